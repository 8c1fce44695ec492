//! `descan identify`, `mode`, `restart`, `address`, `bitrate` and `descriptor`: one command to one
//! device, or what it says of itself. Waits until the device is found, asks, sends once, and waits
//! for the response.

use super::headless::warn_foreign;
use super::one_bus::{self, CommandRun};
use super::open::{self, Setup};
use super::output::{self, answer, ask, may_ask, say};
use super::report::{DescriptorReport, of_descriptor};
use super::{EXIT_FINDINGS, EXIT_INTERRUPTED, EXIT_OK, Failure};
use crate::app::{App, DeviceCommand, parse_address};
use crate::cli::DeviceArgs;
use crate::discovery::{Device, DeviceId, FieldContent, RequestOutcome};
use crate::frame::BusIndex;
use crate::text::{hex, join_first};
use crate::time::Instant;
use crate::wire::descriptor::DescriptorField;
use serde::Serialize;
use std::sync::mpsc::{Receiver, TryRecvError};

/// Devices that a message names; the others are counted.
const NAMED_DEVICES: usize = 12;

/// What a device is asked for.
#[derive(Clone, Copy, Debug)]
pub enum DeviceTask {
    /// A command, after the user's consent.
    Send(DeviceCommand),
    /// A field of its descriptor, or all.
    Read(Option<DescriptorField>),
}

/// Sets the address with which a device starts; reads it without a setting.
pub fn set_address(args: &DeviceArgs, setting: &[String]) -> Result<u8, Failure> {
    let task = if setting.is_empty() {
        DeviceTask::Read(Some(DescriptorField::Address))
    } else {
        let setting = DeviceCommand::parse_address(&words(setting)).map_err(Failure::Usage)?;
        DeviceTask::Send(DeviceCommand::Address(setting))
    };
    run(args, task)
}

/// Sets the bit rate with which a device starts; reads it without a setting.
pub fn set_bitrate(args: &DeviceArgs, setting: &[String]) -> Result<u8, Failure> {
    let task = if setting.is_empty() {
        DeviceTask::Read(Some(DescriptorField::Bitrate))
    } else {
        let setting = DeviceCommand::parse_bitrate(&words(setting)).map_err(Failure::Usage)?;
        DeviceTask::Send(DeviceCommand::Bitrate(setting))
    };
    run(args, task)
}

fn words(setting: &[String]) -> Vec<&str> {
    setting.iter().flat_map(|text| text.split_whitespace()).collect()
}

/// How far it is.
enum CommandStage {
    /// The device is looked for.
    Searching,
    /// The user is asked.
    Asking(DeviceId, Receiver<bool>),
    /// Its end is awaited.
    Waiting(DeviceId),
    /// The user said no.
    Declined,
    /// It ended.
    Done(DeviceId),
}

/// Runs it.
pub fn run(args: &DeviceArgs, task: DeviceTask) -> Result<u8, Failure> {
    let is_read = matches!(task, DeviceTask::Read(_));
    if !is_read && !args.yes && !may_ask() {
        let text = "it asks before it sends, and there is no terminal: give --yes";
        return Err(Failure::Usage(text.to_owned()));
    }
    let buses = std::slice::from_ref(&args.bus);
    if open::log(buses, "a command", None)?.is_some() {
        return Err(Failure::Usage("a log has no device to send to".to_owned()));
    }
    if args.common.listen_only {
        return Err(Failure::Unusable("listen-only: no requests are sent".to_owned()));
    }
    check_address(&args.device)?;
    let setup = Setup::for_buses(&args.common, buses)?;
    let mut stage = CommandStage::Searching;
    let CommandRun { app, is_interrupted } =
        one_bus::run(&args.bus, setup, args.time, |app, now, end| {
            advance(&mut stage, app, args, task, (now, end))?;
            Ok(matches!(stage, CommandStage::Done(_) | CommandStage::Declined))
        })?;
    if is_interrupted {
        return Ok(EXIT_INTERRUPTED);
    }
    if let CommandStage::Done(device) = stage {
        return report(&app, device, task, args.json);
    }
    say("nothing was sent");
    Ok(EXIT_FINDINGS)
}

