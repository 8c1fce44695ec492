//! `descan profile learn`: values of the profile that the frames of a bus or of a log show. Sends
//! nothing.

use super::gate::BusGate;
use super::headless::{self, Limits, RunInput, RunOutcome, warn_foreign};
use super::open::{self, Setup};
use super::output::{answer, ask, may_ask, say};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::app::{App, AppOptions};
use crate::cli::{CommonArgs, LearnArgs};
use crate::diagnostic::Diagnostic;
use crate::frame::{BusIndex, Frame};
use crate::learning::{
    Certainty, DesSearch, LEARNT_KEYS, ProfileLearner, ProfileProposal, SearchEnd,
};
use crate::shell::log_input::LogPace;
use crate::shell::stop::StopReason;
use crate::shell::store::{Store, write_new};
use crate::text::{counted, printable_path};
use crate::time::{Epoch, Instant};
use crate::wire::id::{Address, Service};
use crate::wire::profile::{Profile, ProfileKey, ProfileValue, ValueOrigin};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

/// `--time` of a live bus, unless given.
const DEFAULT_TIME: Duration = Duration::from_secs(20);
/// Time in which a bus is listened to before a search: what else it carries.
const SEARCH_LISTENING: Duration = Duration::from_secs(8);
/// Requests after which the progress of a search is told.
const TOLD_REQUESTS: usize = 400;
/// Values that end listening on a live bus: others may never be shown.
const ENOUGH: [ProfileKey; 5] = [
    ProfileKey::Heartbeat,
    ProfileKey::PeriodMs,
    ProfileKey::UidOffset,
    ProfileKey::ModeOffset,
    ProfileKey::Des,
];

