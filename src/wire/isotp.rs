//! ISO 15765-2 transfers with normal addressing: messages longer than one frame, segmented and
//! reassembled under flow control.
//!
//! Source: ISO 15765-2, protocol §3.1. [`Reassembly`] and [`Segmenter`] are one transfer each, in a
//! buffer of the caller's (a `Vec<u8>`, an array, a borrowed slice). Time is passed in. Does not
//! know identifiers or how many transfers are open.

use super::des::MAX_MESSAGE;
use crate::frame::{Frame, fd_length};
use crate::time::{Duration, Instant};

/// N_Bs and N_Cr: longest wait of a sender for flow control, and of a receiver for the next
/// consecutive frame.
pub const TIMEOUT: Duration = Duration::from_secs(1);
/// Most WAIT flow controls in a row that a sender accepts.
pub const N_WFT_MAX: u8 = 16;

/// Flow status of a flow control frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowStatus {
    /// Continue sending.
    Continue,
    /// Wait for the next flow control.
    Wait,
    /// The message is too long for the receiver: abort.
    Overflow,
}

/// A flow control frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlowControl {
    /// Continue, wait or abort.
    pub status: FlowStatus,
    /// Block size: consecutive frames until the next flow control; 0 = no further flow control.
    pub block_size: u8,
    /// STmin as coded: 00 to 7F milliseconds, F1 to F9 hundreds of microseconds.
    pub st_min: u8,
}

impl FlowControl {
    /// Returns the three bytes of the frame.
    pub const fn encode(self) -> [u8; 3] {
        let status = match self.status {
            FlowStatus::Continue => 0x30,
            FlowStatus::Wait => 0x31,
            FlowStatus::Overflow => 0x32,
        };
        [status, self.block_size, self.st_min]
    }

    /// Returns the minimum time between two consecutive frames. Reserved codes count as 127 ms
    /// (ISO 15765-2).
    pub const fn separation(self) -> Duration {
        Duration::from_micros(self.separation_micros() as u64)
    }

    /// Returns [`Self::separation`] in microseconds: as a [`Duration`] it takes a division of 64 bits.
    pub(crate) const fn separation_micros(self) -> u32 {
        match self.st_min {
            0..=0x7F => self.st_min as u32 * 1000,
            0xF1..=0xF9 => (self.st_min as u32 - 0xF0) * 100,
            _ => 127_000,
        }
    }
}

/// Protocol control information (PCI) of a frame, with its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pci<'a> {
    /// Single frame: the whole message.
    Single(&'a [u8]),
    /// First frame.
    First {
        /// Length of the whole message, in bytes.
        length: u32,
        /// First bytes of the message.
        data: &'a [u8],
    },
    /// Consecutive frame.
    Consecutive {
        /// Sequence number, 0 to 15.
        sequence: u8,
        /// Bytes of the message; in the last frame also padding.
        data: &'a [u8],
    },
    /// Flow control.
    Flow(FlowControl),
}

/// Why the data of a frame are not an ISO 15765-2 frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PciFault {
    /// No data.
    #[error("empty frame")]
    Empty,
    /// The length in the PCI does not fit the frame.
    #[error("a length that does not fit the frame")]
    BadLength,
    /// Reserved frame type or flow status.
    #[error("an unknown frame type")]
    UnknownType,
}

impl<'a> Pci<'a> {
    /// Reads the data of a frame. `fd`: the frame is a CAN FD frame.
    ///
    /// # Errors
    /// [`PciFault`] if the data are not an ISO 15765-2 frame.
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

/// Data of one frame to be sent, at most 64 bytes.
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

    /// Returns the data, without padding.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }

    /// Returns a frame with identifier `id` and these data. With `fd`, pads the data with `padding`
    /// to the next length that a DLC can express.
    pub fn into_frame(self, id: u32, fd: bool, padding: u8) -> Frame {
        if fd {
            Frame::fd(id, self.as_bytes(), padding)
        } else {
            Frame::classic(id, self.as_bytes())
        }
    }
}

/// Returns the most data bytes of a frame: 64 with `fd`, else 8.
const fn capacity(fd: bool) -> usize {
    if fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA }
}

/// Returns a single frame with `message`; `None` if the message is empty or too long for one.
pub fn single_frame(message: &[u8], fd: bool) -> Option<Segment> {
    match message.len() {
        1..=7 => Some(Segment::new(&[&[message.len() as u8], message])),
        8..=62 if fd => Some(Segment::new(&[&[0, message.len() as u8], message])),
        _ => None,
    }
}

