//! Settings of the engine, from the command line and the profile.

use crate::frame::BusIndex;
use crate::time::Duration;
use crate::wire::id::Address;
use crate::wire::profile::Profile;
use std::sync::Arc;

/// Settings of the engine of one bus.
#[derive(Clone, Debug)]
pub struct Config {
    /// Bus that this engine serves.
    pub bus: BusIndex,
    /// Values that the platform leaves open (protocol §9).
    pub profile: Arc<Profile>,
    /// True: send nothing, and learn from the requests and responses of other nodes.
    pub listen_only: bool,
    /// True: send name requests and services requests. False: only descan's heartbeat is sent.
    pub scan: bool,
    /// Time between enumeration rounds after those at start; zero: no further rounds.
    pub round_period: Duration,
    /// Share of the bus load that descan's requests may take during the rounds at start, 0 to 1.
    pub start_share: f64,
    /// Share after the rounds at start, 0 to 1.
    pub steady_share: f64,
    /// Fixed own address; `None`: address 0, or one chosen by address resolution (CAN platform
    /// §3.2.4.2).
    pub address: Option<Address>,
    /// Bit rate in bit/s; 125,000 is assumed while it is `None`.
    pub bitrate: Option<u32>,
    /// True if transmitted frames are received back with
    /// [`Frame::is_tx`](crate::frame::Frame::is_tx) once they are on the bus.
    pub echo: bool,
    /// Seed of the random numbers: RND7, back-off, own address.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            bus: BusIndex(0),
            profile: Arc::new(Profile::default()),
            listen_only: false,
            scan: true,
            round_period: Duration::from_secs(10),
            start_share: 0.30,
            steady_share: 0.05,
            address: None,
            bitrate: None,
            echo: true,
            seed: 0,
        }
    }
}

impl Config {
    /// Returns the bit rate for timing, in bit/s.
    pub fn bits_per_second(&self) -> u32 {
        self.bitrate.unwrap_or(125_000).max(1)
    }

    /// Returns the time that `bits` take on the bus.
    pub fn bit_time(&self, bits: u64) -> Duration {
        Duration::from_micros(bits * 1_000_000 / u64::from(self.bits_per_second()))
    }
}