/// Runs it.
pub fn run(learn: &LearnArgs) -> Result<u8, Failure> {
    if let Some(path) = &learn.write {
        Store::new(path).check_new().map_err(|fault| fault.of(printable_path(path)))?;
    }
    let mut common = CommonArgs::listen_only(learn.profile.clone());
    if learn.search.is_some() {
        // No request but those of the search.
        (common.listen_only, common.no_scan) = (false, true);
    }
    let setup = Setup::new(&common)?;
    let bus = std::slice::from_ref(&learn.bus);
    let is_log = open::log(bus, "profile learn", learn.from)?.is_some();
    let mut search = SearchStep::new(learn, is_log)?;
    let input = if is_log {
        RunInput::Log(&learn.bus, Some(LogPace::AtOnce))
    } else {
        RunInput::Buses(bus)
    };
    let time = learn.time.or((!is_log).then_some(DEFAULT_TIME));
    // A search ends by itself.
    let time = time.filter(|_| learn.search.is_none());
    let limits = Limits { time, from: learn.from, stuck: EXIT_INTERRUPTED, ..Limits::default() };
    let options = AppOptions { learns_profile: true, ..AppOptions::default() };
    let mut gate = BusGate::new(false);
    let mut looked_at = 0;
    let RunOutcome { app, ending, recording, .. } =
        headless::run(input, &setup, options, limits, |session| {
            let now = session.now();
            if is_log {
                return Ok(ControlFlow::Continue(()));
            }
            let is_open = gate.allows(&session.app, now)?;
            if let Some(device) = learn.search {
                let from = learn.search_from.unwrap_or_default();
                let task = SearchTask { device, from, yes: learn.yes };
                let is_over = is_open && search.advance(&mut session.app, task)?;
                return Ok(if is_over {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                });
            }
            // Proposals are made from all that was heard: once a second.
            let second = now.as_micros() / 1_000_000;
            let is_due = is_open && std::mem::replace(&mut looked_at, second) != second;
            let is_enough = is_due && learners(&session.app).any(|(_, it)| knows_enough(it));
            Ok(if is_enough { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
        })?;
    if ending == Some(StopReason::Interrupted) {
        return Ok(EXIT_INTERRUPTED);
    }
    if !is_log {
        gate.require_opened(&app)?;
    }
    recording?;
    warn_foreign(&app, &mut Vec::new());
    if matches!(search, SearchStep::Refused) {
        return Ok(EXIT_FINDINGS);
    }
    let end = app.des_search().and_then(DesSearch::end);
    if let Some(end) = end {
        say(end_text(end));
    }
    let mut buses: Vec<LearntBus> = learners(&app)
        .map(|(bus, learner)| LearntBus::new(&app, bus, learner, &setup.config.profile))
        .collect();
    if let Some(SearchEnd::Answered { service, is_des: true }) = end {
        for bus in &mut buses {
            bus.note_found(*service);
        }
    }
    if learn.json {
        let search = learn.search.zip(app.des_search()).zip(end);
        let search =
            search.map(|((device, search), end)| DesSearchReport::new(device, search, end));
        let report = LearnReport { descan: env!("CARGO_PKG_VERSION"), buses: &buses, search };
        let json = serde_json::to_string_pretty(&report).map_err(anyhow::Error::from)?;
        output::print_json(&(json + "\n"))?;
    } else {
        output::print(&text(&buses))?;
    }
    if let Some(path) = &learn.write {
        write(path, &buses, &setup.config.profile)?;
    }
    let has_any = buses.iter().any(|bus| !bus.proposals.is_empty());
    Ok(if has_any { EXIT_OK } else { EXIT_FINDINGS })
}

/// How far a search is.
enum SearchStep {
    /// The bus is listened to: what else it carries, and whether the device works.
    Listening(Option<Instant>),
    /// The user is asked.
    Asking(Receiver<bool>),
    /// It runs; with the part that was told.
    Running(usize),
    /// The user refused it.
    Refused,
}

/// What is searched: the device, the first service, without a question.
#[derive(Clone, Copy)]
struct SearchTask {
    device: Address,
    from: Service,
    yes: bool,
}

impl SearchStep {
    fn new(learn: &LearnArgs, is_log: bool) -> Result<Self, Failure> {
        if learn.search.is_some() && is_log {
            return Err(Failure::Usage("a log has no device to ask".to_owned()));
        }
        if learn.search.is_some() && !learn.yes && !may_ask() {
            let text = "the search asks before it sends, and there is no terminal: give --yes";
            return Err(Failure::Usage(text.to_owned()));
        }
        Ok(Self::Listening(None))
    }

    /// Takes the next step, if it is time for it; returns true once it is over.
    fn advance(&mut self, app: &mut App, task: SearchTask) -> Result<bool, Failure> {
        let SearchTask { device, yes, .. } = task;
        let (bus, now) = (BusIndex(0), app.now());
        match self {
            Self::Listening(began) => {
                let began = *began.get_or_insert(now);
                if now.since(began) < SEARCH_LISTENING {
                    return Ok(false);
                }
                let is_known = |learner: &ProfileLearner| {
                    learner.proposals().iter().any(|it| it.key == ProfileKey::Des)
                };
                if app.profile_learner(bus).is_some_and(is_known) {
                    say("no search: the service number of DES is known from other requests");
                    return Ok(true);
                }
                if let Some(why) = app.search_obstacle(bus, device) {
                    return Err(Failure::Unusable(why));
                }
                let question = format!(
                    "Ask the device at {device} for its name on up to 1024 services, in two minutes? It \
                     may take a request for a command: restart, change its settings, move what it \
                     controls. It stops at the first answer."
                );
                *self = if yes {
                    say(question.replace('?', "."));
                    start_search(app, task)?
                } else {
                    ask(format!("{question} [y/N]"));
                    Self::Asking(answer())
                };
            }
            Self::Asking(answer) => match answer.try_recv() {
                Ok(true) => *self = start_search(app, task)?,
                Ok(false) | Err(TryRecvError::Disconnected) => {
                    say("nothing was sent");
                    *self = Self::Refused;
                    return Ok(true);
                }
                Err(TryRecvError::Empty) => {}
            },
            Self::Running(told) => {
                let Some(search) = app.des_search() else { return Ok(true) };
                let (sent, all) = search.progress();
                if sent >= *told + TOLD_REQUESTS {
                    *told = sent;
                    say(format!("{sent} of {all} requests sent, no answer"));
                }
                return Ok(search.end().is_some());
            }
            Self::Refused => return Ok(true),
        }
        Ok(false)
    }
}

fn start_search(app: &mut App, task: SearchTask) -> Result<SearchStep, Failure> {
    app.start_des_search(BusIndex(0), task.device, task.from).map_err(Failure::Unusable)?;
    Ok(SearchStep::Running(0))
}

fn end_text(end: &SearchEnd) -> String {
    match end {
        SearchEnd::Answered { service, is_des: true } => {
            format!("answered with a DES response on service {service}")
        }
        SearchEnd::Answered { service, is_des: false } => {
            format!(
                "stopped: answered on service {service}, with no DES response; go on behind it with \
                 --search-from"
            )
        }
        SearchEnd::Exhausted => "the device answered on no service".to_owned(),
        SearchEnd::Stopped(why) => format!("stopped: {why}"),
    }
}

fn learners(app: &App) -> impl Iterator<Item = (BusIndex, &ProfileLearner)> {
    let buses = (0..app.buses().len()).map(|at| BusIndex(at as u8));
    buses.filter_map(|bus| Some((bus, app.profile_learner(bus)?)))
}

fn knows_enough(learner: &ProfileLearner) -> bool {
    let proposals = learner.proposals();
    ENOUGH.iter().all(|key| {
        let mut certain = proposals.iter().filter(|it| it.certainty == Certainty::Certain);
        certain.any(|it| it.key == *key)
    })
}

#[derive(Serialize)]
struct LearnReport<'a> {
    descan: &'static str,
    buses: &'a [LearntBus],
    search: Option<DesSearchReport>,
}

/// How a search ended.
#[derive(Serialize)]
struct DesSearchReport {
    device: u8,
    outcome: &'static str,
    /// The service that was answered.
    service: Option<u16>,
    requests: usize,
    text: String,
}

impl DesSearchReport {
    fn new(device: Address, search: &DesSearch, end: &SearchEnd) -> Self {
        let (outcome, service) = match end {
            SearchEnd::Answered { service, is_des: true } => ("found", Some(service.number())),
            SearchEnd::Answered { service, is_des: false } => ("other", Some(service.number())),
            SearchEnd::Exhausted => ("not-found", None),
            SearchEnd::Stopped(_) => ("stopped", None),
        };
        let (requests, _) = search.progress();
        Self { device: device.number(), outcome, service, requests, text: end_text(end) }
    }
}

/// What was learnt from one bus.
#[derive(Serialize)]
struct LearntBus {
    name: String,
    frames: u64,
    seconds: f64,
    proposals: Vec<LearntValue>,
    unknown: Vec<UnknownValue>,
}

#[derive(Serialize)]
struct LearntValue {
    key: &'static str,
    value: ProfileValue,
    /// The value in force, and its origin.
    now: ProfileValue,
    origin: &'static str,
    certainty: &'static str,
    evidence: String,
    frames: Vec<EvidenceFrame>,
    #[serde(skip)]
    proposal: ProfileProposal,
}

#[derive(Serialize)]
struct EvidenceFrame {
    time: f64,
    frame: String,
}

#[derive(Serialize)]
struct UnknownValue {
    key: &'static str,
    now: ProfileValue,
    origin: &'static str,
    reason: String,
}

impl LearntBus {
    fn new(app: &App, bus: BusIndex, learner: &ProfileLearner, profile: &Profile) -> Self {
        let name = app.buses().get(usize::from(bus.0)).map(|bus| bus.name.clone());
        let proposals: Vec<LearntValue> = learner
            .proposals()
            .into_iter()
            .map(|proposal| LearntValue::new(proposal, profile, app.epoch()))
            .collect();
        let is_unknown = |key: &&ProfileKey| !proposals.iter().any(|it| it.key == key.name());
        let unknown = LEARNT_KEYS
            .iter()
            .filter(is_unknown)
            .map(|key| UnknownValue {
                key: key.name(),
                now: profile.value(*key),
                origin: profile.origin(*key).word(),
                reason: learner.why_unknown(*key),
            })
            .collect();
        Self {
            name: name.unwrap_or_default(),
            frames: learner.frames(),
            seconds: learner.duration().as_secs_f64(),
            proposals,
            unknown,
        }
    }
}

impl LearntBus {
    /// Takes a service on which a device answered a name request of the search: a name there is no
    /// accident.
    fn note_found(&mut self, service: Service) {
        let value = ProfileValue::Service(service.number());
        let is_it = |it: &&mut LearntValue| it.proposal.key == ProfileKey::Des && it.value == value;
        for learnt in self.proposals.iter_mut().filter(is_it) {
            let proposal = &mut learnt.proposal;
            proposal.certainty = proposal.certainty.max(Certainty::Likely);
            proposal.evidence.push_str(", by the search");
            learnt.certainty = proposal.certainty.word();
            learnt.evidence.clone_from(&proposal.evidence);
        }
    }
}

impl LearntValue {
    fn new(proposal: ProfileProposal, profile: &Profile, epoch: Epoch) -> Self {
        let frame = |frame: &Frame| EvidenceFrame {
            time: epoch.unix_secs(frame.time),
            frame: frame.to_string(),
        };
        Self {
            key: proposal.key.name(),
            value: proposal.value.clone(),
            now: profile.value(proposal.key),
            origin: profile.origin(proposal.key).word(),
            certainty: proposal.certainty.word(),
            evidence: proposal.evidence.clone(),
            frames: proposal.frames.iter().map(frame).collect(),
            proposal,
        }
    }
}

/// `≠` where the value in force is another one.
fn mark(value: &LearntValue) -> &'static str {
    if value.value == value.now { " " } else { "≠" }
}

