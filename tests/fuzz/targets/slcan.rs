//! Fuzz target `slcan`: see [`checks::protocol`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::protocol::SLCAN.check)(input));
