//! Descriptors and commands to devices: what is sent, what is known of the responses, and the
//! findings that they give.

use crate::common::harness::Stage;
use crate::common::inspection::Inspection;
use descan::discovery::{
    Config, DeviceId, DeviceRequest, Engine, EventKind, FieldContent, Presence, RequestObstacle,
    RequestOutcome,
};
use descan::finding::{Finding, FindingKind, FindingState};
use descan::frame::Frame;
use descan::learning::ProfileLearner;
use descan::sim::{DeviceAction, DeviceSpec, Fault, Scenario, Sim};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::{
    AddressSetting, BitrateSetting, Capabilities, DescriptorFault, DescriptorField,
    DescriptorValue, FirmwareVersion, Gid,
};
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::{Profile, ProfileKey, ProfileValue, UidProfile};

/// All numbers as they are built in, but given, and those that are not built in.
const GIVEN: &str = "[descriptor]\ngid = 0x010\nuid = 0x011\nsn = 0x012\nfw = 0x013\ncaps = 0x014\n\
    bspd = 0x015\naddr = 0x016\nautostart = 0x017\n\
    [commands]\nidentify = 0x018\nmode = 0x019\nreboot = 0x01A\n\
    [writes]\naddress = 0x016\nbitrate = 0x015\n";

#[test]
fn device_in_idle_is_woken_by_a_command_or_by_power_alone() {
    let sleeper = |name: &str, address, by_command| {
        let mut spec = settled(name, address);
        spec.idle_ends_by_command = by_command;
        spec
    };
    let devices = [sleeper("A", 10, true), sleeper("B", 11, false)];
    let mut bus = bus(&devices, GIVEN);
    run(&mut bus, 6.0);
    let mode = |bus: &Inspection, address| {
        let row = bus.engine.devices().iter().find(|it| it.address.number() == address).unwrap();
        (row.mode, row.presence)
    };
    let command = |bus: &mut Inspection, address, code: u8, time: f64| {
        let device = device(bus, address);
        let service = Service::from_bits(0x019);
        let request = DeviceRequest { device, service, data: vec![code] };
        bus.engine.request(at(time), request).unwrap();
    };
    command(&mut bus, 10, 6, 6.0);
    command(&mut bus, 11, 6, 6.0);
    run(&mut bus, 16.0);
    assert_eq!(mode(&bus, 10), (Some(Mode::Idle), Presence::Online));
    assert_eq!(mode(&bus, 11), (Some(Mode::Idle), Presence::Asleep));
    command(&mut bus, 10, 4, 16.0);
    command(&mut bus, 11, 4, 16.0);
    run(&mut bus, 20.0);
    assert_eq!(mode(&bus, 10), (Some(Mode::Work), Presence::Online));
    assert_eq!(mode(&bus, 11).1, Presence::Asleep);
}

fn at(seconds: f64) -> Instant {
    Instant::ZERO + Duration::from_secs_f64(seconds)
}

fn uid(text: &str) -> Uid {
    Uid::parse(text, &UidProfile::default()).unwrap()
}

/// A device that has its address from the start.
fn settled(name: &str, address: u8) -> DeviceSpec {
    let mut spec = DeviceSpec::new(name).fixed(address);
    spec.skips_address_resolution = true;
    spec
}

/// A bus whose devices have this profile, and an inspector that has it, too.
fn bus(devices: &[DeviceSpec], profile: &str) -> Inspection {
    let profile = Profile::parse(profile).unwrap();
    let scenario = devices.iter().cloned().fold(Scenario::new(125_000), Scenario::with);
    let mut sim = Sim::with_profile(&scenario, 3, profile.clone());
    let station = sim.attach();
    let config =
        Config { bitrate: Some(125_000), profile: profile.into(), seed: 3, ..Config::default() };
    let engine = Engine::new(Instant::ZERO, config);
    Inspection { sim, station, engine, events: Vec::new(), frames: Vec::new() }
}

fn run(bus: &mut Inspection, seconds: f64) {
    bus.run_until(at(seconds), |_| false);
}

fn device(bus: &Inspection, address: u8) -> DeviceId {
    bus.engine.device_at(Address::new(address).unwrap()).expect("a device").id
}

