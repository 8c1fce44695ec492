//! The line of a story: kind, sign, times and words as of a moment.
//!
//! Pure: the steps until the moment in, the line out.

use super::change::StoryChange;
use super::kind::StoryKind;
use super::story::{ATTACH_WITHIN, Story, StoryKey, StoryStep};
use crate::app::lanes::ConflictSpan;
use crate::app::notices::TimelineEntry;
use crate::app::problems::{ProblemKey, length_text};
use crate::app::timeline_kind::TimelineKind;
use crate::discovery::Presence;
use crate::finding::{FindingKey, FindingKind, FindingState};
use crate::frame::BusIndex;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::fmt::Write;

/// Modes of a chain that are named; of more the first one and the last ones.
const NAMED_MODES: usize = 5;
/// Changes of services that are named.
const NAMED_CHANGES: usize = 4;

/// Sign of a story.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StorySign {
    /// A device appeared, or more became known about it.
    Improved,
    /// A device changed.
    Change,
    /// A device is not online.
    Absent(Presence),
    /// A device is online again.
    Returned,
    /// A finding.
    Finding(FindingState),
    /// State of a bus, or the file.
    Plain,
    /// A failure.
    Error,
    /// A mark, with its letter.
    Mark(char),
}

/// The line of a story as of a moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoryLine {
    /// What it is about.
    pub kind: StoryKind,
    /// Sign.
    pub sign: StorySign,
    /// Time of the first step.
    pub from: Instant,
    /// Time of the last step; `None` while the story goes on.
    pub to: Option<Instant>,
    /// What happened, in words.
    pub what: String,
}

/// A finding of a story.
struct FindingStep<'a> {
    key: &'a FindingKey,
    state: FindingState,
    parties: &'a [String],
    text: &'a str,
    since: Option<Instant>,
    until: Instant,
}

/// What the steps of a story say together.
#[derive(Default)]
struct Summary<'a> {
    has_appeared: bool,
    is_named: bool,
    services: Option<usize>,
    versions: Vec<&'a str>,
    uid: Option<(&'a str, &'a str)>,
    modes: Vec<Mode>,
    claim: Option<(&'a StoryStep, Option<&'a str>)>,
    gave_up: Option<(&'a StoryStep, Option<&'a str>)>,
    moves: Vec<Address>,
    has_rebooted: bool,
    /// The worst presence of the last absence.
    absence: Option<Presence>,
    is_absent: bool,
    has_returned: bool,
    findings: Vec<FindingStep<'a>>,
    confirmed: Option<Instant>,
    /// descan has no address, or is not acknowledged.
    is_blocked: bool,
    /// Another log began.
    is_cut: bool,
    last: Option<&'a StoryStep>,
    first_time: Option<Instant>,
    last_time: Instant,
    cycle: u32,
    /// Number of steps, and of their occurrences.
    steps: u32,
    times: u32,
}

impl StoryChange {
    /// Returns true if a story that is over goes on with this change.
    pub(super) fn opens(&self) -> bool {
        match self {
            Self::Finding { state, .. } => *state != FindingState::Cleared,
            Self::Presence(_) | Self::NoAck | Self::NoOwnAddress | Self::Rebooted => true,
            Self::Mode(Some(Mode::Work), to) => *to != Mode::Work,
            _ => false,
        }
    }
}

impl<'a> Summary<'a> {
    fn of(steps: impl Iterator<Item = &'a StoryStep>, at: Instant) -> Self {
        let mut summary = Self::default();
        for step in steps {
            summary.add(step);
            summary.last_time = summary.last_time.max(step.last(at));
            summary.steps += 1;
            summary.times = summary.times.saturating_add(step.times(at));
        }
        summary
    }

