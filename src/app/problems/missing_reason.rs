//! Reasons why a listed device is missing, or a device is known incompletely.
//!
//! Checks causes from the nearest (the bus is down) to the farthest (no frame was received); the
//! texts state observations.

use crate::app::buses::{Bus, TxBlocked};
use crate::app::file_inputs::{FileInputs, Inputs};
use crate::discovery::{Device, OwnAddress, QueryFault, QueryState};
use crate::document::Entry;
use crate::frame::BusIndex;
use crate::status::{BusState, Link};
use crate::text::{Escaped, Quoted};
use crate::time::Duration;
use crate::wire::id::Address;

impl FileInputs<'_> {
    /// Returns true if an entry without a device can be reported as missing: the search is complete
    /// on each of its buses, and no device with an unknown name uses its address.
    pub fn is_missing(&self, entry: &Entry) -> bool {
        let perhaps = |device: &Device| {
            entry.address == Some(device.address.number())
                && device.is_present()
                && device.name.is_none()
                && !device.name_query.has_failed_since_response
        };
        self.buses_of(entry).all(|(index, bus)| {
            self.all.buses.is_search_complete(index, self.all.now)
                && !bus.devices().iter().any(perhaps)
        })
    }

    /// Reasons why no device matches an entry, the likeliest first; never empty.
    pub fn missing_reasons(&self, entry: &Entry) -> Vec<String> {
        let buses = self.buses().filter(|(_, bus)| entry.is_for_bus(&bus.name));
        let mut by_bus: Vec<(&str, Vec<String>)> =
            buses.map(|(index, bus)| (bus.name.as_str(), self.why_on(index, bus, entry))).collect();
        let Some((_, first)) = by_bus.first() else {
            let bus = entry.bus.as_deref().unwrap_or_default();
            return vec![format!("listed for bus {}, which is not open", Escaped(bus.as_bytes()))];
        };
        if by_bus.iter().all(|(_, reasons)| reasons == first) {
            return by_bus.swap_remove(0).1;
        }
        let named = |bus: &str, reason: String| {
            if reason.contains(bus) { reason } else { format!("{bus}: {reason}") }
        };
        let reasons = by_bus
            .into_iter()
            .flat_map(|(bus, reasons)| reasons.into_iter().map(move |it| named(bus, it)));
        reasons.collect()
    }

    fn why_on(&self, index: BusIndex, bus: &Bus, entry: &Entry) -> Vec<String> {
        if let Some(obstacle) = bus_obstacle(bus) {
            return vec![obstacle];
        }
        let mut reasons = Vec::new();
        let mut elsewhere = Vec::new();
        let mut taken = Vec::new();
        for device in bus.devices() {
            let owner = self.all.matching.entry_of(device.id);
            let is_it = owner == Some(self.place(entry));
            let is_namesake = device.is_named(&entry.name);
            match (device.is_present(), owner) {
                (false, None) if is_namesake => reasons.push(self.was_at(device)),
                (false, _) if is_it => reasons.push(self.was_at(device)),
                (true, None) if is_namesake => elsewhere.push(device.address),
                (true, Some(_)) if is_namesake && !is_it => taken.push(device),
                _ => {}
            }
        }
        self.why_at_its_address(bus, entry, &mut reasons);
        elsewhere.sort_unstable();
        if let [only] = elsewhere[..] {
            reasons.push(format!("found at another address: {only}"));
        } else if !elsewhere.is_empty() {
            let at: Vec<String> = elsewhere.iter().map(ToString::to_string).collect();
            let not = entry.address.map(|own| format!(", not at {own}")).unwrap_or_default();
            let (name, at) = (Quoted(&entry.name), at.join(" and "));
            reasons.push(format!("{name} found at {at}{not}: ambiguous"));
        }
        let is_explained = !reasons.is_empty() || entry.address.is_none() && !taken.is_empty();
        match self.all.buses.is_search_complete(index, self.all.now) {
            _ if is_explained => {}
            false if bus.status.link == Link::Ended => {
                let what = match bus.controller().state {
                    BusState::BusOff => "no frame in this log: its controller is bus-off",
                    _ if bus.counters().errors > 0 => "no frame but error frames in this log",
                    _ => "no frame in this log",
                };
                reasons.push(what.to_owned());
            }
            false => reasons.push("search still running".to_owned()),
            true => why_silent(bus, entry, &mut reasons),
        }
        reasons.extend(taken.into_iter().map(|device| {
            format!("{} at {} belongs to another entry", Quoted(&entry.name), device.address)
        }));
        reasons
    }

    fn was_at(&self, device: &Device) -> String {
        let ago =
            format_duration(self.all.buses.display_time(self.all.now).since(device.last_seen));
        format!("last seen at {}, {ago} ago", device.address)
    }

    /// Reasons at the address of an entry: another device that uses it or used it before.
    fn why_at_its_address(&self, bus: &Bus, entry: &Entry, reasons: &mut Vec<String>) {
        let Some(address) = entry.address.and_then(Address::new) else { return };
        if bus.own_address() == OwnAddress::Held(address) {
            reasons.push(format!("descan itself uses address {address}"));
        }
        let mut gone = None;
        for other in bus.devices() {
            if other.moved_from == Some(address) && other.is_present() && other.address != address {
                gone = Some(format!(
                    "{} moved from {address} to {}",
                    device_name(other),
                    other.address
                ));
            }
            let is_its = self.all.matching.entry_of(other.id) == Some(self.place(entry));
            if other.address != address || is_its || other.is_named(&entry.name) {
                continue;
            }
            match (&other.name, other.is_present()) {
                (Some(_), true) if entry.is_static => {
                    reasons.push(format!("{} uses its address {address}", device_name(other)));
                }
                (Some(_), true) => {
                    reasons.push(format!("{} has address {address} now", device_name(other)));
                }
                (None, true) => reasons.extend(self.all.why_unnamed(other)),
                (_, false) => {
                    let ago = format_duration(
                        self.all.buses.display_time(self.all.now).since(other.last_seen),
                    );
                    gone = Some(format!(
                        "only {} was at {address}, last seen {ago} ago",
                        device_name(other)
                    ));
                }
            }
        }
        if reasons.is_empty() {
            reasons.extend(gone);
        }
    }
}

