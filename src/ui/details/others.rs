//! Other devices in the details: the boards of a shared address, devices with the same name, the
//! same device on other buses.

use super::DeviceDetails;
use crate::app::{
    BeatStats, Redundancy, TaskState, clock_millis, format_time_of_day, ordinal, twin_differences,
};
use crate::discovery::Device;
use crate::text::join_first;
use crate::theme::Role;
use crate::ui::brush::labelled;
use crate::ui::devices::{STATS_BEATS, jitter_text, period_text, state_role, uid_text};
use unicode_width::UnicodeWidthStr;

/// Twins that are compared; the others are named only.
const MAX_TWINS: usize = 3;
/// Differences of a twin that are listed; the others are counted.
const MAX_DIFFERENCES: usize = 6;

impl DeviceDetails<'_, '_> {
    /// The tasks of the project that the device does, and the others that do them.
    pub(super) fn tasks(&mut self, device: &Device) {
        let app = self.app();
        for task in &app.shown_buses().project().tasks {
            let ends = task.ends(app.shown_buses(), app.shown_time());
            let Some(own) = ends.iter().find(|end| end.device == Some(device.id)) else { continue };
            self.blank();
            self.add("task", Role::Text, &task.task);
            let failed = ends.iter().filter_map(|end| end.state.since()).max();
            let is_alone = own.state == TaskState::Works
                && ends.iter().all(|end| end.device == own.device || end.state.is_out());
            if let Some(since) = failed.filter(|_| is_alone) {
                let since = format_time_of_day(app, since);
                self.add("", Role::Warning, &format!("! alone since {since}"));
            }
            for end in ends.iter().filter(|end| end.device != own.device || end.device.is_none()) {
                let role = if end.state.is_out() { Role::Warning } else { Role::Text };
                self.add("also by", role, &format!("{} {}", end.label, end.state.words()));
            }
        }
    }

    /// The boards at the address: joining, mode and heartbeats of each.
    pub(super) fn boards(&mut self, device: &Device) {
        if self.row.board.is_none() {
            return;
        }
        let app = self.app();
        let is_here = |row: &&crate::app::Row| {
            row.board.is_some() && row.bus == self.row.bus && row.address == self.row.address
        };
        self.blank();
        let mut rows: Vec<&crate::app::Row> = app.rows().iter().filter(is_here).collect();
        // Whatever the order of the list is.
        rows.sort_by_key(|row| row.board.map(|board| board.side));
        for row in rows {
            let Some(board) = row.board else { continue };
            let uid = uid_text(app, device, board.sender.uid);
            let sender = board.sender;
            let joined = if sender.first < sender.since { "back" } else { "joined" };
            let text = format!("{uid} {joined} {}", clock_millis(app, board.sender.since));
            let is_wide = text.width() + 2 <= usize::from(self.width);
            let since = format_time_of_day(app, board.sender.since);
            let text = if is_wide { text } else { format!("{uid} {joined} {since}") };
            let side = format!("{} ", board.side);
            self.lines.extend(labelled(self.brush, &side, Role::Text, &text, self.width));
            let stats = BeatStats::of(&app.beats_of(row, STATS_BEATS));
            let mode = board.sender.mode.map(|mode| mode.to_string());
            let period = stats
                .period
                .zip(stats.jitter)
                .map(|(period, jitter)| format!("{} {}", period_text(period), jitter_text(jitter)));
            let missed = (stats.missed > 0).then(|| format!("{} missed", stats.missed));
            let place = (board.side as usize).saturating_sub('A' as usize);
            let order = (place > 0).then(|| ordinal(place));
            let texts: Vec<String> = [order, mode, period, missed].into_iter().flatten().collect();
            let text = texts.join(", ");
            self.lines.extend(labelled(self.brush, "  ", Role::Muted, &text, self.width));
        }
    }

    /// Devices with the same name on the bus, and what differs.
    pub(super) fn twins(&mut self, device: &Device) {
        if !self.row.twin {
            return;
        }
        self.blank();
        let app = self.app();
        let devices = app.buses()[usize::from(device.id.bus.0)].devices().iter();
        let mut twins: Vec<&Device> = devices
            .filter(|it| it.id != device.id && it.is_present() && it.name == device.name)
            .collect();
        twins.sort_by_key(|twin| twin.address);
        let places: Vec<String> = twins.iter().map(|it| it.address.to_string()).collect();
        self.add("", Role::Text, &format!("² same name at {} (allowed)", places.join(", ")));
        for twin in twins.into_iter().take(MAX_TWINS) {
            let mut differences = Vec::new();
            if let Some((own, other)) = device.uid.zip(twin.uid)
                && own != other
            {
                differences.push(format!("UID {}", uid_text(app, twin, other)));
            }
            let services = twin_differences(device, twin);
            if services.is_empty() && device.services.is_some() && twin.services.is_some() {
                differences.push("same services and versions".to_owned());
            }
            differences.extend(services);
            if !differences.is_empty() {
                let text = join_first(differences, MAX_DIFFERENCES, "; ");
                self.add(&format!("² at {}", twin.address), Role::Text, &text);
            }
        }
    }

    /// The same device on other buses: redundant ones with their state, separate networks.
    pub(super) fn other_buses(&mut self, device: &Device) {
        let app = self.app();
        if !self.row.redundant_ids.is_empty() {
            self.add("", Role::Text, "redundant: the same services on each bus");
            for device in app.devices_of(self.row) {
                let bus = app.shown_buses().unique_name(device.id.bus);
                let since = format_time_of_day(app, device.presence_since);
                let presence = device.presence;
                let text = format!("@{} {presence} since {since}", device.address);
                self.add(&bus, state_role(presence.into()), &text);
            }
        }
        for sibling in app.redundant_devices(device.id) {
            let Some(other) = app.device(sibling.id) else { continue };
            let bus = app.shown_buses().unique_name(sibling.id.bus);
            if sibling.relation == Redundancy::Redundant {
                continue;
            }
            let what = sibling.relation.words();
            let text = format!("also on {bus} @{}, {what}", other.address);
            self.add("", Role::Text, &text);
        }
    }
}
