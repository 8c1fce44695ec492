//! Drawing tools of all regions: lines, lists and rules in cells, styled by [`Role`]. Inputs: lines
//! of text and an area. Text that does not fit is cut with `…`, scrolled, or wrapped. Widths are in
//! cells of the terminal (a wide character takes two).

use crate::app::{App, Bus, Focus, Page, Screen};
use crate::cell_text::{cut, wrap};
use crate::frame::BusIndex;
use crate::keymap::Action;
use crate::text::Escaped;
use crate::theme::{Role, Theme};
use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};
use ratatui::style::{Modifier, Style};
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// State of one draw: what is shown, its colours, the regions, and the cells to fill.
pub struct DrawContext<'a> {
    /// What is shown; read only.
    pub app: &'a App,
    /// The style of each role.
    pub theme: &'a Theme,
    /// The regions, for the size of the buffer.
    pub screen: Screen,
    /// The cells of the terminal.
    pub buffer: &'a mut Buffer,
    /// Position of the terminal's cursor; `None` hides it (no prompt is open).
    pub cursor: Option<Position>,
    /// Lines by which the scrolled text (details, help) is scrolled, at most to its end; `None` if
    /// the page has none.
    pub scrolled: Option<u16>,
    /// Cells of the title of a panel that takes the place of the page.
    pub panel_title: u16,
}

/// Returns `area` without its first and last column.
pub fn inner(area: Rect) -> Rect {
    Rect { x: area.x + 1, width: area.width.saturating_sub(2), ..area }
}

impl DrawContext<'_> {
    /// Returns the style of a role in the theme.
    pub fn style(&self, role: Role) -> Style {
        self.theme.style(role)
    }

    /// Returns text in the style of a role.
    pub fn span(&self, role: Role, text: impl Into<String>) -> Span<'static> {
        Span::styled(text.into(), self.style(role))
    }

    /// Draws a line into row `row` of an area, cut at its end with `…`; nothing below the area.
    pub fn line(&mut self, area: Rect, row: u16, line: &Line) {
        set_line(self.buffer, self.theme, area, row, line);
    }

    /// Draws lines from the top of an area without the first `scroll`; `scroll` is limited so that
    /// the last line stays at the bottom. The last row gives the number of lines below the area.
    pub fn lines(&mut self, area: Rect, lines: &[Line], scroll: u16) {
        let height = usize::from(area.height);
        let hidden = lines.len().saturating_sub(height);
        let scroll = usize::from(scroll).min(hidden);
        self.scrolled = self.scrolled.max(u16::try_from(scroll).ok());
        let is_more = hidden > scroll && height > 0;
        let height = height - usize::from(is_more);
        for (row, line) in lines.iter().skip(scroll).take(height).enumerate() {
            self.line(area, row as u16, line);
        }
        if is_more {
            let more = format!("↓ {} more", lines.len() - scroll - height);
            let line = Line::from(self.span(Role::Muted, more));
            self.line(area, area.height - 1, &line);
        }
    }

    /// Draws, in place of an empty list, that the filter matches nothing (`what`) and the key that
    /// clears it. While a line is entered, no key does.
    pub fn draw_no_match(&mut self, area: Rect, what: &str) {
        // Otherwise the first Esc closes something, or goes to the present.
        let view = self.app.view();
        let is_next = view.frozen.is_none()
            && view.call_list().is_none()
            && !(view.page == Page::Traffic && view.frame_details)
            && view.focus == Focus::List;
        let action = if is_next { Action::Cancel } else { Action::FilterToggle };
        let key = || format!("{what}; {} switches it off", self.app.key_of(action));
        let text = self.app.prompt().map_or_else(key, |_| what.to_owned());
        let below = Rect { y: area.y + 1, height: area.height.saturating_sub(1), ..area };
        let lines = labelled(self, "  ", Role::Muted, &text, area.width.saturating_sub(1));
        self.lines(below, &lines, 0);
    }

    /// Draws, in place of an empty list, why it is empty, and for each bus that is not up the
    /// cause.
    pub fn draw_empty_list(&mut self, list: Rect, why: &str) {
        let mut lines = labelled(self, "   ", Role::Muted, why, list.width);
        for bus in self.app.buses().iter().filter(|bus| bus.cannot_receive() || bus.ended.is_some())
        {
            let name = Escaped(bus.name.as_bytes());
            let text = match &bus.status.fault {
                Some(fault) => Escaped(fault.to_string().as_bytes()).to_string(),
                None if bus.ended.is_some() => continue,
                None => format!("{name} is not up"),
            };
            lines.push(Line::default());
            lines.extend(labelled(self, "   ", Role::Warning, &text, list.width));
        }
        let below = Rect { y: list.y + 1, height: list.height.saturating_sub(1), ..list };
        self.lines(below, &lines, 0);
    }

    /// Returns true if at least one bus is not up.
    pub fn cannot_receive(&self) -> bool {
        self.app.buses().iter().any(Bus::cannot_receive)
    }

    /// Fills an area with a horizontal rule.
    pub fn rule(&mut self, area: Rect, role: Role) {
        set_rule(self.buffer, area, self.theme.style(role));
    }

    /// Draws the rule with the title of a panel that takes the place of the page; returns the area
    /// below it.
    pub fn panel(&mut self, title: &str) -> Rect {
        let whole = self.screen.whole;
        let rule = Rect { height: self.screen.tabs.height, y: self.screen.tabs.y, ..whole };
        self.rule(rule, Role::BorderFocus);
        let title = Line::from(self.span(Role::TabActive, title.to_owned()));
        self.panel_title = title.width() as u16;
        let room = super::moment::start(self).saturating_sub(2);
        self.line(Rect { x: 1, width: room, ..rule }, 0, &title);
        let y = rule.bottom();
        Rect { y, height: self.screen.footer.y.saturating_sub(y), ..whole }
    }

    /// Gives all cells of an area the colours of a role; their other attributes stay.
    pub fn fill(&mut self, area: Rect, role: Role) {
        let style = self.style(role);
        self.buffer.set_style(area, style);
    }

    /// Lays the style of the selected row over it: its background and attributes; each cell keeps its
    /// own colour, unless the theme gives one.
    pub fn select(&mut self, area: Rect, row: u16) {
        set_selected(self.buffer, self.theme, area, row);
    }
}

