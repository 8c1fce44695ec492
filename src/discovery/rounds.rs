//! Rounds: when everybody is asked who is there, and when a round is over.
//!
//! Rounds repeat at start until two in a row bring nothing new, each waiting until the services
//! of what was found are known; then at a slow period. Does not send anything itself.

use super::config::Config;
use crate::time::{Duration, Instant};

/// Rounds in a row without news that end the start.
const QUIET_ROUNDS: u32 = 2;
/// Bits of a usual frame, for windows that grow with slower buses.
const FRAME_BITS: u64 = 150;
/// How long a round's questions may hold up others.
const ROUND_PRIORITY_WINDOW: Duration = Duration::from_millis(500);
/// How long a round waits for the bus to take its questions at the most.
const SENT_WITHIN: Duration = Duration::from_secs(2);
/// How long a round goes on while answers come, beside what they take on the bus: others' answers
/// to others must not keep it open for ever.
const LONGEST: Duration = Duration::from_secs(2);
/// How long a repeat round waits for services at the most.
const WAIT_FOR_SERVICES: Duration = Duration::from_secs(2);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RoundPhase {
    /// Until our address is ours.
    NotYet,
    /// Answers come in.
    Collecting { began: Instant, last_response: Instant, responses: u32, known: u64 },
    /// The next round is due at `at`, or, while starting, as soon as no question is open.
    Waiting { at: Instant, patience: Instant },
    /// No further rounds.
    Never,
}

#[derive(Debug)]
pub(super) struct Rounds {
    phase: RoundPhase,
    quiet: u32,
    pub finished: u32,
    /// Questions of this round that the bus has not taken yet.
    unsent: u32,
    /// Somebody waits for a round that begins after this one.
    hurried: bool,
}

/// What is to be done about rounds now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RoundStep {
    None,
    /// Send the questions of a round.
    Ask,
    /// A round that began at this moment is over.
    Over {
        began: Instant,
    },
}

impl Rounds {
    pub fn new() -> Self {
        Self { phase: RoundPhase::NotYet, quiet: 0, finished: 0, unsent: 0, hurried: false }
    }

    /// Whether the rounds at start are not over yet.
    pub fn is_starting(&self) -> bool {
        self.quiet < QUIET_ROUNDS
    }

    pub fn is_collecting(&self) -> bool {
        matches!(self.phase, RoundPhase::Collecting { .. })
    }

    /// Makes a round as soon as possible, and repeats as at start.
    pub fn restart(&mut self, now: Instant) {
        self.quiet = 0;
        self.unsent = 0;
        self.phase = RoundPhase::Waiting { at: now, patience: now };
    }

    /// Makes one round soon: where one is being made, another after it.
    pub fn request_round(&mut self, at: Instant) {
        match &mut self.phase {
            RoundPhase::Waiting { at: due, .. } => *due = (*due).min(at),
            RoundPhase::Never => self.phase = RoundPhase::Waiting { at, patience: at },
            RoundPhase::Collecting { .. } => self.hurried = true,
            RoundPhase::NotYet => {}
        }
    }

    /// Stops until the next [`restart`](Self::restart).
    pub fn stop(&mut self) {
        self.phase = RoundPhase::NotYet;
        self.quiet = 0;
    }

    /// So many questions of this round were handed out.
    pub fn note_requests(&mut self, count: u32) {
        self.unsent = count;
    }

    /// The bus took one of them: from now on it may be answered.
    pub fn note_sent(&mut self, now: Instant) {
        self.unsent = self.unsent.saturating_sub(1);
        if let RoundPhase::Collecting { last_response, .. } = &mut self.phase {
            *last_response = now;
        }
    }

    /// Until when other questions, which may be of higher priority, are to let this round's
    /// pass: the one to nodes that are not working would starve behind those to working ones.
    pub fn priority_until(&self, now: Instant) -> Option<Instant> {
        match self.phase {
            RoundPhase::Collecting { began, .. } if self.unsent > 0 => {
                Some(began + ROUND_PRIORITY_WINDOW).filter(|until| now < *until)
            }
            _ => None,
        }
    }

    pub fn note_response(&mut self, now: Instant) {
        if let RoundPhase::Collecting { last_response, responses, .. } = &mut self.phase {
            *last_response = now;
            *responses += 1;
        }
    }

