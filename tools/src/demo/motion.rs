//! The nets of the demo: arms swing all joints about their positions, in step, and return. They are ordinary nets:
//! `takt demo --print-net` shows them, `takt net load` takes them.

use std::f64::consts::TAU;
use std::time::Duration;

use super::cell::Arm;

/// By joint: how far it swings out, rad, and how often in five seconds.
const SWINGS: [(f64, f64); 7] = [
    (0.6, 1.0),
    (0.4, 2.0),
    (-0.5, 1.0),
    (0.5, 2.0),
    (0.3, 2.0),
    (-0.4, 2.0),
    (0.8, 1.0),
];

/// Largest speed of a base, m/s.
const SPEED: f64 = 0.2;

/// The net for a motion of these arms, or of a base, of that length.
pub(super) fn of(moved: &[Arm], duration: Duration) -> String {
    match moved {
        [base] if base.wheel.is_some() => forth_and_back(base.name, duration),
        arms => swing(arms, duration),
    }
}

/// The net that moves arms back to their start, by joint of each, rad.
pub(super) fn back(moved: &[Arm], home: &[Vec<f64>], duration: Duration) -> String {
    let seconds = duration.as_secs_f64().max(0.1);
    let joint = |robot: &str, (axis, home): (usize, &f64)| {
        format!(
            "    monitor{axis}=RobotArm::JointMonitor(Robot='{robot}', Axis='{axis}'),
    start{axis}=Core::DoubleSnapshot(inSnapshot=parent.inFirst, \
             inValue=monitor{axis}.outCommandedPosition),
    minus{axis}=Core::DoubleMultiply(inFirst=start{axis}.outValue, Second='-1'),
    way{axis}=Core::DoubleAdd(inFirst=minus{axis}.outValue, Second='{home}'),
    offset{axis}=Core::DoubleMultiply(inFirst=parent.inAmount, inSecond=way{axis}.outValue),
    target{axis}=Core::DoubleAdd(inFirst=start{axis}.outValue, inSecond=offset{axis}.outValue),
    joint{axis}=RobotArm::JointPosition(inPosition=target{axis}.outValue, Robot='{robot}', \
             Axis='{axis}'),
"
        )
    };
    let arm = |(arm, home): (&Arm, &Vec<f64>)| {
        let joints = home.iter().enumerate().map(|home| joint(arm.name, home));
        let joints: String = joints.collect();
        let (name, joints) = (arm.name, joints.trim_end_matches(",\n"));
        format!("  {name}={{\n{joints}\n  }}(inAmount=amount.outValue, inFirst=first.outValue),\n")
    };
    let arms: String = moved.iter().zip(home).map(arm).collect();
    format!(
        "{{
  clock=Core::Clock(),
  part=Core::Interval(inValue=clock.outValue, Max='{seconds}'),
  amount=Core::Rampify(inValue=part.outValue, Constant='0.6'),
  true=Core::BooleanValue(Value='true'),
  past=Core::BooleanPre(inValue=true.outValue),
  first=Core::BooleanIsNull(inValue=past.outValue),
{arms}
  cancel=Cancel(),
  done=Core::DoubleGreater(inFirst=clock.outValue, Second='{seconds}'),
  over=Core::BooleanOr(inFirst=done.outValue, inSecond=cancel.outCancel),
  outTerminate=over.outValue
}}
"
    )
}

/// The net for a motion of these arms of that length.
fn swing(moved: &[Arm], duration: Duration) -> String {
    let seconds = duration.as_secs_f64().max(0.1);
    // As many swings as fit at the same speed; in a short time, smaller ones.
    let repeats = (seconds / 5.0).round().max(1.0);
    let scale = (seconds / (5.0 * repeats)).powi(2).min(1.0);
    let arms: Vec<String> = moved
        .iter()
        .map(|moved| arm(*moved, repeats, scale))
        .collect();
    let good: Vec<String> = moved
        .iter()
        .map(|moved| format!("{}.outGood", moved.name))
        .collect();
    let (all_good, gates) = all_of("good", &good);
    format!(
        "{{
  # a cancel slows the motion down to a stop on its path, within half a second
  cancel=Cancel(),
  since=Core::Clock(inActive=cancel.outCancel),
  spent=Core::Interval(inValue=since.outValue, Max='0.5'),
  lost=Core::DoubleMultiply(inFirst=spent.outValue, Second='-1'),
  slower=Core::DoubleAdd(inFirst=lost.outValue, Second='1'),
  speed=Core::DoubleConditional(inCondition=cancel.outCancel, inTrue=slower.outValue, False='1'),
  gain=Core::DoubleNetcommIn(Key='gain', Value='1'),
  rate=Core::DoubleMultiply(inFirst=speed.outValue, inSecond=gain.outValue),

  # progress of the motion, 0 to 1, speeding up and slowing down
  clock=Core::Clock(inIncrement=rate.outValue),
  part=Core::Interval(inValue=clock.outValue, Max='{seconds}'),
  amount=Core::Rampify(inValue=part.outValue, Constant='0.6'),
  progress=Core::DoubleNetcommOut(inValue=amount.outValue, Key='progress'),

  # true in the first cycle only
  true=Core::BooleanValue(Value='true'),
  past=Core::BooleanPre(inValue=true.outValue),
  first=Core::BooleanIsNull(inValue=past.outValue),

{arms}
{gates}  result=Core::BooleanNetcommOut(inValue={all_good}, Key='good'),
  failed=Core::BooleanNot(inValue={all_good}),

  # the end: done, stopped after a cancel, or failed
  done=Core::DoubleGreater(inFirst=clock.outValue, Second='{seconds}'),
  moving=Core::DoubleGreater(inFirst=speed.outValue),
  stopped=Core::BooleanNot(inValue=moving.outValue),
  over=Core::BooleanOr(inFirst=done.outValue, inSecond=stopped.outValue),
  end=Core::BooleanOr(inFirst=over.outValue, inSecond=failed.outValue),
  outTerminate=end.outValue
}}
",
        arms = arms.concat()
    )
}

