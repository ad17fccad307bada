//! FRI messages for Sunrise in both directions, framed and not. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::sunrise::wire::fuzz(data));
