//! The first lines: broker, connection, sums, banners; the names of the pages; the last events.

use super::{FleetBrush, age_text, of_state};
use crate::app::{BrokerLink, FleetEvent, FleetEventKind, FleetSums};
use crate::fleet::GatewayState;
use crate::theme::Role;
use crate::ui::brush::{fit, set_rule};
use crate::ui::chart::grouped;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Width from which an event has its gateway and subject in columns of their own.
const WIDE: u16 = 60;

/// Draws the status lines and the banners.
pub fn draw(brush: &mut FleetBrush) {
    let area = brush.regions.status;
    let broker = link_line(brush);
    let sums = sums_line(brush);
    if area.height < 2 {
        brush.line(area, 0, &sums);
    } else {
        brush.line(area, 0, &broker);
        brush.line(area, 1, &sums);
    }
    let banners = brush.regions.banners;
    for (row, (text, is_error)) in brush.screen.banners().into_iter().enumerate() {
        let role = if is_error { Role::Error } else { Role::Warning };
        let line = Line::from(brush.span(role, text));
        brush.line(banners, row as u16, &line);
    }
}

fn link_line(brush: &FleetBrush) -> Line<'static> {
    let (sign, role, word) = match brush.screen.link() {
        BrokerLink::Connecting => ("·", Role::Muted, "connecting"),
        BrokerLink::Reading => ("●", Role::Online, "connected, reading"),
        BrokerLink::Connected => ("●", Role::Online, "connected"),
        BrokerLink::Failed { .. } => ("○", Role::Error, "no connection"),
    };
    Line::from(vec![
        brush.span(Role::Title, format!(" {}", brush.screen.options().broker)),
        brush.span(role, format!("  {sign} {word}")),
    ])
}

/// The sums with words if they fit in the line, otherwise those of devices, then all with signs only.
fn sums_line(brush: &FleetBrush) -> Line<'static> {
    let width = usize::from(brush.regions.whole.width);
    let forms = [(true, true), (true, false)].map(|words| sums_as(brush, words));
    let fitting = forms.into_iter().find(|line| line.width() <= width);
    fitting.unwrap_or_else(|| sums_as(brush, (false, false)))
}

/// The sums, with words for gateways and for devices.
fn sums_as(brush: &FleetBrush, (of_gateways, of_devices): (bool, bool)) -> Line<'static> {
    let sums = brush.screen.sums();
    let count: usize = sums.states.iter().sum();
    let word = match count {
        _ if !of_gateways => "",
        1 => " gateway",
        _ => " gateways",
    };
    let mut spans = vec![brush.span(Role::Title, format!(" {}{word}", grouped(count as u64)))];
    let of_count = |number: usize, (sign, role): (&str, Role), word: &str, has_words: bool| {
        let number = grouped(number as u64);
        let text = match (has_words, of_gateways) {
            (true, _) => format!("  {sign} {number} {word}"),
            (false, true) => format!("  {sign} {number}"),
            (false, false) => format!(" {sign}{number}"),
        };
        Span::styled(text.trim_end().to_owned(), brush.theme.style(role))
    };
    for (state, number) in FleetSums::STATES.iter().zip(sums.states) {
        if number > 0 {
            spans.push(of_count(number, of_state(*state), state.name(), of_gateways));
        }
    }
    spans.push(if of_gateways {
        brush.span(Role::Title, "    devices")
    } else {
        brush.span(Role::Muted, "  dev")
    });
    spans.push(of_count(sums.present, ("●", Role::Online), "present", of_devices));
    let problems = [
        (sums.lost, ("○", Role::Lost), "lost"),
        (sums.last_known, of_state(GatewayState::Unknown), "last known"),
        (sums.confirmed, ("⚠", Role::Confirmed), ""),
        (sums.suspected, ("?", Role::Suspected), ""),
    ];
    for (number, sign, word) in problems {
        if number > 0 {
            spans.push(of_count(number, sign, word, of_devices));
        }
    }
    Line::from(spans)
}

