//! The screen of `descan fleet`: documents, keys and time as input; rows, effects and screens as output.

use crate::common::harness::text_of;
use crate::screen::text_snapshot;
use descan::app::{
    BrokerLink, FleetEffect, FleetPage, FleetRow, FleetScreen, FleetScreenOptions,
    MAX_GATEWAY_VERSIONS, Mouse, MouseKind,
};
use descan::fleet::{MAX_DOCUMENT_BYTES, MAX_GATEWAY_DOCUMENTS};
use descan::keymap::Key;
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use serde_json::{Value, json};

/// 2026-11-27 12:00:00.
const UNIX_START: f64 = 1_795_780_800.0;

/// The screen, and the present.
struct FleetStage {
    screen: FleetScreen,
    now: Instant,
}

impl FleetStage {
    /// A connected screen without gateways.
    fn new(columns: u16, rows: u16) -> Self {
        let screen = FleetScreen::new(FleetScreenOptions {
            broker: "mqtts://broker.example.org:8883".to_owned(),
            unix_start: UNIX_START,
            ..FleetScreenOptions::default()
        });
        let mut stage = Self { screen, now: Instant::ZERO };
        stage.screen.handle_resize(columns, rows);
        stage.connect();
        stage
    }

    fn connect(&mut self) -> &mut Self {
        self.screen.handle_connected(self.now);
        self.screen.handle_subscribed(self.now, 0);
        self
    }

    /// Calls due timeouts until `seconds` later.
    fn wait(&mut self, seconds: f64) -> &mut Self {
        let end = self.now + Duration::from_secs_f64(seconds);
        while let Some(at) = self.screen.poll_timeout().filter(|at| *at <= end) {
            self.screen.handle_timeout(at);
            assert!(self.screen.poll_timeout().is_none_or(|next| next > at));
        }
        self.now = end;
        self
    }

    fn send(&mut self, topic: &str, document: &Value) -> &mut Self {
        self.send_bytes(topic, document.to_string().as_bytes())
    }

    fn send_bytes(&mut self, topic: &str, payload: &[u8]) -> &mut Self {
        let topic = format!("descan/v1/{topic}");
        let is_kept = *self.screen.link() == BrokerLink::Reading;
        self.screen.handle_message(self.now, topic.as_bytes(), payload, is_kept);
        self
    }

    fn keys(&mut self, keys: &str) -> &mut Self {
        for key in keys.split(' ') {
            self.screen.handle_key(self.now, Key::parse(key).unwrap());
        }
        self
    }

    fn filter(&mut self, line: &str) -> &mut Self {
        self.keys("/ Ctrl-u");
        self.screen.handle_paste(self.now, line);
        self.keys("Enter")
    }

    /// Names of the gateways, or of the devices, in the rows.
    fn names(&mut self) -> String {
        self.screen.prepare();
        let name = |row: &FleetRow| match row {
            FleetRow::Gateway(row) => row.name.to_string(),
            FleetRow::Device(row) => row.device.name.clone().unwrap_or_default(),
            FleetRow::Version(row) => format!("{}@{}", row.service, row.version),
            FleetRow::Problem(problem) => format!("{}:{}", problem.gateway, problem.id),
        };
        self.screen.rows().iter().map(name).collect::<Vec<_>>().join(" ")
    }

    fn effects(&mut self) -> Vec<FleetEffect> {
        std::iter::from_fn(|| self.screen.poll_effect()).collect()
    }

    /// The screen as text.
    fn screen(&mut self) -> String {
        self.screen.prepare();
        let regions = self.screen.regions().whole;
        let mut terminal = Terminal::new(TestBackend::new(regions.width, regions.height)).unwrap();
        let theme = Theme::built_in("terminal").unwrap();
        let mut scrolled = None;
        terminal
            .draw(|frame| scrolled = descan::ui::draw_fleet(&self.screen, &theme, frame))
            .unwrap();
        self.screen.handle_drawn(scrolled);
        text_of(terminal.backend().buffer())
    }

    fn status(&mut self, gateway: &str, started_ago: f64) -> &mut Self {
        let started = (UNIX_START - started_ago) as u64;
        let status = json!({
            "online": true, "started_ms": started * 1000, "time": UNIX_START, "descan": "0.1.0",
            "events": {"last": 1234, "dropped": 2},
        });
        self.send(&format!("{gateway}/status"), &status)
    }

    fn device(&mut self, gateway: &str, address: u8, name: &str, services: &str) -> &mut Self {
        let list = services.split(' ').filter_map(|it| it.split_once('@'));
        let list: Vec<Value> =
            list.map(|(name, version)| json!({"name": name, "version": version})).collect();
        let device = json!({
            "bus": "can0", "address": address, "name": name, "uid": format!("{name}{address:02}"),
            "presence": "online", "mode": "WORK", "services": list, "services_known": true,
            "heartbeat": {"period_ms": 1000.2},
            "file": {"listed": true, "address": address, "static": true},
        });
        self.send(&format!("{gateway}/device/can0/{address}"), &device)
    }

