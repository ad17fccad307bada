//! Packets of a recording with FRI datagrams, and the observer that judges them. What must hold stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::capture::fuzz(data));