/// Requests to one device of a service, in the order of their frames.
fn requests(bus: &Inspection, services: std::ops::RangeInclusive<u16>) -> Vec<(u16, Frame)> {
    let of_frame = |frame: &Frame| {
        let header = Header::decode(frame.platform_id()?);
        let number = header.service.number();
        let is_it = frame.is_tx && !header.response && !header.broadcast;
        (is_it && services.contains(&number)).then_some((number, *frame))
    };
    bus.frames.iter().filter_map(of_frame).collect()
}

fn content(bus: &Inspection, address: u8, field: DescriptorField) -> Option<FieldContent> {
    let device = bus.engine.device_at(Address::new(address).unwrap())?;
    device.descriptor.reading(field).map(|reading| reading.content.clone())
}

fn open_finding(bus: &Inspection, kind: FindingKind) -> Option<&Finding> {
    let mut findings = bus.engine.findings().iter();
    findings.find(|it| it.key.kind == kind && it.state != FindingState::Cleared)
}

fn outcomes(bus: &Inspection) -> Vec<RequestOutcome> {
    let ended = bus.events.iter().filter_map(|event| match &event.kind {
        EventKind::RequestEnded { outcome, .. } => Some(outcome.clone()),
        _ => None,
    });
    ended.collect()
}

fn feed() -> DeviceSpec {
    let mut feed = settled("FEED", 10).uid(uid("BOILER01"));
    feed.descriptor.gid = Gid([0, 0, 0, 0xAB, 0, 0x21]);
    feed.descriptor.serial = 0x0102_0304;
    feed.descriptor.firmware = FirmwareVersion { major: 2, minor: 0x0103 };
    feed.descriptor.capabilities =
        Capabilities { is_programmable: true, has_fpu: true, cpu: 2, cpu_flags: 0 };
    feed.descriptor.bitrate = Some(BitrateSetting { rate: 125_000, is_fixed: true });
    feed
}

#[test]
fn all_fields_are_read_in_both_byte_orders() {
    for order in ["little", "big"] {
        let profile = GIVEN.replace("[commands]", &format!("byte_order = \"{order}\"\n[commands]"));
        let mut bus = bus(&[feed(), settled("SENS", 12)], &profile);
        run(&mut bus, 5.0);
        assert_eq!(content(&bus, 10, DescriptorField::Gid), None, "not asked");
        let id = device(&bus, 10);
        assert_eq!(bus.engine.read_descriptor(at(5.0), id, None), 8);
        run(&mut bus, 7.0);
        let spec = feed();
        let values = [
            DescriptorValue::Gid(spec.descriptor.gid),
            DescriptorValue::Uid(uid("BOILER01")),
            DescriptorValue::Serial(0x0102_0304),
            DescriptorValue::Firmware(spec.descriptor.firmware),
            DescriptorValue::Capabilities(spec.descriptor.capabilities),
            DescriptorValue::Bitrate(BitrateSetting { rate: 125_000, is_fixed: true }),
            DescriptorValue::Address(AddressSetting::Fixed(Address::new(10).unwrap())),
            DescriptorValue::Autostart(true),
        ];
        for (field, value) in DescriptorField::ALL.into_iter().zip(values) {
            assert_eq!(content(&bus, 10, field), Some(FieldContent::Value(value)), "{order}");
        }
        let mut learner = ProfileLearner::default();
        learner.set_profile(&Profile::parse(GIVEN).unwrap());
        bus.frames.iter().for_each(|frame| learner.handle_frame(frame));
        let learnt = learner.proposals().into_iter().find(|it| it.key == ProfileKey::ByteOrder);
        assert_eq!(learnt.map(|it| it.value), Some(ProfileValue::Text(order.to_owned())));
        let read: Vec<_> = requests(&bus, 0x010..=0x01A).into_iter().map(|it| it.0).collect();
        assert_eq!(read, (0x010..=0x017).collect::<Vec<_>>(), "each once, of one device");
        assert!(requests(&bus, 0x010..=0x017).iter().all(|(_, frame)| frame.is_empty()));
        let is_read =
            |kind: &EventKind| matches!(kind, EventKind::DescriptorRead { values: 8, fields: 8 });
        assert_eq!(bus.events.iter().filter(|event| is_read(&event.kind)).count(), 1);
    }
}

