//! Each mode of operation except homing.

use super::*;

#[test]
fn profile_position_hand_shake() {
    let mut rig = Rig::enabled(DriveConfig::default(), 1);
    rig.set(0x607A, 10_000_i32);
    rig.word(0x001F);
    rig.step();
    assert_eq!(
        rig.status().raw() & 0x1400,
        0x1000,
        "acknowledged, not reached"
    );
    rig.word(0x000F);
    rig.step();
    assert_eq!(rig.status().raw() & 0x1000, 0, "the next is accepted");
    // One more set-point is accepted behind the current one.
    rig.set(0x607A, 12_000_i32);
    rig.word(0x001F);
    rig.step();
    rig.word(0x000F);
    rig.step();
    assert_eq!(rig.status().raw() & 0x1000, 0x1000, "the buffer is full");
    rig.set(0x607A, -5_i32);
    rig.word(0x001F);
    rig.step();
    rig.word(0x000F);
    rig.until(0x1400, 0x0400, 3000);
    assert!((rig.position() - 12_000).abs() <= 10, "{}", rig.position());
}

#[test]
fn profile_position_changes_at_once_relative_and_blended() {
    let mut rig = Rig::enabled(DriveConfig::default(), 1);
    rig.set(0x607A, 40_000_i32);
    rig.word(0x001F);
    rig.run(200);
    rig.word(0x000F);
    rig.step();
    rig.set(0x607A, 1000_i32);
    rig.word(0x003F);
    rig.step();
    rig.word(0x000F);
    rig.until(0x0400, 0x0400, 3000);
    assert!((rig.position() - 1000).abs() <= 10, "{}", rig.position());
    // Relative to the last target.
    rig.set(0x607A, 500_i32);
    rig.word(0x005F);
    rig.step();
    rig.word(0x000F);
    rig.until(0x0400, 0x0400, 3000);
    assert!((rig.position() - 1500).abs() <= 10, "{}", rig.position());
    // Through 20,000 without a stop, on to 40,000.
    rig.set(0x607A, 20_000_i32);
    rig.word(0x001F);
    rig.step();
    rig.word(0x000F);
    rig.step();
    rig.set(0x607A, 40_000_i32);
    rig.word(0x021F);
    rig.step();
    rig.word(0x020F);
    let mut slowest = i32::MAX;
    while rig.position() < 35_000 {
        rig.step();
        if rig.position() > 15_000 {
            slowest = slowest.min(rig.velocity());
        }
    }
    assert!(slowest > 30_000, "{slowest}");
    rig.until(0x0400, 0x0400, 3000);
    assert!((rig.position() - 40_000).abs() <= 10, "{}", rig.position());
}

/// 6086h = 3: the demanded velocity is smooth in PP and PV, unlike a ramp without jerk limit.
#[test]
fn jerk_limited_profile_limits_jerk() {
    for (profile, mode, jerk_max) in [
        (3_i16, 1_i8, 2_000_000.0),
        (3, 3, 2_000_000.0),
        (0, 1, f64::MAX),
    ] {
        let mut rig = Rig::enabled(DriveConfig::default(), mode);
        rig.set(0x6086, profile);
        rig.set_sub(0x60A4, 1, 2_000_000_u32);
        rig.set(0x607A, 20_000_i32);
        rig.set(0x60FF, 20_000_i32);
        rig.word(0x001F);
        let mut last = (0.0, 0.0);
        let mut largest = 0.0_f64;
        for _ in 0..1500 {
            rig.step();
            let velocity = f64::from(rig.get::<i32>(0x606B));
            let acceleration = (velocity - last.0) / 1e-3;
            largest = largest.max((acceleration - last.1).abs() / 1e-3);
            last = (velocity, acceleration);
        }
        // The demand is an integer: twice half a unit over a ms, over a ms.
        let rounding = 2e6;
        if profile == 3 {
            assert!(largest <= jerk_max + rounding, "mode {mode}: {largest}");
        } else {
            assert!(largest > 1e8, "a trapezoid has corners: {largest}");
        }
        if mode == 1 {
            assert!((rig.position() - 20_000).abs() <= 10, "{}", rig.position());
        } else {
            assert!((rig.velocity() - 20_000).abs() <= 500, "{}", rig.velocity());
        }
    }
}

