//! The discovery engine of one bus: finds devices, asks them for names and services, judges
//! their presence, collects evidence of collisions, and holds our own address.
//!
//! A state machine without I/O and without a clock:
//!
//! * `handle_frame`, `handle_timeout`: the only things, with the commands, that change it;
//! * commands (`rescan`, …): what the user wants;
//! * `poll_transmit`, `poll_event`: what is to be sent, what happened;
//! * `poll_timeout`: when to be called again at the latest.
//!
//! Call one that changes it, then drain the polls. It does not know des.json, the screen, or
//! where frames come from.

mod config;
mod device;
mod event;
mod finding;

pub use config::Config;
pub use device::{
    Device, DeviceId, HeartbeatStats, ModeChange, Presence, Query, QueryFault, QueryState, Quirk,
    ServiceEntry,
};
pub use event::{Event, EventKind};
pub use finding::{Confidence, Evidence, Finding, FindingKey, FindingKind};

use crate::frame::Frame;
use crate::time::Instant;
use crate::wire::id::Address;

/// What we are on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnAddress {
    /// Nothing: we only listen.
    None,
    /// Listening for used addresses before the first word.
    Listening,
    /// About to claim this one.
    Claiming(Address),
    /// Ours.
    Held(Address),
}

/// Where discovery stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Progress {
    /// Rounds finished.
    pub rounds: u32,
    /// Devices here whose name is known.
    pub named: usize,
    /// Devices here.
    pub here: usize,
    /// Devices here whose services are known.
    pub with_services: usize,
    /// Questions that still wait for an answer or for their turn.
    pub open_questions: usize,
    /// A round brought nothing new, every question is answered or given up, and no suspicion
    /// is open.
    pub settled: bool,
}

/// The named counters of one bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Counters {
    /// Data, remote and error frames heard, ours included.
    pub frames: u64,
    /// Frames we sent and the bus took.
    pub sent: u64,
    /// Error frames.
    pub errors: u64,
    /// Standard and remote frames: foreign, never interpreted.
    pub foreign: u64,
    /// Identifiers that are none of the nine types.
    pub non_conforming: u64,
    /// Answers that could not be used, or only in part.
    pub malformed: u64,
    /// Transfers given up.
    pub transfers_failed: u64,
    /// Device rows, findings or transfers refused because there were too many.
    pub refused: u64,
}

/// The engine of one bus. See the module's documentation.
#[derive(Debug)]
pub struct Engine {
    config: Config,
    devices: Vec<Device>,
    findings: Vec<Finding>,
}

impl Engine {
    /// An engine that starts now.
    pub fn new(_now: Instant, config: Config) -> Self {
        Self { config, devices: Vec::new(), findings: Vec::new() }
    }

    /// Takes a frame, dated by its own time (which is `now` or a little before).
    pub fn handle_frame(&mut self, _frame: &Frame) {}

    /// Does what is due at `now`.
    pub fn handle_timeout(&mut self, _now: Instant) {}

    /// When [`handle_timeout`](Self::handle_timeout) is to be called at the latest.
    pub fn poll_timeout(&self) -> Option<Instant> {
        None
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self, _now: Instant) -> Option<Frame> {
        None
    }

    /// The next thing that happened.
    pub fn poll_event(&mut self) -> Option<Event> {
        None
    }

    /// Command: ask everybody again now.
    pub fn rescan(&mut self, _now: Instant) {}

    /// Command: forget the devices that are lost.
    pub fn clear_lost(&mut self) {}

    /// Command: begin anew, as after bus-off or when the interface came back.
    pub fn restart(&mut self, _now: Instant) {}

    /// Tells the bit rate, once it is known.
    pub fn set_bitrate(&mut self, bitrate: Option<u32>) {
        self.config.bitrate = bitrate;
    }

    /// All rows, in the order of appearance.
    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    /// One row.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.devices.iter().find(|device| device.id == id)
    }

    /// All findings, by the time of their first evidence, cleared ones included.
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// What we are on the bus.
    pub fn own_address(&self) -> OwnAddress {
        OwnAddress::None
    }

    /// Where discovery stands.
    pub fn progress(&self) -> Progress {
        Progress::default()
    }

    /// The named counters.
    pub fn counters(&self) -> Counters {
        Counters::default()
    }

    /// The settings it runs with.
    pub fn config(&self) -> &Config {
        &self.config
    }
}
