//! Plans of addresses against simulated devices: at no moment two devices have one address, live or
//! stored, whatever is switched off in between.

mod line;
mod surprises;

use descan::address_plan::{PlanRecord, PlanStep, RunState, StepState};
use descan::app::{FileIndex, FileReading, PlanStart, PlanTask};
use descan::sim::{DeviceAction, DeviceSpec, Fault};
use descan::time::Instant;
use descan::wire::descriptor::AddressSetting;
use descan::wire::node::Uid;
use line::{Line, Writes, address, device};

/// So many different addresses at random, twice: the same ones in another order.
fn permutation(count: usize, seed: u64) -> (Vec<u8>, Vec<u8>) {
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut all: Vec<u8> = (1..128).collect();
    rng.shuffle(&mut all);
    all.truncate(count);
    let from = all.clone();
    rng.shuffle(&mut all);
    (from, all)
}

fn some(addresses: &[u8]) -> Vec<Option<u8>> {
    addresses.iter().copied().map(Some).collect()
}

/// Permutes devices; with a cut, of the power of all in the middle of a random step.
fn permute(count: usize, writes: Writes, is_cut: bool, seed: u64) {
    let (from, wanted) = permutation(count, seed);
    let mut line = Line::new(&from, &wanted, writes, seed);
    line.plan(PlanTask::ToFile);
    if is_cut {
        let mut rng = fastrand::Rng::with_seed(seed);
        let steps = line.app.address_plan().unwrap().plan().steps.len();
        let (step, within) = (rng.usize(..steps.max(1)), rng.f64() * 3.0);
        let is_at = |line: &Line| {
            let run = line.app.address_plan().unwrap().run().unwrap();
            run.current() >= step && run.sent_at(step).is_some()
        };
        line.apply(is_at);
        line.run(within, |_| false);
        line.cut_power(seed);
        let (name, record) = line.record();
        line.plan(PlanTask::Resume(Box::new(record), name));
    }
    let plan = line.app.address_plan().unwrap().plan();
    let text = || format!("seed {seed}, {writes:?}: {}", line.plan_text());
    assert!(!plan.leaves_out(), "{}", text());
    if !plan.steps.is_empty() {
        line.finish();
    }
    assert_eq!(line.addresses(), some(&wanted), "seed {seed}, {writes:?}");
    line.check();
}

#[test]
fn permuted_devices_never_meet() {
    std::thread::scope(|scope| {
        scope.spawn(|| permute(126, Writes::Now, false, 1));
        for writes in Writes::ALL {
            scope.spawn(move || (2..4).for_each(|seed| permute(24, writes, false, seed)));
        }
    });
}

#[test]
fn power_cut_at_any_step_ends_the_same() {
    std::thread::scope(|scope| {
        for writes in Writes::ALL {
            scope.spawn(move || (10..16).for_each(|seed| permute(12, writes, true, seed)));
        }
    });
}

