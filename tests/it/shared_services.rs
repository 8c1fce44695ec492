//! Services of several devices at one address.

use crate::common::inspection::Inspection;
use descan::discovery::{
    Config, Device, DeviceService, Engine, EventKind, QueryFault, ServicesNews,
};
use descan::finding::FindingState;
use descan::frame::{Frame, FrameKind};
use descan::sim::{DeviceSpec, Fault, Scenario};
use descan::text::Name;
use descan::time::{Duration, Instant};
use descan::wire::des;
use descan::wire::id::{Address, Header};
use descan::wire::node::Uid;
use descan::wire::profile::Profile;

const ADDRESS: u8 = 14;
const SECOND_AT: Duration = Duration::from_secs(12);

/// A board that responds after `delay`, in microseconds.
fn board(uid: u8, heater: &str, delay: u64) -> DeviceSpec {
    let delay = Duration::from_micros(delay);
    let device = DeviceSpec::new("BOILER").uid(Uid([uid; 6])).fixed(ADDRESS);
    let mut device = device.skips_address_resolution().fault(Fault::KeepsAddress);
    device.response_delay = (delay, delay);
    device.service("HEATER", heater).service("PUMP", "3.1")
}

/// A bus with two boards of one name at one address, the second from 12 s on.
fn two_boards(second: DeviceSpec) -> Inspection {
    let mut scenario = Scenario::new(250_000);
    scenario.devices.push(board(0x11, "2.0", 1_000));
    scenario.devices.push(second.label("second").power_on(SECOND_AT + Duration::from_millis(370)));
    Inspection::new(&scenario, 1, Config::default())
}

fn at(seconds: u64) -> Instant {
    Instant::ZERO + Duration::from_secs(seconds)
}

fn row(bus: &Inspection) -> &Device {
    bus.engine.device_at(Address::new(ADDRESS).unwrap()).expect("a device at the address")
}

/// The services with their versions, but DES.
fn versions(list: &[DeviceService]) -> Vec<String> {
    let others = list.iter().filter(|service| service.name.to_string() != "DES");
    others.map(|service| format!("{} {}", service.name, service.version)).collect()
}

fn errors(bus: &Inspection) -> usize {
    bus.frames.iter().filter(|frame| frame.kind == FrameKind::Error).count()
}

/// Returns true for the first frame of a service list from the address.
fn is_first_frame(frame: &Frame) -> bool {
    let from = frame.platform_id().map(|id| Header::decode(id).source.number());
    from == Some(ADDRESS) && matches!(frame.data(), [0x10, _, des::TYPE_SERVICES, ..])
}

fn is_confirmed(bus: &Inspection) -> bool {
    let mut findings = bus.engine.findings().iter();
    findings.any(|it| it.state == FindingState::Confirmed && it.key.kind.is_conflict())
}

#[test]
fn second_board_at_an_address_has_its_own_service_list() {
    // The second one begins after the list of the first, or while it is sent.
    for delay in [4_000, 8_000, 15_000, 80_000] {
        let mut bus = two_boards(board(0x22, "2.5", delay));
        bus.run_until(at(12), |_| false);
        assert_eq!(versions(row(&bus).services.as_ref().unwrap())[0], "HEATER 2.0");
        bus.run_until(at(40), |_| false);
        assert!(is_confirmed(&bus));
        let device = row(&bus);
        assert!(!device.services_are_shared);
        assert_eq!(versions(device.services.as_ref().unwrap())[0], "HEATER 2.0");
        let [other] = &device.other_services[..] else { panic!("{:?}", device.other_services) };
        assert_eq!(versions(other), ["HEATER 2.5", "PUMP 3.1"]);
        assert_eq!(errors(&bus), 0, "{delay} µs");
        let news: Vec<ServicesNews> = bus
            .events
            .iter()
            .filter_map(|event| match event.kind {
                EventKind::Services { news, .. } => Some(news),
                _ => None,
            })
            .collect();
        assert_eq!(news, [ServicesNews::First, ServicesNews::OtherDevice]);
    }
}