/// Takes the next step, if it is time for it.
fn advance(
    stage: &mut CommandStage,
    app: &mut App,
    args: &DeviceArgs,
    task: DeviceTask,
    (now, end): (Instant, Instant),
) -> Result<(), Failure> {
    let next = match stage {
        CommandStage::Searching => match find(app, &args.device, now >= end)? {
            Some(device) => begin(app, device, task, args.yes)?,
            None if now < end => return Ok(()),
            None => {
                warn_foreign(app, &mut Vec::new());
                return Err(Failure::Unusable(not_found(app, &args.device)));
            }
        },
        CommandStage::Asking(device, answer) => match answer.try_recv() {
            Ok(true) => start(app, *device, task)?,
            Ok(false) | Err(TryRecvError::Disconnected) => CommandStage::Declined,
            Err(TryRecvError::Empty) => return Ok(()),
        },
        CommandStage::Waiting(device) if is_ended(app, *device, task) => {
            CommandStage::Done(*device)
        }
        CommandStage::Waiting(_) | CommandStage::Declined | CommandStage::Done(_) => return Ok(()),
    };
    *stage = next;
    Ok(())
}

/// Asks, or starts at once.
fn begin(
    app: &mut App,
    device: DeviceId,
    task: DeviceTask,
    yes: bool,
) -> Result<CommandStage, Failure> {
    let DeviceTask::Send(command) = task else { return start(app, device, task) };
    if let Some(why) = app.command_obstacle(device, command) {
        return Err(Failure::Unusable(why));
    }
    let (sent, effect) = app.command_sentences(device, command);
    app.note_asked(device);
    if yes {
        say(format!("{sent}. {effect}"));
        return start(app, device, task);
    }
    ask(format!("{sent}? {effect} [y/N]"));
    Ok(CommandStage::Asking(device, answer()))
}

/// Sends it.
fn start(app: &mut App, device: DeviceId, task: DeviceTask) -> Result<CommandStage, Failure> {
    match task {
        DeviceTask::Send(command) => app.send_command(device, command),
        DeviceTask::Read(field) => app.read_descriptor(device, field).map(|_| ()),
    }
    .map_err(Failure::Unusable)?;
    Ok(CommandStage::Waiting(device))
}

fn is_ended(app: &App, device: DeviceId, task: DeviceTask) -> bool {
    match task {
        DeviceTask::Send(_) => app.ended_commands().next().is_some(),
        DeviceTask::Read(_) => app.is_descriptor_read(device),
    }
}

/// Returns the device that an argument names, by its name, UID or address, once the rounds at start
/// are over; `is_last`: as far as it is known.
///
/// # Errors
///
/// Several devices fit.
pub(super) fn find(app: &App, wanted: &str, is_last: bool) -> Result<Option<DeviceId>, Failure> {
    let Some(bus) = app.bus(BusIndex(0)) else { return Ok(None) };
    let is_it = |device: &&Device| {
        let name = device.name.as_ref().map(ToString::to_string);
        let uid = device.uid.map(|uid| uid.text(&bus.config().profile.uid).to_string());
        let number = parse_address(wanted.strip_prefix('@').unwrap_or(wanted));
        device.is_present()
            && (name.as_deref() == Some(wanted)
                || uid.as_deref() == Some(wanted)
                || number == Some(device.address.number()))
    };
    let found: Vec<&Device> = bus.devices().iter().filter(is_it).collect();
    // Another one of the same name, or at the same address, may be found later.
    let is_over = is_last || bus.progress().is_complete && app.is_observed(bus);
    match &found[..] {
        [] => Ok(None),
        [device] => Ok(is_over.then_some(device.id)),
        several => {
            let places = several.iter().map(|device| format!("at {}", device.address));
            let places = join_first(places.collect(), NAMED_DEVICES, " and ");
            Err(Failure::Usage(format!(
                "several devices are {wanted}, {places}: give the address of one, as @12"
            )))
        }
    }
}

/// Refuses an argument for a device that is an address in any case, but none that a device has.
pub(super) fn check_address(wanted: &str) -> Result<(), Failure> {
    match wanted.strip_prefix('@') {
        Some(address) if parse_address(address).is_none() => {
            Err(Failure::Usage(format!("{wanted}: no such address; addresses are @1 to @127")))
        }
        _ => Ok(()),
    }
}

/// How addresses are written, for the message about a name that looks like a number; empty for other
/// names.
fn number_hint(wanted: &str) -> String {
    let digits = wanted.trim_start_matches('#');
    let hex = digits.strip_prefix("0x").or_else(|| digits.strip_suffix(['h', 'H']));
    let number = match hex {
        Some(hex) => u32::from_str_radix(hex, 16),
        None => digits.parse::<u32>(),
    };
    match number {
        Ok(number @ 1..=127) => format!("; for the address give @{number}"),
        Ok(_) => "; addresses are 1 to 127, as @12".to_owned(),
        Err(_) => String::new(),
    }
}

