//! The time of a 32-bit timer, continued over its wraps. Reads no timer.

use crate::time::Instant;

/// Continues a counter of microseconds with 32 bits, which wraps from `0xFFFF_FFFF` to 0 each 71
/// minutes.
///
/// ```
/// use descan::node::ExtendedClock;
///
/// let mut clock = ExtendedClock::default();
/// let before = clock.extend(0xFFFF_FFFF);
/// assert_eq!(clock.extend(9).since(before).as_micros(), 10);
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct ExtendedClock {
    now: u64,
}

impl ExtendedClock {
    /// Returns the moment of a counter reading, in microseconds. Call it at least once in 71
    /// minutes, with readings in their order.
    pub fn extend(&mut self, micros: u32) -> Instant {
        let step = micros.wrapping_sub(self.now as u32);
        self.now += u64::from(step);
        Instant::from_micros(self.now)
    }
}
