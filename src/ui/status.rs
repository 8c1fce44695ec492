//! The status lines at the top: one per bus (bit rate, state, load, frames per second, errors, lost
//! frames, own address), and one for des.json and the counts of devices and problems. On a screen
//! with one status line both share it. Parts that do not fit are left out by their rank.

use super::brush::{DrawContext, bus_label, fit, fit_right, short_file_name, short_name};
use super::chart::chart_rows;
use crate::app::{
    App, Bus, FileError, FileIndex, FileState, Overlay, TxBlocked, clock_millis, format_duration,
};
use crate::discovery::OwnAddress;
use crate::frame::BusIndex;
use crate::keymap::Action;
use crate::status::{BusState, Link, length_text, size};
use crate::theme::Role;
use crate::time::Instant;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

/// Stands in front of assumed values.
const ASSUMED: &str = "≈";

/// Width from which the first line has the length of the log, in columns.
const NARROW: u16 = 60;
/// Width from which it says how the present is shown again.
pub const WIDE: u16 = 76;

/// Time whose least and most load are the scale; so it becomes narrower only after that.
const SCALE_SECONDS: u64 = 60;
/// Least distance of the ends of the scale, in percent.
const LEAST_SCALE: f64 = 3.0;

/// A part of a line. It is shown whole or left out; only a text that explains an error is cut.
struct Part {
    /// Parts with a higher rank are left out first; those of rank 0 ([`KEPT`]) never.
    rank: u8,
    spans: Vec<Span<'static>>,
    /// Cells to which the last span may be cut.
    least: usize,
    /// How the name that it begins with is cut; `None`: it begins with none.
    name: Option<fn(&str, usize) -> String>,
}

/// What the screen shows is not the present, descan does not transmit, an error, a conflict.
const KEPT: u8 = 0;
/// What is wrong, beside that: suspected problems, lost frames, a failed claim, the recording.
const WARNING: u8 = 1;
const PRESENT: u8 = 2;
const MISSING: u8 = 3;
const LOST: u8 = 4;
const FILE: u8 = 5;
const STATE: u8 = 6;
const ASSUMPTION: u8 = 7;
const LOAD: u8 = 8;
/// Counters that are 0.
const COUNTER: u8 = 9;
const CHART: u8 = 10;
const OWN: u8 = 11;
const RATE: u8 = 12;
const MUTED: u8 = 13;

impl Part {
    fn new(rank: u8, spans: Vec<Span<'static>>) -> Self {
        Self { rank, spans, least: usize::MAX, name: None }
    }

    /// A part whose last span is cut to `least` cells where room is short.
    fn cut_to(least: usize, rank: u8, spans: Vec<Span<'static>>) -> Self {
        Self { rank, spans, least, name: None }
    }

    /// A part that begins with the name of a bus.
    fn of_bus(rank: u8, spans: Vec<Span<'static>>) -> Self {
        Self { name: Some(short_name), ..Self::new(rank, spans) }
    }

    /// The part, which begins with the name of a file and a blank.
    fn of_file(self) -> Self {
        let shortened = |name: &str, width| {
            if name.contains('/') { short_file_name(name, width) } else { short_name(name, width) }
        };
        Self { name: Some(shortened), ..self }
    }

    fn width(&self) -> usize {
        self.spans.iter().map(Span::width).sum()
    }

    /// Cells by which the part can become shorter.
    fn slack(&self) -> usize {
        self.spans.last().map_or(0, |last| last.width().saturating_sub(self.least))
    }
}

type Parts = Vec<Part>;

