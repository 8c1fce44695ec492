//! A line of terms with `and`, `or`, `not` and parentheses.
//!
//! Input: the line. Output: a tree of terms, each with its place in the line, or the place and the
//! cause of a mistake. Bounded: parentheses and negations nest at most 64 deep. Does not know what
//! terms mean.

use super::FilterError;
use std::ops::Range;

/// Deepest nesting of parentheses and negations.
const MAX_DEPTH: usize = 64;

/// Tests that are joined by `and`, `or` and `not`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Expression<T> {
    Test(T),
    Not(Box<Self>),
    /// All of them match; true if there is none.
    All(Vec<Self>),
    /// One of them matches.
    Any(Vec<Self>),
}

impl<T> Default for Expression<T> {
    fn default() -> Self {
        Self::All(Vec::new())
    }
}

impl<T> Expression<T> {
    /// Returns true if there is no test: everything matches.
    pub fn is_empty(&self) -> bool {
        matches!(self, Self::All(parts) if parts.is_empty())
    }

    /// Returns true if it matches with these results of its tests.
    pub fn is_match(&self, test: &mut impl FnMut(&T) -> bool) -> bool {
        match self {
            Self::Test(one) => test(one),
            Self::Not(part) => !part.is_match(test),
            Self::All(parts) => parts.iter().all(|part| part.is_match(test)),
            Self::Any(parts) => parts.iter().any(|part| part.is_match(test)),
        }
    }

    /// Replaces each test.
    ///
    /// # Errors
    /// The first error of `replace`.
    pub fn try_map<U, E>(
        &self,
        replace: &mut impl FnMut(&T) -> Result<U, E>,
    ) -> Result<Expression<U>, E> {
        Ok(match self {
            Self::Test(one) => Expression::Test(replace(one)?),
            Self::Not(part) => Expression::Not(Box::new(part.try_map(replace)?)),
            Self::All(parts) => Expression::All(try_map_all(parts, replace)?),
            Self::Any(parts) => Expression::Any(try_map_all(parts, replace)?),
        })
    }

    /// Replaces each test.
    pub fn map<U>(&self, mut replace: impl FnMut(&T) -> U) -> Expression<U> {
        let mapped = self.try_map(&mut |one| Ok::<U, std::convert::Infallible>(replace(one)));
        match mapped {
            Ok(mapped) => mapped,
            Err(never) => match never {},
        }
    }

    /// Calls `visit` with each test.
    pub fn for_each(&self, visit: &mut impl FnMut(&T)) {
        match self {
            Self::Test(one) => visit(one),
            Self::Not(part) => part.for_each(visit),
            Self::All(parts) | Self::Any(parts) => {
                for part in parts {
                    part.for_each(visit);
                }
            }
        }
    }

    /// Calls `visit` with each test.
    pub fn for_each_mut(&mut self, visit: &mut impl FnMut(&mut T)) {
        match self {
            Self::Test(one) => visit(one),
            Self::Not(part) => part.for_each_mut(visit),
            Self::All(parts) | Self::Any(parts) => {
                for part in parts {
                    part.for_each_mut(visit);
                }
            }
        }
    }
}

fn try_map_all<T, U, E>(
    parts: &[Expression<T>],
    replace: &mut impl FnMut(&T) -> Result<U, E>,
) -> Result<Vec<Expression<U>>, E> {
    parts.iter().map(|part| part.try_map(replace)).collect()
}

/// A term of a line, without its negation; quotes stay in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Term {
    pub text: String,
    /// Its bytes in the line.
    pub range: Range<usize>,
}

/// A piece of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TokenKind {
    Open,
    Close,
    And,
    Or,
    Not,
    Term,
}

#[derive(Clone, Debug)]
pub(super) struct Token {
    kind: TokenKind,
    pub range: Range<usize>,
}

impl Token {
    /// Returns true if it is a term, not an operator.
    pub fn is_term(&self) -> bool {
        self.kind == TokenKind::Term
    }
}

