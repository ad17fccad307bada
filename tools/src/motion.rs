//! `takt move`: one motion of an arm, through the Robotics API. It is planned before anything is loaded, except a jog, which
//! follows keys.

mod direction;
mod failure;
mod goal;
mod jog;
mod jogging;
mod keyboard;
mod keys;
mod report;

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use takt_api::{Activity, Arm, Handle, Outcome, Plan};

use crate::net::server::Server;
use crate::output::{check_writable, complain, save, say};
use crate::quantity::{Place, angle, place};
use crate::signal::Stop;
use crate::{Verdict, confirm};

pub(crate) use failure::{Refused, hinted};
use report::Report;
pub(crate) use report::word;

/// How often a motion is checked for requests to stop, and its progress shown.
const SLICE: Duration = Duration::from_millis(50);

/// Move an arm: one motion, planned and checked before anything is loaded, or by keys.
///
/// The motion begins at the commanded position, and ends at rest. Ctrl-C brakes on the path and waits for rest; a second
/// one ends at once, and the controller brakes. Arms ask for confirmation before they move, unless the controller simulates
/// them. Angles and lengths have a unit: 30deg, 0.5rad, 0.4m, -20mm; 0 needs none.
///
/// Exit status: 0 the arm is at the goal; 1 it is not, or cannot follow; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt move left ptp 0 30deg 0 -70deg 0 45deg 0 --speed 0.2
  takt move left lin -0.6m,-50mm,600mm --dry-run --svg line.svg
  takt move left home --yes
  takt move left jog")]
pub(crate) struct Move {
    /// Name of the arm, as in cell.toml.
    arm: String,
    #[command(subcommand)]
    motion: Motion,
}

/// Where, and on which path.
#[derive(Debug, Subcommand)]
enum Motion {
    #[command(flatten)]
    Planned(Planned),
    Jog(jog::Jog),
}

/// A motion that is planned beforehand.
#[derive(Debug, Subcommand)]
enum Planned {
    Ptp(Ptp),
    Lin(Lin),
    Circ(Circ),
    Home(Home),
}

/// Move to joint positions: all joints start and arrive together.
#[derive(Debug, Args)]
struct Ptp {
    /// Position of each joint, from the base: 30deg, -0.5rad, 0.
    #[arg(required = true, value_name = "JOINT", value_parser = angle)]
    joints: Vec<f64>,
    #[command(flatten)]
    options: Options,
}

/// Move the flange along a straight line.
#[derive(Debug, Args)]
struct Lin {
    /// Pose of the flange in the base of the arm, or in --frame: X,Y,Z or X,Y,Z,A,B,C, where A turns about z, then B about the new y, then C
    /// about the new x. Without angles the orientation remains.
    #[arg(value_name = "POSE", value_parser = place)]
    to: Place,
    /// Poses are in this frame of the cell: `[[frame]]` of cell.toml, `world`, or DEVICE.base.
    #[arg(long, value_name = "NAME")]
    frame: Option<String>,
    #[command(flatten)]
    options: Options,
}

/// Move the flange along an arc.
#[derive(Debug, Args)]
struct Circ {
    /// A pose on the arc, as of `lin`; its orientation does not count.
    #[arg(value_name = "VIA", value_parser = place)]
    via: Place,
    /// The pose at its end, as of `lin`.
    #[arg(value_name = "POSE", value_parser = place)]
    to: Place,
    /// Poses are in this frame of the cell: `[[frame]]` of cell.toml, `world`, or DEVICE.base.
    #[arg(long, value_name = "NAME")]
    frame: Option<String>,
    #[command(flatten)]
    options: Options,
}

/// Move all joints to the home position of the arm: `[[home]]` of cell.toml.
///
/// Without that all joints move to zero, and a joint whose range excludes zero to the middle of its range.
#[derive(Debug, Args)]
struct Home {
    #[command(flatten)]
    options: Options,
}

