//! Fuzz target `profile`: see [`checks::profile`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::profile::PROFILE.check)(input));
