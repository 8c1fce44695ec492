//! Random keys while the bus and the file have faults: no panic at any screen size, and no control
//! characters on the screen.

use crate::common::sweep;
use descan::app::{App, AppOptions, Effect, FileIndex, FileReading, Mouse, MouseKind, SaveOutcome};
use descan::diagnostic::Diagnostic;
use descan::discovery::Config;
use descan::document::Document;
use descan::frame::{BusIndex, CanId, Frame};
use descan::keymap::{Key, KeyCode};
use descan::status::{BusState, BusStatus, Link};
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

#[derive(Clone, Debug)]
enum Step {
    Key(Key),
    Paste(String),
    Mouse(MouseKind, u16, u16),
    Resize(u16, u16),
    Frames(Vec<(u32, Vec<u8>)>),
    File(Option<Vec<u8>>),
    FileError,
    Pause(u64),
    Saves(bool),
    Bus(Link, BusState),
    Stall(u64),
}

fn any_key() -> impl Strategy<Value = Key> {
    let code = prop_oneof![
        10 => prop::sample::select("ervaADnRCucst?/qgGhjkl1234 yoibwmp44mp0123456789xкуЙ\u{1b}\u{202e}".chars().collect::<Vec<_>>())
            .prop_map(KeyCode::Char),
        2 => Just(KeyCode::Enter),
        2 => Just(KeyCode::Esc),
        1 => Just(KeyCode::Tab),
        1 => Just(KeyCode::Backspace),
        1 => Just(KeyCode::Up),
        1 => Just(KeyCode::Down),
        1 => Just(KeyCode::PageDown),
        1 => Just(KeyCode::End),
        1 => Just(KeyCode::Delete),
    ];
    (code, prop::bool::weighted(0.05)).prop_map(|(code, ctrl)| Key { ctrl, ..Key::new(code) })
}

fn any_frames() -> impl Strategy<Value = Vec<(u32, Vec<u8>)>> {
    let name = prop_oneof![
        Just(b"\x06\x01FEED\0".to_vec()),
        Just(b"\x06\x01A\x1b[2\0".to_vec()),
        Just(b"\x07\x01\xff\xfe\xe2\x80\xae\0".to_vec()),
        Just(b"\x03\x01B\0".to_vec()),
        Just(b"\x01\x02".to_vec()),
        prop::collection::vec(any::<u8>(), 0..=8),
    ];
    // Responses and heartbeats of nodes 0 to 7.
    let id = (
        0u32..8,
        prop::sample::select(vec![0x0500_0002u32, 0x0700_0001, 0x1700_0001, 0x0500_0300]),
    )
        .prop_map(|(node, base)| base | node << 17);
    prop::collection::vec((id, name), 0..6)
}

