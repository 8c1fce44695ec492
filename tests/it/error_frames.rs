//! Error frames: findings name an address if bus errors coincide with its transmissions, and no
//! address if they have another cause.

use crate::common::inspection;
use crate::common::inspection::Inspection;
use crate::common::program::command;
use crate::common::sweep;
use descan::discovery::{Config, Engine, EventKind};
use descan::finding::{Finding, FindingKind, FindingState};
use descan::frame::{Frame, FrameKind};
use descan::sim::{ControllerState, DeviceAction, DeviceSpec, Fault, Scenario, TimetableEvent};
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header};
use descan::wire::node::Uid;

fn seconds(seconds: f64) -> Instant {
    Instant::from_micros((seconds * 1e6) as u64)
}

fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Returns a device that always keeps its address and responds after exactly `delay`.
fn stubborn(label: &str, name: &str, address: u8, delay: Duration) -> DeviceSpec {
    let mut device = DeviceSpec::new(name).label(label).fixed(address).skips_address_resolution();
    device.response_delay = (delay, delay);
    device.fault(Fault::KeepsAddress)
}

/// Returns the addresses named in bus error findings, once per report.
fn named(it: &Inspection) -> Vec<u8> {
    let told = it.events.iter().filter_map(|event| match &event.kind {
        EventKind::Finding { key, state } if key.kind == FindingKind::BusErrors => {
            key.address.filter(|_| *state != FindingState::Cleared)
        }
        _ => None,
    });
    told.map(Address::number).collect()
}

fn errors_at(it: &Inspection, address: Option<u8>) -> Option<&Finding> {
    it.engine.findings().iter().find(|finding| {
        finding.key.kind == FindingKind::BusErrors
            && finding.key.address.map(Address::number) == address
    })
}

/// Runs on a bus so bad that descan's own controller goes bus-off; it is restarted.
fn run(it: &mut Inspection, until: Instant) {
    while it.sim.now() < until {
        let now = it.sim.now();
        while let Some(frame) = it.sim.poll_frame(it.station) {
            it.engine.handle_frame(&frame);
            it.frames.push(frame);
        }
        it.engine.handle_timeout(now);
        while let Some(frame) = it.engine.poll_transmit(now) {
            let _ = it.sim.transmit(it.station, frame);
        }
        while let Some(event) = it.engine.poll_event() {
            it.events.push(event);
        }
        if it.sim.status(it.station).state == ControllerState::BusOff {
            it.sim.set_link(it.station, false);
            it.sim.set_link(it.station, true);
            it.engine.restart(now);
        }
        let next = [it.engine.poll_timeout(), it.sim.next_event(), Some(until)];
        let next = next.into_iter().flatten().min().unwrap_or(until);
        it.sim.advance(next.max(now + Duration::from_micros(1)));
    }
}

/// Returns two devices at address 14 that respond at the same moment; `differ` changes the second.
fn pair(differ: impl Fn(DeviceSpec) -> DeviceSpec) -> [DeviceSpec; 2] {
    let one = stubborn("one", "ACT", 14, millis(2)).service("PUMP", "1.0");
    let other = stubborn("other", "ACT", 14, millis(2)).uid(Uid([1, 2, 3, 4, 5, 6]));
    [one, differ(other)]
}

fn with_pair(scenario: Scenario, pair: [DeviceSpec; 2]) -> Scenario {
    pair.into_iter().fold(scenario, Scenario::with)
}

