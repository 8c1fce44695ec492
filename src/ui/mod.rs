//! Draws [`App`]: one file per region of the screen.
//!
//! ```text
//!  can0 125k active  load  37% ▁▂▃▅▂  412 f/s  err 0  lost 0  me 0    status.rs
//!  des.json ✓ 12 entries         ● 14 present  ○ 1 missing  ⚠ 2  ? 1
//! ─ 1 Devices ─ 2 Traffic ─ 3 Timeline ─ 4 Problems 2 ┬─ FEED @12 ──   tabs.rs
//!    ADDR  NAME   STATE   MODE    SVC   AGE   FILE    │ online 3m12s   devices.rs │ details.rs
//! ▸  12   FEED   online  WORK      4    0s   ✓ 12     │ …              (or traffic.rs,
//!    13   SENS   online  WORK      3    0s   + new    │                 timeline.rs,
//! ⚠  14   ACT    CONFLICT WORK     ?    0s   ✗ 16     │                 problems.rs)
//! ─ latest ───────────────────────────────────────────┴─────────────   timeline.rs
//!  12:03:11  ACT @14  collision confirmed: …
//!  e edit address  a add to file  u undo  r rescan  …        ? help    footer.rs
//! ```
//!
//! The help (`help.rs`) and a conflict (`conflict.rs`) take the place of the page.
//!
//! Reads, never changes; no state survives a draw. Colours only by [`Role`]. What devices say
//! comes here as [`crate::text::Name`] or as text the app made of it, never as bytes.
//! Where the regions are is [`crate::app::Screen`]'s.

mod brush;
mod conflict;
mod details;
mod devices;
mod footer;
mod help;
mod problems;
mod signs;
mod status;
mod tabs;
mod timeline;
mod traffic;

use crate::app::{App, Overlay, Page};
use crate::theme::{Role, Theme};
use brush::Brush;
use ratatui::Frame;

pub use signs::SIGNS;

/// Draws all of it. Comes back with how far the text that scrolls (details, help) is scrolled,
/// where there is one: not past its end, which is known only here.
pub fn draw(app: &App, theme: &Theme, frame: &mut Frame) -> Option<u16> {
    let area = frame.area();
    let mut screen = app.screen();
    if screen.whole != area {
        // The terminal was resized and the app was not told yet: the next draw will fit.
        screen = crate::app::Screen::default();
    }
    let mut brush =
        Brush { app, theme, screen, buffer: frame.buffer_mut(), cursor: None, scrolled: None };
    brush.buffer.set_style(area, theme.style(Role::Text));
    status::draw(&mut brush);
    match app.overlay() {
        Overlay::Help(scroll) => help::draw(&mut brush, *scroll),
        Overlay::Conflict => conflict::draw(&mut brush),
        _ => page(&mut brush),
    }
    footer::draw(&mut brush);
    let (cursor, scrolled) = (brush.cursor, brush.scrolled);
    if let Some(cursor) = cursor {
        frame.set_cursor_position(cursor);
    }
    scrolled
}

fn page(brush: &mut Brush) {
    tabs::draw(brush);
    match brush.app.view().page {
        Page::Devices => {
            devices::draw(brush);
            details::draw(brush);
            timeline::draw_latest(brush);
        }
        Page::Traffic => traffic::draw(brush),
        Page::Timeline => timeline::draw(brush),
        Page::Problems => problems::draw(brush),
    }
}
