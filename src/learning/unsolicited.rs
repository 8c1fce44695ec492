//! Unsolicited frames of each source with each service number: which may be heartbeats.
//!
//! A heartbeat has few contents: those of its modes. A source and service with many is not kept.

use crate::frame::Frame;
use crate::time::Instant;
use crate::wire::id::{Address, Header, Service};
use foldhash::fast::FixedState;
use std::collections::HashMap;

/// Pairs of a source and a service that are kept. A bus of the platform has at most 127 sources, and
/// each of them few services.
const MAX_SENDERS: usize = 1024;
/// Contents of a heartbeat: modes and error codes, of two boards at one address.
const MAX_CONTENTS: usize = 12;
/// Intervals of a sender that are kept, the last ones.
pub(super) const MAX_INTERVALS: usize = 24;
/// Frames from which on a sender with as many contents is none of heartbeats.
const MIN_FRAMES: u32 = 4;

/// All of them.
#[derive(Clone, Debug, Default)]
pub(super) struct UnsolicitedFrames {
    senders: HashMap<(Address, Service), UnsolicitedSender, FixedState>,
    /// First and last response or unsolicited frame of each source.
    sources: HashMap<Address, (Instant, Instant), FixedState>,
    /// There are more pairs than are kept.
    is_full: bool,
}

/// Frames of one source with one service number.
#[derive(Clone, Debug)]
pub(super) struct UnsolicitedSender {
    pub frames: u32,
    /// Frames that repeat the one before, RND7 included: copies of a bridge.
    repeated: u32,
    last: Instant,
    last_id: Option<u32>,
    /// The content of the last frame, by its place.
    last_content: usize,
    /// How often the content was another one than that before.
    changes: u32,
    /// The first frame, and the bytes that differed from it in another one, one bit each.
    first: Frame,
    changed_bytes: u64,
    /// It sent one while it did not work.
    pub has_non_working: bool,
    /// The last intervals, in microseconds.
    pub intervals: Vec<u32>,
    next_interval: usize,
    /// Different contents; empty if there were too many.
    pub contents: Vec<SenderContent>,
    is_variable: bool,
    /// The RND7 of its frames, one bit each.
    rnd7: u128,
}

/// A content of frames of one sender.
#[derive(Clone, Debug)]
pub(super) struct SenderContent {
    /// U: its sender does not work.
    pub is_non_working: bool,
    /// The first frame with it.
    pub frame: Frame,
    pub count: u32,
}

impl SenderContent {
    pub fn data(&self) -> &[u8] {
        self.frame.data()
    }
}

impl UnsolicitedFrames {
    /// Takes a conforming response or unsolicited frame of another node.
    pub fn handle_frame(&mut self, frame: &Frame, header: Header) {
        let seen = self.sources.entry(header.source).or_insert((frame.time, frame.time));
        seen.1 = seen.1.max(frame.time);
        if !header.broadcast {
            return;
        }
        let key = (header.source, header.service);
        if let Some(sender) = self.senders.get_mut(&key) {
            sender.add(frame, header);
        } else if self.senders.len() < MAX_SENDERS {
            self.senders.insert(key, UnsolicitedSender::new(frame, header));
        } else {
            self.is_full = true;
        }
    }

    /// Returns true if it does not know all frames: there are more services and sources than a bus of
    /// the platform has.
    pub fn is_full(&self) -> bool {
        self.is_full
    }

    /// First and last frame of each source.
    pub fn sources(&self) -> impl Iterator<Item = (Address, Instant, Instant)> {
        self.sources.iter().map(|(source, (first, last))| (*source, *first, *last))
    }

    /// Returns true if some node sends frames of this service.
    pub fn has_service(&self, service: Service) -> bool {
        self.senders.keys().any(|(_, known)| *known == service)
    }

    /// The service numbers, in their order.
    pub fn services(&self) -> Vec<Service> {
        let mut services: Vec<Service> = self.senders.keys().map(|(_, service)| *service).collect();
        services.sort_unstable();
        services.dedup();
        services
    }

    /// Returns true if several nodes send frames of a service with six bytes that never change and that
    /// are others in each node, whatever the other bytes are: a UID, and a counter.
    pub fn has_uids(&self, service: Service) -> bool {
        let of = self.senders.iter().filter(|((_, of), _)| *of == service);
        let constant: Vec<&UnsolicitedSender> =
            of.map(|(_, sender)| sender).filter(|sender| sender.steady() != 0).collect();
        let mask = constant.iter().fold(u64::MAX, |mask, sender| mask & sender.steady());
        let bytes = |sender: &UnsolicitedSender| -> Vec<u8> {
            let data = sender.first.data().iter().enumerate();
            data.filter(|(at, _)| mask >> at & 1 == 1).map(|(_, byte)| *byte).collect()
        };
        let mut all: Vec<Vec<u8>> = constant.iter().map(|sender| bytes(sender)).collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        has_run(mask) && count > 1 && all.len() == count
    }

