//! Static addresses that the user set in this session, and those of them that another program has
//! overwritten since.
//!
//! Pure: versions of the file in, edits that restore the addresses out. An entry is the same one if
//! bus, name and UID are equal.

use super::state::SavedEdits;
use crate::document::{Document, Entry, Operation};

/// Largest number of pins that are known as those of the user after another one took their place. As many
/// as steps that can be undone.
const MAX_FORMER: usize = 200;

/// Static addresses that the user set.
#[derive(Debug, Default)]
pub(super) struct OwnPins {
    pins: Vec<Pin>,
    /// All that the user set, the newest one last: an undone edit brings one of them back, or one that
    /// was in the file before.
    former: Vec<Pin>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Pin {
    bus: Option<String>,
    name: Vec<u8>,
    uid: Option<String>,
    address: u8,
}

impl Pin {
    fn of(entry: &Entry) -> Option<Self> {
        let address = entry.address.filter(|_| entry.is_static)?;
        let (bus, name, uid) = (entry.bus.clone(), entry.name.clone(), entry.uid.clone());
        Some(Self { bus, name, uid, address })
    }

    fn is_same_entry(&self, other: &Self) -> bool {
        (&self.bus, &self.name, &self.uid) == (&other.bus, &other.name, &other.uid)
    }

    fn is_of(&self, entry: &Entry) -> bool {
        (&self.bus, &self.name, &self.uid) == (&entry.bus, &entry.name, &entry.uid)
    }
}

fn pins_of(document: &Document) -> Vec<Pin> {
    document.entries().iter().filter_map(Pin::of).collect()
}

impl OwnPins {
    /// Takes edits of the user that are on disk. A pin that an edit sets replaces the one of the same
    /// entry, overwritten or not.
    pub fn note_saved(&mut self, edits: &SavedEdits) {
        let SavedEdits { before, after, chosen } = edits;
        let (was, is) = (pins_of(before), pins_of(after));
        let new: Vec<Pin> = is.into_iter().filter(|pin| !was.contains(pin)).collect();
        let edited = |pin: &Pin| {
            let entries = |document: &Document| -> Vec<Entry> {
                document.entries().iter().filter(|entry| pin.is_of(entry)).cloned().collect()
            };
            entries(before).len() != entries(after).len()
                || entries(before).iter().zip(entries(after)).any(|(one, other)| {
                    (one.address, one.is_static) != (other.address, other.is_static)
                })
        };
        let kept = pins_of(after);
        // A renamed entry has the pin of the one before.
        let gone: Vec<Pin> = self.pins.iter().filter(|pin| !kept.contains(pin)).cloned().collect();
        let is_renamed = |pin: &Pin| {
            let mut gone = gone.iter();
            gone.any(|it| (&it.bus, &it.uid, it.address) == (&pin.bus, &pin.uid, pin.address))
        };
        self.pins.retain(|pin| kept.contains(pin) || !edited(pin));
        for pin in new {
            let is_only = after.entries().iter().filter(|entry| pin.is_of(entry)).count() == 1;
            self.pins.retain(|known| *known != pin && !(is_only && known.is_same_entry(&pin)));
            if chosen.contains(&pin.address) || self.former.contains(&pin) || is_renamed(&pin) {
                self.former.retain(|known| *known != pin);
                self.former.push(pin.clone());
                self.pins.push(pin);
            }
        }
        let excess = self.former.len().saturating_sub(MAX_FORMER);
        self.former.drain(..excess);
    }

    /// Forgets the pins that this content overwrites: the user has chosen it.
    pub fn accept(&mut self, document: &Document) {
        let there = pins_of(document);
        self.pins.retain(|pin| there.contains(pin));
    }

