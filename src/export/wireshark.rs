//! A dissector for Wireshark: a table of numbers and names, and the Lua program that uses it.

use super::ExportFacts;
use crate::catalogue::{DeviceType, TypeService};
use crate::text::{Escaped, is_printable};
use crate::wire::data_layout::{DataField, DataLayout, FieldType};
use crate::wire::descriptor::ByteOrder;
use crate::wire::id::Service;
use crate::wire::node::Mode;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

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
    let given = profile.debug_names.iter().map(|(code, name)| (*code, name.as_str()));
    push_names(&mut text, 1, "debug_names", given);
    push_unprintable(&mut text);
    text.push_str("    common = {\n");
    push_types(&mut text, 2, facts.catalogue.common_types());
    text.push_str("    },\n    types = {\n");
    for (name, of) in facts.catalogue.named_types() {
        let _ = writeln!(text, "        [{}] = {{", quoted(name));
        push_types(&mut text, 3, [of]);
        text.push_str("        },\n");
    }
    text.push_str("    },\n}\n\n");
    text.push_str(DISSECTOR);
    text
}

/// A layout of a service.
type LayoutOf = for<'a> fn(&'a TypeService) -> &'a DataLayout;

/// The layouts of a service, by their names in the program.
const SERVICE_LAYOUTS: [(&str, LayoutOf); 3] = [
    ("request", |service| &service.request),
    ("response", |service| &service.response),
    ("data", |service| &service.data),
];

/// Appends what is known of types: names of services and messages, and the fields of their data. Of two
/// with one number the first one counts.
fn push_types<'a>(
    text: &mut String,
    depth: usize,
    types: impl IntoIterator<Item = &'a Arc<DeviceType>, IntoIter: DoubleEndedIterator + Clone>,
) {
    let types = types.into_iter().rev().map(|it| &**it);
    push_names(text, depth, "services", last_of_each(types.clone().flat_map(services_of)));
    // As they are: descan shows names of messages, which are printable, without escapes.
    let messages = last_of_each(types.clone().flat_map(messages_of));
    push_quoted(
        text,
        depth,
        "debug",
        messages.into_iter().map(|(code, name)| (code, quoted(name))),
    );
    for (name, layout) in SERVICE_LAYOUTS {
        let of_type = |of: &'a DeviceType| {
            let numbered = of.services.iter().filter_map(|it| Some((it.number?.number(), it)));
            numbered.map(move |(number, it)| (number, (layout(it), of.byte_order)))
        };
        push_layouts(text, depth, name, types.clone().flat_map(of_type));
    }
    let of_type = |of: &'a DeviceType| {
        let messages = of.debug_messages.iter();
        messages.map(|(code, it)| (*code, (&it.parameters, of.byte_order)))
    };
    push_layouts(text, depth, "parameters", types.flat_map(of_type));
}

/// What stands last for each number.
fn last_of_each<T>(all: impl Iterator<Item = (u16, T)>) -> BTreeMap<u16, T> {
    all.collect()
}

fn services_of(of: &DeviceType) -> impl Iterator<Item = (u16, &str)> {
    let services = of.services.iter();
    services.filter_map(|service| Some((service.number?.number(), service.name.as_str())))
}

fn messages_of(of: &DeviceType) -> impl Iterator<Item = (u16, &str)> {
    of.debug_messages.iter().map(|(code, message)| (*code, message.name.as_str()))
}

/// Appends the ranges of characters above ASCII that are not printable.
fn push_unprintable(text: &mut String) {
    let all = ('\u{80}'..=char::MAX).filter(|&c| !is_printable(c)).map(u32::from);
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    for code in all {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == code => *last = code,
            _ => ranges.push((code, code)),
        }
    }
    text.push_str(
        "    -- Characters that are not printable: first and last, in turn.\n    unprintable = {\n",
    );
    for some in ranges.chunks(6) {
        let some = some.iter().map(|(first, last)| format!("0x{first:X}, 0x{last:X},"));
        let _ = writeln!(text, "        {}", some.collect::<Vec<_>>().join(" "));
    }
    text.push_str("    },\n");
}

/// Appends a table of names by number; what is not printable is escaped, as descan shows it.
fn push_names<'a>(
    text: &mut String,
    depth: usize,
    name: &str,
    names: impl IntoIterator<Item = (u16, &'a str)>,
) {
    let escaped = |name: &str| quoted(&Escaped(name.as_bytes()).to_string());
    push_quoted(text, depth, name, names.into_iter().map(|(number, name)| (number, escaped(name))));
}

/// Appends a table of strings of Lua by number.
fn push_quoted(
    text: &mut String,
    depth: usize,
    name: &str,
    strings: impl IntoIterator<Item = (u16, String)>,
) {
    let indent = "    ".repeat(depth);
    let _ = writeln!(text, "{indent}{name} = {{");
    for (number, string) in strings {
        let _ = writeln!(text, "{indent}    [{number}] = {string},");
    }
    let _ = writeln!(text, "{indent}}},");
}

/// Appends the fields of data, by number.
fn push_layouts<'a>(
    text: &mut String,
    depth: usize,
    name: &str,
    layouts: impl Iterator<Item = (u16, (&'a DataLayout, ByteOrder))>,
) {
    let indent = "    ".repeat(depth);
    let _ = writeln!(text, "{indent}{name} = {{");
    let layouts = layouts.filter(|(_, (layout, _))| !layout.is_empty());
    for (number, (layout, order)) in last_of_each(layouts) {
        let _ = writeln!(text, "{indent}    [{number}] = {{");
        let _ = writeln!(text, "{indent}        big_endian = {},", order == ByteOrder::Big);
        for field in layout.fields() {
            let _ = writeln!(text, "{indent}        {{ {} }},", members_of(field));
        }
        let _ = writeln!(text, "{indent}    }},");
    }
    let _ = writeln!(text, "{indent}}},");
}

/// The members of a field in a table of Lua.
fn members_of(field: &DataField) -> String {
    let kind = match field.kind() {
        FieldType::Unsigned(_) => "unsigned",
        FieldType::Signed(_) => "signed",
        FieldType::Float | FieldType::Double => "float",
        FieldType::Bool => "bool",
        FieldType::Text => "text",
        FieldType::Bytes => "bytes",
    };
    let (at, size) = field.place();
    let mut text = format!("name = {}, kind = \"{kind}\", at = {at}", quoted(field.name()));
    let mut number = |name: &str, value: Option<usize>| {
        if let Some(value) = value {
            let _ = write!(text, ", {name} = {value}");
        }
    };
    number("size", size);
    number("decimals", field.decimals());
    number("digits", Some(field.digits()));
    if let Some((scale, offset)) = field.scaling() {
        let _ = write!(text, ", scale = {scale:?}, offset = {offset:?}");
    }
    if !field.unit().is_empty() {
        let _ = write!(text, ", unit = {}", quoted(field.unit()));
    }
    if let Some(number) = field.number() {
        let (low, bits) = number.bits;
        let _ = write!(text, ", low = {low}, bits = {bits}");
        let named = |(value, name): (&i64, &String)| format!("[\"{value}\"] = {}", quoted(name));
        let values: Vec<String> = number.values.iter().map(named).collect();
        let _ = write!(text, ", values = {{ {} }}", values.join(", "));
    }
    text
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
