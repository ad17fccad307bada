//! A robot of a program: the motion that it executes, the one that follows by rounding, and how both are joined. A
//! Cartesian motion stops on its path before a point that the robot cannot reach. Nothing allocates after construction.

mod path;

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};
use takt_motion::live::{JointMotion, Step};
use takt_motion::plan::{Bounds, FrameBounds, FrameState, PlanError, Route, State};
use takt_net::device::Kinematics;
use takt_net::{Frame, JointLimits, Twist};

use super::{Fault, FaultKind, MAIN_JOINTS, MachineError, at_rest};
use crate::code::{ATTRIBUTES, Location};
use crate::spec;
use path::ToolPath;

/// How much faster than its limit a joint may become by rounding.
const SPEED_TOLERANCE: f64 = 1.05;

/// Where a motion leads.
#[derive(Clone, Copy, Debug)]
pub(super) enum Target {
    /// rad; not a number for joints that are not given.
    Joints([f64; MAIN_JOINTS]),
    Frame(Frame),
    /// m; the orientation stays.
    Position(Vector3<f64>),
}

/// A motion that the program ordered.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Order {
    /// By [`ATTRIBUTES`].
    pub(super) attributes: [f64; ATTRIBUTES.len()],
    pub(super) base: Frame,
    pub(super) tool: Frame,
    /// 0 ptp, 1 lin, 2 circle.
    pub(super) path: u32,
    pub(super) is_incremental: bool,
    pub(super) at: Location,
    /// Goal of the joints, rad.
    joints: [f64; MAIN_JOINTS],
    /// Start, auxiliary point and goal of the tool in the base of the robot, m.
    from: Frame,
    via: Frame,
    to: Frame,
}

