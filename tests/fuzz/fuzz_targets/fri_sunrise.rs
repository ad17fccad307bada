//! Messages of FRI for Sunrise, both ways, framed and not. What must hold of them stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::sunrise::wire::fuzz(data));
