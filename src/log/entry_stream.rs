//! Entries of formats whose files are read in any order, as a stream: databases of SQLite, ASAM MDF.
//!
//! [`super::unpack`] puts the stream in the place of such a file, as it puts the objects of BLF in the place
//! of their containers; the frames can then be read again by their place in it. Does not know files.

use super::binary::{BinaryFormat, EntryInput};
use super::channel::bus_name;
use super::fields::FieldFault;
use super::{Damage, LogEntry, LogSummary, LogTime, UnreadChanges};
use crate::frame::Frame;
use crate::frame::socketcan::{decode, fd_flags, id_word};

/// First bytes of a stream: of the rows of a database, of the records of a measurement.
pub(super) const ROWS_MAGIC: &[u8] = b"\x89descan entries\x01";
pub(super) const RECORDS_MAGIC: &[u8] = b"\x89descan entries\x02";

/// First byte of an entry.
const FRAME: u8 = 1;
const FAULT: u8 = 2;
const DAMAGE: u8 = 3;
const UNREAD_LOG: u8 = 4;
const UNREAD_JOURNAL: u8 = 5;
const CUT_OFF: u8 = 6;
const AMBIGUOUS_DATE: u8 = 7;
const UNKNOWN_ZONE: u8 = 8;
/// Number of the damage of a block.
const BLOCK: u8 = 3;
/// Bytes of a frame before its data, and of the other entries.
const FRAME_HEAD: usize = 18;
const FAULT_LEN: usize = 2;
const DAMAGE_LEN: usize = 10;
/// Flags of a frame, beside its raw DLC in the upper half of the byte: it was sent, and it is changed.
const SENT: u8 = 0x01;
const CHANGED: u8 = 0x02;
/// Byte in the place of the FD flags of a classic frame.
const CLASSIC: u8 = u8::MAX;

/// Faults by their number in a stream.
const FAULTS: [FieldFault; 11] = [
    FieldFault::TooLong,
    FieldFault::Time,
    FieldFault::Date,
    FieldFault::Channel,
    FieldFault::Id,
    FieldFault::Length,
    FieldFault::Data,
    FieldFault::Column,
    FieldFault::Kind,
    FieldFault::TimeRange,
    FieldFault::StartDate,
];

/// Writes a stream.
#[derive(Debug, Default)]
pub(super) struct EntryWriter {
    bytes: Vec<u8>,
}

impl EntryWriter {
    /// Begins with the first bytes of a stream.
    pub fn new(magic: &[u8]) -> Self {
        Self { bytes: magic.to_vec() }
    }

    /// The bytes that were written since [`Self::clear`].
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Forgets the bytes so far.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }

    /// Appends a frame of a numbered channel.
    pub fn frame(&mut self, unix_micros: u64, channel: u8, frame: &Frame) {
        let to = &mut self.bytes;
        let flag = |is_set, flag| if is_set { flag } else { 0 };
        let sent = flag(frame.is_tx, SENT) | flag(frame.is_changed(), CHANGED);
        to.extend_from_slice(&[FRAME, sent | frame.raw_dlc().unwrap_or(0) << 4, channel]);
        to.extend_from_slice(&unix_micros.to_le_bytes());
        to.extend_from_slice(&id_word(frame).to_le_bytes());
        let flags = if frame.is_fd { fd_flags(frame) } else { CLASSIC };
        // A remote frame has a length and no data.
        to.extend_from_slice(&[flags, frame.len() as u8, frame.data().len() as u8]);
        to.extend_from_slice(frame.data());
    }

    /// Appends an entry that cannot be read.
    pub fn fault(&mut self, fault: FieldFault) {
        let number = FAULTS.iter().position(|it| *it == fault).unwrap_or_default();
        self.bytes.extend_from_slice(&[FAULT, number as u8]);
    }

    /// Ends the stream: the data of the block that begins at this byte of the file cannot be read.
    pub fn damaged_block(&mut self, address: u64) {
        self.bytes.extend_from_slice(&[DAMAGE, BLOCK]);
        self.bytes.extend_from_slice(&address.to_le_bytes());
    }

    /// Ends the stream: the rest cannot be read.
    pub fn damage(&mut self, damage: Damage) {
        let (number, place) = match damage {
            Damage::Page(page) => (0, u64::from(page)),
            Damage::PageMissing(page) => (1, u64::from(page)),
            Damage::NoTable => (2, 0),
            Damage::NoBusLog => (4, 0),
            Damage::TooManyGroups => (5, 0),
            Damage::Utf16 => (6, 0),
            Damage::Conversion => (7, 0),
            Damage::UnreadBlock => (8, 0),
            Damage::RecordsMissing(count) => (9, u64::from(count)),
            _ => (u8::MAX, 0),
        };
        self.bytes.extend_from_slice(&[DAMAGE, number]);
        self.bytes.extend_from_slice(&place.to_le_bytes());
    }

    /// Notes that the last entry is cut off.
    pub fn cut_off(&mut self) {
        self.bytes.push(CUT_OFF);
    }

    /// Notes that the date of the beginning comes twice.
    pub fn ambiguous_date(&mut self) {
        self.bytes.push(AMBIGUOUS_DATE);
    }

    /// Notes that the date of the beginning is read as one in UTC, as the time zone is not known.
    pub fn unknown_zone(&mut self) {
        self.bytes.push(UNKNOWN_ZONE);
    }

    /// Notes that a file beside the database is not read.
    pub fn unread_changes(&mut self, unread: UnreadChanges) {
        self.bytes.push(match unread {
            UnreadChanges::WriteAheadLog => UNREAD_LOG,
            UnreadChanges::RollbackJournal => UNREAD_JOURNAL,
        });
    }
}

