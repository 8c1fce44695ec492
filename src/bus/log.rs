//! Reading a log as fast as possible, by its own clock: candump's text, or pcapng, told apart by
//! how it begins.
//!
//! Lines and packets that cannot be read are counted, never an error: a log is evidence, and half of
//! it is better than none. Where a pcapng file is damaged, what stands before counts. Knows nothing of the session's clock: replaying is `bus::replay`.
//!
//! Lines a little out of order are taken in the order in which they stand. Where the clock was
//! set back, or a second log follows in the same file, time goes on from the last moment: what
//! is dated before stays as it is written, what is dated after is late by as much as the clock
//! was set back.

use super::candump::{LineFault, LogLine, MAX_LINE, parse_line};
use super::pcapng::{self, Damage, PacketFault, Sections};
use crate::frame::{BusIndex, Frame};
use crate::time::{Duration, Epoch, Instant};
use std::fmt;
use std::io::{self, BufRead, BufReader, Read};

/// Lines that are so much out of order count as of the moment of the one before; beyond it, the
/// clock was set back.
const MAX_REORDER: Duration = Duration::from_secs(1);
/// A gap after which a clock that was set back may be back at its earlier time.
const GAP: Duration = Duration::from_secs(10);

/// The frames of a log. The first is at the start. Times never run backwards: up to a second
/// they stand still, and where the log goes back by more, they go on from there. Both are
/// counted.
#[derive(Debug)]
pub struct LogReader<R> {
    source: R,
    format: LogFormat,
    /// A last line without an end is not read yet.
    keeps_unfinished: bool,
    /// A line or block that was cut by the end of the source's buffer, as far as it is here.
    partial: Vec<u8>,
    tally: LogSummary,
}

/// What kind of log it is.
#[derive(Debug)]
enum LogFormat {
    /// What is read so far, kept as partial, is how pcapng begins.
    Unknown,
    Text,
    Pcapng {
        sections: Sections,
        /// Bytes of a block that is too long to be read.
        skip: u64,
    },
}

/// Why an entry of a log cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum EntryFault {
    /// A line of text.
    #[error(transparent)]
    Line(#[from] LineFault),
    /// A packet of a pcapng file.
    #[error(transparent)]
    Packet(#[from] PacketFault),
    /// More interface names than there are bus numbers.
    #[error("more than 256 interface names in one log")]
    TooManyInterfaces,
}

/// What was read so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogSummary {
    /// It is pcapng: what is counted as lines are blocks.
    pub is_pcapng: bool,
    /// Lines, readable or not.
    pub lines: u64,
    /// Frames.
    pub frames: u64,
    /// Lines that could not be read.
    pub unreadable: u64,
    /// The first of them: its number, counted from 1, and what is wrong with it.
    pub first_unreadable: Option<(u64, EntryFault)>,
    /// Why nothing more can be read although there may be more.
    pub damage: Option<Damage>,
    /// Frames dated earlier than the one before them: those that are clamped, and each step back
    /// of the clock once.
    pub backwards: u64,
    /// The interfaces by order of appearance: the names of bus 0, 1, ….
    pub interfaces: Vec<String>,
    /// The time of the first frame.
    pub epoch: Option<Epoch>,
    /// The moment of the last frame.
    pub last: Instant,
    /// What is added to the times as they are written, because the clock was set back.
    ahead: Duration,
    /// What was added before the clock was set the last time. It may be set to and fro, and two
    /// interfaces may each have a clock of their own.
    ahead_before: Duration,
}

impl<R: BufRead> LogReader<R> {
    /// Begins at the first line.
    pub fn new(source: R) -> Self {
        Self {
            source,
            format: LogFormat::Unknown,
            keeps_unfinished: false,
            partial: Vec::new(),
            tally: LogSummary::default(),
        }
    }

    /// From now on a last line without an end is kept, for it may be in the middle of being
    /// written: at the end of the source, try again later.
    pub fn keep_unfinished(&mut self) {
        self.keeps_unfinished = true;
    }

    /// Whether the last line has no end, or the last block is cut.
    pub fn has_unfinished(&self) -> bool {
        !self.partial.is_empty()
    }

    /// Takes the last line as it is, though it has no end.
    pub fn take_unfinished(&mut self) -> Option<Frame> {
        if !matches!(self.format, LogFormat::Text) || self.partial.is_empty() {
            return None;
        }
        let frame = self.tally.take(&self.partial);
        self.partial.clear();
        frame
    }