#[test]
fn only_fields_with_a_given_number_are_asked_for() {
    let mut bus = bus(&[feed()], "[descriptor]\nfw = 0x013\nauto = true\n");
    let companion = bus.sim.attach();
    let _ = companion;
    run(&mut bus, 8.0);
    let read: Vec<_> = requests(&bus, 0x010..=0x01A).into_iter().map(|it| it.0).collect();
    assert_eq!(read, [0x013]);
    let mut none = self::bus(&[feed(), settled("SENS", 12)], "[descriptor]\nauto = true\n");
    run(&mut none, 8.0);
    assert_eq!(requests(&none, 0x010..=0x01A).len(), 0);
}

#[test]
fn auto_reads_each_device_once_and_again_after_a_restart() {
    let profile = GIVEN.replace("[commands]", "auto = true\n[commands]");
    let devices: Vec<DeviceSpec> = (1..=20).map(|at| settled(&format!("N{at:03}"), at)).collect();
    let mut bus = bus(&devices, &profile);
    run(&mut bus, 40.0);
    assert_eq!(requests(&bus, 0x010..=0x017).len(), 20 * 8);
    assert!(bus.engine.progress().is_complete);
    let one = bus.sim.device("N007").unwrap();
    bus.sim.apply(one, DeviceAction::Firmware(FirmwareVersion { major: 9, minor: 1 }));
    bus.sim.apply(one, DeviceAction::Reboot { services: None });
    run(&mut bus, 60.0);
    let version = FirmwareVersion { major: 9, minor: 1 };
    let value = FieldContent::Value(DescriptorValue::Firmware(version));
    assert_eq!(content(&bus, 7, DescriptorField::Firmware), Some(value));
    assert_eq!(requests(&bus, 0x010..=0x017).len(), 21 * 8);
}

#[test]
fn reads_stay_within_the_steady_share() {
    let profile = GIVEN.replace("[commands]", "auto = true\n[commands]");
    let devices: Vec<DeviceSpec> = (1..=100).map(|at| settled(&format!("N{at:03}"), at)).collect();
    let mut bus = bus(&devices, &profile);
    run(&mut bus, 60.0);
    let reads = requests(&bus, 0x010..=0x017);
    assert_eq!(reads.len(), 800);
    // 5 % of 125 kbit/s: of a second, 6250 bits; request and response have at least 67 bits each.
    for window in reads.windows(50) {
        let took = window[49].1.time.since(window[0].1.time).as_secs_f64();
        let bits = 49.0 * 2.0 * 67.0;
        assert!(bits / took <= 6_250.0, "{bits} bits in {took} s");
    }
}

#[test]
fn wrong_length_is_shown_as_received_and_is_a_finding() {
    let mut short = feed();
    short.faults.set(Fault::ShortDescriptor, true);
    let mut bus = bus(&[short, settled("SENS", 12)], GIVEN);
    run(&mut bus, 5.0);
    let id = device(&bus, 10);
    bus.engine.read_descriptor(at(5.0), id, None);
    run(&mut bus, 7.0);
    let fault = DescriptorFault::Length { expected: 4 };
    let data = vec![2, 0, 3];
    let malformed = FieldContent::Malformed { data, fault };
    assert_eq!(content(&bus, 10, DescriptorField::Firmware), Some(malformed));
    for field in DescriptorField::ALL {
        let content = content(&bus, 10, field);
        assert!(matches!(content, Some(FieldContent::Malformed { .. })), "{field:?}: {content:?}");
    }
    assert_eq!(open_finding(&bus, FindingKind::MalformedAnswer).map(|it| &it.text), None);
}

