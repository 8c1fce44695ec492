//! The page Bus.

use super::two_buses::Pair;
use super::{one_line, snapshot, styles_of, text_snapshot};
use crate::common::harness::{BOILER, Stage};
use descan::app::{App, AppOptions, BarKey, ChartSpan, Mouse, MouseKind, Page};
use descan::discovery::Config;
use descan::frame::bits::FrameBits;
use descan::frame::{BusIndex, CanId, Frame};
use descan::keymap::Key;
use descan::sim::Scenario;
use descan::status::{BusState, BusStatus, Link, RateSearch};
use descan::theme::Theme;
use descan::time::Instant;
use descan::ui;
use descan::wire::id::{Address, Header, Service};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;

/// Bus errors as Linux reports them: class "bus error", with the type in byte 2.
const PROTOCOL: u32 = 0x008;
const NO_ACK: u32 = 0x020;

/// The app, listen-only, on a bus of 125 kbit/s on which only the test sends.
struct Bench {
    app: App,
    micros: u64,
}

impl Bench {
    fn new() -> Self {
        let config = Config { listen_only: true, ..Config::default() };
        let buses = vec![("can0".to_owned(), config)];
        let app = App::new(
            Instant::ZERO,
            AppOptions { buses, capture_room: Some(1 << 20), ..AppOptions::default() },
        );
        let mut bench = Self { app, micros: 0 };
        bench.app.handle_resize(80, 24);
        let status = BusStatus {
            link: Link::Up,
            state: BusState::ErrorActive,
            bitrate: Some(125_000),
            ..BusStatus::default()
        };
        bench.status(status)
    }

    fn status(mut self, status: BusStatus) -> Self {
        self.app.handle_bus(self.now(), BusIndex(0), status);
        self
    }

    fn now(&self) -> Instant {
        Instant::from_micros(self.micros)
    }

    /// Passes a second, with these frames at its beginning.
    fn second(&mut self, frames: &[Frame]) -> &mut Self {
        let now = self.now();
        let frames: Vec<Frame> = frames.iter().map(|frame| frame.with_time(now)).collect();
        self.app.handle_frames(now, &frames);
        self.micros += 1_000_000;
        let now = self.now();
        while self.app.poll_timeout().is_some_and(|due| due <= now) {
            let due = self.app.poll_timeout().unwrap();
            self.app.handle_timeout(due);
        }
        self.app.renew_rows();
        self
    }

    fn seconds(&mut self, count: u64, frames: &[Frame]) -> &mut Self {
        for _ in 0..count {
            self.second(frames);
        }
        self
    }

    fn keys(&mut self, keys: &str) -> &mut Self {
        for key in keys.split_whitespace() {
            self.app.handle_key(self.now(), Key::parse(key).unwrap());
        }
        self
    }

    fn buffer(&mut self, width: u16, height: u16) -> Buffer {
        self.app.handle_resize(width, height);
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let theme = Theme::built_in("terminal").unwrap();
        terminal
            .draw(|frame| {
                ui::draw(&self.app, &theme, frame);
            })
            .unwrap();
        terminal.backend().buffer().clone()
    }

    fn screen(&mut self, width: u16, height: u16) -> String {
        crate::common::harness::text_of(&self.buffer(width, height))
    }
}

/// Returns a frame that `from` sends about a service, with eight bytes of data.
fn frame(from: u8, service: u16) -> Frame {
    let service = Service::new(service).unwrap();
    let header = Header::unsolicited(Address::new(from).unwrap(), 5, false, service);
    Frame::classic(header.encode(), &[0x55; 8])
}

fn bits(frame: &Frame) -> f64 {
    f64::from(FrameBits::of(frame).total())
}

/// Returns an error frame with a type of bus error at a place in the frame.
fn bus_error(kind: u8, place: u8) -> Frame {
    Frame::error(PROTOCOL, &[0, 0, kind, place, 0, 0, 0, 0])
}

#[test]
fn bus_page_matches_snapshots() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("5");
    snapshot!("bus_80x24", stage);
    snapshot!("bus_120x40", stage.size(120, 40));
    snapshot!("bus_200x50", stage.size(200, 50));
    snapshot!("bus_40x10", stage.size(40, 10));
    stage.size(80, 24);
    text_snapshot!("bus_styles_mono", styles_of(&stage.buffer("mono")));
    text_snapshot!("bus_styles_dark", styles_of(&stage.buffer("dark")));
}

