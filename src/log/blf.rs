//! BLF, the binary log of Vector's tools, with its containers opened: reads it, and writes it.
//!
//! Source: the logs that CANalyzer and python-can write. [`super::unpack`] opens the containers; what
//! is read here is the head of the file and the objects, one after the other. The start of the
//! measurement is in UTC. Files may stand behind one another. Other objects than CAN frames are passed
//! over. Allocation does not depend on lengths in the file. Does not know moments or bus numbers.

use super::asc::is_whole_error;
use super::binary::{BinaryFormat, EntryInput};
use super::bus_errors::{bus_error, capture_of, of_vector, overload};
use super::channel::{ChannelNumbers, channel_name};
use super::controller::ControllerReport;
use super::dates::{LAST_START, system_time, system_time_of};
use super::fields::{FieldFault, can_id, data_frame, len_of_dlc};
use super::{Damage, LogEncoder, LogEntry, LogLoss, LogSummary, LogTime};
use crate::frame::socketcan::{BIT_RATE_SWITCH, ERROR_STATE};
use crate::frame::{CanId, Frame, FrameKind};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::{self, Write};

/// First bytes of a file, and of an object.
pub(super) const MAGIC: &[u8; 4] = b"LOGG";
pub(super) const OBJECT: &[u8; 4] = b"LOBJ";
/// Bytes of an object that are needed to find its length and its type.
pub(super) const OBJECT_HEAD: usize = 16;
/// Longest object that is read, in bytes; longer ones are skipped.
const MAX_OBJECT: usize = 1 << 12;
/// Bytes of the head of a file as it is written, and the least that is read.
pub(super) const FILE_HEAD: usize = 144;
const LEAST_FILE_HEAD: usize = 72;
/// Most bytes of padding before an object.
pub(super) const MAX_PADDING: usize = 4;
/// Types of objects.
const MESSAGE: u32 = 1;
const ERROR: u32 = 2;
const OVERLOAD: u32 = 3;
pub(super) const CONTAINER: u32 = 10;
const DRIVER_ERROR: u32 = 31;
const ERROR_EXT: u32 = 73;
const MESSAGE_2: u32 = 86;
const FD_MESSAGE: u32 = 100;
const FD_MESSAGE_64: u32 = 101;
const FD_ERROR_64: u32 = 104;
/// Flag of an object: its time is in units of 10 µs, not of nanoseconds.
const TEN_MICROS: u32 = 1;
const NANOS: u32 = 2;
/// Flags of a message.
const SENT: u8 = 0x01;
const REMOTE: u8 = 0x80;
/// Bit of an identifier of 29 bits.
const EXTENDED: u32 = 0x8000_0000;
/// FD flags of [`FD_MESSAGE`]: FDF, BRS, ESI.
const FD: [u8; 3] = [0x01, 0x02, 0x04];
/// Flags of [`FD_MESSAGE_64`]: remote, FDF, BRS, ESI.
const FD_64: [u32; 4] = [0x0010, 0x1000, 0x2000, 0x4000];
/// Bytes of objects in a container.
const CONTAINER_SIZE: usize = 128 << 10;

/// State that objects depend on.
#[derive(Clone, Debug, Default)]
pub(super) struct MeasurementState {
    /// Start of the measurement, in microseconds since 1970; `None` before the head is read.
    start: Option<u64>,
}

/// Reads little-endian fields.
struct ObjectFields<'b>(&'b [u8]);

impl<'b> ObjectFields<'b> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], FieldFault> {
        let (bytes, rest) = self.0.split_first_chunk().ok_or(FieldFault::Column)?;
        self.0 = rest;
        Ok(*bytes)
    }

    fn u8(&mut self) -> Result<u8, FieldFault> {
        self.take().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Result<u16, FieldFault> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, FieldFault> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, FieldFault> {
        self.take().map(u64::from_le_bytes)
    }

    fn skip(&mut self, len: usize) -> Result<(), FieldFault> {
        self.0 = self.0.get(len..).ok_or(FieldFault::Column)?;
        Ok(())
    }

    /// Returns `len` bytes of a field of `size` bytes.
    fn data(&mut self, len: usize, size: usize) -> Result<&'b [u8], FieldFault> {
        let data = self.0.get(..len).filter(|_| len <= size).ok_or(FieldFault::Data)?;
        self.0 = self.0.get(size..).unwrap_or_default();
        Ok(data)
    }
}

