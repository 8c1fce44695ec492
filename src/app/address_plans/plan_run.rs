//! The run of a plan: its clock, its requests and their ends, its file, its lines on the timeline.

use super::known_devices::PlanKnowledge;
use super::{MAX_READS, PlanSession, READ_INTERVAL, RENEWAL_INTERVAL};
use crate::address_plan::{DeviceIdentity, PlanRequest, RequestEnd};
use crate::app::device_command::DeviceCommand;
use crate::app::notices::TimelineEntry;
use crate::app::shared_address::{identity_of, is_shared};
use crate::app::timeline_kind::TimelineKind;
use crate::app::{App, Bus, Effect, Overlay, TxBlocked};
use crate::discovery::{DeviceRequest, Event, EventKind, OwnAddress, RequestId, RequestOutcome};
use crate::frame::BusIndex;
use crate::status::BusState;
use crate::text::hex;
use crate::time::Instant;

impl App {
    /// When the plan is to be looked after.
    pub(in crate::app) fn plan_timeout(&self) -> Option<Instant> {
        let session = self.plan.as_ref()?;
        let run = session.run.as_ref().and_then(|run| run.poll_timeout(self.clock.now()));
        let renewal = self.is_plan_shown(session).then_some(session.renewal_due);
        run.into_iter().chain(session.reading_due).chain(renewal).min()
    }

    /// Returns true if the plan is shown, and can be made again: not while it is asked about.
    fn is_plan_shown(&self, session: &PlanSession) -> bool {
        let is_open = matches!(self.input.overlay(), Overlay::Plan);
        is_open && session.run.is_none() && !session.is_reading()
    }

    /// Looks after the plan.
    pub(in crate::app) fn step_plan(&mut self, now: Instant) {
        let Some(mut session) = self.plan.take() else { return };
        if session.reading_due.is_some_and(|due| due <= now) {
            let bus = self.buses.get(session.bus);
            let is_read = |bus: &Bus| {
                !bus.devices().iter().any(|device| bus.is_reading_descriptor(device.id))
            };
            session.reading_due = Some(now + READ_INTERVAL);
            if bus.is_none_or(is_read) {
                let unread = self.unread_settings(session.bus);
                session.reads += 1;
                if !unread.is_empty() && session.reads < MAX_READS {
                    self.plan = Some(session);
                    self.read_settings(&unread);
                    // The engine sends at once.
                    self.buses.handle_timeout(now);
                    return self.take_events();
                }
                session.unread =
                    unread.iter().filter_map(|id| Some(self.device(*id)?.address)).collect();
                session.reading_due = None;
                session.renewal_due = now + RENEWAL_INTERVAL;
                self.plan = Some(session);
                self.notices.redraw.set_dirty();
                return self.renew_plan();
            }
        }
        let has_run = session.run.is_some();
        if has_run {
            self.step_run(now, &mut session);
        } else if self.is_plan_shown(&session) && session.renewal_due <= now {
            session.renewal_due = now + RENEWAL_INTERVAL;
            self.plan = Some(session);
            return self.renew_shown_plan();
        }
        self.plan = Some(session);
        if has_run {
            self.show_plan_change();
        }
    }

    fn step_run(&mut self, now: Instant, session: &mut PlanSession) {
        let obstacle = self.plan_obstacle(session.bus);
        // The device that moves may be the only one that acknowledges.
        let has_only_no_ack = self.buses.get(session.bus).is_some_and(|bus| {
            bus.tx_blocked() == Some(TxBlocked::NoAck)
                && !bus.status.listens_first
                && bus.controller().state != BusState::BusOff
                && matches!(bus.own_address(), OwnAddress::Held(_))
        });
        session.renew_record(self.clock.epoch().unix_secs(now));
        let index = session.bus;
        let record = session.record.as_ref().map(|(_, record)| record);
        let knowledge =
            PlanKnowledge { record, earlier: None, forgets_absent: session.forgets_absent };
        let Some(run) = &mut session.run else { return };
        if run.poll_timeout(now).is_some_and(|due| due <= now) {
            match obstacle {
                Some(why) if run.is_running() && !(run.is_waiting() && has_only_no_ack) => {
                    run.handle_obstacle(why);
                }
                _ => run.handle_timeout(now, &self.known_devices(index, knowledge)),
            }
        }
        if let Some(request) = run.poll_request() {
            let step = run.current();
            run.handle_sent(now);
            let identity = run.plan().steps[step].device.clone();
            match self.send_for_plan(index, request, &identity) {
                Ok(id) => session.open = Some((id, step)),
                Err(why) => run.handle_request_end(RequestEnd::NotSent(why)),
            }
        }
        if !run.is_stored() && session.writing.is_none() {
            session.writing = Some(run.revision());
            let is_running = run.is_running();
            session.renew_record(self.clock.epoch().unix_secs(now));
            if let Some((name, record)) = &session.record {
                let (name, bytes) = (name.clone(), record.to_bytes());
                let is_new = std::mem::take(&mut session.is_file_new);
                let runs_on = is_running.then(|| record.bus.clone());
                self.effects.push_back(Effect::WritePlan { name, bytes, is_new, runs_on });
            }
        }
        self.report_plan_news(session);
    }

