//! Logs: an input is a file. The targets differ in their inputs only: the format is detected.

use super::protocol::check_shape;
use super::{Target, assert_printable};
use descan::frame::Frame;
use descan::log::candump::parse_line;
use descan::log::{
    FORMATS, LogEntry, LogFormat, LogLoss, LogReader, LogSummary, LogTime, Unpacked,
};
use descan::time::{Epoch, Instant};
use std::io::{self, BufRead, BufReader, Read};

/// Target `candump`.
pub const CANDUMP: Target = Target {
    name: "candump",
    check: |input| {
        check_lines(input);
        check(input);
    },
    words: &[
        b"(1436509052.249713) can0 02015402#0444455301\n",
        b"(0.0) can1 123#R4\n",
        b" 123##1AABB T\n",
        b" 20000004#0001020304050607\n",
        b"#11.22.33",
        b"_9",
        b"_F",
        b"\r\n",
        b"\xEF\xBB\xBF",
        b"(18446744073709.551615)",
        b"(1436509052)",
        b"##F",
        b"\x1B[2J",
        b"1FFFFFFF#",
        b"123#1122334455667788",
        b"\n\n",
        b"  can0  RX - -  123   [2]  11 22\n",
        b"date Mon\n",
    ],
};

/// Target `pcapng`.
pub const PCAPNG: Target = Target {
    name: "pcapng",
    check,
    words: &[
        b"\x0A\x0D\x0D\x0A\x1C\0\0\0\x4D\x3C\x2B\x1A\x01\0\0\0\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF\x1C\0\0\0",
        b"\x01\0\0\0\x14\0\0\0\xE3\0\0\0\0\0\0\0\x14\0\0\0",
        b"\x01\0\0\0\x20\0\0\0\xE3\0\0\0\0\0\0\0\x02\0\x04\0can0\0\0\0\0\x20\0\0\0",
        b"\x06\0\0\0\x30\0\0\0\0\0\0\0\0\0\0\0\x01\0\0\0\x10\0\0\0\x10\0\0\0",
        b"\x82\x01\x54\x02\x05\0\0\0\x04DES\x01\0\0\0\x30\0\0\0", b"\x09\0\x01\0\x09\0\0\0",
        b"\x0E\0\x08\0\xFF\xFF\xFF\xFF\xFF\xFF\xFF\x7F", b"\x02\0\x04\0\x02\0\0\0", b"\x4D\x3C\x2B\x1A",
        b"\x1A\x2B\x3C\x4D", b"\0\0\0\0", b"\xFF\xFF\xFF\xFF", b"\x05\0\0\0", b"\x03\0\0\0", b"\x02\0\0\0",
    ],
};

/// Target `asc`.
pub const ASC: Target = Target {
    name: "asc",
    check,
    words: &[
        b"date Sat Sep 30 10:06:13.191 PM 2017\n",
        b"base hex  timestamps absolute\n",
        b"base dec  timestamps relative\n",
        b"// version 9.0.0\n",
        b"Begin Triggerblock Sam Sep 30 15:06:13.191 2017\n",
        b"End TriggerBlock\n",
        b"   2.501000 1  ErrorFrame  ECC: 10100010\n",
        b"   2.5 1  OverloadFrame\n",
        b"   3.098426 1  18EBFF00x  Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 0 ID = 1x\n",
        b"   2.510001 2  100  Tx   r 8\n",
        b"  30.005021 CANFD   1 Rx        300                 1 0 8  8 11 c2 03 04 05 06 07 08",
        b"   102203  133   303000 e0006659 46500250\n",
        b" NAME 0 1 f 64",
        b"   1.015991 1  Statistic: D 0 R 0 XD 0\n",
        b" d d 00 11 22 33 44 55 66 77\n",
        b"99999999999999.999999",
    ],
};

/// Target `trc`.
pub const TRC: Target = Target {
    name: "trc",
    check,
    words: &[
        b";$FILEVERSION=2.1\n",
        b";$FILEVERSION=1.0\n",
        b";$FILEVERSION=1.1\n",
        b";$FILEVERSION=1.3\n",
        b";$STARTTIME=44548.6028595139\n",
        b";$COLUMNS=N,O,T,B,I,d,R,L,D\n",
        b";$COLUMNS=N,O,T,I,d,l,D\n",
        b";##########\n",
        b"      1     17535.400 DT 1  00000100 Tx -  8    00 11 22 33 44 55 66 77\n",
        b"      2     17540.300 ST 1         - Rx -  4    00 00 00 08\n",
        b" FB 1 01A0 Rx - 15 ",
        b" RR 1      0704 Rx -  1\n",
        b" ER 1         - Rx -  5    04 00 02 00 00\n",
        b"     1)     17535  00000100  8  00 11 22 33 44 55 66 77\n",
        b"     2)     17540.3  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY\n",
        b"     2)     17540.3 1  Error  0008 -  4  00 00 00 08\n",
        b"  1  RTR\n",
        b" FE ",
        b" BI ",
        b" FD ",
    ],
};

