//! Fuzz target `theme`: see [`checks::theme`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::theme::THEME.check)(input));