    fn add(&mut self, step: &'a StoryStep) {
        self.cycle = step.cycle;
        self.first_time.get_or_insert(step.entry.time);
        match &step.change {
            StoryChange::Appeared => self.has_appeared = true,
            StoryChange::Named => self.is_named = true,
            StoryChange::Services(count) => self.services = Some(*count),
            StoryChange::Versions(text) => self.versions.push(text),
            StoryChange::Uid(from, to) => self.uid = Some((from, to)),
            StoryChange::Mode(from, to) => {
                if self.modes.is_empty() {
                    self.modes.extend(*from);
                }
                self.modes.push(*to);
            }
            StoryChange::Claimed { holder, .. } => self.claim = Some((step, holder.as_deref())),
            StoryChange::GaveUp { to, .. } => self.gave_up = Some((step, to.as_deref())),
            StoryChange::Moved(from, to) => {
                if self.moves.last() != Some(from) {
                    self.moves.push(*from);
                }
                self.moves.push(*to);
                self.is_absent = false;
            }
            StoryChange::Rebooted => (self.has_rebooted, self.is_absent) = (true, false),
            StoryChange::Presence(presence) => {
                let before = self.absence.filter(|_| self.is_absent);
                self.absence = before.max(Some(*presence));
                (self.is_absent, self.has_returned) = (*presence != Presence::Online, false);
            }
            StoryChange::Returned => (self.is_absent, self.has_returned) = (false, true),
            StoryChange::Finding { key, state, parties, text, since, until } => {
                match state {
                    FindingState::Confirmed => {
                        self.confirmed.get_or_insert(step.entry.time);
                    }
                    FindingState::Suspected if self.is_problem_over() => self.confirmed = None,
                    _ => {}
                }
                let parties = &**parties;
                self.findings.retain(|finding| finding.key != key);
                let (state, since, until) = (*state, *since, (*until).min(step.entry.time));
                self.findings.push(FindingStep { key, state, parties, text, since, until });
            }
            StoryChange::NoOwnAddress | StoryChange::NoAck => self.is_blocked = true,
            StoryChange::OwnAddress(_) | StoryChange::Acknowledged => self.is_blocked = false,
            StoryChange::AnotherLog => self.is_cut = true,
            StoryChange::Text
            | StoryChange::OtherServices
            | StoryChange::Removed
            | StoryChange::Debug(_) => {}
        }
        if step.change != StoryChange::AnotherLog {
            self.last = Some(step);
        }
    }

    /// Time of the end: of a problem its last evidence, as on the Problems page.
    fn end(&self) -> Instant {
        self.findings.iter().map(|finding| finding.until).max().unwrap_or(self.last_time)
    }

    /// Length of the conflict as on the Problems page, where the story began earlier.
    fn own_length(&self) -> Option<Duration> {
        /// The two beginnings are those of one frame and of its finding.
        const SAME: Duration = Duration::from_millis(100);
        let since = self.findings.iter().filter_map(|finding| finding.since).max()?;
        let is_later = since.since(self.first_time?) > SAME;
        (is_later && self.cycle < 2).then(|| self.end().since(since))
    }

    fn is_problem_over(&self) -> bool {
        self.findings.iter().all(|finding| finding.state == FindingState::Cleared)
    }

    /// Returns true if the story goes on at a moment.
    fn is_open(&self, key: &StoryKey, at: Instant) -> bool {
        let is_recent = at.since(self.last_time) < ATTACH_WITHIN;
        let mode = self.modes.last();
        if self.is_cut {
            return false;
        }
        match key {
            StoryKey::Problem(_) if self.findings.is_empty() => {
                self.gave_up.is_none() && is_recent && self.moves.is_empty()
            }
            StoryKey::Problem(_) => !self.is_problem_over(),
            StoryKey::Mode(_) => {
                // The mode of a device that is lost is not known.
                let is_lost = self.is_absent && self.absence == Some(Presence::Lost);
                mode != Some(&Mode::Work) && mode != self.modes.first() && !is_lost
            }
            StoryKey::Device(_) => {
                let is_settling = matches!(mode, Some(Mode::Arslv | Mode::Init | Mode::Boot))
                    || self.has_appeared && !self.is_named;
                self.is_absent || is_settling && is_recent
            }
            StoryKey::Own(_) | StoryKey::Ack(_) => self.is_blocked,
            StoryKey::Text(..) | StoryKey::Debug(..) => false,
        }
    }

