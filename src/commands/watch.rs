//! `descan watch`: events as they happen, one per line: as in the timeline, or as JSON objects.
//!
//! Scripts rely on the names, types and meanings of the JSON members.

use super::gate::BusGate;
use super::headless::{self, Limits, RunInput};
use super::log::field_json;
use super::open::{self, Setup};
use super::report::{
    BusReport, DescriptorReport, FileReport, FindingReport, ServiceReport, of_bus, of_descriptor,
    of_file, of_finding, of_services,
};
use super::{EXIT_OK, Failure, output};
use crate::app::{
    App, AppEvent, AppOptions, DeviceEvent, EventLine, Filter, RowKind, Scope, clock_millis,
    event_word,
};
use crate::cli::WatchArgs;
use crate::discovery::{EventKind, Presence, ServicesNews};
use crate::finding::Finding;
use crate::frame::IdFilter;
use crate::shell::log_input::LogPace;
use crate::shell::stop::StopReason;
use crate::text::hex;
use crate::time::Instant;
use crate::wire::data_layout::DataFieldValue;
use crate::wire::id::{Address, Header, Service};
use crate::wire::node::{Mode, Uid};
use anyhow::Context;
use jiff::tz::TimeZone;
use serde::Serialize;
use serde_json::{Map, Value};
use std::ops::ControlFlow;
use unicode_width::UnicodeWidthStr;

/// Runs it.
pub fn run(watch: &WatchArgs) -> Result<u8, Failure> {
    let buses = open::buses(&watch.run.session)?;
    open::check_speed(watch.speed, &buses)?;
    let mut setup = Setup::for_buses(&watch.run.session.common, &buses)?;
    let interest = open::filter("--filter", watch.filter.as_deref(), RowKind::Event)?;
    setup.only = frames_of_interest(&interest, &setup);
    let options = AppOptions {
        time_zone: Some(TimeZone::system()),
        emit_events: true,
        event_filter: interest,
        ..AppOptions::default()
    };
    let limits = Limits {
        time: watch.run.time,
        from: watch.run.from,
        while_read: true,
        stuck: EXIT_OK,
        ..Limits::default()
    };
    let mut reported = Vec::new();
    let event_writer = EventWriter { json: watch.run.json };
    if let Some(log) = open::log(&buses, "watch", watch.run.from)? {
        let pace = watch.speed.map(LogPace::Timed);
        let input = RunInput::Log(log, pace);
        let outcome = headless::run(input, &setup, options, limits, |session| {
            event_writer.write_events(&mut session.app)?;
            headless::warn_foreign(&session.app, &mut reported);
            Ok(ControlFlow::Continue(()))
        })?;
        outcome.recording?;
    } else {
        let mut gate = BusGate::new(true);
        let input = RunInput::Buses(&buses);
        let outcome = headless::run(input, &setup, options, limits, |session| {
            // A bus that is unusable from the start is an error, without events before it.
            if gate.allows(&session.app, session.now())? {
                event_writer.write_events(&mut session.app)?;
                headless::warn_foreign(&session.app, &mut reported);
            }
            Ok(ControlFlow::Continue(()))
        })?;
        if outcome.ending != Some(StopReason::Interrupted) {
            gate.require_opened(&outcome.app)?;
        }
    }
    Ok(EXIT_OK)
}

/// Patterns of the frames that the filter needs; empty for all. An active node needs all frames,
/// and so does a recording.
fn frames_of_interest(interest: &Filter, setup: &Setup) -> Vec<IdFilter> {
    let needs_all = !setup.config.listen_only || setup.record.is_some();
    let addresses = interest.addresses().filter(|_| !needs_all).unwrap_or_default();
    let service = setup.config.profile.des_service();
    let patterns = addresses.into_iter().flat_map(|it| Header::filters_of(it, service));
    let mut only: Vec<IdFilter> = Vec::new();
    for pattern in patterns {
        if !only.contains(&pattern) {
            only.push(pattern);
        }
    }
    only
}