#[test]
fn shares_are_those_of_the_frames_sent() {
    let (feed, heat) = (frame(10, 0x101), frame(11, 0x102));
    let mut standard = frame(10, 0x101);
    standard.id = CanId::Standard(0x123);
    let own = frame(0, 0x101).with_tx();
    let second =
        [vec![feed; 30], vec![heat; 10], vec![standard; 5], vec![own; 1], vec![feed; 0]].concat();
    let mut bench = Bench::new();
    bench.keys("5").seconds(10, &second);
    let bus = &bench.app.buses()[0];
    let share = |frame: &Frame, count: f64| bits(frame) * count / 125_000.0;
    let bars = bus.sender_bars(BusIndex(0), ChartSpan::TwoMinutes);
    let senders: Vec<BarKey> = bars.iter().map(|bar| bar.key).collect();
    let sender = |address| BarKey::Sender(BusIndex(0), Address::new(address).unwrap());
    assert_eq!(senders, [sender(10), sender(11), sender(0)], "the longest first");
    let near = |one: f64, other: f64| (one - other).abs() < 1e-9;
    assert!(near(bars[0].share, share(&feed, 30.0)), "{bars:?}");
    assert!(near(bars[1].share, share(&heat, 10.0)), "{bars:?}");
    let services = bus.service_bars(BusIndex(0), ChartSpan::TwoMinutes);
    let service = BarKey::Service(BusIndex(0), Service::new(0x101).unwrap());
    assert_eq!(services[0].key, service);
    assert!(near(services[0].share, share(&feed, 30.0) + share(&own, 1.0)), "{services:?}");
    let all = share(&feed, 30.0) + share(&heat, 10.0) + share(&standard, 5.0) + share(&own, 1.0);
    let others = bus.other_shares(ChartSpan::TwoMinutes);
    let standard = share(&standard, 5.0);
    assert_eq!(others.iter().map(|it| it.0).collect::<Vec<_>>(), ["non-platform", "free"]);
    assert!(near(others[0].1, standard) && near(others[1].1, 1.0 - all), "{others:?}");
    let screen = one_line(&bench.screen(120, 40));
    let text = |share: f64| format!("{:.1} %", share * 100.0);
    for (label, share) in
        [("non-platform", standard), (" free ", 1.0 - all), ("own share", share(&own, 1.0))]
    {
        let after = &screen[screen.rfind(label).expect(label)..];
        let part: String = after.chars().take(60).collect();
        assert!(part.contains(&text(share)), "{label} {}: {part}", text(share));
    }
    // Frame rate and load of the last second.
    assert!(screen.contains("frames, /s now 46 avg 46 max 46"), "{screen}");
    let load = format!("load, % now {0:.1} avg {0:.1} max {0:.1}", all * 100.0);
    assert!(screen.contains(&load), "{load}: {screen}");
}

#[test]
fn frames_without_a_sender_have_a_bar_of_their_own() {
    let mut standard = frame(10, 0x101);
    standard.id = CanId::Standard(0x123);
    let mut bench = Bench::new();
    let screen = one_line(&bench.keys("5").screen(120, 40));
    assert!(screen.contains("load by device"), "{screen}");
    assert!(!screen.contains("no frames"), "nothing is known yet: {screen}");
    let screen = one_line(&bench.seconds(10, &[]).screen(120, 40));
    assert!(screen.contains(" no frames "), "{screen}");
    let screen = one_line(&bench.seconds(10, &[standard; 4]).screen(120, 40));
    assert!(screen.contains(" no such frames "), "{screen}");
    // Of 20 s, with such frames in 10 of them.
    let share = format!(" {:.1} %", bits(&standard) * 4.0 / 2500.0);
    let bar = &screen[screen.rfind("non-platform").unwrap()..];
    assert!(bar.chars().take(50).collect::<String>().contains(&share), "{share}: {bar}");
}

#[test]
fn bars_keep_their_order_for_ten_seconds() {
    let (feed, heat) = (frame(10, 0x101), frame(11, 0x102));
    let mut bench = Bench::new();
    bench.keys("5").seconds(10, &[feed, feed, heat]);
    let order = |bench: &Bench| bench.app.bar_keys();
    let before = order(&bench);
    for _ in 0..9 {
        bench.second(&[feed, heat, heat, heat]);
        assert_eq!(order(&bench), before);
    }
    bench.second(&[]);
    assert_eq!(order(&bench)[..2], [before[1], before[0]]);
}

