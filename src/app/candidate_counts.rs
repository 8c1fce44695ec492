//! Numbers beside the candidates of a filter that is typed: how many rows have each value.
//!
//! Inputs: the candidates at the cursor, the rows of the page, the captured frames. Output: a number per
//! candidate, once it is known. Rows are tested in parts between which keys are handled; a number is of
//! all rows, whatever the rest of the line. Bounded: as many as there are candidates. Does not know how
//! candidates are found, nor how they are shown.

use super::filter::{Filter, FrameMatcher, RowKind};
use super::view::{Page, TrafficView};
use super::{App, shown_inputs};
use crate::time::Instant;

/// Rows tested at once, by all candidates together: some milliseconds.
const PART: usize = 65_536;

/// Numbers of rows by candidate.
#[derive(Debug)]
pub(super) struct CandidateCounts {
    /// Whose rows are counted.
    place: (Page, TrafficView),
    /// The word of the field with its colon.
    field: String,
    values: Vec<CountedValue>,
    /// Number behind the last frame that was tested.
    next_frame: u64,
    /// Place of the next candidate whose rows are counted; for frames: all are counted at once.
    next_value: usize,
    /// When the next part is counted; `None` if all is counted.
    due: Option<Instant>,
    /// All rows of the moment when the line was typed are counted.
    is_known: bool,
}

/// A value and the number of its rows.
#[derive(Debug)]
struct CountedValue {
    text: String,
    filter: Filter,
    /// Prepared for what was known of the buses.
    matcher: Option<FrameMatcher>,
    count: u64,
}

impl CandidateCounts {
    fn new(place: (Page, TrafficView), field: &str, candidates: &[String]) -> Self {
        let counted = |text: &String| {
            let line = format!("{field}{text}");
            let filter = Filter::parse(&line, RowKind::of(place.0)).ok()?;
            Some(CountedValue { text: text.clone(), filter, matcher: None, count: 0 })
        };
        Self {
            place,
            field: field.to_owned(),
            values: candidates.iter().filter_map(counted).collect(),
            next_frame: 0,
            next_value: 0,
            due: None,
            is_known: false,
        }
    }

    /// Returns true if it has the numbers of these candidates.
    fn is_of(&self, place: (Page, TrafficView), field: &str, candidates: &[String]) -> bool {
        let has = |text: &String| self.values.iter().any(|value| value.text == *text);
        self.place == place && self.field == field && candidates.iter().all(has)
    }

    /// When the next part is counted.
    pub fn due(&self) -> Option<Instant> {
        self.due
    }
}

impl App {
    /// Number of rows that have a candidate's value; `None` until it is known, and for candidates that
    /// are not values.
    pub fn candidate_count(&self, candidate: &str) -> Option<u64> {
        let counts = self.candidate_counts.as_ref().filter(|counts| counts.is_known)?;
        counts.values.iter().find(|value| value.text == candidate).map(|value| value.count)
    }

    /// Begins to count the candidates of the line that is typed, unless they are counted.
    pub(super) fn renew_candidate_counts(&mut self) {
        let completion = self.filter_completion().map(|(completion, _)| completion);
        let Some((field, candidates)) = completion.and_then(|it| Some((it.field?, it.candidates)))
        else {
            self.candidate_counts = None;
            return;
        };
        let place = (self.view.page, self.view.traffic_view);
        if self.candidate_counts.as_ref().is_some_and(|it| it.is_of(place, field, &candidates)) {
            return;
        }
        let mut counts = CandidateCounts::new(place, field, &candidates);
        // The page is painted first.
        counts.due = Some(self.clock.real() + super::FILTER_PAUSE);
        self.candidate_counts = Some(Box::new(counts));
    }

    /// Once a second: frames that were captured since are to be counted.
    pub(super) fn recount_candidates(&mut self) {
        let due = self.clock.real() + super::FILTER_PAUSE;
        if let Some(counts) = &mut self.candidate_counts {
            counts.due = counts.due.or(Some(due));
        }
    }

    /// Counts the next part of the rows, if it is due.
    pub(super) fn go_on_counting_candidates(&mut self) {
        let real = self.clock.real();
        let is_due = |due: Option<Instant>| due.is_some_and(|due| due <= real);
        let Some(mut counts) = self.candidate_counts.take_if(|counts| is_due(counts.due)) else {
            return;
        };
        let before: u64 = counts.values.iter().map(|value| value.count).sum();
        let was_known = counts.is_known;
        let is_complete = match counts.place {
            (Page::Traffic, TrafficView::Frames) => self.count_frames(&mut counts),
            _ => self.count_rows(&mut counts),
        };
        counts.due = (!is_complete).then(|| real + super::FILTER_PAUSE);
        counts.is_known |= is_complete;
        let after: u64 = counts.values.iter().map(|value| value.count).sum();
        if counts.is_known && (!was_known || after != before) {
            self.request_redraw();
        }
        self.candidate_counts = Some(counts);
    }

    /// Tests the next frames by all candidates. Returns false if some remain.
    fn count_frames(&self, counts: &mut CandidateCounts) -> bool {
        let (capture, buses) = (&self.traffic.capture, self.shown_buses());
        let end = self.traffic.end(&self.view);
        for value in &mut counts.values {
            if value.matcher.as_ref().is_none_or(|matcher| !matcher.is_current(buses)) {
                value.matcher = Some(value.filter.for_frames(buses));
            }
        }
        let part = PART / counts.values.len().max(1);
        let frames = capture.frames_from(counts.next_frame);
        for (number, frame) in frames.take_while(|(number, _)| *number < end).take(part) {
            counts.next_frame = number + 1;
            for value in &mut counts.values {
                let matcher = value.matcher.as_ref();
                let is_match =
                    matcher.is_some_and(|it| it.is_match(&frame, Some((capture, number))));
                value.count += u64::from(is_match);
            }
        }
        capture.numbers_from(counts.next_frame).next().is_none_or(|number| number >= end)
    }

    /// Counts the rows of the next candidates. Returns false if some remain.
    fn count_rows(&self, counts: &mut CandidateCounts) -> bool {
        let (place, mut tested) = (counts.place, 0);
        while let Some(value) = counts.values.get_mut(counts.next_value) {
            if tested >= PART / 4 {
                return false;
            }
            let (count, all) = self.rows_with(place, &value.filter);
            value.count = count as u64;
            counts.next_value += 1;
            tested += all.max(1);
        }
        true
    }

    /// Number of rows that match, and of those that were tested.
    fn rows_with(&self, (page, view): (Page, TrafficView), filter: &Filter) -> (usize, usize) {
        let buses = self.shown_buses();
        match page {
            Page::Devices => {
                let rows = shown_inputs!(self).all_rows();
                (rows.iter().filter(|row| filter.matches_row(buses, row)).count(), rows.len())
            }
            Page::Problems => {
                let problems = self.problems();
                let matching = problems.iter().filter(|it| filter.matches_problem(buses, it));
                (matching.count(), problems.len())
            }
            Page::Timeline => self.count_stories(filter),
            Page::Traffic if view == TrafficView::Calls => {
                let rows = self.traffic.calls_shown(self.calls(), &self.view, Some(filter), buses);
                (rows.len(), self.calls().rows().len())
            }
            Page::Traffic => {
                let identifiers = self.identifiers();
                let rows = super::capture::Traffic::identifiers_shown(
                    identifiers,
                    &self.view,
                    Some(filter),
                    buses,
                );
                (rows.len(), identifiers.rows_of(|bus| buses.is_foreign(bus)).count())
            }
            Page::Bus => (0, 0),
        }
    }
}
