mod common;
use descan::discovery::*;
use descan::sim::Scenario;
use descan::time::Instant;
#[test]
fn story() {
    for (name, secs) in [("boiler", 260u64), ("drone", 200)] {
        let scenario = Scenario::builtin(name).unwrap();
        let mut it = common::Inspection::new(&scenario, scenario.seed, Config::default());
        it.run_until(Instant::from_micros(secs * 1_000_000), |_| false);
        println!("=== {name}");
        for e in &it.events {
            println!("{} {:?} {:?} {:?}", e.time, e.address, e.name, e.kind);
        }
        for d in it.engine.devices() {
            println!(
                "{} {:?} {} {:?} {:?} uid {:?} p {:?} j {:?} missed {} q {:?} reb {}",
                d.address,
                d.name,
                d.presence,
                d.mode,
                d.services.as_ref().map(Vec::len),
                d.uid,
                d.heartbeat.period(),
                d.heartbeat.jitter(),
                d.heartbeat.missed,
                d.quirks,
                d.reboots
            );
        }
        for f in it.engine.findings() {
            println!("{:?} {} {} {}", f.key.address, f.key.kind, f.confidence, f.text);
        }
        println!("{:?}", it.engine.counters());
    }
}
#[test]
fn trace() {
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut it = common::Inspection::new(&scenario, scenario.seed, Config::default());
    it.run_until(Instant::from_micros(45_000_000), |_| false);
    for f in it.frames.iter().filter(|f| f.time > Instant::from_micros(27_000_000)) {
        let s = format!("{f:?}");
        if s.contains("00003802#")
            || s.contains("051C")
            || s.contains("071C") && s.contains("01#")
            || s.contains("171C")
        {
            println!("{s}");
        }
    }
}
