//! The terminal: taken over at the start and restored on every way out.

use super::console::{self, terminal_name};
use super::painted_screen::{PaintedPart, PaintedScreen, SYNC_END};
use super::signals::stop_process;
use crate::app::Signs;
use crate::theme::Theme;
use crossterm::{cursor, event, execute, queue, style, terminal};
use std::io::{self, Stdout, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Keeps the title of the window, and gives it back (XTWINOPS); terminals without them ignore it.
const KEEP_TITLE: &str = "\x1b[22;2t";
const OLD_TITLE: &str = "\x1b[23;2t";

/// Speed of terminals that are no line, by default of the kernel.
const NO_LINE_BAUD: u32 = 38_400;

static TAKEN: AtomicBool = AtomicBool::new(false);

/// Standard output while the terminal is taken over; later output is discarded.
struct TerminalOutput(Stdout);

impl Write for TerminalOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if TAKEN.load(Ordering::SeqCst) { self.0.write(bytes) } else { Ok(bytes.len()) }
    }

    fn flush(&mut self) -> io::Result<()> {
        if TAKEN.load(Ordering::SeqCst) { self.0.flush() } else { Ok(()) }
    }
}

/// The terminal while descan uses it. Dropping it restores the terminal.
pub struct Terminal {
    screen: PaintedScreen<TerminalOutput>,
    title: String,
}

impl Terminal {
    /// Takes the terminal over: raw mode, the alternate screen, mouse and paste reports.
    pub fn enter() -> io::Result<Self> {
        // crossterm drops the attributes of reversed and bold cells under NO_COLOR; the theme
        // `mono` implements NO_COLOR instead.
        style::force_color_output(true);
        enter()?;
        let size = terminal::size().inspect_err(|_| restore())?;
        let screen = PaintedScreen::new(TerminalOutput(io::stdout()), size);
        Ok(Self { screen, title: String::new() })
    }

    /// Columns and rows.
    pub fn size(&self) -> io::Result<(u16, u16)> {
        terminal::size()
    }

    /// Draws `app`, passes it how far its text can be scrolled, and sends about `most_bytes` of what
    /// changed.
    pub fn draw(
        &mut self,
        app: &mut crate::app::App,
        theme: &Theme,
        most_bytes: usize,
    ) -> io::Result<PaintedPart> {
        self.screen.draw(app, theme, most_bytes)
    }

    /// Draws a screen that is not the app's, and sends about `most_bytes` of what changed.
    pub fn draw_frame(
        &mut self,
        draw: impl FnOnce(&mut ratatui::Frame),
        most_bytes: usize,
    ) -> io::Result<PaintedPart> {
        let size = terminal::size()?;
        if self.screen.size() != size {
            self.screen.resize(size)?;
        }
        self.screen.draw_frame(draw, most_bytes)
    }

    /// Sets the title of the window, where it changed.
    pub fn set_title(&mut self, title: String) -> io::Result<()> {
        if self.title == title || !has_title() {
            return Ok(());
        }
        self.write(format!("\x1b]2;{title}\x1b\\").as_bytes())?;
        self.title = title;
        Ok(())
    }

    /// Makes the next draw write the whole screen.
    pub fn redraw(&mut self) -> io::Result<()> {
        self.screen.resize(terminal::size()?)
    }

    /// Writes a terminal command, such as the bell.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.screen.write(bytes)
    }

    /// Puts text into the user's clipboard (OSC 52), if the terminal allows it.
    pub fn copy(&mut self, text: &str) -> io::Result<()> {
        let mut command = Vec::new();
        queue!(command, crossterm::clipboard::CopyToClipboard::to_clipboard_from(text))?;
        self.screen.write(&command)
    }

    /// Restores the terminal, stops this process as Ctrl-Z does, and takes the terminal over again
    /// when it continues.
    pub fn suspend(&mut self) -> io::Result<()> {
        restore();
        stop_process()?;
        enter()?;
        self.title.clear();
        self.redraw()
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        restore();
    }
}

fn enter() -> io::Result<()> {
    terminal::enable_raw_mode()?;
    TAKEN.store(true, Ordering::SeqCst);
    let mut out = io::stdout().lock();
    queue!(out, terminal::EnterAlternateScreen, event::EnableBracketedPaste)
        .and_then(|()| console::enable_mouse(&mut out))
        .and_then(|()| execute!(out, style::Print(KEEP_TITLE), cursor::Hide))
        .inspect_err(|_| restore())
}

/// Restores the terminal, in any state. Does nothing if it is not taken over.
pub fn restore() {
    if !TAKEN.swap(false, Ordering::SeqCst) {
        return;
    }
    // First: another thread may be blocked while it writes to a terminal that is not read.
    let _ = terminal::disable_raw_mode();
    let mut out = io::stdout().lock();
    // Each step is tried, even if an earlier one fails on a closed terminal.
    let _ = out.write_all(SYNC_END);
    let _ = console::disable_mouse(&mut out);
    let _ = queue!(out, event::DisableBracketedPaste);
    let _ = queue!(out, style::Print(OLD_TITLE));
    // Cleared, with the cursor at the end: if the window grew in the meantime, tmux copies lines of
    // this screen to the other one.
    let _ = queue!(out, style::ResetColor, terminal::Clear(terminal::ClearType::All));
    let _ = queue!(out, cursor::MoveTo(0, 998), terminal::LeaveAlternateScreen, cursor::Show);
    let _ = out.flush();
}

/// Returns the signs that the terminal can show, by its environment variables.
pub fn signs() -> Signs {
    Signs::of_terminal(&terminal_name(), console::locale().as_deref())
}

/// Returns the bytes per second of the line to the terminal, where it is known to be slow: a serial line,
/// or a connection to a machine that has one, which passes its speed on.
pub fn line_rate() -> Option<f64> {
    let baud = console::line_speed()?;
    // A start bit, eight bits, one or two stop bits.
    (1..NO_LINE_BAUD).contains(&baud).then(|| f64::from(baud) / 11.0)
}

/// Returns true if the terminal may be asked for its background: an emulator, which ignores what it
/// does not know, and not at the end of a serial line, where a real one may be.
pub fn tells_background() -> bool {
    let terminal = terminal_name();
    has_title() && !terminal.is_empty() && !terminal.starts_with("vt") && line_rate().is_none()
}

/// Returns false for the console of Linux, which has no window and may print the title.
fn has_title() -> bool {
    !matches!(terminal_name().as_str(), "" | "linux" | "dumb")
}

/// Returns true if the other end of the terminal is closed, as after a lost connection.
pub fn is_lost() -> bool {
    console::is_output_closed()
}

/// Makes a panic restore the terminal before it is reported.
pub fn restore_on_panic() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        restore();
        report(panic);
    }));
}
