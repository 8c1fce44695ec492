//! Values of one address that alternate: names, UIDs, service lists, U bits. A value that returns
//! while another one is still remembered shows two senders (protocol §5.2).

use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Most values remembered of one address: names, UIDs or service lists. Bounds the memory; more
/// count as returning.
pub(super) const MAX_VALUES: usize = 8;

/// Detects values that return to an address: A, B, A or A, B, C, A.
#[derive(Clone, Debug)]
pub(super) struct RecentValues<T> {
    current: Option<RecentValue<T>>,
    /// Values before the current one, the one that was current last at the end.
    earlier: VecDeque<RecentValue<T>>,
    return_count: u32,
    /// Time at which another value became current.
    changed_at: Instant,
}

/// A value, since when it is remembered, when it was observed last, and when another one took its
/// place.
#[derive(Clone, Debug)]
struct RecentValue<T> {
    value: T,
    since: Instant,
    last: Instant,
    left_at: Instant,
}

/// What an observed value shows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ObservedValue {
    /// Time since this value was observed before, if it is remembered.
    pub interval: Option<Duration>,
    /// How often in a row a value returned, if it did just now.
    pub return_count: Option<u32>,
}

impl<T> Default for RecentValues<T> {
    fn default() -> Self {
        Self { current: None, earlier: VecDeque::new(), return_count: 0, changed_at: Instant::ZERO }
    }
}

impl<T: PartialEq + Clone> RecentValues<T> {
    /// Takes the current value. A value that was not current for longer than `forget_after` is
    /// forgotten.
    pub fn observe(&mut self, now: Instant, value: &T, forget_after: Duration) -> ObservedValue {
        if let Some(current) = self.current.as_mut().filter(|current| current.value == *value) {
            let interval = Some(now.since(current.last));
            current.last = now;
            return ObservedValue { interval, return_count: None };
        }
        self.earlier.retain(|earlier| now.since(earlier.left_at) <= forget_after);
        if self.earlier.is_empty() {
            self.return_count = 0;
        }
        let known = self.earlier.iter().position(|earlier| earlier.value == *value);
        let returned = known.and_then(|at| self.earlier.remove(at));
        // More values than are remembered: it may be one of those that were forgotten.
        let is_return = returned.is_some() || self.earlier.len() == MAX_VALUES - 1;
        self.return_count = if is_return { self.return_count + 1 } else { 0 };
        let interval = returned.as_ref().map(|returned| now.since(returned.last));
        let since = returned.map_or(now, |returned| returned.since);
        let next = RecentValue { value: value.clone(), since, last: now, left_at: now };
        if let Some(left) = self.current.replace(next) {
            if self.earlier.len() == MAX_VALUES - 1 {
                self.earlier.pop_front();
            }
            self.earlier.push_back(RecentValue { left_at: now, ..left });
        }
        self.changed_at = now;
        ObservedValue { interval, return_count: is_return.then_some(self.return_count) }
    }

    /// The current value.
    pub fn current(&self) -> Option<&T> {
        self.current.as_ref().map(|current| &current.value)
    }

    /// The current value, and when it was observed last.
    pub fn last(&self) -> Option<(&T, Instant)> {
        self.current.as_ref().map(|current| (&current.value, current.last))
    }

    /// The value before the current one.
    pub fn previous(&self) -> Option<&T> {
        self.earlier.back().map(|earlier| &earlier.value)
    }

    /// The values that were current less than `within` ago, with the time since when each is
    /// remembered, the first one first.
    pub fn recent(&self, now: Instant, within: Duration) -> Vec<(&T, Instant)> {
        let earlier = self.earlier.iter().filter(|earlier| now.since(earlier.left_at) <= within);
        let mut values: Vec<_> =
            earlier.chain(&self.current).map(|value| (&value.value, value.since)).collect();
        values.sort_by_key(|(_, since)| *since);
        values
    }

    /// Time of the last observation of the value that was observed last before the current one, and
    /// more than once.
    pub fn second_last_seen(&self) -> Option<Instant> {
        let repeated = self.earlier.iter().filter(|earlier| earlier.last > earlier.since);
        repeated.map(|earlier| earlier.last).max()
    }

    /// Returns true if there was another value less than `within` ago.
    pub fn changed_within(&self, now: Instant, within: Duration) -> bool {
        self.previous().is_some() && now.since(self.changed_at) < within
    }

    /// Time since when two of the values are there that were observed less than `within` ago.
    pub fn second_since(&self, now: Instant, within: Duration) -> Instant {
        let values = self.earlier.iter().chain(&self.current);
        let all = values.filter(|value| now.since(value.last) <= within).map(|value| value.since);
        let (_, second) = all.fold((None, None), |(first, second), since| match first {
            Some(first) if since >= first => {
                (Some(first), Some(second.map_or(since, |second: Instant| second.min(since))))
            }
            _ => (Some(since), first),
        });
        second.unwrap_or(self.changed_at)
    }
}
