//! Statistics of a log as text and as JSON.
//!
//! Scripts rely on the names, types and meanings of the JSON members. Does not know how frames are
//! counted.

use super::frame_json::{name_of, service_name_of};
use super::frame_text::{left, right, with_address};
use super::stats::{LogIntervals, LogStats};
use crate::app::{
    App, Bus, CallStats, Decoded, FrameRole, IdentifierKind, IdentifierStats, clock_millis,
};
use crate::frame::{BusIndex, CanId};
use crate::text::counted;
use crate::time::{Duration, Instant};
use crate::wire::id::{Address, Header};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use unicode_width::UnicodeWidthStr;

// ---- JSON ----------------------------------------------------------------------------------

/// The statistics. What is not known is `None`.
#[derive(Debug, Serialize)]
pub struct StatsReport<'a> {
    descan: &'static str,
    frames: u64,
    /// Unix seconds of the first and the last frame.
    first: Option<f64>,
    last: Option<f64>,
    /// Frames by kind, as in a filter behind `type:`.
    kinds: BTreeMap<&'static str, u64>,
    /// Error frames by kind.
    errors: ErrorKindsReport,
    identifiers: Vec<IdentifierReport<'a>>,
    /// Frames without a row: the table is full.
    identifiers_left_out: u64,
    calls: Vec<CallReport<'a>>,
    /// Requests without a row.
    calls_left_out: u64,
}

#[derive(Debug, Serialize)]
struct ErrorKindsReport {
    stuff: u64,
    crc: u64,
    form: u64,
    bit: u64,
    no_ack: u64,
    other: u64,
}

#[derive(Debug, Serialize)]
struct IdentifierReport<'a> {
    bus: Option<&'a str>,
    /// Hexadecimal digits, without the random bits of a broadcast; `None` for error frames.
    id: Option<String>,
    extended: bool,
    fd: bool,
    kind: &'static str,
    from: Option<u8>,
    to: Option<u8>,
    from_name: Option<String>,
    to_name: Option<String>,
    service: Option<u16>,
    service_name: Option<String>,
    count: u64,
    rate: Option<f64>,
    period_ms: Option<PeriodReport>,
}

#[derive(Debug, Serialize)]
struct PeriodReport {
    min: f64,
    mean: f64,
    max: f64,
    /// Of the last 256 intervals.
    jitter: Option<f64>,
}

#[derive(Debug, Serialize)]
struct CallReport<'a> {
    bus: Option<&'a str>,
    client: u8,
    /// `None` for broadcasts.
    server: Option<u8>,
    client_name: Option<String>,
    server_name: Option<String>,
    service: u16,
    service_name: Option<String>,
    calls: u64,
    rate: Option<f64>,
    responses: u64,
    unanswered: u64,
    failed: u64,
    ambiguous: u64,
    /// Of the last 1024 calls.
    latency_ms: Option<LatencyReport>,
}

#[derive(Debug, Serialize)]
struct LatencyReport {
    p50: f64,
    p99: f64,
    max: f64,
}

impl<'a> StatsReport<'a> {
    /// Returns the report of statistics.
    pub fn new(app: &'a App, stats: &LogStats) -> Self {
        let errors = stats.errors;
        let unix = |at| app.epoch().unix_secs(at);
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            frames: stats.frames,
            first: stats.span.map(|(first, _)| unix(first)),
            last: stats.span.map(|(_, last)| unix(last)),
            kinds: stats.roles().map(|(role, count)| (role.type_word(), count)).collect(),
            errors: ErrorKindsReport {
                stuff: errors.stuff,
                crc: errors.crc,
                form: errors.form,
                bit: errors.bit,
                no_ack: errors.no_ack,
                other: errors.other,
            },
            identifiers: rows(app, stats)
                .into_iter()
                .map(|row| identifier(app, stats, row))
                .collect(),
            identifiers_left_out: stats.identifiers.refused(),
            calls: stats.call_rows(app).map(|row| call(app, stats, row)).collect(),
            calls_left_out: stats.calls.refused(),
        }
    }
}

/// An identifier with its intervals in the whole log.
type IdentifierRow<'a> = (&'a IdentifierStats, Option<&'a LogIntervals>);

