//! Statistics of the frames of a log: kinds, bus errors, identifiers, calls.
//!
//! Input: frames in the order of the log. Bounded by the tables of identifiers and calls. Does not know
//! how they are printed.

use crate::app::{
    App, CallStats, Calls, ErrorKinds, FrameRole, IdentifierStats, Identifiers, add_identifier,
};
use crate::error_report::ErrorReport;
use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant};

/// Intervals between the frames of an identifier, in the whole log.
#[derive(Clone, Copy, Debug)]
pub struct LogIntervals {
    /// Time of the first frame.
    first: Instant,
    last: Instant,
    /// Number of intervals.
    count: u64,
    /// Least interval.
    pub min: Duration,
    /// Greatest interval.
    pub max: Duration,
}

impl LogIntervals {
    /// Mean interval; `None` before the second frame.
    pub fn mean(&self) -> Option<Duration> {
        let micros = self.last.since(self.first).as_micros() / u128::from(self.count.max(1));
        let mean = Duration::from_micros(u64::try_from(micros).unwrap_or(u64::MAX));
        (self.count > 0).then_some(mean)
    }

    fn add(&mut self, time: Instant) {
        let interval = time.since(self.last);
        self.min = self.min.min(interval);
        self.max = self.max.max(interval);
        self.count += 1;
        self.last = time;
    }
}

/// See the module's documentation.
#[derive(Debug, Default)]
pub struct LogStats {
    /// Number of frames.
    pub frames: u64,
    /// Times of the first and the last frame; `None` without a frame.
    pub span: Option<(Instant, Instant)>,
    /// By place in [`FrameRole::ALL`].
    roles: [u64; FrameRole::ALL.len()],
    /// Error frames by kind.
    pub errors: ErrorKinds,
    /// Frames by identifier.
    pub identifiers: Identifiers,
    /// Calls.
    pub calls: Calls,
    /// By row of the identifiers.
    intervals: Vec<LogIntervals>,
    /// The same of identifiers as they are.
    unmasked_intervals: Vec<LogIntervals>,
    /// The same of broadcasts where DBC files have messages.
    described_intervals: Vec<LogIntervals>,
}

impl LogStats {
    /// Counts a frame.
    pub fn add(&mut self, app: &App, frame: &Frame) {
        let time = frame.time;
        let first = self.span.map_or(time, |(first, _)| first);
        self.span = Some((first, time));
        if let Some(bus) = app.bus(frame.bus) {
            self.calls.add(frame, self.frames, &bus.config().profile);
        }
        let is_foreign = app.history().is_foreign(frame.bus);
        let role = FrameRole::of(frame, is_foreign);
        if let Some(count) = self.roles.get_mut(role as usize) {
            *count += 1;
        }
        if frame.kind == FrameKind::Error {
            self.errors.add(ErrorReport::of(frame));
        }
        let rows = add_identifier(&mut self.identifiers, frame, self.frames, app.history());
        let counted = [
            (&mut self.intervals, rows.link.map(|link| link.row)),
            (&mut self.unmasked_intervals, rows.unmasked),
            (&mut self.described_intervals, rows.described),
        ];
        for (intervals, row) in counted {
            if let Some(row) = row {
                add_interval(intervals, row, time);
            }
        }
        self.frames += 1;
    }

    /// Rows of identifiers, as they are on buses that speak another protocol and of messages of DBC files,
    /// with the intervals in the whole log: `None` before the second frame, and for requests and responses,
    /// which have no period.
    pub fn identifier_rows<'a>(
        &'a self,
        app: &'a App,
    ) -> Vec<(&'a IdentifierStats, Option<&'a LogIntervals>)> {
        let is_foreign = |bus| app.history().is_foreign(bus);
        let intervals = |row: &IdentifierStats| {
            let identifiers = &self.identifiers;
            let unmasked = || self.unmasked_intervals.get(identifiers.unmasked_place_of(&row.key)?);
            let described =
                || self.described_intervals.get(identifiers.described_place_of(&row.key)?);
            let masked = || self.intervals.get(identifiers.place_of(&row.key)?);
            let own = if is_foreign(row.key.bus) { unmasked() } else { described() };
            let all = own.or_else(masked);
            all.filter(|it| it.count > 0 && !row.has_no_period(is_foreign(row.key.bus)))
        };
        let rows = self.identifiers.rows_of(is_foreign);
        rows.map(|row| (row, intervals(row))).collect()
    }

    /// Ends the requests that are open for too long at the last frame.
    pub fn end(&mut self, app: &App) {
        let Some((_, last)) = self.span else { return };
        self.calls.tick(last, |bus| app.profile(bus).calls.timeout());
    }

    /// Rows of calls; not of buses that speak another protocol.
    pub fn call_rows<'a>(&'a self, app: &'a App) -> impl Iterator<Item = &'a CallStats> {
        self.calls.rows().iter().filter(|row| !app.history().is_foreign(row.key.bus))
    }

    /// Number of frames of each kind.
    pub fn roles(&self) -> impl Iterator<Item = (FrameRole, u64)> {
        FrameRole::ALL.into_iter().map(|role| (role, self.roles[role as usize]))
    }

    /// Frames per second, of a count of frames; `None` for a log without duration.
    pub fn rate(&self, count: u64) -> Option<f64> {
        let (first, last) = self.span?;
        let seconds = last.since(first).as_secs_f64();
        (seconds > 0.0).then(|| count as f64 / seconds)
    }
}

/// Adds a frame to the intervals of a row; the next row is new.
fn add_interval(all: &mut Vec<LogIntervals>, row: usize, time: Instant) {
    if let Some(intervals) = all.get_mut(row) {
        intervals.add(time);
    } else {
        let (min, max) = (Duration::MAX, Duration::ZERO);
        all.push(LogIntervals { first: time, last: time, count: 0, min, max });
    }
}
