//! The layout of the data of a user service: fields with a name, a type, a place and a unit, as a
//! file describes them.
//!
//! The sources of the protocol leave the data of user services open (CAN platform §4.1: 0 to 8
//! bytes). Pure: data in, values out. A field that the data are too short for has no value. Does not
//! know which service or message the data are of.

use super::descriptor::ByteOrder;
use crate::text::{Escaped, hex, is_printable};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::ops::Range;
use toml::Spanned;

/// Most fields of a layout: one for each bit of a frame of classic CAN.
const MAX_FIELDS: usize = 64;
/// Most bytes of data: those of a frame of CAN FD.
const MAX_DATA: usize = 64;
/// Most characters of a name or a unit.
const MAX_NAME: usize = 40;
/// Most decimals of a scaled value.
const MAX_DECIMALS: i32 = 9;

/// How the bytes of a field are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// Unsigned integer of this number of bytes, 1 to 8.
    Unsigned(usize),
    /// Signed integer, two's complement, of this number of bytes, 1 to 8.
    Signed(usize),
    /// IEEE 754 number of 4 bytes.
    Float,
    /// IEEE 754 number of 8 bytes.
    Double,
    /// One byte, or one bit: 0 is no, all else yes.
    Bool,
    /// Text up to the first byte 00.
    Text,
    /// Bytes as they are.
    Bytes,
}

impl FieldType {
    /// Words of a file, in the order of the guide.
    pub const WORDS: [&'static str; 15] = [
        "u8", "u16", "u24", "u32", "u64", "i8", "i16", "i24", "i32", "i64", "f32", "f64", "bool",
        "text", "bytes",
    ];

    fn from_word(word: &str) -> Option<Self> {
        let bits = |digits: &str| digits.parse::<usize>().ok().map(|bits| bits / 8);
        if !Self::WORDS.contains(&word) {
            return None;
        }
        match word {
            "f32" => Some(Self::Float),
            "f64" => Some(Self::Double),
            "bool" => Some(Self::Bool),
            "text" => Some(Self::Text),
            "bytes" => Some(Self::Bytes),
            _ if word.starts_with('u') => bits(&word[1..]).map(Self::Unsigned),
            _ => bits(&word[1..]).map(Self::Signed),
        }
    }

    /// Number of bytes; `None` for those that take the rest of the data.
    const fn size(self) -> Option<usize> {
        match self {
            Self::Unsigned(size) | Self::Signed(size) => Some(size),
            Self::Float => Some(4),
            Self::Double => Some(8),
            Self::Bool => Some(1),
            Self::Text | Self::Bytes => None,
        }
    }

    const fn is_integer(self) -> bool {
        matches!(self, Self::Unsigned(_) | Self::Signed(_))
    }
}

/// A field of the data.
#[derive(Clone, Debug, PartialEq)]
pub struct DataField {
    name: String,
    kind: FieldType,
    /// First byte.
    at: usize,
    /// Number of bytes; `None` for the rest of the data.
    size: Option<usize>,
    /// Lowest bit and number of bits of the integer that the bytes are; `None` for all.
    bits: Option<(u32, u32)>,
    /// Scale and offset; `None` for the number itself.
    scaling: Option<(f64, f64)>,
    unit: String,
    /// Names of values.
    values: BTreeMap<i64, String>,
}

/// Significant digits of a floating point number of 32 bits.
pub const FLOAT_DIGITS: usize = 6;

/// A value of a field.
#[derive(Clone, Debug, PartialEq)]
pub enum DataValue<'a> {
    /// An integer.
    Integer(i128),
    /// A scaled number, with this many decimals.
    Scaled(f64, usize),
    /// A number of so many decimals, at least one, without its decimal point.
    Decimal(i128, usize),
    /// A floating point number, with this many significant digits.
    Float(f64, usize),
    /// A truth value.
    Bool(bool),
    /// A value that has a name.
    Named(&'a str),
    /// Text, not escaped.
    Text(&'a [u8]),
    /// Bytes.
    Bytes(&'a [u8]),
}

/// A field and its value.
#[derive(Clone, Debug, PartialEq)]
pub struct DataFieldValue<'a> {
    /// Name of the field.
    pub name: &'a str,
    /// Unit; empty without one.
    pub unit: &'a str,
    /// Value; `None` if the data are too short for it.
    pub value: Option<DataValue<'a>>,
}

/// The fields of the data of a message.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataLayout {
    fields: Vec<DataField>,
}

