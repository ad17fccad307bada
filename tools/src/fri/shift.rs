//! `takt fri move`: one joint, a little, with somebody standing by. It refuses what is not small, a connection that is not
//! sound, and goals near the end of a range; the motion itself is in `motion`. It is no safety function.

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
use super::motion::{Goal, MARGIN_RAD, Motion, Remote, Stage, Why, takes_positions};
use super::watch::{Port, Watched};
use crate::output::{complain, say, span};
use crate::{Verdict, confirm};

/// Farthest that is still small, degrees.
const BY_MAX_DEG: f64 = 15.0;
/// Fastest, degrees per second.
const SPEED_MAX_DEG_PER_S: f64 = 20.0;
/// What the guard of the session lets pass above the speed asked for.
const SPEED_SLACK: f64 = 1.05;
/// Measurements before quality is believed.
const SETTLED: u64 = 150;
/// How long the robot gets to come to rest where it was told to be.
const REST: Duration = Duration::from_millis(300);
/// How long braking may take.
const BRAKING: Duration = Duration::from_secs(5);

/// Move one joint a little, when the robot program lets it.
///
/// It becomes the robot's partner, looks whether the connection is sound and the goal within range, asks, waits for
/// command mode (an LWR's friStart, an iiwa's motion with an overlay of positions), moves, and ends. Then nobody answers
/// the controller, which ends command mode. Ctrl-C brakes. Exit status: 0 the joint is there; 1 it is not; 2 it could
/// not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fri move --listen 0.0.0.0:49938 --joint 4 --by 5deg
  takt fri move --listen 0.0.0.0:30200 --joint 7 --by -0.05rad --velocity 2deg/s --yes")]
pub(crate) struct Shift {
    /// Where the controller's datagrams arrive.
    #[arg(long, value_name = "IP:PORT")]
    listen: SocketAddr,
    /// Which joint, 1 to 7 from the base on.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=7))]
    joint: u8,
    /// By how much: 5deg, -0.05rad; at most 15 degrees.
    #[arg(long, value_name = "ANGLE", value_parser = small_angle, allow_hyphen_values = true)]
    by: f64,
    /// How fast at most: 5deg/s, 0.1rad/s; at most 20 degrees per second.
    #[arg(long, value_name = "SPEED", default_value = "5deg/s", value_parser = low_speed)]
    velocity: f64,
    /// How long to wait for a sound connection, and then for command mode.
    #[arg(long, alias = "within", value_name = "TIME", default_value = "30s", value_parser = span)]
    ready_timeout: Duration,
    /// Do not ask whether it is safe.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
    #[command(flatten)]
    port: Port,
}

/// Reads an angle with its unit, rad.
fn angle(text: &str) -> Result<f64, String> {
    let wrong =
        || format!("`{text}` is no angle: write a number and a unit, such as 5deg or 0.1rad");
    let (number, factor) = match (text.strip_suffix("deg"), text.strip_suffix("rad")) {
        (Some(degrees), _) => (degrees, 1.0_f64.to_radians()),
        (None, Some(radians)) => (radians, 1.0),
        (None, None) => return Err(wrong()),
    };
    let number: f64 = number.trim().parse().map_err(|_| wrong())?;
    let angle = number * factor;
    if angle.is_finite() {
        Ok(angle)
    } else {
        Err(wrong())
    }
}

