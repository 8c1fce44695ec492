//! A terminal in memory that is drawn at the pace of the program, and counts the bytes it gets.

use descan::app::App;
use descan::shell::paint_pace::{PaintPace, SCREEN_BUDGET};
use descan::shell::painted_screen::PaintedScreen;
use descan::theme::Theme;
use descan::time::{Duration, Instant};
use std::io::{self, Write};

/// The bytes of a terminal.
#[derive(Default)]
pub struct Output(pub Vec<u8>);

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

pub struct PacedScreen {
    pub screen: PaintedScreen<Output>,
    pub pace: PaintPace,
    pub bytes: usize,
    pub draws: usize,
}

impl PacedScreen {
    pub fn new(columns: u16, rows: u16) -> Self {
        Self::with(PaintPace::new(SCREEN_BUDGET, None), columns, rows)
    }

    pub fn with(pace: PaintPace, columns: u16, rows: u16) -> Self {
        let screen = PaintedScreen::new(Output::default(), (columns, rows));
        Self { screen, pace, bytes: 0, draws: 0 }
    }

    /// Draws if the program would.
    pub fn paint(&mut self, now: Instant, app: &mut App, theme: &Theme) {
        if self.pace.due() > now || !(app.is_dirty() || self.pace.is_partial()) {
            return;
        }
        self.draw(now, app, theme);
    }

    /// Draws.
    pub fn draw(&mut self, now: Instant, app: &mut App, theme: &Theme) {
        if self.pace.is_renewed() {
            app.take_dirty();
        }
        let part = self.screen.draw(app, theme, self.pace.most_bytes()).expect("written to memory");
        self.pace.drawn(now, part.bytes, Duration::ZERO, part.is_complete);
        self.bytes += part.bytes;
        self.draws += 1;
    }
}
