//! Robot arms: what a program reads of them, and the motions that it requests.

use std::panic::Location;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::activity::Activity;
use crate::error::{Error, ErrorKind};
use crate::expression::{Condition, Number};
use crate::live::{JointGoal, JointVelocities, Live, SetPoint, Target, Twist};
use crate::motion::{
    AlongTrajectory, ArmDescription, ArmMotion, CartesianLimits, Centre, Follow, ForceLimits,
    Goals, Hold, Jog, JointTrajectory, Path, Press, Route, Stream,
};
use crate::moving::MovingFrame;
use crate::order::{Operation, Speed};
use crate::pose::Pose;
use crate::session::Session;
use crate::world::{Direction, Frame, Goal};

/// An arm of a cell. Clones are the same arm with speeds and limits of their own.
#[derive(Clone, Debug)]
pub struct Arm {
    session: Arc<Session>,
    description: ArmDescription,
    limits: CartesianLimits,
    force_limits: ForceLimits,
    speed: Speed,
    tool: Pose,
    base: Frame,
}

impl Arm {
    pub(crate) fn new(session: Arc<Session>, description: ArmDescription, base: Frame) -> Self {
        Self {
            session,
            description,
            limits: CartesianLimits::default(),
            force_limits: ForceLimits::default(),
            speed: Speed::FULL,
            tool: Pose::IDENTITY,
            base,
        }
    }

    /// What the controller knows about it.
    pub const fn description(&self) -> &ArmDescription {
        &self.description
    }

    /// The same arm, slower: the speed of its motions is multiplied by `factor`, above 0 to 1.
    #[must_use]
    pub fn with_speed(mut self, factor: f64) -> Self {
        self.speed = self.speed.times(factor);
        self
    }

    /// The same arm with these limits on lines and arcs.
    #[must_use]
    pub const fn with_limits(mut self, limits: CartesianLimits) -> Self {
        self.limits = limits;
        self
    }

    /// The same arm with these limits on motions under force.
    #[must_use]
    pub const fn with_force_limits(mut self, limits: ForceLimits) -> Self {
        self.force_limits = limits;
        self
    }

    /// Its limits on motions under force.
    pub const fn force_limits(&self) -> ForceLimits {
        self.force_limits
    }

    /// Its motion centre in the flange.
    pub(crate) const fn tool(&self) -> Pose {
        self.tool
    }

    /// Its limits on lines, arcs, curves and jogs.
    pub const fn limits(&self) -> CartesianLimits {
        self.limits
    }

    /// The same arm with another motion centre, given in the flange: poses of its motions and paths are those of the
    /// motion centre, such as the tip of a tool.
    #[must_use]
    pub fn with_tool(mut self, tool: impl Into<Pose>) -> Self {
        self.tool = tool.into();
        self
    }

    /// The same arm with its base at this pose in the world, which coupled arms share.
    #[must_use]
    pub fn with_base(mut self, base: impl Into<Pose>) -> Self {
        self.base = Frame::in_world(self.base.name().to_owned(), base.into());
        self
    }

    /// Its base in the world, where its cell file places it or [`Self::with_base`] did; of an arm that is placed nowhere the
    /// world's origin, and of an arm on something that moves its base there.
    pub const fn base(&self) -> Pose {
        self.base.placement()
    }

    /// Its base as a frame.
    pub const fn base_frame(&self) -> &Frame {
        &self.base
    }

    pub(crate) const fn session(&self) -> &Arc<Session> {
        &self.session
    }

    /// A motion to joint positions, rad: all joints start and arrive together.
    pub fn ptp(&self, to: impl Into<Vec<f64>>) -> Activity {
        self.motion(Ok(Path::Ptp(to.into())))
    }

    /// The same to the home position of the arm, [`ArmDescription::home`].
    pub fn home(&self) -> Activity {
        self.ptp(self.description.home.as_slice())
    }

