//! Nets in which one primitive is measured: any number of instances of it, fed with values that the measurement
//! writes. The results do not matter here, only the computing time.

use std::fmt::Write as _;
use std::sync::Arc;

use takt_core::device::{DeviceDescription, DeviceTable, Part};
use takt_net::definition::{InPort, Parameter, ParameterType};
use takt_net::netcomm::Directory;
use takt_net::{Definition, Element, JointLimits};

/// Name of the device that primitives of devices get.
const DEVICE: &str = "device";

/// A cell with a device that offers all that primitives need.
pub(super) fn devices() -> anyhow::Result<DeviceTable> {
    let parts = vec![
        Part::Base {
            wheels: 4,
            velocity_max: 1.0,
            rotation_max: 1.0,
            acceleration_max: 1.6,
            rotation_acceleration_max: 1.6,
        },
        Part::Io {
            bool_in: 1,
            bool_out: 1,
            real_in: 1,
            real_out: 1,
        },
        Part::CartesianPosition,
        Part::Gripper { distance_max: 0.1 },
        Part::Tool,
        Part::Strategy,
        Part::JointImpedance,
        Part::CartesianImpedance,
        Part::Torques,
        Part::Wrench,
        Part::Drives { count: 4 },
        Part::ServoGripper,
        Part::Homing,
        Part::CartesianSine,
        Part::Homing,
    ];
    let limits = JointLimits {
        position_min: -3.0,
        position_max: 3.0,
        velocity_max: 2.0,
        acceleration_max: 4.0,
    };
    let mut table = DeviceTable::default();
    table.add(DeviceDescription {
        name: DEVICE.to_owned(),
        kind: "calibration",
        limits: vec![limits; 7],
        model: "kuka_lwr4".into(),
        parts,
    })?;
    Ok(table)
}

const fn prefix(element: Element) -> &'static str {
    match element {
        Element::Bool => "Core::Boolean",
        Element::Int => "Core::Int",
        Element::Double | Element::Nanos => "Core::Double",
        Element::Vector => "World::Vector",
        Element::Rotation => "World::Rotation",
        Element::Frame => "World::Frame",
        Element::Twist => "World::Twist",
        Element::Wrench => "World::Wrench",
    }
}

fn list(element: &str, size: usize) -> String {
    format!("[{}]", vec![element; size].join(","))
}

/// In ports that are fed. A primitive that is switched off costs nothing.
fn fed(definition: &Definition) -> impl Iterator<Item = (usize, &InPort)> {
    let ports = definition.inputs.iter().enumerate();
    ports.filter(|(_, port)| port.name != "inActive")
}

/// The text of a net with so many instances; arrays have `size` elements.
pub(super) fn net(definition: &Definition, instances: usize, size: usize) -> String {
    let mut text = String::from("{now=Core::TimeNet(),");
    let mut links = Vec::new();
    for (i, port) in fed(definition) {
        let p = prefix(port.ty.element);
        let (array, value) = if port.ty.array {
            (
                "Array",
                format!(",Value='{}'", list(zero(port.ty.element), size)),
            )
        } else {
            ("", String::new())
        };
        let _cannot_fail = write!(text, "v{i}={p}{array}NetcommIn(Key='{i}'{value}),");
        let source = if port.ty.element == Element::Nanos {
            // Programs cannot write times.
            let _cannot_fail = write!(
                text,
                "t{i}=Core::TimeAdd(inTime=now.outValue,inDelta=v{i}.outValue),"
            );
            't'
        } else {
            'v'
        };
        links.push(format!("{}={source}{i}.outValue", port.name));
    }
    for instance in 0..instances {
        let mut arguments = links.clone();
        arguments.extend(parameters(definition, instance, size));
        let (name, arguments) = (&definition.name, arguments.join(","));
        let _cannot_fail = write!(text, "p{instance}={name}({arguments}),");
    }
    text + "end=Core::BooleanValue(Value='false'),outTerminate=end.outValue}"
}

fn zero(element: Element) -> &'static str {
    match element {
        Element::Bool => "false",
        Element::Int | Element::Double | Element::Nanos => "0",
        Element::Vector | Element::Rotation | Element::Frame | Element::Twist | Element::Wrench => {
            "{}"
        }
    }
}

