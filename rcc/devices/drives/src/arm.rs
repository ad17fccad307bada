//! An arm whose joints are axes of CiA 402 drives, on any bus. Nets command the arm only while all axes follow;
//! otherwise, those that still follow brake within their limits and hold their positions against any load. Access to
//! an axis is up to its bus.
//!
//! Drives are enabled as soon as no net commands the arm, and re-enabled after a fault once no net has commanded it
//! for a second: motion from before a fault does not continue. With `recovery = "on_restart"` a fault shuts the arm
//! down. A shutdown removes power when the motors are at standstill ([`Shutdown`]).

use std::fmt;
use std::time::Duration;

use takt_cia402::proof::Objects;
use takt_cia402::{Goal, Power, Runaway, Shutdown, State, StatusWord, axis_goal};
use takt_rt::Nanos;
use takt_rt::cycle::Tick;

use crate::check::parts;
use crate::config::{DriveArm, Recovery};
use crate::driven::{Driven, When, time_of};
use crate::torque::{Cut, Torques};
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::Endpoint;
use takt_core::device::{ARM_JOINTS_MAX, DeviceStatus, Figure};

/// Faults of drives are reset after this time without a command.
const REST: Duration = Duration::from_secs(1);
/// A joint that accelerates less is steady, rad/s².
const STEADY: f64 = 0.2;
/// The latest state of an axis.
#[derive(Clone, Copy, Debug)]
pub struct Feedback {
    /// Whether it answers.
    pub online: bool,
    /// Whether it follows its targets.
    pub follows: bool,
    /// State in 6041h; `None` if the statusword shows none.
    pub state: Option<State>,
    /// 6041h; `None` of an axis without one.
    pub status: Option<StatusWord>,
    /// 6064h.
    pub increments: i32,
    /// Whether it gets no power because its process data are not proven.
    pub refused: bool,
    /// Whether it heeds no targets, as its zero is not known yet or being found: set-points of its joint are refused, and the
    /// joint is where the axis is.
    pub is_homing: bool,
    /// 6077h, per mille of the rated torque; `None` if it is not mapped.
    pub torque: Option<i16>,
}

/// An event of a joint, reported once per occurrence.
#[derive(Clone, Copy, Debug)]
pub enum JointEvent {
    /// The motor did not follow its target.
    Runaway(Runaway),
    /// The joint is out of its range.
    OutOfRange {
        /// Position, degrees.
        position: f64,
        /// Range, degrees.
        range: [f64; 2],
    },
    /// Its feed-forward torque was cut off at its limit.
    FeedForward(Cut),
    /// The arm carries another load than the cell states: so much more, kg.
    Load(f64),
}

impl JointEvent {
    /// Whether the joint does its work all the same.
    #[must_use]
    pub const fn is_warning(&self) -> bool {
        match self {
            Self::OutOfRange { .. } | Self::FeedForward(_) | Self::Load(_) => true,
            Self::Runaway(_) => false,
        }
    }
}

impl fmt::Display for JointEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Runaway(runaway) => runaway.fmt(f),
            Self::OutOfRange {
                position,
                range: [low, high],
            } => write!(
                f,
                "position {position:.2} degrees is out of range {low:.2} to {high:.2}\nhint: move it back by set-points \
                 that begin at its position, which it follows slowly, or correct `zero` and `range`"
            ),
            Self::FeedForward(Cut { wanted, .. }) if !wanted.is_finite() => f.write_str(
                "the model has no feed-forward torque for this motion; none is sent\nhint: check masses and inertia of its \
                 URDF: `takt arm check FILE`",
            ),
            Self::FeedForward(Cut { wanted, most }) => write!(
                f,
                "feed-forward of {wanted:.1} Nm is cut off at {most:.1} Nm\nhint: check the masses of its URDF and `payload`, or \
                 raise `feed_forward`"
            ),
            Self::Load(more) => write!(
                f,
                "the arm carries about {:.1} kg {} than its cell states, by its torques\nhint: correct `payload` \
                 in the cell, or the masses of the URDF",
                more.abs(),
                if *more > 0.0 { "more" } else { "less" }
            ),
        }
    }
}

/// Commands to an axis for one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Order {
    /// The new goal, if it changed.
    pub goal: Option<Goal>,
    /// Whether to reset a fault.
    pub reset: bool,
    /// 607Ah; `None` while the axis does not follow: its target is its position.
    pub target: Option<i32>,
    /// 60B2h, per mille of the rated torque.
    pub torque_offset: i16,
}

