//! Carries out the tests of one device, one exchange after the other, within the share of the bus.

use super::disruption::Disruption;
use super::exchange::{Exchange, FlowScript};
use super::load::LoadGenerator;
use super::malformed::{MALFORMED, endless};
use super::observer::Observer;
use super::rule::{ConformanceRule as Rule, RuleNeed};
use super::task::ProofTask;
use super::verdict::{Records, RuleVerdict, Sample};
use crate::frame::{CanId, Frame};
use crate::time::{Duration, Instant};
use crate::wire::des::MAX_MESSAGE;
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Header};
use crate::wire::isotp::{Pci, TIMEOUT};
use crate::wire::node::Mode;
use crate::wire::profile::Profile;
use std::collections::VecDeque;
use std::sync::Arc;

/// Heartbeat periods that a device is observed for, at least.
const OBSERVED_PERIODS: u32 = 14;
/// Attempts of a request that must be answered, and the wait of each in timeouts of a call.
const ATTEMPTS: [u32; 4] = [1, 1, 2, 3];
/// Waits for an answer after a request that may have silenced the device.
const CONTROL_WAITS: [u64; 6] = [300, 300, 600, 1000, 2000, 4000];
/// Controls without an answer after which the device was away, and not only slow.
pub(super) const AWAY_CONTROLS: usize = 4;
/// Shortest time in which an answer that must not come is awaited.
const SILENCE: Duration = Duration::from_millis(250);
/// Time in which the user switches a device off and on.
const REBOOT_TIME: Duration = Duration::from_secs(90);
/// Times a wait is extended while the bus has no room.
const MAX_EXTENSIONS: u32 = 4;

/// What a proof begins with.
#[derive(Clone, Debug)]
pub struct ProverSetup {
    /// descan's address.
    pub own: Address,
    /// The device.
    pub device: Address,
    /// Values that the platform leaves open.
    pub profile: Arc<Profile>,
    /// Bit rate of the bus, in bit/s.
    pub bits_per_second: u32,
    /// Part of the bus capacity that requests and their answers may use, 0 to 1.
    pub budget: f64,
    /// True: only observes, sends nothing.
    pub is_listen_only: bool,
    /// Tests that are made only on demand.
    pub switches: ProofSwitches,
    /// Seed of the random DST of broadcasts.
    pub seed: u64,
}

/// Tests that are made only on demand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct ProofSwitches {
    /// What throws the device out of its work.
    pub disrupts: bool,
    /// A bus load of 80 %.
    pub loads: bool,
    /// The user switches the device off and on.
    pub reboots: bool,
}

/// What an exchange of a task is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TaskStage {
    /// The test itself; the attempt.
    Test(usize),
    /// A name request after it: does the device still answer? The attempt.
    Control(usize),
}

/// Name and list of services before a reboot, as they were received.
#[derive(Clone, Debug)]
pub(super) struct IdentityBefore {
    pub name: Option<Vec<u8>>,
    pub services: Option<Vec<u8>>,
}

