//! Fuzz target `dbc`: see [`checks::dbc`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::dbc::DBC.check)(input));
