// des_config.rs - what the device is, and the numbers of the profile, for descan::node.
// Written by descan kit --lang rust: change the profile and write it again.

use descan::node::{NodeConfig, NodeDevice};
use descan::wire::descriptor::ByteOrder;
use descan::wire::id::Service;
use descan::wire::profile::WriteEffect;

/// What the device is; GID, serial number and firmware version: NodeDevice { gid, ..DEVICE }.
#[rustfmt::skip]
pub static DEVICE: NodeDevice<'static> = NodeDevice {
    services: &[
        &["DES", "1.0"],
        &["FEED-DATA", "2.1"],
        &["LOG", "0.3"],
    ],
    ..NodeDevice::named("FEED")
};

/// The numbers of the profile.
#[rustfmt::skip]
pub static CONFIG: NodeConfig = NodeConfig {
    heartbeat: Service::from_bits(0x001),
    des: Service::from_bits(0x002),
    descriptor: [
        Some(Service::from_bits(0x010)), // gid, assumed
        Some(Service::from_bits(0x011)), // uid, assumed
        Some(Service::from_bits(0x012)), // sn, assumed
        Some(Service::from_bits(0x013)), // fw, assumed
        Some(Service::from_bits(0x014)), // caps, assumed
        Some(Service::from_bits(0x015)), // bspd, assumed
        Some(Service::from_bits(0x016)), // addr, assumed
        Some(Service::from_bits(0x017)), // autostart, assumed
    ],
    identify: Some(Service::from_bits(0x018)),
    mode: Some(Service::from_bits(0x019)),
    reboot: Some(Service::from_bits(0x01A)),
    write_address: Some(Service::from_bits(0x016)),
    write_bitrate: Some(Service::from_bits(0x015)),
    write_effect: WriteEffect::Now, // assumed
    heartbeat_ms: 1000,
    uid_offset: Some(0),
    mode_offset: Some(6),
    error_offset: Some(7),
    mode_codes: [
        0, // INIT
        1, // ARSLV
        2, // CFG
        3, // BOOT
        4, // WORK
        5, // UFUNC
        6, // IDLE
    ],
    byte_order: ByteOrder::Little, // assumed
    has_raw_framing: true, // assumed
    fd_padding: 0xCC, // assumed
    ..NodeConfig::DEFAULT
};
