//! When the screen is drawn, and how much of it is sent.
//!
//! Inputs: keys, bytes sent and how long that took, answers of the terminal. Outputs: the time of the
//! next draw, the most bytes of it, when to ask the terminal. What a key changes is drawn at once; what
//! the bus changes as often as a budget of bytes per second allows. A line that is known to be slow is
//! never sent more than it takes in a short time, so that the effect of a key does not wait behind old
//! screens. A slow connection takes many screens before a write waits for it: what is on its way shows in
//! the time to the terminal's answer to a question.
//!
//! A state machine without I/O, in real time. Does not know what is drawn.

use crate::time::{Duration, Instant};

/// Least time between two draws.
const PACE: Duration = Duration::from_millis(33);
/// The same between two draws for keys.
const PACE_OF_KEYS: Duration = Duration::from_millis(5);
/// Bytes per second for what the bus changes: with the clock and a message, 2,000 at most.
pub const SCREEN_BUDGET: f64 = 1700.0;
/// Time after a key in which draws are what the key asked for: counts, a past moment.
const AFTER_KEY: Duration = Duration::from_millis(500);
/// What a slow line takes in this time is sent at once.
const PART: Duration = Duration::from_millis(250);
/// Smallest part, in bytes: a row.
const LEAST_PART: f64 = 100.0;
/// Share of a slow line for what the bus changes: the rest is free for keys.
const SHARE: f64 = 0.5;
/// A write that takes longer waited for the line.
const BLOCKED: Duration = Duration::from_millis(60);
/// Bytes after which the terminal is asked again: a part of a screen.
const ASK_AFTER: u64 = 1000;
/// An answer that is late by this is one of a line that still takes what was sent before.
const LATE: Duration = Duration::from_millis(250);
/// Longest time for which the bus waits for an answer: it may be lost.
const HELD: Duration = Duration::from_secs(10);
/// Time between two writes that waited within which the line is slow: one alone may have waited for
/// the program itself, on a busy board or while it was stopped.
const AGAIN: Duration = Duration::from_secs(5);
/// Slowest line that is measured, in bytes per second: 4,800 baud.
const SLOWEST: f64 = 480.0;
/// Lines that take more bytes per second are not slow.
const FAST: f64 = 100_000.0;
/// A line that was slow is tried faster by a quarter after this time without a wait.
const RETRY: Duration = Duration::from_secs(15);

/// See the documentation of the module.
#[derive(Debug)]
pub struct PaintPace {
    /// Bytes per second for what the bus changes.
    budget: f64,
    /// Bytes per second that the line takes; `None`: more than is ever sent.
    line: Option<f64>,
    /// The line is as fast as was set, not as was measured.
    is_line_set: bool,
    drawn: Option<Instant>,
    /// The last draw for a key.
    key_drawn: Option<Instant>,
    keyed: Option<Instant>,
    /// A key was handled after the last draw.
    has_new_key: bool,
    /// A screen was sent in part.
    is_partial: bool,
    /// From when on the bytes sent are within the budget.
    in_budget: Instant,
    /// When the line has taken all bytes sent.
    taken: Instant,
    /// Last time that the line was found to be slow.
    waited: Instant,
    /// The last write that waited while the line did not count as slow.
    blocked: Option<Instant>,
    /// Bytes sent; those before the last question, and before the last answered one.
    sent: u64,
    asked: u64,
    answered: u64,
    /// When the open question was asked.
    question: Option<Instant>,
    /// Shortest time to an answer; `None` if the terminal has not answered yet.
    round_trip: Option<Duration>,
}

impl PaintPace {
    /// Returns the pace for a budget of bytes per second, and a line that takes so many bytes per
    /// second; `None` if that is not known.
    pub fn new(budget: f64, line: Option<f64>) -> Self {
        Self {
            budget,
            line,
            is_line_set: line.is_some(),
            drawn: None,
            key_drawn: None,
            keyed: None,
            has_new_key: false,
            is_partial: false,
            in_budget: Instant::ZERO,
            taken: Instant::ZERO,
            waited: Instant::ZERO,
            blocked: None,
            sent: 0,
            asked: 0,
            answered: 0,
            question: None,
            round_trip: None,
        }
    }

    /// Notes that input of the user was handled.
    pub fn note_key(&mut self, now: Instant) {
        self.keyed = Some(now);
        self.has_new_key = true;
    }

