//! `descan prove`: does a device keep the rules of DES and of the CAN platform? Looks for it, tests it,
//! prints a verdict on each rule.

use super::device::{find, not_found};
use super::headless::warn_foreign;
use super::one_bus::{self, CommandRun};
use super::open::{self, Setup};
use super::output::{self, answer, ask, may_ask, say};
use super::test_report::{CaseOutcome, ReportedCase, test_report};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure};
use crate::app::App;
use crate::app::proof::markdown::{MarkdownTable, Plain};
use crate::cli::ProveArgs;
use crate::discovery::{Device, DeviceId};
use crate::frame::{BusIndex, Frame};
use crate::log::pcapng;
use crate::prove::{Conformance, ProofSwitches, Prover, RuleVerdict};
use crate::regular_file::shown;
use crate::shell::store::{Store, write_new};
use crate::text::{counted, printable};
use crate::time::{Epoch, Instant};
use crate::wire::framing::Framing;
use serde::Serialize;
use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError};

/// The bus of the command.
const BUS: BusIndex = BusIndex(0);

/// Runs it.
pub fn run(args: &ProveArgs) -> Result<u8, Failure> {
    let buses = std::slice::from_ref(&args.bus);
    if open::log(buses, "prove", None)?.is_some() {
        return Err(Failure::Usage("a log has no device to send to".to_owned()));
    }
    if args.common.listen_only {
        return Err(Failure::Usage("listen-only: prove sends DES requests".to_owned()));
    }
    if needs_consent(args) && !may_ask() {
        let text = "it asks before it disturbs the device, and there is no terminal: give --yes";
        return Err(Failure::Usage(text.to_owned()));
    }
    if let Some(path) = &args.proof {
        for path in [path.clone(), path.with_extension("pcapng")] {
            Store::new(&path).check_new().map_err(|fault| fault.of(shown(&path)))?;
        }
    }
    let setup = Setup::for_buses(&args.common, buses)?;
    let mut proof = DeviceProof::default();
    let CommandRun { app, is_interrupted } =
        one_bus::run(&args.bus, setup, args.time, |app, now, end| {
            proof.advance(app, args, (now, end))
        })?;
    if is_interrupted {
        return Ok(EXIT_INTERRUPTED);
    }
    if proof.is_declined {
        say("nothing was sent to the device");
        return Ok(EXIT_FINDINGS);
    }
    let report = ProofReport::new(&app, &proof.proven);
    if let Some(format) = args.report {
        let name = format!("descan prove {}", report.bus);
        output::print(&test_report(&name, &report.cases(), format))?;
    } else if args.json {
        let json = serde_json::to_string_pretty(&report).map_err(anyhow::Error::from)?;
        output::print_json(&(json + "\n"))?;
    } else {
        output::print(&report.text())?;
    }
    if let Some(path) = args.proof.as_deref().filter(|_| report.broken > 0) {
        write_proof(&app, &report, &proof.proven, path)?;
    }
    Ok(if report.broken > 0 { EXIT_FINDINGS } else { EXIT_OK })
}

/// Writes the proof of what is broken: a report in Markdown, and the frames beside it.
fn write_proof(
    app: &App,
    report: &ProofReport,
    proven: &[ProvenDevice],
    path: &Path,
) -> Result<(), Failure> {
    let frames = path.with_extension("pcapng");
    let bytes = proof_pcapng(app, report, proven);
    let text = report.markdown(&shown(&frames));
    write_new(&frames, None, |file| file.write_all(&bytes)).map_err(|it| it.of(shown(&frames)))?;
    write_new(path, None, |file| file.write_all(text.as_bytes()))
        .map_err(|it| it.of(shown(path)))?;
    say(format!("saved: {} and {}", shown(path), shown(&frames)));
    Ok(())
}

/// The frames as pcapng. A comment names the rules that a frame is about.
fn proof_pcapng(app: &App, report: &ProofReport, proven: &[ProvenDevice]) -> Vec<u8> {
    let mut out = Vec::new();
    // Writing to memory does not fail.
    let _ = pcapng::write_section_about(&mut out, &format!("descan prove {}", report.bus));
    let _ = pcapng::write_interface(&mut out, &report.bus);
    for device in proven {
        let broken = device.verdicts.iter().filter(|it| it.conformance == Conformance::Broken);
        let broken: Vec<&RuleVerdict> = broken.collect();
        for frame in &device.frames {
            let rules = broken.iter().filter(|it| it.frames.contains(frame));
            let rules: Vec<&str> = rules.map(|it| it.rule.id()).collect();
            let comment = if rules.is_empty() {
                String::new()
            } else {
                format!("broken: {}", rules.join(", "))
            };
            let micros = app.epoch().unix_micros(frame.time);
            let _ = pcapng::write_frame_with(&mut out, 0, micros, frame, &comment);
        }
    }
    out
}

