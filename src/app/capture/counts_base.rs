//! Counts of identifiers and calls at a moment, from which they are counted anew.
//!
//! Inputs: the tables of identifiers and calls. Output: counts since then. Bounded as they are. Does not
//! know how counts are shown.

use super::calls::{CallKey, CallStats, Calls};
use super::identifiers::{IdentifierKey, IdentifierStats, Identifiers};
use crate::frame::BusIndex;
use crate::time::Instant;
use std::collections::HashMap;

/// Counts of a row of calls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CallCounts {
    /// Requests.
    pub calls: u64,
    /// Responses.
    pub responses: u64,
    /// Responses with ERR = 0.
    pub failed: u64,
    /// Requests without a response in time.
    pub unanswered: u64,
}

impl CallCounts {
    /// Counts of a row since the start.
    pub fn of(row: &CallStats) -> Self {
        Self {
            calls: row.calls,
            responses: row.responses,
            failed: row.failed,
            unanswered: row.unanswered,
        }
    }
}

/// Counts at a moment.
#[derive(Debug)]
pub struct CountsBase {
    /// The moment.
    pub time: Instant,
    /// Number behind its last frame.
    pub frames: u64,
    identifiers: HashMap<IdentifierKey, u64>,
    calls: HashMap<CallKey, CallCounts>,
}

impl CountsBase {
    /// Returns the counts of these tables, which are those of a moment; `is_foreign`: a bus speaks another
    /// protocol.
    pub fn new(
        time: Instant,
        frames: u64,
        identifiers: &Identifiers,
        calls: &Calls,
        is_foreign: impl Fn(BusIndex) -> bool + Copy,
    ) -> Self {
        let identifiers = identifiers.rows_of(is_foreign);
        Self {
            time,
            frames,
            identifiers: identifiers.map(|row| (row.key, row.count)).collect(),
            calls: calls.rows().iter().map(|row| (row.key, CallCounts::of(row))).collect(),
        }
    }

    /// Number of frames of an identifier since then.
    pub fn frame_count(&self, row: &IdentifierStats) -> u64 {
        row.count.saturating_sub(self.identifiers.get(&row.key).copied().unwrap_or_default())
    }

    /// Returns true if an identifier was not received before.
    pub fn is_new_identifier(&self, row: &IdentifierStats) -> bool {
        !self.identifiers.contains_key(&row.key)
    }

    /// Counts of a row of calls since then.
    pub fn call_counts(&self, row: &CallStats) -> CallCounts {
        let before = self.calls.get(&row.key).copied().unwrap_or_default();
        let now = CallCounts::of(row);
        CallCounts {
            calls: now.calls.saturating_sub(before.calls),
            responses: now.responses.saturating_sub(before.responses),
            failed: now.failed.saturating_sub(before.failed),
            unanswered: now.unanswered.saturating_sub(before.unanswered),
        }
    }

    /// Returns true if there were no such calls before.
    pub fn is_new_call(&self, row: &CallStats) -> bool {
        !self.calls.contains_key(&row.key)
    }
}
