//! Scenarios: equal seeds give equal runs, errors are reported, and the built-in ones run.

use super::{after, at_ms, beats, from};
use descan::frame::Frame;
use descan::sim::{DeviceAction, DeviceSpec, Scenario, ScenarioError, Sim};
use descan::time::{Duration, Instant};
use descan::wire::id::Address;
use descan::wire::node::Mode;

fn recording(scenario: &Scenario, seed: u64, seconds: u64) -> Vec<Frame> {
    let mut sim = Sim::new(scenario, seed);
    let me = sim.attach();
    (0..seconds).flat_map(|_| after(&mut sim, me, 1000)).collect()
}

#[test]
fn equal_seed_gives_equal_run() {
    for name in Scenario::BUILTIN {
        let scenario = Scenario::builtin(name).unwrap();
        let first = recording(&scenario, 1, 60);
        assert!(first.len() > 1000);
        assert_eq!(first, recording(&scenario, 1, 60), "{name}");
        assert_ne!(first, recording(&scenario, 2, 60), "{name}");
    }
}

#[test]
fn step_size_does_not_change_the_run() {
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut sim = Sim::from_scenario(&scenario);
    let me = sim.attach();
    let mut stepwise = Vec::new();
    while let Some(next) = sim.next_event().filter(|&at| at <= at_ms(30_000)) {
        assert!(next >= sim.now());
        sim.advance(next);
        stepwise.extend(std::iter::from_fn(|| sim.poll_frame(me)));
    }
    assert_eq!(stepwise, recording(&scenario, scenario.seed, 30));
}

#[test]
fn frame_times_are_ordered_and_not_in_the_future() {
    let mut sim = Sim::from_scenario(&Scenario::builtin("drone").unwrap());
    let me = sim.attach();
    let mut last = Instant::ZERO;
    for _ in 0..100 {
        let frames = after(&mut sim, me, 37);
        for frame in frames {
            assert!(frame.time >= last && frame.time <= sim.now());
            last = frame.time;
        }
    }
}

#[test]
fn boiler_scenario_follows_its_timetable() {
    let mut sim = Sim::from_scenario(&Scenario::builtin("boiler").unwrap());
    let me = sim.attach();
    let first = after(&mut sim, me, 1100);
    for number in [10, 12, 30] {
        assert!(!beats(&first, number).is_empty(), "{number} is there at once");
    }
    after(&mut sim, me, 23_000);
    let working = |sim: &Sim| {
        let state = |id| sim.device_state(id).mode;
        sim.devices().filter(|&id| state(id) == Some(Mode::Work)).count()
    };
    assert_eq!(working(&sim), 8);
    let fresh = sim.device_state(sim.device("fresh").unwrap());
    assert_eq!(fresh.mode, Some(Mode::Cfg));
    let at_14 = |frames: &[Frame]| beats(frames, 14).len();
    assert!(at_14(&after(&mut sim, me, 5900)) <= 10);
    let colliding = at_14(&after(&mut sim, me, 20_000 - 1));
    assert!((38..=42).contains(&colliding), "twice the rate: {colliding}");
    sim.advance(at_ms(59_000));
    super::polled(&mut sim, me);
    assert!((4..=6).contains(&at_14(&after(&mut sim, me, 5000))), "one of them is gone");
    let feed = sim.device("FEED").unwrap();
    assert_eq!(sim.device_state(feed).services[2][1], b"2.2");
    after(&mut sim, me, 17_000);
    let moved = sim.device_state(sim.device("DISP").unwrap()).address;
    assert_eq!(moved.map(Address::number), Some(40));
}

#[test]
fn builtin_scenarios_run_for_ten_minutes() {
    for (name, busy) in [("boiler", 0.03..0.2), ("drone", 0.1..0.6)] {
        let mut sim = Sim::from_scenario(&Scenario::builtin(name).unwrap());
        let me = sim.attach();
        let mut quiet_minutes = 0;
        for _ in 0..10 {
            let frames = after(&mut sim, me, 60_000);
            let modes: std::collections::BTreeSet<_> =
                frames.iter().filter(|f| f.len() == 8).map(|f| f.data()[6]).collect();
            quiet_minutes += usize::from(modes.len() < 2);
        }
        assert_eq!(quiet_minutes, 0, "{name}");
        let statistics = sim.statistics();
        let load = statistics.busy_nanos as f64 / 600e9;
        assert!(busy.contains(&load), "{name}: {load}");
        let status = sim.status(me);
        assert_eq!((status.rx_overflow, status.rx_lost), (0, 0));
        let on = sim.devices().filter(|&id| sim.device_state(id).mode.is_some()).count();
        assert!(on >= 9, "{name}: {on}");
    }
}

#[test]
fn crowd_is_in_work_mode_from_the_start() {
    let frames = recording(&Scenario::with_many_devices(1_000_000, 127, 5), 1, 1);
    for number in 1..=127 {
        assert!((1..=2).contains(&beats(&frames, number).len()), "{number}");
    }
}

