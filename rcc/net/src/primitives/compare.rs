//! Comparisons of numbers.

use crate::definition::{Build, Definition, Primitive, function, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::text::TextValue;

struct Equals<T> {
    first: In<T>,
    second: In<T>,
    epsilon: T,
    value: Out<bool>,
    within: fn(T, T, T) -> bool,
}

impl<T: TextValue> Primitive for Equals<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let pair = self.first.get(cycle).zip(self.second.get(cycle));
        self.value
            .set(cycle, pair.map(|(a, b)| (self.within)(a, b, self.epsilon)));
    }
}

fn equals<T: TextValue>(within: fn(T, T, T) -> bool) -> Definition {
    let build = move |b: &mut Build<'_, '_>| -> Result<Equals<T>, Fault> {
        Ok(Equals {
            first: b.input("inFirst")?,
            second: b.input("inSecond")?,
            epsilon: b.value("Epsilon")?,
            value: b.output("outValue"),
            within,
        })
    };
    let doc = "Whether the inputs differ by at most Epsilon.";
    Definition::new(format!("{}Equals", T::PREFIX), doc, build)
        .input::<T>(port("inFirst", "first operand").or("First", "0"))
        .input::<T>(port("inSecond", "second operand").or("Second", "0"))
        .parameter::<T>("Epsilon", "0", "largest difference of equals")
        .output::<bool>("outValue", "whether they are equal")
}

fn comparison<T: TextValue>(
    name: &str,
    doc: &'static str,
    holds: impl Fn(&T, &T) -> bool + Copy + Send + Sync + 'static,
) -> Definition {
    function(
        format!("{}{name}", T::PREFIX),
        doc,
        &[
            port("inFirst", "first operand").or("First", "0"),
            port("inSecond", "second operand").or("Second", "0"),
        ],
        &[("outValue", "whether it is")],
        move |(a, b): (T, T)| Some((holds(&a, &b),)),
    )
}

/// The orders of two numbers. None holds if one of them is not a number.
fn orders<T: TextValue + PartialOrd>() -> [Definition; 4] {
    [
        comparison("Greater", "Whether first is greater than second.", T::gt),
        comparison(
            "GreaterEqual",
            "Whether first is greater than second or equal to it.",
            T::ge,
        ),
        comparison("Less", "Whether first is less than second.", T::lt),
        comparison(
            "LessEqual",
            "Whether first is less than second or equal to it.",
            T::le,
        ),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = vec![
        equals::<f64>(|a, b, epsilon| (a - b).abs() <= epsilon),
        equals::<i32>(|a, b, epsilon| i64::from(a.abs_diff(b)) <= i64::from(epsilon)),
    ];
    table.extend(orders::<f64>());
    table.extend(orders::<i32>());
    table
}
