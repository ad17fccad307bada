//! Segway RMP frames and USB packets. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_can::fuzz::rmp(data));
