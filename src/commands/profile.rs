//! `descan profile`: the built-in profile, and the check of a file. See [`super::learn`], too.

use super::{EXIT_FINDINGS, EXIT_OK, Failure, output};
use crate::cli::ProfileCommand;
use crate::diagnostic::Diagnostic;
use crate::regular_file::required_text;
use crate::text::printable_path;
use crate::toml_error::TomlError;
use crate::wire::profile::{Profile, ProfileKey, ValueOrigin};
use std::fmt::Write as _;
use std::path::Path;

/// `descan profile [check FILE | learn BUS | export]`.
pub fn run(command: Option<&ProfileCommand>) -> Result<u8, Failure> {
    match command {
        None => output::print(Profile::BUILT_IN).map(|()| EXIT_OK),
        Some(ProfileCommand::Check { file, json }) => check(file, *json),
        Some(ProfileCommand::Learn(learn)) => super::learn::run(learn),
        Some(ProfileCommand::Export(export)) => super::export::run(export),
    }
}

/// Reads a profile.
///
/// # Errors
/// It cannot be read, or is wrong: the text has the place and the wrong line.
pub fn read(path: &Path) -> Result<Profile, Failure> {
    let wrong = |error: TomlError| Diagnostic::new(error.with_line()).of(printable_path(path));
    Ok(Profile::parse(&required_text(path)?).map_err(wrong)?)
}

/// The mistake in a file with its place, and below it the wrong line with a mark.
pub(super) fn fault(path: &Path, error: &TomlError) -> String {
    let excerpt = error.excerpt().replace('\n', "\n  ");
    format!("{}: {error}\n  {excerpt}", printable_path(path))
}

fn check(path: &Path, json: bool) -> Result<u8, Failure> {
    let profile = match Profile::parse(&required_text(path)?) {
        Ok(profile) => profile,
        Err(error) => {
            output::warn(fault(path, &error));
            return Ok(EXIT_FINDINGS);
        }
    };
    if json {
        let text = serde_json::to_string_pretty(&profile.values()).map_err(anyhow::Error::from)?;
        output::print_json(&(text + "\n"))?;
        return Ok(EXIT_OK);
    }
    let mut text = String::new();
    for key in ProfileKey::ALL {
        let (value, origin) = (profile.value(*key).to_string(), profile.origin(*key).word());
        let _ = writeln!(text, "{:<24} {value:<9} {origin}", key.name());
    }
    let given = ProfileKey::ALL.iter().filter(|key| profile.origin(**key) == ValueOrigin::Given);
    let (given, all) = (given.count(), ProfileKey::ALL.len());
    let _ = writeln!(text, "{}: {given} of {all} values given", printable_path(path));
    output::print(&text).map(|()| EXIT_OK)
}
