//! Bus states on the status lines and pages.

use super::{one_line, snapshot};
use crate::common::harness::{BOILER, Stage};
use descan::app::{Effect, FileIndex, FileReading};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::sim::Scenario;
use descan::status::{
    BusState, BusStatus, Link, Playback, PlaybackCommand, RateSearch, RecordingStatus,
};
use descan::time::{Duration, Instant};

/// Returns the app after some seconds on a bus that carries only this frame, 100 f/s.
fn hearing_only(frame: Frame) -> Stage {
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    for millis in 1..4500 {
        let now = Instant::from_micros(millis * 1000);
        if millis % 10 == 0 {
            stage.app.handle_frames(now, &[frame.with_time(now)]);
        }
        stage.pass(now);
        stage.drain(now);
    }
    stage
}

#[test]
fn ended_log_shows_its_final_state() {
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), Some(BOILER), config);
    stage.until(24.0).link(Link::Ended).wait_until(24.5);
    stage.app.handle_file(
        stage.app.now(),
        FileIndex::default(),
        FileReading::Content(stage.file.clone()),
    );
    let before = stage.screen();
    assert!(before.contains("end of log") && before.contains("9 present"), "{before}");
    stage.wait_until(600.0).app.handle_resize(80, 24);
    assert_eq!(stage.screen(), before);
    // A much later edit of the file changes no device either.
    let at = Instant::ZERO + Duration::from_secs_f64(600.0);
    stage.app.handle_file(at, FileIndex::default(), FileReading::Content(Some(b"[]".to_vec())));
    let screen = stage.screen();
    assert!(screen.contains("9 present") && screen.contains("online since 12:00:00"), "{screen}");
    assert_eq!(stage.app.poll_timeout(), None, "nothing is due any more");
}

#[test]
fn missing_bus_reports_no_ack_error() {
    for link in [Link::Missing, Link::Down, Link::NoKernel] {
        let config = Config { seed: 7, has_loopback: true, ..Config::default() };
        let mut stage = Stage::with(&Scenario::builtin("boiler").unwrap(), None, config);
        stage.link(link).wait_until(20.0).keys("3");
        let screen = stage.screen();
        assert!(!screen.contains("no ACK"), "{screen}");
        assert!(!screen.contains("using address"), "{screen}");
        stage.link(Link::Up).wait_until(40.0).keys("3");
        let screen = stage.screen();
        assert!(screen.contains("using address 0"), "{screen}");
        assert!(screen.contains("no ACK on the bus"), "{screen}");
    }
}

#[test]
fn unreachable_bus_is_not_reported_free_of_problems() {
    let mut stage = Stage::boiler();
    let status = BusStatus {
        link: Link::Down,
        fault: Some(
            Diagnostic::new("can0 is down")
                .with_remedy("sudo ip link set can0 up type can bitrate 125000"),
        ),
        ..BusStatus::default()
    };
    stage.app.handle_file(stage.app.now(), FileIndex::default(), FileReading::Content(None));
    stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
    for (page, says) in [("1", "no device: no bus is up"), ("4", "no problems so far")] {
        let screen = stage.keys(page).screen();
        assert!(screen.contains(says), "{screen}");
        assert!(!screen.contains("no problems found"), "{screen}");
        // The remedy, on several lines if one is too short.
        let words = screen.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>();
        assert!(words.join(" ").contains("can bitrate 125000"), "{screen}");
    }
    stage.link(Link::Up);
    let screen = stage.keys("4").screen();
    assert!(screen.contains("no problems found"), "{screen}");
}

#[test]
fn foreign_bus_is_named_on_devices_and_problems() {
    let frame = Frame::new(descan::frame::CanId::Standard(0x181), &[1; 8]);
    let mut stage = hearing_only(frame);
    for page in ["1", "4"] {
        let screen = one_line(&stage.keys(page).screen());
        assert!(screen.contains("this bus does not speak DES"), "{screen}");
        assert!(!screen.contains("no problems found"), "{screen}");
    }
}

