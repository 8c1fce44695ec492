//! Wiring from buses, file and recording to the timeline and the events.
//!
//! Does not evaluate frames: the engines do.

use super::buses::{Redundancy, controller_line};
use super::input::Overlay;
use super::notices::{TimelineEntry, event_text, join_lines};
use super::problems::ProblemKey;
use super::stories::StoryChange;
use super::timeline_kind::TimelineKind;
use super::{App, BusSelection, Effect};
use crate::discovery::{DeviceId, Event, EventKind};
use crate::finding::{Finding, FindingKind};
use crate::frame::BusIndex;
use crate::status::{BusState, BusStatus, RecordingStatus};
use crate::time::Instant;
use crate::wire::profile::{Profile, ProfileKey};
use std::path::PathBuf;
use std::sync::Arc;

/// A line of the events of one frame, which a later event may extend.
struct TimelineDraft {
    entry: TimelineEntry,
    /// The event filter matches one of its events.
    passes_filter: bool,
}

/// Devices whose rows an event may have changed without a further event, with its time.
fn rows_changed_by(event: &Event) -> impl Iterator<Item = (Instant, DeviceId)> {
    let (previous, device) = match event.kind {
        EventKind::IdsMerged { previous, .. } => (Some(previous), event.device),
        EventKind::Returned { .. } => (None, event.device),
        _ => (None, None),
    };
    let time = event.time;
    previous.into_iter().chain(device).map(move |device| (time, device))
}

impl App {
    /// Takes the events of the engines.
    pub(super) fn take_events(&mut self) {
        let mut first: Option<Instant> = None;
        for index in 0..self.buses.len() {
            let bus = BusIndex(index as u8);
            // Queued after the last event: several events of one frame may be one line.
            let mut lines = Vec::new();
            let mut changed_rows = Vec::new();
            while let Some(event) = self.buses.poll_event(bus) {
                first = Some(first.map_or(event.time, |first| first.min(event.time)));
                changed_rows.extend(rows_changed_by(&event));
                self.take_event(bus, event, &mut lines);
            }
            for (time, device) in changed_rows {
                self.correct_merged(time, device);
            }
            for line in lines.into_iter().filter(|line| line.passes_filter) {
                let event = self.line_event(&line.entry);
                self.notices.emit(event);
            }
        }
        if let Some(at) = first {
            self.compare_file_soon(at);
            if self.buses.len() > 1 {
                self.refresh_redundancy();
            }
            self.refresh_before_draw();
            self.request_redraw();
        }
    }

    fn take_event(&mut self, bus: BusIndex, event: Event, lines: &mut Vec<TimelineDraft>) {
        if let (EventKind::IdsMerged { previous: was, before }, Some(device)) =
            (&event.kind, event.device)
        {
            self.notices.reassign(*was, *before, device);
        }
        if !self.end_plan_request(bus, &event) {
            self.end_command(bus, &event);
        }
        self.note_sending_event(bus, &event);
        let emits = self.notices.emits_events();
        if !emits {
            self.lane_records.handle_event(&event);
        }
        let is_of_interest = emits && self.notices.is_event_of_interest(&self.buses, bus, &event);
        if let Some((kind, text)) = event_text(&self.buses, bus, &event) {
            let is_new_conflict = matches!(&event.kind, EventKind::Finding { key, .. }
                if key.kind.is_conflict()
                    && kind == TimelineKind::Confirmed
                    && !self.problems.is_muted(&ProblemKey::of(key)));
            let mut entry = TimelineEntry::of_event(bus, &event, kind, text);
            if let EventKind::Finding { key, .. } = &event.kind {
                let finding = self.buses.finding(bus, key);
                entry.other_names = finding.map(|it| it.names.clone()).unwrap_or_default();
            }
            self.notices.note_step(&entry, StoryChange::of_event(&self.buses, bus, &event));
            let may_join =
                matches!(event.kind, EventKind::Moved { .. } | EventKind::Claimed { .. });
            let timeline = self.notices.timeline_mut();
            let amended = if may_join { timeline.amend(&entry, join_lines) } else { None };
            if let Some((before, amended)) = amended {
                let is_it =
                    |line: &TimelineEntry| line.text == before && line.address == amended.address;
                if let Some(at) = lines.iter().rposition(|line| is_it(&line.entry)) {
                    let is_of_interest = lines.remove(at).passes_filter || is_of_interest;
                    lines.push(TimelineDraft { entry: amended, passes_filter: is_of_interest });
                }
            } else {
                timeline.push(entry.clone());
                if emits {
                    lines.push(TimelineDraft { entry, passes_filter: is_of_interest });
                }
            }
            if is_new_conflict {
                self.effects.push_back(Effect::Bell);
            }
        } else if let EventKind::Mode { to, .. } = &event.kind {
            // Part of a story without a line of its own.
            let text = format!("mode {to}");
            let entry = TimelineEntry::of_event(bus, &event, TimelineKind::Change, text);
            self.notices.note_step(&entry, StoryChange::of_event(&self.buses, bus, &event));
        }
        if !is_of_interest {
            return;
        }
        if let EventKind::Finding { key, state } = &event.kind {
            let finding = self.buses.finding(bus, key).cloned();
            let mut finding = finding.unwrap_or_else(|| Finding::new(key.clone(), event.time));
            finding.state = *state;
            let event = self.finding_event(finding, event.time);
            self.notices.emit(event);
        } else if let Some(event) = self.engine_event(bus, event) {
            self.notices.emit(event);
        }
    }

