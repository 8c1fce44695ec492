//! Text in the cells of a terminal, of which a wide character takes two: its beginning, and its lines.

use unicode_width::{UnicodeWidthChar, UnicodeWidthStr};

/// Returns the longest beginning of `text` that fits `width` cells.
pub fn cut(text: &str, width: usize) -> &str {
    let mut used = 0;
    for (at, c) in text.char_indices() {
        used += c.width().unwrap_or(0);
        if used > width {
            return &text[..at];
        }
    }
    text
}

/// Breaks `text` into lines of at most `width` cells (at least 4), at blanks; a longer word is
/// broken inside.
pub fn wrap(text: &str, width: usize) -> Vec<String> {
    let width = width.max(4);
    let mut lines = Vec::new();
    let mut line = String::new();
    for mut word in text.split_whitespace() {
        if !line.is_empty() && line.width() + 1 + word.width() > width {
            lines.push(std::mem::take(&mut line));
        }
        while word.width() > width {
            let part = cut(word, width - line.width().min(width - 1));
            lines.push(std::mem::take(&mut line) + part);
            word = &word[part.len()..];
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    if !line.is_empty() {
        lines.push(line);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrap_long_text_breaks_at_blanks() {
        assert_eq!(wrap("two devices respond", 11), ["two devices", "respond"]);
        assert_eq!(wrap("a0123456789", 5), ["a0123", "45678", "9"]);
        assert!(wrap("", 5).is_empty());
    }
}
