//! What the answers of an exchange mean for the rules.
//!
//! Silence counts only if the request was on the bus, no frame was lost and the device still answers; an
//! answer that must not be counts only if no other requester asked.

use super::disruption::{Disruption, DisruptionKind};
use super::exchange::{Exchange, FlowFacts, ReceivedAnswer};
use super::malformed::MALFORMED;
use super::rule::ConformanceRule as Rule;
use super::task::{ProofTask, TEST_ST_MIN, TransferTest};
use super::tester::{AWAY_CONTROLS, IdentityBefore, Prover, TaskStage};
use super::verdict::{Records, Sample};
use crate::frame::Frame;
use crate::text::counted;
use crate::time::Duration;
use crate::wire::des::{ResponseFault, ServicesResponse, TYPE_NAME, TYPE_SERVICES, decode_name};
use crate::wire::framing::Framing;
use crate::wire::id::Header;
use crate::wire::isotp::TransferFault;
use crate::wire::node::Mode;
use crate::wire::profile::ProfileKey;

/// Part of STmin that the mean interval of frames must reach: time stamps are not exact.
const ST_MIN_PART: f64 = 0.75;
/// Time after which an answer on a full bus does not come any more. Chosen.
const LATEST_ANSWER: Duration = Duration::from_secs(10);
/// Longest interval of heartbeats, in periods, with which silence for 1.4 periods is no jitter.
const REGULAR_PERIODS: f64 = 1.2;
/// Time for which a lost frame makes what follows doubtful: a transfer that was not seen to begin.
const LOSS_MEMORY: Duration = Duration::from_secs(3);
/// Time after a request that may have stopped a device in which it is heard again, or not at all. Chosen:
/// a person switches it off and on, and it resolves its address.
const RETURN_TIME: Duration = Duration::from_secs(30);
/// Periods of heartbeats after which a device without an answer is not one that resolves its address.
const SETTLED_PERIODS: u32 = 4;
/// Broken transfers that are no lost frames, if none came whole.
const BROKEN_TRANSFERS: usize = 3;

impl Prover {
    /// Takes an exchange that is over.
    pub(super) fn handle_exchange(&mut self, exchange: Exchange) {
        let Some(task) = self.task else { return };
        self.is_task_sure &= self.is_sure(&exchange);
        let is_sure = self.is_task_sure;
        self.note_answers(&exchange);
        let is_control = matches!(self.stage, TaskStage::Control(_));
        if !is_control && exchange.answers.is_empty() {
            self.unanswered.extend(&exchange.frames);
        }
        if exchange.answers.is_empty() && (is_control || task.demands_answer()) {
            self.note_silence(task);
        }
        match self.stage {
            TaskStage::Control(attempt) => self.handle_control(task, attempt, &exchange, is_sure),
            TaskStage::Test(attempt) if task == ProofTask::FindFraming => {
                self.handle_guess(attempt, &exchange, is_sure);
            }
            TaskStage::Test(attempt) if task.demands_answer() => {
                self.handle_demanded(task, attempt, &exchange, is_sure);
            }
            TaskStage::Test(_) => self.begin_control(exchange),
        }
    }

    /// Returns true if silence in an exchange is silence of the device.
    fn is_sure(&self, exchange: &Exchange) -> bool {
        !exchange.is_unsent()
            && !self.is_away()
            && !exchange.is_disturbed
            && !self.is_bus_full()
            && self.observer.is_sure_since(exchange.asked_at - LOSS_MEMORY)
    }

    /// Returns true if the device sent heartbeats and sends none any more, or is in a mode in which it need
    /// not answer.
    pub(super) fn is_away(&self) -> bool {
        let period = self.setup.profile.heartbeat.period();
        let is_silent = self.observer.silent_since().is_some_and(|at| {
            !self.observer.heartbeats.is_empty() && self.now.since(at) > period * 5 / 2
        });
        is_silent || matches!(self.observer.mode(), Some(Mode::Init | Mode::Arslv | Mode::Idle))
    }

    /// Returns true if an answer in an exchange answers its request: no other requester asked, and no
    /// answer to an earlier request is outstanding.
    fn is_alone(&self, exchange: &Exchange) -> bool {
        !exchange.is_disturbed && exchange.asked_at >= self.late_until
    }