    /// A motion of all joints together to a pose of the motion centre in the base of the arm, or in a frame: of all joint
    /// positions for it, those next to where the arm begins.
    pub fn ptp_to(&self, to: impl Into<Goal>) -> Activity {
        let hint = None;
        self.motion(self.goal(to).map(|to| Path::Pose { to, hint }))
    }

    /// The same to the joint positions next to a hint, rad.
    pub fn ptp_near(&self, to: impl Into<Goal>, hint: impl Into<Vec<f64>>) -> Activity {
        let hint = Some(hint.into());
        self.motion(self.goal(to).map(|to| Path::Pose { to, hint }))
    }

    /// A motion of the motion centre along a straight line to a pose in the base of the arm, or in a frame.
    pub fn lin(&self, to: impl Into<Goal>) -> Activity {
        self.motion(self.goal(to).map(|to| Path::Frame(Route::Line(to))))
    }

    /// A motion of the motion centre along the arc through `via` to `to`, both in the base of the arm, or in frames.
    pub fn circ(&self, via: impl Into<Goal>, to: impl Into<Goal>) -> Activity {
        let ends = self.goal(via).and_then(|via| Ok((via, self.goal(to)?)));
        self.motion(ends.map(|(via, to)| Path::Frame(Route::Arc { via, to })))
    }

    /// A motion of the motion centre along a smooth curve through 1 to 63 poses in the base of the arm,
    /// or in frames.
    pub fn spline<P: Into<Goal>>(&self, through: impl IntoIterator<Item = P>) -> Activity {
        let points = through.into_iter().map(|point| self.goal(point));
        let points: Result<Vec<_>, _> = points.collect();
        self.motion(points.map(|points| Path::Frame(Route::Spline(points))))
    }

    /// A motion of the joints through points at given times, as planners make them. It is checked against the limits of the joints
    /// before anything moves; factors of speed stretch its time, the [override of the cell](crate::Cell::set_override) does not
    /// concern it. With [`now`](Activity::now) it begins in motion: from what is commanded then, the joints are led to the first
    /// point that they can reach within their limits, without a jump of position, velocity or acceleration.
    ///
    /// It fails with [`ErrorKind::Unplanned`] if a limit is exceeded, at rest with [`ErrorKind::Deviation`] if a tolerance is, and
    /// with [`ErrorKind::Stale`] if the arm is elsewhere when it begins.
    pub fn trajectory(&self, trajectory: JointTrajectory) -> Activity {
        let along = AlongTrajectory {
            arm: self.description.clone(),
            trajectory,
        };
        Activity::new(&self.session, along, self.speed)
    }

    /// Brakes the arm within its limits and keeps it under command where it comes to rest, until another activity takes
    /// over or it is cancelled.
    pub fn hold(&self) -> Activity {
        let arm = self.description.clone();
        Activity::new(&self.session, Hold { arm }, self.speed)
    }

    /// Presses with a force, N, in a direction: the arm approaches until it touches something, and then moves as the missing
    /// force requires (admittance control), within [`ForceLimits`]; its orientation and its place aside stay. It is
    /// [`Outcome::Maintaining`](crate::Outcome::Maintaining) when the force is held, and goes on until a cancel, a condition
    /// or another activity. An arm that is in contact already holds the force without approach. The force is that of
    /// [`Self::force`], which the load of the tool must not be part of.
    ///
    /// It fails at rest: [`ErrorKind::ForceNotReached`] after `travel`, [`ErrorKind::ContactLost`], if the force is less than
    /// half of `touch` for 0.1 s, [`ErrorKind::ForceExceeded`] beyond `force_max`, [`ErrorKind::Unreachable`].
    /// [`ErrorKind::Unsupported`] if the arm does not know the force at its tool.
    pub fn press(&self, direction: impl Into<Direction>, force: f64) -> Activity {
        self.pressing(&direction.into(), force, None)
    }

    /// The same on the way to a pose in the base of the arm, or in a frame: the motion centre moves aside under force, along
    /// the shortest way within the [limits](Self::with_limits), and turns. The place of the pose along the direction does not
    /// matter: the force has it. It is [`Outcome::Maintaining`](crate::Outcome::Maintaining) at the pose, with the force held.
    pub fn press_to(
        &self,
        to: impl Into<Goal>,
        direction: impl Into<Direction>,
        force: f64,
    ) -> Activity {
        self.pressing(&direction.into(), force, Some(self.goal(to)))
    }

