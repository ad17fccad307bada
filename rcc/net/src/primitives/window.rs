//! Sliding windows over the last cycles: counts of Booleans and means. A cycle in which the input
//! is null or the primitive is skipped does not advance the window.

use crate::definition::{Build, Definition, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::primitives::ring::Ring;
use crate::slots::{In, Out};
use crate::value::text::TextValue;
use crate::value::{Rotation, Vector};

/// Counts the true values among the last Booleans. Those before the start count as false.
struct Booleans {
    value: In<bool>,
    reset: In<bool>,
    none: Out<bool>,
    all: Out<bool>,
    amount: Amount,
    window: Ring<bool>,
    count: u32,
}

/// The form in which the number of true values is returned.
enum Amount {
    Count(Out<i32>),
    Part(Out<f64>),
}

impl Amount {
    fn set(&self, cycle: &Cycle<'_>, counted: Option<(u32, u32)>) {
        match self {
            Self::Count(out) => {
                let count = counted.and_then(|(count, _)| i32::try_from(count).ok());
                out.set(cycle, count);
            }
            Self::Part(out) => {
                let part = counted.map(|(count, of)| f64::from(count) / f64::from(of));
                out.set(cycle, part);
            }
        }
    }
}

impl Booleans {
    fn new(b: &mut Build<'_, '_>, samples: usize, amount: Amount) -> Result<Self, Fault> {
        Ok(Self {
            value: b.input("inValue")?,
            reset: b.input("inReset")?,
            none: b.output("outNone"),
            all: b.output("outAll"),
            amount,
            window: Ring::new(samples, false),
            count: 0,
        })
    }

    /// Adds a value; returns the number of true values and the window length.
    fn push(&mut self, value: bool) -> (u32, u32) {
        let old = self.window.push(value).unwrap_or(false);
        self.count = self.count + u32::from(value) - u32::from(old);
        let of = u32::try_from(self.window.capacity()).unwrap_or(u32::MAX);
        (self.count, of)
    }
}

impl Primitive for Booleans {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.window.clear();
            self.count = 0;
        }
        let counted = self.value.get(cycle).map(|value| self.push(value));
        self.none.set(cycle, counted.map(|(count, _)| count == 0));
        self.all.set(cycle, counted.map(|(count, of)| count == of));
        self.amount.set(cycle, counted);
    }
}

fn booleans(
    name: &str,
    doc: &'static str,
    build: fn(&mut Build<'_, '_>) -> Result<Booleans, Fault>,
) -> Definition {
    Definition::new(name, doc, build)
        .stateful()
        .input::<bool>(port("inValue", "value to count").required())
        .output::<bool>("outNone", "whether none was true")
        .output::<bool>("outAll", "whether all were true")
}

fn last_n() -> Definition {
    booleans(
        "Core::BooleanLastN",
        "How many of the last Count values were true. Cycles before the start count as false.",
        |b| {
            let samples = b.number("Count", 1..=b.limits().history)?;
            b.take_memory(samples)?;
            let amount = Amount::Count(b.output("outCount"));
            Booleans::new(b, samples, amount)
        },
    )
    .parameter::<i32>("Count", "1", "length of the window, cycles")
    .output::<i32>("outCount", "how many were true")
}

fn history() -> Definition {
    booleans(
        "Core::BooleanHistory",
        "The part of the last Duration seconds in which the value was true. The time before the start \
         counts as false.",
        |b| {
            let samples = b.history("Duration", 1)?;
            let amount = Amount::Part(b.output("outAmount"));
            Booleans::new(b, samples, amount)
        },
    )
    .parameter::<f64>("Duration", "1", "length of the window, s")
    .output::<f64>("outAmount", "part of the time in which it was true, 0 to 1")
}

/// A value with a mean: `N` numbers.
trait Mean<const N: usize>: TextValue {
    /// The numbers, with the signs with which they may be added to `sum`.
    fn numbers(self, sum: &[f64; N]) -> [f64; N];

    /// The value from the means of its numbers.
    fn mean(means: [f64; N]) -> Option<Self>;
}

impl Mean<1> for f64 {
    fn numbers(self, _: &[f64; 1]) -> [f64; 1] {
        [self]
    }

