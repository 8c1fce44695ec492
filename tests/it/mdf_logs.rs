//! ASAM MDF 4 with the frames of a bus: what is read, and from damaged files.

use crate::common::program::{run_with_input, text};
use crate::common::python::Python;
use crate::common::read_log::read_log;
use descan::frame::{CanId, Frame};
use std::fs;
use std::process::Command;

/// Twenty frames with their data bytes in records of their own, behind each of them.
const UNSORTED: &[u8] = include_bytes!("../corpus/mdf/unsorted");
/// The same, of a logger that lost its power: no lengths, no places of data bytes.
const UNFINISHED: &[u8] = include_bytes!("../corpus/mdf/unfinished");
/// The same with signal data, in two lists of one block each.
const SIGNAL_DATA: &[u8] = include_bytes!("../corpus/mdf/signal_data");
/// The same, compressed, the records transposed.
const PACKED: &[u8] = include_bytes!("../corpus/mdf/signal_data_packed");
/// Twelve frames of python-can.
const PYTHON_CAN: &[u8] = include_bytes!("../corpus/mdf/python_can");
/// The sixth frame: 64 bytes from 0F on.
const SIXTH: &str = "01ABCDE5##00F101112131415161718191A1B1C1D1E1F202122232425262728292A2B2C2D2E2F\
    303132333435363738393A3B3C3D3E3F404142434445464748494A4B4C4D4E";

/// Returns where the blocks of a type begin.
fn blocks(bytes: &[u8], kind: &str) -> Vec<usize> {
    let mark = format!("##{kind}");
    (0..bytes.len() - 4).filter(|at| &bytes[*at..*at + 4] == mark.as_bytes()).collect()
}

#[test]
fn data_bytes_are_found_wherever_they_are() {
    for (name, bytes) in [
        ("unsorted", UNSORTED),
        ("unfinished", UNFINISHED),
        ("signal data", SIGNAL_DATA),
        ("packed", PACKED),
    ] {
        let (frames, summary) = read_log(bytes);
        assert_eq!(summary.to_string(), "20 frames of 2 interfaces", "{name}");
        assert_eq!(*summary.interfaces, ["bus1", "bus2"], "{name}");
        let micros = |at: usize| summary.epoch.unwrap().unix_micros(frames[at].time);
        assert_eq!((micros(0), micros(19)), (1_700_000_000_000_007, 1_700_000_000_019_007));
        assert_eq!(frames[0].to_string(), "100#", "{name}");
        assert!(frames[0].is_tx && !frames[1].is_tx, "{name}");
        assert_eq!(frames[4].to_string(), "104##10C0D0E0F1011121314151617", "{name}");
        assert_eq!(frames[5].to_string(), SIXTH, "{name}");
    }
}

/// Makes a channel of frames virtual: its value is `offset` + `factor` × number of the record.
fn with_virtual(bytes: &[u8], name: &str, offset: f64, factor: f64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    let conversion = bytes.len() as u64;
    let number =
        |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let mut changed = 0;
    for at in blocks(&bytes, "CN") {
        let name_at = number(&bytes, at + 24 + 8 * 2) as usize;
        let text = &bytes[name_at + 24..];
        let text = &text[..text.iter().position(|byte| *byte == 0).unwrap()];
        if text != name.as_bytes() {
            continue;
        }
        changed += 1;
        let data = at + 24 + 8 * number(&bytes, at + 16) as usize;
        let is_master = bytes[data] == 2;
        bytes[data] = if is_master { 3 } else { 6 };
        bytes[data + 8..data + 12].fill(0);
        bytes[at + 24 + 8 * 4..][..8].copy_from_slice(&conversion.to_le_bytes());
    }
    assert_eq!(changed, 1, "{name}");
    bytes.extend(block("CC", &[0; 4], &conversion_data(offset, factor)));
    bytes
}

/// The data of a linear conversion.
fn conversion_data(offset: f64, factor: f64) -> Vec<u8> {
    let mut data = vec![1, 0, 0, 0, 0, 0, 2, 0];
    for number in [0.0, 0.0, offset, factor] {
        data.extend(number.to_le_bytes());
    }
    data
}

