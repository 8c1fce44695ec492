//! The comparison of two moments: which ones, their differences, the selected row.
//!
//! Inputs: the moment that is shown, the marks, keys that move a moment. Output: rows as those of
//! `descan diff`, with the last event between the moments. A past state is replayed in parts, so
//! that keys are handled meanwhile. Does not know how it is drawn.

use super::history::{BusesReplay, Moment};
use super::input::Overlay;
use super::inventory::inventory_of;
use super::past::{Past, REPLAY_PART};
use super::view::{Page, Selection};
use super::{App, Inputs, clock_millis};
use crate::inventory::{
    Difference, DifferenceKind, DifferenceSubject, DifferenceValue, Inventory, InventoryBus,
    InventoryComparison, UnknownPart, compare,
};
use crate::time::Instant;
use crate::wire::id::Address;

/// The comparison that is open.
#[derive(Debug)]
pub struct MomentComparison {
    sides: [ComparedMoment; 2],
    is_after_chosen: bool,
    rows: Vec<ComparisonRow>,
    notes: Vec<ComparisonNote>,
    unknown: Vec<UnknownPart>,
    cursor: Selection<usize>,
    /// When the next part of a replay is due.
    due: Option<Instant>,
}

/// One of the two moments.
#[derive(Debug)]
pub struct ComparedMoment {
    /// The moment.
    pub moment: Moment,
    /// What is there: `mark a`, `start`, `shown`, `event`, `now`.
    pub label: String,
    replay: Option<BusesReplay>,
    inventory: Option<Inventory>,
}

/// A difference, and what happened to its subject between the moments.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparisonRow {
    /// The difference.
    pub difference: Difference,
    /// The event between the moments that explains it best, and the number of the others; of a bus its frames. Empty without one.
    pub events: String,
}

/// What a bus without a difference did between the moments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComparisonNote {
    /// Name of the bus.
    pub bus: String,
    /// Load and number of error frames at the first moment.
    pub before: String,
    /// The same at the second moment.
    pub after: String,
    /// Frames received and lost between them.
    pub events: String,
}

impl MomentComparison {
    /// The moments A and B.
    pub fn sides(&self) -> &[ComparedMoment; 2] {
        &self.sides
    }

    /// Returns true if the keys move moment B, false for A.
    pub fn is_after_chosen(&self) -> bool {
        self.is_after_chosen
    }

    /// The differences; `None` while a state is being replayed.
    pub fn rows(&self) -> Option<&[ComparisonRow]> {
        let is_ready = self.sides.iter().all(|side| side.inventory.is_some());
        is_ready.then_some(&self.rows[..])
    }

    /// Loads and numbers of frames of the buses.
    pub fn notes(&self) -> &[ComparisonNote] {
        &self.notes
    }

    /// What was not compared.
    pub fn unknown(&self) -> &[UnknownPart] {
        &self.unknown
    }

    /// Returns true if there was no device yet at the first moment.
    pub fn is_before_devices(&self) -> bool {
        let [before, after] = self.sides.each_ref().map(|side| side.inventory.as_ref());
        let has_none = |side: Option<&Inventory>| side.is_some_and(|it| it.devices.is_empty());
        has_none(before) && !has_none(after)
    }

    /// Index of the selected row, and of the first row that is shown on `height` lines.
    pub fn position(&self, height: usize) -> (Option<usize>, usize) {
        let places: Vec<usize> = (0..self.rows.len()).collect();
        let selected = self.cursor.index(places.iter());
        (selected, self.cursor.top(selected, self.rows.len(), height))
    }

    /// The selected row.
    pub fn selected(&self) -> Option<&ComparisonRow> {
        self.rows.get(*self.cursor.selected()?)
    }

    /// When the next part of a replay is due; `None` if both states are known.
    pub(super) fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Returns true if the next part of a replay is due.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        self.due.is_some_and(|due| due <= now)
    }

    /// Returns the side that the keys move.
    fn chosen(&self) -> &ComparedMoment {
        &self.sides[usize::from(self.is_after_chosen)]
    }
}

impl App {
    /// The comparison that is open.
    pub fn comparison(&self) -> Option<&MomentComparison> {
        self.comparison.as_deref()
    }

