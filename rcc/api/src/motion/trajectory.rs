//! Joints through points at given times, as planners make them. The points are checked against the limits of the joints before
//! anything is loaded; the deviation of the measured positions is checked in each cycle.

use takt_motion::plan::State;
use takt_motion::trajectory::{Planned, Waypoint, code, plan};

use super::ArmDescription;
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::net::{Net, Port, Primitive, array};
use crate::order::{Operation, Ports, Requests};
use crate::preparation::{Begin, Begins, Goals};

/// Points with times through which joints move, with tolerances.
///
/// Between points the positions are quintic polynomials where both have accelerations, else cubic ones. Without velocities a
/// joint passes a point as fast as the points beside it suggest, and rests where it turns back and at the end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointTrajectory {
    /// The points; their times, s, increase and count from the start. A point at 0 is where the joints should be.
    pub points: Vec<Waypoint>,
    /// Largest deviation of a measured position on the way, rad: one value for each joint, one for all, or none for any
    /// deviation. 0 is any.
    pub path_tolerance: Vec<f64>,
    /// The same at the end.
    pub goal_tolerance: Vec<f64>,
    /// How long after its end the goal may be reached within the tolerance, s; below 0 as long as it takes.
    pub goal_time: f64,
}

impl JointTrajectory {
    /// A trajectory without points, nor tolerances.
    #[must_use]
    pub fn new() -> Self {
        Self {
            goal_time: 1.0,
            ..Self::default()
        }
    }

    /// Adds a point: positions (rad) at a time (s).
    #[must_use]
    pub fn point(mut self, time: f64, positions: impl Into<Vec<f64>>) -> Self {
        self.points.push(Waypoint {
            time,
            positions: positions.into(),
            ..Waypoint::default()
        });
        self
    }

    /// Adds a point that joints pass at these velocities, rad/s.
    #[must_use]
    pub fn passing(
        mut self,
        time: f64,
        positions: impl Into<Vec<f64>>,
        velocities: impl Into<Vec<f64>>,
    ) -> Self {
        self.points.push(Waypoint {
            time,
            positions: positions.into(),
            velocities: velocities.into(),
            ..Waypoint::default()
        });
        self
    }

    /// Ends it where a measured position is further from the path, rad.
    #[must_use]
    pub fn path_tolerance(mut self, most: impl Into<Vec<f64>>) -> Self {
        self.path_tolerance = most.into();
        self
    }

    /// Waits at most `time` s, below 0 as long as it takes, until the measured positions are this near to the goal, rad.
    #[must_use]
    pub fn goal_tolerance(mut self, most: impl Into<Vec<f64>>, time: f64) -> Self {
        self.goal_tolerance = most.into();
        self.goal_time = time;
        self
    }

    /// The points at a part of the speed, which scales time.
    fn at_speed(&self, speed: f64) -> Vec<Waypoint> {
        let scaled = |list: &[f64], factor: f64| list.iter().map(|value| value * factor).collect();
        let points = self.points.iter();
        let points = points.map(|point| Waypoint {
            time: point.time / speed,
            positions: point.positions.clone(),
            velocities: scaled(&point.velocities, speed),
            accelerations: scaled(&point.accelerations, speed * speed),
        });
        points.collect()
    }
}

/// An arm along a trajectory.
#[derive(Clone, Debug)]
pub(crate) struct Along {
    pub(crate) arm: ArmDescription,
    pub(crate) trajectory: JointTrajectory,
}

/// Time from the moment in which it is planned until its net begins, s: an arm in motion moves on meanwhile.
const LEAD_S: f64 = 0.01;

impl Along {
    fn begin<'a>(&self, begins: &'a Begins) -> Result<&'a Begin, ErrorKind> {
        let begin = begins.get(&self.arm.name);
        begin.ok_or_else(|| self.arm.no_start())
    }

    fn planned(&self, begins: &Begins, speed: f64) -> Result<Planned, ErrorKind> {
        let begin = self.begin(begins)?;
        let pairs = begin.joints.iter().zip(&begin.velocities);
        let states = pairs.map(|(position, velocity)| State {
            position: position + velocity * LEAD_S,
            velocity: *velocity,
            acceleration: 0.0,
        });
        let states: Vec<_> = states.collect();
        let points = self.trajectory.at_speed(speed);
        let first = points.first().filter(|point| point.time <= 0.0);
        // Where it begins is made up for on the way if it is near.
        if let Some(first) = first.filter(|_| begin.is_at_rest) {
            let pairs = first.positions.iter().zip(&begin.joints).enumerate();
            let far = pairs.map(|(joint, (to, from))| (joint, (to - from).abs()));
            let far = far.max_by(|(_, a), (_, b)| a.total_cmp(b));
            if let Some((joint, distance)) = far.filter(|(_, it)| *it > START_TOLERANCE) {
                let cause = format!(
                    "joint {joint} is {distance:.3} rad from the first point; at most {START_TOLERANCE} rad are made up for\n\
                     hint: plan from where the arm is, or move to the first point before"
                );
                return Err(self.unplanned(cause));
            }
        }
        plan(&states, &points, &self.arm.limits()).map_err(|error| {
            self.unplanned(format!(
                "{error}\nhint: give it more time, or begin it nearer to its first point"
            ))
        })
    }

    fn unplanned(&self, cause: String) -> ErrorKind {
        ErrorKind::Unplanned {
            device: self.arm.name.clone(),
            cause,
        }
    }

    /// Whether it ended for a reason, by its code.
    fn ended(&self, net: &mut Net, trajectory: &Primitive, code: i32) -> Port {
        let code = [
            ("inFirst", (&trajectory.out("outCode")).into()),
            ("Second", code.to_string().into()),
        ];
        let is_it = net.add("Core::IntEquals", code).out("outValue");
        net.of_two("Core::BooleanAnd", &is_it, &trajectory.out("outDone"))
    }
}