fn identifier<'a>(
    app: &'a App,
    stats: &LogStats,
    (row, intervals): IdentifierRow,
) -> IdentifierReport<'a> {
    let (bus, last) = (row.key.bus, row.last.time);
    let decoded = Decoded::of(app, &row.last);
    let header = decoded.header;
    let receiver = header.filter(|header| !header.broadcast).map(|header| header.destination);
    let name_of_service = |header: Header| {
        if decoded.role == FrameRole::Debug {
            let types = app.shown_buses().frame_types(Some(header), &row.last);
            return types.debug_name(&app.profile(bus), header.service);
        }
        let server = header.response.then_some((header.source, last));
        service_name_of(app, bus, header.service, server)
    };
    let is_error = row.key.kind == IdentifierKind::Error;
    IdentifierReport {
        bus: bus_name(app, bus),
        id: (!is_error).then(|| row.key.id.to_string()),
        extended: !is_error && matches!(row.key.id, CanId::Extended(_)),
        fd: row.key.fd,
        kind: decoded.role.type_word(),
        from: header.map(|header| header.source.number()),
        to: receiver.map(Address::number),
        from_name: header.and_then(|header| name_of(app, bus, header.source, last)),
        to_name: receiver.and_then(|address| name_of(app, bus, address, last)),
        service: header.map(|header| header.service.number()),
        service_name: header.and_then(name_of_service),
        count: row.count,
        rate: stats.rate(row.count),
        period_ms: intervals.and_then(|it| period(it, row)),
    }
}

fn period(intervals: &LogIntervals, row: &IdentifierStats) -> Option<PeriodReport> {
    Some(PeriodReport {
        min: millis(intervals.min),
        mean: millis(intervals.mean()?),
        max: millis(intervals.max),
        jitter: row.period().map(|period| millis(period.jitter)),
    })
}

fn call<'a>(app: &'a App, stats: &LogStats, row: &CallStats) -> CallReport<'a> {
    let key = row.key;
    let name = |address| name_of(app, key.bus, address, row.last);
    CallReport {
        bus: bus_name(app, key.bus),
        client: key.client.number(),
        server: key.server.map(Address::number),
        client_name: name(key.client),
        server_name: key.server.and_then(name),
        service: key.service.number(),
        service_name: service_name_of(
            app,
            key.bus,
            key.service,
            key.server.map(|address| (address, row.last)),
        ),
        calls: row.calls,
        rate: stats.rate(row.calls),
        responses: row.responses,
        unanswered: row.unanswered,
        failed: row.failed,
        ambiguous: row.ambiguous,
        latency_ms: row.latency().map(|it| LatencyReport {
            p50: millis(it.p50),
            p99: millis(it.p99),
            max: millis(it.max),
        }),
    }
}

fn millis(time: Duration) -> f64 {
    time.as_micros() as f64 / 1e3
}

fn bus_name(app: &App, bus: BusIndex) -> Option<&str> {
    app.bus(bus).map(Bus::name_without_rates)
}

/// Returns the identifiers by bus and identifier.
fn rows<'a>(app: &'a App, stats: &'a LogStats) -> Vec<IdentifierRow<'a>> {
    let mut rows = stats.identifier_rows(app);
    rows.sort_by_key(|(row, _)| row.key);
    rows
}

// ---- text ----------------------------------------------------------------------------------

/// Returns a time, with its date if another one is on another day.
fn time_text(app: &App, at: Instant, other: Instant) -> String {
    let (date, time) = (app.date_text(at), clock_millis(app, at));
    if app.date_text(other) == date { time } else { format!("{date} {time}") }
}

/// Returns the statistics as tables.
pub fn text(app: &App, stats: &LogStats) -> String {
    let mut text = String::new();
    let frames = counted(stats.frames, "frame");
    let _ = match stats.span {
        None => writeln!(text, "{frames}"),
        Some((first, last)) => writeln!(
            text,
            "{frames}, {} to {} ({:.3} s)",
            time_text(app, first, last),
            time_text(app, last, first),
            last.since(first).as_secs_f64()
        ),
    };
    let kinds = stats.roles().map(|(role, count)| (role.type_word(), count));
    let _ = write_counts(&mut text, "kinds  ", kinds);
    let _ = write_counts(&mut text, "errors ", stats.errors.words().into_iter());
    text += &identifier_table(app, stats);
    text += &call_table(app, stats);
    for (count, what) in [
        (stats.identifiers.refused(), "frame not in the table: too many identifiers"),
        (stats.calls.refused(), "request not in the table: too many calls"),
    ] {
        if count > 0 {
            let _ = writeln!(text, "\n{count}× {what}");
        }
    }
    text
}