/// Says that no device fits, and which there are.
pub(super) fn not_found(app: &App, wanted: &str) -> String {
    let bus = app.bus(BusIndex(0));
    let devices = bus.map_or(&[][..], |bus| bus.devices());
    let mut present: Vec<&Device> = devices.iter().filter(|it| it.is_present()).collect();
    present.sort_by_key(|device| device.address);
    let known = present.into_iter().map(|device| {
        let name = device.name.as_ref().map_or("?".to_owned(), ToString::to_string);
        format!("{name} at {}", device.address)
    });
    let known: Vec<String> = known.collect();
    if known.is_empty() {
        return format!("{wanted} was not found: no device is on the bus");
    }
    let known = join_first(known, NAMED_DEVICES, ", ");
    format!("{wanted} was not found; there are {known}{}", number_hint(wanted))
}

/// A command, as JSON.
#[derive(Serialize)]
struct CommandReport<'a> {
    descan: &'static str,
    bus: &'a str,
    address: Option<u8>,
    name: Option<String>,
    command: String,
    /// The frame; `null` if it was not sent.
    frame: Option<String>,
    /// `responded`, `refused`, `no-response` or `not-sent`.
    outcome: &'static str,
    /// Data of the response, as hexadecimal digits.
    data: Option<String>,
}

/// A descriptor, as JSON.
#[derive(Serialize)]
struct ReadReport<'a> {
    descan: &'static str,
    bus: &'a str,
    address: u8,
    name: Option<String>,
    descriptor: DescriptorReport,
}

fn report(app: &App, id: DeviceId, task: DeviceTask, is_json: bool) -> Result<u8, Failure> {
    let descan = env!("CARGO_PKG_VERSION");
    let Some(bus) = app.bus(id.bus) else { return Ok(EXIT_FINDINGS) };
    let device = app.device(id);
    let name = device.and_then(|device| device.name.as_ref()).map(ToString::to_string);
    let address = device.map(|device| device.address.number());
    let print_json = |json: serde_json::Result<String>| -> Result<(), Failure> {
        output::print_json(&(json.map_err(anyhow::Error::from)? + "\n"))
    };
    match task {
        DeviceTask::Send(_) => {
            let Some(ended) = app.ended_commands().last() else { return Ok(EXIT_FINDINGS) };
            let (outcome, data) = match &ended.outcome {
                RequestOutcome::Responded(data) => ("responded", Some(data)),
                RequestOutcome::Refused(data) => ("refused", Some(data)),
                RequestOutcome::NoResponse => ("no-response", None),
                RequestOutcome::NotSent(_) => ("not-sent", None),
            };
            let frame = ended.frame.map(|frame| frame.to_string());
            if is_json {
                print_json(serde_json::to_string_pretty(&CommandReport {
                    descan,
                    bus: &bus.name,
                    address,
                    name,
                    command: ended.command.to_string(),
                    frame,
                    outcome,
                    data: data.map(|data| hex(data, "")),
                }))?;
            } else {
                let sent = frame.map(|frame| format!(" ({frame})")).unwrap_or_default();
                output::print(&format!("{}{sent}: {}\n", ended.command, ended.text))?;
            }
            let is_done = matches!(ended.outcome, RequestOutcome::Responded(_));
            Ok(if is_done { EXIT_OK } else { EXIT_FINDINGS })
        }
        DeviceTask::Read(field) => {
            let Some(device) = device else { return Ok(EXIT_FINDINGS) };
            if is_json {
                print_json(serde_json::to_string_pretty(&ReadReport {
                    descan,
                    bus: &bus.name,
                    address: device.address.number(),
                    name,
                    descriptor: of_descriptor(&device.descriptor, app, bus),
                }))?;
            } else {
                output::print(&descriptor_table(device, field, app))?;
            }
            let readings = device.descriptor.readings().iter();
            let mut asked = readings.filter(|it| field.is_none_or(|field| field == it.field));
            let is_done = asked.all(|it| matches!(it.content, FieldContent::Value(_)));
            Ok(if is_done { EXIT_OK } else { EXIT_FINDINGS })
        }
    }
}

/// A line for each field that was read.
fn descriptor_table(device: &Device, only: Option<DescriptorField>, app: &App) -> String {
    let profile = app.profile(device.id.bus);
    let readings = device.descriptor.readings().iter();
    let lines = readings.filter(|reading| only.is_none_or(|field| field == reading.field));
    let lines = lines.map(|reading| {
        let text = reading.content.in_words(&profile.uid);
        format!("{:9}  {text}\n", reading.field.label())
    });
    lines.collect()
}
