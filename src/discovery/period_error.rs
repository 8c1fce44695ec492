//! Error of a device's heartbeat period against the nominal one, in ppm: that of its clock, as descan's
//! clock shows it.
//!
//! Input: the times of heartbeats of one device. Heartbeats that are missing do not matter, a changed
//! phase begins anew. Does not know why a heartbeat is late.

use crate::time::{Duration, Instant};

/// Nominal periods are multiples of this one, unless the period is clearly another one. Chosen.
const NOMINAL_STEP: Duration = Duration::from_millis(10);
/// Deviation of a period from a nominal one that is an error of the clock, as a fraction. Chosen: an RC
/// oscillator's.
const MAX_ERROR: f64 = 0.006;
/// Deviation of a heartbeat from its phase, in periods, above which it has another one. Chosen: more than
/// the delay on a busy bus.
const SAME_PHASE: f64 = 0.1;
/// Periods without a heartbeat after which the phase is not followed. Chosen.
const MAX_GAP: f64 = 30.0;
/// Time that is measured at least, in periods and in seconds; and from which on older heartbeats are
/// forgotten. Chosen: a minute shows 20 ppm where the jitter is 1 ms.
const MIN_PERIODS: u64 = 10;
/// Heartbeats after a start that are not measured: a device that starts is late. Chosen.
const SETTLING: u8 = 5;
const MIN_TIME: Duration = Duration::from_secs(10);
const MAX_TIME: Duration = Duration::from_mins(10);

/// Error of a heartbeat period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodError {
    /// Parts per million; positive is too long: the clock is slow.
    pub ppm: f64,
    /// What it may differ by, in ppm.
    pub uncertainty: f64,
}

impl PeriodError {
    /// Returns true if it differs from `others`, in ppm, by more than crystals do.
    pub fn is_outlier(&self, others: f64) -> bool {
        /// Chosen: twice the tolerance of a cheap crystal, for both clocks.
        const CRYSTALS: f64 = 200.0;
        (self.ppm - others).abs() > CRYSTALS + self.uncertainty
    }

    /// Returns the error in words, no finer than it is known: `40 ±5 ppm slow`.
    pub fn text(&self) -> String {
        // 1, 2 or 5 times a power of ten.
        let power = 10_f64.powf(self.uncertainty.max(1.0).log10().floor());
        let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
        let step = steps.into_iter().find(|step| *step >= self.uncertainty).unwrap_or(10.0 * power);
        let rounded = (self.ppm / step).round() * step;
        let word = match rounded {
            0.0 => "",
            slow if slow > 0.0 => " slow",
            _ => " fast",
        };
        format!("{:.0} ±{step:.0} ppm{word}", rounded.abs())
    }
}

/// Measures the error of a period.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PeriodMeter {
    nominal: Duration,
    /// Number of heartbeats in phase, at most [`SETTLING`].
    settled: u8,
    /// First heartbeat of the measurement, and periods since.
    first: Option<Instant>,
    periods: u64,
    /// A later heartbeat, with which the measurement goes on when it is long enough.
    next: Option<(Instant, u64)>,
    last: Option<Instant>,
}

impl PeriodMeter {
    /// Notes a heartbeat. `period` is the one expected of the device.
    pub fn note(&mut self, now: Instant, period: Duration) {
        let nominal = nominal_of(period);
        let steps = self.last.map(|last| now.since(last).as_secs_f64() / nominal.as_secs_f64());
        let is_in_phase = |steps: &f64| {
            (0.5..MAX_GAP).contains(steps) && (steps - steps.round()).abs() <= SAME_PHASE
        };
        let known = steps.filter(is_in_phase).filter(|_| nominal == self.nominal);
        let Some(steps) = known else {
            *self = Self { nominal, last: Some(now), ..Self::default() };
            return;
        };
        self.last = Some(now);
        let Some(first) = self.first else {
            self.settled += 1;
            self.first = (self.settled == SETTLING).then_some(now);
            return;
        };
        self.periods += steps.round() as u64;
        let measured = now.since(first);
        match self.next {
            None if measured >= MAX_TIME / 2 => self.next = Some((now, self.periods)),
            Some((next, periods)) if measured >= MAX_TIME => {
                (self.first, self.next) = (Some(next), Some((now, self.periods - periods)));
                self.periods -= periods;
            }
            _ => {}
        }
    }

