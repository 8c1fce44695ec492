//! Text and remedy of the findings that the engine raises. Input: a finding with its evidence;
//! output: one sentence each.
//!
//! Names no keys and no commands, because `scan` prints the same text as the screen. Remedies that
//! do not depend on the cause stand in the table of [`FindingKind`].

use super::conflicts::repeated_frames::{DelayRange, MAX_FORWARDING_DELAY, RepeatedFrames};
use super::errors::{BusErrorSummary, Cause};
use crate::error_report::BusErrorType;
use crate::finding::{Finding, FindingKind, SeenUid};
use crate::text::Name;
use crate::wire::id::Address;

/// Description of the evidence for another node at descan's own address.
pub(super) const NOT_SENT_BY_DESCAN: &str = "frame from address 0 not sent by descan";

/// Number of UIDs of a finding that are stored; there may be more.
const MAX_UIDS: usize = 8;

/// Number of names that a text lists.
const SHOWN_NAMES: usize = 4;

/// Number of addresses that a text lists.
const LISTED_ADDRESSES: usize = 4;

/// Difference in ms between the delays of copies from which on the text has both.
const SHOWN_DELAY_JITTER: f64 = 10.0;

/// Sets text and remedy of a finding of the engine, after its evidence changed; `is_certain`: a
/// single device that sends its frames twice does not explain it. Bus errors have
/// [`bus_errors`] and [`describe_errors_at`] instead; findings about des.json are worded where they
/// are made.
pub(super) fn describe(finding: &mut Finding, is_certain: bool) {
    finding.excludes_one_device = is_certain;
    let device =
        finding.key.address.map_or(String::new(), |address| device_label(address, &finding.names));
    let address = finding.key.address.map_or(0, Address::number);
    let list = finding.addresses.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
    let quoted = |name: &Name| name.quoted().to_string();
    let names = finding.names.iter().map(quoted).collect::<Vec<_>>().join(" and ");
    let uids = finding.uids.iter().map(SeenUid::label).collect::<Vec<_>>();
    let devices = match uids.len() {
        0..=2 => "Two devices".to_owned(),
        count if count == MAX_UIDS => format!("{count} or more devices"),
        count => format!("{count} devices"),
    };
    let uids = match &uids[..] {
        [] => "two UIDs".to_owned(),
        [only] => only.clone(),
        [before @ .., newest] => format!("the UIDs {} and {newest}", before.join(", ")),
    };
    let concerns_own_address = concerns_own_address(finding);
    finding.text = match finding.key.kind {
        FindingKind::SameNameSameAddress if finding.names.is_empty() => {
            let other = if is_certain || finding.uids.len() > 1 {
                ""
            } else {
                ", or one that sends its heartbeats twice"
            };
            format!("Two indistinguishable devices use address {address}{other}.")
        }
        FindingKind::SameNameSameAddress if is_certain || finding.uids.len() > 1 => {
            format!("Two devices answer as {device}.")
        }
        FindingKind::SameNameSameAddress => {
            format!("Two devices answer as {device}, or one that sends its heartbeats twice.")
        }
        FindingKind::AnswersDoubled => format!(
            "Each request to {device} gets two responses: two equal devices, or one that responds twice."
        ),
        FindingKind::OneAddressTwoNames => match finding.names.as_slice() {
            [] | [_] => format!(
                "Two devices share address {address}: {device} and a device with another name respond."
            ),
            [_, _] => format!("Two devices share address {address}: {names} both respond."),
            all => {
                let mut shown: Vec<String> = all.iter().take(SHOWN_NAMES).map(quoted).collect();
                let end = match all.len().saturating_sub(SHOWN_NAMES) {
                    0 => shown.pop().unwrap_or_default(),
                    more => format!("{more} more"),
                };
                let shown = shown.join(", ");
                format!("Several devices share address {address}: {shown} and {end} respond.")
            }
        },
        FindingKind::OneAddressTwoIdentities if finding.uids.len() < 2 => format!(
            "Two devices share address {address}: heartbeats alternate between working and non-working."
        ),
        FindingKind::OneAddressTwoIdentities => {
            format!("{devices} share address {address}: heartbeats alternate between {uids}.")
        }
        FindingKind::OneUidTwoAddresses if !finding.uids.is_empty() => {
            format!("Addresses {list} send heartbeats with one DEV_CFG_UID: {uids}.")
        }
        FindingKind::OneUidTwoAddresses => format!(
            "Addresses {list} send heartbeats with the same DEV_CFG_UID (must be unique per bus)."
        ),
        FindingKind::TwoDebugDevices if concerns_own_address => {
            "Another debug device uses address 0, too.".to_owned()
        }
        FindingKind::TwoDebugDevices => {
            format!("Two debug devices use address 0: heartbeats alternate between {uids}.")
        }
        FindingKind::AddressContested => {
            format!("Two devices claimed address {address}; one gave it up.")
        }
        FindingKind::NonConforming => {
            format!("{device} sends identifiers with an unknown message type.")
        }
        FindingKind::CfgSendsRequests => {
            format!("{device} sends requests in CFG or BOOT, where it only responds.")
        }
        // The detector writes the text, which has the fault or the delay in it.
        FindingKind::MalformedAnswer | FindingKind::FramesRepeated => {
            std::mem::take(&mut finding.text)
        }
        FindingKind::FramesLost => format!(
            "{} frame{} lost before reading: a device shown as missing may be present.",
            finding.count,
            if finding.count == 1 { "" } else { "s" }
        ),
        FindingKind::BusErrors
        | FindingKind::StaticAddressTaken
        | FindingKind::WrongAddress
        | FindingKind::FileDuplicateAddress
        | FindingKind::FileDuplicateEntry
        | FindingKind::FileShape
        | FindingKind::Missing
        | FindingKind::Unlisted
        | FindingKind::NameDiffers
        | FindingKind::ServicesDiffer
        | FindingKind::MalformedDescriptor
        | FindingKind::FixedBitrateDiffers
        | FindingKind::FixedAddressDiffers
        | FindingKind::TypeServicesDiffer
        | FindingKind::CatalogueDiffers
        | FindingKind::TaskFailed
        | FindingKind::RedundancyLost
        | FindingKind::BitrateDiffers => return,
    };
    finding.remedy = if finding.key.kind == FindingKind::TwoDebugDevices && concerns_own_address {
        "No action needed: descan moves to another address. Or quit the other tool.".to_owned()
    } else {
        finding.key.wording().remedy_with(&[("address", &address)])
    };
}

