//! What a gateway publishes: retained documents, of which only changes are sent, and a bounded queue
//! of events, which wait while the broker is away.
//!
//! Inputs: all documents of a moment, events, and what became of messages. Output:
//! [`Publication::poll_message`]. A state machine without I/O; the caller takes the documents at most
//! once a second, so that no topic is sent more often.

use super::topic::{GatewayName, TopicPath};
use crate::time::{Duration, Instant};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::Arc;

/// Number of events that wait for the broker at most; the oldest are dropped, and counted.
pub const MAX_QUEUED_EVENTS: usize = 10_000;

/// Number of bytes of the events that wait for the broker at most.
const MAX_QUEUED_BYTES: usize = 8 << 20;

/// Number of messages that are sent before the first is acknowledged.
const MAX_IN_FLIGHT: usize = 64;

/// A document as it is now.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetDocument {
    /// What it is about.
    pub path: TopicPath,
    /// An object.
    pub value: Value,
    /// Members that do not cause a message when only they change, as `heartbeat.count`.
    pub counters: &'static [&'static str],
    /// Time after which a change of these members is sent as well, at the latest. Not all documents with one
    /// period are sent at once: each has its own time in it.
    pub counter_period: Duration,
}

/// A message to the broker, with QoS 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetMessage {
    /// The topic.
    pub topic: String,
    /// The content; empty to clear a retained document.
    pub payload: Arc<[u8]>,
    /// The broker keeps it for later subscribers.
    pub is_retained: bool,
    /// Whether the broker takes a message of this length.
    pub length: MessageLength,
    /// To be passed back when it is known what became of the message.
    pub id: FleetMessageId,
}

/// Whether the broker takes a message of this length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageLength {
    /// It does.
    Accepted,
    /// It does not take the document: the message clears what it has of it.
    Cleared,
    /// It does not, and the message is not sent.
    TooLong,
}

/// Which message it was.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FleetMessageId {
    /// A document: its levels after the gateway, and its version.
    Document(String, u64),
    /// An event, by its number.
    Event(u64),
}

/// What is known of other programs with the name of the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OtherRun {
    /// None, or an earlier one.
    None,
    /// One that was started later: this one gives way.
    Later,
}

/// Latest start that is believed, in Unix milliseconds: 2200-01-01.
const MAX_STARTED: u64 = 7_258_118_400_000;

/// A document, and what the broker has of it.
#[derive(Debug)]
struct DocumentSlot {
    /// The content; `None` once it is to be cleared.
    payload: Option<Arc<[u8]>>,
    /// The value; of its counters only whether they are known.
    compared: Value,
    /// The whole value, if its counters are sent too.
    whole: Option<Value>,
    /// Time at which a change of the counters is sent.
    counters_due: Instant,
    version: u64,
    /// The broker may have it, or an earlier version.
    is_sent: bool,
}

/// See the module's documentation.
#[derive(Debug)]
pub struct Publication {
    gateway: GatewayName,
    /// Start of the program, in Unix milliseconds: tells the documents and events of two runs apart, and
    /// is later than that of any run before.
    started: u64,
    /// Tells this program from another one with the name that started in the same millisecond.
    instance: u64,
    documents: BTreeMap<String, DocumentSlot>,
    /// Documents to be sent.
    due: BTreeSet<String>,
    version: u64,
    /// Events to be sent, by their number.
    events: VecDeque<(u64, Arc<[u8]>)>,
    queued_bytes: usize,
    /// Events that were sent and are not acknowledged, by their number.
    sent_events: BTreeMap<u64, Arc<[u8]>>,
    /// Number of the last event.
    last_event: u64,
    dropped_events: u64,
    in_flight: usize,
    refused: u64,
    refused_events: u64,
    /// Documents that the broker refused last: one of them is tried again with each status, and all once it
    /// takes one of them.
    refused_documents: VecDeque<String>,
    /// The refused document that is tried again.
    probe: Option<String>,
    /// Documents that are longer than the broker takes.
    long_documents: BTreeSet<String>,
    /// Largest message that the broker takes, in bytes.
    max_message: usize,
    is_connected: bool,
    /// Number of connections so far.
    connections: u64,
    /// Number of the connection whose last will is the status that the broker has, if it kept everything;
    /// `None` once that is known.
    expected_will: Option<u64>,
    /// All documents that the broker has are to be read.
    is_reading_due: bool,
    /// The status that the broker had before, or an own one, was read.
    knows_kept_status: bool,
    /// All documents may be sent again, as another program may have changed them: once for each status.
    may_repeat: bool,
}