/// Draws the status lines.
pub fn draw(brush: &mut DrawContext) {
    let area = brush.screen.status;
    let buses = brush.app.buses().len();
    match area.height {
        0 => {}
        1 => {
            let mut left = moment_parts(brush);
            left.extend(bus_parts(brush, BusIndex(bus_to_show(brush, 0) as u8)));
            let mut right: Parts = assumed(brush).into_iter().collect();
            right.extend(file(brush, false));
            draw_row(brush, area, 0, left, right);
        }
        lines => {
            let shown = usize::from(lines - 1);
            for row in 0..shown.min(buses.max(1)) {
                let rest = buses > shown && row + 1 == shown;
                let index = if rest { bus_to_show(brush, row) } else { row };
                let mut parts = if row == 0 { moment_parts(brush) } else { Vec::new() };
                let at = parts.len() + 1;
                parts.extend(bus_parts(brush, BusIndex(index as u8)));
                if rest {
                    let more = format!("bus {} of {buses}", index + 1);
                    parts.insert(at, Part::new(STATE, vec![brush.span(Role::Muted, more)]));
                }
                put(brush, area, row as u16, parts, Vec::new());
            }
            let mut left = file(brush, true);
            left.extend(assumed(brush));
            draw_row(brush, area, lines - 1, left, Vec::new());
        }
    }
    if brush.app.past_moment().is_some() {
        brush.fill(Rect { height: area.height.min(1), ..area }, Role::Frozen);
    }
}

/// Returns what the first line says of a past moment: which one, and how the present is shown again.
fn moment_parts(brush: &DrawContext) -> Parts {
    let app = brush.app;
    let Some(moment) = app.past_moment() else { return Vec::new() };
    let columns = brush.screen.whole.width;
    let mut text = format!("{} {}", past_word(app), clock_millis(app, moment.time));
    if app.playback().is_some() {
        let _ = write!(text, " · log {}", length_text(moment.time.since(Instant::ZERO)));
        if columns >= NARROW {
            let length = length_text(app.last_moment().since(Instant::ZERO));
            let is_known = !app.playback().is_some_and(|it| it.seeks_end);
            let _ = write!(text, " of {}", if is_known { &length } else { "…" });
        }
        if columns >= WIDE {
            let does = if app.play_pace().is_some() { "stops" } else { "plays" };
            let _ = write!(text, " · {} {does}", app.key_of(Action::Freeze));
        }
    } else {
        let _ = write!(text, " · {} ago", format_duration(app.now().since(moment.time)));
        if columns >= WIDE {
            let _ = write!(text, " · LIVE with {}", app.key_of(Action::Freeze));
        }
    }
    let mut parts = vec![Part::new(KEPT, vec![brush.span(Role::Frozen, text)])];
    if let Some(alarm) = app.present_alarm() {
        let text = format!("now ⚠ {}", alarm.short);
        parts.push(Part::cut_to(6, WARNING, vec![brush.span(Role::Frozen, text)]));
    }
    parts
}

/// Returns the word for a past moment: `FROZEN`, `PLAY ×2`, `PLAY ×-1/4`.
pub fn past_word(app: &App) -> String {
    match app.play_pace() {
        Some(play) => format!("PLAY {}", pace(play.factor())),
        None => "FROZEN".to_owned(),
    }
}

/// Returns the speed of a replay, negative backwards: `×2`, `×1/4`, `×-1`.
pub fn pace(speed: f64) -> String {
    match speed {
        speed if speed < 0.0 => pace(-speed).replacen('×', "×-", 1),
        speed if speed < 0.995 => format!("×1/{:.0}", 1.0 / speed),
        speed => format!("×{speed}"),
    }
}

/// Draws a row with the counts and the recording at its right end, behind `right`. The counts have
/// their words if only the least parts are left out for them.
fn draw_row(brush: &mut DrawContext, area: Rect, row: u16, left: Parts, mut right: Parts) {
    let wide = counts(brush, true);
    let parts = || left.iter().chain(&right).chain(&wide);
    let kept = parts().filter(|part| part.rank < ASSUMPTION);
    let fits = kept.map(|part| part.width() + 2).sum::<usize>() <= usize::from(area.width);
    right.extend(if fits { wide } else { counts(brush, false) });
    right.extend(recording(brush));
    put(brush, area, row, left, right);
}

/// Returns the index of the bus shown on the last bus line if there are more buses than lines: of
/// those from `from` on, the first that is not up, else the bus of the selected row.
fn bus_to_show(brush: &DrawContext, from: usize) -> usize {
    let selected = brush.app.selected_row().and_then(|row| row.bus).unwrap_or_default();
    let selected = usize::from(selected.0).max(from);
    let is_hidden = |at: &usize| brush.app.buses().get(*at).is_some_and(Bus::cannot_receive);
    let others = from..brush.app.buses().len();
    std::iter::once(selected).chain(others).find(is_hidden).unwrap_or(selected)
}

