//! Descriptors of the devices, as read by descan or by another node.
//!
//! A field is read by an empty request to its service. Fields whose service number is assumed are
//! not read from the frames of other nodes: they might belong to another service.

use super::Engine;
use super::device_requests::{DeviceRequest, RequestOutcome};
use super::device_tracker::DeviceTracker;
use super::event::EventKind;
use super::{DeviceId, is_open};
use crate::frame::Frame;
use crate::text::hex;
use crate::time::Instant;
use crate::wire::descriptor::{DescriptorFault, DescriptorField, DescriptorValue};
use crate::wire::id::{Address, Header, Service};
use crate::wire::profile::{Profile, UidProfile, ValueOrigin};
use std::collections::VecDeque;

/// Maximum number of reads and writes that wait for a response. Bounds the memory: all fields of four
/// devices.
const MAX_ACCESSES: usize = 32;
/// Bytes of a malformed response that are stored. As many as a frame of classic CAN has.
const MAX_STORED: usize = 8;

/// What a device responded to the read of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FieldContent {
    /// A value.
    Value(DescriptorValue),
    /// Data that are no value of the field.
    Malformed {
        /// Its first bytes, at most eight.
        data: Vec<u8>,
        /// What is wrong about them.
        fault: DescriptorFault,
    },
    /// A response with ERR = 0: the device reports an error.
    Refused,
    /// Nothing within the time of `calls.timeout_ms`.
    NoResponse,
}

impl FieldContent {
    /// Returns it in words, with the characters of a UID in this alphabet.
    pub fn in_words(&self, alphabet: &UidProfile) -> String {
        match self {
            Self::Value(value) => value.in_words(alphabet).to_string(),
            Self::Malformed { data, .. } if data.is_empty() => "no data".to_owned(),
            Self::Malformed { data, fault } => format!("{}: {fault}", hex(data, " ")),
            Self::Refused => "error response (ERR = 0)".to_owned(),
            Self::NoResponse => "no response".to_owned(),
        }
    }
}

/// The last read of a field.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct FieldReading {
    /// The field.
    pub field: DescriptorField,
    /// Time of the response, or of the end of the wait for it.
    pub time: Instant,
    /// What was received.
    pub content: FieldContent,
    /// The response; `None` where there is none.
    pub frame: Option<Frame>,
}

/// What is known of the descriptor of a device.
#[derive(Clone, Debug, Default)]
pub struct DeviceDescriptor {
    /// The last read of each field, in the order of [`DescriptorField::ALL`].
    readings: Vec<FieldReading>,
    /// True if descan has read it since the device was found or last restarted.
    pub(super) is_read: bool,
}

impl DeviceDescriptor {
    /// Returns the last read of each field that was read, in the order of [`DescriptorField::ALL`].
    pub fn readings(&self) -> &[FieldReading] {
        &self.readings
    }

    /// Returns the last read of a field; `None` if it was not read.
    pub fn reading(&self, field: DescriptorField) -> Option<&FieldReading> {
        self.readings.iter().find(|reading| reading.field == field)
    }

    /// Returns the value of a field; `None` where none is known.
    pub fn value(&self, field: DescriptorField) -> Option<DescriptorValue> {
        match self.reading(field)?.content {
            FieldContent::Value(value) => Some(value),
            _ => None,
        }
    }

    /// Returns the time of the last read; `None` if there was none.
    pub fn read_at(&self) -> Option<Instant> {
        self.readings.iter().map(|reading| reading.time).max()
    }

    /// Forgets a field: it was written since.
    fn forget(&mut self, field: DescriptorField) {
        self.readings.retain(|reading| reading.field != field);
    }

    /// Takes over what was read of the same device under another row.
    pub(super) fn take_over(&mut self, later: Self) {
        for reading in later.readings {
            self.store(reading);
        }
    }

