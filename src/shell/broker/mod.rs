//! The connection to an MQTT broker (version 5): address, TLS and credentials; one that publishes, one
//! that reads. Each has its own thread. Does not know what is published.
//!
//! Nothing that a broker sends leads to a frame on a bus.

mod address;
mod failure;
mod publisher;
mod reader;

pub use address::{BrokerAccess, BrokerAddress, BrokerSettings};
pub use failure::BrokerFailure;
pub use publisher::{BrokerPublisher, PublisherNotice};
pub use reader::{BrokerReader, ReaderNotice};

use crate::time::Duration;

/// Time without a packet after which the other end is tested; the broker calls a client lost after one
/// and a half of it (MQTT 5, section 3.1.2.10).
const KEEP_ALIVE: Duration = Duration::from_secs(20);

/// How long a broker keeps the session of a lost client.
const SESSION_EXPIRY_SECONDS: u32 = 3600;

/// Longest packet that is read, in bytes: told to the broker, which sends none above it (MQTT 5, section
/// 3.1.2.11.4).
const MAX_PACKET_BYTES: u32 = 128 << 10;

/// Wait before the first attempt to connect again; doubled after each, up to [`MAX_BACK_OFF`].
const BACK_OFF: Duration = Duration::from_secs(1);
const MAX_BACK_OFF: Duration = Duration::from_mins(1);

/// Returns the wait before attempt `number`, from 1, with up to a quarter of it taken off at random: 500
/// gateways of one broker do not come back at the same moment.
fn back_off(number: u32) -> Duration {
    let doubled = BACK_OFF.saturating_mul(1 << number.saturating_sub(1).min(6));
    let wait = doubled.min(MAX_BACK_OFF);
    wait.mul_f64(1.0 - fastrand::f64() / 4.0)
}