/// Largest distance of a joint at rest from the first point, rad.
const START_TOLERANCE: f64 = 0.01;

impl Operation for Along {
    fn devices(&self) -> Vec<String> {
        vec![self.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let (name, joints) = (&self.arm.name, self.arm.joints.len());
        let trajectory = &self.trajectory;
        for (what, list) in [
            ("path_tolerance", &trajectory.path_tolerance),
            ("goal_tolerance", &trajectory.goal_tolerance),
        ] {
            let is_wrong = |value: &f64| !(value.is_finite() && *value >= 0.0);
            let fits = [0, 1, joints].contains(&list.len());
            if !fits || list.iter().any(is_wrong) {
                return Err(ErrorKind::Invalid(format!(
                    "{name}: `{what}` has {} values; one for all or one for each of {joints} joints, at least 0 rad",
                    list.len()
                )));
            }
        }
        if !trajectory.goal_time.is_finite() {
            return Err(ErrorKind::not_finite(name, "the goal time"));
        }
        if let Some(last) = trajectory.points.last() {
            self.arm.check_joints(&last.positions)?;
        }
        Ok(())
    }

    fn arms(&self) -> Vec<&ArmDescription> {
        vec![&self.arm]
    }

    fn follow(&self, begins: &Begins, speed: f64) -> Result<Goals, ErrorKind> {
        self.planned(begins, speed)?;
        let last = self.trajectory.points.last();
        let goal = last.map(|point| (self.arm.name.clone(), point.positions.clone()));
        Ok(goal.into_iter().collect())
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let (arm, trajectory) = (&self.arm, &self.trajectory);
        let table = self.planned(requests.begins, requests.speed)?.table;
        let joins = !self.begin(requests.begins)?.is_at_rest;
        let positions = arm.joint_array(net, "outCommandedPosition");
        let velocities = arm.joint_array(net, "outCommandedVelocity");
        let accelerations = arm.joint_array(net, "outCommandedAcceleration");
        let measured = arm.joint_array(net, "outMeasuredPosition");
        let [velocity, acceleration, jerk] = arm.limit_texts();
        let tolerance = |list: &[f64]| array(if list.is_empty() { &[0.0] } else { list });
        let arguments = [
            ("inStop", (&requests.stop).into()),
            ("inMeasured", (&measured).into()),
            ("inFrom", (&positions).into()),
            ("inFromVelocity", (&velocities).into()),
            ("inFromAcceleration", (&accelerations).into()),
            ("Joints", arm.joints.len().into()),
            ("Table", table.text().into()),
            (
                "PathTolerance",
                tolerance(&trajectory.path_tolerance).into(),
            ),
            (
                "GoalTolerance",
                tolerance(&trajectory.goal_tolerance).into(),
            ),
            ("GoalTime", trajectory.goal_time.into()),
            ("StartTolerance", START_TOLERANCE.into()),
            ("Join", joins.to_string().into()),
            ("Velocity", velocity.into()),
            ("Acceleration", acceleration.into()),
            ("Jerk", jerk.into()),
        ];
        let moved = net.add("Motion::Trajectory", arguments);
        let name = &arm.name;
        let mut failures: Vec<_> = [
            (Failure::deviated("path", name), code::PATH),
            (Failure::deviated("goal", name), code::GOAL),
            (Failure::moved(name), code::ELSEWHERE),
        ]
        .into_iter()
        .map(|(failure, code)| (failure, self.ended(net, &moved, code)))
        .collect();
        let fault = [
            ("inFirst", (&moved.out("outCode")).into()),
            ("Second", code::NONE.to_string().into()),
        ];
        let is_good = net.add("Core::IntEquals", fault).out("outValue");
        let fault = net.of("Core::BooleanNot", &is_good);
        let asked = net.of("Core::BooleanNot", &requests.stop);
        let fault = net.of_two("Core::BooleanAnd", &fault, &asked);
        for (key, port, kind) in [
            ("joint", "outJoint", "Core::IntNetcommOut"),
            ("deviation", "outDeviation", "Core::DoubleNetcommOut"),
        ] {
            net.add(
                kind,
                [("inValue", (&moved.out(port)).into()), ("Key", key.into())],
            );
        }
        let progress = net.scaled(&moved.out("outTime"), 1.0 / table.duration());
        failures.extend(arm.command(net, &moved.out("outPosition")));
        Ok(Ports {
            done: moved.out("outDone"),
            progress: Some(progress),
            failures,
            results: Vec::new(),
            fault: Some(fault),
        })
    }
}
