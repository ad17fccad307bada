//! `takt ecat youbot` on an emulated youBot, in virtual time.

use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{YouBot as Slaves, YouBotConfig};

use super::*;
use crate::ecat::tests::Emulated;

fn session(goal: AlState) -> (Session<Emulated>, Slaves) {
    let (segment, bot) = Slaves::segment(&YouBotConfig::default());
    let config = MasterConfig {
        goal,
        ..MasterConfig::default()
    };
    let mut session = Session::new(
        "emulated",
        Emulated::new(segment),
        [2, 0, 0, 0, 0, 1],
        config,
    )
    .unwrap();
    session.bring_up(Duration::from_secs(10)).unwrap();
    (session, bot)
}

#[test]
fn youbot_status_names_each_drive_and_its_flags() {
    let (mut session, bot) = session(AlState::PreOp);
    let (text, good) = status(&mut session).unwrap();
    assert!(good, "{text}");
    assert_eq!(text.lines().count(), 10);
    let wheel =
        "    1 TMCM-1632  1632 2.00   24.0 V    120     0  -      motor halted, velocity mode";
    assert_eq!(text.lines().nth(1), Some(wheel));
    assert!(
        text.contains("10 TMCM-1610  1610 2.00   24.0 V    120     0  no "),
        "{text}"
    );
    bot.wheels[0].lock().emergency_stop = true;
    session.run_for(Duration::from_millis(10)).unwrap();
    let (text, good) = status(&mut session).unwrap();
    assert!(!good && text.contains("emergency stop"), "{text}");
}

#[test]
fn youbot_parameters_are_read_written_and_stored() {
    let (mut session, _) = session(AlState::PreOp);
    let parameter = named("max_current").unwrap();
    for request in writing(parameter, 0, 1234, true).unwrap() {
        assert!(call(&mut session, 6, request).unwrap().is_ok());
    }
    let read = call(&mut session, 6, parameter.get(0)).unwrap();
    assert_eq!(read, Ok(Answer::Value(1234)));
    // Protected ones are unlocked first.
    let limit = named("i2t_limit").unwrap();
    let refused = call(&mut session, 6, limit.set(0, 5).unwrap()).unwrap();
    assert_eq!(refused, Err(CallError::Refused(TmclError::Protected)));
    for request in writing(limit, 0, 5, false).unwrap() {
        assert!(call(&mut session, 6, request).unwrap().is_ok());
    }
    assert!(
        named("max_curent")
            .unwrap_err()
            .to_string()
            .contains("`parameters` lists")
    );
    let bar = named("bar_max_speed").unwrap();
    assert!(writing(bar, 0, 3000, false).is_err() && writing(bar, 0, 5, true).is_err());
    assert_eq!(list().lines().count(), 1 + parameters::ALL.len());
}

/// Whether joints were homed, and what was reported.
fn homed(session: &mut Session<Emulated>, joints: &[usize]) -> (bool, Vec<String>) {
    let mut lines = Vec::new();
    let good = home::home(session, joints, &|| false, |line| {
        lines.push(line.to_owned());
        Ok(())
    });
    (good.unwrap(), lines)
}

#[test]
fn youbot_homing_moves_joints_and_refuses_wheels() {
    let (mut session, bot) = session(AlState::Op);
    assert!(home::check(&session, &[1]).is_err());
    let joints = [6, 7, 8, 9, 10];
    home::check(&session, &joints).unwrap();
    let (good, lines) = homed(&mut session, &joints);
    assert!(good, "{lines:?}");
    for joint in 0..5 {
        assert!(lines.contains(&format!("joint {joint}: towards its stop")));
        assert!(lines.contains(&format!("joint {joint}: homed")));
        assert!(bot.arms[0][joint].lock().angle().abs() < 0.05);
    }
    let (good, lines) = homed(&mut session, &joints[..1]);
    assert!(good, "{lines:?}");
    assert!(lines[0].ends_with("it did not move"), "{lines:?}");
}

#[test]
fn youbot_homing_uses_the_current_limits_of_the_driver() {
    let (mut session, _) = session(AlState::Op);
    homed(&mut session, &[6, 7, 8, 9, 10]);
    let parameter = named("max_current").unwrap();
    for (slave, expected) in (6..).zip(takt_ethercat::youbot::CURRENT_MAX_MA) {
        assert_eq!(read(&mut session, slave, parameter, 0).unwrap(), expected);
    }
}

#[test]
fn youbot_homing_without_motion_is_reported() {
    let (mut session, _) = session(AlState::Op);
    assert!(homed(&mut session, &[6]).0);
    // Its position is forgotten while it rests at its stop.
    let calibrated = named("calibrated").unwrap();
    call(&mut session, 6, calibrated.set(0, 0).unwrap())
        .unwrap()
        .unwrap();
    let (good, lines) = homed(&mut session, &[6]);
    assert!(!good, "{lines:?}");
    let last = lines.last().unwrap();
    assert!(
        last.starts_with("joint 0: homed where it stood: it did not move\nhint: "),
        "{lines:?}"
    );
}

#[test]
fn youbot_homing_with_a_drive_fault_fails() {
    let (mut session, bot) = session(AlState::Op);
    bot.arms[0][0].lock().extra_flags = 1 << 6;
    let (good, lines) = homed(&mut session, &[6]);
    assert!(!good);
    assert_eq!(lines.len(), 1);
    assert!(lines[0].contains("encoder error"), "{lines:?}");
}

#[test]
fn youbot_homing_stopped_by_the_user_holds_joints() {
    let (mut session, bot) = session(AlState::Op);
    let mut lines = Vec::new();
    let is_stopped = || bot.arms[0][0].lock().angle() < 0.05;
    let good = home::home(&mut session, &[6], &is_stopped, |line| {
        lines.push(line.to_owned());
        Ok(())
    });
    assert!(!good.unwrap());
    assert_eq!(lines.last().unwrap(), "stopped: the joints hold");
    let at = bot.arms[0][0].lock().angle();
    assert!(at > 0.01, "{at}");
}

/// Writes a value, and the verdict on the motion that follows.
fn written(session: &mut Session<Emulated>, name: &str, value: i32) -> anyhow::Result<Verdict> {
    let parameter = named(name)?;
    let motion = Motion::new(session, 10, parameter, 0, value)?;
    for request in writing(parameter, 0, value, false)? {
        call(session, 10, request)?.unwrap();
    }
    motion.map_or(Ok(Verdict::Good), |motion| motion.check(session))
}

#[test]
fn youbot_target_without_motion_is_reported() {
    let (mut session, _) = session(AlState::PreOp);
    // The bars of the gripper follow their mailbox; a drive without process data does not.
    assert_eq!(
        written(&mut session, "bar_target_position", -2000).unwrap(),
        Verdict::Good
    );
    assert_eq!(
        written(&mut session, "target_position", 4000).unwrap(),
        Verdict::Failed
    );
    assert_eq!(
        written(&mut session, "target_speed", 0).unwrap(),
        Verdict::Good
    );
    assert_eq!(
        written(&mut session, "max_current", 900).unwrap(),
        Verdict::Good
    );
}

#[test]
fn youbot_target_speed_above_the_drive_limit_is_rejected() {
    let (mut session, _) = session(AlState::PreOp);
    let most = read(&mut session, 10, named("max_positioning_speed").unwrap(), 0).unwrap();
    let error = written(&mut session, "target_speed", -most - 1).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("is too fast: max_positioning_speed of slave 10 is"),
        "{text}"
    );
    assert!(text.contains("\nhint: "), "{text}");
}
