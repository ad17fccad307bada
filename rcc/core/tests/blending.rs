//! Motion blending of Vistein et al. 2014, section 6.2 (figures 6 and 7, listing 1), in both traces
//! of figure 4: from A by way of C to E, where the second net takes over at B if it was scheduled
//! in time, and else starts at C. In virtual time; the arm follows its set-points at once.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_core::device::{ArmDescription, DeviceStatus, DeviceTable};
use takt_core::executor::rules::{Literal, NetActions, Question, Rule, Step};
use takt_core::executor::{DeviceView, Effect, Executor, Running};
use takt_net::{JointLimits, Limits, LoadContext, Moment, Nanos, load};
use takt_rt::latest::latest;

const PERIOD: Duration = Duration::from_millis(1);

/// Joints 0 and 1 of the arm are the plane of figure 1: A (0, 0), C (0.4, 0), E (0.4, 0.4); B lies
/// half-way to C, D half-way to E.
const FIRST: &str = "{
  # trajectory fragment: from A to C within two seconds, at constant speed in its middle half
  clock=Core::Clock(), part=Core::Interval(inValue=clock.outValue, Max='2'),
  amount=Core::Rampify(inValue=part.outValue, Constant='0.5'),
  x=Core::Lerp(inAmount=amount.outValue, From='0', To='0.4'),
  jointX=RobotArm::JointPosition(inPosition=x.outValue, Robot='arm', Axis='0'),
  jointY=RobotArm::JointPosition(inPosition=Core::DoubleValue().outValue, Robot='arm', Axis='1'),

  # point B reached fragment: looked at only while a successor is scheduled
  takeover=Takeover(),
  b={ past=Core::DoubleGreater(inFirst=parent.inPart, Second='0.5'),
      after=Core::DoubleGreater(inFirst=parent.inPart, Second='0.6'),
      not=Core::BooleanNot(inValue=after.outValue),
      at=Core::BooleanAnd(inFirst=past.outValue, inSecond=not.outValue),
      outReached=at.outValue }(inActive=takeover.outTakeover, inPart=part.outValue),
  done=Core::DoubleGreater(inFirst=clock.outValue, Second='2'),
  end=Core::BooleanOr(inFirst=b.outReached, inSecond=done.outValue),
  outTerminate=end.outValue
}";

/// From B to D on a curve, or from C to D, and then on to E. Speed at B: 0.4 rad in 1.5 s.
const SECOND: &str = "{
  true=Core::BooleanValue(Value='true'), past=Core::BooleanPre(inValue=true.outValue),
  first=Core::BooleanIsNull(inValue=past.outValue),
  monitor=RobotArm::JointMonitor(Robot='arm', Axis='0'),
  start=Core::DoubleSnapshot(inSnapshot=first.outValue, inValue=monitor.outCommandedPosition),
  nearC=Core::DoubleGreater(inFirst=start.outValue, Second='0.39'),
  nearB=Core::BooleanNot(inValue=nearC.outValue),

  clock=Core::Clock(), part=Core::Interval(inValue=clock.outValue, Max='1.5'),
  rest=Core::DoubleAdd(inFirst=clock.outValue, Second='-1.5'),
  toE=Core::Interval(inValue=rest.outValue, Max='1.5'),
  late=Core::DoubleGreater(inFirst=clock.outValue, Second='1.5'),
  early=Core::BooleanNot(inValue=late.outValue),
  viaB=Core::BooleanAnd(inFirst=nearB.outValue, inSecond=early.outValue),
  viaC=Core::BooleanAnd(inFirst=nearC.outValue, inSecond=early.outValue),

  fromB={ x=Core::DoubleBezier(inValue=parent.inPart, inFrom=parent.inStart, FromVel='0.4', To='0.4'),
          y=Core::DoubleBezier(inValue=parent.inPart, To='0.2', ToVel='0.3'),
          outX=x.outValue, outY=y.outValue }
        (inActive=viaB.outValue, inPart=part.outValue, inStart=start.outValue),
  fromC={ y=Core::DoubleBezier(inValue=parent.inPart, To='0.2', ToVel='0.3'),
          x=Core::DoubleValue(Value='0.4'), outX=x.outValue, outY=y.outValue }
        (inActive=viaC.outValue, inPart=part.outValue),
  fromD={ y=Core::DoubleBezier(inValue=parent.inPart, From='0.2', FromVel='0.3', To='0.4'),
          x=Core::DoubleValue(Value='0.4'), outX=x.outValue, outY=y.outValue }
        (inActive=late.outValue, inPart=toE.outValue),

  beforeX=Core::DoubleConditional(inCondition=nearB.outValue, inTrue=fromB.outX, inFalse=fromC.outX),
  beforeY=Core::DoubleConditional(inCondition=nearB.outValue, inTrue=fromB.outY, inFalse=fromC.outY),
  x=Core::DoubleConditional(inCondition=late.outValue, inTrue=fromD.outX, inFalse=beforeX.outValue),
  y=Core::DoubleConditional(inCondition=late.outValue, inTrue=fromD.outY, inFalse=beforeY.outValue),
  jointX=RobotArm::JointPosition(inPosition=x.outValue, Robot='arm', Axis='0'),
  jointY=RobotArm::JointPosition(inPosition=y.outValue, Robot='arm', Axis='1'),
  done=Core::DoubleGreater(inFirst=clock.outValue, Second='3'),
  outTerminate=done.outValue
}";

