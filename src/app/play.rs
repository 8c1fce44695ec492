//! Playing: the shown moment moves by itself, forwards or backwards, at any pace; and reading a log
//! ahead to a moment that was not reached yet.
//!
//! In real time, whatever the pace of a log. Capture, discovery and the file go on meanwhile. Does not
//! know how a moment is replayed.

use super::history::Moment;
use super::{App, Effect, TimelineKind};
use crate::keymap::Action;
use crate::status::{Playback, PlaybackCommand};
use crate::time::{Duration, Instant};

/// Real time between two moments that are shown: four screens a second can be read, over a slow line
/// too.
const STEP: Duration = Duration::from_millis(250);
/// Slowest and fastest pace, as powers of two.
const PACES: std::ops::RangeInclusive<i8> = -3..=10;

/// Pace of playing: 1/8 to 1024 times as fast as it happened, in either direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlayPace {
    is_backwards: bool,
    /// Power of two.
    power: i8,
}

impl PlayPace {
    /// As it happened.
    const FORWARDS: Self = Self { is_backwards: false, power: 0 };
    const BACKWARDS: Self = Self { is_backwards: true, power: 0 };

    /// Seconds that pass in a second; negative backwards.
    pub fn factor(self) -> f64 {
        let factor = f64::from(self.power).exp2();
        if self.is_backwards { -factor } else { factor }
    }

    /// Returns the next pace forwards (`by` 1) or backwards (-1): beyond 1/8 the direction changes.
    fn next(self, by: i8) -> Self {
        let step = if self.is_backwards { -by } else { by };
        match self.power + step {
            power if power < *PACES.start() => {
                Self { is_backwards: !self.is_backwards, power: *PACES.start() }
            }
            power => Self { power: power.min(*PACES.end()), ..self },
        }
    }
}

/// The moment moves at a pace since it was `from` at the real time `since`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Play {
    pace: PlayPace,
    since: Instant,
    from: Instant,
    /// Real time of the next step.
    due: Instant,
}

impl Play {
    fn begin(pace: PlayPace, from: Instant, real: Instant) -> Self {
        Self { pace, since: real, from, due: real + STEP }
    }

    /// The moment at a real time.
    fn moment(&self, real: Instant) -> Instant {
        let by = real.since(self.since).mul_f64(self.pace.factor().abs());
        if self.pace.is_backwards { self.from - by } else { self.from + by }
    }

    /// Real time of the next step.
    pub fn due(&self) -> Instant {
        self.due
    }
}

/// How far a log is read at first to find something: what is read is the present afterwards.
const SEEK_STEP: Duration = Duration::from_secs(2);
/// How far it is read at most before the next look.
const MAX_SEEK_STEP: Duration = Duration::from_mins(10);

/// What a log is read up to.
#[derive(Clone, Copy, Debug)]
pub(super) enum ReadingGoal {
    /// The first event after a moment, of the kinds that are selected.
    Event { from: Instant, is_wanted: fn(TimelineKind) -> bool },
    /// The frame with this number, counted from 0.
    Frame(u64),
}

impl App {
    /// Pace at which the shown moment moves; `None` if it stands, or is the present.
    pub fn play_pace(&self) -> Option<PlayPace> {
        self.play.map(|play| play.pace)
    }

    /// Returns true if all buses are logs.
    pub(super) fn is_of_logs(&self) -> bool {
        self.clock.playback().is_some()
    }

    /// Freezes the present moment, or plays a paused log; while a past moment is shown, shows the
    /// present, stops playing, or plays a log.
    pub(super) fn toggle_freeze(&mut self) {
        let is_paused = self.clock.playback().is_some_and(|it| it.is_paused && !it.is_ended);
        if self.past.is_none() && is_paused && self.reading_ahead.is_none() {
            self.is_log_held = false;
            self.effects.push_back(Effect::Playback(PlaybackCommand::SetPaused(false)));
        } else if self.past.is_none() {
            self.freeze();
        } else if self.play.is_some() {
            self.stop_playing();
        } else if self.is_of_logs() {
            self.play(PlayPace::FORWARDS);
        } else {
            self.show_present();
        }
    }

