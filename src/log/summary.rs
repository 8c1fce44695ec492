//! Summary of a log while it is read: counts, faults, interfaces, and the moments of its entries.
//!
//! Entries up to 1 s out of order keep the order of the log. If the log's clock was set back by
//! more, or a second log follows in the same file, time continues from the last entry. Does not
//! know formats: decoders pass entries and faults.

use super::candump::LineFault;
use super::damage::Damage;
use super::fields::FieldFault;
use super::foreign::ForeignFormat;
use super::loss::write_counts;
use super::pcapng::PacketFault;
use super::{LogEntry, LogTime};
use crate::frame::{BusIndex, Frame, FrameKind};
use crate::time::{Duration, Epoch, Instant};
use std::fmt;
use std::sync::Arc;

/// Largest step back at which an entry gets the moment of the entry before it. A larger one means
/// that the clock was set back.
pub(super) const MAX_REORDER: Duration = Duration::from_secs(1);
/// Gap after which a clock that was set back may have returned to its earlier time.
const GAP: Duration = Duration::from_secs(10);

/// Changes of a database in a file beside it, which is not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum UnreadChanges {
    /// The newest rows are in the write-ahead log.
    #[error(
        "what is in the file -wal beside it is not read; end the program that writes it, or run: \
         sqlite3 LOG.db 'pragma wal_checkpoint(truncate)'"
    )]
    WriteAheadLog,
    /// A transaction was begun and not ended; what it has overwritten is in the rollback journal.
    #[error(
        "it is inside a transaction, and the file -journal beside it is not read: the newest rows may be \
         wrong; end the program that writes it, and run: sqlite3 LOG.db 'pragma quick_check'"
    )]
    RollbackJournal,
}

/// Why an entry of a log cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum EntryFault {
    /// A line of candump's log text.
    #[error(transparent)]
    Line(#[from] LineFault),
    /// A block of a pcapng file.
    #[error(transparent)]
    Packet(#[from] PacketFault),
    /// A line of another text format, or an object of a BLF log.
    #[error(transparent)]
    Field(#[from] FieldFault),
    /// More interface names than there are bus numbers.
    #[error("more than 256 interface names in one log")]
    TooManyInterfaces,
}

/// Summary of the part of a log read so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogSummary {
    /// Unit of this log: `line`, `block`. Empty before the format is known.
    pub(super) unit: &'static str,
    /// Entries, readable or not.
    pub entries: u64,
    /// Frames, also of logs before that this one replaced.
    pub frames: u64,
    /// Frames of the logs before.
    frames_before: u64,
    /// Entries that cannot be read.
    pub unreadable: u64,
    /// First unreadable entry: its number, counted from 1, and its fault.
    pub first_unreadable: Option<(u64, EntryFault)>,
    /// Requests to send a frame, which are not on the bus.
    pub transmit_requests: u64,
    /// Why the rest cannot be read; `None` without damage.
    pub damage: Option<Damage>,
    /// The damage, and the byte of the log, unpacked, at which it was found.
    damage_at: Option<(Damage, u64)>,
    /// Bytes of the log, unpacked, that were read.
    bytes: u64,
    /// The format of a log that is not read; `None` for one that is.
    pub foreign: Option<ForeignFormat>,
    /// Frames dated before the previous frame; each step back of the clock counts once.
    pub clock_steps_back: u64,
    /// Interface names in order of appearance, which is that of bus numbers.
    pub interfaces: Arc<Vec<String>>,
    /// Time of the first frame; `None` before it.
    pub epoch: Option<Epoch>,
    /// Moment of the last frame, counted from the first.
    pub last: Instant,
    /// Time of the last frame as it is in the log.
    pub written: LogTime,
    /// Frames that are not all that the log has of them.
    pub changed: ChangedFrames,
    /// The log has no times: its frames have those at which they were read, or all the same.
    pub is_timeless: bool,
    /// What is doubtful of its local dates.
    pub dates: DateDoubts,
    /// The log is a database with changes in a file beside it, which is not read.
    pub unread_changes: Option<UnreadChanges>,
    /// The last line of a text log has no end, or the last record of an unfinished measurement is cut off.
    pub ends_inside_entry: bool,
    /// Time at which the next entry is read, in microseconds since 1970; 0 if it is not known.
    pub(super) arrival: u64,
    /// Offset added to the times in the log, because the clock was set back.
    ahead: Duration,
    /// Offset before the last clock step. The clock may be set back and forth, and two interfaces
    /// may have separate clocks.
    ahead_before: Duration,
    /// Place of the last interface.
    last_interface: usize,
}

/// Numbers of frames that are read otherwise than the log has them, as no frame is so on a bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChangedFrames {
    /// Data frames with zeros behind the data of the log, which have another length than that of their DLC, or
    /// one that no DLC has.
    pub padded: u64,
    /// Error frames without some details of the log.
    pub error_details: u64,
    /// Remote frames whose FDF is dropped.
    pub fd_remote: u64,
}

