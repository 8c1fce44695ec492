//! Enumeration rounds: when one starts and when it is over (protocol §4.1).
//!
//! Rounds repeat at start until two in a row find nothing new, each waiting until the services of
//! the devices found are known; then at a slow period. Does not send anything itself.

use super::config::Config;
use crate::time::{Duration, Instant};

/// Successive rounds without anything new that end the phase at start. Protocol §4.1.
const QUIET_ROUNDS: u32 = 2;
/// Bits of a typical frame, for windows that grow on slower buses. A frame of 8 bytes with a 29-bit
/// identifier has 131 bits without stuff bits (ISO 11898-1).
pub(super) const FRAME_BITS: u64 = 150;
/// Longest time that a round's requests delay other requests. As the time without acknowledgement
/// after which sending is paused.
const ROUND_PRIORITY_WINDOW: Duration = Duration::from_millis(500);
/// Longest time that a round waits until its requests are on the bus. Chosen: longer than 1,000
/// frames take at 125 kbit/s.
const SEND_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest collection time, besides the time the responses take on the bus: responses to other
/// nodes must not keep a round open for ever. Chosen; tested with devices that respond late.
const MAX_COLLECTION: Duration = Duration::from_secs(2);
/// Longest time without a response that a round at start waits for services. Chosen, as
/// `MAX_COLLECTION`.
const SERVICES_WAIT_LIMIT: Duration = Duration::from_secs(2);

/// Phase of the rounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RoundPhase {
    /// No own address yet.
    NotYet,
    /// Responses are collected.
    Collecting { began: Instant, last_response: Instant, responses: u32, known: u64 },
    /// The next round is due at `at` if no query is open then, else once none is, but not after
    /// `latest`, nor before `at`.
    Waiting { at: Instant, latest: Instant },
    /// No further rounds.
    Never,
}

/// State of the enumeration rounds.
#[derive(Clone, Debug)]
pub(super) struct Rounds {
    phase: RoundPhase,
    quiet: u32,
    pub finished: u32,
    /// Requests of this round that are not confirmed yet.
    unsent: u32,
    /// True if another round was requested while this one runs.
    another_requested: bool,
}

/// Action for the caller of [`Rounds::step`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RoundStep {
    None,
    /// Send the requests of a round.
    Send,
    /// The round that began at `began` is over.
    Over {
        began: Instant,
    },
}

impl Rounds {
    pub fn new() -> Self {
        Self {
            phase: RoundPhase::NotYet,
            quiet: 0,
            finished: 0,
            unsent: 0,
            another_requested: false,
        }
    }

    /// Returns true until the rounds at start are over.
    pub fn is_starting(&self) -> bool {
        self.quiet < QUIET_ROUNDS
    }

    pub fn is_collecting(&self) -> bool {
        matches!(self.phase, RoundPhase::Collecting { .. })
    }

    /// Starts a round as soon as possible, and repeats as at start.
    pub fn restart(&mut self, now: Instant) {
        self.quiet = 0;
        self.unsent = 0;
        self.phase = RoundPhase::Waiting { at: now, latest: now };
    }

    /// Requests one round; while one is running, another after it.
    pub fn request_round(&mut self, at: Instant) {
        match &mut self.phase {
            RoundPhase::Waiting { at: due, .. } => *due = (*due).min(at),
            RoundPhase::Never => self.phase = RoundPhase::Waiting { at, latest: at },
            RoundPhase::Collecting { .. } => self.another_requested = true,
            RoundPhase::NotYet => {}
        }
    }

    /// Stops until the next [`restart`](Self::restart).
    pub fn stop(&mut self) {
        self.phase = RoundPhase::NotYet;
        self.quiet = 0;
    }

    /// Sets the number of requests of this round that await confirmation.
    pub fn note_requests(&mut self, count: u32) {
        self.unsent = count;
    }

    /// Notes that one of them is on the bus: responses to it may arrive from now on.
    pub fn note_sent(&mut self, now: Instant) {
        self.unsent = self.unsent.saturating_sub(1);
        if let RoundPhase::Collecting { last_response, .. } = &mut self.phase {
            *last_response = now;
        }
    }

    /// Notes a request of the inspector that recorded the log: responses are collected from now on.
    pub fn note_recorded(&mut self, now: Instant) {
        if let RoundPhase::Collecting { last_response, .. } = &mut self.phase {
            *last_response = now;
            return;
        }
        self.phase =
            RoundPhase::Collecting { began: now, last_response: now, responses: 0, known: 0 };
    }

    /// Ends a recorded round that is over; returns when it began.
    pub fn end_recorded(&mut self, now: Instant, config: &Config) -> Option<Instant> {
        let RoundPhase::Collecting { began, last_response, responses, .. } = self.phase else {
            return None;
        };
        if now < self.end_of_round(config, began, last_response, responses) {
            return None;
        }
        self.finished += 1;
        self.phase = RoundPhase::NotYet;
        Some(began)
    }

    /// Returns the time until which other requests are held back, because they may win arbitration
    /// against the requests of this round; `None` if they need not wait.
    pub fn priority_until(&self, now: Instant) -> Option<Instant> {
        match self.phase {
            RoundPhase::Collecting { began, .. } if self.unsent > 0 => {
                Some(began + ROUND_PRIORITY_WINDOW).filter(|until| now < *until)
            }
            _ => None,
        }
    }

