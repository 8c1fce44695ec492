//! Page 5, Bus: for each bus its state and counters, charts of load, error rate and frame rate,
//! the bus time by device and by service, error kinds; and what happened to the buses. A sample of
//! several seconds is that of its busiest second.

use super::brush::{DrawContext, bus_label, fit, fit_right};
use super::chart::{bar, chart_rows, grouped, rounded, scale_text, scale_top};
use super::timeline::latest_line;
use crate::app::{
    Bus, BusPageLayout, BusRegions, ChartSpan, LoadBar, LoadHistory, LoadSample, bar_lines,
    format_time_of_day, growing_length_text,
};
use crate::discovery::OwnAddress;
use crate::frame::BusIndex;
use crate::status::{BusState, Link};
use crate::theme::Role;
use crate::time::{Duration, Instant};
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};
use unicode_width::UnicodeWidthStr;

/// Cells of the scale at the left of a chart.
const SCALE: u16 = 6;
/// Cells between two times on the axis.
const TICK: usize = 16;
/// Most cells of a label of a bar.
const LABEL: usize = 18;
/// Cells of a share with a blank in front: ` 100.0 %`.
const SHARE: usize = 8;

/// Draws the page.
pub fn draw(brush: &mut DrawContext) {
    let page = brush.app.bus_page();
    let axis = ChartAxis::new(brush, &page);
    for (at, regions) in page.buses.iter().enumerate() {
        let index = BusIndex((page.first + at) as u8);
        let Some(bus) = brush.app.bus(index) else { continue };
        let shown = BusView { index, bus, regions, label: label(brush, index) };
        draw_facts(brush, &shown);
        draw_charts(brush, &shown, axis);
        draw_kinds(
            brush,
            &shown,
            axis,
            page.kinds_heading.height == 0 && regions.errors.height == 0,
        );
        draw_bars(brush, &shown);
    }
    draw_axis(brush, page.axis, axis);
    heading(brush, page.kinds_heading, "error kinds", "");
    draw_divider(brush, &page);
    draw_events(brush, page.events);
}

/// A bus on the page.
struct BusView<'a> {
    index: BusIndex,
    bus: &'a Bus,
    regions: &'a BusRegions,
    /// Name in front of headings; empty for a single bus.
    label: String,
}

impl BusView<'_> {
    /// A heading with the name of the bus, if there are several.
    fn titled(&self, title: &str) -> String {
        if self.label.is_empty() { title.to_owned() } else { format!("{}: {title}", self.label) }
    }
}

/// Returns the name of a bus where there are several.
fn label(brush: &DrawContext, index: BusIndex) -> String {
    let several = brush.app.buses().len() > 1;
    if several { bus_label(brush.app, index, 8) } else { String::new() }
}

// ---- state and counters --------------------------------------------------------------------

/// Draws state and counters, as many as fit: the first ones are the most important.
fn draw_facts(brush: &mut DrawContext, shown: &BusView) {
    let area = shown.regions.facts;
    if area.height == 0 {
        return;
    }
    let mut lines: Vec<Line> = vec![Line::default(); usize::from(area.height)];
    let room = usize::from(area.width).saturating_sub(1);
    let mut row = 0;
    let mut facts = facts(brush, shown);
    if brush.app.buses().len() > 1 {
        facts.insert(0, vec![brush.span(Role::Title, shown.label.clone())]);
    }
    for fact in facts.into_iter().filter(|fact| !fact.is_empty()) {
        let width = fact.iter().map(Span::width).sum::<usize>();
        let used = lines[row].width();
        if used > 0 && used + 2 + width > room {
            // On the last line, a shorter one may fit.
            if row + 1 == lines.len() {
                continue;
            }
            row += 1;
        }
        let Some(line) = lines.get_mut(row) else { break };
        line.push_span(Span::raw(if line.spans.is_empty() { " " } else { "  " }));
        line.spans.extend(fact);
    }
    for (row, line) in lines.iter().enumerate() {
        brush.line(area, row as u16, line);
    }
}

