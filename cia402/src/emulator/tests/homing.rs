//! Every homing method from every kind of position, against the geometric home.

use std::f64::consts::TAU;

use super::*;

/// Home by the definition of the profile, rad: the switch's edge, or the index beyond it.
#[expect(clippy::unreachable, reason = "a wrong test")]
fn expected(method: i8, motor: &MotorConfig) -> f64 {
    let (home_on, home_off) = motor.home;
    let (edge, side) = match if method > 16 { method - 16 } else { method } {
        1 => (motor.negative_limit, 1.0),
        2 => (motor.positive_limit, -1.0),
        3 | 7 | 14 => (home_on, -1.0),
        4 | 8 | 13 => (home_on, 1.0),
        5 | 10 | 11 => (home_off, 1.0),
        6 | 9 | 12 => (home_off, -1.0),
        _ => unreachable!("no such method"),
    };
    if method > 16 {
        return edge;
    }
    let turns = (edge - motor.index) / TAU;
    let turn = if side > 0.0 {
        turns.floor() + 1.0
    } else {
        turns.ceil() - 1.0
    };
    turn * TAU + motor.index
}

fn geometry(method: i8) -> MotorConfig {
    let ends = (-4.0 * TAU, 4.0 * TAU);
    let base = if method > 16 { method - 16 } else { method };
    MotorConfig {
        negative_limit: ends.0,
        positive_limit: ends.1,
        stops: (ends.0 - 3.0, ends.1 + 3.0),
        home: match base {
            // On for all positions right of its edge, or left of it.
            3 | 4 => (0.3, f64::INFINITY),
            5 | 6 => (f64::NEG_INFINITY, 0.3),
            _ => (-0.4, 0.9),
        },
        ..MotorConfig::default()
    }
}

fn home(method: i8, from: f64, offset: i32, quirks: Quirks) -> Rig {
    let config = DriveConfig {
        motor: geometry(method),
        position: from,
        quirks,
        ..DriveConfig::default()
    };
    let mut rig = Rig::enabled(config, 6);
    rig.set(0x6098, method);
    rig.set(0x607C, offset);
    assert_eq!(rig.status().raw() & 0x3400, 0x0400, "not started");
    rig.word(0x001F);
    rig.step();
    rig
}

#[test]
fn homing_methods_find_home_from_everywhere() {
    let per_rad = 4096.0 / TAU;
    for method in (1..=14).chain(17..=30) {
        for from in [-24.0, -6.0, -0.3, 0.0, 0.5, 0.85, 3.0, 24.0] {
            let mut rig = home(method, from, 0, Quirks::default());
            rig.until(0x3400, 0x1400, 20_000);
            // Home reads as zero, so the position is the distance from home.
            let motor = rig.drive.motor();
            let home = motor.position - f64::from(rig.position()) / per_rad;
            let expected = expected(method, motor.config());
            let error = home - expected;
            assert!(
                error.abs() < 0.01,
                "method {method} from {from}: {home}, not {expected}"
            );
        }
    }
}

#[test]
fn homing_methods_33_to_37_use_index_or_position() {
    for (method, from, expected) in [
        (33, 0.0, 1.0 - TAU),
        (34, 0.0, 1.0),
        (35, 2.0, 2.0),
        (37, 2.0, 2.0),
    ] {
        let mut rig = home(method, from, 0, Quirks::default());
        rig.until(0x3400, 0x1400, 5000);
        let home = rig.drive.motor().position - f64::from(rig.position()) * TAU / 4096.0;
        assert!((home - expected).abs() < 0.01, "method {method}: {home}");
    }
}

#[test]
fn home_offset_has_sign_of_profile_or_quirk() {
    for (quirks, sign) in [("profile", -1), ("epos4", 1)] {
        let mut rig = home(37, 2.0, 1000, Quirks::named(quirks).unwrap());
        rig.until(0x3400, 0x1400, 1000);
        assert_eq!(rig.position(), sign * 1000, "{quirks}");
    }
}

#[test]
fn homing_without_switch_is_an_error() {
    let mut motor = geometry(7);
    motor.home = (100.0, 101.0);
    let config = DriveConfig {
        motor,
        ..DriveConfig::default()
    };
    let mut rig = Rig::enabled(config, 6);
    rig.set(0x6098, 7_i8);
    rig.word(0x001F);
    rig.until(0x3400, 0x2400, 20_000);
    // A method that the drive does not have fails at once.
    rig.word(0x000F);
    rig.run(2);
    rig.set(0x6098, 16_i8);
    rig.word(0x001F);
    rig.run(2);
    assert_eq!(rig.status().raw() & 0x2000, 0x2000);
}

#[test]
fn homing_is_interrupted_by_its_bit_and_by_halt() {
    for word in [0x000F, 0x011F] {
        let mut rig = home(1, 0.0, 0, Quirks::default());
        rig.run(100);
        assert_eq!(rig.status().raw() & 0x3400, 0, "running");
        rig.word(word);
        rig.until(0x3400, 0x0400, 1000);
        assert!(rig.velocity().abs() < 200);
    }
}

#[test]
fn homing_quirk_omits_target_reached() {
    let mut rig = home(37, 0.0, 0, Quirks::named("mis").unwrap());
    rig.until(0x3400, 0x1000, 100);
    rig.run(50);
    assert_eq!(rig.status().raw() & 0x3400, 0x1000);
}
