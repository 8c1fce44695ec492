//! Tests of the rows of a fleet: gateways, versions, and devices and findings as they were published.
//!
//! A test of a gateway passes where one of its devices has what the field says; two terms may be about
//! two devices. Does not know how rows are made or shown.

use super::Filter;
use super::field::Field;
use super::test::{Test, TextValue, any_of};
use crate::app::fleet_screen::{FleetDevice, FleetProblem, GatewayFacts, VersionRow};
use crate::fleet::{GatewayName, GatewayState};
use crate::inventory::InventoryDevice;
use crate::wire::id::Address;

impl Filter {
    /// Returns true if a gateway matches.
    pub fn matches_gateway(
        &self,
        name: &GatewayName,
        state: GatewayState,
        facts: &GatewayFacts,
    ) -> bool {
        let bus = |value: &TextValue| facts.buses.iter().any(|bus| value.is_in(&bus.name));
        let named = |value: &TextValue| facts.names.iter().any(|it| value.is_in(it));
        let uid = |value: &TextValue| facts.uids.iter().any(|it| value.is_in(it));
        let at = |value: &TextValue| facts.addresses().any(|it| value.is_address(it));
        let service = |value: &TextValue| {
            facts.services().any(|(name, version, _)| value.is_service(name, version))
        };
        self.is_match(|test| match test {
            Test::Word(word) => {
                word.is_in(name.as_str())
                    || state.name() == word.text
                    || bus(word)
                    || named(word)
                    || service(word)
                    || uid(word)
            }
            Test::Address(set) => facts.addresses().any(|it| set.contains(it)),
            Test::Text(field, values) => any_of(values, |value| match field {
                Field::Name => named(value),
                Field::Device => named(value) || at(value),
                Field::Service => service(value),
                Field::Bus => bus(value),
                Field::Mode => facts.modes.iter().any(|mode| value.begins(mode)),
                Field::Uid => uid(value),
                Field::State => {
                    value.begins(state.name())
                        || (facts.conflicts > 0 && value.begins("conflict"))
                        || (facts.suspected > 0 && value.begins("suspected"))
                }
                _ => false,
            }),
            Test::Error => facts.confirmed > 0 || facts.has_file_error(),
            _ => false,
        })
    }

    /// Returns true if a version of a service matches.
    pub fn matches_version(&self, row: &VersionRow) -> bool {
        self.is_match(|test| match test {
            Test::Word(word) => {
                word.is_service(&row.service, &row.version) || word.is_in(&row.version)
            }
            Test::Text(Field::Service, values) => {
                any_of(values, |value| value.is_service(&row.service, &row.version))
            }
            _ => false,
        })
    }

    /// Returns true if a device matches, as its gateway published it.
    pub fn matches_published_device(&self, row: &FleetDevice) -> bool {
        let device: &InventoryDevice = &row.device;
        let text = |part: &Option<String>| part.clone().unwrap_or_default();
        let (name, uid, mode) = (text(&device.name), text(&device.uid), text(&device.mode));
        let presence = text(&device.presence);
        let address = Address::new(device.address);
        let at = |value: &TextValue| address.is_some_and(|it| value.is_address(it));
        let services = device.services.as_deref().unwrap_or_default();
        let service =
            |value: &TextValue| services.iter().any(|it| value.is_service(&it.name, &it.version));
        self.is_match(|test| match test {
            Test::Word(word) => {
                word.is_in(&name)
                    || at(word)
                    || presence.eq_ignore_ascii_case(&word.text)
                    || mode.eq_ignore_ascii_case(&word.text)
                    || device.bus.eq_ignore_ascii_case(&word.text)
                    || service(word)
                    || word.is_in(&uid)
            }
            Test::Address(set) => address.is_some_and(|it| set.contains(it)),
            Test::Text(field, values) => any_of(values, |value| match field {
                Field::Name => value.is_in(&name),
                Field::Device => value.is_in(&name) || at(value),
                Field::Service => service(value),
                Field::Bus => value.is_in(&device.bus),
                Field::Mode => value.begins(&mode),
                Field::Uid => value.is_in(&uid),
                Field::State => {
                    value.is_in(&presence)
                        || (row.is_in_conflict && value.begins("conflict"))
                        || (row.is_suspected && value.begins("suspected"))
                }
                _ => false,
            }),
            Test::Error => row.is_in_conflict || row.is_suspected,
            _ => false,
        })
    }

    /// Returns true if a problem matches, as a gateway published its findings: each test for one of them.
    pub fn matches_finding(&self, problem: &FleetProblem) -> bool {
        let confidence = &problem.finding.confidence;
        let at = |value: &TextValue| problem.addresses().any(|it| value.is_address(it));
        let named = |value: &TextValue| {
            problem.findings().flat_map(|it| &it.names).any(|it| value.is_in(it))
        };
        let uid = |value: &TextValue| {
            problem.findings().flat_map(|it| &it.uids).any(|it| value.is_in(it))
        };
        let text = |value: &TextValue| problem.findings().any(|it| value.is_in(&it.text));
        let kind = |value: &TextValue| {
            problem.findings().any(|it| value.is_in(&it.kind))
                || problem.headlines().any(|it| value.is_in(it))
        };
        self.is_match(|test| match test {
            Test::Word(word) => {
                word.is_in(problem.gateway.as_str())
                    || kind(word)
                    || *confidence == word.text
                    || named(word)
                    || at(word)
                    || uid(word)
            }
            Test::Address(set) => problem.addresses().any(|it| set.contains(it)),
            Test::Text(field, values) => any_of(values, |value| match field {
                Field::Name => named(value),
                Field::Device => named(value) || at(value),
                Field::Type => kind(value),
                Field::Text => text(value),
                Field::State => value.begins(confidence),
                Field::Bus => value.is_in(&problem.bus),
                Field::Uid => uid(value),
                _ => false,
            }),
            Test::Error => problem.is_confirmed(),
            _ => false,
        })
    }
}
