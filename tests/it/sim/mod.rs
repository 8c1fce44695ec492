//! The simulated bus and its devices, through the public API, as tests and demos use them.

mod bus;
mod devices;
mod responses;
mod scenarios;

use descan::frame::{Frame, FrameKind};
use descan::sim::{DeviceSpec, Scenario, Sim, SimStation};
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header, Service};

fn at_ms(ms: u64) -> Instant {
    Instant::from_micros(ms * 1000)
}

fn address(number: u8) -> Address {
    Address::new(number).unwrap()
}

fn heartbeat() -> Service {
    Service::new(1).unwrap()
}

fn des() -> Service {
    Service::new(2).unwrap()
}

/// Returns an empty bus with two stations.
fn two_stations() -> (Sim, SimStation, SimStation) {
    let mut sim = Sim::new(&Scenario::new(125_000), 1);
    let (one, two) = (sim.attach(), sim.attach());
    (sim, one, two)
}

/// Returns a bus with these devices and a station.
fn bus_with(devices: impl IntoIterator<Item = DeviceSpec>) -> (Sim, SimStation) {
    let mut scenario = Scenario::new(125_000);
    scenario.devices.extend(devices);
    let mut sim = Sim::new(&scenario, 7);
    let me = sim.attach();
    (sim, me)
}

/// Returns all frames that `station` has received and not yet polled.
fn polled(sim: &mut Sim, station: SimStation) -> Vec<Frame> {
    std::iter::from_fn(|| sim.poll_frame(station)).collect()
}

/// Advances for `ms` and returns what `station` received.
fn after(sim: &mut Sim, station: SimStation, ms: u64) -> Vec<Frame> {
    sim.advance(sim.now() + Duration::from_millis(ms));
    polled(sim, station)
}

fn is_error(frame: &Frame) -> bool {
    frame.kind == FrameKind::Error
}

/// Returns identifier and data of every data frame from `source`.
fn from(frames: &[Frame], source: u8) -> Vec<(Header, Frame)> {
    let decoded =
        frames.iter().filter_map(|frame| Some((Header::decode(frame.platform_id()?), *frame)));
    decoded.filter(|(header, _)| header.source.number() == source).collect()
}

/// Returns those of them that are heartbeats.
fn beats(frames: &[Frame], source: u8) -> Vec<Frame> {
    let all = from(frames, source).into_iter();
    all.filter(|(header, _)| header.service == heartbeat()).map(|(_, frame)| frame).collect()
}