    fn bus(&mut self, gateway: &str, bus: &str) -> &mut Self {
        let document = json!({
            "name": bus, "bitrate": 125_000, "state": "error-active", "load": 0.067,
            "frames": 123_456, "errors": 3, "lost": 0,
        });
        self.send(&format!("{gateway}/bus/{bus}"), &document)
    }

    fn conflict(&mut self, gateway: &str, address: u8, confidence: &str) -> &mut Self {
        let finding = json!({
            "kind": "same-name-same-address", "confidence": confidence, "bus": "can0", "address": address,
            "addresses": [address], "names": ["ACT"], "uids": ["ACT14", "SPARE01"],
            "text": format!("Two devices answer as ACT at address {address}."),
            "remedy": "Switch one off, then give the other one another address.",
        });
        self.send(&format!("{gateway}/finding/can0/c{address}"), &finding)
    }

    /// Four gateways: one with a conflict, one lost, one with an old AUGER.
    fn fleet(columns: u16, rows: u16) -> Self {
        let mut stage = Self::new(columns, rows);
        stage.status("north", 273_000.0).bus("north", "can0").bus("north", "can1");
        stage
            .device("north", 10, "FEED", "DES@1.0 AUGER@2.2")
            .device("north", 14, "ACT", "DES@1.0");
        stage.conflict("north", 14, "confirmed");
        stage.status("east", 5000.0).bus("east", "can0");
        stage.device("east", 10, "FEED", "DES@1.0 AUGER@2.1").device(
            "east",
            12,
            "SENS",
            "DES@1.0 TEMP@1.7",
        );
        stage.status("west", 40.0).bus("west", "can0").device(
            "west",
            10,
            "FEED",
            "DES@1.0 AUGER@2.15",
        );
        stage.device("south", 20, "DISP", "DES@1.0 SCREEN@3.0").bus("south", "can0");
        stage.send("south/status", &json!({"online": false, "reason": "lost", "started_ms": 5000}));
        stage.wait(3.0);
        let event = json!({
            "event": "lost", "time": UNIX_START + 2.5, "bus": "can0", "address": 20, "name": "DISP",
        });
        stage.send("south/event", &event);
        let event = json!({
            "event": "finding", "time": UNIX_START + 2.75, "bus": "can0", "address": 14, "name": "ACT",
            "finding": {"confidence": "confirmed", "text": "Two devices answer as ACT at address 14."},
        });
        stage.send("north/event", &event);
        stage
    }
}

#[test]
fn fleet_pages_at_80_columns_are_shown() {
    let mut stage = FleetStage::fleet(80, 24);
    text_snapshot!("fleet_gateways_80", stage.screen());
    text_snapshot!("fleet_versions_80", stage.keys("2").screen());
    text_snapshot!("fleet_problems_80", stage.keys("3").screen());
    text_snapshot!("fleet_opened_80", stage.keys("1 Home Down Enter").screen());
    text_snapshot!("fleet_help_80", stage.keys("?").screen());
}

#[test]
fn fleet_pages_at_120_columns_are_shown() {
    let mut stage = FleetStage::fleet(120, 40);
    text_snapshot!("fleet_gateways_120", stage.screen());
    text_snapshot!("fleet_versions_120", stage.keys("2").screen());
    text_snapshot!("fleet_problems_120", stage.keys("3").screen());
    text_snapshot!("fleet_opened_120", stage.keys("Right 1 Down").screen());
}

#[test]
fn fleet_at_40_columns_keeps_state_and_details() {
    let mut stage = FleetStage::fleet(40, 10);
    text_snapshot!("fleet_gateways_40", stage.screen());
    text_snapshot!("fleet_device_40", stage.keys("Down Enter Enter").screen());
}

#[test]
fn fleet_of_any_size_is_drawn_without_panic() {
    let mut stage = FleetStage::fleet(80, 24);
    for keys in ["1", "2", "3", "Enter", "Esc Right 1", "Enter", "?"] {
        stage.keys(keys);
        for columns in (1..30).chain([31, 59, 60, 79, 160, 300]) {
            for rows in 1..26 {
                stage.screen.handle_resize(columns, rows);
                stage.screen();
            }
        }
    }
}

#[test]
fn two_devices_of_one_address_are_two_rows() {
    let mut stage = FleetStage::new(80, 24);
    let device = |name: &str, presence: &str| {
        json!({
            "bus": "can0", "address": 14, "name": name, "uid": name, "presence": presence,
        })
    };
    let with_others = |others: Value| {
        let mut document = device("ACT", "online");
        document["others"] = others;
        document
    };
    stage.status("north", 10.0).bus("north", "can0").conflict("north", 14, "confirmed");
    let others = json!([device("SPARE", "online"), device("OLD", "lost")]);
    stage.send("north/device/can0/14", &with_others(others)).wait(1.0);
    let row = |screen: &str, name: &str| -> String {
        let found = screen.lines().find(|line| line.contains(name));
        found.unwrap_or_else(|| panic!("{name}: {screen}")).to_owned()
    };
    let words = row(&stage.screen(), " north ");
    assert_eq!(words.split_whitespace().nth(8), Some("2"), "present: {words}");
    assert_eq!(stage.filter("name:SPARE").names(), "north");
    assert_eq!(stage.keys("Esc Enter").names(), "ACT SPARE OLD");
    let screen = stage.screen();
    for name in ["ACT", "SPARE"] {
        assert!(row(&screen, &format!("14 {name}")).contains("CONFLICT"), "{screen}");
    }
    assert!(row(&screen, "14 OLD").contains("lost"), "it left before: {screen}");
    // The selection stays on its row.
    stage.keys("Down").send("north/device/can0/9", &device("NINE", "online"));
    assert_eq!(stage.names(), "ACT SPARE OLD NINE");
    let Some(FleetRow::Device(row)) = stage.screen.selected_row() else { panic!("no device") };
    assert_eq!(row.device.name.as_deref(), Some("SPARE"));
}

