//! Gates: decide when a command can use its input, a bus or a file, or that it never can.
//!
//! Each is called after every wake-up and returns `Ok(true)` if its input can be used, `Ok(false)`
//! to wait, and an error if waiting does not help.

use super::headless::{why_not_open, why_unusable};
use super::{Failure, output, report};
use crate::app::{App, Bus, FileIndex};
use crate::bus::BusSpec;
use crate::status::Link;
use crate::time::{Duration, Instant};

/// Gate of the buses.
#[derive(Debug)]
pub struct BusGate {
    /// A bus that was open once may go down: the command waits until it is up again.
    tolerates_outages: bool,
    was_open: Vec<bool>,
    /// The waiting for a missing interface was reported.
    is_wait_reported: bool,
}

impl BusGate {
    /// A gate that no bus has passed.
    pub fn new(tolerates_outages: bool) -> Self {
        Self { tolerates_outages, was_open: Vec::new(), is_wait_reported: false }
    }

    /// Returns true if all buses were open once. A CAN interface that does not exist is waited for,
    /// with a line on standard error.
    ///
    /// # Errors
    /// A bus cannot be used, and it is not waited for.
    pub fn allows(&mut self, app: &App, now: Instant) -> Result<bool, Failure> {
        self.was_open.resize(app.buses().len(), false);
        for (bus, was_open) in app.buses().iter().zip(&mut self.was_open) {
            *was_open |= bus.status.link == Link::Up;
            let waits = self.tolerates_outages && *was_open && bus.status.link != Link::Failed;
            let Some(why) = why_unusable(bus, now).filter(|_| !waits) else { continue };
            if !is_awaited(bus) {
                return Err(Failure::Unusable(why));
            }
            if !std::mem::replace(&mut self.is_wait_reported, true) {
                output::warn(format_args!("waiting for {}: {why}", bus.name));
            }
        }
        Ok(self.was_open.iter().all(|was_open| *was_open))
    }

    /// At the end of a run: a bus that was never open was not observed.
    ///
    /// # Errors
    /// A bus was never open.
    pub fn require_opened(&self, app: &App) -> Result<(), Failure> {
        let mut buses = app.buses().iter().zip(&self.was_open).filter(|(_, was_open)| !**was_open);
        let why = buses.find_map(|(bus, _)| why_not_open(bus));
        why.map_or(Ok(()), |why| Err(Failure::Unusable(why)))
    }
}

/// Returns true for a CAN interface that does not exist: its adapter may not be connected yet.
fn is_awaited(bus: &Bus) -> bool {
    let is_interface = || matches!(bus.name.parse(), Ok(BusSpec::SocketCan(_)));
    bus.status.link == Link::Missing && is_interface()
}

/// Gate of des.json. Other programs may write it, possibly in several steps: a file that had
/// entries is expected to have entries again.
#[derive(Debug, Default)]
pub struct FileGate {
    /// By file: it had entries.
    had_entries: Vec<bool>,
}

impl FileGate {
    /// Time from the start in which invalid JSON may be a file that is just being written.
    const START: Duration = Duration::from_secs(1);

    /// Returns true if the buses can be compared with their files now.
    ///
    /// # Errors
    /// A file is missing or invalid, and had no entries before.
    pub fn allows(&mut self, app: &App, now: Instant) -> Result<bool, Failure> {
        let mut all_allow = true;
        for (index, file) in app.files() {
            let at = usize::from(index.0);
            if self.had_entries.len() <= at {
                self.had_entries.resize(at + 1, false);
            }
            let has_entries = !file.document().entries().is_empty();
            self.had_entries[at] |= file.is_there() && has_entries;
            let had_any = self.had_entries[at];
            all_allow &= if let Err(failure) = require_file_at(app, index) {
                let is_new = file.problem().is_some() && now.since(Instant::ZERO) < Self::START;
                if !had_any && !is_new {
                    return Err(failure);
                }
                false
            } else {
                file.emptied_since().is_none() && (has_entries || !had_any)
            };
        }
        Ok(all_allow)
    }
}

/// Requires that each des.json can be used.
///
/// # Errors
/// One is missing or invalid.
pub fn require_file(app: &App) -> Result<(), Failure> {
    app.files().try_for_each(|(file, _)| require_file_at(app, file))
}

/// Requires that each des.json that is there can be used.
///
/// # Errors
/// One is invalid.
pub fn require_valid_file(app: &App) -> Result<(), Failure> {
    app.files().try_for_each(|(file, _)| require_valid_at(app, file))
}

fn require_valid_at(app: &App, index: FileIndex) -> Result<(), Failure> {
    let file = report::of_file(&app.file_snapshot(index));
    file.problem.map_or(Ok(()), |text| Err(Failure::Unusable(text)))
}

fn require_file_at(app: &App, index: FileIndex) -> Result<(), Failure> {
    require_valid_at(app, index)?;
    if !app.file_at(index).is_there() {
        let path = report::of_file(&app.file_snapshot(index)).path;
        // In a project without BUS all buses would be written.
        let is_one_of_several = app.files().count() > 1;
        let bus = app.buses_of_file(index).next().filter(|_| is_one_of_several);
        let bus = bus.map_or("BUS", |bus| bus.name.as_str());
        return Err(Failure::Unusable(format!(
            "{path}: file not found; create it with: descan scan {bus} --write {path}"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::{AppOptions, FileReading};

    fn content(text: &str) -> FileReading {
        FileReading::Content(Some(text.as_bytes().to_vec()))
    }

    /// Results of the gate for these contents, 1.5 s apart; `None` is an error.
    fn allowed(readings: impl IntoIterator<Item = FileReading>) -> Vec<Option<bool>> {
        let file_path = Some("des.json".into());
        let mut app = App::new(Instant::ZERO, AppOptions { file_path, ..AppOptions::default() });
        let mut gate = FileGate::default();
        let mut now = Instant::ZERO;
        let mut read = |reading| {
            app.handle_file(now, FileIndex::default(), reading);
            app.handle_timeout(now);
            let allowed = gate.allows(&app, now).ok();
            now += Duration::from_millis(1500);
            app.handle_timeout(now);
            allowed
        };
        readings.into_iter().map(&mut read).collect()
    }

    #[test]
    fn file_gate_waits_for_a_file_that_was_valid() {
        let good = || content(r#"[{"name":"FEED","address":12}]"#);
        let yes = Some(true);
        for gone in [FileReading::Content(None), content("[{\"na"), content(""), content("[]")] {
            assert_eq!(
                allowed([good(), gone.clone(), gone, good()]),
                [yes, Some(false), Some(false), yes]
            );
        }
        assert_eq!(allowed([content("[]")]), [yes], "no entries");
    }

    #[test]
    fn file_gate_rejects_a_file_that_was_never_valid() {
        assert_eq!(allowed([FileReading::Content(None)]), [None]);
        let broken = content("[{\"na");
        assert_eq!(allowed([broken.clone(), broken]), [Some(false), None]);
    }
}
