//! ISO 15765-2 with normal addressing and one PCI byte: how messages longer than a frame are
//! cut up, sent under the receiver's flow control, and put together again.
//!
//! [`Reassembly`] and [`Segmenter`] are one transfer each; which identifiers they travel on,
//! and how many there are at once, is the caller's. Time is passed in.

use super::des::MAX_MESSAGE;
use crate::frame::{Frame, fd_length};
use crate::time::{Duration, Instant};

/// N_Bs and N_Cr: how long a sender waits for flow control and a receiver for the next
/// consecutive frame.
pub const TIMEOUT: Duration = Duration::from_secs(1);
/// How many WAIT flow controls in a row a sender accepts before it gives up.
pub const MAX_WAITS: u8 = 16;

/// What a flow control frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowStatus {
    /// Send on.
    Continue,
    /// Wait for the next flow control.
    Wait,
    /// The message is too long for the receiver: give up.
    Overflow,
}

/// A flow control frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlowControl {
    /// What to do.
    pub status: FlowStatus,
    /// Consecutive frames until the next flow control; 0 = all.
    pub block_size: u8,
    /// STmin as coded: 00–7F milliseconds, F1–F9 hundreds of microseconds.
    pub st_min: u8,
}

impl FlowControl {
    /// The three bytes of the frame.
    pub const fn encode(self) -> [u8; 3] {
        let status = match self.status {
            FlowStatus::Continue => 0x30,
            FlowStatus::Wait => 0x31,
            FlowStatus::Overflow => 0x32,
        };
        [status, self.block_size, self.st_min]
    }

    /// The least time between two consecutive frames. Reserved codes count as the longest,
    /// 127 ms, as the standard demands.
    pub const fn separation(self) -> Duration {
        match self.st_min {
            0..=0x7F => Duration::from_millis(self.st_min as u64),
            0xF1..=0xF9 => Duration::from_micros((self.st_min as u64 - 0xF0) * 100),
            _ => Duration::from_millis(127),
        }
    }
}

/// A frame's protocol control information and what it carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pci<'a> {
    /// The whole message.
    Single(&'a [u8]),
    /// The message's length and its first bytes.
    First {
        /// Length of the whole message in bytes.
        length: u32,
        /// Its first bytes.
        data: &'a [u8],
    },
    /// A further part.
    Consecutive {
        /// Sequence number, 0–15.
        sequence: u8,
        /// The part (and padding, in the last).
        data: &'a [u8],
    },
    /// The receiver's word on how to go on.
    Flow(FlowControl),
}

/// Why bytes are no ISO 15765-2 frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PciFault {
    /// No bytes at all.
    #[error("empty frame")]
    Empty,
    /// The length in the PCI does not fit the frame.
    #[error("a length that does not fit the frame")]
    BadLength,
    /// A frame type that does not exist.
    #[error("an unknown frame type")]
    UnknownType,
}

impl<'a> Pci<'a> {
    /// Reads a frame's data.
    pub fn decode(data: &'a [u8], fd: bool) -> Result<Self, PciFault> {
        let (&first, rest) = data.split_first().ok_or(PciFault::Empty)?;
        let low = usize::from(first & 0x0F);
        match first >> 4 {
            0 if low > 0 => rest.get(..low).map(Pci::Single).ok_or(PciFault::BadLength),
            0 if fd => match rest.split_first() {
                Some((&length, rest)) if length > 0 => {
                    rest.get(..usize::from(length)).map(Pci::Single).ok_or(PciFault::BadLength)
                }
                _ => Err(PciFault::BadLength),
            },
            0 => Err(PciFault::BadLength),
            1 => {
                let (&second, data) = rest.split_first().ok_or(PciFault::BadLength)?;
                let length = (low as u32) << 8 | u32::from(second);
                if length > 0 {
                    return Ok(Pci::First { length, data });
                }
                let (escaped, data) = data.split_first_chunk().ok_or(PciFault::BadLength)?;
                Ok(Pci::First { length: u32::from_be_bytes(*escaped), data })
            }
            2 => Ok(Pci::Consecutive { sequence: first & 0x0F, data: rest }),
            3 => {
                let status = match low {
                    0 => FlowStatus::Continue,
                    1 => FlowStatus::Wait,
                    2 => FlowStatus::Overflow,
                    _ => return Err(PciFault::UnknownType),
                };
                let [block_size, st_min, ..] = *rest else { return Err(PciFault::BadLength) };
                Ok(Pci::Flow(FlowControl { status, block_size, st_min }))
            }
            _ => Err(PciFault::UnknownType),
        }
    }
}

/// The bytes of one frame to be sent.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    len: u8,
    bytes: [u8; Frame::MAX_DATA],
}

