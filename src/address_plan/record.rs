//! The content of a plan's file: what was planned, what became of each step, and where the devices
//! were before.
//!
//! JSON. Written before the first request and after each change; read to go on with a plan, or to
//! take it back. A file may be of anybody: its size and its values are checked.

use super::known_bus::{AddressSet, DeviceIdentity};
use super::run::{PlanRun, RunState, StepState};
use crate::text::Name;
use crate::wire::descriptor::AddressSetting;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use serde::{Deserialize, Serialize};

/// Longest file, in bytes: steps of 127 devices take a tenth of it.
pub const MAX_RECORD_BYTES: u64 = 1 << 20;
/// Version of the format.
const VERSION: u32 = 1;
/// Longest name of a bus in the name of a file.
const MAX_BUS_NAME: usize = 40;
/// Most devices and steps of a file.
const MAX_ROWS: usize = 1024;

/// A plan as its file has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Version of descan that wrote it.
    pub descan: String,
    /// Version of the format, 1.
    pub version: u32,
    /// The bus.
    pub bus: String,
    /// Unix time at which the plan was started, and of the last change, in seconds.
    pub started: f64,
    /// See `started`.
    pub changed: f64,
    /// Where the addresses are from: the path of des.json, or the plan that is taken back.
    pub source: String,
    /// When a write acts: `now`, `restart` (descan restarts the devices) or `later`.
    pub effect: String,
    /// `running`, `stopped`, `stored` or `done`.
    pub state: String,
    /// Why it stopped.
    pub stopped: Option<String>,
    /// The devices that were to move, with their places before the first step.
    pub devices: Vec<RecordedDevice>,
    /// The steps, in their order.
    pub steps: Vec<RecordedStep>,
    /// The steps of earlier runs of this plan that were begun: their devices may have what they wrote.
    #[serde(default)]
    pub earlier: Vec<RecordedStep>,
    /// Devices of earlier plans of the bus of which it was not known, at the start, what they have
    /// stored.
    #[serde(default)]
    pub unsettled: Vec<UnsettledDevice>,
}

/// A device of which it is not known what it has stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnsettledDevice {
    /// The name, for people; `null` if it was unknown.
    pub name: Option<String>,
    /// Its bytes, as hexadecimal digits.
    pub name_hex: Option<String>,
    /// The bytes of the UID, as hexadecimal digits; `null` if it was not heard.
    pub uid_hex: Option<String>,
    /// The addresses that it may have stored, or come back to.
    pub addresses: Vec<u8>,
    /// The code of the setting that it confirmed to have stored; `null` if it confirmed none.
    pub stored: Option<u8>,
}

/// A device of a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedDevice {
    /// The name, for people; `null` if it was unknown.
    pub name: Option<String>,
    /// Its bytes, as hexadecimal digits.
    pub name_hex: Option<String>,
    /// The bytes of the UID, as hexadecimal digits; `null` if it was not heard.
    pub uid_hex: Option<String>,
    /// Where it was.
    pub original: RecordedPlace,
    /// The address it was to have.
    pub to: u8,
    /// The code of the setting it was to have; `null`: as all others of the plan.
    #[serde(default)]
    pub setting: Option<u8>,
}

/// An address, and the setting that a device had stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedPlace {
    /// The address.
    pub address: u8,
    /// The code of the setting, DEV_CFG_ADDR; `null` if it was not read.
    pub setting: Option<u8>,
}

/// A step of a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedStep {
    /// Place of its device in `devices`.
    pub device: usize,
    /// The address before.
    pub from: u8,
    /// The address afterwards.
    pub to: u8,
    /// The code that is written; `null`: the device only restarts.
    pub setting: Option<u8>,
    /// Why it could be done.
    pub why: String,
    /// `pending`, `sent`, `responded`, `stored`, `confirmed` or `failed`.
    pub state: String,
    /// Why it failed.
    pub cause: Option<String>,
}

impl RecordedDevice {
    /// Returns the record of a device.
    pub fn new(
        identity: &DeviceIdentity,
        address: Address,
        setting: Option<AddressSetting>,
        to: Address,
    ) -> Self {
        Self {
            name: identity.name.as_ref().map(ToString::to_string),
            name_hex: identity.name.as_ref().map(Name::hex),
            uid_hex: identity.uid.map(|uid| crate::text::hex(&uid.0, "")),
            original: RecordedPlace {
                address: address.number(),
                setting: setting.map(AddressSetting::code),
            },
            to: to.number(),
            setting: None,
        }
    }

    /// Returns who it is.
    pub fn identity(&self) -> DeviceIdentity {
        identity(self.uid_hex.as_deref(), self.name_hex.as_deref())
    }