#[test]
fn malformed_descriptor_is_a_finding_until_it_is_read_well() {
    let mut short = feed();
    short.faults.set(Fault::ShortDescriptor, true);
    let scenario = Scenario::new(125_000).with(short).with(settled("SENS", 12));
    let profile = Profile::parse("[descriptor]\nfw = 0x013\nautostart = 0x017\n").unwrap();
    let config = Config { profile: profile.into(), seed: 7, ..Config::default() };
    let mut stage = Stage::with(&scenario, None, config);
    stage.until(6.0).keys("I y").until(8.0);
    let kind = FindingKind::MalformedDescriptor;
    assert_eq!(
        problems(&stage, kind),
        ["FEED at 10 sends a malformed descriptor: firmware 02 00 03: 4 bytes expected; \
          AUTOSTART no data."]
    );
    let found = &stage.app.problems_with(|finding| finding.key.kind == kind)[0];
    assert_eq!((found.findings.len(), found.head().evidence.len()), (1, 2));
    let device = stage.sim.device("FEED").unwrap();
    stage.sim.apply(device, DeviceAction::RemoveFault(Fault::ShortDescriptor));
    stage.keys("I y").until(10.0);
    assert_eq!(problems(&stage, kind), [""; 0]);
}

#[test]
fn device_without_a_descriptor_gives_no_value_and_no_finding() {
    let mut mute = feed();
    mute.faults.set(Fault::NoDescriptor, true);
    let mut bus = bus(&[mute, settled("SENS", 12)], GIVEN);
    run(&mut bus, 5.0);
    let id = device(&bus, 10);
    bus.engine.read_descriptor(at(5.0), id, None);
    run(&mut bus, 20.0);
    for field in DescriptorField::ALL {
        assert_eq!(content(&bus, 10, field), Some(FieldContent::NoResponse));
    }
    assert_eq!(requests(&bus, 0x010..=0x017).len(), 8, "none is repeated");
    assert_eq!(open_finding(&bus, FindingKind::MalformedAnswer).map(|it| &it.text), None);
}

#[test]
fn reads_of_another_node_are_taken_only_by_given_numbers() {
    // A log of an inspector that reads, then read by others.
    let mut asking = bus(&[feed(), settled("SENS", 12)], GIVEN);
    run(&mut asking, 5.0);
    let id = device(&asking, 10);
    asking.engine.read_descriptor(at(5.0), id, None);
    run(&mut asking, 8.0);
    for (profile, is_known) in [(GIVEN, true), ("", false)] {
        for is_marked in [true, false] {
            let profile = Profile::parse(profile).unwrap().into();
            let config = Config { listen_only: true, profile, ..Config::default() };
            let mut engine = Engine::new(Instant::ZERO, config);
            for frame in &asking.frames {
                let mut frame = *frame;
                frame.is_tx &= is_marked;
                engine.handle_frame(&frame);
            }
            let device = engine.device_at(Address::new(10).unwrap()).unwrap();
            let count = device.descriptor.readings().len();
            assert_eq!(count, if is_known { 8 } else { 0 }, "tx marked: {is_marked}");
        }
    }
}

#[test]
fn requests_end_with_what_the_device_does() {
    let mut locked = feed();
    locked.faults.set(Fault::Locked, true);
    let mut bus = bus(&[locked, settled("SENS", 12), settled("ACT", 14)], GIVEN);
    run(&mut bus, 5.0);
    let request = |bus: &mut Inspection, address, service, data: &[u8]| {
        let request = DeviceRequest {
            device: device(bus, address),
            service: Service::new(service).unwrap(),
            data: data.to_vec(),
        };
        let now = bus.sim.now();
        bus.engine.request(now, request)
    };
    request(&mut bus, 12, 0x018, &[]).expect("identify");
    request(&mut bus, 10, 0x016, &[33]).expect("the address of a locked device");
    request(&mut bus, 14, 0x3FF, &[]).expect("an unknown service");
    assert_eq!(request(&mut bus, 14, 0x018, &[0; 9]), None, "longer than a frame");
    run(&mut bus, 8.0);
    assert_eq!(
        outcomes(&bus),
        [
            RequestOutcome::Responded(vec![]),
            RequestOutcome::Refused(vec![]),
            RequestOutcome::NoResponse
        ]
    );
    assert_eq!(requests(&bus, 0x3FF..=0x3FF).len(), 1, "sent once");
    // A device that has left gets nothing.
    let gone = bus.sim.device("ACT").unwrap();
    let row = device(&bus, 14);
    bus.sim.apply(gone, DeviceAction::PowerOff);
    run(&mut bus, 20.0);
    let service = Service::new(0x018).unwrap();
    bus.engine.request(at(20.0), DeviceRequest { device: row, service, data: vec![] });
    run(&mut bus, 22.0);
    let left = RequestOutcome::NotSent(RequestObstacle::DeviceLeft);
    assert_eq!(outcomes(&bus).last(), Some(&left));
}

