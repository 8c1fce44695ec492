//! `descan diff`: the differences between two logs or documents of `scan --json`, as a table or
//! JSON. A log counts with the state at its end.

use super::headless::{self, Limits, RunInput, warn_foreign};
use super::open::Setup;
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::app::AppOptions;
use crate::bus::{self, BusSpec};
use crate::cli::{CommonArgs, DiffArgs};
use crate::diagnostic::Diagnostic;
use crate::inventory::{
    Difference, DifferenceSide, DifferenceValue, Inventory, InventoryComparison, InventoryError,
    MAX_DOCUMENT_BYTES, compare,
};
use crate::open_file::{pipe_file, stdin_file};
use crate::shell::stop::StopReason;
use crate::text::counted;
use crate::time::Instant;
use serde::Serialize;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::thread;
use unicode_width::UnicodeWidthStr;

/// Runs it.
pub fn run(diff: &DiffArgs) -> Result<u8, Failure> {
    let specs = [&diff.before, &diff.after].map(|path| spec_of(path));
    if specs.iter().all(|spec| *spec == BusSpec::Stdin) {
        return Err(Failure::Usage(
            "standard input (-) can be read only once; name a file for one of them".to_owned(),
        ));
    }
    let setup = Setup::new(&CommonArgs::listen_only(diff.profile.clone()))?;
    let mut inputs = Vec::new();
    for spec in &specs {
        let Some(input) = read(spec, &setup)? else { return Ok(EXIT_INTERRUPTED) };
        inputs.push(input);
    }
    let [before, after] = &inputs[..] else { return Ok(EXIT_OK) };
    let compared = compare(&before.inventory, &after.inventory);
    if diff.json {
        let report = DiffReport::new(before, after, &compared);
        let json = serde_json::to_string_pretty(&report).expect("plain values are always JSON");
        output::print_json(&(json + "\n"))?;
    } else {
        output::print(&text(before, after, &compared))?;
    }
    Ok(if compared.differences.is_empty() { EXIT_OK } else { EXIT_FINDINGS })
}

/// One side: what it was read from, and its state.
struct DiffInput {
    path: String,
    is_log: bool,
    /// Unix time of the state; `None` for a document.
    time: Option<f64>,
    inventory: Inventory,
}

/// Returns what an argument names: `-`, or a file, with or without `file:`.
pub(super) fn spec_of(path: &Path) -> BusSpec {
    if path == Path::new("-") {
        return BusSpec::Stdin;
    }
    let plain = path.to_str().and_then(|text| text.strip_prefix("file:"));
    BusSpec::File(plain.map_or_else(|| path.to_owned(), PathBuf::from))
}

/// Reads a side; `None` if a signal stopped it.
fn read(spec: &BusSpec, setup: &Setup) -> Result<Option<DiffInput>, Failure> {
    let unusable = |error: io::Error| Failure::from(Diagnostic::unreadable(spec, &error));
    let file = match spec {
        BusSpec::File(path) if !path.exists() => {
            let missing = Diagnostic::new("file not found")
                .with_remedy("name a log, or a document of descan scan --json");
            return Err(missing.of(crate::text::printable_path(path)).into());
        }
        BusSpec::File(path) => bus::open_log(path)?,
        _ => stdin_file().map_err(unusable)?,
    };
    let path = match spec {
        BusSpec::File(path) => crate::text::printable_path(path),
        _ => "-".to_owned(),
    };
    let (head, file) = peek(file).map_err(unusable)?;
    if is_document(&head) {
        let mut bytes = Vec::new();
        (&file).take(MAX_DOCUMENT_BYTES + 1).read_to_end(&mut bytes).map_err(unusable)?;
        if bytes.len() as u64 > MAX_DOCUMENT_BYTES {
            let cause = format!("larger than {} MiB", MAX_DOCUMENT_BYTES >> 20);
            return Err(Diagnostic::new(cause).with_remedy("check the file name").of(path).into());
        }
        let inventory = Inventory::parse(&bytes).map_err(|error| {
            let remedy = match error {
                InventoryError::Json(_) => "make it again: descan scan BUS --json",
                InventoryError::NotAnInventory(_) => {
                    "make one: descan scan BUS --json; for des.json use descan check"
                }
            };
            Diagnostic::new(error.to_string()).with_remedy(remedy).of(&path)
        })?;
        return Ok(Some(DiffInput { path, is_log: false, time: None, inventory }));
    }
    let limits = Limits { stuck: EXIT_INTERRUPTED, ..Limits::default() };
    let input = RunInput::OpenLog(spec, &file);
    let run = headless::run(input, setup, AppOptions::default(), limits, |_| {
        Ok(ControlFlow::Continue(()))
    })?;
    if run.ending == Some(StopReason::Interrupted) {
        return Ok(None);
    }
    if run.app.buses().is_empty() {
        return Err(Failure::Unusable(format!("{spec}: no frames in it; check the file name")));
    }
    warn_foreign(&run.app, &mut Vec::new());
    let time = Some(unix_secs(&run.app, run.now));
    Ok(Some(DiffInput { path, is_log: true, time, inventory: run.app.inventory() }))
}

