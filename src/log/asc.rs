//! ASC, the text log of Vector's tools: reads and writes it.
//!
//! Source: the logs that CANalyzer 9 to 12, python-can and SavvyCAN write. Times count from the date of
//! the measurement, which is local time; with `timestamps relative` each counts from the event before.
//! Other events than frames are passed over. Does not know moments or bus numbers.

use super::bus_errors::{bus_error, capture_of, captured, is_on_bus, of_vector, overload};
use super::channel::{ChannelNumbers, channel_name};
use super::controller::ControllerReport;
use super::dates::{LAST_START, asc_date, is_in_repeated_hour, local_time};
use super::fields::{
    FieldFault, bytes, can_id, channel, check_line, data_frame, first_word, len_of_dlc, number,
    starts_with_ignoring_case as starts, with_dlc, words, write_bytes,
};
use super::{LogEncoder, LogEntry, LogLoss, LogTime};
use crate::error_report::ReportedState;
use crate::frame::socketcan::{BIT_RATE_SWITCH, ERROR_STATE};
use crate::frame::{CanId, Frame, FrameKind};
use std::io::{self, Write};

/// Flags at the end of a line of an FD frame.
const REMOTE: u32 = 0x10;
const FD: u32 = 0x1000;
const SWITCHED: u32 = 0x2000;
const PASSIVE: u32 = 0x4000;

/// What the lines so far say about those that follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct AscLines {
    /// Base of identifiers and data: 10 or 16.
    base: u32,
    /// Each time counts from the event before.
    is_relative: bool,
    /// Date of the measurement.
    start: LogTime,
    /// Time of the last event since the start.
    last: LogTime,
}

impl AscLines {
    const NEW: Self = {
        let zero = LogTime::from_micros(0);
        Self { base: 16, is_relative: false, start: zero, last: zero }
    };

    /// Returns the beginning of a log with this line, if it is one of the head of an ASC log.
    pub fn of_line(line: &[u8]) -> Option<Self> {
        let line = line.trim_ascii();
        let is_head = [&b"date "[..], b"base hex", b"base dec", b"//", b"begin triggerblock"];
        is_head.iter().any(|head| starts(line, head)).then_some(Self::NEW)
    }

    /// Returns true if each time counts from the event before.
    pub fn is_relative(&self) -> bool {
        self.is_relative
    }

    /// Returns the date of the measurement.
    pub fn start(&self) -> LogTime {
        self.start
    }

