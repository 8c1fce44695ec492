//! ASAM MDF 4 with the frames of a bus: what is read, and from damaged files.

use crate::common::program::{run_with_input, text};
use crate::common::python::Python;
use crate::common::read_log::read_log;
use descan::frame::Frame;
use std::fs;

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
fn lists_in_a_loop_end_the_log() {
    // The first two lists are of the signal data, of which nothing is missing.
    for (kind, number) in [("DL", 2), ("DG", 0), ("CG", 0), ("CN", 0)] {
        let at = blocks(SIGNAL_DATA, kind)[number];
        let mut bytes = SIGNAL_DATA.to_vec();
        // The next one is itself.
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
    for bytes in [UNSORTED, SIGNAL_DATA, PACKED] {
        let path = folder.path().join("log.mf4");
        fs::write(&path, bytes).unwrap();
        let theirs = python.run(READER, &[path.to_str().unwrap()], &[]);
        let (frames, summary) = read_log(bytes);
        let capital = |flag: bool| if flag { "True" } else { "False" };
        let line = |frame: &Frame| {
            let (id, is_extended) = match frame.id {
                descan::frame::CanId::Standard(id) => (u32::from(id), false),
                descan::frame::CanId::Extended(id) => (id, true),
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
