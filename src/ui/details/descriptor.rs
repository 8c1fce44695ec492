//! The descriptor in the details of a device: a line for each field that was read.

use super::DeviceDetails;
use crate::app::format_time_of_day;
use crate::discovery::{Device, FieldContent};
use crate::theme::Role;

impl DeviceDetails<'_, '_> {
    /// Adds the time of the last read, and each field with what the device responded.
    pub(super) fn descriptor(&mut self, device: &Device) {
        let Some(read_at) = device.descriptor.read_at() else { return };
        self.blank();
        let read_at = format_time_of_day(self.app(), read_at);
        self.add("", Role::Muted, &format!("descriptor, read {read_at}"));
        let Some(bus) = self.app().bus(device.id.bus) else { return };
        let alphabet = &bus.config().profile.uid;
        for reading in device.descriptor.readings() {
            let (role, sign) = match &reading.content {
                FieldContent::Value(_) => (Role::Text, ""),
                FieldContent::Malformed { .. } | FieldContent::Refused => (Role::Warning, "! "),
                FieldContent::NoResponse => (Role::Muted, ""),
            };
            let text = format!("{sign}{}", reading.content.in_words(alphabet));
            self.add(reading.field.label(), role, &text);
        }
    }
}
