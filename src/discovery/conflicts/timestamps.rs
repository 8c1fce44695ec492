//! Whether the times of heartbeats are those of the bus: a log may have none, or coarse ones.
//!
//! Pure. Does not decide what the times mean.

use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Resolution of a log whose times are coarse, in microseconds. On a bus two frames begin at least 47 µs apart.
const COARSE: u64 = 100;

/// Returns false if these are not times of the bus: those of a log without times are all equal, and what is
/// read from a pipe at once has one time of arrival. In a log of coarse times two senders may have equal ones.
pub(super) fn have_times(times: &VecDeque<Instant>) -> bool {
    let at_once = times.iter().zip(times.iter().skip(1)).any(|(one, next)| one == next);
    let are_coarse = || times.iter().all(|time| is_coarse(*time));
    !at_once || times.front() != times.back() && are_coarse()
}

/// Returns true if a frame at `now` may have come `gap` after another one: at the same time only in a log of
/// coarse times.
pub(super) fn is_known(now: Instant, gap: Duration) -> bool {
    !gap.is_zero() || is_coarse(now)
}

fn is_coarse(time: Instant) -> bool {
    time.as_micros().is_multiple_of(COARSE)
}
