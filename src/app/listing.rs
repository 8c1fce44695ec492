//! Devices as entries of des.json: new entries, and services as they are listed.
//!
//! Pure: devices and entries in, entries and texts out.

use super::buses::Buses;
use super::file::{Documents, EntryPlace, FileIndex};
use super::file_inputs::Inputs;
use crate::discovery::{Device, DeviceService};
use crate::document::{Entry, ListedService, NewEntry, Operation, OwnService, same_services};
use crate::finding::FindingState;
use crate::frame::BusIndex;
use crate::text::{Name, printable};

/// Entry of des.json for a device, with its present address, not pinned; `None` while its name is
/// not known.
pub(super) fn new_entry(buses: &Buses, documents: Documents, device: &Device) -> Option<NewEntry> {
    let bus = buses.get(device.id.bus)?;
    let alphabet = &bus.config().profile.uid;
    // At a shared address the last UID may be the other device's.
    let is_shared = bus.findings().iter().any(|finding| {
        finding.key.kind.is_conflict()
            && finding.state != FindingState::Cleared
            && finding.addresses.contains(&device.address)
    });
    let uid = device.uid.filter(|uid| !uid.is_blank() && !is_shared);
    let uid = uid.map(|uid| uid.text(alphabet).to_string());
    Some(NewEntry {
        name: device.name.as_ref()?.as_bytes().to_vec(),
        address: Some(device.address.number()).filter(|address| *address > 0),
        is_static: false,
        bus: entry_bus(buses, documents, Some(device.id.bus)),
        uid: uid.filter(|uid| !uid.trim().is_empty()),
        services: listed_services(device),
    })
}

/// Name of the bus for a new entry of its file; `None` if no other bus has that file, unless an entry
/// names another one: it could have the same content.
pub(super) fn entry_bus(
    buses: &Buses,
    documents: Documents,
    bus: Option<BusIndex>,
) -> Option<String> {
    let index = bus?;
    let (bus, file) = (buses.get(index)?, documents.of_bus(index));
    let is_shared = documents.buses_of(file, buses).count() > 1;
    let mut entries = documents.entries(file).iter();
    let name = || bus.name_without_rates().to_owned();
    (is_shared || entries.any(|entry| !entry.is_for_bus(&bus.name))).then(name)
}

/// The reason why a device cannot be added to the file; `None` if it can.
pub fn addition_refusal(device: &Device) -> Option<&'static str> {
    match &device.name {
        _ if device.is_debug => Some("debug devices cannot be added to the file"),
        None => Some("name not known yet: cannot add the device"),
        Some(_) => None,
    }
}

/// The operation that adds a device to the file of its bus, or updates the services of its entry;
/// `None` if the file matches the device or its name is not known.
pub(super) fn update_operation(inputs: Inputs, device: &Device) -> Option<(FileIndex, Operation)> {
    let Some(place) = inputs.matching.entry_of(device.id) else {
        let entry = new_entry(inputs.buses, inputs.documents, device)?;
        return Some((inputs.documents.of_bus(device.id.bus), Operation::Add { entry }));
    };
    let EntryPlace { file, index } = place;
    let own = device.services.as_ref()?;
    let (document, entry) = (inputs.documents.get(file)?, inputs.documents.entry(place)?);
    if same_services(entry, own) {
        return None;
    }
    let listed = entry.services.as_deref().unwrap_or_default();
    let mut services = listed_services(device);
    leave_open(&mut services, listed);
    Some((file, Operation::SetServices { entry: document.key(index), services }))
}

fn listed_services(device: &Device) -> Vec<ListedService> {
    let services = device.services.iter().flatten();
    services
        .map(|service| ListedService {
            name: as_listed(&service.name),
            version: as_listed(&service.version),
            extra: service.extra.iter().map(as_listed).collect(),
        })
        .collect()
}

/// Clears versions and further strings that the entry leaves out, so that they stay left out.
fn leave_open(services: &mut [ListedService], listed: &[ListedService]) {
    for place in 0..services.len() {
        let (earlier, later) = services.split_at_mut(place);
        let service = &mut later[0];
        let nth = earlier.iter().filter(|it| it.name == service.name).count();
        let Some(listed) = listed.iter().filter(|it| it.name == service.name).nth(nth) else {
            continue;
        };
        if listed.version.is_empty() {
            service.version.clear();
        }
        if listed.extra.is_empty() {
            service.extra.clear();
        }
    }
}

/// Services of an entry and of its device, where both are known and differ.
pub fn other_services<'a>(
    entry: &'a Entry,
    device: &'a Device,
) -> Option<(&'a [ListedService], &'a [DeviceService])> {
    let both = entry.listed_services().zip(device.services.as_deref());
    both.filter(|(_, own)| !same_services(entry, own))
}

impl OwnService for DeviceService {
    fn is_named_as(&self, listed: &ListedService) -> bool {
        as_listed(&self.name) == listed.name
    }

    fn has_version_of(&self, listed: &ListedService) -> bool {
        as_listed(&self.version) == listed.version
    }

    fn shown_name(&self) -> String {
        printable(as_listed(&self.name).as_bytes())
    }

    fn shown_version(&self) -> String {
        printable(as_listed(&self.version).as_bytes())
    }
}

/// Text of a device's string in des.json: the text itself where it is UTF-8, else escaped.
pub fn as_listed(name: &Name) -> String {
    match std::str::from_utf8(name.as_bytes()) {
        Ok(text) => text.to_owned(),
        Err(_) => name.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::file::FileEditors;
    use crate::discovery::Config;
    use crate::time::Instant;
    use std::path::PathBuf;

    fn bus_of_new_entry(names: &[&str], files: &[Option<&str>], bus: u8) -> Option<String> {
        let configured = names.iter().map(|name| ((*name).to_owned(), Config::default()));
        let buses = Buses::new(Instant::ZERO, configured.collect());
        let own = files.iter().map(|path| path.map(PathBuf::from)).collect();
        let files = FileEditors::new(Some("des.json".into()), own);
        entry_bus(&buses, files.documents(), Some(BusIndex(bus)))
    }

    #[test]
    fn entry_names_its_bus_where_others_have_the_same_file() {
        let both = ["can0", "can1"];
        assert_eq!(bus_of_new_entry(&both, &[], 1).as_deref(), Some("can1"));
        assert_eq!(bus_of_new_entry(&both[..1], &[], 0), None);
        assert_eq!(bus_of_new_entry(&both, &[None, Some("north.json")], 1), None);
        assert_eq!(bus_of_new_entry(&both, &[None, Some("north.json")], 0), None);
        let three = ["can0", "can1", "can2"];
        let files = [Some("north.json"), None, Some("north.json")];
        assert_eq!(bus_of_new_entry(&three, &files, 2).as_deref(), Some("can2"));
        assert_eq!(bus_of_new_entry(&three, &files, 1), None);
    }
}
