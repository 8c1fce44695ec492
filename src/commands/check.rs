//! `descan check`: whether a bus is what des.json says. Looks as `scan` does, and prints the
//! differences.

use super::headless::{RunOutcome, warn_all_tx_blocked};
use super::open::{self, Setup};
use super::report::{self, ScanReport};
use super::scan::{DEFAULT_TIME, is_settled, look, read_log};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, print};
use crate::app::{App, Scope};
use crate::cli::CheckArgs;
use crate::finding::{CheckSection, Confidence, Finding, FindingKind};
use crate::shell::stop::StopReason;
use crate::time::Instant;
use std::fmt::Write as _;
use std::io::{self, Write};

/// Runs it.
pub fn run(check: &CheckArgs) -> Result<u8, Failure> {
    let buses = open::buses(&check.session)?;
    let setup = Setup::new(&check.session.common)?;
    let log = open::log(&buses, "check", check.from)?;
    let RunOutcome { app, now, ending } = if let Some(log) = log {
        read_log(log, (check.from, check.time), &setup, has_file)?
    } else {
        let mut patience = FileGate::default();
        look(&buses, &setup, check.time.unwrap_or(DEFAULT_TIME), |app, now| {
            let usable = patience.allows(app, now)?;
            Ok(usable && (!check.wait_for_all || is_complete(app, now)))
        })?
    };
    has_file(&app)?;
    if ending == Some(StopReason::Interrupted) {
        return Ok(EXIT_INTERRUPTED);
    }
    if let Some(log) = log.filter(|_| app.buses().is_empty()) {
        let text = format!("{log}: no frames in it: is it the right log?");
        return Err(Failure::Unusable(text));
    }
    if ending == Some(StopReason::TimeUp) && !is_settled(&app) {
        let why = "timed out before all responses arrived; use a longer --time";
        let _ = writeln!(io::stderr(), "descan: {why}");
    }
    warn_all_tx_blocked(&app, now);
    let report = ScanReport::new(&app, now, Scope::Check);
    let text = if check.json { report.json() } else { differences(&app, now) };
    print(text.as_bytes())?;
    Ok(if report.has_findings() { EXIT_FINDINGS } else { EXIT_OK })
}

/// Others write the file while the bus is looked at, and not all of them at once: what was good is
/// waited for, to be good again.
#[derive(Default)]
struct FileGate {
    had_entries: bool,
}

impl FileGate {
    /// For so long a file that is not JSON may be one that is just being written.
    const AT_START: crate::time::Duration = crate::time::Duration::from_secs(1);

    /// Whether the bus can be compared with the file now; an error where it is no use to wait.
    fn allows(&mut self, app: &App, now: Instant) -> Result<bool, Failure> {
        let file = app.file();
        self.had_entries |= file.is_there() && !file.document().entries().is_empty();
        if let Err(failure) = has_file(app) {
            let is_new = file.problem().is_some() && now.since(Instant::ZERO) < Self::AT_START;
            return if self.had_entries || is_new { Ok(false) } else { Err(failure) };
        }
        let has_entries = !file.document().entries().is_empty();
        Ok(file.emptied_since().is_none() && (has_entries || !self.had_entries))
    }
}

/// Without a file there is nothing to compare with.
fn has_file(app: &App) -> Result<(), Failure> {
    let file = app.file();
    let path = || report::path_of(app);
    if let Some(text) = report::of_file(app.file_snapshot()).problem {
        return Err(Failure::Unusable(text));
    }
    if !file.is_there() {
        return Err(Failure::Unusable(format!(
            "{}: file not found; create it with: descan scan BUS --write {}",
            path(),
            path()
        )));
    }
    Ok(())
}

/// Whether every entry has its device, and what the file lists of its services is known.
fn is_complete(app: &App, now: Instant) -> bool {
    let missing =
        app.compare(now, Scope::Check).iter().any(|it| it.key.kind == FindingKind::Missing);
    let unknown = app.file().document().entries().iter().any(|entry| {
        let mut devices = app.matching().devices_of(entry.index).iter();
        entry.listed_services().is_some()
            && devices.any(|id| app.device(*id).is_some_and(|it| it.services.is_none()))
    });
    !missing && !unknown
}

