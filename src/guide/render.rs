//! Terminal text of the guide. Inputs: blocks, the width in columns, whether styles may be used.
//! Output: wrapped lines that end with a line feed. Code blocks and words that are longer than a
//! line are not wrapped.

use super::markdown::{GuideBlock, GuideLine, GuideSpan, SpanStyle};
use unicode_width::UnicodeWidthStr;

/// How text is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TextLayout {
    /// Columns of a line, at least [`TextLayout::MIN_WIDTH`].
    pub width: usize,
    /// True: headings and literal text are bold (SGR 1), for a terminal only.
    pub has_styles: bool,
}

impl TextLayout {
    /// Columns without a terminal.
    pub const DEFAULT_WIDTH: usize = 80;
    /// Least columns; narrower terminals break the lines.
    pub const MIN_WIDTH: usize = 20;
    /// Most columns; longer lines are hard to read.
    pub const MAX_WIDTH: usize = 100;

    /// Text without styles for a file or a pipe.
    pub const PLAIN: Self = Self { width: Self::DEFAULT_WIDTH, has_styles: false };

    /// Text for a terminal of `columns`; 0 = unknown.
    pub fn for_terminal(columns: usize) -> Self {
        let columns = if columns == 0 { Self::DEFAULT_WIDTH } else { columns };
        Self { width: columns.clamp(Self::MIN_WIDTH, Self::MAX_WIDTH), has_styles: true }
    }

    /// Returns `text` in bold if styles may be used.
    pub fn bold(self, text: &str) -> String {
        if self.has_styles { format!("\x1b[1m{text}\x1b[0m") } else { text.to_owned() }
    }
}

/// Columns by which text is indented below its heading.
const INDENT: usize = 2;
/// Longest code span, in columns, that is kept on one line.
const UNBROKEN_CODE: usize = 30;
/// Columns between the cells of a table.
const CELL_GAP: usize = 2;

/// Returns the blocks as text.
pub fn render(blocks: &[GuideBlock], layout: TextLayout) -> String {
    let mut writer = TextWriter { layout, text: String::new() };
    for (at, block) in blocks.iter().enumerate() {
        // A heading that follows another one directly needs no gap.
        let follows_heading = at > 0 && matches!(blocks[at - 1], GuideBlock::Heading(..));
        if at > 0 && !follows_heading {
            writer.text.push('\n');
        }
        writer.block(block, INDENT);
    }
    writer.text
}

/// A piece of a word, in one style.
type StyledText = (String, SpanStyle);
/// What a line is broken between.
type UnbrokenText = Vec<StyledText>;

/// The text written so far.
struct TextWriter {
    layout: TextLayout,
    text: String,
}

impl TextWriter {
    /// Writes a block, indented by `indent` columns; headings have an indent of their own.
    fn block(&mut self, block: &GuideBlock, indent: usize) {
        match block {
            GuideBlock::Heading(level, line) => {
                let text = super::markdown::plain(line);
                let text = if *level == 1 { text.to_uppercase() } else { text };
                let at = usize::from(*level > 2);
                for line in wrap(&units_of(&text, SpanStyle::Strong), self.layout.width - at) {
                    self.line(at, &line);
                }
            }
            GuideBlock::Paragraph(line) => {
                // Without styles, quotes mark literal text.
                let quote = if self.layout.has_styles { "" } else { "`" };
                for line in wrap(&units(line, quote), self.room(indent)) {
                    self.line(indent, &line);
                }
            }
            GuideBlock::Code { text, .. } => {
                for line in text.lines() {
                    let indent = if line.is_empty() { 0 } else { indent + 2 };
                    self.line(indent, &[vec![(line.to_owned(), SpanStyle::Plain)]]);
                }
            }
            GuideBlock::List { first, items } => self.list(*first, items, indent),
            GuideBlock::Table { header, rows } => {
                let room = self.room(indent);
                for line in table_lines(header, rows, room) {
                    self.line(indent, &line);
                }
            }
        }
    }

    fn list(&mut self, first: Option<u64>, items: &[Vec<GuideBlock>], indent: usize) {
        let is_loose = items.iter().any(|item| item.len() > 1);
        for (at, item) in items.iter().enumerate() {
            if at > 0 && is_loose {
                self.text.push('\n');
            }
            let marker = first.map_or("-".to_owned(), |first| format!("{}.", first + at as u64));
            let inner = indent + marker.len() + 1;
            let begin = self.text.len();
            for (number, block) in item.iter().enumerate() {
                if number > 0 {
                    self.text.push('\n');
                }
                self.block(block, inner);
            }
            // The marker replaces blanks in front of the first line.
            if self.text[begin..].starts_with(&" ".repeat(inner)) {
                let place = begin + indent..begin + indent + marker.len();
                self.text.replace_range(place, &marker);
            }
        }
    }

