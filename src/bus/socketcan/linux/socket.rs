//! Raw CAN socket: frames in batches, with the kernel's timestamps and drop counter. Does not know the
//! state of the interface.

use crate::frame::socketcan::{self as fields, EXTENDED_FLAG, FD_FORMAT, REMOTE_FLAG};
use crate::frame::{Frame, IdFilter};
use crate::status::KERNEL_BYTES_PER_FRAME;
use nix::cmsg_space;
use nix::libc::{MSG_DONTWAIT, MSG_PEEK, SO_RCVBUF, SO_RCVBUFFORCE, SO_RXQ_OVFL, SOL_SOCKET};
use nix::sys::socket::{ControlMessageOwned, MsgFlags, MultiHeaders, RecvMsg, recvmmsg, recvmsg};
use nix::sys::time::TimeSpec;
use socket2::SockAddr;
use socketcan::{CanFdSocket, CanFilter, Socket, SocketOptions};
use std::io::{self, ErrorKind, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};

/// Frames per system call.
const BATCH: usize = 64;
/// Frames read before frames are sent and the port is served.
const MAX_READ: usize = 1024;
/// The kernel's default receive buffer in bytes.
const USUAL_BUFFER: u32 = 212_992;
/// Requested receive buffer in bytes: one second of a full 1 Mbit/s bus. The default of 212,992 holds
/// under 300 frames. (The kernel doubles the value, and grants less without CAP_NET_ADMIN.)
const RECEIVE_BUFFER: i32 = 8 << 20;

/// Socket option: memory and drops of a socket (linux/socket.h, sock_diag.h).
const SO_MEMINFO: i32 = 55;
const MEMINFO_LEN: usize = 36;
const MEMINFO_DROPS: usize = 32;
/// Even the smallest receive buffer holds more frames, so nothing is dropped unless as many wait.
const MIN_BUFFER_FRAMES: usize = 64;

const CLASSIC_LEN: usize = 16;
const FD_LEN: usize = 72;
const DATA_AT: usize = 8;

/// A frame as the kernel delivers it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReceivedFrame {
    pub(super) frame: Frame,
    /// The kernel's timestamp in Unix microseconds; `None` without one.
    pub(super) stamp_micros: Option<u64>,
}

/// An open socket.
#[derive(Debug)]
pub(super) struct RawSocket {
    socket: CanFdSocket,
    /// The address that the kernel gave it, with the index of the interface.
    address: SockAddr,
    drops: Drops,
    /// Frames read since the drop counter was queried.
    since_query: usize,
    receive_buffer: Option<u32>,
    /// Frames read since the receive buffer was empty, and the most of them.
    waiting: u32,
    most_waiting: u32,
    unconfirmed: u64,
}

impl RawSocket {
    /// Opens a socket on the interface of this index. It receives FD frames, error frames and the
    /// loopback of sent frames; with patterns, only the data frames that match one.
    ///
    /// # Errors
    ///
    /// Those of the kernel.
    pub(super) fn open(ifindex: u32, only: &[IdFilter]) -> io::Result<Self> {
        let socket = CanFdSocket::open_iface(ifindex)?;
        if !only.is_empty() {
            // Extended identifiers only, no remote frames.
            let filters = only.iter().map(|pattern| {
                let mask = pattern.mask | EXTENDED_FLAG | REMOTE_FLAG;
                CanFilter::new(pattern.id | EXTENDED_FLAG, mask)
            });
            socket.set_filters(&filters.collect::<Vec<_>>())?;
        }
        socket.set_nonblocking(true)?;
        socket.set_recv_own_msgs(true)?;
        socket.set_error_filter_accept_all()?;
        socket.set_recv_timestamp(true)?;
        socket.set_socket_option_int(SOL_SOCKET, SO_RXQ_OVFL, 1)?;
        socket
            .set_socket_option_int(SOL_SOCKET, SO_RCVBUFFORCE, RECEIVE_BUFFER)
            .or_else(|_| socket.set_socket_option_int(SOL_SOCKET, SO_RCVBUF, RECEIVE_BUFFER))?;
        let receive_buffer = socket.get_socket_option_int(SOL_SOCKET, SO_RCVBUF);
        let address = socket.as_raw_socket().local_addr()?;
        Ok(Self {
            socket,
            address,
            drops: Drops::default(),
            since_query: 0,
            receive_buffer: receive_buffer.ok().and_then(|bytes| u32::try_from(bytes).ok()),
            waiting: 0,
            most_waiting: 0,
            unconfirmed: 0,
        })
    }

    /// Returns false if the interface was removed, or moved to another network namespace: the kernel then
    /// takes its index from the address of the socket for good.
    pub(super) fn is_bound(&self) -> bool {
        self.socket.as_raw_socket().local_addr().map_or(true, |address| address == self.address)
    }

