//! What the program reports: the status message, the timeline, the events of `watch`, and when the
//! screen is to be drawn.
//!
//! Inputs: texts and events with their time. Outputs: the message and the lines to show, the queue
//! of [`AppEvent`]s, redraw deadlines.

mod event_text;
mod redraw;
pub(super) mod timeline;

pub(super) use event_text::{
    changes_of, device_label, event_text, join_lines, join_short, uid_text,
};
pub use event_text::{event_word, whose_other_services, whose_services};
pub(super) use redraw::{BUS_REDRAW_INTERVAL, Redraw};
pub use timeline::{Timeline, TimelineEntry};

use super::timeline_kind::TimelineKind;

use super::AppEvent;
use super::buses::Buses;
use super::filter::Filter;
use super::stories::{Stories, StoryChange};
use crate::discovery::{DeviceId, Event, EventKind, Presence};
use crate::finding::FindingKind;
use crate::frame::BusIndex;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::collections::VecDeque;

/// Time for which the status message is shown.
const MESSAGE_TIME: Duration = Duration::from_secs(6);
/// Capacity of the event queue; later events are dropped.
const EVENT_CAPACITY: usize = 65_536;

/// A message in the footer, shown for 6 s or until the next key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StatusMessage {
    /// Text, for the user.
    pub text: String,
    /// Returns true if an action failed.
    pub is_error: bool,
    /// The text is about the content of des.json and is withdrawn when that changes.
    is_of_file: bool,
    until: Instant,
}

/// Messages, timeline, events and redraw deadlines.
#[derive(Debug)]
pub(super) struct Notices {
    message: Option<StatusMessage>,
    timeline: Timeline,
    stories: Stories,
    /// Events are queued for [`super::App::poll_app_event`].
    emits_events: bool,
    /// Events about devices are queued only where this matches.
    event_filter: Filter,
    events: VecDeque<AppEvent>,
    pub redraw: Redraw,
}

impl Notices {
    /// Returns an empty timeline and an empty queue.
    pub fn new(now: Instant, emits_events: bool, event_filter: Filter) -> Self {
        Self {
            message: None,
            timeline: Timeline::default(),
            stories: Stories::default(),
            emits_events,
            event_filter,
            events: VecDeque::new(),
            redraw: Redraw::new(now),
        }
    }

    // ---- the status message ----------------------------------------------------------------

    /// The message to show.
    pub fn message(&self) -> Option<&StatusMessage> {
        self.message.as_ref()
    }

    fn show(&mut self, now: Instant, text: String, is_error: bool, is_of_file: bool) {
        let until = now + MESSAGE_TIME;
        self.message = Some(StatusMessage { text, is_error, is_of_file, until });
        self.redraw.set_dirty();
    }

    /// Shows a message.
    pub fn info(&mut self, now: Instant, text: impl Into<String>) {
        self.show(now, text.into(), false, false);
    }

    /// Shows an error.
    pub fn error(&mut self, now: Instant, text: impl Into<String>) {
        self.show(now, text.into(), true, false);
    }

    /// Shows a message about the content of des.json.
    pub fn file_info(&mut self, now: Instant, text: impl Into<String>) {
        self.show(now, text.into(), false, true);
    }

    /// Shows an error about the content of des.json.
    pub fn file_error(&mut self, now: Instant, text: impl Into<String>) {
        self.show(now, text.into(), true, true);
    }

    /// Removes the message.
    pub fn clear_message(&mut self) {
        self.message = None;
    }

    /// Removes a message that is over at `now`.
    pub fn expire(&mut self, now: Instant) {
        if self.message.take_if(|message| message.until <= now).is_some() {
            self.redraw.set_dirty();
        }
    }

    /// Removes a message about the content of des.json after a change on disk; where the edits were
    /// reapplied to the new content, a message that is not an error stays true.
    pub fn clear_file_message(&mut self, is_rebased: bool) {
        self.message.take_if(|it| it.is_of_file && (it.is_error || !is_rebased));
    }

    /// Takes the message if it reports a successful edit.
    pub fn take_edit_message(&mut self) -> Option<StatusMessage> {
        self.message.take_if(|it| it.is_of_file && !it.is_error)
    }

    /// Shows a message that was taken before.
    pub fn restore_message(&mut self, message: StatusMessage) {
        self.message = Some(message);
    }

    // ---- the timeline and the events -------------------------------------------------------

    /// The lines.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// The lines, for changes.
    pub fn timeline_mut(&mut self) -> &mut Timeline {
        &mut self.timeline
    }

    /// The stories that the events belong to; none where events are queued.
    pub fn stories(&self) -> &Stories {
        &self.stories
    }

    /// Adds a line to the timeline.
    pub fn push_line(&mut self, entry: TimelineEntry) {
        self.note_step(&entry, StoryChange::Text);
        self.timeline.push(entry);
    }

    /// Inserts a line at its time.
    pub fn insert_line(&mut self, entry: TimelineEntry) {
        self.note_step(&entry, StoryChange::Text);
        self.timeline.insert(entry);
    }

    /// Adds an event to the story that it belongs to.
    pub fn note_step(&mut self, entry: &TimelineEntry, change: StoryChange) {
        // They are for the screen.
        if self.emits_events {
            return;
        }
        if let (StoryChange::Presence(Presence::Lost), Some(device)) = (&change, entry.device) {
            self.stories.end_modes(entry, device);
        }
        self.stories.push(entry.clone(), change);
    }

    /// Adds what is known about a device to its stories that go on.
    pub fn correct_stories(
        &mut self,
        entry: &TimelineEntry,
        presence: Presence,
        mode: Option<Mode>,
    ) {
        self.stories.correct(entry, presence, mode);
    }