fn block(kind: &str, links: &[u64], data: &[u8]) -> Vec<u8> {
    let mut block = format!("##{kind}\0\0\0\0").into_bytes();
    block.extend((24 + 8 * links.len() as u64 + data.len() as u64).to_le_bytes());
    block.extend((links.len() as u64).to_le_bytes());
    for link in links {
        block.extend(link.to_le_bytes());
    }
    block.extend(data);
    block.resize(block.len().next_multiple_of(8), 0);
    block
}

#[test]
fn virtual_channels_have_the_value_of_their_conversion() {
    let read = |name: &str, offset: f64, factor: f64| {
        let (frames, summary) = read_log(&with_virtual(UNSORTED, name, offset, factor));
        assert_eq!((frames.len(), summary.lost_entries()), (20, 0), "{name}: {summary}");
        (frames, summary)
    };
    let (frames, _) = read("CAN_DataFrame.Dir", 1.0, 0.0);
    assert!(frames.iter().all(|frame| frame.is_tx));
    let (frames, _) = read("CAN_DataFrame.Dir", 0.0, 0.0);
    assert!(frames.iter().all(|frame| !frame.is_tx));
    let (_, summary) = read("CAN_DataFrame.BusChannel", 9.0, 0.0);
    assert_eq!(*summary.interfaces, ["bus9"]);
    let (_, summary) = read("CAN_DataFrame.BusChannel", 3.0, 1.0);
    assert_eq!(summary.interfaces.len(), 20);
    assert_eq!((&*summary.interfaces[0], &*summary.interfaces[19]), ("bus3", "bus22"));
    let (frames, _) = read("CAN_DataFrame.IDE", 1.0, 0.0);
    assert!(frames.iter().all(|frame| matches!(frame.id, CanId::Extended(_))));
    let (frames, summary) = read("Timestamp", 5.0, 0.25);
    let micros = |at: usize| summary.epoch.unwrap().unix_micros(frames[at].time);
    assert_eq!(micros(19) - micros(0), 19 * 250_000);
    // No number, or none that a frame has.
    for (name, offset) in [("BusChannel", f64::NAN), ("BusChannel", -1.0), ("Dir", 1e300)] {
        read(&format!("CAN_DataFrame.{name}"), offset, 0.0);
    }
    let bytes = with_virtual(UNSORTED, "CAN_DataFrame.BusChannel", 256.0, 0.0);
    assert_eq!(read_log(&bytes).1.unreadable, 20);
}

/// A measurement whose two groups of frames, of the buses 1 and 2, share their data: for each record the
/// bus, and the time in seconds.
fn measurement(records: &[(u8, f64)]) -> Vec<u8> {
    let mut bytes = b"MDF     4.10    descan\0\0".to_vec();
    bytes.extend([0, 0, 0, 0, 0x9A, 0x01]);
    bytes.resize(64, 0);
    let add = |bytes: &mut Vec<u8>, block: Vec<u8>| {
        let address = bytes.len() as u64;
        bytes.extend(block);
        address
    };
    // The header comes first; its link to the group is known later.
    let mut start = 1_700_000_000_000_000_000_u64.to_le_bytes().to_vec();
    start.extend([0; 24]);
    add(&mut bytes, block("HD", &[0; 6], &start));
    let mut data = Vec::new();
    for (number, (bus, seconds)) in records.iter().enumerate() {
        data.push(*bus);
        data.extend(seconds.to_le_bytes());
        data.extend((number as u32 % 0x800).to_le_bytes());
    }
    let data = add(&mut bytes, block("DT", &[], &data));
    let mut groups = 0;
    for bus in [1_u8, 2] {
        let mut channels = 0;
        for (name, kind, format, byte, bits) in [
            ("CAN_DataFrame.BusChannel", 6, 0, 0, 0),
            ("CAN_DataFrame.ID", 0, 0, 8, 32_u32),
            ("Timestamp", 2, 4, 0, 64),
        ] {
            let name = add(&mut bytes, block("TX", &[], format!("{name}\0").as_bytes()));
            let conversion = conversion_data(f64::from(bus), 0.0);
            let conversion = add(&mut bytes, block("CC", &[0; 4], &conversion));
            let conversion = if kind == 6 { conversion } else { 0 };
            let mut of_channel = vec![kind, u8::from(kind == 2), format, 0];
            of_channel.extend((byte as u32).to_le_bytes());
            of_channel.extend(bits.to_le_bytes());
            of_channel.resize(72, 0);
            let links = [channels, 0, name, 0, conversion, 0, 0, 0];
            channels = add(&mut bytes, block("CN", &links, &of_channel));
        }
        let mut of_group = u64::from(bus).to_le_bytes().to_vec();
        let count = records.iter().filter(|record| record.0 == bus).count();
        of_group.extend((count as u64).to_le_bytes());
        of_group.extend([0; 8]);
        of_group.extend(12_u32.to_le_bytes());
        of_group.extend([0; 4]);
        groups = add(&mut bytes, block("CG", &[groups, channels, 0, 0, 0, 0], &of_group));
    }
    let list = add(&mut bytes, block("DG", &[0, groups, data, 0], &[1, 0, 0, 0, 0, 0, 0, 0]));
    bytes[64 + 24..64 + 32].copy_from_slice(&list.to_le_bytes());
    bytes
}

