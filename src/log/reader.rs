//! Log reader: detects the format of a log and reads its frames.
//!
//! Input: any [`BufRead`], in pieces of any size. Output: frames in the order of the log, with
//! moments that never decrease, and a [`LogSummary`]. Unreadable entries are counted; in a damaged
//! log, the frames before the damage are read. Does not know the session's clock: replay is in
//! `bus::replay`.

use super::{Damage, DecodeStep, LogContent, LogDecoder, LogSummary};
use crate::frame::Frame;
use crate::positioned_read::read_exact_at;
use crate::time::Instant;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};

/// Bytes of the end of a log in which its last frame is looked for.
const TAIL: usize = 1 << 16;

/// Reads the frames of a log. The first frame is at [`Instant::ZERO`](crate::time::Instant::ZERO).
/// A frame dated up to 1 s before its predecessor gets the same moment; after a larger step back,
/// time continues from the last frame. Both are counted in [`LogSummary::clock_steps_back`].
#[derive(Debug)]
pub struct LogReader<R> {
    source: R,
    /// First bytes of the log, stored until its format is known and they are decoded.
    head: Vec<u8>,
    /// Decoder of the format; `None` before the format is known.
    decoder: Option<Box<dyn LogDecoder>>,
    /// True if a last entry without its end is kept for later instead of being read.
    keeps_unfinished: bool,
    /// The clock for frames of a log without times.
    arrival: Option<fn() -> u64>,
    summary: LogSummary,
}

/// A place between two entries of a log, and all that is needed to read on from there.
#[derive(Debug)]
pub struct LogPosition {
    head: Vec<u8>,
    decoder: Option<Box<dyn LogDecoder>>,
    summary: LogSummary,
}

impl LogPosition {
    /// Number of frames before it.
    pub fn frames(&self) -> u64 {
        self.summary.frames
    }

    /// Moment of the last frame in the last bytes of this log, if its clock is not set back between;
    /// `None` if none is found there, or if its date comes twice and they do not show which one it is.
    ///
    /// # Errors
    ///
    /// Those of the file system.
    pub fn last_time_of(&self, log: &File) -> io::Result<Option<Instant>> {
        let size = log.metadata()?.len();
        let mut tail = vec![0; TAIL.min(usize::try_from(size).unwrap_or(TAIL))];
        let start = size - tail.len() as u64;
        read_exact_at(log, &mut tail, start)?;
        Ok(self.last_time_in(&tail))
    }

    fn last_time_in(&self, tail: &[u8]) -> Option<Instant> {
        let start = self.decoder.as_ref()?.entry_start(tail)?;
        let mut reader = LogReader::at(&tail[start..], self);
        // What cannot be read may stand between.
        let frames = reader.by_ref().take(tail.len()).filter_map(Result::ok);
        let last = frames.last().map(|frame| frame.time);
        last.filter(|_| !reader.summary.dates.is_ambiguous)
    }
}

impl<R: BufRead> LogReader<R> {
    /// Reads on from a position, whose bytes come next from `source`.
    pub fn at(source: R, position: &LogPosition) -> Self {
        Self {
            source,
            head: position.head.clone(),
            decoder: position.decoder.as_ref().map(|decoder| decoder.copy()),
            keeps_unfinished: false,
            arrival: None,
            summary: position.summary.clone(),
        }
    }

    /// Returns the position behind what was read.
    pub fn position(&self) -> LogPosition {
        LogPosition {
            head: self.head.clone(),
            decoder: self.decoder.as_ref().map(|decoder| decoder.copy()),
            summary: self.summary.clone(),
        }
    }

    /// Starts at the beginning of a log.
    pub fn new(source: R) -> Self {
        Self {
            source,
            head: Vec::new(),
            decoder: None,
            keeps_unfinished: false,
            arrival: None,
            summary: LogSummary::default(),
        }
    }

    /// Gives frames of a log without times the time at which they are read, in microseconds since 1970.
    pub fn date_arrivals(&mut self, clock: fn() -> u64) {
        self.arrival = Some(clock);
    }

    /// Keeps a last entry without its end from now on, because another program may still be writing
    /// it. At the end of the source, read again later.
    pub fn hold_partial_entry(&mut self) {
        self.keeps_unfinished = true;
    }

