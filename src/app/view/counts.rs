//! Counts in the views of identifiers and calls: since the start, or since a moment.
//!
//! Does not know how they are drawn.

use super::View;
use crate::app::capture::{CallCounts, CallStats, CountsBase, IdentifierStats};

impl View {
    /// The moment from which frames and calls are counted; `None`: the start, also if an earlier
    /// moment is shown.
    pub fn counts_base(&self) -> Option<&CountsBase> {
        let base = self.counts_base.as_deref()?;
        let is_reached = self.frozen.is_none_or(|frozen| frozen.frames >= base.frames);
        is_reached.then_some(base)
    }

    /// Number of frames of an identifier, as shown.
    pub fn frame_count(&self, row: &IdentifierStats) -> u64 {
        self.counts_base().map_or(row.count, |base| base.frame_count(row))
    }

    /// Counts of calls, as shown.
    pub fn call_counts(&self, row: &CallStats) -> CallCounts {
        self.counts_base().map_or_else(|| CallCounts::of(row), |base| base.call_counts(row))
    }
}
