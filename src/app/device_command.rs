//! Commands to one device: what they are called, what is sent, and what they do to the device.
//!
//! Each needs the key of the profile that has its service number, set in a file. Sends nothing.

use super::input::parse_address;
use crate::bitrate;
use crate::discovery::Device;
use crate::wire::descriptor::{AddressSetting, BitrateSetting};
use crate::wire::id::{Address, Service};
use crate::wire::node::Mode;
use crate::wire::profile::{Profile, ProfileKey, WriteEffect};
use std::fmt;

/// A command to one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceCommand {
    /// It blinks or beeps.
    Identify,
    /// It changes its mode: to one of [`DeviceCommand::MODES`].
    Mode(Mode),
    /// It restarts.
    Restart,
    /// It stores this as DEV_CFG_ADDR.
    Address(AddressSetting),
    /// It stores this as DEV_CFG_BSPD.
    Bitrate(BitrateSetting),
}

/// Forms of commands, for hints and errors.
pub const COMMAND_FORMS: &str = "identify, mode M, restart, address 12 or none, bitrate 250k";

impl DeviceCommand {
    /// The modes that a command can demand; a device enters the others by itself.
    pub const MODES: [Mode; 4] = [Mode::Cfg, Mode::Boot, Mode::Work, Mode::Idle];

    /// The keys of the profile that commands need.
    pub const KEYS: [ProfileKey; 5] = [
        ProfileKey::Identify,
        ProfileKey::Mode,
        ProfileKey::Reboot,
        ProfileKey::WriteAddress,
        ProfileKey::WriteBitrate,
    ];

    /// Reads a command in words: `identify`, `mode IDLE`, `address preferred 12`.
    ///
    /// # Errors
    ///
    /// What is wrong with the text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_whitespace();
        let verb = words.next().unwrap_or_default().to_lowercase();
        let rest: Vec<&str> = words.collect();
        match (verb.as_str(), &rest[..]) {
            ("identify", []) => Ok(Self::Identify),
            ("restart" | "reboot", []) => Ok(Self::Restart),
            ("mode", [word]) => Self::parse_mode(word).map(Self::Mode),
            ("mode", _) => Err("a mode is CFG, BOOT, WORK or IDLE".to_owned()),
            ("address", words) => Self::parse_address(words).map(Self::Address),
            ("bitrate", words) | ("bit", ["rate", words @ ..]) => {
                Self::parse_bitrate(words).map(Self::Bitrate)
            }
            _ => Err(format!("a command is {COMMAND_FORMS}")),
        }
    }

    /// Reads a mode that a command can demand.
    ///
    /// # Errors
    ///
    /// What is wrong with the word.
    pub fn parse_mode(word: &str) -> Result<Mode, String> {
        let mode = Mode::from_name(&word.to_uppercase());
        match mode {
            Some(mode) if Self::MODES.contains(&mode) => Ok(mode),
            Some(mode) => Err(format!("a device enters {mode} by itself: CFG, BOOT, WORK or IDLE")),
            None => Err("a mode is CFG, BOOT, WORK or IDLE".to_owned()),
        }
    }

    /// Reads a setting of the address: `12`, `fixed 12`, `preferred 12` or `none`.
    ///
    /// # Errors
    ///
    /// What is wrong with the words.
    pub fn parse_address(words: &[&str]) -> Result<AddressSetting, String> {
        let address = |text: &str| {
            let number = parse_address(text).and_then(Address::new);
            number.ok_or_else(|| format!("{text} is not an address: 1 to 127, or 0x01 to 0x7F"))
        };
        match words {
            ["none"] => Ok(AddressSetting::None),
            ["fixed" | "preferred"] => Err(format!("{} needs an address: 12", words[0])),
            ["fixed", text] | [text] => address(text).map(AddressSetting::Fixed),
            ["preferred", text] => address(text).map(AddressSetting::Preferred),
            _ => Err("an address is 12, fixed 12, preferred 12 or none".to_owned()),
        }
    }

    /// Reads a setting of the bit rate: `250k`, `fixed 250k` or `preferred 250k`.
    ///
    /// # Errors
    ///
    /// What is wrong with the words.
    pub fn parse_bitrate(words: &[&str]) -> Result<BitrateSetting, String> {
        let (is_fixed, text) = match words {
            ["preferred", text] => (false, text),
            ["fixed", text] | [text] => (true, text),
            _ => return Err("a bit rate is 250k, fixed 250k or preferred 250k".to_owned()),
        };
        let rate = bitrate::parse(text).filter(|rate| BitrateSetting::RATES.contains(rate));
        let rate = rate.ok_or("a bit rate is 125k, 250k, 500k or 1M")?;
        Ok(BitrateSetting { rate, is_fixed })
    }

    /// Returns the key of the profile that has its service number.
    pub const fn key(self) -> ProfileKey {
        match self {
            Self::Identify => ProfileKey::Identify,
            Self::Mode(_) => ProfileKey::Mode,
            Self::Restart => ProfileKey::Reboot,
            Self::Address(_) => ProfileKey::WriteAddress,
            Self::Bitrate(_) => ProfileKey::WriteBitrate,
        }
    }

    /// Returns service number and data of its request; `None` unless a file sets the number.
    pub fn request(self, profile: &Profile) -> Option<(Service, Vec<u8>)> {
        let number = match self {
            Self::Identify => Some(profile.commands.identify),
            Self::Mode(_) => Some(profile.commands.mode),
            Self::Restart => profile.commands.reboot,
            Self::Address(_) => profile.writes.address,
            Self::Bitrate(_) => profile.writes.bitrate,
        };
        let number = number.filter(|_| profile.is_given(self.key()))?;
        let data = match self {
            Self::Identify | Self::Restart => Vec::new(),
            Self::Mode(mode) => vec![profile.modes.codes()[mode as usize]],
            Self::Address(setting) => vec![setting.code()],
            Self::Bitrate(setting) => vec![setting.code()?],
        };
        Some((Service::from_bits(number), data))
    }

    /// What it does to the device, as sentences. `rate`: the bit rate of the bus, if it is known;
    /// `holder`: another device at the address that is to be set, by its name.
    pub fn effect(
        self,
        device: &Device,
        profile: &Profile,
        rate: Option<u32>,
        holder: Option<&str>,
    ) -> String {
        let at_once = profile.writes.effect == WriteEffect::Now;
        let when = if at_once { "" } else { " at its next restart" };
        match self {
            Self::Identify => "It blinks or beeps.".to_owned(),
            Self::Mode(Mode::Idle) => {
                "It stops working; IDLE may end only by switching its power off and on.".to_owned()
            }
            Self::Mode(Mode::Boot) => {
                "It stops working and has no services until its firmware starts again.".to_owned()
            }
            Self::Mode(Mode::Work) => {
                "It begins to work, and may move what it controls.".to_owned()
            }
            Self::Mode(_) => "It stops working until it is set to WORK or restarts.".to_owned(),
            Self::Restart => "It leaves the bus for some seconds.".to_owned(),
            Self::Address(AddressSetting::None) => {
                let from = if at_once { "Without an address" } else { "From its next restart on" };
                format!("{from} it waits in CFG, at a random address, until one is set.")
            }
            Self::Address(AddressSetting::Fixed(address)) => match holder {
                Some(holder) => format!(
                    "{address} is used by {holder}: it stays mute{when} until that is gone."
                ),
                None if at_once && address != device.address => {
                    format!("It leaves the bus for some seconds and comes back at {address}.")
                }
                None if at_once => "It may leave the bus for some seconds.".to_owned(),
                None => format!("It uses {address} and no other address{when}."),
            },
            Self::Address(AddressSetting::Preferred(address)) => {
                let used = holder.map(|holder| format!(" It is used by {holder} now."));
                format!(
                    "It uses {address} if that is free{when}, else another one.{}",
                    used.unwrap_or_default()
                )
            }
            Self::Bitrate(setting) => match rate {
                Some(rate) if rate == setting.rate => {
                    format!("The bus has this bit rate: it stays{when}.")
                }
                Some(rate) if setting.is_fixed => format!(
                    "The bus has {}: it leaves this bus{when}, and is out of reach here.",
                    bitrate::kbit(rate)
                ),
                _ => format!("It may leave this bus{when} if that has another bit rate."),
            },
        }
    }
}

