//! The timeline texts of engine events and findings.
//!
//! Pure: an event and the buses in, kind and text out.

use crate::app::buses::{Bus, Buses, TxBlocked};
use crate::app::timeline_kind::TimelineKind;
use crate::discovery::{
    Device, DeviceId, DeviceService, Event, EventKind, OtherDevice, Presence, ServicesNews,
};
use crate::finding::{FindingKey, FindingState};
use crate::frame::BusIndex;
use crate::text::{Escaped, Name, counted, hex, join_first};
use crate::wire::id::Service;
use crate::wire::node::{Mode, Uid};

/// Kind and text of the timeline line of an engine event; `None` for an event without a line.
pub fn event_text(buses: &Buses, bus: BusIndex, event: &Event) -> Option<(TimelineKind, String)> {
    Some(match &event.kind {
        EventKind::FirstFrame => (TimelineKind::Improved, "appeared".to_owned()),
        EventKind::NameReceived => (TimelineKind::Improved, identified(event)),
        EventKind::Services { count, news } => {
            let plural = if *count == 1 { "" } else { "s" };
            let device = event.device.and_then(|id| buses.device(id));
            let (kind, more) = match (news, device) {
                (ServicesNews::First, Some(device)) if device.services_are_shared => {
                    (TimelineKind::Improved, format!(" of {}", whose_services(device)))
                }
                (ServicesNews::First, _) => (TimelineKind::Improved, String::new()),
                (ServicesNews::Changed, None) => (TimelineKind::Change, String::new()),
                (ServicesNews::Changed, Some(device)) => {
                    (TimelineKind::Change, format!(": {}", changes_of(device, " → ")))
                }
                (ServicesNews::OtherDevice, device) => {
                    let whose = device.map_or("another device", whose_other_services);
                    (TimelineKind::Change, format!(" of {whose}"))
                }
            };
            (kind, format!("{count} service{plural}{more}"))
        }
        // The row shows the first mode of a device; ARSLV is reported as an address claim.
        EventKind::Mode { from: None, .. }
        | EventKind::Mode { to: Mode::Arslv, .. }
        | EventKind::DescriptorField(_)
        | EventKind::RequestEnded { .. }
        | EventKind::FrameSent { .. }
        | EventKind::SequenceEnded { .. }
        | EventKind::IdsMerged { .. } => return None,
        EventKind::Mode { from: Some(from), to } => {
            (TimelineKind::Change, format!("{from} → {to}"))
        }
        EventKind::Moved { from } => (TimelineKind::Change, format!("moved from {from}")),
        EventKind::Claimed { uid, holder, inferred: guess } => {
            let holder = holder.as_ref().map(|holder| device_label(buses, holder));
            let held = match (holder, guess) {
                (Some(holder), false) => format!(" (held by {holder})"),
                (Some(holder), true) => format!(" (probably not {holder})"),
                (None, _) => String::new(),
            };
            let by = uid_label(buses, bus, event.device, *uid);
            (TimelineKind::Change, format!("{by}claims {}{held}", address(event)))
        }
        EventKind::GaveUpAddress { uid, to, inferred: guess } => {
            let to = match to {
                Some(to) => format!(" to {}", device_label(buses, to)),
                None => " (claimed by another device)".to_owned(),
            };
            let guess = if *guess { " (probable)" } else { "" };
            let by = uid_label(buses, bus, event.device, *uid);
            (TimelineKind::Change, format!("{by}gave up {}{to}{guess}", address(event)))
        }
        EventKind::Rebooted => (TimelineKind::Change, "rebooted".to_owned()),
        EventKind::DescriptorRead { values, fields } if values == fields => (
            TimelineKind::Improved,
            format!("descriptor read: {}", counted(*fields as u64, "field")),
        ),
        EventKind::DescriptorRead { values, fields } => {
            let text = format!("descriptor read: {values} of {}", counted(*fields as u64, "field"));
            (TimelineKind::Change, text)
        }
        EventKind::Removed => {
            let text = "removed: the bus speaks another protocol";
            (TimelineKind::Change, text.to_owned())
        }
        EventKind::UidChanged { from, to } => {
            let (from, to) = (uid_text(buses, bus, *from), uid_text(buses, bus, *to));
            (TimelineKind::Change, format!("UID {from} → {to}: another board?"))
        }
        EventKind::Presence(Presence::Online) => (TimelineKind::Improved, "online".to_owned()),
        EventKind::Presence(Presence::Stale) => {
            (TimelineKind::Overdue, "stale: heartbeat overdue".to_owned())
        }
        EventKind::Presence(Presence::Silent) => {
            (TimelineKind::Overdue, "silent: frames but no heartbeat".to_owned())
        }
        EventKind::Presence(Presence::Asleep) => (TimelineKind::Overdue, "asleep".to_owned()),
        EventKind::Presence(Presence::Lost) => {
            let still = event.device.map_or_else(Vec::new, |id| buses.still_on(id));
            let own = buses.get(bus).map_or("", |bus| &bus.name);
            let text = if still.is_empty() {
                "lost".to_owned()
            } else {
                format!("lost on {own}, still on {}", still.join(" and "))
            };
            (TimelineKind::Lost, text)
        }
        EventKind::Returned { was } => {
            let elsewhere = event.device.is_some_and(|id| !buses.still_on(id).is_empty());
            let own = buses.get(bus).filter(|_| elsewhere);
            let place = own.map_or(String::new(), |bus| format!(" on {}", bus.name));
            (TimelineKind::Improved, format!("returned{place} (was {was})"))
        }
        EventKind::Finding { key, state } => {
            let found = buses.finding(bus, key);
            let text = found.map_or("", |finding| finding.text.as_str());
            let superseded_by = found.and_then(|finding| finding.superseded_by);
            match superseded_by.filter(|_| *state == FindingState::Cleared) {
                Some(kind) => {
                    (TimelineKind::Cleared, format!("now {}, was: {text}", kind.headline()))
                }
                None => finding_line(*state, key, text),
            }
        }
        EventKind::OwnAddress(address) => (TimelineKind::Bus, format!("using address {address}")),
        EventKind::OwnAddressLost(address) => {
            (TimelineKind::Bus, format!("released address {address}: used by another node"))
        }
        EventKind::NoAddress(wanted) => {
            (TimelineKind::Error, buses.no_address_reason(bus, *wanted).unwrap_or_default())
        }
        EventKind::NoAck => {
            let text = match buses.get(bus).and_then(Bus::tx_blocked) {
                Some(TxBlocked::QueueFull) => "transmit queue stuck: sending paused",
                _ => "no ACK on the bus: sending paused",
            };
            (TimelineKind::Error, text.to_owned())
        }
        EventKind::Acknowledged => {
            (TimelineKind::Bus, "frames are acknowledged: sending resumed".to_owned())
        }
        EventKind::DebugMessage { code, data } => {
            let code = Service::from_bits(*code);
            let types = buses.types_at(bus, event.address, event.time);
            let name = types.debug_text(&buses.profile(bus), code, data);
            let is_described = !types.debug_values(code.number(), data).is_empty();
            let bytes = hex(data, " ");
            let bytes = if is_described { format!("({bytes})") } else { bytes };
            let text = format!("debug message {name} {bytes}");
            (TimelineKind::Change, text.trim_end().to_owned())
        }
    })
}

