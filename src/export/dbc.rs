//! A DBC file: messages of 29-bit identifiers with their signals.
//!
//! DBC has no masks: SRC and DST are 0 in each identifier (127 is DST of a DEBUG message), and a comment
//! has the mask to compare with. What DBC cannot say (ISO-TP, text, services of several types with one
//! number) is a comment.

use super::ExportFacts;
use crate::catalogue::DeviceType;
use crate::wire::data_layout::{DataField, DataLayout, FieldType, NumberField};
use crate::wire::descriptor::{ByteOrder, DescriptorField};
use crate::wire::id::{Address, Header, MessageType, Service};
use crate::wire::node::Mode;
use crate::wire::profile::{FramingChoice, Profile};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// The bits of an identifier that stay when SRC and DST are any.
const MASK: u32 = 0x1F00_03FF;
/// Marks a 29-bit identifier in a DBC file.
const EXTENDED: u32 = 0x8000_0000;
/// Most characters of a name.
const MAX_NAME: usize = 32;
/// Most bytes of data.
const MAX_DATA: usize = 64;
/// Words of a DBC file that are no names; all others of it end in an underscore.
const KEYWORDS: [&str; 7] = ["VERSION", "FILTER", "INT", "HEX", "FLOAT", "STRING", "ENUM"];

/// A signal of a message.
struct DbcSignal {
    name: String,
    /// Bit at which it starts, as a DBC file counts.
    start: usize,
    bits: usize,
    order: ByteOrder,
    is_signed: bool,
    /// 1 for IEEE 754 of 32 bits, 2 for 64 bits.
    float: Option<u8>,
    scaling: (f64, f64),
    unit: String,
    values: Vec<(i64, String)>,
    /// First byte behind it.
    end: usize,
}

impl DbcSignal {
    /// Returns an unsigned number of whole bytes.
    fn bytes(name: &str, at: usize, size: usize, order: ByteOrder) -> Self {
        Self::part(name, at, size, (0, 8 * size), order)
    }

    /// Returns some bits of the number that bytes are: the lowest one, and how many.
    fn part(
        name: &str,
        at: usize,
        size: usize,
        (low, bits): (usize, usize),
        order: ByteOrder,
    ) -> Self {
        let start = match order {
            ByteOrder::Little => 8 * at + low,
            // The place of its highest bit.
            ByteOrder::Big => {
                let high = low + bits - 1;
                8 * (at + size - 1 - high / 8) + high % 8
            }
        };
        Self {
            name: name.to_owned(),
            start,
            bits,
            order,
            is_signed: false,
            float: None,
            scaling: (1.0, 0.0),
            unit: String::new(),
            values: Vec::new(),
            end: at + size,
        }
    }

    /// The bits of the data that it takes: byte and bit in one number.
    fn places(&self) -> impl Iterator<Item = usize> {
        let (start, order) = (self.start, self.order);
        (0..self.bits).map(move |at| match order {
            ByteOrder::Little => start + at,
            ByteOrder::Big => {
                // From the highest bit downwards, then on in the next byte.
                let behind = 7 - start % 8 + at;
                8 * (start / 8 + behind / 8) + 7 - behind % 8
            }
        })
    }

    fn overlaps(&self, other: &Self) -> bool {
        let taken: BTreeSet<usize> = self.places().collect();
        other.places().any(|place| taken.contains(&place))
    }

    fn with_values(mut self, values: impl IntoIterator<Item = (i64, String)>) -> Self {
        self.values = values.into_iter().collect();
        self
    }

    fn of(field: NumberField, order: ByteOrder) -> Self {
        let (low, bits) = field.bits;
        let bits = (low as usize, bits as usize);
        let values = field.values.iter().map(|(number, name)| (*number, name.clone()));
        let mut signal =
            Self::part(field.name, field.at, field.size, bits, order).with_values(values);
        signal.is_signed = !matches!(field.kind, FieldType::Unsigned(_) | FieldType::Bool);
        signal.float = match field.kind {
            FieldType::Float => Some(1),
            FieldType::Double => Some(2),
            _ => None,
        };
        signal.scaling = field.scaling;
        field.unit.clone_into(&mut signal.unit);
        signal
    }
}

