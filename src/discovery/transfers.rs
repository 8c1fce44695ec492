//! Multi-frame responses: one ISO-TP reassembly per identifier, bounded per source.

use crate::frame::Frame;
use crate::time::{Duration, Instant};
use crate::wire::des::MAX_MESSAGE;
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{Reassembly, ReassemblyProgress, TransferFault};

/// Maximum number of open transfers of one source: one for each of four requesters.
const MAX_PER_SOURCE: usize = 4;
/// Longest time from the end of a transfer to the rest of another one that was sent between its
/// frames: a few frames on a busy bus. At 125 kbit/s a frame takes 1.2 ms.
const INTERLEAVED_REST: Duration = Duration::from_millis(100);

/// Transfer that is being received.
#[derive(Debug)]
struct RxTransfer {
    id: u32,
    first: Frame,
    reassembly: Reassembly<Vec<u8>>,
    /// Sequence number of the last consecutive frame.
    last_sequence: Option<u8>,
    /// True if it began while another one of its identifier was open.
    is_second: bool,
}

/// The last transfer of a source that ended and was the second one of its identifier.
#[derive(Debug)]
struct EndedTransfer {
    id: u32,
    at: Instant,
    last_sequence: u8,
}

/// Result of a first frame.
#[derive(Debug)]
pub(super) enum Started {
    /// A transfer is open; an earlier one of the identifier is dropped.
    Open,
    /// Refused.
    Fault(TransferFault),
}

/// Result of a consecutive frame.
#[derive(Debug)]
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

/// A transfer that was aborted by its timeout.
#[derive(Debug)]
pub(super) struct Expired {
    pub header: Header,
    pub fault: TransferFault,
    /// First frame of the transfer.
    pub first: Frame,
}

/// Open transfers of one bus.
#[derive(Debug)]
pub(super) struct Transfers {
    by_source: Vec<Vec<RxTransfer>>,
    ended: Vec<Option<EndedTransfer>>,
    open: usize,
}

impl Transfers {
    pub fn new() -> Self {
        Self {
            by_source: (0..Address::COUNT).map(|_| Vec::new()).collect(),
            ended: (0..Address::COUNT).map(|_| None).collect(),
            open: 0,
        }
    }

    /// Returns true if a transfer of this identifier is open.
    pub fn is_open(&self, header: Header) -> bool {
        let id = header.encode();
        self.by_source[header.source.index()].iter().any(|transfer| transfer.id == id)
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
        let transfers = &mut self.by_source[header.source.index()];
        if let Some(open) = transfers.iter_mut().find(|transfer| transfer.id == id) {
            let first = *frame;
            *open = RxTransfer { id, first, reassembly, last_sequence: None, is_second: true };
            return Started::Open;
        }
        if transfers.len() == MAX_PER_SOURCE {
            transfers.remove(0);
            self.open -= 1;
        }
        transfers.push(RxTransfer {
            id,
            first: *frame,
            reassembly,
            last_sequence: None,
            is_second: false,
        });
        self.open += 1;
        Started::Open
    }

    /// Returns true if a consecutive frame has the sequence number of the one before it, after two
    /// first frames: two transfers with one identifier are under way.
    pub fn is_interleaved(&self, now: Instant, header: Header, sequence: u8) -> bool {
        let (id, source) = (header.encode(), header.source.index());
        let mut open = self.by_source[source].iter().filter(|transfer| transfer.id == id);
        if let Some(open) = open.next() {
            return open.is_second && open.last_sequence == Some(sequence);
        }
        self.ended[source].as_ref().is_some_and(|ended| {
            ended.id == id
                && ended.last_sequence == sequence
                && now.since(ended.at) < INTERLEAVED_REST
        })
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
        let Some(at) = transfers.iter().position(|transfer| transfer.id == id) else {
            return Continued::Unknown;
        };
        transfers[at].last_sequence = Some(sequence);
        let ended = EndedTransfer { id, at: now, last_sequence: sequence };
        self.ended[header.source.index()] = Some(ended).filter(|_| transfers[at].is_second);
        match transfers[at].reassembly.push(now, sequence, data) {
            Ok(ReassemblyProgress::More) => Continued::More,
            Ok(ReassemblyProgress::BlockEnd) => Continued::BlockEnd,
            Ok(ReassemblyProgress::Done) => {
                self.open -= 1;
                Continued::Done(transfers.swap_remove(at).reassembly.into_buffer())
            }
            Err(fault) => {
                self.open -= 1;
                Continued::Fault(fault, transfers.swap_remove(at).first)
            }
        }
    }

    /// Aborts one transfer whose next frame is overdue (N_Cr), if any.
    pub fn expire(&mut self, now: Instant) -> Option<Expired> {
        if self.open == 0 {
            return None;
        }
        for transfers in &mut self.by_source {
            if let Some(at) = transfers.iter().position(|open| open.reassembly.deadline() <= now) {
                self.open -= 1;
                let RxTransfer { id, first, reassembly, .. } = transfers.swap_remove(at);
                let header = Header::decode(id);
                let fault = TransferFault::TimeoutCr { after: reassembly.message().len() };
                return Some(Expired { header, fault, first });
            }
        }
        None
    }

    pub fn poll_timeout(&self) -> Option<Instant> {
        if self.open == 0 {
            return None;
        }
        self.by_source.iter().flatten().map(|transfer| transfer.reassembly.deadline()).min()
    }

    pub fn clear(&mut self) {
        self.by_source.iter_mut().for_each(Vec::clear);
        self.ended.fill_with(|| None);
        self.open = 0;
    }
}
