//! DES responses, byte by byte, in every framing and under flow control.

use super::{address, after, bus_with, des, from};
use descan::frame::Frame;
use descan::sim::{DeviceFraming, DeviceSpec, Fault, Sim, SimStation};
use descan::time::Duration;
use descan::wire::id::{Header, Service};
use descan::wire::node::{Mode, Uid};
use serde_json::Value;

const NAME: &[u8] = &[4, b'D', b'E', b'S', 1];
const SERVICES: &[u8] = &[4, b'D', b'E', b'S', 2];
const CONTINUE: &[u8] = &[0x30, 0, 0];

fn device() -> DeviceSpec {
    let mut device = DeviceSpec::new("FEED").fixed(12).skips_address_resolution();
    // Only responses on the bus.
    device = device.fault(Fault::NoHeartbeat);
    device
}

fn request(to: u8) -> u32 {
    Header::request(address(0), address(to), false, des()).encode()
}

fn send(sim: &mut Sim, me: SimStation, data: &[u8]) {
    assert!(sim.transmit(me, Frame::classic(request(12), data)));
}

/// Returns everything that 12 sends within `ms`.
fn answers(sim: &mut Sim, me: SimStation, ms: u64) -> Vec<(Header, Frame)> {
    let frames = after(sim, me, ms);
    from(&frames, 12)
}

fn data(answers: &[(Header, Frame)]) -> Vec<Vec<u8>> {
    answers.iter().map(|(_, frame)| frame.data().to_vec()).collect()
}

/// Sends a request, permits a long response, and returns the frames.
fn exchange(device: DeviceSpec, request: &[u8]) -> Vec<(Header, Frame)> {
    let (mut sim, me) = bus_with([device]);
    send(&mut sim, me, request);
    let mut all = answers(&mut sim, me, 20);
    if all.first().is_some_and(|(_, frame)| matches!(frame.data(), [0x10..=0x1F, ..])) {
        send(&mut sim, me, CONTINUE);
        all.extend(answers(&mut sim, me, 3000));
    }
    all
}

