//! Recordings of a controller, MCAP. What must hold stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_core::record::fuzz(data));