#[test]
fn groups_in_blocks_are_put_in_the_order_of_their_times() {
    // A second of each bus, in turn; the second bus has more.
    let mut records = Vec::new();
    for second in 0..20_u32 {
        records.extend((0..50).map(|at| (1, f64::from(second) + f64::from(at) / 50.0)));
        records.extend((0..70).map(|at| (2, f64::from(second) + f64::from(at) / 70.0)));
    }
    let (frames, summary) = read_log(&measurement(&records));
    assert_eq!(summary.to_string(), "2400 frames of 2 interfaces");
    assert!(frames.is_sorted_by_key(|frame| frame.time));
    // No frame has moved to another time.
    let micros = |frame: &Frame| frame.time.as_micros();
    let mut expected: Vec<u64> = records.iter().map(|(_, it)| (it * 1e6).round() as u64).collect();
    expected.sort_unstable();
    assert_eq!(frames.iter().map(micros).collect::<Vec<_>>(), expected);
}

/// Sets the number of records of a group, counted from 0 in the file.
fn with_count(bytes: &[u8], group: usize, count: u64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let at = blocks(&bytes, "CG")[group] + 24 + 6 * 8 + 8;
    bytes[at..at + 8].copy_from_slice(&count.to_le_bytes());
    bytes
}

#[test]
fn records_behind_the_number_of_a_group_are_none() {
    let records: Vec<_> = (0..40).map(|at| (1 + at % 2, f64::from(at))).collect();
    let shared = measurement(&records);
    let (frames, summary) = read_log(&with_count(&shared, 0, 5));
    assert_eq!(summary.to_string(), "25 frames of 2 interfaces");
    assert_eq!(frames.last().unwrap().bus.0, 1);
    for (bytes, all) in [(SIGNAL_DATA, 20), (PACKED, 20)] {
        assert_eq!(read_log(&with_count(bytes, 0, 3)).1.to_string(), "3 frames of 2 interfaces");
        // A logger that did not come to write it.
        assert_eq!(read_log(&with_count(bytes, 0, 0)).0.len(), all);
    }
    // Of an unfinished measurement the number is not final.
    assert_eq!(read_log(&with_count(UNFINISHED, 0, 3)).0.len(), 20);
}

#[test]
fn room_behind_the_records_of_groups_is_ignored() {
    for bytes in [measurement(&[(1, 0.0), (2, 1.0), (1, 2.0)]), UNSORTED.to_vec()] {
        let (frames, _) = read_log(&bytes);
        let at = *blocks(&bytes, "DT").last().unwrap();
        let len = u64::from_le_bytes(bytes[at + 8..at + 16].try_into().unwrap());
        // The data move to the end, where they are longer.
        let mut data = bytes[at + 24..at + len as usize].to_vec();
        data.resize(data.len() + 4096, 0);
        let mut longer = bytes.clone();
        let moved = (longer.len() as u64).to_le_bytes();
        longer.extend(block("DT", &[], &data));
        let group = blocks(&bytes, "DG")[0] + 24 + 2 * 8;
        longer[group..group + 8].copy_from_slice(&moved);
        let (read, summary) = read_log(&longer);
        assert_eq!((read, summary.lost_entries()), (frames, 0), "{summary}");
    }
}

