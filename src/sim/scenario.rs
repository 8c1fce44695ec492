//! Scenarios: which devices are on a bus, how they behave, and what happens to them when.
//!
//! Built in ([`Scenario::builtin`]), read from TOML ([`Scenario::parse`]) or put together in
//! code ([`Scenario::new`], [`DeviceSpec::new`]). Does not know how any of it is simulated.

use crate::time::{Duration, Instant};
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Service};
use crate::wire::node::{Mode, Uid};
use serde::Deserialize;

/// Everything a simulated bus begins with.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Scenario {
    /// Nominal bit rate in bit/s, 10,000–1,000,000.
    pub bitrate: u32,
    /// Bit rate of the data phase of FD frames in bit/s, up to 8,000,000.
    pub data_bitrate: u32,
    /// What the random numbers begin with, unless the caller gives another seed.
    pub seed: u64,
    /// The share of frames that a disturbance destroys on the wire, 0–1; they are repeated.
    pub error_rate: f64,
    /// The share of others' frames that an attached station misses, 0–1.
    pub observer_loss: f64,
    /// The devices.
    pub devices: Vec<DeviceSpec>,
    /// What happens to them.
    pub timetable: Vec<TimetableEvent>,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            bitrate: 125_000,
            data_bitrate: 2_000_000,
            seed: 1,
            error_rate: 0.0,
            observer_loss: 0.0,
            devices: Vec::new(),
            timetable: Vec::new(),
        }
    }
}

impl Scenario {
    /// The names [`Scenario::builtin`] knows.
    pub const BUILTIN: [&'static str; 2] = ["boiler", "drone"];

    /// An empty bus.
    pub fn new(bitrate: u32) -> Self {
        Self { bitrate, ..Self::default() }
    }

    /// The text of a built-in scenario: a template for one's own.
    pub fn builtin_text(name: &str) -> Option<&'static str> {
        let texts = [include_str!("scenarios/boiler.toml"), include_str!("scenarios/drone.toml")];
        let at = Self::BUILTIN.iter().position(|known| *known == name)?;
        Some(texts[at])
    }

    /// A built-in scenario.
    pub fn builtin(name: &str) -> Result<Self, ScenarioError> {
        let text = Self::builtin_text(name)
            .ok_or_else(|| ScenarioError::NoSuchScenario { name: name.to_owned() })?;
        Self::parse(text)
    }

    /// The same with one more device.
    #[must_use]
    pub fn with(mut self, device: DeviceSpec) -> Self {
        self.devices.push(device);
        self
    }

    /// The same with `action` on the device labelled `device` at `time`.
    #[must_use]
    pub fn at(mut self, time: Duration, device: &str, action: DeviceAction) -> Self {
        let time = Instant::ZERO + time;
        self.timetable.push(TimetableEvent::new(time, device, action));
        self
    }

    /// A bus with `count` (1–127) working devices at the addresses from 1, `services` services
    /// each, settled: nothing to resolve, heartbeats from the start.
    pub fn crowd(bitrate: u32, count: usize, services: usize) -> Self {
        let mut scenario = Self::new(bitrate);
        for address in Address::nodes().take(count) {
            let mut device = DeviceSpec::new(&format!("N{:03}", address.number()))
                .address(AddressChoice::Preferred(address))
                .settled();
            for service in 0..services {
                device = device.service(&format!("SRV{service:03}"), "1.0");
            }
            scenario = scenario.with(device);
        }
        scenario
    }
}

/// DEV_CFG_ADDR: which address a device wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "AddressWritten")]
pub enum AddressChoice {
    /// Any free one; such a device does not work but waits to be configured.
    Any,
    /// This one if it is free, else any.
    Preferred(Address),
    /// This one or none.
    Fixed(Address),
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum AddressWritten {
    Any,
    Preferred(u8),
    Fixed(u8),
}

impl TryFrom<AddressWritten> for AddressChoice {
    type Error = String;
    fn try_from(written: AddressWritten) -> Result<Self, String> {
        let address = |number| {
            Address::new(number)
                .filter(|&address| address != Address::DEBUG)
                .ok_or_else(|| format!("{number} is not a node address (1 to 127)"))
        };
        Ok(match written {
            AddressWritten::Any => Self::Any,
            AddressWritten::Preferred(number) => Self::Preferred(address(number)?),
            AddressWritten::Fixed(number) => Self::Fixed(address(number)?),
        })
    }
}

/// In which framings a device understands requests and answers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceFraming {
    /// ISO 15765-2.
    #[default]
    Isotp,
    /// Messages as they stand.
    Raw,
    /// Each request in its own.
    Both,
}

impl DeviceFraming {
    /// Whether a request in this framing is understood.
    pub fn understands(self, framing: Framing) -> bool {
        match self {
            Self::Both => true,
            Self::Isotp => framing == Framing::Isotp,
            Self::Raw => framing == Framing::Raw,
        }
    }
}

