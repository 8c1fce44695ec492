//! Fuzz target `filter`: see [`checks::filter`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::filter::FILTER.check)(input));