impl Inputs<'_> {
    /// Reasons why the name or the services of a device are not known.
    pub fn incomplete_reasons(&self, device: &Device) -> Vec<String> {
        let mut reasons = Vec::new();
        if let Some(bus) = self.buses.get(device.id.bus)
            && (!device.is_present() || bus.cannot_receive())
        {
            reasons.extend(bus_obstacle(bus));
        }
        if device.name.is_none() && !device.is_debug {
            reasons.extend(self.why_unnamed(device));
        } else if device.services.is_none() {
            let query = device.services_query;
            match query.state {
                _ if query.fault == Some(QueryFault::TwoResponses) => {}
                QueryState::NoResponse => reasons
                    .push(format!("name received, no services response{}", asked(query.attempts))),
                QueryState::NotSent if !self.buses.sends_requests(device.id.bus) => {
                    reasons.push("services unknown: requests are off".to_owned());
                }
                _ => {}
            }
        }
        for fault in [device.name_query.fault, device.services_query.fault].into_iter().flatten() {
            reasons.push(match fault {
                QueryFault::TwoResponses => {
                    let what =
                        if device.services.is_some() { "services of one" } else { "services" };
                    format!("{what} not read: two devices respond at once, which destroys frames")
                }
                fault => format!("malformed response: {fault}"),
            });
        }
        reasons
    }

    fn why_unnamed(&self, device: &Device) -> Option<String> {
        let what = if device.heartbeat.count > 0 { "a heartbeat" } else { "frames" };
        let (address, query) = (device.address, device.name_query);
        let own = self.buses.get(device.id.bus).map(Bus::own_address);
        match query.state {
            QueryState::NoResponse => {
                Some(format!("{what} at {address}, but no DES response{}", asked(query.attempts)))
            }
            QueryState::Sent if query.attempts > 0 => Some(format!(
                "{what} at {address}, but no DES response yet{}",
                asked(query.attempts)
            )),
            QueryState::NotSent if !self.buses.sends_requests(device.id.bus) => {
                Some(format!("{what} at {address}; name unknown: requests are off"))
            }
            QueryState::NotSent => Some(match own {
                Some(OwnAddress::Blocked(wanted)) => {
                    let why =
                        self.buses.no_address_reason(device.id.bus, wanted).unwrap_or_default();
                    format!("{what} at {address}, but {why}")
                }
                _ => format!("{what} at {address}, not queried yet"),
            }),
            _ => None,
        }
    }
}

