//! Manual pages in roff with the man macros, for `man -l`, groff and mandoc. Input: blocks. Output:
//! ASCII; other characters are written as `\[uXXXX]`. Tables of two columns are tagged
//! paragraphs, wider ones are set in [`TABLE_WIDTH`] columns.

use super::markdown::{GuideBlock, GuideLine, GuideSpan, SpanStyle, plain};
use super::render::table_lines;
use std::fmt::Write;

/// Width of a table of three columns or more: 80 without the indentation of man.
const TABLE_WIDTH: usize = 70;

/// Returns the line that begins a page, without hyphenation and justification: literal text must
/// stay as it is typed.
pub fn title(name: &str, section: u8, version: &str) -> String {
    let name = escape(&name.to_uppercase());
    format!(
        ".TH \"{name}\" \"{section}\" \"\" \"descan {}\" \"descan guide\"\n.ad l\n.nh\n",
        escape(version)
    )
}

/// Returns the section NAME.
pub fn name(name: &str, summary: &str) -> String {
    format!(".SH NAME\n{} \\- {}\n", escape(name), escape(summary))
}

/// Returns the heading of a section.
pub fn section(title: &str) -> String {
    format!(".SH \"{}\"\n", escape(&title.to_uppercase()))
}

/// Returns a reference to another page.
pub fn reference(name: &str, section: u8) -> String {
    format!("\\fB{}\\fR({section})", escape(name))
}

/// Returns the blocks as roff: headings of level 1 are left out, those of level 2 are sections.
/// `page` returns the name and section of the manual page of a file of the guide.
pub fn body(blocks: &[GuideBlock], page: &dyn Fn(&str) -> Option<(String, u8)>) -> String {
    let mut writer = RoffWriter { page, text: String::new() };
    for block in blocks {
        writer.block(block, false);
    }
    writer.text
}

/// Returns lines that are not wrapped.
pub fn literal(text: &str) -> String {
    let mut out = String::from(".PP\n.RS 4\n.nf\n");
    for line in text.lines() {
        let _ = writeln!(out, "{}", guarded(&escape(line)));
    }
    out.push_str(".fi\n.RE\n");
    out
}

/// Returns a paragraph, which man wraps.
pub fn paragraph(text: &str) -> String {
    format!(".PP\n{}\n", guarded(&escape(text)))
}

/// The roff written so far.
struct RoffWriter<'p> {
    page: &'p dyn Fn(&str) -> Option<(String, u8)>,
    text: String,
}

impl RoffWriter<'_> {
    /// Writes a block; `continues`: it is the first of a list item and needs no `.PP`.
    fn block(&mut self, block: &GuideBlock, continues: bool) {
        match block {
            GuideBlock::Heading(1, _) => {}
            GuideBlock::Heading(2, line) => self.text.push_str(&section(&plain(line))),
            GuideBlock::Heading(_, line) => {
                let _ = writeln!(self.text, ".SS \"{}\"", escape(&plain(line)));
            }
            GuideBlock::Paragraph(line) => {
                if !continues {
                    self.text.push_str(".PP\n");
                }
                let line = self.inline(line);
                let _ = writeln!(self.text, "{}", guarded(&line));
            }
            GuideBlock::Code { text, .. } => self.text.push_str(&literal(text)),
            GuideBlock::List { first, items } => {
                for (at, item) in items.iter().enumerate() {
                    let marker = match first {
                        Some(first) => format!("{}.", first + at as u64),
                        None => "\\(bu".to_owned(),
                    };
                    let _ = writeln!(self.text, ".IP \"{marker}\" 4");
                    for (number, block) in item.iter().enumerate() {
                        if number > 0 && matches!(block, GuideBlock::Paragraph(_)) {
                            self.text.push_str(".IP \"\" 4\n");
                        }
                        self.block(block, true);
                    }
                }
            }
            GuideBlock::Table { header, rows } if header.len() == 2 => {
                for row in rows {
                    let cell = |at: usize| row.get(at).map(|cell| self.inline(cell));
                    let (tag, text) = (cell(0).unwrap_or_default(), cell(1).unwrap_or_default());
                    let _ = writeln!(self.text, ".TP 4\n{}\n{}", guarded(&tag), guarded(&text));
                }
            }
            GuideBlock::Table { header, rows } => self.wide_table(header, rows),
        }
    }

    fn wide_table(&mut self, header: &[GuideLine], rows: &[Vec<GuideLine>]) {
        self.text.push_str(".PP\n.nf\n");
        for line in table_lines(header, rows, TABLE_WIDTH) {
            let pieces = line.iter().flatten();
            let line: String = pieces.map(|(text, style)| styled(text, *style)).collect();
            let _ = writeln!(self.text, "{}", guarded(line.trim_end()));
        }
        self.text.push_str(".fi\n");
    }

    fn inline(&self, spans: &[GuideSpan]) -> String {
        let mut text = String::new();
        for span in spans {
            match span.link.as_deref() {
                Some(link) if link.contains("://") => {
                    let _ = write!(text, "{}", styled(&span.text, span.style));
                    if span.text != *link {
                        let _ = write!(text, " <{}>", escape(link));
                    }
                }
                Some(link) => match (self.page)(link) {
                    Some((name, section)) => text.push_str(&reference(&name, section)),
                    None => text.push_str(&styled(&span.text, span.style)),
                },
                None => text.push_str(&styled(&span.text, span.style)),
            }
        }
        text
    }
}

fn styled(text: &str, style: SpanStyle) -> String {
    match style {
        SpanStyle::Strong | SpanStyle::Code if !text.trim().is_empty() => {
            format!("\\fB{}\\fR", escape(text))
        }
        _ => escape(text),
    }
}

/// Escapes all characters with a meaning in roff.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' => out.push_str("\\(rs"),
            '-' => out.push_str("\\-"),
            '\'' => out.push_str("\\(aq"),
            '`' => out.push_str("\\(ga"),
            '^' => out.push_str("\\(ha"),
            '~' => out.push_str("\\(ti"),
            '"' => out.push_str("\\(dq"),
            // groff composes ≠ from = and a slash; the name avoids a warning.
            '≠' => out.push_str("\\(!="),
            c => push_ascii(&mut out, c),
        }
    }
    out
}

/// Replaces all characters of roff text that are not ASCII by escapes.
pub fn ascii(roff: &str) -> String {
    let mut out = String::with_capacity(roff.len());
    roff.chars().for_each(|c| push_ascii(&mut out, c));
    out
}

fn push_ascii(out: &mut String, c: char) {
    if c.is_ascii() {
        out.push(c);
    } else {
        let _ = write!(out, "\\[u{:04X}]", u32::from(c));
    }
}

/// Protects a line that would begin a request.
fn guarded(line: &str) -> String {
    if line.starts_with('.') || line.starts_with('\'') {
        format!("\\&{line}")
    } else {
        line.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::super::markdown::parse;
    use super::*;

    #[test]
    fn special_characters_are_escaped() {
        let text = body(&parse("## A b\n\n.x `-y` \\\\ ● it's\n"), &|_| None);
        assert_eq!(text, ".SH \"A B\"\n.PP\n\\&.x \\fB\\-y\\fR \\(rs \\[u25CF] it\\(aqs\n");
    }

    #[test]
    fn link_to_a_topic_becomes_a_reference() {
        let page = |link: &str| (link == "keys.md").then(|| ("descan-keys".to_owned(), 7));
        let text = body(&parse("see [`descan help keys`](keys.md)"), &page);
        assert_eq!(text, ".PP\nsee \\fBdescan\\-keys\\fR(7)\n");
    }
}