    fn mean([mean]: [f64; 1]) -> Option<Self> {
        Some(mean)
    }
}

impl Mean<3> for Vector {
    fn numbers(self, _: &[f64; 3]) -> [f64; 3] {
        self.into()
    }

    fn mean(means: [f64; 3]) -> Option<Self> {
        Some(means.into())
    }
}

impl Mean<4> for Rotation {
    /// Of the two quaternions of a rotation, the one nearer to the sum.
    fn numbers(self, sum: &[f64; 4]) -> [f64; 4] {
        let numbers: [f64; 4] = self.into_inner().coords.into();
        let dot: f64 = numbers.iter().zip(sum).map(|(a, b)| a * b).sum();
        numbers.map(|n| if dot < 0.0 { -n } else { n })
    }

    fn mean(means: [f64; 4]) -> Option<Self> {
        Self::try_new(nalgebra::Quaternion::from_vector(means.into()), 1e-9)
    }
}

/// The mean of the last values.
struct Average<T, const N: usize> {
    value: In<T>,
    reset: In<bool>,
    out: Out<T>,
    window: Ring<[f64; N]>,
    sum: [f64; N],
    /// The sum since the start of the ring was last passed. It replaces `sum` after a whole turn,
    /// so that rounding errors do not accumulate.
    fresh: [f64; N],
    /// Number of values in the window that are not finite.
    broken: usize,
}

impl<T: Mean<N>, const N: usize> Average<T, N> {
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let samples = b.history("Duration", size_of::<[f64; N]>())?;
        Ok(Self {
            value: b.input("inValue")?,
            reset: b.input("inReset")?,
            out: b.output("outValue"),
            window: Ring::new(samples, [0.0; N]),
            sum: [0.0; N],
            fresh: [0.0; N],
            broken: 0,
        })
    }

    fn clear(&mut self) {
        self.window.clear();
        (self.sum, self.fresh, self.broken) = ([0.0; N], [0.0; N], 0);
    }

    fn push(&mut self, value: T) -> Option<T> {
        let new = value.numbers(&self.sum);
        if let Some(old) = self.window.push(new) {
            self.broken -= usize::from(!is_finite(&old));
            add(&mut self.sum, &old, -1.0);
        }
        self.broken += usize::from(!is_finite(&new));
        add(&mut self.sum, &new, 1.0);
        add(&mut self.fresh, &new, 1.0);
        if self.window.at_start() {
            self.sum = std::mem::replace(&mut self.fresh, [0.0; N]);
        }
        let samples = f64::from(u32::try_from(self.window.len()).unwrap_or(u32::MAX));
        let mean = T::mean(self.sum.map(|sum| sum / samples));
        mean.filter(|_| self.broken == 0)
    }
}

fn is_finite(numbers: &[f64]) -> bool {
    numbers.iter().all(|n| n.is_finite())
}

/// Adds `numbers` times `sign` to `sum`, if they are finite: others would never leave it.
fn add<const N: usize>(sum: &mut [f64; N], numbers: &[f64; N], sign: f64) {
    if is_finite(numbers) {
        for (sum, n) in sum.iter_mut().zip(numbers) {
            *sum += sign * n;
        }
    }
}

impl<T: Mean<N>, const N: usize> Primitive for Average<T, N> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.clear();
        }
        let mean = self.value.get(cycle).and_then(|value| self.push(value));
        self.out.set(cycle, mean);
    }
}

fn average<T: Mean<N>, const N: usize>() -> Definition {
    let doc = "The mean of the input over the last Duration seconds, or since the start if that \
               is less. Null while a value in the window is not finite.";
    Definition::new(format!("{}Average", T::PREFIX), doc, Average::<T, N>::new)
        .input::<T>(port("inValue", "value to average").required())
        .parameter::<f64>("Duration", "1", "length of the window, s")
        .output::<T>("outValue", "the mean")
}

pub(super) fn table() -> Vec<Definition> {
    let reset = port("inReset", "true empties the window");
    vec![
        last_n(),
        history(),
        average::<f64, 1>().stateful(),
        average::<Vector, 3>().input::<bool>(reset),
        average::<Rotation, 4>().input::<bool>(reset),
    ]
}
