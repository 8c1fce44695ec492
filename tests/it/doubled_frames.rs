//! One device whose frames arrive twice, and one that sends them twice: distinguished from two
//! devices.

use crate::common::inspection::Inspection;
use descan::discovery::{Config, Engine, EventKind};
use descan::finding::{Evidence, Finding, FindingKind, FindingState};
use descan::frame::Frame;
use descan::sim::{DeviceSpec, Fault, Scenario};
use descan::time::{Duration, Instant};
use descan::wire::id::Header;
use descan::wire::node::Uid;
use std::collections::VecDeque;

const END: Instant = Instant::from_micros(40_000_000);

fn device(name: &str, address: u8) -> DeviceSpec {
    let uid = Uid([address; 6]);
    DeviceSpec::new(name).uid(uid).fixed(address).skips_address_resolution().service("DES", "1.0")
}

fn three_devices() -> Scenario {
    let mut scenario = Scenario::new(250_000);
    let phases = [("FEED", 12, 0), ("SENS", 13, 310), ("PUMP", 14, 640)];
    for (name, address, phase) in phases {
        let power_on = Duration::from_millis(phase);
        scenario.devices.push(device(name, address).power_on(power_on));
    }
    scenario
}

/// Runs an inspector that receives each frame for which `is_repeated` returns true again `delay`
/// later, with up to `jitter` more.
fn with_gateway(
    scenario: &Scenario,
    config: Config,
    seed: u64,
    delay: Duration,
    is_repeated: impl Fn(&Frame) -> bool,
) -> Engine {
    let mut bus = Inspection::new(scenario, seed, config);
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut copies: VecDeque<Frame> = VecDeque::new();
    while bus.sim.now() < END {
        let now = bus.sim.now();
        while let Some(frame) = bus.sim.poll_frame(bus.station) {
            bus.engine.handle_frame(&frame);
            if !frame.is_tx && is_repeated(&frame) {
                let at = frame.time + delay + Duration::from_micros(rng.u64(..800));
                copies.push_back(frame.with_time(at));
            }
        }
        while let Some(copy) = copies.pop_front_if(|copy| copy.time <= now) {
            bus.engine.handle_frame(&copy);
        }
        if bus.engine.poll_timeout().is_some_and(|due| due <= now) {
            bus.engine.handle_timeout(now);
        }
        while let Some(frame) = bus.engine.poll_transmit(now) {
            bus.sim.transmit(bus.station, frame);
        }
        let due = [bus.engine.poll_timeout(), bus.sim.next_event()];
        let due = due.into_iter().chain([copies.front().map(|copy| copy.time), Some(END)]);
        bus.sim.advance(due.flatten().min().unwrap_or(END).max(now));
    }
    bus.engine
}

/// Returns the kinds of the conflicts that were ever confirmed.
fn confirmed(engine: &mut Engine) -> Vec<FindingKind> {
    let mut kinds = Vec::new();
    while let Some(event) = engine.poll_event() {
        if let EventKind::Finding { key, state: FindingState::Confirmed } = event.kind {
            kinds.push(key.kind);
        }
    }
    kinds
}

fn finding(engine: &Engine, kind: FindingKind) -> Option<&Finding> {
    engine.findings().iter().find(|finding| finding.key.kind == kind)
}

fn is_of(frame: &Frame, address: u8) -> bool {
    let source = frame.platform_id().map(|id| Header::decode(id).source.number());
    source == Some(address)
}

#[test]
fn gateway_that_repeats_one_device_is_no_conflict() {
    for millis in [3, 8, 20, 50] {
        for seed in 0..5 {
            let delay = Duration::from_millis(millis);
            let mut engine =
                with_gateway(&three_devices(), Config::default(), seed, delay, |frame| {
                    is_of(frame, 12)
                });
            let label = format!("{millis} ms later, seed {seed}");
            assert_eq!(confirmed(&mut engine), [], "{label}");
            let repeated = finding(&engine, FindingKind::FramesRepeated).expect(&label);
            assert_eq!(repeated.state, FindingState::Suspected, "{label}");
            let begin = "Frames from address 12 arrive twice, ";
            let end = " ms apart: sent twice, or repeated by a gateway?";
            let apart = repeated.text.strip_prefix(begin).and_then(|text| text.strip_suffix(end));
            let apart: u64 = apart.and_then(|number| number.parse().ok()).expect(&repeated.text);
            assert!((millis..=millis + 1).contains(&apart), "{label}: {}", repeated.text);
            let open = engine.findings().iter().filter(|it| it.state != FindingState::Cleared);
            assert_eq!(open.count(), 1, "{label}: {:#?}", engine.findings());
        }
    }
}

