//! The data of the services of the descriptor, of commands and of writes, in words: those whose number
//! is given. A number that is only assumed may be another service.

use crate::discovery::FieldContent;
use crate::wire::descriptor::{AddressSetting, BitrateSetting, DescriptorField, DescriptorValue};
use crate::wire::id::{Header, Service};
use crate::wire::profile::{Profile, ProfileKey};

/// Returns what the data of a frame say; `None` if its service is none of these.
pub(super) fn configuration_text(profile: &Profile, header: Header, data: &[u8]) -> Option<String> {
    if header.broadcast {
        return None;
    }
    let service = header.service;
    if !header.response {
        return request_text(profile, service, data);
    }
    let (field, content) =
        descriptor_content(profile, service, data).filter(|_| header.no_error)?;
    Some(format!("{} {}", field.label(), content.in_words(&profile.uid)))
}

/// Returns the field of the descriptor that a response without error on a service is about, and what its
/// data are; `None` if it is about none, or has no data.
pub(in crate::app) fn descriptor_content(
    profile: &Profile,
    service: Service,
    data: &[u8],
) -> Option<(DescriptorField, FieldContent)> {
    let field = field_of(profile, service).filter(|_| !data.is_empty())?;
    let content = match DescriptorValue::decode(field, data, profile.descriptor.byte_order) {
        Ok(value) => FieldContent::Value(value),
        Err(fault) => FieldContent::Malformed { data: data.to_vec(), fault },
    };
    Some((field, content))
}

/// The field of the descriptor that a service reads.
fn field_of(profile: &Profile, service: Service) -> Option<DescriptorField> {
    let is_it = |field: &DescriptorField| {
        profile.is_given(field.key()) && field.service(&profile.descriptor) == service
    };
    DescriptorField::ALL.into_iter().find(is_it)
}

fn request_text(profile: &Profile, service: Service, data: &[u8]) -> Option<String> {
    let number = service.number();
    let (commands, writes) = (&profile.commands, &profile.writes);
    if number == commands.identify && profile.is_given(ProfileKey::Identify) {
        return Some("identify".to_owned());
    }
    if number == commands.mode && profile.is_given(ProfileKey::Mode) {
        let code = *data.first()?;
        let mode = profile.modes.mode(code);
        return Some(mode.map_or(format!("mode 0x{code:02X}"), |mode| format!("mode {mode}")));
    }
    if Some(number) == commands.reboot {
        return Some("restart".to_owned());
    }
    match data.first() {
        Some(code) if Some(number) == writes.address => {
            Some(format!("write address {}", AddressSetting::from_code(*code)?))
        }
        Some(code) if Some(number) == writes.bitrate => {
            Some(format!("write bit rate {}", BitrateSetting::from_code(*code)?))
        }
        Some(_) => None,
        None => field_of(profile, service).map(|field| format!("read {}", field.label())),
    }
}