/// What a device does wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Fault {
    /// Sends no heartbeat.
    NoHeartbeat,
    /// Answers nothing of DES.
    NoDes,
    /// Answers its name but not its services.
    NoServices,
    /// Leaves the second consecutive frame of each long answer out.
    DropFrame,
    /// Numbers the second consecutive frame wrongly.
    WrongSequence,
    /// Never ends a long answer.
    Endless,
    /// Announces four gigabytes and sends nothing.
    HugeLength,
    /// Ends its services answer in the middle of a string.
    TruncatedServices,
    /// Answers everything twice.
    AnswersTwice,
    /// Sends answers to the request's DST, as the platform description says literally.
    EchoDestination,
    /// Keeps its address and its mode whatever it hears: an offender.
    NeverGivesWay,
}

/// The faults of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Faults(u16);

impl Faults {
    /// Whether the device has this one.
    pub const fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u16 & 1 == 1
    }

    /// Adds or mends one.
    pub fn set(&mut self, fault: Fault, present: bool) {
        self.0 = self.0 & !(1 << fault as u16) | u16::from(present) << fault as u16;
    }
}

/// Something a device sends unasked, over and over: background load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Chatter {
    /// The service it is data of.
    pub service: Service,
    /// Every so often.
    pub period: Duration,
    /// Bytes per frame, 0–8 (0–64 for a device with FD).
    pub length: u8,
}

/// Descriptor fields (3.2) that nothing else depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Descriptor {
    /// DEV_INFO_GID: the type of device.
    pub gid: [u8; 6],
    /// DEV_INFO_SN: the serial number; 0 = none.
    pub serial: u32,
    /// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN.
    pub firmware: (u16, u16),
}

/// A device as it is made and configured.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DeviceSpec {
    /// How the timetable calls it; no two devices share one.
    pub label: String,
    /// The name it gives itself: any bytes but 0.
    pub name: Vec<u8>,
    /// DEV_CFG_ADDR.
    pub address: AddressChoice,
    /// DEV_CFG_UID; blank: the device does not work but waits to be configured.
    pub uid: Uid,
    /// What else its descriptor says.
    pub descriptor: Descriptor,
    /// Its services, each a list of strings: name, version, possibly more.
    pub services: Vec<Vec<Vec<u8>>>,
    /// DEV_CFG_AUTOSTART: whether it works as soon as it has an address.
    pub autostart: bool,
    /// The mode it takes whatever its configuration says.
    pub mode: Option<Mode>,
    /// When it is switched on; `None`: not until the timetable says so.
    pub power_on: Option<Duration>,
    /// Has its address already when it is first switched on: no listening, no claim.
    pub settled: bool,
    /// How it lays DES messages into frames.
    pub framing: DeviceFraming,
    /// Answers, beats and chatters in FD frames.
    pub fd: bool,
    /// Heartbeat period; `None`: BUS_CFG_HR_TIME.
    pub heartbeat: Option<Duration>,
    /// Each heartbeat is late by a random part of this.
    pub jitter: Duration,
    /// How much its crystal is off, in millionths: positive is slow.
    pub tolerance_ppm: i32,
    /// It answers after a random time between these.
    pub delay: (Duration, Duration),
    /// What it does wrong.
    pub faults: Faults,
    /// What it sends unasked.
    pub chatter: Vec<Chatter>,
}

impl DeviceSpec {
    /// A working device of that name, any address, with a UID made of the name. Services: DES.
    pub fn new(name: &str) -> Self {
        Self {
            label: name.to_owned(),
            name: name.as_bytes().to_vec(),
            address: AddressChoice::Any,
            uid: uid_of(name),
            descriptor: Descriptor { firmware: (1, 0), ..Descriptor::default() },
            services: vec![vec![b"DES".to_vec(), b"1.0".to_vec()]],
            autostart: true,
            mode: None,
            power_on: Some(Duration::ZERO),
            settled: false,
            framing: DeviceFraming::Isotp,
            fd: false,
            heartbeat: None,
            jitter: Duration::from_micros(500),
            tolerance_ppm: 0,
            delay: (Duration::from_micros(200), Duration::from_millis(1)),
            faults: Faults::default(),
            chatter: Vec::new(),
        }
    }

    /// The same under another label.
    #[must_use]
    pub fn label(mut self, label: &str) -> Self {
        label.clone_into(&mut self.label);
        self
    }

    /// The same with this name; the label stays.
    #[must_use]
    pub fn name(mut self, name: &[u8]) -> Self {
        self.name = name.to_vec();
        self
    }

    /// The same with this DEV_CFG_ADDR.
    #[must_use]
    pub fn address(mut self, address: AddressChoice) -> Self {
        self.address = address;
        self
    }

