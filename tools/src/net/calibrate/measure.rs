//! Times one primitive: nets with many, one and none of it are evaluated in turns, each after the caches were filled
//! with something else and once more at once. The table is made elsewhere.

use std::hint::black_box;
use std::time::{Duration, Instant};

use takt_core::device::DeviceTable;
use takt_net::{Cost, Definition, Image, Limits, LoadContext, Moment, Nanos, Plan, Registry, load};

use super::stage::{self, Values};

/// Instances in the net with many of them.
const MANY: usize = 32;
/// Sizes of arrays: a few elements, and many. Some primitives take only as many as an arm has joints.
/// Others as many as a word has bits.
const SMALL: [usize; 3] = [4, 7, 32];
const LARGE: usize = 128;
/// The part of the repetitions that the figure covers.
const COVERED: f64 = 0.99;
/// The part of them that disturbances of the host spare.
const OFTEN: f64 = 0.9;
/// Evaluations before those that count: code and data come into memory.
const WARM_UP: u64 = 3;
/// More than the cache that a core has for itself, bytes.
const CACHE: usize = 4 << 20;
/// Bytes that a cache holds or loses at once.
const LINE: usize = 64;

/// What was measured of a primitive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    /// At most.
    pub(super) cost: Cost,
    /// Median of one step with warm caches, ns.
    pub(super) usual_ns: f64,
}

/// Memory that takes the place of all else in the caches.
pub(super) struct Caches(Vec<u8>);

impl Caches {
    pub(super) fn new() -> Self {
        Self(vec![1; CACHE])
    }

    /// Leaves nothing of what was there before.
    fn fill(&mut self) {
        for byte in self.0.iter_mut().step_by(LINE) {
            *byte = byte.wrapping_add(1);
        }
        black_box(&mut self.0);
    }
}

/// A net as its executor evaluates it: values in, cycle, values out.
struct Subject {
    plan: Plan,
    words: Vec<u64>,
    out: Vec<u64>,
    /// Times of evaluations with cold and with warm caches, ns.
    cold: Vec<f64>,
    warm: Vec<f64>,
}

impl Subject {
    fn load(text: &str, registry: &Registry, devices: &DeviceTable) -> Result<Self, String> {
        let context = LoadContext {
            registry,
            devices,
            period: Duration::from_millis(1),
            limits: Limits::default(),
        };
        let plan = load(text, &context).map_err(|rejection| rejection.to_string())?;
        Ok(Self {
            words: plan.inbox_words().collect(),
            out: vec![0; plan.outbox().words()],
            plan,
            cold: Vec::new(),
            warm: Vec::new(),
        })
    }

    /// One evaluation; returns its time, ns.
    fn evaluate(&mut self, image: &Image, cycle: u64) -> f64 {
        let time = Nanos(i64::try_from(cycle).unwrap_or(0) * 1_000_000);
        let moment = Moment {
            cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        let start = Instant::now();
        self.plan.import(&self.words);
        black_box(self.plan.evaluate(image, moment));
        if self.plan.take_changed() {
            self.plan.export(&mut self.out);
        }
        start.elapsed().as_secs_f64() * 1e9
    }
}

/// Nets with none, one and many instances, with arrays of one size.
struct Group {
    size: usize,
    subjects: [Subject; 3],
}

impl Group {
    fn load(
        definition: &Definition,
        size: usize,
        registry: &Registry,
        devices: &DeviceTable,
    ) -> Result<Self, String> {
        let net = |instances| {
            let text = stage::net(definition, instances, size);
            Subject::load(&text, registry, devices)
        };
        Ok(Self {
            size,
            subjects: [net(0)?, net(1)?, net(MANY)?],
        })
    }

    fn run(&mut self, definition: &Definition, repetitions: usize, caches: &mut Caches) {
        let image = Image::default();
        let mut values = Values::new();
        for subject in &mut self.subjects {
            (1..=WARM_UP).for_each(|cycle| _ = subject.evaluate(&image, cycle));
        }
        let mut cycle = WARM_UP;
        for _ in 0..repetitions {
            let before = values.clone();
            for subject in &mut self.subjects {
                values = before.clone();
                let inbox = subject.plan.inbox();
                values.write(definition, inbox, &mut subject.words, self.size);
                caches.fill();
                let cold = subject.evaluate(&image, cycle + 1);
                let warm = subject.evaluate(&image, cycle + 2);
                subject.cold.push(cold);
                subject.warm.push(warm);
            }
            cycle += 2;
        }
    }

