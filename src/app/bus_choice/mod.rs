//! The choice of buses before a session: the lines of the list, and what its keys do.
//!
//! Inputs: what the machine has, keys. Output: the BUS arguments to open. A state machine without I/O:
//! nothing is opened and nothing is sent while it is shown. Bounded: 64 lines. Does not know how it is
//! drawn.

use crate::keymap::{Key, KeyCode};

/// Most lines of the list.
const MAX_OFFERS: usize = 64;

/// Bit rates that are offered for a serial adapter, in bit/s.
const BIT_RATES: [u32; 5] = [125_000, 250_000, 500_000, 800_000, 1_000_000];

/// Place of 500 kbit/s, which is offered first.
const USUAL_RATE: usize = 2;

/// Sections of the list, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum OfferKind {
    /// A CAN interface of this machine.
    Interface,
    /// A serial device.
    Adapter,
    /// A log that was opened before.
    Log,
    /// A simulated bus.
    Simulated,
}

impl OfferKind {
    /// Heading of the section.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Interface => "CAN interfaces",
            Self::Adapter => "Serial adapters",
            Self::Log => "Recent logs",
            Self::Simulated => "Simulated",
        }
    }
}

/// A line of the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusOffer {
    /// Section.
    pub kind: OfferKind,
    /// Name, printable.
    pub name: String,
    /// What is known of it, printable.
    pub facts: String,
    /// BUS argument without a bit rate.
    pub argument: String,
    /// Command that makes it usable; `None` where it is.
    pub command: Option<String>,
    /// A serial device that may be anything: Enter asks first, and nothing is transmitted on it.
    pub is_unknown: bool,
}

/// What is done after a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChoiceOutcome {
    /// Open these BUS arguments.
    Open {
        /// The arguments.
        buses: Vec<String>,
        /// Send no frames.
        listen_only: bool,
    },
    /// Copy a command to the clipboard.
    Copy(String),
    /// End the program.
    Quit,
}

/// State of the list.
#[derive(Clone, Debug)]
pub struct BusChoice {
    /// Why it is shown.
    pub reason: String,
    offers: Vec<BusOffer>,
    /// Place in [`BIT_RATES`] for each line.
    rates: Vec<usize>,
    chosen: Vec<bool>,
    selected: usize,
    listen_only: bool,
    /// The question about an unknown adapter is open.
    asks: bool,
    message: Option<String>,
}

impl BusChoice {
    /// Returns the list of these lines, by section, with the first one selected.
    pub fn new(reason: impl Into<String>, mut offers: Vec<BusOffer>) -> Self {
        offers.sort_by_key(|offer| offer.kind);
        offers.truncate(MAX_OFFERS);
        let usable = offers.iter().position(|offer| offer.command.is_none());
        Self {
            reason: reason.into(),
            rates: vec![USUAL_RATE; offers.len()],
            chosen: vec![false; offers.len()],
            selected: usable.unwrap_or(0),
            offers,
            listen_only: false,
            asks: false,
            message: None,
        }
    }

    /// The lines.
    pub fn offers(&self) -> &[BusOffer] {
        &self.offers
    }

    /// Place of the selected line.
    pub fn selected(&self) -> usize {
        self.selected
    }

    /// Returns true if a line was chosen with Space.
    pub fn is_chosen(&self, at: usize) -> bool {
        self.chosen.get(at).copied().unwrap_or(false)
    }

    /// Bit rate for a serial adapter, in bit/s; `None` for other lines.
    pub fn bit_rate(&self, at: usize) -> Option<u32> {
        let is_adapter = self.offers.get(at)?.kind == OfferKind::Adapter;
        is_adapter.then(|| BIT_RATES[self.rates[at]])
    }

    /// No frames will be sent.
    pub fn is_listen_only(&self) -> bool {
        self.listen_only
    }

    /// Text for the last line: the question or a message; `None` for the keys.
    pub fn note(&self) -> Option<String> {
        if self.asks {
            let names = self.unknown().map(|at| self.offers[at].name.as_str());
            let names = names.collect::<Vec<_>>().join(", ");
            return Some(format!("Open {names} as slcan, listen-only? y n"));
        }
        self.message.clone()
    }

    /// Handles a key.
    pub fn handle_key(&mut self, key: Key) -> Option<ChoiceOutcome> {
        self.message = None;
        if self.asks {
            self.asks = false;
            return (key.code == KeyCode::Char('y')).then(|| self.outcome());
        }
        match key.code {
            KeyCode::Char('c') if key.ctrl => return Some(ChoiceOutcome::Quit),
            KeyCode::Up | KeyCode::Char('k') => self.selected = self.selected.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => {
                self.selected = (self.selected + 1).min(self.offers.len().saturating_sub(1));
            }
            KeyCode::Home => self.selected = 0,
            KeyCode::End => self.selected = self.offers.len().saturating_sub(1),
            KeyCode::Char(' ') => self.toggle(),
            KeyCode::Char('e') => self.next_rate(),
            KeyCode::Char('l') => self.listen_only = !self.listen_only,
            KeyCode::Char('y') => return self.copy(),
            KeyCode::Enter => return self.open(),
            KeyCode::Esc | KeyCode::Char('q') => return Some(ChoiceOutcome::Quit),
            _ => {}
        }
        None
    }