#[test]
fn frames_of_a_foreign_bus_are_not_decoded() {
    // NMEA 2000.
    let frame = Frame::classic(0x0DF1_1317, &[1; 8]);
    let mut stage = hearing_only(frame);
    let screen = stage.keys("2").screen();
    assert!(screen.contains("0DF11317"), "{screen}");
    assert!(screen.contains("another prot"), "{screen}");
    let mut rows = screen.lines().filter(|line| line.contains("0DF11317"));
    assert!(rows.all(|row| !row.contains('→')), "{screen}");
    let screen = stage.keys("v v").screen();
    assert!(screen.contains("no calls: the bus speaks another protocol"), "{screen}");
}

#[test]
fn renamed_interface_and_lost_frames_are_shown() {
    let mut stage = Stage::boiler();
    let status = BusStatus {
        link: Link::Up,
        renamed: Some("front".to_owned()),
        kernel_drops: 9,
        queue_drops: 3,
        receive_buffer: Some(425_984),
        note: Some("there is\u{1b}more to know".to_owned()),
        ..BusStatus::default()
    };
    stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
    let screen = stage.screen();
    assert!(screen.contains("can0 (now front)") && screen.contains("lost 12"), "{screen}");
    let screen = stage.size(120, 60).screen();
    assert!(screen.contains("lost 12 (9 kernel, 3 queue)"), "{screen}");
    let screen = stage.size(120, 200).keys("?").screen();
    assert!(screen.contains("receive buffer 425 kB, about 532 frames"), "{screen}");
    assert!(screen.contains("there is\\x1Bmore to know"), "{screen}");
}

#[test]
fn unreadable_data_is_one_timeline_line() {
    let mut stage = Stage::boiler();
    for unreadable in [0, 3, 4, 700] {
        let note = (unreadable > 0).then(|| "adapter: V1013".to_owned());
        let status = BusStatus { link: Link::Up, unreadable, note, ..BusStatus::default() };
        stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    }
    let screen = stage.keys("3").screen();
    assert_eq!(screen.matches("unreadable data received").count(), 1, "{screen}");
    assert_eq!(screen.matches("adapter: V1013").count(), 1, "{screen}");
}

#[test]
fn playback_keys_work_on_logs_only() {
    let mut stage = Stage::boiler();
    stage.until(24.0).keys("P");
    assert!(stage.screen().contains("plan: needs a profile with"), "{}", stage.screen());
    let mut playback =
        Playback { speed: 1.0, is_paused: false, is_ended: false, ..Playback::default() };
    let now = stage.app.now();
    stage.app.handle_playback(now, playback);
    stage.effects.clear();
    let asked = [
        PlaybackCommand::Pause,
        PlaybackCommand::Step,
        PlaybackCommand::Slower,
        PlaybackCommand::Faster,
    ];
    stage.keys("P > ( )");
    assert_eq!(stage.effects, asked.map(Effect::Playback));
    (playback.speed, playback.is_paused) = (0.5, true);
    stage.app.handle_playback(now, playback);
    assert!(stage.screen().contains("PAUSED 0:24 ×1/2"), "{}", stage.screen());
    // While playback is paused, the result of a step is drawn at once.
    stage.app.take_dirty();
    let heartbeat = Frame::classic(0x07B4_3C01, &[0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x12, 4, 0]);
    stage.app.handle_frames(now, &[heartbeat.with_time(now)]);
    stage.app.handle_timeout(now);
    assert!(stage.app.is_dirty());
}

#[test]
fn recording_and_its_end_are_on_every_page() {
    let mut stage = Stage::boiler();
    stage.until(45.0);
    let mut status = RecordingStatus {
        path: "session.log".to_owned(),
        files: 1,
        frames: 5_123,
        bytes: 312_456,
        ..RecordingStatus::default()
    };
    let now = stage.app.now();
    stage.app.handle_recording(now, status.clone());
    for (columns, rows) in [(80, 24), (120, 40), (160, 40), (40, 10), (60, 12)] {
        let text = stage.size(columns, rows).screen();
        assert!(text.contains("● rec 312 kB"), "{columns}×{rows}\n{text}");
    }
    assert!(stage.size(80, 24).keys("3").screen().contains("recording to session.log"));
    (status.bytes, status.lost) = (12_345_678, 34);
    stage.app.handle_recording(now, status.clone());
    assert!(stage.screen().contains("● rec 12 MB lost 34"), "{}", stage.screen());
    status.failure = Some("the disk is full".to_owned());
    stage.app.handle_recording(now, status);
    let text = stage.screen();
    assert!(text.contains("✗ rec stopped"), "{text}");
    assert_eq!(text.matches("recording to session.log stopped: the disk is full").count(), 2);
}

