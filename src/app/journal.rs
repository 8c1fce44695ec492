//! What the buses take besides frames, in order: each input with the number of frames before it, in
//! about four bytes. Does not know what an input does.

use super::varint::{read_varint, write_varint};
use crate::discovery::{Config, DeviceId, DeviceRequest, FrameSequence};
use crate::frame::{BusIndex, Frame};
use crate::status::BusStatus;
use crate::time::Instant;
use crate::wire::descriptor::DescriptorField;
use crate::wire::profile::Profile;
use std::collections::VecDeque;
use std::sync::Arc;

/// Bits of the first byte of an input that are its kind; the others are frames since the input before.
const KIND_BITS: u32 = 2;
/// Number of frames from which it stands in bytes of its own.
const MANY_FRAMES: u64 = 0xFF >> KIND_BITS;
/// Bytes that an input with data is counted as: a status with its texts.
const DATA_BYTES: usize = 512;

/// What the buses take besides frames.
#[derive(Clone, Debug)]
pub(super) enum BusesInput {
    /// Something is due.
    Timeout,
    /// The engines are asked for a frame to send.
    Transmit,
    /// A second is over.
    Tick,
    /// The program was stopped since that moment.
    Stall(Instant),
    /// The status of a bus changed.
    Status(BusIndex, Arc<BusStatus>),
    /// The bit rate of a bus is searched, or of none.
    Searched(Option<BusIndex>),
    /// The enumeration starts again.
    Rescan,
    /// A frame is sent as it stands.
    Send(Frame),
    /// Frames are sent as they are.
    SendFrames(BusIndex, Arc<FrameSequence>),
    /// No further frame of a sequence is sent.
    StopFrames(BusIndex),
    /// The engine of a bus sends no more requests and flow control by itself.
    Yield(BusIndex),
    /// A request to a device.
    Request(DeviceRequest),
    /// A field of the descriptor of a device is read, or all.
    ReadDescriptor(DeviceId, Option<DescriptorField>),
    /// The lost devices are removed.
    RemoveLost,
    /// A bus has another name.
    Rename(BusIndex, String),
    /// A bus is added.
    Add(String, Arc<Config>),
    /// The frames of all buses are read by another profile.
    Profile(Arc<Profile>),
}

/// An input, with the number of frames that the buses took before it.
#[derive(Clone, Debug)]
pub(super) struct PastInput {
    pub frames: u64,
    pub time: Instant,
    pub input: BusesInput,
}

/// A place between two inputs.
#[derive(Clone, Copy, Debug)]
pub(super) struct JournalPlace {
    /// Number of inputs before it.
    pub inputs: u64,
    /// Number of bytes, and of inputs with data, before it.
    bytes: u64,
    data: u64,
    /// Frames and time of the input before it.
    frames: u64,
    time: Instant,
}

/// The inputs, from a place on.
#[derive(Debug)]
pub(super) struct InputJournal {
    bytes: VecDeque<u8>,
    /// The inputs with data.
    data: VecDeque<BusesInput>,
    first: JournalPlace,
    end: JournalPlace,
}

impl InputJournal {
    /// Returns a journal without inputs that begins at `time`.
    pub fn new(time: Instant) -> Self {
        let first = JournalPlace { inputs: 0, bytes: 0, data: 0, frames: 0, time };
        Self { bytes: VecDeque::new(), data: VecDeque::new(), first, end: first }
    }

    /// Appends an input after so many frames.
    pub fn push(&mut self, frames: u64, time: Instant, input: BusesInput) {
        let kind = match input {
            BusesInput::Timeout => 0,
            BusesInput::Transmit => 1,
            BusesInput::Tick => 2,
            _ => 3,
        };
        let before = self.bytes.len();
        let since = frames.saturating_sub(self.end.frames);
        self.bytes.push_back(kind | (since.min(MANY_FRAMES) << KIND_BITS) as u8);
        if since >= MANY_FRAMES {
            write_varint(&mut self.bytes, since);
        }
        let step = time.as_micros().wrapping_sub(self.end.time.as_micros()).cast_signed();
        // The sign as the lowest bit.
        write_varint(&mut self.bytes, (step << 1 ^ step >> 63).cast_unsigned());
        if kind == 3 {
            self.data.push_back(input);
            self.end.data += 1;
        }
        self.end.inputs += 1;
        self.end.bytes += (self.bytes.len() - before) as u64;
        (self.end.frames, self.end.time) = (self.end.frames + since, time);
    }

    /// The place behind the last input.
    pub fn end(&self) -> JournalPlace {
        self.end
    }

