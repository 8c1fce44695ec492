//! Observation: a received frame, decoded once for everything that reads it.

use super::config::Config;
use crate::frame::{Frame, FrameKind};
use crate::time::Instant;
use crate::wire::des::{ReceivedRequest, Request};
use crate::wire::framing::{Framing, classify_request};
use crate::wire::id::{Header, MessageType};
use crate::wire::node::Heartbeat;

/// A frame as received, with what it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation<'a> {
    /// Time at which it counts as received: never before that of an earlier frame.
    pub at: Instant,
    pub frame: &'a Frame,
    pub kind: ObservationKind,
}

/// What a frame is.
#[derive(Clone, Copy, Debug)]
pub(super) enum ObservationKind {
    /// An error frame.
    Error,
    /// A frame with an 11-bit identifier, or a remote frame.
    NonPlatform,
    /// A data frame with a 29-bit identifier.
    Platform(Header, PlatformContent),
}

/// Content of a data frame with a 29-bit identifier, as far as one frame shows it.
#[derive(Clone, Copy, Debug)]
pub(super) enum PlatformContent {
    /// The identifier is none of the nine message types.
    NonConforming,
    /// A DEBUG message.
    Debug,
    /// A frame of the heartbeat service.
    Heartbeat(Heartbeat),
    /// A frame of the DES service sent to a responder; a request with its framing, or `None` for
    /// flow control and what is no known request.
    Request(Option<(Framing, Request)>),
    /// A frame of the DES service sent by a responder.
    Response,
    /// A frame of another service.
    OtherService,
}

impl<'a> Observation<'a> {
    /// Decodes a frame that counts as received at `at`.
    pub fn new(at: Instant, frame: &'a Frame, config: &Config) -> Self {
        let kind = match frame.platform_id().map(Header::decode) {
            _ if frame.kind == FrameKind::Error => ObservationKind::Error,
            None => ObservationKind::NonPlatform,
            Some(header) => {
                ObservationKind::Platform(header, PlatformContent::new(header, frame, config))
            }
        };
        Self { at, frame, kind }
    }

    /// Returns the decoded identifier of a data frame with a 29-bit identifier.
    pub fn header(&self) -> Option<Header> {
        match self.kind {
            ObservationKind::Platform(header, _) => Some(header),
            _ => None,
        }
    }
}

impl PlatformContent {
    fn new(header: Header, frame: &Frame, config: &Config) -> Self {
        let profile = &config.profile;
        match header.message_type() {
            MessageType::NonConforming => return Self::NonConforming,
            MessageType::Debug => return Self::Debug,
            _ => {}
        }
        if header.service == profile.heartbeat_service() {
            let codes = profile.modes.codes();
            return Self::Heartbeat(Heartbeat::decode(frame.data(), &profile.heartbeat, &codes));
        }
        if header.service != profile.des_service() {
            return Self::OtherService;
        }
        if header.response { Self::Response } else { Self::Request(known_request(frame)) }
    }
}

/// Returns a DES request, if the frame is one whose type is known.
fn known_request(frame: &Frame) -> Option<(Framing, Request)> {
    let (framing, message) = classify_request(frame.data(), frame.is_fd)?;
    match Request::decode(message) {
        Some(ReceivedRequest::Known(request)) => Some((framing, request)),
        _ => None,
    }
}
