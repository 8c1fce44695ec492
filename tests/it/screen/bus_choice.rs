//! The list of buses over a running session.

use super::snapshot;
use crate::common::harness::{BOILER, Stage};
use descan::app::{App, AppOptions, BusOffer, BusSelection, Effect, OfferKind};
use descan::discovery::Config;
use descan::frame::BusIndex;
use descan::sim::Scenario;
use descan::status::{BusStatus, Link, Playback};
use descan::time::Instant;

fn offer(kind: OfferKind, argument: &str, facts: &str) -> BusOffer {
    BusOffer {
        kind,
        name: argument.rsplit(':').next().unwrap_or_default().to_owned(),
        facts: facts.to_owned(),
        argument: argument.to_owned(),
        command: None,
        is_unknown: false,
    }
}

fn offers() -> Vec<BusOffer> {
    let down = BusOffer {
        command: Some("sudo ip link set can1 up type can bitrate 125000".to_owned()),
        ..offer(OfferKind::Interface, "can1", "–      DOWN")
    };
    let unknown = BusOffer {
        is_unknown: true,
        ..offer(OfferKind::Adapter, "slcan:/dev/ttyUSB0", "unknown adapter, Enter asks")
    };
    vec![
        offer(OfferKind::Interface, "can0", "125k   active"),
        down,
        offer(OfferKind::Interface, "can2", "500k   active       412 f/s  FEED SENS @12"),
        offer(OfferKind::Adapter, "slcan:/dev/ttyACM0", "slcan  usb-CANable"),
        unknown,
        offer(OfferKind::Log, "file:/home/user/session.log", "2 MB  2026-11-20  17:20  /home/user"),
        offer(OfferKind::Simulated, "sim:boiler", "125k, 10 devices, a conflict after 28 s"),
    ]
}

/// A session on can0, with the list over it.
fn listed() -> Stage {
    let mut stage = Stage::boiler();
    stage.until(8.0).keys("B");
    assert_eq!(stage.effects.pop(), Some(Effect::ListBuses));
    stage.app.handle_offers(stage.app.now(), offers());
    stage
}

fn own_frames(stage: &Stage) -> u64 {
    stage.app.buses()[0].counters().sent
}

#[test]
fn list_over_a_session_shows_what_is_open_and_what_can_be() {
    let stage = listed();
    snapshot!("bus_choice_80x24", stage);
    assert!(stage.app.is_dirty(), "the offers are drawn");
}

