//! The status lines at the top: one per bus (bit rate, state, load, frames per second, errors, lost
//! frames, own address), and one for des.json and the counts of devices and problems. On a screen
//! with one status line both share it. Parts that do not fit are left out, least important first.

use super::brush::{Brush, end_of, fit};
use crate::app::{Bus, FileProblem, LoadMeter, Overlay, TxBlocked};
use crate::discovery::OwnAddress;
use crate::frame::BusIndex;
use crate::keymap::Action;
use crate::status::{BusState, Link, size};
use crate::theme::Role;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use std::fmt::Write;

/// Stands in front of assumed values.
const ASSUMED: &str = "≈";

/// Parts of a line, most important first; a part is shown whole or left out.
type Parts = Vec<Vec<Span<'static>>>;

/// Draws the status lines.
pub fn draw(brush: &mut Brush) {
    let area = brush.screen.status;
    let buses = brush.app.buses().len();
    match area.height {
        0 => {}
        1 => {
            let left = bus_parts(brush, BusIndex(bus_to_show(brush, 0) as u8));
            let mut right: Parts = assumed(brush).into_iter().collect();
            let file = file(brush, false);
            // Unsaved edits and an unreadable file are the last to be left out.
            let (first, last) =
                if has_file_trouble(brush) { (None, Some(file)) } else { (Some(file), None) };
            right.extend(first.into_iter().flatten());
            right.extend(counts(brush));
            right.extend(recording(brush));
            right.extend(last.into_iter().flatten());
            add_muted(brush, area, &left, &mut right);
            let mut left = left;
            fit_parts(area, &mut left, &mut right);
            pair(brush, area, 0, left, right);
        }
        lines => {
            let shown = usize::from(lines - 1);
            for row in 0..shown.min(buses.max(1)) {
                let rest = buses > shown && row + 1 == shown;
                let index = if rest { bus_to_show(brush, row) } else { row };
                let mut parts = bus_parts(brush, BusIndex(index as u8));
                if rest {
                    let more = format!("bus {} of {buses}", index + 1);
                    parts.insert(1, vec![brush.span(Role::Muted, more)]);
                }
                shorten_name(area, &mut parts);
                pair(brush, area, row as u16, parts, Vec::new());
            }
            let mut left = file(brush, true);
            left.extend(assumed(brush));
            let mut right = counts(brush);
            right.extend(recording(brush));
            add_muted(brush, area, &left, &mut right);
            pair(brush, area, lines - 1, left, right);
        }
    }
}

/// Returns true if edits are unsaved or the file on disk cannot be used.
fn has_file_trouble(brush: &Brush) -> bool {
    let file = brush.app.file();
    file.unsaved() > 0
        || file.problem().is_some()
        || file.conflict().is_some()
        || file.emptied_since().is_some()
}

/// Returns the index of the bus shown on the last bus line if there are more buses than lines: of
/// those from `from` on, the first that is not up, else the bus of the selected row.
fn bus_to_show(brush: &Brush, from: usize) -> usize {
    let selected = brush.app.selected_row().and_then(|row| row.bus).unwrap_or_default();
    let selected = usize::from(selected.0).max(from);
    let is_hidden = |at: &usize| brush.app.buses().get(*at).is_some_and(Bus::is_blind);
    let others = from..brush.app.buses().len();
    std::iter::once(selected).chain(others).find(is_hidden).unwrap_or(selected)
}

/// Makes room on a single status line: leaves out `≈ assumed`, then cuts the beginning of the bus
/// name, then leaves out the right parts from the first.
fn fit_parts(area: Rect, left: &mut Parts, right: &mut Parts) {
    /// Cells that are left of a long bus name.
    const LEAST: usize = 6;
    let width = usize::from(area.width);
    let Some(part) = left.first_mut().filter(|part| !part.is_empty()) else { return };
    let (name, beside) = (part[0].width(), own(&part[1..]) + 1);
    let is_assumed = |part: &Vec<Span>| part.first().is_some_and(|span| span.content == ASSUMED);
    while right.first().is_some_and(|part| {
        let name = if is_assumed(part) { name } else { name.min(LEAST) };
        name + beside + whole(right) > width
    }) {
        right.remove(0);
    }
    let room = width.saturating_sub(beside + whole(right)).max(LEAST);
    part[0] = Span::styled(end_of(&part[0].content, room), part[0].style);
}