impl Publication {
    /// Creates the publication of a program that started at `started`, in Unix milliseconds.
    pub fn new(gateway: GatewayName, started: u64) -> Self {
        Self {
            gateway,
            started,
            instance: 0,
            documents: BTreeMap::new(),
            due: BTreeSet::new(),
            version: 0,
            events: VecDeque::new(),
            queued_bytes: 0,
            sent_events: BTreeMap::new(),
            last_event: 0,
            dropped_events: 0,
            in_flight: 0,
            refused: 0,
            refused_events: 0,
            refused_documents: VecDeque::new(),
            probe: None,
            long_documents: BTreeSet::new(),
            max_message: usize::MAX,
            is_connected: false,
            connections: 0,
            expected_will: None,
            is_reading_due: false,
            knows_kept_status: false,
            may_repeat: true,
        }
    }

    /// Returns it with a number that another program of the same moment does not have.
    #[must_use]
    pub fn with_instance(mut self, instance: u64) -> Self {
        self.instance = instance;
        self
    }

    /// The gateway.
    pub fn gateway(&self) -> &GatewayName {
        &self.gateway
    }

    /// Number of messages that the broker refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Returns true if there is a document that the broker does not take, or was an event that it does not
    /// have.
    pub fn is_incomplete(&self) -> bool {
        self.refused_events + self.dropped_events > 0
            || self.probe.is_some()
            || !(self.refused_documents.is_empty() && self.long_documents.is_empty())
    }

    /// Number of events that were dropped, as the broker was away for too long.
    pub fn dropped_events(&self) -> u64 {
        self.dropped_events
    }

    /// Returns true if the broker has everything.
    pub fn is_delivered(&self) -> bool {
        self.due.is_empty() && self.events.is_empty() && self.in_flight == 0
    }

    /// The last will of the next connection: what the broker publishes as the status if it is lost.
    pub fn last_will(&self) -> FleetMessage {
        let payload = json!({
            "online": false,
            "reason": "lost",
            "descan": env!("CARGO_PKG_VERSION"),
            "started_ms": self.started,
            "instance": self.instance,
            "connection": self.connections + 1,
        });
        FleetMessage {
            topic: TopicPath::Status.of(&self.gateway),
            payload: payload.to_string().into_bytes().into(),
            is_retained: true,
            length: MessageLength::Accepted,
            id: FleetMessageId::Document(TopicPath::Status.to_string(), 0),
        }
    }

    /// Takes all documents but the status as of `now` (`unix_secs` on the wall clock). What is not
    /// among them is cleared.
    pub fn handle_documents(
        &mut self,
        now: Instant,
        unix_secs: f64,
        documents: impl IntoIterator<Item = FleetDocument>,
    ) {
        let mut gone: BTreeSet<String> = self.documents.keys().cloned().collect();
        gone.remove(&TopicPath::Status.to_string());
        for FleetDocument { path, value, counters, counter_period } in documents {
            let tail = path.to_string();
            gone.remove(&tail);
            let compared = without(&value, counters);
            if let Some(slot) = self.documents.get(&tail).filter(|slot| slot.payload.is_some()) {
                let is_old = now >= slot.counters_due;
                let is_same = is_same(&slot.compared, &compared, counters);
                if is_same && (!is_old || slot.whole.as_ref() == Some(&value)) {
                    continue;
                }
            }
            let payload = with_members(value.clone(), [("time", json!(unix_secs))]);
            let counters_due = next_in_period(now, counter_period, &tail);
            self.put(tail, &payload, counters_due, compared, Some(value));
        }
        for tail in gone {
            self.clear(tail);
        }
    }

    /// Takes the summary of the gateway, which is sent in any case.
    pub fn handle_status(&mut self, unix_secs: f64, summary: Value) {
        let events = json!({"last": self.last_event, "dropped": self.dropped_events});
        let members = [
            ("online", json!(true)),
            ("started_ms", json!(self.started)),
            ("instance", json!(self.instance)),
            ("connection", json!(self.connections)),
            ("time", json!(unix_secs)),
            ("events", events),
        ];
        let payload = with_members(summary, members);
        self.may_repeat = true;
        self.refused_documents.retain(|tail| self.documents.contains_key(tail));
        self.probe = self.refused_documents.pop_front();
        if let Some(tail) = self.probe.clone() {
            self.mark_due(tail);
        }
        self.put_status(&payload);
    }

