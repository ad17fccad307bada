//! Shapes: the position along a motion at each part of its time. Each is a function of its inputs
//! of this cycle alone; limits of velocity and acceleration are kept by the choice of the motion's
//! duration, or by the online generators.

use takt_net::definition::{Port, port};
use takt_net::{Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive, function};

/// The position of `value` between `min` and `max`, from 0 to 1, and whether it is within them.
fn interval(value: f64, min: f64, max: f64) -> (f64, bool) {
    if value < min {
        (0.0, false)
    } else if value > max {
        (1.0, false)
    } else {
        let width = if max > min { max - min } else { 1.0 };
        let part = (value - min) / width;
        (part, !part.is_nan())
    }
}

/// Position at time `x` of a rest-to-rest motion from 0 to 1 within time 0 to 1, with constant
/// velocity for the part `constant` of its time and constant acceleration before and after.
fn rampify(x: f64, constant: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    let ramp = (1.0 - constant) / 2.0;
    let velocity = 1.0 / (1.0 - ramp);
    if x < ramp {
        velocity * x * x / (2.0 * ramp)
    } else if x > 1.0 - ramp {
        1.0 - velocity * (1.0 - x) * (1.0 - x) / (2.0 * ramp)
    } else {
        velocity * (x - ramp / 2.0)
    }
}

/// Cubic Bézier curve with control points `p`, at `t`.
pub(crate) fn bezier(t: f64, [p0, p1, p2, p3]: [f64; 4]) -> f64 {
    let s = 1.0 - t;
    p0 * (s * s * s) + p1 * (3.0 * s * s * t) + p2 * (3.0 * s * t * t) + p3 * (t * t * t)
}

/// Control points of the Bézier curve that leaves `from` with velocity `from_vel` and arrives at
/// `to` with `to_vel`, velocities per unit of the curve's parameter.
pub(crate) fn hermite(from: f64, to: f64, from_vel: f64, to_vel: f64) -> [f64; 4] {
    [from, from + from_vel / 3.0, to - to_vel / 3.0, to]
}

/// `outActive` must be false, not null, while the primitive is inactive; so the primitive tests
/// that itself.
struct Interval {
    active: Option<In<bool>>,
    value: In<f64>,
    min: In<f64>,
    max: In<f64>,
    out: Out<f64>,
    out_active: Out<bool>,
}

impl Primitive for Interval {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.active.is_some_and(|a| a.get(cycle) != Some(true)) {
            self.out.set(cycle, None);
            self.out_active.set(cycle, false);
            return;
        }
        let value = self.value.get(cycle);
        let bounds = self.min.get(cycle).zip(self.max.get(cycle));
        let position = value
            .zip(bounds)
            .map(|(value, (min, max))| interval(value, min, max));
        self.out.set(cycle, position.map(|(part, _)| part));
        self.out_active
            .set(cycle, position.map(|(_, inside)| inside));
    }
}

fn interval_definition() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Interval, Fault> {
        let active = b.is_linked("inActive").then(|| b.input("inActive"));
        Ok(Interval {
            active: active.transpose()?,
            value: b.input("inValue")?,
            min: b.input("inMin")?,
            max: b.input("inMax")?,
            out: b.output("outValue"),
            out_active: b.output("outActive"),
        })
    };
    Definition::new(
        "Core::Interval",
        "The position of a value in an interval: 0 at Min and below, 1 at Max and above, linear \
         between. If Max equals Min the interval is the one point.",
        build,
    )
    .input::<bool>(port(
        "inActive",
        "switches the primitive off while false or null",
    ))
    .input::<f64>(port("inValue", "value, in the unit of the bounds").required())
    .input::<f64>(port("inMin", "lower bound").or("Min", "0"))
    .input::<f64>(port("inMax", "upper bound").or("Max", "1000"))
    .output::<f64>("outValue", "position in the interval, 0 to 1")
    .output::<bool>("outActive", "whether the value is within the interval")
    .null(NullRule::Own(
        "Null in gives null out; while inactive outValue is null and outActive is false.",
    ))
}

