//! Reading of profile files (TOML).

use super::{Announce, HeartbeatProfile, Profile, ProfileKey, ProfileValue, ValueOrigin};
use crate::toml_error::{TomlError, ValuePlaces};
use crate::wire::descriptor::ByteOrder;
use crate::wire::id::Service;
use crate::wire::node::Uid;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;

/// A value out of its range: its name, what it is, and what is allowed.
struct RangeFault {
    key: &'static str,
    value: String,
    expected: String,
    /// The key with the same value; that one may be built in, or this one.
    other: Option<&'static str>,
}

impl Profile {
    /// Reads a profile, a TOML file that may set any part of the values.
    ///
    /// ```
    /// use descan::wire::profile::{Profile, ProfileKey, ValueOrigin};
    ///
    /// let profile = Profile::parse("services.des = 0x005").unwrap();
    /// assert_eq!(profile.des_service().number(), 5);
    /// assert_eq!(profile.origin(ProfileKey::Des), ValueOrigin::Given);
    /// assert_eq!(profile.origin(ProfileKey::Heartbeat), ValueOrigin::Assumed);
    /// ```
    ///
    /// # Errors
    /// [`TomlError`] if the text is not TOML, has unknown names, or a value is out of range.
    pub fn parse(text: &str) -> Result<Self, TomlError> {
        let mut profile: Self =
            toml::from_str(text).map_err(|error| TomlError::of(text, &error))?;
        let places = ValuePlaces::of(text);
        profile.check().map_err(|RangeFault { key, value, expected, other }| {
            let span = places.get(key).or_else(|| places.get(other?));
            TomlError::new(text, span, format!("{key}: {value} is not {expected}"))
        })?;
        for key in ProfileKey::ALL {
            let is_empty = match key {
                ProfileKey::ServiceNames => profile.service_names.is_empty(),
                ProfileKey::DebugNames => profile.debug_names.is_empty(),
                _ => false,
            };
            if places.contains(key.name()) && !is_empty {
                profile.set_origin(*key, ValueOrigin::Given);
            }
        }
        if let Some((key, other)) = profile.shared_byte() {
            let (name, value) = (key.name(), profile.value(key));
            let message = format!("{name}: {value} is a byte of {}, too", other.name());
            return Err(TomlError::new(text, places.get(name), message));
        }
        if let Some((key, other)) = profile.shared_number() {
            let span = [key, other].into_iter().find_map(|key| places.get(key.name()));
            let (name, value) = (key.name(), profile.value(key));
            let message = format!("{name}: {value} is the number of {}, too", other.name());
            return Err(TomlError::new(text, span, message));
        }
        Ok(profile)
    }

    /// Returns two keys with one service number, of those that are sent or received: a read would be a
    /// command. A field may be written by the number that reads it.
    fn shared_number(&self) -> Option<(ProfileKey, ProfileKey)> {
        use ProfileKey as Key;
        let is_used = |key: &&Key| {
            let is_number = !matches!(key, Key::Config | Key::ConfigMask);
            is_number && (self.is_given(**key) || matches!(key, Key::Heartbeat | Key::Des))
        };
        let number = |key: &Key| match self.value(*key) {
            ProfileValue::Service(number) => Some((*key, number)),
            _ => None,
        };
        let used: Vec<(Key, u16)> = Key::ALL.iter().filter(is_used).filter_map(number).collect();
        let may_share = |one, other| {
            matches!((one, other), (Key::Addr, Key::WriteAddress) | (Key::Bspd, Key::WriteBitrate))
        };
        used.iter().enumerate().find_map(|(at, (other, number))| {
            let mut later = used[at + 1..].iter();
            let same = later.find(|(key, it)| it == number && !may_share(*other, *key))?;
            Some((same.0, *other))
        })
    }