/// The tests on demand.
fn switches(args: &ProveArgs) -> ProofSwitches {
    ProofSwitches { disrupts: args.disrupt_device, loads: args.load, reboots: args.reboot }
}

/// Returns true if the user is asked before the tests begin.
fn needs_consent(args: &ProveArgs) -> bool {
    (args.disrupt_device || args.load) && !args.yes
}

fn question(args: &ProveArgs, devices: &str) -> String {
    let disruption = "it gives its address up, changes its mode, and is off the bus for seconds";
    let load = "the bus is loaded to 80 % for 14 heartbeat periods";
    let effect = match (args.disrupt_device, args.load) {
        (true, true) => format!("{disruption}; {load}"),
        (true, false) => disruption.to_owned(),
        (false, _) => load.to_owned(),
    };
    format!("Disturb {devices}: {effect}? [y/N]")
}

/// Refuses to load a bus on which other devices work.
fn refuse_load(app: &App, tested: &VecDeque<DeviceId>) -> Result<(), Failure> {
    let Some(bus) = app.bus(BUS) else { return Ok(()) };
    let is_other = |it: &&Device| it.is_present() && !(tested.len() == 1 && tested[0] == it.id);
    let others = bus.devices().iter().filter(is_other).count() as u64;
    if others == 0 {
        return Ok(());
    }
    let others = counted(others, "other device");
    Err(Failure::Unusable(format!("--load: {others} on the bus; on a test bench give --bench")))
}

/// How far the tests are.
#[derive(Default)]
struct DeviceProof {
    /// Devices that are still to be tested.
    waiting: VecDeque<DeviceId>,
    is_found: bool,
    running: Option<DeviceId>,
    proven: Vec<ProvenDevice>,
    told: usize,
    /// The user was told to switch the device off and on.
    is_switch_told: bool,
    /// The answer of the user, who is asked.
    asked: Option<Receiver<bool>>,
    is_declined: bool,
}

impl DeviceProof {
    /// Takes the next step, if it is time for it; returns true once all devices are tested.
    fn advance(
        &mut self,
        app: &mut App,
        args: &ProveArgs,
        (now, end): (Instant, Instant),
    ) -> Result<bool, Failure> {
        if !self.is_found {
            self.waiting = searched(app, args, now >= end)?.into();
            self.is_found = !self.waiting.is_empty();
            if !self.is_found {
                return Ok(false);
            }
            if args.load && !args.bench {
                refuse_load(app, &self.waiting)?;
            }
            if needs_consent(args) {
                let devices = counted(self.waiting.len() as u64, "device");
                ask(question(args, &devices));
                self.asked = Some(answer());
            }
        }
        if let Some(asked) = &self.asked {
            match asked.try_recv() {
                Ok(true) => self.asked = None,
                Ok(false) | Err(TryRecvError::Disconnected) => {
                    self.is_declined = true;
                    return Ok(true);
                }
                Err(TryRecvError::Empty) => return Ok(false),
            }
        }
        if let (Some(id), Some(prover)) = (self.running, app.prover()) {
            self.told = tell(prover, self.told);
            if prover.awaits_power_switch() && !std::mem::replace(&mut self.is_switch_told, true) {
                let device = prover.device();
                say(format!("switch the device at {device} off, for 5 s, and on again"));
            }
            if !prover.is_over() {
                return Ok(false);
            }
            self.proven.push(ProvenDevice::new(app, id, prover));
            self.running = None;
        }
        let Some(id) = self.waiting.pop_front() else { return Ok(true) };
        app.start_prover(id, switches(args)).map_err(Failure::Unusable)?;
        (self.running, self.told, self.is_switch_told) = (Some(id), 0, false);
        Ok(false)
    }
}

/// Says how far the tests are, at each tenth.
fn tell(prover: &Prover, told: usize) -> usize {
    let (made, all) = prover.progress();
    let tenth = made * 10 / all.max(1);
    if tenth > told {
        say(format!("device at {}: {made} of {all} tests", prover.device()));
    }
    tenth.max(told)
}

/// The devices to test, in the order of their addresses; none while they are looked for.
///
/// # Errors
///
/// There are none, or several fit.
fn searched(app: &App, args: &ProveArgs, is_last: bool) -> Result<Vec<DeviceId>, Failure> {
    let found = match &args.device {
        Some(wanted) => find(app, wanted, is_last)?.into_iter().collect(),
        None => all_devices(app, is_last),
    };
    if found.is_empty() && is_last {
        warn_foreign(app, &mut Vec::new());
        let wanted = args.device.as_deref().unwrap_or("a device");
        return Err(Failure::Unusable(not_found(app, wanted)));
    }
    Ok(found)
}