#[test]
fn profile_types_unsupported_are_refused() {
    let rig = Rig::new(DriveConfig::default());
    for (kind, allowed) in [(0_i16, true), (1, false), (2, false), (3, true)] {
        let address = Address::new(0x6086, 0);
        let checked = rig
            .drive
            .check_download(&rig.d, address, &kind.to_le_bytes());
        assert_eq!(checked.is_ok(), allowed, "{kind}");
    }
}

#[test]
fn homing_methods_unsupported_are_refused() {
    let rig = Rig::new(DriveConfig::default());
    for method in i8::MIN..=i8::MAX {
        let has = matches!(method, 0..=14 | 17..=30 | 33..=35 | 37);
        let checked =
            rig.drive
                .check_download(&rig.d, Address::new(0x6098, 0), &method.to_le_bytes());
        assert_eq!(checked.is_ok(), has, "{method}");
    }
}

#[test]
fn halt_keeps_the_target() {
    let mut rig = Rig::enabled(DriveConfig::default(), 1);
    rig.set(0x607A, 40_000_i32);
    rig.word(0x001F);
    rig.run(300);
    rig.word(0x011F);
    rig.until(0x0400, 0x0400, 500);
    let halted = rig.position();
    assert!(halted < 39_000, "{halted}");
    rig.run(100);
    assert!((rig.position() - halted).abs() < 20);
    rig.word(0x001F);
    rig.run(2000);
    assert!((rig.position() - 40_000).abs() <= 10, "{}", rig.position());
}

#[test]
fn software_limits_clamp_and_set_internal_limit() {
    let mut rig = Rig::enabled(DriveConfig::default(), 1);
    rig.set_sub(0x607D, 1, -3000_i32);
    rig.set_sub(0x607D, 2, 3000_i32);
    rig.set(0x607A, 9000_i32);
    rig.word(0x001F);
    rig.until(0x0400, 0x0400, 3000);
    assert!((rig.position() - 3000).abs() <= 10, "{}", rig.position());
    assert!(rig.status().internal_limit());
}

#[test]
fn profile_velocity_ramps_and_reports_standstill() {
    let mut rig = Rig::enabled(DriveConfig::default(), 3);
    rig.run(50);
    assert_eq!(rig.status().raw() & 0x1000, 0x1000, "speed is zero");
    rig.set(0x60FF, -40_000_i32);
    rig.run(50);
    assert!((rig.velocity() + 20_000).abs() < 1500, "{}", rig.velocity());
    assert_eq!(rig.status().raw() & 0x1400, 0);
    rig.run(100);
    assert_eq!(rig.status().raw() & 0x1400, 0x0400, "target reached");
}

/// VL: revolutions per minute, its ramps, its limits and its three bits.
#[test]
fn velocity_mode_follows_ramps_limits_and_bits() {
    let mut rig = Rig::enabled(DriveConfig::default(), 2);
    rig.set(0x6042, 600_i16);
    rig.word(0x003F);
    rig.run(50);
    assert_eq!(rig.get::<i16>(0x6043), 0, "bit 6 is low: towards zero");
    rig.word(0x007F);
    rig.run(50);
    // 6000 rpm in 1 s: 300 rpm after 50 ms.
    let demand: i16 = rig.get(0x6043);
    assert!((demand - 300).abs() < 20, "{demand}");
    rig.word(0x005F);
    rig.run(50);
    assert_eq!(
        rig.get::<i16>(0x6043),
        demand,
        "bit 5 is low: the ramp is frozen"
    );
    rig.word(0x007F);
    rig.until(0x0400, 0x0400, 200);
    rig.run(100);
    let actual: i16 = rig.get(0x6044);
    assert!((actual - 600).abs() < 20, "{actual}");
    rig.set_sub(0x6046, 2, 200_u32);
    rig.run(200);
    assert_eq!(rig.get::<i16>(0x6043), 200, "the most amount");
    assert!(rig.status().internal_limit());
    rig.set_sub(0x604C, 1, 2_i32);
    rig.set(0x6042, -50_i16);
    rig.run(200);
    // In units of 2 rpm.
    assert_eq!(rig.get::<i16>(0x6043), -50);
    let turns = f64::from(rig.velocity()) / 4096.0 * 60.0;
    assert!((turns + 100.0).abs() < 10.0, "{turns} rpm");
    rig.word(0x006F);
    rig.run(100);
    assert_eq!(rig.get::<i16>(0x6043), 0, "bit 4 is low: to rest");
}

