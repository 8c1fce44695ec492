//! Findings that the descriptors of the devices show: settings that move a device elsewhere at its
//! next start, and devices of one type with different services.
//!
//! Pure: entries and devices in, findings out. Only values that were read are compared.

use super::comparison::{Comparison, Values};
use crate::app::buses::Bus;
use crate::bitrate::kbit;
use crate::catalogue::TypeBasis;
use crate::discovery::{Device, FieldContent, FieldReading};
use crate::document::Entry;
use crate::finding::{Evidence, FindingKind, FindingState};
use crate::text::{Quoted, join_first};
use crate::wire::descriptor::{AddressSetting, DescriptorField, DescriptorValue, Gid};
use crate::wire::id::Address;
use crate::wire::node::Mode;
use crate::wire::profile::UidProfile;
use std::collections::{BTreeMap, BTreeSet};

/// Services or fields that a text names; the others are counted.
const NAMED: usize = 4;

/// Devices of one type and major firmware version.
type DevicesOfType<'a> = BTreeMap<(Gid, u16), Vec<(&'a Device, BTreeSet<&'a [u8]>)>>;

impl Comparison<'_> {
    /// Adds what the descriptors show without des.json.
    pub(super) fn descriptors(&mut self) {
        let buses = self.inputs.buses;
        for bus in buses.iter() {
            let alphabet = &bus.config().profile.uid;
            for device in bus.devices().iter().filter(|device| device.is_present()) {
                self.malformed_fields(device, alphabet);
                if let Some(rate) = bus.config().bitrate {
                    self.fixed_bitrate(device, rate);
                }
            }
        }
        self.services_of_types();
    }

    /// Adds devices with other services than the catalogue says of their types.
    pub(super) fn catalogue(&mut self) {
        let buses = self.inputs.buses;
        let present = buses.iter().flat_map(Bus::devices).filter(|it| it.is_present());
        for device in present.filter(|it| it.mode != Some(Mode::Boot) && !it.services_are_shared) {
            let Some((found, basis)) = buses.type_of(device) else { continue };
            let Some(difference) = device.services.as_ref().and_then(|own| found.difference(own))
            else {
                continue;
            };
            let (label, by) = (
                label_of_device(device),
                match basis {
                    TypeBasis::Gid => "by its GID",
                    TypeBasis::Name => "by its name",
                },
            );
            let text = format!("{label} is a {} {by}, but {difference}.", found.label());
            self.add_of(FindingKind::CatalogueDiffers, device, text, &[]);
            match (basis, self.found.last_mut()) {
                (TypeBasis::Name, Some(finding)) => finding.state = FindingState::Suspected,
                _ => self.prove_by(device, DescriptorField::Gid),
            }
        }
    }

    /// Adds fields that were sent with data that are no value.
    fn malformed_fields(&mut self, device: &Device, alphabet: &UidProfile) {
        let is_malformed =
            |it: &&FieldReading| matches!(it.content, FieldContent::Malformed { .. });
        let malformed = device.descriptor.readings().iter().filter(is_malformed);
        let fields: Vec<String> = malformed
            .clone()
            .map(|it| format!("{} {}", it.field.label(), it.content.in_words(alphabet)))
            .collect();
        if fields.is_empty() {
            return;
        }
        let fields = join_first(fields, NAMED, "; ");
        let text = format!("{} sends a malformed descriptor: {fields}.", label_of_device(device));
        self.add_of(FindingKind::MalformedDescriptor, device, text, &[]);
        for reading in malformed {
            self.prove_by(device, reading.field);
        }
    }

    /// Adds a fixed bit rate that is not that of the bus.
    fn fixed_bitrate(&mut self, device: &Device, rate: u32) {
        let field = DescriptorField::Bitrate;
        let Some(DescriptorValue::Bitrate(setting)) = device.descriptor.value(field) else {
            return;
        };
        if !setting.is_fixed || setting.rate == rate {
            return;
        }
        let text = format!(
            "{} is set to {setting}, the bus has {}: it is lost at its next restart.",
            label_of_device(device),
            kbit(rate)
        );
        self.add_of(FindingKind::FixedBitrateDiffers, device, text, &[]);
        self.prove_by(device, field);
    }

    /// Adds a fixed address that is not the static one of the device's entry.
    pub(super) fn fixed_address(&mut self, entry: &Entry, device: &Device) {
        let field = DescriptorField::Address;
        let pinned = entry.address.filter(|_| entry.is_static).and_then(Address::new);
        let (Some(pinned), Some(DescriptorValue::Address(AddressSetting::Fixed(fixed)))) =
            (pinned, device.descriptor.value(field))
        else {
            return;
        };
        if fixed == pinned {
            return;
        }
        let name = Quoted(&entry.name);
        let text =
            format!("{name} is set to the fixed address {fixed}; the file pins it to {pinned}.");
        let values: Values = &[("static address", &pinned), ("fixed address", &fixed)];
        self.add_of(FindingKind::FixedAddressDiffers, device, text, values);
        self.prove_by(device, field);
    }

    /// Adds devices whose services are not those of most devices of their type and major version.
    fn services_of_types(&mut self) {
        let mut types: DevicesOfType = BTreeMap::new();
        let all = self.inputs.buses.iter().flat_map(Bus::devices);
        for device in all.filter(|it| it.is_present() && it.mode != Some(Mode::Boot)) {
            let gid = device.descriptor.value(DescriptorField::Gid);
            let version = device.descriptor.value(DescriptorField::Firmware);
            if let (
                Some(DescriptorValue::Gid(gid)),
                Some(DescriptorValue::Firmware(version)),
                Some(services),
            ) = (gid, version, &device.services)
                && !gid.is_blank()
                && !device.services_are_shared
            {
                let names = services.iter().map(|service| service.name.as_bytes()).collect();
                types.entry((gid, version.major)).or_default().push((device, names));
            }
        }
        for ((gid, major), devices) in &types {
            let count = |of: &BTreeSet<&[u8]>| devices.iter().filter(|(_, it)| it == of).count();
            // Of equally many the first one.
            let usual = devices.iter().rev().max_by_key(|(_, names)| count(names));
            let Some((example, usual)) = usual else { continue };
            for (device, names) in devices.iter().filter(|(_, names)| names != usual) {
                let list = |names: Vec<&&[u8]>| {
                    let names = names.into_iter().map(|name| Quoted(name).to_string());
                    join_first(names.collect(), NAMED, ", ")
                };
                let (more, less) = (
                    names.difference(usual).collect::<Vec<_>>(),
                    usual.difference(names).collect::<Vec<_>>(),
                );
                let more = (!more.is_empty()).then(|| format!("also has {}", list(more)));
                let less = (!less.is_empty()).then(|| format!("lacks {}", list(less)));
                let differences: Vec<String> = more.into_iter().chain(less).collect();
                let text = format!(
                    "{} and {} are of one type (GID 0x{gid}, firmware {major}), but the first {}.",
                    label_of_device(device),
                    label_of_device(example),
                    differences.join(" and ")
                );
                self.add_of(FindingKind::TypeServicesDiffer, device, text, &[]);
                self.prove_by(device, DescriptorField::Gid);
                self.prove_by(device, DescriptorField::Firmware);
            }
        }
    }

    fn add_of(&mut self, kind: FindingKind, device: &Device, text: String, values: Values) {
        let bus = Some(device.id.bus);
        self.add(kind, bus, Some(device.address), device.name.clone(), text, values);
    }

    /// Adds the response that has a field's value to the evidence of the last finding.
    fn prove_by(&mut self, device: &Device, field: DescriptorField) {
        let reading = device.descriptor.reading(field);
        let (Some(finding), Some(FieldReading { frame: Some(frame), time, .. })) =
            (self.found.last_mut(), reading)
        else {
            return;
        };
        let description = format!("{} of its descriptor", field.label()).into();
        finding.add_evidence(Evidence { time: *time, description, frame: Some(*frame) });
    }
}

/// A device in a sentence: its name and its address.
pub(in crate::app) fn label_of_device(device: &Device) -> String {
    let name = device.name.as_ref();
    let name = name.map_or("An unnamed device".to_owned(), |name| name.quoted().to_string());
    format!("{name} at {}", device.address)
}
