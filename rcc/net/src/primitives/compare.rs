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

fn greater<T: TextValue + PartialOrd>() -> Definition {
    function(
        format!("{}Greater", T::PREFIX),
        "Whether first is greater than second.",
        &[
            port("inFirst", "first operand").or("First", "0"),
            port("inSecond", "second operand").or("Second", "0"),
        ],
        &[("outValue", "whether it is")],
        |(a, b): (T, T)| Some((a > b,)),
    )
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        equals::<f64>(|a, b, epsilon| (a - b).abs() <= epsilon),
        equals::<i32>(|a, b, epsilon| i64::from(a.abs_diff(b)) <= i64::from(epsilon)),
        greater::<f64>(),
        greater::<i32>(),
    ]
}
