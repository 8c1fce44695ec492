//! Scenarios: the devices of a simulated bus, their behaviour, and a timetable.
//!
//! Built in ([`Scenario::builtin`]), from TOML ([`Scenario::parse`]) or built in code
//! ([`Scenario::new`], [`DeviceSpec::new`]).

use crate::time::{Duration, Instant};
use crate::wire::descriptor::{AddressSetting, BitrateSetting, Capabilities, FirmwareVersion, Gid};
use crate::wire::framing::Framing;
use crate::wire::id::{Address, Service};
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::Profile;
use serde::Deserialize;

/// Initial state of a simulated bus, and its timetable.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Scenario {
    /// Nominal bit rate in bit/s, 10,000 to 1,000,000.
    pub bitrate: u32,
    /// Bit rate of the data phase of FD frames in bit/s, up to 8,000,000.
    pub data_bitrate: u32,
    /// Seed of the random numbers, unless the caller gives another one.
    pub seed: u64,
    /// Share of frames destroyed on the wire, 0 to 1; their senders repeat them.
    pub frame_error_probability: f64,
    /// Share of other stations' frames that an attached station does not receive, 0 to 1.
    pub rx_loss: f64,
    /// The devices.
    pub devices: Vec<DeviceSpec>,
    /// Actions on devices and their times.
    pub timetable: Vec<TimetableEvent>,
    /// Values that the devices use where the protocol leaves them open.
    pub profile: Profile,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            bitrate: 125_000,
            data_bitrate: 2_000_000,
            seed: 1,
            frame_error_probability: 0.0,
            rx_loss: 0.0,
            devices: Vec::new(),
            timetable: Vec::new(),
            profile: Profile::default(),
        }
    }
}

impl Scenario {
    /// Names of the built-in scenarios.
    pub const BUILTIN: [&'static str; 2] = ["boiler", "drone"];

    /// Returns a bus without devices. `bitrate` in bit/s.
    pub fn new(bitrate: u32) -> Self {
        Self { bitrate, ..Self::default() }
    }

    /// Returns the text of a built-in scenario, a template for others; `None` if there is none with
    /// that name.
    pub fn builtin_text(name: &str) -> Option<&'static str> {
        let texts = [include_str!("scenarios/boiler.toml"), include_str!("scenarios/drone.toml")];
        let at = Self::BUILTIN.iter().position(|known| *known == name)?;
        Some(texts[at])
    }

    /// Returns a built-in scenario.
    ///
    /// # Errors
    /// [`ScenarioError::NoSuchScenario`].
    pub fn builtin(name: &str) -> Result<Self, ScenarioError> {
        let text = Self::builtin_text(name)
            .ok_or_else(|| ScenarioError::NoSuchScenario { name: name.to_owned() })?;
        Self::parse(text)
    }

    /// Adds a device.
    #[must_use]
    pub fn with(mut self, device: DeviceSpec) -> Self {
        self.devices.push(device);
        self
    }

    /// Adds an action on the device with label `device`, at `time` after the start.
    #[must_use]
    pub fn at(mut self, time: Duration, device: &str, action: DeviceAction) -> Self {
        let time = Instant::ZERO + time;
        self.timetable.push(TimetableEvent::new(time, device, action));
        self
    }

    /// Returns a bus with `count` (1 to 127) working devices at the addresses from 1, each with
    /// `services` services, without address resolution and with heartbeats from the start.
    pub fn with_many_devices(bitrate: u32, count: usize, services: usize) -> Self {
        let mut scenario = Self::new(bitrate);
        for address in Address::nodes().take(count) {
            let mut device = DeviceSpec::new(&format!("N{:03}", address.number()))
                .address(AddressSetting::Preferred(address))
                .skips_address_resolution();
            for service in 0..services {
                device = device.service(&format!("SRV{service:03}"), "1.0");
            }
            scenario = scenario.with(device);
        }
        scenario
    }
}

/// Framings in which a device reads requests and responds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceFraming {
    /// ISO-TP.
    #[default]
    Isotp,
    /// Raw.
    Raw,
    /// Both; a response has the framing of its request.
    Both,
}

impl DeviceFraming {
    /// Returns true if requests in this framing are accepted.
    pub fn accepts(self, framing: Framing) -> bool {
        match self {
            Self::Both => true,
            Self::Isotp => framing == Framing::Isotp,
            Self::Raw => framing == Framing::Raw,
        }
    }
}

/// A fault of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Fault {
    /// Sends no heartbeat.
    NoHeartbeat,
    /// Responds to no DES request.
    NoDes,
    /// Responds to name requests but not to services requests.
    NoServices,
    /// Omits the second frame of each segmented response.
    DropFrame,
    /// Sends the second frame of each segmented response with a wrong sequence number.
    WrongSequence,
    /// Never ends a segmented response.
    Endless,
    /// Sends a first frame with a length of 4 GiB, and nothing more.
    HugeLength,
    /// Ends the services response inside a string.
    TruncatedServices,
    /// Sends each response twice.
    #[serde(rename = "answers-twice")]
    RespondsTwice,
    /// Copies the DST of the request to the response (protocol §1.3).
    #[serde(rename = "echo-destination")]
    RepeatsRequestDst,
    /// Never gives up its address or its mode.
    #[serde(rename = "never-gives-way")]
    KeepsAddress,
    /// Refuses to change its configuration.
    Locked,
    /// Responds to reads of its descriptor with one byte too few.
    #[serde(rename = "short-descriptor")]
    ShortDescriptor,
    /// Does not respond to reads of its descriptor, nor to commands.
    #[serde(rename = "no-descriptor")]
    NoDescriptor,
    /// Sends a name request to all each second, in each mode.
    #[serde(rename = "sends-requests")]
    SendsRequests,
}

