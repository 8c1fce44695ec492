//! The plan that gives the devices of a bus other addresses: what it is made from, its run, and the
//! requests that the run demands.
//!
//! One plan at a time, about the present alone. Its file is written by the shell, which reports back
//! before the first request of a step is sent. Does not know how it is drawn.

mod dialog;
mod goals;
mod known_devices;
mod plan_run;

use super::{App, Effect, key_needed};
use crate::address_plan::{
    AddressGoal, AddressPlan, PlanOptions, PlanRecord, PlanRun, PlanTiming, RecordedDevice,
    RunState, StepEffect, StepState,
};
use crate::discovery::{Device, DeviceId, OwnAddress, RequestId};
use crate::frame::{BusIndex, Frame};
use crate::text::counted;
use crate::time::{Duration, Instant};
use crate::wire::descriptor::{AddressSetting, DescriptorField};
use crate::wire::id::Address;
use crate::wire::profile::{Profile, ProfileKey, WriteEffect};
use goals::GoalKey;
use known_devices::PlanKnowledge;

/// Time between two looks whether the settings are read.
const READ_INTERVAL: Duration = Duration::from_millis(100);

/// Which addresses the devices are to have.
#[derive(Clone, Debug, PartialEq)]
pub enum PlanTask {
    /// The static ones of des.json.
    ToFile,
    /// Those of a plan that was not finished, with the name of its file.
    Resume(Box<PlanRecord>, String),
    /// Those that the devices had before a plan, with the name of its file.
    TakeBack(Box<PlanRecord>, String),
}

/// What became of the start of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlanStart {
    /// It runs.
    Started,
    /// Other steps than those that were shown are due, for this reason: they are to be asked for again.
    Changed(String),
}

/// The last plan of a bus, in the folder of plans.
#[derive(Debug)]
enum LastPlan {
    /// It is being read.
    Awaited,
    /// It was read; `None` if there is none.
    Read(Option<Box<(String, PlanRecord)>>),
    /// It cannot be read: what devices have stored is not known.
    Unreadable(String),
}

/// Most reads of a setting of a device that does not respond.
const MAX_READS: u32 = 3;
/// Time after which a plan that is shown is made again, from what is known then.
const RENEWAL_INTERVAL: Duration = Duration::from_millis(500);

/// A plan and its run.
#[derive(Debug)]
pub struct PlanSession {
    bus: BusIndex,
    task: PlanTask,
    restarts: bool,
    is_fixed: bool,
    /// When to look again whether the settings are read; `None` once they are.
    reading_due: Option<Instant>,
    /// How often they were read, and the addresses of the devices that did not respond to the last time.
    reads: u32,
    unread: Vec<Address>,
    /// When the plan is made again, as long as it is shown and not started.
    renewal_due: Instant,
    goals: Vec<AddressGoal>,
    left_out: Vec<GoalKey>,
    order: Vec<GoalKey>,
    plan: AddressPlan,
    run: Option<PlanRun>,
    /// The file of the run: its name and content, and the place in it of each goal.
    record: Option<(String, PlanRecord)>,
    places: Vec<Option<usize>>,
    /// The last plan of the bus, with the name of its file.
    last: LastPlan,
    /// Nothing is known of devices that are not heard: their addresses are free.
    forgets_absent: bool,
    /// The state that the content of the file has.
    recorded: u64,
    /// The state that is being written.
    writing: Option<u64>,
    /// The file was not written yet, and is not that of a plan that goes on.
    is_file_new: bool,
    /// The request that waits for its end, and its step.
    open: Option<(RequestId, usize)>,
    /// The last request of each step.
    frames: Vec<Option<Frame>>,
    selected: usize,
    /// The user has seen that it stopped.
    is_seen: bool,
}

impl PlanSession {
    /// The bus.
    pub const fn bus(&self) -> BusIndex {
        self.bus
    }

    /// What it is for.
    pub const fn task(&self) -> &PlanTask {
        &self.task
    }

    /// The plan: that of the run, if there is one.
    pub fn plan(&self) -> &AddressPlan {
        self.run.as_ref().map_or(&self.plan, PlanRun::plan)
    }

