//! Command line: arguments in, plain options out.
//!
//! Opens and reads no files.

use crate::app::DeviceCommand;
use crate::bitrate;
use crate::bus::{self, BusSpec};
#[cfg(feature = "fleet")]
use crate::fleet::GatewayName;
use crate::guide;
use crate::log::{FORMATS, LogFormat};
#[cfg(feature = "fleet")]
use crate::shell::broker::{BrokerAccess, BrokerAddress};
use crate::shell::recorder::Size;
use crate::wire::id::{Address, Service};
use crate::wire::node::Mode;
use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Args, CommandFactory, Parser, Subcommand};
use std::ffi::OsStr;
use std::path::PathBuf;
use std::time::Duration;

/// What the user asked for.
#[derive(Debug, Parser)]
#[command(
    name = "descan",
    bin_name = "descan",
    version,
    about = "Find the devices on a CAN bus, their services, versions and address conflicts; edit static addresses",
    long_about = "Find the devices on a CAN bus with DES, the devices enumeration service: names, services, \
                  versions, modes, address conflicts. Edit static addresses in des.json in place.",
    after_help = EXAMPLES,
    disable_help_subcommand = true,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct Cli {
    /// What to do; without it, the terminal UI on the given buses.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// The buses and how to treat them.
    #[command(flatten)]
    pub session: SessionArgs,
    /// Replay speed of a log: 1 is real time, 10 is ten times as fast
    #[arg(long, value_name = "N", value_parser = speed, allow_negative_numbers = true)]
    pub speed: Option<f64>,
    /// The terminal UI.
    #[command(flatten)]
    pub screen: ScreenArgs,
}

/// What concerns the terminal UI.
#[derive(Debug, Args, Clone)]
pub struct ScreenArgs {
    /// UI theme: terminal | dark | light | high-contrast | mono, or the name of your own
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Memory for captured frames and the past, 1M to 64G: a classic frame takes 24 bytes
    #[arg(long, value_name = "SIZE", value_parser = capture, default_value = "64M")]
    pub capture: Size,
}

const EXAMPLES: &str = "\
Examples:
  descan                        the only CAN interface, in the terminal UI
  descan can0                   can0, in the terminal UI
  descan demo                   a simulated pellet boiler to try it out
  descan scan can0              list the devices as a table
  descan scan can0 --json       the same as JSON, for scripts
  descan check can0             compare the bus with des.json
  descan watch can0             print events as they happen, one per line
  descan diff good.log now.log  list what changed between two logs
  descan log session.log        print the frames of a log, decoded
  descan scan can0 --write des.json
                                create des.json from the bus
  descan session.log            replay a candump log in real time
  ssh board candump -L can0 | descan -
                                a remote bus over SSH

Bring an interface up: sudo ip link set can0 up type can bitrate 125000";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Open the terminal UI on a simulated bus: devices join, move, reboot and conflict
    Demo {
        /// System to simulate
        #[arg(default_value = "boiler", value_parser = ["boiler", "drone"])]
        system: String,
        /// UI and transmit options
        #[command(flatten)]
        session: CommonArgs,
        /// The terminal UI.
        #[command(flatten)]
        screen: ScreenArgs,
    },
    /// Enumerate the devices once and print them as a table
    Scan(ScanArgs),
    /// Compare a bus with des.json, one line per difference
    Check(CheckArgs),
    /// Print events as they happen, one per line
    Watch(WatchArgs),
    /// Publish what is found on buses to an MQTT broker, for descan fleet
    #[cfg(feature = "fleet")]
    Publish(PublishArgs),
    /// Show the gateways that publish to an MQTT broker: devices, versions, findings
    #[cfg(feature = "fleet")]
    Fleet(FleetArgs),
    /// List what changed between two logs, or documents of scan --json
    Diff(DiffArgs),
    /// Print the frames of a log, decoded, one per line, or their statistics
    Log(LogArgs),
    /// Write a log in another format
    Convert(ConvertArgs),
    /// Simulate the devices of a scenario on a bus, or one device
    Sim(SimArgs),
    /// Let a device blink or beep
    #[command(after_help = "\
Needs commands.identify in a profile. Exit code: as of descan mode.

Examples:
  descan identify can0 FEED --profile line7.toml
  descan identify can0 14 --profile line7.toml --yes")]
    Identify(DeviceArgs),
    /// Set the mode of a device: CFG, BOOT, WORK or IDLE
    #[command(after_help = "\
Needs commands.mode in a profile. Says what is sent and what it does, and asks; --yes does not ask. It is \
sent once.

Exit code: 0 the device responded, 1 it refused, or did not respond, or nothing was sent, 2 wrong usage, \
3 bus or device not usable, 130 interrupted.

Examples:
  descan mode can0 FEED CFG --profile line7.toml
  descan mode can0 BOILER01 IDLE --profile line7.toml --yes --json")]
    Mode {
        /// Bus and device.
        #[command(flatten)]
        device: DeviceArgs,
        /// CFG, BOOT, WORK or IDLE
        #[arg(value_name = "MODE", value_parser = DeviceCommand::parse_mode)]
        mode: Mode,
    },
    /// Restart a device
    #[command(after_help = "\
Needs commands.reboot in a profile. Exit code: as of descan mode.

Example:
  descan restart can0 FEED --profile line7.toml")]
    Restart(DeviceArgs),
    /// Read or set the address with which a device starts
    #[command(after_help = "\
Reads it without a SETTING, which needs descriptor.addr in a profile; a SETTING needs writes.address, and \
is asked for. Exit code: as of descan mode.

Examples:
  descan address can0 FEED --profile line7.toml
  descan address can0 FEED 12 --profile line7.toml
  descan address can0 FEED preferred 12 --profile line7.toml --yes
  descan address can0 FEED none --profile line7.toml")]
    Address {
        /// Bus and device.
        #[command(flatten)]
        device: DeviceArgs,
        /// 12 or fixed 12, preferred 12, none
        #[arg(value_name = "SETTING", num_args = 0..=2)]
        setting: Vec<String>,
    },
    /// Read or set the bit rate with which a device starts
    #[command(after_help = "\
Reads it without a SETTING, which needs descriptor.bspd in a profile; a SETTING needs writes.bitrate, and \
is asked for. Exit code: as of descan mode.

