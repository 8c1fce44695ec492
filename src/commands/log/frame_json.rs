//! A frame of a log as a JSON object.
//!
//! Scripts rely on the names, types and meanings of the members. Does not know which frames are
//! printed.

use crate::app::{App, Bus, CallPart, Decoded, FrameRole};
use crate::frame::{BusIndex, CanId, Frame, FrameKind};
use crate::text::{Escaped, hex};
use crate::time::Instant;
use crate::wire::id::{Address, Service};
use serde::Serialize;

/// A frame. What is not known is `None`.
#[derive(Debug, Serialize)]
pub struct FrameReport<'a> {
    /// Unix seconds.
    time: f64,
    bus: Option<&'a str>,
    /// Hexadecimal digits, 3 or 8; `None` for an error frame.
    id: Option<String>,
    extended: bool,
    fd: bool,
    /// As in a filter behind `type:`.
    kind: &'static str,
    from: Option<u8>,
    /// `None` for a broadcast, too.
    to: Option<u8>,
    from_name: Option<String>,
    to_name: Option<String>,
    service: Option<u16>,
    service_name: Option<String>,
    len: usize,
    /// Hexadecimal digits.
    data: String,
    text: Option<String>,
    /// True for a response with ERR = 0.
    failed: bool,
    error: bool,
    tx: bool,
    /// Of a response: Unix seconds of its request.
    request: Option<f64>,
    latency_ms: Option<f64>,
    /// Of a response: true if several equal requests were open.
    ambiguous: Option<bool>,
}

impl<'a> FrameReport<'a> {
    /// Returns the report of a frame; `part` is what it is in a call.
    pub fn new(app: &'a App, frame: &Frame, part: Option<CallPart>) -> Self {
        let decoded = Decoded::of(app, frame);
        let header = decoded.header;
        let name = |address: Address| name_of(app, frame.bus, address, frame.time);
        let receiver = header.filter(|header| !header.broadcast).map(|header| header.destination);
        let service = header.filter(|_| decoded.role != FrameRole::Debug).map(|it| it.service);
        let response = match part {
            Some(CallPart::Response { latency, is_ambiguous, .. }) => Some((latency, is_ambiguous)),
            _ => None,
        };
        let time = app.epoch().unix_secs(frame.time);
        let sent_at = |latency| app.epoch().unix_secs(frame.time - latency);
        Self {
            time,
            bus: app.bus(frame.bus).map(Bus::name_without_rates),
            id: (frame.kind != FrameKind::Error).then(|| frame.id.to_string()),
            extended: matches!(frame.id, CanId::Extended(_)) && frame.kind != FrameKind::Error,
            fd: frame.is_fd,
            kind: decoded.role.type_word(),
            from: header.map(|header| header.source.number()),
            to: receiver.map(Address::number),
            from_name: header.and_then(|header| name(header.source)),
            to_name: receiver.and_then(name),
            service: header.map(|header| header.service.number()),
            service_name: service.and_then(|service| service_name_of(app, frame.bus, service)),
            len: frame.len(),
            data: hex(frame.data(), ""),
            text: Some(decoded.text).filter(|text| !text.is_empty()),
            failed: decoded.role == FrameRole::FailedResponse,
            error: decoded.is_error,
            tx: frame.is_tx,
            request: response.map(|(latency, _)| sent_at(latency)),
            latency_ms: response.map(|(latency, _)| latency.as_micros() as f64 / 1e3),
            ambiguous: response.map(|(_, is_ambiguous)| is_ambiguous),
        }
    }
}

/// Returns the name of the device that had an address at a moment; `None` if it is not known.
pub fn name_of(app: &App, bus: BusIndex, address: Address, time: Instant) -> Option<String> {
    Some(app.bus(bus)?.names().at(address, time)?.to_string())
}

/// Returns the name of a service in the profile; `None` if it has none there.
pub fn service_name_of(app: &App, bus: BusIndex, service: Service) -> Option<String> {
    let name = app.bus(bus)?.config().profile.service_name(service)?;
    Some(Escaped(name.as_bytes()).to_string())
}
