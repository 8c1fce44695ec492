//! Fuzz target `sqlite`: see [`checks::log`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::log::SQLITE.check)(input));
