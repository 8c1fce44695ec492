//! Frames that were composed and sent on the screen, in words, in a small file of the user.
//!
//! A convenience, as [`recent_logs`](super::recent_logs). Bounded: 50 compositions.

use super::state_folder::state_folder;
use crate::regular_file::read_text;
use std::fs;
use std::path::{Path, PathBuf};

/// Most compositions that are remembered.
const MAX_FRAMES: usize = 50;

/// The compositions sent before, the latest first.
pub fn recent_frames() -> Vec<String> {
    frames_file().map(|file| read(&file)).unwrap_or_default()
}

/// Remembers a composition that is sent.
pub fn remember_frame(words: &str) {
    frames_file().inspect(|file| write(file, words));
}

/// File with a composition a line, the latest first.
fn frames_file() -> Option<PathBuf> {
    Some(state_folder()?.join("recent-frames"))
}

fn read(file: &Path) -> Vec<String> {
    let text = read_text(file).ok().flatten().unwrap_or_default();
    text.lines().take(MAX_FRAMES).map(str::to_owned).collect()
}

/// Puts a composition at the first place.
fn write(file: &Path, words: &str) {
    if words.contains(char::is_control) {
        return;
    }
    let others = read(file).into_iter().filter(|it| it != words);
    let all = std::iter::once(words.to_owned()).chain(others).take(MAX_FRAMES);
    let text: String = all.map(|line| line + "\n").collect();
    let Some(folder) = file.parent() else { return };
    let _ = fs::create_dir_all(folder).and_then(|()| fs::write(file, text));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latest_frames_are_kept_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("state/recent-frames");
        assert_eq!(read(&file), Vec::<String>::new());
        (0..60).for_each(|number| write(&file, &format!("debug {number}")));
        write(&file, "debug 30");
        write(&file, "raw \"a\nb\"");
        let found = read(&file);
        assert_eq!((found.len(), &*found[0], &*found[1]), (50, "debug 30", "debug 59"));
        assert_eq!(found.iter().filter(|it| *it == "debug 30").count(), 1);
    }
}
