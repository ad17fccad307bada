//! The executor cycle by cycle, without threads: who may start, who is evaluated, who ends, and
//! what that frees. Rules between nets are not looked at.

#![expect(clippy::float_cmp, reason = "whole numbers of cycles")]

use std::time::Duration;

use takt_net::device::Devices;
use takt_net::{JointLimits, JointState, Limits, LoadContext, Nanos, NoDevices, Registry, load};
use takt_rt::latest::{LatestReader, LatestWriter, latest};

use super::*;
use crate::device::{ArmDescription, DeviceStatus, DeviceTable, Surroundings};

/// Counts its evaluations in out value `n` and ends when asked to cancel.
const COUNTER: &str = "{clock=Core::Clock(Increment='1000'),
    n=Core::DoubleNetcommOut(inValue=clock.outValue,Key='n'),
    cancel=Cancel(),outTerminate=cancel.outCancel}";
/// Counts its evaluations and never ends by itself.
pub(super) const ENDLESS: &str = "{clock=Core::Clock(Increment='1000'),
    n=Core::DoubleNetcommOut(inValue=clock.outValue,Key='n'),
    never=Core::BooleanValue(),outTerminate=never.outValue}";
/// Ends in its first cycle.
pub(super) const BRIEF: &str = "{yes=Core::BooleanValue(Value='true'),outTerminate=yes.outValue}";
/// Gives out what is written to it, in text.
const ECHO: &str = "{x=Core::IntNetcommIn(Key='x',Value='0'),
    y=Core::IntNetcommOut(inValue=x.outValue,Key='y'),
    never=Core::BooleanValue(),outTerminate=never.outValue}";

const READY: DeviceView = DeviceView {
    status: DeviceStatus::Operational,
    faults: 0,
    jumps: 0,
};

/// A net with the program's end of its values.
struct Loaded {
    running: Box<Running>,
    out: LatestReader<Box<[u64]>>,
    inbox: LatestWriter<Box<[u64]>>,
}

fn loaded(id: u32, text: &str) -> Loaded {
    loaded_at(id, text, (&Registry::core(), &NoDevices))
}

fn loaded_at(id: u32, text: &str, (registry, devices): (&Registry, &dyn Devices)) -> Loaded {
    let limits = Limits::default();
    let period = Duration::from_millis(1);
    let context = LoadContext {
        registry,
        devices,
        period,
        limits,
    };
    let plan = load(text, &context).unwrap();
    let words = |n: usize| move || vec![0; n].into_boxed_slice();
    let (out_writer, out) = latest(1, words(plan.outbox().words()));
    let (inbox, in_reader) = latest(1, words(plan.inbox().words()));
    let running = Box::new(Running::new(id, plan, out_writer, in_reader));
    Loaded {
        running,
        out,
        inbox,
    }
}

pub(crate) fn net(id: u32, text: &str) -> Box<Running> {
    loaded(id, text).running
}

/// A net that holds these resources.
pub(super) fn holding(id: u32, text: &str, resources: &[usize]) -> Box<Running> {
    let mut net = net(id, text);
    resources
        .iter()
        .for_each(|number| net.resources.insert(*number));
    net
}

/// A net that commands these devices.
fn commanding(id: u32, devices: &[usize]) -> Box<Running> {
    let mut net = net(id, ENDLESS);
    net.devices = devices.iter().map(|number| (*number, 0)).collect();
    net
}

#[derive(Default)]
struct Bench {
    executor: Executor,
    cycle: u64,
}

impl Bench {
    fn with_devices(devices: &[DeviceView]) -> Self {
        let mut bench = Self::default();
        bench.executor.devices.extend_from_slice(devices);
        bench
    }

    fn start(&mut self, net: Box<Running>) -> Result<(), StartError> {
        self.executor.start(net).map_err(|(_, refusal)| refusal)
    }

