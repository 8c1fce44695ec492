//! Load, frame rate and error rate of a bus over time: a sample a second of the last minutes, and
//! samples of all its time whose length doubles whenever there are too many.
//!
//! Input: the counts of each second. Output: samples of any number of seconds. Bounded: 2,048
//! samples. Does not know the bit rate.

use super::load_second::LoadSecond;
use std::collections::VecDeque;

/// Counts of some consecutive seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadSample {
    /// Seconds in which frames could be received; 0: nothing is known.
    pub seconds: u32,
    /// Frames, error frames included.
    pub frames: u32,
    /// The most frames in a second.
    pub most_frames: u32,
    /// Error frames.
    pub errors: u32,
    /// The most error frames in a second.
    pub most_errors: u32,
    /// The longest time in a second during which the bus was occupied, in nominal bit times.
    pub most_bits: u32,
    /// Time during which the bus was occupied, in nominal bit times.
    pub bits: u64,
}

impl LoadSample {
    /// Returns the sample of one second; with `is_known` false nothing could be received.
    pub fn of(second: LoadSecond, is_known: bool) -> Self {
        if !is_known && second.frames == 0 {
            return Self::default();
        }
        Self {
            seconds: 1,
            frames: second.frames,
            most_frames: second.frames,
            errors: second.errors,
            most_errors: second.errors,
            most_bits: u32::try_from(second.bits).unwrap_or(u32::MAX),
            bits: second.bits,
        }
    }

    /// Adds the counts of other seconds.
    pub fn add(&mut self, other: Self) {
        self.seconds = self.seconds.saturating_add(other.seconds);
        self.frames = self.frames.saturating_add(other.frames);
        self.errors = self.errors.saturating_add(other.errors);
        self.bits = self.bits.saturating_add(other.bits);
        self.most_frames = self.most_frames.max(other.most_frames);
        self.most_errors = self.most_errors.max(other.most_errors);
        self.most_bits = self.most_bits.max(other.most_bits);
    }

    /// Mean bus load, 0–1; `bitrate` in bit/s. `None` if nothing is known.
    pub fn load(&self, bitrate: u32) -> Option<f64> {
        self.per_second(self.bits as f64 / f64::from(bitrate.max(1))).map(|load| load.min(1.0))
    }

    /// Mean number of frames in a second; `None` if nothing is known.
    pub fn frame_rate(&self) -> Option<f64> {
        self.per_second(f64::from(self.frames))
    }

    /// Mean number of error frames in a second; `None` if nothing is known.
    pub fn error_rate(&self) -> Option<f64> {
        self.per_second(f64::from(self.errors))
    }

    fn per_second(&self, sum: f64) -> Option<f64> {
        (self.seconds > 0).then(|| sum / f64::from(self.seconds))
    }
}

/// Samples of consecutive times of equal length, oldest first.
#[derive(Clone, Debug)]
struct SampleRow {
    /// Length of a sample in seconds.
    step: u64,
    /// Number of the first sample: its first second divided by the step.
    first: u64,
    samples: VecDeque<LoadSample>,
}

impl SampleRow {
    /// Number after the last sample.
    fn end(&self) -> u64 {
        self.first + self.samples.len() as u64
    }

    /// Joins each two samples to one.
    fn double_step(&mut self) {
        let mut joined = VecDeque::with_capacity(LoadHistory::SAMPLES);
        let (first, mut at) = (self.first / 2, self.first);
        for sample in &self.samples {
            match joined.back_mut() {
                Some(last) if at % 2 == 1 => LoadSample::add(last, *sample),
                _ => joined.push_back(*sample),
            }
            at += 1;
        }
        (self.step, self.first, self.samples) = (self.step * 2, first, joined);
    }
}

/// Samples of the last minutes, and of all time.
#[derive(Clone, Debug)]
pub struct LoadHistory {
    /// The first second and that after the last one.
    start: u64,
    end: u64,
    /// One sample a second.
    recent: SampleRow,
    all: SampleRow,
}

impl LoadHistory {
    /// Largest number of samples of the last minutes, and of all time.
    pub const SAMPLES: usize = 1024;

    /// Returns a history that starts with this second.
    pub(super) fn new(second: u64) -> Self {
        let row = |capacity| SampleRow {
            step: 1,
            first: second,
            samples: VecDeque::with_capacity(capacity),
        };
        Self { start: second, end: second, recent: row(0), all: row(0) }
    }

    /// Adds the counts of the next second, then `without` seconds without a frame.
    pub(super) fn add(&mut self, second: LoadSecond, without: u64, is_known: bool) {
        self.push(LoadSample::of(second, is_known));
        let idle = LoadSample::of(LoadSecond::default(), is_known);
        // The clock of a log may advance by years.
        let skipped = without.saturating_sub(Self::SAMPLES as u64);
        if skipped > 0 {
            self.skip(skipped, idle);
        }
        for _ in skipped..without {
            self.push(idle);
        }
    }

    fn push(&mut self, sample: LoadSample) {
        if self.recent.samples.len() == Self::SAMPLES {
            self.recent.samples.pop_front();
            self.recent.first += 1;
        }
        self.recent.samples.push_back(sample);
        self.push_to_all(sample);
        self.end += 1;
    }

