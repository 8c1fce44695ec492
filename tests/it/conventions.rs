//! Rules of the source text: names of types and of tests.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The most characters of a test name.
const MAX_TEST_NAME: usize = 60;

/// Rust files below `folder` of the repository, in order of their paths.
fn rust_files(folder: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// The identifier that follows one of `keywords` at the start of a line of code.
fn declared<'a>(line: &'a str, keywords: &[&str]) -> Option<&'a str> {
    let line = match line.strip_prefix("pub") {
        Some(rest) => match rest.strip_prefix('(') {
            Some(rest) => rest.split_once(')')?.1.trim_start(),
            None => rest.trim_start(),
        },
        None => line,
    };
    let (keyword, rest) = line.split_once(' ')?;
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
    keywords.contains(&keyword).then(|| &rest[..end])
}

/// The names of the test functions in a file.
fn test_names(text: &str) -> Vec<&str> {
    let mut names = Vec::new();
    let mut is_test = false;
    for line in text.lines().map(str::trim) {
        if let Some(name) = declared(line, &["fn"]) {
            if std::mem::take(&mut is_test) {
                names.push(name);
            }
        } else if line == "#[test]" {
            is_test = true;
        }
    }
    names
}

#[test]
fn type_names_are_unique_in_the_crate() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in rust_files("src") {
        // A module that differs between systems has its types in each of its bodies.
        if file.ends_with("windows.rs") || file.ends_with("elsewhere.rs") {
            continue;
        }
        let text = fs::read_to_string(&file).unwrap();
        for (number, line) in text.lines().enumerate() {
            // An indented `type` is an associated type: its name comes from its trait.
            let name = declared(line, &["type"])
                .or_else(|| declared(line.trim_start(), &["struct", "enum", "trait", "union"]));
            if let Some(name) = name {
                let place = format!("{}:{}", file.display(), number + 1);
                places.entry(name.to_owned()).or_default().push(place);
            }
        }
    }
    assert!(places.len() > 300, "only {} types found", places.len());
    places.retain(|_, places| places.len() > 1);
    assert!(places.is_empty(), "types of one name: {places:#?}");
}

#[test]
fn test_names_keep_the_rule() {
    let mut wrong = Vec::new();
    let mut count = 0;
    for file in ["src", "tests"].into_iter().flat_map(rust_files) {
        let text = fs::read_to_string(&file).unwrap();
        for name in test_names(&text) {
            count += 1;
            let first = name.split('_').next().unwrap();
            if name.len() > MAX_TEST_NAME
                || !name.contains('_')
                || ["a", "an", "the"].contains(&first)
            {
                wrong.push(format!("{}: {name}", file.display()));
            }
        }
    }
    assert!(count > 650, "only {count} tests found");
    assert!(wrong.is_empty(), "not <subject>_<condition>_<result>: {wrong:#?}");
}

/// All texts pass the writer that escapes them; the screen has its own.
#[test]
fn texts_are_printed_by_one_module() {
    const WRITERS: [&str; 2] = ["src/commands/output.rs", "src/shell/terminal.rs"];
    let mut places = Vec::new();
    for file in rust_files("src") {
        if WRITERS.iter().any(|writer| file.ends_with(writer)) {
            continue;
        }
        let text = fs::read_to_string(&file).unwrap();
        for (number, line) in text.lines().enumerate() {
            let is_stream = ["stdout()", "stderr()"].iter().any(|stream| line.contains(stream));
            if is_stream && ["write", "lock()"].iter().any(|way| line.contains(way)) {
                places.push(format!("{}:{}", file.display(), number + 1));
            }
        }
    }
    assert!(places.is_empty(), "printed without `commands::output`: {places:#?}");
}
