//! The descriptor of a node: what it is and how it is configured (CAN platform §3.2).
//!
//! Source: protocol §7.4. Each field has a service; an empty request reads it, and the data of the
//! response are the field. Service numbers and byte order are not specified there; they are fields
//! of [`super::profile::Profile`]. Data that are no value of a field are a [`DescriptorFault`].

use super::id::{Address, Service};
use super::node::Uid;
use super::profile::{DescriptorProfile, ProfileKey, UidProfile};
use core::fmt;

/// A field of the descriptor, with one service number each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DescriptorField {
    /// DEV_INFO_GID.
    Gid,
    /// DEV_CFG_UID.
    Uid,
    /// DEV_INFO_SN.
    Serial,
    /// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN.
    Firmware,
    /// DEV_INFO_PROG, DEV_INFO_FPU, DEV_INFO_CPU and DEV_INFO_CPU_FLAGS.
    Capabilities,
    /// DEV_CFG_BSPD.
    Bitrate,
    /// DEV_CFG_ADDR.
    Address,
    /// DEV_CFG_AUTOSTART.
    Autostart,
}

impl DescriptorField {
    /// All fields, in the order of CAN platform §3.2.
    pub const ALL: [Self; 8] = [
        Self::Gid,
        Self::Uid,
        Self::Serial,
        Self::Firmware,
        Self::Capabilities,
        Self::Bitrate,
        Self::Address,
        Self::Autostart,
    ];

    /// Returns the name in JSON, which is that in a profile.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gid => "gid",
            Self::Uid => "uid",
            Self::Serial => "sn",
            Self::Firmware => "fw",
            Self::Capabilities => "caps",
            Self::Bitrate => "bspd",
            Self::Address => "addr",
            Self::Autostart => "autostart",
        }
    }

    /// Returns the name on the screen.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Gid => "GID",
            Self::Uid => "UID",
            Self::Serial => "SN",
            Self::Firmware => "firmware",
            Self::Capabilities => "CPU",
            Self::Bitrate => "bit rate",
            Self::Address => "address",
            Self::Autostart => "AUTOSTART",
        }
    }

    /// Returns the key of the profile that has its service number.
    pub const fn key(self) -> ProfileKey {
        match self {
            Self::Gid => ProfileKey::Gid,
            Self::Uid => ProfileKey::Uid,
            Self::Serial => ProfileKey::Sn,
            Self::Firmware => ProfileKey::Fw,
            Self::Capabilities => ProfileKey::Caps,
            Self::Bitrate => ProfileKey::Bspd,
            Self::Address => ProfileKey::Addr,
            Self::Autostart => ProfileKey::Autostart,
        }
    }

    /// Returns its service number.
    pub fn service(self, numbers: &DescriptorProfile) -> Service {
        Service::from_bits(match self {
            Self::Gid => numbers.gid,
            Self::Uid => numbers.uid,
            Self::Serial => numbers.sn,
            Self::Firmware => numbers.fw,
            Self::Capabilities => numbers.caps,
            Self::Bitrate => numbers.bspd,
            Self::Address => numbers.addr,
            Self::Autostart => numbers.autostart,
        })
    }

    /// Returns the number of bytes of its value.
    pub const fn size(self) -> usize {
        match self {
            Self::Gid | Self::Uid => 6,
            Self::Serial | Self::Firmware => 4,
            Self::Capabilities => 5,
            Self::Bitrate | Self::Address | Self::Autostart => 1,
        }
    }
}

/// Order of the bytes of a number of several bytes. The GID and the UID are bytes in the order of
/// the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ByteOrder {
    /// The lowest byte first.
    #[default]
    Little,
    /// The highest byte first.
    Big,
}

impl ByteOrder {
    /// Both, in the order of a profile's comment.
    pub const ALL: [Self; 2] = [Self::Little, Self::Big];

    /// The word in a file.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Little => "little",
            Self::Big => "big",
        }
    }

    fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Little => u16::from_le_bytes(bytes),
            Self::Big => u16::from_be_bytes(bytes),
        }
    }

    fn u32(self, bytes: [u8; 4]) -> u32 {
        match self {
            Self::Little => u32::from_le_bytes(bytes),
            Self::Big => u32::from_be_bytes(bytes),
        }
    }

    fn bytes_of_u16(self, value: u16) -> [u8; 2] {
        match self {
            Self::Little => value.to_le_bytes(),
            Self::Big => value.to_be_bytes(),
        }
    }

    fn bytes_of_u32(self, value: u32) -> [u8; 4] {
        match self {
            Self::Little => value.to_le_bytes(),
            Self::Big => value.to_be_bytes(),
        }
    }
}

