//! Discovery on simulated buses: every kind of device is found with its services in any framing;
//! descan keeps its transmit budget; with listen-only it sends nothing.

use crate::common::inspection;
use crate::common::inspection::Inspection;
use descan::discovery::{
    Config, Engine, Event, EventKind, OwnAddress, Presence, ProtocolDeviation, QueryState,
};
use descan::finding::{FindingKind, FindingState};
use descan::frame::Frame;
use descan::sim::{DeviceAction, DeviceFraming, DeviceSpec, Fault, Scenario, Sim, SimStation};
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
    let done = it.run_until(seconds(20.0), |engine| engine.progress().is_complete);
    assert!(done, "it settles: {:?}", it.engine.progress());
    it
}

fn device(it: &Inspection, address: u8) -> &descan::discovery::Device {
    it.engine.device_at(Address::new(address).unwrap()).expect("a device at that address")
}

#[test]
fn devices_of_every_framing_are_identified() {
    let long = "a-version-that-takes-many-frames-to-say".repeat(4);
    let make =
        |name: &str, address| DeviceSpec::new(name).fixed(address).skips_address_resolution();
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
        .with(make("ECHO", 6).fault(Fault::RepeatsRequestDst).service("Y", "3"));
    scenario.data_bitrate = 2_000_000;
    // Services that fit one raw frame: an empty list.
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
    assert!(it.frames.iter().any(|frame| frame.is_fd), "answers came in FD frames");
    assert_eq!(services(5), ["DES 1.0", "SETUP 1"]);
    assert!(!device(&it, 5).is_working);
    assert_eq!(services(6), ["DES 1.0", "Y 3"]);
    assert!(device(&it, 6).deviations.contains(&ProtocolDeviation::RspDstEcho));
}

#[test]
fn profile_numbers_replace_the_defaults() {
    let profile = Profile::parse(
        "framing = \"isotp\"\n[services]\nheartbeat = 0x155\ndes = 0x2AA\n[heartbeat]\nperiod_ms = 500\n\
         uid_offset = 1\nmode_offset = 0\nerror_offset = 7\n[modes]\nWORK = 40\nINIT = 41\n",
    )
    .unwrap();
    let scenario = Scenario::new(250_000)
        .with(DeviceSpec::new("FEED").fixed(12).skips_address_resolution().service("AUGER", "2.1"));
    let config = Config { profile: Arc::new(profile.clone()), ..Config::default() };
    let mut it = Inspection::new(&scenario, 3, config);
    it.sim = Sim::with_profile(&scenario, 3, profile);
    it.station = it.sim.attach();
    assert!(it.run_until(seconds(10.0), |engine| engine.progress().is_complete));
    let feed = device(&it, 12);
    assert!(feed.is_named(b"FEED"));
    assert_eq!(feed.mode.map(descan::wire::node::Mode::name), Some("WORK"));
    assert_eq!(feed.services.as_ref().map(Vec::len), Some(2));
    let asked = it.frames.iter().filter(|frame| frame.is_tx && frame.data().starts_with(b"DES"));
    assert_eq!(asked.count(), 0, "asked in ISO 15765-2 alone, as the profile says");
}

