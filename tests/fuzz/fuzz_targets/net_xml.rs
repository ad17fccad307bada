//! The XML form of nets. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_net::fuzz::net_xml(data));
