//! Frames: those of the cell by their names in recordings, `left.base`, and with a description its links, as `robot_state_publisher`
//! publishes them. What does not move is in `/tf_static`, flanges, links and mobile bases are in `/tf`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion};
use takt_api::Cell;
use takt_fleet::ros::messages::Transform;
use takt_motion::urdf::{Kind, Urdf, UrdfJoint};
use takt_net::device::Kinematics;

use super::names::RosArm;

/// The frame in which a cell is placed, and by convention the first link of many descriptions.
const WORLD: &str = "world";
/// What the name of the frame in which a mobile base started ends with.
const ODOMETRY: &str = ".odometry";

/// The frames of a cell.
#[derive(Debug)]
pub(super) struct Frames {
    /// Those that do not move.
    pub(super) fixed: Vec<Transform>,
    /// Those that move with an arm, by its name of ROS.
    pub(super) of_arms: BTreeMap<String, Moving>,
    /// The mobile bases.
    pub(super) bases: Vec<String>,
    /// Joints of the description that no arm moves: what is behind them has no place.
    pub(super) unmoved: Vec<String>,
}

/// The frames that move with an arm.
#[derive(Clone)]
pub(super) enum Moving {
    /// Its flange in its base.
    Flange([String; 2], Arc<dyn Kinematics>),
    /// The links behind its joints, from the base on.
    Links(Vec<UrdfJoint>),
}

impl fmt::Debug for Moving {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flange(names, _) => f.debug_tuple("Flange").field(names).finish(),
            Self::Links(links) => f.debug_tuple("Links").field(&links.len()).finish(),
        }
    }
}

impl Moving {
    /// Where they are at these joint positions, rad.
    pub(super) fn at(&self, positions: &[f64]) -> Vec<Transform> {
        match self {
            Self::Flange([base, flange], arm) => {
                vec![transform(base, flange, &arm.forward(positions))]
            }
            Self::Links(links) => {
                let placed = links.iter().zip(positions);
                placed
                    .map(|(joint, position)| {
                        let frame = joint.origin * moved(joint, *position);
                        transform(&joint.parent, &joint.child, &frame)
                    })
                    .collect()
            }
        }
    }
}

/// What a joint at a position, rad or m, adds to its origin.
fn moved(joint: &UrdfJoint, position: f64) -> Isometry3<f64> {
    let axis = Unit::new_normalize(joint.axis);
    match joint.kind {
        Kind::Prismatic => Translation3::from(axis.into_inner() * position).into(),
        Kind::Fixed => Isometry3::identity(),
        // Arms of joints that move in more directions are refused.
        Kind::Revolute | Kind::Continuous | Kind::Floating | Kind::Planar => Isometry3::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_axis_angle(&axis, position),
        ),
    }
}

/// A frame in its parent.
pub(super) fn transform(parent: &str, child: &str, frame: &Isometry3<f64>) -> Transform {
    Transform {
        parent: parent.to_owned(),
        child: child.to_owned(),
        position: frame.translation.vector.into(),
        rotation: frame.rotation.coords.into(),
    }
}

impl Frames {
    /// The frames of a cell with these arms, and the links of a description.
    pub(super) fn read(cell: &Cell, arms: &[RosArm], urdf: Option<&Urdf>) -> anyhow::Result<Self> {
        let all = cell.frames()?;
        let bases = all.iter().filter_map(|it| it.name().strip_suffix(ODOMETRY));
        let mut frames = Self {
            fixed: Vec::new(),
            of_arms: BTreeMap::new(),
            bases: bases.map(str::to_owned).collect(),
            unmoved: Vec::new(),
        };
        for frame in &all {
            if let Some(root) = all.iter().find(|root| root.name() == frame.root())
                && root.name() != frame.name()
            {
                let pose = frame.within(root)?;
                let placed = transform(root.name(), frame.name(), pose.isometry());
                frames.fixed.push(placed);
            }
        }
        for arm in arms {
            let described = arm.arm.description();
            if let Some(kinematics) = described.model.unlimited() {
                let device = &described.name;
                let names = [format!("{device}.base"), format!("{device}.flange")];
                let moving = Moving::Flange(names, kinematics);
                frames.of_arms.insert(arm.name.clone(), moving);
            }
        }
        if let Some(urdf) = urdf {
            frames.describe(arms, urdf);
        }
        Ok(frames)
    }