    /// Notes that a request that must be answered was not: the answer may come late.
    fn note_silence(&mut self, task: ProofTask) {
        self.may_answer_late = true;
        if task != ProofTask::FindFraming {
            self.late_until = self.now + LATEST_ANSWER;
        }
    }

    /// Notes what every answer shows, whatever it answers.
    fn note_answers(&mut self, exchange: &Exchange) {
        let first = exchange.answers.iter().find(|it| it.is_response());
        if let (Some(sent), Some(answer)) = (exchange.sent_at, first)
            && self.is_alone(exchange)
        {
            self.latencies.push(answer.first_at.since(sent));
        }
        for answer in &exchange.answers {
            self.has_answered |= answer.is_response();
            match &answer.fault {
                Some(fault) => self.note_broken_transfer(exchange, *fault),
                None if answer.message.is_some() && exchange.facts.first_frames > 0 => {
                    self.whole_transfers += 1;
                }
                None => {}
            }
        }
        if exchange.facts.first_frames > 0 {
            self.add_transfers();
        }
    }

    fn note_broken_transfer(&mut self, exchange: &Exchange, fault: TransferFault) {
        if exchange.facts.after_overflow == 0 && !self.is_held_late() {
            self.broken_transfers.push((fault.to_string(), exchange.frames.clone()));
        }
    }

    /// Returns true while a transfer is meant to break.
    fn is_held_late(&self) -> bool {
        matches!(
            self.task,
            Some(ProofTask::Transfer(TransferTest::Timeout | TransferTest::Overflow))
        )
    }

    fn handle_guess(&mut self, attempt: usize, exchange: &Exchange, is_sure: bool) {
        let answer = exchange.answers.iter().find(|it| it.is_response());
        if let Some(answer) = answer {
            self.framing = answer.framing;
            self.is_flag_inverted =
                attempt >= self.likely_guesses() && !fits_flag(exchange, answer);
            if self.is_flag_inverted {
                let mode = if self.observer.is_working() == Some(false) { "not " } else { "" };
                for _ in 0..2 {
                    let text =
                        format!("answers only requests to the other modes, while {mode}working");
                    self.records.add(Rule::OwnDFlag, Sample::Broken, text, &exchange.frames);
                }
            }
            self.judge_answers(exchange, TYPE_NAME, false);
            return self.end_task();
        }
        if let Some(answer) = exchange.answers.first() {
            self.unusable_answer = Some(answer.frame);
            self.judge_answers(exchange, TYPE_NAME, false);
        }
        let last = self.likely_guesses() + self.setup.profile.framings(None).len();
        if attempt + 1 < last {
            self.stage = TaskStage::Test(attempt + 1);
            return;
        }
        let rule = Rule::AnswersName;
        if let Some(frame) = self.unusable_answer {
            // A name that does not fit one frame cannot be sent raw.
            self.records.add(rule, Sample::Unsure, format!("answered with {frame} only"), &[frame]);
        } else if is_sure {
            let text = format!("no answer to {}", counted(last as u64, "name request"));
            self.records.depends_on(rule, &[ProfileKey::Des], &self.setup.profile);
            self.records.add(rule, Sample::Broken, text, &self.unanswered);
        } else {
            self.records.add(rule, Sample::Unsure, self.why_unsure(exchange), &[]);
        }
        self.silence = Some("no name response from the device".to_owned());
        self.end_task();
    }

    /// Why silence in an exchange may not be that of the device.
    fn why_unsure(&self, exchange: &Exchange) -> String {
        if exchange.is_unsent() {
            "the bus did not take the request".to_owned()
        } else if self.is_bus_full() {
            "the bus had no room for an answer".to_owned()
        } else if self.is_away() {
            "the device was away".to_owned()
        } else if exchange.is_disturbed {
            "another requester asked the device".to_owned()
        } else if self.observer.lost_frames() > 0 {
            format!("{} lost", counted(self.observer.lost_frames(), "frame"))
        } else if exchange.asked_at < self.late_until {
            "the answer to an earlier request may come late".to_owned()
        } else {
            "the device did not answer".to_owned()
        }
    }

