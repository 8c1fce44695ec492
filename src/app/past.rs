//! The moment that is shown in place of the present one: freezing, and going from moment to moment.
//!
//! Capture, discovery and the file go on meanwhile. Buses, des.json, problems, traffic and timeline
//! are those of the moment.

use super::Page;
use super::capture::StatisticsCount;
use super::file::FileContent;
use super::history::{BusesReplay, Moment};
use super::input::{MomentRange, MomentTarget};
use super::problems::Problems;
use super::stories::Story;
use super::timeline_kind::TimelineKind;
use super::view::Frozen;
use super::{App, Buses, clock_millis};
use crate::status::PlaybackCommand;
use crate::time::Instant;
use std::sync::Arc;

/// Work of a replay in frames between which keys are handled: about 10 ms.
pub(super) const REPLAY_PART: u64 = 50_000;

/// Frames that are counted between keys: about 10 ms in memory.
const COUNT_PART: u64 = 100_000;

/// A past moment, as it was.
#[derive(Debug)]
pub(super) struct Past {
    pub moment: Moment,
    pub buses: Buses,
    pub problems: Problems,
    /// Contents of the des.json files.
    pub contents: Vec<FileContent>,
    /// Statistics of the frames until then, once they are shown.
    pub statistics: Option<StatisticsCount>,
}

impl App {
    /// The moment that is shown, if it is not the present one.
    pub fn past_moment(&self) -> Option<Moment> {
        self.past.as_ref().map(|past| past.moment)
    }

    /// Freezes the present moment.
    pub(super) fn freeze(&mut self) {
        let moment = self.buses.present(self.clock.now());
        let buses = Buses::clone(&self.buses);
        self.hold_log();
        self.show_past(moment, buses);
        let goes_on = self.clock.playback().is_none();
        self.show_info(if goes_on { "frozen; capture continues" } else { "frozen" });
    }

    /// Shows the present again.
    pub(super) fn show_present(&mut self) {
        self.leave_past();
        self.release_log();
        let is_at_end = self.clock.playback().map(|it| it.is_ended);
        self.show_info(match is_at_end {
            None => "live",
            Some(true) => "latest moment of the log",
            Some(false) => "as far as the log was played",
        });
    }

    /// Shows the buses as they are, without a message.
    pub(super) fn leave_past(&mut self) {
        self.play = None;
        self.past = None;
        self.replay = None;
        self.view.frozen = None;
        self.renew_time_bar();
        self.notices.timeline_mut().pin_lines(false);
        self.refresh_for_draw();
        self.filter_frames();
    }

    /// Goes to the event before the moment that is shown, or with 1 to the next one, for which a log is
    /// read on; `is_wanted` selects the kinds of lines.
    pub(super) fn go_to_event(&mut self, by: isize, is_wanted: fn(TimelineKind) -> bool) {
        let from = self.shown_or_target().time;
        match self.event_beside(from, by, is_wanted) {
            Some(time) => self.go_to_time(time),
            None if by < 0 => self.show_error("no earlier one is known"),
            None if self.can_read_on() => self.read_to_event(from, is_wanted),
            None => self.show_error("no later one"),
        }
    }

    /// Time of the event before a moment, or with 1 after it; `None` without one.
    pub(super) fn event_beside(
        &self,
        from: Instant,
        by: isize,
        is_wanted: fn(TimelineKind) -> bool,
    ) -> Option<Instant> {
        // Findings of the comparison with des.json are in stories alone.
        let steps = self.notices.stories().iter().flat_map(Story::steps);
        let findings = steps.map(|step| &step.entry).filter(|entry| entry.finding.is_some());
        let lines = self.timeline().entries().chain(findings);
        let times = lines.filter(|line| is_wanted(line.kind)).map(|line| line.time);
        // A repeated line stands behind later ones.
        if by < 0 {
            times.filter(|time| *time < from).max()
        } else {
            times.filter(|time| *time > from).min()
        }
    }

    /// Goes to the moment after the frame before the last one shown, or with 1 after the next one.
    pub(super) fn go_to_frame(&mut self, by: isize) {
        let shown = self.shown_or_target().frames;
        let capture = &self.traffic.capture;
        let number = if by < 0 {
            capture.numbers_before(shown.saturating_sub(1)).next()
        } else {
            capture.numbers_from(shown).next()
        };
        let moment = number.and_then(|number| self.buses.moment_after(capture, number));
        match moment {
            Some(moment) => self.go_to(moment),
            None if by < 0 => self.show_error("no earlier frame is kept"),
            None => self.show_error("no later frame"),
        }
    }

    /// Goes to the next frame, also to the next one of a log that was not read yet.
    pub(super) fn next_frame(&mut self) {
        let is_last = self.shown_or_target().frames >= self.traffic.capture.end();
        if self.past.is_some() && !(is_last && self.is_of_logs()) {
            return self.go_to_frame(1);
        }
        if self.past.is_some() {
            self.leave_past();
            self.is_log_held = false;
        }
        self.control_playback(PlaybackCommand::Step);
    }

    /// Shows the moment at `time` on all pages, once it is replayed: until then
    /// [`poll_timeout`](Self::poll_timeout) is soon.
    pub fn go_to_time(&mut self, time: Instant) {
        if self.is_of_logs() && time > self.clock.now() {
            return self.read_ahead(time);
        }
        // The end of a log is its present.
        if self.clock.playback().is_some_and(|it| it.is_ended) && time >= self.last_moment() {
            self.show_present();
            return self.show_info("end of the log");
        }
        self.go_to(self.buses.moment(&self.traffic.capture, time));
    }

