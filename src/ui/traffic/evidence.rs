//! The evidence of a problem: an event per row, its meaning, the content of its frame.

use super::super::brush::{DrawContext, bus_cell};
use super::cells::{IN_CAPTURE, route};
use crate::app::{Decoded, clock_millis};
use crate::theme::Role;
use ratatui::text::Line;

/// Marks evidence whose frame has left the capture; the finding has a copy.
const STORED_ONLY: &str = "◇";

/// Draws the evidence of a problem, an event per row: its meaning, then the content of the frame.
pub fn draw(brush: &mut DrawContext) {
    let (header, list) = (brush.screen.header, brush.screen.list);
    let Some(evidence) = brush.app.evidence_alone() else { return };
    let has_bus = brush.app.buses().len() > 1 && list.width >= 60;
    let with_route = list.width >= 60;
    let mut title = format!("  {:12} ", "TIME");
    if has_bus {
        title.push_str("BUS    ");
    }
    if with_route {
        title.push_str("  FROM TO     SRV  ");
    }
    title.push_str("EVIDENCE");
    let mut line = Line::from(brush.span(Role::Header, title));
    if evidence.count > evidence.pieces.len() as u64 {
        let text = format!("   {} of {} stored", evidence.pieces.len(), evidence.count);
        line.push_span(brush.span(Role::Muted, text));
    }
    brush.line(header, 0, &line);
    let selected = evidence.selected().map(|(place, _)| place);
    let (count, height) = (evidence.pieces.len(), usize::from(list.height));
    let top = evidence.cursor.top(selected, count, height);
    for (row, piece) in evidence.pieces.iter().skip(top).take(height).enumerate() {
        let is_selected = selected == Some(top + row);
        let sign = match &piece.frame {
            Some(frame) if brush.app.captured(frame).is_some() => IN_CAPTURE,
            Some(_) => STORED_ONLY,
            None => " ",
        };
        let mut spans = vec![
            brush.span(Role::Text, if is_selected { "▸" } else { " " }),
            brush.span(Role::Match, sign),
            brush.span(Role::Muted, format!("{} ", clock_millis(brush.app, piece.time))),
        ];
        let decoded = piece.frame.map(|frame| (frame, Decoded::of(brush.app, &frame)));
        if let Some((frame, decoded)) = &decoded {
            if has_bus {
                spans.push(brush.span(Role::Muted, bus_cell(brush.app, Some(frame.bus))));
            }
            if with_route {
                spans.extend(route(brush, frame, decoded, Role::Text));
            }
        }
        spans.push(brush.span(Role::Text, piece.what.clone()));
        if let Some((_, decoded)) =
            decoded.filter(|(_, decoded)| !decoded.text.is_empty() && decoded.text != piece.what)
        {
            spans.push(brush.span(Role::Muted, format!(": {}", decoded.text)));
        }
        brush.line(list, row as u16, &Line::from(spans));
        if is_selected {
            brush.select(list, row as u16);
        }
    }
}
