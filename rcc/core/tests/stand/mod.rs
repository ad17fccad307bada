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
use takt_core::executor::rules::{Failure, Literal, NetActions, Question, Rule, RuleState, Step};
use takt_core::executor::serve::{DeviceEnd, Driver, Served};
use takt_core::executor::stop::{EmergencyStop, StopPart};
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
    /// Rules that no longer wait: what became of them, and why.
    pub rules: BTreeMap<u32, (RuleState, Option<Failure>)>,
    /// The part of another thread in the emergency stop.
    stop: StopPart,
}

impl Default for Stand {
    fn default() -> Self {
        let stop = std::sync::Arc::new(EmergencyStop::new(false));
        let own = StopPart::new(std::sync::Arc::clone(&stop), 0);
        Self {
            table: DeviceTable::default(),
            executor: Executor::default(),
            served: Served::new(PERIOD.into(), Recorder::new()).under(own),
            cycle: 0,
            registry: takt_core::registry(),
            resources: BTreeMap::new(),
            nets: BTreeMap::new(),
            ended: BTreeMap::new(),
            rules: BTreeMap::new(),
            stop: StopPart::new(stop, 1),
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
            published: ports.driver_state,
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
        let running = self.make(id, text, every);
        self.executor.start(running).map_err(|(_, refusal)| refusal)
    }

    fn make(&mut self, id: u32, text: &str, every: u64) -> Box<Running> {
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
        running
    }

    /// Has a rule start a net when another one has ended by itself, or now if there is none.
    pub fn start_after(&mut self, predecessor: Option<u32>, id: u32, text: &str, every: u64) {
        let running = self.make(id, text, every);
        self.executor.schedule(running).unwrap();
        let asked = |net| Literal {
            net,
            question: Question::Terminated,
            value: None,
            last: false,
        };
        let literals: Vec<_> = predecessor.map(asked).into_iter().collect();
        let step = predecessor.map_or(Step::Constant(true), |_| Step::Literal(0));
        let orders = NetActions {
            start: vec![id],
            ..NetActions::default()
        };
        self.add_rule(id, literals, step, orders);
    }

    /// Has a rule stop a net after the next cycle and start others.
    pub fn stop_by_rule(&mut self, rule: u32, net: u32, start: &[u32]) {
        let orders = NetActions {
            stop: vec![net],
            start: start.to_vec(),
            ..NetActions::default()
        };
        self.add_rule(rule, Vec::new(), Step::Constant(true), orders);
    }

    fn add_rule(&mut self, id: u32, literals: Vec<Literal>, step: Step, orders: NetActions) {
        let rule = Box::new(Rule::new(id, literals, vec![step], orders));
        self.executor
            .add_rule(rule)
            .map_err(|(_, why)| why)
            .unwrap();
    }

    /// Schedules a net for a rule that is added later.
    pub fn schedule(&mut self, id: u32, text: &str, every: u64) {
        let running = self.make(id, text, every);
        self.executor.schedule(running).unwrap();
    }

    /// Another thread demands an emergency stop, or says that there is none any more.
    pub fn set_stop(&mut self, is_on: bool) {
        self.stop.say(Some(is_on), takt_rt::Nanos(0));
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
        let begin = takt_rt::Nanos(time.0);
        self.served.poll(begin);
        self.served.read(&mut self.executor);
        self.executor.announce_takeovers(|_, _| ());
        self.executor.cycle(moment);
        self.served.write(&mut self.executor, moment, begin);
        self.executor.publish(|_| ());
        self.executor.fire_rules();
        self.executor.effects(|_, _| ());
        if self.executor.withdraw() {
            self.served.retract(&self.executor);
        }
        let rules = &mut self.rules;
        self.executor.take_rules(|rule| {
            rules.insert(rule.id, (rule.state, rule.failure));
            Ok(())
        });
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

    /// Aborts a net, and its program forgets it.
    pub fn unload(&mut self, id: u32) {
        assert!(self.executor.abort(id));
        self.nets.remove(&id);
    }

    /// The client of these nets is lost: those that wait are taken back first, then those that run are aborted.
    pub fn lose_client(&mut self, nets: &[u32]) {
        for id in nets {
            self.executor.take_unscheduled(*id, true);
        }
        for id in nets {
            self.executor.abort(*id);
            self.nets.remove(id);
        }
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
