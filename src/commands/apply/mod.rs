//! `descan apply`: gives the devices of a bus the addresses of des.json, or of a plan's file; or
//! des.json those of the bus. Waits for the devices, prints the plan, asks, and prints each step as it
//! ends.

mod plan_report;

use super::gate::FileGate;
use super::headless::warn_foreign;
use super::one_bus::{self, CommandRun};
use super::open::{self, Setup};
use super::output::{self, answer, ask, may_ask, say};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure};
use crate::address_plan::{DeviceIdentity, LeftOutReason, PlanRecord, PlanRun, RunState};
use crate::app::{App, Bus, EntryPlace, PlanStart, PlanTask, key_needed};
use crate::cli::ApplyArgs;
use crate::discovery::{Device, OwnAddress};
use crate::document::Operation;
use crate::frame::BusIndex;
use crate::shell::plan_files::{is_plan_of, latest_plan, plans_folder, read_plan};
use crate::text::{counted, join_first, printable};
use crate::time::Instant;
use crate::wire::profile::ProfileKey;
use plan_report::{ApplyReport, PinReport, UnpinnedReport, print_json, print_steps, table};
use std::sync::mpsc::{Receiver, TryRecvError};

/// The bus: there is one.
const BUS: BusIndex = BusIndex(0);

/// How far it is.
enum ApplyStage {
    /// The devices are looked for.
    Searching,
    /// Their settings are read.
    Reading,
    /// The user is asked.
    Asking(Receiver<bool>),
    /// Steps are done; so many were printed.
    Running(usize),
    /// The edits of des.json are being saved.
    Saving,
    /// Nothing is to be done, or the user said no, or only the plan was wanted.
    Over,
    /// The run, or the save, ended.
    Done,
}

struct Apply<'a> {
    args: &'a ApplyArgs,
    task: PlanTask,
    stage: ApplyStage,
    file: FileGate,
    pins: Vec<Operation>,
    /// The entries whose devices are not known for sure.
    unpinned: Vec<(String, LeftOutReason)>,
    has_declined: bool,
    /// des.json has mistakes: some of its addresses may be missing.
    has_mistakes: bool,
}

/// Runs it.
pub fn run(args: &ApplyArgs) -> Result<u8, Failure> {
    if !args.yes && !args.dry_run && !may_ask() {
        let text = "it asks before it writes, and there is no terminal: give --yes or --dry-run";
        return Err(Failure::Usage(text.to_owned()));
    }
    let buses = std::slice::from_ref(&args.bus);
    if open::log(buses, "apply", None)?.is_some() {
        return Err(Failure::Usage("a log has no device to write to".to_owned()));
    }
    let mut setup = Setup::for_buses(&args.common, buses)?;
    if let Some(file) = &args.des_json {
        setup.file.clone_from(file);
    }
    if !args.from_bus {
        if args.common.listen_only {
            return Err(Failure::Unusable("listen-only: no requests are sent".to_owned()));
        }
        require_key(&setup, ProfileKey::WriteAddress, "apply")?;
        if args.restart {
            require_key(&setup, ProfileKey::Reboot, "--restart")?;
        }
    }
    let task = task(args)?;
    let (file, pins) = (FileGate::default(), Vec::new());
    let stage = ApplyStage::Searching;
    let (has_declined, has_mistakes) = (false, false);
    let unpinned = Vec::new();
    let mut apply = Apply { args, task, stage, file, pins, unpinned, has_declined, has_mistakes };
    let CommandRun { app, is_interrupted } =
        one_bus::run(&args.bus, setup, args.time, |app, now, end| {
            apply.advance(app, now, end)?;
            Ok(matches!(apply.stage, ApplyStage::Over | ApplyStage::Done))
        })?;
    if is_interrupted {
        if let ApplyStage::Running(_) = apply.stage {
            say(format!("interrupted; go on with: descan apply {} --resume", args.bus));
        }
        return Ok(EXIT_INTERRUPTED);
    }
    apply.report(&app)
}

fn require_key(setup: &Setup, key: ProfileKey, what: &str) -> Result<(), Failure> {
    if setup.config.profile.is_given(key) {
        return Ok(());
    }
    Err(Failure::Unusable(format!("{what} {}", key_needed(key))))
}

/// Returns what the devices are to get; reads the plan that goes on or is taken back.
fn task(args: &ApplyArgs) -> Result<PlanTask, Failure> {
    let bus = args.bus.to_string();
    let find = |wanted: &str| -> Result<(String, PlanRecord), Failure> {
        let found = if wanted.is_empty() { latest_plan(&bus)? } else { Some(read_plan(wanted)?) };
        if let Some((name, record)) = found.as_ref().filter(|it| !is_plan_of(&it.1, &bus)) {
            let of = printable(record.bus.as_bytes());
            return Err(Failure::Usage(format!("{name} is a plan of {of}, not of {bus}")));
        }
        found.ok_or_else(|| {
            let folder = plans_folder().unwrap_or_default();
            Failure::Unusable(format!("no plan of {bus} in {}", folder.display()))
        })
    };
    match (&args.resume, &args.undo) {
        (Some(wanted), _) => {
            let (name, record) = find(wanted)?;
            Ok(PlanTask::Resume(Box::new(record), name))
        }
        (_, Some(wanted)) => {
            let (name, record) = find(wanted)?;
            Ok(PlanTask::TakeBack(Box::new(record), name))
        }
        _ => Ok(PlanTask::ToFile),
    }
}

