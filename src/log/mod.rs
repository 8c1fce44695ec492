//! Log formats: bytes of a recorded log in, frames with their times out, and vice versa.
//!
//! A format is a file here. [`FORMATS`] defines what is written, with the errors and the help of
//! `--record`; what a log is that is read, its bytes say. [`LogReader`] reads from any
//! [`std::io::BufRead`], packed logs through [`Unpacked`]; a [`LogEncoder`] appends to a buffer. Opens no
//! files and reads no clock. Does not know buses.

mod asc;
mod binary;
mod blf;
mod bus_errors;
pub mod candump;
mod candump_screen;
mod candump_time;
mod channel;
mod controller;
mod csv;
mod damage;
mod dates;
mod entry_stream;
mod fields;
mod foreign;
mod frame_source;
mod local_clock;
mod log_time;
mod loss;
mod mdf;
mod mdf_blocks;
mod packet;
mod pcap;
pub mod pcapng;
mod plain_line;
mod random_access;
mod reader;
mod sqlite;
mod summary;
mod text;
mod trc;
mod unpack;

pub use damage::{Damage, MAX_WITHOUT_FRAME};
pub use fields::FieldFault;
pub use foreign::ForeignFormat;
pub use frame_source::FrameSource;
pub use log_time::LogTime;
pub use loss::LogLoss;
pub use random_access::{LogSpool, MakeSpool, RandomAccess};
pub use reader::{LogPosition, LogReader};
pub use summary::{
    ChangedFrames, DateDoubts, EntryFault, LogDoubts, LogSummary, UnreadChanges, UnreadableEntries,
};
pub use unpack::{Packing, Unpacked};

use crate::frame::Frame;
use binary::EntryDecoder;
use std::fmt;
use std::io;
use std::path::Path;

/// The formats that are written. The first two are for recording, too.
pub static FORMATS: [LogFormat; 6] = [
    LogFormat {
        name: "candump",
        description: "candump text",
        extensions: &["log", "txt", "candump"],
        can_record: true,
        encoder: || Box::<candump::LineEncoder>::default(),
    },
    LogFormat {
        name: "pcapng",
        description: "Wireshark",
        extensions: &["pcapng"],
        can_record: true,
        encoder: || Box::<pcapng::BlockEncoder>::default(),
    },
    LogFormat {
        name: "asc",
        description: "Vector ASC",
        extensions: &["asc"],
        can_record: false,
        encoder: || Box::new(asc::AscEncoder::new()),
    },
    LogFormat {
        name: "blf",
        description: "Vector BLF",
        extensions: &["blf"],
        can_record: false,
        encoder: || Box::new(blf::BlfEncoder::new()),
    },
    LogFormat {
        name: "trc",
        description: "PEAK TRC",
        extensions: &["trc"],
        can_record: false,
        encoder: || Box::new(trc::TrcEncoder::new()),
    },
    LogFormat {
        name: "csv",
        description: "SavvyCAN CSV",
        extensions: &["csv"],
        can_record: false,
        encoder: || Box::new(csv::GvretEncoder::new()),
    },
];

/// Binary contents that are read. Any other is text.
static CONTENTS: [LogContent; 5] = [
    LogContent {
        unit: "block",
        detect: |head| FormatMatch::of_magic(&pcapng::MAGIC, head),
        decoder: |_| Box::<EntryDecoder<pcapng::SectionState>>::default(),
    },
    LogContent {
        unit: "packet",
        detect: pcap::detect,
        decoder: |_| Box::<EntryDecoder<pcap::CaptureState>>::default(),
    },
    LogContent {
        unit: "object",
        detect: |head| FormatMatch::of_magic(blf::MAGIC, head),
        decoder: |_| Box::<EntryDecoder<blf::MeasurementState>>::default(),
    },
    LogContent {
        unit: "row",
        detect: |head| FormatMatch::of_magic(entry_stream::ROWS_MAGIC, head),
        decoder: |_| Box::<EntryDecoder<entry_stream::EntryStreamState>>::default(),
    },
    LogContent {
        unit: "record",
        detect: |head| FormatMatch::of_magic(entry_stream::RECORDS_MAGIC, head),
        decoder: |_| Box::<EntryDecoder<entry_stream::EntryStreamState>>::default(),
    },
];