/// Returns state and counters; what is unknown is `–`.
fn facts(brush: &DrawContext, shown: &BusView) -> Vec<Vec<Span<'static>>> {
    let (bus, status, counters) = (shown.bus, &shown.bus.status, shown.bus.counters());
    let known = |value: Option<u64>| value.map_or_else(|| "–".to_owned(), grouped);
    let pair = |word: &str, value: String, role: Role| {
        vec![brush.span(Role::Muted, format!("{word} ")), brush.span(role, value)]
    };
    let text = |word: &str, value: String| pair(word, value, Role::Text);
    let count = |word: &str, value: u64, bad: Role| {
        pair(word, grouped(value), if value > 0 { bad } else { Role::Text })
    };
    let guess = if status.bitrate.is_none() { "≈" } else { "" };
    let bitrate = match (bus.lacks_bit_rate(), status.data_bitrate) {
        (true, _) => "– kbit/s".to_owned(),
        (_, Some(data)) => {
            format!("{guess}{}/{} kbit/s", kilobits(bus.bits_per_second()), kilobits(data))
        }
        _ => format!("{guess}{} kbit/s", kilobits(bus.bits_per_second())),
    };
    let controller = bus.controller();
    let state = match status.link {
        Link::Up => controller.state.name(),
        Link::Opening => "opening",
        Link::Down => "down",
        Link::Missing => "missing",
        Link::Unplugged => "unplugged",
        Link::Ended => "end of log",
        Link::NotCan | Link::NoKernel | Link::Failed => "failed",
    };
    let state = match (state, controller.state) {
        ("unknown", _) => "state –".to_owned(),
        ("end of log", known) if known != BusState::Unknown => format!("{state}, {}", known.name()),
        _ => state.to_owned(),
    };
    let is_bad = !bus.is_up() && status.link != Link::Ended
        || matches!(
            controller.state,
            BusState::ErrorWarning | BusState::ErrorPassive | BusState::BusOff
        );
    let own_address = match bus.own_address() {
        OwnAddress::Held(address) => address.to_string(),
        _ => "–".to_owned(),
    };
    let counts = bus.meter.shares.latest();
    let is_share_known = !bus.lacks_bit_rate() && counts.seconds > 0;
    let own_share = if is_share_known {
        format!("{} %", percent(bus.share_of(counts.own, counts)))
    } else {
        "–".to_owned()
    };
    let places = [
        (status.kernel_drops, "kernel"),
        (status.controller_overruns, "adapter"),
        (status.queue_drops, "queue"),
    ];
    let lost = places.iter().filter(|(count, _)| *count > 0);
    let lost: Vec<String> = lost.map(|(count, at)| format!("{at} {}", grouped(*count))).collect();
    let lost = match lost.as_slice() {
        [] => text("lost", "0".to_owned()),
        some => pair("lost:", some.join(", "), Role::Error),
    };
    let millis = |it: Duration| format!("{:.1}", it.as_secs_f64() * 1000.0);
    let is_counted = brush.app.uncounted_frames() == 0;
    let latency = brush.app.calls().latency_on(shown.index).filter(|_| is_counted);
    let latency = latency.map_or("–".to_owned(), |it| {
        format!("p50 {}  p99 {}  max {} ms", millis(it.p50), millis(it.p99), millis(it.max))
    });
    let buffer = buffer_text(bus);
    let buffer = text("receive buffer", buffer.unwrap_or_else(|| "–".to_owned()));
    // What is not known comes last.
    let is_known = status.receive_buffer.is_some();
    let (known_buffer, no_buffer) =
        if is_known { (buffer, Vec::new()) } else { (Vec::new(), buffer) };
    let role = if is_bad { Role::Error } else { Role::Text };
    vec![
        vec![brush.span(Role::Text, bitrate)],
        vec![brush.span(role, state)],
        text("TEC", known(controller.tec.map(u64::from))),
        text("REC", known(controller.rec.map(u64::from))),
        count("bus-off", controller.bus_offs, Role::Error),
        text("own address", own_address),
        text("own share", own_share),
        text("frames", grouped(counters.frames)),
        count("errors", counters.errors, Role::Warning),
        lost,
        known_buffer,
        count("not sent", status.transmit_failures, Role::Warning),
        count("non-platform", counters.non_platform, Role::Text),
        count("non-conforming", counters.non_conforming, Role::Warning),
        text("latency", latency),
        no_buffer,
    ]
}

