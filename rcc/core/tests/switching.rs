//! Many hand-overs between nets in virtual time, at a logical period of 500 us: every cycle has
//! exactly one set-point, from the net whose turn it is.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_core::device::{ArmDescription, DeviceStatus, DeviceTable};
use takt_core::executor::rules::{Literal, Question, Rule, Step};
use takt_core::executor::{DeviceView, Executor, Running};
use takt_net::{JointLimits, Limits, LoadContext, Moment, Nanos, Registry, load};
use takt_rt::latest::latest;

const PERIOD: Duration = Duration::from_micros(500);
/// Hand-overs; more with the environment variable `TAKT_SWITCHES`.
const SWITCHES: u32 = 5_000;

/// Commands its number for so many cycles and ends.
fn net(id: u32, cycles: u32, registry: &Registry, devices: &DeviceTable) -> Box<Running> {
    let text = format!(
        "{{clock=Core::Clock(Increment='2000'),value=Core::DoubleValue(Value='{id}'),
        joint=RobotArm::JointPosition(inPosition=value.outValue,Robot='arm'),
        end=Core::DoubleGreater(inFirst=clock.outValue,Second='{}.5'),outTerminate=end.outValue}}",
        cycles - 1
    );
    let limits = Limits::default();
    let context = LoadContext {
        registry,
        devices,
        period: PERIOD,
        limits,
    };
    let plan = load(&text, &context).unwrap_or_else(|r| panic!("{}", r.render("net", &text)));
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
    let (name, model) = ("arm".to_owned(), "".into());
    devices
        .add_arm(ArmDescription {
            name,
            kind: "test",
            limits: vec![limits],
            model,
        })
        .unwrap();
    devices
}

/// Net `next` starts when net `next - 1` terminates.
fn follow(executor: &mut Executor, next: Box<Running>) {
    let (id, net) = (next.id, next.id - 1);
    executor.schedule(next).unwrap();
    let literal = Literal {
        net,
        question: Question::Terminated,
        value: None,
        last: false,
    };
    let mut rule = Box::new(Rule::new(id, vec![literal], vec![Step::Literal(0)]));
    rule.start = vec![id];
    executor.add_rule(rule).unwrap();
}

#[test]
fn no_cycle_is_missing_or_doubled() {
    let switches = std::env::var("TAKT_SWITCHES").map_or(SWITCHES, |text| text.parse().unwrap());
    let (registry, devices) = (takt_core::registry(), arm());
    let mut executor = Executor::default();
    executor.use_joints(1);
    executor.set_device(
        0,
        DeviceView {
            status: DeviceStatus::Operational,
            faults: 0,
        },
    );
    let turns = |id: u32| 1 + id * 7 % 4;
    executor
        .start(net(0, turns(0), &registry, &devices))
        .unwrap();
    follow(&mut executor, net(1, turns(1), &registry, &devices));
    let (mut id, mut left, mut cycle) = (0, turns(0), 0_u64);
    while id <= switches {
        cycle += 1;
        let time = Nanos(i64::try_from(cycle).unwrap() * 500_000);
        executor.announce_takeovers(|_, _| ());
        executor.cycle(Moment {
            cycle,
            time,
            wall: time,
            ..Moment::default()
        });
        let command = executor.joints()[0].command.get();
        assert_eq!(command.cycle, cycle, "cycle {cycle} has no set-point");
        assert!(
            (command.position - f64::from(id)).abs() < 0.1,
            "cycle {cycle} is not of net {id}"
        );
        executor.fire_rules();
        let mut ended = None;
        while executor.take_ended(|net, _| {
            assert_eq!(
                ended.replace(net.id),
                None,
                "two nets ended in cycle {cycle}"
            );
            Ok(())
        }) {}
        while executor.take_rule(|_| Ok(())) {}
        left -= 1;
        assert_eq!(ended, (left == 0).then_some(id));
        if left == 0 {
            id += 1;
            left = turns(id);
            follow(
                &mut executor,
                net(id + 1, turns(id + 1), &registry, &devices),
            );
        }
    }
}
