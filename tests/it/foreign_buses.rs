//! Buses that do not speak DES, or not alone: other protocols in 11-bit and 29-bit identifiers.

use descan::discovery::{BusVerdict, Config, Device, Engine, EventKind};
use descan::frame::{CanId, Frame};
use descan::time::Instant;
use descan::wire::id::Header;
use descan::wire::profile::{Announce, Profile};
use std::sync::Arc;

/// A frame of another protocol at a time in milliseconds.
type Traffic = Vec<(u64, Frame)>;

/// Frames with random 29-bit identifiers, some hundred of them again and again, as in J1939.
fn random_29_bit(seed: u64, until: u64) -> Traffic {
    let mut rng = fastrand::Rng::with_seed(seed);
    let ids: Vec<u32> = (0..100).map(|_| rng.u32(..1 << 29)).collect();
    let frame = |rng: &mut fastrand::Rng| {
        let data: [u8; 8] = std::array::from_fn(|_| rng.u8(..));
        Frame::classic(ids[rng.usize(..ids.len())], &data)
    };
    (0..until).step_by(5).map(|at| (at, frame(&mut rng))).collect()
}

/// Frames with 11-bit identifiers, as in CANopen.
fn standard(until: u64) -> Traffic {
    let frame = |at: u64| Frame::new(CanId::standard(0x180 + at as u32 % 20).unwrap(), &[1; 8]);
    (0..until).step_by(7).map(|at| (at, frame(at))).collect()
}

/// Frames of NMEA 2000, most of them with the priority 2 of fast measurements, in whose identifiers
/// the bits of the platform's message type are those of a request.
fn nmea_2000(until: u64) -> Traffic {
    let mut rng = fastrand::Rng::with_seed(2000);
    // Rate of turn, attitude, heading; wind, water depth, and the position, with their priorities.
    let fast = [(2, 127_251), (3, 127_257), (2, 127_250), (2, 129_025), (2, 130_306), (2, 129_026)];
    let frame = |rng: &mut fastrand::Rng| {
        let (priority, number) =
            if rng.u8(..10) < 8 { fast[0] } else { *rng.choice(&fast).unwrap() };
        let (priority, number) = if rng.u8(..4) == 0 { (6, 128_267) } else { (priority, number) };
        let id = priority << 26 | number << 8 | rng.u32(1..9);
        Frame::classic(id, &std::array::from_fn::<u8, 8, _>(|_| rng.u8(..)))
    };
    (0..until).step_by(5).map(|at| (at, frame(&mut rng))).collect()
}

/// Data of a heartbeat in WORK.
const FITTING: [u8; 8] = [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 4, 0];

/// A frame of address 12 that fits a heartbeat.
fn plausible(at: u64, rnd7: u32, data: [u8; 8]) -> (u64, Frame) {
    (at, Frame::classic(0x0700_0001 | 12 << 17 | rnd7 << 10, &data))
}

/// A heartbeat of address 12 each second.
fn heartbeats(until: u64) -> Traffic {
    let times = (400..until).step_by(1000);
    times.map(|at| plausible(at, at as u32 / 1000 % 128, FITTING)).collect()
}

/// An engine that received frames until a time in milliseconds, and the frames that it sent.
fn observed(traffic: Traffic, until: u64) -> (Engine, Vec<Frame>) {
    observed_with(Config::default(), traffic, until)
}

fn observed_with(config: Config, mut traffic: Traffic, until: u64) -> (Engine, Vec<Frame>) {
    traffic.sort_by_key(|(at, _)| *at);
    let config = Config { has_loopback: false, ..config };
    let mut engine = Engine::new(Instant::ZERO, config);
    let mut sent = Vec::new();
    let mut advance = |engine: &mut Engine, to: Instant| {
        while let Some(due) = engine.poll_timeout().filter(|due| *due <= to) {
            engine.handle_timeout(due);
            sent.extend(std::iter::from_fn(|| engine.poll_transmit(due)));
        }
    };
    for (at, frame) in traffic {
        let at = Instant::from_micros(at * 1000);
        advance(&mut engine, at);
        engine.handle_frame(&frame.with_time(at));
    }
    advance(&mut engine, Instant::from_micros(until * 1000));
    (engine, sent)
}

