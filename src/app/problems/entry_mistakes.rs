//! Mistakes in a des.json that show by the buses: a `uid` that no device can have, a `bus` that has
//! another des.json.
//!
//! Pure: entries and the buses in, mistakes in words out. Does not know which devices there are.

use crate::app::file_inputs::FileInputs;
use crate::document::{DocumentFinding, DocumentFindingKind, Entry};
use crate::text::Escaped;
use crate::wire::node::Uid;
use crate::wire::profile::UidProfile;

/// Characters of a UID.
const CHARACTERS: usize = 8;

/// Returns the mistakes of the file, with those that show by the profiles of the buses.
pub(in crate::app) fn file_mistakes(file: FileInputs) -> Vec<DocumentFinding> {
    file.document.findings_with(|entry| {
        let uid = entry.uid.as_deref().and_then(|uid| mistake_of(file, entry, uid));
        let uid = uid.map(|text| (DocumentFindingKind::UnusableUid, text));
        let bus = bus_mistake(file, entry);
        let bus = bus.map(|text| (DocumentFindingKind::BusOfAnotherFile, text));
        uid.into_iter().chain(bus)
    })
}

/// Says which file an entry belongs into whose bus is open with another one; `None` for other entries.
fn bus_mistake(file: FileInputs, entry: &Entry) -> Option<String> {
    let named = entry.bus.as_deref()?;
    if file.buses_of(entry).next().is_some() {
        return None;
    }
    let (buses, documents) = (file.all.buses, file.all.documents);
    let (other, _) = buses.indexed().find(|(_, bus)| entry.is_for_bus(&bus.name))?;
    let (bus, name) = (Escaped(named.as_bytes()), documents.name(documents.of_bus(other)));
    Some(format!("`bus` is {bus}, whose file is {name}; move the entry there"))
}

/// Says what is wrong with the UID of an entry; `None` if a device of one of its buses can have it.
pub(in crate::app) fn mistake_of(file: FileInputs, entry: &Entry, uid: &str) -> Option<String> {
    let own = file.buses_of(entry);
    let mut mistakes = own.map(|(_, bus)| mistake_in(uid.trim(), &bus.config().profile.uid));
    let first = mistakes.next()??;
    mistakes.all(|other| other.is_some()).then_some(first)
}

fn mistake_in(uid: &str, alphabet: &UidProfile) -> Option<String> {
    if uid.is_empty() {
        return Some("`uid` is empty; write the UID, or leave `uid` out".to_owned());
    }
    if let Some(parsed) = Uid::parse(uid, alphabet) {
        let is_blank = parsed.is_blank();
        return is_blank.then(|| "`uid` is that of no device; leave `uid` out".to_owned());
    }
    if let Some(meant) = bytes_of(uid).map(|bytes| Uid(bytes).text(alphabet).to_string()) {
        let meant = Escaped(meant.as_bytes());
        return Some(format!("`uid` is in hexadecimal; write it as text: {meant}"));
    }
    if uid.chars().count() > CHARACTERS {
        let length = uid.chars().count();
        return Some(format!("`uid` has {length} characters; it must have 1 to {CHARACTERS}"));
    }
    let wrong = uid.chars().find(|character| alphabet.value(*character).is_none())?;
    let wrong = Escaped(wrong.encode_utf8(&mut [0; 4]).as_bytes()).to_string();
    let upper = uid.to_uppercase();
    let remedy = if Uid::parse(&upper, alphabet).is_some() {
        format!("write it in capitals: {upper}")
    } else {
        let all: String = (0..64).map(|value| alphabet.character(value)).collect();
        format!("it must be of these characters: {}", Escaped(all.as_bytes()))
    };
    Some(format!("`uid` has `{wrong}`, which is not in the UID alphabet; {remedy}"))
}

/// The bytes of a UID in hexadecimal; `None` for other text, and for a UID without text.
fn bytes_of(uid: &str) -> Option<[u8; Uid::LEN]> {
    if uid.len() != 2 * Uid::LEN || !uid.is_ascii() {
        return None;
    }
    let mut bytes = [0; Uid::LEN];
    for (at, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(uid.get(2 * at..2 * at + 2)?, 16).ok()?;
    }
    Uid(bytes).not_blank().map(|uid| uid.0)
}
