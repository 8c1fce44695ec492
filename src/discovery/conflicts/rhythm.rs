//! Timing of the heartbeats of one address: their rate and their phases (protocol §5.2).

use super::grid::{
    MIN_PHASE_CONTRAST, SAME_PHASE, TWO_PHASE_TIMES, WINDOW_PERIODS, grid_of, may_be_one_sender,
    may_have_restarted,
};
use super::history::{MAX_PHASES, WHOLE_PERIOD};
use crate::time::{Duration, Instant};
use std::cmp::Ordering;
use std::collections::VecDeque;
use std::ops::RangeInclusive;

/// The same for two phases almost half a period apart: seven periods, so that chance does not
/// separate long and short intervals.
const HALF_PERIOD_TIMES: usize = 15;
/// Heartbeats that show the phases of several senders: two cycles of the most that are told apart.
const CYCLE_TIMES: usize = 2 * MAX_PHASES + 1;
/// Number of heartbeats in them that one sender has at most: nine, and two for changes of its mode
/// or jitter.
const MAX_OF_ONE: usize = 11;
/// The same in the last part of them: of two senders, one may have left.
const MAX_OF_ONE_AT_END: usize = 3;
const END_PERIODS: f64 = 2.1;
/// Periods in which two heartbeats of each sender show that both send in turn. With 30 % of the
/// heartbeats lost, nine of ten of one sender are lost once in 7,000 times.
const RECURRING_PERIODS: f64 = 10.0;
/// Periods at the end of these in which intervals may be of one sender alone.
const REMEMBERED_PERIODS: f64 = 5.0;
/// Periods after an early heartbeat in which two phases may be of two senders. With
/// 30 % of the heartbeats lost, as many have none in 1 % of the cases.
const EARLY_PERIODS: f64 = 5.0;

/// Smallest number of steps of the times in a period in which the rate of heartbeats is judged, which is
/// suspicious at most. Chosen: four in an interval at twice the rate.
const MIN_STEPS_OF_RATE: u32 = 8;

/// Deviation of the period of a device from the expected one, in periods, that its clock or its firmware's
/// rounding explains. Chosen: larger ones are another period.
const MAX_PERIOD_ERROR: f64 = 0.06;
/// Deviation of nearly all intervals of one sender from its period, in periods. A smaller one of the period
/// cannot be distinguished from it.
const PERIOD_NOISE: f64 = 0.01;

/// Timing pattern of the heartbeats from one address.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeartbeatPattern {
    /// Heartbeats arrive at twice the rate.
    pub double_rate: bool,
    /// Heartbeats arrive in two or more distinct phases.
    pub two_phases: bool,
    /// Heartbeats arrive in two phases of another period than the expected one.
    pub alternates: bool,
    /// Most heartbeats are one period after another one: phases are not those of one sender by chance.
    pub repeats: bool,
    /// Since when two devices are present, if one of the first two flags is set.
    pub since: Option<Instant>,
}

/// Returns true if more heartbeats arrived in the last three periods than one steady sender has.
pub(super) fn has_several_senders(times: &VecDeque<Instant>, period: Duration) -> bool {
    let Some(last) = times.back() else { return false };
    let recent = |time: &&Instant| last.since(**time) < period * 3;
    times.iter().rev().take_while(recent).count() >= 5
}

/// Returns the period after which most heartbeats are followed by another one, if it is nearly the expected
/// one; else the expected one. The phases of several senders repeat after their own period.
pub(super) fn repeated_period(times: &VecDeque<Instant>, expected: Duration) -> Duration {
    let first = first_of_window(times, expected);
    let recent = || times.iter().skip(first).copied();
    let whole = expected.mul_f64(WHOLE_PERIOD);
    // The usual case: one sender.
    if recent().zip(recent().skip(1)).all(|(one, next)| next.since(one) >= whole) {
        return expected;
    }
    let mut deviations = deviations_of_repeats(times, first, expected);
    let early = deviations.len();
    deviations.retain(|it| it.abs() <= MAX_PERIOD_ERROR);
    let Some(usual) = median(&mut deviations) else { return expected };
    let agreeing = deviations.iter().filter(|it| (*it - usual).abs() <= PERIOD_NOISE).count();
    let is_other = usual.abs() > PERIOD_NOISE && agreeing * 2 > early;
    if is_other { expected.mul_f64(1.0 + usual) } else { expected }
}

