//! The serial arm between two links of a URDF.

use std::collections::{BTreeMap, BTreeSet};

use takt_net::{Frame, JointLimits};

use super::{Finding, Kind, Link, Shape, Urdf, UrdfError, UrdfJoint};
use nalgebra::Vector3;

use crate::dynamics::{Body, Dynamics};
use crate::kinematics::{JOINTS_MAX, Joint, JointKind, Range, Serial, SerialError};

/// Names of links that users mean by the flange, the likeliest first.
const FLANGES: [&str; 5] = ["flange", "tool0", "ee_link", "tool_link", "tcp"];

/// Words in the names of joints that move a gripper.
const GRIPPERS: [&str; 3] = ["grip", "finger", "jaw"];
/// Tolerance for limits that were rounded, degrees.
const BESIDE_DEGREES: f64 = 0.01;

/// An arm of so many joints ends where its joints part or are those of a gripper.
const HANDLESS: usize = 3;

/// A joint of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmJoint {
    /// Its name in the file.
    pub name: String,
    /// Its line in the file, from 1.
    pub line: u32,
    /// What it does.
    pub kind: JointKind,
    /// Its range, rad or m; without bounds for a continuous joint.
    pub range: Range,
    /// Largest speed, rad/s or m/s, if the file gives it.
    pub velocity_max: Option<f64>,
    /// Largest torque or force, Nm or N, if the file gives it.
    pub effort_max: Option<f64>,
    /// From the frame of the joint before it, or from the base, to its own at position 0, m.
    pub origin: Frame,
    /// Its axis in its own frame; any length but 0.
    pub axis: Vector3<f64>,
    /// What it carries up to the next joint, in its own frame.
    pub body: Body,
}

impl ArmJoint {
    /// Why limits of an arm are not within those of this joint, such as `range [-200, 100] degrees exceeds [-180, 180]`.
    #[must_use]
    pub fn exceeded_by(&self, limits: &JointLimits) -> Option<String> {
        let [low, high] = [limits.position_min, limits.position_max].map(f64::to_degrees);
        let [least, most] = [self.range.min, self.range.max].map(f64::to_degrees);
        if low < least - BESIDE_DEGREES || high > most + BESIDE_DEGREES {
            return Some(format!(
                "range [{low:.2}, {high:.2}] degrees exceeds [{least:.2}, {most:.2}]"
            ));
        }
        let (speed, most) = (limits.velocity_max, self.velocity_max?);
        let [wanted, allowed] = [speed, most].map(f64::to_degrees);
        let is_above = wanted > allowed + BESIDE_DEGREES;
        is_above.then(|| format!("velocity_max {wanted:.2} degrees/s exceeds {allowed:.2}"))
    }
}

/// A solid of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Visual {
    /// The number of the joint that moves it, from 1; 0 for the base.
    pub joint: usize,
    /// Its frame in that of the joint, m.
    pub origin: Frame,
    /// Its shape; the file of a mesh is a path once [`Urdf::find_meshes`] found it.
    pub shape: Shape,
}

/// The arm between two links of a file.
#[derive(Clone, Debug)]
pub struct ArmModel {
    /// The name of the robot.
    pub name: String,
    /// The name of its file without folder; empty if it is from no file.
    pub file: String,
    /// The link in which frames of the flange are.
    pub base: String,
    /// The link that is the flange.
    pub tip: String,
    /// Its joints from the base on.
    pub joints: Vec<ArmJoint>,
    /// The flange in the frame of the last joint, m.
    pub flange: Frame,
    /// Its kinematics.
    pub serial: Serial,
    /// Its dynamics; `None` where the file gives no mass behind a joint.
    pub dynamics: Option<Dynamics>,
    /// Its solids.
    pub visuals: Vec<Visual>,
    /// What is wrong, but does not matter for the kinematics.
    pub warnings: Vec<Finding>,
}