/// Returns the damage of this number; one of the compression for any other.
fn damage_of(number: u8, place: u64) -> Damage {
    let count = u32::try_from(place).unwrap_or(u32::MAX);
    match number {
        0 => Damage::Page(count),
        1 => Damage::PageMissing(count),
        2 => Damage::NoTable,
        BLOCK => Damage::Block,
        4 => Damage::NoBusLog,
        5 => Damage::TooManyGroups,
        6 => Damage::Utf16,
        7 => Damage::Conversion,
        8 => Damage::UnreadBlock,
        9 => Damage::RecordsMissing(count),
        _ => Damage::Compression,
    }
}

/// Names of numbered channels; `None` before the first bytes of the stream.
#[derive(Clone, Debug, Default)]
pub(super) struct EntryStreamState {
    name: Option<fn(u8) -> &'static str>,
}

impl EntryStreamState {
    /// Reads a whole frame.
    fn frame(&self, entry: &[u8]) -> Result<LogEntry<'static>, FieldFault> {
        let (head, data) = entry.split_first_chunk::<FRAME_HEAD>().ok_or(FieldFault::Data)?;
        let [_, own, channel, rest @ ..] = *head;
        let [t0, t1, t2, t3, t4, t5, t6, t7, i0, i1, i2, i3, flags, len, _] = rest;
        let word = u32::from_le_bytes([i0, i1, i2, i3]);
        let flags = Some(flags).filter(|flags| *flags != CLASSIC);
        let frame = decode(word, usize::from(len), flags, data).ok_or(FieldFault::Length)?;
        let mut frame = frame.with_raw_dlc(own >> 4);
        frame.is_tx = own & SENT != 0;
        let frame = if own & CHANGED == 0 { frame } else { frame.as_changed() };
        let time = LogTime::from_micros(u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]));
        let name = self.name.unwrap_or(bus_name);
        Ok(LogEntry { time, interface: name(channel), frame })
    }
}

impl BinaryFormat for EntryStreamState {
    fn read(
        &mut self,
        entry: &mut EntryInput<'_>,
        summary: &mut LogSummary,
    ) -> Result<Option<Frame>, Damage> {
        if self.name.is_none() {
            if entry.fill(ROWS_MAGIC.len()) {
                self.name = Some(bus_name);
                entry.end();
            }
            return Ok(None);
        }
        if !entry.fill(1) {
            return Ok(None);
        }
        let frame = match entry.bytes()[0] {
            FRAME => {
                if !entry.fill(FRAME_HEAD) {
                    return Ok(None);
                }
                let len = usize::from(entry.bytes()[FRAME_HEAD - 1]);
                if !entry.fill(FRAME_HEAD + len) {
                    return Ok(None);
                }
                summary.take(self.frame(entry.bytes()).map(Some))
            }
            FAULT => {
                if !entry.fill(FAULT_LEN) {
                    return Ok(None);
                }
                let fault = FAULTS.get(usize::from(entry.bytes()[1]));
                summary.take(Err(*fault.unwrap_or(&FieldFault::Kind)))
            }
            DAMAGE => {
                if !entry.fill(DAMAGE_LEN) {
                    return Ok(None);
                }
                let [_, number, ref place @ ..] = *entry.bytes() else { return Ok(None) };
                let place = place.first_chunk().map_or(0, |place| u64::from_le_bytes(*place));
                entry.end();
                let damage = damage_of(number, place);
                if damage == Damage::Block {
                    summary.note_damage_at(damage, place);
                }
                return Err(damage);
            }
            UNREAD_LOG => {
                summary.unread_changes = Some(UnreadChanges::WriteAheadLog);
                None
            }
            UNREAD_JOURNAL => {
                summary.unread_changes = Some(UnreadChanges::RollbackJournal);
                None
            }
            AMBIGUOUS_DATE => {
                summary.dates.is_ambiguous = true;
                None
            }
            UNKNOWN_ZONE => {
                summary.dates.is_zone_unknown = true;
                None
            }
            CUT_OFF => {
                summary.ends_inside_entry = true;
                None
            }
            _ => return Err(Damage::Compression),
        };
        entry.end();
        Ok(frame)
    }

    fn read_frame(&mut self, bytes: &[u8], summary: &mut LogSummary) -> Option<(usize, Frame)> {
        let head = bytes.first_chunk::<FRAME_HEAD>().filter(|head| head[0] == FRAME)?;
        let len = FRAME_HEAD + usize::from(head[FRAME_HEAD - 1]);
        let entry = self.frame(bytes.get(..len).filter(|_| self.name.is_some())?).ok()?;
        let name = entry.interface.as_bytes();
        let frame = summary.take_plain(entry.time, name, &entry.frame)?;
        Some((len, frame))
    }
}