/// Target `csv`.
pub const CSV: Target = Target {
    name: "csv",
    check,
    words: &[
        b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n",
        b"Time Stamp,ID,Extended,Bus,LEN,D1,D2\n",
        b"166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,\n",
        b"166064001,1FFFFFFF,true,Tx,1,12,FE,36,12,FE,69,05,07,AD,01,02,03,04,\n",
        b"timestamp,arbitration_id,extended,remote,error,dlc,data\n",
        b"1483389946.197,0xdadada,1,0,0,6,WzQyLCA5\n",
        b"1e-05,0x0,0,1,0,8,\n",
        b"0.0,0x0,0,0,1,0,\n",
        b",,,,",
        b"18446744073709551615,",
        b"==",
        b"1e300,",
        b"-1,",
        b"nan,",
    ],
};

/// Target `pcap`.
pub const PCAP: Target = Target {
    name: "pcap",
    check,
    words: &[
        b"\xD4\xC3\xB2\xA1\x02\0\x04\0\0\0\0\0\0\0\0\0\xFF\xFF\0\0\xE3\0\0\0",
        b"\xD4\xC3\xB2\xA1\x02\0\x04\0\0\0\0\0\0\0\0\0\xFF\xFF\0\0\x71\0\0\0",
        b"\xD4\xC3\xB2\xA1\x02\0\x04\0\0\0\0\0\0\0\0\0\xFF\xFF\0\0\x14\x01\0\0",
        b"\xA1\xB2\x3C\x4D\0\x02\0\x04\0\0\0\0\0\0\0\0\0\0\xFF\xFF\0\0\0\xE3",
        b"\0\0\0\x40\x01\0\0\0\x10\0\0\0\x10\0\0\0",
        b"\0\0\x01\x23\x08\0\0\0\0\x11\x22\x33\x44\x55\x66\x77",
        b"\0\x04\x01\x18\0\0\0\0\0\0\0\0\0\0\0\x0C",
        b"\0\x0D\0\0\0\0\0\x03\x01\x18\x04\0\0\0\0\0\0\0\0\0",
        b"\x82\x01\x54\x02\x05\0\0\0\x04DES\x01",
        b"\xFF\xFF\xFF\xFF",
        b"\0\0\0\0",
    ],
};

/// Target `packed`: BLF, and compressed logs.
pub const PACKED: Target = Target {
    name: "packed",
    check: check_packed,
    words: &[
        b"LOGG\x90\0\0\0",
        b"LOBJ\x10\0\x01\0",
        b"LOBJ\x20\0\x01\0\x30\0\0\0\x01\0\0\0",
        b"\x0A\0\0\0\0\0",
        b"\x0A\0\0\0\x02\0",
        b"\x56\0\0\0",
        b"\x64\0\0\0",
        b"\x65\0\0\0",
        b"\x49\0\0\0",
        b"\x1F\x8B\x08\0\0\0\0\0\0\x03",
        b"\x28\xB5\x2F\xFD",
        b"\xFD7zXZ\0\0\x04",
        b"\x21\x01\x16",
        b"\x21\x01\x28",
        b"\0\0\0\0",
        b"\xFF\xFF\xFF\xFF",
        b"\x78\x9C",
    ],
};

/// Target `sqlite`: databases of python-can.
pub const SQLITE: Target = Target {
    name: "sqlite",
    check: check_random_access,
    words: &[
        b"SQLite format 3\0\x02\0\x01\x01\0\x40\x20\x20",
        b"CREATE TABLE messages(ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER",
        b"\x0D\0\0\0\x01",
        b"\x05\0\0\0\x01",
        b"\x08\x07\x04\x08\x08\x08\x01\x16",
        b"\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF",
        b"\x81\x7F",
        b"\0\0\0\x02",
        b"\0\0\0\0",
    ],
};

