//! ASAM MDF 4 with the frames of a bus, as python-can (asammdf) and CANedge log them.
//!
//! Source: ASAM MDF 4.1 and its bus logging: groups of records with the channels `CAN_DataFrame.*`,
//! `CAN_RemoteFrame.*` and `CAN_ErrorFrame.*`. Groups may have their own data, or share them; data bytes
//! may be in the record, in signal data, or in records of their own. The frames of all groups are put in
//! the order of their times. Signals that are decoded are not read. The memory does not depend on lengths
//! in the file. Does not know moments or bus numbers.

use super::Damage;
use super::bus_errors::{bus_error, captured, no_ack, wrong_crc};
use super::dates::{comes_twice, is_zone_unknown, local_micros, unix_nanos_micros};
use super::entry_stream::EntryWriter;
use super::fields::{FieldFault, can_id, len_of_dlc, with_dlc};
use super::mdf_blocks::{DataChain, MdfBlock, MdfFault, UnpackedBytes, u32_at, u64_at};
use super::random_access::{RandomAccess, RandomFormat, read_full_at};
use crate::frame::socketcan::{BIT_RATE_SWITCH, ERROR_STATE, with_fd_flags};
use crate::frame::{CanId, Frame};
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::io;

/// First bytes of a file, and of one that was not finished.
pub(super) const MAGIC: &[u8] = b"MDF     4";
pub(super) const UNFINISHED_MAGIC: &[u8] = b"UnFinMF 4";
/// Address of the header.
const HEADER: u64 = 64;
/// Most groups of a file, and most channels of a group.
const MAX_GROUPS: usize = 4096;
const MAX_CHANNELS: usize = 1024;
/// Most groups of frames with data of their own.
const MAX_STREAMS: usize = 64;
/// Longest record of frames, and of anything else, and most that wait for their data bytes.
const MAX_FRAME_RECORD: u64 = 1 << 10;
const MAX_RECORD: u64 = 1 << 16;
const MAX_WAITING: usize = 256;
/// Groups that share their data are written in blocks, of a second each by CANedge: so many nanoseconds may a
/// record be later in the file than others.
const MAX_DISORDER: i128 = 3_000_000_000;
/// Most frames that wait for earlier ones, of all groups of a file: two full buses for some seconds.
const MAX_READY: usize = 1 << 16;
/// Flag of an unfinished file: places of data bytes in records of their own are not valid.
const NO_PLACES: u16 = 1 << 6;

/// What is known while the groups of a file are read.
struct GroupReading {
    is_unfinished: bool,
    /// Addresses of groups and channels that were read: none is read twice, so that lists in a loop end.
    blocks: HashSet<u64>,
    unpacked: UnpackedBytes,
}

/// Reads a file.
pub(super) struct MdfLog {
    is_begun: bool,
    streams: Vec<FrameStream>,
    /// The first damage, after which a stream has ended.
    damage: Option<LogDamage>,
    /// The data of an unfinished file end inside a record.
    ends_inside_record: bool,
    /// By how many records groups are shorter than their cycle counts.
    missing: u64,
}

/// Why not all of a file was read.
#[derive(Clone, Copy, Debug)]
enum LogDamage {
    /// The block that begins at this byte is damaged.
    Block(u64),
    /// The file is not one that is read, or not all of it.
    Log(Damage),
}

/// The channels of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FrameChannel {
    Bus,
    Id,
    Extended,
    Dlc,
    Length,
    Data,
    Direction,
    Fd,
    Switch,
    Passive,
    ErrorType,
}

impl FrameChannel {
    const NAMES: [(&'static str, Self); 11] = [
        ("BusChannel", Self::Bus),
        ("ID", Self::Id),
        ("IDE", Self::Extended),
        ("DLC", Self::Dlc),
        ("DataLength", Self::Length),
        ("DataBytes", Self::Data),
        ("Dir", Self::Direction),
        ("EDL", Self::Fd),
        ("BRS", Self::Switch),
        ("ESI", Self::Passive),
        ("ErrorType", Self::ErrorType),
    ];
}

/// What the records of a group are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum GroupKind {
    Data,
    Remote,
    Error,
}

/// A number in a record.
#[derive(Clone, Copy, Debug, Default)]
struct RecordNumber {
    byte: usize,
    bit: u32,
    bits: u32,
    kind: u8,
}

