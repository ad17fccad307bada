//! The station of the assembly: its devices, places and values, how they move, and what is reported of the steps.

use std::error::Error;
use std::f64::consts::FRAC_1_SQRT_2 as HALF;
use std::time::{Duration, Instant};

use takt_api::{
    Activity, Arm, Base, CartesianLimits, Cell, Composite, Frame, Gripper, Handle, Io, Outcome,
    Pose, deg, together,
};

pub(crate) type Done<T = ()> = Result<T, Box<dyn Error>>;

/// Joints over the bench, tools down, elbows up: along the way of the boxes, no joint comes near its limits. The other arm has the
/// mirrored ones.
const READY: [f64; 7] = [30.0, -20.0, 0.0, 95.0, 0.0, -65.0, 120.0];
/// Orientations of a tool that points down, and along y of the world, forwards and backwards.
pub(super) const DOWN: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
pub(super) const FORTH: [f64; 4] = [-HALF, 0.0, 0.0, HALF];
pub(super) const BACK: [f64; 4] = [HALF, 0.0, 0.0, HALF];
/// From where the base starts to the dock, m, and where each box stands then and on the bench, x, m.
pub(super) const DOCK: f64 = -1.05;
pub(super) const BOXES: [[f64; 2]; 2] = [[0.82, 0.22], [1.07, 0.53]];
/// Half the distance of the grips of a box, m, and their height on the platform and on the bench.
pub(super) const GRIP: f64 = 0.175;
pub(super) const HEIGHTS: [f64; 2] = [0.14, 0.09];
/// Where the left hand holds the socket, where along y the right one is when the peg is seated, and its bit when the screw is.
pub(super) const HELD: [f64; 3] = [0.28, 0.13, 0.55];
pub(super) const SEATED: f64 = 0.065;
pub(super) const SCREWED: f64 = 0.087;
/// Where the magazine offers the screw, and where its place is from the peg, x and z, m, led a little beside: the soft arm turns under
/// its press, and the left hand yields to the weight.
pub(super) const SCREW: [f64; 3] = [0.3, -0.3, 0.06];
pub(super) const THREAD: [f64; 2] = [0.021_65, -0.000_45];
/// Height of the fingers when the workpiece stands on its peg, m.
pub(super) const STANDS: f64 = 0.086;
/// Contact, N: over the chamfer of the hole, more than sliding there takes, and in the hole, where only friction is left.
pub(super) const CONTACT: [f64; 2] = [8.0, 4.0];
/// Before its seat a peg is in its hole, jams, or stands on the face around the hole; it never comes so far beyond, m.
pub(super) const IN_HOLE: f64 = 0.024;
pub(super) const JAMMED: f64 = 0.003;
pub(super) const ON_FACE: f64 = 0.026;
pub(super) const BEYOND: f64 = 0.015;
/// Where a peg on the face is tried, x and z from the middle, m: more than the chamfer takes from one to the next.
pub(super) const AROUND: [[f64; 2]; 4] = [[0.002, 0.0], [-0.002, 0.0], [0.0, 0.002], [0.0, -0.002]];
/// Pressing the peg and the screw, N; torque, Nm, and speed, rad/s, of the driver, and how long it may take.
pub(super) const PRESS: f64 = 12.0;
pub(super) const TORQUE: f64 = 1.5;
pub(super) const DRIVER: f64 = 18.0;
pub(super) const SCREW_WITHIN: Duration = Duration::from_secs(12);
pub(super) const UNSCREWS: Duration = Duration::from_secs(1);
/// Grasping, N, at first and after a slip. A little lift, m, shows a slip: one arm carries so much more than the other, N, or both less
/// than a box weighs. Of a box of 1.4 kg, arms that both hold it carry parts that differ by up to 1 N, where one slips by 4.5 N.
pub(super) const GRASP: [f64; 2] = [38.0, 80.0];
pub(super) const LIFT: f64 = 0.012;
pub(super) const UNEVEN: f64 = 2.5;
pub(super) const WEIGHT: f64 = 11.0;
/// Speed of a box that both arms carry, m/s: faster, an elbow does not keep up where the box passes the bases.
pub(super) const CARRY: f64 = 0.16;
/// Where the bit of its screwdriver is, beside the fingers of the right arm, m, and how far both are before the flange.
pub(super) const BIT: f64 = 0.12;
const REACH: f64 = 0.16;

/// A step of the assembly.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    pub(crate) name: &'static str,
    pub(crate) duration: Duration,
}

/// What the program reports while it works.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Progress<'a> {
    /// A step begins.
    Begins(&'static str),
    /// It has ended well.
    Ended(&'a Step),
    /// What went wrong, and what is done about it.
    Note(&'static str),
}

/// The devices of the cell, and the steps so far.
pub(crate) struct Station<'r> {
    pub(super) cell: Cell,
    pub(super) world: Frame,
    pub(super) arms: [Arm; 2],
    pub(super) bit: Arm,
    pub(super) hands: [Gripper; 2],
    pub(super) base: Base,
    pub(super) driver: Io,
    pub(super) order: Order,
    report: &'r dyn Fn(Progress<'_>),
    pub(crate) steps: Vec<Step>,
}