/// Returns the length of the object that begins with these bytes, without its padding, and its type;
/// `None` if the mark of an object is missing.
pub(super) fn object_size(head: &[u8; OBJECT_HEAD]) -> Option<(u32, u32)> {
    let mut fields = ObjectFields(head.strip_prefix(OBJECT)?);
    let (_head_len, _version) = (fields.u16().ok()?, fields.u16().ok()?);
    let (size, kind) = (fields.u32().ok()?, fields.u32().ok()?);
    (size as usize >= OBJECT_HEAD).then_some((size, kind))
}

/// Returns the bytes before an object, or the head of a file behind another: padding, which some objects
/// have and others lack.
fn padding(bytes: &[u8]) -> usize {
    let begins = |at: &usize| {
        let rest = &bytes[*at.min(&bytes.len())..];
        rest.starts_with(OBJECT) || rest.starts_with(MAGIC)
    };
    (0..=MAX_PADDING).find(begins).unwrap_or(0)
}

/// Returns the length of the head of a file that begins with these eight bytes.
pub(super) fn file_head_len(head: [u8; 8]) -> Option<usize> {
    let len = ObjectFields(head.strip_prefix(MAGIC)?).u32().ok()? as usize;
    (LEAST_FILE_HEAD..=1024).contains(&len).then_some(len)
}

impl MeasurementState {
    /// Reads the head of the file.
    fn read_head(
        &mut self,
        entry: &mut EntryInput<'_>,
        summary: &mut LogSummary,
    ) -> Result<(), Damage> {
        if !entry.fill(8) {
            return Ok(());
        }
        let len = entry.bytes().first_chunk().copied().and_then(file_head_len);
        if !entry.fill(len.ok_or(Damage::Object)?) {
            return Ok(());
        }
        let start = start_of(entry.bytes());
        // Some writers give no date.
        let is_given = entry.bytes()[40..56].iter().any(|&byte| byte != 0);
        if start.is_none() && is_given {
            summary.take(Err::<Option<LogEntry<'_>>, _>(FieldFault::StartDate));
        }
        self.start = Some(start.unwrap_or(0));
        entry.end();
        Ok(())
    }
}

impl BinaryFormat for MeasurementState {
    fn read(
        &mut self,
        entry: &mut EntryInput<'_>,
        summary: &mut LogSummary,
    ) -> Result<Option<Frame>, Damage> {
        let Some(start) = self.start else { return self.read_head(entry, summary).map(|()| None) };
        if !entry.fill(OBJECT_HEAD) {
            return Ok(None);
        }
        let padding = padding(entry.bytes());
        if padding > 0 {
            entry.discard(padding);
            return Ok(None);
        }
        if entry.bytes().starts_with(MAGIC) {
            return self.read_head(entry, summary).map(|()| None);
        }
        let size = entry.bytes().first_chunk().and_then(object_size);
        let (len, kind) = size.ok_or(Damage::Object)?;
        if len as usize > MAX_OBJECT || !is_frame(kind) {
            entry.skip(u64::from(len));
            summary.entries += 1;
            return Ok(None);
        }
        if !entry.fill(len as usize) {
            return Ok(None);
        }
        let frame = summary.take(read_object(start, entry.bytes()));
        entry.end();
        Ok(frame)
    }

