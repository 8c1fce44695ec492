//! An engine on a simulated bus, driven in virtual time.

#![allow(dead_code)]

use descan::discovery::{Config, Engine, Event};
use descan::frame::Frame;
use descan::sim::{Scenario, Sim, Station};
use descan::time::Instant;

/// A simulated bus with an inspector on it.
pub struct Inspection {
    pub sim: Sim,
    pub station: Station,
    pub engine: Engine,
    pub events: Vec<Event>,
    /// Every frame the inspector saw, its own included.
    pub frames: Vec<Frame>,
}

impl Inspection {
    pub fn new(scenario: &Scenario, seed: u64, config: Config) -> Self {
        let mut sim = Sim::new(scenario, seed);
        let station = sim.attach();
        let config = Config { bitrate: Some(scenario.bitrate), seed, ..config };
        let engine = Engine::new(Instant::ZERO, config);
        Self { sim, station, engine, events: Vec::new(), frames: Vec::new() }
    }

    /// Runs until `until`, or until `enough` says so after something happened.
    pub fn run_until(&mut self, until: Instant, mut enough: impl FnMut(&Engine) -> bool) -> bool {
        loop {
            let now = self.sim.now();
            while let Some(frame) = self.sim.poll_frame(self.station) {
                self.engine.handle_frame(&frame);
                self.frames.push(frame);
            }
            if self.engine.poll_timeout().is_some_and(|due| due <= now) {
                self.engine.handle_timeout(now);
            }
            while let Some(frame) = self.engine.poll_transmit(now) {
                assert!(self.sim.transmit(self.station, frame), "the bus takes our frames");
            }
            while let Some(event) = self.engine.poll_event() {
                self.events.push(event);
            }
            if enough(&self.engine) {
                return true;
            }
            if now >= until {
                return false;
            }
            let next = [self.engine.poll_timeout(), self.sim.next_event(), Some(until)];
            let next = next.into_iter().flatten().min().unwrap_or(until);
            self.sim.advance(next.max(now));
        }
    }
}
