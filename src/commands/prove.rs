//! `descan prove`: does a device keep the rules of DES and of the CAN platform? Looks for it, tests it,
//! prints a verdict on each rule.

use super::device::{check_address, find, not_found};
use super::headless::warn_foreign;
use super::one_bus::{self, CommandRun};
use super::open::{self, Setup};
use super::output::{self, answer, ask, may_ask, say};
use super::proof_progress::ProofProgress;
use super::proof_report::{ProofReport, ProvenDevice, proof_pcapng};
use super::test_report::test_report;
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure};
use crate::app::App;
use crate::cli::ProveArgs;
use crate::discovery::{Device, DeviceId};
use crate::frame::BusIndex;
use crate::prove::{ProofSwitches, Prover};
use crate::shell::store::{Store, write_new};
use crate::text::{counted, printable_path};
use crate::time::Instant;
use std::collections::VecDeque;
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
    if let Some(device) = &args.device {
        check_address(device)?;
    }
    if args.reboot && !may_ask() {
        let text = "--reboot asks to switch the device off and on, and there is no terminal";
        return Err(Failure::Usage(text.to_owned()));
    }
    // Other devices on the bus forbid a load, whatever the user says.
    if !looks_for_others(args) {
        require_consent(args)?;
    }
    if let Some(path) = &args.proof {
        for path in [path.clone(), path.with_extension("pcapng")] {
            Store::new(&path).check_new().map_err(|fault| fault.of(printable_path(&path)))?;
        }
    }
    let setup = Setup::for_buses(&args.common, buses)?;
    let mut proof = DeviceProof::new();
    let CommandRun { app, is_interrupted } =
        one_bus::run(&args.bus, setup, args.time, |app, now, end| {
            proof.advance(app, args, (now, end))
        })?;
    proof.progress.clear();
    if is_interrupted {
        proof.note_interruption(&app);
        if proof.proven.is_empty() {
            return Ok(EXIT_INTERRUPTED);
        }
    }
    if proof.is_declined {
        say("nothing was sent to the device");
        return Ok(EXIT_FINDINGS);
    }
    let untested = is_interrupted.then_some(proof.waiting.len());
    let report = ProofReport::new(&app, &proof.proven, untested);
    print(&report, args)?;
    if let Some(path) = args.proof.as_deref().filter(|_| report.has_findings()) {
        write_proof(&app, &report, &proof.proven, path)?;
    }
    Ok(if is_interrupted {
        EXIT_INTERRUPTED
    } else if report.has_findings() {
        EXIT_FINDINGS
    } else {
        EXIT_OK
    })
}

fn print(report: &ProofReport, args: &ProveArgs) -> Result<(), Failure> {
    if let Some(format) = args.report {
        let name = format!("descan prove {}", report.bus());
        output::print(&test_report(&name, &report.cases(), format))?;
    } else if args.json {
        let json = serde_json::to_string_pretty(&report).map_err(anyhow::Error::from)?;
        output::print_json(&(json + "\n"))?;
    } else {
        return output::print(&report.text());
    }
    if let Some(sentence) = report.incomplete() {
        say(sentence);
    }
    Ok(())
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
    let text = report.markdown(&printable_path(&frames));
    write_new(&frames, None, |file| file.write_all(&bytes))
        .map_err(|it| it.of(printable_path(&frames)))?;
    write_new(path, None, |file| file.write_all(text.as_bytes()))
        .map_err(|it| it.of(printable_path(path)))?;
    say(format!("saved: {} and {}", printable_path(path), printable_path(&frames)));
    Ok(())
}

/// The tests on demand.
fn switches(args: &ProveArgs) -> ProofSwitches {
    ProofSwitches { disrupts: args.disrupt_device, loads: args.load, reboots: args.reboot }
}

/// Returns true if the user is asked before the tests begin.
fn needs_consent(args: &ProveArgs) -> bool {
    (args.disrupt_device || args.load) && !args.yes
}

