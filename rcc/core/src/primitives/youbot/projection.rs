//! Frames that an arm of five joints can reach: its first joint turns about the vertical through the
//! origin, as in the kinematics `kuka_youbot_upright` that devices have by default, the next three bend in one vertical plane, the last turns about the flange's z axis.
//! It does not check the distance to the requested frame.

use takt_net::{Frame, Rotation, Vector};

/// A direction in the plane shorter than this has no heading.
const VERTICAL: f64 = 1e-3;
/// The flange must be turned if it is farther from the arm's plane than this (m).
const IN_PLANE: f64 = 1e-9;
/// How far beyond a right angle rounding may lead, as a sine.
const ROUNDING: f64 = 1e-9;

/// The flange for a motion centre whose z axis is made vertical.
pub(super) fn palletize(flange: &Frame, motion_center: &Frame) -> Option<Frame> {
    let center = flange * motion_center;
    let z = center.rotation * Vector::z();
    let up = Vector::z() * 1.0_f64.copysign(z.z);
    let x = center.rotation * Vector::x();
    let mut ahead = flat(x);
    if ahead.norm() < VERTICAL {
        // The x axis itself is vertical; the direction perpendicular to y is the closest.
        ahead = flat((center.rotation * Vector::y()).cross(&up));
    }
    let rotation = Rotation::face_towards(&up, &up.cross(&ahead));
    let turned = Frame::from_parts(center.translation, rotation);
    finite(turned * motion_center.inverse())
}

/// The flange for a motion centre that is turned about the vertical through itself until the
/// flange's z axis lies in the vertical plane of the origin and the flange.
pub(super) fn keep_position(flange: &Frame, motion_center: &Frame) -> Option<Frame> {
    let center = (flange * motion_center).translation.vector;
    let position = flange.translation.vector;
    let ahead = flat(flange.rotation * Vector::z());
    if ahead.norm() < VERTICAL || cross(position, ahead).abs() < IN_PLANE * ahead.norm() {
        return finite(*flange);
    }
    let radius = flat(center).norm();
    // Turned by an angle a, the plane holds the flange's z axis if the sine of a and the angle
    // between centre and z axis is this: cross(centre + turned(flange - centre), turned(ahead)) = 0.
    let sine = -cross(position - center, ahead) / (radius * ahead.norm());
    if sine.is_nan() || sine.abs() > 1.0 + ROUNDING {
        return None;
    }
    let between = ahead.y.atan2(ahead.x) - center.y.atan2(center.x);
    let angle = sine.clamp(-1.0, 1.0).asin();
    let [one, other] =
        [angle, std::f64::consts::PI - angle].map(|angle| nearest_turn(angle - between));
    let turn = if one.abs() <= other.abs() { one } else { other };
    let rotation = Rotation::from_axis_angle(&Vector::z_axis(), turn);
    let position = center + rotation * (position - center);
    finite(Frame::from_parts(
        position.into(),
        rotation * flange.rotation,
    ))
}

fn flat(v: Vector) -> Vector {
    Vector::new(v.x, v.y, 0.0)
}

/// The part about the vertical of a cross product.
fn cross(a: Vector, b: Vector) -> f64 {
    a.x * b.y - a.y * b.x
}

fn nearest_turn(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}