/// More of the same: `PLAN_SEEDS=40 cargo test --test it -- --ignored wide_permutations`.
#[test]
#[ignore = "takes minutes"]
fn wide_permutations() {
    let seeds = std::env::var("PLAN_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(10);
    let first = std::env::var("PLAN_FIRST").ok().and_then(|text| text.parse().ok()).unwrap_or(100);
    for seed in first..first + seeds {
        for writes in Writes::ALL {
            permute(126, writes, seed % 2 == 0, seed);
            permute(1 + seed as usize % 30, writes, true, seed);
        }
    }
}

#[test]
fn cycle_of_127_devices_is_refused_and_nothing_is_sent() {
    let from: Vec<u8> = (1..128).collect();
    let mut wanted = from.clone();
    wanted.rotate_left(1);
    let mut line = Line::new(&from, &wanted, Writes::Now, 5);
    line.plan(PlanTask::ToFile);
    let plan = line.app.address_plan().unwrap().plan();
    assert!(plan.steps.is_empty());
    assert_eq!(plan.left_out.len(), 127);
    let why = plan.left_out[0].reason.to_string();
    assert_eq!(why, "a cycle, and no address is free");
    line.apply(|_| false);
    assert_eq!(line.state(), Some(RunState::Done));
    assert_eq!(line.sent.len(), 0);
    assert_eq!(line.addresses(), some(&from));
}

#[test]
fn locked_device_stops_the_plan_and_undo_brings_others_back() {
    let mut line = Line::new(&[10, 12, 13, 14], &[20, 13, 12, 24], Writes::Now, 3);
    let locked = line.sim.device("N003").unwrap();
    line.sim.apply(locked, DeviceAction::AddFault(Fault::Locked));
    line.plan(PlanTask::ToFile);
    line.apply(|_| false);
    let stopped = "step 2, N003: refused with an error response";
    assert_eq!(line.state(), Some(RunState::Stopped(stopped.to_owned())));
    let (name, record) = line.record();
    let states: Vec<&str> = record.steps.iter().map(|step| step.state.as_str()).collect();
    assert_eq!(states, ["confirmed", "failed", "pending", "pending", "pending"]);
    assert_eq!(record.steps[1].cause.as_deref(), Some("refused with an error response"));
    assert_eq!(record.stopped.as_deref(), Some(stopped));
    assert_eq!(line.addresses(), some(&[20, 12, 13, 14]));
    assert_eq!(line.sent.len(), 2, "nothing is repeated");
    // Unlocked, it goes on.
    line.sim.apply(locked, DeviceAction::RemoveFault(Fault::Locked));
    line.plan(PlanTask::Resume(Box::new(record), name));
    line.finish();
    assert_eq!(line.addresses(), some(&[20, 13, 12, 24]));
    // All go back to where they were before the first step.
    let (name, record) = line.record();
    assert!(record.is_done());
    line.plan(PlanTask::TakeBack(Box::new(record), name.clone()));
    line.finish();
    assert_eq!(line.addresses(), some(&[10, 12, 13, 14]));
    assert_eq!(line.record().1.source, format!("undo of {name}"));
}

#[test]
fn lost_response_of_a_device_that_moved_is_no_failure() {
    let mut line = Line::new(&[10, 12], &[20, 12], Writes::Now, 3);
    line.plan(PlanTask::ToFile);
    line.app.start_plan().unwrap();
    assert!(line.run(5.0, |line| !line.sent.is_empty()));
    // It has the write and is off before its response is heard.
    let mover = line.devices[0];
    line.sim.apply(mover, DeviceAction::StoreAddress(AddressSetting::Fixed(address(20))));
    line.sim.apply(mover, DeviceAction::Reboot { services: None });
    assert!(line.run(20.0, |line| line.state() != Some(RunState::Running)));
    assert_eq!(line.state(), Some(RunState::Done), "{}", line.plan_text());
}

#[test]
fn write_without_an_effect_is_told_with_what_was_heard() {
    let mut line = Line::new(&[10, 12], &[20, 12], Writes::Now, 3);
    line.plan(PlanTask::ToFile);
    let mute = line.devices[0];
    line.sim.apply(mute, DeviceAction::AddFault(Fault::NoDescriptor));
    line.apply(|_| false);
    let session = line.app.address_plan().unwrap();
    let cause = "not at 20 within 5 s: it did not respond, heard at 10";
    assert_eq!(session.step_state(0), StepState::Failed(cause.to_owned()));
    assert_eq!(line.sent.len(), 1);
    let told = line.app.timeline().entries().find(|line| line.text.contains("plan step")).unwrap();
    assert_eq!(told.text, format!("plan step 1 of 1, 10 → 20 (00002816#14): failed: {cause}"));
}

#[test]
fn device_that_takes_the_address_meanwhile_stops_the_plan() {
    let mut line = Line::new(&[10, 12], &[20, 13], Writes::Now, 3);
    line.is_checked = false;
    line.plan(PlanTask::ToFile);
    line.sim.add_device(device(9, 13));
    line.apply(|_| false);
    let session = line.app.address_plan().unwrap();
    assert_eq!(session.step_state(0), StepState::Confirmed);
    assert_eq!(session.step_state(1), StepState::Failed("13 is used by N009".to_owned()));
    assert_eq!(line.sent.len(), 1);
}

#[test]
fn device_that_joins_before_the_start_is_shown_first() {
    let mut line = Line::new(&[10, 12], &[20, 12, 30], Writes::Now, 3);
    line.plan(PlanTask::ToFile);
    let added = line.sim.add_device(device(2, 14));
    line.devices.push(added);
    line.run(5.0, |_| false);
    let change = "the plan has changed: 2 steps, before 1".to_owned();
    assert_eq!(line.app.start_plan(), Ok(PlanStart::Changed(change)));
    line.run(5.0, |_| false);
    assert_eq!((line.sent.len(), line.state()), (0, None));
    assert!(line.plan_text().contains("N002 14 → 30"), "{}", line.plan_text());
    line.finish();
    assert_eq!(line.addresses(), some(&[20, 12, 30]));
}

#[test]
fn device_unlike_its_entry_is_left_out() {
    for wrong in [r#""name":"N001","uid":"PLAN007""#, r#""name":"INTR","uid":"PLAN001""#] {
        let file = format!(
            r#"[{{"name":"N000","address":10,"static":true}},
            {{{wrong},"address":13,"static":true}}]"#
        );
        let specs = vec![device(0, 10), device(1, 12)];
        let profile = Writes::Now.profile(true);
        let mut line = Line::of(specs, file, Writes::Now, profile, 3);
        line.plan(PlanTask::ToFile);
        let plan = line.app.address_plan().unwrap().plan();
        assert!(plan.steps.is_empty(), "{}", line.plan_text());
        let words: Vec<&str> = plan.left_out.iter().map(|it| it.reason.word()).collect();
        assert!(words.contains(&"another-device"), "{wrong}: {}", line.plan_text());
    }
}

