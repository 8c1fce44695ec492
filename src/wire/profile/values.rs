//! Values of the profile by key, for the screen, for JSON and for files.

use super::{Announce, FramingChoice, Profile, ProfileKey, ValueOrigin};
use crate::wire::descriptor::ByteOrder;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Write as _};

/// The value of a key. As text it is what a file says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
#[non_exhaustive]
pub enum ProfileValue {
    /// A service number, or a mask of them.
    Service(u16),
    /// Another number.
    Number(u32),
    /// A switch; false for an offset or a service that there is none.
    Switch(bool),
    /// A text.
    Text(String),
    /// Names of services by number.
    Names(BTreeMap<u16, String>),
}

impl fmt::Display for ProfileValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Service(number) => write!(f, "0x{number:03X}"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Switch(is_on) => write!(f, "{is_on}"),
            Self::Text(text) => f.write_str(&quoted(text)),
            Self::Names(names) => {
                f.write_str("{")?;
                for (at, (number, name)) in names.iter().enumerate() {
                    let comma = if at == 0 { "" } else { "," };
                    write!(f, "{comma} \"0x{number:03X}\" = {}", quoted(name))?;
                }
                f.write_str(if names.is_empty() { "}" } else { " }" })
            }
        }
    }
}

/// A text as a basic string of TOML.
fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

impl ProfileKey {
    /// Table of a file that has the key; empty for none.
    fn section(self) -> &'static str {
        self.name().split_once('.').map_or("", |(section, _)| section)
    }

    /// Returns true if devices and their findings depend on the value: not on the numbers of commands,
    /// of descriptors, and on names of services.
    fn is_for_devices(self) -> bool {
        !matches!(
            self,
            Self::Config
                | Self::ConfigMask
                | Self::Gid
                | Self::Uid
                | Self::Sn
                | Self::Fw
                | Self::Caps
                | Self::Bspd
                | Self::Addr
                | Self::Autostart
                | Self::ByteOrder
                | Self::AutoRead
                | Self::Identify
                | Self::Mode
                | Self::Reboot
                | Self::WriteAddress
                | Self::WriteBitrate
                | Self::WriteEffect
                | Self::TimeoutMs
                | Self::ServiceNames
                | Self::DebugNames
        )
    }
}

/// A value and where it comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ValueWithOrigin {
    /// The value.
    pub value: ProfileValue,
    /// `assumed`, `given` or `learnt`.
    pub origin: &'static str,
}

impl Profile {
    /// The built-in profile as a file with comments, which sets nothing: the values are comments, too.
    pub const BUILT_IN: &str = include_str!("built_in.toml");

    /// Returns true if the value of a key, or where it comes from, differs from another profile's.
    pub fn differs_in(&self, key: ProfileKey, other: &Self) -> bool {
        self.value(key) != other.value(key) || self.origin(key) != other.origin(key)
    }

    /// Returns true if devices and their findings are read otherwise than by another profile.
    pub fn reads_otherwise(&self, other: &Self) -> bool {
        let mut keys = ProfileKey::ALL.iter().filter(|key| key.is_for_devices());
        keys.any(|key| self.differs_in(*key, other))
    }

