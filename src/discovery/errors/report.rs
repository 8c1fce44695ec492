//! Error frames in the engine: updates the tracker, repeats requests to suspects, and turns results
//! into findings.

use super::super::conflicts::ConflictDetector;
use super::super::device_table::DeviceTable;
use super::super::device_tracker::DeviceTracker;
use super::super::{Presence, finding_text};
use super::{ExpectedFrame, SuspectOutcome, TEXT_INTERVAL};
use crate::error_report::ErrorReport;
use crate::finding::{Evidence, FindingState};
use crate::frame::Frame;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;

/// Delay of a heartbeat, in periods, from which it is missing. Measured with `cargo bench --bench
/// discovery`: a scan delays heartbeats by 0.13 periods at 125 kbit/s and 0.26 periods with 40 %
/// other traffic.
const HEARTBEAT_WINDOW_PERIODS: f64 = 0.3;

impl DeviceTracker {
    /// Processes an error frame.
    pub(in crate::discovery) fn process_error_frame(&mut self, frame: &Frame) {
        let Some(report) = ErrorReport::of(frame) else { return };
        let (now, frames) = (self.now, self.counters.frames);
        // Bus-off, it receives nothing until it reports something of the bus.
        if report.is_bus_off() {
            self.outages.begin(now);
        } else if report.is_from_bus() && self.outages.is_contradicted_by(frame.time) {
            self.end_outage();
        }
        let errors = &mut self.errors;
        errors.frames = frames;
        let broken = errors.broken(&report);
        if errors.rate.note_report(now, &report, broken, frames) {
            self.judge_bus(frame);
        }
        if broken > 0 {
            let (device_table, conflicts) = (&self.device_table, &self.conflicts);
            self.errors.attribute(now, &report, broken, frame, || {
                due_heartbeat(device_table, conflicts, now)
            });
        }
        self.wake_at(now);
    }

    /// Updates the finding about the bus after an error.
    fn judge_bus(&mut self, frame: &Frame) {
        let (now, frames) = (self.now, self.counters.frames);
        let Some(state) = self.errors.rate.finding_state(frames) else { return };
        let Some(finding) =
            self.conflicts.finding_tracker_mut().set_bus_errors_state(now, None, state)
        else {
            return;
        };
        finding.add_evidence(Evidence {
            time: frame.time,
            description: "error frame".into(),
            frame: Some(*frame),
        });
        if finding.changed == now || finding.text.is_empty() {
            self.write_bus_text();
        } else {
            self.errors.is_text_outdated = true;
        }
    }

    /// Updates the text of the bus finding.
    fn write_bus_text(&mut self) {
        let (now, frames) = (self.now, self.counters.frames);
        self.errors.is_text_outdated = false;
        self.errors.text_written_at = now;
        let Some(state) = self.errors.rate.finding_state(frames) else { return };
        if let Some(finding) =
            self.conflicts.finding_tracker_mut().set_bus_errors_state(now, None, state)
        {
            let summary = self.errors.rate.summary(now, frames);
            (finding.text, finding.remedy) = finding_text::bus_errors(&summary);
        }
    }

    /// Closes windows that are over, and repeats requests to suspects.
    pub(in crate::discovery) fn check_errors(&mut self, may_send: bool) {
        let (now, frames) = (self.now, self.counters.frames);
        self.errors.frames = frames;
        let device_table = &mut self.device_table;
        self.errors.handle_timeout(now, |address, request, since| {
            // After a burst devices may reboot, and not respond for some seconds.
            let Some(device) = device_table.current_device_mut(address) else { return false };
            let is_sent = may_send && device.is_present() && device.last_seen > since;
            if is_sent {
                device.query_mut(request).schedule(now);
            }
            is_sent
        });
        if self.errors.rate.handle_timeout(now, frames) {
            self.errors.is_text_outdated = false;
            let cleared = FindingState::Cleared;
            let tracker = self.conflicts.finding_tracker_mut();
            if let Some(finding) = tracker.set_bus_errors_state(now, None, cleared) {
                finding_text::end_bus_off(finding);
            }
        } else if self.errors.is_text_outdated && now >= self.errors.text_written_at + TEXT_INTERVAL
        {
            self.write_bus_text();
        }
        self.emit_bus_errors();
    }

    /// Turns new results about addresses into findings.
    pub(in crate::discovery) fn emit_bus_errors(&mut self) {
        let now = self.now;
        while let Some(outcome) = self.errors.outcomes.pop_front() {
            let (address, due, evidence) = match outcome {
                SuspectOutcome::Reported(address, due, evidence) => (address, due, evidence),
                SuspectOutcome::Cleared(address) => {
                    self.conflicts.finding_tracker_mut().set_bus_errors_state(
                        now,
                        Some(address),
                        FindingState::Cleared,
                    );
                    continue;
                }
            };
            let name: Option<Name> =
                self.device_table.current_device(address).and_then(|device| device.name.clone());
            let suspected = FindingState::Suspected;
            let Some(finding) = self.conflicts.finding_tracker_mut().set_bus_errors_state(
                now,
                Some(address),
                suspected,
            ) else {
                continue;
            };
            if let Some(name) = &name {
                finding.add_name(name);
            }
            for piece in evidence {
                finding.add_evidence(piece);
            }
            finding_text::describe_errors_at(finding, address, due == ExpectedFrame::Heartbeat);
        }
    }

    pub(in crate::discovery) fn errors_timeout(&self) -> Option<Instant> {
        self.errors.poll_timeout(self.counters.frames)
    }
}

/// Returns the only address whose heartbeat is due now, its last heartbeat, and when the next is
/// overdue; `None` if there is none or more than one.
fn due_heartbeat(
    device_table: &DeviceTable,
    conflicts: &ConflictDetector,
    now: Instant,
) -> Option<(Address, Option<Frame>, Instant)> {
    let mut found = None;
    for device in device_table.devices() {
        let heartbeats = &device.heartbeat;
        let (Some(last), Presence::Online) = (heartbeats.last, device.presence) else { continue };
        let expected = conflicts.periods().of(device.address);
        let period = heartbeats.period().unwrap_or(expected);
        let jitter = heartbeats.jitter().unwrap_or_default() * 3;
        let due = last + period;
        // A burst starts with the heartbeat and takes some milliseconds.
        let early = due - (jitter + Duration::from_millis(2));
        let late = due + jitter + Duration::from_millis(30);
        if (early..=late).contains(&now) {
            if found.is_some() {
                return None;
            }
            let overdue = due + period.mul_f64(HEARTBEAT_WINDOW_PERIODS);
            found = Some((device.address, conflicts.last_heartbeat(device.address), overdue));
        }
    }
    found
}