#[derive(Debug, Args)]
struct Options {
    /// Speed as part of the limits, above 0 to 1: of the joints, for paths of 0.25 m/s and 0.5 rad/s.
    #[arg(long, value_name = "FACTOR", default_value = "0.2", value_parser = speed)]
    speed: f64,
    /// Plan and check only, and say what the motion follows, what ends it and what it costs; nothing moves.
    #[arg(long)]
    dry_run: bool,
    /// Write a picture of the plan: positions and velocities of the joints over time.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Print the net that the motion becomes, and do nothing else.
    #[arg(long, conflicts_with_all = ["dry_run", "svg", "json"])]
    print_net: bool,
    /// Print one JSON object: angles in rad, times in s.
    #[arg(long)]
    json: bool,
    /// It is safe that the arm moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    yes: bool,
    #[command(flatten)]
    server: Server,
}

/// Reads a speed factor.
pub(crate) fn speed(text: &str) -> Result<f64, String> {
    let factor = crate::output::share(text.trim())?;
    if factor > 0.0 {
        Ok(factor)
    } else {
        Err("must be above 0, up to 1".to_owned())
    }
}

/// Arguments of the process, with a space before negative numbers of `takt move` and `takt grip`, so that `-70deg` is no option.
pub(crate) fn arguments(all: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut all: Vec<_> = all.collect();
    if all
        .get(1)
        .is_some_and(|command| command == "move" || command == "grip")
    {
        for argument in all.iter_mut().skip(2) {
            let is_number = argument.to_str().is_some_and(|text| {
                let digits = text.strip_prefix('-').unwrap_or_default();
                digits.starts_with(|c: char| c.is_ascii_digit() || c == '.')
            });
            if is_number {
                let mut padded = OsString::from(" ");
                padded.push(&argument);
                *argument = padded;
            }
        }
    }
    all
}

impl Planned {
    const fn options(&self) -> &Options {
        match self {
            Self::Ptp(Ptp { options, .. })
            | Self::Lin(Lin { options, .. })
            | Self::Circ(Circ { options, .. })
            | Self::Home(Home { options }) => options,
        }
    }

    const fn name(&self) -> &'static str {
        match self {
            Self::Ptp(_) => "ptp",
            Self::Lin(_) => "lin",
            Self::Circ(_) => "circ",
            Self::Home(_) => "home",
        }
    }
}

