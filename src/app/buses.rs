//! One bus as the program sees it: its engine, what its adapter says of it, and how busy it is.
//!
//! Does not know how frames come in; the adapter's words arrive as a [`BusStatus`].

use crate::discovery::{Config, Engine};
use crate::error_report::ErrorReport;
use crate::frame::bits::FrameBits;
use crate::frame::{Frame, FrameKind};
use crate::status::{BusState, BusStatus, Link};
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// A bus.
#[derive(Debug)]
pub struct Bus {
    /// Its name: `can0`.
    pub name: String,
    /// Finds its devices.
    pub engine: Engine,
    /// What its adapter says.
    pub status: BusStatus,
    /// How busy it is.
    pub meter: LoadMeter,
    /// When its log ended. What was there then is there for good: no time passes any more.
    pub ended: Option<Instant>,
    /// Since when its transmit queue is full.
    full_since: Option<Instant>,
    /// Until when its frames are not judged, because they may have waited for us.
    rests_until: Option<Instant>,
}

impl Bus {
    /// The name without the bit rates that it is opened at, which say nothing of which bus it is:
    /// `slcan:/dev/ttyACM0` of `slcan:/dev/ttyACM0@500000`.
    pub fn name_without_rates(&self) -> &str {
        let is_rates = |text: &str| text.chars().all(|c| c.is_ascii_digit() || c == '/');
        let parts = self.name.rsplit_once('@').filter(|_| self.name.starts_with("slcan:"));
        parts.filter(|(_, rates)| is_rates(rates)).map_or(&self.name, |(name, _)| name)
    }

    /// A bus that starts now.
    pub fn new(now: Instant, name: String, config: Config) -> Self {
        let status = BusStatus { bitrate: config.bitrate, ..BusStatus::default() };
        let (engine, meter) = (Engine::new(now, config), LoadMeter::new(now));
        Self { name, engine, status, meter, ended: None, full_since: None, rests_until: None }
    }

    /// Nothing was taken from it since `since`; what comes until `until` may have waited, and
    /// its time may be that at which it was taken.
    pub(super) fn begin_quarantine(&mut self, since: Instant, until: Instant) {
        self.engine.suspend(since);
        self.rests_until = Some(until);
    }

    /// Takes note of whether the transmit queue is full.
    pub(super) fn note_queue(&mut self, now: Instant) {
        if self.status.is_transmit_queue_full {
            self.full_since.get_or_insert(now);
        } else if self.full_since.take().is_some_and(|since| now.since(since) >= QUEUE_STALE_AFTER)
        {
            self.engine.handle_delayed_requests(now);
        }
    }

    /// Whether its engine waits until the adapter says that it is back.
    pub(super) fn waits_for_adapter(&self) -> bool {
        self.rests_until.is_none() && self.engine.is_suspended()
    }

    /// It went down: that lasts longer.
    pub(super) fn goes_down(&mut self, now: Instant) {
        self.engine.suspend(now);
        self.rests_until = None;
    }

    /// Whether what is heard at that moment is not judged; ends the rest that is over then.
    pub(super) fn in_quarantine(&mut self, now: Instant) -> bool {
        let Some(until) = self.rests_until else { return false };
        if now < until {
            return true;
        }
        self.rests_until = None;
        self.engine.restart(until);
        false
    }

    /// The bit rate to reckon with.
    pub fn bits_per_second(&self) -> u32 {
        self.status.bitrate.unwrap_or_else(|| self.engine.config().bits_per_second())
    }

    /// When its engine is to be called at the latest.
    pub(super) fn poll_timeout(&self) -> Option<Instant> {
        self.rests_until.or_else(|| self.engine.poll_timeout()).filter(|_| self.ended.is_none())
    }

    /// Whether there is no way to the bus at all, so that nothing can be sent.
    pub(super) fn is_unreachable(&self) -> bool {
        !matches!(self.status.link, Link::Opening | Link::Up)
            || matches!(self.status.state, BusState::BusOff | BusState::Stopped)
    }

    /// Whether frames can come in and go out.
    pub fn is_up(&self) -> bool {
        is_up(&self.status)
    }

    /// Whether nothing can be seen of it, and that is not because its log is over.
    pub fn is_blind(&self) -> bool {
        !self.is_up() && self.ended.is_none() && self.status.link != Link::Opening
    }

    /// Whether many frames broke in the last seconds and none arrived whole: most likely the bit
    /// rate is another one. What nobody acknowledges did not break.
    pub fn hears_only_errors(&self) -> bool {
        let recent = || self.meter.seconds().rev().take(3);
        self.is_up()
            && recent().all(|second| second.frames == second.errors)
            && recent().map(|second| second.broken).sum::<u32>() >= ONLY_ERRORS
    }

    /// What keeps our frames from the bus, as far as is known.
    pub fn tx_blocked(&self) -> Option<TxBlocked> {
        if !self.is_up() {
            None
        } else if self.status.is_transmit_queue_full {
            Some(TxBlocked::QueueFull)
        } else {
            self.engine.is_unacknowledged().then_some(TxBlocked::Unacknowledged)
        }
    }

