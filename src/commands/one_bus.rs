//! A command that does something on one bus: it waits until the bus can be used, then goes on step by
//! step until it is over.
//!
//! Does not know what the steps are.

use super::gate::BusGate;
use super::headless::{self, Limits, RunInput, RunOutcome};
use super::open::Setup;
use super::{EXIT_INTERRUPTED, Failure};
use crate::app::{App, AppOptions};
use crate::bus::BusSpec;
use crate::shell::stop::StopReason;
use crate::time::Instant;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

/// Time in which devices must be found, unless given.
const SEARCH_TIME: Duration = Duration::from_secs(15);

/// How a command ended.
pub struct CommandRun {
    /// All state.
    pub app: App,
    /// A signal stopped it.
    pub is_interrupted: bool,
}

/// Runs a command. Once the bus can be used, for which it waits `search` at most, `advance` is called after each wake-up, with the time and
/// the end of the search for devices (`search` later, by default 15 s), until it returns true. Devices
/// are asked for nothing but by the command.
///
/// # Errors
/// The bus or the recording cannot be used, or `advance` failed.
pub fn run(
    bus: &BusSpec,
    mut setup: Setup,
    search: Option<Duration>,
    mut advance: impl FnMut(&mut App, Instant, Instant) -> Result<bool, Failure>,
) -> Result<CommandRun, Failure> {
    Arc::make_mut(&mut setup.config.profile).descriptor.auto = false;
    let search = search.unwrap_or(SEARCH_TIME);
    // A missing bus gives no news.
    let turn_period = Some(Duration::from_secs(1));
    let limits = Limits { turn_period, stuck: EXIT_INTERRUPTED, ..Limits::default() };
    let input = RunInput::Buses(std::slice::from_ref(bus));
    let mut gate = BusGate::new(false);
    let (mut waits, mut began) = (None, None);
    let RunOutcome { app, ending, recording, .. } =
        headless::run(input, &setup, AppOptions::default(), limits, |session| {
            let now = session.now();
            if !gate.allows(&session.app, now)? {
                let is_missing = now >= *waits.get_or_insert(now) + search;
                return Ok(if is_missing {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                });
            }
            let end = *began.get_or_insert(now) + search;
            let is_over = advance(&mut session.app, now, end)?;
            Ok(if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
        })?;
    let is_interrupted = ending == Some(StopReason::Interrupted);
    if !is_interrupted {
        gate.require_opened(&app)?;
        recording?;
    }
    Ok(CommandRun { app, is_interrupted })
}