#[test]
fn only_bus_errors_offer_the_bit_rate_search() {
    use descan::bitrate::{RateResult, SearchOutcome, SearchProgress};
    let mut stage = hearing_only(Frame::error(0x88, &[0, 0, 4, 0, 0, 0, 0, 0]));
    snapshot!("only_broken_frames", stage);
    stage.effects.clear();
    stage.keys("b");
    let asked = "Search can0's bit rate, listen-only? The interface restarts.";
    assert!(stage.screen().contains(asked), "{}", stage.screen());
    stage.keys("n");
    assert!(!stage.effects.contains(&Effect::FindBitrate(BusIndex(0))), "asked, and refused");
    stage.keys("b y");
    assert!(stage.effects.contains(&Effect::FindBitrate(BusIndex(0))));
    stage.keys("b");
    assert!(stage.screen().contains("bit rate search on can0 is already running"), "not twice");

    let (now, can0) = (stage.app.now(), BusIndex(0));
    let mut told = |progress| stage.app.handle_bitrate_search(now, can0, progress);
    told(SearchProgress::Trying(125_000));
    told(SearchProgress::NothingValid(125_000, RateResult { frames: 0, bus_errors: 64 }));
    told(SearchProgress::NothingValid(250_000, RateResult::default()));
    told(SearchProgress::Trying(500_000));
    assert!(stage.screen().contains("can0: listening at 500 kbit/s"), "{}", stage.screen());
    assert!(!stage.screen().contains("wrong bit rate"), "what is done is not offered");
    // The search takes the interface down and up; no remedy is shown for that.
    stage.link(Link::Down);
    assert!(stage.screen().contains("searching bit rate"), "{}", stage.screen());
    assert!(!stage.screen().contains("DOWN") && !stage.screen().contains("can0 down"));
    stage.link(Link::Up);
    stage.app.handle_bitrate(now, can0, Ok(SearchOutcome::Found(500_000)));
    snapshot!("bit_rate_found", stage.keys("3"));
    stage.keys("b y").app.handle_bitrate(now, can0, Ok(SearchOutcome::NoTraffic));
    assert!(
        stage.screen().contains("if only one device is on, run: descan speed can0"),
        "{}",
        stage.screen()
    );
    // After a valid frame, no bit rate search is offered any more.
    let heartbeat = Frame::classic(0x0718_0001, &[0, 0, 0, 0, 0, 0, 4, 0]);
    stage.app.handle_frames(now, &[heartbeat.with_time(now)]);
    stage.wait_until(6.0);
    assert!(!stage.screen().contains("wrong bit rate"), "{}", stage.screen());
}

#[test]
fn missing_ack_offers_no_bit_rate_search() {
    let stage = hearing_only(Frame::error(0xA8, &[0, 0, 0x80, 0x19, 0, 0, 128, 0]));
    let screen = stage.screen();
    assert!(screen.contains("err 4"), "{screen}");
    assert!(!screen.contains("wrong bit rate"), "{screen}");
}

#[test]
fn bus_without_bit_rate_offers_no_search() {
    let mut stage = Stage::boiler();
    stage.app.name_bus(BusIndex(0), "slcan:/dev/ttyACM0@125000".to_owned());
    for (rate_search, refusal) in [
        (RateSearch::NoRate, "ttyACM0@125000: bit rate cannot be set from here"),
        (RateSearch::WhenClosed, " quit descan, then run: descan speed slcan:/dev/ttyACM0\n"),
    ] {
        let status = BusStatus { link: Link::Up, rate_search, ..BusStatus::default() };
        stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
        let screen = stage.keys("b").screen() + "\n";
        assert!(screen.contains(refusal), "{screen}");
    }
    assert!(!stage.effects.contains(&Effect::FindBitrate(BusIndex(0))));
}

