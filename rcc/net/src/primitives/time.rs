//! Clocks. Time in a net is logical: it moves by exactly one period a cycle.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::Nanos;

struct Clock {
    increment: In<f64>,
    reset: In<bool>,
    value: Out<f64>,
    time: f64,
    period_s: f64,
}

impl Primitive for Clock {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.time = 0.0;
        }
        let time = self
            .increment
            .get(cycle)
            .map(|i| self.time + i * self.period_s);
        self.time = time.unwrap_or(self.time);
        self.value.set(cycle, time);
    }
}

struct CycleTime {
    value: Out<f64>,
    period_s: f64,
}

impl Primitive for CycleTime {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.value.set(cycle, self.period_s);
    }
}

struct TimeOf {
    value: Out<Nanos>,
    read: fn(&Cycle<'_>) -> Nanos,
}

impl Primitive for TimeOf {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.value.set(cycle, (self.read)(cycle));
    }
}

fn time_of(name: &str, doc: &'static str, read: fn(&Cycle<'_>) -> Nanos) -> Definition {
    let build = move |b: &mut Build<'_, '_>| -> Result<TimeOf, Fault> {
        Ok(TimeOf {
            value: b.output("outValue"),
            read,
        })
    };
    Definition::new(name, doc, build)
        .output::<Nanos>("outValue", "time, ns")
        .null(NullRule::Own("Never null."))
}

pub(super) fn table() -> Vec<Definition> {
    let clock = |b: &mut Build<'_, '_>| -> Result<Clock, Fault> {
        Ok(Clock {
            increment: b.input("inIncrement")?,
            reset: b.input("inReset")?,
            value: b.output("outValue"),
            time: 0.0,
            period_s: b.period_s(),
        })
    };
    let cycle_time = |b: &mut Build<'_, '_>| -> Result<CycleTime, Fault> {
        Ok(CycleTime {
            value: b.output("outValue"),
            period_s: b.period_s(),
        })
    };
    vec![
        Definition::new(
            "Core::Clock",
            "Time since the primitive became active, times Increment. The first cycle gives one \
             period, not zero; a reset starts anew in the same way.",
            clock,
        )
        .stateful()
        .input::<f64>(port("inIncrement", "seconds per second").or("Increment", "1"))
        .output::<f64>("outValue", "time, s")
        .null(NullRule::Own(
            "While inIncrement is null the clock stands and the output is null.",
        )),
        Definition::new(
            "Core::CycleTime",
            "Time from one cycle to the next.",
            cycle_time,
        )
        .output::<f64>("outValue", "period, s")
        .null(NullRule::Own("Never null.")),
        time_of(
            "Core::TimeNet",
            "Logical time of this cycle: start of the thread plus whole periods, no jitter.",
            |c| c.moment.time,
        ),
        time_of(
            "Core::TimeWall",
            "The clock as read when this cycle began, on the time line of TimeNet.",
            |c| c.moment.wall,
        ),
    ]
}