    /// Returns true if the log stops inside an entry.
    pub fn has_partial_entry(&self) -> bool {
        !self.head.is_empty() || self.decoder.as_ref().is_some_and(|it| it.has_partial_entry())
    }

    /// Reads the last entry although its end is missing; `None` if there is no such frame.
    pub fn read_partial_entry(&mut self) -> Option<Frame> {
        // The end of a packed log is missing: the entry is cut off.
        if self.summary.damage.is_some() {
            return None;
        }
        let whole = self.read_held_entry();
        whole.or_else(|| self.decoder.as_mut()?.read_partial_entry(&mut self.summary))
    }

    /// Reads the next whole entry of those that were held until the format is known, although nothing
    /// follows; `None` if there is no such frame.
    pub fn read_held_entry(&mut self) -> Option<Frame> {
        if self.decoder.is_none() && !self.head.is_empty() {
            // What is known is all that there is.
            self.take_content(true);
        }
        let decoder = self.decoder.as_mut()?;
        while !self.head.is_empty() {
            let (used, step) = decoder.decode(&self.head, &mut self.summary);
            self.head.drain(..used);
            self.summary.note_read(used);
            match step {
                DecodeStep::Frame(frame) => return Some(frame),
                DecodeStep::Nothing => {}
                DecodeStep::End => return None,
            }
        }
        None
    }

    /// Sets the decoder, if the first bytes of the log show its format; with `is_all`, there are no more.
    fn take_content(&mut self, is_all: bool) {
        match LogContent::detect(&self.head, is_all) {
            Some(Ok(content)) => {
                self.summary.unit = content.unit;
                self.decoder = Some((content.decoder)(&self.head));
            }
            Some(Err(foreign)) => self.summary.foreign = Some(foreign),
            None => {}
        }
    }

    /// Returns true if the rest cannot be read, even if the source grows.
    pub fn is_damaged(&self) -> bool {
        self.summary.foreign.is_some()
            || self.summary.damage.is_some_and(|damage| !damage.is_truncated())
    }

    /// Returns the source.
    pub fn source(&self) -> &R {
        &self.source
    }

    /// Returns the source, to replace the bytes to be read.
    pub fn source_mut(&mut self) -> &mut R {
        &mut self.source
    }

    /// Returns the summary of what was read so far.
    pub fn summary(&self) -> &LogSummary {
        &self.summary
    }

    /// Starts to count unreadable entries anew: the ones so far precede the part that is read.
    pub fn forget_unreadable(&mut self) {
        self.summary.forget_unreadable();
    }

    /// Returns the next frame; `None` at the end.
    ///
    /// # Errors
    ///
    /// Those of the source.
    pub fn next_frame(&mut self) -> io::Result<Option<Frame>> {
        loop {
            match self.step()? {
                DecodeStep::End => return Ok(None),
                DecodeStep::Frame(frame) => return Ok(Some(frame)),
                DecodeStep::Nothing => {}
            }
        }
    }

    /// Reads to the end of an entry, or of the source's buffer: for a caller that reports unreadable
    /// entries before the next frame.
    ///
    /// # Errors
    ///
    /// Those of the source.
    pub fn step(&mut self) -> io::Result<DecodeStep> {
        if self.summary.foreign.is_some() {
            return Ok(DecodeStep::End);
        }
        let Some(decoder) = &mut self.decoder else { return self.detect() };
        if !self.head.is_empty() {
            self.summary.note_arrival(self.arrival);
            let (used, step) = decoder.decode(&self.head, &mut self.summary);
            self.head.drain(..used);
            self.summary.note_read(used);
            return Ok(step);
        }
        let buffer = match self.source.fill_buf() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                return Ok(DecodeStep::Nothing);
            }
            // A packed log: see `Unpacked`.
            Err(error) if packed_damage(&error).is_some() => {
                // An entry may be cut off: it is not read.
                self.summary.damage = packed_damage(&error);
                self.summary.note_read(0);
                return Ok(DecodeStep::End);
            }
            buffer => buffer?,
        };
        if buffer.is_empty() {
            decoder.handle_end(&mut self.summary);
            self.summary.note_read(0);
            let frame = if self.keeps_unfinished {
                None
            } else {
                decoder.read_partial_entry(&mut self.summary)
            };
            return Ok(frame.map_or(DecodeStep::End, DecodeStep::Frame));
        }
        // Now that it is there: the source may have been waited for.
        self.summary.note_arrival(self.arrival);
        let (used, step) = decoder.decode(buffer, &mut self.summary);
        self.source.consume(used);
        self.summary.note_read(used);
        Ok(step)
    }

    /// Reads one more byte and tries to detect the format.
    fn detect(&mut self) -> io::Result<DecodeStep> {
        let byte = match self.source.fill_buf() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                return Ok(DecodeStep::Nothing);
            }
            Err(error) if packed_damage(&error).is_some() => {
                self.summary.damage = packed_damage(&error);
                None
            }
            buffer => buffer?.first().copied(),
        };
        // More of it may be written later.
        if byte.is_none() && (self.head.is_empty() || self.keeps_unfinished) {
            return Ok(DecodeStep::End);
        }
        self.head.extend(byte);
        self.source.consume(usize::from(byte.is_some()));
        self.take_content(byte.is_none());
        Ok(DecodeStep::Nothing)
    }
}

