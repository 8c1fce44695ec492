//! Backoff: pauses between attempts to open a bus, which grow while attempts fail.

use std::time::Duration;

/// Pauses, each twice the one before, up to the longest.
#[derive(Clone, Copy, Debug)]
pub(in crate::bus) struct Backoff {
    first: Duration,
    longest: Duration,
    next: Duration,
}

impl Backoff {
    pub fn new(first: Duration, longest: Duration) -> Self {
        Self { first, longest, next: first }
    }

    /// The pause before the next attempt.
    pub fn pause(&mut self) -> Duration {
        let pause = self.next;
        self.next = (pause * 2).min(self.longest);
        pause
    }

    /// Notes how long the opened bus lasted. The first pause applies again only if that is at least
    /// the longest pause, so that a server that accepts and then closes is not tried every second.
    pub fn lasted(&mut self, time: Duration) {
        if time >= self.longest {
            self.next = self.first;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_until_a_connection_lasts() {
        let seconds = Duration::from_secs;
        let mut backoff = Backoff::new(seconds(1), seconds(5));
        let pauses: Vec<_> = (0..5).map(|_| backoff.pause().as_secs()).collect();
        assert_eq!(pauses, [1, 2, 4, 5, 5]);
        backoff.lasted(seconds(4));
        assert_eq!(backoff.pause(), seconds(5));
        backoff.lasted(seconds(5));
        assert_eq!(backoff.pause(), seconds(1));
    }
}