/// As on the screen of the gateway itself.
#[test]
fn findings_of_a_conflict_at_one_address_are_one_problem() {
    let mut stage = FleetStage::fleet(120, 40);
    let finding = |kind: &str, confidence: &str, address: u8| {
        json!({
            "kind": kind, "confidence": confidence, "bus": "can0", "address": address,
            "addresses": [address], "names": ["ACT"], "uids": ["OTHER"],
            "text": format!("{kind} at {address}."), "remedy": "",
        })
    };
    for (id, kind, confidence, address) in [
        ("a", "one-address-two-identities", "suspected", 14),
        ("b", "one-address-two-identities", "confirmed", 15),
        ("c", "services-differ", "confirmed", 14),
    ] {
        stage.send(&format!("north/finding/can0/{id}"), &finding(kind, confidence, address));
    }
    assert_eq!(stage.keys("3").names(), "north:c14 north:b north:c");
    let screen = stage.screen();
    assert!(screen.contains("3 Problems 3 "), "{screen}");
    assert!(!screen.contains("? 1"), "the suspected one is of the same conflict: {screen}");
    let what = ["ACT at address 14.", "one-address-two-identities at 14."];
    assert!(what.iter().all(|text| screen.contains(text)), "{screen}");
    // Each of its findings is found.
    assert_eq!(stage.filter("kind:two-identities").names(), "north:c14 north:b");
    assert_eq!(stage.filter("uid:OTHER text:\"two-identities at 14\"").names(), "north:c14");
    assert_eq!(stage.filter("is:suspected").names(), "");
}

#[test]
fn file_that_a_gateway_cannot_use_is_named() {
    let mut stage = FleetStage::fleet(80, 24);
    let status = json!({
        "online": true, "time": UNIX_START,
        "file": {"path": "/etc/des.json", "ok": false, "error": "line 3, column 5: a comma is missing"},
    });
    stage.send("east/status", &status).wait(1.0);
    assert_eq!(stage.filter("err").names(), "north east");
    stage.keys("Esc");
    let screen = stage.filter("east").screen();
    let text = "/etc/des.json: line 3, column 5: a comma is missing";
    assert!(screen.lines().any(|line| line.contains(" east ") && line.contains('✗')), "{screen}");
    assert!(
        screen.lines().any(|line| line.contains("des.json") && line.contains(text)),
        "{screen}"
    );
    let screen = stage.keys("Enter").screen();
    assert!(screen.contains(&format!(" ! not used there: {text}")), "{screen}");
}

#[test]
fn details_of_a_gateway_that_do_not_fit_are_scrolled() {
    let mut stage = FleetStage::new(80, 24);
    stage.status("north", 60.0);
    for bus in 0..40 {
        stage.bus("north", &format!("can{bus}"));
    }
    stage.wait(3.0);
    let screen = stage.screen();
    assert!(screen.contains(" more, Right shows all"), "{screen}");
    let screen = stage.keys("Right").screen();
    assert!(screen.contains(" can14 ") && !screen.contains("GATEWAY"), "{screen}");
    assert!(screen.contains("↓ ") && !screen.contains("Right"), "{screen}");
    let screen = stage.keys("End").screen();
    assert!(screen.contains(" can39 ") && !screen.contains("↓ "), "{screen}");
    let screen = stage.keys("Left").screen();
    assert!(screen.contains("GATEWAY") && stage.screen.opened().is_none(), "{screen}");
    stage.keys("Right Enter");
    assert!(stage.screen.opened().is_some(), "Enter opens the gateway from there, too");
}

#[test]
fn gateway_whose_documents_are_cleared_is_an_event() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.wait(1.0).keys("1");
    for topic in ["west/status", "west/bus/can0", "west/device/can0/20"] {
        stage.send_bytes(topic, b"");
    }
    let addresses: Vec<u8> = (0..127).collect();
    for address in addresses {
        stage.send_bytes(&format!("west/device/can0/{address}"), b"");
    }
    assert_eq!(stage.names(), "south north east");
    let screen = stage.screen();
    assert!(screen.contains("no documents any more"), "{screen}");
}

