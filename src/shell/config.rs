//! The user's own settings: `config.toml`, `keys.toml` and `themes/` in the XDG config folder.
//!
//! Each part is optional. An error in one is reported with file and line; descan then starts with
//! the built-in values.

use crate::keymap::Keymap;
use crate::regular_file::{read_text, shown};
use crate::text::printable;
use etcetera::{BaseStrategy, choose_base_strategy};
use serde::Deserialize;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

/// `config.toml`: defaults for command-line options.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UserSettings {
    /// The theme's name.
    pub theme: Option<String>,
    /// Seconds between enumeration rounds once the bus is known, 0 to 86400; 0 stops them then.
    pub round_period: Option<f64>,
    /// Transmit budget while starting, as a share of the bus, 0.001 to 1.
    pub start_share: Option<f64>,
    /// Transmit budget afterwards, 0.001 to 1.
    pub steady_share: Option<f64>,
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
        Ok(settings)
    }

    /// Time between enumeration rounds; `None` for the built-in value.
    pub fn round_period(&self) -> Option<Duration> {
        self.round_period.map(Duration::from_secs_f64)
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

    /// The folder at `path`.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Reads `config.toml`; built-in values if it is missing. The error names file and line.
    pub fn settings(&self) -> Result<UserSettings, String> {
        self.read("config.toml", UserSettings::parse)
    }

    /// Reads `keys.toml`; the built-in keys if it is missing. The error names file and line.
    pub fn keymap(&self) -> Result<Keymap, String> {
        self.read("keys.toml", |text| Keymap::parse(text).map_err(|error| error.to_string()))
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
        let message =
            |message: String| format!("{}: {}", shown(&path), printable(message.as_bytes()));
        parse(&text).map_err(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            ("round_period = -1", "0 to 86400"),
        ] {
            fs::write(folder.path().join("config.toml"), text).unwrap();
            let error = config.settings().unwrap_err();
            assert!(error.contains(hint) && error.contains("config.toml"), "{error}");
        }
        fs::write(folder.path().join("keys.toml"), "rescan = 5").unwrap();
        assert!(config.keymap().unwrap_err().contains("keys.toml: line 1"));
    }
}