/// Where the data bytes of a record are.
#[derive(Clone, Copy, Debug)]
enum DataPlace {
    None,
    /// In the record, from this byte on.
    Inside(usize),
    /// In signal data, or, with the address of a group, in records of that.
    Outside {
        place: RecordNumber,
        address: u64,
        is_group: bool,
    },
}

/// A number of a record.
#[derive(Clone, Copy, Debug)]
enum ChannelValue {
    InRecord(RecordNumber),
    /// A virtual channel: offset and factor of the number of the record. A factor of 0 makes a constant.
    Virtual(f64, f64),
}

/// A group of records with frames.
#[derive(Debug)]
struct FrameGroup {
    kind: GroupKind,
    /// The time, with its offset and its factor.
    time: Option<(ChannelValue, f64, f64)>,
    channels: [Option<ChannelValue>; FrameChannel::NAMES.len()],
    /// Number of records so far, for virtual channels.
    count: u64,
    data: DataPlace,
    /// The signal data.
    signal_data: Option<DataChain>,
}

/// A group of records that share their data with others.
#[derive(Debug)]
enum RecordGroup {
    Frames {
        len: usize,
        group: Box<FrameGroup>,
        /// Number of records that follow; `None` where the file does not say.
        left: Option<u64>,
    },
    /// Data bytes of the frames of other groups.
    Bytes,
    Other {
        len: usize,
    },
}

/// A frame, its channel and its time in nanoseconds since the start.
type TimedFrame = (i128, Result<(u8, Frame), FieldFault>);

/// Data bytes that are records of their own.
#[derive(Debug, Default)]
struct ByteRecords {
    /// The last ones, each with its place.
    known: VecDeque<(u64, Vec<u8>)>,
    /// Place of the next ones.
    next: u64,
}

/// The frames of groups that share their data.
#[derive(Debug)]
struct FrameStream {
    chain: DataChain,
    id_len: usize,
    groups: HashMap<u64, RecordGroup>,
    /// Addresses of groups, with the numbers of their records.
    numbers: HashMap<u64, u64>,
    /// Records whose data bytes are not read yet, with the number of their group.
    waiting: VecDeque<(u64, Vec<u8>)>,
    /// Data bytes by the number of their group.
    bytes: HashMap<u64, ByteRecords>,
    has_places: bool,
    start_nanos: i128,
    /// Time of the last record.
    last: i128,
    /// Frames by their times, and by their numbers in the file.
    ready: BTreeMap<(i128, u64), Result<(u8, Frame), FieldFault>>,
    /// Number of frames so far.
    pushed: u64,
    /// Time by which a record may be later in the file than others, and most frames that wait for such ones.
    max_disorder: i128,
    max_ready: usize,
    is_over: bool,
    /// The data of an unfinished file end inside a record.
    ends_inside_record: bool,
    /// By how many records its groups are shorter than their cycle counts, once it is over.
    missing: u64,
}

impl MdfLog {
    pub fn new() -> Self {
        Self {
            is_begun: false,
            streams: Vec::new(),
            damage: None,
            ends_inside_record: false,
            missing: 0,
        }
    }

    /// Reads the groups of the file.
    fn begin(&mut self, bytes: &dyn RandomAccess, out: &mut EntryWriter) -> Result<(), MdfFault> {
        let mut head = [0; HEADER as usize];
        if read_full_at(bytes, &mut head, 0)? < head.len() {
            return Err(MdfFault::Block(0));
        }
        let is_unfinished = head.starts_with(UNFINISHED_MAGIC);
        let flags = u16::from_le_bytes([head[60], head[61]]);
        let header = MdfBlock::of_kind(bytes, HEADER, *b"HD")?;
        let (start_nanos, is_local) = start_of(bytes, &header)?;
        let micros = unix_nanos_micros(start_nanos).filter(|_| is_local);
        if micros.is_some_and(comes_twice) {
            out.ambiguous_date();
        }
        if is_local && is_zone_unknown() {
            out.unknown_zone();
        }
        let mut next = header.link(0);
        let mut reading = GroupReading {
            is_unfinished,
            blocks: HashSet::new(),
            unpacked: UnpackedBytes::default(),
        };
        for _ in 0..MAX_GROUPS {
            if next == 0 {
                break;
            }
            let group = structure_block(bytes, next, *b"DG", &mut reading)?;
            next = group.link(0);
            let stream = match FrameStream::read(bytes, &group, &mut reading) {
                // The groups behind it are read.
                Err(fault @ MdfFault::Block(_)) => {
                    note_damage(&mut self.damage, fault)?;
                    None
                }
                stream => stream?,
            };
            if let Some(stream) = stream {
                if self.streams.len() == MAX_STREAMS {
                    return Err(MdfFault::Log(Damage::TooManyGroups));
                }
                let has_places = !is_unfinished || flags & NO_PLACES == 0;
                self.streams.push(FrameStream { has_places, start_nanos, ..stream });
            }
        }
        if next != 0 {
            return Err(MdfFault::Log(Damage::TooManyGroups));
        }
        let has_none = self.streams.is_empty() && self.damage.is_none();
        if has_none { Err(MdfFault::Log(Damage::NoBusLog)) } else { Ok(()) }
    }

