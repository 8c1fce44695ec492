//! The theme picker: a list of the themes, each shown on the live screen while it is selected.
//!
//! Inputs: the names of the themes, and the mistakes in those of the user. Outputs: which theme to use,
//! and which to keep. Does not know where themes are stored.

use super::input::Overlay;
use super::{App, Effect};
use crate::time::Instant;
use std::collections::BTreeMap;

/// The theme that `NO_COLOR` selects.
pub const COLOURLESS_THEME: &str = "mono";

/// The themes to choose from.
#[derive(Debug, Default)]
pub(super) struct Themes {
    current: String,
    all: Vec<String>,
    /// Mistakes in themes of the user, by name.
    faults: BTreeMap<String, String>,
    /// The theme before the picker was opened.
    before: String,
}

impl Themes {
    /// Returns the themes with the name of the current one.
    pub fn new(current: String, all: Vec<String>, faults: Vec<(String, String)>) -> Self {
        Self { before: current.clone(), current, all, faults: faults.into_iter().collect() }
    }
}

impl App {
    /// Name of the theme.
    pub fn theme(&self) -> &str {
        &self.themes.current
    }

    /// Names of the themes, each with the mistake for which it cannot be used.
    pub fn themes(&self) -> impl Iterator<Item = (&str, Option<&str>)> {
        let fault = |name: &String| self.themes.faults.get(name).map(String::as_str);
        self.themes.all.iter().map(move |name| (name.as_str(), fault(name)))
    }

    /// Opens the picker at the current theme.
    pub(super) fn pick_theme(&mut self) {
        let at = self.themes.all.iter().position(|name| *name == self.themes.current);
        self.themes.before.clone_from(&self.themes.current);
        self.input.open(Overlay::Themes(at.unwrap_or(0)));
    }

    /// Selects the next theme of the list, or with -1 the one before, and shows it; one with a
    /// mistake is not used.
    pub(super) fn move_in_themes(&mut self, by: isize) {
        let Overlay::Themes(at) = *self.input.overlay() else { return };
        let last = self.themes.all.len().saturating_sub(1);
        let at = at.saturating_add_signed(by).min(last);
        self.input.open(Overlay::Themes(at));
        let Some(name) = self.themes.all.get(at).cloned() else { return };
        match self.themes.faults.get(&name) {
            Some(fault) => {
                let text = format!("theme {name}: {fault}");
                self.show_error(text);
            }
            None => self.use_theme(name),
        }
    }

    fn use_theme(&mut self, name: String) {
        if self.themes.current != name {
            self.themes.current.clone_from(&name);
            self.effects.push_back(Effect::UseTheme(name));
        }
    }

    /// Keeps the theme that is shown, and closes the picker.
    pub(super) fn keep_theme(&mut self) {
        let Overlay::Themes(at) = *self.input.overlay() else { return };
        let selected = self.themes.all.get(at);
        if let Some((name, fault)) =
            selected.and_then(|name| self.themes.faults.get_key_value(name))
        {
            let text = format!("theme {name}: {fault}");
            return self.show_error(text);
        }
        self.input.close();
        if self.themes.current != self.themes.before {
            self.effects.push_back(Effect::KeepTheme(self.themes.current.clone()));
        }
    }

    /// Shows the theme from before the picker was opened, and closes it.
    pub(super) fn leave_themes(&mut self) {
        self.input.close();
        self.use_theme(self.themes.before.clone());
    }

    /// Takes the result of an [`Effect::UseTheme`]; `Err` with the cause.
    pub fn handle_theme(&mut self, now: Instant, result: Result<(), String>) {
        self.clock.set(now);
        match result {
            Ok(()) => {
                self.themes.faults.remove(&self.themes.current);
                self.notices.redraw.set_dirty();
            }
            Err(why) => {
                self.show_error(format!("theme {}: {why}", self.themes.current));
                self.themes.faults.insert(self.themes.current.clone(), why);
            }
        }
    }

    /// Takes the result of an [`Effect::KeepTheme`]; `Err` with the cause.
    pub fn handle_kept_theme(&mut self, now: Instant, result: Result<(), String>) {
        self.clock.set(now);
        match result {
            Ok(()) => self.show_info(format!("theme {} kept in config.toml", self.themes.current)),
            Err(why) => self.show_error(format!("theme not kept: {why}")),
        }
    }
}
