//! What the project says about the buses: bit rates, and which devices do one task on two buses.
//!
//! Pure: the facts and the buses in, the state of each task out. Does not know the project file.

use super::buses::{Bus, Buses};
use super::problems::label_of_device;
use crate::discovery::{Device, DeviceId, Presence};
use crate::time::{Duration, Instant};
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::collections::BTreeMap;

/// Time for which a device must fail before that is certain: five heartbeat periods of the platform, in
/// which one that starts or restarts has its address.
const CERTAIN_AFTER: Duration = Duration::from_secs(5);
/// Time of listening after which a device that was not heard is certainly not there.
const MISSING_AFTER: Duration = Duration::from_secs(10);

/// What a project says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProjectFacts {
    /// Bit rates that buses should have, by bus name, in bit/s.
    pub bitrates: BTreeMap<String, u32>,
    /// Tasks of several devices.
    pub tasks: Vec<RedundantTask>,
}

/// A task that several devices do, each on its own bus (CAN platform §3.1.4).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RedundantTask {
    /// The task, in words.
    pub task: String,
    /// The devices: at least two.
    pub devices: Vec<TaskDevice>,
}

/// A device of a task; what is `None` may be anything.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TaskDevice {
    /// Name of the bus.
    pub bus: String,
    /// Name.
    pub name: Option<String>,
    /// Text of the UID.
    pub uid: Option<String>,
    /// Address.
    pub address: Option<Address>,
}

impl TaskDevice {
    fn is(&self, device: &Device, bus: &Bus) -> bool {
        let is_named =
            |name: &String| device.name.as_ref().is_some_and(|it| it.as_bytes() == name.as_bytes());
        let alphabet = &bus.config().profile.uid;
        let has_uid =
            |uid: &String| device.uid.is_some_and(|own| own.text(alphabet).to_string() == *uid);
        self.name.as_ref().is_none_or(is_named)
            && self.uid.as_ref().is_none_or(has_uid)
            && self.address.is_none_or(|address| device.address == address)
    }

    /// Returns what the device does at present; `taken` are other devices of the task.
    fn end(&self, buses: &Buses, now: Instant, taken: &[DeviceId]) -> TaskEnd {
        let unheard =
            |state, is_certain| TaskEnd { device: None, label: self.label(), state, is_certain };
        let Some((index, bus)) = buses.find_by_name(&self.bus) else {
            return unheard(TaskState::Unknown, false);
        };
        let others = || bus.devices().iter().filter(|device| !taken.contains(&device.id));
        // Of several the one that works, else the last that was heard.
        let rank = |device: &&Device| (state_of(device) == TaskState::Works, device.last_seen);
        let found = others().filter(|device| self.is(device, bus)).max_by_key(rank);
        if let Some(device) = found {
            let label = format!("{} on {}", label_of_device(device), bus.name);
            let state = state_of(device);
            let is_certain = match state {
                TaskState::Away(Presence::Lost, _) => true,
                _ => state.since().is_some_and(|since| now.since(since) >= CERTAIN_AFTER),
            };
            return TaskEnd { device: Some(device.id), label, state, is_certain };
        }
        // It may be one whose name or UID is not known.
        let perhaps = |device: &Device| {
            device.is_present()
                && self.address.is_none_or(|address| device.address == address)
                && (device.name.is_none() || self.uid.is_some() && device.uid.is_none())
        };
        let is_searched = buses.is_search_complete(index, now);
        if !is_searched || others().any(perhaps) {
            return unheard(TaskState::Unknown, false);
        }
        unheard(TaskState::Missing, bus.is_up_for(now, MISSING_AFTER))
    }

    /// What it is called: `SENS at 12 on can0`.
    pub fn label(&self) -> String {
        let name = self.name.as_ref().or(self.uid.as_ref());
        let name = name.map_or("a device", |name| name.as_str());
        let at = self.address.map(|address| format!(" at {address}")).unwrap_or_default();
        format!("{name}{at} on {}", self.bus)
    }
}

/// Whether a device does its task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskState {
    /// It works.
    Works,
    /// It is lost or asleep, since then.
    Away(Presence, Instant),
    /// It is in another mode than WORK, since then.
    InMode(Mode, Instant),
    /// It was not heard, and its bus was searched.
    Missing,
    /// Its bus is not open, or still searched.
    Unknown,
}

/// A device of a task, and what it does at present.
#[derive(Clone, Debug)]
pub struct TaskEnd {
    /// The device; `None` if it was not heard.
    pub device: Option<DeviceId>,
    /// What it is called.
    pub label: String,
    /// Whether it does its task.
    pub state: TaskState,
    /// True if it fails for so long that no start or restart is the cause.
    pub is_certain: bool,
}

impl TaskState {
    /// Returns true if the device is known not to do its task.
    pub fn is_out(self) -> bool {
        !matches!(self, Self::Works | Self::Unknown)
    }

    /// Returns since when it does not do its task, if that is known.
    pub fn since(self) -> Option<Instant> {
        match self {
            Self::Away(_, since) | Self::InMode(_, since) => Some(since),
            _ => None,
        }
    }

    /// Returns it in words: `is lost`.
    pub fn words(self) -> String {
        match self {
            Self::Works => "works".to_owned(),
            Self::Away(presence, _) => format!("is {presence}"),
            Self::InMode(mode, _) => format!("is in {mode}"),
            Self::Missing => "is not on the bus".to_owned(),
            Self::Unknown => "is not known yet".to_owned(),
        }
    }
}

/// Returns the state of a device of a task.
fn state_of(device: &Device) -> TaskState {
    let in_mode = |mode| {
        let change = device.mode_history.iter().rev().find(|change| change.mode == mode);
        TaskState::InMode(mode, change.map_or(device.first_seen, |change| change.time))
    };
    match device.mode {
        _ if !device.is_present() || device.presence == Presence::Asleep => {
            TaskState::Away(device.presence, device.presence_since)
        }
        Some(mode) if mode != Mode::Work => in_mode(mode),
        None if !device.is_working => in_mode(Mode::Cfg),
        _ => TaskState::Works,
    }
}

impl RedundantTask {
    /// Returns the moments at which time alone makes the state of a device certain, before or after `now`.
    pub fn due(&self, buses: &Buses, now: Instant) -> impl Iterator<Item = Instant> {
        let ends = self.ends(buses, now).into_iter().filter_map(|end| end.state.since());
        let buses = self.devices.iter().filter_map(|device| buses.find_by_name(&device.bus));
        let unheard = buses.filter_map(move |(_, bus)| bus.end_of_listening(now, MISSING_AFTER));
        ends.map(|since| since + CERTAIN_AFTER).chain(unheard)
    }

    /// Returns what each device of the task does at present.
    pub fn ends(&self, buses: &Buses, now: Instant) -> Vec<TaskEnd> {
        let mut ends: Vec<TaskEnd> = Vec::with_capacity(self.devices.len());
        for wanted in &self.devices {
            let taken: Vec<DeviceId> = ends.iter().filter_map(|end| end.device).collect();
            ends.push(wanted.end(buses, now, &taken));
        }
        ends
    }
}
