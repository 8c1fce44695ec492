//! The project file `descan.toml`: buses, profile, des.json, catalogue and redundant devices of one
//! system, kept with it.
//!
//! Input: a text and its folder; output: a project. Does not look for the file, and opens no bus.

use crate::app::{ProjectFacts, RedundantTask, TaskDevice};
use crate::bus::BusSpec;
use crate::text::{is_printable, printable};
use crate::toml_error::TomlError;
use crate::wire::id::Address;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use toml::Spanned;

/// Name of the file.
pub const FILE_NAME: &str = "descan.toml";

/// A project. Paths are those of its folder.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Project {
    /// The buses, in the order of the file.
    pub buses: Vec<ProjectBus>,
    /// File of the profile; `None` for the built-in one.
    pub profile: Option<PathBuf>,
    /// des.json of all buses without one of their own.
    pub file: PathBuf,
    /// Folders of the catalogue; `None` for `devices` beside des.json.
    pub catalogue: Option<Vec<PathBuf>>,
    /// Tasks that several devices do, each on its own bus.
    pub tasks: Vec<RedundantTask>,
}

/// A bus of a project.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ProjectBus {
    /// Its name: as it is written in the file, also where that is relative to the folder.
    pub name: String,
    /// The bus.
    pub spec: BusSpec,
    /// Bit rate that it should have, in bit/s.
    pub bitrate: Option<u32>,
    /// Its own des.json.
    pub file: Option<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProjectEntry {
    profile: Option<Spanned<PathBuf>>,
    file: Option<Spanned<PathBuf>>,
    catalogue: Option<Vec<Spanned<PathBuf>>>,
    #[serde(default)]
    bus: Vec<ProjectBusEntry>,
    #[serde(default)]
    redundant: Vec<RedundantTaskEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProjectBusEntry {
    bus: Spanned<String>,
    bitrate: Option<Spanned<u32>>,
    file: Option<Spanned<PathBuf>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RedundantTaskEntry {
    task: Spanned<String>,
    devices: Vec<Spanned<TaskDeviceEntry>>,
}

#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskDeviceEntry {
    bus: String,
    name: Option<String>,
    uid: Option<String>,
    address: Option<u64>,
}

/// A mistake: its place, and what is wrong.
type FaultAt = (Range<usize>, String);

impl Project {
    /// Reads a project file that is in `folder`.
    ///
    /// # Errors
    ///
    /// The first mistake, with its place: it is not TOML, has unknown names, or a value is out of range.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, TomlError> {
        let entry: ProjectEntry =
            toml::from_str(text).map_err(|error| TomlError::of(text, &error))?;
        entry.checked(folder).map_err(|(span, message)| TomlError::new(text, Some(span), message))
    }

    /// What the screen and `check` compare the buses with. Those that are open have the names with which
    /// they are.
    pub fn facts(&self, open: &[(BusSpec, String)]) -> ProjectFacts {
        let name_of = |bus: &ProjectBus| {
            let known = open.iter().find(|(spec, _)| spec.is_same_bus(&bus.spec));
            known.map_or_else(|| bus.name.clone(), |(_, name)| name.clone())
        };
        let names: BTreeMap<&str, String> =
            self.buses.iter().map(|bus| (bus.name.as_str(), name_of(bus))).collect();
        let mut tasks = self.tasks.clone();
        for device in tasks.iter_mut().flat_map(|task| &mut task.devices) {
            if let Some(name) = names.get(device.bus.as_str()) {
                device.bus.clone_from(name);
            }
        }
        let rate = |bus: &ProjectBus| Some((name_of(bus), bus.bitrate?));
        ProjectFacts { bitrates: self.buses.iter().filter_map(rate).collect(), tasks }
    }

    /// Returns the project's bus that a BUS argument names, however it is written.
    pub fn bus(&self, spec: &BusSpec) -> Option<&ProjectBus> {
        self.buses.iter().find(|bus| bus.spec.is_same_bus(spec))
    }

    /// Returns the name of a bus that is opened: that of the project with the bit rates of the argument,
    /// else as it is written.
    pub fn name_of(&self, spec: &BusSpec) -> String {
        match (self.bus(spec), spec) {
            (None, _) => spec.to_string(),
            (Some(bus), BusSpec::Slcan(adapter)) => format!("{}{}", bus.name, adapter.rates()),
            (Some(bus), _) => bus.name.clone(),
        }
    }

    /// Returns the des.json files of the buses, each once; without buses that of the project.
    pub fn files(&self) -> Vec<&Path> {
        let mut files: Vec<&Path> = Vec::new();
        for file in self.buses.iter().map(|bus| bus.file.as_deref().unwrap_or(&self.file)) {
            if !files.contains(&file) {
                files.push(file);
            }
        }
        if files.is_empty() { vec![&self.file] } else { files }
    }

    /// Returns des.json of a bus: its own one, else that of the project.
    pub fn file_of(&self, bus: &BusSpec) -> &Path {
        self.bus(bus).and_then(|bus| bus.file.as_deref()).unwrap_or(&self.file)
    }
}

