//! The nets of `examples/nets`: each is without findings, moves an arm that follows it exactly, never
//! faster than it says, and ends at its goal. Drivers and their limits are tested elsewhere.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use takt_core::device::DeviceTable;
use takt_device_fri::lwr;
use takt_net::device::Kinematics;
use takt_net::{Devices as _, Frame, Image, Limits, LoadContext, Moment, Nanos, Plan, check};

const PERIOD: Duration = Duration::from_millis(1);
/// Where the nets in joint space start, rad.
const START: [f64; 7] = [
    0.0,
    0.523_598_775_598_298_8,
    0.0,
    -std::f64::consts::FRAC_PI_2,
    0.0,
    1.047_197_551_196_597_6,
    0.0,
];

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/nets")
}

/// An arm that is where it was commanded in the previous cycle.
struct Arm {
    plan: Plan,
    image: Image,
    moment: Moment,
    joints: [f64; 7],
}

impl Arm {
    fn new(net: &str, joints: [f64; 7]) -> Self {
        let text = std::fs::read_to_string(folder().join(net)).unwrap();
        let mut devices = DeviceTable::default();
        devices.add_arm(lwr::describe("left")).unwrap();
        let registry = takt_core::registry();
        let context = LoadContext {
            registry: &registry,
            devices: &devices,
            period: PERIOD,
            limits: Limits::default(),
        };
        let (plan, findings) = check(&text, &context)
            .map_err(|rejection| rejection.render(net, &text))
            .unwrap();
        assert_eq!(findings, [], "{net}");
        Self {
            plan,
            image: Image::default(),
            moment: Moment::default(),
            joints,
        }
    }

    /// One cycle; returns whether the net ends.
    fn cycle(&mut self) -> bool {
        self.moment.cycle += 1;
        self.moment.time = Nanos(self.moment.time.0 + 1_000_000);
        for (joint, position) in self.image.joints.iter().zip(self.joints) {
            let mut state = joint.state.get();
            let before = state.commanded_position.unwrap_or(position);
            state.commanded_velocity = Some((position - before) / PERIOD.as_secs_f64());
            state.commanded_position = Some(position);
            joint.state.set(state);
        }
        let is_over = self.plan.evaluate(&self.image, self.moment);
        for (joint, position) in self.image.joints.iter().zip(&mut self.joints) {
            let command = joint.command.get();
            if command.cycle == self.moment.cycle {
                let speed = (command.position - *position).abs() / PERIOD.as_secs_f64();
                assert!(speed < 1.05, "{speed} rad/s in cycle {}", self.moment.cycle);
                *position = command.position;
            }
        }
        is_over
    }

    /// Runs until the net ends; returns the number of cycles.
    fn run(&mut self) -> u64 {
        let is_over = (0..60_000).any(|_| self.cycle());
        assert!(is_over, "the arm is at {:?}", self.joints);
        self.moment.cycle
    }

    fn out(&self, key: &str) -> String {
        let mut words = vec![0; self.plan.outbox().words()];
        self.plan.export(&mut words);
        let mut text = String::new();
        let entry = self.plan.outbox().find(&format!("out{key}")).unwrap();
        entry.format(&words, &mut text);
        text
    }

    fn is_at(&self, degrees: [f64; 7]) -> bool {
        let pairs = self.joints.iter().zip(degrees);
        pairs
            .into_iter()
            .all(|(joint, degrees)| (joint - degrees.to_radians()).abs() < 1e-9)
    }
}

/// The geometry of the arm.
fn kinematics() -> Arc<dyn Kinematics> {
    let mut devices = DeviceTable::default();
    devices.add_arm(lwr::describe("left")).unwrap();
    devices.arm("left").unwrap().kinematics.unwrap()
}

/// The joints at which the flange of an LWR is at a position, with the tool down.
fn above(x: f64, y: f64, z: f64) -> [f64; 7] {
    let flange = Frame::from_parts(
        takt_net::Vector::new(x, y, z).into(),
        takt_net::Rotation::from_euler_angles(std::f64::consts::PI, 0.0, 0.0),
    );
    let mut joints = [0.0; 7];
    kinematics().inverse(&flange, &START, &mut joints).unwrap();
    joints
}

#[test]
fn every_example_net_is_run_here() {
    let mut nets: Vec<String> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".net"))
        .collect();
    nets.sort();
    assert_eq!(
        nets,
        ["circ.net", "lin.net", "otg.net", "ptp.net", "track.net"]
    );
}

#[test]
fn ptp_net_ends_at_its_goal() {
    let mut arm = Arm::new("ptp.net", START);
    let cycles = arm.run();
    assert!(
        arm.is_at([30.0, 45.0, 0.0, -60.0, 0.0, 75.0, -20.0]),
        "{:?}",
        arm.joints
    );
    assert_eq!(
        (arm.out("failed"), arm.out("progress")),
        ("false".to_owned(), "1".to_owned())
    );
    assert!((600..3000).contains(&cycles), "{cycles}");
}

#[test]
fn ptp_net_cancelled_rests_on_its_path() {
    let mut arm = Arm::new("ptp.net", START);
    for _ in 0..300 {
        assert!(!arm.cycle());
    }
    arm.moment.cancel = true;
    arm.run();
    let progress: f64 = arm.out("progress").parse().unwrap();
    assert!((0.05..0.95).contains(&progress), "{progress}");
    let expected = START[3] + progress * 30.0_f64.to_radians();
    assert!((arm.joints[3] - expected).abs() < 1e-9);
}

#[test]
fn lin_and_circ_nets_bring_flange_to_their_goal() {
    let start = above(0.4, 0.0, 0.6);
    let robot = kinematics();
    for (net, goal) in [("lin.net", [0.4, 0.2, 0.5]), ("circ.net", [0.4, 0.1, 0.6])] {
        let mut arm = Arm::new(net, start);
        arm.run();
        assert_eq!(
            (arm.out("failed"), arm.out("reach")),
            ("false".to_owned(), "0".to_owned())
        );
        let flange = robot.forward(&arm.joints).translation.vector;
        assert!(
            (flange - takt_net::Vector::from(goal)).norm() < 1e-9,
            "{net}: {flange}"
        );
    }
}

#[test]
fn track_net_follows_goals_until_cancelled() {
    let mut arm = Arm::new("track.net", START);
    for goal in [0.5, -0.3] {
        let mut words: Vec<u64> = arm.plan.inbox_words().collect();
        let entry = arm.plan.inbox().find("ingoal").unwrap();
        entry
            .write(&format!("[{goal},0,0,0,0,0,0]"), &mut words)
            .unwrap();
        arm.plan.import(&words);
        for _ in 0..4000 {
            assert!(!arm.cycle());
        }
        assert!((arm.joints[0] - goal).abs() < 1e-9 && arm.joints[3].abs() < 1e-9);
    }
    arm.moment.cancel = true;
    arm.run();
}

#[test]
fn otg_net_reaches_its_goal_from_anywhere() {
    let mut start = START;
    start[4] = -1.0;
    let mut arm = Arm::new("otg.net", start);
    for _ in 0..5000 {
        assert!(!arm.cycle());
    }
    assert!(
        (arm.joints[4] - 20.0_f64.to_radians()).abs() < 1e-6,
        "{}",
        arm.joints[4]
    );
    assert_eq!(arm.out("reached"), "true");
    arm.moment.cancel = true;
    assert!(arm.run() > 5000);
}