    /// Returns true if the inputs from a place on are kept.
    pub fn is_kept(&self, place: JournalPlace) -> bool {
        place.inputs >= self.first.inputs
    }

    /// Drops the inputs before a place.
    pub fn drop_before(&mut self, place: JournalPlace) {
        if self.is_kept(place) {
            self.bytes.drain(..(place.bytes - self.first.bytes) as usize);
            self.data.drain(..(place.data - self.first.data) as usize);
            self.first = place;
        }
    }

    /// Bytes of memory.
    pub fn size(&self) -> usize {
        self.bytes.len() + self.data.len() * DATA_BYTES
    }

    /// Inputs from a place on, which must be kept.
    pub fn inputs_from(&self, place: JournalPlace) -> InputsFrom<'_> {
        InputsFrom { journal: self, place }
    }
}

/// Inputs from a place on.
#[derive(Clone, Debug)]
pub(super) struct InputsFrom<'a> {
    journal: &'a InputJournal,
    place: JournalPlace,
}

impl InputsFrom<'_> {
    /// The place behind the last input that was returned.
    pub fn place(&self) -> JournalPlace {
        self.place
    }
}

impl Iterator for InputsFrom<'_> {
    type Item = PastInput;

    fn next(&mut self) -> Option<PastInput> {
        let journal = self.journal;
        let from = usize::try_from(self.place.bytes.checked_sub(journal.first.bytes)?).ok()?;
        if from >= journal.bytes.len() {
            return None;
        }
        let mut used = 0;
        let mut bytes = journal.bytes.range(from..).copied().inspect(|_| used += 1);
        let head = bytes.next()?;
        let since = match u64::from(head >> KIND_BITS) {
            MANY_FRAMES => read_varint(&mut bytes)?,
            since => since,
        };
        let step = read_varint(&mut bytes)?;
        let step = (step >> 1).cast_signed() ^ -(step & 1).cast_signed();
        let time = self.place.time.as_micros().wrapping_add_signed(step);
        let input = match head & ((1 << KIND_BITS) - 1) {
            0 => BusesInput::Timeout,
            1 => BusesInput::Transmit,
            2 => BusesInput::Tick,
            _ => {
                let at = self.place.data.checked_sub(journal.first.data)? as usize;
                self.place.data += 1;
                journal.data.get(at)?.clone()
            }
        };
        self.place.inputs += 1;
        self.place.bytes += used;
        self.place.frames += since;
        self.place.time = Instant::from_micros(time);
        Some(PastInput { frames: self.place.frames, time: self.place.time, input })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_read_as_they_were_written() {
        let at = Instant::from_micros;
        let mut journal = InputJournal::new(at(5_000_000));
        let inputs = [
            (0, 5_000_000, BusesInput::Tick),
            (0, 4_000_000, BusesInput::Stall(at(9))),
            (61, 6_000_000, BusesInput::Timeout),
            (124, 6_000_001, BusesInput::Transmit),
            (1 << 40, 1 << 50, BusesInput::Rename(BusIndex(3), "can3".into())),
            (1 << 40, 0, BusesInput::Timeout),
        ];
        for (frames, time, input) in &inputs {
            journal.push(*frames, at(*time), input.clone());
        }
        let text = |it: &PastInput| format!("{} {:?} {:?}", it.frames, it.time, it.input);
        let begin = journal.first;
        let mut read = journal.inputs_from(begin);
        let mut places = vec![read.place()];
        for (frames, time, input) in inputs {
            let found = read.next().unwrap();
            assert_eq!(text(&found), text(&PastInput { frames, time: at(time), input }));
            places.push(read.place());
        }
        assert!(read.next().is_none());
        // From a place in the middle, also after the inputs before were dropped.
        let rest: Vec<String> = journal.inputs_from(places[2]).map(|it| text(&it)).collect();
        journal.drop_before(places[2]);
        let left: Vec<String> = journal.inputs_from(places[2]).map(|it| text(&it)).collect();
        assert_eq!((rest.len(), &rest), (4, &left));
        assert!(!journal.is_kept(places[1]) && journal.is_kept(places[2]));
    }

    #[test]
    fn frequent_inputs_take_few_bytes() {
        let mut journal = InputJournal::new(Instant::ZERO);
        for number in 0..10_000_u64 {
            let time = Instant::from_micros(number * 7_000);
            journal.push(number * 10, time, BusesInput::Timeout);
        }
        assert!(journal.size() < 40_000, "{}", journal.size());
    }
}