    /// Notes a response, which extends the collection, or the time that a round waits for services.
    /// `is_repeated`: its address is queried again and again because of a conflict; the round does
    /// not wait for that.
    pub fn note_response(&mut self, now: Instant, is_repeated: bool) {
        match &mut self.phase {
            RoundPhase::Collecting { last_response, responses, .. } => {
                *last_response = now;
                *responses += 1;
            }
            // Services are still arriving.
            RoundPhase::Waiting { at, latest } if *latest > *at && !is_repeated => {
                *latest = now + SERVICES_WAIT_LIMIT;
            }
            _ => {}
        }
    }

    /// Returns the time without responses after which a round is over.
    fn quiet_window(config: &Config, responses: u32) -> Duration {
        let frames = 60 + u64::from(responses.min(127));
        Duration::from_millis(60) + config.duration_of_bits(frames * FRAME_BITS)
    }

    /// Returns when the current round is over if no more responses arrive.
    fn end_of_round(
        &self,
        config: &Config,
        began: Instant,
        last_response: Instant,
        responses: u32,
    ) -> Instant {
        let quiet = last_response + Self::quiet_window(config, responses);
        if self.unsent > 0 {
            return quiet.max(began + SEND_TIMEOUT);
        }
        let longest = SEND_TIMEOUT + MAX_COLLECTION + config.duration_of_bits(4 * 127 * FRAME_BITS);
        quiet.min(began + longest)
    }

    /// Advances the rounds. `open`: queries without a response; `known`: number of rows and names
    /// found so far.
    pub fn step(&mut self, now: Instant, config: &Config, open: usize, known: u64) -> RoundStep {
        match self.phase {
            RoundPhase::Collecting { began, last_response, responses, known: before } => {
                if now < self.end_of_round(config, began, last_response, responses) {
                    return RoundStep::None;
                }
                self.finished += 1;
                self.quiet = if known > before { 0 } else { self.quiet + 1 };
                self.phase = if self.is_starting() {
                    RoundPhase::Waiting { at: now, latest: now + SERVICES_WAIT_LIMIT }
                } else if std::mem::take(&mut self.another_requested) {
                    RoundPhase::Waiting { at: now, latest: now }
                } else if config.round_period.is_zero() {
                    RoundPhase::Never
                } else {
                    RoundPhase::Waiting { at: now + config.round_period, latest: now }
                };
                RoundStep::Over { began }
            }
            RoundPhase::Waiting { at, latest } if now >= at && (open == 0 || now >= latest) => {
                self.another_requested = false;
                self.phase =
                    RoundPhase::Collecting { began: now, last_response: now, responses: 0, known };
                RoundStep::Send
            }
            _ => RoundStep::None,
        }
    }

    /// Postpones the round that [`step`](Self::step) started until `at`.
    pub fn postpone(&mut self, at: Instant) {
        self.phase = RoundPhase::Waiting { at, latest: at };
    }

    pub fn poll_timeout(&self, config: &Config, open: usize) -> Option<Instant> {
        match self.phase {
            RoundPhase::NotYet | RoundPhase::Never => None,
            RoundPhase::Collecting { began, last_response, responses, .. } => {
                Some(self.end_of_round(config, began, last_response, responses))
            }
            RoundPhase::Waiting { at, latest } if open > 0 => Some(at.max(latest)),
            RoundPhase::Waiting { at, .. } => Some(at),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::ZERO + Duration::from_millis(millis)
    }

    fn collecting() -> Rounds {
        let mut rounds = Rounds::new();
        rounds.restart(at(0));
        assert_eq!(rounds.step(at(0), &Config::default(), 0, 0), RoundStep::Send);
        rounds
    }

    #[test]
    fn round_with_endless_responses_ends() {
        let mut rounds = collecting();
        let over = (1..100).find(|tenth| {
            rounds.note_response(at(tenth * 100), false);
            rounds.step(at(tenth * 100), &Config::default(), 0, 0) != RoundStep::None
        });
        assert!(over.is_some_and(|tenth| tenth < 60), "{over:?}");
    }

    #[test]
    fn round_with_unsent_requests_stays_open() {
        let mut rounds = collecting();
        rounds.note_requests(1);
        assert_eq!(rounds.step(at(900), &Config::default(), 0, 0), RoundStep::None);
        rounds.note_sent(at(1000));
        assert_eq!(rounds.step(at(1020), &Config::default(), 0, 0), RoundStep::None);
        assert!(matches!(rounds.step(at(1200), &Config::default(), 0, 0), RoundStep::Over { .. }));
    }

    #[test]
    fn responses_of_devices_in_conflict_do_not_delay_rounds() {
        let config = Config::default();
        for is_repeated in [false, true] {
            let mut rounds = collecting();
            assert!(matches!(rounds.step(at(1000), &config, 1, 0), RoundStep::Over { .. }));
            let sent = (11..60).find(|tenth| {
                rounds.note_response(at(tenth * 100), is_repeated);
                rounds.step(at(tenth * 100), &config, 1, 0) == RoundStep::Send
            });
            assert_eq!(sent, is_repeated.then_some(30), "in conflict: {is_repeated}");
        }
    }

    #[test]
    fn round_requested_during_another_follows_it() {
        let config = Config { round_period: Duration::ZERO, ..Config::default() };
        let mut rounds = collecting();
        rounds.quiet = QUIET_ROUNDS;
        rounds.request_round(at(50));
        assert!(matches!(rounds.step(at(1000), &config, 0, 0), RoundStep::Over { .. }));
        assert_eq!(rounds.step(at(1000), &config, 0, 0), RoundStep::Send);
    }
}
