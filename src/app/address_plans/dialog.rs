//! The plan on the screen: opening it, the selected row, leaving a step out, the order, the question.

use super::goals::GoalKey;
use super::{PlanSession, PlanStart, PlanTask};
use crate::address_plan::{PlanRun, RunState, StepEffect};
use crate::app::device_command::DeviceCommand;
use crate::app::input::{Overlay, Question};
use crate::app::{App, view::Page};
use crate::frame::{BusIndex, Frame};
use crate::keymap::Action;
use crate::status::PlaybackCommand;
use crate::wire::id::Header;
use crate::wire::profile::{ProfileKey, WriteEffect};

impl PlanSession {
    /// Place of the selected row: a step, or behind the steps a device without one.
    pub const fn selected(&self) -> usize {
        self.selected
    }

    /// Returns true if its steps can be changed; `again`: or what is left of it can be planned.
    pub fn can_start(&self, again: bool) -> bool {
        match self.run.as_ref().map(PlanRun::state) {
            None => !self.is_reading(),
            Some(RunState::Stopped(_)) => again,
            Some(_) => false,
        }
    }

    /// Place of the goal of a row.
    fn goal_of_row(&self, row: usize) -> Option<usize> {
        let plan = self.plan();
        let step = plan.steps.get(row).map(|step| step.goal);
        step.or_else(|| Some(plan.left_out.get(row.checked_sub(plan.steps.len())?)?.goal))
    }

    fn goal_key(&self, goal: usize) -> Option<GoalKey> {
        self.goals.get(goal).map(|goal| (goal.identity.clone(), goal.to))
    }
}

impl App {
    /// Opens the plan of the selected device's bus; of a log, pauses that.
    pub(in crate::app) fn open_plan(&mut self) {
        if self.clock.playback().is_some() {
            return self.control_playback(PlaybackCommand::Pause);
        }
        if self.view.frozen.is_some() {
            let key = self.key_of_present();
            return self.show_error(format!("frozen: {key} shows the present first"));
        }
        let keeps = |session: &PlanSession| match session.run.as_ref().map(PlanRun::state) {
            Some(RunState::Running | RunState::Stopped(_) | RunState::Stored) => true,
            Some(RunState::Done) | None => false,
        };
        if !self.plan.as_deref().is_some_and(keeps) {
            let on_devices = self.view.page == Page::Devices;
            let selected = self.selected_device().filter(|_| on_devices);
            let bus = selected.map_or(BusIndex(0), |device| device.id.bus);
            if let Err(why) = self.prepare_plan(bus, PlanTask::ToFile, false) {
                return self.show_error(format!("plan: {why}"));
            }
        }
        if let Some(session) = &mut self.plan {
            session.is_seen = true;
        }
        self.input.open(Overlay::Plan);
        self.renew_banner();
    }

    /// Decides whether the line above the page is shown.
    pub(in crate::app) fn renew_banner(&mut self) {
        let has_banner = self.profile_difference().is_some() || self.plan_banner().is_some();
        if std::mem::replace(&mut self.view.has_banner, has_banner) != has_banner {
            self.notices.redraw.set_dirty();
        }
    }

    /// The line about a plan that runs, or stopped unseen.
    pub fn plan_banner(&self) -> Option<String> {
        let session = self.plan.as_ref()?;
        let run = session.run.as_ref()?;
        let (step, count) = ((run.current() + 1).min(run.states().len()), run.states().len());
        match run.state() {
            RunState::Running => Some(format!("plan: step {step} of {count}")),
            RunState::Stopped(cause) if !session.is_seen => {
                Some(format!("plan: stopped at step {step} of {count}: {cause}"))
            }
            _ => None,
        }
    }

    /// Selects another row of the plan.
    pub(in crate::app) fn move_in_plan(&mut self, by: isize) {
        let Some(session) = &mut self.plan else { return };
        let last = session.rows().saturating_sub(1);
        session.selected = session.selected.saturating_add_signed(by).min(last);
    }

