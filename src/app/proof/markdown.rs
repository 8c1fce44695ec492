//! Text in Markdown: what devices sent cannot end a cell, begin a list, a link, code or HTML.

use std::fmt;

/// Text of a line, or of a cell of a table, as it is.
#[derive(Clone, Copy)]
pub struct Plain<'t>(pub &'t str);

impl fmt::Display for Plain<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use fmt::Write;
        let mut before = ' ';
        let mut rest = self.0.chars().peekable();
        while let Some(c) = rest.next() {
            let next = rest.peek().copied().unwrap_or(' ');
            let is_in_word = before.is_alphanumeric() && next.is_alphanumeric();
            match c {
                // Inside a word it is no emphasis: RSP_CC_TGT.
                '_' if is_in_word => f.write_char(c)?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '&' => f.write_str("&amp;")?,
                '\\' | '`' | '*' | '_' | '[' | ']' | '|' | '#' | '~' | '$' => {
                    f.write_char('\\')?;
                    f.write_char(c)?;
                }
                // Readers make links of addresses: http://…, www.…, name@host.
                '/' if before == '/' => f.write_str("\\/")?,
                '@' => f.write_str("\\@")?,
                '.' if matches!(before, 'w' | 'W') => f.write_str("\\.")?,
                c if c.is_control() || matches!(c, '\u{2028}' | '\u{2029}') => f.write_char(' ')?,
                c => f.write_char(c)?,
            }
            before = c;
        }
        Ok(())
    }
}

/// A table that is built row by row.
#[derive(Debug)]
pub struct MarkdownTable {
    text: String,
}

impl MarkdownTable {
    /// Begins a table with these headings.
    pub fn new(headings: &[&str]) -> Self {
        let mut table = Self { text: String::new() };
        table.row(headings);
        table.text.push_str(&"|---".repeat(headings.len()));
        table.text.push_str("|\n");
        table
    }

    /// Adds a row; cells are escaped.
    pub fn row<T: AsRef<str>>(&mut self, cells: &[T]) {
        for cell in cells {
            self.text.push_str("| ");
            self.text.push_str(&Plain(cell.as_ref()).to_string());
            self.text.push(' ');
        }
        self.text.push_str("|\n");
    }

    /// The table as text.
    pub fn finish(self) -> String {
        self.text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_text_is_shown_as_it_is() {
        for (text, escaped) in [
            ("FEED", "FEED"),
            ("a|b", "a\\|b"),
            ("`rm`", "\\`rm\\`"),
            ("<script>", "&lt;script&gt;"),
            ("&lt;", "&amp;lt;"),
            ("[x](y)", "\\[x\\](y)"),
            ("![x](y)", "!\\[x\\](y)"),
            ("**x** _y_ ~z~", "\\*\\*x\\*\\* \\_y\\_ \\~z\\~"),
            ("RSP_CC_TGT __x__", "RSP_CC_TGT \\_\\_x\\_\\_"),
            ("# x", "\\# x"),
            ("a\nb\r\u{2028}c", "a b  c"),
            ("\\x0A", "\\\\x0A"),
            ("http://a www.b x@y", "http:/\\/a www\\.b x\\@y"),
        ] {
            assert_eq!(Plain(text).to_string(), escaped, "{text:?}");
        }
    }

    #[test]
    fn cell_cannot_end_its_row() {
        let mut table = MarkdownTable::new(&["A", "B"]);
        table.row(&["1\n| x |", "\\|"]);
        assert_eq!(table.finish(), "| A | B |\n|---|---|\n| 1 \\| x \\| | \\\\\\| |\n");
    }
}