#[test]
fn last_wills_of_a_broker_that_ends_lose_no_gateway() {
    for (since_will, expected) in [(0.5, "3 online  ○ 1 lost"), (3.0, "1 online  ○ 3 lost")] {
        let mut stage = FleetStage::fleet(80, 24);
        let status = json!({
            "online": true, "time": UNIX_START, "started_ms": 1,
            "file": {"path": "des.json", "ok": false, "error": "line 3: a comma is missing"},
        });
        stage.send("west/status", &status).wait(2.0).screen();
        let will = json!({"online": false, "reason": "lost", "started_ms": 1, "descan": "0.1.0"});
        stage.send("north/status", &will).send("east/status", &will);
        stage.screen();
        stage.wait(since_will);
        // The other one was lost just now, by the same broker.
        stage.send("west/status", &will);
        let refused = "mqtts://broker.example.org:8883: connection refused".to_owned();
        stage.screen.handle_failed(stage.now, refused, Duration::from_mins(1));
        let screen = stage.screen();
        assert!(screen.contains("AS OF"), "{screen}");
        assert!(screen.contains(expected), "{since_will}: {screen}");
        let west = screen.lines().find(|line| line.contains(" west ")).unwrap();
        assert!(west.contains('✗'), "its file is as it was: {screen}");
        // It is the state of then: another failure changes nothing, a connection does.
        stage.wait(1.0);
        let refused = "connection refused".to_owned();
        stage.screen.handle_failed(stage.now, refused, Duration::from_mins(1));
        assert!(stage.screen().contains(expected));
        stage.connect().send("east/status", &will).send("north/status", &will);
        stage.wait(2.0);
        let screen = stage.screen();
        assert!(screen.contains("2 lost"), "{screen}");
    }
}

#[test]
fn versions_of_a_gateway_are_bounded() {
    let mut stage = FleetStage::new(80, 24);
    stage.status("evil", 10.0).status("good", 10.0);
    for address in 1..=4 {
        let names = (0..400).map(|number| format!("S{address}x{number}@1.0"));
        stage.device("evil", address, "EVIL", &names.collect::<Vec<_>>().join(" "));
    }
    stage.device("good", 9, "GOOD", "S1x1@1.0 OWN@1.0").device("good", 10, "GOOD", "OWN@1.0");
    assert_eq!(stage.wait(1.0).keys("2").names().split(' ').count(), MAX_GATEWAY_VERSIONS + 1);
    let screen = stage.keys("1").screen();
    assert!(screen.contains("versions  more than 1,500: not all are listed"), "{screen}");
    let screen = stage.keys("Down").screen();
    assert!(!screen.contains("not all are listed"), "{screen}");
    // What is listed counts all its devices.
    stage.device("evil", 5, "EVIL", "S1x1@1.0 S5x1@1.0").keys("2").filter("srv:=S1x1@1.0");
    stage.names();
    let Some(FleetRow::Version(row)) = stage.screen.selected_row() else { panic!("no version") };
    assert_eq!((row.devices, row.gateways), (3, 2));
}

#[test]
fn gateways_are_sorted_worst_first_then_by_name() {
    let mut stage = FleetStage::fleet(80, 24);
    assert_eq!(stage.names(), "south north east west");
    assert_eq!(stage.keys("s").names(), "east north south west");
    assert_eq!(stage.keys("S").names(), "west south north east");
    assert_eq!(stage.keys("s").names(), "east north south west", "as many devices, by name");
    let mut stage = FleetStage::fleet(80, 24);
    for (state, names) in [
        ("bus-off", "south north west east"),
        ("error-active", "south north east west"),
        ("down", "south north west east"),
        ("stopped", "south north west east"),
        ("error-passive", "south north east west"),
    ] {
        stage.send("west/bus/can0", &json!({"name": "can0", "state": state}));
        assert_eq!(stage.names(), names, "{state}");
    }
}

#[test]
fn gateways_are_filtered_by_what_their_devices_have() {
    let mut stage = FleetStage::fleet(80, 24);
    for (line, names) in [
        ("srv:AUGER", "north east west"),
        ("srv:AUGER@2.1", "east west"),
        ("srv:=AUGER@2.1", "east"),
        ("srv:=AUGER", "north east west"),
        ("auger !east", "north west"),
        ("name:SENS,DISP", "south east"),
        ("uid:ACT14", "north"),
        ("at:12", "east"),
        ("bus:can1", "north"),
        ("is:lost or is:conflict", "south north"),
        ("err", "north"),
        ("nor", "north"),
        ("mode:work", "south north east west"),
    ] {
        assert_eq!(stage.filter(line).names(), names, "{line}");
    }
    stage.keys("Esc");
    assert_eq!(stage.names(), "south north east west");
    assert_eq!(stage.keys("\\").filter("at:14").keys("Enter").names(), "ACT FEED");
    assert_eq!(stage.filter("srv:AUGER@2.2").names(), "FEED");
}

