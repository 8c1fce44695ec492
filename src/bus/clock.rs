//! Clock of a session, which for logs can be paused, stepped and run faster; and the times of frames
//! with kernel timestamps. Does not know what happens at a moment.

use crate::frame::BusIndex;
use crate::status::{Playback, PlaybackCommand};
use crate::time::{Duration, Epoch, Instant};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant as Monotonic, SystemTime, UNIX_EPOCH};

/// Limits of the replay speed.
const SLOWEST: f64 = 0.001;
const FASTEST: f64 = 100_000.0;
/// How far a replay may lag behind its speed and still catch up.
const MAX_LAG: Duration = Duration::from_millis(250);
/// How soon the reader of one of several logs asks again whether its next frame is due.
const ASK_AGAIN: Duration = Duration::from_millis(100);
/// How far the date of a file that grows again may be ahead of other files that grow.
const MAX_AHEAD: Duration = Duration::from_mins(1);
/// How long a fast clock waits for the writer of a pipe while there are other logs: longer than another
/// program pauses.
const WRITER_GRACE: Duration = Duration::from_secs(10);

/// The clock of a session, counting from its start; clones share it. The clock of a session of logs
/// can be paused, stepped from frame to frame, and run faster and slower.
#[derive(Clone, Debug)]
pub struct Clock {
    epoch: Epoch,
    pace: Arc<Mutex<PlaybackPace>>,
}

#[derive(Debug)]
struct PlaybackPace {
    /// It is the clock of logs alone.
    is_replaying: bool,
    /// It was `from` at `since`, and has run at `speed` since then.
    since: Monotonic,
    from: Instant,
    /// The latest moment returned.
    reached: Instant,
    speed: f64,
    is_paused: bool,
    /// Up to this moment it runs as fast as frames are taken, also while it is paused.
    reads_to: Instant,
    /// Time of the last frame of each log, as far as it is known.
    ends: BTreeMap<BusIndex, Instant>,
    /// Logs whose last frames are looked for.
    sought_ends: BTreeSet<BusIndex>,
    /// How many logs are not open yet; with the last one it starts to run.
    awaited_logs: usize,
    /// Times of the first frames of the logs, from the first log on, as far as they are known.
    starts: Vec<Option<Instant>>,
    /// Where each log is.
    logs: BTreeMap<BusIndex, LogPlace>,
}

/// Where the replay of a log is.
#[derive(Clone, Copy, Debug)]
enum LogPlace {
    /// Its next frame has this moment or, if it was not read yet, a later one. The clock does not
    /// pass it before the frame is taken.
    Next(Instant),
    /// A pipe, read as it is written. Its next frame has this moment, or a later one. At its own speed
    /// the clock runs meanwhile; a clock that runs faster would pass what its writer sends next.
    Live { at: Instant, awaits: PipeAwaits },
    /// A file that has grown after its end. Its next frame has this moment, or a later one.
    Followed(Instant),
    /// A file that has grown, of which all is read that was written. Its writer may have more that it
    /// has not written yet, with this moment or a later one: the clock does not pass it.
    Read(Instant),
    /// At its end, for now, after a frame of this moment.
    Ended(Instant),
}

impl LogPlace {
    /// Moment of its last frame; `None` unless it is at its end.
    fn end(&self) -> Option<Instant> {
        if let Self::Ended(last) = self { Some(*last) } else { None }
    }
}

/// What the replay of a pipe waits for.
#[derive(Clone, Copy, Debug)]
enum PipeAwaits {
    /// That its next frame, which was read, is due and taken.
    Frame,
    /// Its writer, which was quick until this time.
    Writer(Monotonic),
    /// Its writer, which has written nothing yet, or nothing for a while beside other logs: the clock goes
    /// on without it.
    SlowWriter,
}

impl Clock {
    /// A clock that starts now.
    pub fn start() -> Self {
        Self::with(Epoch::from_unix_micros(wall_micros()), 1.0, None)
    }

