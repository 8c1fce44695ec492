//! The values of the profile on the screen: what the frames show, and taking it over.

use super::snapshot;
use crate::common::harness::Stage;
use descan::app::{Effect, Mouse, MouseKind};
use descan::sim::{DeviceAction, DeviceSpec, Scenario, Sim};
use descan::time::Duration;
use descan::wire::descriptor::AddressSetting;
use descan::wire::id::Address;
use descan::wire::node::{Mode, Uid};
use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};

/// A profile unlike the built-in one.
fn other_profile() -> Profile {
    let mut profile = Profile::default();
    profile.services.heartbeat = 0x155;
    profile.services.des = 0x222;
    profile.heartbeat.period_ms = 500;
    profile.heartbeat.mode_offset = Some(0);
    profile.heartbeat.uid_offset = Some(1);
    profile
}

/// Four devices that use another profile than the built-in one; no tool asks for their names.
fn unlike_the_profile() -> Stage {
    let mut scenario = Scenario::new(250_000);
    for (at, name) in ["FEED", "SENS", "ACT", "PSU"].into_iter().enumerate() {
        let uid = Uid::parse(&format!("LINE00{at}"), &Profile::default().uid).unwrap();
        let address = Address::from_bits(10 + at as u8);
        let device =
            DeviceSpec::new(name).label(name).uid(uid).address(AddressSetting::Preferred(address));
        scenario = scenario.with(device.service("DES", "1.0"));
    }
    let scenario = scenario.at(Duration::from_secs(6), "ACT", DeviceAction::Mode(Mode::Ufunc)).at(
        Duration::from_secs(8),
        "ACT",
        DeviceAction::Mode(Mode::Work),
    );
    let mut stage = Stage::new(&scenario, None);
    stage.sim = Sim::with_profile(&scenario, 1, other_profile());
    stage.station = stage.sim.attach();
    stage
}

fn banner(stage: &Stage) -> Option<String> {
    let screen = stage.screen();
    screen.lines().find(|line| line.starts_with(" ≠ the frames show")).map(str::to_owned)
}

#[test]
fn values_unlike_the_profile_are_announced_and_taken_over() {
    let mut stage = unlike_the_profile();
    stage.until(6.0);
    assert_eq!(banner(&stage), None, "too early");
    stage.until(14.0);
    let line = banner(&stage).expect("a line about it");
    assert!(line.contains("services.heartbeat 0x155, not 0x001"), "{line}");
    let named = |stage: &Stage| stage.app.buses()[0].devices().iter().any(|it| it.name.is_some());
    assert!(!named(&stage));
    let row = stage.screen().lines().position(|it| it.starts_with(" ≠ the frames show")).unwrap();
    let click = Mouse { kind: MouseKind::Press, column: 5, row: row as u16 };
    stage.app.handle_mouse(stage.app.now(), click);
    assert!(stage.screen().contains("KEY "), "a click opens the list: {}", stage.screen());
    stage.keys("Esc L");
    snapshot!("profile_80x24", stage);
    // Nothing is in force before Enter, and a path.
    stage.keys("Esc");
    assert_eq!(stage.app.buses()[0].config().profile.services.heartbeat, 0x001);
    stage.keys("L Enter");
    let prompt = stage.screen();
    assert!(prompt.contains("use the values, and save them to: learned.toml"), "{prompt}");
    assert_eq!(stage.app.buses()[0].config().profile.services.heartbeat, 0x001);
    stage.keys("Ctrl-u Enter");
    let profile = stage.app.buses()[0].config().profile.clone();
    assert_eq!(profile.services.heartbeat, 0x155);
    assert_eq!(profile.heartbeat, other_profile().heartbeat);
    for key in [ProfileKey::Heartbeat, ProfileKey::PeriodMs, ProfileKey::UidOffset] {
        assert_eq!(profile.origin(key), ValueOrigin::Learnt, "{}", key.name());
    }
    assert_eq!(profile.origin(ProfileKey::Des), ValueOrigin::Assumed, "no request was heard");
    assert_eq!(banner(&stage), None);
    stage.until(16.0).size(120, 36);
    let uids = stage.screen();
    assert!(uids.contains("LINE000") && uids.contains("LINE003"), "{uids}");
    assert!(uids.contains("≈ assumed"), "DES is still assumed: {uids}");
}

#[test]
fn learnt_values_are_saved_before_they_are_in_force() {
    let mut stage = unlike_the_profile();
    stage.until(14.0).keys("L Enter");
    stage.effects.clear();
    stage.keys("Enter");
    stage.drain(stage.app.now());
    let Some(Effect::WriteFile { path, bytes }) = stage.effects.last().cloned() else {
        panic!("{:?}", stage.effects)
    };
    assert_eq!(path.to_str(), Some("learned.toml"));
    let text = String::from_utf8(bytes).unwrap();
    let written = Profile::parse(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
    assert_eq!((written.services.heartbeat, written.heartbeat.period_ms), (0x155, 500), "{text}");
    let heartbeat = |stage: &Stage| stage.app.buses()[0].config().profile.services.heartbeat;
    assert_eq!(heartbeat(&stage), 0x001, "not before it is written");
    let now = stage.app.now();
    let exists = Err(descan::diagnostic::Diagnostic::new("file already exists"));
    stage.app.handle_written(now, &path, exists);
    assert_eq!(heartbeat(&stage), 0x001);
    assert!(stage.screen().contains("file already exists"), "{}", stage.screen());
    stage.keys("Ctrl-u").text("line.toml").keys("Enter");
    stage.app.handle_written(now, "line.toml".as_ref(), Ok(()));
    assert_eq!(heartbeat(&stage), 0x155);
    assert!(stage.screen().contains("--profile line.toml"), "{}", stage.screen());
}

#[test]
fn value_without_a_tick_is_not_taken_over() {
    let mut stage = unlike_the_profile();
    stage.until(14.0).keys("L j Space");
    assert!(stage.screen().contains("▸[ ] heartbeat.period_ms"), "{}", stage.screen());
    stage.keys("Enter Ctrl-u Enter");
    let profile = stage.app.buses()[0].config().profile.clone();
    assert_eq!((profile.services.heartbeat, profile.heartbeat.period_ms), (0x155, 1000));
    stage.until(18.0);
    let line = banner(&stage).expect("the period still differs");
    assert!(line.contains("heartbeat.period_ms 500, not 1000"), "{line}");
    stage.keys("L n");
    assert_eq!(banner(&stage), None);
    stage.until(22.0);
    assert_eq!(banner(&stage), None, "not again");
}

#[test]
fn frames_behind_a_value_are_those_of_its_service() {
    let mut stage = unlike_the_profile();
    stage.until(14.0).keys("L f").size(120, 36);
    let screen = stage.screen();
    assert!(screen.contains("/srv:0x155"), "{screen}");
    stage.keys("Backspace L j j j j j j j j Space");
    let screen = stage.screen();
    assert!(screen.contains("request_err is not known from frames"), "{screen}");
}

#[test]
fn devices_like_the_profile_are_not_announced() {
    let mut stage = Stage::boiler();
    stage.until(40.0);
    assert_eq!(banner(&stage), None);
    stage.size(120, 36).keys("L");
    snapshot!("profile_120x36", stage);
}