/// A field as a file has it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DataFieldEntry {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    at: Option<usize>,
    bit: Option<u32>,
    bits: Option<u32>,
    length: Option<usize>,
    scale: Option<f64>,
    offset: Option<f64>,
    unit: Option<String>,
    #[serde(default)]
    values: BTreeMap<String, String>,
}

impl DataFieldEntry {
    /// Checks it; `before` is the field in front.
    fn checked(self, before: Option<&DataField>) -> Result<DataField, String> {
        check_name(&self.name, "the name of a field")?;
        let name = &self.name;
        let kind = FieldType::from_word(&self.kind).ok_or_else(|| {
            let words = FieldType::WORDS.join(", ");
            format!("{name}: a type is one of {words}, not \"{}\"", Escaped(self.kind.as_bytes()))
        })?;
        let is_bits = self.bit.is_some() || self.bits.is_some();
        if is_bits && !(kind.is_integer() || kind == FieldType::Bool) {
            return Err(format!("{name}: bit and bits are for integers and bool"));
        }
        let size = match (kind.size(), self.length) {
            (Some(_), Some(_)) => return Err(format!("{name}: length is for text and bytes")),
            (None, length) => length,
            (size, None) => size,
        };
        if size == Some(0) {
            return Err(format!("{name}: a field has at least one byte"));
        }
        let at = match (self.at, before) {
            (Some(at), _) => at,
            (None, None) => 0,
            // Bits beside each other are of one byte or number.
            (None, Some(before)) if is_bits && before.bits.is_some() && before.size == size => {
                before.at
            }
            (None, Some(before)) => {
                let size = before.size.ok_or_else(|| {
                    format!("{name}: needs at, behind {} which takes all bytes", before.name)
                })?;
                before.at + size
            }
        };
        if at >= MAX_DATA || size.is_some_and(|size| at.saturating_add(size) > MAX_DATA) {
            return Err(format!("{name}: ends behind byte {}, the last of a frame", MAX_DATA - 1));
        }
        let bits = is_bits.then(|| {
            let width = self.bits.unwrap_or(1);
            (self.bit.unwrap_or(0), width)
        });
        if let Some((bit, width)) = bits {
            let all = 8 * size.unwrap_or(1) as u32;
            if width == 0 || bit.checked_add(width).is_none_or(|end| end > all) {
                return Err(format!("{name}: bit and bits exceed the {all} bits of {}", self.kind));
            }
        }
        let (scale, offset) = (self.scale.unwrap_or(1.0), self.offset.unwrap_or(0.0));
        if !scale.is_finite() || !offset.is_finite() || scale == 0.0 {
            return Err(format!("{name}: scale and offset are numbers, and scale is not 0"));
        }
        let is_scaled = self.scale.is_some() || self.offset.is_some();
        let has_numbers = kind.is_integer() || matches!(kind, FieldType::Float | FieldType::Double);
        if is_scaled && !has_numbers {
            return Err(format!("{name}: scale and offset are for numbers"));
        }
        let unit = self.unit.unwrap_or_default();
        if !unit.is_empty() {
            check_name(&unit, "a unit")?;
        }
        let width = bits.map_or(8 * size.unwrap_or(1) as u32, |(_, width)| width);
        let values = values_of(name, kind, width, self.values)?;
        let scaling = is_scaled.then_some((scale, offset));
        Ok(DataField { name: self.name, kind, at, size, bits, scaling, unit, values })
    }
}

/// Checks the names of values of a field of so many bits.
fn values_of(
    name: &str,
    kind: FieldType,
    width: u32,
    written: BTreeMap<String, String>,
) -> Result<BTreeMap<i64, String>, String> {
    let may_be_named = kind.is_integer() || kind == FieldType::Bool;
    if !written.is_empty() && !may_be_named {
        return Err(format!("{name}: values are for integers and bool"));
    }
    let named = |(number, text): (String, String)| {
        check_name(&text, "the name of a value")?;
        let value = match number.strip_prefix("0x") {
            Some(digits) => i64::from_str_radix(digits, 16),
            None => number.parse(),
        };
        let number = Escaped(number.as_bytes());
        let value = value.map_err(|_| format!("{name}: \"{number}\" is not an integer"))?;
        let (least, most) = range_of(kind, width);
        if !(least..=most).contains(&i128::from(value)) {
            return Err(format!("{name}: the value {number} is not {least} to {most}"));
        }
        Ok((value, text))
    };
    written.into_iter().map(named).collect()
}

