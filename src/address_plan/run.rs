//! The execution of a plan: one step after the other, each confirmed by what is heard.
//!
//! A state machine without I/O. It demands one request at a time ([`PlanRun::poll_request`]), only
//! when its present state is stored ([`PlanRun::handle_stored`]), and never the same one again. It
//! stops at the first surprise; what was not confirmed stays as it is.

use super::known_bus::{AddressSet, DeviceIdentity, KnownDevice, PlanBus};
use super::planner::{AddressPlan, PlanStep, StepEffect};
use crate::time::{Duration, Instant};
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use std::collections::VecDeque;
use std::fmt;

/// Time between two looks at the devices.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);
/// Time of a step in heartbeat periods: 1.5 of silence, up to 1 before the address claim, and room for
/// lost heartbeats. Chosen.
const MOVE_PERIODS: f64 = 5.0;
/// The same of a restart, whose search for the bit rate takes up to 1.5 more, and its start.
const RESTART_PERIODS: f64 = 8.0;
/// Silence of a device, in heartbeat periods, after which it may have left its address: that of an
/// address resolution (CAN platform §3.2.4.2).
const SILENT_PERIODS: f64 = 1.5;
/// Time between two looks at the devices while they are to be restarted.
const STORED_LOOK_INTERVAL: Duration = Duration::from_secs(1);

/// State of a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StepState {
    /// Its turn has not come.
    Pending,
    /// Its request is being sent, or was sent.
    Sent,
    /// The device responded; it is awaited at its address.
    Responded,
    /// The device responded; the setting is in force after its restart.
    Stored,
    /// The device was heard at its address.
    Confirmed,
    /// It failed, with the cause.
    Failed(String),
}

impl StepState {
    /// The word in files and JSON.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Pending => "pending",
            Self::Sent => "sent",
            Self::Responded => "responded",
            Self::Stored => "stored",
            Self::Confirmed => "confirmed",
            Self::Failed(_) => "failed",
        }
    }
}

impl fmt::Display for StepState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Failed(cause) => write!(f, "failed: {cause}"),
            other => f.pad(other.word()),
        }
    }
}

/// State of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunState {
    /// Steps are done.
    Running,
    /// It stopped before the end, with the cause.
    Stopped(String),
    /// All settings are stored; some are in force only after a restart.
    Stored,
    /// All steps are confirmed.
    Done,
}

impl RunState {
    /// The word in files and JSON.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Stopped(_) => "stopped",
            Self::Stored => "stored",
            Self::Done => "done",
        }
    }
}

/// A request that is to be sent, once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanRequest {
    /// Write this setting to the device at this address.
    Write(Address, AddressSetting),
    /// Restart the device at this address.
    Restart(Address),
}

/// How a request ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RequestEnd {
    /// The device responded.
    Responded,
    /// It sent an error response.
    Refused(String),
    /// It sent nothing within this time.
    NoResponse(Duration),
    /// The request was not sent.
    NotSent(String),
}

/// What happened to a step, or to the run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlanNews {
    /// Place of the step; `None`: it is about the run.
    pub step: Option<usize>,
    /// What happened.
    pub text: String,
    /// It is no success.
    pub is_failure: bool,
}

/// How long a step may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanTiming {
    /// BUS_CFG_HR_TIME.
    pub period: Duration,
    /// Time in which a device must respond.
    pub response: Duration,
}

impl PlanTiming {
    /// Returns the longest time from the request to the heartbeat at the new address.
    pub fn step(&self, effect: StepEffect) -> Duration {
        match effect {
            StepEffect::AtOnce => self.response.max(self.period.mul_f64(MOVE_PERIODS)),
            StepEffect::Restart => self.response.max(self.period.mul_f64(RESTART_PERIODS)),
            StepEffect::Deferred => self.response * 2,
        }
    }
}

/// What the present step waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StepPhase {
    /// Its start.
    Next,
    /// Its state is to be stored, then this is sent.
    Ready(PlanRequest),
    /// The request is sent; the device must be heard at its address until then.
    Waiting { sent: Instant, until: Instant, is_ended: bool },
}