    /// Reads a line; `None` for one without a frame.
    pub fn read<'a>(&mut self, line: &'a [u8]) -> Result<Option<LogEntry<'a>>, FieldFault> {
        check_line(line)?;
        let line = line.trim_ascii();
        if !line.first().is_some_and(u8::is_ascii_digit) {
            return self.read_head(line).map(|()| None);
        }
        let (time, rest) = first_word(line);
        let time = LogTime::of_seconds(time).ok_or(FieldFault::Time)?;
        let since_start = if self.is_relative { self.last.checked_add(time) } else { Some(time) };
        let since_start = since_start.ok_or(FieldFault::TimeRange)?;
        let event = self.read_event(rest);
        self.last = since_start;
        let Some((number, frame)) = event? else { return Ok(None) };
        let time = self.start.checked_add(since_start).ok_or(FieldFault::TimeRange)?;
        Ok(Some(LogEntry { time, interface: channel_name(number), frame }))
    }

    /// Reads a line of the head, a comment, or the beginning or end of a block.
    fn read_head(&mut self, line: &[u8]) -> Result<(), FieldFault> {
        let is_other = [&b"//"[..], b"end triggerblock", b"internal events", b"no internal events"];
        if line.is_empty() || is_other.iter().any(|start| starts(line, start)) {
            return Ok(());
        }
        if starts(line, b"date ") || starts(line, b"begin triggerblock") {
            let skipped = if starts(line, b"date ") { 2 } else { 3 };
            let date = (0..skipped).fold(line, |rest, _| first_word(rest).1).trim_ascii();
            self.last = LogTime::default();
            // A block without a date counts from the date of the head.
            if !date.is_empty() || skipped == 2 {
                self.start = asc_date(date).ok_or(FieldFault::StartDate)?;
            }
            return Ok(());
        }
        if starts(line, b"base ") {
            let mut words = words(line).skip(1);
            self.base = if words.next().is_some_and(|it| it.eq_ignore_ascii_case(b"dec")) {
                10
            } else {
                16
            };
            self.is_relative = words.nth(1).is_some_and(|it| it.eq_ignore_ascii_case(b"relative"));
            return Ok(());
        }
        Err(FieldFault::Time)
    }

    /// Reads an event behind its time; `None` for one without a frame.
    fn read_event(&self, event: &[u8]) -> Result<Option<(u8, Frame)>, FieldFault> {
        let (word, rest) = first_word(event);
        if word == b"CANFD" {
            return self.fd_event(rest);
        }
        if word == b"CAN" {
            return controller_event(rest);
        }
        if !word.iter().all(u8::is_ascii_digit) {
            return Ok(None);
        }
        let (id, rest) = first_word(rest);
        if let Some(frame) = error_event(id, rest) {
            return Ok(Some((channel(word)?, frame)));
        }
        let (direction, rest) = first_word(rest);
        let Some(is_tx) = is_tx(direction) else {
            let is_frame = matches!(first_word(rest).0, b"d" | b"D" | b"r" | b"R");
            return if is_frame { Err(no_frame(direction)) } else { Ok(None) };
        };
        let mut frame = self.classic_frame(id, rest)?;
        frame.is_tx = is_tx;
        Ok(Some((channel(word)?, frame)))
    }

    /// Reads `d 8 01 02 …` or `r 8` behind the direction.
    fn classic_frame(&self, id: &[u8], rest: &[u8]) -> Result<Frame, FieldFault> {
        let id = self.id(id, rest)?;
        let (kind, rest) = first_word(rest);
        let (length, rest) = first_word(rest);
        let dlc = number(length, self.base);
        match kind {
            b"r" | b"R" => {
                let dlc = dlc.filter(|dlc| *dlc <= 15).unwrap_or(0);
                Ok(with_dlc(Frame::remote(id, len_of_dlc(dlc, false)?), dlc))
            }
            b"d" | b"D" => {
                let dlc = dlc.ok_or(FieldFault::Length)?;
                if dlc > 8
                    && let Some(frame) = self.long_frame(id, length, rest)?
                {
                    return Ok(frame);
                }
                let mut data = [0; Frame::MAX_CLASSIC_DATA];
                let len = len_of_dlc(dlc, false)?;
                bytes(rest, self.base, &mut data[..len])?;
                Ok(with_dlc(data_frame(id, &data[..len], None)?, dlc))
            }
            _ => Err(FieldFault::Kind),
        }
    }

    /// Reads the data of `d 9 01 02 …` with more than 8 bytes: some writers write FD frames so, with the DLC in
    /// base 10, or the number of bytes. `None` if they are at most 8.
    fn long_frame(
        &self,
        id: CanId,
        length: &[u8],
        rest: &[u8],
    ) -> Result<Option<Frame>, FieldFault> {
        let is_byte = |word: &&[u8]| number(word, self.base).is_some_and(|value| value <= 0xFF);
        let count = words(rest).take_while(is_byte).count();
        if count <= Frame::MAX_CLASSIC_DATA {
            return Ok(None);
        }
        let numbers = [number(length, 10), number(length, self.base)];
        let is_dlc = |dlc: u32| len_of_dlc(dlc, true).is_ok_and(|len| len == count);
        let is_len = |len: u32| is_dlc(len) || len as usize == count && (9..=15).any(is_dlc);
        if !numbers.into_iter().flatten().any(is_len) {
            return Err(FieldFault::Length);
        }
        let mut data = [0; Frame::MAX_DATA];
        let data = data.get_mut(..count).ok_or(FieldFault::Length)?;
        bytes(rest, self.base, data)?;
        data_frame(id, data, Some(0)).map(Some)
    }

    /// Reads `1 Rx 300 NAME 1 0 8 8 01 02 …` behind the time and `CANFD`.
    fn fd_event(&self, event: &[u8]) -> Result<Option<(u8, Frame)>, FieldFault> {
        let (word, rest) = first_word(event);
        let (direction, rest) = first_word(rest);
        let Some(is_tx) = is_tx(direction) else { return Err(no_frame(direction)) };
        let number_of_channel = channel(word)?;
        let (id, mut rest) = first_word(rest);
        if let Some(mut frame) = error_event(id, rest) {
            frame.is_tx = is_tx;
            return Ok(Some((number_of_channel, frame)));
        }
        // A name may stand before BRS.
        let (mut switched, mut after) = first_word(rest);
        if !matches!(switched, b"0" | b"1") {
            rest = after;
            (switched, after) = first_word(rest);
        }
        let (passive, after) = first_word(after);
        let (dlc, after) = first_word(after);
        let (length, after) = first_word(after);
        if !matches!(switched, b"0" | b"1") || !matches!(passive, b"0" | b"1") {
            return Err(FieldFault::Column);
        }
        let dlc = number(dlc, 16).filter(|dlc| *dlc <= 15).ok_or(FieldFault::Length)?;
        let len = number(length, 10).ok_or(FieldFault::Length)? as usize;
        let mut data = [0; Frame::MAX_DATA];
        let data = data.get_mut(..len).ok_or(FieldFault::Length)?;
        let after = bytes(after, self.base, data)?;
        let id = self.id(id, after)?;
        // Duration and number of bits come first.
        let flags = words(after).nth(2).and_then(|flags| number(flags, 16)).unwrap_or(FD);
        // Some writers leave the flags out, as 0.
        let is_classic = flags != 0 && flags & FD == 0 && len <= Frame::MAX_CLASSIC_DATA;
        let mut frame = if flags & REMOTE != 0 || len == 0 && dlc > 0 {
            // The FDF of a remote frame is none on the bus.
            let frame = with_dlc(Frame::remote(id, len_of_dlc(dlc, false)?), dlc);
            if flags & FD != 0 { frame.as_changed() } else { frame }
        } else if is_classic {
            with_dlc(data_frame(id, data, None)?, dlc)
        } else {
            let flag = |word: &[u8], flag| if word == b"1" { flag } else { 0 };
            let fd_flags = flag(switched, BIT_RATE_SWITCH) | flag(passive, ERROR_STATE);
            data_frame(id, data, Some(fd_flags))?
        };
        frame.is_tx = is_tx;
        Ok(Some((number_of_channel, frame)))
    }

    /// Reads an identifier, with `x` for 29 bits; a name has its number at the end of the line.
    fn id(&self, word: &[u8], line: &[u8]) -> Result<CanId, FieldFault> {
        let parsed = |word: &[u8], base| {
            let digits = word.strip_suffix(b"x").or_else(|| word.strip_suffix(b"X"));
            can_id(number(digits.unwrap_or(word), base), digits.is_some())
        };
        parsed(word, self.base).or_else(|fault| {
            let mut words = words(line).skip_while(|word| *word != b"ID");
            let (_, sign, decimal) = (words.next(), words.next(), words.next());
            match decimal.filter(|_| sign == Some(b"=")) {
                Some(decimal) => parsed(decimal, 10),
                None => Err(fault),
            }
        })
    }
}

