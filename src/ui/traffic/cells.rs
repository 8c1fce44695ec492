//! Cells of the rows of Traffic: route, bytes, intervals.

use super::super::brush::{DrawContext, fit, fit_right, short_name};
use crate::app::{Decoded, FrameRole};
use crate::frame::{Frame, FrameKind};
use crate::theme::Role;
use crate::time::Duration;
use ratatui::text::Span;

/// Cells of a name in the columns FROM and TO.
const NAME: usize = 6;
/// Cells of an address with its sign.
const ADDRESS: usize = 4;
/// Cells of eight bytes with blanks between them.
pub const BYTES: usize = 23;
/// Marks a frame that is evidence and in the capture.
pub const IN_CAPTURE: &str = "◆";

/// Returns sender, receiver and service; for a frame without them the identifier.
pub fn route(
    brush: &DrawContext,
    frame: &Frame,
    decoded: &Decoded,
    role: Role,
) -> Vec<Span<'static>> {
    if decoded.header.is_none() {
        let id = match frame.kind {
            FrameKind::Error => decoded.kind.to_owned(),
            _ => frame.id.to_string(),
        };
        return vec![brush.span(role, format!("{} ", fit(&id, 2 * NAME + 6)))];
    }
    vec![
        brush.span(role, fit_right(&decoded.source, NAME)),
        brush.span(Role::Muted, "→"),
        brush.span(role, format!("{} ", fit(&decoded.destination, NAME))),
        brush.span(role, format!("{} ", fit(&decoded.service, 4))),
    ]
}

/// Cells that the ends of a route take.
pub const fn width_of_ends(has_addresses: bool) -> usize {
    2 * (NAME + if has_addresses { ADDRESS } else { 0 }) + 1
}

/// Returns sender and receiver, with their addresses if there is room for them; for a frame without them
/// the name of its message, blank without one.
pub fn ends(
    brush: &DrawContext,
    decoded: &Decoded,
    has_addresses: bool,
    role: Role,
) -> Vec<Span<'static>> {
    let width = (width_of_ends(has_addresses) - 1) / 2;
    let Some(header) = decoded.header else {
        return vec![brush.span(role, fit(&decoded.message, 2 * width + 1))];
    };
    let end = |name: &str, address: String| {
        let name = short_name(name, NAME);
        if has_addresses && name != address { format!("{name}@{address}") } else { name }
    };
    let from = end(&decoded.source, header.source.to_string());
    let to = if header.broadcast {
        "all".to_owned()
    } else {
        end(&decoded.destination, header.destination.to_string())
    };
    vec![
        brush.span(role, fit_right(&from, width)),
        brush.span(Role::Muted, "→"),
        brush.span(role, fit(&to, width)),
    ]
}

/// Role of the KIND column.
pub const fn role_of(role: FrameRole) -> Role {
    match role {
        FrameRole::Request => Role::Request,
        FrameRole::Response => Role::Response,
        FrameRole::Debug => Role::Debug,
        FrameRole::FailedResponse | FrameRole::NonConforming | FrameRole::Error => Role::Error,
        FrameRole::Unsolicited | FrameRole::Standard | FrameRole::Remote | FrameRole::Foreign => {
            Role::Muted
        }
    }
}

/// Returns the first bytes in hexadecimal, as many as fit, `…` behind them if there are more; `role`
/// is that of each byte.
pub fn bytes(
    brush: &DrawContext,
    data: &[u8],
    width: usize,
    role: impl Fn(usize) -> Role,
) -> Vec<Span<'static>> {
    let fits = (width + 1) / 3;
    let has_more = data.len() > fits.min(8);
    let shown = if has_more { fits.saturating_sub(1).min(7) } else { data.len() };
    let mut spans: Vec<Span> = Vec::with_capacity(shown + 1);
    for (at, byte) in data[..shown].iter().enumerate() {
        let between = if at == 0 { "" } else { " " };
        // One span for each run of a role.
        let text = format!("{between}{byte:02X}");
        match spans.last_mut() {
            Some(last) if last.style == brush.style(role(at)) => {
                last.content.to_mut().push_str(&text);
            }
            _ => spans.push(brush.span(role(at), text)),
        }
    }
    if has_more {
        spans.push(brush.span(Role::Muted, " …"));
    }
    let used: usize = spans.iter().map(Span::width).sum();
    spans.push(brush.span(Role::Text, " ".repeat(width.saturating_sub(used))));
    spans
}

/// Returns a time in milliseconds, at most 7 cells: `0.8`, `145.0`, `12345`, `3.4 h`.
pub fn millis(time: Duration) -> String {
    let millis = time.as_secs_f64() * 1e3;
    match millis {
        _ if millis < 9999.95 => format!("{millis:.1}"),
        _ if millis < 9_999_999.5 => format!("{millis:.0}"),
        _ => format!("{:.1} h", millis / 3_600_000.0),
    }
}
