//! A composition in words: `request des name to FEED`, `051C0002#0444455301`, and the inverse.

use super::fields::{FieldToken, quoted, tokens, with_near};
use super::{Composition, CompositionField, MessageKind, Mistake};
use crate::wire::framing::Framing;

/// Words that end what stands before them, outside quotes.
const KEYWORDS: [&str; 7] = ["to", "from", "data", "isotp", "raw", "error", "canfd"];

impl Composition {
    /// Reads a composition in words: `request des name to FEED`, `debug 0x005 01 02`,
    /// `051C0002#0444455301`. What stands in the fields is read when they are composed.
    ///
    /// # Errors
    ///
    /// The wrong word; its column is that in `text`.
    pub fn parse(text: &str) -> Result<Self, Mistake> {
        let wrong = |column, text: String| Mistake::new(CompositionField::Kind, column, text);
        let all = tokens(text).map_err(|at| wrong(at, "a quote has no end: \"text\"".into()))?;
        let Some(first) = all.first() else {
            let text = "what is to be sent? For example request des name to FEED";
            return Err(wrong(0, text.to_owned()));
        };
        if first.text.contains('#') {
            return raw(&all);
        }
        let kind = MessageKind::ALL.into_iter().find(|kind| first.is(kind.word()));
        let Some(kind) = kind else {
            let text = format!(
                "{} is not a kind of frame: request, response, unsolicited, debug, raw, or a frame \
                 as 051C0002#0102",
                first.shown()
            );
            let near = MessageKind::ALL.iter().map(|kind| kind.word());
            return Err(wrong(first.column, with_near(text, &first.text, near)));
        };
        if kind == MessageKind::Raw {
            return raw(&all[1..]);
        }
        let mut composition = Self { kind, ..Self::default() };
        let mut rest = all[1..].iter();
        let service = rest.next().filter(|it| !KEYWORDS.iter().any(|word| it.is(word)));
        let Some(service) = service else {
            let (what, example) = match kind {
                MessageKind::Debug => ("code", "0x005"),
                _ => ("service", "des or 0x123"),
            };
            let text = format!("after {} the {what} is needed: {example}", kind.word());
            return Err(wrong(all.get(1).map_or(text_len(text_of(&all)), |it| it.column), text));
        };
        composition.service = written(service);
        let mut field = CompositionField::Data;
        for token in rest {
            if token.is("to") || token.is("from") || token.is("data") {
                field = match token.text.to_ascii_lowercase().as_str() {
                    "to" => CompositionField::To,
                    "from" => CompositionField::From,
                    _ => CompositionField::Data,
                };
                if !kind.has(field) {
                    return Err(wrong(token.column, not_of_kind(kind, token)));
                }
            } else if let Some(flag) = flag(token) {
                let (of, framing) = flag;
                if !kind.has(of) {
                    return Err(wrong(token.column, not_of_kind(kind, token)));
                }
                let is_other = framing.is_some() && composition.framing.is_some();
                if is_other && composition.framing != framing {
                    let text = "one of isotp and raw, not both".to_owned();
                    return Err(wrong(token.column, text));
                }
                match of {
                    CompositionField::Error => composition.is_error = true,
                    CompositionField::Fd => composition.is_fd = true,
                    _ => composition.framing = framing,
                }
            } else {
                let text = match field {
                    CompositionField::To => &mut composition.to,
                    CompositionField::From => &mut composition.from,
                    _ => &mut composition.data,
                };
                if !text.is_empty() {
                    text.push(' ');
                }
                text.push_str(&written(token));
            }
        }
        Ok(composition)
    }

    /// Joins the arguments of a command line to the words of a composition: a receiver with a space in its
    /// name needs no quotes of its own.
    pub fn join_arguments(arguments: &[String]) -> String {
        let mut words: Vec<String> = Vec::new();
        for argument in arguments {
            let is_after_to = words.last().is_some_and(|word| word.eq_ignore_ascii_case("to"));
            let is_name = is_after_to
                && argument.contains(char::is_whitespace)
                && !argument.to_lowercase().starts_with("all ")
                && !argument.starts_with('"');
            words.push(if is_name { quoted(argument) } else { argument.clone() });
        }
        words.join(" ")
    }

    /// Writes it in the words that [`Composition::parse`] reads.
    pub fn to_words(&self) -> String {
        if self.kind == MessageKind::Raw {
            let is_word = self.data.contains('#')
                && !self.data.contains(|c: char| c.is_whitespace() || c == '"');
            return if is_word { self.data.clone() } else { format!("raw {}", quoted(&self.data)) };
        }
        let mut words = vec![self.kind.word().to_owned(), as_written(&self.service)];
        let mut add = |word: &str, text: &str| {
            if !text.trim().is_empty() {
                words.push(word.to_owned());
                words.push(as_written(text));
            }
        };
        add("data", &self.data);
        if self.kind.has(CompositionField::To) {
            add("to", &self.to);
        }
        add("from", &self.from);
        let framing = self.framing.filter(|_| self.kind.has(CompositionField::Framing));
        words.extend(framing.map(|framing| framing.to_string()));
        if self.is_error && self.kind.has(CompositionField::Error) {
            words.push("error".to_owned());
        }
        if self.is_fd {
            words.push("canfd".to_owned());
        }
        words.join(" ")
    }
}

/// The flag that a word is.
fn flag(token: &FieldToken) -> Option<(CompositionField, Option<Framing>)> {
    if token.is("isotp") {
        Some((CompositionField::Framing, Some(Framing::Isotp)))
    } else if token.is("raw") {
        Some((CompositionField::Framing, Some(Framing::Raw)))
    } else if token.is("error") {
        Some((CompositionField::Error, None))
    } else {
        token.is("canfd").then_some((CompositionField::Fd, None))
    }
}

fn not_of_kind(kind: MessageKind, token: &FieldToken) -> String {
    let reason = match (kind, token.text.to_ascii_lowercase().as_str()) {
        (MessageKind::Debug, "to") => ": it goes to all",
        (_, "error") => ": a response reports an error",
        _ => "",
    };
    format!("{} has no {}{reason}", kind.word(), token.shown())
}

fn raw(rest: &[FieldToken]) -> Result<Composition, Mistake> {
    let wrong = |column, text: &str| Mistake::new(CompositionField::Kind, column, text);
    match rest {
        [frame] => Ok(Composition {
            kind: MessageKind::Raw,
            data: frame.text.clone(),
            ..Composition::default()
        }),
        [] => Err(wrong(0, "after raw the frame is needed: 051C0002#0102")),
        [_, next, ..] => {
            Err(wrong(next.column, "a raw frame is one word, identifier and data: 051C0002#0102"))
        }
    }
}

/// A token as it was written.
fn written(token: &FieldToken) -> String {
    if token.is_quoted { quoted(&token.text) } else { token.text.clone() }
}

/// A field as [`Composition::parse`] reads it back: words that are keywords elsewhere stand in quotes.
fn as_written(text: &str) -> String {
    let Ok(all) = tokens(text) else { return quoted(text) };
    let words = all.iter().map(|token| {
        let is_keyword = KEYWORDS.iter().any(|word| token.is(word));
        if is_keyword { quoted(&token.text) } else { written(token) }
    });
    words.collect::<Vec<_>>().join(" ")
}

/// The last token.
fn text_of(all: &[FieldToken]) -> Option<&FieldToken> {
    all.last()
}

/// The column behind a token.
fn text_len(token: Option<&FieldToken>) -> usize {
    token.map_or(0, |it| it.column + it.text.chars().count())
}