/// How to assemble.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Order {
    /// Each motion ends at rest.
    pub(crate) is_stopping: bool,
    /// The boxes stand on the bench already.
    pub(crate) is_unloaded: bool,
}

impl<'r> Station<'r> {
    pub(crate) fn new(cell: &Cell, order: Order, report: &'r dyn Fn(Progress<'_>)) -> Done<Self> {
        let arm =
            |name, x| Ok::<_, takt_api::Error>(cell.arm(name)?.with_tool(Pose::xyz(x, 0.0, REACH)));
        Ok(Self {
            cell: cell.clone(),
            world: cell.frame("world")?,
            arms: [arm("left", 0.0)?, arm("right", 0.0)?],
            bit: arm("right", BIT)?,
            hands: [cell.gripper("left_hand")?, cell.gripper("right_hand")?],
            base: cell.base("base")?,
            driver: cell.io("right")?,
            order,
            report,
            steps: Vec::new(),
        })
    }

    /// What went wrong and what is done about it.
    pub(super) fn note(&self, text: &'static str) {
        (self.report)(Progress::Note(text));
    }

    pub(super) fn step(&mut self, name: &'static str, work: impl FnOnce(&Self) -> Done) -> Done {
        (self.report)(Progress::Begins(name));
        let began = Instant::now();
        work(self)?;
        let duration = began.elapsed();
        let step = Step { name, duration };
        (self.report)(Progress::Ended(&step));
        self.steps.push(step);
        Ok(())
    }

    /// A motion whose successor takes over before its end.
    pub(super) fn round(&self, motion: Activity) -> Activity {
        if self.order.is_stopping {
            motion
        } else {
            motion.blend(0.7)
        }
    }

    pub(super) fn lin(&self, arm: &Arm, at: [f64; 3], orientation: [f64; 4]) -> Activity {
        arm.lin(self.world.pose(Pose::quaternion(at, orientation)))
    }

    pub(super) fn both(&self, task: impl Fn(&Gripper) -> Activity) -> Composite {
        together(self.hands.each_ref().map(task))
    }

    /// Above a place, by the joints; the elbow stays up.
    pub(super) fn ptp(&self, arm: &Arm, at: [f64; 3]) -> Activity {
        let [_, side, _] = arm.base().position();
        arm.ptp_near(self.world.pose(Pose::quaternion(at, DOWN)), ready(side))
    }

    /// A motion to above a place, and a line down to it.
    pub(super) fn reach(&self, arm: &Arm, [x, y, z]: [f64; 3]) -> Composite {
        self.ptp(arm, [x, y, z + 0.12])
            .then(self.lin(arm, [x, y, z], DOWN))
    }

    /// Presses along y of the world.
    pub(super) fn press(&self, arm: &Arm, force: f64) -> Activity {
        arm.press(self.world.direction([0.0, 1.0, 0.0]), force)
    }

    /// Where a tool of an arm, `beside` its fingers, is measured along y of the world, m.
    pub(super) fn tip(&self, arm: &Arm, beside: f64) -> Done<f64> {
        let tool = Pose::xyz(beside, 0.0, REACH);
        let [_, y, _] = (arm.base() * arm.pose()? * tool).position();
        Ok(y)
    }
}

/// The joints of [`READY`] for the arm on that side of the bench, rad.
pub(super) fn ready(side: f64) -> Vec<f64> {
    let signs = [side, 1.0, side, 1.0, side, 1.0, side].map(f64::signum);
    let joints = READY.iter().zip(signs);
    joints.map(|(angle, sign)| deg(*angle) * sign).collect()
}

/// Limits of motions with another speed, m/s.
pub(super) fn limits(velocity: f64) -> CartesianLimits {
    CartesianLimits {
        velocity,
        ..CartesianLimits::default()
    }
}

/// Limits of motions that end in contact: they brake as hard as the joints can in that posture.
pub(super) fn contact_limits() -> CartesianLimits {
    CartesianLimits {
        acceleration: 1.5,
        jerk: 300.0,
        ..limits(0.05)
    }
}

/// Runs what is to be completed.
#[track_caller]
pub(super) fn perform(what: &str, activity: impl Into<Composite>) -> Done {
    expect(what, activity.into().run(), &Outcome::Completed)
}

/// Waits for what is to reach its goal, and to stay there.
#[track_caller]
pub(super) fn maintain(what: &str, begun: &Handle) -> Done {
    expect(what, begun.wait(), &Outcome::Maintaining)
}

/// Waits for what is to be completed.
#[track_caller]
pub(super) fn complete(what: &str, begun: &Handle) -> Done {
    expect(what, begun.wait(), &Outcome::Completed)
}

/// Ends the step.
pub(super) fn fail<T>(text: &str) -> Done<T> {
    Err(text.into())
}

fn expect(what: &str, ended: Result<Outcome, takt_api::Error>, wanted: &Outcome) -> Done {
    match ended {
        Ok(outcome) if outcome == *wanted => Ok(()),
        Ok(outcome) => Err(format!("{what}: {outcome:?}, not {wanted:?}").into()),
        Err(error) => Err(format!("{what}: {error}").into()),
    }
}
