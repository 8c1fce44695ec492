//! CSV logs: SavvyCAN's (GVRET), which is read and written, and python-can's, which is read.
//!
//! Known by their header lines; python-can's also by a row, as it writes no header where it appends. Does
//! not know moments or bus numbers.

use super::channel::{ChannelNumbers, ONLY_BUS, bus_name};
use super::dates::seconds;
use super::fields::{
    FieldFault, can_id, channel, check_line, data_frame, decimal, hex_byte, number,
    starts_with_ignoring_case as starts, usual_bytes,
};
use super::{LogEncoder, LogEntry, LogLoss, LogTime};
use crate::frame::{CanId, Frame, FrameKind};
use crate::text::hex;
use std::io::{self, Write};

/// A column that the header lacks.
const NONE: u8 = u8::MAX;

/// Columns of a SavvyCAN log, by the number of their place.
#[derive(Clone, Copy, Debug)]
pub(super) struct GvretLines {
    time: u8,
    id: u8,
    extended: u8,
    direction: u8,
    bus: u8,
    len: u8,
    /// The first byte; the others follow.
    data: u8,
    /// Nothing but data follows the first byte.
    ends_with_data: bool,
    /// The first time in microseconds, if it is below 0, from which times then count; 0 otherwise. `None`
    /// before it.
    start: Option<i128>,
    counter: WrappedCounter,
}

impl GvretLines {
    /// Returns the columns of a header line: `Time Stamp,ID,Extended,Dir,Bus,LEN,D1,…`.
    pub fn of_header(line: &[u8]) -> Option<Self> {
        if !starts(line.trim_ascii(), b"time stamp,") {
            return None;
        }
        let place = |name: &[u8]| {
            let mut columns = cells(line);
            columns
                .position(|cell| cell.eq_ignore_ascii_case(name))
                .and_then(|at| u8::try_from(at).ok())
        };
        let (time, id, data) = (place(b"time stamp")?, place(b"id")?, place(b"d1")?);
        let len = place(b"len").or_else(|| place(b"dlc"))?;
        let others = [place(b"extended"), place(b"dir"), place(b"bus")];
        let mut named = [time, id, len].into_iter().chain(others.into_iter().flatten());
        let [extended, direction, bus] = others.map(|place| place.unwrap_or(NONE));
        let is_data = |cell: &[u8]| match cell {
            [] => true,
            [b'd' | b'D', number @ ..] => number.iter().all(u8::is_ascii_digit),
            _ => false,
        };
        Some(Self {
            time,
            id,
            extended,
            direction,
            bus,
            len,
            data,
            ends_with_data: named.all(|place| place < data)
                && cells(line).skip(usize::from(data)).all(is_data),
            start: None,
            counter: WrappedCounter::default(),
        })
    }

    /// Reads a line; `None` for the header and for a blank line.
    pub fn read<'a>(&mut self, line: &'a [u8]) -> Result<Option<LogEntry<'a>>, FieldFault> {
        check_line(line)?;
        if line.trim_ascii().is_empty() {
            return Ok(None);
        }
        if let Some(header) = Self::of_header(line) {
            *self = Self { start: self.start, ..header };
            return Ok(None);
        }
        let (mut time, mut id, mut len) = (None, &b""[..], None);
        let (mut is_extended, mut is_tx, mut bus) = (None, false, 0);
        let mut data = [0; Frame::MAX_DATA];
        let mut bytes = 0;
        let mut cells = cells(line);
        for at in 0..NONE {
            let Some(cell) = cells.next() else { break };
            match at {
                _ if at == self.time => time = self.time(cell),
                _ if at == self.id => id = cell,
                _ if at == self.extended => {
                    is_extended = Some(starts(cell, b"true") || cell == b"1");
                }
                _ if at == self.direction => is_tx = starts(cell, b"tx"),
                _ if at == self.bus => bus = channel(cell)?,
                _ if at == self.len => len = number(cell, 10),
                _ if at >= self.data && len.is_some_and(|len| bytes < len as usize) => {
                    let place = data.get_mut(bytes).ok_or(FieldFault::Length)?;
                    let value = match cell {
                        [high, low] => hex_byte([*high, *low]),
                        _ => number(cell, 16).and_then(|value| u8::try_from(value).ok()),
                    };
                    *place = value.ok_or(FieldFault::Data)?;
                    bytes += 1;
                    if self.ends_with_data
                        && let Some(rest) = cells.rest
                    {
                        let following = len.map_or(0, |len| data.len().min(len as usize));
                        let (usual, rest) = usual_bytes(rest, b',', &mut data[bytes..following]);
                        bytes += usual;
                        cells.rest = Some(rest);
                    }
                }
                // No byte: another row, the end of whose line is lost.
                _ if at >= self.data && self.ends_with_data && cell.len() > LONGEST_BYTE => {
                    return Err(FieldFault::Column);
                }
                _ => {}
            }
        }
        let time = time.ok_or(FieldFault::Time)?;
        let len = len.ok_or(FieldFault::Length)? as usize;
        let id = number(id.strip_prefix(b"0x").unwrap_or(id), 16);
        let is_extended = is_extended.unwrap_or(id > Some(u32::from(CanId::MAX_STANDARD)));
        if bytes < len {
            return Err(FieldFault::Data);
        }
        let is_fd = len > Frame::MAX_CLASSIC_DATA;
        let mut frame = data_frame(can_id(id, is_extended)?, &data[..len], is_fd.then_some(0))?;
        frame.is_tx = is_tx;
        Ok(Some(LogEntry { time, interface: bus_name(bus), frame }))
    }

    /// Reads a time in microseconds. A log may begin below 0, which says nothing but differences.
    fn time(&mut self, cell: &[u8]) -> Option<LogTime> {
        let time = match cell.strip_prefix(b"-") {
            Some(digits) => -i128::from(decimal(digits)?),
            None => i128::from(decimal(cell)?),
        };
        let start = *self.start.get_or_insert(time.min(0));
        let since_start = self.counter.unwrapped(time) - start;
        u64::try_from(since_start.max(0)).ok().map(LogTime::from_micros)
    }
}

