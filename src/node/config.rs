//! What a node is: its numbers on the bus, its texts and constant fields, its settings.

use super::NodeFrame;
use crate::frame::Frame;
use crate::wire::des::MAX_MESSAGE;
use crate::wire::descriptor::{
    AddressSetting, BitrateSetting, ByteOrder, Capabilities, DescriptorField, DescriptorValue,
    FirmwareVersion, Gid,
};
use crate::wire::id::{Header, Service};
use crate::wire::node::{Heartbeat, Mode, Uid};
use crate::wire::profile::{
    Announce, FramingChoice, HeartbeatProfile, Profile, ProfileKey, ValueOrigin, WriteEffect,
};

/// Numbers that the sources of the protocol leave open, as a constant for firmware. All devices of a
/// bus and descan's profile must have the same ones.
///
/// ```
/// use descan::node::NodeConfig;
/// use descan::wire::id::Service;
///
/// const CONFIG: NodeConfig = NodeConfig {
///     identify: Some(Service::from_bits(0x018)),
///     ..NodeConfig::DEFAULT
/// };
/// assert_eq!(CONFIG.des.number(), 0x002);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeConfig {
    /// Service number of heartbeats, MSG_SRV_HR.
    pub heartbeat: Service,
    /// Service number of DES.
    pub des: Service,
    /// Service numbers that read the descriptor, in the order of [`DescriptorField::ALL`]; `None`:
    /// the field is not served.
    pub descriptor: [Option<Service>; 8],
    /// Command that lets the device blink or beep.
    pub identify: Option<Service>,
    /// Command that changes the mode.
    pub mode: Option<Service>,
    /// Command that restarts the device.
    pub reboot: Option<Service>,
    /// Writes DEV_CFG_UID.
    pub write_uid: Option<Service>,
    /// Writes DEV_CFG_ADDR.
    pub write_address: Option<Service>,
    /// Writes DEV_CFG_BSPD.
    pub write_bitrate: Option<Service>,
    /// When a written address or bit rate acts.
    pub write_effect: WriteEffect,
    /// BUS_CFG_HR_TIME in milliseconds, 10 to 60,000 (CAN platform §3.1.7: 1,000); other values count
    /// as the nearest of these.
    pub heartbeat_ms: u32,
    /// Offset of the UID in the heartbeat, 0 to 2; `None`: it does not carry the UID, and other nodes
    /// with this node's UID are not noticed.
    pub uid_offset: Option<u8>,
    /// Offset of the mode in the heartbeat, 0 to 7; `None`: not in it.
    pub mode_offset: Option<u8>,
    /// Offset of the error code in the heartbeat, 0 to 7; `None`: not in it.
    pub error_offset: Option<u8>,
    /// Codes of the modes, in the order of [`Mode::ALL`]; all different.
    pub mode_codes: [u8; 7],
    /// Order of the bytes of numbers in the descriptor.
    pub byte_order: ByteOrder,
    /// Answers raw requests too, beside those in ISO-TP.
    pub has_raw_framing: bool,
    /// Byte that fills FD frames up to the next length that a DLC expresses.
    pub fd_padding: u8,
    /// BUS_CFG_TXERR_MAX: error counter at which the node leaves the bus and begins again in INIT
    /// (CAN platform §3.2.4.2 to §3.2.4.4), 1 to 256.
    pub max_errors: u16,
}

impl NodeConfig {
    /// The values that descan assumes without a profile; no commands and no writes.
    pub const DEFAULT: Self = Self {
        heartbeat: Service::from_bits(0x001),
        des: Service::from_bits(0x002),
        descriptor: [
            Some(Service::from_bits(0x010)),
            Some(Service::from_bits(0x011)),
            Some(Service::from_bits(0x012)),
            Some(Service::from_bits(0x013)),
            Some(Service::from_bits(0x014)),
            Some(Service::from_bits(0x015)),
            Some(Service::from_bits(0x016)),
            Some(Service::from_bits(0x017)),
        ],
        identify: None,
        mode: None,
        reboot: None,
        write_uid: None,
        write_address: None,
        write_bitrate: None,
        write_effect: WriteEffect::Now,
        heartbeat_ms: 1000,
        uid_offset: Some(0),
        mode_offset: Some(6),
        error_offset: Some(7),
        mode_codes: [0, 1, 2, 3, 4, 5, 6],
        byte_order: ByteOrder::Little,
        has_raw_framing: true,
        fd_padding: 0xCC,
        max_errors: 128,
    };

