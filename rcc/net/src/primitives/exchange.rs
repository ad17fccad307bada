//! Exchange of values between a net and programs that are not real time.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::primitives::generic::zero;
use crate::slots::{ArrayIn, ArrayOut, In, Out};
use crate::value::text::TextValue;
use crate::value::{Element, Nanos};

struct NetcommIn<T> {
    at: usize,
    value: Out<T>,
    updated: Out<Nanos>,
    writes: u64,
    since: Option<Nanos>,
}

impl<T: TextValue> Primitive for NetcommIn<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let writes = cycle.inbox.writes(self.at);
        if writes != self.writes {
            self.writes = writes;
            self.since = Some(cycle.moment.time);
        }
        self.value.set(cycle, cycle.inbox.load::<T>(self.at, 0));
        self.updated.set(cycle, self.since);
    }
}

struct NetcommOut<T> {
    at: usize,
    value: In<T>,
}

impl<T: TextValue> Primitive for NetcommOut<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        match self.value.get(cycle) {
            Some(value) => {
                let time = cycle.moment.time.0.cast_unsigned();
                let changed = cycle.outbox.store(self.at, value, time);
                if changed && T::ELEMENT == Element::Bool {
                    cycle.outbox.results.set(true);
                }
            }
            None => cycle.outbox.hold(self.at),
        }
    }
}

struct ArrayNetcommIn<T> {
    at: usize,
    value: ArrayOut<T>,
    updated: Out<Nanos>,
    writes: u64,
    since: Option<Nanos>,
}

impl<T: TextValue> Primitive for ArrayNetcommIn<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let writes = cycle.inbox.writes(self.at);
        if writes != self.writes {
            self.writes = writes;
            self.since = Some(cycle.moment.time);
        }
        let elements = 0..self.value.len();
        let values = elements.map(|i| cycle.inbox.load::<T>(self.at, i));
        self.value.set(cycle, values);
        self.updated.set(cycle, self.since);
    }
}

struct ArrayNetcommOut<T> {
    at: usize,
    value: ArrayIn<T>,
}

impl<T: TextValue> Primitive for ArrayNetcommOut<T> {
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

const KEY_IN: &str = "name of the value; programs write to `in` followed by this name";
const KEY_OUT: &str = "name of the value; programs read `out` followed by this name";
const REPORT: &str = "whether it is visible to programs and rules";

fn netcomm_in<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<NetcommIn<T>, Fault> {
        let initial = b.value::<T>("Value")?;
        let key = b.text("Key").to_owned();
        Ok(NetcommIn {
            at: b.netcomm_in(&key, false, &[initial])?,
            value: b.output("outValue"),
            updated: b.output("outLastUpdated"),
            writes: 0,
            since: None,
        })
    };
    let doc = "A value that programs can write while the net is loaded.";
    Definition::new(format!("{}NetcommIn", T::PREFIX), doc, build)
        .text("Key", KEY_IN)
        .parameter::<T>("Value", zero::<T>(), "value until a program writes one")
        .output::<T>("outValue", "the value last written")
        .output::<Nanos>("outLastUpdated", "logical time at which it arrived, ns")
        .null(NullRule::Own(
            "outLastUpdated is null until a program writes.",
        ))
}

fn netcomm_out<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<NetcommOut<T>, Fault> {
        let key = b.text("Key").to_owned();
        let report = b.value("Report")?;
        Ok(NetcommOut {
            at: b.netcomm_out::<T>(&key, None, report)?,
            value: b.input("inValue")?,
        })
    };
    let doc = "A value that programs can read; synchronization rules may use Boolean ones.";
    Definition::new(format!("{}NetcommOut", T::PREFIX), doc, build)
        .input::<T>(port("inValue", "the value").or("Value", zero::<T>()))
        .text("Key", KEY_OUT)
        .parameter::<bool>("Report", "true", REPORT)
        .null(NullRule::Own(
            "Programs keep seeing the last value that was not null.",
        ))
}

fn array_netcomm_in<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<ArrayNetcommIn<T>, Fault> {
        let initial = b.array::<T>("Value")?;
        let key = b.text("Key").to_owned();
        Ok(ArrayNetcommIn {
            at: b.netcomm_in(&key, true, &initial)?,
            value: b.array_output("outValue", initial.len())?,
            updated: b.output("outLastUpdated"),
            writes: 0,
            since: None,
        })
    };
    let doc = "An array that programs can write while the net is loaded.";
    Definition::new(format!("{}ArrayNetcommIn", T::PREFIX), doc, build)
        .text("Key", KEY_IN)
        .array_parameter::<T>(
            "Value",
            "[]",
            "array until a program writes one; its size is that of all that follow",
        )
        .array_output::<T>("outValue", "the array last written")
        .output::<Nanos>("outLastUpdated", "logical time at which it arrived, ns")
        .null(NullRule::Own(
            "outLastUpdated is null until a program writes.",
        ))
}

fn array_netcomm_out<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<ArrayNetcommOut<T>, Fault> {
        let value: ArrayIn<T> = b.array_input("inValue")?;
        let key = b.text("Key").to_owned();
        let report = b.value("Report")?;
        Ok(ArrayNetcommOut {
            at: b.netcomm_out::<T>(&key, Some(value.len()), report)?,
            value,
        })
    };
    let doc = "An array that programs can read.";
    Definition::new(format!("{}ArrayNetcommOut", T::PREFIX), doc, build)
        .array_input::<T>(port("inValue", "the array").or("Value", "[]"))
        .text("Key", KEY_OUT)
        .parameter::<bool>("Report", "true", REPORT)
        .null(NullRule::Own(
            "Programs keep seeing the last array that was not null.",
        ))
}

fn family<T: TextValue>() -> [Definition; 4] {
    [
        netcomm_in::<T>(),
        netcomm_out::<T>(),
        array_netcomm_in::<T>(),
        array_netcomm_out::<T>(),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    for_each_type!(family).into_iter().flatten().collect()
}
