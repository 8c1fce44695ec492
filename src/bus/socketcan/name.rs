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

/// Returns true for a word like `can0`, `vcan-test` or `mcp_can1`, not for `candump`: an interface that may
/// appear later.
pub fn is_like_an_interface(word: &str) -> bool {
    let rest = word.strip_prefix("can").or_else(|| word.strip_prefix("vcan"));
    let is_plain = rest.is_some_and(|it| !it.starts_with(|next: char| next.is_ascii_alphabetic()));
    let is_numbered = word.ends_with(|end: char| end.is_ascii_digit());
    is_plain || is_numbered && word.contains("can")
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
