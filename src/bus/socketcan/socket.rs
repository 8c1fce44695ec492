//! One raw CAN socket: frames in batches, with the kernel's stamps and drop counter.
//!
//! Does not know what state the interface is in, nor what is to be done about it.

use crate::frame::socketcan::{self as fields, EXTENDED_FLAG, FD_FORMAT, REMOTE_FLAG};
use crate::frame::{Frame, IdPattern};
use nix::cmsg_space;
use nix::libc::{MSG_DONTWAIT, MSG_PEEK, SO_RCVBUF, SO_RCVBUFFORCE, SO_RXQ_OVFL, SOL_SOCKET};
use nix::sys::socket::{ControlMessageOwned, MsgFlags, MultiHeaders, RecvMsg, recvmmsg, recvmsg};
use nix::sys::time::TimeSpec;
use socketcan::{CanFdSocket, CanFilter, Socket, SocketOptions};
use std::io::{self, ErrorKind, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};

/// Frames per system call.
const BATCH: usize = 64;
/// Frames that are read before anything else is looked after.
const MOST: usize = 1024;
/// What the kernel reckons for a frame that waits in the receive buffer, about.
const BYTES_PER_FRAME: u32 = 800;
/// What the kernel gives at least where nobody changed its settings.
const USUAL_BUFFER: u32 = 212_992;
/// The receive buffer asked for. The kernel counts some 800 bytes for each frame, so the usual
/// 212,992 hold under 300; this holds a second of a full 1 Mbit/s bus. (It doubles it, and
/// grants less to users who may not force it.)
const RECEIVE_BUFFER: i32 = 8 << 20;

/// Reads how much memory a socket takes, and how much it dropped (linux/socket.h, sock_diag.h).
const SO_MEMINFO: i32 = 55;
const MEMINFO_LEN: usize = 36;
const MEMINFO_DROPS: usize = 32;
/// The smallest receive buffer holds more frames than that, so nothing is dropped unless as many
/// wait to be read.
const MIN_BUFFER_FRAMES: usize = 64;

const CLASSIC_LEN: usize = 16;
const FD_LEN: usize = 72;
const DATA_AT: usize = 8;

/// A frame as the kernel delivers it: ours or not, and when.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReceivedFrame {
    pub(super) frame: Frame,
    /// When the kernel got it, in Unix microseconds.
    pub(super) stamp_micros: Option<u64>,
}

/// An open socket.
#[derive(Debug)]
pub(super) struct RawSocket {
    socket: CanFdSocket,
    drops: Drops,
    /// Frames read since the kernel was asked for drops.
    unasked: usize,
    receive_buffer: Option<u32>,
    unconfirmed: u64,
}

impl RawSocket {
    /// Opens, on the interface of this index, a socket that hears everything: FD frames, error
    /// reports, and our own frames once they are on the bus; where patterns are given, of data
    /// frames only those that fit one of them.
    pub(super) fn open(ifindex: u32, only: &[IdPattern]) -> io::Result<Self> {
        let socket = CanFdSocket::open_iface(ifindex)?;
        if !only.is_empty() {
            // The flags say extended, and no remote request.
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
        Ok(Self {
            socket,
            drops: Drops::default(),
            unasked: 0,
            receive_buffer: receive_buffer.ok().and_then(|bytes| u32::try_from(bytes).ok()),
            unconfirmed: 0,
        })
    }

    /// Appends what has arrived, at most [`MOST`] or a batch more; nothing if nothing has.
    ///
    /// Whether a frame is ours the kernel says in a message flag (`MSG_CONFIRM`) that the safe
    /// wrapper of recvmmsg does not pass on. So while frames of ours are under way we read one
    /// by one and look at that flag first; otherwise none can be ours.
    pub(super) fn read(&mut self, frames: &mut Vec<ReceivedFrame>) -> io::Result<()> {
        let before = frames.len();
        let outcome = loop {
            let outcome =
                if self.unconfirmed == 0 { self.read_batch(frames) } else { self.read_one(frames) };
            // A batch that is not full has emptied the buffer.
            if !matches!(outcome, Ok(true)) || frames.len() - before >= MOST {
                break outcome;
            }
        };
        self.unasked += frames.len() - before;
        match outcome {
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                if self.unasked >= MIN_BUFFER_FRAMES {
                    self.query_drops();
                }
                Ok(())
            }
            outcome => outcome.map(|_| ()),
        }
    }

    /// A frame tells of the drops before it; of those after the last frame only the socket itself
    /// does. Kernels before 4.12 do not.
    pub(super) fn query_drops(&mut self) {
        self.unasked = 0;
        let mut info = [0; MEMINFO_LEN];
        let read = self.socket.get_socket_option_bytes(SOL_SOCKET, SO_MEMINFO, &mut info);
        if let (Ok(MEMINFO_LEN), Some(count)) = (read, info[MEMINFO_DROPS..].first_chunk()) {
            self.drops.note(u32::from_ne_bytes(*count));
        }
    }

