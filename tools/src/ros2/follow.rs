//! `FollowJointTrajectory` and the topic of trajectories, for one arm or for several at once.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use takt_api::{ErrorKind, Handle, JointTrajectory, Waypoint, together};
use takt_fleet::ros::goal::{Allowed, Checked, check, check_trajectory, code, seconds};
use takt_fleet::ros::messages::{self, Feedback, FollowGoal, GoalId, Nanos, Point, Trajectory};
use takt_fleet::ros::node::{Node, now};
use takt_fleet::ros::types::{
    FOLLOW_FEEDBACK, FOLLOW_FEEDBACK_INDEX, FOLLOW_JOINT_TRAJECTORY, JOINT_TRAJECTORY,
};

use super::names::RosArm;
use super::server::{self, End, Performer, Refusals};
use super::states::Latest;
use crate::signal::Stop;

/// How much later than planned an end may be reached where a goal does not say, s.
const GOAL_TIME: f64 = 1.0;

/// Trajectories of a group of arms.
#[derive(Clone, Debug)]
pub(super) struct Follow {
    arms: Arc<[RosArm]>,
    /// Joints of all arms.
    joints: Arc<[String]>,
    /// rad, where goals name none: on the way, at the end.
    tolerances: [f64; 2],
    latest: Latest,
}

impl Follow {
    pub(super) fn new(arms: Vec<RosArm>, tolerances: [f64; 2], latest: Latest) -> Self {
        let joints = arms.iter().flat_map(|arm| arm.joints.clone());
        Self {
            joints: joints.collect(),
            arms: arms.into(),
            tolerances,
            latest,
        }
    }

    /// Offers the action and the topic of the group.
    pub(super) fn start(
        self,
        node: &Arc<Node>,
        group: &str,
        refusals: &Refusals,
        stop: &Stop,
    ) -> anyhow::Result<JoinHandle<()>> {
        let name = format!("{group}/follow_joint_trajectory");
        let feedbacks = [FOLLOW_FEEDBACK, FOLLOW_FEEDBACK_INDEX];
        let types = (&FOLLOW_JOINT_TRAJECTORY, &feedbacks[..]);
        let (server, queue) = server::offer(node, &name, types, self, (refusals, stop))?;
        let topic = format!("{group}/joint_trajectory");
        node.subscription(&topic, &JOINT_TRAJECTORY, move |message| {
            queue.put_message(message);
        })?;
        Ok(server.start()?)
    }

    /// The trajectory of each arm of a goal.
    fn trajectories(&self, goal: &Checked) -> Vec<JointTrajectory> {
        let mut first = 0;
        let of_arm = |arm: &RosArm| {
            let joints = first..first + arm.joints.len();
            first = joints.end;
            let part = |list: &[f64]| list.get(joints.clone()).unwrap_or_default().to_vec();
            let point = |point: &Point| Waypoint {
                time: seconds(point.time),
                positions: part(&point.positions),
                velocities: part(&point.velocities),
                accelerations: part(&point.accelerations),
            };
            let tolerance = |allowed: &[Allowed], default: f64| {
                let all = allowed.get(joints.clone()).unwrap_or_default().iter();
                let of_joint = |allowed: &Allowed| match allowed {
                    Allowed::Default => default,
                    Allowed::Any => 0.0,
                    Allowed::Most(most) => *most,
                };
                all.map(of_joint).collect()
            };
            let [path, end] = self.tolerances;
            JointTrajectory {
                points: goal.points.iter().map(point).collect(),
                path_tolerance: tolerance(&goal.path, path),
                goal_tolerance: tolerance(&goal.goal, end),
                goal_time: goal.goal_time.map_or(GOAL_TIME, seconds),
            }
        };
        self.arms.iter().map(of_arm).collect()
    }
}

/// A goal, and when its trajectory begins.
#[derive(Debug)]
pub(super) struct Goal {
    checked: Checked,
    received: Nanos,
}

impl Performer for Follow {
    type Goal = Goal;

    fn read(&self, message: &[u8]) -> Result<(GoalId, Goal), String> {
        let received = now();
        let goal = FollowGoal::decode(message).map_err(|why| why.to_string())?;
        let checked = check(&goal, &self.joints, received).map_err(|why| why.to_string())?;
        Ok((goal.id, Goal { checked, received }))
    }