    /// Appends the received frames, at most [`MAX_READ`] and one batch.
    ///
    /// The kernel marks the loopback of a sent frame by a message flag (`MSG_CONFIRM`) that the safe
    /// wrapper of recvmmsg does not pass on. So while sent frames are in flight, frames are read one
    /// by one, with the flag peeked at first; otherwise none can be loopback.
    pub(super) fn read(&mut self, frames: &mut Vec<ReceivedFrame>) -> io::Result<()> {
        let before = frames.len();
        let outcome = loop {
            let outcome =
                if self.unconfirmed == 0 { self.read_batch(frames) } else { self.read_one(frames) };
            // A batch that is not full has emptied the buffer.
            if !matches!(outcome, Ok(true)) || frames.len() - before >= MAX_READ {
                break outcome;
            }
        };
        self.since_query += frames.len() - before;
        self.waiting = self.waiting.saturating_add((frames.len() - before) as u32);
        self.most_waiting = self.most_waiting.max(self.waiting);
        if !matches!(outcome, Ok(true)) {
            self.waiting = 0;
        }
        match outcome {
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                if self.since_query >= MIN_BUFFER_FRAMES {
                    self.query_drops();
                }
                Ok(())
            }
            outcome => outcome.map(|_| ()),
        }
    }

    /// Reads the drop counter of the socket. A frame carries the drops before it; those after the
    /// last frame are known only to the socket (Linux 4.12 and later).
    pub(super) fn query_drops(&mut self) {
        self.since_query = 0;
        let mut info = [0; MEMINFO_LEN];
        let read = self.socket.get_socket_option_bytes(SOL_SOCKET, SO_MEMINFO, &mut info);
        if let (Ok(MEMINFO_LEN), Some(count)) = (read, info[MEMINFO_DROPS..].first_chunk()) {
            self.drops.note(u32::from_ne_bytes(*count));
        }
    }

    /// Returns true if there may be more.
    fn read_one(&mut self, frames: &mut Vec<ReceivedFrame>) -> io::Result<bool> {
        let peeked = self.socket.as_raw_socket();
        let (_, flags) = peeked.recv_vectored_with_flags(&mut [], MSG_PEEK | MSG_DONTWAIT)?;
        let mut bytes = [0; FD_LEN];
        let mut control = cmsg_space!(TimeSpec, u32);
        let mut slices = [IoSliceMut::new(&mut bytes)];
        let fd = self.socket.as_raw_fd();
        let message = recvmsg::<()>(fd, &mut slices, Some(&mut control), MsgFlags::MSG_DONTWAIT)?;
        let stamp_micros = self.drops.read_control(&message);
        let len = message.bytes;
        let Some(mut frame) = decode(&bytes[..len.min(FD_LEN)]) else { return Ok(true) };
        if flags.is_confirm() {
            frame.is_tx = true;
            self.unconfirmed = self.unconfirmed.saturating_sub(1);
        }
        frames.push(ReceivedFrame { frame, stamp_micros });
        Ok(true)
    }

    /// Returns true if there may be more.
    fn read_batch(&mut self, frames: &mut Vec<ReceivedFrame>) -> io::Result<bool> {
        let mut buffers = [[0; FD_LEN]; BATCH];
        let mut slices: Vec<_> =
            buffers.iter_mut().map(|buffer| [IoSliceMut::new(buffer)]).collect();
        // New for each call: the kernel shortens the control buffers to what it wrote and the wrapper
        // does not restore them, so that the first drop counter would not fit.
        let mut headers = MultiHeaders::<()>::preallocate(BATCH, Some(cmsg_space!(TimeSpec, u32)));
        let fd = self.socket.as_raw_fd();
        let messages = recvmmsg(fd, &mut headers, slices.iter_mut(), MsgFlags::MSG_DONTWAIT, None)?;
        let mut count = 0;
        for message in messages {
            count += 1;
            let stamp_micros = self.drops.read_control(&message);
            if let Some(frame) = message.iovs().next().and_then(decode) {
                frames.push(ReceivedFrame { frame, stamp_micros });
            }
        }
        Ok(count == BATCH)
    }

    /// Passes a frame to the kernel; never blocks.
    ///
    /// # Errors
    ///
    /// The kernel does not accept it.
    pub(super) fn send(&mut self, frame: &Frame) -> io::Result<()> {
        let (bytes, len) = encode(frame);
        self.socket.as_raw_socket().send_with_flags(&bytes[..len], MSG_DONTWAIT)?;
        self.unconfirmed += 1;
        Ok(())
    }

    /// Sent frames without loopback so far.
    pub(super) fn unconfirmed(&self) -> u64 {
        self.unconfirmed
    }

    /// Counts drops from now on: the buffer may have overflowed between opening the socket and the
    /// first read, before descan observed the bus.
    pub(super) fn start_counting(&mut self) {
        self.query_drops();
        self.drops.total = 0;
    }

    /// Forgets the frames in flight: the kernel drops them when the interface goes down.
    pub(super) fn forget_unconfirmed(&mut self) {
        self.unconfirmed = 0;
    }

    /// Frames lost because the receive buffer was full, as last read: see
    /// [`query_drops`](Self::query_drops).
    pub(super) fn drops(&self) -> u64 {
        self.drops.total
    }

    /// About how many frames the receive buffer holds.
    pub(super) fn capacity(&self) -> u32 {
        self.receive_buffer.unwrap_or(USUAL_BUFFER) / KERNEL_BYTES_PER_FRAME
    }

    /// The most frames that waited in the receive buffer at once; at most those that arrived while the
    /// others were read are counted with them.
    pub(super) fn most_waiting(&self) -> u32 {
        self.most_waiting
    }

    /// Size of the receive buffer in bytes, as the kernel counts them.
    pub(super) fn receive_buffer(&self) -> Option<u32> {
        self.receive_buffer
    }
}

