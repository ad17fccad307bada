//! Control modes of arms that can give way: stiff positions, or springs at the joints or at the tool (impedance control).
//! A mode stays until the arm switches to another one; motions and holds run in it.

use crate::activity::Activity;
use crate::arm::Arm;
use crate::engine::Failure;
use crate::error::ErrorKind;
use crate::motion::ArmDescription;
use crate::net::{Net, Port};
use crate::order::{Operation, Ports, Requests, Speed};

/// Longest time until an arm has come to rest, s, and until it has switched.
const REST_MAX_S: f64 = 10.0;
const SWITCH_MAX_S: f64 = 20.0;
/// An arm rests if no joint is farther than this from its mean, rad, over this time, s, for as long as the last, s. One that was a
/// spring settles for seconds.
const REST: f64 = 1e-4;
const REST_MEAN_S: f64 = 0.3;
const REST_S: f64 = 0.15;
/// How long it follows again before it counts as switched, s.
const STEADY_S: f64 = 0.1;
/// How long the answer to a stiffness may be an error while the mode changes, s.
const ANSWER_S: f64 = 3.0;
/// Largest stiffness of a joint, Nm/rad, and of the tool, N/m and Nm/rad.
const STIFFNESS_MAX: [f64; 2] = [5_000.0, 10_000.0];

/// How an arm is controlled.
#[derive(Clone, Debug, PartialEq)]
pub struct Control(Mode);

#[derive(Clone, Debug, PartialEq)]
enum Mode {
    Position,
    /// Stiffness (Nm/rad) and damping ratio of each joint.
    Joints(Vec<f64>, Vec<f64>),
    /// Stiffness (N/m, Nm/rad) and damping ratio along x, y, z and about x, y, z.
    Cartesian([f64; 6], [f64; 6]),
}

impl Control {
    /// The arm follows positions, whatever pushes it.
    pub const fn position() -> Self {
        Self(Mode::Position)
    }

    /// Springs at the joints: stiffness from 0 to 5000 Nm/rad, and damping ratio from 0 to 1, one for each joint.
    pub fn joints(stiffness: impl Into<Vec<f64>>, damping: impl Into<Vec<f64>>) -> Self {
        Self(Mode::Joints(stiffness.into(), damping.into()))
    }

    /// Springs at the tool: stiffness along x, y and z, N/m, and about x, y and z, Nm/rad, from 0 to 10,000, and damping ratio
    /// from 0 to 1. The axes are those that the robot's program selects.
    pub const fn cartesian(stiffness: [f64; 6], damping: [f64; 6]) -> Self {
        Self(Mode::Cartesian(stiffness, damping))
    }

    /// Number of the strategy, as primitives have it.
    const fn strategy(&self) -> usize {
        match self.0 {
            Mode::Position => 1,
            Mode::Cartesian(..) => 2,
            Mode::Joints(..) => 3,
        }
    }

    /// Interface that an arm needs for it, and what it is called.
    const fn needs(&self) -> (&'static str, &'static str) {
        match self.0 {
            Mode::Position => ("strategy", "a choice of its control mode"),
            Mode::Cartesian(..) => ("cartesianimpedance", "Cartesian impedance"),
            Mode::Joints(..) => ("jointimpedance", "joint impedance"),
        }
    }

