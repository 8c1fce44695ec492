//! Fuzz target `mdf`: see [`checks::log`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::log::MDF.check)(input));
