//! TRC, the trace of PEAK's tools, versions 1.0 to 2.1: reads it, and writes 2.1.
//!
//! Source: "PEAK CAN TRC File Format" of PEAK-System. The times are milliseconds since `$STARTTIME`, which
//! is local time in days since 1899-12-30, or UTC where the comment with the start has `+00:00`, as
//! python-can writes it. Event lines are passed over. Does not know moments or bus numbers.

use super::bus_errors::{bus_error, capture_of, captured_with_counters, is_on_bus};
use super::channel::{ChannelNumbers, channel_name};
use super::controller::ControllerReport;
use super::dates::{
    LAST_START, day_month_year, is_in_repeated_hour, local_time, trc_date, trc_days, trc_utc_date,
    utc_date,
};
use super::fields::{
    FieldFault, bytes, can_id, channel, check_line, data_frame, first_word, fixed_point,
    len_of_dlc, number, starts_with_ignoring_case as starts, with_dlc, write_bytes,
};
use super::{LogEncoder, LogEntry, LogLoss, LogTime};
use crate::error_report::ReportedState;
use crate::frame::socketcan::{BIT_RATE_SWITCH, ERROR_STATE};
use crate::frame::{CanId, Frame, FrameKind};
use std::io::{self, Write};

/// Most columns of a line.
const MAX_COLUMNS: usize = 10;
/// Columns of the versions that do not name them. The number of the message is not among them.
const COLUMNS_1_0: &[u8] = b"OIlD";
const COLUMNS_1_1: &[u8] = b"OdIlD";
const COLUMNS_1_2: &[u8] = b"OBdIlD";
const COLUMNS_1_3: &[u8] = b"OBdIRlD";

/// What the lines so far say about those that follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrcLines {
    /// Letters of the columns behind the number of the message, as `$COLUMNS` has them.
    columns: [u8; MAX_COLUMNS],
    /// The columns have a type of message.
    has_types: bool,
    /// Date of the beginning, in microseconds since 1970.
    start: u64,
    /// The same if `$STARTTIME` is in UTC.
    utc_start: Option<u64>,
    /// True if the start is in UTC.
    is_utc: bool,
}

impl TrcLines {
    /// Returns the beginning of a trace with this line, if it is one of the head of a trace.
    pub fn of_line(line: &[u8]) -> Option<Self> {
        let line = line.trim_ascii();
        let is_head = line.starts_with(b";$FILEVERSION") || line.starts_with(b";##########");
        is_head.then(|| Self::new(COLUMNS_1_0))
    }

    fn new(letters: &[u8]) -> Self {
        let mut columns = [0; MAX_COLUMNS];
        let len = letters.len().min(MAX_COLUMNS);
        columns[..len].copy_from_slice(&letters[..len]);
        Self {
            columns,
            has_types: letters.contains(&b'T'),
            start: 0,
            utc_start: None,
            is_utc: false,
        }
    }

    /// Returns the date of the beginning; `None` if it is in UTC.
    pub fn local_start(&self) -> Option<LogTime> {
        (!self.is_utc).then_some(LogTime::from_micros(self.start))
    }