#[test]
fn list_over_a_session_sends_nothing_and_receives() {
    let mut stage = listed();
    let (sent, frames) = (own_frames(&stage), stage.app.capture().end());
    stage.until(14.0);
    assert_eq!(own_frames(&stage), sent);
    assert!(stage.app.capture().end() > frames + 20);
    // A status of the bus does not end the pause.
    let status = BusStatus { link: Link::Up, rec: Some(3), ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    stage.until(18.0);
    assert_eq!(own_frames(&stage), sent);
    stage.keys("Esc").until(24.0);
    assert!(own_frames(&stage) > sent, "discovery goes on");
    assert!(stage.screen().contains("own 0"), "{}", stage.screen());
}

#[test]
fn list_over_a_session_keeps_the_alarm() {
    let mut stage = Stage::boiler();
    stage.until(40.0).keys("B");
    assert!(stage.screen().contains("⚠ Address 14: SPARE01 joined"), "{}", stage.screen());
}

/// The page without the first line, whose ages differ, and without events and time bar.
fn page(stage: &Stage) -> Vec<String> {
    stage.screen().lines().skip(1).take(18).map(str::to_owned).collect()
}

#[test]
fn moments_during_the_list_are_those_of_a_run_until_then() {
    let run = |until: f64| {
        let scenario = Scenario::builtin("boiler").unwrap();
        let config = Config { seed: 7, ..Config::default() };
        let file = Some(BOILER.as_bytes().to_vec());
        let mut stage = Stage::with_room(&scenario, file, config, 16 << 20);
        stage.until(until.min(6.0)).keys("B").until(until.min(12.0)).keys("Esc").until(until);
        stage
    };
    let mut past = run(20.0);
    for moment in ["12:00:08.500", "12:00:11", "12:00:14"] {
        past.keys(":").text(moment).keys("Enter");
        let at = past.app.past_moment().expect(moment);
        let mut then = run(at.time.as_secs_f64() + 1.5e-6);
        assert_eq!(then.app.capture().end(), at.frames, "{moment}");
        then.keys("Space");
        assert_eq!(page(&past), page(&then), "{moment}");
        past.keys("Space");
    }
}

#[test]
fn chosen_bus_is_added_beside_the_open_one() {
    let mut stage = listed();
    stage.keys("Home Enter");
    assert!(stage.screen().contains("can0 is open already"), "{}", stage.screen());
    stage.keys("Down Down Enter");
    let wanted = BusSelection { buses: vec!["can2".to_owned()], ..BusSelection::default() };
    assert_eq!(stage.effects.pop(), Some(Effect::OpenBuses(wanted)));
    assert!(stage.app.bus_choice().is_none());
    // As the shell does.
    let now = stage.app.now();
    stage.app.add_bus(now, "can2".to_owned(), Config::default());
    let status = BusStatus { link: Link::Up, bitrate: Some(500_000), ..BusStatus::default() };
    stage.app.handle_bus(now, BusIndex(1), status);
    stage.app.handle_opened(now, Ok(vec!["can2".to_owned()]));
    let screen = stage.screen();
    assert!(screen.contains("can2 500k") && screen.contains("opened can2"), "{screen}");
    stage.keys("3");
    assert!(stage.screen().contains("open"), "{}", stage.screen());
}

#[test]
fn open_log_is_marked_and_not_the_bus_it_was_recorded_on() {
    let mut stage = Stage::boiler();
    let options = AppOptions {
        buses: vec![("sim:boiler".to_owned(), Config::default())],
        logs: vec!["/home/user/session.log".into()],
        ..AppOptions::default()
    };
    stage.app = App::new(Instant::ZERO, options);
    let playback = Playback { speed: 1.0, ..Playback::default() };
    stage.app.handle_playback(Instant::ZERO, playback);
    stage.size(80, 24).keys("B");
    stage.app.handle_offers(stage.app.now(), offers());
    let screen = stage.screen();
    let row = |part: &str| screen.lines().find(|line| line.contains(part)).expect(&screen);
    assert!(row("session.").ends_with(" open"), "{screen}");
    assert!(!row("10 devices").contains(" open"), "{screen}");
    let screen = stage.keys("End Enter").screen();
    assert!(screen.contains("Close file:/home/user/session.log and drop its frames?"), "{screen}");
}

#[test]
fn replacing_asks_and_keeps_unsaved_edits() {
    let mut stage = listed();
    stage.keys("Home Down Down i Enter");
    assert!(stage.screen().contains("Close can0 and drop its frames? y n"), "{}", stage.screen());
    stage.keys("n Enter y");
    let buses = vec!["can2".to_owned()];
    let wanted = BusSelection { buses, replaces: true, ..BusSelection::default() };
    assert_eq!(stage.effects.pop(), Some(Effect::OpenBuses(wanted)));

    let mut stage = Stage::boiler();
    stage.refusal = Some("no space left".to_owned());
    stage.until(8.0).keys("e Ctrl-u 3 3 Enter B");
    stage.app.handle_offers(stage.app.now(), offers());
    let before = stage.effects.len();
    stage.keys("End Enter y");
    assert!(stage.screen().contains("edits are not saved"), "{}", stage.screen());
    assert_eq!(stage.effects.len(), before);
}

#[test]
fn unknown_adapter_is_opened_listen_only_after_a_question() {
    let mut stage = listed();
    stage.keys("/ u n k n o w n Enter Enter");
    let screen = stage.screen();
    assert!(screen.contains("Open /dev/ttyUSB0 as slcan, listen-only? y n"), "{screen}");
    stage.keys("y");
    let buses = vec!["slcan:/dev/ttyUSB0@500000".to_owned()];
    let wanted = BusSelection { buses, listen_only: true, ..BusSelection::default() };
    assert_eq!(stage.effects.pop(), Some(Effect::OpenBuses(wanted)));
}

#[test]
fn command_of_an_interface_that_is_down_is_copied() {
    let mut stage = listed();
    stage.keys("Home Down y");
    let command = "sudo ip link set can1 up type can bitrate 125000";
    assert_eq!(stage.effects.pop(), Some(Effect::Copy(command.to_owned())));
    stage.keys("Enter");
    assert!(stage.screen().contains("can1 is down; y copies the command"), "{}", stage.screen());
}

#[test]
fn list_of_buses_opens_only_in_the_present() {
    let mut stage = Stage::boiler();
    stage.until(8.0).keys("Space B");
    assert!(stage.app.bus_choice().is_none());
    assert!(stage.screen().contains("frozen: Space shows the present first"));
    stage.keys("Space B Ctrl-c");
    assert_eq!(stage.effects.pop(), Some(Effect::Quit), "Ctrl-c quits everywhere");
}

#[test]
fn list_of_buses_fits_every_size() {
    let mut stage = listed();
    for (columns, rows) in [(20, 4), (40, 10), (120, 36), (200, 45)] {
        stage.size(columns, rows).keys("End");
        let screen = stage.screen();
        assert!(screen.contains('▸'), "{columns}x{rows}\n{screen}");
    }
    let screen = stage.size(40, 24).screen();
    for (option, key) in [("listen only", "l"), ("ask no names", "n")] {
        assert!(screen.contains(&format!("[ ] {option} ({key})")), "{screen}");
    }
    assert!(screen.contains("socketcand:/…"), "{screen}");
}