/// The arm.
#[derive(Debug)]
pub struct Arm {
    recovery: Recovery,
    joints: Vec<Driven>,
    torques: Torques,
    period: Nanos,
    end: Endpoint,
    /// The last cycle in which a net commanded it.
    commanded: Nanos,
    last: Option<Nanos>,
    powered: bool,
    /// The shutdown, once requested.
    shutdown: Option<Shutdown>,
    held: bool,
    withheld: bool,
    returned: Return,
}

/// Drives that were lost while they followed, and returned. Their reaction to the loss may still be under way: they show
/// Operation enabled for some cycles more, then a quick stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Return {
    /// They follow, or were not enabled yet.
    #[default]
    None,
    /// They are away.
    Away,
    /// They returned then.
    Since(Nanos),
}

/// Time after a return in which a drive reacts to the loss.
const SETTLE: Duration = Duration::from_millis(200);

impl Arm {
    /// An arm on a bus with that cycle time and these figures.
    pub fn new<D>(
        arm: &DriveArm<D>,
        cycle: Duration,
        end: DeviceEnd,
        of_bus: impl IntoIterator<Item = Figure>,
    ) -> Self {
        Self {
            recovery: arm.recovery,
            joints: arm.joints.iter().map(Driven::new).collect(),
            torques: Torques::new(arm),
            period: cycle.into(),
            end: Endpoint::new(end, &parts(arm, of_bus), arm.joints.len()),
            commanded: Nanos(0),
            last: None,
            powered: false,
            shutdown: None,
            held: false,
            withheld: false,
            returned: Return::None,
        }
    }

    /// Whether all drives are without power; at most [`takt_core::device::driver::SHUTDOWN_MAX`] after a shutdown request, unless
    /// a drive refuses.
    pub fn is_off(&self) -> bool {
        let mut joints = self.joints.iter();
        joints.all(|joint| joint.power() == Power::Off)
    }

    /// Starts or ends a hold: joints brake and hold their positions, and commands are ignored.
    pub const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// Starts or ends a hold by those who give it power: as [`Self::hold`], but no fault unless a net commands the arm.
    pub const fn withhold(&mut self, withheld: bool) {
        self.withheld = withheld;
    }

    /// Reports the figures of its bus with the next cycle.
    pub fn report_bus(&mut self, values: impl IntoIterator<Item = Option<f64>>) {
        let first = 2 * self.joints.len();
        self.end.report_figures(first, values);
    }

    /// The next event of a joint.
    pub fn poll_event(&mut self) -> Option<(usize, JointEvent)> {
        let mut joints = self.joints.iter_mut().enumerate();
        let event = joints.find_map(|(number, joint)| Some((number, joint.poll_event()?)));
        let torques = &mut self.torques;
        let event = event.or_else(|| {
            let (joint, cut) = torques.poll_cut()?;
            Some((joint, JointEvent::FeedForward(cut)))
        });
        event.or_else(|| Some((0, JointEvent::Load(torques.poll_heavy()?))))
    }

    fn follows(&self) -> bool {
        self.returned == Return::None && self.joints.iter().all(Driven::follows)
    }

    /// Notes whether its drives are away or returned.
    fn note_return(&mut self, now: Nanos) {
        let online = self.joints.iter().all(Driven::is_online);
        self.returned = match self.returned {
            Return::None if !online && self.end.reported.status == DeviceStatus::Operational => {
                Return::Away
            }
            Return::Away if online => Return::Since(now),
            Return::Since(_) if !online => Return::Away,
            Return::Since(since) if now - since >= Nanos::from(SETTLE) => Return::None,
            state @ (Return::None | Return::Away | Return::Since(_)) => state,
        };
    }

    /// Steps its drives by one cycle: `axis` commands the axis of a joint and returns its feedback.
    pub fn cycle(
        &mut self,
        tick: &Tick,
        stopping: bool,
        mut axis: impl FnMut(usize, Order) -> Option<Feedback>,
    ) {
        let now = tick.scheduled;
        self.end.take();
        let stopping =
            stopping || (self.recovery == Recovery::OnRestart && self.end.reported.faults > 0);
        let (goal, reset) = if stopping {
            (self.shutdown_goal(now), false)
        } else {
            self.shutdown = None;
            self.choose_goal(now)
        };
        let may_move = self.follows() && !stopping && !self.held && !self.withheld;
        let elapsed = self.last.replace(now).map_or(Nanos(0), |last| now - last);
        let when = When {
            now,
            elapsed_s: elapsed.as_secs_f64(),
            dt_s: if elapsed > Nanos(0) {
                self.period.as_secs_f64()
            } else {
                0.0
            },
            fresh: self.end.is_fresh(now, self.period),
        };
        let mut targets = [None; ARM_JOINTS_MAX];
        let mut motions = [[0.0; 3]; ARM_JOINTS_MAX];
        let joints = self.joints.iter_mut().zip(&self.end.taken.joints);
        let places = targets.iter_mut().zip(&mut motions);
        for ((driven, set_points), (target, motion)) in joints.zip(places) {
            *target = driven.aim(set_points, may_move, &when);
            *motion = driven.joint.motion().into();
        }
        let motions = motions.get(..self.joints.len()).unwrap_or_default();
        self.torques.expect(motions);
        for (number, (driven, target)) in self.joints.iter_mut().zip(targets).enumerate() {
            let goal = axis_goal(goal, driven.power(), driven.has_run_away());
            let order = Order {
                goal,
                reset,
                target,
                torque_offset: self.torques.offset(number, target.is_some(), when.dt_s),
            };
            let feedback = axis(number, order);
            let torque = feedback.filter(|it| it.online).and_then(|it| it.torque);
            self.torques.measure(number, torque);
            driven.take(feedback, target, &when);
        }
        let follows = targets.iter().take(motions.len()).all(Option::is_some);
        let is_steady = follows && motions.iter().all(|[.., rate]| rate.abs() < STEADY);
        self.torques.compare(motions, is_steady, when.dt_s);
        self.publish(tick);
    }