    /// Whether the rest cannot be read, even if there is more of it.
    pub fn is_damaged(&self) -> bool {
        self.tally.damage.is_some_and(|damage| damage != Damage::Cut)
    }

    /// Where it reads from.
    pub fn source(&self) -> &R {
        &self.source
    }

    /// The same, to have it read from elsewhere.
    pub fn source_mut(&mut self) -> &mut R {
        &mut self.source
    }

    /// What was read so far.
    pub fn tally(&self) -> &LogSummary {
        &self.tally
    }

    /// The next frame; `None` at the end.
    pub fn next_frame(&mut self) -> io::Result<Option<Frame>> {
        loop {
            match self.step()? {
                ReadStep::End => return Ok(None),
                ReadStep::Frame(frame) => return Ok(Some(frame)),
                ReadStep::Nothing => {}
            }
        }
    }

    /// Reads to the end of a line or block, or of the source's buffer.
    fn step(&mut self) -> io::Result<ReadStep> {
        let buffer = match self.source.fill_buf() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                return Ok(ReadStep::Nothing);
            }
            buffer => buffer?,
        };
        let (used, step) = match &mut self.format {
            LogFormat::Unknown => {
                let matched = self.partial.len();
                match buffer.first() {
                    None if matched == 0 => (0, ReadStep::End),
                    Some(&byte) if byte == pcapng::MAGIC[matched] => {
                        self.partial.push(byte);
                        if matched + 1 == pcapng::MAGIC.len() {
                            self.tally.is_pcapng = true;
                            self.format =
                                LogFormat::Pcapng { sections: Sections::default(), skip: 0 };
                        }
                        (1, ReadStep::Nothing)
                    }
                    _ => {
                        self.format = LogFormat::Text;
                        if matched > 0 {
                            // That was a blank line, and perhaps what the next begins with.
                            self.partial.remove(0);
                            self.tally.take(b"");
                        }
                        (0, ReadStep::Nothing)
                    }
                }
            }
            LogFormat::Text if buffer.is_empty() && self.keeps_unfinished => (0, ReadStep::End),
            LogFormat::Text => read_line(buffer, &mut self.partial, &mut self.tally),
            LogFormat::Pcapng { sections, skip } => {
                read_block(buffer, (sections, skip), &mut self.partial, &mut self.tally)
            }
        };
        self.source.consume(used);
        Ok(step)
    }
}

/// Reads to the end of a line or of the buffer; says how much of it that is.
fn read_line(buffer: &[u8], partial: &mut Vec<u8>, tally: &mut LogSummary) -> (usize, ReadStep) {
    let (read, is_at_end) = (buffer.len(), buffer.is_empty());
    let line_end = buffer.iter().position(|&byte| byte == b'\n');
    let piece = &buffer[..line_end.unwrap_or(read)];
    let frame = match line_end {
        _ if is_at_end && partial.is_empty() => return (0, ReadStep::End),
        Some(_) if partial.is_empty() => tally.take(piece),
        None if !is_at_end => {
            keep(partial, piece);
            None
        }
        _ => {
            keep(partial, piece);
            let frame = tally.take(partial);
            partial.clear();
            frame
        }
    };
    (line_end.map_or(read, |end| end + 1), frame.map_or(ReadStep::Nothing, ReadStep::Frame))
}

