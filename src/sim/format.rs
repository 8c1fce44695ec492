//! TOML format of scenarios, and its errors.
//!
//! ```toml
//! bitrate = 125000                    # needed; then optional: data_bitrate, seed, error_rate,
//! error_rate = 0.01                   # observer_loss
//!
//! [profile.commands]                  # what the devices use, as in a profile
//! reboot = 0x01A
//!
//! [[device]]                          # all but the name is optional
//! name = "ACT"                        # or name_hex = "414354"
//! label = "the valve"                 # label in the timetable; else its name
//! address = { preferred = 14 }        # or { fixed = 14 }, or "any"
//! uid = "BOILER03"                    # "" = blank; else made of the label
//! services = [["DES", "1.0"], ["VALVE", "1.2", "more"]]
//! autostart = true
//! idle = "power"                       # or "command": what ends IDLE
//! mode = "WORK"                       # instead of the configured one
//! power_on = 4.0                      # seconds; false = off
//! settled = true                      # has its address at the first power-on
//! framing = "isotp"                   # or "raw", "both"
//! fd = false
//! heartbeat_ms = 1000
//! jitter_ms = 0.5
//! tolerance_ppm = 40
//! delay_us = [200, 1000]              # before responses
//! faults = ["drop-frame"]             # see Fault
//! chatter = [{ service = 0x130, period_ms = 250, length = 8, debug = false }]
//! gid = "010203040506"
//! serial = 7
//! firmware = [2, 1]
//! programmable = true
//! fpu = false
//! bit_rate = { fixed = 125000 }       # or { preferred = 125000 }
//!
//! [[at]]
//! time = 30.0                         # seconds; again with every = 60.0
//! device = "the valve"
//! do = "reboot"                       # optional: services
//! # join, leave, firmware (firmware), quick-reboot, move (address), services (services), mode (mode), name (name or
//! # name_hex), uid (uid), break and mend (fault); without a device: error-rate (rate)
//! ```
//!
//! Translation only; the meaning of the values is in [`super::scenario`].

use super::scenario::{
    Descriptor, DeviceAction, DeviceFraming, DeviceSpec, Fault, Faults, PeriodicMessage, Scenario,
    ScenarioError, TimetableEvent, uid_of,
};
use crate::time::{Duration, Instant};
use crate::wire::descriptor::{AddressSetting, BitrateSetting, FirmwareVersion, Gid};
use crate::wire::id::{Address, Service};
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::{Profile, UidProfile};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::fmt::Display;

/// Longest time in a scenario, in seconds: a year.
const LONGEST: f64 = 366.0 * 86_400.0;
/// Most devices on one bus: four per address.
const MAX_DEVICES: usize = 512;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioWritten {
    bitrate: u32,
    data_bitrate: Option<u32>,
    seed: Option<u64>,
    #[serde(default)]
    error_rate: f64,
    #[serde(default)]
    observer_loss: f64,
    #[serde(default)]
    device: Vec<DeviceWritten>,
    #[serde(default)]
    at: Vec<EventWritten>,
    profile: Option<toml::Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DeviceWritten {
    label: Option<String>,
    name: Option<String>,
    name_hex: Option<String>,
    address: Option<AddressRead>,
    uid: Option<String>,
    gid: Option<String>,
    #[serde(default)]
    serial: u32,
    firmware: Option<[u16; 2]>,
    programmable: Option<bool>,
    fpu: Option<bool>,
    bit_rate: Option<BitrateRead>,
    services: Option<Vec<Vec<String>>>,
    autostart: Option<bool>,
    #[serde(default)]
    idle: IdleWritten,
    mode: Option<String>,
    power_on: Option<PowerOn>,
    #[serde(default)]
    settled: bool,
    #[serde(default)]
    framing: DeviceFraming,
    #[serde(default)]
    fd: bool,
    heartbeat_ms: Option<f64>,
    jitter_ms: Option<f64>,
    #[serde(default)]
    tolerance_ppm: i32,
    delay_us: Option<[u32; 2]>,
    #[serde(default)]
    faults: Vec<Fault>,
    #[serde(default)]
    chatter: Vec<ChatterWritten>,
}

/// What ends the mode IDLE.
#[derive(Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum IdleWritten {
    #[default]
    Power,
    Command,
}

