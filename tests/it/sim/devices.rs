//! Devices choose addresses, send heartbeats, give way and go bus-off.

use super::{address, after, at_ms, beats, bus_with, from, is_error};
use crate::common::sweep;
use descan::sim::{DeviceAction, DeviceSpec, Fault, Scenario, Sim, SimStation};
use descan::time::Duration;
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Address;
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::Profile;

fn state(sim: &Sim, label: &str) -> (Option<Mode>, Option<u8>) {
    let state = sim.device_state(sim.device(label).unwrap());
    (state.mode, state.address.map(Address::number))
}

fn settled(name: &str, number: u8) -> DeviceSpec {
    DeviceSpec::new(name).fixed(number).skips_address_resolution()
}

#[test]
fn device_listens_waits_claims_and_works() {
    let (mut sim, me) = bus_with([DeviceSpec::new("FEED").preferred(10)]);
    // Nothing on the bus: INIT to 1.5 s, ARSLV to 3 s, a random part of 1 s.
    sim.advance(at_ms(1400));
    assert_eq!(state(&sim, "FEED"), (Some(Mode::Init), None));
    sim.advance(at_ms(2900));
    assert_eq!(state(&sim, "FEED"), (Some(Mode::Arslv), None));
    let frames = after(&mut sim, me, 3000);
    assert_eq!(state(&sim, "FEED"), (Some(Mode::Work), Some(10)));
    let all = from(&frames, 10);
    let (claim, frame) = all[0];
    assert!(claim.from_non_working && frame.data()[6] == 1, "claimed in ARSLV");
    assert!((at_ms(3000)..at_ms(4010)).contains(&frame.time));
    let (beat, frame) = all[1];
    assert!(!beat.from_non_working && frame.data()[6] == 4, "then at work");
}

#[test]
fn bus_frame_ends_init_early() {
    let (mut sim, _me) = bus_with([settled("A", 1), DeviceSpec::new("B").preferred(2)]);
    sim.advance(at_ms(1100));
    assert_eq!(state(&sim, "B").0, Some(Mode::Arslv));
}

#[test]
fn equal_preferred_addresses_are_resolved() {
    for seed in 0..20 {
        let mut scenario = Scenario::new(125_000);
        for label in ["A", "B"] {
            scenario = scenario.with(DeviceSpec::new(label).preferred(10));
        }
        let mut sim = Sim::new(&scenario, seed);
        sim.attach();
        sim.advance(at_ms(20_000));
        let (a, b) = (state(&sim, "A"), state(&sim, "B"));
        assert_eq!((a.0, b.0), (Some(Mode::Work), Some(Mode::Work)), "seed {seed}");
        assert_ne!(a.1, b.1, "seed {seed}");
        assert!(a.1 == Some(10) || b.1 == Some(10), "seed {seed}");
    }
}

#[test]
fn two_devices_alone_get_addresses() {
    // The first claim is not acknowledged; the second device's controller acknowledges later.
    let scenario = Scenario::new(125_000)
        .with(DeviceSpec::new("A").preferred(1))
        .with(DeviceSpec::new("B").preferred(2));
    let mut sim = Sim::new(&scenario, 5);
    sim.advance(at_ms(15_000));
    assert_eq!(state(&sim, "A"), (Some(Mode::Work), Some(1)));
    assert_eq!(state(&sim, "B"), (Some(Mode::Work), Some(2)));
}

#[test]
fn single_device_never_gets_an_address() {
    let mut sim = Sim::new(&Scenario::new(125_000).with(DeviceSpec::new("A").preferred(1)), 1);
    sim.advance(at_ms(60_000));
    assert_eq!(state(&sim, "A").1, None);
    let me = sim.attach();
    assert!(!beats(&after(&mut sim, me, 10_000), 1).is_empty());
}

#[test]
fn used_fixed_address_is_awaited_preferred_is_not() {
    let (mut sim, _me) = bus_with([
        settled("OLD", 10),
        DeviceSpec::new("FIXED").fixed(10),
        DeviceSpec::new("PREF").preferred(10),
    ]);
    sim.advance(at_ms(20_000));
    assert_eq!(state(&sim, "FIXED").1, None);
    assert!(state(&sim, "PREF").1.is_some_and(|number| number != 10));
    sim.apply(sim.device("OLD").unwrap(), DeviceAction::PowerOff);
    assert_eq!(state(&sim, "OLD"), (None, None));
    sim.advance(at_ms(30_000));
    assert_eq!(state(&sim, "FIXED"), (Some(Mode::Work), Some(10)));
}

