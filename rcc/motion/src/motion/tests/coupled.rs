//! Two arms that hold one object on a path that one of them cannot reach to its end.

use std::sync::Arc;

use super::*;
use crate::kinematics::Srs;
use takt_net::device::Kinematics as _;

const START: [f64; 7] = [0.0, 0.5, 0.0, -1.4, 0.0, 1.0, 0.0];

/// The joints of an arm: those of the previous cycle are the hint. A rest beyond reach stops the motion.
fn arm(name: &str, base: f64) -> String {
    let start = list(&START);
    let mut text = format!(
        "{name}={{base=World::FrameValue(Value='{{pos:{{y:{base}}}}}'),\
         flange=World::FrameTransform(inFirst=base.outValue,inSecond=parent.inObject),\
         rest=World::FrameTransform(inFirst=base.outValue,inSecond=parent.inRest),\
         start=Core::DoubleArrayNetcommIn(Key='{name}',Value='{start}'),h0=Core::DoubleArray(Size='7'),"
    );
    for i in 0..7 {
        let next = i + 1;
        text += &format!(
            "s{i}=Core::DoubleArrayGet(inArray=start.outValue,Size='7',Index='{i}'),\
             g{i}=Core::DoubleArrayGet(inArray=ik.outJoints,Size='7',Index='{i}'),\
             p{i}=Core::DoublePre(inValue=g{i}.outValue),n{i}=Core::DoubleIsNull(inValue=p{i}.outValue),\
             c{i}=Core::DoubleConditional(inCondition=n{i}.outValue,inTrue=s{i}.outValue,inFalse=p{i}.outValue),\
             h{next}=Core::DoubleArraySet(inArray=h{i}.outArray,inValue=c{i}.outValue,Size='7',Index='{i}'),"
        );
    }
    text + "ik=ArmKinematics::InvKin(inFrame=flange.outValue,inHintJoints=h7.outArray,Robot='arm'),\
            ahead=ArmKinematics::InvKin(inFrame=rest.outValue,inHintJoints=h7.outArray,Robot='arm'),\
            none=Core::DoubleArrayIsNull(inValue=ahead.outJoints),outBeyond=none.outValue,outJoints=ik.outJoints}"
        + "(inObject=m.outPosition,inRest=m.outRest),"
}

#[test]
fn coupled_arms_brake_on_common_path_before_unreachable_pose() {
    let robot = Srs::kuka_lwr4();
    let from = robot.forward(&START);
    let to = Frame::translation(0.8, 0.0, 0.0) * from;
    let bounds = "Velocity='0.3',Acceleration='1',Jerk='10'";
    let net = format!(
        "m=Motion::Lin(inStop=was.outValue,From='{}',To='{}',{bounds}),{}{}\
         beyond=Core::BooleanOr(inFirst=left.outBeyond,inSecond=right.outBeyond),\
         kept=Core::Trigger(inOn=beyond.outValue),was=Core::BooleanPre(inValue=kept.outActive),\
         w1=Core::DoubleArrayNetcommOut(inValue=left.outJoints,Key='l'),\
         w2=Core::DoubleArrayNetcommOut(inValue=right.outJoints,Key='r'),\
         w3=Core::BooleanNetcommOut(inValue=m.outDone,Key='d'),w4=Core::DoubleNetcommOut(inValue=m.outProgress,Key='u')",
        text(from),
        text(to),
        arm("left", 0.0),
        arm("right", 0.25)
    );
    let arm = Arm {
        kinematics: Some(Arc::new(robot.clone())),
        joints: 7,
    };
    let mut fixture = Fixture::new(&net, &arm);
    let grasp = |joints: &str, base: f64| {
        let joints = parse_array(joints, 7).expect("the arms follow the path to its rest");
        Frame::translation(0.0, -base, 0.0) * robot.forward(&joints)
    };
    let mut cycles = 0;
    while cycles == 0 || fixture.read("d") != "true" {
        fixture.step();
        cycles += 1;
        assert!(cycles < 5000, "the arms do not come to rest");
        let (left, right) = (
            grasp(&fixture.read("l"), 0.0),
            grasp(&fixture.read("r"), 0.25),
        );
        let off = (left.translation.vector - right.translation.vector).norm();
        assert!(
            off < 1e-9 && left.rotation.angle_to(&right.rotation) < 1e-6,
            "{cycles}: {off}"
        );
    }
    let progress = f64::parse(&fixture.read("u")).expect("progress");
    assert!((0.1..0.95).contains(&progress), "{progress}");
}