/// Prints events on standard output.
struct EventWriter {
    json: bool,
}

impl EventWriter {
    /// Prints the events that wait in `app`, each with its own write: a reader gets every line that
    /// a full pipe still takes. Every value is as of its event.
    fn write_events(&self, app: &mut App) -> Result<(), Failure> {
        while let Some(event) = app.poll_app_event() {
            if self.json {
                if let Some(value) = as_value(app, event) {
                    let line = serde_json::to_string(&value).context("JSON")?;
                    output::print_json(&format!("{line}\n"))?;
                }
            } else if let AppEvent::Line(line) = event {
                let time = clock_millis(app, line.time);
                output::print(&text_line(&time, &line))?;
            }
        }
        Ok(())
    }
}

// --- as text --------------------------------------------------------------------------------

/// `07:08:55.123 can0   12 FEED        identified as FEED`: the bus column if there are several. What
/// was observed of a finding stands behind its headline: an event is one line.
fn text_line(time: &str, line: &EventLine) -> String {
    /// Address, space and name, in columns.
    const SOURCE: usize = 16;
    let bus = line.bus_column.as_ref().map_or(String::new(), |bus| format!(" {bus}"));
    let space = " ".repeat(SOURCE.saturating_sub(line.source.width()));
    let why = if line.explanation.is_empty() { "" } else { ". " };
    format!("{time}{bus} {}{space} {}{why}{}\n", line.source, line.text, line.explanation)
}

// --- as JSON --------------------------------------------------------------------------------

#[derive(Serialize)]
pub(super) struct JsonEvent {
    /// Unix seconds.
    time: f64,
    event: &'static str,
    #[serde(flatten)]
    what: EventBody,
}

#[derive(Serialize)]
#[serde(untagged)]
enum EventBody {
    Device {
        bus: Option<String>,
        address: Option<u8>,
        name: Option<String>,
        #[serde(flatten)]
        more: EventDetails,
    },
    Finding {
        bus: Option<String>,
        address: Option<u8>,
        /// The name; `None` if it is about none or several.
        name: Option<String>,
        finding: FindingReport,
    },
    Bus {
        bus: BusReport,
    },
    File {
        file: FileReport,
    },
}

/// Further members of a device's event.
#[derive(Serialize)]
#[serde(untagged)]
enum EventDetails {
    Nothing {},
    Services {
        services: Vec<ServiceReport>,
        changed: bool,
        /// True if it is another list of an address that several devices use.
        other_device: bool,
    },
    Mode {
        mode: &'static str,
        /// The previous mode, if known.
        from: Option<&'static str>,
    },
    Moved {
        from: u8,
    },
    Uid {
        uid: String,
        /// The previous UID.
        from: String,
    },
    Returned {
        was: &'static str,
    },
    Descriptor {
        descriptor: Box<DescriptorReport>,
    },
    Debug {
        code: u16,
        /// Its name in the profile or in the catalogue.
        code_name: Option<String>,
        /// Hexadecimal digits.
        data: String,
        /// The parameters by name, as the catalogue describes them.
        fields: Option<Map<String, Value>>,
    },
}

/// Converts an event; `None` for what is not one for scripts.
pub(super) fn as_value(app: &App, event: AppEvent) -> Option<JsonEvent> {
    let epoch = app.epoch();
    let time = |at: Instant| epoch.unix_secs(at);
    Some(match event {
        AppEvent::Line(_) => return None,
        AppEvent::Event(event) => return of_event(app, *event),
        AppEvent::Finding(context, finding) => {
            let what = what_finding(app, context.bus, &finding);
            JsonEvent { time: time(context.time), event: "finding", what }
        }
        AppEvent::Bus(at, bus) => {
            JsonEvent { time: time(at), event: "bus", what: EventBody::Bus { bus: of_bus(*bus) } }
        }
        // Not an event for scripts; the warning is for people.
        AppEvent::TxBlocked(bus) => {
            headless::warn_tx_blocked(&bus);
            return None;
        }
        // As text it is a line of the timeline.
        AppEvent::WrongFile(text) => {
            output::warn(text);
            return None;
        }
        AppEvent::File(at, file) => {
            let what = EventBody::File { file: of_file(&file) };
            JsonEvent { time: time(at), event: "file", what }
        }
    })
}