/// DEV_CFG_ADDR.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "AddressWritten")]
struct AddressRead(AddressSetting);

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum AddressWritten {
    Any,
    Preferred(u8),
    Fixed(u8),
}

impl TryFrom<AddressWritten> for AddressRead {
    type Error = String;
    fn try_from(written: AddressWritten) -> Result<Self, String> {
        let address = |number| {
            Address::new(number)
                .filter(|&address| address != Address::DEBUG)
                .ok_or_else(|| format!("{number} is not a node address (1 to 127)"))
        };
        Ok(Self(match written {
            AddressWritten::Any => AddressSetting::None,
            AddressWritten::Preferred(number) => AddressSetting::Preferred(address(number)?),
            AddressWritten::Fixed(number) => AddressSetting::Fixed(address(number)?),
        }))
    }
}

/// DEV_CFG_BSPD.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "BitrateWritten")]
struct BitrateRead(BitrateSetting);

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum BitrateWritten {
    Preferred(u32),
    Fixed(u32),
}

impl TryFrom<BitrateWritten> for BitrateRead {
    type Error = String;
    fn try_from(written: BitrateWritten) -> Result<Self, String> {
        let (rate, is_fixed) = match written {
            BitrateWritten::Preferred(rate) => (rate, false),
            BitrateWritten::Fixed(rate) => (rate, true),
        };
        if !BitrateSetting::RATES.contains(&rate) {
            return Err(format!("{rate} is not 125000, 250000, 500000 or 1000000"));
        }
        Ok(Self(BitrateSetting { rate, is_fixed }))
    }
}

/// Time in seconds, or `false` for a device that only the timetable switches on.
#[derive(Deserialize)]
#[serde(untagged, expecting = "power_on is a time in seconds, or false")]
enum PowerOn {
    At(f64),
    Whether(bool),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ChatterWritten {
    service: u16,
    period_ms: f64,
    #[serde(default = "eight")]
    length: u8,
    #[serde(default)]
    debug: bool,
}

const fn eight() -> u8 {
    8
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EventWritten {
    time: f64,
    every: Option<f64>,
    #[serde(default)]
    device: String,
    #[serde(rename = "do")]
    what: EventAction,
    services: Option<Vec<Vec<String>>>,
    address: Option<AddressRead>,
    firmware: Option<[u16; 2]>,
    mode: Option<String>,
    name: Option<String>,
    name_hex: Option<String>,
    uid: Option<String>,
    fault: Option<Fault>,
    rate: Option<f64>,
}

#[derive(Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum EventAction {
    Join,
    Leave,
    Reboot,
    Firmware,
    QuickReboot,
    Move,
    Services,
    Mode,
    Name,
    Uid,
    Break,
    Mend,
    ErrorRate,
}

impl Scenario {
    /// Reads a scenario from TOML.
    ///
    /// # Errors
    /// [`ScenarioError`] if it is not TOML, has unknown names, or a value is out of range.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let written: ScenarioWritten = toml::from_str(text)?;
        let bus = ScenarioPath("the bus".to_owned());
        let defaults = Scenario::default();
        let mut scenario = Scenario {
            bitrate: written.bitrate,
            data_bitrate: written
                .data_bitrate
                .unwrap_or_else(|| defaults.data_bitrate.max(written.bitrate)),
            seed: written.seed.unwrap_or(defaults.seed),
            frame_error_probability: bus.share("error_rate", written.error_rate)?,
            rx_loss: bus.share("observer_loss", written.observer_loss)?,
            devices: Vec::new(),
            timetable: Vec::new(),
            profile: profile_of(written.profile)?,
        };
        bus.range("bitrate", scenario.bitrate, 10_000, 1_000_000, "10000 to 1000000 bit/s")?;
        bus.range("data_bitrate", scenario.data_bitrate, 10_000, 8_000_000, "up to 8000000 bit/s")?;
        if written.device.len() > MAX_DEVICES {
            return Err(bus.out_of_range("device", &written.device.len(), "at most 512 devices"));
        }
        let mut labels = BTreeSet::new();
        for (index, device) in written.device.into_iter().enumerate() {
            let device = device.translate(index + 1)?;
            if !labels.insert(device.label.clone()) {
                return Err(ScenarioError::DuplicateLabel { label: device.label });
            }
            scenario.devices.push(device);
        }
        for (index, event) in written.at.into_iter().enumerate() {
            let place = ScenarioPath(format!("[[at]] number {}", index + 1));
            let event = event.translate(&place)?;
            let for_bus = matches!(event.action, DeviceAction::SetFrameErrorProbability(_));
            if for_bus != event.device.is_empty() {
                let problem =
                    if for_bus { "applies to the bus, not to a device" } else { "needs `device`" };
                return Err(place.incomplete(problem));
            }
            if !for_bus && !labels.contains(&event.device) {
                return Err(ScenarioError::UnknownDevice { place: place.0, device: event.device });
            }
            scenario.timetable.push(event);
        }
        Ok(scenario)
    }
}