    /// Returns true if a draw at this time is for a key.
    fn is_after_key(&self, at: Instant) -> bool {
        self.has_new_key || self.keyed.is_some_and(|keyed| at < keyed + AFTER_KEY)
    }

    /// When a screen that is out of date is drawn.
    pub fn due(&self) -> Instant {
        let Some(drawn) = self.drawn else { return Instant::ZERO };
        // A key does not wait after a draw of what the bus changed.
        let least = match (self.has_new_key, self.key_drawn) {
            (true, Some(key_drawn)) => key_drawn + PACE_OF_KEYS,
            (true, None) => Instant::ZERO,
            (false, _) => drawn + PACE,
        };
        let due = least.max(self.taken);
        if let Some(held) = self.held_until().filter(|_| !self.has_new_key) {
            return due.max(held);
        }
        // The rest of a screen waits for the line only: it was begun within the budget.
        if self.is_partial || self.is_after_key(due) { due } else { due.max(self.in_budget) }
    }

    /// Until when what the bus changes waits for a late answer; `None` while none is late.
    fn held_until(&self) -> Option<Instant> {
        let asked = self.question.filter(|_| self.sent > self.asked + ASK_AFTER)?;
        self.round_trip.map(|_| asked + HELD)
    }

    /// Returns true if the terminal has answered.
    pub fn is_answered(&self) -> bool {
        self.round_trip.is_some()
    }

    /// Returns true if the terminal is to be asked: it answers, and enough was sent since.
    pub fn wants_answer(&self) -> bool {
        self.question.is_none() && self.round_trip.is_some() && self.sent - self.asked >= ASK_AFTER
    }

    /// Notes that the terminal was asked.
    pub fn note_question(&mut self, now: Instant) {
        self.question = Some(now);
        self.asked = self.sent;
    }

    /// Notes an answer: the terminal has all bytes sent before the question.
    pub fn note_answer(&mut self, now: Instant) {
        let Some(asked) = self.question.take() else { return };
        let took = now.since(asked);
        let usual = self.round_trip.map_or(took, |usual| usual.min(took));
        self.round_trip = Some(usual);
        let late = took.saturating_sub(usual);
        let bytes = (self.asked - self.answered) as usize;
        self.answered = self.asked;
        if !self.is_line_set && late >= LATE {
            // It had many bytes to take.
            self.blocked = Some(now);
            self.measure(now, bytes, late);
            if let Some(line) = self.line {
                let on_the_way = (self.sent - self.asked) as f64;
                self.taken = now + Duration::from_secs_f64(on_the_way / line);
            }
        }
    }

    /// Returns true if the rest of a screen is to be sent.
    pub fn is_partial(&self) -> bool {
        self.is_partial
    }

    /// Returns true if the next draw is of a new screen: what the bus changes waits for the rest of the
    /// last one, what a key changes does not.
    pub fn is_renewed(&self) -> bool {
        !self.is_partial || self.has_new_key
    }

    /// Most bytes of the next draw.
    pub fn most_bytes(&self) -> usize {
        match self.line {
            Some(line) => (line * PART.as_secs_f64()).max(LEAST_PART) as usize,
            None => usize::MAX,
        }
    }

    /// Notes a draw that ended at `now`, the bytes sent, how long the write took, and whether nothing
    /// is left to be sent.
    pub fn drawn(&mut self, now: Instant, bytes: usize, took: Duration, is_complete: bool) {
        if !self.is_line_set {
            self.measure(now, bytes, took);
        }
        self.sent += bytes as u64;
        let bytes = bytes as f64;
        let budget = self.line.map_or(self.budget, |line| self.budget.min(line * SHARE));
        if !self.is_after_key(now) {
            self.in_budget = self.in_budget.max(now) + Duration::from_secs_f64(bytes / budget);
        }
        if let Some(line) = self.line {
            self.taken = self.taken.max(now - took) + Duration::from_secs_f64(bytes / line);
        }
        self.drawn = Some(now);
        if std::mem::take(&mut self.has_new_key) {
            self.key_drawn = Some(now);
        }
        self.is_partial = !is_complete;
    }