impl ChangedFrames {
    fn count(&mut self, frame: &Frame) {
        let count = match frame.kind {
            FrameKind::Data => &mut self.padded,
            FrameKind::Error => &mut self.error_details,
            FrameKind::Remote => &mut self.fd_remote,
        };
        *count += 1;
    }
}

/// Formats each number that is not 0, with a separator before it.
impl fmt::Display for ChangedFrames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = [
            (self.padded, "frame", "padded with zeros to the length of a DLC"),
            (self.error_details, "error frame", "without all details of the log"),
            (self.fd_remote, "remote frame", "of the log in FD format, which has none"),
        ];
        write_counts(f, &counts, &mut "; ")
    }
}

/// Entries of a part of a log that cannot be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnreadableEntries {
    unit: &'static str,
    /// Number of entries; the rest of a damaged log counts as one.
    pub count: u64,
    first: Option<(u64, EntryFault)>,
}

/// What is doubtful of the local dates of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DateDoubts {
    /// A date comes twice, as summer time ended in that hour, and the lines do not show which one it is: it
    /// is read as the first.
    pub is_ambiguous: bool,
    /// A date is one that clocks skip here, as summer time begins: it was written in another time zone.
    pub is_skipped: bool,
    /// `TZ` names a time zone that is not known here: the dates are read as those of UTC.
    pub is_zone_unknown: bool,
}

/// What is doubtful of a part of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogDoubts {
    /// Entries that cannot be read.
    pub entries: UnreadableEntries,
    /// Its local dates.
    pub dates: DateDoubts,
}

impl DateDoubts {
    /// Returns true if there is any.
    pub fn is_any(self) -> bool {
        self != Self::default()
    }

    /// Returns the doubts of both.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self {
            is_ambiguous: self.is_ambiguous | other.is_ambiguous,
            is_skipped: self.is_skipped | other.is_skipped,
            is_zone_unknown: self.is_zone_unknown | other.is_zone_unknown,
        }
    }
}

impl LogSummary {
    /// Returns what is doubtful of what was read so far.
    pub fn doubts(&self) -> LogDoubts {
        LogDoubts { entries: self.unreadable_entries(), dates: self.dates }
    }

    /// Returns the entries that cannot be read.
    pub fn unreadable_entries(&self) -> UnreadableEntries {
        let count = self.lost_entries();
        UnreadableEntries { unit: self.unit, count, first: self.first_unreadable }
    }

    /// Starts to count unreadable entries anew: the ones so far precede the part that is read.
    pub(super) fn forget_unreadable(&mut self) {
        (self.unreadable, self.first_unreadable) = (0, None);
    }

    /// Returns the number of frames of this log, without those of logs that it replaced.
    pub fn own_frames(&self) -> u64 {
        self.frames - self.frames_before
    }

    /// Counts bytes that were read, and notes where damage was found.
    #[inline]
    pub(super) fn note_read(&mut self, bytes: usize) {
        self.bytes += bytes as u64;
        let noted = self.damage_at.filter(|(damage, _)| self.damage == Some(*damage));
        let noted = noted.filter(|(damage, _)| !damage.is_truncated());
        self.damage_at = self.damage.map(|damage| noted.unwrap_or((damage, self.bytes)));
    }

    /// Notes when the next entry is read; only entries of a log without times need it.
    pub(super) fn note_arrival(&mut self, clock: Option<fn() -> u64>) {
        if let Some(clock) = clock.filter(|_| self.is_timeless || self.own_frames() == 0) {
            self.arrival = clock();
        }
    }

    /// Notes where damage is that is not behind what was read.
    pub(super) fn note_damage_at(&mut self, damage: Damage, byte: u64) {
        self.damage_at = Some((damage, byte));
    }