/// The arm and the thread that would move it, in virtual time.
struct Stage {
    executor: Executor,
    cycle: u64,
    /// By cycle: which net ended, and where the joints are.
    path: Vec<[f64; 2]>,
    velocity: [f64; 2],
}

fn net(id: u32, text: &str) -> Box<Running> {
    let mut devices = DeviceTable::default();
    let limits = JointLimits {
        position_min: -1.0,
        position_max: 1.0,
        velocity_max: 1.0,
        acceleration_max: 4.0,
    };
    let description = ArmDescription {
        name: "arm".to_owned(),
        kind: "test",
        limits: vec![limits; 2],
        model: "".into(),
    };
    devices.add_arm(description).unwrap();
    let registry = takt_core::registry();
    let context = LoadContext {
        registry: &registry,
        devices: &devices,
        period: PERIOD,
        limits: Limits::default(),
    };
    let plan = load(text, &context).unwrap_or_else(|r| panic!("{}", r.render("net", text)));
    let words = |n: usize| vec![0; n].into_boxed_slice();
    let (out, _) = latest(1, || words(plan.outbox().words()));
    let (_, inbox) = latest(1, || words(plan.inbox().words()));
    let mut running = Box::new(Running::new(id, plan, out, inbox));
    // All joints are one resource here.
    running.resources.insert(0);
    running.devices.push((0, 0));
    running
}

impl Stage {
    fn new() -> Self {
        let mut executor = Executor::default();
        executor.use_joints(2);
        executor.set_device(
            0,
            DeviceView {
                status: DeviceStatus::Operational,
                faults: 0,
                jumps: 0,
            },
        );
        Self {
            executor,
            cycle: 0,
            path: vec![[0.0; 2]],
            velocity: [0.0; 2],
        }
    }

    /// Schedules net 2 to start when net 1 terminates.
    fn schedule(&mut self) {
        self.executor.schedule(net(2, SECOND)).unwrap();
        let literal = Literal {
            net: 1,
            question: Question::Terminated,
            value: None,
            last: false,
        };
        let orders = NetActions {
            start: vec![2],
            ..NetActions::default()
        };
        let rule = Box::new(Rule::new(0, vec![literal], vec![Step::Literal(0)], orders));
        self.executor.add_rule(rule).unwrap();
    }