#[test]
fn filter_with_mistake_shows_all_rows_and_says_why() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.filter("at:12").keys("/ Space");
    stage.screen.handle_paste(stage.now, "len:4");
    assert_eq!(stage.names(), "south north east west", "not by a part of what is typed");
    let (error, column) = stage.screen.prompt().unwrap().error.clone().unwrap();
    assert!(error.contains("gateways have no field len") && column == 7, "{error} {column}");
    // The whole mistake, above the line that is typed, also after Enter.
    for key in ["Left", "Enter"] {
        let screen = stage.keys(key).screen();
        let words = screen.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains("✗ len:4: gateways have no field len; use at: "), "{screen}");
        assert!(words.contains(", column 7 filter: at:12 len:4"), "{screen}");
    }
    // The mouse leaves the prompt alone.
    let tabs = stage.screen.tabs();
    let press =
        Mouse { kind: MouseKind::Press, column: tabs[2].1, row: stage.screen.regions().tabs.y };
    stage.screen.handle_mouse(stage.now, press);
    assert_eq!(stage.screen.page(), FleetPage::Main);
    assert!(stage.keys("Esc").screen.prompt().is_none());
    assert_eq!((stage.names(), stage.screen.filter().text.as_str()), ("east".to_owned(), "at:12"));
    // One that was off stays off.
    assert_eq!(stage.keys("\\ / x Esc").names(), "south north east west");
}

#[test]
fn filter_without_match_names_the_key_once_it_is_entered() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.keys("/");
    stage.screen.handle_paste(stage.now, "at:99");
    let screen = stage.screen();
    assert!(screen.contains("no gateways match the filter"), "{screen}");
    assert!(!screen.contains("switches it off"), "Esc goes back to all: {screen}");
    let screen = stage.keys("Enter").screen();
    assert!(screen.contains("no gateways match the filter; Esc switches it off"), "{screen}");
}

#[test]
fn tab_completes_services_with_versions() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.keys("/");
    stage.screen.handle_paste(stage.now, "srv:au");
    stage.keys("Tab");
    assert_eq!(stage.screen.prompt().unwrap().input.value(), "srv:AUGER@2.1");
    stage.keys("Tab Tab");
    assert_eq!(stage.screen.prompt().unwrap().input.value(), "srv:AUGER@2.2");
}

#[test]
fn enter_on_version_shows_gateways_that_have_it() {
    let mut stage = FleetStage::fleet(80, 24);
    assert_eq!(
        stage.keys("2").names(),
        "AUGER@2.1 AUGER@2.2 AUGER@2.15 DES@1.0 SCREEN@3.0 TEMP@1.7"
    );
    assert_eq!(stage.keys("Home Enter").names(), "east");
    assert_eq!(stage.screen.page(), FleetPage::Main);
    assert_eq!(stage.keys("2").filter("2.1").names(), "AUGER@2.1 AUGER@2.15");
}

#[test]
fn cursor_stays_on_gateway_when_others_vanish() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.names();
    stage.keys("Down Down");
    let selected = |stage: &mut FleetStage| {
        stage.screen.prepare();
        match stage.screen.selected_row() {
            Some(FleetRow::Gateway(row)) => row.name.to_string(),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(selected(&mut stage), "east");
    for topic in ["status", "bus/can0", "device/can0/20"] {
        stage.send_bytes(&format!("south/{topic}"), b"");
    }
    assert_eq!((selected(&mut stage), stage.names()), ("east".into(), "north east west".into()));
    stage.conflict("west", 10, "confirmed").conflict("west", 11, "confirmed");
    assert_eq!(selected(&mut stage), "east");
    for topic in ["status", "bus/can0", "device/can0/10", "device/can0/12"] {
        stage.send_bytes(&format!("east/{topic}"), b"");
    }
    assert_eq!(selected(&mut stage), "west", "the row at its place");
}

#[test]
fn lost_connection_keeps_rows_and_marks_them_old() {
    let mut stage = FleetStage::fleet(120, 24);
    let cause = "mqtts://broker.example.org:8883: connection refused; check host and port";
    stage.screen.handle_failed(stage.now, cause.to_owned(), Duration::from_secs(8));
    stage.wait(3.0);
    let screen = stage.screen();
    assert!(screen.contains("connection refused; next attempt in 5 s; check host"), "{screen}");
    assert!(screen.contains("no connection") && screen.contains("AS OF 12:00:03"), "{screen}");
    assert_eq!(stage.names(), "south north east west");
}

#[test]
fn long_banner_has_two_lines_and_a_key_connects_at_once() {
    let mut stage = FleetStage::fleet(80, 24);
    let cause = "mqtts://broker.example.org:8883: the certificate is not that of a known \
                 authority; name the certificate that signed it with --ca FILE";
    stage.screen.handle_failed(stage.now, cause.to_owned(), Duration::from_secs(8));
    let screen = stage.screen();
    let lines = " ! the certificate is not that of a known authority; next attempt in 8 s; name\n   \
                 the certificate that signed it with --ca FILE\n─1 Gateways";
    let trimmed = screen.lines().map(str::trim_end).collect::<Vec<_>>().join("\n");
    assert!(trimmed.contains(lines), "{screen}");
    let screen = stage.keys("r").screen();
    assert!(screen.contains("next attempt now; name"), "{screen}");
    assert_eq!(stage.screen.poll_effect(), Some(FleetEffect::Reconnect));
    stage.connect();
    let screen = stage.keys("r").screen();
    assert!(screen.contains("connected already"), "{screen}");
    assert_eq!(stage.screen.poll_effect(), None);
}

#[test]
fn documents_cleared_meanwhile_vanish_after_two_quiet_seconds() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.screen.handle_failed(stage.now, "lost".to_owned(), Duration::from_secs(1));
    stage.wait(10.0).connect();
    stage.status("north", 9.0).device("north", 14, "ACT", "DES@1.0");
    stage.wait(1.5).status("east", 9.0).wait(1.5);
    assert_eq!(*stage.screen.link(), BrokerLink::Reading);
    assert_eq!(stage.names(), "south north east west");
    stage.wait(1.0);
    assert_eq!(*stage.screen.link(), BrokerLink::Connected);
    assert_eq!(stage.names(), "east north");
    assert_eq!(stage.keys("Down Enter").names(), "ACT");
}

