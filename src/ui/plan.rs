//! The plan of addresses: its steps, the devices without one, and the requests of the selected row.
//! Takes the place of the page. And the line about a plan that runs.
//!
//! ```text
//! ─ Plan: give 3 devices the addresses of des.json ─ sends 4 requests ────────────
//!   ORDER DEVICE     UID       FROM   TO  WHY                       STATE
//! ▸ 1     DISP       BOILER04    20   21  21 is free                confirmed
//!   2     SENS       BOILER05    13   15  15 is free                sent 0.4 s
//!   –     ACT        SPARE01     14   18  shares 14: unplug one     left out
//! ─ step 1: DISP 20 → 21 ─────────────────────────────────────────────────────────
//!  00002816 15   fixed 21
//!  each step waits up to 5 s for the heartbeat at the new address; a failure stops
//!  [x] fixed addresses   [ ] restart each   plan: 20261121-120036-can0.json
//! ```
//!
//! Narrow screens leave out the UID, then ORDER and WHY.

use super::brush::{DrawContext, fit, fit_right};
use crate::address_plan::{
    DeviceIdentity, LeftOut, PlanRun, PlanStep, RunState, StepEffect, StepState,
};
use crate::app::{PlanSession, PlanTask};
use crate::keymap::Action;
use crate::text::{counted, hex, join_first};
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use std::fmt::Write as _;
use unicode_width::UnicodeWidthStr;

/// Least width with the UIDs.
const WITH_UIDS: u16 = 76;
/// Least width with the order and the reason.
const WITH_REASONS: u16 = 60;
/// Least height with what is below the list.
const WITH_DETAILS: u16 = 12;
/// Lines below the list: rule, two requests, two about the plan.
const DETAILS: u16 = 5;
/// Columns of the state.
const STATE_WIDTH: usize = 13;

/// Draws the line above the page, if a plan runs; returns false if there is none.
pub fn draw_banner(brush: &mut DrawContext) -> bool {
    let area = brush.screen.banner;
    let Some(text) = brush.app.plan_banner().filter(|_| area.height > 0) else { return false };
    let end = format!("{} shows the plan ", brush.app.key_of(Action::Plan));
    let width = usize::from(area.width);
    let text = fit(&format!(" {text}"), width.saturating_sub(end.width() + 1));
    let gap = width.saturating_sub(text.width() + end.width());
    let line = Line::from(vec![
        brush.span(Role::Warning, text),
        brush.span(Role::Muted, format!("{}{end}", " ".repeat(gap))),
    ]);
    brush.line(area, 0, &line);
    true
}

/// Draws the plan.
pub fn draw(brush: &mut DrawContext) {
    let Some(session) = brush.app.address_plan() else { return };
    let area = brush.panel(&title(brush, session));
    let area = Rect { height: area.height.saturating_sub(brush.screen.time_bar.height), ..area };
    let columns = PlanColumns::new(area);
    let header = columns.row(["", "DEVICE", "UID", "FROM", "TO", "WHY"], false);
    let header = format!("{header}STATE");
    brush.line(area, 0, &Line::from(brush.span(Role::Header, header)));
    let below = if area.height >= WITH_DETAILS { DETAILS } else { 0 };
    let list = Rect { y: area.y + 1, height: area.height.saturating_sub(1 + below), ..area };
    if session.is_reading() {
        let text = " reading the settings that the devices have stored …";
        brush.line(list, 0, &Line::from(brush.span(Role::Muted, text)));
    } else if session.rows() == 0 {
        let text = " no entry pins an address: a pins one, in the list of devices";
        brush.line(list, 0, &Line::from(brush.span(Role::Muted, text)));
    }
    let height = usize::from(list.height).max(1);
    let selected = shown_row(session);
    let top = (selected + 1).saturating_sub(height);
    for row in (top..session.rows()).take(height) {
        let plan = session.plan();
        let look = (columns, row == selected);
        let spans = if let Some(step) = plan.steps.get(row) {
            step_spans(brush, session, (row, step), look)
        } else {
            left_out_spans(brush, session, &plan.left_out[row - plan.steps.len()], look)
        };
        let at = (row - top) as u16;
        brush.line(list, at, &Line::from(spans));
        if row == selected {
            brush.select(list, at);
        }
    }
    if below > 0 {
        let rule = Rect { y: list.bottom(), height: 1, ..area };
        draw_details(brush, session, selected, rule);
    }
}