    fn kind(&self, key: &StoryKey) -> StoryKind {
        match key {
            StoryKey::Mode(_) => StoryKind::Mode,
            StoryKey::Own(_) => StoryKind::Own,
            StoryKey::Ack(_) => StoryKind::Bus,
            StoryKey::Problem(problem) => self.kind_of_problem(problem),
            StoryKey::Text(..) => self.last.map_or(StoryKind::Own, kind_of_text),
            StoryKey::Debug(..) => StoryKind::Debug,
            StoryKey::Device(_) if self.has_rebooted => StoryKind::Reboot,
            StoryKey::Device(_) if !self.moves.is_empty() => StoryKind::Move,
            StoryKey::Device(_) if self.has_appeared => StoryKind::Join,
            StoryKey::Device(_) if self.absence.is_some() || self.has_returned => {
                StoryKind::Presence
            }
            StoryKey::Device(_) if !self.versions.is_empty() || self.uid.is_some() => {
                StoryKind::Version
            }
            StoryKey::Device(_) if self.claim.is_some() => StoryKind::Move,
            StoryKey::Device(_) => StoryKind::Join,
        }
    }

    fn kind_of_problem(&self, problem: &ProblemKey) -> StoryKind {
        match problem {
            ProblemKey::Address(..) if self.findings.is_empty() => StoryKind::Move,
            ProblemKey::Address(..) => StoryKind::Conflict,
            ProblemKey::Finding(key) if key.kind.is_conflict() => StoryKind::Conflict,
            ProblemKey::Finding(key) if key.kind == FindingKind::BusErrors => StoryKind::Bus,
            ProblemKey::Finding(key) if key.address.is_none() => StoryKind::Bus,
            ProblemKey::Finding(_) => StoryKind::Problem,
        }
    }

    fn sign(&self, key: &StoryKey) -> StorySign {
        let absence = self.absence.filter(|_| self.is_absent).map(StorySign::Absent);
        match key {
            StoryKey::Problem(_) => match self.findings.iter().map(|it| it.state).max() {
                Some(state) => StorySign::Finding(state),
                None => StorySign::Change,
            },
            StoryKey::Mode(_) => absence.unwrap_or(StorySign::Change),
            StoryKey::Own(_) | StoryKey::Ack(_) if self.is_blocked => StorySign::Error,
            StoryKey::Own(_) | StoryKey::Ack(_) => StorySign::Plain,
            StoryKey::Text(..) | StoryKey::Debug(..) => {
                self.last.map_or(StorySign::Plain, |step| sign_of(&step.entry))
            }
            StoryKey::Device(_) => match self.kind(key) {
                _ if absence.is_some() => absence.unwrap_or(StorySign::Change),
                StoryKind::Join => StorySign::Improved,
                StoryKind::Presence => StorySign::Returned,
                _ => StorySign::Change,
            },
        }
    }

    fn what(&self, key: &StoryKey, at: Instant, clock: impl Fn(Instant) -> String) -> String {
        let mut text = match key {
            StoryKey::Problem(ProblemKey::Address(..)) => self.address_words(clock),
            StoryKey::Problem(ProblemKey::Finding(_)) => self.finding_words(),
            StoryKey::Mode(_) => self.mode_words(),
            StoryKey::Device(_) => self.device_words(),
            StoryKey::Own(_) | StoryKey::Ack(_) | StoryKey::Text(..) | StoryKey::Debug(..) => {
                self.last_text()
            }
        };
        let times = match key {
            StoryKey::Debug(..) => self.occurrences(),
            _ => self.last.map_or(1, |step| step.times(at)),
        };
        if times > 1 {
            let _ = write!(text, " ×{times}");
        }
        if self.cycle > 1 {
            let _ = write!(text, ", {} times", self.cycle);
        }
        text
    }

