//! The changes between two bus statuses, as timeline texts.
//!
//! Pure: two statuses in, lines out.

use super::controller_status::ControllerStatus;
use crate::app::timeline_kind::TimelineKind;
use crate::status::{BusState, BusStatus, Link};
use crate::text::Escaped;

/// What a new status of a bus changed.
pub struct StatusChange {
    /// Timeline texts.
    pub lines: Vec<(TimelineKind, String)>,
    /// The controller has another state, whoever reported the one before.
    pub has_other_state: bool,
}

/// Returns the changes from `old` to `status`, one line each. `state_before`: that of the controller, which
/// error frames may have reported before the port did.
pub(super) fn status_changes(
    old: &BusStatus,
    status: &BusStatus,
    state_before: BusState,
) -> Vec<(TimelineKind, String)> {
    let shown = |text: &String| Escaped(text.as_bytes()).to_string();
    let mut lines = Vec::new();
    let is_another_log = old.log_changes < status.log_changes;
    if old.link != status.link && !(is_another_log && status.link == Link::Up) {
        lines.push(match status.link {
            Link::Opening => (TimelineKind::Bus, "opening".to_owned()),
            Link::Up if old.link == Link::Ended => {
                (TimelineKind::Bus, "log has grown: replay continues".to_owned())
            }
            Link::Up => (TimelineKind::Bus, "open".to_owned()),
            Link::Ended => (TimelineKind::Bus, "end of log".to_owned()),
            _ => (
                TimelineKind::Error,
                status.fault.as_ref().map_or("down".to_owned(), |it| shown(&it.to_string())),
            ),
        });
    }
    match (old.listens_first, status.listens_first) {
        (false, true) => {
            let text = "listen-only until a valid frame is received";
            lines.push((TimelineKind::Bus, text.to_owned()));
        }
        (true, false) if status.link == Link::Up => {
            lines.push((TimelineKind::Bus, "valid frame received: opened to send".to_owned()));
        }
        _ => {}
    }
    if status.filtered && !old.filtered {
        lines.push((
            TimelineKind::Bus,
            "receive filter on: only matching frames are read".to_owned(),
        ));
    }
    let stays_up = old.link == Link::Up && status.link == Link::Up;
    if stays_up && old.outages < status.outages {
        lines.push((TimelineKind::Error, "was briefly down".to_owned()));
    }
    let was_off = old.state == BusState::BusOff || status.state == BusState::BusOff;
    if stays_up && old.bus_offs < status.bus_offs && !was_off {
        lines.push((TimelineKind::Error, "was briefly bus-off".to_owned()));
    }
    if old.renamed != status.renamed {
        let text = match &status.renamed {
            Some(name) => format!("interface renamed to {}", shown(name)),
            None if status.link == Link::Up => "interface has its old name again".to_owned(),
            None => "renamed interface not found".to_owned(),
        };
        lines.push((TimelineKind::Bus, text));
    }
    if ![old.state, state_before].contains(&status.state) {
        let BusStatus { state, tec, rec, .. } = *status;
        lines.extend(controller_line(ControllerStatus { state, tec, rec, bus_offs: 0 }));
    }
    if old.bitrate != status.bitrate
        && let Some(bitrate) = status.bitrate
    {
        lines.push((TimelineKind::Bus, format!("{bitrate} bit/s")));
    }
    let is_new = |note: &&String| is_another_log || old.note.as_ref() != Some(note);
    if let Some(note) = status.note.as_ref().filter(is_new) {
        lines.push((TimelineKind::Bus, shown(note)));
    }
    match (old.is_transmit_queue_full, status.is_transmit_queue_full) {
        (false, true) => {
            lines.push((TimelineKind::Error, "transmit queue full: frames not sent".to_owned()));
        }
        (true, false) if status.link == Link::Up => {
            lines.push((TimelineKind::Bus, "transmit queue no longer full".to_owned()));
        }
        _ => {}
    }
    // Reported once: unreadable data arrives in bursts. The end of a log names its first line.
    if old.unreadable == 0 && status.unreadable > 0 && status.link != Link::Ended {
        lines.push((TimelineKind::Error, "unreadable data received (counted)".to_owned()));
    }
    for (before, now, why) in [
        (old.kernel_drops, status.kernel_drops, "the kernel's receive buffer was full"),
        (old.queue_drops, status.queue_drops, "descan's receive queue was full"),
        (old.controller_overruns, status.controller_overruns, "controller overrun"),
    ] {
        if before < now {
            lines.push((TimelineKind::Error, format!("frames lost: {why}")));
        }
    }
    lines
}

/// Returns the timeline text of the state of a controller; `None` if it is not known.
pub(in crate::app) fn controller_line(
    controller: ControllerStatus,
) -> Option<(TimelineKind, String)> {
    let ControllerStatus { state, tec, rec, .. } = controller;
    let kind = match state {
        BusState::Unknown => return None,
        BusState::ErrorActive => TimelineKind::Bus,
        BusState::ErrorWarning => TimelineKind::Overdue,
        _ => TimelineKind::Error,
    };
    let counters = match (tec, rec) {
        (Some(tec), Some(rec)) => format!(" (TEC {tec}, REC {rec})"),
        _ => String::new(),
    };
    Some((kind, format!("{state}{counters}")))
}