/// Messages by identifier.
#[derive(Default)]
struct DbcMessages {
    by_id: BTreeMap<u32, DbcMessage>,
    names: BTreeSet<String>,
    /// Requests have ERR set.
    has_request_err: bool,
}

struct DbcMessage {
    name: String,
    signals: Vec<DbcSignal>,
    comment: String,
}

impl DbcMessages {
    /// Adds a message of a service. Of two with one identifier the first one counts; a comment names the
    /// other one.
    fn add(
        &mut self,
        kind: MessageType,
        service: Service,
        name: &str,
        signals: Vec<DbcSignal>,
        comment: &str,
    ) {
        let mut header = header_of(kind, service);
        header.no_error |= self.has_request_err && !header.response;
        let id = header.encode();
        if let Some(first) = self.by_id.get_mut(&id) {
            if !name.is_empty() && first.name != name_of(name, kind) {
                let _ = write!(first.comment, " Also {name}.");
            }
            return;
        }
        let name = unique(&name_of(name, kind), &mut self.names);
        let (mut known, mut comment) = (BTreeSet::new(), comment.to_owned());
        let mut kept: Vec<DbcSignal> = Vec::new();
        for mut signal in signals {
            // Readers refuse a whole file for either.
            if signal.end > MAX_DATA || kept.iter().any(|other| other.overlaps(&signal)) {
                let _ = write!(
                    comment,
                    " Without {}, which overlaps another field or the end.",
                    signal.name
                );
                continue;
            }
            signal.name = unique(&word_of(&signal.name), &mut known);
            kept.push(signal);
        }
        let message = DbcMessage { name, signals: kept, comment };
        self.by_id.insert(id, message);
    }

    /// Adds the requests of a service, or its responses, in working and other modes.
    fn add_both(
        &mut self,
        kinds: [MessageType; 2],
        service: Service,
        name: &str,
        comment: &str,
        signals: impl Fn() -> Vec<DbcSignal>,
    ) {
        for kind in kinds {
            self.add(kind, service, name, signals(), comment);
        }
    }
}

const REQUESTS: [MessageType; 2] = [MessageType::ReqCcTgt, MessageType::ReqCuTgt];
const BROADCASTS: [MessageType; 2] = [MessageType::ReqCcBcst, MessageType::ReqCuBcst];
const RESPONSES: [MessageType; 2] = [MessageType::RspCcTgt, MessageType::RspCuTgt];
const UNSOLICITED: [MessageType; 2] = [MessageType::RspCcUnsc, MessageType::RspCuUnsc];

/// The identifier of a message: SRC 0, DST 0 or that of a DEBUG message, ERR set in a response.
fn header_of(kind: MessageType, service: Service) -> Header {
    let (any, is_u) =
        (Address::DEBUG, matches!(kind, MessageType::RspCuTgt | MessageType::RspCuUnsc));
    let is_d = matches!(kind, MessageType::ReqCuTgt | MessageType::ReqCuBcst);
    match kind {
        MessageType::ReqCcTgt | MessageType::ReqCuTgt | MessageType::NonConforming => {
            Header::request(any, any, is_d, service)
        }
        MessageType::ReqCcBcst | MessageType::ReqCuBcst => Header::broadcast(any, 0, is_d, service),
        MessageType::RspCcTgt | MessageType::RspCuTgt => {
            Header::request(any, any, false, service).response(any, is_u)
        }
        MessageType::RspCcUnsc | MessageType::RspCuUnsc => {
            Header::unsolicited(any, 0, is_u, service)
        }
        MessageType::Debug => Header {
            to_non_working: true,
            ..Header::unsolicited(any, Address::MAX.number(), true, service)
        },
    }
}

