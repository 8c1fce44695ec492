//! Draws the screen of `descan fleet`: its regions are those of [`crate::app::FleetRegions`].
//!
//! Inputs: the screen, read only, and a theme. Output: cells, and how far the help or the details could be
//! scrolled. Only the rows on the screen are made. All texts arrive here printable.

mod details;
mod footer;
mod help;
mod list;
mod status;
mod table;

use super::brush::{set_line, set_rule};
use super::{ascii, cut_marks};
use crate::app::{FleetRegions, FleetScreen, GatewayRow, Signs, format_duration};
use crate::fleet::GatewayState;
use crate::theme::{Role, Theme};
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};
use ratatui::text::{Line, Span};

/// State of one draw.
struct FleetBrush<'a> {
    screen: &'a FleetScreen,
    theme: &'a Theme,
    regions: FleetRegions,
    buffer: &'a mut Buffer,
    /// Position of the terminal's cursor; `None` hides it.
    cursor: Option<Position>,
    /// Lines by which the help or the details are scrolled, at most to their end.
    scrolled: Option<u16>,
}

impl FleetBrush<'_> {
    fn line(&mut self, area: Rect, row: u16, line: &Line) {
        set_line(self.buffer, self.theme, area, row, line);
    }

    fn span(&self, role: Role, text: impl Into<String>) -> Span<'static> {
        Span::styled(text.into(), self.theme.style(role))
    }

    /// Draws a rule with a title over the first row of an area; returns the area below.
    fn titled(&mut self, area: Rect, title: &str) -> Rect {
        let rule = Rect { height: area.height.min(1), ..area };
        set_rule(self.buffer, rule, self.theme.style(Role::Border));
        let line = Line::from(self.span(Role::Title, format!(" {title} ")));
        let inside = Rect { x: rule.x + 1, width: rule.width.saturating_sub(2), ..rule };
        self.line(inside, 0, &line);
        Rect { y: area.y + rule.height, height: area.height - rule.height, ..area }
    }

    /// Draws lines without the first `scroll`, at most so many that the last one is at the bottom. `way` says
    /// how the others are seen.
    fn scrolled_lines(&mut self, area: Rect, lines: &[Line], scroll: u16, way: &str) {
        let height = usize::from(area.height);
        let scroll = usize::from(scroll).min(lines.len().saturating_sub(height));
        self.scrolled = u16::try_from(scroll).ok();
        let shown = lines.iter().skip(scroll).take(height);
        shown.enumerate().for_each(|(row, line)| self.line(area, row as u16, line));
        let below = lines.len().saturating_sub(scroll + height);
        if below > 0 && height > 1 {
            let last = Rect { y: area.bottom() - 1, height: 1, ..area };
            self.buffer.set_style(last, self.theme.style(Role::Text));
            let blank = Line::from(" ".repeat(usize::from(area.width)));
            self.line(last, 0, &blank);
            let more = Line::from(self.span(Role::Muted, format!(" ↓ {} more{way}", below + 1)));
            self.line(last, 0, &more);
        }
    }
}

/// Draws the screen; returns how far the help or the details are scrolled.
pub fn draw_fleet(screen: &FleetScreen, theme: &Theme, frame: &mut Frame) -> Option<u16> {
    let regions = screen.regions();
    let buffer = frame.buffer_mut();
    buffer.set_style(buffer.area, theme.style(Role::Background));
    buffer.set_style(buffer.area, theme.style(Role::Text));
    let mut brush = FleetBrush { screen, theme, regions, buffer, cursor: None, scrolled: None };
    status::draw(&mut brush);
    if let Some(scroll) = screen.help() {
        help::draw(&mut brush, scroll);
    } else {
        status::draw_tabs(&mut brush);
        list::draw(&mut brush);
        details::draw(&mut brush);
        status::draw_latest(&mut brush);
    }
    footer::draw(&mut brush);
    cut_marks(brush.buffer);
    if screen.options().signs == Signs::Ascii {
        ascii::replace(brush.buffer);
    }
    let (cursor, scrolled) = (brush.cursor, brush.scrolled);
    if let Some(cursor) = cursor {
        frame.set_cursor_position(cursor);
    }
    scrolled
}

/// Sign and role of the state of a gateway.
const fn of_state(state: GatewayState) -> (&'static str, Role) {
    match state {
        GatewayState::Online => ("●", Role::Online),
        GatewayState::Silent => ("◌", Role::Silent),
        GatewayState::Stopped => ("◒", Role::Asleep),
        GatewayState::Lost => ("○", Role::Lost),
        GatewayState::Unknown => ("·", Role::Muted),
    }
}

/// How long a gateway has been in its state, in minutes from one on, so that rows at rest do not change:
/// `3d02h`, `>5m` where it may be longer, `–`.
fn age_text(screen: &FleetScreen, row: &GatewayRow) -> String {
    let Some((age, is_least)) = screen.state_age(row) else { return "–".to_owned() };
    let sign = if is_least { ">" } else { "" };
    match age.as_secs() {
        seconds @ 60..3600 => format!("{sign}{}m", seconds / 60),
        _ => format!("{sign}{}", format_duration(age)),
    }
}
