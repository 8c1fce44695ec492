//! Themes: a style for each [`Role`], the meaning of a text on the screen. Input: TOML, of the five
//! built-in themes or of a user's file:
//!
//! ```toml
//! inherits = "dark"
//! [palette]
//! amber = "#ffaf5f"
//! [roles]
//! warning = "amber"
//! selected = { bg = "#303030", bold = true }
//! ```
//!
//! A role that a theme does not name has the style of the theme it inherits from, by default
//! `terminal`. A role given as a colour alone has that foreground and no attributes. Colours are
//! reduced to those of the terminal by [`Theme::limited`].
//!
//! Does not know what is drawn, nor where theme files are kept.

use ratatui::style::{Color, Modifier, Style};
use std::fmt;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

macro_rules! roles {
    ($($variant:ident $name:literal $doc:literal,)*) => {
        /// The meaning of a text on the screen.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Role { $(#[doc = $doc] $variant,)* }

        impl Role {
            /// All roles, in the order of the guide.
            pub const ALL: &[Role] = &[$(Role::$variant),*];

            /// Name in theme files.
            pub const fn name(self) -> &'static str {
                match self { $(Role::$variant => $name,)* }
            }

            /// What the role is used for, as `descan help settings` prints it.
            pub const fn doc(self) -> &'static str {
                match self { $(Role::$variant => $doc,)* }
            }
        }
    };
}

roles! {
    Background "background" "The whole screen; only the background counts.",
    Text "text" "Ordinary text.",
    Muted "muted" "Secondary text: labels, units, old values.",
    Title "title" "Headings, names of buses and of the file.",
    Tab "tab" "Names of the pages that are not open.",
    TabActive "tab_active" "Name of the open page or dialog.",
    Border "border" "Lines between the regions of the screen.",
    BorderFocus "border_focus" "The same around the region that has the focus.",
    Header "header" "Column headings.",
    Selected "selected" "The selected row, on top of its other styles.",
    Alarm "alarm" "The line of a confirmed conflict, whole width.",
    Frozen "frozen" "First line, page rule and time bar of a past moment.",
    Online "online" "Online devices, a bus that works.",
    Stale "stale" "Devices with an overdue heartbeat; partial.",
    Silent "silent" "Devices that send frames but no heartbeats.",
    Asleep "asleep" "Devices that are asleep.",
    Lost "lost" "Lost devices.",
    Missing "missing" "Devices listed in the file but not on the bus.",
    Confirmed "collision" "Confirmed problems, such as address conflicts.",
    Suspected "suspected" "Suspected problems, assumed values.",
    FileOk "file_ok" "Entries that match the bus.",
    FileDiffers "file_differs" "Entries and services that differ from the bus.",
    New "new" "Devices that are not in the file; remedies.",
    Input "input" "Text typed into a prompt.",
    Error "error" "Errors: an interface that is down, lost frames.",
    Warning "warning" "Warnings: listen-only, FROZEN, unsaved edits.",
    HintKey "hint_key" "Keys in the last line and in the help; filter terms.",
    Bar "bar" "Bars of the bus load.",
    Graph "graph" "Charts of load and frame rate; bars of the page Bus.",
    Graph2 "graph_2" "Chart of the error rate.",
    Recording "recording" "Sign of a running recording.",
    Mark "mark" "Marks on the time bar and in lists.",
    Changed "changed" "Bytes, versions and values that changed.",
    Beat "beat" "Heartbeats that are on time.",
    BeatBad "beat_bad" "Heartbeats that are early, late, doubled or missed.",
    Request "request" "Requests.",
    Response "response" "Responses and their latency.",
    Debug "debug" "Debug messages.",
    SideA "side_a" "The board of a conflict that was received first.",
    SideB "side_b" "The other boards of a conflict.",
    Match "match" "The filter, evidence and its frames.",
}

/// A style for each role.
#[derive(Clone, Debug, PartialEq)]
pub struct Theme {
    /// Name of a built-in theme, or of the user's file without `.toml`.
    pub name: String,
    styles: [Style; Role::ALL.len()],
}

/// Name and TOML text of the built-in themes.
pub const BUILT_IN: [(&str, &str); 5] = [
    ("terminal", include_str!("../themes/terminal.toml")),
    ("dark", include_str!("../themes/dark.toml")),
    ("light", include_str!("../themes/light.toml")),
    ("high-contrast", include_str!("../themes/high-contrast.toml")),
    ("mono", include_str!("../themes/mono.toml")),
];

