//! DirectIO messages and their framing in streams. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    takt_client::wire::fuzz(data);
    takt_server::fuzz_frames(data);
});