/// Two boards with the same random numbers, of which only heartbeats are equal.
#[test]
fn equal_heartbeats_less_than_half_a_period_apart_are_suspected() {
    for millis in [110, 200, 300, 440] {
        for seed in 0..3 {
            let delay = Duration::from_millis(millis);
            // Nothing is asked: responses would show that there are two.
            let config = Config { listen_only: true, ..Config::default() };
            let is_beat = |frame: &Frame| {
                let header = frame.platform_id().map(Header::decode);
                is_of(frame, 12) && header.is_some_and(|it| it.service.number() == 1)
            };
            let mut engine = with_gateway(&three_devices(), config, seed, delay, is_beat);
            let label = format!("{millis} ms later, seed {seed}");
            assert_eq!(confirmed(&mut engine), [], "{label}");
            let found = finding(&engine, FindingKind::FramesRepeated).expect(&label);
            assert_eq!(found.state, FindingState::Suspected, "{label}: {:#?}", engine.findings());
            let words = format!("{millis} ms apart: two boards with equal random numbers, or ");
            assert!(found.text.contains(&words), "{label}: {}", found.text);
        }
    }
}

#[test]
fn bridge_that_repeats_all_frames_is_one_finding() {
    for seed in 0..5 {
        let mut engine = with_gateway(
            &three_devices(),
            Config::default(),
            seed,
            Duration::from_millis(12),
            |_| true,
        );
        assert_eq!(confirmed(&mut engine), [], "seed {seed}");
        let open: Vec<&Finding> =
            engine.findings().iter().filter(|it| it.state != FindingState::Cleared).collect();
        let [only] = open[..] else { panic!("seed {seed}: {open:#?}") };
        assert_eq!((only.key.kind, only.key.address), (FindingKind::FramesRepeated, None));
        assert!(only.text.starts_with("All frames arrive twice, 12 ms apart"), "{}", only.text);
    }
}

#[test]
fn device_that_responds_twice_has_doubled_answers() {
    for has_heartbeats in [true, false] {
        for seed in 0..5 {
            let mut scenario = three_devices();
            scenario.devices[0].faults.set(Fault::RespondsTwice, true);
            if !has_heartbeats {
                scenario.devices[0].faults.set(Fault::NoHeartbeat, true);
            }
            let mut bus = Inspection::new(&scenario, seed, Config::default());
            bus.run_until(END, |_| false);
            let label = format!("heartbeats: {has_heartbeats}, seed {seed}");
            let open: Vec<&Finding> = bus
                .engine
                .findings()
                .iter()
                .filter(|it| it.state != FindingState::Cleared)
                .collect();
            let [only] = open[..] else { panic!("{label}: {open:#?}") };
            assert_eq!(only.key.kind, FindingKind::AnswersDoubled, "{label}");
            assert_eq!(only.state, FindingState::Confirmed, "{label}");
            assert!(only.text.contains("two equal devices, or one that responds twice"));
            let opened = bus.events.iter().filter_map(|event| match &event.kind {
                EventKind::Finding { key, state: FindingState::Confirmed } => Some(key.kind),
                _ => None,
            });
            assert!(opened.into_iter().all(|kind| kind == FindingKind::AnswersDoubled), "{label}");
        }
    }
}

/// Two devices of one name without heartbeats: the collision of the platform's own document.
#[test]
fn two_devices_without_heartbeats_have_doubled_answers() {
    for seed in 0..5 {
        let mut scenario = three_devices();
        let mut other = device("FEED", 12).label("other");
        for device in [&mut scenario.devices[0], &mut other] {
            device.faults.set(Fault::NoHeartbeat, true);
            device.faults.set(Fault::KeepsAddress, true);
        }
        scenario.devices.push(other);
        let mut bus = Inspection::new(&scenario, seed, Config::default());
        let is_confirmed = |engine: &Engine| {
            let found = finding(engine, FindingKind::AnswersDoubled);
            found.is_some_and(|it| it.state == FindingState::Confirmed)
        };
        assert!(bus.run_until(END, is_confirmed), "seed {seed}: {:#?}", bus.engine.findings());
    }
}

