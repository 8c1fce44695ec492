//! Markdown reader: turns the text of a topic into blocks, from which the terminal text and the
//! manual pages are made. Covers what the topics use: headings, paragraphs, lists, code blocks,
//! tables, code spans, strong text and links.

use pulldown_cmark::{CodeBlockKind, Event, HeadingLevel, Options, Parser, Tag, TagEnd};
use std::iter::Peekable;

/// A block of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GuideBlock {
    /// A heading of level 1 (the title of the page) to 3.
    Heading(u8, GuideLine),
    /// Text that is wrapped.
    Paragraph(GuideLine),
    /// Text that is not wrapped.
    Code {
        /// The words behind the fence: ` ```sh run ` gives `sh run`.
        info: String,
        /// The lines, without the last line end.
        text: String,
    },
    /// A list.
    List {
        /// Number of the first item; `None`: not numbered.
        first: Option<u64>,
        /// The items, each as blocks.
        items: Vec<Vec<GuideBlock>>,
    },
    /// A table with a header.
    Table {
        /// The cells of the header; as many as in each row.
        header: Vec<GuideLine>,
        /// The cells of each row.
        rows: Vec<Vec<GuideLine>>,
    },
}

/// Text of one paragraph, heading or cell.
pub type GuideLine = Vec<GuideSpan>;

/// A piece of text in one style.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GuideSpan {
    /// The text; a line end in the source is a space.
    pub text: String,
    /// Its mark.
    pub style: SpanStyle,
    /// Target of the link around it: a file of the guide (`buses.md`, `protocol.md#...`) or a URL;
    /// `None`: no link.
    pub link: Option<String>,
}

impl GuideSpan {
    /// Returns text without marks.
    pub fn plain(text: &str) -> Self {
        Self { text: text.to_owned(), style: SpanStyle::Plain, link: None }
    }

    /// Returns literal text.
    pub fn code(text: &str) -> Self {
        Self { style: SpanStyle::Code, ..Self::plain(text) }
    }
}

/// Mark of a piece of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpanStyle {
    /// None.
    Plain,
    /// Strong or emphasised.
    Strong,
    /// Literal: typed or shown as it stands.
    Code,
}

/// Reads Markdown. HTML is ignored.
pub fn parse(text: &str) -> Vec<GuideBlock> {
    MarkdownReader { events: Parser::new_ext(text, Options::ENABLE_TABLES).peekable() }.blocks()
}

/// Returns the text of a line without its marks.
pub fn plain(line: &[GuideSpan]) -> String {
    line.iter().map(|span| span.text.as_str()).collect()
}

/// The events of the parser, from which blocks are collected.
struct MarkdownReader<'t> {
    events: Peekable<Parser<'t>>,
}

