//! Report of `scan` and `check`, as JSON or as tables. `watch` uses parts of it.
//!
//! Scripts rely on the names, types and meanings in the JSON. Unknown values are null.

use super::{Failure, output};
use crate::app::{
    App, Bus, BusSnapshot, Decoded, FileIndex, FileSnapshot, Problem, Redundancy, RedundantDevice,
    Scope, format_time_of_day,
};
use crate::bitrate::kbit;
use crate::catalogue::TypeBasis;
use crate::discovery::{
    DebugCount, Device, DeviceDescriptor, DeviceService, FieldContent, OwnAddress,
};
use crate::finding::{
    Evidence, ExitCodeScope, Finding, FindingKey, FindingKind, FindingState, SeenUid,
};
use crate::frame::{BusIndex, Frame};
use crate::status::Link;
use crate::text::{Name, counted, hex, printable_path};
use crate::time::{Duration, Instant};
use crate::wire::descriptor::{AddressSetting, DescriptorValue};
use crate::wire::id::Address;
use crate::wire::profile::ValueWithOrigin;
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::iter::once;

/// The report.
#[derive(Debug, Serialize)]
pub struct ScanReport {
    descan: &'static str,
    pub(super) buses: Vec<ScannedBusReport>,
    pub(super) devices: Vec<DeviceReport>,
    pub(super) findings: Vec<FindingReport>,
    pub(super) file: FileReport,
    /// All des.json files, where buses of a project have their own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) files: Vec<BusFileReport>,
    #[serde(skip)]
    problems: Vec<ProblemReport>,
}

#[derive(Debug, Serialize)]
pub(super) struct BusReport {
    pub name: String,
    bitrate: Option<u32>,
    state: &'static str,
    frames: u64,
    errors: u64,
    lost: u64,
    load: Option<f64>,
    address: Option<u8>,
    lost_where: LostReport,
    not_sent: u64,
    /// Messages of an adapter or a server that could not be decoded.
    unreadable: u64,
    verdict: &'static str,
}

/// A bus, with the profile by which its frames were read.
#[derive(Debug, Serialize)]
pub(super) struct ScannedBusReport {
    #[serde(flatten)]
    pub bus: BusReport,
    profile: BTreeMap<&'static str, ValueWithOrigin>,
}

/// Lost frames by place; the sum is `lost`.
#[derive(Debug, Serialize)]
struct LostReport {
    kernel: u64,
    queue: u64,
    adapter: u64,
}

#[derive(Debug, Serialize)]
pub(super) struct DeviceReport {
    pub bus: String,
    pub address: u8,
    name: Option<String>,
    name_hex: Option<String>,
    pub presence: &'static str,
    mode: Option<&'static str>,
    working: bool,
    uid: Option<String>,
    framing: Option<String>,
    services: Vec<ServiceReport>,
    services_known: bool,
    /// True if the list is that of one of several devices at the address.
    services_shared: bool,
    /// Other lists from the address, each of one of the devices there.
    other_services: Vec<Vec<ServiceReport>>,
    heartbeat: HeartbeatReport,
    descriptor: DescriptorReport,
    debug: DebugReport,
    /// `null` if the catalogue has none for it.
    #[serde(rename = "type")]
    device_type: Option<DeviceTypeReport>,
    file: EntryReport,
    also: Vec<SiblingReport>,
    quirks: Vec<&'static str>,
    /// UIDs of all devices at its address, if several conflict there.
    #[serde(skip)]
    conflict_uids: Vec<String>,
    #[serde(skip)]
    clash: bool,
}

impl DeviceReport {
    /// The UID, or those of all devices in conflict at the address, since the frames do not tell
    /// whose the row is.
    fn uid_cell(&self) -> String {
        if self.clash && self.conflict_uids.len() > 1 {
            return self.conflict_uids.join(" / ");
        }
        self.uid.clone().unwrap_or_else(|| "?".to_owned())
    }