/// Returns the cells of a row: two blanks between parts, one in front of `left` and behind `right`.
fn parts_width(left: &Parts, right: &Parts) -> usize {
    let all = left.iter().chain(right).map(|part| part.width() + 2).sum::<usize>();
    all.saturating_sub(usize::from(right.is_empty()))
}

/// Cuts the name at the beginning of a row if the row is wider than `width`, to `least` cells.
fn cut_name(left: &mut Parts, right: &Parts, width: usize, least: usize) {
    let missing = parts_width(left, right).saturating_sub(width);
    let mut named = left.iter_mut().filter_map(|part| Some((part.name?, part.spans.first_mut()?)));
    if let Some((shortened, name)) = named.next() {
        let room = name.width().saturating_sub(missing).max(name.width().min(least));
        let whole = name.content.trim_end();
        let blanks = name.content.len() - whole.len();
        name.content = (shortened(whole, room.saturating_sub(blanks)) + &" ".repeat(blanks)).into();
    }
}

/// Draws `left` from the left and `right` to the right end of a row. If not all fit, the parts of
/// the highest rank are left out, of equal ones the last. The first name and texts are cut rather
/// than that a warning is left out.
fn put(brush: &mut DrawContext, area: Rect, row: u16, mut left: Parts, mut right: Parts) {
    let width = usize::from(area.width);
    loop {
        let slack = |rank: u8| match rank {
            0..=PRESENT => left.iter().chain(&right).map(Part::slack).sum(),
            _ => 0,
        };
        let all = left.iter().chain(&right).enumerate();
        let last = all.max_by_key(|(_, part)| part.rank).map(|(at, part)| (at, part.rank));
        match last {
            Some((at, rank @ 1..)) if parts_width(&left, &right) > width + slack(rank) => {
                if at < left.len() {
                    left.remove(at)
                } else {
                    right.remove(at - left.len())
                };
            }
            _ => break,
        }
    }
    cut_name(&mut left, &right, width, 12);
    for part in 0..left.len() {
        let missing = parts_width(&left, &right).saturating_sub(width);
        let slack = left[part].slack().min(missing);
        if let Some(last) = left[part].spans.last_mut().filter(|_| slack > 0) {
            last.content = fit(&last.content, last.width() - slack).into();
        }
    }
    cut_name(&mut left, &right, width, 4);
    let line_of = |parts: Parts| {
        let mut line = Line::default();
        for part in parts {
            let space = if line.spans.is_empty() { "" } else { "  " };
            line.push_span(Span::raw(space));
            line.spans.extend(part.spans);
        }
        line
    };
    let taken = (parts_width(&Vec::new(), &right)).min(width.saturating_sub(6)) as u16;
    let mut line = line_of(left);
    line.spans.insert(0, Span::raw(" "));
    brush.line(Rect { width: area.width - taken, ..area }, row, &line);
    let end = Rect { x: area.right() - taken, width: taken.saturating_sub(1), ..area };
    let mut line = line_of(right);
    line.spans.insert(0, Span::raw(" "));
    brush.line(end, row, &line);
}