    fn read_frame(&mut self, bytes: &[u8], summary: &mut LogSummary) -> Option<(usize, Frame)> {
        let padding = padding(bytes);
        let rest = &bytes[padding..];
        let (len, kind) = rest.first_chunk().and_then(object_size)?;
        let is_read = is_frame(kind) && len as usize <= MAX_OBJECT;
        let object = rest.get(..len as usize).filter(|_| is_read)?;
        let entry = read_object(self.start?, object).ok()??;
        let name = entry.interface.as_bytes();
        let frame = summary.take_plain(entry.time, name, &entry.frame)?;
        Some((padding + object.len(), frame))
    }
}

fn is_frame(kind: u32) -> bool {
    matches!(
        kind,
        MESSAGE
            | ERROR
            | OVERLOAD
            | DRIVER_ERROR
            | ERROR_EXT
            | MESSAGE_2
            | FD_MESSAGE
            | FD_MESSAGE_64
            | FD_ERROR_64
    )
}

/// Returns the start of the measurement, in microseconds since 1970.
fn start_of(head: &[u8]) -> Option<u64> {
    let mut fields = ObjectFields(head.get(40..)?);
    let mut next = || fields.u16().ok();
    let (year, month, _weekday, day) = (next()?, next()?, next()?, next()?);
    let (hour, minute, second, millis) = (next()?, next()?, next()?, next()?);
    system_time([year, month, day, hour, minute, second, millis])
}

/// Reads an object of a type with a frame; `None` for one that is not about a frame.
fn read_object(start: u64, object: &[u8]) -> Result<Option<LogEntry<'static>>, FieldFault> {
    let mut fields = ObjectFields(object);
    fields.skip(4)?;
    let (head_len, version) = (fields.u16()?, fields.u16()?);
    let (size, kind) = (fields.u32()? as usize, fields.u32()?);
    let flags = fields.u32()?;
    fields.skip(4)?;
    let time = fields.u64()?;
    if !matches!(version, 1 | 2) {
        return Err(FieldFault::Kind);
    }
    let since_start = if flags == TEN_MICROS {
        time.checked_mul(10).map(LogTime::from_micros)
    } else {
        Some(LogTime::from_nanos(time))
    };
    let time = since_start.and_then(|time| LogTime::from_micros(start).checked_add(time));
    let time = time.ok_or(FieldFault::TimeRange)?;
    let body = object.get(usize::from(head_len)..size).ok_or(FieldFault::Column)?;
    if is_transmit_request(kind, body) {
        return Err(FieldFault::TransmitRequest);
    }
    let (channel, frame) = match kind {
        MESSAGE | MESSAGE_2 => message(ObjectFields(body))?,
        ERROR => (ObjectFields(body).u16()?, bus_error()),
        OVERLOAD => (ObjectFields(body).u16()?, overload()),
        DRIVER_ERROR => match driver_error(ObjectFields(body))? {
            Some(error) => error,
            None => return Ok(None),
        },
        ERROR_EXT => error_ext(ObjectFields(body))?,
        FD_MESSAGE => fd_message(ObjectFields(body))?,
        FD_MESSAGE_64 => fd_message_64(ObjectFields(body), size - usize::from(head_len))?,
        // FD_ERROR_64
        _ => fd_error_64(ObjectFields(body))?,
    };
    let channel = u8::try_from(channel).map_err(|_| FieldFault::Channel)?;
    Ok(Some(LogEntry { time, interface: channel_name(channel), frame }))
}

/// Returns true for the request of a program to send a frame, which is another object when it is sent.
fn is_transmit_request(kind: u32, body: &[u8]) -> bool {
    /// Bits of the direction in the flags of a frame, and its value for a request.
    const DIRECTION: u8 = 0x0F;
    const REQUEST: u8 = 2;
    let (at, bits) = match kind {
        MESSAGE | MESSAGE_2 | FD_MESSAGE => (2, DIRECTION),
        FD_MESSAGE_64 => (34, u8::MAX),
        _ => return false,
    };
    body.get(at).is_some_and(|byte| byte & bits == REQUEST)
}

fn id(word: u32) -> Result<CanId, FieldFault> {
    can_id(Some(word & !EXTENDED), word & EXTENDED != 0)
}

fn message(mut fields: ObjectFields<'_>) -> Result<(u16, Frame), FieldFault> {
    let (channel, flags, dlc, word) = (fields.u16()?, fields.u8()?, fields.u8()?, fields.u32()?);
    let len = len_of_dlc(u32::from(dlc), false)?;
    let id = id(word)?;
    let mut frame = if flags & REMOTE != 0 {
        Frame::remote(id, len)
    } else {
        data_frame(id, fields.data(len, Frame::MAX_CLASSIC_DATA)?, None)?
    };
    frame = frame.with_raw_dlc(dlc);
    frame.is_tx = flags & SENT != 0;
    Ok((channel, frame))
}

/// Reads the error counters of a controller; `None` if both are 0. Its error code is one of the driver.
fn driver_error(mut fields: ObjectFields<'_>) -> Result<Option<(u16, Frame)>, FieldFault> {
    let (channel, sent, received, code) =
        (fields.u16()?, fields.u8()?, fields.u8()?, fields.u32()?);
    let counters = Some([sent, received]).filter(|it| *it != [0, 0]);
    let frame = ControllerReport { state: None, counters }.frame();
    Ok(frame.map(|frame| (channel, if code == 0 { frame } else { frame.as_changed() })))
}

