//! Columns of the lists of a fleet: which fit, headings, cells.
//!
//! Inputs: columns and a width. Output: lines of exactly that width. Does not know what rows are.

use crate::app::FleetSort;
use crate::theme::{Role, Theme};
use crate::ui::brush::{fit, fit_right};
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Cells in front of the columns: selection, sign, blank.
const SIGN_CELLS: usize = 3;

/// A column.
#[derive(Clone, Copy, Debug)]
pub struct FleetColumn {
    pub title: &'static str,
    /// Cells; of the column that takes the rest, the least.
    pub width: usize,
    /// It takes the rest of the line.
    pub takes_rest: bool,
    pub is_number: bool,
    /// The order in which its heading has an arrow.
    pub sort: Option<FleetSort>,
    /// The greatest gives way first; 0 stays.
    pub gives_way: u8,
}

impl FleetColumn {
    pub const fn new(title: &'static str, width: usize, gives_way: u8) -> Self {
        let (takes_rest, is_number) = (false, false);
        Self { title, width, takes_rest, is_number, sort: None, gives_way }
    }

    pub const fn of_number(self) -> Self {
        Self { is_number: true, ..self }
    }

    pub const fn with_rest(self) -> Self {
        Self { takes_rest: true, ..self }
    }

    pub const fn sorted_by(self, sort: FleetSort) -> Self {
        Self { sort: Some(sort), ..self }
    }
}

/// The columns that fit, each with its place among all.
pub struct FleetTable {
    columns: Vec<(usize, FleetColumn)>,
}

impl FleetTable {
    /// Returns the columns that fit a line of `width` cells.
    pub fn new(columns: &[FleetColumn], width: usize) -> Self {
        let mut shown: Vec<(usize, FleetColumn)> = columns.iter().copied().enumerate().collect();
        let used = |shown: &[(usize, FleetColumn)]| {
            SIGN_CELLS + shown.iter().map(|(_, column)| column.width + 1).sum::<usize>() - 1
        };
        while shown.len() > 1 && used(&shown) > width {
            let last = shown.iter().enumerate().max_by_key(|(_, (_, it))| it.gives_way);
            match last.filter(|(_, (_, column))| column.gives_way > 0) {
                Some((at, _)) => drop(shown.remove(at)),
                None => break,
            }
        }
        let rest = width.saturating_sub(used(&shown));
        if let Some((_, column)) = shown.iter_mut().find(|(_, column)| column.takes_rest) {
            column.width += rest;
        }
        Self { columns: shown }
    }

    /// The headings.
    pub fn header(&self, theme: &Theme, (sort, is_reversed): (FleetSort, bool)) -> Line<'static> {
        let mut spans = vec![Span::raw(" ".repeat(SIGN_CELLS))];
        for (_, column) in &self.columns {
            let is_sorted = column.sort == Some(sort);
            let mut title = column.title.to_owned();
            if is_sorted && title.len() < column.width {
                title.push(if is_reversed { '↑' } else { '↓' });
            }
            let role = if is_sorted { Role::Title } else { Role::Header };
            spans.push(Span::styled(padded(&title, column), theme.style(role)));
            spans.push(Span::raw(" "));
        }
        spans.pop();
        Line::from(spans)
    }

    /// A row: its sign, and the texts of all columns, each in parts.
    pub fn row(
        &self,
        theme: &Theme,
        is_selected: bool,
        sign: (&str, Role),
        cells: &[Vec<(Role, String)>],
    ) -> Line<'static> {
        let marker = if is_selected { "▸" } else { " " };
        let mut spans = vec![
            Span::styled(marker, theme.style(Role::Text)),
            Span::styled(format!("{} ", sign.0), theme.style(sign.1)),
        ];
        for (at, column) in &self.columns {
            match cells.get(*at).map(Vec::as_slice) {
                Some([(role, text)]) => {
                    spans.push(Span::styled(padded(text, column), theme.style(*role)));
                }
                Some(parts) => spans.extend(in_parts(theme, parts, column.width)),
                None => spans.push(Span::raw(" ".repeat(column.width))),
            }
            spans.push(Span::raw(" "));
        }
        spans.pop();
        Line::from(spans)
    }
}

fn padded(text: &str, column: &FleetColumn) -> String {
    if column.is_number { fit_right(text, column.width) } else { fit(text, column.width) }
}

/// Parts beside each other, padded at the right.
fn in_parts(theme: &Theme, parts: &[(Role, String)], width: usize) -> Vec<Span<'static>> {
    let mut left = width;
    let mut spans = Vec::new();
    for (role, text) in parts {
        let own = text.width().min(left);
        spans.push(Span::styled(fit(text, own), theme.style(*role)));
        left -= own;
    }
    spans.push(Span::raw(" ".repeat(left)));
    spans
}
