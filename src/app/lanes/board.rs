//! A lane for each board of a shared address: the lane of their device while the board sent heartbeats.
//!
//! Inputs: the conflicts of the moment that is shown, and the captured heartbeats. Output: the boards of
//! each device, and the cells of their lanes. Bounded: [`MAX_CONFLICTS`] conflicts, [`MAX_BOARDS`] boards
//! of each. A board that has a device of its own has its lane there. Does not know how lanes are drawn.

use super::{Lane, LaneCell};
use crate::app::conflict_panel::end_of_conflict;
use crate::app::problems::{ConflictSides, Problem, ProblemKey, ProblemList};
use crate::app::time_axis::TimeAxis;
use crate::app::{App, side_letter};
use crate::discovery::DeviceId;
use crate::time::Instant;
use crate::wire::node::Uid;
use std::collections::BTreeMap;

/// Conflicts whose boards have lanes: each needs a walk over its heartbeats.
const MAX_CONFLICTS: usize = 4;
/// Boards of a conflict that have lanes.
const MAX_BOARDS: usize = 4;

/// Times at which a board was there that are kept: the last ones.
const MAX_VISITS: usize = 64;
/// Periods without a heartbeat after which a board was away, as on the Problems page.
const AWAY_PERIODS: u32 = 5;

/// A board of a shared address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LaneBoard {
    /// Its place in the order of joining.
    pub side: usize,
    /// UID.
    pub uid: Uid,
    /// Its name, or the names that it may have; `None` if none is known.
    pub name: Option<String>,
    /// First and last heartbeats of the times at which it was there, oldest first.
    visits: Vec<(Instant, Instant)>,
    /// It has left.
    pub has_left: bool,
}

impl LaneBoard {
    /// Letter: A joined first.
    pub fn letter(&self) -> char {
        side_letter(self.side)
    }

    /// Returns the lane: of the cells of the device those while the board was there.
    pub(super) fn lane(&self, device: DeviceId, cells: &[LaneCell], axis: &TimeAxis) -> Lane {
        let is_there = |at: usize| {
            let (from, to) = (axis.start(at), axis.start(at + 1));
            let mut visits = self.visits.iter();
            visits.any(|(first, last)| *first < to && from <= *last)
        };
        let first = self.visits.first().map(|(first, _)| *first);
        let is_before = |at: usize| first.is_none_or(|first| axis.start(at + 1) <= first);
        let cell = |(at, cell): (usize, &LaneCell)| match *cell {
            LaneCell::Blank => LaneCell::Blank,
            // The first board has the lane of the device from its beginning on.
            cell if self.side == 0 && is_before(at) => cell,
            _ if is_before(at) => LaneCell::Blank,
            cell if is_there(at) => cell,
            _ => LaneCell::Gone,
        };
        let cells = cells.iter().enumerate().map(cell).collect();
        Lane { device, board: Some(self.clone()), cells }
    }
}

/// A conflict whose boards have lanes.
struct LaneConflict<'a> {
    problem: Problem<'a>,
    /// The device at its address.
    device: DeviceId,
    /// The boards without a device of their own: places in the order of joining, and UIDs; two or more.
    boards: Vec<(usize, Uid)>,
}

impl App {
    /// The boards of the devices whose lanes show a conflict, in the order of joining: two or more of each.
    pub(super) fn boards_of_lanes(&self) -> BTreeMap<DeviceId, Vec<LaneBoard>> {
        let problems = self.problems();
        let shown = self.conflicts_on_lanes(&problems).into_iter();
        let boards = shown.filter_map(|LaneConflict { problem, device, boards }| {
            let sides = self.conflict_sides(&problem)?;
            let board = |(side, uid)| self.board_of_lane(&problem, &sides, side, uid);
            Some((device, boards.into_iter().map(board).collect()))
        });
        boards.collect()
    }

    /// The number of lanes of boards besides those of their devices.
    pub(super) fn further_lanes(&self) -> usize {
        let problems = self.problems();
        self.conflicts_on_lanes(&problems).iter().map(|conflict| conflict.boards.len() - 1).sum()
    }

    /// The conflicts in the time of the lanes.
    fn conflicts_on_lanes<'a>(&'a self, problems: &'a ProblemList) -> Vec<LaneConflict<'a>> {
        if !self.shows_lanes() {
            return Vec::new();
        }
        let axis = self.lane_axis();
        let is_shown = |problem: &Problem| {
            let ended = problem.ended().unwrap_or(Instant::LATEST);
            problem.is_address_conflict() && problem.first() < axis.end() && ended >= axis.begin
        };
        let with_boards = |problem: Problem<'a>| {
            let ProblemKey::Address(bus, address) = problem.key else { return None };
            let of_bus = self.bus(bus)?;
            let device = of_bus.device_at(address)?.id;
            let has_own = |uid: Uid| {
                of_bus.devices().iter().any(|other| other.uid == Some(uid) && other.id != device)
            };
            let uids = problem.boards().into_iter().map(|board| board.uid).enumerate();
            let boards: Vec<_> = uids.filter(|(_, uid)| !has_own(*uid)).take(MAX_BOARDS).collect();
            (boards.len() > 1).then_some(LaneConflict { problem, device, boards })
        };
        problems.iter().filter(is_shown).filter_map(with_boards).take(MAX_CONFLICTS).collect()
    }

    fn board_of_lane(
        &self,
        problem: &Problem,
        sides: &ConflictSides,
        side: usize,
        uid: Uid,
    ) -> LaneBoard {
        let period = self.period_of(problem);
        let at = sides.sides.iter().position(|side| side.uid == Some(uid));
        let mut visits: Vec<(Instant, Instant)> = Vec::new();
        for (beat, _) in sides.beats().filter(|(_, side)| side.is_some() && *side == at) {
            match visits.last_mut() {
                Some((_, last)) if beat.time.since(*last) <= period * AWAY_PERIODS => {
                    *last = beat.time;
                }
                _ => visits.push((beat.time, beat.time)),
            }
        }
        visits.drain(..visits.len().saturating_sub(MAX_VISITS));
        // Of a conflict that is over the heartbeats soon after it are known.
        let end = self.display_time();
        let known = end_of_conflict(problem, period).map_or(end, |at| end.min(at));
        let has_left = at
            .is_some_and(|at| sides.has_left(at, known, sides.sides[at].period.unwrap_or(period)));
        if let Some((_, last)) = visits.last_mut().filter(|_| !has_left) {
            *last = Instant::LATEST;
        }
        let name = self.name_of_board(problem, Some(uid));
        LaneBoard { side, uid, name, visits, has_left }
    }
}