    /// A clock that starts when a log opens, at `epoch`, and runs `speed` times as fast as real time,
    /// so that ages and timeouts keep the pace of the recording. A speed that is not a positive number
    /// counts as 1.
    pub fn replaying(epoch: Epoch, speed: f64) -> Self {
        Self::of_logs(epoch, speed, vec![None])
    }

    /// As [`replaying`](Self::replaying), but it starts when as many logs are open as there are times
    /// in `starts`: the time of the first frame of each, `None` for the present when that frame is read.
    pub fn of_logs(epoch: Epoch, speed: f64, starts: Vec<Option<Instant>>) -> Self {
        let speed = if speed.is_finite() && speed > 0.0 { speed } else { 1.0 };
        Self::with(epoch, speed, Some(starts))
    }

    fn with(epoch: Epoch, speed: f64, starts: Option<Vec<Option<Instant>>>) -> Self {
        let is_replaying = starts.is_some();
        let starts = starts.unwrap_or_default();
        let logs = BTreeMap::new();
        let (since, from) = (Monotonic::now(), Instant::ZERO);
        let reached = from;
        let awaited_logs = starts.len();
        let pace = PlaybackPace {
            is_replaying,
            since,
            from,
            reached,
            speed,
            is_paused: false,
            reads_to: Instant::ZERO,
            ends: BTreeMap::new(),
            sought_ends: BTreeSet::new(),
            awaited_logs,
            starts,
            logs,
        };
        Self { epoch, pace: Arc::new(Mutex::new(pace)) }
    }

    /// The present moment.
    pub fn now(&self) -> Instant {
        self.pace().now()
    }

    /// Lets time pass.
    #[cfg(test)]
    pub(crate) fn elapse(&self, time: Duration) {
        let mut pace = self.pace();
        pace.since -= time;
        for place in pace.logs.values_mut() {
            if let LogPlace::Live { awaits: PipeAwaits::Writer(since), .. } = place {
                *since -= time;
            }
        }
    }

    /// The Unix time of the start.
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Converts a wall-clock duration to a duration of this clock.
    pub fn run_in(&self, duration: Duration) -> Duration {
        duration.mul_f64(self.pace().speed)
    }

    /// Wall-clock time until `at`: zero if it has passed, [`Duration::MAX`] while the clock stands.
    pub fn until(&self, at: Instant) -> Duration {
        let mut pace = self.pace();
        let left = at.since(pace.now());
        if let Some(grace) = pace.writer_grace(at) {
            return grace;
        }
        // What moves it then are frames, not time.
        let stands =
            pace.is_standing() || pace.is_led() || pace.read_to().is_some_and(|it| it < at);
        if stands && !left.is_zero() { Duration::MAX } else { left.div_f64(pace.speed) }
    }

    /// Returns true if a frame of this moment is due, whether or not earlier ones of other logs were
    /// taken.
    pub(super) fn is_due(&self, at: Instant) -> bool {
        let mut pace = self.pace();
        if pace.is_standing() { at <= pace.now() } else { pace.is_led() || at <= pace.pace() }
    }

    /// Wall-clock time until a frame of this moment [is due](Self::is_due), or until that is asked again
    /// because another log may have moved the clock; [`Duration::MAX`] while a clock of one log stands.
    pub(super) fn until_due(&self, at: Instant) -> Duration {
        let pace = self.pace();
        let left = if pace.is_standing() {
            Duration::MAX
        } else if pace.is_led() {
            Duration::ZERO
        } else {
            at.since(pace.pace()).div_f64(pace.speed)
        };
        let is_one = pace.logs.len() + pace.awaited_logs == 1;
        if is_one { left } else { left.min(ASK_AGAIN) }
    }

