//! A test fixture for nets of this crate with arms, inputs that change while the net runs and any
//! number of observed outputs. It drives no device.

use std::sync::Arc;
use std::time::Duration;

use takt_net::device::Kinematics;
use takt_net::netcomm::OutStatus;
use takt_net::{
    ArmBinding, Devices, Image, JointLimits, Limits, LoadContext, Moment, Nanos, Plan, Registry,
    load,
};

/// Cycle time of all tests, s.
pub(crate) const PERIOD_S: f64 = 1e-3;

/// One robot arm, named `arm`, or none.
#[derive(Default)]
pub(crate) struct Arm {
    pub(crate) kinematics: Option<Arc<dyn Kinematics>>,
    pub(crate) joints: usize,
}

impl Devices for Arm {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let limits = JointLimits {
            position_min: -2.0,
            position_max: 2.0,
            velocity_max: 1.0,
            acceleration_max: 1.0,
        };
        (name == "arm").then(|| ArmBinding {
            first_joint: 0,
            limits: vec![limits; self.joints].into(),
            kinematics: self.kinematics.clone(),
        })
    }

    fn names(&self) -> Vec<String> {
        vec!["arm".to_owned()]
    }
}

/// A loaded net.
pub(crate) struct Fixture {
    plan: Plan,
    image: Image,
    cycle: u64,
}

impl Fixture {
    /// Loads `children` as the children of a net that never ends.
    pub(crate) fn load(children: &str, arm: &Arm) -> Result<Self, Vec<String>> {
        let mut registry = Registry::core();
        registry.add(crate::all());
        let context = LoadContext {
            registry: &registry,
            devices: arm,
            period: Duration::from_secs_f64(PERIOD_S),
            limits: Limits::default(),
        };
        let text = format!("{{{children},never=Core::BooleanValue(),outTerminate=never.outValue}}");
        let plan = load(&text, &context).map_err(|rejection| rejection.lines(&text))?;
        Ok(Self {
            plan,
            image: Image::default(),
            cycle: 0,
        })
    }

    pub(crate) fn new(children: &str, arm: &Arm) -> Self {
        Self::load(children, arm).unwrap_or_else(|faults| panic!("{}", faults.join("\n")))
    }

    /// Writes the value that the `NetcommIn` with that key outputs from the next cycle on.
    pub(crate) fn write(&mut self, key: &str, value: &str) {
        let mut words: Vec<u64> = self.plan.inbox_words().collect();
        let inbox = Arc::clone(self.plan.inbox());
        let entry = inbox.find(&format!("in{key}")).expect("a NetcommIn");
        entry.write(value, &mut words).expect("a value of its type");
        self.plan.import(&words);
    }

    pub(crate) fn step(&mut self) {
        self.cycle += 1;
        let time = Nanos(i64::try_from(self.cycle).expect("few cycles") * 1_000_000);
        let moment = Moment {
            cycle: self.cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        self.plan.evaluate(&self.image, moment);
    }

    /// The text of the value at the `NetcommOut` with that key; `null` if it is null now.
    pub(crate) fn read(&self, key: &str) -> String {
        let mut words = vec![0; self.plan.outbox().words()];
        self.plan.export(&mut words);
        let outbox = self.plan.outbox();
        let entry = outbox.find(&format!("out{key}")).expect("a NetcommOut");
        let mut text = String::new();
        match entry.status(&words) {
            OutStatus::Current => entry.format(&words, &mut text),
            OutStatus::Held | OutStatus::Never => text.push_str("null"),
        }
        text
    }
}
