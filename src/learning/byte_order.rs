//! The byte order of the descriptor, by plausibility: versions and serial numbers are small, and
//! only some codes of processors are defined.
//!
//! Reads responses to the fields whose service numbers are known, since only these are what they seem.

use super::{Certainty, MAX_FRAMES, ProfileProposal};
use crate::frame::Frame;
use crate::text::counted;
use crate::wire::descriptor::{ByteOrder, DescriptorField, DescriptorValue};
use crate::wire::id::{Address, Header};
use crate::wire::profile::{Profile, ProfileKey, ProfileValue};

/// Fields with numbers of several bytes.
const FIELDS: [DescriptorField; 3] =
    [DescriptorField::Capabilities, DescriptorField::Firmware, DescriptorField::Serial];
/// Reads that wait for their responses. Bounds the memory.
const MAX_READS: usize = 32;
/// Devices whose responses are kept for a field. Bounds the memory.
const MAX_DEVICES: usize = 16;
/// Numbers from which a version, or a serial number, is not plausible: the other order makes a small
/// number at least that.
const IMPLAUSIBLE_VERSION: u16 = 256;
const IMPLAUSIBLE_SERIAL: u32 = 1 << 16;

/// Responses to reads of the descriptor.
#[derive(Clone, Debug, Default)]
pub(super) struct FieldResponses {
    /// The services of [`FIELDS`] that are known.
    services: [Option<u16>; FIELDS.len()],
    reads: Vec<(Address, Address, usize)>,
    /// The first response of each device, for each field.
    responses: [Vec<Frame>; FIELDS.len()],
}

impl FieldResponses {
    /// Takes the service numbers that are known; responses by other ones are forgotten.
    pub fn set_profile(&mut self, profile: &Profile) {
        let service = |field: DescriptorField| {
            let number = field.service(&profile.descriptor).number();
            profile.is_given(field.key()).then_some(number)
        };
        let services = FIELDS.map(service);
        if services != self.services {
            *self = Self { services, ..Self::default() };
        }
    }

    /// Takes a conforming frame.
    pub fn handle_frame(&mut self, frame: &Frame, header: Header) {
        if header.broadcast {
            return;
        }
        let number = header.service.number();
        let Some(at) = self.services.iter().position(|known| *known == Some(number)) else {
            return;
        };
        if !header.response {
            if frame.is_empty() && self.reads.len() < MAX_READS {
                self.reads.push((header.source, header.destination, at));
            }
            return;
        }
        let asked = (header.destination, header.source, at);
        let Some(read) = self.reads.iter().position(|read| *read == asked) else { return };
        self.reads.swap_remove(read);
        let of_device = |known: &Frame| {
            known.platform_id().map(Header::decode).is_some_and(|it| it.source == header.source)
        };
        let known = &mut self.responses[at];
        if header.no_error && known.len() < MAX_DEVICES && !known.iter().any(of_device) {
            known.push(*frame);
        }
    }

    /// Returns the order, if the responses are plausible in one alone.
    pub fn proposal(&self) -> Option<ProfileProposal> {
        let mut frames: [Vec<Frame>; 2] = [Vec::new(), Vec::new()];
        let mut codes = [0; 2];
        for (field, responses) in FIELDS.into_iter().zip(&self.responses) {
            for frame in responses {
                let [little, big] = ByteOrder::ALL.map(|order| is_plausible(field, frame, order));
                let order = match (little, big) {
                    (true, false) => 0,
                    (false, true) => 1,
                    _ => continue,
                };
                frames[order].push(*frame);
                codes[order] += u32::from(field == DescriptorField::Capabilities);
            }
        }
        let order = match (frames[0].len(), frames[1].len()) {
            (1.., 0) => 0,
            (0, 1..) => 1,
            _ => return None,
        };
        // Only two codes of processors are defined; versions and serial numbers may be large.
        let certainty = if codes[order] > 0 { Certainty::Likely } else { Certainty::Guess };
        let mut evidence = std::mem::take(&mut frames[order]);
        let count = counted(evidence.len() as u64, "response");
        let is_are = if evidence.len() == 1 { "is" } else { "are" };
        evidence.sort_by_key(|frame| frame.time);
        evidence.truncate(MAX_FRAMES);
        Some(ProfileProposal {
            key: ProfileKey::ByteOrder,
            value: ProfileValue::Text(ByteOrder::ALL[order].word().to_owned()),
            certainty,
            evidence: format!("{count} {is_are} plausible in this order alone"),
            frames: evidence,
        })
    }
}