/// Lines of text, in any of the text formats.
static TEXT: LogContent = LogContent {
    unit: "line",
    detect: |_| FormatMatch::No,
    decoder: |head| Box::new(text::TextDecoder::new(head)),
};

/// File name endings of logs that are read but not written, in lower case.
const READ_EXTENSIONS: &[&str] = &["pcap", "db", "sqlite", "sqlite3", "mf4"];

/// Endings of compressed logs.
const PACKED_EXTENSIONS: &[&str] = &["gz", "zst", "xz"];

/// The way out where nothing of a log can be read.
pub const READABLE_LOGS: &str =
    "use candump, pcapng, ASC, BLF, TRC, CSV, SQLite or MF4 (descan help logs)";

/// A log format that is written: one row of [`FORMATS`].
#[derive(Debug)]
pub struct LogFormat {
    /// Name of the format on the command line.
    pub name: &'static str,
    /// Use of the format, as in "`.log` for candump text".
    pub description: &'static str,
    /// File name endings without the dot, in lower case; the usual one first.
    pub extensions: &'static [&'static str],
    /// A bus may be recorded in this format: a file that is cut off can be read.
    can_record: bool,
    encoder: fn() -> Box<dyn LogEncoder>,
}

/// What the bytes of a log are.
#[derive(Debug)]
struct LogContent {
    /// Unit of a log, as in "line 3 cannot be read".
    unit: &'static str,
    detect: fn(&[u8]) -> FormatMatch,
    /// Returns the decoder of a log with these first bytes.
    decoder: fn(&[u8]) -> Box<dyn LogDecoder>,
}

/// Result of matching the first bytes of a log with a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FormatMatch {
    Yes,
    No,
    /// More bytes are needed.
    Undecided,
}

/// A frame of a log, with its interface. Displayed as a line of candump's log text, without the
/// line end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogEntry<'a> {
    /// Its time.
    pub time: LogTime,
    /// The interface's name; empty if it is not known.
    pub interface: &'a str,
    /// The frame. Its time is zero if it was read from a log; `is_tx` is set if the log marks the
    /// frame as sent.
    pub frame: Frame,
}

/// Result of decoding a piece of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeStep {
    /// The end of the log, or the rest of it cannot be read.
    End,
    /// An entry without a frame, or a part of an entry.
    Nothing,
    /// A frame.
    Frame(Frame),
}

/// Reads one log of a format, in pieces of any size.
trait LogDecoder: fmt::Debug + Send {
    /// Reads from `bytes`, which are not empty, at most to the end of an entry. Returns how many
    /// bytes were used: at least one, except with [`DecodeStep::End`].
    fn decode(&mut self, bytes: &[u8], summary: &mut LogSummary) -> (usize, DecodeStep);

    /// Reads entries from `bytes` as [`Self::decode`] does, while each is a whole frame of the usual
    /// form, and appends them until there are `most`. Returns how many bytes were used; 0 if the next
    /// entry is another one.
    fn decode_frames(
        &mut self,
        _bytes: &[u8],
        _summary: &mut LogSummary,
        _frames: &mut Vec<Frame>,
        _most: usize,
    ) -> usize {
        0
    }

    /// Handles the end of the bytes available for now.
    fn handle_end(&mut self, _: &mut LogSummary) {}

    /// Returns true if the log stops inside an entry.
    fn has_partial_entry(&self) -> bool;

    /// Returns where an entry begins in the last bytes of a log; `None` if that is not known.
    fn entry_start(&self, tail: &[u8]) -> Option<usize>;

    /// Returns a copy, which reads the same bytes alike.
    fn copy(&self) -> Box<dyn LogDecoder>;