/// A set of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Faults(u16);

impl Faults {
    /// Returns true if the fault is in the set.
    pub const fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u16 & 1 == 1
    }

    /// Adds or removes a fault.
    pub fn set(&mut self, fault: Fault, present: bool) {
        self.0 = self.0 & !(1 << fault as u16) | u16::from(present) << fault as u16;
    }
}

/// Periodic unsolicited data of a device: background load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PeriodicMessage {
    /// Service number.
    pub service: Service,
    /// Period.
    pub period: Duration,
    /// Bytes per frame, 0 to 8 (0 to 64 for a device with FD).
    pub length: u8,
    /// A DEBUG message, whose code is the service number.
    pub is_debug: bool,
}

/// Descriptor fields on which nothing else depends (protocol §7.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Descriptor {
    /// DEV_INFO_GID: the type of device.
    pub gid: Gid,
    /// DEV_INFO_SN: the serial number; 0 = none.
    pub serial: u32,
    /// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN.
    pub firmware: FirmwareVersion,
    /// DEV_INFO_PROG, DEV_INFO_FPU, DEV_INFO_CPU and DEV_INFO_CPU_FLAGS.
    pub capabilities: Capabilities,
    /// DEV_CFG_BSPD; `None`: preferred, the bit rate of the bus.
    pub bitrate: Option<BitrateSetting>,
}

/// Configuration of a simulated device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DeviceSpec {
    /// Label in the timetable; unique.
    pub label: String,
    /// Name, any bytes but 0.
    pub name: Vec<u8>,
    /// DEV_CFG_ADDR.
    pub address: AddressSetting,
    /// UID; if blank, the device waits for configuration in mode CFG.
    pub uid: Uid,
    /// Further descriptor fields.
    pub descriptor: Descriptor,
    /// Services, each a list of strings: name, version, possibly more.
    pub services: Vec<Vec<Vec<u8>>>,
    /// DEV_CFG_AUTOSTART: enters mode WORK once it has an address.
    pub autostart: bool,
    /// In IDLE it still sends heartbeats, and a mode command ends it; otherwise only power does.
    pub idle_ends_by_command: bool,
    /// Mode after address resolution; `None`: as configured.
    pub mode: Option<Mode>,
    /// Time of power-on after the start; `None`: by the timetable only.
    pub power_on: Option<Duration>,
    /// Has its address at the first power-on: no address resolution.
    pub skips_address_resolution: bool,
    /// Framing of DES messages.
    pub framing: DeviceFraming,
    /// Sends FD frames.
    pub fd: bool,
    /// Heartbeat period; `None`: BUS_CFG_HR_TIME.
    pub heartbeat: Option<Duration>,
    /// Largest random delay of a heartbeat.
    pub max_heartbeat_delay: Duration,
    /// Deviation of its clock in ppm; positive is slow.
    pub tolerance_ppm: i32,
    /// Shortest and longest random delay of a response.
    pub response_delay: (Duration, Duration),
    /// Faults.
    pub faults: Faults,
    /// Periodic unsolicited data.
    pub periodic_messages: Vec<PeriodicMessage>,
}

impl DeviceSpec {
    /// Returns a working device with that name and label, any address, a UID derived from the name,
    /// and the service DES.
    pub fn new(name: &str) -> Self {
        Self {
            label: name.to_owned(),
            name: name.as_bytes().to_vec(),
            address: AddressSetting::None,
            uid: uid_of(name),
            descriptor: Descriptor {
                firmware: FirmwareVersion { major: 1, minor: 0 },
                capabilities: Capabilities { cpu: 1, ..Capabilities::default() },
                ..Descriptor::default()
            },
            services: vec![vec![b"DES".to_vec(), b"1.0".to_vec()]],
            autostart: true,
            idle_ends_by_command: false,
            mode: None,
            power_on: Some(Duration::ZERO),
            skips_address_resolution: false,
            framing: DeviceFraming::Isotp,
            fd: false,
            heartbeat: None,
            max_heartbeat_delay: Duration::from_micros(500),
            tolerance_ppm: 0,
            response_delay: (Duration::from_micros(200), Duration::from_millis(1)),
            faults: Faults::default(),
            periodic_messages: Vec::new(),
        }
    }

    /// Sets the label.
    #[must_use]
    pub fn label(mut self, label: &str) -> Self {
        label.clone_into(&mut self.label);
        self
    }

    /// Sets the name; the label stays.
    #[must_use]
    pub fn name(mut self, name: &[u8]) -> Self {
        self.name = name.to_vec();
        self
    }