impl Segment {
    fn new(parts: &[&[u8]]) -> Self {
        let mut segment = Self { len: 0, bytes: [0; Frame::MAX_DATA] };
        for part in parts {
            let at = usize::from(segment.len);
            segment.bytes[at..at + part.len()].copy_from_slice(part);
            segment.len += part.len() as u8;
        }
        segment
    }

    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }

    /// As the data of a frame with this identifier; FD frames padded to a DLC's length with
    /// `padding`.
    pub fn into_frame(self, id: u32, fd: bool, padding: u8) -> Frame {
        if fd {
            Frame::fd(id, self.as_bytes(), padding)
        } else {
            Frame::classic(id, self.as_bytes())
        }
    }
}

/// Most bytes a frame of this format carries.
const fn capacity(fd: bool) -> usize {
    if fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA }
}

/// A single frame with `message`, if it fits one.
pub fn single_frame(message: &[u8], fd: bool) -> Option<Segment> {
    match message.len() {
        1..=7 => Some(Segment::new(&[&[message.len() as u8], message])),
        8..=62 if fd => Some(Segment::new(&[&[0, message.len() as u8], message])),
        _ => None,
    }
}

/// Why a transfer was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum TransferFault {
    /// The next consecutive frame has the wrong number: a frame was lost, or two senders share
    /// the identifier.
    #[error("consecutive frame out of sequence after {after} bytes")]
    OutOfSequence {
        /// How many bytes of the message had come.
        after: usize,
    },
    /// The next consecutive frame did not come (N_Cr).
    #[error("no consecutive frame within 1 s after {after} bytes")]
    SenderSilent {
        /// How many bytes of the message had come.
        after: usize,
    },
    /// No flow control came (N_Bs).
    #[error("no flow control within 1 s")]
    ReceiverSilent,
    /// The message is longer than we take, or than its first frame may say.
    #[error("{0} bytes exceed the limit of 4095")]
    TooLong(u32),
    /// A first frame whose length would have fitted a single frame, or that is not filled.
    #[error("first frame with invalid length")]
    BadFirstFrame,
    /// The receiver said OVERFLOW.
    #[error("flow control: overflow")]
    Refused,
    /// The receiver said WAIT too often.
    #[error("flow control: too many WAIT frames")]
    TooManyWaits,
}

/// What a consecutive frame did to a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReassemblyProgress {
    /// More to come.
    More,
    /// More to come, and the sender waits for flow control.
    BlockEnd,
    /// All bytes are here.
    Done,
}

/// A segmented message that is being received, by us or by somebody we listen to.
#[derive(Debug)]
pub struct Reassembly {
    message: Vec<u8>,
    length: usize,
    part: usize,
    next_sequence: u8,
    block_size: u8,
    block_left: u8,
    deadline: Instant,
}

impl Reassembly {
    /// Begins with a first frame of `frame_len` data bytes. `block_size` is what our flow
    /// control says (0 = all at once).
    pub fn start(
        now: Instant,
        length: u32,
        data: &[u8],
        frame_len: usize,
        block_size: u8,
    ) -> Result<Self, TransferFault> {
        if length as usize > MAX_MESSAGE {
            return Err(TransferFault::TooLong(length));
        }
        let fits_single = if frame_len > Frame::MAX_CLASSIC_DATA { frame_len - 2 } else { 7 };
        if length as usize <= fits_single || frame_len < Frame::MAX_CLASSIC_DATA {
            return Err(TransferFault::BadFirstFrame);
        }
        let mut message = Vec::with_capacity(length as usize);
        message.extend_from_slice(data);
        Ok(Self {
            message,
            length: length as usize,
            part: frame_len - 1,
            next_sequence: 1,
            block_size,
            block_left: block_size,
            deadline: now + TIMEOUT,
        })
    }

    /// Takes a consecutive frame.
    pub fn push(
        &mut self,
        now: Instant,
        sequence: u8,
        data: &[u8],
    ) -> Result<ReassemblyProgress, TransferFault> {
        let missing = self.length - self.message.len();
        let take = missing.min(self.part);
        if sequence != self.next_sequence || data.len() < take {
            return Err(TransferFault::OutOfSequence { after: self.message.len() });
        }
        self.message.extend_from_slice(&data[..take]);
        self.next_sequence = (sequence + 1) & 0x0F;
        self.deadline = now + TIMEOUT;
        if self.message.len() == self.length {
            return Ok(ReassemblyProgress::Done);
        }
        if self.block_size > 0 {
            self.block_left -= 1;
            if self.block_left == 0 {
                self.block_left = self.block_size;
                return Ok(ReassemblyProgress::BlockEnd);
            }
        }
        Ok(ReassemblyProgress::More)
    }

    /// The bytes so far; all of them after [`Progress::Done`].
    pub fn message(&self) -> &[u8] {
        &self.message
    }

