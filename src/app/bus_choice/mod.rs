//! The choice of buses, before a session and during one: the lines of the list, and what its keys do.
//!
//! Inputs: what the machine has, keys. Output: the BUS arguments to open. A state machine without I/O:
//! nothing is opened and nothing is sent while it is shown. Bounded: 64 lines, 40 characters of a
//! search. Does not know how it is drawn.

mod keys;
mod offer;

pub use offer::{BusOffer, BusSelection, ChoiceOutcome, OfferKind};

use crate::keymap::Keymap;
use offer::without_rates;
use std::collections::{BTreeMap, BTreeSet};

/// Most lines of the list.
const MAX_OFFERS: usize = 64;
/// Most characters of a search: half a line of 80 columns.
const MAX_SEARCH: usize = 40;

/// Bit rates that are offered for a serial adapter, in bit/s.
pub const BIT_RATES: [u32; 5] = [125_000, 250_000, 500_000, 800_000, 1_000_000];

/// Place of 500 kbit/s, which is offered first.
const USUAL_RATE: usize = 2;

/// The buses of the session over which the list is shown.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OpenBuses {
    /// Their BUS arguments.
    pub arguments: Vec<String>,
    /// One of them is a log: no bus can be added.
    pub has_log: bool,
}

/// A question about the chosen lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChoiceQuestion {
    /// Whether to open devices that may be anything.
    UnknownAdapter,
    /// Whether to close the buses that are open.
    Replace,
}

/// State of the list.
#[derive(Clone, Debug)]
pub struct BusChoice {
    /// Why it is shown.
    pub reason: String,
    offers: Vec<BusOffer>,
    /// Place in [`BIT_RATES`], by argument.
    rates: BTreeMap<String, usize>,
    /// Arguments of the lines chosen with Space.
    chosen: BTreeSet<String>,
    selected: usize,
    /// Words that the lines must have.
    search: String,
    is_typing: bool,
    listen_only: bool,
    no_requests: bool,
    records: bool,
    keymap: Keymap,
    /// The session below; `None` before one.
    open: Option<OpenBuses>,
    /// Chosen buses take the place of those that are open.
    in_place: bool,
    /// The theme that was chosen.
    theme: Option<String>,
    /// Interfaces that are opened once they are all up.
    awaited: Vec<String>,
    question: Option<ChoiceQuestion>,
    message: Option<String>,
}

impl BusChoice {
    /// Returns the list of these lines, by section, with the first usable one selected.
    pub fn new(reason: impl Into<String>, offers: Vec<BusOffer>) -> Self {
        let mut choice = Self {
            reason: reason.into(),
            offers: Vec::new(),
            rates: BTreeMap::new(),
            chosen: BTreeSet::new(),
            selected: 0,
            search: String::new(),
            is_typing: false,
            listen_only: false,
            no_requests: false,
            records: false,
            keymap: Keymap::default(),
            open: None,
            in_place: false,
            theme: None,
            awaited: Vec::new(),
            question: None,
            message: None,
        };
        choice.set_offers(offers);
        choice.select_usable();
        choice
    }

    /// Waits for these interfaces: they are opened once they are up.
    #[must_use]
    pub fn waiting_for(mut self, interfaces: Vec<String>) -> Self {
        self.awaited = interfaces;
        self.select_usable();
        self
    }

    /// Uses these keys instead of the default ones.
    #[must_use]
    pub fn with_keymap(mut self, keymap: Keymap) -> Self {
        self.keymap = keymap;
        self
    }

    /// Shows the list over a session with these buses.
    #[must_use]
    pub fn over(mut self, open: OpenBuses) -> Self {
        self.in_place = open.has_log;
        self.open = Some(open);
        self.select_usable();
        self
    }

    fn select_usable(&mut self) {
        let is_wanted = |at: &usize| self.awaited.contains(&self.offers[*at].argument);
        let is_usable = |at: &usize| self.offers[*at].command.is_none() && !self.is_open(*at);
        let mut places = 0..self.offers.len();
        let wanted = places.clone().find(is_wanted);
        self.selected = wanted.or_else(|| places.find(is_usable)).unwrap_or(0);
    }

