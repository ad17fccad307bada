//! Commands of a net are withdrawn when it ends, as seen on the wire: a net thread, a driver and its emulator in virtual
//! time; a net that moves the device and ends in every way; the frames sent until long after. Each driver's tests
//! describe its device; the common part is here.

#![allow(
    dead_code,
    unused_imports,
    reason = "shared by drivers that need different parts"
)]

use std::time::Duration;

use takt_rt::Nanos;

use fixtures::Fixture;
use takt_core::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus};
use takt_core::executor::End;

#[path = "../../../core/tests/fixtures/mod.rs"]
pub(crate) mod fixtures;
mod jumps;
mod outputs;

pub(crate) use jumps::Jumps;
pub(crate) use outputs::outputs_follow_their_policy;

/// Offsets from a net's number to those of its scheduled successor and of its rules.
const NEXT: u32 = 100;
const RULE: u32 = 200;
/// Periods of nets, in cycles of their thread of 1 ms.
pub(crate) const PERIODS: [u64; 2] = [1, 1000];

/// How a net ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The net terminates.
    Itself,
    /// The net is cancelled.
    Cancel,
    /// The net is aborted.
    Abort,
    /// A rule stops the net.
    Rule,
    /// Its client is lost: its scheduled nets are withdrawn, its running nets aborted.
    LostClient,
    /// The net is aborted and unloaded.
    Unload,
    /// An emergency stop of another thread.
    EmergencyStop,
    /// The net overran its cycle too often.
    Overrun,
    /// The device stops following, and recovers later.
    DeviceFault,
    /// The controller shuts down: nets, then threads, then drivers.
    Shutdown,
}

/// All endings.
const ENDINGS: [Ending; 10] = [
    Ending::Itself,
    Ending::Cancel,
    Ending::Abort,
    Ending::Rule,
    Ending::LostClient,
    Ending::Unload,
    Ending::EmergencyStop,
    Ending::Overrun,
    Ending::DeviceFault,
    Ending::Shutdown,
];

/// A driver, its wire and its emulator.
pub(crate) trait Plant {
    /// Its virtual time.
    fn now(&self) -> Nanos;
    /// Runs driver and emulator up to a time, with the commands of nets. While `is_ending` the driver shuts down.
    fn run_to(&mut self, until: Nanos, given: &DeviceCommand, is_ending: bool);
    /// State reported by the driver.
    fn copy_state(&mut self, state: &mut DeviceState);
    /// Last position or speed sent.
    fn sent(&mut self) -> f64;
    /// Position of the emulated device.
    fn place(&mut self) -> f64;
    /// Injects or clears a fault.
    fn fail(&mut self, is_on: bool);
}

/// Whether positions or speeds are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wire {
    Positions,
    Speeds,
}

/// A device and its expected stop.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) description: DeviceDescription,
    /// Children that move it to and fro, in turn; `STEP` is the step of a clock per evaluation, times 1000.
    pub(crate) children: [String; 2],
    /// Minimum duration of the motion, ms.
    pub(crate) runs: usize,
    pub(crate) wire: Wire,
    /// Acceleration limit, in the unit of the sent values.
    pub(crate) acceleration: f64,
    /// Resolution of the sent values.
    pub(crate) resolution: f64,
    /// Latency from a command to its frame: one or two cycles of the driver.
    pub(crate) latency: Duration,
    /// Distance that the emulated device may move after the sent values rest, by its lag and its compliance.
    pub(crate) creep: f64,
    /// Why an ending does not apply to it at that period of its net.
    pub(crate) without: fn(Ending, u64) -> Option<&'static str>,
}

/// Children that swing a joint about its position at these speeds, rad/s.
pub(crate) fn joint(axis: usize, speeds: [f64; 2]) -> [String; 2] {
    speeds.map(|speed| swing(axis, speed))
}

fn swing(axis: usize, speed: f64) -> String {
    format!(
        "true=Core::BooleanValue(Value='true'),past=Core::BooleanPre(inValue=true.outValue),
        first=Core::BooleanIsNull(inValue=past.outValue),
        at=RobotArm::JointMonitor(Robot='x',Axis='{axis}'),
        start=Core::DoubleSnapshot(inSnapshot=first.outValue,inValue=at.outCommandedPosition),
        clock=Core::Clock(Increment='STEP'),
        begin=Core::DoubleSnapshot(inSnapshot=first.outValue,inValue=clock.outValue),
        way=Core::DoubleMultiply(inFirst=clock.outValue,Second='{speed}'),
        back=Core::DoubleMultiply(inFirst=begin.outValue,Second='{back}'),
        from=Core::DoubleAdd(inFirst=start.outValue,inSecond=back.outValue),
        to=Core::DoubleAdd(inFirst=from.outValue,inSecond=way.outValue),
        j=RobotArm::JointPosition(inPosition=to.outValue,Robot='x',Axis='{axis}')",
        back = -speed
    )
}

