//! Filters: integrator, derivative, low passes. Each is the exact solution of its differential equation
//! at the ends of the cycles, for any period; what it takes the input to be between them is in its
//! description. Means of the last values are windows.

use super::linear::{Approach, Length, Linear, finite};
use crate::definition::{Build, Definition, NullRule, Port, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::{Frame, Rotation, Twist, Vector, Wrench};

/// Upper bound on time constants, s.
const SLOWEST_S: f64 = 1e9;
const KEEPS: NullRule = NullRule::Requires(
    "Null if an input is null or not finite; the state is kept, and the filter continues from it.",
);

/// Part of a step that remains after a period, `exp(-T/τ)`, of a time constant parameter; and the
/// part that is made, which near 0 is known more precisely.
pub(super) fn decay(b: &Build<'_, '_>, parameter: &'static str) -> Result<(f64, f64), Fault> {
    let time_s = b.double(parameter, 0.0..=SLOWEST_S)?;
    let exponent = -b.period_s() / time_s;
    Ok((exponent.exp(), -exponent.exp_m1()))
}

fn filter<T: crate::value::text::TextValue, P: Primitive + 'static>(
    name: &str,
    doc: &'static str,
    build: fn(&mut Build<'_, '_>) -> Result<P, Fault>,
) -> Definition {
    Definition::new(format!("{}{name}", T::PREFIX), doc, build)
        .cost_ns(200)
        .stateful()
        .input::<T>(port("inValue", "value to filter").required())
        .null(KEEPS)
}

struct LowPass<T> {
    value: In<T>,
    reset: In<bool>,
    out: Out<T>,
    /// Part of a step that is made in one cycle.
    part: f64,
    last: Option<T>,
}

impl<T: Approach> Primitive for LowPass<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.last = None;
        }
        let value = self.value.get(cycle).and_then(finite);
        let next = value.map(|value| self.last.map_or(value, |l| l.towards(value, self.part)));
        let next = next.and_then(finite);
        self.last = next.or(self.last);
        self.out.set(cycle, next);
    }
}

fn low_pass<T: Approach>() -> Definition {
    filter::<T, _>(
        "LowPass",
        "Low pass of first order, 1/(1+τs), exact for an input that is constant during each cycle: a \
         step is made up to the part exp(-t/τ). It starts at the first input, and after a reset again.",
        |b| {
            Ok(LowPass::<T> {
                value: b.input("inValue")?,
                reset: b.input("inReset")?,
                out: b.output("outValue"),
                part: decay(b, "TimeConstant")?.1,
                last: None,
            })
        },
    )
    .parameter::<f64>(
        "TimeConstant",
        "0.01",
        "time constant τ, s; the cut-off frequency is 1/(2πτ)",
    )
    .output::<T>("outValue", "the value without fast changes")
}

struct LowPass2<T> {
    value: In<T>,
    reset: In<bool>,
    out: Out<T>,
    rate: Out<T>,
    /// State transition over one cycle of the distance to the input and of the rate.
    transition: [[f64; 2]; 2],
    last: Option<(T, T)>,
}

impl<T: Linear> LowPass2<T> {
    fn next(&self, value: T) -> Option<(T, T)> {
        let (last, rate) = self.last.unwrap_or_else(|| (value, T::default()));
        let distance = last.combine(1.0, value, -1.0);
        let [to_distance, to_rate] = self.transition;
        let distance_next = distance.combine(to_distance[0], rate, to_distance[1]);
        let next = finite(value.combine(1.0, distance_next, 1.0))?;
        Some((
            next,
            finite(distance.combine(to_rate[0], rate, to_rate[1]))?,
        ))
    }
}

impl<T: Linear> Primitive for LowPass2<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.last = None;
        }
        let value = self.value.get(cycle).and_then(finite);
        let next = value.and_then(|value| self.next(value));
        self.last = next.or(self.last);
        self.out.set(cycle, next.map(|(value, _)| value));
        self.rate.set(cycle, next.map(|(_, rate)| rate));
    }
}

