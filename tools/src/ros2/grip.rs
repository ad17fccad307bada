//! `GripperCommand` and `ParallelGripperCommand`: positions are the width between the fingers, m. A goal with an effort grips a part
//! and succeeds with `stalled`; one without moves the fingers.

use std::sync::Arc;
use std::thread::JoinHandle;

use takt_api::{Cell, Gripper, Handle, Outcome};
use takt_fleet::ros::messages::{GoalId, GripperGoal, GripperState};
use takt_fleet::ros::node::{Node, now};
use takt_fleet::ros::types::{GRIPPER_COMMAND, PARALLEL_GRIPPER_COMMAND};

use super::names::ros_name;
use super::server::{self, End, Performer, Refusals};
use crate::signal::Stop;

/// A gripper by one of both types.
#[derive(Clone, Debug)]
struct Grip {
    cell: Cell,
    gripper: Gripper,
    is_parallel: bool,
    /// Whether the goal that runs is to grip, with its force, N.
    force: Option<f64>,
}

/// Offers both actions of a gripper.
pub(super) fn start(
    node: &Arc<Node>,
    (cell, gripper): (&Cell, &Gripper),
    refusals: &Refusals,
    stop: &Stop,
) -> anyhow::Result<Vec<JoinHandle<()>>> {
    let name = ros_name(gripper.name());
    let actions = [
        ("gripper_cmd", &GRIPPER_COMMAND, false),
        ("parallel_gripper_cmd", &PARALLEL_GRIPPER_COMMAND, true),
    ];
    let mut servers = Vec::new();
    for (action, ty, is_parallel) in actions {
        let grip = Grip {
            cell: cell.clone(),
            gripper: gripper.clone(),
            is_parallel,
            force: None,
        };
        let name = format!("{name}/{action}");
        let (server, _) = server::offer(node, &name, (ty, &[]), grip, (refusals, stop))?;
        servers.push(server.start()?);
    }
    Ok(servers)
}

impl Performer for Grip {
    type Goal = GripperGoal;

    fn read(&self, message: &[u8]) -> Result<(GoalId, GripperGoal), String> {
        let goal = if self.is_parallel {
            GripperGoal::decode_parallel(message)
        } else {
            GripperGoal::decode(message)
        };
        let goal = goal.map_err(|why| why.to_string())?;
        let numbers = [goal.position, goal.effort];
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err("the position or the effort is not a number".to_owned());
        }
        Ok((goal.id, goal))
    }

    fn begin(&mut self, goal: &GripperGoal) -> Result<Handle, String> {
        self.force = (goal.effort > 0.0).then_some(goal.effort);
        let motion = match self.force {
            Some(force) => self.gripper.grasp(goal.position, force),
            None => self.gripper.move_to(goal.position),
        };
        motion.now().begin().map_err(|error| error.kind.to_string())
    }

    fn result(&self, status: u8, end: &End) -> Vec<u8> {
        let is_done = matches!(
            end,
            End::Ended(Ok(Outcome::Completed | Outcome::Maintaining))
        );
        let width = self.cell.value(&self.gripper.width()).ok().flatten();
        let state = GripperState {
            position: width.unwrap_or(f64::NAN),
            effort: self.force.unwrap_or(0.0),
            stalled: is_done && self.force.is_some(),
            reached: is_done && self.force.is_none(),
        };
        if self.is_parallel {
            state.parallel_result(status, now(), self.gripper.name())
        } else {
            state.result(status)
        }
    }
}
