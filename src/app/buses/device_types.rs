//! The types of the devices on the buses, and the words of the catalogue for their frames.
//!
//! The messages of DBC files are for frames that are not of DES: of a bus that speaks another protocol, with
//! 11-bit identifiers, and those of a mixed bus that neither have a service of DES nor an end with a device
//! that has a name or sends heartbeats.
//! Who had an address is looked up as of the frame; its type is what is known of the device now.

use super::{Bus, Buses};
use crate::catalogue::{Catalogue, DeviceType, TypeBasis, TypeService};
use crate::dbc::{MessageDatabase, NamedMessage};
use crate::discovery::Device;
use crate::frame::{BusIndex, Frame};
use crate::text::Name;
use crate::time::Instant;
use crate::wire::data_layout::DataFieldValue;
use crate::wire::descriptor::{DescriptorField, DescriptorValue, Gid};
use crate::wire::id::{Address, Header, MessageType, Service};
use crate::wire::profile::Profile;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// What the catalogue says about a frame: of its device, and of all devices. Of a frame that is not of DES,
/// what a DBC file says.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameTypes<'a> {
    device: Option<&'a DeviceType>,
    common: &'a [Arc<DeviceType>],
    message: Option<&'a NamedMessage>,
}

impl<'a> FrameTypes<'a> {
    fn all(self) -> impl Iterator<Item = &'a DeviceType> {
        self.device.into_iter().chain(self.common.iter().map(|it| &**it))
    }

    /// The message of a DBC file; `None` for a frame of DES.
    pub fn message(self) -> Option<&'a NamedMessage> {
        self.message
    }

    /// Returns the service with a number.
    pub fn service(self, number: Service) -> Option<&'a TypeService> {
        self.all().find_map(|it| it.service(number))
    }

    /// Returns the data of a frame in words, escaped; `None` if no file has fields for them.
    pub fn data_in_words(self, header: Header, data: &[u8]) -> Option<String> {
        self.all().find_map(|it| it.data_in_words(header, data))
    }

    /// Returns the fields of the data of a frame.
    pub fn data_values<'b>(self, header: Header, data: &'b [u8]) -> Vec<DataFieldValue<'b>>
    where
        'a: 'b,
    {
        if header.message_type() == MessageType::Debug {
            return self.debug_values(header.service.number(), data);
        }
        let values = self.all().map(|it| it.data_values(header, data));
        values.into_iter().find(|values| !values.is_empty()).unwrap_or_default()
    }

    /// Returns the parameters of a DEBUG message.
    pub fn debug_values<'b>(self, code: u16, data: &'b [u8]) -> Vec<DataFieldValue<'b>>
    where
        'a: 'b,
    {
        let known = self.all().find(|it| it.debug_messages.contains_key(&code));
        known.map_or_else(Vec::new, |it| it.parameter_values(code, data))
    }

    /// Returns the name of a DEBUG message, escaped: from the profile, else from the catalogue.
    pub fn debug_name(self, profile: &Profile, code: Service) -> Option<String> {
        let named = profile.debug_names.get(&code.number());
        let named = named.map(|name| crate::text::printable(name.as_bytes()));
        let known = || self.all().find_map(|it| it.debug_messages.get(&code.number()));
        named.or_else(|| Some(known()?.name.clone()))
    }

    /// Returns a DEBUG message in words, escaped: its name, else its code, and its parameters.
    pub fn debug_text(self, profile: &Profile, code: Service, data: &[u8]) -> String {
        let name = self.debug_name(profile, code).unwrap_or_else(|| code.to_string());
        let parameters = self.all().map(|it| it.parameters_in_words(code.number(), data));
        match parameters.into_iter().find(|text| !text.is_empty()) {
            Some(parameters) => format!("{name}: {parameters}"),
            None => name,
        }
    }
}

/// Returns the address of the device whose type describes a frame: who serves, or sends.
fn described_end(header: Header) -> Option<Address> {
    match (header.response, header.broadcast) {
        (true, _) => Some(header.source),
        (false, false) => Some(header.destination),
        (false, true) => None,
    }
}

/// The types of the devices at the addresses of a bus, for many frames.
#[derive(Clone, Debug, Default)]
pub struct BusTypes {
    common: Vec<Arc<DeviceType>>,
    /// By address, each with the time from which on it is there; empty if no type is known.
    held: Vec<Vec<(Instant, Option<Arc<DeviceType>>)>>,
    messages: Arc<MessageDatabase>,
    /// Services of DES itself.
    services: Vec<Service>,
    /// Addresses of devices that take part in DES, a bit each.
    taken: u128,
}