    /// Frames that were lost on the way to us.
    pub fn lost(&self) -> u64 {
        lost(&self.status)
    }
}

/// What keeps our frames from a bus that is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TxBlocked {
    /// What was sent before them does not go out either.
    QueueFull,
    /// None of them came out, or nobody acknowledged them.
    Unacknowledged,
}

/// A queue that was full for so long holds questions that are overdue.
const QUEUE_STALE_AFTER: Duration = Duration::from_millis(1500);
/// Broken frames in three seconds that are no accident.
const ONLY_ERRORS: u32 = 64;

/// Frames and bus time in each of the last seconds.
#[derive(Debug)]
pub struct LoadMeter {
    second: u64,
    current: LoadSecond,
    past: VecDeque<LoadSecond>,
    started: Instant,
    bits: u64,
}

/// What passed in one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadSecond {
    /// Frames.
    pub frames: u32,
    /// Error frames among them.
    pub errors: u32,
    /// Frames that broke on the wire, as error frames say.
    pub broken: u32,
    /// Bit times at the nominal rate that the bus was taken.
    pub bits: u64,
}

impl LoadMeter {
    /// How many seconds are kept.
    pub const SECONDS: usize = 30;

    fn new(now: Instant) -> Self {
        let second = now.as_micros() / 1_000_000;
        let past = VecDeque::with_capacity(Self::SECONDS);
        Self { second, current: LoadSecond::default(), past, started: now, bits: 0 }
    }

    /// Counts a frame.
    pub fn add(&mut self, frame: &Frame, bitrate: u32, data_bitrate: Option<u32>) {
        self.current.frames += 1;
        let bits = if frame.kind == FrameKind::Error {
            let is_broken = ErrorReport::of(frame).is_some_and(|report| report.is_broken_frame());
            self.current.errors += 1;
            self.current.broken += u32::from(is_broken);
            if is_broken { BROKEN_FRAME_BITS } else { 0 }
        } else {
            bit_times(frame, bitrate, data_bitrate)
        };
        self.current.bits += bits;
        self.bits += bits;
    }

    /// Closes the seconds that are over; whether there were any.
    pub fn advance(&mut self, now: Instant) -> bool {
        let second = now.as_micros() / 1_000_000;
        if second <= self.second {
            return false;
        }
        let over = (second - self.second).min(Self::SECONDS as u64 + 1);
        self.second = second;
        for _ in 0..over {
            if self.past.len() == Self::SECONDS {
                self.past.pop_front();
            }
            self.past.push_back(std::mem::take(&mut self.current));
        }
        true
    }

    /// The share of the bus that was taken since the start, 0–1.
    pub fn mean_load(&self, now: Instant, bitrate: u32) -> f64 {
        let whole = now.since(self.started).as_secs_f64() * f64::from(bitrate.max(1));
        if whole > 0.0 { (self.bits as f64 / whole).min(1.0) } else { 0.0 }
    }

    /// The last whole second.
    pub fn last(&self) -> LoadSecond {
        self.past.back().copied().unwrap_or_default()
    }

    /// The last seconds, oldest first.
    pub fn seconds(&self) -> impl DoubleEndedIterator<Item = &LoadSecond> + ExactSizeIterator {
        self.past.iter()
    }

    /// Whether nothing passed for as long as is shown.
    pub fn is_idle(&self) -> bool {
        self.current.frames == 0 && self.past.iter().all(|second| second.frames == 0)
    }
}

impl LoadSecond {
    /// The share of the bus that was taken, 0–1.
    pub fn load(self, bitrate: u32) -> f64 {
        (self.bits as f64 / f64::from(bitrate.max(1))).min(1.0)
    }
}

/// Whether a bus in this state lets frames come in and go out.
pub(super) fn is_up(status: &BusStatus) -> bool {
    let off = matches!(status.state, BusState::BusOff | BusState::Stopped | BusState::Down);
    status.link == Link::Up && !off
}

/// Frames that were lost on the way to us.
pub(super) fn lost(status: &BusStatus) -> u64 {
    status.kernel_drops + status.queue_drops + status.controller_overruns
}

/// The least that a broken frame takes of the bus, in bits: the error flag, its delimiter, the
/// intermission. How much of the frame went before it, no report says.
const BROKEN_FRAME_BITS: u64 = 6 + 8 + 3;

/// How many bit times at the nominal rate a whole frame takes of the bus.
fn bit_times(frame: &Frame, bitrate: u32, data_bitrate: Option<u32>) -> u64 {
    let bits = FrameBits::of(frame);
    let (data, bitrate) = (u64::from(bits.data), u64::from(bitrate.max(1)));
    let data_bitrate = data_bitrate.map_or(bitrate, u64::from).max(1);
    u64::from(bits.nominal) + data * bitrate / data_bitrate
}