#[test]
fn counts_and_lengths_up_to_the_largest_number_are_handled() {
    let records: Vec<_> = (0..40).map(|at| (1 + at % 2, f64::from(at))).collect();
    let bytes = with_count(&with_count(&measurement(&records), 0, u64::MAX), 1, u64::MAX);
    let (frames, summary) = read_log(&bytes);
    assert_eq!((frames.len(), summary.lost_entries()), (40, 1), "{summary}");
    let mut bytes = PACKED.to_vec();
    for at in blocks(&bytes, "DZ") {
        bytes[at + 24 + 16..at + 24 + 24].fill(0xFF);
    }
    assert!(read_log(&bytes).1.to_string().contains("damaged block"));
}

#[test]
fn link_behind_every_file_is_damage_of_its_block() {
    let mut bytes = PACKED.to_vec();
    // The third link of a group of data.
    bytes[blocks(PACKED, "DG")[0] + 24 + 2 * 8 + 7] = 0x80;
    let expected = read_log(&bytes).1.to_string();
    assert!(expected.contains("damaged block"), "{expected}");
    // A file, too, whose bytes are read at their place.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("in.mf4"), &bytes).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(["log", "in.mf4", "--stats"]).current_dir(folder.path());
    let said = String::from_utf8(command.output().unwrap().stderr).unwrap();
    assert!(said.contains("damaged block"), "{said}");
}

#[test]
fn records_that_a_group_lacks_are_counted() {
    let records: Vec<_> = (0..40).map(|at| (1 + at % 2, f64::from(at))).collect();
    for (bytes, frames) in [(measurement(&records), 40), (SIGNAL_DATA.to_vec(), 20)] {
        let (_, summary) = read_log(&with_count(&bytes, 0, 25));
        let missing = 25 - 20;
        let said = format!(
            "{frames} frames of 2 interfaces; {missing} records are missing: the cycle counts of its groups \
             are higher"
        );
        assert_eq!(summary.to_string(), said);
        assert_eq!(summary.lost_entries(), 1);
    }
}

#[test]
fn blocks_that_are_not_read_are_not_called_damaged() {
    let said = |bytes: &[u8]| read_log(bytes).1.to_string();
    // The times by a rational conversion.
    let mut bytes = with_virtual(SIGNAL_DATA, "CAN_DataFrame.BusChannel", 1.0, 0.0);
    let conversion = *blocks(&bytes, "CC").last().unwrap() as u64;
    bytes[conversion as usize + 24 + 4 * 8] = 2;
    for at in blocks(&bytes, "CN") {
        let links = u64::from_le_bytes(bytes[at + 16..at + 24].try_into().unwrap()) as usize;
        if bytes[at + 24 + 8 * links] == 2 {
            bytes[at + 24 + 8 * 4..][..8].copy_from_slice(&conversion.to_le_bytes());
        }
    }
    assert!(said(&bytes).contains("the conversion of its times is not read"), "{}", said(&bytes));
    let mut bytes = SIGNAL_DATA.to_vec();
    for at in blocks(&bytes, "DT") {
        bytes[at..at + 4].copy_from_slice(b"##DV");
    }
    assert!(said(&bytes).contains("data stored by columns"), "{}", said(&bytes));
    let mut bytes = PACKED.to_vec();
    for at in blocks(&bytes, "DZ") {
        bytes[at + 24 + 8..at + 24 + 16].copy_from_slice(&(9_u64 << 20).to_le_bytes());
    }
    assert!(said(&bytes).contains("compressed blocks over 8 MB"), "{}", said(&bytes));
}

#[test]
fn measurement_of_a_clock_that_was_not_set_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = SIGNAL_DATA.to_vec();
    // The start: 1970-01-01 00:00, local time.
    let start = 64 + 24 + 6 * 8;
    bytes[start..start + 8].fill(0);
    bytes[start + 12] = 1;
    fs::write(folder.path().join("in.mf4"), bytes).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_descan"));
    command.args(["log", "in.mf4"]).env("TZ", "Europe/Berlin").current_dir(folder.path());
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(text(&output.stdout).lines().count(), 20);
}

/// The disorder is bounded: a group that begins only after all of another one is behind it, and nothing
/// is lost.
#[test]
fn groups_one_behind_another_lose_nothing() {
    let all_of = |bus| (0..200_000_u32).map(move |at| (bus, f64::from(at) / 1000.0));
    let records: Vec<(u8, f64)> = all_of(1).chain(all_of(2)).collect();
    let (frames, summary) = read_log(&measurement(&records));
    assert_eq!(frames.len(), 400_000, "{summary}");
    assert!(summary.clock_steps_back > 0, "{summary}");
}

