//! The responder for firmware: two C99 files, and a header with the numbers of a profile; for the same
//! node in Rust a module with them.
//!
//! Input: a [`Profile`] and what the device is; output: the text of des_config.h or des_config.rs. The files are
//! tested by tests/it/kit. Pure: opens and writes no files. Does not know C compilers or boards.

mod rust_config;

pub use rust_config::rust_config;

use crate::wire::des::{MAX_MESSAGE, MAX_SERVICES};
use crate::wire::descriptor::{ByteOrder, DescriptorField};
use crate::wire::node::Mode;
use crate::wire::profile::{FramingChoice, Profile, ProfileKey, ValueOrigin, WriteEffect};
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// des.h, the interface.
pub const HEADER: &str = include_str!("des.h");
/// des.c, the implementation.
pub const SOURCE: &str = include_str!("des.c");

/// Keys of the codes of the modes, in the order of [`Mode::ALL`].
const MODE_KEYS: [ProfileKey; 7] = [
    ProfileKey::Init,
    ProfileKey::Arslv,
    ProfileKey::Cfg,
    ProfileKey::Boot,
    ProfileKey::Work,
    ProfileKey::Ufunc,
    ProfileKey::Idle,
];

/// What a device is, for [`config`] and [`rust_config`].
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct KitDevice {
    /// Name; without a zero byte.
    pub name: String,
    /// Name and version of its services, in the order of their indices; without a zero byte.
    pub services: Vec<(String, String)>,
    /// True: its controller sends CAN FD frames. The node in Rust has them in any case.
    pub has_fd: bool,
}

/// Why a header cannot be written for a device and a profile.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum KitFault {
    /// A response exceeds [`MAX_MESSAGE`].
    #[error("{0} response: {1} bytes exceed the limit of 4095")]
    TooLong(&'static str, usize),
    /// More than [`MAX_SERVICES`] services.
    #[error("{0} services exceed the limit of 256")]
    TooManyServices(usize),
    /// Two services have one name.
    #[error("service {0} is listed twice")]
    ListedTwice(String),
}

/// Returns the text of des_config.h.
///
/// Values that the profile does not set are marked as assumed. Commands and writes that it does not
/// set are not served.
///
/// # Errors
/// [`KitFault`] if a response is too long or two services have one name.
pub fn config(device: &KitDevice, profile: &Profile) -> Result<String, KitFault> {
    check(device)?;
    let mut text = String::from(
        "/*\n * des_config.h - what the device is, and the numbers of the profile, for des.h.\n \
         * Written by descan kit: change the profile and write it again.\n */\n\
         #ifndef DES_CONFIG_H\n#define DES_CONFIG_H\n\n",
    );
    names(&mut text, device);
    switches(&mut text, device, profile);
    numbers(&mut text, profile);
    heartbeat(&mut text, profile);
    text.push_str("\n#endif\n");
    Ok(text)
}

fn check(device: &KitDevice) -> Result<(), KitFault> {
    let name = device.name.len() + 2;
    if name > MAX_MESSAGE {
        return Err(KitFault::TooLong("name", name));
    }
    if device.services.len() > MAX_SERVICES {
        return Err(KitFault::TooManyServices(device.services.len()));
    }
    let services = device.services.iter().map(|(name, version)| name.len() + version.len() + 3);
    let services = 1 + services.sum::<usize>();
    if services > MAX_MESSAGE {
        return Err(KitFault::TooLong("services", services));
    }
    let mut names = BTreeSet::new();
    match device.services.iter().find(|(name, _)| !names.insert(name)) {
        Some((name, _)) => Err(KitFault::ListedTwice(name.clone())),
        None => Ok(()),
    }
}

/// A string of C: what is not plain is an octal escape of three digits, which no digit prolongs.
fn c_string(text: &str) -> String {
    let mut quoted = String::from("\"");
    for byte in text.bytes() {
        match byte {
            b'"' | b'\\' | b'?' | 0..=0x1F | 0x7F.. => {
                let _ = write!(quoted, "\\{byte:03o}");
            }
            _ => quoted.push(char::from(byte)),
        }
    }
    quoted + "\""
}