    /// Moment before which a log has no further frame, besides those that were delivered; `None` if that
    /// is not known, and at its end.
    pub fn next_of(&self, log: BusIndex) -> Option<Instant> {
        let pace = self.pace();
        match pace.logs.get(&log)? {
            LogPlace::Next(at) | LogPlace::Followed(at) | LogPlace::Read(at) => Some(*at),
            LogPlace::Live { at, awaits } => Some(*at).filter(|_| pace.waits_for_pipe(*awaits)),
            LogPlace::Ended(_) => None,
        }
    }

    /// Time of the first frame of a log; `None` if it is the present when that frame is read.
    pub(super) fn start_of(&self, log: BusIndex) -> Option<Instant> {
        self.pace().start_of(log)
    }

    /// The status of the playback; `None` unless all buses are logs.
    pub fn playback(&self) -> Option<Playback> {
        let mut pace = self.pace();
        let now = pace.now();
        pace.is_replaying.then_some(Playback {
            speed: pace.speed,
            is_paused: pace.is_paused,
            is_ended: pace.is_ended(),
            end: pace.ends.values().max().copied(),
            seeks_end: !pace.sought_ends.is_empty(),
            reads_to: Some(pace.reads_to).filter(|to| *to > now),
        })
    }

    /// Executes a playback command, if all buses are logs. The caller wakes threads that sleep by
    /// this clock.
    pub fn control(&self, command: PlaybackCommand) {
        if !self.pace().is_replaying {
            return;
        }
        self.change(|pace| match command {
            PlaybackCommand::Pause => pace.is_paused = !pace.is_paused,
            PlaybackCommand::Step => {
                pace.is_paused = true;
                let next = pace.logs.values().filter_map(|place| match place {
                    LogPlace::Next(at)
                    | LogPlace::Followed(at)
                    | LogPlace::Live { at, awaits: PipeAwaits::Frame } => Some(*at),
                    LogPlace::Live { .. } | LogPlace::Read(_) | LogPlace::Ended(_) => None,
                });
                pace.from = next.min().map_or(pace.from, |next| next.max(pace.from));
            }
            PlaybackCommand::SetPaused(is_paused) => pace.is_paused = is_paused,
            PlaybackCommand::ReadTo(to) => pace.reads_to = to,
            PlaybackCommand::Faster => pace.speed = (pace.speed * 2.0).min(FASTEST),
            PlaybackCommand::Slower => pace.speed = (pace.speed / 2.0).max(SLOWEST),
        });
    }

    /// Adds a log; `is_live`: it is read as it is written.
    pub(super) fn log_opens(&self, log: BusIndex, is_live: bool) {
        self.change(|pace| {
            let start = pace.start_of(log).unwrap_or(pace.from);
            let live = LogPlace::Live { at: pace.from, awaits: PipeAwaits::SlowWriter };
            let place = if is_live { live } else { LogPlace::Next(start) };
            pace.awaited_logs = pace.awaited_logs.saturating_sub(1);
            pace.logs.insert(log, place);
        });
    }

    /// Sets the moment of a log's next frame. Frames closer together than a thread can sleep do not
    /// slow the clock down.
    pub(super) fn log_waits(&self, log: BusIndex, next: Instant) {
        let mut pace = self.pace();
        pace.drop_lag();
        let waits = match pace.logs.get(&log) {
            Some(LogPlace::Live { .. }) => LogPlace::Live { at: next, awaits: PipeAwaits::Frame },
            Some(LogPlace::Followed(_) | LogPlace::Read(_)) => LogPlace::Followed(next),
            _ => LogPlace::Next(next),
        };
        pace.logs.insert(log, waits);
    }

    /// Sets the time of the last frame of a log, as far as it is known.
    pub(super) fn set_log_end(&self, log: BusIndex, end: Instant) {
        self.pace().ends.insert(log, end);
    }

    /// Notes whether the last frame of a log is looked for.
    pub(super) fn set_seeks_end(&self, log: BusIndex, seeks: bool) {
        let sought = &mut self.pace().sought_ends;
        if seeks {
            sought.insert(log);
        } else {
            sought.remove(&log);
        }
    }

