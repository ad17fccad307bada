//! Object code of L-IRL. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_irl::fuzz::code(data));
