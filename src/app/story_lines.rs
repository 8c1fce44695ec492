//! The lines of the Timeline page: a line for each story, and for each step of those that are open.
//!
//! Inputs: the stories, the filter, the kinds that are hidden, the moment that is shown. Output: the
//! lines as of that moment. Does not know how they are drawn.

use super::filter::Filter;
use super::input::Overlay;
use super::notices::TimelineEntry;
use super::stories::{HiddenKinds, Stories, Story, StoryKind, StoryLine, StoryStep};
use super::{App, Page, clock_millis, growing_length_text, length_text};
use crate::text::Name;
use crate::time::Instant;

/// Identity of a line of the Timeline page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LineKey {
    /// Number of the story.
    pub story: u64,
    /// Number of a step; 0: the story itself.
    pub step: u32,
}

impl LineKey {
    /// The line of a story.
    pub const fn of_story(story: u64) -> Self {
        Self { story, step: 0 }
    }
}

impl App {
    /// The stories of the timeline.
    pub fn stories(&self) -> &Stories {
        self.notices.stories()
    }

    /// Lines of the Timeline page that match the filter and the kinds, oldest first.
    pub fn lines_shown(&self) -> Vec<LineKey> {
        let at = self.shown_time();
        let hidden = self.view.hidden_kinds;
        let mut lines = Vec::new();
        for story in self.stories_in_filter(at) {
            if !hidden.is_empty() && hidden.contains(story.kind(at)) {
                continue;
            }
            lines.push(LineKey::of_story(story.id));
            if self.view.open_stories.contains(&story.id) {
                let steps = story.steps_until(at).map(|step| step.number);
                lines.extend(steps.map(|step| LineKey { story: story.id, step }));
            }
        }
        lines
    }

    /// Stories that have begun at a moment and match the filter.
    fn stories_in_filter(&self, at: Instant) -> impl Iterator<Item = &Story> {
        let filter = self.filters.of(Page::Timeline).active();
        let begun = self.stories().iter().take_while(move |story| story.begin() <= at);
        begun.filter(move |story| {
            filter.is_none_or(|filter| {
                let mut steps = story.steps_until(at);
                steps.any(|step| filter.matches_entry(self.shown_buses(), &step.entry))
            })
        })
    }

    /// Number of stories that match a filter, and of all, as of the moment that is shown.
    pub(super) fn count_stories(&self, filter: &Filter) -> (usize, usize) {
        let at = self.shown_time();
        let begun = self.stories().iter().take_while(|story| story.begin() <= at);
        begun.fold((0, 0), |(matching, all), story| {
            let mut steps = story.steps_until(at);
            let is_match = steps.any(|step| filter.matches_entry(self.shown_buses(), &step.entry));
            (matching + usize::from(is_match), all + 1)
        })
    }

    /// Number of stories that match the filter, of each kind, as of the moment that is shown.
    pub fn kind_counts(&self) -> [usize; StoryKind::ALL.len()] {
        let at = self.shown_time();
        let mut counts = [0; StoryKind::ALL.len()];
        for story in self.stories_in_filter(at) {
            counts[story.kind(at) as usize] += 1;
        }
        counts
    }

    /// Number of stories that have begun at the moment that is shown.
    pub(super) fn story_count(&self) -> usize {
        let at = self.shown_time();
        self.stories().iter().take_while(|story| story.begin() <= at).count()
    }

    /// Kinds of stories that are hidden.
    pub fn hidden_kinds(&self) -> HiddenKinds {
        self.view.hidden_kinds
    }

    /// The story of a line; `None` if it was dropped, or begins later than the shown moment.
    pub fn story(&self, key: LineKey) -> Option<&Story> {
        self.stories().get(key.story).filter(|story| story.begin() <= self.shown_time())
    }

    /// The line of a story as of the moment that is shown.
    pub fn story_line(&self, story: &Story) -> Option<StoryLine> {
        story.line(self.shown_time(), |time| clock_millis(self, time))
    }

