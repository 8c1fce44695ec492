//! The plan of addresses on the screen, in its states.

use super::{one_line, snapshot};
use crate::common::harness::Stage;
use descan::app::Effect;
use descan::discovery::Config;
use descan::sim::{DeviceAction, DeviceSpec, Fault, Scenario, Sim};
use descan::wire::node::Uid;
use descan::wire::profile::{Profile, UidProfile};

const FILE: &str = r#"{"devices":[
 {"name":"FEED","address":11,"static":true},
 {"name":"SENS","address":13,"static":true,"uid":"BOILER02"},
 {"name":"SENS","address":12,"static":true,"uid":"BOILER05"},
 {"name":"NEW","address":22,"static":true},
 {"name":"LAST","address":30,"static":true},
 {"name":"PSU","address":31,"static":true},
 {"name":"PUMP","address":44,"static":true}
]}
"#;

/// Devices that are not at their addresses, with a profile of this effect.
fn stage(effect: &str) -> Stage {
    stage_of(effect, None)
}

/// The same, where the last of them has a fault.
fn stage_of(effect: &str, fault: Option<Fault>) -> Stage {
    let profile = format!(
        "[descriptor]\naddr = 0x016\n[commands]\nreboot = 0x01A\n\
         [writes]\naddress = 0x016\neffect = \"{effect}\"\n"
    );
    let profile = Profile::parse(&profile).unwrap();
    let device = |name: &str, uid: &str, address| {
        let mut spec = DeviceSpec::new(name).label(name).fixed(address);
        let blank = Uid([0; 6]);
        let known = Uid::parse(uid, &UidProfile::default()).unwrap();
        spec = spec.uid(if uid.is_empty() { blank } else { known });
        spec.skips_address_resolution = true;
        spec
    };
    let devices = [
        device("FEED", "BOILER01", 10),
        device("SENS", "BOILER02", 12),
        device("SENS", "BOILER05", 13),
        device("NEW", "", 14),
        device("LAST", "BOILER09", 15),
        device("PSU", "BOILER10", 31),
    ];
    let mut devices = Vec::from(devices);
    if let Some(fault) = fault {
        devices[5].faults.set(fault, true);
    }
    let scenario = devices.into_iter().fold(Scenario::new(125_000), Scenario::with);
    let config = Config { profile: profile.clone().into(), seed: 7, ..Config::default() };
    let mut stage = Stage::with(&scenario, Some(FILE), config);
    stage.sim = Sim::with_profile(&scenario, 1, profile);
    stage.station = stage.sim.attach();
    stage.until(10.0);
    stage
}

#[test]
fn plan_is_shown_with_reasons_then_runs_to_its_end() {
    let mut stage = stage("now");
    stage.keys("P").until(10.02);
    assert!(stage.screen().contains("reading the settings"), "{}", stage.screen());
    stage.until(12.0);
    snapshot!("plan_80x24", stage);
    stage.keys("j j j");
    stage.size(120, 36);
    snapshot!("plan_120x36", stage);
    stage.size(40, 10);
    snapshot!("plan_40x10", stage);
    stage.size(80, 24).keys("Enter");
    snapshot!("plan_question_80x24", stage);
    stage.keys("y").until(13.0);
    snapshot!("plan_running_80x24", stage);
    stage.keys("Esc").until(14.0);
    let banner = stage.screen();
    assert!(
        banner.contains(" plan: step 1 of 6") && banner.contains("P shows the plan"),
        "{banner}"
    );
    stage.keys("P").until(40.0);
    snapshot!("plan_done_80x24", stage);
    let lines: Vec<&str> = stage.app.timeline().entries().map(|line| line.text.as_str()).collect();
    let steps: Vec<&&str> = lines.iter().filter(|line| line.starts_with("plan")).collect();
    assert_eq!(
        steps,
        [
            &"plan step 1 of 6, 10 → 11 (00002816#0B): confirmed",
            &"plan step 2 of 6, 14 → 22 (08003816#16): confirmed",
            &"plan step 3 of 6, 15 → 30 (00003C16#1E): confirmed",
            &"plan step 4 of 6, 12 → 127 (00003016#7F): confirmed",
            &"plan step 5 of 6, 13 → 12 (00003416#0C): confirmed",
            &"plan step 6 of 6, 127 → 13 (0001FC16#0D): confirmed",
            &"plan: all steps are confirmed",
        ]
    );
}

#[test]
fn setting_that_cannot_be_read_is_named() {
    let mut stage = stage_of("now", Some(Fault::NoDescriptor));
    // Asked up to three times.
    stage.keys("P").until(20.0);
    let screen = one_line(&stage.screen());
    assert!(screen.contains("not read: 31"), "{screen}");
    assert!(!screen.contains("reading the settings"), "{screen}");
}

#[test]
fn device_that_joins_during_the_question_is_asked_for_again() {
    let mut stage = stage("now");
    stage.keys("P").until(12.0).keys("Enter");
    let uid = Uid::parse("BOILER11", &UidProfile::default()).unwrap();
    let mut pump = DeviceSpec::new("PUMP").fixed(40).uid(uid);
    pump.skips_address_resolution = true;
    stage.sim.add_device(pump);
    stage.until(16.0).keys("y").until(18.0);
    let screen = stage.screen();
    assert!(screen.contains("the plan has changed: 7 steps, before 6"), "{screen}");
    assert!(screen.contains("PUMP"), "{screen}");
    assert!(!stage.effects.iter().any(|it| matches!(it, Effect::WritePlan { .. })));
    assert!(one_line(stage.keys("Enter").screen().as_str()).contains("Change 6 addresses"));
}

