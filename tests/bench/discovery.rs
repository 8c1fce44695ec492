//! Discovery time compared with the bus limit: 127 devices with five services each, from the first
//! request to the last service known, against the bus time of the frames needed at least.
//!
//! The result is bus time, independent of this machine: the same on every run.

#[allow(dead_code, reason = "a part is used")]
#[path = "../it/common/inspection.rs"]
mod inspection;

use descan::discovery::Config;
use descan::sim::Scenario;
use descan::time::{Duration, Instant};
use descan::wire::id::Header;
use inspection::Inspection;

fn main() {
    println!("discovery of 127 devices with 5 services (60-byte answers), auto framing");
    println!(
        "{:>10} {:>10} {:>10} {:>10} {:>7}",
        "bit rate", "took", "needed", "heartbeats", "ratio"
    );
    for bitrate in [125_000, 250_000, 500_000, 1_000_000] {
        let ratios: Vec<f64> = (1..=5).map(|seed| measure(bitrate, seed)).collect();
        let worst = ratios.iter().copied().fold(0.0, f64::max);
        println!("{bitrate:>10} worst of 5 seeds: {worst:.3}");
    }
}

/// Returns five services whose response has 60 bytes.
fn crowd(bitrate: u32) -> Scenario {
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
    scenario
}

fn measure(bitrate: u32, seed: u64) -> f64 {
    let mut inspection = Inspection::new(&crowd(bitrate), seed, Config::default());
    let until = Instant::from_micros(60_000_000);
    let done = inspection.run_until(until, |engine| engine.progress().with_services == 127);
    assert!(done, "not all found: {:?}", inspection.engine.progress());
    let end = inspection.sim.now();
    let ours = inspection.frames.iter().filter(|frame| frame.is_tx);
    let first = *ours.clone().next().expect("a request");
    let began = first.time - inspection.sim.frame_duration(&first);
    let took = end.since(began);
    let (mut needed, mut heartbeats) = (Duration::ZERO, Duration::ZERO);
    let mut count = 0;
    let profile = inspection.engine.config().profile.clone();
    for frame in inspection.frames.iter().filter(|frame| frame.time >= first.time) {
        let header = Header::decode(frame.platform_id().expect("no errors here"));
        let duration = inspection.sim.frame_duration(frame);
        if header.service == profile.heartbeat_service() {
            heartbeats += duration;
            continue;
        }
        // In auto framing, broadcasts are sent raw as well: not needed here.
        let raw = frame.data().starts_with(b"DES");
        if raw {
            continue;
        }
        needed += duration;
        count += 1;
    }
    if std::env::var_os("TRACE").is_some() {
        for frame in inspection.frames.iter().filter(|f| f.time >= first.time) {
            eprintln!("{frame:?}");
        }
    }
    // Two broadcasts, 127 names, and per device request, first frame, flow control and eight
    // consecutive frames: any repeated request or frame would exceed this.
    assert_eq!(count, 2 + 127 + 127 * 11, "nothing lost, nothing asked twice");
    let ratio = took.as_secs_f64() / (needed + heartbeats).as_secs_f64();
    println!(
        "{bitrate:>10} {:>9.1}ms {:>9.1}ms {:>9.1}ms {ratio:>7.3}",
        took.as_secs_f64() * 1e3,
        needed.as_secs_f64() * 1e3,
        heartbeats.as_secs_f64() * 1e3,
    );
    ratio
}