Examples:
  descan bitrate can0 FEED --profile line7.toml
  descan bitrate can0 FEED preferred 250k --profile line7.toml")]
    Bitrate {
        /// Bus and device.
        #[command(flatten)]
        device: DeviceArgs,
        /// 250k or fixed 250k, preferred 250k
        #[arg(value_name = "SETTING", num_args = 0..=2)]
        setting: Vec<String>,
    },
    /// Give the devices of a bus the addresses of des.json
    Apply(ApplyArgs),
    /// Read what a device says of itself: type, firmware, settings
    #[command(after_help = "\
Reads the fields whose service numbers a profile sets: descriptor.gid, descriptor.fw and so on.

Exit code: 0 all have a value, 1 one has none, 2 wrong usage, 3 bus or device not usable, 130 interrupted.

Examples:
  descan descriptor can0 FEED --profile line7.toml
  descan descriptor can0 14 --profile line7.toml --json")]
    Descriptor(DeviceArgs),
    /// Send one frame or request, by fields with names
    #[command(after_help = "\
Says the frame and what it means, and asks; --yes does not ask. A source other than descan's own address is \
a second question. Prints the answers with their latency.

Exit code: 0 sent, and answered where one device must answer; 1 an error response, or no answer; 2 wrong \
usage; 3 bus not usable, or not acknowledged; 130 interrupted. More: descan help send

Examples:
  descan send can0 request des name to FEED
  descan send can0 request des services to @12 --yes
  descan send can0 request 0x123 01 02 to FEED --repeat 100 --every 50 --yes
  descan send can0 request des name to all working --json --yes
  descan send can0 051C0002#0444455301")]
    Send(SendArgs),
    /// Test whether a device keeps the rules of DES and of the platform
    Prove(ProveArgs),
    /// Find the bit rate of a bus, listen-only
    Speed(SpeedArgs),
    /// Print the completion script of a shell
    Completions {
        /// Shell to complete for
        shell: clap_complete::Shell,
    },
    /// Print a manual page, in roff: descan man | man -l -
    Man {
        /// A command or a topic of the guide [default: descan]
        #[arg(value_name = "NAME", value_parser = GuideName, hide_possible_values = true)]
        name: Option<String>,
    },
    /// List the topics of the guide, or print one
    Help {
        /// A command or a topic of the guide
        #[arg(value_name = "NAME", value_parser = GuideName, hide_possible_values = true)]
        name: Option<String>,
    },
    /// Print the built-in profile, a TOML file with comments, or check one
    #[command(after_help = "\
Exit code of check: 0 fine, 1 a mistake in the file, 2 wrong usage, 3 file not readable.

Examples:
  descan profile > line7.toml
  descan profile check line7.toml")]
    Profile {
        /// What to do instead of printing it.
        #[command(subcommand)]
        command: Option<ProfileCommand>,
    },
    /// Write the project file of the buses at hand, descan.toml
    #[command(after_help = "\
Enumerates the buses, as scan does, and writes descan.toml in this folder; one that is there is not \
replaced.

Exit code: 0 written, 2 wrong usage, 3 bus or file not usable, 130 interrupted.

Examples:
  descan init can0 can1
  descan init can0 --profile boiler.toml")]
    Init(InitArgs),
    /// List the types of devices that are known, and mistakes in their files
    #[command(after_help = "\
Exit code: 0 fine, 1 a mistake in a file, 2 wrong usage, 3 file not readable.

Examples:
  descan catalogue
  descan catalogue devices/feeder.toml")]
    Catalogue(CatalogueArgs),
    /// Write the responder for firmware, in C; for that in Rust its configuration
    Kit(KitArgs),
    /// Print the JSON Schema of des.json
    Schema,
}

/// `descan profile`.
#[derive(Debug, Subcommand)]
pub enum ProfileCommand {
    /// Check a profile and list all values with their origin
    Check {
        /// The profile, a TOML file
        file: PathBuf,
        /// Print JSON instead of text
        #[arg(long)]
        json: bool,
    },
    /// Learn values from the frames of a bus or of a log; nothing is sent
    Learn(LearnArgs),
    /// Write what is known of a bus for other programs: Wireshark, and those that read DBC
    Export(ExportArgs),
}

/// `descan profile export`.
#[derive(Debug, Args)]
#[command(after_help = "\
Takes the numbers of the profile and the types of devices of the catalogue; without options those of the \
project. Prints the file, or writes it with --write.

--wireshark: a dissector in Lua, with identifier, DES, ISO-TP, heartbeat, names of devices and services. \
Copy it to the personal Lua plugins of Wireshark 4.0 or later, or give it to tshark; filter with candes.src \
== 12 or candes.name.

--dbc: messages and signals, in ASCII. DBC has no masks: SRC and DST are 0 in the identifiers, so compare \
with the mask 0x1F0003FF (cantools: frame_id_mask).

Exit code: 0 written, 2 wrong usage, 3 file not readable or not written.

Examples:
  descan profile export --wireshark --write candes.lua
  descan profile export --wireshark --profile line7.toml > candes.lua
  descan profile export --dbc --catalogue devices --write line7.dbc")]
pub struct ExportArgs {
    /// A dissector for Wireshark, in Lua
    #[arg(long, required_unless_present = "dbc", conflicts_with = "dbc")]
    pub wireshark: bool,
    /// A DBC file
    #[arg(long)]
    pub dbc: bool,
    /// What the devices use where the protocol leaves values open (TOML) [default: that of the project]
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// A folder with types of devices, in place of devices beside des.json; repeatable
    #[arg(long, value_name = "FOLDER")]
    pub catalogue: Vec<PathBuf>,
    /// Write it to FILE, in place of printing it
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// Replace a FILE with other content
    #[arg(long, requires = "write")]
    pub force: bool,
}

/// `descan kit`.
#[derive(Debug, Args)]
#[command(after_help = "\
Without --write it prints des_config.h: what the device is, and the numbers of the profile. Values that the \
profile does not set are marked as assumed; commands and writes that it does not set are not served. With \
--lang rust it is des_config.rs, a module for the crate descan (feature node).

Exit code: 0 written, 2 wrong usage, 3 file not readable or not written.

Examples:
  descan kit --name PUMP --services FLOW=1.0 --profile line7.toml --write firmware/des
  descan kit --name PUMP --profile line7.toml > des_config.h
  descan kit --name PUMP --profile line7.toml --lang rust --write src")]