/// Writes it in the words that [`DeviceCommand::parse`] reads.
impl fmt::Display for DeviceCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identify => f.write_str("identify"),
            Self::Mode(mode) => write!(f, "mode {mode}"),
            Self::Restart => f.write_str("restart"),
            Self::Address(setting) => write!(f, "address {setting}"),
            Self::Bitrate(setting) => write!(f, "bit rate {setting}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_as_they_are_written() {
        let address = Address::new(12).unwrap();
        let commands = [
            ("identify", DeviceCommand::Identify),
            ("mode idle", DeviceCommand::Mode(Mode::Idle)),
            ("reboot", DeviceCommand::Restart),
            ("address 0x0C", DeviceCommand::Address(AddressSetting::Fixed(address))),
            ("address preferred 12", DeviceCommand::Address(AddressSetting::Preferred(address))),
            ("address none", DeviceCommand::Address(AddressSetting::None)),
            (
                "bitrate 1M",
                DeviceCommand::Bitrate(BitrateSetting { rate: 1_000_000, is_fixed: true }),
            ),
        ];
        for (text, command) in commands {
            assert_eq!(DeviceCommand::parse(text), Ok(command), "{text}");
        }
        for (_, command) in &commands[..6] {
            assert_eq!(DeviceCommand::parse(&command.to_string()), Ok(*command));
        }
        for wrong in ["", "mode", "mode INIT", "mode X", "address 0", "address 128", "bitrate 800k"]
        {
            assert!(DeviceCommand::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn command_needs_its_own_key_in_a_file() {
        let all = [
            (DeviceCommand::Identify, "[commands]\nidentify = 0x018"),
            (DeviceCommand::Mode(Mode::Idle), "[commands]\nmode = 0x019"),
            (DeviceCommand::Restart, "[commands]\nreboot = 0x01A"),
            (DeviceCommand::Address(AddressSetting::None), "[writes]\naddress = 0x016"),
            (
                DeviceCommand::Bitrate(BitrateSetting { rate: 125_000, is_fixed: true }),
                "[writes]\nbitrate = 0x015",
            ),
        ];
        for (at, (_, file)) in all.iter().enumerate() {
            let profile = Profile::parse(file).unwrap();
            for (other, (command, _)) in all.iter().enumerate() {
                assert_eq!(command.request(&profile).is_some(), at == other, "{command}: {file}");
            }
        }
        let none = Profile::parse("[commands]\nreboot = false").unwrap();
        assert_eq!(DeviceCommand::Restart.request(&none), None);
    }
}