impl Apply<'_> {
    /// Takes the next step, if it is time for it.
    fn advance(&mut self, app: &mut App, now: Instant, end: Instant) -> Result<(), Failure> {
        match &mut self.stage {
            ApplyStage::Searching => {
                let is_usable = self.task != PlanTask::ToFile || self.file.allows(app, now)?;
                if is_usable && (is_found(app, &self.task) || now >= end) {
                    self.begin(app)?;
                }
            }
            ApplyStage::Reading => {
                let Some(session) = app.address_plan() else { return Ok(()) };
                if let Some(why) = session.problem() {
                    let rest = "remove the file, or give --forget-absent";
                    return Err(Failure::Unusable(format!("{why}; {rest}")));
                }
                if !session.is_reading() {
                    let unread: Vec<String> =
                        session.unread().iter().map(ToString::to_string).collect();
                    if !unread.is_empty() {
                        let unread = join_first(unread, 8, ", ");
                        say(format!(
                            "no setting was read from {unread}: each counts as one that has stored \
                             its address"
                        ));
                    }
                    self.show_plan(app)?;
                }
            }
            ApplyStage::Asking(answer) => match answer.try_recv() {
                Ok(true) => self.start(app)?,
                Ok(false) | Err(TryRecvError::Disconnected) => {
                    self.has_declined = true;
                    self.stage = ApplyStage::Over;
                }
                Err(TryRecvError::Empty) => {}
            },
            ApplyStage::Running(printed) => {
                let Some(session) = app.address_plan() else { return Ok(()) };
                print_steps(session, printed, self.args.json)?;
                if !session.is_running() && session.is_stored() {
                    self.stage = ApplyStage::Done;
                }
            }
            ApplyStage::Saving => {
                let file = app.file();
                if let Some(problem) = file.problem() {
                    return Err(Failure::Unusable(format!("{}: {problem}", file.name())));
                }
                if file.is_settled() && !file.is_saving() {
                    self.stage = ApplyStage::Done;
                }
            }
            ApplyStage::Over | ApplyStage::Done => {}
        }
        Ok(())
    }

    fn begin(&mut self, app: &mut App) -> Result<(), Failure> {
        warn_foreign(app, &mut Vec::new());
        if self.task == PlanTask::ToFile {
            self.tell_mistakes(app);
        }
        if self.args.from_bus {
            return self.show_pins(app);
        }
        if self.args.forget_absent {
            app.forget_absent_devices();
        }
        app.prepare_plan(BUS, self.task.clone(), self.args.restart).map_err(Failure::Unusable)?;
        self.stage = ApplyStage::Reading;
        Ok(())
    }

    /// Names what is wrong in des.json.
    fn tell_mistakes(&mut self, app: &App) {
        let file = app.file();
        for finding in app.file_mistakes(app.file_of_bus(BUS)) {
            self.has_mistakes = true;
            say(format!("{}, {}: {}", file.name(), finding.position, finding.message));
        }
    }

    fn show_plan(&mut self, app: &mut App) -> Result<(), Failure> {
        let Some(session) = app.address_plan() else { return Ok(()) };
        match (self.args.json, self.args.yes) {
            (false, _) => output::print(&table(app, session))?,
            (true, false) => say(table(app, session).trim_end()),
            (true, true) => {}
        }
        if session.plan().steps.is_empty() || self.args.dry_run {
            self.stage = ApplyStage::Over;
            return Ok(());
        }
        let question = app.plan_question().unwrap_or_default();
        self.ask_or_start(app, &question)
    }

    fn show_pins(&mut self, app: &mut App) -> Result<(), Failure> {
        (self.pins, self.unpinned) = app.pins_of_bus(BUS);
        if !self.args.json {
            for pin in &self.pins {
                output::print(&format!("{pin}\n"))?;
            }
        }
        for (name, reason) in &self.unpinned {
            say(format!("left out: {name}: {reason}"));
        }
        if self.pins.is_empty() || self.args.dry_run {
            self.stage = ApplyStage::Over;
            return Ok(());
        }
        let edits = counted(self.pins.len() as u64, "address");
        let question = format!("Pin {edits} in {}? Nothing is sent.", app.file().name());
        self.ask_or_start(app, &question)
    }

    fn ask_or_start(&mut self, app: &mut App, question: &str) -> Result<(), Failure> {
        if self.args.yes {
            say(question);
            return self.start(app);
        }
        ask(format!("{question} [y/N]"));
        self.stage = ApplyStage::Asking(answer());
        Ok(())
    }

    fn start(&mut self, app: &mut App) -> Result<(), Failure> {
        if self.args.from_bus {
            // A device may have moved while the question was open.
            if app.pins_of_bus(BUS).0 != self.pins {
                say("the addresses of the bus have changed");
                return self.show_pins(app);
            }
            app.pin_bus(BUS, &self.pins);
            self.stage = ApplyStage::Saving;
            return Ok(());
        }
        match app.start_plan().map_err(Failure::Unusable)? {
            PlanStart::Started => self.stage = ApplyStage::Running(0),
            PlanStart::Changed(change) => {
                say(change);
                self.show_plan(app)?;
            }
        }
        Ok(())
    }

    /// Prints the end, and returns the exit code.
    fn report(&self, app: &App) -> Result<u8, Failure> {
        if self.args.from_bus {
            return self.report_pins(app);
        }
        let Some(session) = app.address_plan() else { return Ok(EXIT_FINDINGS) };
        if self.args.json {
            print_json(&ApplyReport::new(app, session))?;
        }
        let state = session.run().map(PlanRun::state);
        let plan = session.plan();
        let pins_nothing =
            self.task == PlanTask::ToFile && plan.steps.is_empty() && plan.left_out.is_empty();
        match state {
            None if self.has_declined => say("nothing was written"),
            None if session.plan().leaves_out() && session.plan().steps.is_empty() => {
                say("no step can be done: see what is left out");
            }
            None if pins_nothing => {
                let file = app.file().name();
                say(format!("nothing to do: {file} pins no address on {}", self.args.bus));
            }
            None if session.plan().steps.is_empty() && self.has_mistakes => {
                say(format!("nothing to do, as far as {} is right", app.file().name()));
            }
            None if session.plan().steps.is_empty() => say("nothing to do"),
            None => {}
            Some(state) => {
                let text = match state {
                    RunState::Done => session.run().map_or("", PlanRun::end_text).to_owned(),
                    RunState::Stopped(cause) => format!("stopped: {cause}"),
                    RunState::Stored => "stored: restart all devices at once, then check with: \
                                         descan apply --resume"
                        .to_owned(),
                    RunState::Running => "not finished".to_owned(),
                };
                say(text);
                if let Some(name) = session.file_name() {
                    let folder = plans_folder().unwrap_or_default();
                    say(format!("plan: {}", folder.join(name).display()));
                }
            }
        }
        let is_done = match state {
            None => self.args.dry_run || session.plan().steps.is_empty(),
            Some(state) => *state == RunState::Done,
        };
        let is_all = is_done && !session.plan().leaves_out() && !self.has_mistakes && !pins_nothing;
        Ok(if is_all { EXIT_OK } else { EXIT_FINDINGS })
    }

    fn report_pins(&self, app: &App) -> Result<u8, Failure> {
        if self.args.json {
            let is_saved = matches!(self.stage, ApplyStage::Done);
            let edits = self.pins.iter().map(ToString::to_string).collect();
            let file = app.file().name().clone();
            let left_out = self.unpinned.iter().map(UnpinnedReport::new).collect();
            let descan = env!("CARGO_PKG_VERSION");
            print_json(&PinReport { descan, file, edits, left_out, is_saved })?;
        }
        match self.stage {
            _ if self.has_declined => say("nothing was written"),
            _ if self.pins.is_empty() && !self.unpinned.is_empty() => say("nothing is pinned"),
            _ if self.pins.is_empty() => {
                say(format!("{} has the addresses of the bus", app.file().name()));
            }
            ApplyStage::Done => say(format!("saved: {}", app.file().name())),
            _ => {}
        }
        let is_all = !self.has_declined && !self.has_mistakes && self.unpinned.is_empty();
        Ok(if is_all { EXIT_OK } else { EXIT_FINDINGS })
    }
}