/// Target `mdf`: ASAM MDF 4 with the frames of a bus.
pub const MDF: Target = Target {
    name: "mdf",
    check: check_random_access,
    words: &[
        b"MDF     4.10    ",
        b"UnFinMF 4.10    ",
        b"##HD\0\0\0\0\x68\0\0\0\0\0\0\0\x06\0\0\0\0\0\0\0",
        b"##DG\0\0\0\0\x40\0\0\0\0\0\0\0\x04\0\0\0\0\0\0\0",
        b"##DL\0\0\0\0",
        b"##HL\0\0\0\0",
        b"##DT\0\0\0\0",
        b"##SD\0\0\0\0",
        b"##DZ\0\0\0\0",
        b"DT\x01\0\x14\0\0\0",
        b"CAN_DataFrame.DataBytes\0",
        b"CAN_ErrorFrame.ErrorType\0",
        b"CAN_RemoteFrame.ID\0",
        b"\0\0\0\0\0\0\0\0",
        b"\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF",
        b"\x40\0\0\0\0\0\0\0",
    ],
};

/// Bytes of a log that are needed to detect its format.
const HEAD: usize = 64;

/// A log in pieces of at most `size` bytes.
struct Pieces<'i> {
    bytes: &'i [u8],
    size: usize,
}

impl Read for Pieces<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Pieces<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        Ok(&self.bytes[..self.bytes.len().min(self.size)])
    }

    fn consume(&mut self, count: usize) {
        self.bytes = &self.bytes[count..];
    }
}

fn read(bytes: &[u8], size: usize) -> (Vec<Frame>, LogSummary) {
    let mut reader = LogReader::new(Pieces { bytes, size });
    let frames = reader.by_ref().map(Result::unwrap).collect();
    (frames, reader.summary().clone())
}

/// Reads a log that another program is still writing: its first half, then the rest.
fn read_growing(bytes: &[u8]) -> (Vec<Frame>, LogSummary) {
    let (first, rest) = bytes.split_at(bytes.len().min(HEAD.max(bytes.len() / 2)));
    let mut reader = LogReader::new(first);
    reader.hold_partial_entry();
    let mut frames: Vec<Frame> = reader.by_ref().map(Result::unwrap).collect();
    *reader.source_mut() = rest;
    frames.extend(reader.by_ref().map(Result::unwrap));
    frames.extend(reader.read_partial_entry());
    (frames, reader.summary().clone())
}

/// Reads a packed log.
fn read_packed(bytes: &[u8], size: usize) -> (Vec<Frame>, LogSummary) {
    let source = BufReader::with_capacity(size, Unpacked::new(bytes));
    let mut reader = LogReader::new(source);
    let frames = reader.by_ref().map(Result::unwrap).collect();
    (frames, reader.summary().clone())
}

fn check_packed(input: &[u8]) {
    let (frames, summary) = read_packed(input, 1 << 16);
    for size in [1, 100] {
        let (other, of_other) = read_packed(input, size);
        // A decompressor may find damage before it gives the bytes before it.
        if summary.damage.is_some() && of_other.damage.is_some() {
            let both = frames.len().min(other.len());
            assert_eq!(frames[..both], other[..both], "pieces of {size}");
        } else {
            assert_eq!((other, of_other), (frames.clone(), summary.clone()), "pieces of {size}");
        }
    }
    check_read(&frames, &summary);
}

/// Checks a log that is read in any order: in a file, or stored in memory.
fn check_random_access(input: &[u8]) {
    check_packed(input);
    let stored = read_packed(input, 1 << 16);
    let source = Unpacked::new(input).with_file(input.to_vec(), None);
    let mut reader = LogReader::new(BufReader::with_capacity(1 << 16, source));
    let mut frames = Vec::new();
    while let Some(frame) = reader.next_frame().unwrap() {
        frames.push(frame);
        let most = frames.len() + 100;
        reader.take_buffered(&mut frames, most);
    }
    assert_eq!((frames, reader.summary().clone()), stored);
}

fn check(input: &[u8]) {
    let (frames, summary) = read(input, usize::MAX);
    for size in [1, 7] {
        assert_eq!(read(input, size), (frames.clone(), summary.clone()), "pieces of {size}");
    }
    assert_eq!(read_growing(input), (frames.clone(), summary.clone()), "a log that grows");

    assert!(summary.entries <= input.len() as u64);
    check_read(&frames, &summary);
}

