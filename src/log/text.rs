//! Text logs: lines of any of the text formats.
//!
//! The format is known by the lines before the first frame, and may be preceded by other lines, such as
//! the greeting of a server. Does not know moments or bus numbers: [`super::LogSummary`] assigns them.

use super::asc::AscLines;
use super::candump::{self, CandumpLines, MAX_LINE};
use super::csv::{GvretLines, PythonCanLines};
use super::dates::{comes_twice, is_zone_unknown};
use super::trc::TrcLines;
use super::{
    Damage, DateDoubts, DecodeStep, EntryFault, ForeignFormat, LogDecoder, LogEntry, LogSummary,
    LogTime, MAX_WITHOUT_FRAME, plain_line,
};
use crate::frame::Frame;

/// Byte order mark, with which some editors begin a file.
pub(super) const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// A text format, with what its lines so far say about those that follow.
#[derive(Clone, Copy, Debug)]
enum TextFormat {
    Candump(CandumpLines),
    Asc(AscLines),
    Trc(TrcLines),
    Gvret(GvretLines),
    PythonCan,
}

impl TextFormat {
    /// Returns the format whose logs have such a line before their first frame.
    fn of_line(line: &[u8]) -> Option<Self> {
        AscLines::of_line(line)
            .map(Self::Asc)
            .or_else(|| TrcLines::of_line(line).map(Self::Trc))
            .or_else(|| GvretLines::of_header(line).map(Self::Gvret))
            .or_else(|| PythonCanLines::is_first_line(line).then_some(Self::PythonCan))
    }

    /// Returns true for the format of a log of which no other was found.
    fn is_candump(&self) -> bool {
        matches!(self, Self::Candump(_))
    }

    /// Returns true for the usual lines of candump's log text.
    fn is_usual_candump(&self) -> bool {
        matches!(self, Self::Candump(lines) if lines.is_usual())
    }

    /// Returns true if the lines have no times.
    fn is_timeless(&self) -> bool {
        matches!(self, Self::Candump(lines) if lines.is_timeless())
    }

    /// Returns the date without a time zone with which the log begins.
    fn start_date(&self) -> Option<LogTime> {
        match self {
            Self::Asc(lines) => Some(lines.start()),
            Self::Trc(lines) => lines.local_start(),
            _ => None,
        }
    }

    /// Returns what is doubtful of the local dates up to the line that was read, which has a frame.
    fn date_doubts(&self, summary: &LogSummary) -> DateDoubts {
        if let Self::Candump(lines) = self {
            return lines.clock().doubts();
        }
        if summary.own_frames() > 0 {
            return summary.dates;
        }
        let start = self.start_date();
        // Without a date, the log starts in 1970.
        let has_date = start.is_some_and(|start| start.micros > 0);
        DateDoubts {
            is_ambiguous: start.is_some_and(|start| comes_twice(start.micros)),
            is_zone_unknown: has_date && is_zone_unknown(),
            ..summary.dates
        }
    }

    /// Reads a line, without its end; `None` for one without a frame.
    fn read<'a>(&mut self, line: &'a [u8]) -> Result<Option<LogEntry<'a>>, EntryFault> {
        Ok(match self {
            Self::Candump(lines) => lines.read(line)?,
            Self::Asc(lines) => lines.read(line)?,
            Self::Trc(lines) => lines.read(line)?,
            Self::Gvret(lines) => lines.read(line)?,
            Self::PythonCan => PythonCanLines::read(line)?,
        })
    }
}

/// Splits text into lines and reads them.
#[derive(Clone, Debug)]
pub(super) struct TextDecoder {
    format: TextFormat,
    /// A line cut by the end of a piece; at most one byte longer than [`MAX_LINE`].
    partial: Vec<u8>,
    /// Bytes of a line that is too long and counted as unreadable; 0 in any other line.
    skipped: u64,
    /// Bytes before the first frame.
    before_frame: u64,
}