    fn pressing(
        &self,
        direction: &Direction,
        force: f64,
        to: Option<Result<Pose, ErrorKind>>,
    ) -> Activity {
        let press = Press {
            centre: self.moving_centre(),
            along: direction.within(&self.base),
            force,
            limits: self.force_limits,
            to,
        };
        Activity::new(&self.session, press, self.speed)
    }

    fn moving_centre(&self) -> Centre {
        Centre {
            arm: self.description.clone(),
            limits: self.limits,
            tool: self.tool,
        }
    }

    /// Follows a frame that moves: the motion centre is brought to it as fast as the [limits](Self::with_limits) of velocity
    /// and acceleration permit, and then moves with it. It is [`Outcome::Maintaining`](crate::Outcome::Maintaining) as long
    /// as it is within 1 mm and 0.01 rad, and goes on until a cancel, a condition or another activity. Where the arm cannot
    /// follow, it brakes on its path and fails with [`ErrorKind::Unreachable`] at rest, and where the place of the frame
    /// becomes unknown, with [`ErrorKind::DeviceFailed`].
    pub fn follow(&self, frame: &MovingFrame) -> Activity {
        let follow = Follow {
            centre: self.moving_centre(),
            frame: frame.clone(),
            base: self.base.clone(),
        };
        Activity::new(&self.session, follow, self.speed)
    }

    /// Jogging of the motion centre: it moves at the velocity that the program [sends](crate::LiveHandle::send), within the
    /// [limits](Self::with_limits) of velocity and acceleration, and brakes when the last one is older than 0.1 s: send at
    /// 20 Hz or more while a key is held. Where the arm cannot follow, it brakes on its path, and the activity fails. It
    /// begins in motion, too, and ends by a cancel. Speeds scale its velocity, not its acceleration.
    pub fn jog(&self) -> Live<Twist> {
        self.live(Jog::Centre(self.moving_centre()))
    }

    /// The same for velocities of the joints. A joint brakes before the end of its range and rests there.
    pub fn jog_joints(&self) -> Live<JointVelocities> {
        let arm = self.description.clone();
        self.live(Jog::Joints { arm })
    }

    /// A motion to joint positions that the program [sends](crate::LiveHandle::send), at 10 to 100 Hz or when it likes: every
    /// joint moves to its latest goal as fast as its limits allow, the others aside, and rests there. It begins in motion,
    /// too, and ends by a cancel.
    pub fn stream(&self) -> Live<JointGoal> {
        self.live(self.following(Goals::Joints))
    }

    /// The same for poses of the motion centre in the base of the arm: of all joint positions for a pose, those next to where
    /// the arm is. Between poses the motion is one of joints. Where the arm cannot reach a pose, it brakes, and the activity
    /// fails.
    pub fn stream_poses(&self) -> Live<Pose> {
        self.live(self.following(Goals::Poses(self.tool)))
    }

    fn following(&self, goals: Goals) -> Stream {
        let arm = self.description.clone();
        Stream { arm, goals }
    }

    fn live<T: SetPoint>(&self, operation: impl Operation + 'static) -> Live<T> {
        let target = Target {
            arm: self.description.clone(),
            limits: self.limits,
            tool: self.tool,
        };
        let activity = Activity::new(&self.session, operation, self.speed);
        Live::new(activity, target)
    }

    /// A goal in the base of the arm.
    fn goal(&self, goal: impl Into<Goal>) -> Result<Pose, ErrorKind> {
        goal.into().within(&self.base)
    }

    fn motion(&self, path: Result<Path, ErrorKind>) -> Activity {
        let motion = ArmMotion {
            arm: self.description.clone(),
            path,
            limits: self.limits,
            tool: self.tool,
        };
        Activity::new(&self.session, motion, self.speed)
    }