    /// Reads the entry inside which the log stops, if the format allows an entry without its end.
    fn read_partial_entry(&mut self, _: &mut LogSummary) -> Option<Frame> {
        None
    }

    /// Returns true if decoding `bytes` would do more than store them.
    fn can_decode(&self, bytes: &[u8]) -> bool {
        !bytes.is_empty()
    }
}

/// Writes one log of a format.
pub trait LogEncoder: fmt::Debug + Send {
    /// Appends the beginning of a log.
    ///
    /// # Errors
    ///
    /// Those of writing to `out`.
    fn begin(&mut self, out: &mut Vec<u8>) -> io::Result<()>;

    /// Appends an entry. Appends nothing and returns false if more than `max_len` bytes would be
    /// needed.
    ///
    /// # Errors
    ///
    /// Those of writing to `out`.
    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool>;

    /// Appends the end of a log. `names` and `lost` are by bus: the names, and the number of frames
    /// lost while this log was written.
    ///
    /// # Errors
    ///
    /// Those of writing to `out`.
    fn end(&mut self, names: &[String], lost: &[u64], out: &mut Vec<u8>) -> io::Result<()>;

    /// Returns the first bytes of a log with their final values, which replace those of
    /// [`Self::begin`] after the end; `None` if those are final.
    fn head(&self) -> Option<Vec<u8>> {
        None
    }

    /// Returns what the log does not hold of what was written so far.
    fn loss(&self) -> LogLoss {
        LogLoss::default()
    }
}

/// A file name whose ending is not of a log format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownFormat;

impl std::error::Error for UnknownFormat {}

/// Formats the cause: `use the ending .log (also .txt, .candump) for candump text, or …`.
impl fmt::Display for UnknownFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("use the ending ")?;
        for (at, format) in LogFormat::recorded().enumerate() {
            let [usual, others @ ..] = format.extensions else { continue };
            write!(f, "{}.{usual}", if at == 0 { "" } else { ", or " })?;
            for (at, other) in others.iter().enumerate() {
                write!(f, "{}.{other}", if at == 0 { " (also " } else { ", " })?;
            }
            write!(f, "{} for {}", if others.is_empty() { "" } else { ")" }, format.description)?;
        }
        Ok(())
    }
}

impl LogFormat {
    /// Returns the format in which a file is recorded, by its ending.
    ///
    /// # Errors
    ///
    /// The file has no ending, or one that is not of such a format.
    pub fn of(path: &Path) -> Result<&'static Self, UnknownFormat> {
        Self::of_written(path).filter(|format| format.can_record).ok_or(UnknownFormat)
    }

    /// Returns the format in which a file is written, by its ending; `None` if it has none of a format.
    pub fn of_written(path: &Path) -> Option<&'static Self> {
        let ending = ending_of(path);
        FORMATS.iter().find(|it| it.extensions.contains(&ending.as_str()))
    }

    /// Returns true if a file has the ending of a compressed log.
    pub fn has_packed_ending(path: &Path) -> bool {
        PACKED_EXTENSIONS.contains(&ending_of(path).as_str())
    }

    /// Returns true if a file has the ending of a log: of a format that is read, or of another one,
    /// whose logs are refused with the way to convert them.
    pub fn has_log_ending(path: &Path) -> bool {
        let ending = ending_of(path);
        Self::of_written(path).is_some()
            || READ_EXTENSIONS.contains(&ending.as_str())
            || Self::has_packed_ending(path)
            || ForeignFormat::has_extension(&ending)
    }

    /// The formats in which buses are recorded.
    fn recorded() -> impl Iterator<Item = &'static Self> {
        FORMATS.iter().filter(|format| format.can_record)
    }

    /// Returns the usual endings for recording with their uses, for help: `.log for candump text,
    /// .pcapng for Wireshark`.
    pub fn summary() -> String {
        let rows = Self::recorded().filter_map(|format| {
            Some(format!(".{} for {}", format.extensions.first()?, format.description))
        });
        rows.collect::<Vec<_>>().join(", ")
    }

    /// Returns the usual ending of each format for recording: `.log or .pcapng`.
    pub fn usual_endings() -> String {
        let extensions =
            Self::recorded().filter_map(|it| Some(format!(".{}", it.extensions.first()?)));
        extensions.collect::<Vec<_>>().join(" or ")
    }

    /// Returns a new encoder of this format.
    pub fn encoder(&self) -> Box<dyn LogEncoder> {
        (self.encoder)()
    }
}