    /// The program stops: the status says so, as the last message.
    pub fn handle_stop(&mut self, unix_secs: f64) {
        let payload = json!({
            "online": false, "reason": "stopped", "started_ms": self.started,
            "instance": self.instance, "time": unix_secs, "descan": env!("CARGO_PKG_VERSION"),
            "events": {"last": self.last_event, "dropped": self.dropped_events},
        });
        self.put_status(&payload);
    }

    /// Takes an event, an object as in `watch --json`.
    pub fn handle_event(&mut self, event: Value) {
        self.last_event += 1;
        let members = [("seq", json!(self.last_event)), ("started_ms", json!(self.started))];
        let payload: Arc<[u8]> = with_members(event, members).to_string().into_bytes().into();
        self.queued_bytes += payload.len();
        self.events.push_back((self.last_event, payload));
        self.keep_bound();
    }

    /// Drops the oldest events above the bound.
    fn keep_bound(&mut self) {
        while self.events.len() > MAX_QUEUED_EVENTS || self.queued_bytes > MAX_QUEUED_BYTES {
            let Some((_, payload)) = self.events.pop_front() else { return };
            self.queued_bytes -= payload.len();
            self.dropped_events += 1;
        }
    }

    /// The broker is connected. Without a kept session it may have lost what it had: all documents
    /// are sent again. With one it may have, too, if it was killed and continues from what was on its disk:
    /// the status that it has tells.
    pub fn handle_connected(&mut self, is_session_kept: bool) {
        self.is_connected = true;
        self.connections += 1;
        // It may take more now.
        self.due.append(&mut self.long_documents);
        if is_session_kept {
            self.expected_will = Some(self.connections - 1);
            // The last will may have replaced it.
            self.renew_status();
        } else {
            self.expected_will = None;
            self.send_all_again();
        }
    }

    /// All documents are sent, and those that the broker has are read, of which others are cleared.
    fn send_all_again(&mut self) {
        self.due = self.documents.keys().cloned().collect();
        self.is_reading_due = true;
    }

    /// Returns true, once, if all documents of this gateway that the broker has are to be read, for
    /// [`Self::handle_message`].
    pub fn poll_reading(&mut self) -> bool {
        std::mem::take(&mut self.is_reading_due)
    }

    /// The connection is lost: nothing is sent until the next one.
    pub fn handle_disconnected(&mut self) {
        self.is_connected = false;
    }

    /// Takes a document of this gateway from the broker: kept there since before the subscription
    /// (`is_kept`), or published meanwhile. A kept one that is not known, left by an earlier run, is cleared.
    pub fn handle_message(&mut self, topic: &str, payload: &[u8], is_kept: bool) -> OtherRun {
        let own = self.gateway.topic("");
        let Some(tail) = topic.strip_prefix(&own).filter(|_| !payload.is_empty()) else {
            return OtherRun::None;
        };
        if tail == "status" {
            return self.handle_other_status(payload, is_kept);
        }
        if is_kept && !self.documents.contains_key(tail) {
            self.clear(tail.to_owned());
        }
        OtherRun::None
    }

    /// The status at the broker. Another program with the name may have changed documents; the one that
    /// was started later stays.
    fn handle_other_status(&mut self, payload: &[u8], is_kept: bool) -> OtherRun {
        let status: Value = serde_json::from_slice(payload).unwrap_or_default();
        let number = |name: &str| status.get(name).and_then(Value::as_u64).unwrap_or_default();
        let started = number("started_ms");
        let run = (started, number("instance"));
        let own = (self.started, self.instance);
        let is_own = run == own;
        let is_first_kept = is_kept && !self.knows_kept_status;
        self.knows_kept_status |= is_kept || is_own;
        if is_own {
            self.handle_own_status(&status, number("connection"), is_kept);
            return OtherRun::None;
        }
        if run < own || started > MAX_STARTED {
            // Not for each of many.
            if std::mem::replace(&mut self.may_repeat, false) {
                self.send_all_again();
            }
            return OtherRun::None;
        }
        if is_first_kept {
            // That of an earlier run, by a clock that was ahead.
            self.started = started + 1;
            self.renew_status();
            return OtherRun::None;
        }
        OtherRun::Later
    }