#[test]
fn foreign_bus_has_one_verdict_and_nothing_is_sent() {
    let random = (0..50).map(|seed| (format!("29 bits, seed {seed}"), random_29_bit(seed, 20_000)));
    for (name, traffic) in random.chain([
        ("11 bits".to_owned(), standard(20_000)),
        ("NMEA 2000".to_owned(), nmea_2000(20_000)),
    ]) {
        let (engine, sent) = observed(traffic, 20_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Foreign, "{name}");
        assert!(engine.traffic().foreign_reason().is_some(), "{name}");
        assert_eq!(sent, [], "{name}");
        assert!(engine.devices().is_empty(), "{name}");
        assert!(engine.findings().is_empty(), "{name}");
        assert!(engine.progress().is_complete, "{name}");
    }
}

#[test]
fn foreign_bus_is_asked_on_request() {
    let (mut engine, _) = observed(standard(5000), 5000);
    let now = Instant::from_micros(5_000_000);
    engine.rescan(now);
    engine.handle_timeout(now);
    assert!(engine.poll_transmit(now).is_some());
}

#[test]
fn devices_among_foreign_nodes_are_found() {
    for foreign in [standard(20_000), random_29_bit(7, 20_000)] {
        let traffic = [foreign, heartbeats(20_000)].concat();
        let (engine, sent) = observed(traffic, 20_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Des);
        let row = engine.devices().iter().find(|device| device.address.number() == 12);
        assert!(row.is_some_and(Device::is_present));
        assert!(!sent.is_empty());
    }
}

#[test]
fn many_devices_among_foreign_nodes_are_found() {
    let numbers = 1..=60;
    let beat = |at: u64, number: u8| {
        let id = 0x0700_0001 | u32::from(number) << 17 | (at as u32 / 1000 % 128) << 10;
        (at + u64::from(number), Frame::classic(id, &[0x11, 0x22, 0x33, 0x44, 0x55, number, 4, 0]))
    };
    let beats =
        (400..20_000).step_by(1000).flat_map(|at| numbers.clone().map(move |it| beat(at, it)));
    let (engine, _) = observed(standard(20_000).into_iter().chain(beats).collect(), 20_000);
    assert_eq!(engine.traffic().verdict(), BusVerdict::Des);
    assert_eq!(engine.devices().iter().filter(|device| device.is_present()).count(), 60);
}

#[test]
fn heartbeat_on_a_foreign_bus_starts_the_rounds() {
    let traffic = standard(20_000).into_iter();
    let late = heartbeats(20_000).into_iter().filter(|(at, _)| *at > 10_000);
    let (engine, sent) = observed(traffic.chain(late).collect(), 20_000);
    assert!(!sent.is_empty());
    assert!(engine.device_at(descan::wire::id::Address::new(12).unwrap()).is_some());
}

#[test]
fn silent_bus_is_asked_again_and_again() {
    let (engine, sent) = observed(Traffic::new(), 60_000);
    assert_eq!(engine.traffic().verdict(), BusVerdict::Silent);
    assert!(sent.len() >= 4 * 4, "{} requests", sent.len());
}

#[test]
fn given_profile_sends_no_heartbeat_on_a_foreign_bus() {
    for announce in [Announce::Auto, Announce::Always] {
        let mut profile = Profile::parse("services.heartbeat = 0x001").unwrap();
        profile.heartbeat.announce = announce;
        let config = || Config { profile: Arc::new(profile.clone()), ..Config::default() };
        let (_, sent) = observed_with(config(), standard(20_000), 20_000);
        assert_eq!(sent, []);
        let (_, sent) = observed_with(config(), Traffic::new(), 20_000);
        let heartbeat = profile.heartbeat_service();
        let is_heartbeat = |frame: &&Frame| {
            frame.platform_id().is_some_and(|id| Header::decode(id).service == heartbeat)
        };
        assert!(sent.iter().any(|frame| is_heartbeat(&frame)), "a silent bus is told");
    }
}

/// Frames of address 48 that fit a heartbeat, with constant RND7, UID and mode.
fn constant_heartbeats(period: u64, until: u64) -> Traffic {
    let frame = Frame::classic(0x1460_D801, &[0, 0x7E, 0xB1, 0x5C, 0xD0, 0x5C, 2]);
    (300..until).step_by(period as usize).map(|at| (at, frame)).collect()
}

#[test]
fn constant_data_of_another_protocol_is_not_a_heartbeat() {
    for period in [20, 100, 500] {
        let traffic = [standard(60_000), constant_heartbeats(period, 60_000)].concat();
        let (engine, sent) = observed(traffic, 60_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Foreign, "each {period} ms");
        assert!(engine.devices().is_empty() && sent.is_empty(), "each {period} ms");
    }
}

