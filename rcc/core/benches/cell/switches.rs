//! Many hand-overs between nets in virtual time, at a logical period of 500 us: counts cycles in which no
//! net, or a net whose turn it is not, commands the arm. Shared with a test, which judges the counts.

use std::time::Duration;

use takt_core::device::{ArmDescription, DeviceStatus, DeviceTable};
use takt_core::executor::rules::{Literal, NetActions, Question, Rule, Step};
use takt_core::executor::{DeviceView, Executor, Running};
use takt_net::{JointLimits, Limits, LoadContext, Moment, Nanos, Registry, load};
use takt_rt::latest::latest;

const PERIOD: Duration = Duration::from_micros(500);

/// The result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Switched {
    /// Hand-overs from one net to the next.
    pub(crate) switches: u32,
    /// Cycles without a set-point.
    pub(crate) missing: u64,
    /// Cycles in which the wrong net commanded or ended.
    pub(crate) doubled: u64,
}

/// Commands its number for some cycles and ends.
fn net(id: u32, cycles: u32, registry: &Registry, devices: &DeviceTable) -> Box<Running> {
    let text = format!(
        "{{clock=Core::Clock(Increment='2000'),value=Core::DoubleValue(Value='{id}'),
        joint=RobotArm::JointPosition(inPosition=value.outValue,Robot='arm'),
        end=Core::DoubleGreater(inFirst=clock.outValue,Second='{}.5'),outTerminate=end.outValue}}",
        cycles - 1
    );
    let context = LoadContext {
        registry,
        devices,
        period: PERIOD,
        limits: Limits::default(),
    };
    let plan = load(&text, &context).expect("the net is good");
    let words = |n: usize| vec![0; n].into_boxed_slice();
    let (out, _) = latest(1, || words(plan.outbox().words()));
    let (_, inbox) = latest(1, || words(plan.inbox().words()));
    let mut running = Box::new(Running::new(id, plan, out, inbox));
    running.resources.insert(0);
    running.devices.push((0, 0));
    running
}

fn arm() -> DeviceTable {
    let mut devices = DeviceTable::default();
    let limits = JointLimits {
        position_min: 0.0,
        position_max: f64::MAX,
        velocity_max: 1.0,
        acceleration_max: 1.0,
    };
    let arm = ArmDescription {
        name: "arm".to_owned(),
        kind: "test",
        limits: vec![limits],
        model: "".into(),
    };
    devices.add_arm(arm).expect("the table is empty");
    devices
}

/// Net `next` starts when net `next - 1` terminates.
fn follow(executor: &mut Executor, next: Box<Running>) {
    let (id, net) = (next.id, next.id - 1);
    let literal = Literal {
        net,
        question: Question::Terminated,
        value: None,
        last: false,
    };
    let orders = NetActions {
        start: vec![id],
        ..NetActions::default()
    };
    let rule = Box::new(Rule::new(id, vec![literal], vec![Step::Literal(0)], orders));
    let scheduled = executor.schedule(next).is_ok();
    let waits = executor.add_rule(rule).is_ok();
    assert!(scheduled && waits, "there is room for one net and one rule");
}

/// How many cycles a net lives: one to four.
const fn turns(id: u32) -> u32 {
    1 + id * 7 % 4
}

/// Hands over `count` times.
pub(crate) fn run(switches: u32) -> Switched {
    let (registry, devices) = (takt_core::registry(), arm());
    let next = |id| net(id, turns(id), &registry, &devices);
    let mut executor = Executor::default();
    executor.use_joints(1);
    let ready = DeviceView {
        status: DeviceStatus::Operational,
        faults: 0,
        jumps: 0,
    };
    executor.set_device(0, ready);
    assert!(executor.start(next(0)).is_ok(), "nothing else runs");
    follow(&mut executor, next(1));
    let mut counts = Switched {
        switches,
        missing: 0,
        doubled: 0,
    };
    let (mut id, mut left, mut cycle) = (0, turns(0), 0_u64);
    while id <= switches {
        cycle += 1;
        let (is_commanded, is_its_own, ended) = one_cycle(&mut executor, cycle, id);
        counts.missing += u64::from(!is_commanded);
        left -= 1;
        let expected: &[u32] = if left == 0 { &[id] } else { &[] };
        counts.doubled += u64::from(!is_its_own || ended != expected);
        if left == 0 {
            id += 1;
            left = turns(id);
            follow(&mut executor, next(id + 1));
        }
    }
    counts
}

/// Whether the arm got a set-point, whether that is of net `id`, and which nets ended.
fn one_cycle(executor: &mut Executor, cycle: u64, id: u32) -> (bool, bool, Vec<u32>) {
    let time = Nanos(i64::try_from(cycle).expect("few cycles") * 500_000);
    executor.announce_takeovers(|_, _| ());
    executor.cycle(Moment {
        cycle,
        time,
        wall: time,
        ..Moment::default()
    });
    let command = executor.joints()[0].command.get();
    executor.fire_rules();
    let mut ended = Vec::new();
    while executor.take_ended(|net, _| {
        ended.push(net.id);
        Ok(())
    }) {}
    executor.take_rules(|_| Ok(()));
    let is_its_own = (command.position - f64::from(id)).abs() < 0.1;
    (command.cycle == cycle, is_its_own, ended)
}