    /// Counts the entries of another log, which follows. Interfaces, frames and time go on.
    pub(super) fn begin_another_log(&mut self) {
        self.forget_unreadable();
        (self.entries, self.clock_steps_back) = (0, 0);
        (self.damage, self.foreign) = (None, None);
        (self.damage_at, self.bytes) = (None, 0);
        (self.unread_changes, self.ends_inside_entry) = (None, false);
        (self.dates, self.changed) = (DateDoubts::default(), ChangedFrames::default());
        self.transmit_requests = 0;
        self.frames_before = self.frames;
    }

    /// Returns the number of entries that cannot be read; of a damaged log, its rest counts as one.
    pub fn lost_entries(&self) -> u64 {
        let is_damaged = self.damage.is_some() || self.foreign.is_some();
        self.unreadable + u64::from(is_damaged) + u64::from(self.unread_changes.is_some())
    }

    /// Returns true if its first entries cannot be read: it is probably not a log. A few may be
    /// the greeting of a server, which frames follow; not if `is_all`, so that all that is there
    /// for now was read.
    pub fn is_doubtful(&self, is_all: bool) -> bool {
        /// Entries of a short greeting.
        const GREETING: u64 = 8;
        self.own_frames() == 0 && self.unreadable >= if is_all { 1 } else { GREETING }
    }

    /// Counts an entry; returns its frame with bus and moment.
    pub(super) fn take<'a>(
        &mut self,
        entry: Result<Option<LogEntry<'a>>, impl Into<EntryFault>>,
    ) -> Option<Frame> {
        self.entries += 1;
        let entry: Result<Option<LogEntry<'a>>, EntryFault> = entry.map_err(Into::into);
        let read = entry.and_then(|entry| entry.map(|entry| self.place(entry)).transpose());
        read.unwrap_or_else(|fault| {
            if fault == EntryFault::Field(FieldFault::TransmitRequest) {
                self.transmit_requests += 1;
            } else {
                self.unreadable += 1;
                self.first_unreadable.get_or_insert((self.entries, fault));
            }
            None
        })
    }

    /// Counts a frame of an interface that was named before, and returns it with bus and moment.
    /// `None`, without counting, for another interface.
    #[inline]
    pub(super) fn take_plain(
        &mut self,
        time: LogTime,
        interface: &[u8],
        frame: &Frame,
    ) -> Option<Frame> {
        let is_it = |name: &String| name.as_bytes() == interface;
        if !self.interfaces.get(self.last_interface).is_some_and(is_it) {
            self.last_interface = self.interfaces.iter().position(is_it)?;
        }
        let bus = BusIndex(self.last_interface as u8);
        self.entries += 1;
        Some(self.dated(time, frame).with_bus(bus))
    }

    fn place(&mut self, entry: LogEntry<'_>) -> Result<Frame, EntryFault> {
        let bus = self.bus_of(entry.interface).ok_or(EntryFault::TooManyInterfaces)?;
        Ok(self.dated(entry.time, &entry.frame).with_bus(bus))
    }

    /// Counts a frame and returns it with its moment.
    #[inline]
    fn dated(&mut self, time: LogTime, frame: &Frame) -> Frame {
        let unix_micros = time.micros;
        let epoch = *self.epoch.get_or_insert(Epoch::from_unix_micros(unix_micros));
        // Most logs go on, and were never set back.
        let next = unix_micros.checked_sub(epoch.unix_micros(Instant::ZERO));
        let goes_on = |next: &u64| {
            let passed = next.checked_sub(self.last.as_micros());
            passed.is_some_and(|passed| passed <= GAP.as_micros() as u64)
        };
        self.last = match next.filter(goes_on).filter(|_| self.ahead.is_zero()) {
            Some(next) => Instant::from_micros(next).min(Instant::LATEST),
            None => self.moment(epoch.since_start(unix_micros)),
        };
        self.frames += 1;
        self.written = time;
        let mut frame = frame.with_time(self.last);
        if frame.take_changed() {
            self.changed.count(&frame);
        }
        frame
    }

    /// Returns the moment of an entry dated `written` microseconds after the first one.
    fn moment(&mut self, written: i128) -> Instant {
        let micros = |duration: Duration| duration.as_micros().cast_signed();
        let last = i128::from(self.last.as_micros());
        let late = |ahead| written + micros(ahead) - last;
        let goes_on = |ahead| (-micros(MAX_REORDER)..=micros(GAP)).contains(&late(ahead));
        if !goes_on(self.ahead) && goes_on(self.ahead_before) {
            std::mem::swap(&mut self.ahead, &mut self.ahead_before);
        }
        let late_by = late(self.ahead);
        // Another log has other dates.
        self.clock_steps_back += u64::from(late_by < 0 && self.own_frames() > 0);
        if late_by < -micros(MAX_REORDER) {
            let set_back = u64::try_from(-late_by).unwrap_or(u64::MAX);
            self.ahead_before = self.ahead;
            self.ahead = self.ahead.saturating_add(Duration::from_micros(set_back));
        }
        let step = Duration::from_micros(u64::try_from(late_by).unwrap_or(0));
        (self.last + step).min(Instant::LATEST)
    }

    fn bus_of(&mut self, interface: &str) -> Option<BusIndex> {
        let known = self.interfaces.iter().position(|name| name == interface);
        let index = u8::try_from(known.unwrap_or(self.interfaces.len())).ok()?;
        if known.is_none() {
            Arc::make_mut(&mut self.interfaces).push(interface.to_owned());
        }
        self.last_interface = usize::from(index);
        Some(BusIndex(index))
    }
}

