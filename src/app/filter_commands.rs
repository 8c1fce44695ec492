//! Commands of the filter: typing it, switching it, searching with it.

use super::filter::{CompletionSource, Filter, RowKind};
use super::input::{FilterPrompt, Overlay, Prompt, PromptKind};
use super::page_filters::PageFilter;
use super::view::{Page, RowKey, TrafficView};
use super::{App, Completion};
use crate::wire::id::Address;

/// Frames that are searched for the next match at once: a tenth of a second.
const MAX_SEARCHED: usize = 500_000;

impl App {
    /// The filter of a page.
    pub fn page_filter(&self, page: Page) -> &PageFilter {
        self.filters.of(page)
    }

    /// Opens the prompt for the filter of the page.
    pub(super) fn ask_filter(&mut self) {
        self.view.close_evidence();
        let page = self.view.page;
        let before = self.filters.of(page).clone();
        let text = if before.is_on() { before.text().to_owned() } else { String::new() };
        self.open_prompt(PromptKind::Filter(FilterPrompt::new(page, before)), text);
        self.filter_changed();
    }

    /// Sets the filter of a page to a line that may have a mistake: then it stays as it was.
    pub(super) fn set_filter(&mut self, page: Page, text: &str) {
        let now = self.shown_time();
        if let Err(error) = self.filters.set(page, text, self.clock.wall(), now) {
            self.show_error(format!("filter not set: {error}"));
        }
        self.filter_changed();
    }

    /// Applies the filter while it is typed; while it is wrong, the one before applies.
    pub(super) fn filter_typed(&mut self) {
        let Some(Prompt { kind: PromptKind::Filter(prompt), input, .. }) = self.input.prompt()
        else {
            return;
        };
        let (page, before) = (prompt.page, prompt.before.clone());
        let typed = input.value().trim().to_owned();
        let now = self.shown_time();
        if self.filters.set(page, &typed, self.clock.wall(), now).is_err() {
            self.filters.restore(page, before);
        }
        self.filter_changed();
    }

    /// Sets the filter that was typed, and remembers it.
    pub(super) fn commit_filter(&mut self, page: Page, text: &str) {
        self.filters.remember(text);
        self.set_filter(page, text);
    }

    /// Leaves the prompt with the filter as it was.
    pub(super) fn restore_filter(&mut self, prompt: FilterPrompt) {
        self.filters.restore(prompt.page, prompt.before);
        self.filter_changed();
    }

    /// Switches the filter of the page off, or on again.
    pub(super) fn toggle_filter(&mut self) {
        let page = self.view.page;
        let filter = self.filters.of(page);
        if filter.filter().is_empty() {
            let key = self.key_of(crate::keymap::Action::Filter);
            return self.show_error(format!("no filter; {key} types one"));
        }
        self.view.close_evidence();
        let filter = self.filters.of(page);
        let is_on = !filter.is_on();
        self.filters.set_on(page, is_on);
        self.show_info(if is_on { "filter on" } else { "filter off; all rows are shown" });
        self.filter_changed();
    }

    /// Switches the filter of the page off, if it is on.
    pub(super) fn switch_filter_off(&mut self) -> bool {
        let page = self.view.page;
        let was_on = self.filters.of(page).is_on();
        if was_on {
            self.filters.set_on(page, false);
            self.filter_changed();
        }
        was_on
    }

    /// Shows what the filters select now.
    pub(super) fn filter_changed(&mut self) {
        self.refresh_for_draw();
        self.filter_frames();
        if self.view.page == Page::Traffic {
            self.select_among_shown();
        }
        self.renew_candidate_counts();
        self.notices.redraw.set_dirty();
    }

    // ---- the prompt ------------------------------------------------------------------------

    /// Puts the next candidate into the prompt.
    pub(super) fn complete_filter(&mut self) {
        let source = self.completion_source();
        if let Some(Prompt { kind: PromptKind::Filter(prompt), input, .. }) =
            self.input.prompt_mut()
        {
            prompt.complete(input, &source);
        }
        self.prompt_changed();
    }

    /// Puts an older line into the prompt, or with 1 a newer one.
    pub(super) fn recall_filter(&mut self, by: isize) {
        if let Some(Prompt { kind: PromptKind::Filter(prompt), input, .. }) =
            self.input.prompt_mut()
        {
            prompt.recall(input, by, self.filters.history());
        }
        self.prompt_changed();
    }

    /// What may stand at the cursor of the filter prompt, and which of it is chosen; `None` without
    /// such a prompt.
    pub fn filter_completion(&self) -> Option<(Completion, Option<usize>)> {
        let Overlay::Prompt(Prompt { kind: PromptKind::Filter(prompt), input, .. }) =
            self.input.overlay()
        else {
            return None;
        };
        Some(prompt.completion(input, &self.completion_source()))
    }

