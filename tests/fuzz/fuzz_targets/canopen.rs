//! Frames of CANopen. What must hold of them stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_can::fuzz::canopen(data));
