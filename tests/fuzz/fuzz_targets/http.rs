//! Heads of HTTP requests and what in them lets a client in. What must hold of them stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_server::fuzz_http_head(data));