/// State transition of `y'' = -ω²y - 2ζωy'` over a time: position and rate from those before.
fn transition(omega: f64, damping: f64, time_s: f64) -> [[f64; 2]; 2] {
    let sigma = damping * omega;
    // The decaying cosine, and the decaying sine divided by its frequency.
    let (cosine, sine) = if damping < 1.0 {
        let frequency = omega * ((1.0 - damping) * (1.0 + damping)).sqrt();
        let (angle, decay) = (frequency * time_s, (-sigma * time_s).exp());
        (decay * angle.cos(), decay * angle.sin() / frequency)
    } else {
        let root = omega * ((damping - 1.0) * (damping + 1.0)).sqrt();
        let slow = (-omega * omega / (sigma + root) * time_s).exp();
        let fall = (-2.0 * root * time_s).exp_m1();
        let sine = if root > 0.0 {
            -fall / (2.0 * root)
        } else {
            time_s
        };
        (slow * (2.0 + fall) / 2.0, slow * sine)
    };
    [
        [cosine + sigma * sine, sine],
        [-omega * omega * sine, cosine - sigma * sine],
    ]
}

fn low_pass_2<T: Linear>() -> Definition {
    filter::<T, _>(
        "LowPass2",
        "Low pass of second order, ω²/(s²+2ζωs+ω²) with ω of 2π times Frequency, exact for an input that is \
         constant during each cycle. It starts at rest at the first input, and after a reset again.",
        |b| {
            // Up to these bounds no intermediate result overflows.
            let omega = std::f64::consts::TAU * b.double("Frequency", 1e-9..=1e9)?;
            let damping = b.double("Damping", 0.0..=1e3)?;
            Ok(LowPass2::<T> {
                value: b.input("inValue")?,
                reset: b.input("inReset")?,
                out: b.output("outValue"),
                rate: b.output("outRate"),
                transition: transition(omega, damping, b.period_s()),
                last: None,
            })
        },
    )
    .parameter::<f64>("Frequency", "10", "natural frequency, Hz")
    .parameter::<f64>(
        "Damping",
        "1",
        "damping ratio ζ, 0 to 1e3; at 1 the fastest without overshoot, at 0.7071 the flattest",
    )
    .output::<T>("outValue", "the value without fast changes")
    .output::<T>("outRate", "its change per second")
}

/// A value whose sum over time can be bounded.
trait Bounded: Length {
    /// The in ports of the bounds.
    const BOUNDS: &'static [Port];

    /// The sum within the bounds; `None` if they contradict each other.
    fn bounded(self, bounds: [f64; 2]) -> Option<Self>;
}

impl Bounded for f64 {
    const BOUNDS: &'static [Port] = &[
        port("inMin", "lower bound on the integral").or("Min", "-inf"),
        port("inMax", "upper bound on the integral").or("Max", "+inf"),
    ];

    fn bounded(self, [min, max]: [f64; 2]) -> Option<Self> {
        (min <= max).then(|| self.clamp(min, max))
    }
}

impl Bounded for Vector {
    const BOUNDS: &'static [Port] =
        &[port("inMax", "upper bound on the length of the integral").or("Max", "+inf")];

    fn bounded(self, [max, _]: [f64; 2]) -> Option<Self> {
        (max >= 0.0).then(|| self.shortened(max))
    }
}

struct Integrator<T> {
    value: In<T>,
    bounds: [In<f64>; 2],
    reset: In<bool>,
    out: Out<T>,
    start: T,
    sum: T,
    period_s: f64,
}

impl<T: Bounded> Integrator<T> {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let ends = [T::BOUNDS.first(), T::BOUNDS.last()];
        let [first, last] = ends.map(|port| port.map_or("", Port::name));
        let start = b.value("Value")?;
        if finite(start).is_none() {
            return Err(b.parameter_fault("Value", "it must be finite".to_owned()));
        }
        Ok(Self {
            value: b.input("inValue")?,
            bounds: [b.input(first)?, b.input(last)?],
            reset: b.input("inReset")?,
            out: b.output("outValue"),
            start,
            sum: start,
            period_s: b.period_s(),
        })
    }

    fn next(&self, cycle: &Cycle<'_>) -> Option<T> {
        let value = finite(self.value.get(cycle)?)?;
        let [first, second] = self.bounds.map(|bound| bound.get(cycle));
        let sum = self.sum.combine(1.0, value, self.period_s);
        finite(sum.bounded([first?, second?])?)
    }
}