    /// Adds the links of a description: flanges are then where its arms end.
    fn describe(&mut self, arms: &[RosArm], urdf: &Urdf) {
        // A name is one frame: a link hides a frame of the cell that is called like it.
        let links: BTreeSet<&str> = urdf.links.iter().map(|link| link.name.as_str()).collect();
        self.fixed
            .retain(|frame| !links.contains(frame.child.as_str()));
        let mut moved = BTreeSet::new();
        let mut trunk = None;
        for arm in arms {
            let Some([base, tip]) = &arm.links else {
                continue;
            };
            let of_arm = |name: &String| urdf.joints.iter().find(|joint| joint.name == *name);
            let joints: Vec<_> = arm.joints.iter().filter_map(of_arm).cloned().collect();
            moved.extend(joints.iter().map(|joint| joint.name.clone()));
            self.of_arms.insert(arm.name.clone(), Moving::Links(joints));
            let device = &arm.arm.description().name;
            let flange = transform(tip, &format!("{device}.flange"), &Isometry3::identity());
            self.fixed.push(flange);
            let base_frame = format!("{device}.base");
            trunk = trunk.or_else(|| Some((base_frame, from_root(urdf, base)?.inverse())));
        }
        // The description hangs on the base of its first arm, unless it places itself in the world.
        if urdf.root != WORLD
            && let Some((base, root)) = trunk
        {
            self.fixed.push(transform(&base, &urdf.root, &root));
        }
        for joint in &urdf.joints {
            if joint.kind == Kind::Fixed {
                let link = transform(&joint.parent, &joint.child, &joint.origin);
                self.fixed.push(link);
            } else if !moved.contains(&joint.name) {
                self.unmoved.push(joint.name.clone());
            }
        }
    }
}

/// Where a link is in the root of a description; `None` if a joint before it moves.
fn from_root(urdf: &Urdf, link: &str) -> Option<Isometry3<f64>> {
    let (mut at, mut frame) = (link, Isometry3::identity());
    while at != urdf.root {
        let joint = urdf.joints.iter().find(|joint| joint.child == at)?;
        if joint.kind != Kind::Fixed {
            return None;
        }
        (at, frame) = (&joint.parent, joint.origin * frame);
    }
    Some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_JOINTS: &str = "<robot name='r'>
        <link name='root'/><link name='base'/><link name='upper'/><link name='slide'/>
        <joint name='stand' type='fixed'><parent link='root'/><child link='base'/><origin xyz='0 0 0.5' rpy='0 0 1.5707963267948966'/></joint>
        <joint name='turn' type='revolute'><parent link='base'/><child link='upper'/><origin xyz='1 0 0'/><axis xyz='0 0 2'/>
          <limit lower='-3' upper='3' effort='1' velocity='1'/></joint>
        <joint name='push' type='prismatic'><parent link='upper'/><child link='slide'/><origin xyz='0 1 0'/><axis xyz='0 0 1'/>
          <limit lower='-1' upper='1' effort='1' velocity='1'/></joint></robot>";

    fn is_near(numbers: &[f64], wanted: &[f64]) -> bool {
        let mut pairs = numbers.iter().zip(wanted);
        numbers.len() == wanted.len() && pairs.all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn links_move_about_and_along_their_axes() {
        let urdf = Urdf::parse(TWO_JOINTS).unwrap();
        let moving = Moving::Links(urdf.joints.into_iter().skip(1).collect());
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let [upper, slide]: [Transform; 2] = moving
            .at(&[std::f64::consts::FRAC_PI_2, 0.25])
            .try_into()
            .unwrap();
        assert_eq!([&*upper.parent, &*upper.child], ["base", "upper"]);
        assert!(is_near(&upper.position, &[1.0, 0.0, 0.0]), "{upper:?}");
        assert!(
            is_near(&upper.rotation, &[0.0, 0.0, half, half]),
            "{upper:?}"
        );
        assert!(is_near(&slide.position, &[0.0, 1.0, 0.25]), "{slide:?}");
        assert!(is_near(&slide.rotation, &[0.0, 0.0, 0.0, 1.0]), "{slide:?}");
    }

    #[test]
    fn base_is_placed_in_root_by_fixed_joints_only() {
        let urdf = Urdf::parse(TWO_JOINTS).unwrap();
        let base = from_root(&urdf, "base").unwrap();
        let place: [f64; 3] = base.translation.vector.into();
        assert!(is_near(&place, &[0.0, 0.0, 0.5]), "{base}");
        assert!(from_root(&urdf, "upper").is_none());
        assert!(from_root(&urdf, "elsewhere").is_none());
    }
}