    /// Returns where it was, and the setting that it had stored.
    pub fn place(&self) -> (Address, Option<AddressSetting>) {
        let setting = self.original.setting.and_then(AddressSetting::from_code);
        (Address::from_bits(self.original.address), setting)
    }
}

impl UnsettledDevice {
    /// Returns who it is.
    pub fn identity(&self) -> DeviceIdentity {
        identity(self.uid_hex.as_deref(), self.name_hex.as_deref())
    }

    /// Returns the addresses that it may have stored, or come back to.
    pub fn possible(&self) -> AddressSet {
        self.addresses.iter().copied().map(Address::from_bits).collect()
    }

    /// Returns the setting that it has stored; `None` if that is not known.
    pub fn setting(&self) -> Option<AddressSetting> {
        self.stored.and_then(AddressSetting::from_code)
    }
}

impl RecordedStep {
    /// Returns true if its request was sent, or may have been.
    pub fn is_begun(&self) -> bool {
        self.state != StepState::Pending.word()
    }
}

/// Returns who a device is, from hexadecimal digits.
fn identity(uid_hex: Option<&str>, name_hex: Option<&str>) -> DeviceIdentity {
    let uid = uid_hex.and_then(bytes_of).and_then(|bytes| <[u8; 6]>::try_from(bytes).ok());
    let name = name_hex.and_then(bytes_of).map(|bytes| Name::new(&bytes));
    DeviceIdentity { uid: uid.map(Uid), name }
}

/// Returns the bytes of hexadecimal digits; `None` if it has others.
fn bytes_of(digits: &str) -> Option<Vec<u8>> {
    let is_even = digits.len().is_multiple_of(2) && digits.is_ascii();
    let parts = (0..digits.len()).step_by(2);
    let bytes = parts.map(|at| u8::from_str_radix(digits.get(at..at + 2)?, 16).ok());
    is_even.then(|| bytes.collect()).flatten()
}

