//! Completion of a filter line: the fields and values that may follow.
//!
//! Input: the line until the cursor, the values that occur. Output: the part of the line that is
//! replaced, and what may stand there. Does not know how candidates are shown.

use super::expression::tokens;
use super::field::{FILTER_FIELDS, Field, RowKind};
use crate::app::capture::decoded::FrameRole;
use crate::finding::FindingKind;
use crate::wire::node::Mode;
use std::ops::Range;

/// Most candidates.
const MAX_CANDIDATES: usize = 64;

/// What may stand at the cursor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Completion {
    /// Part of the line that a candidate replaces, in bytes.
    pub range: Range<usize>,
    /// Texts, the likeliest first.
    pub candidates: Vec<String>,
    /// If they are values that rows have: the word of their field, with its colon.
    pub field: Option<&'static str>,
}

/// Values that occur on the buses.
#[derive(Clone, Debug, Default)]
pub struct CompletionSource {
    /// Names of devices.
    pub names: Vec<String>,
    /// Names of services.
    pub services: Vec<String>,
    /// UIDs.
    pub uids: Vec<String>,
    /// Names of buses.
    pub buses: Vec<String>,
    /// Addresses of devices.
    pub addresses: Vec<u8>,
}

impl Completion {
    /// Finds what may stand before the end of `line`, the part until the cursor.
    pub fn of(line: &str, rows: RowKind, source: &CompletionSource) -> Self {
        let (tokens, _) = tokens(line);
        let term = tokens.last().filter(|token| token.is_term() && token.range.end == line.len());
        let range = term.map_or(line.len()..line.len(), |token| token.range.clone());
        let typed = &line[range.clone()];
        let (range, typed, all, field) = match typed.split_once(':') {
            Some((name, value)) if !typed.starts_with('"') => {
                let start = range.start + name.len() + 1;
                // The last value of a list.
                let last = value.rfind(',').map_or(0, |comma| comma + 1);
                let name = name.to_lowercase();
                let field = FILTER_FIELDS.iter().find(|it| it.words.contains(&&*name));
                let field = field.map(|it| it.field).filter(|field| field.is_of(rows));
                let values = field.map(|field| values_of(field, rows, source)).unwrap_or_default();
                let counted = field.and_then(counted_word);
                (start + last..range.end, &value[last..], values, counted)
            }
            _ => (range, typed, fields_and_names(rows, source), None),
        };
        let typed = typed.trim_matches('"').to_lowercase();
        let mut candidates: Vec<String> =
            all.into_iter().filter(|text| text.to_lowercase().starts_with(&typed)).collect();
        candidates.retain({
            let mut seen = std::collections::HashSet::new();
            move |text| seen.insert(text.clone())
        });
        candidates.truncate(MAX_CANDIDATES);
        Self { range, candidates: candidates.iter().map(|text| quoted(text)).collect(), field }
    }
}

/// Word of a field whose candidates are values that rows have, with its colon; `None` where the
/// candidate is an example.
fn counted_word(field: Field) -> Option<&'static str> {
    Some(match field {
        Field::Name => "name:",
        Field::Source => "src:",
        Field::Destination => "dst:",
        Field::Device => "dev:",
        Field::Address => "at:",
        Field::Service => "srv:",
        Field::Uid => "uid:",
        Field::Bus => "bus:",
        Field::Mode => "mode:",
        Field::State => "is:",
        Field::Type => "type:",
        Field::Id
        | Field::Length
        | Field::Data
        | Field::Interval
        | Field::Since
        | Field::Until
        | Field::Text => return None,
    })
}

/// A text as a value: in quotes where it would be read otherwise.
fn quoted(text: &str) -> String {
    let field = text.strip_suffix(':').unwrap_or(text);
    let is_plain = |c: char| !c.is_whitespace() && !"\"(),:!".contains(c);
    if field.chars().all(is_plain) {
        text.to_owned()
    } else {
        format!("\"{}\"", text.replace('"', ""))
    }
}

fn fields_and_names(rows: RowKind, source: &CompletionSource) -> Vec<String> {
    let fields = FILTER_FIELDS.iter().filter(|field| field.is_of(rows));
    let words = fields.filter_map(|field| field.words.first()).map(|word| format!("{word}:"));
    let operators = ["err", "tx", "or", "not"].map(str::to_owned);
    words.chain(operators).chain(source.names.iter().cloned()).collect()
}

fn values_of(field: Field, rows: RowKind, source: &CompletionSource) -> Vec<String> {
    let owned = |words: &[&str]| words.iter().map(|&word| word.to_owned()).collect::<Vec<_>>();
    match field {
        Field::Name => source.names.clone(),
        Field::Source | Field::Device => {
            let addresses = source.addresses.iter().map(ToString::to_string);
            source.names.iter().cloned().chain(addresses).collect()
        }
        Field::Destination => {
            let mut all = vec!["all".to_owned()];
            all.extend(values_of(Field::Source, rows, source));
            all
        }
        Field::Address => source.addresses.iter().map(ToString::to_string).collect(),
        Field::Service => source.services.clone(),
        Field::Uid => source.uids.clone(),
        Field::Bus => source.buses.clone(),
        Field::Mode => Mode::ALL.iter().map(|mode| mode.name().to_lowercase()).collect(),
        Field::State => owned(rows.states()),
        Field::Type if rows == RowKind::Frame => {
            FrameRole::ALL.iter().map(|role| role.type_word().to_owned()).collect()
        }
        Field::Type => FindingKind::ALL.iter().map(|kind| kind.name().to_owned()).collect(),
        Field::Id
        | Field::Length
        | Field::Data
        | Field::Interval
        | Field::Since
        | Field::Until
        | Field::Text => vec![field.example(rows).split_once(':').map_or("", |it| it.1).to_owned()],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_and_values_are_completed() {
        let source = CompletionSource {
            names: vec!["FEED".into(), "FAN 2".into(), "FEED".into()],
            addresses: vec![12, 14],
            ..CompletionSource::default()
        };
        let of = |line: &str| {
            let completion = Completion::of(line, RowKind::Frame, &source);
            (line[completion.range].to_owned(), completion.candidates.join(" "))
        };
        for (line, replaced, candidates) in [
            ("sr", "sr", "src: srv:"),
            ("err SRC:f", "f", "FEED \"FAN 2\""),
            ("not (f", "f", "FEED \"FAN 2\""),
            ("at:12,1", "1", "12 14"),
            ("dst:", "", "all FEED \"FAN 2\" 12 14"),
            ("type:r", "r", "req rsp rtr"),
            ("mode:i", "i", "init idle"),
            ("kaputt:", "", ""),
            ("zzz", "zzz", ""),
        ] {
            assert_eq!(of(line), (replaced.to_owned(), candidates.to_owned()), "{line}");
        }
        assert!(of("src:FEED ").1.starts_with("at: name:"));
    }
}
