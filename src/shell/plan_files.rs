//! Files of plans of addresses, in a folder of the user: written as a whole, found by their bus.
//!
//! A file is written to a temporary one beside it, synced, and put in its place, so that a power cut
//! leaves the old content or the new one. Does not know what is in a plan: see
//! [`crate::address_plan::PlanRecord`].

use super::state_folder::state_folder;
use crate::address_plan::{MAX_RECORD_BYTES, PlanRecord};
use crate::bus::BusSpec;
use crate::diagnostic::{Diagnostic, without_number};
use crate::open_file::{open_folder, sync_folder};
use crate::regular_file;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Why no plan can be stored.
const NO_HOME: &str = "no home folder; set XDG_STATE_HOME";
/// Most files that are looked at for the last plan of a bus, the latest first.
const MAX_LOOKED_AT: usize = 1000;

/// `$XDG_STATE_HOME/descan/plans`, by default `~/.local/state/descan/plans`; `None` without a home
/// folder.
pub fn plans_folder() -> Option<PathBuf> {
    Some(state_folder()?.join("plans"))
}

/// The right to run a plan on a bus, as long as it exists: on this machine one program has it.
pub struct PlanLock {
    _file: File,
}

impl PlanLock {
    /// Takes it.
    ///
    /// # Errors
    /// Another program has it, or the folder of plans cannot be used.
    pub fn take(bus: &str) -> Result<Self, String> {
        let folder = plans_folder().ok_or(NO_HOME)?;
        let name = PlanRecord::file_name(".lock", &bus_key(bus));
        let name = name.trim_end_matches(".json");
        let opened = fs::create_dir_all(&folder)
            .and_then(|()| File::options().create(true).append(true).open(folder.join(name)));
        let file =
            opened.map_err(|error| format!("{}: {}", folder.display(), without_number(&error)))?;
        file.try_lock().map_err(|_| "another program runs a plan on this bus".to_owned())?;
        Ok(Self { _file: file })
    }
}

/// Returns a text that all spellings of a bus share.
fn bus_key(bus: &str) -> String {
    bus.parse::<BusSpec>().map_or_else(|_| bus.to_owned(), |spec| spec.key())
}

/// Returns true if a plan is one of this bus, however it is written.
pub fn is_plan_of(record: &PlanRecord, bus: &str) -> bool {
    record.bus == bus || bus_key(&record.bus) == bus_key(bus)
}

/// Writes the file of a plan with this name; `is_new`: there must be none. Returns when it has reached
/// the disk.
///
/// # Errors
/// The cause, with the folder.
pub fn write_plan(name: &str, content: &[u8], is_new: bool) -> Result<(), String> {
    let folder = plans_folder().ok_or(NO_HOME)?;
    let written = write_in(&folder, name, content, is_new);
    written.map_err(|error| format!("{}: {}", folder.display(), without_number(&error)))
}

fn write_in(folder: &Path, name: &str, content: &[u8], is_new: bool) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let mut file = tempfile::Builder::new().prefix(".plan-").tempfile_in(folder)?;
    file.write_all(content)?;
    file.as_file().sync_all()?;
    let path = folder.join(name);
    let kept = if is_new { file.persist_noclobber(path) } else { file.persist(path) };
    kept.map_err(|failed| failed.error)?;
    sync_folder(&open_folder(folder)?)
}

/// Reads a plan: a path, or the name of a file in the folder of plans, with or without `.json`.
///
/// # Errors
/// It cannot be read, or is no plan; with its path.
pub fn read_plan(wanted: &str) -> Result<(String, PlanRecord), Diagnostic> {
    let folder = plans_folder().unwrap_or_default();
    let candidates =
        [PathBuf::from(wanted), folder.join(wanted), folder.join(format!("{wanted}.json"))];
    let path = candidates.into_iter().find(|path| path.is_file());
    let path = path.ok_or_else(|| {
        Diagnostic::new(format!(
            "{wanted}: plan not found, neither here nor in {}",
            folder.display()
        ))
    })?;
    let record = read_path(&path)?;
    Ok((file_name(&path), record))
}

/// Reads the latest plan of a bus; `None` if there is none.
///
/// # Errors
/// The latest file cannot be read, or is no plan.
pub fn latest_plan(bus: &str) -> Result<Option<(String, PlanRecord)>, Diagnostic> {
    let Some(folder) = plans_folder() else { return Ok(None) };
    let end = PlanRecord::file_name("", bus);
    let is_own = |name: &str| name.ends_with(&end);
    let entries = fs::read_dir(&folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name.strip_suffix(".json").is_some_and(|stem| !stem.starts_with('.')))
        .collect();
    // A name begins with its time.
    names.sort_unstable();
    for name in names.into_iter().rev().take(MAX_LOOKED_AT) {
        match read_path(&folder.join(&name)) {
            Ok(record) if is_plan_of(&record, bus) => return Ok(Some((name, record))),
            // That of another bus, by its name.
            Err(_) if !is_own(&name) => {}
            Err(fault) => return Err(fault),
            Ok(_) => {}
        }
    }
    Ok(None)
}

fn read_path(path: &Path) -> Result<PlanRecord, Diagnostic> {
    let shown = crate::text::printable_path(path);
    let content = regular_file::read(path, MAX_RECORD_BYTES).map_err(|fault| fault.of(&shown))?;
    let content = content.ok_or_else(|| Diagnostic::new("file not found").of(&shown))?;
    PlanRecord::parse(&content).map_err(|why| Diagnostic::new(why).of(&shown))
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