/// Reads the table `profile`, which has what a profile file has.
fn profile_of(written: Option<toml::Table>) -> Result<Profile, ScenarioError> {
    let Some(table) = written else { return Ok(Profile::default()) };
    Profile::parse(&table.to_string()).map_err(|error| {
        ScenarioPath("[profile]".to_owned())
            .incomplete(&format!("has a mistake: {}", error.message()))
    })
}

impl DeviceWritten {
    fn translate(self, number: usize) -> Result<DeviceSpec, ScenarioError> {
        let called = self.label.as_deref().or(self.name.as_deref()).unwrap_or("without a name");
        let place = ScenarioPath(format!("[[device]] number {number} ({called})"));
        let name = place.name(self.name, self.name_hex)?;
        let name = name.ok_or_else(|| place.incomplete("needs `name` or `name_hex`"))?;
        let text = String::from_utf8_lossy(&name).into_owned();
        let label = self.label.unwrap_or(text);
        let defaults = DeviceSpec::new(&label);
        let power_on = match self.power_on {
            None => defaults.power_on,
            Some(PowerOn::At(seconds)) => Some(place.seconds("power_on", seconds)?),
            Some(PowerOn::Whether(false)) => None,
            Some(PowerOn::Whether(true)) => {
                return Err(place.out_of_range("power_on", &true, "a time in seconds, or false"));
            }
        };
        let delay = match self.delay_us {
            None => defaults.response_delay,
            Some([least, most]) if least <= most => {
                (Duration::from_micros(least.into()), Duration::from_micros(most.into()))
            }
            Some(delay) => {
                let value = format!("{delay:?}");
                return Err(place.out_of_range("delay_us", &value, "[least, most]"));
            }
        };
        let mut faults = Faults::default();
        for fault in self.faults {
            faults.set(fault, true);
        }
        place.range("tolerance_ppm", self.tolerance_ppm, -100_000, 100_000, "within 100000")?;
        let longest = if self.fd { 64 } else { 8 };
        let chatter = self
            .chatter
            .into_iter()
            .map(|chatter| {
                place.range("chatter.length", chatter.length, 0, longest, "what a frame holds")?;
                let service = Service::new(chatter.service).ok_or_else(|| {
                    place.out_of_range("chatter.service", &chatter.service, "0 to 1023")
                })?;
                let period = place.period("chatter.period_ms", chatter.period_ms)?;
                let (length, is_debug) = (chatter.length, chatter.debug);
                Ok(PeriodicMessage { service, period, length, is_debug })
            })
            .collect::<Result<_, ScenarioError>>()?;
        let mut descriptor = Descriptor { serial: self.serial, ..defaults.descriptor };
        if let Some(gid) = self.gid {
            descriptor.gid = Gid::parse(&gid)
                .ok_or_else(|| place.out_of_range("gid", &gid, "twelve hexadecimal digits"))?;
        }
        if let Some([major, minor]) = self.firmware {
            descriptor.firmware = FirmwareVersion { major, minor };
        }
        descriptor.capabilities.is_programmable = self.programmable.unwrap_or(false);
        descriptor.capabilities.has_fpu = self.fpu.unwrap_or(false);
        descriptor.bitrate = self.bit_rate.map(|it| it.0);
        Ok(DeviceSpec {
            descriptor,
            address: self.address.map_or(defaults.address, |it| it.0),
            uid: self.uid.map_or(Ok(uid_of(&label)), |uid| place.uid(&uid))?,
            services: self
                .services
                .map_or(Ok(defaults.services), |services| place.services(services))?,
            autostart: self.autostart.unwrap_or(defaults.autostart),
            idle_ends_by_command: self.idle == IdleWritten::Command,
            mode: self.mode.map(|mode| place.mode(&mode)).transpose()?,
            power_on,
            skips_address_resolution: self.settled,
            framing: self.framing,
            fd: self.fd,
            heartbeat: self.heartbeat_ms.map(|ms| place.period("heartbeat_ms", ms)).transpose()?,
            max_heartbeat_delay: match self.jitter_ms {
                Some(ms) => place.seconds("jitter_ms", ms / 1000.0)?,
                None => defaults.max_heartbeat_delay,
            },
            tolerance_ppm: self.tolerance_ppm,
            response_delay: delay,
            faults,
            periodic_messages: chatter,
            label,
            name,
        })
    }
}

