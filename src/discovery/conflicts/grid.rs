//! Grid of heartbeat times: distinguishes one sender with a shorter period than expected from several
//! senders, although some of its heartbeats are lost or late.

use crate::time::{Duration, Instant};
use std::collections::VecDeque;

/// Heartbeats that show two phases: seven intervals, three periods and a half of two senders.
pub(super) const TWO_PHASE_TIMES: usize = 8;
/// Periods of the heartbeats that are counted.
pub(super) const WINDOW_PERIODS: u32 = 8;
/// Smallest difference, in periods, between the intervals of two senders. Chosen: twice the jitter
/// of a quiet bus.
pub(super) const MIN_PHASE_CONTRAST: f64 = 0.04;
/// Deviation of heartbeats of one sender from its phase, in periods. Chosen: jitter of a busy bus;
/// a third of what other phases are apart.
pub(super) const SAME_PHASE: f64 = 0.03;
/// Shortest period of one sender, in expected periods, that is distinguished from several senders
/// although heartbeats are lost. Chosen: a tenth, and its jitter.
const MIN_FASTER_PERIOD: f64 = 0.08;
/// Deviation of an interval from a multiple of the period, in periods, by the jitter of a busy bus.
/// As that of a measured period.
const GRID_TOLERANCE: f64 = 0.15;
/// Periods in which a faster sender has a heartbeat in all parts of the period but one, and in all:
/// with 40 % of the heartbeats lost, a part is empty for as long once in 97 and in 610 cases.
/// Several senders have them in the same parts each time.
const PERIODS_OF_MOST_PARTS: f64 = 5.0;
const PERIODS_OF_ALL_PARTS: f64 = 7.0;
/// Deviation, in periods, of a heartbeat from the one of the same sender one period before: the
/// jitter of a quiet bus.
const REPEAT_TOLERANCE: f64 = 0.012;
/// Deviation of heartbeats that are in time, in steps: the jitter of a quiet bus.
const IN_TIME: f64 = 0.05;
/// Changes between heartbeats in time and others that show senders in turns: more than of two late
/// heartbeats.
const MIN_TURNS: usize = 5;
/// Longest step, in periods, at which heartbeats in time show one sender: of two or three senders,
/// all may be in equal parts by chance.
const MAX_EXACT_STEP: f64 = 0.3;
/// Number of heartbeats that may deviate more, or a quarter of them: those that waited on a busy bus.
const MAX_LATE_COUNT: usize = 2;
/// Longest time, in steps, by which they are late: with a shorter one, lost heartbeats are counted
/// better. Chosen: half, and clearly before the next one is due.
const MAX_LATENESS: [f64; 2] = [0.5, 0.75];
/// The same for a heartbeat that comes just before the next one.
const LONGEST_LATENESS: f64 = 0.97;
/// Number of intervals from which on some heartbeats may be late. Chosen: fewer do not show a step.
const MIN_GAPS_WITH_LATE: usize = 8;
/// Intervals that show two senders although heartbeats are lost between them: as many as without
/// losses.
const MIN_ALTERNATING_GAPS: usize = TWO_PHASE_TIMES - 1;
/// Last intervals without a lost heartbeat that show several senders: with 30 % of the heartbeats
/// lost, ten in a row are received in 3 % of the cases. Longer ones before may be of one sender alone.
const MAX_GAPS_WITHOUT_LOSS: usize = 10;

/// Restarts in [`WINDOW_PERIODS`] after which heartbeats may be those of one sender. Chosen: a board whose
/// plug bounces; several senders have more intervals that are no multiples.
const MAX_RESTARTS: usize = 3;
/// Periods of a run between restarts that shows several senders by the parts of the period. Chosen: two.
const MIN_RUN_PERIODS: f64 = 2.0;

/// A sender with a shorter period than expected, some of whose heartbeats may be lost.
pub(super) struct FasterSender {
    /// Number of its periods in an expected one; `None` if that is not a whole number.
    pub parts: Option<u32>,
    /// True if heartbeats arrived in each of three parts, or in as many of more as losses leave:
    /// those of several senders leave more of them empty.
    pub has_most_parts: bool,
    /// True if some of the last intervals are several of its periods.
    pub has_losses: bool,
    /// True if every other of its heartbeats is late by the same time: two senders.
    pub alternates: bool,
}

impl FasterSender {
    /// Returns true if the heartbeats may be those of one sender, although several look similar.
    pub fn may_be_one(&self) -> bool {
        match self.parts {
            None => true,
            // Two senders half a period apart look like one.
            Some(2) => !self.alternates,
            Some(_) => self.has_most_parts,
        }
    }
}

