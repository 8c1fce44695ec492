//! The user's own settings: `config.toml`, `keys.toml`, `filters.toml` and `themes/` in the XDG config
//! folder.
//!
//! Each part is optional. An error in one is reported with file and line; descan then starts with
//! the built-in values.

use crate::app::{MAX_SAVED_FILTERS, Page, SavedFilter, SavedFilterChange, Signs};
use crate::keymap::Keymap;
use crate::regular_file::read_text;
use crate::text::{printable, printable_path};
use etcetera::{BaseStrategy, choose_base_strategy};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// `config.toml`: defaults for command-line options.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UserSettings {
    /// The theme's name.
    pub theme: Option<String>,
    /// `unicode` or `ascii`; `None`: what the terminal can show.
    pub signs: Option<String>,
    /// Seconds between enumeration rounds once the bus is known, 0 to 86400; 0 stops them then.
    pub round_period: Option<f64>,
    /// Transmit budget while starting, as a share of the bus, 0.001 to 1.
    pub start_share: Option<f64>,
    /// Transmit budget afterwards, 0.001 to 1.
    pub steady_share: Option<f64>,
    /// Bytes per second to the terminal for what the bus changes, 200 to 1000000.
    pub screen_budget: Option<f64>,
}

impl UserSettings {
    /// Reads the text of `config.toml`.
    ///
    /// # Errors
    ///
    /// The first mistake, not escaped for the terminal: TOML syntax, an unknown name or a value out
    /// of range.
    pub fn parse(text: &str) -> Result<Self, String> {
        let settings: Self = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| text[..span.start].matches('\n').count() + 1);
            format!("line {line}: {}", error.message())
        })?;
        let share = |share: Option<f64>| share.is_none_or(|share| (0.001..=1.0).contains(&share));
        if !share(settings.start_share) || !share(settings.steady_share) {
            return Err("a share of the bus is a number from 0.001 to 1".to_owned());
        }
        if !settings.round_period.is_none_or(|period| (0.0..=86_400.0).contains(&period)) {
            return Err("round_period is a number of seconds, 0 to 86400".to_owned());
        }
        if !settings.screen_budget.is_none_or(|budget| (200.0..=1e6).contains(&budget)) {
            return Err("screen_budget is a number of bytes per second, 200 to 1000000".to_owned());
        }
        if settings.signs.as_ref().is_some_and(|name| Signs::from_name(name).is_none()) {
            return Err("signs is \"unicode\" or \"ascii\"".to_owned());
        }
        Ok(settings)
    }

    /// Time between enumeration rounds; `None` for the built-in value.
    pub fn round_period(&self) -> Option<Duration> {
        self.round_period.map(Duration::from_secs_f64)
    }
}

/// File of the settings.
const CONFIG: &str = "config.toml";

/// Returns the text of `config.toml` with this theme in the place of the one before, or as its first
/// line.
fn with_theme(text: &str, name: &str) -> String {
    let value = toml::Value::String(name.to_owned()).to_string();
    let table = toml::de::DeTable::parse(text).ok();
    let span = table.and_then(|table| Some(table.get_ref().get("theme")?.span()));
    match span {
        Some(span) => format!("{}{value}{}", &text[..span.start], &text[span.end..]),
        None => format!("theme = {value}\n{text}"),
    }
}

/// File of the saved filters.
const FILTERS: &str = "filters.toml";

/// Content of `filters.toml`.
#[derive(Debug, Default, Deserialize, Serialize)]
struct FilterFile {
    #[serde(default)]
    filter: Vec<FilterEntry>,
}

#[derive(Debug, Deserialize, Serialize)]
struct FilterEntry {
    page: String,
    line: String,
}

/// Name of a page in `filters.toml`.
const fn name_of(page: Page) -> &'static str {
    match page {
        Page::Devices => "devices",
        Page::Traffic => "traffic",
        Page::Timeline => "timeline",
        Page::Problems => "problems",
        Page::Bus => "bus",
    }
}

/// The folder with the user's settings.
#[derive(Clone, Debug)]
pub struct ConfigFolder {
    path: PathBuf,
}

