//! Devices that are not what the plan takes them for, and addresses that others may have stored.

use super::line::{Line, Writes, address, device};
use descan::address_plan::RunState;
use descan::app::{DeviceCommand, FileIndex, FileReading, PlanTask};
use descan::sim::{DeviceAction, DeviceSpec, Fault};
use descan::time::{Duration, Instant};
use descan::wire::descriptor::AddressSetting;
use descan::wire::node::Uid;

/// descan on these devices, with this list, where the stored settings can be read or not.
fn bus(specs: Vec<DeviceSpec>, file: &str, writes: Writes, is_readable: bool) -> Line {
    let mut line = Line::of(specs, file.to_owned(), writes, writes.profile(is_readable), 3);
    line.is_checked = false;
    line
}

fn settled(name: &str, number: u8, uid: Uid) -> DeviceSpec {
    let mut spec = DeviceSpec::new(name).fixed(number).uid(uid);
    spec.skips_address_resolution = true;
    spec
}

fn change_file(line: &mut Line, file: &str) {
    file.clone_into(&mut line.file);
    let reading = FileReading::Content(Some(file.as_bytes().to_vec()));
    line.app.handle_file(line.sim.now(), FileIndex::default(), reading);
}

/// descan ends, and is started again.
fn start_again(line: &mut Line) {
    line.writing = None;
    line.app = Line::start(line.sim.now(), &line.file, &line.profile, 9);
}

fn stopped(line: &Line) -> String {
    match line.state() {
        Some(RunState::Stopped(cause)) => cause,
        other => panic!("{other:?}"),
    }
}

const N000_TO_20: &str = r#"[{"name":"N000","address":20,"static":true,"uid":"PLAN000"}]"#;

/// N000 does not send heartbeats yet, and is found by its name.
fn bus_with_late_heartbeat(file: &str) -> Line {
    let mut late = device(0, 10);
    late.faults.set(Fault::NoHeartbeat, true);
    let mut line = bus(vec![late, device(1, 12)], file, Writes::Now, true);
    line.plan(PlanTask::ToFile);
    let heard = line.app.buses()[0].device_at(address(10)).unwrap().uid;
    assert_eq!(heard, None, "its first heartbeat comes later");
    line
}

#[test]
fn device_is_not_written_before_its_listed_uid_is_heard() {
    let mut line = bus_with_late_heartbeat(N000_TO_20);
    assert!(line.plan_text().contains("N000 – 20: its UID was not heard"), "{}", line.plan_text());
    line.sim.apply(line.devices[0], DeviceAction::RemoveFault(Fault::NoHeartbeat));
    line.run(2.0, |_| false);
    line.plan(PlanTask::ToFile);
    assert!(line.plan_text().contains("N000 10 → 20"), "{}", line.plan_text());
}

