//! Fuzz target `udp`: see [`checks::udp`].
#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| (checks::udp::UDP.check)(input));