    /// Shows a message until the next key.
    pub fn show(&mut self, message: impl Into<String>) {
        self.message = Some(message.into());
    }

    fn toggle(&mut self) {
        if let Some(chosen) = self.chosen.get_mut(self.selected) {
            *chosen = !*chosen;
        }
    }

    fn next_rate(&mut self) {
        if self.bit_rate(self.selected).is_none() {
            return self.show("the bit rate is chosen for serial adapters only");
        }
        let rate = &mut self.rates[self.selected];
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

    /// The lines to open: those chosen, else the selected one.
    fn wanted(&self) -> Vec<usize> {
        let chosen: Vec<usize> = (0..self.offers.len()).filter(|at| self.chosen[*at]).collect();
        if chosen.is_empty() && self.selected < self.offers.len() {
            return vec![self.selected];
        }
        chosen
    }

    /// Those of them that may be any serial device.
    fn unknown(&self) -> impl Iterator<Item = usize> {
        self.wanted().into_iter().filter(|at| self.offers[*at].is_unknown)
    }

    fn open(&mut self) -> Option<ChoiceOutcome> {
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
        if self.unknown().next().is_some() {
            self.asks = true;
            return None;
        }
        Some(self.outcome())
    }

    fn outcome(&self) -> ChoiceOutcome {
        let argument = |at: usize| match self.bit_rate(at) {
            Some(rate) => format!("{}@{rate}", self.offers[at].argument),
            None => self.offers[at].argument.clone(),
        };
        let buses = self.wanted().into_iter().map(argument).collect();
        let listen_only = self.listen_only || self.unknown().next().is_some();
        ChoiceOutcome::Open { buses, listen_only }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer(kind: OfferKind, name: &str) -> BusOffer {
        let argument = match kind {
            OfferKind::Adapter => format!("slcan:{name}"),
            _ => name.to_owned(),
        };
        let (name, facts) = (name.to_owned(), String::new());
        BusOffer { kind, name, facts, argument, command: None, is_unknown: false }
    }

    fn choice() -> BusChoice {
        let down = BusOffer {
            command: Some("sudo ip link set can1 up".to_owned()),
            ..offer(OfferKind::Interface, "can1")
        };
        let unknown = BusOffer { is_unknown: true, ..offer(OfferKind::Adapter, "/dev/ttyUSB0") };
        BusChoice::new(
            "no bus named",
            vec![
                offer(OfferKind::Simulated, "sim:boiler"),
                unknown,
                down,
                offer(OfferKind::Interface, "can0"),
            ],
        )
    }

    fn press(choice: &mut BusChoice, keys: &str) -> Option<ChoiceOutcome> {
        keys.split(' ').map(|key| choice.handle_key(Key::parse(key).unwrap())).last().flatten()
    }

    #[allow(clippy::unnecessary_wraps)] // Compared with the result of a key.
    fn opens(buses: &[&str], listen_only: bool) -> Option<ChoiceOutcome> {
        let buses = buses.iter().map(|bus| (*bus).to_owned()).collect();
        Some(ChoiceOutcome::Open { buses, listen_only })
    }

    #[test]
    fn enter_opens_selected_line_or_all_chosen() {
        let mut choice = choice();
        assert_eq!(choice.offers()[choice.selected()].name, "can0", "the first usable one");
        assert_eq!(press(&mut choice, "Enter"), opens(&["can0"], false));
        assert_eq!(
            press(&mut choice, "Space End Space l Enter"),
            opens(&["can0", "sim:boiler"], true)
        );
        assert_eq!(press(&mut choice, "q"), Some(ChoiceOutcome::Quit));
    }

    #[test]
    fn interface_that_is_down_offers_its_command() {
        let mut choice = choice();
        assert_eq!(press(&mut choice, "Home Enter"), None);
        assert_eq!(choice.note().as_deref(), Some("can1 is down; y copies the command"));
        let copied = ChoiceOutcome::Copy("sudo ip link set can1 up".to_owned());
        assert_eq!(press(&mut choice, "y"), Some(copied));
    }

    #[test]
    fn unknown_adapter_is_opened_listen_only_after_a_question() {
        let mut choice = choice();
        assert_eq!(press(&mut choice, "End Up Enter"), None);
        let question = "Open /dev/ttyUSB0 as slcan, listen-only? y n";
        assert_eq!(choice.note().as_deref(), Some(question));
        assert_eq!(press(&mut choice, "Enter"), None, "another key is no");
        assert_eq!(choice.note(), None);
        let opened = opens(&["slcan:/dev/ttyUSB0@800000"], true);
        assert_eq!(press(&mut choice, "e Enter y"), opened);
    }

    #[test]
    fn empty_list_opens_nothing() {
        let mut choice = BusChoice::new("", Vec::new());
        assert_eq!(press(&mut choice, "Enter"), None);
        assert_eq!(press(&mut choice, "Down Space e y Enter"), None);
    }
}