    /// The new goal of all drives, if it changes, and whether to reset their faults.
    fn choose_goal(&mut self, now: Nanos) -> (Option<Goal>, bool) {
        let commanded = self.end.is_commanded();
        if commanded {
            self.commanded = now;
        }
        let online = self.joints.iter().all(Driven::is_online);
        // Drives that recover do not move by themselves.
        self.powered &= online;
        let rested = now - self.commanded >= Nanos::from(REST);
        if self.joints.iter().any(Driven::has_run_away) {
            return (None, false);
        }
        if online && !self.powered && !commanded {
            self.powered = true;
            return (Some(Goal::OperationEnabled), false);
        }
        if rested && !self.follows() {
            self.commanded = now;
            self.powered = false;
            return (None, true);
        }
        (None, false)
    }

    /// The goal of all drives during shutdown.
    fn shutdown_goal(&mut self, now: Nanos) -> Option<Goal> {
        let is_at_rest = self.joints.iter().all(|joint| joint.is_at_rest(now));
        let has_torque = |joint: &Driven| joint.power() == Power::Drives;
        let has_torque = self.joints.iter().any(has_torque);
        let now = time_of(now);
        let shutdown = self.shutdown.get_or_insert_with(|| Shutdown::new(now));
        shutdown.step(is_at_rest, has_torque, now)
    }

    fn publish(&mut self, tick: &Tick) {
        self.note_return(tick.scheduled);
        let status = if self.follows() && !self.held && !self.withheld {
            DeviceStatus::Operational
        } else if self.joints.iter().all(Driven::is_online) {
            DeviceStatus::SafeOperational
        } else {
            DeviceStatus::Offline
        };
        if self.withheld && status == DeviceStatus::SafeOperational && !self.end.is_commanded() {
            self.end.reported.retire(status, tick.scheduled);
        } else {
            self.end.reported.enter(status, tick.scheduled);
        }
        self.end.report_joints(self.joints.iter().map(|driven| {
            let measured = driven.measured;
            let measured = [measured.map(|it| it[0]), measured.map(|it| it[1]), None];
            (&driven.joint, measured)
        }));
        for (reported, driven) in self.end.reported.joints.iter_mut().zip(&self.joints) {
            reported.error = driven.error(status) as i32;
        }
        let signals = &mut self.end.reported.signals;
        for (joint, place) in self
            .end
            .interfaces
            .torques
            .iter()
            .flat_map(|it| it.iter())
            .enumerate()
        {
            place.measured.report(signals, self.torques.measured(joint));
            place
                .estimated
                .report(signals, self.torques.estimated(joint));
        }
        let words = self.joints.iter().flat_map(Driven::words);
        self.end.report_figures(0, words);
        self.end.publish();
    }
}

/// Logs the quirks that the cell configures for the drives of a bus.
pub fn report_quirks<D>(driver: &str, arms: &[DriveArm<D>]) {
    for arm in arms {
        for (joint, of_joint) in arm.joints.iter().enumerate() {
            for quirk in &of_joint.quirks {
                let (arm, quirk) = (&arm.name, quirk.name());
                tracing::info!(driver, arm, joint, quirk, "drive quirk applied");
            }
        }
    }
}

/// The event text of an axis whose process data are proven.
pub fn proven(took: Duration, trusted: Objects) -> String {
    let took = took.as_millis();
    if trusted.is_empty() {
        format!("its process data are proven, in {took} ms")
    } else {
        format!(
            "its process data are proven, in {took} ms, but for {trusted}, taken on trust (`not_mirrored`)"
        )
    }
}

#[cfg(test)]
mod tests;
