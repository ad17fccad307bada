//! Matching measurements of two sources: the latest two ranges of time whose union is short enough.
//! The values measured in these ranges are retrieved by `AtTime`.

use crate::definition::{Build, Definition, NullRule, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::primitives::ring::Ring;
use crate::slots::{In, Out};
use crate::value::Nanos;

/// A range of time with the count of the cycle in which it arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Range {
    start: i64,
    end: i64,
    count: i64,
}

impl Range {
    fn union(self, other: Self) -> Self {
        Self {
            start: self.start.min(other.start),
            end: self.end.max(other.end),
            count: self.count.min(other.count),
        }
    }

    fn is_within(self, size: i64) -> bool {
        self.end.saturating_sub(self.start) <= size
    }
}

/// The latest range whose union with `range` is at most `size` ns. Ranges of one source must not go
/// back in time, so bisection finds the last one that ends early enough; if that one begins too
/// early, so do all before it.
fn matching(range: Range, others: &Ring<Range>, size: i64) -> Option<Range> {
    let latest = range.start.saturating_add(size);
    let (mut low, mut high) = (0, others.len());
    while low < high {
        let back = usize::midpoint(low, high);
        if others.get(back).is_some_and(|other| other.end > latest) {
            low = back + 1;
        } else {
            high = back;
        }
    }
    let union = others.get(low)?.union(range);
    union.is_within(size).then_some(union)
}

struct ConsistentRange {
    inputs: [(In<Nanos>, In<Nanos>); 2],
    reset: In<bool>,
    start: Out<Nanos>,
    end: Out<Nanos>,
    seen: [Ring<Range>; 2],
    best: Option<Range>,
    size_ns: i64,
    /// Number of cycles for which ranges are stored.
    cycles: i64,
}

impl ConsistentRange {
    fn take(&mut self, source: usize, range: Range) {
        self.seen[source].push(range);
        let found = matching(range, &self.seen[1 - source], self.size_ns);
        if let Some(union) = found.filter(|u| self.best.is_none_or(|best| u.end >= best.end)) {
            self.best = Some(union);
        }
    }
}

impl Primitive for ConsistentRange {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.seen.iter_mut().for_each(Ring::clear);
            self.best = None;
        }
        for source in 0..2 {
            let (start, end) = self.inputs[source];
            if let Some((start, end)) = start.get(cycle).zip(end.get(cycle)) {
                let count = cycle.count;
                let range = Range {
                    start: start.0,
                    end: end.0,
                    count,
                };
                self.take(source, range);
            }
        }
        let oldest = cycle.count - self.cycles;
        self.best = self.best.filter(|best| best.count > oldest);
        self.start
            .set(cycle, self.best.map(|best| Nanos(best.start)));
        self.end.set(cycle, self.best.map(|best| Nanos(best.end)));
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<ConsistentRange, Fault> {
    let size_s: f64 = b.value("MaxSize")?;
    if !(0.0..=1e9).contains(&size_s) {
        let why = format!("{size_s} s is not between 0 and 1e9 s");
        return Err(b.parameter_fault("MaxSize", why));
    }
    let samples = b.history("MaxAge", 2 * size_of::<Range>())?;
    let ring = || Ring::new(samples, Range::default());
    #[expect(clippy::cast_possible_truncation, reason = "just checked")]
    Ok(ConsistentRange {
        inputs: [
            (b.input("inFirstStart")?, b.input("inFirstEnd")?),
            (b.input("inSecondStart")?, b.input("inSecondEnd")?),
        ],
        reset: b.input("inReset")?,
        start: b.output("outStart"),
        end: b.output("outEnd"),
        seen: [ring(), ring()],
        best: None,
        size_ns: (size_s * 1e9).round() as i64,
        cycles: i64::try_from(samples).unwrap_or(i64::MAX),
    })
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        Definition::new(
            "Core::TimeConsistentRange",
            "Of the time ranges of two sources, the latest pair that lies within \
             MaxSize together. The ranges of a source must not go back in time.",
            build,
        )
        .stateful()
        .input::<Nanos>(port(
            "inFirstStart",
            "start of the first source's range, ns",
        ))
        .input::<Nanos>(port("inFirstEnd", "end of the first source's range, ns"))
        .input::<Nanos>(port(
            "inSecondStart",
            "start of the second source's range, ns",
        ))
        .input::<Nanos>(port("inSecondEnd", "end of the second source's range, ns"))
        .parameter::<f64>("MaxSize", "1", "longest that the pair may be together, s")
        .parameter::<f64>("MaxAge", "1", "how long ranges are stored, s")
        .output::<Nanos>("outStart", "earlier start of the pair, ns")
        .output::<Nanos>("outEnd", "later end of the pair, ns")
        .null(NullRule::Own(
            "A source with a null end has no range in that cycle; null while there is no pair.",
        )),
    ]
}
