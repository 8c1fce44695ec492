//! Editing of des.json: keys pressed, versions of the file written by other programs, and every
//! byte that results.
//!
//! A scenario is a text file in `tests/editing`. Its input lines are
//!
//! ```text
//! # a comment
//! device FEED 12 DES=1.0 AUGER=2.1    a device on the bus, with its address and services
//! disk                                content on disk: first at the start, then written by
//! |{ "devices": [] }                  another program; each line of it after a bar
//! disk none                           the file does not exist, or is removed by another program
//! disk empty                          the file has no bytes
//! disk first                          the file has its first content again
//! row FEED                            select that row (or FEED 12: the one at that address)
//! keys e 1 6 Enter                    keys, as keys.toml writes them
//! type PUMP 44                        text, character by character
//! see SENS                            the screen of 80×24 must show this
//! miss SENS                           and must not show this
//! saves fail: no space left           from now on the disk rejects saves
//! saves work                          saves succeed again
//! saves are slow                      saves reach the disk at once, but are not reported
//! saves end                           they are reported now
//! saves hang                          saves have no result
//! saves go on                         saves continue
//! unseen                              from now on, changes by other programs are not noticed
//! seen                                they are noticed again
//! services FEED DES=1.1 AUGER=2.2     the device has other services from now on
//! wait 10                             let this many seconds pass
//! ```
//!
//! and the indented lines below each are the expected results:
//!
//! ```text
//!   saved                             descan wrote the file, byte by byte
//!   |{ "devices": [] }
//!   saved as first                    the same bytes as at the start
//!   typed 16: Enter pins it to 16     the input line, and its hint (`warns:`, or
//!                                     `blocks:` if Enter does nothing)
//!   says: undid: …                    the message below (`warns:` if an action failed)
//!   asks: …                           a prompt, or an edit conflict with both values
//!   unsaved 2                         the number of edits that are not on disk
//!   problem: line 1, column 2: …      a problem of the file as a whole
//!   finding: line 1, column 2: …      a new finding in the file
//! ```
//!
//! In lines after a bar `␍` stands for a carriage return, `␉` for a tab, `␠` for a space (needed at
//! the end of a line), `⟨BOM⟩` for a byte order mark and `⟨FF⟩` for any byte. Every line ends with
//! a line feed, unless `\ no newline at the end` follows.
//!
//! In every scenario, descan writes only JSON, never overwrites content that is not JSON, and uses
//! the content on disk unless it reports otherwise.
//!
//! Run with `UPDATE_SCENARIOS=1` to write the results instead of checking them; then review the
//! diff.

use crate::common::harness::Stage;
use crate::common::scenario_files::{are_written_anew, texts_of};
use descan::app::{InputCheck, Overlay};
use descan::discovery::Config;
use descan::document::Document;
use descan::keymap::{Key, KeyCode};
use descan::sim::{DeviceAction, DeviceSpec, Scenario};
use std::fmt::Write;
use std::iter::Peekable;
use std::str::Lines;

/// Simulated time before the first key: by then every device has reported its services.
const SETTLED: f64 = 8.0;
const NO_NEWLINE: &str = "\\ no newline at the end";

/// Returns the bytes of a line after a bar, without its line feed.
fn bytes_of(text: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        rest = &rest[c.len_utf8()..];
        match c {
            '␍' => bytes.push(b'\r'),
            '␉' => bytes.push(b'\t'),
            '␠' => bytes.push(b' '),
            '⟨' => {
                let (code, behind) = rest.split_once('⟩').expect("⟩");
                rest = behind;
                match code {
                    "BOM" => bytes.extend("\u{feff}".bytes()),
                    hex => bytes.push(u8::from_str_radix(hex, 16).expect("a byte in hexadecimal")),
                }
            }
            c => bytes.extend(c.encode_utf8(&mut [0; 4]).bytes()),
        }
    }
    bytes
}

/// Formats a line of a file as it is written after a bar.
fn shown(line: &[u8]) -> String {
    let mut text = String::new();
    for chunk in line.utf8_chunks() {
        for c in chunk.valid().chars() {
            match c {
                '\r' => text.push('␍'),
                '\t' => text.push('␉'),
                '\u{feff}' => text.push_str("⟨BOM⟩"),
                c if c.is_control() || "␍␉␠⟨⟩".contains(c) => {
                    text.push_str(&hex(c.encode_utf8(&mut [0; 4]).as_bytes()));
                }
                c => text.push(c),
            }
        }
        text.push_str(&hex(chunk.invalid()));
    }
    match text.strip_suffix(' ') {
        Some(start) => format!("{start}␠"),
        None => text,
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |text, byte| text + &format!("⟨{byte:02X}⟩"))
}

