//! `can0`: the name of a SocketCAN interface as a BUS argument.

use super::not_can;
use crate::bus::kind::BusKind;
use crate::diagnostic::Diagnostic;

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "",
    forms: &["can0"],
    example: "can0",
    note: Some("SocketCAN"),
    can_send: true,
};

/// The longest name Linux gives an interface, in bytes.
const MAX_LEN: usize = 15;

/// Checks the name of a network interface of any type.
pub(in crate::bus) fn interface_name(text: &str) -> Result<String, Diagnostic> {
    let bad = || not_a_name(&format!("{text:?}"));
    match text {
        "" => Err(Diagnostic::new("empty bus name").with_remedy("use can0 or file:LOG")),
        "." | ".." => Err(bad()),
        _ if text.starts_with("/dev/") => {
            let remedy = format!("for an slcan adapter use slcan:{text}@500000");
            Err(not_can(text).with_remedy(remedy))
        }
        _ if text.contains('/') => Err(bad()),
        _ if text.len() > MAX_LEN => Err(Diagnostic::new(format!(
            "{text} is too long for an interface name ({MAX_LEN} bytes)"
        ))),
        _ if text.contains(|c: char| c.is_whitespace() || c.is_control()) => Err(bad()),
        _ => Ok(text.to_owned()),
    }
}

fn not_a_name(text: &str) -> Diagnostic {
    Diagnostic::new(format!("{text} is not an interface name"))
}

/// The name: there is one spelling of it.
pub(in crate::bus) fn normalised(name: &str) -> String {
    name.to_owned()
}

pub(in crate::bus) fn text(name: &str) -> String {
    name.to_owned()
}