/// Returns the place of the first heartbeat of the window in which periods are judged.
fn first_of_window(times: &VecDeque<Instant>, period: Duration) -> usize {
    let Some(&last) = times.back() else { return 0 };
    let window = period * WINDOW_PERIODS;
    times.partition_point(|at| last.since(*at) > window)
}

/// Returns, for each heartbeat from place `first` on that is so early that another one a period after it may
/// have been received, how much the nearest one to that time deviates from it, in periods.
fn deviations_of_repeats(times: &VecDeque<Instant>, first: usize, period: Duration) -> Vec<f64> {
    let Some(&last) = times.back() else { return Vec::new() };
    let longest = period.mul_f64(1.0 + MAX_PERIOD_ERROR);
    let deviation =
        |after: Instant, at: Instant| after.since(at).as_secs_f64() / period.as_secs_f64() - 1.0;
    let early = times.iter().skip(first).take_while(|at| last.since(**at) >= longest).count();
    let mut later = first;
    let nearest = times.iter().skip(first).take(early).map(|&at| {
        // Of ascending times, the nearest one is not before that of the time before.
        let mut nearest = deviation(times[later], at);
        while let Some(&next) = times.get(later + 1)
            && deviation(next, at).abs() <= nearest.abs()
        {
            later += 1;
            nearest = deviation(next, at);
        }
        nearest
    });
    nearest.collect()
}

/// Returns true if most of the last heartbeats are followed by another one after a period, far more exactly
/// than two phases are apart: `contrast`, in periods.
pub(super) fn repeats(times: &VecDeque<Instant>, period: Duration, contrast: f64) -> bool {
    /// Usual deviation from a period, in periods, that one sender with much jitter does not have.
    const EXACT: f64 = 0.02;
    /// The same in mean intervals, for many heartbeats in a period: the nearest one is never far.
    const EXACT_OF_MANY: f64 = 0.075;
    /// The same where two phases are far apart, and least number of it that they are. Chosen: one sender with
    /// jitter has a contrast of up to four by chance.
    const LONGEST: f64 = 0.04;
    const MIN_CONTRAST: f64 = 5.0;
    let Some(&last) = times.back() else { return false };
    let first = first_of_window(times, period);
    let mut deviations = deviations_of_repeats(times, first, period);
    for deviation in &mut deviations {
        *deviation = deviation.abs();
    }
    let passed = last.since(times.get(first).copied().unwrap_or(last));
    let intervals = times.len().saturating_sub(first + 1).max(1) as f64;
    let interval = passed.as_secs_f64() / period.as_secs_f64() / intervals;
    let exact = EXACT.min(EXACT_OF_MANY * interval);
    let is_exact = |usual| usual <= exact || usual <= LONGEST && contrast > MIN_CONTRAST * usual;
    median(&mut deviations).is_some_and(is_exact)
}

/// Returns the heartbeats that recur: of the times one and two periods before and after them, at least half have
/// another one. Those of a sender do, whatever the others do: with 30 % of them lost, eight of a hundred do not.
pub(super) fn recurring(times: &VecDeque<Instant>, period: Duration) -> VecDeque<Instant> {
    /// Deviation from a period, in periods. Chosen: twice the jitter of a busy bus.
    const TOLERANCE: f64 = 2.0 * SAME_PHASE;
    let (Some(&first), Some(&last)) = (times.front(), times.back()) else { return VecDeque::new() };
    let tolerance = period.mul_f64(TOLERANCE);
    let has = |at: Instant| {
        let nearest = times.partition_point(|time| *time < at - tolerance);
        times.get(nearest).is_some_and(|time| *time <= at + tolerance)
    };
    let recurs = |at: &&Instant| {
        let passed = at.since(first);
        let before = [period, period * 2].into_iter().filter(|it| *it <= passed);
        let after = [period, period * 2].into_iter().map(|it| **at + it);
        let others = before.map(|it| **at - it).chain(after.filter(|it| *it <= last));
        let (others, found) = others
            .fold((0, 0), |(others, found), other| (others + 1, found + usize::from(has(other))));
        found * 2 >= others
    };
    times.iter().filter(recurs).copied().collect()
}

