//! What findings say to people: what is wrong, in a sentence, and what to do about it.
//!
//! Names no keys and no commands: `scan` prints these words as the screen shows them.

use super::finding::{Finding, FindingKind};
use crate::text::Name;
use crate::wire::id::Address;

/// What a frame of somebody else from our own address shows.
pub(super) const NOT_OURS: &str = "a frame from address 0 that we did not send";

/// Words a finding of the engine anew, after its evidence changed.
pub(super) fn describe(finding: &mut Finding) {
    let who = finding.key.address.map_or(String::new(), |address| who(address, &finding.names));
    let address = finding.key.address.map_or(0, Address::number);
    let list = finding.addresses.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
    let names = finding.names.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
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
            format!("Two devices share address {address}: {names} both answer from it."),
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
        FindingKind::BusErrors => (
            "The bus reports errors.".to_owned(),
            "Check the bit rate of every device, both 120 Ω terminators, and the wiring; two devices at one address cause errors too.".to_owned(),
        ),
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

/// "FEED at address 12", or "the device at address 12".
pub(super) fn who(address: Address, names: &[Name]) -> String {
    match names.first() {
        Some(name) => format!("{name} at address {address}"),
        None => format!("the device at address {address}"),
    }
}