    /// Takes the answer to a request that the device must answer.
    fn handle_demanded(
        &mut self,
        task: ProofTask,
        attempt: usize,
        exchange: &Exchange,
        is_sure: bool,
    ) {
        let kind = if task.is_about_services() { TYPE_SERVICES } else { TYPE_NAME };
        let rule = task.answer_rule();
        let refusal = exchange.answers.iter().find(|it| it.is_refusal());
        if exchange.answers.iter().any(|it| it.kind() == Some(kind)) {
            let text = "answered".to_owned();
            self.records.add(rule, Sample::Kept, text, &exchange.frames);
        } else if let Some(refusal) = refusal {
            // A list that does not fit one frame cannot be sent raw.
            let is_raw = self.framing == Some(Framing::Raw) && kind == TYPE_SERVICES;
            let sample = if is_raw { Sample::Unsure } else { Sample::Broken };
            let text = format!("refused with {}", refusal.frame);
            self.records.add(rule, sample, text, &exchange.frames);
        } else if exchange.answers.is_empty() {
            if attempt + 1 < Self::attempts() {
                self.stage = TaskStage::Test(attempt + 1);
                return;
            }
            if is_sure {
                let text = format!("no answer to {}", counted(attempt as u64 + 1, "request"));
                self.records.add(rule, Sample::Broken, text, &self.unanswered);
            } else {
                self.records.add(rule, Sample::Unsure, self.why_unsure(exchange), &[]);
            }
        }
        self.judge_answers(exchange, kind, task == ProofTask::Broadcast);
        match task {
            ProofTask::Transfer(test) => self.judge_transfer(test, exchange),
            ProofTask::NameAfterReboot | ProofTask::ServicesAfterReboot => {
                self.judge_reboot(kind, exchange);
            }
            _ => {}
        }
        self.end_task();
    }

    /// Judges the form of answers to a request of a known type.
    fn judge_answers(&mut self, exchange: &Exchange, kind: u8, is_broadcast: bool) {
        let is_alone = self.is_alone(exchange);
        let count = exchange.answers.iter().filter(|it| !it.is_refusal()).count();
        // Frames that a bridge repeats are equal.
        let is_single = self.task != Some(ProofTask::WhileOthersAsked);
        if count > 1 && is_alone && is_single {
            let text = format!("{count} answers to one request");
            self.records.add(Rule::OneAnswer, Sample::Broken, text, &exchange.frames);
        } else if count == 1 && is_alone {
            self.records.add(Rule::OneAnswer, Sample::Kept, "one answer to each request", &[]);
        }
        self.judge_surplus(exchange);
        let is_late = |it: &&ReceivedAnswer| !is_alone && it.kind() != Some(kind);
        let answers = exchange.answers.iter().filter(|it| !it.is_refusal() && !is_late(it));
        for answer in answers {
            self.judge_header(exchange, answer, is_broadcast);
            if kind == TYPE_NAME {
                self.judge_name(exchange, answer);
            } else {
                self.judge_services(exchange, answer);
            }
        }
    }

    fn judge_header(&mut self, exchange: &Exchange, answer: &ReceivedAnswer, is_broadcast: bool) {
        let header = answer.header;
        if header.no_error {
            self.records.add(Rule::ErrorFlag, Sample::Kept, "ERR = 1", &[]);
        } else {
            let text = "answered with ERR = 0";
            self.records.add(Rule::ErrorFlag, Sample::Broken, text, &exchange.frames);
        }
        let fault = if header.broadcast && !is_broadcast {
            Some("answered a request to it with B = 1".to_owned())
        } else if header.to_non_working {
            Some("answered a request with U = 0 with D = 1".to_owned())
        } else if exchange.strange_destination && !header.broadcast {
            let (to, own) = (header.destination, self.setup.own);
            Some(format!("answered to {to}, the requester is {own}"))
        } else {
            None
        };
        if let Some(text) = fault {
            self.records.add(Rule::AnswerHeader, Sample::Broken, text, &exchange.frames);
        } else if header.destination == header.source && !header.broadcast {
            // Section 4.3 says so to the letter.
            let text = "R = 1, B = 0, D = 0; DST is that of the request (rsp.dst = req.dst)";
            self.records.add(Rule::AnswerHeader, Sample::Kept, text, &[]);
        } else {
            let text = "R = 1, B = 0, D = 0, to the requester";
            self.records.add(Rule::AnswerHeader, Sample::Kept, text, &[]);
        }
    }

