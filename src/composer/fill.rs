//! A composition that makes a given frame.

use super::{Composition, MessageKind, Surroundings};
use crate::frame::{Frame, FrameKind};
use crate::text::hex;
use crate::wire::des::{ReceivedRequest, Request};
use crate::wire::framing::{Framing, classify_request};
use crate::wire::id::{Header, MessageType};
use crate::wire::isotp::{Pci, single_frame};

impl Composition {
    /// Returns the composition that makes this frame: by its fields where they make exactly the same one,
    /// else raw. `None` for remote and error frames, which are not sent.
    pub fn of_frame(frame: &Frame, around: Surroundings<'_>) -> Option<Self> {
        if frame.kind != FrameKind::Data {
            return None;
        }
        let by_fields = frame.platform_id().map(|id| of_header(Header::decode(id), frame, around));
        let is_same = |composition: &Self| {
            let composed = composition.compose(around);
            composed.is_ok_and(|composed| match &composed.frames[..] {
                [made] => {
                    made.same_on_wire(frame)
                        && made.bit_rate_switch == frame.bit_rate_switch
                        && made.error_state == frame.error_state
                }
                _ => false,
            })
        };
        Some(by_fields.filter(is_same).unwrap_or_else(|| Self {
            kind: MessageKind::Raw,
            data: frame.to_string(),
            ..Self::default()
        }))
    }
}

/// Its fields, which need not make the same frame.
fn of_header(header: Header, frame: &Frame, around: Surroundings<'_>) -> Composition {
    let profile = around.profile;
    let is_des = header.service == profile.des_service();
    let mut framing = None;
    let mut data = hex(frame.data(), " ");
    if is_des && (!header.broadcast || !header.response) {
        // With padding the frame is another one.
        let is_whole = |it: Framing, message: &[u8]| match it {
            Framing::Raw => frame.len() == message.len(),
            Framing::Isotp => {
                single_frame(message, frame.is_fd).is_some_and(|it| it.as_bytes() == frame.data())
            }
        };
        let request = classify_request(frame.data(), frame.is_fd).filter(|_| !header.response);
        let request = request.filter(|(it, message)| is_whole(*it, message));
        let known = request.and_then(|(it, message)| match Request::decode(message) {
            Some(ReceivedRequest::Known(Request::Name)) => Some((it, "name")),
            Some(ReceivedRequest::Known(Request::Services)) => Some((it, "services")),
            _ => None,
        });
        match (known, Pci::decode(frame.data(), frame.is_fd)) {
            (Some((it, word)), _) => (framing, data) = (Some(it), word.to_owned()),
            (None, Ok(Pci::Single(message))) if is_whole(Framing::Isotp, message) => {
                (framing, data) = (Some(Framing::Isotp), hex(message, " "));
            }
            _ => framing = Some(Framing::Raw),
        }
    }
    let works = if header.to_non_working { "not-working" } else { "working" };
    let (kind, to) = match header.message_type() {
        MessageType::Debug => (MessageKind::Debug, String::new()),
        _ if header.response && header.broadcast => {
            (MessageKind::Unsolicited, format!("rnd {}", header.destination))
        }
        _ if header.response => (MessageKind::Response, format!("@{}", header.destination)),
        _ if header.broadcast => {
            (MessageKind::Request, format!("all {works} rnd {}", header.destination))
        }
        _ => (MessageKind::Request, format!("@{} {works}", header.destination)),
    };
    let mut from = Vec::new();
    if around.own != Some(header.source) {
        from.push(format!("@{}", header.source));
    }
    if header.from_non_working && kind != MessageKind::Debug {
        from.push("not-working".to_owned());
    }
    let is_named = is_des && kind != MessageKind::Debug;
    Composition {
        kind,
        to,
        service: if is_named { "des".to_owned() } else { header.service.to_string() },
        data,
        framing,
        from: from.join(" "),
        is_error: header.response && !header.no_error,
        is_fd: frame.is_fd,
    }
}