#[test]
fn device_faults_are_reported_and_clear() {
    let faulty = |name: &str, address, fault| {
        let device = DeviceSpec::new(name).fixed(address).skips_address_resolution().fault(fault);
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
        .with(DeviceSpec::new("GOOD").fixed(9).skips_address_resolution());
    let mut it = Inspection::new(&scenario, 3, Config::default());
    it.run_until(seconds(25.0), |_| false);
    assert_eq!(device(&it, 1).services_query.state, QueryState::NoResponse);
    assert!(device(&it, 1).is_named(b"MUTE"), "a name without services is shown as just that");
    assert_eq!(device(&it, 2).name, None);
    assert_eq!(device(&it, 2).presence, Presence::Online);
    for address in [3, 4, 6] {
        let query = &device(&it, address).services_query;
        let given_up = query.fault.is_some() && query.state != QueryState::Responded;
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
    // The consecutive frames after a complete message belong to no transfer.
    assert!(device(&it, 5).services.is_some());
    assert!(device(&it, 9).services.is_some());
    assert!(it.engine.progress().is_complete, "{:?}", it.engine.progress());
    assert!(it.engine.counters().transfers_failed > 0);
}

/// Returns the share of the bus used by descan's frames from `from` to `to`.
fn our_share(it: &Inspection, from: Instant, to: Instant) -> f64 {
    let ours = it.frames.iter().filter(|it| it.is_tx && it.time >= from && it.time < to);
    let taken: Duration = ours.map(|frame| it.sim.frame_duration(frame)).sum();
    taken.as_secs_f64() / to.since(from).as_secs_f64()
}

#[test]
fn transmit_budget_is_kept() {
    let scenario = Scenario::with_many_devices(125_000, 60, 3);
    let slow = Config { startup_budget: 0.02, ..Config::default() };
    let mut it = Inspection::new(&scenario, 3, slow);
    assert!(it.run_until(seconds(60.0), |engine| engine.progress().with_services == 60));
    let end = it.sim.now();
    let share = our_share(&it, seconds(1.5), end);
    assert!(share <= 0.025, "{share}");
    // Without a limit below it, descan uses its full budget.
    let mut quick = Inspection::new(&scenario, 3, Config::default());
    assert!(quick.run_until(seconds(60.0), |engine| engine.progress().with_services == 60));
    assert!(quick.sim.now().since(seconds(1.5)) * 3 < end.since(seconds(1.5)));
    quick.run_until(seconds(60.0), |_| false);
    let steady = our_share(&quick, seconds(20.0), seconds(60.0));
    assert!(steady <= 0.05, "{steady}");
}

/// Responses have priority over heartbeats: a discovery without gaps would keep those off the bus.
#[test]
fn discovery_leaves_gaps_for_heartbeats() {
    let scenario = Scenario::with_many_devices(125_000, 127, 5);
    let heartbeats = |config: Config| {
        let mut it = Inspection::new(&scenario, 1, config);
        it.run_until(seconds(6.0), |_| false);
        let mut times = vec![Vec::new(); Address::COUNT];
        for frame in it.frames.iter().filter(|frame| !frame.is_tx) {
            let header = Header::decode(frame.platform_id().unwrap());
            if header.response && header.broadcast {
                times[header.source.index()].push(frame.time);
            }
        }
        (it, times)
    };
    let (it, with) = heartbeats(Config::default());
    let (_, without) = heartbeats(Config { listen_only: true, ..Config::default() });
    assert_eq!(it.engine.progress().with_services, 127);
    let pairs = with.iter().flatten().zip(without.iter().flatten());
    let latest = pairs.map(|(with, without)| with.since(*without)).max().unwrap();
    assert!(latest < Duration::from_millis(500), "a heartbeat is {latest:?} later");
    let is_change = |event: &&Event| matches!(event.kind, EventKind::Presence(_));
    assert!(!it.events.iter().any(|event| is_change(&event)), "{:?}", told(&it.events));
    // Each service list is requested once.
    let is_services = |frame: &&Frame| frame.is_tx && frame.data() == b"\x04DES\x02";
    assert_eq!(it.frames.iter().filter(is_services).count(), 127);
}

#[test]
fn listen_only_engine_learns_without_sending() {
    let scenario = Scenario::with_many_devices(250_000, 10, 2);
    let [requester, listener] = inspection::requester_and_listener(&scenario, 5, seconds(8.0));
    let known = |engine: &descan::discovery::Engine| engine.progress().with_services;
    // The requester is a debug device that does not respond here, so it knows ten devices too.
    assert_eq!((known(&requester), known(&listener)), (10, 10));
}

#[test]
fn disabled_scan_sends_no_requests() {
    let scenario = Scenario::with_many_devices(250_000, 5, 1);
    let mut it =
        Inspection::new(&scenario, 3, Config { send_requests: false, ..Config::default() });
    it.run_until(seconds(6.0), |_| false);
    let profile = Profile::default();
    let asked = |frame: &&Frame| {
        frame.is_tx && Header::decode(frame.platform_id().unwrap()).service == profile.des_service()
    };
    assert_eq!(it.frames.iter().filter(asked).count(), 0);
    assert_eq!(it.engine.progress().present, 5, "their heartbeats make them rows");
}

#[test]
fn reboot_with_new_services_is_detected() {
    let services = vec![vec![b"DES".to_vec(), b"1.1".to_vec()]];
    let scenario = Scenario::with_many_devices(125_000, 3, 1).at(
        Duration::from_secs(6),
        "N002",
        DeviceAction::Reboot { services: Some(services) },
    );
    let mut it = Inspection::new(&scenario, 3, Config::default());
    it.run_until(seconds(14.0), |_| false);
    let rebooted = device(&it, 2);
    let known: Vec<_> = rebooted.services.iter().flatten().map(|s| s.version.to_string()).collect();
    assert_eq!(known, ["1.1"]);
    assert_eq!(rebooted.previous_services.as_ref().map(Vec::len), Some(2), "what it had before");
    assert_eq!(rebooted.reboots, 1);
}

/// Several inspectors on one simulated bus.
struct Company {
    sim: Sim,
    members: Vec<Member>,
}

struct Member {
    station: SimStation,
    engine: Engine,
    events: Vec<Event>,
}

impl Company {
    fn new(scenario: &Scenario, seed: u64) -> Self {
        Self { sim: Sim::new(scenario, seed), members: Vec::new() }
    }

    /// Adds an inspector that starts now.
    fn join(&mut self, config: Config) {
        let station = self.sim.attach();
        let config = Config { bitrate: Some(250_000), ..config };
        let engine = Engine::new(self.sim.now(), config);
        self.members.push(Member { station, engine, events: Vec::new() });
    }

    fn run_until(&mut self, end: Instant) {
        self.run_with(end, |_, _| {});
    }

    /// Runs, and calls `act` after each event.
    fn run_with(&mut self, end: Instant, mut act: impl FnMut(Instant, &mut Sim)) {
        while self.sim.now() < end {
            let now = self.sim.now();
            act(now, &mut self.sim);
            for Member { station, engine, events } in &mut self.members {
                while let Some(frame) = self.sim.poll_frame(*station) {
                    engine.handle_frame(&frame);
                }
                engine.handle_timeout(now);
                while let Some(frame) = engine.poll_transmit(now) {
                    self.sim.transmit(*station, frame);
                }
                while let Some(event) = engine.poll_event() {
                    events.push(event);
                }
            }
            let due = self.members.iter().filter_map(|member| member.engine.poll_timeout());
            let next = due.chain(self.sim.next_event()).min().unwrap_or(end);
            self.sim.advance(next.clamp(now + Duration::from_micros(1), end));
        }
    }

    fn held(&self) -> Vec<Option<u8>> {
        let held = self.members.iter().map(|member| match member.engine.own_address() {
            OwnAddress::Held(address) => Some(address.number()),
            _ => None,
        });
        held.collect()
    }
}

fn told(events: &[Event]) -> Vec<String> {
    events.iter().map(inspection::describe).collect()
}

/// Asserts that each inspector holds its own address and knows the others as debug devices, and
/// that none of them ever confirmed an address conflict with another.
fn assert_live_together(company: &Company, what: &str) {
    let held = company.held();
    for (at, member) in company.members.iter().enumerate() {
        let own = held[at].unwrap_or_else(|| panic!("{what}: {held:?}"));
        for (other, address) in held.iter().enumerate().filter(|(other, _)| *other != at) {
            let address = address.unwrap();
            assert_ne!(own, address, "{what}: {at} and {other}");
            let row = member.engine.device_at(Address::new(address).unwrap());
            let row = row.unwrap_or_else(|| panic!("{what}: {at} does not know {other}"));
            assert!(row.is_debug && row.is_named(b"DSCAN"), "{what}: {row:?}");
            assert_eq!(row.services.as_ref().map(Vec::len), Some(1), "{what}");
        }
        let confirmed = member.events.iter().find(|event| {
            matches!(&event.kind, EventKind::Finding { key, state: FindingState::Confirmed }
                if key.kind.is_conflict())
        });
        assert!(confirmed.is_none(), "{what}: {}", inspection::describe(confirmed.unwrap()));
    }
}

#[test]
fn several_inspectors_share_one_bus() {
    for seed in 0..10 {
        for count in [2_u32, 4] {
            // With devices, descan sends heartbeats too; without devices, only requests.
            for devices in [5, 0] {
                for apart in [0.0, 0.001, 0.7, 3.0] {
                    let what =
                        format!("seed {seed}, {count} with {devices} devices, {apart} s apart");
                    let mut company =
                        Company::new(&Scenario::with_many_devices(250_000, devices, 1), seed);
                    for at in 0..count {
                        company.run_until(seconds(apart * f64::from(at)));
                        let seed = seed * 100 + u64::from(at);
                        company.join(Config { seed, ..Config::default() });
                    }
                    company.run_until(seconds(60.0));
                    assert_live_together(&company, &what);
                }
            }
        }
    }
}

#[test]
fn two_inspectors_fixed_at_0_settle() {
    for seed in 0..20 {
        let mut company = Company::new(&Scenario::with_many_devices(250_000, 3, 1), seed);
        for at in 0..2 {
            let config =
                Config { seed: seed * 2 + at, address: Some(Address::DEBUG), ..Config::default() };
            company.join(config);
        }
        company.run_until(seconds(30.0));
        let mut held = company.held();
        held.sort_unstable();
        assert_eq!(held, [None, Some(0)], "seed {seed}");
        let told: Vec<_> = company.members.iter().map(|it| told(&it.events)).collect();
        let won = told.iter().flatten().filter(|told| *told == "we are 0").count();
        assert!(won <= 3, "seed {seed}: both at first, then one: {told:#?}");
    }
}

/// Returns a heartbeat from an address, with that UID.
fn beat(at: u8, uid: &str) -> Frame {
    let profile = Profile::default();
    let uid = descan::wire::node::Uid::parse(uid, &profile.uid);
    let mode = Some(descan::wire::node::Mode::Work);
    let beat = descan::wire::node::Heartbeat { uid, mode, error: Some(0) };
    let (data, len) = beat.encode(&profile.heartbeat, &profile.modes.codes());
    let from = Address::new(at).unwrap();
    let header = Header::unsolicited(from, 77, false, profile.heartbeat_service());
    Frame::classic(header.encode(), &data[..len])
}

/// Returns an engine that received no frames for 1.5 s, and its events so far.
fn alone(config: Config) -> (Engine, Vec<String>) {
    let mut engine = Engine::new(Instant::ZERO, Config { has_loopback: false, ..config });
    let events = run(&mut engine, seconds(1.6), |_| None);
    (engine, events)
}

/// Runs an engine until `end`, feeding it each frame at its time.
fn run(
    engine: &mut Engine,
    end: Instant,
    mut next: impl FnMut(Instant) -> Option<Frame>,
) -> Vec<String> {
    let mut events = Vec::new();
    let mut now = Instant::ZERO;
    while now < end {
        now += Duration::from_millis(1);
        if let Some(frame) = next(now) {
            engine.handle_frame(&frame.with_time(now));
        }
        engine.handle_timeout(now);
        while engine.poll_transmit(now).is_some() {}
        while let Some(event) = engine.poll_event() {
            events.push(inspection::describe(&event));
        }
    }
    events
}

/// Returns a name request to one node, and its responses.
fn question(by: u8, to: u8) -> Frame {
    let [by, to] = [by, to].map(|at| Address::new(at).unwrap());
    let header = Header::request(by, to, false, Profile::default().des_service());
    Frame::classic(header.encode(), b"\x04DES\x01")
}

fn answer(from: u8, to: u8) -> Frame {
    let header = Header::decode(question(to, from).platform_id().unwrap());
    let id = header.response(Address::new(from).unwrap(), false).encode();
    Frame::classic(id, b"\x06\x01FEED\x00")
}

/// Like [`run`], but returns the frames that the engine sent, with times in milliseconds.
fn sent(
    engine: &mut Engine,
    end: u64,
    mut next: impl FnMut(u64) -> Vec<Frame>,
) -> Vec<(u64, Frame)> {
    let mut sent = Vec::new();
    for millis in 1..end {
        let now = Instant::from_micros(millis * 1000);
        for frame in next(millis) {
            engine.handle_frame(&frame.with_time(now));
        }
        engine.handle_timeout(now);
        while let Some(frame) = engine.poll_transmit(now) {
            sent.push((millis, frame));
        }
        while engine.poll_event().is_some() {}
    }
    sent
}

/// Returns the times at which `sent` has a name request to that node.
fn asked(sent: &[(u64, Frame)], from: u8, to: u8) -> Vec<u64> {
    let same = sent.iter().filter(|(_, frame)| frame.same_on_wire(&question(from, to)));
    same.map(|(at, _)| *at).collect()
}

#[test]
fn duplicated_request_is_answered_once() {
    let config = Config { has_loopback: false, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    // A bridge repeats the request after 23 ms; the one at 3,500 ms is new.
    let questions = [3000, 3023, 3500];
    let sent = sent(&mut engine, 4000, |millis| {
        questions.contains(&millis).then(|| question(9, 0)).into_iter().collect()
    });
    let answers = sent.iter().filter(|(_, frame)| {
        let header = Header::decode(frame.platform_id().unwrap());
        header.response && !header.broadcast && header.service.number() == 2
    });
    assert_eq!(answers.map(|(at, _)| *at).collect::<Vec<_>>(), [3000, 3500]);
}

#[test]
fn follow_up_requests_of_inspectors_drift_apart() {
    // Both receive the same frame at the same moment. Requests sent at once would make two equal
    // responses wait for the bus together and merge.
    let [one, other] = [1, 2].map(|seed| {
        let config = Config { has_loopback: false, seed, ..Config::default() };
        let mut engine = Engine::new(Instant::ZERO, config);
        let sent = sent(&mut engine, 12_000, |millis| match millis {
            3000 => vec![question(9, 5), answer(5, 9)],
            3001 | 6000 | 8000 => vec![answer(5, 9)],
            _ => Vec::new(),
        });
        asked(&sent, 0, 5)
    });
    let [one, other]: [Vec<u64>; 2] =
        [one, other].map(|all| all.into_iter().filter(|at| (3100..7900).contains(at)).collect());
    assert!(one.len() >= 4 && other.len() >= 4, "{one:?} {other:?}");
    for (a, b) in one.iter().zip(&other) {
        assert!(a.abs_diff(*b) >= 2, "{one:?} {other:?}");
    }
}

#[test]
fn phase_shift_of_steady_heartbeat_triggers_request() {
    let mut engine = Engine::new(
        Instant::ZERO,
        Config { has_loopback: false, round_period: Duration::ZERO, ..Config::default() },
    );
    // A different board takes the place of FEED; its heartbeats come 0.1 s late.
    let sent = sent(&mut engine, 14_000, |millis| {
        let due = if millis < 9000 { 0 } else { 100 };
        let mut frames = Vec::new();
        if millis % 1000 == due {
            frames.push(beat(5, "FEED01"));
        }
        if [1600, 2100].contains(&millis) {
            frames.push(answer(5, 0));
        }
        frames
    });
    let asked = asked(&sent, 0, 5);
    assert!(!asked.iter().any(|at| (4000..9100).contains(at)), "{asked:?}");
    assert!(asked.iter().any(|at| (9100..10_500).contains(at)), "{asked:?}");
}

#[test]
fn heartbeats_during_outage_are_not_missed() {
    let config = Config { has_loopback: false, listen_only: true, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let beats = |engine: &mut Engine, from: u64, to: u64| {
        for second in from..=to {
            engine.handle_frame(&beat(5, "FEED01").with_time(seconds(second as f64 + 0.1)));
        }
    };
    beats(&mut engine, 0, 3);
    engine.suspend(seconds(3.6));
    engine.restart(seconds(13.6));
    beats(&mut engine, 14, 16);
    let missed = |engine: &Engine| engine.devices()[0].heartbeat.missed;
    assert_eq!(missed(&engine), 0);
    beats(&mut engine, 19, 19);
    assert_eq!(missed(&engine), 2);
}

#[test]
fn row_ids_stay_valid_after_moves_and_removals() {
    let config = Config { has_loopback: false, listen_only: true, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let beats = |engine: &mut Engine, second: u64, nodes: &[(u8, &str)]| {
        for (at, uid) in nodes {
            engine.handle_frame(&beat(*at, uid).with_time(seconds(second as f64 + 0.1)));
        }
        engine.handle_timeout(seconds(second as f64 + 0.9));
    };
    let (staying, moving, leaving) = ([(2, "UNIT01"), (8, "UNIT04")], "UNIT02", "UNIT03");
    for second in 0..3 {
        beats(&mut engine, second, &[staying[0], (4, moving), (6, leaving), staying[1]]);
    }
    let ids: Vec<_> = engine.devices().iter().map(|device| device.id).collect();
    let at = |engine: &Engine, id| engine.device(id).map(|device| device.address.number());
    assert_eq!(ids.iter().map(|id| at(&engine, *id)).collect::<Vec<_>>(), [2, 4, 6, 8].map(Some));
    // The moved device has two rows at first, with the number of the second one not used again.
    for second in 3..15 {
        beats(&mut engine, second, &[staying[0], (20, moving), staying[1], (30, "UNIT05")]);
    }
    assert_eq!(engine.devices().len(), 5);
    engine.remove_lost_devices();
    beats(&mut engine, 15, &[staying[0], (40, "UNIT06"), staying[1]]);
    assert_eq!(
        ids.iter().map(|id| at(&engine, *id)).collect::<Vec<_>>(),
        [Some(2), Some(20), None, Some(8)]
    );
    for device in engine.devices() {
        assert_eq!(at(&engine, device.id), Some(device.address.number()));
        assert_eq!(engine.device_at(device.address).map(|it| it.id), Some(device.id));
    }
    assert_eq!(engine.devices().len(), 5);
    assert!(engine.device_at(Address::new(6).unwrap()).is_none());
}

#[test]
fn heartbeat_lost_in_short_outage_is_not_missed() {
    let beats_missed = |outage: (Option<f64>, f64), next: u64| {
        let config = Config { has_loopback: false, listen_only: true, ..Config::default() };
        let mut engine = Engine::new(Instant::ZERO, config);
        let beats = |engine: &mut Engine, second: u64| {
            engine.handle_frame(&beat(5, "FEED01").with_time(seconds(second as f64 + 0.1)));
        };
        (0..=3).for_each(|second| beats(&mut engine, second));
        if let Some(begin) = outage.0 {
            engine.suspend(seconds(begin));
        }
        engine.restart(seconds(outage.1));
        (next..=next + 2).for_each(|second| beats(&mut engine, second));
        engine.devices()[0].heartbeat.missed
    };
    // The heartbeat of 4.1 s: received on time, slightly late, or after the outage.
    assert_eq!(beats_missed((Some(4.08), 4.12), 5), 0);
    assert_eq!(beats_missed((Some(4.15), 4.3), 5), 0);
    assert_eq!(beats_missed((None, 4.15), 5), 0);
    // The next heartbeat was due after the outage, or before it began.
    assert_eq!(beats_missed((Some(4.08), 4.12), 6), 1);
    assert_eq!(beats_missed((Some(4.6), 4.7), 5), 1);
    assert_eq!(beats_missed((Some(4.6), 5.0), 5), 1);
    assert_eq!(beats_missed((Some(4.05), 6.3), 8), 1);
}

fn confidence(engine: &Engine, kind: FindingKind) -> Option<FindingState> {
    engine.findings().iter().find(|it| it.key.kind == kind).map(|it| it.state)
}

#[test]
fn node_that_keeps_address_0_holds_it() {
    let mut engine =
        Engine::new(Instant::ZERO, Config { has_loopback: false, ..Config::default() });
    // The tool starts while descan holds 0.
    let events = run(&mut engine, seconds(30.0), |now| {
        let beats = now >= seconds(3.0) && now.as_micros() % 1_000_000 == 0;
        beats.then(|| beat(0, "TOOL"))
    });
    let OwnAddress::Held(own) = engine.own_address() else { panic!("{events:#?}") };
    assert_ne!(own, Address::DEBUG);
    let ours: Vec<_> = events.iter().filter(|it| it.starts_with("we ")).collect();
    assert_eq!(ours, ["we are 0", "we gave up 0", &format!("we are {own}")]);
    // Only suspected: the tool is alone at 0 by now.
    let findings: Vec<_> = events.iter().filter(|it| it.starts_with("finding")).collect();
    assert_eq!(
        findings,
        [
            "finding two-debug-devices suspected at 0",
            "finding two-debug-devices cleared at 0",
            "finding address-contested suspected at 0",
            "finding address-contested cleared at 0",
        ]
    );
}

#[test]
fn two_foreign_tools_at_0_are_a_confirmed_conflict() {
    let mut engine =
        Engine::new(Instant::ZERO, Config { has_loopback: false, ..Config::default() });
    let events = run(&mut engine, seconds(15.0), |now| match now.as_micros() % 1_000_000 {
        100_000 => Some(beat(0, "TOOL")),
        600_000 => Some(beat(0, "OTHER")),
        _ => None,
    });
    assert!(matches!(engine.own_address(), OwnAddress::Held(own) if own != Address::DEBUG));
    assert_eq!(confidence(&engine, FindingKind::TwoDebugDevices), Some(FindingState::Confirmed));
    let found = engine.findings().iter().find(|it| it.key.kind == FindingKind::TwoDebugDevices);
    let found = found.unwrap();
    assert_eq!(
        found.text,
        "Two debug devices use address 0: heartbeats alternate between the UIDs TOOL and OTHER."
    );
    assert!(!found.remedy.contains("moves to another"), "{}", found.remedy);
    assert!(!events.iter().any(|it| it.contains("gave way")), "{events:#?}");
}

#[test]
fn request_from_own_address_reveals_other_node() {
    let question = {
        let header = Header::broadcast(Address::DEBUG, 33, false, Profile::default().des_service());
        Frame::classic(header.encode(), &[4, b'D', b'E', b'S', 1])
    };
    let (mut engine, _) = alone(Config::default());
    assert_eq!(engine.own_address(), OwnAddress::Held(Address::DEBUG));
    engine.handle_frame(&question.with_time(seconds(2.0)));
    assert_eq!(engine.own_address(), OwnAddress::Listening);
    assert!(engine.poll_transmit(seconds(2.0)).is_none(), "no more from an address of others");
}

#[test]
fn other_node_after_own_claim_stops_transmission() {
    let mut profile = Profile::default();
    profile.heartbeat.announce = descan::wire::profile::Announce::Always;
    let config = Config { profile: Arc::new(profile), has_loopback: false, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let due = seconds(1.5);
    engine.handle_timeout(due);
    assert_eq!(engine.own_address(), OwnAddress::Held(Address::DEBUG));
    engine.handle_frame(&beat(0, "TOOL").with_time(due));
    assert_eq!(engine.own_address(), OwnAddress::Listening);
    assert!(engine.poll_transmit(due).is_none(), "what was to be sent is not sent");
}

#[test]
fn first_sender_at_chosen_address_holds_it() {
    let mut engine =
        Engine::new(Instant::ZERO, Config { has_loopback: false, ..Config::default() });
    let (mut now, mut chosen, mut sent) = (Instant::ZERO, None, Vec::new());
    while now < seconds(15.0) {
        now += Duration::from_millis(1);
        // A tool holds 0; another device takes the chosen address before descan claims it.
        if now.as_micros() % 1_000_000 == 0 {
            engine.handle_frame(&beat(0, "TOOL").with_time(now));
            if let Some(chosen) = chosen {
                engine.handle_frame(&beat(chosen, "OTHER").with_time(now));
            }
        }
        if let (None, OwnAddress::Claiming(address)) = (chosen, engine.own_address()) {
            chosen = Some(address.number());
            engine.handle_frame(&beat(address.number(), "OTHER").with_time(now));
            assert_eq!(engine.own_address(), OwnAddress::Listening);
        }
        engine.handle_timeout(now);
        while let Some(frame) = engine.poll_transmit(now) {
            sent.push(Header::decode(frame.platform_id().unwrap()).source.number());
        }
    }
    let OwnAddress::Held(own) = engine.own_address() else { panic!("{:?}", engine.own_address()) };
    assert_ne!(Some(own.number()), chosen);
    assert!(!sent.is_empty() && sent.iter().all(|source| *source == own.number()), "{sent:?}");
}

#[test]
fn no_free_address_means_listening_until_one_is_free() {
    let mut engine =
        Engine::new(Instant::ZERO, Config { has_loopback: false, ..Config::default() });
    // All nodes send a heartbeat each second, including 0; from 10 s on, 77 is silent.
    let events = run(&mut engine, seconds(20.0), |now| {
        let at = now.as_micros() % 1_000_000 / 1000;
        let at = u8::try_from(at).ok().filter(|at| *at < 128)?;
        (at != 77 || now < seconds(10.0)).then(|| beat(at, &format!("N{at}")))
    });
    let ours: Vec<_> =
        events.iter().filter(|it| it.starts_with("we ") || it.contains("free")).collect();
    assert_eq!(ours, ["no address is free", "we are 77"]);
}

#[test]
fn fixed_own_address_in_use_is_waited_for() {
    let wanted = Address::new(5).unwrap();
    let config = Config { address: Some(wanted), has_loopback: false, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let events = run(&mut engine, seconds(30.0), |now| {
        let beats = now < seconds(10.0) && now.as_micros() % 1_000_000 == 0;
        beats.then(|| beat(5, "N5"))
    });
    let ours: Vec<_> =
        events.iter().filter(|it| it.starts_with("we ") || it.contains("free")).collect();
    assert_eq!(ours, ["5 is not free", "we are 5"]);
}

/// Tests two boards with one name and UID: their heartbeats may look like those of one device with
/// half the period, and equal responses may merge on the wire.
#[test]
fn equal_boards_are_confirmed_at_any_phase() {
    let board = || {
        let board = DeviceSpec::new("FEED").fixed(12).fault(Fault::KeepsAddress);
        board.skips_address_resolution().service("AUGER", "2.1")
    };
    let other = |name, address| DeviceSpec::new(name).fixed(address).skips_address_resolution();
    let scenario = Scenario::new(125_000)
        .with(board())
        .with(board().label("FEED'"))
        .with(other("SENS", 13))
        .with(other("ACT", 14));
    let is_missed = |seed: &u64| {
        let config = Config { seed: *seed, ..Config::default() };
        let mut it = Inspection::new(&scenario, *seed, config);
        !it.run_until(seconds(10.0), |engine| {
            engine.findings().iter().any(|it| {
                it.key.kind == FindingKind::SameNameSameAddress
                    && it.state == FindingState::Confirmed
            })
        })
    };
    let missed: Vec<u64> = (0..2000).filter(is_missed).collect();
    assert!(missed.is_empty(), "{} of 2000: {missed:?}", missed.len());
}

#[test]
fn queries_without_response_are_repeated_after_lost_frames() {
    let requests_after = |is_lost: bool| {
        let mut engine =
            Engine::new(Instant::ZERO, Config { has_loopback: false, ..Config::default() });
        let mut requests = 0;
        for millis in 1..9000 {
            let now = Instant::from_micros(millis * 1000);
            if millis % 1000 == 300 {
                engine.handle_frame(&beat(12, "BOILER01").with_time(now));
            }
            if is_lost && millis == 6000 {
                engine.handle_lost_frames(now, 100);
            }
            engine.handle_timeout(now);
            while let Some(frame) = engine.poll_transmit(now) {
                let is_query = frame.same_on_wire(&question(0, 12));
                requests += u32::from(is_query && millis >= 6000);
            }
        }
        requests
    };
    assert_eq!(requests_after(false), 0, "all attempts were used before");
    assert!(requests_after(true) > 0);
}