    /// The same with the fixed address `number`, of which the low seven bits count.
    #[must_use]
    pub fn fixed(self, number: u8) -> Self {
        self.address(AddressChoice::Fixed(Address::from_bits(number)))
    }

    /// The same with the preferred address `number`, of which the low seven bits count.
    #[must_use]
    pub fn preferred(self, number: u8) -> Self {
        self.address(AddressChoice::Preferred(Address::from_bits(number)))
    }

    /// The same with this UID.
    #[must_use]
    pub fn uid(mut self, uid: Uid) -> Self {
        self.uid = uid;
        self
    }

    /// The same with one more service.
    #[must_use]
    pub fn service(mut self, name: &str, version: &str) -> Self {
        self.services.push(vec![name.as_bytes().to_vec(), version.as_bytes().to_vec()]);
        self
    }

    /// The same with one more fault.
    #[must_use]
    pub fn fault(mut self, fault: Fault) -> Self {
        self.faults.set(fault, true);
        self
    }

    /// The same, settled: see the field.
    #[must_use]
    pub fn settled(mut self) -> Self {
        self.settled = true;
        self
    }

    /// The same, switched on at `at`.
    #[must_use]
    pub fn power_on(mut self, at: Duration) -> Self {
        self.power_on = Some(at);
        self
    }

    /// The same with this framing.
    #[must_use]
    pub fn framing(mut self, framing: DeviceFraming) -> Self {
        self.framing = framing;
        self
    }

    /// The same with one more thing it sends unasked.
    #[must_use]
    pub fn chatter(mut self, service: u16, period: Duration, length: u8) -> Self {
        self.chatter.push(Chatter { service: Service::from_bits(service), period, length });
        self
    }
}

/// A UID that spells as much of `text` as its alphabet has.
pub(super) fn uid_of(text: &str) -> Uid {
    let sextets = std::array::from_fn(|at| match text.as_bytes().get(at) {
        Some(byte @ 0x20..=0x5F) => byte - 0x20,
        Some(other) => other.wrapping_mul(31) & 0x3F,
        None => 0,
    });
    Uid::from_sextets(sextets)
}

/// Something that is done to a device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum DeviceAction {
    /// Switch it on.
    Join,
    /// Switch it off: it is gone without a word.
    Leave,
    /// Off and on again, its address to be resolved anew; with new services after a firmware
    /// update.
    Reboot {
        /// The services it has afterwards; `None`: the same.
        services: Option<Vec<Vec<Vec<u8>>>>,
    },
    /// Off and on again within a bit or two, as by a watchdog: it keeps its address and says
    /// nothing of it; only its heartbeat's phase and what it was about to answer are lost.
    QuickReboot,
    /// Configure another address; it resolves anew.
    Move(AddressChoice),
    /// Change its services without a reboot.
    Services(Vec<Vec<Vec<u8>>>),
    /// Put it into another mode; INIT and ARSLV begin the resolution of its address.
    Mode(Mode),
    /// Change its name.
    Name(Vec<u8>),
    /// Change its UID.
    Uid(Uid),
    /// It begins to do something wrong.
    Break(Fault),
    /// It stops doing something wrong.
    Mend(Fault),
    /// Change how often frames break on the wire, 0–1. Concerns the bus, not the device.
    ErrorRate(f64),
}

/// An entry of the timetable.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TimetableEvent {
    /// When.
    pub time: Instant,
    /// And again each time this has passed.
    pub every: Option<Duration>,
    /// To which device, by its label; empty for what concerns the bus.
    pub device: String,
    /// What.
    pub action: DeviceAction,
}

impl TimetableEvent {
    /// Returns an event that happens once.
    pub fn new(time: Instant, device: &str, action: DeviceAction) -> Self {
        Self { time, every: None, device: device.to_owned(), action }
    }
}

/// Why a scenario cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// Not TOML, or not a scenario.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// No built-in scenario of that name.
    #[error("no built-in scenario \"{name}\" (use boiler or drone)")]
    NoSuchScenario {
        /// The name.
        name: String,
    },
    /// A value outside its range.
    #[error("{place}: {key} = {value} is not {expected}")]
    Range {
        /// Where: the bus, a device or an entry of the timetable.
        place: String,
        /// Which value.
        key: &'static str,
        /// What it is.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// A value that is needed is missing, or one that is there has no meaning.
    #[error("{place}: {problem}")]
    Incomplete {
        /// Where.
        place: String,
        /// What is missing or too much.
        problem: String,
    },
    /// Two devices with one label.
    #[error("two devices are labelled \"{label}\": give one of them a label of its own")]
    DuplicateLabel {
        /// The label.
        label: String,
    },
    /// The timetable names a device that is not there.
    #[error("{place}: no device labelled \"{device}\"")]
    UnknownDevice {
        /// Which entry.
        place: String,
        /// The label.
        device: String,
    },
}
