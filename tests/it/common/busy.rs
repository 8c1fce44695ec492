//! A busy bus in simulated time, its program, and a terminal that counts the bytes it gets.
//!
//! 127 devices, each with a heartbeat every second, and periodic data up to a rate. What the program
//! writes is what it writes to a terminal: the changed cells, through the backend of the real one.

use super::harness::text_of;
use super::paced::PacedScreen;
use descan::app::{App, AppOptions, Effect, FileIndex, FileReading};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::keymap::Key;
use descan::sim::{Fault, Scenario, Sim, SimStation};
use descan::status::{BusState, BusStatus, Link};
use descan::theme::Theme;
use descan::time::{Duration, Epoch, Instant};
use descan::ui;
use descan::wire::id::{Address, Header, Service};
use descan::wire::node::Uid;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

const DEVICES: u16 = 127;
/// Time between two wake-ups of the program by a reader of frames.
const BATCH: Duration = Duration::from_millis(10);
const FILE: &str = r#"{ "devices": [ { "name": "N010", "address": 10, "static": true } ] }"#;

pub struct Busy {
    pub app: App,
    pub screen: PacedScreen,
    sim: Sim,
    station: SimStation,
    /// Frames of periodic data in a second.
    rate: u64,
    sent: u64,
    random: fastrand::Rng,
    theme: Theme,
}

impl Busy {
    /// Starts a bus with this many frames per second, at least 127; with a second board at address 20
    /// or without.
    pub fn new(rate: u64, (columns, rows): (u16, u16), has_conflict: bool) -> Self {
        // A full bus of classic frames has 7,000 frames a second at 1 Mbit/s.
        let mut scenario = Scenario::with_many_devices(2_000_000, usize::from(DEVICES), 5);
        if has_conflict {
            let mut second = scenario.devices[19].clone().fault(Fault::KeepsAddress);
            scenario.devices[19] = second.clone();
            "SECOND".clone_into(&mut second.label);
            second.uid = Uid([9, 9, 9, 9, 9, 20]);
            second.power_on = Some(Duration::from_millis(1300));
            scenario.devices.push(second);
        }
        let mut sim = Sim::new(&scenario, 1);
        let station = sim.attach();
        let config = Config { seed: 7, bitrate: Some(2_000_000), ..Config::default() };
        let options = AppOptions {
            // 2026-11-21 12:00:00 UTC.
            epoch: Epoch::from_unix_micros(1_795_262_400_000_000),
            buses: vec![("can0".to_owned(), config)],
            file_path: Some("des.json".into()),
            theme: "dark".to_owned(),
            learns_profile: true,
            ..AppOptions::default()
        };
        let mut app = App::new(Instant::ZERO, options);
        app.handle_resize(columns, rows);
        let status = BusStatus {
            link: Link::Up,
            state: BusState::ErrorActive,
            bitrate: Some(2_000_000),
            ..BusStatus::default()
        };
        app.handle_bus(Instant::ZERO, BusIndex(0), status);
        app.handle_file(
            Instant::ZERO,
            FileIndex::default(),
            FileReading::Content(Some(FILE.as_bytes().to_vec())),
        );
        Self {
            app,
            screen: PacedScreen::new(columns, rows),
            sim,
            station,
            rate: rate.saturating_sub(u64::from(DEVICES)),
            sent: 0,
            random: fastrand::Rng::with_seed(5),
            theme: Theme::built_in("dark").expect("a built-in theme"),
        }
    }

    /// Runs the bus and the program for this time.
    pub fn run(&mut self, time: Duration) -> &mut Self {
        let end = self.app.now() + time;
        while self.app.now() < end {
            let now = (self.app.now() + BATCH).min(end);
            while let Some(due) = self.app.poll_timeout().filter(|due| *due <= now) {
                self.app.handle_timeout(due);
                self.drain(due);
                self.paint(due);
            }
            let frames = self.frames_until(now);
            self.app.handle_frames(now, &frames);
            self.drain(now);
            self.paint(now);
        }
        self
    }

    /// Presses keys, written as in keys.toml and separated by blanks.
    pub fn keys(&mut self, keys: &str) -> &mut Self {
        for text in keys.split_whitespace() {
            self.key(Key::parse(text).unwrap_or_else(|| panic!("{text} is no key")));
        }
        self
    }

    pub fn key(&mut self, key: Key) {
        self.screen.pace.note_key(self.app.now());
        self.app.handle_key(self.app.now(), key);
        self.drain(self.app.now());
    }

