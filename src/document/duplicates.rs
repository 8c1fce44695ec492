//! Contradictory entries that share a bus: the same static address, the same name and address, or the
//! same UID twice. Pure; returns [`DocumentFinding`]s with line numbers.

use super::entry::Entry;
use super::finding::{DocumentFinding, DocumentFindingKind};
use super::position::Position;
use super::text::brief;
use std::collections::HashMap;
use std::fmt::Write as _;

/// Finds contradictory entries.
///
/// An entry without `bus` applies to all buses. Entries with the same name and address are reported
/// once, as duplicate entries, static or not.
pub(super) fn duplicates(entries: &[Entry]) -> Vec<DocumentFinding> {
    let mut same_entry: HashMap<(u8, &[u8]), Vec<&Entry>> = HashMap::new();
    let mut same_address: HashMap<u8, Vec<&Entry>> = HashMap::new();
    let mut same_uid: HashMap<&str, Vec<&Entry>> = HashMap::new();
    for entry in entries {
        if let Some(uid) = entry.trimmed_uid() {
            same_uid.entry(uid).or_default().push(entry);
        }
        let Some(address) = entry.address else { continue };
        same_entry.entry((address, &entry.name)).or_default().push(entry);
        if entry.is_static {
            same_address.entry(address).or_default().push(entry);
        }
    }
    let mut findings = Vec::new();
    for ((address, name), group) in same_entry {
        for group in on_one_bus(group) {
            let message = format!(
                "{} at address {address} is listed {} times: {}",
                brief(name),
                group.len(),
                enumerate(&group, |entry| format!("line {}", entry.position.line)),
            );
            let at = group[1].address_position;
            findings.push(duplicate(DocumentFindingKind::DuplicateEntry, message, at, &group));
        }
    }
    for (address, group) in same_address {
        for group in on_one_bus(group) {
            if group.iter().all(|entry| entry.name == group[0].name) {
                continue;
            }
            let message = format!(
                "{address} is the static address of {} entries: {}",
                group.len(),
                enumerate(&group, |entry| {
                    format!("{} (line {})", brief(&entry.name), entry.position.line)
                }),
            );
            let at = group[1].address_position;
            findings.push(duplicate(DocumentFindingKind::DuplicateAddress, message, at, &group));
        }
    }
    for (uid, group) in same_uid {
        findings.extend(on_one_bus(group).iter().filter_map(|group| duplicate_uid(uid, group)));
    }
    findings
}

/// Returns the groups of two or more entries that share a bus.
fn on_one_bus(group: Vec<&Entry>) -> Vec<Vec<&Entry>> {
    if group.len() < 2 {
        return Vec::new();
    }
    if group.iter().any(|entry| entry.bus.is_none()) {
        return vec![group];
    }
    let mut buses: HashMap<Option<&str>, Vec<&Entry>> = HashMap::new();
    for entry in group {
        buses.entry(entry.named_bus()).or_default().push(entry);
    }
    buses.into_values().filter(|group| group.len() > 1).collect()
}

/// The finding about a UID of several entries; `None` if all are duplicate entries anyway.
fn duplicate_uid(uid: &str, group: &[&Entry]) -> Option<DocumentFinding> {
    let place = |entry: &&Entry| Some((entry.address?, entry.name.clone()));
    let first = place(&group[0]);
    if first.is_some() && group.iter().all(|entry| place(entry) == first) {
        return None;
    }
    let message = format!(
        "{} is the `uid` of {} entries: {}",
        brief(uid.as_bytes()),
        group.len(),
        enumerate(group, |entry| format!("{} (line {})", brief(&entry.name), entry.position.line)),
    );
    Some(duplicate(DocumentFindingKind::DuplicateUid, message, group[1].uid_position, group))
}

fn duplicate(
    kind: DocumentFindingKind,
    message: String,
    at: Option<Position>,
    group: &[&Entry],
) -> DocumentFinding {
    DocumentFinding {
        kind,
        position: at.unwrap_or(group[1].position),
        message,
        entries: group.iter().map(|entry| entry.index).collect(),
    }
}

/// Lists entries as "A, B and C", at most four of them.
fn enumerate(group: &[&Entry], describe: impl Fn(&Entry) -> String) -> String {
    const SHOWN: usize = 4;
    let mut out = String::new();
    for (i, entry) in group.iter().enumerate().take(SHOWN) {
        out.push_str(match i {
            0 => "",
            i if i + 1 == group.len() => " and ",
            _ => ", ",
        });
        out.push_str(&describe(entry));
    }
    if group.len() > SHOWN {
        let _ = write!(out, " and {} more", group.len() - SHOWN);
    }
    out
}
