//! Timing of the heartbeats of one address: their rate and their phases (protocol §5.2).

use super::history::MAX_PHASES;
use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Heartbeats that show two phases: seven intervals, three periods and a half of two senders.
const TWO_PHASE_TIMES: usize = 8;
/// The same for two phases almost half a period apart: seven periods, so that chance does not
/// separate long and short intervals.
const HALF_PERIOD_TIMES: usize = 15;
/// Heartbeats that show the phases of several senders: two cycles of the most that are told apart.
const CYCLE_TIMES: usize = 2 * MAX_PHASES + 1;
/// Periods of the heartbeats that are counted.
pub(super) const WINDOW_PERIODS: u32 = 8;
/// Number of heartbeats in them that one sender has at most: nine, and two for changes of its mode
/// or jitter.
const MAX_OF_ONE: usize = 11;
/// The same in the last part of them: of two senders, one may have left.
const MAX_OF_ONE_AT_END: usize = 3;
const END_PERIODS: f64 = 2.1;
/// Shortest period of a sender, in expected periods, that is told from several senders although
/// heartbeats are lost. Chosen: a tenth, and its jitter.
const MIN_FASTER_PERIOD: f64 = 0.08;
/// Deviation of an interval from a multiple of the period, in periods, by the jitter of a busy bus.
/// As that of a measured period.
const GRID_TOLERANCE: f64 = 0.15;
/// Periods in which a faster sender has a heartbeat in all parts of the period but one, and in all:
/// with 40 % of the heartbeats lost, a part is empty for as long once in 97 and in 610 cases.
/// Several senders have them in the same parts each time.
const PERIODS_OF_MOST_PARTS: f64 = 5.0;
const PERIODS_OF_ALL_PARTS: f64 = 7.0;
/// Heartbeats that may deviate more, or a sixth of them, if there are enough: those that waited on a
/// busy bus.
const MAX_LATE: usize = 2;
const MIN_GAPS_WITH_LATE: usize = 8;

/// Smallest difference, in periods, between the intervals of two senders. Chosen: twice the jitter
/// of a quiet bus.
const MIN_PHASE_CONTRAST: f64 = 0.04;
/// Intervals that show two senders although heartbeats are lost between them: as many as without
/// losses.
const MIN_ALTERNATING_GAPS: usize = TWO_PHASE_TIMES - 1;

/// Last intervals without a lost heartbeat that show several senders: with 30 % of the heartbeats
/// lost, ten in a row are received in 3 % of the cases. Longer ones before may be of one sender alone.
const MAX_GAPS_WITHOUT_LOSS: usize = 10;

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
    if is_faster_with_losses(times, period) {
        return HeartbeatPattern::default();
    }
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
    let skipped = times.len().saturating_sub(CYCLE_TIMES);
    let times = || times.iter().skip(skipped);
    let mut gaps = [0.0; CYCLE_TIMES - 1];
    for (gap, (one, next)) in gaps.iter_mut().zip(times().zip(times().skip(1))) {
        *gap = next.since(*one).as_secs_f64() / period.as_secs_f64();
    }
    let count = times().count();
    let gaps = &gaps[..count - 1];
    let first = |number: usize| count.saturating_sub(number);
    let since = cycle_length(gaps)
        .map(|senders| first(2 * senders + 1) + 1)
        .or_else(|| {
            let begin = gaps.len().saturating_sub(TWO_PHASE_TIMES - 1);
            second_sender(&gaps[begin..]).map(|at| begin + at)
        })
        .or_else(|| {
            let begin = gaps.len().checked_sub(HALF_PERIOD_TIMES - 1)?;
            are_half_a_period_apart(&gaps[begin..]).then_some(begin + 1)
        });
    match since {
        Some(at) => HeartbeatPattern { two_phases: true, since: times().nth(at).copied(), ..rate },
        None => rate,
    }
}

/// Returns true if more heartbeats arrived in the last periods than one sender has, and one with a
/// shorter period does not explain them. Losses hide the phases, but not the number.
pub(super) fn is_crowded(times: &VecDeque<Instant>, period: Duration) -> bool {
    let Some(&last) = times.back() else { return false };
    let has_more = |count: usize, within: Duration| {
        let at = times.len().checked_sub(count + 1);
        at.is_some_and(|at| last.since(times[at]) < within)
    };
    has_more(MAX_OF_ONE, period * WINDOW_PERIODS)
        && has_more(MAX_OF_ONE_AT_END, period.mul_f64(END_PERIODS))
        && grid_of(times, period).is_none_or(|grid| match grid.parts {
            None => false,
            // Two senders half a period apart look like one.
            Some(2) => grid.alternates,
            Some(_) => !grid.has_most_parts,
        })
}

/// A sender with a shorter period than expected, some of whose heartbeats may be lost.
struct FasterSender {
    /// Number of its periods in an expected one; `None` if that is not a whole number.
    parts: Option<u32>,
    /// True if heartbeats arrived in each of three parts, or in as many of more as losses leave:
    /// those of several senders leave more of them empty.
    has_most_parts: bool,
    /// True if some of the last intervals are several of its periods.
    has_losses: bool,
    /// True if every other of its heartbeats is late by the same time: two senders.
    alternates: bool,
}

/// Returns true if one sender with a shorter period explains the last heartbeats. Several senders
/// whose phases are parts of the period leave some of these parts empty.
fn is_faster_with_losses(times: &VecDeque<Instant>, period: Duration) -> bool {
    grid_of(times, period).is_some_and(|grid| match grid.parts {
        None => true,
        // Two senders half a period apart look the same.
        Some(2) => grid.has_losses && !grid.alternates,
        Some(_) => grid.has_most_parts,
    })
}