    /// Stores a read; returns true if it changes what is known.
    fn store(&mut self, reading: FieldReading) -> bool {
        match self.readings.binary_search_by_key(&reading.field, |known| known.field) {
            Ok(at) => {
                let is_new = self.readings[at].content != reading.content;
                self.readings[at] = reading;
                is_new
            }
            Err(at) => {
                self.readings.insert(at, reading);
                true
            }
        }
    }
}

/// A read, or a write of a setting, that waits for its response.
#[derive(Clone, Copy, Debug)]
struct FieldAccess {
    time: Instant,
    requester: Address,
    device: Address,
    service: Service,
    field: DescriptorField,
    is_write: bool,
}

/// Reads and writes of all nodes, descan among them.
#[derive(Clone, Debug, Default)]
pub(super) struct FieldAccesses(VecDeque<FieldAccess>);

impl FieldAccesses {
    /// Notes a targeted request: an empty one to the service of a field reads it, and data written to a
    /// setting change it.
    pub fn note_request(&mut self, now: Instant, header: Header, data: &[u8], profile: &Profile) {
        let is_write = !data.is_empty();
        let service = header.service;
        let field =
            if is_write { setting_of(service, profile) } else { field_of(service, profile) };
        let Some(field) = field else { return };
        if self.0.len() == MAX_ACCESSES {
            self.0.pop_front();
        }
        let (requester, device) = (header.source, header.destination);
        let access = FieldAccess { time: now, requester, device, service, field, is_write };
        self.0.push_back(access);
    }

    /// Returns the field of the oldest read or write that a response answers, and true for a write. `is_echo`:
    /// its DST is that of the request, not the requester.
    fn take(
        &mut self,
        now: Instant,
        header: Header,
        is_echo: bool,
        profile: &Profile,
    ) -> Option<(DescriptorField, bool)> {
        let timeout = profile.calls.timeout();
        self.0.retain(|read| now.since(read.time) <= timeout);
        let at = self.0.iter().position(|read| {
            read.service == header.service
                && read.device == header.source
                && (is_echo || read.requester == header.destination)
        })?;
        self.0.remove(at).map(|read| (read.field, read.is_write))
    }
}

/// Returns the field that a service reads, if its number is not assumed.
fn field_of(service: Service, profile: &Profile) -> Option<DescriptorField> {
    known_fields(profile).find(|field| field.service(&profile.descriptor) == service)
}

/// Returns the field that a service writes, if a file sets its number.
fn setting_of(service: Service, profile: &Profile) -> Option<DescriptorField> {
    let number = Some(service.number());
    if profile.writes.address == number {
        Some(DescriptorField::Address)
    } else if profile.writes.bitrate == number {
        Some(DescriptorField::Bitrate)
    } else {
        None
    }
}

/// Returns the fields whose service number is not assumed.
fn known_fields(profile: &Profile) -> impl Iterator<Item = DescriptorField> {
    let is_known = |field: &DescriptorField| profile.origin(field.key()) != ValueOrigin::Assumed;
    DescriptorField::ALL.into_iter().filter(is_known)
}

/// Returns the fields whose service number a file sets: only these are read.
pub fn given_fields(profile: &Profile) -> impl Iterator<Item = DescriptorField> {
    known_fields(profile).filter(|field| profile.is_given(field.key()))
}

impl DeviceTracker {
    /// Stores what a device responded to the read of a field, or that it did not.
    fn store_field(
        &mut self,
        row: DeviceId,
        field: DescriptorField,
        content: FieldContent,
        frame: Option<&Frame>,
    ) {
        let now = self.now;
        let Some(device) = self.device_table.get_mut(row) else { return };
        self.counters.malformed += u64::from(matches!(content, FieldContent::Malformed { .. }));
        let reading = FieldReading { field, time: now, content, frame: frame.copied() };
        if device.descriptor.store(reading) {
            self.emit(row, EventKind::DescriptorField(field));
        }
    }
}

impl Engine {
    /// Command: reads a field of a device's descriptor, or with `None` all, one by one; only those
    /// whose service numbers a file sets. Returns the number of fields.
    pub fn read_descriptor(
        &mut self,
        now: Instant,
        device: DeviceId,
        field: Option<DescriptorField>,
    ) -> usize {
        self.tracker.advance(now);
        let count = self.queue_reads(device, field, false);
        self.tracker.wake_at(self.tracker.now);
        count
    }