fn name_of(name: &str, kind: MessageType) -> String {
    word_of(&format!("{name}_{}", kind.name()))
}

/// A name as DBC allows it: letters, digits and underscores.
fn word_of(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut word: String = name.chars().map(plain).collect();
    word.truncate(word.trim_end_matches('_').len());
    if KEYWORDS.contains(&&*word)
        || word.starts_with(|c: char| c.is_ascii_digit())
        || word.is_empty()
    {
        word.insert(0, '_');
    }
    if word.len() > MAX_NAME {
        // The end has the message type.
        let tail = word.split_off(word.len() - 12);
        word.truncate(MAX_NAME - tail.len());
        word.push_str(&tail);
    }
    word
}

fn unique(name: &str, known: &mut BTreeSet<String>) -> String {
    let mut found = name.to_owned();
    let mut number = 1;
    while !known.insert(found.clone()) {
        number += 1;
        let end = format!("_{number}");
        found = format!("{}{end}", &name[..name.len().min(MAX_NAME - end.len())]);
    }
    found
}

/// A text as DBC files have it: ASCII, without quotation marks.
fn plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '"' => plain.push('\''),
            '\\' => plain.push('/'),
            ' '..='~' => plain.push(c),
            '°' => plain.push_str("deg"),
            '\u{B5}' | '\u{3BC}' => plain.push('u'),
            '\u{3A9}' | '\u{2126}' => plain.push_str("Ohm"),
            '²' => plain.push('2'),
            '³' => plain.push('3'),
            _ => plain.push('?'),
        }
    }
    plain
}

/// Returns the text of a DBC file.
pub fn dbc(facts: ExportFacts) -> String {
    let has_request_err = facts.profile.request_err;
    let mut messages = DbcMessages { has_request_err, ..DbcMessages::default() };
    add_platform(&mut messages, facts.profile);
    add_descriptor(&mut messages, facts.profile);
    add_commands(&mut messages, facts.profile);
    // What a type says of itself counts before what all devices share.
    for of in facts.catalogue.device_types().chain(facts.catalogue.common_types()) {
        add_type(&mut messages, of);
    }
    for (code, name) in &facts.profile.debug_names {
        messages.add(MessageType::Debug, Service::from_bits(*code), name, Vec::new(), "");
    }
    for (number, name) in &facts.profile.service_names {
        let service = Service::from_bits(*number);
        for kinds in [REQUESTS, RESPONSES, UNSOLICITED] {
            messages.add_both(kinds, service, name, "", Vec::new);
        }
    }
    written(&messages)
}

fn modes_of(profile: &Profile) -> Vec<(i64, String)> {
    let modes = profile.modes.codes().into_iter().zip(Mode::ALL);
    modes.map(|(code, mode)| (code.into(), mode.name().to_owned())).collect()
}

/// Heartbeat and DES.
fn add_platform(messages: &mut DbcMessages, profile: &Profile) {
    let layout = &profile.heartbeat;
    let byte = |name: &str, offset: Option<u8>| {
        Some(DbcSignal::bytes(name, offset?.into(), 1, ByteOrder::Little))
    };
    let heartbeat = || {
        let uid = layout.uid_offset;
        let uid = uid.map(|at| DbcSignal::bytes("UID", at.into(), 6, ByteOrder::Big));
        let mode = byte("MODE", layout.mode_offset);
        let mode = mode.map(|mode| mode.with_values(modes_of(profile)));
        [uid, mode, byte("ERROR", layout.error_offset)].into_iter().flatten().collect()
    };
    let comment = "Heartbeat, MSG_SRV_HR. UID: 8 characters of 6 bits, the first one on top.";
    messages.add_both(UNSOLICITED, profile.heartbeat_service(), "HR", comment, heartbeat);
    let des = profile.des_service();
    let is_raw = profile.framing == FramingChoice::Raw;
    let kinds = [(1, "name".to_owned()), (2, "services".to_owned())];
    let request = || {
        let at = if is_raw { 3 } else { 4 };
        let mut signals =
            vec![DbcSignal::bytes("TYPE", at, 1, ByteOrder::Little).with_values(kinds.clone())];
        if !is_raw {
            signals.insert(0, DbcSignal::bytes("PCI", 0, 1, ByteOrder::Little));
        }
        signals
    };
    let comment = if is_raw {
        "DES request: the letters DES and the type."
    } else {
        "DES request in an ISO-TP single frame: PCI 4, the letters DES and the type. PCI 0x30 to 0x32 is \
         flow control."
    };
    for kinds in [REQUESTS, BROADCASTS] {
        messages.add_both(kinds, des, "DES", comment, request);
    }
    let comment = if is_raw {
        "DES response: its type, then the name, or the services."
    } else {
        "DES response in ISO-TP: PCI 0x01 to 0x07 single frame, 0x10 first frame, 0x21 consecutive \
         frame. A DBC file cannot tell more."
    };
    let response = || {
        let name = if is_raw { "TYPE" } else { "PCI" };
        vec![DbcSignal::bytes(name, 0, 1, ByteOrder::Little)]
    };
    messages.add_both(RESPONSES, des, "DES", comment, response);
}