    /// Evaluates a cycle; returns the nets whose values changed.
    fn evaluate(&mut self) -> Vec<u32> {
        self.cycle += 1;
        let time = Nanos(self.cycle.cast_signed() * 1_000_000);
        let moment = Moment {
            cycle: self.cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        for net in self.executor.running() {
            net.receive();
        }
        self.executor.cycle(moment);
        let mut changed = Vec::new();
        self.executor.publish(|net| changed.push(net.id));
        changed
    }

    /// Evaluates a cycle and takes out the nets that ended.
    fn run(&mut self) -> Vec<(u32, End)> {
        self.evaluate();
        let mut ended = Vec::new();
        while self.executor.take_ended(|net, end| {
            ended.push((net.id, end));
            Ok(())
        }) {}
        ended
    }

    fn ids(&mut self) -> Vec<u32> {
        self.executor.running().iter().map(|net| net.id).collect()
    }
}

/// How often a net was evaluated, as its program sees it; 0 before it published.
fn evaluations(out: &mut LatestReader<Box<[u64]>>) -> f64 {
    out.read_with(|words| f64::from_bits(words[2]))
}

// Start.

#[test]
fn net_runs_from_next_cycle() {
    let mut bench = Bench::default();
    let Loaded {
        running,
        mut out,
        inbox: _inbox,
    } = loaded(7, ENDLESS);
    assert_eq!(bench.start(running), Ok(()));
    assert_eq!(evaluations(&mut out), 0.0);
    for _ in 0..3 {
        assert_eq!(bench.run(), []);
    }
    // The clock shows 0 in the first cycle or 1: what counts is that it moves once a cycle.
    let third = evaluations(&mut out);
    bench.run();
    assert_eq!(evaluations(&mut out), third + 1.0);
    assert_eq!(bench.ids(), [7]);
}

#[test]
fn resource_belongs_to_one_running_net() {
    let mut bench = Bench::default();
    assert_eq!(
        bench.start(holding(0, ENDLESS, &[3, 64, ResourceSet::MAX - 1])),
        Ok(())
    );
    for (resources, expected) in [
        (&[][..], Ok(())),
        (&[2, 65], Ok(())),
        (&[2, 65], Err(StartError::ResourceInUse(2))),
        (&[64], Err(StartError::ResourceInUse(64))),
        (&[4, 3], Err(StartError::ResourceInUse(3))),
        (
            &[ResourceSet::MAX - 1],
            Err(StartError::ResourceInUse(ResourceSet::MAX - 1)),
        ),
    ] {
        assert_eq!(
            bench.start(holding(1, ENDLESS, resources)),
            expected,
            "{resources:?}"
        );
    }
}

#[test]
fn net_requires_operational_device() {
    let safe = DeviceView {
        status: DeviceStatus::SafeOperational,
        ..READY
    };
    let mut bench = Bench::with_devices(&[READY, safe, DeviceView::default()]);
    for (devices, expected) in [
        (&[0][..], Ok(())),
        (&[1], Err(StartError::DeviceNotReady(1))),
        (&[0, 2], Err(StartError::DeviceNotReady(2))),
        (&[3], Err(StartError::DeviceNotReady(3))),
    ] {
        assert_eq!(bench.start(commanding(0, devices)), expected, "{devices:?}");
    }
}

#[test]
fn rejected_net_is_returned_without_resources() {
    let mut bench = Bench::default();
    let mut refused = holding(5, ENDLESS, &[1]);
    refused.devices.push((0, 0));
    let (back, why) = bench.executor.start(refused).unwrap_err();
    assert_eq!((back.id, why), (5, StartError::DeviceNotReady(0)));
    assert_eq!(bench.start(holding(6, ENDLESS, &[1])), Ok(()));
    assert_eq!(bench.ids(), [6]);
}

#[test]
fn running_nets_are_bounded() {
    let mut bench = Bench::default();
    let most = u32::try_from(RUNNING_MAX).unwrap();
    for id in 0..most {
        assert_eq!(bench.start(net(id, BRIEF)), Ok(()));
    }
    assert_eq!(bench.start(net(most, BRIEF)), Err(StartError::TooMany));
    assert_eq!(bench.run().len(), RUNNING_MAX);
    assert_eq!(bench.start(net(most, BRIEF)), Ok(()));
}

// Cycles.

#[test]
fn net_is_evaluated_every_nth_cycle() {
    let mut bench = Bench::default();
    for every in [1, 2, 5] {
        let mut net = net(u32::try_from(every).unwrap(), ENDLESS);
        net.set_every(every);
        bench.start(net).unwrap();
    }
    let changed: Vec<_> = (0..6).map(|_| bench.evaluate()).collect();
    assert_eq!(
        changed,
        [&[1][..], &[1, 2], &[1], &[1, 2], &[1, 5], &[1, 2]]
    );
}

#[test]
fn values_are_published_only_on_change() {
    let mut bench = Bench::default();
    let Loaded {
        running,
        mut out,
        mut inbox,
    } = loaded(0, ECHO);
    let (in_directory, out_directory) =
        (running.plan.inbox().clone(), running.plan.outbox().clone());
    let mut words: Vec<_> = running.plan.inbox_words().collect();
    bench.start(running).unwrap();
    assert_eq!(bench.evaluate(), [0], "the first value is a change");
    let version = out.version();
    for _ in 0..5 {
        assert_eq!(bench.evaluate(), [0_u32; 0]);
    }
    assert_eq!(out.version(), version);
    let mut write = |text| {
        in_directory
            .find("inx")
            .unwrap()
            .write(text, &mut words)
            .unwrap();
        inbox.write_with(|slot| slot.copy_from_slice(&words));
    };
    write("42");
    assert_eq!(bench.evaluate(), [0]);
    let mut text = String::new();
    let value = out_directory.find("outy").unwrap();
    out.read_with(|words| value.format(words, &mut text));
    assert_eq!(text, "42");
    write("42");
    assert_eq!(bench.evaluate(), [0_u32; 0], "written again, but the same");
}

// End.

#[test]
fn cancelled_net_ends_by_itself() {
    let mut bench = Bench::default();
    bench.start(net(0, COUNTER)).unwrap();
    bench.start(net(1, COUNTER)).unwrap();
    bench.start(net(2, ENDLESS)).unwrap();
    assert_eq!(bench.run(), []);
    assert!(bench.executor.cancel(0));
    assert!(bench.executor.cancel(2));
    assert!(!bench.executor.cancel(9));
    assert_eq!(bench.run(), [(0, End::Terminated)]);
    assert!(!bench.executor.cancel(0));
    assert_eq!(bench.run(), [], "the one that takes no notice runs on");
    assert_eq!(bench.ids(), [1, 2]);
}

#[test]
fn aborted_net_is_not_evaluated_again() {
    let mut bench = Bench::default();
    let Loaded {
        running,
        mut out,
        inbox: _inbox,
    } = loaded(0, ENDLESS);
    bench.start(running).unwrap();
    bench.run();
    let before = evaluations(&mut out);
    assert!(bench.executor.abort(0));
    assert!(!bench.executor.abort(1));
    assert_eq!(bench.run(), [(0, End::Aborted)]);
    assert_eq!(evaluations(&mut out), before);
}

#[test]
fn device_fault_ends_only_commanding_nets() {
    let mut bench = Bench::with_devices(&[READY, READY]);
    for (id, devices) in [(0, &[0][..]), (1, &[1]), (2, &[0, 1]), (3, &[])] {
        bench.start(commanding(id, devices)).unwrap();
    }
    assert_eq!(bench.run(), []);
    // Even if it is operational again before the next cycle.
    bench.executor.devices[0].faults += 1;
    assert_eq!(
        bench.run(),
        [(0, End::DeviceFault(0)), (2, End::DeviceFault(0))]
    );
    // What was before a net started is none of its business.
    bench.start(commanding(4, &[0])).unwrap();
    assert_eq!(bench.run(), []);
    bench.executor.devices.clear();
    assert_eq!(
        bench.run(),
        [(1, End::DeviceFault(1)), (4, End::DeviceFault(0))]
    );
    assert_eq!(bench.ids(), [3]);
}

/// Ends only by itself; shows whether a device failed.
const ENDURING: &str = "{failure=DeviceFailure(Time='0.005'),
    failed=Core::BooleanNetcommOut(inValue=failure.outFailed,Key='failed'),
    never=Core::BooleanValue(),outTerminate=never.outValue}";