    /// Reads a line; `None` for one without a frame.
    pub fn read<'a>(&mut self, line: &'a [u8]) -> Result<Option<LogEntry<'a>>, FieldFault> {
        check_line(line)?;
        let line = line.trim_ascii();
        if let Some(comment) = line.strip_prefix(b";") {
            return self.read_head(comment).map(|()| None);
        }
        if line.is_empty() {
            return Ok(None);
        }
        let (message, rest) = first_word(line);
        number(message.strip_suffix(b")").unwrap_or(message), 10).ok_or(FieldFault::Time)?;
        self.read_message(rest)
    }

    /// Reads what stands behind the `;` of a line.
    fn read_head(&mut self, comment: &[u8]) -> Result<(), FieldFault> {
        let value = |name: &[u8]| {
            let value = comment.strip_prefix(name)?.trim_ascii();
            Some(value.strip_prefix(b"=").unwrap_or(value).trim_ascii())
        };
        let columns = if let Some(version) = value(b"$FILEVERSION") {
            match version {
                b"1.0" => COLUMNS_1_0,
                b"1.1" => COLUMNS_1_1,
                b"1.2" => COLUMNS_1_2,
                b"1.3" => COLUMNS_1_3,
                // Later ones name their columns.
                _ => return Ok(()),
            }
        } else if let Some(days) = value(b"$STARTTIME") {
            (self.utc_start, self.is_utc) = (trc_utc_date(days), false);
            // Just after 1970 in UTC, the local time may be before it.
            self.start = trc_date(days).or(self.utc_start).ok_or(FieldFault::StartDate)?;
            return Ok(());
        } else if let Some(letters) = value(b"$COLUMNS") {
            let mut columns = [0; MAX_COLUMNS];
            let named = letters.split(|&byte| byte == b',').map(<[u8]>::trim_ascii);
            let rest = named.filter(|letter| *letter != b"N");
            for (at, letter) in rest.enumerate() {
                let place = columns.get_mut(at).ok_or(FieldFault::Column)?;
                *place = *letter.first().ok_or(FieldFault::Column)?;
            }
            *self = self.with_columns(&columns);
            return Ok(());
        } else {
            if let Some(date) = comment.trim_ascii().strip_prefix(b"Start time:") {
                let utc = date.strip_suffix(b"+00:00");
                if let Some(start) = utc.and_then(|date| self.utc_start.or(utc_date(date))) {
                    (self.start, self.is_utc) = (start, true);
                } else if self.start == 0 {
                    // Version 1.0 has its date in words.
                    self.start = day_month_year(date).unwrap_or(0);
                }
            }
            return Ok(());
        };
        *self = self.with_columns(columns);
        Ok(())
    }

    /// Returns the beginning of a trace with the same date and these columns.
    fn with_columns(&self, letters: &[u8]) -> Self {
        let &Self { start, utc_start, is_utc, .. } = self;
        Self { start, utc_start, is_utc, ..Self::new(letters) }
    }

    /// Reads a line behind the number of the message.
    fn read_message(&self, line: &[u8]) -> Result<Option<LogEntry<'static>>, FieldFault> {
        let (mut time, mut kind, mut bus, mut id, mut length) = (None, &b"DT"[..], 1, None, None);
        let (mut is_tx, mut is_error, mut is_warning) = (false, false, false);
        let (mut is_dlc, mut rest) = (false, line);
        for column in self.columns.into_iter().take_while(|column| *column != 0) {
            if column == b'D' {
                break;
            }
            let (word, after) = first_word(rest);
            match column {
                // Milliseconds with at most three places: microseconds.
                b'O' => time = Some(fixed_point::<3>(word).ok_or(FieldFault::Time)?),
                b'T' => kind = word,
                // An event may be of no bus.
                b'B' if kind == b"EV" => return Ok(None),
                b'B' => bus = channel(word)?,
                // An error frame has no identifier.
                b'I' if matches!(word, b"Rx" | b"Tx") => continue,
                b'I' => id = Some(word),
                b'd' if word == b"Tx" || word == b"Rx" => is_tx = word == b"Tx",
                b'd' if word == b"-" && matches!(kind, b"ER" | b"ST" | b"EC") => {}
                // A status line of some versions has nothing in these columns.
                b'd' if self.has_types && matches!(kind, b"ST" | b"EC" | b"EV") => return Ok(None),
                b'd' if self.has_types => return Err(FieldFault::Column),
                // Warnings and errors of version 1.
                b'd' if word == b"Warng" => is_warning = true,
                b'd' if word == b"Error" => is_error = true,
                b'd' => return Err(FieldFault::Kind),
                // Without an identifier, version 2.0 has no length, and the first byte stands here.
                b'l' | b'L' if id.is_none() && word.len() == 2 => continue,
                b'l' | b'L' => (length, is_dlc) = (Some(word), column == b'L'),
                _ => {}
            }
            rest = after;
        }
        let time = self.time(time)?;
        let interface = channel_name(bus);
        let (is_fd, flags) = match kind {
            b"DT" | b"RR" => (false, 0),
            b"FD" => (true, 0),
            b"FB" => (true, BIT_RATE_SWITCH),
            b"FE" => (true, ERROR_STATE),
            b"BI" => (true, BIT_RATE_SWITCH | ERROR_STATE),
            b"ER" => {
                let mut frame = error_frame(None, rest);
                frame.is_tx = is_tx;
                return Ok(Some(LogEntry { time, interface, frame }));
            }
            b"ST" | b"EC" => {
                let frame = if kind == b"ST" { status(rest)? } else { counters(rest)? };
                return Ok(frame.map(|frame| LogEntry { time, interface, frame }));
            }
            b"EV" => return Ok(None),
            _ => return Err(FieldFault::Kind),
        };
        let id = id.ok_or(FieldFault::Id)?;
        // A status line of version 1.
        if is_warning || id == b"FFFFFFFF" && !self.has_types {
            return Ok(status(rest)?.map(|frame| LogEntry { time, interface, frame }));
        }
        // Version 1.0 names an error frame before its bytes.
        let named = rest.trim_ascii_start().strip_prefix(b"ERROR").filter(|_| !self.has_types);
        if is_error || named.is_some() {
            let kind = number(id, 16).and_then(|kind| u8::try_from(kind).ok()).unwrap_or(0);
            let frame = error_frame(Some(kind), named.unwrap_or(rest));
            return Ok(Some(LogEntry { time, interface, frame }));
        }
        let id = can_id(number(id, 16), id.len() > 4)?;
        let length = number(length.unwrap_or_default(), 10).ok_or(FieldFault::Length)?;
        let len = match (is_dlc, is_fd) {
            (true, _) => len_of_dlc(length, is_fd)?,
            // Some writers give the DLC of a classic frame.
            (false, false) => len_of_dlc(length, false)?,
            (false, true) => length as usize,
        };
        let mut frame = if kind == b"RR" || starts(rest.trim_ascii_start(), b"RTR") {
            Frame::remote(id, len)
        } else {
            let mut data = [0; Frame::MAX_DATA];
            let data = data.get_mut(..len).ok_or(FieldFault::Length)?;
            bytes(rest, 16, data)?;
            data_frame(id, data, is_fd.then_some(flags))?
        };
        if !is_fd {
            frame = with_dlc(frame, length);
        }
        frame.is_tx = is_tx;
        Ok(Some(LogEntry { time, interface, frame }))
    }

    /// Returns the time of a message, given the microseconds since the start.
    fn time(&self, since_start: Option<u64>) -> Result<LogTime, FieldFault> {
        let time = self.start.checked_add(since_start.ok_or(FieldFault::Time)?);
        time.map(LogTime::from_micros).ok_or(FieldFault::TimeRange)
    }
}