#[test]
fn profile_torque_follows_its_slope() {
    let mut rig = Rig::enabled(DriveConfig::default(), 4);
    rig.set(0x6071, 500_i16);
    rig.run(25);
    assert!(
        (rig.get::<i16>(0x6074) - 250).abs() <= 11,
        "{}",
        rig.get::<i16>(0x6074)
    );
    rig.run(30);
    assert_eq!(rig.get::<i16>(0x6074), 500);
    assert_eq!(rig.get::<i16>(0x6077), 500);
    assert!(rig.status().target_reached());
    assert!(rig.velocity() > 1000);
}

#[test]
fn cyclic_position_follows_a_sine() {
    let mut rig = Rig::enabled(DriveConfig::default(), 8);
    let mut worst = 0;
    for ms in 0..2000_u32 {
        let t = f64::from(ms) * 1e-3;
        #[expect(clippy::cast_possible_truncation, reason = "a few thousand")]
        let target = (3000.0 * (1.0 - (4.0 * t).cos())) as i32;
        rig.set(0x607A, target);
        rig.step();
        worst = worst.max((rig.position() - target).abs());
    }
    assert!(worst < 60, "{worst}");
    assert_eq!(rig.status().raw() & 0x1000, 0x1000, "drive follows");
    // Offsets are added each cycle, not piled up.
    let before = rig.position();
    rig.set(0x60B0, 200_i32);
    rig.run(200);
    let moved = rig.position() - before;
    assert!((moved - 200).abs() < 60, "{moved}");
}

#[test]
fn enabling_ignores_stale_target_until_first_set_point() {
    let config = DriveConfig {
        position: 30.0,
        ..DriveConfig::default()
    };
    let mut rig = Rig::new(config);
    rig.cyclic = false;
    rig.set(0x6060, 8_i8);
    rig.run(5);
    // A master that aligns its target: no motion.
    let here = rig.position();
    rig.set(0x607A, here);
    rig.reach(Goal::OperationEnabled);
    rig.run(100);
    assert!(
        (rig.position() - here).abs() <= 2,
        "{}",
        rig.position() - here
    );
}

#[test]
fn missing_set_points_beyond_the_limit_fault() {
    let mut rig = Rig::enabled(DriveConfig::default(), 8);
    rig.run(10);
    rig.cyclic = false;
    rig.run(3);
    assert_eq!(rig.emergencies, []);
    rig.run(20);
    assert_eq!(rig.emergencies, [FaultCode::SYNC]);
}

#[test]
fn cyclic_velocity_and_torque_add_their_offsets() {
    let mut rig = Rig::enabled(DriveConfig::default(), 9);
    rig.set(0x60FF, 10_000_i32);
    rig.set(0x60B1, 5000_i32);
    rig.run(100);
    assert!((rig.velocity() - 15_000).abs() < 300, "{}", rig.velocity());
    let mut rig = Rig::enabled(DriveConfig::default(), 10);
    rig.set(0x6071, 100_i16);
    rig.set(0x60B2, 50_i16);
    rig.run(3);
    assert_eq!(rig.get::<i16>(0x6077), 150);
}

#[test]
fn interpolated_position_waits_for_its_bit() {
    let mut rig = Rig::enabled(DriveConfig::default(), 7);
    rig.set_sub(0x60C1, 1, 400_i32);
    rig.run(50);
    assert!(rig.position().abs() < 10);
    assert_eq!(rig.status().raw() & 0x1000, 0);
    rig.word(0x001F);
    rig.run(200);
    assert!((rig.position() - 400).abs() < 10, "{}", rig.position());
    assert_eq!(rig.status().raw() & 0x1000, 0x1000);
}