    /// Cost of each of many, and of one, beside that of a net without, ns.
    fn at_most(&self) -> (f64, f64) {
        let [none, one, many] = &self.subjects;
        // Disturbances of the host are not costs of the primitive; an outlier of the net without it must not hide its
        // cost.
        let longer = |times: &[f64], none: &[f64]| {
            let rarely = quantile(times, COVERED) - quantile(none, COVERED);
            let often = quantile(times, OFTEN) - quantile(none, 0.5);
            rarely.max(often)
        };
        let above = |subject: &Subject| {
            let cold = longer(&subject.cold, &none.cold);
            cold.max(longer(&subject.warm, &none.warm)).max(0.0)
        };
        (above(many) / as_f64(MANY), above(one))
    }

    fn usual_ns(&self) -> f64 {
        let [none, _, many] = &self.subjects;
        let above = quantile(&many.warm, 0.5) - quantile(&none.warm, 0.5);
        (above / as_f64(MANY)).max(0.0)
    }

    /// Array elements at the ports of one instance.
    fn elements(&self, definition: &Definition) -> usize {
        let [.., many] = &self.subjects;
        let mut shares = many.plan.cost().shares.iter();
        let share = shares.find(|share| share.primitive == definition.name);
        share.map_or(0, |share| share.elements / share.count)
    }
}

/// Measures one primitive.
///
/// # Errors
/// If no net with it can be loaded, with the reason.
pub(super) fn measure(
    definition: &Definition,
    registry: &Registry,
    repetitions: usize,
    caches: &mut Caches,
) -> Result<Measured, String> {
    let devices = stage::devices().map_err(|error| error.to_string())?;
    let group = |size| Group::load(definition, size, registry, &devices);
    let [few, others @ ..] = SMALL;
    let mut small = others.into_iter().fold(group(few), |found, size| {
        // The first reason is the cause.
        found.or_else(|why| group(size).map_err(|_| why))
    })?;
    small.run(definition, repetitions, caches);
    let elements = small.elements(definition);
    let mut element_ns = 0.0;
    let large = (elements > 0).then(|| group(LARGE)).and_then(Result::ok);
    if let Some(mut large) = large {
        large.run(definition, repetitions, caches);
        let more = as_f64(large.elements(definition)) - as_f64(elements);
        if more > 0.0 {
            element_ns = ((large.at_most().0 - small.at_most().0) / more).max(0.0);
        }
    }
    let (each, one) = small.at_most();
    let ns = (each - element_ns * as_f64(elements)).max(0.0);
    let cost = Cost {
        first_ns: rounded(one - each),
        ns: rounded(ns),
        element_ns: rounded(element_ns),
    };
    Ok(Measured {
        cost,
        usual_ns: rounded(small.usual_ns()),
    })
}

/// To tenths, upwards, and never below 0.
fn rounded(ns: f64) -> f64 {
    (ns.max(0.0) * 10.0).ceil() / 10.0
}

/// The value that a share of the others does not exceed.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of a small number"
    )]
    let at = (as_f64(sorted.len()) * share) as usize;
    let last = sorted.len().saturating_sub(1);
    sorted.get(at.min(last)).copied().unwrap_or(0.0)
}

fn as_f64(count: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
    let number = count as f64;
    number
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_primitive_is_measured() {
        let registry = takt_core::registry();
        let mut caches = Caches::new();
        for definition in registry.definitions() {
            let measured = measure(definition, &registry, 1, &mut caches);
            // Those need a net to exchange values with.
            let is_alone = !definition.name.contains("InterNetcomm");
            assert_eq!(
                measured.is_ok(),
                is_alone,
                "{}: {measured:?}",
                definition.name
            );
        }
    }

    #[test]
    fn cost_of_elements_is_separated_from_base() {
        let registry = takt_core::registry();
        let definition = registry.find("Core::DoubleArraySlice").unwrap();
        let devices = stage::devices().unwrap();
        let group = Group::load(definition, 4, &registry, &devices).unwrap();
        assert!(
            group.elements(definition) >= 5,
            "{}",
            group.elements(definition)
        );
    }

    #[test]
    fn quantiles_leave_the_rest_above() {
        let values: Vec<f64> = (0..100).map(f64::from).collect();
        assert!((quantile(&values, 0.99) - 99.0).abs() < 1e-9);
        assert!((quantile(&values, 0.5) - 50.0).abs() < 1e-9);
        assert!(quantile(&[], 0.5).abs() < 1e-9);
    }
}
