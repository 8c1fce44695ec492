//! The path of a file with its symbolic links resolved.

use crate::diagnostic::Diagnostic;
use crate::system_error::link_loop;
use crate::text::printable_path;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

/// Most symbolic links that are followed, as in the kernel.
const MAX_LINKS: usize = 40;

/// Path of a file with all symbolic links resolved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::shell) struct Places {
    /// Folders and names in them that decide which file the path leads to: links, the file itself,
    /// and the first missing folder.
    pub watched: Vec<(PathBuf, OsString)>,
    /// The file itself; it may not exist.
    pub target: PathBuf,
    /// The folder of the file.
    pub folder: PathBuf,
}

impl Places {
    /// Resolves `path`.
    ///
    /// # Errors
    /// The links form a loop, a part of the path cannot be examined, or the
    /// current folder was removed.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut watched = Vec::new();
        let path = std::path::absolute(path)?;
        let mut here = root(&path);
        // Components not resolved yet, last first.
        let mut ahead = components(&path);
        let mut links = 0;
        while let Some(name) = ahead.pop() {
            if name == ".." {
                here.pop();
                continue;
            }
            let next = here.join(&name);
            match fs::symlink_metadata(&next) {
                Ok(metadata) if metadata.is_symlink() => {
                    links += 1;
                    if links > MAX_LINKS {
                        return Err(link_loop());
                    }
                    let link = fs::read_link(&next)?;
                    if link.is_absolute() {
                        watched.push((std::mem::replace(&mut here, root(&link)), name));
                    } else {
                        watched.push((here.clone(), name));
                    }
                    ahead.extend(components(&link));
                }
                Ok(_) if !ahead.is_empty() => here = next,
                Ok(_) => watched.push((here.clone(), name)),
                Err(error) if is_missing(&error) => {
                    watched.push((here.clone(), name));
                    let target = ahead.iter().rev().fold(next, |path, name| path.join(name));
                    let folder = target.parent().unwrap_or(&here).to_owned();
                    return Ok(Self { watched, target, folder });
                }
                Err(error) => return Err(error),
            }
        }
        let target = watched.last().map_or(here.clone(), |(folder, name)| folder.join(name));
        Ok(Self { watched, folder: target.parent().unwrap_or(&here).to_owned(), target })
    }

    /// Returns the fault if the folder of the file does not exist; `path` is the file as entered by the user.
    pub(super) fn missing_folder(&self, path: &Path) -> Option<Diagnostic> {
        /// Creates a folder and those above it.
        const MKDIR: &str = if cfg!(windows) { "mkdir" } else { "mkdir -p" };
        let found = fs::metadata(&self.folder);
        let is_missing = found.is_err_and(|error| error.kind() == ErrorKind::NotFound);
        let remedy = || format!("{MKDIR} {}", printable_path(self.folder_as_named(path)));
        is_missing.then(|| Diagnostic::new("no such folder").with_remedy(remedy()))
    }

    /// Returns the file's folder as entered by the user, unless a link leads to another one.
    fn folder_as_named<'p>(&'p self, path: &'p Path) -> &'p Path {
        let named = path.parent().filter(|named| !named.as_os_str().is_empty());
        let is_it = |named: &&Path| Self::of(named).is_ok_and(|it| it.target == self.folder);
        named.filter(is_it).unwrap_or(&self.folder)
    }
}

/// Returns true if a part of a path does not exist; a file in place of a folder counts as missing,
/// too, and is reported when the folder is opened.
fn is_missing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory)
}

/// Returns the beginning of an absolute path: `/`; on Windows with a drive before it.
fn root(path: &Path) -> PathBuf {
    let is_root = |part: &Component| matches!(part, Component::Prefix(_) | Component::RootDir);
    path.components().take_while(is_root).collect()
}

/// Returns the names in a path, last first.
fn components(path: &Path) -> Vec<OsString> {
    let name = |component| match component {
        Component::Normal(name) => Some(name),
        Component::ParentDir => Some(OsStr::new("..")),
        _ => None,
    };
    path.components().rev().filter_map(name).map(OsStr::to_owned).collect()
}