    fn check(&self) -> Result<(), RangeFault> {
        use ProfileKey as Key;
        let range = |key, value: String, expected: &str| {
            Err(RangeFault { key, value, expected: expected.to_owned(), other: None })
        };
        for key in ProfileKey::ALL {
            if let ProfileValue::Service(number) = self.value(*key)
                && number > 0x3FF
            {
                return range(key.name(), number.to_string(), "a service number, 0 to 0x3FF");
            }
        }
        if self.services.heartbeat == self.services.des {
            let value = self.services.des.to_string();
            let expected = "another number than services.heartbeat".to_owned();
            let other = Some("services.heartbeat");
            return Err(RangeFault { key: "services.des", value, expected, other });
        }
        if !HeartbeatProfile::PERIODS.contains(&self.heartbeat.period_ms) {
            let value = self.heartbeat.period_ms.to_string();
            return range("heartbeat.period_ms", value, "10 to 60000 milliseconds");
        }
        if !(1..=60_000).contains(&self.calls.timeout_ms) {
            let value = self.calls.timeout_ms.to_string();
            return range("calls.timeout_ms", value, "1 to 60000 milliseconds");
        }
        let codes = self.modes.codes();
        let keys = [Key::Init, Key::Arslv, Key::Cfg, Key::Boot, Key::Work, Key::Ufunc, Key::Idle];
        for (at, key) in keys.into_iter().enumerate() {
            if let Some(other) = codes[..at].iter().position(|code| *code == codes[at]) {
                let (key, value, other) = (key.name(), codes[at].to_string(), keys[other].name());
                let expected = format!("another code than {other}");
                return Err(RangeFault { key, value, expected, other: Some(other) });
            }
        }
        Ok(())
    }

    /// Returns two offsets of the heartbeat that are given, and have a byte in common.
    fn shared_byte(&self) -> Option<(ProfileKey, ProfileKey)> {
        use ProfileKey as Key;
        let layout = &self.heartbeat;
        let fields = [
            (Key::UidOffset, layout.uid_offset, Uid::LEN as u8),
            (Key::ModeOffset, layout.mode_offset, 1),
            (Key::ErrorOffset, layout.error_offset, 1),
        ];
        let given = fields.into_iter().filter(|(key, ..)| self.is_given(*key));
        let given: Vec<_> = given.filter_map(|(key, at, size)| Some((key, at?, size))).collect();
        given.iter().enumerate().find_map(|(place, (key, at, size))| {
            let mut before = given[..place].iter();
            let is_shared = |(_, other, length): &&(Key, u8, u8)| {
                u16::from(*at) < u16::from(*other) + u16::from(*length)
                    && u16::from(*other) < u16::from(*at) + u16::from(*size)
            };
            before.find(is_shared).map(|(other, ..)| (*key, *other))
        })
    }

    /// Returns the displayed name of a service, from the platform or from `service_names`; `None`
    /// if it has none.
    pub fn service_name(&self, service: Service) -> Option<&str> {
        let number = service.number();
        if number == self.services.heartbeat {
            Some("HR")
        } else if number == self.services.des {
            Some("DES")
        } else {
            let named = self.service_names.get(&number).map(String::as_str);
            named.or_else(|| self.configuration_name(number))
        }
    }

    /// Returns the name of a service of the descriptor, of a command or of a write whose number is
    /// given.
    fn configuration_name(&self, number: u16) -> Option<&'static str> {
        use ProfileKey as Key;
        const NAMES: [(ProfileKey, &str); 13] = [
            (Key::Gid, "GID"),
            (Key::Uid, "UID"),
            (Key::Sn, "SN"),
            (Key::Fw, "FW"),
            (Key::Caps, "CAPS"),
            (Key::Bspd, "BSPD"),
            (Key::Addr, "ADDR"),
            (Key::Autostart, "AUTOSTART"),
            (Key::Identify, "IDENTIFY"),
            (Key::Mode, "MODE"),
            (Key::Reboot, "REBOOT"),
            (Key::WriteAddress, "ADDR"),
            (Key::WriteBitrate, "BSPD"),
        ];
        let is_it = |(key, _): &&(ProfileKey, &str)| {
            self.is_given(*key) && self.value(*key) == ProfileValue::Service(number)
        };
        NAMES.iter().find(is_it).map(|(_, name)| *name)
    }
}

