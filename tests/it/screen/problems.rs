//! The page Problems and the evidence of a problem.

use super::snapshot;
use super::{one_line, problems};
use crate::common::harness::{BOILER, Stage};
use descan::app::{Effect, EvidenceItem, Mouse, MouseKind, Page};
use descan::discovery::Config;
use descan::frame::{BusIndex, CanId, Frame};
use descan::sim::Scenario;
use descan::status::{BusStatus, Link};
use descan::time::{Duration, Instant};

fn selected(stage: &Stage) -> String {
    stage.app.selected_problem().map_or_else(String::new, |problem| problem.title())
}

/// Sends so many non-platform frames at `time` that no others fit into the capture.
fn flood(stage: &mut Stage, time: Instant) {
    let frame = Frame::new(CanId::Standard(0x123), &[]).with_time(time);
    let count = 2 * stage.app.capture().capacity() as usize;
    stage.app.handle_frames(stage.app.now(), &vec![frame; count]);
}

#[test]
fn bus_problem_names_its_bus() {
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::new(125_000), None, config);
    stage.link(Link::Up);
    // A stuff error each millisecond, of at least 17 bits; a state change is not a frame.
    for millis in 0..1000 {
        let at = Instant::ZERO + Duration::from_millis(millis);
        let stuff = Frame::error(0x88, &[0, 0, 4, 0, 0, 0, 0, 0]).with_time(at);
        let passive = Frame::error(0x04, &[0, 4, 0, 0, 0, 0, 0, 96]).with_time(at);
        stage.app.handle_frames(at, &[stuff, passive]);
    }
    let screen = stage.wait_until(1.5).size(120, 24).screen();
    assert!(screen.contains("load ≈14%"), "{screen}");
    let status = BusStatus { link: Link::Up, bitrate: Some(125_000), ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    assert!(stage.screen().contains("load  14%"), "{}", stage.screen());
}

#[test]
fn problems_sorted_by_confidence() {
    let mut stage = Stage::boiler();
    stage.until(30.5).keys("4");
    assert_eq!(
        problems(&stage),
        [
            "confirmed static address taken @16",
            "confirmed wrong address @14",
            "confirmed missing @44",
            "suspected address conflict (same name) @14",
        ]
    );
    snapshot!("problems_suspected_120x40", stage.size(120, 40).keys("G"));
    for (size, status) in [((80, 24), "○ 1 missing  ⚠ 3  ? 1"), ((40, 10), "○ 1  ⚠ 3  ? 1")]
    {
        let screen = stage.size(size.0, size.1).screen();
        assert!(screen.contains(status), "{screen}");
    }
    assert!(stage.screen().contains(" 4 Problems ⚠3 ?1 "), "{}", stage.screen());
    stage.until(45.0);
    assert_eq!(problems(&stage)[0], "confirmed address conflict (same name) @14");
    stage.until(130.0);
    let last = problems(&stage).pop().unwrap();
    assert!(last.starts_with("cleared "), "{:?}", problems(&stage));
    snapshot!("problems_over_80x24", stage.size(80, 24).keys("G"));
}

#[test]
fn address_conflict_is_one_problem() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let findings = stage.app.findings().filter(|finding| finding.key.kind.is_conflict()).count();
    let problem = stage.app.selected_problem().unwrap();
    // Two responses to each request, before the heartbeats showed why.
    let superseded = problem.findings.iter().filter(|finding| finding.superseded_by.is_some());
    assert_eq!((findings, problem.findings.len(), superseded.count()), (3, 3, 1));
    let evidence = problem.evidence();
    assert!(evidence.is_sorted_by_key(|piece| piece.time));
    for finding in &problem.findings {
        for piece in &finding.evidence {
            let is_it = |own: &&EvidenceItem| own.time == piece.time && own.frame == piece.frame;
            let kept = evidence.iter().find(is_it).unwrap();
            assert!(kept.what.contains(&*piece.description), "{kept:?} is not {piece:?}");
        }
    }
    let counts = stage.app.counts();
    assert_eq!((counts.confirmed, counts.suspected), (4, 0));
    let screen = stage.size(80, 100).screen();
    for words in [
        "Two devices answer as ACT",
        "heartbeats alternate between",
        "same-name-same-address",
        "one-address-two-identities",
        "ACT→own DES name ACT",
        "051C0002#050141435400",
    ] {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
}

