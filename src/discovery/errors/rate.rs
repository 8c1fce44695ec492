//! How often frames break on the bus, and how: the finding about the bus as a whole.
//!
//! * *Suspected*: three broken frames (or missing acknowledges) within ten seconds. One or two
//!   are counted, and nothing is said: a plug that is touched does as much.
//! * *Confirmed*: some in each of three successive seconds; or in three of ten seconds, and then
//!   at least 1 % of the frames: however busy or quiet the bus is, that is no chance. Bus-off is
//!   a fact, and confirmed at once.
//!   Bursts that follow one address do not count: those are another finding.
//! * *Cleared*: none for ten seconds, thirty where it was confirmed. Bus-off: once the
//!   controller takes part again.

use crate::error_report::{ErrorReport, Violation};
use crate::finding::Confidence;
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// How long errors are remembered, in seconds.
const MEMORY: u64 = 10;
/// Errors within the memory that are a suspicion.
const SUSPECT: u64 = 3;
/// Seconds with errors that confirm it: in a row, or within the memory.
const CONFIRM_SECONDS: usize = 3;
/// One frame in so many, where the seconds are not in a row.
const CONFIRM_SHARE: u64 = 100;
/// How long no errors end what was suspected, and what was confirmed.
const QUIET: Duration = Duration::from_secs(10);
const QUIET_CONFIRMED: Duration = Duration::from_secs(30);

/// What the errors are, as far as the reports say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::discovery) enum Cause {
    /// Our controller has left the bus.
    BusOff,
    /// Nobody acknowledges our frames.
    NoAcknowledge,
    /// The transceiver says that the wires are at fault.
    Wires,
    /// Bits of our own frames are overwritten.
    OwnFrames,
    /// Frames break, most of them in this way.
    Broken(Option<Violation>),
}

/// What there is to say of the errors of the last ten seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::discovery) struct BusErrorSummary {
    /// What most of them are.
    pub cause: Cause,
    /// Errors per second, while they come.
    pub rate: f64,
    /// Their share of all frames while they come, 0–1.
    pub share: f64,
}

/// A second in which there were errors.
#[derive(Clone, Copy, Debug, Default)]
struct ErrorSecond {
    /// Which, since the beginning of time.
    number: u64,
    broken: u64,
    no_acknowledge: u64,
    /// Of the broken ones, ours.
    sending: u64,
    /// Of the broken ones, by [`Violation`].
    violations: [u64; 3],
}

#[derive(Debug, Default)]
pub(super) struct ErrorRate {
    seconds: VecDeque<ErrorSecond>,
    /// When a second began, and how many frames had been heard by then: as far back as errors
    /// are remembered.
    heard: VecDeque<(Instant, u64)>,
    /// When the next second begins.
    next_second: Instant,
    /// What was told last, while it is not cleared.
    told: Option<Confidence>,
    last: Instant,
    /// Since when our controller is off the bus: frames heard until then.
    bus_off: Option<u64>,
    wires: bool,
    /// What was told is over before it was quiet for long.
    over: bool,
}

impl ErrorRate {
    /// Takes note that `frames` were heard before now. Called with every frame. Whether it is the
    /// first that is heard since the controller left the bus.
    pub fn note_frame(&mut self, now: Instant, frames: u64) -> bool {
        if now >= self.next_second {
            self.next_second = Instant::from_micros((second_of(now) + 1) * 1_000_000);
            if self.heard.len() as u64 == MEMORY {
                self.heard.pop_front();
            }
            self.heard.push_back((now, frames));
        }
        let is_back = self.bus_off == Some(frames);
        if is_back {
            // Nothing is heard off the bus: only from now on it can be quiet.
            self.last = now;
        }
        is_back
    }

    /// Takes a report in; `broken` frames broke, of `frames` heard in all, errors included.
    /// Whether it is an error at all.
    pub fn see(&mut self, now: Instant, report: &ErrorReport, broken: u64, frames: u64) -> bool {
        self.forget(now);
        if report.is_recovery() {
            // Where there was nothing else, it is over.
            self.over = self.bus_off.take().is_some() && self.count() < SUSPECT;
        }
        let no_acknowledge = u64::from(report.is_missing_acknowledge());
        let off = report.is_bus_off();
        if broken + no_acknowledge == 0 && !off && !report.is_transceiver_fault() {
            return false;
        }
        self.last = now;
        self.over = false;
        self.wires = report.is_transceiver_fault() || self.wires && self.told.is_some();
        if off {
            self.bus_off = Some(frames);
        }
        if broken + no_acknowledge == 0 {
            return true;
        }
        let second = self.second(now);
        second.broken += broken;
        second.no_acknowledge += no_acknowledge;
        second.sending += if report.is_while_sending() { broken } else { 0 };
        if let Some(violation) = report.violation() {
            second.violations[violation as usize] += broken;
        }
        true
    }