/// Reads an error frame: as SocketCAN has it if its identifier and data are there, otherwise by its codes.
fn error_ext(mut fields: ObjectFields<'_>) -> Result<(u16, Frame), FieldFault> {
    let (channel, _length) = (fields.u16()?, fields.u16()?);
    let (flags, code, _position, dlc) = (fields.u32()?, fields.u8()?, fields.u8()?, fields.u8()?);
    fields.skip(1)?;
    let (_frame_length, word, extended) = (fields.u32()?, fields.u32()?, fields.u16()?);
    fields.skip(2)?;
    let class = word & CanId::MAX_EXTENDED;
    // Without valid fields the identifier is the class; otherwise it is that of the frame with the error.
    let frame = if flags == 0 && class != 0 && dlc as usize <= Frame::MAX_CLASSIC_DATA {
        Frame::error(class, fields.data(usize::from(dlc), Frame::MAX_CLASSIC_DATA)?)
    } else {
        of_vector(flags, code, extended, flags != 0 && word != 0)
    };
    Ok((channel, frame))
}

fn fd_error_64(mut fields: ObjectFields<'_>) -> Result<(u16, Frame), FieldFault> {
    let (channel, _dlc, _valid, code) = (fields.u8()?, fields.u8()?, fields.u8()?, fields.u8()?);
    let (flags, extended) = (fields.u16()?, fields.u16()?);
    // The identifier of the frame with the error, and more.
    let has_more = fields.0.iter().any(|byte| *byte != 0);
    Ok((u16::from(channel), of_vector(u32::from(flags), code, extended, has_more)))
}

fn fd_message(mut fields: ObjectFields<'_>) -> Result<(u16, Frame), FieldFault> {
    let (channel, flags, dlc, word) = (fields.u16()?, fields.u8()?, fields.u8()?, fields.u32()?);
    fields.skip(5)?;
    let (fd, valid) = (fields.u8()?, usize::from(fields.u8()?));
    fields.skip(5)?;
    let [is_fd, switched, passive] = FD.map(|flag| fd & flag != 0);
    let id = id(word)?;
    let len = len_of_dlc(u32::from(dlc), is_fd)?;
    let mut frame = if flags & REMOTE != 0 {
        Frame::remote(id, len)
    } else {
        let data = fields.data(valid.min(len), Frame::MAX_DATA)?;
        padded_frame(id, data, len, is_fd.then_some(fd_flags(switched, passive)))?
    };
    frame = frame.with_raw_dlc(dlc);
    frame.is_tx = flags & SENT != 0;
    Ok((channel, frame))
}

fn fd_message_64(mut fields: ObjectFields<'_>, body: usize) -> Result<(u16, Frame), FieldFault> {
    let (channel, dlc, valid, _count) = (fields.u8()?, fields.u8()?, fields.u8()?, fields.u8()?);
    let (word, _length, flags) = (fields.u32()?, fields.u32()?, fields.u32()?);
    fields.skip(16)?;
    let (_bit_count, direction, extra) = (fields.u16()?, fields.u8()?, usize::from(fields.u8()?));
    fields.skip(4)?;
    let [is_remote, is_fd, switched, passive] = FD_64.map(|flag| flags & flag != 0);
    let id = id(word)?;
    let len = len_of_dlc(u32::from(dlc), is_fd)?;
    let mut frame = if is_remote {
        Frame::remote(id, len)
    } else {
        /// Bytes before the data, and of the head of the object.
        const BEFORE_DATA: usize = 40;
        const HEAD: usize = 32;
        // More may stand behind the data; fewer bytes than said are filled up with zeros.
        let end = if extra > HEAD + BEFORE_DATA { extra - HEAD } else { body };
        let room = end.saturating_sub(BEFORE_DATA).min(fields.0.len());
        let data = fields.data(usize::from(valid).min(len).min(room), Frame::MAX_DATA)?;
        padded_frame(id, data, len, is_fd.then_some(fd_flags(switched, passive)))?
    };
    frame = frame.with_raw_dlc(dlc);
    frame.is_tx = direction != 0;
    Ok((u16::from(channel), frame))
}