/// Two boards with equal name and UID look like one with half the period.
#[test]
fn equal_boards_at_opposite_phases_are_confirmed() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let seeds = number("SEEDS").unwrap_or(4);
    let mut missed = Vec::new();
    let mut slowest = Duration::ZERO;
    for percent in 46..=54 {
        for seed in 0..seeds {
            let mut scenario = three_devices();
            let delay = Duration::from_millis([1, 10, 40][seed as usize % 3]);
            for phase in [120, 120 + 10 * percent] {
                let board = device("ACT", 20).fault(Fault::KeepsAddress);
                let mut board = board.power_on(Duration::from_millis(phase));
                board.max_heartbeat_delay = delay;
                scenario.devices.push(board);
            }
            let mut bus = Inspection::new(&scenario, seed, Config::default());
            let end = Instant::from_micros(20_000_000);
            let is_found = bus.run_until(end, |engine| {
                let found = finding(engine, FindingKind::SameNameSameAddress);
                found.is_some_and(|it| it.state == FindingState::Confirmed)
            });
            if is_found {
                slowest = slowest.max(bus.sim.now().since(Instant::ZERO));
            } else {
                missed.push((percent, seed));
            }
        }
    }
    println!("slowest: {slowest:?}, missed: {}", missed.len());
    assert_eq!(missed, []);
}

/// Heartbeats of one board: its address, the time of its first one, its period and its random numbers.
fn beats(
    address: u32,
    first: u64,
    period: u64,
    number: impl Fn(u32) -> u32,
) -> impl Iterator<Item = Frame> {
    (0..).map(move |count| {
        let at = first + u64::from(count) * period;
        let id = 0x0700_0001 | address << 17 | (number(count) & 127) << 10;
        let uid = address as u8;
        let data = [uid, uid, uid, uid, uid, uid, 4, 0];
        Frame::classic(id, &data).with_time(Instant::from_micros(at))
    })
}

/// Runs a listener on the heartbeats of these boards.
fn listener(boards: Vec<Box<dyn Iterator<Item = Frame>>>, end: Instant) -> Engine {
    let until_end = |board: Box<dyn Iterator<Item = Frame>>| {
        board.take_while(|frame| frame.time < end).collect::<Vec<Frame>>()
    };
    let mut frames: Vec<Frame> = boards.into_iter().flat_map(until_end).collect();
    frames.sort_by_key(|frame| frame.time);
    let mut engine = Engine::new(Instant::ZERO, Config { listen_only: true, ..Config::default() });
    for frame in frames {
        while let Some(due) = engine.poll_timeout().filter(|due| *due <= frame.time) {
            engine.handle_timeout(due);
        }
        engine.handle_frame(&frame);
    }
    engine
}

/// A sequence without a repeated pair.
fn random(count: u32) -> u32 {
    count.wrapping_mul(0x9E37_79B1) >> 25
}

#[test]
fn repeated_addresses_are_named_where_others_have_no_copies() {
    for (delay, who) in [
        (20_000, "20 ms apart: repeated by a bridge?"),
        (300_000, "two boards at each address with equal random numbers, or "),
    ] {
        for others in [0, 1, 3] {
            let mut boards: Vec<Box<dyn Iterator<Item = Frame>>> = Vec::new();
            for address in [12, 14] {
                let first = u64::from(address) * 5_000;
                let number = move |count| random(count + address);
                boards.push(Box::new(beats(address, first, 1_000_000, number)));
                boards.push(Box::new(beats(address, first + delay, 1_000_000, number)));
            }
            for other in 0..others {
                let number = move |count| random(count + 40 + other);
                boards.push(Box::new(beats(40 + other, 600_000, 1_000_400, number)));
            }
            let mut engine = listener(boards, END);
            let label = format!("{delay} µs, {others} others");
            assert_eq!(confirmed(&mut engine), [], "{label}");
            let repeated = engine.findings().iter();
            let repeated = repeated.filter(|it| it.key.kind == FindingKind::FramesRepeated);
            let open = repeated.filter(|it| it.state == FindingState::Suspected);
            let texts: Vec<&str> = open.map(|it| &*it.text).collect();
            let says_all = texts.iter().any(|text| text.starts_with("All frames arrive twice"));
            assert_eq!(says_all, others == 0, "{label}: {texts:?}");
            if others == 0 {
                assert!(texts[0].contains(who), "{label}: {texts:?}");
            } else {
                let names = |text: &&str| text.contains(" 12") || text.contains(" 14 ");
                assert!(!texts.is_empty() && texts.iter().all(names), "{label}: {texts:?}");
            }
        }
    }
}

