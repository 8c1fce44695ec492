//! The cells of a lane: the worst state of the device in each, and what happened there.
//!
//! Pure: the changes of a device, the conflicts at its addresses and an axis in, cells out. Does not
//! know how cells are drawn.

use super::record::{LaneChange, LaneRecord, LaneState};
use crate::app::time_axis::TimeAxis;
use crate::discovery::Presence;
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Mode;

/// A cell of a lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LaneCell {
    /// Nothing is known: before the first frame, or behind the shown moment.
    #[default]
    Blank,
    /// Present in mode WORK, or without a mode.
    Working,
    /// Present in another mode, or asleep.
    NotWorking,
    /// Where another mode begins.
    Mode(Mode),
    /// Stale or silent.
    Stale,
    /// Lost.
    Gone,
    /// It rebooted.
    Rebooted,
    /// Another device used its address; false: that was suspected only.
    Conflict(bool),
    /// A character of `→40`, the new address.
    Moved(char),
}

impl LaneCell {
    /// Rank of the state: the worst one of a cell is shown.
    fn rank(self) -> u8 {
        match self {
            Self::Blank => 0,
            Self::Working => 1,
            Self::NotWorking => 2,
            Self::Stale => 3,
            _ => 4,
        }
    }

    fn is_present(self) -> bool {
        matches!(self, Self::Working | Self::NotWorking | Self::Mode(_) | Self::Conflict(_))
    }
}

impl LaneState {
    fn cell(self) -> LaneCell {
        match (self.presence, self.mode) {
            (None, _) => LaneCell::Blank,
            (Some(Presence::Online), Some(Mode::Work) | None) => LaneCell::Working,
            // In IDLE a heartbeat is not missing.
            (Some(Presence::Online | Presence::Asleep), _)
            | (Some(Presence::Stale), Some(Mode::Idle)) => LaneCell::NotWorking,
            (Some(Presence::Stale | Presence::Silent), _) => LaneCell::Stale,
            (Some(Presence::Lost), _) => LaneCell::Gone,
        }
    }
}

/// A time in which two devices used one address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::app) struct ConflictSpan {
    pub address: Address,
    pub from: Instant,
    pub to: Instant,
    pub is_confirmed: bool,
}

/// Returns the cells of a device until a moment, which is in a cell or behind the axis.
pub(super) fn lane_cells(
    record: &LaneRecord,
    conflicts: &[ConflictSpan],
    axis: &TimeAxis,
    until: Instant,
) -> Vec<LaneCell> {
    let mut cells = vec![LaneCell::Blank; axis.cells];
    let last = if axis.contains(until) { axis.cell(until) + 1 } else { axis.cells };
    if until < axis.begin || axis.cells == 0 {
        return cells;
    }
    let mut state = record.before;
    let mut changes = record.changes.iter().filter(|(time, _)| *time <= until).peekable();
    let mut shown = Vec::new();
    // The addresses at which it was, from when on.
    let mut addresses = vec![(Instant::ZERO, state.address)];
    for (cell, place) in cells.iter_mut().enumerate().take(last) {
        let end = axis.start(cell + 1);
        let mut worst = if changes.peek().is_some_and(|(time, _)| *time <= axis.start(cell)) {
            LaneCell::Blank
        } else {
            state.cell()
        };
        while let Some((time, change)) = changes.next_if(|(time, _)| *time < end) {
            let before = state;
            state.apply(*change);
            if let LaneChange::Moved(address) = change {
                addresses.push((*time, Some(*address)));
            }
            // What was before the axis is part of its first state only.
            if *time < axis.begin {
                worst = state.cell();
                continue;
            }
            if state.cell().rank() >= worst.rank() {
                worst = state.cell();
            }
            match change {
                LaneChange::Mode(mode) if *mode != Mode::Work && before.mode != Some(*mode) => {
                    shown.push((cell, LaneCell::Mode(*mode)));
                }
                LaneChange::Rebooted => shown.push((cell, LaneCell::Rebooted)),
                LaneChange::Moved(_) => shown.push((cell, LaneCell::Moved('→'))),
                _ => {}
            }
        }
        *place = if worst == LaneCell::Blank { state.cell() } else { worst };
    }
    put_conflicts(&mut cells[..last], conflicts, &addresses, axis, until);
    put_events(&mut cells[..last], &shown, record, axis, until);
    cells
}

fn put_conflicts(
    cells: &mut [LaneCell],
    conflicts: &[ConflictSpan],
    addresses: &[(Instant, Option<Address>)],
    axis: &TimeAxis,
    until: Instant,
) {
    let was_at = |time: Instant| {
        let at = addresses.partition_point(|(since, _)| *since <= time);
        addresses.get(at.saturating_sub(1)).and_then(|(_, address)| *address)
    };
    for span in conflicts {
        let to = span.to.min(until);
        if to < axis.begin || span.from >= axis.end() || to < span.from {
            continue;
        }
        let (from, to) = (axis.cell(span.from.max(axis.begin)), axis.cell(to));
        for (cell, place) in cells.iter_mut().enumerate().take(to + 1).skip(from) {
            let is_there = was_at(axis.start(cell).max(span.from)) == Some(span.address);
            if is_there && place.is_present() && *place != LaneCell::Conflict(true) {
                *place = LaneCell::Conflict(span.is_confirmed);
            }
        }
    }
}

