//! Fuzz target `keys`: see [`checks::keys`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::keys::KEYS.check)(input));
