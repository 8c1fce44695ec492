//! Fuzz target `document`: see [`checks::document`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::document::DOCUMENT.check)(input));