    /// One cycle; returns the nets that ended in it.
    fn cycle(&mut self) -> Vec<u32> {
        self.cycle += 1;
        for (joint, (at, velocity)) in self
            .executor
            .joints()
            .iter()
            .zip(self.path.last().unwrap().iter().zip(self.velocity))
        {
            let mut state = joint.state.get();
            state.commanded_position = Some(*at);
            state.commanded_velocity = Some(velocity);
            joint.state.set(state);
        }
        self.executor.announce_takeovers(|_, _| ());
        let time = Nanos(i64::try_from(self.cycle).unwrap() * 1_000_000);
        let moment = Moment {
            cycle: self.cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        self.executor.cycle(moment);
        let before = *self.path.last().unwrap();
        let mut now = before;
        for (position, joint) in now.iter_mut().zip(self.executor.joints()) {
            let command = joint.command.get();
            assert_eq!(command.cycle, self.cycle, "a cycle without a set-point");
            *position = command.position;
        }
        self.velocity = std::array::from_fn(|i| (now[i] - before[i]) / PERIOD.as_secs_f64());
        self.path.push(now);
        self.executor.fire_rules();
        self.executor
            .effects(|id, effect| assert_eq!((id, effect), (2, Effect::Started)));
        let mut ended = Vec::new();
        while self.executor.take_ended(|net, _| {
            ended.push(net.id);
            Ok(())
        }) {}
        ended
    }

    /// Runs from A to E; the second net is scheduled in cycle `scheduled`.
    fn run(scheduled: u64) -> Self {
        let mut stage = Self::new();
        stage.executor.start(net(1, FIRST)).unwrap();
        let mut first_ended = None;
        loop {
            if stage.cycle == scheduled {
                stage.schedule();
            }
            let ended = stage.cycle();
            if ended.contains(&1) {
                first_ended = Some(stage.cycle);
            }
            if ended.contains(&2) {
                assert!(first_ended.is_some());
                return stage;
            }
            assert!(stage.cycle < 10_000, "E is not reached");
        }
    }

    /// Checks that position and velocity are continuous: no step beyond the limits of the motion.
    fn assert_smooth(&self) {
        let dt = PERIOD.as_secs_f64();
        let velocity = |pair: &[[f64; 2]], i: usize| (pair[1][i] - pair[0][i]) / dt;
        for i in 0..2 {
            let speeds: Vec<f64> = self.path.windows(2).map(|p| velocity(p, i)).collect();
            let fastest = speeds.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
            assert!(fastest < 0.6, "joint {i} moves at {fastest} rad/s");
            for (cycle, pair) in speeds.windows(2).enumerate() {
                let change = (pair[1] - pair[0]).abs();
                assert!(
                    change < 2.5 * dt,
                    "joint {i}, cycle {cycle}: {pair:?} rad/s"
                );
            }
        }
        let [x, y] = *self.path.last().unwrap();
        assert!(
            (x - 0.4).abs() < 1e-6 && (y - 0.4).abs() < 1e-6,
            "ends at ({x}, {y})"
        );
    }

    /// The smallest distance of the path from C.
    fn distance_from_c(&self) -> f64 {
        let distance = |[x, y]: &[f64; 2]| (x - 0.4).hypot(*y);
        self.path.iter().map(distance).fold(f64::MAX, f64::min)
    }
}

#[test]
fn blending_net_scheduled_in_time_takes_over_at_b() {
    let stage = Stage::run(500);
    stage.assert_smooth();
    assert!(
        stage.distance_from_c() > 0.01,
        "{}",
        stage.distance_from_c()
    );
    // One second to B, three more to E.
    assert!((4_000..4_010).contains(&stage.cycle), "{}", stage.cycle);
}

#[test]
fn blending_net_scheduled_late_starts_at_c() {
    let stage = Stage::run(1_500);
    stage.assert_smooth();
    assert!(
        stage.distance_from_c() < 1e-6,
        "{}",
        stage.distance_from_c()
    );
    assert!((5_000..5_010).contains(&stage.cycle), "{}", stage.cycle);
}