    /// The services with their versions; in a conflict all lists received.
    fn services_cell(&self) -> String {
        if !self.services_known {
            return "?".to_owned();
        }
        let text = |list: &Vec<ServiceReport>| {
            let service = |service: &ServiceReport| {
                format!("{} {}", service.name, service.version).trim_end().to_owned()
            };
            list.iter().map(service).collect::<Vec<_>>().join(", ")
        };
        let lists: Vec<String> =
            std::iter::once(&self.services).chain(&self.other_services).map(text).collect();
        let whose = if self.clash && lists.len() == 1 { " (of one of them)" } else { "" };
        lists.join(" / ") + whose
    }
}

/// The same device on another bus.
#[derive(Debug, Serialize)]
struct SiblingReport {
    bus: String,
    address: u8,
    /// True if its services are the same there; null unless both are known.
    redundant: Option<bool>,
    #[serde(skip)]
    kinship: Redundancy,
}

#[derive(Debug, Serialize)]
pub(super) struct ServiceReport {
    index: u8,
    name: String,
    version: String,
    extra: Vec<String>,
}

#[derive(Debug, Serialize)]
struct HeartbeatReport {
    count: u64,
    period_ms: Option<f64>,
    jitter_ms: Option<f64>,
    missed: u64,
    period_error_ppm: Option<f64>,
    period_uncertainty_ppm: Option<f64>,
}

#[derive(Debug, Serialize)]
struct EntryReport {
    listed: bool,
    address: Option<u8>,
    #[serde(rename = "static")]
    is_static: Option<bool>,
    agrees: Option<bool>,
}

#[derive(Debug, Serialize)]
pub(super) struct FindingReport {
    pub kind: &'static str,
    pub confidence: &'static str,
    pub bus: Option<String>,
    pub address: Option<u8>,
    addresses: Vec<u8>,
    names: Vec<String>,
    uids: Vec<String>,
    first: f64,
    last: f64,
    pub cleared_at: Option<f64>,
    /// Kind of the finding that replaced it, if that is why it was cleared.
    superseded_by: Option<&'static str>,
    evidence: Vec<EvidenceReport>,
    text: String,
    remedy: String,
    #[serde(skip)]
    counts: bool,
    #[serde(skip)]
    pub key: FindingKey,
}

/// A problem of the screen, for tables.
#[derive(Debug)]
struct ProblemReport {
    confidence: &'static str,
    headline: String,
    /// Times of its begin and of its end, as on the screen.
    times: String,
    keys: Vec<FindingKey>,
    remedy: String,
}

#[derive(Debug, Serialize)]
struct EvidenceReport {
    time: f64,
    what: String,
    /// Address of the sender; null for a frame of another protocol.
    from: Option<u8>,
    /// Address of the receiver; null for a broadcast too.
    to: Option<u8>,
    /// Content of the frame as text.
    meaning: Option<String>,
    frame: Option<String>,
}

#[derive(Debug, Serialize)]
pub(super) struct FileReport {
    pub path: String,
    ok: Option<bool>,
    entries: Option<usize>,
    error: Option<String>,
    /// The error for tables: with the path, and the faulty line below.
    #[serde(skip)]
    pub problem: Option<String>,
}

/// A des.json, with the buses that have it.
#[derive(Debug, Serialize)]
pub(super) struct BusFileReport {
    #[serde(flatten)]
    file: FileReport,
    buses: Vec<String>,
}