fn small_angle(text: &str) -> Result<f64, String> {
    let by = angle(text)?;
    if by == 0.0 || by.abs() > BY_MAX_DEG.to_radians() + 1e-9 {
        return Err(format!(
            "must be small: up to {BY_MAX_DEG} deg either way, and not 0"
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

/// Why it did not come to its end; told as what is found, not as a fault of the call.
type Outcome = anyhow::Result<Result<(), String>>;

impl Shift {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let remote = Arc::new(Remote::default());
        let goal = Goal {
            joint: usize::from(self.joint - 1),
            by_rad: self.by,
            speed: self.velocity,
        };
        let motion = Motion::new(goal, Arc::clone(&remote));
        let mut watched = Watched::start(&self.port, self.listen, self.config(), motion)?;
        complain(&format!(
            "waiting for a controller at {}",
            watched.live.local
        ));
        let outcome = self.lead(&mut watched, &remote);
        watched.live.stop()?;
        match outcome? {
            Ok(()) => Ok(Verdict::Good),
            Err(why) => {
                say(&why)?;
                Ok(Verdict::Failed)
            }
        }
    }

    /// Sessions whose guards let no more pass than was asked for.
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
    fn lead(&self, watched: &mut Watched, remote: &Remote) -> Outcome {
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
        remote.go();
        if let Err(why) = self.follow(watched, remote)? {
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

    /// Waits until the connection is fit to be moved over.
    fn sound(&self, watched: &mut Watched) -> anyhow::Result<Result<Seen, String>> {
        let started = Instant::now();
        loop {
            let (seen, news) = watched.look();
            let is_there = seen.status.phase != Phase::Offline;
            if let Some(fault) = news.into_iter().next() {
                return Ok(Err(fault));
            }
            let is_sound = seen.status.quality.is_some_and(Quality::is_sound);
            if is_there && is_sound && seen.observed.answers >= SETTLED {
                return Ok(Ok(seen));
            }
            if started.elapsed() >= self.ready_timeout {
                return Ok(Err(unsound(&seen)));
            }
            ensure!(!watched.pause(), "ended before anything moved");
        }
    }

    /// The joint's name and what is going to happen, or which limit forbids it.
    fn plan(&self, seen: &Seen) -> Result<(&'static str, String), String> {
        let status = &seen.status;
        let (Some(version), Some(joints)) = (status.version, status.measured) else {
            return Err("the controller tells no joint positions".to_owned());
        };
        plan(version, &joints, self.joint, self.by, self.velocity)
    }

    /// Watches the motion to its end. Ctrl-C brakes.
    fn follow(&self, watched: &mut Watched, remote: &Remote) -> Outcome {
        let started = Instant::now();
        let mut braking: Option<Instant> = None;
        let mut is_told = false;
        loop {
            let stage = remote.stage();
            if stage == Stage::Moving && !is_told {
                complain("the robot follows; Ctrl-C brakes");
                is_told = true;
            }
            let seen = watched.live.seen();
            if stage.is_end() {
                return Ok(ended(stage, remote.why(), &seen));
            }
            if stage == Stage::Idle && started.elapsed() >= self.ready_timeout {
                return Ok(Err(idle(&seen)));
            }
            if stage == Stage::Idle && braking.is_some() {
                return Ok(Err("ended before anything moved".to_owned()));
            }
            if braking.is_some_and(|since| since.elapsed() >= BRAKING) {
                return Ok(Err(
                    "the controller went silent while the robot braked".to_owned()
                ));
            }
            if watched.pause() && braking.is_none() {
                remote.brake();
                braking = Some(Instant::now());
            }
            if seen.status.phase == Phase::Offline {
                return Ok(Err(
                    "the controller went silent; it brakes by itself".to_owned()
                ));
            }
        }
    }
}

/// What is going to happen, or which limit forbids it.
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
            "{name} is at {from:.2} deg and would go to {to:.2} deg, beyond {limit:.0} deg: its range of {range:.0} deg less 2"
        ));
    }
    let text = format!(
        "{name} (joint {joint}) goes from {from:.2} deg to {to:.2} deg at up to {:.1} deg/s, as soon as the robot follows",
        speed.to_degrees()
    );
    Ok((name, text))
}

/// Why the connection is not fit.
fn unsound(seen: &Seen) -> String {
    let quality = seen.status.quality;
    let quality = quality.map_or_else(|| "unknown".to_owned(), |it| it.to_string());
    let verdict = judge(&seen.observed);
    let because = if verdict.is_good() {
        String::new()
    } else {
        format!(": {verdict}; {}", verdict.remedy())
    };
    format!("quality is {quality}, too bad to move anything{because}")
}

/// Why the motion was never begun.
fn idle(seen: &Seen) -> String {
    let status = &seen.status;
    let state = status.state;
    let state = state.map_or_else(|| "unknown".to_owned(), |it| it.to_string());
    if status.has_power == Some(false) {
        return format!(
            "the drives have no power (state {state}): release the brakes at the controller"
        );
    }
    if let Some(mode) = status.overlay.filter(|mode| !takes_positions(Some(*mode))) {
        return format!(
            "the overlay of the robot program wants {mode} (state {state}): only one of joint positions (FRIJointOverlay, POSITION) can be moved"
        );
    }
    let what = match status.version {
        Some(Version::Sunrise(_)) => {
            "the robot program must run a motion with an overlay of joint positions (FRIJointOverlay, POSITION)"
        }
        Some(Version::Lwr) | None => "the KRL program must call friStart",
    };
    format!("the robot does not follow (state {state}): {what}")
}

fn ended(stage: Stage, why: Why, seen: &Seen) -> Result<(), String> {
    match stage {
        Stage::Arrived => Ok(()),
        Stage::Beyond => Err("the controller's own set-point is nearer to the end of the range than the measured one: nothing was moved".to_owned()),
        Stage::Left if seen.status.has_power == Some(false) => {
            Err("the drives lost their power on the way; the controller's own message says why".to_owned())
        }
        Stage::Left => {
            let state = seen.status.state.map_or_else(|| "?".to_owned(), |it| it.to_string());
            Err(format!("the controller left command mode on the way (now {state}); its own message says why"))
        }
        Stage::Idle | Stage::Moving | Stage::Braking | Stage::Stopped => Err(match why {
            Why::Asked => "braked to rest on the way, as asked",
            Why::Quality => "braked to rest on the way, since quality became too bad; `takt fri stat` says who is late",
            Why::Withheld => "braked to rest on the way, since the session withheld a position",
        }
        .to_owned()),
    }
}

/// That the joint is there, or did not go at least half of the way in its direction; both rad.
fn arrived(name: &str, by: f64, moved: f64) -> Result<String, String> {
    let (asked, measured) = (by.to_degrees(), moved.to_degrees());
    if moved * by.signum() * 2.0 < by.abs() {
        return Err(format!(
            "{name} did not move as commanded: {asked:.2} deg were asked for, {measured:.2} deg are measured\n\
             hint: look at its brake, at contact with its surroundings, and at the override and messages of the controller"
        ));
    }
    Ok(format!(
        "{name} is there: {asked:.2} deg were asked for, {measured:.2} deg are measured"
    ))
}

/// Gives the arm time to be where it was told to be.
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
    fn angles_and_speeds_have_units_and_bounds() {
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
    fn a_limit_that_forbids_it_is_named() {
        let joints = [0.0, 117.0_f64.to_radians(), 0.0, 0.0, 0.0, 0.0, 0.0];
        let told =
            |version, joint, by_deg: f64| plan(version, &joints, joint, by_deg.to_radians(), 0.1);
        assert_eq!(
            told(Version::Lwr, 2, 2.0).unwrap_err(),
            "A2 is at 117.00 deg and would go to 119.00 deg, beyond 118 deg: its range of 120 deg less 2"
        );
        let (name, text) = told(Version::Lwr, 3, -2.0).unwrap();
        assert_eq!(name, "E1");
        assert!(
            text.contains("from 0.00 deg to -2.00 deg at up to 5.7 deg/s"),
            "{text}"
        );
        let (name, _) = told(Version::Sunrise(None), 3, -2.0).unwrap();
        assert_eq!(name, "A3");
        assert!(told(Version::Lwr, 2, 1.0).is_ok());
    }

    #[test]
    fn shift_of_a_joint_at_rest_fails() {
        for (by, moved) in [(0.1, 0.0), (0.1, 0.04), (-0.1, 0.1), (-0.1, -0.001)] {
            let text = arrived("A4", by, moved).unwrap_err();
            assert!(text.starts_with("A4 did not move as commanded: "), "{text}");
            assert!(text.contains("\nhint: "), "{text}");
        }
        let text = arrived("A4", -0.1, -0.099).unwrap();
        assert_eq!(
            text,
            "A4 is there: -5.73 deg were asked for, -5.67 deg are measured"
        );
    }

    #[test]
    fn what_holds_a_robot_is_named() {
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
        assert!(idle(&wrench).contains("wants wrench"), "{}", idle(&wrench));
        let told = ended(Stage::Left, Why::Asked, &seen(Version::Lwr, false)).unwrap_err();
        assert!(told.contains("lost their power"), "{told}");
        let told = ended(Stage::Left, Why::Asked, &seen(Version::Lwr, true)).unwrap_err();
        assert!(told.contains("left command mode"), "{told}");
        let bad = unsound(&Seen::default());
        assert!(
            bad.starts_with(
                "quality is unknown, too bad to move anything: no measurement received"
            ),
            "{bad}"
        );
    }
}
