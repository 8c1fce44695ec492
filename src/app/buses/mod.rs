//! The buses: engine, bus status and load of each, redundant devices, the bit rate search.
//!
//! Inputs: frames, bus statuses, time. Outputs: frames to transmit, engine events, timeline
//! texts of status changes. Read by the other parts of the application to look up devices and
//! names. Does not know des.json, the timeline or the screen.

mod address_names;
mod bus;
mod controller_status;
mod device_types;
mod error_kinds;
mod load_history;
mod load_meter;
mod load_second;
mod load_shares;
mod redundancy;
mod status_changes;

pub use address_names::{AddressHolder, AddressNames};
pub use bus::{Bus, TxBlocked};
pub use controller_status::ControllerStatus;
pub use device_types::{BusTypes, FrameTypes};
pub use error_kinds::ErrorKinds;
pub use load_history::{LoadHistory, LoadSample};
pub use load_meter::LoadMeter;
pub use load_second::LoadSecond;
pub use load_shares::{LoadShares, ShareCounts};
pub use redundancy::{Redundancy, RedundantDevice};
pub(super) use status_changes::{StatusChange, controller_line};

use super::project_facts::ProjectFacts;
use crate::catalogue::Catalogue;
use crate::dbc::MessageDatabase;
use crate::discovery::{
    BusVerdict, Config, Device, DeviceId, DeviceRequest, Event, FrameSequence, OwnAddress,
    RequestId, SequenceEnd, SequenceId,
};
use crate::finding::{Finding, FindingKey, FindingKind, FindingState};
use crate::frame::{BusIndex, Frame};
use crate::status::{BusState, BusStatus};
use crate::time::{Duration, Instant};
use crate::wire::descriptor::DescriptorField;
use crate::wire::id::Address;
use crate::wire::node::Uid;
use crate::wire::profile::Profile;
use redundancy::RedundantDevices;
use std::sync::Arc;

/// Time after a stall in which frames that waited during it may still arrive.
const STALL_BACKLOG: Duration = Duration::from_millis(250);

/// All buses.
#[derive(Clone, Debug)]
pub struct Buses {
    list: Vec<Bus>,
    redundant: RedundantDevices,
    /// The bus whose bit rate is being searched.
    searched: Option<BusIndex>,
    /// What is known of types of devices.
    catalogue: Arc<Catalogue>,
    /// Messages of DBC files.
    messages: Arc<MessageDatabase>,
    /// What the project says about the buses.
    project: Arc<ProjectFacts>,
}

impl Buses {
    /// Returns buses that start at `now`.
    pub(super) fn new(now: Instant, buses: Vec<(String, Config)>) -> Self {
        let mut all = Self {
            list: Vec::new(),
            redundant: RedundantDevices::default(),
            searched: None,
            catalogue: Arc::default(),
            messages: Arc::default(),
            project: Arc::default(),
        };
        for (name, config) in buses {
            all.add(now, name, config);
        }
        all
    }

    /// Appends a bus that starts at `now`; returns false at 256 buses, the most there can be.
    pub(super) fn add(&mut self, now: Instant, name: String, config: Config) -> bool {
        let Ok(index) = u8::try_from(self.list.len()) else { return false };
        let bus = BusIndex(index);
        self.list.push(Bus::new(now, name, Config { bus, ..config }));
        true
    }

    // ---- reading ---------------------------------------------------------------------------

    /// All buses, in the order of their indices.
    pub fn as_slice(&self) -> &[Bus] {
        &self.list
    }

