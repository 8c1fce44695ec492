//! pcapng: files written by descan are read back and match tshark's output; files of other programs
//! are read, and no file content does harm.

use crate::common::frames::any_frame;
use descan::frame::{BusIndex, CanId, Frame};
use descan::log::pcapng::{
    Damage, PacketFault, write_frame, write_interface, write_section, write_statistics,
};
use descan::log::{EntryFault, LogReader, LogSummary};
use descan::time::{Duration, Instant};
use proptest::prelude::*;
use std::io::BufReader;
use std::process::Command;

const START: u64 = 1_436_509_052_249_713;

fn read_with(bytes: &[u8], buffer: usize) -> (Vec<Frame>, LogSummary) {
    let mut reader = LogReader::new(BufReader::with_capacity(buffer, bytes));
    let frames = reader.by_ref().collect::<Result<_, _>>().unwrap();
    (frames, reader.summary().clone())
}

fn read(bytes: &[u8]) -> (Vec<Frame>, LogSummary) {
    read_with(bytes, 1 << 16)
}

/// Returns a pcapng file of these frames, with an interface per bus.
fn write(frames: &[Frame]) -> Vec<u8> {
    let mut file = Vec::new();
    write_section(&mut file).unwrap();
    let mut described = 0;
    for frame in frames {
        while described <= frame.bus.0 {
            write_interface(&mut file, &format!("can{described}")).unwrap();
            described += 1;
        }
        let micros = START + frame.time.as_micros();
        write_frame(&mut file, frame.bus.0.into(), micros, frame).unwrap();
    }
    file
}

/// Returns a frame of every kind, a millisecond apart.
fn one_of_each() -> Vec<Frame> {
    let mut fd = Frame::fd(0x0201_5402, &[7; 20], 0);
    fd.error_state = true;
    let mut plain_fd = Frame::fd(1, &[1, 2, 3], 0);
    (plain_fd.id, plain_fd.bit_rate_switch) = (CanId::Standard(0x123), false);
    let all = [
        Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]),
        Frame::new(CanId::Standard(0x7FF), &[]).with_tx(),
        Frame::remote(CanId::Standard(0x123), 4),
        Frame::remote(CanId::Extended(0x123), 0).with_tx(),
        Frame::error(0x24, &[0, 1, 2, 3, 4, 5, 6, 7]),
        fd,
        plain_fd.with_tx(),
    ];
    let dated =
        |(at, frame): (usize, Frame)| frame.with_time(Instant::from_micros(at as u64 * 1000));
    all.into_iter().enumerate().map(dated).collect()
}

// --- files of other programs ----------------------------------------------------------------

/// Builds blocks in one byte order.
struct Blocks {
    big_endian: bool,
    bytes: Vec<u8>,
}

impl Blocks {
    fn new(big_endian: bool) -> Self {
        Self::with_version(big_endian, 1)
    }

    fn with_version(big_endian: bool, major: u16) -> Self {
        let mut blocks = Self { big_endian, bytes: Vec::new() };
        let mut body = blocks.u32(0x1A2B_3C4D);
        body.extend([blocks.u16(major), blocks.u16(0)].concat());
        body.extend([0xFF; 8]);
        blocks.block(0x0A0D_0D0A, &body);
        blocks
    }

    fn u16(&self, number: u16) -> Vec<u8> {
        let bytes = if self.big_endian { number.to_be_bytes() } else { number.to_le_bytes() };
        bytes.to_vec()
    }

    fn u32(&self, number: u32) -> Vec<u8> {
        let bytes = if self.big_endian { number.to_be_bytes() } else { number.to_le_bytes() };
        bytes.to_vec()
    }

    fn block(&mut self, kind: u32, body: &[u8]) {
        let mut body = body.to_vec();
        body.resize(body.len().next_multiple_of(4), 0);
        let len = self.u32(body.len() as u32 + 12);
        self.bytes.extend([self.u32(kind), len.clone(), body, len].concat());
    }