impl TextDecoder {
    /// Returns the decoder of a log that begins with `head`.
    pub fn new(head: &[u8]) -> Self {
        let format = TextFormat::Candump(CandumpLines::of_head(head));
        Self { format, partial: Vec::new(), skipped: 0, before_frame: 0 }
    }

    /// Appends a piece to a cut line, at most up to one byte more than [`MAX_LINE`].
    fn keep(&mut self, piece: &[u8]) {
        let room = (MAX_LINE + 1).saturating_sub(self.partial.len());
        self.partial.extend_from_slice(&piece[..piece.len().min(room)]);
    }

    /// Appends a piece without a line end; a line that is too long counts at once, as it may not end.
    fn keep_cut(&mut self, piece: &[u8], summary: &mut LogSummary) {
        self.keep(piece);
        if self.skipped == 0 && self.partial.len() > MAX_LINE {
            self.take_partial(summary);
            self.skipped = MAX_LINE as u64;
        }
        if self.skipped > 0 {
            self.skipped += piece.len() as u64;
        }
    }

    /// Notes damage if what was read is too much for a log.
    fn check_damage(&mut self, used: usize, summary: &mut LogSummary) {
        if summary.own_frames() == 0 {
            self.before_frame += used as u64;
        }
        let is_inside_line = self.skipped > 0;
        if is_inside_line && self.skipped + used as u64 >= MAX_WITHOUT_FRAME {
            summary.damage = Some(Damage::NoLineEnd);
        } else if !is_inside_line
            && summary.own_frames() == 0
            && self.before_frame >= MAX_WITHOUT_FRAME
        {
            summary.damage = Some(Damage::NoFrame);
        }
    }

    /// Reads the line that was kept, which stays.
    fn take_partial(&mut self, summary: &mut LogSummary) -> Option<Frame> {
        let line = std::mem::take(&mut self.partial);
        let frame = self.take_line(&line, summary);
        self.partial = line;
        frame
    }

    fn take_line(&mut self, line: &[u8], summary: &mut LogSummary) -> Option<Frame> {
        let is_first = summary.entries == 0;
        let line = line.strip_prefix(BYTE_ORDER_MARK).filter(|_| is_first).unwrap_or(line);
        let mut entry = self.format.read(line);
        if entry.is_err() && summary.own_frames() == 0 {
            if let Some(format) = TextFormat::of_line(line).filter(|_| self.format.is_candump()) {
                self.format = format;
                entry = self.format.read(line);
            } else {
                summary.foreign = ForeignFormat::of_line(line);
            }
        }
        if let Ok(Some(entry)) = &mut entry
            && self.format.is_timeless()
        {
            date_by_arrival(entry, summary);
            summary.is_timeless = true;
        }
        if matches!(entry, Ok(Some(_))) {
            summary.dates = self.format.date_doubts(summary);
        }
        summary.take(entry)
    }
}

impl LogDecoder for TextDecoder {
    fn decode(&mut self, bytes: &[u8], summary: &mut LogSummary) -> (usize, DecodeStep) {
        if summary.damage.is_some() {
            return (bytes.len(), DecodeStep::End);
        }
        // The log goes on behind what was its end.
        summary.ends_inside_entry = false;
        let end = memchr::memchr(b'\n', bytes);
        self.check_damage(end.map_or(bytes.len(), |end| end + 1), summary);
        if summary.damage.is_some() {
            self.partial.clear();
            self.skipped = 0;
            return (bytes.len(), DecodeStep::End);
        }
        let Some(end) = end else {
            self.keep_cut(bytes, summary);
            let is_over = summary.foreign.is_some();
            return (bytes.len(), if is_over { DecodeStep::End } else { DecodeStep::Nothing });
        };
        let frame = if self.partial.is_empty() {
            self.take_line(&bytes[..end], summary)
        } else if std::mem::take(&mut self.skipped) > 0 {
            self.partial.clear();
            None
        } else {
            self.keep(&bytes[..end]);
            let frame = self.take_partial(summary);
            self.partial.clear();
            frame
        };
        let step = match frame {
            Some(frame) => DecodeStep::Frame(frame),
            None if summary.foreign.is_some() => DecodeStep::End,
            None => DecodeStep::Nothing,
        };
        (end + 1, step)
    }

