//! The service of DES, and the framing of its responses.
//!
//! A request has the bytes `DES` in it; the service is known once one was answered with a name.

use super::{Certainty, MAX_FRAMES, ProfileProposal};
use crate::frame::Frame;
use crate::text::counted;
use crate::wire::des::{self, ReceivedRequest, Request};
use crate::wire::framing::{Framing, classify_request, classify_response, strip_raw_padding};
use crate::wire::id::{Address, Header, Service};
use crate::wire::isotp::Pci;
use crate::wire::profile::{ProfileKey, ProfileValue};

/// Services with requests that are kept.
const MAX_SERVICES: usize = 16;
/// Letters of a name in raw framing: a status and its value look like a name of one or two letters.
const MIN_RAW_NAME: usize = 3;
/// Letters of a name in ISO-TP, where the length has to fit, too.
const MIN_ISOTP_NAME: usize = 2;
/// Nodes with one framing that show it.
const MIN_NODES: usize = 2;

/// The services with requests of DES.
#[derive(Clone, Debug, Default)]
pub(super) struct DesServices {
    services: Vec<DesService>,
}

#[derive(Clone, Debug)]
struct DesService {
    service: Service,
    /// The first request.
    request: Frame,
    /// Responses with a name.
    names: u32,
    /// Names of nodes, by address.
    of_nodes: Vec<(Address, Vec<u8>)>,
    /// A node had several names: they are none.
    has_other_names: bool,
    /// The first of them.
    responses: Vec<Frame>,
    /// Nodes that responded in each framing, one bit each.
    isotp: u128,
    raw: u128,
}

impl DesServices {
    /// Takes a conforming frame.
    pub fn handle_frame(&mut self, frame: &Frame, header: Header) {
        if header.response {
            self.handle_response(frame, header);
        } else if let Some((_, message)) = classify_request(frame.data(), frame.is_fd)
            && let Some(ReceivedRequest::Known(Request::Name | Request::Services)) =
                Request::decode(message)
            && !self.services.iter().any(|known| known.service == header.service)
            && self.services.len() < MAX_SERVICES
        {
            self.services.push(DesService {
                service: header.service,
                request: *frame,
                names: 0,
                of_nodes: Vec::new(),
                has_other_names: false,
                responses: Vec::new(),
                isotp: 0,
                raw: 0,
            });
        }
    }

    fn handle_response(&mut self, frame: &Frame, header: Header) {
        let known = self.services.iter_mut().find(|known| known.service == header.service);
        let Some(known) = known.filter(|_| !header.broadcast && header.no_error && !frame.is_tx)
        else {
            return;
        };
        let Some(framing) = classify_response(frame.data(), frame.is_fd, false) else { return };
        let name = match framing {
            Framing::Raw => name_of(strip_raw_padding(frame.data()), MIN_RAW_NAME),
            Framing::Isotp => match Pci::decode(frame.data(), frame.is_fd) {
                Ok(Pci::Single(message)) => name_of(message, MIN_ISOTP_NAME),
                _ => None,
            },
        };
        if let Some(name) = name {
            match known.of_nodes.iter().find(|(node, _)| *node == header.source) {
                Some((_, before)) => known.has_other_names |= before != name,
                None => known.of_nodes.push((header.source, name.to_vec())),
            }
            known.names = known.names.saturating_add(1);
            let nodes = match framing {
                Framing::Isotp => &mut known.isotp,
                Framing::Raw => &mut known.raw,
            };
            *nodes |= 1 << header.source.index();
            if known.responses.len() + 1 < MAX_FRAMES {
                known.responses.push(*frame);
            }
        }
    }

    /// Proposals of service and framing. `nodes`: those that sent anything; `are_known`: they were heard
    /// long enough to be all.
    pub fn proposals(&self, nodes: &[Address], are_known: bool) -> Vec<ProfileProposal> {
        let is_answered = |known: &&DesService| known.names > 0 && !known.has_other_names;
        let mut answered = self.services.iter().filter(is_answered);
        let Some(des) = answered.next().filter(|_| answered.next().is_none()) else {
            return Vec::new();
        };
        let responders = (des.isotp | des.raw).count_ones() as usize;
        let frames: Vec<Frame> = [des.request].into_iter().chain(des.responses.clone()).collect();
        let responses = counted(des.names as u64, "response");
        let mut proposals = vec![ProfileProposal {
            key: ProfileKey::Des,
            value: ProfileValue::Service(des.service.number()),
            certainty: des.certainty(),
            evidence: format!("{responses} with a name, of {}", counted(responders as u64, "node")),
            frames: frames.clone(),
        }];
        let framing = match (des.isotp, des.raw) {
            (isotp, 0) => Some(("isotp", isotp)),
            (0, raw) => Some(("raw", raw)),
            _ => None,
        };
        // One that has not responded may have another framing.
        let is_all = |of: u128| are_known && nodes.iter().all(|node| of >> node.index() & 1 == 1);
        if let Some((word, _)) =
            framing.filter(|(_, of)| of.count_ones() as usize >= MIN_NODES && is_all(*of))
        {
            proposals.push(ProfileProposal {
                key: ProfileKey::Framing,
                value: ProfileValue::Text(word.to_owned()),
                // A device that joins later may have the other one, and would not be found.
                certainty: Certainty::Guess,
                evidence: format!("all {}", counted(responders as u64, "node")),
                frames,
            });
        }
        proposals
    }
}

impl DesService {
    /// Names that are all the same may be another text that begins like one.
    fn certainty(&self) -> Certainty {
        let first = self.of_nodes.first().map(|(_, name)| name);
        let differ = self.of_nodes.iter().any(|(_, name)| Some(name) != first);
        match self.of_nodes.len() {
            _ if differ => Certainty::Certain,
            1 if self.names > 1 => Certainty::Likely,
            _ => Certainty::Guess,
        }
    }
}

/// The name of a name response, if it is text of so many letters.
fn name_of(message: &[u8], least: usize) -> Option<&[u8]> {
    let (name, fault) = des::decode_name(message);
    let is_text = |name: &&[u8]| name.len() >= least && name.iter().all(u8::is_ascii_graphic);
    let is_response = message.first() == Some(&des::TYPE_NAME) && fault.is_none();
    name.filter(is_text).filter(|_| is_response)
}
