//! Heartbeats of a device as cells, one for each heartbeat period: on time, early or late, two in
//! one period, missed.
//!
//! Inputs: heartbeats, the period, the moment shown. Output: cells and their statistics. The cells
//! of a device that sends on time are equal, so they do not change while time passes. Does not know
//! how cells are drawn.

use super::capture::CapturedHeartbeat;
use crate::time::{Duration, Instant};
use crate::wire::node::Mode;

/// What a cell shows of its heartbeat period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeatKind {
    /// A heartbeat within 10 % of the period.
    OnTime,
    /// A heartbeat that was early or late.
    OffTime,
    /// Two heartbeats or more.
    Double,
    /// No heartbeat.
    Missed,
    /// Not known: not captured, before the first heartbeat, or while none is expected.
    Unknown,
}

/// One heartbeat period of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// What is shown.
    pub kind: BeatKind,
    /// Time of the heartbeat, or when it was expected.
    pub time: Instant,
    /// Number of its frame in the capture; `None` for a miss.
    pub number: Option<u64>,
    /// Time since the heartbeat before; `None` for the first one and for a miss.
    pub gap: Option<Duration>,
    /// Mode; `None` if the heartbeat has none.
    pub mode: Option<Mode>,
}

/// Statistics of the heartbeats of some cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BeatStats {
    /// Number of cells with a heartbeat.
    pub count: usize,
    /// Number of cells without one.
    pub missed: usize,
    /// Shortest and longest time between two heartbeats without a miss between them.
    pub range: Option<(Duration, Duration)>,
    /// Mean of these times.
    pub period: Option<Duration>,
    /// Deviation from it that 95 % of them do not exceed.
    pub jitter: Option<Duration>,
}

/// Deviation from the period within which a heartbeat is on time, as a fraction. As of the detector
/// of late heartbeats.
const ON_TIME: f64 = 0.1;
/// Interval in periods below which two heartbeats are in one period.
const DOUBLE: f64 = 0.5;
/// Interval in periods above which a heartbeat is missed, as in the engine.
const MISSED: f64 = 1.4;
/// Periods over which a heartbeat in the phase of an earlier one is on time: after a late one the
/// next is early, though its sender is on time.
const PHASE_PERIODS: f64 = 3.0;

/// Returns the last cells, oldest first, at most `most`. `beats` are the heartbeats, newest first.
/// From the last heartbeat to `end` cells are of the kind `after`: [`BeatKind::Missed`], or
/// [`BeatKind::Unknown`] where no heartbeat is expected.
pub fn beat_cells(
    beats: impl Iterator<Item = CapturedHeartbeat>,
    period: Duration,
    end: Instant,
    after: BeatKind,
    most: usize,
) -> Vec<Beat> {
    let period_seconds = period.as_secs_f64().max(1e-6);
    // The one before the first cell tells how late that is; two may share a cell.
    let mut beats: Vec<CapturedHeartbeat> = beats.take(most * 2 + 2).collect();
    beats.reverse();
    let mut cells: Vec<Beat> = Vec::with_capacity(most);
    let mut phase = beats.first().map_or(end, |beat| beat.time);
    let mut last: Option<Instant> = None;
    for beat in &beats {
        let number = Some(beat.number);
        let cell = |kind, gap| Beat { kind, time: beat.time, number, gap, mode: beat.mode };
        let Some(before) = last else {
            cells.push(cell(BeatKind::OnTime, None));
            last = Some(beat.time);
            continue;
        };
        let gap = beat.time.since(before);
        let passed = gap.as_secs_f64() / period_seconds;
        if passed < DOUBLE {
            if let Some(cell) = cells.last_mut() {
                cell.kind = BeatKind::Double;
            }
            continue;
        }
        let missed = missed_periods(passed);
        push_missed(&mut cells, before, period, missed, BeatKind::Missed, most);
        let since_phase = beat.time.since(phase).as_secs_f64() / period_seconds;
        let is_in_phase = since_phase <= PHASE_PERIODS + ON_TIME && is_whole(since_phase);
        let kind = if is_whole(passed) || is_in_phase {
            phase = beat.time;
            BeatKind::OnTime
        } else {
            BeatKind::OffTime
        };
        cells.push(cell(kind, (missed == 0).then_some(gap)));
        last = Some(beat.time);
    }
    if let Some(last) = last {
        let missed = missed_periods(end.since(last).as_secs_f64() / period_seconds);
        push_missed(&mut cells, last, period, missed, after, most);
    }
    cells.drain(..cells.len().saturating_sub(most));
    cells
}

/// Returns the number of missed heartbeats in an interval of so many periods.
fn missed_periods(periods: f64) -> usize {
    if periods <= MISSED { 0 } else { (periods - MISSED) as usize + 1 }
}