/// Tests of one device.
#[derive(Clone, Debug)]
pub struct Prover {
    pub(super) setup: ProverSetup,
    pub(super) now: Instant,
    began: Instant,
    pub(super) observer: Observer,
    pub(super) records: Records,
    agenda: VecDeque<ProofTask>,
    planned: usize,
    pub(super) task: Option<ProofTask>,
    pub(super) stage: TaskStage,
    /// The test, while its control is under way.
    pub(super) tested: Option<Exchange>,
    exchange: Option<Exchange>,
    disruption: Option<Disruption>,
    pub(super) load: Option<LoadGenerator>,
    /// The device is to be switched off and on: since when, and whether it is off.
    reboot: Option<(Instant, bool)>,
    /// The last list of services.
    pub(super) services: Option<Vec<u8>>,
    pub(super) before: Option<IdentityBefore>,
    /// Intervals of the heartbeats before the first disruption, in seconds.
    pub(super) intervals: Option<[f64; 3]>,
    pub(super) loaded_at: Instant,
    /// True: the samples of the observation are in the records.
    is_judged: bool,
    extensions: u32,
    free_at: Instant,
    /// Framing in which the device answers.
    pub(super) framing: Option<Framing>,
    /// It answers only requests with the D flag of the other modes.
    pub(super) is_flag_inverted: bool,
    /// Consecutive frames to descan before its first request, of a transfer that began before the tests: the
    /// first ones, and how many.
    early: (Vec<Frame>, u32),
    /// Why nothing is sure.
    doubt: Option<String>,
    /// Why no more requests are sent.
    pub(super) silence: Option<String>,
    pub(super) has_answered: bool,
    /// Times from requests to answers.
    pub(super) latencies: Vec<Duration>,
    pub(super) name: Option<Vec<u8>>,
    /// Transfers that came whole, and those that broke, with the frames of the last.
    pub(super) whole_transfers: u32,
    pub(super) broken_transfers: Vec<(String, Vec<Frame>)>,
    /// An answer to a name request that is no name response.
    pub(super) unusable_answer: Option<Frame>,
    /// A request that must be answered was not, yet.
    pub(super) may_answer_late: bool,
    /// Until then an answer may be one to an earlier request.
    pub(super) late_until: Instant,
    /// The tests of segmented answers are on the agenda.
    has_transfers: bool,
    /// Frames of the attempts of the task without an answer.
    pub(super) unanswered: Vec<Frame>,
    /// Silence in all exchanges of the task is silence of the device.
    pub(super) is_task_sure: bool,
    /// True: the request of the task silenced the device, which was heard again; it is repeated.
    pub(super) is_repeated: bool,
    is_over: bool,
    rng: fastrand::Rng,
}

impl Prover {
    /// Creates the tests of a device, which begin at `now`.
    pub fn new(now: Instant, setup: ProverSetup) -> Self {
        let ProverSetup { own, device, bits_per_second, .. } = setup;
        let observer = Observer::new(now, own, device, Arc::clone(&setup.profile), bits_per_second);
        let mut agenda = if setup.is_listen_only { Vec::new() } else { ProofTask::agenda() };
        if setup.switches.disrupts && !setup.is_listen_only {
            agenda.extend(ProofTask::disruptions());
        }
        if setup.switches.loads && !setup.is_listen_only {
            agenda.extend(ProofTask::loads());
        }
        if setup.switches.reboots && !setup.is_listen_only {
            agenda.extend(ProofTask::reboot());
        }
        let first = now + setup.profile.heartbeat.period() * 3 / 2;
        Self {
            now,
            began: now,
            observer,
            records: Records::new(),
            planned: agenda.len(),
            agenda: agenda.into(),
            task: None,
            stage: TaskStage::Test(0),
            tested: None,
            exchange: None,
            disruption: None,
            load: None,
            reboot: None,
            services: None,
            before: None,
            intervals: None,
            loaded_at: now,
            is_judged: false,
            extensions: 0,
            // Until then a heartbeat shows the mode.
            free_at: first,
            framing: None,
            is_flag_inverted: false,
            early: (Vec::new(), 0),
            doubt: None,
            silence: None,
            has_answered: false,
            latencies: Vec::new(),
            name: None,
            whole_transfers: 0,
            broken_transfers: Vec::new(),
            late_until: now,
            unusable_answer: None,
            may_answer_late: false,
            has_transfers: false,
            unanswered: Vec::new(),
            is_task_sure: true,
            is_repeated: false,
            is_over: false,
            rng: fastrand::Rng::with_seed(setup.seed),
            setup,
        }
    }

    /// The address of the device.
    pub fn device(&self) -> Address {
        self.setup.device
    }

    /// descan's address.
    pub fn own(&self) -> Address {
        self.setup.own
    }

    /// Notes why nothing that is seen is surely of the device.
    pub fn note_doubt(&mut self, why: String) {
        self.doubt.get_or_insert(why);
    }

    /// Returns true once all tests are made.
    pub fn is_over(&self) -> bool {
        self.is_over
    }

    /// Returns true while it loads the bus.
    pub fn is_loading(&self) -> bool {
        self.load.is_some()
    }

    /// Number of tests made, and of all; those of segmented answers are added when there is one.
    pub fn progress(&self) -> (usize, usize) {
        (self.planned - self.agenda.len(), self.planned)
    }

    /// The name in its last answer.
    pub fn name(&self) -> Option<&[u8]> {
        self.name.as_deref()
    }

    /// Framing of its answers.
    pub fn framing(&self) -> Option<Framing> {
        self.framing
    }

