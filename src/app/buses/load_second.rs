//! Frames and bus time in one second.
//!
//! Plain counts. Does not know the frames.

/// Counts of one second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadSecond {
    /// Frames, error frames included.
    pub frames: u32,
    /// Error frames among them.
    pub errors: u32,
    /// Error frames that report a bus error (ISO 11898-1).
    pub bus_errors: u32,
    /// Time during which the bus was occupied, in nominal bit times.
    pub bits: u64,
}

impl LoadSecond {
    /// Bus load, 0–1; `bitrate` in bit/s.
    pub fn load(self, bitrate: u32) -> f64 {
        (self.bits as f64 / f64::from(bitrate.max(1))).min(1.0)
    }
}
