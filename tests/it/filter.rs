//! The filter language, from outside: which frames, rows, events and problems a line selects.

use crate::common::harness::Stage;
use descan::app::{App, AppOptions, Effect, Filter, FilterError, Page, RowKind};
use descan::discovery::Config;
use descan::frame::{CanId, Frame};
use descan::sim::Scenario;
use descan::time::Instant;
use descan::wire::id::{Address, Header, Service};
use proptest::prelude::*;

fn at(millis: u64) -> Instant {
    Instant::from_micros(millis * 1000)
}

fn address(number: u8) -> Address {
    Address::from_bits(number)
}

/// An identifier word: flags U D R B ERR, sender, receiver, service.
fn id(flags: &str, from: u8, to: u8, service: u16) -> u32 {
    let has = |flag: char| flags.contains(flag);
    Header {
        from_non_working: has('U'),
        to_non_working: has('D'),
        response: has('R'),
        broadcast: has('B'),
        no_error: has('E'),
        source: address(from),
        destination: address(to),
        service: Service::from_bits(service),
    }
    .encode()
}

/// An App that listens to one bus and was given these frames.
fn app_with(frames: &[Frame]) -> App {
    let config = Config { listen_only: true, bitrate: Some(125_000), ..Config::default() };
    let options = AppOptions { buses: vec![("can0".to_owned(), config)], ..AppOptions::default() };
    let mut app = App::new(Instant::ZERO, options);
    for frame in frames {
        while let Some(due) = app.poll_timeout().filter(|due| *due <= frame.time) {
            app.handle_timeout(due);
        }
        app.handle_frames(frame.time, &[*frame]);
        while app.poll_effect().is_some() {}
    }
    app
}

/// Numbers of the captured frames that a filter selects.
fn selected(app: &App, line: &str) -> Vec<u64> {
    let filter =
        Filter::parse(line, RowKind::Frame).unwrap_or_else(|error| panic!("{line}: {error}"));
    let matcher = filter.for_frames(app.history());
    let all = app.capture().frames_from(0);
    all.filter(|(number, frame)| matcher.is_match(frame, Some((app.capture(), *number))))
        .map(|(number, _)| number)
        .collect()
}

#[test]
fn word_that_is_a_whole_identifier_selects_its_frames() {
    let app = app_with(&frames_of_all_kinds());
    let response = format!("{:08x}", id("RE", 14, 0, 2));
    let heartbeats = format!("{:08X}", id("RBE", 14, 0, 1));
    for (line, expected) in [
        (response.as_str(), &[3][..]),
        (&heartbeats, &[0]),
        ("00000123", &[9]),
        ("id:=123", &[8]),
        // An address, and a part of an identifier.
        ("123", &[]),
        ("0000123", &[]),
    ] {
        assert_eq!(selected(&app, line), expected, "{line}");
    }
}

/// One frame of each kind, a second apart.
fn frames_of_all_kinds() -> Vec<Frame> {
    let uid = [0x8A, 0xFA, 0x6C, 0x97, 0x24, 0x13];
    let beat = |mode: u8| [&uid[..], &[mode, 0]].concat();
    let frames = [
        // 0: heartbeat of 14 in WORK; 1: in IDLE
        Frame::classic(id("RBE", 14, 33, 1), &beat(4)),
        Frame::classic(id("URBE", 14, 80, 1), &beat(6)),
        // 2: name request to 14; 3: its response; 4: an error response
        Frame::classic(id("", 0, 14, 2), &[4, b'D', b'E', b'S', 1]).with_tx(),
        Frame::classic(id("RE", 14, 0, 2), &[5, 1, b'A', b'C', b'T', 0]),
        Frame::classic(id("R", 14, 0, 2), &[2, 3, 0]),
        // 5: unsolicited data; 6: broadcast request; 7: debug message
        Frame::classic(id("RBE", 12, 5, 0x101), &[0x01, 0x7F, 0x0F, 0x40]),
        Frame::classic(id("B", 0, 77, 2), &[4, b'D', b'E', b'S', 1]),
        Frame::classic(id("UDRBE", 12, 127, 0x33), &[9]),
        // 8: 11-bit; 9: remote; 10: error frame; 11: a combination of flags that is no message
        Frame::new(CanId::Standard(0x123), &[0x01, 0x02]),
        Frame::remote(CanId::Extended(0x123), 4),
        Frame::error(0x8, &[0, 0, 4, 0, 0, 0, 0, 0]),
        Frame::classic(id("UDRE", 12, 14, 3), &[]),
    ];
    let dated = |(second, frame): (u64, Frame)| frame.with_time(at(1000 * second));
    (1..).zip(frames).map(dated).collect()
}