/// Children that drive a base to and fro at a speed, m/s.
pub(crate) fn velocity(ahead: f64) -> [String; 2] {
    [ahead, -ahead].map(|ahead| {
        format!(
            "v=World::TwistValue(Value='{{vel:{{x:{ahead}}}}}'),
            j=RobotBase::BaseVelocity(inVel=v.outValue,Robot='x')"
        )
    })
}

/// The net of these children.
fn net(children: &str, every: u64, ends_after: Option<u32>) -> String {
    let children = children.replace("STEP", &every.to_string());
    let last = ends_after.map_or(1e9, |count| f64::from(count) / 1000.0 - 0.0005);
    format!(
        "{{{children},age=Core::Clock(Increment='1'),
        over=Core::DoubleGreater(inFirst=age.outValue,Second='{last}'),
        cancel=Cancel(),end=Core::BooleanOr(inFirst=cancel.outCancel,inSecond=over.outValue),
        outTerminate=end.outValue}}"
    )
}

/// A net thread and a plant that it commands.
struct Bench<P> {
    fixture: Fixture,
    driven: fixtures::Driven,
    plant: P,
    given: DeviceCommand,
    state: DeviceState,
    /// Sent values and positions of the device, each millisecond.
    sent: Vec<f64>,
    places: Vec<f64>,
}

impl<P: Plant> Bench<P> {
    fn new(row: &Row, plant: P) -> Self {
        let mut fixture = Fixture::default();
        let description = DeviceDescription {
            name: "x".to_owned(),
            ..row.description.clone()
        };
        let mut layout = takt_net::device::Layout::default();
        let joints = description.limits.len();
        let _places = takt_core::device::parts::lay(&description.parts, joints, &mut layout);
        let driven = fixture.add_driven(description);
        fixture.cycle = plant.now().0.unsigned_abs().div_ceil(1_000_000);
        let mut bench = Self {
            fixture,
            driven,
            plant,
            given: DeviceCommand::new(layout.commands),
            state: DeviceState::new(layout.signals),
            sent: Vec::new(),
            places: Vec::new(),
        };
        bench.steps(50);
        assert_eq!(
            bench.state.status,
            DeviceStatus::Operational,
            "{}",
            row.name
        );
        bench
    }

    /// Runs driver and emulator up to a time.
    fn drive(&mut self, until: Nanos, is_ending: bool) {
        self.plant.run_to(until, &self.given, is_ending);
        self.plant.copy_state(&mut self.state);
        let state = &self.state;
        self.driven.state.write_with(|slot| slot.copy_from(state));
        self.sent.push(self.plant.sent());
        self.places.push(self.plant.place());
    }

    fn time(&self) -> Nanos {
        Nanos(self.fixture.cycle.cast_signed() * 1_000_000)
    }

    /// A cycle of the net thread, then the driver until the next.
    fn step(&mut self) {
        self.fixture.step();
        let given = &mut self.given;
        self.driven
            .command
            .read_with(|command| given.copy_from(command));
        self.drive(Nanos(self.time().0 + 999_999), false);
    }

    fn steps(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.step());
    }

    /// The net threads have ended, the driver shuts down.
    fn end_driver(&mut self, cycles: u32) {
        for n in 1..=cycles {
            let span = i64::from(n) * 1_000_000;
            self.drive(Nanos(self.time().0 + 999_999 + span), true);
        }
    }

    /// Ends a net in this way, at once or in its next cycle.
    fn end(&mut self, id: u32, ending: Ending) {
        let executor = &mut self.fixture.executor;
        match ending {
            Ending::Itself => {}
            Ending::Cancel => assert!(executor.cancel(id)),
            Ending::Abort | Ending::Shutdown => assert!(executor.abort(id)),
            Ending::Unload => self.fixture.unload(id),
            Ending::LostClient => self.fixture.lose_client(&[id, id + NEXT]),
            Ending::Rule => self.fixture.stop_by_rule(id + RULE, id, &[]),
            Ending::Overrun => executor.end_runaway(id),
            Ending::DeviceFault => self.plant.fail(true),
            Ending::EmergencyStop => self.fixture.set_stop(true),
        }
    }

    /// Runs until a net has ended.
    fn await_end(&mut self, id: u32, most: usize, what: &str) -> End {
        for _ in 0..most {
            self.step();
            if let Some(end) = self.fixture.ended.get(&id) {
                return *end;
            }
        }
        panic!("{what}: it does not end");
    }

    /// Runs until nets may command the device.
    fn await_operational(&mut self, what: &str) {
        for _ in 0..30_000 {
            if self.state.status == DeviceStatus::Operational {
                return self.steps(20);
            }
            self.step();
        }
        panic!("{what}: the device does not come back");
    }
}

/// The largest change between two values `span` steps apart.
fn fastest(values: &[f64], span: usize) -> f64 {
    let windows = values.windows(span + 1);
    let changes = windows.map(|w| (w[span] - w[0]).abs());
    changes.fold(0.0, f64::max)
}