    /// Shows the moment at `time`, also while playing.
    pub(super) fn replay_at(&mut self, time: Instant) {
        self.replay_to(self.buses.moment(&self.traffic.capture, time));
    }

    /// Moments that can be shown.
    pub(super) fn moment_range(&self) -> MomentRange<'_> {
        let begin = self.buses.begin(&self.traffic.capture);
        MomentRange {
            begin: begin.min(self.clock.now()),
            end: self.last_moment(),
            is_end_known: !self.clock.playback().is_some_and(|it| it.seeks_end),
            shown: self.shown_or_target().time,
            frames: self.traffic.capture.end(),
            has_more_frames: self.can_read_on(),
            wall: self.clock.wall(),
            marks: self.marks.bits(),
        }
    }

    /// Goes to a moment that was typed.
    pub(super) fn go_to_target(&mut self, target: MomentTarget) {
        match target {
            MomentTarget::Time(time) => self.go_to_time(time),
            MomentTarget::Frame(number) => {
                let is_unread = number >= self.traffic.capture.end();
                match self.buses.moment_after(&self.traffic.capture, number) {
                    Some(moment) => self.go_to(moment),
                    None if is_unread => self.read_to_frame(number),
                    None => self.show_error(format!("frame {} is no longer kept", number + 1)),
                }
            }
            MomentTarget::Mark(letter) => {
                if let Some(moment) = self.marks.get(letter).map(|mark| mark.moment) {
                    self.go_to(moment);
                }
            }
        }
    }

    /// The moment that is shown, or is about to be.
    pub(super) fn shown_or_target(&self) -> Moment {
        let replay = self.replay.as_ref().map(BusesReplay::moment);
        let shown = replay.or(self.past_moment());
        shown.unwrap_or_else(|| self.buses.present(self.clock.now()))
    }

    /// Goes to a moment; it is shown when it is replayed.
    pub(super) fn go_to(&mut self, moment: Moment) {
        self.play = None;
        self.reading_ahead = None;
        self.reading_goal = None;
        self.replay_to(moment);
    }

    pub(super) fn replay_to(&mut self, moment: Moment) {
        self.hold_log();
        self.replay = self.buses.replay(&self.traffic.capture, moment);
        if self.replay.is_none() {
            let begin = self.buses.begin(&self.traffic.capture);
            let kept = clock_millis(self, begin);
            return self.show_error(format!("no longer kept: moments from {kept} on are"));
        }
        self.go_on_replaying();
    }

    /// Replays the next part on the way to a moment, and shows the moment when it is reached.
    pub(super) fn go_on_replaying(&mut self) {
        self.replay_due = None;
        let Some(replay) = &mut self.replay else { return };
        if !replay.is_kept(&self.buses, &self.traffic.capture) {
            let moment = replay.moment();
            return self.replay_to(moment);
        }
        if !replay.run(&self.buses, &self.traffic.capture, REPLAY_PART) {
            self.replay_due = Some(self.clock.real() + super::FILTER_PAUSE);
            return;
        }
        if let Some(replay) = self.replay.take() {
            let moment = replay.moment();
            self.show_past(moment, replay.into_buses());
        }
    }

    /// Counts the next frames until the moment that is shown, if its identifiers or calls are. Returns
    /// false if some remain.
    pub(super) fn count_past_frames(&mut self) -> bool {
        let Some(past) = &mut self.past else { return true };
        let is_shown = self.view.shows_identifiers() || self.view.shows_calls();
        // The Bus page has the latency of the calls.
        if !is_shown && self.view.page != Page::Bus {
            return true;
        }
        let Moment { frames, time, .. } = past.moment;
        let count = || self.traffic.count_until(frames, time);
        let count = past.statistics.get_or_insert_with(count);
        count.run(&self.traffic.capture, &past.buses, COUNT_PART)
    }

    /// Returns a past moment, with the buses as they were.
    pub(super) fn past_at(&mut self, moment: Moment, mut buses: Buses) -> Past {
        buses.refresh_redundancy();
        buses.set_catalogue(Arc::clone(self.buses.catalogue()));
        buses.set_messages(Arc::clone(self.buses.messages()));
        buses.set_project(Arc::clone(self.buses.project()));
        let mut problems = self.problems.for_moment(moment.time);
        self.note_content();
        let mut before = self.contents_before.iter();
        let contents = before.find(|(until, _)| *until > moment.time);
        let contents = contents.map_or(&self.contents, |(_, contents)| contents).clone();
        let documents = self.files.documents_of(&contents);
        problems.refresh_for_moment(&buses, documents, moment.time, &self.problems);
        Past { moment, buses, problems, contents, statistics: None }
    }

    fn show_past(&mut self, moment: Moment, buses: Buses) {
        let past = self.past_at(moment, buses);
        self.view.frozen = Some(Frozen { frames: moment.frames });
        self.notices.timeline_mut().pin_lines(true);
        self.past = Some(Box::new(past));
        self.settle_alarm();
        self.renew_time_bar();
        self.settle_problems();
        self.settle_bars();
        self.refresh_rows();
        self.filter_frames();
        self.notices.redraw.set_dirty();
    }
}
