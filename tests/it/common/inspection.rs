//! A discovery engine on a simulated bus, driven in virtual time, with its events as text.

use descan::discovery::{Config, Engine, Event, EventKind, OtherDevice, ServicesNews};
use descan::frame::Frame;
use descan::log::candump::write_line;
use descan::sim::{Fault, Scenario, Sim, SimStation};
use descan::time::{Duration, Epoch, Instant};
use std::fmt::Write;

/// A simulated bus with an inspector.
pub struct Inspection {
    pub sim: Sim,
    pub station: SimStation,
    pub engine: Engine,
    pub events: Vec<Event>,
    /// Every frame that the inspector sent or received.
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

    /// Runs until `until`, or until `enough` returns true after an event.
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

/// The faults that a device may have on its own.
pub const FAULTS: [Fault; 7] = [
    Fault::NoHeartbeat,
    Fault::NoDes,
    Fault::NoServices,
    Fault::DropFrame,
    Fault::WrongSequence,
    Fault::HugeLength,
    Fault::RepeatsRequestDst,
];

/// Runs two inspectors on that bus until `until`: one sends requests, one is listen-only.
pub fn requester_and_listener(scenario: &Scenario, seed: u64, until: Instant) -> [Engine; 2] {
    let mut sim = Sim::new(scenario, seed);
    let stations = [sim.attach(), sim.attach()];
    let config = Config { bitrate: Some(scenario.bitrate), ..Config::default() };
    let silent = Config { listen_only: true, ..config.clone() };
    let mut engines = [config, silent].map(|config| Engine::new(Instant::ZERO, config));
    while sim.now() < until {
        let now = sim.now();
        for (station, engine) in stations.into_iter().zip(&mut engines) {
            while let Some(frame) = sim.poll_frame(station) {
                engine.handle_frame(&frame);
            }
            engine.handle_timeout(now);
        }
        let [requester, listener] = &mut engines;
        while let Some(frame) = requester.poll_transmit(now) {
            sim.transmit(stations[0], frame);
        }
        assert!(listener.poll_transmit(now).is_none(), "who listens sends nothing");
        let next = [requester.poll_timeout(), listener.poll_timeout(), sim.next_event()];
        let next = next.into_iter().flatten().min().unwrap_or(until);
        sim.advance(next.max(now + Duration::from_micros(1)));
    }
    engines
}

/// Formats an event as text.
pub fn describe(event: &Event) -> String {
    let mut who = event.address.map_or(String::new(), |address| format!(" {address}"));
    if let Some(name) = &event.name {
        write!(who, " {name}").unwrap();
    }
    match &event.kind {
        EventKind::FirstFrame => format!("appeared{who}"),
        EventKind::NameReceived => format!("named{who}"),
        EventKind::Services { count, news } => {
            let news = match news {
                ServicesNews::First => "",
                ServicesNews::Changed => ", others than before",
                ServicesNews::OtherDevice => ", of another device",
            };
            format!("services{who}: {count}{news}")
        }
        EventKind::Mode { from, to } => match from {
            Some(from) => format!("mode{who}: {from} -> {to}"),
            None => format!("mode{who}: {to}"),
        },
        EventKind::Claimed { holder, inferred: guess, .. } => match holder {
            Some(holder) => format!("claimed{who}: held by {}{}", party(holder), perhaps(*guess)),
            None => format!("claimed{who}"),
        },
        EventKind::GaveUpAddress { to, inferred: guess, .. } => {
            let to = to.as_ref().map_or("nobody".to_owned(), party);
            format!("gave way{who}: to {to}{}", perhaps(*guess))
        }
        EventKind::Moved { from } => format!("moved{who}: from {from}"),
        EventKind::IdsMerged { previous: was, before: None } => {
            format!("joined{who}: was row {}", was.number)
        }
        EventKind::IdsMerged { previous: was, before: Some(before) } => {
            format!("joined{who}: was row {} before {before}", was.number)
        }
        EventKind::Removed => format!("removed{who}"),
        EventKind::DescriptorField(field) => format!("field{who}: {}", field.name()),
        EventKind::DescriptorRead { values, fields } => {
            format!("descriptor{who}: {values} of {fields}")
        }
        EventKind::RequestEnded { outcome, .. } => format!("response{who}: {outcome:?}"),
        EventKind::FrameSent { copy, frame, .. } => format!("sent {copy}: {frame}"),
        EventKind::SequenceEnded { copies, why, .. } => format!("sent {copies} in all: {why}"),
        EventKind::Rebooted => format!("rebooted{who}"),
        EventKind::UidChanged { from, to } => format!("uid{who}: {from:?} -> {to:?}"),
        EventKind::Presence(presence) => format!("{presence}{who}"),
        EventKind::Returned { was } => format!("returned{who}: was {was}"),
        EventKind::Finding { key, state } => {
            let at = key.address.map_or(String::new(), |address| format!(" at {address}"));
            format!("finding {} {state}{at}", key.kind)
        }
        EventKind::OwnAddress(address) => format!("we are {address}"),
        EventKind::OwnAddressLost(address) => format!("we gave up {address}"),
        EventKind::NoAddress(Some(wanted)) => format!("{wanted} is not free"),
        EventKind::NoAddress(None) => "no address is free".to_owned(),
        EventKind::NoAck => "no ACK".to_owned(),
        EventKind::Acknowledged => "acknowledged".to_owned(),
        EventKind::DebugMessage { code, data } => format!("debug{who}: {code:03X} {data:02X?}"),
    }
}

fn party(party: &OtherDevice) -> String {
    let name = party.name.as_ref().map(ToString::to_string);
    name.unwrap_or_else(|| format!("row {}", party.device.number))
}

fn perhaps(guess: bool) -> &'static str {
    if guess { ", perhaps" } else { "" }
}

/// Returns what a listen-only node receives in a scenario with another inspector, as a candump log.
pub fn log(scenario: &Scenario, seconds: u64) -> String {
    let mut sim = Sim::new(scenario, 7);
    let observer = sim.attach();
    let inspector = sim.attach();
    let config = Config { seed: 7, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let epoch = Epoch::from_unix_micros(1_436_509_052_249_713);
    let mut log = Vec::new();
    let until = Instant::from_micros(seconds * 1_000_000);
    while sim.now() < until {
        let now = sim.now();
        while let Some(frame) = sim.poll_frame(inspector) {
            engine.handle_frame(&frame);
        }
        engine.handle_timeout(now);
        while let Some(frame) = engine.poll_transmit(now) {
            sim.transmit(inspector, frame);
        }
        while let Some(frame) = sim.poll_frame(observer) {
            write_line(&mut log, epoch, "can0", &frame).unwrap();
        }
        let next = [engine.poll_timeout(), sim.next_event()].into_iter().flatten().min();
        sim.advance(next.unwrap_or(until).max(now + Duration::from_micros(1)).min(until));
    }
    String::from_utf8(log).unwrap()
}
