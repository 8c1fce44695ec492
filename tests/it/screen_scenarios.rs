//! The screen in `tests/screens/*.txt`: a simulated bus, keys, and what the screen shows then.
//!
//! A line is a step: `until SECONDS`, `size COLUMNS ROWS`, `keys KEYS`, `text TEXT`, `shows TEXT` (in a
//! line of the screen, however wide its gaps are), `lacks TEXT`. `#` begins a comment.

use crate::common::harness::{BOILER, Stage};
use descan::discovery::Config;
use descan::sim::Scenario;
use std::fs;
use std::path::Path;

/// Room for captured frames, in bytes: more than any scenario needs.
const ROOM: usize = 16 << 20;

fn squeezed(line: &str) -> String {
    line.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns why a step fails; `None` if it does not.
fn step(stage: &mut Stage, word: &str, rest: &str) -> Option<String> {
    match word {
        "until" => drop(stage.until(rest.parse().expect("seconds"))),
        "size" => {
            let (columns, rows) = rest.split_once(' ').expect("columns and rows");
            stage.size(columns.parse().expect("columns"), rows.parse().expect("rows"));
        }
        "keys" => drop(stage.keys(rest)),
        "text" => drop(stage.text(rest)),
        "shows" | "lacks" => {
            stage.app.renew_rows();
            let screen = stage.screen();
            let wanted = squeezed(rest);
            let is_shown = screen.lines().any(|line| squeezed(line).contains(&wanted));
            return (is_shown != (word == "shows")).then_some(screen);
        }
        other => return Some(format!("unknown step {other}")),
    }
    None
}

#[test]
fn screens_are_those_of_the_scenarios() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/screens");
    let mut failures = Vec::new();
    let mut count = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let config = Config { seed: 7, ..Config::default() };
        let file = Some(BOILER.as_bytes().to_vec());
        let mut stage = Stage::with_room(&Scenario::builtin("boiler").unwrap(), file, config, ROOM);
        let (text, mut checks) = (fs::read_to_string(&path).unwrap(), 0);
        for (at, line) in (1..).zip(text.lines()) {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
            checks += usize::from(matches!(word, "shows" | "lacks"));
            if let Some(why) = step(&mut stage, word, rest) {
                failures.push(format!("{}:{at}: {line}\n{why}", path.display()));
                break;
            }
        }
        assert!(checks > 0, "{} shows nothing", path.display());
        count += 1;
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(count >= 4, "{count} scenarios");
}
