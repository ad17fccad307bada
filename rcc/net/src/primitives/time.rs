//! Clocks and time arithmetic. Time in a net is logical: it advances by exactly one period each
//! cycle.

use crate::definition::{Build, Definition, NullRule, Primitive, function, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::Nanos;

struct Clock {
    increment: In<f64>,
    reset: In<bool>,
    value: Out<f64>,
    /// Sum of the increments; periods are multiplied in last, so that a clock with whole increments
    /// does not drift.
    ticks: f64,
    period_s: f64,
}

impl Primitive for Clock {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.ticks = 0.0;
        }
        let increment = self.increment.get(cycle).filter(|i| i.is_finite());
        self.ticks += increment.unwrap_or(0.0);
        let time = increment.map(|_| self.ticks * self.period_s);
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

fn difference(first: Nanos, second: Nanos) -> f64 {
    (i128::from(first.0) - i128::from(second.0)) as f64 * 1e-9
}

/// `None` if the sum exceeds 64 bits of nanoseconds.
fn sum(time: Nanos, delta_s: f64) -> Option<Nanos> {
    let delta = (delta_s * 1e9).round();
    // 2^63 is the first double out of range, and -2^63 the last one in range.
    let fits = (-9_223_372_036_854_775_808.0..9_223_372_036_854_775_808.0).contains(&delta);
    #[expect(clippy::cast_possible_truncation, reason = "just checked")]
    let delta = fits.then_some(delta as i64)?;
    time.0.checked_add(delta).map(Nanos)
}

fn arithmetic() -> [Definition; 2] {
    [
        function(
            "Core::TimeDiff",
            "First minus second.",
            &[port("inFirst", "time, ns"), port("inSecond", "time, ns")],
            &[("outValue", "span between them, s")],
            |(first, second): (Nanos, Nanos)| Some((difference(first, second),)),
        ),
        function(
            "Core::TimeAdd",
            "A time plus a span; null if beyond 64 bits.",
            &[port("inTime", "time, ns"), port("inDelta", "span, s")],
            &[("outValue", "time, ns")],
            |(time, delta_s): (Nanos, f64)| Some((sum(time, delta_s)?,)),
        ),
    ]
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = clocks();
    table.extend(arithmetic());
    table
}

fn clocks() -> Vec<Definition> {
    let clock = |b: &mut Build<'_, '_>| -> Result<Clock, Fault> {
        Ok(Clock {
            increment: b.input("inIncrement")?,
            reset: b.input("inReset")?,
            value: b.output("outValue"),
            ticks: 0.0,
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
             period, not zero; a reset restarts in the same way.",
            clock,
        )
        .stateful()
        .input::<f64>(port("inIncrement", "seconds per second").or("Increment", "1"))
        .output::<f64>("outValue", "time, s")
        .null(NullRule::Own(
            "While inIncrement is null or not finite, the clock stops and the output is null.",
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_and_differences_of_extreme_times() {
        assert_eq!(sum(Nanos(5), 1.5), Some(Nanos(1_500_000_005)));
        assert_eq!(sum(Nanos(0), -1e-9), Some(Nanos(-1)));
        for delta in [f64::NAN, f64::INFINITY, 1e10, -1e10] {
            assert_eq!(sum(Nanos(0), delta), None, "{delta}");
        }
        assert_eq!(sum(Nanos(i64::MAX), 1e-9), None);
        assert!(
            (difference(Nanos(i64::MAX), Nanos(i64::MIN)) - 18_446_744_073.709_55).abs() < 1e-4
        );
    }
}