/// Returns why a line with this word in the place of the direction has no frame.
fn no_frame(direction: &[u8]) -> FieldFault {
    let is_request = direction.eq_ignore_ascii_case(b"TxRq");
    if is_request { FieldFault::TransmitRequest } else { FieldFault::Column }
}

/// Returns true for `Tx`, false for `Rx`; `None` for another word, such as that of a transmit request.
fn is_tx(direction: &[u8]) -> Option<bool> {
    match direction {
        b"Rx" => Some(false),
        b"Tx" => Some(true),
        _ => None,
    }
}

/// Reads `1 Status:chip status error passive - TxErr: 132 RxErr: 0` behind the time and `CAN`; `None` for
/// another event of a channel.
fn controller_event(event: &[u8]) -> Result<Option<(u8, Frame)>, FieldFault> {
    let (word, rest) = first_word(event);
    let rest = rest.trim_ascii_start();
    let Some(rest) = rest.strip_prefix(b"Status:") else { return Ok(None) };
    let Some(rest) = rest.trim_ascii_start().strip_prefix(b"chip status ") else {
        return Ok(None);
    };
    let rest = rest.trim_ascii_start();
    let is_named = |state: &ReportedState| starts(rest, state_name(*state).as_bytes());
    let is_bus_off = starts(rest, b"bus off") || starts(rest, b"bus-off");
    let other = Some(ReportedState::BusOff).filter(|_| is_bus_off);
    let state = ReportedState::ALL.into_iter().find(is_named).or(other).ok_or(FieldFault::Kind)?;
    let word_after = |name: &[u8]| words(rest).skip_while(|word| *word != name).nth(1);
    let counter = |name: &[u8]| {
        let word = word_after(name)?;
        let value = number(word.strip_suffix(b",").unwrap_or(word), 10)?;
        // That of sending is 256 where it has led to bus-off.
        Some(u8::try_from(value).unwrap_or(u8::MAX))
    };
    let (sent, received) = (counter(b"TxErr:"), counter(b"RxErr:"));
    // One alone says nothing of the other.
    let counters = sent.zip(received).map(|(sent, received)| [sent, received]);
    let names = [b"TxErr:", b"RxErr:"].map(|name| words(rest).any(|word| word == name));
    let is_whole = counters.is_some() || names == [false, false];
    let frame = ControllerReport { state: Some(state), counters }.frame();
    let channel = channel(word)?;
    Ok(frame.map(|frame| (channel, if is_whole { frame } else { frame.as_changed() })))
}