impl Move {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match &self.motion {
            Motion::Planned(motion) => self.run_planned(motion),
            Motion::Jog(jog) => jog.run(&self.arm),
        }
    }

    fn run_planned(&self, motion: &Planned) -> anyhow::Result<Verdict> {
        let options = motion.options();
        if let Some(path) = &options.svg {
            check_writable(path)?;
        }
        let cell = options.server.cell()?;
        let arm = cell.arm(&self.arm).map_err(hinted)?;
        let activity = goal::activity(motion, &cell, &arm)?;
        let activity = activity.speed(options.speed);
        if options.print_net {
            say(activity.explain().map_err(hinted)?.net.trim_end())?;
            return Ok(Verdict::Good);
        }
        let plan = activity.plan().map_err(hinted)?;
        let mut report = Report::new(&arm, motion.name(), options.speed, &plan);
        if let Some(path) = &options.svg {
            save(path, plan.svg())?;
        }
        if !options.json {
            say(report.plan().trim_end())?;
        }
        if options.dry_run {
            let explained = activity.explain().map_err(hinted)?;
            if options.json {
                report.explain(&explained);
                say(&report.json().to_string())?;
            } else {
                explained.rules.iter().try_for_each(|rule| say(rule))?;
                say(&explained.cost.to_string())?;
            }
            return Ok(Verdict::Good);
        }
        confirm_arm(&arm, options.yes)?;
        let begin = Instant::now();
        let outcome = perform(activity, &plan)?;
        report.end(begin.elapsed(), &outcome, arm.commanded().ok());
        drop(arm);
        cell.close().map_err(hinted)?;
        if options.json {
            say(&report.json().to_string())?;
        } else {
            say(&report.outcome())?;
        }
        Ok(if outcome == Outcome::Completed {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// Asks before an arm moves, unless the controller simulates it.
pub(crate) fn confirm_arm(arm: &Arm, is_confirmed: bool) -> anyhow::Result<()> {
    let it = arm.description();
    confirm_device("moving", &it.name, &it.kind, is_confirmed)
}

/// Asks before something is done with a device that can move, unless the controller simulates it.
pub(crate) fn confirm_device(
    action: &str,
    name: &str,
    kind: &str,
    is_confirmed: bool,
) -> anyhow::Result<()> {
    let is_simulated = takt_core::device::sim::kinds().contains(&kind);
    confirm::motion(
        &format!("{action} {name} ({kind})"),
        is_confirmed || is_simulated,
    )
}

/// Begins a motion and waits until the arm is at rest.
fn perform(activity: Activity, plan: &Plan) -> anyhow::Result<Outcome> {
    let stop = Stop::listen()?;
    let handle = activity.begin().map_err(hinted)?;
    let bar = bar(plan);
    let outcome = follow(&handle, &stop, &bar);
    bar.finish_and_clear();
    outcome
}

/// Begins an activity and waits until it has ended; Ctrl-C cancels it.
pub(crate) fn perform_unplanned(activity: Activity) -> anyhow::Result<Outcome> {
    let stop = Stop::listen()?;
    let handle = activity.begin().map_err(hinted)?;
    follow(&handle, &stop, &ProgressBar::hidden())
}

fn follow(handle: &Handle, stop: &Stop, bar: &ProgressBar) -> anyhow::Result<Outcome> {
    let mut is_cancelled = false;
    loop {
        if let Some(outcome) = handle.wait_for(SLICE) {
            return outcome.map_err(hinted);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "of 0 to 1"
        )]
        bar.set_position((handle.progress() * 100.0) as u64);
        if stop.is_requested() && !is_cancelled {
            is_cancelled = true;
            handle.cancel();
            complain("cancelled: waiting for rest");
        }
        anyhow::ensure!(
            stop.requests() < 2,
            "ended before the device was at rest: the controller brakes it"
        );
    }
}

/// The progress line, on a terminal only.
fn bar(plan: &Plan) -> ProgressBar {
    let bar = ProgressBar::new(100);
    if !crate::output::is_terminal() {
        bar.set_draw_target(indicatif::ProgressDrawTarget::hidden());
    }
    let style = ProgressStyle::with_template("{msg} {bar:40} {pos:>3} %");
    if let Ok(style) = style {
        bar.set_style(style);
    }
    let seconds = plan.duration().as_secs_f64();
    bar.set_message(format!("{}, {seconds:.1} s", plan.device()));
    bar
}

/// The pose of the flange in the base of the arm, as commanded; as measured, if the arm's kinematics are not known here.
fn commanded_pose(arm: &Arm) -> anyhow::Result<takt_api::Pose> {
    let here = arm.commanded().map_err(hinted)?;
    let planned = arm.ptp(here).plan().ok();
    match planned.and_then(|plan| plan.pose(Duration::ZERO)) {
        Some(pose) => Ok(pose),
        None => arm.pose().map_err(hinted),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_numbers_of_moves_are_no_options() {
        let padded = |text: &str| {
            let all = text.split(' ').map(OsString::from);
            let all = arguments(all).into_iter();
            let all = all.map(|argument| argument.into_string().unwrap());
            all.collect::<Vec<_>>().join("|")
        };
        assert_eq!(
            padded("takt move left ptp -70deg -.5rad --speed 0.2 -h"),
            "takt|move|left|ptp| -70deg| -.5rad|--speed|0.2|-h"
        );
        assert_eq!(padded("takt can -1"), "takt|can|-1");
    }
}
