//! Motions of the command line as activities of the Robotics API.

use takt_api::{Activity, Arm, Cell, Frame, Goal, Pose};

use super::failure::hinted;
use super::{Circ, Lin, Planned, Ptp, commanded_pose};
use crate::quantity::Place;

/// The activity that a motion requests of an arm.
pub(super) fn activity(motion: &Planned, cell: &Cell, arm: &Arm) -> anyhow::Result<Activity> {
    let frame = |name: &Option<String>| {
        let frame = name.as_ref().map(|name| cell.frame(name));
        frame.transpose().map_err(hinted)
    };
    Ok(match motion {
        Planned::Ptp(Ptp { joints, .. }) => arm.ptp(joints.as_slice()),
        Planned::Home(_) => arm.home(),
        Planned::Lin(Lin { to, frame: of, .. }) => arm.lin(goal(to, arm, frame(of)?.as_ref())?),
        Planned::Circ(Circ {
            via, to, frame: of, ..
        }) => {
            let frame = frame(of)?;
            let [via, to] = [via, to].map(|place| goal(place, arm, frame.as_ref()));
            arm.circ(via?, to?)
        }
    })
}

/// A pose in the base of an arm or in a frame; without an orientation of its own it has that of the arm now.
fn goal(place: &Place, arm: &Arm, frame: Option<&Frame>) -> anyhow::Result<Goal> {
    let now = if place.is_whole() {
        None
    } else {
        let now = commanded_pose(arm)?;
        let base = frame.map(|frame| arm.base_frame().within(frame));
        let base = base.transpose().map_err(hinted)?;
        Some(base.unwrap_or(Pose::IDENTITY) * now)
    };
    let pose = place.pose(now).unwrap_or(Pose::IDENTITY);
    Ok(match frame {
        Some(frame) => pose.in_(frame),
        None => pose.into(),
    })
}
