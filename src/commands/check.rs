//! `descan check`: compares a bus or a log with des.json and prints the differences. Enumerates as
//! `scan` does.

use super::gate::{FileGate, require_file};
use super::headless::{RunOutcome, warn_all_tx_blocked, warn_foreign};
use super::open::{self, Setup};
use super::report::ScanReport;
use super::scan::{DEFAULT_TIME, look, read_log, warn_incomplete};
use super::test_report::{CaseOutcome, ReportedCase, test_report};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::app::{App, Bus, EntryPlace, FileIndex, Scope};
use crate::cli::CheckArgs;
use crate::discovery::Device;
use crate::finding::{CheckSection, Finding, FindingKind, FindingState};
use crate::shell::stop::StopReason;
use crate::text::counted;
use crate::time::Instant;
use std::fmt::Write as _;

/// Runs it.
pub fn run(check: &CheckArgs) -> Result<u8, Failure> {
    #[cfg(feature = "fleet")]
    if let Some((folder, broker)) = check.fleet.as_ref().zip(check.broker.as_ref()) {
        return super::fleet_check::run(check, folder, broker);
    }
    #[cfg(feature = "fleet")]
    if check.broker.is_some() {
        let why =
            "--broker needs --fleet FOLDER, and no bus: descan check --fleet FOLDER --broker URL";
        return Err(Failure::Usage(why.to_owned()));
    }
    let buses = open::buses(&check.run.session)?;
    let setup = Setup::for_buses(&check.run.session.common, &buses)?;
    let log = open::log(&buses, "check", check.run.from)?;
    let RunOutcome { app, now, ending, recording } = if let Some(log) = log {
        read_log(log, (check.run.from, check.run.time), &setup, require_file)?
    } else {
        let mut file = FileGate::default();
        look(&buses, &setup, check.run.time.unwrap_or(DEFAULT_TIME), |app, now| {
            let usable = file.allows(app, now)?;
            Ok(usable && (!check.wait_for_all || is_complete(app, now)))
        })?
    };
    require_file(&app)?;
    if ending == Some(StopReason::Interrupted) {
        return Ok(EXIT_INTERRUPTED);
    }
    if let Some(log) = log.filter(|_| app.buses().is_empty()) {
        return Err(Failure::Unusable(format!("{log}: no frames in it; check the file name")));
    }
    if log.is_none() {
        warn_incomplete(&app, ending);
    }
    warn_all_tx_blocked(&app, now);
    warn_foreign(&app, &mut Vec::new());
    warn_uncounted_conflicts(&app);
    let report = ScanReport::new(&app, now, Scope::Check);
    if let Some(format) = check.report {
        let name = format!("descan check {}", names_of_files(&app));
        output::print(&test_report(&name, &cases(&app, now), format))?;
    } else {
        report.print(check.run.json, |_| differences(&app, now))?;
    }
    recording?;
    Ok(if report.has_findings() { EXIT_FINDINGS } else { EXIT_OK })
}

/// Most conflicts that do not count and are named.
const NAMED_CONFLICTS: usize = 8;

/// Warns of conflicts that do not count as a difference: suspected ones, those that were over before
/// the end, and repeated frames, behind which a second board may be.
fn warn_uncounted_conflicts(app: &App) {
    let found = app.buses().iter().flat_map(Bus::findings);
    let found = found.filter(|it| it.key.kind.may_be_conflict());
    let uncounted = found.filter_map(|it| match it.state {
        FindingState::Suspected => Some(("suspected", it)),
        FindingState::Cleared if it.was_confirmed && it.superseded_by.is_none() => {
            Some(("over", it))
        }
        FindingState::Cleared | FindingState::Confirmed => None,
    });
    warn_conflicts(uncounted.map(|(state, it)| format!("{state}: {}", line_of(app, it))));
}

/// Warns of conflicts that do not count, each in a line.
pub(super) fn warn_conflicts(lines: impl Iterator<Item = String>) {
    let lines: Vec<String> = lines.collect();
    for line in lines.iter().take(NAMED_CONFLICTS) {
        output::warn(format_args!("{line}"));
    }
    if let Some(more) = lines.len().checked_sub(NAMED_CONFLICTS).filter(|more| *more > 0) {
        let conflicts = counted(more as u64, "further conflict");
        output::warn(format_args!("{conflicts} not listed; they do not count"));
    }
}

/// Returns true if every entry has its device, with known services where the file lists them.
fn is_complete(app: &App, now: Instant) -> bool {
    let missing =
        app.compare(now, Scope::Check).iter().any(|it| it.key.kind == FindingKind::Missing);
    let entries = app.files().flat_map(|(file, state)| {
        let entries = state.document().entries().iter();
        entries.map(move |entry| (EntryPlace { file, index: entry.index }, entry))
    });
    let unknown = entries.into_iter().any(|(place, entry)| {
        let mut devices = app.matching().devices_of(place).iter();
        entry.listed_services().is_some()
            && devices.any(|id| app.device(*id).is_some_and(|it| it.services.is_none()))
    });
    !missing && !unknown
}

