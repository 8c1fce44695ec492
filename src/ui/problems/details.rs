//! The details of the selected problem, below the list or in its place.
//!
//! Of a conflict: the boards side by side, their heartbeats, the evidence, then all that the findings
//! say. Of any other problem: state, text and remedy first, then the evidence. What gives way on a low
//! screen stands at the end.

use super::super::brush::{DrawContext, fit, labelled};
use super::super::symbols;
use super::boards::{self, BoardLines};
use super::evidence::{EvidenceTable, frame_line};
use super::{roles, state_word};
use crate::app::{Focus, Problem, clock_millis, format_duration, format_time_of_day};
use crate::finding::FindingState;
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Cells of a label: beside it the longest kind, 26 characters, fits the narrowest details.
const LABEL: usize = 8;
/// Pieces of evidence for which rows of the boards give way.
const LEAST_EVIDENCE: usize = 3;

/// Draws the details of the selected problem with the rule above them.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.details;
    if area.height == 0 {
        return;
    }
    draw_rule(brush);
    let Some(problem) = brush.app.selected_problem() else { return };
    let view = brush.app.view();
    let focused = view.focus == Focus::Details;
    let details = ProblemDetails {
        brush,
        width: area.width.saturating_sub(1),
        height: usize::from(area.height),
        piece: focused.then_some(view.piece),
        is_expanded: false,
        lines: Vec::new(),
        selected: None,
        problem,
    };
    let (lines, selected) = details.all();
    // The selected piece stays in view, with the line of its frame; the rest scrolls behind it.
    let hidden = lines.len().saturating_sub(usize::from(area.height));
    // The first one is selected at once: the lines above it stay.
    let below = 3;
    let moved = selected.filter(|_| view.piece > 0);
    let kept = moved.map_or(0, |line| (line + below).saturating_sub(usize::from(area.height)));
    let kept = kept.min(hidden);
    let extra = usize::from(view.details_scroll).min(hidden - kept);
    let scroll = u16::try_from(kept + extra).unwrap_or(u16::MAX);
    brush.lines(area, &lines, scroll);
    brush.scrolled = u16::try_from(extra).ok();
    if let Some(row) = selected.and_then(|line| line.checked_sub(kept + extra)) {
        brush.select(area, u16::try_from(row).unwrap_or(u16::MAX));
    }
}

/// Draws the rule with the headline, and at its right end the state.
fn draw_rule(brush: &mut DrawContext) {
    let rule = brush.screen.lower_rule;
    if rule.height == 0 {
        return;
    }
    let focused = brush.app.view().focus == Focus::Details;
    brush.rule(rule, if focused { Role::BorderFocus } else { Role::Border });
    let Some(problem) = brush.app.selected_problem() else { return };
    let mut left = rule.width.saturating_sub(1);
    if rule.width >= 100 {
        let at = clock_millis(brush.app, problem.since());
        let state = Line::from(brush.span(Role::Muted, format!(" {} {at} ", state_word(&problem))));
        let width = state.width() as u16;
        let end = Rect { x: rule.right().saturating_sub(width + 1), width, ..rule };
        brush.line(end, 0, &state);
        left = left.saturating_sub(width + 2);
    }
    let title = brush.app.headline(&problem).full;
    let title = Line::from(brush.span(Role::Title, format!(" {title} ")));
    brush.line(Rect { x: rule.x + 1, width: left, ..rule }, 0, &title);
}

/// The lines of the details, collected top to bottom.
struct ProblemDetails<'b, 'a> {
    brush: &'b DrawContext<'a>,
    problem: Problem<'a>,
    width: u16,
    height: usize,
    /// Selected piece of evidence, if the details have the focus.
    piece: Option<usize>,
    /// There is room for the frame below each piece.
    is_expanded: bool,
    lines: Vec<Line<'static>>,
    /// Line of the selected piece.
    selected: Option<usize>,
}

