//! Past values. Ages count cycles of the net: cycles that were skipped by an overrun are not
//! counted, and a cycle in which the primitive was skipped is stored as null.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};
use crate::value::Nanos;
use crate::value::text::TextValue;

/// One value per cycle, addressed by the count of its cycle.
struct History<T> {
    samples: Box<[(i64, Option<T>)]>,
    /// Count of the first stored cycle. Overwriting all samples would take long.
    since: i64,
}

impl<T: Copy> History<T> {
    /// Stores this cycle and the span of parameter `MaxAge` before it.
    fn new(b: &mut Build<'_, '_>) -> Result<Self, Fault> {
        let samples = b.history("MaxAge", size_of::<(i64, Option<T>)>())? + 1;
        Ok(Self {
            samples: vec![(-1, None); samples].into_boxed_slice(),
            since: 0,
        })
    }

    fn index(&self, count: i64) -> usize {
        let len = i64::try_from(self.samples.len()).unwrap_or(i64::MAX);
        usize::try_from(count.rem_euclid(len)).unwrap_or(0)
    }

    fn store(&mut self, count: i64, value: Option<T>) {
        let index = self.index(count);
        self.samples[index] = (count, value);
    }

    fn at(&self, count: i64) -> Option<T> {
        let (stored, value) = self.samples[self.index(count)];
        value.filter(|_| stored == count && count >= self.since)
    }

    /// Upper bound on the age, cycles.
    fn reach(&self) -> usize {
        self.samples.len() - 1
    }

    /// Forgets all cycles before `count`.
    const fn clear(&mut self, count: i64) {
        self.since = count;
    }
}

/// A time in cycles, rounded; `None` if negative, not a number or beyond `most`.
fn cycles_of(seconds: f64, period_s: f64, most: usize) -> Option<i64> {
    let cycles = (seconds / period_s).round();
    let most = f64::from(u32::try_from(most).unwrap_or(u32::MAX));
    #[expect(clippy::cast_possible_truncation, reason = "just checked")]
    (0.0..=most).contains(&cycles).then_some(cycles as i64)
}

struct AtTime<T> {
    value: In<T>,
    age: In<f64>,
    out: Out<T>,
    history: History<T>,
    period_s: f64,
}

impl<T: TextValue> Primitive for AtTime<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.history.store(cycle.count, self.value.get(cycle));
        let reach = self.history.reach();
        let back = self.age.get(cycle);
        let back = back.and_then(|age| cycles_of(age, self.period_s, reach));
        let value = back.and_then(|back| self.history.at(cycle.count - back));
        self.out.set(cycle, value);
    }
}

fn at_time<T: TextValue>() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<AtTime<T>, Fault> {
        Ok(AtTime {
            value: b.input("inValue")?,
            age: b.input("inAge")?,
            out: b.output("outValue"),
            history: History::new(b)?,
            period_s: b.period_s(),
        })
    };
    let doc = "The input as it was Age seconds ago, to the nearest cycle; age 0 is this cycle.";
    Definition::new(format!("{}AtTime", T::PREFIX), doc, build)
        .input::<T>(port("inValue", "value to store").required())
        .input::<f64>(port("inAge", "how long ago, s").or("Age", "0"))
        .parameter::<f64>("MaxAge", "1", "how long values are stored, s")
        .output::<T>("outValue", "the value of that time")
        .null(NullRule::Own(
            "Null if the input was null at that time, or the time is before the start, in the \
             future or beyond MaxAge.",
        ))
}

/// Searches for the cycle in which a time stamp was current.
struct TimeHistory {
    value: In<Nanos>,
    time: In<Nanos>,
    reset: In<bool>,
    age: Out<f64>,
    history: History<Nanos>,
    period_s: f64,
}

impl TimeHistory {
    /// Bisects for the newest stamp not after `time`; stamps must not decrease, and cycles without
    /// one have the stamp of the previous cycle.
    fn back_to(&self, count: i64, time: Nanos) -> Option<i64> {
        let reach = i64::try_from(self.history.reach()).unwrap_or(i64::MAX);
        let (mut low, mut high) = (0, reach + 1);
        while low < high {
            let back = i64::midpoint(low, high);
            match self.history.at(count - back) {
                Some(stamp) if stamp > time => low = back + 1,
                _ => high = back,
            }
        }
        self.history.at(count - low).map(|_| low)
    }
}

impl Primitive for TimeHistory {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.history.clear(cycle.count);
        }
        let stamp = self.value.get(cycle);
        let held = stamp.or_else(|| self.history.at(cycle.count - 1));
        self.history.store(cycle.count, held);
        let time = stamp.and_then(|_| self.time.get(cycle));
        let back = time.and_then(|time| self.back_to(cycle.count, time));
        let back = back.and_then(|back| u32::try_from(back).ok());
        self.age
            .set(cycle, back.map(|b| f64::from(b) * self.period_s));
    }
}

fn time_history() -> Definition {
    let build = |b: &mut Build<'_, '_>| -> Result<TimeHistory, Fault> {
        Ok(TimeHistory {
            value: b.input("inValue")?,
            time: b.input("inTime")?,
            reset: b.input("inReset")?,
            age: b.output("outAge"),
            history: History::new(b)?,
            period_s: b.period_s(),
        })
    };
    let doc = "How long ago the newest time stamp that is not after inTime was current. Stamps \
               must not decrease. AtTime with this age gives other values of that moment.";
    Definition::new("Core::TimeHistory", doc, build)
        .stateful()
        .input::<Nanos>(port("inValue", "time stamp of this cycle, ns").required())
        .input::<Nanos>(port("inTime", "time to search for, ns"))
        .parameter::<f64>("MaxAge", "1", "how long stamps are stored, s")
        .output::<f64>("outAge", "how long ago, s")
        .null(NullRule::Own(
            "Null if an input is null or no stored stamp is that old.",
        ))
}

pub(super) fn table() -> Vec<Definition> {
    let mut table = vec![at_time::<Nanos>(), time_history()];
    table.extend(for_each_type!(at_time));
    table
}
