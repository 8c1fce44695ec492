//! Draws [`App`] into the cells of a terminal: one file per region of the screen. At 80 columns:
//!
//! ```text
//!  can0 125k  active  load   7% ⣶⣶⣶⣾⣾⣿⣿⣿ 5–8%    err 0  lost 0  own 0             status.rs
//!  des.json ✓ 6 entries                              ● 4 present  ○ 1 missing  ⚠ 2
//!  1 Devices  2 Traffic  3 Timeline  4 Problems 2 ─┬─ FEED @10 ───────────────────  tabs.rs
//!    ADDR NAME       STATE    MODE  SVC  AGE FILE  │ online 3m12s                   devices.rs
//! ▸●   10 FEED       online   WORK   5≠   0s ✓ 10  │                                │ details.rs
//!  ●   13 SENS       online   WORK    5   0s + new │ heartbeat 1.00 s ±0 ms
//!  ⚠   14 ACT        CONFLICT WORK    4   0s ✓ 14  │ mode      WORK                 or traffic.rs,
//!  ○   17 IGNITER    missing                 ✗ 17  │ UID       BOILER01             stories.rs,
//!  ●   30 PSU        online   WORK    3   0s   30  │ framing   isotp                problems.rs
//! ─ latest ────────────────────────────────────────┴──────────────────────────────  timeline.rs
//!  12:03:11 ⚠ ACT @14      confirmed: Two devices answer as ACT at address 14.
//!  ? help  q quit  e edit address  a add to file  r rescan  / filter  u undo        footer.rs
//! ```
//!
//! The help (`help.rs`), an edit conflict (`conflict.rs`), the marks (`marks.rs`) and a comparison
//! (`comparison.rs`), the plan (`plan.rs`) take the place of the page. The regions are computed by
//! [`crate::app::Screen`].
//!
//! Inputs: the app, read only, and a theme. Output: cells, and the limit of the scrolled text. No
//! state survives a draw. Colours only by [`Role`]. Bytes that devices send arrive here escaped: as
//! [`crate::text::Name`], or as text made by the app.

mod alarm;
mod ascii;
mod brush;
mod bus;
mod bus_choice;
mod chart;
mod comparison;
mod composer;
mod conflict;
mod details;
mod devices;
mod fleet;
mod footer;
mod help;
mod lanes;
mod marks;
mod moment;
mod plan;
mod problems;
mod profile;
mod saved_filters;
mod status;
mod stories;
mod story_kinds;
mod symbols;
mod tabs;
mod theme_picker;
mod time_bar;
mod timeline;
mod traffic;

use crate::app::{App, Overlay, Page, Question, Signs};
use crate::text::with_few_marks;
use crate::theme::{Role, Theme};
use brush::DrawContext;
use ratatui::Frame;
use ratatui::buffer::Buffer;

pub use bus_choice::draw_choice;
pub use fleet::draw_fleet;
pub use symbols::SYMBOLS;

/// Draws the whole screen. Returns the lines by which the scrolled text (details, help) is
/// scrolled, limited to its end; `None` if the screen has none. The app stores it, since the length
/// of wrapped text is known only after drawing.
pub fn draw(app: &App, theme: &Theme, frame: &mut Frame) -> Option<u16> {
    if let Some(choice) = app.bus_choice() {
        draw_choice(choice, app.alarm(), theme, app.signs(), frame);
        return None;
    }
    let area = frame.area();
    let mut screen = app.screen();
    if screen.whole != area {
        // The event of a resize is still in the queue: draw nothing but the background.
        screen = crate::app::Screen::default();
    }
    let mut brush = DrawContext {
        app,
        theme,
        screen,
        buffer: frame.buffer_mut(),
        cursor: None,
        scrolled: None,
        panel_title: 0,
    };
    brush.fill(area, Role::Background);
    brush.fill(area, Role::Text);
    status::draw(&mut brush);
    alarm::draw(&mut brush);
    match app.overlay() {
        Overlay::Help(scroll) => help::draw(&mut brush, *scroll),
        Overlay::Conflict => conflict::draw(&mut brush),
        Overlay::Marks(selected) => marks::draw(&mut brush, *selected),
        Overlay::Filters(selected) => saved_filters::draw(&mut brush, *selected),
        Overlay::Comparison => comparison::draw(&mut brush),
        Overlay::Profile => profile::draw(&mut brush),
        Overlay::Plan | Overlay::Question(Question::Plan) => plan::draw(&mut brush),
        _ if app.composer_dialog().is_some() => composer::draw(&mut brush),
        Overlay::Kinds(selected) => {
            page(&mut brush);
            story_kinds::draw(&mut brush, *selected);
        }
        Overlay::Themes(selected) => {
            page(&mut brush);
            theme_picker::draw(&mut brush, *selected);
        }
        _ => page(&mut brush),
    }
    moment::draw(&mut brush);
    time_bar::draw(&mut brush);
    footer::draw(&mut brush);
    cut_marks(brush.buffer);
    if app.signs() == Signs::Ascii {
        ascii::replace(brush.buffer);
    }
    let (cursor, scrolled) = (brush.cursor, brush.scrolled);
    if let Some(cursor) = cursor {
        frame.set_cursor_position(cursor);
    }
    scrolled
}

/// Cuts cells with many combining marks, as of a device's name: a cell takes any number of them.
fn cut_marks(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        let short = with_few_marks(cell.symbol());
        if short.len() < cell.symbol().len() {
            let short = short.to_owned();
            cell.set_symbol(&short);
        }
    }
}

fn page(brush: &mut DrawContext) {
    tabs::draw(brush);
    if !plan::draw_banner(brush) {
        profile::draw_banner(brush);
    }
    match brush.app.view().page {
        Page::Devices => {
            devices::draw(brush);
            details::draw(brush);
            timeline::draw_latest(brush);
        }
        Page::Traffic => traffic::draw(brush),
        Page::Timeline => stories::draw(brush),
        Page::Problems => problems::draw(brush),
        Page::Bus => bus::draw(brush),
    }
}
