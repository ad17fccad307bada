//! `takt fri move`: a small motion of one joint, with an operator present. It rejects motions that are not small,
//! connections that are not sound, and goals near the end of a range; the motion itself is in `motion`. It is no safety
//! function.
//!
//! It starts no controller: the generation of the robot is known only after its first datagram, the guard of its session
//! allows no more than the requested speed, and its diagnoses need power, overlay and state of the session, which drivers do
//! not report.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::ensure;
use clap::Args;
use takt_fri::client::{AXES, ClientConfig, Phase, Quality, Version};
use takt_fri::diagnosis::judge;
use takt_fri::guard::Guard;
use takt_fri::lwr;
use takt_fri::sunrise;

use super::live::Seen;
use super::motion::{
    BrakeCause, Control, Goal, MARGIN_RAD, Motion, MotionState, accepts_positions,
};
use super::watch::{Port, Watched};
use crate::output::{complain, say, span};
use crate::quantity::angle;
use crate::{Verdict, confirm};

/// Largest distance, degrees.
const BY_MAX_DEG: f64 = 15.0;
/// Largest speed, degrees per second.
const SPEED_MAX_DEG_PER_S: f64 = 20.0;
/// Speed that the guard of the session accepts, as a share of the requested one.
const SPEED_SLACK: f64 = 1.05;
/// Answers after which quality is valid, if they take no longer than [`SETTLED_SPAN`].
const SETTLED: u64 = 150;
/// Time after which quality is valid with slow controllers, too.
const SETTLED_SPAN: Duration = Duration::from_secs(3);
/// Time for the robot to come to rest at its goal.
const REST: Duration = Duration::from_millis(300);
/// Timeout of braking.
const BRAKING: Duration = Duration::from_secs(5);

/// Move one joint a little, when the robot program permits it.
///
/// It becomes the client of the robot, checks that the connection is sound and the goal within range, requests a
/// confirmation, waits for command mode (an LWR's friStart, an iiwa's motion with an overlay of positions), moves, and
/// ends. Afterwards the controller receives no answers, and ends command mode. The joint moves and brakes within the last
/// stage of the drivers. Ctrl-C brakes. Exit status: 0 the joint arrived; 1 it did not; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fri move --listen 0.0.0.0:49938 --joint 4 --by 5deg
  takt fri move --listen 0.0.0.0:30200 --joint 7 --by -0.05rad --velocity 2deg/s --yes")]
pub(crate) struct Shift {
    /// Local address for the controller's datagrams.
    #[arg(long, value_name = "IP:PORT")]
    listen: SocketAddr,
    /// The joint, 1 to 7 from the base on.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=7))]
    joint: u8,
    /// Distance: 5deg, -0.05rad; at most 15 degrees.
    #[arg(long, value_name = "ANGLE", value_parser = small_angle, allow_hyphen_values = true)]
    by: f64,
    /// Largest speed: 5deg/s, 0.1rad/s; at most 20 degrees per second.
    #[arg(long, value_name = "SPEED", default_value = "5deg/s", value_parser = low_speed)]
    velocity: f64,
    /// How long to wait for a sound connection, and then for command mode.
    #[arg(long, alias = "within", value_name = "TIME", default_value = "30s", value_parser = span)]
    ready_timeout: Duration,
    /// It is safe that the robot moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
    #[command(flatten)]
    port: Port,
}

fn small_angle(text: &str) -> Result<f64, String> {
    let by = angle(text)?;
    if by == 0.0 || by.abs() > BY_MAX_DEG.to_radians() + 1e-9 {
        return Err(format!(
            "must be small: up to {BY_MAX_DEG} deg in either direction, and not 0"
        ));
    }
    Ok(by)
}

fn low_speed(text: &str) -> Result<f64, String> {
    let number = text.strip_suffix("/s").ok_or_else(|| {
        format!("`{text}` is no speed: write a number and a unit, such as 5deg/s")
    })?;
    let speed = angle(number)?;
    if speed <= 0.0 || speed > SPEED_MAX_DEG_PER_S.to_radians() + 1e-9 {
        return Err(format!(
            "must be above 0, up to {SPEED_MAX_DEG_PER_S} deg/s"
        ));
    }
    Ok(speed)
}

/// `Err` in the result: why the joint did not arrive, a finding rather than an error of the call.
type Outcome = anyhow::Result<Result<(), String>>;