    /// All values with their origins, by the names of their keys.
    pub fn values(&self) -> BTreeMap<&'static str, ValueWithOrigin> {
        let value = |key: ProfileKey| {
            let (value, origin) = (self.value(key), self.origin(key).word());
            (key.name(), ValueWithOrigin { value, origin })
        };
        ProfileKey::ALL.iter().map(|key| value(*key)).collect()
    }

    /// Takes a value that was learnt from frames. Returns false for a key that cannot be learnt, or a
    /// value that is none of it.
    pub fn learn(&mut self, key: ProfileKey, value: &ProfileValue) -> bool {
        use ProfileKey as Key;
        use ProfileValue::{Number, Service, Text};
        let is_given = |key| self.origin(key) != ValueOrigin::Assumed;
        // A number that a file gives to something else.
        if let (Key::Heartbeat | Key::Des, Service(number)) = (key, value)
            && ProfileKey::ALL.iter().any(|other| {
                *other != key
                    && *other != Key::Heartbeat
                    && *other != Key::Des
                    && self.is_given(*other)
                    && self.value(*other) == Service(*number)
            })
        {
            return false;
        }
        let [heartbeat_is_given, des_is_given] = [Key::Heartbeat, Key::Des].map(is_given);
        let Self { services, descriptor, heartbeat, framing, .. } = self;
        match (key, value) {
            // The two have different numbers: an assumed one gives way.
            (Key::Heartbeat, Service(number)) => {
                let before = std::mem::replace(&mut services.heartbeat, *number);
                if services.des == *number && before != *number {
                    if des_is_given {
                        services.heartbeat = before;
                        return false;
                    }
                    services.des = before;
                }
            }
            (Key::Des, Service(number)) => {
                let before = std::mem::replace(&mut services.des, *number);
                if services.heartbeat == *number && before != *number {
                    if heartbeat_is_given {
                        services.des = before;
                        return false;
                    }
                    services.heartbeat = before;
                }
            }
            (Key::PeriodMs, Number(millis)) => heartbeat.period_ms = *millis,
            (Key::UidOffset | Key::ModeOffset | Key::ErrorOffset, Number(at)) => {
                let Ok(at) = u8::try_from(*at) else { return false };
                let offset = match key {
                    Key::UidOffset => &mut heartbeat.uid_offset,
                    Key::ModeOffset => &mut heartbeat.mode_offset,
                    _ => &mut heartbeat.error_offset,
                };
                *offset = Some(at);
            }
            (Key::ByteOrder, Text(word)) => {
                let order = ByteOrder::ALL.into_iter().find(|order| order.word() == word);
                let Some(order) = order else { return false };
                descriptor.byte_order = order;
            }
            (Key::Framing, Text(word)) => match FramingChoice::from_word(word) {
                Some(choice) => *framing = choice,
                None => return false,
            },
            _ => return false,
        }
        self.set_origin(key, ValueOrigin::Learnt);
        true
    }

    /// The values that are not assumed, as a file. `comment`: a remark on a value, on one line.
    pub fn to_file(&self, comment: impl Fn(ProfileKey) -> Option<String>) -> String {
        let mut text = String::new();
        let mut section = "";
        for key in ProfileKey::ALL.iter().filter(|key| key.section().is_empty()) {
            self.write_value(&mut text, *key, comment(*key));
        }
        for key in ProfileKey::ALL.iter().filter(|key| !key.section().is_empty()) {
            if self.is_written(*key) && key.section() != section {
                section = key.section();
                let gap = if text.is_empty() { "" } else { "\n" };
                let _ = writeln!(text, "{gap}[{section}]");
            }
            self.write_value(&mut text, *key, comment(*key));
        }
        text
    }

    /// Returns true if a file needs the value: one that is assumed may have given way to another one.
    fn is_written(&self, key: ProfileKey) -> bool {
        self.origin(key) != ValueOrigin::Assumed || self.value(key) != Self::default().value(key)
    }

    fn write_value(&self, text: &mut String, key: ProfileKey, comment: Option<String>) {
        if !self.is_written(key) {
            return;
        }
        let comment = comment.map(|comment| format!("  # {comment}")).unwrap_or_default();
        let name = key.name().rsplit('.').next().unwrap_or_default();
        let _ = writeln!(text, "{name} = {}{comment}", self.value(key));
    }

    /// The value of a key.
    pub fn value(&self, key: ProfileKey) -> ProfileValue {
        use ProfileKey as Key;
        use ProfileValue::{Names, Number, Service, Switch, Text};
        let Self { services, descriptor, commands, writes, heartbeat, isotp, modes, .. } = self;
        let offset = |at: Option<u8>| at.map_or(Switch(false), |at| Number(u32::from(at)));
        let service = |number: Option<u16>| number.map_or(Switch(false), Service);
        let byte = |value: u8| Number(u32::from(value));
        match key {
            Key::Framing => Text(self.framing.word().to_owned()),
            Key::RequestErr => byte(u8::from(self.request_err)),
            Key::Heartbeat => Service(services.heartbeat),
            Key::Des => Service(services.des),
            Key::Config => Service(services.config),
            Key::ConfigMask => Service(services.config_mask),
            Key::Gid => Service(descriptor.gid),
            Key::Uid => Service(descriptor.uid),
            Key::Sn => Service(descriptor.sn),
            Key::Fw => Service(descriptor.fw),
            Key::Caps => Service(descriptor.caps),
            Key::Bspd => Service(descriptor.bspd),
            Key::Addr => Service(descriptor.addr),
            Key::Autostart => Service(descriptor.autostart),
            Key::ByteOrder => Text(descriptor.byte_order.word().to_owned()),
            Key::AutoRead => Switch(descriptor.auto),
            Key::Identify => Service(commands.identify),
            Key::Mode => Service(commands.mode),
            Key::Reboot => service(commands.reboot),
            Key::WriteAddress => service(writes.address),
            Key::WriteBitrate => service(writes.bitrate),
            Key::WriteEffect => Text(writes.effect.word().to_owned()),
            Key::UidOffset => offset(heartbeat.uid_offset),
            Key::ModeOffset => offset(heartbeat.mode_offset),
            Key::ErrorOffset => offset(heartbeat.error_offset),
            Key::PeriodMs => Number(heartbeat.period_ms),
            Key::Announce => match heartbeat.announce {
                Announce::Auto => Text("auto".to_owned()),
                Announce::Always => Switch(true),
                Announce::Never => Switch(false),
            },
            Key::FdPadding => byte(isotp.fd_padding),
            Key::BlockSize => byte(isotp.block_size),
            Key::StMin => byte(isotp.st_min),
            Key::TimeoutMs => Number(self.calls.timeout_ms),
            Key::Init => byte(modes.init),
            Key::Arslv => byte(modes.arslv),
            Key::Cfg => byte(modes.cfg),
            Key::Boot => byte(modes.boot),
            Key::Work => byte(modes.work),
            Key::Ufunc => byte(modes.ufunc),
            Key::Idle => byte(modes.idle),
            Key::Alphabet => Text(self.uid.alphabet.iter().collect()),
            Key::ServiceNames => Names(self.service_names.clone()),
            Key::DebugNames => Names(self.debug_names.clone()),
        }
    }
}