#[test]
fn timetable_with_period_repeats() {
    let scenario = Scenario::parse(
        r#"
        bitrate = 500000
        [[device]]
        name = "A"
        address = { fixed = 1 }
        settled = true
        [[device]]
        name = "B"
        address = { fixed = 2 }
        settled = true
        chatter = [{ service = 0x123, period_ms = 10, length = 3 }]
        [[at]]
        time = 1.0
        every = 4.0
        device = "A"
        do = "break"
        fault = "no-heartbeat"
        [[at]]
        time = 3.0
        every = 4.0
        device = "A"
        do = "mend"
        fault = "no-heartbeat"
        "#,
    )
    .unwrap();
    let frames = recording(&scenario, 1, 41);
    let beats = beats(&frames, 1).len();
    assert!((10..=12).contains(&beats), "one a second after each mending: {beats}");
    let chatter = from(&frames, 2).iter().filter(|(h, _)| h.service.number() == 0x123).count();
    assert!((4080..=4110).contains(&chatter), "{chatter}");
}

#[test]
fn invalid_scenario_error_names_the_cause() {
    let device = "bitrate = 125000\n[[device]]\nname = \"A\"\n";
    let said = |text: &str| Scenario::parse(text).unwrap_err().to_string();
    let cases = [
        ("", "missing field `bitrate`"),
        ("bitrate = 5", "the bus: bitrate = 5 is not 10000 to 1000000 bit/s"),
        ("bitrate = 125000\nspeed = 1", "unknown field `speed`"),
        ("bitrate = 125000\nerror_rate = 2.0", "error_rate = 2 is not a share"),
        ("bitrate = 125000\n[[device]]\n", "number 1 (without a name): needs `name`"),
        (&format!("{device}[[device]]\nname = \"A\""), "two devices are labelled \"A\""),
        (&format!("{device}address = {{ fixed = 128 }}"), "128 is not a node address"),
        (&format!("{device}address = {{ fixed = 0 }}"), "0 is not a node address"),
        (&format!("{device}uid = \"small\""), "uid = small is not up to 8 characters"),
        (&format!("{device}name_hex = \"41\""), "both `name` and `name_hex`"),
        (&format!("{device}faults = [\"lazy\"]"), "unknown variant `lazy`"),
        (&format!("{device}mode = \"SLEEP\""), "mode = SLEEP is not INIT, ARSLV"),
        (&format!("{device}delay_us = [5, 1]"), "delay_us = [5, 1]"),
        (&format!("{device}heartbeat_ms = 0"), "heartbeat_ms = 0"),
        (&format!("{device}power_on = -1.0"), "power_on = -1"),
        (&format!("{device}chatter = [{{ service = 1024, period_ms = 1 }}]"), "service = 1024"),
        (
            &format!("{device}[[at]]\ntime = 1.0\ndevice = \"B\"\ndo = \"leave\""),
            "[[at]] number 1: no device labelled \"B\"",
        ),
        (&format!("{device}[[at]]\ntime = 1.0\ndo = \"leave\""), "needs `device`"),
        (
            &format!("{device}[[at]]\ntime = 1.0\ndevice = \"A\"\ndo = \"move\""),
            "[[at]] number 1: needs `address`",
        ),
        (
            &format!("{device}[[at]]\ntime = 1.0\ndevice = \"A\"\ndo = \"leave\"\nrate = 0.5"),
            "`rate` not allowed",
        ),
        (&format!("{device}[[at]]\ntime = nan\ndevice = \"A\"\ndo = \"leave\""), "time = NaN"),
    ];
    for (text, expected) in cases {
        let said = said(text);
        assert!(said.contains(expected), "{text}\n→ {said}\nnot: {expected}");
    }
    assert!(matches!(Scenario::builtin("kettle"), Err(ScenarioError::NoSuchScenario { .. })));
}

#[test]
fn scenario_names_may_hold_any_bytes() {
    let text = "bitrate = 125000\n[[device]]\nlabel = \"odd\"\nname_hex = \"1B5bFF\"";
    let scenario = Scenario::parse(text).unwrap();
    assert_eq!(scenario.devices[0].name, [0x1B, 0x5B, 0xFF]);
}

#[test]
fn extreme_scenarios_do_not_panic() {
    let mut device = DeviceSpec::new("A").skips_address_resolution();
    device.heartbeat = Some(Duration::ZERO);
    device.max_heartbeat_delay = Duration::MAX;
    device.response_delay = (Duration::MAX, Duration::ZERO);
    device.tolerance_ppm = i32::MIN;
    device.services = vec![vec![vec![b'x'; 9000]]];
    device = device.periodic_message(0x3FF, Duration::ZERO, 255);
    let mut scenario = Scenario::new(0).with(device.clone()).with(device);
    scenario.data_bitrate = 0;
    scenario.frame_error_probability = f64::NAN;
    scenario = scenario.at(Duration::MAX, "nobody", DeviceAction::PowerOff);
    let mut sim = Sim::new(&scenario, 1);
    let me = sim.attach();
    sim.transmit(me, Frame::classic(0, &[]));
    sim.advance(at_ms(2000));
    scenario.bitrate = 1_000_000;
    let mut sim = Sim::new(&scenario, 1);
    let me = sim.attach();
    after(&mut sim, me, 2000);
}