/// Returns true if the rounds at start are over and all devices are found.
fn is_found(app: &App, task: &PlanTask) -> bool {
    let Some(bus) = app.bus(BUS) else { return false };
    matches!(bus.own_address(), OwnAddress::Held(_))
        && bus.progress().is_complete
        && app.is_observed(bus)
        && !is_missing(app, bus, task)
}

fn is_missing(app: &App, bus: &Bus, task: &PlanTask) -> bool {
    match task {
        PlanTask::ToFile => {
            let entries = app.file().document().entries().iter();
            let mut pinned = entries.filter(|it| it.is_static && it.is_for_bus(&bus.name));
            pinned.any(|entry| {
                // A device is known to be the listed one by its UID alone, where the entry has one.
                let needs_uid = entry.trimmed_uid().is_some();
                let is_there = |it: &Device| it.is_present() && (!needs_uid || it.uid.is_some());
                let place = EntryPlace { file: app.file_of_bus(BUS), index: entry.index };
                let mut devices = app.matching().devices_of(place).iter();
                !app.matching().is_duplicate(place)
                    && !devices.any(|id| app.device(*id).is_some_and(is_there))
            })
        }
        PlanTask::Resume(record, _) | PlanTask::TakeBack(record, _) => {
            record.devices.iter().any(|recorded| {
                let wanted = recorded.identity();
                !bus.devices().iter().any(|device| {
                    let own = DeviceIdentity { uid: device.uid, name: device.name.clone() };
                    device.is_present() && wanted.is_same(&own)
                })
            })
        }
    }
}