#[test]
fn scale_is_that_of_the_load_shown() {
    let feed = frame(10, 0x101);
    // 10 and 60 frames in a second: about 1 and 7 % of the bus.
    let mut bench = Bench::new();
    bench.keys("5").seconds(130, &vec![feed; 10]);
    let top = |bench: &mut Bench| {
        let screen = bench.screen(80, 24);
        let line = screen.lines().find(|line| line.contains('┤')).unwrap().to_owned();
        line.split('┤').next().unwrap().trim().to_owned()
    };
    assert_eq!(top(&mut bench), "3", "the least top of a scale");
    bench.second(&vec![feed; 60]).second(&vec![feed; 10]);
    let load = (bits(&feed) * 60.0 / 1250.0).ceil();
    assert_eq!(top(&mut bench), if load > 6.0 { "8".to_owned() } else { format!("{load}") });
    // The peak is in the chart for at least two minutes.
    bench.seconds(120, &vec![feed; 10]);
    assert_ne!(top(&mut bench), "3");
    bench.seconds(40, &vec![feed; 10]);
    assert_eq!(top(&mut bench), "3");
    // In ten minutes it is still shown.
    bench.keys("v");
    assert!(bench.screen(96, 24).contains(" last 10 min (v) "), "{}", bench.screen(96, 24));
    assert!(bench.screen(80, 24).contains(" 10 min "), "{}", bench.screen(80, 24));
    assert!(bench.screen(80, 24).contains("max 6.4"), "{}", bench.screen(80, 24));
    assert_ne!(top(&mut bench), "3", "a burst is as high as in its second");
}

#[test]
fn error_kinds_are_counted() {
    let mut bench = Bench::new();
    let feed = frame(10, 0x101);
    let errors = [
        vec![bus_error(0x04, 0x0A); 9],
        vec![bus_error(0x02, 0x1A); 2],
        vec![bus_error(0x00, 0x08); 3],
        vec![bus_error(0x10, 0x0A); 4],
        vec![Frame::error(NO_ACK, &[0; 8]); 5],
        vec![Frame::error(0x004, &[0, 4, 0, 0, 0, 0, 0, 96]); 1],
        vec![feed; 20],
    ];
    bench.keys("5").second(&errors.concat());
    let line = "errors 24/s max 24/s stuff 9 CRC 3 form 2 bit 4 no ACK 5 other 1";
    let screen = one_line(&bench.screen(80, 24));
    assert!(screen.contains(line), "{screen}");
    let screen = one_line(&bench.screen(44, 16));
    assert!(screen.contains("errors 24/s max 24/s stuff 9 CRC 3"), "{screen}");
    bench.second(&[]);
    let screen = one_line(&bench.screen(120, 40));
    assert!(screen.contains("error frames, /s now 0 avg 12 max 24"), "{screen}");
    assert!(screen.contains("stuff 9 CRC 3 form 2 bit 4 no ACK 5 other 1"), "{screen}");
}

#[test]
fn unknown_values_are_not_shown_as_zero() {
    let bench = Bench::new();
    let screen = one_line(&{ bench }.keys("5").screen(120, 40));
    for unknown in ["TEC – REC –", "own address –", "own share –", "receive buffer –"] {
        assert!(screen.contains(unknown), "{unknown}: {screen}");
    }
    assert!(screen.contains("load, % now – avg – max –"), "{screen}");

    // A bus that is down has no load.
    let mut bench = Bench::new();
    bench.keys("5").seconds(4, &[frame(10, 0x101)]);
    let mut bench = bench.status(BusStatus {
        link: Link::Down,
        bitrate: Some(125_000),
        ..BusStatus::default()
    });
    let screen = bench.seconds(20, &[]).screen(120, 40);
    assert!(one_line(&screen).contains("125 kbit/s down"), "{screen}");
    assert!(one_line(&screen).contains("load, % now – avg 0.1"), "{screen}");
    assert!(screen.contains("··········"), "time without a bus is marked: {screen}");

    // Without a bit rate there is no load, and shares are those of the frames.
    let no_rate =
        BusStatus { link: Link::Up, rate_search: RateSearch::NoRate, ..BusStatus::default() };
    let mut bench = Bench::new().status(no_rate);
    let frames = [frame(10, 0x101), frame(10, 0x101), frame(10, 0x101), frame(11, 0x101)];
    let screen = one_line(&bench.keys("5").seconds(10, &frames).screen(120, 40));
    assert!(!screen.contains("load,"), "{screen}");
    assert!(!screen.contains(" free "), "{screen}");
    assert!(screen.contains("– kbit/s") && screen.contains("frames, /s now 4"), "{screen}");
    let own = bits(&frames[0]) * 3.0;
    let percent = own / (own + bits(&frames[3])) * 100.0;
    assert!(screen.contains(&format!(" {percent:.1} %")), "{screen}");
}