/// Why a transfer was aborted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum TransferFault {
    /// Unexpected sequence number: a frame was lost, or two senders use the identifier.
    #[error("consecutive frame out of sequence after {after} bytes")]
    WrongSequenceNumber {
        /// Bytes of the message received until then.
        after: usize,
    },
    /// No consecutive frame in time (N_Cr).
    #[error("no consecutive frame within 1 s after {after} bytes")]
    TimeoutCr {
        /// Bytes of the message received until then.
        after: usize,
    },
    /// No flow control in time (N_Bs).
    #[error("no flow control within 1 s")]
    TimeoutBs,
    /// The length in the first frame, in bytes, exceeds [`MAX_MESSAGE`] or the buffer.
    #[error("{0} bytes exceed the limit of 4095")]
    TooLong(u32),
    /// A first frame whose message fits a single frame, or that is not full.
    #[error("first frame with invalid length")]
    BadFirstFrame,
    /// The receiver sent OVERFLOW.
    #[error("flow control: overflow")]
    BufferOverflow,
    /// The receiver sent more than [`N_WFT_MAX`] WAITs in a row.
    #[error("flow control: too many WAIT frames")]
    TooManyWaits,
}

/// State of a transfer after a consecutive frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReassemblyProgress {
    /// More frames follow.
    More,
    /// More frames follow after flow control.
    BlockEnd,
    /// The message is complete.
    Done,
}

/// A segmented message in reception, addressed to this node or overheard.
///
/// ```
/// use descan::time::Instant;
/// use descan::wire::isotp::{Reassembly, ReassemblyProgress};
///
/// let first = [0x10, 9, 1, b'B', b'O', b'I', b'L', b'E'];
/// let mut transfer = Reassembly::start(Instant::ZERO, 9, &first[2..], 8, 0, [0; 64]).unwrap();
/// let progress = transfer.push(Instant::ZERO, 1, b"R2\0").unwrap();
/// assert_eq!(progress, ReassemblyProgress::Done);
/// assert_eq!(transfer.message(), b"\x01BOILER2\0");
/// ```
#[derive(Clone, Debug)]
pub struct Reassembly<B> {
    buffer: B,
    received: usize,
    length: usize,
    /// Message bytes in a full consecutive frame.
    part: usize,
    next_sequence: u8,
    block_size: u8,
    block_left: u8,
    deadline: Instant,
}

impl<B: AsRef<[u8]> + AsMut<[u8]>> Reassembly<B> {
    /// Starts with a first frame.
    ///
    /// `length`: length of the message in bytes; `data`: its first bytes; `frame_len`: data bytes
    /// of the frame, which all but the last consecutive frame have too; `block_size`: as in the
    /// flow control sent for it, 0 = no further flow control; `buffer`: takes the message, at least
    /// `length` bytes.
    ///
    /// # Errors
    /// [`TransferFault::TooLong`] if the message exceeds [`MAX_MESSAGE`] or the buffer,
    /// [`TransferFault::BadFirstFrame`] if it fits a single frame or the frame is not full.
    pub fn start(
        now: Instant,
        length: u32,
        data: &[u8],
        frame_len: usize,
        block_size: u8,
        mut buffer: B,
    ) -> Result<Self, TransferFault> {
        let bytes = buffer.as_mut();
        if length as usize > MAX_MESSAGE.min(bytes.len()) {
            return Err(TransferFault::TooLong(length));
        }
        let fits_single = if frame_len > Frame::MAX_CLASSIC_DATA { frame_len - 2 } else { 7 };
        if length as usize <= fits_single || frame_len < Frame::MAX_CLASSIC_DATA {
            return Err(TransferFault::BadFirstFrame);
        }
        let received = data.len().min(length as usize);
        bytes[..received].copy_from_slice(&data[..received]);
        Ok(Self {
            buffer,
            received,
            length: length as usize,
            part: frame_len - 1,
            next_sequence: 1,
            block_size,
            block_left: block_size,
            deadline: now + TIMEOUT,
        })
    }

    /// Changes the block size, to that in the flow control sent next.
    pub fn set_block_size(&mut self, block_size: u8) {
        self.block_size = block_size;
        self.block_left = block_size;
    }

    /// Returns the sequence number of the next consecutive frame.
    pub fn next_sequence(&self) -> u8 {
        self.next_sequence
    }

