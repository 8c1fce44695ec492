//! Kinds of findings: one table with every fact about each of them.
//!
//! [`FindingKind::facts`] is the only place that lists name, headline, severity, remedy, grouping
//! and exit code; the screen, `scan`, `check` and the guide read it. A kind cannot be added without
//! its facts.

use std::fmt;

/// Everything that depends on the kind of a finding alone.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct FindingKindInfo {
    /// Name in JSON, in events and in the filter of the Problems page; stable across releases.
    pub name: &'static str,
    /// Severity from 0 to 100: the highest comes first on the Problems page and in reports.
    pub severity: u8,
    /// How the Problems page combines findings into problems.
    pub grouping: Grouping,
    /// Which commands exit with 1 for a confirmed finding.
    pub exit_code_of: ExitCodeScope,
    /// Texts of a finding about the bus, the file or, where `at_address` is `None`, an address.
    pub wording: Wording,
    /// Texts of a finding about one address, where they differ from `wording`.
    pub at_address: Option<Wording>,
}

/// Texts that a kind of finding has on the screen and in reports.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Wording {
    /// What is wrong, without address and names, which stand beside it.
    pub headline: &'static str,
    /// What to do, likeliest cause first. `{address}`, `{name}` and the like stand for values of
    /// the finding; a module that knows the cause may use a more exact text.
    pub remedy: &'static str,
    /// When a suspected finding is confirmed or cleared; `None` where it is confirmed at once.
    pub confirmation: Option<&'static str>,
}

/// How findings become rows of the Problems page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grouping {
    /// One problem for all findings about one address of a bus; a finding without an address is a
    /// problem of its own.
    Address,
    /// Each finding is a problem of its own.
    Single,
}

/// Commands that exit with 1 for a confirmed finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExitCodeScope {
    /// `scan` and `check`: a conflict, that is two devices where one should be.
    ScanAndCheck,
    /// `check` alone, which lists it in this section: file and bus differ, or the file is
    /// contradictory.
    Check(CheckSection),
    /// No command.
    Nothing,
}

/// Sections of the output of `check`, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckSection {
    /// Address conflicts and UID conflicts.
    Conflicts,
    /// Entries whose device is not on the bus.
    Missing,
    /// Devices at another address than the static one of their entry.
    WrongAddress,
    /// Static addresses used by another device.
    StaticAddressTaken,
    /// Devices without an entry.
    NotInFile,
    /// Devices with another name than the entry of their address.
    NameDiffers,
    /// Devices with other services than their entry.
    ServicesDiffer,
    /// Devices with settings that move them elsewhere at their next start.
    SettingsDiffer,
    /// Errors in the file itself.
    FileErrors,
}

impl CheckSection {
    /// All sections, in the order of the output.
    pub const ALL: [Self; 9] = [
        Self::Conflicts,
        Self::Missing,
        Self::WrongAddress,
        Self::StaticAddressTaken,
        Self::NotInFile,
        Self::NameDiffers,
        Self::ServicesDiffer,
        Self::SettingsDiffer,
        Self::FileErrors,
    ];

    /// Title of the section, without a colon.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Conflicts => "conflicts",
            Self::Missing => "missing",
            Self::WrongAddress => "wrong address",
            Self::StaticAddressTaken => "static address taken",
            Self::NotInFile => "not in file",
            Self::NameDiffers => "name differs",
            Self::ServicesDiffer => "services differ",
            Self::SettingsDiffer => "settings differ",
            Self::FileErrors => "file errors",
        }
    }

    /// Returns the title after the count of one.
    pub const fn singular(self) -> &'static str {
        match self {
            Self::Conflicts => "conflict",
            Self::FileErrors => "file error",
            Self::ServicesDiffer => "service list differs",
            other => other.title(),
        }
    }
}