/// Returns the style of ordinary text on the painted background, in place of any other.
fn plain(theme: &Theme) -> Style {
    let background = Style { bg: theme.style(Role::Background).bg, ..Style::new() };
    Style::reset().patch(background).patch(theme.style(Role::Text))
}

/// Draws a line into row `row` of an area, cut at its end with `…`; nothing below the area.
pub fn set_line(buffer: &mut Buffer, theme: &Theme, area: Rect, row: u16, line: &Line) {
    if row >= area.height || area.width == 0 {
        return;
    }
    let width = usize::from(area.width);
    let (x, y) = (area.x, area.y + row);
    // A role without a colour gets the colour of text, not the one drawn here before.
    let covered = line.width().min(width) as u16;
    buffer.set_style(Rect { x, y, width: covered, height: 1 }, plain(theme));
    if text_width(line) <= width {
        buffer.set_line(x, y, line, area.width);
        return;
    }
    let mut left = width.saturating_sub(1);
    let mut at = x;
    let mut last = Style::new();
    for span in &line.spans {
        let text = cut(&span.content, left);
        left -= text.width();
        buffer.set_stringn(at, y, text, width, span.style);
        at += text.width() as u16;
        last = span.style;
        if text.len() < span.content.len() {
            break;
        }
    }
    buffer.set_stringn(at, y, "…", 1, last);
}

/// Cells of a line without the blanks at its end.
fn text_width(line: &Line) -> usize {
    let is_blank = |span: &&Span| span.content.trim_end().is_empty();
    let blank: usize = line.spans.iter().rev().take_while(is_blank).map(Span::width).sum();
    let last = line.spans.iter().rev().find(|span| !is_blank(span));
    let end = last.map_or(0, |span| span.width() - span.content.trim_end().width());
    line.width() - blank - end
}

/// Fills an area with a horizontal rule.
pub fn set_rule(buffer: &mut Buffer, area: Rect, style: Style) {
    for y in area.top()..area.bottom() {
        for x in area.left()..area.right() {
            buffer[(x, y)].set_symbol("─").set_style(style);
        }
    }
}

/// Writes the numbers of rows above and below the screen at the right end of the headings of a list; a
/// heading that would be cut by it gives way.
pub fn set_hidden_rows(
    buffer: &mut Buffer,
    theme: &Theme,
    header: Rect,
    (above, below): (usize, usize),
) {
    let text = match (above, below) {
        (0, 0) => return,
        (above, 0) => format!(" ↑{above}"),
        (0, below) => format!(" ↓{below}"),
        (above, below) => format!(" ↑{above} ↓{below}"),
    };
    let width = text.width() as u16;
    if header.height == 0 || width >= header.width {
        return;
    }
    let start = header.right() - width;
    let is_blank = |buffer: &Buffer, x: u16| buffer[(x, header.y)].symbol() == " ";
    let mut cut = start;
    while cut > header.left() && !is_blank(buffer, cut) && !is_blank(buffer, cut - 1) {
        cut -= 1;
    }
    for x in cut..start {
        buffer[(x, header.y)].set_symbol(" ");
    }
    buffer.set_string(start, header.y, text, theme.style(Role::Muted));
}

