//! FRI 1.0 datagrams, both ways. What must hold of them stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::lwr::wire::fuzz(data));
