//! The result of `descan prove`: as text, JSON, tests and Markdown.
//!
//! Input: the verdicts on the rules of each device. Does not know how they were found.

use super::test_report::{CaseOutcome, ReportedCase};
use crate::app::App;
use crate::app::proof::markdown::Plain;
use crate::discovery::DeviceId;
use crate::frame::{BusIndex, Frame};
use crate::log::pcapng;
use crate::prove::{Conformance, Prover, RuleVerdict};
use crate::text::{counted, printable};
use crate::time::Epoch;
use crate::wire::framing::Framing;
use serde::Serialize;
use std::fmt::Write as _;

/// Name of the test that fails if a conflict at the address of a device is confirmed.
const CONFLICT_CASE: &str = "address-conflict";

/// The bus of the command.
const BUS: BusIndex = BusIndex(0);

/// A device that was tested.
pub struct ProvenDevice {
    summary: DeviceSummary,
    verdicts: Vec<RuleVerdict>,
    /// The frames of the bus meanwhile.
    frames: Vec<Frame>,
}

impl ProvenDevice {
    /// Takes the verdicts of the tests.
    pub fn new(app: &App, id: DeviceId, prover: &Prover) -> Self {
        let conflict = prover.doubt();
        let device = app.device(id);
        let is_confirmed = device.is_some_and(|it| app.has_confirmed_conflict(it));
        let millis = |seconds: f64| (seconds * 1e6).round() / 1e3;
        let known = device.and_then(|it| it.name.as_ref()).map(ToString::to_string);
        let uid = device.and_then(|it| it.uid);
        let (made, all) = prover.progress();
        let summary = DeviceSummary {
            address: prover.device().number(),
            name: prover.name().map(printable).or(known),
            uid: uid.map(|uid| uid.text(&app.profile(BUS).uid).to_string()),
            framing: prover.framing(),
            heartbeat_ms: prover.heartbeat_intervals().map(|all| all.map(millis)),
            response_ms: prover.latency().map(|all| all.map(|it| millis(it.as_secs_f64()))),
            conflict_confirmed: conflict.is_some() && is_confirmed,
            conflict,
            tests: [made, all],
        };
        let frames = app.proof_frames().copied().collect();
        Self { summary, verdicts: prover.verdicts(), frames }
    }
}

/// What is known of a device, and of its tests as a whole.
#[derive(Clone, Serialize)]
struct DeviceSummary {
    address: u8,
    name: Option<String>,
    uid: Option<String>,
    framing: Option<Framing>,
    /// Shortest, mean and longest interval.
    heartbeat_ms: Option<[f64; 3]>,
    /// Shortest, mean and longest time to an answer.
    response_ms: Option<[f64; 3]>,
    /// Why no rule is seen: another device at its address.
    conflict: Option<String>,
    /// Frames confirm the conflict.
    conflict_confirmed: bool,
    /// Number of tests made, and of all.
    tests: [usize; 2],
}

/// The result, as JSON.
#[derive(Serialize)]
pub struct ProofReport {
    descan: &'static str,
    bus: String,
    /// False: interrupted.
    complete: bool,
    /// Devices whose tests did not begin.
    #[serde(skip)]
    untested: usize,
    kept: usize,
    broken: usize,
    not_seen: usize,
    devices: Vec<ProvenReport>,
}

/// A device, as JSON.
#[derive(Serialize)]
struct ProvenReport {
    #[serde(flatten)]
    summary: DeviceSummary,
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

/// Escapes text for Markdown; frames in it are code.
fn with_code(text: &str) -> String {
    let is_frame = |word: &str| {
        word.split_once('#').is_some_and(|(id, data)| {
            id.len() == 8 && [id, data].iter().all(|it| it.bytes().all(|it| it.is_ascii_hexdigit()))
        })
    };
    let word = |word: &str| {
        if is_frame(word) { format!("`{word}`") } else { Plain(word).to_string() }
    };
    text.split(' ').map(word).collect::<Vec<_>>().join(" ")
}

fn count(verdicts: &[RuleVerdict], conformance: Conformance) -> usize {
    verdicts.iter().filter(|it| it.conformance == conformance).count()
}

impl ProofReport {
    /// The result for these devices. `untested`: number of devices whose tests did not begin, if it was
    /// interrupted.
    pub fn new(app: &App, proven: &[ProvenDevice], untested: Option<usize>) -> Self {
        let devices: Vec<ProvenReport> =
            proven.iter().map(|device| ProvenReport::new(device, app.epoch())).collect();
        let sum = |of: fn(&ProvenReport) -> usize| devices.iter().map(of).sum();
        Self {
            descan: env!("CARGO_PKG_VERSION"),
            bus: app.bus(BUS).map_or_else(String::new, |bus| bus.name.clone()),
            complete: untested.is_none(),
            untested: untested.unwrap_or(0),
            kept: sum(|it| it.kept),
            broken: sum(|it| it.broken),
            not_seen: sum(|it| it.not_seen),
            devices,
        }
    }

    /// Name of the bus.
    pub fn bus(&self) -> &str {
        &self.bus
    }