struct Rampify {
    value: In<f64>,
    out: Out<f64>,
    constant: f64,
}

impl Primitive for Rampify {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let value = self.value.get(cycle);
        self.out
            .set(cycle, value.map(|x| rampify(x, self.constant)));
    }
}

fn rampify_definition() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Rampify, Fault> {
        let constant = b.double("Constant", 0.0..=1.0)?;
        Ok(Rampify {
            value: b.input("inValue")?,
            out: b.output("outValue"),
            constant,
        })
    };
    Definition::new(
        "Core::Rampify",
        "Converts time to position along a motion that starts and ends at rest: constant \
         acceleration, constant velocity, constant deceleration.",
        build,
    )
    .active()
    .input::<f64>(port("inValue", "part of the time that has passed, 0 to 1").required())
    .parameter::<f64>(
        "Constant",
        "0.5",
        "part of the time at constant velocity, 0 to 1",
    )
    .output::<f64>("outValue", "part of the path, 0 to 1")
}

const VALUE: &[(&str, &str)] = &[("outValue", "position on the curve, in the unit of its ends")];

const fn ends() -> [Port; 2] {
    [
        port("inFrom", "start of the curve").or("From", "0"),
        port("inTo", "end of the curve").or("To", "0"),
    ]
}

fn lerp() -> Definition {
    let [from, to] = ends();
    let amount = port(
        "inAmount",
        "part of the path; 0 is From, 1 is To, others extrapolate",
    )
    .required();
    function(
        "Core::Lerp",
        "The point on the straight line between two values.",
        &[from, to, amount],
        VALUE,
        |(from, to, amount): (f64, f64, f64)| Some((from + amount * (to - from),)),
    )
    .active()
}

const PARAMETER: Port = port("inValue", "parameter of the curve, 0 at From to 1 at To").required();

fn double_bezier() -> Definition {
    let [from, to] = ends();
    let from_vel = port("inFromVel", "slope at From per unit of inValue").or("FromVel", "0");
    let to_vel = port("inToVel", "slope at To per unit of inValue").or("ToVel", "0");
    function(
        "Core::DoubleBezier",
        "The cubic curve between two values with given slopes at its ends.",
        &[from, to, from_vel, to_vel, PARAMETER],
        VALUE,
        |(from, to, from_vel, to_vel, t): (f64, f64, f64, f64, f64)| {
            Some((bezier(t, hermite(from, to, from_vel, to_vel)),))
        },
    )
}

fn cubic_bezier() -> Definition {
    let [from, to] = ends();
    let first = port("inControl1", "first control point").or("Control1", "0");
    let second = port("inControl2", "second control point").or("Control2", "0");
    function(
        "Core::CubicBezier",
        "The cubic Bézier curve between two values with given control points.",
        &[from, to, first, second, PARAMETER],
        VALUE,
        |(from, to, first, second, t): (f64, f64, f64, f64, f64)| {
            Some((bezier(t, [from, first, second, to]),))
        },
    )
    .active()
}

