//! How often frames are sent, and how far apart.

use crate::time::Duration;

/// Most copies that are sent one after the other.
pub const MAX_REPEATS: u32 = 1000;
/// Longest time between two copies, in milliseconds.
const MAX_INTERVAL: u32 = 60_000;

/// How often frames are sent, and how far apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeat {
    /// Number of copies, 1 to 1000.
    pub copies: u32,
    /// Least time between two copies.
    pub interval: Duration,
}

impl Default for Repeat {
    /// Once.
    fn default() -> Self {
        Self { copies: 1, interval: Duration::from_secs(1) }
    }
}

impl Repeat {
    /// Returns so many copies with so many milliseconds between them.
    ///
    /// # Errors
    ///
    /// What is out of range.
    pub fn new(copies: u32, every_ms: u32) -> Result<Self, String> {
        if !(1..=MAX_REPEATS).contains(&copies) {
            return Err(format!("repeat is 1 to {MAX_REPEATS}, not {copies}"));
        }
        if every_ms > MAX_INTERVAL {
            return Err(format!("every is 0 to {MAX_INTERVAL} ms, not {every_ms}"));
        }
        Ok(Self { copies, interval: Duration::from_millis(u64::from(every_ms)) })
    }

    /// Reads both as typed; empty: once, every 1000 ms.
    ///
    /// # Errors
    ///
    /// What is wrong with the count (first), or with the time.
    pub fn parse(copies: &str, every_ms: &str) -> Result<Self, String> {
        let read = |text: &str, usual: u32, what: &str| match text.trim() {
            "" => Ok(usual),
            text => text.parse().map_err(|_| format!("{what} is a number")),
        };
        Self::new(read(copies, 1, "repeat")?, read(every_ms, 1000, "every")?)
    }
}