#[test]
fn stopped_program_waits_again_before_it_clears() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.connect();
    // Ctrl-Z for a minute: what the broker sent is not read yet.
    stage.now += Duration::from_mins(1);
    stage.screen.handle_timeout(stage.now);
    assert_eq!(*stage.screen.link(), BrokerLink::Reading);
    assert_eq!(stage.names(), "south north east west");
}

#[test]
fn gateway_is_lost_for_as_long_after_another_connection() {
    let lost = json!({"online": false, "reason": "lost", "started_ms": 5000});
    let mut stage = FleetStage::fleet(80, 24);
    // South was lost before the first connection, east while connected.
    stage.wait(10.0).send("east/status", &lost).wait(40.0);
    stage.screen.handle_failed(stage.now, "lost".to_owned(), Duration::from_secs(1));
    stage.wait(2.0).connect();
    stage.send("south/status", &lost).send("east/status", &lost);
    // West was lost meanwhile.
    stage.send("west/status", &lost);
    stage.wait(5.0);
    let screen = stage.screen();
    for (gateway, age) in [("south", " >1m "), ("east", " 47s "), ("west", " >5s ")] {
        let row = screen.lines().find(|line| line.contains(&format!(" {gateway} "))).unwrap();
        assert!(row.contains(age), "{gateway} {age}: {screen}");
    }
}

#[test]
fn documents_are_kept_until_the_subscription_is_there() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.screen.handle_failed(stage.now, "lost".to_owned(), Duration::from_secs(1));
    stage.screen.handle_connected(stage.now);
    stage.wait(10.0);
    assert_eq!(stage.names(), "south north east west");
    stage.screen.handle_subscribed(stage.now, 0);
    stage.wait(3.0);
    assert_eq!(stage.names(), "");
}

/// What the broker kept shows that the gateway was connected then, not that it is.
#[test]
fn kept_status_does_not_show_that_a_gateway_is_connected() {
    let old = json!({"online": true, "started_ms": 5000, "time": UNIX_START - 600.0});
    let mut stage = FleetStage::new(80, 24);
    stage.send("old/status", &old).wait(3.0);
    let screen = stage.screen();
    assert!(screen.contains("silent 10m"), "{screen}");
    // Another one shows it, whatever the clock of the gateway is.
    stage.send("old/status", &old);
    assert_eq!(stage.filter("is:online").names(), "old");
    stage.wait(80.0);
    assert_eq!(stage.filter("is:silent").names(), "old");
    // The same again after another connection.
    stage.screen.handle_failed(stage.now, "lost".to_owned(), Duration::from_secs(1));
    stage.connect().send("old/status", &old).wait(3.0);
    assert_eq!(stage.names(), "old");
}

#[test]
fn escape_switches_the_filter_off_before_it_leaves_a_gateway() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.filter("east").keys("Enter");
    stage.filter("zzz");
    assert!(stage.screen().contains("Esc switches it off"), "{}", stage.screen());
    stage.keys("Esc");
    assert!(stage.screen.opened().is_some());
    assert!(!stage.names().is_empty());
    // The prompt uses the line that it shows, and does not go on with one that is off.
    let screen = stage.keys("/").screen();
    assert!(!screen.contains("zzz") && !screen.contains("0 of"), "{screen}");
    stage.keys("Esc \\");
    let screen = stage.screen();
    assert!(screen.contains("filter on: zzz"), "{screen}");
    let screen = stage.keys("/").screen();
    assert!(screen.contains("zzz") && screen.contains("0 of"), "{screen}");
    stage.keys("Esc Esc Esc");
    assert!(stage.screen.opened().is_none());
}

#[test]
fn nothing_is_said_of_gateways_before_the_first_connection() {
    let mut stage = FleetStage::new(80, 24);
    stage.screen.handle_failed(stage.now, "connection refused".to_owned(), Duration::from_secs(1));
    for page in ["1", "2", "3"] {
        let screen = stage.keys(page).screen();
        assert!(screen.contains("not connected to the broker yet"), "{screen}");
        assert!(!screen.contains("AS OF") && !screen.contains("no problems"), "{screen}");
    }
}

