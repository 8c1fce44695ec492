//! The common period of frames, from intervals of which some are several periods long, because frames
//! were lost.

use crate::learning::unsolicited::UnsolicitedSender;

/// Most periods of an interval.
const MAX_PERIODS: f64 = 8.0;
/// Deviation of an interval, as part of the period.
const TOLERANCE: f64 = 0.1;
/// Smallest part of the intervals that are a multiple of the period.
const MIN_FITTING: f64 = 0.75;
/// The same for one sender: after a restart its heartbeats come at other moments.
const MIN_FITTING_OF_ONE: f64 = 0.6;
/// Smallest part of the intervals that are one period, and their smallest number. With 30 % of the
/// frames lost 70 % are.
const MIN_SINGLE: f64 = 0.25;
const MIN_SINGLES: usize = 3;
/// Intervals of all senders: of few of them, every second frame may have been lost.
const MIN_INTERVALS: usize = 8;
/// Intervals that are compared, at most: the search is quadratic.
const MAX_COMPARED: usize = 96;
/// Largest error of a period that is proposed, as part of it, and of its rounding.
const MAX_ERROR: f64 = 0.013;
const MAX_ROUNDING: f64 = 0.007;
/// Deviation of clocks that cannot be distinguished from rounding, as part of the period: 200 ppm, more than that
/// of a crystal.
const CLOCK_TOLERANCE: f64 = 0.000_2;

/// Deviation of an interval that is none, as part of the period.
const SAME: f64 = 0.001;

/// A period, in microseconds, and the bounds between which it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Period {
    pub micros: f64,
    pub low: f64,
    pub high: f64,
    /// Intervals that show it.
    pub intervals: usize,
}

impl Period {
    /// Finds the period of most intervals of all senders; `None` if there is none.
    pub fn find(senders: &[&UnsolicitedSender]) -> Option<Self> {
        let mut all: Vec<f64> = Vec::new();
        // The same number of each sender: one with a long history must not decide alone.
        let each = (MAX_COMPARED / senders.len().max(1)).max(4);
        for sender in senders {
            all.extend(sender.intervals.iter().rev().take(each).map(|it| f64::from(*it)));
        }
        all.truncate(MAX_COMPARED);
        if all.len() < MIN_INTERVALS {
            return None;
        }
        let candidates = all.iter().copied().filter(|it| *it > 0.0);
        let rated = candidates.filter_map(|candidate| {
            let fit = Fit::of(&all, candidate);
            let is_common = fit.singles >= MIN_SINGLES
                && fit.singles as f64 >= MIN_SINGLE * all.len() as f64
                && fit.fitting as f64 >= MIN_FITTING * all.len() as f64;
            is_common.then_some((fit.fitting, fit.singles, fit.mean))
        });
        let (.., mean) = rated.max_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)))?;
        let each: Vec<Fit> = senders.iter().filter_map(|it| Self::of_sender(it, mean)).collect();
        let intervals = each.iter().map(|fit| fit.fitting).sum();
        // Delays of heartbeats differ from node to node: the most regular ones decide.
        let weight = |fit: &Fit| 1.0 / (fit.error * fit.error);
        let sum: f64 = each.iter().map(|fit| fit.mean * weight(fit)).sum();
        let micros = sum / each.iter().map(weight).sum::<f64>();
        let error = each.iter().map(|fit| fit.error).fold(f64::INFINITY, f64::min);
        let error = error + micros * CLOCK_TOLERANCE;
        let (low, high) = (micros - error, micros + error);
        (intervals > 0).then_some(Self { micros, low, high, intervals })
    }

    fn of_sender(sender: &UnsolicitedSender, period: f64) -> Option<Fit> {
        let intervals: Vec<f64> = sender.intervals.iter().map(|it| f64::from(*it)).collect();
        let fit = Fit::of(&intervals, period);
        let is_its = fit.fitting as f64 >= MIN_FITTING_OF_ONE * intervals.len() as f64;
        (is_its && fit.fitting > 0).then_some(fit)
    }

    /// Returns true if its error is small enough for a proposal.
    pub fn is_exact(&self) -> bool {
        self.high - self.low <= 2.0 * MAX_ERROR * self.micros
    }

    /// Returns true if the frames of a sender come in this period.
    pub fn is_of(&self, sender: &UnsolicitedSender) -> bool {
        Self::of_sender(sender, self.micros).is_some()
    }

    /// The roundest number of milliseconds between the bounds, else the nearest one.
    pub fn millis(&self) -> u32 {
        let middle = self.micros / 1000.0;
        let steps = [1000.0, 500.0, 100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0];
        let nearest = |step: f64| (middle / step).round() * step;
        let is_between = |millis: &f64| {
            let micros = *millis * 1000.0;
            *millis > 0.0
                && (self.low..=self.high).contains(&micros)
                && (micros - self.micros).abs() <= MAX_ROUNDING * self.micros
        };
        let round = steps.into_iter().map(nearest).find(is_between);
        round.unwrap_or_else(|| middle.round()) as u32
    }
}

/// How intervals fit multiples of a period.
#[derive(Clone, Copy, Debug, Default)]
struct Fit {
    fitting: usize,
    /// Those of one period.
    singles: usize,
    /// Mean period of those that fit, in microseconds, and how far it may be from the true one.
    mean: f64,
    error: f64,
}

impl Fit {
    fn of(intervals: &[f64], period: f64) -> Self {
        let count = |interval: f64| (interval / period).round();
        let fits = |interval: &f64| {
            let periods = count(*interval);
            (1.0..=MAX_PERIODS).contains(&periods)
                && (interval - periods * period).abs() <= TOLERANCE * period
        };
        // Period, number of periods.
        let mut all: Vec<(f64, f64)> = intervals
            .iter()
            .filter(|it| fits(it))
            .map(|interval| (interval / count(*interval), count(*interval)))
            .collect();
        let (fitting, singles) = (all.len(), all.iter().filter(|(_, count)| *count < 1.5).count());
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some((median, _)) = all.get(all.len() / 2).copied() else { return Self::default() };
        let deviation = |of: &(f64, f64)| (of.0 - median).abs() * of.1;
        let mut deviations: Vec<f64> = all.iter().map(deviation).collect();
        deviations.sort_by(f64::total_cmp);
        // Of delays that are evenly spread, the largest deviation is 3.4 times the median one. Larger ones
        // are of an interval that fits by chance, as after a restart.
        let usual = deviations[deviations.len() / 2];
        let largest = (usual * 4.0).max(median * SAME);
        all.retain(|it| deviation(it) <= largest);
        let periods: f64 = all.iter().map(|(_, count)| count).sum();
        let sum: f64 = all.iter().map(|(period, count)| period * count).sum();
        // Twice the standard error, as if each delay moved all heartbeats after it.
        let error = (usual * 3.0 / periods.sqrt()).max(median * SAME / periods);
        Self { fitting, singles, mean: sum / periods, error }
    }
}
