//! Many hand-overs between nets in virtual time, at a logical period of 500 us: every cycle has
//! exactly one set-point, from the net whose turn it is.

#[path = "../benches/cell/switches.rs"]
mod switches;

use switches::Switched;

/// Hand-overs; more with the environment variable `TAKT_SWITCHES`.
const SWITCHES: u32 = 5_000;

#[test]
fn net_switch_skips_and_repeats_no_cycle() {
    let wanted = std::env::var("TAKT_SWITCHES").map(|text| text.parse().expect("a number"));
    let switches = wanted.unwrap_or(SWITCHES);
    let expected = Switched {
        switches,
        missing: 0,
        doubled: 0,
    };
    assert_eq!(switches::run(switches), expected);
}