/// Cuts the beginning of a long bus name if not all parts fit.
fn shorten_name(area: Rect, parts: &mut Parts) {
    /// Cells that are left of a long bus name.
    const LEAST: usize = 12;
    let missing = (whole(parts).saturating_sub(2)).saturating_sub(usize::from(area.width));
    let Some(name) = parts.first_mut().and_then(|part| part.first_mut()) else { return };
    let room = name.width().saturating_sub(missing).max(LEAST);
    *name = Span::styled(end_of(&name.content, room), name.style);
}

/// Draws `left` from the left and `right` to the right end of a row. If not all fit, the last parts
/// of `left` and the first of `right` are left out.
fn pair(brush: &mut Brush, area: Rect, row: u16, left: Parts, mut right: Parts) {
    let width = usize::from(area.width);
    let first = left.first().map_or(0, |part| own(part) + 1);
    while !right.is_empty() && first + whole(&right) > width {
        right.remove(0);
    }
    let room = width.saturating_sub(whole(&right));
    let mut line = Line::default();
    for part in left {
        let space = if line.spans.is_empty() { " " } else { "  " };
        let free = room.saturating_sub(line.width() + space.len());
        if own(&part) > free && !line.spans.is_empty() {
            // Text is cut; numbers are shown whole or not at all.
            if let (Some(text), 12..) = (part.first(), free) {
                line.push_span(Span::raw(space));
                line.push_span(Span::styled(fit(&text.content, free), text.style));
            }
            break;
        }
        line.push_span(Span::raw(space));
        line.spans.extend(part);
    }
    brush.line(area, row, &line);
    let taken = whole(&right).min(width) as u16;
    let mut line = Line::default();
    for part in right {
        line.push_span(Span::raw("  "));
        line.spans.extend(part);
    }
    brush.line(Rect { x: area.right() - taken, width: taken, ..area }, row, &line);
}

/// Returns the cells of a part.
fn own(part: &[Span]) -> usize {
    part.iter().map(Span::width).sum()
}

/// Returns the cells of parts with the blanks between them.
fn whole(parts: &Parts) -> usize {
    match parts.len() {
        0 => 0,
        _ => parts.iter().map(|part| own(part) + 2).sum::<usize>() + 1,
    }
}

/// Adds the number of muted problems if nothing else has to be left out for it.
fn add_muted(brush: &Brush, area: Rect, left: &Parts, right: &mut Parts) {
    let muted = brush.app.counts().muted;
    if muted > 0 {
        let part = vec![brush.span(Role::Muted, format!("{muted} muted"))];
        if whole(left) + whole(right) + own(&part) + 2 <= usize::from(area.width) {
            right.push(part);
        }
    }
}

/// Returns the parts of the line of a bus.
fn bus_parts(brush: &Brush, index: BusIndex) -> Parts {
    let Some(bus) = brush.app.bus(index) else {
        return vec![vec![brush.span(Role::Muted, "no bus")]];
    };
    let text = |text: String| vec![brush.span(Role::Text, text)];
    let mut parts: Parts = Vec::new();
    let mut name = vec![brush.span(Role::Title, bus.name_without_rates().to_owned())];
    if let Some(now) = &bus.status.renamed {
        let now = crate::text::Escaped(now.as_bytes());
        name.push(brush.span(Role::Warning, format!(" (now {now})")));
    }
    if let Some(bitrate) = bus.status.bitrate {
        name.push(brush.span(Role::Text, format!(" {}", rate(bitrate))));
        if let Some(data) = bus.status.data_bitrate {
            name.push(brush.span(Role::Text, format!("/{}", rate(data))));
        }
    }
    let good = matches!(bus.status.state, BusState::ErrorActive | BusState::Unknown);
    if bus.is_up() && good {
        parts.push(name);
        parts.push(vec![state(brush, index, bus)]);
    } else {
        // One part with the name: a state that is not good is never left out.
        name.push(Span::raw("  "));
        name.push(state(brush, index, bus));
        parts.push(name);
    }
    parts.extend(place_in_log(brush, bus));
    if brush.app.view().frozen.is_some() {
        parts.insert(1, vec![brush.span(Role::Warning, "FROZEN")]);
    }
    let is_searched = brush.app.searches_bitrate_of(index);
    let message = bus.status.message.as_ref().filter(|_| !bus.is_up() && !is_searched);
    if let Some(message) = message {
        // The state in front of the message already is BUS-OFF.
        let known = format!("{} is bus-off: ", bus.name);
        let message = message.strip_prefix(&*known).unwrap_or(message);
        let message = crate::text::Escaped(message.as_bytes()).to_string();
        parts.push(vec![brush.span(Role::Error, message)]);
        return parts;
    }
    parts.extend(warning(brush, bus).filter(|_| !is_searched));
    let load = bus.meter.last().load(bus.bits_per_second()) * 100.0;
    let guess = if bus.status.bitrate.is_none() { ASSUMED } else { "" };
    let frames = bus.meter.last().frames;
    let errors = bus.counters().errors;
    let lost = bus.lost();
    parts.push(vec![
        brush.span(Role::Muted, "load "),
        brush.span(
            if load >= 80.0 { Role::Warning } else { Role::Text },
            format!("{:>4} ", format!("{guess}{load:.0}%")),
        ),
        brush.span(Role::Bar, sparkline(bus, if brush.screen.whole.width < 100 { 6 } else { 20 })),
    ]);
    parts.push(text(format!("{frames:>4} f/s")));
    parts.push(counter(brush, "err", errors, Role::Warning));
    let mut lost = counter(brush, "lost", lost, Role::Error);
    if brush.screen.whole.width >= 100 {
        lost.extend(lost_where(brush, bus));
    }
    parts.push(lost);
    parts.extend(own_address(brush, bus));
    parts
}