impl ArmModel {
    /// An arm of these joints, from the base on, with the flange in the frame of the last one (m). It is from no file and has no
    /// solids.
    ///
    /// # Errors
    /// If there are too few or too many joints, or one has no axis or no range.
    pub fn new(name: String, joints: Vec<ArmJoint>, flange: Frame) -> Result<Self, SerialError> {
        let given = joints.iter().map(|joint| Joint {
            origin: joint.origin,
            axis: joint.axis,
            kind: joint.kind,
            range: joint.range,
        });
        let serial = Serial::new(&given.collect::<Vec<_>>(), &flange)?;
        let bodies: Vec<_> = joints.iter().map(|joint| joint.body).collect();
        let has_masses = bodies.iter().all(|body| body.mass > 0.0);
        let dynamics = has_masses.then(|| Dynamics::new(serial.clone(), &bodies));
        Ok(Self {
            name,
            file: String::new(),
            base: String::new(),
            tip: String::new(),
            joints,
            flange,
            serial,
            dynamics: dynamics.flatten(),
            visuals: Vec::new(),
            warnings: Vec::new(),
        })
    }
}

fn error(line: u32, cause: impl Into<String>, hint: impl Into<String>) -> UrdfError {
    let finding = Finding {
        line,
        cause: cause.into(),
        hint: hint.into(),
    };
    UrdfError {
        findings: vec![finding],
    }
}

/// The tree of a file by names.
struct Tree<'a> {
    urdf: &'a Urdf,
    parents: BTreeMap<&'a str, &'a UrdfJoint>,
    links: BTreeMap<&'a str, &'a Link>,
}

impl<'a> Tree<'a> {
    fn new(urdf: &'a Urdf) -> Self {
        let parents = urdf.joints.iter().map(|joint| (&*joint.child, joint));
        let links = urdf.links.iter().map(|link| (&*link.name, link));
        Self {
            urdf,
            parents: parents.collect(),
            links: links.collect(),
        }
    }

    fn link(&self, name: &str) -> Result<&'a Link, UrdfError> {
        self.links.get(name).copied().ok_or_else(|| {
            let names: Vec<_> = self.links.keys().copied().take(40).collect();
            let hint = format!("expected one of {}", names.join(", "));
            error(1, format!("the robot has no link `{name}`"), hint)
        })
    }

    /// The joints from `base` to `tip`; `None` if that is not behind the base.
    fn chain(&self, base: &str, tip: &str) -> Option<Vec<&'a UrdfJoint>> {
        let mut joints = Vec::new();
        let mut at = tip;
        while at != base {
            let joint = self.parents.get(at)?;
            joints.push(*joint);
            at = &joint.parent;
        }
        joints.reverse();
        Some(joints)
    }

    /// The links with a joint that moves somewhere behind them.
    fn moving(&self) -> BTreeSet<&'a str> {
        let mut moving = BTreeSet::new();
        for joint in self.urdf.joints.iter().filter(|it| it.kind != Kind::Fixed) {
            let mut at = &*joint.parent;
            while moving.insert(at) {
                match self.parents.get(at) {
                    Some(before) => at = &before.parent,
                    None => break,
                }
            }
        }
        moving
    }

    /// The tip that a user means: where the joints end, or part into those of a gripper.
    fn usual_tip(&self, base: &'a str) -> Result<&'a str, UrdfError> {
        let moving = self.moving();
        let (mut at, mut count, mut last) = (base, 0, None);
        loop {
            let behind = self.urdf.joints.iter().filter(|joint| joint.parent == at);
            let moves =
                |joint: &&UrdfJoint| joint.kind != Kind::Fixed || moving.contains(&*joint.child);
            let behind: Vec<_> = behind.filter(moves).collect();
            match behind[..] {
                [] => break,
                [joint] if count >= HANDLESS && is_of_gripper(joint) => break,
                [joint] => {
                    at = &joint.child;
                    if joint.kind != Kind::Fixed {
                        (count, last) = (count + 1, Some(at));
                    }
                }
                _ if count >= HANDLESS => break,
                _ => {
                    let names: Vec<_> = behind
                        .iter()
                        .map(|joint| format!("`{}`", joint.name))
                        .collect();
                    let cause = format!(
                        "the robot has several arms: the joints {} part at link `{at}`",
                        names.join(", ")
                    );
                    return Err(error(self.link(at)?.line, cause, "name base and tip"));
                }
            }
        }
        let Some(last) = last else {
            let cause = format!("no joint behind `{base}` moves");
            return Err(error(self.link(base)?.line, cause, "name another base"));
        };
        let is_rigid = |name: &str| {
            let chain = self.chain(last, name);
            chain.is_some_and(|chain| chain.iter().all(|joint| joint.kind == Kind::Fixed))
        };
        let named = FLANGES.iter().find_map(|usual| {
            let mut links = self.urdf.links.iter().map(|link| &*link.name);
            links.find(|name| name.ends_with(usual) && is_rigid(name))
        });
        Ok(named.unwrap_or(at))
    }
}