/// Reads of the descriptor and the responses to them.
fn add_descriptor(messages: &mut DbcMessages, profile: &Profile) {
    let order = profile.descriptor.byte_order;
    for field in DescriptorField::ALL {
        let service = field.service(&profile.descriptor);
        let signals = || descriptor_signals(field, order);
        let name = field.name().to_ascii_uppercase();
        let comment = format!("{}: an empty request reads it.", field.label());
        messages.add_both(RESPONSES, service, &name, &comment, signals);
    }
}

fn descriptor_signals(field: DescriptorField, order: ByteOrder) -> Vec<DbcSignal> {
    let number = |name: &str, at: usize, size: usize| DbcSignal::bytes(name, at, size, order);
    let bits = |name: &str, low: usize, count: usize| {
        DbcSignal::part(name, 0, 1, (low, count), ByteOrder::Little)
    };
    let named = |names: &[&str]| {
        let names = names.iter().map(|name| (*name).to_owned());
        (0..).zip(names).collect::<Vec<(i64, String)>>()
    };
    match field {
        DescriptorField::Gid => vec![DbcSignal::bytes("GID", 0, 6, ByteOrder::Big)],
        DescriptorField::Uid => vec![DbcSignal::bytes("UID", 0, 6, ByteOrder::Big)],
        DescriptorField::Serial => vec![number("SN", 0, 4)],
        DescriptorField::Firmware => vec![number("FW_MAJ", 0, 2), number("FW_MIN", 2, 2)],
        DescriptorField::Capabilities => vec![
            bits("PROG", 0, 1),
            bits("FPU", 1, 1),
            number("CPU", 1, 2),
            number("CPU_FLAGS", 3, 2),
        ],
        DescriptorField::Bitrate => vec![
            bits("RATE", 0, 7).with_values(named(&["125k", "250k", "500k", "1M"])),
            bits("PREFERRED", 7, 1).with_values(named(&["fixed", "preferred"])),
        ],
        DescriptorField::Address => vec![
            bits("ADDRESS", 0, 7),
            bits("PREFERRED", 7, 1).with_values(named(&["fixed", "preferred"])),
        ],
        DescriptorField::Autostart => vec![bits("AUTOSTART", 0, 1)],
    }
}

/// Commands and writes that have a number.
fn add_commands(messages: &mut DbcMessages, profile: &Profile) {
    let (commands, writes) = (&profile.commands, &profile.writes);
    let mode =
        || vec![DbcSignal::bytes("MODE", 0, 1, ByteOrder::Little).with_values(modes_of(profile))];
    let mut add = |number: u16, name: &str, signals: &dyn Fn() -> Vec<DbcSignal>| {
        messages.add_both(REQUESTS, Service::from_bits(number), name, "", signals);
    };
    add(commands.mode, "SET_MODE", &mode);
    add(commands.identify, "IDENTIFY", &Vec::new);
    if let Some(number) = commands.reboot {
        add(number, "RESTART", &Vec::new);
    }
    let order = profile.descriptor.byte_order;
    if let Some(number) = writes.address {
        add(number, "ADDR", &|| descriptor_signals(DescriptorField::Address, order));
    }
    if let Some(number) = writes.bitrate {
        add(number, "BSPD", &|| descriptor_signals(DescriptorField::Bitrate, order));
    }
}