fn unix_secs(app: &crate::app::App, at: Instant) -> f64 {
    app.epoch().unix_secs(at)
}

/// Mark that some programs write in front of UTF-8.
const MARK: &[u8] = b"\xEF\xBB\xBF";

/// Returns true if a file that begins with these bytes is JSON. No log format begins like that.
fn is_document(head: &[u8]) -> bool {
    let head = head.strip_prefix(MARK).unwrap_or(head);
    let first = head.iter().find(|byte| !b" \t\r\n".contains(byte));
    matches!(first, Some(b'{' | b'['))
}

/// Returns the first bytes of a file, and the file as it was before. What cannot be read again, as a
/// pipe, is passed on through another pipe.
fn peek(mut file: File) -> io::Result<(Vec<u8>, File)> {
    /// Bytes in which JSON has begun.
    const HEAD: u64 = 512;
    let start = file.stream_position();
    let mut head = Vec::new();
    if let Ok(start) = start {
        (&file).take(HEAD).read_to_end(&mut head)?;
        file.seek(SeekFrom::Start(start))?;
        return Ok((head, file));
    }
    // One byte that is not blank decides: the rest of a live log may be long in coming.
    let is_decided = |head: &[u8]| {
        let begun = head.strip_prefix(MARK).unwrap_or(head);
        !MARK.starts_with(head) && begun.iter().any(|byte| !byte.is_ascii_whitespace())
    };
    while head.len() < HEAD as usize && !is_decided(&head) {
        let mut byte = [0];
        if file.read(&mut byte)? == 0 {
            break;
        }
        head.extend(byte);
    }
    let (from, mut to) = io::pipe()?;
    let begin = head.clone();
    // Detached: the other end may be closed, or never close its own.
    thread::Builder::new().name("input".into()).spawn(move || {
        let _ = to.write_all(&begin).and_then(|()| io::copy(&mut file, &mut to));
    })?;
    Ok((head, pipe_file(from)))
}

// ---- JSON ----------------------------------------------------------------------------------

#[derive(Serialize)]
struct DiffReport<'a> {
    descan: &'static str,
    before: DiffInputReport<'a>,
    after: DiffInputReport<'a>,
    buses: Vec<PairedBusReport<'a>>,
    differences: Vec<DifferenceReport<'a>>,
    not_known: Vec<UnknownReport>,
}

#[derive(Serialize)]
struct DiffInputReport<'a> {
    path: &'a str,
    kind: &'static str,
    time: Option<f64>,
}

#[derive(Serialize)]
struct PairedBusReport<'a> {
    before: &'a str,
    after: &'a str,
}

#[derive(Serialize)]
struct DifferenceReport<'a> {
    kind: &'static str,
    detail: Option<&'a str>,
    bus: Option<&'a str>,
    address: Option<u8>,
    name: Option<&'a str>,
    uid: Option<&'a str>,
    before: &'a DifferenceValue,
    after: &'a DifferenceValue,
}

#[derive(Serialize)]
struct UnknownReport {
    kind: &'static str,
    side: &'static str,
    devices: usize,
}

