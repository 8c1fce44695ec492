//! The configuration of the node in Rust (`src/node`): what the device is, and the numbers of a profile.
//!
//! Input: a [`Profile`] and what the device is; output: the text of des_config.rs, with the same values as
//! `NodeConfig::from_profile`. Pure: opens and writes no files. Does not know the node.

use super::{KitDevice, KitFault, MODE_KEYS, check};
use crate::wire::descriptor::{ByteOrder, DescriptorField};
use crate::wire::node::Mode;
use crate::wire::profile::{FramingChoice, Profile, ProfileKey, ValueOrigin, WriteEffect};
use std::fmt::Write as _;

/// Returns the text of des_config.rs, a module with `DEVICE` and `CONFIG`.
///
/// Values that the profile does not set are marked as assumed. Commands and writes that it does not
/// set are not served.
///
/// # Errors
/// [`KitFault`] if a response is too long or two services have one name.
pub fn rust_config(device: &KitDevice, profile: &Profile) -> Result<String, KitFault> {
    check(device)?;
    let mut text = String::from(
        "// des_config.rs - what the device is, and the numbers of the profile, for descan::node.\n\
         // Written by descan kit --lang rust: change the profile and write it again.\n\n\
         use descan::node::{NodeConfig, NodeDevice};\n\
         use descan::wire::descriptor::ByteOrder;\n\
         use descan::wire::id::Service;\n\
         use descan::wire::profile::WriteEffect;\n\n",
    );
    write_device(&mut text, device);
    text.push_str(
        "\n/// The numbers of the profile.\n#[rustfmt::skip]\n\
         pub static CONFIG: NodeConfig = NodeConfig {\n",
    );
    write_numbers(&mut text, profile);
    write_layout(&mut text, profile);
    text.push_str("    ..NodeConfig::DEFAULT\n};\n");
    Ok(text)
}

fn write_device(text: &mut String, device: &KitDevice) {
    text.push_str(
        "/// What the device is; GID, serial number and firmware version: NodeDevice { gid, ..DEVICE }.\n#[rustfmt::skip]\n\
         pub static DEVICE: NodeDevice<'static> = NodeDevice {\n    services: &[\n",
    );
    for (name, version) in &device.services {
        let _ = writeln!(text, "        &[{name:?}, {version:?}],");
    }
    let _ = writeln!(text, "    ],\n    ..NodeDevice::named({:?})\n}};", device.name);
}

/// A line with a value, and where it comes from.
fn field(text: &mut String, name: &str, value: &str, profile: &Profile, key: ProfileKey) {
    let is_assumed = profile.origin(key) == ValueOrigin::Assumed;
    let note = if is_assumed { " // assumed" } else { "" };
    let _ = writeln!(text, "    {name}: {value},{note}");
}

/// Ends a comment.
fn assumed(profile: &Profile, key: ProfileKey) -> &'static str {
    if profile.origin(key) == ValueOrigin::Assumed { ", assumed" } else { "" }
}

fn service(number: u16) -> String {
    format!("Service::from_bits(0x{number:03X})")
}

fn write_numbers(text: &mut String, profile: &Profile) {
    let services = &profile.services;
    field(text, "heartbeat", &service(services.heartbeat), profile, ProfileKey::Heartbeat);
    field(text, "des", &service(services.des), profile, ProfileKey::Des);
    text.push_str("    descriptor: [\n");
    for it in DescriptorField::ALL {
        let number = service(it.service(&profile.descriptor).number());
        let note = assumed(profile, it.key());
        let _ = writeln!(text, "        Some({number}), // {}{note}", it.name());
    }
    text.push_str("    ],\n");
    let given = |key, number: u16| (profile.origin(key) != ValueOrigin::Assumed).then_some(number);
    let commands = &profile.commands;
    for (name, number) in [
        ("identify", given(ProfileKey::Identify, commands.identify)),
        ("mode", given(ProfileKey::Mode, commands.mode)),
        ("reboot", commands.reboot),
        ("write_address", profile.writes.address),
        ("write_bitrate", profile.writes.bitrate),
    ] {
        let _ = match number {
            Some(number) => writeln!(text, "    {name}: Some({}),", service(number)),
            None => writeln!(text, "    {name}: None, // not in the profile"),
        };
    }
}

fn write_layout(text: &mut String, profile: &Profile) {
    let effect = match profile.writes.effect {
        WriteEffect::Now => "WriteEffect::Now",
        WriteEffect::Restart => "WriteEffect::Restart",
    };
    field(text, "write_effect", effect, profile, ProfileKey::WriteEffect);
    let layout = &profile.heartbeat;
    field(text, "heartbeat_ms", &layout.period_ms.to_string(), profile, ProfileKey::PeriodMs);
    for (name, key, offset) in [
        ("uid_offset", ProfileKey::UidOffset, layout.uid_offset),
        ("mode_offset", ProfileKey::ModeOffset, layout.mode_offset),
        ("error_offset", ProfileKey::ErrorOffset, layout.error_offset),
    ] {
        field(text, name, &format!("{offset:?}"), profile, key);
    }
    text.push_str("    mode_codes: [\n");
    for ((mode, code), key) in Mode::ALL.into_iter().zip(profile.modes.codes()).zip(MODE_KEYS) {
        let _ = writeln!(text, "        {code}, // {mode}{}", assumed(profile, key));
    }
    text.push_str("    ],\n");
    let order = match profile.descriptor.byte_order {
        ByteOrder::Little => "ByteOrder::Little",
        ByteOrder::Big => "ByteOrder::Big",
    };
    field(text, "byte_order", order, profile, ProfileKey::ByteOrder);
    let has_raw = profile.framing != FramingChoice::Isotp;
    field(text, "has_raw_framing", &has_raw.to_string(), profile, ProfileKey::Framing);
    let padding = format!("0x{:02X}", profile.isotp.fd_padding);
    field(text, "fd_padding", &padding, profile, ProfileKey::FdPadding);
}
