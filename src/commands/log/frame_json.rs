//! A frame of a log as a JSON object.
//!
//! Scripts rely on the names, types and meanings of the members. Written without a serializer: the same
//! bytes, in a fraction of the time. Does not know which frames are printed.

use super::frame_text::push_number;
use super::known_names::KnownNames;
use crate::app::{App, Bus, CallPart, FrameMeaning, FrameRole};
use crate::dbc::NamedMessage;
use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::text::{Escaped, hex, push_hex};
use crate::time::Instant;
use crate::wire::data_layout::{DataFieldValue, DataValue, FLOAT_DIGITS};
use crate::wire::id::{Address, Service};
use serde::Serialize;
use serde_json::Value;

/// Unix times in microseconds of which the shortest decimal number that is read as the same
/// floating-point number has these six digits, without zeros at the end: from 1 s on, as before there
/// is an exponent, and
/// below 2³² s, where neighbouring numbers are less than 0.5 µs apart.
const EXACT_MICROS: std::ops::Range<u64> = 1_000_000..(1 << 32) * 1_000_000;

/// Writes frames as JSON objects.
#[derive(Debug, Default)]
pub struct FrameJson {
    names: KnownNames,
}

impl FrameJson {
    /// Appends a frame; `part` is what it is in a call. What is not known is `null`.
    ///
    /// Members: `time` (Unix seconds), `bus`, `id` (3 or 8 hexadecimal digits; `null` for an error
    /// frame), `extended`, `fd`, `kind` (as in a filter behind `type:`), `from`, `to` (`null` for a
    /// broadcast, too), `from_name`, `to_name`, `service`, `service_name`, `len`, `data` (hexadecimal
    /// digits), `text`, `fields` (by name, as the catalogue describes them), `message` and `signals` (by name, as
    /// a DBC file describes them), `failed` (a response with ERR = 0), `error`, `tx`; of a response `request`
    /// (Unix seconds), `latency_ms` and `ambiguous` (several equal requests were open).
    pub fn write(&mut self, line: &mut String, app: &App, frame: &Frame, part: Option<CallPart>) {
        let FrameMeaning { header, role, text, is_error } = FrameMeaning::of(app, frame);
        line.push_str("{\"time\":");
        push_seconds(line, app.epoch().unix_micros(frame.time));
        line.push_str(",\"bus\":");
        push_text(line, app.bus(frame.bus).map(Bus::name_without_rates));
        line.push_str(",\"id\":");
        push_id(line, frame);
        let is_extended = matches!(frame.id, CanId::Extended(_)) && frame.kind != FrameKind::Error;
        push_flag(line, ",\"extended\":", is_extended);
        push_flag(line, ",\"fd\":", frame.is_fd);
        line.push_str(",\"kind\":\"");
        line.push_str(role.type_word());
        let receiver = header.filter(|header| !header.broadcast).map(|header| header.destination);
        let sender = header.map(|header| header.source);
        line.push_str("\",\"from\":");
        push_optional_number(line, sender.map(|it| it.number().into()));
        line.push_str(",\"to\":");
        push_optional_number(line, receiver.map(|it| it.number().into()));
        for (member, address) in [(",\"from_name\":", sender), (",\"to_name\":", receiver)] {
            line.push_str(member);
            line.push_str(match address {
                Some(address) => &self.names.end(app, frame.bus, address, frame.time).json_name,
                None => "null",
            });
        }
        line.push_str(",\"service\":");
        push_optional_number(line, header.map(|header| header.service.number().into()));
        line.push_str(",\"service_name\":");
        line.push_str(match header {
            Some(header) => &self.names.service(app, frame, header, role).json_name,
            None => "null",
        });
        line.push_str(",\"len\":");
        push_number(line, frame.len() as u64, 1);
        line.push_str(",\"data\":\"");
        push_hex(line, frame.data(), "");
        line.push_str("\",\"text\":");
        push_text(line, Some(&*text).filter(|text| !text.is_empty()));
        line.push_str(",\"fields\":");
        let types = app.shown_buses().frame_types(header, frame);
        match header {
            // The data of an error response are its code.
            Some(header) if role != FrameRole::FailedResponse => {
                push_fields(line, &types.data_values(header, frame.data()));
            }
            _ => line.push_str("null"),
        }
        line.push_str(",\"message\":");
        push_text(line, types.message().map(NamedMessage::name));
        line.push_str(",\"signals\":");
        match types.message().map(|message| message.values(frame.data())) {
            Some(signals) if signals.is_empty() => line.push_str("{}"),
            signals => push_fields(line, &signals.unwrap_or_default()),
        }
        push_flag(line, ",\"failed\":", role == FrameRole::FailedResponse);
        push_flag(line, ",\"error\":", is_error);
        push_flag(line, ",\"tx\":", frame.is_tx);
        if let Some(CallPart::Response { latency, is_ambiguous, .. }) = part {
            line.push_str(",\"request\":");
            push_seconds(line, app.epoch().unix_micros(frame.time - latency));
            line.push_str(",\"latency_ms\":");
            push_serialized(line, latency.as_micros() as f64 / 1e3);
            push_flag(line, ",\"ambiguous\":", is_ambiguous);
        } else {
            line.push_str(",\"request\":null,\"latency_ms\":null,\"ambiguous\":null");
        }
        line.push_str("}\n");
    }
}

