//! Bounds on a value, on its change and on its chatter: clamps, dead bands, rate limiters, debouncing.
//! Limits on acceleration are kept by the online generators of motions.

use super::linear::{Approach, Length, finite, shorter};
use crate::definition::{Build, Definition, NullRule, Port, Primitive, function, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::text::TextValue;
use crate::value::{Frame, Rotation, Twist, Vector};

const VALUE: &[(&str, &str)] = &[("outValue", "result, in the unit of the value")];

const fn value(doc: &'static str) -> Port {
    port("inValue", doc).required()
}

/// `None` if `min` is greater than `max`, or a bound is not a number. A value that is not a number
/// stays.
fn clamp<T: PartialOrd>(value: T, min: T, max: T) -> Option<T> {
    if min > max || min.partial_cmp(&max).is_none() {
        None
    } else if value < min {
        Some(min)
    } else if value > max {
        Some(max)
    } else {
        Some(value)
    }
}

fn clamps() -> [Definition; 3] {
    fn number<T: TextValue + PartialOrd>(min: &'static str, max: &'static str) -> Definition {
        function(
            format!("{}Clamp", T::PREFIX),
            "The value between two bounds; null if the lower one is greater.",
            &[
                value("value to bound"),
                port("inMin", "lower bound").or("Min", min),
                port("inMax", "upper bound").or("Max", max),
            ],
            VALUE,
            |(value, min, max): (T, T, T)| Some((clamp(value, min, max)?,)),
        )
    }
    [
        number::<f64>("-inf", "+inf"),
        number::<i32>("-2147483648", "2147483647"),
        function(
            "World::VectorClamp",
            "The vector, shortened to a length at most; null if that is negative.",
            &[
                value("vector to bound"),
                port("inMax", "upper bound on the length").or("Max", "+inf"),
            ],
            VALUE,
            |(value, max): (Vector, f64)| (max >= 0.0).then(|| (value.shortened(max),)),
        ),
    ]
}

/// The part of a value that is longer than `width`; `None` if that is negative.
fn beyond<T: Length>(value: T, width: f64) -> Option<T> {
    let length = value.length();
    if width.is_nan() || width < 0.0 {
        None
    } else if length <= width {
        Some(T::default())
    } else {
        Some(value.combine((length - width) / length, T::default(), 0.0))
    }
}

fn dead_band<T: Length>() -> Definition {
    function(
        format!("{}DeadBand", T::PREFIX),
        "Zero up to the width, and what is beyond it without a step: the value minus the width in \
         its direction. Null if the width is negative.",
        &[
            value("value, such as a deflection or a force"),
            port("inWidth", "half of the band, in the unit of the value").or("Width", "0"),
        ],
        VALUE,
        |(value, width): (T, f64)| Some((beyond(value, width)?,)),
    )
}

/// A value whose change can be bounded by one or two rates.
trait Rated: Approach {
    /// The in ports of the rates.
    const RATES: &'static [Port];

    /// The value after a change to `goal` by at most `most`.
    fn step(self, goal: Self, most: [f64; 2]) -> Self;
}

const fn rate(doc: &'static str) -> Port {
    port("inRate", doc).or("Rate", "1")
}
const TRANS_RATE: &str = "inMaxTransVel";
const ROT_RATE: &str = "inMaxRotVel";

/// The part of a path that is `most` long.
fn part(most: f64, length: f64) -> f64 {
    if length > most { most / length } else { 1.0 }
}

/// As [`Approach::towards`], and exactly `goal` once it is near enough.
fn straight<T: Length>(from: T, goal: T, most: f64) -> T {
    let path = goal.combine(1.0, from, -1.0);
    if path.length() <= most {
        return goal;
    }
    from.combine(1.0, path.shortened(most), 1.0)
}

fn turned(from: Rotation, goal: Rotation, most: f64) -> Rotation {
    let angle = shorter(from.inverse() * goal).norm();
    from.towards(goal, part(most, angle))
}

impl Rated for f64 {
    const RATES: &'static [Port] = &[rate("largest change, in the unit of the value per second")];

    fn step(self, goal: Self, [most, _]: [f64; 2]) -> Self {
        straight(self, goal, most)
    }
}

impl Rated for Vector {
    const RATES: &'static [Port] = &[rate("largest change, in the unit of the value per second")];

    fn step(self, goal: Self, [most, _]: [f64; 2]) -> Self {
        straight(self, goal, most)
    }
}

impl Rated for Rotation {
    const RATES: &'static [Port] = &[rate("largest rotational speed, rad/s")];

    fn step(self, goal: Self, [most, _]: [f64; 2]) -> Self {
        turned(self, goal, most)
    }
}

impl Rated for Frame {
    const RATES: &'static [Port] = &[
        port(TRANS_RATE, "largest speed, m/s").or("MaxTransVel", "1"),
        port(ROT_RATE, "largest rotational speed, rad/s").or("MaxRotVel", "1"),
    ];

    fn step(self, goal: Self, [trans, rot]: [f64; 2]) -> Self {
        let position = straight(self.translation.vector, goal.translation.vector, trans);
        Self::from_parts(position.into(), turned(self.rotation, goal.rotation, rot))
    }
}

