//! `takt move ARM jog`: an arm moves while a key is held, or in one direction for a time. It is no safety function.

use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

use anyhow::ensure;
use clap::Args;
use serde_json::json;
use takt_api::{Arm, Pose};

use super::direction::{Direction, direction};
use super::failure::hinted;
use super::jogging::{Jogging, known};
use super::{commanded_pose, confirm_arm, speed};
use crate::Verdict;
use crate::net::server::Server;
use crate::output::{complain, positive_span, say};
use crate::signal::Stop;

/// Move an arm while a key is held.
///
/// Keys, in the axes of the base: w s along x, a d along y, r f along z, u j about x, i k about y, o l about z. Joints: a digit
/// selects a joint, from 0, and + - or the arrows up and down move it. q, Esc or Ctrl-C ends.
///
/// Hold a key: on most terminals the arm begins to move when the key repeats, about half a second later, and brakes at most
/// 0.3 s after the last repetition. Where the terminal reports releases (the keyboard protocol of kitty), it moves at once and brakes with the
/// release. A stalled terminal or connection is a release. It is no safety function: where people are at risk, use the enabling
/// switch and the emergency stop of the robot.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt move left jog
  takt move left jog z+ --for 500ms --speed 0.1
  takt move left jog j3- --for 1s --yes --json")]
pub(super) struct Jog {
    /// Without keys: x+, y-, z+ along the axes of the base, rx+, ry-, rz+ about them, j0- for joint 0.
    #[arg(value_name = "DIRECTION", value_parser = direction, requires = "time")]
    direction: Option<Direction>,
    /// How long to move in that direction before the arm brakes: 500ms, 2s.
    #[arg(long = "for", value_name = "TIME", value_parser = positive_span, requires = "direction")]
    time: Option<Duration>,
    /// Speed as part of the limits, above 0 to 1: of 0.25 m/s and 0.5 rad/s, or of those of the joint.
    #[arg(long, value_name = "FACTOR", default_value = "0.2", value_parser = speed)]
    speed: f64,
    /// Print one JSON object at the end: angles in rad, lengths in m, times in s.
    #[arg(long)]
    json: bool,
    /// It is safe that the arm moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    yes: bool,
    #[command(flatten)]
    server: Server,
}

impl Jog {
    pub(super) fn run(&self, name: &str) -> anyhow::Result<Verdict> {
        let has_keys = std::io::stdin().is_terminal() && std::io::stderr().is_terminal();
        ensure!(
            self.direction.is_some() || has_keys,
            "there is no terminal whose keys can be held\nhint: `takt move {name} jog x+ --for 1s` needs none"
        );
        let cell = self.server.cell()?;
        let arm = cell.arm(name).map_err(hinted)?;
        if let Some(direction) = self.direction {
            known(direction, &arm)?;
        }
        confirm_arm(&arm, self.yes)?;
        let stop = Stop::listen()?;
        let (begin, from) = (Instant::now(), commanded_pose(&arm).ok());
        let mut jogging = Jogging::new(&arm, self.speed);
        let ended = match self.direction.zip(self.time) {
            Some((direction, time)) => jogging.hold(direction, time, &stop),
            None => super::keyboard::run(&mut jogging, &stop),
        };
        let rested = jogging.end();
        let is_whole = ended.and_then(|is_whole| rested.map(|()| is_whole).map_err(hinted))?;
        self.report(&arm, begin.elapsed(), from)?;
        drop(jogging);
        drop(arm);
        cell.close().map_err(hinted)?;
        Ok(if is_whole {
            Verdict::Good
        } else {
            complain("interrupted: the arm is at rest");
            Verdict::Failed
        })
    }

    /// Where the arm is, and how far the flange is from where it began.
    fn report(&self, arm: &Arm, took: Duration, from: Option<Pose>) -> anyhow::Result<()> {
        let name = &arm.description().name;
        let at = arm.commanded().ok();
        let moved = from.zip(commanded_pose(arm).ok()).map(|(from, to)| {
            let (from, to) = (from.isometry(), to.isometry());
            let distance = (to.translation.vector - from.translation.vector).norm();
            (distance, from.rotation.angle_to(&to.rotation))
        });
        if self.json {
            let object = json!({
                "arm": name, "motion": "jog", "speed": self.speed,
                "direction": self.direction.map(|it| it.to_string()), "took_s": took.as_secs_f64(),
                "moved_m": moved.map(|(distance, _)| distance), "turned_rad": moved.map(|(_, angle)| angle),
                "at_rad": at,
            });
            return say(&object.to_string());
        }
        let mut text = format!("at rest after {:.2} s", took.as_secs_f64());
        if let Some((distance, angle)) = moved {
            let (distance, angle) = (distance * 1e3, angle.to_degrees());
            text = format!("{text}, flange {distance:.1} mm and {angle:.2} deg from where it was");
        }
        if let Some(at) = at {
            text = format!("{text}, {name} at {} deg", super::report::degrees(&at));
        }
        say(&text)
    }
}