/// Number of colours of the terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Colours {
    /// 16, with the values that the user's terminal gives them.
    Sixteen,
    /// 256: the 16, a cube of 6×6×6, and 24 greys.
    Indexed,
    /// Any, 8 bits each of red, green and blue.
    Full,
}

/// A mistake in the text of a theme; the theme cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {message}")]
pub struct ThemeError {
    /// Line of the mistake, from 1; a mistake in a parent theme has the line of `inherits`.
    pub line: usize,
    /// What is wrong, and what is accepted instead.
    pub message: String,
}

impl Theme {
    /// Returns the built-in theme of that name; `None` if there is none.
    pub fn built_in(name: &str) -> Option<Self> {
        let (_, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        Self::parse(name, text, |_| None).ok()
    }

    /// Reads a theme. `find` returns the text of another user theme by its name, for `inherits`;
    /// built-in themes need no `find`.
    ///
    /// # Errors
    ///
    /// The first mistake: TOML syntax, an unknown key, role or colour, a parent theme that is not
    /// found or inherits from this one.
    pub fn parse(
        name: &str,
        text: &str,
        find: impl Fn(&str) -> Option<String>,
    ) -> Result<Self, ThemeError> {
        Self::parse_below(name, text, &find, &[name])
    }

    /// As [`Self::parse`]; `above` are the themes that inherit from this one, itself last.
    fn parse_below(
        name: &str,
        text: &str,
        find: &dyn Fn(&str) -> Option<String>,
        above: &[&str],
    ) -> Result<Self, ThemeError> {
        let source = ThemeText { text };
        let table = DeTable::parse(text)
            .map_err(|e| source.error(e.span().unwrap_or(0..0), e.message().to_owned()))?;
        let mut theme = Self { name: name.to_owned(), styles: [Style::new(); Role::ALL.len()] };
        let mut palette = None;
        let mut roles = None;
        for (key, value) in table.get_ref() {
            match (key.get_ref().as_ref(), value.get_ref()) {
                ("inherits", DeValue::String(parent)) => {
                    theme.styles = source.parent(parent, value.span(), find, above)?.styles;
                }
                ("palette", DeValue::Table(table)) => palette = Some(table),
                ("roles", DeValue::Table(table)) => roles = Some(table),
                ("inherits", _) => return source.refuse(value, "a theme's name, in quotes"),
                ("palette" | "roles", _) => return source.refuse(value, "a table"),
                (other, _) => {
                    let message =
                        format!("unknown key \"{other}\"; use inherits, [palette], [roles]");
                    return Err(source.error(key.span(), message));
                }
            }
        }
        if !table.get_ref().contains_key("inherits") && name != "terminal" {
            theme.styles = Self::built_in("terminal").map_or(theme.styles, |theme| theme.styles);
        }
        for (key, value) in roles.into_iter().flatten() {
            let role = Role::ALL.iter().position(|role| role.name() == key.get_ref().as_ref());
            let Some(role) = role else {
                let known: Vec<&str> = Role::ALL.iter().map(|role| role.name()).collect();
                let known = known.join(", ");
                let message = format!("unknown role \"{}\"; use {known}", key.get_ref());
                return Err(source.error(key.span(), message));
            };
            theme.styles[role] = source.style(value, palette)?;
        }
        Ok(theme)
    }

    /// Returns the style of a role.
    pub fn style(&self, role: Role) -> Style {
        self.styles[role as usize]
    }

    /// Returns the theme with a tint of the selected row beside the terminal's own background: where the
    /// theme paints neither, but underlines the row, and the terminal has a colour between.
    #[must_use]
    pub fn tinted(mut self, background: [u8; 3], colours: Colours) -> Self {
        let selected = self.style(Role::Selected);
        let is_underlined = selected == Style::new().add_modifier(Modifier::UNDERLINED);
        let paints = self.style(Role::Background).bg.is_some();
        if paints || !is_underlined || colours == Colours::Sixteen {
            return self;
        }
        let [red, green, blue] = background;
        let own = nearest(Color::Rgb(red, green, blue), colours);
        let tints = TINTS.map(|share| nearest(tint(background, share), colours));
        if let Some(tint) = tints.into_iter().find(|tint| *tint != own) {
            self.styles[Role::Selected as usize] = Style::new().bg(tint);
        }
        self
    }

    /// Returns the theme with each colour replaced by the nearest one that the terminal has.
    #[must_use]
    pub fn limited(mut self, colours: Colours) -> Self {
        for style in &mut self.styles {
            style.fg = style.fg.map(|colour| nearest(colour, colours));
            style.bg = style.bg.map(|colour| nearest(colour, colours));
            style.underline_color = None;
        }
        self
    }
}

/// The text of a theme, from which spans of values become line numbers.
struct ThemeText<'t> {
    text: &'t str,
}