    /// How sure it is now that something is wrong, where that is anything.
    pub fn confidence(&mut self, frames: u64) -> Option<Confidence> {
        let now = if self.bus_off.is_some() || self.is_lasting(frames) {
            Some(Confidence::Confirmed)
        } else if self.wires || self.count() >= SUSPECT {
            Some(Confidence::Suspected)
        } else {
            None
        };
        // What is told stays until it is quiet.
        self.told = self.told.max(now);
        self.told
    }

    /// The errors in numbers.
    pub fn summary(&self, now: Instant, frames: u64) -> BusErrorSummary {
        let sum = |of: fn(&ErrorSecond) -> u64| self.seconds.iter().map(of).sum::<u64>();
        let (broken, no_acknowledge) = (sum(|s| s.broken), sum(|s| s.no_acknowledge));
        let violations = [Violation::Bit, Violation::Stuff, Violation::Form];
        let most = violations.into_iter().max_by_key(|violation| {
            self.seconds.iter().map(|s| s.violations[*violation as usize]).sum::<u64>()
        });
        let known = sum(|s| s.violations.iter().sum()) > 0;
        let cause = if self.bus_off.is_some() {
            Cause::BusOff
        } else if self.wires {
            Cause::Wires
        } else if no_acknowledge > broken {
            Cause::NoAcknowledge
        } else if sum(|s| s.sending) * 2 > broken {
            Cause::OwnFrames
        } else {
            Cause::Broken(most.filter(|_| known))
        };
        let errors = self.count() as f64;
        let since = self.heard.front().map_or(now, |(since, _)| *since);
        let seconds = now.since(since).as_secs_f64().clamp(1.0, MEMORY as f64);
        let frames = self.frames(frames).max(1) as f64;
        BusErrorSummary { cause, rate: errors / seconds, share: (errors / frames).min(1.0) }
    }

    /// Of the errors between two moments `count` have another cause than the bus.
    pub fn exclude(&mut self, from: Instant, to: Instant, mut count: u64) {
        let (from, to) = (second_of(from), second_of(to));
        for second in &mut self.seconds {
            if (from..=to).contains(&second.number) {
                let explained = second.broken.min(count);
                second.broken -= explained;
                count -= explained;
            }
        }
        self.seconds.retain(|second| second.broken + second.no_acknowledge > 0);
    }

    /// When [`handle_timeout`](Self::handle_timeout) is to be called; `frames` were heard in all.
    pub fn poll_timeout(&self, frames: u64) -> Option<Instant> {
        let told = self.told?;
        if self.over {
            return Some(self.last);
        }
        if self.bus_off.is_some_and(|heard| heard >= frames) {
            return None;
        }
        let quiet = match told {
            Confidence::Confirmed => QUIET_CONFIRMED,
            Confidence::Suspected | Confidence::Cleared => QUIET,
        };
        Some(self.last + quiet)
    }

    /// Whether it was quiet long enough.
    pub fn handle_timeout(&mut self, now: Instant, frames: u64) -> bool {
        if self.poll_timeout(frames).is_none_or(|due| now < due) {
            return false;
        }
        self.told = None;
        self.wires = false;
        self.bus_off = None;
        self.over = false;
        true
    }

    /// The controller begins anew.
    pub fn restart(&mut self) {
        self.bus_off = None;
    }

    /// Forgets the errors that are past.
    fn forget(&mut self, now: Instant) {
        let number = second_of(now);
        while self.seconds.front().is_some_and(|second| second.number + MEMORY <= number) {
            self.seconds.pop_front();
        }
    }

    fn second(&mut self, now: Instant) -> &mut ErrorSecond {
        let number = second_of(now);
        if self.seconds.back().is_none_or(|last| last.number != number) {
            self.seconds.push_back(ErrorSecond { number, ..ErrorSecond::default() });
        }
        let last = self.seconds.len() - 1;
        &mut self.seconds[last]
    }

    fn count(&self) -> u64 {
        self.seconds.iter().map(|second| second.broken + second.no_acknowledge).sum()
    }

    /// Of all frames heard, those of the last ten seconds.
    fn frames(&self, frames: u64) -> u64 {
        frames - self.heard.front().map_or(0, |(_, before)| *before)
    }

    fn is_lasting(&self, frames: u64) -> bool {
        let count = self.seconds.len();
        if count < CONFIRM_SECONDS {
            return false;
        }
        let (last, third) = (self.seconds[count - 1], self.seconds[count - CONFIRM_SECONDS]);
        let in_a_row = last.number - third.number < CONFIRM_SECONDS as u64;
        in_a_row || self.count() * CONFIRM_SHARE >= self.frames(frames)
    }
}

fn second_of(now: Instant) -> u64 {
    now.as_micros() / 1_000_000
}
