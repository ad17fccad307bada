//! The families with one member for each value type: constants, null, choice and memory.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::Nanos;
use crate::value::text::TextValue;

/// A constant: its slot is set once and never written again.
struct Constant<T> {
    value: T,
    out: Out<T>,
}

impl<T: TextValue> Primitive for Constant<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.out.set(cycle, self.value);
    }
}

struct IsNull<T> {
    value: In<T>,
    out: Out<bool>,
}

impl<T: TextValue> Primitive for IsNull<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.out.set(cycle, self.value.get(cycle).is_none());
    }
}

struct SetNull<T> {
    value: In<T>,
    null: In<bool>,
    out: Out<T>,
}

impl<T: TextValue> Primitive for SetNull<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let null = self.null.get(cycle) != Some(false);
        self.out.set(cycle, self.value.get(cycle).filter(|_| !null));
    }
}

struct Conditional<T> {
    condition: In<bool>,
    if_true: In<T>,
    if_false: In<T>,
    out: Out<T>,
}

impl<T: TextValue> Primitive for Conditional<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let chosen = match self.condition.get(cycle) {
            Some(true) => self.if_true.get(cycle),
            Some(false) => self.if_false.get(cycle),
            None => None,
        };
        self.out.set(cycle, chosen);
    }
}

struct Snapshot<T> {
    snapshot: In<bool>,
    reset: In<bool>,
    value: In<T>,
    out: Out<T>,
    initial: T,
    held: Option<T>,
}

impl<T: TextValue> Primitive for Snapshot<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.held = Some(self.initial);
        }
        if self.snapshot.get(cycle) == Some(true) {
            self.held = self.value.get(cycle);
        }
        self.out.set(cycle, self.held);
    }
}

/// Keeps the value for the next cycle. The value and the count of its cycle are in slots that
/// [`PreEarly`] reads.
struct Pre<T> {
    value: In<T>,
    reset: In<bool>,
    kept: Out<T>,
    kept_in: Out<Nanos>,
}

impl<T: TextValue> Primitive for Pre<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let reset = self.reset.get(cycle) == Some(true);
        self.kept
            .set(cycle, self.value.get(cycle).filter(|_| !reset));
        self.kept_in.set(cycle, Nanos(cycle.count));
    }
}

/// Outputs the value that [`Pre`] kept in the previous cycle; an older one dates from before an
/// inactive period.
struct PreEarly<T> {
    kept: In<T>,
    kept_in: In<Nanos>,
    out: Out<T>,
}

impl<T: TextValue> Primitive for PreEarly<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let fresh = self.kept_in.get(cycle) == Some(Nanos(cycle.count - 1));
        self.out.set(cycle, self.kept.get(cycle).filter(|_| fresh));
    }
}

fn pre<T: TextValue>() -> Definition {
    let late = |b: &mut Build<'_, '_>| -> Result<Pre<T>, Fault> {
        let ((_, kept), (_, kept_in)) = (b.state(0), b.state(1));
        Ok(Pre {
            value: b.input("inValue")?,
            reset: b.input("inReset")?,
            kept,
            kept_in,
        })
    };
    let early = |b: &mut Build<'_, '_>| -> Result<PreEarly<T>, Fault> {
        let ((kept, _), (kept_in, _)) = (b.state(0), b.state(1));
        Ok(PreEarly {
            kept,
            kept_in,
            out: b.output("outValue"),
        })
    };
    let doc = "The input's value of the previous cycle. Links from a Pre may close cycles.";
    Definition::new(format!("{}Pre", T::PREFIX), doc, late)
        .early(early)
        .stateful()
        .input::<T>(port("inValue", "value for the next cycle"))
        .output::<T>("outValue", "value of the previous cycle")
        .null(NullRule::Own(
            "Null in the first cycle and after a cycle in which it was inactive, reset or had \
             a null input.",
        ))
}

fn value<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Constant<T>, Fault> {
        Ok(Constant {
            value: b.value("Value")?,
            out: b.output("outValue"),
        })
    };
    Definition::new(format!("{}Value", T::PREFIX), "A constant.", build)
        .parameter::<T>("Value", zero::<T>(), "the constant")
        .output::<T>("outValue", "the constant")
        .null(NullRule::Own("Never null."))
}

/// The text of the zero of a type, for parameter defaults.
pub(super) fn zero<T: TextValue>() -> &'static str {
    use crate::value::Element;
    match T::ELEMENT {
        Element::Bool => "false",
        Element::Int | Element::Double | Element::Nanos => "0",
        Element::Vector | Element::Rotation | Element::Frame | Element::Twist | Element::Wrench => {
            "{}"
        }
    }
}

fn is_null<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<IsNull<T>, Fault> {
        Ok(IsNull {
            value: b.input("inValue")?,
            out: b.output("outValue"),
        })
    };
    Definition::new(
        format!("{}IsNull", T::PREFIX),
        "Whether the input is null.",
        build,
    )
    .input::<T>(port("inValue", "value to test").required())
    .output::<bool>("outValue", "whether it is null")
    .null(NullRule::Own("Never null."))
}

fn set_null<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<SetNull<T>, Fault> {
        Ok(SetNull {
            value: b.input("inValue")?,
            null: b.input("inNull")?,
            out: b.output("outValue"),
        })
    };
    Definition::new(
        format!("{}SetNull", T::PREFIX),
        "The input, or null on demand.",
        build,
    )
    .input::<T>(port("inValue", "value passed on").required())
    .input::<bool>(port("inNull", "true makes the output null").required())
    .output::<T>("outValue", "the value or null")
}

fn conditional<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Conditional<T>, Fault> {
        Ok(Conditional {
            condition: b.input("inCondition")?,
            if_true: b.input("inTrue")?,
            if_false: b.input("inFalse")?,
            out: b.output("outValue"),
        })
    };
    Definition::new(
        format!("{}Conditional", T::PREFIX),
        "One of two values.",
        build,
    )
    .input::<bool>(port("inCondition", "which one").required())
    .input::<T>(port("inTrue", "value if true").or("True", zero::<T>()))
    .input::<T>(port("inFalse", "value if false").or("False", zero::<T>()))
    .output::<T>("outValue", "the chosen value")
    .null(NullRule::Own(
        "Null if inCondition or the chosen value is null.",
    ))
}

fn snapshot<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Snapshot<T>, Fault> {
        let initial = b.value("Value")?;
        Ok(Snapshot {
            snapshot: b.input("inSnapshot")?,
            reset: b.input("inReset")?,
            value: b.input("inValue")?,
            out: b.output("outValue"),
            initial,
            held: Some(initial),
        })
    };
    let doc = "Follows the input while inSnapshot is true, and holds its last value after.";
    Definition::new(format!("{}Snapshot", T::PREFIX), doc, build)
        .stateful()
        .input::<bool>(port("inSnapshot", "true copies the input").required())
        .input::<T>(port("inValue", "value to copy").required())
        .parameter::<T>("Value", zero::<T>(), "value at the start and after a reset")
        .output::<T>("outValue", "the held value")
        .null(NullRule::Own("Null only if the copied value was null."))
}

fn family<T: TextValue>() -> Vec<Definition> {
    vec![
        value::<T>(),
        is_null::<T>(),
        set_null::<T>(),
        conditional::<T>(),
        snapshot::<T>(),
        pre::<T>(),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = vec![pre::<Nanos>()];
    table.extend(for_each_type!(family).into_iter().flatten());
    table
}
