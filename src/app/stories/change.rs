//! What an event changes, with the values before and after it as texts of their moment.
//!
//! Pure: an event and the buses in, a change out. Bounded by the texts of one event. Does not know
//! how changes are grouped or shown.

use crate::app::buses::Buses;
use crate::app::notices::{changes_of, device_label, uid_text};
use crate::discovery::{Event, EventKind, OtherDevice, Presence, ServicesNews};
use crate::finding::{Finding, FindingKey, FindingState, SeenUid};
use crate::frame::BusIndex;
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Mode;

/// What an event changes; the kinds that a line of the timeline is made from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StoryChange {
    /// Nothing that is known besides the text.
    #[default]
    Text,
    /// A device appeared.
    Appeared,
    /// Its name became known.
    Named,
    /// Its first services, by number.
    Services(usize),
    /// Its services changed: `AUGER 2.1→2.2, JAM added`.
    Versions(String),
    /// Services of another device at its address.
    OtherServices,
    /// Mode before, if known, and after.
    Mode(Option<Mode>, Mode),
    /// A device claimed an address.
    Claimed {
        /// Its UID, where it has no row.
        by: Option<String>,
        /// The device that has the address already.
        holder: Option<String>,
    },
    /// A device gave up its address.
    GaveUp {
        /// Its UID, where it has no row.
        by: Option<String>,
        /// The device that has the address now.
        to: Option<String>,
    },
    /// A device moved from one address to another one.
    Moved(Address, Address),
    /// A device rebooted.
    Rebooted,
    /// UID before and after.
    Uid(String, String),
    /// Its row was removed.
    Removed,
    /// Stale, silent, asleep or lost.
    Presence(Presence),
    /// Online again.
    Returned,
    /// A finding was opened, or changed its state.
    Finding {
        /// The finding.
        key: FindingKey,
        /// Its state.
        state: FindingState,
        /// UIDs of the boards, or names of the devices, the newest first; empty for fewer than two.
        parties: Vec<String>,
        /// What is wrong, as a sentence.
        text: String,
        /// Time at which its newest board joined; `None` for fewer than two boards with UIDs.
        since: Option<Instant>,
        /// Time of the last evidence.
        until: Instant,
    },
    /// descan took this address.
    OwnAddress(Address),
    /// descan has no address.
    NoOwnAddress,
    /// No node acknowledges the frames of descan.
    NoAck,
    /// They are acknowledged again.
    Acknowledged,
    /// A DEBUG message with this code.
    Debug(u16),
    /// Another log began: what was known of the bus before is over.
    AnotherLog,
}

impl StoryChange {
    /// Returns the change of an engine event.
    pub fn of_event(buses: &Buses, bus: BusIndex, event: &Event) -> Self {
        let label = |other: &OtherDevice| device_label(buses, other);
        let by = |uid: Option<_>| {
            let has_row = event.device.is_some_and(|id| buses.device(id).is_some());
            uid.filter(|_| !has_row).map(|uid| uid_text(buses, bus, uid))
        };
        match &event.kind {
            EventKind::FirstFrame => Self::Appeared,
            EventKind::NameReceived => Self::Named,
            EventKind::Services { count, news: ServicesNews::First } => Self::Services(*count),
            EventKind::Services { news: ServicesNews::OtherDevice, .. } => Self::OtherServices,
            EventKind::Services { count, .. } => {
                let device = event.device.and_then(|id| buses.device(id));
                let changes = device.map(|device| changes_of(device, "→"));
                Self::Versions(changes.unwrap_or_else(|| format!("{count} services")))
            }
            EventKind::Mode { from, to } => Self::Mode(*from, *to),
            EventKind::Claimed { uid, holder, .. } => {
                Self::Claimed { by: by(*uid), holder: holder.as_ref().map(label) }
            }
            EventKind::GaveUpAddress { uid, to, .. } => {
                Self::GaveUp { by: by(*uid), to: to.as_ref().map(label) }
            }
            EventKind::Moved { from } => Self::Moved(*from, event.address.unwrap_or(*from)),
            EventKind::Rebooted => Self::Rebooted,
            EventKind::UidChanged { from, to } => {
                Self::Uid(uid_text(buses, bus, *from), uid_text(buses, bus, *to))
            }
            EventKind::Removed => Self::Removed,
            EventKind::Presence(presence) => Self::Presence(*presence),
            EventKind::Returned { .. } => Self::Returned,
            EventKind::Finding { key, state } => {
                let finding = buses.finding(bus, key);
                let parties = finding.map_or_else(Vec::new, parties_of);
                let text = finding.map_or_else(String::new, |finding| finding.text.clone());
                let until = finding.map_or(event.time, |finding| finding.last.min(event.time));
                let joined = finding.filter(|finding| finding.uids.len() > 1);
                let joined = joined.and_then(|it| it.uids.iter().map(|seen| seen.since).max());
                Self::Finding {
                    key: key.clone(),
                    state: *state,
                    parties,
                    text,
                    since: joined,
                    until,
                }
            }
            EventKind::OwnAddress(address) => Self::OwnAddress(*address),
            EventKind::OwnAddressLost(_) | EventKind::NoAddress(_) => Self::NoOwnAddress,
            EventKind::NoAck => Self::NoAck,
            EventKind::Acknowledged => Self::Acknowledged,
            EventKind::DebugMessage { code, .. } => Self::Debug(*code),
            EventKind::DescriptorRead { .. }
            | EventKind::DescriptorField(_)
            | EventKind::RequestEnded { .. }
            | EventKind::FrameSent { .. }
            | EventKind::SequenceEnded { .. }
            | EventKind::IdsMerged { .. } => Self::Text,
        }
    }
}

/// The boards of a conflict by their UIDs, else by their names, the newest first.
fn parties_of(finding: &Finding) -> Vec<String> {
    /// Parties that are named.
    const NAMED: usize = 3;
    let uids: Vec<String> = finding.uids.iter().rev().map(SeenUid::label).collect();
    let mut parties = if uids.len() > 1 {
        uids
    } else {
        finding.names.iter().rev().map(ToString::to_string).collect()
    };
    if parties.len() < 2 {
        return Vec::new();
    }
    parties.truncate(NAMED);
    parties
}
