//! The alarm: the newest confirmed conflict, which every page announces until it is over or muted.
//!
//! Inputs: the problems of the shown moment and of the present one. Outputs: the alarm to show, the
//! conflict that is confirmed now while a past moment is shown, the title of the terminal. Computed
//! when the problems change. Does not know how it is drawn.

use super::problems::{Problem, ProblemKey, ProblemList};
use super::view::Page;
use super::{App, format_time_of_day};
use crate::finding::{Finding, FindingKind, FindingState, SeenUid};
use crate::keymap::Action;
use crate::text::{Escaped, Name, join_first};
use crate::time::Instant;
use std::collections::BTreeSet;

/// UIDs or names in a text; the others are counted.
const SHOWN_DEVICES: usize = 3;

/// A confirmed conflict that every page announces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// Its problem.
    pub problem: ProblemKey,
    /// One sentence: address, UIDs or names, times.
    pub text: String,
    /// The address and the devices: `14: SPARE01 / BOILER03`.
    pub short: String,
    /// Number of further confirmed conflicts.
    pub others: usize,
    /// The user has gone to the problem.
    pub is_seen: bool,
}

/// The alarm, and what the user has seen of the confirmed conflicts.
#[derive(Debug, Default)]
pub(super) struct Alarms {
    shown: Option<Alarm>,
    /// The newest conflict that is confirmed now and was not at the shown moment.
    present: Option<Alarm>,
    /// Conflicts that are confirmed now.
    confirmed: BTreeSet<ProblemKey>,
    /// Those of them to which the user has gone.
    seen: BTreeSet<ProblemKey>,
}

impl App {
    /// The newest confirmed conflict at the shown moment that is not muted.
    pub fn alarm(&self) -> Option<&Alarm> {
        self.alarms.shown.as_ref()
    }

    /// While a past moment is shown: the newest conflict that is confirmed now and was not then.
    pub fn present_alarm(&self) -> Option<&Alarm> {
        self.alarms.present.as_ref()
    }

    /// Title for the window of the terminal: the buses, in front of them a conflict that is confirmed
    /// now.
    pub fn terminal_title(&self) -> String {
        let names = self.buses.iter().map(|bus| Escaped(bus.name.as_bytes()).to_string());
        let title = format!("descan {}", join_first(names.collect(), SHOWN_DEVICES, ", "));
        let present = self.alarms.present.as_ref().or(self.alarms.shown.as_ref());
        match present.filter(|alarm| self.alarms.confirmed.contains(&alarm.problem)) {
            Some(alarm) => format!("⚠ {} – {title}", alarm.short),
            None => title,
        }
    }

    /// Renews the alarm after a change of the problems or of the shown moment.
    pub(super) fn settle_alarm(&mut self) {
        let present = self.problems.list(&self.buses);
        let confirmed: BTreeSet<_> = conflicts(&present).map(|problem| problem.key).collect();
        let shown = match &self.past {
            Some(past) => self.newest(&past.problems.list(&past.buses), |_| true),
            None => self.newest(&present, |_| true),
        };
        let then: BTreeSet<_> = match &self.past {
            Some(past) => conflicts(&past.problems.list(&past.buses)).map(|it| it.key).collect(),
            None => confirmed.clone(),
        };
        let later = self.newest(&present, |key| !then.contains(key));
        let is_new = later.as_ref().is_some_and(|it| !self.alarms.confirmed.contains(&it.problem));
        self.alarms.seen.retain(|key| confirmed.contains(key));
        self.view.has_alarm = shown.is_some();
        self.alarms.shown = shown;
        self.alarms.present = later;
        self.alarms.confirmed = confirmed;
        if let Some(alarm) = self.alarms.present.clone().filter(|_| is_new) {
            let key = self.key_of(Action::Freeze);
            self.show_error(format!("conflict now: {}; {key} shows the present", alarm.short));
        }
    }

    /// Notes that the problem was opened: its alarm is no longer filled.
    pub(super) fn note_alarm_seen(&mut self, problem: &ProblemKey) {
        if let Some(alarm) = self.alarms.shown.as_mut().filter(|it| it.problem == *problem) {
            alarm.is_seen = true;
        }
        if self.alarms.confirmed.contains(problem) {
            self.alarms.seen.insert(problem.clone());
        }
    }

    /// The problem that a key is about where the page has none: that of the alarm.
    pub(super) fn alarm_problem(&self) -> Option<ProblemKey> {
        self.alarm().map(|alarm| alarm.problem.clone())
    }