    fn room(&self, indent: usize) -> usize {
        self.layout.width.saturating_sub(indent).max(10)
    }

    fn line(&mut self, indent: usize, units: &[UnbrokenText]) {
        self.text.push_str(&" ".repeat(indent));
        for (at, unit) in units.iter().enumerate() {
            if at > 0 {
                self.text.push(' ');
            }
            for (text, style) in unit {
                match style {
                    SpanStyle::Plain => self.text.push_str(text),
                    SpanStyle::Strong | SpanStyle::Code => {
                        self.text.push_str(&self.layout.bold(text));
                    }
                }
            }
        }
        let end = self.text.trim_end_matches(' ').len();
        self.text.truncate(end);
        self.text.push('\n');
    }
}

fn width(unit: &[StyledText]) -> usize {
    unit.iter().map(|(text, _)| text.width()).sum()
}

/// Splits a line into words; short code spans stay in one piece.
fn units(line: &[GuideSpan], quote: &str) -> Vec<UnbrokenText> {
    let mut units: Vec<UnbrokenText> = Vec::new();
    let mut is_open = false;
    let mut add = |text: &str, style: SpanStyle, keep: bool| {
        if keep {
            match units.last_mut().filter(|_| is_open) {
                Some(unit) => unit.push((text.to_owned(), style)),
                None => units.push(vec![(text.to_owned(), style)]),
            }
            is_open = true;
            return;
        }
        for (at, word) in text.split(' ').enumerate() {
            is_open &= at == 0;
            if word.is_empty() {
                continue;
            }
            match units.last_mut().filter(|_| is_open) {
                Some(unit) => unit.push((word.to_owned(), style)),
                None => units.push(vec![(word.to_owned(), style)]),
            }
            is_open = true;
        }
        is_open &= !text.ends_with(' ');
    };
    for span in line {
        let is_code = span.style == SpanStyle::Code;
        let quoted =
            if is_code { format!("{quote}{}{quote}", span.text) } else { span.text.clone() };
        add(&quoted, span.style, is_code && span.text.width() <= UNBROKEN_CODE);
        // A link to a topic has the name of the topic as its text.
        if let Some(url) = span.link.as_deref().filter(|link| link.contains("://"))
            && url != span.text
        {
            add(&format!(" <{url}>"), SpanStyle::Plain, false);
        }
    }
    units
}

fn units_of(text: &str, style: SpanStyle) -> Vec<UnbrokenText> {
    units(&[GuideSpan { text: text.to_owned(), style, link: None }], "")
}

/// Breaks units into lines of at most `room` columns; a longer unit has a line of its own.
fn wrap(units: &[UnbrokenText], room: usize) -> Vec<Vec<UnbrokenText>> {
    let mut lines: Vec<Vec<UnbrokenText>> = Vec::new();
    let mut used = 0;
    for unit in units {
        let needed = width(unit);
        if let Some(line) = lines.last_mut().filter(|_| used + 1 + needed <= room) {
            line.push(unit.clone());
            used += 1 + needed;
        } else {
            lines.push(vec![unit.clone()]);
            used = needed;
        }
    }
    if lines.is_empty() {
        lines.push(Vec::new());
    }
    lines
}

/// Returns a table in at most `room` columns; more if its longest words need more.
pub(super) fn table_lines(
    header: &[GuideLine],
    rows: &[Vec<GuideLine>],
    room: usize,
) -> Vec<Vec<UnbrokenText>> {
    let count = header.len();
    let cells = |row: &[GuideLine]| -> Vec<Vec<UnbrokenText>> {
        (0..count).map(|at| row.get(at).map(|cell| units(cell, "")).unwrap_or_default()).collect()
    };
    let strong = |row: Vec<Vec<UnbrokenText>>| -> Vec<Vec<UnbrokenText>> {
        let pieces =
            |unit: UnbrokenText| unit.into_iter().map(|(text, _)| (text, SpanStyle::Strong));
        let cell = |units: Vec<UnbrokenText>| {
            units.into_iter().map(|unit| pieces(unit).collect()).collect()
        };
        row.into_iter().map(cell).collect()
    };
    let mut all: Vec<Vec<Vec<UnbrokenText>>> = vec![strong(cells(header))];
    all.extend(rows.iter().map(|row| cells(row)));
    let widths = column_widths(&all, room);
    let mut lines = Vec::new();
    for (at, row) in all.iter().enumerate() {
        let is_empty_header = at == 0 && row.iter().all(Vec::is_empty);
        if !is_empty_header {
            lines.extend(row_lines(row, &widths));
        }
        if at == 0 && !is_empty_header {
            let rule = |width: &usize| (("-").repeat(*width), SpanStyle::Plain);
            let gap = (" ".repeat(CELL_GAP), SpanStyle::Plain);
            let mut pieces: UnbrokenText = Vec::new();
            for width in &widths {
                if !pieces.is_empty() {
                    pieces.push(gap.clone());
                }
                pieces.push(rule(width));
            }
            lines.push(vec![pieces]);
        }
    }
    lines
}

