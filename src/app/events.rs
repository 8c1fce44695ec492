//! From what happens on the buses and to the file, to the lines of the timeline.
//!
//! Does not judge anything: the engines did.

use super::buses::{Bus, TxBlocked, is_up, lost};
use super::traffic::hex;

use super::timeline::{TimelineEntry, TimelineKind};
use super::{App, AppEvent, Change, Effect, ProblemKey};
use crate::discovery::{
    Confidence, ConflictParty, DeviceId, Event, EventKind, Finding, FindingKey, Presence,
};
use crate::frame::BusIndex;
use crate::status::{BusState, BusStatus, Link, RecordingStatus};
use crate::text::{Escaped, Name};
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::{Mode, Uid};
use std::collections::BTreeMap;

/// A line that is about to be told, or to become part of one.
struct TimelineDraft {
    entry: TimelineEntry,
    is_told: bool,
}

impl App {
    /// Takes the engines' events.
    pub(super) fn take_events(&mut self) {
        let mut any = false;
        for index in 0..self.buses.len() {
            // Told when all that one frame gave rise to is known: some of it is one line.
            let mut lines = Vec::new();
            while let Some(event) = self.buses[index].engine.poll_event() {
                any = true;
                self.take_event(BusIndex(index as u8), event, &mut lines);
            }
            for line in lines.into_iter().filter(|line| line.is_told) {
                self.report(self.line_event(&line.entry));
            }
        }
        if any {
            self.outdated = true;
            self.request_redraw();
            if !self.has_screen {
                self.catch_up();
            }
        }
    }

    fn take_event(&mut self, bus: BusIndex, event: Event, lines: &mut Vec<TimelineDraft>) {
        if let (EventKind::Joined { was, before }, Some(device)) = (&event.kind, event.device) {
            self.timeline.reassign(*was, *before, device);
        }
        let is_told = self.report && self.is_event_of_interest(bus, &event);
        if let Some((kind, text)) = self.describe(bus, &event) {
            let collision = matches!(&event.kind, EventKind::Finding { key, .. }
                if key.kind.is_conflict()
                    && kind == TimelineKind::Confirmed
                    && !self.muted.contains(&ProblemKey::of(key)));
            let mut entry = TimelineEntry::new(event.time, kind, text).on(bus);
            (entry.device, entry.address) = (event.device, event.address);
            entry.name.clone_from(&event.name);
            let may_join =
                matches!(event.kind, EventKind::Moved { .. } | EventKind::Claimed { .. });
            let amended = if may_join { self.timeline.amend(&entry, one_line) } else { None };
            if let Some((before, amended)) = amended {
                let is_it =
                    |line: &TimelineEntry| line.text == before && line.address == amended.address;
                if let Some(at) = lines.iter().rposition(|line| is_it(&line.entry)) {
                    let is_told = lines.remove(at).is_told || is_told;
                    lines.push(TimelineDraft { entry: amended, is_told });
                }
            } else {
                if self.report {
                    lines.push(TimelineDraft { entry: entry.clone(), is_told });
                }
                self.timeline.push(entry);
            }
            if collision {
                self.effects.push_back(Effect::Bell);
            }
        }
        if !is_told {
            return;
        }
        if let EventKind::Finding { key, confidence } = &event.kind {
            let mut finding = self
                .engine_finding(bus, key)
                .cloned()
                .unwrap_or_else(|| Finding::new(key.clone(), event.time));
            finding.confidence = *confidence;
            self.report(self.finding_event(finding, event.time));
        } else if let Some(event) = self.engine_event(bus, event) {
            self.report(event);
        }
    }

    /// Whether an event is told to those who watch.
    fn is_event_of_interest(&self, bus: BusIndex, event: &Event) -> bool {
        if self.interest.is_empty() {
            return true;
        }
        let (kind, text) =
            self.describe(bus, event).unwrap_or((TimelineKind::Change, String::new()));
        let mut line = TimelineEntry::new(event.time, kind, text).on(bus);
        (line.device, line.address) = (event.device, event.address);
        line.name.clone_from(&event.name);
        let others: &[Address] = match &event.kind {
            EventKind::Moved { from } => &[*from],
            EventKind::Finding { key, .. } => {
                self.engine_finding(bus, key).map_or(&[], |finding| &finding.addresses)
            }
            _ => &[],
        };
        self.is_of_interest(&line, others)
    }