impl ProjectEntry {
    fn checked(self, folder: &Path) -> Result<Project, FaultAt> {
        let path = |path: Spanned<PathBuf>| in_folder(folder, path);
        let mut buses: Vec<ProjectBus> = Vec::with_capacity(self.bus.len());
        for entry in self.bus {
            let span = entry.bus.span();
            let bus = entry.checked(folder)?;
            if buses.iter().any(|known| known.spec.is_same_bus(&bus.spec)) {
                return Err((span, "stands twice".to_owned()));
            }
            buses.push(bus);
        }
        let tasks: Vec<RedundantTask> = self
            .redundant
            .into_iter()
            .map(|entry| entry.checked(&buses))
            .collect::<Result<_, FaultAt>>()?;
        Ok(Project {
            buses,
            profile: self.profile.map(path).transpose()?,
            file: self.file.map(path).transpose()?.unwrap_or_else(|| folder.join("des.json")),
            catalogue: self.catalogue.map(|all| all.into_iter().map(path).collect()).transpose()?,
            tasks,
        })
    }
}

impl ProjectBusEntry {
    fn checked(self, folder: &Path) -> Result<ProjectBus, FaultAt> {
        let span = self.bus.span();
        let spec = self.bus.get_ref().parse::<BusSpec>();
        let spec = spec.map_err(|fault| (span.clone(), fault.to_string()))?;
        let spec = match spec {
            BusSpec::Stdin => {
                return Err((span, "a project has no standard input".to_owned()));
            }
            // A project sets no bit rate, as an adapter's is set by its address.
            BusSpec::Slcan(adapter) if adapter.bitrate.is_some() => {
                let why =
                    "a project sets no bit rate: write the adapter without @, and bitrate = N";
                return Err((span, why.to_owned()));
            }
            BusSpec::File(path) => BusSpec::File(joined(folder, &path)),
            BusSpec::Sim(name) if crate::sim::Scenario::builtin_text(&name).is_none() => {
                BusSpec::Sim(joined(folder, Path::new(&name)).display().to_string())
            }
            other => other,
        };
        if let Some(rate) = &self.bitrate
            && !crate::bitrate::CLASSIC_RATES.contains(rate.get_ref())
        {
            return Err((rate.span(), "bitrate is 10000 to 1000000 bit/s".to_owned()));
        }
        let bitrate = self.bitrate.map(Spanned::into_inner);
        let file = self.file.map(|file| in_folder(folder, file)).transpose()?;
        let name = self.bus.into_inner();
        Ok(ProjectBus { name, spec, bitrate, file })
    }
}

/// Returns a path of the project's folder.
fn in_folder(folder: &Path, path: Spanned<PathBuf>) -> Result<PathBuf, FaultAt> {
    if path.get_ref().as_os_str().is_empty() {
        return Err((
            path.span(),
            "the path is empty; leave the key out, or name a file".to_owned(),
        ));
    }
    Ok(folder.join(path.into_inner()))
}

/// Returns a path of a folder, without `.` in it: each has one form.
fn joined(folder: &Path, path: &Path) -> PathBuf {
    let path = folder.join(path);
    path.components().filter(|part| *part != Component::CurDir).collect()
}

impl RedundantTaskEntry {
    /// Checks it; `buses` are those of the project.
    fn checked(self, buses: &[ProjectBus]) -> Result<RedundantTask, FaultAt> {
        let (span, task) = (self.task.span(), self.task.into_inner());
        if task.is_empty() || task.chars().count() > 60 || task.chars().any(|c| !is_printable(c)) {
            return Err((span, "task has 1 to 60 printable characters".to_owned()));
        }
        if self.devices.len() < 2 {
            return Err((span, "a redundant task has at least two devices".to_owned()));
        }
        let mut devices = Vec::with_capacity(self.devices.len());
        for entry in self.devices {
            let span = entry.span();
            let device = entry.into_inner().checked(buses).map_err(|why| (span.clone(), why))?;
            if devices.contains(&device) {
                return Err((span, "the device stands twice".to_owned()));
            }
            devices.push(device);
        }
        Ok(RedundantTask { task, devices })
    }
}

impl TaskDeviceEntry {
    fn checked(self, buses: &[ProjectBus]) -> Result<TaskDevice, String> {
        let bus = buses.iter().find(|bus| bus.name == self.bus);
        let name = printable(self.bus.as_bytes());
        match bus.map(|bus| &bus.spec) {
            None => return Err(format!("{name} is no bus of this project")),
            Some(BusSpec::File(_)) => {
                return Err(format!("{name} is a log; redundant devices are on live buses"));
            }
            Some(_) => {}
        }
        let address = self.address.map(|number| {
            let address = u8::try_from(number).ok().and_then(Address::new);
            address.ok_or_else(|| format!("address {number} is not 0 to 127"))
        });
        let address = address.transpose()?;
        if address.is_none() && self.name.is_none() && self.uid.is_none() {
            return Err("a device has a name, a uid or an address".to_owned());
        }
        let texts = [&self.name, &self.uid].into_iter().flatten();
        for text in texts {
            if text.is_empty() || text.chars().any(|c| !is_printable(c)) {
                return Err("a name and a uid have printable characters".to_owned());
            }
        }
        Ok(TaskDevice { bus: self.bus, name: self.name, uid: self.uid, address })
    }
}
