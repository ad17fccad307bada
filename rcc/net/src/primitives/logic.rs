//! Boolean primitives. Null is "unknown" in the gates: three-valued logic after Kleene.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

struct Gate {
    first: In<bool>,
    second: In<bool>,
    value: Out<bool>,
    /// The input value that decides the output whatever the other input is.
    decides: bool,
}

impl Primitive for Gate {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let (first, second) = (self.first.get(cycle), self.second.get(cycle));
        let decisive = Some(self.decides);
        let value = if first == decisive || second == decisive {
            decisive
        } else {
            first.and(second)
        };
        self.value.set(cycle, value);
    }
}

fn gate(name: &str, doc: &'static str, decides: bool) -> Definition {
    // An input that is not connected must not decide.
    let neutral = if decides { "false" } else { "true" };
    let build = move |b: &mut Build<'_, '_>| -> Result<Gate, Fault> {
        Ok(Gate {
            first: b.input("inFirst")?,
            second: b.input("inSecond")?,
            value: b.output("outValue"),
            decides,
        })
    };
    Definition::new(name, doc, build)
        .input::<bool>(port("inFirst", "first operand").or("First", neutral))
        .input::<bool>(port("inSecond", "second operand").or("Second", neutral))
        .output::<bool>("outValue", "result")
        .null(NullRule::Kleene)
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        gate("Core::BooleanAnd", "True if both inputs are true.", false),
        gate(
            "Core::BooleanOr",
            "True if one of the inputs is true.",
            true,
        ),
        crate::function(
            "Core::BooleanNot",
            "True if the input is false.",
            &[port("inValue", "operand").or("Value", "false")],
            &[("outValue", "result")],
            |(value,): (bool,)| Some((!value,)),
        ),
    ]
}
