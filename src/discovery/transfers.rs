//! Multi-frame responses: ISO-TP reassembly per identifier, bounded per source.
//!
//! Two devices at one address send with one identifier. Of their two transfers, each takes the
//! frames with the sequence number that it expects; where both expect the same, the one that
//! received nothing for longer: the slower device stays the slower one.
//!
//! Flow control cannot be addressed to one of the two. It releases both if both wait for it, and
//! then they send different frames with one identifier at once, which destroy each other until both
//! devices are bus-off. So it is sent before the other one responds, or after the first transfer.
//! Where both wait, it is refused, unless both began the same name, as equal devices do: then it
//! permits one frame, whose two copies merge, and the next one only if no other came.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::{self, MAX_MESSAGE};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{FlowControl, FlowStatus, Reassembly, ReassemblyProgress, TransferFault};

/// Maximum number of open transfers of one source: one for each of four requesters.
const MAX_PER_SOURCE: usize = 4;
/// Maximum number of them with one identifier: of two devices at one address.
const MAX_PER_ID: usize = 2;
/// Longest time from the end of a transfer to the rest of another one that was sent between its
/// frames: a few frames on a busy bus. At 125 kbit/s a frame takes 1.2 ms.
const INTERLEAVED_REST: Duration = Duration::from_millis(100);

/// Transfer that is being received.
#[derive(Clone, Debug)]
struct RxTransfer {
    id: u32,
    first: Frame,
    /// Type of the message; `None` if the first frame has no data.
    message_type: Option<u8>,
    reassembly: Reassembly<Vec<u8>>,
    /// Time of its last frame.
    last_at: Instant,
    /// True if no consecutive frame was received.
    is_empty: bool,
    /// Consecutive frames that the last flow control permits.
    permitted: u32,
    /// True if another one of its identifier began later: if its frames stop, one device began its
    /// response anew.
    is_superseded: bool,
    flow_control: FlowControlState,
    /// Time after each frame in which that of another device with the same response may come; `None`
    /// if no other one is known.
    step: Option<Duration>,
}

/// Flow control to send.
#[derive(Clone, Debug)]
pub(super) struct DueFlowControl {
    pub status: FlowStatus,
    /// First frame of the transfer.
    pub first: Frame,
    /// True if it permits one frame only.
    pub in_steps: bool,
}

/// State of descan's flow control after a first frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FlowControlState {
    /// Sent, or that of another requester.
    Sent,
    /// Due at this time, unless another first frame comes before.
    DueAt(Instant),
    /// Due after the other transfer of its identifier.
    AfterOther,
    /// Another sender waits for the same flow control: both have to stop.
    Refused,
}

/// Two transfers of one identifier, and the last consecutive frame of them.
#[derive(Clone, Debug)]
struct TransferPair {
    id: u32,
    last: Option<(Instant, Frame)>,
    /// True if a frame was received twice in a row.
    has_equal: bool,
}

/// What a consecutive frame shows about two transfers of one identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Interleaving {
    /// It has the sequence number of the one before it: a second transfer is under way.
    Equal,
    /// It also has other data: no device repeats its own frame so.
    Differs,
}

/// Result of a first frame.
#[derive(Clone, Debug)]
pub(super) enum Started {
    /// A transfer is open.
    Open,
    /// Refused.
    Fault(TransferFault),
}

/// Result of a consecutive frame.
#[derive(Clone, Debug)]
pub(super) enum Continued {
    /// No transfer is open for it: a late frame.
    Unknown,
    /// More frames follow.
    More,
    /// More frames follow after flow control.
    BlockEnd,
    /// The message is complete.
    Done(Vec<u8>),
    /// The transfer was aborted; with its first frame.
    Fault(TransferFault, Frame),
}

/// A transfer whose sender stopped.
#[derive(Clone, Debug)]
pub(super) struct Stopped {
    pub header: Header,
    pub fault: TransferFault,
    /// First frame of the transfer.
    pub first: Frame,
    /// True if its sender waits for flow control of the requester.
    pub lacks_flow_control: bool,
}