/// Returns what an ASC log calls a state.
fn state_name(state: ReportedState) -> &'static str {
    match state {
        ReportedState::ErrorActive => "error active",
        ReportedState::ErrorWarning => "warning level",
        ReportedState::ErrorPassive => "error passive",
        ReportedState::BusOff => "busoff",
    }
}

/// Reads `OverloadFrame`, `ErrorFrame ECC: 10100010`, and the longer forms: see [`error_code`].
fn error_event(word: &[u8], rest: &[u8]) -> Option<Frame> {
    if word.eq_ignore_ascii_case(b"OverloadFrame") {
        return Some(overload());
    }
    if !word.eq_ignore_ascii_case(b"ErrorFrame") {
        return None;
    }
    if let Some((valid, code, extended)) = error_code(rest) {
        return Some(of_vector(valid, code, extended, true));
    }
    let (name, after) = first_word(rest);
    let (code, end) = first_word(after);
    let bits = number(code, 2).filter(|_| name == b"ECC:" && code.len() == 8);
    let frame = bits.map_or_else(bus_error, |bits| captured(bits as u8));
    // A direction may stand there alone.
    let other = match bits {
        Some(_) => end,
        None if is_tx(name).is_some() => after,
        None => rest,
    };
    Some(if other.trim_ascii().is_empty() { frame } else { frame.as_changed() })
}

/// Reads which fields are valid, the error code capture and the extended error flags, from
/// `Flags = 0xe CodeExt = 0x20a2 Code = 0x82 ID = …`, or from `TEXT fffe c7 31ca Arb. …` of a line of CAN FD.
fn error_code(line: &[u8]) -> Option<(u32, u8, u16)> {
    let hex = |word: &[u8]| number(word.strip_prefix(b"0x").unwrap_or(word), 16);
    let named = |name: &[u8]| {
        let mut words = words(line).skip_while(|word| *word != name);
        let (_, sign, value) = (words.next()?, words.next()?, words.next()?);
        if sign == b"=" { hex(value) } else { None }
    };
    let (valid, code, extended) = if let Some(valid) = named(b"Flags") {
        (valid, named(b"Code")?, named(b"CodeExt")?)
    } else {
        // Before the phase of the frame.
        let mut before = [&b""[..]; 3];
        let mut words = words(line);
        let [valid, code, extended] = loop {
            match words.next()? {
                b"Arb." | b"Data" if before.iter().all(|it| hex(it).is_some()) => break before,
                word => before = [before[1], before[2], word],
            }
        };
        (hex(valid)?, hex(code)?, hex(extended)?)
    };
    Some((valid, u8::try_from(code).ok()?, u16::try_from(extended).ok()?))
}

/// Writes an ASC log.
#[derive(Debug)]
pub(super) struct AscEncoder {
    channels: ChannelNumbers,
    /// Date of the first frame, in microseconds since 1970.
    start: Option<u64>,
    loss: LogLoss,
}

impl AscEncoder {
    pub fn new() -> Self {
        Self { channels: ChannelNumbers::new(1), start: None, loss: LogLoss::default() }
    }

    fn write_head(out: &mut Vec<u8>, unix_micros: u64) -> io::Result<()> {
        let at = local_time(unix_micros);
        let date = at.strftime("%a %b %d %I:%M:%S");
        let (millis, half) = (at.millisecond(), if at.hour() < 12 { "am" } else { "pm" });
        let date = format!("{date}.{millis:03} {half} {}", at.year());
        write!(out, "date {date}\nbase hex  timestamps absolute\ninternal events logged\n")?;
        write!(out, "// version 9.0.0\nBegin Triggerblock {date}\n")?;
        writeln!(out, "   0.000000 Start of measurement")
    }
}

