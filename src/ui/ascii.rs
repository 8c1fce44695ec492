//! ASCII forms of all signs, for terminals that have no other characters. Each takes one cell, as the
//! sign does, so no layout changes; a character without a form, as in a name, is `?`.

use ratatui::buffer::Buffer;

/// First pattern of braille dots, and behind the last one.
const BRAILLE: std::ops::Range<u32> = 0x2800..0x2900;

/// Bars of a chart by the number of eighths or dots that are filled, at most 8.
const LEVELS: [&str; 9] = [" ", ".", ",", ":", ":", "=", "=", "#", "#"];

/// Replaces all characters beyond ASCII in a drawn screen.
pub fn replace(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        if !cell.symbol().is_ascii() {
            let form = form_of(cell.symbol());
            cell.set_symbol(form);
        }
    }
}

/// Returns the ASCII form of a sign.
fn form_of(symbol: &str) -> &'static str {
    let Some(c) = symbol.chars().next() else { return " " };
    match c {
        '●' => "*",
        '○' | '◇' => "o",
        '◐' | '◑' | '▒' => "%",
        '◒' => "z",
        '⚠' => "!",
        '✗' | '×' => "x",
        '≈' | '…' | '╌' | '±' => "~",
        '·' | '•' => ".",
        '–' | '—' | '−' | '─' | '═' => "-",
        '│' | '┃' | '┊' | '╷' | '╵' | '▏' | '▎' | '▍' => "|",
        '┌' | '┐' | '└' | '┘' | '├' | '┤' | '┬' | '┴' | '┼' => "+",
        '▸' | '→' | '›' => ">",
        '◂' | '←' | '‹' => "<",
        '▼' => "V",
        '✓' | '↓' | '⌄' => "v",
        '▲' | '↑' => "^",
        '↻' => "@",
        '≠' | '◆' | '▓' => "#",
        '━' | '▌' | '▋' | '▊' | '▉' => "=",
        '▁'..='█' => LEVELS[(u32::from(c) - u32::from('▁') + 1) as usize],
        '²' => "\"",
        '³' => "3",
        '¹' => "1",
        'µ' | 'μ' => "u",
        'Δ' => "d",
        '§' => "$",
        '◌' | '░' | '⋮' => ":",
        _ if BRAILLE.contains(&u32::from(c)) => {
            LEVELS[((u32::from(c) - BRAILLE.start).count_ones() as usize).min(8)]
        }
        _ => "?",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ui::SYMBOLS;

    #[test]
    fn every_sign_has_a_form_of_its_own() {
        for (_, text, meaning) in SYMBOLS {
            for c in text.chars().chain(meaning.chars()).filter(|c| !c.is_ascii()) {
                assert_ne!(form_of(&c.to_string()), "?", "{c} in {text}");
            }
        }
        for c in '▁'..='█' {
            assert_ne!(form_of(&c.to_string()), "?", "{c}");
        }
        // Signs that stand beside each other in a lane, a heartbeat strip or a column.
        for signs in ["━─╌·▓▒↻!▏", "▂▅█×·", "●◐◌◒○·⚠?", "✓✗≠…·+!"]
        {
            let mut forms: Vec<_> =
                signs
                    .chars()
                    .map(|c| {
                        if c.is_ascii() {
                            c
                        } else {
                            form_of(&c.to_string()).chars().next().unwrap()
                        }
                    })
                    .collect();
            forms.sort_unstable();
            forms.dedup();
            assert_eq!(forms.len(), signs.chars().count(), "{signs}: {forms:?}");
        }
        assert_eq!((form_of("⠀"), form_of("⣿"), form_of("温")), (" ", "#", "?"));
    }
}