/// Returns the parts of the line of a bus.
fn bus_parts(brush: &DrawContext, index: BusIndex) -> Parts {
    let Some(bus) = brush.app.bus(index) else {
        return vec![Part::new(KEPT, vec![brush.span(Role::Muted, "no bus")])];
    };
    let columns = usize::from(brush.screen.whole.width);
    let label = bus_label(
        brush.app,
        index,
        match columns {
            0..60 => 8,
            60..100 => columns / 4,
            _ => columns / 2,
        },
    );
    let mut name = vec![brush.span(Role::Title, label)];
    if let Some(now) = &bus.status.renamed {
        let now = crate::text::Escaped(now.as_bytes());
        name.push(brush.span(Role::Warning, format!(" (now {now})")));
    }
    if let Some(bitrate) = bus.status.bitrate.filter(|_| columns >= 60) {
        name.push(brush.span(Role::Text, format!(" {}", rate(bitrate))));
        if let Some(data) = bus.status.data_bitrate {
            name.push(brush.span(Role::Text, format!("/{}", rate(data))));
        }
    }
    // On a narrow screen a past moment has the room of the name.
    let gives_way = columns < usize::from(WIDE) && brush.app.past_moment().is_some();
    let mut parts = vec![Part::of_bus(if gives_way { OWN } else { KEPT }, name)];
    let mut spans = vec![state(brush, index, bus)];
    let place = place_in_log(brush, bus);
    let good = matches!(bus.controller().state, BusState::ErrorActive | BusState::Unknown);
    let rank = if bus.is_up() && good && place.is_none() { STATE } else { KEPT };
    spans.extend(place.into_iter().flatten());
    parts.push(Part::new(rank, spans));
    let is_searched = brush.app.searches_bitrate_of(index);
    if let Some(fault) = bus.status.fault.as_ref().filter(|_| !bus.is_up() && !is_searched) {
        // Name and state stand in front of it.
        let known = format!("{} is {}", bus.name, bus.status.state);
        let remedy = fault.remedy().filter(|_| fault.cause() == known);
        let text = remedy.map_or_else(|| fault.to_string(), str::to_owned);
        let text = crate::text::Escaped(text.as_bytes()).to_string();
        parts.push(Part::cut_to(12, WARNING, vec![brush.span(Role::Error, text)]));
        return parts;
    }
    parts.extend(warning(brush, bus).filter(|_| !is_searched));
    let frames = bus.meter.last().frames;
    parts.extend(load(brush, bus, if columns < 100 { 8 } else { 15 }));
    parts.push(Part::new(RATE, vec![brush.span(Role::Text, format!("{frames:>4} f/s"))]));
    parts.push(counter(brush, "err", bus.counters().errors, Role::Warning));
    let mut lost = counter(brush, "lost", bus.lost(), Role::Error);
    if columns >= 100 {
        lost.spans.extend(lost_where(brush, bus));
    }
    parts.push(lost);
    parts.extend(own_address(brush, bus));
    parts
}

/// Returns the bus load, and its chart of so many cells with its scale; `–` where no bit rate is
/// known.
fn load(brush: &DrawContext, bus: &Bus, cells: usize) -> Parts {
    let label = brush.span(Role::Muted, "load ");
    if bus.lacks_bit_rate() {
        return vec![Part::new(LOAD, vec![label, brush.span(Role::Muted, "   –")])];
    }
    let load = bus.meter.last().load(bus.bits_per_second()) * 100.0;
    let guess = if bus.status.bitrate.is_none() { ASSUMED } else { "" };
    let role = if load >= 80.0 { Role::Warning } else { Role::Text };
    let load = format!("{:>4}", format!("{guess}{load:.0}%"));
    let (chart, scale) = load_chart(bus, cells);
    vec![
        Part::new(LOAD, vec![label, brush.span(role, load)]),
        Part::new(CHART, vec![brush.span(Role::Bar, chart), brush.span(Role::Muted, scale)]),
    ]
}

/// Returns whether a replay is paused, its position, percent and speed; `None` without a log.
fn place_in_log(brush: &DrawContext, bus: &Bus) -> Option<Vec<Span<'static>>> {
    let playback = brush.app.playback().filter(|_| brush.app.past_moment().is_none())?;
    if bus.status.link == Link::Opening {
        return None;
    }
    let is_ended = bus.status.link == Link::Ended;
    let at = bus.ended.unwrap_or(brush.app.display_time());
    let mut text = format!(" {}", length_text(at.since(Instant::ZERO)));
    if let Some(percent) = bus.status.percent.filter(|_| !is_ended) {
        let _ = write!(text, " {percent}%");
    }
    if (playback.speed - 1.0).abs() > f64::EPSILON {
        let _ = write!(text, " {}", pace(playback.speed));
    }
    let paused = if playback.is_paused && !is_ended { " PAUSED" } else { "" };
    Some(vec![brush.span(Role::Warning, paused), brush.span(Role::Text, text)])
}

fn counter(brush: &DrawContext, label: &str, count: u64, bad: Role) -> Part {
    let (role, rank) = if count > 0 { (bad, WARNING) } else { (Role::Text, COUNTER) };
    Part::new(
        rank,
        vec![brush.span(Role::Muted, format!("{label} ")), brush.span(role, short(count))],
    )
}