pub struct KitArgs {
    /// Name of the device; 5 characters or less fit one frame
    #[arg(long, value_name = "NAME", value_parser = device_name)]
    pub name: String,
    /// Its services besides DES, with versions: A=1.0,B=2
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = version)]
    pub services: Vec<(String, String)>,
    /// What it uses where the protocol leaves values open (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// Language of the firmware
    #[arg(long, value_name = "LANG", value_enum, default_value_t = KitLanguage::C)]
    pub lang: KitLanguage,
    /// Its controller sends CAN FD frames, too; in Rust always
    #[arg(long)]
    pub fd: bool,
    /// Write des.h, des.c and des_config.h, or des_config.rs, to this folder
    #[arg(long, value_name = "DIR")]
    pub write: Option<PathBuf>,
    /// Replace files that have other content
    #[arg(long, requires = "write")]
    pub force: bool,
}

/// Languages of `descan kit`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum KitLanguage {
    /// C99: the responder itself, and its header.
    C,
    /// Rust: the configuration of the node in the crate descan.
    Rust,
}

/// `descan sim`.
#[derive(Debug, Args)]
#[command(after_help = "\
With --device it is one device: its name, its services, and its address, or else one that follows from \
its name. It works as soon as it has its address, and answers requests as the profile says.

Examples:
  descan sim vcan0
  descan sim udp:239.74.163.2 --scenario drone
  descan sim slcan:/dev/ttyACM0@500000 --scenario line.toml --time 60
  descan sim vcan0 --device FEED --services AUGER=2.1,MOTOR=1.4 --node-address 10")]
pub struct SimArgs {
    /// The bus, of a kind that sends.
    #[arg(
        value_name = "BUS",
        help = format!("Bus to simulate the devices on: {}", bus::forms(|kind| kind.can_send))
    )]
    pub bus: BusSpec,
    /// Scenario: boiler, drone or a TOML file [default: boiler]
    #[arg(long, value_name = "SCENARIO", conflicts_with = "device")]
    pub scenario: Option<String>,
    /// One device of this NAME, in place of a scenario
    #[arg(long, value_name = "NAME", value_parser = device_name)]
    pub device: Option<String>,
    /// Its services besides DES, with versions: A=1.0,B=2
    #[arg(long, value_name = "LIST", requires = "device", conflicts_with = "scenario", value_delimiter = ',', value_parser = version)]
    pub services: Vec<(String, String)>,
    /// Its fixed address, 1 to 127
    #[arg(long, value_name = "N", requires = "device", conflicts_with = "scenario", value_parser = node_address)]
    pub node_address: Option<Address>,
    /// What it uses where the protocol leaves values open (TOML)
    #[arg(long, value_name = "FILE", requires = "device", conflicts_with = "scenario")]
    pub profile: Option<PathBuf>,
    /// Stop after SECONDS; without it, run until interrupted
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
}

/// Commands to one device.
#[derive(Debug, Args)]
pub struct DeviceArgs {
    /// The bus.
    #[arg(value_name = "BUS", help = format!("The bus: {}", bus::forms(|kind| kind.can_send)))]
    pub bus: BusSpec,
    /// Name, UID or address of the device; @12 is the address in any case
    #[arg(value_name = "DEVICE", value_parser = device_name)]
    pub device: String,
    /// Send without asking
    #[arg(long)]
    pub yes: bool,
    /// Look for the device for SECONDS [default: 15]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
    /// What it shares with the other commands.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// `descan apply`.
#[derive(Debug, Args)]
#[command(after_help = "\
Needs writes.address in a profile. Prints the plan, asks, and changes one device after the other: each must \
be heard at its new address before the next one is written. Stops at the first surprise and never repeats \
a write. Where writes act at a restart (writes.effect), --restart restarts each device after its write, \
which needs commands.reboot; without it all are stored and in force after a restart of all at once. The \
plan lies in $XDG_STATE_HOME/descan/plans: --resume goes on with it, --undo takes it back.

Exit code: 0 all are confirmed, or nothing is to be done, 1 it stopped, or a device is left out, 2 wrong \
usage, 3 bus, file or profile not usable, 130 interrupted.

Examples:
  descan apply can0 --profile line7.toml --dry-run
  descan apply can0 line7.json --profile line7.toml --yes
  descan apply can0 --profile line7.toml --resume
  descan apply can0 --profile line7.toml --undo=20261121-120036-can0.json
  descan apply can0 --from-bus")]
pub struct ApplyArgs {
    /// The bus.
    #[arg(value_name = "BUS", help = format!("The bus: {}", bus::forms(|kind| kind.can_send)))]
    pub bus: BusSpec,
    /// The des.json file, as --file
    #[arg(value_name = "DES_JSON", conflicts_with = "file", value_hint = clap::ValueHint::FilePath)]
    pub des_json: Option<PathBuf>,
    /// Print the plan and write nothing
    #[arg(long, conflicts_with = "yes")]
    pub dry_run: bool,
    /// Start without asking
    #[arg(long)]
    pub yes: bool,
    /// Restart each device after its write
    #[arg(long, conflicts_with = "from_bus")]
    pub restart: bool,
    /// Go on with the last plan of this bus, or with PLAN
    #[arg(
        long,
        value_name = "PLAN",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "",
        conflicts_with_all = ["des_json", "undo", "from_bus"]
    )]
    pub resume: Option<String>,
    /// Give the devices the addresses they had before the last plan of this bus, or before PLAN
    #[arg(
        long,
        value_name = "PLAN",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "",
        conflicts_with_all = ["des_json", "from_bus"]
    )]
    pub undo: Option<String>,
    /// Take the addresses of devices of earlier plans that are not heard as free
    #[arg(long, conflicts_with = "from_bus")]
    pub forget_absent: bool,
    /// Give the entries of des.json the addresses of the bus, pinned; writes to no device
    #[arg(long)]
    pub from_bus: bool,
    /// Wait at most SECONDS for the devices [default: 15]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
    /// What it shares with the other commands.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// `descan send`.