    /// Opens the comparison of the last mark, or the start of what is kept, with the moment that is
    /// shown.
    pub(super) fn compare_moments(&mut self) {
        let present = || self.buses.present(self.clock.now());
        let shown = self.past_moment().unwrap_or_else(present);
        let (moment, label) = match self.marks.last_before(shown) {
            Some(mark) => (mark.moment, format!("mark {}", mark.letter)),
            None => (self.first_moment(shown), "start".to_owned()),
        };
        let Some(before) = self.compared(moment, label) else { return };
        let label =
            self.marks.at(shown).map_or("shown".to_owned(), |it| format!("mark {}", it.letter));
        let inventory = Some(self.inventory());
        let after = ComparedMoment { moment: shown, label, replay: None, inventory };
        self.comparison = Some(Box::new(MomentComparison {
            sides: [before, after],
            is_after_chosen: false,
            rows: Vec::new(),
            notes: Vec::new(),
            unknown: Vec::new(),
            cursor: Selection::default(),
            due: None,
        }));
        self.input.open(Overlay::Comparison);
        self.go_on_comparing();
    }

    /// The first moment that is kept, at most `shown`.
    fn first_moment(&self, shown: Moment) -> Moment {
        let begin = self.buses.begin(&self.traffic.capture).min(shown.time);
        self.buses.moment(&self.traffic.capture, begin)
    }

    /// Begins to replay the state of a moment; shows an error if that is not possible.
    fn compared(&mut self, moment: Moment, label: String) -> Option<ComparedMoment> {
        let replay = self.buses.replay(&self.traffic.capture, moment);
        if replay.is_none() {
            let begin = self.buses.begin(&self.traffic.capture);
            let kept = clock_millis(self, begin.min(self.clock.now()));
            self.show_error(format!("{label}: no longer kept; moments from {kept} on are"));
        }
        Some(ComparedMoment { moment, label, replay: Some(replay?), inventory: None })
    }

    /// Replays the next part of a state that is not known yet; compares the states when both are.
    pub(super) fn go_on_comparing(&mut self) {
        self.notices.redraw.set_dirty();
        let Some(mut comparison) = self.comparison.take() else { return };
        comparison.due = None;
        for side in &mut comparison.sides {
            let Some(mut replay) = side.replay.take() else { continue };
            if !replay.is_kept(&self.buses, &self.traffic.capture) {
                let Some(again) = self.buses.replay(&self.traffic.capture, side.moment) else {
                    self.input.close();
                    return self.show_error("not compared: a moment is no longer kept");
                };
                replay = again;
            }
            if replay.run(&self.buses, &self.traffic.capture, REPLAY_PART) {
                let past = self.past_at(side.moment, replay.into_buses());
                side.inventory = Some(self.inventory_at(&past));
            } else {
                side.replay = Some(replay);
                comparison.due = Some(self.clock.real() + super::FILTER_PAUSE);
                break;
            }
        }
        if let [Some(before), Some(after)] =
            comparison.sides.each_ref().map(|it| it.inventory.as_ref())
        {
            let InventoryComparison { differences, unknown, .. } = compare(before, after);
            let moments = comparison.sides.each_ref().map(|side| side.moment);
            let mut notes = notes(before, after);
            let bus_of = |difference: &Difference| {
                let is_of_bus = difference.kind == DifferenceKind::Bus;
                difference.subject().and_then(|subject| subject.bus.clone()).filter(|_| is_of_bus)
            };
            let rows = differences.into_iter().map(|difference| {
                let bus = bus_of(&difference);
                let note = notes.iter().find(|note| Some(&note.bus) == bus.as_ref());
                let events = match note {
                    Some(note) => note.events.clone(),
                    None => self.events_between(&difference, moments),
                };
                ComparisonRow { difference, events }
            });
            comparison.rows = rows.collect();
            let has_row = |note: &ComparisonNote| {
                comparison
                    .rows
                    .iter()
                    .any(|row| bus_of(&row.difference).as_ref() == Some(&note.bus))
            };
            notes.retain(|note| !has_row(note));
            comparison.notes = notes;
            comparison.unknown = unknown;
            let places: Vec<usize> = (0..comparison.rows.len()).collect();
            comparison.cursor.update(&places, usize::MAX);
        }
        self.comparison = Some(comparison);
    }