impl Profile {
    /// Returns the name of a DEBUG message from `debug_names`, else its code.
    pub fn debug_text(&self, code: Service) -> String {
        let name = self.debug_names.get(&code.number());
        name.map_or_else(|| code.to_string(), |name| crate::text::printable(name.as_bytes()))
    }
}

impl<'de> Deserialize<'de> for Announce {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum AnnounceValue {
            Switch(bool),
            Word(String),
        }
        match AnnounceValue::deserialize(deserializer)? {
            AnnounceValue::Switch(true) => Ok(Self::Always),
            AnnounceValue::Switch(false) => Ok(Self::Never),
            AnnounceValue::Word(word) if word == "auto" => Ok(Self::Auto),
            AnnounceValue::Word(word) => Err(serde::de::Error::custom(format!(
                "announce is true, false or \"auto\", not \"{word}\""
            ))),
        }
    }
}

/// Reads 0 or 1 as a truth value.
pub(super) fn bit<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    match u8::deserialize(deserializer)? {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(serde::de::Error::custom(format!("a bit is 0 or 1, not {other}"))),
    }
}

/// Reads an offset, or `false` for a field that the heartbeat does not carry.
pub(super) fn offset<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum OffsetValue {
        Offset(u8),
        Switch(bool),
    }
    match OffsetValue::deserialize(deserializer)? {
        OffsetValue::Offset(at) if at < 64 => Ok(Some(at)),
        OffsetValue::Switch(false) => Ok(None),
        _ => Err(serde::de::Error::custom("an offset is 0 to 63, or false for none")),
    }
}

/// Reads `little` or `big`.
pub(crate) fn byte_order<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<ByteOrder, D::Error> {
    let word = String::deserialize(deserializer).unwrap_or_default();
    let order = ByteOrder::ALL.into_iter().find(|order| order.word() == word);
    order.ok_or_else(|| serde::de::Error::custom("a byte order is \"little\" or \"big\""))
}

/// Reads a service number. Its range is checked with its name.
pub(super) fn service<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    let wrong = "a service number is 0 to 0x3FF (1023), without quotes";
    u16::deserialize(deserializer).map_err(|_| serde::de::Error::custom(wrong))
}

/// Reads a service number, or `false` for none.
pub(super) fn service_or_none<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<u16>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum ServiceValue {
        Number(u16),
        Switch(bool),
    }
    match ServiceValue::deserialize(deserializer) {
        Ok(ServiceValue::Number(number)) => Ok(Some(number)),
        Ok(ServiceValue::Switch(false)) => Ok(None),
        _ => Err(serde::de::Error::custom("a service number is 0 to 0x3FF, or false for none")),
    }
}

/// Reads 64 printable characters.
pub(super) fn alphabet<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[char; 64], D::Error> {
    let text = String::deserialize(deserializer)?;
    let characters: Vec<char> = text.chars().collect();
    let count = characters.len();
    if let Some(odd) = characters.iter().find(|&&c| !crate::text::is_printable(c)) {
        return Err(serde::de::Error::custom(format!("{odd:?} is not printable")));
    }
    characters.try_into().map_err(|_| {
        serde::de::Error::custom(format!("an alphabet has 64 characters, not {count}"))
    })
}

/// Reads a table of names whose keys are service numbers, decimal or `0x…`.
pub(super) fn service_names<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<u16, String>, D::Error> {
    let written = BTreeMap::<String, String>::deserialize(deserializer)?;
    written
        .into_iter()
        .map(|(key, name)| {
            let number = key
                .strip_prefix("0x")
                .map_or_else(|| key.parse().ok(), |hex| u16::from_str_radix(hex, 16).ok())
                .filter(|number| *number < 1024);
            let number = number.ok_or_else(|| {
                serde::de::Error::custom(format!(
                    "\"{key}\" is not a service number (0 to 1023, or \"0x…\" up to 3FF)"
                ))
            })?;
            Ok((number, name))
        })
        .collect()
}