#[derive(Debug, Args)]
pub struct SendArgs {
    /// The bus.
    #[arg(value_name = "BUS", help = format!("The bus: {}", bus::forms(|kind| kind.can_send)))]
    pub bus: BusSpec,
    /// What is sent: request des name to FEED, or a frame: 051C0002#0444455301
    #[arg(value_name = "WORDS", required = true)]
    pub words: Vec<String>,
    /// Send N copies, at most 1000 [default: 1]
    #[arg(long, value_name = "N", default_value_t = 1, hide_default_value = true)]
    pub repeat: u32,
    /// Send a copy every MS milliseconds, as far as the bus allows [default: 1000]
    #[arg(long, value_name = "MS", default_value_t = 1000, hide_default_value = true)]
    pub every: u32,
    /// Send without asking
    #[arg(long)]
    pub yes: bool,
    /// Wait SECONDS for answers, all of them [default: until answered, at most calls.timeout_ms]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub wait: Option<Duration>,
    /// Look for the device for SECONDS [default: 15]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// Print JSON instead of text, an object a line
    #[arg(long)]
    pub json: bool,
    /// What it shares with the other commands.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// `descan profile learn`.
#[derive(Debug, Args)]
#[command(after_help = "\
Listens for at least 8 s, and prints the values that the frames show, with the evidence of each, and why \
others are not known. Requests of DES are heard only while another tool enumerates the bus. Certain: no \
other value fits; likely: other frames might fit, too; guess: fits so far. Nothing is in force: give the \
written file, which has no guesses, with --profile; values of --profile stay.

With --search it sends: name requests to one device, service by service, some 2000 in two minutes, until \
it answers. The device may take one for a command, so it must be in CFG or BOOT, and the bus may carry \
nothing else. It stops without acknowledgement, at an error warning, or when the device begins to work.

Exit code: 0 a value was learnt, 1 none, 2 wrong usage, 3 bus or file not usable, 130 interrupted.

Examples:
  descan profile learn can0
  descan profile learn can0 --time 60 --write boiler.toml
  descan profile learn can0 --search 12
  descan profile learn file:session.log --json | jq '.proposals[].value'")]
pub struct LearnArgs {
    /// The bus, or the log.
    #[arg(value_name = "BUS", help = bus::forms(|_| true))]
    pub bus: BusSpec,
    /// Search the service number of DES: ask the device at ADDRESS on each service, after a question
    #[arg(long, value_name = "ADDRESS", value_parser = address, allow_negative_numbers = true)]
    pub search: Option<Address>,
    /// First service of the search, as 0x019
    #[arg(long, value_name = "SERVICE", requires = "search", value_parser = service)]
    pub search_from: Option<Service>,
    /// Search without asking
    #[arg(long, requires = "search")]
    pub yes: bool,
    /// Write the values to a new FILE, beside those of --profile; never overwrites
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// Values that are known already (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// Stop after SECONDS (log time for a log) [default: 20; log: its end]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// Start reading a log SECONDS after its first frame
    #[arg(long, value_name = "SECONDS", value_parser = moment, allow_negative_numbers = true)]
    pub from: Option<Duration>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Bounds of `--capture`, in bytes.
const MIN_CAPTURE: u64 = 1_000_000;
const MAX_CAPTURE: u64 = 64_000_000_000;

/// Most devices that `--expect` waits for: those of several buses.
const MAX_EXPECTED: usize = 10_000;

/// `descan scan`.
#[derive(Debug, Args)]
#[command(after_help = "\
Exit code: 0 no confirmed conflict, 1 one or more, or fewer devices than expected, 2 wrong usage, \
3 bus or file not usable.

Examples:
  descan scan can0
  descan scan can0 --json | jq '.devices[].name'
  descan scan can0 --expect 12 --time 60
                                wait until 12 devices are present and named
  descan scan can0 --for 30     devices that boot within 30 s
  descan scan file:session.log --json
  descan scan file:session.log --from 60 --time 24 --write start.json
                                the devices of seconds 60 to 84, in a new file")]
pub struct ScanArgs {
    /// What it shares with the other commands without a screen.
    #[command(flatten)]
    pub run: RunArgs,
    /// Write the devices found to a new FILE; never overwrites
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// Stay for SECONDS, in place of --time: devices that boot meanwhile are found
    #[arg(
        long = "for",
        value_name = "SECONDS",
        value_parser = seconds,
        allow_negative_numbers = true,
        conflicts_with = "time"
    )]
    pub stay: Option<Duration>,
    /// Wait until N devices are present and named, at most --time; debug devices do not count
    #[arg(long, value_name = "N", value_parser = device_count)]
    pub expect: Option<usize>,
}

/// `descan check`.
#[derive(Debug, Args)]
#[command(after_help = "\
Compares the bus with des.json and prints: missing entries; devices at another address than the \
static one, with another name, or not in the file; services and versions that differ, where the file \
has them (order counts in a list); address conflicts.

Exit code: 0 no difference, 1 one or more, 2 wrong usage, 3 bus or file not usable, 130 interrupted.

Examples:
  descan check can0
  descan check can0 --file line7.json --wait-for-all --time 60
  descan check file:session.log --json | jq -r '.findings[].text'")]
pub struct CheckArgs {
    /// What it shares with the other commands without a screen.
    #[command(flatten)]
    pub run: RunArgs,
    /// Wait until every entry has its device, at most --time
    #[arg(long)]
    pub wait_for_all: bool,
    /// Print a report of tests instead of text: junit, tap or github
    #[arg(long, value_name = "FORMAT", conflicts_with = "json")]
    pub report: Option<TestReportFormat>,
    /// Compare what gateways have published: each with FOLDER/GATEWAY/des.json
    #[cfg(feature = "fleet")]
    #[arg(long, value_name = "FOLDER", requires = "broker", conflicts_with_all = [
        "buses", "wait_for_all", "from", "file", "profile", "catalogue", "dbc", "project", "address", "record",
    ])]
    pub fleet: Option<PathBuf>,
    /// The broker of --fleet: mqtts://HOST:PORT, or mqtt:// without TLS
    #[cfg(feature = "fleet")]
    #[arg(long, value_name = "URL", requires = "fleet")]
    pub broker: Option<BrokerAddress>,
    /// What the broker asks of its clients.
    #[cfg(feature = "fleet")]
    #[command(flatten)]
    pub broker_files: BrokerFiles,
}

/// `descan watch`.
#[derive(Debug, Args)]
#[command(after_help = "\
Without --speed, a log is read at full speed; times are those of the log. Lines from standard \
input are processed as they arrive. A bus that goes down or is unplugged after it was open is \
opened again when it returns.