    /// Notes how fast the line took bytes.
    fn measure(&mut self, now: Instant, bytes: usize, took: Duration) {
        if took >= BLOCKED {
            let rate = (bytes as f64 / took.as_secs_f64()).max(SLOWEST);
            let before = self.blocked.replace(now);
            let is_again = before.is_some_and(|before| now - took <= before + AGAIN);
            if self.line.is_some() || is_again {
                self.waited = now;
                self.line = Some(self.line.map_or(rate, |line| line.min(rate)));
            }
        } else if let Some(line) = self.line
            && now.since(self.waited) >= RETRY
        {
            self.waited = now;
            self.line = Some(line * 1.25);
        }
        self.line = self.line.filter(|line| *line < FAST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    const NO_TIME: Duration = Duration::ZERO;

    #[test]
    fn bus_changes_keep_to_the_budget_and_keys_do_not() {
        let mut pace = PaintPace::new(1000.0, None);
        assert_eq!((pace.due(), pace.most_bytes()), (at(0), usize::MAX));
        pace.drawn(at(1000), 2000, NO_TIME, true);
        assert_eq!(pace.due(), at(3000));
        pace.note_key(at(1001));
        assert!(pace.due() <= at(1001), "at once");
        pace.drawn(at(1002), 5000, NO_TIME, true);
        // What follows from the key.
        assert_eq!(pace.due(), at(1035));
        pace.note_key(at(1003));
        assert_eq!(pace.due(), at(1007), "keys that come at once are drawn together");
        pace.drawn(at(1007), 100, NO_TIME, true);
        pace.drawn(at(1600), 100, NO_TIME, true);
        assert_eq!(pace.due(), at(3100));
    }

    #[test]
    fn slow_line_gets_parts_and_half_of_it_is_free_for_keys() {
        let mut pace = PaintPace::new(2000.0, Some(960.0));
        assert_eq!(pace.most_bytes(), 240);
        pace.drawn(at(1000), 240, NO_TIME, false);
        assert!(pace.is_partial());
        assert_eq!(pace.due(), at(1250));
        pace.drawn(at(1250), 240, NO_TIME, true);
        assert_eq!(pace.due(), at(2000));
        pace.note_key(at(1300));
        assert_eq!(pace.due(), at(1500), "when the line has taken the last part");
    }

    #[test]
    fn line_that_blocks_is_measured_and_tried_again_faster() {
        let mut pace = PaintPace::new(2000.0, None);
        pace.drawn(at(1000), 2000, Duration::from_secs(1), true);
        assert_eq!(pace.most_bytes(), usize::MAX, "the program may have been stopped");
        pace.drawn(at(3000), 2000, Duration::from_secs(2), true);
        assert_eq!(pace.most_bytes(), 250);
        pace.drawn(at(9000), 200, NO_TIME, true);
        assert_eq!(pace.most_bytes(), 250);
        pace.drawn(at(18_000), 200, NO_TIME, true);
        assert_eq!(pace.most_bytes(), 312);
        // Faster than any screen needs: not slow any more.
        for turn in 1..60 {
            pace.drawn(at(18_000 + turn * 15_000), 200, NO_TIME, true);
        }
        assert_eq!(pace.most_bytes(), usize::MAX);
    }

    #[test]
    fn late_answer_shows_how_much_the_line_takes() {
        let mut pace = PaintPace::new(2000.0, None);
        pace.note_question(at(0));
        pace.drawn(at(5), 3000, NO_TIME, true);
        assert!(!pace.wants_answer(), "one is open");
        pace.note_answer(at(80));
        assert!(pace.wants_answer());
        assert_eq!(pace.most_bytes(), usize::MAX, "the usual time");
        pace.note_question(at(100));
        // Two screens more; the bus waits for the answer, a key does not.
        pace.note_key(at(101));
        pace.drawn(at(110), 6000, NO_TIME, true);
        assert_eq!(pace.due(), at(10_100));
        pace.note_key(at(200));
        assert_eq!(pace.due(), at(115));
        pace.note_answer(at(3180));
        // 3,000 bytes in 3 s; 6,000 are on their way.
        assert_eq!(pace.most_bytes(), 250);
        assert_eq!(pace.due(), at(9180));
        // Fast again: tried so after a while.
        pace.note_question(at(20_000));
        pace.note_answer(at(20_090));
        pace.drawn(at(20_100), 100, NO_TIME, true);
        assert_eq!(pace.most_bytes(), 312);
    }

    #[test]
    fn terminal_that_never_answers_is_not_asked_again() {
        let mut pace = PaintPace::new(2000.0, None);
        pace.note_question(at(0));
        pace.drawn(at(5), 9000, NO_TIME, true);
        assert!(!pace.wants_answer());
        assert_eq!(pace.due(), at(4505), "within the budget");
    }
}
