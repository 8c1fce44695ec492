//! Why a device that should be there is not, as far as can be told.
//!
//! Looks at the bus from the nearest cause to the farthest. Says what was observed; what follows
//! from it is marked as a guess.

use super::App;
use super::buses::Bus;
use super::matching::is_for;
use crate::discovery::{Device, OwnAddress, QueryState};
use crate::document::Entry;
use crate::frame::BusIndex;
use crate::status::{BusState, Link};
use crate::text::Escaped;
use crate::time::Duration;
use crate::wire::id::Address;

/// How long to listen before a listed device counts as missing, where nobody is asked.
const LISTEN: Duration = Duration::from_secs(5);

impl App {
    /// Whether a bus was asked or heard long enough to call a device missing.
    pub fn has_looked(&self, bus: BusIndex) -> bool {
        let Some(bus) = self.bus(bus) else { return false };
        let progress = bus.engine.progress();
        let listened = self.now.since(self.started) >= LISTEN;
        progress.settled || progress.rounds >= 2 || listened
    }

    /// Whether an entry that no device matches can be said to be missing: every bus it is for was
    /// looked at, and nobody without a known name sits where it should be.
    pub fn is_missing(&self, entry: &Entry) -> bool {
        let perhaps = |device: &Device| {
            entry.address == Some(device.address.number())
                && device.is_here()
                && device.name.is_none()
                && device.name_query.state != QueryState::Unanswered
        };
        let buses = self.buses.iter().enumerate().filter(|(_, bus)| is_for(entry, &bus.name));
        buses.into_iter().all(|(index, bus)| {
            self.has_looked(BusIndex(index as u8)) && !bus.engine.devices().iter().any(perhaps)
        })
    }

    /// Why no device matches this entry: the likeliest cause first.
    pub fn why_missing(&self, entry: &Entry) -> Vec<String> {
        let mut reasons = Vec::new();
        for (index, bus) in self.buses.iter().enumerate().filter(|(_, it)| is_for(entry, &it.name))
        {
            let before = reasons.len();
            why_bus(bus, &mut reasons);
            if reasons.len() > before {
                continue;
            }
            self.why_on(bus, entry, &mut reasons);
            if reasons.len() == before && !self.has_looked(BusIndex(index as u8)) {
                reasons.push("still looking".to_owned());
            } else if reasons.len() == before {
                why_silent(bus, entry, &mut reasons);
            }
        }
        if reasons.is_empty() {
            reasons.push("nothing was heard of it".to_owned());
        }
        reasons
    }

    fn why_on(&self, bus: &Bus, entry: &Entry, reasons: &mut Vec<String>) {
        let devices = bus.engine.devices();
        let at = |device: &&Device| entry.address == Some(device.address.number());
        let seconds = |device: &Device| spell(self.now.since(device.last_seen));
        for other in devices.iter().filter(|device| device.is_named(&entry.name)) {
            let listed = self.matching.entry_of(other.id).is_some();
            reasons.push(match (other.is_here(), listed) {
                (true, false) => format!("it is there under another address: {}", other.address),
                (true, true) => format!(
                    "one of its name is at {}, which belongs to another entry",
                    other.address
                ),
                (false, _) => {
                    format!("it was at {} and was last heard {} ago", other.address, seconds(other))
                }
            });
        }
        for other in devices.iter().filter(at) {
            let address = other.address;
            match (&other.name, other.is_here()) {
                (Some(name), true) if name.as_bytes() != entry.name => {
                    reasons.push(format!("{name} sits on its address {address}"));
                }
                (None, true) => reasons.extend(why_unnamed(other, self.asks(other.id.bus))),
                (None, false) => reasons.push(format!(
                    "something without a name was at {address}, last heard {} ago",
                    seconds(other)
                )),
                _ => {}
            }
        }
    }

    /// What keeps a device from being whole: no heartbeats, no name, no services.
    pub fn why_incomplete(&self, device: &Device) -> Vec<String> {
        let mut reasons = Vec::new();
        if !device.is_here()
            && let Some(bus) = self.bus(device.id.bus)
        {
            why_bus(bus, &mut reasons);
        }
        if device.name.is_none() && !device.is_debug {
            reasons.extend(why_unnamed(device, self.asks(device.id.bus)));
        } else if device.services.is_none() {
            let query = device.services_query;
            match query.state {
                QueryState::Unanswered => reasons.push(format!(
                    "it says its name, but not its services (asked {})",
                    times(query.attempts)
                )),
                QueryState::NotAsked if !self.asks(device.id.bus) => {
                    reasons.push("services: we do not ask".to_owned());
                }
                _ => {}
            }
        }
        for fault in [device.name_query.fault, device.services_query.fault].into_iter().flatten() {
            reasons.push(format!("its answer was not usable: {fault}"));
        }
        reasons
    }