/// Puts modes, reboots and new addresses over the states, the most important ones last.
fn put_events(
    cells: &mut [LaneCell],
    shown: &[(usize, LaneCell)],
    record: &LaneRecord,
    axis: &TimeAxis,
    until: Instant,
) {
    for (cell, event) in shown {
        if let LaneCell::Mode(_) = event
            && matches!(cells[*cell], LaneCell::NotWorking | LaneCell::Mode(_))
        {
            cells[*cell] = *event;
        }
    }
    let moves = record.changes.iter().filter_map(|(time, change)| match change {
        LaneChange::Moved(address) => Some((axis.cell(*time), *time, *address)),
        _ => None,
    });
    let moves: Vec<_> =
        moves.filter(|(_, time, _)| axis.contains(*time) && *time <= until).collect();
    for (at, (cell, _, address)) in moves.iter().enumerate() {
        let text: Vec<char> = format!("→{address}").chars().collect();
        let Some(places) = cells.get_mut(*cell..) else { continue };
        // All digits or none: `→11` of `→110` is another address. An absence is not hidden by them.
        let next = moves.get(at + 1).map_or(places.len(), |next| next.0.saturating_sub(*cell));
        let room = next.min(places.len());
        let has_room = room >= text.len() && places[1..text.len()].iter().all(|it| it.is_present());
        let shown = if has_room { text.len() } else { 1 };
        for (place, c) in places.iter_mut().zip(&text[..shown]) {
            *place = LaneCell::Moved(*c);
        }
    }
    for (cell, event) in shown.iter().filter(|(_, event)| *event == LaneCell::Rebooted) {
        cells[*cell] = *event;
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::LaneRecords;
    use super::*;
    use crate::discovery::{DeviceId, Event, EventKind};
    use crate::frame::BusIndex;
    use crate::time::Duration;

    fn at(seconds: f64) -> Instant {
        Instant::ZERO + Duration::from_secs_f64(seconds)
    }

    fn lane(events: &[(f64, EventKind)], conflicts: &[ConflictSpan], until: f64) -> String {
        let id = DeviceId { bus: BusIndex(0), number: 0 };
        let mut records = LaneRecords::default();
        let mut address = Address::from_bits(20);
        for (time, kind) in events {
            if let EventKind::Moved { .. } = kind {
                address = Address::from_bits(40);
            }
            let (device, name, kind) = (Some(id), None, kind.clone());
            let event = Event { time: at(*time), device, address: Some(address), name, kind };
            records.handle_event(&event);
        }
        let axis = TimeAxis::new(at(0.0), Duration::from_secs(20), 20);
        let cells = lane_cells(records.get(id).unwrap(), conflicts, &axis, at(until));
        let text = |cell: &LaneCell| match cell {
            LaneCell::Blank => ' ',
            LaneCell::Working => '━',
            LaneCell::NotWorking => '─',
            LaneCell::Mode(mode) => mode.name().chars().next().unwrap(),
            LaneCell::Stale => '╌',
            LaneCell::Gone => '·',
            LaneCell::Rebooted => '↻',
            LaneCell::Conflict(true) => '▓',
            LaneCell::Conflict(false) => '▒',
            LaneCell::Moved(c) => *c,
        };
        cells.iter().map(text).collect()
    }

    #[test]
    fn cells_show_states_and_events_of_their_time() {
        let mode = |to| EventKind::Mode { from: None, to };
        let events = [
            (2.5, EventKind::FirstFrame),
            (2.5, mode(Mode::Work)),
            (5.2, mode(Mode::Cfg)),
            (7.1, mode(Mode::Work)),
            (8.5, EventKind::Presence(Presence::Stale)),
            (9.5, EventKind::Presence(Presence::Lost)),
            (11.9, EventKind::Returned { was: Presence::Lost }),
            (13.0, EventKind::Rebooted),
            (15.0, EventKind::Moved { from: Address::from_bits(20) }),
        ];
        assert_eq!(lane(&events, &[], 60.0), "  ━━━C──╌···━↻━→40━━");
        assert_eq!(lane(&events, &[], 12.5), "  ━━━C──╌···━       ", "later ones are absent");
        let address = Address::from_bits(20);
        let span = ConflictSpan { address, from: at(3.0), to: at(16.5), is_confirmed: true };
        let shown = lane(&events, &[span], 60.0);
        assert_eq!(shown, "  ━▓▓▓▓▓╌···▓↻▓→40━━", "not at the new address");
    }

    #[test]
    fn new_address_has_all_digits_or_none() {
        let moved = |at: f64| (at, EventKind::Moved { from: Address::from_bits(20) });
        let events = [(0.0, EventKind::FirstFrame), moved(5.0)];
        assert_eq!(lane(&events, &[], 7.5), "━━━━━→40            ");
        assert_eq!(lane(&events, &[], 6.5), "━━━━━→━             ", "`→4` is another address");
        let lost = (6.5, EventKind::Presence(Presence::Lost));
        let events = [(0.0, EventKind::FirstFrame), moved(5.0), lost];
        assert_eq!(lane(&events, &[], 8.5), "━━━━━→···           ");
        let events = [(0.0, EventKind::FirstFrame), moved(5.0), moved(7.0)];
        assert_eq!(lane(&events, &[], 12.0), "━━━━━→━→40━━━       ");
        let events = [(0.0, EventKind::FirstFrame), moved(5.5)];
        assert_eq!(lane(&events, &[], 5.2), "━━━━━━              ", "later in the same cell");
    }

    #[test]
    fn short_absence_is_not_hidden_by_a_long_cell() {
        let events = [
            (0.0, EventKind::FirstFrame),
            (3.1, EventKind::Presence(Presence::Lost)),
            (3.2, EventKind::Returned { was: Presence::Lost }),
        ];
        assert_eq!(lane(&events, &[], 6.0), "━━━·━━━             ");
    }
}
