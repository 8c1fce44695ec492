//! The past of the buses: their state at any moment.

use crate::common::harness::{BOILER, Stage};
use crate::simulation::random_scenario::World;
use descan::app::{App, Buses, BusesReplay, Moment, StoryLine};
use descan::discovery::{Config, Device};
use descan::frame::{BusIndex, CanId, Frame};
use descan::sim::{DeviceAction, Fault, Scenario};
use descan::status::{BusState, BusStatus, Link};
use descan::time::{Duration, Instant};
use descan::wire::node::Uid;

/// Room for captured frames in which the worlds here need several snapshots.
const ROOM: usize = 16 << 20;

/// All that the buses have stored.
fn state(buses: &Buses) -> String {
    format!("{buses:?}")
}

/// Returns where two long texts differ.
fn difference(one: &str, other: &str) -> String {
    let at = one.bytes().zip(other.bytes()).take_while(|(one, other)| one == other).count();
    let part = |text: &str| {
        let bytes = &text.as_bytes()[at.saturating_sub(300)..(at + 80).min(text.len())];
        String::from_utf8_lossy(bytes).into_owned()
    };
    format!("…{}\n…{}", part(one), part(other))
}

fn replayed(app: &App, moment: Moment) -> Option<Buses> {
    let mut replay: BusesReplay = app.history().replay(app.capture(), moment)?;
    while !replay.run(app.history(), app.capture(), 1000) {}
    Some(replay.into_buses())
}

/// Tests that the state at random moments is that of the buses at these moments, with outages,
/// commands and lost frames between them.
#[test]
fn past_state_is_that_of_its_moment() {
    let first = std::env::var("FIRST").ok().and_then(|it| it.parse().ok()).unwrap_or(0);
    let count = std::env::var("SEEDS").ok().and_then(|it| it.parse().ok()).unwrap_or(12);
    for seed in first..first + count {
        let mut rng = fastrand::Rng::with_seed(seed);
        let world = World::new(seed);
        let config = world.inspectors[0].config.clone();
        let mut stage = Stage::with_room(&world.scenario, None, config, ROOM);
        let mut status = BusStatus {
            link: Link::Up,
            bitrate: Some(world.scenario.bitrate),
            ..BusStatus::default()
        };
        let (mut moments, mut time) = (Vec::new(), 0.0);
        while time < 30.0 {
            time += rng.f64() * 2.0;
            stage.until(time);
            let now = stage.app.now();
            match rng.u8(0..12) {
                0 => {
                    stage.keys("r");
                }
                1 => {
                    stage.keys("c");
                }
                2 => status.kernel_drops += 1,
                3 => status.link = if status.link == Link::Up { Link::Down } else { Link::Up },
                4 => status.state = BusState::BusOff,
                5 => status.state = BusState::ErrorActive,
                6 => stage.app.handle_stall(now - Duration::from_millis(300), now),
                7 => status.log_changes += 1,
                8 => {
                    status.link = if status.link == Link::Ended { Link::Up } else { Link::Ended };
                }
                _ => {}
            }
            stage.app.handle_bus(now, BusIndex(0), status.clone());
            let history = stage.app.history();
            moments.push((history.present(now), state(history)));
        }
        rng.shuffle(&mut moments);
        let (mut dropped, count) = (0, moments.len());
        for (moment, expected) in moments {
            let Some(past) = replayed(&stage.app, moment) else {
                let begin = stage.app.history().begin(stage.app.capture());
                assert!(moment.time < begin, "seed {seed}: {moment:?} is kept, from {begin:?}");
                dropped += 1;
                continue;
            };
            let past = state(&past);
            assert!(past == expected, "seed {seed}, {moment:?}:\n{}", difference(&past, &expected));
        }
        assert!(dropped < count / 2, "seed {seed}: {dropped} of {count} moments are not kept");
    }
}

