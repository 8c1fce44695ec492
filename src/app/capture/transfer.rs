//! Transfers of several frames (ISO 15765-2) among the stored frames.
//!
//! Input: stored frames of the DES service, each with the one of its identifier before it. Output:
//! the first frame of the transfer that a frame belongs to, and the message. Bounded: 4095 bytes,
//! 4096 frames between two of a transfer. Does not know what messages mean.

use super::frame_store::FrameStore;
use crate::frame::{CanId, Frame, FrameKind};
use crate::time::Duration;
use crate::wire::des::MAX_MESSAGE;
use crate::wire::id::{Header, Service};
use crate::wire::isotp::Pci;

/// Most frames of a transfer: 4095 bytes, 6 of them in the first frame and 7 in the others.
const MAX_FRAMES: usize = 586;
/// Longest time between two frames of a transfer: twice N_Cr of ISO 15765-2.
const MAX_GAP: Duration = Duration::from_secs(2);
/// Frames that are searched for the next frame of a transfer.
const SEARCHED: usize = 4096;
/// Frames that are searched for the first frame that flow control is about.
const SEARCHED_BEFORE: u64 = 256;

/// A message of several frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Bytes that were received.
    pub message: Vec<u8>,
    /// Bytes that the first frame announces.
    pub length: usize,
    /// Number of frames that carry it.
    pub frames: usize,
    /// Time from the first to the last of them.
    pub duration: Duration,
}

impl Transfer {
    /// Returns true if all bytes were received.
    pub fn is_complete(&self) -> bool {
        self.message.len() >= self.length
    }

    /// Reads the transfer whose first frame has this number, as far as it was received before `end`.
    pub(super) fn starting_at(store: &FrameStore, number: u64, end: u64) -> Option<Self> {
        let first = store.get(number)?;
        let Ok(Pci::First { length, data }) = Pci::decode(first.data(), first.is_fd) else {
            return None;
        };
        let length = (length as usize).min(MAX_MESSAGE);
        let mut transfer =
            Self { message: data.to_vec(), length, frames: 1, duration: Duration::ZERO };
        let (mut sequence, mut last) = (1, first.time);
        let others = store.frames_from(number + 1).take_while(|(number, _)| *number < end);
        let mut between = 0;
        for (_, frame) in others {
            if transfer.is_complete() || between > SEARCHED || frame.time.since(last) > MAX_GAP {
                break;
            }
            between += 1;
            if frame.id != first.id || frame.bus != first.bus || frame.kind != FrameKind::Data {
                continue;
            }
            match Pci::decode(frame.data(), frame.is_fd) {
                Ok(Pci::Consecutive { sequence: own, data }) if own == sequence => {
                    transfer.message.extend_from_slice(data);
                    transfer.frames += 1;
                    transfer.duration = frame.time.since(first.time);
                    sequence = (sequence + 1) & 0x0F;
                    (last, between) = (frame.time, 0);
                }
                Ok(Pci::First { .. }) => break,
                _ => {}
            }
        }
        transfer.message.truncate(length);
        Some(transfer)
    }
}

/// Returns the header of a frame of the DES service, which has this number.
fn header_of(frame: &Frame, des: Service) -> Option<Header> {
    match (frame.kind, frame.id) {
        (FrameKind::Data, CanId::Extended(id)) => {
            Some(Header::decode(id)).filter(|header| header.service == des)
        }
        _ => None,
    }
}

fn is_first(frame: &Frame) -> bool {
    matches!(Pci::decode(frame.data(), frame.is_fd), Ok(Pci::First { .. }))
}

/// Returns the number of the first frame of the transfer that a later frame, or flow control, belongs
/// to; `None` for other frames, and if a frame between is missing. `des` is the DES service of its bus.
pub(super) fn first_frame_of(store: &FrameStore, number: u64, des: Service) -> Option<u64> {
    let frame = store.get(number)?;
    let header = header_of(&frame, des)?;
    match Pci::decode(frame.data(), frame.is_fd).ok()? {
        Pci::Consecutive { sequence, .. } => first_before(store, number, frame, sequence),
        Pci::Flow(_) => {
            let is_answered = |(_, other): &(u64, Frame)| {
                other.bus == frame.bus
                    && header_of(other, des).is_some_and(|it| {
                        it.source == header.destination && it.destination == header.source
                    })
                    && is_first(other)
            };
            let before = store.numbers_before(number).take(SEARCHED_BEFORE as usize);
            let before = before.filter_map(|number| Some((number, store.get(number)?)));
            before
                .take_while(|(_, other)| frame.time.since(other.time) <= MAX_GAP)
                .find(is_answered)
                .map(|(number, _)| number)
        }
        Pci::Single(_) | Pci::First { .. } => None,
    }
}

fn first_before(store: &FrameStore, number: u64, frame: Frame, sequence: u8) -> Option<u64> {
    let frames = frames_until(store, number, frame, sequence)?;
    frames.last().map(|(number, _)| *number)
}

/// The frames of the transfer that a consecutive frame with this sequence number belongs to, from it
/// back to the first one; `None` if one is missing.
fn frames_until(
    store: &FrameStore,
    number: u64,
    frame: Frame,
    sequence: u8,
) -> Option<Vec<(u64, Frame)>> {
    let (mut frames, mut expected) = (vec![(number, frame)], sequence);
    while let Some(&(at, last)) = frames.last().filter(|_| frames.len() < MAX_FRAMES) {
        let at = store.previous(at)?;
        let before = store.get(at)?;
        if last.time.since(before.time) > MAX_GAP {
            return None;
        }
        frames.push((at, before));
        match Pci::decode(before.data(), before.is_fd).ok()? {
            Pci::First { .. } if expected == 1 => return Some(frames),
            Pci::Consecutive { sequence, .. } if sequence == expected.wrapping_sub(1) & 0x0F => {
                expected = sequence;
            }
            _ => return None,
        }
    }
    None
}

/// The bytes of a transfer from its first frame to the frame with this number, and where those of that
/// frame begin. `None` for a frame of no transfer, or if a frame before is missing.
pub(in crate::app) fn message_until(
    store: &FrameStore,
    number: u64,
    frame: &Frame,
) -> Option<(Vec<u8>, usize)> {
    let sequence = match Pci::decode(frame.data(), frame.is_fd).ok()? {
        Pci::Single(data) | Pci::First { data, .. } => return Some((data.to_vec(), 0)),
        Pci::Consecutive { sequence, .. } => sequence,
        Pci::Flow(_) => return None,
    };
    let (mut message, mut own) = (Vec::new(), 0);
    for (_, frame) in frames_until(store, number, *frame, sequence)?.iter().rev() {
        own = message.len();
        match Pci::decode(frame.data(), frame.is_fd) {
            Ok(Pci::First { data, .. } | Pci::Consecutive { data, .. }) => {
                message.extend_from_slice(data);
            }
            _ => return None,
        }
    }
    Some((message, own))
}
