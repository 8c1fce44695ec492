//! Fuzz target `engine`: see [`checks::engine`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::engine::ENGINE.check)(input));