#[test]
fn groups_of_python_can_are_put_in_order() {
    let (frames, summary) = read_log(PYTHON_CAN);
    assert_eq!((frames.len(), summary.lost_entries(), summary.clock_steps_back), (12, 0, 0));
    let has = |test: fn(&Frame) -> bool| frames.iter().any(test);
    assert!(has(|frame| frame.is_fd) && has(|frame| !frame.is_fd) && has(|frame| frame.is_tx));
}

#[test]
fn damaged_block_is_named_and_frames_before_it_are_read() {
    // The second block of records is behind the first seven frames.
    let second = blocks(SIGNAL_DATA, "DT")[1];
    let mut bytes = SIGNAL_DATA.to_vec();
    bytes[second + 2] = b'?';
    let (frames, summary) = read_log(&bytes);
    assert_eq!(frames.len(), 7, "{summary}");
    let said = summary.to_string();
    let expected = format!("; damaged block: the rest of its data cannot be read (byte {second})");
    assert!(said.ends_with(&expected), "{said}");
    // Compressed data.
    let second = blocks(PACKED, "DZ")[3];
    let mut bytes = PACKED.to_vec();
    bytes[second + 60..second + 70].fill(0x5A);
    let (frames, summary) = read_log(&bytes);
    assert_eq!(frames.len(), 7, "{summary}");
    assert!(summary.to_string().contains(&format!("(byte {second})")), "{summary}");
    // The end is missing.
    let (frames, summary) = read_log(&UNSORTED[..UNSORTED.len() - 100]);
    assert!((10..20).contains(&frames.len()), "{summary}");
    assert!(summary.to_string().contains("damaged block"), "{summary}");
    let (frames, summary) = read_log(&UNFINISHED[..UNFINISHED.len() - 100]);
    assert!((10..20).contains(&frames.len()), "{summary}");
    assert_eq!(summary.damage, None, "an unfinished file ends anywhere");
}

#[test]
fn unfinished_measurement_that_ends_inside_a_record_says_so() {
    assert!(!read_log(UNFINISHED).1.ends_inside_entry);
    let said = |cut: &usize| {
        let summary = read_log(&UNFINISHED[..UNFINISHED.len() - cut]).1;
        let is_said = summary.to_string().contains("; it ends inside a record");
        assert_eq!(is_said, summary.ends_inside_entry);
        is_said || summary.lost_entries() > 0
    };
    // Behind a record nothing is missing. None is longer than 64 data bytes and its other fields.
    let silent: Vec<_> = (1..300).filter(|cut| !said(cut)).collect();
    assert!(silent.len() < 20 && silent.windows(2).all(|it| it[0] + 1 < it[1]), "{silent:?}");
}

#[test]
fn changed_bytes_of_compressed_blocks_are_found() {
    /// Bytes of a block and of the head of its data before what is compressed.
    const BEFORE: usize = 24 + 24;
    let (whole, summary) = read_log(PACKED);
    assert_eq!(summary.lost_entries(), 0);
    for start in blocks(PACKED, "DZ") {
        let size = |at: usize| u64::from_le_bytes(*PACKED[start + at..].first_chunk().unwrap());
        for at in start + BEFORE..start + BEFORE + size(40) as usize {
            let mut changed = PACKED.to_vec();
            changed[at] ^= 0x10;
            let (frames, summary) = read_log(&changed);
            assert!(summary.lost_entries() > 0 || frames == whole, "byte {at}: {summary}");
        }
    }
}

#[test]
fn damage_of_one_group_leaves_the_others_readable() {
    let (all, _) = read_log(PYTHON_CAN);
    let mut bytes = PYTHON_CAN.to_vec();
    // asammdf writes the groups of data, error and remote frames in this order.
    let first = blocks(PYTHON_CAN, "DZ")[0];
    bytes[first + 48..first + 60].fill(0x5A);
    let (frames, summary) = read_log(&bytes);
    assert!(summary.damage.is_some() && frames.len() < all.len(), "{summary}");
    assert_eq!(
        frames.len(),
        all.len() - all.iter().filter(|frame| frame.kind == descan::frame::FrameKind::Data).count(),
        "{summary}"
    );
}

