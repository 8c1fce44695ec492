//! `sim:SCENARIO`: a simulated bus as a port. Its virtual time runs with the session's clock. Does not
//! know what is simulated: [`crate::sim`] does.

use super::absolute_path::absolute;
use super::clock::Clock;
use super::faults::cannot_open;
use super::kind::{BusKind, OpenRequest};
use super::port::{Port, PortShared};
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::regular_file::read_text;
use crate::sim::{self, Scenario, Sim, SimStation};
use crate::status::{BusState, Link, RateSearch};
use crate::text::{on_one_line, printable_path};
use crate::time::Duration;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Shortest time between two deliveries: wake-ups cost more than frames.
const NAP: Duration = Duration::from_millis(2);
/// Longest sleep of an idle bus.
const IDLE: Duration = Duration::from_secs(1);

pub(super) const KIND: BusKind = BusKind {
    scheme: "sim",
    forms: &["sim:boiler", "sim:drone", "sim:FILE"],
    example: "sim:boiler",
    note: None,
    can_send: false,
};

pub(super) fn parse(text: &str) -> Result<String, Diagnostic> {
    if text.is_empty() { Err(KIND.incomplete()) } else { Ok(text.to_owned()) }
}

/// The name that all spellings of one simulated bus share: the path of its file, unless built-in.
pub(super) fn normalised(scenario: &str) -> String {
    match Scenario::builtin_text(scenario) {
        Some(_) => scenario.to_owned(),
        None => absolute(Path::new(scenario)).display().to_string(),
    }
}

pub(super) fn text(scenario: &str) -> String {
    scenario.to_owned()
}

/// Opens a bus on which the scenario of that name runs; its time zero is the present.
pub(super) fn open(name: &str, request: OpenRequest) -> Result<Port, Diagnostic> {
    let scenario = scenario(name)?;
    let bus = request.name.clone();
    start(&scenario, request).map_err(|error| cannot_open(bus, &error))
}

/// The scenario of that name: a built-in one, or a TOML file.
///
/// # Errors
///
/// The file cannot be read, or is not a scenario.
pub fn scenario(name: &str) -> Result<Scenario, Diagnostic> {
    if Scenario::builtin_text(name).is_some() {
        return Scenario::builtin(name).map_err(|error| Diagnostic::new(error.to_string()));
    }
    let text = read_text(Path::new(name))?.ok_or_else(|| {
        let missing = Diagnostic::new("file not found").of(printable_path(Path::new(name)));
        missing.with_remedy("use boiler, drone or a TOML file")
    })?;
    Scenario::parse(&text).map_err(|error| {
        Diagnostic::new(on_one_line(&error.to_string())).of(printable_path(Path::new(name)))
    })
}

fn start(scenario: &Scenario, request: OpenRequest) -> io::Result<Port> {
    let OpenRequest { name, index, clock, options } = request;
    let shared = Arc::new(PortShared::new()?);
    let mut sim = Sim::from_scenario(scenario);
    let station = sim.attach();
    let mut port = Port::new(&name, Arc::clone(&shared), options.listen_only);
    shared.queue.update_status(|status| {
        status.link = Link::Up;
        status.rate_search = RateSearch::NoRate;
        status.bitrate = Some(scenario.bitrate);
    });
    port.serve(move |shared| run(&mut sim, station, shared, index, &clock))?;
    Ok(port)
}

fn run(sim: &mut Sim, station: SimStation, shared: &PortShared, index: BusIndex, clock: &Clock) {
    // The simulation starts at its own zero.
    let start = clock.now();
    let mut batch: Vec<Frame> = Vec::new();
    while !shared.is_stopped() {
        let now = clock.now();
        let passed = now.since(start);
        // In this order: a frame is sent at the present, not when the simulation last advanced.
        sim.advance(crate::time::Instant::ZERO + passed);
        while let Some(frame) = shared.pop_tx() {
            sim.transmit(station, frame);
        }
        batch.clear();
        while let Some(frame) = sim.poll_frame(station) {
            let time = start + frame.time.since(crate::time::Instant::ZERO);
            batch.push(frame.with_time(time).with_bus(index));
        }
        if !batch.is_empty() {
            shared.queue.push(&batch);
        }
        report(sim, station, shared);
        let next = sim.next_event().map_or(IDLE, |at| at.since(sim.now()));
        if shared.wait(None, Some(next.clamp(NAP, IDLE))).is_err() {
            return;
        }
    }
}

fn report(sim: &Sim, station: SimStation, shared: &PortShared) {
    let status = sim.status(station);
    shared.queue.update_status(|told| {
        told.bitrate = Some(status.bitrate);
        told.tec = Some(status.tec);
        told.rec = Some(status.rec);
        told.queue_drops = status.rx_overflow;
        told.state = match status.state {
            sim::ControllerState::ErrorActive => BusState::ErrorActive,
            sim::ControllerState::ErrorWarning => BusState::ErrorWarning,
            sim::ControllerState::ErrorPassive => BusState::ErrorPassive,
            sim::ControllerState::BusOff => BusState::BusOff,
            sim::ControllerState::Down => BusState::Down,
        };
    });
}