/// Returns true if the devices on the bus decide whether the tests may be made.
fn looks_for_others(args: &ProveArgs) -> bool {
    args.load && !args.bench
}

/// Refuses tests that need a question which cannot be asked.
fn require_consent(args: &ProveArgs) -> Result<(), Failure> {
    if needs_consent(args) && !may_ask() {
        let text = "it asks before it disturbs the device, and there is no terminal: give --yes";
        return Err(Failure::Usage(text.to_owned()));
    }
    Ok(())
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
fn refuse_load(app: &App, args: &ProveArgs, tested: &[DeviceId]) -> Result<(), Failure> {
    let Some(bus) = app.bus(BUS) else { return Ok(()) };
    let is_other = |it: &&Device| it.is_present() && tested != [it.id];
    let others = bus.devices().iter().filter(is_other).count() as u64;
    if others == 0 {
        return Ok(());
    }
    let others = counted(others, "other device");
    let more = if needs_consent(args) && !may_ask() { " and --yes" } else { "" };
    let text = format!("--load: {others} on the bus; on a test bench give --bench{more}");
    Err(Failure::Unusable(text))
}

/// How far the tests are.
struct DeviceProof {
    /// Devices that are still to be tested.
    waiting: VecDeque<DeviceId>,
    is_found: bool,
    running: Option<DeviceId>,
    proven: Vec<ProvenDevice>,
    progress: ProofProgress,
    switch_instruction: SwitchInstruction,
    /// The answer of the user, who is asked.
    asked: Option<Receiver<bool>>,
    is_declined: bool,
}

/// The last instruction about the power switch of the device that was shown.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum SwitchInstruction {
    Nothing,
    Off,
    On,
}

impl DeviceProof {
    fn new() -> Self {
        Self {
            waiting: VecDeque::new(),
            is_found: false,
            running: None,
            proven: Vec::new(),
            progress: ProofProgress::new(),
            switch_instruction: SwitchInstruction::Nothing,
            asked: None,
            is_declined: false,
        }
    }

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
            if looks_for_others(args) {
                refuse_load(app, args, self.waiting.make_contiguous())?;
                require_consent(args)?;
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
        if let Some(id) = self.running {
            // One may have joined since the tests began.
            if looks_for_others(args) && app.prover().is_some_and(Prover::is_loading) {
                refuse_load(app, args, &[id])?;
            }
            if !self.watch(app, now) {
                return Ok(false);
            }
            self.end_device(app, id);
        }
        let Some(id) = self.waiting.pop_front() else { return Ok(true) };
        app.start_prover(id, switches(args)).map_err(Failure::Unusable)?;
        (self.running, self.switch_instruction) = (Some(id), SwitchInstruction::Nothing);
        self.progress.begin(now);
        Ok(false)
    }

    /// Says how far the tests of a device are, and when to switch it; returns true once they are over.
    fn watch(&mut self, app: &App, now: Instant) -> bool {
        let Some(prover) = app.prover() else { return true };
        let (wanted, text) = match prover.power_switch() {
            None => (SwitchInstruction::Nothing, ""),
            Some(false) => (SwitchInstruction::Off, "off, for 5 s"),
            Some(true) => (SwitchInstruction::On, "on again"),
        };
        if wanted > self.switch_instruction {
            self.switch_instruction = wanted;
            self.progress.clear();
            say(format!("switch the device at {} {text}", prover.device()));
        }
        self.progress.show(prover, now);
        prover.is_over()
    }

    fn end_device(&mut self, app: &App, id: DeviceId) {
        if let Some(prover) = app.prover() {
            self.proven.push(ProvenDevice::new(app, id, prover));
        }
        self.running = None;
    }

    /// Takes the verdicts so far of the device that is being tested.
    fn note_interruption(&mut self, app: &App) {
        if let Some(id) = self.running {
            self.end_device(app, id);
        }
    }
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