impl EventWritten {
    fn translate(self, place: &ScenarioPath) -> Result<TimetableEvent, ScenarioError> {
        let given = [
            (
                "services",
                self.services.is_some(),
                [EventAction::Services, EventAction::Reboot].as_slice(),
            ),
            ("address", self.address.is_some(), &[EventAction::Move]),
            ("mode", self.mode.is_some(), &[EventAction::Mode]),
            ("name", self.name.is_some(), &[EventAction::Name]),
            ("name_hex", self.name_hex.is_some(), &[EventAction::Name]),
            ("uid", self.uid.is_some(), &[EventAction::Uid]),
            ("firmware", self.firmware.is_some(), &[EventAction::Firmware]),
            ("fault", self.fault.is_some(), &[EventAction::Break, EventAction::Mend]),
            ("rate", self.rate.is_some(), &[EventAction::ErrorRate]),
        ];
        if let Some((key, ..)) =
            given.into_iter().find(|(_, given, by)| *given && !by.contains(&self.what))
        {
            return Err(place.incomplete(&format!("`{key}` not allowed for this action")));
        }
        let needs = |key: &str| place.incomplete(&format!("needs `{key}`"));
        let services = self.services.map(|services| place.services(services)).transpose()?;
        let action = match self.what {
            EventAction::Join => DeviceAction::PowerOn,
            EventAction::Leave => DeviceAction::PowerOff,
            EventAction::Reboot => DeviceAction::Reboot { services },
            EventAction::Firmware => {
                let [major, minor] = self.firmware.ok_or_else(|| needs("firmware"))?;
                DeviceAction::Firmware(FirmwareVersion { major, minor })
            }
            EventAction::QuickReboot => DeviceAction::WatchdogReset,
            EventAction::Move => {
                DeviceAction::Move(self.address.ok_or_else(|| needs("address"))?.0)
            }
            EventAction::Services => {
                DeviceAction::Services(services.ok_or_else(|| needs("services"))?)
            }
            EventAction::Mode => {
                DeviceAction::Mode(place.mode(&self.mode.ok_or_else(|| needs("mode"))?)?)
            }
            EventAction::Name => DeviceAction::Name(
                place.name(self.name, self.name_hex)?.ok_or_else(|| needs("name"))?,
            ),
            EventAction::Uid => {
                DeviceAction::Uid(place.uid(&self.uid.ok_or_else(|| needs("uid"))?)?)
            }
            EventAction::Break => DeviceAction::AddFault(self.fault.ok_or_else(|| needs("fault"))?),
            EventAction::Mend => {
                DeviceAction::RemoveFault(self.fault.ok_or_else(|| needs("fault"))?)
            }
            EventAction::ErrorRate => {
                let rate = self.rate.ok_or_else(|| needs("rate"))?;
                DeviceAction::SetFrameErrorProbability(place.share("rate", rate)?)
            }
        };
        let time = Instant::ZERO + place.seconds("time", self.time)?;
        let every = self.every.map(|every| place.period("every", every * 1000.0)).transpose()?;
        Ok(TimetableEvent { time, every, device: self.device, action })
    }
}

