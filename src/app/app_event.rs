//! Events for a consumer without a screen, with all data to print as of their moment.
//!
//! Consumers may read them later than they happened: nothing in them refers to the state of
//! [`App`].

use super::file::FileIndex;
use super::{App, FileError, TimelineEntry, TxBlocked};
use crate::discovery::{
    BusTraffic, Counters, DeviceService, Event, EventKind, OwnAddress, ServicesNews,
};
use crate::finding::Finding;
use crate::frame::BusIndex;
use crate::status::{BusState, BusStatus};
use crate::time::Instant;
use std::path::PathBuf;
use unicode_width::UnicodeWidthStr;

/// An event for a consumer without a screen. Kept if [`AppOptions::emit_events`] is set.
///
/// [`AppOptions::emit_events`]: super::AppOptions::emit_events
#[derive(Clone, Debug)]
pub enum AppEvent {
    /// A line of the timeline, emitted at each repetition; the other variants carry the same as
    /// values.
    Line(EventLine),
    /// An event of a device; findings are [`AppEvent::Finding`].
    Event(Box<DeviceEvent>),
    /// A finding of an engine or of the comparison with des.json: new, changed in state, or
    /// cleared.
    Finding(EventContext, Box<Finding>),
    /// A bus changed: link, bit rate, state, lost frames, own address.
    Bus(Instant, Box<BusSnapshot>),
    /// descan cannot transmit on a bus, or has no own address on it.
    TxBlocked(Box<BusSnapshot>),
    /// des.json changed on disk, or cannot be used.
    File(Instant, FileSnapshot),
    /// The profile, the project or a file of the catalogue was saved with a mistake: which, where, and
    /// what stays in force.
    WrongFile(String),
}

/// Time and place of an event.
#[derive(Clone, Debug)]
pub struct EventContext {
    /// When it happened.
    pub time: Instant,
    /// Name of its bus; `None` for an event of no bus.
    pub bus: Option<String>,
}

/// An event of a device.
#[derive(Clone, Debug)]
pub struct DeviceEvent {
    /// When and on which bus.
    pub context: EventContext,
    /// The engine's event, with the device's address and name.
    pub event: Event,
    /// The device's services; empty unless the event is about them.
    pub services: Vec<DeviceService>,
}

/// A line of the timeline with the texts of its columns.
#[derive(Clone, Debug)]
pub struct EventLine {
    /// When it happened.
    pub time: Instant,
    /// Name of the bus, padded to the longest one; `None` on a single bus.
    pub bus_column: Option<String>,
    /// The subject: address and name of a device, name of the bus, the file or a part of descan.
    pub source: String,
    /// What happened.
    pub text: String,
    /// Of a finding: what was observed, as a sentence; empty if `text` has it.
    pub explanation: String,
}

/// State of a bus at one moment.
#[derive(Clone, Debug)]
pub struct BusSnapshot {
    /// Which bus.
    pub index: BusIndex,
    /// Its name: `can0`.
    pub name: String,
    /// State of its adapter.
    pub status: BusStatus,
    /// State of its controller, as its adapter or error frames report it.
    pub controller_state: BusState,
    /// Counters of its engine.
    pub counters: Counters,
    /// What its frames show about its protocol.
    pub traffic: BusTraffic,
    /// Frames lost on the way to descan.
    pub lost: u64,
    /// Mean bus load since the start, 0 to 1; `None` if the bit rate is unknown.
    pub mean_load: Option<f64>,
    /// descan's address on it.
    pub own_address: OwnAddress,
    /// Frames can be received and transmitted.
    pub is_up: bool,
    /// Why frames are not transmitted; `None` if they are, or if the bus is not up.
    pub tx_blocked: Option<TxBlocked>,
    /// Why descan has no address, as a sentence; `None` unless it is blocked.
    pub why_no_address: Option<String>,
}

/// State of des.json at one moment.
#[derive(Clone, Debug)]
pub struct FileSnapshot {
    /// Where it is.
    pub path: Option<PathBuf>,
    /// Number of entries; `None` if there is no file.
    pub entries: Option<usize>,
    /// Why it cannot be used as it is.
    pub problem: Option<FileError>,
}

impl App {
    /// The state of bus `index` at `now`, which sets the time span of the mean load. `None` if the
    /// bus does not exist.
    pub fn bus_snapshot(&self, index: BusIndex, now: Instant) -> Option<BusSnapshot> {
        let bus = self.bus(index)?;
        let bitrate = bus.status.bitrate.filter(|_| !bus.status.filtered);
        let own_address = bus.own_address();
        Some(BusSnapshot {
            index,
            name: bus.name.clone(),
            status: bus.status.clone(),
            controller_state: bus.controller().state,
            counters: bus.counters(),
            traffic: bus.traffic(),
            lost: bus.lost(),
            mean_load: bitrate.map(|bitrate| bus.meter.mean_load(now, bitrate)),
            own_address,
            is_up: bus.is_up(),
            tx_blocked: bus.tx_blocked(),
            why_no_address: match own_address {
                OwnAddress::Blocked(wanted) => self.no_address_reasons(index, wanted),
                _ => None,
            },
        })
    }

