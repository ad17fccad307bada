//! Messages of clients of live data. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_server::fuzz_live(data));
