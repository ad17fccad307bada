//! Couples emulated robots to a world that they share: arms post the poses of their flanges, grippers their fingers, a
//! mobile base where it is. Forces reach the controller over the wires of the real devices alone.

use std::time::Duration;

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use takt_devices::wsg::emulator::Surroundings as Grasping;
use takt_ethercat::emulator::DriveHandle;
use takt_ethercat::youbot::Mecanum;
use takt_fri::lwr::emulator::{Flange, Periphery, Screwdriver, Sensing, Surroundings};
use takt_fri::lwr::wire::Krl;
use takt_world::{Base, Fingers, Hand, Twist, World};

/// A late cycle turns a bit by at most this much time.
const LATE_MAX: Duration = Duration::from_millis(100);

/// The world of a cell, and which of its parts each emulated device moves.
#[derive(Debug, Clone)]
pub struct CellWorld {
    /// The world.
    pub world: World,
    /// Arms by device: where their base stands in the world, and the hands at their flange.
    pub arms: Vec<(String, Isometry3<f64>, Vec<String>)>,
    /// Grippers by device, and the hand whose fingers they move.
    pub grippers: Vec<(String, String)>,
    /// Arms whose controller drives the screwdriver of a hand: its first real output is the speed, rad/s, its first real input the
    /// torque, Nm.
    pub screwdrivers: Vec<(String, String)>,
    /// Arms whose controller reads the switch of a dock at a digital input, from 0.
    pub switches: Vec<(String, u32, String)>,
    /// The base of the world that the wheels of an emulated youBot move.
    pub base: Option<String>,
    /// How the arms' controllers estimate external forces.
    pub sensing: Sensing,
}

impl CellWorld {
    /// Hands of an arm; `None` if it is in no world.
    pub(crate) fn arm(&self, device: &str) -> Option<Mounted> {
        let (_, base, hands) = self.arms.iter().find(|(name, ..)| name == device)?;
        let hands = hands.iter().filter_map(|name| self.world.hand(name));
        Some(Mounted::new(*base, hands.collect()))
    }

    /// What is at the user variables of the controller of an arm.
    pub(crate) fn periphery(&self, device: &str) -> Vec<Box<dyn Periphery>> {
        let bits = self.screwdrivers.iter().filter(|(arm, _)| arm == device);
        let bits = bits.filter_map(|(_, hand)| self.world.screwdriver(hand));
        let bits = bits.map(|bit| Box::new(Driven::new(bit)) as Box<dyn Periphery>);
        let switches = self.switches.iter().filter(|(arm, ..)| arm == device);
        let switches = switches.map(|(_, input, dock)| {
            Box::new(Switch {
                world: self.world.clone(),
                dock: dock.clone(),
                input: *input,
            }) as Box<dyn Periphery>
        });
        bits.chain(switches).collect()
    }

    /// Fingers of a gripper, for its emulator; `None` if it is in no world.
    #[must_use]
    pub fn pads(&self, device: &str) -> Option<Box<dyn Grasping>> {
        let (_, hand) = self.grippers.iter().find(|(name, _)| name == device)?;
        let fingers = self.world.fingers(hand)?;
        Some(Box::new(Pads(fingers)))
    }

    /// The base that wheels move.
    pub(crate) fn base(&self) -> Option<Base> {
        self.world.base(self.base.as_deref()?)
    }
}

/// Hands of a world at the flange of an emulated arm.
#[derive(Debug)]
pub struct Mounted {
    base: Isometry3<f64>,
    hands: Vec<Hand>,
}

impl Mounted {
    /// Hands at the flange of an arm whose base stands there in the world.
    #[must_use]
    pub const fn new(base: Isometry3<f64>, hands: Vec<Hand>) -> Self {
        Self { base, hands }
    }
}

impl Surroundings for Mounted {
    fn wrench(&mut self, at: Duration, flange: &Flange) -> [f64; 6] {
        let axes = flange.axes.map(Vector3::from);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes));
        let turn = UnitQuaternion::from_rotation_matrix(&rotation);
        let pose = self.base * Isometry3::from_parts(Vector3::from(flange.position).into(), turn);
        let [x, y, z, a, b, c] = flange.velocity;
        let twist = Twist {
            linear: self.base.rotation * Vector3::new(x, y, z),
            angular: self.base.rotation * Vector3::new(a, b, c),
        };
        let back = self.base.rotation.inverse();
        let mut sum = [0.0; 6];
        for hand in &self.hands {
            let wrench = hand.post(at, &pose, &twist);
            let (force, torque) = (back * wrench.force, back * wrench.torque);
            let parts = force.iter().chain(torque.iter());
            for (sum, part) in sum.iter_mut().zip(parts) {
                *sum += part;
            }
        }
        sum
    }
}