/// Formats content as lines after bars.
fn block(content: &[u8], indent: &str) -> String {
    let mut text = String::new();
    for line in content.split_inclusive(|&byte| byte == b'\n') {
        let whole = line.strip_suffix(b"\n");
        writeln!(text, "{indent}|{}", shown(whole.unwrap_or(line))).unwrap();
        if whole.is_none() {
            writeln!(text, "{indent}{NO_NEWLINE}").unwrap();
        }
    }
    text
}

/// Parses the output of [`block`].
fn read_block(lines: &mut Peekable<Lines>) -> Vec<u8> {
    let mut content = Vec::new();
    while let Some(line) = lines.peek().and_then(|line| line.strip_prefix('|')) {
        content.extend(bytes_of(line));
        content.push(b'\n');
        lines.next();
    }
    if lines.next_if_eq(&NO_NEWLINE).is_some() {
        content.pop();
    }
    content
}

fn services(words: &[&str]) -> Vec<Vec<Vec<u8>>> {
    let service = |word: &&str| word.split('=').map(|text| text.as_bytes().to_vec()).collect();
    words.iter().map(service).collect()
}

fn wait(stage: &mut Stage, seconds: f64) {
    stage.until(stage.app.now().as_micros() as f64 / 1e6 + seconds);
}

/// A running scenario.
struct Play {
    stage: Stage,
    log: String,
    first: Option<Vec<u8>>,
    /// True if changes by other programs are noticed.
    is_watched: bool,
    /// The last message reported, so that only new ones are logged.
    message: Option<String>,
    problem: Option<String>,
    findings: Vec<String>,
    unsaved: usize,
}

impl Play {
    fn new(scenario: &Scenario, first: Option<Vec<u8>>) -> Self {
        let config = Config { seed: 7, ..Config::default() };
        let mut stage = Stage::with_bytes(scenario, first.clone(), config);
        stage.until(SETTLED);
        let log = String::new();
        let (message, problem, findings) = (None, None, Vec::new());
        Self { stage, log, first, is_watched: true, message, problem, findings, unsaved: 0 }
    }

    /// Runs an action of descan, and logs what descan wrote meanwhile.
    fn act(&mut self, action: impl FnOnce(&mut Stage)) {
        let before = self.stage.file.clone();
        action(&mut self.stage);
        self.tell_saved(before.as_deref());
    }

    /// Changes the file as another program.
    fn change(&mut self, content: Option<Vec<u8>>) {
        self.stage.file = content;
        if self.is_watched {
            self.act(|stage| {
                stage.notice();
            });
        }
    }

    fn tell_saved(&mut self, before: Option<&[u8]>) {
        let after = self.stage.file.as_deref();
        if after == before {
            return;
        }
        if let Some(before) = before {
            assert!(Document::parse(before).is_ok(), "written over what is not JSON");
        }
        let after = after.expect("we never remove the file");
        assert!(Document::parse(after).is_ok(), "what was written is not JSON");
        if self.first.as_deref() == Some(after) {
            self.log.push_str("  saved as first\n");
        } else {
            write!(self.log, "  saved\n{}", block(after, "  ")).unwrap();
        }
    }

    /// Selects a row by name and, if needed, by address.
    fn select(&mut self, words: &[&str]) {
        let is_it = |stage: &Stage| {
            let row = stage.app.selected_row().expect("a row");
            let name = row.name.as_ref().map_or("?".to_owned(), ToString::to_string);
            let address = row.address.map(|address| address.to_string());
            name == words[0] && (words.len() == 1 || address.as_deref() == Some(words[1]))
        };
        self.act(|stage| {
            stage.keys("Home");
            for _ in 1..stage.app.rows().len() {
                if is_it(stage) {
                    break;
                }
                stage.keys("j");
            }
            assert!(is_it(stage), "there is no row {words:?}:\n{}", stage.screen());
        });
    }