#[test]
fn destination_addresses_count_as_used() {
    let (mut sim, me) = bus_with([DeviceSpec::new("A").preferred(33)]);
    sim.attach();
    for second in 0..8u64 {
        sim.advance(at_ms(second * 500));
        let header = descan::wire::id::Header::request(
            address(0),
            address(33),
            false,
            descan::wire::id::Service::new(0x99).unwrap(),
        );
        sim.transmit(me, descan::frame::Frame::classic(header.encode(), &[]));
    }
    sim.advance(at_ms(10_000));
    assert!(state(&sim, "A").1.is_some_and(|number| number != 33));
}

#[test]
fn unconfigured_device_stays_in_cfg() {
    let mut manual = DeviceSpec::new("MANUAL").preferred(3);
    manual.autostart = false;
    let mut forced = DeviceSpec::new("UFUNC").preferred(4);
    forced.mode = Some(Mode::Ufunc);
    let (mut sim, me) = bus_with([
        DeviceSpec::new("ANY"),
        DeviceSpec::new("BLANK").preferred(2).uid(Uid([0; 6])),
        manual,
        forced,
    ]);
    let frames = after(&mut sim, me, 10_000);
    for label in ["ANY", "BLANK", "MANUAL"] {
        assert_eq!(state(&sim, label).0, Some(Mode::Cfg), "{label}");
    }
    assert!(from(&frames, 3).iter().all(|(header, _)| header.from_non_working));
    let (header, beat) = *from(&frames, 4).last().unwrap();
    assert!(!header.from_non_working);
    assert_eq!(&beat.data()[6..], [5, 1], "mode and an error code");
}

#[test]
fn conforming_device_yields_to_one_that_keeps_its_address() {
    let offender = DeviceSpec::new("BAD")
        .fixed(10)
        .fault(Fault::KeepsAddress)
        .power_on(Duration::from_secs(2));
    let (mut sim, _me) =
        bus_with([DeviceSpec::new("GOOD").preferred(10).skips_address_resolution(), offender]);
    sim.advance(at_ms(15_000));
    assert_eq!(state(&sim, "BAD"), (Some(Mode::Work), Some(10)));
    assert!(state(&sim, "GOOD").1.is_some_and(|number| number != 10));
}

#[test]
fn second_uid_in_work_mode_sends_first_to_cfg() {
    let uid = Uid([1; 6]);
    let (mut sim, _me) = bus_with([settled("A", 1).uid(uid), settled("B", 2).uid(uid)]);
    sim.advance(at_ms(3000));
    let mut modes = [state(&sim, "A").0, state(&sim, "B").0];
    modes.sort_unstable();
    assert_eq!(modes, [Some(Mode::Cfg), Some(Mode::Work)]);
}

#[test]
fn heartbeats_keep_their_period() {
    let mut slow = settled("SLOW", 2);
    slow.tolerance_ppm = 10_000;
    slow.max_heartbeat_delay = Duration::ZERO;
    let mut late = settled("LATE", 3);
    late.heartbeat = Some(Duration::from_millis(500));
    late.max_heartbeat_delay = Duration::from_millis(20);
    let (mut sim, me) = bus_with([slow, late]);
    let frames = after(&mut sim, me, 101_000);
    let slow = beats(&frames, 2);
    assert!((99..=100).contains(&slow.len()), "{}", slow.len());
    let whole = slow[98].time.since(slow[0].time).as_secs_f64();
    assert!((whole - 98.0 * 1.01).abs() < 0.01, "{whole}");
    let late = beats(&frames, 3);
    let gaps = late.windows(2).map(|pair| pair[1].time.since(pair[0].time).as_micros());
    let (least, most) = (gaps.clone().min().unwrap(), gaps.clone().max().unwrap());
    assert!((478_000..500_000).contains(&least), "{least}");
    assert!((500_000..522_000).contains(&most), "{most}");
    let mean = gaps.sum::<u128>() / (late.len() as u128 - 1);
    assert!((499_500..500_500).contains(&mean), "the grid does not drift: {mean}");
}