    /// The bytes so far, for keeping.
    pub fn into_message(self) -> Vec<u8> {
        self.message
    }

    /// When it is to be given up if nothing more comes (N_Cr).
    pub fn deadline(&self) -> Instant {
        self.deadline
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SendState {
    First,
    AwaitFlow { until: Instant, waits: u8 },
    Sending { block_left: Option<u8>, next_at: Instant },
    Done,
}

/// A message that is being sent.
#[derive(Debug)]
pub struct Segmenter {
    message: Vec<u8>,
    sent: usize,
    sequence: u8,
    fd: bool,
    separation: Duration,
    state: SendState,
}

impl Segmenter {
    /// Begins to send `message` (1–4095 bytes).
    pub fn new(message: Vec<u8>, fd: bool) -> Self {
        Self {
            message,
            sent: 0,
            sequence: 1,
            fd,
            separation: Duration::ZERO,
            state: SendState::First,
        }
    }

    /// The next frame's bytes, if one may be sent now.
    pub fn poll(&mut self, now: Instant) -> Option<Segment> {
        match self.state {
            SendState::First => {
                if let Some(single) = single_frame(&self.message, self.fd) {
                    self.state = SendState::Done;
                    return Some(single);
                }
                let length = self.message.len().min(MAX_MESSAGE);
                let take = capacity(self.fd) - 2;
                self.sent = take;
                self.state = SendState::AwaitFlow { until: now + TIMEOUT, waits: 0 };
                Some(Segment::new(&[
                    &[0x10 | (length >> 8) as u8, length as u8],
                    &self.message[..take],
                ]))
            }
            SendState::Sending { block_left, next_at } if now >= next_at => {
                let take = (self.message.len() - self.sent).min(capacity(self.fd) - 1);
                let data = &self.message[self.sent..self.sent + take];
                let segment = Segment::new(&[&[0x20 | self.sequence], data]);
                self.sent += take;
                self.sequence = (self.sequence + 1) & 0x0F;
                self.state = match block_left {
                    _ if self.sent == self.message.len() => SendState::Done,
                    Some(1) => SendState::AwaitFlow { until: now + TIMEOUT, waits: 0 },
                    left => SendState::Sending {
                        block_left: left.map(|left| left - 1),
                        next_at: now + self.separation,
                    },
                };
                Some(segment)
            }
            _ => None,
        }
    }

    /// Takes the receiver's flow control.
    pub fn handle_flow(&mut self, now: Instant, flow: FlowControl) -> Result<(), TransferFault> {
        let SendState::AwaitFlow { waits, .. } = self.state else { return Ok(()) };
        match flow.status {
            FlowStatus::Continue => {
                self.separation = flow.separation();
                self.state = SendState::Sending {
                    block_left: (flow.block_size > 0).then_some(flow.block_size),
                    next_at: now,
                };
                Ok(())
            }
            FlowStatus::Wait if waits < MAX_WAITS => {
                self.state = SendState::AwaitFlow { until: now + TIMEOUT, waits: waits + 1 };
                Ok(())
            }
            FlowStatus::Wait => Err(TransferFault::TooManyWaits),
            FlowStatus::Overflow => Err(TransferFault::Refused),
        }
    }

    /// When [`poll`](Self::poll) or [`handle_timeout`](Self::handle_timeout) is to be called
    /// next; `None` when all is sent.
    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.state {
            SendState::First => Some(Instant::ZERO),
            SendState::AwaitFlow { until, .. } => Some(until),
            SendState::Sending { next_at, .. } => Some(next_at),
            SendState::Done => None,
        }
    }

    /// Gives up where flow control is overdue (N_Bs).
    pub fn handle_timeout(&self, now: Instant) -> Result<(), TransferFault> {
        match self.state {
            SendState::AwaitFlow { until, .. } if now >= until => {
                Err(TransferFault::ReceiverSilent)
            }
            _ => Ok(()),
        }
    }

    /// Whether every byte has been handed out.
    pub fn is_done(&self) -> bool {
        self.state == SendState::Done
    }
}

/// How many frames a message of `length` bytes takes, and how many data bytes each carries
/// (FD frames padded): what a transfer costs on the bus.
pub fn frame_lengths(length: usize, fd: bool) -> impl Iterator<Item = usize> {
    let whole = capacity(fd);
    let single = if length <= 7 {
        Some(length + 1)
    } else if fd && length <= 62 {
        Some(fd_length(length + 2))
    } else {
        None
    };
    let mut left = if single.is_some() { 0 } else { length.saturating_sub(whole - 2) };
    let consecutive = std::iter::from_fn(move || {
        let take = left.min(whole - 1);
        left -= take;
        (take > 0).then(|| if fd { fd_length(take + 1) } else { take + 1 })
    });
    std::iter::once(single.unwrap_or(whole)).chain(consecutive)
}