type Value<'t> = Spanned<DeValue<'t>>;

impl ThemeText<'_> {
    fn error(&self, span: Range<usize>, message: String) -> ThemeError {
        ThemeError { line: self.text[..span.start].matches('\n').count() + 1, message }
    }

    /// Returns the error of a value that is not what `expected` describes.
    fn refuse<T>(&self, value: &Value, expected: impl fmt::Display) -> Result<T, ThemeError> {
        Err(self.error(value.span(), format!("expected {expected}")))
    }

    /// Returns the theme named by `inherits`.
    fn parent(
        &self,
        name: &str,
        span: Range<usize>,
        find: &dyn Fn(&str) -> Option<String>,
        above: &[&str],
    ) -> Result<Theme, ThemeError> {
        // A user's theme may have the name of a built-in one and inherit from that.
        if !above.contains(&name)
            && let Some(text) = find(name)
        {
            let above = [above, &[name]].concat();
            return Theme::parse_below(name, &text, find, &above)
                .map_err(|error| self.error(span, format!("in {name}: {error}")));
        }
        match Theme::built_in_other_than(name, self.text) {
            Some(theme) => Ok(theme),
            None if above.contains(&name) => {
                Err(self.error(span, format!("{name} inherits from itself")))
            }
            None => Err(self.error(span, format!("theme \"{name}\" not found"))),
        }
    }

    /// Returns the style of a role: a colour, or a table of colours and attributes.
    fn style(&self, value: &Value, palette: Option<&DeTable>) -> Result<Style, ThemeError> {
        let DeValue::Table(table) = value.get_ref() else {
            return Ok(Style { fg: self.colour(value, palette)?, ..Style::new() });
        };
        let mut style = Style::new();
        for (key, value) in table {
            let modifier = match key.get_ref().as_ref() {
                "fg" => {
                    style.fg = self.colour(value, palette)?;
                    continue;
                }
                "bg" => {
                    style.bg = self.colour(value, palette)?;
                    continue;
                }
                "bold" => Modifier::BOLD,
                "dim" => Modifier::DIM,
                "italic" => Modifier::ITALIC,
                "underline" => Modifier::UNDERLINED,
                "reverse" => Modifier::REVERSED,
                other => {
                    let message = format!(
                        "unknown key \"{other}\" in a style; use fg, bg, bold, dim, italic, \
                         underline, reverse"
                    );
                    return Err(self.error(key.span(), message));
                }
            };
            match value.get_ref() {
                DeValue::Boolean(true) => style = style.add_modifier(modifier),
                DeValue::Boolean(false) => {}
                _ => return self.refuse(value, "true or false"),
            }
        }
        Ok(style)
    }

    /// Returns a colour; `None` for "default", the terminal's own.
    fn colour(
        &self,
        value: &Value,
        palette: Option<&DeTable>,
    ) -> Result<Option<Color>, ThemeError> {
        let expected = "a colour: one of the palette, one of the sixteen (\"red\", \
                        \"bright-red\", …), \"default\", \"#rrggbb\", or 0 to 255";
        match value.get_ref() {
            DeValue::String(name) => {
                let own = |(key, _): &(&Spanned<DeString>, &Value)| key.get_ref() == name;
                if let Some((_, value)) = palette.and_then(|palette| palette.iter().find(own)) {
                    return self.colour(value, None);
                }
                match named(name) {
                    Some(Color::Reset) => Ok(None),
                    Some(colour) => Ok(Some(colour)),
                    None => self.refuse(value, expected),
                }
            }
            DeValue::Integer(number) => match u8::from_str_radix(number.as_str(), number.radix()) {
                Ok(index) => Ok(Some(Color::Indexed(index))),
                Err(_) => self.refuse(value, expected),
            },
            _ => self.refuse(value, expected),
        }
    }
}