    /// Shortest, mean and longest time from a request to its answer.
    pub fn latency(&self) -> Option<[Duration; 3]> {
        let (least, most) = (self.latencies.iter().min()?, self.latencies.iter().max()?);
        let sum: Duration = self.latencies.iter().sum();
        Some([*least, sum / self.latencies.len() as u32, *most])
    }

    /// Shortest, mean and longest interval of its heartbeats, in seconds.
    pub fn heartbeat_intervals(&self) -> Option<[f64; 3]> {
        self.intervals
            .or_else(|| self.observer.intervals().map(|(least, mean, most)| [least, mean, most]))
    }

    /// Takes a frame of the bus; those of descan once they are on it.
    pub fn handle_frame(&mut self, frame: &Frame) {
        if self.is_over {
            return;
        }
        self.now = self.now.max(frame.time);
        self.observer.handle_frame(frame);
        if self.agenda.len() == self.planned && self.task.is_none() {
            self.note_early(frame);
        }
        if let Some(exchange) = &mut self.exchange {
            exchange.handle_frame(frame);
            exchange.handle_timeout(self.now);
        }
        if let Some(load) = &mut self.load {
            load.handle_frame(frame);
        }
        if let Some(disruption) = &mut self.disruption {
            disruption.handle_frame(frame, &self.setup.profile);
        }
    }

    /// Waits for the end of a transfer that began before the tests; one that is longer than any message
    /// does not end, and leaves no room for answers.
    fn note_early(&mut self, frame: &Frame) {
        const KEPT: usize = 24;
        let most = MAX_MESSAGE.div_ceil(7) as u32;
        let CanId::Extended(id) = frame.id else { return };
        let (setup, header) = (&self.setup, Header::decode(id));
        let is_response = header.response && header.service == setup.profile.des_service();
        let is_for_us = header.source == setup.device && header.destination == setup.own;
        let pci = Pci::decode(frame.data(), frame.is_fd);
        if !is_response || !is_for_us || !matches!(pci, Ok(Pci::Consecutive { .. })) {
            return;
        }
        let (frames, count) = &mut self.early;
        *count += 1;
        if frames.len() < KEPT {
            frames.push(*frame);
        }
        self.free_at = self.free_at.max(self.now + TIMEOUT);
        if *count > most && self.silence.is_none() {
            let text = format!("over {most} consecutive frames of one transfer");
            for _ in 0..2 {
                self.records.add(Rule::TransferFraming, Sample::Broken, &*text, frames);
            }
            self.silence = Some("a transfer of the device does not end".to_owned());
            self.free_at = self.now;
        }
    }

    /// Takes that `frames` frames were lost, or, with 0, that the bus was not observed.
    pub fn handle_gap(&mut self, now: Instant, frames: u64) {
        self.now = self.now.max(now);
        self.observer.note_gap(self.now, frames);
    }