/// Reads to the end of a block or of the buffer; says how much of it that is.
fn read_block(
    buffer: &[u8],
    (sections, skip): (&mut Sections, &mut u64),
    partial: &mut Vec<u8>,
    tally: &mut LogSummary,
) -> (usize, ReadStep) {
    if tally.damage.is_some_and(|damage| damage != Damage::Cut) {
        return (0, ReadStep::End);
    }
    if buffer.is_empty() {
        tally.damage = (*skip > 0 || !partial.is_empty()).then_some(Damage::Cut);
        return (0, ReadStep::End);
    }
    // More came than there was.
    tally.damage = None;
    if *skip > 0 {
        let skipped = buffer.len().min(usize::try_from(*skip).unwrap_or(usize::MAX));
        *skip -= skipped as u64;
        return (skipped, ReadStep::Nothing);
    }
    let mut used = 0;
    let mut fill = |partial: &mut Vec<u8>, wanted: usize| {
        let piece = &buffer[used..];
        let piece = &piece[..piece.len().min(wanted.saturating_sub(partial.len()))];
        partial.extend_from_slice(piece);
        used += piece.len();
        partial.len() >= wanted
    };
    let read = 'read: {
        if !fill(partial, pcapng::HEAD) {
            break 'read Ok(None);
        }
        let Some(head) = partial.first_chunk() else { break 'read Ok(None) };
        let len = match sections.block_len(head) {
            Ok(len) => len as usize,
            Err(damage) => break 'read Err(damage),
        };
        if len > pcapng::MAX_BLOCK {
            *skip = (len - partial.len()) as u64;
            tally.take_block(sections.skip(head).map(|()| None));
            partial.clear();
            break 'read Ok(None);
        }
        if !fill(partial, len) {
            break 'read Ok(None);
        }
        let taken = sections.take(partial).map(|block| tally.take_block(block));
        partial.clear();
        taken
    };
    match read {
        Ok(frame) => (used, frame.map_or(ReadStep::Nothing, ReadStep::Frame)),
        Err(damage) => {
            tally.damage = Some(damage);
            (used, ReadStep::End)
        }
    }
}

impl<R: Read> LogReader<BufReader<R>> {
    /// Another log goes on in the place of this one: what comes is the beginning of a file. What
    /// was read stays counted.
    pub fn restart(&mut self) {
        let left = self.source.buffer().len();
        self.source.consume(left);
        self.partial.clear();
        self.format = LogFormat::Unknown;
        (self.tally.is_pcapng, self.tally.damage) = (false, None);
    }

    /// The next frame whose line is here already; `None` where the source would have to be read.
    pub fn next_buffered(&mut self) -> Option<Frame> {
        while self.has_whole() {
            // What is buffered is not read again, so there is no error.
            match self.step() {
                Ok(ReadStep::Frame(frame)) => return Some(frame),
                Ok(ReadStep::Nothing) => {}
                Ok(ReadStep::End) | Err(_) => return None,
            }
        }
        None
    }

    /// Whether the rest of a line is buffered, or anything of a block: reading that does not
    /// wait, and less than a block is kept.
    fn has_whole(&self) -> bool {
        match self.format {
            LogFormat::Text => self.source.buffer().contains(&b'\n'),
            LogFormat::Unknown | LogFormat::Pcapng { .. } => !self.source.buffer().is_empty(),
        }
    }
}

/// What a step of reading came to.
enum ReadStep {
    End,
    Nothing,
    Frame(Frame),
}

/// Adds a piece to a cut line, no more than it takes to see that the line is too long.
fn keep(partial: &mut Vec<u8>, piece: &[u8]) {
    let room = (MAX_LINE + 1).saturating_sub(partial.len());
    partial.extend_from_slice(&piece[..piece.len().min(room)]);
}

impl<R: BufRead> Iterator for LogReader<R> {
    type Item = io::Result<Frame>;

    fn next(&mut self) -> Option<io::Result<Frame>> {
        self.next_frame().transpose()
    }
}

impl LogSummary {
    fn take(&mut self, line: &[u8]) -> Option<Frame> {
        // Some editors begin a file with a byte order mark.
        let mark = b"\xEF\xBB\xBF".as_slice();
        let line = line.strip_prefix(mark).filter(|_| self.lines == 0).unwrap_or(line);
        self.take_read(parse_line(line).map_err(EntryFault::from))
    }

    fn take_block(&mut self, block: Result<Option<LogLine<'_>>, PacketFault>) -> Option<Frame> {
        self.take_read(block.map_err(EntryFault::from))
    }

    fn take_read(&mut self, line: Result<Option<LogLine<'_>>, EntryFault>) -> Option<Frame> {
        self.lines += 1;
        let read = line.and_then(|line| line.map(|line| self.place(line)).transpose());
        read.unwrap_or_else(|fault| {
            self.unreadable += 1;
            self.first_unreadable.get_or_insert((self.lines, fault));
            None
        })
    }

    fn place(&mut self, line: LogLine<'_>) -> Result<Frame, EntryFault> {
        let bus = self.bus_of(line.interface).ok_or(EntryFault::TooManyInterfaces)?;
        let epoch = *self.epoch.get_or_insert(Epoch::from_unix_micros(line.unix_micros));
        self.last = self.moment(epoch.since_start(line.unix_micros));
        self.frames += 1;
        Ok(line.frame.with_time(self.last).with_bus(bus))
    }