    fn decode_frames(
        &mut self,
        bytes: &[u8],
        summary: &mut LogSummary,
        frames: &mut Vec<Frame>,
        most: usize,
    ) -> usize {
        if !self.partial.is_empty() {
            return 0;
        }
        let mut used = 0;
        while self.format.is_usual_candump() {
            used += plain_frames(&bytes[used..], summary, frames, most);
            let next = most.min(frames.len() + 1);
            let other = self.other_frames(&bytes[used..], summary, frames, next);
            if other == 0 {
                return used;
            }
            used += other;
        }
        used + self.other_frames(&bytes[used..], summary, frames, most)
    }

    fn has_partial_entry(&self) -> bool {
        !self.partial.is_empty()
    }

    fn entry_start(&self, tail: &[u8]) -> Option<usize> {
        // The times count from entries before.
        let is_relative = match &self.format {
            TextFormat::Candump(lines) => !lines.has_fixed_times(),
            TextFormat::Asc(lines) => lines.is_relative(),
            TextFormat::Trc(_) | TextFormat::Gvret(_) | TextFormat::PythonCan => false,
        };
        if is_relative {
            return None;
        }
        memchr::memchr(b'\n', tail).map(|end| end + 1)
    }

    fn copy(&self) -> Box<dyn LogDecoder> {
        Box::new(self.clone())
    }

    fn read_partial_entry(&mut self, summary: &mut LogSummary) -> Option<Frame> {
        if self.partial.is_empty() {
            return None;
        }
        let is_counted = std::mem::take(&mut self.skipped) > 0;
        summary.ends_inside_entry = !self.partial.trim_ascii().is_empty();
        let frame = if is_counted { None } else { self.take_partial(summary) };
        self.partial.clear();
        frame
    }

    fn can_decode(&self, bytes: &[u8]) -> bool {
        bytes.contains(&b'\n')
    }
}

/// Gives the frame of a log without times that of its arrival.
fn date_by_arrival(entry: &mut LogEntry<'_>, summary: &LogSummary) {
    entry.time = LogTime::from_micros(summary.arrival);
    entry.frame.is_timeless = true;
}

/// Appends the frames of the usual lines of candump's log text that `bytes` begin with; returns how many
/// bytes were used.
fn plain_frames(
    bytes: &[u8],
    summary: &mut LogSummary,
    frames: &mut Vec<Frame>,
    most: usize,
) -> usize {
    let mut used = 0;
    while frames.len() < most
        && let Some(line) = plain_line::parse(&bytes[used..])
        && let Some(frame) = summary.take_plain(line.time, line.interface, &line.frame)
    {
        frames.push(frame);
        used += line.len;
    }
    used
}

impl TextDecoder {
    /// Appends the frames of the lines that `bytes` begin with, while each has one of a known interface
    /// and no other doubts of its date; returns how many bytes were used.
    fn other_frames(
        &mut self,
        bytes: &[u8],
        summary: &mut LogSummary,
        frames: &mut Vec<Frame>,
        most: usize,
    ) -> usize {
        let mut used = 0;
        while frames.len() < most
            && let Some(len) = memchr::memchr(b'\n', &bytes[used..])
        {
            let mut next = self.format;
            let line = &bytes[used..used + len];
            let Ok(Some(mut entry)) = next.read(line) else { break };
            if next.is_timeless() {
                date_by_arrival(&mut entry, summary);
            }
            if next.date_doubts(summary) != summary.dates {
                break;
            }
            let name = entry.interface.as_bytes();
            let Some(frame) = summary.take_plain(entry.time, name, &entry.frame) else {
                break;
            };
            frames.push(frame);
            self.format = next;
            used += len + 1;
        }
        used
    }
}

/// Returns true if more of the log must be known before its lines can be read.
pub(super) fn needs_more(head: &[u8]) -> bool {
    candump::has_undecided_times(head)
}