#[test]
fn device_whose_uid_is_heard_during_its_step_is_the_same() {
    let mut line = bus_with_late_heartbeat(&N000_TO_20.replace(r#","uid":"PLAN000""#, ""));
    line.sim.apply(line.devices[0], DeviceAction::RemoveFault(Fault::NoHeartbeat));
    line.apply(|_| false);
    assert_eq!(line.state(), Some(RunState::Done), "{}", line.plan_text());
}

#[test]
fn nothing_is_written_before_three_heartbeats_of_all_are_heard() {
    let mut line = Line::new(&[10, 12], &[20, 12], Writes::Now, 3);
    line.run(1.0, Line::is_complete);
    line.plan(PlanTask::ToFile);
    line.apply(|line| !line.sent.is_empty());
    assert!(line.sent[0].time >= Instant::ZERO + Duration::from_secs(3), "{:?}", line.sent);
}

#[test]
fn board_with_another_uid_at_the_listed_address_is_named() {
    let file = r#"[{"name":"N000","address":10,"static":true,"uid":"PLAN007"}]"#;
    let mut line = bus(vec![device(0, 10), device(1, 12)], file, Writes::Now, true);
    line.plan(PlanTask::ToFile);
    let text = line.plan_text();
    assert!(text.contains("N000 – 10: at 10: not the name and UID listed"), "{text}");
}

#[test]
fn entry_with_an_impossible_uid_is_not_written() {
    for uid in ["plan-0", "425541524430", "PLAN00000000"] {
        let file = N000_TO_20.replace("PLAN000", uid);
        let mut line = bus(vec![device(0, 10), device(1, 12)], &file, Writes::Now, true);
        line.plan(PlanTask::ToFile);
        let text = line.plan_text();
        assert!(text.contains("N000 – 20: its entry has a mistake"), "{uid}: {text}");
    }
}

#[test]
fn boards_at_one_address_are_not_written() {
    // Two names; one name with two UIDs.
    let other_uid = device(7, 10).uid;
    for mut other in [device(7, 10), settled("N000", 10, other_uid)] {
        let mut first = device(0, 10);
        first.faults.set(Fault::KeepsAddress, true);
        other.faults.set(Fault::KeepsAddress, true);
        let file = N000_TO_20.replace(r#","uid":"PLAN000""#, "");
        let specs = vec![first, other, device(1, 12)];
        let mut line = bus(specs, &file, Writes::Now, false);
        line.devices.truncate(1);
        line.run(8.0, |_| false);
        line.app.prepare_plan(super::line::BUS, PlanTask::ToFile, false).unwrap();
        line.run(10.0, |line| !line.app.address_plan().unwrap().is_reading());
        assert!(line.plan_text().contains("N000 – 20: shares 10"), "{}", line.plan_text());
        line.apply(|_| false);
        assert_eq!(line.sent.len(), 0);
    }
}

#[test]
fn boards_with_one_uid_at_two_addresses_are_not_written() {
    let uid = device(0, 10).uid;
    let specs = vec![device(0, 10), settled("N000", 11, uid), device(1, 12)];
    let mut line = bus(specs, N000_TO_20, Writes::Now, false);
    line.run(12.0, |_| false);
    line.devices.truncate(1);
    // Whichever of them was heard last.
    for _ in 0..12 {
        line.run(0.3, |_| false);
        line.plan(PlanTask::ToFile);
        let text = line.plan_text();
        assert!(text.contains("N000 – 20: its UID is at "), "{text}");
    }
}

#[test]
fn device_that_takes_a_confirmed_address_stops_the_plan() {
    let mut line = Line::new(&[10, 12, 14], &[20, 22, 24], Writes::Now, 3);
    line.is_checked = false;
    line.plan(PlanTask::ToFile);
    line.apply(|line| line.app.address_plan().unwrap().run().unwrap().finished() == 1);
    line.sim.add_device(device(9, 20));
    line.run(30.0, |line| line.state() != Some(RunState::Running));
    let cause = stopped(&line);
    assert!(cause.contains("at 20, too") || cause.contains("conflict at 20"), "{cause}");
    assert!(line.sent.len() < 3, "{}", line.plan_text());
}

/// A device has a write stored that was not answered, and was switched off then.
fn unanswered_write(line: &mut Line) {
    line.plan(PlanTask::ToFile);
    line.apply(|line| !line.sent.is_empty());
    let stored = AddressSetting::Fixed(address(20));
    line.sim.apply(line.devices[0], DeviceAction::StoreAddress(stored));
    line.sim.apply(line.devices[0], DeviceAction::AddFault(Fault::NoDescriptor));
    line.sim.apply(line.devices[0], DeviceAction::PowerOff);
    assert!(line.run(30.0, |line| line.state() != Some(RunState::Running)));
    stopped(line);
}

#[test]
fn address_that_an_earlier_plan_may_have_stored_is_kept() {
    for writes in [Writes::Now, Writes::Restart] {
        let specs = vec![device(0, 10), device(1, 12), device(2, 14)];
        let mut line = bus(specs, N000_TO_20, writes, false);
        unanswered_write(&mut line);
        let absent = line.devices.remove(0);
        // Another session, with another list: of both, N000 may come back at 20.
        start_again(&mut line);
        let wants_20 = r#"[{"name":"N001","address":20,"static":true},
            {"name":"N002","address":24,"static":true}]"#;
        change_file(&mut line, wants_20);
        line.plan(PlanTask::ToFile);
        let held = "N001 – 20: 20 is used by N000 (absent)";
        assert!(line.plan_text().contains(held), "{}", line.plan_text());
        line.finish();
        // So it stays after a plan of others, and after that was taken back.
        let (name, record) = line.record();
        line.plan(PlanTask::TakeBack(Box::new(record), name));
        line.finish();
        start_again(&mut line);
        line.plan(PlanTask::ToFile);
        assert!(line.plan_text().contains(held), "{}", line.plan_text());
        // The user knows better.
        line.app.forget_absent_devices();
        line.plan(PlanTask::ToFile);
        assert!(line.plan_text().contains("N001 12 → 20"), "{}", line.plan_text());
        // It comes back: nothing is in doubt where its setting acts at once.
        line.sim.apply(absent, DeviceAction::PowerOn);
        line.run(10.0, |_| false);
        start_again(&mut line);
        line.plan(PlanTask::ToFile);
        assert!(
            line.plan_text().contains("N001 – 20: 20 is used by N000\n"),
            "{}",
            line.plan_text()
        );
    }
}

#[test]
fn address_of_a_board_whose_row_another_took_is_kept() {
    // Two with one name at 10; the later one is off, then the first one moves to 30.
    let file = r#"[{"name":"N001","address":10,"static":true}]"#;
    let (mut first, mut second) = (device(0, 10), settled("N000", 10, device(9, 10).uid));
    first.faults.set(Fault::KeepsAddress, true);
    second.faults.set(Fault::KeepsAddress, true);
    let mut line = bus(vec![first, device(1, 12)], file, Writes::Now, false);
    line.run(5.0, |_| false);
    let second = line.sim.add_device(second);
    line.run(10.0, |_| false);
    line.sim.apply(second, DeviceAction::PowerOff);
    line.run(2.5, |_| false);
    let first = line.devices[0];
    line.sim.apply(first, DeviceAction::Move(AddressSetting::Fixed(address(30))));
    line.run(20.0, |_| false);
    line.plan(PlanTask::ToFile);
    let text = line.plan_text();
    assert!(text.contains("N001 – 10: 10 is used by "), "{text}");
}

#[test]
fn address_of_an_absent_twin_without_a_uid_is_kept() {
    let blank = Uid([0; 6]);
    let specs = vec![settled("SENS", 10, blank), settled("SENS", 12, blank), device(1, 14)];
    let file = r#"[{"name":"SENS","address":10,"static":true}]"#;
    let mut line = bus(specs, file, Writes::Now, false);
    line.run(8.0, |_| false);
    let twin = line.devices.remove(0);
    line.sim.apply(twin, DeviceAction::PowerOff);
    line.run(10.0, |_| false);
    line.plan(PlanTask::ToFile);
    let text = line.plan_text();
    assert!(!text.contains("12 → 10"), "{text}");
}

#[test]
fn address_of_an_absent_device_of_the_last_plan_is_kept() {
    // N000 is locked: the plan stops before N001 moves, or after it.
    for (from, confirmed) in [([10, 12, 13], 0), ([12, 10, 13], 1)] {
        let specs = (0..3).map(|at| device(at, from[at])).collect();
        let file = r#"[{"name":"N000","address":11,"static":true},
            {"name":"N001","address":14,"static":true}]"#;
        let mut line = bus(specs, file, Writes::Now, false);
        line.sim.apply(line.devices[0], DeviceAction::AddFault(Fault::Locked));
        line.plan(PlanTask::ToFile);
        line.apply(|_| false);
        let run = line.app.address_plan().unwrap().run().unwrap();
        assert_eq!(run.finished(), confirmed, "{}", line.plan_text());
        let absent = line.devices.remove(1);
        line.sim.apply(absent, DeviceAction::PowerOff);
        start_again(&mut line);
        let at = if confirmed == 0 { 12 } else { 14 };
        change_file(&mut line, &format!(r#"[{{"name":"N002","address":{at},"static":true}}]"#));
        line.plan(PlanTask::ToFile);
        let held = format!("N002 – {at}: {at} is used by N001 (absent)");
        assert!(line.plan_text().contains(&held), "{}", line.plan_text());
    }
}

#[test]
fn pins_of_the_bus_leave_out_what_is_not_sure() {
    let mut first = device(0, 10);
    let mut second = settled("N000", 10, device(9, 10).uid);
    first.faults.set(Fault::KeepsAddress, true);
    second.faults.set(Fault::KeepsAddress, true);
    let file = r#"[{"name":"N000","address":5,"static":true},
        {"name":"N001","address":6,"static":true,"uid":"PLAN008"},
        {"name":"N002","address":7,"static":true},
        {"name":"N003","address":8,"static":true}]"#;
    let specs = vec![first, second, device(1, 12), device(2, 14)];
    let mut line = bus(specs, file, Writes::Now, false);
    line.run(12.0, |_| false);
    let (pins, left_out) = line.app.pins_of_bus(super::line::BUS);
    let pins: Vec<String> = pins.iter().map(ToString::to_string).collect();
    assert_eq!(pins, ["address of the entry N002: 7 → 14"]);
    let left_out: Vec<String> =
        left_out.iter().map(|(name, why)| format!("{name} {}", why.word())).collect();
    assert_eq!(left_out, ["N000 shared-address", "N001 another-device", "N003 not-present"]);
}

#[test]
fn setting_that_was_not_read_is_read_again_and_named() {
    let mut line = Line::new(&[10, 12], &[20, 12], Writes::Now, 3);
    line.sim.apply(line.devices[1], DeviceAction::AddFault(Fault::NoDescriptor));
    line.plan(PlanTask::ToFile);
    assert_eq!(line.app.address_plan().unwrap().unread(), [address(12)]);
    let reads = line
        .reads
        .iter()
        .filter(|frame| frame.platform_id().is_some_and(|id| (id >> 10) & 0x7F == 12));
    assert_eq!(reads.count(), 3);
}

#[test]
fn command_reaches_the_device_that_was_asked_for_or_none() {
    let mut line = bus(vec![device(0, 10), device(1, 12)], "[]", Writes::Now, true);
    line.run(5.0, |_| false);
    let id = line.app.buses()[0].device_at(address(10)).unwrap().id;
    let command = DeviceCommand::Address(AddressSetting::Fixed(address(30)));
    line.app.note_asked(id);
    line.sim.apply(line.devices[0], DeviceAction::PowerOff);
    line.run(0.5, |_| false);
    line.sim.add_device(settled("N000", 10, device(9, 10).uid));
    line.run(5.0, |_| false);
    let why = line.app.send_command(id, command).unwrap_err();
    assert!(why.contains("another device is at 10"), "{why}");
    // Asked again, it may be written.
    let id = line.app.buses()[0].device_at(address(10)).unwrap().id;
    line.run(10.0, |_| false);
    line.app.note_asked(id);
    assert_eq!(line.app.send_command(id, command), Ok(()));
    line.run(2.0, |_| false);
    assert_eq!(line.sent.len(), 1);
}

#[test]
fn command_to_a_shared_address_is_refused() {
    let mut first = device(0, 10);
    let mut second = settled("N000", 10, device(9, 10).uid);
    first.faults.set(Fault::KeepsAddress, true);
    second.faults.set(Fault::KeepsAddress, true);
    let mut line = bus(vec![first, second, device(1, 12)], "[]", Writes::Now, true);
    line.run(6.0, |_| false);
    let id = line.app.buses()[0].device_at(address(10)).unwrap().id;
    for command in [DeviceCommand::Address(AddressSetting::None), DeviceCommand::Restart] {
        let why = line.app.send_command(id, command).unwrap_err();
        assert_eq!(why, "another device is at 10, too");
    }
}
