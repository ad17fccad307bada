//! Exchange of values between nets of one controller. A value arrives in the cycle after the one
//! that wrote it, whatever the order of evaluation; the executor transfers it.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::netcomm::INTER_STATUS;
use crate::plan::Cycle;
use crate::slots::{ArrayIn, ArrayOut, In, Out};
use crate::value::text::TextValue;
use crate::value::{Frame, Nanos, Rotation, Twist, Vector, Wrench};

struct InterNetcommIn<T> {
    at: usize,
    value: Out<T>,
    updated: Out<Nanos>,
}

impl<T: TextValue> Primitive for InterNetcommIn<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let time = cycle.inbox.inter_time(self.at);
        let value = time.map(|_| cycle.inbox.load::<T>(self.at + INTER_STATUS, 0));
        self.value.set(cycle, value);
        let time = time.map(|word| Nanos(word.cast_signed()));
        self.updated.set(cycle, time);
    }
}

struct ArrayInterNetcommIn<T> {
    at: usize,
    value: ArrayOut<T>,
    updated: Out<Nanos>,
}

impl<T: TextValue> Primitive for ArrayInterNetcommIn<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let time = cycle.inbox.inter_time(self.at);
        if time.is_some() {
            let at = self.at + INTER_STATUS;
            let elements = 0..self.value.len();
            let values = elements.map(|i| cycle.inbox.load::<T>(at, i));
            self.value.set(cycle, values);
        } else {
            self.value.set_null(cycle);
        }
        let time = time.map(|word| Nanos(word.cast_signed()));
        self.updated.set(cycle, time);
    }
}

struct InterNetcommOut<T> {
    at: usize,
    value: In<T>,
}

impl<T: TextValue> Primitive for InterNetcommOut<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        match self.value.get(cycle) {
            Some(value) => {
                let time = cycle.moment.time.0.cast_unsigned();
                cycle.outbox.store(self.at, value, time);
            }
            None => cycle.outbox.hold(self.at),
        }
    }
}

struct ArrayInterNetcommOut<T> {
    at: usize,
    value: ArrayIn<T>,
}

impl<T: TextValue> Primitive for ArrayInterNetcommOut<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let Some(array) = self.value.get(cycle) else {
            cycle.outbox.hold(self.at);
            return;
        };
        let mut changed = false;
        for (i, cell) in array.iter().enumerate() {
            changed |= cycle.outbox.store_element(self.at, i, cell.get());
        }
        let time = cycle.moment.time.0.cast_unsigned();
        cycle.outbox.finish_array(self.at, changed, time);
    }
}

const RCC: &str = "ignored; the other net runs in the same controller";
const NET: &str = "the other net, such as rpinet0; it must be loaded before this one";
const KEY_OUT: &str = "`Key` of the NetcommOut in the other net";
const KEY_IN: &str = "`Key` of the NetcommIn in the other net";
const NULL_IN: &str = "null while the value of the other net is null, before its first value, and once it is \
                       unloaded; after its end its last value stays.";
const NULL_OUT: &str = "Null is not passed on: the other net keeps its value.";
const VALUE: &str = "value of the other net at the end of its last cycle";
const UPDATED: &str = "logical time at which the other net changed it, ns";

fn addressed(definition: Definition, key: &'static str) -> Definition {
    definition
        .text("RemoteRCC", RCC)
        .text("RemoteNet", NET)
        .text("RemoteKey", key)
}

fn scalar_in<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<InterNetcommIn<T>, Fault> {
        let (at, _) = b.inter_in::<T>(false)?;
        let (value, updated) = (b.output("outValue"), b.output("outLastUpdated"));
        Ok(InterNetcommIn { at, value, updated })
    };
    let doc = "The value of a NetcommOut of another net.";
    let name = format!("{}InterNetcommIn", T::PREFIX);
    addressed(Definition::new(name, doc, build), KEY_OUT)
        .output::<T>("outValue", VALUE)
        .output::<Nanos>("outLastUpdated", UPDATED)
        .null(NullRule::Own(NULL_IN))
}

fn array_in<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<ArrayInterNetcommIn<T>, Fault> {
        let (at, len) = b.inter_in::<T>(true)?;
        let (value, updated) = (b.array_output("outValue", len)?, b.output("outLastUpdated"));
        Ok(ArrayInterNetcommIn { at, value, updated })
    };
    let doc = "The array of an ArrayNetcommOut of another net; it has the same size.";
    let name = format!("{}ArrayInterNetcommIn", T::PREFIX);
    addressed(Definition::new(name, doc, build), KEY_OUT)
        .array_output::<T>("outValue", VALUE)
        .output::<Nanos>("outLastUpdated", UPDATED)
        .null(NullRule::Own(NULL_IN))
}

fn scalar_out<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<InterNetcommOut<T>, Fault> {
        let value = b.input("inValue")?;
        let at = b.inter_out::<T>(None)?;
        Ok(InterNetcommOut { at, value })
    };
    let doc = "Writes a value to a NetcommIn of another net, whenever it changes.";
    let name = format!("{}InterNetcommOut", T::PREFIX);
    let port = port("inValue", "the value");
    addressed(Definition::new(name, doc, build).input::<T>(port), KEY_IN)
        .null(NullRule::Own(NULL_OUT))
}

fn array_out<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<ArrayInterNetcommOut<T>, Fault> {
        let value: ArrayIn<T> = b.array_input("inValue")?;
        let at = b.inter_out::<T>(Some(value.len()))?;
        Ok(ArrayInterNetcommOut { at, value })
    };
    let doc = "Writes an array to an ArrayNetcommIn of another net, whenever it changes.";
    let name = format!("{}ArrayInterNetcommOut", T::PREFIX);
    let port = port("inValue", "the array, of the same size as there");
    addressed(
        Definition::new(name, doc, build).array_input::<T>(port),
        KEY_IN,
    )
    .null(NullRule::Own(NULL_OUT))
}

fn family<T: TextValue>() -> [Definition; 4] {
    [
        scalar_in::<T>(),
        scalar_out::<T>(),
        array_in::<T>(),
        array_out::<T>(),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = Vec::from(family::<bool>());
    table.extend(family::<i32>());
    table.extend(family::<f64>());
    table.extend(family::<Vector>());
    table.extend(family::<Rotation>());
    table.extend(family::<Frame>());
    table.extend(family::<Twist>());
    table.extend(family::<Wrench>());
    table
}