/// A plan that is executed.
#[derive(Clone, Debug)]
pub struct PlanRun {
    plan: AddressPlan,
    effect: StepEffect,
    timing: PlanTiming,
    states: Vec<StepState>,
    sent_at: Vec<Option<Instant>>,
    confirmed_at: Vec<Option<Instant>>,
    state: RunState,
    current: usize,
    phase: StepPhase,
    /// Conflicts at the start.
    known_conflicts: AddressSet,
    stops_after_step: bool,
    looked_at: Option<Instant>,
    /// Number of the present state, and of that which is stored.
    revision: u64,
    stored_revision: u64,
    news: VecDeque<PlanNews>,
}

impl PlanRun {
    /// Returns a run of a plan that begins with its first step.
    pub fn new(plan: AddressPlan, effect: StepEffect, timing: PlanTiming, bus: &PlanBus) -> Self {
        let count = plan.steps.len();
        let mut run = Self {
            plan,
            effect,
            timing,
            states: vec![StepState::Pending; count],
            sent_at: vec![None; count],
            confirmed_at: vec![None; count],
            state: RunState::Running,
            current: 0,
            phase: StepPhase::Next,
            known_conflicts: bus.conflicts,
            stops_after_step: false,
            looked_at: None,
            revision: 1,
            stored_revision: 0,
            news: VecDeque::new(),
        };
        run.end_if_over();
        run
    }

    /// The plan.
    pub const fn plan(&self) -> &AddressPlan {
        &self.plan
    }

    /// The states of its steps.
    pub fn states(&self) -> &[StepState] {
        &self.states
    }

    /// State of the run.
    pub const fn state(&self) -> &RunState {
        &self.state
    }

    /// Returns true if steps are being done.
    pub fn is_running(&self) -> bool {
        self.state == RunState::Running
    }