impl ProblemDetails<'_, '_> {
    /// All lines, and that of the selected piece of evidence; a section without content has none.
    fn all(mut self) -> (Vec<Line<'static>>, Option<usize>) {
        self.build();
        let pieces = self.problem.evidence().len();
        if self.lines.len() + pieces <= self.height {
            self.is_expanded = true;
            self.lines.clear();
            self.build();
        }
        (self.lines, self.selected)
    }

    fn build(&mut self) {
        if let Some(boards) = boards::lines(self.brush, &self.problem, self.width) {
            return self.conflict(boards);
        }
        self.state();
        self.text();
        self.remedy();
        self.others();
        if self.problem.has_evidence() {
            self.lines.push(Line::default());
        }
        self.evidence(None);
        self.subject();
    }

    /// The boards, then the evidence, then the rest. Rows give way to the first pieces of evidence in
    /// this order: answers, services, remedy.
    fn conflict(&mut self, boards: BoardLines) {
        let BoardLines { mut columns, mut services, axis, mut answers, mut remedy, panel } = boards;
        let heading = 1;
        let wanted = heading + LEAST_EVIDENCE.min(self.problem.evidence().len());
        let mut gone = Vec::new();
        let mut height = columns.len() + services.len() + axis.len() + answers.len() + remedy.len();
        for part in [&mut answers, &mut services, &mut remedy] {
            if height + wanted > self.height {
                height -= part.len();
                gone.append(part);
            }
        }
        // The heartbeats never give way, the last rows of the columns do.
        let least = 2;
        let room = self.height.saturating_sub(axis.len() + 1).max(least);
        let mut below = columns.split_off(columns.len().min(room));
        gone.append(&mut below);
        self.lines.extend([columns, services, axis, answers, remedy].into_iter().flatten());
        self.evidence(Some(&panel.sides));
        self.lines.push(Line::default());
        self.lines.append(&mut gone);
        self.state();
        self.text();
        self.others();
        self.subject();
    }

    fn add(&mut self, label: &str, role: Role, text: &str) {
        let label = format!(" {label}");
        self.lines.extend(labelled(self.brush, &label, role, text, self.width));
    }

    /// Confidence, time and age. A confirmed problem that is not a conflict has no word: it is an
    /// observation, not a conclusion.
    fn state(&mut self) {
        let (app, head) = (self.brush.app, self.problem.head());
        let (sign, role, _) = roles(&self.problem);
        let since = self.problem.since();
        let (at, ago) =
            (format_time_of_day(app, since), format_duration(app.display_time().since(since)));
        let word = match head.state {
            FindingState::Cleared => "cleared ",
            FindingState::Suspected => "suspected ",
            FindingState::Confirmed if head.key.kind.is_conflict() => "confirmed ",
            FindingState::Confirmed => "",
        };
        self.lines.push(Line::from(vec![
            self.brush.span(role, format!(" {sign} {word}")),
            self.brush.span(
                Role::Muted,
                match head.state {
                    FindingState::Cleared if self.problem.was_only_suspected() => {
                        format!("{at}, {ago} ago, never confirmed")
                    }
                    FindingState::Cleared => format!("{at}, {ago} ago"),
                    _ => format!("since {at}, {ago}"),
                },
            ),
        ]));
        // A conflict is confirmed some periods after it began.
        let is_confirmed = head.state == FindingState::Confirmed && head.key.kind.is_conflict();
        if let Some(began) = Some(self.problem.first()).filter(|it| is_confirmed && *it < since) {
            let began = format!("first evidence {}", format_time_of_day(app, began));
            self.add("", Role::Muted, &began);
        }
        if self.problem.is_muted {
            let key = app.key_of(Action::Mute);
            self.add("", Role::Muted, &format!("muted ({key} unmutes)"));
        }
    }