/// Bits of the status of PEAK's hardware (`PCAN_ERROR_…` of PCAN-Basic).
const ANY_WARNING: u32 = 0x0C;
const WARNING: u32 = 0x08;
const BUS_OFF: u32 = 0x10;
const BUS_PASSIVE: u32 = 0x4_0000;

/// Reads the bytes of a status line; `None` if they are no state of the controller.
fn status(bytes_of_line: &[u8]) -> Result<Option<Frame>, FieldFault> {
    let mut word = [0; 4];
    bytes(bytes_of_line, 16, &mut word)?;
    let word = u32::from_be_bytes(word);
    let state = match word {
        0 => ReportedState::ErrorActive,
        _ if word & BUS_OFF != 0 => ReportedState::BusOff,
        _ if word & BUS_PASSIVE != 0 => ReportedState::ErrorPassive,
        _ if word & ANY_WARNING != 0 => ReportedState::ErrorWarning,
        _ => return Ok(None),
    };
    let frame = ControllerReport { state: Some(state), counters: None }.frame();
    // What else is wrong, such as a buffer that is full.
    let has_more = word & !(ANY_WARNING | BUS_OFF | BUS_PASSIVE) != 0;
    Ok(frame.map(|frame| if has_more { frame.as_changed() } else { frame }))
}