/// DEV_INFO_GID: the type of a device. As text it is its twelve hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct Gid(pub [u8; 6]);

impl Gid {
    /// Returns true if all bits are 0 or all are 1: the manufacturer set none.
    pub fn is_blank(self) -> bool {
        self.0 == [0; 6] || self.0 == [0xFF; 6]
    }

    /// Returns the GID of twelve hexadecimal digits, with or without `0x`; `None` if the text is none.
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix("0x").unwrap_or(text);
        if digits.len() != 12 || !digits.bytes().all(|digit| digit.is_ascii_hexdigit()) {
            return None;
        }
        let bits = u64::from_str_radix(digits, 16).ok()?;
        Some(Self(core::array::from_fn(|at| (bits >> (40 - 8 * at)) as u8)))
    }
}

impl fmt::Display for Gid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl fmt::Debug for Gid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct FirmwareVersion {
    /// DEV_INFO_FW_MAJ: devices of one type have the same services while it is the same.
    pub major: u16,
    /// DEV_INFO_FW_MIN.
    pub minor: u16,
}

impl fmt::Display for FirmwareVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

/// What a device can execute.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Capabilities {
    /// DEV_INFO_PROG: it runs programs of the user.
    pub is_programmable: bool,
    /// DEV_INFO_FPU: it calculates with floating-point numbers.
    pub has_fpu: bool,
    /// DEV_INFO_CPU.
    pub cpu: u16,
    /// DEV_INFO_CPU_FLAGS, which are not defined yet.
    pub cpu_flags: u16,
}

impl Capabilities {
    /// Returns the name of the processor's type; `None` for a code that is not defined.
    pub const fn cpu_name(self) -> Option<&'static str> {
        match self.cpu {
            1 => Some("RV32I"),
            2 => Some("RV32E"),
            _ => None,
        }
    }
}

impl fmt::Display for Capabilities {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.cpu_name() {
            Some(name) => f.write_str(name)?,
            None => write!(f, "type 0x{:04X}", self.cpu)?,
        }
        f.write_str(if self.has_fpu { ", FPU" } else { "" })?;
        f.write_str(if self.is_programmable { ", programmable" } else { "" })?;
        if self.cpu_flags != 0 {
            write!(f, ", flags 0x{:04X}", self.cpu_flags)?;
        }
        Ok(())
    }
}

/// DEV_CFG_BSPD: the bit rate with which a device starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitrateSetting {
    /// Bit rate in bit/s: one of [`BitrateSetting::RATES`].
    pub rate: u32,
    /// True: it uses no other rate. False: it looks for that of the bus.
    pub is_fixed: bool,
}

impl BitrateSetting {
    /// The bit rates of the CAN platform, in bit/s, in the order of their codes.
    pub const RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];

    /// Returns the setting of a code; `None` if it has no meaning.
    pub fn from_code(code: u8) -> Option<Self> {
        let rate = *Self::RATES.get(usize::from(code & 0x7F))?;
        Some(Self { rate, is_fixed: code & 0x80 == 0 })
    }

    /// Returns the code; `None` for a rate that has none.
    pub fn code(self) -> Option<u8> {
        let at = Self::RATES.iter().position(|&rate| rate == self.rate)?;
        Some(at as u8 | if self.is_fixed { 0 } else { 0x80 })
    }
}

impl fmt::Display for BitrateSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = if self.is_fixed { "fixed" } else { "preferred" };
        write!(f, "{word} {} kbit/s", self.rate / 1000)
    }
}

/// DEV_CFG_ADDR: the address with which a device starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum AddressSetting {
    /// None: a random free one, and mode CFG.
    #[default]
    None,
    /// This one, if it is free; otherwise a random free one.
    Preferred(Address),
    /// This one only.
    Fixed(Address),
}

impl AddressSetting {
    /// Returns the setting of a code; `None` if it has no meaning: address 0 as a preferred one.
    pub fn from_code(code: u8) -> Option<Self> {
        let address = Address::from_bits(code);
        match code {
            0 => Some(Self::None),
            0x80 => None,
            0x81.. => Some(Self::Preferred(address)),
            _ => Some(Self::Fixed(address)),
        }
    }

    /// Returns the code.
    pub const fn code(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Preferred(address) => address.number() | 0x80,
            Self::Fixed(address) => address.number(),
        }
    }

    /// Returns the address, if there is one.
    pub const fn address(self) -> Option<Address> {
        match self {
            Self::None => None,
            Self::Preferred(address) | Self::Fixed(address) => Some(address),
        }
    }
}

