//! The console of Windows 10 and later, which knows the escape sequences of xterm.

use crossterm::event::{DisableMouseCapture, EnableMouseCapture};
use crossterm::execute;
use std::io::{self, Write};

/// The kind of terminal: that of TERM, as in MSYS2, or one like xterm.
pub fn terminal_name() -> String {
    std::env::var("TERM").unwrap_or_else(|_| "xterm-256color".to_owned())
}

/// The name of the locale: the console takes UTF-8.
pub fn locale() -> Option<String> {
    Some("C.UTF-8".to_owned())
}

/// Bit/s of the line to the terminal: there is none.
pub fn line_speed() -> Option<u32> {
    None
}

/// Width of the terminal at standard output; 0 if it is not known.
pub fn columns() -> usize {
    crossterm::terminal::size().map_or(0, |(columns, _)| usize::from(columns))
}

/// Does nothing: what was typed before a question stays.
pub fn discard_typed() {}

/// Returns false: the next write notices it.
pub fn is_output_closed() -> bool {
    false
}

/// Waits for ever: the next write notices that the output is closed.
pub fn wait_until_output_closed() {
    loop {
        std::thread::park();
    }
}

/// Makes the console report the mouse.
///
/// # Errors
/// There is no console.
pub fn enable_mouse(out: &mut impl Write) -> io::Result<()> {
    execute!(out, EnableMouseCapture)
}

/// Ends these reports.
///
/// # Errors
/// There is no console.
pub fn disable_mouse(out: &mut impl Write) -> io::Result<()> {
    execute!(out, DisableMouseCapture)
}
