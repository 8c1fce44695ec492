//! `descan check --fleet`: each gateway at a broker, compared with the des.json of its folder.
//!
//! Scripts rely on the names, types and meanings of the JSON members.

use super::check::warn_conflicts;
use super::fleet;
use super::open;
use super::test_report::{CaseOutcome, ReportedCase, test_report};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure, output};
use crate::cli::CheckArgs;
use crate::diagnostic::Diagnostic;
use crate::document::{Document, MAX_BYTES};
use crate::finding::CheckSection;
use crate::fleet::{ExpectedDevices, ExpectedGateway, Fleet, GatewayName, GatewayState};
use crate::project::{FILE_NAME, Project};
use crate::regular_file::{read, read_text};
use crate::shell::broker::{BrokerAddress, BrokerSettings};
use crate::text::{counted, printable, printable_path};
use crate::time::Instant;
use anyhow::Context;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// The section of a gateway that is not online.
const GATEWAY: &str = "gateway";

/// Runs it.
pub fn run(check: &CheckArgs, folder: &Path, broker: &BrokerAddress) -> Result<u8, Failure> {
    let access = check.broker_files.access(broker).map_err(Failure::Usage)?;
    let sites = sites(folder)?;
    let settings = BrokerSettings::read(&access)?;
    let has_site = |name: &GatewayName| sites.iter().any(|it| it.gateway.as_ref() == Some(name));
    let Some(read) = fleet::read(&settings, check.run.time, has_site)? else {
        return Ok(EXIT_INTERRUPTED);
    };
    if !read.is_complete {
        let why = "documents or statuses were not waited for; --time gives more time";
        return Err(Failure::Unusable(format!("{broker}: {why}")));
    }
    fleet::warn_rejects(&read.fleet);
    fleet::warn_if_empty(&read.fleet);
    warn_without_folder(&read.fleet, has_site, folder);
    warn_suspected_conflicts(&read.fleet, has_site);
    let checks: Vec<SiteCheck> =
        sites.iter().map(|site| SiteCheck::new(site, &read.fleet, read.now)).collect();
    if let Some(format) = check.report {
        let cases: Vec<ReportedCase> = checks.iter().flat_map(SiteCheck::cases).collect();
        output::print(&test_report(
            &format!("descan check {}", printable_path(folder)),
            &cases,
            format,
        ))?;
    } else if check.run.json {
        let report = FleetCheckReport { descan: env!("CARGO_PKG_VERSION"), gateways: &checks };
        output::print_json(&(serde_json::to_string_pretty(&report).context("JSON")? + "\n"))?;
    } else {
        let text: String = checks.iter().map(SiteCheck::text).collect();
        output::print(&text)?;
    }
    let unusable: Vec<&SiteCheck> = checks.iter().filter(|it| it.error.is_some()).collect();
    if let [first, ..] = unusable[..] {
        let why = first.error.as_deref().unwrap_or_default();
        let more = match unusable.len() - 1 {
            0 => String::new(),
            more => format!("; and {} more not compared", counted(more as u64, "gateway")),
        };
        return Err(Failure::Unusable(format!("{}: not compared: {why}{more}", first.name)));
    }
    Ok(if checks.iter().all(SiteCheck::is_passed) { EXIT_OK } else { EXIT_FINDINGS })
}

/// A folder with the files of a gateway.
struct Site {
    /// Its name, printable.
    name: String,
    /// The same as the name of a gateway; `None` if it cannot be one.
    gateway: Option<GatewayName>,
    /// What its files list, or why they cannot be used.
    expected: Result<ExpectedGateway, String>,
}

/// Reads the folder of each gateway, by name.
fn sites(folder: &Path) -> Result<Vec<Site>, Failure> {
    let entries = std::fs::read_dir(folder)
        .map_err(|error| Diagnostic::unreadable(printable_path(folder), &error))?;
    let mut sites = Vec::new();
    for entry in entries {
        let path =
            entry.map_err(|error| Diagnostic::unreadable(printable_path(folder), &error))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if !path.is_dir() || name.starts_with('.') {
            continue;
        }
        // One faulty file or name does not keep the other gateways from being compared.
        let (gateway, expected) = match name.parse() {
            Ok(gateway) => (Some(gateway), expected(&path).map_err(|failure| failure.to_string())),
            Err(why) => (None, Err(format!("{}: {why}", printable_path(&path)))),
        };
        sites.push(Site { name: printable(name.as_bytes()), gateway, expected });
    }
    if sites.is_empty() {
        let remedy = "put the des.json of each into FOLDER/GATEWAY";
        let why = format!("{}: no folder of a gateway in it", printable_path(folder));
        return Err(Diagnostic::new(why).with_remedy(remedy).into());
    }
    sites.sort_by(|one, other| one.name.cmp(&other.name));
    Ok(sites)
}

