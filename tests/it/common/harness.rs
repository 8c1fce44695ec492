//! Test harness: the app on a simulated bus, with a des.json file.

use descan::address_plan::PlanRecord;
use descan::app::{App, AppOptions, Effect, FileIndex, FileReading, Overlay, SaveOutcome};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::document::Document;
use descan::frame::BusIndex;
use descan::keymap::Key;
use descan::sim::{Scenario, Sim, SimStation};
use descan::status::{BusState, BusStatus, Link};
use descan::theme::{BUILT_IN, Theme};
use descan::time::{Duration, Epoch, Instant};
use descan::ui;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;

/// The app, its simulated bus and its file.
pub struct Stage {
    pub app: App,
    pub sim: Sim,
    pub station: SimStation,
    pub file: Option<Vec<u8>>,
    pub effects: Vec<Effect>,
    /// Saves whose result has not been reported yet, for a slow disk.
    pub unfinished: Option<Vec<SaveOutcome>>,
    /// Saves without a result, for a disk that hangs.
    pub hanging: Option<Vec<Effect>>,
    /// The last plan of addresses, with the name of its file.
    pub last_plan: Option<(String, PlanRecord)>,
    /// The error of every save, for a disk that rejects writes.
    pub refusal: Option<String>,
    pub size: (u16, u16),
}