#[test]
fn fields_select_the_frames_that_have_them() {
    let app = app_with(&frames_of_all_kinds());
    let all: Vec<u64> = (0..12).collect();
    for (line, expected) in [
        ("", &all[..]),
        ("at:14", &[0, 1, 2, 3, 4, 11]),
        ("at:14,12 not at:14", &[5, 7]),
        ("at:0x0c..13", &[5, 7, 11]),
        ("src:14", &[0, 1, 3, 4]),
        ("src:ACT", &[0, 1, 3, 4]),
        ("src:=ac", &[]),
        ("dst:act", &[2, 11]),
        ("dst:all", &[0, 1, 5, 6, 7]),
        ("dst:0", &[3, 4]),
        ("dev:act", &[0, 1, 2, 3, 4, 11]),
        ("name:act", &[0, 1, 2, 3, 4, 11]),
        ("name:14", &[]),
        ("srv:des", &[2, 3, 4, 6]),
        ("srv:2", &[2, 3, 4, 6]),
        ("srv:0x100..0x1FF", &[5]),
        ("srv:>2", &[5, 11]),
        ("type:req", &[2, 6]),
        ("type:rsp", &[3, 4]),
        ("type:=rsp", &[3]),
        ("type:failed", &[4]),
        ("type:data", &[0, 1, 5]),
        ("type:dbg", &[7]),
        ("type:std", &[8]),
        ("type:rtr", &[9]),
        ("type:err", &[10]),
        ("type:odd", &[11]),
        ("type:rsp_cc", &[0, 3, 4, 5]),
        ("type:req_cc_bcst", &[6]),
        ("mode:work", &[0]),
        ("mode:work,idle", &[0, 1]),
        ("uid:boiler", &[0, 1]),
        ("id:123", &[8, 9]),
        ("id:1?3 not type:odd", &[8, 9]),
        ("id:0x120..0x125", &[8, 9]),
        ("len:0", &[11]),
        ("len:>5", &[0, 1, 3, 10]),
        ("len:2..4 type:data", &[5]),
        ("len:<2", &[7, 11]),
        ("data:\"01 ?? 0F\"", &[5]),
        ("data:^01", &[3, 5, 8]),
        ("data:02$", &[8]),
        ("data:444553", &[2, 6]),
        ("is:error", &[4, 10, 11]),
        ("err", &[4, 10, 11]),
        ("is:failed", &[4]),
        ("tx", &[2]),
        ("is:ours", &[2]),
        ("own", &[2]),
        ("bus:can0", &all[..]),
        ("bus:can1", &[]),
        ("text:\"name act\"", &[3]),
        ("text:stuff", &[10]),
        ("act", &[0, 1, 2, 3, 4, 11]),
        ("request", &[2, 6]),
        ("since:-10s until:-9s", &[1, 2]),
        ("not type:data,req type:rsp", &[3, 4]),
        ("(at:14 or len:2) and not (uid:boiler or srv:des or type:odd)", &[8]),
    ] {
        let mut filter = Stage::new(&Scenario::new(125_000), None);
        if line.contains("since") {
            // Times are relative to what the screen shows.
            filter.app = app_with(&frames_of_all_kinds());
            filter.size(80, 24).keys("2 /").text(line).keys("Enter");
            assert_eq!(filter.app.frames_shown(99).0, expected, "{line}");
        } else {
            assert_eq!(selected(&app, line), expected, "{line}");
        }
    }
}