    /// Does what is due.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = self.now.max(now);
        if self.is_over {
            return;
        }
        if let Some(load) = &mut self.load {
            load.handle_timeout(self.now);
        }
        if let Some(exchange) = &mut self.exchange {
            if exchange.handle_timeout(self.now) {
                return;
            }
            self.end_exchange();
        }
        if let Some(disruption) = &mut self.disruption {
            if disruption.handle_timeout(self.now, &self.setup.profile) {
                return;
            }
            self.end_disruption();
        }
        if self.exchange.is_none() && self.now >= self.free_at {
            self.begin_next();
        }
    }

    /// Returns the next frame to send.
    pub fn poll_transmit(&mut self) -> Option<Frame> {
        let of_test = match (&mut self.exchange, &mut self.disruption) {
            (Some(exchange), _) => exchange.poll_transmit(),
            (None, Some(disruption)) => disruption.poll_transmit(),
            (None, None) => None,
        };
        of_test.or_else(|| self.load.as_mut()?.poll_transmit(self.now))
    }

    /// Returns the latest time of the next call of [`Prover::handle_timeout`]; `None` once it is over.
    pub fn poll_timeout(&self) -> Option<Instant> {
        if self.is_over {
            return None;
        }
        let due = match (&self.exchange, &self.disruption) {
            (Some(exchange), _) if exchange.has_frame() => self.now,
            (Some(exchange), _) => exchange.due(),
            (None, Some(disruption)) => disruption.due(),
            (None, None) => self.free_at,
        };
        let due = self.load.as_ref().map_or(due, |load| due.min(load.due()));
        Some(due.max(self.now + Duration::from_micros(1)))
    }

    /// Ends the tests.
    pub fn stop(&mut self, why: &str) {
        (self.exchange, self.disruption, self.load) = (None, None, None);
        self.silence.get_or_insert_with(|| why.to_owned());
        self.is_over = true;
    }

    /// The verdicts on all rules.
    pub fn verdicts(&self) -> Vec<RuleVerdict> {
        let mut records = self.records.clone();
        if !self.is_judged {
            self.judge_observation(&mut records);
        }
        self.judge_transfers(&mut records);
        self.describe_times(&mut records);
        if records.is_broken(Rule::FlowControlAwaited) {
            let follows =
                [Rule::BlockSizeKept, Rule::StMinKept, Rule::FlowWaitKept, Rule::OverflowKept];
            records.excuse(&follows, "the device does not wait for flow control");
        }
        if records.is_broken(Rule::ModeFlag) {
            let follows = [Rule::AnswersName, Rule::AnswersBroadcast, Rule::AnswersServices];
            records.excuse(&follows, "its U flag does not say which requests it takes");
        }
        let doubt = self.doubt();
        let verdict = |rule: &Rule| {
            let reason = match (rule.need().option(), rule.need()) {
                (_, RuleNeed::Disruption) if self.setup.switches.disrupts => {
                    self.silence.clone().unwrap_or_else(|| "was not seen in such a mode".to_owned())
                }
                (_, RuleNeed::Load) if self.setup.switches.loads => self.why_not_tested(),
                (_, RuleNeed::Reboot) if self.setup.switches.reboots => self.why_not_tested(),
                (Some(option), _) => format!("needs {option}"),
                (None, RuleNeed::Requests) if self.setup.is_listen_only => {
                    "no requests are sent".to_owned()
                }
                _ => self.why_not_tested(),
            };
            records.verdict(*rule, doubt.as_deref(), &reason)
        };
        Rule::ALL.iter().map(verdict).collect()
    }

    /// Why there is no sample of a rule.
    fn why_not_tested(&self) -> String {
        self.silence.clone().unwrap_or_else(|| "nothing was seen of it".to_owned())
    }

    fn judge_observation(&self, records: &mut Records) {
        self.observer.judge(self.now, records);
        self.observer.judge_silence(self.now.since(self.began), records);
    }

    /// Why nothing that is seen is surely of the device; `None` if it is.
    pub fn doubt(&self) -> Option<String> {
        self.doubt.clone().or_else(|| self.observer.doubt())
    }

    /// What is done, in some words.
    pub fn activity(&self) -> &'static str {
        // The first test that disturbs the device begins once this was observed for long enough.
        let is_begun = |task: &ProofTask| self.is_judged || !task.needs_observation();
        self.task.filter(is_begun).map_or("observes its heartbeats", ProofTask::activity)
    }

    /// Whether the device was switched off, while the user is to switch it off and on; otherwise `None`.
    pub fn power_switch(&self) -> Option<bool> {
        self.reboot.map(|(_, is_off)| is_off)
    }

    /// Judges what was observed, before descan changes it; returns false until the device was observed for
    /// long enough.
    fn end_observation(&mut self) -> bool {
        let end = self.began + self.setup.profile.heartbeat.period() * OBSERVED_PERIODS;
        if !self.is_judged && self.now < end {
            self.free_at = end;
            return false;
        }
        if !std::mem::replace(&mut self.is_judged, true) {
            self.intervals = self.heartbeat_intervals();
            let mut records = std::mem::replace(&mut self.records, Records::new());
            self.judge_observation(&mut records);
            self.records = records;
        }
        true
    }

    /// Begins or ends the load of the bus.
    fn change_load(&mut self, task: ProofTask) {
        if !self.end_observation() {
            return;
        }
        let period = self.setup.profile.heartbeat.period();
        if task == ProofTask::BeginLoad {
            self.observer.exclude(false);
            let (own, bits) = (self.setup.own, self.setup.bits_per_second);
            self.load = Some(LoadGenerator::new(self.now, own, bits));
            self.loaded_at = self.now;
            self.free_at = self.now + period * 2;
            return self.end_task();
        }
        let end = self.loaded_at + period * OBSERVED_PERIODS;
        if self.now < end {
            self.free_at = end;
            return;
        }
        self.judge_load();
        self.load = None;
        self.observer.exclude(false);
        self.end_task();
    }

    /// Waits until the device was switched off and on.
    fn wait_for_reboot(&mut self) {
        if !self.end_observation() {
            return;
        }
        let period = self.setup.profile.heartbeat.period();
        self.free_at = self.now + period / 4;
        // It may have an address that it prefers to the one it had.
        if let Some(address) = self.observer.moved_to() {
            self.take_address(address);
            self.reboot = self.reboot.map(|(since, _)| (since, true));
        }
        let Some((since, is_off)) = self.reboot else {
            self.observer.exclude(true);
            let (name, services) = (self.name.clone(), self.services.clone());
            self.before = Some(IdentityBefore { name, services });
            self.reboot = Some((self.now, false));
            return;
        };
        let silent = self.observer.silent_since().map_or(Duration::ZERO, |at| self.now.since(at));
        if !is_off && silent > period * 3 {
            self.reboot = Some((since, true));
        } else if is_off && silent < period {
            self.reboot = None;
            self.observer.exclude(false);
            self.free_at = self.now + period * 2;
            self.end_task();
        } else if self.now.since(since) > REBOOT_TIME {
            let why =
                if is_off { "the device did not come back" } else { "it was not switched off" };
            self.records.add(Rule::StableOverReboot, Sample::Unsure, why, &[]);
            (self.reboot, self.before) = (None, None);
            self.agenda.clear();
            self.end_task();
        }
    }

    /// Begins a disruption, once the device was observed for long enough.
    fn begin_disruption(&mut self, task: ProofTask) {
        if !self.end_observation() {
            return;
        }
        let Some(kind) = self.disruption_kind(task) else { return self.end_task() };
        self.observer.exclude(true);
        let pair = (self.setup.own, self.setup.device);
        let random = self.rng.u8(..128);
        let profile = &self.setup.profile;
        self.disruption =
            Some(Disruption::new(self.now, kind, pair, &self.observer, profile, random));
    }

    /// Ends the disruption. The device may have another address.
    fn end_disruption(&mut self) {
        let Some(disruption) = self.disruption.take() else { return };
        let period = self.setup.profile.heartbeat.period();
        if let Some(address) = disruption.returned.filter(|it| *it != self.setup.device) {
            self.take_address(address);
        }
        self.observer.exclude(false);
        // The first heartbeat is a claim, with U = 1; the next one has its mode.
        self.free_at = self.now + period * 3 / 2;
        self.judge_disruption(&disruption);
        self.end_task();
    }

    fn begin_next(&mut self) {
        if self.task.is_none() {
            if self.silence.is_some() {
                self.agenda.clear();
            }
            let next = self.agenda.pop_front();
            if next == Some(ProofTask::FindFraming) && self.observer.mode() == Some(Mode::Idle) {
                self.silence = Some("the device is in IDLE".to_owned());
                return;
            }
            self.task = next;
            self.stage = TaskStage::Test(0);
            self.is_repeated = false;
            self.is_task_sure = true;
            self.unanswered.clear();
        }
        let Some(task) = self.task else {
            let end = self.began + self.setup.profile.heartbeat.period() * OBSERVED_PERIODS;
            self.is_over = self.now >= end;
            self.free_at = end;
            return;
        };
        match task {
            ProofTask::BeginLoad | ProofTask::EndLoad => return self.change_load(task),
            ProofTask::Reboot => return self.wait_for_reboot(),
            _ if task.is_disruption() => return self.begin_disruption(task),
            _ => {}
        }
        let Some((frames, wait, script)) = self.exchange_of(task) else {
            self.task = None;
            return;
        };
        let pair = (self.setup.own, self.setup.device);
        let request_err = self.setup.profile.request_err;
        self.extensions = 0;
        self.exchange = Some(Exchange::new(self.now, pair, request_err, frames, wait, script));
    }

    /// The frames of the next exchange of a task, the time to wait for an answer, and flow control.
    fn exchange_of(&mut self, task: ProofTask) -> Option<(Vec<Frame>, Duration, FlowScript)> {
        self.follow_device();
        let plain = FlowScript::PLAIN;
        let call = self.setup.profile.calls.timeout();
        let silence = SILENCE.max(self.latencies.iter().max().map_or(SILENCE, |it| *it * 4));
        let attempt = match self.stage {
            TaskStage::Control(at) => {
                let wait = Duration::from_millis(CONTROL_WAITS[at.min(CONTROL_WAITS.len() - 1)]);
                let wait = wait.max(silence);
                return Some((vec![self.name_request(self.flag())], wait, plain));
            }
            TaskStage::Test(at) => at,
        };
        let patient = call * ATTEMPTS[attempt.min(ATTEMPTS.len() - 1)];
        let device = self.setup.device;
        Some(match task {
            ProofTask::FindFraming => {
                let (framing, flag) = self.guess(attempt)?;
                let request = self.request(device, flag, &[0x01], framing, false);
                (vec![request], call, plain)
            }
            ProofTask::Name => (vec![self.name_request(self.flag())], patient, plain),
            ProofTask::Broadcast => (vec![self.broadcast(self.flag(), 0x01)], patient, plain),
            ProofTask::Services => (vec![self.services_request()], patient, plain),
            ProofTask::Transfer(test) => (vec![self.services_request()], patient, test.script()),
            ProofTask::OtherFlag { is_broadcast: true } => {
                (vec![self.broadcast(!self.flag(), 0x01)], silence, plain)
            }
            ProofTask::OtherFlag { is_broadcast: false } => {
                (vec![self.name_request(!self.flag())], silence, plain)
            }
            ProofTask::OtherAddress => {
                let other = self.observer.unused_address()?;
                (vec![self.request_of_type(other, 0x01)], silence, plain)
            }
            ProofTask::WhileOthersAsked => {
                let window = self.setup.profile.heartbeat.period() * 3;
                let present = self.observer.other_address(self.now, window);
                let other = present.or_else(|| self.observer.unused_address())?;
                let frames =
                    vec![self.request_of_type(other, 0x01), self.name_request(self.flag())];
                (frames, patient, plain)
            }
            ProofTask::Reserved { kind, is_broadcast: true } => {
                (vec![self.broadcast(self.flag(), kind)], silence, plain)
            }
            ProofTask::Reserved { kind, is_broadcast: false } => {
                (vec![self.request_of_type(device, kind)], silence, plain)
            }
            ProofTask::Malformed(at) => {
                let frame = self.targeted(device, self.flag(), MALFORMED[at].0);
                (vec![frame], Duration::from_millis(50), plain)
            }
            ProofTask::LoadedName | ProofTask::NameAfterReboot => {
                (vec![self.name_request(self.flag())], patient, plain)
            }
            ProofTask::LoadedServices | ProofTask::ServicesAfterReboot => {
                (vec![self.services_request()], patient, plain)
            }
            ProofTask::Displace { .. }
            | ProofTask::Occupy
            | ProofTask::ChangeMode
            | ProofTask::BeginLoad
            | ProofTask::EndLoad
            | ProofTask::Reboot => return None,
            ProofTask::Endless => {
                let data = endless(20);
                let frames = data.iter().map(|data| self.targeted(device, self.flag(), data));
                (frames.collect(), Duration::from_millis(50), plain)
            }
        })
    }

    /// Takes the address to which the device has moved, if it is silent at its own one.
    fn follow_device(&mut self) {
        if self.is_away()
            && let Some(address) = self.observer.moved_to()
        {
            self.take_address(address);
        }
    }

    fn take_address(&mut self, address: Address) {
        self.setup.device = address;
        self.observer.set_device(address);
    }

    /// The framing and the D flag of an attempt to find those of the device; the likely ones first and
    /// most often. `None` if there are no more.
    fn guess(&self, attempt: usize) -> Option<(Framing, bool)> {
        let framings = self.setup.profile.framings(None);
        let flag = self.observer.is_working() == Some(false);
        let mut guesses: Vec<(Framing, bool)> = framings.iter().map(|it| (*it, flag)).collect();
        guesses = guesses.repeat(4);
        guesses.extend(framings.iter().map(|it| (*it, !flag)));
        guesses.get(attempt).copied()
    }

    /// Number of attempts to find the framing with the D flag of the mode.
    pub(super) fn likely_guesses(&self) -> usize {
        4 * self.setup.profile.framings(None).len()
    }

    /// The D flag of requests to the device.
    pub(super) fn flag(&self) -> bool {
        (self.observer.is_working() == Some(false)) != self.is_flag_inverted
    }

    fn name_request(&self, flag: bool) -> Frame {
        let framing = self.framing.unwrap_or(Framing::Isotp);
        self.request(self.setup.device, flag, &[0x01], framing, false)
    }

    fn services_request(&self) -> Frame {
        self.request_of_type(self.setup.device, 0x02)
    }

    fn request_of_type(&self, to: Address, kind: u8) -> Frame {
        let framing = self.framing.unwrap_or(Framing::Isotp);
        self.request(to, self.flag(), &[kind], framing, false)
    }

    fn broadcast(&mut self, flag: bool, kind: u8) -> Frame {
        let (own, device) = (self.setup.own, self.setup.device);
        let random = loop {
            let random = Address::from_bits(self.rng.u8(..128));
            if random != own && random != device {
                break random;
            }
        };
        let framing = self.framing.unwrap_or(Framing::Isotp);
        self.request(random, flag, &[kind], framing, true)
    }

    fn request(
        &self,
        to: Address,
        flag: bool,
        kind: &[u8],
        framing: Framing,
        is_broadcast: bool,
    ) -> Frame {
        let mut data = Vec::with_capacity(5);
        if framing == Framing::Isotp {
            data.push(4);
        }
        data.extend_from_slice(b"DES");
        data.extend_from_slice(kind);
        self.frame(to, flag, &data, is_broadcast)
    }

    fn targeted(&self, to: Address, flag: bool, data: &[u8]) -> Frame {
        self.frame(to, flag, data, false)
    }

    fn frame(&self, to: Address, flag: bool, data: &[u8], is_broadcast: bool) -> Frame {
        let service = self.setup.profile.des_service();
        let mut header = Header::request(self.setup.own, to, flag, service);
        header.broadcast = is_broadcast;
        header.no_error = self.setup.profile.request_err;
        Frame::classic(header.encode(), data)
    }

    fn end_exchange(&mut self) {
        let Some(mut exchange) = self.exchange.take() else { return };
        // An answer may wait for a bus that was never idle.
        let since = exchange.asked_at.max(self.now - self.setup.profile.calls.timeout() / 2);
        if exchange.answers.is_empty()
            && !exchange.is_unsent()
            && !self.observer.was_idle_since(self.now, since)
            && self.extensions < MAX_EXTENSIONS
        {
            self.extensions += 1;
            exchange.extend(self.setup.profile.calls.timeout());
            self.exchange = Some(exchange);
            return;
        }
        let rate = self.setup.budget * f64::from(self.setup.bits_per_second);
        let least = exchange.bits / rate.max(1.0);
        let free = exchange.asked_at + Duration::from_micros((least * 1e6) as u64);
        self.free_at = free.max(self.now);
        self.handle_exchange(exchange);
    }

    /// Returns true if the bus had no room for an answer.
    pub(super) fn is_bus_full(&self) -> bool {
        self.extensions >= MAX_EXTENSIONS
    }

    /// Ends the task. An answer that may come late must not be taken for one to the next request.
    pub(super) fn end_task(&mut self) {
        self.task = None;
        if std::mem::take(&mut self.may_answer_late) {
            self.free_at = self.free_at.max(self.now + self.setup.profile.calls.timeout() * 2);
        }
    }

    /// Ends the test and begins its control.
    pub(super) fn begin_control(&mut self, tested: Exchange) {
        self.tested = Some(tested);
        self.stage = TaskStage::Control(0);
    }

    /// Adds the tests of segmented answers, before those that may silence the device.
    pub(super) fn add_transfers(&mut self) {
        if std::mem::replace(&mut self.has_transfers, true) {
            return;
        }
        let at = self.agenda.iter().position(|it| matches!(it, ProofTask::Malformed(_)));
        let at = at.unwrap_or(self.agenda.len());
        let rest = self.agenda.split_off(at);
        self.agenda.extend(ProofTask::transfers());
        self.agenda.extend(rest);
        self.planned += ProofTask::transfers().count();
    }

    /// Number of attempts of a request that must be answered.
    pub(super) fn attempts() -> usize {
        ATTEMPTS.len()
    }

    /// Number of controls after a test.
    pub(super) fn controls() -> usize {
        CONTROL_WAITS.len()
    }
}
