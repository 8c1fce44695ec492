//! Processing a frame allocates nothing once the devices and identifiers on the bus are known; the
//! node for firmware allocates nothing at all.
#![allow(unsafe_code)] // A counting allocator cannot be written without.

use descan::app::{App, AppOptions};
use descan::discovery::Config;
use descan::frame::Frame;
use descan::node::{Node, NodeAction, NodeConfig, NodeDevice, NodeFrame, NodeSettings, Slot};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::{Heartbeat, Mode, Uid};
use descan::wire::profile::Profile;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: forwards every call to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller upholds the same contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the same contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns one second of traffic: heartbeats and data of twenty devices, 2,000 frames in all.
fn second(number: u64) -> Vec<Frame> {
    let profile = Profile::default();
    let codes = profile.modes.codes();
    let start = number * 1_000_000;
    let mut frames = Vec::new();
    for at in 0..2000u64 {
        let device = (at % 20) as u8;
        let from = Address::from_bits(10 + device);
        let is_beat = at < 20;
        let service = Service::from_bits(if is_beat { 1 } else { 0x100 + u16::from(device) });
        let rnd7 = (at * 31 + number * 7) as u8 & 0x7F;
        let header = Header::unsolicited(from, rnd7, false, service);
        let beat = Heartbeat {
            uid: Some(Uid([1, 2, 3, 4, 5, device])),
            mode: Some(Mode::Work),
            error: Some(0),
        };
        let data = beat.encode(&profile.heartbeat, &codes).0;
        let time = Instant::from_micros(start + at * 500);
        frames.push(Frame::classic(header.encode(), &data).with_time(time));
    }
    frames
}

#[test]
fn steady_traffic_allocates_almost_nothing() {
    let config = Config { listen_only: true, ..Config::default() };
    let buses = vec![("can0".to_owned(), config)];
    let mut app = App::new(
        Instant::ZERO,
        AppOptions { buses, capture_room: Some(0), ..AppOptions::default() },
    );
    // Until the ring and the histories of all addresses are full and all statistics have settled.
    for number in 0..110 {
        let frames = second(number);
        let now = Instant::from_micros((number + 1) * 1_000_000);
        for part in frames.chunks(50) {
            app.handle_frames(part.last().unwrap().time, part);
            app.handle_timeout(part.last().unwrap().time);
        }
        app.handle_timeout(now);
        app.take_dirty();
    }
    let mut allocations = 0;
    for number in 110..115 {
        let frames = second(number);
        for part in frames.chunks(50) {
            app.advance_to(part.last().unwrap().time);
            let before = ALLOCATIONS.get();
            app.handle_frames(part.last().unwrap().time, part);
            allocations += ALLOCATIONS.get() - before;
        }
        app.handle_timeout(Instant::from_micros((number + 1) * 1_000_000));
    }
    assert_eq!(allocations, 0, "allocations in 10,000 frames");
}

/// Passes a frame to a node, lets a second pass, and returns how many frames it sent.
fn node_second(node: &mut Node, now: &mut Instant, frame: Option<&NodeFrame>) -> usize {
    let mut count = 0;
    if let Some(frame) = frame {
        node.handle_frame(*now, frame);
    }
    for _ in 0..100 {
        node.handle_timeout(*now);
        while let Some(action) = node.poll_action() {
            if let NodeAction::Store(_) = action {
                node.handle_stored(true);
            }
        }
        for slot in Slot::ALL {
            if node.poll_transmit(slot).is_some() {
                count += 1;
                node.handle_transmitted(*now, slot, true);
            }
        }
        *now += Duration::from_millis(10);
    }
    count
}

#[test]
fn firmware_node_allocates_nothing() {
    const SERVICES: &[&[&str]] = &[&["DES", "1.0"], &["FLOW", "2.1"], &["PRESSURE", "0.3"]];
    let device = NodeDevice { services: SERVICES, ..NodeDevice::named("PUMP") };
    let write = Some(Service::from_bits(0x011));
    let config = NodeConfig { write_uid: write, ..NodeConfig::DEFAULT };
    let settings = NodeSettings {
        uid: Uid([1; 6]),
        address: AddressSetting::Fixed(Address::from_bits(12)),
        autostart: true,
        ..NodeSettings::BLANK
    };
    let request = |service: u16, data: &[u8]| {
        let service = Service::from_bits(service);
        let header = Header::request(Address::DEBUG, Address::from_bits(12), false, service);
        NodeFrame::classic(header.encode(), data).unwrap()
    };
    let requests = [
        request(2, &[4, b'D', b'E', b'S', 1]),
        request(2, &[4, b'D', b'E', b'S', 2]),
        request(2, &[0x30, 2, 1]),
        request(2, &[0x30, 0, 0]),
        request(2, b"DES\x01"),
        request(0x012, &[]),
        request(0x011, &[7; 6]),
        request(0x155, &[1]),
    ];
    let before = ALLOCATIONS.get();
    let mut node = Node::new(&config, &device, settings, 7);
    let mut now = Instant::ZERO;
    let mut sent = 0;
    for _ in 0..5 {
        sent += node_second(&mut node, &mut now, None);
    }
    for request in &requests {
        sent += node_second(&mut node, &mut now, Some(request));
    }
    assert_eq!(ALLOCATIONS.get() - before, 0, "allocations");
    assert_eq!(node.settings().uid, Uid([7; 6]));
    assert!(sent > 15, "{sent} frames");
}

/// Prints the speed; checks no limit, since machines differ. Run with `--release --nocapture
/// --ignored`.
#[test]
#[ignore = "a measurement"]
fn engine_throughput_in_frames_per_second() {
    let config = Config { listen_only: true, ..Config::default() };
    let buses = vec![("can0".to_owned(), config)];
    let mut app = App::new(
        Instant::ZERO,
        AppOptions { buses, capture_room: Some(0), ..AppOptions::default() },
    );
    let seconds: Vec<Vec<Frame>> = (0..500).map(second).collect();
    let start = std::time::Instant::now();
    for (number, frames) in seconds.iter().enumerate() {
        for part in frames.chunks(50) {
            app.handle_frames(part.last().unwrap().time, part);
        }
        app.handle_timeout(Instant::ZERO + Duration::from_secs(number as u64 + 1));
    }
    let took = start.elapsed();
    println!("{:.2} M frames/s", 1.0 / took.as_secs_f64());
}
