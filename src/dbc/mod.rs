//! DBC files: names of messages and signals, with the values and units of the signals, for frames that are
//! not of DES.
//!
//! Input: the bytes of files, and frames. Output: [`MessageDatabase`], and the message of a frame with the
//! values of its signals. Texts of a file are printable when they are read. Opens no files. Does not know
//! which frames are of DES.

mod decimal;
mod file;
mod signal;
mod tokens;

pub use file::{DbcError, MAX_FILE, MAX_MESSAGES};
pub use signal::MessageSignal;

use crate::frame::{CanId, Frame, FrameKind};
use crate::wire::data_layout::{DataFieldValue, DataValue};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt::Write;

/// Bit of the identifier of a message with 29 bits, as the file has it.
const EXTENDED: u32 = 0x8000_0000;
/// Bits of the sender's address in the identifier of a parameter group (SAE J1939-21).
const SOURCE: u32 = 0xFF;
/// Address of no device, which files have for any sender (SAE J1939-81).
const NULL_ADDRESS: u32 = 0xFE;
/// Most multiplexors that a signal depends on.
const MAX_DEPTH: usize = 16;

/// Messages of one or several files, by their identifiers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MessageDatabase {
    /// By identifier, with [`EXTENDED`].
    messages: BTreeMap<u32, NamedMessage>,
    /// Identifiers of parameter groups of J1939, by [`parameter_group`].
    groups: BTreeMap<u32, Vec<u32>>,
}

/// A message: its name and its signals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NamedMessage {
    name: String,
    signals: Vec<MessageSignal>,
    /// It is a parameter group of J1939: of any sender, receiver and priority.
    is_parameter_group: bool,
}

impl MessageDatabase {
    /// Adds the messages of a file. Of several messages with one identifier the first one stays, also of
    /// files added before.
    ///
    /// # Errors
    ///
    /// The first mistake, with its line. Nothing is added.
    pub fn add(&mut self, bytes: &[u8]) -> Result<(), DbcError> {
        for (id, message) in file::read(bytes)? {
            let Entry::Vacant(place) = self.messages.entry(id) else { continue };
            if message.is_parameter_group {
                self.groups.entry(parameter_group(id)).or_default().push(id);
            }
            place.insert(message);
        }
        Ok(())
    }

    /// Returns true without messages.
    pub fn is_empty(&self) -> bool {
        self.messages.is_empty()
    }

    /// Returns the message of a data frame: the one with its identifier, otherwise the parameter group of it,
    /// of several the one of its sender, otherwise that of any sender, otherwise the first; `None` for other
    /// frames.
    pub fn message(&self, frame: &Frame) -> Option<&NamedMessage> {
        let id = match frame.id {
            CanId::Standard(id) => u32::from(id),
            CanId::Extended(id) => id | EXTENDED,
        };
        let of_group = || {
            let group = self.groups.get(&parameter_group(id)).filter(|_| id & EXTENDED != 0)?;
            let rank = |of: &&u32| match **of & SOURCE {
                source if source == id & SOURCE => 0,
                NULL_ADDRESS => 1,
                _ => 2,
            };
            self.messages.get(group.iter().min_by_key(rank)?)
        };
        self.messages.get(&id).or_else(of_group).filter(|_| frame.kind == FrameKind::Data)
    }
}

/// Returns the number of the parameter group in an identifier of 29 bits, with the bits that other parts of it
/// have cleared: priority and source address, and the destination address below format 240 (SAE J1939-21,
/// "Parameter group number").
fn parameter_group(id: u32) -> u32 {
    let is_addressed = id >> 16 & 0xFF < 240;
    id & if is_addressed { 0x03FF_0000 } else { 0x03FF_FF00 }
}

impl NamedMessage {
    /// Name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the signals that are in data, in the order of the file, with their values; those whose
    /// multiplexor has another value are left out. A signal that the data are too short for has no value.
    pub fn values(&self, data: &[u8]) -> Vec<DataFieldValue<'_>> {
        let places = (0..self.signals.len()).filter(|at| self.is_active(*at, data));
        let value = |at: usize| {
            let signal = &self.signals[at];
            let value = signal.value(data);
            let is_named = matches!(value, Some(DataValue::Named(_)));
            let unit = if is_named { "" } else { &signal.unit };
            DataFieldValue { name: &signal.name, unit, value }
        };
        places.map(value).collect()
    }

    /// Returns the name and the signals in words: `Engine: Speed 812.5 rpm, Fan on`.
    pub fn in_words(&self, data: &[u8]) -> String {
        let mut text = self.name.clone();
        for (at, field) in self.values(data).iter().enumerate() {
            // Writing to a text does not fail.
            let _ = write!(text, "{}{field}", if at == 0 { ": " } else { ", " });
        }
        text
    }

    /// Returns true if the multiplexors of a signal have the values at which it is there.
    fn is_active(&self, signal: usize, data: &[u8]) -> bool {
        // A multiplexor may be multiplexed itself; a file may have them in a circle.
        let mut at = signal;
        for _ in 0..MAX_DEPTH {
            let Some(signal) = self.signals.get(at) else { return false };
            let Some(multiplexed) = &signal.multiplexed else { return true };
            let raw = self.signals.get(multiplexed.by).and_then(|by| by.raw(data));
            if !raw.is_some_and(|raw| multiplexed.has(raw)) {
                return false;
            }
            at = multiplexed.by;
        }
        false
    }
}
