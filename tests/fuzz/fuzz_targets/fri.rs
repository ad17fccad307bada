//! FRI 1.0 datagrams in both directions. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::lwr::wire::fuzz(data));