    fn push_to_all(&mut self, sample: LoadSample) {
        let all = &mut self.all;
        if self.end / all.step < all.end()
            && let Some(last) = all.samples.back_mut()
        {
            return last.add(sample);
        }
        if all.samples.len() == Self::SAMPLES {
            all.double_step();
            // The second may belong to the sample that is last now.
            return self.push_to_all(sample);
        }
        all.samples.push_back(sample);
    }

    /// Adds `seconds` that are all like `idle`, without a step for each.
    fn skip(&mut self, seconds: u64, idle: LoadSample) {
        let to = self.end + seconds;
        while to / self.all.step - self.all.first >= Self::SAMPLES as u64 {
            self.all.double_step();
        }
        while self.end < to {
            let next = (self.end / self.all.step + 1) * self.all.step;
            let count = next.min(to) - self.end;
            let known = u32::try_from(count).unwrap_or(u32::MAX).saturating_mul(idle.seconds);
            self.push_to_all(LoadSample { seconds: known, ..idle });
            self.end += count;
        }
        self.recent.samples.clear();
        self.recent.first = self.end;
    }

    /// The second after the last sample.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Number of seconds since the start.
    pub fn len(&self) -> u64 {
        self.end - self.start
    }

    /// Returns true before the first second is over.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Length in seconds of the samples in which all seconds since `from` are stored: 1 in the last
    /// minutes, else a power of two.
    pub fn step_since(&self, from: u64) -> u64 {
        if from.max(self.start) >= self.recent.first { 1 } else { self.all.step }
    }

    /// Counts of the seconds from `from` until before `to`; a sample that lies partly in them is
    /// left to the part in which it begins.
    pub fn sample(&self, from: u64, to: u64) -> LoadSample {
        let row = if self.step_since(from) == 1 { &self.recent } else { &self.all };
        let first = from.div_ceil(row.step).max(row.first);
        let end = to.div_ceil(row.step).min(row.end());
        let mut sum = LoadSample::default();
        for at in first..end {
            sum.add(row.samples[(at - row.first) as usize]);
        }
        sum
    }

    /// Returns true if nothing could be received in a second, or in the one before or after it, as far as
    /// that is stored.
    pub fn is_unknown_near(&self, second: u64) -> bool {
        let near = second.saturating_sub(1)..=second.saturating_add(1);
        let sample = |second: u64| {
            let at = usize::try_from(second.checked_sub(self.recent.first)?).ok()?;
            self.recent.samples.get(at)
        };
        near.filter_map(sample).any(|sample| sample.seconds == 0)
    }

    /// Size in bytes, as of a copy.
    pub(super) fn size(&self) -> usize {
        (self.recent.samples.len() + self.all.samples.len()) * size_of::<LoadSample>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn second(frames: u32) -> LoadSecond {
        LoadSecond { frames, errors: 0, bus_errors: 0, bits: u64::from(frames) * 100 }
    }

    #[test]
    fn long_history_is_bounded_and_counts_every_second() {
        let mut history = LoadHistory::new(17);
        for at in 0..5000u32 {
            history.add(second(at % 7), 0, true);
        }
        assert!(history.recent.samples.len() == LoadHistory::SAMPLES);
        assert!(history.all.samples.len() <= LoadHistory::SAMPLES);
        let whole = history.sample(0, u64::MAX);
        assert_eq!(whole.seconds, 5000);
        assert_eq!(whole.frames, (0..5000).map(|at| at % 7).sum::<u32>());
        assert_eq!((whole.most_frames, whole.most_bits), (6, 600));
        // The samples of one second are still those of the last minutes.
        assert_eq!(history.step_since(history.end() - 1000), 1);
        assert_eq!(history.sample(history.end() - 2, history.end() - 1).frames, 4998 % 7);
        // Parts that follow each other hold each second once.
        let parts = (0..10).map(|at| history.sample(17 + at * 500, 17 + (at + 1) * 500));
        assert_eq!(parts.map(|part| part.seconds).sum::<u32>(), 5000);
    }

    #[test]
    fn years_without_frames_cost_little_and_count() {
        let mut history = LoadHistory::new(0);
        history.add(second(5), 0, true);
        let years = 100_000_000;
        history.add(second(3), years, true);
        let whole = history.sample(0, u64::MAX);
        assert_eq!((u64::from(whole.seconds), whole.frames), (years + 2, 8));
        assert_eq!(history.end(), years + 2);
        assert!(history.all.samples.len() <= LoadHistory::SAMPLES);
        assert_eq!(history.sample(history.end() - 1, history.end()).frame_rate(), Some(0.0));
    }

    #[test]
    fn time_without_a_bus_is_unknown() {
        let mut history = LoadHistory::new(0);
        history.add(second(0), 4, false);
        assert_eq!(history.sample(0, 5).load(125_000), None);
        history.add(second(10), 0, true);
        assert_eq!(history.sample(0, 6).frame_rate(), Some(10.0));
    }
}