impl<'a> DiffReport<'a> {
    fn new(before: &'a DiffInput, after: &'a DiffInput, compared: &'a InventoryComparison) -> Self {
        let input =
            |it: &'a DiffInput| DiffInputReport { path: &it.path, kind: it.kind(), time: it.time };
        let unknown = compared.unknown.iter().map(|unknown| UnknownReport {
            kind: unknown.kind.name(),
            side: unknown.side.name(),
            devices: unknown.devices,
        });
        let buses = compared.buses.iter();
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            before: input(before),
            after: input(after),
            buses: buses
                .map(|bus| PairedBusReport { before: &bus.before, after: &bus.after })
                .collect(),
            differences: compared.differences.iter().map(DifferenceReport::new).collect(),
            not_known: unknown.collect(),
        }
    }
}

impl<'a> DifferenceReport<'a> {
    fn new(difference: &'a Difference) -> Self {
        let subject = difference.subject();
        Self {
            kind: difference.kind.name(),
            detail: Some(&*difference.detail).filter(|detail| !detail.is_empty()),
            bus: subject.and_then(|subject| subject.bus.as_deref()),
            address: subject.and_then(|subject| subject.address),
            name: subject.and_then(|subject| subject.name.as_deref()),
            uid: subject.and_then(|subject| subject.uid.as_deref()),
            before: &difference.before,
            after: &difference.after,
        }
    }
}

// ---- text ----------------------------------------------------------------------------------

impl DiffInput {
    /// Kind in JSON.
    fn kind(&self) -> &'static str {
        if self.is_log { "log" } else { "scan" }
    }
}

/// Returns the sides, a row for each difference, what was not compared, and the number of
/// differences.
fn text(before: &DiffInput, after: &DiffInput, compared: &InventoryComparison) -> String {
    let mut text = String::new();
    let width = before.path.width().max(after.path.width());
    for (title, input) in [("BEFORE", before), ("AFTER ", after)] {
        let space = " ".repeat(width - input.path.width());
        let devices = counted(input.inventory.present_devices() as u64, "device");
        let _ = writeln!(text, "{title}  {}{space}  {:4}  {devices}", input.path, input.kind());
    }
    for bus in compared.buses.iter().filter(|bus| bus.before != bus.after) {
        let _ = writeln!(text, "{} in BEFORE is compared with {} in AFTER", bus.before, bus.after);
    }
    text.push('\n');
    if !compared.differences.is_empty() {
        text.push_str(&table(compared));
        text.push('\n');
    }
    for unknown in &compared.unknown {
        let side = match unknown.side {
            DifferenceSide::Before => "BEFORE",
            DifferenceSide::After => "AFTER",
        };
        let _ = writeln!(text, "{}", unknown.text(side));
    }
    let _ = match compared.differences.len() {
        0 => writeln!(text, "no difference"),
        count => writeln!(text, "{}", counted(count as u64, "difference")),
    };
    text
}

/// Returns the differences as a table; with one bus without the column BUS.
fn table(compared: &InventoryComparison) -> String {
    let mut rows = vec![["BUS", "ADDR", "NAME", "WHAT", "BEFORE", "AFTER"].map(str::to_owned)];
    for difference in &compared.differences {
        let subject = difference.subject().cloned().unwrap_or_default();
        rows.push([
            subject.bus.unwrap_or_default(),
            subject.address.map(|address| address.to_string()).unwrap_or_default(),
            subject
                .name
                .unwrap_or_else(|| if subject.address.is_some() { "?" } else { "" }.to_owned()),
            difference.what(),
            difference.before.to_string(),
            difference.after.to_string(),
        ]);
    }
    let mut buses: Vec<&str> = rows[1..].iter().map(|row| &*row[0]).collect();
    buses.sort_unstable();
    buses.dedup();
    let first = usize::from(buses.len() <= 1 && compared.buses.len() <= 1);
    let widths: Vec<usize> = (0..rows[0].len())
        .map(|column| rows.iter().map(|row| row[column].width()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for row in &rows {
        let mut line = String::new();
        for (column, cell) in row.iter().enumerate().skip(first) {
            let space = " ".repeat(widths[column] - cell.width());
            // Addresses are right-aligned.
            let _ = match column {
                1 => write!(line, "{space}{cell}  "),
                _ => write!(line, "{cell}{space}  "),
            };
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}