impl Shift {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let control = Arc::new(Control::default());
        let goal = Goal {
            joint: usize::from(self.joint - 1),
            by_rad: self.by,
            speed: self.velocity,
        };
        let motion = Motion::new(goal, Arc::clone(&control));
        let mut watched = Watched::start(&self.port, self.listen, self.config(), motion)?;
        complain(&format!(
            "waiting for a controller at {}",
            watched.live.local
        ));
        let outcome = self.perform(&mut watched, &control);
        watched.live.stop()?;
        match outcome? {
            Ok(()) => Ok(Verdict::Good),
            Err(why) => {
                say(&why)?;
                Ok(Verdict::Failed)
            }
        }
    }

    /// Sessions whose guards accept no more than was requested.
    fn config(&self) -> ClientConfig {
        let guard = |names| Guard {
            speed_rad_per_s: [self.velocity * SPEED_SLACK; AXES],
            ..Guard::open(names)
        };
        ClientConfig {
            lwr: lwr::SessionConfig {
                guard: guard(lwr::JOINT_NAMES),
                ..lwr::SessionConfig::default()
            },
            sunrise: sunrise::SessionConfig {
                guard: guard(sunrise::JOINT_NAMES),
                ..sunrise::SessionConfig::default()
            },
            ..ClientConfig::default()
        }
    }

    /// From the first measurement to the end of the motion.
    fn perform(&self, watched: &mut Watched, control: &Control) -> Outcome {
        let before = match self.sound(watched)? {
            Ok(seen) => seen,
            Err(why) => return Ok(Err(why)),
        };
        let (name, plan) = match self.plan(&before) {
            Ok(plan) => plan,
            Err(why) => return Ok(Err(why)),
        };
        complain(&plan);
        confirm::motion("this", self.confirm_motion)?;
        control.start();
        if let Err(why) = self.follow(watched, control)? {
            return Ok(Err(why));
        }
        rest(watched);
        let moved = |seen: &Seen| {
            seen.status
                .measured
                .map(|joints| joints[usize::from(self.joint - 1)])
        };
        let (from, to) = (moved(&before), moved(&watched.live.seen()));
        let moved = from.zip(to).map_or(0.0, |(from, to)| to - from);
        match arrived(name, self.by, moved) {
            Ok(text) => say(&text)?,
            Err(why) => return Ok(Err(why)),
        }
        Ok(Ok(()))
    }

    /// Waits until the connection is sound enough for a motion.
    fn sound(&self, watched: &mut Watched) -> anyhow::Result<Result<Seen, String>> {
        let started = Instant::now();
        loop {
            let (seen, faults) = watched.look();
            let is_there = seen.status.phase != Phase::Offline;
            if let Some(fault) = faults.into_iter().next() {
                return Ok(Err(fault));
            }
            if let Some(why) = wrong_overlay(&seen) {
                return Ok(Err(why));
            }
            let is_sound = seen.status.quality.is_some_and(Quality::is_sound);
            if is_there && is_sound && seen.observed.answers >= settled(&seen) {
                return Ok(Ok(seen));
            }
            if started.elapsed() >= self.ready_timeout {
                return Ok(Err(unsound(&seen)));
            }
            ensure!(!watched.pause(), "ended before anything moved");
        }
    }

    /// Name and plan of the motion, or the limit that forbids it.
    fn plan(&self, seen: &Seen) -> Result<(&'static str, String), String> {
        let status = &seen.status;
        let (Some(version), Some(joints)) = (status.version, status.measured) else {
            return Err("the controller reports no joint positions".to_owned());
        };
        plan(version, &joints, self.joint, self.by, self.velocity)
    }

    /// Watches the motion to its end. Ctrl-C brakes.
    fn follow(&self, watched: &mut Watched, control: &Control) -> Outcome {
        let started = Instant::now();
        let mut braking: Option<Instant> = None;
        let mut is_reported = false;
        loop {
            let state = control.state();
            if state == MotionState::Moving && !is_reported {
                complain("the robot follows; Ctrl-C brakes");
                is_reported = true;
            }
            let seen = watched.live.seen();
            if state.is_end() {
                return Ok(ended(state, control.cause(), &seen));
            }
            if state == MotionState::Idle
                && let Some(why) = wrong_overlay(&seen)
            {
                return Ok(Err(why));
            }
            if state == MotionState::Idle && started.elapsed() >= self.ready_timeout {
                return Ok(Err(idle(&seen)));
            }
            if state == MotionState::Idle && braking.is_some() {
                return Ok(Err("ended before anything moved".to_owned()));
            }
            if braking.is_some_and(|since| since.elapsed() >= BRAKING) {
                return Ok(Err(
                    "the controller stopped sending while the robot braked".to_owned()
                ));
            }
            if watched.pause() && braking.is_none() {
                control.brake();
                braking = Some(Instant::now());
            }
            if seen.status.phase == Phase::Offline {
                return Ok(Err(
                    "the controller stopped sending; it brakes by itself".to_owned()
                ));
            }
        }
    }
}

