//! Files with FRI datagrams, pcap and pcapng. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fri::capture::fuzz_file(data));