impl From<RxTransfer> for Stopped {
    fn from(transfer: RxTransfer) -> Self {
        let RxTransfer { id, first, reassembly, permitted, .. } = transfer;
        Self {
            header: Header::decode(id),
            fault: TransferFault::TimeoutCr { after: reassembly.message().len() },
            first,
            lacks_flow_control: permitted == 0,
        }
    }
}

/// Open transfers of one bus.
#[derive(Clone, Debug)]
pub(super) struct Transfers {
    by_source: Vec<Vec<RxTransfer>>,
    /// Last pair of each source, until it was reported.
    pairs: Vec<Option<TransferPair>>,
    open: usize,
}

impl Transfers {
    pub fn new() -> Self {
        Self {
            by_source: (0..Address::COUNT).map(|_| Vec::new()).collect(),
            pairs: (0..Address::COUNT).map(|_| None).collect(),
            open: 0,
        }
    }

    /// Returns true if a transfer of this identifier is open.
    pub fn is_open(&self, header: Header) -> bool {
        let id = header.encode();
        self.by_source[header.source.index()].iter().any(|transfer| transfer.id == id)
    }

    /// Returns the sources of open transfers, one bit each.
    pub fn open_sources(&self) -> u128 {
        if self.open == 0 {
            return 0;
        }
        let open = self.by_source.iter().enumerate().filter(|(_, transfers)| !transfers.is_empty());
        open.fold(0, |sources, (source, _)| sources | 1 << source)
    }

    /// Starts a transfer from a first frame; drops the oldest one of the source if there are too
    /// many.
    pub fn start(
        &mut self,
        now: Instant,
        header: Header,
        frame: &Frame,
        length: u32,
        data: &[u8],
        block_size: u8,
    ) -> Started {
        let buffer = vec![0; MAX_MESSAGE.min(length as usize)];
        let reassembly = match Reassembly::start(now, length, data, frame.len(), block_size, buffer)
        {
            Ok(reassembly) => reassembly,
            Err(fault) => return Started::Fault(fault),
        };
        let id = header.encode();
        let source = header.source.index();
        let transfers = &mut self.by_source[source];
        // A device sends one response at a time, and two devices respond to the same request.
        let message_type = data.first().copied();
        let before = transfers.len();
        transfers.retain(|open| open.id != id || open.message_type == message_type);
        self.open -= before - transfers.len();
        let mut count = 0;
        for open in transfers.iter_mut().filter(|transfer| transfer.id == id) {
            open.is_superseded = true;
            count += 1;
        }
        self.pairs[source] =
            (count > 0).then_some(TransferPair { id, last: None, has_equal: false });
        let is_full = count == MAX_PER_ID;
        let replaced = transfers.iter().position(|open| open.id == id).filter(|_| is_full);
        let oldest = (transfers.len() == MAX_PER_SOURCE).then_some(0);
        if let Some(at) = replaced.or(oldest) {
            transfers.remove(at);
            self.open -= 1;
        }
        transfers.push(RxTransfer {
            id,
            first: *frame,
            message_type,
            reassembly,
            last_at: now,
            is_empty: true,
            permitted: 0,
            is_superseded: false,
            flow_control: FlowControlState::Sent,
            step: None,
        });
        self.open += 1;
        Started::Open
    }

    /// Plans flow control for the transfer of `header` that began last: after `wait`, in which
    /// another device may respond too.
    pub fn plan_flow_control(&mut self, now: Instant, header: Header, wait: Duration) {
        let id = header.encode();
        let transfers = &mut self.by_source[header.source.index()];
        let Some(newest) = transfers.iter().rposition(|open| open.id == id) else { return };
        let (others, rest) = transfers.split_at_mut(newest);
        let [newest, ..] = rest else { return };
        let Some(other) = others.iter_mut().rfind(|open| open.id == id) else {
            newest.flow_control = FlowControlState::DueAt(now + wait);
            return;
        };
        let is_equal = newest.message_type == Some(des::TYPE_NAME)
            && other.first.same_on_wire(&newest.first)
            && other.is_empty;
        newest.flow_control = match other.flow_control {
            FlowControlState::DueAt(_) if is_equal => {
                for open in [&mut *other, &mut *newest] {
                    open.step = Some(wait);
                    open.reassembly.set_block_size(1);
                }
                other.flow_control = FlowControlState::Sent;
                FlowControlState::DueAt(now + wait)
            }
            FlowControlState::DueAt(_) | FlowControlState::Refused => FlowControlState::Refused,
            FlowControlState::Sent | FlowControlState::AfterOther => FlowControlState::AfterOther,
        };
    }

