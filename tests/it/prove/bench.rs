//! A simulated bus with a prover. A filter changes what passes between the prover and the device.

use descan::frame::Frame;
use descan::prove::{
    Conformance, ConformanceRule, ProofSwitches, Prover, ProverSetup, RuleVerdict,
};
use descan::sim::{Scenario, Sim, SimStation};
use descan::time::{Duration, Instant};
use descan::wire::id::Address;
use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};
use std::collections::VecDeque;
use std::sync::Arc;

/// Longest time of a proof.
const LIMIT: Duration = Duration::from_secs(400);

/// What passes between prover and device.
pub trait Filter {
    /// Frames that the bus gets instead of one of the prover.
    fn transmitted(&mut self, _now: Instant, frame: Frame) -> Vec<Frame> {
        vec![frame]
    }

    /// Frames that the prover gets instead of one of the bus.
    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        vec![frame]
    }

    /// Frames that the bus gets in addition, and the prover does not see.
    fn hidden(&mut self, _now: Instant) -> Vec<Frame> {
        Vec::new()
    }

    /// When one is due.
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }

    /// Frames that the prover gets in addition, now.
    fn inject(&mut self, _now: Instant) -> Vec<Frame> {
        Vec::new()
    }
}

/// Further tests.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Extra {
    None,
    Disruption,
    Load,
    Reboot,
}

/// Changes nothing.
pub struct NoFilter;

impl Filter for NoFilter {}

/// The built-in values, as if a file gave them all.
pub fn given_profile() -> Profile {
    let mut profile = Profile::default();
    for key in ProfileKey::ALL {
        profile.set_origin(*key, ValueOrigin::Given);
    }
    profile
}

pub struct ProofBench {
    pub sim: Sim,
    station: SimStation,
    pub prover: Prover,
    filter: Box<dyn Filter>,
    /// Frames on the way to the bus, with what the prover takes for them.
    sent: VecDeque<(Frame, Option<Frame>)>,
    lost: u64,
    /// Frames that the prover got.
    pub seen: Vec<Frame>,
}

impl ProofBench {
    pub fn new(scenario: &Scenario, device: u8, profile: Profile, filter: Box<dyn Filter>) -> Self {
        Self::with(scenario, device, profile, filter, Extra::None)
    }

    /// A bench whose prover makes further tests.
    pub fn with(
        scenario: &Scenario,
        device: u8,
        profile: Profile,
        filter: Box<dyn Filter>,
        extra: Extra,
    ) -> Self {
        let mut sim = Sim::from_scenario(scenario);
        let station = sim.attach();
        let setup = ProverSetup {
            own: Address::DEBUG,
            device: Address::from_bits(device),
            profile: Arc::new(profile),
            bits_per_second: scenario.bitrate,
            budget: 0.05,
            is_listen_only: false,
            switches: ProofSwitches {
                disrupts: extra == Extra::Disruption,
                loads: extra == Extra::Load,
                reboots: extra == Extra::Reboot,
            },
            seed: 1,
        };
        let prover = Prover::new(Instant::ZERO, setup);
        let (sent, seen) = (VecDeque::new(), Vec::new());
        Self { sim, station, prover, filter, sent, lost: 0, seen }
    }

    /// Runs until all tests are made.
    pub fn run(&mut self) -> Vec<RuleVerdict> {
        let end = Instant::ZERO + LIMIT;
        while !self.prover.is_over() {
            self.step();
            assert!(self.sim.now() < end, "not over: {:?}", self.prover.progress());
        }
        self.prover.verdicts()
    }

    fn step(&mut self) {
        let due = [self.sim.next_event(), self.prover.poll_timeout(), self.filter.poll_timeout()];
        let now = due.into_iter().flatten().min().expect("not over").max(self.sim.now());
        self.sim.advance(now);
        while let Some(frame) = self.sim.poll_frame(self.station) {
            self.pass(frame);
        }
        let lost = self.sim.status(self.station).rx_lost;
        if lost > self.lost {
            self.prover.handle_gap(now, lost - self.lost);
            self.lost = lost;
        }
        for frame in self.filter.hidden(now) {
            self.sent.push_back((frame, None));
            assert!(self.sim.transmit(self.station, frame));
        }
        for frame in self.filter.inject(now) {
            self.give(frame.with_time(now));
        }
        self.prover.handle_timeout(now);
        while let Some(frame) = self.prover.poll_transmit() {
            self.transmit(now, frame);
        }
    }

    fn transmit(&mut self, now: Instant, frame: Frame) {
        let mut original = Some(frame);
        let instead = self.filter.transmitted(now, frame);
        if instead.is_empty() {
            self.give(frame.with_time(now).with_tx());
        }
        for changed in instead {
            self.sent.push_back((changed, original.take()));
            if !self.sim.transmit(self.station, changed) {
                // Bus-off: alone with a device that restarts, on a disturbed bus.
                self.sim.set_link(self.station, true);
                self.prover.handle_gap(now, 0);
            }
        }
    }

    fn pass(&mut self, frame: Frame) {
        if !frame.is_tx {
            for changed in self.filter.received(frame) {
                self.give(changed);
            }
            return;
        }
        let at = self.sent.iter().position(|(sent, _)| sent.same_on_wire(&frame));
        if let Some((_, Some(original))) = at.and_then(|at| self.sent.remove(at)) {
            self.give(original.with_time(frame.time).with_tx());
        }
    }

    fn give(&mut self, frame: Frame) {
        self.seen.push(frame);
        self.prover.handle_frame(&frame);
    }
}

/// The rules that are broken, with the texts.
pub fn broken(verdicts: &[RuleVerdict]) -> Vec<(ConformanceRule, String)> {
    let broken = verdicts.iter().filter(|it| it.conformance == Conformance::Broken);
    broken.map(|it| (it.rule, it.text.clone())).collect()
}

/// The verdict on a rule.
pub fn verdict(verdicts: &[RuleVerdict], rule: ConformanceRule) -> &RuleVerdict {
    verdicts.iter().find(|it| it.rule == rule).expect("all rules")
}
