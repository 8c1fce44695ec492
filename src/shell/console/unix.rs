//! A terminal of Unix, by termios and poll(2).

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{FlushArg, tcflush};
use std::io::{self, Write};
use std::os::fd::AsFd as _;

/// The kind of terminal, as in TERM; empty if it is not known.
pub fn terminal_name() -> String {
    std::env::var("TERM").unwrap_or_default()
}

/// The name of the locale: its end is the encoding of text.
pub fn locale() -> Option<String> {
    let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().find_map(variable)
}

/// Bit/s of the line to the terminal; `None` without a terminal.
pub fn line_speed() -> Option<u32> {
    Some(rustix::termios::tcgetattr(io::stdout()).ok()?.output_speed())
}

/// Width of the terminal at standard output; 0 if it is not known.
pub fn columns() -> usize {
    rustix::termios::tcgetwinsize(io::stdout()).map_or(0, |size| usize::from(size.ws_col))
}

/// Discards what was typed and not read yet.
pub fn discard_typed() {
    let _ = tcflush(io::stdin(), FlushArg::TCIFLUSH);
}

/// Returns true if the other end of standard output is closed.
pub fn is_output_closed() -> bool {
    let stdout = io::stdout();
    // No events requested: poll(2) reports errors and hang-up only.
    let mut watched = [PollFd::new(stdout.as_fd(), PollFlags::empty())];
    poll(&mut watched, PollTimeout::ZERO).is_ok_and(|count| count > 0)
}

/// Waits until the other end of standard output is closed, as far as the system reports it.
pub fn wait_until_output_closed() {
    let stdout = io::stdout();
    // No events requested: poll(2) returns on errors and hang-up only.
    let mut watched = [PollFd::new(stdout.as_fd(), PollFlags::empty())];
    while poll(&mut watched, PollTimeout::NONE) == Err(Errno::EINTR) {}
}

/// Makes the terminal report buttons and wheel, in SGR coordinates; no any-motion reports, which cost
/// bandwidth over SSH.
///
/// # Errors
/// The terminal cannot be written.
pub fn enable_mouse(out: &mut impl Write) -> io::Result<()> {
    out.write_all(b"\x1b[?1000h\x1b[?1002h\x1b[?1006h")
}

/// Ends these reports.
///
/// # Errors
/// The terminal cannot be written.
pub fn disable_mouse(out: &mut impl Write) -> io::Result<()> {
    out.write_all(b"\x1b[?1006l\x1b[?1002l\x1b[?1000l")
}