/// The least and the greatest value of a field of so many bits, 1 to 64.
const fn range_of(kind: FieldType, width: u32) -> (i128, i128) {
    match kind {
        FieldType::Signed(_) => (-(1 << (width - 1)), (1 << (width - 1)) - 1),
        _ => (0, (1 << width) - 1),
    }
}

/// Checks a text that is shown on the screen.
///
/// # Errors
///
/// It is empty, long, or has characters that are not printable.
pub(crate) fn check_name(text: &str, what: &str) -> Result<(), String> {
    if text.trim().is_empty() || text.trim() != text || text.chars().count() > MAX_NAME {
        return Err(format!("{what} has 1 to {MAX_NAME} characters, without blanks around them"));
    }
    match text.chars().find(|&c| !is_printable(c)) {
        Some(odd) => Err(format!("{what}: {odd:?} is not printable")),
        None => Ok(()),
    }
}

/// The fields of the data of a message, as a file has them.
#[derive(Default, Deserialize)]
#[serde(transparent)]
pub(crate) struct DataLayoutEntry(Vec<Spanned<DataFieldEntry>>);

impl DataLayoutEntry {
    /// Returns true without fields.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Checks the fields.
    ///
    /// # Errors
    ///
    /// The place of the first wrong field, and what is wrong.
    pub(crate) fn checked(self) -> Result<DataLayout, (Range<usize>, String)> {
        let mut fields: Vec<DataField> = Vec::with_capacity(self.0.len().min(MAX_FIELDS));
        for entry in self.0 {
            let (span, entry) = (entry.span(), entry.into_inner());
            let field = match entry {
                _ if fields.len() == MAX_FIELDS => Err(format!("at most {MAX_FIELDS} fields")),
                entry if fields.iter().any(|known| known.name == entry.name) => {
                    Err(format!("two fields are called {}", entry.name))
                }
                entry => entry.checked(fields.last()),
            };
            fields.push(field.map_err(|why| (span, why))?);
        }
        Ok(DataLayout { fields })
    }
}

/// An integer or a floating-point number: where it is, and what its value means.
#[derive(Clone, Copy, Debug)]
pub struct NumberField<'a> {
    /// Name.
    pub name: &'a str,
    /// How its bytes are read.
    pub kind: FieldType,
    /// First byte.
    pub at: usize,
    /// Number of bytes.
    pub size: usize,
    /// Lowest bit of the number that the bytes are, and number of bits.
    pub bits: (u32, u32),
    /// Scale and offset.
    pub scaling: (f64, f64),
    /// Unit; empty without one.
    pub unit: &'a str,
    /// Names of values.
    pub values: &'a BTreeMap<i64, String>,
}

impl DataField {
    /// Name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How its bytes are read.
    pub fn kind(&self) -> FieldType {
        self.kind
    }

    /// First byte, and number of bytes; `None` for the rest of the data.
    pub fn place(&self) -> (usize, Option<usize>) {
        (self.at, self.size)
    }

    /// Scale and offset; `None` for the number itself.
    pub fn scaling(&self) -> Option<(f64, f64)> {
        self.scaling
    }

    /// Decimals of the scaled value; `None` if it is shown with significant digits.
    pub fn decimals(&self) -> Option<usize> {
        let (scale, offset) = self.scaling.filter(|_| self.kind.is_integer())?;
        Some(decimals(scale)?.max(decimals(offset)?))
    }