/// Tests that the moments around evidence can be shown when the frames before and behind them are no
/// longer kept, and no other moments of that time.
#[test]
fn moments_around_evidence_outlive_the_other_frames() {
    let mut scenario = Scenario::with_many_devices(1_000_000, 60, 5);
    for (at, device) in scenario.devices.iter_mut().enumerate() {
        let service = 0x100 + at as u16;
        *device = device.clone().periodic_message(service, Duration::from_millis(20), 8);
    }
    for (at, on) in [(10, 4.0), (20, 9.0), (30, 9.5)] {
        let mut second = scenario.devices[at].clone().fault(Fault::KeepsAddress);
        scenario.devices[at] = second.clone();
        second.uid = Uid([9, 9, 9, 9, 9, at as u8]);
        second.power_on = Some(Duration::from_secs_f64(on));
        second.label = format!("second{at}");
        let off = Duration::from_secs_f64(on + 3.0);
        scenario = scenario.at(off, &second.label, DeviceAction::PowerOff);
        scenario.devices.push(second);
    }
    let config = Config { seed: 3, ..Config::default() };
    let mut stage = Stage::with_room(&scenario, None, config, 12 << 20);
    let mut moments = Vec::new();
    for step in 1..180 {
        stage.until(f64::from(step) * 0.1);
        let now = stage.app.now();
        let history = stage.app.history();
        moments.push((history.present(now), state(history)));
    }
    stage.until(180.0);
    let begin = stage.app.history().begin(stage.app.capture());
    assert!(begin.as_secs_f64() > 20.0, "kept from {begin}");
    let evidence: Vec<Instant> = stage
        .app
        .findings()
        .flat_map(|finding| finding.evidence.iter().map(|piece| piece.time))
        .collect();
    let (mut kept, mut lost) = (0, 0);
    for (moment, expected) in moments {
        let is_near = |near: u64| {
            let near = Duration::from_millis(near);
            evidence
                .iter()
                .any(|time| time.since(moment.time) <= near && moment.time.since(*time) <= near)
        };
        let Some(past) = replayed(&stage.app, moment) else {
            assert!(!is_near(900), "{moment:?} is near evidence");
            lost += 1;
            continue;
        };
        assert!(is_near(1_100), "{moment:?} is not near evidence");
        let past = state(&past);
        assert!(past == expected, "{moment:?}:\n{}", difference(&past, &expected));
        kept += 1;
    }
    assert!(kept > 20 && lost > 20, "{kept} moments are kept, {lost} are not");
    // Traffic says where frames are missing between those that are kept.
    let ranges: Vec<_> = stage.app.capture().ranges().collect();
    let gap = ranges.windows(2).find(|two| two[0].end < two[1].start).expect("a gap");
    let told = format!(" {} not kept before", gap[1].start - gap[0].end);
    stage.size(120, 36).keys("2 /").text("src:N001 heartbeat").keys("Enter");
    stage.until(181.0).keys("g g");
    assert_eq!(stage.screen().matches(&told).count(), 1, "{}", stage.screen());
}

/// The lines of a page that show the moment: without the state of the program, which names the moment,
/// the time bar, which has all of them, and the keys.
fn page(stage: &mut Stage, key: &str) -> String {
    let screen = stage.keys(key).screen();
    let lines: Vec<&str> = screen.lines().collect();
    lines[1..lines.len() - 2].join("\n")
}

/// Tests that each page shows a past moment as it was shown then.
#[test]
fn pages_of_a_past_moment_are_those_of_a_run_until_then() {
    let boiler = || {
        let config = Config { seed: 7, ..Config::default() };
        let file = Some(BOILER.as_bytes().to_vec());
        Stage::with_room(&Scenario::builtin("boiler").unwrap(), file, config, ROOM)
    };
    // Another program changes des.json meanwhile.
    let later = BOILER.replace("44", "45").replace("\"address\": 20", "\"address\": 40");
    let run = |until: f64| {
        let mut stage = boiler();
        stage.size(120, 30).until(until.min(31.0));
        if until > 31.0 {
            stage.write(&later).until(until);
        }
        // Without a zoom the axis of the lanes is that of the whole capture.
        stage.keys("3").keys(&"+ ".repeat(20)).keys(&"- ".repeat(7));
        stage
    };
    let mut past = run(48.0);
    for key in ["[", "[", "{", "{", "[", "{", "]", "<", "<", "<", "[", "[", "{"] {
        past.keys(key);
        let moment = past.app.past_moment().expect(key);
        let mut then = run(moment.time.as_secs_f64() + 1.5e-6);
        assert_eq!(then.app.capture().end(), moment.frames, "{key} {:?}", moment.time);
        then.keys("Space");
        // Of three pages all views.
        let keys =
            ["1", "v", "v", "h", "h v", "3", "3 v", "v", "v", "4", "5", "2", "2 v", "v", "v"];
        for number in keys {
            let (shown, expected) = (page(&mut past, number), page(&mut then, number));
            assert_eq!(shown, expected, "{key} {:?}", moment.time);
        }
    }
}

