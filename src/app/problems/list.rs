//! The rows of page 4 in their order. A row is made from its findings when it is read.

use super::group::{Problem, ProblemKey};
use super::{Problems, StoredProblem};
use crate::app::buses::Buses;
use crate::finding::FindingState;
use std::rc::Rc;

/// Problems in the order of the list.
#[derive(Clone, Debug)]
pub struct ProblemList<'a> {
    problems: &'a Problems,
    buses: &'a Buses,
    stored: Rc<[StoredProblem]>,
    /// Places in `stored`, in the order of the list.
    places: Vec<usize>,
}

impl<'a> ProblemList<'a> {
    /// All problems in the order of `stored`.
    pub(super) fn new(
        problems: &'a Problems,
        buses: &'a Buses,
        stored: Rc<[StoredProblem]>,
    ) -> Self {
        let places = (0..stored.len()).collect();
        Self { problems, buses, stored, places }
    }

    /// Keeps the problems that `is_wanted` selects.
    pub fn retain(&mut self, is_wanted: impl Fn(&Problem) -> bool) {
        let problem = |place: usize| self.problems.problem(self.buses, &self.stored[place]);
        self.places.retain(|&place| problem(place).is_some_and(|it| is_wanted(&it)));
    }

    fn stored(&self) -> impl Iterator<Item = &StoredProblem> {
        self.places.iter().map(|&place| &self.stored[place])
    }

    /// Number of problems.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Returns true without problems.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// The problem in this row.
    pub fn get(&self, row: usize) -> Option<Problem<'a>> {
        let stored = &self.stored[*self.places.get(row)?];
        self.problems.problem(self.buses, stored)
    }

    /// The problems from the first row to the last.
    pub fn iter(&self) -> impl Iterator<Item = Problem<'a>> {
        (0..self.len()).filter_map(|row| self.get(row))
    }

    /// Identities of the problems.
    pub fn keys(&self) -> impl Iterator<Item = &ProblemKey> {
        self.stored().map(|problem| &problem.key)
    }

    /// Number of problems in this state, muted or not.
    pub(in crate::app) fn count(&self, state: FindingState, is_muted: bool) -> usize {
        self.stored().filter(|it| it.state == state && it.is_muted == is_muted).count()
    }
}
