//! Exchange of values between a net and programs that are not real time.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::primitives::generic::zero;
use crate::slots::{In, Out};
use crate::value::text::TextValue;
use crate::value::{Frame, Nanos, Rotation, Twist, Vector, Wrench};

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
                cycle
                    .outbox
                    .store(self.at, value, cycle.moment.time.0.cast_unsigned());
            }
            None => cycle.outbox.hold(self.at),
        }
    }
}

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
        .text(
            "Key",
            "name of the value; programs write to `in` and this name",
        )
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
        .text(
            "Key",
            "name of the value; programs read `out` and this name",
        )
        .parameter::<bool>("Report", "true", "whether programs and rules see it")
        .null(NullRule::Own(
            "Programs keep seeing the last value that was not null.",
        ))
}

fn family<T: TextValue>() -> [Definition; 2] {
    [netcomm_in::<T>(), netcomm_out::<T>()]
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
