//! Reasons why a device in des.json is missing from the bus: each cause, as the details show it.

use descan::app::{App, AppOptions, FileIndex, FileReading};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::finding::FindingKind;
use descan::frame::BusIndex;
use descan::sim::{DeviceAction, DeviceSpec, Fault, Scenario, Sim, SimStation};
use descan::status::{BusState, BusStatus, Link};
use descan::time::{Duration, Instant};
use descan::wire::id::Address;

/// The app on simulated buses: can0, can1, …
struct Stage {
    app: App,
    buses: Vec<(Sim, SimStation)>,
}

impl Stage {
    /// Runs for eight seconds with a file of these entries.
    fn after_eight_seconds(scenarios: &[Scenario], config: &Config, entries: &str) -> Self {
        let mut stage = Self::new(scenarios, config, entries);
        stage.until(8.0);
        stage
    }

    fn new(scenarios: &[Scenario], config: &Config, entries: &str) -> Self {
        let buses: Vec<_> = scenarios
            .iter()
            .map(|scenario| {
                let mut sim = Sim::new(scenario, 1);
                let station = sim.attach();
                sim.set_listen_only(station, config.listen_only);
                (sim, station)
            })
            .collect();
        let names = (0..buses.len()).map(|at| (format!("can{at}"), config.clone())).collect();
        let options = AppOptions {
            buses: names,
            file_path: Some("des.json".into()),
            ..AppOptions::default()
        };
        let mut stage = Self { app: App::new(Instant::ZERO, options), buses };
        for at in 0..stage.buses.len() {
            stage.status(at, Link::Up, BusState::ErrorActive, None);
        }
        let file = format!("{{ \"devices\": [ {entries} ] }}");
        stage.app.handle_file(
            Instant::ZERO,
            FileIndex::default(),
            FileReading::Content(Some(file.into_bytes())),
        );
        stage
    }

    fn until(&mut self, seconds: f64) {
        let end = Instant::ZERO + Duration::from_secs_f64(seconds);
        while self.app.now() < end {
            let now = self.app.now() + Duration::from_millis(1);
            for (at, (sim, station)) in self.buses.iter_mut().enumerate() {
                sim.advance(now);
                while let Some(frame) = sim.poll_frame(*station) {
                    self.app.handle_frames(now, &[frame.with_bus(BusIndex(at as u8))]);
                }
            }
            self.app.handle_timeout(now);
            self.app.renew_rows();
            while let Some(frame) = self.app.poll_transmit(now) {
                let (sim, station) = &mut self.buses[usize::from(frame.bus.0)];
                sim.transmit(*station, frame);
            }
            while self.app.poll_effect().is_some() {}
        }
    }

    fn status(&mut self, at: usize, link: Link, state: BusState, message: Option<&str>) {
        let fault = message.map(Diagnostic::new);
        let status =
            BusStatus { link, state, fault, bitrate: Some(250_000), ..BusStatus::default() };
        self.app.handle_bus(self.app.now(), BusIndex(at as u8), status);
        let (sim, station) = &mut self.buses[at];
        sim.set_link(*station, matches!(link, Link::Up | Link::Ended));
    }

    /// Returns the reasons for the entry at this index.
    fn why(&self, entry: usize) -> Vec<String> {
        self.app.missing_reasons(FileIndex::default(), &self.app.file().document().entries()[entry])
    }

    /// Returns the text and the remedy of the finding that reports missing devices.
    fn finding(&self) -> (String, String) {
        let found = self.app.problems();
        let found = found.iter().flat_map(|problem| problem.findings);
        let mut missing = found.filter(|it| it.key.kind == FindingKind::Missing);
        let first = missing.next().expect("something is missing");
        (first.text.clone(), first.remedy.clone())
    }
}

fn bus() -> Scenario {
    Scenario::new(250_000)
        .with(DeviceSpec::new("FEED").fixed(12).skips_address_resolution())
        .with(DeviceSpec::new("SENS").fixed(13).skips_address_resolution())
}

const PUMP: &str = r#"{ "name": "PUMP", "address": 44, "static": true }"#;