pub(crate) fn table() -> Vec<Definition> {
    vec![
        interval_definition(),
        lerp(),
        rampify_definition(),
        double_bezier(),
        cubic_bezier(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::series;

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    #[test]
    fn interval_by_value() {
        for (value, expected) in [
            (-1.0, (0.0, false)),
            (2.0, (0.0, true)),
            (3.0, (0.5, true)),
            (4.0, (1.0, true)),
            (4.1, (1.0, false)),
        ] {
            assert_eq!(interval(value, 2.0, 4.0), expected, "{value}");
        }
        assert_eq!(interval(2.0, 2.0, 2.0), (0.0, true));
        assert_eq!(interval(f64::INFINITY, 0.0, f64::MAX), (1.0, false));
        let (part, inside) = interval(f64::NAN, 0.0, 1.0);
        assert!(part.is_nan() && !inside);
    }

    #[test]
    fn interval_inactive_is_false_null_is_null() {
        let on = "on=Core::BooleanValue(Value='false')";
        let net = format!(
            "{on},i=Core::Interval(inValue=x.outValue,inActive=on.outValue),x=Core::DoubleValue()"
        );
        assert_eq!(
            series(&net, "Core::Boolean", "i.outActive", 2),
            ["false", "false"]
        );
        assert_eq!(series(&net, "Core::Double", "i.outValue", 1), ["null"]);
        let net = "x=Core::DoublePre(inValue=y.outValue),y=Core::DoubleValue(Value='250'),\
                   i=Core::Interval(inValue=x.outValue)";
        assert_eq!(
            series(net, "Core::Boolean", "i.outActive", 2),
            ["null", "true"]
        );
        assert_eq!(
            series(net, "Core::Double", "i.outValue", 2),
            ["null", "0.25"]
        );
    }

    #[test]
    fn rampify_is_smooth_symmetric_and_bounded() {
        for constant in [0.0, 0.3, 0.5, 1.0] {
            assert!(near(rampify(0.0, constant), 0.0), "{constant}");
            assert!(near(rampify(0.5, constant), 0.5), "{constant}");
            assert!(near(rampify(1.0, constant), 1.0), "{constant}");
            let mut last = 0.0;
            for i in 0..=1000 {
                let x = f64::from(i) / 1000.0;
                let y = rampify(x, constant);
                assert!(y >= last && y - last <= 2.001e-3, "{constant} {x}");
                assert!(near(y, 1.0 - rampify(1.0 - x, constant)), "{constant} {x}");
                last = y;
            }
        }
        assert!(near(rampify(0.25, 0.5), 1.0 / 6.0));
        assert!(near(rampify(-3.0, 0.5), 0.0) && near(rampify(7.0, 0.5), 1.0));
        assert!(rampify(f64::NAN, 0.5).is_nan());
    }

    #[test]
    fn rampify_rejects_part_above_one() {
        let net = "r=Core::Rampify(inValue=x.outValue,Constant='1.5'),x=Core::DoubleValue()";
        let faults = crate::bench::faults(net, "Core::Double", "r.outValue");
        assert_eq!(
            faults,
            ["1:47: parameter `Constant`: 1.5 is not between 0 and 1"]
        );
    }

    #[test]
    fn bezier_has_its_ends_and_slopes() {
        let p = hermite(2.0, 5.0, 4.0, -1.0);
        assert!(near(bezier(0.0, p), 2.0) && near(bezier(1.0, p), 5.0));
        let h = 1e-6;
        assert!(((bezier(h, p) - 2.0) / h - 4.0).abs() < 1e-4);
        assert!(((5.0 - bezier(1.0 - h, p)) / h + 1.0).abs() < 1e-4);
        // A straight line is reproduced.
        assert!(near(bezier(0.3, hermite(1.0, 2.0, 1.0, 1.0)), 1.3));
    }

    #[test]
    fn shape_primitives_compute_their_functions() {
        let of = |primitive: &str| {
            let net = format!("p={primitive},x=Core::DoubleValue(Value='0.5')");
            series(&net, "Core::Double", "p.outValue", 1).remove(0)
        };
        assert_eq!(
            of("Core::Lerp(inAmount=x.outValue,From='10',To='20')"),
            "15"
        );
        assert_eq!(of("Core::Rampify(inValue=x.outValue)"), "0.5");
        let double = "Core::DoubleBezier(inValue=x.outValue,From='1',To='3',FromVel='2',ToVel='2')";
        assert_eq!(of(double), "2");
        let cubic =
            "Core::CubicBezier(inValue=x.outValue,From='0',Control1='8',Control2='8',To='0')";
        assert_eq!(of(cubic), "6");
    }
}
