//! Fuzz target `scenario`: see [`checks::scenario`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::scenario::SCENARIO.check)(input));