impl Wording {
    /// Returns the remedy with the values of its placeholders, given as (name, value) pairs.
    ///
    /// # Panics
    ///
    /// In debug builds, if a placeholder has no value. In release builds it stays as it is.
    pub fn remedy_with(&self, values: &[(&str, &dyn fmt::Display)]) -> String {
        let mut text = String::new();
        let mut rest = self.remedy;
        while let Some((before, (name, after))) =
            rest.split_once('{').and_then(|(before, at)| Some((before, at.split_once('}')?)))
        {
            text.push_str(before);
            if let Some((_, value)) = values.iter().find(|(key, _)| *key == name) {
                text.push_str(&value.to_string());
            } else {
                debug_assert!(false, "no value for {{{name}}} in: {}", self.remedy);
                text.push_str(&rest[before.len()..rest.len() - after.len()]);
            }
            rest = after;
        }
        text + rest
    }
}

/// Confirmation hint of all conflicts.
const CONFLICT_CONFIRMATION: Option<&str> = Some(
    "Confirmed after five heartbeat periods; a reboot or a board swap looks the same at first.",
);
/// Remedy for two devices at one address.
const SEPARATE_DEVICES: &str = "Switch one of them off, then give the other one a free address.";
/// Confirmation hint of redundant tasks.
const TASK_CONFIRMATION: Option<&str> =
    Some("Confirmed after five seconds; after ten if a device was never heard.");
/// Confirmation hint of observations that are confirmed when repeated.
const SEEN_AGAIN: Option<&str> = Some("Seen once; confirmed when seen again.");