    /// The state of a des.json.
    pub fn file_snapshot(&self, file: FileIndex) -> FileSnapshot {
        let file = self.file_at(file);
        FileSnapshot {
            path: file.path().map(Into::into),
            entries: file.is_there().then(|| file.document().entries().len()),
            problem: file.problem().cloned(),
        }
    }

    /// The state of bus `index` as an event; `None` if the bus does not exist.
    pub(super) fn bus_event(&self, index: BusIndex, time: Instant) -> Option<AppEvent> {
        Some(AppEvent::Bus(time, Box::new(self.bus_snapshot(index, time)?)))
    }

    /// Adds the frames handled at `now` to the bus events of that moment that wait.
    pub(super) fn complete_bus_events(&mut self, now: Instant) {
        // A status change comes with a few events at most.
        const RECENT: usize = 16;
        for event in self.notices.recent_events(RECENT) {
            if let AppEvent::Bus(time, snapshot) = event
                && *time == now
                && let Some(bus) = self.buses.get(snapshot.index)
            {
                snapshot.counters = bus.counters();
            }
        }
    }

    /// An event of the engine of bus `index`, as the values that belong to it.
    pub(super) fn engine_event(&self, index: BusIndex, event: Event) -> Option<AppEvent> {
        match event.kind {
            EventKind::OwnAddress(_) | EventKind::OwnAddressLost(_) => {
                return self.bus_event(index, event.time);
            }
            EventKind::NoAck | EventKind::NoAddress(_) => {
                let bus = self.bus_snapshot(index, event.time)?;
                return Some(AppEvent::TxBlocked(Box::new(bus)));
            }
            _ => {}
        }
        let device = event.device.and_then(|id| self.device(id));
        let services = match event.kind {
            EventKind::Services { news: ServicesNews::OtherDevice, .. } => {
                device.and_then(|device| device.other_services.last().cloned())
            }
            EventKind::Services { .. } => device.and_then(|device| device.services.clone()),
            _ => None,
        };
        let context = self.event_context(Some(index), event.time);
        let services = services.unwrap_or_default();
        Some(AppEvent::Event(Box::new(DeviceEvent { context, event, services })))
    }

    pub(super) fn finding_event(&self, finding: Finding, time: Instant) -> AppEvent {
        AppEvent::Finding(self.event_context(finding.key.bus, time), Box::new(finding))
    }

    pub(super) fn line_event(&self, line: &TimelineEntry) -> AppEvent {
        let bus = line.bus.and_then(|index| self.bus(index)).map_or("", |bus| &bus.name);
        let has_several = self.buses().len() > 1;
        let name = self.name_on_line(line).map(ToString::to_string);
        let source = match (line.address, name) {
            (Some(address), name) => format!("{address:>3} {}", name.as_deref().unwrap_or("?")),
            (None, Some(name)) => name,
            (None, None) if line.bus.is_none() => self.file_at(line.file).name(),
            (None, None) if has_several => String::new(),
            (None, None) => bus.to_owned(),
        };
        let bus_column = has_several.then(|| {
            let width = self.buses().iter().map(|bus| bus.name.width()).max().unwrap_or(0);
            format!("{bus}{}", " ".repeat(width.saturating_sub(bus.width())))
        });
        let plain = || (line.text.clone(), String::new());
        let (text, explanation) = self.explained(line).unwrap_or_else(plain);
        AppEvent::Line(EventLine { time: line.time, bus_column, source, text, explanation })
    }

    fn event_context(&self, bus: Option<BusIndex>, time: Instant) -> EventContext {
        let bus = bus.and_then(|index| self.bus(index)).map(|bus| bus.name.clone());
        EventContext { time, bus }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::AppOptions;
    use crate::discovery::Config;
    use crate::status::Link;

    #[test]
    fn event_polled_later_has_data_of_its_time() {
        let buses = vec![("can0".to_owned(), Config::default())];
        let mut app = App::new(
            Instant::ZERO,
            AppOptions { buses, emit_events: true, ..AppOptions::default() },
        );
        let mut status = BusStatus { link: Link::Up, ..BusStatus::default() };
        for drops in 1..=2 {
            status.kernel_drops = drops;
            app.handle_bus(Instant::ZERO, BusIndex(0), status.clone());
        }
        app.name_bus(BusIndex(0), "can7".to_owned());
        let mut lost = Vec::new();
        while let Some(event) = app.poll_app_event() {
            if let AppEvent::Bus(_, bus) = event {
                lost.push((bus.name, bus.lost));
            }
        }
        assert_eq!(lost, [("can0".to_owned(), 1), ("can0".to_owned(), 2)]);
    }
}
