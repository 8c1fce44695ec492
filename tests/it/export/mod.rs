//! `descan profile export`: tshark and cantools show what descan shows.

mod dbc;
mod wireshark;

use std::path::Path;
use std::process::{Command, Stdio};

/// Runs descan in a folder; returns what it printed, what it said, and its exit code.
fn descan(folder: &Path, arguments: &[&str]) -> (String, String, Option<i32>) {
    let output = Command::new(env!("CARGO_BIN_EXE_descan"))
        .args(arguments)
        .current_dir(folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .env("XDG_DATA_HOME", folder.join("data"))
        .stdin(Stdio::null())
        .output()
        .expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (text(output.stdout), text(output.stderr), output.status.code())
}

fn export(folder: &Path, options: &[&str]) -> String {
    let arguments = [&["profile", "export"], options].concat();
    let (text, said, code) = descan(folder, &arguments);
    assert_eq!(code, Some(0), "{said}");
    text
}

#[test]
fn export_replaces_other_content_only_with_force() {
    let folder = tempfile::tempdir().unwrap();
    let write = ["profile", "export", "--dbc", "--write", "a.dbc"];
    assert_eq!(descan(folder.path(), &write).2, Some(0));
    let written = std::fs::read_to_string(folder.path().join("a.dbc")).unwrap();
    assert_eq!(written, export(folder.path(), &["--dbc"]));
    assert_eq!(descan(folder.path(), &write).2, Some(0), "the same content");
    std::fs::write(folder.path().join("a.dbc"), "mine").unwrap();
    let (_, said, code) = descan(folder.path(), &write);
    assert!(said.contains("a.dbc: already exists, with other content"), "{said}");
    assert_eq!(code, Some(3));
    assert_eq!(std::fs::read_to_string(folder.path().join("a.dbc")).unwrap(), "mine");
    let (_, said, code) = descan(folder.path(), &[&write[..], &["--force"]].concat());
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(std::fs::read_to_string(folder.path().join("a.dbc")).unwrap(), written);
}

#[test]
fn export_needs_one_format_and_readable_files() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("wrong.toml"), "[services]\ndse = 3\n").unwrap();
    let cases: [(&[&str], i32, &str); 5] = [
        (&[], 2, "--wireshark"),
        (&["--dbc", "--wireshark"], 2, "cannot be used with"),
        (&["--dbc", "--profile", "wrong.toml"], 3, "wrong.toml: line 2, column 1"),
        (&["--dbc", "--profile", "none.toml"], 3, "none.toml: file not found"),
        (&["--dbc", "--catalogue", "nowhere"], 3, "nowhere: not a folder"),
    ];
    for (options, expected, why) in cases {
        let (told, said, code) = descan(folder.path(), &[&["profile", "export"], options].concat());
        assert!(said.contains(why), "{options:?}: {said}");
        assert_eq!((code, told.as_str()), (Some(expected), ""), "{options:?}");
    }
}
