//! The gripper against the emulated one, in virtual time: reference are the positions of its bars.

use super::*;
use crate::emulator::Bar;

/// How far the fingers are apart, m.
fn truth(lead: &Lead) -> f64 {
    let joint = lead.bot.arms[0][4].lock();
    joint.bars().unwrap().iter().map(Bar::opening).sum()
}

/// Blocks or releases a finger.
fn jam(lead: &Lead, jammed: bool) {
    let mut joint = lead.bot.arms[0][4].lock();
    joint.bars_mut().unwrap()[1].jammed = jammed;
}

#[test]
fn gripper_finds_its_stops_and_opens_as_commanded() {
    let mut lead = Lead::ready(Firmware::V200);
    lead.gripper.start(lead.rig.now);
    lead.until(12_000, |lead| lead.gripper.is_ready());
    lead.until(100, |lead| lead.gripper.distance().is_some());
    assert!(truth(&lead) < 1e-3, "{}", truth(&lead));
    let now = lead.rig.now;
    assert!(!lead.gripper.order(0.024, now), "too far");
    assert!(lead.gripper.order(0.02, now));
    lead.until(4000, |lead| lead.gripper.state() == GripperState::Ready);
    assert!((truth(&lead) - 0.02).abs() < 1e-3, "{}", truth(&lead));
    assert!((lead.gripper.distance().unwrap() - 0.02).abs() < 1e-4);
    // Calibrated drives are not calibrated again.
    lead.gripper.forget();
    lead.gripper.start(lead.rig.now);
    lead.may_move = false;
    lead.until(400, |lead| lead.gripper.is_ready());
}

#[test]
fn gripper_that_missed_its_stops_does_not_retry() {
    let mut lead = Lead::ready(Firmware::V200);
    jam(&lead, true);
    lead.gripper.start(lead.rig.now);
    let late = |lead: &Lead| {
        let state = lead.gripper.state();
        matches!(state, GripperState::Failed(GripperError::Late, _))
    };
    lead.until(10_000, late);
    jam(&lead, false);
    let at = truth(&lead);
    for _ in 0..3000 {
        lead.gripper.start(lead.rig.now);
        lead.cycle();
        assert!(late(&lead), "{:?}", lead.gripper.state());
    }
    // The blocked finger completes its motion; none is sent back.
    assert!(truth(&lead) >= at);
    lead.gripper.forget();
    lead.gripper.start(lead.rig.now);
    lead.until(12_000, |lead| lead.gripper.is_ready());
}

#[test]
fn gripper_on_an_object_presses_and_accepts_orders() {
    let mut lead = Lead::ready(Firmware::V200);
    lead.gripper.start(lead.rig.now);
    lead.until(12_000, |lead| lead.gripper.is_ready());
    assert!(lead.gripper.order(0.02, lead.rig.now));
    lead.until(4000, |lead| lead.gripper.state() == GripperState::Ready);
    jam(&lead, true);
    assert!(lead.gripper.order(0.0, lead.rig.now));
    lead.until(9000, |lead| lead.gripper.state() == GripperState::Short);
    lead.cycles(100);
    let distance = lead.gripper.distance().unwrap();
    assert!(
        (distance - 0.01).abs() < 1e-4,
        "one finger came: {distance}"
    );
    jam(&lead, false);
    assert!(lead.gripper.order(0.02, lead.rig.now));
    lead.until(4000, |lead| lead.gripper.state() == GripperState::Ready);
}

#[test]
fn gripper_stopped_in_motion_stays() {
    let mut lead = Lead::ready(Firmware::V200);
    lead.gripper.start(lead.rig.now);
    lead.until(12_000, |lead| lead.gripper.is_ready());
    let before = truth(&lead);
    assert!(lead.gripper.order(0.02, lead.rig.now));
    lead.until(4000, |lead| truth(lead) > before + 0.002);
    lead.gripper.stop();
    lead.until(100, |lead| lead.gripper.state() == GripperState::Ready);
    let rest = truth(&lead);
    assert!(rest < 0.015, "{rest}");
    lead.cycles(2000);
    assert!((truth(&lead) - rest).abs() < 1e-9, "it moves on");
    let distance = lead.gripper.distance().unwrap();
    assert!((distance - rest).abs() < 1e-3, "{distance} is not {rest}");
    assert!(
        lead.gripper.order(0.02, lead.rig.now),
        "it takes the next one"
    );
    lead.until(4000, |lead| lead.gripper.state() == GripperState::Ready);
    assert!((truth(&lead) - 0.02).abs() < 1e-3);
}

#[test]
fn gripper_retries_only_mailbox_errors_after_two_seconds() {
    let now = Duration::from_secs(100);
    let lost = CallError::Lost(JobError::Timeout(Duration::from_secs(1)));
    for (error, later_s, again) in [
        (GripperError::Call(lost), 1, false),
        (GripperError::Call(lost), 2, true),
        (GripperError::Call(TmclError::Command.into()), 60, false),
        (GripperError::Late, 60, false),
    ] {
        let mut gripper = Gripper::new(BarConfig::default());
        gripper.force(GripperState::Failed(error, now), [None; 2]);
        gripper.start(now + Duration::from_secs(later_s));
        let began = gripper.state() == GripperState::Setup(0);
        assert_eq!(began, again, "{error} {later_s} s later");
    }
}

#[test]
fn gripper_distance_of_any_counts_is_bounded() {
    let mut gripper = Gripper::new(BarConfig::default());
    for count in [i32::MIN, i32::MAX, 0] {
        gripper.force(GripperState::Ready, [Some(count); 2]);
        assert!(gripper.distance().is_some_and(f64::is_finite), "{count}");
    }
}