fn names(text: &mut String, device: &KitDevice) {
    let _ = writeln!(text, "#define DES_NAME {}", c_string(&device.name));
    text.push_str("#define DES_SERVICES");
    for (index, (name, version)) in device.services.iter().enumerate() {
        let (name, version) = (c_string(name), c_string(version));
        let _ = write!(text, " \\\n    DES_SERVICE(\"\\{index:03o}\", {name}, {version})");
    }
    text.push_str(if device.services.is_empty() { " \"\"\n\n" } else { "\n\n" });
}

/// A line with a value of the profile.
fn value(text: &mut String, name: &str, value: &str, profile: &Profile, key: ProfileKey) {
    let is_assumed = profile.origin(key) == ValueOrigin::Assumed;
    let note = if is_assumed { " /* assumed */" } else { "" };
    let _ = writeln!(text, "#define {name} {value}{note}");
}

fn switches(text: &mut String, device: &KitDevice, profile: &Profile) {
    let is_set = |key| profile.origin(key) != ValueOrigin::Assumed;
    let has_writes = profile.writes.address.is_some() || profile.writes.bitrate.is_some();
    let has_commands = is_set(ProfileKey::Identify)
        || is_set(ProfileKey::Mode)
        || profile.commands.reboot.is_some();
    let has_raw = profile.framing != FramingChoice::Isotp;
    for (name, is_on) in [
        ("FD", device.has_fd),
        ("RAW", has_raw),
        ("WRITES", has_writes),
        ("COMMANDS", has_commands),
    ] {
        let _ = writeln!(text, "#define DES_WITH_{name} {}", u8::from(is_on));
    }
    text.push('\n');
}

fn numbers(text: &mut String, profile: &Profile) {
    let hex = |number: u16| format!("0x{number:03X}u");
    let services = &profile.services;
    value(text, "DES_SRV_HEARTBEAT", &hex(services.heartbeat), profile, ProfileKey::Heartbeat);
    value(text, "DES_SRV_DES", &hex(services.des), profile, ProfileKey::Des);
    for field in DescriptorField::ALL {
        let name = format!("DES_SRV_{}", field.name().to_uppercase());
        let number = field.service(&profile.descriptor).number();
        value(text, &name, &hex(number), profile, field.key());
    }
    let given = |key, number: u16| (profile.origin(key) != ValueOrigin::Assumed).then_some(number);
    let commands = &profile.commands;
    for (name, number) in [
        ("IDENTIFY", given(ProfileKey::Identify, commands.identify)),
        ("MODE", given(ProfileKey::Mode, commands.mode)),
        ("REBOOT", commands.reboot),
        ("WRITE_ADDRESS", profile.writes.address),
        ("WRITE_BITRATE", profile.writes.bitrate),
    ] {
        let number = number.map_or("DES_NONE /* not in the profile */".to_owned(), hex);
        let _ = writeln!(text, "#define DES_SRV_{name} {number}");
    }
    let at_restart = u8::from(profile.writes.effect == WriteEffect::Restart).to_string();
    value(text, "DES_WRITES_AT_RESTART", &at_restart, profile, ProfileKey::WriteEffect);
    let is_big = u8::from(profile.descriptor.byte_order == ByteOrder::Big).to_string();
    value(text, "DES_BIG_ENDIAN", &is_big, profile, ProfileKey::ByteOrder);
    let padding = format!("0x{:02X}u", profile.isotp.fd_padding);
    value(text, "DES_FD_PADDING", &padding, profile, ProfileKey::FdPadding);
    text.push('\n');
}

fn heartbeat(text: &mut String, profile: &Profile) {
    let layout = &profile.heartbeat;
    let period = format!("{}u", layout.period_ms);
    value(text, "DES_HEARTBEAT_MS", &period, profile, ProfileKey::PeriodMs);
    for (name, key, offset, most) in [
        ("UID", ProfileKey::UidOffset, layout.uid_offset, 2),
        ("MODE", ProfileKey::ModeOffset, layout.mode_offset, 7),
        ("ERROR", ProfileKey::ErrorOffset, layout.error_offset, 7),
    ] {
        // A field that ends behind the eighth byte is left out, as descan does.
        let offset = offset.filter(|at| *at <= most).map_or("-1".to_owned(), |at| at.to_string());
        value(text, &format!("DES_HEARTBEAT_{name}_AT"), &offset, profile, key);
    }
    for ((mode, code), key) in Mode::ALL.into_iter().zip(profile.modes.codes()).zip(MODE_KEYS) {
        value(text, &format!("DES_CODE_{mode}"), &code.to_string(), profile, key);
    }
}
