//! Simulated time, which begins once in a process: a test of its own program.
#![allow(clippy::unwrap_used, reason = "a test may fail anywhere")]

use takt_embedded::{Embedded, EmulatedCell, Error, simulate_time};

#[test]
fn cell_file_is_refused_in_simulated_time() {
    simulate_time(1.0).unwrap();
    simulate_time(2.0).unwrap();
    let cell = EmulatedCell::named("two_lwr").unwrap();
    let error = Embedded::start(&cell.config).unwrap_err();
    assert!(matches!(error, Error::RealDevices), "{error}");
    assert!(error.to_string().contains("hint:"), "{error}");
}
