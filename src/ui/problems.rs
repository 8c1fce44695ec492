//! Page 4, Problems: a row per problem, and the details of the selected one: state, finding
//! texts, remedy, evidence with its frames, addresses and names. Why des.json cannot be used stands
//! below the list.

use super::brush::{DrawContext, bus_label, fit, inner, labelled};
use super::symbols;
use super::traffic::in_words;
use crate::app::{Page, Problem, clock_millis, format_duration, format_time_of_day};
use crate::finding::FindingState;
use crate::keymap::Action;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Draws the list and the details.
pub fn draw(brush: &mut DrawContext) {
    draw_list(brush);
    draw_details(brush);
}

/// Returns the sign of a problem, the role of the sign, and that of the text.
fn roles(problem: &Problem) -> (&'static str, Role, Role) {
    let (sign, role) = symbols::of_finding_state(problem.state());
    match problem.state() {
        _ if problem.is_muted => (sign, Role::Muted, Role::Muted),
        FindingState::Cleared => (sign, role, Role::Muted),
        _ => (sign, role, Role::Text),
    }
}

/// Columns from which the list has the column SINCE.
const WITH_TIME: u16 = 56;

fn draw_list(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let time = if list.width >= WITH_TIME { "SINCE    " } else { "" };
    let title = format!("   {} {time}PROBLEM", fit("WHERE", bus_width(brush) + ADDRESS));
    let line = Line::from(brush.span(Role::Header, title));
    brush.line(header, 0, &line);
    let list = draw_file_problem(brush, list);
    let app = brush.app;
    let problems = app.problems_shown();
    if problems.is_empty() {
        if app.file().problem().is_some() && app.problems().is_empty() {
            return;
        }
        if app.page_filter(Page::Problems).is_on() {
            return brush.draw_no_match(list, "no problem matches the filter");
        }
        if let Some(reason) = app.foreign_reason() {
            return brush.draw_empty_list(list, &reason);
        }
        // A bus that is not up may have problems that were not received.
        let text = if brush.cannot_receive() { "no problems so far" } else { "no problems found" };
        return brush.draw_empty_list(list, text);
    }
    let selected = app.view().problems.index(problems.keys());
    let height = usize::from(list.height);
    let top = app.view().problems.top(selected, problems.len(), height);
    for row in 0..height {
        let Some(problem) = problems.get(top + row) else { break };
        let is_selected = selected == Some(top + row);
        let line = problem_line(brush, &problem, list, is_selected);
        // A blank in front of the divider.
        let width = list.width - brush.screen.divider.width;
        brush.line(Rect { width, ..list }, row as u16, &line);
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

/// Draws why des.json cannot be used, with the lines of the mistake, at the bottom of the list.
/// Returns the area that is left for the problems.
fn draw_file_problem(brush: &mut DrawContext, list: Rect) -> Rect {
    let file = brush.app.file();
    let Some(problem) = file.problem() else { return list };
    let mut lines = vec![Line::default()];
    let text = problem.of_file(&file.name());
    lines.extend(labelled(brush, "  ✗ ", Role::Error, &text, list.width));
    for text in problem.excerpt().into_iter().flatten() {
        lines.push(Line::from(brush.span(Role::Text, format!("  {text}"))));
    }
    let height = list.height.min(lines.len() as u16);
    let left = Rect { height: list.height - height, ..list };
    brush.lines(Rect { y: left.bottom(), height, ..list }, &lines, 0);
    left
}

fn problem_line(
    brush: &DrawContext,
    problem: &Problem,
    list: Rect,
    selected: bool,
) -> Line<'static> {
    let (sign, sign_role, plain) = roles(problem);
    let mut spans = vec![
        brush.span(Role::Text, if selected { "▸" } else { " " }),
        brush.span(sign_role, format!("{sign} ")),
        brush.span(plain, format!("{} ", place(brush, problem))),
    ];
    if list.width >= WITH_TIME {
        let is_over = problem.state() == FindingState::Cleared;
        let since = if is_over { problem.first() } else { problem.since() };
        let since = format_time_of_day(brush.app, since);
        spans.push(brush.span(Role::Muted, format!("{since} ")));
    }
    if problem.is_muted {
        spans.push(brush.span(plain, "muted · "));
    }
    let names: Vec<String> = problem.names().iter().map(|it| it.quoted().to_string()).collect();
    let names = names.join(", ");
    if names.is_empty() {
        spans.push(brush.span(plain, problem.headline()));
    } else if list.width >= WITH_TIME {
        spans.push(brush.span(plain, format!("{}  ", problem.headline())));
        spans.push(brush.span(Role::Muted, names));
    } else {
        // The headline may be cut, the names not.
        spans.push(brush.span(plain, format!("{names}  ")));
        spans.push(brush.span(plain, problem.headline()));
    }
    Line::from(spans)
}

/// Cells of a label: beside it the longest kind, 26 characters, fits the narrowest details.
const LABEL: usize = 8;

/// Cells of an address with its `@`.
const ADDRESS: usize = 5;

/// Cells of the bus in front of the address, with its blank; 0 for a single bus.
fn bus_width(brush: &DrawContext) -> usize {
    let buses = brush.app.buses();
    let longest = buses.iter().map(|bus| bus.name.width()).max().unwrap_or(0);
    let most = if brush.screen.list.width >= WITH_TIME { 12 } else { 6 };
    if buses.len() > 1 { longest.min(most) + 1 } else { 0 }
}

/// Returns the column WHERE: the bus if there are several, then the address, `bus` or `file`.
fn place(brush: &DrawContext, problem: &Problem) -> String {
    let width = bus_width(brush).saturating_sub(1);
    let name = problem.bus().map(|bus| bus_label(brush.app, bus, width));
    let (bus, address) = match (problem.head().key.address, name) {
        (Some(address), name) => (name.unwrap_or("file".to_owned()), format!("@{address}")),
        // An entry without an address.
        (None, Some(name)) if problem.head().key.name.is_some() => (name, "–".to_owned()),
        (None, Some(name)) => (name, if width > 0 { "" } else { "bus" }.to_owned()),
        (None, None) => ("file".to_owned(), if width > 0 { "" } else { "file" }.to_owned()),
    };
    match width {
        0 => fit(&address, ADDRESS),
        _ => format!("{} {}", fit(&bus, width), fit(&address, ADDRESS)),
    }
}

fn draw_details(brush: &mut DrawContext) {
    let area = inner(brush.screen.details);
    if area.height == 0 {
        return;
    }
    let lines = match brush.app.selected_problem() {
        Some(problem) => {
            ProblemDetails { brush, problem, width: area.width, lines: Vec::new() }.all()
        }
        None => return,
    };
    let scroll = brush.app.view().details_scroll;
    brush.lines(area, &lines, scroll);
}

/// The lines of the details, collected top to bottom.
struct ProblemDetails<'b, 'a> {
    brush: &'b DrawContext<'a>,
    problem: Problem<'a>,
    width: u16,
    lines: Vec<Line<'static>>,
}

impl ProblemDetails<'_, '_> {
    /// All lines; a section without content has none.
    fn all(mut self) -> Vec<Line<'static>> {
        self.state();
        self.text();
        self.others();
        self.evidence();
        self.subject();
        self.lines
    }

    fn add(&mut self, label: &str, role: Role, text: &str) {
        self.lines.extend(labelled(self.brush, label, role, text, self.width));
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
            self.brush.span(role, format!("{sign} {word}")),
            self.brush.span(
                Role::Muted,
                match head.state {
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
                format!("{}, since {since}", seen.label())
            });
            let others = others.collect::<Vec<String>>().join(", and ");
            let verb = match (head.state, later.len()) {
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
        if !head.remedy.is_empty() && head.state != FindingState::Cleared {
            self.lines.push(Line::default());
            self.add("→ ", Role::New, &head.remedy);
        }
    }

    /// Texts of the other findings of the problem.
    fn others(&mut self) {
        if self.problem.findings.len() > 1 {
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

    /// Number of events, and each stored one with its time and frame.
    fn evidence(&mut self) {
        let (brush, pieces) = (self.brush, self.problem.evidence());
        if pieces.is_empty() {
            return;
        }
        self.lines.push(Line::default());
        let key = brush.app.key_of(Action::Details);
        let count = self.problem.count().max(pieces.len() as u64);
        let stored = pieces.len();
        let text = match count {
            1 => "1 event".to_owned(),
            _ if count > stored as u64 => format!("{count} events, {stored} stored"),
            _ => format!("{count} events"),
        };
        self.lines.push(Line::from(brush.span(Role::Title, text)));
        self.add("", Role::Muted, &format!("{key} shows the frames"));
        for piece in &pieces {
            let time = format!("{} ", clock_millis(brush.app, piece.time));
            self.add(&time, Role::Text, &piece.what);
            if let Some(frame) = &piece.frame {
                self.add("  ", Role::Text, &in_words(brush, frame));
                self.add("  ", Role::Muted, &frame.to_string());
            }
        }
    }

    /// Bus, addresses, names, first and last event, and the finding kinds as in JSON.
    fn subject(&mut self) {
        let (app, problem) = (self.brush.app, &self.problem);
        let addresses: Vec<String> = problem.addresses().iter().map(ToString::to_string).collect();
        let names: Vec<String> = problem.names().iter().map(|it| it.quoted().to_string()).collect();
        let bus = problem.bus().filter(|_| app.buses().len() > 1).and_then(|bus| app.bus(bus));
        let buses: Vec<String> = bus.iter().map(|bus| bus.name.clone()).collect();
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