    /// Key that shows the present: of a log, the one that freezes plays it.
    pub(super) fn key_of_present(&self) -> String {
        self.key_of(if self.is_of_logs() { Action::Cancel } else { Action::Freeze })
    }

    /// Changes the pace: of the shown moment if that is past, else of the log.
    pub(super) fn change_pace(&mut self, by: i8) {
        // A pace that was raised is lowered first.
        let is_slow = |it: Playback| it.is_paused && !it.is_ended && it.speed <= 1.0;
        let is_backwards = by < 0 && self.clock.playback().is_some_and(is_slow);
        if self.past.is_none() && self.is_of_logs() && !is_backwards {
            let faster = by > 0;
            let command = if faster { PlaybackCommand::Faster } else { PlaybackCommand::Slower };
            return self.control_playback(command);
        }
        if self.past.is_none() && by > 0 {
            let key = self.key_of(Action::Freeze);
            return self.show_error(format!("live: {key} freezes; then a moment can be played"));
        }
        if self.past.is_none() {
            self.freeze();
        }
        let pace = match (self.play, by > 0) {
            (Some(play), _) => play.pace.next(by),
            (None, true) => PlayPace::FORWARDS,
            (None, false) => PlayPace::BACKWARDS,
        };
        self.play(pace);
    }

    fn play(&mut self, pace: PlayPace) {
        let from = self.shown_or_target().time;
        self.play = Some(Play::begin(pace, from, self.clock.real()));
        // The keys of playing stand in the place of a message.
        self.notices.clear_message();
        self.notices.redraw.set_dirty();
    }

    /// Stops playing: the shown moment stays.
    pub(super) fn stop_playing(&mut self) {
        self.play = None;
        self.notices.redraw.set_dirty();
    }

    /// Shows the next moment if it is due.
    pub(super) fn go_on_playing(&mut self) {
        let real = self.clock.real();
        let Some(play) = &mut self.play else { return };
        if real < play.due {
            return;
        }
        play.due = real + STEP;
        let (at, is_backwards) = (play.moment(real), play.pace.is_backwards);
        if self.replay.is_some() {
            // The moment before is not shown yet: the next step is longer.
            return;
        }
        let begin = self.buses.begin(&self.traffic.capture);
        if is_backwards && at <= begin {
            self.play = None;
            self.replay_at(begin);
            self.show_info("first moment that is kept");
        } else if !is_backwards && at >= self.clock.now() {
            self.show_present();
        } else {
            self.replay_at(at);
        }
    }

    // ---- reading a log ahead ---------------------------------------------------------------

    /// Last moment that can be gone to: the present, or the end of a log.
    pub fn last_moment(&self) -> Instant {
        let end = self.clock.playback().filter(|it| !it.is_ended).and_then(|it| it.end);
        end.map_or(self.clock.now(), |end| end.max(self.clock.now()))
    }

    /// The moment to which the log is being read.
    pub fn reading_ahead(&self) -> Option<Instant> {
        self.reading_ahead
    }

    /// Returns true if there is more of a log to be read.
    pub(super) fn can_read_on(&self) -> bool {
        self.is_of_logs() && self.clock.playback().is_some_and(|it| !it.is_ended)
    }

    /// Reads the log up to the next event after a moment, which is shown then.
    pub(super) fn read_to_event(&mut self, from: Instant, is_wanted: fn(TimelineKind) -> bool) {
        self.read_to_goal(ReadingGoal::Event { from, is_wanted });
        self.show_info("reading the log up to the next one; Esc stops");
    }

    /// Reads the log up to a frame, counted from 0, after which it is shown.
    pub(super) fn read_to_frame(&mut self, number: u64) {
        self.read_to_goal(ReadingGoal::Frame(number));
        self.show_info(format!("reading the log up to frame {}; Esc stops", number + 1));
    }

    fn read_to_goal(&mut self, goal: ReadingGoal) {
        self.read_ahead(self.clock.now() + SEEK_STEP);
        self.reading_goal = Some((self.clock.now(), goal));
    }

    /// Reads the log up to a moment, which is shown then.
    pub(super) fn read_ahead(&mut self, to: Instant) {
        self.reading_goal = None;
        self.play = None;
        if self.past.is_some() {
            self.leave_past();
        }
        self.hold_log();
        let at = super::format_time_of_day(self, to);
        self.read_to(to);
        self.show_info(format!("reading the log up to {at}; Esc stops"));
    }