    /// Whether a line is told to those who watch: it fits what they asked for, at its own address or
    /// at one of `others`. What is about a whole bus, and what went wrong with us, always is: who
    /// asks for one device must still learn that frames were lost.
    fn is_of_interest(&self, line: &TimelineEntry, others: &[Address]) -> bool {
        let is_of_device = line.address.is_some() || line.device.is_some();
        let is_of_bus = line.bus.is_some() && line.name.is_none();
        self.interest.is_empty()
            || (!is_of_device && (is_of_bus || line.kind == TimelineKind::Error))
            || self.interest.matches_entry_of(self, line, others)
    }

    fn engine_finding(&self, bus: BusIndex, key: &FindingKey) -> Option<&Finding> {
        self.bus(bus)?.engine.findings().iter().find(|finding| finding.key == *key)
    }

    /// Tells what is found now by comparing file and bus, and was not `before`, or was otherwise.
    pub(super) fn report_differences(&mut self, before: &[Finding], now: Instant) {
        if !self.report {
            return;
        }
        let confidences = |findings: &[Finding]| -> BTreeMap<FindingKey, Confidence> {
            findings.iter().map(|finding| (finding.key.clone(), finding.confidence)).collect()
        };
        let (was, is) = (confidences(before), confidences(&self.file_findings));
        let mut told = Vec::new();
        for mut finding in before.iter().filter(|it| !is.contains_key(&it.key)).cloned() {
            (finding.confidence, finding.changed) = (Confidence::Cleared, now);
            told.push(finding);
        }
        let is_news = |found: &&Finding| was.get(&found.key) != Some(&found.confidence);
        told.extend(self.file_findings.iter().filter(is_news).cloned());
        for finding in told {
            let (kind, text) = finding_in_words(finding.confidence, &finding.key, &finding.text);
            let mut line = TimelineEntry::new(now, kind, text);
            line.bus = finding.key.bus;
            line.address = finding.key.address;
            line.name.clone_from(&finding.key.name);
            if self.is_of_interest(&line, &finding.addresses) {
                self.report(self.line_event(&line));
                self.report(self.finding_event(finding, now));
            }
        }
    }

    /// A line of the timeline, which `watch` tells too.
    pub(super) fn report_line(&mut self, line: TimelineEntry) {
        if self.report && self.is_of_interest(&line, &[]) {
            self.report(self.line_event(&line));
        }
        self.timeline.push(line);
    }

    fn report(&mut self, happening: AppEvent) {
        const MOST: usize = 65_536;
        if self.report && self.app_events.len() < MOST {
            self.app_events.push_back(happening);
        }
    }