#[test]
fn interface_down_or_bus_off_is_the_reason() {
    let mut stage = Stage::after_eight_seconds(&[bus()], &Config::default(), PUMP);
    stage.status(0, Link::Down, BusState::Down, Some("can0 is down: ip link set can0 up"));
    assert_eq!(stage.why(0), ["can0 is down: ip link set can0 up"]);
    stage.status(0, Link::Missing, BusState::Unknown, None);
    assert_eq!(stage.why(0), ["can0 is down"]);
    stage.status(0, Link::Opening, BusState::Unknown, None);
    assert_eq!(stage.why(0), ["can0 is opening"]);
    stage.status(0, Link::Up, BusState::BusOff, None);
    assert_eq!(stage.why(0), ["can0 is bus-off: nothing is received"]);
    stage.status(0, Link::Up, BusState::Stopped, None);
    assert_eq!(stage.why(0), ["can0 is stopped"]);
    // Devices that were online before, too: the bus is the reason, not the device.
    let feed = r#"{ "name": "FEED", "address": 12, "static": true }"#;
    let mut stage = Stage::after_eight_seconds(&[bus()], &Config::default(), feed);
    stage.status(0, Link::Down, BusState::Down, None);
    stage.until(20.0);
    assert_eq!(stage.why(0), ["can0 is down"]);
}

#[test]
fn missing_ack_is_the_reason() {
    let stage = Stage::after_eight_seconds(&[Scenario::new(250_000)], &Config::default(), PUMP);
    let why = "no ACK on can0: no other node, wrong bit rate or broken wire";
    assert_eq!(stage.why(0), [why]);
    let (text, remedy) = stage.finding();
    assert_eq!(text, format!("PUMP (at 44) is listed but not on the bus: {why}."));
    assert_eq!(remedy, "");
}

#[test]
fn address_without_any_frame_is_reported() {
    let stage = Stage::after_eight_seconds(&[bus()], &Config::default(), PUMP);
    assert_eq!(
        stage.why(0),
        ["no frame received from address 44", "other devices respond: check its power and wiring"]
    );
    let (text, remedy) = stage.finding();
    assert_eq!(
        text,
        "PUMP (at 44) is listed but not on the bus: no frame received from address 44."
    );
    assert_eq!(remedy, "other devices respond: check its power and wiring");
    let unplaced = r#"{ "name": "PUMP" }"#;
    let stage = Stage::after_eight_seconds(&[bus()], &Config::default(), unplaced);
    assert_eq!(stage.why(0)[0], "no device named PUMP seen");
    // A UID not seen on the bus changes nothing.
    let with_uid = r#"{ "name": "PUMP", "uid": "PUMP0001", "address": 44 }"#;
    let stage = Stage::after_eight_seconds(&[bus()], &Config::default(), with_uid);
    assert_eq!(stage.why(0)[0], "no frame received from address 44");
    // Before the first request, no reason is known.
    let mut stage = Stage::new(&[bus()], &Config::default(), PUMP);
    stage.until(1.0);
    assert_eq!(stage.why(0), ["search still running"]);
}

#[test]
fn heartbeat_without_des_response_is_reported() {
    let mute = DeviceSpec::new("PUMP").fixed(44).skips_address_resolution().fault(Fault::NoDes);
    let mut stage = Stage::new(&[bus().with(mute)], &Config::default(), PUMP);
    for seconds in [20.0, 40.0, 60.0, 80.0] {
        stage.until(seconds);
        let why = stage.why(0);
        assert_eq!(why.len(), 1, "{why:?}");
        let (before, after) = why[0].split_once(" (requested ").unwrap_or((&why[0], ""));
        assert_eq!(before.trim_end_matches(" yet"), "a heartbeat at 44, but no DES response");
        assert!(after.ends_with(')'), "{seconds}: {why:?}");
    }
    // Without requests, a missing response proves nothing.
    let mute = DeviceSpec::new("PUMP").fixed(44).skips_address_resolution();
    for config in [
        Config { listen_only: true, ..Config::default() },
        Config { send_requests: false, ..Config::default() },
    ] {
        let stage = Stage::after_eight_seconds(&[bus().with(mute.clone())], &config, PUMP);
        assert_eq!(stage.why(0), ["a heartbeat at 44; name unknown: requests are off"]);
    }
}