/// The row that is shown as selected: while the plan runs its present step.
fn shown_row(session: &PlanSession) -> usize {
    match session.run() {
        Some(run) if run.is_running() => run.current().min(session.rows().saturating_sub(1)),
        _ => session.selected(),
    }
}

fn title(brush: &DrawContext, session: &PlanSession) -> String {
    let plan = session.plan();
    let devices = counted(plan.devices() as u64, "device");
    let requests = counted(plan.requests(brush.app.plan_effect(session)) as u64, "request");
    let source = match session.task() {
        PlanTask::ToFile => {
            format!("the addresses of {}", brush.app.name_of_file(Some(session.bus())))
        }
        PlanTask::Resume(..) => "their addresses, what is left".to_owned(),
        PlanTask::TakeBack(..) => "their former addresses".to_owned(),
    };
    let state = match session.run().map(PlanRun::state) {
        None => format!("sends {requests}"),
        Some(RunState::Running) => {
            let run = session.run();
            let step = run.map_or(0, |run| run.current() + 1);
            format!("step {step} of {}", plan.steps.len())
        }
        Some(RunState::Stopped(_)) => "stopped".to_owned(),
        Some(RunState::Stored) => "stored, not in force".to_owned(),
        Some(RunState::Done) => "done".to_owned(),
    };
    format!(" Plan: give {devices} {source} ─ {state} ")
}

/// Which columns there are, and how wide.
#[derive(Clone, Copy)]
struct PlanColumns {
    has_uids: bool,
    has_reasons: bool,
    /// Columns of the reason: what the others leave.
    why: usize,
}

impl PlanColumns {
    fn new(area: Rect) -> Self {
        let (has_uids, has_reasons) = (area.width >= WITH_UIDS, area.width >= WITH_REASONS);
        let others = 2 + 4 + 11 + if has_uids { 10 } else { 0 } + 5 + 5 + 1 + STATE_WIDTH;
        let why = usize::from(area.width).saturating_sub(others).clamp(8, 48);
        Self { has_uids, has_reasons, why }
    }

    fn row(self, cells: [&str; 6], is_selected: bool) -> String {
        let [order, name, uid, from, to, reason] = cells;
        let sign = if is_selected { "▸" } else { " " };
        let order = if self.has_reasons { format!("{} ", fit(order, 3)) } else { String::new() };
        let uid = if self.has_uids { format!("{} ", fit(uid, 9)) } else { String::new() };
        let reason =
            if self.has_reasons { format!("{} ", fit(reason, self.why)) } else { String::new() };
        let (name, from, to) = (fit(name, 10), fit_right(from, 4), fit_right(to, 4));
        format!("{sign} {order}{name} {uid}{from} {to}  {reason}")
    }
}

fn uid_text(brush: &DrawContext, session: &PlanSession, device: &DeviceIdentity) -> String {
    device.uid_text(&brush.app.profile(session.bus()).uid)
}

fn step_spans(
    brush: &DrawContext,
    session: &PlanSession,
    (at, step): (usize, &PlanStep),
    (columns, is_selected): (PlanColumns, bool),
) -> Vec<Span<'static>> {
    let state = session.step_state(at);
    let role = match state {
        StepState::Pending => Role::Muted,
        StepState::Sent | StepState::Responded => Role::Text,
        StepState::Stored => Role::Stale,
        StepState::Confirmed => Role::Online,
        StepState::Failed(_) => Role::Error,
    };
    let sent = session.run().and_then(|run| run.sent_at(at));
    let word = match (&state, sent) {
        (StepState::Sent | StepState::Responded, Some(sent)) => {
            let age = brush.app.now().since(sent).as_secs();
            format!("{} {age} s", state.word())
        }
        (StepState::Failed(_), _) => "failed".to_owned(),
        _ => state.word().to_owned(),
    };
    let (order, from, to) = ((at + 1).to_string(), step.from.to_string(), step.to.to_string());
    let (name, uid) = (step.device.label(), uid_text(brush, session, &step.device));
    let reason = match &state {
        StepState::Failed(cause) => cause.clone(),
        _ => step.why(),
    };
    let row = columns.row([&order, &name, &uid, &from, &to, &reason], is_selected);
    vec![brush.span(Role::Text, row), brush.span(role, word)]
}

