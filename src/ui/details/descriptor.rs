//! The descriptor in the details of a device: a line for each field that was read.

use super::DeviceDetails;
use crate::app::format_time_of_day;
use crate::discovery::{Device, FieldContent};
use crate::text::hex;
use crate::theme::Role;

impl DeviceDetails<'_, '_> {
    /// Adds the time of the last read, and each field with what the device responded.
    pub(super) fn descriptor(&mut self, device: &Device) {
        let Some(read_at) = device.descriptor.read_at() else { return };
        self.blank();
        let read_at = format_time_of_day(self.app(), read_at);
        self.add("descriptor", Role::Muted, &format!(" read {read_at}"));
        let Some(bus) = self.app().bus(device.id.bus) else { return };
        let alphabet = &bus.config().profile.uid;
        for reading in device.descriptor.readings() {
            let (role, text) = match &reading.content {
                FieldContent::Value(value) => (Role::Text, value.in_words(alphabet).to_string()),
                FieldContent::Malformed { data, .. } if data.is_empty() => {
                    (Role::Warning, "! no data".to_owned())
                }
                FieldContent::Malformed { data, fault } => {
                    (Role::Warning, format!("! {}: {fault}", hex(data, " ")))
                }
                FieldContent::Refused => (Role::Warning, "! error response (ERR = 0)".to_owned()),
                FieldContent::NoResponse => (Role::Muted, "no response".to_owned()),
            };
            self.add(reading.field.label(), role, &text);
        }
    }
}
