//! The built-in systems, simulated from the start: the events that the engine reports.
//!
//! The scenarios' timetables are the ground truth; the snapshots are the reported events.

use crate::common::inspection::{Inspection, describe};
use descan::discovery::Config;
use descan::finding::FindingState;
use descan::sim::Scenario;
use descan::time::Instant;
use std::fmt::Write;

fn told(system: &str, seconds: u64) -> (String, Inspection) {
    let scenario = Scenario::builtin(system).unwrap();
    let mut inspection = Inspection::new(&scenario, scenario.seed, Config::default());
    inspection.run_until(Instant::from_micros(seconds * 1_000_000), |_| false);
    let mut story = String::new();
    for event in &inspection.events {
        let seconds = event.time.as_micros() as f64 / 1e6;
        writeln!(story, "{seconds:8.2}  {}", describe(event)).unwrap();
    }
    (story, inspection)
}

/// Asserts that the final state of the engine matches the simulator.
fn assert_true(inspection: &Inspection) {
    let (sim, engine) = (&inspection.sim, &inspection.engine);
    for id in sim.devices() {
        let truth = sim.device_state(id);
        let (Some(address), Some(mode)) = (truth.address, truth.mode) else { continue };
        let device = engine.device_at(address).unwrap_or_else(|| panic!("{truth:?} is not known"));
        assert!(device.is_named(truth.name), "{truth:?} is known as {:?}", device.name);
        assert_eq!(device.mode, Some(mode), "{truth:?}");
        let services = device.services.as_ref().unwrap_or_else(|| panic!("{truth:?}"));
        let known: Vec<Vec<Vec<u8>>> = services
            .iter()
            .map(|service| {
                let strings = [&service.name, &service.version].into_iter().chain(&service.extra);
                strings.map(|string| string.as_bytes().to_vec()).collect()
            })
            .collect();
        assert_eq!(known, truth.services, "{truth:?}");
    }
    let open = engine.findings().iter().filter(|it| it.state != FindingState::Cleared);
    assert_eq!(open.count(), 0, "nothing is wrong any more");
}

#[test]
fn boiler_scenario_events_match_snapshot() {
    let (story, inspection) = told("boiler", 200);
    assert_true(&inspection);
    insta::assert_snapshot!("boiler", story);
}

#[test]
fn drone_scenario_events_match_snapshot() {
    let (story, inspection) = told("drone", 160);
    assert_true(&inspection);
    insta::assert_snapshot!("drone", story);
}
