//! What a terminal shows is the screen that was drawn last, whatever it showed before.

use crate::common::paced::Output;
use descan::shell::painted_screen::PaintedScreen;
use ratatui::style::Style;
use std::num::NonZero;
use unicode_width::UnicodeWidthChar;

const COLUMNS: u16 = 12;

/// Returns a line of wide and narrow characters that fits on the screen.
fn random_line(rng: &mut fastrand::Rng) -> String {
    let (mut line, mut width) = (String::new(), 0);
    loop {
        let letter = rng.choice(['a', 'b', ' ', 'é', '宽', '你']).unwrap();
        width += letter.width().unwrap();
        if width > usize::from(COLUMNS) {
            return line;
        }
        line.push(letter);
    }
}

#[test]
fn halves_of_wide_characters_are_drawn_again() {
    let mut rng = fastrand::Rng::with_seed(1);
    let mut screen = PaintedScreen::new(Output::default(), (COLUMNS, 2));
    let mut terminal =
        vt100::Parser::new(NonZero::new(2).unwrap(), NonZero::new(COLUMNS).unwrap(), 0);
    let mut sent = 0;
    for round in 0..1000 {
        let lines = [random_line(&mut rng), random_line(&mut rng)];
        let draw = |frame: &mut ratatui::Frame| {
            for (row, line) in (0..).zip(&lines) {
                frame.buffer_mut().set_string(0, row, line, Style::new());
            }
        };
        screen.draw_frame(draw, usize::MAX).unwrap();
        let bytes = &screen.output().0;
        terminal.process(&bytes[sent..]);
        sent = bytes.len();
        let shown: Vec<String> = terminal.screen().rows(0, COLUMNS).collect();
        let expected = lines.each_ref().map(|line| line.trim_end());
        let shown: Vec<&str> = shown.iter().map(|line| line.trim_end()).collect();
        assert_eq!(shown, expected, "round {round}");
    }
}