impl AsFd for RawSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// The drop counter of the socket: 32 bits, wraps.
#[derive(Debug, Default)]
struct Drops {
    last: u32,
    total: u64,
}

impl Drops {
    /// Reads a message's control part: notes drops, returns the timestamp.
    fn read_control(&mut self, message: &RecvMsg<'_, '_, ()>) -> Option<u64> {
        let mut stamp = None;
        for control in message.cmsgs().into_iter().flatten() {
            match control {
                ControlMessageOwned::ScmTimestampns(time) => {
                    let (seconds, nanos) = (time.tv_sec(), time.tv_nsec());
                    stamp = u64::try_from(seconds * 1_000_000 + nanos / 1_000).ok();
                }
                ControlMessageOwned::RxqOvfl(count) => {
                    self.note(count);
                }
                _ => {}
            }
        }
        stamp
    }

    /// Notes a value of the counter. A frame that waited carries an earlier value than the socket:
    /// it is ignored.
    fn note(&mut self, count: u32) {
        let more = count.wrapping_sub(self.last);
        if more < u32::MAX / 2 {
            self.total += u64::from(more);
            self.last = count;
        }
    }
}

/// Decodes Linux's `can_frame` or `canfd_frame`; `None` if it is neither.
fn decode(bytes: &[u8]) -> Option<Frame> {
    let is_fd = match bytes.len() {
        CLASSIC_LEN => false,
        FD_LEN => true,
        _ => return None,
    };
    let (head, data) = bytes.split_at(DATA_AT);
    let word = u32::from_ne_bytes(*head.first_chunk()?);
    let frame = fields::decode(word, usize::from(head[4]), is_fd.then_some(head[5]), data)?;
    Some(frame.with_raw_dlc(head[7]))
}

/// Encodes `can_frame` or `canfd_frame`; returns it with its length.
fn encode(frame: &Frame) -> ([u8; FD_LEN], usize) {
    let mut bytes = [0; FD_LEN];
    bytes[..4].copy_from_slice(&fields::id_word(frame).to_ne_bytes());
    bytes[4] = frame.len() as u8;
    if frame.is_fd {
        bytes[5] = FD_FORMAT | fields::fd_flags(frame);
    }
    bytes[7] = frame.raw_dlc().unwrap_or(0);
    bytes[DATA_AT..][..frame.data().len()].copy_from_slice(frame.data());
    (bytes, if frame.is_fd { FD_LEN } else { CLASSIC_LEN })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::CanId;

    #[test]
    fn encoded_frames_decode_to_the_same() {
        let mut fd = Frame::fd(0x1234_5678, &[7; 40], 0xCC);
        fd.error_state = true;
        for frame in [
            Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]),
            Frame::new(CanId::Standard(0x7FF), &[]),
            Frame::remote(CanId::Standard(0x12), 4),
            Frame::remote(CanId::Extended(0x12), 0),
            Frame::error(0x24, &[0, 1, 2, 3, 4, 5, 6, 7]),
            Frame::classic(1, &[0xFF; 8]).with_raw_dlc(15),
            fd,
        ] {
            let (bytes, len) = encode(&frame);
            assert_eq!(decode(&bytes[..len]), Some(frame));
        }
    }

    #[test]
    fn drop_counter_wraps_and_ignores_earlier_values() {
        let mut drops = Drops::default();
        for count in [0, 5, 5, 3, 0x7000_0000, 0xC000_0000, 0xFFFF_FFFF, 2, 0xFFFF_FFFF] {
            drops.note(count);
        }
        assert_eq!(drops.total, 0x1_0000_0002);
    }

    #[test]
    fn drops_before_counting_starts_are_not_lost_frames() {
        let mut drops = Drops::default();
        drops.note(7);
        drops.total = 0;
        // Frames that waited in the buffer carry the counter of before.
        for count in [1, 7, 9] {
            drops.note(count);
        }
        assert_eq!(drops.total, 2);
    }

    #[test]
    fn malformed_frames_are_rejected() {
        assert_eq!(decode(&[]), None);
        assert_eq!(decode(&[0; 15]), None);
        let mut too_long = [0; CLASSIC_LEN];
        too_long[4] = 9;
        assert_eq!(decode(&too_long), None);
    }
}
