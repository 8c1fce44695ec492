//! The alarm: the newest confirmed conflict, which every page announces until it is over or muted.
//!
//! Inputs: the problems of the shown moment and of the present one. Outputs: the alarm to show, the
//! conflict that is confirmed now while a past moment is shown, the title of the terminal. Computed
//! when the problems change. Does not know how it is drawn.

use super::App;
use super::problems::{Problem, ProblemKey, ProblemList};
use super::view::Page;
use crate::finding::{Finding, FindingState};
use crate::keymap::Action;
use crate::text::{Escaped, join_first};
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
            let key = self.key_of_present();
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
        self.refresh_for_draw();
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
        let headline = self.headline(newest);
        let (text, short) = (headline.full, headline.label);
        let is_seen = self.alarms.seen.contains(&newest.key);
        let (problem, others) = (newest.key.clone(), wanted.len() - 1);
        Some(Alarm { problem, text, short, others, is_seen })
    }
}

/// The confirmed conflicts of a list that are not muted.
fn conflicts<'a>(problems: &'a ProblemList<'_>) -> impl Iterator<Item = Problem<'a>> {
    let is_confirmed =
        |it: &&Finding| it.state == FindingState::Confirmed && it.key.kind.is_conflict();
    problems
        .iter()
        .filter(move |problem| !problem.is_muted && problem.findings.iter().any(is_confirmed))
}