fn fd_flags(switched: bool, passive: bool) -> u8 {
    let flag = |is_set, flag| if is_set { flag } else { 0 };
    flag(switched, BIT_RATE_SWITCH) | flag(passive, ERROR_STATE)
}

/// Returns a data frame of `len` bytes, whose last ones are zeros where `data` has fewer: marked as changed then.
fn padded_frame(
    id: CanId,
    data: &[u8],
    len: usize,
    fd_flags: Option<u8>,
) -> Result<Frame, FieldFault> {
    let mut all = [0; Frame::MAX_DATA];
    all.get_mut(..data.len()).ok_or(FieldFault::Data)?.copy_from_slice(data);
    let frame = data_frame(id, &all[..len], fd_flags)?;
    Ok(if data.len() < len { frame.as_changed() } else { frame })
}

/// Writes a BLF log. The head has its final values when [`LogEncoder::head`] replaces it.
#[derive(Debug, Default)]
pub(super) struct BlfEncoder {
    channels: ChannelNumbers,
    /// Date of the first frame, and of the last one, in microseconds since 1970.
    start: Option<u64>,
    last: u64,
    /// Objects that are not in a container yet.
    objects: Vec<u8>,
    count: u32,
    other_times: u64,
    error_details: u64,
    /// Bytes written, and the same without compression.
    written: u64,
    uncompressed: u64,
}

impl BlfEncoder {
    pub fn new() -> Self {
        Self { channels: ChannelNumbers::new(1), ..Self::default() }
    }

    fn file_head(&self) -> Vec<u8> {
        let mut head = Vec::with_capacity(FILE_HEAD);
        head.extend_from_slice(MAGIC);
        head.extend_from_slice(&(FILE_HEAD as u32).to_le_bytes());
        // An application of no particular maker; version 2.6.8.1 of the format.
        head.extend_from_slice(&[5, 0, 0, 0, 2, 6, 8, 1]);
        head.extend_from_slice(&self.written.to_le_bytes());
        head.extend_from_slice(&(self.uncompressed + FILE_HEAD as u64).to_le_bytes());
        head.extend_from_slice(&self.count.to_le_bytes());
        head.extend_from_slice(&0_u32.to_le_bytes());
        for at in [self.start.unwrap_or(0), self.last] {
            let fields = if self.start.is_some() { system_time_of(at) } else { [0; 8] };
            for field in fields {
                head.extend_from_slice(&field.to_le_bytes());
            }
        }
        head.resize(FILE_HEAD, 0);
        head
    }

    /// Writes the head of the file, if nothing was written.
    fn write_head(&mut self, out: &mut Vec<u8>) {
        if self.written == 0 {
            self.written = FILE_HEAD as u64;
            out.extend_from_slice(&self.file_head());
        }
    }

    fn add_object(&mut self, kind: u32, nanos: u64, body: &[u8]) {
        const HEAD: usize = 32;
        let size = (HEAD + body.len()) as u32;
        let to = &mut self.objects;
        to.extend_from_slice(OBJECT);
        to.extend_from_slice(&(HEAD as u16).to_le_bytes());
        to.extend_from_slice(&1_u16.to_le_bytes());
        to.extend_from_slice(&size.to_le_bytes());
        to.extend_from_slice(&kind.to_le_bytes());
        to.extend_from_slice(&NANOS.to_le_bytes());
        to.extend_from_slice(&[0; 4]);
        to.extend_from_slice(&nanos.to_le_bytes());
        to.extend_from_slice(body);
        to.resize(to.len() + (size % 4) as usize, 0);
        self.count += 1;
    }

    /// Writes a container with the first `len` bytes of the objects.
    fn write_container(&mut self, len: usize, out: &mut Vec<u8>) -> io::Result<()> {
        const ZLIB: u16 = 2;
        const HEAD: usize = OBJECT_HEAD + 16;
        let mut packed = ZlibEncoder::new(Vec::new(), Compression::default());
        packed.write_all(&self.objects[..len])?;
        let packed = packed.finish()?;
        let size = (HEAD + packed.len()) as u32;
        let before = out.len();
        out.extend_from_slice(OBJECT);
        out.extend_from_slice(&(OBJECT_HEAD as u16).to_le_bytes());
        out.extend_from_slice(&1_u16.to_le_bytes());
        out.extend_from_slice(&size.to_le_bytes());
        out.extend_from_slice(&CONTAINER.to_le_bytes());
        out.extend_from_slice(&ZLIB.to_le_bytes());
        out.extend_from_slice(&[0; 6]);
        out.extend_from_slice(&(len as u32).to_le_bytes());
        out.extend_from_slice(&[0; 4]);
        out.extend_from_slice(&packed);
        out.resize(out.len() + (size % 4) as usize, 0);
        self.written += (out.len() - before) as u64;
        self.uncompressed += (HEAD + len) as u64;
        self.objects.drain(..len);
        Ok(())
    }