/// Lays the style of the selected row over it: its background and attributes; each cell keeps its own
/// colour, unless the theme gives one.
pub fn set_selected(buffer: &mut Buffer, theme: &Theme, area: Rect, row: u16) {
    if row >= area.height {
        return;
    }
    let row = Rect { y: area.y + row, height: 1, ..area };
    let style = theme.style(Role::Selected);
    if style.add_modifier.contains(Modifier::REVERSED) {
        // Reversed colours of each span would break the bar into patches.
        let plain = plain(theme);
        for x in row.left()..row.right() {
            let cell = &mut buffer[(x, row.y)];
            let keep = cell.modifier & Modifier::BOLD;
            cell.set_style(plain.add_modifier(keep));
        }
    }
    buffer.set_style(row, style);
}

/// Returns `text` in exactly `width` cells: cut with `…`, or padded with blanks at the right.
pub fn fit(text: &str, width: usize) -> String {
    let own = text.width();
    if own <= width {
        return format!("{text}{}", " ".repeat(width - own));
    }
    let start = cut(text, width.saturating_sub(1));
    let dots = if width > 0 { "…" } else { "" };
    let rest = width.saturating_sub(start.width() + dots.width());
    format!("{start}{dots}{}", " ".repeat(rest))
}

/// Returns `text` in exactly `width` cells: cut with `…`, or padded with blanks at the left.
pub fn fit_right(text: &str, width: usize) -> String {
    let own = text.width();
    if own < width { format!("{}{text}", " ".repeat(width - own)) } else { fit(text, width) }
}

/// Returns `text` if it fits `width` cells, else `…` and its end: for names that differ at their
/// end.
pub fn end_of(text: &str, width: usize) -> String {
    if text.width() <= width || width == 0 {
        return cut(text, width).to_owned();
    }
    let mut rest = text.chars();
    while rest.as_str().width() >= width {
        rest.next();
    }
    format!("…{}", rest.as_str())
}

/// Returns the name of a bus in at most `width` cells, different from the names of the other buses.
pub fn bus_label(app: &App, bus: BusIndex, width: usize) -> String {
    let name = app.bus(bus).map_or("", Bus::name_without_rates);
    if let Some(number) = app.shown_buses().number_of_equal(bus) {
        return format!("{}{number}", short_name(name, width.saturating_sub(number.width())));
    }
    let label = short_name(name, width);
    let others = app.buses().iter().map(Bus::name_without_rates).filter(|other| *other != name);
    let is_unique = others.into_iter().all(|other| short_name(other, width) != label);
    if is_unique { label } else { end_of(name, width) }
}

/// Returns a name in at most `width` cells: without its scheme, then without its folders, then
/// without the ending of a file, then without its middle. Names differ at their end.
pub fn short_name(name: &str, width: usize) -> String {
    let tail = name.split_once(':').map_or(name, |(_, tail)| tail);
    let last = tail.rsplit('/').next().unwrap_or(tail);
    // Not the last number of an IP address.
    let ending = last.rsplit_once('.').filter(|(_, end)| end.parse::<u8>().is_err());
    let stem = ending.map_or(last, |(stem, _)| stem);
    let fits = |it: &&str| it.width() <= width && !it.is_empty();
    if let Some(whole) = [name, tail, last, stem].into_iter().find(fits) {
        return whole.to_owned();
    }
    let start = cut(name, width.saturating_sub(1) / 3);
    format!("{start}{}", end_of(name, width - start.width()))
}

/// Returns the name of a des.json in at most `width` cells. Of one that a folder tells from others of the
/// same name, that folder: `north/…` of `north/des.json`.
pub fn short_file_name(name: &str, width: usize) -> String {
    match name.split_once('/') {
        Some((folder, _)) if name.width() > width => {
            let short = format!("{folder}/…");
            if short.width() <= width { short } else { end_of(folder, width) }
        }
        _ => fit(name, width).trim_end().to_owned(),
    }
}

/// Returns the name of a bus for the BUS column of Traffic and Timeline, 7 cells; blank for `None`.
pub fn bus_cell(app: &App, bus: Option<BusIndex>) -> String {
    format!("{} ", fit(&bus.map_or(String::new(), |bus| bus_label(app, bus, 6)), 6))
}

/// Returns lines of `width` cells: the label, muted, and the text wrapped at the right of it.
pub fn labelled(
    brush: &DrawContext,
    label: &str,
    role: Role,
    text: &str,
    width: u16,
) -> Vec<Line<'static>> {
    let indent = label.width();
    wrap(text, usize::from(width).saturating_sub(indent))
        .into_iter()
        .enumerate()
        .map(|(at, part)| {
            let label = if at == 0 { label.to_owned() } else { " ".repeat(indent) };
            Line::from(vec![brush.span(Role::Muted, label), brush.span(role, part)])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fit_text_has_exact_width() {
        assert_eq!(fit("FEED", 6), "FEED  ");
        assert_eq!(fit("FEEDER", 5), "FEED…");
        assert_eq!(fit("温度計", 5), "温度…");
        assert_eq!(fit("温度計", 4), "温… ");
        assert_eq!(fit("x", 0), "");
        assert_eq!(fit_right("12", 4), "  12");
    }
}