    fn read_to(&mut self, to: Instant) {
        // The last moment is the end, also of a log that has grown.
        let end = self.clock.playback().and_then(|it| it.end);
        let to = if end.is_some_and(|end| to >= end) { Instant::LATEST } else { to };
        self.reading_ahead = Some(to);
        self.effects.push_back(Effect::Playback(PlaybackCommand::ReadTo(to)));
    }

    /// Shows the moment to which the log was read, once it is reached; at the end of the log the present.
    pub(super) fn check_reading(&mut self) {
        let Some(to) = self.reading_ahead else { return };
        let found = self.reading_goal.and_then(|(_, goal)| self.moment_of_goal(goal));
        if let Some(moment) = found {
            (self.reading_ahead, self.reading_goal) = (None, None);
            self.effects.push_back(Effect::Playback(PlaybackCommand::ReadTo(Instant::ZERO)));
            return self.replay_to(moment);
        }
        if self.clock.playback().is_none_or(|it| it.is_ended) {
            self.reading_ahead = None;
            self.leave_past();
            self.release_log();
            match self.reading_goal.take() {
                Some((_, ReadingGoal::Event { .. })) => {
                    self.show_error("no later one: end of the log");
                }
                Some((_, ReadingGoal::Frame(_))) => {
                    let frames = self.traffic.capture.end();
                    self.show_error(format!("no such frame: the log has {frames}"));
                }
                None => self.show_info("end of the log"),
            }
        } else if self.clock.now() >= to {
            if let Some((begin, _)) = self.reading_goal {
                // Each step is longer, so that a long silence is passed quickly.
                let read = to.since(begin);
                self.read_to(to + SEEK_STEP.max(read.min(MAX_SEEK_STEP)));
                return;
            }
            self.reading_ahead = None;
            self.replay_at(to);
        }
    }

    /// The moment of a goal, if it was read.
    fn moment_of_goal(&self, goal: ReadingGoal) -> Option<Moment> {
        let capture = &self.traffic.capture;
        match goal {
            ReadingGoal::Event { from, is_wanted } => {
                let time = self.event_beside(from, 1, is_wanted)?;
                Some(self.buses.moment(capture, time))
            }
            ReadingGoal::Frame(number) => self.buses.moment_after(capture, number),
        }
    }

    /// Stops reading ahead, where the log is; returns false if it is not read ahead.
    pub(super) fn stop_reading(&mut self) -> bool {
        if self.reading_ahead.take().is_none() {
            return false;
        }
        self.reading_goal = None;
        let stop = PlaybackCommand::ReadTo(Instant::ZERO);
        self.effects.push_back(Effect::Playback(stop));
        self.freeze();
        true
    }

    /// Pauses a log that is played: it stays where it is while another moment is shown.
    pub(super) fn hold_log(&mut self) {
        let plays = self.clock.playback().is_some_and(|it| !it.is_paused && !it.is_ended);
        if plays && !self.is_log_held {
            self.is_log_held = true;
            let pause = PlaybackCommand::SetPaused(true);
            self.effects.push_back(Effect::Playback(pause));
        }
    }

    /// Plays the log again if it was paused for another moment.
    pub(super) fn release_log(&mut self) {
        if std::mem::take(&mut self.is_log_held) {
            let resume = PlaybackCommand::SetPaused(false);
            self.effects.push_back(Effect::Playback(resume));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pace_below_an_eighth_changes_direction() {
        let mut pace = PlayPace::FORWARDS;
        let mut factors = Vec::new();
        for _ in 0..6 {
            pace = pace.next(-1);
            factors.push(pace.factor());
        }
        assert_eq!(factors, [0.5, 0.25, 0.125, -0.125, -0.25, -0.5]);
        for _ in 0..4 {
            pace = pace.next(1);
        }
        assert!((pace.factor() - 0.25).abs() < 1e-9, "{pace:?}");
        for _ in 0..20 {
            pace = pace.next(1);
        }
        assert!((pace.factor() - 1024.0).abs() < 1e-9, "{pace:?}");
    }
}