/// Returns the sender of whose period all intervals in the last periods are multiples.
fn grid_of(times: &VecDeque<Instant>, period: Duration) -> Option<FasterSender> {
    let last = *times.back()?;
    let recent = || times.iter().rev().take_while(|at| last.since(**at) < period * WINDOW_PERIODS);
    let gaps = || {
        let pairs = recent().zip(recent().skip(1));
        pairs.map(|(next, one)| next.since(*one).as_secs_f64() / period.as_secs_f64())
    };
    let shortest = gaps().fold(f64::MAX, f64::min);
    if !(MIN_FASTER_PERIOD..=1.0 - GRID_TOLERANCE).contains(&shortest) {
        return None;
    }
    let mean_step = |about: f64| {
        let steps: f64 = gaps().map(|gap| (gap / about).round().max(1.0)).sum();
        gaps().sum::<f64>() / steps
    };
    let step = mean_step(shortest);
    let is_regular = |gap: f64| (gap / step - (gap / step).round()).abs() <= GRID_TOLERANCE;
    let step = if gaps().all(is_regular) {
        step
    } else {
        let mut sorted: Vec<f64> = gaps().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let step = mean_step(sorted[(sorted.len() - 1) / 2]);
        let late = late_count(gaps(), step);
        let is_grid = sorted.len() >= MIN_GAPS_WITH_LATE && late <= MAX_LATE.max(sorted.len() / 6);
        is_grid.then_some(step)?
    };
    let parts = 1.0 / step;
    let whole = parts.round();
    // Long gaps alone at the beginning are those of one sender before the second one.
    let is_long = |gap: f64| (gap / step).round() > 1.0;
    let first_short = gaps().collect::<Vec<f64>>().iter().rposition(|gap| !is_long(*gap));
    let since_first = gaps().take(MAX_GAPS_WITHOUT_LOSS.min(first_short.unwrap_or(0)));
    let has_losses = since_first.into_iter().any(is_long);
    if (parts - whole).abs() > GRID_TOLERANCE {
        let grid =
            FasterSender { parts: None, has_most_parts: false, has_losses, alternates: false };
        return Some(grid);
    }
    let whole = whole as u32;
    let (mut at, mut hit) = (0.0_f64, 1_u32);
    for gap in gaps() {
        at += gap / step;
        hit |= 1 << (at.round() as u32 % whole);
    }
    let empty = whole.saturating_sub(hit.count_ones());
    let has_most_parts = match at * step {
        _ if whole <= 3 => empty == 0,
        periods if periods >= PERIODS_OF_ALL_PARTS => empty == 0,
        periods if periods >= PERIODS_OF_MOST_PARTS => empty <= 1,
        _ => empty * 2 < whole,
    };
    let alternates = whole == 2 && alternates(gaps(), step);
    Some(FasterSender { parts: Some(whole), has_most_parts, has_losses, alternates })
}

/// Returns the number of heartbeats that are not a multiple of `step` after one before them.
fn late_count(gaps: impl Iterator<Item = f64>, step: f64) -> usize {
    let (mut since, mut late) = (0.0, 0);
    for gap in gaps {
        since += gap / step;
        if (since - since.round()).abs() <= GRID_TOLERANCE {
            since = 0.0;
        } else {
            late += 1;
        }
    }
    late
}

/// Returns true if gaps of an odd number of `step` are alternately longer and shorter than that by
/// the same time, however many heartbeats are lost between them.
fn alternates(gaps: impl Iterator<Item = f64>, step: f64) -> bool {
    let mut sign = 1.0;
    let (mut low, mut high, mut noise, mut count) = (f64::MAX, f64::MIN, 0.0_f64, 0);
    for gap in gaps {
        let steps = (gap / step).round();
        let late = gap - steps * step;
        if steps % 2.0 == 0.0 {
            noise = noise.max(late.abs());
            continue;
        }
        (low, high) = (low.min(sign * late), high.max(sign * late));
        sign = -sign;
        count += 1;
    }
    let noise = noise.max(high - low);
    let late = if low > 0.0 { low } else { -high };
    count >= MIN_ALTERNATING_GAPS && late > MIN_PHASE_CONTRAST / 2.0 && 2.0 * late > 3.0 * noise
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
    let PhaseContrast { apart, noise } = phase_contrast(gaps);
    apart > MIN_PHASE_CONTRAST && apart > 3.0 * noise
}

/// Difference between every other gap and the others, and within each of both.
struct PhaseContrast {
    apart: f64,
    noise: f64,
}

fn phase_contrast(gaps: &[f64]) -> PhaseContrast {
    let range = |from: usize| {
        let every_other = gaps.iter().skip(from).step_by(2);
        every_other.fold((f64::MAX, f64::MIN), |(low, high), &gap| (low.min(gap), high.max(gap)))
    };
    let (even, odd) = (range(0), range(1));
    PhaseContrast {
        apart: (even.0 - odd.1).max(odd.0 - even.1),
        noise: (even.1 - even.0).max(odd.1 - odd.0),
    }
}

/// Returns true if long and short gaps alternate for so long, and so regularly, that one sender does
/// not explain it.
fn are_half_a_period_apart(gaps: &[f64]) -> bool {
    /// Smallest difference, in periods, that the timer tick of one sender does not explain.
    const MIN_CONTRAST: f64 = 0.012;
    let full_period = gaps.windows(2).all(|two| (0.95..=1.05).contains(&(two[0] + two[1])));
    let contrast = phase_contrast(gaps);
    full_period && contrast.apart > MIN_CONTRAST && contrast.apart > 6.0 * contrast.noise
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
    gaps.windows(senders).all(is_period) && contrast > MIN_PHASE_CONTRAST && contrast > 3.0 * noise
}