    /// Returns the frame that is next by its time; `None` at the end.
    fn next_frame(&mut self, bytes: &dyn RandomAccess) -> Result<Option<TimedFrame>, io::Error> {
        for stream in &mut self.streams {
            if let Err(fault) = stream.fill(bytes) {
                stream.is_over = true;
                note_damage(&mut self.damage, fault)?;
            }
            self.missing = self.missing.saturating_add(std::mem::take(&mut stream.missing));
        }
        self.ends_inside_record |= self.streams.iter().any(|stream| stream.ends_inside_record);
        self.streams.retain(|stream| !stream.ready.is_empty() || !stream.is_over);
        let next = |stream: &&mut FrameStream| stream.next_time().unwrap_or(i128::MAX);
        let first = self.streams.iter_mut().min_by_key(next);
        let first = first.and_then(|stream| stream.ready.pop_first());
        Ok(first.map(|((nanos, _), frame)| (nanos, frame)))
    }
}

impl RandomFormat for MdfLog {
    fn read_on(&mut self, bytes: &dyn RandomAccess, out: &mut EntryWriter) -> io::Result<bool> {
        /// Bytes of entries that are given at once.
        const PART: usize = 1 << 14;
        if !std::mem::replace(&mut self.is_begun, true) {
            if let Err(fault) = self.begin(bytes, out) {
                // The groups before it are read.
                note_damage(&mut self.damage, fault)?;
            }
            let max_ready = MAX_READY / self.streams.len().max(1);
            self.streams.iter_mut().for_each(|stream| stream.max_ready = max_ready);
        }
        while out.bytes().len() < PART {
            let Some((nanos, frame)) = self.next_frame(bytes)? else {
                if self.ends_inside_record {
                    out.cut_off();
                }
                match self.damage {
                    Some(LogDamage::Block(address)) => out.damaged_block(address),
                    Some(LogDamage::Log(damage)) => out.damage(damage),
                    None if self.missing > 0 => out.damage(Damage::RecordsMissing(
                        u32::try_from(self.missing).unwrap_or(u32::MAX),
                    )),
                    None => {}
                }
                return Ok(false);
            };
            let micros = unix_nanos_micros(nanos).ok_or(FieldFault::TimeRange);
            match frame.and_then(|frame| Ok((micros?, frame))) {
                Ok((micros, (channel, frame))) => out.frame(micros, channel, &frame),
                Err(fault) => out.fault(fault),
            }
        }
        Ok(true)
    }
}

/// Notes why not all is read; the first reason stays.
fn note_damage(damage: &mut Option<LogDamage>, fault: MdfFault) -> io::Result<()> {
    damage.get_or_insert(match fault {
        MdfFault::File(error) => return Err(error),
        MdfFault::Block(address) => LogDamage::Block(address),
        MdfFault::Log(damage) => LogDamage::Log(damage),
    });
    Ok(())
}

/// Reads a group or a channel.
fn structure_block(
    bytes: &dyn RandomAccess,
    address: u64,
    kind: [u8; 2],
    reading: &mut GroupReading,
) -> Result<MdfBlock, MdfFault> {
    let is_new = reading.blocks.insert(address);
    if is_new { MdfBlock::of_kind(bytes, address, kind) } else { Err(MdfFault::Block(address)) }
}