/// For people: a line for each difference, in groups, and a summary.
fn differences(app: &App, now: Instant) -> String {
    let compared = app.compare(now, Scope::Check);
    let engines = app.buses().iter().flat_map(|bus| bus.findings());
    let found: Vec<&Finding> =
        engines.chain(&compared).filter(|it| it.confidence == Confidence::Confirmed).collect();
    let mut text = String::new();
    let mut sums = Vec::new();
    for section in CheckSection::ALL {
        let title = section.title();
        let is_in = |it: &&&Finding| it.key.kind.check_section() == Some(section);
        let mut group: Vec<_> = found.iter().filter(is_in).collect();
        if group.is_empty() {
            continue;
        }
        group.sort_by_key(|it| (it.place, it.key.bus, it.key.address));
        let _ = writeln!(text, "{title}:");
        for finding in &group {
            let bus = finding.key.bus.and_then(|bus| app.bus(bus));
            let bus = bus.filter(|_| app.buses().len() > 1);
            let bus = bus.map_or(String::new(), |bus| format!("{}: ", bus.name));
            // Its text says where it is in the file, but not whose it is.
            let whose =
                finding.names.first().filter(|_| finding.key.kind == FindingKind::FileShape);
            let whose = whose.map_or(String::new(), |name| format!("{name}: "));
            let _ = writeln!(text, "  {bus}{whose}{}", finding.text);
        }
        sums.push(format!("{} {title}", group.len()));
    }
    let here = |bus: &crate::app::Bus| {
        bus.devices().iter().filter(|it| it.is_present() && !it.is_debug).count()
    };
    let buses: Vec<String> = app
        .buses()
        .iter()
        .map(|bus| format!("{} on {}", many(here(bus), "device", "devices"), bus.name))
        .collect();
    let file = app.file();
    let entries = many(file.document().entries().len(), "entry", "entries");
    let verdict = if sums.is_empty() { "no difference".to_owned() } else { sums.join(", ") };
    let _ = writeln!(text, "{}: {entries}, {}: {verdict}", file.name(), buses.join(", "));
    text
}

fn many(count: usize, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::{AppOptions, FileReading};
    use crate::time::Duration;

    fn content(text: &str) -> FileReading {
        FileReading::Content(Some(text.as_bytes().to_vec()))
    }

    /// What comes of these readings of the file, a second apart.
    fn allowed(readings: impl IntoIterator<Item = FileReading>) -> Vec<Option<bool>> {
        let file_path = Some("des.json".into());
        let mut app = App::new(Instant::ZERO, AppOptions { file_path, ..AppOptions::default() });
        let mut patience = FileGate::default();
        let mut now = Instant::ZERO;
        let mut read = |reading| {
            app.handle_file(now, reading);
            app.handle_timeout(now);
            let allowed = patience.allows(&app, now).ok();
            now += Duration::from_millis(1500);
            app.handle_timeout(now);
            allowed
        };
        readings.into_iter().map(&mut read).collect()
    }

    #[test]
    fn what_was_good_is_waited_for() {
        let good = || content(r#"[{"name":"FEED","address":12}]"#);
        let yes = Some(true);
        for gone in [FileReading::Content(None), content("[{\"na"), content(""), content("[]")] {
            assert_eq!(
                allowed([good(), gone.clone(), gone, good()]),
                [yes, Some(false), Some(false), yes]
            );
        }
        assert_eq!(allowed([content("[]")]), [yes], "none is listed");
    }

    #[test]
    fn what_was_never_good_is_an_error_soon() {
        assert_eq!(allowed([FileReading::Content(None)]), [None]);
        let broken = content("[{\"na");
        assert_eq!(allowed([broken.clone(), broken]), [Some(false), None]);
    }
}