    /// Takes a consecutive frame: its sequence number and its data, padding included.
    ///
    /// # Errors
    /// [`TransferFault::WrongSequenceNumber`] if the number is not the next one or data are
    /// missing. The transfer is over then.
    pub fn push(
        &mut self,
        now: Instant,
        sequence: u8,
        data: &[u8],
    ) -> Result<ReassemblyProgress, TransferFault> {
        let take = (self.length - self.received).min(self.part);
        if sequence != self.next_sequence || data.len() < take {
            return Err(TransferFault::WrongSequenceNumber { after: self.received });
        }
        let end = self.received + take;
        self.buffer.as_mut()[self.received..end].copy_from_slice(&data[..take]);
        self.received = end;
        self.next_sequence = (sequence + 1) & 0x0F;
        self.deadline = now + TIMEOUT;
        if self.received == self.length {
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

    /// Returns the bytes received so far; the whole message after [`ReassemblyProgress::Done`].
    pub fn message(&self) -> &[u8] {
        &self.buffer.as_ref()[..self.received]
    }

    /// Returns the buffer, whose first bytes are the [`message`](Self::message).
    pub fn into_buffer(self) -> B {
        self.buffer
    }

    /// Returns when to abort the transfer if no frame arrives before (N_Cr).
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

/// A message in transmission.
#[derive(Clone, Debug)]
pub struct Segmenter<B> {
    message: B,
    sent: usize,
    sequence: u8,
    fd: bool,
    separation: Duration,
    state: SendState,
}

impl<B: AsRef<[u8]>> Segmenter<B> {
    /// Starts to send `message`, 1 to 4095 bytes; an empty message is done at once.
    pub fn new(message: B, fd: bool) -> Self {
        let state = if message.as_ref().is_empty() { SendState::Done } else { SendState::First };
        Self { message, sent: 0, sequence: 1, fd, separation: Duration::ZERO, state }
    }

    /// Returns the next frame's data; `None` if no frame may be sent at `now`.
    pub fn poll(&mut self, now: Instant) -> Option<Segment> {
        let message = self.message.as_ref();
        match self.state {
            SendState::First => {
                if let Some(single) = single_frame(message, self.fd) {
                    self.state = SendState::Done;
                    return Some(single);
                }
                let length = message.len().min(MAX_MESSAGE);
                let take = capacity(self.fd) - 2;
                self.sent = take;
                self.state = SendState::AwaitFlow { until: now + TIMEOUT, waits: 0 };
                Some(Segment::new(&[&[0x10 | (length >> 8) as u8, length as u8], &message[..take]]))
            }
            SendState::Sending { block_left, next_at } if now >= next_at => {
                let take = (message.len() - self.sent).min(capacity(self.fd) - 1);
                let data = &message[self.sent..self.sent + take];
                let segment = Segment::new(&[&[0x20 | self.sequence], data]);
                self.sent += take;
                self.sequence = (self.sequence + 1) & 0x0F;
                self.state = match block_left {
                    _ if self.sent == message.len() => SendState::Done,
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

    /// Takes flow control from the receiver; ignored unless it is awaited.
    ///
    /// # Errors
    /// [`TransferFault::BufferOverflow`] for OVERFLOW, [`TransferFault::TooManyWaits`].
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
            FlowStatus::Wait if waits < N_WFT_MAX => {
                self.state = SendState::AwaitFlow { until: now + TIMEOUT, waits: waits + 1 };
                Ok(())
            }
            FlowStatus::Wait => Err(TransferFault::TooManyWaits),
            FlowStatus::Overflow => Err(TransferFault::BufferOverflow),
        }
    }

    /// Returns when to call [`poll`](Self::poll) and [`handle_timeout`](Self::handle_timeout) next;
    /// `None` once the whole message was sent. After both, it is later than their `now`.
    pub fn poll_timeout(&self) -> Option<Instant> {
        match self.state {
            SendState::First => Some(Instant::ZERO),
            SendState::AwaitFlow { until, .. } => Some(until),
            SendState::Sending { next_at, .. } => Some(next_at),
            SendState::Done => None,
        }
    }

    /// Checks whether flow control is overdue.
    ///
    /// # Errors
    /// [`TransferFault::TimeoutBs`] if it is (N_Bs): the transfer is over; drop it.
    pub fn handle_timeout(&self, now: Instant) -> Result<(), TransferFault> {
        match self.state {
            SendState::AwaitFlow { until, .. } if now >= until => Err(TransferFault::TimeoutBs),
            _ => Ok(()),
        }
    }

    /// Returns true if [`poll`](Self::poll) has returned the whole message.
    pub fn is_done(&self) -> bool {
        self.state == SendState::Done
    }
}

/// Yields the data lengths of the frames that a message of `length` bytes takes, in bytes, FD
/// frames with their padding: the cost of a transfer on the bus.
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
    let consecutive = core::iter::from_fn(move || {
        let take = left.min(whole - 1);
        left -= take;
        (take > 0).then(|| if fd { fd_length(take + 1) } else { take + 1 })
    });
    core::iter::once(single.unwrap_or(whole)).chain(consecutive)
}