    /// Notes what changed on the screen through a look after the plan.
    fn show_plan_change(&mut self) {
        let is_open = matches!(self.input.overlay(), Overlay::Plan);
        if let Some(session) = &mut self.plan
            && session.run.is_some()
        {
            session.is_seen = is_open || session.is_seen && !session.is_running();
        }
        self.renew_banner();
    }

    /// Sends a request, if the device with this identity is still alone at its address.
    fn send_for_plan(
        &mut self,
        bus: BusIndex,
        request: PlanRequest,
        identity: &DeviceIdentity,
    ) -> Result<RequestId, String> {
        let (at, command) = match request {
            PlanRequest::Write(at, setting) => (at, DeviceCommand::Address(setting)),
            PlanRequest::Restart(at) => (at, DeviceCommand::Restart),
        };
        let here = self.buses.get(bus).and_then(|bus| Some((bus, bus.device_at(at)?)));
        let (on, device) = here.ok_or_else(|| format!("no device at {at}"))?;
        let found = identity_of(device);
        if !identity.is_same(&found) {
            let who = found.label();
            let who = if who == identity.label() { format!("another {who}") } else { who };
            return Err(format!("{who} is at {at} now"));
        }
        if is_shared(on, device, self.clock.now()) {
            return Err(format!("another device is at {at}, too"));
        }
        let device = device.id;
        let request = command.request(&self.buses.profile(bus));
        let (service, data) = request.ok_or("its service number is not known")?;
        let request = DeviceRequest { device, service, data };
        let sent = self.buses.request(self.clock.now(), request);
        sent.ok_or_else(|| "too many requests wait to be sent".to_owned())
    }

    /// Takes the end of a request of the plan; returns false for another request.
    pub(in crate::app) fn end_plan_request(&mut self, bus: BusIndex, event: &Event) -> bool {
        let EventKind::RequestEnded { request, frame, outcome } = &event.kind else { return false };
        let timeout = self.buses.profile(bus).calls.timeout();
        let Some(session) = self.plan.as_mut().filter(|session| session.bus == bus) else {
            return false;
        };
        let Some((_, step)) = session.open.take_if(|(id, _)| id == request) else { return false };
        if let Some(place) = session.frames.get_mut(step).filter(|_| frame.is_some()) {
            *place = *frame;
        }
        let end = match outcome {
            RequestOutcome::Responded(_) => RequestEnd::Responded,
            RequestOutcome::Refused(code) => RequestEnd::Refused(hex(code, " ")),
            RequestOutcome::NoResponse => RequestEnd::NoResponse(timeout),
            RequestOutcome::NotSent(why) => RequestEnd::NotSent(why.to_string()),
        };
        if let Some(run) = &mut session.run {
            run.handle_request_end(end);
        }
        true
    }

    fn report_plan_news(&mut self, session: &mut PlanSession) {
        let Some(run) = &mut session.run else { return };
        let count = run.states().len();
        let news: Vec<_> = std::iter::from_fn(|| run.poll_news()).collect();
        for it in news {
            if let Some(step) = it.step.filter(|_| it.is_failure) {
                session.selected = step;
            }
            let kind = if it.is_failure { TimelineKind::Error } else { TimelineKind::Improved };
            let step = it.step.and_then(|at| Some((at, session.plan().steps.get(at)?)));
            let text = match step {
                Some((at, step)) => {
                    let frame = session.frame(at).map(|frame| format!(" ({frame})"));
                    let (frame, from, to) = (frame.unwrap_or_default(), step.from, step.to);
                    format!("plan step {} of {count}, {from} → {to}{frame}: {}", at + 1, it.text)
                }
                None => format!("plan: {}", it.text),
            };
            let mut line = TimelineEntry::new(self.clock.now(), kind, text).on(session.bus);
            if let Some((_, step)) = step {
                line.name.clone_from(&step.device.name);
                line.address = Some(step.to);
                let bus = self.buses.get(session.bus);
                let near = [step.to, step.from].map(|at| bus.and_then(|bus| bus.device_at(at)));
                line.device = near.into_iter().flatten().next().map(|device| device.id);
            }
            self.report_line(line);
            if it.step.is_none() {
                let text = format!("plan: {}", it.text);
                if it.is_failure { self.show_error(text) } else { self.show_info(text) }
            }
        }
        self.notices.redraw.set_dirty();
    }
}
