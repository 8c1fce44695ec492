//! Parser of a socketcand argument: `socketcand://HOST[:PORT]/BUS`.

use super::DEFAULT_PORT;
use crate::bus::kind::BusKind;
use crate::diagnostic::Diagnostic;
use std::net::IpAddr;

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "socketcand",
    forms: &["socketcand://HOST/BUS"],
    example: "socketcand://host:29536/can0",
    note: None,
    can_send: true,
};

/// The longest bus name that socketcand accepts, in bytes.
const MAX_BUS_NAME: usize = 16;

/// A bus of a socketcand server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SocketcandAddress {
    /// The server's name or address; IPv6 without brackets.
    pub host: String,
    /// The TCP port; `None`: socketcand's default.
    pub port: Option<u16>,
    /// Name of the bus on the server.
    pub interface: String,
}

pub(in crate::bus) fn parse(text: &str) -> Result<SocketcandAddress, Diagnostic> {
    let parts = text.strip_prefix("//").and_then(|rest| rest.split_once('/'));
    let parts = parts.filter(|(server, bus)| !server.is_empty() && !bus.is_empty());
    let (server, interface) = parts.ok_or_else(|| KIND.incomplete())?;
    let bad = || {
        let fault = Diagnostic::new(format!("{}:{text} is not HOST/BUS", KIND.scheme));
        fault.with_remedy(format!("use {} or socketcand://[fe80::1%eth0]/can0", KIND.example))
    };
    let (host, port) = match server.strip_prefix('[') {
        Some(rest) => {
            let (host, rest) = rest.split_once(']').ok_or_else(bad)?;
            let port =
                if rest.is_empty() { None } else { Some(rest.strip_prefix(':').ok_or_else(bad)?) };
            (host, port)
        }
        None => match server.rsplit_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (server, None),
        },
    };
    let port = port.map(|port| port.parse().ok().filter(|port| *port > 0).ok_or_else(bad));
    let port = port.transpose()?;
    let is_ipv6 = server.starts_with('[');
    let is_odd = |c: char| c.is_whitespace() || c.is_control() || c == '<' || c == '>' || c == '/';
    // The name stands between the brackets of a message.
    let is_name = interface.len() <= MAX_BUS_NAME && !interface.contains(is_odd);
    if host.is_empty() || host.contains(is_odd) || host.contains(':') && !is_ipv6 || !is_name {
        return Err(bad());
    }
    Ok(SocketcandAddress { host: host.to_owned(), port, interface: interface.to_owned() })
}

/// The address that all spellings of one bus share: with the port, and the host in one form.
pub(in crate::bus) fn normalised(address: &SocketcandAddress) -> SocketcandAddress {
    let host = match address.host.parse::<IpAddr>() {
        Ok(host) => host.to_string(),
        Err(_) => address.host.to_ascii_lowercase(),
    };
    let port = Some(address.port.unwrap_or(DEFAULT_PORT));
    SocketcandAddress { host, port, interface: address.interface.clone() }
}

pub(in crate::bus) fn text(address: &SocketcandAddress) -> String {
    let SocketcandAddress { host, port, interface } = address;
    let (open, close) = if host.contains(':') { ("[", "]") } else { ("", "") };
    let port = port.map(|port| format!(":{port}")).unwrap_or_default();
    format!("//{open}{host}{close}{port}/{interface}")
}
