//! `descan sim`: simulated devices on a real bus. Their own bus is simulated; frames are relayed
//! between the two in both directions.

use super::{EXIT_OK, EXIT_UNUSABLE, Failure, headless, open, output};
use crate::bus::{self, Clock, Options};
use crate::cli::SimArgs;
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame, FrameKind};
use crate::shell::signals::StopSignals;
use crate::shell::stop;
use crate::shell::waiting::block_on;
use crate::sim::{DeviceSpec, Scenario, Sim};
use crate::status::Link;
use crate::text::counted;
use crate::time::Instant;
use anyhow::Context;
use std::time::Duration;

/// Bit rate of the simulated bus of one device, in bit/s: that of the bus is at most this.
const SIMULATED_BITRATE: u32 = 1_000_000;
/// Shortest time between two relays.
const NAP: Duration = Duration::from_millis(2);

/// Runs until interrupted, or for `--time`.
///
/// # Errors
/// The bus cannot transmit or be opened, or the scenario or the profile is invalid.
pub fn run(args: &SimArgs) -> Result<u8, Failure> {
    let (spec, time) = (&args.bus, args.time);
    if !spec.kind().can_send {
        return Err(Failure::Usage(format!(
            "cannot simulate devices on {spec}; for a simulated bus: descan demo"
        )));
    }
    let scenario = match &args.device {
        Some(name) => one_device(name, args)?,
        None => bus::scenario(args.scenario.as_deref().unwrap_or("boiler"))
            .map_err(|error| Failure::Unusable(error.to_string()))?,
    };
    let clock = Clock::start();
    let mut sim = Sim::from_scenario(&scenario);
    let station = sim.attach();
    block_on(&headless::runtime()?, async {
        stop::exit_if_stuck(EXIT_OK, || {}).context("no signals")?;
        let mut stopped = StopSignals::without_hangup().context("no signals")?;
        // After the signals: an opened adapter is closed again, however soon one arrives.
        let port = bus::open(spec, BusIndex(0), clock.clone(), Options::default())?;
        let mut heard: Vec<Frame> = Vec::new();
        // The simulation starts when the real bus is open.
        let mut start = None;
        let mut told = None;
        loop {
            let now = clock.now();
            // Taken, so that `ready` waits for the next change.
            port.queue().take_status();
            let status = port.queue().status();
            let is_away = !matches!(status.link, Link::Opening | Link::Up);
            if is_away && told != Some(status.link) {
                let unknown = || Diagnostic::new(format!("{spec} cannot be used"));
                output::warn(status.fault.unwrap_or_else(unknown));
                // Wait for a bus that was open once.
                if start.is_none() || status.link.is_final() {
                    return Ok(EXIT_UNUSABLE);
                }
            }
            told = is_away.then_some(status.link);
            if time.is_some_and(|time| now.since(Instant::ZERO) >= time) {
                return Ok(EXIT_OK);
            }
            if status.link == Link::Up && start.is_none() {
                let devices = counted(scenario.devices.len() as u64, "device");
                output::say(format_args!("{devices} on {spec}; Ctrl-C stops"));
                start = Some(now);
            }
            heard.clear();
            port.queue().drain(&mut heard, usize::MAX);
            if let Some(start) = start {
                sim.advance(Instant::ZERO + now.since(start));
                let is_heard = |it: &&Frame| !it.is_tx && it.kind != FrameKind::Error;
                for frame in heard.iter().filter(is_heard) {
                    sim.forward(station, *frame);
                }
            }
            while let Some(frame) = sim.poll_frame(station) {
                if !frame.is_tx && frame.kind != FrameKind::Error {
                    // The port's status reports a full outbox.
                    let _ = port.transmit(&frame);
                }
            }
            let next = sim.next_event().map_or(NAP, |at| at.since(sim.now())).max(NAP);
            tokio::select! {
                biased;
                () = stopped.next() => return Ok(EXIT_OK),
                () = tokio::time::sleep(next.min(Duration::from_secs(1))) => {}
                () = port.queue().ready(), if next > NAP => {}
            }
        }
    })
}

/// Returns the scenario of one device that works once it has its address.
fn one_device(name: &str, args: &SimArgs) -> Result<Scenario, Failure> {
    let device = DeviceSpec::new(name);
    let device = if let Some(address) = args.node_address {
        device.fixed(address.number())
    } else {
        // Without an address of its own it would stay in CFG.
        let sum = name.bytes().fold(0u32, |sum, byte| sum * 31 % 127 + u32::from(byte));
        device.preferred((sum % 127) as u8 + 1)
    };
    let device = args
        .services
        .iter()
        .fold(device, |device, (service, version)| device.service(service, version));
    let profile = open::profile(args.profile.as_deref())?;
    Ok(Scenario { profile, ..Scenario::new(SIMULATED_BITRATE).with(device) })
}
