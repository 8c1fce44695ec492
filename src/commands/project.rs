//! The project of a command: found, read, and combined with the arguments.

use super::profile::fault;
use super::{Failure, output};
use crate::bus::BusSpec;
use crate::cli::CommonArgs;
use crate::project::Project;
use crate::regular_file::required_text;
use crate::shell::project_search::{self, FoundProject, agree, is_agreed};
use crate::text::printable_path;
use std::path::{Path, PathBuf};
use std::sync::Once;

/// Done once a file that is ignored was named.
static IS_NAMED: Once = Once::new();

/// Finds and reads the project; `None` without one. A file that is ignored is named, once.
///
/// # Errors
///
/// The file cannot be read, or has a mistake: the text has the place and the wrong line.
pub fn of(common: &CommonArgs) -> Result<Option<(PathBuf, Project)>, Failure> {
    if common.no_project {
        return Ok(None);
    }
    let found = match &common.project {
        Some(path) => FoundProject { path: Some(path.clone()), ignored: None },
        None => std::env::current_dir().map(|it| project_search::find(&it)).unwrap_or_default(),
    };
    if let Some((path, user)) = found.ignored.filter(|_| !IS_NAMED.is_completed()) {
        IS_NAMED.call_once(|| {});
        let path = printable_path(&path);
        output::warn(format_args!("{path} is of {user}: ignored; --project {path} takes it"));
    }
    let Some(path) = found.path else { return Ok(None) };
    let text = required_text(&path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let project = Project::parse(&text, folder);
    let project = project.map_err(|error| Failure::Unusable(fault(&path, &error)))?;
    Ok(Some((path, project)))
}

/// Returns the buses of the project, if the arguments name none; asks for those on other machines.
///
/// # Errors
///
/// As [`of`]; or the user refuses a bus, or cannot be asked.
pub fn buses(common: &CommonArgs) -> Result<Vec<BusSpec>, Failure> {
    let Some((path, project)) = of(common)? else { return Ok(Vec::new()) };
    let path = std::path::absolute(&path).unwrap_or(path);
    for bus in &project.buses {
        if is_remote(&bus.spec) && !is_agreed(&path, &bus.spec.to_string()) {
            ask_for(&path, &bus.spec)?;
        }
    }
    Ok(project.buses.into_iter().map(|bus| bus.spec).collect())
}

/// Returns true if frames of a bus come over a network.
fn is_remote(bus: &BusSpec) -> bool {
    match bus {
        BusSpec::Socketcand(_) | BusSpec::Udp(_) => true,
        BusSpec::SocketCan(_)
        | BusSpec::Slcan(_)
        | BusSpec::File(_)
        | BusSpec::Sim(_)
        | BusSpec::Stdin => false,
    }
}

fn ask_for(project: &Path, bus: &BusSpec) -> Result<(), Failure> {
    let file = printable_path(project);
    if !output::may_ask() {
        let why = format!(
            "{file} opens {bus} on another machine; agree to it once on a terminal, or name it: \
             descan {bus}"
        );
        return Err(Failure::Usage(why));
    }
    output::ask(format_args!(
        "{file} opens {bus}, on another machine. Open it, from now on? [y/N]"
    ));
    if !output::answer().recv().unwrap_or(false) {
        return Err(Failure::Usage(format!(
            "{bus} is not opened; --no-project opens none of them"
        )));
    }
    if let Err(error) = agree(project, &bus.to_string()) {
        output::warn(format_args!("the answer is not kept: {error}"));
    }
    Ok(())
}
