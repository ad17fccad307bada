//! Fixed arrays. Sizes are known at load time; an index out of range is a fault of the net.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::{Fault, FaultKind};
use crate::plan::Cycle;
use crate::slots::{ArrayIn, ArrayOut, In, Out};
use crate::value::text::TextValue;

struct Array<T> {
    out: ArrayOut<T>,
}

impl<T: TextValue> Primitive for Array<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.out.set(cycle, std::iter::repeat(T::default()));
    }
}

struct Get<T> {
    array: ArrayIn<T>,
    index: usize,
    out: Out<T>,
}

impl<T: TextValue> Primitive for Get<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let element = self.array.get(cycle).and_then(|a| a.get(self.index));
        self.out.set(cycle, element.map(std::cell::Cell::get));
    }
}

struct Set<T> {
    array: ArrayIn<T>,
    value: In<T>,
    index: usize,
    out: ArrayOut<T>,
}

impl<T: TextValue> Primitive for Set<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        match self.array.get(cycle).zip(self.value.get(cycle)) {
            None => self.out.set_null(cycle),
            Some((array, value)) => {
                let other = array.iter().map(std::cell::Cell::get);
                let changed = other.enumerate();
                let element = |(i, old)| if i == self.index { value } else { old };
                self.out.set(cycle, changed.map(element));
            }
        }
    }
}

struct Slice<T> {
    array: ArrayIn<T>,
    start: usize,
    out: ArrayOut<T>,
}

impl<T: TextValue> Primitive for Slice<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        match self.array.get(cycle) {
            None => self.out.set_null(cycle),
            Some(array) => {
                self.out.set(
                    cycle,
                    array.iter().skip(self.start).map(std::cell::Cell::get),
                );
            }
        }
    }
}

struct IsNull<T> {
    array: ArrayIn<T>,
    out: Out<bool>,
}

impl<T: TextValue> Primitive for IsNull<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.out.set(cycle, self.array.get(cycle).is_none());
    }
}

struct SetNull<T> {
    array: ArrayIn<T>,
    null: In<bool>,
    out: ArrayOut<T>,
}

impl<T: TextValue> Primitive for SetNull<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let null = self.null.get(cycle) != Some(false);
        match self.array.get(cycle).filter(|_| !null) {
            None => self.out.set_null(cycle),
            Some(array) => self.out.set(cycle, array.iter().map(std::cell::Cell::get)),
        }
    }
}

const SIZE: (&str, &str) = ("Size", "number of elements");

/// Checks that parameter `Size` is the array's size.
fn size_of_array<T: TextValue>(b: &Build<'_, '_>, array: &ArrayIn<T>) -> Result<usize, Fault> {
    let size = b.number("Size", 1..=b.limits().array_size)?;
    if size != array.len() {
        let message = format!("Size is {size}, but the array has {} elements", array.len());
        return Err(b.fault(FaultKind::ArraySize(message)));
    }
    Ok(size)
}

fn index_within<T: TextValue>(b: &Build<'_, '_>, array: &ArrayIn<T>) -> Result<usize, Fault> {
    let size = size_of_array(b, array)?;
    b.number("Index", 0..=size - 1)
}

fn array<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Array<T>, Fault> {
        let size = b.number("Size", 1..=b.limits().array_size)?;
        Ok(Array {
            out: b.array_output("outArray", size)?,
        })
    };
    Definition::new(format!("{}Array", T::PREFIX), "An array of zeros.", build)
        .parameter::<i32>(SIZE.0, "1", SIZE.1)
        .array_output::<T>("outArray", "the array")
        .null(NullRule::Own("Never null."))
}

fn get<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Get<T>, Fault> {
        let array = b.array_input("inArray")?;
        Ok(Get {
            index: index_within(b, &array)?,
            array,
            out: b.output("outValue"),
        })
    };
    Definition::new(
        format!("{}ArrayGet", T::PREFIX),
        "One element of an array.",
        build,
    )
    .array_input::<T>(port("inArray", "the array").required())
    .parameter::<i32>(SIZE.0, "1", SIZE.1)
    .parameter::<i32>("Index", "0", "which element, from 0")
    .output::<T>("outValue", "the element")
}

fn set<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Set<T>, Fault> {
        let array = b.array_input("inArray")?;
        let index = index_within(b, &array)?;
        let out = b.array_output("outArray", array.len())?;
        Ok(Set {
            array,
            value: b.input("inValue")?,
            index,
            out,
        })
    };
    let doc = "A copy of an array with one element replaced.";
    Definition::new(format!("{}ArraySet", T::PREFIX), doc, build)
        .array_input::<T>(port("inArray", "the array").required())
        .input::<T>(port("inValue", "the new element").required())
        .parameter::<i32>(SIZE.0, "1", SIZE.1)
        .parameter::<i32>("Index", "0", "which element, from 0")
        .array_output::<T>("outArray", "the copy")
}

fn slice<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<Slice<T>, Fault> {
        let array = b.array_input("inArray")?;
        let size = b.number("Size", 1..=b.limits().array_size)?;
        let start = b.number("Start", 0..=b.limits().array_size)?;
        if start + size > array.len() {
            let message = format!(
                "elements {start} to {} are out of range: the array has only {}",
                start + size - 1,
                array.len()
            );
            return Err(b.fault(FaultKind::ArraySize(message)));
        }
        Ok(Slice {
            array,
            start,
            out: b.array_output("outArray", size)?,
        })
    };
    Definition::new(
        format!("{}ArraySlice", T::PREFIX),
        "A part of an array.",
        build,
    )
    .array_input::<T>(port("inArray", "the array").required())
    .parameter::<i32>(SIZE.0, "1", "number of elements of the part")
    .parameter::<i32>("Start", "0", "first element of the part, from 0")
    .array_output::<T>("outArray", "the part")
}

fn is_null<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<IsNull<T>, Fault> {
        Ok(IsNull {
            array: b.array_input("inValue")?,
            out: b.output("outValue"),
        })
    };
    let doc = "Whether the array is null.";
    Definition::new(format!("{}ArrayIsNull", T::PREFIX), doc, build)
        .array_input::<T>(port("inValue", "array to test").required())
        .output::<bool>("outValue", "whether it is null")
        .null(NullRule::Own("Never null."))
}

fn set_null<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<SetNull<T>, Fault> {
        let array = b.array_input("inValue")?;
        let size = size_of_array(b, &array)?;
        Ok(SetNull {
            array,
            null: b.input("inNull")?,
            out: b.array_output("outValue", size)?,
        })
    };
    let doc = "The array, or null on demand.";
    Definition::new(format!("{}ArraySetNull", T::PREFIX), doc, build)
        .array_input::<T>(port("inValue", "array passed on").required())
        .input::<bool>(port("inNull", "true makes the output null").required())
        .parameter::<i32>(SIZE.0, "1", SIZE.1)
        .array_output::<T>("outValue", "the array or null")
}

fn family<T: TextValue>() -> Vec<Definition> {
    vec![
        array::<T>(),
        get::<T>(),
        set::<T>(),
        slice::<T>(),
        is_null::<T>(),
        set_null::<T>(),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    for_each_type!(family).into_iter().flatten().collect()
}
