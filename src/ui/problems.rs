//! Problems: what is wrong, how sure that is, the frames that prove it, and what to do.

use super::brush::{Brush, fit, labelled};
use super::details::inner;
use crate::app::{Page, clock, clock_millis, spell};
use crate::discovery::{Confidence, Finding};
use crate::theme::Role;
use ratatui::text::{Line, Span};

pub fn draw(brush: &mut Brush) {
    draw_list(brush);
    draw_details(brush);
}

/// The sign and the role of a confidence.
pub(super) fn sign(confidence: Confidence) -> (&'static str, Role) {
    match confidence {
        Confidence::Confirmed => ("⚠", Role::Collision),
        Confidence::Suspected => ("?", Role::Suspected),
        Confidence::Cleared => ("✓", Role::Muted),
    }
}

fn draw_list(brush: &mut Brush) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let line = Line::from(
        brush.span(Role::Header, format!("    {} WHAT", fit("WHERE", place_width(brush)))),
    );
    brush.line(header, 0, &line);
    let app = brush.app;
    let problems = app.problems_shown();
    if problems.is_empty() {
        let text = if app.view().filter(Page::Problems).is_empty() {
            "nothing is wrong, as far as can be seen"
        } else {
            return brush.filtered(list, "no problem fits the filter");
        };
        let line = Line::from(brush.span(Role::Muted, format!("   {text}")));
        return brush.line(list, 1, &line);
    }
    let selected = app.view().problems.index(problems.iter().map(|finding| &finding.key));
    let height = usize::from(list.height);
    let top = app.view().problems.top(selected, problems.len(), height);
    for (row, finding) in problems.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + row);
        let (sign, role) = sign(finding.confidence);
        let cleared = finding.confidence == Confidence::Cleared;
        let plain = if cleared { Role::Muted } else { Role::Text };
        let mut spans = vec![
            brush.span(Role::Text, if is_selected { "▸" } else { " " }),
            brush.span(role, format!("{sign} ")),
            brush.span(plain, format!(" {} ", fit(&place(brush, finding), place_width(brush)))),
            brush.span(plain, finding.key.kind.to_string()),
        ];
        if let Some(name) = finding.names.first() {
            spans.push(brush.span(Role::Muted, format!("  {name}")));
        }
        brush.line(list, row as u16, &Line::from(spans));
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}

fn place_width(brush: &Brush) -> usize {
    if brush.app.buses().len() > 1 { 10 } else { 5 }
}

/// Where it is: the bus, where there are several, and the address.
fn place(brush: &Brush, finding: &Finding) -> String {
    let app = brush.app;
    let bus = finding.key.bus.filter(|_| app.buses().len() > 1).and_then(|bus| app.bus(bus));
    let bus = bus.map(|bus| format!("{} ", bus.name)).unwrap_or_default();
    match finding.key.address {
        Some(address) => format!("{bus}@{address}"),
        None if finding.key.bus.is_none() => "file".to_owned(),
        None => finding
            .key
            .bus
            .and_then(|bus| app.bus(bus))
            .map_or_else(String::new, |bus| bus.name.clone()),
    }
}

fn draw_details(brush: &mut Brush) {
    let area = inner(brush.screen.details, brush.screen.details_alone());
    if area.height == 0 {
        return;
    }
    let app = brush.app;
    let Some(finding) = app.selected_problem() else { return };
    let (sign, role) = sign(finding.confidence);
    let since = spell(app.now().since(finding.changed));
    let mut lines = vec![Line::from(vec![
        brush.span(role, format!("{sign} {}", finding.confidence)),
        brush.span(Role::Muted, format!("  since {since}")),
    ])];
    let text = |role: Role, text: &str| labelled(brush, "", role, text, area.width);
    lines.extend(text(Role::Text, &finding.text));
    if !finding.remedy.is_empty() {
        lines.push(Line::default());
        lines.extend(labelled(brush, "→ ", Role::New, &finding.remedy, area.width));
    }
    if finding.addresses.len() > 1 {
        let all: Vec<String> = finding.addresses.iter().map(ToString::to_string).collect();
        lines.extend(labelled(brush, "addresses ", Role::Text, &all.join(", "), area.width));
    }
    if finding.names.len() > 1 {
        let all: Vec<String> = finding.names.iter().map(ToString::to_string).collect();
        lines.extend(labelled(brush, "names ", Role::Text, &all.join(", "), area.width));
    }
    if !finding.evidence.is_empty() {
        lines.push(Line::default());
        let kept = finding.evidence.len() as u64;
        let all = if finding.count > kept {
            format!("evidence: {} pieces, the first and the last", finding.count)
        } else {
            "evidence".to_owned()
        };
        lines.push(Line::from(brush.span(Role::Title, all)));
    }
    for evidence in &finding.evidence {
        let time = clock_millis(app, evidence.time);
        lines.extend(labelled(brush, &format!("{time} "), Role::Text, evidence.what, area.width));
        if let Some(frame) = &evidence.frame {
            let text = frame.to_string();
            lines.push(Line::from(vec![Span::raw("  "), brush.span(Role::Muted, text)]));
        }
    }
    lines.push(Line::default());
    let first = clock(app, finding.first);
    let last = clock(app, finding.last);
    lines.push(Line::from(brush.span(Role::Muted, format!("first {first}, last {last}"))));
    let scroll = app.view().details_scroll;
    brush.lines(area, &lines, scroll);
}
