//! `takt grip`: one command to a gripper, through the Robotics API.

use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use serde_json::json;
use takt_api::{Activity, Cell, Gripper, Outcome};

use crate::Verdict;
use crate::motion::{confirm_device, hinted, perform_unplanned, speed, word};
use crate::net::server::Server;
use crate::output::{positive_span, say};
use crate::quantity::{force, length};

/// Open and close a gripper, grip a part, read its state.
///
/// Lengths and forces have a unit: 20mm, 0.02m, 30N. Widths are distances between the fingers. Ctrl-C stops the fingers where
/// they are. Grippers ask for confirmation before they move, unless the controller simulates them.
///
/// Exit status: 0 done; 1 the gripper could not, or was interrupted; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt grip hand open
  takt grip hand width 15mm
  takt grip gripper grasp 50mm 30N --yes
  takt grip gripper state")]
pub(crate) struct Grip {
    /// Name of the gripper, as in cell.toml.
    gripper: String,
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Open it wide. A Schunk WSG moves to its outer end stop, from which it counts.
    Open(Options),
    /// Close it without a part.
    Close(Options),
    /// Move the fingers to a width.
    Width {
        /// The width, from 0: 20mm. `state` shows the largest one, if it is known.
        #[arg(value_parser = length)]
        width: f64,
        #[command(flatten)]
        options: Options,
    },
    /// Grip a part of a width with at most a force. Only grippers that measure their force, such as a Schunk WSG, can.
    Grasp {
        /// Width of the part, from 0: 50mm.
        #[arg(value_parser = length)]
        width: f64,
        /// Largest force, above 0: 30N.
        #[arg(value_parser = force)]
        force: f64,
        #[command(flatten)]
        options: Options,
    },
    /// Print width, force and whether it holds a part, as far as the gripper measures them.
    State {
        /// Print one JSON object: lengths in m, forces in N.
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        server: Server,
    },
}

#[derive(Debug, Args)]
struct Options {
    /// Speed as part of 0.2 m/s, above 0 to 1. A youBot's fingers have one speed.
    #[arg(long, value_name = "FACTOR", default_value = "0.5", value_parser = speed)]
    speed: f64,
    /// Time-out of the command at this speed.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = positive_span)]
    timeout: Duration,
    /// Print one JSON object: lengths in m, forces in N, times in s.
    #[arg(long)]
    json: bool,
    /// It is safe that the gripper moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    yes: bool,
    #[command(flatten)]
    server: Server,
}

impl Grip {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let name = &self.gripper;
        match &self.task {
            Task::State { json, server } => {
                let cell = server.cell()?;
                let gripper = cell.gripper(name).map_err(hinted)?;
                let state = State::read(&cell, &gripper)?;
                say(&if *json {
                    state.json(name).to_string()
                } else {
                    state.text(name, gripper.width_max())
                })?;
                Ok(Verdict::Good)
            }
            Task::Open(options) => command(name, options, Gripper::open),
            Task::Close(options) => command(name, options, Gripper::close),
            Task::Width { width, options } => command(name, options, |it| it.move_to(*width)),
            Task::Grasp {
                width,
                force,
                options,
            } => command(name, options, |it| it.grasp(*width, *force)),
        }
    }
}

/// Executes a command of a gripper.
fn command(
    name: &str,
    options: &Options,
    task: impl Fn(&Gripper) -> Activity,
) -> anyhow::Result<Verdict> {
    let cell = options.server.cell()?;
    let gripper = cell.gripper(name).map_err(hinted)?;
    // A factor of speed makes time-outs longer.
    let timeout = options.timeout.mul_f64(options.speed);
    let gripper = gripper.with_timeout(timeout).with_speed(options.speed);
    let activity = task(&gripper);
    // What is wrong with it is reported before the question.
    activity.explain().map_err(hinted)?;
    confirm_device("moving", name, gripper.kind(), options.yes)?;
    let begin = Instant::now();
    let outcome = perform_unplanned(activity)?;
    let took = begin.elapsed().as_secs_f64();
    let state = State::read(&cell, &gripper)?;
    say(&if options.json {
        let mut object = state.json(name);
        if let Some(object) = object.as_object_mut() {
            object.insert("outcome".to_owned(), word(&outcome).into());
            object.insert("took_s".to_owned(), took.into());
        }
        object.to_string()
    } else {
        let outcome = word(&outcome);
        format!("{outcome} after {took:.2} s, {}", state.text(name, None))
    })?;
    drop(gripper);
    cell.close().map_err(hinted)?;
    Ok(if outcome == Outcome::Completed {
        Verdict::Good
    } else {
        Verdict::Failed
    })
}

/// What a gripper measures; `None` where it does not, or is offline.
#[derive(Clone, Copy, Debug, PartialEq)]
struct State {
    /// m.
    width: Option<f64>,
    /// N.
    force: Option<f64>,
    holds: Option<bool>,
}

impl State {
    fn read(cell: &Cell, gripper: &Gripper) -> anyhow::Result<Self> {
        let width = cell.value(&gripper.width()).map_err(hinted)?;
        let mut state = Self {
            width,
            force: None,
            holds: None,
        };
        if let (Ok(force), Ok(holds)) = (gripper.force(), gripper.holds()) {
            state.force = cell.value(&force).map_err(hinted)?;
            // A condition over what is not known is untrue.
            if state.force.is_some() {
                state.holds = Some(cell.holds(&holds).map_err(hinted)?);
            }
        }
        Ok(state)
    }

    fn text(&self, name: &str, width_max: Option<f64>) -> String {
        let mut text = match self.width {
            Some(width) => format!("{name}: width {:.1} mm", width * 1e3),
            None => format!("{name}: width not known"),
        };
        if let Some(most) = width_max {
            text = format!("{text} of {:.1} mm", most * 1e3);
        }
        if let Some(force) = self.force {
            text = format!("{text}, force {force:.1} N");
        }
        match self.holds {
            Some(true) => text + ", holds a part",
            Some(false) => text + ", holds no part",
            None => text,
        }
    }

    fn json(&self, name: &str) -> serde_json::Value {
        json!({
            "gripper": name, "width_m": self.width, "force_n": self.force, "holds": self.holds,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn state_shows_what_is_known() {
        let unknown = State {
            width: None,
            force: None,
            holds: None,
        };
        assert_eq!(unknown.text("hand", None), "hand: width not known");
        let holding = State {
            width: Some(0.05),
            force: Some(29.96),
            holds: Some(true),
        };
        assert_eq!(
            holding.text("hand", Some(0.11)),
            "hand: width 50.0 mm of 110.0 mm, force 30.0 N, holds a part"
        );
        assert_eq!(holding.json("hand")["force_n"], 29.96);
    }
}