impl fmt::Display for AddressSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.pad("none"),
            Self::Preferred(address) => write!(f, "preferred {address}"),
            Self::Fixed(address) => write!(f, "fixed {address}"),
        }
    }
}

/// Value of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptorValue {
    /// DEV_INFO_GID.
    Gid(Gid),
    /// DEV_CFG_UID.
    Uid(Uid),
    /// DEV_INFO_SN; 0: none.
    Serial(u32),
    /// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN.
    Firmware(FirmwareVersion),
    /// DEV_INFO_PROG, DEV_INFO_FPU, DEV_INFO_CPU and DEV_INFO_CPU_FLAGS.
    Capabilities(Capabilities),
    /// DEV_CFG_BSPD.
    Bitrate(BitrateSetting),
    /// DEV_CFG_ADDR.
    Address(AddressSetting),
    /// DEV_CFG_AUTOSTART: it enters mode WORK without a command.
    Autostart(bool),
}

impl DescriptorValue {
    /// Most bytes of a value.
    pub const MAX_LEN: usize = 6;

    /// Reads the data of a response.
    ///
    /// # Errors
    ///
    /// [`DescriptorFault`] if they are no value of the field.
    pub fn decode(
        field: DescriptorField,
        data: &[u8],
        order: ByteOrder,
    ) -> Result<Self, DescriptorFault> {
        if data.len() != field.size() {
            return Err(DescriptorFault::Length { expected: field.size() as u8 });
        }
        let bytes = || data.first_chunk().copied().unwrap_or_default();
        let first = data.first().copied().unwrap_or_default();
        let u16_at = |at: usize| {
            data.get(at..).and_then(<[u8]>::first_chunk).map_or(0, |bytes| order.u16(*bytes))
        };
        let value = match field {
            DescriptorField::Gid => Some(Self::Gid(Gid(bytes()))),
            DescriptorField::Uid => Some(Self::Uid(Uid(bytes()))),
            DescriptorField::Serial => {
                let bytes = data.first_chunk().copied().unwrap_or_default();
                Some(Self::Serial(order.u32(bytes)))
            }
            DescriptorField::Firmware => {
                Some(Self::Firmware(FirmwareVersion { major: u16_at(0), minor: u16_at(2) }))
            }
            DescriptorField::Capabilities => (first & !0b11 == 0).then(|| {
                Self::Capabilities(Capabilities {
                    is_programmable: first & 1 != 0,
                    has_fpu: first & 2 != 0,
                    cpu: u16_at(1),
                    cpu_flags: u16_at(3),
                })
            }),
            DescriptorField::Bitrate => BitrateSetting::from_code(first).map(Self::Bitrate),
            DescriptorField::Address => AddressSetting::from_code(first).map(Self::Address),
            DescriptorField::Autostart => (first <= 1).then_some(Self::Autostart(first == 1)),
        };
        value.ok_or(DescriptorFault::Undefined)
    }

    /// Returns the data of a response, and how many of the bytes to send.
    pub fn encode(self, order: ByteOrder) -> ([u8; Self::MAX_LEN], usize) {
        let mut data = [0; Self::MAX_LEN];
        let mut put = |at: usize, bytes: &[u8]| data[at..at + bytes.len()].copy_from_slice(bytes);
        match self {
            Self::Gid(gid) => put(0, &gid.0),
            Self::Uid(uid) => put(0, &uid.0),
            Self::Serial(serial) => put(0, &order.bytes_of_u32(serial)),
            Self::Firmware(version) => {
                put(0, &order.bytes_of_u16(version.major));
                put(2, &order.bytes_of_u16(version.minor));
            }
            Self::Capabilities(able) => {
                put(0, &[u8::from(able.is_programmable) | u8::from(able.has_fpu) << 1]);
                put(1, &order.bytes_of_u16(able.cpu));
                put(3, &order.bytes_of_u16(able.cpu_flags));
            }
            Self::Bitrate(setting) => put(0, &[setting.code().unwrap_or(0x80)]),
            Self::Address(setting) => put(0, &[setting.code()]),
            Self::Autostart(starts) => put(0, &[u8::from(starts)]),
        }
        (data, self.field().size())
    }

    /// Returns its field.
    pub const fn field(self) -> DescriptorField {
        match self {
            Self::Gid(_) => DescriptorField::Gid,
            Self::Uid(_) => DescriptorField::Uid,
            Self::Serial(_) => DescriptorField::Serial,
            Self::Firmware(_) => DescriptorField::Firmware,
            Self::Capabilities(_) => DescriptorField::Capabilities,
            Self::Bitrate(_) => DescriptorField::Bitrate,
            Self::Address(_) => DescriptorField::Address,
            Self::Autostart(_) => DescriptorField::Autostart,
        }
    }