impl Theme {
    /// Returns the built-in theme of that name, unless `text` is its own: then it would inherit
    /// from itself.
    fn built_in_other_than(name: &str, text: &str) -> Option<Self> {
        let other = BUILT_IN.iter().any(|(known, own)| *known == name && *own != text);
        other.then(|| Self::built_in(name)).flatten()
    }
}

/// Shares of the way from the background to white, or to black, of a tint: the first one that the
/// terminal can show. The first is that of the theme `dark`.
const TINTS: [f32; 3] = [0.11, 0.17, 0.25];

/// Returns a colour beside a background, towards white on a dark one and towards black on a light one.
fn tint(background: [u8; 3], share: f32) -> Color {
    let [red, green, blue] = background.map(f32::from);
    // Luminance by ITU-R BT.601.
    let is_dark = 0.299 * red + 0.587 * green + 0.114 * blue < 128.0;
    let end = if is_dark { 255.0 } else { 0.0 };
    let [red, green, blue] = [red, green, blue].map(|part| part + (end - part) * share);
    Color::Rgb(red as u8, green as u8, blue as u8)
}

/// Name, colour and usual value of the 16 colours.
const SIXTEEN: [(&str, Color, [u8; 3]); 16] = [
    ("black", Color::Black, [0, 0, 0]),
    ("red", Color::Red, [205, 0, 0]),
    ("green", Color::Green, [0, 205, 0]),
    ("yellow", Color::Yellow, [205, 205, 0]),
    ("blue", Color::Blue, [0, 0, 238]),
    ("magenta", Color::Magenta, [205, 0, 205]),
    ("cyan", Color::Cyan, [0, 205, 205]),
    ("white", Color::Gray, [229, 229, 229]),
    ("bright-black", Color::DarkGray, [127, 127, 127]),
    ("bright-red", Color::LightRed, [255, 80, 80]),
    ("bright-green", Color::LightGreen, [80, 255, 80]),
    ("bright-yellow", Color::LightYellow, [255, 255, 80]),
    ("bright-blue", Color::LightBlue, [92, 92, 255]),
    ("bright-magenta", Color::LightMagenta, [255, 80, 255]),
    ("bright-cyan", Color::LightCyan, [80, 255, 255]),
    ("bright-white", Color::White, [255, 255, 255]),
];

/// Returns the colour of a name (`red`, `default`) or of `#rrggbb`; `None` if it is neither.
fn named(name: &str) -> Option<Color> {
    if name == "default" {
        return Some(Color::Reset);
    }
    if let Some(hex) = name.strip_prefix('#') {
        let digits = (hex.len() == 6).then(|| u32::from_str_radix(hex, 16).ok()).flatten()?;
        let [_, red, green, blue] = digits.to_be_bytes();
        return Some(Color::Rgb(red, green, blue));
    }
    let found = SIXTEEN.iter().find(|(known, ..)| *known == name);
    found.map(|(_, colour, _)| *colour)
}

/// Returns the nearest colour that the terminal has, by weighted distance of red, green and blue.
fn nearest(colour: Color, colours: Colours) -> Color {
    let rgb = match colour {
        Color::Rgb(red, green, blue) if colours < Colours::Full => [red, green, blue],
        Color::Indexed(index) if colours < Colours::Indexed => rgb_of(index),
        _ => return colour,
    };
    let distance = |other: [u8; 3]| -> i32 {
        let part = |at: usize| (i32::from(rgb[at]) - i32::from(other[at])).pow(2);
        2 * part(0) + 4 * part(1) + 3 * part(2)
    };
    if colours == Colours::Indexed {
        let best = (16..=255).min_by_key(|&index| distance(rgb_of(index)));
        return Color::Indexed(best.unwrap_or(7));
    }
    let best = SIXTEEN.iter().min_by_key(|(.., other)| distance(*other));
    best.map_or(colour, |(_, colour, _)| *colour)
}

