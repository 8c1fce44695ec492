//! Tests of devices, events and problems.
//!
//! Does not know how rows are made or shown.

use super::Filter;
use super::field::Field;
use super::test::{Test, TextValue, any_of};
use crate::app::buses::Buses;
use crate::app::notices::timeline::TimelineEntry;
use crate::app::problems::Problem;
use crate::app::timeline_kind::TimelineKind;
use crate::app::view::{Row, RowState};
use crate::app::{FileStatus, capture::decoded};
use crate::discovery::Device;
use crate::finding::FindingState;
use crate::frame::BusIndex;
use crate::wire::id::Address;
use crate::wire::node::Uid;

impl Filter {
    /// Returns true if a row of the Devices page matches.
    pub fn matches_row(&self, buses: &Buses, row: &Row) -> bool {
        let name = row.name.as_ref().map(ToString::to_string).unwrap_or_default();
        let at = |value: &TextValue| row.addresses(buses).any(|it| value.is_address(it));
        let on = row.bus.into_iter().chain(row.redundant_ids.iter().map(|id| id.bus));
        let on: Vec<&str> = on.filter_map(|bus| Some(&*buses.get(bus)?.name)).collect();
        let device = row.device(buses);
        let mode = device.and_then(|device| device.mode).map_or("", |mode| mode.name());
        let services = device.and_then(|device| device.services.as_deref()).unwrap_or_default();
        let service = |value: &TextValue| {
            let mut texts = services.iter().map(|it| (it.name.to_string(), it.version.to_string()));
            texts.any(|(name, version)| value.is_service(&name, &version))
        };
        let uid = |value: &TextValue| {
            if let (Some(board), Some(bus)) = (row.board, row.bus) {
                return value.is_in(&text_of(buses, bus, board.sender.uid));
            }
            let mut uids = row.devices(buses).flat_map(|it| uids_of(buses, it));
            uids.any(|uid| value.is_in(&uid))
        };
        self.is_match(|test| match test {
            Test::Word(word) => {
                word.is_in(&name)
                    || at(word)
                    || has_state(row.state, |own| own.eq_ignore_ascii_case(&word.text))
                    || mode.eq_ignore_ascii_case(&word.text)
                    || on.iter().any(|bus| bus.eq_ignore_ascii_case(&word.text))
                    || service(word)
                    || (!word.text.is_empty() && uid(word))
                    || (word.text == "new" && row.file == FileStatus::New)
                    || (word.text == "twin" && row.twin)
            }
            Test::Address(set) => row.addresses(buses).any(|it| set.contains(it)),
            Test::Text(field, values) => any_of(values, |value| match field {
                Field::Device => value.is_in(&name) || at(value),
                Field::Name => value.is_in(&name),
                Field::Service => service(value),
                Field::Bus => on.iter().any(|bus| value.is_in(bus)),
                Field::Mode => value.begins(mode),
                Field::Uid => uid(value),
                Field::State => {
                    has_state(row.state, |own| value.is_in(own))
                        || (row.suspected && value.begins("suspected"))
                        || (row.file == FileStatus::New && value.begins("new"))
                        || (row.twin && value.begins("twin"))
                }
                _ => false,
            }),
            Test::Error => row.state == RowState::Conflict || row.suspected,
            _ => false,
        })
    }

    /// Returns true if a line of the timeline matches.
    pub fn matches_entry(&self, buses: &Buses, entry: &TimelineEntry) -> bool {
        self.matches_entry_of(buses, entry, &[])
    }