    /// What is true of all steps once none waits any more.
    pub fn end_text(&self) -> &'static str {
        // Where a device stays at its address, nothing that is heard confirms its setting.
        let is_unheard = |(step, state): (&PlanStep, &StepState)| {
            *state == StepState::Stored && !step.is_detour() && step.from == step.to
        };
        if self.plan.steps.iter().zip(&self.states).any(is_unheard) {
            "all settings are stored: in force after a restart of the devices"
        } else {
            "all steps are confirmed"
        }
    }

    /// Returns true if a request was sent, and the device is awaited.
    pub const fn is_waiting(&self) -> bool {
        matches!(self.phase, StepPhase::Waiting { .. })
    }

    /// Place of the step that is done, or is next.
    pub const fn current(&self) -> usize {
        self.current
    }

    /// Number of steps whose request is stored or that are confirmed.
    pub fn finished(&self) -> usize {
        let is_finished = |it: &&StepState| matches!(it, StepState::Stored | StepState::Confirmed);
        self.states.iter().filter(is_finished).count()
    }

    /// When the request of a step was sent; `None` before.
    pub fn sent_at(&self, step: usize) -> Option<Instant> {
        self.sent_at.get(step).copied().flatten()
    }

    /// Returns true if it stops after the present step.
    pub const fn stops_after_step(&self) -> bool {
        self.stops_after_step
    }

    /// Number of the present state.
    pub const fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns true if the present state is stored.
    pub const fn is_stored(&self) -> bool {
        self.stored_revision == self.revision
    }

    // ---- input -----------------------------------------------------------------------------

    /// Takes that the state with this number is stored, or why not: then nothing is sent any more.
    pub fn handle_stored(&mut self, revision: u64, result: Result<(), String>) {
        match result {
            Ok(()) => self.stored_revision = self.stored_revision.max(revision),
            Err(why) => {
                self.stored_revision = self.stored_revision.max(revision);
                self.stop(format!("the plan is not stored: {why}"));
            }
        }
    }

    /// Takes that the request was handed over for sending.
    pub fn handle_sent(&mut self, now: Instant) {
        let StepPhase::Ready(_) = self.phase else { return };
        let until = now + self.timing.step(self.effect);
        self.sent_at[self.current] = Some(now);
        self.phase = StepPhase::Waiting { sent: now, until, is_ended: false };
    }

    /// Takes how the request ended.
    pub fn handle_request_end(&mut self, end: RequestEnd) {
        let StepPhase::Waiting { sent, until, is_ended: false } = self.phase else { return };
        let is_restart = self.states[self.current] == StepState::Responded;
        self.phase = StepPhase::Waiting { sent, until, is_ended: true };
        match (end, self.effect) {
            (RequestEnd::Responded, _) if is_restart => self.changed(),
            (RequestEnd::Responded, StepEffect::AtOnce) => {
                self.states[self.current] = StepState::Responded;
                self.changed();
            }
            (RequestEnd::Responded, StepEffect::Restart) => {
                self.states[self.current] = StepState::Responded;
                let step = &self.plan.steps[self.current];
                self.phase = StepPhase::Ready(PlanRequest::Restart(step.from));
                self.changed();
            }
            (RequestEnd::Responded, StepEffect::Deferred) => {
                self.end_step(StepState::Stored);
            }
            (RequestEnd::Refused(code), _) => {
                let code = if code.is_empty() { code } else { format!(" {code}") };
                self.fail(format!("refused with an error response{code}"));
            }
            (RequestEnd::NotSent(why), _) => self.fail(format!("not sent: {why}")),
            // It may have acted by the request, and be on its way.
            (RequestEnd::NoResponse(_), StepEffect::AtOnce) => {}
            (RequestEnd::NoResponse(_), StepEffect::Restart) if is_restart => {}
            (RequestEnd::NoResponse(time), _) => {
                let time = time.as_millis();
                self.fail(format!("no response within {time} ms: the setting is not known"));
            }
        }
        self.looked_at = None;
    }

    /// Looks at the devices: confirms the present step, begins the next one, stops at a surprise.
    pub fn handle_timeout(&mut self, now: Instant, bus: &PlanBus) {
        self.looked_at = Some(now);
        self.confirm_stored(bus);
        if !self.is_running() {
            return;
        }
        if let Some(surprise) = self.new_conflict(bus).or_else(|| self.taken_address(bus)) {
            return self.handle_obstacle(surprise);
        }
        if let StepPhase::Waiting { sent, until, is_ended } = self.phase {
            self.judge(now, (sent, until, is_ended), bus);
        }
        if self.phase == StepPhase::Next && self.is_running() {
            if self.stops_after_step {
                return self.stop("as you demanded".to_owned());
            }
            self.begin_step(now, bus);
        }
    }

    /// Takes that nothing can be sent any more, or judged by what is heard.
    pub fn handle_obstacle(&mut self, why: String) {
        if let StepPhase::Waiting { .. } = self.phase {
            self.fail(why);
        } else {
            self.stop(why);
        }
    }

    /// Stops after the present step, or does not any more.
    pub fn stop_after_step(&mut self) {
        self.stops_after_step = !self.stops_after_step;
    }

    // ---- output ----------------------------------------------------------------------------

    /// The request that is due. Hand it over for sending, then call [`Self::handle_sent`].
    pub fn poll_request(&self) -> Option<PlanRequest> {
        match self.phase {
            StepPhase::Ready(request) if self.is_stored() && self.is_running() => Some(request),
            _ => None,
        }
    }

    /// The next news.
    pub fn poll_news(&mut self) -> Option<PlanNews> {
        self.news.pop_front()
    }

    /// When [`Self::handle_timeout`] is due.
    pub fn poll_timeout(&self, now: Instant) -> Option<Instant> {
        let interval = match self.state {
            RunState::Running => LOOK_INTERVAL,
            RunState::Stored => STORED_LOOK_INTERVAL,
            RunState::Stopped(_) | RunState::Done => return None,
        };
        Some(self.looked_at.map_or(now, |at| at + interval))
    }

    // ---- steps -----------------------------------------------------------------------------

    fn begin_step(&mut self, now: Instant, bus: &PlanBus) {
        // Of two at one address, both must have been heard.
        if !bus.is_observed {
            return;
        }
        let step = &self.plan.steps[self.current];
        let Some(device) = bus.find(&step.device, step.from) else {
            let text = format!("{} is not on the bus any more", step.device.label());
            return self.fail(text);
        };
        let is_moved = device.address != step.from;
        if is_moved || device.is_shared {
            let why = if is_moved { "is now at" } else { "is not alone at" };
            let text = format!("{} {why} {}", step.device.label(), device.address);
            return self.fail(text);
        }
        if bus.own == Some(step.to) {
            return self.fail(format!("{} is descan's own address now", step.to));
        }
        if let Some(other) = self.holder_of_target(step, device, bus) {
            // A device that has just left may still have its row.
            if now.since(other.last_heard) < self.timing.period.mul_f64(SILENT_PERIODS) {
                let text = format!("{} is used by {}", step.to, other.identity.label());
                self.fail(text);
            }
            return;
        }
        let request = match step.setting {
            Some(setting) => PlanRequest::Write(step.from, setting),
            None => PlanRequest::Restart(step.from),
        };
        let is_restart = step.setting.is_none();
        self.states[self.current] = if is_restart { StepState::Responded } else { StepState::Sent };
        self.phase = StepPhase::Ready(request);
        self.changed();
    }

    /// Returns another device that uses the address of a step, or has it stored.
    fn holder_of_target<'b>(
        &self,
        step: &PlanStep,
        device: &KnownDevice,
        bus: &'b PlanBus,
    ) -> Option<&'b KnownDevice> {
        let is_stored_first = self.effect == StepEffect::Deferred;
        let uses = |other: &&KnownDevice| {
            let is_there = other.address == step.to && !is_stored_first;
            // Another program may have written it meanwhile.
            let has_it = other.stored() == Some(step.to);
            !std::ptr::eq(*other, device) && other.is_present && (is_there || has_it)
        };
        bus.devices.iter().find(uses)
    }

    /// Judges the present step by what is heard.
    fn judge(
        &mut self,
        now: Instant,
        (sent, until, is_ended): (Instant, Instant, bool),
        bus: &PlanBus,
    ) {
        if self.effect == StepEffect::Deferred {
            return;
        }
        let step = &self.plan.steps[self.current];
        let there = bus.device_at(step.to).filter(|it| it.last_heard > sent);
        if let Some(there) = there {
            if step.device.is_same(&there.identity) {
                // Where it stays at its address, only the response tells that it has the setting.
                let stays = step.from == step.to;
                let is_answered = self.states[self.current] == StepState::Responded;
                if !stays || is_answered && is_ended {
                    return self.end_step(StepState::Confirmed);
                }
            } else if step.device.is_other(&there.identity) {
                let who = there.identity.label();
                return self.fail(format!("{who} is at {} now", step.to));
            }
        }
        if now >= until {
            let text = self.why_not_confirmed(sent, bus);
            self.fail(text);
        }
    }

    /// What was sent and what was heard of a step that is not confirmed.
    fn why_not_confirmed(&self, sent: Instant, bus: &PlanBus) -> String {
        let step = &self.plan.steps[self.current];
        let seconds = self.timing.step(self.effect).as_secs_f64();
        let answer = match self.states[self.current] {
            StepState::Responded => "it responded",
            _ => "it did not respond",
        };
        let heard = bus.find(&step.device, step.from).filter(|it| it.last_heard > sent);
        let heard = match heard {
            Some(device) => format!("heard at {}", device.address),
            None => "not heard since".to_owned(),
        };
        format!("not at {} within {seconds:.0} s: {answer}, {heard}", step.to)
    }

    fn new_conflict(&self, bus: &PlanBus) -> Option<String> {
        let steps = &self.plan.steps;
        let mut addresses = steps.iter().flat_map(|step| [step.from, step.to]);
        let is_new = |at: &Address| bus.conflicts.has(*at) && !self.known_conflicts.has(*at);
        addresses.find(is_new).map(|address| format!("an address conflict at {address}"))
    }

    /// Returns that another device is heard at an address that was confirmed.
    fn taken_address(&self, bus: &PlanBus) -> Option<String> {
        self.plan.steps.iter().zip(&self.confirmed_at).find_map(|(step, confirmed)| {
            let (confirmed, there) = (Some((*confirmed)?), bus.device_at(step.to)?);
            let is_later = |heard: Option<Instant>| heard.is_some() && heard > confirmed;
            if step.device.is_other(&there.identity) && is_later(Some(there.last_heard)) {
                let who = there.identity.label();
                return Some(format!(
                    "{who} is at {}, too, after {}",
                    step.to,
                    step.device.label()
                ));
            }
            let is_shared = step.device.is_same(&there.identity) && is_later(there.other_heard);
            is_shared.then(|| format!("another device is at {}, too", step.to))
        })
    }

    /// Confirms the settings that are stored once their devices are heard at their addresses.
    fn confirm_stored(&mut self, bus: &PlanBus) {
        let mut is_changed = false;
        for at in 0..self.plan.steps.len() {
            let step = &self.plan.steps[at];
            let is_heard = |identity: &DeviceIdentity| {
                let there = bus.device_at(step.to);
                there.is_some_and(|it| {
                    identity.is_same(&it.identity) && Some(it.last_heard) > self.sent_at[at]
                })
            };
            let waits = self.states[at] == StepState::Stored && step.from != step.to;
            if waits && !step.is_detour() && is_heard(&step.device) {
                self.states[at] = StepState::Confirmed;
                self.confirmed_at[at] = self.looked_at;
                self.tell(Some(at), StepState::Confirmed.word().to_owned(), false);
                is_changed = true;
            }
        }
        if is_changed {
            self.changed();
            if self.state == RunState::Stored {
                self.end_if_over();
            }
        }
    }

    fn end_step(&mut self, state: StepState) {
        let at = self.current;
        self.tell(Some(at), state.word().to_owned(), false);
        if state == StepState::Confirmed {
            // The step that brought it to its place before is over.
            let device = &self.plan.steps[at].device;
            for (step, confirmed) in self.plan.steps.iter().zip(&mut self.confirmed_at) {
                *confirmed = confirmed.filter(|_| !step.device.is_same(device));
            }
            self.confirmed_at[at] = self.looked_at;
        }
        self.states[at] = state;
        self.current += 1;
        self.phase = StepPhase::Next;
        self.changed();
        self.end_if_over();
    }

    fn end_if_over(&mut self) {
        if self.current < self.plan.steps.len() {
            return;
        }
        let waits = |at: &usize| {
            let step = &self.plan.steps[*at];
            self.states[*at] == StepState::Stored && !step.is_detour() && step.from != step.to
        };
        let waiting = (0..self.states.len()).filter(waits).count();
        let state = if waiting == 0 { RunState::Done } else { RunState::Stored };
        if state == self.state {
            return;
        }
        let text = match waiting {
            0 => self.end_text().to_owned(),
            _ => format!("{waiting} stored: in force after a restart of all devices at once"),
        };
        self.state = state;
        self.tell(None, text, false);
        self.changed();
    }

    /// The present step fails, and the run stops.
    fn fail(&mut self, cause: String) {
        let step = &self.plan.steps[self.current];
        let text = format!("step {}, {}: {cause}", self.current + 1, step.device.label());
        self.tell(Some(self.current), format!("failed: {cause}"), true);
        self.states[self.current] = StepState::Failed(cause);
        self.stop(text);
    }

    fn stop(&mut self, cause: String) {
        if !self.is_running() {
            return;
        }
        self.phase = StepPhase::Next;
        self.tell(None, format!("stopped: {cause}"), true);
        self.state = RunState::Stopped(cause);
        self.changed();
    }

    fn tell(&mut self, step: Option<usize>, text: String, is_failure: bool) {
        self.news.push_back(PlanNews { step, text, is_failure });
    }

    fn changed(&mut self) {
        self.revision += 1;
    }
}