/// The device whose services were received while several use its address.
pub fn whose_services(device: &Device) -> &'static str {
    if device.other_services.len() < 2 { "one of the two" } else { "one of them" }
}

/// The device whose services are in the last of the other lists.
pub fn whose_other_services(device: &Device) -> &'static str {
    if device.services_are_shared || device.other_services.len() > 1 {
        whose_services(device)
    } else {
        "the other device here"
    }
}

/// What changed in the services of a device: `AUGER 2.1 → 2.2, JAM added`, with this arrow.
pub fn changes_of(device: &Device, arrow: &str) -> String {
    /// Number of changes that are listed; the others are counted.
    const LISTED: usize = 4;
    let services = |list: &'_ Option<Vec<DeviceService>>| list.clone().unwrap_or_default();
    let (before, now) = (services(&device.previous_services), services(&device.services));
    let in_list = |list: &[DeviceService], name: &Name| list.iter().any(|it| it.name == *name);
    let mut changes = Vec::new();
    for service in &now {
        let name = &service.name;
        let versions = before.iter().filter(|it| it.name == *name).map(|it| &it.version);
        match versions.clone().next() {
            None => changes.push(format!("{name} added")),
            Some(_) if versions.clone().any(|version| *version == service.version) => {}
            Some(version) => changes.push(format!("{name} {version}{arrow}{}", service.version)),
        }
    }
    let removed = before.iter().filter(|it| !in_list(&now, &it.name));
    changes.extend(removed.map(|service| format!("{} removed", service.name)));
    if changes.is_empty() {
        return "order or further strings changed".to_owned();
    }
    join_first(changes, LISTED, ", ")
}

