//! The command line: arguments in, plain options out.
//!
//! Opens nothing and reads nothing.

use crate::bus::BusSpec;
use crate::guide;
use crate::shell::recorder::{Format, Size};
use crate::wire::id::Address;
use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Args, CommandFactory, Parser, Subcommand};
use std::ffi::OsStr;
use std::path::PathBuf;
use std::time::Duration;

/// What the user asked for.
#[derive(Debug, Parser)]
#[command(
    name = "descan",
    version,
    about = "Find the devices on a CAN bus, their services, versions and collisions; edit static addresses",
    long_about = "Find the devices on a CAN bus with DES, the devices enumeration service: names, services, \
                  versions, modes, collisions. Edit static addresses in des.json in place.",
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
    pub session: Session,
}

const EXAMPLES: &str = "\
Examples:
  descan                        the one CAN interface there is, in the terminal UI
  descan can0                   can0, in the terminal UI
  descan demo                   a simulated pellet boiler, to look around
  descan scan can0              who is there, as a table
  descan scan can0 --json       the same for scripts
  descan check can0             is the bus what des.json says?
  descan watch can0             what happens, as it happens, a line each
  descan scan can0 --write des.json
                                begin a des.json with what is there
  descan file:session.log       a candump log, as it was timed
  ssh board candump -L can0 | descan -
                                a bus at the other end of a line

An interface that is down: sudo ip link set can0 up type can bitrate 125000";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// The terminal UI on a simulated bus: devices that join, move, reboot, collide
    Demo {
        /// Which system is simulated
        #[arg(default_value = "boiler", value_parser = ["boiler", "drone"])]
        system: String,
        /// How it is shown, and whether we only listen
        #[command(flatten)]
        session: Common,
    },
    /// One enumeration, printed as a table
    Scan(Scan),
    /// Whether a bus is what des.json says, a line for each difference
    Check(Check),
    /// What happens, as it happens, a line each
    Watch(Watch),
    /// Simulated devices on a bus, from a scenario
    #[command(after_help = "\
Examples:
  descan sim vcan0
  descan sim udp:239.74.163.2 --scenario drone
  descan sim slcan:/dev/ttyACM0@500000 --scenario line.toml --time 60")]
    Sim {
        /// The bus they are put on: can0 | slcan:DEVICE@RATE | udp:GROUP | socketcand://HOST/BUS
        #[arg(value_name = "BUS")]
        bus: BusSpec,
        /// boiler, drone, or a scenario file (TOML)
        #[arg(long, default_value = "boiler", value_name = "SCENARIO")]
        scenario: String,
        /// End after this many seconds
        #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
        time: Option<Duration>,
    },
    /// Find the bit rate of a bus, listening only
    Speed(Speed),
    /// Print the completions for a shell
    Completions {
        /// For which shell
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
    /// Print the JSON Schema of des.json
    Schema,
}

/// `descan scan`.
#[derive(Debug, Args)]
#[command(after_help = "\
Exit code: 0 no confirmed collision, 1 one or more, 2 wrong usage, 3 bus or file not usable.

Examples:
  descan scan can0
  descan scan can0 --json | jq '.devices[].name'
  descan scan file:session.log --json")]
pub struct Scan {
    /// The buses and how to treat them.
    #[command(flatten)]
    pub session: Session,
    /// Print one JSON object instead of tables
    #[arg(long)]
    pub json: bool,
    /// Write what was found to this file; an existing one is not touched
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// End at the latest after this many seconds
    #[arg(long, value_name = "SECONDS", default_value = "15", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Duration,
}

/// `descan check`.
#[derive(Debug, Args)]
#[command(after_help = "\
Compares what is on the bus with des.json: entries that are missing, devices at another address than
the pinned one, of another name, or not listed, services and versions where the file lists them (in
their order where they are a list); and collisions.

Exit code: 0 no difference, 1 one or more, 2 wrong usage, 3 bus or file not usable, 130 interrupted.