#[test]
fn blocked_requests_show_reason() {
    let mut stage = Stage::boiler();
    stage.link(Link::Down).keys("r");
    assert_eq!(stage.app.message().unwrap().text, "can0 is down");

    let full = BusStatus { link: Link::Up, is_transmit_queue_full: true, ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), full.clone());
    let screen = stage.keys("3").screen();
    assert!(screen.contains(" transmit queue full "), "{screen}");
    assert!(screen.contains("transmit queue full: frames not sent"), "{screen}");
    let room = BusStatus { is_transmit_queue_full: false, ..full };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), room);
    let screen = stage.screen();
    assert!(screen.contains("transmit queue no longer full"), "{screen}");
    assert!(!screen.contains(" transmit queue full "), "{screen}");
}

#[test]
fn bus_down_is_shown_on_every_page() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    let status = BusStatus {
        link: Link::Down,
        state: BusState::Down,
        fault: Some(
            Diagnostic::new("can0 is down")
                .with_remedy("sudo ip link set can0 up type can bitrate 125000"),
        ),
        ..BusStatus::default()
    };
    let now = stage.app.now();
    stage.app.handle_bus(now, BusIndex(0), status);
    stage.sim.set_link(stage.station, false);
    stage.until(40.0).keys("G");
    snapshot!("bus_down", stage);
}

#[test]
fn listen_only_is_shown() {
    let config = Config { listen_only: true, seed: 7, ..Config::default() };
    let scenario = Scenario::builtin("boiler").unwrap();
    let mut stage = Stage::with(&scenario, Some(BOILER), config);
    stage.until(24.0);
    assert!(stage.screen().contains("listen-only, acks"), "{}", stage.screen());
    snapshot!("listen_only", stage);
    assert!(!stage.app.capture().frames_from(0).any(|(_, frame)| frame.is_tx));
    stage.keys("r");
    assert!(stage.screen().contains("listen-only: no requests are sent"));
}

/// Tests that unsaved edits are shown with any bus name and file name.
#[test]
fn long_name_is_cut_before_the_file_status() {
    for (bus, short) in [("sim:../bus.toml", "s.toml"), (&*"x".repeat(58), "…xxxxx")] {
        let mut stage = Stage::boiler();
        stage.app.name_bus(BusIndex(0), bus.to_owned());
        stage.until(9.0).size(40, 10);
        let first = |stage: &Stage| stage.screen().lines().next().unwrap_or_default().to_owned();
        let line = first(&stage);
        assert!(line.contains("● 5"), "{line}");
        stage.refusal = Some("mounted read-only".to_owned());
        stage.keys("e").text("100").keys("Enter");
        let line = first(&stage);
        assert!(line.contains("des.json ✗ not saved"), "{line}");
        assert!(line.contains(&short[short.len() - 4..]), "{line}");
        stage.write(&BOILER.replace("\"address\": 10", "\"address\": 99")).keys("Esc");
        assert!(first(&stage).contains("✗ edit conflict"), "{}", stage.screen());
        // With enough space, nothing is cut off.
        let whole = &bus[bus.len().saturating_sub(36)..];
        assert!(stage.size(120, 10).screen().contains(whole));
    }
}