    /// Unit; empty without one.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// Returns it as a number; `None` for text and bytes.
    pub fn number(&self) -> Option<NumberField<'_>> {
        let size = self.kind.size()?;
        Some(NumberField {
            name: &self.name,
            kind: self.kind,
            at: self.at,
            size,
            bits: self.bits.unwrap_or((0, 8 * size as u32)),
            scaling: self.scaling.unwrap_or((1.0, 0.0)),
            unit: &self.unit,
            values: &self.values,
        })
    }

    /// Reads the value; `None` if the data are too short.
    fn value<'a>(&'a self, data: &'a [u8], order: ByteOrder) -> Option<DataValue<'a>> {
        let end = self.size.map_or(data.len(), |size| self.at + size);
        let bytes = data.get(self.at..end).filter(|bytes| !bytes.is_empty())?;
        match self.kind {
            FieldType::Text => {
                let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
                return Some(DataValue::Text(&bytes[..end]));
            }
            FieldType::Bytes => return Some(DataValue::Bytes(bytes)),
            FieldType::Float | FieldType::Double => {
                let number = unsigned(bytes, order);
                let number = if self.kind == FieldType::Float {
                    f64::from(f32::from_bits(number as u32))
                } else {
                    f64::from_bits(number)
                };
                return Some(
                    self.scaled(number).unwrap_or(DataValue::Float(number, self.digits())),
                );
            }
            FieldType::Unsigned(_) | FieldType::Signed(_) | FieldType::Bool => {}
        }
        let (bit, width) = self.bits.unwrap_or((0, 8 * bytes.len() as u32));
        let mask = if width >= 64 { u64::MAX } else { (1 << width) - 1 };
        let number = unsigned(bytes, order).checked_shr(bit).unwrap_or(0) & mask;
        let number = match self.kind {
            FieldType::Signed(_) if width > 0 && width < 128 && number >> (width - 1) & 1 == 1 => {
                i128::from(number) - (1_i128 << width)
            }
            _ => i128::from(number),
        };
        let name = i64::try_from(number).ok().and_then(|number| self.values.get(&number));
        if let Some(name) = name {
            return Some(DataValue::Named(name));
        }
        if self.kind == FieldType::Bool {
            return Some(DataValue::Bool(number != 0));
        }
        Some(self.scaled(number as f64).unwrap_or(DataValue::Integer(number)))
    }

    /// Significant digits of a number: as many as all numbers of its type have.
    pub const fn digits(&self) -> usize {
        match self.kind {
            FieldType::Float => FLOAT_DIGITS,
            _ => 15,
        }
    }

    /// Returns a number times scale plus offset; `None` if it is not scaled.
    fn scaled(&self, number: f64) -> Option<DataValue<'static>> {
        let (scale, offset) = self.scaling?;
        let value = number * scale + offset;
        Some(match self.decimals() {
            Some(decimals) => DataValue::Scaled(value, decimals),
            None => DataValue::Float(value, self.digits()),
        })
    }
}

/// Number of decimals of a number; `None` for more than [`MAX_DECIMALS`].
fn decimals(number: f64) -> Option<usize> {
    let is_whole = |decimals: &i32| {
        let shifted = number * 10_f64.powi(*decimals);
        (shifted - shifted.round()).abs() < 1e-9 * shifted.abs() || number == 0.0
    };
    (0..=MAX_DECIMALS).find(is_whole).map(|decimals| decimals.unsigned_abs() as usize)
}

/// Writes a number with so many significant digits; with an exponent where it is far from 1.
fn write_number(f: &mut fmt::Formatter<'_>, number: f64, digits: usize) -> fmt::Result {
    let decimals = digits.saturating_sub(1);
    let rounded = format!("{number:.decimals$e}").parse::<f64>().unwrap_or(number);
    if rounded == 0.0 || !rounded.is_finite() || (1e-6..1e15).contains(&rounded.abs()) {
        write!(f, "{rounded}")
    } else {
        write!(f, "{rounded:e}")
    }
}

/// Returns the integer of at most eight bytes.
fn unsigned(bytes: &[u8], order: ByteOrder) -> u64 {
    let add = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
    match order {
        ByteOrder::Little => bytes.iter().rev().fold(0, add),
        ByteOrder::Big => bytes.iter().fold(0, add),
    }
}

impl DataLayout {
    /// Returns true without fields.
    pub fn is_empty(&self) -> bool {
        self.fields.is_empty()
    }

    /// The fields, in the order of the file.
    pub fn fields(&self) -> &[DataField] {
        &self.fields
    }