    fn describe(&self, bus: BusIndex, event: &Event) -> Option<(TimelineKind, String)> {
        Some(match &event.kind {
            EventKind::Appeared => (TimelineKind::Good, "appeared".to_owned()),
            EventKind::Named => (TimelineKind::Good, identified(event)),
            EventKind::Services { count, changed } => {
                let plural = if *count == 1 { "" } else { "s" };
                let kind = if *changed { TimelineKind::Change } else { TimelineKind::Good };
                let now = if *changed { " (changed)" } else { "" };
                (kind, format!("{count} service{plural}{now}"))
            }
            // The first mode of a device that appears is no news: its row says it. ARSLV is told as
            // the claim of an address.
            EventKind::Mode { from: None, .. }
            | EventKind::Mode { to: Mode::Arslv, .. }
            | EventKind::Joined { .. } => return None,
            EventKind::Mode { from: Some(from), to } => {
                (TimelineKind::Change, format!("{from} → {to}"))
            }
            EventKind::Moved { from } => (TimelineKind::Change, format!("moved from {from}")),
            EventKind::Claimed { uid, holder, inferred: guess } => {
                let holder = holder.as_ref().map(|holder| self.party_label(holder));
                let held = match (holder, guess) {
                    (Some(holder), false) => format!(" (held by {holder})"),
                    (Some(holder), true) => format!(" (probably not {holder})"),
                    (None, _) => String::new(),
                };
                let by = self.uid_label(bus, event.device, *uid);
                (TimelineKind::Change, format!("{by}claims {}{held}", address(event)))
            }
            EventKind::GaveWay { uid, to, inferred: guess } => {
                let to = match to {
                    Some(to) => format!(" to {}", self.party_label(to)),
                    None => " (claimed by another device)".to_owned(),
                };
                let guess = if *guess { " (probable)" } else { "" };
                let by = self.uid_label(bus, event.device, *uid);
                (TimelineKind::Change, format!("{by}gave up {}{to}{guess}", address(event)))
            }
            EventKind::Rebooted => (TimelineKind::Change, "rebooted".to_owned()),
            EventKind::Presence(Presence::Online) => (TimelineKind::Good, "online".to_owned()),
            EventKind::Presence(Presence::Stale) => {
                (TimelineKind::Late, "stale: heartbeat overdue".to_owned())
            }
            EventKind::Presence(Presence::Silent) => {
                (TimelineKind::Late, "silent: frames but no heartbeat".to_owned())
            }
            EventKind::Presence(Presence::Asleep) => (TimelineKind::Late, "asleep".to_owned()),
            EventKind::Presence(Presence::Lost) => {
                let still = event.device.map_or_else(Vec::new, |id| self.still_on(id));
                let own = self.bus(bus).map_or("", |bus| &bus.name);
                let text = if still.is_empty() {
                    "lost".to_owned()
                } else {
                    format!("lost on {own}, still on {}", still.join(" and "))
                };
                (TimelineKind::Lost, text)
            }
            EventKind::Returned { was } => {
                let elsewhere = event.device.is_some_and(|id| !self.still_on(id).is_empty());
                let own = self.bus(bus).filter(|_| elsewhere);
                let place = own.map_or(String::new(), |bus| format!(" on {}", bus.name));
                (TimelineKind::Good, format!("returned{place} (was {was})"))
            }
            EventKind::Finding { key, confidence } => {
                let found = self.engine_finding(bus, key);
                let text = found.map_or("", |finding| finding.text.as_str());
                finding_in_words(*confidence, key, text)
            }
            EventKind::OwnAddress(address) => {
                (TimelineKind::Bus, format!("using address {address}"))
            }
            EventKind::OwnAddressLost(address) => {
                (TimelineKind::Bus, format!("released address {address}: used by another node"))
            }
            EventKind::NoAddress(wanted) => {
                (TimelineKind::Error, self.why_no_address(bus, *wanted).unwrap_or_default())
            }
            EventKind::NobodyAcknowledges => {
                let text = match self.bus(bus).and_then(Bus::tx_blocked) {
                    Some(TxBlocked::QueueFull) => "transmit queue stuck: sending paused",
                    _ => "no ACK on the bus: sending paused",
                };
                (TimelineKind::Error, text.to_owned())
            }
            EventKind::Acknowledged => {
                (TimelineKind::Bus, "frames are acknowledged: sending resumed".to_owned())
            }
            EventKind::Debug { code, data } => {
                (TimelineKind::Change, format!("debug message {code:03X} {}", hex(data, " ")))
            }
        })
    }

    fn party_label(&self, party: &ConflictParty) -> String {
        let known = || self.device(party.device)?.name.as_ref();
        match (party.name.as_ref().or_else(known), party.uid) {
            (Some(name), _) => name.to_string(),
            (None, Some(uid)) => format!("UID {}", self.uid_text(party.device.bus, uid)),
            (None, None) => "another device".to_owned(),
        }
    }

    /// The UID of one that has no row, and so no name.
    fn uid_label(&self, bus: BusIndex, device: Option<DeviceId>, uid: Option<Uid>) -> String {
        let has_row = device.is_some_and(|id| self.device(id).is_some());
        match uid {
            Some(uid) if !has_row => format!("{} ", self.uid_text(bus, uid)),
            _ => String::new(),
        }
    }

    fn uid_text(&self, bus: BusIndex, uid: Uid) -> String {
        let alphabet = self.bus(bus).map(|bus| &bus.engine.config().profile.uid);
        let text = alphabet.map_or_else(String::new, |alphabet| uid.text(alphabet).to_string());
        Escaped(text.as_bytes()).to_string()
    }