#[test]
fn word_right_behind_a_quote_is_a_term_of_its_own() {
    let app = app_with(&frames_of_all_kinds());
    let both = selected(&app, "srv:\"des\" type:rsp");
    assert!(!both.is_empty() && both != selected(&app, "srv:des"), "{both:?}");
    assert_eq!(selected(&app, "srv:\"des\"type:rsp"), both);
}

#[test]
fn wrong_lines_name_the_place_and_the_way_out() {
    for (line, column, said) in [
        ("at:14 tipe:rsp", 7, "unknown field tipe; use type:; quote"),
        ("dat:11", 1, "unknown field dat; use data:;"),
        ("at:128", 4, "\"128\" is not an address; use 0 to 127"),
        ("at:12,x,14", 7, "\"x\" is not an address"),
        ("at:5..3", 4, "\"5..3\" is not a range; use 3..5"),
        ("data:0", 6, "\"0\" is not bytes in hexadecimal; for example data:"),
        ("len:8..3", 5, "is not a range; use 3..8"),
        ("dt:soon", 4, "is not an interval; for example dt:>50ms"),
        ("since:25:00", 7, "is not a time"),
        ("id:0g", 4, "is not digits of an identifier"),
        ("type:xyz", 6, "is not a type; use req, rsp,"),
        ("mode:asleep", 6, "is not a mode; use init, arslv"),
        ("is:lost", 4, "is not a state; use error, failed, tx"),
        ("a or", 3, "a term is missing after or"),
        ("(a", 1, "not closed"),
        ("name:", 6, "needs a value"),
        ("name:=", 6, "is not a text"),
        ("srv:2,0x400", 7, "is not a service; use a name or 0 to 0x3FF"),
        ("kind:\"a", 1, "a quote is not closed"),
    ] {
        let error: FilterError = Filter::parse(line, RowKind::Frame).unwrap_err();
        assert!(error.text().contains(said), "{line}: {error}");
        assert_eq!(error.column(line), column, "{line}: {error}");
    }
    let error = |line, rows| Filter::parse(line, rows).unwrap_err().to_string();
    let said = "id:1: devices have no field id; use at: name:";
    assert!(error("id:1", RowKind::Device).starts_with(said));
    assert!(error("since:13:51", RowKind::Device).contains("devices have no field since"));
    assert!(error("dt:>1", RowKind::Problem).contains("problems have no field dt"));
}

/// Tests that frames of an address have the name of the device that had it then, from its first frame
/// there on, whatever is there now.
#[test]
fn names_are_those_of_the_frames_moment() {
    let heartbeat = |from: u8, mode: u8, uid: u8| {
        Frame::classic(id("RBE", from, 1, 1), &[uid, 1, 1, 1, 1, 1, mode, 0])
    };
    let named = |from: u8, name: &[u8; 3]| {
        let data = [5, 1, name[0], name[1], name[2], 0];
        Frame::classic(id("RE", from, 0, 2), &data)
    };
    let mut frames = Vec::new();
    for second in 1..=60 {
        frames.push(heartbeat(12, 4, 1).with_time(at(second * 1000)));
        if second == 5 {
            frames.push(named(12, b"OLD").with_time(at(5500)));
        }
    }
    // The board is replaced by another one.
    for second in 200..=260 {
        frames.push(heartbeat(12, 4, 2).with_time(at(second * 1000)));
        if second == 210 {
            frames.push(named(12, b"NEW").with_time(at(210_500)));
        }
    }
    let app = app_with(&frames);
    let seconds = |line: &str| {
        let numbers = selected(&app, line);
        let time = |number: &u64| app.capture().get(*number).unwrap().time.as_micros() / 1_000_000;
        (time(numbers.first().unwrap()), time(numbers.last().unwrap()), numbers.len())
    };
    assert_eq!(seconds("src:OLD"), (1, 60, 61));
    assert_eq!(seconds("src:NEW").1, 260);
    let (first, _, count) = seconds("src:NEW");
    assert!((200..=210).contains(&first) && count >= 51, "{first} {count}");
    assert_eq!(selected(&app, "src:OLD src:NEW"), [0; 0]);
}

