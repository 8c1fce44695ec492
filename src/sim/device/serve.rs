//! Responses of a device to requests: DES, descriptor fields and commands (protocol §2, §7.4).
//!
//! Service numbers come from the profile. A request without data reads a field; UID, address and
//! bit rate can be written. Does not know how responses are
//! split into frames: see [`super::super::reply`].

use super::{DeviceIo, SimDevice, nanos_of};
use crate::frame::Frame;
use crate::sim::reply::ResponseFormat;
use crate::sim::scenario::{DeviceAction, Fault};
use crate::wire::des::{self, ReceivedRequest, Request};
use crate::wire::descriptor::{AddressSetting, BitrateSetting, DescriptorField, DescriptorValue};
use crate::wire::framing::{Framing, classify_request};
use crate::wire::id::Header;
use crate::wire::isotp::Pci;
use crate::wire::node::{Mode, Uid};
use crate::wire::profile::{Profile, WriteEffect};

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
        } else if !header.broadcast && (self.accepts(header) || self.is_woken_by(header, port)) {
            self.handle_common(frame, header, port);
        }
    }

    /// Returns true if a request addresses nodes in its mode and it is not in IDLE.
    fn accepts(&self, header: Header) -> bool {
        header.to_non_working != self.is_working() && self.mode != Mode::Idle
    }

    /// Returns true if a request is the command that a device waits for in IDLE (CAN platform §3.2.4.5).
    fn is_woken_by(&self, header: Header, port: &DeviceIo) -> bool {
        let waits = self.mode == Mode::Idle && self.spec.idle_ends_by_command;
        waits && header.to_non_working && header.service.number() == port.profile.commands.mode
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
        let faults = self.spec.faults;
        if faults.has(Fault::NoDes) || !self.spec.framing.accepts(framing) {
            return;
        }
        let request = match Request::decode(message) {
            Some(ReceivedRequest::Known(request)) => request,
            Some(ReceivedRequest::Reserved(_)) if !header.broadcast => {
                return self.refuse(header, port);
            }
            _ => return,
        };
        if request == Request::Services && faults.has(Fault::NoServices) {
            return;
        }
        let message = self.response(request);
        for _ in 0..=u8::from(faults.has(Fault::RespondsTwice)) {
            self.reply(header, framing, message.clone(), port);
        }
    }

    /// Answers a targeted request that it cannot process (CAN platform §4.3).
    fn refuse(&self, header: Header, port: &mut DeviceIo) {
        if let Some(form) = self.form(header, Framing::Raw, port) {
            port.send(ResponseFormat { id: form.refusal_id, ..form }.raw(&[]));
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
        if self.spec.faults.has(Fault::NoDescriptor) {
            return None;
        }
        let Profile { descriptor: fields, commands, writes, .. } = port.profile;
        let is_field = |field: &DescriptorField| field.service(fields).number() == service;
        let field = DescriptorField::ALL.into_iter().find(is_field);
        let served = if let Some(field) = field.filter(|_| data.is_empty()) {
            let (bytes, len) = self.value(field, port).encode(fields.byte_order);
            let missing = usize::from(self.spec.faults.has(Fault::ShortDescriptor));
            Served::Value(bytes[..len - missing].to_vec())
        } else if let Some(written) = write_of(service, data, port.profile) {
            if self.spec.faults.has(Fault::Locked) { Served::Refused } else { written }
        } else if service == commands.identify {
            Served::Done(None)
        } else if Some(service) == commands.reboot && data.is_empty() {
            Served::Done(Some(DeviceAction::Reboot { services: None }))
        } else if service == commands.mode {
            let code = data.first().filter(|_| data.len() == 1);
            let mode = code.and_then(|code| Mode::from_code(*code, port.modes));
            let mode = mode.filter(|mode| self.may_enter(*mode));
            mode.map_or(Served::Refused, |mode| Served::Done(Some(DeviceAction::Mode(mode))))
        } else if field.is_some() || [writes.address, writes.bitrate].contains(&Some(service)) {
            Served::Refused
        } else {
            return None;
        };
        Some(served)
    }

    /// Returns true unless it is to work without a configured address or a UID (CAN platform §3.2.4.4).
    fn may_enter(&self, mode: Mode) -> bool {
        mode.is_working() != Some(true)
            || self.spec.address != AddressSetting::None && !self.spec.uid.is_blank()
    }

    /// Returns the value of a field of its descriptor.
    fn value(&self, field: DescriptorField, port: &DeviceIo) -> DescriptorValue {
        let spec = &self.spec;
        match field {
            DescriptorField::Gid => DescriptorValue::Gid(spec.descriptor.gid),
            DescriptorField::Uid => DescriptorValue::Uid(spec.uid),
            DescriptorField::Serial => DescriptorValue::Serial(spec.descriptor.serial),
            DescriptorField::Firmware => DescriptorValue::Firmware(spec.descriptor.firmware),
            DescriptorField::Capabilities => {
                DescriptorValue::Capabilities(spec.descriptor.capabilities)
            }
            DescriptorField::Bitrate => {
                let of_bus = BitrateSetting { rate: port.bus.bitrate(), is_fixed: false };
                DescriptorValue::Bitrate(spec.descriptor.bitrate.unwrap_or(of_bus))
            }
            DescriptorField::Address => DescriptorValue::Address(spec.address),
            DescriptorField::Autostart => DescriptorValue::Autostart(spec.autostart),
        }
    }
}

/// Returns what a request that writes a setting demands; `None` if it writes none.
fn write_of(service: u16, data: &[u8], profile: &Profile) -> Option<Served> {
    let Profile { descriptor: fields, writes, .. } = profile;
    let code = match *data {
        [] => return None,
        [code] => Some(code),
        _ => None,
    };
    let action = if service == fields.uid {
        data.try_into().ok().map(|uid| DeviceAction::Uid(Uid(uid)))
    } else if Some(service) == writes.address {
        code.and_then(AddressSetting::from_code).map(match writes.effect {
            WriteEffect::Now => DeviceAction::Move,
            WriteEffect::Restart => DeviceAction::StoreAddress,
        })
    } else if Some(service) == writes.bitrate {
        code.and_then(BitrateSetting::from_code).map(DeviceAction::StoreBitrate)
    } else {
        return None;
    };
    Some(action.map_or(Served::Refused, |action| Served::Done(Some(action))))
}