    /// An own status at the broker. After a connection with a kept session, it is the last will of the one
    /// before, or the broker lost what came after it.
    fn handle_own_status(&mut self, status: &Value, connection: u64, is_kept: bool) {
        let Some(expected) = self.expected_will else { return };
        // One that was not kept and is of this connection: there was no kept one. Older ones come with the
        // session.
        if is_kept || connection == self.connections {
            self.expected_will = None;
            let is_will = status.get("reason").is_some_and(|it| it == "lost");
            // A connection that was lost before this end knew of it has a number that is used again.
            if !is_kept || !is_will || connection < expected {
                self.send_all_again();
            }
        }
    }

    /// What became of a message: the broker has it.
    pub fn handle_delivered(&mut self, id: &FleetMessageId) {
        self.in_flight = self.in_flight.saturating_sub(1);
        match id {
            FleetMessageId::Event(number) => {
                self.sent_events.remove(number);
            }
            FleetMessageId::Document(tail, version) => {
                self.refused_documents.retain(|refused| refused != tail);
                if self.probe.take_if(|probe| probe == tail).is_some() {
                    for refused in std::mem::take(&mut self.refused_documents) {
                        self.mark_due(refused);
                    }
                }
                let is_clear = |slot: &DocumentSlot| slot.payload.is_none();
                let slot = self.documents.get(tail).filter(|slot| slot.version == *version);
                if slot.is_some_and(is_clear) {
                    self.documents.remove(tail);
                    self.due.remove(tail);
                    self.long_documents.remove(tail);
                }
            }
        }
    }

    /// What became of a message: it was lost with the session, and is sent again.
    pub fn handle_undelivered(&mut self, id: &FleetMessageId) {
        self.in_flight = self.in_flight.saturating_sub(1);
        match id {
            FleetMessageId::Event(number) => {
                let Some(payload) = self.sent_events.remove(number) else { return };
                let at = self.events.partition_point(|(other, _)| other < number);
                self.queued_bytes += payload.len();
                self.events.insert(at, (*number, payload));
                self.keep_bound();
            }
            FleetMessageId::Document(tail, version) => {
                if self.documents.get(tail).is_some_and(|slot| slot.version == *version) {
                    self.due.insert(tail.clone());
                }
            }
        }
    }

    /// What became of a message: the broker does not take it. Events are not sent again.
    pub fn handle_refused(&mut self, id: &FleetMessageId) {
        self.refused += 1;
        self.probe = None;
        self.handle_delivered(id);
        match id {
            // Of one that was to be cleared, nothing is left to send.
            FleetMessageId::Document(tail, _) if self.documents.contains_key(tail) => {
                self.refused_documents.push_back(tail.clone());
            }
            FleetMessageId::Document(..) => {}
            FleetMessageId::Event(_) => self.refused_events += 1,
        }
    }

    /// The broker takes messages of at most so many bytes, topic and content.
    pub fn set_max_message(&mut self, bytes: usize) {
        self.max_message = bytes;
    }

    /// Returns the next message to send: documents before the status, which tells that they are
    /// complete, then events.
    pub fn poll_message(&mut self) -> Option<FleetMessage> {
        if !self.is_connected || self.in_flight >= MAX_IN_FLIGHT {
            return None;
        }
        let message = self.next_document().or_else(|| self.next_event())?;
        self.in_flight += 1;
        Some(message)
    }

    fn next_document(&mut self) -> Option<FleetMessage> {
        let status = TopicPath::Status.to_string();
        let tail = self.due.iter().find(|tail| **tail != status).or(self.due.first())?.clone();
        self.due.remove(&tail);
        let slot = self.documents.get_mut(&tail)?;
        slot.is_sent = true;
        let topic = self.gateway.topic(&tail);
        let payload = slot.payload.clone().unwrap_or_default();
        let id = FleetMessageId::Document(tail.clone(), slot.version);
        let length = match self.max_message.checked_sub(topic.len()) {
            None => MessageLength::TooLong,
            Some(room) if payload.len() > room => MessageLength::Cleared,
            Some(_) => MessageLength::Accepted,
        };
        let payload = if length == MessageLength::Cleared { Arc::default() } else { payload };
        if length == MessageLength::Cleared {
            self.refused += 1;
            self.long_documents.insert(tail);
        } else {
            self.long_documents.remove(&tail);
        }
        Some(FleetMessage { topic, payload, is_retained: true, length, id })
    }

    fn next_event(&mut self) -> Option<FleetMessage> {
        let (number, payload) = self.events.pop_front()?;
        self.queued_bytes -= payload.len();
        self.sent_events.insert(number, Arc::clone(&payload));
        let topic = TopicPath::Event.of(&self.gateway);
        let is_accepted = topic.len() + payload.len() <= self.max_message;
        let length = if is_accepted { MessageLength::Accepted } else { MessageLength::TooLong };
        let id = FleetMessageId::Event(number);
        Some(FleetMessage { topic, payload, is_retained: false, length, id })
    }