    /// Moment up to which frames are taken as fast as possible.
    pub(super) fn reads_to(&self) -> Instant {
        self.pace().reads_to
    }

    /// Notes the end of a log, whose last frame had this moment. When all logs are at their end, the
    /// clock stands at the latest of these moments: frames that were read ahead were taken before it.
    pub(super) fn log_ends(&self, log: BusIndex, last: Instant) {
        self.change(|pace| {
            pace.logs.insert(log, LogPlace::Ended(last));
            if pace.is_ended() {
                pace.reads_to = Instant::ZERO;
                let ends = pace.logs.values().filter_map(LogPlace::end);
                pace.from = ends.fold(pace.from, Instant::max);
            }
        });
    }

    /// Notes that a file continues after its end, and returns the time of its first new frame: its own,
    /// `dated`, where nothing else goes by the clock, or files that grow, too, and it is not past nor far
    /// ahead of these. Otherwise that frame is of now.
    pub(super) fn log_resumes(&self, log: BusIndex, dated: Instant) -> Instant {
        let mut next = dated;
        self.change(|pace| {
            let is_alone = pace
                .logs
                .iter()
                .all(|(other, place)| *other == log || matches!(place, LogPlace::Ended(_)));
            pace.logs.insert(log, LogPlace::Followed(dated));
            let is_led = pace.is_led();
            let latest = if !is_led {
                pace.from
            } else if is_alone {
                Instant::LATEST
            } else {
                pace.from + MAX_AHEAD
            };
            next = if dated <= latest { dated.max(pace.from) } else { pace.from };
            pace.logs.insert(log, LogPlace::Followed(next));
            if is_led {
                // From now on lines come as they are written.
                pace.speed = 1.0;
            }
        });
        next
    }

    /// Notes that all that was written of a log is read, up to a frame of this moment. Its writer may
    /// have more that it has not written yet, so the clock does not run on: silence since that frame says
    /// nothing about the devices.
    pub(super) fn log_awaits_more(&self, log: BusIndex, last: Instant) {
        self.change(|pace| {
            pace.logs.insert(log, LogPlace::Read(last));
        });
    }

    /// Notes that all that was written to a pipe is read, up to a frame of this moment.
    pub(super) fn log_awaits_writer(&self, log: BusIndex, last: Instant) {
        // The pace stays: this is so again and again.
        if let Some(place @ LogPlace::Live { .. }) = self.pace().logs.get_mut(&log) {
            *place = LogPlace::Live { at: last, awaits: PipeAwaits::Writer(Monotonic::now()) };
        }
    }

    /// Changes the pace from now on.
    fn change(&self, change: impl FnOnce(&mut PlaybackPace)) {
        let mut pace = self.pace();
        pace.begin_at_now();
        change(&mut pace);
    }