/// Set-points of a constant velocity every 4 ms, each up to 0.5 ms early or late: the demand is even.
#[test]
fn cyclic_set_points_with_jitter_are_smoothed() {
    for early in [-2_i32, -1, 0, 1, 2] {
        let mut rig = Rig::enabled(DriveConfig::default(), 8);
        rig.set_sub(0x60C2, 1, 4_u8);
        let quarter = MS / 4;
        let mut velocities = vec![];
        for n in 0..400_i32 {
            // Every third one is off, by so many quarters of a ms.
            let off = |n: i32| if n % 3 == 0 { -early } else { 0 };
            let quarters = 16 + off(n + 1) - off(n);
            rig.set(0x607A, 40 * (n + 1));
            for at in 0..quarters {
                let step = Step {
                    dt: quarter,
                    set_point: at == 0,
                    link_lost: false,
                };
                let _ = rig.drive.step(&mut rig.d, &step);
                velocities.push(rig.get::<i32>(0x606B));
            }
        }
        // 40 in 4 ms. Once the phase is found.
        let settled = &velocities[200 * 16..];
        let (low, high) = (settled.iter().min().unwrap(), settled.iter().max().unwrap());
        let span = if early == 0 { 1 } else { 400 };
        assert!(
            *low >= 10_000 - span && *high <= 10_000 + span,
            "{early}: {low} to {high}"
        );
        assert_eq!(rig.drive.state(), State::OperationEnabled);
    }
}

/// Records arrive in bursts; one is consumed in each period.
#[test]
fn interpolated_position_buffer_queues_records() {
    let mut rig = Rig::enabled(DriveConfig::default(), 7);
    rig.cyclic = false;
    rig.set_sub(0x60C2, 1, 20_u8);
    rig.set_sub(0x60C4, 2, 8_u32);
    rig.set_sub(0x60C4, 6, 1_u8);
    rig.step();
    let records = (1..=8).map(|n| n * 100);
    let taken = |rig: &mut Rig, record| rig.drive.take_record(&rig.d, record);
    assert!(records.clone().all(|record| taken(&mut rig, record)));
    assert!(!taken(&mut rig, 900), "a queue refuses what does not fit");
    rig.run(50);
    assert!(rig.position().abs() < 10, "bit 4 is low");
    rig.word(0x001F);
    let demand = |rig: &Rig| rig.get::<i32>(0x6062);
    for n in 1..=8 {
        rig.run(20);
        assert!((demand(&rig) - 100 * n).abs() <= 1, "{n}: {}", demand(&rig));
        if n == 2 {
            assert!(taken(&mut rig, 900), "a slot is free again");
        }
    }
    rig.run(20);
    assert_eq!(demand(&rig), 900);
    rig.run(100);
    assert_eq!(demand(&rig), 900, "it holds the last one");
    assert!(taken(&mut rig, 700));
    rig.run(20);
    assert!((demand(&rig) - 700).abs() <= 1, "{}", demand(&rig));
}

/// Values and effects of 60C4h.
#[test]
fn interpolated_position_ring_overwrites_the_oldest_record() {
    let mut rig = Rig::enabled(DriveConfig::default(), 7);
    rig.cyclic = false;
    let next_record = |rig: &Rig| -> u16 { rig.d.get(rig.d.key(Address::new(0x60C4, 4)).unwrap()) };
    rig.set_sub(0x60C4, 2, 3_u32);
    rig.set_sub(0x60C4, 3, 1_u8);
    rig.set_sub(0x60C4, 6, 1_u8);
    for (record, next) in [(10, 1), (20, 2), (30, 0), (40, 1)] {
        assert!(rig.drive.take_record(&rig.d, record));
        rig.step();
        assert_eq!(next_record(&rig), next, "{record}");
    }
    rig.word(0x001F);
    rig.step();
    assert!(rig.get::<i32>(0x6062) <= 21, "20 is the oldest one left");
    rig.run(20);
    assert_eq!(rig.get::<i32>(0x6062), 40);
    assert!(rig.drive.take_record(&rig.d, 9_000));
    rig.set_sub(0x60C4, 6, 0_u8);
    rig.run(1);
    rig.set_sub(0x60C4, 6, 1_u8);
    rig.run(20);
    assert_eq!((rig.get::<i32>(0x6062), next_record(&rig)), (40, 0));
}

