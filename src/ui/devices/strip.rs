//! The heartbeat strip: a cell for each heartbeat period of a device.

use crate::app::{Beat, BeatKind};
use crate::theme::Role;
use crate::time::Duration;
use crate::ui::brush::DrawContext;
use ratatui::text::Span;

/// Returns the sign of a cell and its role.
pub fn sign(kind: BeatKind) -> (&'static str, Role) {
    match kind {
        BeatKind::OnTime => ("▂", Role::Beat),
        BeatKind::OffTime => ("▅", Role::BeatBad),
        BeatKind::Double => ("█", Role::BeatBad),
        BeatKind::Missed => ("×", Role::BeatBad),
        BeatKind::Unknown => ("·", Role::Muted),
    }
}

/// Returns the cells in exactly `width` cells of the terminal, newest at the right; `·` before the
/// first heartbeat.
pub fn spans(brush: &DrawContext, beats: &[Beat], width: usize) -> Vec<Span<'static>> {
    let unknown = width.saturating_sub(beats.len());
    let shown = &beats[beats.len().saturating_sub(width)..];
    let kinds = std::iter::repeat_n(BeatKind::Unknown, unknown);
    let kinds: Vec<BeatKind> = kinds.chain(shown.iter().map(|beat| beat.kind)).collect();
    let runs = kinds.chunk_by(|a, b| a == b);
    runs.map(|run| {
        let (sign, role) = sign(run[0]);
        brush.span(role, sign.repeat(run.len()))
    })
    .collect()
}

/// Returns a heartbeat period in at most 7 cells: `1.00 s`, `50 ms`.
pub fn period_text(period: Duration) -> String {
    match period.as_secs_f64() {
        ..0.1 => format!("{} ms", period.as_millis()),
        seconds @ ..100.0 => format!("{seconds:.2} s"),
        seconds => format!("{seconds:.0} s"),
    }
}

/// Returns a jitter in at most 6 cells: `±2 ms`, `±0.1 s`.
pub fn jitter_text(jitter: Duration) -> String {
    let millis = jitter.as_secs_f64() * 1000.0;
    if millis < 99.5 {
        format!("±{millis:.0} ms")
    } else if millis < 9950.0 {
        format!("±{:.1} s", millis / 1000.0)
    } else if millis < 99_500.0 {
        format!("±{:.0} s", millis / 1000.0)
    } else if millis < 99.0 * 60_000.0 {
        format!("±{:.0}min", millis / 60_000.0)
    } else {
        "±>99 m".to_owned()
    }
}

/// Returns a number in at most 4 cells: `9999`, `12k`, `>1M`.
pub fn count_text(count: u64) -> String {
    match count {
        0..10_000 => count.to_string(),
        10_000..1_000_000 => format!("{}k", count / 1000),
        _ => ">1M".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_fit_their_columns() {
        for micros in [0, 999, 99_999, 999_999, 1_004_000, 99_990_000, 3_600_000_000] {
            let time = Duration::from_micros(micros);
            assert!(period_text(time).chars().count() <= 7, "{}", period_text(time));
            assert!(jitter_text(time).chars().count() <= 6, "{}", jitter_text(time));
        }
        for count in [0, 9999, 10_000, 999_999, u64::MAX] {
            assert!(count_text(count).len() <= 4, "{}", count_text(count));
        }
        assert_eq!(period_text(Duration::from_secs(1)), "1.00 s");
        assert_eq!(jitter_text(Duration::from_millis(2)), "±2 ms");
    }
}