impl PlanRecord {
    /// Returns the name of the file of a plan that is started at `time`.
    pub fn file_name(time: &str, bus: &str) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
        let bus: String = bus.chars().map(plain).take(MAX_BUS_NAME).collect();
        format!("{time}-{bus}.json")
    }

    /// Reads the content of a file.
    ///
    /// # Errors
    ///
    /// What is wrong with it.
    pub fn parse(content: &[u8]) -> Result<Self, String> {
        if content.len() as u64 > MAX_RECORD_BYTES {
            return Err("larger than 1 MiB: not a plan of descan".to_owned());
        }
        let record: Self = serde_json::from_slice(content).map_err(|error| {
            format!("not a plan of descan: line {}, column {}", error.line(), error.column())
        })?;
        record.check()?;
        Ok(record)
    }

    fn check(&self) -> Result<(), String> {
        if self.version != VERSION {
            return Err(format!("format {} is not known: {VERSION} is", self.version));
        }
        let lengths =
            [self.devices.len(), self.steps.len(), self.earlier.len(), self.unsettled.len()];
        if lengths.into_iter().any(|length| length > MAX_ROWS) {
            return Err(format!("more than {MAX_ROWS} devices or steps"));
        }
        let addresses = self.devices.iter().flat_map(|it| [it.original.address, it.to]);
        let addresses = addresses.chain(self.all_steps().flat_map(|it| [it.from, it.to]));
        let addresses = addresses.chain(self.unsettled.iter().flat_map(|it| it.addresses.clone()));
        let is_wrong = |address: &u8| !(1..128).contains(address);
        if let Some(wrong) = { addresses }.find(is_wrong) {
            return Err(format!("{wrong} is not an address: 1 to 127"));
        }
        let has_no_identity = |it: &RecordedDevice| !it.identity().is_known();
        if let Some(at) = self.devices.iter().position(has_no_identity) {
            return Err(format!("device {} has neither UID nor name", at + 1));
        }
        if let Some(at) = self.unsettled.iter().position(|it| !it.identity().is_known()) {
            return Err(format!("unsettled device {} has neither UID nor name", at + 1));
        }
        if self.all_steps().any(|step| step.device >= self.devices.len()) {
            return Err("a step of an unknown device".to_owned());
        }
        Ok(())
    }

    /// Takes the state of a run. `places`: the place in `devices` of the device of each goal.
    pub fn update(&mut self, run: &PlanRun, places: &[Option<usize>], changed: f64) {
        env!("CARGO_PKG_VERSION").clone_into(&mut self.descan);
        self.version = VERSION;
        self.changed = changed;
        run.state().word().clone_into(&mut self.state);
        self.stopped = match run.state() {
            RunState::Stopped(cause) => Some(cause.clone()),
            _ => None,
        };
        let steps = run.plan().steps.iter().zip(run.states());
        let steps = steps.filter_map(|(step, state)| {
            Some(RecordedStep {
                device: places.get(step.goal).copied().flatten()?,
                from: step.from.number(),
                to: step.to.number(),
                setting: step.setting.map(AddressSetting::code),
                why: step.why(),
                state: state.word().to_owned(),
                cause: match state {
                    StepState::Failed(cause) => Some(cause.clone()),
                    _ => None,
                },
            })
        });
        self.steps = steps.collect();
    }

    /// The steps of all runs, the first one first.
    pub fn all_steps(&self) -> impl DoubleEndedIterator<Item = &RecordedStep> {
        self.earlier.iter().chain(&self.steps)
    }

    /// Prepares for another run: keeps the steps that were begun as earlier ones, of each device those
    /// since it was confirmed last.
    pub fn begin_again(&mut self) {
        let steps = std::mem::take(&mut self.steps);
        self.earlier.extend(steps.into_iter().filter(RecordedStep::is_begun));
        let mut kept: Vec<RecordedStep> = Vec::new();
        for step in std::mem::take(&mut self.earlier) {
            if step.state == StepState::Confirmed.word() {
                kept.retain(|it| it.device != step.device);
            }
            // A run that is repeated fails in the same way.
            kept.retain(|it| *it != step);
            kept.push(step);
        }
        kept.drain(..kept.len().saturating_sub(MAX_ROWS));
        self.earlier = kept;
    }

    /// Returns true if nothing remains to be done.
    pub fn is_done(&self) -> bool {
        self.state == RunState::Done.word()
    }

    /// Addresses at which a device of the plan may come back, as far as the file tells.
    pub fn possible_addresses(&self, device: usize) -> Vec<Address> {
        let original = self.devices.get(device).map(|it| it.original.address);
        let is_begun = |step: &&RecordedStep| step.device == device && step.is_begun();
        let begun = self.all_steps().filter(is_begun).flat_map(|step| [step.from, step.to]);
        let mut all: Vec<u8> = original.into_iter().chain(begun).collect();
        all.sort_unstable();
        all.dedup();
        all.into_iter().map(Address::from_bits).collect()
    }

    /// The devices of which it is not known what they have stored: those whose last write was not
    /// confirmed, and those of earlier plans.
    pub fn unsettled_devices(&self) -> Vec<UnsettledDevice> {
        let is_confirmed = |step: &RecordedStep| step.state == StepState::Confirmed.word();
        let is_open = |place: &usize| self.last_begun(*place).is_some_and(|it| !is_confirmed(it));
        let own = (0..self.devices.len()).filter(is_open).map(|place| self.unsettled_device(place));
        let is_written = |it: &UnsettledDevice| {
            let identity = it.identity();
            let is_it = |place: usize| identity.is_same(&self.devices[place].identity());
            (0..self.devices.len()).any(|place| is_it(place) && self.last_begun(place).is_some())
        };
        let earlier = self.unsettled.iter().filter(|it| !is_written(it)).cloned();
        own.chain(earlier).collect()
    }

    /// The other devices of the plan, with the address at which each was confirmed, or was before.
    pub fn settled_devices(&self) -> Vec<UnsettledDevice> {
        let is_confirmed = |step: &RecordedStep| step.state == StepState::Confirmed.word();
        let is_settled = |place: &usize| self.last_begun(*place).is_none_or(is_confirmed);
        let settled = (0..self.devices.len()).filter(is_settled).map(|place| {
            let confirmed = self.last_begun(place).map(|step| step.to);
            let address = confirmed.unwrap_or(self.devices[place].original.address);
            UnsettledDevice {
                addresses: vec![address],
                stored: None,
                ..self.unsettled_device(place)
            }
        });
        settled.collect()
    }

    fn unsettled_device(&self, place: usize) -> UnsettledDevice {
        let device = &self.devices[place];
        let has_it = |it: &&RecordedStep| {
            it.state == StepState::Stored.word() || it.state == StepState::Responded.word()
        };
        let possible = self.possible_addresses(place);
        UnsettledDevice {
            name: device.name.clone(),
            name_hex: device.name_hex.clone(),
            uid_hex: device.uid_hex.clone(),
            addresses: possible.iter().map(|address| address.number()).collect(),
            stored: self.last_begun(place).filter(has_it).and_then(|it| it.setting),
        }
    }

    /// The last step of a device that was begun.
    pub fn last_begun(&self, device: usize) -> Option<&RecordedStep> {
        self.all_steps().rfind(|step| step.device == device && step.is_begun())
    }

    /// Returns the content of the file.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Plain structs of texts and numbers: it does not fail.
        let mut bytes = serde_json::to_vec_pretty(self).unwrap_or_default();
        bytes.push(b'\n');
        bytes
    }
}
