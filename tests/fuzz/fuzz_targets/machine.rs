//! Machines: compiled, drawn and stepped. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_machine::fuzz::machine(data));
