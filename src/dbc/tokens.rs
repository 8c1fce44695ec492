//! DbcTokens of a DBC file: words, quoted texts and signs, with their lines.
//!
//! Does not know statements.

use super::file::DbcError;

/// A part of the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DbcTokenKind<'t> {
    /// A name, a number or a keyword.
    Word(&'t str),
    /// What stands between quotes, as it is.
    Quoted(&'t str),
    Sign(char),
}

/// A token and its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct DbcToken<'t> {
    pub kind: DbcTokenKind<'t>,
    /// Counted from 1.
    pub line: usize,
    /// Nothing is before it in its line, not even blanks.
    pub is_flush: bool,
}

/// Reads the tokens of a text, one after the other.
#[derive(Clone, Debug)]
pub(super) struct DbcTokens<'t> {
    rest: &'t str,
    /// What ends a line: LF, or CR in a file without any.
    line_end: char,
    line: usize,
    is_flush: bool,
}

impl<'t> DbcTokens<'t> {
    pub fn new(text: &'t str) -> Self {
        let line_end = if text.contains('\n') { '\n' } else { '\r' };
        Self { rest: text, line_end, line: 1, is_flush: true }
    }

    /// Line of what follows, counted from 1.
    pub fn line(&self) -> usize {
        self.line
    }

    /// Returns the next token; `None` at the end.
    ///
    /// # Errors
    ///
    /// A quoted text does not end.
    pub fn next(&mut self) -> Result<Option<DbcToken<'t>>, DbcError> {
        loop {
            let Some(character) = self.rest.chars().next() else { return Ok(None) };
            if !character.is_whitespace() {
                return self.token(character).map(Some);
            }
            self.rest = &self.rest[character.len_utf8()..];
            self.is_flush = character == self.line_end;
            self.line += usize::from(self.is_flush);
        }
    }

    /// Returns the token that begins with a character.
    fn token(&mut self, character: char) -> Result<DbcToken<'t>, DbcError> {
        let (line, rest) = (self.line, self.rest);
        let (kind, len) = match character {
            '"' => {
                let text = &rest[1..];
                let end = end_of_quoted(text);
                let end = end.ok_or_else(|| DbcError::new(line, "the quoted text does not end"))?;
                self.line += text[..end].matches(self.line_end).count();
                (DbcTokenKind::Quoted(&text[..end]), end + 2)
            }
            sign if is_sign(sign) => (DbcTokenKind::Sign(sign), sign.len_utf8()),
            _ => {
                let end = rest.find(|c: char| c.is_whitespace() || c == '"' || is_sign(c));
                let end = end.unwrap_or(rest.len());
                (DbcTokenKind::Word(&rest[..end]), end)
            }
        };
        let token = DbcToken { kind, line, is_flush: self.is_flush };
        self.is_flush = false;
        self.rest = &rest[len..];
        Ok(token)
    }
}

/// Returns where a quoted text ends: at a quote without a backslash before it.
fn end_of_quoted(text: &str) -> Option<usize> {
    let mut is_escaped = false;
    for (at, byte) in text.bytes().enumerate() {
        match byte {
            b'"' if !is_escaped => return Some(at),
            b'\\' => is_escaped = !is_escaped,
            _ => is_escaped = false,
        }
    }
    None
}

fn is_sign(character: char) -> bool {
    matches!(character, ':' | '|' | '@' | '(' | ')' | '[' | ']' | ',' | ';')
}