/// Writes the bytes of a status line, or of one with the error counters alone.
fn write_report(out: &mut Vec<u8>, report: ControllerReport) -> io::Result<()> {
    let word = match report.state {
        Some(ReportedState::ErrorActive) => 0,
        Some(ReportedState::ErrorWarning) => WARNING,
        Some(ReportedState::ErrorPassive) => BUS_PASSIVE,
        Some(ReportedState::BusOff) => BUS_OFF,
        None => {
            let [sent, received] = report.counters.unwrap_or_default();
            return writeln!(out, "  2    {received:02X} {sent:02X}");
        }
    };
    write!(out, "  4   ")?;
    word.to_be_bytes().iter().try_for_each(|byte| write!(out, " {byte:02X}"))?;
    writeln!(out)
}

/// Reads the bytes of a line with the error counters, for receiving and for sending.
fn counters(bytes_of_line: &[u8]) -> Result<Option<Frame>, FieldFault> {
    let mut counters = [0; 2];
    bytes(bytes_of_line, 16, &mut counters)?;
    let [received, sent] = counters;
    Ok(ControllerReport { state: None, counters: Some([sent, received]) }.frame())
}

/// Reads the bytes of an error frame: the type of the error, unless version 1 has it in place of the
/// identifier, the direction, the place in the frame, and the error counters.
fn error_frame(kind: Option<u8>, bytes_of_line: &[u8]) -> Frame {
    let mut data = [kind.unwrap_or(0), 0, 0, 0, 0];
    // Some writers leave the counters out.
    let (mut line, mut end) = (bytes_of_line, usize::from(kind.is_some()));
    for byte in data[end..].chunks_mut(1) {
        let Ok(rest) = bytes(line, 16, byte) else { break };
        (line, end) = (rest, end + 1);
    }
    if end < 3 {
        return bus_error();
    }
    let [kind, direction, place, received, sent] = data;
    let kind = match kind {
        0x01 => 0,
        0x02 => 1,
        0x04 => 2,
        _ => 3,
    };
    let direction = if direction == 0 { 0 } else { 0x20 };
    captured_with_counters(kind << 6 | direction | place & 0x1F, sent, received)
}

/// Writes a trace of version 2.1.
#[derive(Debug)]
pub(super) struct TrcEncoder {
    channels: ChannelNumbers,
    /// Date of the first frame, in microseconds since 1970, and the number of frames so far.
    start: Option<u64>,
    messages: u64,
    loss: LogLoss,
}

impl TrcEncoder {
    pub fn new() -> Self {
        Self {
            channels: ChannelNumbers::new(1),
            start: None,
            messages: 0,
            loss: LogLoss::default(),
        }
    }

    fn write_head(out: &mut Vec<u8>, start: u64) -> io::Result<()> {
        let (days, at) = (trc_days(start), local_time(start));
        let at = at.strftime("%d.%m.%Y %H:%M:%S.%3f");
        write!(out, ";$FILEVERSION=2.1\n;$STARTTIME={days}\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n")?;
        write!(out, ";   Start time: {at}\n;   Generated by descan\n")?;
        writeln!(out, ";   Message, offset in ms, type, bus, id, direction, reserved, DLC, data\n;")
    }
}

/// Returns the type of a data frame.
fn type_of(frame: &Frame) -> &'static str {
    match (frame.kind, frame.is_fd, frame.bit_rate_switch, frame.error_state) {
        (FrameKind::Error, ..) => "ER",
        (FrameKind::Remote, ..) => "RR",
        (FrameKind::Data, false, ..) => "DT",
        (FrameKind::Data, true, false, false) => "FD",
        (FrameKind::Data, true, true, false) => "FB",
        (FrameKind::Data, true, false, true) => "FE",
        (FrameKind::Data, true, true, true) => "BI",
    }
}

