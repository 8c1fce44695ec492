//! Numbered channels of logs: the names that descan gives them, and the numbers it gives to names.

use super::LogLoss;
use std::fmt::Write;
use std::sync::LazyLock;

/// Names of the channels 0 to 255.
static CHANNELS: LazyLock<Names> = LazyLock::new(|| Names::new("ch"));
/// Names of the buses 0 to 255 of formats that call them so.
static BUSES: LazyLock<Names> = LazyLock::new(|| Names::new("bus"));

/// Name of the bus of a log that has no channels.
pub(super) const ONLY_BUS: &str = "bus0";

/// Names one after the other, without allocations of their own.
struct Names {
    text: String,
    ends: [usize; 256],
}

impl Names {
    fn new(start: &str) -> Self {
        let (mut text, mut ends) = (String::new(), [0; 256]);
        for (number, end) in ends.iter_mut().enumerate() {
            // Writing to a text does not fail.
            let _ = write!(text, "{start}{number}");
            *end = text.len();
        }
        Self { text, ends }
    }

    fn name(&self, number: u8) -> &str {
        let at = usize::from(number);
        let start = if at == 0 { 0 } else { self.ends[at - 1] };
        &self.text[start..self.ends[at]]
    }
}

/// Returns the name of a channel, as in `ch1`.
pub(super) fn channel_name(number: u8) -> &'static str {
    CHANNELS.name(number)
}

/// Returns the name of a numbered bus, as in `bus0`.
pub(super) fn bus_name(number: u8) -> &'static str {
    BUSES.name(number)
}

/// The numbers that a written log gives to interfaces.
#[derive(Clone, Debug, Default)]
pub(super) struct ChannelNumbers {
    /// Names with their numbers.
    given: Vec<(String, u8)>,
    /// The smallest number.
    first: u8,
}

impl ChannelNumbers {
    /// Begins with no names; the smallest number is `first`.
    pub fn new(first: u8) -> Self {
        Self { given: Vec::new(), first }
    }

    /// Returns the number of a name: that at its end, which counts from 0 except for `ch1`, or the first
    /// one that is free.
    pub fn number(&mut self, name: &str) -> u8 {
        if let Some((_, number)) = self.given.iter().find(|(given, _)| given == name) {
            return *number;
        }
        let wanted = self.wanted(name).filter(|number| self.is_free(*number));
        let free = || (self.first..=u8::MAX).find(|number| self.is_free(*number));
        let number = wanted.or_else(free).unwrap_or(u8::MAX);
        self.given.push((name.to_owned(), number));
        number
    }

    /// Returns what a log with numbers in place of names does not hold, beside this.
    pub fn loss(&self, other: &LogLoss) -> LogLoss {
        LogLoss { numbers: self.lost_names(), shared_numbers: self.shared(), ..other.clone() }
    }

    fn lost_names(&self) -> Vec<(String, u8)> {
        let is_lost = |(name, number): &&(String, u8)| {
            name != channel_name(*number) && name != bus_name(*number)
        };
        self.given.iter().filter(is_lost).cloned().collect()
    }

    /// Returns how many names have the number of another one, because there are no more numbers.
    fn shared(&self) -> u64 {
        let mut taken = [false; 256];
        let repeated = |number: u8| std::mem::replace(&mut taken[usize::from(number)], true);
        let numbers = self.given.iter().map(|(_, number)| *number);
        numbers.map(repeated).filter(|is_repeated| *is_repeated).count() as u64
    }

    fn is_free(&self, number: u8) -> bool {
        number >= self.first && self.given.iter().all(|(_, given)| *given != number)
    }

    fn wanted(&self, name: &str) -> Option<u8> {
        let start = name.trim_end_matches(|c: char| c.is_ascii_digit());
        let number: u8 = name[start.len()..].parse().ok()?;
        let counts_from = u8::from(start == "ch");
        number.checked_sub(counts_from)?.checked_add(self.first)
    }
}
