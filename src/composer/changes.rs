//! What a request changes in a device, by the service numbers of the profile, assumed ones included.
//!
//! A number that is only assumed may be another service of the device: it is named all the same, with
//! that doubt.

use crate::text::hex;
use crate::wire::descriptor::{AddressSetting, BitrateSetting, DescriptorField};
use crate::wire::id::{Header, Service};
use crate::wire::node::Mode;
use crate::wire::profile::{Profile, ProfileKey};

/// What a request does to its receivers: `sets the mode to IDLE`; `None` if it only reads, as far as the
/// profile says.
pub(super) fn change_of(header: Header, message: &[u8], profile: &Profile) -> Option<String> {
    if header.response || header.from_non_working {
        return None;
    }
    let (what, key) = known_change(header.service, message, profile)?;
    let doubt = if profile.is_given(key) { "" } else { " (if the assumed number is right)" };
    Some(format!("{what}{doubt}"))
}

fn known_change(
    service: Service,
    message: &[u8],
    profile: &Profile,
) -> Option<(String, ProfileKey)> {
    let number = service.number();
    let first = message.first().copied();
    let (commands, writes) = (&profile.commands, &profile.writes);
    if number == commands.identify {
        return Some(("makes it blink or beep".to_owned(), ProfileKey::Identify));
    }
    if number == commands.mode {
        let code = first?;
        let mode = profile.modes.mode(code);
        let effect = match mode {
            Some(Mode::Idle) => ", which may end only by switching the power off and on",
            Some(Mode::Boot) => ", with no services until its firmware starts again",
            _ => "",
        };
        let mode = mode.map_or(format!("code 0x{code:02X}"), |mode| mode.to_string());
        return Some((format!("sets the mode to {mode}{effect}"), ProfileKey::Mode));
    }
    if Some(number) == commands.reboot {
        return Some(("restarts it".to_owned(), ProfileKey::Reboot));
    }
    // An empty request reads.
    let code = first?;
    let is_of = |field: DescriptorField| field.service(&profile.descriptor) == service;
    if Some(number) == writes.address || is_of(DescriptorField::Address) {
        let setting = AddressSetting::from_code(code);
        let effect = match setting {
            Some(AddressSetting::None) => ", so that it waits in CFG until one is set",
            Some(AddressSetting::Fixed(_)) => ", where it stays mute if that is used",
            _ => "",
        };
        let setting = setting.map_or(format!("code 0x{code:02X}"), |it| it.to_string());
        let is_write = Some(number) == writes.address;
        let key = if is_write { ProfileKey::WriteAddress } else { ProfileKey::Addr };
        return Some((format!("sets its address to {setting}{effect}"), key));
    }
    if Some(number) == writes.bitrate || is_of(DescriptorField::Bitrate) {
        let setting = BitrateSetting::from_code(code);
        let setting = setting.map_or(format!("code 0x{code:02X}"), |it| it.to_string());
        let is_write = Some(number) == writes.bitrate;
        let key = if is_write { ProfileKey::WriteBitrate } else { ProfileKey::Bspd };
        return Some((format!("sets its bit rate to {setting}, and may leave this bus"), key));
    }
    if let Some(field) = DescriptorField::ALL.into_iter().find(|field| is_of(*field)) {
        let text = format!("may set its {} to {}", field.label(), hex(message, " "));
        return Some((text, field.key()));
    }
    let services = &profile.services;
    let is_config = number & services.config_mask == services.config & services.config_mask;
    is_config.then(|| {
        let key = ProfileKey::Config;
        (format!("may change its configuration (service {service})"), key)
    })
}
