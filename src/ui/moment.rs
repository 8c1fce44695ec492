//! The shown moment at the right end of the page rule: `13:51:12 LIVE`, `13:51:20 FROZEN`,
//! `13:51:20 PLAY ×2`. The clock changes once a second, with a draw that is due anyway: on a bus
//! without devices and frames nothing is drawn, and only `LIVE` is shown, never a clock that stands.

use super::brush::DrawContext;
use super::status::{pace, past_word};
use crate::app::{Overlay, format_time_of_day};
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Width from which the rule has the views of the page, and goes on behind the moment, in columns.
const RULE_WIDTH: u16 = 60;
/// Cells of the title of a panel for which the clock gives way at most.
const MOST_TITLE: u16 = 60;

/// Returns what is shown and its text.
fn text(brush: &DrawContext) -> (Role, String) {
    let app = brush.app;
    let (role, word) = match app.playback() {
        _ if app.past_moment().is_some() => (Role::Frozen, past_word(app)),
        None => (Role::Title, "LIVE".to_owned()),
        Some(playback) if playback.is_ended => (Role::Muted, "END".to_owned()),
        Some(playback) if playback.is_paused => (Role::Warning, "PAUSED".to_owned()),
        Some(playback) if (playback.speed - 1.0).abs() < f64::EPSILON => {
            (Role::Title, "PLAY".to_owned())
        }
        Some(playback) => (Role::Title, format!("PLAY {}", pace(playback.speed))),
    };
    let stands = app.is_idle() && app.playback().is_none() && app.past_moment().is_none();
    let long = format!(" {} {word} ", format_time_of_day(app, app.display_time()));
    let short = format!(" {word} ");
    let end = tabs_end(brush);
    let width = brush.screen.tabs.width;
    if stands || long.width() > usize::from(width.saturating_sub(end)) {
        return (role, short);
    }
    // The clock gives way to the view or the filter of the page, and to the title of a panel.
    let (wanted, least) = if end == 0 {
        (brush.panel_title, brush.panel_title.min(MOST_TITLE))
    } else {
        super::tabs::title_cells(brush)
    };
    let beside = |text: &str| {
        let behind = u16::from(width >= RULE_WIDTH);
        width.saturating_sub(end + text.width() as u16 + behind)
    };
    // Without a word of its filter, a short list looks like the whole bus.
    let is_filtered = end > 0 && app.page_filter(app.view().page).is_on();
    let may_give_way = width >= RULE_WIDTH || is_filtered;
    let gives_way = may_give_way && beside(&long) <= wanted + 1 && beside(&short) > least + 1;
    (role, if gives_way { short } else { long })
}

/// Returns the column behind the names of the pages; 0 where a dialog takes the place of the page.
pub fn tabs_end(brush: &DrawContext) -> u16 {
    let is_page = matches!(
        brush.app.overlay(),
        Overlay::None | Overlay::Question(_) | Overlay::Prompt(_) | Overlay::Themes(_)
    );
    if !is_page || brush.app.composer_dialog().is_some() {
        return 0;
    }
    let tabs = brush.screen.tabs(brush.app.view().page, brush.app.counts());
    tabs.last().map_or(0, |(_, start, text)| start + text.width() as u16)
}

/// Returns the word for what is shown, for the time bar.
pub fn word(brush: &DrawContext) -> Span<'static> {
    let (role, text) = text(brush);
    let word = text.trim().trim_start_matches(|c: char| c.is_ascii_digit() || c == ':');
    brush.span(role, word.trim_start().to_owned())
}

/// Returns the column of the page rule from which the moment stands.
pub fn start(brush: &DrawContext) -> u16 {
    let area = brush.screen.tabs;
    let behind = u16::from(area.width >= RULE_WIDTH);
    area.right().saturating_sub(text(brush).1.width() as u16 + behind)
}

/// Draws the moment into the page rule.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.tabs;
    if area.height == 0 {
        return;
    }
    let (role, text) = text(brush);
    let start = start(brush).max(area.x);
    let line = Line::from(brush.span(role, text));
    brush.line(Rect { x: start, width: area.right() - start, ..area }, 0, &line);
}
