//! Devices that are switched off just before or during a request that may stop a device.

use super::bench::{Filter, NoFilter, ProofBench, broken, given_profile, verdict};
use descan::frame::Frame;
use descan::prove::{Conformance, ConformanceRule as Rule, RuleVerdict};
use descan::sim::{DeviceAction, DeviceSpec, Scenario};
use descan::time::{Duration, Instant};

/// A request that may stop a device: the rule, and the data of its first frame.
const REQUESTS: [(Rule, &[u8]); 3] = [
    (Rule::SurvivesMalformed, b"D"),
    (Rule::SurvivesMalformed, b"\x04DEX\x01"),
    (Rule::SurvivesEndless, b"\x1F\xFFDES\x01AA"),
];

/// Moments of the power switch, in ms after that frame; the endless request takes about 20 ms.
const MOMENTS: [i64; 7] = [-190, -100, -20, 5, 15, 40, 70];

fn scenario() -> Scenario {
    let feed = DeviceSpec::new("FEED").fixed(12).skips_address_resolution();
    let psu = DeviceSpec::new("PSU").fixed(40).skips_address_resolution();
    Scenario::new(125_000).with(feed.service("AUGER", "1.0")).with(psu)
}

fn run(scenario: &Scenario) -> (Vec<RuleVerdict>, ProofBench) {
    let mut bench = ProofBench::new(scenario, 12, given_profile(), Box::new(NoFilter));
    (bench.run(), bench)
}

/// When descan sends the frame.
fn time_of(data: &[u8]) -> Instant {
    let (_, bench) = run(&scenario());
    let is_it = |it: &&Frame| it.is_tx && it.data() == data;
    bench.seen.iter().find(is_it).expect("it is sent").time
}

/// The verdict on the rule, of a device that is switched off, and on again after a time.
fn switched(moment: i64, on_after: Option<Duration>, rule: Rule, data: &[u8]) -> RuleVerdict {
    let off = time_of(data).as_micros().saturating_add_signed(moment * 1000);
    let off = Duration::from_micros(off);
    let mut scenario = scenario().at(off, "FEED", DeviceAction::PowerOff);
    if let Some(time) = on_after {
        scenario = scenario.at(off + time, "FEED", DeviceAction::PowerOn);
    }
    let (verdicts, _) = run(&scenario);
    let named = broken(&verdicts);
    assert!(named.is_empty(), "{data:02X?}, off {moment} ms after, on {on_after:?}: {named:?}");
    verdict(&verdicts, rule).clone()
}

#[test]
fn device_switched_off_at_a_request_is_not_accused() {
    for (rule, data) in REQUESTS {
        for moment in MOMENTS {
            let verdict = switched(moment, None, rule, data);
            assert_eq!(verdict.conformance, Conformance::NotSeen, "{moment}: {verdict:?}");
        }
    }
}

#[test]
fn device_switched_on_again_is_asked_once_more() {
    for (rule, data) in REQUESTS {
        for milliseconds in [1500, 5000, 9000, 14_000] {
            let time = Duration::from_millis(milliseconds);
            let verdict = switched(-20, Some(time), rule, data);
            assert_eq!(verdict.conformance, Conformance::Kept, "{milliseconds}: {verdict:?}");
        }
    }
}

/// A device that sends and takes nothing for a time after a request.
struct Crash {
    request: &'static [u8],
    time: Duration,
    until: Instant,
}

impl Filter for Crash {
    fn transmitted(&mut self, now: Instant, frame: Frame) -> Vec<Frame> {
        if now < self.until {
            return Vec::new();
        }
        if frame.data() == self.request {
            self.until = now + self.time;
        }
        vec![frame]
    }

    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        if frame.time < self.until { Vec::new() } else { vec![frame] }
    }
}

/// What is said of a device that crashes at a request, each time.
fn crashed(rule: Rule, request: &'static [u8], seconds: u64) -> RuleVerdict {
    let time = Duration::from_secs(seconds);
    let filter = Box::new(Crash { request, time, until: Instant::ZERO });
    let verdicts = ProofBench::new(&scenario(), 12, given_profile(), filter).run();
    assert!(broken(&verdicts).iter().all(|(named, _)| *named == rule), "{:?}", broken(&verdicts));
    verdict(&verdicts, rule).clone()
}

#[test]
fn crash_until_a_restart_is_named() {
    for (rule, data) in REQUESTS {
        for seconds in [4, 12, 25] {
            let verdict = crashed(rule, data, seconds);
            assert_eq!(verdict.conformance, Conformance::Broken, "{seconds}: {verdict:?}");
            assert!(verdict.frames.iter().any(|frame| frame.is_tx), "no frames prove it");
        }
    }
}

#[test]
fn crash_for_good_looks_like_the_power_switch() {
    for (rule, data) in REQUESTS {
        let verdict = crashed(rule, data, 3600);
        assert_eq!(verdict.conformance, Conformance::NotSeen, "{verdict:?}");
        assert!(verdict.text.starts_with("not heard again after "), "{verdict:?}");
    }
}