/// Tests that lost frames and the remedy for a bus outage are shown with any bus name.
#[test]
fn long_bus_name_is_cut_before_its_counters() {
    let mut stage = Stage::boiler();
    let name = "udp:ff15:7079:7468:6f6e:6465:6d6f:6d63:6173";
    stage.app.name_bus(BusIndex(0), name.to_owned());
    let first = |stage: &Stage| stage.screen().lines().next().unwrap_or_default().to_owned();
    let line = first(stage.until(9.0));
    assert!(line.contains(":6173 "), "{line}");
    assert!(line.contains("err 0") && line.contains("lost 0"), "{line}");
    let fault = Diagnostic::new("127.0.0.1:29536: connection refused");
    let fault = Some(fault.with_remedy("start socketcand there"));
    let status = BusStatus { link: Link::Down, fault, ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    let line = first(&stage);
    assert!(line.ends_with("start socketcand there"), "{line}");
    assert!(stage.size(120, 24).screen().contains(name), "{}", stage.screen());

    stage.app.name_bus(BusIndex(0), "can0".to_owned());
    let way_out = "check wiring, then sudo ip link set can0 type can restart";
    let status = BusStatus {
        link: Link::Up,
        state: BusState::BusOff,
        bitrate: Some(250_000),
        fault: Some(Diagnostic::new("can0 is bus-off").with_remedy(way_out)),
        ..BusStatus::default()
    };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    let line = first(stage.size(80, 24));
    assert!(line.ends_with(way_out) && line.contains("BUS-OFF"), "{line}");
}

/// Tests that the remedy is not cut off at 80 columns.
#[test]
fn remedy_is_never_cut() {
    let mut stage = Stage::boiler();
    stage.until(9.0);
    for (content, way_out) in [
        (&b"\xff\xfe[\0]\0"[..], "line 1, column 1: the file is UTF-16: save it as UTF-8"),
        (b"[{ \"name\": \"\xff\" }]", "line 1, column 13: 0xFF is not UTF-8: save it as UTF-8"),
    ] {
        stage.file = Some(content.to_vec());
        stage.notice();
        let screen = stage.screen();
        // In the status, in the timeline and at the bottom; and after a key that starts an edit.
        assert_eq!(screen.matches(way_out).count(), 3, "{screen}");
        let screen = stage.keys("e").screen();
        let words = screen.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(&format!("file has errors, fix it first: {way_out}")), "{screen}");
    }
    stage.write("[{\n  \"name\": 1\n  ]");
    for columns in 80..121 {
        let screen = stage.size(columns, 24).screen();
        assert!(screen.contains("des.json ✗ line 3, column 3: expected `,` or `}`"), "{screen}");
        assert_eq!(
            screen.contains("last valid:"),
            screen.contains("last valid: 5 entries"),
            "{screen}"
        );
        assert!(columns < 118 || screen.contains("last valid: 5 "), "{screen}");
    }
}

/// Sizes of a terminal on which the status has one line, or two.
const SIZES: [(u16, u16); 9] =
    [(40, 10), (45, 10), (52, 12), (60, 12), (60, 16), (72, 20), (80, 10), (80, 24), (120, 40)];

/// Puts the app into a state.
type Change<'a> = &'a dyn Fn(&mut Stage);

/// Returns the status lines: all above the names of the pages.
fn status(stage: &Stage) -> String {
    let screen = stage.screen();
    let lines = screen.lines().take_while(|line| !line.contains("1 Devices"));
    lines.collect::<Vec<_>>().join("\n")
}