    fn judge_name(&mut self, exchange: &Exchange, answer: &ReceivedAnswer) {
        let Some(message) = &answer.message else { return };
        let (name, fault) = decode_name(message);
        let Some(fault) = fault else {
            let name = name.unwrap_or_default();
            self.name = Some(name.to_vec());
            let name = String::from_utf8_lossy(name);
            let text = format!("{name}, {}", counted(name.len() as u64, "byte"));
            self.records.add(Rule::NameFormat, Sample::Kept, text, &[]);
            return;
        };
        let text = match fault {
            ResponseFault::NotAName => {
                let kind = message.first().map_or("nothing".to_owned(), |it| format!("{it:#04X}"));
                format!("the answer begins with {kind}, not 0x01")
            }
            ResponseFault::Truncated => "no zero behind the name".to_owned(),
            _ => fault.to_string(),
        };
        self.records.add(Rule::NameFormat, Sample::Broken, text, &exchange.frames);
    }

    fn judge_services(&mut self, exchange: &Exchange, answer: &ReceivedAnswer) {
        let Some(message) = &answer.message else { return };
        let response = ServicesResponse::decode(message);
        let fault = response.fault().map(|fault| match fault {
            ResponseFault::Truncated => "the list ends within a service".to_owned(),
            ResponseFault::NotServices => "the answer does not begin with 0x02".to_owned(),
            fault => fault.to_string(),
        });
        let fault = fault.or_else(|| index_fault(message));
        if let Some(text) = fault {
            self.records.add(Rule::ServicesFormat, Sample::Broken, text, &exchange.frames);
        } else {
            self.services = Some(message.clone());
            let count = counted(response.services().count() as u64, "service");
            let text = format!("{count}, {}", counted(message.len() as u64, "byte"));
            self.records.add(Rule::ServicesFormat, Sample::Kept, text, &[]);
        }
    }

    /// Compares an answer with that before the reboot.
    fn judge_reboot(&mut self, kind: u8, exchange: &Exchange) {
        let rule = Rule::StableOverReboot;
        let Some(IdentityBefore { name, services }) = &self.before else { return };
        let (before, after, what) = if kind == TYPE_NAME {
            (name, &self.name, "name")
        } else {
            (services, &self.services, "list of services")
        };
        let is_whole = exchange.answers.iter().any(|it| it.message.is_some());
        let (sample, text) = match (before, after) {
            (Some(before), Some(after)) if is_whole && before == after => {
                (Sample::Kept, "the same name and services".to_owned())
            }
            (Some(_), Some(_)) if is_whole => (Sample::Broken, format!("another {what}")),
            _ => (Sample::Unsure, format!("its {what} was not received")),
        };
        self.records.add(rule, sample, text, &exchange.frames);
    }

    /// Judges the heartbeats of the time in which the bus was loaded.
    pub(super) fn judge_load(&mut self) {
        let Some(load) = &self.load else { return };
        let rules = [Rule::AnswersUnderLoad, Rule::HeartbeatUnderLoad];
        let percent = 100.0 * load.load(self.now);
        if !load.is_enough(self.now) {
            for rule in rules {
                self.records.clear(rule);
                let text = format!("the bus load was only {percent:.0} %");
                self.records.add(rule, Sample::Unsure, text, &[]);
            }
            return;
        }
        let is_there = self.records.counts(Rule::AnswersUnderLoad).0 > 0;
        let is_sure = is_there && self.observer.is_sure_since(self.loaded_at);
        let mut records = std::mem::replace(&mut self.records, Records::new());
        if is_sure && self.observer.has_no_heartbeat_since(self.loaded_at) {
            // It answers, so it is on the bus.
            let rule = Rule::HeartbeatUnderLoad;
            let time = self.now.since(self.loaded_at).as_secs_f64();
            records.depends_on(rule, &[ProfileKey::Heartbeat], &self.setup.profile);
            records.add(rule, Sample::Broken, format!("no heartbeat for {time:.1} s"), &[]);
        } else {
            self.observer.judge_interval(Rule::HeartbeatUnderLoad, &mut records);
        }
        self.records = records;
    }

    fn judge_transfer(&mut self, test: TransferTest, exchange: &Exchange) {
        let facts = exchange.facts;
        if facts.first_frames == 0 || facts.flows == 0 && facts.early == 0 {
            return;
        }
        let (mut sample, what) = transfer_sample(test, facts);
        let is_absence = test == TransferTest::Wait && facts.during_wait == 0;
        if is_absence && sample == Sample::Broken && !self.is_sure(exchange) {
            sample = Sample::Unsure;
        }
        self.records.add(test.rule(), sample, what, &exchange.frames);
    }