    /// Returns the fields of data, in the order of the file.
    pub fn values<'a>(&'a self, data: &'a [u8], order: ByteOrder) -> Vec<DataFieldValue<'a>> {
        let value = |field: &'a DataField| DataFieldValue {
            name: &field.name,
            unit: &field.unit,
            value: field.value(data, order),
        };
        self.fields.iter().map(value).collect()
    }

    /// Returns the bytes behind the last field.
    pub fn rest<'a>(&self, data: &'a [u8]) -> &'a [u8] {
        let ends = self.fields.iter().map(|it| it.size.map_or(data.len(), |size| it.at + size));
        let end = ends.max().unwrap_or(0);
        data.get(end..).unwrap_or_default()
    }

    /// Returns the data in words, escaped: `speed 1200 rpm, direction forward`. A field that the data
    /// are too short for is `–`; bytes behind the last field follow as they are.
    pub fn in_words(&self, data: &[u8], order: ByteOrder) -> String {
        let mut text = String::new();
        for field in self.values(data, order) {
            let separator = if text.is_empty() { "" } else { ", " };
            let _ = write!(text, "{separator}{field}");
        }
        let rest = self.rest(data);
        if !rest.is_empty() && !self.is_empty() {
            let _ = write!(text, ", + {}", hex(rest, " "));
        }
        text
    }
}

/// `speed 1200 rpm`, escaped.
impl fmt::Display for DataFieldValue<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(value) = &self.value else { return write!(f, "{} –", self.name) };
        write!(f, "{} {value}", self.name)?;
        if self.unit.is_empty() { Ok(()) } else { write!(f, " {}", self.unit) }
    }
}