    fn completion_source(&self) -> CompletionSource {
        let buses = self.shown_buses();
        let mut source = CompletionSource::default();
        for device in buses.devices() {
            source.names.extend(device.name.as_ref().map(ToString::to_string));
            source.addresses.push(device.address.number());
            let services = device.services.iter().flatten();
            source.services.extend(services.map(|service| service.name.to_string()));
            let profile = buses.profile(device.id.bus);
            let uids = buses.uids_of(device).into_iter().filter(|uid| !uid.is_blank());
            source.uids.extend(uids.map(|uid| super::capture::decoded::uid_text(&profile, uid)));
        }
        for bus in buses.iter() {
            source.buses.push(bus.name.clone());
            let names = bus.config().profile.service_names.values();
            source.services.extend(names.map(|name| name.to_lowercase()));
        }
        source.names.sort();
        source.services.sort();
        source.addresses.sort_unstable();
        source.addresses.dedup();
        source
    }

    /// Number of rows of the page that match the filter, and of all; `None` until it is known.
    pub(super) fn filter_matches(&self) -> Option<(u64, u64)> {
        let count = |count: usize| count as u64;
        Some(match self.view.page {
            Page::Devices => (count(self.rows().len()), count(self.devices.all())),
            Page::Traffic if self.view.shows_identifiers() => {
                let buses = self.shown_buses();
                let all = self.identifiers().rows_of(|bus| buses.is_foreign(bus)).count();
                (count(self.identifiers_shown().len()), count(all))
            }
            Page::Traffic if let Some(list) = self.view.call_list() => {
                let row = self.calls().get(&list.key);
                let all = row.map_or(0, |row| row.kept_calls().len());
                (count(self.calls_listed().len()), count(all))
            }
            Page::Traffic if self.view.shows_calls() => {
                (count(self.calls_shown().len()), count(self.calls().rows().len()))
            }
            Page::Traffic => {
                let ranges = self.traffic.capture.ranges();
                let all: u64 = ranges.map(|range| range.end - range.start).sum();
                (all - self.hidden_frames()?.min(all), all)
            }
            Page::Timeline => (count(self.lines_shown().len()), count(self.story_count())),
            Page::Problems => (count(self.problems_shown().len()), count(self.problems().len())),
            Page::Bus => return None,
        })
    }

