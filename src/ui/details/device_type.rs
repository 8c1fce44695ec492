//! The type of a device in its details, as the catalogue describes it, and its DEBUG messages.

use super::DeviceDetails;
use crate::app::format_time_of_day;
use crate::catalogue::TypeBasis;
use crate::discovery::{DebugCount, Device};
use crate::text::{counted, join_first};
use crate::theme::Role;
use std::cmp::Reverse;

/// Codes that a line names; the others are counted.
const NAMED: usize = 6;

impl DeviceDetails<'_, '_> {
    /// Adds the number of DEBUG messages by code.
    pub(super) fn debug_messages(&mut self, device: &Device) {
        let counts = &device.debug_messages;
        let Some(last) = counts.by_code().iter().map(|known| known.last).max() else { return };
        let (bus, app) = (device.id.bus, self.app());
        let profile = app.profile(bus);
        let of_code = |known: &DebugCount| {
            let types = app.shown_buses().types_at(bus, Some(device.address), known.last);
            let name = types.debug_name(&profile, known.code);
            format!("{} {}", name.unwrap_or_else(|| known.code.to_string()), known.count)
        };
        let mut all: Vec<&DebugCount> = counts.by_code().iter().collect();
        all.sort_by_key(|known| Reverse(known.count));
        let codes = join_first(all.into_iter().map(of_code).collect(), NAMED, ", ");
        let last = format_time_of_day(app, last);
        self.add("DEBUG", Role::Text, &format!("{}: {codes}; last {last}", counts.total()));
    }

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
                let text = format!("has the {} of its type", counted(count, "service"));
                self.add("", Role::Muted, &text);
            }
            None => {}
        }
    }
}