impl MarkdownReader<'_> {
    /// Reads blocks up to the end of the enclosing element, and consumes that end.
    fn blocks(&mut self) -> Vec<GuideBlock> {
        let mut blocks = Vec::new();
        while let Some(event) = self.events.peek() {
            match event {
                Event::Start(tag) if is_block(tag) => {
                    let Some(Event::Start(tag)) = self.events.next() else { break };
                    blocks.extend(self.block(tag));
                }
                Event::End(_) => {
                    self.events.next();
                    break;
                }
                Event::Rule | Event::Html(_) => {
                    self.events.next();
                }
                // An item of a list whose items are single lines has no paragraph of its own.
                _ => blocks.push(GuideBlock::Paragraph(self.line())),
            }
        }
        blocks
    }

    /// Reads the block that `tag` begins; `None` for elements that the topics do not use.
    fn block(&mut self, tag: Tag<'_>) -> Option<GuideBlock> {
        Some(match tag {
            Tag::Heading { level, .. } => {
                let line = self.line();
                self.events.next();
                let level = match level {
                    HeadingLevel::H1 => 1,
                    HeadingLevel::H2 => 2,
                    _ => 3,
                };
                GuideBlock::Heading(level, line)
            }
            Tag::Paragraph => {
                let line = self.line();
                self.events.next();
                GuideBlock::Paragraph(line)
            }
            Tag::CodeBlock(kind) => {
                let mut text = String::new();
                for event in self.events.by_ref() {
                    match event {
                        Event::Text(part) => text.push_str(&part),
                        Event::End(TagEnd::CodeBlock) => break,
                        _ => {}
                    }
                }
                let info = match kind {
                    CodeBlockKind::Fenced(info) => info.into_string(),
                    CodeBlockKind::Indented => String::new(),
                };
                GuideBlock::Code { info, text: text.trim_end_matches('\n').to_owned() }
            }
            Tag::List(first) => {
                let mut items = Vec::new();
                while let Some(Event::Start(Tag::Item)) = self.events.next() {
                    items.push(self.blocks());
                }
                GuideBlock::List { first, items }
            }
            Tag::Table(_) => {
                let mut rows = Vec::new();
                while let Some(Event::Start(Tag::TableHead | Tag::TableRow)) = self.events.next() {
                    let mut cells = Vec::new();
                    while let Some(Event::Start(Tag::TableCell)) = self.events.next() {
                        cells.push(self.line());
                        self.events.next();
                    }
                    rows.push(cells);
                }
                let header = if rows.is_empty() { Vec::new() } else { rows.remove(0) };
                GuideBlock::Table { header, rows }
            }
            _ => {
                self.blocks();
                return None;
            }
        })
    }

    /// Reads text up to the next block or the end of this one, which is not consumed.
    fn line(&mut self) -> GuideLine {
        let mut spans = GuideLine::new();
        let mut strong = 0u32;
        let mut link = None;
        let mut add = |text: &str, style, link: &Option<String>| match spans.last_mut() {
            Some(last) if last.style == style && last.link == *link => last.text.push_str(text),
            _ => spans.push(GuideSpan { text: text.to_owned(), style, link: link.clone() }),
        };
        loop {
            match self.events.peek() {
                Some(Event::Start(tag)) if is_block(tag) => break,
                Some(Event::End(
                    TagEnd::Strong | TagEnd::Emphasis | TagEnd::Link | TagEnd::Strikethrough,
                )) => {}
                Some(Event::End(_)) | None => break,
                _ => {}
            }
            let style = if strong > 0 { SpanStyle::Strong } else { SpanStyle::Plain };
            match self.events.next() {
                Some(Event::Start(Tag::Strong | Tag::Emphasis)) => strong += 1,
                Some(Event::End(TagEnd::Strong | TagEnd::Emphasis)) => strong -= 1,
                Some(Event::Start(Tag::Link { dest_url, .. })) => link = Some(dest_url.to_string()),
                Some(Event::End(TagEnd::Link)) => link = None,
                Some(Event::Text(text)) => add(&text, style, &link),
                Some(Event::Code(text)) => add(&text, SpanStyle::Code, &link),
                Some(Event::SoftBreak | Event::HardBreak) => add(" ", style, &link),
                _ => {}
            }
        }
        spans
    }
}

/// Returns true if the element is a block, not a mark inside a line.
fn is_block(tag: &Tag<'_>) -> bool {
    !matches!(tag, Tag::Strong | Tag::Emphasis | Tag::Strikethrough | Tag::Link { .. })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parse_reads_all_kinds_of_blocks() {
        let blocks =
            parse("# T `c`\n\na\nb **c** [d](e.md)\n\n- x\n- y\n\n  z\n\n| h |\n|---|\n| `1` |\n");
        assert_eq!(blocks.len(), 4);
        let GuideBlock::Heading(1, title) = &blocks[0] else { panic!("{blocks:?}") };
        assert_eq!(plain(title), "T c");
        let GuideBlock::Paragraph(line) = &blocks[1] else { panic!("{blocks:?}") };
        assert_eq!(plain(line), "a b c d");
        assert_eq!(line[3].link.as_deref(), Some("e.md"));
        let GuideBlock::List { first: None, items } = &blocks[2] else { panic!("{blocks:?}") };
        assert_eq!(items.iter().map(Vec::len).collect::<Vec<_>>(), [1, 2]);
        let GuideBlock::Table { header, rows } = &blocks[3] else { panic!("{blocks:?}") };
        assert_eq!((plain(&header[0]), rows[0][0][0].style), ("h".to_owned(), SpanStyle::Code));
    }

    #[test]
    fn code_block_keeps_fence_words_and_lines() {
        let blocks = parse("```sh run\na\n\n  b\n```\n");
        let wanted = GuideBlock::Code { info: "sh run".to_owned(), text: "a\n\n  b".to_owned() };
        assert_eq!(blocks, [wanted]);
    }
}