/// The heartbeats of two boards drift: from 0.65 periods apart until they are at one time, and on.
#[test]
fn confirmed_conflict_stays_where_equal_heartbeats_come_closer() {
    for end in [165, 200, 280, 320, 340, 360] {
        let boards: Vec<Box<dyn Iterator<Item = Frame>>> = vec![
            Box::new(beats(12, 100_000, 1_000_000, random)),
            Box::new(beats(12, 750_000, 998_000, random)),
            Box::new(beats(40, 300_000, 1_000_000, |count| random(count + 40))),
        ];
        let end = Instant::from_micros(end * 1_000_000);
        let mut engine = listener(boards, end);
        assert_eq!(confirmed(&mut engine), [FindingKind::SameNameSameAddress], "{end}");
        let found = finding(&engine, FindingKind::SameNameSameAddress).unwrap();
        assert_eq!(found.state, FindingState::Confirmed, "{:#?}", engine.findings());
        assert!(end.since(found.last) < Duration::from_secs(3), "{end} {found:#?}");
    }
}

/// After a conflict of two boards one of them leaves, and a gateway repeats the frames of the other.
#[test]
fn confirmed_conflict_ends_where_a_gateway_repeats_frames() {
    let boards: Vec<Box<dyn Iterator<Item = Frame>>> = vec![
        Box::new(beats(12, 100_000, 1_000_000, random)),
        Box::new(beats(12, 750_000, 1_000_000, random).take(30)),
        Box::new(beats(12, 300_000, 1_000_000, random).skip(30)),
        Box::new(beats(40, 310_000, 1_000_000, |count| random(count + 40))),
    ];
    let engine = listener(boards, Instant::from_micros(60_000_000));
    let found = finding(&engine, FindingKind::SameNameSameAddress).unwrap();
    assert_eq!(found.state, FindingState::Cleared, "{:#?}", engine.findings());
}

/// Each frame of these addresses, and its copies so many milliseconds later, comes in each second. Returns the
/// texts of repeated frames that are open.
fn texts_of_repeated(copies: &[(u32, &[u64])]) -> Vec<String> {
    let mut boards: Vec<Box<dyn Iterator<Item = Frame>>> = Vec::new();
    for &(address, delays) in copies {
        let first = u64::from(address) * 30_000;
        for delay in [0].iter().chain(delays) {
            let number = move |count| random(count + address);
            boards.push(Box::new(beats(address, first + delay * 1000, 1_000_000, number)));
        }
    }
    let mut engine = listener(boards, Instant::from_micros(40_000_000));
    assert_eq!(confirmed(&mut engine), [], "{copies:?}");
    let repeated = engine.findings().iter();
    let repeated = repeated.filter(|it| it.key.kind == FindingKind::FramesRepeated);
    let open = repeated.filter(|it| it.state == FindingState::Suspected);
    let with_pairs = open.inspect(|finding| {
        for stored in &finding.evidence {
            let frame = stored.frame.unwrap();
            let is_same = |other: &&Evidence| other.frame.unwrap().same_on_wire(&frame);
            let count = finding.evidence.iter().filter(is_same).count();
            assert!(count >= 2, "{frame:?} without its original or copy: {finding:#?}");
        }
    });
    with_pairs.map(|it| it.text.clone()).collect()
}

