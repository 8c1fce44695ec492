//! Rate and kind of bus errors: the finding about the bus as a whole.
//!
//! * *Suspected*: three failed frames (or missing acknowledgements) within ten seconds. One or two
//!   are counted only: touching a plug causes as many.
//! * *Confirmed*: errors in each of three successive seconds; or in three of ten seconds, and then
//!   in at least 1 % of the frames, which is not chance on a busy or a quiet bus. Bus-off is a
//!   fact, and confirmed at once. Bursts that follow one address do not count: they are another
//!   finding.
//! * *Cleared*: no errors for ten seconds, thirty if it was confirmed. Bus-off: once the controller
//!   is on the bus again.

use crate::error_report::{BusErrorType, ErrorReport};
use crate::finding::FindingState;
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Time in which errors count, in seconds. Chosen.
const MEMORY_SECONDS: u64 = 10;
/// Errors within that time from which the finding is suspected. Chosen: plugging in a device may
/// cause one or two.
const SUSPECT_FROM_ERRORS: u64 = 3;
/// Seconds with errors that confirm it: in a row, or within that time. Chosen: plugging in a device
/// takes less.
const CONFIRM_SECONDS: usize = 3;
/// One error in this many frames confirms it if the seconds are not in a row. Chosen: with sound
/// wiring errors are orders of magnitude rarer.
const CONFIRM_SHARE: u64 = 100;
/// Time without errors after which the finding is cleared, if it was suspected and if it was
/// confirmed. As `MEMORY_SECONDS`; three times that once confirmed, so that it does not come and
/// go.
const CLEAR_AFTER: Duration = Duration::from_secs(10);
const CLEAR_CONFIRMED_AFTER: Duration = Duration::from_secs(30);

/// Cause of the errors, as far as the reports show it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::discovery) enum Cause {
    /// The controller is bus-off.
    BusOff,
    /// The controller was bus-off, and has been on the bus since.
    WasBusOff,
    /// descan's frames are not acknowledged.
    NoAck,
    /// The transceiver reports a wiring fault.
    Wires,
    /// Errors occur in descan's own frames.
    OwnFrames,
    /// Bus errors, most of them of this kind; `None` if the kind is unknown.
    BusError(Option<BusErrorType>),
}

/// Summary of the errors of the last ten seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::discovery) struct BusErrorSummary {
    /// Most frequent cause.
    pub cause: Cause,
    /// Errors per second.
    pub rate: f64,
    /// Share of all frames, 0 to 1.
    pub share: f64,
}

/// Errors of one second.
#[derive(Clone, Copy, Debug, Default)]
struct ErrorSecond {
    /// Number of the second since [`Instant::ZERO`].
    number: u64,
    bus_errors: u64,
    no_acknowledge: u64,
    /// Of the failed frames, those sent by descan.
    sending: u64,
    /// Failed frames by [`BusErrorType`].
    violations: [u64; 3],
}

/// Errors of the last seconds on one bus.
#[derive(Clone, Debug, Default)]
pub(super) struct ErrorRate {
    seconds: VecDeque<ErrorSecond>,
    /// Begin of each second and the number of frames received by then, for as long as errors count.
    frames_at: VecDeque<(Instant, u64)>,
    /// Begin of the next second.
    next_second: Instant,
    /// State reported last; `None` if cleared.
    reported: Option<FindingState>,
    last: Instant,
    /// Number of frames received when the controller became bus-off; `None` while it is on the bus.
    bus_off: Option<u64>,
    wires: bool,
    /// True if the finding is over without waiting.
    over: bool,
}

impl ErrorRate {
    /// Notes that `frames` were received before now; called for every frame. Returns true if this
    /// is the first frame since the controller became bus-off.
    pub fn note_frame(&mut self, now: Instant, frames: u64) -> bool {
        if now >= self.next_second {
            self.next_second =
                Instant::from_micros(second_of(now) * 1_000_000) + Duration::from_secs(1);
            if self.frames_at.len() as u64 == MEMORY_SECONDS {
                self.frames_at.pop_front();
            }
            self.frames_at.push_back((now, frames));
        }
        let is_back = self.bus_off == Some(frames);
        if is_back {
            // A bus-off controller receives nothing: time without errors starts now.
            self.last = now;
        }
        is_back
    }

    /// Notes an error report with `broken` failed frames, of `frames` received in all, errors
    /// included. Returns true if it is an error.
    pub fn note_report(
        &mut self,
        now: Instant,
        report: &ErrorReport,
        broken: u64,
        frames: u64,
    ) -> bool {
        self.forget(now);
        if report.is_recovery() {
            // Without other errors, the finding is over.
            self.over = self.bus_off.take().is_some() && self.count() < SUSPECT_FROM_ERRORS;
        }
        let no_acknowledge = u64::from(report.is_no_ack());
        let off = report.is_bus_off();
        if !off && !report.is_from_bus() && self.bus_off == Some(frames.saturating_sub(1)) {
            // It does not say that the controller is on the bus again.
            self.bus_off = Some(frames);
        }
        if broken + no_acknowledge == 0 && !off && !report.is_transceiver_fault() {
            return false;
        }
        self.last = now;
        self.over = false;
        self.wires = report.is_transceiver_fault() || self.wires && self.reported.is_some();
        if off {
            self.bus_off = Some(frames);
        }
        if broken + no_acknowledge == 0 {
            return true;
        }
        let second = self.second(now);
        second.bus_errors += broken;
        second.no_acknowledge += no_acknowledge;
        second.sending += if report.is_while_sending() { broken } else { 0 };
        if let Some(violation) = report.bus_error_type() {
            second.violations[violation as usize] += broken;
        }
        true
    }

