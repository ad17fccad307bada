//! Several arms that hold one object: one motion of the object in one net, and every arm follows by its own kinematics.
//! Where one of them cannot follow, all brake on the common path, so that the object is not torn: a place out of reach
//! is noticed while the object can still come to rest before it, and when the device of one arm fails, the net goes on
//! until the others rest on the path. Not here: what the driver of the failed device does.

use takt_motion::plan::{FrameSample, Plan as MotionPlan};

use super::frame::{self, Route};
use super::{ArmDescription, CartesianLimits};
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::net::{Net, Port};
use crate::order::{Operation, Ports, Requests};
use crate::plan::{Plan, unfit, unplanned};
use crate::pose::Pose;
use crate::preparation::{Begin, Begins, Goals};

/// Largest speed of a joint, as part of its limit: where a joint is faster, the object brakes. Near a singularity joints
/// become faster while the object already brakes; the rest is for that.
const SPEED_MAX: f64 = 0.8;

/// Largest speed of a joint on a path that is checked beforehand, as part of its limit.
const CHECKED_SPEED_MAX: f64 = 0.6;

/// Largest mean speed of a joint, as part of its limit, if the object braked to rest for the longest time of braking: where
/// it is larger, the object brakes. More lets arms near a singularity leave the path by millimetres. A path that is checked
/// beforehand has no such place: it is refused with the speed at which it fits.
const BRAKING_SPEED_MAX: f64 = 0.4;

/// Least time for which the net goes on after a device failed, s.
const FAILURE_MIN_S: f64 = 1.0;

/// Longest time that controllers accept for it, s.
const FAILURE_MAX_S: f64 = 10.0;

/// Time for which the net goes on after a device failed, as part of the time that braking takes from constant velocity:
/// while the object accelerates, braking takes longer.
const FAILURE_PER_BRAKING: f64 = 2.0;

/// A joint that would be too fast if the object braked.
struct TooFast {
    /// Of its mean speed while braking to the largest one.
    ratio: f64,
    joint: usize,
    progress: f64,
    velocity: f64,
    limit: f64,
}

/// An arm that holds an object.
#[derive(Clone, Debug)]
pub(crate) struct Holder {
    pub(crate) arm: ArmDescription,
    /// Its base in the world.
    pub(crate) base: Pose,
    /// Its flange in the object.
    pub(crate) grasp: Pose,
}

impl Holder {
    /// Where the object is in the world.
    fn object(&self, begin: &Begin) -> Option<Pose> {
        Some(self.base * self.arm.pose(&begin.joints)? * self.grasp.inverse())
    }
}

/// A motion of an object that several arms hold.
#[derive(Clone, Debug)]
pub(crate) struct CoupledMotion {
    /// At least two arms, each once.
    pub(crate) holders: Vec<Holder>,
    /// Path of the object in the world.
    pub(crate) route: Route,
    pub(crate) limits: CartesianLimits,
}

impl CoupledMotion {
    fn first(&self) -> Result<&Holder, ErrorKind> {
        let few = || ErrorKind::Invalid("no arm holds the object".to_owned());
        self.holders.first().ok_or_else(few)
    }

    /// Where the object begins in the world, by the first arm.
    fn start(&self, begins: &Begins) -> Result<Pose, ErrorKind> {
        let first = self.first()?;
        let arm = &first.arm;
        let begin = begins.get(&arm.name).ok_or_else(|| arm.no_start())?;
        first.object(begin).ok_or_else(|| arm.no_model())
    }

    /// The motion of the object in the base of an arm, and that of the arm.
    fn plan_of(
        &self,
        holder: &Holder,
        begins: &Begins,
        speed: f64,
    ) -> Result<(Plan, MotionPlan<FrameSample>), ErrorKind> {
        let arm = &holder.arm;
        let begin = begins.get(&arm.name).ok_or_else(|| arm.no_start())?;
        let kinematics = arm.kinematics().ok_or_else(|| arm.no_model())?;
        let in_base = holder.base.inverse();
        let start = in_base * self.start(begins)?;
        let route = self.route.moved(&in_base);
        let object: MotionPlan<FrameSample> = route
            .plan(&start, (&self.limits, speed), arm.period)
            .map_err(|error| unplanned(arm, error))?;
        let grasp = holder.grasp.isometry();
        let joints = object.joints(&*kinematics, &arm.limits(), &begin.joints, grasp);
        let joints = joints.map_err(|found| unfit(arm, &found))?;
        Ok((Plan::new(arm, joints), object))
    }