    /// Logs what is new on the screen.
    fn tell_state(&mut self, always_message: bool) {
        let app = &self.stage.app;
        let mut log = String::new();
        if let (Some(prompt), Some(verdict)) = (app.prompt(), app.prompt_check()) {
            let (how, words) = match verdict {
                InputCheck::Accepted(words) => ("", words),
                InputCheck::Warning(words) => ("warns: ", words),
                InputCheck::Rejected(words) => ("blocks: ", words),
            };
            writeln!(log, "  typed {}: {how}{words}", prompt.input.value()).unwrap();
        }
        let message = app.message().map(|message| {
            let how = if message.is_error { "warns" } else { "says" };
            format!("{how}: {}", message.text)
        });
        if let Some(message) =
            message.as_ref().filter(|it| always_message || self.message.as_ref() != Some(*it))
        {
            writeln!(log, "  {message}").unwrap();
        }
        match (app.overlay(), app.file().conflict()) {
            (Overlay::Question(_), _) => {
                let screen = self.stage.screen();
                let question = screen.lines().last().unwrap_or_default().trim().to_owned();
                writeln!(log, "  asks: {question}").unwrap();
            }
            (Overlay::Conflict, Some(conflict)) => {
                let which = match conflict.total {
                    1 => "conflict".to_owned(),
                    of => format!("conflict {} of {of}", conflict.index),
                };
                writeln!(log, "  asks: {which}: {}", conflict.operation).unwrap();
                writeln!(log, "    ours: {}", conflict.ours).unwrap();
                writeln!(log, "    theirs: {}", conflict.theirs).unwrap();
            }
            _ => {}
        }
        let unsaved = app.file().unsaved();
        if unsaved != self.unsaved {
            writeln!(log, "  unsaved {unsaved}").unwrap();
        }
        let problem = app.file().problem().map(ToString::to_string);
        if problem != self.problem {
            let problem = problem.as_deref().unwrap_or("none any more");
            writeln!(log, "  problem: {problem}").unwrap();
        }
        let document = app.file().document();
        let findings: Vec<String> = document.findings().iter().map(ToString::to_string).collect();
        for finding in findings.iter().filter(|finding| !self.findings.contains(finding)) {
            writeln!(log, "  finding: {finding}").unwrap();
        }
        let is_known = self.is_watched && app.file().emptied_since().is_none();
        if unsaved == 0 && problem.is_none() && is_known && !app.file().is_saving() {
            let on_disk = self.stage.file.as_deref().unwrap_or_default();
            assert_eq!(document.source(), on_disk, "what is in force is not what is on the disk");
        }
        (self.message, self.problem) = (message, problem);
        (self.findings, self.unsaved) = (findings, unsaved);
        self.log.push_str(&log);
    }
}

fn play(scenario: &str) -> String {
    let mut bus = Scenario::new(125_000);
    let mut playing: Option<Play> = None;
    let mut log = String::new();
    let mut lines = scenario.lines().peekable();
    while let Some(line) = lines.next() {
        if line.starts_with("  ") {
            continue;
        }
        let written = playing.as_mut().map_or(&mut log, |play| &mut play.log);
        writeln!(written, "{line}").unwrap();
        let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
        let words: Vec<&str> = rest.split_whitespace().collect();
        if matches!(word, "" | "#") {
            continue;
        }
        if word == "device" {
            assert!(playing.is_none(), "devices come before the file");
            let mut device = DeviceSpec::new(words[0])
                .fixed(words[1].parse().unwrap())
                .skips_address_resolution();
            device.services.extend(services(&words[2..]));
            bus = bus.with(device);
            continue;
        }
        if word == "disk" {
            let content = match rest {
                "none" => None,
                "empty" => Some(Vec::new()),
                "first" => playing.as_ref().expect("a start").first.clone(),
                "" => {
                    let content = read_block(&mut lines);
                    written.push_str(&block(&content, ""));
                    Some(content)
                }
                other => panic!("disk {other}"),
            };
            if let Some(play) = &mut playing {
                play.change(content);
            } else {
                let mut play = Play::new(&bus, content);
                play.log = std::mem::take(&mut log);
                playing = Some(play);
            }
            playing.as_mut().unwrap().tell_state(false);
            continue;
        }
        let play = playing.as_mut().expect("what is on the disk comes first");
        match (word, rest) {
            ("row", _) => play.select(&words),
            ("keys", _) => words.iter().for_each(|key| {
                play.act(|stage| {
                    stage.keys(key);
                });
            }),
            ("type", text) => play.act(|stage| {
                for c in text.chars() {
                    let code = KeyCode::Char(c);
                    stage.app.handle_key(stage.app.now(), Key::new(code));
                }
            }),
            ("see" | "miss", text) => {
                let screen = play.stage.screen();
                if screen.contains(text) != (word == "see") {
                    let screen = screen.replace('\n', "\n    ");
                    writeln!(play.log, "  but the screen is\n    {}", screen.trim_end()).unwrap();
                }
                continue;
            }
            ("saves", "work") => {
                play.stage.refusal = None;
                play.stage.unfinished = None;
            }
            ("saves", "are slow") => {
                play.stage.slow_disk();
            }
            ("saves", "hang") => {
                play.stage.hang();
            }
            ("saves", "go on") => play.act(|stage| {
                stage.go_on();
            }),
            ("saves", "end") => play.act(|stage| {
                stage.finish_saves();
            }),
            ("saves", why) => {
                let why = why.strip_prefix("fail: ").unwrap_or_else(|| panic!("saves {why}"));
                play.stage.refusal = Some(why.to_owned());
            }
            ("unseen", "") => play.is_watched = false,
            ("seen", "") => {
                play.is_watched = true;
                play.act(|stage| {
                    stage.notice();
                });
            }
            ("services", _) => play.act(|stage| {
                let device = stage.sim.device(words[0]).expect("a device");
                stage.sim.apply(device, DeviceAction::Services(services(&words[1..])));
                wait(stage.keys("r"), 6.0);
            }),
            ("wait", _) => play.act(|stage| {
                wait(stage, rest.parse().expect("seconds"));
            }),
            other => panic!("unknown input {other:?}"),
        }
        play.tell_state(matches!(word, "keys"));
    }
    playing.map_or(log, |play| play.log)
}

