//! DEBUG messages of a device, counted by code (CAN platform §4.3).

use crate::time::{Duration, Instant};
use crate::wire::id::Service;

/// Maximum number of codes that are counted one by one. Bounds the memory; a code is any of 1024.
const MAX_CODES: usize = 32;
/// Time between two messages below which they are frequent.
const FREQUENT_INTERVAL: Duration = Duration::from_millis(100);

/// DEBUG messages with one code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DebugCount {
    /// The code.
    pub code: Service,
    /// Number of messages.
    pub count: u64,
    /// Time of the last one.
    pub last: Instant,
}

/// DEBUG messages of a device.
#[derive(Clone, Debug, Default)]
pub struct DebugCounts {
    by_code: Vec<DebugCount>,
    others: u64,
    last: Option<Instant>,
    is_frequent: bool,
}

impl DebugCounts {
    /// Counts a message.
    pub(super) fn note(&mut self, now: Instant, code: Service) {
        let before = self.last.replace(now);
        self.is_frequent |= before.is_some_and(|before| now.since(before) < FREQUENT_INTERVAL);
        match self.by_code.binary_search_by_key(&code, |known| known.code) {
            Ok(at) => {
                let known = &mut self.by_code[at];
                (known.count, known.last) = (known.count.saturating_add(1), now);
            }
            Err(at) if self.by_code.len() < MAX_CODES => {
                self.by_code.insert(at, DebugCount { code, count: 1, last: now });
            }
            Err(_) => self.others = self.others.saturating_add(1),
        }
    }

    /// The counts by code, ascending; at most 32.
    pub fn by_code(&self) -> &[DebugCount] {
        &self.by_code
    }

    /// Number of messages with further codes.
    pub fn others(&self) -> u64 {
        self.others
    }

    /// Returns true if two of them were less than 100 ms apart.
    pub const fn is_frequent(&self) -> bool {
        self.is_frequent
    }

    /// Number of all messages.
    pub fn total(&self) -> u64 {
        self.by_code.iter().fold(self.others, |sum, known| sum.saturating_add(known.count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_bounded_and_all_messages_count() {
        let mut counts = DebugCounts::default();
        for number in 0..2000_u16 {
            counts.note(Instant::from_micros(number.into()), Service::from_bits(number % 100));
        }
        assert_eq!((counts.by_code().len(), counts.total()), (MAX_CODES, 2000));
        assert_eq!(counts.by_code()[3].count, 20);
        assert_eq!(counts.by_code()[3].last, Instant::from_micros(1903));
    }

    #[test]
    fn messages_100_ms_apart_are_not_frequent() {
        let mut counts = DebugCounts::default();
        for millis in [0, 100, 200, 299] {
            assert!(!counts.is_frequent(), "{millis}");
            counts.note(Instant::from_micros(millis * 1000), Service::from_bits(1));
        }
        assert!(counts.is_frequent());
    }
}
