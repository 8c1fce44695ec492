//! Commands that the user sends to devices: the question before, the sending, and how each ended.
//! Also the reading of a descriptor, which is asked for in the same way.

use super::device_command::DeviceCommand;
use super::input::{CommandPrompt, Prompt, PromptKind, Question};
use super::notices::TimelineEntry;
use super::shared_address::{identity_of, is_shared};
use super::timeline_kind::TimelineKind;
use super::{App, format_time_of_day};
use crate::address_plan::DeviceIdentity;
use crate::discovery::{
    Device, DeviceId, DeviceRequest, Event, EventKind, OwnAddress, RequestId, RequestOutcome,
    given_fields,
};
use crate::frame::{BusIndex, Frame};
use crate::keymap::Action;
use crate::text::{counted, hex};
use crate::time::Instant;
use crate::wire::descriptor::DescriptorField;
use crate::wire::id::Address;
use crate::wire::profile::ProfileKey;
use std::collections::{BTreeMap, VecDeque};

/// Maximum number of ended commands that are kept. Bounds the memory; a command line sends one.
const MAX_ENDED: usize = 64;

/// A command that ended.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct EndedCommand {
    /// The device.
    pub device: DeviceId,
    /// The command.
    pub command: DeviceCommand,
    /// Time at which it ended.
    pub time: Instant,
    /// Its frame; `None` if it was not sent.
    pub frame: Option<Frame>,
    /// How it ended.
    pub outcome: RequestOutcome,
    /// How it ended, in words.
    pub text: String,
}

/// Commands that wait for their end, and those that ended.
#[derive(Debug, Default)]
pub(super) struct SentCommands {
    open: BTreeMap<(BusIndex, RequestId), (DeviceId, DeviceCommand)>,
    /// The device that the user was asked about last, as it was then.
    asked: Option<(DeviceId, DeviceIdentity, Address)>,
    ended: VecDeque<EndedCommand>,
    /// The device whose descriptor is being read for the user.
    reading: Option<DeviceId>,
}

impl App {
    /// The commands that ended, oldest first, at most 64.
    pub fn ended_commands(&self) -> impl Iterator<Item = &EndedCommand> {
        self.commands.ended.iter()
    }

    /// Why a command cannot be sent to a device; `None` if it can.
    pub fn command_obstacle(&self, id: DeviceId, command: DeviceCommand) -> Option<String> {
        let profile = &self.profile(id.bus);
        let obstacle = || {
            let is_known = command.request(profile).is_some();
            (!is_known).then(|| format!("{command} {}", key_needed(command.key())))
        };
        let shared = || self.shared_address(id).filter(|_| command != DeviceCommand::Identify);
        self.request_obstacle(id).or_else(obstacle).or_else(shared)
    }

    /// Says that another device uses the address of this one: a request would reach both.
    pub(super) fn shared_address(&self, id: DeviceId) -> Option<String> {
        let (device, bus) = (self.device(id)?, self.bus(id.bus)?);
        is_shared(bus, device, self.clock.now())
            .then(|| format!("another device is at {}, too", device.address))
    }

    /// Remembers the device that the user is asked about.
    pub fn note_asked(&mut self, id: DeviceId) {
        let asked = self.device(id).map(|device| (id, identity_of(device), device.address));
        self.commands.asked = asked;
    }

    /// How the device differs from that which the user was asked about; `None` if it does not.
    fn change_since_asked(&self, id: DeviceId) -> Option<String> {
        let (_, asked, at) = self.commands.asked.as_ref().filter(|(asked, ..)| *asked == id)?;
        let device = self.device(id)?;
        if device.address != *at {
            return Some(format!(
                "not sent: it was asked for at {at}, now it is at {}",
                device.address
            ));
        }
        let is_other = asked.is_other(&identity_of(device));
        is_other.then(|| format!("not sent: another device is at {at} now"))
    }

    /// Why no request can be sent to a device; `None` if one can.
    fn request_obstacle(&self, id: DeviceId) -> Option<String> {
        let (Some(device), Some(bus)) = (self.device(id), self.bus(id.bus)) else {
            return Some("device is no longer on the bus".to_owned());
        };
        if let Some(obstacle) = self.tx_obstacle(id.bus, bus) {
            return Some(obstacle);
        }
        match bus.own_address() {
            OwnAddress::Held(own) if own == device.address => {
                Some("this is descan's own address".to_owned())
            }
            OwnAddress::Held(_) if !device.is_present() => Some("the device is lost".to_owned()),
            OwnAddress::Held(_) => None,
            _ => Some("descan has no address on this bus yet".to_owned()),
        }
    }

