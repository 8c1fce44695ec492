//! What happened to each device, for its lane: presence, mode, address, reboots.
//!
//! Input: the events of the engines. Output: the state of a device before the changes that are
//! kept, and these changes. Bounded: 256 changes of a device, 512 devices; the oldest changes and
//! devices are dropped. Does not know how lanes are drawn.

use crate::discovery::{Device, DeviceId, Event, EventKind, Presence};
use crate::time::Instant;
use crate::wire::id::Address;
use crate::wire::node::Mode;
use std::collections::VecDeque;

/// Largest number of changes of a device.
const MAX_CHANGES: usize = 256;
/// Largest number of devices.
const MAX_DEVICES: usize = 512;

/// A change of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LaneChange {
    /// It is online.
    Online,
    /// It is not online.
    Absent(Presence),
    /// Its mode.
    Mode(Mode),
    /// It moved to this address.
    Moved(Address),
    Rebooted,
    /// Its row was removed.
    Removed,
}

/// State of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LaneState {
    /// `None` before its first frame, and after its row was removed.
    pub presence: Option<Presence>,
    pub mode: Option<Mode>,
    pub address: Option<Address>,
}

impl LaneState {
    pub fn apply(&mut self, change: LaneChange) {
        match change {
            LaneChange::Online | LaneChange::Rebooted => self.presence = Some(Presence::Online),
            LaneChange::Absent(presence) => self.presence = Some(presence),
            LaneChange::Mode(mode) => self.mode = Some(mode),
            LaneChange::Moved(address) => self.address = Some(address),
            LaneChange::Removed => self.presence = None,
        }
    }
}

/// Changes of a device.
#[derive(Clone, Debug)]
pub(super) struct LaneRecord {
    device: DeviceId,
    /// State before the first change that is kept.
    pub before: LaneState,
    /// With their times, oldest first.
    pub changes: VecDeque<(Instant, LaneChange)>,
}

impl LaneRecord {
    fn push(&mut self, time: Instant, change: LaneChange) {
        if self.changes.len() == MAX_CHANGES
            && let Some((_, dropped)) = self.changes.pop_front()
        {
            self.before.apply(dropped);
        }
        let at = self.changes.partition_point(|(other, _)| *other <= time);
        self.changes.insert(at, (time, change));
    }
}

/// Changes of all devices.
#[derive(Clone, Debug, Default)]
pub(in crate::app) struct LaneRecords {
    /// In the order of their first events.
    records: VecDeque<LaneRecord>,
}

impl LaneRecords {
    /// The changes of a device.
    pub(super) fn get(&self, device: DeviceId) -> Option<&LaneRecord> {
        self.records.iter().rev().find(|record| record.device == device)
    }

    /// Takes an event.
    pub(in crate::app) fn handle_event(&mut self, event: &Event) {
        let Some(device) = event.device else { return };
        let change = match event.kind {
            EventKind::FirstFrame
            | EventKind::Returned { .. }
            | EventKind::Presence(Presence::Online) => LaneChange::Online,
            EventKind::Presence(presence) => LaneChange::Absent(presence),
            EventKind::Mode { to, .. } => LaneChange::Mode(to),
            EventKind::Moved { .. } => match event.address {
                Some(address) => LaneChange::Moved(address),
                None => return,
            },
            EventKind::Rebooted => LaneChange::Rebooted,
            EventKind::Removed => LaneChange::Removed,
            EventKind::IdsMerged { previous, before } => {
                return self.merge(previous, before, device);
            }
            _ => return,
        };
        let record = self.record(device);
        if matches!(event.kind, EventKind::FirstFrame) && record.changes.is_empty() {
            record.before.address = event.address;
        }
        record.push(event.time, change);
    }