    /// The run; `None` before it is started.
    pub const fn run(&self) -> Option<&PlanRun> {
        self.run.as_ref()
    }

    /// Returns true while stored settings and the last plan are read, and no plan is made yet.
    pub const fn is_reading(&self) -> bool {
        self.reading_due.is_some() || matches!(self.last, LastPlan::Awaited)
    }

    /// The addresses of the devices whose settings could not be read, although the profile has the
    /// number: each counts as one that has stored its address.
    pub fn unread(&self) -> &[Address] {
        &self.unread
    }

    /// Why no plan can be made; `None` if one can.
    pub const fn problem(&self) -> Option<&String> {
        match &self.last {
            LastPlan::Unreadable(why) => Some(why),
            _ => None,
        }
    }

    /// The last plan of the bus, with the name of its file.
    fn last_plan(&self) -> Option<&(String, PlanRecord)> {
        match &self.last {
            LastPlan::Read(last) => last.as_deref(),
            _ => None,
        }
    }

    /// Returns true while steps are done.
    pub fn is_running(&self) -> bool {
        self.run.as_ref().is_some_and(PlanRun::is_running)
    }

    /// Returns true if the file has the present state.
    pub fn is_stored(&self) -> bool {
        self.writing.is_none() && self.run.as_ref().is_none_or(PlanRun::is_stored)
    }

    /// State of a step; pending before the start.
    pub fn step_state(&self, step: usize) -> StepState {
        let state = self.run.as_ref().and_then(|run| run.states().get(step));
        state.cloned().unwrap_or(StepState::Pending)
    }

    /// The last request that was sent in a step.
    pub fn frame(&self, step: usize) -> Option<&Frame> {
        self.frames.get(step)?.as_ref()
    }

    /// Name of the file of the run.
    pub fn file_name(&self) -> Option<&str> {
        self.record.as_ref().map(|(name, _)| name.as_str())
    }

    /// Content of the file of the run.
    pub fn record(&self) -> Option<&PlanRecord> {
        self.record.as_ref().map(|(_, record)| record)
    }

    /// Takes the state of the run into the content of its file.
    fn renew_record(&mut self, unix_secs: f64) {
        if let (Some(run), Some((_, record))) = (&self.run, &mut self.record)
            && self.recorded != run.revision()
        {
            record.update(run, &self.places, unix_secs);
            self.recorded = run.revision();
        }
    }

    /// What files tell of the devices: that of the run, else that of the task, and the last one.
    fn knowledge(&self) -> PlanKnowledge<'_> {
        let forgets_absent = self.forgets_absent;
        if self.run.is_some() {
            return PlanKnowledge { record: self.record(), earlier: None, forgets_absent };
        }
        let (record, name) = match &self.task {
            PlanTask::ToFile => (None, None),
            PlanTask::Resume(record, name) | PlanTask::TakeBack(record, name) => {
                (Some(&**record), Some(name))
            }
        };
        let earlier = self.last_plan().filter(|(last, _)| Some(last) != name);
        PlanKnowledge { record, earlier: earlier.map(|(_, last)| last), forgets_absent }
    }

    /// Returns true if settings are fixed addresses, else preferred ones.
    pub const fn is_fixed(&self) -> bool {
        self.is_fixed
    }

    /// Returns true if descan restarts each device after its write.
    pub const fn restarts(&self) -> bool {
        self.restarts
    }
}

/// When a write acts.
fn effect_of(profile: &Profile, restarts: bool) -> StepEffect {
    match profile.writes.effect {
        WriteEffect::Now => StepEffect::AtOnce,
        WriteEffect::Restart if restarts => StepEffect::Restart,
        WriteEffect::Restart => StepEffect::Deferred,
    }
}

impl App {
    /// The plan that is shown, runs, or ended last.
    pub fn address_plan(&self) -> Option<&PlanSession> {
        self.plan.as_deref()
    }

    /// When the writes of the plan act.
    pub fn plan_effect(&self, session: &PlanSession) -> StepEffect {
        effect_of(&self.buses.profile(session.bus), session.restarts)
    }

