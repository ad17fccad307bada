//! A controller with proportional, integral and derivative part. Motions of robots need no controller:
//! their drivers have one.

use super::filter::Slope;
use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

/// The inputs of one cycle.
#[derive(Clone, Copy)]
struct Inputs {
    error: f64,
    measured: f64,
    /// Factors of the error, of its integral and of the derivative of the measurement.
    gains: [f64; 3],
    ahead: f64,
    min: f64,
    max: f64,
}

struct Pid {
    set_point: In<f64>,
    measured: In<f64>,
    gains: [In<f64>; 3],
    ahead: In<f64>,
    bounds: [In<f64>; 2],
    reset: In<bool>,
    out: Out<f64>,
    out_limited: Out<bool>,
    slope: Slope<f64>,
    integral: f64,
    period_s: f64,
}

/// The next integral: without the part of its growth that would only lead the output further beyond
/// the bound at which it is.
fn integral(last: f64, growth: f64, rest: f64, min: f64, max: f64) -> f64 {
    let next = last + growth;
    if growth > 0.0 {
        next.min((max - rest).max(last))
    } else {
        next.max((min - rest).min(last))
    }
}

impl Pid {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        Ok(Self {
            set_point: b.input("inSetPoint")?,
            measured: b.input("inMeasured")?,
            gains: [b.input("inKp")?, b.input("inKi")?, b.input("inKd")?],
            ahead: b.input("inFeedForward")?,
            bounds: [b.input("inMin")?, b.input("inMax")?],
            reset: b.input("inReset")?,
            out: b.output("outValue"),
            out_limited: b.output("outLimited"),
            slope: Slope::new(b, "TimeConstant")?,
            integral: 0.0,
            period_s: b.period_s(),
        })
    }

    /// `None` if an input is null or not finite, or the bounds contradict each other.
    fn inputs(&self, cycle: &Cycle<'_>) -> Option<Inputs> {
        let read = |port: In<f64>| port.get(cycle).filter(|value| value.is_finite());
        let measured = read(self.measured)?;
        let [p, i, d] = self.gains.map(read);
        let (min, max) = (self.bounds[0].get(cycle)?, self.bounds[1].get(cycle)?);
        (min <= max).then_some(())?;
        Some(Inputs {
            error: read(self.set_point)? - measured,
            measured,
            gains: [p?, i?, d?],
            ahead: read(self.ahead)?,
            min,
            max,
        })
    }

    /// The output, and whether it is at a bound. `None` if it is not finite; the state is kept.
    fn next(&mut self, inputs: Inputs) -> Option<(f64, bool)> {
        let Inputs {
            error,
            measured,
            gains: [p, i, d],
            ahead,
            min,
            max,
        } = inputs;
        let slope = self.slope.peek(measured)?;
        let rest = ahead + p * error - d * slope;
        let growth = i * error * self.period_s;
        let integral = integral(self.integral, growth, rest, min, max);
        let wanted = rest + integral;
        let value = wanted.clamp(min, max);
        let parts = [wanted, integral, value];
        if !parts.iter().all(|part| part.is_finite()) {
            return None;
        }
        self.slope.push(measured);
        self.integral = integral;
        Some((value, wanted <= min || wanted >= max))
    }
}

impl Primitive for Pid {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.slope.reset();
            self.integral = 0.0;
        }
        let inputs = self.inputs(cycle);
        if inputs.is_none() {
            self.slope.reset();
        }
        let next = inputs.and_then(|inputs| self.next(inputs));
        self.out.set(cycle, next.map(|(value, _)| value));
        self.out_limited
            .set(cycle, next.map(|(_, is_limited)| is_limited));
    }
}

pub(super) fn table() -> Vec<Definition> {
    let gain = |name, parameter, default, doc| port(name, doc).or(parameter, default);
    vec![
        Definition::new(
            "Core::DoublePID",
            "FeedForward plus Kp times the error (SetPoint minus Measured), plus the integral of Ki times the \
             error, minus Kd times the derivative of Measured: a step of SetPoint gives no peak. \
             Integral and derivative are exact for an error that is constant, and a measurement that is \
             straight, during each cycle. The integral grows only as far as the output reaches its \
             bound, so the output leaves the bound as soon as the error turns.",
            Pid::new,
        )
        .cost_ns(200)
        .stateful()
        .input::<f64>(port("inSetPoint", "wanted value").required())
        .input::<f64>(port("inMeasured", "measured value").required())
        .input::<f64>(gain("inKp", "Kp", "1", "output per error"))
        .input::<f64>(gain("inKi", "Ki", "0", "output per error and second"))
        .input::<f64>(gain("inKd", "Kd", "0", "output per change of Measured in a second"))
        .input::<f64>(gain(
            "inFeedForward",
            "FeedForward",
            "0",
            "output without an error",
        ))
        .input::<f64>(gain("inMin", "Min", "-inf", "lower bound on the output"))
        .input::<f64>(gain("inMax", "Max", "+inf", "upper bound on the output"))
        .parameter::<f64>(
            "TimeConstant",
            "0.01",
            "time constant of the low pass of the derivative, s",
        )
        .output::<f64>("outValue", "the output")
        .output::<bool>("outLimited", "whether the output is at a bound")
        .null(NullRule::Requires(
            "Null if an input is null or not finite, or the bounds contradict each other. The integral is \
             then kept, and the derivative starts again at 0.",
        )),
    ]
}