pub const BOILER: &str = r#"{
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
    pub fn new(scenario: &Scenario, file: Option<&str>) -> Self {
        Self::with(scenario, file, Config { seed: 7, ..Config::default() })
    }

    pub fn with(scenario: &Scenario, file: Option<&str>, config: Config) -> Self {
        Self::with_bytes(scenario, file.map(|text| text.as_bytes().to_vec()), config)
    }

    pub fn with_bytes(scenario: &Scenario, file: Option<Vec<u8>>, config: Config) -> Self {
        // Small, so that a test fills it soon.
        Self::with_room(scenario, file, config, 1 << 20)
    }

    /// Starts the program with captured frames of at most `room` bytes.
    pub fn with_room(
        scenario: &Scenario,
        file: Option<Vec<u8>>,
        config: Config,
        room: usize,
    ) -> Self {
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
                capture_room: Some(room),
                learns_profile: true,
                ..AppOptions::default()
            },
        );
        let mut stage = Self {
            app,
            sim,
            station,
            file,
            effects: Vec::new(),
            unfinished: None,
            hanging: None,
            last_plan: None,
            refusal: None,
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
        stage.app.handle_bus(Instant::ZERO, BusIndex(0), status);
        let content = stage.file.clone();
        stage.app.handle_file(Instant::ZERO, FileIndex::default(), FileReading::Content(content));
        stage
    }

    pub fn boiler() -> Self {
        Self::new(&Scenario::builtin("boiler").unwrap(), Some(BOILER))
    }

    /// Runs everything until `seconds` after the start.
    pub fn until(&mut self, seconds: f64) -> &mut Self {
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
                self.pass(now);
            }
            self.drain(now);
        }
        self.app.renew_rows();
        self
    }

    /// Handles what is due at `now`, and renews the rows as a draw does.
    pub fn pass(&mut self, now: Instant) {
        self.app.handle_timeout(now);
        if self.app.is_dirty() {
            self.app.renew_rows();
        }
    }

    pub fn drain(&mut self, now: Instant) {
        while let Some(frame) = self.app.poll_transmit(now) {
            self.sim.transmit(self.station, frame);
        }
        while let Some(effect) = self.app.poll_effect() {
            if let (Effect::Save { .. }, Some(hanging)) = (&effect, &mut self.hanging) {
                hanging.push(effect.clone());
            } else {
                self.save(now, &effect);
            }
            if let Effect::WritePlan { name, bytes, .. } = &effect {
                self.last_plan = Some((name.clone(), PlanRecord::parse(bytes).unwrap()));
                self.app.handle_plan_written(now, Ok(()));
            }
            if let Effect::ReadLastPlan { bus } = &effect {
                let last = self.last_plan.clone().map(Box::new);
                self.app.handle_last_plan(now, bus, Ok(last));
            }
            if effect == Effect::ReadFile(FileIndex::default()) {
                let reading = FileReading::Content(self.file.clone());
                self.app.handle_file(now, FileIndex::default(), reading);
            }
            self.effects.push(effect);
        }
    }

    /// Writes the file if a save is due.
    fn save(&mut self, now: Instant, effect: &Effect) {
        let Effect::Save { expected, content, .. } = effect else { return };
        let expected = expected.as_ref().map(Document::source);
        let outcome = if let Some(why) = &self.refusal {
            SaveOutcome::Failed(Diagnostic::new(why))
        } else if expected == self.file.as_deref() {
            self.file = Some(content.source().to_vec());
            SaveOutcome::Saved
        } else {
            SaveOutcome::Changed(FileReading::Content(self.file.clone()))
        };
        match &mut self.unfinished {
            Some(unfinished) => unfinished.push(outcome),
            None => self.app.handle_saved(now, FileIndex::default(), outcome),
        }
    }

    /// Makes saves hang until [`Self::go_on`].
    pub fn hang(&mut self) -> &mut Self {
        self.hanging = Some(Vec::new());
        self
    }

    pub fn go_on(&mut self) -> &mut Self {
        let now = self.app.now();
        for effect in self.hanging.take().into_iter().flatten() {
            self.save(now, &effect);
        }
        self.drain(now);
        self
    }

    /// Delays the result of each save until [`Self::finish_saves`].
    pub fn slow_disk(&mut self) -> &mut Self {
        self.unfinished = Some(Vec::new());
        self
    }

    pub fn finish_saves(&mut self) -> &mut Self {
        for outcome in std::mem::take(self.unfinished.as_mut().unwrap()) {
            self.app.handle_saved(self.app.now(), FileIndex::default(), outcome);
        }
        self.drain(self.app.now());
        self
    }

    /// Makes the pending saves fail.
    pub fn refuse_saves(&mut self) -> &mut Self {
        for outcome in self.unfinished.as_mut().into_iter().flatten() {
            *outcome = SaveOutcome::Failed(Diagnostic::new("no space left on the disk"));
        }
        self.finish_saves()
    }

    /// Presses keys, written as in keys.toml and separated by blanks; before a choice, waits until
    /// the page accepts keys.
    pub fn keys(&mut self, keys: &str) -> &mut Self {
        if matches!(self.app.overlay(), Overlay::Conflict) {
            self.until(self.app.now().as_micros() as f64 / 1e6 + 1.0);
        }
        for text in keys.split_whitespace() {
            let key = Key::parse(text).unwrap_or_else(|| panic!("{text} is no key"));
            self.app.handle_key(self.app.now(), key);
            self.drain(self.app.now());
        }
        self
    }

    /// Types text into the input line.
    pub fn text(&mut self, text: &str) -> &mut Self {
        for c in text.chars() {
            self.app.handle_key(self.app.now(), Key::char(c));
        }
        self
    }

    /// Writes the file as another program.
    pub fn write(&mut self, text: &str) -> &mut Self {
        self.file = Some(text.as_bytes().to_vec());
        self.notice()
    }

    /// Deletes the file as another program.
    pub fn remove(&mut self) -> &mut Self {
        self.file = None;
        self.notice()
    }

    /// Reports the content on disk to the app.
    pub fn notice(&mut self) -> &mut Self {
        let reading = FileReading::Content(self.file.clone()).parsed();
        self.app.handle_file(self.app.now(), FileIndex::default(), reading);
        self.drain(self.app.now());
        self
    }

    pub fn size(&mut self, columns: u16, rows: u16) -> &mut Self {
        self.size = (columns, rows);
        self.app.handle_resize(columns, rows);
        self
    }

    pub fn buffer(&self, theme: &str) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(self.size.0, self.size.1)).unwrap();
        let theme = Theme::built_in(theme).unwrap();
        terminal
            .draw(|frame| {
                ui::draw(&self.app, &theme, frame);
            })
            .unwrap();
        terminal.backend().buffer().clone()
    }

    /// Draws the screen and reports to the app how far its text can be scrolled.
    pub fn drawn(&mut self) -> &mut Self {
        let mut terminal = Terminal::new(TestBackend::new(self.size.0, self.size.1)).unwrap();
        let theme = Theme::built_in("terminal").unwrap();
        let mut scrolled = None;
        terminal.draw(|frame| scrolled = ui::draw(&self.app, &theme, frame)).unwrap();
        self.app.handle_drawn(scrolled);
        self
    }

    /// Returns the screen as text.
    pub fn screen(&self) -> String {
        text_of(&self.buffer("terminal"))
    }

    /// Returns the content of the file.
    pub fn file(&self) -> &str {
        std::str::from_utf8(self.file.as_deref().unwrap_or_default()).unwrap()
    }
}

pub fn text_of(buffer: &Buffer) -> String {
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
