//! `descan speed`: finds the bit rate of a bus. Listen-only first; an active search, which disturbs
//! a bus of another rate, needs the user's consent.

use super::open::profile;
use super::output::{self, ask, say};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, headless};
use crate::bitrate::{ListenMode, SearchOutcome, SearchProgress, kbit};
use crate::bus::{BusSpec, TuneError};
use crate::cli::SpeedArgs;
use crate::shell::bitrate_search::{Plan, SearchReport, find};
use crate::shell::stop::StopWaiter;
use crate::shell::waiting::block_on;
use crate::text::printable_path;
use anyhow::Context;
use serde::Serialize;
use std::io::{self, IsTerminal};

/// Runs it.
pub fn run(speed: &SpeedArgs) -> Result<u8, Failure> {
    let runtime = headless::runtime()?;
    let result = block_on(&runtime, async {
        let mut endings = StopWaiter::new(None, EXIT_INTERRUPTED).context("no signals")?;
        tokio::select! {
            biased;
            // Dropping the search restores the previous setting.
            _ = endings.next() => Ok(EXIT_INTERRUPTED),
            done = search(speed) => done,
        }
    });
    // A prompt may still wait for its line.
    runtime.shutdown_background();
    result
}

async fn search(speed: &SpeedArgs) -> Result<u8, Failure> {
    let bus = &speed.bus;
    let manner = if speed.active { ListenMode::Active } else { ListenMode::ListenOnly };
    let mut report = attempt(speed, manner).await?;
    if manner == ListenMode::ListenOnly && !matches!(report.outcome, SearchOutcome::Found(_)) {
        say(nothing_heard(bus, report.outcome));
        if may_ask(speed) && wants_to_take_part(bus).await {
            report = attempt(speed, ListenMode::Active).await?;
        } else {
            print(speed, &report)?;
            say(format!("to search actively: descan speed {bus} --active"));
            return Ok(EXIT_FINDINGS);
        }
    }
    print(speed, &report)?;
    if let SearchOutcome::Found(rate) = report.outcome {
        say(match bus {
            BusSpec::Slcan(slcan) => {
                format!("open it with: descan slcan:{}@{rate}", printable_path(&slcan.device))
            }
            _ => format!("{bus} keeps this bit rate; open it with: descan {bus}"),
        });
        return Ok(EXIT_OK);
    }
    say("no frames at any rate; check that a device is on, and CAN_H, CAN_L and ground");
    Ok(EXIT_FINDINGS)
}

async fn attempt(speed: &SpeedArgs, manner: ListenMode) -> Result<SearchReport, Failure> {
    let period = profile(speed.profile.as_deref())?.heartbeat.period();
    let plan = Plan { first: speed.first, manner, period };
    let bus = &speed.bus;
    let what = match manner {
        ListenMode::ListenOnly => "listen-only",
        ListenMode::Active => "active",
    };
    let report = find(bus, plan, |progress| match progress {
        SearchProgress::Trying(rate) => say(format!("{bus} at {}: {what} …", kbit(rate))),
        SearchProgress::NothingValid(rate, heard) => {
            say(format!(
                "{bus} at {}: no valid frame, {} bus errors",
                kbit(rate),
                heard.bus_errors
            ));
        }
        SearchProgress::Skipped(rate) => {
            say(format!("{bus} at {}: not supported by the controller", kbit(rate)));
        }
    });
    report.await.map_err(|error| match error {
        TuneError::NoRate(fault) => Failure::Usage(fault.to_string()),
        TuneError::NotThisRate(fault) | TuneError::Failed(fault) => fault.into(),
    })
}

fn nothing_heard(bus: &BusSpec, outcome: SearchOutcome) -> String {
    let what = match outcome {
        SearchOutcome::OnlyBusErrors => "bus errors but no valid frame",
        _ => "no frames at any rate",
    };
    format!(
        "{bus}: {what}. Listen-only search cannot find a device alone on the bus: \
         it gets no ACK."
    )
}

fn may_ask(speed: &SpeedArgs) -> bool {
    !speed.json && io::stdin().is_terminal() && io::stderr().is_terminal()
}

/// Prompts on the terminal; returns true only for y or yes.
async fn wants_to_take_part(bus: &BusSpec) -> bool {
    ask(format_args!("Search actively on {bus}? A wrong rate destroys other nodes' frames. [y/N]"));
    let line = tokio::task::spawn_blocking(|| {
        let mut line = String::new();
        io::stdin().read_line(&mut line).map(|_| line)
    });
    let line = line.await.ok().and_then(Result::ok).unwrap_or_default();
    matches!(line.trim(), "y" | "Y" | "yes")
}

#[derive(Serialize)]
struct SpeedOutput<'a> {
    bus: String,
    bitrate: Option<u32>,
    tried: &'a [Tried],
}

#[derive(Serialize)]
struct Tried {
    bitrate: u32,
    frames: u64,
    broken: u64,
}

fn print(speed: &SpeedArgs, report: &SearchReport) -> Result<(), Failure> {
    let bus = speed.bus.to_string();
    let bitrate = match report.outcome {
        SearchOutcome::Found(rate) => Some(rate),
        SearchOutcome::OnlyBusErrors | SearchOutcome::NoTraffic => None,
    };
    let line = if speed.json {
        let tried = report.tried.iter().map(|(bitrate, heard)| Tried {
            bitrate: *bitrate,
            frames: heard.frames,
            broken: heard.bus_errors,
        });
        let tried: Vec<Tried> = tried.collect();
        let told = SpeedOutput { bus, bitrate, tried: &tried };
        serde_json::to_string(&told).context("JSON")?
    } else if let Some(bitrate) = bitrate {
        format!("{bus}: {bitrate} bit/s")
    } else {
        return Ok(());
    };
    let line = format!("{line}\n");
    if speed.json { output::print_json(&line) } else { output::print(&line) }
}