    /// Returns the values of a profile. Commands and writes that no file sets are not served, as in
    /// `descan kit`.
    pub fn from_profile(profile: &Profile) -> Self {
        let given = |key, number| {
            let is_given = profile.origin(key) != ValueOrigin::Assumed;
            is_given.then(|| Service::from_bits(number))
        };
        let layout = &profile.heartbeat;
        Self {
            heartbeat: profile.heartbeat_service(),
            des: profile.des_service(),
            descriptor: DescriptorField::ALL.map(|field| Some(field.service(&profile.descriptor))),
            identify: given(ProfileKey::Identify, profile.commands.identify),
            mode: given(ProfileKey::Mode, profile.commands.mode),
            reboot: profile.commands.reboot.map(Service::from_bits),
            write_uid: None,
            write_address: profile.writes.address.map(Service::from_bits),
            write_bitrate: profile.writes.bitrate.map(Service::from_bits),
            write_effect: profile.writes.effect,
            heartbeat_ms: layout.period_ms,
            uid_offset: layout.uid_offset,
            mode_offset: layout.mode_offset,
            error_offset: layout.error_offset,
            mode_codes: profile.modes.codes(),
            byte_order: profile.descriptor.byte_order,
            has_raw_framing: profile.framing != FramingChoice::Isotp,
            fd_padding: profile.isotp.fd_padding,
            ..Self::DEFAULT
        }
    }

    /// Returns BUS_CFG_HR_TIME in microseconds. Not a [`core::time::Duration`], whose sums take a
    /// division of 64 bits.
    pub(super) fn period_micros(&self) -> u64 {
        let periods = HeartbeatProfile::PERIODS;
        let period = self.heartbeat_ms.clamp(*periods.start(), *periods.end());
        u64::from(period) * 1000
    }

    fn layout(&self) -> HeartbeatProfile {
        HeartbeatProfile {
            uid_offset: self.uid_offset,
            mode_offset: self.mode_offset,
            error_offset: self.error_offset,
            period_ms: self.heartbeat_ms,
            announce: Announce::Never,
        }
    }

    /// Returns the frame of a heartbeat.
    pub(super) fn heartbeat_frame(&self, header: Header, heartbeat: &Heartbeat) -> NodeFrame {
        let (data, len) = heartbeat.encode(&self.layout(), &self.mode_codes);
        let mut frame = NodeFrame::with_header(header);
        frame.extend(data.into_iter().take(len));
        frame
    }

    /// Returns the UID of a heartbeat's data.
    pub(super) fn uid_of(&self, data: &[u8]) -> Option<Uid> {
        Heartbeat::decode(data, &self.layout(), &self.mode_codes).uid
    }

    /// Returns the mode of a code.
    pub(super) fn mode_of(&self, code: u8) -> Option<Mode> {
        Mode::ALL.into_iter().zip(self.mode_codes).find(|it| it.1 == code).map(|it| it.0)
    }

    /// Returns the number that reads a field.
    pub(super) fn reads(&self, field: DescriptorField) -> Option<Service> {
        self.descriptor[field as usize]
    }

    /// Returns the field that a service number reads.
    pub(super) fn read_field(&self, service: Service) -> Option<DescriptorField> {
        DescriptorField::ALL.into_iter().find(|field| self.reads(*field) == Some(service))
    }

    /// Returns the field that a service number writes.
    pub(super) fn written_field(&self, service: Service) -> Option<DescriptorField> {
        let writes = [
            (self.write_uid, DescriptorField::Uid),
            (self.write_address, DescriptorField::Address),
            (self.write_bitrate, DescriptorField::Bitrate),
        ];
        writes.into_iter().find(|it| it.0 == Some(service)).map(|it| it.1)
    }

    /// Returns true if a service number is that of a command.
    pub(super) fn is_command(&self, service: Service) -> bool {
        [self.mode, self.identify, self.reboot].contains(&Some(service))
    }
}

