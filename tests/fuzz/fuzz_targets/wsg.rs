//! Packets of WSG grippers. The property is defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_device_wsg::wire::fuzz(data));