#[test]
fn address_of_a_lost_device_is_given_to_nobody() {
    let mut line = Line::new(&[10, 12], &[12], Writes::Now, 3);
    line.run(40.0, Line::is_complete);
    line.sim.apply(line.devices[1], DeviceAction::PowerOff);
    line.run(10.0, |_| false);
    line.plan(PlanTask::ToFile);
    let text = line.plan_text();
    assert!(text.contains("N000 – 12: 12 is used by N001 (absent)"), "{text}");
}

#[test]
fn only_device_of_a_bus_is_confirmed_after_its_move() {
    for writes in [Writes::Now, Writes::Restart] {
        let mut line = Line::new(&[10], &[20], writes, 3);
        line.plan(PlanTask::ToFile);
        line.finish();
        assert_eq!(line.addresses(), some(&[20]));
    }
}

#[test]
fn failed_write_of_an_earlier_run_stays_known() {
    let mut line = Line::new(&[10, 12], &[20, 13], Writes::Now, 3);
    line.plan(PlanTask::ToFile);
    line.sim.apply(line.devices[1], DeviceAction::AddFault(Fault::Locked));
    line.apply(|_| false);
    let (name, record) = line.record();
    line.sim.apply(line.devices[1], DeviceAction::PowerOff);
    line.run(10.0, |_| false);
    line.plan(PlanTask::Resume(Box::new(record), name));
    line.apply(|_| false);
    let (_, record) = line.record();
    let at = record.devices.iter().position(|it| it.to == 13).unwrap();
    assert_eq!(record.possible_addresses(at), [address(12), address(13)], "{record:?}");
}