#[test]
fn state_that_a_port_does_not_know_is_that_of_error_frames() {
    const COUNTERS: u32 = 0x200;
    let port = BusStatus { link: Link::Up, ..BusStatus::default() };
    let mut bench = Bench::new().status(port);
    let passive = Frame::error(0x04 | COUNTERS, &[0, 0x20, 0, 0, 0, 0, 130, 7]);
    let bus_off = Frame::error(0x40 | COUNTERS, &[0, 0, 0, 0, 0, 0, 255, 7]);
    let shown = |bench: &mut Bench| one_line(&bench.screen(120, 40));
    let screen = shown(bench.keys("5").second(&[passive]));
    assert!(screen.contains("error-passive") && screen.contains("TEC 130 REC 7"), "{screen}");
    let screen = shown(bench.second(&[bus_off, bus_off]));
    for words in ["bit/s bus-off TEC 255", "bus-off 1"] {
        assert!(screen.contains(words), "{words}: {screen}");
    }
    let found = |bench: &Bench| bench.app.findings().next().unwrap().text.clone();
    assert!(found(&bench).starts_with("The controller is bus-off"), "{}", found(&bench));
    // A bus error does: a controller that is bus-off finds none.
    let mut other = Bench::new().status(BusStatus { link: Link::Up, ..BusStatus::default() });
    let stuff_error = Frame::error(PROTOCOL | 0x80, &[0, 0, 4, 0x0A, 0, 0, 0, 0]);
    let screen = shown(other.keys("5").second(&[bus_off, stuff_error]));
    assert!(screen.contains("state – TEC 255"), "{screen}");
    // Counters do not say that it is on the bus again.
    let counters = Frame::error(COUNTERS, &[0, 0, 0, 0, 0, 0, 248, 0]);
    let screen = shown(bench.second(&[counters, counters]));
    assert!(screen.contains("bus-off TEC 248 REC 0"), "{screen}");
    assert!(found(&bench).starts_with("The controller is bus-off"), "{}", found(&bench));
    // A controller that is bus-off receives nothing.
    let screen = shown(bench.seconds(3, &[frame(10, 0x101)]));
    for words in ["state – TEC 248", "bus-off 1"] {
        assert!(screen.contains(words), "{words}: {screen}");
    }
    assert!(found(&bench).starts_with("The controller was bus-off"), "{}", found(&bench));
}

#[test]
fn axis_moves_on_an_idle_bus() {
    let mut bench = Bench::new();
    let end = |bench: &mut Bench| {
        let screen = bench.screen(80, 24);
        let line = screen.lines().find(|line| line.contains('▼')).unwrap().to_owned();
        line.split(' ').find(|word| word.ends_with('▼')).unwrap().to_owned()
    };
    bench.second(&[frame(10, 0x101)]).seconds(299, &[]).keys("5").second(&[]);
    assert_eq!(end(&mut bench), "00:05:00▼");
    bench.seconds(2, &[]);
    assert_eq!(end(&mut bench), "00:05:02▼");
}

#[test]
fn bar_leads_to_its_device_and_frames() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("5 j");
    let Some(BarKey::Sender(_, address)) = stage.app.selected_bar() else {
        panic!("{:?}", stage.app.selected_bar())
    };
    stage.keys("f");
    assert_eq!(stage.app.view().page, Page::Traffic);
    assert_eq!(stage.app.page_filter(Page::Traffic).text(), format!("src:{address}"));
    stage.keys("5 Enter");
    assert_eq!(stage.app.view().page, Page::Devices);
    assert_eq!(stage.app.selected_row().unwrap().address, Some(address));
    // The services follow the devices.
    let senders = stage.app.buses()[0].sender_bars(BusIndex(0), ChartSpan::TwoMinutes).len();
    stage.keys("5 Home").keys(&"j ".repeat(senders)).keys("Enter");
    assert_eq!(stage.app.view().page, Page::Traffic);
    let filter = stage.app.page_filter(Page::Traffic).text().to_owned();
    assert!(filter.starts_with("srv:"), "{filter}");
    for key in ["/", "\\", "J", "K", "=", "!"] {
        stage.keys("5").keys(key);
        assert!(stage.app.prompt().is_none(), "{key}");
        let refusal = "filter: the Bus page has no rows to filter";
        assert!(stage.screen().contains(refusal), "{key}");
    }
}