    /// Leaves the device of the selected row out, or takes it in again.
    pub(in crate::app) fn leave_out_of_plan(&mut self) {
        let Some(session) = self.changeable_plan() else { return };
        let Some(goal) = session.goal_of_row(session.selected) else { return };
        let Some(key) = session.goal_key(goal) else { return };
        match session.left_out.iter().position(|it| *it == key) {
            Some(place) => drop(session.left_out.remove(place)),
            None => session.left_out.push(key.clone()),
        }
        self.renew_plan();
        self.select_goal(&key);
    }

    /// Moves the device of the selected step to an earlier or a later place, as far as addresses allow.
    pub(in crate::app) fn reorder_plan(&mut self, is_later: bool) {
        let Some(session) = self.changeable_plan() else { return };
        // The order of the first steps.
        let mut order: Vec<usize> = Vec::new();
        for step in &session.plan.steps {
            if !order.contains(&step.goal) {
                order.push(step.goal);
            }
        }
        let selected = session.goal_of_row(session.selected);
        let Some(at) = order.iter().position(|goal| Some(*goal) == selected) else { return };
        let other = if is_later { at + 1 } else { at.wrapping_sub(1) };
        if other >= order.len() {
            return;
        }
        order.swap(at, other);
        session.order = order.iter().filter_map(|goal| session.goal_key(*goal)).collect();
        let Some(key) = selected.and_then(|goal| session.goal_key(goal)) else { return };
        let moves = |session: &PlanSession| -> Vec<_> {
            let steps = session.plan.steps.iter();
            steps.map(|step| (step.device.clone(), step.from, step.to)).collect()
        };
        let before = moves(session);
        self.renew_plan();
        self.select_goal(&key);
        if self.plan.as_ref().is_some_and(|session| moves(session) == before) {
            self.show_error("the order follows from the addresses");
        }
    }

    /// Chooses whether descan restarts each device.
    pub(in crate::app) fn toggle_plan_restarts(&mut self) {
        let Some(session) = self.changeable_plan() else { return };
        let (bus, restarts) = (session.bus, !session.restarts);
        let profile = self.buses.profile(bus);
        if profile.writes.effect == WriteEffect::Now {
            return self.show_error("writes act at once: no restart is needed");
        }
        if !profile.is_given(ProfileKey::Reboot) {
            let key = ProfileKey::Reboot.name();
            return self.show_error(format!("a restart needs a profile with {key}"));
        }
        if let Some(session) = &mut self.plan {
            session.restarts = restarts;
        }
        self.renew_plan();
    }

    /// Chooses between fixed and preferred addresses.
    pub(in crate::app) fn toggle_plan_setting(&mut self) {
        let Some(session) = self.changeable_plan() else { return };
        session.is_fixed = !session.is_fixed;
        self.renew_plan();
    }

    /// Makes a plan that brings the devices back to where they were before the run.
    pub(in crate::app) fn take_plan_back(&mut self) {
        let Some(session) = &self.plan else { return };
        if session.is_running() {
            return self.show_error("the plan runs: stop it first");
        }
        let own = session.record.as_ref().or_else(|| session.last_plan());
        let Some((name, record)) = own.cloned() else {
            return self.show_error("nothing was written: nothing to take back");
        };
        let (bus, restarts) = (session.bus, session.restarts);
        let task = PlanTask::TakeBack(Box::new(record), name);
        match self.prepare_plan(bus, task, restarts) {
            Ok(()) => self.show_info("the way back: Enter starts it"),
            Err(why) => self.show_error(why),
        }
    }

    /// Asks whether to start the plan; of one that stopped, makes a new one with the same addresses.
    pub(in crate::app) fn ask_to_start_plan(&mut self) {
        let Some(session) = &self.plan else { return };
        let state = session.run.as_ref().map(|run| run.state().clone());
        match state {
            None if session.is_reading() => self.show_error("settings are being read"),
            None if session.problem().is_some() => {
                let why = session.problem().cloned().unwrap_or_default();
                self.show_error(format!("plan: {why}"));
            }
            None if session.plan.steps.is_empty() => self.show_error("no step to do"),
            None => match self.plan_obstacle(session.bus) {
                None => self.input.ask(Question::Plan),
                Some(why) => self.show_error(why),
            },
            Some(RunState::Running) => {
                let key = self.key_of(Action::PlanStop);
                self.show_error(format!("the plan runs; {key} stops it after this step"));
            }
            Some(RunState::Done | RunState::Stored) => self.show_error("nothing is left to write"),
            Some(RunState::Stopped(_)) => {
                let Some((name, record)) = session.record.clone() else { return };
                let (bus, restarts) = (session.bus, session.restarts);
                let task = PlanTask::Resume(Box::new(record), name);
                match self.prepare_plan(bus, task, restarts) {
                    Ok(()) => self.show_info("what is left: Enter starts it"),
                    Err(why) => self.show_error(why),
                }
            }
        }
    }