#[test]
fn two_different_responders_are_suspected() {
    let services = pair(|other| other.service("VALVE", "2.1"));
    let names = pair(|other| other.name(b"VALVE"));
    for (what, pair) in [("services", services), ("names", names)] {
        for bitrate in [125_000, 1_000_000] {
            // Without other nodes, no node acknowledges while the two restart.
            for crowd in [1, 10, 40] {
                let scenario =
                    with_pair(Scenario::with_many_devices(bitrate, crowd, 3), pair.clone());
                // A crowd that has a device at address 14 as well makes three.
                for seed in 0..4 {
                    let mut it = Inspection::new(&scenario, seed, Config::default());
                    run(&mut it, seconds(15.0));
                    let told = named(&it);
                    assert!(
                        told.contains(&14) && told.iter().all(|address| *address == 14),
                        "{what}, {bitrate} bit/s, {crowd} others, seed {seed}: {told:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn named_address_is_suspected_with_frames() {
    let pair = pair(|other| other.service("VALVE", "2.1"));
    let scenario = with_pair(Scenario::with_many_devices(250_000, 10, 3), pair);
    let mut it = Inspection::new(&scenario, 1, Config::default());
    run(&mut it, seconds(15.0));
    let finding = errors_at(&it, Some(14)).expect("address 14 is named");
    assert_eq!(finding.state, FindingState::Suspected);
    assert!(finding.text.contains("ACT at address 14"), "{}", finding.text);
    let question = finding.evidence.front().and_then(|piece| piece.frame).unwrap();
    let header = Header::decode(question.platform_id().unwrap());
    assert_eq!((header.destination.number(), header.response), (14, false));
    let broken = finding.evidence.iter().filter_map(|piece| piece.frame);
    let broken = broken.filter(|frame| frame.kind == FrameKind::Error).count();
    assert!(broken >= 4, "{:?}", finding.evidence);
    assert!(finding.evidence.iter().is_sorted_by_key(|piece| piece.time));
}

#[test]
fn suspects_are_checked_in_turn() {
    let pairs = [5, 6, 7, 8].map(|address| {
        let label = |which: &str| format!("{which}{address}");
        let one = stubborn(&label("one"), "ACT", address, millis(2));
        [one, stubborn(&label("other"), "VALVE", address, millis(2))]
    });
    let crowd = Scenario::with_many_devices(125_000, 4, 3);
    let scenario = pairs.into_iter().flatten().fold(crowd, Scenario::with);
    let end = seconds(40.0);
    for seed in 0..8 {
        let mut it = Inspection::new(&scenario, seed, Config::default());
        run(&mut it, end);
        for address in 5..=8 {
            let asked = it.frames.iter().filter(|frame| {
                let header = Header::decode(frame.platform_id().unwrap_or(0));
                let targeted = !header.broadcast && header.destination.number() == address;
                frame.is_tx && targeted && frame.data().ends_with(b"DES\x01")
            });
            let asked: Vec<Instant> = asked.map(|it| it.time).chain([end]).collect();
            let longest = asked.windows(2).map(|two| two[1].since(two[0])).max();
            let waits = longest.unwrap_or(Duration::MAX);
            // The median over 48 seeds is 3.3 s, the longest 7.3 s.
            assert!(waits < millis(8000), "seed {seed}: {address} is not asked for {waits:?}");
        }
    }
}

#[test]
fn suspicion_clears_when_one_of_two_leaves() {
    let pair = pair(|other| other.service("VALVE", "2.1"));
    let scenario = with_pair(Scenario::with_many_devices(250_000, 10, 3), pair).at(
        Duration::from_secs(20),
        "other",
        DeviceAction::PowerOff,
    );
    let mut it = Inspection::new(&scenario, 1, Config::default());
    run(&mut it, seconds(20.0));
    assert_eq!(errors_at(&it, Some(14)).map(|it| it.state), Some(FindingState::Suspected));
    run(&mut it, seconds(110.0));
    assert_eq!(errors_at(&it, Some(14)).map(|it| it.state), Some(FindingState::Cleared));
}

#[test]
fn listen_only_suspects_from_foreign_requests() {
    let pair = pair(|other| other.service("VALVE", "2.1"));
    let scenario = with_pair(Scenario::with_many_devices(250_000, 10, 3), pair);
    for engine in inspection::requester_and_listener(&scenario, 1, seconds(40.0)) {
        let named = engine.findings().iter().filter(|it| it.key.kind == FindingKind::BusErrors);
        let named: Vec<_> = named.filter_map(|it| it.key.address.map(Address::number)).collect();
        assert_eq!(named, [14]);
    }
}

/// Returns twenty devices: fast and slow, with short and long responses, quiet and busy ones.
fn mixed(bitrate: u32) -> Scenario {
    let mut scenario = Scenario::with_many_devices(bitrate, 20, 0);
    for (at, device) in scenario.devices.iter_mut().enumerate() {
        for service in 0..at {
            *device = device.clone().service(&format!("S{service}"), "1.0");
        }
        if at % 3 == 0 {
            device.response_delay = (millis(5), millis(80));
        }
        if at % 5 == 0 {
            *device = device.clone().periodic_message(0x100, millis(20), 8);
        }
    }
    scenario
}

fn assert_nobody_named(what: &str, scenario: &Scenario, seed: u64) -> Inspection {
    let mut it = Inspection::new(scenario, seed, Config::default());
    run(&mut it, seconds(60.0));
    assert_eq!(named(&it), [0; 0], "{what}, seed {seed}");
    it
}

#[test]
fn disturbed_bus_suspects_no_device() {
    for seed in 0..u64::from(sweep::cases(20)) {
        for rate in [0.01, 0.05, 0.2] {
            let bitrate = if seed % 2 == 0 { 125_000 } else { 1_000_000 };
            let mut scenario = mixed(bitrate);
            scenario.frame_error_probability = rate;
            let it = assert_nobody_named(&format!("{rate} of all break"), &scenario, seed);
            let bus = errors_at(&it, None).expect("the bus as a whole");
            assert_eq!(bus.state, FindingState::Confirmed, "{rate} of all break");
        }
    }
    for seed in 0..3 {
        for rate in [0.3, 0.5, 0.8] {
            let mut scenario = mixed(250_000);
            scenario.frame_error_probability = rate;
            assert_nobody_named(&format!("{rate} of all break"), &scenario, seed);
        }
    }
}

#[test]
fn occasional_bus_errors_suspect_no_device() {
    // Interference from a motor: all frames break for some milliseconds, again and again.
    for (period, pulse) in
        [(100, 15), (200, 8), (200, 15), (333, 25), (500, 8), (770, 25), (1000, 25), (10_000, 100)]
    {
        for seed in 0..3 {
            let mut scenario = mixed([500_000, 1_000_000, 250_000][seed as usize]);
            for (after, rate) in [(0, 1.0), (pulse, 0.0)] {
                // From the first request on.
                let start = Instant::ZERO + millis(1502 + 3 * seed + after);
                let mut event =
                    TimetableEvent::new(start, "", DeviceAction::SetFrameErrorProbability(rate));
                event.every = Some(millis(period));
                scenario.timetable.push(event);
            }
            let what = format!("{pulse} ms of {period}");
            assert_nobody_named(&what, &scenario, seed);
        }
    }
}

#[test]
fn node_at_wrong_bit_rate_suspects_no_device() {
    for seed in 0..5 {
        let mut it = Inspection::new(&mixed(250_000), seed, Config::default());
        let stranger = it.sim.attach();
        for second in 0..60 {
            let wrong = second % 5 == 4;
            it.sim.set_bitrate(stranger, if wrong { 500_000 } else { 250_000 });
            run(&mut it, seconds(f64::from(second)));
        }
        assert_eq!(named(&it), [0; 0], "seed {seed}");
        assert!(errors_at(&it, None).is_some(), "the bus as a whole");
    }
}

#[test]
fn missing_ack_suspects_no_device() {
    let mut scenario = Scenario::with_many_devices(250_000, 3, 1);
    for device in ["N001", "N002", "N003"] {
        scenario = scenario.at(Duration::from_secs(10), device, DeviceAction::PowerOff);
    }
    let mut it = Inspection::new(&scenario, 1, Config::default());
    run(&mut it, seconds(30.0));
    assert_eq!(named(&it), [0; 0]);
    let bus = errors_at(&it, None).expect("the bus as a whole");
    assert!(bus.text.starts_with("No ACK for descan's frames"), "{}", bus.text);
}

#[test]
fn single_node_is_not_blamed_for_another() {
    // While 14 and 15 each have two devices, all others respond normally.
    let other = |name: &str| {
        let one = stubborn(name, "VENT", 15, millis(3));
        one.service(name, "1").uid(Uid([name.len() as u8; 6]))
    };
    let scenario = with_pair(mixed(250_000), pair(|other| other.service("VALVE", "2.1")));
    let scenario = with_pair(scenario, [other("A"), other("BB")]);
    for seed in 0..5 {
        let mut it = Inspection::new(&scenario, seed, Config::default());
        run(&mut it, seconds(60.0));
        let told = named(&it);
        assert!(told.iter().all(|address| [14, 15].contains(address)), "{seed}: {told:?}");
        assert!([14, 15].iter().all(|address| told.contains(address)), "{seed}: {told:?}");
    }
}

/// Feeds `frames` f/s, evenly spaced, for so many seconds, with bus errors where `breaks` returns
/// true; returns the events about the bus as a whole, and the last text.
fn heard(frames: u64, seconds: u64, breaks: impl Fn(u64) -> bool) -> (Vec<String>, String) {
    let config = Config { listen_only: true, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let beat = Frame::classic(0x0714_0001, &[1, 2, 3, 4, 5, 6, 4, 0]);
    let stuff = Frame::error(0x88, &[0, 0, 4, 0, 0, 0, 0, 0]);
    let mut told = Vec::new();
    for number in 0..frames * seconds {
        let frame = if breaks(number) { stuff } else { beat };
        engine.handle_frame(&frame.with_time(Instant::from_micros(number * 1_000_000 / frames)));
        while let Some(due) = engine.poll_timeout().filter(|due| *due <= frame.time) {
            engine.handle_timeout(due);
        }
        engine.handle_timeout(Instant::from_micros(number * 1_000_000 / frames));
        while let Some(event) = engine.poll_event() {
            if let EventKind::Finding { key, state } = event.kind
                && key.kind == FindingKind::BusErrors
                && key.address.is_none()
            {
                told.push(format!("{} {state}", event.time.as_micros() / 1_000_000));
            }
        }
    }
    let finding = engine.findings().iter().find(|it| it.key.kind == FindingKind::BusErrors);
    (told, finding.map_or(String::new(), |finding| finding.text.clone()))
}

#[test]
fn error_rate_decides_the_bus_finding() {
    let none: [&str; 0] = [];
    // A single bus error now and then is not a finding.
    assert_eq!(heard(100, 300, |number| number % 1000 == 500).0, none);
    // Three in a row are suspected, on a busy bus and on a quiet one, and are cleared.
    assert_eq!(
        heard(7000, 20, |number| (7000..7003).contains(&number)).0,
        ["1 suspected", "11 cleared"]
    );
    assert_eq!(heard(20, 20, |number| (20..23).contains(&number)).0, ["1 suspected", "11 cleared"]);
    // One bus error in 7,000 frames every third second, for long: suspected, not confirmed.
    let seldom = heard(7000, 30, |number| number % 21_000 == 3500).0;
    assert_eq!(seldom, ["6 suspected"]);
    // The same with 20 frames is more than 1 %.
    let often = heard(20, 30, |number| number % 60 == 10).0;
    assert_eq!(often, ["6 suspected", "6 confirmed"]);
    // A few in each second are a fault, however many valid frames there are.
    let (steady, text) = heard(7000, 30, |number| number % 3500 == 10);
    assert_eq!(steady, ["1 suspected", "2 confirmed"]);
    assert!(text.starts_with("Bus errors: 2."), "{text}");
    assert!(text.ends_with("less than 1 % of all frames, mostly stuff errors."), "{text}");
    // Cleared half a minute after the last bus error.
    let ends = heard(100, 60, |number| number % 20 == 0 && number < 1000).0;
    assert_eq!(ends, ["0 suspected", "2 confirmed", "39 cleared"]);
}

/// A log holds the reports of the controller, and no state of a port.
#[test]
fn time_in_bus_off_of_a_log_is_not_counted_against_devices() {
    let folder = tempfile::tempdir().unwrap();
    let beat = |at: u32, number: u32| {
        format!("({at}.100000) can0 07{:06X}#8AFA6C9724110400\n", 0x18_0001 | (number % 63) << 10)
    };
    let bus_off = "(1030.000000) can0 20000040#0000000000000000\n";
    let restarted = "(1060.000000) can0 20000100#0000000000000000\n";
    // The other line gives the time: reports of an interface without devices.
    let elsewhere = |range: std::ops::Range<u32>| -> String {
        range.fold(String::new(), |text, at| text + &format!("({at}.500000) can1 123#00\n"))
    };
    let first: String = (1000..1030).map(|at| beat(at, at - 1000)).collect();
    let rest: String = (1060..1080).map(|at| beat(at, at - 1030)).collect();
    for (name, log, is_lost) in [
        ("restarted", format!("{first}{bus_off}{}{restarted}{rest}", elsewhere(1031..1060)), false),
        ("frames", format!("{first}{bus_off}{}{rest}", elsewhere(1031..1060)), false),
        ("end", format!("{first}{bus_off}{}", elsewhere(1031..1060)), false),
        ("silence", format!("{first}{}{rest}", elsewhere(1031..1060)), true),
        // It restarted, and the device has left.
        ("left", format!("{first}{bus_off}{restarted}{}", elsewhere(1061..1090)), true),
    ] {
        std::fs::write(folder.path().join("session.log"), log).unwrap();
        let output = command(&["watch", "file:session.log"], folder.path()).output().unwrap();
        let stdout = String::from_utf8(output.stdout).unwrap();
        assert!(stdout.contains("12 ?"), "{name}: {stdout}");
        let words = ["lost", "overdue", "rebooted"];
        assert_eq!(words.iter().any(|word| stdout.contains(word)), is_lost, "{name}: {stdout}");
    }
}