#[test]
fn click_selects_a_bar() {
    let mut stage = Stage::boiler();
    stage.until(45.0).keys("5");
    let keys = stage.app.bar_keys();
    let screen = stage.screen();
    let row = screen.lines().position(|line| line.contains("load by device")).unwrap();
    let press = |column: u16, line: usize| Mouse {
        kind: MouseKind::Press,
        column,
        row: (row + line) as u16,
    };
    let now = stage.app.now();
    stage.app.handle_mouse(now, press(5, 3));
    assert_eq!(stage.app.selected_bar(), Some(keys[2]));
    stage.app.handle_mouse(now, press(60, 1));
    let services = stage.app.buses()[0].service_bars(BusIndex(0), ChartSpan::TwoMinutes);
    assert_eq!(stage.app.selected_bar(), Some(services[0].key));
}

#[test]
fn past_moment_has_the_charts_of_then() {
    let boiler = || {
        let config = Config { seed: 7, ..Config::default() };
        let file = Some(BOILER.as_bytes().to_vec());
        let scenario = Scenario::builtin("boiler").unwrap();
        let mut stage = Stage::with_room(&scenario, file, config, 16 << 20);
        stage.size(120, 40);
        stage
    };
    let page = |stage: &Stage| {
        let screen = stage.screen();
        let lines: Vec<&str> = screen.lines().collect();
        // Without the time bar, which is everything that is kept.
        lines[1..lines.len() - 2].join("\n")
    };
    let mut then = boiler();
    let expected = page(then.until(35.5).keys("5 Space"));
    let mut past = boiler();
    past.until(70.0).keys("5");
    assert_ne!(page(&past), expected);
    past.keys(":").text("12:00:35.500").keys("Enter");
    assert_eq!(page(&past), expected);
    // Nothing changes while it is shown.
    past.until(75.0);
    assert_eq!(page(&past), expected);
}

#[test]
fn two_buses_share_an_axis() {
    let scenarios = ["boiler", "drone"].map(|name| Scenario::builtin(name).unwrap());
    let mut pair = Pair::new([&scenarios[0], &scenarios[1]]);
    pair.run(0..20).keys("5");
    text_snapshot!("bus_two_120x40", pair.screen(120, 40));
    text_snapshot!("bus_two_80x24", pair.screen(80, 24));
    let screen = pair.screen(120, 40);
    assert_eq!(screen.matches('▼').count(), 2, "one axis and the time bar: {screen}");
    assert!(screen.contains("can0: load, %") && screen.contains("can1: load, %"), "{screen}");
}

#[test]
fn status_chart_is_scaled_by_the_last_minute() {
    let feed = frame(10, 0x101);
    let percent = |count: f64| bits(&feed) * count / 1250.0;
    let mut bench = Bench::new();
    let status = |bench: &mut Bench| bench.screen(100, 24).lines().next().unwrap().to_owned();
    bench.second(&vec![feed; 60]).seconds(30, &vec![feed; 20]);
    let (least, most) = (percent(20.0).floor(), percent(60.0).ceil());
    let scale = format!("{least}–{most}%");
    assert!(status(&mut bench).contains(&scale), "{scale}: {}", status(&mut bench));
    // The burst is out of the chart, but less than a minute ago.
    bench.seconds(29, &vec![feed; 20]);
    assert!(status(&mut bench).contains(&scale), "{scale}: {}", status(&mut bench));
    bench.second(&vec![feed; 20]);
    let scale = format!("⣀ {least}–{}%", least + 3.0);
    assert!(status(&mut bench).contains(&scale), "{scale}: {}", status(&mut bench));
}

/// Returns about how many bytes a terminal gets for the changes from one screen to the next: the
/// changed cells, and a cursor movement for each run of them.
fn bytes_between(before: &Buffer, after: &Buffer) -> usize {
    let mut last = None;
    let changes = before.diff(after);
    let mut bytes = 0;
    for (x, y, cell) in changes {
        if last != Some((x, y)) {
            bytes += 10;
        }
        last = Some((x + 1, y));
        bytes += cell.symbol().len();
    }
    bytes
}