fn of_event(app: &App, DeviceEvent { context, event, services }: DeviceEvent) -> Option<JsonEvent> {
    let word = event_word(&event.kind);
    let more = match event.kind {
        EventKind::FirstFrame
        | EventKind::NameReceived
        | EventKind::Rebooted
        | EventKind::Removed => EventDetails::Nothing {},
        EventKind::Services { news, .. } => EventDetails::Services {
            services: of_services(&services),
            changed: news == ServicesNews::Changed,
            other_device: news == ServicesNews::OtherDevice,
        },
        EventKind::Mode { from, to } => {
            EventDetails::Mode { mode: to.name(), from: from.map(Mode::name) }
        }
        EventKind::Moved { from } => EventDetails::Moved { from: from.number() },
        EventKind::UidChanged { from, to } => {
            let bus = event.device.and_then(|id| app.bus(id.bus))?;
            let text = |uid: Uid| uid.text(&bus.config().profile.uid).to_string();
            EventDetails::Uid { uid: text(to), from: text(from) }
        }
        EventKind::Presence(presence) if presence != Presence::Online => EventDetails::Nothing {},
        EventKind::Returned { was } => EventDetails::Returned { was: was.name() },
        EventKind::DescriptorRead { .. } => {
            let device = app.device(event.device?)?;
            let bus = app.bus(device.id.bus)?;
            let descriptor = Box::new(of_descriptor(&device.descriptor, app, bus));
            EventDetails::Descriptor { descriptor }
        }
        EventKind::DebugMessage { code, data } => {
            let bus = event.device?.bus;
            let types = app.shown_buses().types_at(bus, event.address, event.time);
            let code_name = types.debug_name(&app.profile(bus), Service::from_bits(code));
            let values = types.debug_values(code, &data);
            let of_field = |field: &DataFieldValue<'_>| {
                (field.name.to_owned(), field.value.as_ref().map_or(Value::Null, field_json))
            };
            let fields = (!values.is_empty()).then(|| values.iter().map(of_field).collect());
            EventDetails::Debug { code, code_name, data: hex(&data, ""), fields }
        }
        // Findings and bus states are events of their own, `returned` reports a device that is
        // online again, and the outcome of an address claim follows it.
        EventKind::Finding { .. }
        | EventKind::DescriptorField(_)
        | EventKind::RequestEnded { .. }
        | EventKind::FrameSent { .. }
        | EventKind::SequenceEnded { .. }
        | EventKind::OwnAddress(_)
        | EventKind::OwnAddressLost(_)
        | EventKind::NoAddress(_)
        | EventKind::NoAck
        | EventKind::Presence(_)
        | EventKind::Claimed { .. }
        | EventKind::GaveUpAddress { .. }
        | EventKind::IdsMerged { .. }
        | EventKind::Acknowledged => return None,
    };
    let what = EventBody::Device {
        bus: context.bus,
        address: event.address.map(Address::number),
        name: event.name.as_ref().map(ToString::to_string),
        more,
    };
    Some(JsonEvent { time: app.epoch().unix_secs(context.time), event: word, what })
}

fn what_finding(app: &App, bus: Option<String>, finding: &Finding) -> EventBody {
    let name = match &finding.names[..] {
        [only] => Some(only.to_string()),
        _ => None,
    };
    EventBody::Finding {
        bus: bus.clone(),
        address: finding.key.address.map(Address::number),
        name,
        finding: of_finding(app, bus, finding, Scope::Screen),
    }
}