    /// Says whether there may be more.
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

    /// Says whether there may be more.
    fn read_batch(&mut self, frames: &mut Vec<ReceivedFrame>) -> io::Result<bool> {
        let mut buffers = [[0; FD_LEN]; BATCH];
        let mut slices: Vec<_> =
            buffers.iter_mut().map(|buffer| [IoSliceMut::new(buffer)]).collect();
        // Made anew for each call: the kernel shortens the control buffers to what it wrote, the
        // wrapper leaves them so, and the first drop counter would not fit any more.
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

    /// Hands a frame to the kernel, or says at once why it does not take it.
    pub(super) fn send(&mut self, frame: &Frame) -> io::Result<()> {
        let (bytes, len) = encode(frame);
        self.socket.as_raw_socket().send_with_flags(&bytes[..len], MSG_DONTWAIT)?;
        self.unconfirmed += 1;
        Ok(())
    }

    /// Frames handed to the kernel that have not been seen on the bus.
    pub(super) fn unconfirmed(&self) -> u64 {
        self.unconfirmed
    }

    /// The interface went down: the kernel threw away what it still had to send.
    pub(super) fn forget_unconfirmed(&mut self) {
        self.unconfirmed = 0;
    }

    /// Frames that found the receive buffer full, as far as is known: see
    /// [`ask_for_drops`](Self::ask_for_drops).
    pub(super) fn drops(&self) -> u64 {
        self.drops.total
    }

    /// How many frames may wait to be read, about.
    pub(super) fn capacity(&self) -> u32 {
        self.receive_buffer.unwrap_or(USUAL_BUFFER) / BYTES_PER_FRAME
    }

    /// Bytes of the receive buffer, as the kernel counts them.
    pub(super) fn receive_buffer(&self) -> Option<u32> {
        self.receive_buffer
    }
}

impl AsFd for RawSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// The drop counter of the socket, which is 32 bits wide and wraps.
#[derive(Debug, Default)]
struct Drops {
    last: u32,
    total: u64,
}

impl Drops {
    /// Reads a message's control part: counts drops, and gives the stamp.
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

    /// The kernel counts as far as `count` now. A frame that waited tells an earlier count than
    /// the socket did: that is no news.
    fn note(&mut self, count: u32) {
        let more = count.wrapping_sub(self.last);
        if more < u32::MAX / 2 {
            self.total += u64::from(more);
            self.last = count;
        }
    }
}

/// Reads Linux's `can_frame` or `canfd_frame`.
fn decode(bytes: &[u8]) -> Option<Frame> {
    let is_fd = match bytes.len() {
        CLASSIC_LEN => false,
        FD_LEN => true,
        _ => return None,
    };
    let (head, data) = bytes.split_at(DATA_AT);
    let word = u32::from_ne_bytes(*head.first_chunk()?);
    fields::decode(word, usize::from(head[4]), is_fd.then_some(head[5]), data)
}

/// Writes `can_frame` or `canfd_frame`; says how long it is.
fn encode(frame: &Frame) -> ([u8; FD_LEN], usize) {
    let mut bytes = [0; FD_LEN];
    bytes[..4].copy_from_slice(&fields::id_word(frame).to_ne_bytes());
    bytes[4] = frame.len() as u8;
    if frame.fd {
        bytes[5] = FD_FORMAT | fields::fd_flags(frame);
    }
    bytes[DATA_AT..][..frame.data().len()].copy_from_slice(frame.data());
    (bytes, if frame.fd { FD_LEN } else { CLASSIC_LEN })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::CanId;

    #[test]
    fn frames_survive_the_kernel_layout() {
        let mut fd = Frame::fd(0x1234_5678, &[7; 40], 0xCC);
        fd.error_state = true;
        for frame in [
            Frame::classic(0x0201_5402, &[4, 0x44, 0x45, 0x53, 1]),
            Frame::with(CanId::Standard(0x7FF), &[]),
            Frame::remote(CanId::Standard(0x12), 4),
            Frame::remote(CanId::Extended(0x12), 0),
            Frame::error(0x24, &[0, 1, 2, 3, 4, 5, 6, 7]),
            fd,
        ] {
            let (bytes, len) = encode(&frame);
            assert_eq!(decode(&bytes[..len]), Some(frame));
        }
    }

    #[test]
    fn the_drop_counter_wraps_and_an_earlier_count_is_no_news() {
        let mut drops = Drops::default();
        for count in [0, 5, 5, 3, 0x7000_0000, 0xC000_0000, 0xFFFF_FFFF, 2, 0xFFFF_FFFF] {
            drops.note(count);
        }
        assert_eq!(drops.total, 0x1_0000_0002);
    }

    #[test]
    fn what_is_no_frame_is_left_out() {
        assert_eq!(decode(&[]), None);
        assert_eq!(decode(&[0; 15]), None);
        let mut too_long = [0; CLASSIC_LEN];
        too_long[4] = 9;
        assert_eq!(decode(&too_long), None);
    }
}
