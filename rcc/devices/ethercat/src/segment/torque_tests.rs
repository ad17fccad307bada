//! Feed-forward torques of an arm with a URDF on an emulated segment, in virtual time: six drives whose motors carry the links of the
//! arm, with gravity, inertia and a payload. What the drives miss of their set-points, and what the arm reports of its torques.

use takt_core::device::parts;
use takt_ethercat::emulator::{Segment, ServoConfig, ServoDrive};
use takt_motion::dynamics::{Down, Dynamics, Payload, Sample, weigh};
use takt_motion::urdf::read_arm;

use super::wire_tests::{Bench, config};
use super::*;
use takt_net::device::Layout;

const URDF: &str = "../../../examples/cells/ur5e.urdf";
/// Turns of a motor for one of its joint.
const GEAR: f64 = 100.0;
/// Rated torque of each motor, Nm.
const RATED: f64 = 3.0;
/// Increments of a motor in a turn.
const TURN: f64 = 4096.0;

fn cell(more: &str) -> EthercatConfig {
    config(&text(more))
}

fn text(more: &str) -> String {
    let joints: String = (0..6)
        .map(|axis| {
            format!(
                "[[ethercat.arm.joint]]\nslave = 'drives'\naxis = {axis}\nincrements_per_turn = {}\nrated_torque = {}\n\
                 velocity_max = 60\nacceleration_max = 120\nfollowing_error_max = 20\n",
                TURN * GEAR,
                RATED * GEAR
            )
        })
        .collect();
    format!(
        "cycle = '2ms'\n[[ethercat.slave]]\nname = 'drives'\nposition = 0\naxes = 6\n\
         [[ethercat.arm]]\nname = 'arm'\nmodel = 'urdf:{URDF}'\n{more}\n{joints}"
    )
}

/// Cycle of the segment, s.
const CYCLE_S: f64 = 2e-3;

/// The arm as it is: its drives, and the torques that its links take.
struct Plant {
    bench: Bench,
    drive: ServoDrive,
    links: Dynamics,
    /// Commanded speeds of the cycle before, rad/s.
    speeds: [f64; 6],
}

impl Plant {
    /// With that payload at its flange, whatever the cell says.
    fn new(config: &EthercatConfig, payload: Payload) -> Self {
        let links = read_arm(std::path::Path::new(URDF), None, None)
            .unwrap()
            .dynamics
            .unwrap();
        let mut servo = ServoConfig::with_axes(vec![Default::default(); 6]);
        for axis in &mut servo.axes {
            axis.quirks.missing_set_points = None;
            let motor = &mut axis.motor;
            (motor.negative_limit, motor.positive_limit) = (-1e4, 1e4);
            motor.stops = (-2e4, 2e4);
            motor.rated_torque = RATED;
            // Light rotors with little friction, neither of which is modelled: the links matter.
            (motor.inertia, motor.coulomb) = (2e-5, 1e-3);
        }
        let (slave, drive) = ServoDrive::slave(servo).unwrap();
        let bench = Bench::new(config, Segment::line([slave]), 0);
        Self {
            bench,
            drive,
            links: links.with_payload(&payload.body()),
            speeds: [0.0; 6],
        }
    }

    /// One cycle in which each motor carries what the links take.
    fn cycle(&mut self) {
        // Inertia by the commanded acceleration: by the measured one it would lag a cycle, and swing up.
        let commanded = self.bench.devices[0].state.read_with(|state| state.joints);
        let mut motions = [[0.0; 3]; 6];
        let joints = commanded.iter().zip(&mut self.speeds);
        for (axis, (motion, (joint, before))) in motions.iter_mut().zip(joints).enumerate() {
            let at = self.drive.axis(axis, |drive| drive.motor().position / GEAR);
            let speed = joint.commanded_velocity.unwrap_or(0.0);
            let rate = (speed - std::mem::replace(before, speed)) / CYCLE_S;
            *motion = [at.unwrap(), speed, rate];
        }
        let mut torques = [0.0; 6];
        self.links
            .torques(&motions, &Down::default().gravity(), &mut torques);
        for (axis, torque) in torques.into_iter().enumerate() {
            self.drive
                .axis(axis, |drive| drive.motor_mut().external = -torque / GEAR);
        }
        self.bench.cycle();
    }

