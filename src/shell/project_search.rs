//! The search for the project file, and the buses on other machines that the user agreed to.
//!
//! A file in a folder above may be anybody's, so one of another user is not read. Does not know what
//! is in the file.

use super::file_owner::{device_of, owner_of, readers, user_name};
use super::state_folder::state_folder;
use crate::project::FILE_NAME;
use crate::regular_file::read_text;
use etcetera::home_dir;
use std::fs::{self, Metadata};
use std::io;
use std::path::{Path, PathBuf};

/// Most buses that are kept.
const MAX_AGREED: usize = 1000;

/// Result of a search.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FoundProject {
    /// The file; `None` if there is none.
    pub path: Option<PathBuf>,
    /// A file that is ignored, as it is of another user; and the user.
    pub ignored: Option<(PathBuf, String)>,
}

/// Looks for the project file in a folder and those above it, up to the user's home folder or the end
/// of the file system.
pub fn find(folder: &Path) -> FoundProject {
    let home = home_dir().ok().and_then(|home| fs::canonicalize(home).ok());
    find_below(folder, home.as_deref(), &readers())
}

fn find_below(folder: &Path, home: Option<&Path>, owners: &[u32]) -> FoundProject {
    let mut found = FoundProject::default();
    let Ok(start) = fs::metadata(folder) else { return found };
    for folder in folder.ancestors() {
        if fs::metadata(folder).ok().is_none_or(|it| device_of(&it) != device_of(&start)) {
            break;
        }
        let path = folder.join(FILE_NAME);
        // The link, and what it leads to.
        let both = [fs::symlink_metadata(&path), fs::metadata(&path)];
        let both: Vec<Metadata> = both.into_iter().flatten().collect();
        let other = both.iter().find(|it| !owners.contains(&owner_of(it)));
        match (other, both.last()) {
            (Some(other), _) if found.ignored.is_none() => {
                found.ignored = Some((path, user_name(owner_of(other))));
            }
            (None, Some(file)) if file.is_file() => {
                found.path = Some(path);
                break;
            }
            _ => {}
        }
        if home == Some(folder) {
            break;
        }
    }
    found
}

/// Returns true if the user agreed that a project opens a bus on another machine.
pub fn is_agreed(project: &Path, bus: &str) -> bool {
    let text = agreed_file().and_then(|file| read_text(&file).ok().flatten());
    text.is_some_and(|text| text.lines().any(|line| line == line_of(project, bus)))
}

/// Keeps that the user agreed to it.
///
/// # Errors
///
/// The file cannot be written.
pub fn agree(project: &Path, bus: &str) -> io::Result<()> {
    let Some(file) = agreed_file() else { return Ok(()) };
    let before = read_text(&file).ok().flatten().unwrap_or_default();
    let kept: Vec<&str> = before.lines().rev().take(MAX_AGREED - 1).collect();
    let own = line_of(project, bus);
    let mut text = kept.into_iter().rev().chain([own.as_str()]).collect::<Vec<_>>().join("\n");
    text.push('\n');
    fs::create_dir_all(file.parent().unwrap_or(Path::new("")))?;
    fs::write(file, text)
}

/// One line, whatever the names have.
fn line_of(project: &Path, bus: &str) -> String {
    format!("{bus:?}\t{:?}", project.to_string_lossy())
}

fn agreed_file() -> Option<PathBuf> {
    Some(state_folder()?.join("project-buses"))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use nix::unistd::Uid;

    #[test]
    fn file_is_found_upwards_until_the_home_folder() {
        let home = tempfile::tempdir().unwrap();
        let home = fs::canonicalize(home.path()).unwrap();
        let inner = home.join("a/b/c");
        fs::create_dir_all(&inner).unwrap();
        let own = [Uid::effective().as_raw()];
        let find = |home: &Path| find_below(&inner, Some(home), &own).path;
        assert_eq!(find(&home), None);
        fs::write(home.join(FILE_NAME), "").unwrap();
        assert_eq!(find(&home), Some(home.join(FILE_NAME)));
        assert_eq!(find(&home.join("a")), None, "the search stops at the home folder");
        fs::create_dir(home.join("a/b").join(FILE_NAME)).unwrap();
        fs::write(home.join("a").join(FILE_NAME), "").unwrap();
        assert_eq!(find(&home), Some(home.join("a").join(FILE_NAME)));
    }

    #[test]
    fn file_of_another_user_is_ignored_and_named() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("in")).unwrap();
        fs::write(folder.path().join(FILE_NAME), "").unwrap();
        let inner = folder.path().join("in");
        let user = Uid::effective().as_raw();
        let found = find_below(&inner, Some(folder.path()), &[user + 1]);
        let (path, _) = found.ignored.unwrap();
        assert_eq!((found.path, path), (None, folder.path().join(FILE_NAME)));
        // A link to a file of another user is as one.
        std::os::unix::fs::symlink(folder.path().join(FILE_NAME), inner.join(FILE_NAME)).unwrap();
        assert_eq!(find_below(&inner, None, &[user]).path, Some(inner.join(FILE_NAME)));
    }
}