/// Writes a line of counts, without those that are 0.
fn write_counts(
    text: &mut String,
    title: &str,
    counts: impl Iterator<Item = (&'static str, u64)>,
) -> std::fmt::Result {
    let counts: Vec<_> = counts.filter(|(_, count)| *count > 0).collect();
    if counts.is_empty() {
        return Ok(());
    }
    let counts: Vec<_> = counts.iter().map(|(word, count)| format!("{word} {count}")).collect();
    writeln!(text, "{title}{}", counts.join(", "))
}

fn identifier_table(app: &App, stats: &LogStats) -> String {
    let mut table = TextTable::new(&[
        "BUS",
        ">ID",
        "KIND",
        ">FROM",
        "TO",
        "SERVICE",
        ">COUNT",
        ">/s",
        ">MIN ms",
        ">AVG ms",
        ">MAX ms",
        ">JITTER ms",
    ]);
    for (row, intervals) in rows(app, stats) {
        let decoded = Decoded::of(app, &row.last);
        let (from, to) = decoded.header.map_or_else(Default::default, |header| {
            let to = if header.broadcast {
                "all".to_owned()
            } else {
                with_address(&decoded.destination, header.destination)
            };
            (with_address(&decoded.source, header.source), to)
        });
        let id = match row.key.kind {
            IdentifierKind::Error => String::new(),
            _ => row.key.id.to_string(),
        };
        let period = intervals.and_then(|it| period(it, row));
        let cell =
            |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |it| format!("{it:.1}"));
        table.push([
            bus_name(app, row.key.bus).unwrap_or("?").to_owned(),
            id,
            decoded.role.word().to_owned(),
            from,
            to,
            decoded.service,
            row.count.to_string(),
            cell(stats.rate(row.count)),
            cell(period.as_ref().map(|it| it.min)),
            cell(period.as_ref().map(|it| it.mean)),
            cell(period.as_ref().map(|it| it.max)),
            period.and_then(|it| it.jitter).map_or("–".to_owned(), |it| format!("±{it:.1}")),
        ]);
    }
    table.text(app)
}

fn call_table(app: &App, stats: &LogStats) -> String {
    let mut table = TextTable::new(&[
        "BUS", ">CLIENT", "SERVER", "SERVICE", ">CALLS", ">/s", ">p50 ms", ">p99 ms", ">MAX ms",
        ">UNANSW", ">FAILED",
    ]);
    for row in stats.call_rows(app) {
        let key = row.key;
        let end = |address| with_address(&app.name_at(key.bus, address, row.last), address);
        let latency = row.latency();
        // Of some calls it is not certain which request a response is to.
        let about = if row.ambiguous > 0 { "≈" } else { "" };
        let cell = |time: Option<Duration>| {
            time.map_or_else(|| "–".to_owned(), |it| format!("{about}{:.1}", millis(it)))
        };
        table.push([
            bus_name(app, key.bus).unwrap_or("?").to_owned(),
            end(key.client),
            key.server.map_or_else(|| "all".to_owned(), end),
            app.service_name(key.bus, key.service, key.server),
            row.calls.to_string(),
            stats.rate(row.calls).map_or_else(|| "–".to_owned(), |it| format!("{it:.1}")),
            cell(latency.map(|it| it.p50)),
            cell(latency.map(|it| it.p99)),
            cell(latency.map(|it| it.max)),
            row.unanswered.to_string(),
            row.failed.to_string(),
        ]);
    }
    table.text(app)
}

/// Rows of cells in columns.
struct TextTable {
    /// Titles; those of right-aligned columns begin with `>`.
    titles: &'static [&'static str],
    rows: Vec<Vec<String>>,
}

impl TextTable {
    fn new(titles: &'static [&'static str]) -> Self {
        Self { titles, rows: Vec::new() }
    }

    fn push(&mut self, cells: impl Into<Vec<String>>) {
        self.rows.push(cells.into());
    }

    /// Returns an empty line and the table; nothing without a row. The first column is left out where
    /// there is one bus.
    fn text(mut self, app: &App) -> String {
        if self.rows.is_empty() {
            return String::new();
        }
        let titles = self.titles.iter().map(|title| title.trim_start_matches('>').to_owned());
        self.rows.insert(0, titles.collect());
        let first = usize::from(app.buses().len() <= 1);
        let width = |column| {
            self.rows.iter().filter_map(|row| Some(row.get::<usize>(column)?.width())).max()
        };
        let widths: Vec<usize> =
            (0..self.titles.len()).map(|column| width(column).unwrap_or(0)).collect();
        let mut text = String::from("\n");
        for row in &self.rows {
            let mut line = String::new();
            let cells = row.iter().zip(&widths).zip(self.titles).skip(first);
            for ((cell, width), title) in cells {
                let align = if title.starts_with('>') { right } else { left };
                align(&mut line, cell, *width);
                line.push_str("  ");
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
        text
    }
}