#[test]
fn name_without_services_is_reported() {
    let mute =
        DeviceSpec::new("PUMP").fixed(44).skips_address_resolution().fault(Fault::NoServices);
    let mut stage = Stage::new(&[bus().with(mute)], &Config::default(), PUMP);
    stage.until(20.0);
    let device = stage.app.buses()[0].device_at(Address::new(44).unwrap()).unwrap();
    let why = stage.app.incomplete_reasons(device);
    assert_eq!(why, ["name received, no services response (requested 4 times)"]);
}

#[test]
fn address_in_use_is_the_reason() {
    let other = || DeviceSpec::new("VALVE").fixed(44).skips_address_resolution();
    let stage = Stage::after_eight_seconds(&[bus().with(other())], &Config::default(), PUMP);
    assert_eq!(stage.why(0), ["VALVE uses its address 44"]);
    assert_eq!(
        stage.finding().0,
        "PUMP (at 44) is listed but not on the bus: VALVE uses its address 44."
    );
    // The address is not reserved for it while it is not pinned.
    let unpinned = r#"{ "name": "PUMP", "address": 44 }"#;
    let stage = Stage::after_eight_seconds(&[bus().with(other())], &Config::default(), unpinned);
    assert_eq!(stage.why(0), ["VALVE has address 44 now"]);
    let blank = DeviceSpec::new("").fixed(44).skips_address_resolution();
    let stage = Stage::after_eight_seconds(&[bus().with(blank)], &Config::default(), PUMP);
    assert_eq!(stage.why(0), ["a device with an empty name uses its address 44"]);
    // descan itself.
    let config = Config { address: Address::new(44), ..Config::default() };
    let stage = Stage::after_eight_seconds(&[bus()], &config, PUMP);
    assert_eq!(stage.why(0), ["descan itself uses address 44"]);
    // It was online, and is lost.
    let leaves = bus().with(other()).at(Duration::from_secs(4), "VALVE", DeviceAction::PowerOff);
    let mut stage = Stage::new(&[leaves], &Config::default(), PUMP);
    stage.until(20.0);
    let why = stage.why(0);
    assert!(why[0].starts_with("only VALVE was at 44, last seen "), "{why:?}");
    let moves = DeviceAction::Move(descan::wire::descriptor::AddressSetting::Fixed(
        Address::new(45).unwrap(),
    ));
    let moves = bus().with(other()).at(Duration::from_secs(4), "VALVE", moves);
    let mut stage = Stage::new(&[moves], &Config::default(), PUMP);
    stage.until(20.0);
    assert_eq!(stage.why(0), ["VALVE moved from 44 to 45"]);
}