/// The net that drives a base forth and back in that time.
fn forth_and_back(base: &str, duration: Duration) -> String {
    let seconds = duration.as_secs_f64().max(0.1);
    format!(
        "{{
  clock=Core::Clock(),
  part=Core::Interval(inValue=clock.outValue, Max='{seconds}'),
  angle=Core::DoubleMultiply(inFirst=part.outValue, Second='{TAU}'),
  sine=Core::DoubleSin(inValue=angle.outValue),
  speed=Core::DoubleMultiply(inFirst=sine.outValue, Second='{SPEED}'),
  velocity=World::TwistFromXYZ(inX=speed.outValue),
  move=RobotBase::BaseVelocity(inVel=velocity.outValue, Robot='{base}'),
  good=Core::IntEquals(inFirst=move.outError),
  failed=Core::BooleanNot(inValue=good.outValue),
  cancel=Cancel(),
  done=Core::DoubleGreater(inFirst=clock.outValue, Second='{seconds}'),
  over=Core::BooleanOr(inFirst=done.outValue, inSecond=cancel.outCancel),
  end=Core::BooleanOr(inFirst=over.outValue, inSecond=failed.outValue),
  outTerminate=end.outValue
}}
"
    )
}

/// The fragment that moves one arm.
fn arm(
    Arm {
        name: robot,
        joints,
        ..
    }: Arm,
    repeats: f64,
    scale: f64,
) -> String {
    let joint = |(axis, (swing, often)): (usize, &(f64, f64))| {
        let angle = TAU * often * repeats;
        let half = swing * scale / 2.0;
        format!(
            "    monitor{axis}=RobotArm::JointMonitor(Robot='{robot}', Axis='{axis}'),
    start{axis}=Core::DoubleSnapshot(inSnapshot=parent.inFirst, \
             inValue=monitor{axis}.outCommandedPosition),
    angle{axis}=Core::DoubleMultiply(inFirst=parent.inAmount, Second='{angle}'),
    cosine{axis}=Core::DoubleCos(inValue=angle{axis}.outValue),
    swing{axis}=Core::DoubleMultiply(inFirst=cosine{axis}.outValue, Second='{}'),
    offset{axis}=Core::DoubleAdd(inFirst=swing{axis}.outValue, Second='{half}'),
    target{axis}=Core::DoubleAdd(inFirst=start{axis}.outValue, inSecond=offset{axis}.outValue),
    joint{axis}=RobotArm::JointPosition(inPosition=target{axis}.outValue, Robot='{robot}', \
             Axis='{axis}'),
    good{axis}=Core::IntEquals(inFirst=joint{axis}.outError),
",
            -half
        )
    };
    let joints = joints.len();
    let good: Vec<String> = (0..joints)
        .map(|axis| format!("good{axis}.outValue"))
        .collect();
    let joints: String = SWINGS.iter().take(joints).enumerate().map(joint).collect();
    let (all, gates) = all_of("all", &good);
    format!(
        "  {robot}={{
{joints}{gates}    outGood={all}
  }}(inAmount=amount.outValue, inFirst=first.outValue),
"
    )
}

/// Gates that join `sources` by "and": the port of the last one and their text.
fn all_of(name: &str, sources: &[String]) -> (String, String) {
    let mut last = sources.first().cloned().unwrap_or_default();
    let mut text = String::new();
    for (i, source) in sources.iter().enumerate().skip(1) {
        let gate = format!("{name}And{i}");
        text += &format!("    {gate}=Core::BooleanAnd(inFirst={last}, inSecond={source}),\n");
        last = format!("{gate}.outValue");
    }
    (last, text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::cell::Kind;

    #[test]
    fn demo_nets_of_all_parts_load() {
        let cell = Kind::Factory;
        for arms in cell.parts() {
            let home: Vec<_> = arms
                .iter()
                .map(|arm| vec![-1e-9; arm.joints.len()])
                .collect();
            let nets = [
                of(arms, Duration::from_secs(3)),
                back(arms, &home, Duration::from_secs(3)),
            ];
            for net in nets {
                let mut faults = Vec::new();
                takt_net::text::parse(&net, &takt_net::Limits::default(), &mut faults);
                assert!(faults.is_empty(), "{faults:?}\n{net}");
            }
        }
    }
}