    /// Returns the value in words, with the characters of a UID in this alphabet.
    pub const fn in_words(self, alphabet: &UidProfile) -> DescriptorText<'_> {
        DescriptorText { value: self, alphabet }
    }
}

/// A value in words.
#[derive(Clone, Copy, Debug)]
pub struct DescriptorText<'a> {
    value: DescriptorValue,
    alphabet: &'a UidProfile,
}

impl fmt::Display for DescriptorText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.value {
            DescriptorValue::Gid(gid) => write!(f, "0x{gid}"),
            DescriptorValue::Uid(uid) if uid.is_blank() => f.write_str("blank"),
            DescriptorValue::Uid(uid) => uid.text(self.alphabet).fmt(f),
            DescriptorValue::Serial(0) => f.write_str("none"),
            DescriptorValue::Serial(serial) => serial.fmt(f),
            DescriptorValue::Firmware(version) => version.fmt(f),
            DescriptorValue::Capabilities(able) => able.fmt(f),
            DescriptorValue::Bitrate(setting) => setting.fmt(f),
            DescriptorValue::Address(setting) => setting.fmt(f),
            DescriptorValue::Autostart(starts) => f.write_str(if starts { "on" } else { "off" }),
        }
    }
}

/// Why the data of a response are no value of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptorFault {
    /// It has more or fewer bytes than the field.
    Length {
        /// Bytes of the field.
        expected: u8,
    },
    /// The bytes have no meaning: CAN platform §3.2 defines other codes.
    Undefined,
}

impl fmt::Display for DescriptorFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { expected: 1 } => f.write_str("1 byte expected"),
            Self::Length { expected } => write!(f, "{expected} bytes expected"),
            Self::Undefined => f.write_str("undefined code"),
        }
    }
}

impl core::error::Error for DescriptorFault {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_as_they_were_encoded() {
        let address = Address::new(10).unwrap();
        let able = Capabilities { is_programmable: true, has_fpu: true, cpu: 2, cpu_flags: 0x1234 };
        let values = [
            DescriptorValue::Gid(Gid([0, 0, 0, 0, 0, 0x21])),
            DescriptorValue::Uid(Uid([1, 2, 3, 4, 5, 6])),
            DescriptorValue::Serial(0x0102_0304),
            DescriptorValue::Firmware(FirmwareVersion { major: 0x0102, minor: 3 }),
            DescriptorValue::Capabilities(able),
            DescriptorValue::Bitrate(BitrateSetting { rate: 500_000, is_fixed: false }),
            DescriptorValue::Address(AddressSetting::Preferred(address)),
            DescriptorValue::Autostart(true),
        ];
        for (order, serial) in [(ByteOrder::Little, [4, 3, 2, 1]), (ByteOrder::Big, [1, 2, 3, 4])] {
            assert_eq!(values[2].encode(order).0[..4], serial);
            for (field, value) in DescriptorField::ALL.into_iter().zip(values) {
                let (data, len) = value.encode(order);
                assert_eq!(DescriptorValue::decode(field, &data[..len], order), Ok(value));
                // One byte less or more is no value.
                for wrong in [&data[..len - 1], &[0; 7][..=len]] {
                    let expected = len as u8;
                    let fault = Err(DescriptorFault::Length { expected });
                    assert_eq!(DescriptorValue::decode(field, wrong, order), fault);
                }
            }
        }
    }

    #[test]
    fn codes_without_a_meaning_are_faults() {
        let decode = |field, data: &[u8]| DescriptorValue::decode(field, data, ByteOrder::Little);
        let undefined = Err(DescriptorFault::Undefined);
        for code in (4..0x80).chain(0x84..=0xFF) {
            assert_eq!(decode(DescriptorField::Bitrate, &[code]), undefined, "{code}");
        }
        assert_eq!(decode(DescriptorField::Address, &[0x80]), undefined);
        assert_eq!(decode(DescriptorField::Autostart, &[2]), undefined);
        assert_eq!(decode(DescriptorField::Capabilities, &[4, 1, 0, 0, 0]), undefined);
    }

    #[test]
    fn gid_is_read_as_it_is_shown() {
        let gid = Gid([0, 0, 0, 0xAB, 0, 0x21]);
        assert_eq!(Gid::parse("000000AB0021"), Some(gid));
        assert_eq!(Gid::parse("0x000000ab0021"), Some(gid));
        for wrong in ["", "21", "0x", "+00000AB0021", "000000AB00210", "000000AB002é"] {
            assert_eq!(Gid::parse(wrong), None, "{wrong}");
        }
    }
}