--filter takes the words and fields of the filter line in the UI; all of them must match: at:12,14 \
name:FEED is:confirmed bus:can1 lost !debug. A word matches name, event, state and kind; text:WORD the \
sentence. Bus state, lost frames, descan's own address and \
descan's errors are always printed. With at: and --listen-only, frames of other addresses are \
not read from a SocketCAN interface: other devices are not found, and the bus load is unknown. \
Without --listen-only, and with --record, all frames are read: descan needs them for its own \
address, or to record them.

Exit code: 0 ended by a signal, --time or the end of the log, 2 wrong usage, 3 bus or file not \
usable.

Examples:
  descan watch can0
  descan watch can0 can1 --json --time 60 | jq -c 'select(.event == \"finding\")'
  descan watch can0 --filter at:12 --listen-only
  descan watch file:session.log
  ssh board candump -L can0 | descan watch -")]
pub struct WatchArgs {
    /// What it shares with the other commands without a screen.
    #[command(flatten)]
    pub run: RunArgs,
    /// Replay speed of a log: 1 is real time, 10 is ten times as fast
    #[arg(long, value_name = "N", value_parser = speed, allow_negative_numbers = true)]
    pub speed: Option<f64>,
    /// Print only matching events: at:12,14 | name:FEED | is:confirmed | word | !word ...
    #[arg(long, value_name = "EXPR")]
    pub filter: Option<String>,
}

/// What a broker asks of its clients.
#[cfg(feature = "fleet")]
#[derive(Debug, Args, Clone)]
pub struct BrokerFiles {
    /// Certificates that are trusted, in place of those of the system (PEM)
    #[arg(long, value_name = "FILE", requires = "broker")]
    pub ca: Option<PathBuf>,
    /// Certificate of this client (PEM)
    #[arg(long, value_name = "FILE", requires_all = ["key", "broker"])]
    pub cert: Option<PathBuf>,
    /// Private key of this client (PEM)
    #[arg(long, value_name = "FILE", requires_all = ["cert", "broker"])]
    pub key: Option<PathBuf>,
    /// File with user = "NAME" and password = "PASSWORD" (TOML) [default: the environment,
    /// DESCAN_MQTT_USER and DESCAN_MQTT_PASSWORD]
    #[arg(long, value_name = "FILE", requires = "broker")]
    pub credentials: Option<PathBuf>,
}

#[cfg(feature = "fleet")]
impl BrokerFiles {
    /// What they say about the broker at this address.
    ///
    /// # Errors
    /// Certificates are given, but the address is one without TLS.
    pub fn access(&self, address: &BrokerAddress) -> Result<BrokerAccess, String> {
        if !address.has_tls() && (self.ca.is_some() || self.cert.is_some()) {
            return Err(format!("{address}: certificates need TLS; write mqtts://"));
        }
        Ok(BrokerAccess {
            address: address.clone(),
            ca: self.ca.clone(),
            identity: self.cert.clone().zip(self.key.clone()),
            credentials: self.credentials.clone(),
        })
    }
}

/// `descan publish`.
#[cfg(feature = "fleet")]
#[derive(Debug, Args)]
#[command(mut_arg("buses", |arg| {
    arg.help(format!("{} (several: each in topics of its own)", bus::forms(|kind| !matches!(kind.scheme, "file" | "-"))))
}))]
#[command(after_help = "\
Publishes inventory, findings and bus state as retained JSON under descan/v1/GATEWAY, and events as they \
happen. Only changes are sent. While the broker is away, events wait, at most 10000. Nothing that comes \
from the broker is ever sent to a bus. More: descan help gateways

Exit code: 0 ended by a signal or --time, 2 wrong usage, 3 bus, file or broker not usable, or with --time \
the broker does not have everything at the end.

Examples:
  descan publish can0 --broker mqtts://mqtt.example.org --gateway boiler-17
  descan publish can0 can1 --broker mqtt://localhost --listen-only")]
pub struct PublishArgs {
    /// The buses and how to treat them.
    #[command(flatten)]
    pub session: SessionArgs,
    /// The broker: mqtts://HOST:PORT, or mqtt:// without TLS
    #[arg(long, value_name = "URL")]
    pub broker: BrokerAddress,
    /// Name of this gateway, unlike all others at the broker [default: the host name]
    #[arg(long, value_name = "NAME")]
    pub gateway: Option<GatewayName>,
    /// What the broker asks of its clients.
    #[command(flatten)]
    pub files: BrokerFiles,
    /// Stop after SECONDS
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
}

/// `descan fleet`.
#[cfg(feature = "fleet")]
#[derive(Debug, Args)]
#[command(after_help = "\
Only reads; nothing is published. On a terminal a screen shows all gateways: devices, versions, problems; \
Enter opens a gateway, ? lists the keys. With --json, or without a terminal, it prints what all gateways \
have published, and ends. More: descan help gateways

Exit code: 0 no confirmed conflict, or the screen was left, 1 one or more (without a screen), 2 wrong \
usage, 3 broker not usable, 130 interrupted.

Examples:
  descan fleet --broker mqtts://mqtt.example.org
  descan fleet --broker mqtt://localhost --json | jq -r '.gateways[].name'
  descan check --fleet sites --broker mqtts://mqtt.example.org
                                compare each gateway with sites/GATEWAY/des.json")]
pub struct FleetArgs {
    /// The broker: mqtts://HOST:PORT, or mqtt:// without TLS
    #[arg(long, value_name = "URL")]
    pub broker: BrokerAddress,
    /// What the broker asks of its clients.
    #[command(flatten)]
    pub files: BrokerFiles,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Without a screen: wait at most SECONDS for documents [default: 10, and 35 for an overdue status]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// UI theme: terminal | dark | light | high-contrast | mono, or the name of your own
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
}

/// `descan diff`.
#[derive(Debug, Args)]
#[command(after_help = "\
Compares the state at the end of two logs (of any format), of two documents of descan scan \
--json, or of one of each, and prints: devices that are on one side only, their presence, address, \
name, board (UID), mode, services, versions, heartbeat period (by more than a fifth) and entry in \
des.json; findings; bus load (by more than a fifth), errors and lost frames. A device that moved is \
one row. What one side does not know is named below the rows and is not a difference. Debug devices \
are left out.