Examples:
  descan check can0
  descan check can0 --file line7.json --wait-for-all --time 60
  descan check file:session.log --json | jq -r '.findings[].text'")]
pub struct Check {
    /// The buses and how to treat them.
    #[command(flatten)]
    pub session: Session,
    /// Print one JSON object instead of lines
    #[arg(long)]
    pub json: bool,
    /// Wait until every entry is there, at most for the --time
    #[arg(long)]
    pub wait_for_all: bool,
    /// End at the latest after this many seconds
    #[arg(long, value_name = "SECONDS", default_value = "15", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Duration,
}

/// `descan watch`.
#[derive(Debug, Args)]
#[command(after_help = "\
A log is read as fast as it can be, with its own times, unless --speed is given; lines from
standard input are told as they come. What goes down or is unplugged is waited for, once it was
open.

--filter takes the words and fields of the screen's filter line, all of which must fit: at:12,14
name:FEED is:confirmed bus:can1 lost !debug. What is about a whole bus (its state, frames lost,
our own address) and what goes wrong with us is told all the same. With at: and --listen-only,
frames of other addresses are not even read from a SocketCAN interface: other devices are not
discovered then, and the bus load is not known. Without --listen-only everything is read, for
our own address needs it, and so it is with --record.

Exit code: 0 ended by a signal, by --time or by the log's end, 2 wrong usage, 3 bus or file not
usable.

Examples:
  descan watch can0
  descan watch can0 can1 --json --time 60 | jq -c 'select(.event == \"finding\")'
  descan watch can0 --filter at:12 --listen-only
  descan watch file:session.log
  ssh board candump -L can0 | descan watch -")]
pub struct Watch {
    /// The buses and how to treat them.
    #[command(flatten)]
    pub session: Session,
    /// Print one JSON object a line
    #[arg(long)]
    pub json: bool,
    /// Tell only what fits: at:12,14 | name:FEED | is:confirmed | word | !word ...
    #[arg(long, value_name = "EXPR")]
    pub filter: Option<String>,
    /// End after this many seconds; those of a log file are its own
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub time: Option<Duration>,
}

/// `descan speed`.
#[derive(Debug, Args)]
#[command(after_help = "\
Listens at 125, 250, 500 and 1000 kbit/s, from the rate that is set, 1.5 s at each, until a frame
arrives whole; then the interface keeps that rate. Otherwise it is put back to how it was. Only root
may set an interface.

A device that is alone on the bus is not heard by who only listens: nobody acknowledges its frames.
--active takes part while it tries, which at a wrong rate destroys the frames of others.

Exit code: 0 found, 1 not found, 2 wrong usage, 3 interface not usable, 130 interrupted.

Examples:
  sudo descan speed can0
  sudo descan speed can0 --first 500000 --json | jq .bitrate
  descan speed slcan:/dev/ttyACM0")]