impl Urdf {
    /// The arm from one link to another. Without a base the root of the file is it; without a tip the one of the longest chain.
    ///
    /// # Errors
    /// If a link does not exist, the tip is not behind the base, several tips are as likely, or a joint between them has no limits,
    /// follows another, or moves in more than one direction: all findings, by line.
    pub fn arm(&self, base: Option<&str>, tip: Option<&str>) -> Result<ArmModel, UrdfError> {
        let tree = Tree::new(self);
        let base = &*tree.link(base.unwrap_or(&self.root))?.name;
        let tip = match tip {
            Some(tip) => &*tree.link(tip)?.name,
            None => tree.usual_tip(base)?,
        };
        let chain = tree.chain(base, tip).ok_or_else(|| {
            let cause = format!("link `{tip}` is not behind link `{base}`");
            error(
                tree.links[tip].line,
                cause,
                "exchange base and tip, or name another base",
            )
        })?;
        let mut findings = Vec::new();
        let joints: Vec<_> = chain
            .iter()
            .filter_map(|joint| moved(joint, &mut findings))
            .collect();
        if !findings.is_empty() {
            return Err(UrdfError { findings });
        }
        if joints.is_empty() || joints.len() > JOINTS_MAX {
            let cause = format!(
                "there are {} joints between `{base}` and `{tip}`",
                joints.len()
            );
            let hint = format!("arms have 1 to {JOINTS_MAX} joints: name base and tip");
            return Err(error(1, cause, hint));
        }
        let mut joints = joints;
        let (origins, flange) = origins(&chain);
        let mut warnings = self.warnings.clone();
        let carried = self.carried(&tree, base, &chain, &mut warnings);
        let bodies = carried.bodies.into_iter().skip(1);
        for (joint, (origin, body)) in joints.iter_mut().zip(origins.into_iter().zip(bodies)) {
            (joint.origin, joint.body) = (origin, body);
        }
        let arm = ArmModel::new(self.name.clone(), joints, flange);
        let arm = arm.map_err(|cause| error(1, cause.to_string(), ""))?;
        Ok(ArmModel {
            base: base.to_owned(),
            tip: tip.to_owned(),
            visuals: carried.visuals,
            warnings,
            ..arm
        })
    }