fn names_of_files(app: &App) -> String {
    app.files().map(|(_, file)| file.name()).collect::<Vec<_>>().join(", ")
}

/// The confirmed findings: of the buses, then of the comparison.
fn confirmed(app: &App, now: Instant) -> Vec<Finding> {
    let engines = app.buses().iter().flat_map(Bus::findings).cloned();
    let all = engines.chain(app.compare(now, Scope::Check));
    all.filter(|it| it.state == FindingState::Confirmed).collect()
}

/// A test for each kind of difference, of each file.
fn cases(app: &App, now: Instant) -> Vec<ReportedCase> {
    let found = confirmed(app, now);
    let of_section = |file: FileIndex, section: CheckSection| {
        let details = found
            .iter()
            .filter(|it| it.key.kind.check_section() == Some(section) && is_of(app, it, file))
            .map(|it| line_of(app, it));
        let details: Vec<String> = details.collect();
        let (outcome, text) = match details.len() {
            0 => (CaseOutcome::Passed, "no difference".to_owned()),
            count => {
                let title = if count == 1 { section.singular() } else { section.title() };
                (CaseOutcome::Failed, format!("{count} {title}"))
            }
        };
        let suite = app.file_at(file).name();
        ReportedCase { suite, name: section.title().to_owned(), outcome, text, details }
    };
    let files = app.files().map(|(file, _)| file);
    let cases = files.flat_map(|file| CheckSection::ALL.map(|section| of_section(file, section)));
    cases.collect()
}

/// Returns true if a finding is about a bus that has this file; one about no bus is of the first.
fn is_of(app: &App, finding: &Finding, file: FileIndex) -> bool {
    let of_bus = finding.key.bus.map(|bus| app.file_of_bus(bus));
    of_bus.unwrap_or_default() == file
}

/// A finding in a line: its bus, where there are several, and its text.
fn line_of(app: &App, finding: &Finding) -> String {
    let bus = finding.key.bus.and_then(|bus| app.bus(bus));
    let bus = bus.filter(|_| app.buses().len() > 1);
    let bus = bus.map_or(String::new(), |bus| format!("{}: ", bus.name));
    // Its text names the place in the file, but not the device.
    let whose = finding.names.first().filter(|_| finding.key.kind == FindingKind::FileShape);
    let whose = whose.map_or(String::new(), |name| format!("{name}: "));
    format!("{bus}{whose}{}", finding.text)
}

/// The differences as text: one line each, in groups, and a summary.
fn differences(app: &App, now: Instant) -> String {
    let found = confirmed(app, now);
    let mut text = String::new();
    for section in CheckSection::ALL {
        let title = section.title();
        let is_in = |it: &&Finding| it.key.kind.check_section() == Some(section);
        let mut group: Vec<_> = found.iter().filter(is_in).collect();
        if group.is_empty() {
            continue;
        }
        group.sort_by_key(|it| (it.position, it.key.bus, it.key.address));
        let _ = writeln!(text, "{title}:");
        for finding in &group {
            let _ = writeln!(text, "  {}", line_of(app, finding));
        }
    }
    for (index, file) in app.files() {
        let sums = CheckSection::ALL.into_iter().filter_map(|section| {
            let is_in = |it: &&Finding| it.key.kind.check_section() == Some(section);
            let count = found.iter().filter(is_in).filter(|it| is_of(app, it, index)).count();
            let title = if count == 1 { section.singular() } else { section.title() };
            (count > 0).then(|| format!("{count} {title}"))
        });
        let sums: Vec<String> = sums.collect();
        let entries = many(file.document().entries().len(), "entry", "entries");
        let verdict = if sums.is_empty() { "no difference".to_owned() } else { sums.join(", ") };
        let buses = devices_of_file(app, index);
        let _ = writeln!(text, "{}: {entries}, {buses}: {verdict}", file.name());
    }
    text
}

/// The present devices on the buses of a file: `3 devices on can0`.
fn devices_of_file(app: &App, file: FileIndex) -> String {
    let is_here = |device: &&Device| device.is_present() && !device.is_debug;
    let buses = app.buses_of_file(file).map(|bus| {
        let devices = bus.devices().iter().filter(is_here).count();
        format!("{} on {}", many(devices, "device", "devices"), bus.name)
    });
    buses.collect::<Vec<_>>().join(", ")
}

fn many(count: usize, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}