/// Returns position, percent and speed of a replay, and whether it is paused; `None` without a log.
fn place_in_log(brush: &Brush, bus: &Bus) -> Option<Vec<Span<'static>>> {
    let playback = brush.app.playback()?;
    let mut spans = Vec::new();
    if playback.is_paused {
        spans.push(brush.span(Role::Warning, "PAUSED "));
    }
    let seconds = brush.app.display_time().as_micros() / 1_000_000;
    let (hours, minutes, seconds) = (seconds / 3600, seconds / 60 % 60, seconds % 60);
    let mut text = match hours {
        0 => format!("{minutes}:{seconds:02}"),
        _ => format!("{hours}:{minutes:02}:{seconds:02}"),
    };
    if let Some(percent) = bus.status.percent {
        let _ = write!(text, " {percent}%");
    }
    if (playback.speed - 1.0).abs() > f64::EPSILON {
        let _ = match playback.speed {
            speed if speed < 0.995 => write!(text, " ×1/{:.0}", 1.0 / speed),
            speed => write!(text, " ×{speed}"),
        };
    }
    spans.push(brush.span(Role::Text, text));
    Some(spans)
}

fn counter(brush: &Brush, label: &str, count: u64, bad: Role) -> Vec<Span<'static>> {
    let role = if count > 0 { bad } else { Role::Text };
    vec![brush.span(Role::Muted, format!("{label} ")), brush.span(role, short(count))]
}

/// Returns where frames were lost: `(9 kernel, 3 queue)`; `None` if none were.
fn lost_where(brush: &Brush, bus: &Bus) -> Option<Span<'static>> {
    let places = [
        (bus.status.kernel_drops, "kernel"),
        (bus.status.queue_drops, "queue"),
        (bus.status.controller_overruns, "adapter"),
    ];
    let some = places.iter().filter(|(count, _)| *count > 0);
    let some: Vec<String> = some.map(|(count, at)| format!("{} {at}", short(*count))).collect();
    (!some.is_empty()).then(|| brush.span(Role::Muted, format!(" ({})", some.join(", "))))
}

/// Returns a count in at most five characters up to 9999M.
fn short(count: u64) -> String {
    match count {
        0..=99_999 => count.to_string(),
        100_000..=9_999_999 => format!("{}k", count / 1000),
        _ => format!("{}M", count / 1_000_000),
    }
}

/// Returns a bit rate as `125k`, `1M`, or in bit/s if it is not a multiple of 1000.
fn rate(bits: u32) -> String {
    match bits {
        0 => "0".to_owned(),
        _ if bits.is_multiple_of(1_000_000) => format!("{}M", bits / 1_000_000),
        _ if bits.is_multiple_of(1000) => format!("{}k", bits / 1000),
        _ => bits.to_string(),
    }
}