#[test]
fn intervals_are_between_equal_identifiers() {
    let beat = |millis: u64, random: u8| {
        Frame::classic(id("RBE", 12, random, 1), &[0; 8]).with_time(at(millis))
    };
    let other = |millis: u64| Frame::classic(id("RBE", 13, 9, 1), &[0; 8]).with_time(at(millis));
    let frames = [beat(1000, 1), other(1500), beat(2000, 2), other(2501), beat(3300, 3)];
    let app = app_with(&frames);
    assert_eq!(selected(&app, "dt:1s"), [2]);
    assert_eq!(selected(&app, "dt:>1s"), [3, 4]);
    assert_eq!(selected(&app, "dt:1001..1300"), [3, 4]);
    assert_eq!(selected(&app, "not dt:>=0"), [0, 1], "their predecessor is not known");
    // The view of identifiers shows broadcasts without their random destination.
    let masked = format!("id:{:08X}", id("RBE", 12, 0, 1));
    assert_eq!(selected(&app, &masked), [0, 2, 4]);
    assert_eq!(selected(&app, &format!("id:{:08X}", id("RBE", 12, 2, 1))), [2]);
}

#[test]
fn bytes_of_a_transfer_are_found_where_they_end() {
    let answer = |data: &[u8]| Frame::classic(id("RE", 50, 0, 2), data);
    let frames: Vec<Frame> = [
        answer(&[0x10, 0x12, 2, 0, b'D', b'E', b'S', 0]),
        Frame::classic(id("", 0, 50, 2), &[0x30, 0, 0]).with_tx(),
        answer(&[0x21, b'1', b'.', b'0', 0, 1, b'P', b'U']),
        // Another one sends in between.
        Frame::classic(id("RE", 51, 0, 2), &[0x21, 1, 2, 3, 4, 5, 6, 7]),
        answer(&[0x22, b'M', b'P', 0, b'2', 0]),
        // A frame is missing.
        answer(&[0x10, 0x20, 2, 0, b'D', b'E', b'S', 0]),
        answer(&[0x22, b'1', b'.', b'0', 0, 1, b'P', b'U']),
    ]
    .into_iter()
    .zip(1..)
    .map(|(frame, second)| frame.with_time(at(second * 10)))
    .collect();
    let app = app_with(&frames);
    let pump = "data:\"50 55 4D 50\"";
    assert_eq!(selected(&app, pump), [4]);
    assert_eq!(selected(&app, "data:\"53 00 31 2E\""), [2]);
    assert_eq!(selected(&app, "data:\"^02 00 44\""), [0, 5], "the beginning of a transfer");
}

// ---- the screen ----------------------------------------------------------------------------

#[test]
fn filter_keeps_the_selected_row_or_the_nearest() {
    let frames: Vec<Frame> = (0..1000)
        .map(|number: u32| {
            let id = if number.is_multiple_of(10) { 0x123 } else { 0x456 };
            let frame = Frame::new(CanId::Standard(id), &number.to_be_bytes());
            frame.with_time(at(1 + u64::from(number)))
        })
        .collect();
    let mut stage = Stage::new(&Scenario::new(125_000), None);
    stage.app = app_with(&frames);
    stage.size(100, 24).keys("2 k k k k");
    let selected = stage.app.view().traffic.unwrap();
    assert!(selected > 990);
    stage.keys("/").text("id:123").keys("Enter");
    assert_eq!(stage.app.view().traffic, Some(1000 - 10), "the nearest match\n{}", stage.screen());
    stage.keys("k k");
    let line = stage.app.view().traffic_line;
    assert_eq!(stage.app.view().traffic, Some(970));
    stage.keys("\\");
    assert_eq!((stage.app.view().traffic, stage.app.view().traffic_line), (Some(970), line));
    assert!(stage.screen().contains("off /id:123"), "{}", stage.screen());
    // Search without hiding.
    stage.keys("J");
    assert_eq!(stage.app.view().traffic, Some(980));
    stage.keys("K K");
    assert_eq!(stage.app.view().traffic, Some(960));
    stage.keys("j \\");
    assert_eq!(stage.app.view().traffic, Some(960));
    assert!(stage.screen().contains("/id:123  900 hidden"), "{}", stage.screen());
    stage.keys("Esc = ");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "id:=123");
    stage.keys("Esc !");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "!id:=123");
    assert_eq!(stage.app.hidden_frames(), Some(100));
}