/// All devices but debug devices, once the rounds at start are over.
fn all_devices(app: &App, is_last: bool) -> Vec<DeviceId> {
    let Some(bus) = app.bus(BUS) else { return Vec::new() };
    if !is_last && !bus.progress().is_complete {
        return Vec::new();
    }
    let devices = bus.devices().iter().filter(|it| it.is_present() && !it.is_debug);
    let mut devices: Vec<&Device> = devices.collect();
    devices.sort_by_key(|device| device.address);
    devices.into_iter().map(|device| device.id).collect()
}

/// A device that was tested.
struct ProvenDevice {
    address: u8,
    name: Option<String>,
    uid: Option<String>,
    framing: Option<Framing>,
    heartbeat_ms: Option<[f64; 3]>,
    response_ms: Option<[f64; 3]>,
    verdicts: Vec<RuleVerdict>,
    /// The frames of the bus meanwhile.
    frames: Vec<Frame>,
}

impl ProvenDevice {
    fn new(app: &App, id: DeviceId, prover: &Prover) -> Self {
        let device = app.device(id);
        let millis = |seconds: f64| (seconds * 1e6).round() / 1e3;
        let known = device.and_then(|it| it.name.as_ref()).map(ToString::to_string);
        let uid = device.and_then(|it| it.uid);
        Self {
            address: prover.device().number(),
            name: prover.name().map(printable).or(known),
            uid: uid.map(|uid| uid.text(&app.profile(BUS).uid).to_string()),
            framing: prover.framing(),
            heartbeat_ms: prover.heartbeat_intervals().map(|all| all.map(millis)),
            response_ms: prover.latency().map(|all| all.map(|it| millis(it.as_secs_f64()))),
            verdicts: prover.verdicts(),
            frames: app.proof_frames().copied().collect(),
        }
    }
}

/// The result, as JSON.
#[derive(Serialize)]
struct ProofReport {
    descan: &'static str,
    bus: String,
    kept: usize,
    broken: usize,
    not_seen: usize,
    devices: Vec<ProvenReport>,
}

/// A device, as JSON.
#[derive(Serialize)]
struct ProvenReport {
    address: u8,
    name: Option<String>,
    uid: Option<String>,
    framing: Option<Framing>,
    /// Shortest, mean and longest interval.
    heartbeat_ms: Option<[f64; 3]>,
    /// Shortest, mean and longest time to an answer.
    response_ms: Option<[f64; 3]>,
    kept: usize,
    broken: usize,
    not_seen: usize,
    rules: Vec<RuleReport>,
}

/// A verdict, as JSON.
#[derive(Serialize)]
struct RuleReport {
    rule: &'static str,
    /// `kept`, `broken` or `not-seen`.
    verdict: &'static str,
    document: &'static str,
    section: &'static str,
    needs: &'static str,
    sentence: &'static str,
    text: String,
    samples: u32,
    assumed: Vec<&'static str>,
    frames: Vec<ProofFrame>,
}

/// A frame, as JSON.
#[derive(Serialize)]
struct ProofFrame {
    time: f64,
    frame: String,
    tx: bool,
}

fn count(verdicts: &[RuleVerdict], conformance: Conformance) -> usize {
    verdicts.iter().filter(|it| it.conformance == conformance).count()
}

impl ProofReport {
    fn new(app: &App, proven: &[ProvenDevice]) -> Self {
        let devices: Vec<ProvenReport> =
            proven.iter().map(|device| ProvenReport::new(device, app.epoch())).collect();
        let sum = |of: fn(&ProvenReport) -> usize| devices.iter().map(of).sum();
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            bus: app.bus(BUS).map_or_else(String::new, |bus| bus.name.clone()),
            kept: sum(|it| it.kept),
            broken: sum(|it| it.broken),
            not_seen: sum(|it| it.not_seen),
            devices,
        }
    }

    /// A test for each rule of each device.
    fn cases(&self) -> Vec<ReportedCase> {
        let of_device = |device: &ProvenReport| {
            let suite = device.who();
            device.rules.iter().map(move |rule| rule.case(suite.clone())).collect::<Vec<_>>()
        };
        self.devices.iter().flat_map(of_device).collect()
    }

    /// What is broken, with the frames, then all verdicts. `frames`: name of the file with the frames.
    fn markdown(&self, frames: &str) -> String {
        let mut text = format!("# descan prove {}\n", Plain(&self.bus));
        for device in &self.devices {
            let ProvenReport { kept, broken, not_seen, .. } = device;
            let who = device.who();
            let sums = format!("{kept} rules kept, {broken} broken, {not_seen} not seen");
            let _ = writeln!(text, "\n## {}\n\n{sums}.\n", Plain(&who));
            let broken = device.rules.iter().filter(|it| it.verdict == Conformance::Broken.word());
            broken.for_each(|rule| rule.write_markdown(&mut text));
            let mut table = MarkdownTable::new(&["rule", "verdict", "what was seen"]);
            for rule in &device.rules {
                table.row(&[rule.rule, rule.verdict, &rule.text]);
            }
            text.push_str(&table.finish());
        }
        let version = self.descan;
        let _ = writeln!(
            text,
            "\nThe file {} has the frames of the bus; its comments name the rules. Wireshark and \
             tshark open it. Measured by descan {version}.",
            Plain(frames)
        );
        text
    }

    /// A line for each rule, and the sums.
    fn text(&self) -> String {
        let mut text = String::new();
        for device in &self.devices {
            let _ = writeln!(text, "{}:", device.who());
            device.rules.iter().for_each(|rule| rule.write(&mut text));
            let _ = writeln!(text);
        }
        for device in &self.devices {
            let ProvenReport { kept, broken, not_seen, .. } = device;
            let who = device.who();
            let _ = writeln!(text, "{who}: {kept} kept, {broken} broken, {not_seen} not seen");
        }
        text
    }
}