    /// The moment of a line dated `written` microseconds after the first one.
    fn moment(&mut self, written: i128) -> Instant {
        let micros = |duration: Duration| duration.as_micros().cast_signed();
        let last = i128::from(self.last.as_micros());
        let late = |ahead| written + micros(ahead) - last;
        let goes_on = |ahead| (-micros(MAX_REORDER)..=micros(GAP)).contains(&late(ahead));
        if !goes_on(self.ahead) && goes_on(self.ahead_before) {
            std::mem::swap(&mut self.ahead, &mut self.ahead_before);
        }
        let late_by = late(self.ahead);
        self.backwards += u64::from(late_by < 0);
        if late_by < -micros(MAX_REORDER) {
            let set_back = u64::try_from(-late_by).unwrap_or(u64::MAX);
            self.ahead_before = self.ahead;
            self.ahead = self.ahead.saturating_add(Duration::from_micros(set_back));
        }
        self.last + Duration::from_micros(u64::try_from(late_by).unwrap_or(0))
    }

    fn bus_of(&mut self, interface: &str) -> Option<BusIndex> {
        let known = self.interfaces.iter().position(|name| name == interface);
        let index = u8::try_from(known.unwrap_or(self.interfaces.len())).ok()?;
        if known.is_none() {
            self.interfaces.push(interface.to_owned());
        }
        Some(BusIndex(index))
    }
}

