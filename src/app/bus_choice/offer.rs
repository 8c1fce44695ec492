//! A line of the list of buses, and what is done with the chosen ones. Plain values; does not know keys.

use std::path::PathBuf;

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

impl BusOffer {
    /// Returns true if each of the words, in lower case, is in its section, name or facts.
    pub(super) fn has_words(&self, words: &str) -> bool {
        let text = format!("{} {} {}", self.kind.title(), self.name, self.facts).to_lowercase();
        words.split_whitespace().all(|word| text.contains(word))
    }
}

/// The buses that are to be opened.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusSelection {
    /// BUS arguments.
    pub buses: Vec<String>,
    /// Send no frames.
    pub listen_only: bool,
    /// Send no requests for names and services.
    pub no_requests: bool,
    /// Record the frames to a new file.
    pub records: bool,
    /// Close the buses that are open; otherwise these are added to them.
    pub replaces: bool,
    /// Theme that was chosen with them; `None` for that of the settings.
    pub theme: Option<String>,
    /// File of the profile to read frames by; `None` for the one before.
    pub profile: Option<PathBuf>,
}

/// What is done after a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChoiceOutcome {
    /// Open these buses.
    Open(BusSelection),
    /// Copy a command to the clipboard.
    Copy(String),
    /// Use the next theme, then call [`BusChoice::set_theme`](super::BusChoice::set_theme).
    NextTheme,
    /// Close the list; without a session, end the program.
    Close,
}

/// What buses have in common that can be open beside each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BusWorld {
    /// Interfaces, adapters and servers.
    Real,
    /// Buses of a simulation.
    Simulated,
    /// A log, which is read by its own clock.
    Log,
}

impl BusWorld {
    /// Returns the world of a BUS argument.
    pub fn of(argument: &str) -> Self {
        match argument.split_once(':') {
            Some(("sim", _)) => Self::Simulated,
            Some(("file", _)) => Self::Log,
            _ => Self::Real,
        }
    }
}

/// Returns the device of an slcan argument without its bit rates; any other argument as it is.
pub(super) fn without_rates(argument: &str) -> &str {
    let is_rates = |text: &str| text.chars().all(|c| c.is_ascii_digit() || c == '/');
    let parts = argument.rsplit_once('@').filter(|_| argument.starts_with("slcan:"));
    parts.filter(|(_, rates)| is_rates(rates)).map_or(argument, |(device, _)| device)
}