Exit code: 0 no difference, 1 one or more, 2 wrong usage, 3 a file cannot be read, 130 interrupted.

Examples:
  descan diff good.log now.log
  descan diff good.json now.log --json | jq -r '.differences[].kind'
  descan scan can0 --json | descan diff good.json -
  ssh board cat /tmp/now.log | descan diff good.log -
Two moments of one log, here 10 s after its start and its end:
  descan log session.log --time 10 --write start.log
  descan diff start.log session.log")]
pub struct DiffArgs {
    /// Log or document to compare with; - is standard input
    #[arg(value_name = "BEFORE", value_hint = clap::ValueHint::FilePath)]
    pub before: PathBuf,
    /// Log or document that is compared with it; - is standard input
    #[arg(value_name = "AFTER", value_hint = clap::ValueHint::FilePath)]
    pub after: PathBuf,
    /// Values the protocol leaves open: service numbers, framing, heartbeat layout (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// Print one JSON object instead of text
    #[arg(long)]
    pub json: bool,
}

/// `descan log`.
#[derive(Debug, Args)]
#[command(after_help = "\
Prints time, bus (if there are several), identifier, kind, sender and receiver, service, length, \
bytes and meaning of each frame; of a response the time since its request. Names are those of the \
frame's moment: a file is read twice, so that a name that is received later holds for earlier frames \
of its device, too. Standard input and pipes are read once, and have the names received so far; so \
does a large file that is to be read once: descan log - < big.log

--filter takes the words and fields of the filter line of the frames: src:FEED type:rsp id:123 \
len:>4 since:12:03 !data:FF (descan help filter).

--stats prints, in place of the frames, the number of each kind, bus errors by kind, the identifiers \
with count, rate, period and jitter, and the calls with latency, unanswered and failed ones. Jitter \
is that of the last 256 intervals, latencies are those of the last 1024 calls.

--write writes the matching frames, as they were, to a new log, in place of printing them.

Exit code: 0 done, 2 wrong usage, 3 the log cannot be read or written, 130 interrupted.

Examples:
  descan log session.log
  descan log session.pcapng --filter 'src:FEED type:failed'
  descan log session.log --from 60 --time 5
                                the frames of seconds 60 to 65
  descan log session.log --json | jq -c 'select(.latency_ms > 50)'
  descan log session.log --filter 'at:14 since:13:50' --write part.pcapng
  descan log session.log --stats
  descan log session.log --stats --json | jq '.identifiers[] | select(.rate > 100) | .id'
  ssh board candump -L can0 | descan log - --filter at:12")]
pub struct LogArgs {
    /// Log in any format that descan reads; - is standard input
    #[arg(value_name = "FILE", value_hint = clap::ValueHint::FilePath)]
    pub log: PathBuf,
    /// Print JSON instead of text: one object per frame, or one with --stats
    #[arg(long)]
    pub json: bool,
    /// Print only matching frames: src:FEED | id:123 | type:rsp | word | !word ...
    #[arg(long, value_name = "EXPR")]
    pub filter: Option<String>,
    /// Print statistics instead of frames
    #[arg(long, conflicts_with = "limit")]
    pub stats: bool,
    /// Where the frames are written.
    #[arg(
        long,
        value_name = "FILE",
        value_parser = recording,
        conflicts_with_all = ["stats", "json"],
        help = format!("Write the matching frames to a new FILE: {}", LogFormat::summary())
    )]
    pub write: Option<PathBuf>,
    /// Stop after N matching frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub limit: Option<u64>,
    /// Start SECONDS after the first frame
    #[arg(long, value_name = "SECONDS", value_parser = moment, allow_negative_numbers = true)]
    pub from: Option<Duration>,
    /// Stop after SECONDS of log time
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// Values the protocol leaves open: service numbers, framing, heartbeat layout (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// A folder with types of devices, in place of devices beside des.json; repeatable
    #[arg(long, value_name = "FOLDER")]
    pub catalogue: Vec<PathBuf>,
    /// A DBC file with the messages of frames that are not of DES; repeatable
    #[arg(long, value_name = "FILE")]
    pub dbc: Vec<PathBuf>,
    /// The project file [default: descan.toml in this folder or above]
    #[arg(long, value_name = "FILE", conflicts_with = "no_project")]
    pub project: Option<PathBuf>,
    /// Take no project file
    #[arg(long)]
    pub no_project: bool,
}

/// `descan convert`.
#[derive(Debug, Args)]
#[command(after_help = "\
Reads any log that descan reads (descan help logs), compressed or not, and writes all of its frames with \
their times, directions, channels and FD flags, as far as the format has them. What it does not hold is \
said at the end. An existing file is replaced only with --force.

Exit code: 0 written, 1 written without what cannot be read, 2 wrong usage, 3 nothing can be read, or not \
written, 130 interrupted.

Examples:
  descan convert trace.blf trace.log
  descan convert session.log.xz session.asc
  descan convert trace.trc.gz - --format candump | descan -
  ssh board candump -L can0 | descan convert - board.blf")]
pub struct ConvertArgs {
    /// Log that is read; - is standard input
    #[arg(value_name = "IN", value_hint = clap::ValueHint::FilePath)]
    pub input: PathBuf,
    /// Log that is written; - is standard output
    #[arg(value_name = "OUT", value_hint = clap::ValueHint::FilePath)]
    pub output: PathBuf,
    /// Format of OUT [default: by the ending of its name]
    #[arg(long, value_name = "FORMAT", value_parser = written_format())]
    pub format: Option<String>,
    /// Replace OUT if it exists
    #[arg(long)]
    pub force: bool,
}

fn written_format() -> clap::builder::PossibleValuesParser {
    FORMATS.iter().map(|format| format.name).collect::<Vec<_>>().into()
}

/// What the commands without a screen share.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// The buses and how to treat them.
    #[command(flatten)]
    pub session: SessionArgs,
    /// Print JSON instead of text (watch: one object per line)
    #[arg(long)]
    pub json: bool,
    /// Stop after SECONDS at the latest (log time for a log file) [default: scan, check: 15; log: its end]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// Start reading a log SECONDS after its first frame
    #[arg(long, value_name = "SECONDS", value_parser = moment, allow_negative_numbers = true)]
    pub from: Option<Duration>,
}