    /// Its parameters by name, with the largest of each.
    fn parameters(&self) -> [(&'static str, &[f64], f64); 2] {
        let [joint, tool] = STIFFNESS_MAX;
        let (stiffness, damping, most): (&[f64], &[f64], f64) = match &self.0 {
            Mode::Position => (&[], &[], 0.0),
            Mode::Joints(stiffness, damping) => (stiffness, damping, joint),
            Mode::Cartesian(stiffness, damping) => (stiffness, damping, tool),
        };
        [("stiffness", stiffness, most), ("damping", damping, 1.0)]
    }

    fn check(&self, arm: &ArmDescription) -> Result<(), ErrorKind> {
        let (name, joints) = (&arm.name, arm.joints.len());
        for (what, values, most) in self.parameters() {
            if matches!(self.0, Mode::Joints(..)) && values.len() != joints {
                let text = format!(
                    "{name} has {joints} joints, not {}\nhint: one {what} for each joint, from the base",
                    values.len()
                );
                return Err(ErrorKind::Invalid(text));
            }
            if let Some(wrong) = values.iter().find(|value| !(0.0..=most).contains(*value)) {
                let text = format!("{name}: the {what} is {wrong}; it is from 0 to {most}");
                return Err(ErrorKind::Invalid(text));
            }
        }
        let (interface, wanted) = self.needs();
        arm.needs("strategy", "a choice of its control mode")?;
        arm.needs(interface, wanted)
    }
}

impl Arm {
    /// Switches how the arm is controlled, as soon as it rests. It must be where it is commanded. Some arms leave command mode for
    /// that and come back: completed when the arm follows again. The mode stays until the arm switches again.
    pub fn switch_to(&self, control: Control) -> Activity {
        let arm = self.description().clone();
        Activity::new(self.session(), Switch { arm, control }, Speed::FULL)
    }
}

/// A change of the control mode.
#[derive(Clone, Debug)]
struct Switch {
    arm: ArmDescription,
    control: Control,
}

impl Switch {
    /// Whether the arm has come to rest; true from then on.
    fn rests(&self, net: &mut Net) -> Port {
        let is_moving = (0..self.arm.joints.len()).map(|axis| {
            let monitor = [
                ("Robot", self.arm.name.as_str().into()),
                ("Axis", axis.into()),
            ];
            let monitor = net.add("RobotArm::JointMonitor", monitor);
            let position = monitor.out("outMeasuredPosition");
            let mean = [
                ("inValue", (&position).into()),
                ("Duration", REST_MEAN_S.into()),
            ];
            let mean = net.add("Core::DoubleAverage", mean).out("outValue");
            let apart = net.of_two("Core::DoubleSubtract", &position, &mean);
            net.is_beyond(&apart, REST)
        });
        let is_moving: Vec<_> = is_moving.collect();
        let never = [("Value", "false".into())];
        let never = net.add("Core::BooleanValue", never).out("outValue");
        let moves = net.any(&is_moving).unwrap_or(never);
        // What was before the net counts as false: as moving.
        let resting = net.of("Core::BooleanNot", &moves);
        let resting = [("inValue", (&resting).into()), ("Duration", REST_S.into())];
        let resting = net.add("Core::BooleanHistory", resting).out("outAll");
        let (later, rests) = net.feedback(&resting);
        net.close(&later, &rests);
        rests
    }

    /// Orders the parameters; returns the error number of each order.
    fn parameters(&self, net: &mut Net) -> Vec<Port> {
        let name = self.arm.name.as_str();
        match &self.control.0 {
            Mode::Position => Vec::new(),
            Mode::Joints(stiffness, damping) => {
                let orders = stiffness.iter().zip(damping).enumerate();
                let orders = orders.map(|(axis, values)| {
                    let [stiffness, damping] = [values.0, values.1].map(|value| {
                        net.add("Core::DoubleValue", [("Value", (*value).into())])
                            .out("outValue")
                    });
                    let order = [
                        ("inStiffness", (&stiffness).into()),
                        ("inDamping", (&damping).into()),
                        ("Robot", name.into()),
                        ("Axis", axis.into()),
                    ];
                    net.add("KUKA::LWR::JointImpParameters", order)
                        .out("outError")
                });
                orders.collect()
            }
            Mode::Cartesian(stiffness, damping) => {
                let [stiffness, damping] = [stiffness, damping].map(|[x, y, z, a, b, c]| {
                    let text =
                        format!("{{force:{{x:{x},y:{y},z:{z}}},torque:{{x:{a},y:{b},z:{c}}}}}");
                    net.add("World::WrenchValue", [("Value", text.into())])
                        .out("outValue")
                });
                let order = [
                    ("inStiffness", (&stiffness).into()),
                    ("inDamping", (&damping).into()),
                    ("Robot", name.into()),
                ];
                vec![
                    net.add("KUKA::LWR::CartImpParameters", order)
                        .out("outError"),
                ]
            }
        }
    }