/// Returns true if a response has a value that a device may well have.
fn is_plausible(field: DescriptorField, frame: &Frame, order: ByteOrder) -> bool {
    match DescriptorValue::decode(field, frame.data(), order) {
        Ok(DescriptorValue::Capabilities(able)) => able.cpu_name().is_some(),
        Ok(DescriptorValue::Firmware(version)) => {
            version.major < IMPLAUSIBLE_VERSION && version.minor < IMPLAUSIBLE_VERSION
        }
        Ok(DescriptorValue::Serial(serial)) => serial < IMPLAUSIBLE_SERIAL,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learn(frames: &[(u16, u8, &[u8])]) -> Option<(String, Certainty)> {
        let profile = Profile::parse("[descriptor]\nfw = 0x101\ncaps = 0x102\nsn = 0x103").unwrap();
        let mut responses = FieldResponses::default();
        responses.set_profile(&profile);
        for (service, address, data) in frames {
            let service = crate::wire::id::Service::new(*service).unwrap();
            let [tool, node] = [Address::DEBUG, Address::new(*address).unwrap()];
            let request = Header::request(tool, node, false, service);
            responses.handle_frame(&Frame::classic(request.encode(), &[]), request);
            let response = request.response(node, false);
            responses.handle_frame(&Frame::classic(response.encode(), data), response);
        }
        let proposal = responses.proposal()?;
        Some((proposal.value.to_string(), proposal.certainty))
    }

    #[test]
    fn order_is_that_in_which_all_is_plausible() {
        let little = ("\"little\"".to_owned(), Certainty::Likely);
        let big = |certainty| Some(("\"big\"".to_owned(), certainty));
        assert_eq!(
            learn(&[(0x102, 1, &[1, 1, 0, 0, 0]), (0x102, 2, &[3, 2, 0, 0, 0])]),
            Some(little)
        );
        assert_eq!(learn(&[(0x102, 1, &[1, 0, 1, 0, 0])]), big(Certainty::Likely));
        assert_eq!(learn(&[(0x101, 1, &[0, 2, 0, 1])]), big(Certainty::Guess));
        assert_eq!(learn(&[(0x103, 1, &[0, 0, 0x27, 0x3D])]), big(Certainty::Guess));
    }

    #[test]
    fn what_fits_both_orders_or_contradicts_shows_none() {
        // Version 0.0, a serial number of none, an unknown processor.
        assert_eq!(learn(&[(0x101, 1, &[0; 4]), (0x103, 1, &[0; 4]), (0x102, 1, &[0; 5])]), None);
        assert_eq!(learn(&[(0x101, 1, &[2, 0, 1, 0]), (0x101, 2, &[0, 2, 0, 1])]), None);
        // Of the wrong length, and of a service that is not known.
        assert_eq!(learn(&[(0x102, 1, &[1, 1, 0, 0]), (0x104, 2, &[1, 1, 0, 0, 0])]), None);
    }

    #[test]
    fn response_without_a_read_shows_nothing() {
        let mut responses = FieldResponses::default();
        responses.set_profile(&Profile::parse("descriptor.caps = 0x102").unwrap());
        let service = crate::wire::id::Service::new(0x102).unwrap();
        let node = Address::new(1).unwrap();
        let response = Header::request(Address::DEBUG, node, false, service).response(node, false);
        let frame = Frame::classic(response.encode(), &[1, 1, 0, 0, 0]);
        responses.handle_frame(&frame, response);
        assert_eq!(responses.proposal(), None);
    }
}
