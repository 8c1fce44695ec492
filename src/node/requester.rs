//! One requester that a node serves: which of its requests are to be answered, and the transfer of
//! the answer that is under way (ISO 15765-2, sender's side).
//!
//! The segmenter of [`crate::wire::isotp`] is not used: it has one message in a buffer, and counts
//! STmin from the call that returns a frame instead of from the end of its transmission.

use super::after;
use crate::time::Instant;
use crate::wire::descriptor::DescriptorField;
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Service};
use crate::wire::isotp::{FlowControl, FlowStatus, N_WFT_MAX, TIMEOUT};
use crate::wire::node::Mode;

/// What a response carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ResponseKind {
    Name(Framing),
    Services(Framing),
    /// No data: ERR tells whether the command is executed.
    Command,
    Field(DescriptorField),
}

impl ResponseKind {
    /// The bit of a set of pending responses; the lowest is sent first.
    const fn bit(self) -> u16 {
        match self {
            Self::Name(Framing::Isotp) => 1,
            Self::Name(Framing::Raw) => 1 << 1,
            Self::Services(Framing::Isotp) => 1 << 2,
            Self::Services(Framing::Raw) => 1 << 3,
            Self::Command => 1 << 4,
            Self::Field(field) => 1 << (5 + field as u16),
        }
    }

    /// Returns the first of a set; `None` if it is empty.
    fn first(set: u16) -> Option<Self> {
        let others = [
            Self::Name(Framing::Isotp),
            Self::Name(Framing::Raw),
            Self::Services(Framing::Isotp),
            Self::Services(Framing::Raw),
            Self::Command,
        ];
        let fields = DescriptorField::ALL.into_iter().map(Self::Field);
        others.into_iter().chain(fields).find(|kind| kind.bit() & set != 0)
    }
}

/// What a command does after its response was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CommandEffect {
    Nothing,
    Enter(Mode),
    Identify,
    Reboot,
}

/// A command or write that is to be answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NodeCommand {
    pub(super) service: Service,
    /// `None`: refused.
    pub(super) effect: Option<CommandEffect>,
    /// True while the settings are being stored: the response waits.
    pub(super) is_storing: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TransferState {
    /// No requester.
    Free,
    /// The next frame may be sent.
    Ready,
    /// The next frame may be sent then (STmin).
    Separated(Instant),
    /// A frame is in the transmit buffer.
    Sending,
    /// Waits for flow control until then (N_Bs).
    AwaitFlow { until: Instant, waits: u8 },
}

/// A requester that is being served, or a free place for one.
#[derive(Clone, Copy, Debug)]
pub(super) struct ServedRequester {
    pub(super) peer: Address,
    pub(super) is_fd: bool,
    pub(super) command: NodeCommand,
    /// Bytes of the current response that were sent.
    pub(super) sent: u16,
    /// Bytes of the current response that follow them.
    pub(super) left: u16,
    /// Sequence number of the next consecutive frame, modulo 256.
    pub(super) sequence: u8,
    /// The response that is being sent; `None`: none was begun.
    current: Option<ResponseKind>,
    /// Responses to send, one bit each; the current one included.
    pending: u16,
    /// Frames until the next flow control; 0: no further one.
    block_left: u8,
    /// Flow control of the receiver: its STmin counts.
    flow: FlowControl,
    state: TransferState,
}

impl ServedRequester {
    pub(super) const FREE: Self = Self {
        peer: Address::DEBUG,
        is_fd: false,
        command: NodeCommand { service: Service::from_bits(0), effect: None, is_storing: false },
        sent: 0,
        left: 0,
        sequence: 0,
        current: None,
        pending: 0,
        block_left: 0,
        flow: FlowControl { status: FlowStatus::Continue, block_size: 0, st_min: 0 },
        state: TransferState::Free,
    };

    pub(super) fn is_free(&self) -> bool {
        self.state == TransferState::Free
    }