/// Returns true for the same value, and for periods of clocks that differ by two parts in a hundred.
fn is_same(one: &ProfileValue, other: &ProfileValue) -> bool {
    match (one, other) {
        (ProfileValue::Number(a), ProfileValue::Number(b)) => a.abs_diff(*b) * 50 <= *a,
        _ => one == other,
    }
}

fn text(buses: &[LearntBus]) -> String {
    let mut text = String::new();
    if buses.is_empty() {
        text.push_str("no frame was received\n");
    }
    for bus in buses {
        let (frames, seconds) = (counted(bus.frames, "frame"), bus.seconds);
        let _ = writeln!(text, "{}: {frames} in {seconds:.1} s", bus.name);
        let now = |value: &ProfileValue, origin: &str| format!("{value} {origin}");
        let nows = bus.proposals.iter().map(|it| now(&it.now, it.origin));
        let nows = nows.chain(bus.unknown.iter().map(|it| now(&it.now, it.origin)));
        let width = nows.map(|it| it.len()).max().unwrap_or_default().max(3);
        let _ = writeln!(
            text,
            "  {:<22} {:<width$}   {:<7} {:<7} EVIDENCE",
            "KEY", "NOW", "LEARNT", "SURE"
        );
        for key in LEARNT_KEYS.map(ProfileKey::name) {
            if let Some(value) = bus.proposals.iter().find(|it| it.key == key) {
                let LearntValue { certainty, evidence, origin, .. } = value;
                let (now, learnt) = (now(&value.now, origin), value.value.to_string());
                let mark = mark(value);
                let _ = writeln!(
                    text,
                    "  {key:<22} {now:<width$} {mark} {learnt:<7} {certainty:<7} {evidence}"
                );
            } else if let Some(value) = bus.unknown.iter().find(|it| it.key == key) {
                let UnknownValue { origin, reason, .. } = value;
                let now = now(&value.now, origin);
                let _ = writeln!(text, "  {key:<22} {now:<width$}   –       –       {reason}");
            }
        }
    }
    text
}

