//! Devices that keep all rules.

use super::bench::{Extra, Filter, NoFilter, ProofBench, broken, given_profile, verdict};
use descan::frame::Frame;
use descan::prove::{Conformance, ConformanceRule, RuleNeed};
use descan::sim::{DeviceAction, DeviceFraming, DeviceSpec, Scenario};
use descan::time::Duration;
use descan::wire::descriptor::AddressSetting;
use descan::wire::framing::Framing;
use descan::wire::id::{Address, Header};
use descan::wire::node::{Mode, Uid};

/// Devices of a run of the suite.
const DEVICES: u64 = 300;
/// Devices of the long run.
const MANY_DEVICES: u64 = 10_000;

fn feed() -> DeviceSpec {
    DeviceSpec::new("FEED").fixed(12).skips_address_resolution()
}

/// A working device with a list of several frames, alone on the bus.
fn scenario(device: DeviceSpec) -> Scenario {
    let services = ["AUGER", "MOTOR", "LOG", "TIME"];
    let device = services.iter().fold(device, |it, name| it.service(name, "1.0"));
    Scenario::new(125_000).with(device)
}

#[test]
fn good_device_keeps_every_rule_that_can_be_seen() {
    let mut bench = ProofBench::new(&scenario(feed()), 12, given_profile(), Box::new(NoFilter));
    let verdicts = bench.run();
    assert!(broken(&verdicts).is_empty(), "{:?}", broken(&verdicts));
    let unseen = verdicts.iter().filter(|it| {
        let is_usual = matches!(it.rule.need(), RuleNeed::Observation | RuleNeed::Requests);
        is_usual && it.conformance == Conformance::NotSeen
    });
    let unseen: Vec<&str> = unseen.map(|it| it.rule.id()).collect();
    assert_eq!(unseen, ["no-requests-unless-working"], "{verdicts:#?}");
    assert_eq!(bench.prover.framing(), Some(Framing::Isotp));
    assert_eq!(bench.prover.name(), Some(&b"FEED"[..]));
}

#[test]
fn device_that_leaves_is_not_accused() {
    for tenths in [62, 81, 100, 120, 150, 170, 191] {
        let psu = DeviceSpec::new("PSU").fixed(40).skips_address_resolution();
        let gone = Duration::from_millis(tenths * 100);
        let scenario = scenario(feed()).with(psu).at(gone, "FEED", DeviceAction::PowerOff);
        let mut bench = ProofBench::new(&scenario, 12, given_profile(), Box::new(NoFilter));
        let verdicts = bench.run();
        assert!(broken(&verdicts).is_empty(), "{tenths}: {:?}", broken(&verdicts));
    }
}