    /// Sets the address.
    #[must_use]
    pub fn address(mut self, address: AddressSetting) -> Self {
        self.address = address;
        self
    }

    /// Sets the fixed address `number`; only the low seven bits count.
    #[must_use]
    pub fn fixed(self, number: u8) -> Self {
        self.address(AddressSetting::Fixed(Address::from_bits(number)))
    }

    /// Sets the preferred address `number`; only the low seven bits count.
    #[must_use]
    pub fn preferred(self, number: u8) -> Self {
        self.address(AddressSetting::Preferred(Address::from_bits(number)))
    }

    /// Sets the UID.
    #[must_use]
    pub fn uid(mut self, uid: Uid) -> Self {
        self.uid = uid;
        self
    }

    /// Adds a service.
    #[must_use]
    pub fn service(mut self, name: &str, version: &str) -> Self {
        self.services.push(vec![name.as_bytes().to_vec(), version.as_bytes().to_vec()]);
        self
    }

    /// Adds a fault.
    #[must_use]
    pub fn fault(mut self, fault: Fault) -> Self {
        self.faults.set(fault, true);
        self
    }

    /// Sets [`skips_address_resolution`](Self#structfield.skips_address_resolution).
    #[must_use]
    pub fn skips_address_resolution(mut self) -> Self {
        self.skips_address_resolution = true;
        self
    }

    /// Sets the time of power-on after the start.
    #[must_use]
    pub fn power_on(mut self, at: Duration) -> Self {
        self.power_on = Some(at);
        self
    }

    /// Sets the framing.
    #[must_use]
    pub fn framing(mut self, framing: DeviceFraming) -> Self {
        self.framing = framing;
        self
    }

    /// Adds periodic unsolicited data. `length` in bytes.
    #[must_use]
    pub fn periodic_message(mut self, service: u16, period: Duration, length: u8) -> Self {
        self.periodic_messages.push(PeriodicMessage {
            service: Service::from_bits(service),
            period,
            length,
            is_debug: false,
        });
        self
    }
}

/// Returns a UID from the first eight characters of `text`; others are mapped into its alphabet.
pub(super) fn uid_of(text: &str) -> Uid {
    let sextets = std::array::from_fn(|at| match text.as_bytes().get(at) {
        Some(byte @ 0x20..=0x5F) => byte - 0x20,
        Some(other) => other.wrapping_mul(31) & 0x3F,
        None => 0,
    });
    Uid::from_sextets(sextets)
}

/// An action on a device.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum DeviceAction {
    /// Switches it on.
    PowerOn,
    /// Switches it off.
    PowerOff,
    /// Switches it off and on; it resolves its address again.
    Reboot {
        /// New services, as after a firmware update; `None`: unchanged.
        services: Option<Vec<Vec<Vec<u8>>>>,
    },
    /// Restarts it at once, as a watchdog does: it keeps its address; the heartbeat phase changes
    /// and pending responses are lost.
    WatchdogReset,
    /// Configures another address, which it resolves.
    Move(AddressSetting),
    /// Stores another DEV_CFG_ADDR, for its next start.
    StoreAddress(AddressSetting),
    /// Stores another DEV_CFG_BSPD, for its next start.
    StoreBitrate(BitrateSetting),
    /// Changes its firmware version.
    Firmware(FirmwareVersion),
    /// Changes its services without a reboot.
    Services(Vec<Vec<Vec<u8>>>),
    /// Changes its mode; INIT and ARSLV start address resolution.
    Mode(Mode),
    /// Changes its name.
    Name(Vec<u8>),
    /// Changes its UID.
    Uid(Uid),
    /// Adds a fault.
    AddFault(Fault),
    /// Removes a fault.
    RemoveFault(Fault),
    /// Sets the share of frames destroyed on the wire, 0 to 1. Concerns the bus, not the device.
    SetFrameErrorProbability(f64),
}

/// An event of the timetable.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TimetableEvent {
    /// Time of the event.
    pub time: Instant,
    /// Period of repetitions; `None`: once.
    pub every: Option<Duration>,
    /// Label of the device; empty for actions on the bus.
    pub device: String,
    /// The action.
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
    /// A value is out of range.
    #[error("{place}: {key} = {value} is not {expected}")]
    Range {
        /// Place: the bus, a device or an entry of the timetable.
        place: String,
        /// Key of the value.
        key: &'static str,
        /// The value.
        value: String,
        /// The allowed values.
        expected: &'static str,
    },
    /// A required value is missing, or a value has no effect.
    #[error("{place}: {problem}")]
    Incomplete {
        /// Place, as above.
        place: String,
        /// The missing or superfluous value.
        problem: String,
    },
    /// Two devices have the same label.
    #[error("two devices are labelled \"{label}\": give one of them a label of its own")]
    DuplicateLabel {
        /// The label.
        label: String,
    },
    /// The timetable contains an unknown device label.
    #[error("{place}: no device labelled \"{device}\"")]
    UnknownDevice {
        /// Entry of the timetable.
        place: String,
        /// The label.
        device: String,
    },
}