    /// Number of occurrences of all steps; steps that were dropped count once.
    fn occurrences(&self) -> u32 {
        let dropped = self.last.map_or(0, |step| step.number.saturating_sub(self.steps));
        self.times.saturating_add(dropped)
    }

    fn last_text(&self) -> String {
        self.last.map_or_else(String::new, |step| step.entry.text.clone())
    }

    /// The most certain, then most severe finding.
    fn head(&self) -> Option<&FindingStep<'a>> {
        self.findings.iter().max_by_key(|it| (it.state, it.key.kind.facts().severity))
    }

    fn finding_words(&self) -> String {
        let Some(head) = self.head() else { return self.last_text() };
        let state = match head.state {
            FindingState::Cleared => "over",
            other => other.name(),
        };
        let text = if head.text.is_empty() { head.key.wording().headline } else { head.text };
        format!("{state}: {}", text.strip_suffix('.').unwrap_or(text))
    }

    fn address_words(&self, clock: impl Fn(Instant) -> String) -> String {
        let mut parts = Vec::new();
        if let Some((step, to)) = self.gave_up {
            let who = subject(step);
            let to = to.map_or(String::new(), |to| format!(" to {to}"));
            parts.push(format!("{who} gave up {}{to}", address(step)));
        }
        if !self.moves.is_empty() {
            parts.push(format!("moved {}", chain(&self.moves, "→")));
        }
        if let Some(head) = self.head() {
            let parties = self.findings.iter().map(|it| it.parties).max_by_key(|it| it.len());
            // Who gave up to whom is named already.
            let parties = parties.filter(|_| self.gave_up.is_none());
            let parties = parties.unwrap_or_default().join(" / ");
            parts.push(match (parties.is_empty(), head.key.kind.is_conflict()) {
                (true, _) => head.key.wording().headline.to_owned(),
                (false, true) => format!("conflict {parties}"),
                (false, false) => format!("{}: {parties}", head.key.wording().headline),
            });
            match (self.confirmed, head.state) {
                (Some(time), _) => parts.push(format!("confirmed {}", clock(time))),
                (None, FindingState::Cleared) => parts.push("never confirmed".to_owned()),
                (None, state) => parts.push(state.name().to_owned()),
            }
        } else if let (Some((step, holder)), None) = (self.claim, self.gave_up) {
            parts.push(format!("{}claimed {}", by(step), address(step)));
            parts.extend(holder.map(|holder| format!("held by {holder}")));
        }
        parts.extend(self.uid.map(|(from, to)| format!("UID {from}→{to}")));
        if !self.findings.is_empty() && self.is_problem_over() {
            parts.push(match self.own_length() {
                Some(length) => format!("over after {}", length_text(length)),
                None => "over".to_owned(),
            });
        }
        if parts.is_empty() { self.last_text() } else { parts.join(", ") }
    }

    fn mode_words(&self) -> String {
        let modes: Vec<&str> = self.modes.iter().map(|mode| mode.name()).collect();
        let chain = chain(&modes, " → ");
        match self.absence {
            Some(Presence::Asleep) if self.is_absent => format!("asleep (IDLE), {chain}"),
            Some(Presence::Asleep) => format!("was asleep, {chain}"),
            Some(Presence::Lost) if self.is_absent => format!("{chain}, then lost"),
            Some(other) if self.is_absent => format!("{chain}, {other}"),
            _ => chain,
        }
    }

    fn device_words(&self) -> String {
        let mut parts: Vec<String> = Vec::new();
        let claimed = self.claim.map(|(step, _)| step);
        let first = self.moves.first().copied();
        if self.has_appeared {
            let at = first.map(|it| it.to_string());
            let at = at.or_else(|| self.last.map(address)).unwrap_or_default();
            parts.push(match claimed {
                Some(step) => format!("joined at {} (claimed)", address(step)),
                None => format!("appeared at {at}"),
            });
        }
        if let Some(absence) = self.absence {
            parts.push(match absence {
                Presence::Stale if self.is_absent => "stale: heartbeat overdue".to_owned(),
                Presence::Silent if self.is_absent => "silent: frames but no heartbeat".to_owned(),
                other => other.name().to_owned(),
            });
        }
        if self.has_rebooted {
            parts.push("rebooted".to_owned());
        } else if self.has_returned && self.moves.is_empty() {
            parts.push("returned".to_owned());
        }
        if !self.moves.is_empty() {
            parts.push(format!("moved {}", chain(&self.moves, "→")));
        }
        let mut changes: Vec<&str> =
            self.versions.iter().rev().take(NAMED_CHANGES).copied().collect();
        changes.reverse();
        let mut text = parts.join(", ");
        if !changes.is_empty() {
            let label = if text.is_empty() { "services" } else { &*text };
            text = format!("{label}: {}", changes.join(", "));
        }
        if let Some((from, to)) = self.uid {
            let gap = if text.is_empty() { "" } else { ", " };
            let _ = write!(text, "{gap}UID {from}→{to}: another board?");
        }
        if text.is_empty() {
            return self.last_text();
        }
        // Of others the mode is news only where it is not the usual one.
        let mode = self.modes.last().filter(|mode| self.has_appeared || **mode != Mode::Work);
        if let Some(mode) = mode {
            let _ = write!(text, ", {mode}");
        }
        if let Some(count) = self.services {
            let plural = if count == 1 { "" } else { "s" };
            let _ = write!(text, ", {count} service{plural}");
        }
        text
    }
}