    /// What would be sent, and what it does to the device; ends without a question mark.
    pub fn command_sentences(&self, id: DeviceId, command: DeviceCommand) -> (String, String) {
        let (profile, who) = (&self.profile(id.bus), self.who(id));
        let bytes = match command.request(profile) {
            Some((service, data)) if data.is_empty() => format!("service {service}"),
            Some((service, data)) => format!("service {service}, data {}", hex(&data, " ")),
            None => key_needed(command.key()),
        };
        let sent = format!("Send {command} ({bytes}) to {who}");
        let rate = self.bus(id.bus).and_then(|bus| bus.config().bitrate);
        let effect = self.device(id).map(|device| {
            let holder = self.holder_of(device, command);
            command.effect(device, profile, rate, holder.as_deref())
        });
        (sent, effect.unwrap_or_default())
    }

    /// Name of another device at the address that a command sets.
    fn holder_of(&self, device: &Device, command: DeviceCommand) -> Option<String> {
        let DeviceCommand::Address(setting) = command else { return None };
        let address = setting.address()?;
        let bus = self.bus(device.id.bus)?;
        let at_address = |it: &&Device| it.address == address && it.is_present();
        let other = bus.devices().iter().filter(at_address).find(|it| it.id != device.id)?;
        Some(other.name.as_ref().map_or("another device".to_owned(), ToString::to_string))
    }

    /// Name and address of a device.
    fn who(&self, id: DeviceId) -> String {
        let Some(device) = self.device(id) else { return "a device no longer on the bus".into() };
        let name = device.name.as_ref().map_or("the device".to_owned(), ToString::to_string);
        format!("{name} at {}", device.address)
    }

    /// Sends a command to a device, once.
    ///
    /// # Errors
    ///
    /// The reason why it cannot be sent.
    pub fn send_command(&mut self, id: DeviceId, command: DeviceCommand) -> Result<(), String> {
        let change = self.change_since_asked(id);
        if let Some(why) = change.or_else(|| self.command_obstacle(id, command)) {
            return Err(why);
        }
        let request = command.request(&self.profile(id.bus));
        let (service, data) = request.ok_or("its service number is not known")?;
        let request = DeviceRequest { device: id, service, data };
        let sent = self.buses.request(self.clock.now(), request);
        let sent = sent.ok_or("too many requests wait to be sent")?;
        self.commands.open.insert((id.bus, sent), (id, command));
        Ok(())
    }

    /// Reads a field of a device's descriptor, or all whose service numbers a file sets.
    ///
    /// # Errors
    ///
    /// The reason why it cannot be read.
    pub fn read_descriptor(
        &mut self,
        id: DeviceId,
        field: Option<DescriptorField>,
    ) -> Result<usize, String> {
        if let Some(why) = self.descriptor_obstacle(id, field) {
            return Err(why);
        }
        Ok(self.buses.read_descriptor(self.clock.now(), id, field))
    }

    /// Why a field of a device's descriptor, or all, cannot be read; `None` if it can.
    pub fn descriptor_obstacle(
        &self,
        id: DeviceId,
        field: Option<DescriptorField>,
    ) -> Option<String> {
        let profile = &self.profile(id.bus);
        let is_known = given_fields(profile).any(|it| field.is_none_or(|field| field == it));
        let key = field.unwrap_or(DescriptorField::Gid).key();
        let obstacle = || (!is_known).then(|| format!("the descriptor {}", key_needed(key)));
        self.request_obstacle(id).or_else(obstacle)
    }

    /// Returns true if no field of a device's descriptor is still to be read.
    pub fn is_descriptor_read(&self, id: DeviceId) -> bool {
        self.bus(id.bus).is_none_or(|bus| !bus.is_reading_descriptor(id))
    }

    // ---- on the screen ---------------------------------------------------------------------

    /// Opens the prompt for a command to the selected device.
    pub(super) fn ask_for_command(&mut self) {
        if !self.go_to_row() {
            return;
        }
        let Some(device) = self.selected_device() else {
            return self.show_error("no device in this row");
        };
        let id = device.id;
        if let Some(why) = self.request_obstacle(id) {
            return self.show_error(why);
        }
        let prompt = CommandPrompt { device: id };
        self.input
            .open(super::Overlay::Prompt(Prompt::new(PromptKind::Command(prompt), String::new())));
    }

    /// Asks whether to send a command to the selected device.
    pub(super) fn ask_identify(&mut self) {
        if !self.go_to_row() {
            return;
        }
        match self.selected_device().map(|device| device.id) {
            Some(id) => self.ask_to_send(id, DeviceCommand::Identify),
            None => self.show_error("no device in this row to identify"),
        }
    }

    /// Asks whether to send a command.
    pub(super) fn ask_to_send(&mut self, id: DeviceId, command: DeviceCommand) {
        match self.command_obstacle(id, command) {
            None => {
                self.note_asked(id);
                self.input.ask(Question::Command(id, command));
            }
            Some(why) => self.show_error(why),
        }
    }

