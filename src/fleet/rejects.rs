//! Messages of a broker that were not used: counters of all, and the topics that still have such a document.
//!
//! Input: what a message was refused for, and which topics are well again. Output: counters; the last cause
//! that still holds. Bounded: [`MAX_TOPICS`] topics, each by its first [`MAX_TOPIC_BYTES`] bytes. Does not know what a document is.

use crate::text::printable;
use std::collections::BTreeMap;

/// Number of topics that are remembered at most; further ones are counted alone.
const MAX_TOPICS: usize = 1000;
/// The first bytes of a topic by which it is remembered.
const MAX_TOPIC_BYTES: usize = 1024;

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
    /// Messages since all topics were last well.
    open: u64,
    topics: BTreeMap<Vec<u8>, RejectedTopic>,
    /// The last cause of a topic that is not remembered.
    other: Option<String>,
}

/// The last message of a topic was not used.
#[derive(Clone, Debug, PartialEq, Eq)]
struct RejectedTopic {
    /// Topic and cause.
    text: String,
    /// Number of the message.
    number: u64,
    /// The connection by which it was received.
    connection: u32,
}

impl FleetRejects {
    /// Number of all messages that were not used.
    pub fn count(&self) -> u64 {
        self.foreign + self.malformed + self.oversized
    }

    /// Number of messages that were not used since every topic last had a usable document, or none.
    pub fn open_count(&self) -> u64 {
        self.open
    }

    /// The last topic whose document is not used, with the cause.
    pub fn last(&self) -> Option<&str> {
        let last = self.topics.values().max_by_key(|topic| topic.number);
        last.map(|topic| &topic.text).or(self.other.as_ref()).map(String::as_str)
    }

    /// Counts a message.
    pub(super) fn add(
        &mut self,
        connection: u32,
        topic: &[u8],
        reason: RejectReason,
        text: String,
    ) {
        match reason {
            RejectReason::Foreign => self.foreign += 1,
            RejectReason::Malformed => self.malformed += 1,
            RejectReason::Oversized => self.oversized += 1,
        }
        self.open += 1;
        let number = self.count();
        let key = key_of(topic);
        if self.topics.len() < MAX_TOPICS || self.topics.contains_key(key) {
            self.topics.insert(key.to_owned(), RejectedTopic { text, number, connection });
        } else {
            self.other = Some(text);
        }
    }

    /// The last message of a topic was used, or cleared it.
    pub(super) fn remove(&mut self, topic: &[u8]) {
        if self.topics.remove(key_of(topic)).is_some() {
            self.note_removed();
        }
    }

    /// All that the broker has was received by this connection: other documents were cleared meanwhile.
    pub(super) fn retain(&mut self, connection: u32) {
        self.topics.retain(|_, topic| topic.connection == connection);
        self.note_removed();
    }

    fn note_removed(&mut self) {
        if self.topics.is_empty() {
            (self.open, self.other) = (0, None);
        }
    }
}

fn key_of(topic: &[u8]) -> &[u8] {
    &topic[..topic.len().min(MAX_TOPIC_BYTES)]
}

/// A topic of any origin, shortened.
pub(super) fn shown_topic(topic: &[u8]) -> String {
    const MOST: usize = 80;
    printable(&topic[..topic.len().min(MOST)])
}
