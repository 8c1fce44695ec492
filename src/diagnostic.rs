//! What users read of an error: its cause and the way out.
//!
//! Does not know the object where the reader does: the screen names the file already; the command
//! line puts it in front.

use std::cmp::Reverse;
use std::{fmt, io};

/// Why something cannot be done, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    cause: String,
    remedy: Option<String>,
}

impl Diagnostic {
    /// Without a remedy that would fit.
    pub fn new(cause: impl Into<String>) -> Self {
        Self { cause: cause.into(), remedy: None }
    }

    /// A file or a bus that the system does not read.
    pub fn unreadable(name: impl fmt::Display, error: &io::Error) -> Self {
        Self::new(format!("{name} cannot be read: {}", without_number(error)))
    }

    /// Puts the object in front: `OBJECT: CAUSE; REMEDY`.
    #[must_use]
    pub fn of(self, object: impl fmt::Display) -> Self {
        Self { cause: format!("{object}: {}", self.cause), ..self }
    }

    /// Adds the remedy: a command or an option, in the imperative.
    #[must_use]
    pub fn with_remedy(self, remedy: impl Into<String>) -> Self {
        Self { remedy: Some(remedy.into()), ..self }
    }

    /// The cause, on one line.
    pub fn cause(&self) -> &str {
        &self.cause
    }

    /// The way out, on one line; `None` if none is known.
    pub fn remedy(&self) -> Option<&str> {
        self.remedy.as_deref()
    }
}

impl std::error::Error for Diagnostic {}

/// `CAUSE; REMEDY`.
impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.cause)?;
        self.remedy.as_ref().map_or(Ok(()), |remedy| write!(f, "; {remedy}"))
    }
}

/// The text of a system's error without its number, nor the full stop that Windows has before it.
pub fn without_number(error: &io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).trim_end_matches('.').to_owned()
}

/// Returns the word that is most like a misspelled one: one or two letters differ, and at most
/// half of them; `None` if there is none.
pub fn nearest_word<'a>(word: &str, words: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    /// Most letters that differ.
    const MAX_DISTANCE: usize = 2;
    let most = (word.chars().count() / 2).min(MAX_DISTANCE);
    let distance = |other: &&str| strsim::damerau_levenshtein(word, other);
    // The first letters are rarely the wrong ones.
    let begin = |other: &&str| word.chars().zip(other.chars()).take_while(|(a, b)| a == b).count();
    words
        .min_by_key(|other| (distance(other), Reverse(begin(other))))
        .filter(|other| distance(other) <= most)
}