/// Returns the start of the measurement, in nanoseconds since 1970, and whether it is given as a local time.
fn start_of(bytes: &dyn RandomAccess, header: &MdfBlock) -> Result<(i128, bool), MdfFault> {
    const LOCAL: u8 = 1;
    let data: [u8; 13] = header.data(bytes)?;
    let nanos = u64_at(&data, 0);
    if data[12] & LOCAL == 0 {
        return Ok((i128::from(nanos), false));
    }
    // A clock that was not set stands at 1970, which may be before 1970 in UTC.
    let micros = local_micros(nanos / 1000).unwrap_or(nanos / 1000);
    Ok((i128::from(micros) * 1000 + i128::from(nanos % 1000), true))
}

impl FrameStream {
    /// Reads the groups of records that share their data; `None` without frames.
    fn read(
        bytes: &dyn RandomAccess,
        group: &MdfBlock,
        reading: &mut GroupReading,
    ) -> Result<Option<Self>, MdfFault> {
        let [id_len] = group.data(bytes)?;
        if !matches!(id_len, 0 | 1 | 2 | 4 | 8) {
            return Err(group.damage());
        }
        let (mut groups, mut numbers) = (HashMap::new(), HashMap::new());
        let mut next = group.link(1);
        for _ in 0..MAX_GROUPS {
            if next == 0 {
                break;
            }
            let records = structure_block(bytes, next, *b"CG", reading)?;
            let number = records.data::<8>(bytes).map(|number| u64_at(&number, 0))?;
            let number = if id_len == 0 { 0 } else { number };
            numbers.insert(next, number);
            groups.insert(number, RecordGroup::read(bytes, &records, reading)?);
            next = records.link(0);
        }
        let frames = groups.values().filter(|it| matches!(it, RecordGroup::Frames { .. })).count();
        // Each group is in the order of its times.
        let max_disorder = if frames > 1 { MAX_DISORDER } else { 0 };
        Ok((frames > 0).then(|| Self {
            chain: DataChain::new(group.link(2), reading.is_unfinished, &reading.unpacked),
            id_len: usize::from(id_len),
            groups,
            numbers,
            waiting: VecDeque::new(),
            bytes: HashMap::new(),
            has_places: true,
            start_nanos: 0,
            last: 0,
            ready: BTreeMap::new(),
            pushed: 0,
            max_disorder,
            max_ready: MAX_READY,
            is_over: false,
            ends_inside_record: false,
            missing: 0,
        }))
    }

    /// Time of the frame that is next; `None` as long as one before it may follow.
    fn next_time(&self) -> Option<i128> {
        let ((nanos, _), _) = self.ready.first_key_value()?;
        let is_complete = self.is_over
            || self.ready.len() >= self.max_ready
            || nanos.saturating_add(self.max_disorder) <= self.last;
        is_complete.then_some(*nanos)
    }

    /// Returns true if all frames were read: each group has as many records as its cycle count. What is behind
    /// them may be room that a logger has reserved.
    fn is_complete(&self) -> bool {
        let is_complete = |group: &RecordGroup| match group {
            RecordGroup::Frames { left, .. } => *left == Some(0),
            RecordGroup::Bytes | RecordGroup::Other { .. } => true,
        };
        self.waiting.is_empty() && self.groups.values().all(is_complete)
    }

    /// Reads until the next frame is known, or to the end.
    fn fill(&mut self, bytes: &dyn RandomAccess) -> Result<(), MdfFault> {
        while self.next_time().is_none() && !self.is_over {
            if self.is_complete() || !self.read_record(bytes)? {
                self.is_over = true;
                let left = self.groups.values().filter_map(RecordGroup::left);
                self.missing = left.fold(0, u64::saturating_add);
                while let Some((number, record)) = self.waiting.pop_front() {
                    self.push(number, &record, Err(FieldFault::Data));
                }
            }
        }
        Ok(())
    }