    /// Plans the motion of an arm and checks it: no joint is too fast, and at no time would the object brake.
    fn checked(&self, holder: &Holder, begins: &Begins, speed: f64) -> Result<Plan, ErrorKind> {
        let (plan, object) = self.plan_of(holder, begins, speed)?;
        let too_fast = plan.check(speed, CHECKED_SPEED_MAX).err();
        let arm = &holder.arm;
        let kinematics = arm.kinematics().ok_or_else(|| arm.no_model())?;
        let grasp = holder.grasp.isometry();
        let braking_s = self.limits.braking_s(speed);
        let mut at_rest = vec![0.0; arm.joints.len()];
        let mut fastest: Option<TooFast> = None;
        for ((_, progress, joints), (_, object)) in plan.cycles().zip(object.cycles()) {
            let found = kinematics.inverse(&(object.rest * grasp), &joints, &mut at_rest);
            found.map_err(|cause| ErrorKind::Unreachable {
                device: arm.name.clone(),
                progress: progress * 100.0,
                cause: cause.to_string(),
            })?;
            let moved = joints.iter().zip(&at_rest).zip(&arm.joints).enumerate();
            for (joint, ((from, to), limits)) in moved {
                let velocity = (to - from) / braking_s;
                let limit = limits.velocity * BRAKING_SPEED_MAX;
                let ratio = velocity.abs() / limit;
                if ratio > fastest.as_ref().map_or(1.0, |it| it.ratio) {
                    fastest = Some(TooFast {
                        ratio,
                        joint,
                        progress,
                        velocity,
                        limit,
                    });
                }
            }
        }
        // Way and time of braking shrink with the speed, and so does the mean velocity, in proportion to it. Rounded down, so that the
        // number that is shown fits.
        let fits = |it: &TooFast| (speed / it.ratio * 1000.0).floor() / 1000.0;
        let Some(it) = fastest else {
            return too_fast.map_or(Ok(plan), Err);
        };
        let braking = ErrorKind::TooFast {
            device: arm.name.clone(),
            joint: it.joint,
            progress: it.progress * 100.0,
            velocity: it.velocity,
            limit: it.limit,
            speed: fits(&it),
        };
        let mut error = too_fast.unwrap_or_else(|| braking.clone());
        error.slow_down(&braking);
        Err(error)
    }

    /// Writes the arm of a holder; returns why it fails.
    fn write_arm(
        holder: &Holder,
        net: &mut Net,
        [position, rest]: [&Port; 2],
        braking_s: f64,
    ) -> Vec<(Failure, Port)> {
        let arm = &holder.arm;
        let mut flange = |object: &Port| {
            let in_base = net.frame(&holder.base.inverse());
            let object = net.of_two("World::FrameTransform", &in_base, object);
            net.transform(&object, &holder.grasp)
        };
        let (now, at_rest) = (flange(position), flange(rest));
        let (joints, beyond) = frame::inverse(net, arm, &now);
        let (rest_joints, will_be_beyond) = frame::inverse(net, arm, &at_rest);
        let beyond = net.of_two("Core::BooleanOr", &beyond, &will_be_beyond);
        let fast = [
            arm.any_faster(net, &joints, SPEED_MAX),
            arm.any_further(net, [&joints, &rest_joints], (braking_s, BRAKING_SPEED_MAX)),
        ];
        let fast: Vec<_> = fast.into_iter().flatten().collect();
        let fast = net.any(&fast);
        // A failed device comes first: its joints may be unknown, and out of reach for that.
        let mut failures = arm.command(net, &joints);
        failures.push((Failure::unreachable(&arm.name), beyond));
        failures.extend(fast.map(|fast| (Failure::too_fast(&arm.name), fast)));
        failures
    }
}

impl Operation for CoupledMotion {
    fn devices(&self) -> Vec<String> {
        let names = self.holders.iter().map(|holder| holder.arm.name.clone());
        names.collect()
    }