    fn interface(&mut self, link_type: u16, options: &[(u16, &[u8])]) {
        let mut body = [self.u16(link_type), self.u16(0), self.u32(0)].concat();
        for (option, value) in options {
            body.extend([self.u16(*option), self.u16(value.len() as u16), value.to_vec()].concat());
            body.resize(body.len().next_multiple_of(4), 0);
        }
        self.block(1, &body);
    }

    fn packet(&mut self, interface: u32, time: u64, packet: &[u8]) {
        let head = [interface, (time >> 32) as u32, time as u32]
            .into_iter()
            .chain([packet.len() as u32; 2])
            .flat_map(|number| self.u32(number));
        let body: Vec<u8> = head.chain(packet.iter().copied()).collect();
        self.block(6, &body);
    }
}

/// Returns the packet of a frame with a standard identifier and one byte.
fn packet(id: u16, byte: u8) -> Vec<u8> {
    // Padded to eight bytes, as the kernel captures them.
    [&u32::from(id).to_be_bytes()[..], &[1, 0, 0, 0, byte, 0, 0, 0, 0, 0, 0, 0]].concat()
}

#[test]
fn packet_outside_the_range_of_times_is_unreadable() {
    let before_1970 = (-20_i64).to_le_bytes();
    // Units of interfaces, and a time in each that is read, with its microseconds, and one that is not.
    let seconds = 1_u64 << 44;
    for (options, (time, micros), outside) in [
        (&[(14, &before_1970[..])][..], (20_000_000, 0), 19_999_999),
        (&[(9, &[9]), (14, &before_1970)], (20_000_000_999, 0), 19_999_999_999),
        (&[(9, &[0])], (seconds, seconds * 1_000_000), 1 << 45),
        (&[(9, &[0x80])], (seconds, seconds * 1_000_000), u64::MAX),
        (
            &[(14, &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F, 0, 0])],
            (0, 17_592_186_044_415_000_000),
            u64::MAX,
        ),
    ] {
        let mut blocks = Blocks::new(false);
        blocks.interface(227, options);
        blocks.packet(0, outside, &packet(0x101, 1));
        blocks.packet(0, time, &packet(0x102, 2));
        let (frames, summary) = read(&blocks.bytes);
        assert_eq!(summary.written.micros, micros, "{options:?}");
        assert_eq!(frames.len(), 1, "{options:?}");
        assert_eq!(
            summary.unreadable_entries().to_string(),
            "block 3 cannot be read: the time is before 1970, or too large",
            "{options:?}"
        );
    }
}

#[test]
fn either_byte_order_and_any_time_unit_is_read() {
    let mut big = Blocks::new(true);
    big.interface(227, &[(2, b"can7"), (9, &[9])]);
    big.interface(1, &[(2, b"eth0")]);
    big.interface(227, &[(2, b"can 8\x1b[2J"), (9, &[0x80 | 0xA]), (14, &1_000_u64.to_be_bytes())]);
    big.block(0x0BAD, b"nobody knows this one");
    big.packet(0, 1_700_000_000_123_456_789, &packet(0x101, 1));
    big.packet(1, 1_700_000_000_000_000, &[0; 60]);
    big.packet(2, (1_700_000_000 - 1_000) << 10 | 512, &packet(0x102, 2));
    big.packet(9, 0, &packet(0x103, 3));
    let mut little = Blocks::new(false);
    // Neither a name nor a unit: microseconds.
    little.interface(227, &[]);
    little.interface(227, &[(2, b"can7"), (9, &[3])]);
    little.packet(0, 1_700_000_001_000_000, &packet(0x104, 4));
    little.packet(1, 1_700_000_001_500, &packet(0x105, 5));
    let file = [big.bytes, little.bytes].concat();

    let (frames, tally) = read(&file);
    assert_eq!(*tally.interfaces, ["can7", "can_8\\x1B[2J", "if0"]);
    let told: Vec<_> =
        frames.iter().map(|it| (it.bus.0, it.data()[0], it.time.as_micros())).collect();
    assert_eq!(told, [(0, 1, 0), (1, 2, 376_544), (2, 4, 876_544), (0, 5, 1_376_544)], "{tally:?}");
    assert_eq!(tally.epoch.unwrap().unix_micros(Instant::ZERO), 1_700_000_000_123_456);
    assert_eq!((tally.unreadable, tally.damage), (2, None));
    let eth = EntryFault::Packet(PacketFault::LinkType(1));
    assert_eq!(tally.first_unreadable, Some((7, eth)));
    assert_eq!(
        tally.to_string(),
        "4 frames of 3 interfaces; 2 blocks cannot be read, the first is block 7: link type 1, expected \
         227 (SocketCAN), 113 or 276 (Linux cooked)"
    );
    for buffer in 1..70 {
        assert_eq!(read_with(&file, buffer), (frames.clone(), tally.clone()), "{buffer}");
    }
}