    /// What each joint of a chain carries: all links that are fixed to it, with those of other branches at position 0.
    fn carried(
        &self,
        tree: &Tree<'_>,
        base: &str,
        chain: &[&UrdfJoint],
        warnings: &mut Vec<Finding>,
    ) -> Carried {
        let moving: Vec<_> = chain.iter().filter(|it| it.kind != Kind::Fixed).collect();
        let mut carried = Carried {
            bodies: vec![Body::default(); moving.len() + 1],
            visuals: Vec::new(),
        };
        for link in &self.links {
            let Some(path) = tree.chain(base, &link.name) else {
                continue;
            };
            let mut at = Frame::identity();
            let mut number = 0;
            for joint in path {
                at *= joint.origin;
                if moving
                    .get(number)
                    .is_some_and(|next| next.name == joint.name)
                {
                    number += 1;
                    at = Frame::identity();
                } else if joint.child == link.name && joint.kind != Kind::Fixed {
                    let cause = format!(
                        "joint `{}` is not one of the arm: it is taken as fixed at 0",
                        joint.name
                    );
                    warnings.push(Finding {
                        line: joint.line,
                        cause,
                        hint: String::new(),
                    });
                }
            }
            if let (Some(body), Some(sum)) = (&link.body, carried.bodies.get_mut(number)) {
                *sum = sum.with(&body.seen_from(&at));
            }
            let visuals = link.visuals.iter();
            let visuals = visuals.map(|(origin, shape)| Visual {
                joint: number,
                origin: at * origin,
                shape: shape.clone(),
            });
            carried.visuals.extend(visuals);
        }
        carried
    }
}

struct Carried {
    bodies: Vec<Body>,
    visuals: Vec<Visual>,
}

fn is_of_gripper(joint: &UrdfJoint) -> bool {
    let name = joint.name.to_lowercase();
    joint.kind != Kind::Fixed && GRIPPERS.iter().any(|word| name.contains(word))
}

/// The origin of each joint that moves in the frame of the one before it, and the tip in the frame of the last one.
fn origins(chain: &[&UrdfJoint]) -> (Vec<Frame>, Frame) {
    let mut origins = Vec::new();
    let mut at = Frame::identity();
    for joint in chain {
        at *= joint.origin;
        if joint.kind != Kind::Fixed {
            origins.push(at);
            at = Frame::identity();
        }
    }
    (origins, at)
}

/// A joint of the chain as one of the arm; `None` for a fixed one, and with a finding for one that an arm cannot have.
fn moved(joint: &UrdfJoint, findings: &mut Vec<Finding>) -> Option<ArmJoint> {
    let mut refuse = |cause: String, hint: &str| {
        findings.push(Finding {
            line: joint.line,
            cause,
            hint: hint.to_owned(),
        });
    };
    let name = &joint.name;
    if let Some(other) = &joint.mimic {
        let cause = format!("joint `{name}` of the arm follows joint `{other}`");
        refuse(
            cause,
            "coupled joints are not supported within an arm: name a tip before it",
        );
        return None;
    }
    let kind = match joint.kind {
        Kind::Fixed => return None,
        Kind::Revolute | Kind::Continuous => JointKind::Revolute,
        Kind::Prismatic => JointKind::Prismatic,
        Kind::Floating | Kind::Planar => {
            let cause = format!("joint `{name}` of the arm moves in more than one direction");
            refuse(cause, "name a base behind it");
            return None;
        }
    };
    let limit = joint.limit;
    let range = match (joint.kind, limit) {
        (Kind::Continuous, _) => Range {
            min: f64::NEG_INFINITY,
            max: f64::INFINITY,
        },
        (_, Some(limit)) if limit.lower < limit.upper => Range {
            min: limit.lower,
            max: limit.upper,
        },
        _ => {
            let hint = "add <limit lower=\"..\" upper=\"..\" effort=\"..\" velocity=\"..\"/> from the data sheet (rad or m)";
            refuse(format!("joint `{name}` has no limits"), hint);
            return None;
        }
    };
    let positive = |value: f64| value.is_finite() && value > 0.0;
    Some(ArmJoint {
        name: name.clone(),
        line: joint.line,
        kind,
        range,
        velocity_max: limit.and_then(|it| it.velocity).filter(|it| positive(*it)),
        effort_max: limit.and_then(|it| it.effort).filter(|it| positive(*it)),
        origin: Frame::identity(),
        axis: joint.axis,
        body: Body::default(),
    })
}