    /// The name of the device that a line is about: it may have had none yet then.
    pub fn name_on_line<'a>(&'a self, entry: &'a TimelineEntry) -> Option<&'a Name> {
        let known = || self.device(entry.device?)?.name.as_ref();
        entry.name.as_ref().or_else(known)
    }

    /// Takes an adapter's words.
    pub(super) fn bus_changed(&mut self, index: BusIndex, status: BusStatus) {
        let now = self.now;
        let Some(bus) = self.buses.get_mut(usize::from(index.0)) else { return };
        if bus.status == status {
            return;
        }
        let changes = changes(&bus.status, &status);
        let was_there = matches!(bus.status.link, Link::Opening | Link::Ended);
        // It may have been away and be back before anybody was told.
        let was_away = !is_up(&bus.status)
            || bus.status.outages < status.outages
            || bus.status.bus_offs < status.bus_offs;
        let came_back = is_up(&status) && (was_away && !was_there || bus.waits_for_adapter());
        let is_down = !is_up(&status) && status.link != Link::Ended;
        // Or down again, before anybody was told that it was up.
        let goes_down = is_down
            && (is_up(&bus.status)
                || bus.status.bus_offs < status.bus_offs
                || bus.status.state != status.state && !was_there);
        let newly_lost = lost(&status).saturating_sub(lost(&bus.status));
        if bus.status.bitrate != status.bitrate {
            bus.engine.set_bitrate(status.bitrate);
        }
        match status.link {
            Link::Ended => {
                bus.ended.get_or_insert(now);
            }
            _ => bus.ended = None,
        }
        bus.status = status;
        bus.note_queue(now);
        // While its bit rate is looked for it goes down and up all the time.
        let changes = if self.searched == Some(index) { Vec::new() } else { changes };
        let is_news = !changes.is_empty();
        for (kind, text) in changes {
            let line = TimelineEntry::new(now, kind, text).on(index);
            self.report_line(line);
        }
        if is_news
            && self.report
            && let Some(event) = self.bus_event(index, now)
        {
            self.report(event);
        }
        let Some(bus) = self.buses.get_mut(usize::from(index.0)) else { return };
        if goes_down {
            bus.goes_down(now);
        }
        if came_back {
            bus.engine.restart(now);
        }
        if newly_lost > 0 {
            bus.engine.handle_lost(now, newly_lost);
        }
        self.take_events();
        self.refresh();
        self.request_redraw();
    }

    /// The recording began, grew, lost frames, or is over.
    pub(super) fn recording_changed(&mut self, status: RecordingStatus) {
        let before = self.recording.replace(status.clone());
        let had_failed = before.as_ref().is_some_and(|before| before.failure.is_some());
        let had_lost = before.as_ref().is_some_and(|before| before.lost > 0);
        let is_another = before.is_none_or(|before| before.path != status.path);
        let (kind, text) = match status.failure {
            Some(_) if had_failed => return,
            Some(why) => {
                (TimelineKind::Error, format!("recording to {} stopped: {why}", status.path))
            }
            None if status.lost > 0 && !had_lost => {
                (TimelineKind::Error, "recorder too slow: frames missing from the file".to_owned())
            }
            None if is_another => (TimelineKind::File, format!("recording to {}", status.path)),
            None => return self.request_redraw(),
        };
        if kind == TimelineKind::Error {
            self.show_error(text.clone());
        }
        let mut line = TimelineEntry::new(self.now, kind, text);
        line.name = Some("recording".into());
        self.report_line(line);
        self.dirty = true;
    }

