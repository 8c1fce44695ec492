//! The tests of a device on a bus (see [`Prover`]): what forbids them, and their requests.
//!
//! While they run, the engine of the bus sends no requests by itself.

use super::App;
use super::proof::MAX_FRAMES;
use crate::discovery::{DeviceId, OwnAddress};
use crate::frame::{BusIndex, Frame};
use crate::prove::{ProofSwitches, Prover, ProverSetup};
use crate::time::Instant;
use std::collections::VecDeque;
use std::sync::Arc;

/// Tests of a device on one of the buses.
#[derive(Debug)]
pub(super) struct BusProver {
    bus: BusIndex,
    prover: Prover,
    /// Frames that the bus had lost before.
    lost: u64,
    /// The last frames of the bus, for a proof.
    frames: VecDeque<Frame>,
}

impl App {
    /// The tests that were started last.
    pub fn prover(&self) -> Option<&Prover> {
        self.prover.as_ref().map(|it| &it.prover)
    }

    /// The frames of the bus during the tests, the last ones if they are too many.
    pub fn proof_frames(&self) -> impl Iterator<Item = &Frame> {
        self.prover.iter().flat_map(|it| &it.frames)
    }

    /// Starts to test a device. `switches`: tests on demand.
    ///
    /// # Errors
    ///
    /// What forbids it.
    pub fn start_prover(&mut self, id: DeviceId, switches: ProofSwitches) -> Result<(), String> {
        let now = self.clock.now();
        let (Some(device), Some(bus)) = (self.device(id), self.bus(id.bus)) else {
            return Err("device is no longer on the bus".to_owned());
        };
        if let Some(obstacle) = self.tx_obstacle(id.bus, bus) {
            return Err(obstacle);
        }
        let OwnAddress::Held(own) = bus.own_address() else {
            return Err("descan has no address on this bus yet".to_owned());
        };
        if own == device.address {
            return Err("this is descan's own address".to_owned());
        }
        let (config, address) = (bus.config(), device.address);
        let setup = ProverSetup {
            own,
            device: address,
            profile: Arc::clone(&config.profile),
            bits_per_second: config.bits_per_second(),
            budget: config.steady_budget,
            is_listen_only: false,
            switches,
            seed: config.seed,
        };
        let mut prover = Prover::new(now, setup);
        if let Some(why) = self.shared_address(id) {
            prover.note_doubt(why);
        }
        let lost = bus.lost();
        self.buses.yield_requests(now, id.bus);
        let frames = VecDeque::new();
        self.prover = Some(Box::new(BusProver { bus: id.bus, prover, lost, frames }));
        Ok(())
    }

    /// Sends what is due, and notes what was not received.
    pub(super) fn step_prover(&mut self, now: Instant) {
        let Some(mut it) = self.prover.take() else { return };
        if let Some(bus) = self.bus(it.bus).filter(|_| !it.prover.is_over()) {
            let lost = bus.lost();
            if lost > it.lost {
                it.prover.handle_gap(now, lost - it.lost);
                it.lost = lost;
            }
            let is_held = bus.own_address() == OwnAddress::Held(it.prover.own());
            if let Some(why) = self.tx_obstacle(it.bus, bus) {
                it.prover.stop(&why);
            } else if !is_held {
                it.prover.stop("descan gave up its address");
            }
            it.prover.handle_timeout(now);
            while let Some(frame) = it.prover.poll_transmit() {
                self.buses.send(now, frame.with_bus(it.bus));
            }
        }
        self.prover = Some(it);
    }

    /// Passes a frame to the tests on its bus.
    pub(super) fn note_for_prover(&mut self, frame: &Frame) {
        if let Some(it) = self.prover.as_mut().filter(|it| it.bus == frame.bus) {
            if it.frames.len() == MAX_FRAMES {
                it.frames.pop_front();
            }
            it.frames.push_back(*frame);
            it.prover.handle_frame(frame);
        }
    }

    /// Notes that the program did not run.
    pub(super) fn note_gap_for_prover(&mut self, now: Instant) {
        if let Some(it) = &mut self.prover {
            it.prover.handle_gap(now, 0);
        }
    }

    /// Returns when the tests are due.
    pub(super) fn prover_timeout(&self) -> Option<Instant> {
        self.prover.as_ref()?.prover.poll_timeout()
    }
}