    fn judge_surplus(&mut self, exchange: &Exchange) {
        let facts = exchange.facts;
        let is_whole = exchange.answers.iter().all(|it| it.message.is_some());
        let is_sure = self.is_alone(exchange) && self.is_sure(exchange);
        if facts.surplus == 0 || !is_whole || !is_sure {
            return;
        }
        let text = format!("{} behind the last one", counted(facts.surplus.into(), "frame"));
        self.records.add(Rule::TransferFraming, Sample::Broken, &*text, &exchange.frames);
        if exchange.is_endless() {
            // It leaves no room for answers.
            self.records.add(Rule::TransferFraming, Sample::Broken, text, &exchange.frames);
            self.silence = Some("a transfer of the device does not end".to_owned());
        }
    }

    /// Transfers that always break are broken by the device; else frames were lost on the way.
    pub(super) fn judge_transfers(&self, records: &mut Records) {
        let rule = Rule::TransferFraming;
        if self.whole_transfers > 0 {
            let text = counted(u64::from(self.whole_transfers), "whole transfer");
            records.add(rule, Sample::Kept, text, &[]);
        } else if let Some((text, frames)) = self.broken_transfers.last() {
            // Lost frames break them at different places.
            let equal = self.broken_transfers.iter().filter(|(other, _)| other == text).count();
            let is_proven = equal >= BROKEN_TRANSFERS && self.observer.lost_frames() == 0;
            let text = format!("no transfer came whole: {text}");
            for _ in 0..2 {
                let sample = if is_proven { Sample::Broken } else { Sample::Unsure };
                records.add(rule, sample, text.clone(), frames);
            }
        } else if self.has_answered {
            let text = "all answers fit one frame";
            records.add(rule, Sample::Unsure, text, &[]);
        }
    }

    /// Times of the answers, in the text of the rules that are kept.
    pub(super) fn describe_times(&self, records: &mut Records) {
        let Some(times) = self.latency() else { return };
        let [least, mean, most] = times.map(|it| it.as_secs_f64() * 1e3);
        for rule in [Rule::AnswersName, Rule::AnswersBroadcast, Rule::AnswersServices] {
            let count = counted(u64::from(records.counts(rule).0), "answer");
            let times = format!("{least:.1} to {most:.1} ms, mean {mean:.1} ms");
            records.describe(rule, format!("{count}; all answers after {times}"));
        }
    }

    /// What a task does to the device; `None` if it cannot be judged: why not is noted.
    pub(super) fn disruption_kind(&mut self, task: ProofTask) -> Option<DisruptionKind> {
        let is_working = self.observer.is_working()?;
        let rule = match task {
            ProofTask::Displace { from_non_working } => displace_rule(is_working, from_non_working),
            ProofTask::Occupy => Rule::ResolvesAnew,
            _ => Rule::ModeChanges,
        };
        let longest = self.setup.profile.heartbeat.period().as_secs_f64() * REGULAR_PERIODS;
        let is_regular = self.intervals.is_some_and(|[.., most]| most < longest);
        let gives_way = displace_rule(is_working, false);
        let why = if task == ProofTask::Occupy && self.records.counts(gives_way).0 == 0 {
            Some("it was not seen to give way")
        } else if task == ProofTask::ChangeMode && !self.setup.profile.is_given(ProfileKey::Mode) {
            Some("the number of the command is assumed: give commands.mode")
        } else if !is_regular {
            Some("its heartbeats are too irregular")
        } else {
            None
        };
        if let Some(why) = why {
            self.records.add(rule, Sample::Unsure, why, &[]);
            return None;
        }
        Some(match task {
            ProofTask::Displace { from_non_working } => {
                DisruptionKind::Displace { from_non_working }
            }
            ProofTask::Occupy => DisruptionKind::Occupy,
            _ => DisruptionKind::SetMode(if is_working { Mode::Cfg } else { Mode::Work }),
        })
    }