/// Returns the widths of the columns: those of the content, the widest narrowed until all fit.
fn column_widths(rows: &[Vec<Vec<UnbrokenText>>], room: usize) -> Vec<usize> {
    let count = rows.first().map_or(0, Vec::len);
    let natural = |units: &Vec<UnbrokenText>| {
        units.iter().map(|unit| width(unit) + 1).sum::<usize>().saturating_sub(1)
    };
    let longest =
        |units: &Vec<UnbrokenText>| units.iter().map(|unit| width(unit)).max().unwrap_or(0);
    let most = |at: usize, measure: &dyn Fn(&Vec<UnbrokenText>) -> usize| {
        rows.iter().map(|row| measure(&row[at])).max().unwrap_or(0).max(1)
    };
    let mut widths: Vec<usize> = (0..count).map(|at| most(at, &natural)).collect();
    let least: Vec<usize> = (0..count).map(|at| most(at, &longest)).collect();
    let gaps = CELL_GAP * count.saturating_sub(1);
    while widths.iter().sum::<usize>() + gaps > room {
        let narrowable = (0..count).filter(|&at| widths[at] > least[at]);
        let Some(widest) = narrowable.max_by_key(|&at| widths[at]) else { break };
        widths[widest] -= 1;
    }
    widths
}

/// Returns the lines of a row, each as a single unit padded to the columns.
fn row_lines(row: &[Vec<UnbrokenText>], widths: &[usize]) -> Vec<Vec<UnbrokenText>> {
    let wrapped: Vec<Vec<Vec<UnbrokenText>>> =
        row.iter().zip(widths).map(|(cell, &width)| wrap(cell, width)).collect();
    let height = wrapped.iter().map(Vec::len).max().unwrap_or(0);
    (0..height)
        .map(|line| {
            let mut pieces: UnbrokenText = Vec::new();
            for (at, (cell, &column)) in wrapped.iter().zip(widths).enumerate() {
                let mut used = 0;
                for (word, unit) in cell.get(line).into_iter().flatten().enumerate() {
                    if word > 0 {
                        pieces.push((" ".to_owned(), SpanStyle::Plain));
                        used += 1;
                    }
                    used += width(unit);
                    pieces.extend(unit.iter().cloned());
                }
                if at + 1 < widths.len() {
                    let blanks = column.saturating_sub(used) + CELL_GAP;
                    pieces.push((" ".repeat(blanks), SpanStyle::Plain));
                }
            }
            vec![pieces]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::markdown::parse;
    use super::*;

    fn plain(text: &str, width: usize) -> String {
        render(&parse(text), TextLayout { width, has_styles: false })
    }

    #[test]
    fn paragraph_is_wrapped_and_code_is_not() {
        let text = plain(
            "# Title\n\none two three four five six\n\n```\na long line of code, kept\n```\n",
            20,
        );
        assert_eq!(
            text,
            "TITLE\n  one two three four\n  five six\n\n    a long line of code, kept\n"
        );
    }

    #[test]
    fn list_items_hang_behind_their_marker() {
        let text = plain("- one two three four\n- five\n", 20);
        assert_eq!(text, "  - one two three\n    four\n  - five\n");
        assert_eq!(plain("1. a\n2. b\n", 20), "  1. a\n  2. b\n");
    }

    #[test]
    fn table_is_narrowed_to_the_room() {
        let text = plain("| key | does |\n|---|---|\n| `a` | one two three four five |\n", 24);
        let wanted =
            "  key  does\n  ---  -----------------\n  a    one two three\n       four five\n";
        assert_eq!(text, wanted);
    }

    #[test]
    fn code_spans_stay_together_and_are_bold_on_a_terminal() {
        let text = plain("run the command `descan help keys`, then", 30);
        assert_eq!(text, "  run the command\n  `descan help keys`, then\n");
        let styled = render(&parse("a `b`"), TextLayout::for_terminal(0));
        assert_eq!(styled, "  a \x1b[1mb\x1b[0m\n");
    }
}
