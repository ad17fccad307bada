//! The net that executes a program on the devices of a controller: the arms of its robots, inputs and outputs of its signals,
//! and the values with which a program is observed and controlled. Nothing is loaded here.

mod signals;

use std::fmt::Write as _;

use crate::code::Program;
use crate::machine::BREAKPOINTS_MAX;
use crate::spec::{Direction, SignalKind};

pub use crate::spec::Channel;

/// Which devices execute a program.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Binding {
    /// The arm of each robot.
    pub arms: Vec<String>,
    /// Input or output of each signal, that of the lowest bit of a binary one. A signal without one is a value of the net,
    /// `signal_` and its name.
    pub channels: Vec<Option<Channel>>,
    /// First values of signals that are values of the net, as texts of nets; `false` or 0 if there is none.
    pub values: Vec<Option<String>>,
    /// Variables of the program at value `watch`.
    pub watch: Vec<String>,
    /// Most steps in a cycle, 16 to 100000.
    pub steps: u32,
    /// Lines before which the program waits.
    pub breakpoints: Vec<u32>,
    /// Part of the speed of motions, 0 to 1.
    pub speed: f64,
    /// Whether the program waits before its first line.
    pub is_held: bool,
}

/// Why a program cannot be bound so.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BindingError {
    /// A name that cannot be part of a net.
    #[error("`{0}` is not the name of a device or variable")]
    Name(String),
    /// Not one arm for each robot, or not one entry for each signal.
    #[error("{found} {what}, but the program has {needed}")]
    Count {
        /// What is counted.
        what: &'static str,
        /// As given.
        found: usize,
        /// As needed.
        needed: usize,
    },
    /// A binary signal takes as many digital inputs or outputs as it has bits.
    #[error(
        "signal `{0}` is a whole number of unknown width, which no device has\nhint: give it `bits` in the system specification, or \
         leave it unbound"
    )]
    Width(String),
    /// There are no ports for all bits.
    #[error("signal `{0}` has more bits than there are ports from {1} on")]
    Ports(String, Channel),
    /// An output that two signals set.
    #[error("signals `{0}` and `{1}` both set output {2}\nhint: bind each output once")]
    Shared(String, String, Channel),
}

const KINDS: [SignalKind; 3] = [SignalKind::Digital, SignalKind::Analog, SignalKind::Binary];

/// The value of the net that shows or takes a signal without a device.
#[must_use]
pub fn signal_key(name: &str) -> String {
    format!("signal_{name}")
}

/// The text of the net.
///
/// In values: `pause`, `continue`, `step`, `stop`, `override`, `breakpoints`, and signals. Out values: `state`, `line`, `column`, `error`,
/// `watch`, `failed`, and signals. It ends when the program has ended and its robots are at rest; a cancel stops the program.
///
/// # Errors
/// If the binding does not fit the program.
pub fn net(program: &Program, binding: &Binding) -> Result<String, BindingError> {
    check(program, binding)?;
    let mut net = Text::default();
    controls(&mut net, binding);
    let joints = arms(&mut net, program, binding);
    let mut links = String::new();
    for kind in KINDS {
        signals::inputs(&mut net, &mut links, program, binding, kind);
    }
    if !joints.is_empty() {
        let _ = write!(links, "inPosition=where{}.outArray, ", joints.len());
    }
    let code: String = program
        .encode()
        .iter()
        .fold(String::new(), |mut code, byte| {
            let _ = write!(code, "{byte:02x}");
            code
        });
    let (arms, watch) = (binding.arms.join(","), binding.watch.join(","));
    net.line(&format!(
        "program=Irl::Program({links}inOverride=override.outValue, inPause=pause.outValue, inContinue=continue.outValue, \
         inStep=step.outValue, inStop=ending.outValue, inBreakpoints=breakpoints.outValue, Robots='{arms}', Watch='{watch}', \
         Steps='{}', Code='{code}')",
        binding.steps
    ));
    set_points(&mut net, &joints);
    for kind in KINDS {
        signals::outputs(&mut net, program, binding, kind);
    }
    for name in ["State", "Line", "Column", "Error"] {
        let key = name.to_lowercase();
        net.line(&format!(
            "shown_{key}=Core::IntNetcommOut(inValue=program.out{name}, Key='{key}')"
        ));
    }
    if !binding.watch.is_empty() {
        net.line("shown_watch=Core::DoubleArrayNetcommOut(inValue=program.outWatch, Key='watch')");
    }
    Ok(format!("{{\n{}  outTerminate=end.outValue\n}}\n", net.0))
}

fn check(program: &Program, binding: &Binding) -> Result<(), BindingError> {
    let counted = |what, found, needed| {
        if found == needed {
            Ok(())
        } else {
            Err(BindingError::Count {
                what,
                found,
                needed,
            })
        }
    };
    let signals = &program.system.signals;
    counted("arms", binding.arms.len(), program.system.robots.len())?;
    counted("channels", binding.channels.len(), signals.len())?;
    let devices = binding.channels.iter().flatten().map(|c| &c.device);
    let values = binding.values.iter().flatten();
    for name in binding
        .arms
        .iter()
        .chain(devices)
        .chain(&binding.watch)
        .chain(values)
    {
        if !crate::spec::is_device(name) {
            return Err(BindingError::Name(name.clone()));
        }
    }
    check_channels(program, binding)
}