#[test]
fn groups_behind_a_damaged_one_are_read() {
    let (all, _) = read_log(PYTHON_CAN);
    // The blocks of the first group of records, its channels, and the links from the one to the other.
    let group = blocks(PYTHON_CAN, "CG")[0];
    for at in [group + 2, group + 24 + 8 + 7, blocks(PYTHON_CAN, "CN")[0] + 2] {
        let mut bytes = PYTHON_CAN.to_vec();
        bytes[at] ^= 0x55;
        let (frames, summary) = read_log(&bytes);
        assert!(!frames.is_empty() && frames.len() < all.len(), "byte {at}: {summary}");
        assert!(summary.to_string().contains("damaged block"), "byte {at}: {summary}");
    }
}

#[test]
fn lists_in_a_loop_end_the_log() {
    // The first two lists are of the signal data, of which nothing is missing.
    for (kind, number) in [("DL", 2), ("DG", 0), ("CG", 0), ("CN", 0)] {
        let at = blocks(SIGNAL_DATA, kind)[number];
        // The next one is itself, and more records should follow.
        let mut bytes = with_count(SIGNAL_DATA, 0, 21);
        bytes[at + 24..at + 32].copy_from_slice(&(at as u64).to_le_bytes());
        let (frames, summary) = read_log(&bytes);
        assert!(frames.len() <= 20, "{kind}");
        assert!(summary.to_string().contains("damaged block"), "{kind}: {summary}");
    }
}

/// Heads of lists that lie in each other's links: each has many, and the next one is the first of them.
#[test]
fn lists_within_lists_are_damage() {
    let list = blocks(SIGNAL_DATA, "DL")[2];
    let mut bytes = SIGNAL_DATA.to_vec();
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    let (start, count, links) = (bytes.len(), 200, 60_000_u64);
    // The first data block of the list that was there is the first of these.
    bytes[list + 32..list + 40].copy_from_slice(&(start as u64).to_le_bytes());
    for number in 1..=count {
        let next = (start + 40 * number) as u64;
        bytes.extend(b"##DL\0\0\0\0");
        bytes.extend((24 + 8 * links).to_le_bytes());
        bytes.extend(links.to_le_bytes());
        bytes.extend(1_u64.to_le_bytes());
        bytes.extend(next.to_le_bytes());
    }
    bytes.resize(bytes.len() + 8 * links as usize, 1);
    let (_, summary) = read_log(&bytes);
    let damaged = summary.to_string();
    // Of the first three, far from the last one.
    let at = damaged.split("byte ").nth(1).and_then(|it| it.split(')').next()?.parse().ok());
    let at: usize = at.unwrap_or_else(|| panic!("{damaged}"));
    assert!((start..start + 40 * 4).contains(&at), "{damaged}, the lists begin at {start}");
}

#[test]
fn measurement_without_frames_says_what_it_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = SIGNAL_DATA.to_vec();
    let name = blocks(&bytes, "TX");
    for at in name {
        if bytes[at + 24..].starts_with(b"CAN_DataFrame") {
            bytes[at + 24] = b'X';
        }
    }
    fs::write(folder.path().join("signals.mf4"), &bytes).unwrap();
    fs::write(folder.path().join("old.mdf"), b"MDF     3.30    TGT 15.0").unwrap();
    for (log, cause) in [
        ("signals.mf4", "0 frames; the measurement has no frames as ASAM bus logging has them"),
        ("old.mdf", "an ASAM MDF log of version 3 or older; convert it with asammdf"),
    ] {
        let output = run_with_input(&["convert", log, "out.log"], folder.path(), b"");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{said}");
        assert!(said.contains(cause), "{said}");
    }
}

