//! Pictures of the demo for the README: the real screen at fixed moments, drawn as SVG.
//!
//! Fails if a picture differs from the screen. `UPDATE_PICTURES=1 cargo test --test it pictures`
//! redraws them.

use crate::common::harness::Stage;
use descan::frame::BusIndex;
use descan::sim::Scenario;
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};
use std::fmt::Write as _;
use std::path::Path;
use unicode_width::UnicodeWidthStr;

/// The des.json of `descan demo`.
const DEMO_FILE: &str = include_str!("../../src/commands/demo/boiler.json");

/// Width and height of a cell in units of the picture; a monospaced font advances by 0.6 em.
const CELL: (f32, f32) = (8.4, 18.0);
const FONT_SIZE: f32 = 14.0;
/// Blank border around the screen.
const MARGIN: f32 = 8.0;
/// Foreground and background of the theme `dark`.
const INK: &str = "#d4d9e1";
const PAPER: &str = "#1c1f24";

#[test]
fn conflict_picture_matches_screen() {
    let mut stage = demo(100, 26);
    stage.until(45.0).keys("4 p 1");
    assert_picture("conflict", &stage);
}

#[test]
fn evidence_picture_matches_screen() {
    let mut stage = demo(100, 20);
    stage.until(45.0).keys("4 f");
    assert_picture("evidence", &stage);
}

#[test]
fn timeline_picture_matches_screen() {
    let mut stage = demo(100, 22);
    stage.until(110.0).keys("3");
    assert_picture("timeline", &stage);
}

#[test]
fn edit_picture_matches_screen() {
    let mut stage = demo(100, 22);
    stage.until(24.0).keys("j j j j j e").text("12");
    assert_picture("edit", &stage);
}

#[test]
fn bus_picture_matches_screen() {
    let mut stage = demo(100, 28);
    stage.until(170.0).keys("5");
    assert_picture("bus", &stage);
}

/// `descan demo` on a screen of this size.
fn demo(columns: u16, rows: u16) -> Stage {
    let mut stage = Stage::new(&Scenario::builtin("boiler").unwrap(), Some(DEMO_FILE));
    stage.app.name_bus(BusIndex(0), "sim:boiler".to_owned());
    stage.size(columns, rows);
    stage
}

/// Compares the screen with `tests/pictures/NAME.svg`, or writes it.
fn assert_picture(name: &str, stage: &Stage) {
    let picture = svg(&stage.buffer("dark"));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/pictures").join(name);
    let path = path.with_extension("svg");
    if std::env::var_os("UPDATE_PICTURES").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, picture).unwrap();
        return;
    }
    let drawn = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        drawn == picture,
        "tests/pictures/{name}.svg is out of date: UPDATE_PICTURES=1 cargo test --test it pictures"
    );
}

/// Returns the buffer as an SVG document: a rectangle for each coloured background, a text for each
/// run of cells of one style, so that columns stay aligned in any monospaced font.
fn svg(buffer: &Buffer) -> String {
    let columns = usize::from(buffer.area.width);
    let (width, height) = (
        f32::from(buffer.area.width) * CELL.0 + 2.0 * MARGIN,
        f32::from(buffer.area.height) * CELL.1 + 2.0 * MARGIN,
    );
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\" font-size=\"{FONT_SIZE}\" \
         font-family=\"'DejaVu Sans Mono', Menlo, Consolas, monospace\" fill=\"{INK}\">\n\
         <rect width=\"100%\" height=\"100%\" rx=\"6\" fill=\"{PAPER}\"/>\n"
    );
    for (row, cells) in buffer.content().chunks(columns).enumerate() {
        let y = MARGIN + row as f32 * CELL.1;
        let mut at = 0;
        while at < columns {
            let end = run_end(cells, at);
            write_run(&mut svg, &cells[at..end], MARGIN + at as f32 * CELL.0, y);
            at = end;
        }
    }
    svg.push_str("</svg>\n");
    svg
}

/// Returns the end of the run that begins at `at`: cells of one style, all ASCII or all the same
/// sign.
fn run_end(cells: &[Cell], at: usize) -> usize {
    let first = &cells[at];
    if !first.symbol().is_ascii() && first.symbol().width() > 1 {
        return (at + first.symbol().width()).min(cells.len());
    }
    let belongs = |cell: &Cell| {
        let same_kind = if first.symbol().is_ascii() {
            cell.symbol().is_ascii()
        } else {
            cell.symbol() == first.symbol()
        };
        same_kind && cell.style() == first.style()
    };
    at + cells[at..].iter().take_while(|cell| belongs(cell)).count()
}

fn write_run(svg: &mut String, cells: &[Cell], x: f32, y: f32) {
    let first = &cells[0];
    let (mut ink, mut paper) = (colour(first.fg, INK), colour(first.bg, PAPER));
    if first.modifier.contains(Modifier::REVERSED) {
        std::mem::swap(&mut ink, &mut paper);
    }
    let width = cells.len() as f32 * CELL.0;
    if paper != PAPER {
        let height = CELL.1;
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             fill=\"{paper}\"/>"
        );
    }
    let text: String = cells.iter().map(Cell::symbol).collect();
    if text.trim().is_empty() {
        return;
    }
    let mut attributes = String::new();
    if ink != INK {
        let _ = write!(attributes, " fill=\"{ink}\"");
    }
    if first.modifier.contains(Modifier::BOLD) {
        attributes.push_str(" font-weight=\"bold\"");
    }
    if first.modifier.contains(Modifier::UNDERLINED) {
        attributes.push_str(" text-decoration=\"underline\"");
    }
    // Leading and trailing blanks need no text.
    let lead = text.len() - text.trim_start().len();
    let text = text.trim();
    let (x, baseline) = (x + lead as f32 * CELL.0, y + CELL.1 * 0.74);
    let length = text.width() as f32 * CELL.0;
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let _ = writeln!(
        svg,
        "<text x=\"{x:.1}\" y=\"{baseline:.1}\" textLength=\"{length:.1}\" \
         lengthAdjust=\"spacingAndGlyphs\" xml:space=\"preserve\"{attributes}>{text}</text>"
    );
}

/// Returns a colour of the theme in SVG notation.
fn colour(colour: Color, reset: &str) -> String {
    match colour {
        Color::Reset => reset.to_owned(),
        Color::Rgb(red, green, blue) => format!("#{red:02x}{green:02x}{blue:02x}"),
        other => panic!("the theme dark names its colours as #rrggbb, not {other}"),
    }
}
