//! What the engine does with error frames: takes them in, asks who is looked into, tells what comes
//! of it.

use super::super::conflict_detector::ConflictDetector;
use super::super::device_table::DeviceTable;
use super::super::{Engine, Presence, finding_text};
use super::{Due, SuspectOutcome, WORDS};
use crate::error_report::ErrorReport;
use crate::finding::{Confidence, Evidence};
use crate::frame::Frame;
use crate::text::Name;
use crate::time::{Duration, Instant};
use crate::wire::id::Address;

/// How late a heartbeat is missing, in periods.
const OVERDUE: f64 = 0.3;

impl Engine {
    /// Takes an error frame in.
    pub(in crate::discovery) fn process_error_frame(&mut self, frame: &Frame) {
        let Some(report) = ErrorReport::of(frame) else { return };
        let (now, frames) = (self.now, self.counters.frames);
        let errors = &mut self.errors;
        errors.frames = frames;
        let broken = errors.broken(&report);
        if errors.rate.see(now, &report, broken, frames) {
            self.judge_bus(frame);
        }
        if broken > 0 {
            let (device_table, conflicts) = (&self.device_table, &self.conflicts);
            let period = self.config.profile.heartbeat.period();
            self.errors.attribute(now, &report, broken, frame, || {
                due_heartbeat(device_table, conflicts, now, period)
            });
        }
        self.wake_at(now);
    }

    /// Tells what is to be told about the bus as a whole, after an error.
    fn judge_bus(&mut self, frame: &Frame) {
        let (now, frames) = (self.now, self.counters.frames);
        let Some(confidence) = self.errors.rate.confidence(frames) else { return };
        let Some(finding) = self.conflicts.cases_mut().judge_errors(now, None, confidence) else {
            return;
        };
        finding.add(Evidence { time: frame.time, what: "error frame".into(), frame: Some(*frame) });
        if finding.changed == now || finding.text.is_empty() {
            self.write_bus_text();
        } else {
            self.errors.outdated = true;
        }
    }

    fn write_bus_text(&mut self) {
        let (now, frames) = (self.now, self.counters.frames);
        self.errors.outdated = false;
        self.errors.worded = now;
        let Some(confidence) = self.errors.rate.confidence(frames) else { return };
        if let Some(finding) = self.conflicts.cases_mut().judge_errors(now, None, confidence) {
            let summary = self.errors.rate.summary(now, frames);
            (finding.text, finding.remedy) = finding_text::bus_errors(&summary);
        }
    }

    /// How long an answer may take, on a busy and slow bus too, until its window closes.
    pub(in crate::discovery) fn response_window(&self) -> Instant {
        self.now + Duration::from_millis(200) + self.config.bit_time(180 * 150)
    }

    /// Closes windows that are over, and asks again where that shows more.
    pub(in crate::discovery) fn check_errors(&mut self) {
        let (now, frames) = (self.now, self.counters.frames);
        self.errors.frames = frames;
        let (device_table, asks) =
            (&mut self.device_table, self.local_node.held().is_some() && self.config.scan);
        self.errors.handle_timeout(now, |address, request, since| {
            // After a burst devices may begin anew, and answer nothing for some seconds.
            let Some(device) = device_table.current_device_mut(address) else { return false };
            let there = asks && device.is_present() && device.last_seen > since;
            if there {
                device.query_mut(request).schedule(now);
            }
            there
        });
        if self.errors.rate.handle_timeout(now, frames) {
            self.errors.outdated = false;
            self.conflicts.cases_mut().judge_errors(now, None, Confidence::Cleared);
        } else if self.errors.outdated && now >= self.errors.worded + WORDS {
            self.write_bus_text();
        }
        self.emit_bus_errors();
    }

    /// Tells who is named, or no more.
    pub(in crate::discovery) fn emit_bus_errors(&mut self) {
        let now = self.now;
        while let Some(verdict) = self.errors.verdicts.pop_front() {
            let (address, due, evidence) = match verdict {
                SuspectOutcome::Named(address, due, evidence) => (address, due, evidence),
                SuspectOutcome::Cleared(address) => {
                    self.conflicts.cases_mut().judge_errors(
                        now,
                        Some(address),
                        Confidence::Cleared,
                    );
                    continue;
                }
            };
            let name: Option<Name> =
                self.device_table.current_device(address).and_then(|device| device.name.clone());
            let suspected = Confidence::Suspected;
            let Some(finding) =
                self.conflicts.cases_mut().judge_errors(now, Some(address), suspected)
            else {
                continue;
            };
            if let Some(name) = &name {
                finding.add_name(name);
            }
            for piece in evidence {
                finding.add(piece);
            }
            finding_text::describe_errors_at(finding, address, due == Due::Heartbeat);
        }
    }

    pub(in crate::discovery) fn errors_timeout(&self) -> Option<Instant> {
        self.errors.poll_timeout(self.counters.frames)
    }
}

/// The one address whose heartbeat is due now, its last one, and when the next is overdue.
fn due_heartbeat(
    device_table: &DeviceTable,
    conflicts: &ConflictDetector,
    now: Instant,
    period: Duration,
) -> Option<(Address, Option<Frame>, Instant)> {
    let mut found = None;
    for device in device_table.devices() {
        let beats = &device.heartbeat;
        let (Some(last), Presence::Online) = (beats.last, device.presence) else { continue };
        let period = beats.period().unwrap_or(period);
        let jitter = beats.jitter().unwrap_or_default() * 3;
        let due = last + period;
        // A burst takes some milliseconds from the moment at which the heartbeat began.
        let early = due - (jitter + Duration::from_millis(2));
        let late = due + jitter + Duration::from_millis(30);
        if (early..=late).contains(&now) {
            if found.is_some() {
                return None;
            }
            let overdue = due + period.mul_f64(OVERDUE);
            found = Some((device.address, conflicts.last_heartbeat(device.address), overdue));
        }
    }
    found
}
