//! A net thread without a thread: devices, nets and cycles of 1 ms in virtual time.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::panic,
    reason = "shared by test files that need different parts"
)]

use std::collections::BTreeMap;
use std::time::Duration;

use takt_core::device::{DeviceDescription, DevicePorts, DeviceState, DeviceTable, sim};
use takt_core::executor::serve::{DeviceEnd, Driver, Served};
use takt_core::executor::{End, Executor, Refusal, ResourceSet, Running};
use takt_net::netcomm::{Directory, OutStatus};
use takt_net::{Limits, LoadContext, Moment, Nanos, Registry, Rejection, load};
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::stats::Recorder;

pub const PERIOD: Duration = Duration::from_millis(1);

/// What a program sees of a net.
pub struct Seen {
    directory: std::sync::Arc<Directory>,
    out: LatestReader<Box<[u64]>>,
}

pub struct Stand {
    pub table: DeviceTable,
    pub executor: Executor,
    pub served: Served,
    pub cycle: u64,
    registry: Registry,
    resources: BTreeMap<String, usize>,
    nets: BTreeMap<u32, Seen>,
    pub ended: BTreeMap<u32, End>,
}

impl Default for Stand {
    fn default() -> Self {
        Self {
            table: DeviceTable::default(),
            executor: Executor::default(),
            served: Served::new(PERIOD.into(), Recorder::new()),
            cycle: 0,
            registry: takt_core::registry(),
            resources: BTreeMap::new(),
            nets: BTreeMap::new(),
            ended: BTreeMap::new(),
        }
    }
}

/// Parameters as programs give them.
pub fn parameters(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
    let pairs = pairs.iter();
    pairs
        .map(|(key, value)| ((*key).to_owned(), (*value).to_owned()))
        .collect()
}

/// Those of a simulated arm, and more.
pub fn arm_parameters(joints: usize, more: &[(&str, &str)]) -> BTreeMap<String, String> {
    let list = |value: f64| format!("{:?}", vec![value; joints]);
    let limits = [
        ("min_joint", -2.0),
        ("max_joint", 2.0),
        ("max_vel", 2.0),
        ("max_acc", 4.0),
    ];
    let mut all: BTreeMap<_, _> = limits
        .map(|(key, value)| (key.to_owned(), list(value)))
        .into();
    all.extend(parameters(more));
    all
}

impl Stand {
    /// Makes a simulated device.
    pub fn add(&mut self, name: &str, kind: &str, parameters: &BTreeMap<String, String>) {
        let (description, device) = sim::make(name, kind, parameters).unwrap();
        let (number, ports) = self.table.add(description).unwrap();
        let driver = Driver::Simulated {
            device,
            told: ports.driver_state,
        };
        self.serve(number, driver);
    }

    /// Makes a device whose driver the test is.
    pub fn add_driven(&mut self, description: DeviceDescription) -> Driven {
        let (number, ports) = self.table.add(description).unwrap();
        let DevicePorts {
            state,
            command,
            driver_state,
            driver_command,
        } = ports;
        self.serve(number, Driver::Cells { state, command });
        Driven {
            state: driver_state,
            command: driver_command,
        }
    }

    fn serve(&mut self, number: usize, driver: Driver) {
        let place = self.table.get(number).unwrap().place.clone();
        let end = Box::new(DeviceEnd::new(number, place, driver));
        self.served.add(end, &mut self.executor);
    }

    pub fn load(&self, text: &str) -> Result<takt_net::Plan, Rejection> {
        let context = LoadContext {
            registry: &self.registry,
            devices: &self.table,
            period: PERIOD,
            limits: Limits::default(),
        };
        load(text, &context)
    }

    /// The one fault of a net.
    pub fn fault(&self, text: &str) -> String {
        match self.load(text) {
            Ok(_) => panic!("{text} is taken"),
            Err(rejection) => rejection.to_string(),
        }
    }

    /// Starts a net that is evaluated in every so many cycles.
    pub fn try_start(&mut self, id: u32, text: &str, every: u64) -> Result<(), Refusal> {
        let plan = self
            .load(text)
            .unwrap_or_else(|r| panic!("{}", r.render("net", text)));
        let words = |n: usize| vec![0; n].into_boxed_slice();
        let directory = std::sync::Arc::clone(plan.outbox());
        let (out_writer, out) = latest(1, || words(plan.outbox().words()));
        let (_, inbox) = latest(1, || words(plan.inbox().words()));
        let mut resources = ResourceSet::default();
        for name in plan.resources() {
            let next = self.resources.len();
            resources.insert(*self.resources.entry(name.clone()).or_insert(next));
        }
        let numbers = plan.devices().iter();
        let devices = numbers
            .map(|d| (self.table.number(d).unwrap(), 0))
            .collect();
        let mut running = Box::new(Running::new(id, plan, out_writer, inbox));
        (running.resources, running.devices) = (resources, devices);
        running.set_every(every);
        self.nets.insert(id, Seen { directory, out });
        self.executor.start(running).map_err(|(_, refusal)| refusal)
    }

    /// Starts a net made of these children, which ends when told to cancel.
    pub fn start(&mut self, id: u32, children: &str) {
        let text = endless(children);
        self.try_start(id, &text, 1).unwrap();
    }

    /// One cycle of the thread.
    pub fn step(&mut self) {
        self.cycle += 1;
        let time = Nanos(i64::try_from(self.cycle).unwrap() * 1_000_000);
        let moment = Moment {
            cycle: self.cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        self.served.read(&mut self.executor);
        self.executor.cycle(moment);
        self.served
            .write(&mut self.executor, moment, takt_rt::Nanos(time.0));
        self.executor.publish(|_| ());
        while self.executor.take_ended(|net, end| {
            self.ended.insert(net.id, end);
            Ok(())
        }) {}
    }

    pub fn steps(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.step());
    }

    /// Runs until a net gives out this text, or fails.
    pub fn until(&mut self, id: u32, key: &str, text: &str) {
        for _ in 0..10_000 {
            self.step();
            if self.out(id, key) == text {
                return;
            }
        }
        panic!("{key} stays {}, never {text}", self.out(id, key));
    }

    /// The text of an out value, or `null`.
    pub fn out(&mut self, id: u32, key: &str) -> String {
        let seen = self.nets.get_mut(&id).unwrap();
        let entry = seen.directory.find(&format!("out{key}")).unwrap().clone();
        seen.out.read_with(|words| match entry.status(words) {
            OutStatus::Current => {
                let mut text = String::new();
                entry.format(words, &mut text);
                text
            }
            OutStatus::Held | OutStatus::Never => "null".to_owned(),
        })
    }

    /// The number in an out value.
    pub fn number(&mut self, id: u32, key: &str) -> f64 {
        let text = self.out(id, key);
        text.parse().unwrap_or_else(|_| panic!("{key} is {text}"))
    }

    pub fn end(&mut self, id: u32) {
        assert!(self.executor.abort(id));
        self.step();
    }
}

/// A device whose driver the test is.
pub struct Driven {
    pub state: LatestWriter<DeviceState>,
    pub command: LatestReader<takt_core::device::DeviceCommand>,
}

/// A net of these children that ends when told to cancel.
pub fn endless(children: &str) -> String {
    format!("{{{children},cancel=Cancel(),outTerminate=cancel.outCancel}}")
}

/// Gives out a value of a family such as `Core::Double` under a key.
pub fn watch(family: &str, key: &str, link: &str) -> String {
    format!("w_{key}={family}NetcommOut(inValue={link},Key='{key}')")
}
