//! From what happens on the buses and to the file, to the lines of the timeline.
//!
//! Does not judge anything: the engines did.

use super::buses::{is_up, lost};
use super::traffic::hex;

use super::timeline::{Entry, Kind};
use super::{App, Change, Effect, ProblemKey};
use crate::discovery::{Confidence, Event, EventKind, Presence};
use crate::frame::BusIndex;
use crate::status::{BusState, BusStatus, Link};
use crate::text::Escaped;

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
            self.outdated = true;
            self.dirty_soon();
            if !self.has_screen {
                self.catch_up();
            }
        }
    }

    fn take_event(&mut self, bus: BusIndex, event: Event) {
        if let Some((kind, text)) = self.describe(bus, &event) {
            let collision = matches!(&event.kind, EventKind::Finding { key, .. }
                if key.kind.is_collision()
                    && kind == Kind::Confirmed
                    && !self.muted.contains(&ProblemKey::of(key)));
            let mut entry = Entry::new(event.time, kind, text).on(bus);
            (entry.device, entry.address) = (event.device, event.address);
            entry.name.clone_from(&event.name);
            self.timeline.push(entry);
            if collision {
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
            // The first mode of a device that appears is no news: its row says it.
            EventKind::Mode { from: None, .. } => return None,
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
                let text = if text.is_empty() { key.kind.name() } else { text };
                (kind, format!("{confidence}: {text}"))
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
                (Kind::Change, format!("debug message {code:03X} {}", hex(data, " ")))
            }
        })
    }

    /// Takes an adapter's words.
    pub(super) fn bus_changed(&mut self, index: BusIndex, status: BusStatus) {
        let now = self.now;
        let Some(bus) = self.buses.get_mut(usize::from(index.0)) else { return };
        if bus.status == status {
            return;
        }
        for (kind, text) in changes(&bus.status, &status) {
            self.timeline.push(Entry::new(now, kind, text).on(index));
        }
        let came_back = is_up(&status) && !is_up(&bus.status) && bus.status.link != Link::Opening;
        let newly_lost = lost(&status).saturating_sub(lost(&bus.status));
        if bus.status.bitrate != status.bitrate {
            bus.engine.set_bitrate(status.bitrate);
        }
        bus.status = status;
        if came_back {
            bus.engine.restart(now);
        }
        if newly_lost > 0 {
            bus.engine.handle_lost(now, newly_lost);
        }
        self.take_events();
        self.refresh();
        self.dirty_soon();
        self.report(Happening::Bus(index));
    }

    /// des.json changed, or what is known of it.
    pub(super) fn file_changed(&mut self, change: Change) {
        let name = self.file.name();
        let entries = self.file.document().entries().len();
        let listed = format!("{entries} {}", if entries == 1 { "entry" } else { "entries" });
        let line = match change {
            Change::None => return,
            Change::Saved => None,
            Change::First if !self.file.is_there() => {
                Some((Kind::File, "not there yet: it begins with the first edit".to_owned()))
            }
            Change::First => {
                let path = self.file.path().map(|path| path.as_os_str().as_encoded_bytes());
                let path = crate::text::printable(path.unwrap_or_default());
                let where_it_is = if path == name { String::new() } else { format!(", {path}") };
                Some((Kind::File, format!("{listed}{where_it_is}")))
            }
            Change::Content if !self.file.is_there() => {
                Some((Kind::File, "gone: the next edit begins a new one".to_owned()))
            }
            Change::Content => Some((Kind::File, format!("changed on disk: {listed}"))),
            Change::Rebased => Some((
                Kind::File,
                "changed by someone else: our edits are made on the newer content".to_owned(),
            )),
            Change::Broken => {
                let problem = self.file.problem().map(ToString::to_string).unwrap_or_default();
                self.complain(format!("{name}: {problem}"));
                Some((Kind::Error, problem))
            }
            Change::Conflict => {
                self.show_conflict();
                Some((Kind::Error, "someone else changed the same value".to_owned()))
            }
        };
        if let Some((kind, text)) = line {
            self.timeline.push(Entry::new(self.now, kind, text));
        }
        if matches!(change, Change::First | Change::Content | Change::Rebased) {
            for finding in self.file.document().findings() {
                self.timeline.push(Entry::new(self.now, Kind::File, finding.to_string()));
            }
        }
        if change != Change::Broken {
            self.save_pending();
        }
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

/// What changed between two words of an adapter, in lines.
fn changes(old: &BusStatus, status: &BusStatus) -> Vec<(Kind, String)> {
    let message = status.message.as_ref().map(|message| Escaped(message.as_bytes()).to_string());
    let mut lines = Vec::new();
    if old.link != status.link {
        lines.push(match status.link {
            Link::Opening => (Kind::Bus, "being opened".to_owned()),
            Link::Up => (Kind::Bus, "open".to_owned()),
            Link::Ended => (Kind::Bus, "the log is at its end".to_owned()),
            _ => (Kind::Error, message.unwrap_or_else(|| "down".to_owned())),
        });
    }
    if old.state != status.state && status.state != BusState::Unknown {
        let kind = match status.state {
            BusState::ErrorActive => Kind::Bus,
            BusState::ErrorWarning => Kind::Late,
            _ => Kind::Error,
        };
        let counters = match (status.tec, status.rec) {
            (Some(tec), Some(rec)) => format!(" (error counters: tx {tec}, rx {rec})"),
            _ => String::new(),
        };
        lines.push((kind, format!("{}{counters}", status.state)));
    }
    if old.bitrate != status.bitrate
        && let Some(bitrate) = status.bitrate
    {
        lines.push((Kind::Bus, format!("{bitrate} bit/s")));
    }
    if lost(old) < lost(status) {
        lines.push((Kind::Error, "frames were lost on the way to us".to_owned()));
    }
    lines
}