    fn set_offers(&mut self, mut offers: Vec<BusOffer>) {
        offers.sort_by_key(|offer| offer.kind);
        offers.truncate(MAX_OFFERS);
        self.offers = offers;
    }

    /// Takes what the machine has now; the selection stays on its line. Returns true if a line
    /// changed.
    pub fn handle_offers(&mut self, offers: Vec<BusOffer>) -> bool {
        let before = std::mem::take(&mut self.offers);
        self.set_offers(offers);
        let old = before.get(self.selected).map(|offer| &offer.argument);
        let same = old.and_then(|old| self.offers.iter().position(|it| it.argument == *old));
        match same {
            Some(at) => self.selected = at,
            None if before.is_empty() => self.select_usable(),
            None => self.selected = self.selected.min(self.offers.len().saturating_sub(1)),
        }
        self.offers != before
    }

    /// The awaited interfaces, once they are all up and no other choice was begun.
    pub fn take_awaited(&mut self) -> Option<BusSelection> {
        let is_up = |name: &String| {
            self.offers.iter().any(|offer| offer.argument == *name && offer.command.is_none())
        };
        let is_due = !self.awaited.is_empty() && self.awaited.iter().all(is_up);
        if !is_due || !self.chosen.is_empty() || self.question.is_some() {
            return None;
        }
        let buses = std::mem::take(&mut self.awaited);
        Some(BusSelection { buses, ..self.options() })
    }

    // ---- reading ---------------------------------------------------------------------------

    /// The lines.
    pub fn offers(&self) -> &[BusOffer] {
        &self.offers
    }

    /// Places of the lines that have the words of the search.
    pub fn shown(&self) -> Vec<usize> {
        let words = self.search.to_lowercase();
        (0..self.offers.len()).filter(|at| self.offers[*at].has_words(&words)).collect()
    }

    /// Place of the selected line.
    pub fn selected(&self) -> usize {
        self.selected
    }

    /// Returns true if a line was chosen with Space.
    pub fn is_chosen(&self, at: usize) -> bool {
        self.offers.get(at).is_some_and(|offer| self.chosen.contains(&offer.argument))
    }

    /// Returns true if the session below has the bus of a line.
    pub fn is_open(&self, at: usize) -> bool {
        let Some((open, offer)) = self.open.as_ref().zip(self.offers.get(at)) else { return false };
        open.arguments.iter().any(|argument| without_rates(argument) == offer.argument)
    }

    /// Bit rate for a serial adapter, in bit/s; `None` for other lines.
    pub fn bit_rate(&self, at: usize) -> Option<u32> {
        let offer = self.offers.get(at)?;
        let rate = self.rates.get(&offer.argument).copied().unwrap_or(USUAL_RATE);
        (offer.kind == OfferKind::Adapter).then(|| BIT_RATES[rate])
    }

    /// Its keys.
    pub fn keymap(&self) -> &Keymap {
        &self.keymap
    }

    /// No frames will be sent.
    pub fn is_listen_only(&self) -> bool {
        self.listen_only
    }

    /// No requests will be sent.
    pub fn is_without_requests(&self) -> bool {
        self.no_requests
    }

    /// The frames will be recorded; `None` over a session, which records or does not.
    pub fn is_recorded(&self) -> Option<bool> {
        self.open.is_none().then_some(self.records)
    }

    /// Chosen buses will take the place of those that are open; `None` without a session.
    pub fn is_in_place(&self) -> Option<bool> {
        self.open.as_ref().map(|_| self.in_place)
    }

    /// The words of the search, and whether they are being typed; `None` without a search.
    pub fn search(&self) -> Option<(&str, bool)> {
        (self.is_typing || !self.search.is_empty()).then_some((&*self.search, self.is_typing))
    }