#[test]
fn full_bus_at_rest_sends_little_to_the_terminal() {
    let mut random = fastrand::Rng::with_seed(3);
    for (width, height) in [(80, 24), (120, 40), (200, 50)] {
        let mut bench = Bench::new();
        bench.keys("5");
        let mut bytes = 0;
        let mut before = None;
        for number in 0..160 {
            // 60 devices; the load changes by a third from second to second.
            let count = random.usize(500..800);
            let frames: Vec<Frame> =
                (0..count).map(|_| frame(random.u8(1..=60), 0x100 + random.u16(0..90))).collect();
            bench.second(&frames);
            let buffer = bench.buffer(width, height);
            if let Some(before) = before.replace(buffer.clone())
                && number >= 100
            {
                bytes += bytes_between(&before, &buffer);
            }
        }
        let each = bytes / 60;
        assert!(each <= 2000, "{width}×{height}: {each} bytes in a second");
    }
}

#[test]
fn zoom_keys_change_the_span_of_charts_and_bars() {
    let mut bench = Bench::new();
    bench.keys("5").seconds(700, &[frame(10, 0x101)]).seconds(130, &[frame(11, 0x102)]);
    let text = |bench: &mut Bench| one_line(&bench.screen(120, 40));
    let screen = text(&mut bench);
    assert!(screen.contains("load by device last 2m00s"), "{screen}");
    assert!(screen.contains("? @11") && !screen.contains("? @10"), "of the same span: {screen}");
    let span = |bench: &Bench| bench.app.chart_span();
    for (key, expected, title) in [
        ("-", ChartSpan::TenMinutes, "load by device last 10m00s"),
        ("-", ChartSpan::OneHour, "load by device last 13m50s"),
        ("-", ChartSpan::All, "load by device all 13m50s"),
        ("-", ChartSpan::All, "no other span of time"),
        ("+", ChartSpan::OneHour, "load by device last 13m50s"),
        ("+", ChartSpan::TenMinutes, "load by service last 10m00s"),
        ("+", ChartSpan::TwoMinutes, "load by device last 2m00s"),
    ] {
        let screen = text(bench.keys(key));
        assert!(screen.contains(title), "{key} {title}: {screen}");
        assert_eq!(span(&bench), expected);
        assert_eq!(screen.contains("? @10"), expected != ChartSpan::TwoMinutes, "{screen}");
    }
}

#[test]
fn receive_buffer_says_how_much_it_holds_and_how_full_it_was() {
    let status = BusStatus {
        link: Link::Up,
        bitrate: Some(125_000),
        receive_buffer: Some(212_992),
        most_waiting: 12,
        ..BusStatus::default()
    };
    let mut bench = Bench::new().status(status);
    let screen = one_line(&bench.keys("5").seconds(40, &[frame(10, 0x101); 50]).screen(120, 40));
    assert!(screen.contains("receive buffer 266 frames (5.3 s), max 12"), "{screen}");
    let screen = one_line(&bench.screen(80, 24));
    assert!(screen.contains("receive buffer 266 frames (5.3 s), max 12"), "{screen}");
    // A log has none.
    let mut bench = Bench::new();
    let screen = bench.keys("5").seconds(5, &[frame(10, 0x101)]).screen(120, 40);
    assert!(screen.contains("receive buffer –"), "{screen}");
}

#[test]
fn chart_of_an_hour_shows_its_first_seconds() {
    let mut stage = Stage::boiler();
    stage.until(20.0).size(120, 40).keys("5 v v");
    let screen = stage.screen();
    let of = |what: &str| screen.lines().find(|line| line.contains(what)).unwrap().to_owned();
    assert!(screen.contains("1 h"), "{screen}");
    let load = of(" load, %");
    let most: f64 = load.split_once("max ").unwrap().1.split(' ').next().unwrap().parse().unwrap();
    let top: f64 = of("┤").split('┤').next().unwrap().trim().parse().unwrap();
    assert!(top >= most, "{screen}");
    assert!(of("▼").contains("12:00:19▼") || of("▼").contains("12:00:20▼"), "{screen}");
    let rows = screen.lines().skip_while(|line| !line.contains(" load, %"));
    let mut chart = rows.skip(1).take_while(|line| line.contains('┤') || line.contains('│'));
    let is_drawn = |line: &str| {
        line.chars().any(|c| ('\u{2800}'..='\u{28FF}').contains(&c) || ('▁'..='█').contains(&c))
    };
    assert!(chart.any(is_drawn), "{screen}");
}