    /// Why we have no address on a bus, where that is the case: the fixed one is used by somebody
    /// else, or all are used.
    pub fn why_no_address(&self, bus: BusIndex, wanted: Option<Address>) -> Option<String> {
        let Some(wanted) = wanted else {
            return Some("all addresses are used: we ask nobody until one is free".to_owned());
        };
        let user = self.bus(bus)?.engine.device_at(wanted);
        let user = user.and_then(|device| device.name.as_ref());
        let user = user.map_or_else(|| "somebody else".to_owned(), ToString::to_string);
        Some(format!("{user} uses our address {wanted}: we ask nobody until it is free"))
    }

    /// Whether discovery asks anything on a bus.
    pub fn asks(&self, bus: BusIndex) -> bool {
        self.bus(bus).is_some_and(|bus| {
            let config = bus.engine.config();
            config.scan && !config.listen_only
        })
    }
}

/// Why nothing at all was heard of a device.
fn why_silent(bus: &Bus, entry: &Entry, reasons: &mut Vec<String>) {
    reasons.push(match entry.address {
        Some(address) => format!("nothing was ever heard from address {address}"),
        None => format!("nobody called {}", Escaped(&entry.name)),
    });
    let config = bus.engine.config();
    let mut others = bus.engine.devices().iter().filter(|it| !it.is_debug && it.is_here());
    reasons.push(if config.listen_only || !config.scan {
        "we do not ask: a device that says nothing is not seen".to_owned()
    } else if bus.engine.own_address() == OwnAddress::None {
        "we have no address yet, so nobody was asked".to_owned()
    } else if others.next().is_none() {
        "nobody at all answers: is the bit rate right, are both ends terminated?".to_owned()
    } else {
        "others answer: is it powered and wired?".to_owned()
    });
}

fn why_bus(bus: &Bus, reasons: &mut Vec<String>) {
    let name = &bus.name;
    match (bus.status.link, bus.status.state) {
        (link, _) if !matches!(link, Link::Up | Link::Ended) => {
            reasons.push(match &bus.status.message {
                Some(message) => Escaped(message.as_bytes()).to_string(),
                None => format!("{name} is down"),
            });
        }
        (_, BusState::BusOff) => {
            reasons.push(format!("the controller of {name} is bus-off: it hears nothing"));
        }
        (_, BusState::Stopped) => reasons.push(format!("{name} is stopped")),
        _ => {}
    }
    if bus.is_up() && bus.engine.is_unacknowledged() {
        reasons.push(format!(
            "nobody on {name} acknowledges: no other device, another bit rate, or a broken wire"
        ));
    }
}

fn why_unnamed(device: &Device, asks: bool) -> Option<String> {
    let what = if device.heartbeat.count > 0 { "a heartbeat" } else { "frames" };
    let query = device.name_query;
    match query.state {
        QueryState::Unanswered | QueryState::Asked if query.attempts > 0 => Some(format!(
            "{what} at {}, but no DES answer (asked {})",
            device.address,
            times(query.attempts)
        )),
        QueryState::NotAsked if asks => {
            Some(format!("{what} at {}, not asked yet", device.address))
        }
        QueryState::NotAsked => {
            Some(format!("{what} at {}; its name is not known, as we do not ask", device.address))
        }
        _ => None,
    }
}

fn times(count: u32) -> String {
    match count {
        1 => "once".to_owned(),
        2 => "twice".to_owned(),
        count => format!("{count} times"),
    }
}

/// A duration in its largest unit, or two: `7s`, `3m12s`, `2h05m`, `4d`.
pub fn spell(duration: Duration) -> String {
    let seconds = duration.as_secs();
    match seconds {
        0..=59 => format!("{seconds}s"),
        60..=3599 => format!("{}m{:02}s", seconds / 60, seconds % 60),
        3600..=86_399 => format!("{}h{:02}m", seconds / 3600, seconds / 60 % 60),
        _ => format!("{}d{:02}h", seconds / 86_400, seconds / 3600 % 24),
    }
}
