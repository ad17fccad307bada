//! Jogs of other modes, jogs of drives whose quick stop does not brake, and a halt of another master.

use super::*;

fn by_mode(mode: i8, velocity: i32, ms: u64) -> Plan {
    Plan {
        mode,
        ..jog(velocity, ms)
    }
}

fn turns(lab: &mut Lab) -> f64 {
    axis(&mut lab.devices).motor().position / std::f64::consts::TAU
}

fn set(lab: &mut Lab, index: u16, sub: u8, value: &[u8]) {
    let mut asker = SdoClient::new(node(5), TIMEOUT);
    let answer = asker.write(lab, Address::new(index, sub), value, false);
    answer.unwrap().unwrap();
}

#[test]
fn can_jog_by_set_point_arrives_and_restores() {
    let mut lab = lab();
    let before = lab
        .drive(0)
        .dictionary()
        .bytes(Address::new(0x6081, 0))
        .unwrap()
        .to_vec();
    let report = run(&mut lab, by_mode(1, -20_480, 1000));
    assert_eq!(
        report.diagnosis,
        None,
        "{}",
        super::super::text::verdict(&report)
    );
    // 5 turns of 4096 increments.
    let turned = turns(&mut lab);
    assert!((turned + 5.0).abs() < 0.05, "{turned}");
    assert!(axis(&mut lab.devices).motor().velocity.abs() < 0.1);
    let after = lab
        .drive(0)
        .dictionary()
        .bytes(Address::new(0x6081, 0))
        .unwrap();
    assert_eq!(after, before);
}

#[test]
fn can_jog_by_cyclic_set_points_arrives() {
    let mut lab = lab();
    let report = run(&mut lab, by_mode(8, 20_480, 2000));
    assert_eq!(
        report.diagnosis,
        None,
        "{}",
        super::super::text::verdict(&report)
    );
    // Its largest speed is 5 turns/s, its mean half of that.
    let turned = turns(&mut lab);
    assert!((turned - 5.0).abs() < 0.05, "{turned}");
    assert_eq!(axis(&mut lab.devices).state(), State::SwitchOnDisabled);
}

#[test]
fn can_jog_of_each_mode_stops_on_ctrl_c() {
    for mode in [1, 8] {
        let mut lab = lab();
        lab.stop_at = Some(lab.now() + Duration::from_secs(1));
        let report = run(&mut lab, by_mode(mode, 20_000, 8000));
        let text = super::super::text::verdict(&report);
        assert!(
            report.stopped && report.diagnosis.is_none(),
            "{mode}: {text}"
        );
        assert!(states(&report).contains(&State::QuickStopActive), "{mode}");
        assert!(axis(&mut lab.devices).motor().velocity.abs() < 0.1);
        assert_eq!(axis(&mut lab.devices).state(), State::SwitchOnDisabled);
    }
}

#[test]
fn can_jog_of_a_blocked_motor_fails_in_each_mode() {
    for mode in [1, 8] {
        let mut lab = lab();
        set(&mut lab, 0x6072, 0, &[0, 0]);
        // Without it the following error would be a fault first.
        set(&mut lab, 0x6065, 0, &u32::MAX.to_le_bytes());
        let report = run(&mut lab, by_mode(mode, 2000, 4000));
        let cause = report.diagnosis.expect("a diagnosis").cause;
        let known = ["does-not-turn", "runaway"].contains(&cause.name());
        assert!(known, "{mode}: {cause:?}");
    }
}

/// 605Ah is 0: a quick stop takes the power from a turning motor.
#[test]
fn can_jog_without_braking_quick_stop_brakes_by_ramp() {
    let mut lab = lab();
    set(&mut lab, 0x605A, 0, &[0, 0]);
    lab.stop_at = Some(lab.now() + Duration::from_secs(1));
    let report = run(&mut lab, jog(20_000, 60_000));
    let text = super::super::text::verdict(&report);
    assert!(report.stopped && report.diagnosis.is_none(), "{text}");
    assert!(text.contains("note: 605Ah is 0"), "{text}");
    assert!(!states(&report).contains(&State::QuickStopActive));
    // It was at rest before it lost its power.
    let last = report
        .steps
        .iter()
        .rfind(|step| step.status.state() == Ok(State::OperationEnabled));
    let off = report
        .steps
        .iter()
        .find(|step| step.at > last.unwrap().at)
        .unwrap();
    assert!(off.velocity.abs() < 500, "{off:?}");
}

#[test]
fn can_jog_that_nothing_brakes_is_rejected() {
    let mut lab = lab();
    set(&mut lab, 0x605A, 0, &[0, 0]);
    let (cause, text) = diagnosed(&mut lab, by_mode(8, 20_000, 1000));
    assert_eq!(cause, Cause::Coasts, "{text}");
    let (cause, _) = diagnosed(&mut lab, by_mode(1, 20_000, 1000));
    assert_eq!(cause, Cause::Coasts);
}

/// Another master holds the motor by the halt bit.
#[test]
fn can_jog_held_by_foreign_halt_names_the_bit() {
    let mut lab = lab();
    let halt = Frame::new(node(5).cob(RPDO1), &[0x0F, 0x01]).unwrap();
    let begun = lab.now();
    for ms in 600..6000 {
        let at = begun + Duration::from_millis(ms);
        lab.other_master.push((at, halt));
    }
    let (cause, text) = diagnosed(&mut lab, jog(20_000, 4000));
    assert!(
        matches!(cause, Cause::Overwritten { holds: 0x010F, .. }),
        "{text}"
    );
    assert!(text.contains("bit 8 (halt)"), "{text}");
}