/// Splits a line into its pieces.
///
/// # Errors
/// A quote that is not closed; the pieces before it.
pub(super) fn tokens(line: &str) -> (Vec<Token>, Result<(), FilterError>) {
    let mut tokens = Vec::new();
    let mut at = 0;
    while let Some(c) = line[at..].chars().next() {
        let start = at;
        at += c.len_utf8();
        let kind = match c {
            _ if c.is_whitespace() => continue,
            '(' => TokenKind::Open,
            ')' => TokenKind::Close,
            '!' => TokenKind::Not,
            _ => {
                let (end, is_closed) = end_of_term(line, start);
                at = end;
                if !is_closed {
                    let range = start..end;
                    tokens.push(Token { kind: TokenKind::Term, range: range.clone() });
                    return (tokens, Err(FilterError::new("a quote is not closed: add \"", range)));
                }
                match &*line[start..end].to_lowercase() {
                    "and" => TokenKind::And,
                    "or" => TokenKind::Or,
                    "not" => TokenKind::Not,
                    _ => TokenKind::Term,
                }
            }
        };
        tokens.push(Token { kind, range: start..at });
    }
    (tokens, Ok(()))
}

/// Returns the end of the term at `start`, and true unless a quote in it is open. A parenthesis that
/// is opened in a term is closed in it. A letter or a digit right behind a value in quotes begins another term.
fn end_of_term(line: &str, start: usize) -> (usize, bool) {
    let (mut is_quoted, mut depth) = (false, 0usize);
    // The quotes are those of a value; it has just ended.
    let (mut is_value, mut was_value, mut before) = (false, false, ' ');
    for (at, c) in line[start..].char_indices() {
        if std::mem::take(&mut was_value) && depth == 0 && c.is_alphanumeric() {
            return (start + at, true);
        }
        match c {
            '"' if is_quoted => (is_quoted, was_value) = (false, is_value),
            '"' => (is_quoted, is_value) = (true, before == ':'),
            _ if is_quoted => {}
            '(' => depth += 1,
            ')' if depth > 0 => depth -= 1,
            ')' => return (start + at, true),
            _ if c.is_whitespace() => return (start + at, true),
            _ => {}
        }
        before = c;
    }
    (line.len(), !is_quoted)
}

/// Parses a line.
///
/// # Errors
/// The first mistake.
pub(super) fn parse(line: &str) -> Result<Expression<Term>, FilterError> {
    let (tokens, result) = tokens(line);
    result?;
    let mut parser = Parser { line, tokens: &tokens, at: 0, depth: 0 };
    if tokens.is_empty() {
        return Ok(Expression::default());
    }
    let expression = parser.any()?;
    match parser.next() {
        None => Ok(expression),
        Some(token) => {
            Err(FilterError::new("no parenthesis is open: remove )", token.range.clone()))
        }
    }
}

struct Parser<'a> {
    line: &'a str,
    tokens: &'a [Token],
    at: usize,
    depth: usize,
}

impl<'a> Parser<'a> {
    fn peek(&self) -> Option<TokenKind> {
        self.tokens.get(self.at).map(|token| token.kind)
    }

