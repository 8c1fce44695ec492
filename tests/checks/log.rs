//! Logs: an input is a file. The targets differ in their inputs only: the format is detected.

use super::protocol::check_shape;
use super::{Target, assert_printable};
use descan::frame::Frame;
use descan::log::candump::parse_line;
use descan::log::{FORMATS, LogEntry, LogFormat, LogReader, LogSummary};
use descan::time::{Epoch, Instant};
use std::io::{self, BufRead, Read};

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

fn check(input: &[u8]) {
    let (frames, summary) = read(input, usize::MAX);
    for size in [1, 7] {
        assert_eq!(read(input, size), (frames.clone(), summary.clone()), "pieces of {size}");
    }
    assert_eq!(read_growing(input), (frames.clone(), summary.clone()), "a log that grows");

    assert_printable(&summary.to_string());
    assert_printable(&summary.unreadable_entries().to_string());
    summary.interfaces.iter().for_each(|name| assert_printable(name));
    assert_eq!(summary.frames, frames.len() as u64);
    assert!(summary.entries <= input.len() as u64 && summary.frames <= summary.entries);
    let mut last = Instant::ZERO;
    for frame in &frames {
        check_shape(frame);
        assert!((last..=Instant::LATEST).contains(&frame.time), "{frame:?} after {last}");
        assert!(usize::from(frame.bus.0) < summary.interfaces.len(), "{frame:?}");
        last = frame.time;
    }
    for format in &FORMATS {
        check_written(format, &frames, &summary);
    }
}

/// Asserts that a log is the same when it is written in this format and read again.
fn check_written(format: &LogFormat, frames: &[Frame], summary: &LogSummary) {
    let Some(epoch) = summary.epoch else { return };
    let mut encoder = format.encoder();
    let mut log = Vec::new();
    encoder.begin(&mut log).unwrap();
    for frame in frames {
        let interface = &summary.interfaces[usize::from(frame.bus.0)];
        let entry =
            LogEntry { unix_micros: epoch.unix_micros(frame.time), interface, frame: *frame };
        assert!(encoder.write(entry, u64::MAX, &mut log).unwrap(), "{frame:?}");
    }
    encoder.end(&summary.interfaces, &vec![0; summary.interfaces.len()], &mut log).unwrap();

    let (again, read) = read(&log, usize::MAX);
    assert_eq!((read.lost_entries(), read.clock_steps_back), (0, 0), "{read}");
    assert_eq!(read.epoch.map(unix_micros), Some(unix_micros(epoch)));
    assert_eq!(again.len(), frames.len());
    // Other names are changed when they are written, and may then be equal.
    let is_plain =
        |name: &String| !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_alphanumeric());
    let keeps_names = summary.interfaces.iter().all(|name| is_plain(name) && name.len() <= 16);
    if keeps_names {
        assert_eq!(read.interfaces, summary.interfaces);
    }
    for (again, frame) in again.iter().zip(frames) {
        // A time after the largest Unix time is written as that.
        let time = epoch.unix_micros(frame.time) - unix_micros(epoch);
        let bus = if keeps_names { frame.bus } else { again.bus };
        assert_eq!(*again, frame.with_time(Instant::from_micros(time)).with_bus(bus));
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
                assert_eq!(parse_line(printed.as_bytes()), Ok(Some(entry)), "{printed}");
            }
            Ok(None) => assert!(line.trim_ascii().is_empty()),
            Err(fault) => assert_printable(&fault.to_string()),
        }
    }
}
