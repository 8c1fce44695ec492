//! Findings of the project: buses with another bit rate than it says, and tasks of which a device
//! fails.
//!
//! Pure: facts and buses in, findings out.

use super::comparison::{Comparison, Values};
use crate::app::project_facts::{TaskEnd, TaskState};
use crate::bitrate::kbit;
use crate::finding::{FindingKind, FindingState};
use crate::frame::BusIndex;
use crate::text::Name;

impl Comparison<'_> {
    /// Adds what differs from the project.
    pub(super) fn project(&mut self) {
        self.bitrates();
        self.redundant_tasks();
    }

    fn bitrates(&mut self) {
        let buses = self.inputs.buses;
        for (index, bus) in buses.iter().enumerate() {
            let wanted = buses.project().bitrates.get(bus.name_without_rates());
            let (Some(wanted), Some(rate)) = (wanted, bus.config().bitrate) else { continue };
            if *wanted == rate {
                continue;
            }
            let (wanted, rate) = (kbit(*wanted), kbit(rate));
            let name = crate::text::printable(bus.name.as_bytes());
            let text = format!("{name} has {rate}; the project says {wanted}.");
            let values: Values = &[("project rate", &wanted), ("rate", &rate)];
            let bus = Some(BusIndex(index as u8));
            self.add(FindingKind::BitrateDiffers, bus, None, None, text, values);
        }
    }

    fn redundant_tasks(&mut self) {
        let (buses, now) = (self.inputs.buses, self.inputs.now);
        for task in &buses.project().tasks {
            let ends = task.ends(buses, now);
            let out: Vec<&TaskEnd> = ends.iter().filter(|end| end.state.is_out()).collect();
            let Some(first) = out.first() else { continue };
            let working = ends.iter().find(|end| end.state == TaskState::Works);
            let why: Vec<String> =
                out.iter().map(|end| format!("{} {}", end.label, end.state.words())).collect();
            let why = why.join(", ");
            let (kind, text) = match working {
                Some(working) => {
                    let text = format!("{}: {why}; {} does it alone.", task.task, working.label);
                    (FindingKind::RedundancyLost, text)
                }
                // The other one may be there.
                None if out.len() < ends.len() => continue,
                None => (FindingKind::TaskFailed, format!("{}: {why}.", task.task)),
            };
            let device = first.device.and_then(|id| buses.device(id));
            let bus = first.device.map(|id| id.bus);
            let name = Some(Name::new(task.task.as_bytes()));
            self.add(kind, bus, device.map(|it| it.address), name, text, &[]);
            if let Some(finding) = self.found.last_mut() {
                let since = out.iter().filter_map(|end| end.state.since()).max();
                finding.first = since.unwrap_or(now);
                finding.state = FindingState::Confirmed;
            }
        }
    }
}