fn left_out_spans(
    brush: &DrawContext,
    session: &PlanSession,
    left: &LeftOut,
    (columns, is_selected): (PlanColumns, bool),
) -> Vec<Span<'static>> {
    let uid = uid_text(brush, session, &left.device);
    let from = left.at.map_or("–".to_owned(), |at| at.to_string());
    let (name, to, reason) = (left.device.label(), left.to.to_string(), left.reason.to_string());
    let row = columns.row(["–", &name, &uid, &from, &to, &reason], is_selected);
    let is_done = left.reason.is_done();
    let role = if is_done { Role::Muted } else { Role::Suspected };
    vec![brush.span(Role::Muted, row), brush.span(role, if is_done { "–" } else { "left out" })]
}

fn draw_details(brush: &mut DrawContext, session: &PlanSession, selected: usize, rule: Rect) {
    brush.rule(rule, Role::Border);
    let area = Rect { y: rule.bottom(), height: DETAILS - 1, ..rule };
    let width = usize::from(rule.width);
    let step = session.plan().steps.get(selected);
    let place = selected.wrapping_sub(session.plan().steps.len());
    let title = match (step, session.plan().left_out.get(place)) {
        (Some(step), _) => {
            let (name, from, to) = (step.device.label(), step.from, step.to);
            format!(" step {}: {name} {from} → {to} ", selected + 1)
        }
        (None, Some(left)) => format!(" {}: {} ", left.device.label(), left.reason),
        (None, None) => String::new(),
    };
    let title = Line::from(brush.span(Role::TabActive, fit_title(&title, width.saturating_sub(3))));
    brush.line(Rect { x: 1, ..rule }, 0, &title);
    let mut lines: Vec<Line> = Vec::new();
    if step.is_some() {
        if let StepState::Failed(cause) = session.step_state(selected) {
            lines.push(Line::from(brush.span(Role::Error, format!(" {cause}"))));
        }
        let frames = brush.app.plan_frames(session, selected);
        for (frame, meaning) in frames.iter().take(2 - lines.len()) {
            let id = frame.platform_id().unwrap_or_default();
            let text = format!(" {id:08X} {}", hex(frame.data(), " "));
            lines.push(Line::from(vec![
                brush.span(Role::Request, text),
                brush.span(Role::Muted, format!("  {meaning}")),
            ]));
        }
    }
    brush.lines(area, &lines, 0);
    let text = match session.run().map(PlanRun::state) {
        Some(RunState::Stopped(cause)) => format!(" stopped: {cause}"),
        Some(RunState::Stored) => {
            " stored: in force after a restart of all devices at once".to_owned()
        }
        _ => rule_of_steps(brush, session),
    };
    brush.line(area, 2, &Line::from(brush.span(Role::Muted, text)));
    let tick = |is_on: bool| if is_on { "[x]" } else { "[ ]" };
    let mut text = format!(" {} fixed addresses", tick(session.is_fixed()));
    if brush.app.plan_effect(session) != StepEffect::AtOnce {
        let _ = write!(text, "   {} restart each", tick(session.restarts()));
    }
    if !session.unread().is_empty() {
        let unread: Vec<String> = session.unread().iter().map(ToString::to_string).collect();
        let _ = write!(text, "   not read: {}", join_first(unread, 4, ", "));
    }
    if let Some(name) = session.file_name() {
        let _ = write!(text, "   plan: {name}");
    }
    brush.line(area, 3, &Line::from(brush.span(Role::Muted, text)));
}

fn rule_of_steps(brush: &DrawContext, session: &PlanSession) -> String {
    let seconds = brush.app.plan_step_time(session).as_secs_f64();
    match brush.app.plan_effect(session) {
        StepEffect::AtOnce | StepEffect::Restart => format!(
            " each step waits up to {seconds:.0} s for the heartbeat at the new address; a failure stops"
        ),
        StepEffect::Deferred => {
            " all settings are stored, in force after a restart of all devices at once".to_owned()
        }
    }
}

/// A title, cut if it is wider than the room.
fn fit_title(title: &str, room: usize) -> String {
    if title.width() > room { fit(title, room) } else { title.to_owned() }
}