    /// des.json changed, or what is known of it.
    pub(super) fn file_changed(&mut self, change: Change) {
        let name = self.file.name();
        let entries = self.file.document().entries().len();
        let listed = format!("{entries} {}", if entries == 1 { "entry" } else { "entries" });
        if matches!(change, Change::Content | Change::Rebased | Change::Conflict) {
            self.clear_file_message(change == Change::Rebased);
        }
        let by_others = match change {
            Change::Content | Change::Rebased => self.file.changed_by_others(),
            _ => Vec::new(),
        };
        let line = match change {
            Change::None => return,
            Change::Saved => None,
            Change::First if !self.file.is_there() => {
                // Without a screen nobody edits it.
                let text = if self.report {
                    "not found: devices are not compared"
                } else {
                    "not found: the first edit creates it"
                };
                Some((TimelineKind::File, text.to_owned()))
            }
            Change::First => {
                let path = self.file.path().map(|path| path.as_os_str().as_encoded_bytes());
                let path = crate::text::printable(path.unwrap_or_default());
                let where_it_is = if path == name { String::new() } else { format!(", {path}") };
                Some((TimelineKind::File, format!("{listed}{where_it_is}")))
            }
            Change::Content if !self.file.is_there() => {
                let text = if self.report {
                    "deleted: devices are no longer compared"
                } else {
                    "deleted: the next edit creates it again"
                };
                Some((TimelineKind::File, text.to_owned()))
            }
            Change::Content if !by_others.is_empty() => None,
            Change::Content => Some((TimelineKind::File, format!("changed on disk: {listed}"))),
            Change::Rebased => {
                Some((TimelineKind::File, "changed on disk; your edits are reapplied".to_owned()))
            }
            Change::Broken => {
                let problem = self.file.problem().map(ToString::to_string).unwrap_or_default();
                let whole = self.file.problem().map(|problem| problem.of_file(&name));
                self.complain_of_file(whole.unwrap_or_default());
                Some((TimelineKind::Error, problem))
            }
            Change::Conflict => {
                self.show_conflict();
                Some((TimelineKind::Error, "edit conflict: same value changed on disk".to_owned()))
            }
        };
        let by_others = as_lines(by_others).into_iter();
        let by_others =
            by_others.map(|text| (TimelineKind::File, format!("changed on disk, {text}")));
        let mut lines: Vec<(TimelineKind, String)> = by_others.chain(line).collect();
        // To `watch` each of them is told as what it is, a finding.
        let is_listed = matches!(change, Change::First | Change::Content | Change::Rebased);
        if is_listed && !self.report {
            /// Of more the page of problems tells.
            const TOLD: usize = 20;
            let findings = self.file.document().findings();
            let told = findings.iter().take(TOLD).map(ToString::to_string);
            let more = findings.len().saturating_sub(TOLD);
            let rest = (more > 0).then(|| format!("and {more} more errors in the file"));
            lines.extend(told.chain(rest).map(|text| (TimelineKind::File, text)));
        }
        let mut is_told = self.interest.is_empty();
        for (kind, text) in lines {
            let line = TimelineEntry::new(self.now, kind, text);
            is_told |= self.is_of_interest(&line, &[]);
            self.report_line(line);
        }
        let is_told = is_told && self.report;
        if let Some(excerpt) = self.file.problem().filter(|_| change == Change::Broken)
            && let Some(lines) = excerpt.excerpt()
        {
            // To be looked at, one below the other; no events.
            for text in lines {
                let line = TimelineEntry::new(self.now, TimelineKind::Error, text);
                if is_told {
                    self.report(self.line_event(&line));
                }
                self.timeline.push(line);
            }
        }
        if is_told {
            self.report(AppEvent::File(self.now, self.file_snapshot()));
        }
        self.leave_conflict_that_is_over(change);
        if change != Change::Broken {
            self.save_pending();
        }
        self.quit_if_saved();
        self.dirty = true;
        // What is saved was in force before.
        if change != Change::Saved {
            self.refresh();
        }
    }

    /// Begins to save what is not saved yet.
    pub(super) fn save_pending(&mut self) {
        if let Some(saving) = self.file.start_saving() {
            let (expected, content) = (saving.expected, saving.content);
            self.effects.push_back(Effect::Save { expected, content });
        }
    }
}

fn identified(event: &Event) -> String {
    let named = |name: &Name| format!("identified as {name}");
    event.name.as_ref().map_or_else(|| "identified".to_owned(), named)
}

fn address(event: &Event) -> String {
    event.address.map_or_else(String::new, |address| address.to_string())
}

/// One line of two that one frame gave rise to: that a device appeared, moved or rebooted, and that it
/// claims its address.
fn one_line(first: &str, second: &str) -> Option<String> {
    let moved = second.starts_with("moved");
    match first {
        "appeared" if moved => Some(second.to_owned()),
        "appeared" | "rebooted" if !moved => Some(format!("{first}, {second}")),
        _ if first.starts_with("moved") && !moved => Some(format!("{first}, {second}")),
        _ => None,
    }
}

