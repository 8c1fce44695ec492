//! Frames and bus time of a bus: in each of the last 30 seconds, over all its time, by sender and
//! service; error frames by kind.
//!
//! Input: the frames of one bus. Output: frame rate and bus load. Does not know the adapter.

use super::error_kinds::ErrorKinds;
use super::load_history::LoadHistory;
use super::load_second::LoadSecond;
use super::load_shares::LoadShares;
use crate::error_report::ErrorReport;
use crate::frame::bits::FrameBits;
use crate::frame::{Frame, FrameKind};
use crate::time::Instant;
use std::collections::VecDeque;

/// Frame counts and bus time of the current and of the last [`Self::SECONDS`] seconds.
#[derive(Clone, Debug)]
pub struct LoadMeter {
    second: u64,
    current: LoadSecond,
    past: VecDeque<LoadSecond>,
    started: Instant,
    bits: u64,
    /// Seconds, of the last minutes and of all time.
    pub history: LoadHistory,
    /// Bus time by sender and by service.
    pub shares: LoadShares,
    /// Error frames by kind.
    pub error_kinds: ErrorKinds,
}

impl LoadMeter {
    /// Number of whole seconds that are stored.
    pub const SECONDS: usize = 30;

    /// Returns a meter that starts at `now`.
    pub(super) fn new(now: Instant) -> Self {
        let second = now.as_micros() / 1_000_000;
        let past = VecDeque::with_capacity(Self::SECONDS);
        Self {
            second,
            current: LoadSecond::default(),
            past,
            started: now,
            bits: 0,
            history: LoadHistory::new(second),
            shares: LoadShares::new(second),
            error_kinds: ErrorKinds::default(),
        }
    }

    /// Counts a frame. `bitrate` and `data_bitrate` in bit/s; without a data bit rate the nominal
    /// one applies to the data phase.
    pub fn add(&mut self, frame: &Frame, bitrate: u32, data_bitrate: Option<u32>) {
        self.current.frames += 1;
        let bits = if frame.kind == FrameKind::Error {
            let report = ErrorReport::of(frame);
            let is_broken = report.is_some_and(|report| report.is_bus_error());
            self.error_kinds.add(report);
            self.current.errors += 1;
            self.current.bus_errors += u32::from(is_broken);
            if is_broken { BROKEN_FRAME_BITS } else { 0 }
        } else {
            bit_times(frame, bitrate, data_bitrate)
        };
        self.current.bits += bits;
        self.bits += bits;
        self.shares.add(frame, bits);
    }

    /// Closes the seconds that are over; returns true if there were any. With `is_known` false no
    /// frames could be received in them.
    pub fn advance(&mut self, now: Instant, is_known: bool) -> bool {
        let second = now.as_micros() / 1_000_000;
        if second <= self.second {
            return false;
        }
        self.history.add(self.current, second - self.second - 1, is_known);
        self.shares.advance(second);
        let over = (second - self.second).min(Self::SECONDS as u64 + 1);
        self.second = second;
        for _ in 0..over {
            if self.past.len() == Self::SECONDS {
                self.past.pop_front();
            }
            self.past.push_back(std::mem::take(&mut self.current));
        }
        true
    }

    /// Mean bus load since the start, 0–1; `bitrate` in bit/s.
    pub fn mean_load(&self, now: Instant, bitrate: u32) -> f64 {
        let whole = now.since(self.started).as_secs_f64() * f64::from(bitrate.max(1));
        if whole > 0.0 { (self.bits as f64 / whole).min(1.0) } else { 0.0 }
    }

    /// Counts of the last whole second; zero in the first one.
    pub fn last(&self) -> LoadSecond {
        self.past.back().copied().unwrap_or_default()
    }

    /// Counts of the last whole seconds, oldest first.
    pub fn seconds(&self) -> impl DoubleEndedIterator<Item = &LoadSecond> + ExactSizeIterator {
        self.past.iter()
    }

    /// Size in bytes, as of a copy.
    pub(super) fn size(&self) -> usize {
        self.history.size() + self.shares.size()
    }

    /// Returns true if no frame was counted in the stored seconds.
    pub fn is_idle(&self) -> bool {
        self.current.frames == 0 && self.past.iter().all(|second| second.frames == 0)
    }
}

/// Least bus time of a bus error, in bits (ISO 11898-1): error flag, error delimiter, intermission.
/// An error frame does not report how much of the frame preceded it.
const BROKEN_FRAME_BITS: u64 = 6 + 8 + 3;

/// Bus time of a valid frame, in nominal bit times.
fn bit_times(frame: &Frame, bitrate: u32, data_bitrate: Option<u32>) -> u64 {
    let bits = FrameBits::of(frame);
    let (data, bitrate) = (u64::from(bits.data), u64::from(bitrate.max(1)));
    let data_bitrate = data_bitrate.map_or(bitrate, u64::from).max(1);
    u64::from(bits.nominal) + data * bitrate / data_bitrate
}