/// Returns red, green and blue of a colour of the 256, as terminals usually show it.
fn rgb_of(index: u8) -> [u8; 3] {
    let level = |part: u8| if part == 0 { 0 } else { 55 + 40 * part };
    match index {
        0..=15 => SIXTEEN[usize::from(index)].2,
        16..=231 => {
            let cube = index - 16;
            [level(cube / 36), level(cube / 6 % 6), level(cube % 6)]
        }
        _ => [8 + 10 * (index - 232); 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Theme, ThemeError> {
        Theme::parse("mine", text, |name| match name {
            "ours" => Some("inherits = \"ring\"\n[roles]\ntext = \"red\"".to_owned()),
            "ring" => Some("inherits = \"ours\"".to_owned()),
            "warm" => Some("[roles]\ntext = 208".to_owned()),
            _ => None,
        })
    }

    #[test]
    fn built_in_theme_names_all_roles() {
        for (name, text) in BUILT_IN {
            let theme = Theme::built_in(name).unwrap();
            assert!(theme.styles.iter().any(|style| *style != Style::new()), "{name}");
            if !text.contains("inherits") {
                for role in Role::ALL {
                    assert!(text.contains(&format!("\n{} = ", role.name())), "{name}: {role:?}");
                }
            }
        }
    }

    #[test]
    fn mono_theme_has_no_colours() {
        let theme = Theme::built_in("mono").unwrap();
        assert!(theme.styles.iter().all(|style| style.fg.is_none() && style.bg.is_none()));
        assert!(theme.style(Role::Selected).add_modifier.contains(Modifier::REVERSED));
    }

    #[test]
    fn theme_with_parent_and_palette_has_their_colours() {
        let theme = parse(
            "inherits = \"warm\"\n[palette]\namber = \"#ffaf5f\"\n\
             [roles]\nwarning = \"amber\"\nerror = { fg = \"bright-red\", bold = true }",
        )
        .unwrap();
        assert_eq!(theme.style(Role::Text).fg, Some(Color::Indexed(208)));
        assert_eq!(theme.style(Role::Warning).fg, Some(Color::Rgb(0xFF, 0xAF, 0x5F)));
        assert!(theme.style(Role::Error).add_modifier.contains(Modifier::BOLD));
        let limited = theme.clone().limited(Colours::Indexed);
        assert_eq!(limited.style(Role::Warning).fg, Some(Color::Indexed(215)));
        assert_eq!(theme.limited(Colours::Sixteen).style(Role::Error).fg, Some(Color::LightRed));
    }

    #[test]
    fn wrong_theme_reports_line_and_choices() {
        let message = |text| parse(text).unwrap_err().to_string();
        assert!(
            message("[roles]\n\nerorr = \"red\"").starts_with("line 3: unknown role \"erorr\"; ")
        );
        assert!(message("[roles]\ntext = \"rde\"").starts_with("line 2: expected a colour"));
        assert!(message("[roles]\ntext = 256").starts_with("line 2: expected a colour"));
        assert!(
            message("[roles]\ntext = { bald = true }").starts_with("line 2: unknown key \"bald\"")
        );
        assert_eq!(message("inherits = \"nice\""), "line 1: theme \"nice\" not found");
        assert!(message("inherits = \"ours\"").contains("inherits from itself"));
        assert!(message("text = ").starts_with("line 1: "));
    }

    #[test]
    fn selected_row_is_tinted_beside_the_background_of_the_terminal() {
        let selected = |name: &str, background, colours| {
            let theme = Theme::built_in(name).unwrap().limited(colours);
            theme.tinted(background, colours).style(Role::Selected)
        };
        let underlined = Style::new().add_modifier(Modifier::UNDERLINED);
        let (dark, light) = ([0x1c, 0x1f, 0x24], [0xfd, 0xf6, 0xe3]);
        let tint = |red, green, blue| Style::new().bg(Color::Rgb(red, green, blue));
        assert_eq!(selected("terminal", dark, Colours::Full), tint(0x34, 0x37, 0x3c));
        assert_eq!(selected("terminal", light, Colours::Full), tint(0xe1, 0xda, 0xca));
        assert_eq!(selected("terminal", dark, Colours::Sixteen), underlined);
        for grey in 0..=255 {
            let background = [grey; 3];
            let found = selected("terminal", background, Colours::Indexed).bg;
            let own = nearest(Color::Rgb(grey, grey, grey), Colours::Indexed);
            assert!(found.is_some_and(|it| it != own), "{grey}: {found:?}");
        }
        // Themes that paint, or mark the row otherwise.
        for name in ["dark", "light", "high-contrast", "mono"] {
            let own = Theme::built_in(name).unwrap().limited(Colours::Full).style(Role::Selected);
            assert_eq!(selected(name, dark, Colours::Full), own, "{name}");
        }
    }
}
