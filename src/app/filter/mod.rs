//! The filter language: which devices, frames, events, problems and gateways are shown, searched and
//! written.
//!
//! ```text
//! feed                      a word: part of a name, an event, a state, a kind, a service
//! src:FEED type:rsp         fields; terms beside each other must all match
//! at:12,14 or err           one of two
//! not (dst:0 and len:>4)    not both
//! ```
//!
//! Input: a line and what it selects from ([`RowKind`]). Output: a [`Filter`], or the mistake and its
//! place ([`FilterError`]). Case is ignored. The fields are in [`FILTER_FIELDS`]. Does not know where
//! rows come from.

mod completion;
mod expression;
mod field;
mod fleet;
mod frame;
mod row;
mod test;
mod value;

pub use completion::{Completion, CompletionSource};
pub use field::{FILTER_FIELDS, FILTER_WORDS, FilterField, RowKind};
pub use frame::FrameMatcher;

use super::wall_clock::WallClock;
use crate::time::Instant;
use crate::wire::id::Address;
use expression::Expression;
use std::fmt;
use std::ops::Range;
use test::{Addresses, Test};

/// A parsed filter line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Filter {
    expression: Expression<Test>,
}

/// A mistake in a filter line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilterError {
    text: String,
    range: Range<usize>,
}

impl FilterError {
    fn new(text: impl Into<String>, range: Range<usize>) -> Self {
        Self { text: text.into(), range }
    }

    /// What is wrong and what helps, in words.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Its place in the line, in bytes.
    pub fn range(&self) -> Range<usize> {
        self.range.clone()
    }

    /// The column of its first character in the line, from 1 on.
    pub fn column(&self, line: &str) -> usize {
        line.get(..self.range.start).map_or(0, |before| before.chars().count()) + 1
    }
}

impl fmt::Display for FilterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for FilterError {}

impl Filter {
    /// Parses a filter line for rows of a kind. An empty line matches everything.
    ///
    /// # Errors
    /// The first mistake.
    pub fn parse(line: &str, rows: RowKind) -> Result<Self, FilterError> {
        let terms = expression::parse(line)?;
        let expression = terms.try_map(&mut |term| Test::parse(term, rows))?;
        Ok(Self { expression })
    }

    /// Returns true if the filter is empty and matches everything.
    pub fn is_empty(&self) -> bool {
        self.expression.is_empty()
    }

    /// Finds the moments of `since:` and `until:`.
    pub(super) fn resolve(&mut self, clock: &WallClock, now: Option<Instant>) {
        self.expression.for_each_mut(&mut |test| test.resolve(clock, now));
    }

    /// Addresses that a match must have; `None` if the filter does not restrict them.
    pub fn addresses(&self) -> Option<Vec<Address>> {
        required_addresses(&self.expression).map(|set| set.iter().collect())
    }

    fn is_match(&self, mut test: impl FnMut(&Test) -> bool) -> bool {
        self.expression.is_match(&mut test)
    }
}

fn required_addresses(expression: &Expression<Test>) -> Option<Addresses> {
    match expression {
        Expression::Test(Test::Address(set)) => Some(*set),
        Expression::Test(_) | Expression::Not(_) => None,
        Expression::All(parts) => {
            let sets = parts.iter().filter_map(required_addresses);
            sets.reduce(|one, other| Addresses(one.0 & other.0))
        }
        Expression::Any(parts) => {
            let sets: Option<Vec<_>> = parts.iter().map(required_addresses).collect();
            sets?.into_iter().reduce(|one, other| Addresses(one.0 | other.0))
        }
    }
}
