//! `descan sim`: simulated devices on a bus. Their bus is simulated too; what they send there
//! goes out to the real one, and what is heard there comes in.

use super::{EXIT_OK, EXIT_UNUSABLE, Failure, headless};
use crate::bus::{self, BusSpec, Clock, Options};
use crate::frame::{BusIndex, Frame, FrameKind};
use crate::sim::Sim;
use crate::status::Link;
use crate::time::Instant;
use anyhow::Context;
use std::io::{self, Write};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};

/// The pace at which both buses exchange frames.
const NAP: Duration = Duration::from_millis(2);

/// Runs until interrupted, or for `time`.
pub fn run(spec: &BusSpec, scenario: &str, time: Option<Duration>) -> Result<u8, Failure> {
    if !spec.kind().can_send {
        return Err(Failure::Usage(format!(
            "cannot simulate devices on {spec}; for a simulated bus: descan demo"
        )));
    }
    let scenario = bus::scenario(scenario).map_err(|error| Failure::Unusable(error.to_string()))?;
    let clock = Clock::start();
    let mut sim = Sim::from_scenario(&scenario);
    let station = sim.attach();
    headless::runtime()?.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt()).context("no signals")?;
        let mut terminate = signal(SignalKind::terminate()).context("no signals")?;
        // After the signals: an adapter that was opened is closed again, however soon one comes.
        let port = bus::open(spec, BusIndex(0), clock.clone(), Options::default())
            .map_err(|error| Failure::Unusable(error.to_string()))?;
        let mut heard: Vec<Frame> = Vec::new();
        // The simulated bus begins when the other one is there.
        let mut start = None;
        let mut told = None;
        loop {
            let now = clock.now();
            // Taken, so that it is no news any more: the loop sleeps until there is some.
            port.queue().take_status();
            let status = port.queue().status();
            let is_away = !matches!(status.link, Link::Opening | Link::Up);
            if is_away && told != Some(status.link) {
                let why = status.message.unwrap_or_else(|| format!("{spec} cannot be used"));
                let _ = writeln!(io::stderr(), "descan: {why}");
                // What was there once is waited for.
                if start.is_none() || status.link.is_final() {
                    return Ok(EXIT_UNUSABLE);
                }
            }
            told = is_away.then_some(status.link);
            if time.is_some_and(|time| now.since(Instant::ZERO) >= time) {
                return Ok(EXIT_OK);
            }
            if status.link == Link::Up && start.is_none() {
                let devices = scenario.devices.len();
                let _ = writeln!(io::stderr(), "{devices} devices on {spec}; Ctrl-C stops");
                start = Some(now);
            }
            heard.clear();
            port.queue().drain(&mut heard, usize::MAX);
            if let Some(start) = start {
                sim.advance(Instant::ZERO + now.since(start));
                let is_heard = |it: &&Frame| !it.is_tx && it.kind != FrameKind::Error;
                for frame in heard.iter().filter(is_heard) {
                    sim.relay(station, *frame);
                }
            }
            while let Some(frame) = sim.poll_frame(station) {
                if !frame.is_tx && frame.kind != FrameKind::Error {
                    // A full outbox is a bus that takes nothing; its status says so.
                    let _ = port.transmit(&frame);
                }
            }
            let next = sim.next_event().map_or(NAP, |at| at.since(sim.now())).max(NAP);
            tokio::select! {
                biased;
                _ = interrupt.recv() => return Ok(EXIT_OK),
                _ = terminate.recv() => return Ok(EXIT_OK),
                () = tokio::time::sleep(next.min(Duration::from_secs(1))) => {}
                () = port.queue().ready(), if next > NAP => {}
            }
        }
    })
}