impl LogContent {
    /// Returns the content of a log that begins with `head`, or the format that is not read; `None` if
    /// more bytes are needed. With `is_all`, there are no more.
    fn detect(head: &[u8], is_all: bool) -> Option<Result<&'static Self, ForeignFormat>> {
        let found = CONTENTS.iter().map(|content| (content, (content.detect)(head)));
        let (foreign, is_foreign) = ForeignFormat::of_head(head);
        let mut is_undecided = is_foreign == FormatMatch::Undecided;
        for (content, matches) in found {
            match matches {
                FormatMatch::Yes => return Some(Ok(content)),
                FormatMatch::Undecided => is_undecided = true,
                FormatMatch::No => {}
            }
        }
        match foreign {
            Some(foreign) => Some(Err(foreign)),
            None if !is_all && (is_undecided || text::needs_more(head)) => None,
            None => Some(Ok(&TEXT)),
        }
    }
}

/// Returns the ending of a file name in lower case, without the dot; empty without one.
fn ending_of(path: &Path) -> String {
    let ending = path.extension().and_then(|it| it.to_str()).unwrap_or_default();
    ending.to_ascii_lowercase()
}

impl FormatMatch {
    /// Matches `head` with a format whose logs begin with `magic`.
    fn of_magic(magic: &[u8], head: &[u8]) -> Self {
        let len = magic.len().min(head.len());
        match magic[..len] == head[..len] {
            true if len == magic.len() => FormatMatch::Yes,
            true => FormatMatch::Undecided,
            false => FormatMatch::No,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_follows_the_ending() {
        let purpose = |path: &str| LogFormat::of(Path::new(path)).map(|format| format.description);
        assert_eq!(purpose("a/b.LOG"), Ok("candump text"));
        assert_eq!(purpose("b.pcapng"), Ok("Wireshark"));
        for wrong in ["b", "b.pcap", ".log", "b.log.gz", "b.asc"] {
            assert_eq!(purpose(wrong), Err(UnknownFormat), "{wrong}");
        }
    }

    #[test]
    fn texts_list_every_format() {
        assert_eq!(
            UnknownFormat.to_string(),
            "use the ending .log (also .txt, .candump) for candump text, or .pcapng for Wireshark"
        );
        assert_eq!(LogFormat::summary(), ".log for candump text, .pcapng for Wireshark");
    }

    #[test]
    fn detection_waits_for_enough_bytes() {
        let purpose = |head, is_all| {
            LogContent::detect(head, is_all).map(|found| found.map_or("foreign", |it| it.unit))
        };
        assert_eq!(purpose(b"LOG", false), None);
        assert_eq!(purpose(b"LOG", true), Some("line"));
        assert_eq!(purpose(b"LOGG", false), Some("object"));
        assert_eq!(purpose(b"PK\x03\x04", false), Some("foreign"));
        assert_eq!(purpose(b"\n\r\r", false), None);
        assert_eq!(purpose(b"\n\r\r", true), Some("line"));
        assert_eq!(purpose(b"\n\r\r\n", false), Some("block"));
        assert_eq!(purpose(b"(", false), None);
        assert_eq!(purpose(b"(1436", false), Some("line"));
        assert_eq!(purpose(b"(000.000000) can0 1#\n?\n", false), Some("line"));
        assert_eq!(purpose(b"(000.000000) can0 1#\n", false), None);
        assert_eq!(purpose(b"(000.000000) can0 1#\n", true), Some("line"));
    }
}