    /// Longest time of a step of the plan.
    pub fn plan_step_time(&self, session: &PlanSession) -> Duration {
        self.plan_timing(session.bus).step(self.plan_effect(session))
    }

    fn plan_timing(&self, bus: BusIndex) -> PlanTiming {
        let profile = self.buses.profile(bus);
        PlanTiming { period: profile.heartbeat.period(), response: profile.calls.timeout() }
    }

    /// Why no addresses can be written on a bus; `None` if they can.
    pub fn plan_obstacle(&self, index: BusIndex) -> Option<String> {
        let bus = self.buses.get(index)?;
        if let Some(obstacle) = self.tx_obstacle(index, bus) {
            return Some(obstacle);
        }
        let profile = self.buses.profile(index);
        if profile.writes.address.is_none() || !profile.is_given(ProfileKey::WriteAddress) {
            return Some(key_needed(ProfileKey::WriteAddress));
        }
        match bus.own_address() {
            OwnAddress::Held(_) => None,
            _ => Some("descan has no address on this bus yet".to_owned()),
        }
    }

    /// Takes the last plan of a bus, with the name of its file, or why it cannot be read.
    pub fn handle_last_plan(
        &mut self,
        now: Instant,
        bus: &str,
        last: Result<Option<Box<(String, PlanRecord)>>, String>,
    ) {
        self.clock.set(now);
        let Some(mut session) = self.plan.take() else { return };
        let is_its = self.buses.get(session.bus).is_some_and(|it| it.name == bus);
        if is_its && matches!(session.last, LastPlan::Awaited) {
            session.last = match last {
                Ok(last) => LastPlan::Read(last),
                Err(_) if session.forgets_absent => LastPlan::Read(None),
                Err(why) => LastPlan::Unreadable(why),
            };
        }
        let problem = session.problem().cloned();
        self.plan = Some(session);
        self.notices.redraw.set_dirty();
        self.renew_plan();
        if let Some(why) = problem {
            self.show_error(format!("plan: {why}"));
        }
    }

    /// Takes that devices that are not heard keep no address: those of earlier plans are free.
    pub const fn forget_absent_devices(&mut self) {
        self.forgets_absent_devices = true;
    }

    /// Prepares a plan: reads the stored settings, where the profile has their number, and makes it
    /// then. Nothing is written.
    ///
    /// # Errors
    ///
    /// What forbids it.
    pub fn prepare_plan(
        &mut self,
        bus: BusIndex,
        task: PlanTask,
        restarts: bool,
    ) -> Result<(), String> {
        if self.plan.as_ref().is_some_and(|session| session.is_running()) {
            return Err("a plan is running".to_owned());
        }
        if let Some(why) = self.plan_obstacle(bus) {
            return Err(why);
        }
        let profile = self.buses.profile(bus);
        if restarts && !profile.is_given(ProfileKey::Reboot) {
            let key = ProfileKey::Reboot.name();
            return Err(format!("a restart needs a profile with {key}"));
        }
        let file = &self.files.get(self.files.of_bus(bus)).file;
        if task == PlanTask::ToFile && !file.is_there() {
            return Err(format!("{} does not exist", file.name()));
        }
        let is_read = profile.is_given(ProfileKey::Addr) && {
            let all = self.readable_devices(bus);
            self.read_settings(&all)
        };
        let now = self.clock.now();
        let name = self.buses.get(bus).map_or_else(String::new, |bus| bus.name.clone());
        self.effects.push_back(Effect::ReadLastPlan { bus: name });
        self.plan = Some(Box::new(PlanSession {
            bus,
            task,
            restarts: restarts && profile.writes.effect == WriteEffect::Restart,
            is_fixed: true,
            reading_due: is_read.then_some(now + READ_INTERVAL),
            reads: 0,
            unread: Vec::new(),
            renewal_due: now + RENEWAL_INTERVAL,
            goals: Vec::new(),
            left_out: Vec::new(),
            order: Vec::new(),
            plan: AddressPlan::default(),
            run: None,
            record: None,
            places: Vec::new(),
            last: LastPlan::Awaited,
            forgets_absent: self.forgets_absent_devices,
            recorded: 0,
            writing: None,
            is_file_new: true,
            open: None,
            frames: Vec::new(),
            selected: 0,
            is_seen: true,
        }));
        Ok(())
    }