impl LogEncoder for TrcEncoder {
    fn begin(&mut self, _: &mut Vec<u8>) -> io::Result<()> {
        Ok(())
    }

    fn write(&mut self, entry: LogEntry<'_>, max_len: u64, out: &mut Vec<u8>) -> io::Result<bool> {
        let before = out.len();
        let report = ControllerReport::of(&entry.frame);
        if report.is_none() && !is_on_bus(&entry.frame) {
            self.loss.error_frames += 1;
            return Ok(true);
        }
        let unix_micros = entry.time.micros;
        let start = if let Some(start) = self.start {
            start
        } else {
            let start = unix_micros.min(LAST_START);
            Self::write_head(out, start)?;
            self.loss.is_in_repeated_hour = is_in_repeated_hour(start);
            *self.start.insert(start)
        };
        self.loss.other_times += u64::from(unix_micros < start);
        self.loss.finer_times += u64::from(entry.time.nanos > 0);
        let since_start = unix_micros.saturating_sub(start);
        let is_whole = match report {
            Some(it) => it.is_all_of(&entry.frame) && (it.state.is_none() || it.counters.is_none()),
            None => is_whole_error(&entry.frame),
        };
        self.loss.error_details += u64::from(!is_whole);
        self.messages += 1;
        let (frame, channel) = (entry.frame, self.channels.number(entry.interface));
        let id = match (frame.kind, frame.id) {
            (FrameKind::Error, _) => "-".to_owned(),
            (_, CanId::Standard(id)) => format!("{id:04X}"),
            (_, CanId::Extended(id)) => format!("{id:08X}"),
        };
        let direction = if frame.is_tx { "Tx" } else { "Rx" };
        let (millis, micros) = (since_start / 1000, since_start % 1000);
        let number = self.messages;
        let kind = match report {
            Some(ControllerReport { state: Some(_), .. }) => "ST",
            Some(_) => "EC",
            None => type_of(&frame),
        };
        write!(
            out,
            "{number:>7} {millis:>9}.{micros:03} {kind} {channel:>2} {id:>9} {direction} -"
        )?;
        if let Some(report) = report {
            write_report(out, report)?;
        } else if frame.kind == FrameKind::Error {
            write_error(out, &frame)?;
        } else {
            write!(out, "  {:<2}  ", frame.dlc())?;
            write_bytes(out, frame.data())?;
            writeln!(out)?;
        }
        let fits = (out.len() - before) as u64 <= max_len;
        if !fits {
            out.truncate(before);
        }
        Ok(fits)
    }

    fn end(&mut self, _: &[String], _: &[u64], out: &mut Vec<u8>) -> io::Result<()> {
        if self.start.is_none() { Self::write_head(out, 0) } else { Ok(()) }
    }

    fn loss(&self) -> LogLoss {
        self.channels.loss(&self.loss)
    }
}

/// Returns true for an error frame that is read from its line as it was, and for any other frame.
fn is_whole_error(frame: &Frame) -> bool {
    let [sent, received] = counters_of(frame);
    let read = || captured_with_counters(capture_of(frame.data()), sent, received);
    frame.kind != FrameKind::Error
        || frame.same_on_wire(&bus_error())
        || frame.same_on_wire(&read())
}

/// Returns the error counters of the controller, for sending and receiving.
fn counters_of(frame: &Frame) -> [u8; 2] {
    frame.data().get(6..8).map_or([0, 0], |it| [it[0], it[1]])
}

/// Writes the bytes of an error frame: see [`error_frame`].
fn write_error(out: &mut Vec<u8>, frame: &Frame) -> io::Result<()> {
    if frame.same_on_wire(&bus_error()) {
        return writeln!(out, "  0");
    }
    let code = capture_of(frame.data());
    let kind = [0x01, 0x02, 0x04, 0x08][usize::from(code >> 6)];
    let direction = u8::from(code & 0x20 != 0);
    let [sent, received] = counters_of(frame);
    writeln!(out, "  5    {kind:02X} {direction:02X} {:02X} {received:02X} {sent:02X}", code & 0x1F)
}
