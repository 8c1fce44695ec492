//! A signal: where it is in the data, and what its number means.
//!
//! Pure. Does not know messages.

use super::decimal::DecimalFactor;
use crate::wire::data_layout::DataValue;
use crate::wire::descriptor::ByteOrder;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Significant digits of floating-point numbers.
const DIGITS: usize = 15;

/// How the bits of a signal are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum SignalKind {
    #[default]
    Unsigned,
    Signed,
    /// IEEE 754 number of 32 bits.
    Float,
    /// IEEE 754 number of 64 bits.
    Double,
}

/// A signal of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct MessageSignal {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) kind: SignalKind,
    pub(super) order: ByteOrder,
    /// Bit as the file has it: in little-endian order the lowest one, in big-endian order the highest one.
    pub(super) start: u32,
    /// Number of bits, 1 to 64.
    pub(super) size: u32,
    pub(super) factor: DecimalFactor,
    pub(super) offset: DecimalFactor,
    /// Names of values.
    pub(super) values: BTreeMap<i128, String>,
    /// `None` if it is always there.
    pub(super) multiplexed: Option<Multiplexed>,
}

/// When a signal is there.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Multiplexed {
    /// Place of its multiplexor among the signals of the message.
    pub by: usize,
    /// Values of that, as they are in the data.
    pub values: Vec<RangeInclusive<u64>>,
}

impl Multiplexed {
    /// Returns true if the signal is there at this value of its multiplexor.
    pub fn has(&self, raw: u64) -> bool {
        self.values.iter().any(|range| range.contains(&raw))
    }
}

impl MessageSignal {
    /// Name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the bits in data; `None` if the data are too short for them.
    pub(super) fn raw(&self, data: &[u8]) -> Option<u64> {
        // The place of the first bit, in the order of the bits of the number.
        let first = match self.order {
            ByteOrder::Little => self.start,
            ByteOrder::Big => self.start / 8 * 8 + 7 - self.start % 8,
        };
        let end = first.checked_add(self.size)?;
        let bytes = data.get(first as usize / 8..(end as usize).div_ceil(8))?;
        // At most nine bytes.
        let add = |number: u128, byte: &u8| number << 8 | u128::from(*byte);
        let (number, below) = match self.order {
            ByteOrder::Little => (bytes.iter().rev().fold(0, add), first % 8),
            ByteOrder::Big => (bytes.iter().fold(0, add), (8 - end % 8) % 8),
        };
        Some((number >> below) as u64 & u64::MAX >> (64 - self.size))
    }

    /// Reads the value; `None` if the data are too short.
    pub(super) fn value(&self, data: &[u8]) -> Option<DataValue<'_>> {
        let raw = self.raw(data)?;
        let float = match self.kind {
            SignalKind::Float => Some(shortest(f32::from_bits(raw as u32))),
            SignalKind::Double => Some(f64::from_bits(raw)),
            SignalKind::Unsigned | SignalKind::Signed => None,
        };
        if let Some(number) = float {
            let is_whole = number.fract() == 0.0 && number.abs() < 1e18;
            let name = self.values.get(&(number as i128)).filter(|_| is_whole);
            let scaled = || number * self.factor.number() + self.offset.number();
            let value = name.map(|name| DataValue::Named(name));
            return Some(value.unwrap_or_else(|| DataValue::Float(scaled(), DIGITS)));
        }
        let is_negative = self.kind == SignalKind::Signed && raw >> (self.size - 1) & 1 == 1;
        let number = i128::from(raw) - if is_negative { 1_i128 << self.size } else { 0 };
        if let Some(name) = self.values.get(&number) {
            return Some(DataValue::Named(name));
        }
        let float = || {
            DataValue::Float(number as f64 * self.factor.number() + self.offset.number(), DIGITS)
        };
        Some(self.factor.scale(number, &self.offset).unwrap_or_else(float))
    }
}

/// Returns an integer as it is, and otherwise the number with the fewest digits that is the same one in 32
/// bits.
fn shortest(number: f32) -> f64 {
    let exact = f64::from(number);
    if exact.fract() == 0.0 { exact } else { number.to_string().parse().unwrap_or(exact) }
}