/// Returns how many frames the kernel's receive buffer holds, for how long it can be left unread at the
/// present rate, and how full it was at most; `None` if its size is not known, as of logs.
fn buffer_text(bus: &Bus) -> Option<String> {
    let frames = bus.status.receive_buffer_frames()?;
    let seconds = bus.meter.seconds();
    let count = seconds.len().max(1) as f64;
    let rate = seconds.map(|second| f64::from(second.frames)).sum::<f64>() / count;
    let lasts = match f64::from(frames) / rate {
        seconds if rate <= 0.0 || seconds >= 60.0 => String::new(),
        seconds => format!(" ({seconds:.1} s)"),
    };
    let most = bus.status.most_waiting;
    Some(format!("{} frames{lasts}, max {}", grouped(frames.into()), grouped(most.into())))
}

/// Returns a bit rate in kbit/s.
fn kilobits(bits: u32) -> String {
    if bits.is_multiple_of(1000) {
        grouped(u64::from(bits / 1000))
    } else {
        format!("{:.1}", f64::from(bits) / 1000.0)
    }
}

/// Returns a part of 1 in percent, with one digit behind the point.
fn percent(part: f64) -> String {
    let percent = part * 100.0;
    if percent > 0.0 && percent < 0.05 { "<0.1".to_owned() } else { format!("{percent:.1}") }
}

// ---- charts --------------------------------------------------------------------------------

/// The time of all charts of the page.
#[derive(Clone, Copy)]
struct ChartAxis {
    /// Cells.
    cells: u64,
    /// Seconds of a sample; a cell has two samples.
    step: u64,
    /// Second after the last sample: charts move by whole cells.
    end: u64,
    /// Second that is not over yet.
    now: u64,
}

impl ChartAxis {
    fn new(brush: &DrawContext, page: &BusPageLayout) -> Self {
        let width = page.buses.first().map_or(0, |bus| bus.load.width);
        let cells = u64::from(width.saturating_sub(SCALE + 1));
        let histories = brush.app.buses().iter().map(|bus| &bus.meter.history);
        let longest = histories.clone().map(LoadHistory::len).max().unwrap_or(0);
        let now = histories.map(LoadHistory::end).max().unwrap_or(0);
        let step = brush.app.chart_span().seconds_per_sample(cells * 2, longest);
        // A long cell has what is known of it so far.
        let whole = if step > 1 { now.div_ceil(2 * step) } else { now / (2 * step) };
        Self { cells, step, end: whole * 2 * step, now }
    }

    /// The first second.
    fn start(&self) -> u64 {
        self.end.saturating_sub(self.cells * 2 * self.step)
    }
}

/// A chart.
struct LoadChart {
    area: Rect,
    title: String,
    /// In the last second.
    now: Option<f64>,
    average: fn(&LoadSample, u32) -> Option<f64>,
    most: fn(&LoadSample, u32) -> f64,
    /// Least top of the scale.
    least: f64,
    role: Role,
}

fn draw_charts(brush: &mut DrawContext, shown: &BusView, axis: ChartAxis) {
    let (bus, last) = (shown.bus, shown.bus.meter.last());
    let is_known = !bus.meter.history.is_empty() && bus.is_up();
    let rate = bus.bits_per_second();
    let load = LoadChart {
        area: shown.regions.load,
        title: if bus.status.bitrate.is_none() { "load, ≈%" } else { "load, %" }.to_owned(),
        now: is_known.then(|| last.load(rate) * 100.0),
        average: |sample, rate| sample.load(rate).map(|load| load * 100.0),
        most: |sample, rate| {
            (f64::from(sample.most_bits) / f64::from(rate.max(1)) * 100.0).min(100.0)
        },
        least: 3.0,
        role: Role::Graph,
    };
    let frames = LoadChart {
        area: shown.regions.frames,
        title: "frames, /s".to_owned(),
        now: is_known.then(|| f64::from(last.frames)),
        average: |sample, _| sample.frame_rate(),
        most: |sample, _| f64::from(sample.most_frames),
        least: 10.0,
        role: Role::Graph,
    };
    let errors = LoadChart {
        area: shown.regions.errors,
        title: "error frames, /s".to_owned(),
        now: is_known.then(|| f64::from(last.errors)),
        average: |sample, _| sample.error_rate(),
        most: |sample, _| f64::from(sample.most_errors),
        least: 2.0,
        role: Role::Graph2,
    };
    if bus.lacks_bit_rate() {
        // The load is not known: the frame rate in its place.
        draw_chart(brush, shown, axis, &LoadChart { area: load.area, ..frames });
    } else {
        draw_chart(brush, shown, axis, &load);
        draw_chart(brush, shown, axis, &frames);
    }
    draw_chart(brush, shown, axis, &errors);
}

