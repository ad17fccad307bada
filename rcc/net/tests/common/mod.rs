//! A net under test: loads a text, runs cycles of 1 ms and reads its values as a program would. Tables
//! of primitives and of the values that their out ports must have.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::panic,
    clippy::unwrap_used,
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
    try_load_at(text, PERIOD)
}

/// Loads `text` for cycles of that period, or returns its faults.
fn try_load_at(text: &str, period: Duration) -> Result<Plan, Vec<String>> {
    let registry = Registry::core();
    let context = LoadContext {
        registry: &registry,
        devices: &NoDevices,
        period,
        limits: Limits::default(),
    };
    load(text, &context).map_err(|rejection| rejection.lines(text))
}

impl Bench {
    /// Loads `text`, which must have no faults.
    pub fn new(text: &str) -> Self {
        Self::at(text, PERIOD)
    }

    /// Loads `text`, which must have no faults, for cycles of that period.
    pub fn at(text: &str, period: Duration) -> Self {
        let plan =
            try_load_at(text, period).unwrap_or_else(|faults| panic!("{}", faults.join("\n")));
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

/// Whether two texts of values are equal up to rounding.
pub fn close(a: &str, b: &str) -> bool {
    let parts = |text: &str| -> Vec<String> {
        let separators = ['{', '}', '[', ']', ',', ':'];
        text.split(separators).map(str::to_owned).collect()
    };
    let (a, b) = (parts(a), parts(b));
    a.len() == b.len()
        && a.iter()
            .zip(&b)
            .all(|(a, b)| match (a.parse::<f64>(), b.parse::<f64>()) {
                (Ok(a), Ok(b)) => {
                    (a - b).abs() <= 1e-12 * a.abs().max(1.0) || a.total_cmp(&b).is_eq()
                }
                _ => a == b,
            })
}

/// Rows of `primitive | type of the out port, port | value`, evaluated once.
pub fn check(rows: &[(&str, &str, &str)]) {
    for (primitive, out, expected) in rows {
        let (ty, port) = out.split_once(' ').unwrap();
        let mut net = Bench::watching(ty, &format!("p={primitive}"), &format!("p.{port}"));
        let found = net.series(1).remove(0);
        assert!(
            close(&found, expected),
            "{primitive}.{port} is {found}, not {expected}"
        );
    }
}

pub const B: &str = "Core::Boolean outValue";
pub const I: &str = "Core::Int outValue";
pub const D: &str = "Core::Double outValue";
pub const V: &str = "World::Vector outValue";
pub const R: &str = "World::Rotation outValue";
pub const F: &str = "World::Frame outValue";
pub const T: &str = "World::Twist outValue";

/// A source of null of type `ty`.
pub fn null(ty: &str) -> String {
    format!(
        "{ty}SetNull(inValue={ty}Value().outValue,\
         inNull=Core::BooleanValue(Value='true').outValue).outValue"
    )
}

/// Runs a primitive whose ports are fed by `x` of type `ty`, and by the Booleans `r`, `s` and `a`;
/// a row is the value of `x`, the ones of `r`, `s`, `-a` that are set in this cycle, and the
/// expected output.
pub fn over_time(ty: &str, primitive: &str, out: &str, rows: &[(&str, &str, &str)]) {
    let (out_ty, port) = out.split_once(' ').unwrap();
    let children = format!(
        "v=Core::BooleanNetcommIn(Key='null'),x={ty}SetNull(inValue=y.outValue,inNull=v.outValue),\
         y={ty}NetcommIn(Key='x'),r=Core::BooleanNetcommIn(Key='r'),\
         s=Core::BooleanNetcommIn(Key='s'),a=Core::BooleanNetcommIn(Key='a',Value='true'),\
         p={primitive}"
    );
    let mut net = Bench::watching(out_ty, &children, &format!("p.{port}"));
    for (i, (x, set, expected)) in rows.iter().enumerate() {
        let bool = |on: bool| if on { "true" } else { "false" };
        net.write("null", bool(*x == "null"));
        if *x != "null" {
            net.write("x", x);
        }
        net.write("r", bool(set.contains('r')));
        net.write("s", bool(set.contains('s')));
        net.write("a", bool(!set.contains("-a")));
        let found = net.series(1).remove(0);
        assert!(
            close(&found, expected),
            "{primitive}.{port}, row {i}: {found}, not {expected}"
        );
    }
}
