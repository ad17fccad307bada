//! Writer of net texts: one primitive a line, values in their shortest exact form. Equal primitives without effect are
//! written once. It knows no controller.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use crate::pose::Pose;

/// An out port of a primitive in the net, such as `p3.outValue`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Port(String);

/// A primitive in the net.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Primitive(String);

impl Primitive {
    /// One of its out ports.
    pub(crate) fn out(&self, port: &str) -> Port {
        Port(format!("{}.{port}", self.0))
    }
}

/// A feedback whose source is written later.
#[derive(Debug)]
#[must_use = "a feedback without source is no net"]
pub(crate) struct Later {
    line: usize,
    /// Type of its value, as primitives are named by it.
    kind: &'static str,
}

/// An argument of a primitive: what is at a port, or the text of a parameter.
#[derive(Clone, Debug)]
pub(crate) enum Argument {
    Port(Port),
    Text(String),
}

impl From<&Port> for Argument {
    fn from(port: &Port) -> Self {
        Self::Port(port.clone())
    }
}

impl From<&str> for Argument {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Argument {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<f64> for Argument {
    fn from(number: f64) -> Self {
        Self::Text(number.to_string())
    }
}

impl From<usize> for Argument {
    fn from(number: usize) -> Self {
        Self::Text(number.to_string())
    }
}

/// A net in the making.
#[derive(Debug, Default)]
pub(crate) struct Net {
    lines: Vec<String>,
    /// Names of primitives by their text.
    known: BTreeMap<String, String>,
}

impl Net {
    /// Adds a primitive, or finds the equal one.
    pub(crate) fn add<const N: usize>(
        &mut self,
        kind: &str,
        arguments: [(&str, Argument); N],
    ) -> Primitive {
        self.add_with(kind, &arguments)
    }

    /// The same with any number of arguments.
    pub(crate) fn add_with(&mut self, kind: &str, arguments: &[(&str, Argument)]) -> Primitive {
        let text = arguments
            .iter()
            .fold(format!("{kind}("), |mut text, (name, argument)| {
                let separator = if text.ends_with('(') { "" } else { ", " };
                // Writing to a String does not fail.
                let _ = match argument {
                    Argument::Port(Port(port)) => write!(text, "{separator}{name}={port}"),
                    Argument::Text(value) => write!(text, "{separator}{name}='{}'", escaped(value)),
                };
                text
            })
            + ")";
        let name = self.known.get(&text).cloned().unwrap_or_else(|| {
            let name = format!("p{}", self.lines.len());
            self.lines.push(format!("  {name}={text}"));
            self.known.insert(text, name.clone());
            name
        });
        Primitive(name)
    }

    /// Adds a primitive with one in port `inValue`.
    pub(crate) fn of(&mut self, kind: &str, value: &Port) -> Port {
        self.add(kind, [("inValue", value.into())]).out("outValue")
    }

    /// Adds a primitive of two values.
    pub(crate) fn of_two(&mut self, kind: &str, first: &Port, second: &Port) -> Port {
        let arguments = [("inFirst", first.into()), ("inSecond", second.into())];
        self.add(kind, arguments).out("outValue")
    }

    /// Whether one of the ports is true; `None` if there are none.
    pub(crate) fn any(&mut self, ports: &[Port]) -> Option<Port> {
        let (first, rest) = ports.split_first()?;
        Some(rest.iter().fold(first.clone(), |all, port| {
            self.of_two("Core::BooleanOr", &all, port)
        }))
    }

    /// A truth value whose null counts as false.
    pub(crate) fn known(&mut self, value: &Port) -> Port {
        let unknown = self.of("Core::BooleanIsNull", value);
        let known = [
            ("inCondition", (&unknown).into()),
            ("inFalse", value.into()),
        ];
        self.add("Core::BooleanConditional", known).out("outValue")
    }

    /// The pose `second`, which is given in `first`, in the reference of `first`.
    pub(crate) fn transform(&mut self, first: &Port, second: &Pose) -> Port {
        if *second == Pose::IDENTITY {
            return first.clone();
        }
        let value = self.frame(second);
        self.of_two("World::FrameTransform", first, &value)
    }

    /// A pose as a value.
    pub(crate) fn frame(&mut self, pose: &Pose) -> Port {
        let value = [("Value", pose.text().into())];
        self.add("World::FrameValue", value).out("outValue")
    }

    /// What a port that is written later had in the previous cycle, null in the first one: [`Self::close`] names the port.
    fn before(&mut self, kind: &'static str) -> (Later, Port, Port) {
        let line = self.lines.len();
        let before = Primitive(format!("p{line}")).out("outValue");
        self.lines.push(String::new());
        let never = self.of(&format!("{kind}IsNull"), &before);
        (Later { line, kind }, before, never)
    }

    /// Whether `stop` is true, or a port that is written later was true in the previous cycle: [`Self::close`] names it.
    pub(crate) fn feedback(&mut self, stop: &Port) -> (Later, Port) {
        let (later, before, never) = self.before("Core::Boolean");
        let known = self.zero_if("Core::Boolean", &never, &before);
        let stop = self.of_two("Core::BooleanOr", stop, &known);
        (later, stop)
    }

