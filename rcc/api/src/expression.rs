//! Numbers and conditions over sensors, evaluated by the controller in every cycle. An expression becomes primitives of
//! the net that uses it, equal parts once. A number that its device does not know is null, and a condition over null is
//! not true.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};
use std::sync::Arc;
use std::time::Duration;

use crate::net::{Net, Port};

/// A number that changes from cycle to cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct Number(Arc<NumberKind>);

#[derive(Debug, PartialEq)]
enum NumberKind {
    Constant(f64),
    /// An out port of a primitive that reads a device.
    Sensor {
        primitive: &'static str,
        parameters: Vec<(&'static str, String)>,
        port: String,
    },
    Of(&'static str, Number),
    OfTwo(&'static str, Number, Number),
    Average(Number, Duration),
}

impl Number {
    pub(crate) fn sensor(
        primitive: &'static str,
        parameters: Vec<(&'static str, String)>,
        port: impl Into<String>,
    ) -> Self {
        Self(Arc::new(NumberKind::Sensor {
            primitive,
            parameters,
            port: port.into(),
        }))
    }

    fn of_two(kind: &'static str, first: Self, second: impl Into<Self>) -> Self {
        Self(Arc::new(NumberKind::OfTwo(kind, first, second.into())))
    }

    /// Its magnitude.
    #[must_use]
    pub fn abs(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleAbs", self)))
    }

    /// Its square root; a negative number has none, and nothing holds of it.
    #[must_use]
    pub fn sqrt(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleSquareRoot", self)))
    }

    /// Sine of an angle, rad.
    #[must_use]
    pub fn sin(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleSin", self)))
    }

    /// Cosine of an angle, rad.
    #[must_use]
    pub fn cos(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleCos", self)))
    }

    /// Tangent of an angle, rad.
    #[must_use]
    pub fn tan(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleTan", self)))
    }

    /// Arc sine, rad.
    #[must_use]
    pub fn asin(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleAsin", self)))
    }

    /// Arc cosine, rad.
    #[must_use]
    pub fn acos(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleAcos", self)))
    }

    /// Its mean over the last `duration`, or since the start if that is less.
    #[must_use]
    pub fn average(self, duration: Duration) -> Self {
        Self(Arc::new(NumberKind::Average(self, duration)))
    }

    /// The smaller of both.
    #[must_use]
    pub fn min(self, other: impl Into<Self>) -> Self {
        Self::of_two("Core::DoubleMin", self, other)
    }

    /// The larger of both.
    #[must_use]
    pub fn max(self, other: impl Into<Self>) -> Self {
        Self::of_two("Core::DoubleMax", self, other)
    }

    /// Whether it is greater than `limit`.
    pub fn over(self, limit: impl Into<Self>) -> Condition {
        Condition(Arc::new(ConditionKind::Greater(self, limit.into())))
    }

    /// Whether it is less than `limit`.
    pub fn under(self, limit: impl Into<Self>) -> Condition {
        Condition(Arc::new(ConditionKind::Greater(limit.into(), self)))
    }

    /// Writes it into a net; returns where its value is.
    pub(crate) fn write(&self, net: &mut Net) -> Port {
        match &*self.0 {
            NumberKind::Constant(value) => net
                .add("Core::DoubleValue", [("Value", (*value).into())])
                .out("outValue"),
            NumberKind::Sensor {
                primitive,
                parameters,
                port,
            } => {
                let primitive = match parameters.as_slice() {
                    [(name, value)] => net.add(primitive, [(name, value.as_str().into())]),
                    [(first, a), (second, b), ..] => net.add(
                        primitive,
                        [(first, a.as_str().into()), (second, b.as_str().into())],
                    ),
                    [] => net.add(primitive, []),
                };
                primitive.out(port)
            }
            NumberKind::Of(kind, value) => {
                let value = value.write(net);
                net.of(kind, &value)
            }
            NumberKind::Average(value, duration) => {
                let value = value.write(net);
                let seconds = duration.as_secs_f64();
                let arguments = [("inValue", (&value).into()), ("Duration", seconds.into())];
                net.add("Core::DoubleAverage", arguments).out("outValue")
            }
            NumberKind::OfTwo(kind, first, second) => {
                let (first, second) = (first.write(net), second.write(net));
                net.of_two(kind, &first, &second)
            }
        }
    }
}

impl From<f64> for Number {
    fn from(value: f64) -> Self {
        Self(Arc::new(NumberKind::Constant(value)))
    }
}

impl From<&Self> for Number {
    fn from(number: &Self) -> Self {
        number.clone()
    }
}

impl Neg for Number {
    type Output = Self;

    fn neg(self) -> Self {
        Self(Arc::new(NumberKind::Of("Core::DoubleNegate", self)))
    }
}

/// An operator of two numbers.
macro_rules! operator {
    ($($operator:ident $method:ident $primitive:literal)*) => {$(
        impl<T: Into<Number>> $operator<T> for Number {
            type Output = Self;

            fn $method(self, other: T) -> Self {
                Self::of_two($primitive, self, other)
            }
        }
    )*};
}

operator! {
    Add add "Core::DoubleAdd"
    Sub sub "Core::DoubleSubtract"
    Mul mul "Core::DoubleMultiply"
    Div div "Core::DoubleDivide"
}

/// A state that is true or not in each cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition(Arc<ConditionKind>);

#[derive(Debug, PartialEq)]
enum ConditionKind {
    Greater(Number, Number),
    Port {
        primitive: &'static str,
        device: String,
        port: u32,
    },
    Not(Condition),
    And(Condition, Condition),
    Or(Condition, Condition),
    Lasting(Condition, Duration),
    Edge(Condition, bool),
    /// The first, once the second has held.
    After(Condition, Condition),
}

impl Condition {
    /// A digital input of a device.
    pub(crate) fn input(device: &str, port: u32) -> Self {
        Self::port("IO::InBool", device, port)
    }

    /// A digital port of a device, which a primitive reads.
    pub(crate) fn port(primitive: &'static str, device: &str, port: u32) -> Self {
        let device = device.to_owned();
        let kind = ConditionKind::Port {
            primitive,
            device,
            port,
        };
        Self(Arc::new(kind))
    }

    /// Whether it has just become true; also if it is true from the start.
    #[must_use]
    pub fn rises(self) -> Self {
        Self(Arc::new(ConditionKind::Edge(self, true)))
    }

    /// Whether it has just become false; also if it is false from the start.
    #[must_use]
    pub fn falls(self) -> Self {
        Self(Arc::new(ConditionKind::Edge(self, false)))
    }

    /// Whether it has been true for `duration` without a break.
    #[must_use]
    pub fn lasting(self, duration: Duration) -> Self {
        Self(Arc::new(ConditionKind::Lasting(self, duration)))
    }

    /// Whether it holds once another condition has held since the activity began.
    #[must_use]
    pub fn after(self, other: Self) -> Self {
        Self(Arc::new(ConditionKind::After(self, other)))
    }

    /// Writes it into a net; returns where it is true from the first cycle on in which the condition held. Null counts
    /// as false.
    pub(crate) fn latched(&self, net: &mut Net) -> Port {
        let value = self.write(net);
        let known = net.known(&value);
        net.add("Core::Trigger", [("inOn", (&known).into())])
            .out("outActive")
    }

    /// Writes it into a net; returns where its value is.
    pub(crate) fn write(&self, net: &mut Net) -> Port {
        match &*self.0 {
            ConditionKind::Greater(first, second) => {
                let (first, second) = (first.write(net), second.write(net));
                net.of_two("Core::DoubleGreater", &first, &second)
            }
            ConditionKind::Port {
                primitive,
                device,
                port,
            } => {
                let number = port.to_string();
                let arguments = [
                    ("DeviceID", device.as_str().into()),
                    ("Port", number.into()),
                ];
                net.add(primitive, arguments).out("outIO")
            }
            ConditionKind::Not(condition) => {
                let value = condition.write(net);
                net.of("Core::BooleanNot", &value)
            }
            ConditionKind::And(first, second) => {
                let (first, second) = (first.write(net), second.write(net));
                net.of_two("Core::BooleanAnd", &first, &second)
            }
            ConditionKind::Or(first, second) => {
                let (first, second) = (first.write(net), second.write(net));
                net.of_two("Core::BooleanOr", &first, &second)
            }
            ConditionKind::Edge(condition, is_rising) => {
                let value = condition.write(net);
                let direction = is_rising.to_string();
                let arguments = [
                    ("inValue", (&value).into()),
                    ("Direction", direction.into()),
                ];
                net.add("Core::EdgeDetection", arguments).out("outValue")
            }
            ConditionKind::After(condition, before) => {
                let before = before.latched(net);
                let value = condition.write(net);
                net.of_two("Core::BooleanAnd", &before, &value)
            }
            ConditionKind::Lasting(condition, duration) => {
                let value = condition.write(net);
                let seconds = duration.as_secs_f64();
                let arguments = [("inValue", (&value).into()), ("Duration", seconds.into())];
                net.add("Core::BooleanHistory", arguments).out("outAll")
            }
        }
    }
}

impl Not for Condition {
    type Output = Self;

    fn not(self) -> Self {
        Self(Arc::new(ConditionKind::Not(self)))
    }
}

impl BitAnd for Condition {
    type Output = Self;

    fn bitand(self, other: Self) -> Self {
        Self(Arc::new(ConditionKind::And(self, other)))
    }
}

impl BitOr for Condition {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(Arc::new(ConditionKind::Or(self, other)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn force() -> Number {
        Number::sensor(
            "KUKA::LWR::FMonitor",
            vec![("Robot", "left".to_owned())],
            "outTcpFz",
        )
    }

    #[test]
    fn equal_sensors_are_read_once() {
        let condition = force().over(5.0) | force().under(-5.0);
        let mut net = Net::default();
        let value = condition.write(&mut net);
        let text = net.finish(&value);
        assert_eq!(text.matches("FMonitor").count(), 1, "{text}");
        assert_eq!(text.matches("DoubleGreater").count(), 2, "{text}");
    }

    #[test]
    fn arithmetic_becomes_primitives_in_order() {
        let condition = (-(force() * 2.0 - 1.0).abs())
            .under(3.0)
            .lasting(Duration::from_millis(20));
        let mut net = Net::default();
        let value = condition.write(&mut net);
        let text = net.finish(&value);
        for part in [
            "DoubleMultiply",
            "DoubleSubtract",
            "DoubleAbs",
            "DoubleNegate",
            "Duration='0.02'",
        ] {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
    }
}