impl<T: Bounded> Primitive for Integrator<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.sum = self.start;
        }
        let next = self.next(cycle);
        self.sum = next.unwrap_or(self.sum);
        self.out.set(cycle, next);
    }
}

fn integrator<T: Bounded>() -> Definition {
    let definition = filter::<T, _>(
        "Integrator",
        "The integral of the input over time from Value, exact for an input that is constant during each \
         cycle: the first cycle adds one period of it. The sum itself is bounded, so it leaves a bound in \
         the cycle in which the input turns.",
        Integrator::<T>::new,
    );
    let with_bound = |definition: Definition, bound: &Port| definition.input::<f64>(*bound);
    T::BOUNDS
        .iter()
        .fold(definition, with_bound)
        .parameter::<T>(
            "Value",
            super::generic::zero::<T>(),
            "integral at the start and after a reset",
        )
        .output::<T>("outValue", "the integral")
        .null(NullRule::Requires(
            "Null if an input is null or not finite, or the bounds contradict each other; the \
             integral then stays.",
        ))
}

/// The derivative of a value, filtered. Both numbers date from the previous cycle.
pub(super) struct Slope<T> {
    /// Part of the last derivative that remains, and that of the new one.
    parts: (f64, f64),
    period_s: f64,
    last: Option<T>,
    slope: T,
}

impl<T: Linear> Slope<T> {
    pub(super) fn new(b: &Build<'_, '_>, parameter: &'static str) -> Result<Self, Fault> {
        Ok(Self {
            parts: decay(b, parameter)?,
            period_s: b.period_s(),
            last: None,
            slope: T::default(),
        })
    }

    /// Starts again at the next value, with derivative zero.
    pub(super) fn reset(&mut self) {
        (self.last, self.slope) = (None, T::default());
    }

    /// The derivative at `value`; `None` if it is not finite, and then the state is kept.
    pub(super) fn peek(&self, value: T) -> Option<T> {
        let change = value.combine(1.0, self.last.unwrap_or(value), -1.0);
        let (remains, made) = self.parts;
        finite(self.slope.combine(remains, change, made / self.period_s))
    }

    pub(super) fn push(&mut self, value: T) -> Option<T> {
        let slope = finite(value).and_then(|value| self.peek(value))?;
        (self.last, self.slope) = (Some(value), slope);
        Some(slope)
    }
}

struct Derivative<T> {
    value: In<T>,
    reset: In<bool>,
    out: Out<T>,
    slope: Slope<T>,
}

impl<T: Linear> Primitive for Derivative<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let value = self.value.get(cycle);
        if value.is_none() || self.reset.get(cycle) == Some(true) {
            self.slope.reset();
        }
        let slope = value.and_then(|value| self.slope.push(value));
        self.out.set(cycle, slope);
    }
}

fn derivative<T: Linear>() -> Definition {
    filter::<T, _>(
        "Derivative",
        "The change of the input per second through a low pass of first order, s/(1+τs), exact for an input \
         that is straight during each cycle. With a time constant of 0 it is the difference of two \
         cycles divided by the period. The first value gives 0.",
        |b| {
            Ok(Derivative::<T> {
                value: b.input("inValue")?,
                reset: b.input("inReset")?,
                out: b.output("outValue"),
                slope: Slope::new(b, "TimeConstant")?,
            })
        },
    )
    .parameter::<f64>("TimeConstant", "0.01", "time constant τ of the filter, s")
    .output::<T>("outValue", "change per second")
    .null(NullRule::Requires(
        "Null if an input is null or not finite. After null it starts again as with the first value: a \
         change over several cycles is no derivative.",
    ))
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        integrator::<f64>(),
        integrator::<Vector>(),
        derivative::<f64>(),
        derivative::<Vector>(),
        low_pass::<f64>(),
        low_pass::<Vector>(),
        low_pass::<Rotation>(),
        low_pass::<Frame>(),
        low_pass::<Twist>(),
        low_pass::<Wrench>(),
        low_pass_2::<f64>(),
        low_pass_2::<Vector>(),
        low_pass_2::<Twist>(),
        low_pass_2::<Wrench>(),
    ]
}