#[test]
fn non_can_packets_are_reported() {
    let mut blocks = Blocks::new(false);
    blocks.interface(227, &[]);
    for odd in [
        &[0; 7][..],
        // Nine bytes of which two are there; more bytes than allowed; a standard identifier beyond
        // 0x7FF; CAN XL.
        &[0, 0, 1, 1, 2, 0, 0, 0, 1],
        &[0, 0, 1, 1, 65, 4, 0, 0],
        &[0, 0, 0x11, 1, 0, 0, 0, 0],
        &[0, 0, 1, 1, 0x81, 0, 0, 0, 0, 0, 0, 0],
    ] {
        blocks.packet(0, 5, odd);
    }
    blocks.block(6, &[0; 8]);
    blocks.block(3, &[0; 20]);
    blocks.packet(0, 5, &packet(0x101, 1));
    let (frames, tally) = read(&blocks.bytes);
    assert_eq!((frames.len(), tally.unreadable, tally.damage), (1, 7, None));
}

#[test]
fn interfaces_beyond_bus_limit_use_no_memory() {
    let mut blocks = Blocks::new(false);
    for number in 0..100_000 {
        blocks.interface(227, &[(2, format!("can{number}").as_bytes())]);
    }
    blocks.packet(255, 5, &packet(0x101, 1));
    blocks.packet(99_999, 5, &packet(0x101, 1));
    let (frames, tally) = read(&blocks.bytes);
    assert_eq!((frames.len(), tally.unreadable), (1, 1));
    assert_eq!(*tally.interfaces, ["can255"]);
    let cause = EntryFault::Packet(PacketFault::TooManyInterfaces);
    assert_eq!(tally.first_unreadable, Some((100_003, cause)));
}

#[test]
fn packets_of_unknown_versions_and_kinds_are_counted() {
    let mut known = Blocks::new(true);
    known.interface(227, &[(2, b"can7")]);
    known.packet(0, 5, &packet(0x101, 1));
    let mut unknown = Blocks::with_version(false, 2);
    unknown.interface(227, &[]);
    unknown.packet(0, 5, &packet(0x102, 2));
    unknown.block(6, &vec![0; 1 << 17]);
    unknown.block(5, &[0; 8]);
    let (frames, tally) = read(&[&known.bytes[..], &unknown.bytes, &known.bytes].concat());
    assert_eq!((frames.len(), tally.unreadable, tally.damage), (2, 2, None));
    let cause = EntryFault::Packet(PacketFault::Version(2));
    assert_eq!(tally.first_unreadable, Some((6, cause)));
    let mut blocks = Blocks::new(false);
    blocks.interface(227, &[]);
    blocks.block(3, &[0; 20]);
    let (_, tally) = read(&blocks.bytes);
    let cause = EntryFault::Packet(PacketFault::NoTime);
    assert_eq!(tally.first_unreadable, Some((3, cause)));
}