/// Name and plan of the motion, or the limit that forbids it.
fn plan(
    version: Version,
    joints: &[f64; AXES],
    joint: u8,
    by: f64,
    speed: f64,
) -> Result<(&'static str, String), String> {
    let index = usize::from(joint.saturating_sub(1));
    let (Some(from), Some(range)) = (
        joints.get(index),
        version.position_max_rad().get(index).copied(),
    ) else {
        return Err(format!("there is no joint {joint}"));
    };
    let name = version.joint_names().get(index).copied().unwrap_or("?");
    let (from, to) = (from.to_degrees(), (from + by).to_degrees());
    let limit = (range - MARGIN_RAD).to_degrees();
    if to.abs() > limit + 1e-6 {
        let limit = limit.copysign(to);
        let range = range.to_degrees();
        return Err(format!(
            "{name} is at {from:.2} deg and would move to {to:.2} deg, beyond {limit:.0} deg: its range of {range:.0} deg less 2"
        ));
    }
    let text = format!(
        "{name} (joint {joint}) moves from {from:.2} deg to {to:.2} deg at up to {:.1} deg/s, as soon as the robot follows",
        speed.to_degrees()
    );
    Ok((name, text))
}

/// Answers after which quality is valid.
fn settled(seen: &Seen) -> u64 {
    let period = seen.status.period.unwrap_or_default().as_nanos().max(1);
    let in_span = SETTLED_SPAN.as_nanos() / period;
    u64::try_from(in_span).unwrap_or(SETTLED).min(SETTLED)
}

/// That the overlay of the robot program accepts no positions: waiting does not help.
fn wrong_overlay(seen: &Seen) -> Option<String> {
    let status = &seen.status;
    let mode = status
        .overlay
        .filter(|mode| !accepts_positions(Some(*mode)))?;
    let state = status.state;
    let state = state.map_or_else(|| "unknown".to_owned(), |it| it.to_string());
    Some(format!(
        "the overlay of the robot program accepts {mode} (state {state})\n\
         hint: use one of joint positions (FRIJointOverlay, POSITION)"
    ))
}

/// Why the connection is not sound.
fn unsound(seen: &Seen) -> String {
    let quality = seen.status.quality;
    if quality.is_some_and(Quality::is_sound) {
        let (answers, needed) = (seen.observed.answers, settled(seen));
        return format!(
            "only {answers} answers of {needed} left before the timeout\nhint: give it longer (--ready-timeout)"
        );
    }
    let quality = quality.map_or_else(|| "unknown".to_owned(), |it| it.to_string());
    let verdict = judge(&seen.observed);
    let because = if verdict.is_good() {
        String::new()
    } else {
        format!(": {verdict}\nhint: {}", verdict.remedy())
    };
    format!("quality is {quality}, too bad for a motion{because}")
}

/// Why the motion was not started.
fn idle(seen: &Seen) -> String {
    let status = &seen.status;
    let state = status.state;
    let state = state.map_or_else(|| "unknown".to_owned(), |it| it.to_string());
    if status.has_power == Some(false) {
        return format!(
            "the drives have no power (state {state})\nhint: release the brakes at the controller"
        );
    }
    if let Some(why) = wrong_overlay(seen) {
        return why;
    }
    let remedy = match status.version {
        Some(Version::Sunrise(_)) => {
            "run a motion with an overlay of joint positions in the robot program (FRIJointOverlay, POSITION)"
        }
        Some(Version::Lwr) | None => "call friStart in the KRL program",
    };
    format!("the robot does not follow (state {state})\nhint: {remedy}")
}

fn ended(state: MotionState, cause: BrakeCause, seen: &Seen) -> Result<(), String> {
    match state {
        MotionState::Arrived => Ok(()),
        MotionState::Beyond => Err("the controller's own set-point is nearer to the end of the range than the measured one: nothing was moved".to_owned()),
        MotionState::Left if seen.status.has_power == Some(false) => {
            Err("the drives lost their power during the motion\nhint: read the message of the controller".to_owned())
        }
        MotionState::Left => {
            let state = seen.status.state.map_or_else(|| "?".to_owned(), |it| it.to_string());
            Err(format!("the controller left command mode during the motion (now {state})\nhint: read the message of the controller"))
        }
        MotionState::Idle | MotionState::Moving | MotionState::Braking | MotionState::Stopped => Err(match cause {
            BrakeCause::Requested => "braked to rest before the goal, as requested",
            BrakeCause::Quality => "braked to rest before the goal: quality became too bad\nhint: `takt fri stat` reports which side is late",
            BrakeCause::Withheld => "braked to rest before the goal: the session withheld a position",
        }
        .to_owned()),
    }
}

