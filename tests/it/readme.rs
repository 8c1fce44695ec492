//! The README says what is so.

use descan::document::Document;
use descan::keymap::{ACTIONS, Key, KeyMode, Keymap};
use descan::wire::profile::Profile;

const README: &str = include_str!("../../README.md");

/// The text of the fenced block that begins with `begin`.
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
            // What stands between backticks.
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
fn readme_profile_and_des_json_are_valid() {
    let profile = Profile::parse(block("toml", "framing")).unwrap();
    assert_eq!(profile.service_names[&0x101], "AUGER");
    let document = Document::parse(block("json", "{").as_bytes()).unwrap();
    assert_eq!(document.entries()[0].name_text, "FEED");
    assert!(document.findings().is_empty());
}

#[test]
fn readme_commands_exist() {
    let blocks = ["sudo ip link", "descan scan file:", "descan file:", "sudo ip link set lo"]
        .map(|begin| block("sh", begin));
    let lines = blocks.iter().flat_map(|block| block.lines());
    for line in lines.filter(|line| line.starts_with("descan ")) {
        let command = line.split('#').next().unwrap();
        let arguments: Vec<&str> = command.split_whitespace().collect();
        descan::cli::parse(&arguments).unwrap_or_else(|refusal| panic!("{line}: {refusal:?}"));
    }
}
