//! Recordings of wires: pcap, pcapng, ERF. What must hold stands with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_link::capture::fuzz(data));