/// Appends a Unix time in seconds, as the floating-point number that it is to a reader.
fn push_seconds(line: &mut String, unix_micros: u64) {
    if !EXACT_MICROS.contains(&unix_micros) {
        return push_serialized(line, unix_micros as f64 / 1e6);
    }
    push_number(line, unix_micros / 1_000_000, 1);
    line.push('.');
    let (mut fraction, mut digits) = (unix_micros % 1_000_000, 6);
    // One digit stays.
    while digits > 1 && fraction % 10 == 0 {
        (fraction, digits) = (fraction / 10, digits - 1);
    }
    push_number(line, fraction, digits);
}

fn push_id(line: &mut String, frame: &Frame) {
    match (frame.kind, frame.id) {
        (FrameKind::Error, _) => line.push_str("null"),
        (_, CanId::Extended(id)) => {
            line.push('"');
            push_hex(line, &id.to_be_bytes(), "");
            line.push('"');
        }
        (_, id @ CanId::Standard(_)) => push_serialized(line, id.to_string()),
    }
}

fn push_optional_number(line: &mut String, number: Option<u64>) {
    match number {
        Some(number) => push_number(line, number, 1),
        None => line.push_str("null"),
    }
}

fn push_flag(line: &mut String, member: &str, is_set: bool) {
    line.push_str(member);
    line.push_str(if is_set { "true" } else { "false" });
}

fn push_text(line: &mut String, text: Option<&str>) {
    let is_plain = |byte: u8| (0x20..0x7F).contains(&byte) && byte != b'"' && byte != b'\\';
    match text {
        Some(text) if text.bytes().all(is_plain) => {
            line.push('"');
            line.push_str(text);
            line.push('"');
        }
        Some(text) => push_serialized(line, text),
        None => line.push_str("null"),
    }
}

/// Appends the fields of the data as an object; `null` where the catalogue has none.
fn push_fields(line: &mut String, values: &[DataFieldValue<'_>]) {
    if values.is_empty() {
        return line.push_str("null");
    }
    for (at, field) in values.iter().enumerate() {
        line.push(if at == 0 { '{' } else { ',' });
        push_text(line, Some(field.name));
        line.push(':');
        match &field.value {
            Some(value) => push_serialized(line, field_json(value)),
            None => line.push_str("null"),
        }
    }
    line.push('}');
}

/// Returns a value of a field as JSON: a number, a truth value or a text; `null` for a number that JSON
/// has not.
pub fn field_json(value: &DataValue<'_>) -> Value {
    match value {
        DataValue::Integer(number) => u64::try_from(*number)
            .map(Value::from)
            .or_else(|_| i64::try_from(*number).map(Value::from))
            .unwrap_or_else(|_| Value::from(*number as f64)),
        // The shortest number that is the same one in the 32 bits that it has.
        DataValue::Float(number, FLOAT_DIGITS)
            if f64::from(*number as f32).to_bits() == number.to_bits() =>
        {
            (*number as f32).to_string().parse::<f64>().map_or(Value::Null, Value::from)
        }
        DataValue::Float(number, digits) if *digits > FLOAT_DIGITS => Value::from(*number),
        DataValue::Scaled(..) | DataValue::Decimal(..) | DataValue::Float(..) => {
            value.to_string().parse::<f64>().map_or(Value::Null, Value::from)
        }
        DataValue::Bool(is_set) => Value::from(*is_set),
        DataValue::Named(name) => Value::from(*name),
        DataValue::Text(text) => Value::from(Escaped(text).to_string()),
        DataValue::Bytes(bytes) => Value::from(hex(bytes, "")),
    }
}

fn push_serialized(line: &mut String, value: impl Serialize) {
    // Numbers and strings have no errors.
    line.push_str(&serde_json::to_string(&value).unwrap_or_default());
}

/// Returns the name of the device that had an address at a moment; `None` if it is not known.
pub fn name_of(app: &App, bus: BusIndex, address: Address, time: Instant) -> Option<String> {
    Some(app.bus(bus)?.names().at(address, time)?.to_string())
}

/// Returns the name of a service in the profile or in the catalogue; `None` if it has none there.
/// `server`: the device that has it, and the moment.
pub fn service_name_of(
    app: &App,
    bus: BusIndex,
    service: Service,
    server: Option<(Address, Instant)>,
) -> Option<String> {
    let name = app.shown_buses().service_name(bus, service, server)?;
    Some(Escaped(name.as_bytes()).to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_serializer() {
        let mut rng = fastrand::Rng::with_seed(3);
        let edges = [EXACT_MICROS.start, EXACT_MICROS.end - 1, EXACT_MICROS.end, 0, 1, 999_999];
        let random = std::iter::repeat_with(|| {
            let micros = rng.u64(..) >> rng.u32(0..64);
            micros - micros % 10_u64.pow(rng.u32(0..8))
        });
        for micros in edges.into_iter().chain(random.take(1_000_000)) {
            let mut line = String::new();
            push_seconds(&mut line, micros);
            assert_eq!(line, serde_json::to_string(&(micros as f64 / 1e6)).unwrap());
        }
    }
}
