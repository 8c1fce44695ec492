//! Reading of profile files (TOML).

use super::{Announce, Profile};
use crate::wire::id::Service;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;

/// Why a profile cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// Not TOML, or an unknown name or type.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A value outside its range.
    #[error("{key}: {value} is not {expected}")]
    Range {
        /// Name of the value.
        key: &'static str,
        /// The value given.
        value: String,
        /// The allowed values.
        expected: &'static str,
    },
}

impl Profile {
    /// Reads a profile, a TOML file that may set any part of the values.
    ///
    /// ```
    /// use descan::wire::profile::Profile;
    ///
    /// let profile = Profile::parse("services.des = 0x005").unwrap();
    /// assert_eq!(profile.des_service().number(), 5);
    /// ```
    ///
    /// # Errors
    /// [`ProfileError`] if the text is not TOML, has unknown names, or a value is out of range.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        let mut profile: Self = toml::from_str(text)?;
        profile.given = true;
        profile.check()?;
        Ok(profile)
    }

    fn check(&self) -> Result<(), ProfileError> {
        let range =
            |key, value: String, expected| Err(ProfileError::Range { key, value, expected });
        let services = [
            ("services.heartbeat", self.services.heartbeat),
            ("services.des", self.services.des),
            ("services.config", self.services.config),
            ("services.config_mask", self.services.config_mask),
            ("descriptor.gid", self.descriptor.gid),
            ("descriptor.uid", self.descriptor.uid),
            ("descriptor.sn", self.descriptor.sn),
            ("descriptor.fw", self.descriptor.fw),
            ("descriptor.caps", self.descriptor.caps),
            ("descriptor.bspd", self.descriptor.bspd),
            ("descriptor.addr", self.descriptor.addr),
            ("descriptor.autostart", self.descriptor.autostart),
            ("commands.identify", self.commands.identify),
            ("commands.mode", self.commands.mode),
        ];
        for (key, number) in services {
            if number > 0x3FF {
                return range(key, number.to_string(), "a service number, 0 to 0x3FF");
            }
        }
        if self.services.heartbeat == self.services.des {
            let value = self.services.des.to_string();
            return range("services.des", value, "another number than services.heartbeat");
        }
        if !(10..=60_000).contains(&self.heartbeat.period_ms) {
            let value = self.heartbeat.period_ms.to_string();
            return range("heartbeat.period_ms", value, "10 to 60000 milliseconds");
        }
        if !(1..=60_000).contains(&self.calls.timeout_ms) {
            let value = self.calls.timeout_ms.to_string();
            return range("calls.timeout_ms", value, "1 to 60000 milliseconds");
        }
        let mut codes = self.modes.codes();
        codes.sort_unstable();
        if codes.windows(2).any(|pair| pair[0] == pair[1]) {
            return range("modes", format!("{:?}", self.modes.codes()), "seven different codes");
        }
        Ok(())
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
            self.service_names.get(&number).map(String::as_str)
        }
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