/// As tools wrote them before 2009: the number of lost packets stands behind that of the interface.
#[test]
fn obsolete_packet_blocks_are_read() {
    for big_endian in [false, true] {
        let mut blocks = Blocks::new(big_endian);
        blocks.interface(227, &[]);
        blocks.interface(227, &[(2, b"can7")]);
        let data = packet(0x101, 0x5A);
        let lens = [data.len() as u32; 2].map(|len| blocks.u32(len)).concat();
        let place = [blocks.u16(1), blocks.u16(3), blocks.u32(0), blocks.u32(5)].concat();
        blocks.block(2, &[place.clone(), lens, data].concat());
        blocks.block(2, &place[..4]);
        let (frames, tally) = read(&blocks.bytes);
        assert_eq!(frames, [Frame::new(CanId::Standard(0x101), &[0x5A])]);
        assert_eq!((tally.interfaces[0].as_str(), tally.unreadable), ("can7", 1));
        let cause = EntryFault::Packet(PacketFault::Short);
        assert_eq!(tally.first_unreadable, Some((5, cause)));
    }
}

// --- damage -----------------------------------------------------------------------------------

#[test]
fn truncated_file_keeps_frames_before_the_cut() {
    let frames = one_of_each();
    let mut file = write(&frames);
    write_statistics(&mut file, 0, START, 7, 3).unwrap();
    let mut seen = 0;
    for end in 0..file.len() {
        let (there, tally) = read(&file[..end]);
        assert_eq!(there, frames[..there.len()], "{end}");
        assert!(there.len() >= seen, "{end}");
        seen = there.len();
        assert!(matches!(tally.damage, None | Some(Damage::Truncated)), "{end}: {tally:?}");
    }
    assert_eq!(seen, frames.len());
    let (_, tally) = read(&file[..file.len() - 1]);
    let cut = file.len() - 1;
    assert_eq!(tally.to_string(), format!("7 frames; truncated inside a block (byte {cut})"));
}

#[test]
fn wrong_block_lengths_use_no_memory() {
    let frames = one_of_each();
    let file = write(&frames);
    for (length, damage) in [
        (0, Damage::Length(0)),
        (8, Damage::Length(8)),
        (13, Damage::Length(13)),
        (16, Damage::Lengths),
        (!3, Damage::Truncated),
    ] {
        let mut lying = file.clone();
        lying.extend([6_u32.to_le_bytes(), u32::to_le_bytes(length)].concat());
        lying.extend([0; 24]);
        let (there, tally) = read(&lying);
        assert_eq!((&there, tally.damage), (&frames, Some(damage)), "{length}");
    }
    // A block whose stated length is correct, but above the limit.
    let mut long = Blocks { big_endian: false, bytes: file.clone() };
    long.block(6, &vec![0; 1 << 20]);
    long.block(0x0BAD, &vec![0; 1 << 20]);
    long.bytes.extend(&file);
    let (there, tally) = read(&long.bytes);
    assert_eq!((there.len(), tally.unreadable, tally.damage), (2 * frames.len(), 1, None));
    // The captured length within a block is wrong, too.
    let mut inner = Blocks::new(false);
    inner.interface(227, &[]);
    let mut body = vec![0; 12];
    body.extend([u32::MAX.to_le_bytes(); 2].concat());
    inner.block(6, &body);
    let (_, tally) = read(&inner.bytes);
    assert_eq!(tally.first_unreadable, Some((3, EntryFault::Packet(PacketFault::Short))));
}

#[test]
fn log_with_leading_blank_line_is_text() {
    let line = "(1.5) can0 123#11\n";
    for blank in ["\n", "\n\r\n", "\r\n", "\n\r", "\n\n"] {
        for buffer in [1, 3, 4096] {
            let (frames, tally) = read_with(format!("{blank}{line}").as_bytes(), buffer);
            assert_eq!((frames.len(), tally.unreadable), (1, 0), "{blank:?}");
        }
    }
    assert_eq!(read(b"\n").1.entries, 1);
    assert_eq!(read(b"\n\r\r").1.frames, 0);
}

