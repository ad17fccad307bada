//! Two arms hold one object: one net commands both. When one arm fails, the other comes to rest on the common path.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod fixtures;

use fixtures::{Driven, Fixture, arm_parameters};
use takt_core::device::{DeviceState, DeviceStatus, sim};
use takt_core::executor::End;
use takt_net::Frame;
use takt_net::device::{Devices, JointState};

const NET: u32 = 1;
const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];

/// The arm `left` is simulated, `right` is driven by the test, which can let it fail.
struct Bench {
    fixture: Fixture,
    right: Driven,
    state: DeviceState,
}

impl Bench {
    fn new() -> Self {
        let mut fixture = Fixture::default();
        let home = format!("{BENT:?}");
        let parameters = arm_parameters(7, &[("home_joint", &home)]);
        fixture.add("left", "kuka_lwr_sim", &parameters);
        let (description, _) = sim::make("right", "kuka_lwr_sim", &parameters).unwrap();
        let right = fixture.add_driven(description);
        let words = fixture.table.find("right").unwrap().place.signals.len();
        let mut state = DeviceState::new(words);
        state.status = DeviceStatus::Operational;
        for (joint, at) in state.joints.iter_mut().zip(BENT) {
            *joint = JointState {
                commanded_position: Some(at),
                measured_position: Some(at),
                ..JointState::default()
            };
        }
        let mut bench = Self {
            fixture,
            right,
            state,
        };
        (0..2).for_each(|_| bench.step());
        bench
    }

    /// One cycle; then the right arm follows its set-points at once, while it is operational.
    fn step(&mut self) {
        self.fixture.step();
        let state = &mut self.state;
        if state.status == DeviceStatus::Operational {
            self.right.command.read_with(|command| {
                for (joint, points) in state.joints.iter_mut().zip(&command.joints) {
                    if points.active {
                        let position = Some(points.points[0].position);
                        joint.commanded_position = position;
                        joint.measured_position = position;
                    }
                }
            });
        }
        self.right.state.write_with(|slot| slot.copy_from(state));
    }

    fn enter(&mut self, status: DeviceStatus) {
        self.state.enter(status, takt_rt::Nanos(0));
        for joint in &mut self.state.joints {
            joint.error = i32::from(status != DeviceStatus::Operational);
        }
        self.right
            .state
            .write_with(|slot| slot.copy_from(&self.state));
    }

    /// How many joints of the right arm are commanded.
    fn commanded(&mut self) -> usize {
        let count = |command: &takt_core::device::DeviceCommand| {
            command.joints.iter().filter(|joint| joint.active).count()
        };
        self.right.command.read_with(count)
    }

    /// Where the flange of the left arm is commanded to be, in its base.
    fn flange(&self) -> Frame {
        let arm = self.fixture.table.arm("left").unwrap();
        let state = self.fixture.table.find("left").unwrap().state();
        let joints = state.joints[..7].iter();
        let joints: Vec<_> = joints
            .map(|joint| joint.commanded_position.unwrap())
            .collect();
        arm.kinematics.unwrap().forward(&joints)
    }
}

/// One motion of the object, in the bases of both arms; each side reports by `outFailed` that it has no joints for it.
fn lift(from: Frame, to: Frame, failure: &str) -> String {
    let arm = |robot: &str| {
        let each = |text: &dyn Fn(usize) -> String| (0..7).map(text).collect::<String>();
        let monitors =
            each(&|n| format!("n{n}=RobotArm::JointMonitor(Robot='{robot}',Axis='{n}'),"));
        let hints = each(&|n| {
            let before = n
                .checked_sub(1)
                .map_or_else(|| "h".to_owned(), |m| format!("h{m}"));
            format!(
                "h{n}=Core::DoubleArraySet(inArray={before}.outArray,inValue=n{n}.outCommandedPosition,Size='7',Index='{n}'),"
            )
        });
        let joints = each(&|n| {
            format!(
                "q{n}=Core::DoubleArrayGet(inArray=ik.outJoints,Size='7',Index='{n}'),\
                     j{n}=RobotArm::JointPosition(inPosition=q{n}.outValue,Robot='{robot}',Axis='{n}'),"
            )
        });
        format!(
            "{robot}={{{monitors}h=Core::DoubleArray(Size='7'),{hints}\
                 ik=ArmKinematics::InvKin(inFrame=parent.inObject,inHintJoints=h6.outArray,Robot='{robot}'),\
                 {joints}none=Core::DoubleArrayIsNull(inValue=ik.outJoints),outFailed=none.outValue}}(inObject=m.outPosition)"
        )
    };
    let frame = |frame: Frame| {
        let p = frame.translation;
        let (a, b, c) = frame.rotation.euler_angles();
        format!(
            "{{pos:{{x:{},y:{},z:{}}},rot:{{a:{c},b:{b},c:{a}}}}}",
            p.x, p.y, p.z
        )
    };
    format!(
        "{{cancel=Cancel(),{failure},
        m=Motion::Lin(inStop=stop.outValue,From='{}',To='{}',Velocity='0.3',Acceleration='1',Jerk='10'),
        {},{},
        stop=Core::BooleanOr(inFirst=cancel.outCancel,inSecond=lost.outFailed),
        failed=Core::BooleanNetcommOut(inValue=lost.outFailed,Key='failed'),
        outTerminate=m.outDone}}",
        frame(from),
        frame(to),
        arm("left"),
        arm("right")
    )
}

