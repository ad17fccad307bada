//! The example of a driver of one's own runs: a controller with that driver, and a net that moves it.

#[allow(dead_code, reason = "its main function prints")]
#[path = "../examples/own_driver.rs"]
mod own_driver;

#[test]
fn own_driver_example_moves_by_a_net() {
    takt_tests::steady(|| {
        let position = own_driver::turn().unwrap();
        assert!((0.25..0.32).contains(&position), "it is at {position} rad");
    });
}
