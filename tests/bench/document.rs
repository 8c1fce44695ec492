//! A des.json of 10,000 entries and 5 MB: time to open, to edit and to show it.

use descan::app::{App, AppOptions, Effect, FileIndex, FileReading, SaveOutcome};
use descan::discovery::Config;
use descan::document::{Document, Operation};
use descan::frame::BusIndex;
use descan::keymap::Key;
use descan::shell::store::Store;
use descan::status::{BusStatus, Link};
use descan::theme::Theme;
use descan::time::Instant;
use descan::ui;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use std::fmt::Write as _;
use std::time::Instant as Clock;

const ENTRIES: usize = 10_000;

fn main() {
    let text = file();
    println!("{ENTRIES} entries, {} bytes", text.len());
    let folder = tempfile::tempdir().unwrap();
    let store = Store::new(folder.path().join("des.json"));
    store.save(None, text.as_bytes()).unwrap();

    let document =
        timed("read and parsed", || Document::parse(&store.read().unwrap().unwrap()).unwrap());
    assert_eq!(document.entries().len(), ENTRIES);
    let entry = document.key(ENTRIES / 2);
    let operation = Operation::PinAddress { from: entry.address, entry, to: 99 };
    let edited = timed("one address edited", || document.apply(&operation).unwrap());
    let (old, new) = (document.source(), edited.source());
    timed("saved, with the disk", || store.save(Some(old), new).unwrap());

    let mut app = App::new(
        Instant::ZERO,
        AppOptions {
            buses: vec![("can0".to_owned(), Config::default())],
            file_path: Some("des.json".into()),
            ..AppOptions::default()
        },
    );
    app.handle_resize(120, 40);
    let status = BusStatus { link: Link::Up, ..BusStatus::default() };
    app.handle_bus(Instant::ZERO, BusIndex(0), status);
    let reading = FileReading::Content(Some(text.clone().into_bytes()));
    timed("opened in the program", || {
        app.handle_file(Instant::ZERO, FileIndex::default(), reading);
    });
    // Long enough for entries to be missing.
    let mut seconds = 0;
    let mut worst = 0.0_f64;
    while seconds < 60 {
        let now = app.poll_timeout().unwrap_or(Instant::ZERO);
        let start = Clock::now();
        app.handle_timeout(now);
        worst = worst.max(start.elapsed().as_secs_f64());
        while app.poll_transmit(now).is_some() || app.poll_effect().is_some() {}
        seconds = now.as_micros() / 1_000_000;
    }
    println!("{:>28} {:8.1} ms", "the longest turn of a minute", worst * 1e3);
    let mut terminal = Terminal::new(TestBackend::new(120, 40)).unwrap();
    let theme = Theme::built_in("terminal").unwrap();
    for page in ["1", "4"] {
        timed("a key that turns the page", || app.handle_key(app.now(), Key::parse(page).unwrap()));
        timed("drawn", || {
            terminal
                .draw(|frame| {
                    ui::draw(&app, &theme, frame);
                })
                .unwrap();
        });
    }
    app.handle_key(app.now(), Key::parse("1").unwrap());
    let theirs = |note: &str| text.replacen("xxx", note, 1).into_bytes();
    let reading = FileReading::Content(Some(theirs("yyy")));
    timed("changed by others, not parsed", || {
        app.handle_file(app.now(), FileIndex::default(), reading);
    });
    // In the form that the reader delivers.
    let reading = FileReading::Content(Some(theirs("zzz"))).parsed();
    timed("changed by others", || app.handle_file(app.now(), FileIndex::default(), reading));
    for key in ["G", "e", "Ctrl-u", "9", "8"] {
        app.handle_key(app.now(), Key::parse(key).unwrap());
    }
    timed("an edit, until it is written", || {
        app.handle_key(app.now(), Key::parse("Enter").unwrap());
        while !matches!(app.poll_effect().expect("a save"), Effect::Save { .. }) {}
    });
    timed("after it was written", || {
        app.handle_saved(app.now(), FileIndex::default(), SaveOutcome::Saved);
    });
    timed("taken back, until written", || {
        app.handle_key(app.now(), Key::parse("u").unwrap());
        while !matches!(app.poll_effect().expect("a save"), Effect::Save { .. }) {}
    });
    app.handle_saved(app.now(), FileIndex::default(), SaveOutcome::Saved);
    app.handle_key(app.now(), Key::parse("D").unwrap());
    timed("an entry deleted, the same", || {
        app.handle_key(app.now(), Key::parse("y").unwrap());
        while !matches!(app.poll_effect().expect("a save"), Effect::Save { .. }) {}
    });
}

/// Returns entries with services and members unknown to descan, 500 bytes each.
fn file() -> String {
    let mut text = "{\n  \"devices\": [\n".to_owned();
    for number in 0..ENTRIES {
        let comma = if number + 1 < ENTRIES { "," } else { "" };
        let address = number % 97 + 1;
        let note = "x".repeat(270);
        let _ = writeln!(
            text,
            "    {{ \"name\": \"N{number:05}\", \"address\": {address}, \"note\": \"{note}\",\n      \
             \"services\": [ {{ \"name\": \"DES\", \"version\": \"1.0\" }}, \
             {{ \"name\": \"AUGER\", \"version\": \"2.1\" }}, \
             {{ \"name\": \"RELAY\", \"version\": \"3.0.1\" }} ] }}{comma}"
        );
    }
    text + "  ]\n}\n"
}

fn timed<T>(what: &str, work: impl FnOnce() -> T) -> T {
    let start = Clock::now();
    let result = work();
    println!("{what:>28} {:8.1} ms", start.elapsed().as_secs_f64() * 1e3);
    result
}
