//! Feed-forward torques of an arm with a URDF on an emulated CANopen network, in virtual time: six drives whose motors carry the links
//! of the arm, with gravity, inertia and a payload. What the drives miss of their set-points, and what the arm reports of its torques.

use takt_can::cia402::dictionary::Address;
use takt_core::device::parts;
use takt_core::{CellConfig, cell};
use takt_motion::dynamics::{Down, Dynamics, Payload};
use takt_motion::urdf::read_arm;
use takt_net::device::Layout;

use super::wire_tests::Bench;
use super::*;
use takt_core::device::SetPoint;

const URDF: &str = "../../../examples/cells/ur5e.urdf";
/// Turns of a motor for one of its joint.
const GEAR: f64 = 100.0;
/// Rated torque of each motor, Nm.
const RATED: f64 = 3.0;
const PAYLOAD: Payload = Payload {
    mass: 3.0,
    centre_of_mass: [0.0, 0.0, 0.08],
};

fn config(more: &str) -> CanopenConfig {
    let joint = |node: u32| {
        format!(
            "[[canopen.arm.joint]]\nnode = {node}\nincrements_per_turn = {}\nrated_torque = {}\nvelocity_max = 60\n\
             acceleration_max = 120\nfollowing_error_max = 20\n",
            4096.0 * GEAR,
            RATED * GEAR
        )
    };
    let joints: String = (1..=6).map(joint).collect();
    let text = format!(
        "[[canopen]]\nname = 'network'\ninterface = 'none'\ncycle = '2ms'\n[[canopen.arm]]\nname = 'arm'\nmodel = 'urdf:{URDF}'\n\
         payload = {{ mass = 3.0, centre_of_mass = [0, 0, 0.08] }}\n{more}\n{joints}"
    );
    let kinds = [cell::DriverKind::new::<CanopenConfig>(cell::Section::Bus(
        "canopen",
    ))];
    let cell = CellConfig::parse(&text, &kinds).unwrap();
    cell.of_kind::<CanopenConfig>().next().unwrap().clone()
}

/// Cycle of the network, s.
const CYCLE_S: f64 = 2e-3;

/// The arm as it is: its drives, and the torques that its links take.
struct Loaded {
    bench: Bench,
    links: Dynamics,
    /// Commanded speeds of the cycle before, rad/s.
    speeds: [f64; 6],
}

impl Loaded {
    fn new(config: &CanopenConfig) -> Self {
        let arm = read_arm(std::path::Path::new(URDF), None, None).unwrap();
        let bench = Bench::of(config, |axis| {
            let motor = &mut axis.motor;
            (motor.negative_limit, motor.positive_limit) = (-1e4, 1e4);
            motor.stops = (-2e4, 2e4);
            motor.rated_torque = RATED;
            // Light rotors with little friction, neither of which is modelled: the links matter.
            (motor.inertia, motor.coulomb) = (2e-5, 1e-3);
        });
        Self {
            bench,
            links: arm.dynamics.unwrap().with_payload(&PAYLOAD.body()),
            speeds: [0.0; 6],
        }
    }

    fn commanded(&mut self) -> [[f64; 3]; 6] {
        let joints = self.bench.joints();
        std::array::from_fn(|joint| {
            let it = joints[joint];
            [
                it.commanded_position,
                it.commanded_velocity,
                it.commanded_acceleration,
            ]
            .map(|value| value.unwrap_or(0.0))
        })
    }

    /// One cycle in which each motor carries what the links take.
    fn cycle(&mut self) {
        // Inertia by the commanded acceleration: by the measured one it would lag a cycle, and swing up.
        let mut motions = self.commanded();
        let joints = self.bench.nodes.iter().zip(&mut self.speeds);
        for (motion, (node, before)) in motions.iter_mut().zip(joints) {
            let axis = node.application().axis(0).unwrap();
            motion[0] = axis.motor().position / GEAR;
            motion[2] = (motion[1] - std::mem::replace(before, motion[1])) / CYCLE_S;
        }
        let mut torques = [0.0; 6];
        self.links
            .torques(&motions, &Down::default().gravity(), &mut torques);
        for (torque, node) in torques.into_iter().zip(&mut self.bench.nodes) {
            let axis = node.application_mut().axis_mut(0).unwrap();
            axis.motor_mut().external = -torque / GEAR;
        }
        self.bench.cycle();
    }

    /// An object of the drive of joint 1.
    fn object<const BYTES: usize>(&self, index: u16) -> [u8; BYTES] {
        let objects = self.bench.nodes[1].dictionary();
        let bytes = objects.bytes(Address::new(index, 0)).unwrap();
        bytes.try_into().unwrap()
    }

    /// The largest following error (60F4h) of a swing of joint 1 there and back, and the largest offset (60B2h), per mille.
    fn swing(&mut self) -> (i32, i16) {
        let [_, [start, ..], ..] = self.commanded();
        let (mut error, mut offset) = (0, 0);
        for n in 0..1500_u32 {
            let phase = f64::from(n) / 1500.0 * std::f64::consts::TAU;
            let time = self.bench.now + Nanos(2_000_000);
            let set_points = &mut self.bench.given.joints[1];
            set_points.period = Nanos(2_000_000);
            let position = start - 0.4 * (1.0 - phase.cos());
            set_points.advance(Some(SetPoint { time, position }));
            self.cycle();
            error = error.max(i32::from_le_bytes(self.object(0x60F4)).abs());
            offset = offset.max(i16::from_le_bytes(self.object(0x60B2)).abs());
        }
        (error, offset)
    }
}

#[test]
fn canopen_feed_forward_torque_lowers_following_error() {
    let errors = ["", "feed_forward = 0.9"].map(|more| {
        let mut loaded = Loaded::new(&config(more));
        (0..500).for_each(|_| loaded.cycle());
        let (error, offset) = loaded.swing();
        assert_eq!(offset > 0, !more.is_empty(), "off by default");
        f64::from(error)
    });
    let ratio = errors[1] / errors[0];
    println!(
        "following error {:.0} increments, with feed-forward {:.0}: ratio {ratio:.2}",
        errors[0], errors[1]
    );
    assert!(errors[0] > 3.0 && ratio < 0.6, "{errors:?}");
}

/// Without motion, the torque that a drive measures is that of the links, and nothing else acts on them.
#[test]
fn canopen_measured_torques_are_those_of_links() {
    let config = config("");
    let mut loaded = Loaded::new(&config);
    (0..1000).for_each(|_| loaded.cycle());
    let description = describe(&config).remove(0);
    let laid = parts::lay(&description.parts, 6, &mut Layout::default());
    let torques = laid.torques.unwrap();
    let signals = loaded.bench.signals();
    let mut expected = [0.0; 6];
    let motions = loaded.commanded();
    loaded
        .links
        .torques(&motions, &Down::default().gravity(), &mut expected);
    assert!(expected[1].abs() > 20.0, "it carries its links");
    for (joint, (it, expected)) in torques.iter().zip(expected).enumerate() {
        let measured = it.measured.read(&signals).unwrap();
        let estimated = it.estimated.read(&signals).unwrap();
        // Friction of the motors, 0.1 Nm at a joint, and the resolution of 6077h, 0.3 Nm.
        assert!((measured - expected).abs() < 0.8, "{joint}: {measured} Nm");
        assert!(estimated.abs() < 0.8, "{joint}: {estimated} Nm");
    }
}