    /// Judges what the device did.
    pub(super) fn judge_disruption(&mut self, disruption: &Disruption) {
        let is_sure = disruption.sent_at.is_some_and(|at| self.observer.is_sure_since(at));
        let is_back = disruption.returned.is_some();
        let (rule, sample, text) = match disruption.kind {
            DisruptionKind::Displace { from_non_working } => {
                displace_sample(disruption, from_non_working)
            }
            DisruptionKind::Occupy => {
                let sample = if disruption.heartbeat.is_some() {
                    (Sample::Broken, "sends heartbeats from an address that another node uses")
                } else if is_back {
                    (Sample::Kept, "does not use the address, and is back")
                } else {
                    (Sample::Unsure, "is not back on the bus")
                };
                (Rule::ResolvesAnew, sample.0, sample.1)
            }
            DisruptionKind::SetMode(_) => {
                let is_refused = disruption
                    .answer
                    .and_then(|it| it.platform_id())
                    .is_some_and(|id| !Header::decode(id).no_error);
                let sample = match (disruption.heartbeat, disruption.answer) {
                    (Some(_), _) => (Sample::Kept, "its U changed with the mode"),
                    (None, Some(_)) if !is_refused => {
                        (Sample::Broken, "confirmed the command, and its U did not change")
                    }
                    (None, Some(_)) => (Sample::Unsure, "refused the command"),
                    (None, None) => (Sample::Unsure, "did not answer the command"),
                };
                (Rule::ModeChanges, sample.0, sample.1)
            }
        };
        let (sample, text) = if is_sure || sample == Sample::Unsure {
            (sample, text)
        } else {
            (Sample::Unsure, "frames were lost, or the bus did not take them")
        };
        self.records.add(rule, sample, text, &disruption.frames);
        let is_gone = !is_back
            && disruption.heartbeat.is_none()
            && !matches!(disruption.kind, DisruptionKind::SetMode(_));
        if is_gone {
            self.silence = Some("the device did not come back".to_owned());
        }
    }

    /// Takes the answer to the name request after a test.
    fn handle_control(
        &mut self,
        task: ProofTask,
        attempt: usize,
        exchange: &Exchange,
        is_sure: bool,
    ) {
        let is_alive = exchange.answers.iter().any(ReceivedAnswer::is_response);
        let is_repeatable = task.may_stop_device() && !self.is_repeated;
        let is_heard = is_alive || is_repeatable && self.is_heard_again(exchange);
        if !is_alive && attempt + 1 < Self::controls()
            || !is_heard && is_repeatable && self.may_be_heard_again()
        {
            self.stage = TaskStage::Control(attempt + 1);
            return;
        }
        let Some(tested) = self.tested.take() else { return self.end_task() };
        let was_away = is_alive && attempt >= AWAY_CONTROLS;
        let has_failed = was_away || !is_alive && self.is_silence_sure(&tested);
        match task {
            _ if is_repeatable && is_heard && has_failed => {
                // It may have been a coincidence.
                self.is_repeated = true;
                self.stage = TaskStage::Test(0);
                return;
            }
            ProofTask::Malformed(at) => {
                let what = MALFORMED[at].1;
                self.judge_survival(Rule::SurvivesMalformed, what, (is_alive, was_away), &tested);
            }
            ProofTask::Endless => {
                let what = "a request that does not end";
                self.judge_survival(Rule::SurvivesEndless, what, (is_alive, was_away), &tested);
            }
            _ => self.judge_silent_test(task, is_alive, &tested),
        }
        if !is_alive {
            let why = match is_sure {
                true => "the device stopped answering",
                false if self.is_away() => "the device left the bus",
                false => "frames may be lost: silence of the device is not sure",
            };
            self.silence = Some(why.to_owned());
        }
        self.end_task();
    }

    /// Returns true if a device that did not answer a control sends heartbeats, and for so long that it does
    /// not resolve its address.
    fn is_heard_again(&self, control: &Exchange) -> bool {
        let settled = self.setup.profile.heartbeat.period() * SETTLED_PERIODS;
        !self.is_away() && self.observer.is_present_for(self.now, settled, control.asked_at)
    }

    /// Returns true while a device that has stopped answering may be heard again.
    fn may_be_heard_again(&self) -> bool {
        let longest = RETURN_TIME.max(self.setup.profile.heartbeat.period() * SETTLED_PERIODS);
        self.tested.as_ref().is_some_and(|it| self.now.since(it.asked_at) < longest)
    }

