//! How the engine is to behave: what the user chose on the command line, and the profile.

use crate::frame::BusIndex;
use crate::time::Duration;
use crate::wire::id::Address;
use crate::wire::profile::Profile;
use std::sync::Arc;

/// Settings of one bus's engine.
#[derive(Clone, Debug)]
pub struct Config {
    /// Which bus this is.
    pub bus: BusIndex,
    /// What the descriptions leave open.
    pub profile: Arc<Profile>,
    /// Never send anything; learn from what others ask and answer.
    pub listen_only: bool,
    /// Ask who is there and for services. Without it only our presence is announced.
    pub scan: bool,
    /// Time between rounds once the bus is known; zero = no rounds after the first ones.
    pub round_period: Duration,
    /// The share of the bus that what we send may take while starting, 0–1.
    pub start_share: f64,
    /// The same afterwards.
    pub steady_share: f64,
    /// A fixed address for us, instead of 0 or one found by the rules of 3.2.4.2.
    pub address: Option<Address>,
    /// Bits per second, where known; 125,000 is assumed otherwise.
    pub bitrate: Option<u32>,
    /// Whether frames that we send come back as ours once the bus took them.
    pub echo: bool,
    /// Seed of the random numbers (RND7, back-off, address).
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
    /// The bit rate to reckon with.
    pub fn bits_per_second(&self) -> u32 {
        self.bitrate.unwrap_or(125_000).max(1)
    }

    /// How long the bus takes for `bits`.
    pub fn bit_time(&self, bits: u64) -> Duration {
        Duration::from_micros(bits * 1_000_000 / u64::from(self.bits_per_second()))
    }
}
