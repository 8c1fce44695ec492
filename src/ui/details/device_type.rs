//! The type of a device in its details, as the catalogue describes it.

use super::DeviceDetails;
use crate::catalogue::TypeBasis;
use crate::discovery::Device;
use crate::text::counted;
use crate::theme::Role;

impl DeviceDetails<'_, '_> {
    /// Adds what the type is called, how it is known, and where its documentation is.
    pub(super) fn device_type(&mut self, device: &Device) {
        let Some((found, basis)) = self.app().shown_buses().type_of(device) else { return };
        self.blank();
        let by = match basis {
            TypeBasis::Gid => "by its GID",
            TypeBasis::Name => "by its name",
        };
        self.add("type", Role::Text, &format!("{} ({by})", found.label()));
        if let Some(link) = &found.documentation {
            self.add("documents", Role::Text, link);
        }
        let count = found.services.len() as u64;
        let services = device.services.as_ref().filter(|_| count > 0);
        match services.map(|own| found.difference(own)) {
            Some(Some(difference)) => self.add("", Role::Warning, &format!("! {difference}")),
            Some(None) => {
                let text = format!("has its {}", counted(count, "service"));
                self.add("", Role::Muted, &text);
            }
            None => {}
        }
    }
}