    /// Returns true while fields of a device's descriptor are still to be read.
    pub fn is_reading_descriptor(&self, device: DeviceId) -> bool {
        self.requester.device_requests.reads_of(device) > 0
    }

    /// Queues the reads of devices that were found or restarted, if the profile says so.
    pub(super) fn queue_due_reads(&mut self) {
        let config = &self.tracker.config;
        if !config.profile.descriptor.auto || config.listen_only || !config.send_requests {
            return;
        }
        let table = &self.tracker.device_table;
        let is_due = |id: &DeviceId| {
            table.get(*id).is_some_and(|device| {
                !device.descriptor.is_read
                    && device.name.is_some()
                    && device.is_present()
                    && !is_open(&device.services_query)
                    && table.is_current(device)
                    && !self.tracker.conflicts.finding_tracker().is_open_at(device.address)
            })
        };
        let all = table.devices().iter().map(|device| device.id);
        let due: Vec<DeviceId> = all.filter(is_due).collect();
        for id in due {
            self.queue_reads(id, None, true);
        }
    }

    fn queue_reads(
        &mut self,
        device: DeviceId,
        only: Option<DescriptorField>,
        is_automatic: bool,
    ) -> usize {
        let profile = self.tracker.config.profile.clone();
        let Some(row) = self.tracker.device_table.get_mut(device) else { return 0 };
        row.descriptor.is_read |= only.is_none();
        let mut count = 0;
        for field in given_fields(&profile).filter(|field| only.is_none_or(|it| it == *field)) {
            let service = field.service(&profile.descriptor);
            let request = DeviceRequest { device, service, data: Vec::new() };
            let requests = &mut self.requester.device_requests;
            let queued = requests.push(request, Some(field), is_automatic);
            count += usize::from(queued.is_some());
        }
        count
    }

    /// Takes the end of a read of descan.
    pub(super) fn end_read(
        &mut self,
        row: DeviceId,
        field: DescriptorField,
        outcome: &RequestOutcome,
    ) {
        if let RequestOutcome::NoResponse = outcome {
            self.tracker.store_field(row, field, FieldContent::NoResponse, None);
        }
        if self.requester.device_requests.reads_of(row) > 0 {
            return;
        }
        let profile = &self.tracker.config.profile;
        let Some(device) = self.tracker.device_table.get(row) else { return };
        let has_value = |field: &DescriptorField| device.descriptor.value(*field).is_some();
        let values = given_fields(profile).filter(has_value).count();
        let fields = given_fields(profile).count();
        self.tracker.emit(row, EventKind::DescriptorRead { values, fields });
    }

    /// Takes a response of another service than DES: it may answer a read or a write.
    pub(super) fn note_field_response(
        &mut self,
        row: DeviceId,
        header: Header,
        is_echo: bool,
        frame: &Frame,
    ) {
        let now = self.tracker.now;
        let profile = self.tracker.config.profile.clone();
        let accessed = self.tracker.field_accesses.take(now, header, is_echo, &profile);
        let Some((field, is_write)) = accessed else { return };
        if is_write {
            if header.no_error
                && let Some(device) = self.tracker.device_table.get_mut(row)
            {
                // What the device made of the data is known once it is read.
                device.descriptor.forget(field);
                self.tracker.emit(row, EventKind::DescriptorField(field));
            }
            return;
        }
        let content = if header.no_error {
            let order = profile.descriptor.byte_order;
            match DescriptorValue::decode(field, frame.data(), order) {
                Ok(value) => FieldContent::Value(value),
                Err(fault) => {
                    let data = frame.data().iter().take(MAX_STORED).copied().collect();
                    FieldContent::Malformed { data, fault }
                }
            }
        } else {
            FieldContent::Refused
        };
        self.tracker.store_field(row, field, content, Some(frame));
    }
}