    /// Word for the rows of the page in a message.
    pub(super) fn row_noun(&self) -> &'static str {
        match self.view.page {
            Page::Traffic if self.view.shows_identifiers() => "identifiers",
            Page::Traffic if self.view.shows_calls() || self.view.call_list().is_some() => "calls",
            page => RowKind::of(page).plural(),
        }
    }

    /// Number of rows of the Traffic page that its filter hides, until the moment that is shown; `None`
    /// on other pages, without a filter, and until it is known.
    pub fn hidden_rows_shown(&self) -> Option<u64> {
        if self.view.page != Page::Traffic {
            return None;
        }
        if self.view.traffic_view == TrafficView::Frames && self.view.call_list().is_none() {
            return self.hidden_frames_shown();
        }
        let is_on = self.filters.of(Page::Traffic).is_on();
        let (hits, all) = self.filter_matches().filter(|_| is_on)?;
        Some(all.saturating_sub(hits))
    }

    // ---- searching without hiding ----------------------------------------------------------

    /// Selects the next row that matches the filter, or with -1 the one before; all rows may be
    /// shown.
    pub(super) fn go_to_match(&mut self, by: isize) {
        let page = self.view.page;
        let filter = self.filters.of(page).filter().clone();
        if filter.is_empty() {
            let key = self.key_of(crate::keymap::Action::Filter);
            return self.show_error(format!("no filter; {key} types one"));
        }
        let is_of_frames = !self.view.shows_identifiers() && !self.view.shows_calls();
        let is_found = match page {
            // Rows of identifiers and calls are those that match, or all.
            Page::Traffic if !is_of_frames && self.filters.of(page).is_on() => {
                return self.move_by(by);
            }
            Page::Traffic if !is_of_frames => {
                let key = self.key_of(crate::keymap::Action::FilterToggle);
                return self.show_error(format!("the filter is off; {key} shows its rows alone"));
            }
            Page::Devices => self.go_to_matching_device(&filter, by),
            Page::Traffic => self.go_to_matching_frame(&filter, by),
            Page::Timeline => self.go_to_matching_line(&filter, by),
            Page::Problems => self.go_to_matching_problem(&filter, by),
            Page::Bus => false,
        };
        if !is_found {
            let place = if by < 0 { "before" } else { "behind" };
            self.show_error(format!("no match {place} this row"));
        }
    }

    fn go_to_matching_device(&mut self, filter: &Filter, by: isize) -> bool {
        let at = self.selected_row_index();
        let key: Option<RowKey> = {
            let rows = self.rows();
            let matches = |at: &usize| filter.matches_row(self.shown_buses(), &rows[*at]);
            next_of(rows.len(), at, by).find(matches).map(|at| rows[at].key.clone())
        };
        let is_found = key.is_some();
        if let Some(key) = key {
            self.view.devices.select(key);
            self.refresh_rows();
        }
        is_found
    }

    fn go_to_matching_problem(&mut self, filter: &Filter, by: isize) -> bool {
        let shown = self.problems_shown();
        let at = self.view.problems.index(shown.keys());
        let matches = |at: &usize| {
            let problem = shown.get(*at);
            problem.is_some_and(|it| filter.matches_problem(self.shown_buses(), &it))
        };
        let found = next_of(shown.len(), at, by).find(matches);
        let Some(key) = found.and_then(|at| Some(shown.get(at)?.key)) else { return false };
        drop(shown);
        self.view.problems.select(key);
        self.refresh_for_draw();
        true
    }

    fn go_to_matching_line(&mut self, filter: &Filter, by: isize) -> bool {
        let lines = self.lines_shown();
        let selected = self.view.timeline.index(lines.iter()).or(lines.len().checked_sub(1));
        let matches = |at: &usize| {
            let (until, key) = (self.shown_time(), lines[*at]);
            let story = self.story(key);
            let mut steps = story.into_iter().flat_map(|story| story.steps_until(until));
            steps.any(|step| {
                (key.step == 0 || key.step == step.number)
                    && filter.matches_entry(self.shown_buses(), &step.entry)
            })
        };
        let Some(at) = next_of(lines.len(), selected, by).find(matches) else { return false };
        self.view.timeline.select(lines[at]);
        let height = self.list_height();
        self.view.timeline.update(&lines, height);
        true
    }

    fn go_to_matching_frame(&mut self, filter: &Filter, by: isize) -> bool {
        let capture = &self.traffic.capture;
        let matcher = filter.for_frames(self.shown_buses());
        let end = self.traffic.end(&self.view);
        let from = self.view.traffic.unwrap_or(end);
        let is_match = |number: &u64| {
            let frame = capture.get(*number);
            frame.is_some_and(|frame| matcher.is_match(&frame, Some((capture, *number))))
        };
        let found = if by < 0 {
            capture.numbers_before(from).take(MAX_SEARCHED).find(is_match)
        } else {
            let numbers = capture.numbers_from(from + 1).take_while(|number| *number < end);
            numbers.take(MAX_SEARCHED).find(is_match)
        };
        if let Some(number) = found {
            self.view.select_frame(number, self.list_height());
        }
        found.is_some()
    }

    // ---- filters of a row ------------------------------------------------------------------

    /// Adds a term for the selected row to the filter of the page: only such rows, or without them.
    pub(super) fn filter_like(&mut self, is_hidden: bool) {
        let page = self.view.page;
        let Some(term) = self.term_of_selection() else {
            return self.show_error("no row is selected");
        };
        let term = if is_hidden { format!("!{term}") } else { term };
        let filter = self.filters.of(page);
        let before = if filter.is_on() { filter.text().trim() } else { "" };
        let text = match before {
            "" => term,
            // `or` binds weaker than what is added.
            before if before.to_lowercase().split_whitespace().any(|word| word == "or") => {
                format!("({before}) {term}")
            }
            before => format!("{before} {term}"),
        };
        self.commit_filter(page, &text);
    }

    /// A term that the selected row matches, and rows like it.
    fn term_of_selection(&self) -> Option<String> {
        let quoted = |name: &str| format!("\"{}\"", name.replace('"', ""));
        match self.view.page {
            Page::Devices => {
                let row = self.selected_row()?;
                let name =
                    row.name.as_ref().map(|name| format!("name:{}", quoted(&name.to_string())));
                name.or_else(|| row.address.map(|address| format!("at:{address}")))
            }
            Page::Traffic => {
                let frame = self.selected_frame()?;
                let key = super::IdentifierKey::of(&frame);
                let id = if self.shown_buses().has_fixed_id(&frame) { frame.id } else { key.id };
                Some(match key.kind {
                    super::IdentifierKind::Error => "type:err".to_owned(),
                    _ => format!("id:={id}"),
                })
            }
            Page::Timeline => {
                let line = self.selected_line()?;
                let of_kind = line.finding.map(|kind| format!("kind:{}", kind.name()));
                let of_event = || line.events.first().map(|event| quoted(event));
                let of_device = line.address.map(|address: Address| format!("at:{address}"));
                of_kind.or(of_device).or_else(of_event)
            }
            Page::Problems => {
                let problem = self.selected_problem()?;
                Some(format!("kind:{}", problem.head().key.kind.name()))
            }
            Page::Bus => None,
        }
    }
}

/// Places behind `at` in a list of `len`, or with -1 those before it, nearest first.
fn next_of(len: usize, at: Option<usize>, by: isize) -> Box<dyn Iterator<Item = usize>> {
    match (at, by < 0) {
        (Some(at), true) => Box::new((0..at.min(len)).rev()),
        (Some(at), false) => Box::new(at.saturating_add(1)..len),
        (None, true) => Box::new((0..len).rev()),
        (None, false) => Box::new(0..len),
    }
}
