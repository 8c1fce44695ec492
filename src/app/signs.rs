//! Signs that the terminal can show.

/// Characters for signs and charts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Signs {
    /// Any character: for terminals with UTF-8 and a font that has them.
    #[default]
    Unicode,
    /// ASCII alone: for the console of Linux and for other character sets.
    Ascii,
}

impl Signs {
    /// Returns the signs for a terminal by the values of `TERM` and of its locale; an unset locale
    /// says nothing.
    pub fn of_terminal(terminal: &str, locale: Option<&str>) -> Self {
        let locale = locale.unwrap_or("UTF-8").to_ascii_lowercase();
        let is_utf8 = locale.contains("utf-8") || locale.contains("utf8");
        if terminal == "linux" || !is_utf8 { Self::Ascii } else { Self::Unicode }
    }

    /// Returns the signs with this name in `config.toml`; `None` for an unknown name.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "unicode" => Some(Self::Unicode),
            "ascii" => Some(Self::Ascii),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_follow_terminal_and_locale() {
        for (terminal, locale, signs) in [
            ("xterm", Some("de_DE.UTF-8"), Signs::Unicode),
            ("xterm", Some("C.utf8"), Signs::Unicode),
            ("xterm", None, Signs::Unicode),
            ("linux", Some("de_DE.UTF-8"), Signs::Ascii),
            ("xterm", Some("C"), Signs::Ascii),
            ("xterm", Some("ru_RU.KOI8-R"), Signs::Ascii),
        ] {
            assert_eq!(Signs::of_terminal(terminal, locale), signs, "{terminal} {locale:?}");
        }
    }
}