/// Returns where frames were lost: `(9 kernel, 3 queue)`; `None` if none were.
fn lost_where(brush: &DrawContext, bus: &Bus) -> Option<Span<'static>> {
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
pub fn rate(bits: u32) -> String {
    match bits {
        0 => "0".to_owned(),
        _ if bits.is_multiple_of(1_000_000) => format!("{}M", bits / 1_000_000),
        _ if bits.is_multiple_of(1000) => format!("{}k", bits / 1000),
        _ => bits.to_string(),
    }
}

/// Returns the state of the interface and the controller as a word.
fn state(brush: &DrawContext, index: BusIndex, bus: &Bus) -> Span<'static> {
    let is_log = brush.app.playback().is_some();
    let (word, role) = match (bus.status.link, bus.controller().state) {
        (Link::Opening, _) if is_log => ("begins later", Role::Muted),
        (Link::Opening, _) => ("opening", Role::Muted),
        (Link::Down, _) | (Link::Up, BusState::Down) => ("DOWN", Role::Error),
        (Link::Missing, _) => ("MISSING", Role::Error),
        (Link::Unplugged, _) => ("UNPLUGGED", Role::Error),
        (Link::NotCan | Link::NoKernel | Link::Failed, _) => ("FAILED", Role::Error),
        (Link::Ended, _) => ("end of log", Role::Muted),
        (Link::Up, BusState::Unknown | BusState::ErrorActive) if is_log => ("log", Role::Warning),
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

/// Returns why descan sends no requests; `None` if it does, and for a log.
fn warning(brush: &DrawContext, bus: &Bus) -> Option<Part> {
    let part = |role, text: String| Some(Part::new(KEPT, vec![brush.span(role, text)]));
    if bus.has_only_bus_errors() {
        let keymap = brush.app.keymap();
        let key = keymap.keys_of(Action::BitRate).next();
        let key = key.map(|key| format!(" ({key})")).unwrap_or_default();
        return part(Role::Error, format!("only bus errors: wrong bit rate?{key}"));
    }
    if bus.config().listen_only {
        // A controller that is not in listen-only mode itself still acknowledges frames.
        let acks = if bus.status.listen_only { "" } else { ", acks" };
        let is_log = brush.app.playback().is_some();
        return part(Role::Warning, format!("listen-only{acks}")).filter(|_| !is_log);
    }
    if bus.status.listens_first {
        return part(Role::Warning, "listen-only until a valid frame".to_owned());
    }
    let why = match bus.tx_blocked()? {
        TxBlocked::QueueFull => "transmit queue full",
        TxBlocked::NoAck => "no ACK",
    };
    part(Role::Error, why.to_owned())
}

/// Returns descan's own address or the state of its claim; `None` with `--listen-only`.
fn own_address(brush: &DrawContext, bus: &Bus) -> Option<Part> {
    if bus.config().listen_only {
        return None;
    }
    let (rank, role, text) = match bus.own_address() {
        OwnAddress::Held(address) => {
            let label = brush.span(Role::Muted, "own ");
            let address = brush.span(Role::Text, address.to_string());
            return Some(Part::new(OWN, vec![label, address]));
        }
        OwnAddress::Blocked(Some(address)) => {
            (WARNING, Role::Error, format!("own {address} in use"))
        }
        OwnAddress::Blocked(None) => (WARNING, Role::Error, "no free address".to_owned()),
        OwnAddress::Claiming(address) => (OWN, Role::Muted, format!("own {address}?")),
        OwnAddress::Listening => (OWN, Role::Muted, "listening".to_owned()),
        OwnAddress::None => (OWN, Role::Muted, "own –".to_owned()),
    };
    Some(Part::new(rank, vec![brush.span(role, text)]))
}

/// Returns the chart of the load in `cells` cells of 2 s, newest at the right, and its scale: the
/// least and the most of the last minute, at least 3 percent apart. A second without frames is
/// blank.
fn load_chart(bus: &Bus, cells: usize) -> (String, String) {
    let (history, bitrate) = (&bus.meter.history, bus.bits_per_second());
    let load = |second: u64| Some(history.sample(second, second + 1).load(bitrate)? * 100.0);
    let minute = (history.end().saturating_sub(SCALE_SECONDS)..history.end()).filter_map(load);
    let (least, most) = minute
        .fold((100.0, 0.0), |(least, most): (f64, f64), load| (least.min(load), most.max(load)));
    if least > most {
        return (" ".repeat(cells), String::new());
    }
    let least = least.floor().min(100.0 - LEAST_SCALE);
    let most = most.ceil().max(least + LEAST_SCALE);
    // The chart moves by whole cells.
    let end = history.end() / 2 * 2;
    let begin = history.end() - history.len();
    let start = end.saturating_sub(2 * cells as u64).max(begin / 2 * 2);
    // What is not 0 has a dot, the least load too.
    let above = |load: f64| if load > 0.0 { (load - least).max(0.01) } else { 0.0 };
    let values: Vec<_> = (start..end).map(|second| load(second).map(above)).collect();
    let chart = chart_rows(&values, 1, most - least).concat();
    (fit_right(&chart, cells), format!(" {least:.0}–{most:.0}%"))
}

/// Returns the sign that devices are read with assumed values.
fn assumed(brush: &DrawContext) -> Option<Part> {
    let assumed =
        brush.app.buses().iter().any(|bus| bus.config().profile.assumed().next().is_some());
    let spans = vec![brush.span(Role::Suspected, ASSUMED), brush.span(Role::Muted, " assumed")];
    assumed.then(|| Part::new(ASSUMPTION, spans))
}

/// Returns the counts of devices and problems. Missing and lost devices have the same sign: if both
/// are counted, their words stay.
fn counts(brush: &DrawContext, words: bool) -> Parts {
    let counts = brush.app.counts();
    let word = |text: &'static str| if words { text } else { "" };
    let both = counts.missing > 0 && counts.lost > 0;
    let absent = |text| if both || brush.screen.whole.width >= 60 { text } else { word(text) };
    [
        (PRESENT, Role::Online, "● ", counts.present, word(" present")),
        (LOST, Role::Muted, "· ", counts.unknown, word(" unknown")),
        (MISSING, Role::Missing, "○ ", counts.missing, absent(" missing")),
        (LOST, Role::Lost, "○ ", counts.lost, absent(" lost")),
        (KEPT, Role::Confirmed, "⚠ ", counts.confirmed, ""),
        (WARNING, Role::Suspected, "? ", counts.suspected, ""),
        (MUTED, Role::Muted, "", counts.muted, " muted"),
    ]
    .into_iter()
    .filter(|&(rank, _, _, count, _)| count > 0 || rank == PRESENT)
    .map(|(rank, role, sign, count, word)| {
        let count_span = brush.span(role, format!("{sign}{count}"));
        Part::new(
            rank,
            vec![count_span, brush.span(if count > 0 { role } else { Role::Muted }, word)],
        )
    })
    .collect()
}

/// Returns the counts in few cells, for the line of the alarm: `●10 ○1 ⚠3`.
pub fn short_counts(brush: &DrawContext) -> Vec<Span<'static>> {
    let mut spans = Vec::new();
    for part in counts(brush, false) {
        if !spans.is_empty() {
            spans.push(Span::raw(" "));
        }
        let count = part.spans.into_iter().next();
        spans.extend(count.map(|span| Span::styled(span.content.replace(' ', ""), span.style)));
    }
    spans
}

