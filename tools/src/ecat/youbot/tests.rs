//! The commands on an emulated youBot, in virtual time.

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
fn status_names_each_drive_and_its_flags() {
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
fn parameters_are_read_written_and_kept() {
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

#[test]
fn joints_are_homed_and_wheels_refused() {
    let (mut session, bot) = session(AlState::Op);
    assert!(home::check(&session, &[1]).is_err());
    let joints = [6, 7, 8, 9, 10];
    home::check(&session, &joints).unwrap();
    let mut lines = Vec::new();
    let good = home::home(&mut session, &joints, |line| {
        lines.push(line.to_owned());
        Ok(())
    });
    assert!(good.unwrap(), "{lines:?}");
    for joint in 0..5 {
        assert!(lines.contains(&format!("joint {joint}: towards its stop")));
        assert!(lines.contains(&format!("joint {joint}: homed")));
        assert!(bot.arms[0][joint].lock().angle().abs() < 0.05);
    }
}

#[test]
fn a_joint_that_is_stopped_on_its_way_ends_homing() {
    let (mut session, bot) = session(AlState::Op);
    bot.arms[0][0].lock().extra_flags = 1 << 6;
    let mut lines = Vec::new();
    let good = home::home(&mut session, &[6], |line| {
        lines.push(line.to_owned());
        Ok(())
    });
    assert!(!good.unwrap());
    assert_eq!(lines.len(), 1);
    assert!(lines[0].contains("encoder error"), "{lines:?}");
}
