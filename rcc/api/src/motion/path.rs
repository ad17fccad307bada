//! The motions of one arm to a goal: joints together, or a frame at the flange along a path.

use super::frame::{self, Course, Route};
use super::{ArmDescription, CartesianLimits};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::net::{Net, array};
use crate::order::{Operation, Ports, Requests};
use crate::plan::{Plan, joint_bounds, unfit, unplanned};
use crate::pose::Pose;
use crate::preparation::{Begins, Goals};
use takt_motion::plan::{State, plan};

/// Where an arm is to move, and on which path. Poses are those of the motion centre in the base of the arm.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Path {
    /// To joint positions (rad), all joints together; the path of the flange follows from that.
    Ptp(Vec<f64>),
    /// The same to the joint positions of a pose: those next to the hint (rad), or to where the arm begins.
    Pose { to: Pose, hint: Option<Vec<f64>> },
    /// The motion centre along a path.
    Frame(Route),
}

/// A motion of an arm with everything that is needed to write its net.
#[derive(Clone, Debug)]
pub(crate) struct ArmMotion {
    pub(crate) arm: ArmDescription,
    /// Or why its goals are not known.
    pub(crate) path: Result<Path, ErrorKind>,
    /// Limits of the motion centre on paths.
    pub(crate) limits: CartesianLimits,
    /// The motion centre in the flange.
    pub(crate) tool: Pose,
}

impl Operation for ArmMotion {
    fn devices(&self) -> Vec<String> {
        vec![self.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let name = &self.arm.name;
        if !self.tool.is_finite() {
            return Err(ErrorKind::not_finite(name, "the motion centre"));
        }
        self.limits.check(name)?;
        match self.path()? {
            Path::Ptp(to) => self.arm.check_joints(to),
            Path::Pose { to, .. } if !to.is_finite() => {
                Err(ErrorKind::not_finite(name, "the pose"))
            }
            Path::Pose { hint, .. } => match hint {
                Some(hint) => self.arm.check_joints(hint),
                None => Ok(()),
            },
            Path::Frame(route) => route.check(name),
        }
    }

    fn arms(&self) -> Vec<&ArmDescription> {
        vec![&self.arm]
    }

    fn needs_begins(&self) -> bool {
        match &self.path {
            Ok(Path::Ptp(_)) | Err(_) => false,
            Ok(Path::Pose { hint, .. }) => hint.is_none(),
            Ok(Path::Frame(_)) => true,
        }
    }

    fn needs_start(&self) -> bool {
        matches!(&self.path, Ok(Path::Frame(route)) if route.needs_start())
    }

    fn follow(&self, begins: &Begins, speed: f64) -> Result<Goals, ErrorKind> {
        let name = &self.arm.name;
        if !matches!(self.path, Ok(Path::Frame(_))) {
            return Ok(Goals::from([(name.clone(), self.goal(begins)?)]));
        }
        // Without a known start, or a known model, the controller checks the path while it runs.
        let (Some(begin), Some(_)) = (begins.get(name), self.arm.kinematics()) else {
            return Ok(Goals::new());
        };
        let plan = self.plan(begins, speed);
        match plan.and_then(|plan| plan.check(speed, 1.0).map(|()| plan)) {
            Ok(plan) => Ok(Goals::from([(name.clone(), plan.end())])),
            Err(_) if !begin.is_at_rest => Ok(Goals::new()),
            Err(error) => Err(error),
        }
    }

    fn plan(&self, begins: &Begins, speed: f64) -> Result<Plan, ErrorKind> {
        let arm = &self.arm;
        let begin = begins.get(&arm.name).ok_or_else(|| arm.no_start())?;
        let Path::Frame(route) = self.path()? else {
            let from: Vec<_> = begin.joints.iter().map(|q| State::at_rest(*q)).collect();
            let joints = arm.joints.iter();
            let bounds: Vec<_> = joints.map(|joint| joint_bounds(joint, speed)).collect();
            let joints = plan(&from, &self.goal(begins)?, &bounds, arm.period);
            let joints = joints.map_err(|error| unplanned(arm, error))?;
            return Ok(Plan::new(arm, joints));
        };
        let kinematics = arm.kinematics().ok_or_else(|| arm.no_model())?;
        let start = Pose::from(kinematics.forward(&begin.joints)) * self.tool;
        let frames = route.plan(&start, (&self.limits, speed), arm.period);
        let frames = frames.map_err(|error| unplanned(arm, error))?;
        let flange = self.tool.isometry().inverse();
        let limits = arm.limits();
        let joints = frames.joints(&*kinematics, &limits, &begin.joints, &flange);
        let joints = joints.map_err(|found| unfit(arm, &found))?;
        Ok(Plan::new(arm, joints))
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let arm = &self.arm;
        let mut failures = Vec::new();
        let mut fault = None;
        let course = match self.path()? {
            Path::Ptp(_) | Path::Pose { .. } => self.joint_motion(net, requests)?,
            Path::Frame(route) => {
                let start = requests.begins.get(&arm.name);
                let start = start.and_then(|begin| arm.pose(&begin.joints));
                let start = start.map(|start| start * self.tool);
                let from = frame::commanded(net, arm, &self.tool);
                let limits = (&self.limits, requests.speed);
                let (fault_in, stop) = net.feedback(&requests.stop);
                let moved = route.write(net, (&stop, limits), Some(&from), start.as_ref());
                let moved = moved.ok_or_else(|| arm.no_start())?;
                let grip = self.tool.inverse();
                let (flange, rest) = (
                    net.transform(&moved.position, &grip),
                    net.transform(&moved.rest, &grip),
                );
                let (joints, beyond) = frame::inverse(net, arm, &flange);
                let (_, will_be_beyond) = frame::inverse(net, arm, &rest);
                // It brakes on the path, while it can still come to rest within reach, and fails at rest: what follows
                // begins there.
                let beyond = net.of_two("Core::BooleanOr", &beyond, &will_be_beyond);
                let latched = [("inOn", (&beyond).into())];
                let latched = net.add("Core::Trigger", latched).out("outActive");
                net.close(&fault_in, &latched);
                let ended = net.of_two("Core::BooleanAnd", &moved.done, &latched);
                failures.push((Failure::unreachable(&arm.name), ended));
                fault = Some(latched);
                moved.course(joints)
            }
        };
        failures.extend(arm.command(net, &course.joints));
        Ok(Ports {
            done: course.done,
            progress: Some(course.progress),
            failures,
            results: Vec::new(),
            fault,
        })
    }
}

impl ArmMotion {
    fn path(&self) -> Result<&Path, ErrorKind> {
        self.path.as_ref().map_err(Clone::clone)
    }

