//! Discovery of 127 devices with five services each, from the first request to the last service
//! known: its duration compared with the bus time of all frames in it, and the delay of the devices'
//! heartbeats compared with the same bus without descan.
//!
//! The result is bus time, independent of this machine: the same on every run.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/inspection.rs"]
mod inspection;

use descan::discovery::Config;
use descan::frame::Frame;
use descan::sim::Scenario;
use descan::time::{Duration, Instant};
use descan::wire::id::{Address, Header};
use inspection::Inspection;

/// Number of devices that send the other traffic.
const CHATTERING: usize = 16;
/// Bits of a frame with eight bytes, with the usual stuff bits.
const FRAME_BITS: f64 = 140.0;

fn main() {
    println!("discovery of 127 devices with 5 services (60-byte answers), auto framing");
    println!(
        "{:>10} {:>6} {:>10} {:>10} {:>7} {:>16}",
        "bit rate", "other", "took", "all frames", "ratio", "heartbeat later"
    );
    for bitrate in [125_000, 1_000_000] {
        for other in [0.0, 0.4, 0.7] {
            for seed in 1..=3 {
                measure(bitrate, other, seed);
            }
        }
    }
}

/// Returns five services whose response has 60 bytes.
fn crowd(bitrate: u32, other: f64) -> Scenario {
    let mut scenario = Scenario::with_many_devices(bitrate, 127, 0);
    for device in &mut scenario.devices {
        let services = [
            ("DES", "1.0"),
            ("HEAT", "1.0.4"),
            ("AUGER", "2.1.0"),
            ("SENS", "1.2.9"),
            ("RELAY", "3.0.1"),
        ];
        device.services = services
            .map(|(name, version)| vec![name.as_bytes().to_vec(), version.as_bytes().to_vec()])
            .to_vec();
        assert_eq!(descan::wire::des::encode_services(&device.services).count(), 60);
    }
    if other > 0.0 {
        let frames = other * f64::from(bitrate) / FRAME_BITS;
        let period = Duration::from_secs_f64(CHATTERING as f64 / frames);
        for device in scenario.devices.iter_mut().step_by(127 / CHATTERING).take(CHATTERING) {
            *device = device.clone().periodic_message(32, period, 8);
        }
    }
    scenario
}

/// Returns the times of each device's heartbeats.
fn heartbeats(inspection: &Inspection) -> Vec<Vec<Instant>> {
    let service = inspection.engine.config().profile.heartbeat_service();
    let mut times = vec![Vec::new(); Address::COUNT];
    for frame in inspection.frames.iter().filter(|frame| !frame.is_tx) {
        let header = header(frame);
        if header.service == service && header.response {
            times[header.source.index()].push(frame.time);
        }
    }
    times
}

fn header(frame: &Frame) -> Header {
    Header::decode(frame.platform_id().expect("no errors here"))
}

fn measure(bitrate: u32, other: f64, seed: u64) {
    let scenario = crowd(bitrate, other);
    let mut inspection = Inspection::new(&scenario, seed, Config::default());
    let until = Instant::from_micros(60_000_000);
    let done = inspection.run_until(until, |engine| engine.progress().with_services == 127);
    assert!(done, "not all found: {:?}", inspection.engine.progress());
    let end = inspection.sim.now();
    let listening = Config { listen_only: true, ..Config::default() };
    let mut alone = Inspection::new(&scenario, seed, listening);
    alone.run_until(end, |_| false);

    let ours = inspection.frames.iter().filter(|frame| frame.is_tx);
    let first = *ours.clone().next().expect("a request");
    let began = first.time - inspection.sim.frame_duration(&first);
    let took = end.since(began);
    let during = inspection.frames.iter().filter(|frame| frame.time >= first.time);
    // In auto framing, broadcasts are sent raw as well: not needed here.
    let needed = during.clone().filter(|frame| !frame.data().starts_with(b"DES"));
    let time: Duration = needed.map(|frame| inspection.sim.frame_duration(frame)).sum();
    let own: Duration = ours.map(|frame| inspection.sim.frame_duration(frame)).sum();
    let profile = inspection.engine.config().profile.clone();
    let des = during.filter(|frame| {
        header(frame).service == profile.des_service() && !frame.data().starts_with(b"DES")
    });
    // Two broadcasts, 127 names, and per device request, first frame, flow control and eight
    // consecutive frames: any repeated request or frame would exceed this.
    let extra = i128::try_from(des.count()).unwrap() - (2 + 127 + 127 * 11);
    let limit = time.max(own.mul_f64(1.0 / Config::default().startup_budget));
    let ratio = took.as_secs_f64() / limit.as_secs_f64();
    let pairs = heartbeats(&inspection).into_iter().zip(heartbeats(&alone));
    let delays = pairs.flat_map(|(with, without)| {
        with.into_iter().zip(without).map(|(with, without)| with.since(without))
    });
    let latest = delays.max().unwrap_or_default();
    println!(
        "{bitrate:>10} {:>4.0} % {:>8.1}ms {:>8.1}ms {ratio:>7.3} {:>14.1}ms  {extra} frames more than needed",
        other * 100.0,
        took.as_secs_f64() * 1e3,
        limit.as_secs_f64() * 1e3,
        latest.as_secs_f64() * 1e3,
    );
}