proptest! {
    #[test]
    fn any_frame_written_is_read_back(
        frames in proptest::collection::vec((any_frame(), 0_u64..5_000_000, 0_u8..3), 1..40),
        buffer in 1_usize..300,
    ) {
        let mut moment = Instant::ZERO;
        let frames: Vec<Frame> = frames
            .into_iter()
            .enumerate()
            .map(|(at, (frame, gap, bus))| {
                // The first frame sets the start, and belongs to the first bus.
                let (gap, bus) = if at == 0 { (0, 0) } else { (gap, bus) };
                moment += Duration::from_micros(gap);
                frame.with_time(moment).with_bus(BusIndex(bus))
            })
            .collect();
        let (there, tally) = read_with(&write(&frames), buffer);
        prop_assert_eq!(tally.epoch.unwrap().unix_micros(Instant::ZERO), START);
        prop_assert_eq!((tally.unreadable, tally.damage), (0, None));
        // Buses are numbered in order of appearance.
        prop_assert_eq!(there.len(), frames.len());
        for (there, frame) in there.iter().zip(&frames) {
            let name = format!("can{}", frame.bus.0);
            prop_assert_eq!(&tally.interfaces[usize::from(there.bus.0)], &name);
            prop_assert_eq!(there.with_bus(frame.bus), *frame);
        }
    }

    #[test]
    fn changed_bytes_do_not_panic(
        at in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut file = write(&one_of_each());
        for (index, byte) in at {
            *index.get_mut(&mut file[..]) = byte;
        }
        let (frames, _) = read(&file);
        prop_assert!(frames.len() <= 7);
    }

    #[test]
    fn arbitrary_bytes_do_not_panic(
        rest in proptest::collection::vec(any::<u8>(), 0..400),
        magic in any::<bool>(),
    ) {
        let head: &[u8] = if magic { &write(&one_of_each())[..60] } else { b"\n\r\r\n" };
        read(&[head, &rest].concat());
    }
}

// --- tshark -----------------------------------------------------------------------------------

/// Returns tshark's output for a file; `None` if tshark is missing and may be.
fn tshark(file: &[u8], arguments: &[&str]) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.pcapng");
    std::fs::write(&path, file).unwrap();
    let output = Command::new("tshark")
        .args(["-n", "-r", path.to_str().unwrap()])
        .args(arguments)
        .env("HOME", folder.path())
        .output();
    match output {
        Ok(output) => {
            let words = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.success(), "{words}");
            Some(String::from_utf8(output.stdout).unwrap())
        }
        Err(missing) => {
            assert!(std::env::var_os("CI").is_none(), "tshark: {missing}");
            eprintln!("skipped: tshark: {missing}");
            None
        }
    }
}

#[test]
fn tshark_reads_written_files() {
    let mut frames = one_of_each();
    frames[2].bus = BusIndex(1);
    let mut file = write(&frames);
    write_statistics(&mut file, 1, START, 1, 3).unwrap();
    let fields = [
        "frame.time_epoch",
        "frame.interface_name",
        "frame.packet_flags_direction",
        "can.id",
        "can.flags.xtd",
        "can.flags.rtr",
        "can.flags.err",
        "can.err.ack",
        "can.len",
        "canfd.flags.brs",
        "canfd.flags.esi",
        "data.data",
        "_ws.malformed",
    ];
    let mut arguments = vec!["-T", "fields", "-E", "separator=,"];
    arguments.extend(fields.iter().flat_map(|field| ["-e", field]));
    let Some(told) = tshark(&file, &arguments) else { return };
    // FD frames cannot be remote, and error frames have no identifier.
    let expected = "\
1436509052.249713000,can0,0x00000001,33641474,1,0,0,,5,,,0444455301,
1436509052.250713000,can0,0x00000002,2047,0,0,0,,0,,,,
1436509052.251713000,can1,0x00000001,291,0,1,0,,4,,,,
1436509052.252713000,can0,0x00000002,291,1,1,0,,0,,,,
1436509052.253713000,can0,0x00000001,,,,1,1,8,,,,
1436509052.254713000,can0,0x00000001,33641474,1,,,,20,1,1,0707070707070707070707070707070707070707,
1436509052.255713000,can0,0x00000002,291,0,,,,3,0,0,010203,
";
    assert_eq!(told, expected);
}