#[test]
fn device_at_another_address_is_reported() {
    let pump = |at| DeviceSpec::new("PUMP").fixed(at).skips_address_resolution();
    // One device of that name counts as the entry's: wrong address; the holder is named.
    let valve = DeviceSpec::new("VALVE").fixed(44).skips_address_resolution();
    let scenario = bus().with(pump(20)).with(valve);
    let stage = Stage::after_eight_seconds(&[scenario], &Config::default(), PUMP);
    let problems = stage.app.problems();
    let mut texts: Vec<_> =
        problems.iter().flat_map(|it| it.findings).map(|it| it.text.as_str()).collect();
    texts.sort_unstable();
    assert_eq!(
        texts,
        [
            "PUMP is at address 20; the file pins it to 44.",
            "Static address 44 of PUMP is used by a device named VALVE.",
        ]
    );
    // With several, it may be either.
    let scenario = bus().with(pump(20)).with(pump(21));
    let stage = Stage::after_eight_seconds(&[scenario], &Config::default(), PUMP);
    assert_eq!(stage.why(0), ["PUMP found at 20 and 21, not at 44: ambiguous"]);
    // A device that matches another entry does not count.
    let entries = format!(r#"{PUMP}, {{ "name": "PUMP", "address": 20, "static": true }}"#);
    let scenario = bus().with(pump(20));
    let stage = Stage::after_eight_seconds(&[scenario], &Config::default(), &entries);
    assert_eq!(
        stage.why(0),
        [
            "no frame received from address 44",
            "other devices respond: check its power and wiring",
            "PUMP at 20 belongs to another entry"
        ]
    );
}

#[test]
fn device_seen_earlier_is_reported() {
    let pump = DeviceSpec::new("PUMP").fixed(44).skips_address_resolution();
    let scenario = bus().with(pump).at(Duration::from_secs(4), "PUMP", DeviceAction::PowerOff);
    let mut stage = Stage::new(&[scenario], &Config::default(), PUMP);
    stage.until(20.0);
    let why = stage.why(0);
    assert!(why[0].starts_with("last seen at 44, 1"), "{why:?}");
    assert_eq!(why.len(), 1, "{why:?}");
    // Another device took its address meanwhile.
    let pump = DeviceSpec::new("PUMP").fixed(44).skips_address_resolution();
    let valve = DeviceSpec::new("VALVE")
        .fixed(44)
        .skips_address_resolution()
        .power_on(Duration::from_secs(9));
    let scenario =
        bus().with(pump).with(valve).at(Duration::from_secs(4), "PUMP", DeviceAction::PowerOff);
    let mut stage = Stage::new(&[scenario], &Config::default(), PUMP);
    stage.until(25.0);
    let why = stage.why(0);
    assert!(why[0].starts_with("last seen at 44, "), "{why:?}");
    assert_eq!(why[1..], ["VALVE uses its address 44"]);
}

#[test]
fn disabled_requests_are_the_reason() {
    for config in [
        Config { listen_only: true, ..Config::default() },
        Config { send_requests: false, ..Config::default() },
    ] {
        let stage = Stage::after_eight_seconds(&[bus()], &config, PUMP);
        assert_eq!(
            stage.why(0),
            ["no frame received from address 44", "requests are off: silent devices are not found"]
        );
        let unplaced = r#"{ "name": "PUMP" }"#;
        let stage = Stage::after_eight_seconds(&[bus()], &config, unplaced);
        assert_eq!(
            stage.why(0)[..2],
            ["no device named PUMP seen", "it may be one of 2 unnamed devices"]
        );
    }
    let config = Config { address: Address::new(12), ..Config::default() };
    let stage = Stage::after_eight_seconds(&[bus()], &config, PUMP);
    assert_eq!(
        stage.why(0),
        ["no frame received from address 44", "descan has no address: no requests were sent"]
    );
}

#[test]
fn end_of_log_is_the_reason() {
    let config = Config { listen_only: true, ..Config::default() };
    let mut stage = Stage::after_eight_seconds(&[bus()], &config, PUMP);
    stage.status(0, Link::Ended, BusState::Unknown, None);
    assert_eq!(
        stage.why(0),
        [
            "in this log no frame received from address 44",
            "requests are off: silent devices are not found"
        ]
    );
}

#[test]
fn missing_device_reason_covers_both_buses() {
    let entries = format!(
        r#"{PUMP}, {{ "name": "FAN", "bus": "can1", "address": 45 }},
           {{ "name": "LAMP", "bus": "can7", "address": 46 }}"#
    );
    let valve = DeviceSpec::new("VALVE").fixed(44).skips_address_resolution();
    let scenarios = [bus(), bus().with(valve)];
    let mut stage = Stage::after_eight_seconds(&scenarios, &Config::default(), &entries);
    // Each bus has its own reason; reasons common to both are shown once.
    assert_eq!(
        stage.why(0),
        [
            "can0: no frame received from address 44",
            "can0: other devices respond: check its power and wiring",
            "can1: VALVE uses its address 44"
        ]
    );
    assert_eq!(
        stage.why(1),
        ["no frame received from address 45", "other devices respond: check its power and wiring"]
    );
    assert_eq!(stage.why(2), ["listed for bus can7, which is not open"]);
    stage.status(1, Link::Down, BusState::Down, None);
    assert_eq!(stage.why(1), ["can1 is down"]);
    assert_eq!(stage.why(0)[2], "can1 is down");
    let stage = Stage::after_eight_seconds(&[bus(), bus()], &Config::default(), PUMP);
    assert_eq!(
        stage.why(0),
        ["no frame received from address 44", "other devices respond: check its power and wiring"]
    );
}

#[test]
fn namesake_of_another_entry_is_the_only_reason() {
    let entries = r#"{ "name": "FEED", "address": 12, "static": true },
        { "name": "FEED", "address": 130 }"#;
    let stage = Stage::after_eight_seconds(&[bus()], &Config::default(), entries);
    assert_eq!(stage.why(1), ["FEED at 12 belongs to another entry"]);
}