    /// Compares file and buses again and queues the differences that changed.
    pub(super) fn refresh_problems(&mut self) {
        self.refresh_problems_at(self.clock.now());
    }

    /// The same; what changed, changed at `now`.
    pub(super) fn refresh_problems_at(&mut self, now: Instant) {
        let tasks = self.buses.project().tasks.iter();
        let task_due = tasks.flat_map(|task| task.due(&self.buses, now));
        self.file_comparison.note_comparison(now, task_due.filter(|at| *at > now).min());
        let before = self.problems.refresh(&self.buses, self.files.documents(), now);
        if !self.notices.emits_events() {
            return self.note_file_findings(&before, now);
        }
        for finding in self.problems.changes_since(&before, now) {
            let line = TimelineEntry::of_finding(now, &finding);
            if self.notices.passes_filter(&self.buses, &line, &finding.addresses) {
                let events = [self.line_event(&line), self.finding_event(finding, now)];
                for event in events {
                    self.notices.emit(event);
                }
            }
        }
    }

    /// Adds the differences from des.json that changed to the stories; not devices without an entry,
    /// whose stories begin with their joining.
    fn note_file_findings(&mut self, before: &[Finding], now: Instant) {
        let changes = self.problems.changes_since(before, now);
        for finding in changes.into_iter().filter(|it| it.key.kind != FindingKind::Unlisted) {
            let entry = TimelineEntry::of_finding(now, &finding);
            let Finding { key, state, text, .. } = finding;
            let (parties, since, until) = (Vec::new(), None, now);
            let change = StoryChange::Finding { key, state, parties, text, since, until };
            self.notices.note_step(&entry, change);
        }
    }

    /// Updates which devices are on several buses and reports what changed.
    pub(super) fn refresh_redundancy(&mut self) {
        for (one, other, redundancy) in self.buses.refresh_redundancy() {
            let Some(text) = self.redundancy_text(one, other, redundancy) else { continue };
            let mut line =
                TimelineEntry::new(self.clock.now(), TimelineKind::Bus, text).on(one.bus);
            if let Some(device) = self.buses.device(one) {
                line.device = Some(one);
                line.address = Some(device.address);
                line.name.clone_from(&device.name);
            }
            self.report_line(line);
        }
    }

    fn redundancy_text(
        &self,
        one: DeviceId,
        other: DeviceId,
        redundancy: Redundancy,
    ) -> Option<String> {
        let place = |id: DeviceId| {
            let (device, bus) = (self.buses.device(id)?, self.buses.unique_name(id.bus));
            Some(format!("{bus} @{}", device.address))
        };
        let (here, there) = (place(one)?, place(other)?);
        match redundancy {
            Redundancy::Redundant => {
                Some(format!("on {here} and {there}, same services: redundant"))
            }
            Redundancy::TwoNetworks => {
                Some(format!("on {here} and {there}, different services: separate networks"))
            }
            Redundancy::Undetermined => None,
        }
    }

    /// Handles a new status of a bus.
    pub(super) fn bus_changed(&mut self, index: BusIndex, mut status: BusStatus) {
        let now = self.clock.now();
        let changes_before = self.buses.get(index).map(|bus| bus.status.log_changes);
        let is_another_log = changes_before.is_some_and(|before| before < status.log_changes);
        status.is_sending_paused = self.bus_choice.is_some();
        let Some(change) = self.buses.update_status(now, index, status) else { return };
        if is_another_log {
            let entry = TimelineEntry::new(now, TimelineKind::Bus, "another log begins").on(index);
            self.notices.end_stories(index, &entry);
        }
        let is_news = !change.lines.is_empty() || change.has_other_state;
        for (kind, text) in change.lines {
            self.report_line(TimelineEntry::new(now, kind, text).on(index));
        }
        if is_news
            && self.notices.emits_events()
            && let Some(event) = self.bus_event(index, now)
        {
            self.notices.emit(event);
        }
        self.take_events();
        self.compare_file_soon(now);
        self.refresh_before_draw();
        if self.clock.playback().is_some_and(|it| it.is_standing()) {
            // The time of a later draw would not come.
            self.notices.redraw.set_dirty();
        } else {
            self.request_redraw();
        }
    }

