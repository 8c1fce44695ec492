//! Parser of a udp argument: `udp:[GROUP][%INTERFACE][@PORT]`.

use super::DEFAULT_PORT;
use crate::bus::kind::BusKind;
use crate::bus::socketcan::interface_name;
use crate::diagnostic::Diagnostic;
use std::net::{IpAddr, Ipv6Addr};

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "udp",
    forms: &["udp:GROUP"],
    example: "udp:239.74.163.2",
    note: None,
    can_send: true,
};

/// Default group of python-can.
const DEFAULT_GROUP: IpAddr =
    IpAddr::V6(Ipv6Addr::new(0xFF15, 0x7079, 0x7468, 0x6F6E, 0x6465, 0x6D6F, 0x6D63, 0x6173));

/// A multicast group, its port and its interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UdpAddress {
    /// The multicast group.
    pub group: IpAddr,
    /// Network interface; `None`: selected by the system's routes.
    pub interface: Option<String>,
    /// UDP port; `None`: python-can's default.
    pub port: Option<u16>,
}

pub(in crate::bus) fn parse(text: &str) -> Result<UdpAddress, Diagnostic> {
    let bad = || {
        Diagnostic::new(format!("{text} is not a multicast group")).with_remedy(format!(
            "use {}, udp:ff15::1%eth0@43113, or udp: for python-can's default",
            KIND.example
        ))
    };
    let (place, port) = match text.rsplit_once('@') {
        Some((place, port)) => {
            let port = port.parse().ok().filter(|port| *port > 0).ok_or_else(bad)?;
            (place, Some(port))
        }
        None => (text, None),
    };
    let (group, interface) = match place.split_once('%') {
        Some((group, interface)) => (group, Some(interface_name(interface).map_err(|_| bad())?)),
        None => (place, None),
    };
    let group = if group.is_empty() { DEFAULT_GROUP } else { group.parse().map_err(|_| bad())? };
    if !group.is_multicast() {
        return Err(bad());
    }
    Ok(UdpAddress { group, interface, port })
}

/// The address that all spellings of one bus share: with the port.
pub(in crate::bus) fn normalised(address: &UdpAddress) -> UdpAddress {
    UdpAddress { port: Some(address.port.unwrap_or(DEFAULT_PORT)), ..address.clone() }
}

pub(in crate::bus) fn text(address: &UdpAddress) -> String {
    let mut text = address.group.to_string();
    text.extend(address.interface.as_ref().map(|name| format!("%{name}")));
    text.extend(address.port.map(|port| format!("@{port}")));
    text
}