/// The des.json files of a folder: those of its project, else its own.
fn expected(folder: &Path) -> Result<ExpectedGateway, Failure> {
    let project_path = folder.join(FILE_NAME);
    let text = read_text(&project_path)?;
    let Some(text) = text else {
        let document = document(&folder.join(open::default_file()))?;
        let files = vec![ExpectedDevices { document, buses: None }];
        return Ok(ExpectedGateway { files, bitrates: BTreeMap::new() });
    };
    let project = Project::parse(&text, folder).map_err(|error| {
        Failure::Unusable(format!("{}: {error}", printable_path(&project_path)))
    })?;
    let of_file = |file: &Path| {
        let buses = project.buses.iter().filter(|bus| project.file_of(&bus.spec) == file);
        let buses: Vec<String> = buses.map(|bus| bus.name.clone()).collect();
        let buses = Some(buses).filter(|buses| !buses.is_empty());
        Ok(ExpectedDevices { document: document(file)?, buses })
    };
    let files: Result<_, Failure> = project.files().into_iter().map(of_file).collect();
    Ok(ExpectedGateway { files: files?, bitrates: project.facts(&[]).bitrates })
}

fn document(path: &Path) -> Result<Document, Failure> {
    let bytes = read(path, MAX_BYTES as u64).map_err(|fault| fault.of(printable_path(path)))?;
    let bytes = bytes.ok_or_else(|| Diagnostic::new("file not found").of(printable_path(path)))?;
    let unusable = |error| Failure::Unusable(format!("{}: {error}", printable_path(path)));
    Document::parse(&bytes).map_err(unusable)
}

/// Says which gateways are not compared.
fn warn_without_folder(fleet: &Fleet, has_site: impl Fn(&GatewayName) -> bool, folder: &Path) {
    let without: Vec<&str> = fleet
        .gateways()
        .map(|(name, _)| name)
        .filter(|name| !has_site(name))
        .map(GatewayName::as_str)
        .collect();
    if let [first, ..] = without[..] {
        let count = without.len();
        let who =
            if count == 1 { first.to_owned() } else { format!("{count} gateways ({first}, …)") };
        output::warn(format_args!("{who}: no folder in {}; not compared", printable_path(folder)));
    }
}

/// Says which conflicts the gateways suspect; they do not count as a difference.
fn warn_suspected_conflicts(fleet: &Fleet, has_site: impl Fn(&GatewayName) -> bool) {
    let compared = fleet.gateways().filter(|(name, _)| has_site(name));
    let all = compared.flat_map(|(name, gateway)| {
        gateway.suspected_conflicts().map(move |finding| {
            let bus = finding.bus.as_ref().map_or(String::new(), |bus| format!("{bus}: "));
            format!("suspected: {name}: {bus}{}", finding.text)
        })
    });
    warn_conflicts(all);
}

#[derive(Serialize)]
struct FleetCheckReport<'a> {
    descan: &'static str,
    gateways: &'a [SiteCheck],
}

/// A gateway, and how it differs from its files.
#[derive(Serialize)]
struct SiteCheck {
    name: String,
    /// `missing`: it has published nothing.
    state: &'static str,
    entries: usize,
    devices: usize,
    differences: Vec<FleetDifferenceReport>,
    /// Why its files or a document of it cannot be used; it is not compared then.
    error: Option<String>,
    #[serde(skip)]
    is_online: bool,
    /// It has published something.
    #[serde(skip)]
    is_known: bool,
}

#[derive(Serialize)]
struct FleetDifferenceReport {
    section: &'static str,
    bus: Option<String>,
    address: Option<u8>,
    text: String,
}

