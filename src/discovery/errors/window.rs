//! Windows: times in which an address is expected to send, with the errors in them.

use super::ExpectedFrame;
use crate::finding::Evidence;
use crate::frame::Frame;
use crate::time::Instant;
use crate::wire::id::Address;

/// Failed frames from which a window counts; fewer are chance. Tuned with the simulation.
pub(super) const BURST: u64 = 3;
/// Failed frames in a row that only two senders cause: two such windows are enough. Half of the 16
/// errors after which a sender is error-passive (ISO 11898-1: TEC + 8 each).
pub(super) const LONG_BURST: u64 = 8;
/// Maximum number of frames that two senders destroy until both are error-passive or bus-off. A
/// sender is bus-off after 32 errors (ISO 11898-1: TEC + 8 each); the rest is tuned with the
/// simulation.
pub(super) const LONGEST_BURST: u64 = 40;
/// Weight of a window with a burst, and with a long one. With `NAME_FROM_WEIGHT`: three bursts, or
/// two long ones.
const WEIGHT: u32 = 2;
const LONG_WEIGHT: u32 = 3;

/// Time in which an address is expected to send.
#[derive(Clone, Debug)]
pub(super) struct Window {
    pub(super) address: Address,
    pub(super) due: ExpectedFrame,
    /// Request, or last heartbeat, that opened the window.
    pub(super) cause: Option<Frame>,
    pub(super) ends: Instant,
    /// Frames that failed while no other address was expected to send.
    pub(super) errors: u64,
    /// Frames that failed while others were expected to send.
    pub(super) shared: u64,
    /// Numbers of the first and of the last failed frame, counting all frames.
    pub(super) span: Option<(u64, u64)>,
    pub(super) first: Option<Frame>,
    pub(super) last: Option<Frame>,
}

impl Window {
    /// Adds failed frames; `number` is that of the error frame.
    pub(super) fn note(&mut self, broken: u64, number: u64, frame: &Frame) {
        self.errors += broken;
        self.span = Some((self.span.map_or(number, |(first, _)| first), number));
        self.first.get_or_insert(*frame);
        self.last = Some(*frame);
    }

    /// Returns the weight of the window if frames failed one after the other; `None` if the errors
    /// are too few, scattered or endless.
    pub(super) fn weight(&self) -> Option<u32> {
        let (first, last) = self.span?;
        if self.errors > LONGEST_BURST {
            return None;
        }
        let valid = (last + 1 - first).saturating_sub(self.errors);
        // A heartbeat is not requested, so it never has the weight of a long burst.
        let is_requested = self.due != ExpectedFrame::Heartbeat;
        if is_requested && self.errors >= LONG_BURST && valid * 8 <= self.errors {
            Some(LONG_WEIGHT)
        } else {
            (self.errors >= BURST && valid <= self.errors).then_some(WEIGHT)
        }
    }

    /// Returns the evidence of this window, with the late response if there was one.
    pub(super) fn evidence(&self, response: Option<&Frame>) -> impl Iterator<Item = Evidence> {
        let (cause, broken, late) = match self.due {
            ExpectedFrame::Response(_) => {
                ("request", "bus error before the response", "late response")
            }
            ExpectedFrame::Heartbeat => {
                ("previous heartbeat", "bus error when the next was due", "")
            }
        };
        let last = self.last.filter(|_| self.errors > 1);
        let pieces = [(cause, self.cause), (broken, self.first), (broken, last)];
        let pieces = pieces.into_iter().chain([(late, response.copied())]);
        pieces.filter_map(|(what, frame)| {
            frame.map(|frame| Evidence {
                time: frame.time,
                description: what.into(),
                frame: Some(frame),
            })
        })
    }
}

/// A broadcast request, and the addresses without a response.
#[derive(Clone, Debug)]
pub(super) struct BroadcastWindow {
    pub(super) request: Frame,
    pub(super) ends: Instant,
    /// One bit for each address.
    pub(super) awaited: u128,
    pub(super) responded: u128,
}
