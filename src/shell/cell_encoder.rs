//! Cells of a row as bytes for a terminal, as few as possible: a style only where it changes, a move of
//! the cursor only over more cells than it is long.
//!
//! Knows how the terminal stands after what was encoded before. ECMA-48, as all terminals have it.

use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};
use std::io::{self, Write};
use unicode_width::UnicodeWidthStr;

/// Attributes: off and on by one number each; `0` is off for all.
const ATTRIBUTES: [(Modifier, u8); 8] = [
    (Modifier::BOLD, 1),
    (Modifier::DIM, 2),
    (Modifier::ITALIC, 3),
    (Modifier::UNDERLINED, 4),
    (Modifier::SLOW_BLINK, 5),
    (Modifier::REVERSED, 7),
    (Modifier::HIDDEN, 8),
    (Modifier::CROSSED_OUT, 9),
];
/// Unchanged cells that are sent again rather than moved over: a move has five bytes or more.
const SHORT_GAP: u16 = 4;

/// Colours and attributes of the next character.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pen {
    front: Color,
    back: Color,
    attributes: Modifier,
}

impl Pen {
    const PLAIN: Self =
        Self { front: Color::Reset, back: Color::Reset, attributes: Modifier::empty() };

    fn of(cell: &Cell) -> Self {
        Self { front: cell.fg, back: cell.bg, attributes: cell.modifier }
    }
}

/// See the documentation of the module.
#[derive(Debug)]
pub(super) struct CellEncoder {
    pen: Pen,
    /// Where the next character goes; `None` if that is not known.
    at: Option<(u16, u16)>,
}

impl CellEncoder {
    /// Returns the state of a terminal of which nothing is known but that its style is plain.
    pub fn new() -> Self {
        Self { pen: Pen::PLAIN, at: None }
    }

    /// Writes the changed cells of a row, of which `shown` has those that the terminal shows.
    pub fn write_row(
        &mut self,
        out: &mut impl Write,
        shown: &Buffer,
        cells: &[(u16, u16, &Cell)],
    ) -> io::Result<()> {
        for &(x, y, cell) in cells {
            self.move_to(out, shown, (x, y))?;
            self.write_cell(out, cell)?;
            let width = cell.symbol().width();
            // Behind wide characters terminals do not agree.
            let last = x + 1 == shown.area.width;
            self.at = (width == 1 && !last).then_some((x + 1, y));
        }
        Ok(())
    }

    fn move_to(
        &mut self,
        out: &mut impl Write,
        shown: &Buffer,
        (x, y): (u16, u16),
    ) -> io::Result<()> {
        match self.at {
            Some((at, row)) if (at, row) == (x, y) => Ok(()),
            Some((at, row)) if row == y && at < x => {
                let is_plain = |x: u16| {
                    let cell = &shown[(x, y)];
                    cell.symbol().len() == 1 && Pen::of(cell) == self.pen
                };
                if x - at > SHORT_GAP || !(at..x).all(is_plain) {
                    return write!(out, "\x1b[{}G", x + 1);
                }
                (at..x).try_for_each(|x| out.write_all(shown[(x, y)].symbol().as_bytes()))
            }
            _ => write!(out, "\x1b[{};{}H", y + 1, x + 1),
        }
    }

    fn write_cell(&mut self, out: &mut impl Write, cell: &Cell) -> io::Result<()> {
        let pen = Pen::of(cell);
        if pen != self.pen {
            let mut numbers = Vec::new();
            if pen == Pen::PLAIN {
                numbers.push(0);
            } else {
                let mut was = self.pen;
                if !pen.attributes.contains(was.attributes) {
                    numbers.push(0);
                    was = Pen::PLAIN;
                }
                let added = pen.attributes.difference(was.attributes);
                let added = ATTRIBUTES.iter().filter(|(it, _)| added.contains(*it));
                numbers.extend(added.map(|(_, number)| *number));
                if pen.front != was.front {
                    push_colour(&mut numbers, pen.front, 30);
                }
                if pen.back != was.back {
                    push_colour(&mut numbers, pen.back, 40);
                }
            }
            for (at, number) in numbers.iter().enumerate() {
                write!(out, "{}{number}", if at == 0 { "\x1b[" } else { ";" })?;
            }
            out.write_all(b"m")?;
            self.pen = pen;
        }
        out.write_all(cell.symbol().as_bytes())
    }