    fn put_status(&mut self, payload: &Value) {
        let tail = TopicPath::Status.to_string();
        self.put(tail, payload, Instant::ZERO, Value::Null, None);
    }

    fn put(
        &mut self,
        tail: String,
        payload: &Value,
        counters_due: Instant,
        compared: Value,
        whole: Option<Value>,
    ) {
        self.version += 1;
        let payload = Some(payload.to_string().into_bytes().into());
        let version = self.version;
        let is_sent = self.documents.get(&tail).is_some_and(|known| known.is_sent);
        let slot = DocumentSlot { payload, compared, whole, counters_due, version, is_sent };
        self.documents.insert(tail.clone(), slot);
        self.due.insert(tail);
    }

    /// Clears a document of the broker, unless that is under way. One that was never sent is forgotten:
    /// those of a broker that is away do not add up.
    fn clear(&mut self, tail: String) {
        if self.documents.get(&tail).is_some_and(|known| !known.is_sent) {
            self.documents.remove(&tail);
            self.due.remove(&tail);
            self.long_documents.remove(&tail);
            return;
        }
        self.version += 1;
        let slot = DocumentSlot {
            payload: None,
            compared: Value::Null,
            counters_due: Instant::ZERO,
            whole: None,
            version: self.version,
            is_sent: true,
        };
        match self.documents.get(&tail) {
            Some(known) if known.payload.is_none() => return,
            _ => self.documents.insert(tail.clone(), slot),
        };
        self.due.insert(tail);
    }

    fn mark_due(&mut self, tail: String) {
        if self.documents.contains_key(&tail) {
            self.due.insert(tail);
        }
    }

    /// Sends the status again, with the start of the program and the connection as they are now.
    fn renew_status(&mut self) {
        let tail = TopicPath::Status.to_string();
        let payload = self.documents.get(&tail).and_then(|slot| slot.payload.as_ref());
        let Some(Value::Object(mut status)) =
            payload.and_then(|payload| serde_json::from_slice(payload).ok())
        else {
            return;
        };
        status.insert("started_ms".to_owned(), json!(self.started));
        status.insert("connection".to_owned(), json!(self.connections));
        self.put_status(&Value::Object(status));
    }
}

/// Returns the next time in a period that a document has of its own: its documents do not come in bursts.
fn next_in_period(now: Instant, period: Duration, tail: &str) -> Instant {
    let period = period.as_millis().max(1) as u64;
    let mut hasher = DefaultHasher::new();
    tail.hash(&mut hasher);
    let offset = hasher.finish() % period;
    let now = now.since(Instant::ZERO).as_millis() as u64;
    let rounds = (now + period - offset) / period;
    Instant::ZERO + Duration::from_millis(rounds * period + offset)
}

/// Returns an object with further members.
fn with_members<const COUNT: usize>(
    object: Value,
    members: [(&'static str, Value); COUNT],
) -> Value {
    let mut map = match object {
        Value::Object(map) => map,
        _ => Map::new(),
    };
    map.extend(members.map(|(name, value)| (name.to_owned(), value)));
    Value::Object(map)
}

/// Returns an object with only whether its counters are known.
fn without(object: &Value, counters: &[&str]) -> Value {
    let mut object = object.clone();
    for counter in counters {
        if let Some(value) = member(&mut object, counter) {
            *value = Value::Bool(!value.is_null());
        }
    }
    object
}

/// Returns true if nothing but counters changed. A counter that was known and is not now does not count:
/// it may come and go.
fn is_same(before: &Value, now: &Value, counters: &[&str]) -> bool {
    if before == now {
        return true;
    }
    let (mut before, mut now) = (before.clone(), now.clone());
    for counter in counters {
        let both = member(&mut before, counter).zip(member(&mut now, counter));
        if let Some((before, now)) = both.filter(|(before, _)| **before == Value::Bool(true)) {
            now.clone_from(before);
        }
    }
    before == now
}

/// Returns a member of an object; `heartbeat.count` is a member of a member.
fn member<'a>(object: &'a mut Value, name: &str) -> Option<&'a mut Value> {
    match name.split_once('.') {
        Some((parent, name)) => object.get_mut(parent)?.get_mut(name),
        None => object.get_mut(name),
    }
}