    fn next(&mut self) -> Option<&'a Token> {
        let token = self.tokens.get(self.at)?;
        self.at += 1;
        Some(token)
    }

    /// Terms with `or` between them.
    fn any(&mut self) -> Result<Expression<Term>, FilterError> {
        let mut parts = vec![self.all()?];
        while self.peek() == Some(TokenKind::Or) {
            self.at += 1;
            parts.push(self.all()?);
        }
        Ok(if parts.len() == 1 { parts.remove(0) } else { Expression::Any(parts) })
    }

    /// Terms beside each other, or with `and` between them.
    fn all(&mut self) -> Result<Expression<Term>, FilterError> {
        let mut parts = vec![self.one()?];
        loop {
            match self.peek() {
                None | Some(TokenKind::Or | TokenKind::Close) => break,
                Some(TokenKind::And) => self.at += 1,
                Some(TokenKind::Open | TokenKind::Not | TokenKind::Term) => {}
            }
            parts.push(self.one()?);
        }
        Ok(if parts.len() == 1 { parts.remove(0) } else { Expression::All(parts) })
    }

    fn one(&mut self) -> Result<Expression<Term>, FilterError> {
        let Some(token) = self.next() else { return Err(self.lacks_term()) };
        let range = token.range.clone();
        match token.kind {
            TokenKind::Term => {
                let text = self.line[range.clone()].to_owned();
                Ok(Expression::Test(Term { text, range }))
            }
            TokenKind::Not | TokenKind::Open if self.depth == MAX_DEPTH => {
                Err(FilterError::new(format!("more than {MAX_DEPTH} levels"), range))
            }
            TokenKind::Not => {
                self.depth += 1;
                let part = self.one()?;
                self.depth -= 1;
                Ok(Expression::Not(Box::new(part)))
            }
            TokenKind::Open => {
                self.depth += 1;
                let part = self.any()?;
                self.depth -= 1;
                match self.next() {
                    Some(_) => Ok(part),
                    None => Err(FilterError::new("a parenthesis is not closed: add )", range)),
                }
            }
            TokenKind::And | TokenKind::Or | TokenKind::Close => {
                self.at -= 1;
                Err(self.lacks_term())
            }
        }
    }

    /// The mistake of a place that lacks a term.
    fn lacks_term(&self) -> FilterError {
        let before = self.at.checked_sub(1).and_then(|at| self.tokens.get(at));
        let found = self.tokens.get(self.at).or(before);
        let range = found.map_or(0..self.line.len(), |token| token.range.clone());
        let word = &self.line[range.clone()];
        let hint = match found.map(|token| token.kind) {
            Some(TokenKind::Open | TokenKind::Close) => "",
            _ if word == "!" => "",
            _ => "; quote it to search for the word",
        };
        let place = if self.at < self.tokens.len() { "before" } else { "after" };
        FilterError::new(format!("a term is missing {place} {word}{hint}"), range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tree of a line: `&(a |(b c))`.
    fn tree(line: &str) -> String {
        fn show(expression: &Expression<Term>) -> String {
            let list =
                |parts: &[Expression<Term>]| parts.iter().map(show).collect::<Vec<_>>().join(" ");
            match expression {
                Expression::Test(term) => term.text.clone(),
                Expression::Not(part) => format!("!{}", show(part)),
                Expression::All(parts) => format!("&({})", list(parts)),
                Expression::Any(parts) => format!("|({})", list(parts)),
            }
        }
        match parse(line) {
            Ok(expression) => show(&expression),
            Err(error) => format!("{}: {}", error.column(line), error.text()),
        }
    }

    #[test]
    fn operators_bind_by_their_strength() {
        for (line, expected) in [
            ("  ", "&()"),
            ("a", "a"),
            ("a b", "&(a b)"),
            ("a and b", "&(a b)"),
            ("a b or c d", "|(&(a b) &(c d))"),
            ("a (b OR c) not d", "&(a |(b c) !d)"),
            ("!a !!b ! c", "&(!a !!b !c)"),
            ("!(a or b)", "!|(a b)"),
            ("((a))", "a"),
            ("f(x) at:(1)", "&(f(x) at:(1))"),
            ("\"a or b\" bus:\"x y\")", "19: no parenthesis is open: remove )"),
            ("a\"b c\"d", "a\"b c\"d"),
            ("(a", "1: a parenthesis is not closed: add )"),
            ("a and", "3: a term is missing after and; quote it to search for the word"),
            ("or a", "1: a term is missing before or; quote it to search for the word"),
            ("a or or b", "6: a term is missing before or; quote it to search for the word"),
            ("()", "2: a term is missing before )"),
            ("!", "1: a term is missing after !"),
            ("ж \"x", "3: a quote is not closed: add \""),
        ] {
            assert_eq!(tree(line), expected, "{line}");
        }
    }

    #[test]
    fn deep_nesting_is_refused() {
        let deep = format!("{}a{}", "(".repeat(64), ")".repeat(64));
        assert!(parse(&deep).is_ok());
        assert!(parse(&"(".repeat(1_000_000)).is_err());
        assert!(parse(&"!".repeat(1_000_000)).is_err());
        assert!(parse(&"a or ".repeat(100_000)).is_err());
        assert!(parse(&format!("{}a", "a or ".repeat(100_000))).is_ok());
    }
}
