//! Tables of the guide that are generated from the code: keys, symbols, findings, filter fields,
//! theme roles; and files of the example project. Input: Markdown in which a line
//! `<!-- table: keys -->` stands for a table. Output: Markdown.

use crate::app::{FILTER_FIELDS, FILTER_WORDS, Page, RowKind};
use crate::finding::FindingKind;
use crate::keymap::{ACTIONS, ActionGroup};
use crate::prove::ConformanceRule;
use crate::theme::Role;
use crate::ui::SYMBOLS;
use std::fmt::Write;

/// Replaces the lines that stand for tables by the tables.
pub fn expand(text: &str) -> String {
    let mut out = String::with_capacity(text.len() * 2);
    for line in text.lines() {
        let name = line.strip_prefix("<!-- table: ").and_then(|rest| rest.strip_suffix(" -->"));
        out.push_str(&name.map_or_else(|| line.to_owned(), table));
        out.push('\n');
    }
    out
}

/// The example project: a boiler with two buses.
const EXAMPLE_PROJECT: &str = include_str!("../../tests/project/descan.toml");
/// The type of its feeder.
const EXAMPLE_TYPE: &str = include_str!("../../tests/project/devices/feeder.toml");

/// Returns a file as a block of code.
fn block(info: &str, text: &str) -> String {
    format!("```{info}\n{}\n```", text.trim_end())
}

/// Returns the table of that name; empty if there is none (the tests of the guide report that).
fn table(name: &str) -> String {
    match name {
        "keys" => keys(),
        "symbols" => symbols(),
        "findings" => findings(),
        "filter" => filter(),
        "filter-pages" => filter_pages(),
        "roles" => roles(),
        "rules" => rules(),
        "example-project" => block("toml descan.toml", EXAMPLE_PROJECT),
        "example-type" => block("toml device type", EXAMPLE_TYPE),
        _ => String::new(),
    }
}

/// Returns all actions with their default keys and names in `keys.toml`, a table for each group.
pub fn keys() -> String {
    let mut out = String::new();
    for group in ActionGroup::ALL {
        let _ = write!(
            out,
            "### {}\n\n| key | action | in keys.toml |\n|---|---|---|\n",
            group.title()
        );
        for action in ACTIONS.iter().filter(|action| action.group == group) {
            let keys: Vec<String> = action.keys.iter().map(|key| code(key)).collect();
            let (keys, doc) = (keys.join(" "), escape(action.doc));
            let _ = writeln!(out, "| {keys} | {doc} | {} |", code(action.name));
        }
        out.push('\n');
    }
    out
}

/// Returns the symbols of the screen with their meanings.
fn symbols() -> String {
    let mut out = String::from("| on the screen | meaning |\n|---|---|\n");
    for (_, sign, meaning) in SYMBOLS {
        let _ = writeln!(out, "| {} | {} |", code(sign.trim()), escape(meaning));
    }
    out
}

/// Returns the rules of `descan prove`, each with its sentence, its source and what it needs.
fn rules() -> String {
    let mut out = String::from("| rule | the device | source | needs |\n|---|---|---|---|\n");
    for rule in ConformanceRule::ALL {
        let (id, sentence) = (code(rule.id()), escape(rule.sentence()));
        let source = format!("{}, {}", rule.document().name(), rule.section());
        let needs = rule.need().word();
        let _ = writeln!(out, "| {id} | {sentence} | {} | {needs} |", escape(&source));
    }
    out
}

/// Returns the kinds of findings, most severe first, their headlines, and the commands whose exit
/// code they change.
fn findings() -> String {
    let mut out = String::from("| kind | on the screen | counts for |\n|---|---|---|\n");
    let mut kinds = FindingKind::ALL.to_vec();
    kinds.sort_by_key(|kind| std::cmp::Reverse(kind.severity()));
    for kind in kinds {
        let counts = match (kind.is_conflict(), kind.check_section()) {
            (true, _) => "`scan`, `check`",
            (false, Some(_)) => "`check`",
            (false, None) => "",
        };
        let (name, headline) = (code(kind.name()), escape(kind.headline()));
        let _ = writeln!(out, "| {name} | {headline} | {counts} |");
    }
    out
}

/// Returns the fields and words of the filter.
fn filter() -> String {
    let mut out = String::from("| term | matches |\n|---|---|\n");
    for field in FILTER_FIELDS {
        let words: Vec<String> = field.words.iter().map(|word| code(&format!("{word}:"))).collect();
        let _ = writeln!(out, "| {} | {} |", words.join(" "), escape(field.doc));
    }
    for (word, doc) in FILTER_WORDS {
        let _ = writeln!(out, "| {} | {} |", code(word), escape(doc));
    }
    out
}

/// Returns the fields that the rows of each page have.
fn filter_pages() -> String {
    let mut out = String::from("| page | fields |\n|---|---|\n");
    for page in Page::ALL.into_iter().filter(|page| page.has_rows()) {
        let rows = RowKind::of(page);
        let fields = FILTER_FIELDS.iter().filter(|field| field.is_of(rows));
        let words: Vec<String> =
            fields.filter_map(|it| it.words.first()).map(|it| code(&format!("{it}:"))).collect();
        let also = if rows == RowKind::Event { ", `watch`" } else { "" };
        let _ = writeln!(out, "| {}{also} | {} |", page.title(), words.join(" "));
    }
    out
}

/// Returns the roles of themes.
fn roles() -> String {
    let mut out = String::from("| role | used for |\n|---|---|\n");
    for role in Role::ALL {
        let _ = writeln!(out, "| {} | {} |", code(role.name()), escape(role.doc()));
    }
    out
}

/// Returns a cell of literal text.
fn code(text: &str) -> String {
    format!("`{}`", text.replace('|', "\\|"))
}

/// Returns a cell of prose in which nothing is Markdown.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if "\\`*_[]<>|#".contains(c) {
            out.push('\\');
        }
        out.push(c);
    }
    out
}
