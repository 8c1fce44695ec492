//! Bus time by sender and by service, in the last whole ten seconds.
//!
//! Input: the frames of one bus with their length in bits. Output: sums that change every ten
//! seconds; in the first ten, every second. Counting a frame allocates nothing. Does not know the
//! bit rate and names.

use crate::frame::{CanId, Frame, FrameKind};
use crate::wire::id::{Address, Header, MessageType, Service};

/// Number of service numbers.
const SERVICES: usize = 1024;

/// Bus time in some seconds by sender and by service, in nominal bit times.
#[derive(Clone, Debug)]
pub struct ShareCounts {
    /// Length in seconds; 0 before the first second is over.
    pub seconds: u64,
    /// Bus time of all frames.
    pub bits: u64,
    /// Bus time of frames that report a bus error.
    pub errors: u64,
    /// Bus time of frames that are not of the CAN platform: 11-bit identifiers, remote frames.
    pub non_platform: u64,
    /// Bus time of the frames that descan sent.
    pub own: u64,
    senders: Box<[u32; Address::COUNT]>,
    services: Box<[u32; SERVICES]>,
}

impl ShareCounts {
    fn new() -> Self {
        Self {
            seconds: 0,
            bits: 0,
            errors: 0,
            non_platform: 0,
            own: 0,
            senders: Box::new([0; Address::COUNT]),
            services: Box::new([0; SERVICES]),
        }
    }

    /// Sets all counts to 0.
    fn clear(&mut self) {
        self.senders.fill(0);
        self.services.fill(0);
        (self.seconds, self.bits, self.errors, self.non_platform, self.own) = (0, 0, 0, 0, 0);
    }

    /// Takes the counts of another one, without an allocation.
    fn copy_from(&mut self, other: &Self) {
        *self.senders = *other.senders;
        *self.services = *other.services;
        (self.seconds, self.bits, self.errors) = (other.seconds, other.bits, other.errors);
        (self.non_platform, self.own) = (other.non_platform, other.own);
    }

    fn add(&mut self, frame: &Frame, bits: u64) {
        self.bits += bits;
        if frame.is_tx {
            self.own += bits;
        }
        let bits_of_frame = u32::try_from(bits).unwrap_or(u32::MAX);
        match (frame.kind, frame.id) {
            (FrameKind::Error, _) => self.errors += bits,
            (FrameKind::Data, CanId::Extended(id)) => {
                let header = Header::decode(id);
                let sender = &mut self.senders[header.source.index()];
                *sender = sender.saturating_add(bits_of_frame);
                // In a debug message the number is that of the message.
                if header.message_type() != MessageType::Debug {
                    let service = &mut self.services[usize::from(header.service.number())];
                    *service = service.saturating_add(bits_of_frame);
                }
            }
            _ => self.non_platform += bits,
        }
    }

    /// Bus time of each address that sent something.
    pub fn senders(&self) -> impl Iterator<Item = (Address, u64)> {
        Address::all()
            .zip(self.senders.iter())
            .map(|(address, bits)| (address, u64::from(*bits)))
            .filter(|(_, bits)| *bits > 0)
    }

    /// Bus time of each service with a frame; debug messages have none.
    pub fn services(&self) -> impl Iterator<Item = (Service, u64)> {
        let numbers = (0..SERVICES as u16).map(Service::from_bits);
        numbers
            .zip(self.services.iter())
            .map(|(service, bits)| (service, u64::from(*bits)))
            .filter(|(_, bits)| *bits > 0)
    }
}

/// Sums of the running ten seconds, and those of the last whole ones.
#[derive(Clone, Debug)]
pub struct LoadShares {
    /// First second of the running ten.
    start: u64,
    is_first: bool,
    running: ShareCounts,
    whole: ShareCounts,
}

impl LoadShares {
    /// Time of which the sums are shown, in seconds.
    pub const SECONDS: u64 = 10;

    /// Returns sums that start with this second.
    pub(super) fn new(second: u64) -> Self {
        let (running, whole) = (ShareCounts::new(), ShareCounts::new());
        Self { start: second, is_first: true, running, whole }
    }

    /// Counts a frame of so many bits.
    pub(super) fn add(&mut self, frame: &Frame, bits: u64) {
        self.running.add(frame, bits);
    }

    /// Takes that all seconds before `second` are over.
    pub(super) fn advance(&mut self, second: u64) {
        let seconds = second.saturating_sub(self.start);
        if seconds < Self::SECONDS {
            if self.is_first {
                self.running.seconds = seconds;
                self.whole.copy_from(&self.running);
            }
            return;
        }
        self.running.seconds = seconds;
        std::mem::swap(&mut self.running, &mut self.whole);
        self.running.clear();
        (self.start, self.is_first) = (second, false);
        if seconds >= 2 * Self::SECONDS {
            // Nothing was received for long.
            self.whole.clear();
            self.whole.seconds = Self::SECONDS;
        }
    }

    /// The sums of the last whole ten seconds; before, of the first whole seconds.
    pub fn latest(&self) -> &ShareCounts {
        &self.whole
    }

    /// Size in bytes, as of a copy.
    pub(super) fn size() -> usize {
        2 * (size_of::<[u32; Address::COUNT]>() + size_of::<[u32; SERVICES]>())
    }
}
