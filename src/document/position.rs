//! Lines and columns of byte offsets.

use std::fmt;

/// A position in the file, as text editors count it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// Line, from 1; a line ends with LF.
    pub line: usize,
    /// Column in characters, from 1; a byte order mark does not count.
    pub column: usize,
}

impl Position {
    /// Start of the file.
    pub(super) const START: Self = Self { line: 1, column: 1 };
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}", self.line, self.column)
    }
}

/// Positions in a text. A query reads at most one block: a file may be one long line.
pub(super) struct Positions<'a> {
    text: &'a [u8],
    /// Position of the start of each block.
    blocks: Vec<Position>,
}

const BLOCK_BYTES: usize = 1024;

impl<'a> Positions<'a> {
    pub fn new(text: &'a str) -> Self {
        let text = text.as_bytes();
        let mut position = Position::START;
        let mut blocks = Vec::with_capacity(text.len() / BLOCK_BYTES + 1);
        for block in text.chunks(BLOCK_BYTES) {
            blocks.push(position);
            position = advance(position, block);
        }
        blocks.push(position);
        Self { text, blocks }
    }

    pub fn at(&self, offset: usize) -> Position {
        let block = offset / BLOCK_BYTES;
        advance(self.blocks[block], &self.text[block * BLOCK_BYTES..offset])
    }
}

/// Returns the position behind a text that starts at `from`.
fn advance(from: Position, text: &[u8]) -> Position {
    match memchr::memrchr(b'\n', text) {
        None => Position { column: from.column + characters(text), ..from },
        Some(last) => Position {
            line: from.line + memchr::memchr_iter(b'\n', text).count(),
            column: 1 + characters(&text[last + 1..]),
        },
    }
}

/// Returns the number of characters: all bytes but the continuation bytes of UTF-8.
fn characters(text: &[u8]) -> usize {
    text.iter().filter(|&&byte| byte & 0xC0 != 0x80).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_count_characters_across_blocks() {
        let text = "abc\nдef\r\n".repeat(700) + &"ж".repeat(3000);
        let positions = Positions::new(&text);
        let mut expected = Position::START;
        for (offset, c) in text.char_indices() {
            assert_eq!(positions.at(offset), expected);
            if c == '\n' {
                expected = Position { line: expected.line + 1, column: 1 };
            } else {
                expected.column += 1;
            }
        }
        assert_eq!(positions.at(text.len()), expected);
    }
}
