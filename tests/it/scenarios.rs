//! Scenarios: frames received on a bus, and the frames and events of the engine in response.
//!
//! A scenario is a text file in `tests/scenarios`. Its input lines are
//!
//! ```text
//! # a comment
//! set listen-only            (or: announce, no-scan, address 5)
//! 1.200 05180002#0601464545440000   a frame received at that time
//! 2.500                      wait until that time
//! 3.000 rescan               a command; or suspend, restart, clear-lost, show
//! ```
//!
//! and the indented lines below each are the expected results: `>` a frame sent, `*` an event, `?`
//! the final state. A file named `row_…` covers a row of the table of conflicts, from its first
//! evidence to its end; `innocent_…` a similar case that must never be confirmed. Run with
//! `UPDATE_SCENARIOS=1` to write the results instead of checking them; then review the diff.

use crate::common::inspection::describe;
use crate::common::scenario_files::{are_written_anew, texts_of};
use descan::discovery::{Config, Engine};
use descan::frame::{CanId, Frame};
use descan::time::Instant;
use descan::wire::id::Address;
use descan::wire::profile::{Announce, Profile};
use std::fmt::Write;
use std::sync::Arc;

fn parse_time(text: &str) -> Instant {
    let (seconds, fraction) = text.split_once('.').unwrap_or((text, ""));
    let micros: u64 = format!("{fraction:0<6}").parse().expect("a fraction of a second");
    Instant::from_micros(seconds.parse::<u64>().expect("seconds") * 1_000_000 + micros)
}

fn parse_frame(text: &str) -> Frame {
    let (id, data) = text.split_once('#').expect("ID#DATA");
    let number = u32::from_str_radix(id, 16).expect("a hexadecimal identifier");
    let data: Vec<u8> = (0..data.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&data[at..at + 2], 16).expect("hexadecimal data"))
        .collect();
    if id.len() == 8 && number & 0x2000_0000 != 0 {
        return Frame::error(number, &data);
    }
    let id = if id.len() == 3 { CanId::Standard(number as u16) } else { CanId::Extended(number) };
    Frame::new(id, &data)
}

/// An engine whose frames are all sent by the bus at once.
struct Stage {
    engine: Engine,
    now: Instant,
    log: String,
    taken: bool,
}

impl Stage {
    fn drain(&mut self) {
        loop {
            let sent = self.engine.poll_transmit(self.now);
            if let Some(frame) = sent {
                writeln!(self.log, "  {} > {frame}", self.now).unwrap();
                if self.taken {
                    self.engine.handle_frame(&frame.with_time(self.now).with_tx());
                }
            }
            while let Some(event) = self.engine.poll_event() {
                writeln!(self.log, "  {} * {}", event.time, describe(&event)).unwrap();
            }
            if sent.is_none() {
                break;
            }
        }
    }

    fn run_until(&mut self, until: Instant) {
        while let Some(due) = self.engine.poll_timeout().filter(|due| *due <= until) {
            self.now = self.now.max(due);
            self.engine.handle_timeout(self.now);
            self.drain();
        }
        self.now = until;
    }

    fn show_devices(&mut self) {
        for device in self.engine.devices() {
            let name = device.name.as_ref().map_or("?".to_owned(), ToString::to_string);
            let services = device.services.as_ref().map_or("?".to_owned(), |services| {
                services
                    .iter()
                    .map(|s| format!("{} {}", s.name, s.version))
                    .collect::<Vec<_>>()
                    .join(", ")
            });
            write!(self.log, "  ? {} {name} {}", device.address, device.presence).unwrap();
            if let Some(mode) = device.mode {
                write!(self.log, " {mode}").unwrap();
            }
            writeln!(self.log, " [{services}]").unwrap();
        }
        for finding in self.engine.findings() {
            writeln!(self.log, "  ? {} {}: {}", finding.key.kind, finding.state, finding.text)
                .unwrap();
        }
    }
}

fn play(scenario: &str) -> String {
    let mut config = Config { seed: 1, ..Config::default() };
    let mut profile = Profile::default();
    profile.heartbeat.announce = Announce::Never;
    let mut taken = true;
    let mut stage: Option<Stage> = None;
    let mut log = String::new();
    for line in scenario.lines() {
        if line.starts_with(' ') {
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        let stage = match words[..] {
            [] | ["#", ..] => {
                let log = stage.as_mut().map_or(&mut log, |stage| &mut stage.log);
                writeln!(log, "{line}").unwrap();
                continue;
            }
            ["set", setting, ref rest @ ..] => {
                match (setting, rest) {
                    ("listen-only", []) => config.listen_only = true,
                    ("no-scan", []) => config.send_requests = false,
                    ("no-rounds", []) => config.round_period = std::time::Duration::ZERO,
                    ("alone", []) => taken = false,
                    ("announce", []) => profile.heartbeat.announce = Announce::Always,
                    ("address", [address]) => {
                        config.address = Address::new(address.parse().unwrap());
                    }
                    other => panic!("unknown setting {other:?}"),
                }
                writeln!(log, "{line}").unwrap();
                continue;
            }
            _ => stage.get_or_insert_with(|| {
                config.profile = Arc::new(profile.clone());
                let engine = Engine::new(Instant::ZERO, config.clone());
                Stage { engine, now: Instant::ZERO, log: std::mem::take(&mut log), taken }
            }),
        };
        let at = parse_time(words[0]);
        // Results of elapsed time are written above the line with the end time.
        stage.run_until(at);
        writeln!(stage.log, "{line}").unwrap();
        match words[1..] {
            [] => {}
            ["rescan"] => stage.engine.rescan(at),
            ["suspend"] => stage.engine.suspend(at),
            ["restart"] => stage.engine.restart(at),
            ["clear-lost"] => stage.engine.remove_lost_devices(),
            ["show"] => stage.show_devices(),
            [frame] => stage.engine.handle_frame(&parse_frame(frame).with_time(at)),
            ref other => panic!("unknown input {other:?}"),
        }
        stage.drain();
        if stage.engine.poll_timeout().is_some_and(|due| due <= at) {
            stage.engine.handle_timeout(at);
            stage.drain();
        }
    }
    stage.map_or(log, |stage| stage.log)
}

#[test]
fn scenario_files_give_their_recorded_events() {
    let update = are_written_anew();
    let mut wrong = String::new();
    for path in texts_of("scenarios") {
        let expected = std::fs::read_to_string(&path).unwrap();
        let played = play(&expected);
        if played == expected {
            continue;
        }
        if update {
            std::fs::write(&path, played).unwrap();
            continue;
        }
        writeln!(wrong, "--- {}", path.file_name().unwrap().to_string_lossy()).unwrap();
        let mut theirs = expected.lines();
        for line in played.lines() {
            let wanted = theirs.next().unwrap_or("(the end)");
            if wanted != line {
                writeln!(wrong, "expected: {wanted}\nplayed:   {line}").unwrap();
                break;
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}