    /// A value of a type, such as `Core::Double`, that a net keeps from cycle to cycle, from `initial` on:
    /// [`Self::close`] names what it becomes.
    pub(crate) fn state(&mut self, kind: &'static str, initial: &Port) -> (Later, Port) {
        let (later, before, never) = self.before(kind);
        let value = [
            ("inCondition", (&never).into()),
            ("inTrue", initial.into()),
            ("inFalse", (&before).into()),
        ];
        let value = self.add(&format!("{kind}Conditional"), value);
        (later, value.out("outValue"))
    }

    /// Connects a feedback with its source.
    pub(crate) fn close(&mut self, later: &Later, source: &Port) {
        let Later { line, kind } = later;
        let text = format!("  p{line}={kind}Pre(inValue={})", source.0);
        if let Some(place) = self.lines.get_mut(*line) {
            *place = text;
        }
    }

    /// A value of a type, such as `Core::Double`, or zero while a condition holds.
    pub(crate) fn zero_if(&mut self, kind: &str, off: &Port, value: &Port) -> Port {
        let arguments = [("inCondition", off.into()), ("inFalse", value.into())];
        self.add(&format!("{kind}Conditional"), arguments)
            .out("outValue")
    }

    /// A number times a constant.
    pub(crate) fn scaled(&mut self, number: &Port, factor: f64) -> Port {
        let arguments = [("inFirst", number.into()), ("Second", factor.into())];
        self.add("Core::DoubleMultiply", arguments).out("outValue")
    }

    /// A number between bounds.
    pub(crate) fn clamped(&mut self, value: &Port, min: &Port, max: &Port) -> Port {
        let arguments = [
            ("inValue", value.into()),
            ("inMin", min.into()),
            ("inMax", max.into()),
        ];
        self.add("Core::DoubleClamp", arguments).out("outValue")
    }

    /// An array of zeros.
    pub(crate) fn doubles(&mut self, size: usize) -> Port {
        self.add("Core::DoubleArray", [("Size", size.into())])
            .out("outArray")
    }

    /// An array with another element.
    pub(crate) fn with_element(
        &mut self,
        array: &Port,
        value: &Port,
        size: usize,
        at: usize,
    ) -> Port {
        let element = [
            ("inArray", array.into()),
            ("inValue", value.into()),
            ("Size", size.into()),
            ("Index", at.into()),
        ];
        self.add("Core::DoubleArraySet", element).out("outArray")
    }

    /// Whether the magnitude of a number is greater than a limit.
    pub(crate) fn is_beyond(&mut self, value: &Port, limit: f64) -> Port {
        let size = self.of("Core::DoubleAbs", value);
        let greater = [("inFirst", (&size).into()), ("Second", limit.into())];
        let greater = self.add("Core::DoubleGreater", greater).out("outValue");
        self.known(&greater)
    }

    /// Whether it is the first cycle of the net.
    pub(crate) fn first_cycle(&mut self) -> Port {
        let always = [("Value", "true".into())];
        let always = self.add("Core::BooleanValue", always).out("outValue");
        let before = self.of("Core::BooleanPre", &always);
        self.of("Core::BooleanIsNull", &before)
    }

    /// The override of the net: a factor of the speed of its motions, 0 to 1, which a client may set while it runs.
    pub(crate) fn override_in(&mut self) -> Port {
        let argument = [("Key", "override".into()), ("Value", 1.0.into())];
        self.add("Core::DoubleNetcommIn", argument).out("outValue")
    }

    /// A result that rules and programs can read.
    pub(crate) fn result(&mut self, key: &str, value: &Port) {
        self.add(
            "Core::BooleanNetcommOut",
            [("inValue", value.into()), ("Key", key.into())],
        );
    }

    /// The text of the net, which is evaluated once.
    pub(crate) fn finish_once(self) -> String {
        format!("{{\n{}\n}}", self.lines.join(",\n"))
    }

    /// The text of the net, which ends when `end` is true.
    pub(crate) fn finish(self, end: &Port) -> String {
        format!(
            "{{\n{},\n  outTerminate={}\n}}",
            self.lines.join(",\n"),
            end.0
        )
    }
}

/// The text of a parameter between apostrophes.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('\'', "\\'")
}

/// The text of an array.
pub(crate) fn array(numbers: &[f64]) -> String {
    let numbers: Vec<_> = numbers.iter().map(f64::to_string).collect();
    format!("[{}]", numbers.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_primitives_are_written_once() {
        let mut net = Net::default();
        let monitor = |net: &mut Net| {
            net.add(
                "RobotArm::JointMonitor",
                [("Robot", "left".into()), ("Axis", 0.into())],
            )
        };
        let (first, second) = (monitor(&mut net), monitor(&mut net));
        assert_eq!(first, second);
        let text = net.finish(&first.out("outValue"));
        assert_eq!(text.matches("JointMonitor").count(), 1, "{text}");
    }

    #[test]
    fn names_with_apostrophes_are_escaped() {
        let mut net = Net::default();
        let cancel = net.add("Cancel", []).out("outCancel");
        net.result(r"it's \", &cancel);
        let text = net.finish(&cancel);
        assert!(text.contains(r"Key='it\'s \\'"), "{text}");
    }

    #[test]
    fn numbers_are_exact() {
        assert_eq!(
            array(&[0.1 + 0.2, -0.0, 1e-7, 1e21]),
            "[0.30000000000000004,-0,0.0000001,1000000000000000000000]"
        );
    }
}