/// The word of an event in `watch --json`, and in the filter.
pub fn event_word(event: &EventKind) -> &'static str {
    match event {
        EventKind::FirstFrame => "appeared",
        EventKind::NameReceived => "named",
        EventKind::Services { .. } => "services",
        EventKind::Mode { .. } => "mode",
        EventKind::Claimed { .. } => "claimed",
        EventKind::GaveUpAddress { .. } => "gave-up",
        EventKind::Moved { .. } => "moved",
        EventKind::IdsMerged { .. } => "merged",
        EventKind::Rebooted => "rebooted",
        EventKind::UidChanged { .. } => "uid",
        EventKind::Removed => "removed",
        EventKind::DescriptorField(_) => "field",
        EventKind::DescriptorRead { .. } => "descriptor",
        EventKind::RequestEnded { .. } => "response",
        EventKind::FrameSent { .. } | EventKind::SequenceEnded { .. } => "sent",
        EventKind::Presence(presence) => presence.name(),
        EventKind::Returned { .. } => "returned",
        EventKind::Finding { .. } => "finding",
        EventKind::OwnAddress(_) | EventKind::OwnAddressLost(_) | EventKind::NoAddress(_) => {
            "address"
        }
        EventKind::NoAck | EventKind::Acknowledged => "ack",
        EventKind::DebugMessage { .. } => "debug",
    }
}

/// Names of the devices besides its own that an event is about.
pub fn other_names(event: &EventKind) -> Vec<Name> {
    match event {
        EventKind::Claimed { holder: Some(other), .. }
        | EventKind::GaveUpAddress { to: Some(other), .. } => other.name.iter().cloned().collect(),
        _ => Vec::new(),
    }
}

/// Name of the other device of an event, else its UID.
pub fn device_label(buses: &Buses, party: &OtherDevice) -> String {
    let known = || buses.device(party.device)?.name.as_ref();
    match (party.name.as_ref().or_else(known), party.uid) {
        (Some(name), _) => name.to_string(),
        (None, Some(uid)) => format!("UID {}", uid_text(buses, party.device.bus, uid)),
        (None, None) => "another device".to_owned(),
    }
}

/// UID of a device without a row, and therefore without a name, with a space; else empty.
fn uid_label(buses: &Buses, bus: BusIndex, device: Option<DeviceId>, uid: Option<Uid>) -> String {
    let has_row = device.is_some_and(|id| buses.device(id).is_some());
    match uid {
        Some(uid) if !has_row => format!("{} ", uid_text(buses, bus, uid)),
        _ => String::new(),
    }
}

/// Text of a UID in the alphabet of its bus, with all characters printable.
pub fn uid_text(buses: &Buses, bus: BusIndex, uid: Uid) -> String {
    let alphabet = buses.get(bus).map(|bus| &bus.config().profile.uid);
    let text = alphabet.map_or_else(String::new, |alphabet| uid.text(alphabet).to_string());
    Escaped(text.as_bytes()).to_string()
}

fn identified(event: &Event) -> String {
    let named = |name: &Name| format!("identified as {name}");
    event.name.as_ref().map_or_else(|| "identified".to_owned(), named)
}

fn address(event: &Event) -> String {
    event.address.map_or_else(String::new, |address| address.to_string())
}

/// Joins two lines that one frame caused: a device appeared, moved or rebooted, and claims its
/// address. `None` for any other pair.
pub fn join_lines(first: &str, second: &str) -> Option<String> {
    let moved = second.starts_with("moved");
    match first {
        "appeared" if moved => Some(second.to_owned()),
        "appeared" | "rebooted" if !moved => Some(format!("{first}, {second}")),
        _ if first.starts_with("moved") && !moved => Some(format!("{first}, {second}")),
        _ => None,
    }
}

/// Joins changes to one line where they fit into it.
pub fn join_short(changes: Vec<String>) -> Vec<String> {
    /// Width of the changes in a line of 80 columns.
    const WIDTH: usize = 36;
    let joined = changes.join("; ");
    if changes.len() > 1 && joined.chars().count() <= WIDTH { vec![joined] } else { changes }
}

/// Kind and text of the timeline line of a finding; the name of its kind where it has no text yet.
pub fn finding_line(state: FindingState, key: &FindingKey, text: &str) -> (TimelineKind, String) {
    let kind = match state {
        FindingState::Cleared => TimelineKind::Cleared,
        FindingState::Suspected => TimelineKind::Suspected,
        FindingState::Confirmed => TimelineKind::Confirmed,
    };
    let text = if text.is_empty() { key.kind.name() } else { text };
    (kind, format!("{state}: {text}"))
}