#[test]
fn mode_change_quirks_delay_and_halt_apply() {
    let mut rig = Rig::quirky(Quirks::named("halt-before-mode").unwrap());
    rig.run(5);
    rig.set(0x6060, 3_i8);
    rig.word(0x0100);
    rig.run(50);
    assert_eq!(rig.get::<i8>(0x6061), 0);
    rig.word(0x0000);
    rig.run(15);
    assert_eq!(rig.get::<i8>(0x6061), 0);
    rig.run(10);
    assert_eq!(rig.get::<i8>(0x6061), 3);
}

#[test]
fn mode_or_method_unsupported_is_refused() {
    use crate::dictionary::AbortCode;
    let rig = Rig::quirky(Quirks::named("epos4").unwrap());
    for (index, byte, expected) in [
        (0x6060, 8, Ok(())),
        (0x6060, 2, Err(AbortCode::Value)),
        (0x6060, 10, Ok(())),
        (0x6098, 37, Ok(())),
        (0x6098, 0, Err(AbortCode::Value)),
        (0x6098, 15, Err(AbortCode::Value)),
    ] {
        let address = Address::new(index, 0);
        let found = rig.drive.check_download(&rig.d, address, &[byte]);
        assert_eq!(found, expected, "{index:04X}h = {byte}");
    }
    let rig = Rig::quirky(Quirks::named("ax8000").unwrap());
    let address = Address::new(0x605A, 0);
    for (option, allowed) in [(2_i16, true), (6, true), (1, false), (-1, true)] {
        let found = rig
            .drive
            .check_download(&rig.d, address, &option.to_le_bytes());
        assert_eq!(found.is_ok(), allowed, "{option}");
    }
}

#[test]
fn positions_wrap_at_32_bits() {
    let mut rig = Rig::enabled(DriveConfig::default(), 8);
    rig.set_sub(0x6092, 1, 1_000_000_000_u32);
    rig.set(0x607F, u32::MAX);
    rig.set(0x6065, u32::MAX);
    rig.run(2);
    let mut target = rig.position();
    for _ in 0..6000 {
        target = target.wrapping_add(1_000_000);
        rig.set(0x607A, target);
        rig.step();
    }
    // Six turns of a thousand million: over the end more than once, and still close.
    rig.run(100);
    let error = rig.position().wrapping_sub(target);
    assert!(error.abs() < 1_000_000, "{error}");
    assert!(
        rig.drive.motor().position > 35.0,
        "{}",
        rig.drive.motor().position
    );
}

#[test]
fn gear_feed_and_polarity_scale_what_the_master_sees() {
    let mut rig = Rig::enabled(DriveConfig::default(), 8);
    rig.set_sub(0x6091, 1, 10_u32);
    rig.set_sub(0x6092, 1, 360_000_u32);
    rig.set(0x607E, 0x80_u8);
    rig.run(2);
    for step in 0..1000 {
        rig.set(0x607A, -36 * step);
        rig.step();
    }
    rig.run(100);
    // A tenth of a turn of the shaft is one of the motor, and vice versa.
    let turns = rig.drive.motor().position / std::f64::consts::TAU;
    assert!((turns - 0.999).abs() < 0.01, "{turns}");
    assert!((rig.position() + 35_964).abs() < 100, "{}", rig.position());
}

#[test]
fn touch_probes_latch_edges_and_the_index() {
    let mut rig = Rig::enabled(
        DriveConfig {
            position: -3.0,
            ..DriveConfig::default()
        },
        3,
    );
    let per_rad = 4096.0 / std::f64::consts::TAU;
    // Probe 1 at the home switch, both edges, once; probe 2 at the index pulse, again and again.
    rig.set(0x60B8, 0x0031_u16 | 0x1700);
    rig.set(0x60FF, 4000_i32);
    rig.run(1500);
    assert_eq!(rig.get::<u16>(0x60B9), 0x0307);
    for (index, expected) in [(0x60BA, -0.5), (0x60BB, 0.5), (0x60BC, 1.0)] {
        let found = f64::from(rig.get::<i32>(index));
        let expected = expected * per_rad;
        assert!(
            (found - expected).abs() < 8.0,
            "{index:04X}h: {found}, not {expected}"
        );
    }
    rig.set(0x60B8, 0_u16);
    rig.step();
    assert_eq!(rig.get::<u16>(0x60B9), 0);
}