    /// Reports another state of the controller of a bus, from error frames: the port does not know it.
    pub(super) fn controller_changed(&mut self, index: BusIndex, before: BusState) {
        let now = self.clock.now();
        let Some(bus) = self.buses.get(index) else { return };
        let is_back = before == BusState::BusOff;
        let back = || is_back.then(|| (TimelineKind::Bus, "on the bus again".to_owned()));
        if let Some((kind, text)) = controller_line(bus.controller()).or_else(back) {
            self.report_line(TimelineEntry::new(now, kind, text).on(index));
        }
        if self.notices.emits_events()
            && let Some(event) = self.bus_event(index, now)
        {
            self.notices.emit(event);
        }
        // After bus-off, time goes on for what needs listening.
        self.compare_file_soon(now);
        self.refresh_before_draw();
        self.request_redraw();
    }

    /// Takes a profile that was saved. Frames are read by it from now on; logs are opened again.
    pub(super) fn profile_changed(&mut self, name: &str, profile: &Arc<Profile>) {
        let now = self.clock.now();
        let Some(before) = self.buses.iter().next().map(|bus| bus.config().profile.clone()) else {
            return;
        };
        if self.clock.playback().is_some() && profile.reads_otherwise(&before) {
            if self.logs.is_empty() {
                return self.show_info(format!("{name} changed: read the frames again with it"));
            }
            return self.reopen_logs(None);
        }
        let changes: Vec<String> = ProfileKey::ALL
            .iter()
            .filter(|key| profile.differs_in(**key, &before))
            .map(|key| match (before.value(*key), profile.value(*key)) {
                (old, new) if old == new => {
                    format!("{} {}", key.name(), profile.origin(*key).word())
                }
                (old, new) => format!("{} {old} → {new}", key.name()),
            })
            .collect();
        if changes.is_empty() {
            return;
        }
        self.learners.set_profile(profile.clone());
        let over = self.buses.set_profile(now, profile);
        self.traffic.take_profile();
        self.take_events();
        for index in &over {
            let entry = TimelineEntry::new(now, TimelineKind::Bus, "another profile").on(*index);
            self.notices.end_stories(*index, &entry);
        }
        let what = if over.is_empty() { "" } else { "; devices start over" };
        let text = format!("{name}: {}{what}", changes.join(", "));
        self.add_line_to_all_buses(TimelineKind::File, &text);
        self.show_info(text);
        self.refresh_before_draw();
        self.notices.redraw.set_dirty();
    }

    /// Opens the logs again, with the profile of a file; `None`: of the one before.
    pub(super) fn reopen_logs(&mut self, profile: Option<PathBuf>) {
        let logs = self.logs.iter().map(|path| format!("file:{}", path.display()));
        let buses = logs.collect();
        let again = BusSelection { buses, replaces: true, profile, ..BusSelection::default() };
        self.effects.push_back(Effect::OpenBuses(again));
    }

    /// Adds a line of each bus to the timeline.
    pub(super) fn add_line_to_all_buses(&mut self, kind: TimelineKind, text: &str) {
        let now = self.clock.now();
        for index in (0..self.buses.len()).map(|index| BusIndex(index as u8)) {
            self.report_line(TimelineEntry::new(now, kind, text.to_owned()).on(index));
        }
    }

    /// Takes the state of the recording; reports its start, its first lost frames and its failure.
    pub(super) fn recording_changed(&mut self, status: RecordingStatus) {
        let before = self.traffic.set_recording(status.clone());
        let had_failed = before.as_ref().is_some_and(|before| before.failure.is_some());
        let had_lost = before.as_ref().is_some_and(|before| before.lost > 0);
        let is_another = before.is_none_or(|before| before.path != status.path);
        let (kind, text) = match status.failure {
            Some(_) if had_failed => return,
            Some(why) => {
                (TimelineKind::Error, format!("recording to {} stopped: {why}", status.path))
            }
            None if status.lost > 0 && !had_lost => {
                (TimelineKind::Error, "recorder too slow: frames missing from the file".to_owned())
            }
            None if is_another => {
                let filter = status.filter.map(|filter| format!(" (filter {filter})"));
                let text = format!("recording to {}{}", status.path, filter.unwrap_or_default());
                (TimelineKind::File, text)
            }
            None => return self.request_redraw(),
        };
        if kind == TimelineKind::Error {
            self.show_error(text.clone());
        }
        let mut line = TimelineEntry::new(self.clock.now(), kind, text);
        line.name = Some("recording".into());
        self.report_line(line);
        self.notices.redraw.set_dirty();
    }

    /// Quits if the question whether to quit is open and all edits are saved by now.
    pub(super) fn quit_if_saved(&mut self) {
        let asks = matches!(self.overlay(), Overlay::Question(super::Question::Quit));
        if asks && self.files.unsaved() == 0 {
            self.input.close();
            self.quit();
        }
    }
}