    /// The largest following error (60F4h) of a swing of joints 1 and 2 there and back, and the largest offset (60B2h), per mille.
    fn swing(&mut self) -> (f64, i16) {
        let start = [1, 2].map(|joint| self.bench.position(joint));
        let (mut error, mut offset) = (0.0_f64, 0_i16);
        for n in 0..1500_u32 {
            let phase = f64::from(n) / 1500.0 * std::f64::consts::TAU;
            for (joint, from) in [1, 2].into_iter().zip(start) {
                self.bench.want(joint, from - 0.4 * (1.0 - phase.cos()), 1);
            }
            self.cycle();
            self.drive.dictionary(|objects| {
                let at = |index| takt_cia402::dictionary::Address::new(index, 0);
                let missed = objects.key::<i32>(at(0x68F4)).unwrap();
                error = error.max(f64::from(objects.get(missed)).abs());
                let sent = objects.key::<i16>(at(0x68B2)).unwrap();
                offset = offset.max(objects.get(sent).abs());
            });
        }
        (error, offset)
    }

    fn events(&mut self) -> Vec<String> {
        let arm = self.bench.units.arms.first_mut().unwrap();
        std::iter::from_fn(|| arm.poll_joint())
            .map(|(_, event)| event.to_string())
            .collect()
    }
}

const LOAD: &str = "payload = { mass = 3.0, centre_of_mass = [0, 0, 0.08] }";

fn load(mass: f64) -> Payload {
    Payload {
        mass,
        centre_of_mass: [0.0, 0.0, 0.08],
    }
}

#[test]
fn feed_forward_torque_lowers_following_error() {
    let errors = [LOAD.to_owned(), format!("feed_forward = 0.9\n{LOAD}")].map(|more| {
        let mut plant = Plant::new(&cell(&more), load(3.0));
        (0..500).for_each(|_| plant.cycle());
        let (error, offset) = plant.swing();
        assert_eq!(offset > 0, more.starts_with("feed"), "off by default");
        assert_eq!(plant.events(), Vec::<String>::new());
        error
    });
    let ratio = errors[1] / errors[0];
    println!(
        "following error {:.0} increments, with feed-forward {:.0}: ratio {ratio:.2}",
        errors[0], errors[1]
    );
    assert!(errors[0] > 3.0 && ratio < 0.6, "{errors:?}");
}

#[test]
fn feed_forward_torque_beyond_share_is_cut_off_and_reported_once() {
    // 2 % of 150 Nm are 3 Nm, of 300 Nm at 1000 per mille.
    let mut plant = Plant::new(&cell(&format!("feed_forward = 0.02\n{LOAD}")), load(3.0));
    (0..500).for_each(|_| plant.cycle());
    let (_, offset) = plant.swing();
    assert_eq!(offset, 10);
    let events = plant.events();
    let of_limit = events
        .iter()
        .filter(|it| it.contains("is cut off at 3.0 Nm\nhint: "));
    assert!((1..=3).contains(&of_limit.count()), "{events:?}");
}

#[test]
fn tool_masses_of_cell_count_as_load_of_arm() {
    let tool = "[[tool]]\nname = 'pen'\ndevice = 'arm'\nmass = 1.5\ncentre_of_mass = [0.1, 0, 0]\n";
    let config = config(&(text(LOAD) + tool));
    let load = config.arms[0].load();
    assert!((load.mass - 4.5).abs() < 1e-12);
    assert!((load.centre().x - 0.1 / 3.0).abs() < 1e-12);
    assert!((cell(LOAD).arms[0].load().mass - 3.0).abs() < 1e-12);
}

#[test]
fn payload_heavier_than_stated_is_reported() {
    for (mass, said) in [(3.2, None), (6.0, Some("kg more than its cell states"))] {
        let mut plant = Plant::new(&cell(LOAD), load(mass));
        (0..500).for_each(|_| plant.cycle());
        plant.swing();
        (0..1500).for_each(|_| plant.cycle());
        let events = plant.events();
        assert_eq!(
            events.len(),
            usize::from(said.is_some()),
            "{mass}: {events:?}"
        );
        if let Some(said) = said {
            assert!(
                events[0].contains(said) && events[0].contains("hint: "),
                "{events:?}"
            );
        }
    }
}