    /// Reads a record; returns false at the end.
    fn read_record(&mut self, bytes: &dyn RandomAccess) -> Result<bool, MdfFault> {
        let Some(id) = self.chain.take(bytes, self.id_len)? else {
            self.ends_inside_record = self.chain.has_rest();
            return Ok(false);
        };
        let mut number = [0; 8];
        number[..id.len()].copy_from_slice(id);
        let number = u64::from_le_bytes(number);
        let damage = self.chain.damage();
        let len = match self.groups.get(&number).ok_or(damage)? {
            RecordGroup::Frames { len, .. } | RecordGroup::Other { len } => *len,
            RecordGroup::Bytes => {
                let Some(len) = self.chain.take(bytes, 4)? else {
                    self.ends_inside_record = true;
                    return Ok(false);
                };
                u32_at(len, 0) as usize
            }
        };
        if len as u64 > MAX_RECORD || len + self.id_len == 0 {
            return Err(self.chain.damage());
        }
        let Some(mut record) = self.chain.take(bytes, len)?.map(<[u8]>::to_vec) else {
            self.ends_inside_record = self.id_len > 0 || self.chain.has_rest();
            return Ok(false);
        };
        match self.groups.get_mut(&number) {
            Some(RecordGroup::Frames { left: Some(0), .. } | RecordGroup::Other { .. }) | None => {}
            Some(RecordGroup::Frames { group, left, .. }) => {
                *left = left.map(|left| left - 1);
                if let Some(data) = group.data_bytes(bytes, &record)? {
                    self.push(number, &record, data);
                } else {
                    self.waiting.push_back((number, record));
                    self.push_complete();
                }
            }
            Some(RecordGroup::Bytes) => {
                let records = self.bytes.entry(number).or_default();
                let place = records.next;
                records.next += 4 + record.len() as u64;
                record.truncate(Frame::MAX_DATA);
                record.shrink_to_fit();
                records.known.push_back((place, record));
                if records.known.len() > MAX_WAITING {
                    records.known.pop_front();
                }
                self.push_complete();
            }
        }
        Ok(true)
    }

    /// Gives the frames that wait, up to the first one whose data bytes are not read yet.
    fn push_complete(&mut self) {
        while let Some((number, record)) = self.waiting.front() {
            let number = *number;
            let Some(RecordGroup::Frames { group, .. }) = self.groups.get(&number) else { return };
            let DataPlace::Outside { place, address, .. } = group.data else { return };
            let known = self.numbers.get(&address).and_then(|of| self.bytes.get_mut(of));
            let data = known.and_then(|ByteRecords { known, .. }| {
                let place = place.unsigned(record);
                let at = known.iter().position(|(at, _)| !self.has_places || Some(*at) == place)?;
                known.remove(at)
            });
            let data = match data {
                Some((_, data)) => Ok(data),
                None if self.waiting.len() > MAX_WAITING => Err(FieldFault::Data),
                None => return,
            };
            if let Some((number, record)) = self.waiting.pop_front() {
                self.push(number, &record, data);
            }
        }
    }

    fn push(&mut self, number: u64, record: &[u8], data: Result<Vec<u8>, FieldFault>) {
        let Some(RecordGroup::Frames { group, .. }) = self.groups.get_mut(&number) else { return };
        let nanos = group.nanos(record).map(|nanos| self.start_nanos.saturating_add(nanos));
        let frame = data.and_then(|data| group.frame(record, &data));
        let frame = nanos.ok_or(FieldFault::Date).and(frame);
        group.count += 1;
        self.last = nanos.unwrap_or(self.last);
        self.pushed += 1;
        self.ready.insert((self.last, self.pushed), frame);
    }
}

impl RecordGroup {
    /// Number of records with frames that follow, where the file says it.
    fn left(&self) -> Option<u64> {
        match self {
            Self::Frames { left, .. } => *left,
            Self::Bytes | Self::Other { .. } => None,
        }
    }

    fn read(
        bytes: &dyn RandomAccess,
        records: &MdfBlock,
        reading: &mut GroupReading,
    ) -> Result<Self, MdfFault> {
        const OF_BYTES: u8 = 1;
        let data: [u8; 32] = records.data(bytes)?;
        if data[16] & OF_BYTES != 0 {
            return Ok(Self::Bytes);
        }
        let len = u64::from(u32_at(&data, 24)) + u64::from(u32_at(&data, 28));
        if len > MAX_RECORD {
            return Err(records.damage());
        }
        let len = len as usize;
        let group = FrameGroup::read(bytes, records.link(1), reading)?;
        Ok(match group {
            Some(_) if len as u64 > MAX_FRAME_RECORD => return Err(records.damage()),
            Some(group) => {
                // Loggers that were interrupted have not written it.
                let count = u64_at(&data, 8);
                let left = (count > 0 && !reading.is_unfinished).then_some(count);
                Self::Frames { len, group: Box::new(group), left }
            }
            None => Self::Other { len },
        })
    }
}