fn address(step: &StoryStep) -> String {
    step.entry.address.map_or_else(|| "?".to_owned(), |address| address.to_string())
}

/// UID of a device without a row, and a blank; else empty.
fn by(step: &StoryStep) -> String {
    match &step.change {
        StoryChange::Claimed { by: Some(by), .. } => format!("{by} "),
        _ => String::new(),
    }
}

/// Name or UID of the device of a step.
fn subject(step: &StoryStep) -> String {
    let name = step.entry.name.as_ref().map(ToString::to_string);
    let uid = match &step.change {
        StoryChange::GaveUp { by, .. } => by.clone(),
        _ => None,
    };
    uid.or(name).unwrap_or_else(|| "a device".to_owned())
}

/// The first and the last parts, joined by an arrow.
fn chain<T: ToString>(parts: &[T], arrow: &str) -> String {
    let text = |part: &T| part.to_string();
    let mut texts: Vec<String> = parts.iter().map(text).collect();
    if texts.len() > NAMED_MODES {
        let last = texts.split_off(texts.len() - (NAMED_MODES - 2));
        texts.truncate(1);
        texts.push("…".to_owned());
        texts.extend(last);
    }
    texts.join(arrow)
}

/// Kind of a story that is known by its text alone.
fn kind_of_text(step: &StoryStep) -> StoryKind {
    match (step.entry.kind, &step.change) {
        (_, StoryChange::Debug(_)) => StoryKind::Debug,
        (TimelineKind::Mark(_), _) => StoryKind::Mark,
        (TimelineKind::File, _) => StoryKind::File,
        // Errors of des.json have no name of their own.
        (TimelineKind::Error, _) if step.entry.bus.is_none() && step.entry.name.is_none() => {
            StoryKind::File
        }
        _ if step.entry.device.is_none() && step.entry.bus.is_some() => StoryKind::Bus,
        (_, StoryChange::Removed) => StoryKind::Presence,
        _ => StoryKind::Own,
    }
}