/// Checks what was read, and that it is the same when it is written and read again.
fn check_read(frames: &[Frame], summary: &LogSummary) {
    assert_printable(&summary.to_string());
    assert_printable(&summary.unreadable_entries().to_string());
    summary.interfaces.iter().for_each(|name| assert_printable(name));
    assert_eq!(summary.frames, frames.len() as u64);
    assert!(summary.frames <= summary.entries);
    let mut last = Instant::ZERO;
    for frame in frames {
        check_shape(frame);
        assert!((last..=Instant::LATEST).contains(&frame.time), "{frame:?} after {last}");
        assert!(usize::from(frame.bus.0) < summary.interfaces.len(), "{frame:?}");
        last = frame.time;
    }
    for format in &FORMATS {
        check_written(format, frames, summary, |_| 0);
        if matches!(format.name, "pcapng" | "blf") {
            check_written(format, frames, summary, |at| (at * 377 % 1000) as u16);
        }
    }
}

/// Asserts that a log is the same when it is written in this format and read again. `nanos` returns the
/// nanoseconds of the time of each frame.
fn check_written(
    format: &LogFormat,
    frames: &[Frame],
    summary: &LogSummary,
    nanos: fn(usize) -> u16,
) {
    /// The end of the dates that the formats with dates have, in microseconds since 1970.
    const YEAR_9000: u64 = 221_845_392_000_000_000;
    let Some(epoch) = summary.epoch else { return };
    let end = epoch.unix_micros(frames.last().map_or(Instant::ZERO, |frame| frame.time));
    let has_dates = !matches!(format.name, "candump" | "pcapng");
    if has_dates && end > YEAR_9000 {
        return;
    }
    let mut encoder = format.encoder();
    let mut log = Vec::new();
    encoder.begin(&mut log).unwrap();
    for (at, frame) in frames.iter().enumerate() {
        let interface = &summary.interfaces[usize::from(frame.bus.0)];
        let time = LogTime { micros: epoch.unix_micros(frame.time), nanos: nanos(at) };
        let entry = LogEntry { time, interface, frame: *frame };
        assert!(encoder.write(entry, u64::MAX, &mut log).unwrap(), "{frame:?}");
    }
    encoder.end(&summary.interfaces, &vec![0; summary.interfaces.len()], &mut log).unwrap();

    let loss = encoder.loss();
    let left_out = loss.remote_frames + loss.error_frames;
    let is_whole = LogLoss { numbers: Vec::new(), ..loss }.is_empty();
    let mut reader = LogReader::new(BufReader::with_capacity(1 << 16, Unpacked::new(&log[..])));
    let (mut again, mut read_nanos) = (Vec::new(), Vec::new());
    while let Some(frame) = reader.next_frame().unwrap() {
        again.push(frame);
        read_nanos.push(reader.summary().written.nanos);
    }
    let read = reader.summary();
    if !is_whole {
        assert_eq!(again.len() as u64 + left_out, frames.len() as u64, "{}", format.name);
        return;
    }
    assert_eq!((read.lost_entries(), read.clock_steps_back), (0, 0), "{read}");
    assert_eq!(read.epoch.map(unix_micros), Some(unix_micros(epoch)));
    assert_eq!(again.len(), frames.len());
    assert!((0..frames.len()).map(nanos).eq(read_nanos), "{}", format.name);
    if has_dates && summary.interfaces.len() > 255 {
        return;
    }
    // Other names are changed when they are written, and may then be equal.
    let is_plain =
        |name: &String| !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_alphanumeric());
    let keeps_names = summary.interfaces.iter().all(|name| is_plain(name) && name.len() <= 16);
    if keeps_names && !has_dates {
        assert_eq!(read.interfaces, summary.interfaces);
    }
    for (again, frame) in again.iter().zip(frames) {
        // A time after the largest Unix time is written as that.
        let time = epoch.unix_micros(frame.time) - unix_micros(epoch);
        let bus = if keeps_names { frame.bus } else { again.bus };
        let mut expected = frame.with_time(Instant::from_micros(time)).with_bus(bus);
        // What is written has times.
        expected.is_timeless = false;
        assert_eq!(*again, expected);
    }
}

fn unix_micros(epoch: Epoch) -> u64 {
    epoch.unix_micros(Instant::ZERO)
}

/// Reads each line; an entry is the same when it is printed and read again.
fn check_lines(input: &[u8]) {
    for line in input.split(|byte| *byte == b'\n') {
        match parse_line(line) {
            Ok(Some(entry)) => {
                let printed = entry.to_string();
                assert_printable(&printed);
                let time = LogTime::from_micros(entry.time.micros);
                let whole_micros = LogEntry { time, ..entry };
                assert_eq!(parse_line(printed.as_bytes()), Ok(Some(whole_micros)), "{printed}");
            }
            Ok(None) => assert!(line.trim_ascii().is_empty()),
            Err(fault) => assert_printable(&fault.to_string()),
        }
    }
}
