//! Two arms assemble a workpiece. A mobile base brings two supply boxes; both arms lift each of them onto the bench as one. The left
//! arm fetches the socket, the right one the peg, and pushes it in until it feels the bottom; then it fetches a screw, and drives it
//! in under impedance control until the torque is reached. The program connects to nothing and prints nothing: its caller does.
//! The same in Python is `rcc/python/examples/assembly.py`.

use std::error::Error;
use std::f64::consts::FRAC_1_SQRT_2 as HALF;
use std::time::{Duration, Instant};

use takt_api::{
    Activity, Arm, Base, CartesianLimits, Cell, Composite, Control, Frame, Gripper, Handle, Io,
    Outcome, Pose, coupled, deg, together,
};

pub(crate) type Done<T = ()> = Result<T, Box<dyn Error>>;

/// Joints over the bench, tools down, elbows up: along the way of the boxes, no joint comes near its limits. The other arm has the
/// mirrored ones.
const READY: [f64; 7] = [30.0, -20.0, 0.0, 95.0, 0.0, -65.0, 120.0];
/// Orientations of a tool that points down, and along y of the world, forwards and backwards.
const DOWN: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
const FORTH: [f64; 4] = [-HALF, 0.0, 0.0, HALF];
const BACK: [f64; 4] = [HALF, 0.0, 0.0, HALF];
/// From where the base starts to the dock, m, and where each box stands then and on the bench, x, m.
const DOCK: f64 = -1.05;
const BOXES: [[f64; 2]; 2] = [[0.82, 0.22], [1.07, 0.53]];
/// Half the distance of the grips of a box, m, and their height on the platform and on the bench.
const GRIP: f64 = 0.175;
const HEIGHTS: [f64; 2] = [0.14, 0.09];
/// Where the fingers of the left arm hold the socket, where those of the right one are along y when the peg is seated, and where the
/// bit of its screwdriver is, beside them, when the screw is.
const HELD: [f64; 3] = [0.28, 0.13, 0.55];
const SEATED: f64 = 0.065;
const BIT: f64 = 0.12;
const SCREWED: f64 = 0.087;
/// Where the magazine offers the screw, and its place beside the peg, x, m.
const SCREW: [f64; 3] = [0.3, -0.3, 0.06];
const BESIDE: f64 = 0.022;
/// Contact, N: over the chamfer of the hole, more than sliding there takes, and in the hole, where only friction is left.
const CONTACT: [f64; 2] = [8.0, 4.0];
/// In the hole, before its seat, m; and beyond its seat, where the peg never comes.
const IN_HOLE: f64 = 0.024;
const BEYOND: f64 = 0.015;
/// A peg that stops farther before its seat has met the face around the hole, m. Where it is tried then, x and z from the middle, m:
/// more than the chamfer takes from one to the next.
const ON_FACE: f64 = 0.026;
const AROUND: [[f64; 2]; 4] = [[0.002, 0.0], [-0.002, 0.0], [0.0, 0.002], [0.0, -0.002]];
/// Pressing the peg and the screw, N; the torque of the screw, Nm, and the speed of the driver, rad/s.
const PRESS: [f64; 2] = [12.0, 12.0];
/// Stiffness of the arm that drives the screw, N/m and Nm/rad.
const STIFFNESS: [f64; 2] = [2000.0, 300.0];
/// The bit is led beside the place of the screw, x and z, m: pressed beside its flange, the soft arm turns, and the pads of the left
/// hand yield to the weight of the workpiece.
const LED: [f64; 2] = [-0.000_35, -0.000_45];
const TORQUE: f64 = 1.5;
const DRIVER: f64 = 18.0;
/// Grasping, N, at first and after a slip. A little lift, m, shows a slip: one arm carries so much more than the other, N, or both less
/// than a box weighs.
const GRASP: [f64; 2] = [40.0, 80.0];
const LIFT: f64 = 0.012;
const UNEVEN: f64 = 1.5;
const WEIGHT: f64 = 11.0;
/// Speed of a box that both arms carry, m/s: faster, an elbow does not keep up where the box passes the bases.
const CARRY: f64 = 0.16;
/// What stops this far before its seat jams, m.
const JAMMED: f64 = 0.003;
/// Height of the fingers when the workpiece stands on its peg, m.
const STANDS: f64 = 0.086;
/// How long driving the screw may take.
const SCREW_WITHIN: Duration = Duration::from_secs(10);

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
    cell: Cell,
    world: Frame,
    arms: [Arm; 2],
    bit: Arm,
    hands: [Gripper; 2],
    base: Base,
    driver: Io,
    order: Order,
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