    /// Measured positions of the joints, rad.
    ///
    /// # Errors
    /// If the arm is offline, or the connection is lost.
    #[track_caller]
    pub fn positions(&self) -> Result<Vec<f64>, Error> {
        Ok(self.read("outMeasuredPosition")?)
    }

    /// Commanded positions of the joints, rad.
    ///
    /// # Errors
    /// If the arm is offline, or the connection is lost.
    #[track_caller]
    pub fn commanded(&self) -> Result<Vec<f64>, Error> {
        Ok(self.read("outCommandedPosition")?)
    }

    fn read(&self, port: &str) -> Result<Vec<f64>, ErrorKind> {
        let joints = self.session.joints(&self.description, port)?;
        joints.ok_or_else(|| self.unknown(&self.description.name))
    }

    fn unknown(&self, name: &str) -> ErrorKind {
        ErrorKind::DeviceFailed {
            device: name.to_owned(),
            cause:
                "its positions are not known\nhint: `takt run` and the page say why it is offline"
                    .to_owned(),
        }
    }

    /// The measured pose of the flange in the base of the arm.
    ///
    /// # Errors
    /// If the arm is offline or has no kinematics, or the connection is lost.
    #[track_caller]
    pub fn pose(&self) -> Result<Pose, Error> {
        let values = self.session.evaluate(&self.description.pose_reader())?;
        let pose = values.get("outpose").and_then(|text| Pose::read(text));
        Ok(pose.ok_or_else(|| self.unknown(&self.description.name))?)
    }

    /// Force and torque at the tool.
    pub fn force(&self) -> Force {
        Force(self.description.name.clone())
    }

    /// The measured position of a joint, rad, as an expression.
    pub fn joint(&self, axis: usize) -> Number {
        let parameters = vec![
            ("Robot", self.description.name.clone()),
            ("Axis", axis.to_string()),
        ];
        Number::sensor("RobotArm::JointMonitor", parameters, "outMeasuredPosition")
    }

    /// A digital input of the arm.
    pub fn input(&self, port: u32) -> Condition {
        Condition::input(&self.description.name, port)
    }

    /// Requests that what the arm does end, and everything that waits for it.
    pub fn cancel(&self) {
        self.session.cancel_device(&self.description.name);
    }

    /// Waits until the arm has done everything that was requested of it.
    ///
    /// # Errors
    /// If the connection is lost. How the activities ended is in their handles.
    #[track_caller]
    pub fn finish(&self) -> Result<(), Error> {
        Ok(self.session.wait_for_rest(&self.description.name)?)
    }

    /// The same, at most for `timeout`; `None` if the arm still has something to do.
    ///
    /// # Errors
    /// As [`Self::finish`].
    #[track_caller]
    pub fn finish_for(&self, timeout: Duration) -> Option<Result<(), Error>> {
        let until = Instant::now() + timeout;
        let name = &self.description.name;
        let rested = self.session.wait_for_rest_until(name, until)?;
        let place = Location::caller();
        Some(rested.map_err(|kind| Error { kind, place }))
    }
}

/// Force and torque at the tool of an arm, as its driver reports them.
#[derive(Clone, Debug)]
pub struct Force(String);

impl Force {
    fn number(&self, port: &'static str) -> Number {
        Number::sensor("KUKA::LWR::FMonitor", vec![("Robot", self.0.clone())], port)
    }

    /// Force along x, N.
    pub fn x(&self) -> Number {
        self.number("outTcpFx")
    }

    /// Force along y, N.
    pub fn y(&self) -> Number {
        self.number("outTcpFy")
    }

    /// Force along z, N.
    pub fn z(&self) -> Number {
        self.number("outTcpFz")
    }

    /// Torque about x, Nm.
    pub fn torque_x(&self) -> Number {
        self.number("outTcpTx")
    }

    /// Torque about y, Nm.
    pub fn torque_y(&self) -> Number {
        self.number("outTcpTy")
    }

    /// Torque about z, Nm.
    pub fn torque_z(&self) -> Number {
        self.number("outTcpTz")
    }
}