    /// Returns true if a rule is broken, or a conflict is confirmed.
    pub fn has_findings(&self) -> bool {
        self.broken > 0 || self.devices.iter().any(|device| device.summary.conflict_confirmed)
    }

    /// Says that the result is incomplete; `None` if it is not.
    pub fn incomplete(&self) -> Option<String> {
        let [made, all] = self.devices.last().filter(|_| !self.complete)?.summary.tests;
        let others = match self.untested as u64 {
            0 => String::new(),
            count => format!(", {} not tested", counted(count, "device")),
        };
        Some(format!(
            "interrupted after {made} of {all} tests{others}: incomplete, a rule that was kept until then \
             may be broken"
        ))
    }

    /// A test for each rule of each device, and one for a conflict that is confirmed.
    pub fn cases(&self) -> Vec<ReportedCase> {
        let of_device = |device: &ProvenReport| {
            let suite = device.who();
            let rules = device.rules.iter().map(|rule| rule.case(suite.clone()));
            device.conflict_case().into_iter().chain(rules).collect::<Vec<_>>()
        };
        self.devices.iter().flat_map(of_device).collect()
    }

    /// What is broken, with the frames, then all verdicts. `frames`: name of the file with the frames.
    pub fn markdown(&self, frames: &str) -> String {
        let mut text = format!("# descan prove {}\n", Plain(&self.bus));
        if let Some(sentence) = self.incomplete() {
            let _ = writeln!(text, "\n**{}.**", Plain(&sentence));
        }
        for device in &self.devices {
            let ProvenReport { kept, broken, not_seen, .. } = device;
            let who = device.who();
            let sums = format!("{kept} rules kept, {broken} broken, {not_seen} not seen");
            let _ = writeln!(text, "\n## {}\n\n{sums}.\n", Plain(&who));
            if let Some(conflict) = device.conflict_sentence() {
                let _ = writeln!(text, "**{}.**\n", Plain(&conflict));
            }
            let broken = device.rules.iter().filter(|it| it.verdict == Conformance::Broken.word());
            broken.for_each(|rule| rule.write_markdown(&mut text));
            text.push_str("| rule | verdict | what was seen |\n|---|---|---|\n");
            for RuleReport { rule, verdict, text: seen, .. } in &device.rules {
                let _ = writeln!(text, "| {rule} | {verdict} | {} |", with_code(seen));
            }
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
    pub fn text(&self) -> String {
        let mut text = String::new();
        for device in &self.devices {
            let _ = writeln!(text, "{}:", device.who());
            if let Some(conflict) = device.conflict_sentence() {
                let _ = writeln!(text, "  {conflict}");
            }
            device.rules.iter().for_each(|rule| rule.write(&mut text));
            let _ = writeln!(text);
        }
        for device in &self.devices {
            let ProvenReport { kept, broken, not_seen, .. } = device;
            let who = device.who();
            let _ = writeln!(text, "{who}: {kept} kept, {broken} broken, {not_seen} not seen");
        }
        if let Some(sentence) = self.incomplete() {
            let _ = writeln!(text, "{sentence}");
        }
        text
    }
}

impl ProvenReport {
    fn new(device: &ProvenDevice, epoch: Epoch) -> Self {
        let verdicts = &device.verdicts;
        Self {
            summary: device.summary.clone(),
            kept: count(verdicts, Conformance::Kept),
            broken: count(verdicts, Conformance::Broken),
            not_seen: count(verdicts, Conformance::NotSeen),
            rules: verdicts.iter().map(|it| RuleReport::new(it, epoch)).collect(),
        }
    }

    /// The conflict at its address, and whether frames confirm it.
    fn conflict_sentence(&self) -> Option<String> {
        let strength =
            if self.summary.conflict_confirmed { "confirmed by frames" } else { "suspected" };
        let conflict = self.summary.conflict.as_ref()?;
        Some(format!("address conflict, {strength}: {conflict}; so no rule is seen"))
    }

    fn conflict_case(&self) -> Option<ReportedCase> {
        let text = self.summary.conflict.clone().filter(|_| self.summary.conflict_confirmed)?;
        Some(ReportedCase {
            suite: self.who(),
            name: CONFLICT_CASE.to_owned(),
            outcome: CaseOutcome::Failed,
            text,
            details: Vec::new(),
        })
    }

    fn who(&self) -> String {
        format!("{} at {}", self.summary.name.as_deref().unwrap_or("?"), self.summary.address)
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
        let _ = writeln!(text, "Seen: {}.\n", with_code(&self.text));
        text.push_str("| time | frame | sent by |\n|---|---|---|\n");
        for ProofFrame { time, frame, tx } in &self.frames {
            let sender = if *tx { "descan" } else { "the device or another node" };
            let _ = writeln!(text, "| {time:.6} | `{frame}` | {sender} |");
        }
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

/// The frames as pcapng. A comment names the rules that a frame is about.
pub fn proof_pcapng(app: &App, report: &ProofReport, proven: &[ProvenDevice]) -> Vec<u8> {
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