/// Times of a counter of 32 bits, written as signed or as unsigned numbers, that begins anew after a turn of
/// 71.6 minutes.
#[derive(Clone, Copy, Debug, Default)]
struct WrappedCounter {
    /// A time outside the range of 32 bits was read: the times are of another clock.
    is_wider: bool,
    /// The last time, with the turns before it.
    last: Option<i128>,
    /// Microseconds of the turns so far.
    turned: i128,
}

impl WrappedCounter {
    const TURN: i128 = 1 << 32;

    /// Returns a time with the turns before it. A step back of at least half a turn is another turn, and a
    /// step forward of more than that, after a turn, is of a frame from before it.
    fn unwrapped(&mut self, time: i128) -> i128 {
        self.is_wider |= !(-Self::TURN / 2..Self::TURN).contains(&time);
        let mut unwrapped = time + self.turned;
        if !self.is_wider {
            let step = self.last.map_or(0, |last| unwrapped - last);
            if step <= -Self::TURN / 2 {
                self.turned += Self::TURN;
                unwrapped += Self::TURN;
            } else if step > Self::TURN / 2 && self.turned > 0 {
                unwrapped -= Self::TURN;
            }
        }
        self.last = Some(unwrapped);
        unwrapped
    }
}

/// Characters of the longest cell of a byte: `0xFF`.
const LONGEST_BYTE: usize = 4;

/// python-can's CSV log.
pub(super) struct PythonCanLines;

impl PythonCanLines {
    /// Returns true for the header line, and for a row of a log without one.
    pub fn is_first_line(line: &[u8]) -> bool {
        let is_row = || {
            let has_prefix = cells(line).nth(1).is_some_and(|id| id.starts_with(b"0x"));
            has_prefix && matches!(Self::read(line), Ok(Some(_)))
        };
        Self::is_header(line) || is_row()
    }

    fn is_header(line: &[u8]) -> bool {
        starts(line.trim_ascii(), b"timestamp,arbitration_id,")
    }

    /// Reads a line of the columns `timestamp,arbitration_id,extended,remote,error,dlc,data`; `None` for the
    /// header and for a blank line.
    pub fn read(line: &[u8]) -> Result<Option<LogEntry<'_>>, FieldFault> {
        check_line(line)?;
        if line.trim_ascii().is_empty() || Self::is_header(line) {
            return Ok(None);
        }
        let mut cells = cells(line);
        let mut cell = || cells.next().ok_or(FieldFault::Column);
        let time = LogTime::from_micros(seconds(cell()?).ok_or(FieldFault::Time)?);
        let id = cell()?;
        let id = number(id.strip_prefix(b"0x").unwrap_or(id), 16);
        let flag = |cell: &[u8]| match cell {
            b"0" => Ok(false),
            b"1" => Ok(true),
            _ => Err(FieldFault::Column),
        };
        let (is_extended, is_remote, is_error) = (flag(cell()?)?, flag(cell()?)?, flag(cell()?)?);
        let len = number(cell()?, 10).ok_or(FieldFault::Length)? as usize;
        let encoded = cell()?;
        // A row that goes on is two of which the end of a line is lost.
        if cells.next().is_some_and(|cell| !cell.is_empty()) {
            return Err(FieldFault::Column);
        }
        let mut data = [0; Frame::MAX_DATA];
        let data = data.get_mut(..len).ok_or(FieldFault::Length)?;
        let frame = if is_remote {
            let len = Some(len).filter(|len| *len <= Frame::MAX_CLASSIC_DATA);
            Frame::remote(can_id(id, is_extended)?, len.ok_or(FieldFault::Length)?)
        } else {
            base64(encoded, data)?;
            if is_error {
                let class = id.filter(|id| *id <= CanId::MAX_EXTENDED).ok_or(FieldFault::Id)?;
                error_of(class, data)?
            } else {
                let is_fd = len > Frame::MAX_CLASSIC_DATA;
                data_frame(can_id(id, is_extended)?, data, is_fd.then_some(0))?
            }
        };
        Ok(Some(LogEntry { time, interface: ONLY_BUS, frame }))
    }
}

