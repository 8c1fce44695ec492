//! Nodes on the bit-timed bus of the simulator, found by the engine, with all checks of the random
//! simulation.

use super::{Driver, SEEDS};
use crate::kit::Bench;
use crate::kit::program::{BenchProgram, board_of};
use crate::simulation::random_scenario::{Inspector, World};
use crate::simulation::{Run, checks, link_faults::Lens, tell};
use descan::discovery::Config;
use descan::sim::{DeviceAction, DeviceSpec, Faults, Scenario, Sim};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::{AddressSetting, BitrateSetting};
use descan::wire::id::Address;
use descan::wire::node::{Mode, Uid};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::{Arc, Mutex};

fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// A world without faults, in which nothing changes after `calm`.
fn world_of(seed: u64, scenario: Scenario, calm: Duration, end: Duration) -> World {
    let inspector =
        Inspector { from: Duration::ZERO, config: Config::default(), lens: Lens::default() };
    World {
        seed,
        scenario,
        inspectors: vec![inspector],
        stories: Vec::new(),
        touched: Vec::new(),
        broken: None,
        foreign: None,
        calm,
        end,
    }
}

/// Gives nodes under test to the devices that `is_node` selects.
fn install(sim: &mut Sim, world: &World, is_node: impl Fn(&DeviceSpec) -> bool, loss: f64) {
    let mut random = fastrand::Rng::with_seed(world.seed ^ 0x6B69_7473);
    let bench = Arc::new(Mutex::new(Driver::start()));
    let here = BitrateSetting { rate: world.scenario.bitrate, is_fixed: true };
    for (number, spec) in world.scenario.devices.iter().enumerate() {
        let bitrate = if random.bool() { here.code().unwrap() } else { 0x80 + random.u8(..4) };
        let board = board_of(spec, bitrate, random.u32(..));
        if is_node(spec) {
            let device = sim.device(&spec.label).unwrap();
            let program = BenchProgram::new(Arc::clone(&bench), number, board).losing(loss);
            sim.set_program(device, Box::new(program));
        }
    }
}

/// Returns the check failures of a run; and of addresses: two nodes at one address, or none 20
/// seconds after the last change.
fn complaints(run: &Run) -> Vec<String> {
    let mut wrong = checks::judge(run);
    let mut used = BTreeSet::new();
    for device in &run.devices {
        let state = run.sim.device_state(*device);
        let is_free = state.address.is_none_or(|address| used.insert(address));
        if state.mode.is_some() && (state.address.is_none() || !is_free) {
            let (label, mode, address) = (state.label, state.mode, state.address);
            wrong.push(format!("{label} at {address:?} in {mode:?} has no address of its own"));
        }
    }
    wrong
}

fn is_known(run: &Run, spec: &DeviceSpec) -> bool {
    let device = run.sim.device(&spec.label).unwrap();
    let Some(address) = run.sim.device_state(device).address else { return false };
    run.inspectors[0].engine.device_at(address).is_some_and(|known| {
        let services: Vec<Vec<Vec<u8>>> = (known.services.iter().flatten())
            .map(|it| vec![it.name.as_bytes().to_vec(), it.version.as_bytes().to_vec()])
            .collect();
        known.is_named(&spec.name) && services == spec.services
    })
}

#[test]
fn full_bus_started_at_once_is_found_with_all_services() {
    let mut scenario = Scenario::new(500_000);
    for number in 0..127 {
        let mut spec = DeviceSpec::new(&format!("K{number:03}"));
        spec.uid = Uid([1, 2, 3, 4, 5, number]);
        spec.address = AddressSetting::Preferred(Address::new(number + 1).unwrap());
        for service in 0..number % 3 {
            spec = spec.service(&format!("S{service}"), "1.0");
        }
        scenario = scenario.with(spec);
    }
    let world = world_of(1, scenario, seconds(8.0), seconds(13.0));
    let run = Run::with_programs(world, |sim, world| install(sim, world, |_| true, 0.0));
    assert_eq!(complaints(&run), Vec::<String>::new());
    for spec in &run.world.scenario.devices {
        assert!(is_known(&run, spec), "{}", spec.label);
        let state = run.sim.device_state(run.sim.device(&spec.label).unwrap());
        assert_eq!((state.mode, state.setting.address()), (Some(Mode::Work), state.address));
    }
}

