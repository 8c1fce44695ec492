//! Messages of a broker that were not used: counters of all, and the topics whose document is not used now.
//!
//! Input: why a message was refused, and which topics have a usable document again, or none. Output:
//! counters, and the last cause that still holds. Bounded: [`MAX_TOPICS`] topics, each by its first
//! [`MAX_TOPIC_BYTES`] bytes, with a cause of [`MAX_CAUSE`] characters. Does not know what a document is.

use super::topic::{GatewayName, ROOT, TopicPath};
use crate::text::{printable, shortened};
use std::collections::BTreeMap;

/// Number of topics that are remembered at most; further ones are counted alone.
const MAX_TOPICS: usize = 1000;
/// Number of topics of one gateway that are remembered at most, so that others have room.
const MAX_GATEWAY_TOPICS: usize = 100;
/// The first bytes of a topic by which it is remembered.
const MAX_TOPIC_BYTES: usize = 1024;

/// Longest topic that is shown, and longest cause, in characters.
const MAX_SHOWN_TOPIC: usize = 150;
const MAX_CAUSE: usize = 200;

/// Why a message is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RejectReason {
    /// No gateway has such a topic.
    Foreign,
    /// It is not what its topic says.
    Malformed,
    /// It is too long, or above the bound of all.
    Oversized,
}

/// Messages that were not used.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FleetRejects {
    /// Messages with a topic that no gateway has.
    pub foreign: u64,
    /// Documents and events that are not what their topic says.
    pub malformed: u64,
    /// Documents that are too long, or above the bound of all.
    pub oversized: u64,
    topics: BTreeMap<Vec<u8>, RejectedTopic>,
    /// Messages of further topics since the last reading, and the last of them.
    beyond: u64,
    last_beyond: Option<RejectedTopic>,
    /// One of them may be of a gateway of which no topic is remembered.
    has_unknown_gateway: bool,
}

/// The last message of a topic was not used.
#[derive(Clone, Debug, PartialEq, Eq)]
struct RejectedTopic {
    /// Topic and cause, with `: ` between them.
    text: String,
    /// Bytes of the topic in it.
    topic_bytes: usize,
    /// Number of the message.
    number: u64,
    /// The connection by which it was received.
    connection: u32,
}

impl RejectedTopic {
    /// Topic and cause.
    fn parts(&self) -> (&str, &str) {
        let (topic, cause) = self.text.split_at(self.topic_bytes);
        (topic, cause.trim_start_matches(": "))
    }
}

impl FleetRejects {
    /// Number of all messages that were not used.
    pub fn count(&self) -> u64 {
        self.foreign + self.malformed + self.oversized
    }

    /// Number of topics whose last document or event is not used.
    pub fn open_count(&self) -> u64 {
        self.topics.len() as u64 + self.beyond
    }

    /// The last of them, with the cause.
    pub fn last(&self) -> Option<&str> {
        self.last_topic().map(|topic| topic.text.as_str())
    }

    /// Topic and cause of the last of them.
    pub fn last_parts(&self) -> Option<(&str, &str)> {
        self.last_topic().map(RejectedTopic::parts)
    }

    fn last_topic(&self) -> Option<&RejectedTopic> {
        let all = self.topics.values().chain(&self.last_beyond);
        all.max_by_key(|topic| topic.number)
    }

    /// Topic and cause of those that are remembered, by topic.
    pub fn documents(&self) -> impl Iterator<Item = (&str, &str)> {
        self.topics.values().map(RejectedTopic::parts)
    }

    /// Topic and cause of a document of that gateway that is not used; of one of any gateway if more gateways
    /// have such documents than are remembered.
    pub fn of_gateway(&self, gateway: &GatewayName) -> Option<&str> {
        let status = TopicPath::Status.of(gateway);
        let begin = status.trim_end_matches("status").as_bytes();
        let any = || self.last_beyond.as_ref().filter(|_| self.has_unknown_gateway);
        self.topics_of(begin).next().or_else(any).map(|it| it.text.as_str())
    }

    /// Remembered topics that begin so.
    fn topics_of(&self, begin: &[u8]) -> impl Iterator<Item = &RejectedTopic> {
        let from = self.topics.range(begin.to_vec()..);
        from.take_while(move |(topic, _)| topic.starts_with(begin)).map(|(_, rejected)| rejected)
    }

    /// Counts a message.
    pub(super) fn add(&mut self, connection: u32, topic: &[u8], reason: RejectReason, cause: &str) {
        match reason {
            RejectReason::Foreign => self.foreign += 1,
            RejectReason::Malformed => self.malformed += 1,
            RejectReason::Oversized => self.oversized += 1,
        }
        let shown = shortened(&printable(key_of(topic)), MAX_SHOWN_TOPIC);
        let text = format!("{shown}: {}", shortened(cause, MAX_CAUSE));
        let (topic_bytes, number) = (shown.len(), self.count());
        let rejected = RejectedTopic { text, topic_bytes, number, connection };
        let key = key_of(topic);
        let of_gateway =
            gateway_part(key).map_or(0, |it| self.topics_of(it).take(MAX_GATEWAY_TOPICS).count());
        let has_room = self.topics.len() < MAX_TOPICS && of_gateway < MAX_GATEWAY_TOPICS;
        if has_room || self.topics.contains_key(key) {
            self.topics.insert(key.to_owned(), rejected);
        } else {
            self.beyond += 1;
            self.last_beyond = Some(rejected);
            self.has_unknown_gateway |= of_gateway == 0 && gateway_part(key).is_some();
        }
    }

    /// The last message of a topic was used, or cleared it.
    pub(super) fn remove(&mut self, topic: &[u8]) {
        self.topics.remove(key_of(topic));
    }

    /// A connection begins that brings all documents again.
    pub(super) fn begin_reading(&mut self) {
        (self.beyond, self.last_beyond, self.has_unknown_gateway) = (0, None, false);
    }

    /// All that the broker has was received by this connection: other documents were cleared meanwhile.
    pub(super) fn retain(&mut self, connection: u32) {
        self.topics.retain(|_, topic| topic.connection == connection);
    }
}

/// The part of a topic that those of one gateway share: `descan/v1/GATEWAY/`.
fn gateway_part(topic: &[u8]) -> Option<&[u8]> {
    let name = topic.strip_prefix(ROOT.as_bytes())?.strip_prefix(b"/")?;
    let end = name.iter().position(|&byte| byte == b'/')? + 1;
    topic.get(..topic.len() - name.len() + end)
}

fn key_of(topic: &[u8]) -> &[u8] {
    &topic[..topic.len().min(MAX_TOPIC_BYTES)]
}