/// Moves both arms by 0.3 m, lets the right one fail half-way, and runs until the left one rests: why the net ended, the
/// largest distance of the left flange from the path, m, and its largest turn, rad. The right arm returns at once.
fn broken_lift(failure: &str) -> (End, f64, f64) {
    let mut bench = Bench::new();
    let from = bench.flange();
    let mut to = from;
    to.translation.x += 0.1;
    to.translation.z += 0.25;
    let net = lift(from, to, failure);
    bench.fixture.try_start(NET, &net, 1).unwrap();
    (0..600).for_each(|_| bench.step());
    assert!(bench.fixture.ended.is_empty());
    assert_eq!(bench.commanded(), 7);
    bench.enter(DeviceStatus::SafeOperational);
    let direction = (to.translation.vector - from.translation.vector).normalize();
    let (mut far, mut turned): (f64, f64) = (0.0, 0.0);
    for cycle in 0..2000 {
        bench.step();
        if cycle == 20 {
            bench.enter(DeviceStatus::Operational);
        }
        if cycle > 0 {
            assert_eq!(
                bench.commanded(),
                0,
                "nothing is commanded to the failed arm"
            );
        }
        let flange = bench.flange();
        let way = flange.translation.vector - from.translation.vector;
        far = far.max((way - direction * way.dot(&direction)).norm());
        turned = turned.max(flange.rotation.angle_to(&from.rotation));
    }
    let left = bench.fixture.table.find("left").unwrap();
    assert!(left.is_at_rest());
    let end = bench.fixture.ended.get(&NET).copied();
    (end.unwrap(), far, turned)
}

#[test]
fn coupled_arm_rests_on_path_when_partner_fails() {
    let (end, far, turned) = broken_lift("lost=DeviceFailure(Time='1')");
    assert_eq!(end, End::Terminated);
    assert!(far < 1e-4 && turned < 1e-4, "{far} m, {turned} rad");
}

#[test]
fn coupled_arm_without_policy_leaves_path() {
    let never = "lost={no=Core::BooleanValue(Value='false'),outFailed=no.outValue}()";
    let (end, far, turned) = broken_lift(never);
    assert!(matches!(end, End::DeviceFault(_)));
    assert!(far > 5e-4 && turned > 1e-3, "{far} m, {turned} rad");
}

#[test]
fn coupled_net_out_of_time_ends() {
    let (end, _, _) = broken_lift("lost=DeviceFailure(Time='0.05')");
    assert!(matches!(end, End::DeviceFault(_)), "{end:?}");
}

#[test]
fn coupled_net_ends_at_once_in_emergency_stop() {
    let mut bench = Bench::new();
    let from = bench.flange();
    let mut to = from;
    to.translation.z += 0.2;
    let net = lift(from, to, "lost=DeviceFailure(Time='1')");
    bench.fixture.try_start(NET, &net, 1).unwrap();
    (0..300).for_each(|_| bench.step());
    bench.fixture.set_stop(true);
    (0..3).for_each(|_| bench.step());
    let end = bench.fixture.ended.get(&NET).copied();
    assert!(matches!(end, Some(End::DeviceFault(_))), "{end:?}");
}
