//! Buses, devices, problems and rows at the moment that is shown: now, or a past one.
//!
//! Inputs: the state of the present, and that of a past moment while it is shown. Does not know how they
//! are drawn.

use super::buses::{Buses, RedundantDevice};
use super::notices::TimelineEntry;
use super::problems::{Problem, ProblemList, Problems};
use super::view::{Counts, Page, ProblemsView, Row};
use super::{App, Bus, shown_inputs};
use crate::app::file::FileIndex;
use crate::catalogue::Catalogue;
use crate::discovery::{Device, DeviceId};
use crate::document::Entry;
use crate::finding::Finding;
use crate::frame::BusIndex;
use crate::text::{Escaped, Name};
use crate::time::Instant;
use crate::wire::id::{Address, Service};
use crate::wire::node::Uid;
use crate::wire::profile::Profile;
use std::sync::Arc;

impl App {
    /// The buses at the moment that is shown.
    pub(crate) fn shown_buses(&self) -> &Buses {
        self.past.as_ref().map_or(&self.buses, |past| &past.buses)
    }

    /// What is known of types of devices.
    pub fn catalogue(&self) -> &Arc<Catalogue> {
        self.buses.catalogue()
    }

    /// The problems at the moment that is shown.
    pub(super) fn shown_problems(&self) -> &Problems {
        self.past.as_ref().map_or(&self.problems, |past| &past.problems)
    }

    /// The moment that is shown.
    pub(crate) fn shown_time(&self) -> Instant {
        self.past.as_ref().map_or(self.clock.now(), |past| past.moment.time)
    }

    /// The moment up to which ages are counted: now, or the end of the last log.
    pub fn display_time(&self) -> Instant {
        self.shown_buses().display_time(self.shown_time())
    }

    /// The buses, in the order of their indices.
    pub fn buses(&self) -> &[Bus] {
        self.shown_buses().as_slice()
    }

    /// The bus with this index; `None` for an unknown index.
    pub fn bus(&self, index: BusIndex) -> Option<&Bus> {
        self.shown_buses().get(index)
    }

    /// The device with this identity; `None` after its removal.
    pub fn device(&self, id: DeviceId) -> Option<&Device> {
        self.shown_buses().device(id)
    }

    /// Median of the errors of the heartbeat periods of the other devices on its bus, in ppm; `None` of
    /// fewer than two.
    pub fn usual_period_error(&self, id: DeviceId) -> Option<f64> {
        let bus = self.shown_buses().get(id.bus)?;
        let others = bus.devices().iter().filter(|device| device.id != id);
        let mut errors: Vec<f64> =
            others.filter_map(|it| it.heartbeat.period_error()).map(|error| error.ppm).collect();
        errors.sort_unstable_by(f64::total_cmp);
        if errors.len() < 2 { None } else { errors.get((errors.len() - 1) / 2).copied() }
    }

    /// The device of a row, as far as it is known of the board of a shared address alone; `None` for the
    /// row of an entry.
    pub fn device_of<'a>(&'a self, row: &'a Row) -> Option<&'a Device> {
        row.board_device.as_deref().or_else(|| row.device(self.shown_buses()))
    }

    /// The devices of a row: several where buses are redundant.
    pub fn devices_of<'a>(&'a self, row: &'a Row) -> impl Iterator<Item = &'a Device> {
        row.devices(self.shown_buses())
    }

    /// The same device on other buses.
    pub fn redundant_devices(&self, id: DeviceId) -> &[RedundantDevice] {
        self.shown_buses().redundant_devices(id)
    }

    /// Returns true if an address conflict is confirmed at the address of a device: its heartbeat
    /// statistics are those of two devices then.
    pub fn has_confirmed_conflict(&self, device: &Device) -> bool {
        self.shown_buses().has_confirmed_conflict(device)
    }

    /// UIDs in the heartbeats of a device; two where alternating UIDs are confirmed.
    pub fn uids_of(&self, device: &Device) -> Vec<Uid> {
        self.shown_buses().uids_of(device)
    }

    /// Profile of a bus; the default one for an unknown index.
    pub fn profile(&self, bus: BusIndex) -> Arc<Profile> {
        self.shown_buses().profile(bus)
    }

    /// Returns true if descan holds this address on this bus.
    pub fn is_own_address(&self, bus: BusIndex, address: Address) -> bool {
        self.shown_buses().is_own_address(bus, address)
    }

    /// The reason why descan has no address on a bus: the `wanted` one is used by another node, or
    /// with `None` all are used.
    pub fn no_address_reasons(&self, bus: BusIndex, wanted: Option<Address>) -> Option<String> {
        self.shown_buses().no_address_reason(bus, wanted)
    }