/// `descan prove`.
#[derive(Debug, Args)]
#[command(after_help = "\
Observes the device and sends DES requests to it, within the share of the bus. Says for each rule of the \
documents whether it is kept, broken or not seen, with the frames. Takes half a minute for a device.

Exit code: 0 no rule is broken, 1 one is or an address conflict is confirmed, 2 wrong usage, 3 bus not \
usable or device not found, 130 interrupted. More: descan help conformance

Examples:
  descan prove can0 FEED --profile line7.toml
  descan prove can0 @12 --json
  descan prove can0 --all --profile line7.toml --report junit > prove.xml
  descan prove can0 FEED --profile line7.toml --disrupt-device --yes")]
pub struct ProveArgs {
    /// The bus.
    #[arg(value_name = "BUS", help = format!("The bus: {}", bus::forms(|kind| kind.can_send)))]
    pub bus: BusSpec,
    /// Name, UID or address of the device; @12 is the address in any case
    #[arg(value_name = "DEVICE", required_unless_present = "all", conflicts_with = "all", value_parser = device_name)]
    pub device: Option<String>,
    /// Test all devices of the bus, one after the other
    #[arg(long)]
    pub all: bool,
    /// Also throw it out of its work: frames from its address, commands to change its mode
    #[arg(long)]
    pub disrupt_device: bool,
    /// Also test it at a bus load of 80 %; refused while other devices are on the bus
    #[arg(long)]
    pub load: bool,
    /// The bus is a test bench: --load although other devices are on it
    #[arg(long, requires = "load")]
    pub bench: bool,
    /// Also test it after you have switched it off and on
    #[arg(long, conflicts_with = "all")]
    pub reboot: bool,
    /// Do not ask before --disrupt-device and --load; adds neither
    #[arg(long)]
    pub yes: bool,
    /// Look for the device for SECONDS [default: 15]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
    /// If a rule is broken, write a report to FILE.md, and the frames to FILE.pcapng
    #[arg(long, value_name = "FILE.md")]
    pub proof: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
    /// Print a report of tests instead of text: junit, tap or github
    #[arg(long, value_name = "FORMAT", conflicts_with = "json")]
    pub report: Option<TestReportFormat>,
    /// What it shares with the other commands.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Formats of a report of tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TestReportFormat {
    /// JUnit XML.
    Junit,
    /// Test Anything Protocol, version 13.
    Tap,
    /// Annotations of GitHub Actions: one line for each failure.
    Github,
}

/// `descan speed`.
#[derive(Debug, Args)]
#[command(after_help = "\
Listens at 125, 250, 500 and 1000 kbit/s, beginning with the current rate, 1.5 s at each, until a \
valid frame arrives; the interface then keeps that rate. Otherwise the previous settings are \
restored. Setting an interface needs root.

A device alone on the bus gets no ACK, so listen-only search cannot find it. \
--active joins the bus at each rate, which at a wrong rate destroys other nodes' frames.

Exit code: 0 found, 1 not found, 2 wrong usage, 3 interface not usable, 130 interrupted.

Examples:
  sudo descan speed can0
  sudo descan speed can0 --first 500000 --json | jq .bitrate
  descan speed slcan:/dev/ttyACM0")]
pub struct SpeedArgs {
    /// can0 | slcan:/dev/ttyACM0
    #[arg(value_name = "BUS")]
    pub bus: BusSpec,
    /// First rate to try, in bit/s [default: the current rate]
    #[arg(long, value_name = "BITRATE", value_parser = bitrate, allow_negative_numbers = true)]
    pub first: Option<u32>,
    /// Values the protocol leaves open (TOML): here BUS_CFG_HR_TIME; 1.5 of it per rate
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// Join the bus at each rate without confirmation
    #[arg(long)]
    pub active: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// `descan init`.
#[derive(Debug, Args)]
pub struct InitArgs {
    /// Buses, and what concerns them.
    #[command(flatten)]
    pub session: SessionArgs,
    /// Enumerate for SECONDS at most [default: 15]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
}

/// `descan catalogue`.
#[derive(Debug, Args)]
pub struct CatalogueArgs {
    /// Files or folders to read alone
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Print a JSON array
    #[arg(long)]
    pub json: bool,
}

/// Buses, and what concerns them.
#[derive(Debug, Args, Clone)]
pub struct SessionArgs {
    /// The buses, of any kind.
    #[arg(
        value_name = "BUS",
        help = format!("{} (several: one view over all)", bus::forms(|_| true))
    )]
    pub buses: Vec<BusSpec>,
    /// What concerns every session.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// What concerns every session.
#[derive(Debug, Args, Clone)]
pub struct CommonArgs {
    /// The des.json file [default: ./des.json; demo: a temporary file]
    #[arg(long, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Values the protocol leaves open: service numbers, framing, heartbeat layout (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// A folder with types of devices, in place of devices beside des.json; repeatable
    #[arg(long, value_name = "FOLDER")]
    pub catalogue: Vec<PathBuf>,
    /// A DBC file with the messages of frames that are not of DES; repeatable
    #[arg(long, value_name = "FILE")]
    pub dbc: Vec<PathBuf>,
    /// The project file [default: descan.toml in this folder or above]
    #[arg(long, value_name = "FILE", conflicts_with = "no_project")]
    pub project: Option<PathBuf>,
    /// Take no project file
    #[arg(long)]
    pub no_project: bool,
    /// Never transmit; learn from other nodes' traffic
    #[arg(long)]
    pub listen_only: bool,
    /// Send no name or services requests
    #[arg(long)]
    pub no_scan: bool,
    /// Own address, 0 to 127 [default: 0, or a free address]
    #[arg(long, value_name = "N", value_parser = address, allow_negative_numbers = true)]
    pub address: Option<Address>,
    /// Where frames are recorded.
    #[arg(
        long,
        value_name = "FILE",
        value_parser = recording,
        help = format!("Record all frames to a new FILE: {}", LogFormat::summary())
    )]
    pub record: Option<PathBuf>,
    /// Start a new file (FILE_00002, …) before SIZE is reached: 500k, 100M, 2G
    #[arg(long, value_name = "SIZE", requires = "record")]
    pub record_size: Option<Size>,
    /// Record only matching frames: src:FEED | id:123 | type:rsp | word | !word ...
    #[arg(long, value_name = "EXPR", requires = "record")]
    pub record_filter: Option<String>,
}

