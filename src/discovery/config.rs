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
    /// True: send nothing, and learn from the requests and responses of other nodes. Default false.
    pub listen_only: bool,
    /// True (default): send name requests and services requests. False: only descan's heartbeat is
    /// sent.
    pub send_requests: bool,
    /// Time between enumeration rounds after those at start; zero: no further rounds. Default 10 s.
    pub round_period: Duration,
    /// Part of the bus capacity that descan's frames may use during the rounds at start, 0 to 1;
    /// default 0.30.
    pub startup_budget: f64,
    /// The same after the rounds at start, 0 to 1; default 0.05.
    pub steady_budget: f64,
    /// Fixed own address; `None`: address 0, or one chosen by address resolution (CAN platform
    /// §3.2.4.2).
    pub address: Option<Address>,
    /// Bit rate in bit/s, 10,000 to 1,000,000; 125,000 is assumed while it is `None`.
    pub bitrate: Option<u32>,
    /// True if transmitted frames are received back with
    /// [`Frame::is_tx`](crate::frame::Frame::is_tx) once they are on the bus. Default true.
    pub has_loopback: bool,
    /// Seed of the random numbers: RND7, back-off, own address.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            bus: BusIndex(0),
            profile: Arc::new(Profile::default()),
            listen_only: false,
            send_requests: true,
            round_period: Duration::from_secs(10),
            startup_budget: 0.30,
            steady_budget: 0.05,
            address: None,
            bitrate: None,
            has_loopback: true,
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
    pub fn duration_of_bits(&self, bits: u64) -> Duration {
        Duration::from_micros(bits * 1_000_000 / u64::from(self.bits_per_second()))
    }
}