impl FrameGroup {
    /// Reads the channels of a group; `None` if they are not those of frames.
    fn read(
        bytes: &dyn RandomAccess,
        first: u64,
        reading: &mut GroupReading,
    ) -> Result<Option<Self>, MdfFault> {
        /// Types of channels.
        const VARIABLE: u8 = 1;
        const MASTER: u8 = 2;
        const VIRTUAL_MASTER: u8 = 3;
        const VIRTUAL: u8 = 6;
        let mut group = Self {
            kind: GroupKind::Data,
            time: None,
            channels: [None; FrameChannel::NAMES.len()],
            count: 0,
            data: DataPlace::None,
            signal_data: None,
        };
        let (mut next, mut is_of_frames) = (vec![first], false);
        let mut time_fault = None;
        for _ in 0..MAX_CHANNELS {
            let Some(address) = next.pop() else { break };
            if address == 0 {
                continue;
            }
            let channel = structure_block(bytes, address, *b"CN", reading)?;
            next.push(channel.link(0));
            let data: [u8; 12] = channel.data(bytes)?;
            let (kind, number) = (data[0], RecordNumber::of_channel(&data));
            if matches!(kind, MASTER | VIRTUAL_MASTER) {
                let (offset, factor) = match linear(bytes, channel.link(4)) {
                    Ok(conversion) => conversion,
                    Err(fault @ MdfFault::File(_)) => return Err(fault),
                    Err(fault) => {
                        time_fault = Some(fault);
                        continue;
                    }
                };
                let value = match kind {
                    MASTER => ChannelValue::InRecord(number),
                    _ => ChannelValue::Virtual(0.0, 1.0),
                };
                group.time = Some((value, offset, factor));
                continue;
            }
            let name = text(bytes, channel.link(2))?;
            let (of, part) = name.split_once('.').unwrap_or((&name, ""));
            let of = match of {
                "CAN_DataFrame" => GroupKind::Data,
                "CAN_RemoteFrame" => GroupKind::Remote,
                "CAN_ErrorFrame" => GroupKind::Error,
                _ => continue,
            };
            (group.kind, is_of_frames) = (of, true);
            let known = FrameChannel::NAMES.iter().position(|(name, _)| *name == part);
            let Some(at) = known else {
                // The channels are below that of the frame.
                next.push(channel.link(1));
                continue;
            };
            group.channels[at] = match kind {
                VIRTUAL => match linear(bytes, channel.link(4)) {
                    Ok((offset, factor)) => Some(ChannelValue::Virtual(offset, factor)),
                    // Of other conversions the number is not known.
                    Err(MdfFault::Block(_) | MdfFault::Log(_)) => None,
                    Err(fault @ MdfFault::File(_)) => return Err(fault),
                },
                _ => Some(ChannelValue::InRecord(number)),
            };
            if FrameChannel::NAMES[at].1 == FrameChannel::Data {
                let address = channel.link(5);
                group.data = if kind == VARIABLE && address == 0 {
                    DataPlace::None
                } else if kind == VARIABLE {
                    let block = MdfBlock::read(bytes, address)?;
                    let is_group = block.kind == *b"CG";
                    group.signal_data =
                        Some(DataChain::new(address, reading.is_unfinished, &reading.unpacked));
                    DataPlace::Outside { place: number, address, is_group }
                } else {
                    DataPlace::Inside(number.byte)
                };
            }
        }
        // Of signals that are decoded no time is read.
        match time_fault.filter(|_| is_of_frames) {
            Some(fault) => Err(fault),
            None => Ok(is_of_frames.then_some(group)),
        }
    }

