//! Frames and USB packets of a Segway RMP. What must hold of them stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_can::fuzz::rmp(data));
