//! A net that uses every kind of device at once, and the devices it uses.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "shared by test files that need different parts"
)]

use std::collections::BTreeMap;

use super::stand::{arm_parameters, parameters, watch};

/// Every kind of device: name, type and parameters.
pub fn devices() -> Vec<(&'static str, &'static str, BTreeMap<String, String>)> {
    let load = ("external_wrench", "[10,0,0,0,0,0]");
    vec![
        ("lwr", "kuka_lwr_sim", arm_parameters(7, &[load])),
        ("iiwa", "kuka_iiwa_sim", arm_parameters(7, &[])),
        ("arm", "kuka_youbot_arm_sim", arm_parameters(5, &[])),
        ("base", "kuka_youbot_base_sim", parameters(&[])),
        ("ship", "kuka_youbot_base_sim", parameters(&[])),
        ("hand", "kuka_youbot_gripper_sim", parameters(&[])),
        ("io", "io_sim", parameters(&[])),
    ]
}

/// Uses all of them for so many seconds.
pub fn net(seconds: f64) -> String {
    format!(
        "{{clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='{seconds}'),
        smooth=Core::DoubleBezier(inValue=part.outValue,To='0.3'),
        j1=RobotArm::JointPosition(inPosition=smooth.outValue,Robot='lwr',Axis='1'),
        j2=RobotArm::JointPosition(inPosition=smooth.outValue,Robot='arm',Axis='1'),
        m1=RobotArm::JointMonitor(Robot='lwr',Axis='1'),
        three=Core::IntValue(Value='3'),hundred=Core::DoubleValue(Value='100'),
        strategy=KUKA::LWR::ControlStrategy(inStrategy=three.outValue,Robot='iiwa'),
        soft=KUKA::LWR::JointImpParameters(inStiffness=hundred.outValue,inAddTorque=smooth.outValue,
            Robot='iiwa',Axis='2'),
        wrench=World::WrenchValue(Value='{{force:{{x:500}}}}'),
        cart=KUKA::LWR::CartImpParameters(inStiffness=wrench.outValue,Robot='iiwa'),
        mi=RobotArm::JointMonitor(Robot='iiwa',Axis='2'),
        tool=RobotArm::ToolParameters(Robot='iiwa',Axis='6',Mass='2'),
        forces=KUKA::LWR::FTMonitor(Robot='lwr'),
        controller=KUKA::youBot::ArmControlStrategy(Robot='arm'),
        flags=KUKA::youBot::SlaveError(Robot='arm',Port='2'),
        to=World::FrameValue(Value='{{pos:{{x:1,y:1}},rot:{{a:1}}}}'),
        bm=RobotBase::BaseMonitor(Robot='base'),w=RobotBase::WheelMonitor(Robot='base',Wheel='2'),
        go=RobotBase::OmnidirectionalBaseController(inDest=to.outValue,inPos=bm.outPos,
            inVel=bm.outVel),
        bv=RobotBase::BaseVelocity(inVel=go.outVel,Robot='base'),
        rot=World::RotationValue(),
        pose=World::FrameFromXYZ(inX=smooth.outValue,inRot=rot.outValue),
        cp=CartesianPosition::CartesianPosition(inPosition=pose.outValue,Robot='ship'),
        cm=CartesianPosition::CartesianMonitor(Robot='ship'),
        xyz=World::FrameToXYZ(inValue=cm.outMeasuredPosition),
        open=KUKA::youBot::Gripper(Robot='hand',Distance='0.01'),
        gm=KUKA::youBot::GripperMonitor(Robot='hand'),
        high=Core::DoubleGreater(inFirst=smooth.outValue,Second='0.15'),
        ob=IO::OutBool(inIO=high.outValue,DeviceID='io'),
        or=IO::OutReal(inIO=smooth.outValue,DeviceID='io'),
        ib=IO::InBool(DeviceID='io'),ir=IO::InReal(DeviceID='io'),
        os=IO::OutBoolSensor(DeviceID='io'),on=IO::OutRealSensor(DeviceID='io'),
        five=KUKA::youBot::PositionPreservingProject(inFlange=pose.outValue),
        down=KUKA::youBot::PalletizingProject(inFlange=five.outValue),
        {},over=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
        outTerminate=over.outValue}}",
        [
            watch("Core::Double", "lwr", "m1.outMeasuredPosition"),
            watch("Core::Double", "iiwa", "mi.outMeasuredPosition"),
            watch("Core::Boolean", "strategy", "strategy.outCompleted"),
            watch("Core::Boolean", "tool", "tool.outCompleted"),
            watch("Core::Double", "torque", "forces.outEstJ2"),
            watch("Core::Boolean", "flag", "flags.bit15"),
            watch("World::Frame", "base", "bm.outPos"),
            watch("Core::Double", "wheel", "w.outPos"),
            watch("Core::Double", "ship", "xyz.outX"),
            watch("Core::Double", "hand", "gm.outDistance"),
            watch("Core::Boolean", "bool", "ib.outIO"),
            watch("Core::Double", "real", "ir.outIO"),
            watch("Core::Int", "errors", "bv.outError"),
            watch("World::Frame", "down", "down.outValue"),
        ]
        .join(",")
    )
}