/// Returns an error frame with its class and details; one without them is an error frame on the bus.
fn error_of(class: u32, data: &[u8]) -> Result<Frame, FieldFault> {
    match data.len() {
        0 if class == 0 => Ok(super::bus_errors::bus_error()),
        0..=Frame::MAX_CLASSIC_DATA => Ok(Frame::error(class, data)),
        _ => Err(FieldFault::Length),
    }
}

/// CsvCells of a line without the blanks around them.
struct CsvCells<'a> {
    /// What follows; `None` behind the last one.
    rest: Option<&'a [u8]>,
}

fn cells(line: &[u8]) -> CsvCells<'_> {
    CsvCells { rest: Some(line) }
}

impl<'a> Iterator for CsvCells<'a> {
    type Item = &'a [u8];

    #[inline]
    fn next(&mut self) -> Option<&'a [u8]> {
        let line = self.rest?;
        let end = line.iter().position(|&byte| byte == b',');
        self.rest = end.map(|end| &line[end + 1..]);
        Some(line[..end.unwrap_or(line.len())].trim_ascii())
    }
}

/// Reads as many bytes as `data` has from base64 with padding.
fn base64(text: &[u8], data: &mut [u8]) -> Result<(), FieldFault> {
    let value = |digit: u8| match digit {
        b'A'..=b'Z' => Some(digit - b'A'),
        b'a'..=b'z' => Some(digit - b'a' + 26),
        b'0'..=b'9' => Some(digit - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let digits = text.trim_ascii_end();
    let digits = &digits[..digits.iter().position(|&byte| byte == b'=').unwrap_or(digits.len())];
    if digits.len() * 6 / 8 != data.len() {
        return Err(FieldFault::Data);
    }
    let (mut bits, mut count, mut filled) = (0_u32, 0, 0);
    for &digit in digits {
        bits = bits << 6 | u32::from(value(digit).ok_or(FieldFault::Data)?);
        count += 6;
        if count >= 8 {
            count -= 8;
            data[filled] = (bits >> count) as u8;
            filled += 1;
        }
    }
    Ok(())
}

/// Writes SavvyCAN's CSV.
#[derive(Debug)]
pub(super) struct GvretEncoder {
    buses: ChannelNumbers,
    loss: LogLoss,
}

impl GvretEncoder {
    pub fn new() -> Self {
        Self { buses: ChannelNumbers::new(0), loss: LogLoss::default() }
    }
}

impl LogEncoder for GvretEncoder {
    fn begin(&mut self, out: &mut Vec<u8>) -> io::Result<()> {
        writeln!(out, "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8")
    }

    /// A frame that the format does not have is passed over.
    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        let (before, frame) = (out.len(), entry.frame);
        match frame.kind {
            FrameKind::Data => {}
            FrameKind::Remote => {
                self.loss.remote_frames += 1;
                return Ok(true);
            }
            FrameKind::Error => {
                self.loss.error_frames += 1;
                return Ok(true);
            }
        }
        let is_classic_length = frame.len() <= Frame::MAX_CLASSIC_DATA;
        let has_flags = frame.bit_rate_switch || frame.error_state;
        self.loss.finer_times += u64::from(entry.time.nanos > 0);
        self.loss.raw_dlcs += u64::from(frame.raw_dlc().is_some());
        self.loss.fd_flags += u64::from(frame.is_fd && (is_classic_length || has_flags));
        let (id, is_extended) = match frame.id {
            CanId::Standard(id) => (u32::from(id), false),
            CanId::Extended(id) => (id, true),
        };
        let direction = if frame.is_tx { "Tx" } else { "Rx" };
        let bus = self.buses.number(entry.interface);
        write!(out, "{},{id:08X},{is_extended},{direction},{bus},", entry.time.micros)?;
        write!(out, "{},", frame.len())?;
        let end = if frame.is_empty() { "" } else { "," };
        writeln!(out, "{}{end}", hex(frame.data(), ","))?;
        let fits = (out.len() - before) as u64 <= max_len;
        if !fits {
            out.truncate(before);
        }
        Ok(fits)
    }

    fn end(&mut self, _: &[String], _: &[u64], _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn loss(&self) -> LogLoss {
        self.buses.loss(&self.loss)
    }
}