#[test]
fn both_service_lists_are_requested_again_by_a_rescan() {
    let mut bus = two_boards(board(0x22, "2.5", 8_000));
    bus.run_until(at(40), |_| false);
    let read = |bus: &Inspection| bus.frames.iter().filter(|frame| is_first_frame(frame)).count();
    let before = read(&bus);
    bus.engine.rescan(at(40));
    bus.run_until(at(50), |_| false);
    assert_eq!(read(&bus), before + 2);
    assert_eq!(errors(&bus), 0);
}

/// Two boards that respond one after the other, before flow control is sent, for 30 s.
fn boards_that_respond_at_once(second: DeviceSpec) -> Inspection {
    let mut scenario = Scenario::new(500_000);
    scenario.devices.push(board(0x11, "2.0", 1_000));
    scenario.devices.push(second.label("second"));
    let mut bus = Inspection::new(&scenario, 1, Config::default());
    bus.run_until(at(30), |_| false);
    assert!(is_confirmed(&bus));
    assert_eq!(row(&bus).name, Some(Name::new(b"BOILER")));
    bus
}

#[test]
fn boards_that_respond_at_once_are_not_released_together() {
    // Of another length, and of the same.
    for version in ["2.10", "2.5"] {
        let bus = boards_that_respond_at_once(board(0x22, version, 1_400));
        assert_eq!(row(&bus).services, None);
        assert_eq!(row(&bus).services_query.fault, Some(QueryFault::TwoResponses));
        assert_eq!(errors(&bus), 0, "{version}");
    }
}

#[test]
fn colliding_service_lists_are_not_requested() {
    let mut bus = two_boards(board(0x22, "2.5", 1_000));
    bus.run_until(at(30), |_| false);
    bus.engine.rescan(at(30));
    bus.run_until(at(40), |_| false);
    assert!(is_confirmed(&bus));
    assert!(row(&bus).other_services.is_empty());
    assert_eq!(errors(&bus), 0);
}

#[test]
fn interleaved_service_lists_are_both_read() {
    let mut engine = Engine::new(Instant::ZERO, Config { listen_only: true, ..Config::default() });
    let mut now = Instant::ZERO;
    let mut receive = |id: u32, data: &[u8], micros: u64| {
        now += Duration::from_micros(micros);
        engine.handle_frame(&Frame::classic(id, data).with_time(now));
        engine.handle_timeout(now);
    };
    let node = Address::new(ADDRESS).unwrap();
    let des = Profile::default().des_service();
    let request = Header::request(Address::DEBUG, node, false, des);
    let response = request.response(node, false).encode();
    let lists: Vec<Vec<u8>> = ["2.0", "2.5", "3.12"]
        .map(|version| des::encode_services(&[["HEATER", version], ["PUMP", "3.1"]]).collect())
        .to_vec();
    for second in [&lists[1], &lists[2]] {
        for _ in 0..6 {
            receive(request.encode(), b"\x04DES\x02", 300_000);
            let [one, mut other] = [&lists[0], second].map(|list| segments(list).into_iter());
            // The slower board sends each of its frames after one of the other board.
            for first in one {
                receive(response, &first, 400);
                other.next().into_iter().for_each(|frame| receive(response, &frame, 300));
            }
            other.for_each(|frame| receive(response, &frame, 300));
        }
    }
    let device = engine.device_at(node).unwrap();
    let mut all = vec![versions(device.services.as_ref().unwrap())];
    all.extend(device.other_services.iter().map(|list| versions(list)));
    let heaters: Vec<&str> = all.iter().map(|list| list[0].as_str()).collect();
    assert_eq!(heaters, ["HEATER 2.0", "HEATER 2.5", "HEATER 3.12"]);
    assert!(all.iter().all(|list| list[1] == "PUMP 3.1"), "{all:?}");
}

/// The frames of a multi-frame response.
fn segments(message: &[u8]) -> Vec<Vec<u8>> {
    let (first, rest) = message.split_at(6);
    let begin = [0x10, message.len() as u8];
    let mut frames = vec![[&begin, first].concat()];
    for (at, part) in rest.chunks(7).enumerate() {
        frames.push([&[0x21 + at as u8], part].concat());
    }
    frames
}