    /// Returns flow control to send now, if any.
    pub fn poll_flow_control(&mut self, now: Instant) -> Option<DueFlowControl> {
        if self.open == 0 {
            return None;
        }
        for transfers in &mut self.by_source {
            let Some(at) = (0..transfers.len())
                .find(|at| flow_control_at(transfers, *at).is_some_and(|due| due <= now))
            else {
                continue;
            };
            let RxTransfer { id, first, flow_control, step, .. } = transfers[at];
            let in_steps = step.is_some();
            if flow_control != FlowControlState::Refused {
                transfers[at].flow_control = FlowControlState::Sent;
                return Some(DueFlowControl { status: FlowStatus::Continue, first, in_steps });
            }
            transfers.retain(|open| open.id != id);
            self.open = self.by_source.iter().map(Vec::len).sum();
            return Some(DueFlowControl { status: FlowStatus::Overflow, first, in_steps });
        }
        None
    }

    /// Notes a consecutive frame, and returns what it shows after two first frames; each result once
    /// for each pair of transfers.
    pub fn note_interleaved(
        &mut self,
        now: Instant,
        header: Header,
        frame: &Frame,
    ) -> Option<Interleaving> {
        let (id, source) = (header.encode(), header.source.index());
        let is_open = self.is_open(header);
        let pair = self.pairs[source].as_mut().filter(|pair| pair.id == id)?;
        let (at, before) = pair.last.replace((now, *frame))?;
        let is_same_number = before.data().first() == frame.data().first();
        if !is_same_number || (!is_open && now.since(at) >= INTERLEAVED_REST) {
            return None;
        }
        if before.same_on_wire(frame) {
            let is_first = !std::mem::replace(&mut pair.has_equal, true);
            return is_first.then_some(Interleaving::Equal);
        }
        self.pairs[source] = None;
        Some(Interleaving::Differs)
    }

    /// Notes flow control for the responses of its destination to its source: the requester permits
    /// consecutive frames, all with a block size of 0, or none at all.
    pub fn note_flow_control(&mut self, header: Header, flow: FlowControl) {
        let transfers = &mut self.by_source[header.destination.index()];
        let is_for = |open: &RxTransfer| Header::decode(open.id).destination == header.source;
        match flow.status {
            FlowStatus::Continue => {
                let permitted =
                    if flow.block_size == 0 { u32::MAX } else { u32::from(flow.block_size) };
                for open in transfers.iter_mut().filter(|open| is_for(open)) {
                    open.permitted = permitted;
                }
            }
            FlowStatus::Wait => {}
            FlowStatus::Overflow => {
                let before = transfers.len();
                transfers.retain(|open| !is_for(open) || open.permitted > 0);
                self.open -= before - transfers.len();
            }
        }
    }