/// That the joint arrived, or did not move at least half of its distance in that direction; both rad.
fn arrived(name: &str, by: f64, moved: f64) -> Result<String, String> {
    let (requested, measured) = (by.to_degrees(), moved.to_degrees());
    if moved * by.signum() * 2.0 < by.abs() {
        return Err(format!(
            "{name} did not move as commanded: {requested:.2} deg requested, {measured:.2} deg measured\n\
             hint: check its brake, contact with its surroundings, and the override and messages of the controller"
        ));
    }
    Ok(format!(
        "{name} arrived: {requested:.2} deg requested, {measured:.2} deg measured"
    ))
}

/// Waits until the arm has arrived.
fn rest(watched: &mut Watched) {
    let until = Instant::now() + REST;
    while Instant::now() < until && !watched.pause() {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_fri::client::Status;
    use takt_fri::sunrise::wire::CommandMode;

    #[test]
    fn fri_move_angles_and_speeds_have_units_and_bounds() {
        assert!((small_angle("5deg").unwrap() - 0.087_266).abs() < 1e-6);
        assert!((small_angle("-0.1rad").unwrap() + 0.1).abs() < 1e-12);
        assert!(small_angle("15deg").is_ok());
        for wrong in [
            "5", "deg", "0deg", "16deg", "-1rad", "NaNdeg", "infrad", "5 grad",
        ] {
            assert!(small_angle(wrong).is_err(), "{wrong}");
        }
        assert!((low_speed("20deg/s").unwrap() - 0.349_066).abs() < 1e-6);
        for wrong in ["5deg", "5/s", "0deg/s", "-1deg/s", "21deg/s", "1rad/s"] {
            assert!(low_speed(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn fri_move_beyond_the_range_names_the_limit() {
        let joints = [0.0, 117.0_f64.to_radians(), 0.0, 0.0, 0.0, 0.0, 0.0];
        let planned =
            |version, joint, by_deg: f64| plan(version, &joints, joint, by_deg.to_radians(), 0.1);
        assert_eq!(
            planned(Version::Lwr, 2, 2.0).unwrap_err(),
            "A2 is at 117.00 deg and would move to 119.00 deg, beyond 118 deg: its range of 120 deg less 2"
        );
        let (name, text) = planned(Version::Lwr, 3, -2.0).unwrap();
        assert_eq!(name, "E1");
        assert!(
            text.contains("from 0.00 deg to -2.00 deg at up to 5.7 deg/s"),
            "{text}"
        );
        let (name, _) = planned(Version::Sunrise(None), 3, -2.0).unwrap();
        assert_eq!(name, "A3");
        assert!(planned(Version::Lwr, 2, 1.0).is_ok());
    }

    #[test]
    fn fri_move_without_motion_fails() {
        for (by, moved) in [(0.1, 0.0), (0.1, 0.04), (-0.1, 0.1), (-0.1, -0.001)] {
            let text = arrived("A4", by, moved).unwrap_err();
            assert!(text.starts_with("A4 did not move as commanded: "), "{text}");
            assert!(text.contains("\nhint: "), "{text}");
        }
        let text = arrived("A4", -0.1, -0.099).unwrap();
        assert_eq!(text, "A4 arrived: -5.73 deg requested, -5.67 deg measured");
    }

    #[test]
    fn fri_move_names_what_holds_the_robot() {
        let seen = |version, has_power| Seen {
            status: Status {
                version: Some(version),
                has_power: Some(has_power),
                ..Status::default()
            },
            ..Seen::default()
        };
        assert!(idle(&seen(Version::Lwr, true)).contains("friStart"));
        assert!(idle(&seen(Version::Lwr, false)).contains("no power"));
        assert!(idle(&seen(Version::Sunrise(None), true)).contains("FRIJointOverlay"));
        let mut wrench = seen(Version::Sunrise(None), true);
        wrench.status.overlay = Some(CommandMode::Wrench);
        assert!(
            idle(&wrench).contains("accepts wrench"),
            "{}",
            idle(&wrench)
        );
        let text = ended(
            MotionState::Left,
            BrakeCause::Requested,
            &seen(Version::Lwr, false),
        )
        .unwrap_err();
        assert!(text.contains("lost their power"), "{text}");
        let text = ended(
            MotionState::Left,
            BrakeCause::Requested,
            &seen(Version::Lwr, true),
        )
        .unwrap_err();
        assert!(text.contains("left command mode"), "{text}");
        let bad = unsound(&Seen::default());
        assert!(
            bad.starts_with("quality is unknown, too bad for a motion: no measurement received"),
            "{bad}"
        );
        let slow = Seen {
            status: Status {
                quality: Some(Quality::Sunrise(3.into())),
                period: Some(Duration::from_millis(100)),
                ..Status::default()
            },
            ..Seen::default()
        };
        assert_eq!(settled(&slow), 30);
        let early = unsound(&slow);
        assert!(early.starts_with("only 0 answers of 30"), "{early}");
    }
}