#[test]
fn device_fault_leaves_declared_time_to_net() {
    let mut bench = Bench::with_devices(&[READY, READY]);
    let mut net = net(0, ENDURING);
    net.devices = vec![(0, 0), (1, 0)];
    bench.start(net).unwrap();
    assert_eq!(bench.run(), []);
    bench.executor.devices[1].faults += 1;
    for _ in 0..5 {
        assert_eq!(bench.run(), []);
    }
    assert_eq!(bench.run(), [(0, End::DeviceFault(1))]);
}

#[test]
fn device_fault_of_last_device_ends_net() {
    let mut bench = Bench::with_devices(&[READY, READY]);
    let mut both = net(0, ENDURING);
    both.devices = vec![(0, 0), (1, 0)];
    let mut one = net(1, ENDURING);
    one.devices = vec![(0, 0)];
    bench.start(both).unwrap();
    bench.start(one).unwrap();
    bench.executor.devices[0].faults += 1;
    assert_eq!(bench.run(), [(1, End::DeviceFault(0))]);
    bench.executor.devices[1].faults += 1;
    assert_eq!(bench.run(), [(0, End::DeviceFault(0))]);
}

#[test]
fn net_end_keeps_first_reason() {
    let mut bench = Bench::with_devices(&[READY]);
    bench.start(commanding(0, &[0])).unwrap();
    bench.executor.abort(0);
    bench.executor.devices[0].faults += 1;
    assert_eq!(bench.run(), [(0, End::Aborted)]);
}