    /// Returns true if a line of the timeline matches that concerns the addresses `others` too.
    pub(in crate::app) fn matches_entry_of(
        &self,
        buses: &Buses,
        entry: &TimelineEntry,
        others: &[Address],
    ) -> bool {
        let name = || entry.device_name(buses).map(ToString::to_string).unwrap_or_default();
        let bus = || entry.bus.and_then(|bus| buses.get(bus)).map_or("", |bus| &bus.name);
        let device = || buses.device(entry.device?);
        let at = |value: &TextValue| {
            others.iter().chain(&entry.address).any(|address| value.is_address(*address))
        };
        self.is_match(|test| match test {
            Test::Word(word) => {
                word.is_in(&name())
                    || entry.other_names.iter().any(|it| word.is_in(&it.to_string()))
                    || entry.address.is_some_and(|address| word.is_address(address))
                    || entry.events.iter().any(|event| word.begins(event))
                    || entry.kind.state_word() == Some(&word.text)
                    || entry.finding.is_some_and(|kind| word.is_in(kind.name()))
            }
            Test::Address(set) => others.iter().chain(&entry.address).any(|it| set.contains(*it)),
            Test::Text(field, values) => any_of(values, |value| match field {
                Field::Text => value.is_in(&entry.text),
                Field::Type => entry.finding.is_some_and(|kind| value.is_kind(kind)),
                Field::Bus => value.is_in(bus()),
                Field::Name => {
                    value.is_in(&name())
                        || entry.other_names.iter().any(|it| value.is_in(&it.to_string()))
                }
                Field::Device => value.is_in(&name()) || at(value),
                Field::State => {
                    entry.kind.state_word().is_some_and(|state| value.begins(state))
                        || entry.events.iter().any(|event| value.begins(event))
                        || (entry.kind == TimelineKind::File
                            && ["tx", "ours", "own"].iter().any(|word| value.begins(word)))
                }
                Field::Mode => entry.mode.is_some_and(|mode| value.begins(mode.name())),
                Field::Uid => {
                    device().is_some_and(|it| uids_of(buses, it).any(|uid| value.is_in(&uid)))
                }
                _ => false,
            }),
            Test::Since(bound) => bound.is_since(entry.last),
            Test::Until(bound) => bound.is_until(entry.time),
            Test::Error => matches!(entry.kind, TimelineKind::Confirmed | TimelineKind::Error),
            Test::ByDescan => entry.kind == TimelineKind::File,
            Test::Id(_) | Test::Length(_) | Test::Interval(_) | Test::Data(_) => false,
        })
    }

    /// Returns true if a problem matches.
    pub fn matches_problem(&self, buses: &Buses, problem: &Problem) -> bool {
        let bus = || problem.bus().and_then(|bus| buses.get(bus)).map_or("", |bus| &bus.name);
        let state = problem.state();
        let at = |value: &TextValue| problem.addresses().iter().any(|it| value.is_address(*it));
        let named =
            |value: &TextValue| problem.names().iter().any(|it| value.is_in(&it.to_string()));
        let kind = |value: &TextValue| {
            value.is_in(&problem.headline())
                || problem.findings.iter().any(|finding| value.is_kind(finding.key.kind))
        };
        let uid = |value: &TextValue| {
            let mut all = problem.findings.iter().flat_map(|finding| &finding.uids);
            all.any(|seen| value.is_in(&seen.text.to_string()))
        };
        self.is_match(|test| match test {
            Test::Word(word) => {
                kind(word)
                    || word.is_in(state.name())
                    || (problem.is_muted && word.text == "muted")
                    || named(word)
                    || at(word)
                    || uid(word)
            }
            Test::Address(set) => problem.addresses().iter().any(|it| set.contains(*it)),
            Test::Text(field, values) => any_of(values, |value| match field {
                Field::Name => named(value),
                Field::Device => named(value) || at(value),
                Field::Type => kind(value),
                Field::Text => problem.findings.iter().any(|finding| value.is_in(&finding.text)),
                Field::State => {
                    value.begins(state.name()) || (problem.is_muted && value.begins("muted"))
                }
                Field::Bus => value.is_in(bus()),
                Field::Uid => uid(value),
                _ => false,
            }),
            Test::Since(bound) => bound.is_since(problem.since()),
            Test::Until(bound) => bound.is_until(problem.since()),
            Test::Error => state == FindingState::Confirmed,
            Test::ByDescan | Test::Id(_) | Test::Length(_) | Test::Interval(_) | Test::Data(_) => {
                false
            }
        })
    }
}

/// Texts of the UIDs of a device.
fn uids_of<'a>(buses: &'a Buses, device: &'a Device) -> impl Iterator<Item = String> + 'a {
    buses.uids_of(device).into_iter().map(|uid| text_of(buses, device.id.bus, uid))
}

fn text_of(buses: &Buses, bus: BusIndex, uid: Uid) -> String {
    decoded::uid_text(&buses.profile(bus), uid)
}

/// Returns true if `fits` accepts the shown word of a row's state or its alias.
fn has_state(state: RowState, fits: impl Fn(&str) -> bool) -> bool {
    let alias = match state {
        RowState::Conflict => "clash",
        RowState::Partial => "partly",
        RowState::Unknown => "unseen",
        RowState::Pending => "awaited",
        RowState::Duplicate => "again",
        _ => return fits(state.word()),
    };
    fits(state.word()) || fits(alias)
}