/// The value alone, escaped.
impl fmt::Display for DataValue<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(number) => write!(f, "{number}"),
            Self::Scaled(number, decimals) => write!(f, "{number:.decimals$}"),
            Self::Decimal(digits, decimals) => {
                let (sign, power) =
                    (if *digits < 0 { "-" } else { "" }, 10_u128.pow(*decimals as u32));
                let (whole, rest) = (digits.unsigned_abs() / power, digits.unsigned_abs() % power);
                write!(f, "{sign}{whole}.{rest:0decimals$}")
            }
            Self::Float(number, digits) => write_number(f, *number, *digits),
            Self::Bool(is_set) => f.write_str(if *is_set { "yes" } else { "no" }),
            Self::Named(name) => f.write_str(name),
            Self::Text(text) => write!(f, "\"{}\"", Escaped(text)),
            Self::Bytes(bytes) => f.write_str(&hex(bytes, " ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct LayoutFile {
        fields: DataLayoutEntry,
    }

    fn layout(fields: &str) -> Result<DataLayout, String> {
        let file = format!("fields = [{fields}]");
        let file = toml::from_str::<LayoutFile>(&file);
        let file = file.map_err(|error| error.message().to_owned())?;
        file.fields.checked().map_err(|(_, why)| why)
    }

    fn words(fields: &str, data: &[u8]) -> String {
        layout(fields).unwrap().in_words(data, ByteOrder::Little)
    }

    #[test]
    fn values_are_read_by_type_place_and_scale() {
        let speed = r#"{ name = "speed", type = "u16", unit = "rpm" },
            { name = "t", type = "i16", scale = 0.01, offset = -40, unit = "°C" }"#;
        assert_eq!(words(speed, &[0xB0, 0x04, 0xF6, 0xFF]), "speed 1200 rpm, t -40.10 °C");
        let big = layout(speed).unwrap().in_words(&[0x04, 0xB0, 0xFF, 0xF6], ByteOrder::Big);
        assert_eq!(big, "speed 1200 rpm, t -40.10 °C");
        let bits = r#"{ name = "on", type = "bool", bit = 0 },
            { name = "gear", type = "u8", bit = 1, bits = 3, values = { 0 = "P", 2 = "D" } },
            { name = "trim", type = "i8", bit = 4, bits = 4 },
            { name = "next", type = "u8" }"#;
        assert_eq!(words(bits, &[0b1111_0101, 7]), "on yes, gear D, trim -1, next 7");
        assert_eq!(words(bits, &[0b0111_0110, 7]), "on no, gear 3, trim 7, next 7");
        let float = r#"{ name = "f", type = "f32" }, { name = "n", type = "text" }"#;
        assert_eq!(words(float, &[0, 0, 0x20, 0x41, b'a', 0x1B, 0, b'z']), "f 10, n \"a\\x1B\"");
        assert_eq!(words(r#"{ name = "i", type = "i64" }"#, &[0xFF; 8]), "i -1");
        let scaled = |scale: &str, number: f32| {
            let field = format!("{{ name = \"v\", type = \"f32\", {scale} }}");
            words(&field, &number.to_le_bytes())
        };
        assert_eq!(scaled("scale = 1000", 0.0004), "v 0.4");
        assert_eq!(scaled("offset = -273", 300.65), "v 27.65");
        assert_eq!(scaled("unit = \"V\"", 0.1), "v 0.1 V");
        assert_eq!(scaled("scale = 1e30", 2.0), "v 2e30");
        assert_eq!(words(r#"{ name = "u", type = "u8", scale = 1e-20 }"#, &[5]), "u 5e-20");
        assert_eq!(words(r#"{ name = "u", type = "u64" }"#, &[0xFF; 8]), format!("u {}", u64::MAX));
    }

    #[test]
    fn data_too_short_or_long_are_shown_as_they_are() {
        let two = r#"{ name = "a", type = "u8" }, { name = "b", type = "u16" }"#;
        assert_eq!(words(two, &[1, 2]), "a 1, b –");
        assert_eq!(words(two, &[]), "a –, b –");
        assert_eq!(words(two, &[1, 2, 0, 9, 8]), "a 1, b 2, + 09 08");
    }

    #[test]
    fn mistakes_in_fields_are_named() {
        let cases = [
            (r#"{ name = "a", type = "u7" }"#, "a type is one of"),
            (r#"{ name = "", type = "u8" }"#, "1 to 40 characters"),
            (r#"{ name = "a\u001b", type = "u8" }"#, "not printable"),
            (
                r#"{ name = "a", type = "u8" }, { name = "a", type = "u8" }"#,
                "two fields are called a",
            ),
            (r#"{ name = "a", type = "u8", bit = 7, bits = 2 }"#, "exceed the 8 bits"),
            (r#"{ name = "a", type = "u8", bit = 4294967295, bits = 2 }"#, "exceed the 8 bits"),
            (r#"{ name = "a", type = "u8", bits = 0 }"#, "exceed"),
            (r#"{ name = "a", type = "text", bit = 1 }"#, "for integers"),
            (r#"{ name = "a", type = "u32", at = 61 }"#, "ends behind byte 63"),
            (r#"{ name = "a", type = "u32", at = 9223372036854775807 }"#, "ends behind byte 63"),
            (r#"{ name = "a", type = "u8", scale = 0 }"#, "scale is not 0"),
            (r#"{ name = "a", type = "u8", scale = nan }"#, "are numbers"),
            (r#"{ name = "a", type = "bool", scale = 2 }"#, "for numbers"),
            (r#"{ name = "a", type = "u8", length = 2 }"#, "for text and bytes"),
            (r#"{ name = "a", type = "bytes", length = 0 }"#, "at least one byte"),
            (r#"{ name = "a", type = "bytes" }, { name = "b", type = "u8" }"#, "needs at"),
            (r#"{ name = "a", type = "u8", values = { x = "y" } }"#, "not an integer"),
            (
                r#"{ name = "a", type = "u8", values = { 256 = "y" } }"#,
                "a: the value 256 is not 0 to 255",
            ),
            (
                r#"{ name = "a", type = "i8", values = { -129 = "y" } }"#,
                "a: the value -129 is not -128 to 127",
            ),
            (
                r#"{ name = "a", type = "u8", bits = 3, values = { 0x8 = "y" } }"#,
                "a: the value 0x8 is not 0 to 7",
            ),
            (r#"{ name = "a", type = "bool", bit = 1, values = { 2 = "y" } }"#, "is not 0 to 1"),
            (r#"{ name = "a", type = "u8", sclae = 2 }"#, "unknown field"),
        ];
        for (fields, expected) in cases {
            let error = layout(fields).unwrap_err();
            assert!(error.contains(expected), "{fields}: {error}");
        }
    }
}
