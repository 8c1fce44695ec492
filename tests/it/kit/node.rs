//! What only the node in Rust has: its configuration, its frames, settings that are stored later.

use descan::frame::{CanId, Frame};
use descan::node::{Node, NodeAction, NodeConfig, NodeDevice, NodeFrame, NodeSettings, Slot};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::Profile;
use embedded_can::Frame as _;
use socketcan::{CanDataFrame, CanFrame, ExtendedId, StandardId};

const OWN: Address = Address::from_bits(12);
const NAME: &[u8] = &[4, b'D', b'E', b'S', 1];
const PUMP: NodeDevice = NodeDevice::named("PUMP");
const WRITABLE: NodeConfig =
    NodeConfig { write_uid: Some(Service::from_bits(0x011)), ..NodeConfig::DEFAULT };

fn settings() -> NodeSettings {
    let address = AddressSetting::Fixed(OWN);
    NodeSettings { uid: Uid(*b"BOARD1"), address, autostart: true, ..NodeSettings::BLANK }
}

fn request(from: u8, service: u16, data: &[u8]) -> NodeFrame {
    let service = Service::from_bits(service);
    let header = Header::request(Address::from_bits(from), OWN, false, service);
    NodeFrame::classic(header.encode(), data).unwrap()
}

/// Returns the response that a node sends next.
fn response<const N: usize>(node: &mut Node<'_, N>, now: Instant) -> Option<NodeFrame> {
    node.handle_timeout(now);
    let frame = node.poll_transmit(Slot::Response)?;
    node.handle_transmitted(now, Slot::Response, true);
    Some(frame)
}

/// Lets a node take its address, for which it stores nothing; returns the time.
pub(super) fn start<const N: usize>(node: &mut Node<'_, N>) -> Instant {
    let mut now = Instant::ZERO;
    while node.mode() != Mode::Work {
        node.handle_timeout(now);
        while let Some(action) = node.poll_action() {
            assert!(!matches!(action, NodeAction::Store(_)));
        }
        if node.poll_transmit(Slot::Heartbeat).is_some() {
            node.handle_transmitted(now, Slot::Heartbeat, true);
        }
        now += Duration::from_millis(1);
        assert!(now < Instant::ZERO + Duration::from_secs(10), "{:?}", node.mode());
    }
    now
}

#[test]
fn node_numbers_are_those_of_the_profile() {
    assert_eq!(NodeConfig::from_profile(&Profile::default()), NodeConfig::DEFAULT);
    let text = "[services]\ndes = 0x123\n[commands]\nmode = 0x019\n[writes]\naddress = 0x016\n";
    let profile = Profile::parse(text).unwrap();
    let config = NodeConfig::from_profile(&profile);
    let expected = NodeConfig {
        des: Service::from_bits(0x123),
        mode: Some(Service::from_bits(0x019)),
        write_address: Some(Service::from_bits(0x016)),
        ..NodeConfig::DEFAULT
    };
    assert_eq!(config, expected, "what no file sets is not served");
}

#[test]
fn node_frames_are_checked() {
    assert!(NodeFrame::classic(0x1FFF_FFFF, &[0; 8]).is_some());
    assert!(NodeFrame::classic(0x2000_0000, &[]).is_none());
    assert!(NodeFrame::classic(1, &[0; 9]).is_none());
    assert!(NodeFrame::fd(1, &[0; 12]).is_some() && NodeFrame::fd(1, &[0; 64]).is_some());
    assert!(NodeFrame::fd(1, &[0; 9]).is_none() && NodeFrame::fd(1, &[0; 65]).is_none());
    for frame in [NodeFrame::classic(7, NAME).unwrap(), NodeFrame::fd(7, &[3; 20]).unwrap()] {
        assert_eq!(NodeFrame::try_from(&Frame::from(&frame)), Ok(frame));
    }
    let standard = Frame::new(CanId::Standard(7), NAME);
    assert_eq!(NodeFrame::try_from(&standard), Err(&standard));
    assert!(NodeFrame::try_from(&Frame::remote(CanId::Extended(7), 2)).is_err());
}