    /// Presses a key and draws; returns how long that takes, in milliseconds.
    #[allow(dead_code, reason = "a bench uses it")]
    pub fn time_of_key(&mut self, key: &str) -> f64 {
        let key = Key::parse(key).expect("a key");
        let start = std::time::Instant::now();
        self.key(key);
        self.screen.draw(self.app.now(), &mut self.app, &self.theme);
        start.elapsed().as_secs_f64() * 1e3
    }

    /// Draws until the terminal has the whole screen, while no time passes for the bus.
    pub fn finish(&mut self) {
        let mut now = self.app.now();
        for _ in 0..1000 {
            now += Duration::from_millis(50);
            self.paint(now);
        }
    }

    /// Returns the screen as text.
    pub fn screen(&mut self) -> String {
        let (columns, rows) = self.screen.screen.size();
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("in memory");
        let drawn = terminal.draw(|frame| _ = ui::draw(&self.app, &self.theme, frame));
        text_of(drawn.expect("in memory").buffer)
    }

    /// Draws if the program would.
    fn paint(&mut self, now: Instant) {
        self.screen.paint(now, &mut self.app, &self.theme);
    }

    fn drain(&mut self, now: Instant) {
        while let Some(frame) = self.app.poll_transmit(now) {
            self.sim.transmit(self.station, frame);
        }
        while let Some(effect) = self.app.poll_effect() {
            assert_ne!(effect, Effect::Quit);
        }
    }

    /// Returns the frames of the bus after the last ones, in the order of their times.
    pub fn frames_until(&mut self, now: Instant) -> Vec<Frame> {
        self.sim.advance(now);
        let mut frames = Vec::new();
        while let Some(frame) = self.sim.poll_frame(self.station) {
            frames.push(frame);
        }
        let due = now.as_micros() * self.rate / 1_000_000;
        while self.sent < due {
            self.sent += 1;
            let at = Instant::from_micros(self.sent * 1_000_000 / self.rate);
            frames.push(self.data(at));
        }
        frames.sort_by_key(|frame| frame.time);
        frames
    }

    /// Returns the next frame of the traffic: data of each device in turn, of one of six services; every
    /// 50th is a request, and the next one its response.
    fn data(&mut self, at: Instant) -> Frame {
        let turn = self.sent / u64::from(DEVICES);
        let device = (self.sent % u64::from(DEVICES)) as u16;
        let address = |device: u16| Address::new(device as u8 + 1).expect("a node address");
        let service = |number: u16| Service::new(number).expect("ten bits");
        let turn_of_call = self.sent / 50;
        let client = address((turn_of_call % 4) as u16);
        let server = address(10 + (turn_of_call % 7) as u16);
        let call = Header::request(client, server, false, service(0x80));
        let header = match self.sent % 50 {
            0 => call,
            1 => call.response(server, false),
            _ => {
                let service = service(0x100 + device * 6 + (turn % 6) as u16);
                Header::unsolicited(address(device), self.random.u8(0..128), false, service)
            }
        };
        let mut data = [0x10; 8];
        data[..2].copy_from_slice(&(turn as u16).to_le_bytes());
        data[2] = self.random.u8(..);
        Frame::classic(header.encode(), &data).with_time(at)
    }
}

/// A page or view at rest.
pub struct BusyView {
    pub name: &'static str,
    pub keys: &'static str,
    /// A confirmed conflict is on the screen.
    pub has_conflict: bool,
}

const fn view(name: &'static str, keys: &'static str) -> BusyView {
    BusyView { name, keys, has_conflict: false }
}

const fn conflict(name: &'static str, keys: &'static str) -> BusyView {
    BusyView { name, keys, has_conflict: true }
}

pub const VIEWS: [BusyView; 22] = [
    view("Devices", "1"),
    view("Devices, details", "1 Enter"),
    view("Devices, services", "1 v"),
    view("Devices, heartbeats", "1 v v"),
    view("Devices, history", "1 h"),
    conflict("Devices, alarm", "1"),
    view("Problems", "4"),
    conflict("Problems, conflict", "4"),
    conflict("Problems, evidence", "4 Enter"),
    view("Timeline", "3"),
    view("Timeline, lines", "3 v"),
    view("Timeline, lanes", "3 v v"),
    view("Bus", "5"),
    view("Traffic, following", "2"),
    view("Traffic, filtered", "2 / d a t a : 1 0 Enter"),
    view("Traffic, selected", "2 k"),
    view("Traffic, identifiers", "2 v"),
    view("Identifiers by rate", "2 v s s Home"),
    view("Identifiers, newest", "2 v s s s s s Home"),
    view("Traffic, calls", "2 v v"),
    view("past moment", "1 Space"),
    view("playing", "1 ("),
];