/// Gives refusals an error code.
struct ErrorCode(&'static [u8]);

impl Filter for ErrorCode {
    fn received(&mut self, mut frame: Frame) -> Vec<Frame> {
        let header = frame.platform_id().map(Header::decode);
        let is_refusal = header.is_some_and(|it| it.response && !it.no_error);
        if is_refusal && !frame.is_tx {
            let id = header.unwrap().encode();
            frame = Frame::classic(id, self.0).with_time(frame.time).with_bus(frame.bus);
        }
        vec![frame]
    }
}

#[test]
fn refusal_may_have_any_error_code() {
    for code in [&[1][..], &[2], &[0], &[9, 1], &[2, 1, 0]] {
        let mut bench =
            ProofBench::new(&scenario(feed()), 12, given_profile(), Box::new(ErrorCode(code)));
        let verdicts = bench.run();
        assert!(broken(&verdicts).is_empty(), "{code:?}: {:?}", broken(&verdicts));
        let refused = verdict(&verdicts, ConformanceRule::ReservedRefused);
        assert_eq!(refused.conformance, Conformance::Kept, "{code:?}: {refused:?}");
    }
}

#[test]
fn disrupted_good_device_keeps_every_rule() {
    for mode in [Mode::Work, Mode::Cfg] {
        let mut device = feed();
        device.mode = Some(mode);
        let psu = DeviceSpec::new("PSU").fixed(40).skips_address_resolution();
        let scenario = scenario(device).with(psu);
        let mut bench =
            ProofBench::with(&scenario, 12, given_profile(), Box::new(NoFilter), Extra::Disruption);
        let verdicts = bench.run();
        assert!(broken(&verdicts).is_empty(), "{:?}", broken(&verdicts));
        let needs_more = |need| matches!(need, RuleNeed::Load | RuleNeed::Reboot);
        let unseen = verdicts
            .iter()
            .filter(|it| it.conformance == Conformance::NotSeen && !needs_more(it.rule.need()));
        let unseen: Vec<(&str, &str)> = unseen.map(|it| (it.rule.id(), &*it.text)).collect();
        assert!(
            unseen
                .iter()
                .all(|(id, _)| ["no-requests-unless-working", "uid-set-in-work"].contains(id)),
            "{mode}: {unseen:?}"
        );
    }
}

#[test]
fn good_device_keeps_the_rules_on_a_loaded_bus() {
    for bitrate in [125_000, 500_000] {
        let mut scenario = scenario(feed());
        scenario.bitrate = bitrate;
        let filter = Box::new(NoFilter);
        let mut bench = ProofBench::with(&scenario, 12, given_profile(), filter, Extra::Load);
        let verdicts = bench.run();
        assert!(broken(&verdicts).is_empty(), "{:?}", broken(&verdicts));
        for rule in [ConformanceRule::AnswersUnderLoad, ConformanceRule::HeartbeatUnderLoad] {
            let verdict = verdict(&verdicts, rule);
            assert_eq!(verdict.conformance, Conformance::Kept, "{verdict:?}");
        }
    }
}

/// The verdict on a device that is switched off, and on again as another one.
fn rebooted(services: Option<Vec<Vec<Vec<u8>>>>) -> (Conformance, String) {
    let at = Duration::from_mins(1);
    let services = services.unwrap_or_else(|| scenario(feed()).devices[0].services.clone());
    let scenario = scenario(feed())
        .at(at, "FEED", DeviceAction::PowerOff)
        .at(at + Duration::from_secs(5), "FEED", DeviceAction::Services(services))
        .at(at + Duration::from_secs(6), "FEED", DeviceAction::PowerOn);
    let filter = Box::new(NoFilter);
    let mut bench = ProofBench::with(&scenario, 12, given_profile(), filter, Extra::Reboot);
    let verdicts = bench.run();
    let verdict = verdict(&verdicts, ConformanceRule::StableOverReboot);
    (verdict.conformance, verdict.text.clone())
}

#[test]
fn services_after_a_reboot_are_compared() {
    assert_eq!(rebooted(None).0, Conformance::Kept);
    let other = vec![vec![b"DES".to_vec(), b"2.0".to_vec()]];
    assert_eq!(rebooted(Some(other)), (Conformance::Broken, "another list of services".into()));
}

#[test]
fn device_with_another_address_after_a_reboot_is_found() {
    let at = Duration::from_mins(1);
    let other = AddressSetting::Fixed(Address::from_bits(30));
    let scenario = scenario(feed().uid(Uid(*b"BOILER")))
        .at(at, "FEED", DeviceAction::StoreAddress(other))
        .at(at, "FEED", DeviceAction::PowerOff)
        .at(at + Duration::from_secs(6), "FEED", DeviceAction::PowerOn);
    let filter = Box::new(NoFilter);
    let mut bench = ProofBench::with(&scenario, 12, given_profile(), filter, Extra::Reboot);
    let verdicts = bench.run();
    let verdict = verdict(&verdicts, ConformanceRule::StableOverReboot);
    assert_eq!(verdict.conformance, Conformance::Kept, "{verdict:?}");
    assert!(broken(&verdicts).is_empty(), "{:?}", broken(&verdicts));
    assert_eq!(bench.prover.device().number(), 30);
}

#[test]
fn requests_stay_within_the_share_of_the_bus() {
    let mut bench = ProofBench::new(&scenario(feed()), 12, given_profile(), Box::new(NoFilter));
    bench.run();
    let bits = |frame: &Frame| f64::from(descan::frame::bits::FrameBits::of(frame).total());
    let sent: f64 = bench.seen.iter().filter(|it| it.is_tx).map(bits).sum();
    let seconds = bench.sim.now().as_secs_f64();
    assert!(sent / seconds < 0.05 * 125_000.0, "{sent} bits in {seconds} s");
}

/// A random good device among others, on a bus that may lose frames and be loaded.
fn random_world(seed: u64) -> Scenario {
    let mut rng = fastrand::Rng::with_seed(seed);
    let bitrate = *rng.choice(&[125_000, 250_000, 500_000, 1_000_000]).unwrap();
    let mut scenario = Scenario::new(bitrate);
    scenario.seed = seed;
    let mut addresses: Vec<u8> = (1..128).filter(|it| *it != 12).collect();
    rng.shuffle(&mut addresses);
    let others = rng.usize(0..=6);
    let places = std::iter::once(12).chain(addresses).take(others + 1);
    for (number, address) in places.enumerate() {
        let longest = if rng.bool() { 5 } else { 20 };
        let length = rng.usize(1..=longest);
        let name: Vec<u8> = (0..length).map(|_| rng.u8(b'A'..=b'Z')).collect();
        let mut device = DeviceSpec::new(&format!("D{number}"))
            .name(&name)
            .preferred(address)
            .uid(Uid([7, number as u8, rng.u8(1..255), 1, 2, 3]))
            .skips_address_resolution();
        let most = if rng.u8(..4) == 0 { 40 } else { 6 };
        for service in 0..rng.usize(0..=most) {
            device = device.service(&format!("S{service}"), "1.10");
            if rng.u8(..6) == 0 {
                device.services.last_mut().unwrap().push(b"extra".to_vec());
            }
        }
        device.framing = *rng
            .choice(&[
                DeviceFraming::Isotp,
                DeviceFraming::Isotp,
                DeviceFraming::Both,
                DeviceFraming::Raw,
            ])
            .unwrap();
        device.fd = rng.u8(..5) == 0;
        device.tolerance_ppm = rng.i32(-20_000..=20_000);
        device.max_heartbeat_delay = Duration::from_millis(*rng.choice(&[0, 1, 50, 700]).unwrap());
        let slowest = *rng.choice(&[1, 20, 400]).unwrap();
        device.response_delay = (Duration::from_micros(200), Duration::from_millis(slowest));
        device.mode = *rng
            .choice(&[None, None, Some(Mode::Cfg), Some(Mode::Boot), Some(Mode::Ufunc)])
            .unwrap();
        if number > 0 && rng.u8(..3) == 0 {
            let period = Duration::from_micros(150_000_000 / u64::from(bitrate) * rng.u64(3..20));
            device = device.periodic_message(rng.u16(0x100..0x200), period, 8);
        }
        scenario = scenario.with(device);
    }
    if rng.u8(..8) == 0 {
        let at = Duration::from_millis(rng.u64(2_000..40_000));
        let reboot = DeviceAction::Reboot { services: None };
        let action = rng.choice([reboot, DeviceAction::WatchdogReset]).unwrap();
        scenario = scenario.at(at, "D0", action);
    }
    match rng.u8(..10) {
        0 => scenario.rx_loss = 0.03,
        1 => scenario.rx_loss = 0.2,
        2 => scenario.frame_error_probability = 0.02,
        _ => {}
    }
    scenario
}

/// Loses frames of which nobody knows: an adapter that does not count.
struct SilentLoss(fastrand::Rng, f64);

impl Filter for SilentLoss {
    fn received(&mut self, frame: Frame) -> Vec<Frame> {
        if self.0.f64() < self.1 { Vec::new() } else { vec![frame] }
    }
}

fn random_filter(seed: u64) -> Box<dyn Filter> {
    let mut rng = fastrand::Rng::with_seed(!seed);
    match rng.u8(..10) {
        0 => Box::new(SilentLoss(rng, 0.01)),
        1 => Box::new(SilentLoss(rng, 0.05)),
        _ => Box::new(NoFilter),
    }
}

fn check_good(seeds: std::ops::Range<u64>) {
    let mut kept = 0;
    let mut failures = Vec::new();
    for seed in seeds.clone() {
        let scenario = random_world(seed);
        let filter = random_filter(seed);
        let mut bench = ProofBench::new(&scenario, 12, given_profile(), filter);
        let verdicts = bench.run();
        let broken = broken(&verdicts);
        if !broken.is_empty() {
            failures.push((seed, broken));
        }
        kept += verdicts.iter().filter(|it| it.conformance == Conformance::Kept).count();
    }
    assert!(failures.is_empty(), "{} failures: {failures:?}", failures.len());
    let mean = kept as u64 / (seeds.end - seeds.start);
    assert!(mean >= 15, "only {mean} rules kept of each");
}

#[test]
fn random_good_devices_break_no_rule() {
    check_good(0..DEVICES);
}

#[test]
#[ignore = "10,000 devices take minutes"]
fn many_random_good_devices_break_no_rule() {
    check_good(DEVICES..DEVICES + MANY_DEVICES);
}