fn bytes(value: &Value) -> Vec<u8> {
    let text = value.as_str().unwrap();
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

fn list(value: &Value) -> Vec<Vec<u8>> {
    value.as_array().unwrap().iter().map(bytes).collect()
}

fn vectors(text: &str) -> Vec<Value> {
    serde_json::from_str(text).unwrap()
}

#[test]
fn name_responses_match_the_vectors() {
    for vector in vectors(include_str!("../../vectors/names.json")) {
        let mut named = device();
        named.name = bytes(&vector["name"]);
        assert_eq!(data(&exchange(named.clone(), NAME)), list(&vector["isotp"]), "{vector}");
        let raw = data(&exchange(named.framing(DeviceFraming::Raw), b"DES\x01"));
        let expected = vector["raw"].as_str().map_or(vec![], |_| bytes(&vector["raw"]));
        assert_eq!(raw, [expected], "what does not fit is refused: {vector}");
    }
}

#[test]
fn services_responses_match_the_vectors() {
    for vector in vectors(include_str!("../../vectors/services.json")) {
        if !vector["finding"].is_null() {
            continue;
        }
        for (key, fd) in [("isotp", false), ("isotp_fd", true)] {
            let mut offering = device();
            offering.fd = fd;
            offering.services = vector["services"].as_array().unwrap().iter().map(list).collect();
            if vector.get(key).is_some() {
                assert_eq!(data(&exchange(offering, SERVICES)), list(&vector[key]), "{key}");
            }
        }
    }
}

#[test]
fn response_identifier_addresses_the_requester() {
    let answer = exchange(device(), NAME)[0].0;
    assert_eq!(answer.message_type().name(), "RSP_CC_TGT");
    assert_eq!((answer.source, answer.destination), (address(12), address(0)));
    assert!(answer.no_error && answer.service == des());
    let answer = exchange(device().fault(Fault::RepeatsRequestDst), NAME)[0].0;
    assert_eq!(answer.destination, address(12));
}

#[test]
fn request_is_answered_in_supported_framings_only() {
    let count = |framing, request| exchange(device().framing(framing), request).len();
    assert_eq!(count(DeviceFraming::Isotp, b"DES\x01"), 0);
    assert_eq!(count(DeviceFraming::Raw, NAME), 0);
    assert_eq!(count(DeviceFraming::Both, b"DES\x01"), 1);
    assert_eq!(count(DeviceFraming::Both, NAME), 1);
    let refused = exchange(device().framing(DeviceFraming::Raw), b"DES\x02");
    assert!(!refused[0].0.no_error && refused[0].1.is_empty(), "ten bytes fit no frame");
}

#[test]
fn reserved_request_type_is_refused() {
    for request in [b"DES\x00", b"DES\x03"] {
        let refused = exchange(device().framing(DeviceFraming::Both), request);
        assert_eq!(refused.len(), 1, "CAN platform 4.3");
        assert!(!refused[0].0.no_error && refused[0].1.is_empty());
    }
}

#[test]
fn command_to_work_is_refused_without_uid() {
    let is_executed = |uid: [u8; 6]| {
        let mut waiting = device().uid(Uid(uid));
        waiting.mode = Some(Mode::Cfg);
        let (mut sim, me) = bus_with([waiting]);
        let command = Service::new(0x019).unwrap();
        let header = Header::request(address(0), address(12), true, command);
        sim.transmit(me, Frame::classic(header.encode(), &[4]));
        let frames = after(&mut sim, me, 20);
        let answer = from(&frames, 12).into_iter().find(|(header, _)| header.service == command);
        answer.unwrap().0.no_error
    };
    assert!(is_executed(*b"BOARD1"));
    assert!(!is_executed([0; 6]), "CAN platform 3.2.4.4");
}

#[test]
fn broadcast_reaches_devices_of_its_mode() {
    let mut idle = DeviceSpec::new("CFG").fixed(13).skips_address_resolution();
    idle.mode = Some(Mode::Cfg);
    let (mut sim, me) = bus_with([device(), idle]);
    for (to_not_working, answerer, request) in
        [(false, 12, NAME), (true, 13, NAME), (false, 12, SERVICES)]
    {
        let header = Header::broadcast(address(0), 99, to_not_working, des());
        sim.transmit(me, Frame::classic(header.encode(), request));
        let frames = after(&mut sim, me, 20);
        for number in [12, 13] {
            let answers = from(&frames, number).into_iter().filter(|(h, _)| h.service == des());
            let expected = usize::from(number == answerer);
            assert_eq!(answers.count(), expected, "D = {to_not_working}, {number}");
        }
    }
}

#[test]
fn responses_come_after_their_delay() {
    let mut slow = device();
    slow.response_delay = (Duration::from_millis(5), Duration::from_millis(6));
    let (mut sim, me) = bus_with([slow]);
    send(&mut sim, me, NAME);
    let frames = after(&mut sim, me, 50);
    let waited = frames[1].time.since(frames[0].time);
    assert!(waited > Duration::from_millis(5) && waited < Duration::from_millis(8), "{waited:?}");
}

fn long() -> DeviceSpec {
    // 2 + 6 × 10 bytes: a first frame and nine consecutive ones.
    (0..6).fold(device(), |device, at| device.service(&format!("SRV{at}"), "1.0"))
}

#[test]
fn block_size_and_separation_time_are_kept() {
    let (mut sim, me) = bus_with([long()]);
    send(&mut sim, me, SERVICES);
    assert_eq!(answers(&mut sim, me, 20).len(), 1, "waits for flow control");
    send(&mut sim, me, &[0x30, 2, 20]);
    let block = answers(&mut sim, me, 500);
    assert_eq!(block.len(), 2);
    let gap = block[1].1.time.since(block[0].1.time);
    assert!(gap >= Duration::from_millis(20) && gap < Duration::from_millis(23), "{gap:?}");
    send(&mut sim, me, &[0x31, 0, 0]);
    assert!(answers(&mut sim, me, 900).is_empty(), "told to wait");
    send(&mut sim, me, &[0x30, 0, 0xF5]);
    let rest = answers(&mut sim, me, 500);
    assert_eq!(rest.last().unwrap().1.data()[0], 0x20 | (2 + rest.len() as u8));
    let gaps = rest.windows(2).map(|pair| pair[1].1.time.since(pair[0].1.time));
    assert!(gaps.clone().all(|gap| gap >= Duration::from_micros(500)), "{gaps:?}");
}

#[test]
fn overflow_or_timeout_aborts_transfer() {
    let (mut sim, me) = bus_with([long()]);
    send(&mut sim, me, SERVICES);
    answers(&mut sim, me, 20);
    let stranger = Header::request(address(7), address(12), false, des());
    sim.transmit(me, Frame::classic(stranger.encode(), CONTINUE));
    assert!(answers(&mut sim, me, 100).is_empty());
    send(&mut sim, me, &[0x32, 0, 0]);
    send(&mut sim, me, CONTINUE);
    assert!(answers(&mut sim, me, 100).is_empty(), "given up after overflow");
    send(&mut sim, me, SERVICES);
    assert_eq!(answers(&mut sim, me, 1100).len(), 1);
    send(&mut sim, me, CONTINUE);
    assert!(answers(&mut sim, me, 100).is_empty(), "given up after N_Bs");
    send(&mut sim, me, NAME);
    assert_eq!(answers(&mut sim, me, 100).len(), 1, "and alive");
}

#[test]
fn broadcast_flow_control_continues_transfer() {
    let (mut sim, me) = bus_with([long()]);
    send(&mut sim, me, SERVICES);
    answers(&mut sim, me, 20);
    let broadcast = Header::broadcast(address(0), 99, false, des());
    sim.transmit(me, Frame::classic(broadcast.encode(), CONTINUE));
    assert!(answers(&mut sim, me, 100).len() > 5);
}

#[test]
fn two_requests_are_answered_in_turn() {
    let (mut sim, me) = bus_with([long()]);
    send(&mut sim, me, SERVICES);
    send(&mut sim, me, NAME);
    assert_eq!(answers(&mut sim, me, 50).len(), 1, "the name waits behind the transfer");
    send(&mut sim, me, CONTINUE);
    let rest = data(&answers(&mut sim, me, 200));
    assert_eq!(rest.last().unwrap(), &[6, 1, b'F', b'E', b'E', b'D', 0]);
}

#[test]
fn configured_faults_are_applied() {
    let served = |fault| data(&exchange(long().fault(fault), SERVICES));
    let sound = data(&exchange(long(), SERVICES));
    assert!(served(Fault::NoDes).is_empty());
    assert!(served(Fault::NoServices).is_empty());
    assert_eq!(exchange(long().fault(Fault::NoServices), NAME).len(), 1);
    let dropped = served(Fault::DropFrame);
    assert_eq!(dropped.len(), sound.len() - 1);
    assert_eq!(dropped[1][0], 0x22);
    assert_eq!(served(Fault::WrongSequence)[1][0], 0x29);
    assert!(served(Fault::Endless).len() > 1000);
    assert_eq!(served(Fault::HugeLength), [[0x10, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0]]);
    let truncated = served(Fault::TruncatedServices);
    assert_eq!(truncated[0][1], sound[0][1] - 3);
    assert_eq!(exchange(device().fault(Fault::RespondsTwice), NAME).len(), 2);
}
