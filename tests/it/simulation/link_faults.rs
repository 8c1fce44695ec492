//! Link faults between the bus and an inspector: a bridge that duplicates all frames, a gateway that
//! duplicates those of one device, loopback, lost frames, and a clock that jumps.

use descan::frame::Frame;
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header};
use std::collections::VecDeque;

#[derive(Clone, Debug, Default)]
pub struct Lens {
    /// Start, end, and the delay of each duplicate frame.
    pub doubled: Option<(Duration, Duration, Duration)>,
    pub gateway: Option<Gateway>,
    /// The inspector's own frames come back as if another node had sent them.
    pub echo: bool,
    pub deaf: Option<Deafness>,
    pub jump: Option<Jump>,
}

/// Duplicates the frames of one address.
#[derive(Clone, Copy, Debug)]
pub struct Gateway {
    pub address: Address,
    pub from: Duration,
    pub until: Duration,
    pub delay: Duration,
}

/// Frames lost on the link.
#[derive(Clone, Copy, Debug)]
pub struct Deafness {
    pub from: Duration,
    pub until: Duration,
    /// True if the number of lost frames is reported to the inspector.
    pub told: bool,
}

/// The inspector's clock is set ahead, or the machine slept: all deadlines pass at once.
#[derive(Clone, Copy, Debug)]
pub struct Jump {
    pub at: Duration,
    pub by: Duration,
}

impl Lens {
    /// Returns how far the inspector's clock is ahead at `now`.
    pub fn ahead(&self, now: Instant) -> Duration {
        self.jump.filter(|jump| now >= Instant::ZERO + jump.at).map_or(Duration::ZERO, |it| it.by)
    }

    pub fn is_clear(&self) -> bool {
        self.doubled.is_none()
            && self.gateway.is_none()
            && !self.echo
            && self.deaf.is_none()
            && self.jump.is_none()
    }
}

/// Frames in transit over a faulty link.
#[derive(Debug, Default)]
pub struct Seen {
    later: VecDeque<Frame>,
    pub lost: u64,
}

impl Seen {
    /// Returns the arrival time of the next delayed frame.
    pub fn next(&self) -> Option<Instant> {
        self.later.front().map(|frame| frame.time)
    }

    /// Returns a frame that is due.
    pub fn due(&mut self, now: Instant) -> Option<Frame> {
        self.later.pop_front_if(|frame| frame.time <= now)
    }

    /// Takes a frame from the bus; returns what arrives at once.
    pub fn look(&mut self, lens: &Lens, frame: Frame) -> [Option<Frame>; 2] {
        let at = frame.time.since(Instant::ZERO);
        if lens.deaf.is_some_and(|deaf| (deaf.from..deaf.until).contains(&at)) && !frame.is_tx {
            self.lost += 1;
            return [None, None];
        }
        let mut strange = frame;
        strange.is_tx = false;
        let is_error = frame.kind == descan::frame::FrameKind::Error;
        if let Some((from, until, delay)) = lens.doubled
            && (from..until).contains(&at)
            && !is_error
        {
            self.later.push_back(strange.with_time(frame.time + delay));
        }
        if let Some(gateway) = lens.gateway
            && (gateway.from..gateway.until).contains(&at)
            && frame.platform_id().map(|id| Header::decode(id).source) == Some(gateway.address)
        {
            self.later.push_back(strange.with_time(frame.time + gateway.delay));
            self.later.make_contiguous().sort_by_key(|frame| frame.time);
        }
        [Some(frame), (lens.echo && frame.is_tx).then_some(strange)]
    }
}