    /// Iterates over the buses in the order of their indices.
    #[expect(clippy::iter_without_into_iter, reason = "loops name what they go through")]
    pub fn iter(&self) -> std::slice::Iter<'_, Bus> {
        self.list.iter()
    }

    /// The buses, each with its index.
    pub fn indexed(&self) -> impl Iterator<Item = (BusIndex, &Bus)> + Clone {
        (0..=u8::MAX).map(BusIndex).zip(&self.list)
    }

    /// What the project says about the buses.
    pub fn project(&self) -> &Arc<ProjectFacts> {
        &self.project
    }

    /// Sets what the project says about the buses.
    pub(super) fn set_project(&mut self, project: Arc<ProjectFacts>) {
        self.project = project;
    }

    /// Approximate size in bytes, as of a copy.
    pub fn size(&self) -> usize {
        self.list.iter().map(Bus::size).sum()
    }

    /// Number of buses.
    #[expect(clippy::len_without_is_empty, reason = "there is no App without a bus")]
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// The bus with this index; `None` for an unknown index.
    pub fn get(&self, index: BusIndex) -> Option<&Bus> {
        self.list.get(usize::from(index.0))
    }

    /// The bus that a project names so, without bit rates.
    pub fn find_by_name(&self, name: &str) -> Option<(BusIndex, &Bus)> {
        let at = self.list.iter().position(|bus| bus.name_without_rates() == name)?;
        Some((BusIndex(at as u8), &self.list[at]))
    }

    /// Returns what tells a bus from an earlier one of the same name, as two logs of `can0` have: `#2`, its
    /// number; `None` for any other bus.
    pub fn number_of_equal(&self, index: BusIndex) -> Option<String> {
        let (bus, before) = self.list.get(..=usize::from(index.0))?.split_last()?;
        let is_equal = before.iter().any(|other| other.name == bus.name);
        is_equal.then(|| format!("#{}", usize::from(index.0) + 1))
    }

    /// The name of a bus, printable, followed by its number if an earlier one has the same: `can0 #2`.
    pub fn unique_name(&self, index: BusIndex) -> String {
        let name = self.get(index).map_or("", |bus| &bus.name);
        let name = crate::text::printable(name.as_bytes());
        self.number_of_equal(index).map_or(name.clone(), |number| format!("{name} {number}"))
    }

    /// Counter that changes when a finding of a bus is opened or has another state.
    pub fn findings_revision(&self) -> u64 {
        self.list.iter().map(|bus| 1 + bus.findings_revision()).sum()
    }

    /// Counter that changes with every name of an address.
    pub fn names_revision(&self) -> u64 {
        self.list.iter().map(|bus| bus.names().revision()).sum()
    }

    /// The device with this identity; `None` after its removal.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.get(id.bus)?.device(id)
    }

    /// Devices of all buses.
    pub fn devices(&self) -> impl Iterator<Item = &Device> {
        self.list.iter().flat_map(Bus::devices)
    }

    /// Profile of a bus; the default one for an unknown index.
    pub fn profile(&self, bus: BusIndex) -> Arc<Profile> {
        self.get(bus).map_or_else(Default::default, |bus| bus.config().profile.clone())
    }

    /// Returns true if a bus speaks another protocol than DES.
    pub fn is_foreign(&self, bus: BusIndex) -> bool {
        self.get(bus).is_some_and(Bus::is_foreign)
    }

    /// Returns true if a bus is known to speak DES.
    pub fn speaks_des(&self, bus: BusIndex) -> bool {
        self.get(bus).is_some_and(|bus| bus.traffic().verdict() == BusVerdict::Des)
    }

    /// Name of the device that had an address at a moment; `own` for descan's own address, else the
    /// number.
    pub fn name_at(&self, bus: BusIndex, address: Address, time: Instant) -> String {
        let named = self.get(bus).and_then(|bus| bus.names().at(address, time));
        match named {
            Some(name) => name.to_string(),
            None => self.unnamed(bus, address),
        }
    }

    /// Text for an address without a known name: `own` for descan's, else the number.
    pub(super) fn unnamed(&self, bus: BusIndex, address: Address) -> String {
        if self.is_own_address(bus, address) { "own".to_owned() } else { address.to_string() }
    }

    /// Returns true if descan holds this address on this bus.
    pub fn is_own_address(&self, bus: BusIndex, address: Address) -> bool {
        self.get(bus).map(Bus::own_address) == Some(OwnAddress::Held(address))
    }

    /// Findings of all engines, bus by bus.
    pub fn findings(&self) -> impl Iterator<Item = &Finding> {
        self.list.iter().flat_map(Bus::findings)
    }

    /// The finding with this key on a bus.
    pub fn finding(&self, bus: BusIndex, key: &FindingKey) -> Option<&Finding> {
        self.get(bus)?.findings().iter().find(|finding| finding.key == *key)
    }

    /// Returns true if an address conflict is confirmed at the device's address: its heartbeat
    /// statistics are those of two devices then.
    pub fn has_confirmed_conflict(&self, device: &Device) -> bool {
        self.is_confirmed(device, FindingKind::SameNameSameAddress)
            || self.is_confirmed(device, FindingKind::OneAddressTwoNames)
            || self.is_confirmed(device, FindingKind::OneAddressTwoIdentities)
    }

    /// UIDs in the heartbeats of a device; two where alternating UIDs are confirmed.
    pub fn uids_of(&self, device: &Device) -> Vec<Uid> {
        let two = self.is_confirmed(device, FindingKind::OneAddressTwoIdentities);
        let other = device.uid_before().filter(|_| two);
        device.uid.into_iter().chain(other).collect()
    }

    fn is_confirmed(&self, device: &Device, kind: FindingKind) -> bool {
        self.get(device.id.bus).is_some_and(|bus| {
            bus.findings().iter().any(|finding| {
                finding.key.kind == kind
                    && finding.key.address == Some(device.address)
                    && finding.state == FindingState::Confirmed
            })
        })
    }

    /// The same device on other buses.
    pub fn redundant_devices(&self, id: DeviceId) -> &[RedundantDevice] {
        self.redundant.of(id)
    }

    /// The same device on redundant buses.
    pub fn redundant(&self, id: DeviceId) -> impl Iterator<Item = DeviceId> {
        self.redundant.redundant(id)
    }

    /// Names of the redundant buses on which the same device is present.
    pub fn still_on(&self, id: DeviceId) -> Vec<String> {
        let others = self.redundant(id).filter(|other| other.bus != id.bus);
        let here = others.filter(|other| self.device(*other).is_some_and(Device::is_present));
        here.filter_map(|other| Some(self.get(other.bus)?.name.clone())).collect()
    }

    /// Returns true if a bus was searched long enough to report a device as missing: the
    /// enumeration settled or ran twice, the bus was up for 5 s, or the log ended. A log without a frame shows
    /// nothing.
    pub fn is_search_complete(&self, bus: BusIndex, now: Instant) -> bool {
        let Some(bus) = self.get(bus) else { return false };
        if bus.ended.is_some() {
            return bus.traffic().frames > 0;
        }
        let progress = bus.progress();
        progress.is_complete || progress.rounds >= 2 || bus.has_listened(now)
    }

    /// Returns true if the engine of a bus sends requests.
    pub fn sends_requests(&self, bus: BusIndex) -> bool {
        self.get(bus).is_some_and(|bus| {
            let config = bus.config();
            config.send_requests && !config.listen_only
        })
    }

    /// The reason why descan has no address on a bus: the `wanted` one is used by another node, or
    /// with `None` all are used. Returns `None` for an unknown bus.
    pub fn no_address_reason(&self, bus: BusIndex, wanted: Option<Address>) -> Option<String> {
        let Some(wanted) = wanted else {
            return Some("no free address: requests paused until one is free".to_owned());
        };
        let user = self.get(bus)?.device_at(wanted);
        let user = user.and_then(|device| device.name.as_ref());
        let user = user.map_or_else(|| "another node".to_owned(), ToString::to_string);
        Some(format!("{user} uses address {wanted}: requests paused until it is free"))
    }

    /// The moment up to which ages are counted: `now`, or the end of the last log where all buses
    /// are logs that ended.
    pub fn display_time(&self, now: Instant) -> Instant {
        let ended = self.list.iter().map(|bus| bus.ended).collect::<Option<Vec<_>>>();
        ended.and_then(|ended| ended.into_iter().max()).unwrap_or(now)
    }

    /// The bus whose bit rate is being searched.
    pub fn searched(&self) -> Option<BusIndex> {
        self.searched
    }

    /// The moment at which `handle_timeout` is due; `None` with no timer running.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.list.iter().filter_map(Bus::poll_timeout).min()
    }

    /// Returns true if an engine has an event.
    pub fn has_events(&self) -> bool {
        self.list.iter().any(Bus::has_events)
    }

    /// Returns true if no bus has a device or recent traffic.
    pub fn is_quiet(&self) -> bool {
        let quiet =
            |bus: &Bus| bus.ended.is_some() || bus.meter.is_idle() && bus.devices().is_empty();
        self.list.iter().all(quiet)
    }

    // ---- changing --------------------------------------------------------------------------

    fn get_mut(&mut self, index: BusIndex) -> Option<&mut Bus> {
        self.list.get_mut(usize::from(index.0))
    }

    fn all_mut(&mut self) -> std::slice::IterMut<'_, Bus> {
        self.list.iter_mut()
    }

    /// Renames a bus; returns false for an unknown index.
    pub(super) fn rename(&mut self, index: BusIndex, name: String) -> bool {
        let Some(bus) = self.get_mut(index) else { return false };
        bus.name = name;
        true
    }

    /// Passes a frame to the engine and the load meter of its bus; returns false for an unknown
    /// bus.
    pub(super) fn receive(&mut self, frame: &Frame) -> bool {
        let Some(bus) = self.get_mut(frame.bus) else { return false };
        bus.receive(frame);
        true
    }

    /// State of the controller of a bus before the last frame, if that reported another one.
    pub(super) fn poll_state_change(&mut self, index: BusIndex) -> Option<BusState> {
        self.get_mut(index)?.poll_state_change()
    }

    /// Runs the timers that are due at `now`.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        let is_due = |bus: &Bus| bus.poll_timeout().is_some_and(|at| at <= now);
        if self.list.iter().any(is_due) {
            self.all_mut().filter(|bus| is_due(bus)).for_each(|bus| bus.handle_timeout(now));
        }
    }

    /// Quarantines the buses after a stall from `since` to `now`: frames of that time are shown
    /// and do not count as evidence, and silence does not count against devices.
    pub(super) fn handle_stall(&mut self, since: Instant, now: Instant) {
        for bus in self.all_mut().filter(|bus| !bus.is_unreachable() && bus.ended.is_none()) {
            bus.quarantine(since, now + STALL_BACKLOG);
        }
    }

    /// Updates the bus status of a bus. Returns what changed (without lines during a bit rate search, which
    /// takes the bus down and up), or `None` if nothing did.
    pub(super) fn update_status(
        &mut self,
        now: Instant,
        index: BusIndex,
        status: BusStatus,
    ) -> Option<StatusChange> {
        let is_searched = self.searched == Some(index);
        let change = self.get_mut(index)?.update_status(now, status)?;
        let lines = if is_searched { Vec::new() } else { change.lines };
        Some(StatusChange { lines, ..change })
    }

    /// The next engine event of a bus.
    pub(super) fn poll_event(&mut self, index: BusIndex) -> Option<Event> {
        self.list.get_mut(usize::from(index.0))?.poll_event()
    }

    /// The next frame to transmit; `frame.bus` is the bus to transmit on.
    pub(super) fn poll_transmit(&mut self, now: Instant) -> Option<Frame> {
        self.list.iter_mut().enumerate().find_map(|(index, bus)| {
            bus.poll_transmit(now).map(|frame| frame.with_bus(BusIndex(index as u8)))
        })
    }

    /// Restarts the enumeration on all buses.
    pub(super) fn rescan(&mut self, now: Instant) {
        self.all_mut().for_each(|bus| bus.rescan(now));
    }

    /// Sends frames as they are; returns `None` if others are being sent, or for an unknown bus.
    pub(super) fn send_frames(
        &mut self,
        now: Instant,
        index: BusIndex,
        sequence: FrameSequence,
    ) -> Option<SequenceId> {
        self.get_mut(index)?.send_frames(now, sequence)
    }

    /// Sends no further frame of the sequence of a bus.
    pub(super) fn stop_frames(&mut self, now: Instant, index: BusIndex) {
        if let Some(bus) = self.get_mut(index) {
            bus.stop_frames(now, SequenceEnd::Stopped);
        }
    }

    /// Sends no more requests and flow control by itself on a bus.
    pub(super) fn yield_requests(&mut self, now: Instant, index: BusIndex) {
        if let Some(bus) = self.get_mut(index) {
            bus.yield_requests(now);
        }
    }

    /// Sends a frame as it stands.
    pub(super) fn send(&mut self, now: Instant, frame: Frame) {
        if let Some(bus) = self.list.get_mut(usize::from(frame.bus.0)) {
            bus.send(now, frame);
        }
    }

    /// Sends a request to a device, once; returns `None` if it cannot be sent.
    pub(super) fn request(&mut self, now: Instant, request: DeviceRequest) -> Option<RequestId> {
        self.list.get_mut(usize::from(request.device.bus.0))?.request(now, request)
    }

    /// Reads a field of the descriptor of a device, or all; returns the number of fields.
    pub(super) fn read_descriptor(
        &mut self,
        now: Instant,
        device: DeviceId,
        field: Option<DescriptorField>,
    ) -> usize {
        let bus = self.list.get_mut(usize::from(device.bus.0));
        bus.map_or(0, |bus| bus.read_descriptor(now, device, field))
    }

    /// Removes the lost devices of all buses.
    pub(super) fn remove_lost_devices(&mut self) {
        self.all_mut().for_each(Bus::remove_lost_devices);
    }

    /// Reads frames by another profile from now on; returns the buses whose devices start over.
    pub(super) fn set_profile(&mut self, now: Instant, profile: &Arc<Profile>) -> Vec<BusIndex> {
        let buses = self.list.iter_mut().zip(0..);
        let over = buses
            .filter_map(|(bus, index)| bus.set_profile(now, profile).then_some(BusIndex(index)));
        over.collect()
    }

    /// Closes the load seconds that are over; a log that ended keeps its last ones.
    pub(super) fn tick(&mut self, now: Instant) {
        for bus in self.list.iter_mut().filter(|bus| bus.ended.is_none()) {
            let is_known = bus.is_up();
            bus.meter.advance(now, is_known);
        }
    }

    /// Starts or ends a bit rate search.
    pub(super) fn set_searched(&mut self, bus: Option<BusIndex>) {
        self.searched = bus;
    }

    /// Updates which devices are on several buses; returns the pairs whose redundancy
    /// changed, in the order of their buses.
    pub(super) fn refresh_redundancy(&mut self) -> Vec<(DeviceId, DeviceId, Redundancy)> {
        self.redundant.refresh(&self.list)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::Link;

    fn two_buses() -> Buses {
        let config = Config::default;
        Buses::new(Instant::ZERO, vec![("can0".into(), config()), ("can1".into(), config())])
    }

    #[test]
    fn frame_of_an_unknown_bus_is_refused() {
        let mut buses = two_buses();
        assert!(buses.receive(&Frame::classic(1, &[])));
        assert!(!buses.receive(&Frame::classic(1, &[]).with_bus(BusIndex(2))));
    }

    #[test]
    fn status_changes_during_bit_rate_search_are_not_reported() {
        let mut buses = two_buses();
        let up = || BusStatus { link: Link::Up, ..BusStatus::default() };
        buses.set_searched(Some(BusIndex(1)));
        let mut update = |at| buses.update_status(Instant::ZERO, BusIndex(at), up());
        assert_eq!(update(0).map(|change| change.lines.len()), Some(1));
        assert_eq!(update(1).map(|change| change.lines), Some(Vec::new()));
        assert!(update(1).is_none(), "nothing changed");
    }
}
