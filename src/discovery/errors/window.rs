//! The time in which an address is expected to send, and what broke in it.

use super::Due;
use crate::finding::Evidence;
use crate::frame::Frame;
use crate::time::Instant;
use crate::wire::id::Address;

/// Frames that break in a window until it counts: fewer is chance.
pub(super) const BURST: u64 = 3;
/// Frames that break in a row as only two senders break them: two such windows are enough.
pub(super) const LONG_BURST: u64 = 8;
/// More than two senders can break until both are error-passive, or off the bus.
pub(super) const LONGEST_BURST: u64 = 40;
/// What a window with a burst counts, and with a long one.
const WEIGHT: u32 = 2;
const LONG_WEIGHT: u32 = 3;

/// A time in which an address is expected to send.
#[derive(Debug)]
pub(super) struct Window {
    pub(super) address: Address,
    pub(super) due: Due,
    /// The question, or the last heartbeat.
    pub(super) cause: Option<Frame>,
    pub(super) ends: Instant,
    /// Frames that broke while nobody else was expected to send.
    pub(super) errors: u64,
    /// And while others were.
    pub(super) shared: u64,
    /// The number of the first and of the last frame that broke, all frames counted.
    pub(super) span: Option<(u64, u64)>,
    pub(super) first: Option<Frame>,
    pub(super) last: Option<Frame>,
}

impl Window {
    pub(super) fn note(&mut self, broken: u64, number: u64, frame: &Frame) {
        self.errors += broken;
        self.span = Some((self.span.map_or(number, |(first, _)| first), number));
        self.first.get_or_insert(*frame);
        self.last = Some(*frame);
    }

    /// What it counts, where frames broke one after the other, and not here and there.
    pub(super) fn weight(&self) -> Option<u32> {
        let (first, last) = self.span?;
        if self.errors > LONGEST_BURST {
            return None;
        }
        let whole = (last + 1 - first).saturating_sub(self.errors);
        // A heartbeat that is overdue was not even asked for.
        let asked = self.due != Due::Heartbeat;
        if asked && self.errors >= LONG_BURST && whole * 8 <= self.errors {
            Some(LONG_WEIGHT)
        } else {
            (self.errors >= BURST && whole <= self.errors).then_some(WEIGHT)
        }
    }

    pub(super) fn evidence(&self, response: Option<&Frame>) -> impl Iterator<Item = Evidence> {
        let (cause, broken, late) = match self.due {
            Due::Answer(_) => ("request", "bus error before the response", "late response"),
            Due::Heartbeat => ("previous heartbeat", "bus error when the next was due", ""),
        };
        let last = self.last.filter(|_| self.errors > 1);
        let pieces = [(cause, self.cause), (broken, self.first), (broken, last)];
        let pieces = pieces.into_iter().chain([(late, response.copied())]);
        pieces.filter_map(|(what, frame)| {
            frame.map(|frame| Evidence { time: frame.time, what: what.into(), frame: Some(frame) })
        })
    }
}

/// A question to all, and who has yet to answer it.
#[derive(Debug)]
pub(super) struct BroadcastWindow {
    pub(super) request: Frame,
    pub(super) ends: Instant,
    /// One bit for each address.
    pub(super) awaited: u128,
    pub(super) answered: u128,
}