/// Returns the differing lines with a few lines around them.
fn difference(expected: &str, played: &str) -> String {
    const AROUND: usize = 4;
    let (wanted, came): (Vec<&str>, Vec<&str>) =
        (expected.lines().collect(), played.lines().collect());
    let same = |(a, b): &(&&str, &&str)| a == b;
    let start = wanted.iter().zip(&came).take_while(same).count();
    let (wanted_rest, came_rest) = (&wanted[start..], &came[start..]);
    let end = wanted_rest.iter().rev().zip(came_rest.iter().rev()).take_while(same).count();
    let mut text = String::new();
    for line in &wanted[start.saturating_sub(AROUND)..start] {
        writeln!(text, "  {line}").unwrap();
    }
    for (sign, lines) in [('-', wanted_rest), ('+', came_rest)] {
        for line in &lines[..lines.len() - end] {
            writeln!(text, "{sign} {line}").unwrap();
        }
    }
    for line in &wanted[wanted.len() - end..][..end.min(AROUND)] {
        writeln!(text, "  {line}").unwrap();
    }
    text
}

#[test]
fn edit_files_match_their_recorded_screens() {
    let update = are_written_anew();
    let mut wrong = String::new();
    for path in texts_of("editing") {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let expected = std::fs::read_to_string(&path).unwrap();
        let played = match std::panic::catch_unwind(|| play(&expected)) {
            Ok(played) => played,
            Err(panic) => {
                let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
                let text = text.or(panic.downcast_ref::<String>().cloned());
                writeln!(wrong, "--- {name}: {}", text.unwrap_or_default()).unwrap();
                continue;
            }
        };
        if played == expected {
            continue;
        }
        if update {
            std::fs::write(&path, played).unwrap();
            continue;
        }
        writeln!(wrong, "--- {name} (- expected, + came)").unwrap();
        wrong.push_str(&difference(&expected, &played));
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

#[test]
fn file_content_notation_round_trips() {
    for content in [&b""[..], b"[]", b"[]\n", b"\xef\xbb\xbf[\r\n\t1 \r\n]  \n", b"\xff\x00\n\n \n"]
    {
        let text = block(content, "");
        assert_eq!(read_block(&mut text.lines().peekable()), content, "{text}");
        assert!(!text.contains(['\r', '\t']) && !text.contains(" \n"), "{text}");
    }
}

#[test]
fn difference_is_shown_with_context() {
    let shown = difference("1\n2\n3\n4\n5\n6\nA\n7\n", "1\n2\n3\n4\n5\n6\nB\nC\n7\n");
    assert_eq!(shown, "  3\n  4\n  5\n  6\n- A\n+ B\n+ C\n  7\n");
}
