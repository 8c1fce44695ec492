//! The screen as the terminal has it: sends the cells that differ from the next one, row by row.
//!
//! Inputs: the app and a theme, the most bytes to send. Output: bytes for the terminal. A slow terminal
//! gets a screen in parts, each as of its own moment: first the rows that differ from the screen before,
//! as the effect of a key, then the rest in turn. Does not know when to draw.

use super::cell_encoder::CellEncoder;
use crate::app::App;
use crate::theme::Theme;
use crossterm::{cursor, queue, terminal};
use ratatui::Frame;
use ratatui::backend::TestBackend;
use ratatui::buffer::{Buffer, Cell};
use ratatui::layout::{Position, Rect};
use std::io::{self, Write};
use std::time::{Duration, Instant};
use unicode_width::UnicodeWidthStr;

/// Synchronised output (DEC 2026): terminals that lack it ignore it.
const SYNC_BEGIN: &[u8] = b"\x1b[?2026h";
/// End of [`SYNC_BEGIN`].
pub(super) const SYNC_END: &[u8] = b"\x1b[?2026l";

/// What was sent of a screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PaintedPart {
    /// Bytes sent.
    pub bytes: usize,
    /// Nothing is left to be sent.
    pub is_complete: bool,
    /// How long the output took them.
    pub took: Duration,
}

/// See the documentation of the module.
pub struct PaintedScreen<W> {
    /// The next screen.
    next: ratatui::Terminal<TestBackend>,
    /// What the terminal shows.
    shown: Buffer,
    /// Where the terminal shows its cursor.
    cursor: Option<Position>,
    /// Row from which on the next part is sent.
    row: u16,
    /// The last screen that was drawn, while it is sent in parts.
    last: Option<Buffer>,
    /// Rows that were changed after they were last sent or drawn first.
    new_rows: Vec<bool>,
    encoder: CellEncoder,
    /// What is sent at once.
    part: Vec<u8>,
    output: W,
}

impl<W: Write> PaintedScreen<W> {
    /// Returns a blank screen of this size, in columns and rows, with the cursor hidden.
    pub fn new(output: W, (columns, rows): (u16, u16)) -> Self {
        let Ok(next) = ratatui::Terminal::new(TestBackend::new(columns, rows));
        Self {
            next,
            shown: Buffer::empty(Rect::new(0, 0, columns, rows)),
            cursor: None,
            row: 0,
            last: None,
            new_rows: vec![false; usize::from(rows)],
            encoder: CellEncoder::new(),
            part: Vec::new(),
            output,
        }
    }

    /// Draws `app`, passes it how far its text can be scrolled, and sends about `most_bytes` of what
    /// changed: whole rows, one at least.
    ///
    /// # Errors
    /// Those of the output.
    pub fn draw(
        &mut self,
        app: &mut App,
        theme: &Theme,
        most_bytes: usize,
    ) -> io::Result<PaintedPart> {
        let mut scrolled = None;
        let part =
            self.draw_frame(|frame| scrolled = crate::ui::draw(app, theme, frame), most_bytes);
        app.handle_drawn(scrolled);
        part
    }

    /// Draws any screen, and sends about `most_bytes` of what changed.
    ///
    /// # Errors
    /// Those of the output.
    pub fn draw_frame(
        &mut self,
        draw: impl FnOnce(&mut Frame),
        most_bytes: usize,
    ) -> io::Result<PaintedPart> {
        let Ok(completed) = self.next.draw(draw);
        let changed = self.shown.diff(completed.buffer);
        let mut rows: Vec<_> = changed.chunk_by(|a, b| a.1 == b.1).collect();
        if let Some(last) = &self.last {
            for (y, is_new) in (0..).zip(&mut self.new_rows) {
                *is_new |= cells_of(last, y) != cells_of(completed.buffer, y);
            }
        }
        rows.sort_by_key(|row| {
            let y = row[0].1;
            let is_old = !self.new_rows[usize::from(y)];
            (is_old, is_old && y < self.row, y)
        });
        self.part.clear();
        if !rows.is_empty() {
            self.part.extend_from_slice(SYNC_BEGIN);
        }
        let mut cells = Vec::new();
        let mut sent = 0;
        for row in &rows {
            if sent > 0 && self.part.len() >= most_bytes {
                break;
            }
            self.encoder.write_row(&mut self.part, &self.shown, row)?;
            cells.extend(row.iter().map(|(x, y, cell)| (*x, *y, (*cell).clone())));
            if !std::mem::take(&mut self.new_rows[usize::from(row[0].1)]) {
                self.row = row[0].1 + 1;
            }
            sent += 1;
        }
        let is_complete = sent == rows.len();
        if is_complete {
            self.row = 0;
            self.last = None;
            self.new_rows.fill(false);
        } else {
            self.last = Some(completed.buffer.clone());
        }
        for (x, y, cell) in cells {
            // The other half of a wide character is not among the cells.
            let end = x.saturating_add(cell.symbol().width() as u16).min(self.shown.area.width);
            for half in x + 1..end {
                self.shown[(half, y)].reset();
            }
            self.shown[(x, y)] = cell;
        }
        self.encoder.finish(&mut self.part)?;
        self.place_cursor(sent > 0)?;
        if sent > 0 {
            self.part.extend_from_slice(SYNC_END);
        }
        let start = Instant::now();
        self.output.write_all(&self.part)?;
        self.output.flush()?;
        Ok(PaintedPart { bytes: self.part.len(), is_complete, took: start.elapsed() })
    }

    fn place_cursor(&mut self, has_moved: bool) -> io::Result<()> {
        let memory = self.next.backend();
        let wanted = memory.cursor_visible().then(|| memory.cursor_position());
        let was = std::mem::replace(&mut self.cursor, wanted);
        if let Some(at) = wanted.filter(|_| has_moved || was != wanted) {
            queue!(self.part, cursor::MoveTo(at.x, at.y))?;
        }
        match (was, wanted) {
            (Some(_), None) => queue!(self.part, cursor::Hide),
            (None, Some(_)) => queue!(self.part, cursor::Show),
            _ => Ok(()),
        }
    }

    /// Columns and rows.
    pub fn size(&self) -> (u16, u16) {
        (self.shown.area.width, self.shown.area.height)
    }

    /// Sets the size in columns and rows; the next draw sends the whole screen.
    ///
    /// # Errors
    /// Those of the output.
    pub fn resize(&mut self, (columns, rows): (u16, u16)) -> io::Result<()> {
        self.next.backend_mut().resize(columns, rows);
        self.shown = Buffer::empty(Rect::new(0, 0, columns, rows));
        self.row = 0;
        self.last = None;
        self.new_rows = vec![false; usize::from(rows)];
        queue!(self.output, terminal::Clear(terminal::ClearType::All))
    }

    /// Writes a terminal command, such as the bell.
    ///
    /// # Errors
    /// Those of the output.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.output.write_all(bytes)?;
        self.output.flush()
    }

    /// The output.
    pub fn output(&self) -> &W {
        &self.output
    }
}

/// The cells of a row.
fn cells_of(buffer: &Buffer, row: u16) -> &[Cell] {
    let width = usize::from(buffer.area.width);
    let start = usize::from(row) * width;
    buffer.content.get(start..start + width).unwrap_or_default()
}
