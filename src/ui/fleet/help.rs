//! The keys of the screen, its signs, and the filter language.

use super::{FleetBrush, of_state};
use crate::app::{FILTER_FIELDS, FILTER_WORDS, FLEET_KEYS, FleetSums, RowKind};
use crate::cell_text::wrap;
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Cells of the key or sign.
const LABEL: usize = 16;

/// Draws the help in place of the page.
pub fn draw(brush: &mut FleetBrush, scroll: u16) {
    let regions = brush.regions;
    let top = regions.tabs.y;
    let height = regions.footer.y.saturating_sub(top);
    let area = Rect { y: top, height, ..regions.whole };
    let below = brush.titled(area, "Keys of descan fleet");
    let mut lines = Vec::new();
    keys(brush, &mut lines);
    signs(brush, &mut lines);
    filter(brush, &mut lines);
    brush.scrolled_lines(below, &lines, scroll, "");
}

fn title(brush: &FleetBrush, lines: &mut Vec<Line<'static>>, text: &str) {
    if !lines.is_empty() {
        lines.push(Line::default());
    }
    lines.push(Line::from(brush.span(Role::Title, format!(" {text}"))));
}

fn entry(
    brush: &FleetBrush,
    lines: &mut Vec<Line<'static>>,
    (role, label): (Role, &str),
    text: &str,
) {
    let width = usize::from(brush.regions.whole.width).saturating_sub(LABEL + 2);
    for (at, part) in wrap(text, width).into_iter().enumerate() {
        let label = if at == 0 { label } else { "" };
        lines.push(Line::from(vec![
            brush.span(role, format!(" {label:<LABEL$}")),
            brush.span(Role::Text, part),
        ]));
    }
}

fn keys(brush: &FleetBrush, lines: &mut Vec<Line<'static>>) {
    title(brush, lines, "Keys");
    for (action, doc) in FLEET_KEYS {
        let keys = brush.screen.options().keymap.keys_of(*action);
        let keys = keys.map(|key| key.to_string()).collect::<Vec<_>>().join(" ");
        let doc = if doc.is_empty() { action.info().doc } else { doc };
        if !keys.is_empty() {
            entry(brush, lines, (Role::HintKey, &keys), doc);
        }
    }
}

fn signs(brush: &FleetBrush, lines: &mut Vec<Line<'static>>) {
    title(brush, lines, "Signs");
    for state in FleetSums::STATES {
        let (sign, role) = of_state(state);
        let text = match state {
            crate::fleet::GatewayState::Online => "connected to the broker; FOR is since its start",
            crate::fleet::GatewayState::Silent => "connected, but no status for 75 s",
            crate::fleet::GatewayState::Stopped => "descan was ended there",
            crate::fleet::GatewayState::Lost => "its connection was lost; > is at least so long",
            crate::fleet::GatewayState::Unknown => "documents, but no status",
        };
        entry(brush, lines, (role, &format!("{sign} {}", state.name())), text);
    }
    let others = [
        (Role::Confirmed, "⚠ 2", "confirmed problems; as the sign of a gateway: a conflict"),
        (Role::Suspected, "? 1", "suspected problems"),
        (Role::Muted, "· 9 last known", "devices of gateways that are not online"),
        (Role::Changed, "≠", "other versions of the service are in use, too"),
    ];
    for (role, sign, text) in others {
        entry(brush, lines, (role, sign), text);
    }
}

fn filter(brush: &FleetBrush, lines: &mut Vec<Line<'static>>) {
    let rows = brush.screen.row_kind(brush.screen.page());
    title(brush, lines, &format!("Filter of {}", rows.plural()));
    if rows == RowKind::Gateway {
        let text = "gateways with such a device; each term may be about another one";
        entry(brush, lines, (Role::HintKey, "name: srv: at:"), text);
    }
    if matches!(rows, RowKind::Gateway | RowKind::Version | RowKind::Device) {
        let text = "service and version; srv:=AUGER@2.1 is exactly that";
        entry(brush, lines, (Role::HintKey, "srv:AUGER@2.1"), text);
    }
    for field in FILTER_FIELDS.iter().filter(|field| field.is_of(rows)) {
        let words = field.words.iter().map(|word| format!("{word}:")).collect::<Vec<_>>();
        let states = match rows {
            // Words of `is:` that a published device can have.
            RowKind::Device => {
                "online, stale, silent, asleep, lost, conflict, suspected".to_owned()
            }
            _ => rows.states().join(", "),
        };
        let doc = if field.is_state() { &states } else { field.doc };
        entry(brush, lines, (Role::HintKey, &words.join(" ")), doc);
    }
    for (word, doc) in FILTER_WORDS.iter().filter(|(word, _)| *word != "tx") {
        let doc = match (*word, rows) {
            ("err", RowKind::Gateway) => "gateways with a confirmed problem",
            ("err", RowKind::Device) => "devices in a conflict, confirmed or suspected",
            ("err", RowKind::Finding) => "confirmed problems",
            ("err", _) => continue,
            ("( )", _) => "group: not (a or b)",
            _ => doc,
        };
        entry(brush, lines, (Role::HintKey, word), doc);
    }
}