#[test]
fn bus_errors_of_an_address_join_its_problem() {
    use descan::sim::{DeviceSpec, Fault};
    let act = |label: &str, service: &str| {
        let mut device = DeviceSpec::new("ACT").label(label).fixed(101).skips_address_resolution();
        device.response_delay = (Duration::from_millis(2), Duration::from_millis(2));
        device.service(service, "1.0").fault(Fault::KeepsAddress)
    };
    let scenario = Scenario::with_many_devices(125_000, 10, 3)
        .with(act("one", "PUMP"))
        .with(act("other", "VALVE"));
    let mut stage = Stage::new(&scenario, None);
    stage.until(15.0).keys("4").size(80, 40);
    snapshot!("problems_errors", stage);
    snapshot!("evidence_errors", stage.keys("Enter").size(100, 30));
}

#[test]
fn muted_problem_is_not_counted_and_stays_muted() {
    let mut stage = Stage::boiler();
    stage.until(30.5).keys("4 G m");
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    assert!(stage.screen().contains("○ 1 missing  ⚠ 3  1 muted"), "{}", stage.screen());
    stage.effects.clear();
    stage.until(45.0);
    assert_eq!(problems(&stage)[3], "muted confirmed address conflict (same name) @14");
    assert_eq!(stage.app.counts().confirmed, 3);
    assert!(!stage.effects.contains(&Effect::Bell), "nobody wants to hear of it");
    snapshot!("problems_muted_80x24", stage);
    snapshot!("problems_muted_40x10", stage.size(40, 10));
    stage.size(80, 24).keys("1");
    assert!(
        stage.screen().contains("⚠  14A ACT       BOILER03 CONFLICT"),
        "the device says it all the same"
    );
    stage.keys("4 m");
    assert_eq!(stage.app.counts().confirmed, 4);
    assert_eq!(problems(&stage)[0], "confirmed address conflict (same name) @14");
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    stage.keys("1 m");
    assert_eq!(stage.app.counts().confirmed, 3, "elsewhere that of the alarm");
    assert!(problems(&stage)[3].starts_with("muted confirmed address conflict"));
    // Without a selection by the user, too, the key undoes its own effect.
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 m");
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    stage.keys("m");
    assert_eq!(stage.app.counts().confirmed, 4);
}

#[test]
fn problems_are_filtered_by_words_and_fields() {
    let mut stage = Stage::boiler();
    stage.until(30.5).keys("4");
    let mut filtered = |filter: &str| {
        stage.keys("/").text(filter).keys("Enter");
        let shown = problems(&stage).len();
        stage.keys("Esc");
        (shown, problems(&stage).len())
    };
    for (filter, shown) in [
        ("is:confirmed", 3),
        ("is:suspected", 1),
        ("is:cleared", 0),
        ("is:muted", 0),
        ("at:14", 2),
        ("at:1", 0),
        ("name:pump", 1),
        ("name:a", 3),
        ("bus:can0", 4),
        ("bus:can1", 0),
        ("kind:conflict", 1),
        ("kind:same-name", 1),
        ("kind:missing", 1),
        ("pump", 1),
        ("address", 3),
        ("text:address", 4),
        ("text:listed", 1),
        ("listed", 0),
        ("!is:confirmed", 1),
        ("at:14 is:confirmed", 1),
    ] {
        assert_eq!(filtered(filter), (shown, 4), "{filter}");
    }
    stage.keys("Home m /").text("is:muted").keys("Enter");
    assert_eq!(problems(&stage), ["muted confirmed static address taken @16"]);
    stage.keys("m");
    let screen = one_line(&stage.screen());
    assert!(screen.contains("no problem matches the filter; Esc switches it off"), "{screen}");
    // In the prompt, Esc goes back to the filter before.
    stage.keys("/").text("x");
    let screen = one_line(&stage.screen());
    assert!(screen.contains("no problem matches the filter "), "{screen}");
}

#[test]
fn problem_opens_its_frames_and_returns() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 f");
    snapshot!("evidence_80x24", stage);
    snapshot!("evidence_120x40", stage.size(120, 40));
    stage.size(80, 24).keys("j Enter");
    snapshot!("evidence_around", stage);
    let frame = stage.app.selected_frame().unwrap();
    assert_eq!(stage.app.piece_of(&frame).unwrap().what, "first response to one request");
    // To the next one among all frames: the list of evidence follows.
    stage.keys("j");
    let next = stage.app.selected_frame().unwrap();
    assert_ne!(next, frame);
    stage.keys("Enter");
    assert_eq!(stage.app.selected_frame(), Some(next));
    assert!(stage.app.evidence_alone().is_some());
    stage.keys("Esc");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    stage.keys("2");
    assert!(stage.screen().contains("following"), "the traffic is as it was before");
    assert!(!stage.screen().contains('◆'));
}