    /// The devices whose settings can be read.
    fn readable_devices(&self, index: BusIndex) -> Vec<DeviceId> {
        let Some(bus) = self.buses.get(index) else { return Vec::new() };
        let devices = bus.devices().iter().filter(|device| device.is_present() && !device.is_debug);
        devices.map(|device| device.id).collect()
    }

    /// Those of them that did not respond, or with nothing that is a setting.
    fn unread_settings(&self, index: BusIndex) -> Vec<DeviceId> {
        let mut all = self.readable_devices(index);
        let is_read = |device: &Device| device.descriptor.value(DescriptorField::Address).is_some();
        all.retain(|id| !self.device(*id).is_some_and(is_read));
        all
    }

    /// Reads the stored settings of these devices; returns true if there are any to read.
    fn read_settings(&mut self, devices: &[DeviceId]) -> bool {
        let (now, field) = (self.clock.now(), Some(DescriptorField::Address));
        // All of them, whatever the first one gives.
        let fields = devices.iter().map(|id| self.buses.read_descriptor(now, *id, field));
        fields.sum::<usize>() > 0
    }

    /// Makes the plan again, from what is known now.
    pub(super) fn renew_plan(&mut self) {
        let Some(mut session) = self.plan.take() else { return };
        if session.run.is_none() && !session.is_reading() && session.problem().is_none() {
            let bus = self.known_devices(session.bus, session.knowledge());
            session.goals = self.address_goals(&session, &bus);
            let options = self.plan_options(&session);
            let plan = AddressPlan::new(&bus, &session.goals, &options);
            if std::mem::replace(&mut session.plan, plan) != session.plan {
                self.notices.redraw.set_dirty();
            }
            session.selected = session.selected.min(session.rows().saturating_sub(1));
        }
        self.plan = Some(session);
    }

    fn plan_options(&self, session: &PlanSession) -> PlanOptions {
        PlanOptions {
            effect: self.plan_effect(session),
            is_fixed: session.is_fixed,
            reserved: self.reserved_addresses(session.bus),
        }
    }

    /// Starts the plan as it was shown: its first request is sent when its file is written. What is
    /// known now may lead to other steps: then these are the plan, and nothing is started.
    ///
    /// # Errors
    ///
    /// What forbids it.
    pub fn start_plan(&mut self) -> Result<PlanStart, String> {
        let shown = self.plan.as_ref().map(|session| session.plan.clone());
        self.renew_plan();
        let Some(mut session) = self.plan.take() else { return Err("there is no plan".into()) };
        let change = shown.and_then(|shown| session.plan.change_since(&shown));
        let result = match change {
            Some(change) => Ok(PlanStart::Changed(format!("the plan has changed: {change}"))),
            None => self.start_session(&mut session).map(|()| PlanStart::Started),
        };
        self.plan = Some(session);
        self.step_plan(self.clock.now());
        result
    }

    fn start_session(&mut self, session: &mut PlanSession) -> Result<(), String> {
        if session.is_reading() || session.run.is_some() {
            return Err("the plan is not ready".to_owned());
        }
        if let Some(why) = session.problem() {
            return Err(why.clone());
        }
        self.forgets_absent_devices = false;
        if let Some(why) = self.plan_obstacle(session.bus) {
            return Err(why);
        }
        let bus = self.known_devices(session.bus, session.knowledge());
        let (effect, timing) = (self.plan_effect(session), self.plan_timing(session.bus));
        let (name, mut record) = self.new_record(session, effect);
        record.unsettled = session.knowledge().unsettled_after(&bus, &record);
        // The device of each goal with a step, as the file has it.
        session.places = vec![None; session.goals.len()];
        for step in &session.plan.steps {
            let goal = &session.goals[step.goal];
            let Some(device) = goal.device.map(|place| &bus.devices[place]) else { continue };
            if session.places[step.goal].is_some() {
                continue;
            }
            let place = goals::place_in(&record, &device.identity, device.address);
            let place = place.unwrap_or_else(|| {
                let (at, stored) = (device.address, device.setting);
                record.devices.push(RecordedDevice::new(&device.identity, at, stored, goal.to));
                record.devices.len() - 1
            });
            record.devices[place].to = goal.to.number();
            record.devices[place].setting = goal.setting.map(AddressSetting::code);
            session.places[step.goal] = Some(place);
        }
        let run = PlanRun::new(session.plan.clone(), effect, timing, &bus);
        session.frames = vec![None; run.states().len()];
        session.run = Some(run);
        session.is_file_new = !matches!(session.task, PlanTask::Resume(..));
        session.record = Some((name, record));
        Ok(())
    }