    // A panic of another thread leaves nothing half-done in here, so its poison is ignored.
    fn pace(&self) -> MutexGuard<'_, PlaybackPace> {
        self.pace.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl PlaybackPace {
    fn now(&mut self) -> Instant {
        self.release_pipes();
        // A moment that passed stays so.
        self.reached = self.held_now();
        self.reached
    }

    /// The present moment, with all that holds it up.
    fn held_now(&self) -> Instant {
        let stands = self.is_standing();
        let pace = if stands { self.from } else { self.pace() };
        let now = match self.next() {
            // What is read ahead is known up to the next frame; of a pipe nothing is.
            Some(next) if self.reads_to > pace => self.reads_to.min(next),
            Some(next) if !stands && self.is_led() => next,
            Some(next) if !stands => pace.min(next),
            _ => pace,
        };
        self.reached.max(now)
    }

    /// How far it would be if no log held it up.
    fn pace(&self) -> Instant {
        self.from + self.since.elapsed().mul_f64(self.speed)
    }

    fn start_of(&self, log: BusIndex) -> Option<Instant> {
        self.starts.get(usize::from(log.0)).copied().flatten()
    }

    /// The moment that it does not pass: of the first frame that waits to be taken, or of the last one
    /// where more is awaited.
    fn next(&self) -> Option<Instant> {
        let next = self.logs.values().filter_map(|place| match place {
            LogPlace::Next(at) => Some(*at),
            LogPlace::Followed(at) | LogPlace::Read(at) => self.is_replaying.then_some(*at),
            LogPlace::Live { at, awaits } => Some(*at).filter(|_| self.waits_for_pipe(*awaits)),
            LogPlace::Ended(_) => None,
        });
        next.min()
    }

    /// Returns true if it would pass what is written to a pipe: it is faster.
    fn waits_for_pipe(&self, awaits: PipeAwaits) -> bool {
        self.is_replaying && self.speed > 1.0 && !matches!(awaits, PipeAwaits::SlowWriter)
    }

    /// Real time for which it waits before a moment for the writer of a pipe; `None` if it does not.
    fn writer_grace(&self, before: Instant) -> Option<Duration> {
        let waits = self.logs.values().filter_map(|place| match place {
            LogPlace::Live { at, awaits: awaits @ PipeAwaits::Writer(since) } => {
                // Without other logs there is nothing to go on with.
                let is_alone =
                    self.logs.values().filter(|it| !matches!(it, LogPlace::Ended(_))).count() == 1;
                let left = if is_alone {
                    Duration::MAX
                } else {
                    WRITER_GRACE.saturating_sub(since.elapsed())
                };
                Some(left).filter(|_| *at < before && self.waits_for_pipe(*awaits))
            }
            _ => None,
        });
        waits.min()
    }

    /// Goes on, from now, without a pipe whose writer is slow.
    fn release_pipes(&mut self) {
        if self.writer_grace(Instant::LATEST) != Some(Duration::ZERO) {
            return;
        }
        (self.from, self.since) = (self.held_now(), Monotonic::now());
        for place in self.logs.values_mut() {
            if let LogPlace::Live { awaits, .. } = place
                && matches!(awaits, PipeAwaits::Writer(since) if since.elapsed() >= WRITER_GRACE)
            {
                *awaits = PipeAwaits::SlowWriter;
            }
        }
    }

    /// The moment that it does not pass until more of a log is written.
    fn read_to(&self) -> Option<Instant> {
        let places = self.logs.values().filter(|_| self.is_replaying);
        let read = places.filter_map(|place| match place {
            LogPlace::Read(at) => Some(*at),
            _ => None,
        });
        read.min()
    }

    /// Returns true if it goes by the frames of files that grow, as fast as they are written.
    fn is_led(&self) -> bool {
        self.is_replaying && !self.is_ended() && self.are_all_followed()
    }

    /// Returns true if all logs are followed, but for those at their ends.
    fn are_all_followed(&self) -> bool {
        self.logs.values().all(|place| match place {
            LogPlace::Followed(_) | LogPlace::Read(_) | LogPlace::Ended(_) => true,
            LogPlace::Next(_) | LogPlace::Live { .. } => false,
        })
    }

    fn begin_at_now(&mut self) {
        self.from = self.now();
        self.since = Monotonic::now();
    }

    /// Goes on from the first frame that waits, where that is too late to catch up.
    fn drop_lag(&mut self) {
        let now = self.now();
        if now < self.reads_to {
            // Not late: it runs as fast as it can.
            self.begin_at_now();
        } else if self.pace().since(now) > MAX_LAG.mul_f64(self.speed) {
            self.begin_at_now();
        }
    }

    fn is_standing(&self) -> bool {
        self.is_paused || self.awaited_logs > 0 || self.is_ended()
    }

    /// Returns true if all logs are at their ends.
    fn is_ended(&self) -> bool {
        let ended = |place: &LogPlace| matches!(place, LogPlace::Ended(_));
        self.is_replaying && !self.logs.is_empty() && self.logs.values().all(ended)
    }
}

/// The times of the frames of one bus, from the kernel's timestamps.
///
/// The age of a frame by the wall clock is subtracted from the present moment of the monotonic clock.
/// So setting the wall clock moves no earlier time; times are never in the future and never run
/// backwards.
#[derive(Debug)]
pub struct RxTimestamps {
    clock: Clock,
    now: Instant,
    wall_micros: u64,
    last: Instant,
}

impl RxTimestamps {
    /// For a bus without frames so far.
    pub fn new(clock: Clock) -> Self {
        Self { clock, now: Instant::ZERO, wall_micros: 0, last: Instant::ZERO }
    }

