//! The bit rate of a bus, found as a device finds it when it is switched on (section 3.2.4.1):
//! listen at one rate after the other until a frame arrives whole.
//!
//! Sets nothing and reads no clock: says which rate is to be tried now, and takes what was heard
//! there.

use crate::error_report::ErrorReport;
use crate::frame::{Frame, FrameKind};
use crate::time::{Duration, Instant};

/// The rates of the platform's buses, in bit/s, in the order of the cycle.
pub const RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];

/// Broken frames, without a whole one, that mean another rate before the time is over. A sender
/// that nobody acknowledges breaks its first sixteen itself, at the right rate too.
const MAX_BUS_ERRORS: u64 = 64;

/// A bit rate as it is written for people.
pub fn kbit(rate: u32) -> String {
    format!("{} kbit/s", f64::from(rate) / 1000.0)
}

/// Whether we take part in the bus while we try.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListenMode {
    /// Nothing is sent, not even acknowledges: no harm is done at a wrong rate, and a device that
    /// is alone may not be heard, for nobody acknowledges its frames.
    Listening,
    /// We acknowledge what we hear, and at a wrong rate destroy the frames of others.
    TakingPart,
}

/// What was heard at one rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RateResult {
    /// Frames that arrived whole.
    pub frames: u64,
    /// Frames that broke.
    pub broken: u64,
}

/// What is going on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchProgress {
    /// At this rate, in bit/s, we listen now.
    Trying(u32),
    /// This was heard there, and no frame that arrived whole.
    Heard(u32, RateResult),
    /// The controller cannot have this rate.
    Skipped(u32),
}

/// How it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchOutcome {
    /// A frame arrived whole at this rate, in bit/s.
    Found(u32),
    /// At some rates frames broke, at none did one arrive whole.
    OnlyBroken,
    /// Nothing at all was heard.
    Silence,
}

/// The search. First what [`rate`](Self::rate) says is to be set; then [`begin`](Self::begin),
/// frames and [`handle_timeout`](Self::handle_timeout), until another rate is to be tried or there
/// is an [`outcome`](Self::outcome).
#[derive(Clone, Debug)]
pub struct Search {
    tried: Vec<(u32, RateResult)>,
    left: Vec<u32>,
    wait: Duration,
    until: Option<Instant>,
    outcome: Option<SearchOutcome>,
}

impl Search {
    /// Begins at `first`, goes on upwards and around; `period` is the buses' BUS_CFG_HR_TIME, of
    /// which each rate gets one and a half.
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

    /// The rate to be set now, in bit/s.
    pub fn rate(&self) -> u32 {
        self.tried.last().map_or(RATES[0], |(rate, _)| *rate)
    }

    /// The rates that were tried, and what was heard at each; the present one last.
    pub fn tried(&self) -> &[(u32, RateResult)] {
        &self.tried
    }

    /// How it ended, once it has.
    pub fn outcome(&self) -> Option<SearchOutcome> {
        self.outcome
    }

    /// The rate is set: what is heard from now on counts.
    pub fn begin(&mut self, now: Instant) {
        self.until = Some(now + self.wait);
    }

    /// The rate could not be set on this controller: the next one.
    pub fn skip(&mut self) {
        self.go_on();
    }

    /// Takes a frame or an error frame.
    pub fn handle_frame(&mut self, frame: &Frame) {
        let rate = self.rate();
        let (Some(_), Some((_, heard))) = (self.until, self.tried.last_mut()) else { return };
        if frame.kind == FrameKind::Error {
            heard.broken +=
                u64::from(ErrorReport::of(frame).is_some_and(|it| it.is_broken_frame()));
            if heard.frames == 0 && heard.broken >= MAX_BUS_ERRORS {
                self.go_on();
            }
        } else if !frame.is_tx {
            heard.frames += 1;
            self.until = None;
            self.outcome = Some(SearchOutcome::Found(rate));
        }
    }

    /// Time passes.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.until.is_some_and(|until| now >= until) {
            self.go_on();
        }
    }

    /// When to be told of the time at the latest; none while a rate is to be set, and at the end.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.until
    }

    /// Whether a rate is to be set.
    pub fn wants_rate(&self) -> bool {
        self.until.is_none() && self.outcome.is_none()
    }

    fn go_on(&mut self) {
        self.until = None;
        if let Some(rate) = self.left.pop() {
            self.tried.push((rate, RateResult::default()));
            return;
        }
        let broken = self.tried.iter().any(|(_, heard)| heard.broken > 0);
        self.outcome =
            Some(if broken { SearchOutcome::OnlyBroken } else { SearchOutcome::Silence });
    }
}