/// Fingers of a world, moved by an emulated gripper.
#[derive(Debug)]
struct Pads(Fingers);

impl Grasping for Pads {
    fn part(&mut self, at: Duration, width_mm: f64, force_n: f64) -> Option<f64> {
        let stopped = self.0.post(at, width_mm / 1e3, force_n);
        stopped.width_m.map(|width| width * 1e3)
    }
}

/// The screwdriver of a hand, driven by the controller of its arm.
#[derive(Debug)]
struct Driven {
    bit: takt_world::Screwdriver,
    driver: Screwdriver,
    /// rad
    angle: f64,
    /// Nm
    torque: f64,
    last: Option<Duration>,
}

impl Driven {
    fn new(bit: takt_world::Screwdriver) -> Self {
        Self {
            bit,
            driver: Screwdriver::default(),
            angle: 0.0,
            torque: 0.0,
            last: None,
        }
    }
}

impl Periphery for Driven {
    fn exchange(&mut self, at: Duration, from_client: &Krl, to_client: &mut Krl) {
        let last = self.last.replace(at).unwrap_or(at);
        let span = at.saturating_sub(last).min(LATE_MAX);
        let [speed, ..] = from_client.real;
        self.angle += self.driver.step(speed.into(), self.torque, span);
        self.torque = self.bit.post(at, self.angle);
        #[expect(clippy::cast_possible_truncation, reason = "user variables are f32")]
        let torque = self.torque as f32;
        let [out, ..] = &mut to_client.real;
        *out = torque;
    }
}

/// The switch of a dock, at a digital input of the controller of an arm.
#[derive(Debug)]
struct Switch {
    world: World,
    dock: String,
    input: u32,
}

impl Periphery for Switch {
    fn exchange(&mut self, _at: Duration, _from_client: &Krl, to_client: &mut Krl) {
        let is_closed = self.world.docked(&self.dock).unwrap_or(false);
        to_client.set_bool(self.input, is_closed);
    }
}

/// The true pose of a base on emulated wheels.
#[derive(Debug)]
pub(crate) struct Wheeled {
    wheels: Vec<DriveHandle>,
    mecanum: Mecanum,
    angles: Option<[f64; 4]>,
    /// x and y, m, and heading, rad.
    pose: [f64; 3],
    base: Base,
}

impl Wheeled {
    /// It stands at `start` first: x and y, m, and heading, rad.
    pub(crate) fn new(wheels: Vec<DriveHandle>, base: Base, start: [f64; 3]) -> Self {
        Self {
            wheels,
            mecanum: Mecanum::default(),
            angles: None,
            pose: start,
            base,
        }
    }

    /// Posts where the wheels have brought it.
    pub(crate) fn follow(&mut self, now: Duration) {
        let mut wheels = self.wheels.iter();
        let angles = std::array::from_fn(|_| wheels.next().map_or(0.0, |it| it.lock().angle()));
        let last = self.angles.replace(angles).unwrap_or(angles);
        // Joints count against the sense of their motors.
        let turned = std::array::from_fn(|wheel| last[wheel] - angles[wheel]);
        roll(&mut self.pose, &self.mecanum, turned);
        let [x, y, heading] = self.pose;
        self.base.post(now, x, y, heading);
    }
}

/// Moves a pose on by turns of the wheels, rad, in the sense of their motors.
fn roll([x, y, heading]: &mut [f64; 3], mecanum: &Mecanum, turned: [f64; 4]) {
    let [forward, left, turn] = mecanum.velocity(turned);
    let (sin, cos) = (*heading + turn / 2.0).sin_cos();
    *x += cos * forward - sin * left;
    *y += sin * forward + cos * left;
    *heading += turn;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wheeled_base_rolls_as_commanded() {
        let (mecanum, mut pose) = (Mecanum::default(), [0.0; 3]);
        let mut drive = |velocity: [f64; 3], count: u32| {
            let turned = mecanum.rates(velocity).map(|rate| rate / 1000.0);
            (0..count).for_each(|_| roll(&mut pose, &mecanum, turned));
            pose
        };
        let [x, y, _] = drive([0.5, 0.0, 0.0], 1000);
        assert!((x - 0.5).abs() < 1e-9 && y.abs() < 1e-9);
        drive([0.0, 0.0, 0.5], 1000);
        let [x, y, heading] = drive([0.2, 0.1, 0.0], 1000);
        let (sin, cos) = 0.5_f64.sin_cos();
        assert!((heading - 0.5).abs() < 1e-9);
        assert!((x - (0.5 + cos * 0.2 - sin * 0.1)).abs() < 1e-9);
        assert!((y - (sin * 0.2 + cos * 0.1)).abs() < 1e-9);
    }
}