fn finite(frame: Frame) -> Option<Frame> {
    let mut parts = frame
        .translation
        .vector
        .iter()
        .chain(frame.rotation.coords.iter());
    parts.all(|v| v.is_finite()).then_some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(x: f64, y: f64, z: f64, roll: f64, pitch: f64, yaw: f64) -> Frame {
        Frame::from_parts(
            [x, y, z].into(),
            Rotation::from_euler_angles(roll, pitch, yaw),
        )
    }

    /// Many frames all around.
    fn frames() -> impl Iterator<Item = (Frame, Frame)> {
        (0..2000).map(|i| {
            let at = |k: f64| (f64::from(i) * k).sin();
            let flange = frame(
                at(0.37),
                at(0.73),
                at(1.1),
                3.0 * at(0.91),
                3.0 * at(1.7),
                3.0 * at(2.3),
            );
            let center = frame(
                0.1 * at(3.1),
                0.1 * at(3.7),
                0.1 * at(4.3),
                at(0.2),
                at(0.3),
                at(0.4),
            );
            (flange, center)
        })
    }

    fn distance(a: &Frame, b: &Frame) -> f64 {
        (a.translation.vector - b.translation.vector).norm()
    }

    #[test]
    fn palletizing_makes_z_vertical_keeps_centre() {
        for (flange, center) in frames() {
            let projected = palletize(&flange, &center).unwrap() * center;
            let before = flange * center;
            let z = projected.rotation * Vector::z();
            assert!((z.z.abs() - 1.0).abs() < 1e-9, "{z}");
            assert!(z.z * (before.rotation * Vector::z()).z >= 0.0);
            assert!(distance(&projected, &before) < 1e-9);
            let (x, was) = (
                projected.rotation * Vector::x(),
                before.rotation * Vector::x(),
            );
            assert!(cross(x, was).abs() < 1e-9 && x.dot(&was) > 0.0, "{x} {was}");
            // What is projected stays.
            let again = palletize(&palletize(&flange, &center).unwrap(), &center).unwrap() * center;
            assert!(again.rotation.angle_to(&projected.rotation) < 1e-6);
        }
    }

    #[test]
    fn keep_position_turns_z_minimally_into_plane() {
        let mut turned = 0;
        for (flange, center) in frames() {
            let before = flange * center;
            let Some(projected) = keep_position(&flange, &center) else {
                continue;
            };
            turned += 1;
            let after = projected * center;
            assert!(distance(&after, &before) < 1e-9);
            let (at, z) = (
                projected.translation.vector,
                projected.rotation * Vector::z(),
            );
            if flat(z).norm() > VERTICAL {
                assert!(cross(at, z).abs() < 1e-6, "{at} {z}");
            }
            let turn = projected.rotation * flange.rotation.inverse();
            // Only about the vertical.
            assert!((turn * Vector::z() - Vector::z()).norm() < 1e-6);
            // No smaller turn does it: the flange stays on one side of the plane until then.
            let side = |angle: f64| {
                let turn = Rotation::from_axis_angle(&Vector::z_axis(), angle);
                let center = before.translation.vector;
                let position = center + turn * (flange.translation.vector - center);
                cross(position, flat(turn * (flange.rotation * Vector::z())))
            };
            let least = turn.angle() - 1e-3;
            for part in (1..50).map(|i| least * f64::from(i) / 50.0) {
                assert!(least <= 0.0 || side(part) * side(0.0) >= 0.0);
                assert!(least <= 0.0 || side(-part) * side(0.0) >= 0.0);
            }
        }
        assert!(turned > 1500, "{turned}");
    }

    #[test]
    fn keep_position_with_centre_in_flange() {
        let flange = frame(0.4, 0.0, 0.2, 0.0, std::f64::consts::FRAC_PI_2, 0.5);
        let projected = keep_position(&flange, &Frame::identity()).unwrap();
        let z = projected.rotation * Vector::z();
        assert!((z - Vector::x()).norm() < 1e-9, "{z}");
    }

    /// What is projected is reached: projection and kinematics have one base.
    #[test]
    fn projected_frames_are_reached_by_kinematics() {
        let arm = takt_motion::kinematics::named("kuka_youbot_upright").unwrap();
        let reach = |flange: &Frame, hint: &[f64]| {
            let mut joints = [0.0; 5];
            arm.inverse(flange, hint, &mut joints).map(|()| joints)
        };
        let upright = keep_position(&arm.forward(&[0.0; 5]), &Frame::identity()).unwrap();
        let joints = reach(&upright, &[0.0; 5]).unwrap();
        assert!(joints.iter().all(|joint| joint.abs() < 1e-5), "{joints:?}");
        for i in 0..500 {
            let at = |k: f64| (f64::from(i) * k).sin();
            let joints = [
                2.0 * at(0.37),
                0.5 * at(0.73),
                0.9 + 0.4 * at(1.1),
                0.8 + 0.4 * at(0.9),
                at(1.7),
            ];
            let flange = arm.forward(&joints);
            let turned = Rotation::from_axis_angle(&Vector::z_axis(), 0.2 * at(2.3));
            let off_plane = Frame::from_parts(flange.translation, turned * flange.rotation);
            let projected = keep_position(&off_plane, &Frame::identity()).unwrap();
            assert!(reach(&projected, &joints).is_ok(), "{joints:?}");
            assert!(distance(&projected, &flange) < 1e-9);
        }
    }

    #[test]
    fn projection_of_nan_gives_none() {
        let nan = frame(f64::NAN, 0.0, 0.0, 0.0, 1.0, 0.0);
        assert_eq!(palletize(&nan, &Frame::identity()), None);
        assert_eq!(keep_position(&nan, &Frame::identity()), None);
        // The centre lies on the vertical, the flange beside it points across.
        let flange = frame(0.2, 0.0, 0.2, 0.0, 1.0, 1.0);
        let center = flange.inverse() * Frame::translation(0.0, 0.0, 0.2);
        assert_eq!(keep_position(&flange, &center), None);
    }
}
