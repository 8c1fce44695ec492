//! Timing of the heartbeats of one address: their rate and their phases (protocol §5.2).

use super::history::{MAX_PHASES, MAX_TIMES};
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Heartbeats that show two phases: seven intervals, three periods and a half of two senders.
const TWO_PHASE_TIMES: usize = 8;

/// Timing pattern of the heartbeats from one address.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeartbeatPattern {
    /// Heartbeats arrive at twice the rate.
    pub double_rate: bool,
    /// Heartbeats arrive in two or more distinct phases.
    pub two_phases: bool,
    /// Since when two devices are present, if either flag is set.
    pub since: Option<Instant>,
}

/// Returns true if more heartbeats arrived in the last three periods than one steady sender has.
pub(super) fn has_several_senders(times: &VecDeque<Instant>, period: Duration) -> bool {
    let Some(last) = times.back() else { return false };
    let recent = |time: &&Instant| last.since(**time) < period * 3;
    times.iter().rev().take_while(recent).count() >= 5
}

/// Returns the timing pattern of the last heartbeats.
pub(super) fn pattern(times: &VecDeque<Instant>, period: Duration) -> HeartbeatPattern {
    let Some(&last) = times.back() else { return HeartbeatPattern::default() };
    let recent = times.iter().rev().take(TWO_PHASE_TIMES);
    let recent = recent.filter(|time| last.since(**time) < period * 4);
    // The newest heartbeat must be early, or the double rate has already ended.
    let before = times.iter().rev().nth(1);
    let soon = before.is_some_and(|before| last.since(*before) < period.mul_f64(0.85));
    let double_rate =
        soon && recent.count() >= TWO_PHASE_TIMES - 1 && !is_faster_sender(times, period);
    // This many heartbeats show two devices for at least a period.
    let rate = HeartbeatPattern { double_rate, two_phases: false, since: Some(last - period) };
    if times.len() < TWO_PHASE_TIMES - 1 {
        return rate;
    }
    let mut gaps = [0.0; MAX_TIMES - 1];
    let pairs = times.iter().zip(times.iter().skip(1));
    for (gap, (one, next)) in gaps.iter_mut().zip(pairs) {
        *gap = next.since(*one).as_secs_f64() / period.as_secs_f64();
    }
    let gaps = &gaps[..times.len() - 1];
    let first = |count: usize| times.len().saturating_sub(count);
    let since = cycle_length(gaps).map(|senders| first(2 * senders + 1) + 1).or_else(|| {
        let begin = gaps.len().saturating_sub(TWO_PHASE_TIMES - 1);
        second_sender(&gaps[begin..]).map(|at| begin + at)
    });
    match since {
        Some(at) => HeartbeatPattern { two_phases: true, since: times.get(at).copied(), ..rate },
        None => rate,
    }
}

/// Returns true if equal intervals show one sender with a shorter period. Only with half of it two
/// senders look the same.
fn is_faster_sender(times: &VecDeque<Instant>, period: Duration) -> bool {
    let last = times.len().saturating_sub(TWO_PHASE_TIMES);
    let gaps = times.iter().skip(last).zip(times.iter().skip(last + 1));
    let gaps = gaps.map(|(one, next)| next.since(*one).as_secs_f64() / period.as_secs_f64());
    let (shortest, longest) = gaps.fold((f64::MAX, 0.0_f64), |(shortest, longest), gap| {
        (shortest.min(gap), longest.max(gap))
    });
    let mean = f64::midpoint(shortest, longest);
    longest - shortest < 0.15 * longest && !(0.4..=0.6).contains(&mean)
}

/// Returns the place of the first heartbeat after which both of two senders are present; `None` if
/// the gaps do not show two.
fn second_sender(gaps: &[f64]) -> Option<usize> {
    let count = gaps.len();
    let full_period = gaps.windows(2).all(|two| (0.85..=1.15).contains(&(two[0] + two[1])));
    let apart = gaps.windows(2).all(|two| (two[0] - two[1]).abs() > 0.15);
    // If one of the two stopped, the newest gap is a full period.
    let continues = (gaps[count - 1] - gaps[count - 3]).abs() < 0.1;
    if !(full_period && continues && (apart || has_two_phases(gaps))) {
        return None;
    }
    // Both senders were present at the second heartbeat, or, if the first gap is a full period, at
    // the third.
    let short = gaps.iter().copied().fold(f64::MAX, f64::min);
    let alone = (gaps[0] - gaps[2]).abs() > short / 4.0;
    Some(1 + usize::from(alone))
}

/// Returns true if long and short gaps alternate far more regularly than by chance: two steady
/// senders almost half a period apart.
fn has_two_phases(gaps: &[f64]) -> bool {
    let range = |from: usize| {
        let every_other = gaps.iter().skip(from).step_by(2);
        every_other.fold((f64::MAX, f64::MIN), |(low, high), &gap| (low.min(gap), high.max(gap)))
    };
    let (even, odd) = (range(0), range(1));
    let apart = (even.0 - odd.1).max(odd.0 - even.1);
    apart > 0.04 && apart > 3.0 * (even.1 - even.0).max(odd.1 - odd.0)
}

/// Returns the number of senders, three or more, whose phases the last gaps repeat.
fn cycle_length(gaps: &[f64]) -> Option<usize> {
    // Two cycles of three senders are the fewest: six gaps in two periods.
    let six = gaps.len().checked_sub(6)?;
    if gaps[six..].iter().sum::<f64>() > 2.2 {
        return None;
    }
    let mut senders = (3..=MAX_PHASES).take_while(|senders| 2 * senders <= gaps.len());
    senders.find(|&senders| is_cycle(&gaps[gaps.len() - 2 * senders..], senders))
}

/// Returns true if gaps repeat in a cycle of `senders` gaps and differ within it: that many steady
/// senders. One sender with a shorter period has equal gaps.
fn is_cycle(gaps: &[f64], senders: usize) -> bool {
    let is_period = |cycle: &[f64]| (0.9..=1.1).contains(&cycle.iter().sum());
    let repeats = gaps.iter().zip(&gaps[senders..]).map(|(gap, next)| (gap - next).abs());
    let noise = repeats.fold(0.0, f64::max);
    let longest = gaps.iter().copied().fold(0.0, f64::max);
    let shortest = gaps.iter().copied().fold(f64::MAX, f64::min);
    let contrast = longest - shortest;
    gaps.windows(senders).all(is_period) && contrast > 0.04 && contrast > 3.0 * noise
}