/// What an instance needs or what makes its work long, where the defaults do not.
fn parameters(definition: &Definition, instance: usize, size: usize) -> Vec<String> {
    const FAST: &str = "Velocity='1000',Acceleration='1e5',Jerk='1e6'";
    const FAST_JOINTS: &str = "Velocity='[1000]',Acceleration='[1e5]',Jerk='[1e6]'";
    let given = match definition.name.as_str() {
        "Motion::Lin" => format!("{FAST},From='{{}}',To='{{pos:{{x:1000}},rot:{{a:3}}}}'"),
        "Motion::Circ" => {
            format!("{FAST},From='{{}}',Via='{{pos:{{x:300,y:300}}}}',To='{{pos:{{x:600}}}}'")
        }
        "Motion::Ptp" => {
            format!(
                "{FAST_JOINTS},From='{}',To='{}'",
                list("0", size),
                list("1000", size)
            )
        }
        "Motion::Track" | "Motion::Coast" => FAST_JOINTS.to_owned(),
        "Motion::Trajectory" => {
            // Positions and velocities of all joints at the start, and after 1000 s.
            let point = |position: &str| format!("{}{}", position.repeat(size), " 0".repeat(size));
            let (start, end) = (point(" 0"), point(" 1"));
            format!("{FAST_JOINTS},Joints='{size}',Table='0{start}/1000{end}'")
        }
        _ => String::new(),
    };
    let own = |parameter: &Parameter| {
        let value = match (parameter.name, parameter.ty) {
            // The default, a program that does nothing: what others cost is in their object code.
            _ if definition.name == "Irl::Program" => return None,
            ("Table", _) => return None,
            ("Size", _) => size.to_string(),
            // Tools belong to the last axis.
            ("Axis", _) if definition.name == "RobotArm::ToolParameters" => "6".to_owned(),
            ("Axis", _) => (instance % 7).to_string(),
            ("Key", _) => format!("k{instance}"),
            (_, ParameterType::Text) => DEVICE.to_owned(),
            ("Value", ParameterType::Value(ty)) if ty.array => list(zero(ty.element), size),
            _ => return None,
        };
        let is_port = definition
            .inputs
            .iter()
            .any(|port| port.parameter == Some(parameter.name));
        (!is_port).then(|| format!("{}='{value}'", parameter.name))
    };
    let mut all: Vec<String> = definition.parameters.iter().filter_map(own).collect();
    if !given.is_empty() {
        all.push(given);
    }
    all
}

/// Values that change from one repetition to the next: some ordinary, some for which functions take long. The same
/// series in each run.
#[derive(Clone)]
pub(super) struct Values(u64);

impl Values {
    pub(super) const fn new() -> Self {
        Self(0x9e37_79b9_7f4a_7c15)
    }

    fn below(&mut self, bound: u32) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        let high = u32::try_from(self.0 >> 32).unwrap_or(0);
        high % bound
    }

    fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * f64::from(self.below(1 << 24)) / f64::from(1 << 24)
    }

    /// Writes a value to every in value of a net.
    pub(super) fn write(
        &mut self,
        definition: &Definition,
        inbox: &Arc<Directory>,
        words: &mut [u64],
        size: usize,
    ) {
        for (i, port) in fed(definition) {
            let value = self.text(port);
            let value = if port.ty.array {
                list(&value, size)
            } else {
                value
            };
            if let Some(entry) = inbox.find(&format!("in{i}")) {
                // A text that is no value of its type leaves the previous value.
                let _ = entry.write(&value, words);
            }
        }
    }

    fn text(&mut self, port: &InPort) -> String {
        const SLOW: [&str; 6] = [
            "1e308",
            "-1e300",
            "1e22",
            "3e-310",
            "nan",
            "-7.000000001e15",
        ];
        match port.ty.element {
            Element::Bool if ["inReset", "inStop"].contains(&port.name) => {
                (self.below(16) == 0).to_string()
            }
            Element::Bool => (self.below(2) == 0).to_string(),
            Element::Int => [0, 1, 3, i32::MAX, i32::MIN][self.below(5) as usize].to_string(),
            Element::Double if self.below(4) == 0 => SLOW[self.below(6) as usize].to_owned(),
            Element::Double | Element::Nanos => self.between(-2.0, 2.0).to_string(),
            Element::Vector => self.vector(["x", "y", "z"], 1.0),
            Element::Rotation => self.vector(["a", "b", "c"], 3.0),
            Element::Frame => {
                let (pos, rot) = (
                    self.vector(["x", "y", "z"], 0.7),
                    self.vector(["a", "b", "c"], 3.0),
                );
                format!("{{pos:{pos},rot:{rot}}}")
            }
            Element::Twist => {
                let (vel, rot) = (
                    self.vector(["x", "y", "z"], 1.0),
                    self.vector(["x", "y", "z"], 1.0),
                );
                format!("{{vel:{vel},rot:{rot}}}")
            }
            Element::Wrench => {
                let (force, torque) = (
                    self.vector(["x", "y", "z"], 9.0),
                    self.vector(["x", "y", "z"], 9.0),
                );
                format!("{{force:{force},torque:{torque}}}")
            }
        }
    }

    fn vector(&mut self, names: [&str; 3], most: f64) -> String {
        let [a, b, c] = [(); 3].map(|()| self.between(-most, most));
        format!("{{{}:{a},{}:{b},{}:{c}}}", names[0], names[1], names[2])
    }
}