#[test]
fn write_moves_a_device_now_or_at_its_restart() {
    for effect in ["now", "restart"] {
        let profile = format!("{GIVEN}effect = \"{effect}\"\n");
        let mut bus = bus(&[feed(), settled("SENS", 12)], &profile);
        run(&mut bus, 5.0);
        let row = device(&bus, 10);
        let send = |bus: &mut Inspection, service, data: &[u8]| {
            let service = Service::new(service).unwrap();
            let now = bus.sim.now();
            bus.engine.request(now, DeviceRequest { device: row, service, data: data.to_vec() });
        };
        send(&mut bus, 0x016, &[40]);
        run(&mut bus, 15.0);
        let address = |bus: &Inspection| bus.engine.device(row).unwrap().address.number();
        assert_eq!(address(&bus), if effect == "now" { 40 } else { 10 });
        let id = bus.engine.device(row).unwrap().id;
        bus.engine.read_descriptor(at(15.0), id, Some(DescriptorField::Address));
        send(&mut bus, 0x01A, &[]);
        run(&mut bus, 30.0);
        assert_eq!(address(&bus), 40);
        let stored = bus.engine.device(row).unwrap().descriptor.value(DescriptorField::Address);
        let setting = AddressSetting::Fixed(Address::new(40).unwrap());
        assert_eq!(stored, Some(DescriptorValue::Address(setting)));
    }
}

#[test]
fn other_bit_rate_takes_a_device_off_the_bus() {
    let mut bus = bus(&[feed(), settled("SENS", 12)], GIVEN);
    run(&mut bus, 5.0);
    let row = device(&bus, 10);
    let service = Service::new(0x015).unwrap();
    bus.engine.request(at(5.0), DeviceRequest { device: row, service, data: vec![1] });
    run(&mut bus, 20.0);
    assert_eq!(outcomes(&bus), [RequestOutcome::Responded(vec![])]);
    assert!(!bus.engine.device(row).unwrap().is_present());
}

#[test]
fn requests_in_cfg_are_a_finding_and_others_are_none() {
    let requester = |mode: Mode, address| {
        let mut spec = settled(&format!("R{address:03}"), address);
        spec.mode = Some(mode);
        spec.faults.set(Fault::SendsRequests, true);
        spec
    };
    let mut bus = bus(&[requester(Mode::Cfg, 20), requester(Mode::Work, 21)], "");
    run(&mut bus, 15.0);
    let found = open_finding(&bus, FindingKind::CfgSendsRequests).expect("a finding");
    assert_eq!(found.state, FindingState::Confirmed);
    assert_eq!(found.addresses, [Address::new(20).unwrap()]);
    assert!(!found.evidence.is_empty());
    // One that is set to WORK sends its first request before its first heartbeat there.
    let mut bus = self::bus(&[requester(Mode::Work, 21), settled("SENS", 12)], "");
    let device = bus.sim.device("R021").unwrap();
    for round in 0..6 {
        bus.sim.apply(device, DeviceAction::Mode(Mode::Cfg));
        bus.sim.apply(device, DeviceAction::RemoveFault(Fault::SendsRequests));
        run(&mut bus, 6.0 + 6.0 * f64::from(round));
        bus.sim.apply(device, DeviceAction::Mode(Mode::Work));
        bus.sim.apply(device, DeviceAction::AddFault(Fault::SendsRequests));
        run(&mut bus, 9.0 + 6.0 * f64::from(round));
    }
    assert_eq!(open_finding(&bus, FindingKind::CfgSendsRequests).map(|it| &it.text), None);
}

/// Returns the texts of the open problems of a kind.
fn problems(stage: &Stage, kind: FindingKind) -> Vec<String> {
    let problems = stage.app.problems_with(|finding| finding.key.kind == kind);
    let findings = problems.iter().flat_map(|problem| &problem.findings);
    findings.map(|finding| finding.text.clone()).collect()
}