/// Returns true if a part of the last heartbeats is all that one sender has in that time: the rest may be
/// besides those of its period.
pub(super) fn is_of_one_sender(
    part: &VecDeque<Instant>,
    all: &VecDeque<Instant>,
    period: Duration,
) -> bool {
    /// Heartbeats in a period. Chosen: 30 % of them may be lost.
    const LEAST: f64 = 0.6;
    let (Some(&last), first) = (all.back(), first_of_window(all, period)) else { return false };
    let Some(&first) = all.get(first) else { return false };
    let begin = part.partition_point(|at| *at < first);
    let count = part.len() - begin;
    let is_early = last_early(part, period).is_some_and(|at| at >= first);
    !is_early && count as f64 >= LEAST * last.since(first).as_secs_f64() / period.as_secs_f64()
}

/// Returns the timing pattern of the last heartbeats, as [`pattern`] does, of the period that they repeat.
/// The number of those `counted` shows several senders whose phases losses hide.
pub(super) fn pattern_with_number(
    times: &VecDeque<Instant>,
    counted: Option<&VecDeque<Instant>>,
    expected: Duration,
    resolution: Duration,
) -> HeartbeatPattern {
    let longest = expected.mul_f64(1.0 + MAX_PERIOD_ERROR);
    // The usual case: one sender, whatever period is repeated. Such intervals show no others.
    let mut pattern = if ends_with_whole_periods(times, longest) {
        let since = times.back().map(|last| *last - expected);
        HeartbeatPattern { since, ..HeartbeatPattern::default() }
    } else {
        pattern(times, repeated_period(times, expected), resolution)
    };
    let Some(counted) = counted.filter(|it| has_surplus(it, longest)) else {
        return pattern;
    };
    let period = repeated_period(counted, expected);
    if is_crowded(counted, period) {
        pattern.two_phases = true;
        pattern.repeats |= repeats(counted, period, 0.0);
        pattern.since = pattern.since.or_else(|| Some(*counted.back()? - expected));
    }
    pattern
}

/// Returns the timing pattern of the last heartbeats, whose times have this resolution.
fn pattern(times: &VecDeque<Instant>, period: Duration, resolution: Duration) -> HeartbeatPattern {
    let Some(&last) = times.back() else { return HeartbeatPattern::default() };
    if is_faster_with_losses(times, period) {
        return HeartbeatPattern::default();
    }
    // Most by which gaps of equal length differ: each is up to a step shorter or longer.
    let rounding = 2.0 * resolution.as_secs_f64() / period.as_secs_f64();
    let recent = times.iter().rev().take(TWO_PHASE_TIMES);
    let recent = recent.filter(|time| last.since(**time) < period * 4);
    // The newest heartbeat must be early, or the double rate has already ended.
    let double_rate = last_early(times, period) == Some(last)
        && recent.count() >= TWO_PHASE_TIMES - 1
        && resolution * MIN_STEPS_OF_RATE <= period
        && !is_faster_sender(times, period, rounding);
    // This many heartbeats show two devices for at least a period.
    let rate =
        HeartbeatPattern { double_rate, since: Some(last - period), ..HeartbeatPattern::default() };
    if times.len() < TWO_PHASE_TIMES - 1 {
        return rate;
    }
    let skipped = times.len().saturating_sub(CYCLE_TIMES);
    let all = times;
    let times = || times.iter().skip(skipped);
    let mut gaps = [0.0; CYCLE_TIMES - 1];
    for (gap, (one, next)) in gaps.iter_mut().zip(times().zip(times().skip(1))) {
        *gap = next.since(*one).as_secs_f64() / period.as_secs_f64();
    }
    let count = times().count();
    let gaps = &gaps[..count - 1];
    let first = |number: usize| count.saturating_sub(number);
    let last_gaps = gaps.len().saturating_sub(TWO_PHASE_TIMES - 1);
    let cycle = cycle_length(gaps, rounding);
    let since = cycle
        .map(|senders| first(2 * senders + 1) + 1)
        .or_else(|| second_sender(&gaps[last_gaps..], rounding).map(|at| last_gaps + at))
        .or_else(|| {
            let begin = gaps.len().checked_sub(HALF_PERIOD_TIMES - 1)?;
            are_half_a_period_apart(&gaps[begin..], rounding).then_some(begin + 1)
        });
    let Some(at) = since else { return rate };
    let apart = if cycle.is_some() { 0.0 } else { phase_contrast(&gaps[last_gaps..]).apart };
    HeartbeatPattern {
        two_phases: true,
        repeats: repeats(all, period, apart),
        since: times().nth(at).copied(),
        ..rate
    }
}

