//! Discovery on simulated buses: every kind of device is found, with its services, whatever its
//! framing; what we send keeps to its share; listening only sends nothing.

mod common;

use common::Inspection;
use descan::discovery::{Config, FindingKind, OwnAddress, Presence, QueryState, Quirk};
use descan::frame::Frame;
use descan::sim::{Action, DeviceFraming, DeviceSpec, Fault, Scenario, Sim};
use descan::time::{Duration, Instant};
use descan::wire::framing::Framing;
use descan::wire::id::{Address, Header};
use descan::wire::profile::Profile;
use std::sync::Arc;

fn seconds(seconds: f64) -> Instant {
    Instant::from_micros((seconds * 1e6) as u64)
}

fn settled(scenario: &Scenario, config: Config) -> Inspection {
    let mut it = Inspection::new(scenario, 3, config);
    let done = it.run_until(seconds(20.0), |engine| engine.progress().settled);
    assert!(done, "it settles: {:?}", it.engine.progress());
    it
}

fn device(it: &Inspection, address: u8) -> &descan::discovery::Device {
    it.engine.device_at(Address::new(address).unwrap()).expect("a device at that address")
}

#[test]
fn every_framing_is_understood() {
    let long = "a-version-that-takes-many-frames-to-say".repeat(4);
    let make = |name: &str, address| DeviceSpec::new(name).fixed(address).settled();
    let mut fd = make("FD", 4).service("WIDE", &long);
    fd.fd = true;
    let mut cfg = make("CFG", 5).service("SETUP", "1");
    cfg.autostart = false;
    let mut scenario = Scenario::new(500_000)
        .with(make("A-NAME-LONGER-THAN-A-FRAME", 1).service("LONG", &long))
        .with(make("RAW", 2).framing(DeviceFraming::Raw))
        .with(make("BOTH", 3).framing(DeviceFraming::Both).service("X", "2"))
        .with(fd)
        .with(cfg)
        .with(make("ECHO", 6).fault(Fault::EchoDestination).service("Y", "3"));
    scenario.data_bitrate = 2_000_000;
    // What fits one frame raw: no service at all.
    scenario.devices[1].services = vec![vec![b"A".to_vec(), b"1".to_vec()]];
    let it = settled(&scenario, Config::default());
    let services = |address: u8| {
        let known = device(&it, address).services.as_ref().expect("services");
        known.iter().map(|s| format!("{} {}", s.name, s.version)).collect::<Vec<_>>()
    };
    assert!(device(&it, 1).is_named(b"A-NAME-LONGER-THAN-A-FRAME"));
    assert_eq!(services(1), ["DES 1.0".to_owned(), format!("LONG {long}")]);
    assert_eq!(services(2), ["A 1"]);
    assert_eq!(device(&it, 2).framing, Some(Framing::Raw));
    assert_eq!(services(3), ["DES 1.0", "X 2"]);
    assert_eq!(services(4), ["DES 1.0".to_owned(), format!("WIDE {long}")]);
    assert!(it.frames.iter().any(|frame| frame.fd), "answers came in FD frames");
    assert_eq!(services(5), ["DES 1.0", "SETUP 1"]);
    assert!(!device(&it, 5).working);
    assert_eq!(services(6), ["DES 1.0", "Y 3"]);
    assert!(device(&it, 6).quirks.contains(&Quirk::RspDstEcho));
}

#[test]
fn another_profile_has_other_numbers() {
    let profile = Profile::parse(
        "framing = \"isotp\"\n[services]\nheartbeat = 0x155\ndes = 0x2AA\n[heartbeat]\nperiod_ms = 500\n\
         uid_offset = 1\nmode_offset = 0\nerror_offset = 7\n[modes]\nWORK = 40\nINIT = 41\n",
    )
    .unwrap();
    let scenario = Scenario::new(250_000)
        .with(DeviceSpec::new("FEED").fixed(12).settled().service("AUGER", "2.1"));
    let config = Config { profile: Arc::new(profile.clone()), ..Config::default() };
    let mut it = Inspection::new(&scenario, 3, config);
    it.sim = Sim::with_profile(&scenario, 3, profile);
    it.station = it.sim.attach();
    assert!(it.run_until(seconds(10.0), |engine| engine.progress().settled));
    let feed = device(&it, 12);
    assert!(feed.is_named(b"FEED"));
    assert_eq!(feed.mode.map(descan::wire::node::Mode::name), Some("WORK"));
    assert_eq!(feed.services.as_ref().map(Vec::len), Some(2));
    let asked = it.frames.iter().filter(|frame| frame.ours && frame.data().starts_with(b"DES"));
    assert_eq!(asked.count(), 0, "asked in ISO 15765-2 alone, as the profile says");
}