fn sign_of(entry: &TimelineEntry) -> StorySign {
    match entry.kind {
        TimelineKind::Improved => StorySign::Improved,
        TimelineKind::Change => StorySign::Change,
        TimelineKind::Overdue => StorySign::Absent(Presence::Stale),
        TimelineKind::Lost => StorySign::Absent(Presence::Lost),
        TimelineKind::Suspected => StorySign::Finding(FindingState::Suspected),
        TimelineKind::Confirmed => StorySign::Finding(FindingState::Confirmed),
        TimelineKind::Cleared => StorySign::Finding(FindingState::Cleared),
        TimelineKind::Bus | TimelineKind::File => StorySign::Plain,
        TimelineKind::Error => StorySign::Error,
        TimelineKind::Mark(letter) => StorySign::Mark(letter),
    }
}

impl Story {
    /// The times until a moment in which findings of an address conflict were open.
    pub(in crate::app) fn conflict_spans(&self, at: Instant) -> Vec<(BusIndex, ConflictSpan)> {
        let StoryKey::Problem(ProblemKey::Address(bus, address)) = self.key else {
            return Vec::new();
        };
        let (mut spans, mut open) = (Vec::new(), Vec::new());
        let (mut span, mut last): (Option<ConflictSpan>, _) = (None, Instant::ZERO);
        for step in self.steps_until(at) {
            if step.change == StoryChange::AnotherLog {
                open.clear();
                spans.extend(
                    span.take().map(|span| (bus, ConflictSpan { to: step.entry.time, ..span })),
                );
            }
            let StoryChange::Finding { key, state, until, .. } = &step.change else { continue };
            if !key.kind.is_conflict() {
                continue;
            }
            let time = step.entry.time;
            last = last.max((*until).min(time));
            open.retain(|it| *it != key);
            if *state != FindingState::Cleared {
                open.push(key);
                let begun =
                    ConflictSpan { address, from: time, to: Instant::LATEST, is_confirmed: false };
                span.get_or_insert(begun).is_confirmed |= *state == FindingState::Confirmed;
            } else if let Some(over) = span.take_if(|_| open.is_empty()) {
                spans.push((bus, ConflictSpan { to: last.max(over.from), ..over }));
            }
        }
        spans.extend(span.map(|span| (bus, span)));
        spans
    }

    /// Returns true if the story goes on at a moment.
    pub(super) fn is_open(&self, at: Instant) -> bool {
        Summary::of(self.steps_until(at), at).is_open(&self.key, at)
    }

    /// Returns true if its device is not online at a moment.
    pub(super) fn is_absent(&self, at: Instant) -> bool {
        Summary::of(self.steps_until(at), at).is_absent
    }

    /// The last mode of its device until a moment.
    pub(super) fn last_mode(&self, at: Instant) -> Option<Mode> {
        Summary::of(self.steps_until(at), at).modes.last().copied()
    }

    /// Kind as of a moment.
    pub fn kind(&self, at: Instant) -> StoryKind {
        Summary::of(self.steps_until(at), at).kind(&self.key)
    }

    /// The line as of a moment; `None` before the first step. `clock` writes a time of day.
    pub fn line(&self, at: Instant, clock: impl Fn(Instant) -> String) -> Option<StoryLine> {
        if self.begin() > at {
            return None;
        }
        let summary = Summary::of(self.steps_until(at), at);
        Some(StoryLine {
            kind: summary.kind(&self.key),
            sign: summary.sign(&self.key),
            from: self.begin(),
            to: (!summary.is_open(&self.key, at)).then(|| summary.end().max(self.begin())),
            what: summary.what(&self.key, at, clock),
        })
    }

    /// The event that names what the story is about, as of a moment: the last one with a name, of a
    /// conflict the last one at its address.
    pub fn subject(&self, at: Instant) -> &TimelineEntry {
        let place = match &self.key {
            StoryKey::Problem(ProblemKey::Address(_, address)) => Some(*address),
            _ => None,
        };
        let is_there = |step: &&StoryStep| place.is_none() || step.entry.address == place;
        let mut steps = self.steps_until(at).rev().filter(is_there);
        let last = steps.next();
        let named = last.into_iter().chain(steps).find(|step| step.entry.name.is_some());
        &named.or(last).unwrap_or(&self.steps()[0]).entry
    }
}