    /// The name and the content of a run's file; that of a plan that goes on is kept.
    fn new_record(&self, session: &PlanSession, effect: StepEffect) -> (String, PlanRecord) {
        let now = self.clock.epoch().unix_secs(self.clock.now());
        let source = match &session.task {
            PlanTask::Resume(record, name) => {
                let mut record =
                    PlanRecord { effect: effect.word().to_owned(), ..(**record).clone() };
                record.begin_again();
                return (name.clone(), record);
            }
            PlanTask::ToFile => self.file_at(self.file_of_bus(session.bus)).name(),
            PlanTask::TakeBack(_, name) => format!("undo of {name}"),
        };
        let bus = self.buses.get(session.bus).map_or_else(String::new, |bus| bus.name.clone());
        let name = PlanRecord::file_name(&self.clock.stamp(), &bus);
        let record = PlanRecord {
            descan: String::new(),
            version: 1,
            bus,
            started: now,
            changed: now,
            source,
            effect: effect.word().to_owned(),
            state: RunState::Running.word().to_owned(),
            stopped: None,
            devices: Vec::new(),
            steps: Vec::new(),
            earlier: Vec::new(),
            unsettled: Vec::new(),
        };
        (name, record)
    }

    /// Takes that the file of the plan was written, or why not.
    pub fn handle_plan_written(&mut self, now: Instant, result: Result<(), String>) {
        let now = self.clock.set(now);
        if let Some(session) = &mut self.plan
            && let (Some(revision), Some(run)) = (session.writing.take(), &mut session.run)
        {
            run.handle_stored(revision, result);
        }
        self.step_plan(now);
    }

    /// Stops the run after the present step, or does not any more.
    pub fn stop_plan_after_step(&mut self) {
        if let Some(run) = self.plan.as_mut().and_then(|session| session.run.as_mut()) {
            run.stop_after_step();
        }
        self.notices.redraw.set_dirty();
    }

    /// The question before a plan is started.
    pub fn plan_question(&self) -> Option<String> {
        let session = self.plan.as_ref()?;
        let bus = self.buses.get(session.bus)?;
        let plan = session.plan();
        let devices = counted(plan.devices() as u64, "address");
        let (effect, seconds) =
            (self.plan_effect(session), self.plan_step_time(session).as_secs_f64());
        let frames = counted(plan.requests(effect) as u64, "request");
        let profile = self.buses.profile(session.bus);
        let write = profile.writes.address.unwrap_or_default();
        let restart = profile.commands.reboot.filter(|_| effect == StepEffect::Restart);
        let restart = restart.map(|number| format!(" and 0x{number:03X}")).unwrap_or_default();
        let what = match effect {
            StepEffect::AtOnce => {
                format!("each device leaves the bus for some seconds, at most {seconds:.0} each")
            }
            StepEffect::Restart => format!(
                "each device restarts and leaves the bus for some seconds, at most {seconds:.0} each"
            ),
            StepEffect::Deferred => "in force after a restart of all devices at once".to_owned(),
        };
        let name = &bus.name;
        Some(format!(
            "Change {devices} on {name}? Sends {frames} (service 0x{write:03X}{restart}); {what}."
        ))
    }
}

impl PlanSession {
    /// Number of rows of the list: steps, then devices without one.
    pub fn rows(&self) -> usize {
        self.plan().steps.len() + self.plan().left_out.len()
    }
}
