//! The elbow of an arm with seven joints, where a line takes over from a motion of its joints.

use std::time::Duration;

use takt_net::device::Kinematics;

use super::super::live::FrameMotion;
use super::super::plan::{FrameBounds, FrameState, Route};
use super::*;
use crate::kinematics::Srs;

/// The largest change of a joint's velocity, rad/s², from joints in motion along a line on, with a hint that coasts or without.
fn hardest(is_coasting: bool) -> f64 {
    let arm = Srs::kuka_lwr4();
    let mut joints = vec![0.3, 0.6, -0.3, -1.2, 0.4, 0.9, -0.2];
    let mut velocities = vec![0.5, 0.3, -0.6, -0.2, 0.5, 0.1, 0.4];
    let mut columns = [Twist::default(); 7];
    arm.jacobian(&joints, &mut columns);
    let mut velocity = Twist::default();
    for (column, rate) in columns.iter().zip(&velocities) {
        velocity.vel += column.vel * *rate;
        velocity.rot += column.rot * *rate;
    }
    let from = FrameState {
        frame: arm.forward(&joints),
        velocity,
        acceleration: Twist::default(),
    };
    let bounds = Bounds {
        velocity: 1.0,
        acceleration: 2.0,
        jerk: 20.0,
    };
    let bounds = FrameBounds {
        translation: bounds,
        rotation: bounds,
    };
    let to = Frame::translation(0.1, 0.05, -0.1) * from.frame;
    let mut line = FrameMotion::new(Duration::from_millis(1)).unwrap();
    line.begin(&from, &Route::Line { to }, bounds, 1.0).unwrap();
    let text = format!(
        "f=Core::DoubleArrayNetcommIn(Key='f',Value='{}'),v=Core::DoubleArrayNetcommIn(Key='v',Value='{}'),\
         m=Motion::Coast(inFrom=f.outValue,inFromVelocity=v.outValue,Acceleration='[4]',Jerk='[40]'),\
         w=Core::DoubleArrayNetcommOut(inValue=m.outPosition,Key='p')",
        list(&joints),
        list(&velocities)
    );
    let mut coast = Fixture::new(&text, &Arm::default());
    let mut most = 0.0_f64;
    while !line.step(1.0, false).is_done {
        coast.write("f", &list(&joints));
        coast.step();
        let hint = if is_coasting {
            parse_array(&coast.read("p"), 8).expect("joints")
        } else {
            joints.clone()
        };
        let mut next = vec![0.0; 7];
        arm.inverse(&line.state().frame, &hint, &mut next).unwrap();
        for (joint, velocity) in velocities.iter_mut().enumerate() {
            let now = (next[joint] - joints[joint]) / PERIOD_S;
            most = most.max((now - *velocity).abs() / PERIOD_S);
            *velocity = now;
        }
        joints = next;
    }
    assert!(
        velocities.iter().all(|rate| rate.abs() < 1e-3),
        "{velocities:?}"
    );
    most
}

#[test]
fn elbow_in_motion_keeps_acceleration_on_line() {
    let (with, without) = (hardest(true), hardest(false));
    assert!(with < 15.0, "{with} rad/s²");
    assert!(
        without > 10.0 * with,
        "{without} rad/s² without a hint that coasts, {with} with it"
    );
}