/// Returns size and lost frames of the recording, or that it stopped; `None` without `--record`.
fn recording(brush: &DrawContext) -> Option<Part> {
    let status = brush.app.recording()?;
    if status.failure.is_some() {
        return Some(Part::new(KEPT, vec![brush.span(Role::Error, "✗ rec stopped")]));
    }
    let mut spans = vec![
        brush.span(Role::Recording, "● rec"),
        brush.span(Role::Text, format!(" {}", size(status.bytes))),
    ];
    if status.lost > 0 {
        spans.push(brush.span(Role::Error, format!(" lost {}", short(status.lost))));
    }
    Some(Part::new(WARNING, spans))
}

/// Returns which static addresses of the user another program has overwritten, and the key that
/// restores them; `None` without any.
fn overwritten_pins(brush: &DrawContext, whole: bool) -> Option<Part> {
    /// Longest part of a name, which leaves room for the key.
    const NAME_WIDTH: usize = 16;
    let names = brush.app.overwritten_pins();
    let pins = match names.as_slice() {
        [] => return None,
        [name] => format!("pin of {}", fit(&name.quoted().to_string(), NAME_WIDTH).trim_end()),
        all => format!("{} pins", all.len()),
    };
    let remedy = if whole {
        format!("; {} restores", brush.app.key_of(Action::Save))
    } else {
        String::new()
    };
    let text = format!("! {pins} overwritten{remedy}");
    Some(Part::new(KEPT, vec![brush.span(Role::Warning, text)]))
}