    /// Adds a request; returns false if it is dropped, for there is room for one command.
    pub(super) fn add(&mut self, peer: Address, is_fd: bool, kind: ResponseKind) -> bool {
        if self.is_free() {
            *self = Self { peer, is_fd, state: TransferState::Ready, ..Self::FREE };
        } else if kind == ResponseKind::Command && self.pending & kind.bit() != 0 {
            return false;
        } else if self.current == Some(kind) {
            // A requester that asks again gave up the transfer that is under way: begin again.
            self.current = None;
            self.is_fd = is_fd;
            if self.state != TransferState::Sending {
                self.state = TransferState::Ready;
            }
        }
        self.pending |= kind.bit();
        true
    }

    /// Returns the response whose next frame may be sent; `None` if there is none.
    pub(super) fn ready(&self) -> Option<ResponseKind> {
        if self.state != TransferState::Ready {
            return None;
        }
        let waiting = if self.command.is_storing { ResponseKind::Command.bit() } else { 0 };
        self.current.or_else(|| ResponseKind::first(self.pending & !waiting))
    }

    /// Begins or continues a response: its next frame goes into the transmit buffer.
    pub(super) fn begin(&mut self, kind: ResponseKind) {
        if self.current.is_none() {
            self.current = Some(kind);
            (self.sent, self.left, self.sequence) = (0, 0, 0);
            self.block_left = 1; // A first frame needs flow control.
        }
        self.state = TransferState::Sending;
    }

    /// Handles the end of a frame's transmission; returns the effect of a command whose response was
    /// sent.
    pub(super) fn handle_transmitted(&mut self, is_sent: bool, now: Instant) -> CommandEffect {
        if self.state != TransferState::Sending {
            return CommandEffect::Nothing;
        }
        if is_sent && self.left > 0 && self.current.is_some() {
            self.continue_transfer(now);
            return CommandEffect::Nothing;
        }
        let is_command = is_sent && self.current == Some(ResponseKind::Command);
        self.finish();
        self.command.effect.filter(|_| is_command).unwrap_or(CommandEffect::Nothing)
    }

    fn continue_transfer(&mut self, now: Instant) {
        let is_block_end = self.block_left == 1;
        self.block_left = self.block_left.saturating_sub(1);
        self.state = if is_block_end {
            TransferState::AwaitFlow { until: now + TIMEOUT, waits: 0 }
        } else if self.flow.st_min == 0 {
            TransferState::Ready
        } else {
            TransferState::Separated(after(now, u64::from(self.flow.separation_micros())))
        };
    }

    /// Ends the current response: turns to the next one.
    fn finish(&mut self) {
        if let Some(kind) = self.current.take() {
            self.pending &= !kind.bit();
        }
        let is_done = self.pending == 0;
        self.state = if is_done { TransferState::Free } else { TransferState::Ready };
    }

    /// Takes flow control; ignored unless it is awaited.
    pub(super) fn handle_flow(&mut self, flow: FlowControl, now: Instant) {
        let TransferState::AwaitFlow { waits, .. } = self.state else { return };
        match flow.status {
            FlowStatus::Continue => {
                self.block_left = flow.block_size;
                self.flow = flow;
                self.state = TransferState::Ready;
            }
            FlowStatus::Wait if waits < N_WFT_MAX => {
                let until = now + TIMEOUT;
                self.state = TransferState::AwaitFlow { until, waits: waits + 1 };
            }
            FlowStatus::Wait | FlowStatus::Overflow => self.finish(),
        }
    }

    /// Handles a deadline that is over.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        match self.state {
            TransferState::Separated(until) if until <= now => self.state = TransferState::Ready,
            TransferState::AwaitFlow { until, .. } if until <= now => self.finish(),
            _ => {}
        }
    }

    /// Returns when to call [`Self::handle_timeout`].
    pub(super) fn deadline(&self) -> Option<Instant> {
        match self.state {
            TransferState::Separated(until) | TransferState::AwaitFlow { until, .. } => Some(until),
            TransferState::Free | TransferState::Ready | TransferState::Sending => None,
        }
    }
}