/// Assembles one workpiece.
pub(crate) fn run(cell: &Cell, order: Order, report: &dyn Fn(Progress<'_>)) -> Done<Vec<Step>> {
    let mut station = Station::new(cell, order, report)?;
    station.home()?;
    station.work()?;
    Ok(station.steps)
}

impl<'r> Station<'r> {
    pub(crate) fn new(cell: &Cell, order: Order, report: &'r dyn Fn(Progress<'_>)) -> Done<Self> {
        let arm =
            |name, x| Ok::<_, takt_api::Error>(cell.arm(name)?.with_tool(Pose::xyz(x, 0.0, 0.16)));
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

    /// The first step: all devices at their places.
    pub(crate) fn home(&mut self) -> Done {
        self.step("start and dock", Self::start)
    }

    /// All others.
    pub(crate) fn work(&mut self) -> Done {
        let boxes = if self.order.is_unloaded {
            &[][..]
        } else {
            &BOXES
        };
        for &[from, to] in boxes {
            self.step("unload a box", |it| it.unload(from, to))?;
        }
        let home = self.base.go_to(Pose::IDENTITY).begin()?;
        self.step("fetch the parts", Self::fetch)?;
        self.step("insert the peg", Self::insert)?;
        self.step("drive the screw", Self::screw)?;
        self.step("deliver", Self::deliver)?;
        expect("the base goes home", &home.wait()?, &Outcome::Completed)
    }

    /// After a fault: the screwdriver rests, and the arms are stiff where they are. Hands keep what they hold.
    pub(crate) fn recover(&self) -> Done {
        perform("driver off", self.driver.set_analogue(0, 0.0))?;
        perform("stiff", self.bit.switch_to(Control::position()))
    }

    /// What went wrong and what is done about it.
    fn note(&self, text: &'static str) {
        (self.report)(Progress::Note(text));
    }

    fn step(&mut self, name: &'static str, work: impl FnOnce(&Self) -> Done) -> Done {
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
    fn round(&self, motion: Activity) -> Activity {
        if self.order.is_stopping {
            motion
        } else {
            motion.blend(0.7)
        }
    }

    fn lin(&self, arm: &Arm, at: [f64; 3], orientation: [f64; 4]) -> Activity {
        arm.lin(self.world.pose(Pose::quaternion(at, orientation)))
    }

    fn both(&self, task: impl Fn(&Gripper) -> Activity) -> Composite {
        together(self.hands.each_ref().map(task))
    }

    /// Above a place, by the joints; the elbow stays up.
    fn ptp(&self, arm: &Arm, at: [f64; 3]) -> Activity {
        let [_, side, _] = arm.base().position();
        arm.ptp_near(self.world.pose(Pose::quaternion(at, DOWN)), ready(side))
    }

    /// A motion to above a place, and a line down to it.
    fn reach(&self, arm: &Arm, [x, y, z]: [f64; 3]) -> Composite {
        self.ptp(arm, [x, y, z + 0.12])
            .then(self.lin(arm, [x, y, z], DOWN))
    }

    /// The base docks while the arms take their posture, and the hands open.
    fn start(&self) -> Done {
        let [left, right] = &self.arms;
        let [a, b] = &self.hands;
        let dock = |x| self.base.go_to(Pose::xyz(x, 0.0, 0.0));
        let here = [
            left.ptp(ready(1.0)),
            right.ptp(ready(-1.0)),
            a.open(),
            b.open(),
        ];
        if self.order.is_unloaded {
            return perform("start", together(here));
        }
        perform("start", together(here.into_iter().chain([dock(DOCK)])))?;
        let is_docked = left.input(0);
        if !self.cell.holds(&is_docked)? {
            self.note("the base docks beside its place: it docks again");
            perform("dock again", dock(DOCK + 0.1).then(dock(DOCK)))?;
        }
        if !self.cell.holds(&is_docked)? {
            let text = "the base docks beside its place twice, the boxes stay on it\nhint: clear the dock and the wheels";
            return Err(text.into());
        }
        Ok(())
    }

    /// Both arms lift a box from the platform onto the bench: from its grasp on as one.
    fn unload(&self, from: f64, to: f64) -> Done {
        let [left, right] = &self.arms;
        let at = |arm, y, z| self.lin(arm, [from, y, z], DOWN);
        let [platform, bench] = HEIGHTS;
        let above = |arm: &Arm, y| self.ptp(arm, [from, y, platform + 0.12]);
        let above = together([above(left, GRIP), above(right, -GRIP)]);
        let down = together([at(left, GRIP, platform), at(right, -GRIP, platform)]);
        perform("reach the box", above.then(down))?;
        self.carry(from, to)?;
        perform("release the box", self.both(|hand| hand.move_to(0.04)))?;
        let back = |arm, y| self.lin(arm, [to, y, bench + 0.15], DOWN);
        let back = [back(left, GRIP), back(right, -GRIP)];
        perform("leave the box", together(back))?;
        Ok(())
    }

    /// Grasps a box with both hands, and carries it; where a hand slips, the box is set down, and grasped harder.
    fn carry(&self, from: f64, to: f64) -> Done {
        let [platform, bench] = HEIGHTS;
        let place = |x, z| Pose::quaternion([x, 0.0, z], DOWN);
        let [left, right] = self.arms.each_ref().map(|arm| arm.force().z());
        let is_carried = (left.clone() + right.clone()).under(-WEIGHT);
        let slips = (left - right).abs().over(UNEVEN);
        for force in GRASP {
            perform("grasp the box", self.both(|hand| hand.grasp(0.01, force)))?;
            let load = coupled(place(from, platform), &self.arms)?.with_limits(limits(CARRY));
            let lift = load.lin(place(from, platform + LIFT)).speed(0.3);
            perform("lift the box", lift)?;
            if self.cell.holds(&slips)? || !self.cell.holds(&is_carried)? {
                perform("set the box down", load.lin(place(from, platform)))?;
                perform("release the box", self.both(|hand| hand.move_to(0.04)))?;
                self.note("a hand slips: the box is set down and grasped harder");
                continue;
            }
            let up = self.round(load.lin(place(from, platform + 0.2)));
            let across = self.round(load.lin(place(to, bench + 0.27)));
            let down = load.lin(place(to, bench));
            return perform("carry the box", up.then(across).then(down));
        }
        Err("a hand slips at its largest force, the box stays on the platform\nhint: clean the pads".into())
    }

    /// The left arm fetches the socket, the right one the peg.
    fn fetch(&self) -> Done {
        let ([left, right], [[_, pegs], [_, sockets]]) = (&self.arms, BOXES);
        let [a, b] = &self.hands;
        perform("open", together([a.move_to(0.08), b.move_to(0.05)]))?;
        // The right arm comes over the boxes when the left one leaves them.
        let mut leaves = None;
        for (arm, hand, at, width, missing) in [
            (left, a, [sockets, 0.0, 0.06], 0.06, "box 2 has no socket"),
            (right, b, [pegs, 0.0, 0.1], 0.03, "box 1 has no peg"),
        ] {
            perform("reach the part", self.reach(arm, at))?;
            if let Err(error) = perform("grasp the part", hand.grasp(width, GRASP[1])) {
                let [x, y, z] = at;
                perform("leave the box", self.lin(arm, [x, y, z + 0.2], DOWN))?;
                let text = "fill the box, and assemble again; the other hand keeps what it holds";
                return Err(format!("{missing}: {error}\nhint: {text}").into());
            }
            let [x, y, z] = at;
            let [_, beside, _] = arm.base().position();
            let up = self.round(self.lin(arm, [x, y, z + 0.2], DOWN));
            let clear = self.lin(arm, [x, y + 0.25 * beside.signum(), z + 0.3], DOWN);
            let lift = up.then(clear).begin()?;
            if let Some(last) = leaves.replace(lift) {
                expect("lift the part", &last.wait()?, &Outcome::Completed)?;
            }
        }
        if let Some(last) = leaves {
            expect("lift the part", &last.wait()?, &Outcome::Completed)?;
        }
        let [x, _, z] = HELD;
        let hold = self.lin(left, HELD, BACK);
        let before = self.lin(right, [x, SEATED - 0.15, z], FORTH);
        perform("meet", together([hold, before]))?;
        Ok(())
    }

    /// The right arm inserts the peg until it feels the bottom, and presses.
    fn insert(&self) -> Done {
        let right = &self.arms[1];
        let [x, _, z] = HELD;
        let at = |arm: &Arm, [a, b]: [f64; 2], y| self.lin(arm, [x + a, y, z + b], FORTH);
        let mut place = [0.0; 2];
        perform("approach", self.round(at(right, place, SEATED - 0.04)))?;
        let slow = right.clone().with_limits(CartesianLimits {
            acceleration: 3.0,
            jerk: 300.0,
            ..limits(0.05)
        });
        let (mut others, mut jams) = (AROUND.into_iter(), 0);
        loop {
            let contact = CONTACT.map(|force| (-right.force().x()).over(force));
            let [mouth, bottom] = contact;
            let enter = at(&slow, place, SEATED - IN_HOLE).until("mouth", mouth);
            let insert = at(&slow, place, SEATED + BEYOND).until("contact", bottom);
            let entered = self.round(enter).begin()?;
            let outcome = insert.run()?;
            entered.wait_to_end()?;
            let left = SEATED - self.tip(right, 0.0)?;
            if !outcome.is_stopped_by("contact") {
                return Err(
                    "there is no socket before the peg\nhint: does the left hand hold it?".into(),
                );
            }
            if left < JAMMED {
                break;
            }
            perform("draw the peg back", at(&slow, place, SEATED - 0.04))?;
            if left > ON_FACE {
                if others.len() == AROUND.len() {
                    self.note("the peg meets the face beside the hole: it is tried around it");
                }
                let text = "the peg does not find the hole; both hands keep their parts\nhint: put peg and socket into their places";
                place = others.next().ok_or(text)?;
                continue;
            }
            if jams > 0 {
                let left = left * 1e3;
                return Err(format!("the peg jams {left:.1} mm before its seat, twice; both hands hold their parts\nhint: remove burrs, or replace the parts").into());
            }
            jams += 1;
            self.note("the peg jams: it is drawn back, and inserted again");
        }
        let press = right.press(self.world.direction([0.0, 1.0, 0.0]), PRESS[0]);
        expect("press the peg", &press.run()?, &Outcome::Maintaining)?;
        // Else the contact is lost when the fingers open.
        expect("hold", &right.hold().run()?, &Outcome::Maintaining)?;
        perform("release the peg", self.hands[1].move_to(0.05))?;
        perform("leave the peg", at(right, place, SEATED - 0.2))?;
        Ok(())
    }

    /// The right arm fetches a screw, and drives it in under impedance control.
    fn screw(&self) -> Done {
        let [x, _, z] = HELD;
        let [sx, sy, sz] = SCREW;
        let bit = &self.bit;
        perform("fetch a screw", self.reach(bit, SCREW))?;
        perform("take the screw", self.lin(bit, [sx, sy, sz + 0.19], DOWN))?;
        let (beside, z) = (x + BESIDE + LED[0], z + LED[1]);
        let before = Pose::quaternion([beside, SEATED - 0.02, z], FORTH);
        perform("turn", bit.ptp_to(self.world.pose(before)))?;
        let [along, about] = STIFFNESS;
        let soft = Control::cartesian([along, along, along, about, about, about], [0.7; 6]);
        perform("impedance", bit.switch_to(soft))?;
        let torque = self.driver.analogue_input(0)?;
        let driven = |speed| self.driver.set_analogue(0, speed);
        for attempt in 0..2 {
            let press = bit.press(self.world.direction([0.0, 1.0, 0.0]), PRESS[1]);
            let press = press.until("tight", torque.clone().over(TORQUE)).begin()?;
            expect("press the screw", &press.wait()?, &Outcome::Maintaining)?;
            perform("driver on", driven(DRIVER))?;
            let ended = press.wait_to_end_for(SCREW_WITHIN);
            perform("driver off", driven(0.0))?;
            let ended = match ended {
                Some(ended) => {
                    let ended = ended?;
                    expect(
                        "drive the screw",
                        &ended,
                        &Outcome::Stopped("tight".to_owned()),
                    )?;
                    ended
                }
                None => self.stop_pressing(&press, attempt)?,
            };
            if !ended.is_stopped_by("tight") {
                let back = self.lin(bit, [beside, SEATED - 0.02, z], FORTH);
                perform("draw the screw back", back)?;
                self.note("the screw does not bite: it is drawn back, and pressed again");
                continue;
            }
            let left = SCREWED - self.tip(bit, BIT)?;
            if left < JAMMED {
                break;
            }
            perform("driver back", driven(-DRIVER))?;
            std::thread::sleep(Duration::from_secs(1));
            perform("driver off", driven(0.0))?;
            if attempt > 0 {
                let left = left * 1e3;
                return Err(format!("the screw is tight {left:.1} mm before its seat, twice: it was turned back\nhint: replace screw and socket").into());
            }
            self.note("the screw is tight before its seat: it is turned back, and driven again");
        }
        let away = self.lin(bit, [beside, SEATED - 0.15, z], FORTH);
        perform("leave the screw", away)?;
        perform("stiff", bit.switch_to(Control::position()))?;
        Ok(())
    }

    /// Ends a press under which the screw did not become tight; the second one ends the assembly.
    fn stop_pressing(&self, press: &Handle, attempt: usize) -> Done<Outcome> {
        let force = self.cell.value(&-self.bit.force().x())?;
        press.cancel();
        // A force that was held is completed by its end; or the screw has become tight meanwhile.
        let ended = press.wait_to_end()?;
        if attempt == 0 || ended.is_stopped_by("tight") {
            return Ok(ended);
        }
        let (force, left) = (
            force.unwrap_or(f64::NAN),
            (SCREWED - self.tip(&self.bit, BIT)?) * 1e3,
        );
        Err(format!(
            "the screw does not reach {TORQUE} Nm, twice: {left:.1} mm before its seat, pressed with {force:.1} N\nhint: is there one \
             at the bit?"
        )
        .into())
    }

    /// The left arm puts the workpiece into the second box; both arms go back.
    fn deliver(&self) -> Done {
        let ([left, _], [_, [_, x]]) = (&self.arms, BOXES);
        let over = self.round(self.lin(left, [x, 0.15, 0.36], DOWN));
        let place = over.then(self.reach(left, [x, 0.0, STANDS]));
        perform("place the workpiece", place)?;
        perform("release the workpiece", self.hands[0].move_to(0.08))?;
        perform("leave the workpiece", self.lin(left, [x, 0.0, 0.36], DOWN))?;
        Ok(())
    }

    /// Where a tool of an arm, `beside` its fingers, is measured along y of the world, m.
    fn tip(&self, arm: &Arm, beside: f64) -> Done<f64> {
        let tool = Pose::xyz(beside, 0.0, 0.16);
        let [_, y, _] = (arm.base() * arm.pose()? * tool).position();
        Ok(y)
    }
}

/// The joints of [`READY`] for the arm on that side of the bench, rad.
fn ready(side: f64) -> Vec<f64> {
    let signs = [side, 1.0, side, 1.0, side, 1.0, side].map(f64::signum);
    let joints = READY.iter().zip(signs);
    joints.map(|(angle, sign)| deg(*angle) * sign).collect()
}

/// Limits of motions with another speed, m/s.
fn limits(velocity: f64) -> CartesianLimits {
    CartesianLimits {
        velocity,
        ..CartesianLimits::default()
    }
}

/// Runs what is to be completed.
fn perform(what: &str, activity: impl Into<Composite>) -> Done {
    let run = activity.into().run();
    let outcome = run.map_err(|error| format!("{what}: {error}"))?;
    expect(what, &outcome, &Outcome::Completed)
}

fn expect(what: &str, outcome: &Outcome, wanted: &Outcome) -> Done {
    if outcome == wanted {
        return Ok(());
    }
    Err(format!("{what}: {outcome:?}, not {wanted:?}").into())
}