/// Reasons why no frame of a device was received.
fn why_silent(bus: &Bus, entry: &Entry, reasons: &mut Vec<String>) {
    if let Some(reason) = bus.traffic().foreign_reason() {
        return reasons.push(reason);
    }
    let ended = bus.status.link == Link::Ended;
    let log = if ended { "in this log " } else { "" };
    reasons.push(match entry.address {
        Some(address) => format!("{log}no frame received from address {address}"),
        None => format!("{log}no device named {} seen", Quoted(&entry.name)),
    });
    let config = bus.config();
    let others = || bus.devices().iter().filter(|it| !it.is_debug && it.is_present());
    let nameless = others().filter(|it| it.name.is_none()).count();
    if entry.address.is_none() && nameless > 0 {
        reasons.push(match nameless {
            1 => "it may be the one unnamed device".to_owned(),
            count => format!("it may be one of {count} unnamed devices"),
        });
    }
    reasons.push(if ended || config.listen_only || !config.send_requests {
        "requests are off: silent devices are not found".to_owned()
    } else if let OwnAddress::Blocked(_) = bus.own_address() {
        "descan has no address: no requests were sent".to_owned()
    } else if others().next().is_none() {
        "no device responds: check bit rate and termination".to_owned()
    } else {
        "other devices respond: check its power and wiring".to_owned()
    });
}

fn device_name(device: &Device) -> String {
    match &device.name {
        Some(name) if name.as_bytes().is_empty() => "a device with an empty name".to_owned(),
        Some(name) => name.quoted().to_string(),
        None => "an unnamed device".to_owned(),
    }
}

/// The reason why nothing can be received or sent on a bus; `None` if both is possible.
pub fn bus_obstacle(bus: &Bus) -> Option<String> {
    let name = &bus.name;
    let state =
        if bus.status.link == Link::Ended { bus.status.state } else { bus.controller().state };
    Some(match (bus.status.link, state) {
        (Link::Opening, _) => format!("{name} is opening"),
        (link, _) if !matches!(link, Link::Up | Link::Ended) => match &bus.status.fault {
            Some(fault) => Escaped(fault.to_string().as_bytes()).to_string(),
            None => format!("{name} is down"),
        },
        (_, BusState::BusOff) => format!("{name} is bus-off: nothing is received"),
        (_, BusState::Stopped) => format!("{name} is stopped"),
        _ if bus.status.listens_first => {
            format!("{name} is listen-only until a valid frame is received")
        }
        _ => match bus.tx_blocked()? {
            TxBlocked::QueueFull => {
                format!("cannot send requests: transmit queue of {name} is stuck")
            }
            TxBlocked::NoAck => {
                format!("no ACK on {name}: no other node, wrong bit rate or broken wire")
            }
        },
    })
}

fn asked(attempts: u32) -> String {
    if attempts > 0 { format!(" (requested {})", times(attempts)) } else { String::new() }
}

fn times(count: u32) -> String {
    match count {
        1 => "once".to_owned(),
        2 => "twice".to_owned(),
        count => format!("{count} times"),
    }
}

/// Text of a duration in its largest one or two units: `7s`, `3m12s`, `2h05m`, `4d03h`.
pub fn format_duration(duration: Duration) -> String {
    let seconds = duration.as_secs();
    match seconds {
        0..=59 => format!("{seconds}s"),
        60..=3599 => format!("{}m{:02}s", seconds / 60, seconds % 60),
        3600..=86_399 => format!("{}h{:02}m", seconds / 3600, seconds / 60 % 60),
        _ => format!("{}d{:02}h", seconds / 86_400, seconds / 3600 % 24),
    }
}