    /// Reads both clocks: to be called once for each batch of frames.
    pub fn read_clocks(&mut self) {
        self.set_clocks(self.clock.now(), wall_micros());
    }

    /// The time of a frame with this timestamp (Unix microseconds); without one, the present.
    pub fn date(&mut self, stamp_micros: Option<u64>) -> Instant {
        let age = stamp_micros.map_or(0, |stamp| self.wall_micros.saturating_sub(stamp));
        self.last = self.last.max(self.now - Duration::from_micros(age));
        self.last
    }

    fn set_clocks(&mut self, now: Instant, wall_micros: u64) {
        self.now = now;
        self.wall_micros = wall_micros;
    }
}

/// Returns the time of the system clock, in microseconds since 1970.
pub(crate) fn wall_micros() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dating_at(now: u64, wall: u64) -> RxTimestamps {
        let mut dating = RxTimestamps::new(Clock::start());
        dating.set_clocks(Instant::from_micros(now), wall);
        dating
    }

    #[test]
    fn date_subtracts_the_age_of_a_frame() {
        let mut dating = dating_at(1_000, 5_000);
        assert_eq!(dating.date(Some(4_700)), Instant::from_micros(700));
        assert_eq!(dating.date(Some(4_900)), Instant::from_micros(900));
        assert_eq!(dating.date(None), Instant::from_micros(1_000));
    }

    #[test]
    fn setting_the_wall_clock_keeps_times_in_order() {
        let mut dating = dating_at(1_000, 5_000);
        assert_eq!(dating.date(Some(4_900)), Instant::from_micros(900));
        assert_eq!(dating.date(Some(9_999)), Instant::from_micros(1_000));
        dating.set_clocks(Instant::from_micros(2_000), 900_000);
        assert_eq!(dating.date(Some(5_100)), Instant::from_micros(1_000));
    }

    #[test]
    fn replaying_clock_runs_at_its_speed() {
        let clock = Clock::replaying(Epoch::from_unix_micros(7), 1_000.0);
        assert_eq!(clock.epoch().unix_micros(Instant::ZERO), 7);
        assert_eq!(clock.until(Instant::from_micros(1)), Duration::MAX, "no log is open");
        clock.log_opens(BusIndex(0), false);
        let at = clock.now() + Duration::from_secs(1_000);
        let wait = clock.until(at);
        assert!(wait <= Duration::from_secs(1) && wait > Duration::from_millis(900), "{wait:?}");
    }

    #[test]
    fn log_clock_pauses_steps_and_stands_at_the_end() {
        let clock = Clock::replaying(Epoch::default(), 1e6);
        let (first, second) = (BusIndex(0), BusIndex(1));
        clock.log_opens(first, false);
        clock.log_opens(second, true);
        clock.control(PlaybackCommand::Pause);
        let stopped = clock.now();
        let at = |seconds| stopped + Duration::from_secs(seconds);
        clock.log_waits(first, at(7_000_000));
        clock.log_waits(second, at(8_000_000));
        assert_eq!(clock.until(at(1)), Duration::MAX);
        assert_eq!(clock.until(stopped), Duration::ZERO);
        assert_eq!(clock.now(), stopped);
        clock.control(PlaybackCommand::Step);
        assert_eq!(clock.now(), at(7_000_000));
        clock.log_waits(first, at(9_000_000));
        clock.control(PlaybackCommand::Step);
        assert_eq!(clock.now(), at(8_000_000));
        // It runs, but not beyond a frame that is not taken.
        clock.log_waits(first, at(8_000_000));
        clock.control(PlaybackCommand::Pause);
        assert!(clock.playback().is_some_and(|it| !it.is_paused));
        assert_eq!(clock.now(), at(8_000_000));
        clock.log_ends(first, at(8_000_000));
        clock.log_ends(second, at(8_000_000));
        let end = clock.now();
        assert_eq!(clock.playback().map(|it| it.is_ended), Some(true));
        assert_eq!(clock.now(), end);
    }