/// Draws the rule with the names of the pages, the filter and the opened gateway.
pub fn draw_tabs(brush: &mut FleetBrush) {
    let area = brush.regions.tabs;
    set_rule(brush.buffer, area, brush.theme.style(Role::Border));
    let mut end = 0;
    for (page, start, text) in brush.screen.tabs() {
        let role = if page == brush.screen.page() { Role::TabActive } else { Role::Tab };
        end = start + text.width() as u16;
        let line = Line::from(brush.span(role, text));
        let width = area.width.saturating_sub(start);
        brush.line(Rect { x: start, width, ..area }, 0, &line);
    }
    let right = right_of_tabs(brush);
    let width = right.width() as u16;
    let room = area.width.saturating_sub(end);
    if width > 0 && room > 4 {
        let width = width.min(room - 1);
        let at = Rect { x: area.right() - width, width, ..area };
        brush.line(at, 0, &right);
    }
}

/// The filter of the page, the opened gateway, and that what is shown is old.
fn right_of_tabs(brush: &FleetBrush) -> Line<'static> {
    let screen = brush.screen;
    let mut spans = Vec::new();
    let filter = screen.filter();
    if filter.is_on {
        let counts = format!(" {} of {} ", screen.rows().len(), screen.row_total());
        spans.push(brush.span(Role::Match, format!(" / {}", filter.text)));
        spans.push(brush.span(Role::Muted, counts));
    }
    if let Some(name) = screen.opened() {
        spans.push(brush.span(Role::Title, format!(" {name} ")));
        if let Some(row) = screen.gateway_row(name) {
            let (sign, role) = of_state(row.state);
            let age = age_text(screen, &row);
            spans.push(brush.span(role, format!("{sign} {} {age} ", row.state.name())));
        }
    }
    if let (true, BrokerLink::Failed { since, .. }) = (screen.is_old(), screen.link()) {
        spans.push(brush.span(Role::Frozen, format!(" AS OF {} ", screen.wall_clock_at(*since))));
    }
    Line::from(spans)
}

/// Draws the last events, of the opened gateway or of all, the newest at the bottom.
pub fn draw_latest(brush: &mut FleetBrush) {
    let area = brush.regions.latest;
    if area.height == 0 {
        return;
    }
    let below = brush.titled(area, "latest");
    let opened = brush.screen.opened();
    let last = brush.screen.events().last(opened).take(usize::from(below.height));
    let mut lines: Vec<Line> = last.map(|event| event_line(brush, event)).collect();
    lines.reverse();
    if lines.is_empty() {
        lines.push(Line::from(brush.span(Role::Muted, " no event since descan fleet was started")));
    }
    for (row, line) in lines.iter().enumerate() {
        brush.line(below, row as u16, line);
    }
}

fn event_line(brush: &FleetBrush, event: &FleetEvent) -> Line<'static> {
    let (sign, role) = match event.kind {
        FleetEventKind::Device => ("~", Role::Text),
        FleetEventKind::Absence => ("○", Role::Lost),
        FleetEventKind::Confirmed => ("⚠", Role::Confirmed),
        FleetEventKind::Suspected => ("?", Role::Suspected),
        FleetEventKind::Other => ("·", Role::Muted),
    };
    let is_wide = brush.regions.whole.width >= WIDE;
    let time = fit(&brush.screen.wall_clock(event.time), 8);
    let gateway = match brush.screen.opened() {
        Some(_) => String::new(),
        None => format!("{} ", fit(event.gateway.as_str(), if is_wide { 16 } else { 8 })),
    };
    let subject = fit(&event.subject, if is_wide { 16 } else { 9 });
    Line::from(vec![
        brush.span(Role::Muted, format!(" {time} ")),
        brush.span(role, format!("{sign} ")),
        brush.span(Role::Title, gateway),
        brush.span(Role::Text, format!("{subject} ")),
        brush.span(role, event.text.clone()),
    ])
}
