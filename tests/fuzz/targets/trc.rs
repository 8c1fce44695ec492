//! Fuzz target `trc`: see [`checks::log`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::log::TRC.check)(input));
