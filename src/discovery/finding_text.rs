//! What findings say to people: what is wrong, in a sentence, and what to do about it.
//!
//! Names no keys and no commands: `scan` prints these words as the screen shows them.

use super::errors::{BusErrorSummary, Cause};
use super::finding::{Finding, FindingKind};
use crate::error_report::Violation;
use crate::text::Name;
use crate::wire::id::Address;

/// What a frame of somebody else from our own address shows.
pub(super) const NOT_SENT_BY_DESCAN: &str = "frame from address 0 not sent by descan";

/// Words a finding of the engine anew, after its evidence changed.
pub(super) fn describe(finding: &mut Finding) {
    let who =
        finding.key.address.map_or(String::new(), |address| device_label(address, &finding.names));
    let address = finding.key.address.map_or(0, Address::number);
    let list = finding.addresses.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
    let called = |name: &Name| name.quoted().to_string();
    let names = finding.names.iter().map(called).collect::<Vec<_>>().join(" and ");
    let (text, remedy) = match finding.key.kind {
        FindingKind::SameNameSameAddress => (
            if finding.names.is_empty() {
                format!("Two indistinguishable devices use address {address}.")
            } else {
                format!("Two devices answer as {who}.")
            },
            format!(
                "Give one of them another address: switch one off, then move or pin the other away from {address}."
            ),
        ),
        FindingKind::OneAddressTwoNames => (
            match finding.names.as_slice() {
                [] | [_] => format!(
                    "Two devices share address {address}: {who} and a device with another name respond."
                ),
                _ => format!("Two devices share address {address}: {names} both respond."),
            },
            "Switch one of them off, then give it a free address.".to_owned(),
        ),
        FindingKind::OneAddressTwoIdentities => (
            format!("Two devices share address {address}: heartbeats alternate between two UIDs."),
            "Switch one of them off, then give it a free address.".to_owned(),
        ),
        FindingKind::OneUidTwoAddresses => (
            format!("Addresses {list} send heartbeats with the same DEV_CFG_UID (must be unique per bus)."),
            "Give one of the two boards its own UID.".to_owned(),
        ),
        FindingKind::TwoDebugDevices if !concerns_own_address(finding) => (
            "Two debug devices use address 0: heartbeats alternate between two UIDs.".to_owned(),
            "Quit one of the two tools, or give it another address.".to_owned(),
        ),
        FindingKind::TwoDebugDevices => (
            "Another debug device uses address 0, too.".to_owned(),
            "No action needed: descan moves to another address. Or quit the other tool.".to_owned(),
        ),
        FindingKind::AddressContested => (
            format!("Two devices claimed address {address}; one gave it up."),
            "Pin addresses in des.json and in the devices to avoid contention at startup.".to_owned(),
        ),
        FindingKind::NonConforming => (
            format!("{who} sends identifiers with an unknown message type."),
            "Check its firmware's identifiers against section 4.3; another protocol on this bus looks the same.".to_owned(),
        ),
        FindingKind::MalformedAnswer => {
            (finding.text.clone(), "Check how its firmware builds DES responses.".to_owned())
        }
        FindingKind::FramesLost => (
            format!("{} frames lost before reading: a device shown as missing may be present.", finding.count),
            "Reduce the load on this machine, or filter fewer identifiers.".to_owned(),
        ),
        _ => return,
    };
    finding.text = text;
    finding.remedy = remedy;
}

/// Whether it came up because of an address that was ours.
fn concerns_own_address(finding: &Finding) -> bool {
    finding.evidence.iter().any(|piece| piece.what == NOT_SENT_BY_DESCAN)
}

/// What is wrong with a bus on which frames break, and what to do about it.
pub(super) fn bus_errors(summary: &BusErrorSummary) -> (String, String) {
    let rate = match summary.rate {
        rate if rate < 9.95 => format!("{rate:.1}"),
        rate => format!("{rate:.0}"),
    };
    let share = match summary.share * 100.0 {
        share if share < 1.0 => "less than 1 %".to_owned(),
        share => format!("{share:.0} %"),
    };
    let (text, remedy) = match summary.cause {
        Cause::BusOff => (
            "The controller is bus-off: too many transmit errors.".to_owned(),
            "Check its bit rate and the wiring, then restart the interface.",
        ),
        Cause::NoAcknowledge => (
            format!("No ACK for descan's frames: {rate} failed attempts/s."),
            "Check the plug, that another device is on, and that the bit rate matches.",
        ),
        Cause::Wires => (
            "The transceiver reports a wiring fault.".to_owned(),
            "Check CAN_H and CAN_L for a break or a short, to each other, to ground and to supply.",
        ),
        Cause::OwnFrames => (
            format!("Bus errors while sending: {rate}/s, {share} of all frames."),
            "Check descan's wiring and bit rate; another debug device at the same address has the same effect.",
        ),
        Cause::Broken(violation) => {
            let how = match violation {
                Some(Violation::Bit) => ", mostly bit errors",
                Some(Violation::Stuff) => ", mostly stuff errors",
                Some(Violation::Form) => ", mostly form errors",
                None => "",
            };
            (
                format!("Bus errors: {rate}/s, {share} of all frames{how}."),
                "Check the bit rate of every device, both 120 Ω terminators, and the wiring; two devices at one address cause errors too.",
            )
        }
    };
    (text, remedy.to_owned())
}

/// What is wrong at an address whose frames break, and what to do about it.
pub(super) fn errors_at(address: Address, names: &[Name], heartbeat: bool) -> (String, String) {
    let who = device_label(address, names);
    let what = if heartbeat { "should send its heartbeat" } else { "should respond" };
    (
        format!(
            "Bus errors occur when {who} {what}: two devices at that address, or a faulty transceiver."
        ),
        format!(
            "Switch it off: if {address} still responds, give that device another address. Otherwise check its transceiver and wiring."
        ),
    )
}

/// "FEED at address 12", or "the device at address 12".
pub(super) fn device_label(address: Address, names: &[Name]) -> String {
    match names.first() {
        Some(name) => format!("{} at address {address}", name.quoted()),
        None => format!("the device at address {address}"),
    }
}