impl CommonArgs {
    /// Those of a command that only listens.
    pub fn listen_only(profile: Option<PathBuf>) -> Self {
        Self {
            file: None,
            profile,
            catalogue: Vec::new(),
            dbc: Vec::new(),
            project: None,
            no_project: false,
            listen_only: true,
            no_scan: false,
            address: None,
            record: None,
            record_size: None,
            record_filter: None,
        }
    }
}

fn address(text: &str) -> Result<Address, String> {
    let number = match text.strip_prefix("0x") {
        Some(hex) => u8::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    };
    number.and_then(Address::new).ok_or_else(|| "an address is a number from 0 to 127".to_owned())
}

fn node_address(text: &str) -> Result<Address, String> {
    let node = address(text).ok().filter(|address| *address != Address::DEBUG);
    node.ok_or_else(|| "an address of a node is a number from 1 to 127".to_owned())
}

fn device_name(text: &str) -> Result<String, String> {
    if text.is_empty() || text.contains('\0') {
        return Err("a name has at least one character".to_owned());
    }
    Ok(text.to_owned())
}

fn version(text: &str) -> Result<(String, String), String> {
    let (name, version) = text.split_once('=').unwrap_or((text, ""));
    if name.is_empty() || text.contains('\0') {
        return Err("a service is NAME=VERSION".to_owned());
    }
    Ok((name.to_owned(), version.to_owned()))
}

fn service(text: &str) -> Result<Service, String> {
    let number = match text.strip_prefix("0x") {
        Some(hex) => u16::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    };
    number.and_then(Service::new).ok_or_else(|| "a service is a number, 0 to 0x3FF".to_owned())
}

fn recording(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    LogFormat::of(&path).map_err(|fault| fault.to_string())?;
    Ok(path)
}

/// Parses `--capture`.
fn capture(text: &str) -> Result<Size, String> {
    let size = text.parse().ok().filter(|Size(bytes)| (MIN_CAPTURE..=MAX_CAPTURE).contains(bytes));
    size.ok_or_else(|| "a size like 64M or 2G, 1M to 64G".to_owned())
}

fn bitrate(text: &str) -> Result<u32, String> {
    let bitrate = bitrate::parse(text).filter(|rate| bitrate::CLASSIC_RATES.contains(rate));
    bitrate.ok_or_else(|| "a bit rate from 10000 to 1000000".to_owned())
}

fn device_count(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|count| (1..=MAX_EXPECTED).contains(count));
    count.ok_or_else(|| format!("a number of devices, 1 to {MAX_EXPECTED}"))
}

fn seconds(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| (0.001..=1e6).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "a number of seconds, 0.001 to 1000000".to_owned())
}

/// Parses `--from` in seconds; 0 and times beyond the limit of `--time` are allowed.
fn moment(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| (0.0..=1e9).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "a number of seconds, 0 to 1000000000".to_owned())
}

fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|speed| (0.001..=100_000.0).contains(speed))
        .ok_or_else(|| "a number from 0.001 to 100000".to_owned())
}

/// Parses the arguments. An error is one line that names the fault and a valid form.
pub fn parse<I, T>(arguments: I) -> Result<Cli, CliExit>
where
    I: IntoIterator<Item = T>,
    T: Into<std::ffi::OsString> + Clone,
{
    let arguments: Vec<std::ffi::OsString> = arguments.into_iter().map(Into::into).collect();
    Cli::try_parse_from(&arguments).map_err(|error| {
        if !error.use_stderr() {
            return CliExit::Text(error.render().to_string());
        }
        CliExit::Usage(one_line(&error, &arguments))
    })
}

/// Why parsing ended without options.
#[derive(Debug)]
pub enum CliExit {
    /// Text of a help or version request.
    Text(String),
    /// Invalid arguments: the error line.
    Usage(String),
}

/// Shortens clap's error to one line: the fault, the tip or the possible values, or the usage or the help of
/// the command.
fn one_line(error: &clap::Error, arguments: &[std::ffi::OsString]) -> String {
    let text = error.render().to_string();
    let usage = text.lines().find_map(|line| line.trim().strip_prefix("Usage: "));
    let usage = usage.map(|usage| format!("usage: {usage}"));
    let mut parts = text
        .lines()
        .map(str::trim)
        .take_while(|line| !line.starts_with("Usage:"))
        .filter(|line| !line.is_empty() && !line.starts_with("For more information"))
        .map(|line| line.trim_start_matches("error: ").trim_start_matches("tip: "))
        // What begins with a minus is rarely meant as a value.
        .filter(|line| !line.starts_with("to pass '"))
        .map(|line| line.trim_end_matches(':'));
    let first = parts.next().unwrap_or("wrong arguments").to_owned();
    let mut rest: Vec<&str> = parts.collect();
    if error.kind() == clap::error::ErrorKind::MissingRequiredArgument {
        rest.extend(usage.as_deref());
    }
    if rest.is_empty() {
        format!("{first} (see {} --help)", command_of(arguments))
    } else {
        format!("{first}: {}", rest.join("; "))
    }
}

/// Returns the command that these arguments name: `descan scan`, or the program alone.
fn command_of(arguments: &[std::ffi::OsString]) -> String {
    let (program, mut words) = (Cli::command(), vec!["descan"]);
    let mut command = &program;
    let is_option = |argument: &&std::ffi::OsString| argument.as_encoded_bytes().starts_with(b"-");
    for argument in arguments.iter().skip(1).filter(|argument| !is_option(argument)) {
        let Some(next) = command.find_subcommand(argument) else { break };
        words.push(next.get_name());
        command = next;
    }
    words.join(" ")
}

/// Returns the completion script of a shell.
pub fn completions(shell: clap_complete::Shell) -> Vec<u8> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "descan", &mut text);
    text
}

/// The name of a command or topic. Shells complete topics; the guide rejects unknown names.
#[derive(Clone)]
struct GuideName;

impl TypedValueParser for GuideName {
    type Value = String;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        StringValueParser::new().parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(guide::TOPICS.iter().map(|topic| PossibleValue::new(topic.name))))
    }
}

/// Returns the clap definition of all commands, for the guide.
pub fn program() -> clap::Command {
    Cli::command()
}
