//! Findings of the project: buses with another bit rate than it says, and tasks of which a device
//! fails.
//!
//! Pure: facts and buses in, findings out.

use super::and_list;
use super::comparison::{Comparison, Values};
use crate::app::project_facts::{TaskEnd, TaskState};
use crate::bitrate::{kbit, unexpected_rate};
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
            let name = crate::text::printable(bus.name.as_bytes());
            let text = unexpected_rate(&name, rate, *wanted);
            let values: Values = &[("project rate", &kbit(*wanted)), ("rate", &kbit(rate))];
            let bus = Some(BusIndex(index as u8));
            self.add(FindingKind::BitrateDiffers, bus, None, None, text, values);
        }
    }

    fn redundant_tasks(&mut self) {
        let (buses, now) = (self.inputs.buses, self.inputs.now);
        for task in &buses.project().tasks {
            let ends = task.ends(buses, now);
            let out: Vec<&TaskEnd> = ends.iter().filter(|end| end.state.is_out()).collect();
            if out.is_empty() {
                continue;
            }
            let works = |end: &&TaskEnd| end.state == TaskState::Works;
            let working = ends.iter().filter(works).map(|end| end.label.clone());
            let working: Vec<String> = working.collect();
            let why: Vec<String> =
                out.iter().map(|end| format!("{} {}", end.label, end.state.words())).collect();
            let why = why.join(", ");
            let (kind, text) = match &working[..] {
                // The other one may be there.
                [] if out.len() < ends.len() => continue,
                [] => (FindingKind::TaskFailed, format!("{}: {why}.", task.task)),
                [alone] => {
                    let text = format!("{}: {why}; {alone} does it alone.", task.task);
                    (FindingKind::RedundancyLost, text)
                }
                _ => {
                    let text = format!("{}: {why}; {} do it.", task.task, and_list(working));
                    (FindingKind::RedundancyLost, text)
                }
            };
            // The same finding whichever of the devices fails.
            let first = task.devices.first();
            let bus = first.and_then(|first| buses.find_by_name(&first.bus));
            let bus = bus.map(|(index, _)| index);
            self.add(kind, bus, None, Some(Name::new(task.task.as_bytes())), text, &[]);
            if let Some(finding) = self.found.last_mut() {
                let since = out.iter().filter_map(|end| end.state.since()).max();
                finding.first = since.unwrap_or(now);
                let is_certain = out.iter().all(|end| end.is_certain);
                finding.state =
                    if is_certain { FindingState::Confirmed } else { FindingState::Suspected };
                let devices = out.iter().filter_map(|end| buses.device(end.device?));
                finding.addresses = devices.map(|device| device.address).collect();
                finding.addresses.sort_unstable();
                finding.addresses.dedup();
            }
        }
    }
}
