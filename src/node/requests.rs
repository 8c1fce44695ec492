//! Requests that a node receives: DES, the descriptor, writes and commands.

use super::requester::{CommandEffect, NodeCommand, ResponseKind, ServedRequester};
use super::{Node, NodeFrame, StorePending};
use crate::time::Instant;
use crate::wire::des::{ReceivedRequest, Request};
use crate::wire::descriptor::{DescriptorField, DescriptorValue};
use crate::wire::framing::{self, Framing};
use crate::wire::id::{Header, Service};
use crate::wire::isotp::Pci;
use crate::wire::node::Mode;
use crate::wire::profile::WriteEffect;

impl<const REQUESTERS: usize> Node<'_, REQUESTERS> {
    /// Takes a request to this node or to all; returns true if it is for the application.
    pub(super) fn handle_request(
        &mut self,
        now: Instant,
        header: Header,
        frame: &NodeFrame,
    ) -> bool {
        // Requests to nodes in its mode; in IDLE that to change the mode.
        let is_served = header.to_non_working != self.is_working()
            && (self.mode != Mode::Idle || Some(header.service) == self.config.mode);
        if header.service == self.config.des {
            self.handle_des(now, header, frame, is_served);
            return false;
        }
        is_served && (header.broadcast || !self.serve(header, frame))
    }

    /// Takes a frame on the number of DES.
    fn handle_des(&mut self, now: Instant, header: Header, frame: &NodeFrame, is_served: bool) {
        if let Ok(Pci::Flow(flow)) = Pci::decode(frame.data(), frame.is_fd()) {
            let peer = header.source;
            let of_peer = self.requesters.iter_mut().filter(|it| !it.is_free() && it.peer == peer);
            of_peer.for_each(|requester| requester.handle_flow(flow, now));
            return;
        }
        let request = framing::classify_request(frame.data(), frame.is_fd());
        let Some((framing, message)) = request.filter(|_| is_served) else { return };
        if framing == Framing::Raw && !self.config.has_raw_framing {
            return;
        }
        let kind = match Request::decode(message) {
            Some(ReceivedRequest::Known(Request::Name)) => ResponseKind::Name(framing),
            Some(ReceivedRequest::Known(Request::Services)) => ResponseKind::Services(framing),
            Some(ReceivedRequest::Reserved(_)) if !header.broadcast => {
                self.add_command(header, frame, None);
                return;
            }
            _ => return,
        };
        self.add(header, frame, kind);
    }

    /// Adds a request to those of its requester. Returns the requester's index; `None` if the
    /// request is dropped.
    fn add(&mut self, header: Header, frame: &NodeFrame, kind: ResponseKind) -> Option<usize> {
        let peer = header.source;
        let known = self.requesters.iter().position(|it| !it.is_free() && it.peer == peer);
        let free = || self.requesters.iter().position(ServedRequester::is_free);
        let at =
            known.or_else(free).filter(|at| self.requesters[*at].add(peer, frame.is_fd(), kind));
        if at.is_none() {
            self.dropped = self.dropped.wrapping_add(1);
        }
        at
    }

    /// Adds a command that is answered at once; `effect` is `None` if it is refused.
    fn add_command(&mut self, header: Header, frame: &NodeFrame, effect: Option<CommandEffect>) {
        if let Some(at) = self.add(header, frame, ResponseKind::Command) {
            let service = header.service;
            self.requesters[at].command = NodeCommand { service, effect, is_storing: false };
        }
    }

    /// Takes a targeted request for the descriptor, a write or a command; returns false if its
    /// service is none of them.
    fn serve(&mut self, header: Header, frame: &NodeFrame) -> bool {
        let (service, data) = (header.service, frame.data());
        let read = self.config.read_field(service);
        let written = self.config.written_field(service);
        if let Some(field) = read.filter(|_| data.is_empty()) {
            self.add(header, frame, ResponseKind::Field(field));
            return true;
        }
        let value = written.and_then(|field| self.written_value(field, data));
        if let Some(value) = value {
            self.write(header, frame, value);
        } else if self.config.is_command(service) {
            self.add_command(header, frame, self.effect_of(service, data));
        } else if read.is_some() || written.is_some() {
            self.add_command(header, frame, None);
        } else {
            return false;
        }
        true
    }

    fn written_value(&self, field: DescriptorField, data: &[u8]) -> Option<DescriptorValue> {
        DescriptorValue::decode(field, data, self.config.byte_order).ok()
    }

    /// Begins to store a value. There is room for one.
    fn write(&mut self, header: Header, frame: &NodeFrame, value: DescriptorValue) {
        if self.storing.is_some() {
            self.dropped = self.dropped.wrapping_add(1);
            return;
        }
        let Some(at) = self.add(header, frame, ResponseKind::Command) else { return };
        let service = header.service;
        self.requesters[at].command = NodeCommand { service, effect: None, is_storing: true };
        let effect = match value {
            _ if self.config.write_effect == WriteEffect::Restart => CommandEffect::Nothing,
            DescriptorValue::Address(_) => CommandEffect::Enter(Mode::Arslv),
            DescriptorValue::Bitrate(_) => CommandEffect::Enter(Mode::Init),
            _ => CommandEffect::Nothing,
        };
        let settings = self.settings.with_value(value);
        let requester = Some(at);
        self.storing = Some(StorePending { settings, requester, effect, is_reported: false });
    }

    /// Returns what a command does; `None` if it is refused.
    fn effect_of(&self, service: Service, data: &[u8]) -> Option<CommandEffect> {
        if Some(service) == self.config.identify {
            return Some(CommandEffect::Identify);
        }
        if Some(service) == self.config.reboot {
            return data.is_empty().then_some(CommandEffect::Reboot);
        }
        let [code] = *data else { return None };
        let mode = self.config.mode_of(code)?;
        let is_permitted =
            mode.is_working() != Some(true) || self.permitted(mode).is_working() == Some(true);
        is_permitted.then_some(CommandEffect::Enter(mode))
    }
}