/// Up to 30 nodes that start at once or apart, with equal addresses among them, lose frames, and
/// are switched off and on.
fn random_nodes(seed: u64) -> (World, f64) {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut scenario =
        Scenario::new(*random.choice(&[125_000, 250_000, 500_000, 1_000_000]).unwrap());
    let count = if random.u8(..20) == 0 { 127 } else { random.u8(2..=30) };
    let is_apart = random.bool();
    let mut touched = Vec::new();
    for number in 0..count {
        let name = if random.u8(..8) == 0 { "LONGNAME" } else { "K" };
        let mut spec = DeviceSpec::new(&format!("{name}{number:03}"));
        spec.uid = Uid(if random.u8(..8) == 0 { [0; 6] } else { [9, 8, 7, 6, 5, number] });
        let own = Address::new(number + 1).unwrap();
        let any = Address::new(random.u8(1..=count)).unwrap();
        spec.address = match random.u8(..4) {
            0 => AddressSetting::None,
            1 => AddressSetting::Preferred(any),
            _ => AddressSetting::Preferred(own),
        };
        spec.autostart = random.u8(..5) != 0;
        for service in 0..random.u8(..6) {
            spec = spec.service(&format!("S{service}"), "1.0");
        }
        if is_apart {
            spec.power_on = Some(Duration::from_millis(random.u64(..9000)));
        }
        // Any address may be taken by any of them.
        touched.push(spec.label.clone());
        scenario = scenario.with(spec);
    }
    let moment = |random: &mut fastrand::Rng| Duration::from_millis(random.u64(5000..18_000));
    for _ in 0..random.u8(..=count.min(8)) {
        let label = touched[random.usize(..touched.len())].clone();
        let at = moment(&mut random);
        if random.bool() {
            scenario = scenario.at(at, &label, DeviceAction::Reboot { services: None });
        } else {
            let back = at + Duration::from_millis(random.u64(1..4000));
            scenario = scenario.at(at, &label, DeviceAction::PowerOff);
            scenario = scenario.at(back, &label, DeviceAction::PowerOn);
        }
    }
    if random.u8(..3) == 0 {
        scenario.frame_error_probability = random.f64() * 0.03;
    }
    let mut broken = None;
    if random.u8(..4) == 0 {
        let (at, rate) = (moment(&mut random), 0.2 + 0.8 * random.f64());
        let until = at + Duration::from_millis(random.u64(50..3000));
        let quiet = scenario.frame_error_probability;
        broken = Some((at, until));
        scenario = scenario.at(at, "", DeviceAction::SetFrameErrorProbability(rate));
        scenario = scenario.at(until, "", DeviceAction::SetFrameErrorProbability(quiet));
    }
    let loss = if random.u8(..3) == 0 { random.f64() * 0.05 } else { 0.0 };
    let world = world_of(seed, scenario, seconds(22.0), seconds(46.0));
    (World { touched, broken, ..world }, loss)
}

/// Random worlds of the simulation, in which nodes under test replace the devices that behave as they
/// do.
fn mixed(seed: u64) -> World {
    let mut world = World::new(seed);
    for spec in &mut world.scenario.devices {
        if is_replaceable(spec, &world.scenario.timetable) {
            spec.max_heartbeat_delay = Duration::ZERO;
            spec.skips_address_resolution = false;
        }
    }
    world
}

