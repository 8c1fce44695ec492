//! What the keys of the list of buses do. Input: a key. Output: what is to be done outside. Does not know
//! how the list is drawn.

use super::offer::BusWorld;
use super::{
    BIT_RATES, BusChoice, BusSelection, ChoiceOutcome, ChoiceQuestion, MAX_SEARCH, USUAL_RATE,
};
use crate::keymap::{Action, Key, KeyCode, KeyMode};

impl BusChoice {
    /// Handles a key.
    pub fn handle_key(&mut self, key: Key) -> Option<ChoiceOutcome> {
        self.message = None;
        if key == Key::ctrl('c') {
            return Some(ChoiceOutcome::Close);
        }
        if self.is_typing {
            self.type_search(key);
            return None;
        }
        if let Some(question) = self.question.take() {
            let is_yes = self.keymap.lookup(KeyMode::Confirm, key) == Some(Action::Yes);
            return if is_yes { self.open_after(Some(question)) } else { None };
        }
        let is_open = self.open.is_some();
        let action = self.keymap.lookup(KeyMode::Choice, key);
        let is_of_line = matches!(
            action,
            Some(Action::ChoiceToggle | Action::ChoiceBitrate | Action::ChoiceCopy)
        );
        if is_of_line && !self.shown().contains(&self.selected) {
            self.show("no line is shown");
            return None;
        }
        match action {
            Some(Action::ChoiceUp) => self.move_by(-1),
            Some(Action::ChoiceDown) => self.move_by(1),
            Some(Action::ChoiceFirst) => self.move_by(isize::MIN),
            Some(Action::ChoiceLast) => self.move_by(isize::MAX),
            Some(Action::ChoiceToggle) => self.toggle(),
            Some(Action::ChoiceBitrate) => self.next_rate(),
            Some(Action::ChoiceListenOnly) => self.listen_only = !self.listen_only,
            Some(Action::ChoiceNoNames) => self.no_requests = !self.no_requests,
            Some(Action::ChoiceRecord) if !is_open => self.records = !self.records,
            Some(Action::ChoiceInPlace) if is_open => self.toggle_in_place(),
            Some(Action::ChoiceTheme) if !is_open => return Some(ChoiceOutcome::NextTheme),
            Some(Action::ChoiceSearch) => self.is_typing = true,
            Some(Action::ChoiceCopy) => return self.copy(),
            Some(Action::ChoiceOpen) => return self.open_after(None),
            Some(Action::ChoiceClose) if key.code == KeyCode::Esc && !self.search.is_empty() => {
                self.search.clear();
            }
            Some(Action::ChoiceClose) => return Some(ChoiceOutcome::Close),
            // The key that opened the list.
            None if is_open => {
                let opens = self.keymap.lookup(KeyMode::Browse, key) == Some(Action::Buses);
                return opens.then_some(ChoiceOutcome::Close);
            }
            _ => {}
        }
        None
    }

    /// Takes the name of the theme that is used now.
    pub fn set_theme(&mut self, name: String) {
        self.show(format!("theme {name}"));
        self.theme = Some(name);
    }

    /// Shows a message until the next key.
    pub fn show(&mut self, message: impl Into<String>) {
        self.message = Some(message.into());
    }

    fn type_search(&mut self, key: Key) {
        match key.code {
            KeyCode::Enter => self.is_typing = false,
            KeyCode::Esc => {
                self.is_typing = false;
                self.search.clear();
            }
            KeyCode::Backspace => {
                self.search.pop();
            }
            KeyCode::Up => self.move_by(-1),
            KeyCode::Down => self.move_by(1),
            KeyCode::Char(c) if !key.ctrl && !key.alt && self.search.len() < MAX_SEARCH => {
                self.search.push(c);
            }
            _ => {}
        }
        let shown = self.shown();
        if !shown.contains(&self.selected)
            && let Some(first) = shown.first()
        {
            self.selected = *first;
        }
    }

    fn move_by(&mut self, by: isize) {
        let shown = self.shown();
        let at = shown.iter().position(|at| *at == self.selected).unwrap_or(0);
        let at = at.saturating_add_signed(by).min(shown.len().saturating_sub(1));
        self.selected = shown.get(at).copied().unwrap_or(self.selected);
    }

