//! Bit rate search: listens at one rate after the other until a valid frame arrives, as a device
//! does at start (CAN platform §3.2.4.1).
//!
//! State machine without I/O or clock. Input: frames and error frames. Output: the rate to set.

use crate::error_report::ErrorReport;
use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant, debug_assert_later};

/// The bit rates of the CAN platform, in bit/s, in the order of the search.
pub const RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];

/// Bus errors without a valid frame after which the next rate is tried early. At the right rate, a
/// sender without ACK causes 16 bus errors before it is error-passive.
const MAX_BUS_ERRORS: u64 = 64;

/// A bit rate in bit/s as text: `125 kbit/s`.
pub fn kbit(rate: u32) -> String {
    format!("{} kbit/s", f64::from(rate) / 1000.0)
}

/// Says that a bus, whose name is printable, has not the bit rate that its project gives; both in bit/s.
pub fn unexpected_rate(bus: &str, rate: u32, expected: u32) -> String {
    format!("{bus} has {}; the project says {}.", kbit(rate), kbit(expected))
}

/// Bit rates of classic frames, in bit/s.
pub const CLASSIC_RATES: std::ops::RangeInclusive<u32> = 10_000..=1_000_000;

/// Reads a bit rate, in bit/s: `125000`, or short as the screen shows it, `125k`, `1M`; `None` if
/// the text is none.
pub fn parse(text: &str) -> Option<u32> {
    let (number, factor) = match text.strip_suffix(['k', 'K']) {
        Some(number) => (number, 1_000),
        None => text.strip_suffix('M').map_or((text, 1), |number| (number, 1_000_000)),
    };
    number.parse::<u32>().ok()?.checked_mul(factor)
}

/// Whether the controller is listen-only during the search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListenMode {
    /// Listen-only: no ACK and no error flags are sent, so a wrong rate disturbs nothing. Frames of
    /// a device that is alone on the bus are not valid, because they get no ACK.
    ListenOnly,
    /// Active: frames are acknowledged; at a wrong rate, frames of other nodes are destroyed.
    Active,
}

/// What was received at one rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RateResult {
    /// Valid frames.
    pub frames: u64,
    /// Bus errors.
    pub bus_errors: u64,
}

/// Progress of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchProgress {
    /// This rate, in bit/s, is tried now.
    Trying(u32),
    /// The result of a rate without a valid frame.
    NothingValid(u32, RateResult),
    /// The controller does not support this rate.
    Skipped(u32),
}

/// Outcome of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchOutcome {
    /// A valid frame arrived at this rate, in bit/s.
    Found(u32),
    /// Bus errors at some rates, a valid frame at none.
    OnlyBusErrors,
    /// Neither frames nor bus errors at any rate.
    NoTraffic,
}

/// A search. Set [`rate`](Self::rate), call [`begin`](Self::begin), pass frames and
/// [`handle_timeout`](Self::handle_timeout), until [`wants_rate`](Self::wants_rate) is true again
/// or there is an [`outcome`](Self::outcome).
#[derive(Clone, Debug)]
pub struct Search {
    tried: Vec<(u32, RateResult)>,
    left: Vec<u32>,
    wait: Duration,
    until: Option<Instant>,
    outcome: Option<SearchOutcome>,
}

impl Search {
    /// Starts at `first`, in bit/s, and continues upwards and around. Each rate gets one and a half
    /// `period`, the heartbeat period BUS_CFG_HR_TIME.
    pub fn new(first: u32, period: Duration) -> Self {
        let next = RATES.iter().position(|rate| *rate > first).unwrap_or(0);
        let cycle = RATES.iter().cycle().skip(next).take(RATES.len());
        let mut left: Vec<u32> = cycle.copied().filter(|rate| *rate != first).collect();
        left.reverse();
        Self {
            tried: vec![(first, RateResult::default())],
            left,
            wait: period.mul_f64(1.5),
            until: None,
            outcome: None,
        }
    }

    /// The rate to set or in use, in bit/s.
    pub fn rate(&self) -> u32 {
        self.tried.last().map_or(RATES[0], |(rate, _)| *rate)
    }

    /// The rates tried so far and their results; the present one last.
    pub fn tried(&self) -> &[(u32, RateResult)] {
        &self.tried
    }

    /// The outcome; `None` while the search runs.
    pub fn outcome(&self) -> Option<SearchOutcome> {
        self.outcome
    }

    /// Notes that the rate is set: frames count from now on.
    pub fn begin(&mut self, now: Instant) {
        self.until = Some(now + self.wait);
    }

    /// Skips the rate, because the controller does not support it.
    pub fn skip(&mut self) {
        self.next_rate();
    }

    /// Handles a frame or an error frame.
    pub fn handle_frame(&mut self, frame: &Frame) {
        let rate = self.rate();
        let (Some(_), Some((_, result))) = (self.until, self.tried.last_mut()) else { return };
        if frame.kind == FrameKind::Error {
            result.bus_errors +=
                u64::from(ErrorReport::of(frame).is_some_and(|it| it.is_bus_error()));
            if result.frames == 0 && result.bus_errors >= MAX_BUS_ERRORS {
                self.next_rate();
            }
        } else if !frame.is_tx {
            result.frames += 1;
            self.until = None;
            self.outcome = Some(SearchOutcome::Found(rate));
        }
    }

    /// Ends the rate if its time is over.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.until.is_some_and(|until| now >= until) {
            self.next_rate();
        }
        debug_assert_later(self.poll_timeout(), now);
    }

    /// When to call [`handle_timeout`](Self::handle_timeout); `None` while a rate is to be set, and
    /// at the end.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.until
    }

    /// Returns true if a rate is to be set.
    pub fn wants_rate(&self) -> bool {
        self.until.is_none() && self.outcome.is_none()
    }

    fn next_rate(&mut self) {
        self.until = None;
        if let Some(rate) = self.left.pop() {
            self.tried.push((rate, RateResult::default()));
            return;
        }
        let broken = self.tried.iter().any(|(_, result)| result.bus_errors > 0);
        self.outcome =
            Some(if broken { SearchOutcome::OnlyBusErrors } else { SearchOutcome::NoTraffic });
    }
}