impl Order {
    fn is_rounded(&self) -> bool {
        let [_, _, c_ptp, _, _, c_cp, c_ori, ..] = self.attributes;
        if self.path == 0 {
            c_ptp > 0.0
        } else {
            c_cp > 0.0 || c_ori > 0.0
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Active {
    None,
    Joints,
    Frame,
}

#[derive(Debug)]
pub(super) struct Robot {
    limits: Box<[Bounds]>,
    ranges: Box<[(f64, f64)]>,
    /// m/s³ and rad/s³ of the tool.
    jerk_m: f64,
    arm: Option<Arc<dyn Kinematics>>,
    joints: JointMotion,
    path: ToolPath,
    active: Active,
    now: Order,
    next: Option<Order>,
    /// Positions of this cycle and of the two before, rad.
    history: [Box<[f64]>; 3],
    states: Box<[State]>,
    bounds: Box<[Bounds]>,
    goal: Box<[f64]>,
    scratch: Box<[f64]>,
    /// Where the last motion that was ordered ends, in the base of the robot.
    end: Option<Frame>,
    /// A fault for which the robot brakes.
    fault: Option<FaultKind>,
    period_s: f64,
    owner: usize,
}

impl Robot {
    #[expect(
        clippy::too_many_lines,
        reason = "one struct of many preallocated parts"
    )]
    pub(super) fn new(
        robot: &spec::Robot,
        arm: Option<Arc<dyn Kinematics>>,
        period: Duration,
    ) -> Result<Self, MachineError> {
        let limits: Vec<JointLimits> = robot
            .joints
            .iter()
            .map(|joint| JointLimits {
                position_min: joint.min.to_radians(),
                position_max: joint.max.to_radians(),
                velocity_max: joint.speed.to_radians(),
                acceleration_max: joint.acceleration.to_radians(),
            })
            .collect();
        let count = limits.len();
        let error = |why: String| MachineError::Robot {
            name: robot.name.clone(),
            why,
        };
        if let Some(arm) = arm.as_ref().filter(|arm| arm.joints() != count) {
            return Err(error(format!(
                "the program was compiled for {count} joints, the device has {}",
                arm.joints()
            )));
        }
        let arm = match arm {
            Some(arm) => Some(arm),
            None if robot.model.is_empty() => None,
            None => {
                let (model, known) = (&robot.model, robot.model.limited(&limits));
                let why = || error(format!("there is no model `{model}` of {count} joints"));
                Some(known.ok_or_else(why)?)
            }
        };
        let zeros = || vec![0.0; count].into_boxed_slice();
        let mut made = Self {
            limits: robot
                .joints
                .iter()
                .map(|joint| Bounds {
                    velocity: joint.speed.to_radians(),
                    acceleration: joint.acceleration.to_radians(),
                    jerk: joint.jerk.to_radians(),
                })
                .collect(),
            ranges: limits
                .iter()
                .map(|l| (l.position_min, l.position_max))
                .collect(),
            jerk_m: robot.jerk / 1000.0,
            arm,
            joints: JointMotion::new(count, period)?,
            path: ToolPath::new(period)?,
            active: Active::None,
            now: Order::default(),
            next: None,
            history: [zeros(), zeros(), zeros()],
            states: vec![State::default(); count].into(),
            bounds: vec![
                Bounds {
                    velocity: 1.0,
                    acceleration: 1.0,
                    jerk: 1.0
                };
                count
            ]
            .into(),
            goal: zeros(),
            scratch: zeros(),
            end: None,
            fault: None,
            period_s: period.as_secs_f64(),
            owner: 0,
        };
        made.now.base = crate::builtin::of_six(&robot.base);
        made.now.tool = crate::builtin::of_six(&robot.tool);
        made.place(&vec![0.0; count]);
        Ok(made)
    }

    pub(super) fn place(&mut self, positions: &[f64]) {
        for history in &mut self.history {
            for (known, position) in history.iter_mut().zip(positions) {
                *known = *position;
            }
        }
        let [now, ..] = &self.history;
        self.goal.copy_from_slice(now);
        self.active = Active::None;
        self.next = None;
        self.end = None;
        self.fault = None;
    }

    pub(super) fn positions(&self) -> &[f64] {
        let [now, ..] = &self.history;
        now
    }

    pub(super) fn is_idle(&self) -> bool {
        self.active == Active::None && self.next.is_none()
    }

    pub(super) const fn owner(&self) -> usize {
        self.owner
    }

    /// Whether a motion can be ordered: it begins at once, or follows one that is rounded.
    pub(super) fn takes_order(&self) -> bool {
        self.active == Active::None || (self.now.is_rounded() && self.next.is_none())
    }

    /// The tool of the last motion in the world, m.
    pub(super) fn tool_centre(&self) -> Option<Frame> {
        let arm = self.arm.as_ref()?;
        Some(self.now.base * arm.forward(self.positions()) * self.now.tool)
    }

    /// Orders a motion.
    pub(super) fn order(
        &mut self,
        mut order: Order,
        target: Target,
        via: Option<Target>,
        owner: usize,
    ) -> Result<(), FaultKind> {
        let from = self.end_frame(&order);
        let goal = match target {
            Target::Joints(joints) => {
                order.joints = self.joint_goal(&joints, order.is_incremental)?;
                None
            }
            other @ (Target::Frame(_) | Target::Position(_)) => Some(place(other, from, &order)?),
        };
        if let Some(to) = goal {
            order.to = to;
            order.from = from.unwrap_or(to);
            if let Some(via) = via {
                order.via = place(via, from, &order)?;
            }
            self.solve(&mut order)?;
        }
        self.goal
            .iter_mut()
            .zip(order.joints)
            .for_each(|(goal, joint)| *goal = joint);
        self.end = goal;
        self.owner = owner;
        if self.active == Active::None {
            return self.begin(order, false);
        }
        self.next = Some(order);
        Ok(())
    }

    /// Where the last motion ends, with the tool of this one.
    fn end_frame(&self, order: &Order) -> Option<Frame> {
        let arm = self.arm.as_ref()?;
        let same_tool = self.now.tool == order.tool;
        match self.end.filter(|_| same_tool) {
            Some(end) => Some(end),
            None => Some(arm.forward(&self.goal) * order.tool),
        }
    }

    fn joint_goal(
        &self,
        given: &[f64; MAIN_JOINTS],
        is_incremental: bool,
    ) -> Result<[f64; MAIN_JOINTS], FaultKind> {
        let mut joints = [0.0; MAIN_JOINTS];
        for (i, (joint, given)) in joints.iter_mut().zip(given).enumerate() {
            let Some((range, goal)) = self.ranges.get(i).zip(self.goal.get(i)) else {
                if given.is_nan() {
                    continue;
                }
                return Err(FaultKind::JointCount);
            };
            if !given.is_finite() {
                return Err(FaultKind::JointCount);
            }
            *joint = if is_incremental { goal + given } else { *given };
            // Degrees are rounded on their way to radians.
            if *joint < range.0 - 1e-9 || *joint > range.1 + 1e-9 {
                return Err(FaultKind::JointLimit);
            }
        }
        Ok(joints)
    }

    /// The joints at the goal of a motion to a frame.
    fn solve(&mut self, order: &mut Order) -> Result<(), FaultKind> {
        let arm = self.arm.as_ref().ok_or(FaultKind::BadCode)?;
        let flange = order.to * order.tool.inverse();
        arm.inverse(&flange, &self.goal, &mut self.scratch)
            .map_err(|_| FaultKind::Unreachable)?;
        for (joint, found) in order.joints.iter_mut().zip(&self.scratch) {
            *joint = *found;
        }
        Ok(())
    }

    /// Begins a motion; `in_motion` joins it to the present one.
    fn begin(&mut self, order: Order, in_motion: bool) -> Result<(), FaultKind> {
        let begun = if order.path == 0 {
            self.begin_joints(&order)
        } else {
            self.begin_frame(&order, in_motion)
        };
        begun.map_err(|error| match error {
            PlanError::Path => FaultKind::NoPath,
            PlanError::Number => FaultKind::NotANumber,
            PlanError::Limit(_)
            | PlanError::Joints { .. }
            | PlanError::Bounds
            | PlanError::Period
            | PlanError::Endless
            | _ => FaultKind::Attribute,
        })?;
        self.active = if order.path == 0 {
            Active::Joints
        } else {
            Active::Frame
        };
        self.now = order;
        Ok(())
    }

    fn begin_joints(&mut self, order: &Order) -> Result<(), PlanError> {
        self.read_states();
        let [speed, acc, .., time] = order.attributes;
        for (bounds, limit) in self.bounds.iter_mut().zip(&self.limits) {
            *bounds = Bounds {
                velocity: limit.velocity * speed,
                acceleration: limit.acceleration * acc,
                jerk: limit.jerk * acc,
            };
        }
        let to = order.joints.get(..self.goal.len()).unwrap_or_default();
        self.joints.begin(&self.states, to, &self.bounds, 1.0)?;
        let factor = time / self.joints.duration_s();
        if time > 0.0 && factor.is_finite() && factor > 1.0 {
            self.bounds.iter_mut().for_each(|b| *b = slower(*b, factor));
            self.joints.begin(&self.states, to, &self.bounds, 1.0)?;
        }
        Ok(())
    }

    fn begin_frame(&mut self, order: &Order, in_motion: bool) -> Result<(), PlanError> {
        let is_corner = in_motion && self.active == Active::Frame;
        let [_, _, _, speed, acc, _, _, ori, time] = order.attributes;
        let acceleration = acc / 1000.0;
        let translation = Bounds {
            velocity: speed / 1000.0,
            acceleration,
            jerk: self.jerk_m,
        };
        // Rotation reaches its speed in the time in which translation does.
        let ratio = ori.to_radians() / translation.velocity;
        let rotation = Bounds {
            velocity: ori.to_radians(),
            acceleration: (acceleration * ratio).clamp(1e-3, 1e5),
            jerk: (self.jerk_m * ratio).clamp(1e-2, 1e6),
        };
        let state = self.frame_state(order).ok_or(PlanError::Number)?;
        let route = match order.path {
            2 => Route::Arc {
                from: if in_motion { order.from } else { state.frame },
                via: order.via,
                to: order.to,
            },
            _ => Route::Line { to: order.to },
        };
        let begin = |path: &mut ToolPath, factor: f64| {
            let bounds = FrameBounds {
                translation: slower(translation, factor),
                rotation: slower(rotation, factor),
            };
            if is_corner && factor <= 1.0 {
                return path.begin_at_corner(order.from, &route, bounds);
            }
            if is_corner {
                return path.begin_again(order.from, &route, bounds);
            }
            path.begin(&state, &route, bounds)
        };
        begin(&mut self.path, 1.0)?;
        let factor = time / self.path.duration_s();
        if time > 0.0 && factor.is_finite() && factor > 1.0 {
            begin(&mut self.path, factor)?;
        }
        Ok(())
    }

    /// The state of all joints: exact where joints are what moves, else from three positions.
    fn read_states(&mut self) {
        let [now, before, earlier] = &self.history;
        let triples = now.iter().zip(before).zip(earlier);
        for (i, (state, ((a, b), c))) in self.states.iter_mut().zip(triples).enumerate() {
            *state = match self.active {
                Active::None => at_rest(*a),
                Active::Joints => self.joints.joint(i),
                Active::Frame => State {
                    position: *a,
                    velocity: (3.0 * a - 4.0 * b + c) / (2.0 * self.period_s),
                    acceleration: (a - 2.0 * b + c) / (self.period_s * self.period_s),
                },
            };
        }
    }

    /// The state of the tool of a motion.
    fn frame_state(&self, order: &Order) -> Option<FrameState> {
        let arm = self.arm.as_ref()?;
        let [now, before, earlier] = &self.history;
        match self.active {
            Active::None => return Some(FrameState::at_rest(arm.forward(now) * order.tool)),
            Active::Frame | Active::Joints => {}
        }
        let [a, b, c] = [now, before, earlier].map(|q| arm.forward(q) * order.tool);
        let t = self.period_s;
        let [pa, pb, pc] = [a, b, c].map(|f| f.translation.vector);
        let turn = |to: &Frame, from: &Frame| -> Vector3<f64> {
            let turn: UnitQuaternion<f64> = to.rotation * from.rotation.inverse();
            turn.scaled_axis() / t
        };
        let (last, previous) = (turn(&a, &b), turn(&b, &c));
        Some(FrameState {
            frame: a,
            velocity: Twist {
                vel: (pa * 3.0 - pb * 4.0 + pc) / (2.0 * t),
                rot: last * 1.5 - previous * 0.5,
            },
            acceleration: Twist {
                vel: (pa - pb * 2.0 + pc) / (t * t),
                rot: (last - previous) / t,
            },
        })
    }

    /// One cycle. A fault is returned once, at its onset.
    pub(super) fn cycle(&mut self, speed: f64, stop: bool) -> Result<(), Fault> {
        if stop {
            self.next = None;
        }
        let before = self.fault;
        // A brake does not depend on the override.
        let speed = if self.fault.is_some() { 1.0 } else { speed };
        let stop = stop || self.fault.is_some();
        let step = match self.active {
            Active::None => None,
            Active::Joints => Some(self.joints.step(speed, stop)),
            Active::Frame => Some(self.frame_step(speed, stop)),
        };
        if self.active == Active::Joints {
            for (i, position) in self.scratch.iter_mut().enumerate() {
                *position = self.joints.joint(i).position;
            }
        }
        let [now, old, older] = &mut self.history;
        older.copy_from_slice(old);
        old.copy_from_slice(now);
        if let Some(step) = step {
            now.copy_from_slice(&self.scratch);
            self.go_on(step, stop);
        }
        match (before, self.fault) {
            (None, Some(kind)) => {
                self.next = None;
                Err(Fault {
                    kind,
                    at: self.now.at,
                })
            }
            _ => Ok(()),
        }
    }

    /// Ends a motion, or joins the next one to it.
    fn go_on(&mut self, step: Step, stop: bool) {
        if step.is_done {
            self.active = Active::None;
            if stop {
                let [now, ..] = &self.history;
                self.goal.copy_from_slice(now);
                self.end = None;
            }
        }
        let Some(next) = self.next else { return };
        if stop || !(step.is_done || self.is_near_end(step.progress)) {
            return;
        }
        self.next = None;
        if let Err(kind) = self.begin(next, !step.is_done) {
            self.fault = Some(kind);
            self.now.at = next.at;
        }
    }

    fn is_near_end(&self, progress: f64) -> bool {
        let [_, _, c_ptp, _, _, c_cp, c_ori, ..] = self.now.attributes;
        if self.active == Active::Joints {
            return 1.0 - progress <= c_ptp;
        }
        // Motions of different tools have no corner in common.
        let next = self.next.as_ref();
        let fits = next.is_some_and(|next| next.path == 0 || next.tool == self.now.tool);
        fits && self
            .path
            .is_near_end(progress, c_cp / 1000.0, c_ori.to_radians())
    }

    /// A cycle along a path of the tool; the joints are in `scratch` then.
    fn frame_step(&mut self, speed: f64, stop: bool) -> Step {
        let Some(arm) = self.arm.clone() else {
            return Step {
                progress: 1.0,
                is_done: true,
            };
        };
        let flange = self.now.tool.inverse();
        let [now, ..] = &self.history;
        let rest = self.path.rest() * flange;
        if arm.inverse(&rest, now, &mut self.scratch).is_err() {
            self.fault = self.fault.or(Some(FaultKind::Unreachable));
        }
        let stop = stop || self.fault.is_some();
        let step = self.path.step(speed, stop);
        let at = self.path.now() * flange;
        let found = arm.inverse(&at, now, &mut self.scratch);
        let pairs = self.scratch.iter().zip(now).zip(&self.limits);
        let fits = pairs.fold(true, |fits, ((to, from), limit)| {
            fits && (to - from).abs() <= limit.velocity * self.period_s * SPEED_TOLERANCE
        });
        if found.is_ok() && fits {
            return step;
        }
        let kind = if found.is_err() {
            FaultKind::Unreachable
        } else {
            FaultKind::JointSpeed
        };
        self.fault = self.fault.or(Some(kind));
        self.brake()
    }

    /// Leaves the path: brakes all joints at their limits.
    fn brake(&mut self) -> Step {
        self.read_states();
        for (goal, state) in self.scratch.iter_mut().zip(&self.states) {
            *goal = state.position + state.velocity;
        }
        self.active = Active::Joints;
        let begun = self
            .joints
            .begin(&self.states, &self.scratch, &self.limits, 1.0);
        if begun.is_err() {
            let [now, ..] = &self.history;
            self.scratch.copy_from_slice(now);
            return Step {
                progress: 1.0,
                is_done: true,
            };
        }
        self.joints.step(1.0, true)
    }
}

/// Bounds with which the same motion from rest takes `factor` times as long.
fn slower(bounds: Bounds, factor: f64) -> Bounds {
    Bounds {
        velocity: bounds.velocity / factor,
        acceleration: bounds.acceleration / factor.powi(2),
        jerk: bounds.jerk / factor.powi(3),
    }
}

/// A target in the base of the robot.
fn place(target: Target, from: Option<Frame>, order: &Order) -> Result<Frame, FaultKind> {
    let before = from.ok_or(FaultKind::BadCode)?;
    Ok(match (target, order.is_incremental) {
        (Target::Frame(frame), false) => order.base.inverse() * frame,
        (Target::Frame(frame), true) => before * frame,
        (Target::Position(position), false) => {
            let at = order.base.inverse() * nalgebra::Point3::from(position);
            Frame::from_parts(at.into(), before.rotation)
        }
        (Target::Position(position), true) => {
            before * Frame::translation(position.x, position.y, position.z)
        }
        (Target::Joints(_), _) => return Err(FaultKind::BadCode),
    })
}