    /// Makes the style plain, and counts the place of the cursor as unknown.
    pub fn finish(&mut self, out: &mut impl Write) -> io::Result<()> {
        self.at = None;
        if std::mem::replace(&mut self.pen, Pen::PLAIN) != Pen::PLAIN {
            out.write_all(b"\x1b[0m")?;
        }
        Ok(())
    }
}

/// Adds the numbers of a colour; `base` is 30 for that of the character, 40 for that behind it.
fn push_colour(numbers: &mut Vec<u8>, colour: Color, base: u8) {
    let bright = base + 60;
    numbers.push(match colour {
        Color::Reset => base + 9,
        Color::Black => base,
        Color::Red => base + 1,
        Color::Green => base + 2,
        Color::Yellow => base + 3,
        Color::Blue => base + 4,
        Color::Magenta => base + 5,
        Color::Cyan => base + 6,
        Color::Gray => base + 7,
        Color::DarkGray => bright,
        Color::LightRed => bright + 1,
        Color::LightGreen => bright + 2,
        Color::LightYellow => bright + 3,
        Color::LightBlue => bright + 4,
        Color::LightMagenta => bright + 5,
        Color::LightCyan => bright + 6,
        Color::White => bright + 7,
        Color::Indexed(index) => return numbers.extend([base + 8, 5, index]),
        Color::Rgb(red, green, blue) => {
            return numbers.extend([base + 8, 2, red, green, blue]);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::layout::Rect;
    use ratatui::style::Style;

    /// Returns what is sent for the changes from a screen of ten columns to another.
    fn sent(shown: &Buffer, next: &Buffer) -> String {
        let (mut encoder, mut out) = (CellEncoder::new(), Vec::new());
        for row in shown.diff(next).chunk_by(|a, b| a.1 == b.1) {
            encoder.write_row(&mut out, shown, row).unwrap();
        }
        encoder.finish(&mut out).unwrap();
        String::from_utf8(out).unwrap().replace('\x1b', "␛")
    }

    fn screen(text: &str) -> Buffer {
        let mut buffer = Buffer::empty(Rect::new(0, 0, 10, 2));
        buffer.set_string(0, 0, text, Style::new());
        buffer
    }

    #[test]
    fn short_gap_is_sent_again_and_long_one_moved_over() {
        let shown = screen("a2345b78c");
        assert_eq!(sent(&shown, &screen("A2345B78C")), "␛[1;1HA2345B78C");
        assert_eq!(sent(&screen("a23456789c"), &screen("A23456789C")), "␛[1;1HA␛[10GC");
        assert_eq!(sent(&shown, &shown), "");
    }

    #[test]
    fn style_is_sent_where_it_changes() {
        let mut next = screen("");
        let red = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
        next.set_string(0, 0, "ab", red);
        next.set_string(2, 0, "c", Style::new().fg(Color::Indexed(9)));
        next.set_string(3, 0, "d", Style::new().bg(Color::Rgb(1, 2, 3)));
        let bytes = "␛[1;1H␛[1;31mab␛[0;38;5;9mc␛[39;48;2;1;2;3md␛[0m";
        assert_eq!(sent(&screen(""), &next), bytes);
    }

    #[test]
    fn cursor_is_placed_anew_behind_wide_characters_and_at_the_end() {
        assert_eq!(sent(&screen(""), &screen("你x")), "␛[1;1H你␛[1;3Hx");
        let mut next = screen("         x");
        next.set_string(0, 1, "y", Style::new());
        assert_eq!(sent(&screen(""), &next), "␛[1;10Hx␛[2;1Hy");
    }
}
