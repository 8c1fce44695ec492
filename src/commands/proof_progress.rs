//! How far the tests of a device are: on a terminal one line that is replaced, elsewhere lines.
//!
//! Does not know the tests.

use super::output::{self, say};
use crate::prove::Prover;
use crate::time::{Duration, Instant};
use std::io::{self, IsTerminal};

/// Longest time between two lines elsewhere.
const QUIET: Duration = Duration::from_secs(10);

/// What was shown last.
#[derive(Debug)]
pub struct ProofProgress {
    is_terminal: bool,
    /// Tenths of the tests, and when they were printed.
    told: (usize, Instant),
    /// What is done, and since when.
    activity: Option<(&'static str, Instant)>,
    line: String,
}

impl ProofProgress {
    /// Nothing was shown.
    pub fn new() -> Self {
        let is_terminal = io::stderr().is_terminal();
        Self { is_terminal, told: (0, Instant::ZERO), activity: None, line: String::new() }
    }

    /// A device is to be tested.
    pub fn begin(&mut self, now: Instant) {
        (self.told, self.activity) = ((0, now), None);
    }

    /// Shows how far the tests are, unless that is on the screen.
    pub fn show(&mut self, prover: &Prover, now: Instant) {
        let activity = prover.activity();
        let since = match self.activity {
            Some((last, since)) if last == activity => since,
            _ => now,
        };
        self.activity = Some((activity, since));
        let (made, all) = prover.progress();
        let tests = format!("device at {}: {made} of {all} tests", prover.device());
        if self.is_terminal {
            let seconds = now.since(since).as_secs();
            let waits = if seconds > 0 { format!(", {seconds} s") } else { String::new() };
            self.replace(format!("{tests}; {activity}{waits}"));
            return;
        }
        let tenth = made * 10 / all.max(1);
        if tenth > self.told.0 {
            say(&tests);
        } else if now.since(self.told.1) >= QUIET {
            say(format!("{tests}; {activity}"));
        } else {
            return;
        }
        self.told = (tenth.max(self.told.0), now);
    }

    fn replace(&mut self, line: String) {
        if line != self.line {
            output::show_progress(&line);
            self.line = line;
        }
    }

    /// Removes the line, for other text.
    pub fn clear(&mut self) {
        if !self.line.is_empty() {
            self.replace(String::new());
        }
    }
}

impl Drop for ProofProgress {
    fn drop(&mut self) {
        self.clear();
    }
}