/// Returns the name of the file, cut to a third of the width, so that its state has room.
fn file_name(brush: &DrawContext, file: &FileState) -> Span<'static> {
    let name = file.name();
    let width = name.width().min(usize::from(brush.screen.whole.width / 3));
    brush.span(Role::Title, format!("{} ", short_file_name(&name, width)))
}

/// Returns the state of des.json; with `whole` also the cause of an error and the next step. Of several
/// files, that of the first one that needs the user, else their sum.
fn file(brush: &DrawContext, whole: bool) -> Parts {
    let app = brush.app;
    if app.files().count() == 1 {
        return one_file(brush, FileIndex::default(), whole);
    }
    let urgency = |file: FileIndex, state: &FileState| match () {
        () if app.shown_file(file).0.is_some() || state.conflict().is_some() => Some(0),
        () if state.unsaved() > 0 || state.emptied_since().is_some() => Some(1),
        () if !app.file_mistakes(file).is_empty() => Some(2),
        () => None,
    };
    let urgent = app.files().filter_map(|(file, state)| Some((urgency(file, state)?, file)));
    let mut urgent: Vec<_> = urgent.collect();
    urgent.sort_unstable();
    let (mut absent, present): (Vec<_>, Vec<_>) = app
        .files()
        .map(|(file, _)| file)
        .partition(|file| app.file_at(*file).is_read() && !app.shown_file(*file).1);
    if let Some((_, file)) = urgent.first() {
        let mut parts = one_file(brush, *file, whole);
        if urgent.len() > 1 {
            let more = format!("and {} more", urgent.len() - 1);
            parts.push(Part::new(WARNING, vec![brush.span(Role::Warning, more)]));
        }
        absent.retain(|it| it != file);
        parts.extend(absent_files(brush, &absent));
        return parts;
    }
    let mut parts = match *present {
        [] => return vec![all_absent(brush, &absent)],
        [file] => one_file(brush, file, whole),
        _ => sum_of_files(brush, &present, whole),
    };
    parts.extend(absent_files(brush, &absent));
    parts
}

/// Returns which files are not there, beside others: they give way first, unless one was there.
fn absent_files(brush: &DrawContext, files: &[FileIndex]) -> Option<Part> {
    let text = match *files {
        [] => return None,
        [file] => {
            let name = file_name(brush, brush.app.file_at(file));
            format!("{} not found", name.content.trim_end())
        }
        _ => format!("{} files not found", files.len()),
    };
    let (rank, role) = of_absent(brush, files, STATE);
    Some(Part::new(rank, vec![brush.span(role, text)]))
}

/// Returns how files that are not there are shown: one that was there is missed.
fn of_absent(brush: &DrawContext, files: &[FileIndex], rank: u8) -> (u8, Role) {
    let is_missed = files.iter().any(|file| brush.app.file_at(*file).has_valid_content());
    if is_missed { (WARNING, Role::Warning) } else { (rank, Role::Muted) }
}

/// Returns that none of the files is there.
fn all_absent(brush: &DrawContext, files: &[FileIndex]) -> Part {
    let (rank, role) = of_absent(brush, files, FILE);
    let title = brush.span(Role::Title, format!("{} files ", files.len()));
    Part::new(rank, vec![title, brush.span(role, "not found")]).of_file()
}