    /// Returns true if a bus was searched long enough to report a device as missing.
    pub fn is_search_complete(&self, bus: BusIndex) -> bool {
        self.shown_buses().is_search_complete(bus, self.shown_time())
    }

    /// Why the buses that speak another protocol are taken for such; `None` without any. Of several buses
    /// they are named.
    pub fn foreign_reason(&self) -> Option<String> {
        let buses = self.buses();
        let reasons = buses.iter().filter_map(|bus| {
            let reason = bus.traffic().foreign_reason()?;
            let name = crate::text::printable(bus.name.as_bytes());
            Some(if buses.len() > 1 { format!("{name}: {reason}") } else { reason })
        });
        let reasons: Vec<String> = reasons.collect();
        (!reasons.is_empty()).then(|| reasons.join("; "))
    }

    /// Reasons why no device matches an entry of a des.json, the likeliest first.
    pub fn missing_reasons(&self, file: FileIndex, entry: &Entry) -> Vec<String> {
        let file = shown_inputs!(self).file(file);
        file.map(|file| file.missing_reasons(entry)).unwrap_or_default()
    }

    /// Name of the des.json of a bus; without a bus that of the first file.
    pub fn name_of_file(&self, bus: Option<BusIndex>) -> String {
        self.file_at(bus.map(|bus| self.file_of_bus(bus)).unwrap_or_default()).name()
    }

    /// Reasons why the name or the services of a device are not known.
    pub fn incomplete_reasons(&self, device: &Device) -> Vec<String> {
        shown_inputs!(self).incomplete_reasons(device)
    }

    /// All problems: confirmed, suspected, cleared, muted; by severity within each.
    pub fn problems(&self) -> ProblemList<'_> {
        self.shown_problems().list(self.shown_buses())
    }

    /// The problems with a finding that `is_wanted` selects.
    pub fn problems_with(&self, is_wanted: impl Fn(&Finding) -> bool) -> Vec<Problem<'_>> {
        self.shown_problems().list_with(self.shown_buses(), is_wanted)
    }

    /// Returns true if `is_wanted` selects a finding.
    pub fn has_finding(&self, is_wanted: impl Fn(&Finding) -> bool) -> bool {
        self.shown_problems().findings(self.shown_buses()).any(is_wanted)
    }

    /// The problems of the view that match the filter.
    pub fn problems_shown(&self) -> ProblemList<'_> {
        let mut problems = self.problems();
        let view = self.view.problems_view;
        if view != ProblemsView::All {
            problems.retain(|problem| view.lists(problem));
        }
        if let Some(filter) = self.filters.of(Page::Problems).active() {
            problems.retain(|problem| filter.matches_problem(self.shown_buses(), problem));
        }
        problems
    }

    /// The selected problem.
    pub fn selected_problem(&self) -> Option<Problem<'_>> {
        let shown = self.problems_shown();
        shown.get(self.view.problems.index(shown.keys())?)
    }

    /// The rows of the Devices page, sorted and filtered.
    pub fn rows(&self) -> &[Row] {
        self.devices.rows()
    }

    /// Number of rows by state, whatever the filter, and of problems.
    pub fn counts(&self) -> Counts {
        let is_file_broken = self.files.states().any(|(_, file)| file.problem().is_some());
        Counts { is_file_broken, ..self.devices.counts() }
    }

    /// The selected row.
    pub fn selected_row(&self) -> Option<&Row> {
        self.rows().get(self.selected_row_index()?)
    }

    /// Place of the selected row.
    pub fn selected_row_index(&self) -> Option<usize> {
        self.devices.selected_index(&self.view)
    }

    /// The device of the selected row.
    pub fn selected_device(&self) -> Option<&Device> {
        self.device_of(self.selected_row()?)
    }

    /// Name of the device that had an address at a moment, else the address.
    pub fn name_at(&self, bus: BusIndex, address: Address, time: Instant) -> String {
        self.shown_buses().name_at(bus, address, time)
    }

    /// Name of a service in the profile of a bus or in the catalogue, else its number. `server`: the
    /// device that has it.
    pub fn service_name(&self, bus: BusIndex, service: Service, server: Option<Address>) -> String {
        let server = server.map(|address| (address, self.shown_time()));
        let name = self.shown_buses().service_name(bus, service, server);
        let name = name.map(|name| Escaped(name.as_bytes()).to_string());
        name.unwrap_or_else(|| service.to_string())
    }

    /// Name of the device that a line is about.
    pub fn name_on_line<'a>(&'a self, entry: &'a TimelineEntry) -> Option<&'a Name> {
        entry.device_name(self.shown_buses())
    }
}