    fn failures(&self) -> [(i32, Failure); 6] {
        let name = &self.arm.name;
        let (_, wanted) = self.control.needs();
        let unsupported = |cause: &str| ErrorKind::Unsupported {
            device: name.clone(),
            wanted,
            cause: cause.to_owned(),
        };
        let failed = |key: &str, cause: &str| Failure::of(key, name, cause);
        [
            (
                1,
                Failure::with(
                    "no_mode",
                    name,
                    unsupported("there is no such control mode"),
                ),
            ),
            (
                2,
                failed(
                    "powerless",
                    "there is no contact to it, or its drives have no power",
                ),
            ),
            (
                3,
                failed(
                    "moves",
                    "it moves, or is not where it is commanded, and cannot switch its control mode",
                ),
            ),
            (
                4,
                Failure::with(
                    "no_switch",
                    name,
                    unsupported(
                        "the robot's program does not switch to it\nhint: `handshake` of the cell file names what the program \
                         understands; on a Sunrise cabinet the program itself selects the mode",
                    ),
                ),
            ),
            (
                5,
                failed(
                    "silent",
                    "the robot's program did not switch its control mode",
                ),
            ),
            (-1, Failure::conflict(name)),
        ]
    }
}

impl Switch {
    /// The parameters are refused for long in a mode that has been switched to.
    fn refusal(&self, net: &mut Net, taken: &Port, switched: &Port) -> (Failure, Port) {
        let refused = net.of("Core::BooleanNot", taken);
        let refused = net.of_two("Core::BooleanAnd", &refused, switched);
        let refused = net.known(&refused);
        let refused = [
            ("inValue", (&refused).into()),
            ("Duration", ANSWER_S.into()),
        ];
        let refused = net.add("Core::BooleanHistory", refused).out("outAll");
        let (_, wanted) = self.control.needs();
        let error = ErrorKind::Unsupported {
            device: self.arm.name.clone(),
            wanted,
            cause: "the arm does not accept stiffness and damping while it is in this mode\nhint: switch to position \
                    control first"
                .to_owned(),
        };
        (Failure::with("refused", &self.arm.name, error), refused)
    }
}

impl Operation for Switch {
    fn devices(&self) -> Vec<String> {
        vec![self.arm.name.clone()]
    }

    fn check(&self) -> Result<(), ErrorKind> {
        self.control.check(&self.arm)
    }

    fn needs_begins(&self) -> bool {
        false
    }

    fn write(&self, net: &mut Net, requests: &Requests<'_>) -> Result<Ports, ErrorKind> {
        let name = self.arm.name.as_str();
        let is = |net: &mut Net, error: &Port, number: i32| {
            let equal = [
                ("inFirst", error.into()),
                ("Second", number.to_string().into()),
            ];
            net.add("Core::IntEquals", equal).out("outValue")
        };
        let strategy = [("Value", self.control.strategy().into())];
        let strategy = net.add("Core::IntValue", strategy).out("outValue");
        let rests = self.rests(net);
        let moves = net.of("Core::BooleanNot", &rests);
        let strategy = [("inValue", (&strategy).into()), ("inNull", (&moves).into())];
        let strategy = net.add("Core::IntSetNull", strategy).out("outValue");
        let order = [("inStrategy", (&strategy).into()), ("Robot", name.into())];
        let order = net.add("KUKA::LWR::ControlStrategy", order);
        let orders = self.parameters(net);
        let monitor = [("Robot", name.into()), ("Axis", 0.into())];
        let joint = net.add("RobotArm::JointMonitor", monitor).out("outError");
        let mut is_done = order.out("outCompleted");
        let mut is_taken = None;
        for error in &orders {
            let taken = is(net, error, 0);
            is_taken = Some(match is_taken {
                Some(all) => net.of_two("Core::BooleanAnd", &all, &taken),
                None => taken,
            });
        }
        let switched = is_done.clone();
        let follows = is(net, &joint, 0);
        is_done = net.of_two("Core::BooleanAnd", &is_done, &follows);
        if let Some(taken) = &is_taken {
            is_done = net.of_two("Core::BooleanAnd", &is_done, taken);
        }
        let is_done = net.known(&is_done);
        let steady = [
            ("inValue", (&is_done).into()),
            ("Duration", STEADY_S.into()),
        ];
        let steady = net.add("Core::BooleanHistory", steady).out("outAll");
        let mut failures = Vec::new();
        for (number, failure) in self.failures() {
            let failed = is(net, &order.out("outError"), number);
            failures.push((failure, net.known(&failed)));
        }
        failures.extend(is_taken.map(|taken| self.refusal(net, &taken, &switched)));
        let clock = net.add("Core::Clock", []).out("outValue");
        let mut is_after = |limit_s: f64| {
            let late = [("inFirst", (&clock).into()), ("Second", limit_s.into())];
            net.add("Core::DoubleGreater", late).out("outValue")
        };
        let (restless, late) = (is_after(REST_MAX_S), is_after(SWITCH_MAX_S));
        let restless = net.of_two("Core::BooleanAnd", &restless, &moves);
        let cause = "it does not come to rest within 10 s, and cannot switch its control mode\nhint: does anything push it?";
        failures.push((Failure::of("restless", name, cause), restless));
        let cause = "it has not switched its control mode within 20 s";
        failures.push((Failure::of("late", name, cause), late));
        Ok(Ports {
            done: net.of_two("Core::BooleanOr", &steady, &requests.stop),
            progress: None,
            failures,
            results: Vec::new(),
            fault: None,
        })
    }
}