#[test]
fn ended_net_frees_resources_before_next_cycle() {
    let mut bench = Bench::default();
    bench.start(holding(0, BRIEF, &[1])).unwrap();
    assert_eq!(
        bench.start(holding(1, BRIEF, &[1])),
        Err(StartError::ResourceInUse(1))
    );
    assert_eq!(bench.run(), [(0, End::Terminated)]);
    assert_eq!(bench.start(holding(1, BRIEF, &[1])), Ok(()));
    assert_eq!(bench.run(), [(1, End::Terminated)]);
}

#[test]
fn unaccepted_ended_net_is_not_evaluated() {
    let mut bench = Bench::default();
    let Loaded {
        mut running,
        mut out,
        inbox: _inbox,
    } = loaded(0, COUNTER);
    running.resources.insert(1);
    bench.start(running).unwrap();
    bench.executor.cancel(0);
    bench.evaluate();
    let last = evaluations(&mut out);
    for _ in 0..3 {
        assert!(!bench.executor.take_ended(|net, _| Err(net)));
        assert_eq!(
            bench.start(holding(1, BRIEF, &[1])),
            Err(StartError::ResourceInUse(1))
        );
        assert_eq!(bench.evaluate(), [0_u32; 0]);
        assert_eq!(evaluations(&mut out), last);
    }
    assert_eq!(bench.run(), [(0, End::Terminated)]);
    assert_eq!(bench.start(holding(1, BRIEF, &[1])), Ok(()));
}

/// A net that moves a joint on from where it is commanded. What its driver reports stays behind.
const FURTHER: &str = "{m=RobotArm::JointMonitor(Robot='arm',Axis='0'),
    p=Core::DoubleAdd(inFirst=m.outCommandedPosition,Second='0.001'),
    j=RobotArm::JointPosition(inPosition=p.outValue,Robot='arm',Axis='0'),
    never=Core::BooleanValue(),outTerminate=never.outValue}";

#[test]
fn skipped_cycles_leave_commanded_position() {
    let mut table = DeviceTable::default();
    let limits = JointLimits {
        position_min: -3.0,
        position_max: 3.0,
        velocity_max: 1e3,
        acceleration_max: 1e6,
    };
    let arm = ArmDescription {
        name: "arm".to_owned(),
        kind: "test",
        limits: vec![limits],
        model: "".into(),
    };
    table.add_arm(arm).unwrap();
    let devices = Surroundings {
        devices: &table,
        boxes: |_| None,
    };
    let net = loaded_at(0, FURTHER, (&crate::registry(), &devices)).running;
    let mut executor = Executor::default();
    executor.use_joints(1);
    let reported = JointState {
        commanded_position: Some(0.0),
        ..JointState::default()
    };
    executor.image.joints[0].state.set(reported);
    executor.start(net).unwrap();
    // The last pause is so long that the driver has braked.
    for (cycle, thousandths) in [(1, 1.0), (2, 2.0), (4, 3.0), (5, 4.0), (16, 5.0), (28, 1.0)] {
        executor.cycle(Moment {
            cycle,
            every: 1,
            ..Moment::default()
        });
        let position = executor.joints()[0].command.get().position;
        assert!(
            (position - thousandths * 1e-3).abs() < 1e-12,
            "{cycle}: {position}"
        );
    }
}