/// Returns how many entries these files have together.
fn sum_of_files(brush: &DrawContext, files: &[FileIndex], whole: bool) -> Parts {
    let entries = files.iter().filter_map(|file| brush.app.document_at(*file));
    let entries: usize = entries.map(|document| document.entries().len()).sum();
    let words = match (whole, entries) {
        (false, _) => format!(" {entries}"),
        (true, 1) => " 1 entry".to_owned(),
        (true, _) => format!(" {entries} entries"),
    };
    let title = brush.span(Role::Title, format!("{} files ", files.len()));
    let spans = vec![title, brush.span(Role::FileOk, "✓"), brush.span(Role::Text, words)];
    [Some(Part::new(FILE, spans).of_file()), overwritten_pins(brush, whole)]
        .into_iter()
        .flatten()
        .collect()
}

fn one_file(brush: &DrawContext, index: FileIndex, whole: bool) -> Parts {
    let file = brush.app.file_at(index);
    if file.path().is_none() {
        return vec![Part::new(FILE, vec![brush.span(Role::Muted, "no file")])];
    }
    let entries = brush.app.document_at(index).map_or(0, |it| it.entries().len());
    let unsaved = file.unsaved();
    let is_past = brush.app.past_moment().is_some();
    let is_emptied = file.emptied_since().is_some() && !is_past;
    let (problem, is_there) = brush.app.shown_file(index);
    let findings = brush.app.file_mistakes(index).len();
    let mut more = None;
    let (rank, role, text) = match problem {
        Some(problem) => {
            let text = match problem {
                FileError::Syntax(error) if !whole => {
                    format!("✗ {}:{}", error.line, error.column)
                }
                FileError::Unreadable(_) if !whole => "✗".to_owned(),
                FileError::NotSaved(_) if !whole => "✗ not saved".to_owned(),
                FileError::NotSaved(why) => format!("✗ not saved: {why}"),
                FileError::Unconfirmed(_) if !whole => "✗ unconfirmed".to_owned(),
                problem => format!("✗ {problem}"),
            };
            if matches!(problem, FileError::Syntax(_))
                && (file.has_valid_content() && !is_past || entries > 0)
            {
                let valid =
                    if brush.screen.whole.width < 100 { "last valid" } else { "using last valid" };
                let word = if entries == 1 { "entry" } else { "entries" };
                more = Some((ASSUMPTION, format!("{valid}: {entries} {word}")));
            }
            (KEPT, Role::Error, text)
        }
        None if file.conflict().is_some() => {
            if !matches!(brush.app.overlay(), Overlay::Conflict) {
                more = Some((FILE, format!("{} resolves it", brush.app.key_of(Action::Save))));
            }
            (KEPT, Role::Error, "✗ edit conflict".to_owned())
        }
        None if unsaved > 0 => {
            more = is_emptied.then(|| (FILE, "empty (being written?)".to_owned()));
            (KEPT, Role::Warning, format!("… saving {unsaved}"))
        }
        None if is_emptied => (KEPT, Role::Warning, "empty (being written?)".to_owned()),
        None if !file.is_read() => (FILE, Role::Muted, "…".to_owned()),
        // A file that was there is missed.
        None if !is_there && file.has_valid_content() => {
            (WARNING, Role::Warning, "not found".to_owned())
        }
        None if !is_there => (FILE, Role::Muted, "not found".to_owned()),
        None => {
            let (rank, role, sign) = match findings {
                0 => (FILE, Role::FileOk, "✓".to_owned()),
                _ => (WARNING, Role::Warning, format!("! {findings}")),
            };
            let words = match (whole, entries, findings) {
                (false, _, 1..) => String::new(),
                (false, ..) => format!(" {entries}"),
                (true, 1, 0) => " 1 entry".to_owned(),
                (true, _, 0) => format!(" {entries} entries"),
                (true, 1, _) => " in 1 entry".to_owned(),
                (true, ..) => format!(" in {entries} entries"),
            };
            let name = file_name(brush, file);
            let words = brush.span(Role::Text, words);
            let file = Part::new(rank, vec![name, brush.span(role, sign), words]).of_file();
            return [Some(file), overwritten_pins(brush, whole)].into_iter().flatten().collect();
        }
    };
    let name = file_name(brush, file);
    let mut parts = vec![Part::cut_to(24, rank, vec![name, brush.span(role, text)]).of_file()];
    parts.extend(
        more.filter(|_| whole)
            .map(|(rank, text)| Part::new(rank, vec![brush.span(Role::Muted, text)])),
    );
    parts
}
