//! The nets of `examples/nets`: each is without findings, moves an arm that follows it exactly, never
//! faster than it says, and ends at its goal. And lines whose joints are driven within their limits, as drivers do.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use takt_core::device::setpoint::Joint;
use takt_core::device::{DeviceTable, JointSetPoints, SetPoint};
use takt_device_fri::lwr;
use takt_net::device::Kinematics;
use takt_net::{
    Devices as _, Frame, Image, JointState, Limits, LoadContext, Moment, Nanos, Plan, check,
};

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

/// The joints in which a line was seen to turn its tool, rad, and how far the tool is before the flange, m.
const BESIDE: [f64; 7] = [0.7208, -0.3795, 0.0, 1.5367, -1.9386, -0.7857, 0.4991];
const TOOL: f64 = 0.16;

/// The net of a line to a pose of the tool, beyond what the joints can there.
fn line(to: &Frame) -> String {
    let (at, (c, b, a)) = (to.translation.vector, to.rotation.euler_angles());
    let mut text = String::new();
    let mut add = |line: String| text.push_str(&format!("  {line},\n"));
    add("none=Core::DoubleArray(Size='7')".to_owned());
    for value in ["Position", "Velocity", "Acceleration"] {
        let mut from = "none".to_owned();
        for joint in 0..7 {
            if value == "Position" {
                add(format!(
                    "now{joint}=RobotArm::JointMonitor(Robot='left', Axis='{joint}')"
                ));
            }
            let name = format!("{value}{joint}");
            add(format!(
                "{name}=Core::DoubleArraySet(inArray={from}.outArray, inValue=now{joint}.outCommanded{value}, \
                 Size='7', Index='{joint}')"
            ));
            from = name;
        }
    }
    let tool = |z: f64| format!("'{{pos:{{x:0,y:0,z:{z}}},rot:{{a:0,b:0,c:0}}}}'");
    let (there, back) = (tool(TOOL), tool(-TOOL));
    add(format!("tool=World::FrameValue(Value={there})"));
    add(format!("back=World::FrameValue(Value={back})"));
    add("flange=ArmKinematics::Kin(inJoints=Position6.outArray, Robot='left')".to_owned());
    add("from=World::FrameTransform(inFirst=flange.outFrame, inSecond=tool.outValue)".to_owned());
    add(format!(
        "rates=ArmKinematics::VelKin(inJoints=Position6.outArray, inVelocities=Velocity6.outArray, \
         inAccelerations=Acceleration6.outArray, Robot='left', Tool={there})"
    ));
    add(format!(
        "line=Motion::Lin(inFrom=from.outValue, inFromVelocity=rates.outTwist, inFromAcceleration=rates.outAcceleration, \
         To='{{pos:{{x:{},y:{},z:{}}},rot:{{a:{a},b:{b},c:{c}}}}}', Velocity='0.05', Acceleration='3', Jerk='300', \
         RotVelocity='0.5', RotAcceleration='2.5', RotJerk='25', Speed='1')",
        at.x, at.y, at.z
    ));
    add("to=World::FrameTransform(inFirst=line.outPosition, inSecond=back.outValue)".to_owned());
    add("joints=ArmKinematics::InvKin(inFrame=to.outValue, inHintJoints=Position6.outArray, Robot='left')".to_owned());
    for joint in 0..7 {
        add(format!(
            "goal{joint}=Core::DoubleArrayGet(inArray=joints.outJoints, Size='7', Index='{joint}')"
        ));
        add(format!(
            "joint{joint}=RobotArm::JointPosition(inPosition=goal{joint}.outValue, Robot='left', Axis='{joint}')"
        ));
    }
    format!("{{\n{text}  outTerminate=line.outDone\n}}")
}

/// An arm whose joints are led to their set-points within their limits.
struct Driven {
    image: Image,
    moment: Moment,
    joints: Vec<(Joint, JointSetPoints)>,
}

impl Driven {
    fn new(at: [f64; 7]) -> Self {
        let joint = |(limits, position)| {
            let (mut joint, none) = (Joint::new(limits), JointSetPoints::default());
            joint.rest_at(position, &none);
            (joint, none)
        };
        let limits = lwr::describe("left").limits.into_iter();
        let mut arm = Self {
            image: Image::default(),
            moment: Moment::default(),
            joints: limits.zip(at).map(joint).collect(),
        };
        arm.report();
        arm
    }

    fn report(&mut self) {
        for ((joint, _), place) in self.joints.iter().zip(&self.image.joints) {
            let (position, velocity, acceleration) = joint.continued();
            place.state.set(JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                ..JointState::default()
            });
        }
    }

    /// One cycle, of a net or of none; returns whether the net ends.
    fn cycle(&mut self, plan: Option<&mut Plan>) -> bool {
        self.moment.cycle += 1;
        self.moment.time = Nanos(self.moment.time.0 + 1_000_000);
        let (moment, dt_s) = (self.moment, PERIOD.as_secs_f64());
        let is_over = plan.is_some_and(|plan| plan.evaluate(&self.image, moment));
        for ((joint, set_points), place) in self.joints.iter_mut().zip(&self.image.joints) {
            let command = place.command.get();
            let (time, position) = (takt_core::Nanos(moment.time.0), command.position);
            let is_new = command.cycle == moment.cycle;
            set_points.period = PERIOD.into();
            set_points.advance(is_new.then_some(SetPoint { time, position }));
            joint.sample(set_points, true, time - joint.delay(set_points), dt_s);
        }
        self.report();
        is_over
    }

    fn tool(&self, robot: &dyn Kinematics) -> Frame {
        let joints: Vec<_> = self
            .joints
            .iter()
            .map(|(joint, _)| joint.motion().0)
            .collect();
        robot.forward(&joints) * Frame::translation(0.0, 0.0, TOOL)
    }
}

/// A line begins so many cycles after one that its driver still follows to its end, braking at the limits of its joints.
#[test]
fn line_begun_while_driver_still_brakes_stays_straight() {
    let robot = kinematics();
    let registry = takt_core::registry();
    let mut devices = DeviceTable::default();
    devices.add_arm(lwr::describe("left")).unwrap();
    let context = LoadContext {
        registry: &registry,
        devices: &devices,
        period: PERIOD,
        limits: Limits::default(),
    };
    for pause in 0..30 {
        let mut arm = Driven::new(BESIDE);
        let here = arm.tool(&*robot);
        let there = Frame::translation(-0.02, 0.0, 0.0) * here;
        let mut turned: f64 = 0.0;
        for to in [there, here] {
            let text = line(&to);
            let checked = check(&text, &context);
            let (mut plan, _) = checked
                .map_err(|rejection| rejection.render("line", &text))
                .unwrap();
            let is_over = (0..5_000).any(|_| {
                let ends = arm.cycle(Some(&mut plan));
                turned = turned.max(arm.tool(&*robot).rotation.angle_to(&here.rotation));
                ends
            });
            assert!(is_over, "after {pause} cycles");
            for _ in 0..pause {
                arm.cycle(None);
            }
        }
        assert!(turned < 0.003, "after {pause} cycles: {turned} rad");
    }
}