#[test]
fn two_offenders_collide_and_give_up_at_128() {
    let mut one = settled("ESC", 5).label("one").fault(Fault::KeepsAddress);
    one.services = vec![vec![b"DES".to_vec(), b"1.0".to_vec()]];
    one.response_delay = (Duration::ZERO, Duration::ZERO);
    let mut two = one.clone().label("two");
    two.services = vec![vec![b"DES".to_vec(), b"9.9".to_vec()]];
    let (mut sim, me) = bus_with([one, two]);
    let ask = descan::wire::id::Header::request(address(0), address(5), false, super::des());
    sim.transmit(me, descan::frame::Frame::classic(ask.encode(), &[4, b'D', b'E', b'S', 2]));
    let frames = after(&mut sim, me, 10);
    let answers = from(&frames, 5);
    assert_eq!(answers.len(), 1, "equal first frames merge");
    sim.transmit(me, descan::frame::Frame::classic(ask.encode(), &[0x30, 0, 0]));
    let frames = after(&mut sim, me, 100);
    assert!(from(&frames, 5).is_empty());
    assert_eq!(frames.iter().filter(|frame| is_error(frame)).count(), 16);
    assert_eq!(state(&sim, "one"), (Some(Mode::Init), None));
    assert_eq!(state(&sim, "two"), (Some(Mode::Init), None));
    sim.advance(at_ms(10_000));
    assert_eq!(state(&sim, "one").1, Some(5), "and they come back");
}

#[test]
fn device_actions_take_effect() {
    let (mut sim, me) = bus_with([settled("A", 1), settled("B", 2)]);
    let a = sim.device("A").unwrap();
    sim.apply(a, DeviceAction::Mode(Mode::Cfg));
    assert!(from(&after(&mut sim, me, 1100), 1)[0].0.from_non_working);
    sim.apply(a, DeviceAction::Mode(Mode::Work));
    sim.apply(a, DeviceAction::Uid(Uid([9; 6])));
    assert_eq!(beats(&after(&mut sim, me, 1100), 1)[0].data()[..6], [9; 6]);
    sim.apply(a, DeviceAction::AddFault(Fault::NoHeartbeat));
    assert!(after(&mut sim, me, 5000).iter().all(|frame| beats(&[*frame], 1).is_empty()));
    sim.apply(a, DeviceAction::RemoveFault(Fault::NoHeartbeat));
    assert!(!beats(&after(&mut sim, me, 1100), 1).is_empty());
    sim.apply(a, DeviceAction::Mode(Mode::Idle));
    let last_words = after(&mut sim, me, 5000);
    let last_words = beats(&last_words, 1);
    assert_eq!(last_words.len(), 1, "asleep");
    assert_eq!(last_words[0].data()[6], 6);
    sim.apply(a, DeviceAction::Move(AddressSetting::Fixed(address(9))));
    sim.advance(sim.now() + Duration::from_secs(5));
    assert_eq!(state(&sim, "A"), (Some(Mode::Work), Some(9)));
    sim.apply(a, DeviceAction::Reboot { services: Some(vec![vec![b"X".to_vec(), b"2".to_vec()]]) });
    assert_eq!(state(&sim, "A"), (Some(Mode::Init), None));
    assert_eq!(sim.device_state(a).services[0][1], b"2");
    let c = sim.add_device(DeviceSpec::new("C").fixed(77).skips_address_resolution());
    assert_eq!(sim.device("C"), Some(c));
    assert!(!beats(&after(&mut sim, me, 1100), 77).is_empty());
}