    /// Text for the last line: the question or a message; `None` for the keys.
    pub fn note(&self) -> Option<String> {
        match self.question {
            Some(ChoiceQuestion::UnknownAdapter) => {
                let names = self.unknown().map(|at| self.offers[at].name.as_str());
                let names = names.collect::<Vec<_>>().join(", ");
                Some(format!("Open {names} as slcan, listen-only? y n"))
            }
            Some(ChoiceQuestion::Replace) => {
                let open = self.open.as_ref().map(|open| open.arguments.join(", "));
                Some(format!("Close {} and drop its frames? y n", open.unwrap_or_default()))
            }
            None => self.message.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keymap::Key;

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
        Some(ChoiceOutcome::Open(BusSelection { buses, listen_only, ..BusSelection::default() }))
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
        assert_eq!(press(&mut choice, "q"), Some(ChoiceOutcome::Close));
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

    fn interface(name: &str, command: Option<&str>) -> BusOffer {
        let command = command.map(str::to_owned);
        BusOffer { command, ..offer(OfferKind::Interface, name) }
    }

    #[test]
    fn awaited_interface_is_opened_once_it_is_up() {
        let mut choice = choice().waiting_for(vec!["can1".to_owned()]);
        assert_eq!(choice.offers()[choice.selected()].name, "can1");
        assert_eq!(choice.take_awaited(), None);
        let other = offer(OfferKind::Simulated, "sim:boiler");
        assert!(choice.handle_offers(vec![interface("can1", None), other.clone()]));
        let opened = choice.clone().take_awaited().unwrap();
        assert_eq!(opened.buses, ["can1"]);
        assert!(!choice.handle_offers(vec![interface("can1", None), other]), "nothing changed");
        // Another choice was begun.
        press(&mut choice, "End Space");
        assert_eq!(choice.take_awaited(), None);
    }

    #[test]
    fn selection_stays_on_its_line_when_others_appear() {
        let mut choice = BusChoice::new("", vec![interface("can3", None)]);
        press(&mut choice, "Space");
        choice.handle_offers(vec![interface("can1", None), interface("can3", None)]);
        assert_eq!(choice.selected(), 1);
        assert!(choice.is_chosen(1) && !choice.is_chosen(0));
        choice.handle_offers(Vec::new());
        assert_eq!(press(&mut choice, "Enter"), None);
    }

    #[test]
    fn search_leaves_lines_with_all_words() {
        let mut choice = choice();
        let names = |choice: &BusChoice| -> Vec<String> {
            choice.shown().into_iter().map(|at| choice.offers()[at].name.clone()).collect()
        };
        press(&mut choice, "/ S E r i a l Space t t y");
        assert_eq!(names(&choice), ["/dev/ttyUSB0"]);
        assert_eq!(choice.offers()[choice.selected()].name, "/dev/ttyUSB0");
        assert_eq!(choice.search(), Some(("SErial tty", true)));
        press(&mut choice, "x Enter");
        assert_eq!(press(&mut choice, "Enter"), None, "no line");
        assert_eq!(press(&mut choice, "Esc"), None, "all lines again");
        assert_eq!((names(&choice).len(), choice.search()), (4, None));
    }

    #[test]
    fn bus_is_added_beside_its_like_and_replaces_others() {
        let over = |open: &[&str], has_log: bool| {
            let arguments = open.iter().map(|it| (*it).to_owned()).collect();
            choice().over(OpenBuses { arguments, has_log })
        };
        let replaces = |outcome: Option<ChoiceOutcome>| match outcome {
            Some(ChoiceOutcome::Open(selection)) => Some(selection.replaces),
            _ => None,
        };
        assert_eq!(replaces(press(&mut over(&["can7"], false), "Home Down Enter")), Some(false));
        let mut simulated = over(&["can7"], false);
        assert_eq!(press(&mut simulated, "End Enter"), None);
        let question = "Close can7 and drop its frames? y n";
        assert_eq!(simulated.note().as_deref(), Some(question));
        assert_eq!(replaces(press(&mut simulated, "y")), Some(true));
        let mut wanted = over(&["can7"], false);
        assert_eq!(replaces(press(&mut wanted, "Home Down i Enter y")), Some(true));
        let mut log = over(&["session.log"], true);
        assert_eq!(replaces(press(&mut log, "Home Down Enter y")), Some(true));
        assert_eq!(press(&mut log, "i"), None);
        assert_eq!(log.is_in_place(), Some(true), "a log has no bus beside it");
        let mut same = over(&["can0"], false);
        assert_eq!(press(&mut same, "Home Down Enter"), None);
        assert_eq!(same.note().as_deref(), Some("can0 is open already"));
    }
}
