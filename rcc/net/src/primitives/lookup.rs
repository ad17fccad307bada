//! Tables: a function given by points. Curves over the time of a motion are shapes of motions.

use crate::definition::{Build, Definition, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

struct Table {
    value: In<f64>,
    out: Out<f64>,
    points: Box<[(f64, f64)]>,
}

/// The value at `x` on the straight lines through the points, which are ordered by x. Not a number if
/// `x` is not.
fn interpolate(points: &[(f64, f64)], x: f64) -> f64 {
    let after = points.partition_point(|(at, _)| *at <= x);
    let Some(&(x0, y0)) = after.checked_sub(1).and_then(|i| points.get(i)) else {
        return points.first().map_or(f64::NAN, |(_, y)| *y);
    };
    let Some(&(x1, y1)) = points.get(after) else {
        return y0;
    };
    // Halves do not overflow, and a mean of both values stays between them.
    let part = (x / 2.0 - x0 / 2.0) / (x1 / 2.0 - x0 / 2.0);
    y0 * (1.0 - part) + y1 * part
}

impl Primitive for Table {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let value = self.value.get(cycle).filter(|value| !value.is_nan());
        let found = value.map(|value| interpolate(&self.points, value));
        self.out.set(cycle, found);
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<Table, Fault> {
    let (x, y): (Vec<f64>, Vec<f64>) = (b.array("X")?, b.array("Y")?);
    let is_good = |values: &[f64]| values.iter().all(|value| value.is_finite());
    if x.is_empty() || !is_good(&x) || !x.is_sorted_by(|a, b| a < b) {
        let why = "it must be a list of numbers, each greater than the one before";
        return Err(b.parameter_fault("X", why.to_owned()));
    }
    if y.len() != x.len() || !is_good(&y) {
        let why = format!(
            "it must be a list of {} numbers, one for each of X",
            x.len()
        );
        return Err(b.parameter_fault("Y", why));
    }
    b.take_memory(size_of::<(f64, f64)>() * x.len())?;
    Ok(Table {
        value: b.input("inValue")?,
        out: b.output("outValue"),
        points: x.into_iter().zip(y).collect(),
    })
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        Definition::new(
            "Core::DoubleTable",
            "The function through the points (X, Y), straight between them; before the first and after the \
             last point it keeps their values. Null if the input is not a number.",
            build,
        )
        .active()
        .input::<f64>(port("inValue", "where to read the function").required())
        .array_parameter::<f64>("X", "[0,1]", "input of each point, in ascending order")
        .array_parameter::<f64>("Y", "[0,1]", "output of each point")
        .output::<f64>("outValue", "the value there"),
    ]
}
