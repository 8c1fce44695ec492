//! Responses that a node sends: their frames, and what follows their transmission.

use super::config::capacity;
use super::requester::{CommandEffect, ResponseKind};
use super::{ModeWish, Node, NodeFrame};
use crate::time::Instant;
use crate::wire::des::{self, MAX_MESSAGE};
use crate::wire::descriptor::DescriptorField;
use crate::wire::framing::Framing;
use crate::wire::id::Header;
use crate::wire::node::Mode;

/// Longest message of a single frame with one byte of PCI.
const MAX_SINGLE: usize = 7;
/// Longest message of a single frame of CAN FD, with two bytes of PCI.
const MAX_FD_SINGLE: usize = 62;

impl<const REQUESTERS: usize> Node<'_, REQUESTERS> {
    /// Returns the next frame of a response; the requesters take turns.
    pub(super) fn next_response(&mut self) -> Option<NodeFrame> {
        let (at, kind) = (1..=REQUESTERS)
            .map(|step| (self.turn + step) % REQUESTERS)
            .find_map(|at| Some((at, self.requesters[at].ready()?)))?;
        self.turn = at;
        self.requesters[at].begin(kind);
        let mut frame = match kind {
            ResponseKind::Name(framing) => self.text_frame(at, true, framing),
            ResponseKind::Services(framing) => self.text_frame(at, false, framing),
            ResponseKind::Command => self.command_frame(at),
            ResponseKind::Field(field) => self.field_frame(at, field),
        };
        if self.requesters[at].is_fd {
            frame.pad_as_fd(self.config.fd_padding);
        }
        Some(frame)
    }

    /// Returns the identifier of a DES response to a requester.
    fn header_to(&self, at: usize) -> Header {
        Header {
            from_non_working: !self.is_working(),
            to_non_working: false,
            response: true,
            broadcast: false,
            no_error: true,
            source: self.own,
            destination: self.requesters[at].peer,
            service: self.config.des,
        }
    }

    fn command_frame(&self, at: usize) -> NodeFrame {
        let command = self.requesters[at].command;
        let no_error = command.effect.is_some();
        let service = command.service;
        NodeFrame::with_header(Header { no_error, service, ..self.header_to(at) })
    }

    fn field_frame(&self, at: usize, field: DescriptorField) -> NodeFrame {
        // It was requested by its number, so it has one.
        let service = self.config.reads(field).unwrap_or_default();
        let value = self.device.value(field, &self.settings);
        let (data, len) = value.encode(self.config.byte_order);
        let mut frame = NodeFrame::with_header(Header { service, ..self.header_to(at) });
        frame.extend(data.into_iter().take(len));
        frame
    }

    /// Returns the next frame of a name or services response; with ERR = 0 if it is too long.
    fn text_frame(&mut self, at: usize, is_name: bool, framing: Framing) -> NodeFrame {
        let header = self.header_to(at);
        let requester = &mut self.requesters[at];
        let capacity = capacity(requester.is_fd);
        let sent = usize::from(requester.sent);
        let total = if is_name {
            self.device.name_len()
        } else if sent == 0 && self.mode == Mode::Boot {
            1 // Without firmware it has no services.
        } else {
            self.device.services_len()
        };
        let most = if framing == Framing::Raw { capacity } else { MAX_MESSAGE };
        if total > most {
            return NodeFrame::with_header(Header { no_error: false, ..header });
        }
        let mut frame = NodeFrame::with_header(header);
        if framing == Framing::Isotp {
            match total {
                _ if sent > 0 => frame.extend([0x20 | requester.sequence & 0x0F]),
                0..=MAX_SINGLE => frame.extend([total as u8]),
                0..=MAX_FD_SINGLE if requester.is_fd => frame.extend([0, total as u8]),
                _ => frame.extend([0x10 | (total >> 8) as u8, total as u8]),
            }
        }
        let count = (total - sent).min(capacity - frame.data().len());
        if is_name {
            frame.extend(part(des::encode_name(self.device.name.as_bytes()), sent, count));
        } else {
            frame.extend(part(des::encode_services(self.device.services), sent, count));
        }
        requester.sequence = requester.sequence.wrapping_add(1);
        requester.sent = (sent + count) as u16;
        requester.left = (total - sent - count) as u16;
        frame
    }

    /// Handles the end of the transmission of a response's frame.
    pub(super) fn handle_response_sent(&mut self, now: Instant, is_sent: bool) {
        match self.requesters[self.turn].handle_transmitted(is_sent, now) {
            CommandEffect::Nothing => {}
            CommandEffect::Enter(mode) => self.wish = ModeWish::Enter(mode),
            CommandEffect::Identify => self.has_identify = true,
            CommandEffect::Reboot => {
                self.has_reboot = true;
                self.wish = ModeWish::Enter(Mode::Init);
            }
        }
    }
}

/// Returns `count` bytes behind the first `sent`. Not `skip`, whose code is larger than the time it saves
/// is worth.
fn part(
    mut bytes: impl Iterator<Item = u8>,
    sent: usize,
    count: usize,
) -> impl Iterator<Item = u8> {
    for _ in 0..sent {
        bytes.next();
    }
    bytes.take(count)
}
