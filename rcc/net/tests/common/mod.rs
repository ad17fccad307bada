//! A net under test: loads a text, runs cycles of 1 ms and reads its values as a program would.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::panic,
    reason = "shared by test files that need different parts"
)]

use std::time::Duration;

use takt_net::netcomm::OutStatus;
use takt_net::{Image, Limits, LoadContext, Moment, Nanos, NoDevices, Plan, Registry, load};

/// A loaded net with its cycle counter.
pub struct Bench {
    /// The net.
    pub plan: Plan,
    /// Devices, which are not driven here.
    pub image: Image,
    /// The inputs of the next cycle.
    pub moment: Moment,
}

/// One period of the nets under test.
pub const PERIOD: Duration = Duration::from_millis(1);

/// Loads `text`, or returns its faults, one per line.
pub fn try_load(text: &str) -> Result<Plan, Vec<String>> {
    let registry = Registry::core();
    let context = LoadContext {
        registry: &registry,
        devices: &NoDevices,
        period: PERIOD,
        limits: Limits::default(),
    };
    load(text, &context).map_err(|rejection| rejection.lines(text))
}

impl Bench {
    /// Loads `text`, which must have no faults.
    pub fn new(text: &str) -> Self {
        let plan = try_load(text).unwrap_or_else(|faults| panic!("{}", faults.join("\n")));
        Self {
            plan,
            image: Image::default(),
            moment: Moment::default(),
        }
    }

    /// Loads children and publishes out port `value` of type `ty` under the key `v`.
    pub fn watching(ty: &str, children: &str, value: &str) -> Self {
        Self::new(&format!(
            "{{{children},watch={ty}NetcommOut(inValue={value},Key='v'),\
             never=Core::BooleanValue(),outTerminate=never.outValue}}"
        ))
    }

    /// Runs one cycle; returns whether the net ends.
    pub fn cycle(&mut self) -> bool {
        self.moment.cycle += 1;
        self.moment.time = Nanos(self.moment.time.0 + 1_000_000);
        self.moment.wall = self.moment.time;
        self.plan.evaluate(&self.image, self.moment)
    }

    /// The text of out value `key`, or `null` if it is null in this cycle.
    pub fn out(&self, key: &str) -> String {
        let entry = self
            .plan
            .outbox()
            .find(&format!("out{key}"))
            .expect("no such out value");
        let mut words = vec![0; self.plan.outbox().words()];
        self.plan.export(&mut words);
        let mut text = String::new();
        match entry.status(&words) {
            OutStatus::Current => entry.format(&words, &mut text),
            OutStatus::Held | OutStatus::Never => text.push_str("null"),
        }
        text
    }

    /// Runs `n` cycles and collects the values of `v`.
    pub fn series(&mut self, n: usize) -> Vec<String> {
        (0..n)
            .map(|_| {
                self.cycle();
                self.out("v")
            })
            .collect()
    }

    /// Writes in value `key`.
    pub fn write(&self, key: &str, text: &str) {
        let mut words: Vec<u64> = self.plan.inbox_words().collect();
        let entry = self
            .plan
            .inbox()
            .find(&format!("in{key}"))
            .expect("no such in value");
        entry.write(text, &mut words).expect("value");
        self.plan.import(&words);
    }
}