/// Returns true if an interval is a whole number of periods, at least one.
fn is_whole(periods: f64) -> bool {
    let whole = periods.round().max(1.0);
    (periods - whole).abs() <= ON_TIME
}

/// Appends the cells of the misses since `from`, only the last ones of more than `most`.
fn push_missed(
    cells: &mut Vec<Beat>,
    from: Instant,
    period: Duration,
    count: usize,
    kind: BeatKind,
    most: usize,
) {
    for at in count.saturating_sub(most)..count {
        let time = from + period.mul_f64(at as f64 + 1.0);
        cells.push(Beat { kind, time, number: None, gap: None, mode: None });
    }
}

impl BeatStats {
    /// Returns the statistics of cells.
    pub fn of(cells: &[Beat]) -> Self {
        let mut gaps: Vec<Duration> = cells.iter().filter_map(|cell| cell.gap).collect();
        gaps.sort_unstable();
        let mut stats = Self {
            count: cells.iter().filter(|cell| cell.number.is_some()).count(),
            missed: cells.iter().filter(|cell| cell.kind == BeatKind::Missed).count(),
            range: gaps.first().copied().zip(gaps.last().copied()),
            ..Self::default()
        };
        if gaps.is_empty() {
            return stats;
        }
        let sum: u128 = gaps.iter().map(Duration::as_micros).sum();
        let mean = (sum / gaps.len() as u128) as u64;
        stats.period = Some(Duration::from_micros(mean));
        let mut off: Vec<u64> =
            gaps.iter().map(|gap| (gap.as_micros() as u64).abs_diff(mean)).collect();
        off.sort_unstable();
        stats.jitter =
            off.get((off.len() * 95 / 100).min(off.len() - 1)).copied().map(Duration::from_micros);
        stats
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_secs(1);

    fn at(millis: u64) -> Instant {
        Instant::from_micros(millis * 1000)
    }

    /// Draws the cells of heartbeats at these milliseconds.
    fn strip(times: &[u64], end: u64, most: usize) -> String {
        let beats = times.iter().enumerate().rev().map(|(number, time)| CapturedHeartbeat {
            number: number as u64,
            time: at(*time),
            uid: None,
            mode: None,
            is_working: true,
        });
        let cells = beat_cells(beats, PERIOD, at(end), BeatKind::Missed, most);
        assert!(cells.is_sorted_by_key(|cell| cell.time), "{cells:?}");
        cells
            .iter()
            .map(|cell| match cell.kind {
                BeatKind::OnTime => '▂',
                BeatKind::OffTime => '▅',
                BeatKind::Double => '█',
                BeatKind::Missed => '×',
                BeatKind::Unknown => '·',
            })
            .collect()
    }

    #[test]
    fn strip_shows_late_missed_and_double_heartbeats() {
        for (times, end, expected) in [
            (&[0, 1000, 2000, 3000][..], 3900, "▂▂▂▂"),
            (&[0, 1000, 2090, 3080], 3900, "▂▂▂▂"),
            (&[0, 1000, 2140, 3000, 4000], 4900, "▂▂▅▂▂"),
            (&[0, 1000, 1800, 2800], 3000, "▂▂▅▂"),
            (&[0, 1000, 4000, 5000], 5900, "▂▂××▂▂"),
            (&[0, 1000, 1300, 2000, 2300, 3000], 3900, "▂██▂"),
            (&[0, 1000], 3900, "▂▂××"),
            (&[0, 1000], 1_000_000, "××××××"),
            (&[0, 1000], 2399, "▂▂"),
            (&[], 5000, ""),
        ] {
            assert_eq!(strip(times, end, 6), expected, "{times:?} until {end}");
        }
    }

    #[test]
    fn regular_strip_does_not_change_while_it_moves_on() {
        let times: Vec<u64> = (0..200).map(|at| at * 1004 + at % 7).collect();
        for count in 20..200 {
            let end = times[count - 1];
            for late in [0, 500, 1000] {
                assert_eq!(strip(&times[..count], end + late, 10), "▂".repeat(10));
            }
        }
    }

    #[test]
    fn statistics_leave_gaps_out() {
        let beats = [5000, 4000, 1010, 0].into_iter().map(|time| CapturedHeartbeat {
            number: time,
            time: at(time),
            uid: None,
            mode: None,
            is_working: true,
        });
        let cells = beat_cells(beats, PERIOD, at(5100), BeatKind::Missed, 10);
        let stats = BeatStats::of(&cells);
        assert_eq!((stats.count, stats.missed), (4, 2));
        let millis = |millis| Duration::from_millis(millis);
        assert_eq!(stats.range, Some((millis(1000), millis(1010))));
        assert_eq!(stats.period, Some(millis(1005)));
    }
}