    fn add_frame(&mut self, channel: u8, nanos: u64, frame: &Frame) {
        let word = match frame.id {
            CanId::Standard(id) => u32::from(id),
            CanId::Extended(id) => id | EXTENDED,
        };
        let flags = if frame.is_tx { SENT } else { 0 };
        let flags = flags | if frame.kind == FrameKind::Remote { REMOTE } else { 0 };
        let mut body = u16::from(channel).to_le_bytes().to_vec();
        let kind = match (frame.kind, frame.is_fd) {
            (FrameKind::Error, _) => {
                // Length, and flags: the identifier and the data are those of SocketCAN.
                body.extend_from_slice(&[0; 6]);
                let dlc = frame.data().len() as u8;
                body.extend_from_slice(&[capture_of(frame.data()), 0, dlc, 0, 0, 0, 0, 0]);
                body.extend_from_slice(&(word & CanId::MAX_EXTENDED).to_le_bytes());
                body.extend_from_slice(&[0; 4]);
                ERROR_EXT
            }
            (_, true) => {
                body.extend_from_slice(&[flags, frame.dlc()]);
                body.extend_from_slice(&word.to_le_bytes());
                body.extend_from_slice(&[0; 5]);
                let set = [true, frame.bit_rate_switch, frame.error_state];
                let fd = FD.iter().zip(set).filter(|(_, is_set)| *is_set);
                body.push(fd.fold(0, |all, (flag, _)| all | flag));
                body.push(frame.data().len() as u8);
                body.extend_from_slice(&[0; 5]);
                FD_MESSAGE
            }
            (_, false) => {
                body.extend_from_slice(&[flags, frame.dlc()]);
                body.extend_from_slice(&word.to_le_bytes());
                MESSAGE
            }
        };
        let data_start = body.len();
        body.extend_from_slice(frame.data());
        let size = if kind == FD_MESSAGE { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA };
        body.resize(data_start + size, 0);
        self.add_object(kind, nanos, &body);
    }
}

impl LogEncoder for BlfEncoder {
    /// The head has the date of the first frame.
    fn begin(&mut self, _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn write(&mut self, entry: LogEntry<'_>, _: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        // The date has milliseconds.
        let LogTime { micros, nanos } = entry.time;
        let start = *self.start.get_or_insert((micros - micros % 1000).min(LAST_START));
        self.write_head(out);
        self.last = micros.max(self.last);
        let since_start = micros.checked_sub(start);
        let nanos =
            since_start.and_then(|micros| micros.checked_mul(1000)?.checked_add(u64::from(nanos)));
        self.other_times += u64::from(nanos.is_none());
        let nanos = nanos.unwrap_or(if since_start.is_some() { u64::MAX } else { 0 });
        let has_class = !matches!(entry.frame.id, CanId::Extended(0) | CanId::Standard(0));
        let is_whole = is_whole_error(&entry.frame) || has_class && !entry.frame.is_tx;
        self.error_details += u64::from(!is_whole);
        let channel = self.channels.number(entry.interface);
        self.add_frame(channel, nanos, &entry.frame);
        while self.objects.len() >= CONTAINER_SIZE {
            self.write_container(CONTAINER_SIZE, out)?;
        }
        Ok(true)
    }

    fn end(&mut self, _: &[String], _: &[u64], out: &mut Vec<u8>) -> io::Result<()> {
        self.write_head(out);
        if self.objects.is_empty() { Ok(()) } else { self.write_container(self.objects.len(), out) }
    }

    fn head(&self) -> Option<Vec<u8>> {
        Some(self.file_head())
    }

    fn loss(&self) -> LogLoss {
        let (other_times, error_details) = (self.other_times, self.error_details);
        self.channels.loss(&LogLoss { error_details, other_times, ..LogLoss::default() })
    }
}