#[test]
fn status_never_drops_what_is_not_normal() {
    let config = Config { seed: 7, listen_only: true, ..Config::default() };
    let boiler = Scenario::builtin("boiler").unwrap();
    let frozen = |stage: &mut Stage| {
        stage.keys("Space");
    };
    let paused = |stage: &mut Stage| {
        let playback =
            Playback { speed: 2.0, is_paused: true, is_ended: false, ..Playback::default() };
        stage.app.handle_playback(stage.app.now(), playback);
        let status = BusStatus { link: Link::Up, percent: Some(40), ..BusStatus::default() };
        stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    };
    let listening = |_: &mut Stage| {};
    let broken = |stage: &mut Stage| {
        stage.write("[{ \"name\": }");
    };
    let deleted = |stage: &mut Stage| {
        stage.remove();
    };
    let cases: [(Change, &str); 5] = [
        (&frozen, "FROZEN"),
        (&paused, "log PAUSED 0:45 40% ×2"),
        (&listening, "listen-only, acks"),
        (&broken, "des.json ✗ "),
        (&deleted, "des.json not found"),
    ];
    for (at, (happens, shown)) in cases.into_iter().enumerate() {
        let config = if at == 2 { config.clone() } else { Config { seed: 7, ..Config::default() } };
        let mut stage = Stage::with(&boiler, Some(BOILER), config);
        stage.app.name_bus(BusIndex(0), "sim:../scenarios/boiler.toml".to_owned());
        stage.until(45.0);
        happens(&mut stage);
        let confirmed = stage.app.counts().confirmed;
        assert!(confirmed > 0);
        for (columns, rows) in SIZES {
            let status = status(stage.size(columns, rows));
            assert!(status.contains(shown), "{columns}×{rows}\n{status}");
            assert!(status.contains(&format!("⚠ {confirmed}")), "{columns}×{rows}\n{status}");
            assert!(!status.contains('…') || columns < 60, "{columns}×{rows}\n{status}");
            // A label goes with its value.
            for label in ["load", "err", "lost", "own"] {
                let words: Vec<&str> = status.split_whitespace().collect();
                let at = words.iter().position(|word| *word == label);
                let value = at.map_or(Some(&"0"), |at| words.get(at + 1));
                let is_value =
                    |text: &&str| text.starts_with(|c: char| c.is_ascii_digit() || c == '≈');
                assert!(value.is_some_and(is_value), "{columns}×{rows}\n{status}");
            }
        }
    }
}

#[test]
fn bus_label_does_not_change_with_counters() {
    let mut stage = Stage::boiler();
    stage.app.name_bus(BusIndex(0), "sim:boiler".to_owned());
    stage.size(40, 10);
    for seconds in [1.0, 9.0, 24.0, 45.0, 70.0] {
        let status = status(stage.until(seconds));
        assert!(status.starts_with(" boiler "), "{status}");
    }
}

#[test]
fn ended_log_is_not_paused() {
    let mut stage = Stage::boiler();
    stage.until(24.0);
    let now = stage.app.now();
    stage.app.handle_playback(
        now,
        Playback { speed: 1.0, is_paused: true, is_ended: true, ..Playback::default() },
    );
    let ended = BusStatus { link: Link::Ended, percent: Some(100), ..BusStatus::default() };
    stage.app.handle_bus(now, BusIndex(0), ended);
    let screen = stage.screen();
    assert!(screen.contains("end of log 0:24 ") && !screen.contains("PAUSED"), "{screen}");
    assert!(!screen.contains("P p"), "{screen}");
}

#[test]
fn load_without_a_bit_rate_is_unknown() {
    let mut stage = Stage::boiler();
    stage.until(10.0);
    assert!(one_line(&stage.screen()).contains("load 6%"), "{}", stage.screen());
    let rate_search = RateSearch::NoRate;
    let status = BusStatus { link: Link::Up, rate_search, ..BusStatus::default() };
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status);
    assert!(one_line(&stage.screen()).contains("load – "), "{}", stage.screen());
}

#[test]
fn listening_adapter_sends_nothing_until_a_valid_frame() {
    let mut stage = Stage::boiler();
    let status = |listens_first| BusStatus {
        link: Link::Up,
        bitrate: Some(125_000),
        listens_first,
        ..BusStatus::default()
    };
    stage.app.handle_bus(Instant::ZERO, BusIndex(0), status(true));
    stage.until(8.0).size(120, 36);
    assert_eq!(stage.app.buses()[0].counters().sent, 0);
    assert!(stage.screen().contains("listen-only until a valid frame"), "{}", stage.screen());
    stage.keys("r");
    let refusal = "can0 is listen-only until a valid frame is received";
    assert!(stage.screen().contains(refusal), "{}", stage.screen());
    stage.app.handle_bus(stage.app.now(), BusIndex(0), status(false));
    stage.until(16.0).keys("3 v");
    assert!(stage.app.buses()[0].counters().sent > 0);
    let screen = stage.screen();
    assert!(screen.contains("valid frame received: opened to send"), "{screen}");
    assert!(screen.contains("own 0"), "{screen}");
}