impl ScanReport {
    /// Creates the report of the state at `now`. `scope` selects the findings and the differences
    /// from the file; bus load is the average of the session.
    pub fn new(app: &App, now: Instant, scope: Scope) -> Self {
        let mut devices: Vec<DeviceReport> = app
            .buses()
            .iter()
            .flat_map(|bus| bus.devices().iter().map(|device| of_device(app, bus, device)))
            .collect();
        devices.sort_by(|a, b| (&a.bus, a.address, &a.name).cmp(&(&b.bus, b.address, &b.name)));
        let compared = if scope == Scope::Check { app.compare(now, scope) } else { Vec::new() };
        let mut findings: Vec<&Finding> = match scope {
            Scope::Screen => app.findings().collect(),
            Scope::Check => {
                let engines = app.buses().iter().flat_map(Bus::findings);
                engines.chain(&compared).collect()
            }
        };
        // By time; findings of the same time by state and severity.
        findings.sort_by_key(|finding| {
            let state = Reverse(finding.state);
            let severity = Reverse(finding.key.kind.severity());
            (finding.first, state, severity, finding.key.clone())
        });
        let findings = findings.iter().map(|it| {
            let bus = it.key.bus.and_then(|index| app.bus(index)).map(|bus| bus.name.clone());
            of_finding(app, bus, it, scope)
        });
        let findings = findings.collect();
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            buses: (0..=u8::MAX)
                .map_while(|at| app.bus_snapshot(BusIndex(at), now))
                .map(|bus| of_scanned_bus(app, bus))
                .collect(),
            devices,
            findings,
            file: of_file(&app.file_snapshot(FileIndex::default())),
            files: of_files(app),
            problems: of_problems(app),
        }
    }

    /// Returns true if a finding that counts for the exit code is confirmed.
    pub fn has_findings(&self) -> bool {
        self.findings.iter().any(|finding| finding.counts)
    }

    /// Prints the report on standard output, as JSON or as `text`.
    pub fn print(&self, as_json: bool, text: impl FnOnce(&Self) -> String) -> Result<(), Failure> {
        if as_json { output::print_json(&self.json()) } else { output::print(&text(self)) }
    }

    /// Returns indented JSON.
    pub fn json(&self) -> String {
        serde_json::to_string_pretty(self).expect("plain values are always JSON") + "\n"
    }

    /// Returns tables as text.
    pub fn tables(&self) -> String {
        let mut text = String::new();
        for ScannedBusReport { bus, .. } in &self.buses {
            let rate = bus.bitrate.map_or("bit rate unknown".to_owned(), kbit);
            // Virtual interfaces and logs do not report a controller state.
            let state = match bus.state {
                "unknown" => String::new(),
                state => format!("{state}, "),
            };
            let load =
                bus.load.map_or(String::new(), |load| format!("load {:.0} %, ", load * 100.0));
            let (frames, errors) = (counted(bus.frames, "frame"), counted(bus.errors, "error"));
            let unreadable = match bus.unreadable {
                0 => String::new(),
                count => format!(", {} unreadable", counted(count, "message")),
            };
            let _ = writeln!(
                text,
                "{}: {rate}, {state}{frames}, {load}{errors}, {} lost{unreadable}",
                bus.name, bus.lost
            );
        }
        text.push('\n');
        text.push_str(&self.device_table());
        text.push_str(&self.on_several_buses());
        for problem in &self.problems {
            self.write_problem(problem, &mut text);
        }
        let further = self.files.iter().skip(1).map(|it| &it.file);
        for problem in once(&self.file).chain(further).filter_map(|file| file.problem.as_ref()) {
            let _ = writeln!(text, "\n{problem}");
        }
        text
    }

    /// Writes a problem: the headline of the screen, then its findings.
    fn write_problem(&self, problem: &ProblemReport, text: &mut String) {
        let findings = self.findings.iter().filter(|it| problem.keys.contains(&it.key));
        let findings: Vec<_> = findings.filter(|it| it.superseded_by.is_none()).collect();
        if findings.is_empty() {
            return;
        }
        let _ = writeln!(text, "\n{} {}", problem.confidence, problem.headline);
        for finding in &findings {
            let bus = finding.bus.as_ref().filter(|_| self.buses.len() > 1);
            let bus = bus.map(|bus| format!(" on {bus}")).unwrap_or_default();
            let (confidence, kind) = (finding.confidence, finding.kind);
            let _ = writeln!(text, "  {confidence} {kind}{bus}, {}", problem.times);
            if finding.text.strip_suffix('.').unwrap_or(&finding.text) != problem.headline {
                let _ = writeln!(text, "  {}", finding.text);
            }
        }
        if FindingState::Cleared.name() == problem.confidence {
            text.push_str("  No longer present.\n");
        } else if !problem.remedy.is_empty() {
            let _ = writeln!(text, "  {}", problem.remedy);
        }
    }

    /// Returns a line for each device that is on two buses.
    fn on_several_buses(&self) -> String {
        let mut text = String::new();
        for device in &self.devices {
            for other in device.also.iter().filter(|other| other.bus > device.bus) {
                let _ = writeln!(
                    text,
                    "{} is on {} @{} and {} @{}, {}",
                    device.name.as_deref().unwrap_or("?"),
                    device.bus,
                    device.address,
                    other.bus,
                    other.address,
                    other.kinship.words()
                );
            }
        }
        if text.is_empty() { text } else { format!("\n{text}") }
    }

    fn device_table(&self) -> String {
        if self.devices.is_empty() {
            return "no devices\n".to_owned();
        }
        let several = self.buses.len() > 1;
        let mut rows =
            vec![["BUS", "ADDR", "NAME", "STATE", "MODE", "UID", "SERVICES"].map(str::to_owned)];
        for device in &self.devices {
            let state = if device.clash { "CONFLICT" } else { device.presence };
            let unknown = if device.working { "working" } else { "non-working" };
            rows.push([
                device.bus.clone(),
                device.address.to_string(),
                device.name.clone().unwrap_or_else(|| "?".to_owned()),
                state.to_owned(),
                device.mode.unwrap_or(unknown).to_owned(),
                device.uid_cell(),
                device.services_cell(),
            ]);
        }
        let first = usize::from(!several);
        let width = |column: usize| {
            let cells = rows.iter().map(|row| unicode_width::UnicodeWidthStr::width(&*row[column]));
            cells.max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..7).map(width).collect();
        let mut text = String::new();
        for row in &rows {
            let mut line = String::new();
            for column in first..7 {
                let cell = &row[column];
                let space = widths[column] - unicode_width::UnicodeWidthStr::width(&**cell);
                // Numbers are right-aligned.
                if column == 1 {
                    let _ = write!(line, "{}{cell}  ", " ".repeat(space));
                } else {
                    let _ = write!(line, "{cell}{}  ", " ".repeat(space));
                }
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
        text
    }
}

pub(super) fn of_bus(bus: BusSnapshot) -> BusReport {
    // Frames written to an adapter that never responded may not have reached a bus.
    let (frames, load, address) = match bus.own_address {
        _ if bus.status.unanswered => (0, None, None),
        OwnAddress::Held(address) => (bus.counters.frames, bus.mean_load, Some(address.number())),
        _ => (bus.counters.frames, bus.mean_load, None),
    };
    BusReport {
        name: bus.name,
        bitrate: bus.status.bitrate,
        state: match bus.status.link {
            Link::Down | Link::Missing | Link::Unplugged | Link::NotCan | Link::NoKernel => "down",
            _ => bus.controller_state.name(),
        },
        frames,
        errors: bus.counters.errors,
        lost: bus.lost,
        load: load.map(|load| (load * 1000.0).round() / 1000.0),
        address,
        lost_where: LostReport {
            kernel: bus.status.kernel_drops,
            queue: bus.status.queue_drops,
            adapter: bus.status.controller_overruns,
        },
        not_sent: bus.status.transmit_failures,
        unreadable: bus.status.unreadable,
        verdict: bus.traffic.verdict().name(),
    }
}

fn of_scanned_bus(app: &App, bus: BusSnapshot) -> ScannedBusReport {
    let profile = app.bus(bus.index).map(|bus| bus.config().profile.values());
    ScannedBusReport { bus: of_bus(bus), profile: profile.unwrap_or_default() }
}

fn of_siblings(app: &App, device: &Device) -> Vec<SiblingReport> {
    let siblings = app.redundant_devices(device.id).iter();
    let of_sibling = |sibling: &RedundantDevice| {
        Some(SiblingReport {
            bus: app.bus(sibling.id.bus)?.name.clone(),
            address: app.device(sibling.id)?.address.number(),
            redundant: match sibling.relation {
                Redundancy::Redundant => Some(true),
                Redundancy::TwoNetworks => Some(false),
                Redundancy::Undetermined => None,
            },
            kinship: sibling.relation,
        })
    };
    siblings.filter_map(of_sibling).collect()
}

fn of_device(app: &App, bus: &Bus, device: &Device) -> DeviceReport {
    let millis = |duration: Duration| (duration.as_secs_f64() * 1e4).round() / 10.0;
    let alphabet = &bus.config().profile.uid;
    let services = device.services.as_deref().unwrap_or_default();
    let mut conflicts = bus.findings().iter().filter(|finding| {
        finding.state == FindingState::Confirmed
            && finding.key.kind.is_conflict()
            && crate::app::concerns(finding, device)
    });
    let clash = conflicts.clone().next().is_some();
    let at_one_address =
        conflicts.find(|finding| finding.addresses.len() == 1 && finding.uids.len() > 1);
    let error = device.heartbeat.period_error().filter(|_| !app.has_confirmed_conflict(device));
    let tenths = |ppm: f64| (ppm * 10.0).round() / 10.0;
    DeviceReport {
        bus: bus.name.clone(),
        address: device.address.number(),
        name: device.name.as_ref().map(ToString::to_string),
        name_hex: device.name.as_ref().map(Name::hex),
        presence: device.presence.name(),
        mode: device.mode.map(crate::wire::node::Mode::name),
        working: device.is_working,
        uid: device.uid.map(|uid| uid.text(alphabet).to_string()),
        framing: device.framing.map(|framing| framing.to_string()),
        services: of_services(services),
        services_known: device.services.is_some(),
        services_shared: device.services_are_shared,
        other_services: device.other_services.iter().map(|list| of_services(list)).collect(),
        heartbeat: HeartbeatReport {
            count: device.heartbeat.count,
            period_ms: device.heartbeat.period().map(millis),
            jitter_ms: device.heartbeat.jitter().map(millis),
            missed: device.heartbeat.missed,
            period_error_ppm: error.map(|error| tenths(error.ppm)),
            period_uncertainty_ppm: error.map(|error| tenths(error.uncertainty)),
        },
        descriptor: of_descriptor(&device.descriptor, app, bus),
        debug: of_debug(app, device),
        device_type: of_type(app, device),
        file: of_entry(app, device),
        also: of_siblings(app, device),
        quirks: device.deviations.iter().map(|deviation| deviation.name()).collect(),
        conflict_uids: at_one_address
            .map_or_else(Vec::new, |finding| finding.uids.iter().map(SeenUid::label).collect()),
        clash,
    }
}

/// DEBUG messages of a device.
#[derive(Debug, Serialize)]
struct DebugReport {
    count: u64,
    /// By code, at most 32.
    codes: Vec<DebugCodeReport>,
}

#[derive(Debug, Serialize)]
struct DebugCodeReport {
    code: u16,
    name: Option<String>,
    count: u64,
    last: f64,
}

fn of_debug(app: &App, device: &Device) -> DebugReport {
    let (bus, at) = (device.id.bus, Some(device.address));
    let of_code = |known: &DebugCount| DebugCodeReport {
        code: known.code.number(),
        name: app
            .shown_buses()
            .types_at(bus, at, known.last)
            .debug_name(&app.profile(bus), known.code),
        count: known.count,
        last: app.epoch().unix_secs(known.last),
    };
    let codes = device.debug_messages.by_code().iter().map(of_code).collect();
    DebugReport { count: device.debug_messages.total(), codes }
}

/// The type of a device in the catalogue.
#[derive(Debug, Serialize)]
struct DeviceTypeReport {
    gid: Option<String>,
    name: Option<String>,
    title: Option<String>,
    documentation: Option<String>,
    /// `gid` or `name`.
    by: &'static str,
    /// How the services of the device differ, in words; `null` if they do not, or are not known.
    difference: Option<String>,
}

fn of_type(app: &App, device: &Device) -> Option<DeviceTypeReport> {
    let (found, basis) = app.shown_buses().type_of(device)?;
    Some(DeviceTypeReport {
        gid: found.gid.map(|gid| gid.to_string()),
        name: found.name.clone(),
        title: Some(found.title.clone()).filter(|title| !title.is_empty()),
        documentation: found.documentation.clone(),
        by: match basis {
            TypeBasis::Gid => "gid",
            TypeBasis::Name => "name",
        },
        difference: device.services.as_ref().and_then(|own| found.difference(own)),
    })
}

/// A descriptor: a member for each field, `null` where it was not read.
#[derive(Debug, Default, Serialize)]
pub(super) struct DescriptorReport {
    /// Time of the last read, in seconds.
    read_at: Option<f64>,
    gid: Option<String>,
    uid: Option<String>,
    sn: Option<u32>,
    fw: Option<String>,
    caps: Option<CapabilitiesReport>,
    bspd: Option<BitrateReport>,
    addr: Option<AddressReport>,
    autostart: Option<bool>,
    /// Fields that were asked for without a value, by their name.
    faults: BTreeMap<&'static str, FieldFaultReport>,
}

#[derive(Debug, Serialize)]
struct CapabilitiesReport {
    programmable: bool,
    fpu: bool,
    cpu: u16,
    cpu_name: Option<&'static str>,
    cpu_flags: u16,
}

#[derive(Debug, Serialize)]
struct BitrateReport {
    bitrate: u32,
    fixed: bool,
}

#[derive(Debug, Serialize)]
struct AddressReport {
    /// `null`: none is set.
    address: Option<u8>,
    fixed: bool,
}

#[derive(Debug, Serialize)]
struct FieldFaultReport {
    /// `malformed`, `refused` or `no-response`.
    fault: &'static str,
    /// Bytes of a malformed response, as hexadecimal digits.
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<String>,
}

pub(super) fn of_descriptor(
    descriptor: &DeviceDescriptor,
    app: &App,
    bus: &Bus,
) -> DescriptorReport {
    let mut report = DescriptorReport {
        read_at: descriptor.read_at().map(|at| app.epoch().unix_secs(at)),
        ..DescriptorReport::default()
    };
    for reading in descriptor.readings() {
        let value = match &reading.content {
            FieldContent::Value(value) => *value,
            other => {
                let (fault, data) = match other {
                    FieldContent::Malformed { data, .. } => ("malformed", Some(hex(data, ""))),
                    FieldContent::Refused => ("refused", None),
                    FieldContent::NoResponse | FieldContent::Value(_) => ("no-response", None),
                };
                report.faults.insert(reading.field.name(), FieldFaultReport { fault, data });
                continue;
            }
        };
        match value {
            DescriptorValue::Gid(gid) => report.gid = Some(gid.to_string()),
            DescriptorValue::Uid(uid) => {
                report.uid = Some(uid.text(&bus.config().profile.uid).to_string());
            }
            DescriptorValue::Serial(serial) => report.sn = Some(serial),
            DescriptorValue::Firmware(version) => report.fw = Some(version.to_string()),
            DescriptorValue::Capabilities(able) => {
                report.caps = Some(CapabilitiesReport {
                    programmable: able.is_programmable,
                    fpu: able.has_fpu,
                    cpu: able.cpu,
                    cpu_name: able.cpu_name(),
                    cpu_flags: able.cpu_flags,
                });
            }
            DescriptorValue::Bitrate(setting) => {
                report.bspd =
                    Some(BitrateReport { bitrate: setting.rate, fixed: setting.is_fixed });
            }
            DescriptorValue::Address(setting) => {
                report.addr = Some(AddressReport {
                    address: setting.address().map(Address::number),
                    fixed: matches!(setting, AddressSetting::Fixed(_)),
                });
            }
            DescriptorValue::Autostart(starts) => report.autostart = Some(starts),
        }
    }
    report
}

pub(super) fn of_services(services: &[DeviceService]) -> Vec<ServiceReport> {
    let of_service = |service: &DeviceService| ServiceReport {
        index: service.index,
        name: service.name.to_string(),
        version: service.version.to_string(),
        extra: service.extra.iter().map(ToString::to_string).collect(),
    };
    services.iter().map(of_service).collect()
}

fn of_entry(app: &App, device: &Device) -> EntryReport {
    let place = app.matching().entry_of(device.id);
    let entry = place.and_then(|at| app.file_at(at.file).document().entries().get(at.index));
    EntryReport {
        listed: entry.is_some(),
        address: entry.and_then(|entry| entry.address),
        is_static: entry.map(|entry| entry.is_static),
        agrees: entry
            .map(|entry| !entry.is_static || entry.address == Some(device.address.number())),
    }
}

/// Converts a finding; `bus` is the name of its bus.
pub(super) fn of_finding(
    app: &App,
    bus: Option<String>,
    finding: &Finding,
    scope: Scope,
) -> FindingReport {
    let epoch = app.epoch();
    let cleared_at = finding.cleared_at();
    FindingReport {
        kind: finding.key.kind.name(),
        confidence: finding.state.name(),
        bus,
        address: finding.key.address.map(Address::number),
        addresses: finding.addresses.iter().map(|address| address.number()).collect(),
        names: finding.names.iter().map(ToString::to_string).collect(),
        uids: finding.uids.iter().map(SeenUid::label).collect(),
        first: epoch.unix_secs(finding.first),
        last: epoch.unix_secs(finding.last),
        cleared_at: cleared_at.map(|at| epoch.unix_secs(at)),
        superseded_by: finding.superseded_by.map(FindingKind::name),
        evidence: finding.evidence.iter().map(|piece| of_evidence(app, piece)).collect(),
        text: finding.text.clone(),
        remedy: finding.remedy.clone(),
        counts: finding.state == FindingState::Confirmed
            && match finding.key.kind.facts().exit_code_of {
                ExitCodeScope::ScanAndCheck => true,
                ExitCodeScope::Check(_) => scope == Scope::Check,
                ExitCodeScope::Nothing => false,
            },
        key: finding.key.clone(),
    }
}

/// The problems of the screen, by the time of their begin.
fn of_problems(app: &App) -> Vec<ProblemReport> {
    let time = |at: Instant| format_time_of_day(app, at);
    let list = app.problems();
    let mut problems: Vec<Problem> = list.iter().collect();
    problems.sort_by_key(Problem::began);
    let of_problem = |problem: &Problem| ProblemReport {
        confidence: problem.state().name(),
        headline: app.headline(problem).full,
        times: match problem.ended() {
            Some(ended) => format!("{} to {}", time(problem.began()), time(ended)),
            None => format!("since {}", time(problem.began())),
        },
        keys: problem.findings.iter().map(|finding| finding.key.clone()).collect(),
        remedy: problem.head().remedy.clone(),
    };
    problems.iter().map(of_problem).collect()
}

fn of_evidence(app: &App, piece: &Evidence) -> EvidenceReport {
    let decoded = piece.frame.as_ref().map(|frame| Decoded::of(app, frame));
    let header = decoded.as_ref().and_then(|decoded| decoded.header);
    EvidenceReport {
        time: app.epoch().unix_secs(piece.time),
        what: piece.description.to_string(),
        from: header.map(|header| header.source.number()),
        to: header.filter(|header| !header.broadcast).map(|header| header.destination.number()),
        meaning: decoded.map(|decoded| decoded.meaning()),
        frame: piece.frame.as_ref().map(Frame::to_string),
    }
}

/// The files with their buses; none where all buses have one file.
fn of_files(app: &App) -> Vec<BusFileReport> {
    if app.files().count() < 2 {
        return Vec::new();
    }
    let of_index = |file: FileIndex| BusFileReport {
        file: of_file(&app.file_snapshot(file)),
        buses: app.buses_of_file(file).map(|bus| bus.name.clone()).collect(),
    };
    app.files().map(|(file, _)| of_index(file)).collect()
}

pub(super) fn of_file(file: &FileSnapshot) -> FileReport {
    let path = file.path.as_deref().map(printable_path).unwrap_or_default();
    let problem = file.problem.as_ref().map(|problem| {
        let excerpt = problem.excerpt().into_iter().flatten();
        excerpt.fold(problem.of_file(&path), |text, line| text + "\n    " + &line)
    });
    FileReport {
        path,
        ok: if problem.is_some() { Some(false) } else { file.entries.map(|_| true) },
        entries: file.entries,
        error: file.problem.as_ref().map(ToString::to_string),
        problem,
    }
}