#[test]
fn prompt_completes_and_recalls() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(100, 30).keys("2 /").text("sr");
    assert!(stage.screen().contains("Tab completes  src:  srv:"), "{}", stage.screen());
    let typed = |stage: &Stage| stage.app.prompt().unwrap().input.value().to_owned();
    stage.keys("Tab");
    assert_eq!(typed(&stage), "src:");
    stage.text("fe").keys("Tab");
    assert_eq!(typed(&stage), "src:FEED");
    assert!(stage.screen().contains("frames match"), "{}", stage.screen());
    stage.text(" type:d").keys("Tab");
    assert_eq!(typed(&stage), "src:FEED type:data");
    stage.keys("Tab");
    assert_eq!(typed(&stage), "src:FEED type:dbg", "Tab goes on");
    stage.keys("Enter Esc /").text("err").keys("Enter Esc /").text("zz").keys("Up");
    assert_eq!(typed(&stage), "err");
    stage.keys("Up");
    assert_eq!(typed(&stage), "src:FEED type:dbg");
    stage.keys("Up Down");
    assert_eq!(typed(&stage), "err");
    stage.keys("Down");
    assert_eq!(typed(&stage), "zz", "what was typed comes back");
    stage.keys("Ctrl-u").text("src:FEED tipe:req");
    let screen = stage.screen();
    assert!(screen.contains("unknown field tipe; use type:"), "{screen}");
    assert!(screen.contains("column 10"), "{screen}");
}

#[test]
fn saved_filters_are_listed_and_set() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(100, 30).keys("2 F");
    assert!(stage.screen().contains("no saved filter; /, then Ctrl-s"), "{}", stage.screen());
    let store = |stage: &mut Stage| {
        let mut saved = stage.app.saved_filters(Page::Traffic).into_iter().cloned().collect();
        let changes = std::mem::take(&mut stage.effects);
        for effect in changes {
            if let Effect::ChangeFilters(change) = effect {
                change.apply(&mut saved);
            }
        }
        stage.app.handle_saved_filters(Ok(saved));
    };
    for line in ["src:FEED", "type:req"] {
        stage.keys("/").keys("Ctrl-u").text(line).keys("Ctrl-s");
        store(&mut stage);
        assert_eq!(stage.app.page_filter(Page::Traffic).text(), line);
    }
    stage.keys("/").keys("Ctrl-u").text("tipe:").keys("Ctrl-s");
    assert!(stage.app.prompt().is_some(), "a mistake is not saved");
    stage.keys("Esc F");
    let screen = stage.screen();
    assert!(screen.contains("1 src:FEED") && screen.contains("2 type:req"), "{screen}");
    stage.keys("1");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "src:FEED");
    stage.keys("F j Enter");
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), "type:req");
    stage.keys("F D");
    store(&mut stage);
    assert!(!stage.screen().contains("src:FEED"), "{}", stage.screen());
    stage.keys("D");
    store(&mut stage);
    assert!(!stage.screen().contains("Filters of"), "the empty list is closed");
    stage.keys("1 F");
    assert!(stage.screen().contains("no saved filter"), "{}", stage.screen());
}

#[test]
fn matches_are_found_on_every_page() {
    let mut stage = Stage::boiler();
    stage.until(45.0).size(100, 30);
    stage.keys("/").text("name:disp").keys("Enter \\ Home J");
    let named =
        |stage: &Stage| stage.app.selected_row().unwrap().name.as_ref().unwrap().to_string();
    assert_eq!(named(&stage), "DISP");
    stage.keys("K");
    assert!(stage.screen().contains("no match before this row"), "{}", stage.screen());
    stage.keys("3 /").text("claimed").keys("Enter Esc Home J");
    let first = stage.app.view().timeline.selected().copied().unwrap();
    stage.keys("J");
    assert!(stage.app.view().timeline.selected().copied().unwrap() > first);
    stage.keys("4 J");
    assert!(stage.screen().contains("no filter; / types one"), "{}", stage.screen());
    stage.keys("/").text("kind:missing").keys("Enter \\ Home J");
    let problem = stage.app.selected_problem().unwrap();
    assert_eq!(problem.head().key.kind.name(), "missing");
}

