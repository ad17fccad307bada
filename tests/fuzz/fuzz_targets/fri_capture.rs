//! Packets of a recording with FRI datagrams, and the observer that checks them. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::capture::fuzz(data));