    fn toggle(&mut self) {
        if self.is_open(self.selected) && !self.in_place {
            return self.show_open(self.selected);
        }
        let Some(offer) = self.offers.get(self.selected) else { return };
        if !self.chosen.remove(&offer.argument) {
            self.chosen.insert(offer.argument.clone());
        }
    }

    fn toggle_in_place(&mut self) {
        if self.open.as_ref().is_some_and(|open| open.has_log) {
            return self.show("a log is open: no bus can be added beside it");
        }
        self.in_place = !self.in_place;
    }

    fn next_rate(&mut self) {
        if self.bit_rate(self.selected).is_none() {
            return self.show("the bit rate is chosen for serial adapters only");
        }
        let argument = self.offers[self.selected].argument.clone();
        let rate = self.rates.entry(argument).or_insert(USUAL_RATE);
        *rate = (*rate + 1) % BIT_RATES.len();
    }

    fn copy(&mut self) -> Option<ChoiceOutcome> {
        let command = self.offers.get(self.selected).and_then(|offer| offer.command.clone());
        self.show(match &command {
            Some(command) => format!("copied: {command}"),
            None => "no command for this line".to_owned(),
        });
        command.map(ChoiceOutcome::Copy)
    }

    fn show_open(&mut self, at: usize) {
        let name = self.offers[at].name.clone();
        self.show(format!("{name} is open already"));
    }

    /// The lines to open: those chosen, else the selected one.
    fn wanted(&self) -> Vec<usize> {
        let chosen: Vec<usize> = (0..self.offers.len()).filter(|at| self.is_chosen(*at)).collect();
        if chosen.is_empty() && self.shown().contains(&self.selected) {
            return vec![self.selected];
        }
        chosen
    }

    /// Those of them that may be any serial device.
    pub(super) fn unknown(&self) -> impl Iterator<Item = usize> {
        self.wanted().into_iter().filter(|at| self.offers[*at].is_unknown)
    }

    /// Returns true if the wanted buses cannot be open beside those of the session, or are not to be.
    fn replaces(&self) -> bool {
        let Some(open) = &self.open else { return false };
        let worlds = open.arguments.iter().map(String::as_str);
        let wanted = self.wanted();
        let wanted = wanted.iter().map(|at| &*self.offers[*at].argument);
        let worlds: Vec<BusWorld> = worlds.chain(wanted).map(BusWorld::of).collect();
        let fit = worlds.windows(2).all(|pair| pair[0] == pair[1]);
        self.in_place || open.has_log || !fit || worlds.contains(&BusWorld::Log)
    }

    /// Opens the wanted buses, after this question was answered with yes; the next question comes
    /// first.
    fn open_after(&mut self, answered: Option<ChoiceQuestion>) -> Option<ChoiceOutcome> {
        let wanted = self.wanted();
        if wanted.is_empty() {
            self.show("nothing is selected");
            return None;
        }
        if let Some(down) = wanted.iter().find(|at| self.offers[**at].command.is_some()) {
            let name = &self.offers[*down].name;
            self.show(format!("{name} is down; y copies the command"));
            return None;
        }
        let replaces = self.replaces();
        if let Some(at) = wanted.iter().find(|at| self.is_open(**at) && !replaces) {
            self.show_open(*at);
            return None;
        }
        if answered.is_none() && self.unknown().next().is_some() {
            self.question = Some(ChoiceQuestion::UnknownAdapter);
            return None;
        }
        if answered != Some(ChoiceQuestion::Replace) && replaces {
            self.question = Some(ChoiceQuestion::Replace);
            return None;
        }
        let argument = |at: usize| match self.bit_rate(at) {
            Some(rate) => format!("{}@{rate}", self.offers[at].argument),
            None => self.offers[at].argument.clone(),
        };
        let buses = wanted.into_iter().map(argument).collect();
        let listen_only = self.listen_only || self.unknown().next().is_some();
        let options = self.options();
        Some(ChoiceOutcome::Open(BusSelection { buses, listen_only, replaces, ..options }))
    }

    pub(super) fn options(&self) -> BusSelection {
        BusSelection {
            buses: Vec::new(),
            listen_only: self.listen_only,
            no_requests: self.no_requests,
            records: self.records,
            replaces: false,
            theme: self.theme.clone(),
            profile: None,
        }
    }
}