    /// Takes the answer to the question, and shows the plan again.
    pub(in crate::app) fn plan_answered(&mut self, is_yes: bool) {
        if is_yes && let Err(why) | Ok(PlanStart::Changed(why)) = self.start_plan() {
            self.show_error(why);
        }
        self.input.open(Overlay::Plan);
        self.renew_banner();
    }

    /// Stops after the present step, or does not any more.
    pub(in crate::app) fn stop_plan(&mut self) {
        if !self.plan.as_ref().is_some_and(|session| session.is_running()) {
            return self.show_error("the plan does not run");
        }
        self.stop_plan_after_step();
        let run = self.plan.as_ref().and_then(|session| session.run.as_ref());
        let stops = run.is_some_and(PlanRun::stops_after_step);
        self.show_info(if stops { "stops after this step" } else { "goes on after this step" });
    }

    /// The plan, as long as it is not started; else reports why it stays as it is.
    fn changeable_plan(&mut self) -> Option<&mut PlanSession> {
        let is_free = self
            .plan
            .as_ref()
            .is_some_and(|session| session.run.is_none() && !session.is_reading());
        if !is_free {
            self.show_error("the plan is started, or not ready");
            return None;
        }
        self.plan.as_deref_mut()
    }

    /// Makes the plan again, with the same device selected.
    pub(super) fn renew_shown_plan(&mut self) {
        let Some(session) = &self.plan else { return };
        let (shown, selected) = (session.plan.clone(), session.goal_of_row(session.selected));
        let selected = selected.and_then(|goal| session.goal_key(goal));
        self.renew_plan();
        let is_same = self.plan.as_ref().is_some_and(|session| session.plan == shown);
        if let Some(selected) = selected.filter(|_| !is_same) {
            self.select_goal(&selected);
        }
    }

    fn select_goal(&mut self, key: &GoalKey) {
        let Some(session) = &mut self.plan else { return };
        let is_it = |row: &usize| {
            let goal = session.goal_of_row(*row);
            goal.and_then(|goal| session.goal_key(goal)).as_ref() == Some(key)
        };
        // Of a detour and its final step the final one.
        let row = (0..session.rows()).rfind(is_it);
        session.selected = row.unwrap_or(session.selected);
    }

    /// The requests of a step with their meanings: the last one sent, else those that will be.
    pub fn plan_frames(&self, session: &PlanSession, step: usize) -> Vec<(Frame, String)> {
        let Some(planned) = session.plan().steps.get(step) else { return Vec::new() };
        let Some(bus) = self.buses.get(session.bus) else { return Vec::new() };
        let crate::discovery::OwnAddress::Held(own) = bus.own_address() else { return Vec::new() };
        let profile = self.buses.profile(session.bus);
        let write = planned.setting.map(DeviceCommand::Address);
        let restarts = self.plan_effect(session) == StepEffect::Restart;
        let restart = restarts.then_some(DeviceCommand::Restart);
        let is_working = bus.device_at(planned.from).is_none_or(|device| device.is_working);
        let commands = write.into_iter().chain(restart);
        let frames = commands.filter_map(|command| {
            let (service, data) = command.request(&profile)?;
            let mut header = Header::request(own, planned.from, !is_working, service);
            header.no_error = profile.request_err;
            Some((Frame::classic(header.encode(), &data), command.to_string()))
        });
        match session.frame(step) {
            None => frames.collect(),
            Some(sent) => {
                let is_it = |it: &(Frame, String)| it.0.data() == sent.data();
                let meaning = frames.filter(is_it).map(|it| it.1).next();
                vec![(*sent, format!("{}, sent", meaning.unwrap_or_default()))]
            }
        }
    }
}