/// Makes the enum, the list of all kinds and the table of facts from one list.
macro_rules! finding_kinds {
    ($($(#[$doc:meta])+ $kind:ident: $facts:expr,)+) => {
        /// Kind of a finding. The order of the variants breaks ties between equal severities.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum FindingKind {
            $($(#[$doc])+ $kind,)+
        }

        impl FindingKind {
            /// All kinds, in the order of declaration.
            pub const ALL: &[Self] = &[$(Self::$kind,)+];

            /// Returns the facts about this kind.
            pub const fn facts(self) -> &'static FindingKindInfo {
                match self {
                    $(Self::$kind => {
                        const FACTS: FindingKindInfo = $facts;
                        &FACTS
                    })+
                }
            }
        }
    };
}

finding_kinds! {
    /// Two devices of one name use one address.
    SameNameSameAddress: FindingKindInfo {
        name: "same-name-same-address",
        severity: 100,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::ScanAndCheck,
        wording: Wording {
            headline: "address conflict (same name)",
            remedy: "Give one of them another address: switch one off, then move or pin the other away from {address}.",
            confirmation: CONFLICT_CONFIRMATION,
        },
        at_address: None,
    },
    /// Two devices of different names use one address.
    OneAddressTwoNames: FindingKindInfo {
        name: "one-address-two-names",
        severity: 100,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::ScanAndCheck,
        wording: Wording {
            headline: "address conflict (different names)",
            remedy: SEPARATE_DEVICES,
            confirmation: CONFLICT_CONFIRMATION,
        },
        at_address: None,
    },
    /// Heartbeats of one address alternate between two UIDs or two U bits.
    OneAddressTwoIdentities: FindingKindInfo {
        name: "one-address-two-identities",
        severity: 95,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::ScanAndCheck,
        wording: Wording {
            headline: "address conflict (alternating UIDs)",
            remedy: SEPARATE_DEVICES,
            confirmation: CONFLICT_CONFIRMATION,
        },
        at_address: None,
    },
    /// Each request to an address gets two equal responses, and heartbeats do not show two senders.
    AnswersDoubled: FindingKindInfo {
        name: "answers-doubled",
        severity: 90,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::ScanAndCheck,
        wording: Wording {
            headline: "two responses to each request",
            remedy: "Switch one off: if {address} still responds, there are two; give one another address. Otherwise check its firmware.",
            confirmation: CONFLICT_CONFIRMATION,
        },
        at_address: None,
    },
    /// Two addresses send heartbeats with the same DEV_CFG_UID. Two addresses are concerned, so it
    /// is not grouped by one of them.
    OneUidTwoAddresses: FindingKindInfo {
        name: "one-uid-two-addresses",
        severity: 95,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::ScanAndCheck,
        wording: Wording {
            headline: "UID conflict",
            remedy: "Give one of the two boards its own UID.",
            confirmation: CONFLICT_CONFIRMATION,
        },
        at_address: None,
    },
    /// A device other than the listed one uses an entry's static address.
    StaticAddressTaken: FindingKindInfo {
        name: "static-address-taken",
        severity: 80,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::StaticAddressTaken),
        wording: Wording {
            headline: "static address taken",
            remedy: "Pin {name} to another address, or move the other device.",
            confirmation: Some("Confirmed when the device sends its name."),
        },
        at_address: None,
    },
    /// A device uses another address than the static one of its entry.
    WrongAddress: FindingKindInfo {
        name: "wrong-address",
        severity: 75,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::WrongAddress),
        wording: Wording {
            headline: "wrong address",
            remedy: "Move the device to {static address}, or change the file to {address}.",
            confirmation: None,
        },
        at_address: None,
    },
    /// Two debug devices use address 0.
    TwoDebugDevices: FindingKindInfo {
        name: "two-debug-devices",
        severity: 90,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::ScanAndCheck,
        wording: Wording {
            headline: "two debug devices",
            remedy: "Quit one of the two tools, or give it another address.",
            confirmation: CONFLICT_CONFIRMATION,
        },
        at_address: None,
    },
    /// Two devices claimed an address, and one gave it up.
    AddressContested: FindingKindInfo {
        name: "address-contested",
        severity: 70,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "address was contested",
            remedy: "Pin addresses in des.json and in the devices to avoid contention at startup.",
            confirmation: Some("Stays suspected and clears by itself: one device gave up the address."),
        },
        at_address: None,
    },
    /// Two entries of des.json have one static address on one bus.
    FileDuplicateAddress: FindingKindInfo {
        name: "file-duplicate-address",
        severity: 60,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::FileErrors),
        wording: Wording {
            headline: "duplicate static address in file",
            remedy: "Give one of them another address.",
            confirmation: None,
        },
        at_address: None,
    },
    /// Two entries of des.json have one name and one address on one bus.
    FileDuplicateEntry: FindingKindInfo {
        name: "file-duplicate-entry",
        severity: 60,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::FileErrors),
        wording: Wording {
            headline: "duplicate entry in file",
            remedy: "Delete one of them from the file.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A value in des.json has the wrong type or range and is ignored.
    FileShape: FindingKindInfo {
        name: "file-shape",
        severity: 60,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::FileErrors),
        wording: Wording {
            headline: "invalid value in file",
            remedy: "Correct it in the file.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A listed device is not on the bus.
    Missing: FindingKindInfo {
        name: "missing",
        severity: 65,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::Missing),
        wording: Wording { headline: "missing", remedy: "{further reasons}", confirmation: None },
        at_address: None,
    },
    /// A device on the bus has no entry in des.json.
    Unlisted: FindingKindInfo {
        name: "unlisted",
        severity: 20,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::NotInFile),
        wording: Wording {
            headline: "not in the file",
            remedy: "Add it to the file, or remove it from the bus.",
            confirmation: None,
        },
        at_address: None,
    },
    /// An entry's device, matched by its UID, reports another name than the entry.
    NameDiffers: FindingKindInfo {
        name: "name-differs",
        severity: 55,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::NameDiffers),
        wording: Wording {
            headline: "name differs from file",
            remedy: "Rename the entry to {reported name}, or the device to {name}.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A device reports other services than its entry lists.
    ServicesDiffer: FindingKindInfo {
        name: "services-differ",
        severity: 50,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::ServicesDiffer),
        wording: Wording {
            headline: "services differ from file",
            remedy: "Add them to the file, or check the firmware.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A device is set to a fixed bit rate that is not that of the bus.
    FixedBitrateDiffers: FindingKindInfo {
        name: "fixed-bit-rate-differs",
        severity: 72,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::SettingsDiffer),
        wording: Wording {
            headline: "fixed bit rate differs from the bus",
            remedy: "Set it to the bit rate of the bus, or to a preferred one, before it restarts.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A device is set to a fixed address that is not the static one of its entry.
    FixedAddressDiffers: FindingKindInfo {
        name: "fixed-address-differs",
        severity: 58,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::SettingsDiffer),
        wording: Wording {
            headline: "fixed address differs from file",
            remedy: "Set the address of the device to {static address}, or change the file to {fixed address}.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A device has other services than another one of its type and major firmware version (CAN
    /// platform §3.2).
    TypeServicesDiffer: FindingKindInfo {
        name: "type-services-differ",
        severity: 52,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "services differ within a type",
            remedy: "Give one of the two firmwares another major version, or one of the devices another GID.",
            confirmation: None,
        },
        at_address: None,
    },
    /// All devices of a redundant task of the project fail.
    TaskFailed: FindingKindInfo {
        name: "task-failed",
        severity: 82,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::Missing),
        wording: Wording {
            headline: "no device does the task",
            remedy: "Check power, wiring and mode of each of them.",
            confirmation: TASK_CONFIRMATION,
        },
        at_address: None,
    },
    /// One device of a redundant task of the project fails, and another one works (CAN platform
    /// §3.1.4).
    RedundancyLost: FindingKindInfo {
        name: "redundancy-lost",
        severity: 62,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::Missing),
        wording: Wording {
            headline: "redundancy lost",
            remedy: "Repair the one that fails before the other one does.",
            confirmation: TASK_CONFIRMATION,
        },
        at_address: None,
    },
    /// A bus has another bit rate than the project says.
    BitrateDiffers: FindingKindInfo {
        name: "bit-rate-differs",
        severity: 83,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::SettingsDiffer),
        wording: Wording {
            headline: "bit rate differs from the project",
            remedy: "Set the interface to {project rate}, or correct descan.toml if the devices have {rate}.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A device has other services than the catalogue says of its type.
    CatalogueDiffers: FindingKindInfo {
        name: "catalogue-differs",
        severity: 51,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Check(CheckSection::ServicesDiffer),
        wording: Wording {
            headline: "not as its type in the catalogue",
            remedy: "Check its firmware, or correct the file of its type.",
            confirmation: Some("Stays suspected while only its name says which type it is: read its GID."),
        },
        at_address: None,
    },
    /// A device responds to reads of its descriptor with data that are no value of the field.
    MalformedDescriptor: FindingKindInfo {
        name: "malformed-descriptor",
        severity: 42,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "malformed descriptor",
            remedy: "Check the fields of its descriptor in its firmware, and their numbers in the profile.",
            confirmation: None,
        },
        at_address: None,
    },
    /// A device in CFG or BOOT sends requests (CAN platform §3.2.4.3).
    CfgSendsRequests: FindingKindInfo {
        name: "cfg-sends-requests",
        severity: 35,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "sends requests while it is configured",
            remedy: "Check its firmware: in CFG and BOOT a device sends responses and heartbeats alone.",
            confirmation: Some(
                "Confirmed by requests with U = 1; with U = 0 it may have worked between two heartbeats.",
            ),
        },
        at_address: None,
    },
    /// A device sends identifiers that are none of the nine message types (protocol §1.2, CAN
    /// platform §4.3).
    NonConforming: FindingKindInfo {
        name: "non-conforming",
        severity: 30,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "non-conforming identifiers",
            remedy: "Check its firmware's identifiers against CAN platform §4.3; another protocol on this bus looks the same.",
            confirmation: SEEN_AGAIN,
        },
        at_address: None,
    },
    /// A device sends DES responses that cannot be decoded, or aborts each of them.
    MalformedAnswer: FindingKindInfo {
        name: "malformed-answer",
        severity: 40,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "malformed responses",
            remedy: "Check how its firmware builds DES responses.",
            confirmation: SEEN_AGAIN,
        },
        at_address: None,
    },
    /// Frames arrive twice, of one address or of all: a gateway or a bridge repeats them (protocol
    /// §5.4).
    FramesRepeated: FindingKindInfo {
        name: "frames-repeated",
        severity: 45,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "frames repeated",
            remedy: "Look for a bridge or a gateway that connects this bus twice, or sends its frames back; of one address, also for a second board with the same random numbers.",
            confirmation: Some("Stays suspected; the copies count as no evidence of a conflict."),
        },
        at_address: None,
    },
    /// Frames were lost on this machine before descan read them.
    FramesLost: FindingKindInfo {
        name: "frames-lost",
        severity: 85,
        grouping: Grouping::Single,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "frames lost",
            remedy: "Reduce the load on this machine, or filter fewer identifiers.",
            confirmation: None,
        },
        at_address: None,
    },
    /// Bus errors (ISO 11898), of the bus as a whole or when one address sends. Two devices that
    /// send different bytes at one address cause them, so those are grouped by address.
    BusErrors: FindingKindInfo {
        name: "bus-errors",
        severity: 85,
        grouping: Grouping::Address,
        exit_code_of: ExitCodeScope::Nothing,
        wording: Wording {
            headline: "bus errors",
            remedy: "Check the bit rate of every device, both 120 Ω terminators, and the wiring; two devices at one address cause errors too.",
            confirmation: Some("Confirmed if more errors follow."),
        },
        at_address: Some(Wording {
            headline: "bus errors when it sends",
            remedy: "Switch it off: if {address} still responds, give that device another address. Otherwise check its transceiver and wiring.",
            confirmation: Some("Stays suspected: a faulty transceiver looks the same."),
        }),
    },
}

