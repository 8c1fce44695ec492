//! From what happens on the buses and to the file, to the lines of the timeline.
//!
//! Does not judge anything: the engines did.

use super::buses::{BusView, ControllerState, Link};
use super::timeline::{Entry, Kind};
use super::{App, Change, Effect, Overlay};
use crate::discovery::{Confidence, Event, EventKind, Presence};
use crate::frame::BusIndex;
use crate::wire::text::Escaped;

/// Something that happened, for those who watch without a screen.
#[derive(Clone, Debug)]
pub enum Happening {
    /// On a bus.
    Event(BusIndex, Event),
    /// To a bus: link, bit rate, state.
    Bus(BusIndex),
    /// To des.json.
    File,
}

impl App {
    /// Takes the engines' events.
    pub(super) fn take_events(&mut self) {
        let mut any = false;
        for index in 0..self.buses.len() {
            while let Some(event) = self.buses[index].engine.poll_event() {
                any = true;
                self.take_event(BusIndex(index as u8), event);
            }
        }
        if any {
            self.refresh();
            self.dirty_soon();
        }
    }

    fn take_event(&mut self, bus: BusIndex, event: Event) {
        let acknowledged = match event.kind {
            EventKind::NobodyAcknowledges => Some(false),
            EventKind::Acknowledged => Some(true),
            _ => None,
        };
        if let (Some(acknowledged), Some(bus)) =
            (acknowledged, self.buses.get_mut(usize::from(bus.0)))
        {
            bus.nobody_acknowledges = !acknowledged;
        }
        if let Some((kind, text)) = self.describe(bus, &event) {
            let confirmed = kind == Kind::Confirmed;
            let mut entry = Entry::new(event.time, kind, text).on(bus);
            (entry.device, entry.address) = (event.device, event.address);
            entry.name.clone_from(&event.name);
            self.timeline.push(entry);
            if confirmed {
                self.effects.push_back(Effect::Bell);
            }
        }
        self.report(Happening::Event(bus, event));
    }

    fn report(&mut self, happening: Happening) {
        const MOST: usize = 65_536;
        if self.report && self.happenings.len() < MOST {
            self.happenings.push_back(happening);
        }
    }

    fn describe(&self, bus: BusIndex, event: &Event) -> Option<(Kind, String)> {
        Some(match &event.kind {
            EventKind::Appeared => (Kind::Good, "appeared".to_owned()),
            EventKind::Named => (Kind::Good, "says its name".to_owned()),
            EventKind::Services { count, changed } => {
                let plural = if *count == 1 { "" } else { "s" };
                let kind = if *changed { Kind::Change } else { Kind::Good };
                let now = if *changed { ", other than before" } else { "" };
                (kind, format!("{count} service{plural}{now}"))
            }
            EventKind::Mode { from: Some(from), to } => (Kind::Change, format!("{from} → {to}")),
            EventKind::Mode { from: None, to } => (Kind::Change, format!("in mode {to}")),
            EventKind::Moved { from } => (Kind::Change, format!("moved here from {from}")),
            EventKind::Rebooted => (Kind::Change, "rebooted".to_owned()),
            EventKind::Presence(Presence::Online) => (Kind::Good, "online".to_owned()),
            EventKind::Presence(Presence::Stale) => {
                (Kind::Late, "stale: its heartbeat is late".to_owned())
            }
            EventKind::Presence(Presence::Silent) => {
                (Kind::Late, "silent: frames, but no heartbeats".to_owned())
            }
            EventKind::Presence(Presence::Asleep) => (Kind::Late, "asleep".to_owned()),
            EventKind::Presence(Presence::Lost) => (Kind::Lost, "lost".to_owned()),
            EventKind::Returned { was } => (Kind::Good, format!("returned, was {was}")),
            EventKind::Finding { key, confidence } => {
                let kind = match confidence {
                    Confidence::Cleared => Kind::Cleared,
                    Confidence::Suspected => Kind::Suspected,
                    Confidence::Confirmed => Kind::Confirmed,
                };
                let findings = self.bus(bus).map_or(&[][..], |bus| bus.engine.findings());
                let found = findings.iter().find(|finding| finding.key == *key);
                let text = found.map_or("", |finding| finding.text.as_str());
                (kind, format!("{confidence}: {}{}{text}", key.kind, separator(text)))
            }
            EventKind::OwnAddress(address) => (Kind::Bus, format!("we are at {address}")),
            EventKind::OwnAddressLost(address) => {
                (Kind::Bus, format!("we gave {address} up: somebody else uses it"))
            }
            EventKind::NobodyAcknowledges => {
                (Kind::Error, "nobody acknowledges our frames: we wait".to_owned())
            }
            EventKind::Acknowledged => (Kind::Bus, "our frames are acknowledged".to_owned()),
            EventKind::Debug { code, data } => {
                let bytes: String = data.iter().map(|byte| format!(" {byte:02X}")).collect();
                (Kind::Change, format!("debug message {code:03X}{bytes}"))
            }
        })
    }

