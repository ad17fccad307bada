//! Requests of the scope. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_server::fuzz_scope(data));