fn is_replaceable(spec: &DeviceSpec, timetable: &[descan::sim::TimetableEvent]) -> bool {
    let is_plain = spec.faults == Faults::default()
        && spec.heartbeat.is_none()
        && spec.periodic_messages.is_empty()
        && matches!(spec.mode, None | Some(Mode::Cfg));
    let is_power = |action: &DeviceAction| {
        matches!(
            action,
            DeviceAction::PowerOn
                | DeviceAction::PowerOff
                | DeviceAction::Reboot { services: None }
        )
    };
    let mut own = timetable.iter().filter(|entry| entry.device == spec.label);
    is_plain && own.all(|entry| is_power(&entry.action))
}

/// Checks a range of seeds; prints the events of a single one.
fn sweep(default: u64, check: impl Fn(u64) -> Run, judge: impl Fn(&Run) -> Vec<String>) {
    let number = |name| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let one = number("SEED");
    let first = one.or(number("FIRST")).unwrap_or(0);
    let seeds = if one.is_some() { 1 } else { number("SEEDS").unwrap_or(default) };
    let mut text = String::new();
    for seed in first..first + seeds {
        let run = check(seed);
        if one.is_some() {
            tell(&run);
        }
        for line in judge(&run) {
            writeln!(text, "seed {seed}: {line}").unwrap();
        }
    }
    assert!(text.is_empty(), "{text}");
}

fn run_random(seed: u64) -> Run {
    let (world, loss) = random_nodes(seed);
    Run::with_programs(world, |sim, world| install(sim, world, |_| true, loss))
}

fn run_mixed(seed: u64) -> Run {
    Run::with_programs(mixed(seed), |sim, world| {
        install(sim, world, |spec| is_replaceable(spec, &world.scenario.timetable), 0.0);
    })
}

#[test]
fn random_buses_of_nodes_keep_all_invariants() {
    sweep(SEEDS, run_random, complaints);
}

#[test]
fn nodes_among_simulated_devices_keep_all_invariants() {
    sweep(SEEDS, run_mixed, checks::judge);
}

/// By hand: `SEEDS=1000 FIRST=0 cargo test --release --test it kit::rust::simulation -- --ignored`.
#[test]
#[ignore = "takes minutes"]
fn many_random_buses_keep_all_invariants() {
    sweep(400, run_random, complaints);
    sweep(400, run_mixed, checks::judge);
}

/// Two nodes alone, the second one switched on `gap` seconds after the first. Returns the time until
/// both have an address, from then on.
fn two_alone(seed: u64, gap: f64, bitrates: [u8; 2], end: f64) -> Option<Duration> {
    let mut scenario = Scenario::new(125_000);
    for number in [1, 2] {
        let mut spec = DeviceSpec::new(&format!("K{number}")).fixed(number);
        spec.power_on = Some(seconds(f64::from(number - 1) * gap));
        scenario = scenario.with(spec);
    }
    let mut sim = Sim::new(&scenario, seed);
    let bench = Arc::new(Mutex::new(Driver::start()));
    let mut random = fastrand::Rng::with_seed(seed);
    for (number, spec) in scenario.devices.iter().enumerate() {
        let board = board_of(spec, bitrates[number], random.u32(..));
        let program = BenchProgram::new(Arc::clone(&bench), number, board);
        sim.set_program(sim.device(&spec.label).unwrap(), Box::new(program));
    }
    let devices: Vec<_> = sim.devices().collect();
    let step = Duration::from_millis(50);
    while sim.now() < Instant::ZERO + seconds(end + gap) {
        sim.advance(sim.now() + step);
        if devices.iter().all(|device| sim.device_state(*device).address.is_some()) {
            return Some(sim.now().since(Instant::ZERO + seconds(gap)));
        }
    }
    None
}

#[test]
fn two_nodes_alone_find_each_other_at_a_fixed_bit_rate() {
    const FIXED: u8 = 0;
    let mut random = fastrand::Rng::with_seed(7);
    for seed in 0..2 * SEEDS {
        let gap = random.f64() * 30.0;
        let time = two_alone(seed, gap, [FIXED; 2], 20.0);
        assert!(time.is_some(), "seed {seed}, {gap} s apart");
    }
}