#[test]
fn settings_that_move_a_device_at_its_next_start_are_found() {
    let mut sens = settled("SENS", 12);
    sens.descriptor.bitrate = Some(BitrateSetting { rate: 250_000, is_fixed: true });
    let mut act = settled("ACT", 14);
    act.descriptor.bitrate = Some(BitrateSetting { rate: 250_000, is_fixed: false });
    let scenario = [feed(), sens, act].into_iter().fold(Scenario::new(125_000), Scenario::with);
    let profile = GIVEN.replace("[commands]", "auto = true\n[commands]");
    let profile = Profile::parse(&profile).unwrap().into();
    let file = r#"{"devices":[{"name":"FEED","address":11,"static":true},
        {"name":"SENS","address":12,"static":true}]}"#;
    let config = Config { profile, bitrate: Some(125_000), seed: 7, ..Config::default() };
    let mut stage = Stage::with(&scenario, Some(file), config);
    stage.until(12.0);
    let rates = problems(&stage, FindingKind::FixedBitrateDiffers);
    assert_eq!(
        rates,
        [
            "SENS at 12 is set to fixed 250 kbit/s, the bus has 125 kbit/s: it is lost at its next restart."
        ]
    );
    let addresses = problems(&stage, FindingKind::FixedAddressDiffers);
    assert_eq!(addresses, ["FEED is set to the fixed address 10; the file pins it to 11."]);
    stage.write(&file.replace("11", "10")).until(13.0);
    assert_eq!(problems(&stage, FindingKind::FixedAddressDiffers), [""; 0]);
}

#[test]
fn services_of_one_type_and_major_version_are_compared() {
    let of_type = |name: &str, address, major, services: &[&str]| {
        let mut spec = settled(name, address);
        spec.descriptor.gid = Gid([0, 0, 0, 0, 0, 0x21]);
        spec.descriptor.firmware = FirmwareVersion { major, minor: u16::from(address) };
        let text = |text: &str| text.as_bytes().to_vec();
        let version = address.to_string();
        spec.services = services.iter().map(|name| vec![text(name), text(&version)]).collect();
        spec
    };
    let devices = [
        of_type("A", 1, 2, &["DES", "TEMP"]),
        of_type("B", 2, 2, &["DES", "TEMP"]),
        of_type("C", 3, 2, &["DES", "OXYG"]),
        // Another major version may have other services.
        of_type("D", 4, 3, &["DES"]),
    ];
    let scenario = devices.into_iter().fold(Scenario::new(125_000), Scenario::with);
    let profile = GIVEN.replace("[commands]", "auto = true\n[commands]");
    let profile = Profile::parse(&profile).unwrap().into();
    let config = Config { profile, bitrate: Some(125_000), seed: 7, ..Config::default() };
    let mut stage = Stage::with(&scenario, None, config);
    stage.until(12.0);
    assert_eq!(
        problems(&stage, FindingKind::TypeServicesDiffer),
        ["C at 3 and A at 1 are of one type (GID 0x000000000021, firmware 2), but the first also \
          has OXYG and lacks TEMP."]
    );
}

/// A candump log, as frames received: time in ms, identifier, data.
fn heard(engine: &mut Engine, lines: &[(u64, u32, &[u8])]) {
    for (millis, id, data) in lines {
        let at = Instant::ZERO + Duration::from_millis(*millis);
        engine.handle_frame(&Frame::classic(*id, data).with_time(at));
        engine.handle_timeout(at);
    }
}