#[test]
fn embedded_can_frames_are_converted_both_ways() {
    let id = ExtendedId::new(0x0201_5402).unwrap();
    let driver_frame = CanDataFrame::new(id, NAME).unwrap();
    let frame = NodeFrame::from_can(&driver_frame).unwrap();
    assert_eq!((frame.id(), frame.data()), (0x0201_5402, NAME));
    let back: CanFrame = frame.to_can().unwrap();
    assert_eq!((back.id(), back.data()), (driver_frame.id(), NAME));
    let standard = CanDataFrame::new(StandardId::new(7).unwrap(), NAME).unwrap();
    assert_eq!(NodeFrame::from_can(&standard), None);
    assert_eq!(NodeFrame::from_can(&CanFrame::new_remote(id, 2).unwrap()), None);
    assert_eq!(NodeFrame::fd(7, &[0; 12]).unwrap().to_can::<CanFrame>(), None);
    let generic = <NodeFrame as embedded_can::Frame>::new(id, NAME).unwrap();
    assert!(generic == frame && generic.is_extended() && generic.is_data_frame());
    assert_eq!((generic.dlc(), embedded_can::Frame::id(&generic)), (5, driver_frame.id()));
}

#[test]
fn write_is_answered_after_it_is_stored() {
    let mut node: Node = Node::new(&WRITABLE, &PUMP, settings(), 1);
    let now = start(&mut node);
    node.handle_frame(now, &request(0, 0x011, b"OTHER!"));
    let written = NodeSettings { uid: Uid(*b"OTHER!"), ..settings() };
    assert_eq!(node.poll_action(), Some(NodeAction::Store(written)));
    assert_eq!(node.poll_action(), None, "once");
    assert_eq!(response(&mut node, now), None, "not stored yet");
    node.handle_frame(now, &request(5, 0x011, b"THIRD!"));
    assert_eq!(node.dropped(), 1, "room for one");
    node.handle_frame(now, &request(0, 2, NAME));
    assert_eq!(response(&mut node, now).unwrap().data()[1], 1, "the name meanwhile");
    assert_eq!(node.settings(), &settings());
    node.handle_stored(true);
    let answer = response(&mut node, now).unwrap().header();
    assert!(answer.no_error && answer.service.number() == 0x011);
    assert_eq!(node.settings(), &written);
    node.handle_frame(now, &request(0, 0x011, b"FOURTH"));
    node.poll_action();
    node.handle_stored(false);
    assert!(!response(&mut node, now).unwrap().header().no_error);
    assert_eq!(node.settings(), &written);
}

#[test]
fn requesters_beyond_the_parameter_are_dropped() {
    let mut node = Node::<1>::new(&NodeConfig::DEFAULT, &PUMP, settings(), 1);
    let now = start(&mut node);
    node.handle_frame(now, &request(0, 2, NAME));
    node.handle_frame(now, &request(5, 2, NAME));
    assert_eq!(node.dropped(), 1);
    assert_eq!(response(&mut node, now).unwrap().header().destination, Address::DEBUG);
    node.handle_frame(now, &request(5, 2, NAME));
    assert_eq!(response(&mut node, now).unwrap().header().destination.number(), 5);
}

#[test]
fn too_long_name_is_refused() {
    let name = "x".repeat(4094);
    let device = NodeDevice::named(&name);
    assert!(PUMP.has_valid_texts() && !device.has_valid_texts());
    let mut node: Node = Node::new(&NodeConfig::DEFAULT, &device, settings(), 1);
    let now = start(&mut node);
    node.handle_frame(now, &request(0, 2, NAME));
    let answer = response(&mut node, now).unwrap();
    assert!(!answer.header().no_error && answer.data().is_empty());
}

#[test]
fn raw_requests_are_ignored_without_raw_framing() {
    let config = NodeConfig { has_raw_framing: false, ..NodeConfig::DEFAULT };
    let mut node: Node = Node::new(&config, &PUMP, settings(), 1);
    let now = start(&mut node);
    node.handle_frame(now, &request(0, 2, b"DES\x01"));
    assert_eq!(response(&mut node, now), None);
    node.handle_frame(now, &request(0, 2, NAME));
    assert!(response(&mut node, now).is_some());
}

#[test]
fn application_headers_are_those_of_the_node() {
    let mut node: Node = Node::new(&NodeConfig::DEFAULT, &PUMP, settings(), 1);
    let service = Service::from_bits(0x155);
    assert_eq!(node.request_header(Address::DEBUG, service), None, "it does not work yet");
    start(&mut node);
    let request = Header::request(Address::DEBUG, OWN, false, service);
    assert_eq!(node.response_header(request, true), request.response(OWN, false));
    assert!(!node.response_header(request, false).no_error);
    let (one, two) = (node.unsolicited_header(service), node.unsolicited_header(service));
    assert!(one.is_conforming() && one.broadcast && one.source == OWN);
    assert_ne!(one.destination, two.destination, "RND7");
    let sent = node.request_header(Address::from_bits(7), service);
    assert_eq!(sent, Some(Header::request(OWN, Address::from_bits(7), false, service)));
}