    /// The edits that restore the addresses that differ in this content. An entry that was removed,
    /// or that has an equal one, is left as it is.
    pub fn restoring(&self, document: &Document) -> Vec<Operation> {
        if self.pins.is_empty() {
            return Vec::new();
        }
        let there = pins_of(document);
        let overwritten = self.pins.iter().filter(|pin| !there.contains(pin));
        let restore = |pin: &Pin| {
            let is_own = |entry: &Entry| Pin::of(entry).is_some_and(|it| self.pins.contains(&it));
            let entries = document.entries().iter();
            let mut candidates = entries.filter(|entry| pin.is_of(entry) && !is_own(entry));
            match (candidates.next(), candidates.next()) {
                (Some(entry), None) => Some(Operation::PinAddress {
                    entry: document.key(entry.index),
                    from: entry.address,
                    to: pin.address,
                }),
                _ => None,
            }
        };
        overwritten.filter_map(restore).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn document(text: &str) -> Document {
        Document::parse(text.as_bytes()).unwrap()
    }

    /// Notes a save that sets the addresses in which both contents differ.
    fn note(pins: &mut OwnPins, before: &Document, after: &Document) {
        let chosen = pins_of(after).iter().map(|pin| pin.address).collect();
        pins.note_saved(&SavedEdits { before: before.clone(), after: after.clone(), chosen });
    }

    const LOOSE: &str = r#"[{"name":"FEED","address":10},{"name":"SENS","address":12}]"#;
    const PINNED: &str =
        r#"[{"name":"FEED","address":31,"static":true},{"name":"SENS","address":12}]"#;

    #[test]
    fn overwritten_pin_is_restored_in_its_entry() {
        let mut pins = OwnPins::default();
        note(&mut pins, &document(LOOSE), &document(PINNED));
        assert_eq!(pins.restoring(&document(PINNED)), []);
        let theirs = document(LOOSE);
        let restored = pins.restoring(&theirs);
        assert_eq!(restored.len(), 1);
        let restored = theirs.apply(&restored[0]).unwrap();
        assert_eq!(pins_of(&restored), pins_of(&document(PINNED)));
        assert_eq!(pins.restoring(&document("[]")), [], "a removed entry stays removed");
    }

    #[test]
    fn pin_is_restored_each_time_it_is_overwritten() {
        let mut pins = OwnPins::default();
        note(&mut pins, &document(LOOSE), &document(PINNED));
        for theirs in [LOOSE.to_owned(), PINNED.replace("31", "55"), PINNED.replace("31", "56")] {
            let theirs = document(&theirs);
            let restoring = pins.restoring(&theirs);
            assert_eq!(restoring.len(), 1);
            let restored = theirs.apply(&restoring[0]).unwrap();
            assert_eq!(pins_of(&restored), pins_of(&document(PINNED)));
            note(&mut pins, &theirs, &restored);
        }
    }

    #[test]
    fn newest_pin_of_an_entry_replaces_an_earlier_one() {
        let mut pins = OwnPins::default();
        note(&mut pins, &document(LOOSE), &document(PINNED));
        // Another program overwrote the first one before the second one was saved.
        let newest = document(&PINNED.replace("31", "32"));
        note(&mut pins, &document(LOOSE), &newest);
        assert_eq!(pins.restoring(&newest), []);
        let theirs = document(LOOSE);
        let [restoring] = &pins.restoring(&theirs)[..] else { panic!("one pin") };
        assert_eq!(theirs.apply(restoring).unwrap().source(), newest.source());
    }

    #[test]
    fn pin_that_the_user_removes_is_forgotten() {
        let mut pins = OwnPins::default();
        note(&mut pins, &document(LOOSE), &document(PINNED));
        note(&mut pins, &document(PINNED), &document(LOOSE));
        assert_eq!(pins.restoring(&document(LOOSE)), []);
    }

    #[test]
    fn pin_that_undo_brings_back_is_of_who_set_it() {
        let undone = |before: &str, after: &str| SavedEdits {
            before: document(before),
            after: document(after),
            chosen: Vec::new(),
        };
        let [first, second, third] = ["31", "32", "33"].map(|to| PINNED.replace("31", to));
        let mut pins = OwnPins::default();
        // 31 was in the file.
        note(&mut pins, &document(&first), &document(&second));
        pins.note_saved(&undone(&second, &first));
        assert_eq!(pins.restoring(&document(&third)), []);
        pins.note_saved(&undone(&first, &second));
        assert_eq!(pins.restoring(&document(&first)).len(), 1, "redone");
        note(&mut pins, &document(&second), &document(&third));
        pins.note_saved(&undone(&third, &second));
        assert_eq!(pins.restoring(&document(&first)).len(), 1, "32 was set by the user");
    }

    #[test]
    fn pin_of_a_renamed_entry_stays_that_of_the_user() {
        let mut pins = OwnPins::default();
        note(&mut pins, &document(LOOSE), &document(PINNED));
        let renamed = PINNED.replace("FEED", "FEED2");
        let (before, after) = (document(PINNED), document(&renamed));
        pins.note_saved(&SavedEdits { before, after, chosen: Vec::new() });
        let theirs = document(&renamed.replace("31", "55"));
        assert_eq!(pins.restoring(&theirs).len(), 1);
    }
}