/// Returns the state of the interface and the controller as a word.
fn state(brush: &Brush, index: BusIndex, bus: &Bus) -> Span<'static> {
    let (word, role) = match (bus.status.link, bus.status.state) {
        (Link::Opening, _) => ("opening", Role::Muted),
        (Link::Down, _) | (Link::Up, BusState::Down) => ("DOWN", Role::Error),
        (Link::Missing, _) => ("MISSING", Role::Error),
        (Link::Unplugged, _) => ("UNPLUGGED", Role::Error),
        (Link::NotCan | Link::NoKernel | Link::Failed, _) => ("FAILED", Role::Error),
        (Link::Ended, _) => ("end of log", Role::Muted),
        (Link::Up, BusState::ErrorActive) => ("active", Role::Online),
        (Link::Up, BusState::Unknown) => ("open", Role::Online),
        (Link::Up, BusState::ErrorWarning) => ("WARNING", Role::Warning),
        (Link::Up, BusState::ErrorPassive) => ("PASSIVE", Role::Error),
        (Link::Up, BusState::BusOff) => ("BUS-OFF", Role::Error),
        (Link::Up, BusState::Stopped) => ("STOPPED", Role::Error),
    };
    if brush.app.searches_bitrate_of(index) {
        return brush.span(Role::Warning, "searching bit rate");
    }
    brush.span(role, word)
}

/// Returns why descan sends no requests; `None` if it does.
fn warning(brush: &Brush, bus: &Bus) -> Option<Vec<Span<'static>>> {
    if bus.hears_only_errors() {
        let keymap = brush.app.keymap();
        let key = keymap.keys_of(Action::BitRate).next();
        let key = key.map(|key| format!(" ({key})")).unwrap_or_default();
        let text = format!("only bus errors: wrong bit rate?{key}");
        return Some(vec![brush.span(Role::Error, text)]);
    }
    if bus.config().listen_only {
        // A controller that is not in listen-only mode itself still acknowledges frames.
        let acks = if bus.status.listen_only { "" } else { ", acks" };
        return Some(vec![brush.span(Role::Warning, format!("listen-only{acks}"))]);
    }
    let why = match bus.tx_blocked()? {
        TxBlocked::QueueFull => "transmit queue full",
        TxBlocked::Unacknowledged => "no ACK",
    };
    Some(vec![brush.span(Role::Error, why)])
}

/// Returns descan's own address or the state of its claim; `None` with `--listen-only`.
fn own_address(brush: &Brush, bus: &Bus) -> Option<Vec<Span<'static>>> {
    if bus.config().listen_only {
        return None;
    }
    let label = |text: String| vec![brush.span(Role::Muted, text)];
    Some(match bus.own_address() {
        OwnAddress::Held(address) => {
            vec![brush.span(Role::Muted, "own "), brush.span(Role::Text, address.to_string())]
        }
        OwnAddress::Blocked(Some(address)) => {
            vec![brush.span(Role::Error, format!("own {address} in use"))]
        }
        OwnAddress::Blocked(None) => vec![brush.span(Role::Error, "no free address")],
        OwnAddress::Claiming(address) => label(format!("own {address}?")),
        OwnAddress::Listening => label("listening".to_owned()),
        OwnAddress::None => label("own –".to_owned()),
    })
}

/// Returns the bus load of the last `width` seconds, newest at the right, a bar step per eighth of
/// the bit rate; a second without frames is blank.
fn sparkline(bus: &Bus, width: usize) -> String {
    const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let bitrate = bus.bits_per_second();
    let width = width.min(LoadMeter::SECONDS);
    let newest = bus.meter.seconds().rev().take(width);
    let mut bars: Vec<char> = newest
        .map(|second| match (second.frames, second.load(bitrate)) {
            (0, _) => ' ',
            (_, load) => BARS[((load * 8.0) as usize).min(7)],
        })
        .collect();
    bars.resize(width, ' ');
    bars.iter().rev().collect()
}

/// Returns the sign that a bus is read with assumed values (no profile given).
fn assumed(brush: &Brush) -> Option<Vec<Span<'static>>> {
    let assumed = brush.app.buses().iter().any(|bus| !bus.config().profile.given);
    assumed.then(|| vec![brush.span(Role::Suspected, ASSUMED), brush.span(Role::Muted, " assumed")])
}

/// Returns the counts of devices and problems; with words from 60 columns on.
fn counts(brush: &Brush) -> Parts {
    let counts = brush.app.counts();
    let narrow = brush.screen.whole.width < 60;
    let one = |role: Role, sign: &str, count: usize, word: &str| {
        let word = if narrow || word.is_empty() { String::new() } else { format!(" {word}") };
        vec![
            brush.span(role, format!("{sign} {count}")),
            brush.span(if count > 0 { role } else { Role::Muted }, word),
        ]
    };
    let mut parts = vec![one(Role::Online, "●", counts.here, "present")];
    if counts.unseen > 0 {
        parts.push(one(Role::Muted, "·", counts.unseen, "unknown"));
    }
    // Without words the signs of missing and lost are the same.
    let (missing, lost) =
        if narrow { (counts.missing + counts.lost, 0) } else { (counts.missing, counts.lost) };
    if missing > 0 {
        parts.push(one(Role::Missing, "○", missing, "missing"));
    }
    if lost > 0 {
        parts.push(one(Role::Lost, "○", lost, "lost"));
    }
    if counts.confirmed > 0 {
        parts.push(one(Role::Collision, "⚠", counts.confirmed, ""));
    }
    if counts.suspected > 0 {
        parts.push(one(Role::Suspected, "?", counts.suspected, ""));
    }
    parts
}