fn draw_chart(brush: &mut DrawContext, shown: &BusView, axis: ChartAxis, chart: &LoadChart) {
    let area = chart.area;
    if area.height == 0 {
        return;
    }
    let (history, rate) = (&shown.bus.meter.history, shown.bus.bits_per_second());
    let sum = history.sample(axis.start(), history.end());
    let value = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), rounded);
    let average = (chart.average)(&sum, rate);
    let most = average.map(|_| (chart.most)(&sum, rate));
    let numbers = format!("now {}  avg {}  max {}", value(chart.now), value(average), value(most));
    heading(brush, Rect { height: 1, ..area }, &shown.titled(&chart.title), &numbers);
    let rows = usize::from(area.height.saturating_sub(1));
    if rows == 0 {
        return;
    }
    // Samples from the first one of the bus on.
    let first = axis.start().max((history.end() - history.len()) / (2 * axis.step) * 2 * axis.step);
    let mut values = Vec::new();
    let mut at = first;
    while at < axis.end {
        let sample = history.sample(at, at + axis.step);
        // Of several seconds the busiest one: a burst must not vanish in a long time.
        values.push((chart.average)(&sample, rate).map(|_| (chart.most)(&sample, rate)));
        at += axis.step;
    }
    let top = scale_top(values.iter().flatten().copied().fold(0.0, f64::max), chart.least);
    let blank = axis.cells - (axis.end.saturating_sub(first) / (2 * axis.step)).min(axis.cells);
    for (row, text) in chart_rows(&values, rows, top).into_iter().enumerate() {
        let number = match row {
            0 => scale_text(top),
            _ if row + 1 == rows => "0".to_owned(),
            _ => String::new(),
        };
        let tick = if number.is_empty() { "│" } else { "┤" };
        let line = Line::from(vec![
            brush.span(Role::Muted, fit_right(&number, usize::from(SCALE) - 2)),
            brush.span(Role::Border, tick),
            Span::raw(" ".repeat(blank as usize + 1)),
            brush.span(chart.role, text),
        ]);
        brush.line(area, row as u16 + 1, &line);
    }
}

/// Draws the times below the charts.
fn draw_axis(brush: &mut DrawContext, area: Rect, axis: ChartAxis) {
    if area.height == 0 || axis.cells == 0 {
        return;
    }
    let time = |cell: u64| {
        let second = (axis.end + cell * 2 * axis.step).checked_sub(axis.cells * 2 * axis.step)?;
        let second = second.min(axis.now);
        Some(format_time_of_day(brush.app, Instant::from_micros(second * 1_000_000)))
    };
    let cells = axis.cells as usize;
    let mut text = String::new();
    // The last time ends in the last cell; the others begin in theirs.
    let last = time(axis.cells).map_or_else(String::new, |time| format!("{time}▼"));
    let end = cells.saturating_sub(last.width());
    let mut cell = 0;
    while cell + 10 < end {
        text.push_str(&" ".repeat(cell - text.width()));
        if let Some(time) = time(cell as u64) {
            text.push('╷');
            text.push_str(&time);
        }
        cell += TICK;
    }
    text.push_str(&" ".repeat(end.saturating_sub(text.width())));
    text.push_str(&last);
    let line = Line::from(vec![
        brush.span(Role::Border, format!("{}└ ", " ".repeat(usize::from(SCALE) - 2))),
        brush.span(Role::Muted, text),
    ]);
    brush.line(area, 0, &line);
}

// ---- bars ----------------------------------------------------------------------------------

