//! Keys of the profile by name, and where the value of each comes from.

use super::Profile;

/// Where a value of the profile comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ValueOrigin {
    /// Built in: the sources of the protocol leave it open.
    #[default]
    Assumed,
    /// Set in a file.
    Given,
    /// Proposed by what was heard, and taken over by the user.
    Learnt,
}

impl ValueOrigin {
    /// The word for it, on the screen and in JSON.
    pub fn word(self) -> &'static str {
        match self {
            Self::Assumed => "assumed",
            Self::Given => "given",
            Self::Learnt => "learnt",
        }
    }
}

macro_rules! profile_keys {
    ($($key:ident $name:literal,)*) => {
        /// A key of the profile.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum ProfileKey {
            $(
                #[doc = concat!("`", $name, "`")]
                $key,
            )*
        }

        impl ProfileKey {
            /// All keys, in the order of the guide.
            pub const ALL: &[Self] = &[$(Self::$key,)*];

            /// Name of the key in a file: `services.des`.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$key => $name,)*
                }
            }
        }
    };
}

profile_keys! {
    Framing "framing",
    RequestErr "request_err",
    Heartbeat "services.heartbeat",
    Des "services.des",
    Config "services.config",
    ConfigMask "services.config_mask",
    Gid "descriptor.gid",
    Uid "descriptor.uid",
    Sn "descriptor.sn",
    Fw "descriptor.fw",
    Caps "descriptor.caps",
    Bspd "descriptor.bspd",
    Addr "descriptor.addr",
    Autostart "descriptor.autostart",
    ByteOrder "descriptor.byte_order",
    AutoRead "descriptor.auto",
    Identify "commands.identify",
    Mode "commands.mode",
    Reboot "commands.reboot",
    WriteAddress "writes.address",
    WriteBitrate "writes.bitrate",
    WriteEffect "writes.effect",
    UidOffset "heartbeat.uid_offset",
    ModeOffset "heartbeat.mode_offset",
    ErrorOffset "heartbeat.error_offset",
    PeriodMs "heartbeat.period_ms",
    Announce "heartbeat.announce",
    FdPadding "isotp.fd_padding",
    BlockSize "isotp.block_size",
    StMin "isotp.st_min",
    TimeoutMs "calls.timeout_ms",
    Init "modes.INIT",
    Arslv "modes.ARSLV",
    Cfg "modes.CFG",
    Boot "modes.BOOT",
    Work "modes.WORK",
    Ufunc "modes.UFUNC",
    Idle "modes.IDLE",
    Alphabet "uid.alphabet",
    ServiceNames "service_names",
    DebugNames "debug_names",
}

impl ProfileKey {
    /// The keys by which devices and their names are read at all.
    pub const READING: [Self; 4] = [Self::Heartbeat, Self::Des, Self::UidOffset, Self::ModeOffset];

    /// Returns the key of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|key| key.name() == name)
    }

    fn bit(self) -> u64 {
        1 << self as u32
    }
}

/// Origins of all values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) struct ValueOrigins {
    /// A bit for each key.
    given: u64,
    learnt: u64,
}

impl Profile {
    /// Where the value of a key comes from.
    pub fn origin(&self, key: ProfileKey) -> ValueOrigin {
        match (self.origins.given & key.bit() != 0, self.origins.learnt & key.bit() != 0) {
            (true, _) => ValueOrigin::Given,
            (_, true) => ValueOrigin::Learnt,
            _ => ValueOrigin::Assumed,
        }
    }

    /// Sets where the value of a key comes from.
    pub fn set_origin(&mut self, key: ProfileKey, origin: ValueOrigin) {
        let ValueOrigins { given, learnt } = &mut self.origins;
        for (bits, is_it) in
            [(given, origin == ValueOrigin::Given), (learnt, origin == ValueOrigin::Learnt)]
        {
            *bits = if is_it { *bits | key.bit() } else { *bits & !key.bit() };
        }
    }

    /// Returns true if a file sets the value of a key.
    pub fn is_given(&self, key: ProfileKey) -> bool {
        self.origin(key) == ValueOrigin::Given
    }

    /// Keys by which devices are read, and whose values are assumed.
    pub fn assumed(&self) -> impl Iterator<Item = ProfileKey> {
        let reading = ProfileKey::READING.into_iter();
        reading.filter(|key| self.origin(*key) == ValueOrigin::Assumed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_their_own_origin() {
        assert!(ProfileKey::ALL.len() <= 64, "a bit each");
        let mut profile = Profile::default();
        for (at, key) in ProfileKey::ALL.iter().enumerate() {
            assert_eq!(ProfileKey::from_name(key.name()), Some(*key));
            profile.set_origin(*key, [ValueOrigin::Given, ValueOrigin::Learnt][at % 2]);
        }
        for (at, key) in ProfileKey::ALL.iter().enumerate() {
            assert_eq!(profile.origin(*key), [ValueOrigin::Given, ValueOrigin::Learnt][at % 2]);
            profile.set_origin(*key, ValueOrigin::Assumed);
        }
        assert_eq!(profile, Profile::default());
    }
}