#[test]
fn faults_are_told_and_end() {
    let faulty = |name: &str, address, fault| {
        let device = DeviceSpec::new(name).fixed(address).settled().fault(fault);
        device.service("SOME", "1.0").service("MORE", "2.0")
    };
    let scenario = Scenario::new(250_000)
        .with(faulty("MUTE", 1, Fault::NoServices))
        .with(faulty("GHOST", 2, Fault::NoDes))
        .with(faulty("DROPS", 3, Fault::DropFrame))
        .with(faulty("ORDER", 4, Fault::WrongSequence))
        .with(faulty("ENDLS", 5, Fault::Endless))
        .with(faulty("HUGE", 6, Fault::HugeLength))
        .with(faulty("CUT", 7, Fault::TruncatedServices))
        .with(DeviceSpec::new("GOOD").fixed(9).settled());
    let mut it = Inspection::new(&scenario, 3, Config::default());
    it.run_until(seconds(25.0), |_| false);
    assert_eq!(device(&it, 1).services_query.state, QueryState::Unanswered);
    assert!(device(&it, 1).is_named(b"MUTE"), "a name without services is shown as just that");
    assert_eq!(device(&it, 2).name, None);
    assert_eq!(device(&it, 2).presence, Presence::Online);
    for address in [3, 4, 6] {
        let query = &device(&it, address).services_query;
        let given_up = query.fault.is_some() && query.state != QueryState::Answered;
        assert!(given_up, "{address}: {query:?}");
    }
    for (address, what) in [(3, "out of sequence"), (4, "out of sequence"), (6, "4095")] {
        let malformed = it.engine.findings().iter().find(|finding| {
            finding.key.kind == FindingKind::MalformedAnswer
                && finding.key.address == Address::new(address)
        });
        let finding = malformed.unwrap_or_else(|| panic!("a finding at {address}"));
        assert!(finding.text.contains(what), "{}", finding.text);
        assert!(finding.evidence.iter().all(|piece| piece.frame.is_some()));
    }
    // The frames behind a message that is whole are nobody's.
    assert!(device(&it, 5).services.is_some());
    assert!(device(&it, 9).services.is_some());
    assert!(it.engine.progress().settled, "{:?}", it.engine.progress());
    assert!(it.engine.counters().transfers_failed > 0);
}

/// The share of the bus that our frames took between the first and the last of them.
fn our_share(it: &Inspection, from: Instant, to: Instant) -> f64 {
    let ours = it.frames.iter().filter(|it| it.ours && it.time >= from && it.time < to);
    let taken: Duration = ours.map(|frame| it.sim.frame_duration(frame)).sum();
    taken.as_secs_f64() / to.since(from).as_secs_f64()
}

#[test]
fn what_we_send_keeps_to_its_share() {
    let scenario = Scenario::crowd(125_000, 60, 3);
    let slow = Config { start_share: 0.02, ..Config::default() };
    let mut it = Inspection::new(&scenario, 3, slow);
    assert!(it.run_until(seconds(60.0), |engine| engine.progress().with_services == 60));
    let end = it.sim.now();
    let share = our_share(&it, seconds(1.5), end);
    assert!(share <= 0.025, "{share}");
    // And with nothing in the way it uses what it may.
    let mut quick = Inspection::new(&scenario, 3, Config::default());
    assert!(quick.run_until(seconds(60.0), |engine| engine.progress().with_services == 60));
    assert!(quick.sim.now().since(seconds(1.5)) * 3 < end.since(seconds(1.5)));
    quick.run_until(seconds(60.0), |_| false);
    let steady = our_share(&quick, seconds(20.0), seconds(60.0));
    assert!(steady <= 0.05, "{steady}");
}

