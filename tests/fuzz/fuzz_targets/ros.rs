//! Messages, tokens and attachments of ROS 2. The properties are defined with the function.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| takt_fleet::ros::fuzz(data));
