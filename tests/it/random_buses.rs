//! Small random buses: conforming devices are identified correctly on any bus, discovery comes to
//! an end, and no conflict is confirmed by mistake.
//!
//! `WORLDS=300 cargo test --test it random_buses` tries more of them; `WORLD=17` tries one.

use crate::common::inspection::{FAULTS, Inspection, describe};
use descan::discovery::{Config, Presence};
use descan::finding::{FindingKind, FindingState};
use descan::sim::{DeviceFraming, DeviceSpec, Fault, Scenario};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Address;
use descan::wire::node::{Mode, Uid};
use std::fmt::Write;

fn world(seed: u64) -> Scenario {
    let mut rng = fastrand::Rng::with_seed(seed);
    let bitrate = *rng.choice(&[125_000, 250_000, 500_000, 1_000_000]).unwrap();
    let mut scenario = Scenario::new(bitrate);
    if rng.u8(..4) == 0 {
        scenario.frame_error_probability = 0.01;
    }
    if rng.u8(..4) == 0 {
        scenario.rx_loss = 0.01;
    }
    let mut addresses: Vec<u8> = (1..128).collect();
    rng.shuffle(&mut addresses);
    let busy = rng.u8(..6) == 0;
    for (number, address) in addresses.into_iter().take(rng.usize(1..=40)).enumerate() {
        let twin = rng.u8(..10) == 0;
        let long = rng.u8(..10) == 0;
        let name = match (twin, long) {
            (true, _) => "TWIN".to_owned(),
            (_, true) => format!("LONGNAME{number:03}"),
            _ => format!("N{number:03}"),
        };
        let uid =
            if rng.u8(..8) == 0 { Uid([0; 6]) } else { Uid([1, 2, 3, 4, seed as u8, address]) };
        let mut device = DeviceSpec::new(&name).label(&format!("{number}")).uid(uid).fixed(address);
        // From the start, another node must acknowledge.
        device = if number == 0 || rng.bool() {
            device.skips_address_resolution()
        } else {
            device.power_on(Duration::from_millis(rng.u64(..8000)))
        };
        if rng.u8(..4) == 0 {
            device.mode = Some(Mode::Cfg);
        }
        let framing =
            *rng.choice(&[DeviceFraming::Isotp, DeviceFraming::Raw, DeviceFraming::Both]).unwrap();
        if framing == DeviceFraming::Raw {
            device.services.clear();
            if long && !twin {
                device.name.truncate(6);
                device.name = format!("L{number:03}").into_bytes();
            }
        } else {
            for service in 0..rng.usize(..12) {
                device = device.service(&format!("S{service}"), "1.0");
            }
        }
        device = device.framing(framing);
        device.fd = framing != DeviceFraming::Raw && rng.u8(..6) == 0;
        if rng.u8(..6) == 0 {
            device.response_delay =
                (Duration::from_millis(20), Duration::from_millis(rng.u64(21..150)));
        }
        if rng.u8(..6) == 0 {
            device.max_heartbeat_delay = Duration::from_millis(rng.u64(1..80));
        }
        if rng.u8(..5) == 0 {
            let fault = *rng.choice(&FAULTS).unwrap();
            device = device.fault(fault);
        }
        if rng.u8(..6) == 0 || busy {
            // In total no more than the bus can carry.
            let period = 6_000_000 / u64::from(bitrate / 1000) * rng.u64(1..8);
            device = device.periodic_message(0x100, Duration::from_micros(period), 8);
        }
        scenario = scenario.with(device);
    }
    scenario
}