    /// Text of the first finding, what would confirm it, and the remedy.
    fn text(&mut self) {
        let head = self.problem.head();
        let headline = self.problem.headline();
        let text = if head.text.is_empty() { &*headline } else { &head.text };
        let was = if head.state == FindingState::Cleared { "was: " } else { "" };
        self.add("", Role::Text, &format!("{was}{text}"));
        if let [first, later @ ..] = &head.uids[..]
            && !later.is_empty()
        {
            let others = later.iter().map(|seen| {
                let since = format_time_of_day(self.brush.app, seen.since);
                let back = if seen.has_returned() { "back " } else { "" };
                format!("{}, {back}since {since}", seen.label())
            });
            let others = others.collect::<Vec<String>>().join(", and ");
            let verb = match (head.state, later.len()) {
                (FindingState::Cleared, _) if !head.was_confirmed => "may have conflicted",
                (FindingState::Cleared, _) => "conflicted",
                (_, 1) => "conflicts",
                _ => "conflict",
            };
            self.add("", Role::Text, &format!("{others}, {verb} with {}.", first.label()));
        }
        if let Some(hint) = self.problem.confirmation_hint() {
            self.lines.push(Line::default());
            self.add("? ", Role::Muted, hint);
        }
    }

    fn remedy(&mut self) {
        let head = self.problem.head();
        if !head.remedy.is_empty() && head.state != FindingState::Cleared {
            self.lines.push(Line::default());
            self.add("→ ", Role::New, &head.remedy);
        }
    }

    /// Texts of the other findings of the problem.
    fn others(&mut self) {
        let mut others = self.problem.findings.iter().skip(1);
        if others.any(|finding| finding.superseded_by.is_none()) {
            self.lines.push(Line::default());
        }
        for at in 1..self.problem.findings.len() {
            let finding = self.problem.findings[at];
            if finding.superseded_by.is_some() {
                continue;
            }
            let (sign, _) = symbols::of_finding_state(finding.state);
            let sure = finding.state == FindingState::Confirmed;
            self.add(
                &format!("{sign} "),
                if sure { Role::Text } else { Role::Muted },
                &finding.text,
            );
        }
    }

    /// The evidence as a table; with the frame below each piece where all fit, else below the selected
    /// one.
    fn evidence(&mut self, sides: Option<&crate::app::ConflictSides>) {
        let (brush, pieces) = (self.brush, self.problem.evidence());
        if pieces.is_empty() {
            return;
        }
        let table = EvidenceTable {
            pieces: &pieces,
            count: self.problem.count(),
            sides,
            width: self.width,
        };
        self.lines.push(table.heading(brush));
        let selected = self.piece.map(|piece| piece.min(pieces.len() - 1));
        for (at, piece) in pieces.iter().enumerate() {
            let is_selected = selected == Some(at);
            if is_selected {
                self.selected = Some(self.lines.len());
            }
            self.lines.push(table.line(brush, at, is_selected));
            if self.is_expanded || is_selected {
                self.lines.extend(frame_line(brush, piece));
            }
        }
    }

    /// Bus, addresses, names, first and last event, and the finding kinds as in JSON.
    fn subject(&mut self) {
        let (app, problem) = (self.brush.app, &self.problem);
        let addresses: Vec<String> = problem.addresses().iter().map(ToString::to_string).collect();
        let names: Vec<String> = problem.names().iter().map(|it| it.quoted().to_string()).collect();
        let bus = problem.bus().filter(|_| app.buses().len() > 1);
        let buses: Vec<String> =
            bus.into_iter().map(|bus| app.shown_buses().unique_name(bus)).collect();
        let mut seen = Vec::new();
        if problem.has_evidence() {
            let (first, last) =
                (format_time_of_day(app, problem.first()), format_time_of_day(app, problem.last()));
            seen.push(format!("first {first}, last {last}"));
        }
        self.lines.push(Line::default());
        for (one, several, all) in [
            ("bus", "", buses),
            ("address", "address", addresses),
            ("name", "names", names),
            ("seen", "", seen),
        ] {
            let label = if all.len() > 1 { several } else { one };
            self.add(&fit(label, LABEL), Role::Muted, &all.join(", "));
        }
        for at in 0..self.problem.findings.len() {
            let label = fit(if at == 0 { "kind" } else { "" }, LABEL);
            self.add(&label, Role::Muted, self.problem.findings[at].key.kind.name());
        }
    }
}