#[test]
fn shown_plan_follows_the_bus_until_it_is_started() {
    let mut stage = stage("now");
    stage.keys("P").until(12.0).keys("j j");
    let selected = |stage: &mut Stage| {
        let screen = stage.screen();
        screen.lines().find(|line| line.contains('▸')).map(str::to_owned).unwrap()
    };
    let before = selected(&mut stage);
    let uid = Uid::parse("BOILER11", &UidProfile::default()).unwrap();
    let mut pump = DeviceSpec::new("PUMP").fixed(9).uid(uid);
    pump.skips_address_resolution = true;
    stage.sim.add_device(pump);
    stage.until(16.0);
    assert!(stage.screen().contains("PUMP       BOILER11"), "{}", stage.screen());
    let name = |row: &str| row.split_whitespace().find(|it| it.len() > 2).map(str::to_owned);
    assert_eq!(name(&selected(&mut stage)), name(&before), "the same device is selected");
}

#[test]
fn last_plan_of_an_earlier_start_is_taken_back() {
    let mut stage = stage("now");
    stage.keys("P").until(12.0).keys("Enter y").until(40.0);
    let last = stage.last_plan.clone();
    let mut stage = self::stage("now");
    stage.last_plan = last;
    // The simulation is a new one: its devices are where they were before the plan.
    stage.keys("P").until(12.0).keys("u").until(14.0);
    let screen = stage.screen();
    assert!(screen.contains("the way back") && screen.contains("already there"), "{screen}");
}

#[test]
fn locked_device_stops_the_plan_and_what_is_left_goes_on() {
    let mut stage = stage("now");
    let last = stage.sim.device("LAST").unwrap();
    stage.sim.apply(last, DeviceAction::AddFault(Fault::Locked));
    stage.keys("P").until(12.0).keys("Enter y Esc").until(24.0);
    let banner = stage.screen();
    assert!(banner.contains("plan: stopped at step 3 of 6: step 3, LAST: refused"), "{banner}");
    stage.keys("P");
    snapshot!("plan_stopped_80x24", stage);
    stage.keys("Esc");
    assert!(!stage.screen().contains("stopped at step"), "it was seen");
    // Left out, the others go on; then all go back.
    stage.keys("P Enter").until(26.0).keys("k k k k Space");
    let screen = stage.screen();
    assert!(screen.contains("left out by you"), "{screen}");
    stage.keys("Enter y").until(45.0);
    assert!(stage.screen().contains("done"), "{}", stage.screen());
    stage.keys("u").until(47.0).keys("Enter y").until(80.0);
    let mut addresses: Vec<u8> = stage.app.buses()[0]
        .devices()
        .iter()
        .filter(|it| it.is_present() && !it.is_debug)
        .map(|it| it.address.number())
        .collect();
    addresses.sort_unstable();
    assert_eq!(addresses, [10, 12, 13, 14, 15, 31]);
}

#[test]
fn settings_that_act_later_wait_for_a_restart_of_all() {
    let mut stage = stage("restart");
    stage.keys("P").until(12.0);
    let screen = stage.screen();
    assert!(screen.contains("[ ] restart each"), "{screen}");
    stage.keys("Enter");
    let asked = "in force after a restart of all devices at once";
    assert!(one_line(&stage.screen()).contains(asked), "{}", stage.screen());
    stage.keys("y").until(20.0);
    snapshot!("plan_stored_80x24", stage);
    for device in stage.sim.devices() {
        stage.sim.apply(device, DeviceAction::Reboot { services: None });
    }
    stage.until(32.0);
    assert!(stage.screen().contains(" done "), "{}", stage.screen());
}

#[test]
fn order_and_settings_change_before_the_start_only() {
    let mut stage = stage("restart");
    stage.keys("P").until(12.0).keys("j J r x");
    let screen = stage.screen();
    let lines: Vec<&str> = screen.lines().collect();
    let place = |name: &str| lines.iter().position(|line| line.contains(name)).unwrap();
    assert!(place("LAST") < place("NEW") && place("FEED") < place("LAST"), "{screen}");
    assert!(screen.contains("[x] restart each") && screen.contains("[ ] fixed"), "{screen}");
    assert!(screen.contains("▸ 3   NEW"), "{screen}");
    // The steps of a cycle keep their order.
    stage.keys("j J");
    assert!(stage.screen().contains("the order follows from the addresses"), "{}", stage.screen());
    stage.keys("Enter y s").until(30.0);
    let screen = stage.screen();
    assert!(screen.contains("stopped: as you demanded"), "{screen}");
    assert!(screen.contains("preferred 31"), "{screen}");
    let written = stage.effects.iter().filter(|it| matches!(it, Effect::WritePlan { .. }));
    assert!(written.count() > 2);
}

#[test]
fn plan_names_what_it_needs() {
    let mut stage = Stage::boiler();
    stage.until(10.0).keys("P");
    let why = "plan: needs a profile with writes.address: no number is known for sure";
    assert!(stage.screen().contains(why), "{}", stage.screen());
    let mut stage = self::stage("now");
    stage.keys("Space P");
    assert!(stage.screen().contains("frozen: Space shows the present first"), "{}", stage.screen());
}