    /// Returns the state of the finding; `None` if there is none.
    pub fn finding_state(&mut self, frames: u64) -> Option<FindingState> {
        let now = if self.bus_off.is_some() || self.is_lasting(frames) {
            Some(FindingState::Confirmed)
        } else if self.wires || self.count() >= SUSPECT_FROM_ERRORS {
            Some(FindingState::Suspected)
        } else {
            None
        };
        // The state does not decrease until the errors stop.
        self.reported = self.reported.max(now);
        self.reported
    }

    /// Returns the summary of the errors.
    pub fn summary(&self, now: Instant, frames: u64) -> BusErrorSummary {
        let sum = |of: fn(&ErrorSecond) -> u64| self.seconds.iter().map(of).sum::<u64>();
        let (broken, no_acknowledge) = (sum(|s| s.bus_errors), sum(|s| s.no_acknowledge));
        let violations = [BusErrorType::Bit, BusErrorType::Stuff, BusErrorType::Form];
        let most = violations.into_iter().max_by_key(|violation| {
            self.seconds.iter().map(|s| s.violations[*violation as usize]).sum::<u64>()
        });
        let known = sum(|s| s.violations.iter().sum()) > 0;
        let cause = if let Some(frames_at) = self.bus_off {
            if frames_at >= frames { Cause::BusOff } else { Cause::WasBusOff }
        } else if self.wires {
            Cause::Wires
        } else if no_acknowledge > broken {
            Cause::NoAck
        } else if sum(|s| s.sending) * 2 > broken {
            Cause::OwnFrames
        } else {
            Cause::BusError(most.filter(|_| known))
        };
        let errors = self.count() as f64;
        let since = self.frames_at.front().map_or(now, |(since, _)| *since);
        let seconds = now.since(since).as_secs_f64().clamp(1.0, MEMORY_SECONDS as f64);
        let frames = self.frames(frames).max(1) as f64;
        BusErrorSummary { cause, rate: errors / seconds, share: (errors / frames).min(1.0) }
    }

    /// Removes `count` errors between two times, which have another cause than the bus.
    pub fn exclude(&mut self, from: Instant, to: Instant, mut count: u64) {
        let (from, to) = (second_of(from), second_of(to));
        for second in &mut self.seconds {
            if (from..=to).contains(&second.number) {
                let explained = second.bus_errors.min(count);
                second.bus_errors -= explained;
                count -= explained;
            }
        }
        self.seconds.retain(|second| second.bus_errors + second.no_acknowledge > 0);
    }

    /// Returns when [`handle_timeout`](Self::handle_timeout) is due; `frames` were received in all.
    pub fn poll_timeout(&self, frames: u64) -> Option<Instant> {
        let reported = self.reported?;
        if self.over {
            return Some(self.last);
        }
        if self.bus_off.is_some_and(|frames_at| frames_at >= frames) {
            return None;
        }
        let quiet = match reported {
            FindingState::Confirmed => CLEAR_CONFIRMED_AFTER,
            FindingState::Suspected | FindingState::Cleared => CLEAR_AFTER,
        };
        Some(self.last + quiet)
    }

    /// Returns true if the errors have stopped for long enough, and clears the state.
    pub fn handle_timeout(&mut self, now: Instant, frames: u64) -> bool {
        if self.poll_timeout(frames).is_none_or(|due| now < due) {
            return false;
        }
        self.reported = None;
        self.wires = false;
        self.bus_off = None;
        self.over = false;
        true
    }

    /// Handles a restart of the controller.
    pub fn restart(&mut self) {
        self.bus_off = None;
    }

    /// Drops errors that no longer count.
    fn forget(&mut self, now: Instant) {
        let number = second_of(now);
        while self.seconds.front().is_some_and(|second| second.number + MEMORY_SECONDS <= number) {
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

    /// Returns the number of errors that count.
    fn count(&self) -> u64 {
        self.seconds.iter().map(|second| second.bus_errors + second.no_acknowledge).sum()
    }

    /// Returns how many of all frames were received in the last ten seconds.
    fn frames(&self, frames: u64) -> u64 {
        frames - self.frames_at.front().map_or(0, |(_, before)| *before)
    }

    /// Returns true if the errors last long enough to be confirmed.
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

/// Returns the number of the second since [`Instant::ZERO`].
fn second_of(now: Instant) -> u64 {
    now.as_micros() / 1_000_000
}