    /// Returns the data bytes of a record and what follows them there; `None` if they are in another record.
    fn data_bytes(
        &mut self,
        bytes: &dyn RandomAccess,
        record: &[u8],
    ) -> Result<Option<Result<Vec<u8>, FieldFault>>, MdfFault> {
        let (place, is_group) = match self.data {
            DataPlace::None => return Ok(Some(Ok(Vec::new()))),
            DataPlace::Inside(at) => {
                let data = record.get(at..).ok_or(FieldFault::Data);
                return Ok(Some(data.map(<[u8]>::to_vec)));
            }
            DataPlace::Outside { place, is_group, .. } => (place, is_group),
        };
        let Some(chain) = self.signal_data.as_mut().filter(|_| !is_group) else { return Ok(None) };
        let Some(place) = place.unsigned(record) else { return Ok(Some(Err(FieldFault::Data))) };
        if !chain.skip_to(bytes, place)? {
            return Ok(Some(Err(FieldFault::Data)));
        }
        let Some(len) = chain.take(bytes, 4)?.map(|len| u32_at(len, 0)) else {
            return Ok(Some(Err(FieldFault::Data)));
        };
        if len as usize > Frame::MAX_DATA {
            return Ok(Some(Err(FieldFault::Length)));
        }
        let data = chain.take(bytes, len as usize)?;
        Ok(Some(data.map(<[u8]>::to_vec).ok_or(FieldFault::Data)))
    }

    /// Returns the number that a virtual channel has in the next record.
    fn virtual_number(&self, offset: f64, factor: f64) -> f64 {
        offset + factor * self.count as f64
    }

    /// Returns the time of a record, in nanoseconds since the start.
    fn nanos(&self, record: &[u8]) -> Option<i128> {
        let (value, offset, factor) = self.time?;
        let number = match value {
            ChannelValue::InRecord(number) => number.float(record)?,
            ChannelValue::Virtual(offset, factor) => self.virtual_number(offset, factor),
        };
        let seconds = offset + factor * number;
        let nanos = (seconds * 1e9).round();
        (nanos.abs() < 1e27).then_some(nanos as i128)
    }

    fn value(&self, record: &[u8], channel: FrameChannel) -> Option<u64> {
        match self.channels[channel as usize]? {
            ChannelValue::InRecord(number) => number.unsigned(record),
            ChannelValue::Virtual(offset, factor) => {
                let value = self.virtual_number(offset, factor);
                // Above that a number has no place in a frame.
                (0.0..=f64::from(u32::MAX)).contains(&value).then_some(value as u64)
            }
        }
    }

    /// Returns the frame of a record, and its channel.
    fn frame(&self, record: &[u8], data: &[u8]) -> Result<(u8, Frame), FieldFault> {
        use FrameChannel as C;
        /// Bit of an identifier of 29 bits, where there is no channel for it.
        const EXTENDED: u64 = 0x8000_0000;
        let value = |channel| self.value(record, channel);
        let flag = |channel| value(channel).is_some_and(|value| value != 0);
        let bus = value(C::Bus).unwrap_or(0);
        let bus = u8::try_from(bus).map_err(|_| FieldFault::Channel)?;
        let is_tx = flag(C::Direction);
        let with_direction = |frame: Frame| if is_tx { frame.with_tx() } else { frame };
        if self.kind == GroupKind::Error {
            let frame = error_frame(value(C::ErrorType));
            // The identifier of the frame with the error, and more.
            let has_more = value(C::Id).is_some_and(|id| id != 0) || data.iter().any(|it| *it != 0);
            let frame = if has_more { frame.as_changed() } else { frame };
            return Ok((bus, with_direction(frame)));
        }
        let word = value(C::Id).ok_or(FieldFault::Id)?;
        let is_extended = value(C::Extended).map_or(word & EXTENDED != 0, |flag| flag != 0);
        let number = u32::try_from(word & !EXTENDED).ok();
        let id: CanId = can_id(number, is_extended)?;
        let is_fd = flag(C::Fd);
        let dlc = value(C::Dlc).map(|dlc| u32::try_from(dlc).unwrap_or(16));
        let of_dlc = dlc.map(|dlc| len_of_dlc(dlc, is_fd));
        let with_dlc = |frame: Frame| with_dlc(frame, dlc.unwrap_or(0));
        if self.kind == GroupKind::Remote {
            let len = of_dlc.unwrap_or(Ok(0))?.min(Frame::MAX_CLASSIC_DATA);
            return Ok((bus, with_direction(with_dlc(Frame::remote(id, len)))));
        }
        let len = value(C::Length).map(|len| usize::try_from(len).unwrap_or(usize::MAX));
        let len = len.map_or_else(|| of_dlc.unwrap_or(Ok(data.len())), Ok)?;
        let most = if is_fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
        if len > most {
            return Err(FieldFault::Length);
        }
        let data = data.get(..len).ok_or(FieldFault::Data)?;
        let bit = |channel, bit| if flag(channel) { bit } else { 0 };
        let flags = bit(C::Switch, BIT_RATE_SWITCH) | bit(C::Passive, ERROR_STATE);
        let frame = if is_fd { with_fd_flags(id, data, flags) } else { Frame::new(id, data) };
        Ok((bus, with_direction(with_dlc(frame))))
    }
}

