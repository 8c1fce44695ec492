//! Factors and offsets of signals, as the decimal numbers that they are written as.
//!
//! Pure. Integers are scaled exactly: a number of 64 bits has more digits than one of floating point.

use crate::wire::data_layout::DataValue;

/// Decimals of a value that are always shown if its factor has them.
const SHOWN_DECIMALS: u8 = 3;
/// Most decimals that are kept exactly.
const MAX_DECIMALS: u8 = 15;
/// Integers of floating point below this are exact.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// A factor or an offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DecimalFactor {
    number: f64,
    /// The number without its decimal point, and how many digits are behind that; `None` if it has too
    /// many.
    exact: Option<(i128, u8)>,
}

impl DecimalFactor {
    pub fn new(number: f64) -> Self {
        let exact = (0..=MAX_DECIMALS).find_map(|decimals| {
            let power = 10_f64.powi(decimals.into());
            let digits = (number * power).round();
            let is_same = (digits / power).to_bits() == number.to_bits();
            (digits.abs() < EXACT && is_same).then_some((digits as i128, decimals))
        });
        Self { number, exact }
    }

    /// The number itself.
    pub fn number(&self) -> f64 {
        self.number
    }

    /// Returns an integer times this, and an offset added, exactly; `None` where that has too many
    /// digits.
    pub fn scale(&self, integer: i128, offset: &Self) -> Option<DataValue<'static>> {
        let ((factor, of_factor), (offset, of_offset)) = (self.exact?, offset.exact?);
        let decimals = of_factor.max(of_offset);
        let power = |less: u8| 10_i128.pow(u32::from(decimals - less));
        let product = integer.checked_mul(factor.checked_mul(power(of_factor))?)?;
        let mut sum = product.checked_add(offset.checked_mul(power(of_offset))?)?;
        let mut decimals = decimals;
        // Many come from a binary factor, such as 1/256, and most of them are zeros.
        while decimals > SHOWN_DECIMALS && sum % 10 == 0 {
            (sum, decimals) = (sum / 10, decimals - 1);
        }
        Some(if decimals == 0 {
            DataValue::Integer(sum)
        } else {
            DataValue::Decimal(sum, decimals.into())
        })
    }
}
