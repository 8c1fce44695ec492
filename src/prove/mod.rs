//! Proof that a device keeps the rules of DES and of the CAN platform, section 3.2.4: observes it, sends
//! requests to it, and says for each rule whether it is kept, broken or not seen.
//!
//! A state machine without I/O and without a clock, for one device at a time:
//!
//! * `handle_frame`, `handle_gap`, `handle_timeout`: input;
//! * `poll_transmit`: frames to send, within the share of the bus;
//! * `poll_timeout`: the latest time of the next call;
//! * `verdicts`: the result, at any time.
//!
//! What was not surely seen is *not seen*, never *broken*: lost frames, another requester, another node at
//! the same address, values of the profile that are assumed. Does not know buses, files or screens.
//!
//! ```text
//! rule        the table of rules
//! verdict     samples of each rule, and what they add up to
//! observer    what the device sends by itself
//! exchange    one request and its answers
//! disruption  frames that throw a device out of its work
//! task        which requests, in which order
//! tester      carries them out
//! judge       what the answers mean for the rules
//! load        frames that load the bus
//! malformed   malformed requests
//! ```

mod disruption;
mod exchange;
mod judge;
mod load;
mod malformed;
mod observer;
mod rule;
mod task;
mod tester;
mod verdict;

pub use rule::{ConformanceRule, RuleDocument, RuleNeed};
pub use tester::{ProofSwitches, Prover, ProverSetup};
pub use verdict::{Conformance, MAX_PROOF_FRAMES, RuleVerdict};

use crate::frame::Frame;
use crate::frame::bits::FrameBits;

/// Bits of a frame on the bus.
fn nominal_bits(frame: &Frame) -> f64 {
    f64::from(FrameBits::of(frame).total())
}