impl<R: Read> LogReader<BufReader<R>> {
    /// Reads another log that replaces this one, from its beginning. The summary continues.
    pub fn restart(&mut self, source: BufReader<R>) {
        self.source = source;
        self.head.clear();
        self.decoder = None;
        self.summary.begin_another_log();
    }

    /// Returns the next frame that is buffered as a whole; `None` if the source must be read.
    pub fn next_buffered(&mut self) -> Option<Frame> {
        while self.has_buffered() {
            // The source is not read, so there is no error.
            match self.step() {
                Ok(DecodeStep::Frame(frame)) => return Some(frame),
                Ok(DecodeStep::Nothing) => {}
                Ok(DecodeStep::End) | Err(_) => return None,
            }
        }
        None
    }

    /// Appends the next frames that are buffered as a whole, until there are `most`, or an entry
    /// follows that is another one than a frame of the usual form: [`Self::next_buffered`] reads that one.
    pub fn take_buffered(&mut self, frames: &mut Vec<Frame>, most: usize) {
        let Some(decoder) = &mut self.decoder else { return };
        if self.head.is_empty() && self.summary.foreign.is_none() {
            self.summary.note_arrival(self.arrival);
            let used = decoder.decode_frames(self.source.buffer(), &mut self.summary, frames, most);
            self.source.consume(used);
            self.summary.note_read(used);
        }
    }

    /// Returns true if a step makes progress without a read from the source.
    pub fn has_buffered(&self) -> bool {
        let buffer = self.source.buffer();
        match &self.decoder {
            None => !buffer.is_empty(),
            Some(decoder) => !self.head.is_empty() || decoder.can_decode(buffer),
        }
    }
}

/// Returns the damage of a packed log that an error of [`super::Unpacked`] says.
fn packed_damage(error: &io::Error) -> Option<Damage> {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => Some(Damage::Truncated),
        io::ErrorKind::InvalidData => Some(Damage::Compression),
        io::ErrorKind::OutOfMemory => Some(Damage::Window),
        io::ErrorKind::Unsupported => Some(Damage::Filter),
        _ => None,
    }
}

impl<R: BufRead> Iterator for LogReader<R> {
    type Item = io::Result<Frame>;