impl Row {
    /// Maximum speed in the last cycles before its net ended.
    fn speed(&self, sent: &[f64]) -> f64 {
        // Longer than any driver's cycle.
        let last = &sent[sent.len().saturating_sub(200)..];
        match self.wire {
            Wire::Positions => fastest(last, 50) / 0.05,
            Wire::Speeds => last.iter().fold(0.0, |most, one| most.max(one.abs())),
        }
    }

    /// The sent values as positions, the last of which must be held.
    fn path(&self, sent: &[f64]) -> Vec<f64> {
        match self.wire {
            Wire::Positions => sent.to_vec(),
            Wire::Speeds => {
                let sum = |at: &mut f64, speed: &f64| {
                    *at += speed * 1e-3;
                    Some(*at)
                };
                sent.iter().scan(0.0, sum).collect()
            }
        }
    }

    /// How long and how far it may continue at its speed.
    fn stopping(&self, sent: &[f64]) -> (usize, f64) {
        let latency = self.latency.as_secs_f64();
        // It may still have been accelerating at the end.
        let speed = self.speed(sent) + self.acceleration * latency;
        let time = speed / self.acceleration + latency;
        let way = speed * speed / (2.0 * self.acceleration) + speed * latency + self.resolution;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some thousand milliseconds"
        )]
        let cycles = (time * 1e3).ceil() as usize + 2;
        (cycles, way)
    }

    /// From this cycle on it brakes within its limit, and rests after the braking time.
    fn check(&self, sent: &[f64], from: usize, ending: Ending, what: &str) {
        // After a fault it continues from its present position.
        let has_failed = ending == Ending::DeviceFault && self.wire == Wire::Positions;
        let tolerance = if has_failed {
            self.resolution.max(self.creep)
        } else {
            self.resolution
        };
        let (cycles, way) = self.stopping(&sent[..from]);
        let path = self.path(&sent[from..]);
        for (n, at) in path.iter().enumerate() {
            let gone = (at - path[0]).abs();
            assert!(gone <= way, "{what}: {gone} after {n} ms, at most {way}");
        }
        let rest = &path[cycles..];
        let most = fastest(rest, 1).max(fastest(rest, rest.len() - 1));
        assert!(most <= tolerance, "{what}: moves on by {most}");
    }

    /// All combinations of endings and periods for a device; `make` creates one for each period.
    pub(crate) fn comes_to_rest<P: Plant>(&self, make: impl Fn() -> P) {
        for every in PERIODS {
            let mut bench = Bench::new(self, make());
            let with = |ending: &Ending| (self.without)(*ending, every).is_none();
            for (number, ending) in (1..).zip(ENDINGS.into_iter().filter(with)) {
                self.ends(&mut bench, number, ending, every);
            }
        }
    }

    fn ends<P: Plant>(&self, bench: &mut Bench<P>, id: u32, ending: Ending, every: u64) {
        let what = format!("{}, {ending:?}, every {every}", self.name);
        bench.await_operational(&what);
        bench.sent.clear();
        bench.places.clear();
        let period = usize::try_from(every).unwrap();
        let evaluations = u32::try_from(self.runs / period + 3).unwrap();
        let ends_after = (ending == Ending::Itself).then_some(evaluations);
        let children = &self.children[usize::try_from((id + 1) % 2).unwrap()];
        let text = net(children, every, ends_after);
        bench.fixture.try_start(id, &text, every).unwrap();
        if ending == Ending::LostClient {
            bench.fixture.start_after(Some(id), id + NEXT, &text, every);
        }
        // Up to its first evaluation, then some more periods and a part of one.
        let until_due = every - bench.fixture.cycle % every;
        bench.steps(usize::try_from(until_due).unwrap());
        bench.steps(self.runs.max(if self.runs < 250 {
            0
        } else {
            period + period / 3
        }));
        assert_eq!(bench.fixture.ended.get(&id), None, "{what}");
        let begins = bench.sent.len();
        bench.end(id, ending);
        bench.await_end(id, 3 * period + 500, &what);
        let from = if ending == Ending::DeviceFault {
            begins
        } else {
            bench.sent.len() - 1
        };
        let path = self.path(&bench.sent[..from]);
        let moved = fastest(&path, path.len() - 1);
        assert!(moved > 20.0 * self.resolution, "{what}: {moved}, it moves");
        let (rests, _) = self.stopping(&bench.sent[..from]);
        bench.steps(rests + 300);
        self.check(&bench.sent, from, ending, &what);
        // Long enough to see any later motion.
        if ending == Ending::Shutdown {
            bench.end_driver(1_200);
        } else if ending == Ending::DeviceFault {
            bench.plant.fail(false);
            bench.await_operational(&what);
        } else {
            if ending == Ending::EmergencyStop {
                bench.fixture.set_stop(false);
            }
            bench.steps(if every > 1 { period + 50 } else { 300 });
        }
        self.check(&bench.sent, from, ending, &what);
        let places = &bench.places[from + rests + 200..];
        let most = fastest(places, places.len() - 1);
        assert!(most <= self.creep, "{what}: the device moves on by {most}");
        assert!(!bench.fixture.ended.contains_key(&(id + NEXT)), "{what}");
    }
}