impl SiteCheck {
    fn new(site: &Site, fleet: &Fleet, now: Instant) -> Self {
        let gateway = site.gateway.as_ref().and_then(|name| fleet.gateway(name));
        let state = gateway.map(|it| it.state(now));
        let is_online = state == Some(GatewayState::Online);
        let state = state.map_or("missing", GatewayState::name);
        // A device that is not listed may be in it.
        let unread = site.gateway.as_ref().and_then(|name| fleet.rejects().of_gateway(name));
        let unread = unread.map(|document| format!("not used: {document}"));
        let expected = site.expected.as_ref().ok().filter(|_| unread.is_none());
        let mut differences = Vec::new();
        if expected.is_some() && !is_online {
            let text = state.to_owned();
            differences.push(FleetDifferenceReport {
                section: GATEWAY,
                bus: None,
                address: None,
                text,
            });
        }
        if let (Some(gateway), Some(expected)) = (gateway, expected) {
            differences.extend(gateway.differences(expected).into_iter().map(|it| {
                let section = it.section.title();
                FleetDifferenceReport { section, bus: it.bus, address: it.address, text: it.text }
            }));
        }
        Self {
            name: site.name.clone(),
            state,
            entries: expected.map_or(0, ExpectedGateway::entries),
            devices: gateway.map_or(0, |it| it.inventory().present_devices()),
            differences,
            error: site.expected.as_ref().err().cloned().or(unread),
            is_online,
            is_known: gateway.is_some(),
        }
    }

    fn is_passed(&self) -> bool {
        self.differences.is_empty() && self.error.is_none()
    }

    fn in_section(&self, section: CheckSection) -> impl Iterator<Item = &FleetDifferenceReport> {
        self.differences.iter().filter(move |it| it.section == section.title())
    }

    /// The differences in sections, and a summary; the summary alone if there are none.
    fn text(&self) -> String {
        if let Some(why) = &self.error {
            return format!("{}: not compared: {why}\n", self.name);
        }
        let mut text = String::new();
        let mut sums = Vec::new();
        for section in CheckSection::ALL {
            let mut count = 0;
            for difference in self.in_section(section) {
                if count == 0 {
                    let _ = writeln!(text, "{} {}:", self.name, section.title());
                }
                count += 1;
                let _ = writeln!(text, "  {}", line_of(difference));
            }
            let title = if count == 1 { section.singular() } else { section.title() };
            if count > 0 {
                sums.push(format!("{count} {title}"));
            }
        }
        if !self.is_online {
            sums.insert(0, format!("gateway {}", self.state));
        }
        let verdict = if sums.is_empty() { "no difference".to_owned() } else { sums.join(", ") };
        let entries = if self.entries == 1 { "entry" } else { "entries" };
        let devices = counted(self.devices as u64, "device");
        let _ = writeln!(text, "{}: {} {entries}, {devices}: {verdict}", self.name, self.entries);
        text
    }

    /// A test for each section, and one for the gateway.
    fn cases(&self) -> Vec<ReportedCase> {
        let outcome = |passed| if passed { CaseOutcome::Passed } else { CaseOutcome::Failed };
        let connection = ReportedCase {
            suite: self.name.clone(),
            name: GATEWAY.to_owned(),
            outcome: outcome(self.is_online),
            text: self.state.to_owned(),
            details: Vec::new(),
        };
        let of_section = |section: CheckSection| {
            let (suite, name) = (self.name.clone(), section.title().to_owned());
            if let Some(why) = &self.error {
                // The first says why; the others were not made.
                let is_first = section == CheckSection::FileErrors;
                let outcome = if is_first { CaseOutcome::Failed } else { CaseOutcome::Skipped };
                let text = format!("not compared: {why}");
                return ReportedCase { suite, name, outcome, text, details: Vec::new() };
            }
            if !self.is_known {
                let text = "not compared: the gateway has published nothing".to_owned();
                let outcome = CaseOutcome::Skipped;
                return ReportedCase { suite, name, outcome, text, details: Vec::new() };
            }
            let details: Vec<String> = self.in_section(section).map(line_of).collect();
            let text = match details.len() {
                0 => "no difference".to_owned(),
                1 => format!("1 {}", section.singular()),
                count => format!("{count} {}", section.title()),
            };
            ReportedCase { suite, name, outcome: outcome(details.is_empty()), text, details }
        };
        std::iter::once(connection).chain(CheckSection::ALL.map(of_section)).collect()
    }
}

/// A difference in a line, with its bus.
fn line_of(difference: &FleetDifferenceReport) -> String {
    let bus = difference.bus.as_ref().map_or(String::new(), |bus| format!("{bus}: "));
    format!("{bus}{}", difference.text)
}