/// Few changes in one line, as far as they can be read there to the end.
fn as_lines(changes: Vec<String>) -> Vec<String> {
    /// What a line of 80 columns has room for behind the time, the file and that it was changed.
    const ROOM: usize = 36;
    let joined = changes.join("; ");
    if changes.len() > 1 && joined.chars().count() <= ROOM { vec![joined] } else { changes }
}

/// A finding as a line tells it; one without words yet by its kind.
fn finding_in_words(
    confidence: Confidence,
    key: &FindingKey,
    text: &str,
) -> (TimelineKind, String) {
    let kind = match confidence {
        Confidence::Cleared => TimelineKind::Cleared,
        Confidence::Suspected => TimelineKind::Suspected,
        Confidence::Confirmed => TimelineKind::Confirmed,
    };
    let text = if text.is_empty() { key.kind.name() } else { text };
    (kind, format!("{confidence}: {text}"))
}

/// What changed between two words of an adapter, in lines.
fn changes(old: &BusStatus, status: &BusStatus) -> Vec<(TimelineKind, String)> {
    let shown = |text: &String| Escaped(text.as_bytes()).to_string();
    let message = status.message.as_ref().map(shown);
    let mut lines = Vec::new();
    if old.link != status.link {
        lines.push(match status.link {
            Link::Opening => (TimelineKind::Bus, "opening".to_owned()),
            Link::Up if old.link == Link::Ended => {
                (TimelineKind::Bus, "log has grown: replay continues".to_owned())
            }
            Link::Up => (TimelineKind::Bus, "open".to_owned()),
            Link::Ended => (TimelineKind::Bus, "end of log".to_owned()),
            _ => (TimelineKind::Error, message.unwrap_or_else(|| "down".to_owned())),
        });
    }
    if status.filtered && !old.filtered {
        lines.push((
            TimelineKind::Bus,
            "receive filter on: only matching frames are read".to_owned(),
        ));
    }
    let stays_up = old.link == Link::Up && status.link == Link::Up;
    if stays_up && old.outages < status.outages {
        lines.push((TimelineKind::Error, "was briefly down".to_owned()));
    }
    let was_off = old.state == BusState::BusOff || status.state == BusState::BusOff;
    if stays_up && old.bus_offs < status.bus_offs && !was_off {
        lines.push((TimelineKind::Error, "was briefly bus-off".to_owned()));
    }
    if old.renamed != status.renamed {
        let text = match &status.renamed {
            Some(name) => format!("interface renamed to {}", shown(name)),
            None if status.link == Link::Up => "interface has its old name again".to_owned(),
            None => "renamed interface not found".to_owned(),
        };
        lines.push((TimelineKind::Bus, text));
    }
    if old.state != status.state && status.state != BusState::Unknown {
        let kind = match status.state {
            BusState::ErrorActive => TimelineKind::Bus,
            BusState::ErrorWarning => TimelineKind::Late,
            _ => TimelineKind::Error,
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
        lines.push((TimelineKind::Bus, format!("{bitrate} bit/s")));
    }
    if let Some(note) = status.note.as_ref().filter(|note| old.note.as_ref() != Some(note)) {
        lines.push((TimelineKind::Bus, shown(note)));
    }
    match (old.is_transmit_queue_full, status.is_transmit_queue_full) {
        (false, true) => {
            lines.push((TimelineKind::Error, "transmit queue full: frames not sent".to_owned()));
        }
        (true, false) if status.link == Link::Up => {
            lines.push((TimelineKind::Bus, "transmit queue no longer full".to_owned()));
        }
        _ => {}
    }
    // Once: whoever sends such things sends many.
    if old.unreadable == 0 && status.unreadable > 0 {
        lines.push((TimelineKind::Error, "unreadable data received (counted)".to_owned()));
    }
    for (before, now, why) in [
        (old.kernel_drops, status.kernel_drops, "the kernel's receive buffer was full"),
        (old.queue_drops, status.queue_drops, "descan's receive queue was full"),
        (old.controller_overruns, status.controller_overruns, "controller overrun"),
    ] {
        if before < now {
            lines.push((TimelineKind::Error, format!("frames lost: {why}")));
        }
    }
    lines
}