impl LogEncoder for AscEncoder {
    fn begin(&mut self, _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        let before = out.len();
        let report = ControllerReport::of(&entry.frame).filter(|it| it.state.is_some());
        if report.is_none() && !is_on_bus(&entry.frame) {
            self.loss.error_frames += 1;
            return Ok(true);
        }
        let unix_micros = entry.time.micros;
        let start = if let Some(start) = self.start {
            start
        } else {
            // The date has milliseconds.
            let start = (unix_micros - unix_micros % 1000).min(LAST_START);
            Self::write_head(out, start)?;
            self.loss.is_in_repeated_hour = is_in_repeated_hour(start);
            *self.start.insert(start)
        };
        self.loss.other_times += u64::from(unix_micros < start);
        self.loss.finer_times += u64::from(entry.time.nanos > 0);
        let since_start = unix_micros.saturating_sub(start);
        let channel = self.channels.number(entry.interface);
        write!(out, "{:4}.{:06} ", since_start / 1_000_000, since_start % 1_000_000)?;
        if let Some(report) = report {
            write_controller_event(out, channel, report)?;
            self.loss.error_details += u64::from(!report.is_all_of(&entry.frame));
        } else {
            write_event(out, channel, &entry.frame)?;
            self.loss.error_details += u64::from(!is_whole_error(&entry.frame));
        }
        let fits = (out.len() - before) as u64 <= max_len;
        if !fits {
            out.truncate(before);
        }
        Ok(fits)
    }

    fn end(&mut self, _: &[String], _: &[u64], out: &mut Vec<u8>) -> io::Result<()> {
        if self.start.is_none() {
            Self::write_head(out, 0)?;
        }
        writeln!(out, "End TriggerBlock")
    }

    fn loss(&self) -> LogLoss {
        self.channels.loss(&self.loss)
    }
}

/// Returns true for an error frame that is read from its error code capture as it was, and for any other
/// frame.
pub(super) fn is_whole_error(frame: &Frame) -> bool {
    let read = || [bus_error(), overload(), captured(capture_of(frame.data()))];
    let is_read = || !frame.is_tx && read().iter().any(|it| it.same_on_wire(frame));
    frame.kind != FrameKind::Error || is_read()
}

fn write_controller_event(
    out: &mut Vec<u8>,
    channel: u8,
    report: ControllerReport,
) -> io::Result<()> {
    let Some(state) = report.state else { return Ok(()) };
    write!(out, "CAN {channel} Status:chip status {}", state_name(state))?;
    if let Some([sent, received]) = report.counters {
        write!(out, " - TxErr: {sent} RxErr: {received}")?;
    }
    writeln!(out)
}

fn write_event(out: &mut Vec<u8>, channel: u8, frame: &Frame) -> io::Result<()> {
    let direction = if frame.is_tx { "Tx" } else { "Rx" };
    let id = match frame.id {
        CanId::Standard(id) => format!("{id:X}"),
        CanId::Extended(id) => format!("{id:X}x"),
    };
    match frame.kind {
        FrameKind::Error if frame.same_on_wire(&overload()) => {
            return writeln!(out, "{channel}  OverloadFrame");
        }
        FrameKind::Error => {
            write!(out, "{channel}  ErrorFrame")?;
            let code = capture_of(frame.data());
            if !frame.same_on_wire(&bus_error()) {
                write!(out, "  ECC: {code:08b}")?;
            }
            return writeln!(out);
        }
        FrameKind::Remote => {
            return writeln!(out, "{channel}  {id:<15} {direction:<4} r {:x}", frame.dlc());
        }
        FrameKind::Data => {}
    }
    if !frame.is_fd {
        write!(out, "{channel}  {id:<15} {direction:<4} d {:x}", frame.dlc())?;
        write_bytes(out, frame.data())?;
        return writeln!(out);
    }
    let (switched, passive) = (u8::from(frame.bit_rate_switch), u8::from(frame.error_state));
    let (code, len) = (frame.dlc(), frame.len());
    write!(out, "CANFD {channel:>3} {direction:<4} {id:>8}  {:>32} ", "")?;
    write!(out, "{switched} {passive} {code:x} {len:>2}")?;
    write_bytes(out, frame.data())?;
    let flag = |is_set, flag| if is_set { flag } else { 0 };
    let flags = FD | flag(frame.bit_rate_switch, SWITCHED) | flag(frame.error_state, PASSIVE);
    writeln!(out, "        0    0 {flags:>8X}        0        0        0        0        0")
}