/// Returns size and lost frames of the recording, or that it stopped; `None` without `--record`.
/// Last of the right parts, so that it is left out last.
fn recording(brush: &Brush) -> Option<Vec<Span<'static>>> {
    let status = brush.app.recording()?;
    if status.failure.is_some() {
        return Some(vec![brush.span(Role::Error, "✗ rec stopped")]);
    }
    let mut spans = vec![
        brush.span(Role::Recording, "● rec"),
        brush.span(Role::Text, format!(" {}", size(status.bytes))),
    ];
    if status.lost > 0 {
        spans.push(brush.span(Role::Error, format!(" lost {}", short(status.lost))));
    }
    Some(spans)
}

/// Returns the state of des.json; with `whole` also the cause of an error and the next step.
fn file(brush: &Brush, whole: bool) -> Parts {
    let file = brush.app.file();
    let name = brush.span(Role::Title, file.name());
    let mut parts: Parts = Vec::new();
    if file.path().is_none() {
        return vec![vec![brush.span(Role::Muted, "no file")]];
    }
    let entries = file.document().entries().len();
    match file.problem() {
        Some(FileProblem::Syntax(error)) => {
            let text = if whole {
                format!(" ✗ {error}")
            } else {
                format!(" ✗ {}:{}", error.line, error.column)
            };
            parts.push(vec![name, brush.span(Role::Error, text)]);
            if whole && file.was_good() {
                // A part of its own: without room it is left out, not cut.
                let word = if entries == 1 { " entry" } else { " entries" };
                let text = format!(": {entries}{word}");
                let is_narrow = brush.screen.whole.width < 100;
                let valid = if is_narrow { "last valid" } else { "using last valid" };
                parts.push(vec![brush.span(Role::Muted, valid), brush.span(Role::Muted, text)]);
            }
            return parts;
        }
        Some(FileProblem::Unreadable(why)) => {
            let text = if whole { format!(" ✗ {why}") } else { " ✗".to_owned() };
            parts.push(vec![name, brush.span(Role::Error, text)]);
            return parts;
        }
        Some(FileProblem::NotSaved(why)) => {
            let text =
                if whole { format!(" ✗ not saved: {why}") } else { " ✗ not saved".to_owned() };
            parts.push(vec![name, brush.span(Role::Error, text)]);
            return parts;
        }
        None => {}
    }
    let unsaved = file.unsaved();
    if file.conflict().is_some() {
        parts.push(vec![name, brush.span(Role::Error, " ✗ conflict")]);
        if whole && !matches!(brush.app.overlay(), Overlay::Conflict) {
            let key = brush.app.key_of(Action::Save);
            parts.push(vec![brush.span(Role::Muted, format!("{key} resolves it"))]);
        }
    } else if unsaved > 0 {
        parts.push(vec![name, brush.span(Role::Warning, format!(" … saving {unsaved}"))]);
        if whole && file.emptied_since().is_some() {
            parts.push(vec![brush.span(Role::Muted, "empty (being written?)")]);
        }
    } else if file.emptied_since().is_some() {
        parts.push(vec![name, brush.span(Role::Warning, " empty (being written?)")]);
    } else if !file.is_read() {
        parts.push(vec![name, brush.span(Role::Muted, " …")]);
    } else if file.is_there() {
        let words = match (whole, entries) {
            (false, count) => format!(" {count}"),
            (true, 1) => " 1 entry".to_owned(),
            (true, count) => format!(" {count} entries"),
        };
        let findings = file.document().findings().len();
        let tick = if findings == 0 { " ✓" } else { "" };
        parts.push(vec![name, brush.span(Role::FileOk, tick), brush.span(Role::Text, words)]);
        if findings > 0 {
            parts.push(vec![brush.span(Role::Warning, format!("! {findings}"))]);
        }
    } else {
        parts.push(vec![name, brush.span(Role::Muted, " not found")]);
    }
    parts
}