    #[test]
    fn fast_clock_waits_for_what_is_written_to_a_pipe() {
        let pipe = BusIndex(0);
        for (speed, waits) in [(1.0, false), (1000.0, true)] {
            let clock = Clock::replaying(Epoch::default(), speed);
            clock.log_opens(pipe, true);
            let at = |seconds| Instant::ZERO + Duration::from_secs(seconds);
            clock.log_waits(pipe, at(60));
            clock.elapse(Duration::from_secs(100));
            assert_eq!(clock.now() == at(60), waits, "{speed}");
            clock.log_awaits_writer(pipe, at(60));
            clock.elapse(WRITER_GRACE / 2);
            assert_eq!(clock.now() == at(60), waits, "{speed}");
            assert_eq!(clock.next_of(pipe).is_some(), waits);
        }
    }

    #[test]
    fn fast_clock_goes_on_without_a_slow_writer_beside_another_log() {
        let clock = Clock::of_logs(Epoch::default(), 1000.0, vec![None, None]);
        let (pipe, other) = (BusIndex(0), BusIndex(1));
        let at = |seconds| Instant::ZERO + Duration::from_secs(seconds);
        clock.log_opens(pipe, true);
        clock.log_opens(other, false);
        clock.log_waits(other, at(1_000_000));
        clock.log_waits(pipe, at(2));
        clock.log_awaits_writer(pipe, at(2));
        clock.elapse(WRITER_GRACE / 2);
        assert!(clock.until(at(3600)) <= WRITER_GRACE, "asked again when it is over");
        clock.elapse(WRITER_GRACE / 2);
        // From where it stood.
        assert!((at(2)..at(60)).contains(&clock.now()), "{:?}", clock.now());
        clock.elapse(Duration::from_secs(1));
        assert!(clock.now() > at(1000));
        assert_eq!(clock.next_of(pipe), None);
        // Alone it waits for as long as that takes.
        clock.log_waits(pipe, at(500_000));
        clock.elapse(Duration::from_secs(1000));
        clock.log_ends(other, at(1_000_000));
        let now = clock.now();
        clock.log_awaits_writer(pipe, now);
        clock.elapse(WRITER_GRACE * 10);
        assert_eq!((clock.now(), clock.until(at(3_000_000))), (now, Duration::MAX));
    }