impl ConfigFolder {
    /// `$XDG_CONFIG_HOME/descan`, by default `~/.config/descan`; `None` without a home folder.
    pub fn of_user() -> Option<Self> {
        let base = choose_base_strategy().ok()?;
        Some(Self { path: base.config_dir().join("descan") })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder at `path`.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Reads `config.toml`; built-in values if it is missing. The error names file and line.
    pub fn settings(&self) -> Result<UserSettings, String> {
        self.read(CONFIG, UserSettings::parse)
    }

    /// Reads `keys.toml`; the built-in keys if it is missing. The error names file and line.
    pub fn keymap(&self) -> Result<Keymap, String> {
        self.read("keys.toml", |text| Keymap::parse(text).map_err(|error| error.to_string()))
    }

    /// Reads `filters.toml`; no filters if it is missing. The error names file and line.
    pub fn saved_filters(&self) -> Result<Vec<SavedFilter>, String> {
        let file: FilterFile = self.read(FILTERS, |text| {
            toml::from_str(text).map_err(|error| error.message().to_owned())
        })?;
        let filters = file.filter.into_iter().take(MAX_SAVED_FILTERS);
        let known = filters.filter_map(|entry| {
            let page = Page::ALL.into_iter().find(|page| name_of(*page) == entry.page)?;
            Some(SavedFilter { page, line: entry.line })
        });
        Ok(known.collect())
    }

    /// Changes `filters.toml` as it is now; returns the filters in it.
    ///
    /// # Errors
    /// It cannot be read, or not be written.
    pub fn change_filters(&self, change: &SavedFilterChange) -> Result<Vec<SavedFilter>, String> {
        let mut filters = self.saved_filters()?;
        change.apply(&mut filters);
        let entries = filters.iter().map(|filter| FilterEntry {
            page: name_of(filter.page).to_owned(),
            line: filter.line.clone(),
        });
        let file = FilterFile { filter: entries.collect() };
        let path = self.path.join(FILTERS);
        let text = toml::to_string(&file).map_err(|error| error.to_string())?;
        let text =
            format!("# Filters saved on the screen: Ctrl-s in the prompt, F lists them.\n{text}");
        self.replace(&path, &text)?;
        Ok(filters)
    }

    /// Makes `name` the theme in `config.toml`; all else in the file stays as it is.
    ///
    /// # Errors
    /// It cannot be read, is not valid, or cannot be written.
    pub fn keep_theme(&self, name: &str) -> Result<(), String> {
        // Not `self.path` alone: a link to a file elsewhere stays one.
        let path = self.path.join(CONFIG);
        let path = fs::canonicalize(&path).unwrap_or(path);
        let text = read_text(&path).map_err(|fault| fault.to_string())?.unwrap_or_default();
        let message =
            |why: String| format!("{}: {}", printable_path(&path), printable(why.as_bytes()));
        UserSettings::parse(&text).map_err(message)?;
        let new = with_theme(&text, name);
        let is_right = UserSettings::parse(&new).is_ok_and(|it| it.theme.as_deref() == Some(name));
        if !is_right {
            return Err(message(format!("set there: theme = \"{name}\"")));
        }
        self.replace(&path, &new)
    }

    /// Writes a file as a whole.
    fn replace(&self, path: &Path, text: &str) -> Result<(), String> {
        let failed = |error: &io::Error| format!("{}: {error}", printable_path(path));
        let folder = path.parent().unwrap_or(&self.path);
        fs::create_dir_all(folder).map_err(|error| failed(&error))?;
        let mut temporary =
            tempfile::NamedTempFile::new_in(folder).map_err(|error| failed(&error))?;
        temporary.write_all(text.as_bytes()).map_err(|error| failed(&error))?;
        if let Ok(before) = fs::metadata(path) {
            let _ = temporary.as_file().set_permissions(before.permissions());
        }
        temporary.persist(path).map_err(|error| failed(&error.error))?;
        Ok(())
    }

    /// Path of the user's theme `name`, whether or not it exists.
    pub fn theme_path(&self, name: &str) -> PathBuf {
        self.path.join("themes").join(format!("{name}.toml"))
    }

    /// The names of the user's themes, sorted.
    pub fn theme_names(&self) -> Vec<String> {
        let Ok(entries) = fs::read_dir(self.path.join("themes")) else { return Vec::new() };
        let mut names: Vec<String> = entries
            .filter_map(|entry| {
                let path = entry.ok()?.path();
                (path.extension()? == "toml")
                    .then(|| path.file_stem()?.to_str().map(str::to_owned))?
            })
            .collect();
        names.sort();
        names
    }

    fn read<T: Default>(
        &self,
        name: &str,
        parse: impl FnOnce(&str) -> Result<T, String>,
    ) -> Result<T, String> {
        let path = self.path.join(name);
        let Some(text) = read_text(&path).map_err(|fault| fault.to_string())? else {
            return Ok(T::default());
        };
        let message = |message: String| {
            format!("{}: {}", printable_path(&path), printable(message.as_bytes()))
        };
        parse(&text).map_err(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_theme_changes_nothing_else_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let config = ConfigFolder::at(folder.path().join("descan"));
        let path = folder.path().join("descan/config.toml");
        config.keep_theme("dark").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "theme = \"dark\"\n");
        let text = "# mine\nround_period = 5\ntheme = 'light' # for the sun\n";
        fs::write(&path, text).unwrap();
        config.keep_theme("high-contrast").unwrap();
        let kept = fs::read_to_string(&path).unwrap();
        assert_eq!(kept, text.replace("'light'", "\"high-contrast\""));
        // A file with a mistake is the user's to correct.
        fs::write(&path, "tehme = 1\n").unwrap();
        let error = config.keep_theme("dark").unwrap_err();
        assert!(error.contains("config.toml: line 1: unknown field"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "tehme = 1\n");
    }

    #[test]
    fn link_to_the_settings_stays_one() {
        let folder = tempfile::tempdir().unwrap();
        let (own, link) = (folder.path().join("own.toml"), folder.path().join("config.toml"));
        fs::write(&own, "round_period = 5\n").unwrap();
        std::os::unix::fs::symlink(&own, &link).unwrap();
        ConfigFolder::at(folder.path()).keep_theme("mono").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(fs::read_to_string(&own).unwrap().contains("theme = \"mono\""));
    }

    #[test]
    fn saved_filters_are_stored_beside_those_of_others() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other) = (folder.path().join("descan"), folder.path().join("descan"));
        let (one, other) = (ConfigFolder::at(one), ConfigFolder::at(other));
        assert_eq!(one.saved_filters(), Ok(Vec::new()));
        let filter = |page, line: &str| SavedFilter { page, line: line.to_owned() };
        let first = filter(Page::Traffic, "src:FEED data:\"01 ??\"");
        let second = filter(Page::Devices, "is:lost");
        one.change_filters(&SavedFilterChange::Add(first.clone())).unwrap();
        let both = other.change_filters(&SavedFilterChange::Add(second.clone()));
        assert_eq!(both, Ok(vec![first.clone(), second.clone()]));
        let again = one.change_filters(&SavedFilterChange::Add(second.clone()));
        assert_eq!(again.map(|all| all.len()), Ok(2), "it is there");
        assert_eq!(one.change_filters(&SavedFilterChange::Remove(first)), Ok(vec![second]));
        // A damaged file is not overwritten.
        let path = folder.path().join("descan").join(FILTERS);
        fs::write(&path, "[[filter]]\npage = 5").unwrap();
        let change = SavedFilterChange::Add(filter(Page::Traffic, "err"));
        assert!(one.change_filters(&change).unwrap_err().contains("filters.toml"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "[[filter]]\npage = 5");
    }

    #[test]
    fn settings_missing_are_built_in_and_errors_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let config = ConfigFolder::at(folder.path());
        assert_eq!(config.settings(), Ok(UserSettings::default()));
        fs::write(folder.path().join("config.toml"), "theme = \"dark\"\nround_period = 5\n")
            .unwrap();
        let settings = config.settings().unwrap();
        assert_eq!(settings.theme.as_deref(), Some("dark"));
        assert_eq!(settings.round_period(), Some(Duration::from_secs(5)));
        for (text, hint) in [
            ("\ntehme = \"dark\"", "line 2: unknown field `tehme`"),
            ("start_share = 30", "0.001 to 1"),
            ("signs = \"emoji\"", "\"unicode\" or \"ascii\""),
            ("round_period = -1", "0 to 86400"),
            ("screen_budget = 20", "200 to 1000000"),
        ] {
            fs::write(folder.path().join("config.toml"), text).unwrap();
            let error = config.settings().unwrap_err();
            assert!(error.contains(hint) && error.contains("config.toml"), "{error}");
        }
        fs::write(folder.path().join("keys.toml"), "rescan = 5").unwrap();
        assert!(config.keymap().unwrap_err().contains("keys.toml: line 1"));
    }
}