    /// Ends the stories of a bus on which another log begins.
    pub fn end_stories(&mut self, bus: BusIndex, entry: &TimelineEntry) {
        self.stories.end_all(bus, entry);
    }

    /// Removes the line of the mark with this letter.
    pub fn remove_mark(&mut self, letter: char) {
        self.timeline.remove_mark(letter);
        self.stories.remove_mark(letter);
    }

    /// Assigns the lines of `was`, those before `before` if given, to `device`.
    pub fn reassign(&mut self, was: DeviceId, before: Option<Instant>, device: DeviceId) {
        self.timeline.reassign(was, before, device);
        self.stories.reassign(was, before, device);
    }

    /// Returns true if events are queued, as for `watch`.
    pub fn emits_events(&self) -> bool {
        self.emits_events
    }

    /// Returns true if events are not filtered.
    pub fn is_unfiltered(&self) -> bool {
        self.event_filter.is_empty()
    }

    /// Queues an event, where events are wanted and the queue is not full.
    pub fn emit(&mut self, event: AppEvent) {
        if self.emits_events && self.events.len() < EVENT_CAPACITY {
            self.events.push_back(event);
        }
    }

    /// The last events that wait, at most `count`, the newest first.
    pub fn recent_events(&mut self, count: usize) -> impl Iterator<Item = &mut AppEvent> {
        self.events.iter_mut().rev().take(count)
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<AppEvent> {
        self.events.pop_front()
    }

    /// Returns true if the event filter matches a line, at its own address or at one of `others`.
    /// Lost frames, lines about the state of a bus, and errors of the program always match: they
    /// matter to a filter for one device, too.
    pub fn passes_filter(&self, buses: &Buses, line: &TimelineEntry, others: &[Address]) -> bool {
        let is_of_device = line.address.is_some() || line.device.is_some();
        let is_of_bus = line.bus.is_some()
            && line.name.is_none()
            && line.finding.is_none_or(|kind| kind == FindingKind::FramesLost);
        self.event_filter.is_empty()
            || (!is_of_device && (is_of_bus || line.kind == TimelineKind::Error))
            || self.event_filter.matches_entry_of(buses, line, others)
    }

    /// Returns true if the event filter matches an engine event.
    pub fn is_event_of_interest(&self, buses: &Buses, bus: BusIndex, event: &Event) -> bool {
        if self.event_filter.is_empty() {
            return true;
        }
        let text = event_text(buses, bus, event);
        let (kind, text) = text.unwrap_or((TimelineKind::Change, String::new()));
        let mut line = TimelineEntry::of_event(bus, event, kind, text);
        let others: &[Address] = match &event.kind {
            EventKind::Moved { from } => &[*from],
            EventKind::Finding { key, .. } => {
                let finding = buses.finding(bus, key);
                let names = finding.map(|finding| finding.names.clone());
                line.other_names.extend(names.unwrap_or_default());
                finding.map_or(&[], |finding| &finding.addresses)
            }
            _ => &[],
        };
        self.passes_filter(buses, &line, others)
    }

    /// The moment at which the message is over or a redraw is due.
    pub fn poll_timeout(&self) -> Option<Instant> {
        let message = self.message.as_ref().map(|message| message.until);
        message.into_iter().chain(self.redraw.poll_timeout()).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::filter::RowKind;
    use crate::finding::{Finding, FindingKey};

    const NOW: Instant = Instant::ZERO;

    fn notices(filter: &str) -> Notices {
        Notices::new(NOW, true, Filter::parse(filter, RowKind::Event).unwrap())
    }

    #[test]
    fn message_expires_after_six_seconds() {
        let mut notices = notices("");
        notices.info(NOW, "saved");
        notices.redraw.take_dirty(NOW);
        assert_eq!(notices.poll_timeout(), Some(NOW + MESSAGE_TIME));
        notices.expire(NOW + Duration::from_secs(5));
        assert_eq!(notices.message().map(|it| &*it.text), Some("saved"));
        notices.expire(NOW + MESSAGE_TIME);
        assert!(notices.message().is_none() && notices.redraw.is_dirty());
    }

    #[test]
    fn file_error_is_withdrawn_when_file_changes() {
        let mut notices = notices("");
        notices.file_info(NOW, "address 12");
        notices.clear_file_message(true);
        assert!(notices.message().is_some(), "reapplied edits keep it true");
        notices.file_error(NOW, "not saved");
        notices.clear_file_message(true);
        assert!(notices.message().is_none());
        notices.info(NOW, "sorted by name");
        notices.clear_file_message(false);
        assert!(notices.message().is_some());
    }

    #[test]
    fn bus_lines_pass_every_event_filter() {
        let notices = notices("at:12");
        let buses = Buses::new(NOW, Vec::new());
        let line = |text| TimelineEntry::new(NOW, TimelineKind::File, text);
        assert!(!notices.passes_filter(&buses, &line("listed"), &[]));
        assert!(notices.passes_filter(&buses, &line("down").on(BusIndex(0)), &[]));
    }

    #[test]
    fn suspicion_about_a_bus_passes_its_own_state_only() {
        let buses = Buses::new(NOW, Vec::new());
        let line = |kind| {
            let (bus, address, name) = (Some(BusIndex(0)), None, None);
            let key = FindingKey { kind, bus, address, name, fault: None };
            TimelineEntry::of_finding(NOW, &Finding::new(key, NOW))
        };
        let errors = line(FindingKind::BusErrors);
        assert!(!notices("is:confirmed").passes_filter(&buses, &errors, &[]));
        assert!(notices("is:suspected").passes_filter(&buses, &errors, &[]));
        let lost = line(FindingKind::FramesLost);
        assert!(notices("is:confirmed").passes_filter(&buses, &lost, &[]));
    }
}