impl FramingChoice {
    /// The word in a file.
    fn word(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Isotp => "isotp",
            Self::Raw => "raw",
        }
    }

    fn from_word(word: &str) -> Option<Self> {
        [Self::Auto, Self::Isotp, Self::Raw].into_iter().find(|choice| choice.word() == word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_file_has_the_values_that_are_not_assumed() {
        let mut profile = Profile::parse(
            "request_err = 1\n[uid]\nalphabet = \" !\\\"#$%&'()*+,-./0123456789:;<=>?@ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\\\]^_\"\n\
             [heartbeat]\nannounce = false\nmode_offset = false\n[service_names]\n\"0x101\" = \"A\\\"B\"\n",
        )
        .unwrap();
        assert!(profile.learn(ProfileKey::Heartbeat, &ProfileValue::Service(0x123)));
        assert!(profile.learn(ProfileKey::Framing, &ProfileValue::Text("raw".to_owned())));
        assert!(!profile.learn(ProfileKey::Identify, &ProfileValue::Service(0x123)), "a command");
        let text = profile.to_file(|key| (key == ProfileKey::Heartbeat).then(|| "3 nodes".into()));
        assert!(text.contains("[services]\nheartbeat = 0x123  # 3 nodes\n"), "{text}");
        let read = Profile::parse(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
        for key in ProfileKey::ALL {
            assert_eq!(read.value(*key), profile.value(*key), "{}", key.name());
            let is_assumed = profile.origin(*key) == ValueOrigin::Assumed;
            assert_eq!(read.origin(*key) == ValueOrigin::Assumed, is_assumed, "{}", key.name());
        }
    }

    #[test]
    fn built_in_file_has_all_values_and_sets_none() {
        let written = Profile::parse(Profile::BUILT_IN).unwrap();
        let is_given = |key: &&ProfileKey| written.origin(**key) == ValueOrigin::Given;
        assert_eq!(
            ProfileKey::ALL.iter().find(is_given),
            None,
            "tables without names count as none"
        );
        let tables = [&ProfileKey::ServiceNames, &ProfileKey::DebugNames];
        let lines = Profile::BUILT_IN.lines().map(|line| match line.strip_prefix('#') {
            Some(value) if !value.starts_with(' ') => value,
            _ => line,
        });
        let text = lines.collect::<Vec<_>>().join("\n");
        let written = Profile::parse(&text).unwrap();
        let built_in = Profile::default();
        for key in ProfileKey::ALL.iter().filter(|key| !tables.contains(key)) {
            assert_eq!(written.value(*key), built_in.value(*key), "{}", key.name());
            assert_eq!(written.origin(*key), ValueOrigin::Given, "{}", key.name());
        }
    }
}