/// The services and DEBUG messages of a type of device.
fn add_type(messages: &mut DbcMessages, of: &DeviceType) {
    let signals = |layout: &DataLayout| {
        let numbers = layout.fields().iter().filter_map(DataField::number);
        numbers.map(|field| DbcSignal::of(field, of.byte_order)).collect::<Vec<_>>()
    };
    let of_type = if of.is_common() { String::new() } else { format!("Of {}.", of.label()) };
    for service in &of.services {
        let Some(number) = service.number else { continue };
        let comment = format!("{} {of_type}", service.summary);
        let layouts = [
            (REQUESTS, &service.request),
            (BROADCASTS, &service.request),
            (RESPONSES, &service.response),
            (UNSOLICITED, &service.data),
        ];
        for (kinds, layout) in layouts {
            messages.add_both(kinds, number, &service.name, comment.trim(), || signals(layout));
        }
    }
    for (code, message) in &of.debug_messages {
        let (code, fields) = (Service::from_bits(*code), signals(&message.parameters));
        messages.add(MessageType::Debug, code, &message.name, fields, &of_type);
    }
}

fn written(messages: &DbcMessages) -> String {
    let mut text = String::from(
        "VERSION \"\"\n\nNS_ :\n    CM_\n    VAL_\n    SIG_VALTYPE_\n\nBS_:\n\nBU_:\n\n",
    );
    for (id, message) in &messages.by_id {
        let end = message.signals.iter().map(|signal| signal.end).max().unwrap_or(0);
        let length = if end > 8 { 64 } else { 8 };
        let _ = writeln!(text, "BO_ {} {}: {length} Vector__XXX", id | EXTENDED, message.name);
        for signal in &message.signals {
            let order = u8::from(signal.order == ByteOrder::Little);
            let sign = if signal.is_signed { '-' } else { '+' };
            let (scale, offset) = signal.scaling;
            let _ = writeln!(
                text,
                " SG_ {} : {}|{}@{order}{sign} ({scale:?},{offset:?}) [0|0] \"{}\" Vector__XXX",
                signal.name,
                signal.start,
                signal.bits,
                plain(&signal.unit)
            );
        }
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "CM_ \"CAN platform with DES. Written by descan profile export --dbc. SRC (bits 23 to 17) and DST \
         (16 to 10) are 0 here and any on the bus: compare identifiers with the mask 0x{MASK:08X}. Requests \
         may have ERR (bit 24) set, responses without ERR are error responses.\";"
    );
    for (id, message) in &messages.by_id {
        let comment = plain(&message.comment);
        let comment = format!("Mask 0x{MASK:08X}. {}", comment.trim());
        let _ = writeln!(text, "CM_ BO_ {} \"{}\";", id | EXTENDED, comment.trim_end());
    }
    for (id, message) in &messages.by_id {
        for signal in &message.signals {
            write_values(&mut text, id | EXTENDED, signal);
        }
    }
    text
}

fn write_values(text: &mut String, id: u32, signal: &DbcSignal) {
    if !signal.values.is_empty() {
        let _ = write!(text, "VAL_ {id} {}", signal.name);
        for (number, name) in &signal.values {
            let _ = write!(text, " {number} \"{}\"", plain(name));
        }
        text.push_str(" ;\n");
    }
    if let Some(kind) = signal.float {
        let _ = writeln!(text, "SIG_VALTYPE_ {id} {} : {kind};", signal.name);
    }
}
