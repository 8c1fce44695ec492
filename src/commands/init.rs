//! `descan init`: the project file of the buses at hand.

use super::open::{self, Setup};
use super::scan::{DEFAULT_TIME, look, read_log};
use super::{EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::app::{App, Bus};
use crate::bus::BusSpec;
use crate::cli::{CommonArgs, InitArgs};
use crate::diagnostic::Diagnostic;
use crate::project::FILE_NAME;
use crate::shell::stop::StopReason;
use crate::shell::store::{Store, write_new};
use crate::text::{counted, join_first, printable_path};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Devices that a comment names; the others are counted.
const NAMED: usize = 12;

/// Enumerates the buses and writes the file; one that is there is not replaced.
pub fn run(args: &InitArgs) -> Result<u8, Failure> {
    let path = Path::new(FILE_NAME);
    if path.symlink_metadata().is_ok() {
        let fault = Diagnostic::new("already exists").with_remedy("edit it, or move it away first");
        return Err(fault.of(printable_path(path)).into());
    }
    Store::new(path).check_new().map_err(|fault| fault.of(printable_path(path)))?;
    // Of a folder above: this is another project.
    let common = CommonArgs { no_project: true, project: None, ..args.session.common.clone() };
    let session = crate::cli::SessionArgs { common, ..args.session.clone() };
    let buses = open::buses(&session)?;
    if let Some(bus) = buses.iter().find(|bus| **bus == BusSpec::Stdin) {
        return Err(Failure::Usage(format!("{bus} cannot be in a project; name a bus or a log")));
    }
    let setup = Setup::for_buses(&session.common, &buses)?;
    let found = match open::log(&buses, "init", None)? {
        Some(log) => read_log(log, (None, args.time), &setup, |_| Ok(()))?,
        None => look(&buses, &setup, args.time.unwrap_or(DEFAULT_TIME), |_, _| Ok(true))?,
    };
    if found.ending == Some(StopReason::Interrupted) {
        return Ok(EXIT_INTERRUPTED);
    }
    found.recording?;
    let text = project_text(&buses, &found.app, &setup, &session.common);
    write_new(path, None, |file| file.write_all(text.as_bytes()))
        .map_err(|fault| fault.of(printable_path(path)))?;
    output::print(&text)?;
    output::warn(format_args!("wrote {FILE_NAME}"));
    if !setup.file.exists() {
        let file = printable_path(&setup.file);
        output::warn(format_args!("there is no {file} yet: descan scan --write {file}"));
    }
    Ok(EXIT_OK)
}

/// The text of the project file.
fn project_text(buses: &[BusSpec], app: &App, setup: &Setup, common: &CommonArgs) -> String {
    let quoted = |text: String| toml::Value::String(text).to_string();
    let path = |path: &Path| quoted(path.display().to_string());
    let mut text = String::new();
    match &common.profile {
        Some(profile) => {
            let _ = writeln!(text, "profile = {}", path(profile));
        }
        None => {
            text.push_str("# profile = \"profile.toml\"  # values that the protocol leaves open\n");
        }
    }
    let _ = writeln!(text, "file = {}", path(&setup.file));
    if !common.catalogue.is_empty() {
        let folders: Vec<String> = common.catalogue.iter().map(|folder| path(folder)).collect();
        let _ = writeln!(text, "catalogue = [{}]", folders.join(", "));
    }
    for spec in buses {
        let bus = app.buses().iter().find(|bus| bus.name == spec.to_string());
        let rate = bus.and_then(|bus| bus.config().bitrate);
        let _ = writeln!(text, "\n[[bus]]\nbus = {}", quoted(without_rate(spec)));
        if let Some(rate) = rate {
            let _ = writeln!(text, "bitrate = {rate}");
        }
        if let Some(devices) = bus.and_then(devices_of) {
            let _ = writeln!(text, "# {devices}");
        }
    }
    text
}

/// A project sets no bit rate.
fn without_rate(spec: &BusSpec) -> String {
    match spec {
        BusSpec::Slcan(adapter) => format!("slcan:{}", adapter.device.display()),
        other => other.to_string(),
    }
}

/// The devices of a bus in a comment: `2 devices: FEED 10, SENS 12`; `None` without any.
fn devices_of(bus: &Bus) -> Option<String> {
    let devices = bus.devices().iter().filter(|device| device.is_present() && !device.is_debug);
    let label = |device: &crate::discovery::Device| {
        let name = device.name.as_ref().map_or("?".to_owned(), ToString::to_string);
        format!("{name} {}", device.address)
    };
    let labels: Vec<String> = devices.map(label).collect();
    let count = counted(labels.len() as u64, "device");
    (!labels.is_empty()).then(|| format!("{count}: {}", join_first(labels, NAMED, ", ")))
}