#[test]
fn response_to_a_write_is_no_value_of_the_field() {
    let profile = Profile::parse(GIVEN).unwrap().into();
    let config = Config { listen_only: true, profile, ..Config::default() };
    let mut engine = Engine::new(Instant::ZERO, config);
    let node = Address::new(10).unwrap();
    let service = Service::new(0x016).unwrap();
    let request = Header::request(Address::DEBUG, node, false, service);
    let response = request.response(node, false).encode();
    let request = request.encode();
    let heartbeat = Header::unsolicited(node, 7, false, Service::new(1).unwrap()).encode();
    let beat = [0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x11, 4, 0];
    let beats = [(0, heartbeat, &beat[..]), (1000, heartbeat, &beat)];
    heard(&mut engine, &beats);
    let address = |engine: &Engine| {
        let device = engine.device_at(node).expect("a device");
        device.descriptor.reading(DescriptorField::Address).map(|it| it.content.clone())
    };
    let value = |number| {
        let setting = AddressSetting::Fixed(Address::new(number).unwrap());
        Some(FieldContent::Value(DescriptorValue::Address(setting)))
    };
    heard(&mut engine, &[(1100, request, &[]), (1105, response, &[10])]);
    assert_eq!(address(&engine), value(10));
    // A write and a read at once, answered in their order.
    heard(&mut engine, &[(1200, request, &[33]), (1201, request, &[]), (1205, response, &[])]);
    assert_eq!(address(&engine), None, "it was written");
    heard(&mut engine, &[(1210, response, &[33])]);
    assert_eq!(address(&engine), value(33));
}

#[test]
fn requests_with_either_u_bit_are_told_apart() {
    // A device that says with U = 0 that it works may have done so between two heartbeats.
    for (from_non_working, state) in
        [(true, FindingState::Confirmed), (false, FindingState::Suspected)]
    {
        let mut engine =
            Engine::new(Instant::ZERO, Config { listen_only: true, ..Config::default() });
        let node = Address::new(20).unwrap();
        let beat = Header::unsolicited(node, 7, true, Service::new(1).unwrap()).encode();
        let mut request = Header::broadcast(node, 9, false, Service::new(0x100).unwrap());
        request.from_non_working = from_non_working;
        for second in 0..12 {
            heard(&mut engine, &[(1000 * second, beat, &[1, 2, 3, 4, 5, 6, 2, 0])]);
            heard(&mut engine, &[(1000 * second + 500, request.encode(), &[])]);
        }
        let found =
            engine.findings().iter().find(|it| it.key.kind == FindingKind::CfgSendsRequests);
        assert_eq!(found.map(|it| it.state), Some(state), "U = {from_non_working}");
    }
}

#[test]
fn debug_device_at_any_address_may_send_requests() {
    for (uid, is_found) in [("DSCAN1", false), ("BOILER1", true)] {
        let mut engine =
            Engine::new(Instant::ZERO, Config { listen_only: true, ..Config::default() });
        let node = Address::new(20).unwrap();
        let beat = Header::unsolicited(node, 7, true, Service::new(1).unwrap()).encode();
        let mut request = Header::broadcast(node, 9, false, Service::new(0x100).unwrap());
        request.from_non_working = true;
        let uid = Uid::parse(uid, &UidProfile::default()).unwrap();
        let data: Vec<u8> = uid.0.into_iter().chain([2, 0]).collect();
        for second in 0..12 {
            heard(&mut engine, &[(1000 * second, beat, &data)]);
            heard(&mut engine, &[(1000 * second + 500, request.encode(), &[])]);
        }
        let mut kinds = engine.findings().iter().map(|it| it.key.kind);
        assert_eq!(kinds.any(|kind| kind == FindingKind::CfgSendsRequests), is_found, "{uid:?}");
    }
}

#[test]
fn mode_that_contradicts_u_is_no_mode_that_forbids_requests() {
    let mut engine = Engine::new(Instant::ZERO, Config { listen_only: true, ..Config::default() });
    let node = Address::new(20).unwrap();
    let beat = Header::unsolicited(node, 7, false, Service::new(1).unwrap()).encode();
    let other = Header::unsolicited(Address::new(21).unwrap(), 7, false, Service::new(1).unwrap());
    let request = Header::broadcast(node, 9, false, Service::new(0x100).unwrap()).encode();
    for second in 0..12 {
        heard(
            &mut engine,
            &[
                (1000 * second, beat, &[1, 2, 3, 4, 5, 6, 2, 0]),
                (1000 * second + 100, other.encode(), &[1, 2, 3, 4, 5, 7, 4, 0]),
                (1000 * second + 500, request, &[]),
            ],
        );
    }
    let found = engine.findings().iter().find(|it| it.key.kind == FindingKind::CfgSendsRequests);
    assert_eq!(found.map(|it| &it.text), None);
}