#[test]
fn copies_of_one_bridge_are_one_finding() {
    assert_eq!(
        texts_of_repeated(&[(10, &[12]), (12, &[12]), (14, &[12]), (16, &[12]), (18, &[85])]),
        ["All frames arrive twice, 12 to 85 ms apart: repeated by a bridge?"],
        "one device waits longest"
    );
    let apart = texts_of_repeated(&[(10, &[3]), (12, &[3]), (14, &[200]), (16, &[200])]);
    let of =
        |address: u32, rest: &str| format!("Frames from address {address} arrive twice, {rest}");
    let (soon, late) = (
        "3 ms apart: sent twice, or repeated by a gateway?",
        "200 ms apart: two boards with equal random numbers, or repeated by a gateway?",
    );
    let mut found = apart;
    found.sort();
    assert_eq!(found, [of(10, soon), of(12, soon), of(14, late), of(16, late)]);
}

#[test]
fn frames_of_two_gateways_arrive_more_than_twice() {
    assert_eq!(
        texts_of_repeated(&[(10, &[3, 40]), (12, &[3, 40]), (14, &[3, 40])]),
        ["All frames arrive more than twice, 3 to 40 ms apart: repeated by a bridge?"]
    );
}

/// Copies explain neither a second UID nor that the finding is over.
#[test]
fn repeated_frames_do_not_replace_a_conflict_of_two_uids() {
    let second = |frame: Frame| {
        let mut data = [13_u8, 13, 13, 13, 13, 14, 4, 0];
        data[4] = 99;
        Frame::classic(frame.platform_id().unwrap(), &data).with_time(frame.time)
    };
    let mut boards: Vec<Box<dyn Iterator<Item = Frame>>> = Vec::new();
    for address in [12, 13] {
        for delay in [0, 4_000] {
            let first = u64::from(address) * 30_000 + delay;
            let number = move |count| random(count + address);
            boards.push(Box::new(beats(address, first, 1_000_000, number)));
        }
    }
    for delay in [0, 4_000] {
        let other = beats(13, 690_000 + delay, 1_000_000, |count| random(count + 77));
        boards.push(Box::new(other.skip(10).take(3).map(second)));
    }
    let engine = listener(boards, END);
    let found = finding(&engine, FindingKind::OneAddressTwoIdentities).unwrap();
    assert_eq!((found.state, found.superseded_by), (FindingState::Cleared, None), "{found:#?}");
}

#[test]
fn copies_nearly_half_a_period_late_are_no_conflict() {
    for delay in [440, 460, 480] {
        let texts = texts_of_repeated(&[(10, &[delay]), (12, &[delay]), (14, &[delay])]);
        let start = format!("All frames arrive twice, {delay} ms apart: two boards");
        assert!(texts.len() == 1 && texts[0].starts_with(&start), "{texts:?}");
    }
}

#[test]
fn late_copies_of_one_neighbour_doubt_a_constant_random_number() {
    for delay in [120_000, 200_000, 400_000] {
        let mut boards: Vec<Box<dyn Iterator<Item = Frame>>> = Vec::new();
        for late in [0, delay] {
            boards.push(Box::new(beats(12, 100_000 + late, 1_000_000, |_| 9)));
            boards.push(Box::new(beats(40, 650_000 + late, 1_000_000, random)));
        }
        let mut engine = listener(boards, END);
        assert_eq!(confirmed(&mut engine), [], "{delay} µs: {:#?}", engine.findings());
    }
}

#[test]
fn one_late_copy_is_not_named_for_good() {
    let mut boards: Vec<Box<dyn Iterator<Item = Frame>>> = Vec::new();
    for address in [12, 14] {
        let first = u64::from(address) * 5_000;
        let number = move |count| random(count + address);
        boards.push(Box::new(beats(address, first, 1_000_000, number)));
        let copies = beats(address, first, 1_000_000, number).enumerate();
        boards.push(Box::new(copies.map(move |(count, copy)| {
            let delay = if count == 9 && address == 12 { 130 } else { 12 };
            copy.with_time(copy.time + Duration::from_millis(delay))
        })));
    }
    let engine = listener(boards, END);
    let repeated = finding(&engine, FindingKind::FramesRepeated).unwrap();
    assert_eq!(repeated.text, "All frames arrive twice, 12 ms apart: repeated by a bridge?");
}