/// Returns true if one sender with a shorter period, which restarted or was replaced a few times,
/// explains the heartbeats of the last periods: between these times all intervals are multiples of
/// the same period.
pub(super) fn may_have_restarted(times: &VecDeque<Instant>, period: Duration) -> bool {
    let gaps: Vec<f64> = gaps_within(times, period, f64::from(WINDOW_PERIODS)).collect();
    let mut ascending = gaps.clone();
    ascending.sort_unstable_by(f64::total_cmp);
    let Some(&step) = ascending.get(gaps.len().saturating_sub(1) / 2) else { return false };
    if step < MIN_FASTER_PERIOD {
        return false;
    }
    let is_restart = |gap: &f64| {
        let steps = (gap / step).round();
        steps < 1.0 || (gap / step - steps).abs() > GRID_TOLERANCE
    };
    let is_one = |run: &[f64]| {
        let whole: f64 = run.iter().sum();
        let steps: f64 = run.iter().map(|gap| (gap / step).round()).sum();
        // Of a short run the parts of the period say nothing.
        whole < MIN_RUN_PERIODS || grid_with(|| run.iter().copied(), whole / steps).may_be_one()
    };
    gaps.iter().filter(|gap| is_restart(gap)).count() <= MAX_RESTARTS
        && gaps.split(is_restart).all(is_one)
}

/// Returns the sender of whose period all intervals in the last periods are multiples.
pub(super) fn grid_of(times: &VecDeque<Instant>, period: Duration) -> Option<FasterSender> {
    let gaps = || gaps_within(times, period, f64::from(WINDOW_PERIODS));
    let shortest = gaps().fold(f64::MAX, f64::min);
    if shortest > 1.0 - GRID_TOLERANCE {
        return None;
    }
    if shortest < MIN_FASTER_PERIOD {
        let late = longer_step_with_late(&gaps().collect::<Vec<f64>>(), shortest)?;
        return Some(grid_with(gaps, late));
    }
    if let Some(step) = regular_step(gaps, shortest, GRID_TOLERANCE) {
        let grid = grid_with(gaps, step);
        if grid.parts.is_none_or(|parts| parts <= 2) || grid.has_most_parts {
            return Some(grid);
        }
        // The shortest gap may be the one after a heartbeat that is late by a part of the step.
        let late = longer_step_with_late(&gaps().collect::<Vec<f64>>(), step);
        return Some(late.map_or(grid, |step| grid_with(gaps, step)));
    }
    let all: Vec<f64> = gaps().collect();
    let mut grids = steps_with_late(&all).map(|step| grid_with(gaps, step));
    let first = grids.next()?;
    // Late heartbeats may also fit a part of the step, most of whose parts are empty.
    let other = if first.may_be_one() { None } else { grids.find(FasterSender::may_be_one) };
    Some(other.unwrap_or(first))
}

/// Returns the sender with this step between the gaps.
fn grid_with<I: Iterator<Item = f64>>(gaps: impl Fn() -> I, step: f64) -> FasterSender {
    let parts = 1.0 / step;
    let whole = parts.round();
    // Long gaps alone at the beginning are those of one sender before the second one.
    let is_long = |gap: f64| (gap / step).round() > 1.0;
    let first_short = gaps().enumerate().filter(|(_, gap)| !is_long(*gap)).last();
    let since_first = first_short.map_or(0, |(count, _)| count);
    let has_losses = gaps().take(MAX_GAPS_WITHOUT_LOSS.min(since_first)).any(is_long);
    if (parts - whole).abs() > GRID_TOLERANCE {
        return FasterSender { parts: None, has_most_parts: false, has_losses, alternates: false };
    }
    let whole = whole as u32;
    let empty = empty_parts(gaps(), step, whole);
    let has_most_parts = match gaps().sum::<f64>() {
        _ if whole <= 3 => empty == 0,
        periods if periods >= PERIODS_OF_ALL_PARTS => empty == 0,
        periods if periods >= PERIODS_OF_MOST_PARTS => empty <= 1,
        _ => empty * 2 < whole,
    };
    let alternates = whole == 2 && alternates(gaps(), step);
    FasterSender { parts: Some(whole), has_most_parts, has_losses, alternates }
}