impl FindingKind {
    /// Returns the name in JSON.
    pub const fn name(self) -> &'static str {
        self.facts().name
    }

    /// Returns the headline of a finding that is not about one address alone.
    pub const fn headline(self) -> &'static str {
        self.facts().wording.headline
    }

    /// Returns the severity from 0 to 100, the highest first in lists.
    pub const fn severity(self) -> u8 {
        self.facts().severity
    }

    /// Returns true if it is a conflict: two devices where one should be. A confirmed one makes
    /// `scan` exit with 1.
    pub const fn is_conflict(self) -> bool {
        matches!(self.facts().exit_code_of, ExitCodeScope::ScanAndCheck)
    }

    /// Returns true if two devices may be the cause, where one should be: a conflict, and repeated frames.
    pub const fn may_be_conflict(self) -> bool {
        self.is_conflict() || matches!(self, Self::FramesRepeated)
    }

    /// Returns the section of `check` that lists a confirmed finding; `None` where it does not
    /// count for `check`.
    pub const fn check_section(self) -> Option<CheckSection> {
        match self.facts().exit_code_of {
            ExitCodeScope::ScanAndCheck => Some(CheckSection::Conflicts),
            ExitCodeScope::Check(section) => Some(section),
            ExitCodeScope::Nothing => None,
        }
    }
}

impl fmt::Display for FindingKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn facts_of_all_kinds_have_distinct_names_and_headlines() {
        let all = FindingKind::ALL;
        let names: BTreeSet<&str> = all.iter().map(|kind| kind.name()).collect();
        let headlines: BTreeSet<&str> = all.iter().map(|kind| kind.headline()).collect();
        assert_eq!((names.len(), headlines.len()), (all.len(), all.len()));
    }

    #[test]
    fn check_sections_are_all_used() {
        for section in CheckSection::ALL {
            assert!(
                FindingKind::ALL.iter().any(|kind| kind.check_section() == Some(section)),
                "{section:?}"
            );
        }
    }

    #[test]
    fn remedy_placeholders_take_values_as_they_are() {
        let wording = FindingKind::NameDiffers.facts().wording;
        assert_eq!(
            wording.remedy_with(&[("name", &"{reported name}"), ("reported name", &"B{}")]),
            "Rename the entry to B{}, or the device to {reported name}."
        );
    }
}