/// `5123 frames; 2 lines cannot be read, the first is line 17: …`.
impl fmt::Display for LogSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plural = |count| if count == 1 { "" } else { "s" };
        write!(f, "{} frame{}", self.frames, plural(self.frames))?;
        if self.interfaces.len() > 1 {
            write!(f, " of {} interfaces", self.interfaces.len())?;
        }
        let unit = if self.is_pcapng { "block" } else { "line" };
        match (self.first_unreadable, self.unreadable) {
            (None, _) => {}
            (Some((line, fault)), 1) => write!(f, "; {unit} {line} cannot be read: {fault}")?,
            (Some((line, fault)), count) => {
                write!(f, "; {count} {unit}s cannot be read, the first is {unit} {line}: {fault}")?;
            }
        }
        if let Some(damage) = self.damage {
            write!(f, "; {damage}")?;
        }
        match self.backwards {
            0 => Ok(()),
            count => write!(f, "; time goes backwards {count} time{}", plural(count)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::CanId;

    const LOG: &str = "\
(1436509052.249713) can0 02015402#04
(1436509052.249800) can1 123#R4

not a line
(1436509052.249000) can0 02015402#05 T\r
(1436509053.000000) can0 00000001#";

    fn read(text: &str, buffer: usize) -> (Vec<Frame>, LogSummary) {
        let mut reader = LogReader::new(BufReader::with_capacity(buffer, text.as_bytes()));
        let frames = reader.by_ref().collect::<io::Result<_>>().unwrap();
        (frames, reader.tally().clone())
    }

    #[test]
    fn reads_the_same_whatever_the_buffer() {
        let (frames, tally) = read(LOG, 4096);
        let micros: Vec<_> = frames.iter().map(|frame| frame.time.as_micros()).collect();
        assert_eq!(micros, [0, 87, 87, 750_287]);
        assert_eq!(frames.iter().map(|frame| frame.bus.0).collect::<Vec<_>>(), [0, 1, 0, 0]);
        assert!(frames[2].is_tx);
        assert_eq!(tally.interfaces, ["can0", "can1"]);
        assert_eq!(tally.epoch.unwrap().unix_micros(tally.last), 1_436_509_053_000_000);
        assert_eq!((tally.lines, tally.frames, tally.unreadable, tally.backwards), (6, 4, 1, 1));
        assert_eq!(tally.first_unreadable, Some((4, LineFault::Time.into())));
        for buffer in 1..60 {
            assert_eq!(read(LOG, buffer), (frames.clone(), tally.clone()));
        }
    }

    #[test]
    fn what_is_here_is_had_without_reading_on() {
        // A pipe that gives one piece per read, and nothing after them.
        struct Pieces(Vec<&'static str>);
        impl Read for Pieces {
            fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
                let piece = self.0.pop().expect("it is not read on").as_bytes();
                buffer[..piece.len()].copy_from_slice(piece);
                Ok(piece.len())
            }
        }
        let pieces = vec!["0 125#\n", "(0.1) can0 123#\n\n?\n(0.2) can0 124#\n\n(0.3) can"];
        let mut reader = LogReader::new(BufReader::new(Pieces(pieces)));
        assert_eq!(reader.next_frame().unwrap().unwrap().id, CanId::Standard(0x123));
        assert_eq!(reader.next_buffered().unwrap().id, CanId::Standard(0x124));
        assert_eq!(reader.next_buffered(), None);
        assert_eq!(reader.next_frame().unwrap().unwrap().id, CanId::Standard(0x125));
        assert_eq!(reader.next_buffered(), None);
    }

    /// The moments of lines with these times, in milliseconds, and how many ran backwards.
    fn moments(written: &[u64]) -> (Vec<u64>, u64) {
        let line = |&millis: &u64| format!("({}.{:03}) can0 123#\n", millis / 1000, millis % 1000);
        let (frames, tally) = read(&written.iter().map(line).collect::<String>(), 4096);
        let moments = frames.iter().map(|frame| frame.time.as_micros() / 1000).collect();
        (moments, tally.backwards)
    }

    #[test]
    fn a_little_disorder_stands_still() {
        let (moments, backwards) = moments(&[5000, 6000, 5000, 5900, 6100]);
        assert_eq!((moments, backwards), (vec![0, 1000, 1000, 1000, 1100], 2));
    }

    #[test]
    fn a_clock_that_is_set_back_goes_on_from_the_last_moment() {
        let hour = 3_600_000;
        let told = moments(&[hour + 5000, hour + 6000, 5999, 6999, 6899, 60_999, 61_999]);
        assert_eq!(told, (vec![0, 1000, 1000, 2000, 2000, 56_000, 57_000], 2));
        // Before the first line, and again, and by little more than a second.
        let told = moments(&[9000, 10_000, 0, 1000, 0, 1000, 2000, 998, 2998]);
        assert_eq!(told, (vec![0, 1000, 1000, 2000, 2000, 2000, 3000, 3000, 5000], 3));
    }

    #[test]
    fn a_clock_that_is_set_to_and_fro_makes_no_gaps() {
        // One stray line; then two interfaces, each with a clock of its own.
        let told = moments(&[100_000, 101_000, 3, 102_000, 103_000]);
        assert_eq!(told, (vec![0, 1000, 1000, 2000, 3000], 1));
        let told = moments(&[7_000_000, 7_000_100, 300, 7_000_200, 400, 7_000_400, 450, 600]);
        assert_eq!(told, (vec![0, 100, 100, 200, 200, 400, 400, 400], 2));
        // One that is set forward is believed: nobody can tell it from silence.
        assert_eq!(moments(&[0, 1000, 8_000_000]), (vec![0, 1000, 8_000_000], 0));
    }

    #[test]
    fn times_beyond_measure_stay_in_order() {
        let text = "(18446744073709.551615) can0 123#\n(0.0) can0 123#\n".repeat(20);
        let (frames, _) = read(&text, 4096);
        assert!(frames.is_sorted_by_key(|frame| frame.time));
    }

    #[test]
    fn an_endless_line_is_one_unreadable_line() {
        let text = format!("{}\n(0.1) can0 123#", "x".repeat(1_000_000));
        for buffer in [64, 8192, 2_000_000] {
            let (frames, tally) = read(&text, buffer);
            assert_eq!(frames.len(), 1);
            assert_eq!(tally.first_unreadable, Some((1, LineFault::TooLong.into())));
        }
    }

    #[test]
    fn the_257th_interface_is_unreadable() {
        let lines: Vec<_> = (0..300).map(|n| format!("(0.1) bus{n} 123#")).collect();
        let (frames, tally) = read(&lines.join("\n"), 8192);
        assert_eq!((frames.len(), tally.unreadable), (256, 44));
        assert_eq!(tally.first_unreadable, Some((257, EntryFault::TooManyInterfaces)));
    }

    #[test]
    fn sums_up_in_words() {
        assert_eq!(
            read(LOG, 4096).1.to_string(),
            "4 frames of 2 interfaces; line 4 cannot be read: it does not begin with \
             (SECONDS.FRACTION); time goes backwards 1 time"
        );
    }
}