#[test]
fn heartbeats_with_constant_rnd7_among_foreign_nodes_are_found() {
    let traffic = [standard(20_000), constant_heartbeats(1000, 20_000)].concat();
    let (engine, _) = observed(traffic, 20_000);
    let found: Vec<u8> = engine.devices().iter().map(|it| it.address.number()).collect();
    assert_eq!((engine.traffic().verdict(), found.contains(&48)), (BusVerdict::Des, true));
}

#[test]
fn heartbeat_by_chance_at_first_is_refuted_by_the_next_frames() {
    for foreign in [standard(20_000), nmea_2000(20_000)] {
        let later = foreign.into_iter().map(|(at, frame)| (at + 1, frame));
        let traffic: Traffic = [plausible(0, 9, FITTING)].into_iter().chain(later).collect();
        let (mut engine, _) = observed(traffic, 20_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Foreign);
        assert!(engine.devices().is_empty() && engine.findings().is_empty());
        let events: Vec<EventKind> =
            std::iter::from_fn(|| engine.poll_event()).map(|event| event.kind).collect();
        assert!(events.iter().any(|kind| matches!(kind, EventKind::Removed)), "{events:?}");
    }
}

#[test]
fn first_heartbeat_is_not_refuted_by_11_bit_frames() {
    let later = standard(20_000).into_iter().map(|(at, frame)| (at + 450, frame));
    for beats in [heartbeats(20_000), constant_heartbeats(1000, 20_000)] {
        let (mut engine, _) = observed(later.clone().chain(beats).collect(), 20_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Des);
        let [device] = engine.devices() else { panic!("one device") };
        assert!(device.first_seen < Instant::from_micros(500_000));
        let mut events = std::iter::from_fn(|| engine.poll_event());
        assert!(events.all(|event| !matches!(event.kind, EventKind::Removed)));
    }
}

#[test]
fn changing_data_of_one_identifier_is_no_heartbeat() {
    for interval in [250, 500, 1000] {
        let frames = (0..60_000).step_by(interval).map(|at: u64| {
            let mut data = FITTING;
            data[2] ^= (at / 1000 % 2) as u8;
            plausible(at, 9, data)
        });
        let (engine, _) = observed(standard(60_000).into_iter().chain(frames).collect(), 60_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Foreign, "every {interval} ms");
    }
}

#[test]
fn constant_data_of_half_the_period_with_losses_is_no_heartbeat() {
    for seed in 0..200 {
        let mut rng = fastrand::Rng::with_seed(seed);
        let received = (0..120_000).step_by(500).filter(|_| rng.f64() >= 0.3);
        let frames: Traffic = received.map(|at| plausible(at, 9, FITTING)).collect();
        let (engine, _) = observed([standard(120_000), frames].concat(), 120_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Foreign, "seed {seed}");
    }
}

#[test]
fn constant_rnd7_with_losses_is_of_a_device() {
    let late = (0..200).filter(|seed| {
        let mut rng = fastrand::Rng::with_seed(*seed);
        let received = (400..60_000).step_by(1000).filter(|_| rng.f64() >= 0.3);
        let frames: Traffic = received.map(|at| plausible(at, 9, FITTING)).collect();
        let (engine, _) = observed([standard(60_000), frames].concat(), 60_000);
        let [device] = engine.devices() else { panic!("seed {seed}") };
        device.first_seen.as_micros() > 20_000_000
    });
    assert!(late.count() <= 10, "5 % need more than 20 s");
}

#[test]
fn heartbeat_with_a_wrong_u_bit_is_of_a_device_on_a_quiet_bus() {
    let beats = heartbeats(20_000).into_iter().map(|(at, frame)| {
        let header = Header::decode(frame.platform_id().unwrap());
        let header = Header { from_non_working: true, ..header };
        (at, Frame::classic(header.encode(), frame.data()))
    });
    let (engine, _) = observed(beats.collect(), 20_000);
    assert_eq!(engine.traffic().verdict(), BusVerdict::Des);
    assert_eq!(engine.devices().len(), 1);
}

#[test]
fn two_frames_by_chance_long_apart_are_no_device() {
    for apart in [20_000, 50_000] {
        let two = [plausible(3000, 9, FITTING), plausible(3000 + apart, 40, FITTING)];
        let (engine, _) = observed([standard(60_000), two.to_vec()].concat(), 60_000);
        assert_eq!(engine.traffic().verdict(), BusVerdict::Foreign, "{apart} ms apart");
    }
}