impl BusTypes {
    /// Collects the types of a bus.
    pub fn of(buses: &Buses, index: BusIndex) -> Self {
        let Some(bus) = buses.get(index) else { return Self::default() };
        let messages = Self::of_messages(buses, bus);
        let catalogue = &buses.catalogue;
        if catalogue.is_empty() {
            return messages;
        }
        let of_address = |address: Address| {
            let holders = bus.names().holders(address).iter();
            holders
                .map(|it| (it.since, bus.type_at(catalogue, address, it.since).cloned()))
                .collect()
        };
        Self {
            common: catalogue.common_types().to_vec(),
            held: Address::all().map(of_address).collect(),
            ..messages
        }
    }

    fn of_messages(buses: &Buses, bus: &Bus) -> Self {
        if buses.messages.is_empty() {
            return Self::default();
        }
        let taken = Address::all().filter(|address| bus.has_device_of_des(*address));
        Self {
            messages: Arc::clone(&buses.messages),
            services: services_of_des(&bus.config().profile).to_vec(),
            taken: taken.fold(0, |all, address| all | 1 << address.index()),
            ..Self::default()
        }
    }

    /// Returns what is known about a frame; `header` is `None` for one of another protocol.
    pub fn of_frame(&self, header: Option<Header>, frame: &Frame) -> FrameTypes<'_> {
        let is_taken = |address: Address| self.taken >> address.index() & 1 == 1;
        let message = self.messages.message(frame);
        let is_of_des = || header.is_some_and(|header| is_of_des(header, &self.services, is_taken));
        let message = message.filter(|_| !is_of_des());
        let end = header.and_then(described_end);
        let at = end.and_then(|address| self.held.get(address.index()));
        let held = at.and_then(|held| {
            let later = held.partition_point(|(since, _)| *since <= frame.time);
            held.get(later.saturating_sub(1))?.1.as_deref()
        });
        FrameTypes { device: held, common: &self.common, message }
    }
}

fn services_of_des(profile: &Profile) -> [Service; 2] {
    [profile.des_service(), profile.heartbeat_service()]
}

/// Returns true for a frame of DES, or of a device that takes part in it: `is_taken` says which addresses
/// have such a device.
fn is_of_des(header: Header, services: &[Service], is_taken: impl Fn(Address) -> bool) -> bool {
    let is_of_device =
        || is_taken(header.source) || !header.broadcast && is_taken(header.destination);
    header.is_conforming() && (services.contains(&header.service) || is_of_device())
}

impl Bus {
    /// Returns true if a device that takes part in DES had an address: it has a name or sends heartbeats.
    fn has_device_of_des(&self, address: Address) -> bool {
        self.names().holders(address).iter().any(|holder| {
            let device = || holder.device().and_then(|id| self.device(id));
            holder.name.is_some() || device().is_some_and(|device| device.heartbeat.count > 0)
        })
    }

    /// Returns the type of the device that had an address at a moment.
    fn type_at<'a>(
        &self,
        catalogue: &'a Catalogue,
        address: Address,
        time: Instant,
    ) -> Option<&'a Arc<DeviceType>> {
        let holder = self.names().holder_at(address, time)?;
        let device = holder.device().and_then(|id| self.device(id));
        // Of the board before nothing but the name is known.
        let is_it = |device: &&Device| device.replaced_at.is_none_or(|at| at <= time);
        let gid = device.filter(is_it).and_then(gid_of);
        let name = holder.name.as_ref().map(Name::as_bytes);
        catalogue.type_of(gid, name).map(|(found, _)| found)
    }
}

/// Returns the GID of a device, if it was read.
fn gid_of(device: &Device) -> Option<Gid> {
    match device.descriptor.value(DescriptorField::Gid) {
        Some(DescriptorValue::Gid(gid)) => Some(gid),
        _ => None,
    }
}

impl Buses {
    /// What is known of types of devices.
    pub fn catalogue(&self) -> &Arc<Catalogue> {
        &self.catalogue
    }

    /// Sets what is known of types of devices.
    pub(in crate::app) fn set_catalogue(&mut self, catalogue: Arc<Catalogue>) {
        self.catalogue = catalogue;
    }

    /// Returns a number that changes with what is known of devices for their frames, other than their names.
    pub fn types_revision(&self) -> u64 {
        let revision = if self.messages.is_empty() {
            self.catalogue.revision()
        } else {
            let with_heartbeat = self.devices().filter(|device| device.heartbeat.count > 0);
            self.catalogue.revision().wrapping_add((with_heartbeat.count() as u64) << 32)
        };
        if self.catalogue.is_empty() {
            return revision;
        }
        let gids = self.devices().filter_map(gid_of);
        let bits = gids
            .map(|Gid(bytes)| bytes.iter().fold(1, |bits: u64, byte| bits << 8 | u64::from(*byte)));
        let add = |sum: u64, bits: u64| sum.wrapping_mul(0x0100_0000_01B3).wrapping_add(bits);
        bits.fold(revision, add)
    }