fn tried(seed: u64, config: Config, wrong: &mut String) {
    let scenario = world(seed);
    let loss = scenario.rx_loss > 0.0;
    let mut inspection = Inspection::new(&scenario, seed, config);
    let end = Instant::from_micros(30_000_000);
    inspection.run_until(end, |_| false);
    let settled =
        inspection.run_until(end + Duration::from_secs(20), |engine| engine.progress().is_complete);
    let mut complain = |what: String| writeln!(wrong, "world {seed}: {what}").unwrap();
    let Inspection { sim, engine, .. } = &inspection;
    if !settled {
        complain(format!("never settled: {:?}", engine.progress()));
    }
    for (id, spec) in sim.devices().zip(&scenario.devices) {
        let truth = sim.device_state(id);
        let (Some(address), Some(_)) = (truth.address, truth.mode) else { continue };
        if FAULTS.iter().any(|fault| {
            spec.faults.has(*fault)
                && *fault != Fault::RepeatsRequestDst
                && *fault != Fault::NoHeartbeat
        }) {
            continue;
        }
        let Some(device) = engine.device_at(address) else {
            complain(format!("{truth:?} is not known"));
            continue;
        };
        if !device.is_named(truth.name) {
            complain(format!("{truth:?} is known as {:?}", device.name));
        }
        let services: Option<Vec<Vec<Vec<u8>>>> = device.services.as_ref().map(|services| {
            services
                .iter()
                .map(|service| {
                    let strings =
                        [&service.name, &service.version].into_iter().chain(&service.extra);
                    strings.map(|string| string.as_bytes().to_vec()).collect()
                })
                .collect()
        });
        let unlucky = loss && device.services_query.fault.is_some();
        if services.as_deref() != Some(truth.services) && !unlucky {
            complain(format!(
                "{truth:?} lists {:?}, {:?} {:?} {:?}",
                services.map(|s| s.len()),
                device.framing,
                device.deviations,
                device.services_query
            ));
        }
        let beats = !spec.faults.has(Fault::NoHeartbeat);
        if device.presence != Presence::Online && !loss && beats {
            complain(format!("{truth:?} is {}", device.presence));
        }
        if spec.faults.has(Fault::NoHeartbeat) {
            continue;
        }
        if device.mode != truth.mode {
            complain(format!("{truth:?} is in {:?}", device.mode));
        }
    }
    let known = engine.devices().iter().map(|device| device.address).collect::<Vec<_>>();
    for address in Address::all() {
        let rows = known.iter().filter(|known| **known == address).count();
        if rows > 1 {
            complain(format!("{rows} rows at {address}"));
        }
    }
    for finding in engine.findings() {
        // Bus errors occur at random or not at all; no device causes them.
        let blamed = finding.key.kind == FindingKind::BusErrors && finding.key.address.is_some();
        let collision = finding.key.kind.is_conflict();
        if blamed || collision && finding.state == FindingState::Confirmed {
            complain(format!(
                "{} at {:?}: {:?}",
                finding.key.kind, finding.key.address, finding.evidence
            ));
        }
    }
    for event in &inspection.events {
        use descan::discovery::EventKind as K;
        let quiet = scenario.devices.iter().any(|spec| {
            spec.address == event.address.map_or(spec.address, AddressSetting::Fixed)
                && spec.faults.has(Fault::NoHeartbeat)
        });
        let odd = match &event.kind {
            K::Moved { .. } | K::OwnAddressLost(_) => true,
            K::NoAck => event.time > Instant::from_micros(10_000_000),
            K::Presence(_) | K::Returned { .. } | K::Rebooted => !loss && !quiet,
            K::Finding { key, state } => {
                key.kind.is_conflict() && *state == FindingState::Confirmed
            }
            _ => false,
        };
        if odd {
            complain(format!("{:?} {}", event.time, describe(event)));
        }
    }
}

#[test]
fn random_buses_meet_all_invariants() {
    let number = |name| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let worlds = match number("WORLD") {
        Some(seed) => seed..seed + 1,
        None => 0..number("WORLDS").unwrap_or(25),
    };
    let mut wrong = String::new();
    for seed in worlds {
        tried(seed, Config::default(), &mut wrong);
        let no_rounds = Config { round_period: Duration::ZERO, ..Config::default() };
        if seed % 3 == 0 {
            tried(seed, no_rounds, &mut wrong);
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}
