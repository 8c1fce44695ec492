//! Themes: an input is the text of a theme, and behind a zero byte that of another one, which is
//! found as `other`.

use super::{Target, assert_line};
use descan::theme::{Colours, Role, Theme};
use ratatui::style::Color;

/// Target `theme`.
pub const THEME: Target = Target {
    name: "theme",
    check: |input| {
        let Ok(texts) = str::from_utf8(input) else { return };
        let (text, other) = texts.split_once('\0').unwrap_or((texts, ""));
        let find = |name: &str| match name {
            "mine" => Some(text.to_owned()),
            "other" => Some(other.to_owned()),
            _ => None,
        };
        match Theme::parse("mine", text, find) {
            Ok(theme) => check_colours(&theme),
            Err(error) => assert_line(text, error.line),
        }
    },
    words: &[
        b"inherits = \"other\"\n",
        b"inherits = \"mine\"\n",
        b"inherits = \"dark\"\n",
        b"[palette]\n",
        b"[roles]\n",
        b"amber = \"#ffaf5f\"\n",
        b"warning = \"amber\"\n",
        b"selected = { bg = \"#303030\", bold = true }\n",
        b"text = 208\n",
        b"\0",
        b"\"default\"",
        b"\"bright-red\"",
        b"\"#+12345\"",
        b"0xFF",
        b"0o17",
        b"1_0",
        b"-1",
        b"256",
        b"underline",
        b"reverse",
    ],
};

/// Asserts that a theme reduced to the colours of a terminal has no others.
fn check_colours(theme: &Theme) {
    for colours in [Colours::Sixteen, Colours::Indexed, Colours::Full] {
        let theme = theme.clone().limited(colours);
        for role in Role::ALL {
            let style = theme.style(*role);
            for colour in [style.fg, style.bg].into_iter().flatten() {
                let is_available = match colour {
                    Color::Rgb(..) => colours == Colours::Full,
                    Color::Indexed(_) => colours != Colours::Sixteen,
                    _ => true,
                };
                assert!(is_available, "{role:?}: {colour:?} of {colours:?}");
            }
        }
    }
}
