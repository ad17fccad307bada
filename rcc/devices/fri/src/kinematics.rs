//! Kinematics of an FRI arm by a URDF in place of that of its maker: a calibrated arm, another variant, a mounted tool as the flange.
//! The robot's controller keeps its own, which Cartesian impedance uses.

use nalgebra::Vector3;
use takt_core::device::ArmDescription;
use takt_motion::Model;
use takt_motion::kinematics::JointKind;
use takt_motion::urdf::ArmModel;
use takt_net::device::Kinematics;
use takt_net::value::Twist;

use crate::fri::{AXES, Joints};

/// A pose in which no two axes are parallel, rad.
const BENT: Joints = [0.3, 0.5, -0.4, -1.1, 0.6, 0.8, 0.2];
/// How far the cosine of the angle between two axes may be from that of the maker's arm: some degrees.
const ALIKE: f64 = 0.05;
/// Speeds of a file that are no limit: rounded ones.
const ROUNDED: f64 = 1e-3;

/// The arm with the kinematics of a URDF, if there is one, and with the narrower limits of both.
pub(crate) fn with_kinematics(mut arm: ArmDescription, kinematics: &Model) -> ArmDescription {
    let Some(of_file) = kinematics.arm() else {
        return arm;
    };
    for (limits, joint) in arm.limits.iter_mut().zip(&of_file.joints) {
        limits.position_min = limits.position_min.max(joint.range.min);
        limits.position_max = limits.position_max.min(joint.range.max);
        let speed = joint.velocity_max.unwrap_or(f64::INFINITY);
        limits.velocity_max = limits.velocity_max.min(speed + ROUNDED);
    }
    arm.model = kinematics.clone();
    arm
}

/// Checks that a URDF describes an arm that moves as that of the maker does.
pub(crate) fn check(arm: &ArmDescription, kinematics: &Model) -> Result<(), String> {
    if kinematics.is_empty() {
        return Ok(());
    }
    let Some(of_file) = kinematics.arm() else {
        return Err(format!(
            "kinematics is `{kinematics}`; it must be a URDF\nhint: `kinematics = \"urdf:FILE\"`; leave it out for that of the maker"
        ));
    };
    let file = &of_file.file;
    if of_file.joints.len() != AXES {
        let count = of_file.joints.len();
        return Err(format!(
            "{count} joints in {file}, but the arm has {AXES}\nhint: name base_link and tip_link"
        ));
    }
    let mut joints = of_file.joints.iter();
    if let Some(joint) = joints.find(|joint| joint.kind != JointKind::Revolute) {
        let (line, joint) = (joint.line, &joint.name);
        return Err(format!("joint `{joint}` slides ({file}:{line})"));
    }
    let known = arm.model.unlimited();
    if let Some(joint) = known.and_then(|known| unlike(of_file, &*known)) {
        let (line, joint) = (joint.line, &joint.name);
        return Err(format!(
            "joint `{joint}` ({file}:{line}) is not where that of the arm is: the direction, the zero or the order of it or of a joint \
             before it differs\nhint: the joints of the file must count as the robot's controller does"
        ));
    }
    let narrowed = with_kinematics(arm.clone(), kinematics);
    let mut limits = narrowed.limits.iter().zip(&of_file.joints);
    let empty = limits.find(|(it, _)| it.position_min >= it.position_max || it.velocity_max <= 0.0);
    match empty {
        Some((_, joint)) => Err(format!(
            "joint `{}` ({file}:{}) has no range or speed in common with the arm",
            joint.name, joint.line
        )),
        None => Ok(()),
    }
}

