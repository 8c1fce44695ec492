//! The statements of the README that a program can check.

use descan::document::Document;
use descan::keymap::{ACTIONS, Key, KeyMode, Keymap};

const README: &str = include_str!("../../README.md");

/// Returns the text of the fenced block that begins with `begin`.
fn block<'t>(language: &str, begin: &str) -> &'t str {
    let fence = format!("```{language}\n");
    README
        .split(&fence)
        .skip(1)
        .filter_map(|rest| rest.split("\n```").next())
        .find(|block| block.starts_with(begin))
        .unwrap_or_else(|| panic!("no {language} block that begins with {begin}"))
}

#[test]
fn readme_keys_are_all_bound() {
    let keymap = Keymap::default();
    let table = README.split("| key | does |").nth(1).expect("the table of keys");
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    let mut count = 0;
    for row in rows {
        let cell = row.split('|').nth(1).unwrap();
        for (at, text) in cell.split('`').enumerate() {
            // Text between backticks.
            if at % 2 == 1 {
                let key = Key::parse(text).unwrap_or_else(|| panic!("{text} is a key"));
                assert!(keymap.lookup(KeyMode::Browse, key).is_some(), "{text} does something");
                count += 1;
            }
        }
    }
    assert!(count > 20, "{count}");
}

#[test]
fn bound_letters_are_all_in_the_readme() {
    for action in ACTIONS.iter().filter(|action| action.mode == KeyMode::Browse) {
        let letter = action
            .keys
            .iter()
            .find(|key| key.len() == 1 && key.as_bytes()[0].is_ascii_alphabetic());
        if let Some(letter) = letter.filter(|letter| !matches!(**letter, "h" | "l" | "y")) {
            assert!(README.contains(&format!("`{letter}`")), "{} ({letter})", action.name);
        }
    }
}

#[test]
fn readme_des_json_is_valid() {
    let document = Document::parse(block("json", "{").as_bytes()).unwrap();
    assert_eq!(document.entries()[0].name_text, "FEED");
    assert!(document.findings().is_empty());
}

#[test]
fn readme_commands_exist() {
    let mut count = 0;
    for line in block("sh", "descan can0").lines() {
        let command = line.split('#').next().unwrap();
        // The part of the command line run by descan, in a pipe or with sudo.
        let command = command.rsplit('|').next().unwrap().trim().trim_start_matches("sudo ");
        let arguments: Vec<&str> = command.split_whitespace().collect();
        assert_eq!(arguments[0], "descan", "{line}");
        descan::cli::parse(&arguments).unwrap_or_else(|refusal| panic!("{line}: {refusal:?}"));
        count += 1;
    }
    assert!(count >= 10, "{count}");
}

#[test]
fn readme_is_short_and_its_files_exist() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    assert!(README.lines().count() <= 170, "{}", README.lines().count());
    let links: Vec<&str> = README
        .split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .filter(|link| !link.contains("://"))
        .collect();
    assert!(links.len() >= 5, "{links:?}");
    for link in links {
        assert!(root.join(link).exists(), "{link}");
    }
}