    /// Returns true if silence after a test is not one of the bus. That the device is away is the question.
    fn is_silence_sure(&self, tested: &Exchange) -> bool {
        !tested.is_unsent()
            && !tested.is_disturbed
            && self.observer.is_sure_since(tested.asked_at - LOSS_MEMORY)
    }

    fn judge_survival(
        &mut self,
        rule: Rule,
        what: &str,
        (is_alive, was_away): (bool, bool),
        tested: &Exchange,
    ) {
        let (sample, text) = if is_alive && !(was_away && self.is_repeated) {
            (Sample::Kept, "answers afterwards".to_owned())
        } else if is_alive {
            (Sample::Broken, format!("no answer for seconds after {what}, twice"))
        } else if !self.is_silence_sure(tested) {
            (Sample::Unsure, self.why_unsure(tested))
        } else if self.is_repeated {
            (Sample::Broken, format!("no answer any more after {what}, twice"))
        } else {
            let text = format!("not heard again after {what}: stopped by it, or switched off");
            (Sample::Unsure, text)
        };
        if sample == Sample::Unsure {
            // That it survived the requests before does not count: this one may have stopped it.
            self.records.clear(rule);
        }
        self.records.add(rule, sample, text, &tested.frames);
    }

    /// Judges a request that the device must not answer, or not as it answers others.
    fn judge_silent_test(&mut self, task: ProofTask, is_alive: bool, tested: &Exchange) {
        let frames = &tested.frames;
        let is_alone = self.is_alone(tested) && !tested.is_unsent();
        let is_reserved = matches!(task, ProofTask::Reserved { .. });
        // A refusal may have an error code that looks like a type.
        let is_answer =
            |it: &&ReceivedAnswer| it.is_response() && (it.header.no_error || !is_reserved);
        let response = tested.answers.iter().find(is_answer);
        let is_other_flag = matches!(task, ProofTask::OtherFlag { .. });
        if is_other_flag && response.is_some_and(|it| fits_flag(tested, it)) {
            let text = "its mode changed meanwhile";
            return self.records.add(Rule::OwnDFlag, Sample::Unsure, text, &[]);
        }
        let (rule, text, kept) = match task {
            ProofTask::OtherFlag { .. } => (
                Rule::OwnDFlag,
                "answers a request to the other modes",
                "no answer to requests to the other modes",
            ),
            ProofTask::OtherAddress => (
                Rule::OnlyOwnRequests,
                "answers a request to another address",
                "no answer to requests to another address",
            ),
            ProofTask::Reserved { kind, is_broadcast } => {
                if !is_broadcast && response.is_none() {
                    self.judge_refusal(kind, is_alone, tested);
                }
                (
                    Rule::ReservedNotAnswered,
                    "answers a reserved request type",
                    "no name or services response to reserved request types",
                )
            }
            _ => return,
        };
        if response.is_some() && is_alone {
            self.records.add(rule, Sample::Broken, text, frames);
        } else if is_alive && is_alone {
            self.records.add(rule, Sample::Kept, kept, &[]);
        } else {
            self.records.add(rule, Sample::Unsure, self.why_unsure(tested), &[]);
        }
    }

    fn judge_refusal(&mut self, kind: u8, is_alone: bool, tested: &Exchange) {
        let rule = Rule::ReservedRefused;
        let frames: &[Frame] = &tested.frames;
        match tested.answers.first() {
            Some(answer) if !answer.header.no_error => {
                let text = format!("refused type {kind:#04X} with {}", answer.frame);
                self.records.add(rule, Sample::Kept, text, frames);
            }
            Some(answer) if is_alone => {
                let text = format!("answered type {kind:#04X} with {}", answer.frame);
                self.records.add(rule, Sample::Broken, text, frames);
            }
            _ => {
                let text = "silence: a lost frame, or a device that cannot";
                self.records.add(rule, Sample::Unsure, text, &[]);
            }
        }
    }
}

/// Returns true if the D flag of a request is that of the mode in which the device answered.
fn fits_flag(exchange: &Exchange, answer: &ReceivedAnswer) -> bool {
    let request = exchange.frames.iter().find(|it| it.is_tx).and_then(Frame::platform_id);
    request.is_some_and(|id| Header::decode(id).to_non_working == answer.header.from_non_working)
}