    /// Returns the type of a device, and how it is known.
    pub fn type_of(&self, device: &Device) -> Option<(&Arc<DeviceType>, TypeBasis)> {
        let name = device.name.as_ref().map(Name::as_bytes);
        self.catalogue.type_of(gid_of(device), name)
    }

    /// Messages of DBC files.
    pub fn messages(&self) -> &Arc<MessageDatabase> {
        &self.messages
    }

    /// Sets the messages of DBC files.
    pub(in crate::app) fn set_messages(&mut self, messages: Arc<MessageDatabase>) {
        self.messages = messages;
    }

    /// Returns true if a DBC file has the message of a frame that is not of DES.
    pub fn has_message(&self, frame: &Frame) -> bool {
        let id = frame.platform_id().filter(|_| !self.is_foreign(frame.bus));
        self.frame_types(id.map(Header::decode), frame).message().is_some()
    }

    /// Returns true if no bit of the identifier of a frame is random: it is not of DES. Otherwise RND7 of a
    /// broadcast is.
    pub fn has_fixed_id(&self, frame: &Frame) -> bool {
        self.is_foreign(frame.bus) || self.has_message(frame)
    }

    /// Returns what is known about a frame; `header` is `None` for one of another protocol.
    pub fn frame_types(&self, header: Option<Header>, frame: &Frame) -> FrameTypes<'_> {
        let message = self.messages.message(frame).filter(|_| {
            let bus = header.and_then(|header| Some((header, self.get(frame.bus)?)));
            !bus.is_some_and(|(header, bus)| {
                let services = services_of_des(&bus.config().profile);
                is_of_des(header, &services, |address| bus.has_device_of_des(address))
            })
        });
        let types =
            header.map(|header| self.types_at(frame.bus, described_end(header), frame.time));
        FrameTypes { message, ..types.unwrap_or_default() }
    }

    /// Returns what the catalogue says about the device that had an address at a moment, and about all.
    pub fn types_at(
        &self,
        index: BusIndex,
        address: Option<Address>,
        time: Instant,
    ) -> FrameTypes<'_> {
        if self.catalogue.is_empty() {
            return FrameTypes::default();
        }
        let at = |address| self.get(index)?.type_at(&self.catalogue, address, time);
        let device = address.and_then(at).map(|it| &**it);
        FrameTypes { device, common: self.catalogue.common_types(), message: None }
    }

    /// Returns the name of a service on a bus: from the profile, else from the type of the device that
    /// has it, or from what all devices share; without a device from all types on the bus, if they
    /// agree. `server`: the device, and the moment.
    pub fn service_name(
        &self,
        index: BusIndex,
        service: Service,
        server: Option<(Address, Instant)>,
    ) -> Option<String> {
        let bus = self.get(index)?;
        if let Some(name) = bus.config().profile.service_name(service) {
            return Some(name.to_owned());
        }
        if self.catalogue.is_empty() {
            return None;
        }
        let at = |(address, time)| bus.type_at(&self.catalogue, address, time);
        let own = server.and_then(at).and_then(|it| it.service(service));
        let common = || self.catalogue.common_types().iter().find_map(|it| it.service(service));
        if let Some(known) = own.or_else(common) {
            return Some(known.name.clone());
        }
        if server.is_some() {
            return None;
        }
        let mut names = self.types_on(bus).filter_map(|it| it.service(service)).map(|it| &it.name);
        let first = names.next()?;
        names.all(|name| name == first).then(|| first.clone())
    }

    /// Names of services by number, of all types on a bus, where the profile has none.
    pub fn service_names_of_types(&self, index: BusIndex) -> BTreeMap<u16, BTreeSet<String>> {
        let mut names = BTreeMap::<u16, BTreeSet<String>>::new();
        let Some(bus) = self.get(index) else { return names };
        let profile = &bus.config().profile;
        let types = self.types_on(bus).chain(self.catalogue.common_types());
        for service in types.flat_map(|it| &it.services) {
            if let Some(number) = service.number
                && profile.service_name(number).is_none()
            {
                names.entry(number.number()).or_default().insert(service.name.clone());
            }
        }
        names
    }

    fn types_on<'a>(&'a self, bus: &'a Bus) -> impl Iterator<Item = &'a Arc<DeviceType>> {
        let devices = if self.catalogue.is_empty() { &[] } else { bus.devices() };
        devices.iter().filter_map(|device| self.type_of(device)).map(|(found, _)| found)
    }
}