/// Path of a value in the scenario, for messages.
struct ScenarioPath(String);

impl ScenarioPath {
    fn out_of_range(
        &self,
        key: &'static str,
        value: &dyn Display,
        expected: &'static str,
    ) -> ScenarioError {
        ScenarioError::Range { place: self.0.clone(), key, value: value.to_string(), expected }
    }

    fn incomplete(&self, problem: &str) -> ScenarioError {
        ScenarioError::Incomplete { place: self.0.clone(), problem: problem.to_owned() }
    }

    fn range<T: PartialOrd + Copy + Display>(
        &self,
        key: &'static str,
        value: T,
        least: T,
        most: T,
        expected: &'static str,
    ) -> Result<(), ScenarioError> {
        if value >= least && value <= most {
            Ok(())
        } else {
            Err(self.out_of_range(key, &value, expected))
        }
    }

    fn share(&self, key: &'static str, value: f64) -> Result<f64, ScenarioError> {
        self.range(key, value, 0.0, 1.0, "a share, 0 to 1").map(|()| value)
    }

    fn seconds(&self, key: &'static str, value: f64) -> Result<Duration, ScenarioError> {
        self.range(key, value, 0.0, LONGEST, "a time from 0 to a year")?;
        Ok(Duration::from_secs_f64(value))
    }

    fn period(&self, key: &'static str, ms: f64) -> Result<Duration, ScenarioError> {
        self.range(key, ms, 0.1, LONGEST * 1000.0, "at least 0.1 ms")?;
        Ok(Duration::from_secs_f64(ms / 1000.0))
    }

    fn mode(&self, name: &str) -> Result<Mode, ScenarioError> {
        let expected = "INIT, ARSLV, CFG, BOOT, WORK, UFUNC or IDLE";
        Mode::from_name(name).ok_or_else(|| self.out_of_range("mode", &name, expected))
    }

    fn uid(&self, text: &str) -> Result<Uid, ScenarioError> {
        if text.is_empty() {
            return Ok(Uid([0; 6]));
        }
        let expected = "up to 8 characters from space to underscore, no small letters";
        Uid::parse(text, &UidProfile::default())
            .ok_or_else(|| self.out_of_range("uid", &text, expected))
    }

    /// Returns the name from `name` or `name_hex`; `None` if neither is given.
    fn name(
        &self,
        text: Option<String>,
        hex: Option<String>,
    ) -> Result<Option<Vec<u8>>, ScenarioError> {
        let bytes = match (text, hex) {
            (None, None) => return Ok(None),
            (Some(text), None) => text.into_bytes(),
            (None, Some(hex)) => {
                let expected = "pairs of hexadecimal digits";
                bytes_of_hex(&hex).ok_or_else(|| self.out_of_range("name_hex", &hex, expected))?
            }
            (Some(_), Some(_)) => return Err(self.incomplete("has both `name` and `name_hex`")),
        };
        if bytes.contains(&0) || bytes.len() > 1000 {
            let value = format!("{} bytes", bytes.len());
            return Err(self.out_of_range("name", &value, "up to 1000 bytes, none of them 0"));
        }
        Ok(Some(bytes))
    }

    fn services(&self, written: Vec<Vec<String>>) -> Result<Vec<Vec<Vec<u8>>>, ScenarioError> {
        let bytes: usize = written.iter().flatten().map(|text| text.len() + 2).sum();
        if written.len() > 256 || bytes > 4000 {
            let value = format!("{} of them, {bytes} bytes", written.len());
            return Err(self.out_of_range("services", &value, "at most 256 and 4000 bytes"));
        }
        if written.iter().flatten().any(|text| text.contains('\0')) {
            return Err(self.incomplete("a zero byte in a service's strings"));
        }
        let bytes = |service: Vec<String>| service.into_iter().map(String::into_bytes).collect();
        Ok(written.into_iter().map(bytes).collect())
    }
}

fn bytes_of_hex(hex: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> =
        hex.chars().map(|c| c.to_digit(16).map(|digit| digit as u8)).collect::<Option<_>>()?;
    let (pairs, rest) = digits.as_chunks::<2>();
    rest.is_empty().then(|| pairs.iter().map(|[high, low]| high << 4 | low).collect())
}