#[test]
fn gateway_without_status_for_75_seconds_is_silent() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.wait(60.0).status("east", 5000.0).wait(20.0);
    assert_eq!(stage.filter("is:silent").names(), "north west");
}

#[test]
fn malicious_documents_are_counted_and_shown_escaped() {
    let mut stage = FleetStage::fleet(120, 24);
    stage.send_bytes("evil/device/can0/5", b"\x1b[31m");
    stage.send_bytes("evil/bus/can0", &vec![b' '; MAX_DOCUMENT_BYTES + 1]);
    stage.send_bytes("north/event", b"{}");
    stage.send("west/device/can0/9", &json!({"address": 9, "name": "\u{1b}[2J\u{202e}x"}));
    let screen = stage.screen();
    assert!(
        screen.contains("3 documents not used; the last is descan/v1/north/event: no event"),
        "{screen}"
    );
    let screen = stage.filter("west").keys("Enter").screen();
    assert!(screen.contains("\\x1B[2J"), "{screen}");
    assert!(!screen.contains(['\u{1b}', '\u{202e}']));
}

#[test]
fn banner_ends_when_the_unusable_document_is_replaced() {
    let mut stage = FleetStage::fleet(120, 24);
    stage.send_bytes("west/device/can0/9", b"{").send_bytes("west/event", b"[]");
    let screen = stage.screen();
    let banner = "2 documents not used; the last is descan/v1/west/event: no event";
    assert!(screen.contains(banner), "{screen}");
    // A long topic leaves room for the cause.
    stage.send_bytes(&format!("{}/event", "w".repeat(120)), b"[]");
    let screen = stage.screen();
    assert!(screen.contains("w…: no "), "{screen}");
    stage.send_bytes(&format!("{}/event", "w".repeat(120)), b"");
    stage.device("west", 9, "NINE", "DES@1.0");
    let screen = stage.screen();
    assert!(screen.contains("not used"), "{screen}");
    stage.send("west/event", &json!({"event": "lost", "address": 9}));
    // One that the broker keeps is cleared like a document.
    stage.send_bytes("east/event", b"[]").send_bytes("east/event", b"");
    let screen = stage.screen();
    assert!(!screen.contains("not used"), "{screen}");
}

#[test]
fn devices_of_gateways_that_are_not_online_are_last_known() {
    let mut stage = FleetStage::fleet(120, 24);
    let screen = stage.screen();
    assert!(screen.contains("devices  ● 5 present  · 1 last known  ⚠ 1"), "{screen}");
    stage.wait(60.0).status("east", 5000.0).wait(20.0);
    let screen = stage.screen();
    assert!(screen.contains("● 2 present  · 4 last known"), "silent ones: {screen}");
}

#[test]
fn gateways_that_come_and_go_are_events() {
    let mut stage = FleetStage::fleet(80, 24);
    let screen = stage.screen();
    assert!(!screen.contains(" gateway  "), "nothing of the first reading: {screen}");
    stage.send("east/status", &json!({"online": false, "reason": "lost", "started_ms": 5000}));
    let screen = stage.screen();
    assert!(screen.contains(" 12:00:03 ○ east             gateway          lost"), "{screen}");
    stage
        .wait(2.0)
        .status("east", 1.0)
        .send("west/status", &json!({"online": false, "reason": "stopped"}));
    stage.status("new", 1.0);
    let screen = stage.screen();
    for line in [
        " 12:00:05 ~ east             gateway          online",
        " 12:00:05 ~ new              gateway          online",
        " 12:00:05 · west             gateway          stopped",
    ] {
        assert!(screen.contains(line), "{screen}");
    }
    // A status that says nothing new; silence.
    stage.status("east", 1.0).wait(100.0);
    assert!(stage.screen().contains(" 12:00:05 · west             gateway          stopped"));
}

#[test]
fn sums_lose_the_words_of_devices_first() {
    let mut stage = FleetStage::fleet(100, 24);
    let mut sums = |columns| {
        stage.screen.handle_resize(columns, 24);
        stage.screen().lines().nth(1).unwrap().trim_end().to_owned()
    };
    let gateways = " 4 gateways  ● 3 online  ○ 1 lost    devices";
    assert_eq!(sums(80), format!("{gateways}  ● 5 present  · 1 last known  ⚠ 1"));
    assert_eq!(sums(70), format!("{gateways}  ● 5  · 1  ⚠ 1"));
    assert_eq!(sums(50), " 4 ●3 ○1  dev ●5 ·1 ⚠1");
}

#[test]
fn message_ends_by_itself() {
    let mut stage = FleetStage::fleet(80, 24);
    assert!(stage.keys("s").screen().contains("sorted by"));
    stage.wait(5.5);
    assert!(stage.screen().contains("sorted by"));
    stage.wait(1.0);
    assert!(stage.screen().contains("? help"), "{}", stage.screen());
}

#[test]
fn device_of_lost_gateway_is_last_known() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.names();
    let screen = stage.keys("Enter").screen();
    assert!(screen.contains("state     last known online; mode WORK"), "{screen}");
}