    /// The joint positions that it ends at, rad, if its goal is one of the joints.
    fn goal(&self, begins: &Begins) -> Result<Vec<f64>, ErrorKind> {
        let (arm, name) = (&self.arm, &self.arm.name);
        let (to, hint) = match self.path()? {
            Path::Ptp(to) => return Ok(to.clone()),
            Path::Pose { to, hint } => (to, hint),
            Path::Frame(_) => return Err(arm.no_start()),
        };
        let begin = begins.get(name).map(|begin| begin.joints.clone());
        let hint = hint.clone().or(begin).ok_or_else(|| arm.no_start())?;
        let kinematics = arm.kinematics().ok_or_else(|| arm.no_model())?;
        let mut joints = vec![0.0; arm.joints.len()];
        let flange = *to * self.tool.inverse();
        let found = kinematics.inverse(flange.isometry(), &hint, &mut joints);
        found.map_err(|cause| ErrorKind::Unreachable {
            device: name.clone(),
            progress: 100.0,
            cause: cause.to_string(),
        })?;
        Ok(joints)
    }

    fn joint_motion(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Course, ErrorKind> {
        let arm = &self.arm;
        let positions = arm.joint_array(net, "outCommandedPosition");
        let velocities = arm.joint_array(net, "outCommandedVelocity");
        let accelerations = arm.joint_array(net, "outCommandedAcceleration");
        let over = net.override_in();
        let [velocity, acceleration, jerk] = arm.limit_texts();
        let ptp = net.add(
            "Motion::Ptp",
            [
                ("inStop", (&requests.stop).into()),
                ("inOverride", (&over).into()),
                ("inFrom", (&positions).into()),
                ("inFromVelocity", (&velocities).into()),
                ("inFromAcceleration", (&accelerations).into()),
                ("To", array(&self.goal(requests.begins)?).into()),
                ("Velocity", velocity.into()),
                ("Acceleration", acceleration.into()),
                ("Jerk", jerk.into()),
                ("Speed", requests.speed.into()),
            ],
        );
        Ok(Course {
            joints: ptp.out("outPosition"),
            progress: ptp.out("outProgress"),
            done: ptp.out("outDone"),
        })
    }
}
