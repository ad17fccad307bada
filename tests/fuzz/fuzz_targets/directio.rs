//! DirectIO messages and how they are cut from streams. What must hold of them stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_server::wire::fuzz(data));