#[test]
fn key_without_use_is_named() {
    let mut stage = FleetStage::fleet(80, 24);
    for key in ["4", "x", "F9"] {
        let screen = stage.keys(key).screen();
        let message = format!("{key} has no use here; ? lists the keys");
        assert!(screen.contains(&message), "{screen}");
    }
}

#[test]
fn help_lists_states_of_the_rows_of_the_page() {
    let mut stage = FleetStage::fleet(120, 90);
    let states = "online, silent, stopped, lost, unknown, conflict, suspected";
    let help = stage.keys("?").screen();
    assert!(help.contains(states) && !help.contains("frames"), "{help}");
    let help = stage.keys("Esc 3 ?").screen();
    assert!(help.contains(" suspected, confirmed") && !help.contains(states), "{help}");
}

#[test]
fn numbers_of_hidden_rows_cut_no_heading() {
    let mut stage = FleetStage::fleet(80, 24);
    for number in 0..30 {
        stage.status(&format!("more{number:02}"), 10.0);
    }
    let screen = stage.screen();
    let headings = screen.lines().find(|line| line.contains("GATEWAY")).unwrap();
    let words: Vec<&str> = headings.split_whitespace().collect();
    assert!(words.ends_with(&["PROBLEMS", "↓24"]), "{headings:?}");
}

#[test]
fn documents_of_one_gateway_are_bounded() {
    let mut stage = FleetStage::new(80, 24);
    for number in 0..=MAX_GATEWAY_DOCUMENTS {
        stage.send(
            &format!("big/device/bus{}/{}", number / 100, number % 100),
            &json!({"address": 1}),
        );
    }
    assert_eq!(stage.screen.rejects().oversized, 1);
    assert!(stage.screen.rejects().last().unwrap().ends_with(": too many documents"));
    stage.status("big", 5.0).send("big/device/bus0/0", &json!({"address": 1, "name": "A"}));
    assert_eq!(stage.screen.rejects().oversized, 1, "known documents are replaced");
}

/// Each device of an address counts: a document of 128 kB could have thousands.
#[test]
fn devices_of_one_gateway_are_bounded() {
    let mut stage = FleetStage::new(80, 24);
    let others: Vec<Value> =
        (0..500).map(|at| json!({"address": 1, "name": format!("N{at}")})).collect();
    let document = json!({"address": 1, "name": "A", "others": others});
    for bus in 0..100 {
        stage.send(&format!("big/device/bus{bus}/1"), &document);
    }
    stage.status("big", 5.0).wait(3.0);
    let devices = stage.filter("big").keys("Enter").names().split(' ').count();
    assert!((4000..=MAX_GATEWAY_DOCUMENTS + 100).contains(&devices), "{devices}");
    assert!(stage.screen.rejects().oversized > 0);
}

#[test]
fn silent_gateway_stays_silent_when_the_broker_ends() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.wait(60.0).status("east", 5000.0).wait(20.0);
    let will = json!({"online": false, "reason": "lost", "started_ms": 1, "descan": "0.1.0"});
    stage.send("north/status", &will).wait(0.5);
    assert_eq!(stage.filter("is:silent").names(), "west");
    stage.screen.handle_failed(stage.now, "lost".to_owned(), Duration::from_secs(1));
    assert_eq!(stage.names(), "north west");
}

#[test]
fn copied_commands_lead_to_gateway_and_bus() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.names();
    stage.keys("Down y Enter y");
    let copied = |text: &str| FleetEffect::Copy(text.to_owned());
    let expected = [copied("ssh north"), copied("descan socketcand://north:29536/can0")];
    assert_eq!(stage.effects(), expected);
}

#[test]
fn names_that_a_shell_reads_otherwise_have_no_command() {
    let name = |text: &str| text.parse().unwrap();
    assert_eq!(FleetScreen::shell_command(&name("-oProxy")), None);
    assert_eq!(FleetScreen::live_command(&name("north"), "can0;reboot"), None);
    assert_eq!(FleetScreen::live_command(&name("north"), "sim:boiler"), None);
    assert_eq!(FleetScreen::live_command(&name("north"), "-can0"), None);
    let live = FleetScreen::live_command(&name("north"), "can0");
    assert_eq!(live.as_deref(), Some("descan socketcand://north:29536/can0"));
}

#[test]
fn keys_of_program_lead_to_effects() {
    use FleetEffect as E;
    let mut stage = FleetStage::fleet(80, 24);
    stage.keys("t Ctrl-l Ctrl-z q / x Ctrl-c");
    assert_eq!(stage.effects(), [E::NextTheme, E::Redraw, E::Suspend, E::Quit, E::Quit]);
}

#[test]
fn clicks_select_rows_and_pages() {
    let mut stage = FleetStage::fleet(80, 24);
    stage.names();
    let mut click = |column, row| {
        stage.screen.handle_mouse(stage.now, Mouse { kind: MouseKind::Press, column, row });
        (stage.screen.selected(), stage.screen.page())
    };
    assert_eq!(click(20, 6), (Some(2), FleetPage::Main));
    assert_eq!(click(20, 12), (Some(2), FleetPage::Main), "below the rows");
    assert_eq!(click(15, 2).1, FleetPage::Versions);
}