/// Tests that after a log was truncated or replaced nothing of the one before is present or missing,
/// and that its moments can still be shown.
#[test]
fn another_log_has_its_own_devices() {
    let stage_of = |scenario: &Scenario| {
        let config = Config { listen_only: true, ..Config::default() };
        Stage::with_room(scenario, None, config, ROOM)
    };
    let mut scenario = Scenario::builtin("boiler").unwrap();
    let mut second = scenario.devices[1].clone().fault(Fault::KeepsAddress);
    second.uid = Uid([9; 6]);
    second.label = "second".to_owned();
    scenario.devices[1] = scenario.devices[1].clone().fault(Fault::KeepsAddress);
    scenario.devices.push(second);
    let mut stage = stage_of(&scenario);
    stage.until(20.0);
    let begin = stage.app.now();
    let then = (stage.app.history().present(begin), state(stage.app.history()));
    let findings = |app: &App| app.findings().map(|it| it.text.clone()).collect::<Vec<_>>();
    assert!(!findings(&stage.app).is_empty(), "a conflict");

    // The other log has the first two devices alone, which start anew.
    let mut other = Scenario::builtin("boiler").unwrap();
    other.devices.truncate(2);
    let mut alone = stage_of(&other);
    let up = BusStatus { link: Link::Up, ..BusStatus::default() };
    alone.app.handle_bus(Instant::ZERO, BusIndex(0), up.clone());
    alone.until(20.0);
    let changed = BusStatus { log_changes: 1, note: Some("log replaced".into()), ..up };
    stage.app.handle_bus(begin, BusIndex(0), changed);
    assert!(stage.app.buses()[0].devices().is_empty());
    assert!(!stage.app.stories().iter().any(|story| {
        story.line(begin, |time| time.to_string()).is_some_and(|line| line.to.is_none())
    }));
    let frames: Vec<_> = alone.app.capture().frames_from(0).map(|(_, frame)| frame).collect();
    for frame in frames {
        let time = begin + frame.time.since(Instant::ZERO);
        stage.app.advance_to(time);
        stage.app.handle_frames(time, &[frame.with_time(time)]);
        while stage.app.poll_effect().is_some() {}
    }
    let devices = |app: &App| {
        let row = |it: &Device| format!("{:?} {:?} {:?}", it.address, it.presence, it.services);
        app.buses()[0].devices().iter().map(row).collect::<Vec<_>>()
    };
    assert_eq!(devices(&stage.app), devices(&alone.app));
    assert_eq!(findings(&stage.app), findings(&alone.app));
    let lines = |app: &App, from: Instant| {
        let now = app.now();
        let stories = app.stories().iter().filter(|story| story.begin() > from);
        let words = |line: StoryLine| line.what;
        let lines = stories.filter_map(|story| story.line(now, |it| it.to_string()).map(words));
        lines.collect::<Vec<_>>()
    };
    assert_eq!(lines(&stage.app, begin), lines(&alone.app, Instant::ZERO));
    let past = replayed(&stage.app, then.0).map(|buses| state(&buses));
    assert!(past == Some(then.1), "the state before");
}

#[test]
fn typed_moment_is_shown_or_refused() {
    let config = Config { seed: 7, ..Config::default() };
    let file = Some(BOILER.as_bytes().to_vec());
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&scenario, file, config, ROOM);
    stage.until(45.0);
    for (typed, seconds) in
        [("12:00:20", 20.0), ("+1.5", 21.5), ("-500ms", 21.0), ("100%", 45.0), ("#1", 0.0)]
    {
        stage.keys(":").text(typed).keys("Enter");
        let moment = stage.app.past_moment().expect(typed);
        let apart = moment.time.as_secs_f64() - seconds;
        assert!((0.0..0.5).contains(&apart), "{typed}: {:?}", moment.time);
        assert!(stage.screen().contains("FROZEN 12:00:"), "{}", stage.screen());
    }
    stage.keys(":").text("12:01:00");
    let screen = stage.size(100, 24).keys("Enter").screen();
    assert!(screen.contains("12:01:00: not kept; 12:00:00.000 to 12:00:45.000 is"), "{screen}");
    stage.keys("Ctrl-u").text("soon").keys("Enter");
    assert!(stage.screen().contains("soon: not a moment; use 13:51:20"), "{}", stage.screen());
    stage.keys("Esc Esc");
    assert!(stage.app.past_moment().is_none(), "Esc shows the present");
}

/// Tests that in a small capture every moment can be shown whose frames are there, and that frames and
/// states around the evidence of a conflict are shown long after.
#[test]
fn small_capture_shows_its_past_and_that_of_evidence() {
    let config = Config { seed: 7, ..Config::default() };
    let file = Some(BOILER.as_bytes().to_vec());
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with_room(&scenario, file, config, 1_000_000);
    stage.until(45.0).keys(":").text("12:00:03").keys("Enter");
    assert!(stage.app.past_moment().is_some(), "{}", stage.screen());
    stage.keys("Esc");
    let id = CanId::Extended(0x0714_0101);
    for number in 0..60_000 {
        let mut frame = Frame::new(id, &[0xDA, 0, 0x8C, 0x10, 0, 0, 0, 0]);
        frame.time = Instant::from_micros(45_001_000 + 500 * number);
        stage.app.advance_to(frame.time);
        stage.app.handle_frames(frame.time, &[frame]);
    }
    let since = stage.app.history().begin(stage.app.capture());
    assert!(since > Instant::ZERO + Duration::from_secs(50), "{since:?}");
    stage.keys("3 /").text("kind:conflict").keys("Enter Home f");
    assert!(stage.screen().contains("▸ 12:00:26.8"), "{}", stage.screen());
    stage.keys("3 Enter");
    let moment = stage.app.past_moment().expect("the moment of the evidence");
    assert!(moment.time < Instant::ZERO + Duration::from_secs(30), "{:?}", moment.time);
    // What lies between is not kept.
    stage.keys("Esc 3 Esc Home f");
    assert!(stage.screen().contains("frames no longer in the capture"), "{}", stage.screen());
}