    fn next(&mut self) -> Option<io::Result<Frame>> {
        self.next_frame().transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::CanId;
    use crate::log::EntryFault;
    use crate::log::candump::LineFault;
    use crate::log::{LogEntry, LogTime, MAX_WITHOUT_FRAME};

    const LOG: &str = "\
(1436509052.249713) can0 02015402#04
(1436509052.249800) can1 123#R4

not a line
(1436509052.249000) can0 02015402#05 T\r
(1436509053.000000) can0 00000001#";

    fn read(text: &str, buffer: usize) -> (Vec<Frame>, LogSummary) {
        let mut reader = LogReader::new(BufReader::with_capacity(buffer, text.as_bytes()));
        let frames = reader.by_ref().collect::<io::Result<_>>().unwrap();
        (frames, reader.summary().clone())
    }

    #[test]
    fn end_of_log_shows_its_last_moment() {
        let entry = |micros: u64| LogEntry {
            time: LogTime::from_micros(1_436_509_052_000_000 + micros),
            interface: "can0",
            frame: Frame::classic(micros as u32, &[1, 2, 3]),
        };
        for format in super::super::FORMATS.iter().filter(|format| format.can_record) {
            let (mut encoder, mut log) = (format.encoder(), Vec::new());
            encoder.begin(&mut log).unwrap();
            for number in 0..1000 {
                encoder.write(entry(number * 7000), u64::MAX, &mut log).unwrap();
            }
            encoder.end(&[], &[], &mut log).unwrap();
            let mut reader = LogReader::new(&log[..]);
            reader.next_frame().unwrap();
            let tail = &log[log.len() - 1001..];
            let last = Instant::from_micros(999 * 7000);
            assert_eq!(reader.position().last_time_in(tail), Some(last), "{format:?}");
            assert_eq!(reader.position().last_time_in(&tail[..5]), None);
        }
    }

    #[test]
    fn result_is_independent_of_buffer_size() {
        let (frames, tally) = read(LOG, 4096);
        let micros: Vec<_> = frames.iter().map(|frame| frame.time.as_micros()).collect();
        assert_eq!(micros, [0, 87, 87, 750_287]);
        assert_eq!(frames.iter().map(|frame| frame.bus.0).collect::<Vec<_>>(), [0, 1, 0, 0]);
        assert!(frames[2].is_tx);
        assert_eq!(*tally.interfaces, ["can0", "can1"]);
        assert_eq!(tally.epoch.unwrap().unix_micros(tally.last), 1_436_509_053_000_000);
        assert_eq!(
            (tally.entries, tally.frames, tally.unreadable, tally.clock_steps_back),
            (6, 4, 1, 1)
        );
        assert_eq!(tally.first_unreadable, Some((4, LineFault::Time.into())));
        for buffer in 1..60 {
            assert_eq!(read(LOG, buffer), (frames.clone(), tally.clone()));
        }
    }

    #[test]
    fn frames_taken_together_are_as_those_taken_one_by_one() {
        let usual = "(1436509052.249713) can0 02015402#0444455301\n(1436509052.249714) can1 123#\n";
        let other = "(1436509052.2) can2 123##1AABB\n(1436509059.000000) can0 20000004#00 T\r\n";
        let set_back = "(1436500000.000000) can1 123#0011 R\n(1436500000.000001) can3 1#\n";
        let log = [usual, LOG, "\n", usual, other, usual, set_back, usual].concat().repeat(3);
        for buffer in [1, 7, 64, 200, 4096] {
            let (frames, summary) = read(&log, buffer);
            let mut reader = LogReader::new(BufReader::with_capacity(buffer, log.as_bytes()));
            let mut taken = Vec::new();
            while let Some(frame) = reader.next_frame().unwrap() {
                taken.push(frame);
                let most = taken.len() + 3;
                reader.take_buffered(&mut taken, most);
                assert!(taken.len() <= most);
            }
            assert_eq!((taken, reader.summary()), (frames, &summary), "{buffer}");
        }
    }

    #[test]
    fn buffered_frames_need_no_read() {
        // A pipe that returns one piece per read, then nothing.
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

    /// Returns the moments of lines with these times, in milliseconds, and the count of steps back.
    fn moments(written: &[u64]) -> (Vec<u64>, u64) {
        let line = |&millis: &u64| format!("({}.{:03}) can0 123#\n", millis / 1000, millis % 1000);
        let (frames, tally) = read(&written.iter().map(line).collect::<String>(), 4096);
        let moments = frames.iter().map(|frame| frame.time.as_micros() / 1000).collect();
        (moments, tally.clock_steps_back)
    }

    #[test]
    fn small_disorder_repeats_the_last_time() {
        let (moments, backwards) = moments(&[5000, 6000, 5000, 5900, 6100]);
        assert_eq!((moments, backwards), (vec![0, 1000, 1000, 1000, 1100], 2));
    }

    #[test]
    fn clock_set_back_continues_from_last_time() {
        let hour = 3_600_000;
        let told = moments(&[hour + 5000, hour + 6000, 5999, 6999, 6899, 60_999, 61_999]);
        assert_eq!(told, (vec![0, 1000, 1000, 2000, 2000, 56_000, 57_000], 2));
        // Before the first line; again; and by little more than 1 s.
        let told = moments(&[9000, 10_000, 0, 1000, 0, 1000, 2000, 998, 2998]);
        assert_eq!(told, (vec![0, 1000, 1000, 2000, 2000, 2000, 3000, 3000, 5000], 3));
    }

    #[test]
    fn clock_set_back_and_forth_makes_no_gaps() {
        // One stray line; then two interfaces with separate clocks.
        let told = moments(&[100_000, 101_000, 3, 102_000, 103_000]);
        assert_eq!(told, (vec![0, 1000, 1000, 2000, 3000], 1));
        let told = moments(&[7_000_000, 7_000_100, 300, 7_000_200, 400, 7_000_400, 450, 600]);
        assert_eq!(told, (vec![0, 100, 100, 200, 200, 400, 400, 400], 2));
        // A step forward is accepted: it looks the same as silence.
        assert_eq!(moments(&[0, 1000, 8_000_000]), (vec![0, 1000, 8_000_000], 0));
    }

    #[test]
    fn extreme_times_stay_in_order() {
        let text = "(18446744073709.551615) can0 123#\n(0.0) can0 123#\n".repeat(20);
        let (frames, _) = read(&text, 4096);
        assert!(frames.is_sorted_by_key(|frame| frame.time));
    }

    #[test]
    fn endless_line_is_one_unreadable_line() {
        let text = format!("{}\n(0.1) can0 123#", "x".repeat(1_000_000));
        for buffer in [64, 8192, 2_000_000] {
            let (frames, tally) = read(&text, buffer);
            assert_eq!(frames.len(), 1);
            assert_eq!(tally.first_unreadable, Some((1, LineFault::TooLong.into())));
        }
    }

    /// A log that gives the same bytes forever, and counts them.
    struct Endless<'b>(&'b [u8], u64);

    impl io::Read for Endless<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            for (to, from) in buffer.iter_mut().zip(self.0.iter().cycle()) {
                *to = *from;
            }
            self.1 += buffer.len() as u64;
            Ok(buffer.len())
        }
    }

    #[test]
    fn endless_input_without_frames_ends_with_its_cause() {
        for (bytes, cause) in [
            (&b"\0"[..], ["no line end in 16 MB", "line 1 cannot be read: the line is too long"]),
            (
                b"not a frame\n",
                ["no frame in the first 16 MB", "does not begin with (SECONDS.FRACTION)"],
            ),
        ] {
            let source =
                BufReader::with_capacity(65_536 / bytes.len() * bytes.len(), Endless(bytes, 0));
            let mut reader = LogReader::new(source);
            assert_eq!(reader.next_frame().unwrap(), None);
            let text = reader.summary().to_string();
            assert!(cause.iter().all(|it| text.contains(it)), "{text}");
            assert!(reader.is_damaged() && !reader.has_partial_entry());
            assert!(reader.source().get_ref().1 < 2 * MAX_WITHOUT_FRAME);
            assert_eq!(reader.next_frame().unwrap(), None, "nothing more is read");
        }
    }

    #[test]
    fn line_that_does_not_end_is_doubtful_before_its_end() {
        let pieces = ["x".repeat(600), "y".repeat(600)].concat();
        let mut reader = LogReader::new(BufReader::with_capacity(64, pieces.as_bytes()));
        let mut is_doubtful = false;
        while reader.step().unwrap() != DecodeStep::End {
            is_doubtful |= reader.summary().is_doubtful(true);
        }
        assert!(is_doubtful);
        assert_eq!(reader.summary().unreadable, 1, "counted once");
    }

    #[test]
    fn interface_number_257_is_unreadable() {
        let lines: Vec<_> = (0..300).map(|n| format!("(0.1) bus{n} 123#")).collect();
        let (frames, tally) = read(&lines.join("\n"), 8192);
        assert_eq!((frames.len(), tally.unreadable), (256, 44));
        assert_eq!(tally.first_unreadable, Some((257, EntryFault::TooManyInterfaces)));
    }

    #[test]
    fn summary_is_described_in_words() {
        assert_eq!(
            read(LOG, 4096).1.to_string(),
            "4 frames of 2 interfaces; line 4 cannot be read: it does not begin with \
             (SECONDS.FRACTION); the last line has no end: it may be cut off; time goes backwards 1 time"
        );
    }
}