    /// Mutes the selected problem, on other pages that of the alarm; or unmutes it.
    pub(super) fn toggle_muted(&mut self) {
        let key = match self.view.page {
            Page::Problems => self.selected_problem().map(|problem| problem.key),
            _ => self.alarm_problem(),
        };
        let problem = key.and_then(|key| self.problems().iter().find(|it| it.key == key));
        let Some(problem) = problem else {
            return self.show_error(match self.view.page {
                Page::Problems => "no problem is selected",
                _ => "no alarm; mute problems on the Problems page",
            });
        };
        let (key, title) = (problem.key.clone(), problem.title());
        if self.view.page == Page::Problems {
            // The selection follows the problem to its new place: the same key unmutes it.
            self.view.problems.select(key.clone());
        }
        if let Some(past) = &mut self.past {
            past.problems.toggle_muted(key.clone());
        }
        let is_muted = self.problems.toggle_muted(key);
        self.refresh();
        if is_muted {
            let undo = self.key_of(Action::Mute);
            let place = if self.view.page == Page::Problems { "" } else { " on Problems" };
            self.show_info(format!("muted until descan quits ({undo}{place} unmutes): {title}"));
        } else {
            self.show_info(format!("unmuted: {title}"));
        }
    }

    /// The newest confirmed conflict of a list whose key `is_wanted` selects.
    fn newest(
        &self,
        problems: &ProblemList,
        is_wanted: impl Fn(&ProblemKey) -> bool,
    ) -> Option<Alarm> {
        let wanted: Vec<Problem> =
            conflicts(problems).filter(|problem| is_wanted(&problem.key)).collect();
        let newest = wanted.iter().max_by_key(|problem| problem.since())?;
        let finding = conflict_of(newest)?;
        let place = match newest.bus().filter(|_| self.buses.len() > 1) {
            Some(bus) => self.bus(bus).map_or(String::new(), |bus| {
                format!(" on {}", Escaped(bus.name_without_rates().as_bytes()))
            }),
            None => String::new(),
        };
        let at = |time| format_time_of_day(self, time);
        let (text, short) = words(finding, &place, at);
        let is_seen = self.alarms.seen.contains(&newest.key);
        let (problem, others) = (newest.key.clone(), wanted.len() - 1);
        Some(Alarm { problem, text, short, others, is_seen })
    }
}

/// The confirmed conflicts of a list that are not muted.
fn conflicts<'a>(problems: &'a ProblemList<'_>) -> impl Iterator<Item = Problem<'a>> {
    problems.iter().filter(|problem| !problem.is_muted && conflict_of(problem).is_some())
}

/// The finding of a problem that says most about its confirmed conflict.
fn conflict_of<'a>(problem: &Problem<'a>) -> Option<&'a Finding> {
    let is_conflict =
        |it: &&&Finding| it.state == FindingState::Confirmed && it.key.kind.is_conflict();
    let known = |it: &&&Finding| (it.uids.len().min(2), it.names.len().min(2));
    // Of equal ones the first, which is the most severe.
    problem.findings.iter().rev().filter(is_conflict).max_by_key(known).copied()
}

/// A conflict as a sentence and in short.
fn words(
    finding: &Finding,
    place: &str,
    time_of_day: impl Fn(Instant) -> String,
) -> (String, String) {
    let list = |separator: &str| {
        let all = finding.addresses.iter().map(ToString::to_string);
        join_first(all.collect(), SHOWN_DEVICES, separator)
    };
    let mut uids: Vec<&SeenUid> = finding.uids.iter().collect();
    uids.sort_by_key(|uid| uid.since);
    let labels = |uids: &[&SeenUid]| uids.iter().map(|uid| uid.label()).collect::<Vec<_>>();
    let names: Vec<String> =
        finding.names.iter().map(Name::quoted).map(|it| it.to_string()).collect();
    let since = time_of_day(finding.first);
    let address = finding.key.address.map_or_else(|| list("/"), |it| it.to_string());
    match (finding.key.kind, &uids[..]) {
        (FindingKind::OneUidTwoAddresses, [uid, ..]) => {
            let text = format!("UID {} at addresses {}{place}", uid.label(), list(" and "));
            (format!("{text} since {since}"), format!("{}: {}", list("/"), uid.label()))
        }
        (kind, [before @ .., newest]) if !before.is_empty() => {
            let joined = if newest.has_returned() { "returned" } else { "joined" };
            let at = time_of_day(newest.since);
            let first = time_of_day(before[0].since);
            let others = join_first(labels(before), SHOWN_DEVICES, " and ");
            let newest = newest.label();
            let start = match kind {
                FindingKind::TwoDebugDevices => format!("Debug devices at {address}"),
                _ => format!("Address {address}"),
            };
            let text = format!(
                "{start}{place}: {newest} {joined} {at}, conflicts with {others} (since {first})"
            );
            let before = join_first(labels(before), SHOWN_DEVICES, " / ");
            (text, format!("{address}: {newest} / {before}"))
        }
        _ if names.len() > 1 => {
            let text = join_first(names.clone(), SHOWN_DEVICES, " and ");
            let short = join_first(names, SHOWN_DEVICES, " / ");
            (
                format!("Address {address}{place}: {text} conflict since {since} (UIDs unknown)"),
                format!("{address}: {short}"),
            )
        }
        _ => {
            let name = names.first().map_or_else(|| "one name".to_owned(), Clone::clone);
            (
                format!(
                    "Address {address}{place}: a second {name} detected {since} (UIDs unknown)"
                ),
                format!("{address}: two of {name}"),
            )
        }
    }
}