/// Formats the summary: `5123 frames; 2 lines cannot be read, the first is line 17: …`.
impl fmt::Display for LogSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(foreign) = self.foreign {
            return write!(f, "{foreign}");
        }
        let plural = |count| if count == 1 { "" } else { "s" };
        let frames = self.own_frames();
        write!(f, "{frames} frame{}", plural(frames))?;
        if self.interfaces.len() > 1 {
            write!(f, " of {} interfaces", self.interfaces.len())?;
        }
        if let Some(damage) = self.damage {
            write!(f, "; {damage}")?;
            if !damage.has_place() {
                write!(f, " (byte {})", self.damage_at.map_or(self.bytes, |(_, byte)| byte))?;
            }
        }
        if self.unreadable > 0 {
            let entries = UnreadableEntries { count: self.unreadable, ..self.unreadable_entries() };
            write!(f, "; {entries}")?;
        }
        if let Some(unread) = self.unread_changes {
            write!(f, "; {unread}")?;
        }
        if self.ends_inside_entry {
            let end = match self.unit {
                "line" => "the last line has no end: it may be cut off",
                _ => "it ends inside a record",
            };
            write!(f, "; {end}")?;
        }
        write!(f, "{}", self.changed)?;
        if self.transmit_requests > 0 {
            let count = self.transmit_requests;
            write!(f, "; {count} transmit request{}, not read", plural(count))?;
        }
        if self.is_timeless {
            write!(f, "; without times")?;
        }
        if self.dates.is_any() {
            write!(f, "; {}", self.dates)?;
        }
        match self.clock_steps_back {
            0 => Ok(()),
            count => write!(f, "; time goes backwards {count} time{}", plural(count)),
        }
    }
}

/// Formats all that there are, with their remedy; nothing without one.
impl fmt::Display for DateDoubts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let doubts = [
            (
                self.is_ambiguous,
                "its date comes twice, as clocks were set back then: its times may be off by that step",
            ),
            (
                self.is_skipped,
                "a date in it is skipped in this time zone, as clocks were set forward over it: set TZ to \
                 the zone of the log",
            ),
            (
                self.is_zone_unknown,
                "the time zone in TZ is not known here, so its dates are read as UTC: install tzdata, or \
                 set TZ to a rule such as CET-1CEST,M3.5.0,M10.5.0/3",
            ),
        ];
        let mut separator = "";
        for (_, doubt) in doubts.into_iter().filter(|(is_so, _)| *is_so) {
            write!(f, "{separator}{doubt}")?;
            separator = "; ";
        }
        Ok(())
    }
}

/// Formats the number and the first one: `2 lines cannot be read, the first is line 17: …`.
impl fmt::Display for UnreadableEntries {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit;
        match (self.first, self.count) {
            (None, count) => write!(f, "{count} {unit}s cannot be read"),
            (Some((at, fault)), 1) => write!(f, "{unit} {at} cannot be read: {fault}"),
            (Some((at, fault)), count) => {
                write!(f, "{count} {unit}s cannot be read, the first is {unit} {at}: {fault}")
            }
        }
    }
}