#[test]
fn listening_only_sends_nothing_and_learns_from_others() {
    let scenario = Scenario::crowd(250_000, 10, 2);
    let mut sim = Sim::new(&scenario, 5);
    let (asking, listening) = (sim.attach(), sim.attach());
    let config = Config { bitrate: Some(250_000), ..Config::default() };
    let mut asker = descan::discovery::Engine::new(Instant::ZERO, config.clone());
    let silent = Config { listen_only: true, ..config };
    let mut listener = descan::discovery::Engine::new(Instant::ZERO, silent);
    while sim.now() < seconds(8.0) {
        let now = sim.now();
        for (station, engine) in [(asking, &mut asker), (listening, &mut listener)] {
            while let Some(frame) = sim.poll_frame(station) {
                engine.handle_frame(&frame);
            }
            engine.handle_timeout(now);
        }
        while let Some(frame) = asker.poll_transmit(now) {
            sim.transmit(asking, frame);
        }
        assert!(listener.poll_transmit(now).is_none());
        let next = [asker.poll_timeout(), listener.poll_timeout(), sim.next_event()];
        let next = next.into_iter().flatten().min().unwrap_or(seconds(8.0));
        sim.advance(next.max(now + Duration::from_micros(1)));
    }
    let known = |engine: &descan::discovery::Engine| engine.progress().with_services;
    // The asker itself is a debug device that answers nobody here: it knows ten.
    assert_eq!((known(&asker), known(&listener)), (10, 10));
}

#[test]
fn without_scan_nobody_is_asked() {
    let scenario = Scenario::crowd(250_000, 5, 1);
    let mut it = Inspection::new(&scenario, 3, Config { scan: false, ..Config::default() });
    it.run_until(seconds(6.0), |_| false);
    let profile = Profile::default();
    let asked = |frame: &&Frame| {
        frame.ours && Header::decode(frame.platform_id().unwrap()).service == profile.des_service()
    };
    assert_eq!(it.frames.iter().filter(asked).count(), 0);
    assert_eq!(it.engine.progress().here, 5, "their heartbeats make them rows");
}

#[test]
fn new_firmware_after_a_reboot_is_noticed() {
    let services = vec![vec![b"DES".to_vec(), b"1.1".to_vec()]];
    let scenario = Scenario::crowd(125_000, 3, 1).at(
        Duration::from_secs(6),
        "N002",
        Action::Reboot { services: Some(services) },
    );
    let mut it = Inspection::new(&scenario, 3, Config::default());
    it.run_until(seconds(14.0), |_| false);
    let rebooted = device(&it, 2);
    let known: Vec<_> = rebooted.services.iter().flatten().map(|s| s.version.to_string()).collect();
    assert_eq!(known, ["1.1"]);
    assert_eq!(rebooted.previous_services.as_ref().map(Vec::len), Some(2), "what it had before");
    assert_eq!(rebooted.reboots, 1);
}

#[test]
fn inspectors_that_start_together_end_at_addresses_of_their_own() {
    for seed in 0..20 {
        let mut sim = Sim::new(&Scenario::crowd(250_000, 5, 1), seed);
        let mut inspectors: Vec<_> = (0..4)
            .map(|at| {
                let config =
                    Config { bitrate: Some(250_000), seed: seed * 100 + at, ..Config::default() };
                (sim.attach(), descan::discovery::Engine::new(Instant::ZERO, config))
            })
            .collect();
        while sim.now() < seconds(20.0) {
            let now = sim.now();
            for (station, engine) in &mut inspectors {
                while let Some(frame) = sim.poll_frame(*station) {
                    engine.handle_frame(&frame);
                }
                engine.handle_timeout(now);
                while let Some(frame) = engine.poll_transmit(now) {
                    sim.transmit(*station, frame);
                }
            }
            let due = inspectors.iter().filter_map(|(_, engine)| engine.poll_timeout());
            let next = due.chain(sim.next_event()).min().unwrap_or(seconds(20.0));
            sim.advance(next.max(now + Duration::from_micros(1)));
        }
        let mut held: Vec<u8> = inspectors
            .iter()
            .map(|(_, engine)| match engine.own_address() {
                OwnAddress::Held(address) => address.number(),
                other => panic!("seed {seed}: {other:?}"),
            })
            .collect();
        held.sort_unstable();
        held.dedup();
        assert_eq!(held.len(), 4, "seed {seed}: {held:?}");
        assert!(held.iter().all(|address| !(1..=5).contains(address)), "a device's: {held:?}");
    }
}