/// Returns true if the finding is about descan's own address.
fn concerns_own_address(finding: &Finding) -> bool {
    finding.evidence.iter().any(|evidence| evidence.description == NOT_SENT_BY_DESCAN)
}

/// Text of bus errors while the controller is bus-off.
const BUS_OFF: &str = "The controller is bus-off: too many transmit errors.";
/// The same since it is on the bus again.
const WAS_BUS_OFF: &str =
    "The controller was bus-off: too many transmit errors. It is on the bus again.";
/// What helps against it then.
const WAS_BUS_OFF_REMEDY: &str = "Check its bit rate and the wiring.";

/// Changes text and remedy of bus errors that are over: the controller is not bus-off any more.
pub(super) fn end_bus_off(finding: &mut Finding) {
    if finding.text == BUS_OFF {
        WAS_BUS_OFF.clone_into(&mut finding.text);
        WAS_BUS_OFF_REMEDY.clone_into(&mut finding.remedy);
    }
}

/// Returns text and remedy of bus errors that concern the bus as a whole.
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
        Cause::BusOff => {
            (BUS_OFF.to_owned(), "Check its bit rate and the wiring, then restart the interface.")
        }
        Cause::WasBusOff => (WAS_BUS_OFF.to_owned(), WAS_BUS_OFF_REMEDY),
        Cause::NoAck => (
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
        Cause::BusError(violation) => {
            let how = match violation {
                Some(BusErrorType::Bit) => ", mostly bit errors",
                Some(BusErrorType::Stuff) => ", mostly stuff errors",
                Some(BusErrorType::Form) => ", mostly form errors",
                None => "",
            };
            (
                format!("Bus errors: {rate}/s, {share} of all frames{how}."),
                FindingKind::BusErrors.facts().wording.remedy,
            )
        }
    };
    (text, remedy.to_owned())
}

/// Sets text and remedy of bus errors when `address` sends: its heartbeat, if `heartbeat`, else its
/// responses.
pub(super) fn describe_errors_at(finding: &mut Finding, address: Address, heartbeat: bool) {
    let device = device_label(address, &finding.names);
    let what = if heartbeat { "should send its heartbeat" } else { "should respond" };
    finding.text = format!(
        "Bus errors occur when {device} {what}: two devices at that address, or a faulty transceiver."
    );
    finding.remedy = finding.key.wording().remedy_with(&[("address", &address)]);
}

/// Returns "FEED at address 12", or "the device at address 12" without a name.
pub(super) fn device_label(address: Address, names: &[Name]) -> String {
    match names.first() {
        Some(name) => format!("{} at address {address}", name.quoted()),
        None => format!("the device at address {address}"),
    }
}

/// Returns the text of repeated frames.
pub(super) fn repeated(repeated: &RepeatedFrames) -> String {
    let RepeatedFrames { addresses, delays: DelayRange { shortest, longest }, .. } = repeated;
    let (from, to) = (shortest.as_secs_f64() * 1000.0, longest.as_secs_f64() * 1000.0);
    let apart = if to - from > SHOWN_DELAY_JITTER {
        format!("{from:.0} to {to:.0} ms apart")
    } else {
        format!("{from:.0} ms apart")
    };
    let whose = match addresses[..] {
        [] => "All frames".to_owned(),
        [address] => format!("Frames from address {address}"),
        [ref first @ .., last] if addresses.len() <= LISTED_ADDRESSES => {
            let first: Vec<String> = first.iter().map(ToString::to_string).collect();
            format!("Frames from addresses {} and {last}", first.join(", "))
        }
        _ => format!("Frames from {} addresses", addresses.len()),
    };
    let is_late = repeated.usual_delay > MAX_FORWARDING_DELAY;
    let or = match (addresses.len(), is_late) {
        (1, true) => "two boards with equal random numbers, or ",
        (1, false) => "sent twice, or ",
        (_, true) => "two boards at each address with equal random numbers, or ",
        (_, false) => "",
    };
    let by = if addresses.is_empty() { "bridge" } else { "gateway" };
    let times = if repeated.is_further_copy { "more than twice" } else { "twice" };
    format!("{whose} arrive {times}, {apart}: {or}repeated by a {by}?")
}
