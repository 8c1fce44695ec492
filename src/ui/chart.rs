//! Charts of braille dots, bars of block elements, and their scales.
//!
//! Inputs: values, a size, the top of the scale. Output: text. A value above 0 has at least one dot
//! or an eighth of a cell. Does not know what the values are.

/// Blocks of one to eight eighths of a cell.
const EIGHTHS: [char; 8] = ['▏', '▎', '▍', '▌', '▋', '▊', '▉', '█'];
/// Dots of the left and of the right column of a cell, from the bottom.
const DOTS: [[u8; 4]; 2] = [[0x40, 0x04, 0x02, 0x01], [0x80, 0x20, 0x10, 0x08]];
/// Mantissas of the top of a scale.
const TOPS: [f64; 9] = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];

/// Returns the top of a scale from 0 that `most` fits in: a round number, at least `least`.
pub fn scale_top(most: f64, least: f64) -> f64 {
    if most <= least || !most.is_finite() {
        return least;
    }
    let decade = 10_f64.powf(most.log10().floor());
    let top = TOPS.iter().map(|top| top * decade).find(|top| *top >= most - 1e-9);
    let top = top.unwrap_or(10.0 * decade);
    // No half steps below 10.
    if top < 10.0 { top.ceil() } else { top }
}

/// Returns the top of a scale in at most four cells: `8`, `500`, `1.5k`.
pub fn scale_text(top: f64) -> String {
    let (top, unit) = match top {
        ..1e3 => (top, ""),
        ..1e6 => (top / 1e3, "k"),
        _ => (top / 1e6, "M"),
    };
    format!("{}{unit}", (top * 10.0).round() / 10.0)
}

/// Returns the rows of a chart, top row first, with two values in each cell; `None` leaves a mark
/// at the bottom where both values of a cell are unknown.
pub fn chart_rows(values: &[Option<f64>], rows: usize, top: f64) -> Vec<String> {
    let dots = rows * DOTS[0].len();
    let height = |value: Option<f64>| match value {
        Some(value) if value > 0.0 => ((value / top * dots as f64).round() as usize).clamp(1, dots),
        _ => 0,
    };
    let row = |row: usize| {
        let below = (rows - 1 - row) * DOTS[0].len();
        let cell = |pair: &[Option<f64>]| {
            let mut pattern = 0;
            for (value, column) in pair.iter().zip(DOTS) {
                let filled = height(*value).saturating_sub(below).min(column.len());
                pattern |= column[..filled].iter().sum::<u8>();
            }
            match pattern {
                0 if below == 0 && pair.iter().all(Option::is_none) => '·',
                0 => ' ',
                _ => char::from_u32(0x2800 + u32::from(pattern)).unwrap_or(' '),
            }
        };
        values.chunks(2).map(cell).collect()
    };
    (0..rows).map(row).collect()
}

/// Returns a bar of at most `width` cells; `part` of them, 0–1, are filled.
pub fn bar(part: f64, width: usize) -> String {
    if part <= 0.0 || width == 0 {
        return String::new();
    }
    let eighths = ((part.min(1.0) * (width * 8) as f64).round() as usize).max(1);
    let mut bar = "█".repeat(eighths / 8);
    if !eighths.is_multiple_of(8) {
        bar.push(EIGHTHS[eighths % 8 - 1]);
    }
    bar
}

/// Returns a number in groups of three digits: `5,123`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() * 4 / 3);
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Returns a rate or a percentage: two digits below 10 unless it is a whole number, else none
/// behind the point.
pub fn rounded(value: f64) -> String {
    let tenths = (value * 10.0).round() / 10.0;
    if tenths >= 10.0 || (tenths - tenths.round()).abs() < 0.05 {
        // What is not 0 is not shown as 0.
        let is_small = value > 0.0 && tenths < 0.05;
        return if is_small { "<0.1".to_owned() } else { grouped(value.round() as u64) };
    }
    format!("{tenths:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_has_a_round_top_above_its_values() {
        for (most, least, top) in [
            (0.0, 3.0, 3.0),
            (6.4, 3.0, 8.0),
            (8.1, 3.0, 10.0),
            (10.0, 3.0, 10.0),
            (11.0, 3.0, 15.0),
            (1.2, 1.0, 2.0),
            (412.0, 10.0, 500.0),
        ] {
            assert!((scale_top(most, least) - top).abs() < 1e-9, "{most}");
        }
    }

    #[test]
    fn scale_text_fits_its_cells() {
        let texts = [3.0, 8.0, 100.0, 500.0, 1500.0, 3000.0, 20_000.0, 800_000.0].map(scale_text);
        assert_eq!(texts.join(" "), "3 8 100 500 1.5k 3k 20k 800k");
    }

    #[test]
    fn chart_has_four_dots_a_row_and_two_values_a_cell() {
        let values = [Some(8.0), Some(4.0), Some(0.01), Some(0.0), None, None];
        assert_eq!(chart_rows(&values, 2, 8.0), ["⡇  ", "⣿⡀·"]);
        assert_eq!(chart_rows(&values[..2], 1, 8.0), ["⣧"]);
    }

    #[test]
    fn bar_has_eighths_and_shows_the_least() {
        assert_eq!(bar(0.5, 5), "██▌");
        assert_eq!(bar(1.0, 3), "███");
        assert_eq!((bar(0.0001, 5).as_str(), bar(0.0, 5).as_str()), ("▏", ""));
    }

    #[test]
    fn numbers_are_short_and_never_a_false_zero() {
        for (value, text) in
            [(0.0, "0"), (0.04, "<0.1"), (0.06, "0.1"), (6.0, "6"), (6.42, "6.4"), (99.6, "100")]
        {
            assert_eq!(rounded(value), text);
        }
        assert_eq!(grouped(1_234_567), "1,234,567");
    }
}