/// Returns true if the intervals of the last `periods` are those of one sender with a shorter period,
/// or as well of two senders half a period apart.
pub(super) fn may_be_one_sender(times: &VecDeque<Instant>, period: Duration, periods: f64) -> bool {
    let gaps = || gaps_within(times, period, periods);
    let shortest = gaps().fold(f64::MAX, f64::min);
    if !(MIN_FASTER_PERIOD..=1.0 - GRID_TOLERANCE).contains(&shortest) {
        return false;
    }
    regular_step(gaps, shortest, SAME_PHASE / shortest).is_some_and(|step| {
        let whole = (1.0 / step).round();
        (1.0 / step - whole).abs() > GRID_TOLERANCE || empty_parts(gaps(), step, whole as u32) == 0
    })
}

/// Returns the intervals of the last `periods`, in periods, the newest one first.
fn gaps_within(
    times: &VecDeque<Instant>,
    period: Duration,
    periods: f64,
) -> impl Iterator<Item = f64> {
    let last = times.back().copied().unwrap_or(Instant::ZERO);
    let window = period.mul_f64(periods);
    let recent = move || times.iter().rev().take_while(move |at| last.since(**at) < window);
    let pairs = recent().zip(recent().skip(1));
    pairs.map(move |(next, one)| next.since(*one).as_secs_f64() / period.as_secs_f64())
}

/// Returns the step, about `shortest`, of which all gaps are multiples.
fn regular_step<I: Iterator<Item = f64>>(
    gaps: impl Fn() -> I,
    shortest: f64,
    tolerance: f64,
) -> Option<f64> {
    let steps: f64 = gaps().map(|gap| (gap / shortest).round()).sum();
    let step = gaps().sum::<f64>() / steps;
    gaps().all(|gap| (gap / step - (gap / step).round()).abs() <= tolerance).then_some(step)
}

/// Returns the number of the `whole` parts of a period in which no heartbeat arrived.
fn empty_parts(gaps: impl Iterator<Item = f64>, step: f64, whole: u32) -> u32 {
    let (mut at, mut hit) = (0.0_f64, 1_u32);
    for gap in gaps {
        at += gap / step;
        hit |= 1 << (at.round() as u32 % whole);
    }
    whole.saturating_sub(hit.count_ones())
}

/// Returns the steps of which all gaps are multiples, but for a few heartbeats that are late. The
/// newest gap comes first.
fn steps_with_late(gaps: &[f64]) -> impl Iterator<Item = f64> {
    let mut ascending = gaps.to_vec();
    ascending.sort_unstable_by(f64::total_cmp);
    // A late heartbeat may leave a gap much shorter than a step, and lost ones longer ones.
    let shorter = ascending.partition_point(|gap| *gap < 1.5 * ascending[0]);
    let middle = |count: usize| ascending.get(count.saturating_sub(1) / 2).copied();
    let steps = [middle(shorter), middle(ascending.len())].into_iter().flatten();
    let steps: Vec<f64> = steps.filter(|_| gaps.len() >= MIN_GAPS_WITH_LATE).collect();
    let numberings = steps.into_iter().flat_map(|step| MAX_LATENESS.map(|late| (step, late)));
    numberings.filter_map(|(step, late)| step_of(&numbered_times(gaps, step, late)))
}

/// Returns a step much longer than `step`, which fits all gaps, if it explains them with a few heartbeats
/// that are late: the median gap. The newest gap comes first.
fn longer_step_with_late(gaps: &[f64], step: f64) -> Option<f64> {
    if gaps.len() < MIN_GAPS_WITH_LATE {
        return None;
    }
    let mut ascending = gaps.to_vec();
    ascending.sort_unstable_by(f64::total_cmp);
    let median = ascending[(ascending.len() - 1) / 2];
    if median < MIN_FASTER_PERIOD {
        return None;
    }
    let latenesses = MAX_LATENESS.into_iter().chain([LONGEST_LATENESS]);
    let mut numberings = latenesses.map(|late| numbered_times(gaps, median, late));
    let exact = |times: Vec<NumberedTime>| {
        let all = slope(&times);
        let phases = ascending_phases(&times, all);
        let first = cluster(&phases, GRID_TOLERANCE)?.first;
        let is_in_time =
            |it: &&NumberedTime| (first..=first + 2.0 * GRID_TOLERANCE).contains(&it.phase(all));
        // Late ones would change the step.
        let in_time: Vec<NumberedTime> = times.iter().filter(is_in_time).copied().collect();
        if in_time.len() + MAX_LATE_COUNT < times.len() {
            return None;
        }
        let step = slope(&in_time);
        let late = times.len() - cluster(&ascending_phases(&times, step), IN_TIME)?.count;
        (late <= MAX_LATE_COUNT).then_some(step)
    };
    numberings.find_map(exact).filter(|longer| *longer > MIN_FASTER_PERIOD && *longer > 1.5 * step)
}