    #[test]
    fn clock_goes_by_the_frames_of_files_that_grow() {
        let clock = Clock::of_logs(Epoch::default(), 8.0, vec![Some(Instant::ZERO), None]);
        let (first, second) = (BusIndex(0), BusIndex(1));
        let at = |seconds| Instant::ZERO + Duration::from_secs(seconds);
        clock.log_opens(first, false);
        assert_eq!(clock.until(at(1)), Duration::MAX, "the second one is not open");
        clock.log_opens(second, false);
        clock.log_ends(second, Instant::ZERO);
        clock.log_waits(first, at(10_000));
        assert_eq!(clock.log_resumes(second, at(9_000)), clock.now(), "the first one is played");
        clock.log_ends(second, Instant::ZERO);
        clock.log_waits(first, Instant::ZERO);
        clock.log_ends(first, Instant::ZERO);
        let end = clock.now();
        assert_eq!(
            clock.log_resumes(first, end + Duration::from_hours(5)),
            end + Duration::from_hours(5)
        );
        assert_eq!(clock.now(), end + Duration::from_hours(5));
        assert_eq!(
            clock.playback().map(|it| it.speed),
            Some(1.0),
            "lines come as they are written"
        );
        // All is read that was written.
        let last = clock.now();
        clock.log_awaits_more(first, last);
        assert_eq!(clock.until(last + Duration::from_secs(1)), Duration::MAX);
        assert_eq!(clock.now(), last);
        // The second one grows, too: both set the time.
        assert_eq!(clock.log_resumes(second, last - Duration::from_secs(8)), last, "late");
        clock.log_waits(second, last + Duration::from_secs(3));
        assert_eq!(clock.now(), last);
        assert!(clock.is_due(last + Duration::from_secs(3)));
        clock.log_waits(first, last + Duration::from_secs(2));
        assert_eq!(clock.now(), last + Duration::from_secs(2));
        clock.log_ends(first, last);
        assert_eq!(clock.now(), last + Duration::from_secs(3));
        let far = clock.now() + Duration::from_hours(5);
        assert_eq!(clock.log_resumes(first, far), clock.now(), "not years ahead of the other");
    }

    #[test]
    fn log_read_ahead_ends_at_its_last_frame() {
        let clock = Clock::of_logs(Epoch::default(), 1.0, vec![Some(Instant::ZERO); 2]);
        let (short, long) = (BusIndex(0), BusIndex(1));
        let at = |seconds| Instant::ZERO + Duration::from_secs(seconds);
        clock.log_opens(short, false);
        clock.log_opens(long, false);
        clock.control(PlaybackCommand::ReadTo(Instant::LATEST));
        clock.log_waits(short, at(8));
        clock.log_waits(long, at(38));
        clock.log_ends(short, at(9));
        assert_eq!(clock.now(), at(38), "the long one is not at its end");
        // Its last frames were taken together.
        clock.log_ends(long, at(40));
        assert_eq!(clock.now(), at(40));
        assert_eq!(clock.log_resumes(short, at(9)), at(40), "after all that was taken");
    }

    #[test]
    fn live_clock_is_not_held_up_by_logs() {
        let clock = Clock::start();
        let log = BusIndex(1);
        clock.log_opens(log, false);
        clock.log_ends(log, Instant::ZERO);
        let soon = clock.now() + Duration::from_millis(1);
        assert!(clock.until(soon) < Duration::from_secs(1));
        clock.log_awaits_more(log, clock.now());
        assert!(clock.until(clock.now() + Duration::from_millis(1)) < Duration::from_secs(1));
        assert!(clock.log_resumes(log, far_future()) < far_future());
    }

    fn far_future() -> Instant {
        Instant::ZERO + Duration::from_hours(9)
    }

    #[test]
    fn log_clock_keeps_its_speed_with_close_frames() {
        let clock = Clock::replaying(Epoch::default(), 1.0);
        let log = BusIndex(0);
        clock.log_opens(log, false);
        let at = Instant::from_micros;
        clock.log_waits(log, at(1_000));
        clock.elapse(Duration::from_millis(3));
        assert_eq!(clock.now(), at(1_000), "not beyond the frame");
        clock.log_waits(log, at(2_000));
        assert_eq!(clock.now(), at(2_000), "and with that in time for the next");
        clock.elapse(Duration::from_secs(5));
        clock.log_waits(log, at(3_000_000));
        let now = clock.now();
        assert!(now >= at(2_000) && now < at(2_000_000), "held up for long it goes on: {now}");
    }

    #[test]
    fn live_clock_ignores_playback_commands() {
        let clock = Clock::start();
        clock.control(PlaybackCommand::Pause);
        assert_eq!(clock.playback(), None);
        assert!(clock.until(clock.now() + Duration::from_secs(9)) < Duration::from_secs(10));
    }
}
