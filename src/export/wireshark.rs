//! A dissector for Wireshark: a table of numbers and names, and the Lua program that uses it.

use super::ExportFacts;
use crate::catalogue::DeviceType;
use crate::text::Escaped;
use crate::wire::id::Service;
use crate::wire::node::Mode;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The program; `profile` is the table before it.
const DISSECTOR: &str = include_str!("dissector.lua");

const HEAD: &str = "\
-- Dissector for Wireshark 4.0 and later: CAN platform frames with DES.
-- Written by descan profile export --wireshark: change the profile and write it again.
--
-- Copy it to the folder of Help > About Wireshark > Folders > Personal Lua Plugins, or:
-- tshark -X lua_script:FILE -r session.pcapng
";

/// Returns the text of the Lua file.
pub fn dissector(facts: ExportFacts) -> String {
    let mut text = HEAD.to_owned();
    text.push_str("\nlocal profile = {\n");
    let profile = facts.profile;
    let mut number = |name: &str, value: Option<u16>| {
        if let Some(value) = value {
            let _ = writeln!(text, "    {name} = {value},");
        }
    };
    number("heartbeat", Some(profile.services.heartbeat));
    number("des", Some(profile.services.des));
    let layout = &profile.heartbeat;
    number("uid_offset", layout.uid_offset.map(u16::from));
    number("mode_offset", layout.mode_offset.map(u16::from));
    number("error_offset", layout.error_offset.map(u16::from));
    let modes = profile.modes.codes().into_iter().zip(Mode::ALL);
    push_names(&mut text, 1, "modes", modes.map(|(code, mode)| (code.into(), mode.name())));
    text.push_str("    alphabet = {\n");
    for row in 0..8 {
        let characters = (8 * row..8 * row + 8).map(|value| profile.uid.character(value));
        let characters: Vec<_> = characters.map(|it| quoted(it.encode_utf8(&mut [0; 4]))).collect();
        let _ = writeln!(text, "        {},", characters.join(", "));
    }
    text.push_str("    },\n");
    let services = (0..=Service::MAX)
        .filter_map(|number| Some((number, profile.service_name(Service::from_bits(number))?)));
    push_names(&mut text, 1, "services", services);
    let common = facts.catalogue.common_types().iter();
    let (mut services, mut messages) = (BTreeMap::new(), BTreeMap::new());
    // Of two the first one counts.
    for of in common.rev() {
        services.extend(services_of(of));
        messages.extend(messages_of(of));
    }
    push_names(&mut text, 1, "common_services", services);
    push_names(&mut text, 1, "common_debug", messages);
    let given = profile.debug_names.iter().map(|(code, name)| (*code, name.as_str()));
    push_names(&mut text, 1, "debug_names", given);
    text.push_str("    types = {\n");
    for (name, of) in facts.catalogue.named_types() {
        let _ = writeln!(text, "        [{}] = {{", quoted(name));
        push_names(&mut text, 3, "services", services_of(of));
        push_names(&mut text, 3, "debug", messages_of(of));
        text.push_str("        },\n");
    }
    text.push_str("    },\n}\n\n");
    text.push_str(DISSECTOR);
    text
}

fn services_of(of: &DeviceType) -> impl Iterator<Item = (u16, &str)> {
    let services = of.services.iter();
    services.filter_map(|service| Some((service.number?.number(), service.name.as_str())))
}

fn messages_of(of: &DeviceType) -> impl Iterator<Item = (u16, &str)> {
    of.debug_messages.iter().map(|(code, message)| (*code, message.name.as_str()))
}

/// Appends a table of names by number; what is not printable is escaped, as descan shows it.
fn push_names<'a>(
    text: &mut String,
    depth: usize,
    name: &str,
    names: impl IntoIterator<Item = (u16, &'a str)>,
) {
    let indent = "    ".repeat(depth);
    let _ = writeln!(text, "{indent}{name} = {{");
    for (number, name) in names {
        let _ = writeln!(
            text,
            "{indent}    [{number}] = {},",
            quoted(&Escaped(name.as_bytes()).to_string())
        );
    }
    let _ = writeln!(text, "{indent}}},");
}

/// A string of Lua: what is not plain is a decimal escape of three digits.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for byte in text.bytes() {
        match byte {
            b'"' | b'\\' => quoted.extend(['\\', char::from(byte)]),
            0x20..=0x7E => quoted.push(char::from(byte)),
            _ => {
                let _ = write!(quoted, "\\{byte:03}");
            }
        }
    }
    quoted.push('"');
    quoted
}