fn draw_bars(brush: &mut DrawContext, shown: &BusView) {
    let (bus, index) = (shown.bus, shown.index);
    let what = match (bus.lacks_bit_rate(), bus.status.bitrate) {
        // Its parts are of the bits, not of the number of frames.
        (true, _) => "bits",
        (_, None) => "load ≈",
        _ => "load",
    };
    let span = brush.app.chart_span();
    let others = bus.other_shares(span);
    let regions = shown.regions;
    let title = shown.titled(&format!("{what} by device"));
    draw_bar_list(brush, regions.senders, bus, &title, &bus.sender_bars(index, span), &others);
    // Below the devices, or beside them: the bus is named there.
    let title = format!("{what} by service");
    draw_bar_list(brush, regions.services, bus, &title, &bus.service_bars(index, span), &[]);
}

fn draw_bar_list(
    brush: &mut DrawContext,
    area: Rect,
    bus: &Bus,
    title: &str,
    bars: &[LoadBar],
    others: &[(&'static str, f64)],
) {
    if area.height == 0 {
        return;
    }
    let counts = bus.shares_of(brush.app.chart_span());
    let seconds = counts.seconds;
    let (lines, other_lines) = bar_lines(area, others.len());
    let mut since = if seconds > 0 { span_text(brush, seconds) } else { String::new() };
    if bars.len() > lines {
        // The heading drops its last numbers first where it is too narrow.
        since = format!("{lines} of {}  {since}", bars.len());
    }
    heading(brush, Rect { height: 1, ..area }, title, &since);
    let below = Rect { y: area.y + 1, height: area.height - 1, ..area };
    if bars.is_empty() {
        let text = match counts.bits {
            _ if seconds == 0 => "  –",
            0 => "  no frames",
            _ => "  no such frames",
        };
        let line = Line::from(brush.span(Role::Muted, text));
        brush.line(below, 0, &line);
    }
    let labels: Vec<String> = bars.iter().map(|bar| brush.app.bar_label(bar.key)).collect();
    let words = others.iter().map(|(word, _)| word.width());
    let longest = labels.iter().map(|label| label.width()).chain(words).max().unwrap_or(0);
    let room = usize::from(area.width).saturating_sub(SHARE + 4);
    let label_width = longest.min(LABEL).min(room.saturating_sub(4));
    let bar_width = room.saturating_sub(label_width + 1);
    let most = bars.first().map_or(1.0, |bar| bar.share).max(f64::MIN_POSITIVE);
    let window = brush.app.bars_window(bars, lines);
    let mut row = 0;
    let line_of =
        |brush: &DrawContext, pointer: &str, label: &str, role: Role, share: f64, full: f64| {
            Line::from(vec![
                brush.span(Role::Text, pointer),
                brush.span(role, format!(" {} ", fit(label, label_width))),
                brush.span(Role::Graph, fit(&bar(full, bar_width), bar_width)),
                brush.span(role, format!("{} %", fit_right(&percent(share), SHARE - 2))),
            ])
        };
    for (at, bar) in bars.iter().enumerate().take(window.end).skip(window.start) {
        let is_selected = brush.app.selected_bar() == Some(bar.key);
        let pointer = if is_selected { "▸" } else { " " };
        let full = bar.share / most;
        let line = line_of(brush, pointer, &labels[at], Role::Text, bar.share, full);
        brush.line(below, row, &line);
        if is_selected {
            brush.select(below, row);
        }
        row += 1;
    }
    row = row.max(u16::from(bars.is_empty()));
    for (word, share) in &others[others.len() - other_lines..] {
        let full = if *word == "free" { 0.0 } else { share / most };
        let line = line_of(brush, " ", word, Role::Muted, *share, full);
        brush.line(below, row, &line);
        row += 1;
    }
}

/// Returns the time that bars are of: `last 2m00s`, `all 3m34s`.
fn span_text(brush: &DrawContext, seconds: u64) -> String {
    let word = if brush.app.chart_span() == ChartSpan::All { "all" } else { "last" };
    format!("{word} {}", growing_length_text(Duration::from_secs(seconds)))
}

// ---- errors and events ---------------------------------------------------------------------

/// Draws the errors by kind; in place of their chart also the rate.
fn draw_kinds(brush: &mut DrawContext, shown: &BusView, axis: ChartAxis, with_rate: bool) {
    let area = shown.regions.kinds;
    if area.height == 0 {
        return;
    }
    let mut spans = vec![Span::raw(" ")];
    if !shown.label.is_empty() {
        spans.push(brush.span(Role::Title, format!("{}  ", shown.label)));
    }
    if with_rate {
        let history = &shown.bus.meter.history;
        let most = history.sample(axis.start(), history.end()).most_errors;
        for (word, rate) in [("errors", shown.bus.meter.last().errors), ("max", most)] {
            let role = if rate > 0 { Role::Warning } else { Role::Text };
            spans.push(brush.span(Role::Muted, format!("{word} ")));
            spans.push(brush.span(role, format!("{}/s", grouped(u64::from(rate)))));
            spans.push(Span::raw("  "));
        }
        spans.push(Span::raw(" "));
    }
    let head = Line::from(spans);
    let line_of = |is_shown: fn(u64) -> bool| {
        let mut line = head.clone();
        let words = shown.bus.meter.error_kinds.words().into_iter();
        for (at, (word, count)) in words.filter(|(_, count)| is_shown(*count)).enumerate() {
            let gap = if at > 0 { "  " } else { "" };
            let role = if count > 0 { Role::Warning } else { Role::Text };
            line.push_span(brush.span(Role::Muted, format!("{gap}{word} ")));
            line.push_span(brush.span(role, grouped(count)));
        }
        line
    };
    // Where room is short, kinds without an error are left out.
    let all = line_of(|_| true);
    let line = if all.width() > usize::from(area.width) { line_of(|it| it > 0) } else { all };
    brush.line(area, 0, &line);
}

/// Draws what happened to the buses, newest at the bottom.
fn draw_events(brush: &mut DrawContext, area: Rect) {
    if area.height == 0 {
        return;
    }
    heading(brush, Rect { height: 1, ..area }, "what happened to the bus", "");
    let stories = brush.app.latest_bus_stories(usize::from(area.height - 1));
    if stories.is_empty() {
        let line = Line::from(brush.span(Role::Muted, "  nothing so far"));
        return brush.line(area, 1, &line);
    }
    for (row, (story, time)) in stories.into_iter().enumerate() {
        let line = latest_line(brush, story, time, if area.width >= 60 { 12 } else { 8 });
        brush.line(area, row as u16 + 1, &line);
    }
}

/// Draws a rule with a title and numbers behind it.
fn heading(brush: &mut DrawContext, area: Rect, title: &str, numbers: &str) {
    if area.height == 0 || area.width < 4 {
        return;
    }
    brush.rule(area, Role::Border);
    let mut line = Line::from(brush.span(Role::Title, format!(" {title} ")));
    let width = area.width - 2;
    // Numbers that do not fit are left out: the last ones first.
    let mut numbers = numbers;
    while !numbers.is_empty() && line.width() + numbers.width() + 3 > usize::from(width) {
        numbers = numbers.rfind("  ").map_or("", |at| &numbers[..at]);
    }
    if !numbers.is_empty() {
        line.push_span(brush.span(Role::Muted, format!("  {numbers} ")));
    }
    brush.line(Rect { x: area.x + 1, width, ..area }, 0, &line);
}

/// Draws the line between charts and bars, and its corners in the headings beside it.
fn draw_divider(brush: &mut DrawContext, page: &BusPageLayout) {
    let divider = page.divider;
    if divider.height == 0 {
        return;
    }
    let style = brush.style(Role::Border);
    for y in divider.top()..divider.bottom() {
        let left = divider.x > 0 && brush.buffer[(divider.x - 1, y)].symbol() == "─";
        let right = brush.buffer[(divider.x + 1, y)].symbol() == "─";
        let sign = match (y == divider.top(), left, right) {
            (true, true, _) => "┬",
            (_, true, true) => "┼",
            (_, true, false) => "┤",
            (_, false, true) => "├",
            _ => "│",
        };
        brush.buffer[(divider.x, y)].set_symbol(sign).set_style(style);
    }
    if page.events.height > 0 {
        brush.buffer[(divider.x, page.events.y)].set_symbol("┴").set_style(style);
    }
}