#[test]
fn frames_of_a_problem_without_evidence_are_those_of_its_device() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 Home");
    while !selected(&stage).contains("static address") {
        stage.keys("j");
    }
    assert!(stage.app.selected_problem().unwrap().evidence().is_empty());
    stage.keys("f");
    let shown = |stage: &Stage| {
        (stage.app.view().page, stage.app.page_filter(Page::Traffic).text().to_owned())
    };
    assert_eq!(shown(&stage), (Page::Traffic, "at:16".to_owned()), "{}", stage.screen());
    stage.keys("Backspace");
    assert_eq!(stage.app.view().page, Page::Problems);
    // Of a device that is missing there are none, even if another one is at its address.
    stage.keys("G f");
    assert_eq!(selected(&stage), "missing @44");
    assert_eq!(stage.app.view().page, Page::Devices);
    stage.write(&BOILER.replace("44", "20")).keys("4 G");
    assert_eq!(selected(&stage), "missing @20");
    stage.keys("f");
    assert_eq!(stage.app.view().page, Page::Devices, "{}", stage.screen());
}

#[test]
fn backspace_leaves_evidence_to_its_problem() {
    let page = |stage: &Stage| stage.app.view().page;
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("1 Home p");
    assert_eq!(page(&stage), Page::Problems);
    for open in ["f", "f Enter", "Enter Enter"] {
        stage.keys("4 Home").keys(open);
        assert_eq!(page(&stage), Page::Traffic, "{open}: {}", stage.screen());
        stage.keys("Backspace");
        assert_eq!(page(&stage), Page::Problems, "{open}: {}", stage.screen());
        stage.keys("Esc Esc");
    }
    // From there to the page before.
    stage.keys("Backspace");
    assert_eq!(page(&stage), Page::Devices, "{}", stage.screen());
}

#[test]
fn evidence_view_closes_like_other_views() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("2 v /").text("srv:des").keys("Enter 4 f");
    let shown = |stage: &Stage| stage.screen().contains("EVIDENCE");
    assert!(shown(&stage), "{}", stage.screen());
    assert!(!stage.screen().contains("/srv:des"), "no filter stands before evidence");
    stage.keys("Enter Esc");
    assert!(shown(&stage), "first back to the evidence alone");
    stage.keys("Tab Shift-Tab");
    assert!(!shown(&stage) && stage.screen().contains("COUNT"), "{}", stage.screen());
    stage.keys("4 f v v");
    assert!(!shown(&stage) && stage.screen().contains("following"), "{}", stage.screen());
    stage.keys("4 f /");
    assert!(!shown(&stage) && stage.screen().contains("filter: srv:des"), "{}", stage.screen());
}

#[test]
fn evidence_outlives_the_capture() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let evidence = stage.app.selected_problem().unwrap().findings[0].evidence[0].time;
    let later = stage.app.now() + Duration::from_secs(2);
    flood(&mut stage, later);
    let oldest = |stage: &Stage| stage.app.capture().get(0).is_some();
    assert!(!oldest(&stage), "it was before any evidence");
    // Frames within a second of evidence are kept.
    stage.keys("Enter Enter").size(80, 40);
    snapshot!("evidence_around_kept", stage);
    // They are bounded, too.
    stage.keys("Esc Esc Esc Esc");
    flood(&mut stage, evidence);
    stage.size(80, 24).keys("4 Home f");
    snapshot!("evidence_forgotten", stage);
    stage.keys("Enter");
    let screen = stage.screen();
    assert!(screen.contains("surrounding frames no longer in the capture"), "{screen}");
    // A problem opened before its frames left the capture stays open, too.
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4 f Home");
    let later = stage.app.now() + Duration::from_secs(10);
    flood(&mut stage, later);
    flood(&mut stage, evidence);
    stage.keys("Enter");
    assert!(stage.screen().contains("▸◇12:00:"), "{}", stage.screen());
}

#[test]
fn small_screen_shows_the_problem_before_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(40, 10).keys("4 Enter");
    snapshot!("problem_40x10", stage);
    snapshot!("evidence_40x10", stage.keys("f"));
    snapshot!("evidence_40x10_frame", stage.keys("Right"));
    stage.keys("Esc Enter");
    snapshot!("evidence_around_40x10", stage);
    stage.keys("Esc Esc");
    assert!(stage.screen().contains("B SPARE01"), "{}", stage.screen());
    stage.keys("Esc j j j Enter Enter");
    assert!(stage.screen().contains("▸○   44 PUMP"), "{}", stage.screen());
}