// ---- any line --------------------------------------------------------------------------------

/// A part of a filter and what it selects of [`frames_of_all_kinds`].
const ATOMS: &[(&str, &[u64])] = &[
    ("at:14", &[0, 1, 2, 3, 4, 11]),
    ("len:>5", &[0, 1, 3, 10]),
    ("type:data", &[0, 1, 5]),
    ("srv:des", &[2, 3, 4, 6]),
    ("err", &[4, 10, 11]),
    ("request", &[2, 6]),
    ("uid:boiler", &[0, 1]),
    ("bus:can1", &[]),
];

/// A random line with the numbers that it selects.
fn any_line() -> impl Strategy<Value = (String, u16)> {
    let atom = (0..ATOMS.len()).prop_map(|at| {
        let (text, numbers) = ATOMS[at];
        (text.to_owned(), numbers.iter().fold(0, |set, number| set | 1 << number))
    });
    atom.prop_recursive(4, 24, 3, |part| {
        let parts = || prop::collection::vec(part.clone(), 1..4);
        let joined = |parts: &[(String, u16)], between: &str| {
            parts.iter().map(|(text, _)| format!("({text})")).collect::<Vec<_>>().join(between)
        };
        prop_oneof![
            (parts(), prop::bool::ANY).prop_map(move |(parts, is_written)| {
                let text = joined(&parts, if is_written { " AND " } else { " " });
                (text, parts.iter().fold(0xFFF, |set, part| set & part.1))
            }),
            parts().prop_map(move |parts| {
                (joined(&parts, " or "), parts.iter().fold(0, |set, part| set | part.1))
            }),
            (part.clone(), prop::bool::ANY).prop_map(|((text, set), is_sign)| {
                let not = if is_sign { "!" } else { "not " };
                (format!("{not}({text})"), !set & 0xFFF)
            }),
        ]
    })
}

proptest! {
    #[test]
    fn operators_select_as_sets_do((line, expected) in any_line()) {
        thread_local! {
            static KINDS: App = app_with(&frames_of_all_kinds());
        }
        let numbers = KINDS.with(|app| selected(app, &line));
        let set = numbers.iter().fold(0u16, |set, number| set | 1 << number);
        prop_assert_eq!(set, expected, "{}", line);
    }

    #[test]
    fn any_text_is_parsed_or_refused_with_its_place(line in line_of_pieces()) {
        for rows in [RowKind::Device, RowKind::Frame, RowKind::Event, RowKind::Problem] {
            if let Err(error) = Filter::parse(&line, rows) {
                let range = error.range();
                prop_assert!(line.get(range.clone()).is_some(), "{line:?} {range:?}");
                prop_assert!(error.column(&line) <= line.chars().count() + 1);
                prop_assert!(!error.text().is_empty());
            }
        }
    }
}

/// Lines of pieces that mean something, and of any characters.
fn line_of_pieces() -> impl Strategy<Value = String> {
    const PIECES: &[&str] = &[
        "at:",
        "src:",
        "data:",
        "len:",
        "dt:",
        "since:",
        "id:",
        "is:",
        "kind:",
        "mode:",
        "\"",
        "(",
        ")",
        "!",
        "and",
        "or",
        "not",
        " ",
        ",",
        "..",
        ">",
        "<",
        "=",
        "12",
        "0x1F",
        "??",
        "^",
        "$",
        "-2m",
        "13:51",
        "FEED",
        "ж",
        "\u{1F600}",
        ":",
        "5..",
        "..5",
        "%",
        "*",
    ];
    let piece = prop_oneof![
        4 => prop::sample::select(PIECES).prop_map(str::to_owned),
        1 => ".{0,3}",
    ];
    prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}
