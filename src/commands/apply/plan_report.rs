//! What `descan apply` prints: the plan as a table, each step as it ends, and all as JSON.

use crate::address_plan::{DeviceIdentity, LeftOutReason, PlanRun, PlanStep, RunState, StepState};
use crate::app::{App, PlanSession};
use crate::commands::Failure;
use crate::commands::output::{self, say};
use crate::wire::id::Address;
use serde::Serialize;
use std::fmt::Write as _;

/// The plan as a table.
pub fn table(app: &App, session: &PlanSession) -> String {
    let mut rows =
        vec![["ORDER", "DEVICE", "UID", "FROM", "TO", "WHY", "STATE"].map(str::to_owned)];
    let uid = |identity: &DeviceIdentity| uid_text(app, session, identity);
    for (at, step) in session.plan().steps.iter().enumerate() {
        rows.push([
            (at + 1).to_string(),
            step.device.label(),
            uid(&step.device),
            step.from.to_string(),
            step.to.to_string(),
            step.why(),
            session.step_state(at).to_string(),
        ]);
    }
    for left in &session.plan().left_out {
        let state = if left.reason.is_done() { "–" } else { "left out" };
        rows.push([
            "–".to_owned(),
            left.device.label(),
            uid(&left.device),
            left.at.map_or("–".to_owned(), |at| at.to_string()),
            left.to.to_string(),
            left.reason.to_string(),
            state.to_owned(),
        ]);
    }
    let width =
        |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; 7] = std::array::from_fn(width);
    let mut text = String::new();
    for row in &rows {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(widths) {
            let _ = write!(line, "{cell:width$}  ");
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

fn uid_text(app: &App, session: &PlanSession, identity: &DeviceIdentity) -> String {
    identity.uid_text(&app.profile(session.bus()).uid)
}

/// Prints the steps that ended since.
pub fn print_steps(
    session: &PlanSession,
    printed: &mut usize,
    is_json: bool,
) -> Result<(), Failure> {
    let count = session.plan().steps.len();
    while *printed < count {
        let state = session.step_state(*printed);
        let is_over =
            matches!(state, StepState::Confirmed | StepState::Stored | StepState::Failed(_));
        if !is_over {
            return Ok(());
        }
        let step = &session.plan().steps[*printed];
        let frame = session.frame(*printed).map(|frame| format!(" ({frame})"));
        let line = format!(
            "{} of {count}  {} {} → {}{}: {state}",
            *printed + 1,
            step.device.label(),
            step.from,
            step.to,
            frame.unwrap_or_default()
        );
        if is_json {
            say(line);
        } else {
            output::print(&format!("{line}\n"))?;
        }
        *printed += 1;
    }
    Ok(())
}

// ---- JSON ------------------------------------------------------------------------------------

/// The edits of des.json, as JSON.
#[derive(Serialize)]
pub struct PinReport {
    pub descan: &'static str,
    pub file: String,
    pub edits: Vec<String>,
    pub left_out: Vec<UnpinnedReport>,
    #[serde(rename = "saved")]
    pub is_saved: bool,
}

/// An entry that is not pinned, as JSON.
#[derive(Serialize)]
pub struct UnpinnedReport {
    name: String,
    reason: &'static str,
    why: String,
}

impl UnpinnedReport {
    pub fn new((name, reason): &(String, LeftOutReason)) -> Self {
        Self { name: name.clone(), reason: reason.word(), why: reason.to_string() }
    }
}

/// A plan and what became of it, as JSON.
#[derive(Serialize)]
pub struct ApplyReport<'a> {
    descan: &'static str,
    bus: &'a str,
    /// `now`, `restart` or `later`.
    effect: &'static str,
    /// Name of the plan's file; `null` if nothing was started.
    plan: Option<&'a str>,
    /// `planned`, `running`, `stopped`, `stored` or `done`.
    state: &'static str,
    /// Why it stopped.
    stopped: Option<String>,
    steps: Vec<StepReport>,
    left_out: Vec<LeftOutReport>,
}

/// A step, as JSON.
#[derive(Serialize)]
struct StepReport {
    order: usize,
    name: Option<String>,
    /// Empty if it is blank, `null` if it was not heard.
    uid: Option<String>,
    from: u8,
    to: u8,
    /// What is written, as `descan address` takes it; `null`: the device only restarts.
    setting: Option<String>,
    why: String,
    state: &'static str,
    /// Why it failed.
    cause: Option<String>,
    /// The last request of the step; `null` if none was sent.
    frame: Option<String>,
}

/// A device without a step, as JSON.
#[derive(Serialize)]
struct LeftOutReport {
    name: Option<String>,
    /// Empty if it is blank, `null` if it was not heard.
    uid: Option<String>,
    from: Option<u8>,
    to: u8,
    reason: &'static str,
    why: String,
}

impl<'a> ApplyReport<'a> {
    pub fn new(app: &'a App, session: &'a PlanSession) -> Self {
        let profile = app.profile(session.bus());
        let uid =
            |identity: &DeviceIdentity| identity.uid.map(|uid| uid.text(&profile.uid).to_string());
        let name = |identity: &DeviceIdentity| identity.name.as_ref().map(ToString::to_string);
        let step = |(at, step): (usize, &PlanStep)| {
            let state = session.step_state(at);
            StepReport {
                order: at + 1,
                name: name(&step.device),
                uid: uid(&step.device),
                from: step.from.number(),
                to: step.to.number(),
                setting: step.setting.map(|setting| setting.to_string()),
                why: step.why(),
                state: state.word(),
                cause: match state {
                    StepState::Failed(cause) => Some(cause),
                    _ => None,
                },
                frame: session.frame(at).map(ToString::to_string),
            }
        };
        let run = session.run().map(PlanRun::state);
        let left_out = session.plan().left_out.iter().map(|left| LeftOutReport {
            name: name(&left.device),
            uid: uid(&left.device),
            from: left.at.map(Address::number),
            to: left.to.number(),
            reason: left.reason.word(),
            why: left.reason.to_string(),
        });
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            bus: app.bus(session.bus()).map_or("", |bus| &bus.name),
            effect: app.plan_effect(session).word(),
            plan: session.file_name(),
            state: run.map_or("planned", RunState::word),
            stopped: match run {
                Some(RunState::Stopped(cause)) => Some(cause.clone()),
                _ => None,
            },
            steps: session.plan().steps.iter().enumerate().map(step).collect(),
            left_out: left_out.collect(),
        }
    }
}

pub fn print_json(report: &impl Serialize) -> Result<(), Failure> {
    let json = serde_json::to_string_pretty(report).map_err(anyhow::Error::from)?;
    output::print_json(&(json + "\n"))
}
