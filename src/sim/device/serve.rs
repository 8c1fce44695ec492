//! Responses of a device to requests: DES, descriptor fields and commands (protocol §2, §7.4).
//!
//! Service numbers and layouts of the descriptor come from the profile. A request without data
//! reads a field; any other request writes it if it is writable. Does not know how responses are
//! split into frames: see [`super::super::reply`].

use super::{DeviceIo, SimDevice, nanos_of};
use crate::frame::Frame;
use crate::sim::reply::ResponseFormat;
use crate::sim::scenario::{AddressChoice, DeviceAction, Fault};
use crate::wire::des::{self, ReceivedRequest, Request};
use crate::wire::framing::{Framing, classify_request};
use crate::wire::id::{Address, Header};
use crate::wire::isotp::Pci;
use crate::wire::node::{Mode, Uid};

/// Result of a request for a descriptor field or of a command.
enum Served {
    /// Response with these bytes.
    Value(Vec<u8>),
    /// Empty response, then this action.
    Done(Option<DeviceAction>),
    /// Response with ERR = 0.
    Refused,
}

impl SimDevice {
    /// Handles a conforming request, targeted at this device or broadcast.
    pub(super) fn handle_request(&mut self, frame: &Frame, header: Header, port: &mut DeviceIo) {
        if header.service == port.profile.des_service() {
            self.handle_des(frame, header, port);
        } else if !header.broadcast && self.accepts(header) {
            self.handle_common(frame, header, port);
        }
    }

    /// Returns true if a request addresses nodes in its mode and it is not in IDLE.
    fn accepts(&self, header: Header) -> bool {
        header.to_non_working != self.is_working() && self.mode != Mode::Idle
    }

    fn handle_des(&mut self, frame: &Frame, header: Header, port: &mut DeviceIo) {
        if let Ok(Pci::Flow(flow)) = Pci::decode(frame.data(), frame.is_fd) {
            self.replies.handle_flow(port.now, header.source.number(), flow);
            return;
        }
        if !self.accepts(header) {
            return;
        }
        let Some((framing, message)) = classify_request(frame.data(), frame.is_fd) else { return };
        let Some(ReceivedRequest::Known(request)) = Request::decode(message) else { return };
        let faults = self.spec.faults;
        let mute = faults.has(Fault::NoDes)
            || request == Request::Services && (header.broadcast || faults.has(Fault::NoServices));
        if mute || !self.spec.framing.accepts(framing) {
            return;
        }
        let message = self.response(request);
        for _ in 0..=u8::from(faults.has(Fault::RespondsTwice)) {
            self.reply(header, framing, message.clone(), port);
        }
    }

    fn response(&self, request: Request) -> Vec<u8> {
        match request {
            Request::Name => des::encode_name(&self.spec.name).collect(),
            // Without firmware a device has no services.
            Request::Services if self.mode == Mode::Boot => vec![des::TYPE_SERVICES],
            Request::Services => {
                let mut message: Vec<u8> = des::encode_services(&self.spec.services).collect();
                if self.spec.faults.has(Fault::TruncatedServices) {
                    let half = (message.len() - message.len().min(3)).max(2);
                    message.truncate(half);
                }
                message
            }
        }
    }

    fn reply(&mut self, header: Header, framing: Framing, message: Vec<u8>, port: &DeviceIo) {
        let Some(form) = self.form(header, framing, port) else { return };
        let (least, most) = self.spec.response_delay;
        let delay = self.rng.u64(nanos_of(least)..=nanos_of(most).max(nanos_of(least)));
        self.replies.push(port.now + delay, form, message, self.spec.faults);
    }

    /// Returns the form of the response's frames; `None` without an address.
    fn form(&self, header: Header, framing: Framing, port: &DeviceIo) -> Option<ResponseFormat> {
        let mut response = header.response(self.address?, !self.is_working());
        if self.spec.faults.has(Fault::RepeatsRequestDst) {
            response.destination = header.destination;
        }
        let refusal = Header { no_error: false, ..response };
        Some(ResponseFormat {
            id: response.encode(),
            refusal_id: refusal.encode(),
            framing,
            fd: self.spec.fd,
            padding: port.profile.isotp.fd_padding,
            requester: header.source.number(),
        })
    }

    fn handle_common(&mut self, frame: &Frame, header: Header, port: &mut DeviceIo) {
        let Some(served) = self.serve(header.service.number(), frame.data(), port) else { return };
        let Some(form) = self.form(header, Framing::Raw, port) else { return };
        let (form, data, action) = match served {
            Served::Value(data) => (form, data, None),
            Served::Done(action) => (form, Vec::new(), action),
            Served::Refused => (ResponseFormat { id: form.refusal_id, ..form }, Vec::new(), None),
        };
        // The action takes effect after the response was sent.
        let sent = port.send(form.raw(&data));
        self.pending_action = action.filter(|_| sent).map(|action| (form.id, action));
    }

    fn serve(&self, service: u16, data: &[u8], port: &DeviceIo) -> Option<Served> {
        let (fields, commands) = (&port.profile.descriptor, &port.profile.commands);
        let read = data.is_empty();
        let served = if service == fields.gid && read {
            Served::Value(self.spec.descriptor.gid.to_vec())
        } else if service == fields.uid && read {
            Served::Value(self.spec.uid.0.to_vec())
        } else if service == fields.uid {
            data.try_into()
                .map_or(Served::Refused, |uid| Served::Done(Some(DeviceAction::Uid(Uid(uid)))))
        } else if service == fields.sn && read {
            Served::Value(self.spec.descriptor.serial.to_le_bytes().to_vec())
        } else if service == fields.fw && read {
            let (major, minor) = self.spec.descriptor.firmware;
            Served::Value([major.to_le_bytes(), minor.to_le_bytes()].concat())
        } else if service == fields.caps && read {
            // Programmable, no FPU, RV32I, no flags.
            Served::Value(vec![1, 1, 0, 0, 0])
        } else if service == fields.bspd && read {
            let rates = [125_000, 250_000, 500_000, 1_000_000];
            let at = rates.iter().position(|&rate| rate == port.bus.bitrate());
            Served::Value(vec![at.map_or(0x80, |at| at as u8 | 0x80)])
        } else if service == fields.addr && read {
            Served::Value(vec![match self.spec.address {
                AddressChoice::Any => 0,
                AddressChoice::Fixed(address) => address.number(),
                AddressChoice::Preferred(address) => address.number() | 0x80,
            }])
        } else if service == fields.addr {
            match *data {
                [0] => Served::Done(Some(DeviceAction::Move(AddressChoice::Any))),
                [0x80] => Served::Refused,
                [code] => {
                    let address = Address::from_bits(code);
                    let fixed = code & 0x80 == 0;
                    let choice =
                        if fixed { AddressChoice::Fixed } else { AddressChoice::Preferred };
                    Served::Done(Some(DeviceAction::Move(choice(address))))
                }
                _ => Served::Refused,
            }
        } else if service == fields.autostart && read {
            Served::Value(vec![u8::from(self.spec.autostart)])
        } else if service == commands.identify {
            Served::Done(None)
        } else if service == commands.mode {
            let code = data.first().filter(|_| data.len() == 1);
            let mode = code.and_then(|code| port.modes.iter().position(|known| known == code));
            mode.map_or(Served::Refused, |at| Served::Done(Some(DeviceAction::Mode(Mode::ALL[at]))))
        } else if [fields.gid, fields.sn, fields.fw, fields.caps, fields.bspd, fields.autostart]
            .contains(&service)
        {
            Served::Refused
        } else {
            return None;
        };
        Some(served)
    }
}