    fn inventory_at(&self, past: &Past) -> Inventory {
        let inputs = Inputs {
            now: past.moment.time,
            buses: &past.buses,
            documents: self.files.documents_of(&past.contents),
            matching: past.problems.matching(),
        };
        inventory_of(inputs, past.problems.findings(&past.buses), self.has_file_path())
    }

    /// Returns the event between two moments that explains a difference of a device best: the last one,
    /// of a new device the first one; and the number of the others.
    fn events_between(&self, difference: &Difference, moments: [Moment; 2]) -> String {
        let [from, to] = moments.map(|moment| moment.time);
        let (from, to) = (from.min(to), from.max(to));
        let subjects = [&difference.subject_before, &difference.subject_after];
        let is_of = |subject: &DifferenceSubject, line: &super::TimelineEntry| {
            let bus = line.bus.and_then(|bus| self.bus(bus)).map(|bus| &*bus.name);
            let is_here = bus.is_none() || bus == subject.bus.as_deref();
            // Two devices may share an address; a conflict is one of both.
            let name = self.name_on_line(line).filter(|_| line.finding.is_none());
            let is_other =
                name.zip(subject.name.as_ref()).is_some_and(|(name, own)| name.to_string() != *own);
            if is_other {
                return false;
            }
            match (subject.address, line.address) {
                (Some(address), Some(at)) => is_here && at.number() == address,
                (None, None) => bus.is_some() && is_here,
                _ => false,
            }
        };
        let lines = self.timeline().entries().filter(|line| {
            line.last > from
                && line.last <= to
                && subjects.iter().any(|subject| subject.as_ref().is_some_and(|it| is_of(it, line)))
        });
        let is_new = difference.kind == DifferenceKind::Presence
            && difference.before == DifferenceValue::Absent;
        let (mut told, mut count) = (None, 0);
        for line in lines {
            count += 1;
            let rank = rank_of(difference, line);
            if told.is_none_or(|(before, _)| if is_new { rank > before } else { rank >= before }) {
                told = Some((rank, line));
            }
        }
        // What else happened to its device does not explain a finding.
        let is_finding = difference.kind == DifferenceKind::Finding;
        let told = told.filter(|(rank, _)| *rank > 0 || !is_finding);
        let Some((_, line)) = told else { return String::new() };
        let at = super::format_time_of_day(self, line.last);
        let more = if count > 1 { format!(" +{}", count - 1) } else { String::new() };
        format!("{at} {}{more}", line.text)
    }

    /// Moves the selection of the comparison by rows.
    pub(super) fn move_in_comparison(&mut self, by: isize) {
        let height = self.list_height();
        if let Some(comparison) = &mut self.comparison {
            let places: Vec<usize> = (0..comparison.rows.len()).collect();
            comparison.cursor.move_by(&places, by, height);
        }
    }

    /// Moves the selection of the comparison by screenfuls.
    pub(super) fn page_comparison(&mut self, pages: isize) {
        let height = self.list_height().saturating_sub(1).max(1);
        self.move_in_comparison(pages * height.cast_signed());
    }

    /// Lets the keys move the other moment.
    pub(super) fn choose_compared_side(&mut self) {
        if let Some(comparison) = &mut self.comparison {
            comparison.is_after_chosen = !comparison.is_after_chosen;
        }
    }

    /// Moves the chosen moment to the event before it, or with 1 to the next one; before the first
    /// one is the start of what is kept, after the last one the present.
    pub(super) fn move_compared_moment(&mut self, by: isize) {
        let Some(comparison) = &self.comparison else { return };
        let (from, is_after) = (comparison.chosen().moment.time, comparison.is_after_chosen);
        let begin = self.buses.begin(&self.traffic.capture).min(self.clock.now());
        let times = self.timeline().entries().map(|line| line.time);
        let to = if by < 0 {
            times.filter(|time| *time < from && *time >= begin).max()
        } else {
            times.filter(|time| *time > from).min()
        };
        let end = if by < 0 { begin } else { self.clock.now() };
        if to.is_none() && end == from {
            let which = if by < 0 { "no earlier moment is kept" } else { "no later moment" };
            return self.show_error(which);
        }
        let (moment, label) = match to {
            Some(time) => {
                let moment = self.buses.moment(&self.traffic.capture, time);
                let marked = self.marks.by_letter();
                match marked.into_iter().find(|mark| mark.moment.time == time) {
                    Some(mark) => (mark.moment, format!("mark {}", mark.letter)),
                    None => (moment, "event".to_owned()),
                }
            }
            None if by < 0 => (self.buses.moment(&self.traffic.capture, begin), "start".to_owned()),
            None => (self.buses.present(self.clock.now()), "now".to_owned()),
        };
        let Some(side) = self.compared(moment, label) else { return };
        if let Some(comparison) = &mut self.comparison {
            comparison.sides[usize::from(is_after)] = side;
        }
        self.go_on_comparing();
    }