#[test]
fn devices_without_a_uid_are_moved_by_their_addresses() {
    for is_readable in [true, false] {
        let specs = [10, 12, 13].into_iter().map(|number| {
            let mut spec = DeviceSpec::new("SENS").fixed(number).uid(Uid([0; 6]));
            spec.skips_address_resolution = true;
            spec
        });
        let file = r#"[{"name":"SENS","address":10,"static":true},
            {"name":"SENS","address":12,"static":true},
            {"name":"SENS","address":13,"static":true}]"#;
        let profile = Writes::Now.profile(is_readable);
        let mut line = Line::of(specs.collect(), file.to_owned(), Writes::Now, profile, 3);
        line.plan(PlanTask::ToFile);
        assert!(line.app.address_plan().unwrap().plan().steps.is_empty());
        // One of them, by its name, where the others are in their places.
        let moved = file.replace("13", "30");
        line.app.handle_file(
            line.sim.now(),
            FileIndex::default(),
            FileReading::Content(Some(moved.into_bytes())),
        );
        line.plan(PlanTask::ToFile);
        let plan = line.app.address_plan().unwrap().plan();
        let why: Vec<String> = plan.steps.iter().map(PlanStep::why).collect();
        assert_eq!(why, ["no UID: by its address"], "{}", line.plan_text());
        line.finish();
        assert_eq!(line.addresses(), some(&[10, 12, 30]));
    }
}

#[test]
fn unread_settings_are_known_from_the_file() {
    let (from, wanted) = permutation(6, 8);
    let mut line = Line::new(&from, &wanted, Writes::Later, 8);
    line.profile = Writes::Later.profile(false);
    line.app = Line::start(Instant::ZERO, &line.file, &line.profile, 8);
    line.plan(PlanTask::ToFile);
    line.apply(|line| line.app.address_plan().unwrap().run().unwrap().finished() == 3);
    // descan ends, the devices go on.
    let (name, record) = line.record();
    line.writing = None;
    line.app = Line::start(line.sim.now(), &line.file, &line.profile, 9);
    line.plan(PlanTask::Resume(Box::new(record), name));
    let plan = line.app.address_plan().unwrap().plan();
    let left = plan.left_out.iter().map(|it| it.reason.to_string());
    let left: Vec<String> = left.collect();
    assert!(!left.is_empty() && left.iter().all(|why| why.starts_with("stored: ")), "{left:?}");
    line.finish();
    // Those that the second plan left to the restart may still be on their way.
    line.run(5.0, |_| false);
    assert_eq!(line.addresses(), some(&wanted));
}

#[test]
fn file_of_a_plan_is_checked() {
    let mut line = Line::new(&[10, 12], &[20, 12], Writes::Now, 3);
    line.plan(PlanTask::ToFile);
    line.finish();
    let (_, bytes) = line.disk.clone().unwrap();
    let text = String::from_utf8(bytes).unwrap();
    let parse = |text: &str| PlanRecord::parse(text.as_bytes());
    assert_eq!(parse(&text).unwrap(), line.record().1);
    for (from, to, why) in [
        ("{", "[", "not a plan of descan: line 2, column"),
        ("\"version\": 1", "\"version\": 2", "format 2 is not known: 1 is"),
        ("\"to\": 20", "\"to\": 128", "128 is not an address: 1 to 127"),
        ("\"to\": 20", "\"to\": 0", "0 is not an address: 1 to 127"),
        ("\"device\": 0", "\"device\": 7", "a step of an unknown device"),
        ("\"name_hex\": \"", "\"name_hex\": \"é", ""),
    ] {
        let wrong = parse(&text.replacen(from, to, 1));
        assert!(why.is_empty() || wrong.unwrap_err().starts_with(why), "{from} → {to}");
    }
    let nobody = text
        .replace("uid_hex\": \"", "uid_hex\": \"x")
        .replace("name_hex\": \"", "name_hex\": \"x");
    assert_eq!(parse(&nobody).unwrap_err(), "device 1 has neither UID nor name");
    assert!(PlanRecord::parse(&vec![b' '; 2 << 20]).is_err());
}