impl ProvenReport {
    fn new(device: &ProvenDevice, epoch: Epoch) -> Self {
        let verdicts = &device.verdicts;
        Self {
            address: device.address,
            name: device.name.clone(),
            uid: device.uid.clone(),
            framing: device.framing,
            heartbeat_ms: device.heartbeat_ms,
            response_ms: device.response_ms,
            kept: count(verdicts, Conformance::Kept),
            broken: count(verdicts, Conformance::Broken),
            not_seen: count(verdicts, Conformance::NotSeen),
            rules: verdicts.iter().map(|it| RuleReport::new(it, epoch)).collect(),
        }
    }

    fn who(&self) -> String {
        format!("{} at {}", self.name.as_deref().unwrap_or("?"), self.address)
    }
}

impl RuleReport {
    fn new(verdict: &RuleVerdict, epoch: Epoch) -> Self {
        let rule = verdict.rule;
        let frame = |frame: &Frame| ProofFrame {
            time: epoch.unix_secs(frame.time),
            frame: frame.to_string(),
            tx: frame.is_tx,
        };
        Self {
            rule: rule.id(),
            verdict: verdict.conformance.word(),
            document: rule.document().name(),
            section: rule.section(),
            needs: rule.need().word(),
            sentence: rule.sentence(),
            text: verdict.text.clone(),
            samples: verdict.samples,
            assumed: verdict.assumed.iter().map(|key| key.name()).collect(),
            frames: verdict.frames.iter().map(frame).collect(),
        }
    }

    fn case(&self, suite: String) -> ReportedCase {
        let is = |conformance: Conformance| self.verdict == conformance.word();
        let outcome = if is(Conformance::Broken) {
            CaseOutcome::Failed
        } else if is(Conformance::Kept) {
            CaseOutcome::Passed
        } else {
            CaseOutcome::Skipped
        };
        let demand = format!("{} ({}, {})", self.sentence, self.document, self.section);
        let frames = self.frames.iter().map(|it| format!("{:.6} {}", it.time, it.frame));
        ReportedCase {
            suite,
            name: self.rule.to_owned(),
            outcome,
            text: self.text.clone(),
            details: std::iter::once(demand).chain(frames).collect(),
        }
    }

    /// The rule, what it demands, what was seen and the frames.
    fn write_markdown(&self, text: &mut String) {
        let Self { rule, sentence, document, section, .. } = self;
        let source = format!("{document}, {section}");
        let _ = writeln!(text, "### {rule}: broken\n");
        let _ = writeln!(text, "The device {} ({}).\n", Plain(sentence), Plain(&source));
        let _ = writeln!(text, "Seen: {}.\n", Plain(&self.text));
        let mut table = MarkdownTable::new(&["time", "frame", "sent by"]);
        for frame in &self.frames {
            let sender = if frame.tx { "descan" } else { "the device or another node" };
            table.row(&[&format!("{:.6}", frame.time), &frame.frame, sender]);
        }
        text.push_str(&table.finish());
        text.push('\n');
    }

    /// A line; of a rule that is broken also what it demands, and the frames.
    fn write(&self, text: &mut String) {
        let label = if self.verdict == "not-seen" { "not seen" } else { self.verdict };
        let _ = writeln!(text, "  {label:8}  {:28}  {}", self.rule, self.text);
        if self.verdict == Conformance::Broken.word() {
            let Self { sentence, document, section, .. } = self;
            let _ = writeln!(text, "            the device {sentence} ({document}, {section})");
            for frame in &self.frames {
                let tx = if frame.tx { "  sent by descan" } else { "" };
                let _ = writeln!(text, "            {:.6}  {}{tx}", frame.time, frame.frame);
            }
        }
    }
}