    /// Adds a consecutive frame to its transfer.
    pub fn push_consecutive(
        &mut self,
        now: Instant,
        header: Header,
        sequence: u8,
        data: &[u8],
    ) -> Continued {
        let id = header.encode();
        let transfers = &mut self.by_source[header.source.index()];
        let open = transfers.iter().enumerate().filter(|(_, transfer)| transfer.id == id);
        let next = open.min_by_key(|(_, transfer)| {
            (transfer.reassembly.next_sequence() != sequence, transfer.last_at)
        });
        let Some(at) = next.map(|(at, _)| at) else { return Continued::Unknown };
        transfers[at].last_at = now;
        transfers[at].is_empty = false;
        // Its flow control may have been lost.
        let permitted = &mut transfers[at].permitted;
        *permitted = permitted.checked_sub(1).unwrap_or(u32::MAX);
        match transfers[at].reassembly.push(now, sequence, data) {
            Ok(ReassemblyProgress::More) => Continued::More,
            Ok(ReassemblyProgress::BlockEnd) => match transfers[at].step {
                None => Continued::BlockEnd,
                Some(step) => {
                    plan_next_step(now, transfers, at, step);
                    Continued::More
                }
            },
            Ok(ReassemblyProgress::Done) => {
                let done = transfers.remove(at);
                // The other one began with the same frame: one device began its response anew, or
                // another one waits for flow control.
                transfers.retain_mut(|open| {
                    let is_equal =
                        open.id == id && open.is_empty && open.first.same_on_wire(&done.first);
                    open.is_superseded |= is_equal;
                    !is_equal || open.permitted == 0
                });
                self.open = self.by_source.iter().map(Vec::len).sum();
                Continued::Done(done.reassembly.into_buffer())
            }
            Err(fault) => {
                self.open -= 1;
                let RxTransfer { first, is_superseded, .. } = transfers.remove(at);
                if is_superseded { Continued::Unknown } else { Continued::Fault(fault, first) }
            }
        }
    }

    /// Aborts an unfinished transfer before a new first frame with its identifier, if its last frame
    /// is old. Two devices send theirs together.
    pub fn end_unfinished(&mut self, now: Instant, header: Header) -> Option<Stopped> {
        let id = header.encode();
        let transfers = &mut self.by_source[header.source.index()];
        let at = transfers
            .iter()
            .position(|open| open.id == id && now.since(open.last_at) >= INTERLEAVED_REST)?;
        self.open -= 1;
        let stopped = transfers.remove(at);
        (!stopped.is_superseded).then(|| Stopped::from(stopped))
    }

    /// Aborts one transfer whose next frame is overdue (N_Cr), if any.
    pub fn expire(&mut self, now: Instant) -> Option<Stopped> {
        if self.open == 0 {
            return None;
        }
        for transfers in &mut self.by_source {
            while let Some(at) = transfers.iter().position(|open| open.reassembly.deadline() <= now)
            {
                self.open -= 1;
                let stopped = transfers.remove(at);
                if !stopped.is_superseded {
                    return Some(Stopped::from(stopped));
                }
            }
        }
        None
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        if self.open == 0 {
            return None;
        }
        let deadlines = self.by_source.iter().flatten().map(|open| open.reassembly.deadline());
        let flow_control = self.by_source.iter().flat_map(|transfers| {
            (0..transfers.len()).filter_map(|at| flow_control_at(transfers, at))
        });
        deadlines.chain(flow_control).min()
    }

    pub fn clear(&mut self) {
        self.by_source.iter_mut().for_each(Vec::clear);
        self.pairs.fill_with(|| None);
        self.open = 0;
    }
}

/// Returns when flow control for the transfer at this place is due, if it is not sent.
fn flow_control_at(transfers: &[RxTransfer], at: usize) -> Option<Instant> {
    let RxTransfer { id, flow_control, .. } = transfers[at];
    match flow_control {
        FlowControlState::Sent => None,
        FlowControlState::DueAt(due) => Some(due),
        FlowControlState::Refused => Some(Instant::ZERO),
        FlowControlState::AfterOther => {
            let other = transfers[..at].iter().rfind(|open| open.id == id);
            Some(other.map_or(Instant::ZERO, |other| other.last_at + INTERLEAVED_REST))
        }
    }
}

/// Plans flow control after a frame of the transfer at this place, one of two with the same response
/// so far: none if the other one goes on in another way.
fn plan_next_step(now: Instant, transfers: &mut [RxTransfer], at: usize, step: Duration) {
    let RxTransfer { id, ref reassembly, .. } = transfers[at];
    let length = reassembly.message().len();
    let differs = |open: &RxTransfer| {
        let other = open.reassembly.message();
        open.id == id && other.len() >= length && other[..length] != *reassembly.message()
    };
    let differs = transfers.iter().any(differs);
    let is_planned =
        transfers.iter().any(|open| open.id == id && open.flow_control != FlowControlState::Sent);
    if differs {
        transfers[at].flow_control = FlowControlState::Refused;
    } else if !is_planned {
        transfers[at].flow_control = FlowControlState::DueAt(now + step);
    }
}
