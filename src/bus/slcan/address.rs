//! `slcan:DEVICE[@RATE[/DATA_RATE]]`: what an slcan argument names.

use super::line::{self, data_rate_code, data_rates, rate_code};
use crate::bitrate;
use crate::bus::absolute_path::absolute;
use crate::bus::kind::BusKind;
use crate::diagnostic::Diagnostic;
use std::path::PathBuf;

pub(in crate::bus) const KIND: BusKind = BusKind {
    scheme: "slcan",
    forms: &["slcan:DEVICE@RATE"],
    example: "slcan:/dev/ttyACM0@500000",
    note: None,
    can_send: true,
};

/// A serial adapter and its bit rates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlcanAddress {
    /// The serial device.
    pub device: PathBuf,
    /// Bit/s, one that slcan has a code for; `None`: the adapter keeps its own.
    pub bitrate: Option<u32>,
    /// Bit/s of the FD data phase; `None`: no FD frames are sent.
    pub data_bitrate: Option<u32>,
}

impl SlcanAddress {
    /// Returns the bit rates as they stand behind the device: `@500000/2000000`; empty without them.
    pub fn rates(&self) -> String {
        let bitrate = self.bitrate.map(|rate| format!("@{rate}"));
        let data_bitrate = self.data_bitrate.map(|rate| format!("/{rate}"));
        [bitrate, data_bitrate].into_iter().flatten().collect()
    }
}

pub(in crate::bus) fn parse(text: &str) -> Result<SlcanAddress, Diagnostic> {
    if text.is_empty() {
        return Err(KIND.incomplete());
    }
    let Some((device, rates)) = text.rsplit_once('@') else {
        return Ok(SlcanAddress { device: text.into(), bitrate: None, data_bitrate: None });
    };
    let rate = |text: &str| {
        let fault = || Diagnostic::new(format!("{rates} is not a bit rate"));
        bitrate::parse(text).ok_or_else(|| fault().with_remedy(format!("use {}", KIND.example)))
    };
    let (bitrate, data_bitrate) = match rates.split_once('/') {
        Some((bitrate, data)) => (rate(bitrate)?, Some(rate(data)?)),
        None => (rate(rates)?, None),
    };
    if rate_code(bitrate).is_none() {
        return Err(not_supported(bitrate, "", &line::rates()));
    }
    if let Some(data) = data_bitrate.filter(|data| data_rate_code(*data).is_none()) {
        return Err(not_supported(data, " in the data phase", &data_rates()));
    }
    Ok(SlcanAddress { device: device.into(), bitrate: Some(bitrate), data_bitrate })
}

fn not_supported(rate: u32, phase: &str, rates: &str) -> Diagnostic {
    let fault = Diagnostic::new(format!("slcan does not support {rate} bit/s{phase}"));
    fault.with_remedy(format!("use {rates}"))
}

/// The address that all spellings of one bus share: without bit rates.
pub(in crate::bus) fn normalised(address: &SlcanAddress) -> SlcanAddress {
    SlcanAddress { device: absolute(&address.device), bitrate: None, data_bitrate: None }
}

pub(in crate::bus) fn text(address: &SlcanAddress) -> String {
    format!("{}{}", address.device.display(), address.rates())
}