#[test]
fn external_torques_are_those_of_what_the_cell_does_not_state() {
    let config = cell(LOAD);
    let mut plant = Plant::new(&config, load(5.0));
    (0..500).for_each(|_| plant.cycle());
    let description = describe(&config).remove(0);
    let has = parts::lay(&description.parts, 6, &mut Layout::default());
    let torques = has.torques.unwrap();
    let mut samples = Vec::new();
    // Each joint but the first swings alone, slowly.
    for joint in 1..6 {
        let from = plant.bench.position(joint);
        for n in 0..2000_u32 {
            let phase = f64::from(n) / 2000.0 * std::f64::consts::TAU;
            plant.bench.want(joint, from + 0.5 * phase.sin(), 1);
            plant.cycle();
            let seen = plant.bench.devices[0].state.read_with(|state| {
                let joints = state.joints.iter().take(6);
                let motions =
                    joints.map(|it| Some([it.commanded_position?, it.commanded_velocity?, 0.0]));
                let exerted = torques.iter().map(|it| it.estimated.read(&state.signals));
                Some((
                    motions.collect::<Option<Vec<_>>>()?,
                    exerted.collect::<Option<Vec<f64>>>()?,
                ))
            });
            if n % 20 == 0
                && let Some((motions, exerted)) = seen
            {
                // What holds them is the opposite.
                let torques = exerted.into_iter().map(|torque| -torque).collect();
                samples.push(Sample { motions, torques });
            }
        }
    }
    let model = description.model.unlimited().unwrap();
    let found = weigh(&*model, None, &samples, &Down::default().gravity()).unwrap();
    assert!((found.mass - 2.0).abs() < 0.15, "{found:?}");
    let [x, y, z]: [f64; 3] = found.centre.into();
    assert!(x.hypot(y) < 0.02 && (z - 0.08).abs() < 0.02, "{found:?}");
}

/// What a cell with this in its arm, and this joint table, is refused for.
fn refused(from: &str, to: &str) -> String {
    let joint = |axis: u32| {
        format!(
            "[[ethercat.arm.joint]]\nslave = 'drives'\naxis = {axis}\nincrements_per_turn = 1000\nrated_torque = 50\n"
        )
    };
    let joints: String = (0..6).map(joint).collect();
    let text = format!(
        "[[ethercat]]\nname = 'segment'\ninterface = 'none'\n[[ethercat.slave]]\nname = 'drives'\nposition = 0\naxes = 6\n\
         [[ethercat.arm]]\nname = 'arm'\nmodel = 'urdf:{URDF}'\nfeed_forward = 0.5\n{joints}"
    );
    assert!(text.contains(from), "{from}");
    let kinds = [takt_core::cell::DriverKind::new::<EthercatConfig>(
        takt_core::cell::Section::Bus("ethercat"),
    )];
    let read = takt_core::CellConfig::parse(&text.replacen(from, to, 1), &kinds);
    read.unwrap_err().to_string()
}

#[test]
fn feed_forward_of_unfit_cell_is_refused_with_line() {
    let forward = "feed_forward = 0.5";
    for (from, to, said) in [
        (forward, "feed_forward = 1.5", "line 11, column 16"),
        (forward, "feed_forward = nan", "a share of NaN"),
        (
            forward,
            "feed_forward = 0.5\ndown = [0, 0, 0]",
            "is no direction\nhint: `down`",
        ),
        (
            forward,
            "feed_forward = 0.5\npayload = { mass = -1 }",
            "`mass` is -1; it must be 0 to 2000 kg",
        ),
        (
            forward,
            "feed_forward = 0.5\npayload = { mass = 1, centre_of_mass = [0, 0, 80] }",
            "each must be within 10 m",
        ),
        (
            forward,
            "feed_forward = 0.5\npayload = { mas = 1 }",
            "unknown field `mas`",
        ),
        (
            "rated_torque = 50\n",
            "",
            "joint 0: `feed_forward` needs `rated_torque`",
        ),
        (
            "rated_torque = 50\n",
            "rated_torque = 0\n",
            "joint 0: `rated_torque` is 0",
        ),
        (
            "model = 'urdf:../../../examples/cells/ur5e.urdf'",
            "model = ''",
            "line 8",
        ),
        (
            "axes = 6\n",
            "axes = 6\noutputs = [{ pdo = 0x1600, entries = [[0x6040, 0, 16], [0x607A, 0, 32]] }]\n",
            "axis 0 of an arm with `feed_forward` has no 60B2h:00; map it",
        ),
    ] {
        let error = refused(from, to);
        assert!(error.contains(said), "{to}: {said} is not in\n{error}");
    }
}