/// The rule that a frame from the address of a device is about.
const fn displace_rule(is_working: bool, from_non_working: bool) -> Rule {
    match (is_working, from_non_working) {
        (true, true) => Rule::KeepsAddressWorking,
        (true, false) => Rule::GivesWayWorking,
        (false, _) => Rule::GivesWayConfiguring,
    }
}

fn displace_sample(
    disruption: &Disruption,
    from_non_working: bool,
) -> (Rule, Sample, &'static str) {
    let rule = displace_rule(disruption.was_working, from_non_working);
    let is_kept = disruption.heartbeat.is_some();
    let (sample, text) = match (rule, is_kept, disruption.returned.is_some()) {
        (Rule::KeepsAddressWorking, true, _) => (Sample::Kept, "went on"),
        (Rule::KeepsAddressWorking, false, true) => (Sample::Broken, "gave its address up"),
        (_, true, _) => (Sample::Broken, "went on sending heartbeats from its address"),
        (_, false, true) => (Sample::Kept, "was silent for 1.4 periods, then came back"),
        (_, false, false) => (Sample::Unsure, "is not back on the bus"),
    };
    (rule, sample, text)
}

/// What a test of flow control shows.
fn transfer_sample(test: TransferTest, facts: FlowFacts) -> (Sample, String) {
    let broken = |count: u32, where_: &str| {
        (Sample::Broken, format!("{} {where_}", counted(count.into(), "consecutive frame")))
    };
    let kept = |text: &str| (Sample::Kept, text.to_owned());
    match test {
        TransferTest::Hold if facts.early > 0 => broken(facts.early, "before flow control"),
        TransferTest::Hold => kept("waited for flow control"),
        _ if facts.early > 0 => (Sample::Unsure, "does not wait for flow control".to_owned()),
        TransferTest::BlockSize if facts.beyond_block > 0 => {
            broken(facts.beyond_block, "behind a block of 2")
        }
        TransferTest::BlockSize if facts.whole_blocks > 0 => {
            let blocks = counted(facts.whole_blocks.into(), "block");
            (Sample::Kept, format!("{blocks} of 2 frames"))
        }
        TransferTest::BlockSize => (Sample::Unsure, "no block was whole".to_owned()),
        TransferTest::StMin if facts.block_intervals > 0 => st_min_sample(facts),
        TransferTest::StMin => (Sample::Unsure, "one consecutive frame only".to_owned()),
        TransferTest::Wait if facts.during_wait > 0 => broken(facts.during_wait, "after WAIT"),
        TransferTest::Wait if facts.continued == 0 => {
            (Sample::Broken, "no frame after CONTINUE that followed WAIT".to_owned())
        }
        TransferTest::Wait => kept("waited, and went on"),
        TransferTest::Overflow if facts.after_overflow > 0 => {
            broken(facts.after_overflow, "after OVERFLOW")
        }
        TransferTest::Timeout if facts.continued > 0 => {
            broken(facts.continued, "after flow control that came 2.5 s late")
        }
        TransferTest::Overflow | TransferTest::Timeout => kept("ended the transfer"),
    }
}

fn st_min_sample(facts: FlowFacts) -> (Sample, String) {
    let mean = facts.block_time / facts.block_intervals;
    let wanted = Duration::from_millis(TEST_ST_MIN.into());
    let text = format!("{:.1} ms between frames, STmin {TEST_ST_MIN} ms", mean.as_secs_f64() * 1e3);
    let is_kept = mean >= wanted.mul_f64(ST_MIN_PART);
    (if is_kept { Sample::Kept } else { Sample::Broken }, text)
}

/// What is wrong with the indices of a list of services with two strings each; `None` if nothing is, or
/// the list has another form.
fn index_fault(message: &[u8]) -> Option<String> {
    let mut rest = message.get(1..)?;
    let mut indices = Vec::new();
    while let Some((index, strings)) = rest.split_first() {
        indices.push(*index);
        let mut ends = strings.iter().enumerate().filter(|(_, byte)| **byte == 0);
        let (end, _) = ends.nth(1)?;
        rest = &strings[end + 1..];
    }
    let at = indices.iter().enumerate().find(|(at, index)| **index as usize != *at)?;
    // A printable one is the begin of a further string.
    let (at, index) = (at.0, *at.1);
    let is_index = (1..0x20).contains(&index) || indices.iter().all(|it| *it == 0);
    is_index.then(|| format!("service {at} has the index {index}"))
}