/// Returns true if the last two intervals are whole periods at least.
fn ends_with_whole_periods(times: &VecDeque<Instant>, period: Duration) -> bool {
    let whole = period.mul_f64(WHOLE_PERIOD);
    let newest = || times.iter().rev().copied();
    let mut intervals = newest().zip(newest().skip(1)).take(2).map(|(last, one)| last.since(one));
    times.len() > 2 && intervals.all(|interval| interval >= whole)
}

/// Returns the time of the last heartbeat that came less than a whole period after the one before
/// it. Later ones do not show that two senders are still there.
pub(super) fn last_early(times: &VecDeque<Instant>, period: Duration) -> Option<Instant> {
    let whole = period.mul_f64(WHOLE_PERIOD);
    let is_early = |last: Instant, before| last.since(before) < whole;
    let mut newest = times.iter().rev().zip(times.iter().rev().skip(1));
    newest.find(|(last, before)| is_early(**last, **before)).map(|(last, _)| *last)
}

/// Returns true if more heartbeats arrived in the last periods than one sender has, and one with a
/// shorter period does not explain them. Losses hide the phases, but not the number.
fn is_crowded(times: &VecDeque<Instant>, period: Duration) -> bool {
    has_surplus(times, period)
        && !grid_of(times, period).is_some_and(|grid| grid.may_be_one())
        && !may_have_restarted(times, period)
}

/// Returns true if more heartbeats arrived in the last periods than one sender has.
fn has_surplus(times: &VecDeque<Instant>, period: Duration) -> bool {
    let Some(&last) = times.back() else { return false };
    let has_more = |count: usize, within: Duration| {
        let at = times.len().checked_sub(count + 1);
        at.is_some_and(|at| last.since(times[at]) < within)
    };
    has_more(MAX_OF_ONE, period * WINDOW_PERIODS)
        && has_more(MAX_OF_ONE_AT_END, period.mul_f64(END_PERIODS))
}

/// Returns the usual delay between the heartbeats of a pair, if the last heartbeats are in pairs at most
/// `longest` apart, one pair in each period of one sender, whatever that is: the copies of its heartbeats, or
/// two senders that close. Some heartbeats may be lost.
pub(super) fn delay_of_close_pairs(
    times: &VecDeque<Instant>,
    longest: Duration,
) -> Option<Duration> {
    /// Deviation of the intervals of pairs from multiples of the period, in periods.
    const PAIR_TOLERANCE: f64 = 0.2;
    let skipped = times.len().saturating_sub(CYCLE_TIMES);
    let mut recent = times.iter().skip(skipped).copied();
    let mut first = recent.next()?;
    let (mut delays, mut intervals) = (Vec::new(), Vec::new());
    for at in recent {
        let since = at.since(first);
        if since <= longest {
            delays.push(since);
        } else {
            intervals.push(since.as_secs_f64());
            first = at;
        }
    }
    let delay = median(&mut delays)?;
    let period = median(&mut intervals)?;
    // One of a pair may be lost.
    let tolerance = PAIR_TOLERANCE * period + longest.as_secs_f64();
    let is_other = |interval: &&f64| {
        let whole = (*interval / period).round().max(1.0) * period;
        (*interval - whole).abs() > tolerance.min(period / 4.0)
    };
    // A restart leaves another interval; of two senders farther apart, half of all are others.
    let others = intervals.iter().filter(is_other).count();
    let is_paired = delays.len() * 4 >= intervals.len();
    (is_paired && others * 4 <= intervals.len()).then_some(delay)
}

/// Returns the intervals between the last [`TWO_PHASE_TIMES`], in periods.
fn last_gaps(times: &VecDeque<Instant>, period: Duration) -> impl Iterator<Item = f64> {
    let first = times.len().saturating_sub(TWO_PHASE_TIMES);
    let gaps = times.iter().skip(first).zip(times.iter().skip(first + 1));
    gaps.map(move |(one, next)| next.since(*one).as_secs_f64() / period.as_secs_f64())
}

