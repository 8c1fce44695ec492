//! The evidence of a problem as a table: time, board, what a frame shows, its content.

use super::super::brush::{DrawContext, fit, fit_right};
use super::super::traffic::in_words;
use super::boards::side_span;
use crate::app::{ConflictSides, Decoded, EvidenceItem, clock_millis};
use crate::cell_text::cut;
use crate::frame::{CanId, Frame};
use crate::text::hex;
use crate::theme::Role;
use crate::wire::id::Header;
use ratatui::text::Line;
use unicode_width::UnicodeWidthStr;

/// Columns from which the table has NAME, ID and DATA: on a screen of 120.
const WIDE: u16 = 119;
/// Columns from which it has MODE and UID.
const WITH_UID: u16 = 64;
const TIME: usize = 14;
const SIDE: usize = 6;
const MODE: usize = 7;
const UID: usize = 10;
const NAME: usize = 8;
const ID: usize = 10;
/// Cells of the number of pieces at the end of the heading: `16 of 45`.
const COUNT: usize = 9;
/// Cells of eight bytes in hexadecimal digits.
const DATA: usize = 24;

/// The pieces of evidence of a problem, and how they are shown.
pub struct EvidenceTable<'t> {
    /// Stored pieces, oldest first.
    pub pieces: &'t [EvidenceItem],
    /// Number of all.
    pub count: u64,
    /// The boards of a conflict.
    pub sides: Option<&'t ConflictSides>,
    /// Cells of a line.
    pub width: u16,
}

/// What the columns say of a frame.
#[derive(Default)]
struct FrameCells {
    mode: String,
    uid: String,
    name: String,
}

impl EvidenceTable<'_> {
    /// Cells of the column WHAT IT SHOWS.
    fn what_width(&self) -> usize {
        let mut taken = 1 + TIME;
        taken += if self.sides.is_some() { SIDE } else { 0 };
        if self.has_uid() {
            taken += MODE + UID;
        }
        if self.width >= WIDE {
            taken += NAME + ID + DATA + 1;
        } else if self.has_uid() {
            taken += COUNT;
        }
        usize::from(self.width).saturating_sub(taken + 1)
    }

    fn has_uid(&self) -> bool {
        self.sides.is_some() && self.width >= WITH_UID
    }

    /// The heading.
    pub fn heading(&self, brush: &DrawContext) -> Line<'static> {
        let stored = self.pieces.len() as u64;
        let count = self.count.max(stored);
        let count = match count {
            1 => "1 event".to_owned(),
            _ if count > stored => format!("{stored} of {count}"),
            _ => format!("{count} events"),
        };
        let mut title = format!(" {}", fit("EVIDENCE", TIME));
        if self.sides.is_some() {
            title += &fit("SIDE", SIDE);
        }
        title += &fit("WHAT IT SHOWS", self.what_width());
        if self.has_uid() {
            title += &fit("MODE", MODE);
            title += &fit("UID", UID);
        }
        if self.width >= WIDE {
            for (name, width) in [("NAME", NAME), ("ID", ID), ("DATA", DATA)] {
                title += &fit(name, width);
            }
        }
        let room = usize::from(self.width).saturating_sub(1);
        let start = cut(&title, room.saturating_sub(count.width() + 1)).to_owned();
        let rest = fit_right(&count, room.saturating_sub(start.width()));
        Line::from(vec![brush.span(Role::Header, start), brush.span(Role::Muted, rest)])
    }

    /// What a piece shows; of a further response also how long after the one before.
    fn what(&self, at: usize) -> String {
        let piece = &self.pieces[at];
        let before = at.checked_sub(1).map(|before| &self.pieces[before]);
        let is_pair = |before: &&EvidenceItem| {
            before.what.contains("first response") && piece.what.contains("second response")
        };
        match before.filter(is_pair) {
            Some(before) => {
                let later = piece.time.since(before.time).as_secs_f64() * 1000.0;
                format!("{}, {later:.1} ms later", piece.what.replace(" to one request", ""))
            }
            None => piece.what.clone(),
        }
    }

    /// The line of the piece at this place.
    pub fn line(&self, brush: &DrawContext, at: usize, selected: bool) -> Line<'static> {
        let piece = &self.pieces[at];
        let mut spans = vec![
            brush.span(Role::Text, if selected { "▸" } else { " " }),
            brush.span(Role::Muted, fit(&clock_millis(brush.app, piece.time), TIME)),
        ];
        let cells = piece.frame.map(|frame| cells_of(brush, &frame)).unwrap_or_default();
        if let Some(sides) = self.sides {
            let side = piece.frame.and_then(|frame| brush.app.side_of_frame(sides, &frame));
            let is_beat = !cells.mode.is_empty() || !cells.uid.is_empty();
            spans.push(side_span(brush, side, is_beat));
            spans.push(brush.span(Role::Text, " ".repeat(SIDE - 1)));
        }
        let what = fit(&self.what(at), self.what_width().saturating_sub(1));
        spans.push(brush.span(Role::Text, format!("{what} ")));
        let dash = |text: String| if text.is_empty() { "–".to_owned() } else { text };
        if self.has_uid() {
            spans.push(brush.span(Role::Text, fit(&dash(cells.mode), MODE)));
            spans.push(brush.span(Role::Text, fit(&dash(cells.uid), UID)));
        }
        if self.width >= WIDE {
            spans.push(brush.span(Role::Text, fit(&dash(cells.name), NAME)));
            let (id, data) = piece.frame.map_or((String::new(), String::new()), |frame| {
                (frame.id.to_string(), hex(frame.data(), " "))
            });
            spans.push(brush.span(Role::Muted, fit(&dash(id), ID)));
            spans.push(brush.span(Role::Muted, fit(&data, DATA)));
        }
        Line::from(spans)
    }
}

/// Below a piece: its frame in words and as bytes.
pub fn frame_line(brush: &DrawContext, piece: &EvidenceItem) -> Option<Line<'static>> {
    let frame = piece.frame.as_ref()?;
    Some(Line::from(vec![
        brush.span(Role::Text, format!("   {}  ", in_words(brush, frame))),
        brush.span(Role::Muted, frame.to_string()),
    ]))
}

fn cells_of(brush: &DrawContext, frame: &Frame) -> FrameCells {
    let CanId::Extended(id) = frame.id else { return FrameCells::default() };
    let (profile, header) = (brush.app.profile(frame.bus), Header::decode(id));
    if !header.response {
        return FrameCells::default();
    }
    if header.service == profile.heartbeat_service() {
        let beat = profile.heartbeat_of(frame.data());
        let mode = beat.mode.map_or(String::new(), |mode| mode.name().to_owned());
        let uid = beat.uid.map_or(String::new(), |uid| brush.app.uid_text(frame.bus, uid));
        return FrameCells { mode, uid, name: String::new() };
    }
    let text = Decoded::of(brush.app, frame).text;
    let name = text.strip_prefix("name ").map_or(String::new(), str::to_owned);
    FrameCells { name, ..FrameCells::default() }
}