/// Returns an error frame of a type of bus logging: bit, form or stuff error, CRC error, no ACK, or any other.
fn error_frame(kind: Option<u64>) -> Frame {
    const RECEPTION: u8 = 0x20;
    match kind {
        Some(kind @ 1..=3) => captured((kind as u8 - 1) << 6 | RECEPTION),
        Some(4) => wrong_crc(),
        Some(5) => no_ack(),
        _ => bus_error(),
    }
}

/// Returns offset and factor of a conversion; 0 and 1 without one.
fn linear(bytes: &dyn RandomAccess, address: u64) -> Result<(f64, f64), MdfFault> {
    const LINEAR: u8 = 1;
    if address == 0 {
        return Ok((0.0, 1.0));
    }
    let conversion = MdfBlock::of_kind(bytes, address, *b"CC")?;
    let [kind] = conversion.data(bytes)?;
    match kind {
        0 => Ok((0.0, 1.0)),
        LINEAR => {
            let data: [u8; 40] = conversion.data(bytes)?;
            let value = |at| f64::from_bits(u64_at(&data, at));
            Ok((value(24), value(32)))
        }
        _ => Err(MdfFault::Log(Damage::Conversion)),
    }
}

/// Returns the beginning of a text.
fn text(bytes: &dyn RandomAccess, address: u64) -> Result<String, MdfFault> {
    const LONGEST: u64 = 256;
    if address == 0 {
        return Ok(String::new());
    }
    let block = MdfBlock::of_kind(bytes, address, *b"TX")?;
    let mut text = vec![0; block.data_len.min(LONGEST) as usize];
    let count = read_full_at(bytes, &mut text, block.data_at)?;
    text.truncate(count);
    let end = text.iter().position(|byte| *byte == 0).unwrap_or(text.len());
    Ok(String::from_utf8_lossy(&text[..end]).into_owned())
}

impl RecordNumber {
    /// Reads the place of a channel.
    fn of_channel(data: &[u8; 12]) -> Self {
        let (byte, bits) = (u32_at(data, 4) as usize, u32_at(data, 8));
        Self { byte, bit: u32::from(data[3]), bits, kind: data[2] }
    }

    /// Returns the bits in a record; `None` outside it.
    fn unsigned(self, record: &[u8]) -> Option<u64> {
        const BIG_ENDIAN: [u8; 3] = [1, 3, 5];
        if !(1..=64).contains(&self.bits) || self.bit > 7 {
            return None;
        }
        let len = (self.bit + self.bits).div_ceil(8) as usize;
        let bytes = record.get(self.byte..self.byte.checked_add(len)?)?;
        let add = |number: u128, byte: &u8| number << 8 | u128::from(*byte);
        let number = if BIG_ENDIAN.contains(&self.kind) {
            bytes.iter().fold(0, add)
        } else {
            bytes.iter().rev().fold(0, add)
        };
        Some((number >> self.bit) as u64 & u64::MAX >> (64 - self.bits))
    }

    /// Returns the number in a record; `None` outside it.
    fn float(self, record: &[u8]) -> Option<f64> {
        let raw = self.unsigned(record)?;
        match (self.kind, self.bits) {
            (0 | 1, _) => Some(raw as f64),
            (2 | 3, bits) => Some(((raw << (64 - bits)).cast_signed() >> (64 - bits)) as f64),
            (4 | 5, 32) => Some(f64::from(f32::from_bits(raw as u32))),
            (4 | 5, 64) => Some(f64::from_bits(raw)),
            _ => None,
        }
    }
}