pub struct Speed {
    /// can0 | slcan:/dev/ttyACM0
    #[arg(value_name = "BUS")]
    pub bus: BusSpec,
    /// The rate to begin with, in bit/s [default: the one that is set]
    #[arg(long, value_name = "BITRATE", value_parser = bitrate, allow_negative_numbers = true)]
    pub first: Option<u32>,
    /// What the protocol leaves open: here BUS_CFG_HR_TIME, of which each rate gets 1.5 (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// Take part in the bus at each rate, without asking
    #[arg(long)]
    pub active: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Buses, and what concerns them.
#[derive(Debug, Args, Clone)]
pub struct Session {
    /// can0 | slcan:DEVICE@RATE | socketcand://HOST/BUS | udp:GROUP | file:LOG | - | sim:boiler |
    /// sim:drone | sim:FILE (several: one view over all)
    #[arg(value_name = "BUS")]
    pub buses: Vec<BusSpec>,
    /// How fast a log is replayed: 1 as it was timed, 10 ten times faster
    #[arg(long, value_name = "N", value_parser = speed, allow_negative_numbers = true)]
    pub speed: Option<f64>,
    /// What concerns every session.
    #[command(flatten)]
    pub common: Common,
}

/// What concerns every session.
#[derive(Debug, Args, Clone)]
pub struct Common {
    /// The list of devices and static addresses [default: ./des.json; demo: one of its own]
    #[arg(long, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// What the protocol leaves open: service numbers, framing, heartbeat layout (TOML)
    #[arg(long, value_name = "FILE")]
    pub profile: Option<PathBuf>,
    /// Send nothing at all; learn from what others ask and answer
    #[arg(long)]
    pub listen_only: bool,
    /// Do not ask devices who they are
    #[arg(long)]
    pub no_scan: bool,
    /// Our own address, 0 to 127 [default: 0, or a free one]
    #[arg(long, value_name = "N", value_parser = address, allow_negative_numbers = true)]
    pub address: Option<Address>,
    /// Record all frames, into a new file: .log is candump's text, .pcapng is for Wireshark
    #[arg(long, value_name = "FILE", value_parser = recording)]
    pub record: Option<PathBuf>,
    /// Begin another file (FILE_00002, …) before one grows beyond this: 500k, 100M, 2G
    #[arg(long, value_name = "SIZE", requires = "record")]
    pub record_size: Option<Size>,
    /// Of the terminal UI: terminal | dark | light | high-contrast | mono, or one of your own
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
}

fn address(text: &str) -> Result<Address, String> {
    let number = match text.strip_prefix("0x") {
        Some(hex) => u8::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    };
    number.and_then(Address::new).ok_or_else(|| "an address is a number from 0 to 127".to_owned())
}

fn recording(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    Format::of(&path).map_err(|fault| fault.to_string())?;
    Ok(path)
}

fn bitrate(text: &str) -> Result<u32, String> {
    let bitrate = text.parse().ok().filter(|rate| (10_000..=1_000_000).contains(rate));
    bitrate.ok_or_else(|| "a bit rate from 10000 to 1000000".to_owned())
}

fn seconds(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .filter(|seconds: &f64| (0.001..=1e6).contains(seconds))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "a number of seconds, 0.001 to 1000000".to_owned())
}

fn speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|speed| (0.001..=100_000.0).contains(speed))
        .ok_or_else(|| "a number from 0.001 to 100000".to_owned())
}

/// Parses the arguments. What is wrong with them is one line that says what would be right.
pub fn parse<I, T>(arguments: I) -> Result<Cli, Refusal>
where
    I: IntoIterator<Item = T>,
    T: Into<std::ffi::OsString> + Clone,
{
    Cli::try_parse_from(arguments).map_err(|error| {
        if !error.use_stderr() {
            return Refusal::Text(error.render().to_string());
        }
        Refusal::Usage(one_line(&error))
    })
}

/// Why there are no options.
#[derive(Debug)]
pub enum Refusal {
    /// Help or version was asked for: this is it.
    Text(String),
    /// The arguments are wrong: this is what would be right.
    Usage(String),
}

/// clap's several lines as one: what is wrong, the tip or the possible values, and where help is.
fn one_line(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let mut parts = text
        .lines()
        .map(str::trim)
        .take_while(|line| !line.starts_with("Usage:"))
        .filter(|line| !line.is_empty() && !line.starts_with("For more information"))
        .map(|line| line.trim_start_matches("error: ").trim_start_matches("tip: "))
        .map(|line| line.trim_end_matches(':'));
    let first = parts.next().unwrap_or("wrong arguments").to_owned();
    let rest: Vec<&str> = parts.collect();
    if rest.is_empty() {
        format!("{first} (descan --help shows what there is)")
    } else {
        format!("{first}: {}", rest.join("; "))
    }
}

/// The completions of a shell.
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

/// The tree of commands, for the guide.
pub fn program() -> clap::Command {
    Cli::command()
}