    fn check(&self) -> Result<(), ErrorKind> {
        let name = &self.first()?.arm.name;
        if self.holders.len() < 2 {
            let text = format!("{name}: only one arm holds the object; two or more are coupled");
            return Err(ErrorKind::Invalid(text));
        }
        for (number, holder) in self.holders.iter().enumerate() {
            let name = &holder.arm.name;
            let before = self.holders.get(..number).unwrap_or_default();
            if before.iter().any(|other| other.arm.name == *name) {
                let text = format!("{name}: the arm is coupled with itself");
                return Err(ErrorKind::Invalid(text));
            }
            if !(holder.base.is_finite() && holder.grasp.is_finite()) {
                return Err(ErrorKind::Invalid(format!(
                    "{name}: its base or its grasp is not finite"
                )));
            }
        }
        self.limits.check(name)?;
        self.route.check(name)
    }

    fn arms(&self) -> Vec<&ArmDescription> {
        self.holders.iter().map(|holder| &holder.arm).collect()
    }

    fn needs_start(&self) -> bool {
        self.route.needs_start()
    }

    fn follow(&self, begins: &Begins, speed: f64) -> Result<Goals, ErrorKind> {
        let mut goals = Goals::new();
        let arms = self.arms();
        // Without known starts, or known models, the controller checks the path while it runs.
        let is_known =
            |arm: &&ArmDescription| arm.kinematics().is_some() && begins.contains_key(&arm.name);
        if !arms.iter().all(is_known) {
            return Ok(goals);
        }
        let is_at_rest = begins.values().all(|begin| begin.is_at_rest);
        let mut found: Option<ErrorKind> = None;
        for holder in &self.holders {
            match self.checked(holder, begins, speed) {
                Ok(plan) => drop(goals.insert(holder.arm.name.clone(), plan.end())),
                Err(_) if !is_at_rest => {}
                Err(error) => {
                    let first = found.get_or_insert_with(|| error.clone());
                    first.slow_down(&error);
                }
            }
        }
        found.map_or(Ok(goals), Err)
    }

    fn plan(&self, begins: &Begins, speed: f64) -> Result<Plan, ErrorKind> {
        let plans = self
            .holders
            .iter()
            .map(|holder| self.plan_of(holder, begins, speed).map(|(plan, _)| plan));
        let mut plans = plans.collect::<Result<Vec<_>, _>>()?.into_iter();
        let first = plans
            .next()
            .ok_or_else(|| ErrorKind::Invalid("no arm".to_owned()))?;
        Ok(first.with_partners(plans.collect()))
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let first = self.first()?;
        let start = self.start(requests.begins).ok();
        let from = frame::commanded_in(net, &first.arm, &first.base, &first.grasp.inverse());
        let braking_s = self.limits.braking_s(requests.speed);
        let time_s = (FAILURE_PER_BRAKING * braking_s).clamp(FAILURE_MIN_S, FAILURE_MAX_S);
        let lost = [("Time", time_s.into())];
        let lost = net.add("DeviceFailure", lost).out("outFailed");
        let stop = net.of_two("Core::BooleanOr", &requests.stop, &lost);
        // A fault of any arm stops the object from the next cycle on.
        let (fault_in, stop) = net.feedback(&stop);
        let limits = (&self.limits, requests.speed);
        let moved = self
            .route
            .write(net, (&stop, limits), Some(&from), start.as_ref());
        let moved = moved.ok_or_else(|| first.arm.no_start())?;
        let ends = [&moved.position, &moved.rest];
        let faults = self.holders.iter();
        let faults = faults.flat_map(|holder| Self::write_arm(holder, net, ends, braking_s));
        let mut faults: Vec<_> = faults.collect();
        faults.push((Failure::device_lost(&first.arm.name), lost));
        let mut failures = Vec::new();
        let mut kept = Vec::new();
        for (failure, port) in faults {
            let latched = [("inOn", (&port).into())];
            let latched = net.add("Core::Trigger", latched).out("outActive");
            // The net ends when the object is at rest.
            let ended = net.of_two("Core::BooleanAnd", &moved.done, &latched);
            failures.push((failure, ended));
            kept.push(latched);
        }
        let fault = net.any(&kept).unwrap_or_else(|| moved.done.clone());
        net.close(&fault_in, &fault);
        Ok(Ports {
            done: moved.done,
            progress: Some(moved.progress),
            failures,
            results: Vec::new(),
            fault: Some(fault),
        })
    }
}