/// Returns the deviations of heartbeats from their numbers, in steps, ascending.
fn ascending_phases(times: &[NumberedTime], step: f64) -> Vec<f64> {
    let mut phases: Vec<f64> = times.iter().map(|it| it.phase(step)).collect();
    phases.sort_unstable_by(f64::total_cmp);
    phases
}

/// Returns the step of heartbeats with these numbers, if all but a few are in time.
fn step_of(times: &[NumberedTime]) -> Option<f64> {
    let step = slope(times);
    let phases = ascending_phases(times, step);
    let late = phases.len() - cluster(&phases, GRID_TOLERANCE)?.count;
    let in_time = cluster(&phases, IN_TIME)?;
    // As many independent senders are not in equal parts of the period by chance.
    let is_exact = step < MAX_EXACT_STEP && in_time.count * 3 >= phases.len() * 2;
    let is_one = late <= MAX_LATE_COUNT.max((times.len() - 1) / 4)
        && (is_exact || !is_late_in_each_period(times, step, in_time.first));
    is_one.then_some(step)
}

/// A heartbeat: its number in steps and its time in periods, both counted back from the newest one.
#[derive(Clone, Copy)]
struct NumberedTime {
    number: f64,
    at: f64,
}

impl NumberedTime {
    /// Returns the deviation from its number, in steps.
    fn phase(self, step: f64) -> f64 {
        self.at / step - self.number
    }
}

/// Numbers the heartbeats between the gaps in steps. A heartbeat may be late by `max_lateness` steps, and
/// the gap after it is shorter then.
fn numbered_times(gaps: &[f64], step: f64, max_lateness: f64) -> Vec<NumberedTime> {
    let mut late = 0.0;
    let steps = gaps.iter().rev().map(|gap| {
        let passed = gap / step + late;
        let steps = (passed + 1.0 - max_lateness).floor().max(1.0);
        late = if passed - steps > GRID_TOLERANCE { passed - steps } else { 0.0 };
        steps
    });
    let steps: Vec<f64> = steps.collect();
    let newest = NumberedTime { number: 0.0, at: 0.0 };
    let others = gaps.iter().zip(steps.iter().rev()).scan(newest, |time, (gap, steps)| {
        time.number += steps;
        time.at += gap;
        Some(*time)
    });
    std::iter::once(newest).chain(others).collect()
}

/// Returns the time of one step by the least squares.
fn slope(times: &[NumberedTime]) -> f64 {
    let count = times.len() as f64;
    let number = times.iter().map(|it| it.number / count).sum::<f64>();
    let at = times.iter().map(|it| it.at / count).sum::<f64>();
    let products = times.iter().map(|it| (it.number - number) * (it.at - at));
    let squares = times.iter().map(|it| (it.number - number).powi(2));
    products.sum::<f64>() / squares.sum::<f64>()
}

/// Phases that are together within a tolerance.
struct Cluster {
    count: usize,
    first: f64,
}

/// Returns the largest cluster of ascending phases.
fn cluster(phases: &[f64], tolerance: f64) -> Option<Cluster> {
    let end = |first: f64| phases.partition_point(|phase| *phase <= first + 2.0 * tolerance);
    let clusters = phases.iter().enumerate();
    let clusters = clusters.map(|(at, first)| Cluster { count: end(*first) - at, first: *first });
    clusters.max_by_key(|cluster| cluster.count)
}

/// Returns true if heartbeats that are not in time, from phase `in_time` on, are late in turns and by
/// the same time in each period, as those of several senders. One sender whose phase changed is late
/// for a while.
fn is_late_in_each_period(times: &[NumberedTime], step: f64, in_time: f64) -> bool {
    let deviation = |at: f64| {
        let next = times.partition_point(|before| before.at - at < 1.0 - step / 2.0);
        let near = times[next..].iter().map(|before| (before.at - at - 1.0).abs());
        near.take(2).fold(f64::MAX, f64::min)
    };
    let is_in_time =
        |it: &NumberedTime| (in_time..=in_time + 2.0 * IN_TIME).contains(&it.phase(step));
    let turns = times.windows(2).filter(|two| is_in_time(&two[0]) != is_in_time(&two[1])).count();
    let (mut repeated, mut all) = (0, 0);
    for it in times.iter().filter(|it| !is_in_time(it)) {
        let deviation = deviation(it.at);
        if deviation < step / 2.0 {
            all += 1;
            repeated += u32::from(deviation <= REPEAT_TOLERANCE);
        }
    }
    turns >= MIN_TURNS && repeated * 4 > all * 3
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