/// The first joint whose axis is elsewhere relative to the one before it than in the known arm.
fn unlike<'a>(
    of_file: &'a ArmModel,
    known: &dyn Kinematics,
) -> Option<&'a takt_motion::urdf::ArmJoint> {
    let cosines = |arm: &dyn Kinematics| {
        let mut columns = [Twist::default(); AXES];
        arm.jacobian(&BENT, &mut columns);
        let axis = |at: usize| {
            let rot = columns[at].rot;
            Vector3::new(rot.x, rot.y, rot.z)
        };
        // To the axis before, and to that before it: the former does not show its direction.
        std::array::from_fn::<_, AXES, _>(|at| {
            [1, 2].map(|back| {
                at.checked_sub(back)
                    .map_or(0.0, |before| axis(at).dot(&axis(before)))
            })
        })
    };
    let [own, wanted] = [cosines(&of_file.serial), cosines(known)];
    let differs = |at: &usize| {
        let pairs = own[*at].iter().zip(wanted[*at]);
        pairs
            .into_iter()
            .any(|(own, wanted)| (own - wanted).abs() > ALIKE)
    };
    (0..AXES)
        .find(differs)
        .and_then(|at| of_file.joints.get(at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::IiwaModel;
    use crate::{iiwa, lwr};

    /// A URDF of an arm with axes as those of an iiwa: signs of the axes, the length of the upper arm, and joint 4.
    fn urdf(signs: [i8; AXES], upper: f64, fourth: &str) -> Model {
        let mut text = String::from("<robot name=\"arm\"><link name=\"l0\"/>\n");
        let along = [0.0, 0.36, 0.0, upper, 0.0, 0.4, 0.0];
        for (at, (sign, z)) in signs.into_iter().zip(along).enumerate() {
            let axis = if at % 2 == 0 { "0 0" } else { "0" };
            let axis = if at % 2 == 0 {
                format!("{axis} {sign}")
            } else {
                format!("{axis} {sign} 0")
            };
            let kind = if at == 3 { fourth } else { "revolute" };
            text += &format!(
                "<link name=\"l{0}\"/><joint name=\"A{0}\" type=\"{kind}\"><parent link=\"l{at}\"/><child link=\"l{0}\"/>\
                 <origin xyz=\"0 0 {z}\"/><axis xyz=\"{axis}\"/><limit lower=\"-2\" upper=\"2.9\" velocity=\"1.5\"/></joint>\n",
                at + 1
            );
        }
        text += "<link name=\"tool\"/><joint name=\"mount\" type=\"fixed\"><parent link=\"l7\"/><child link=\"tool\"/>\
            <origin xyz=\"0 0 0.276\"/></joint></robot>";
        let arm = takt_motion::urdf::Urdf::parse(&text).and_then(|urdf| urdf.arm(None, None));
        Model::of_arm(arm.unwrap())
    }

    const SIGNS: [i8; AXES] = [1, 1, 1, -1, 1, 1, 1];

    #[test]
    fn fri_arm_with_urdf_has_its_kinematics_and_narrower_limits() {
        for arm in [
            iiwa::describe("arm", IiwaModel::Iiwa14),
            lwr::describe("arm"),
        ] {
            let model = urdf(SIGNS, 0.45, "revolute");
            check(&arm, &model).unwrap();
            let with = with_kinematics(arm.clone(), &model);
            assert_eq!(with.model, model);
            assert_eq!(with.limits[0].position_min.to_bits(), (-2.0_f64).to_bits());
            assert!(
                with.limits[0].position_max <= 2.9,
                "and no wider than the arm's own"
            );
            assert!((with.limits[5].velocity_max - 1.501).abs() < 1e-9);
            assert!(arm.limits[1].velocity_max >= with.limits[1].velocity_max);
        }
    }

    #[test]
    fn fri_arm_with_other_urdf_is_refused_with_line() {
        let arm = iiwa::describe("arm", IiwaModel::Iiwa7);
        for at in 0..AXES {
            let mut signs = SIGNS;
            signs[at] = -signs[at];
            let error = check(&arm, &urdf(signs, 0.42, "revolute")).unwrap_err();
            assert!(
                error.contains("a joint before it differs\nhint: "),
                "{at}: {error}"
            );
        }
        let error = check(&arm, &urdf(SIGNS, 0.42, "prismatic")).unwrap_err();
        assert!(error.contains("joint `A4` slides (:5)"), "{error}");
        let error = check(&arm, &"kuka_lwr4".into()).unwrap_err();
        assert!(error.contains("it must be a URDF"), "{error}");
    }
}