/// Returns the middle one of these values.
fn median<T: Copy + PartialOrd>(values: &mut [T]) -> Option<T> {
    values.sort_unstable_by(|one, other| one.partial_cmp(other).unwrap_or(Ordering::Equal));
    values.get(values.len() / 2).copied()
}

/// Returns true if one sender that restarts again and again explains the last heartbeats: between restarts
/// they are exactly the expected period apart, and two in turns would have a clearly longer one.
pub(super) fn may_restart_often(times: &VecDeque<Instant>, expected: Duration) -> bool {
    /// Deviation of a whole interval from the expected period, in periods. Chosen: half the least of a
    /// restart.
    const WHOLE_INTERVAL: f64 = 0.015;
    let (mut whole, mut after_restart) = (0, 0);
    for gap in last_gaps(times, expected) {
        match gap {
            _ if (gap - 1.0).abs() <= WHOLE_INTERVAL => whole += 1,
            _ if gap >= 2.0 * WHOLE_INTERVAL => after_restart += 1,
            _ => return false,
        }
    }
    // Some heartbeats between are lost.
    whole * 2 >= after_restart && after_restart > 0
}

/// Returns the time of the last heartbeat in another phase than the newest one, if heartbeats
/// arrived in these two phases alone: two senders, some of whose heartbeats may be lost.
pub(super) fn last_in_other_phase(times: &VecDeque<Instant>, period: Duration) -> Option<Instant> {
    let &newest = times.back()?;
    let window = period.mul_f64(RECURRING_PERIODS);
    let recent = || times.iter().rev().take_while(|at| newest.since(**at) <= window);
    // How far the phases of two heartbeats are apart, in periods.
    let apart = |one: Instant, other: Instant| {
        let periods = one.since(other).as_secs_f64() / period.as_secs_f64();
        (periods - periods.round()).abs()
    };
    let &other = recent().find(|at| apart(newest, **at) > 3.0 * SAME_PHASE)?;
    let in_phase = |of: Instant| {
        let equal = recent().filter(|at| apart(of.max(**at), of.min(**at)) <= SAME_PHASE);
        equal.count()
    };
    let (first, second) = (in_phase(newest), in_phase(other));
    let are_two = first >= 2
        && second >= 2
        && first + second == recent().count()
        && !may_be_one_sender(times, period, REMEMBERED_PERIODS);
    // Heartbeats of one sender are late rather than early.
    let early = last_early(times, period)? + period.mul_f64(EARLY_PERIODS);
    are_two.then_some(other.min(early))
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

/// Returns true if equal intervals show one sender with a shorter period. Only with half of it two
/// senders look the same.
fn is_faster_sender(times: &VecDeque<Instant>, period: Duration, rounding: f64) -> bool {
    let (shortest, longest) = last_gaps(times, period)
        .fold((f64::MAX, 0.0_f64), |(shortest, longest), gap| {
            (shortest.min(gap), longest.max(gap))
        });
    let mean = f64::midpoint(shortest, longest);
    longest - shortest < 0.15 * longest + rounding && !(0.4..=0.6).contains(&mean)
}

/// Returns the place of the first heartbeat after which both of two senders are present; `None` if
/// the gaps do not show two. `rounding`: most by which gaps of equal length differ because times are
/// in steps.
fn second_sender(gaps: &[f64], rounding: f64) -> Option<usize> {
    let count = gaps.len();
    let full_period = gaps.windows(2).all(|two| (0.85..=1.15).contains(&(two[0] + two[1])));
    let apart = gaps.windows(2).all(|two| (two[0] - two[1]).abs() > 0.15 + rounding);
    // If one of the two stopped, the newest gap is a full period.
    let continues = (gaps[count - 1] - gaps[count - 3]).abs() < 0.1 + rounding;
    if !(full_period && continues && (apart || has_two_phases(gaps, rounding))) {
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
fn has_two_phases(gaps: &[f64], rounding: f64) -> bool {
    let PhaseContrast { apart, noise } = phase_contrast(gaps);
    apart > MIN_PHASE_CONTRAST + rounding && apart > 3.0 * noise
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
fn are_half_a_period_apart(gaps: &[f64], rounding: f64) -> bool {
    /// Smallest difference, in periods, that the timer tick of one sender does not explain.
    const MIN_CONTRAST: f64 = 0.012;
    /// Rounding from which on gaps that differ by as much show two senders if each of both is always the
    /// same: the times of one sender are rounded up and down in turns only while its clock drifts
    /// over the end of a step, and that by chance.
    const LONG_ROUNDING: f64 = 0.1;
    let full_period = gaps.windows(2).all(|two| (0.95..=1.05).contains(&(two[0] + two[1])));
    let contrast = phase_contrast(gaps);
    let is_constant = rounding >= LONG_ROUNDING && contrast.noise < f64::EPSILON;
    let least = if is_constant { rounding - MIN_CONTRAST } else { rounding + MIN_CONTRAST };
    full_period && contrast.apart > least && contrast.apart > 6.0 * contrast.noise
}

/// Returns the period of two senders, if it is not the expected one, and a short and a long gap alternate
/// for so long, and so regularly, that losses of one sender do not explain it.
pub(super) fn alternating_period(
    times: &VecDeque<Instant>,
    expected: Duration,
) -> Option<Duration> {
    /// Part of both gaps together that the short one is. Chosen: clearly less than that of one sender
    /// whose times are in steps, of which the gaps take one more or less: half the long one at least.
    const SHORT_GAP: RangeInclusive<f64> = 0.005..=0.31;
    /// Gap, in expected periods, between two heartbeats of one sender that restarts in the other gap.
    const ONE_SENDER: RangeInclusive<f64> = 0.93..=1.07;
    /// Period, in expected ones, that is the expected one. Chosen: those rules tolerate as much.
    const EXPECTED: RangeInclusive<f64> = 0.96..=1.04;
    let first = times.len().checked_sub(HALF_PERIOD_TIMES)?;
    let mut gaps = [0.0; HALF_PERIOD_TIMES - 1];
    let pairs = || times.iter().skip(first).zip(times.iter().skip(first + 1));
    let seconds = |(one, next): (&Instant, &Instant)| next.since(*one).as_secs_f64();
    let [one, other] = [0, 1].map(|at| pairs().nth(at).map_or(0.0, seconds));
    // The usual case: equal gaps.
    if !SHORT_GAP.contains(&(one.min(other) / (one + other))) {
        return None;
    }
    for (gap, pair) in gaps.iter_mut().zip(pairs()) {
        *gap = seconds(pair);
    }
    let PhaseContrast { apart, noise } = phase_contrast(&gaps);
    let is_of_one = |gap: &f64| ONE_SENDER.contains(&(gap / expected.as_secs_f64()));
    let period = 2.0 * gaps.iter().sum::<f64>() / gaps.len() as f64;
    let are_two = apart > 6.0 * noise
        && !gaps.iter().any(is_of_one)
        // Else the other rules say more.
        && !EXPECTED.contains(&(period / expected.as_secs_f64()));
    are_two.then(|| Duration::from_secs(1).mul_f64(period))
}

/// Returns the number of senders, three or more, whose phases the last gaps repeat.
fn cycle_length(gaps: &[f64], rounding: f64) -> Option<usize> {
    // Two cycles of three senders are the fewest: six gaps in two periods.
    let six = gaps.len().checked_sub(6)?;
    if gaps[six..].iter().sum::<f64>() > 2.2 {
        return None;
    }
    let mut senders = (3..=MAX_PHASES).take_while(|senders| 2 * senders <= gaps.len());
    senders.find(|&senders| is_cycle(&gaps[gaps.len() - 2 * senders..], senders, rounding))
}

/// Returns true if gaps repeat in a cycle of `senders` gaps and differ within it: that many steady
/// senders. One sender with a shorter period has equal gaps.
fn is_cycle(gaps: &[f64], senders: usize, rounding: f64) -> bool {
    let is_period = |cycle: &[f64]| (0.9..=1.1).contains(&cycle.iter().sum());
    let repeats = gaps.iter().zip(&gaps[senders..]).map(|(gap, next)| (gap - next).abs());
    let noise = repeats.fold(0.0, f64::max);
    let longest = gaps.iter().copied().fold(0.0, f64::max);
    let shortest = gaps.iter().copied().fold(f64::MAX, f64::min);
    let contrast = longest - shortest;
    gaps.windows(senders).all(is_period)
        && contrast > MIN_PHASE_CONTRAST + rounding
        && contrast > 3.0 * noise
}