fn any_file() -> impl Strategy<Value = Option<Vec<u8>>> {
    prop::sample::select(vec![
        None,
        Some(b"".to_vec()),
        Some(b"{ oops".to_vec()),
        Some(br#"{"devices":[{"name":"FEED","address":1,"static":true},{"name":"B","address":5}]}"#.to_vec()),
        Some(br#"[{"name":"FEED","address":2,"static":true},{"name":"GONE","address":2,"static":true}]"#.to_vec()),
        Some(br#"{"devices":[{"name":"\u001b[2J","address":500},{"nome":1},7]}"#.to_vec()),
        Some(b"\xff\xfe".to_vec()),
    ])
}

fn any_bus() -> impl Strategy<Value = Step> {
    let links = vec![Link::Opening, Link::Up, Link::Up, Link::Down, Link::Unplugged, Link::Ended];
    let states = vec![BusState::ErrorActive, BusState::ErrorPassive, BusState::BusOff];
    (prop::sample::select(links), prop::sample::select(states))
        .prop_map(|(link, state)| Step::Bus(link, state))
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        12 => any_key().prop_map(Step::Key),
        1 => "\\PC{0,8}|\u{1b}\\[2J|12".prop_map(Step::Paste),
        1 => (prop::sample::select(vec![MouseKind::Press, MouseKind::WheelUp, MouseKind::WheelDown]), 0u16..130, 0u16..50)
            .prop_map(|(kind, column, row)| Step::Mouse(kind, column, row)),
        1 => (1u16..130, 1u16..50).prop_map(|(columns, rows)| Step::Resize(columns, rows)),
        4 => any_frames().prop_map(Step::Frames),
        2 => any_file().prop_map(Step::File),
        1 => Just(Step::FileError),
        3 => (0u64..3_000_000).prop_map(Step::Pause),
        1 => any::<bool>().prop_map(Step::Saves),
        1 => any_bus(),
        1 => (0u64..5_000_000).prop_map(Step::Stall),
    ]
}

struct Stage {
    app: App,
    now: Instant,
    size: (u16, u16),
    disk: Option<Vec<u8>>,
    saves: bool,
    theme: Theme,
}

impl Stage {
    fn take(&mut self, step: Step) {
        let now = self.now;
        match step {
            Step::Key(key) => self.app.handle_key(now, key),
            Step::Paste(text) => self.app.handle_paste(now, &text),
            Step::Mouse(kind, column, row) => {
                self.app.handle_mouse(now, Mouse { kind, column, row });
            }
            Step::Resize(columns, rows) => {
                self.size = (columns, rows);
                self.app.handle_resize(columns, rows);
            }
            Step::Frames(frames) => {
                let frames: Vec<Frame> = frames
                    .iter()
                    .map(|(id, data)| Frame::new(CanId::Extended(*id), data).with_time(now))
                    .collect();
                self.app.handle_frames(now, &frames);
            }
            Step::File(content) => {
                self.disk.clone_from(&content);
                self.app.handle_file(now, FileIndex::default(), FileReading::Content(content));
            }
            Step::FileError => {
                self.app.handle_file(
                    now,
                    FileIndex::default(),
                    FileReading::Error(Diagnostic::new("is a folder")),
                );
            }
            Step::Pause(micros) => self.now = now + Duration::from_micros(micros),
            Step::Saves(saves) => self.saves = saves,
            Step::Bus(link, state) => {
                let status = BusStatus { link, state, ..BusStatus::default() };
                self.app.handle_bus(now, BusIndex(0), status);
            }
            Step::Stall(micros) => {
                self.now = now + Duration::from_micros(micros);
                self.app.handle_stall(now, self.now);
            }
        }
        self.settle();
    }

    fn settle(&mut self) {
        while let Some(due) = self.app.poll_timeout().filter(|due| *due <= self.now) {
            let now = due.max(self.app.now());
            self.app.handle_timeout(now);
            let next = self.app.poll_timeout();
            assert!(next.is_none_or(|next| next > now), "due at {next:?}, handled until {now:?}");
        }
        while self.app.poll_transmit(self.now).is_some() {}
        while let Some(effect) = self.app.poll_effect() {
            match effect {
                Effect::Save { expected, content, .. } if self.saves => {
                    let expected = expected.as_ref().map(Document::source);
                    let outcome = if expected == self.disk.as_deref() {
                        self.disk = Some(content.source().to_vec());
                        SaveOutcome::Saved
                    } else {
                        SaveOutcome::Changed(FileReading::Content(self.disk.clone()))
                    };
                    self.app.handle_saved(self.now, FileIndex::default(), outcome);
                }
                Effect::Save { .. } => {
                    let why = "the disk is full".to_owned();
                    self.app.handle_saved(
                        self.now,
                        FileIndex::default(),
                        SaveOutcome::Failed(Diagnostic::new(why)),
                    );
                }
                Effect::WriteFile { path, .. } => self.app.handle_written(self.now, &path, Ok(())),
                Effect::UseTheme(_) => self.app.handle_theme(self.now, Ok(())),
                _ => {}
            }
        }
    }

    fn draw(&mut self) {
        self.app.take_dirty();
        let (columns, rows) = self.size;
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
        let mut scrolled = None;
        let (app, theme) = (&self.app, &self.theme);
        terminal.draw(|frame| scrolled = descan::ui::draw(app, theme, frame)).unwrap();
        self.app.handle_drawn(scrolled);
        for cell in terminal.backend().buffer().content() {
            assert!(
                cell.symbol().chars().all(descan::text::is_printable),
                "{:?} is on the screen",
                cell.symbol()
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: sweep::cases(192), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_input_never_panics_nor_controls_terminal(steps in prop::collection::vec(any_step(), 1..120)) {
        let options = AppOptions {
            buses: vec![("can0".to_owned(), Config::default())],
            file_path: Some("des.json".into()),
            themes: vec!["terminal".to_owned(), "mono".to_owned()],
            theme: "terminal".to_owned(),
            ..AppOptions::default()
        };
        let app = App::new(Instant::ZERO, options);
        let theme = Theme::built_in("terminal").unwrap();
        let mut stage =
            Stage { app, now: Instant::ZERO, size: (80, 24), disk: None, saves: true, theme };
        stage.app.handle_resize(80, 24);
        for step in steps {
            stage.take(step);
            stage.draw();
        }
        // The content on disk is always complete: another program's content, or a document.
        if let Some(disk) = stage.disk.filter(|disk| !disk.starts_with(b"{ oops") && !disk.starts_with(b"\xff")) {
            prop_assert!(Document::parse(&disk).is_ok());
        }
    }
}