#[test]
fn measurements_are_read_from_files_and_pipes() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("log.mf4"), PACKED).unwrap();
    let convert = |from: &str, input: &[u8]| {
        let output =
            run_with_input(&["convert", from, "-", "--format", "candump"], folder.path(), input);
        assert_eq!(output.status.code(), Some(0), "{from}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let plain = convert("log.mf4", b"");
    assert_eq!(plain.lines().count(), 20);
    assert!(plain.contains(SIXTH), "{plain}");
    assert_eq!(convert("-", UNSORTED), plain);
    let output = run_with_input(&["log", "log.mf4", "--json"], folder.path(), b"");
    assert_eq!(text(&output.stdout).lines().count(), 20, "{}", text(&output.stderr));
}

/// The files of this module in python-can: one line per frame.
const READER: &str = r#"
import sys
import can
for it in can.LogReader(sys.argv[1]):
    print(round(it.timestamp * 1e6), it.channel, f"{it.arbitration_id:X}", it.is_extended_id, it.is_fd, it.is_rx, bytes(it.data).hex().upper())
"#;

#[test]
fn hand_made_files_are_those_that_python_can_reads() {
    let Some(python) = Python::with(&["python-can==4.6.1", "asammdf==8.8.28"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let bus = with_virtual(UNSORTED, "CAN_DataFrame.BusChannel", 7.0, 0.0);
    let direction = with_virtual(SIGNAL_DATA, "CAN_DataFrame.Dir", 1.0, 0.0);
    for bytes in [UNSORTED, SIGNAL_DATA, PACKED, &bus, &direction] {
        let path = folder.path().join("log.mf4");
        fs::write(&path, bytes).unwrap();
        let theirs = python.run(READER, &[path.to_str().unwrap()], &[]);
        let (frames, summary) = read_log(bytes);
        let capital = |flag: bool| if flag { "True" } else { "False" };
        let line = |frame: &Frame| {
            let (id, is_extended) = match frame.id {
                CanId::Standard(id) => (u32::from(id), false),
                CanId::Extended(id) => (id, true),
            };
            let micros = summary.epoch.unwrap().unix_micros(frame.time);
            let bus = &summary.interfaces[usize::from(frame.bus.0)][3..];
            let data = descan::text::hex(frame.data(), "");
            let flags = [is_extended, frame.is_fd, !frame.is_tx].map(capital).join(" ");
            format!("{micros} {bus} {id:X} {flags} {data}").trim_end().to_owned()
        };
        let own: Vec<String> = frames.iter().map(line).collect();
        let theirs: Vec<&str> = theirs.lines().map(str::trim_end).collect();
        assert_eq!(own, theirs);
    }
}

#[test]
fn cut_log_is_said_wherever_it_is_cut() {
    let (whole, _) = read_log(PYTHON_CAN);
    let mut cut_short = 0;
    for end in 64..PYTHON_CAN.len() {
        let (frames, summary) = read_log(&PYTHON_CAN[..end]);
        assert!(frames.len() == whole.len() || summary.lost_entries() > 0, "cut at byte {end}");
        cut_short += usize::from(!frames.is_empty() && frames.len() < whole.len());
    }
    assert!(cut_short > 0, "records are cut too");
}

/// So many measurements in one file: their groups one behind another.
fn repeated(bytes: &[u8], count: usize) -> Vec<u8> {
    const HEAD_LEN: usize = 64;
    const GROUP_LINKS: usize = 24;
    let rest_len = bytes.len().next_multiple_of(8) - HEAD_LEN;
    let starts: Vec<usize> = (HEAD_LEN..bytes.len() - 4)
        .filter(|at| {
            at % 8 == 0 && bytes[*at..].starts_with(b"##") && bytes[at + 2].is_ascii_uppercase()
        })
        .collect();
    let group = blocks(bytes, "DG")[0];
    let mut all = bytes[..HEAD_LEN].to_vec();
    for number in 0..count {
        let shift = (number * rest_len) as u64;
        let mut copy = bytes.to_vec();
        copy.resize(HEAD_LEN + rest_len, 0);
        for start in &starts {
            let count = u64::from_le_bytes(copy[start + 16..start + 24].try_into().unwrap());
            for link in 0..count as usize {
                let at = start + 24 + 8 * link;
                let address = u64::from_le_bytes(copy[at..at + 8].try_into().unwrap());
                if address != 0 {
                    copy[at..at + 8].copy_from_slice(&(address + shift).to_le_bytes());
                }
            }
        }
        if number + 1 < count {
            let next = group as u64 + shift + rest_len as u64;
            copy[group + GROUP_LINKS..][..8].copy_from_slice(&next.to_le_bytes());
        }
        all.extend_from_slice(&copy[HEAD_LEN..]);
    }
    all
}

#[test]
fn groups_behind_the_limit_are_said() {
    let (frames, summary) = read_log(&repeated(SIGNAL_DATA, 64));
    assert_eq!((frames.len(), summary.lost_entries()), (64 * 20, 0), "{summary}");
    let (frames, summary) = read_log(&repeated(SIGNAL_DATA, 65));
    assert_eq!(frames.len(), 64 * 20);
    assert!(summary.to_string().contains("over 64 groups of frames"), "{summary}");
}