    /// The event that names what a story is about.
    pub fn story_subject<'a>(&'a self, story: &'a Story) -> (&'a TimelineEntry, Option<&'a Name>) {
        let entry = story.subject(self.shown_time());
        (entry, self.name_on_line(entry))
    }

    /// Length of a story as of the moment that is shown: of one that goes on in whole seconds; `None`
    /// for a single moment.
    pub fn story_length(&self, line: &StoryLine) -> Option<String> {
        match line.to {
            Some(to) if to == line.from => None,
            Some(to) => Some(length_text(to.since(line.from))),
            None => Some(growing_length_text(self.display_time().since(line.from))),
        }
    }

    /// The stories that changed last until the moment that is shown, at most `most` of those that are
    /// wanted, with the time of the change, oldest first.
    pub fn latest_stories(
        &self,
        most: usize,
        is_wanted: impl Fn(&Story) -> bool,
    ) -> Vec<(&Story, Instant)> {
        let at = self.shown_time();
        let begun = self.stories().iter().take_while(|story| story.begin() <= at);
        let wanted = begun.filter(|story| is_wanted(story));
        let mut latest: Vec<(&Story, Instant)> =
            wanted.filter_map(|story| Some((story, story.last_change(at)?))).collect();
        latest.sort_by_key(|(_, time)| *time);
        latest.split_off(latest.len().saturating_sub(most))
    }

    /// The stories about buses that changed last, with the time of the change, oldest first.
    pub fn latest_bus_stories(&self, most: usize) -> Vec<(&Story, Instant)> {
        self.latest_stories(most, |story| {
            let entry = story.subject(self.shown_time());
            let is_of_device = entry.device.is_some() || entry.address.is_some();
            entry.bus.is_some() && !is_of_device && entry.name.is_none()
        })
    }

    /// Number of occurrences of a step, and the time of the last one, as of the moment that is shown.
    pub fn step_times(&self, step: &StoryStep) -> (u32, Instant) {
        let at = self.shown_time();
        (step.times(at), step.last(at))
    }

    /// Returns true if a line of the open page becomes longer with time, or the axis of its lanes.
    pub(super) fn grows_on_timeline(&self) -> bool {
        self.view.page == Page::Timeline
            && self.past.is_none()
            && self.buses.iter().any(|bus| bus.ended.is_none())
            && (self.shows_lanes() || self.stories().has_open(self.clock.now()))
    }

    // ---- commands --------------------------------------------------------------------------

    /// The selected line, or the last one.
    pub(super) fn selected_line_key(&self) -> Option<LineKey> {
        let selected = self.view.timeline.selected().copied();
        selected.or_else(|| self.lines_shown().last().copied())
    }

    /// The event of the selected line, or of the last one; of a story the first one, or its first
    /// finding.
    pub(super) fn selected_line(&self) -> Option<&TimelineEntry> {
        let key = self.selected_line_key()?;
        let story = self.story(key)?;
        if let Some(step) = story.step(key.step) {
            return Some(&step.entry);
        }
        let mut steps = story.steps_until(self.shown_time());
        let finding = steps.find(|step| step.entry.finding.is_some());
        finding.or(story.steps().first()).map(|step| &step.entry)
    }

    /// The moment of the selected line, or of the last one: the first step of a story.
    pub(super) fn selected_line_time(&self) -> Option<(LineKey, Instant)> {
        let key = self.selected_line_key()?;
        let story = self.story(key)?;
        Some((key, story.step(key.step).map_or(story.begin(), |step| step.entry.time)))
    }

    /// Shows the moment of the selected line.
    pub(super) fn go_to_line(&mut self) {
        if let Some((key, time)) = self.selected_line_time() {
            self.view.timeline.select(key);
            self.go_to_time(time);
        }
    }

    /// The selected line as text: times, length, who, what.
    pub(super) fn line_text(&self) -> Option<String> {
        let key = *self.view.timeline.selected()?;
        let story = self.story(key)?;
        if let Some(step) = story.step(key.step) {
            return Some(format!("{} {}", clock_millis(self, step.entry.time), step.entry.text));
        }
        let line = self.story_line(story)?;
        let (entry, name) = self.story_subject(story);
        let name = name.map(ToString::to_string);
        let who = match (entry.address, name) {
            (Some(address), name) => format!(" {}@{address}", name.as_deref().unwrap_or("?")),
            (None, Some(name)) => format!(" {name}"),
            (None, None) => String::new(),
        };
        let from = clock_millis(self, line.from);
        let to = match (line.to, self.story_length(&line)) {
            (Some(to), Some(length)) => format!(" – {} ({length})", clock_millis(self, to)),
            (None, Some(length)) => format!(" – … ({length})"),
            (_, None) => String::new(),
        };
        Some(format!("{from}{to}{who} {}", line.what))
    }

    /// Opens the steps of the selected story, or closes them.
    pub(super) fn toggle_story(&mut self) {
        let keys = self.lines_shown();
        let height = self.list_height();
        self.view.hold_timeline(&keys, height);
        let Some(id) = self.view.timeline.selected().map(|key| key.story) else {
            return self.show_error("no line is selected");
        };
        self.view.timeline.select(LineKey::of_story(id));
        if !self.view.open_stories.remove(&id) {
            // Stories that were dropped meanwhile.
            let stories = self.notices.stories();
            self.view.open_stories.retain(|id| stories.get(*id).is_some());
            self.view.open_stories.insert(id);
            // Its steps may be below the screen.
            let steps = self.lines_shown().iter().filter(|key| key.story == id).count();
            self.view.timeline.make_room(steps.saturating_sub(1), height);
        }
    }

    /// Opens the list of kinds.
    pub(super) fn list_kinds(&mut self) {
        if self.view.page == Page::Timeline {
            self.input.open(Overlay::Kinds(0));
        } else {
            self.show_error("kinds are on the Timeline page");
        }
    }

    /// Selects the next kind of the list, or with -1 the one before.
    pub(super) fn move_in_kinds(&mut self, by: isize) {
        if let Overlay::Kinds(at) = *self.input.overlay() {
            let last = StoryKind::ALL.len() - 1;
            self.input.open(Overlay::Kinds(at.saturating_add_signed(by).min(last)));
        }
    }

    /// Hides the selected kind or shows it again; or does that for all others.
    pub(super) fn toggle_kind(&mut self, others: bool) {
        let Overlay::Kinds(at) = *self.input.overlay() else { return };
        let Some(kind) = StoryKind::ALL.get(at).copied() else { return };
        if others {
            self.view.hidden_kinds.toggle_others(kind);
        } else {
            self.view.hidden_kinds.toggle(kind);
        }
        let (keys, height) = (self.lines_shown(), self.list_height());
        if self.view.timeline.selected().is_some() {
            self.view.timeline.update(&keys, height);
        }
    }
}