#[test]
fn descriptor_is_read_and_address_written() {
    let profile = Profile::parse("writes.address = 0x016").unwrap();
    let mut scenario = Scenario::new(125_000).with(settled("A", 1)).with(settled("B", 2));
    scenario.profile = profile;
    let mut sim = Sim::new(&scenario, 1);
    let me = sim.attach();
    let ask = |sim: &mut Sim, me: SimStation, to: u8, service: u16, data: &[u8]| {
        let service = descan::wire::id::Service::new(service).unwrap();
        let header = descan::wire::id::Header::request(address(0), address(to), false, service);
        sim.transmit(me, descan::frame::Frame::classic(header.encode(), data));
        let frames = after(sim, me, 10);
        let answer = from(&frames, to).into_iter().find(|(header, _)| header.service == service);
        answer.map(|(header, frame)| (header.no_error, frame.data().to_vec()))
    };
    assert_eq!(ask(&mut sim, me, 1, 0x016, &[]), Some((true, vec![1])));
    assert_eq!(ask(&mut sim, me, 1, 0x015, &[]), Some((true, vec![0x80])));
    assert_eq!(ask(&mut sim, me, 1, 0x013, &[]), Some((true, vec![1, 0, 0, 0])));
    assert_eq!(ask(&mut sim, me, 1, 0x010, &[1]), Some((false, vec![])), "not to be written");
    assert_eq!(ask(&mut sim, me, 1, 0x018, &[]), Some((true, vec![])), "blinks");
    assert_eq!(ask(&mut sim, me, 1, 0x123, &[]), None);
    assert_eq!(ask(&mut sim, me, 1, 0x016, &[0x80 | 0x63]), Some((true, vec![])));
    sim.advance(sim.now() + Duration::from_secs(5));
    assert_eq!(state(&sim, "A"), (Some(Mode::Work), Some(99)));
    assert_eq!(ask(&mut sim, me, 2, 0x019, &[2]), Some((true, vec![])));
    assert_eq!(state(&sim, "B").0, Some(Mode::Cfg));
}

/// Tests that after any disturbance has ended, every working device has its own address.
#[test]
fn random_faults_removed_leave_unique_addresses() {
    const FAULTS: [Fault; 6] = [
        Fault::KeepsAddress,
        Fault::Endless,
        Fault::RespondsTwice,
        Fault::NoHeartbeat,
        Fault::DropFrame,
        Fault::HugeLength,
    ];
    for seed in 0..u64::from(sweep::cases(60)) {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut scenario = Scenario::new(500_000);
        for number in 0..12 {
            // Few addresses for many devices.
            let device = DeviceSpec::new(&format!("N{number}")).preferred(rng.u8(1..5));
            let device = device.service("A-SERVICE", "1.0").periodic_message(0x100, at(30), 8);
            scenario =
                scenario.with(if rng.bool() { device.skips_address_resolution() } else { device });
        }
        let mut sim = Sim::new(&scenario, seed);
        let me = sim.attach();
        let devices: Vec<_> = sim.devices().collect();
        for _ in 0..150 {
            let device = rng.choice(&devices).copied().unwrap();
            let fault = rng.choice(FAULTS).unwrap();
            let wanted = AddressSetting::Fixed(address(rng.u8(1..5)));
            match rng.u8(0..9) {
                0 => sim.apply(device, DeviceAction::PowerOff),
                1 => sim.apply(device, DeviceAction::PowerOn),
                2 => sim.apply(device, DeviceAction::Reboot { services: None }),
                3 => sim.apply(device, DeviceAction::Move(wanted)),
                4 => sim.apply(device, DeviceAction::AddFault(fault)),
                5 => sim.apply(device, DeviceAction::Mode(rng.choice(Mode::ALL).unwrap())),
                6 => sim.set_frame_error_probability(rng.f64() * 0.5),
                7 => sim.set_link(me, rng.bool()),
                _ => {
                    let header = super::Header::request(
                        address(0),
                        address(rng.u8(1..5)),
                        rng.bool(),
                        super::des(),
                    );
                    let data = [4, b'D', b'E', b'S', rng.u8(1..3)];
                    let flow = [0x30, rng.u8(0..4), rng.u8(..)];
                    let data = if rng.bool() { &data[..] } else { &flow[..] };
                    sim.transmit(me, descan::frame::Frame::classic(header.encode(), data));
                }
            }
            after(&mut sim, me, rng.u64(0..800));
        }
        sim.set_frame_error_probability(0.0);
        sim.set_link(me, true);
        for &device in &devices {
            for fault in FAULTS {
                sim.apply(device, DeviceAction::RemoveFault(fault));
            }
            let preferred = AddressSetting::Preferred(address(rng.u8(1..5)));
            sim.apply(device, DeviceAction::Move(preferred));
            sim.apply(device, DeviceAction::PowerOn);
        }
        after(&mut sim, me, 60_000);
        let states = devices.iter().map(|&device| sim.device_state(device));
        let mut held: Vec<u8> =
            states.map(|state| state.address.map_or(0, Address::number)).collect();
        held.sort_unstable();
        held.dedup();
        assert!(held.len() == 12 && held[0] > 0, "seed {seed}: {held:?}");
    }
}

fn at(ms: u64) -> Duration {
    Duration::from_millis(ms)
}