impl Default for NodeConfig {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What a device is; constant, usually in flash memory.
///
/// ```
/// use descan::node::NodeDevice;
///
/// const PUMP: NodeDevice = NodeDevice {
///     services: &[&["DES", "1.0"], &["FLOW", "2.1"]],
///     ..NodeDevice::named("PUMP")
/// };
/// const _: () = assert!(PUMP.has_valid_texts());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeDevice<'a> {
    /// Name, without a zero character; of 5 bytes or less it fits one classic frame.
    pub name: &'a str,
    /// Services in the order of their indices, at most 256: each its name, its version and perhaps
    /// further strings, without zero characters.
    pub services: &'a [&'a [&'a str]],
    /// DEV_INFO_GID.
    pub gid: Gid,
    /// DEV_INFO_SN; 0: none.
    pub serial: u32,
    /// DEV_INFO_FW_MAJ and DEV_INFO_FW_MIN.
    pub firmware: FirmwareVersion,
    /// DEV_INFO_PROG, DEV_INFO_FPU, DEV_INFO_CPU and DEV_INFO_CPU_FLAGS.
    pub capabilities: Capabilities,
}

impl<'a> NodeDevice<'a> {
    /// Returns a device with a name, and without anything else.
    pub const fn named(name: &'a str) -> Self {
        Self {
            name,
            services: &[],
            gid: Gid([0; 6]),
            serial: 0,
            firmware: FirmwareVersion { major: 0, minor: 0 },
            capabilities: Capabilities {
                is_programmable: false,
                has_fpu: false,
                cpu: 0,
                cpu_flags: 0,
            },
        }
    }

    /// Returns true if both responses of DES fit the limit of ISO 15765-2, 4,095 bytes, and their
    /// number that of DES, 256. A response that does not is refused (ERR = 0).
    pub const fn has_valid_texts(&self) -> bool {
        self.name_len() <= MAX_MESSAGE
            && self.services_len() <= MAX_MESSAGE
            && self.services.len() <= crate::wire::des::MAX_SERVICES
    }

    /// Returns the bytes of the name response.
    pub(super) const fn name_len(&self) -> usize {
        self.name.len() + 2
    }

    /// Returns the bytes of the services response.
    pub(super) const fn services_len(&self) -> usize {
        let mut len = 1;
        let mut service = 0;
        while service < self.services.len() {
            let strings = self.services[service];
            let mut string = 0;
            len += 1;
            while string < strings.len() {
                len += strings[string].len() + 1;
                string += 1;
            }
            service += 1;
        }
        len
    }

    /// Returns the value of a field, constant or of the settings.
    pub(super) fn value(&self, field: DescriptorField, settings: &NodeSettings) -> DescriptorValue {
        match field {
            DescriptorField::Gid => DescriptorValue::Gid(self.gid),
            DescriptorField::Serial => DescriptorValue::Serial(self.serial),
            DescriptorField::Firmware => DescriptorValue::Firmware(self.firmware),
            DescriptorField::Capabilities => DescriptorValue::Capabilities(self.capabilities),
            DescriptorField::Uid => DescriptorValue::Uid(settings.uid),
            DescriptorField::Bitrate => DescriptorValue::Bitrate(settings.bitrate),
            DescriptorField::Address => DescriptorValue::Address(settings.address),
            DescriptorField::Autostart => DescriptorValue::Autostart(settings.autostart),
        }
    }
}

/// Configuration that a device keeps without power (CAN platform §3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeSettings {
    /// DEV_CFG_UID.
    pub uid: Uid,
    /// DEV_CFG_ADDR.
    pub address: AddressSetting,
    /// DEV_CFG_BSPD.
    pub bitrate: BitrateSetting,
    /// DEV_CFG_AUTOSTART: enters WORK by itself.
    pub autostart: bool,
}

impl NodeSettings {
    /// Settings of a board that was never configured: any bit rate, beginning with 125 kbit/s (CAN
    /// platform §3.2.4.1); no UID, no address, no AUTOSTART.
    pub const BLANK: Self = Self {
        uid: Uid::BLANK,
        address: AddressSetting::None,
        bitrate: BitrateSetting { rate: 125_000, is_fixed: false },
        autostart: false,
    };

    /// Returns the settings with another value of a field; constant fields change nothing.
    #[must_use]
    pub fn with_value(mut self, value: DescriptorValue) -> Self {
        match value {
            DescriptorValue::Uid(uid) => self.uid = uid,
            DescriptorValue::Address(address) => self.address = address,
            DescriptorValue::Bitrate(bitrate) => self.bitrate = bitrate,
            DescriptorValue::Autostart(autostart) => self.autostart = autostart,
            DescriptorValue::Gid(_)
            | DescriptorValue::Serial(_)
            | DescriptorValue::Firmware(_)
            | DescriptorValue::Capabilities(_) => {}
        }
        self
    }
}

impl Default for NodeSettings {
    fn default() -> Self {
        Self::BLANK
    }
}

/// Most data bytes of a frame.
pub(super) const fn capacity(is_fd: bool) -> usize {
    if is_fd { Frame::MAX_DATA } else { Frame::MAX_CLASSIC_DATA }
}
