//! What findings say to people: what is wrong, in a sentence, and what to do about it.
//!
//! Names no keys and no commands: `scan` prints these words as the screen shows them.

use super::errors::{Cause, Summary};
use super::finding::{Finding, FindingKind};
use crate::error_report::Violation;
use crate::text::Name;
use crate::wire::id::Address;

/// What a frame of somebody else from our own address shows.
pub(super) const NOT_OURS: &str = "a frame from address 0 that we did not send";

/// Words a finding of the engine anew, after its evidence changed.
pub(super) fn describe(finding: &mut Finding) {
    let who = finding.key.address.map_or(String::new(), |address| who(address, &finding.names));
    let address = finding.key.address.map_or(0, Address::number);
    let list = finding.addresses.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
    let called = |name: &Name| name.called().to_string();
    let names = finding.names.iter().map(called).collect::<Vec<_>>().join(" and ");
    let (text, remedy) = match finding.key.kind {
        FindingKind::SameNameSameAddress => (
            if finding.names.is_empty() {
                format!("Two devices send from address {address}, and nothing tells them apart.")
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
                    "Two devices share address {address}: {who} and one of another name answer from it."
                ),
                _ => format!("Two devices share address {address}: {names} both answer from it."),
            },
            "Switch one of them off, then give it a free address.".to_owned(),
        ),
        FindingKind::OneAddressTwoIdentities => (
            format!("Two devices share address {address}: heartbeats of two identities take turns."),
            "Switch one of them off, then give it a free address.".to_owned(),
        ),
        FindingKind::OneUidTwoAddresses => (
            format!("Addresses {list} beat with the same DEV_CFG_UID, which must be unique on a bus."),
            "Give one of the two boards a UID of its own.".to_owned(),
        ),
        FindingKind::TwoDebugDevices if !is_about_us(finding) => (
            "Two debug devices use address 0: heartbeats of two identities take turns.".to_owned(),
            "End one of the two tools, or give it another address.".to_owned(),
        ),
        FindingKind::TwoDebugDevices => (
            "Another debug device uses address 0, as we did.".to_owned(),
            "Nothing to do: we take another address; or end the other tool.".to_owned(),
        ),
        FindingKind::AddressContested => (
            format!("Two devices contended for address {address}, until one gave way."),
            "Pin addresses in des.json and in the devices, so that they do not meet at start.".to_owned(),
        ),
        FindingKind::NonConforming => (
            format!("{who} sends identifiers that are none of the nine message types."),
            "Check its firmware's identifiers against section 4.3; a foreign protocol on this bus looks the same.".to_owned(),
        ),
        FindingKind::MalformedAnswer => {
            (finding.text.clone(), "Check how its firmware builds DES answers.".to_owned())
        }
        FindingKind::FramesLost => (
            format!("{} frames were lost before they could be read: what is missing here may be there.", finding.count),
            "Close what else loads this machine, or watch fewer identifiers.".to_owned(),
        ),
        _ => return,
    };
    finding.text = text;
    finding.remedy = remedy;
}

/// Whether it came up because of an address that was ours.
fn is_about_us(finding: &Finding) -> bool {
    finding.evidence.iter().any(|piece| piece.what == NOT_OURS)
}

/// What is wrong with a bus on which frames break, and what to do about it.
pub(super) fn bus_errors(summary: &Summary) -> (String, String) {
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
            "Our controller has left the bus (bus-off): too many of its frames failed.".to_owned(),
            "Check our bit rate and the wiring, then restart the interface.",
        ),
        Cause::NoAcknowledge => (
            format!("Nobody acknowledges our frames: {rate} attempts a second fail."),
            "Check the plug, that another device is on, and that our bit rate is the bus's.",
        ),
        Cause::Wires => (
            "The transceiver reports a fault of the wires.".to_owned(),
            "Check CAN_H and CAN_L for a break or a short, to each other, to ground and to supply.",
        ),
        Cause::OwnFrames => (
            format!("Frames of ours break: {rate} a second, {share} of all."),
            "Check our wiring and our bit rate; another debug device at our address does the same.",
        ),
        Cause::Broken(violation) => {
            let how = match violation {
                Some(Violation::Bit) => ", most of them with bit errors",
                Some(Violation::Stuff) => ", most of them with stuff errors",
                Some(Violation::Form) => ", most of them with form errors",
                None => "",
            };
            (
                format!("Frames break on the bus: {rate} a second, {share} of all{how}."),
                "Check the bit rate of every device, both 120 Ω terminators, and the wiring; two devices at one address cause errors too.",
            )
        }
    };
    (text, remedy.to_owned())
}

/// What is wrong at an address whose frames break, and what to do about it.
pub(super) fn errors_at(address: Address, names: &[Name], heartbeat: bool) -> (String, String) {
    let who = who(address, names);
    let what = if heartbeat { "should send its heartbeat" } else { "should answer" };
    (
        format!(
            "The bus breaks frames just when {who} {what}: two devices there that send different bytes do that, or its transceiver."
        ),
        format!(
            "Switch it off: if something still answers from {address}, give that another address. Otherwise check its transceiver and wiring."
        ),
    )
}

/// "FEED at address 12", or "the device at address 12".
pub(super) fn who(address: Address, names: &[Name]) -> String {
    match names.first() {
        Some(name) => format!("{} at address {address}", name.called()),
        None => format!("the device at address {address}"),
    }
}