#[test]
fn key_jumps_between_device_and_problem() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("j j j");
    assert!(stage.screen().contains("→ 4 Problems (p)"), "{}", stage.screen());
    stage.keys("4 /").text("pump").keys("Enter 1 p");
    assert_eq!(stage.app.view().page, Page::Problems);
    assert_eq!(selected(&stage), "address conflict (same name) @14", "a filter does not hide it");
    stage.keys("G p");
    let name = |stage: &Stage| stage.app.selected_row().unwrap().name.clone().unwrap().to_string();
    assert_eq!((stage.app.view().page, name(&stage)), (Page::Devices, "PUMP".to_owned()));
    stage.keys("p");
    assert_eq!(selected(&stage), "missing @44", "also of what is not there");
    stage.keys("1 Home p");
    assert_eq!(selected(&stage), "address conflict (same name) @14", "that of the alarm");
    stage.keys("m 1 Home p");
    assert!(stage.screen().contains("no problem for this device"), "{}", stage.screen());
    stage.keys("4 m");
    stage.keys("3 /").text("is:suspected").keys("Enter k k p");
    assert_eq!(
        selected(&stage),
        "address conflict (same name) @14",
        "from a line of the timeline, too"
    );
    stage.keys("3 Esc");
    // Rows that the filter excludes are found all the same.
    stage.keys("1 Home");
    stage.keys("/").text("feed").keys("Enter 4 Home p");
    assert_eq!((stage.app.view().page, name(&stage)), (Page::Devices, "ACT".to_owned()));
}

#[test]
fn selection_follows_its_problem() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 G");
    assert_eq!(selected(&stage), "missing @44");
    stage.until(45.0);
    assert_eq!(selected(&stage), "missing @44");
    stage.keys("Home").write(&BOILER.replace("44", "45"));
    assert_eq!(selected(&stage), "address conflict (same name) @14");
    // Without a selection by the user, too: new rows above do not move the row being read.
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4");
    let first = selected(&stage);
    stage.until(45.0);
    assert_eq!(selected(&stage), first);
    assert_ne!(problems(&stage)[0], format!("confirmed {first}"));
    stage.keys("1").until(46.0).keys("4");
    assert_eq!(
        selected(&stage),
        "address conflict (same name) @14",
        "the page opens with the first"
    );
    // While a moment is shown, its problems are.
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("4 Space");
    let before = problems(&stage);
    stage.until(45.0);
    assert_eq!(problems(&stage), before);
    stage.keys("Space");
    assert_eq!(problems(&stage)[0], "confirmed address conflict (same name) @14");
}

#[test]
fn problems_work_by_mouse_and_russian_keys() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("4");
    let press = |stage: &mut Stage, column, row| {
        let mouse = Mouse { kind: MouseKind::Press, column, row };
        stage.app.handle_mouse(stage.app.now(), mouse);
    };
    press(&mut stage, 10, 8);
    assert_eq!(selected(&stage), "missing @44");
    stage.keys("ь");
    assert_eq!(stage.app.counts().confirmed, 3, "ь is m");
    stage.keys("з");
    assert_eq!(stage.app.view().page, Page::Devices, "з is p");
    stage.keys("4 Home f");
    press(&mut stage, 10, 7);
    let (place, _) = stage.app.evidence_alone().unwrap().selected().unwrap();
    assert_eq!(place, 2);
    let wheel = Mouse { kind: MouseKind::WheelDown, column: 10, row: 6 };
    stage.app.handle_mouse(stage.app.now(), wheel);
    let (place, _) = stage.app.evidence_alone().unwrap().selected().unwrap();
    assert_eq!(place, 5);
}

#[test]
fn problems_outside_the_screen_are_counted() {
    let entry = |number: u32| {
        format!(r#"{{"name":"GHOST{number}","address":{},"static":true}}"#, number + 60)
    };
    let file = format!("[{}]", (0..30).map(entry).collect::<Vec<_>>().join(","));
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(&file));
    stage.until(30.0).keys("4");
    for size in [(80, 24), (120, 40), (40, 12)] {
        let screen = stage.size(size.0, size.1).screen();
        let headings = screen.lines().find(|line| line.contains("PROBLEM ")).unwrap();
        let below = headings.split_once('↓').unwrap_or_else(|| panic!("{screen}")).1;
        let below: usize = below.trim().parse().unwrap();
        let shown =
            screen.lines().filter(|line| line.contains(" 12:00:") || line.contains("GHOST"));
        assert!(below + shown.count() >= stage.app.problems_shown().len(), "{screen}");
    }
}
