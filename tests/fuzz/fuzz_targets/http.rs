//! HTTP request heads and the credentials in them. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_server::fuzz_http_head(data));
