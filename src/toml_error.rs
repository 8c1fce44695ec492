//! Mistakes in TOML files that users write, with their place.
//!
//! Does not know what the files are about.

use std::collections::BTreeMap;
use std::ops::Range;
use toml::de::DeTable;

/// Why a file cannot be used: what is wrong, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {message}")]
pub struct TomlError {
    message: String,
    line: usize,
    column: usize,
    /// Number of characters concerned, at least one.
    width: usize,
    text: String,
}

/// Types as the parser names them at the end of a message, and what is expected in words.
const TYPE_WORDS: [(&str, &str); 8] = [
    ("u8", "expected a whole number, 0 to 255"),
    ("u16", "expected a whole number, 0 to 65535"),
    ("u32", "expected a whole number, 0 to 4294967295"),
    ("u64", "expected a whole number from 0"),
    ("usize", "expected a whole number from 0"),
    ("i64", "expected a whole number"),
    ("f64", "expected a number"),
    ("a boolean", "expected true or false"),
];

impl TomlError {
    /// Makes an error about a part of a file.
    pub(crate) fn new(file: &str, span: Option<Range<usize>>, message: String) -> Self {
        let span = span.unwrap_or(0..0);
        let at = file.floor_char_boundary(span.start);
        let start = file[..at].rfind('\n').map_or(0, |before| before + 1);
        let text = file[start..].lines().next().unwrap_or_default();
        let end = file.floor_char_boundary(span.end).min(start + text.len()).max(at);
        Self {
            message,
            line: file[..at].matches('\n').count() + 1,
            column: file[start..at].chars().count() + 1,
            width: file[at..end].chars().count().max(1),
            text: text.to_owned(),
        }
    }

    /// Makes it of an error of the parser.
    pub(crate) fn of(file: &str, error: &toml::de::Error) -> Self {
        let message = crate::text::on_one_line(error.message());
        let meaning = TYPE_WORDS.iter().find_map(|(word, meaning)| {
            Some(format!("{}{meaning}", message.strip_suffix(&format!("expected {word}"))?))
        });
        Self::new(file, error.span(), meaning.unwrap_or(message))
    }

    /// What is wrong, without the place.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// Place in the file: line and column, from 1 on.
    pub fn place(&self) -> (usize, usize) {
        (self.line, self.column)
    }

    /// The line concerned, without blanks around it, safe on a terminal.
    pub fn line_text(&self) -> String {
        const LENGTH: usize = 160;
        let text = self.text.trim();
        let shown: String = text.chars().take(LENGTH).collect();
        let rest = if shown.len() < text.len() { "…" } else { "" };
        crate::text::printable(shown.as_bytes()) + rest
    }

    /// The mistake, its place and the line concerned, on one line and safe on a terminal.
    pub fn with_line(&self) -> String {
        format!("{self}: {}", self.line_text())
    }

    /// The line concerned, with a mark under what is wrong: two lines, safe on a terminal.
    pub fn excerpt(&self) -> String {
        /// Characters of a line that are shown.
        const LENGTH: usize = 120;
        let shown = |c: char| if crate::text::is_printable(c) { c } else { '?' };
        // The mark stays in view.
        let skipped = (self.column - 1).saturating_sub(LENGTH / 2);
        let text: String = self.text.chars().skip(skipped).take(LENGTH).map(shown).collect();
        let before = self.column - 1 - skipped;
        let marks = "^".repeat(self.width.min(text.chars().count().saturating_sub(before)).max(1));
        format!("{text}\n{}{marks}", " ".repeat(before))
    }
}

/// Places of the values in a file, by name: `services.des`.
#[derive(Default)]
pub(crate) struct ValuePlaces(BTreeMap<String, Range<usize>>);

impl ValuePlaces {
    /// Finds the values of a file; none if it is not TOML.
    pub fn of(file: &str) -> Self {
        let mut places = Self::default();
        if let Ok(table) = DeTable::parse(file) {
            places.add("", table.get_ref());
        }
        places
    }

    fn add(&mut self, prefix: &str, table: &DeTable) {
        for (key, value) in table {
            let name = format!("{prefix}{}", key.get_ref());
            if let Some(inner) = value.get_ref().as_table() {
                self.add(&format!("{name}."), inner);
            }
            self.0.insert(name, value.span());
        }
    }

    /// Returns true if the file sets this value.
    pub fn contains(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// Returns the place of this value; of several modes that of the last one.
    pub fn get(&self, name: &str) -> Option<Range<usize>> {
        let within = |it: &&String| it.strip_prefix(name).is_some_and(|it| it.starts_with('.'));
        let last = || self.0.iter().filter(|(it, _)| within(it)).map(|(_, span)| span);
        self.0.get(name).or_else(|| last().max_by_key(|span| span.start)).cloned()
    }
}