    /// Adds what differs from the state of a device as it is known now: after a merge.
    pub(super) fn correct(&mut self, time: Instant, device: &Device) {
        let record = self.record(device.id);
        let mut state = record.before;
        for (_, change) in &record.changes {
            state.apply(*change);
        }
        if state.address.is_none() {
            record.before.address = Some(device.address);
        } else if state.address != Some(device.address) {
            record.push(time, LaneChange::Moved(device.address));
        }
        if state.presence != Some(device.presence) {
            let change = match device.presence {
                Presence::Online => LaneChange::Online,
                other => LaneChange::Absent(other),
            };
            record.push(time, change);
        }
        if let Some(mode) = device.mode.filter(|mode| state.mode != Some(*mode)) {
            record.push(time, LaneChange::Mode(mode));
        }
    }

    fn record(&mut self, device: DeviceId) -> &mut LaneRecord {
        let at = self.records.iter().rposition(|record| record.device == device);
        let at = at.unwrap_or_else(|| {
            if self.records.len() == MAX_DEVICES {
                self.records.pop_front();
            }
            let (before, changes) = (LaneState::default(), VecDeque::new());
            self.records.push_back(LaneRecord { device, before, changes });
            self.records.len() - 1
        });
        &mut self.records[at]
    }

    /// Moves the changes of `was`, those before `before` if given, to `device`.
    fn merge(&mut self, was: DeviceId, before: Option<Instant>, device: DeviceId) {
        let Some(at) = self.records.iter().rposition(|record| record.device == was) else { return };
        let is_before = |time: Instant| before.is_none_or(|before| time < before);
        let other = &mut self.records[at];
        let moved: Vec<_> =
            other.changes.iter().filter(|(time, _)| is_before(*time)).copied().collect();
        other.changes.retain(|(time, _)| !is_before(*time));
        let address = other.before.address;
        if before.is_none() {
            self.records.remove(at);
        }
        let record = self.record(device);
        if record.before.address.is_none() {
            record.before.address = address;
        }
        for (time, change) in moved {
            record.push(time, change);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::BusIndex;

    fn event(micros: u64, number: u32, kind: EventKind) -> Event {
        Event {
            time: Instant::from_micros(micros),
            device: Some(DeviceId { bus: BusIndex(0), number }),
            address: Some(Address::from_bits(12)),
            name: None,
            kind,
        }
    }

    #[test]
    fn changes_and_devices_are_bounded_and_keep_the_state_before() {
        let mut records = LaneRecords::default();
        records.handle_event(&event(0, 0, EventKind::FirstFrame));
        for at in 1..10_000 {
            let to = if at % 2 == 0 { Mode::Work } else { Mode::Cfg };
            records.handle_event(&event(at, 0, EventKind::Mode { from: None, to }));
        }
        let record = records.get(DeviceId { bus: BusIndex(0), number: 0 }).unwrap();
        assert_eq!(record.changes.len(), MAX_CHANGES);
        let address = Some(Address::from_bits(12));
        let presence = Some(Presence::Online);
        let mode = Some(if record.changes[0].1 == LaneChange::Mode(Mode::Cfg) {
            Mode::Work
        } else {
            Mode::Cfg
        });
        assert_eq!(record.before, LaneState { presence, mode, address });
        for number in 0..10_000 {
            records.handle_event(&event(10_000, number, EventKind::FirstFrame));
        }
        assert_eq!(records.records.len(), MAX_DEVICES);
    }

    #[test]
    fn merged_device_has_the_changes_of_both_in_order() {
        let mut records = LaneRecords::default();
        records.handle_event(&event(1, 0, EventKind::FirstFrame));
        records.handle_event(&event(2, 1, EventKind::FirstFrame));
        records.handle_event(&event(3, 0, EventKind::Presence(Presence::Lost)));
        let previous = DeviceId { bus: BusIndex(0), number: 1 };
        records.handle_event(&event(4, 0, EventKind::IdsMerged { previous, before: None }));
        assert!(records.get(previous).is_none());
        let record = records.get(DeviceId { bus: BusIndex(0), number: 0 }).unwrap();
        let times: Vec<u64> = record.changes.iter().map(|(time, _)| time.as_micros()).collect();
        assert_eq!(times, [1, 2, 3]);
    }
}
