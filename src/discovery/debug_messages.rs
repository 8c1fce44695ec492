//! DEBUG messages of a device, counted by code (CAN platform §4.3).

use crate::time::Instant;
use crate::wire::id::Service;

/// Maximum number of codes that are counted one by one. Bounds the memory; a code is any of 1024.
const MAX_CODES: usize = 32;

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
}

impl DebugCounts {
    /// Counts a message.
    pub(super) fn note(&mut self, now: Instant, code: Service) {
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
}
