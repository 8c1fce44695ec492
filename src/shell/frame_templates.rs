//! Templates of frames, in words, in a file of the user's settings.
//!
//! The file can be edited by hand: a composition a line; a line that is none is left alone. Does not know
//! what the words mean.

use crate::app::MAX_TEMPLATES;
use crate::regular_file::read_text;
use crate::shell::config::ConfigFolder;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Name of the file.
const TEMPLATES: &str = "templates";

/// The templates, in the order of the file.
pub fn frame_templates() -> Vec<String> {
    templates_file().map(|file| read(&file)).unwrap_or_default()
}

/// Appends a template.
///
/// # Errors
///
/// There is no folder for settings, or the file cannot be written.
pub fn keep_template(words: &str) -> io::Result<()> {
    let file = templates_file();
    append(&file.ok_or_else(|| io::Error::other("no home folder; set XDG_CONFIG_HOME"))?, words)
}

fn templates_file() -> Option<PathBuf> {
    Some(ConfigFolder::of_user()?.path().join(TEMPLATES))
}

fn read(file: &Path) -> Vec<String> {
    let text = read_text(file).ok().flatten().unwrap_or_default();
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    lines.take(MAX_TEMPLATES).map(str::to_owned).collect()
}

fn append(file: &Path, words: &str) -> io::Result<()> {
    if words.contains(char::is_control) {
        return Err(io::Error::other("it has control characters"));
    }
    fs::create_dir_all(file.parent().unwrap_or(Path::new("")))?;
    let text = read_text(file).map_err(|fault| io::Error::other(fault.to_string()))?;
    let is_open = text.is_some_and(|text| !text.is_empty() && !text.ends_with('\n'));
    let line = if is_open { format!("\n{words}\n") } else { format!("{words}\n") };
    fs::File::options().create(true).append(true).open(file)?.write_all(line.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_are_appended_to_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("descan/templates");
        assert_eq!(read(&file), Vec::<String>::new());
        append(&file, "request des name to FEED").unwrap();
        fs::write(&file, "request des name to FEED\n\n# own").unwrap();
        append(&file, "debug 5").unwrap();
        assert_eq!(read(&file), ["request des name to FEED", "# own", "debug 5"]);
        assert!(append(&file, "raw \"a\nb\"").is_err());
    }
}