    /// Takes an adapter's words.
    pub(super) fn bus_changed(&mut self, index: BusIndex, view: BusView) {
        let now = self.now;
        let Some(bus) = self.buses.get_mut(usize::from(index.0)) else { return };
        if bus.view == view {
            return;
        }
        let old = std::mem::replace(&mut bus.view, view);
        let view = bus.view.clone();
        if old.bitrate != view.bitrate {
            bus.engine.set_bitrate(view.bitrate);
        }
        let came_back = view.is_up()
            && (old.link == Link::Down
                || matches!(old.state, ControllerState::BusOff | ControllerState::Stopped));
        if came_back {
            bus.engine.restart(now);
            bus.nobody_acknowledges = false;
        }
        let message = view.message.as_ref().map(|message| Escaped(message.as_bytes()).to_string());
        let mut lines = Vec::new();
        if old.link != view.link {
            lines.push(match view.link {
                Link::Opening => (Kind::Bus, "being opened".to_owned()),
                Link::Up => (Kind::Bus, "open".to_owned()),
                Link::Ended => (Kind::Bus, "the log is at its end".to_owned()),
                Link::Down => (Kind::Error, message.unwrap_or_else(|| "down".to_owned())),
            });
        }
        if old.state != view.state && view.state != ControllerState::Unknown {
            let kind = match view.state {
                ControllerState::Active | ControllerState::Unknown => Kind::Bus,
                ControllerState::Warning => Kind::Late,
                _ => Kind::Error,
            };
            let counters = match (view.tec, view.rec) {
                (Some(tec), Some(rec)) => format!(" (error counters: tx {tec}, rx {rec})"),
                _ => String::new(),
            };
            lines.push((kind, format!("{}{counters}", view.state_name())));
        }
        if old.bitrate != view.bitrate
            && let Some(bitrate) = view.bitrate
        {
            lines.push((Kind::Bus, format!("{bitrate} bit/s")));
        }
        if old.lost() < view.lost() {
            lines.push((Kind::Error, "frames were lost on the way to us".to_owned()));
        }
        for (kind, text) in lines {
            self.timeline.push(Entry::new(now, kind, text).on(index));
        }
        self.take_events();
        self.refresh();
        self.dirty = true;
        self.report(Happening::Bus(index));
    }

    /// des.json changed, or what is known of it.
    pub(super) fn file_changed(&mut self, change: Change) {
        let name = self.file.name();
        let entries = self.file.document().entries().len();
        let listed = format!("{entries} {}", if entries == 1 { "entry" } else { "entries" });
        let line = match change {
            Change::None => return,
            Change::First if !self.file.is_there() => Some((
                Kind::File,
                format!("{name} is not there yet: it begins with the first edit"),
            )),
            Change::First => Some((Kind::File, format!("{name}: {listed}"))),
            Change::Saved => None,
            Change::Content => Some((Kind::File, format!("{name} on disk: {listed}"))),
            Change::Rebased => Some((
                Kind::File,
                format!(
                    "{name} was changed by someone else: our edits are made on the newer content"
                ),
            )),
            Change::Broken => {
                let problem = self.file.problem().map(ToString::to_string).unwrap_or_default();
                Some((Kind::Error, format!("{name}: {problem}")))
            }
            Change::Conflict => {
                self.overlay = Overlay::Conflict;
                Some((Kind::Error, format!("{name}: someone else changed the same value")))
            }
        };
        if let Some((kind, text)) = line {
            if kind == Kind::Error && change == Change::Broken {
                self.complain(text.clone());
            }
            self.timeline.push(Entry::new(self.now, kind, text));
        }
        if matches!(change, Change::First | Change::Content | Change::Rebased) {
            for finding in self.file.document().findings() {
                let text = format!("{name}: {finding}");
                self.timeline.push(Entry::new(self.now, Kind::File, text));
            }
        }
        self.save_pending();
        self.refresh();
        self.dirty = true;
        self.report(Happening::File);
    }

    /// Begins to save what is not saved yet.
    pub(super) fn save_pending(&mut self) {
        if let Some(saving) = self.file.start_saving() {
            let (expected, content) = (saving.expected, saving.content);
            self.effects.push_back(Effect::Save { expected, content });
        }
    }
}

fn separator(text: &str) -> &'static str {
    if text.is_empty() { "" } else { ". " }
}