fn check_channels(program: &Program, binding: &Binding) -> Result<(), BindingError> {
    let all = program.system.signals.iter().zip(&binding.channels);
    let bound: Vec<_> = all
        .filter_map(|(signal, channel)| Some((signal, channel.as_ref()?)))
        .collect();
    for (i, (signal, channel)) in bound.iter().enumerate() {
        let name = || signal.name.clone();
        if signal.kind == SignalKind::Binary && signal.bits == 0 {
            return Err(BindingError::Width(name()));
        }
        if channel.port.checked_add(signal.width()).is_none() {
            return Err(BindingError::Ports(name(), (*channel).clone()));
        }
        if signal.direction == Direction::In {
            continue;
        }
        let is_analog = |kind| kind == SignalKind::Analog;
        let others = bound.iter().take(i).filter(|(other, at)| {
            other.direction == Direction::Out
                && is_analog(other.kind) == is_analog(signal.kind)
                && at.device == channel.device
        });
        for (other, at) in others {
            let first = channel.port.max(at.port);
            let ends =
                [(signal, channel), (other, at)].map(|(s, at)| at.port.saturating_add(s.width()));
            if ends.iter().all(|end| first < *end) {
                let shared = Channel {
                    port: first,
                    device: channel.device.clone(),
                };
                return Err(BindingError::Shared(other.name.clone(), name(), shared));
            }
        }
    }
    Ok(())
}

#[derive(Default)]
struct Text(String);

impl Text {
    fn line(&mut self, line: &str) {
        let _ = writeln!(self.0, "  {line},");
    }
}

fn controls(net: &mut Text, binding: &Binding) {
    net.line("cancel=Cancel()");
    for key in ["pause", "continue", "step", "stop"] {
        let value = key == "step" && binding.is_held;
        net.line(&format!(
            "{key}=Core::BooleanNetcommIn(Key='{key}', Value='{value}')"
        ));
    }
    let speed = binding.speed;
    net.line(&format!(
        "override=Core::DoubleNetcommIn(Key='override', Value='{speed}')"
    ));
    let given = binding.breakpoints.iter().map(u32::to_string);
    let lines = given.chain(std::iter::repeat("0".to_owned()));
    let lines: Vec<String> = lines.take(BREAKPOINTS_MAX).collect();
    let lines = lines.join(",");
    net.line(&format!(
        "breakpoints=Core::IntArrayNetcommIn(Key='breakpoints', Value='[{lines}]')"
    ));
    net.line("ending=Core::BooleanOr(inFirst=cancel.outCancel, inSecond=stop.outValue)");
}

/// Where the arms are; returns arm and axis of each joint, in the order of the program.
fn arms(net: &mut Text, program: &Program, binding: &Binding) -> Vec<(String, usize)> {
    let robots = program.system.robots.iter().zip(&binding.arms);
    let joints = robots.flat_map(|(robot, arm)| {
        let axes = 0..robot.joints.len();
        axes.map(|axis| (arm.clone(), axis))
    });
    let joints: Vec<_> = joints.collect();
    let size = joints.len();
    if size > 0 {
        net.line(&format!("where0=Core::DoubleArray(Size='{size}')"));
    }
    for (i, (arm, axis)) in joints.iter().enumerate() {
        net.line(&format!(
            "at{i}=RobotArm::JointMonitor(Robot='{arm}', Axis='{axis}')"
        ));
        net.line(&format!(
            "where{}=Core::DoubleArraySet(inArray=where{i}.outArray, inValue=at{i}.outCommandedPosition, Size='{size}', \
             Index='{i}')",
            i + 1
        ));
    }
    joints
}

/// Set-points, and the end: with the program, or when a joint does not take them.
fn set_points(net: &mut Text, joints: &[(String, usize)]) {
    let size = joints.len();
    net.line("failed0=Core::BooleanValue(Value='false')");
    for (i, (arm, axis)) in joints.iter().enumerate() {
        net.line(&format!(
            "angle{i}=Core::DoubleArrayGet(inArray=program.outPosition, Size='{size}', Index='{i}')"
        ));
        net.line(&format!(
            "joint{i}=RobotArm::JointPosition(inPosition=angle{i}.outValue, Robot='{arm}', Axis='{axis}')"
        ));
        net.line(&format!(
            "good{i}=Core::IntEquals(inFirst=joint{i}.outError)"
        ));
        net.line(&format!(
            "bad{i}=Core::BooleanNot(inValue=good{i}.outValue)"
        ));
        net.line(&format!(
            "failed{}=Core::BooleanOr(inFirst=failed{i}.outValue, inSecond=bad{i}.outValue)",
            i + 1
        ));
    }
    net.line(&format!(
        "shown_failed=Core::BooleanNetcommOut(inValue=failed{size}.outValue, Key='failed')"
    ));
    net.line(&format!(
        "end=Core::BooleanOr(inFirst=program.outDone, inSecond=failed{size}.outValue)"
    ));
}