    /// Asks whether to read the descriptor of the selected device.
    pub(super) fn ask_to_read_descriptor(&mut self) {
        if !self.go_to_row() {
            return;
        }
        let Some(id) = self.selected_device().map(|device| device.id) else {
            return self.show_error("no device in this row");
        };
        match self.descriptor_obstacle(id, None) {
            None => self.input.ask(Question::Descriptor(id)),
            Some(why) => self.show_error(why),
        }
    }

    /// The question before a descriptor is read.
    pub(super) fn descriptor_question(&self, id: DeviceId) -> String {
        let profile = &self.profile(id.bus);
        let fields: Vec<DescriptorField> = given_fields(profile).collect();
        let numbers = fields.iter().map(|field| field.service(&profile.descriptor).number());
        let range = match (numbers.clone().min(), numbers.max()) {
            (Some(first), Some(last)) if first != last => {
                format!("services 0x{first:03X} to 0x{last:03X}")
            }
            (first, _) => format!("service 0x{:03X}", first.unwrap_or_default()),
        };
        let requests = counted(fields.len() as u64, "empty request");
        format!("Read the descriptor of {}: {requests} ({range})?", self.who(id))
    }

    /// Sends a command that the user confirmed.
    pub(super) fn send_confirmed(&mut self, id: DeviceId, command: DeviceCommand) {
        match self.send_command(id, command) {
            Ok(()) => self.show_info(format!("{command} sent")),
            Err(why) => self.show_error(why),
        }
    }

    /// Reads a descriptor as the user confirmed.
    pub(super) fn read_confirmed(&mut self, id: DeviceId) {
        match self.read_descriptor(id, None) {
            Ok(fields) => {
                self.commands.reading = Some(id);
                self.show_info(format!("reading {}", counted(fields as u64, "field")));
            }
            Err(why) => self.show_error(why),
        }
    }

    /// Takes the end of a request to a device.
    pub(super) fn end_command(&mut self, bus: BusIndex, event: &Event) {
        if let EventKind::DescriptorRead { values, fields } = &event.kind
            && self.commands.reading.take_if(|id| event.device == Some(*id)).is_some()
        {
            let fields = counted(*fields as u64, "field");
            self.show_info(format!("descriptor: {values} of {fields} read, in the details"));
        }
        let EventKind::RequestEnded { request, frame, outcome } = &event.kind else { return };
        let Some((device, command)) = self.commands.open.remove(&(bus, *request)) else { return };
        let timeout = self.profile(bus).calls.timeout_ms;
        let (kind, what) = match outcome {
            RequestOutcome::Responded(data) if data.is_empty() => {
                (TimelineKind::Improved, "the device responded".to_owned())
            }
            RequestOutcome::Responded(data) => {
                (TimelineKind::Improved, format!("the device responded {}", hex(data, " ")))
            }
            RequestOutcome::Refused(data) => {
                let code =
                    if data.is_empty() { String::new() } else { format!(" {}", hex(data, " ")) };
                (TimelineKind::Error, format!("refused with an error response{code}"))
            }
            RequestOutcome::NoResponse => {
                let last = self.device(device).map(|device| device.last_seen);
                let last = last.map(|at| format!("; last heard {}", format_time_of_day(self, at)));
                let last = last.unwrap_or_default();
                (TimelineKind::Error, format!("no response within {timeout} ms{last}"))
            }
            RequestOutcome::NotSent(why) => (TimelineKind::Error, format!("not sent: {why}")),
        };
        let sent = frame.map(|frame| format!(" ({frame})")).unwrap_or_default();
        let text = format!("{command}{sent}: {what}");
        let mut line = TimelineEntry::new(event.time, kind, text).on(bus);
        line.device = Some(device);
        line.address = event.address;
        line.name.clone_from(&event.name);
        self.report_line(line);
        let message = format!("{command}: {what}");
        if kind == TimelineKind::Error {
            self.show_error(message);
        } else {
            self.show_info(message);
        }
        if self.commands.ended.len() == MAX_ENDED {
            self.commands.ended.pop_front();
        }
        let (frame, outcome) = (*frame, outcome.clone());
        let ended = EndedCommand { device, command, time: event.time, frame, outcome, text: what };
        self.commands.ended.push_back(ended);
    }

    /// Returns true if a command or a read of a descriptor can be sent to some device.
    pub fn has_command(&self, action: Action) -> bool {
        let is_given =
            |key: ProfileKey| self.buses().iter().any(|bus| bus.config().profile.is_given(key));
        match action {
            Action::Identify => is_given(ProfileKey::Identify),
            Action::ReadDescriptor => {
                DescriptorField::ALL.iter().any(|field| is_given(field.key()))
            }
            _ => DeviceCommand::KEYS.into_iter().any(is_given),
        }
    }
}

/// What is missing in the profile: this key.
pub(crate) fn key_needed(key: ProfileKey) -> String {
    format!("needs a profile with {}: no number is known for sure", key.name())
}