    /// Forgets the heartbeats: those that follow are of another device, or it restarted.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Returns the error, by heartbeats that deviate from their phase by `jitter`; `None` before enough
    /// are known.
    pub fn error(&self, jitter: Duration) -> Option<PeriodError> {
        let time = self.last?.since(self.first?);
        if self.periods < MIN_PERIODS || time < MIN_TIME {
            return None;
        }
        let seconds = time.as_secs_f64();
        let nominal = self.nominal.as_secs_f64() * self.periods as f64;
        // Both ends may be late by the jitter.
        let uncertainty = 2.0 * jitter.as_secs_f64().max(20e-6) / seconds;
        Some(PeriodError { ppm: (seconds / nominal - 1.0) * 1e6, uncertainty: uncertainty * 1e6 })
    }
}

/// Returns the period that a device is set to: the nearest multiple of [`NOMINAL_STEP`], if its clock
/// explains the difference.
fn nominal_of(period: Duration) -> Duration {
    let steps = (period.as_secs_f64() / NOMINAL_STEP.as_secs_f64()).round();
    let near = NOMINAL_STEP.mul_f64(steps);
    let apart = (near.as_secs_f64() / period.as_secs_f64() - 1.0).abs();
    if steps >= 1.0 && apart <= MAX_ERROR { near } else { period }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Meter after heartbeats of a clock that is off by `ppm`, at these numbers of periods.
    fn measured(ppm: f64, period: f64, numbers: impl Iterator<Item = u32>) -> PeriodMeter {
        let mut meter = PeriodMeter::default();
        for number in numbers {
            let at = f64::from(number) * period * (1.0 + ppm / 1e6);
            meter
                .note(Instant::ZERO + Duration::from_secs_f64(at), Duration::from_secs_f64(period));
        }
        meter
    }

    fn ppm(meter: &PeriodMeter) -> Option<f64> {
        meter.error(Duration::from_micros(100)).map(|error| error.ppm.round())
    }

    #[test]
    fn error_is_that_of_the_clock_with_missing_heartbeats() {
        for off in [-3000.0, -40.0, 0.0, 15.0, 250.0, 4000.0] {
            for period in [0.1, 1.0, 2.5] {
                let count = (60.0 / period) as u32;
                let meter = measured(off, period, (0..count).filter(|number| number % 7 != 3));
                assert_eq!(ppm(&meter), Some(off), "{period} s");
            }
        }
        assert_eq!(ppm(&measured(40.0, 1.0, 0..14)), None, "too short");
    }

    #[test]
    fn changed_phase_begins_anew() {
        let mut meter = measured(40.0, 1.0, 0..60);
        let restart = Instant::ZERO + Duration::from_secs_f64(62.4);
        for second in 0..20 {
            meter.note(restart + Duration::from_secs(second), Duration::from_secs(1));
            assert_eq!(ppm(&meter), if second < 15 { None } else { Some(0.0) });
        }
        meter.forget();
        assert_eq!(ppm(&meter), None);
    }

    #[test]
    fn old_heartbeats_are_forgotten() {
        let mut meter = measured(100.0, 1.0, 0..2000);
        let warm = meter.last.unwrap();
        for number in 1..=1300 {
            let at = warm + Duration::from_secs_f64(f64::from(number) * 1.0002);
            meter.note(at, Duration::from_secs(1));
        }
        assert_eq!(ppm(&meter), Some(200.0));
        let error = meter.error(Duration::from_millis(1)).unwrap();
        assert!((3.0..7.0).contains(&error.uncertainty), "{error:?}");
    }
}
