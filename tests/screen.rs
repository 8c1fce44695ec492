//! Keys and simulated buses in, screens out.

use descan::app::{App, AppOptions, Effect, FileReading, Mouse, MouseKind, SaveOutcome};
use descan::bus::{BusState, BusStatus, Link};
use descan::discovery::Config;
use descan::frame::{BusIndex, Frame};
use descan::keymap::Key;
use descan::sim::{Scenario, Sim, Station};
use descan::theme::{BUILT_IN, Role, Theme};
use descan::time::{Duration, Epoch, Instant};
use descan::ui;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;

/// A bus, the program on it, and a file: what stands around the program elsewhere.
struct Stage {
    app: App,
    sim: Sim,
    station: Station,
    file: Option<Vec<u8>>,
    effects: Vec<Effect>,
    size: (u16, u16),
}

const BOILER: &str = r#"{
  "devices": [
    { "name": "FEED", "address": 10, "static": true,
      "services": [ { "name": "DES", "version": "1.0" }, { "name": "AUGER", "version": "2.1" } ] },
    { "name": "SENS", "address": 12, "static": true },
    { "name": "ACT", "address": 16, "static": true },
    { "name": "DISP", "address": 20 },
    { "name": "PUMP", "address": 44, "static": true }
  ]
}
"#;

impl Stage {
    fn new(scenario: &Scenario, file: Option<&str>) -> Self {
        Self::with(scenario, file, Config { seed: 7, ..Config::default() })
    }

    fn with(scenario: &Scenario, file: Option<&str>, config: Config) -> Self {
        let mut sim = Sim::new(scenario, 1);
        let station = sim.attach();
        sim.set_listen_only(station, config.listen_only);
        // 2026-11-21 12:00:00 UTC.
        let epoch = Epoch::from_unix_micros(1_795_262_400_000_000);
        let app = App::new(
            Instant::ZERO,
            AppOptions {
                epoch,
                buses: vec![("can0".to_owned(), config)],
                file_path: Some("des.json".into()),
                theme: "terminal".to_owned(),
                themes: BUILT_IN.iter().map(|(name, _)| (*name).to_owned()).collect(),
                ..AppOptions::default()
            },
        );
        let mut stage = Self {
            app,
            sim,
            station,
            file: file.map(|text| text.as_bytes().to_vec()),
            effects: Vec::new(),
            size: (80, 24),
        };
        stage.size(80, 24);
        let bitrate = Some(scenario.bitrate);
        let status = BusStatus {
            link: Link::Up,
            state: BusState::ErrorActive,
            bitrate,
            ..BusStatus::default()
        };
        stage.app.handle_bus(Instant::ZERO, BusIndex(0), &status);
        let content = stage.file.clone();
        stage.app.handle_file(Instant::ZERO, FileReading::Content(content));
        stage
    }

    fn boiler() -> Self {
        Self::new(&Scenario::builtin("boiler").unwrap(), Some(BOILER))
    }

    /// Lets everything run until `seconds` after the start.
    fn until(&mut self, seconds: f64) -> &mut Self {
        let end = Instant::ZERO + Duration::from_secs_f64(seconds);
        let mut now = self.app.now();
        while now < end {
            let next = [self.sim.next_event(), self.app.poll_timeout(), Some(end)];
            now = next.into_iter().flatten().min().unwrap().max(now + Duration::from_micros(1));
            self.sim.advance(now);
            while let Some(frame) = self.sim.poll_frame(self.station) {
                self.app.handle_frames(now, &[frame]);
            }
            if self.app.poll_timeout().is_some_and(|at| at <= now) {
                self.app.handle_timeout(now);
            }
            self.drain(now);
        }
        self
    }

    fn drain(&mut self, now: Instant) {
        while let Some(frame) = self.app.poll_transmit(now) {
            self.sim.transmit(self.station, frame);
        }
        while let Some(effect) = self.app.poll_effect() {
            if let Effect::Save { expected, content } = &effect {
                let outcome = if *expected == self.file {
                    self.file = Some(content.clone());
                    SaveOutcome::Saved
                } else {
                    SaveOutcome::Changed(self.file.clone())
                };
                self.app.handle_saved(now, outcome);
            }
            self.effects.push(effect);
        }
    }

    /// Presses keys, written as in keys.toml, with blanks between.
    fn keys(&mut self, keys: &str) -> &mut Self {
        for text in keys.split_whitespace() {
            let key = Key::parse(text).unwrap_or_else(|| panic!("{text} is no key"));
            self.app.handle_key(self.app.now(), key);
            self.drain(self.app.now());
        }
        self
    }

    /// Types text into the line being typed.
    fn text(&mut self, text: &str) -> &mut Self {
        for c in text.chars() {
            self.app.handle_key(self.app.now(), Key::char(c));
        }
        self
    }

    /// Somebody else writes the file.
    fn write(&mut self, text: &str) -> &mut Self {
        self.file = Some(text.as_bytes().to_vec());
        let content = self.file.clone();
        self.app.handle_file(self.app.now(), FileReading::Content(content));
        self.drain(self.app.now());
        self
    }

    fn size(&mut self, columns: u16, rows: u16) -> &mut Self {
        self.size = (columns, rows);
        self.app.handle_resize(columns, rows);
        self
    }

    fn buffer(&self, theme: &str) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(self.size.0, self.size.1)).unwrap();
        let theme = Theme::built_in(theme).unwrap();
        terminal.draw(|frame| ui::draw(&self.app, &theme, frame)).unwrap();
        terminal.backend().buffer().clone()
    }

    /// The screen as text.
    fn screen(&self) -> String {
        text_of(&self.buffer("terminal"))
    }

    /// The text of the file.
    fn file(&self) -> &str {
        std::str::from_utf8(self.file.as_deref().unwrap_or_default()).unwrap()
    }
}

fn text_of(buffer: &Buffer) -> String {
    let mut text = String::new();
    for row in buffer.content().chunks(usize::from(buffer.area.width).max(1)) {
        let mut line = String::new();
        let mut skip = 0;
        for cell in row {
            if skip == 0 {
                line.push_str(cell.symbol());
                skip = unicode_width::UnicodeWidthStr::width(cell.symbol()).max(1);
            }
            skip -= 1;
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

#[test]
fn look() {
    let mut stage = Stage::boiler();
    for at in [1.0, 22.0, 45.0] {
        stage.until(at);
        for (columns, rows) in [(80, 24), (120, 40), (40, 10)] {
            stage.size(columns, rows);
            println!("--- {at} {columns}×{rows}\n{}", stage.screen());
        }
    }
    stage.size(80, 24);
    for keys in ["2", "v", "v Up Up Enter", "Esc 3", "4", "? ", "Esc 1 e"] {
        stage.keys(keys);
        println!("--- {keys}\n{}", stage.screen());
    }
}