impl Rated for Twist {
    const RATES: &'static [Port] = &[
        port("inMaxTransAcc", "largest acceleration, m/s²").or("MaxTransAcc", "1"),
        port("inMaxRotAcc", "largest rotational acceleration, rad/s²").or("MaxRotAcc", "1"),
    ];

    fn step(self, goal: Self, [trans, rot]: [f64; 2]) -> Self {
        Self {
            vel: straight(self.vel, goal.vel, trans),
            rot: straight(self.rot, goal.rot, rot),
        }
    }
}

struct RateLimiter<T> {
    value: In<T>,
    rates: [In<f64>; 2],
    reset: In<bool>,
    out: Out<T>,
    last: Option<T>,
    period_s: f64,
}

impl<T: Rated> RateLimiter<T> {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let [first, last] = [T::RATES.first(), T::RATES.last()].map(|port| port.map(Port::name));
        Ok(Self {
            value: b.input("inValue")?,
            rates: [
                b.input(first.unwrap_or_default())?,
                b.input(last.unwrap_or_default())?,
            ],
            reset: b.input("inReset")?,
            out: b.output("outValue"),
            last: None,
            period_s: b.period_s(),
        })
    }

    fn next(&self, cycle: &Cycle<'_>) -> Option<T> {
        let goal = finite(self.value.get(cycle)?)?;
        let [first, second] = self.rates.map(|rate| {
            let rate = rate.get(cycle)?;
            (rate >= 0.0).then_some(rate * self.period_s)
        });
        let most = [first?, second?];
        finite(self.last.map_or(goal, |last| last.step(goal, most)))
    }
}

impl<T: Rated> Primitive for RateLimiter<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.last = None;
        }
        let next = self.next(cycle);
        self.last = next.or(self.last);
        self.out.set(cycle, next);
    }
}

fn rate_limiter<T: Rated>() -> Definition {
    let doc = "The input, followed no faster than allowed: in one cycle the output changes by at \
               most the rate times the period, straight towards the input. It starts at the first \
               input, and after a reset again.";
    let definition = Definition::new(
        format!("{}RateLimiter", T::PREFIX),
        doc,
        RateLimiter::<T>::new,
    )
    .cost_ns(200)
    .stateful()
    .input::<T>(value("value to follow"));
    let with_rate = |definition: Definition, rate: &Port| definition.input::<f64>(*rate);
    T::RATES
        .iter()
        .fold(definition, with_rate)
        .output::<T>("outValue", "the value within its rate")
        .null(NullRule::Requires(
            "Null if an input is null or not finite, or a rate is negative. The output then \
             stays where it was and continues from there.",
        ))
}

/// Counts how long the input differs from the output.
struct Debounce {
    value: In<bool>,
    reset: In<bool>,
    out: Out<bool>,
    /// Cycles that the input must last to switch on, and off.
    on: usize,
    off: usize,
    state: bool,
    count: usize,
}

impl Debounce {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        Ok(Self {
            value: b.input("inValue")?,
            reset: b.input("inReset")?,
            out: b.output("outValue"),
            on: b.cycles_in("OnTime", b.value("OnTime")?)?,
            off: b.cycles_in("OffTime", b.value("OffTime")?)?,
            state: false,
            count: 0,
        })
    }

    fn next(&mut self, value: bool) -> bool {
        self.count = if value == self.state {
            0
        } else {
            self.count + 1
        };
        let most = if value { self.on } else { self.off };
        if self.count >= most {
            (self.state, self.count) = (value, 0);
        }
        self.state
    }
}

impl Primitive for Debounce {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            (self.state, self.count) = (false, 0);
        }
        let value = self.value.get(cycle);
        if value.is_none() {
            self.count = 0;
        }
        let next = value.map(|value| self.next(value));
        self.out.set(cycle, next);
    }
}

fn debounce() -> Definition {
    Definition::new(
        "Core::BooleanDebounce",
        "Becomes true once the input was true in all cycles of OnTime, this one included, and false once \
         it was false in all of OffTime. It starts false. A time of 0 follows at once.",
        Debounce::new,
    )
    .stateful()
    .input::<bool>(port("inValue", "value that may chatter").required())
    .parameter::<f64>("OnTime", "0.01", "how long it must be true, s")
    .parameter::<f64>("OffTime", "0.01", "how long it must be false, s")
    .output::<bool>("outValue", "the settled value")
    .null(NullRule::Requires(
        "Null in gives null out. The state is kept, and the time that the input must last starts \
         again.",
    ))
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = Vec::from(clamps());
    table.extend([
        dead_band::<f64>(),
        dead_band::<Vector>(),
        rate_limiter::<f64>(),
        rate_limiter::<Vector>(),
        rate_limiter::<Rotation>(),
        rate_limiter::<Frame>(),
        rate_limiter::<Twist>(),
        debounce(),
    ]);
    table
}