    fn read_message(&self, message: &[u8]) -> Result<Goal, String> {
        let received = now();
        let trajectory = Trajectory::decode(message).map_err(|why| why.to_string())?;
        let checked = check_trajectory(&trajectory, &self.joints, received);
        let checked = checked.map_err(|why| why.to_string())?;
        Ok(Goal { checked, received })
    }

    fn delay(&self, goal: &Goal) -> Duration {
        let left = goal.received + goal.checked.delay - now();
        Duration::from_nanos(u64::try_from(left).unwrap_or(0))
    }

    fn begin(&mut self, goal: &Goal) -> Result<Handle, String> {
        let pairs = self.arms.iter().zip(self.trajectories(&goal.checked));
        let activities = pairs.map(|(arm, trajectory)| arm.arm.trajectory(trajectory).now());
        let begun = together(activities).begin();
        begun.map_err(|error| error.kind.to_string())
    }

    fn result(&self, status: u8, end: &End) -> Vec<u8> {
        let code = match end {
            End::Ended(Ok(_)) => code::SUCCESSFUL,
            End::Ended(Err(error)) => {
                if let ErrorKind::Deviation { place, .. } = &error.kind {
                    match *place {
                        "path" => code::PATH_TOLERANCE_VIOLATED,
                        _ => code::GOAL_TOLERANCE_VIOLATED,
                    }
                } else {
                    code::INVALID_GOAL
                }
            }
            End::NotBegun(_) | End::NoGoal => code::INVALID_GOAL,
        };
        let mut text = end.text();
        if let End::Ended(Err(error)) = end
            && let ErrorKind::Deviation { device, joint, .. } = &error.kind
            && let Some(name) = self.joint_name(device, *joint)
        {
            text = format!("{name}: {text}");
        }
        messages::follow_result(status, code, &text)
    }

    fn feedback(&self, id: GoalId, goal: &Goal, elapsed: Duration) -> Vec<Vec<u8>> {
        let samples: Option<Vec<_>> = self
            .arms
            .iter()
            .map(|arm| self.latest.of(&arm.name))
            .collect();
        let Some(samples) = samples else {
            return Vec::new();
        };
        let time = Nanos::try_from(elapsed.as_nanos()).unwrap_or(Nanos::MAX);
        let point = |positions: Vec<f64>| Point {
            positions,
            time,
            ..Point::default()
        };
        let commanded: Vec<f64> = samples.iter().flat_map(|it| it.commanded.clone()).collect();
        let measured: Vec<f64> = samples.iter().flat_map(|it| it.measured.clone()).collect();
        let pairs = commanded.iter().zip(&measured);
        let errors = pairs.map(|(commanded, measured)| commanded - measured);
        let passed = goal.checked.points.iter();
        let passed = passed.filter(|point| point.time <= time).count();
        let feedback = Feedback {
            id,
            stamp: samples.iter().map(|it| it.stamp).max().unwrap_or(0),
            joints: self.joints.to_vec(),
            points: [
                point(commanded.clone()),
                point(measured.clone()),
                point(errors.collect()),
            ],
            index: i32::try_from(passed).unwrap_or(i32::MAX),
        };
        vec![feedback.encode(false), feedback.encode(true)]
    }
}

impl Follow {
    /// The name of a joint of an arm, by the arm's name in the cell.
    fn joint_name(&self, device: &str, joint: usize) -> Option<&str> {
        let mut arms = self.arms.iter();
        let arm = arms.find(|arm| arm.arm.description().name == device)?;
        arm.joints.get(joint).map(String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use std::panic::Location;

    use takt_api::{Error, Outcome};

    use super::*;

    #[test]
    fn end_of_goal_has_its_code() {
        let follow = Follow::new(Vec::new(), [0.0, 0.0], Latest::default());
        let error = |kind| {
            End::Ended(Err(Error {
                kind,
                place: Location::caller(),
            }))
        };
        let deviation = |place| ErrorKind::Deviation {
            device: "left".to_owned(),
            place,
            joint: 2,
            deviation: 0.02,
        };
        for (end, code) in [
            (End::Ended(Ok(Outcome::Completed)), 0),
            (End::Ended(Ok(Outcome::TakenOver)), 0),
            (error(deviation("path")), -4),
            (error(deviation("goal")), -5),
            (error(ErrorKind::Invalid("no".to_owned())), -1),
            (End::NotBegun("too late".to_owned()), -1),
        ] {
            let expected = messages::follow_result(4, code, &end.text());
            assert_eq!(follow.result(4, &end), expected, "{end:?}");
        }
    }
}
