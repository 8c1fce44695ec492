//! Lists of the scenario files.

use std::path::{Path, PathBuf};

/// Returns the text files of a folder below `tests`, by name; there is at least one.
pub fn texts_of(folder: &str) -> Vec<PathBuf> {
    let mut files: Vec<_> = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests")
        .join(folder)
        .read_dir()
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "txt"))
        .collect();
    files.sort();
    assert!(!files.is_empty());
    files
}

/// Returns true if the scenario files are to be rewritten instead of compared.
pub fn are_written_anew() -> bool {
    std::env::var_os("UPDATE_SCENARIOS").is_some()
}
