//! The calls of one client, server and service, one by one: selection and order.
//!
//! Does not know the calls, nor how they are drawn.

use super::View;
use super::cursor::Selection;
use crate::app::capture::CallKey;

/// The open list of calls.
#[derive(Clone, Debug)]
pub struct CallList {
    /// Whose calls.
    pub key: CallKey,
    /// Selection, by the number of the request in the capture.
    pub cursor: Selection<u64>,
    /// Slowest first, before them those without a response; else newest first.
    pub is_by_latency: bool,
    /// The order is reversed.
    pub is_reversed: bool,
}

impl View {
    /// The open list of calls, where Traffic shows it.
    pub fn call_list(&self) -> Option<&CallList> {
        self.call_list.as_ref().filter(|_| self.shows_calls())
    }

    /// Opens the list of calls.
    pub(in crate::app) fn open_call_list(&mut self, key: CallKey) {
        let cursor = Selection::default();
        self.call_list = Some(CallList { key, cursor, is_by_latency: false, is_reversed: false });
    }
}