    /// How long the bus must be quiet of answers until a round is over.
    fn quiet_window(config: &Config, responses: u32) -> Duration {
        let frames = 60 + u64::from(responses.min(127));
        Duration::from_millis(60) + config.bit_time(frames * FRAME_BITS)
    }

    /// When the round that is being made is over if nothing more is heard.
    fn end_of_round(
        &self,
        config: &Config,
        began: Instant,
        last_response: Instant,
        responses: u32,
    ) -> Instant {
        let quiet = last_response + Self::quiet_window(config, responses);
        if self.unsent > 0 {
            return quiet.max(began + SENT_WITHIN);
        }
        let longest = SENT_WITHIN + LONGEST + config.bit_time(4 * 127 * FRAME_BITS);
        quiet.min(began + longest)
    }

    /// `open` questions are waiting for answers; `known` counts what was ever found.
    pub fn step(&mut self, now: Instant, config: &Config, open: usize, known: u64) -> RoundStep {
        match self.phase {
            RoundPhase::Collecting { began, last_response, responses, known: before } => {
                if now < self.end_of_round(config, began, last_response, responses) {
                    return RoundStep::None;
                }
                self.finished += 1;
                self.quiet = if known > before { 0 } else { self.quiet + 1 };
                self.phase = if self.is_starting() {
                    RoundPhase::Waiting { at: now, patience: now + WAIT_FOR_SERVICES }
                } else if std::mem::take(&mut self.hurried) {
                    RoundPhase::Waiting { at: now, patience: now }
                } else if config.round_period.is_zero() {
                    RoundPhase::Never
                } else {
                    RoundPhase::Waiting { at: now + config.round_period, patience: now }
                };
                RoundStep::Over { began }
            }
            RoundPhase::Waiting { at, patience } if now >= at && (open == 0 || now >= patience) => {
                self.hurried = false;
                self.phase =
                    RoundPhase::Collecting { began: now, last_response: now, responses: 0, known };
                RoundStep::Ask
            }
            _ => RoundStep::None,
        }
    }

    /// Puts the round that [`step`](Self::step) wanted off until `at`.
    pub fn postpone(&mut self, at: Instant) {
        self.phase = RoundPhase::Waiting { at, patience: at };
    }

    pub fn poll_timeout(&self, config: &Config, open: usize) -> Option<Instant> {
        match self.phase {
            RoundPhase::NotYet | RoundPhase::Never => None,
            RoundPhase::Collecting { began, last_response, responses, .. } => {
                Some(self.end_of_round(config, began, last_response, responses))
            }
            RoundPhase::Waiting { at, patience } if open > 0 => Some(at.max(patience)),
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

    fn begun() -> Rounds {
        let mut rounds = Rounds::new();
        rounds.restart(at(0));
        assert_eq!(rounds.step(at(0), &Config::default(), 0, 0), RoundStep::Ask);
        rounds
    }

    #[test]
    fn answers_without_end_do_not_keep_a_round_open() {
        let mut rounds = begun();
        let over = (1..100).find(|tenth| {
            rounds.note_response(at(tenth * 100));
            rounds.step(at(tenth * 100), &Config::default(), 0, 0) != RoundStep::None
        });
        assert!(over.is_some_and(|tenth| tenth < 60), "{over:?}");
    }

    #[test]
    fn a_round_waits_until_the_bus_took_its_questions() {
        let mut rounds = begun();
        rounds.note_requests(1);
        assert_eq!(rounds.step(at(900), &Config::default(), 0, 0), RoundStep::None);
        rounds.note_sent(at(1000));
        assert_eq!(rounds.step(at(1020), &Config::default(), 0, 0), RoundStep::None);
        assert!(matches!(rounds.step(at(1200), &Config::default(), 0, 0), RoundStep::Over { .. }));
    }

    #[test]
    fn whoever_hurries_gets_a_round_that_begins_afterwards() {
        let config = Config { round_period: Duration::ZERO, ..Config::default() };
        let mut rounds = begun();
        rounds.quiet = QUIET_ROUNDS;
        rounds.request_round(at(50));
        assert!(matches!(rounds.step(at(1000), &config, 0, 0), RoundStep::Over { .. }));
        assert_eq!(rounds.step(at(1000), &config, 0, 0), RoundStep::Ask);
    }
}