/// Writes the learnt values, with those that the profile gives.
fn write(path: &Path, buses: &[LearntBus], before: &Profile) -> Result<(), Failure> {
    let mut profile = before.clone();
    let mut comments: Vec<(ProfileKey, String)> = Vec::new();
    for bus in buses {
        for LearntValue { proposal, .. } in &bus.proposals {
            let key = proposal.key;
            if before.is_given(key) {
                if before.value(key) != proposal.value {
                    let (given, learnt) = (before.value(key), &proposal.value);
                    output::warn(format_args!(
                        "{}: {given} of --profile is kept; frames show {learnt}",
                        key.name()
                    ));
                }
                continue;
            }
            let is_other = comments.iter().any(|(known, _)| *known == key)
                && !is_same(&profile.value(key), &proposal.value);
            if is_other {
                let cause = format!("the buses differ in {}", key.name());
                let fault = Diagnostic::new(cause).with_remedy("learn from one bus");
                return Err(fault.of(printable_path(path)).into());
            }
            if proposal.certainty > Certainty::Guess {
                profile.learn(key, &proposal.value);
                let (certainty, evidence) = (proposal.certainty.word(), &proposal.evidence);
                comments.push((key, format!("learnt, {certainty}: {evidence}")));
            }
        }
    }
    let learnt = ProfileKey::ALL.iter().filter(|key| profile.origin(**key) == ValueOrigin::Learnt);
    let learnt = learnt.count();
    let guesses = buses.iter().flat_map(|bus| &bus.proposals);
    let guesses = guesses.filter(|it| it.proposal.certainty == Certainty::Guess);
    if learnt == 0 {
        output::say(format_args!("{}: not written: no value was learnt", printable_path(path)));
        return Ok(());
    }
    let comment = |key| {
        let known = comments.iter().find(|(known, _)| *known == key);
        known.map(|(_, comment)| comment.clone())
    };
    let mut text = profile.to_file(comment);
    for LearntValue { key, value, evidence, .. } in guesses {
        let _ = write!(text, "\n# A guess, not in force: {key} = {value} ({evidence})\n");
    }
    write_new(path, None, |file| file.write_all(text.as_bytes()))
        .map_err(|fault| fault.of(printable_path(path)))?;
    let values = counted(learnt as u64, "value");
    output::say(format_args!("{}: {values} written; use it: --profile {0}", printable_path(path)));
    Ok(())
}