    /// Returns true if a node sent a frame of a service while it did not work.
    pub fn has_non_working(&self, service: Service) -> bool {
        self.senders.iter().any(|((_, of), sender)| *of == service && sender.has_non_working)
    }

    /// The senders of a service that may be those of heartbeats, by address.
    pub fn senders_of(&self, service: Service) -> Vec<(Address, &UnsolicitedSender)> {
        let mut senders: Vec<(Address, &UnsolicitedSender)> = self
            .senders
            .iter()
            .filter(|((_, of), sender)| *of == service && sender.may_be_heartbeats())
            .map(|((source, _), sender)| (*source, sender))
            .collect();
        senders.sort_unstable_by_key(|(source, _)| *source);
        senders
    }
}

impl UnsolicitedSender {
    fn new(frame: &Frame, header: Header) -> Self {
        let mut sender = Self {
            frames: 0,
            repeated: 0,
            last: frame.time,
            last_id: frame.platform_id(),
            last_content: 0,
            changes: 0,
            first: *frame,
            changed_bytes: 0,
            has_non_working: false,
            intervals: Vec::new(),
            next_interval: 0,
            contents: Vec::new(),
            is_variable: false,
            rnd7: 0,
        };
        sender.count(frame, header);
        sender
    }

    fn add(&mut self, frame: &Frame, header: Header) {
        let data = frame.data();
        let is_copy = self.last_id == frame.platform_id()
            && self.contents.get(self.last_content).is_some_and(|it| it.data() == data);
        if is_copy {
            self.repeated = self.repeated.saturating_add(1);
            return;
        }
        self.last_id = frame.platform_id();
        for (at, byte) in self.first.data().iter().enumerate() {
            self.changed_bytes |= u64::from(data.get(at) != Some(byte)) << at;
        }
        let micros = frame.time.since(self.last).as_micros();
        self.last = self.last.max(frame.time);
        if self.is_variable {
            return;
        }
        let micros = u32::try_from(micros).unwrap_or(u32::MAX);
        match self.intervals.get_mut(self.next_interval) {
            Some(oldest) => *oldest = micros,
            None => self.intervals.push(micros),
        }
        self.next_interval = (self.next_interval + 1) % MAX_INTERVALS;
        self.count(frame, header);
    }

    fn count(&mut self, frame: &Frame, header: Header) {
        self.frames = self.frames.saturating_add(1);
        self.rnd7 |= 1 << header.destination.index();
        let is_non_working = header.from_non_working;
        self.has_non_working |= is_non_working;
        let is_same = |it: &SenderContent| {
            it.is_non_working == is_non_working && it.frame.data() == frame.data()
        };
        let known = self.contents.iter().position(is_same);
        let place = known.unwrap_or(self.contents.len());
        self.changes = self.changes.saturating_add(u32::from(place != self.last_content));
        self.last_content = place;
        if let Some(content) = self.contents.get_mut(place) {
            content.count = content.count.saturating_add(1);
        } else if self.contents.len() < MAX_CONTENTS {
            self.contents.push(SenderContent { is_non_working, frame: *frame, count: 1 });
        } else {
            self.is_variable = true;
            self.contents = Vec::new();
            self.intervals = Vec::new();
        }
    }

    /// Returns true if its contents are few enough for heartbeats.
    fn may_be_heartbeats(&self) -> bool {
        let contents = self.contents.len() as u32;
        let most = if self.frames < MIN_FRAMES { 2 } else { self.frames.div_ceil(2) };
        !self.is_variable && contents <= most
    }

    /// Frames, copies included.
    pub fn received(&self) -> u32 {
        self.frames.saturating_add(self.repeated)
    }

    /// Returns true if contents alternate, as those of two boards at one address.
    pub fn alternates(&self) -> bool {
        self.changes * 3 > self.frames
    }

    /// Bytes that never changed, one bit each; 0 if there are not six in a row.
    fn steady(&self) -> u64 {
        let length = self.first.data().len();
        let all = if length >= 64 { u64::MAX } else { (1 << length) - 1 };
        let steady = all & !self.changed_bytes;
        if has_run(steady) { steady } else { 0 }
    }

    /// Returns true if its RND7 changes, as those of the platform do.
    pub fn has_random_rnd7(&self) -> bool {
        self.rnd7.count_ones() > 1
    }
}

/// Returns true if six bits in a row are set.
fn has_run(mask: u64) -> bool {
    mask & mask >> 1 & mask >> 2 & mask >> 3 & mask >> 4 & mask >> 5 != 0
}