    /// Closes the comparison and selects the device of its selected row on Devices.
    pub(super) fn go_to_compared_device(&mut self) {
        let selected = self.comparison.as_ref().and_then(|comparison| comparison.selected());
        let Some(difference) = selected.map(|row| row.difference.clone()) else { return };
        if difference.subject().is_none_or(|subject| subject.address.is_none()) {
            return self.show_error("no device in this row");
        }
        self.close_comparison();
        self.show_page(Page::Devices);
        if self.filters.of(Page::Devices).is_on() {
            self.filters.set_on(Page::Devices, false);
            self.refresh_for_draw();
        }
        let is_it = |row: &&super::Row, subject: &DifferenceSubject| {
            let bus = row.bus.and_then(|bus| self.bus(bus)).map(|bus| &*bus.name);
            let is_here = bus.is_none() || bus == subject.bus.as_deref();
            is_here && row.address.map(Address::number) == subject.address
        };
        let name = |row: &super::Row| row.name.as_ref().map(ToString::to_string);
        let subjects = [&difference.subject_after, &difference.subject_before];
        let key = subjects.into_iter().flatten().find_map(|subject| {
            let mut rows: Vec<&super::Row> =
                self.rows().iter().filter(|row| is_it(row, subject)).collect();
            rows.sort_by_key(|row| name(row) != subject.name);
            rows.first().map(|row| row.key.clone())
        });
        match key {
            Some(key) => self.view.devices.select(key),
            None => self.show_error("not in the list at the moment that is shown"),
        }
    }

    /// Closes the comparison.
    pub(super) fn close_comparison(&mut self) {
        self.comparison = None;
        self.input.close();
    }
}

/// Returns how well a line of the timeline explains a difference: 0 if it is about something else.
fn rank_of(difference: &Difference, line: &super::TimelineEntry) -> usize {
    let words: &[&str] = match difference.kind {
        DifferenceKind::Presence => {
            return usize::from(line.finding.is_none() && line.mode.is_none());
        }
        DifferenceKind::Finding => {
            return usize::from(line.finding.is_some_and(|kind| kind.name() == difference.detail));
        }
        DifferenceKind::Boards | DifferenceKind::Uid => &["finding", "uid"],
        DifferenceKind::Address => &["claimed", "gave-up", "moved"],
        DifferenceKind::Name => &["named"],
        DifferenceKind::Mode => &["rebooted", "mode"],
        // New firmware begins with a reboot.
        DifferenceKind::Services | DifferenceKind::Version => &["services", "rebooted"],
        DifferenceKind::File => &["file"],
        DifferenceKind::Heartbeat | DifferenceKind::Bus => &[],
    };
    let rank = |event: &&str| words.iter().position(|word| word == event).map_or(0, |at| at + 1);
    line.events.iter().map(rank).max().unwrap_or(0)
}

/// Returns load, errors and frames of each bus that both states have.
fn notes(before: &Inventory, after: &Inventory) -> Vec<ComparisonNote> {
    let mut notes = Vec::new();
    for bus in &after.buses {
        let Some(was) = before.buses.iter().find(|other| other.name == bus.name) else { continue };
        let state = |bus: &InventoryBus| {
            let load = bus.load.map_or("–".to_owned(), |load| format!("{:.1} %", load * 100.0));
            format!("{load}, {}", bus.errors.unwrap_or_default())
        };
        let between = |count: [Option<u64>; 2]| {
            let [was, is] = count.map(Option::unwrap_or_default);
            was.abs_diff(is)
        };
        let frames = between([was.frames, bus.frames]);
        let lost = between([was.lost, bus.lost]);
        notes.push(ComparisonNote {
            bus: bus.name.clone(),
            before: state(was),
            after: state(bus),
            events: format!("{frames} frames, {lost} lost"),
        });
    }
    notes
}
