//! The text of a URDF as links and joints, and the check that they are one tree.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use roxmltree::{Document, Node, ParsingOptions};
use takt_net::Frame;

use super::{
    ANGLE_MAX, FILE_MAX, Finding, Kind, LENGTH_MAX, Limit, Link, Shape, Urdf, UrdfError, UrdfJoint,
};
use crate::dynamics::Body;

/// Most elements of a file.
const NODES_MAX: u32 = 1 << 20;
/// Most links, and most joints.
const LINKS_MAX: usize = 1000;
/// Deepest nesting of elements: the format needs five.
const DEPTH_MAX: usize = 64;

const METRES: &str = "URDF gives lengths in metres and angles in radians";
const XACRO: &str =
    "expand it first: `xacro FILE > arm.urdf` (Debian package ros-xacro, or `pip install xacro`)";

/// A file being read: its elements by line, and what is wrong with it.
struct Reader<'a> {
    document: &'a Document<'a>,
    errors: Vec<Finding>,
    warnings: Vec<Finding>,
}

fn one(line: u32, cause: impl Into<String>, hint: &str) -> UrdfError {
    UrdfError {
        findings: vec![finding(line, cause, hint)],
    }
}

fn finding(line: u32, cause: impl Into<String>, hint: &str) -> Finding {
    Finding {
        line,
        cause: cause.into(),
        hint: hint.to_owned(),
    }
}

/// The nesting of elements, roughly, before anything recurses into it.
fn depth(text: &str) -> usize {
    let (mut deepest, mut now) = (0_usize, 0_usize);
    for part in text.split('<').skip(1) {
        if part.starts_with('/') {
            now = now.saturating_sub(1);
        } else if !part.starts_with(['!', '?']) {
            now += 1;
            deepest = deepest.max(now);
            let tag = part.split('>').next().unwrap_or("");
            if tag.ends_with('/') {
                now -= 1;
            }
        }
    }
    deepest
}

pub(super) fn parse(text: &str) -> Result<Urdf, UrdfError> {
    if text.len() > FILE_MAX {
        let cause = format!(
            "the file has {} bytes, at most {FILE_MAX} are read",
            text.len()
        );
        return Err(one(1, cause, "meshes belong into files of their own"));
    }
    if depth(text) > DEPTH_MAX {
        let cause = format!("elements are nested more than {DEPTH_MAX} deep");
        return Err(one(1, cause, ""));
    }
    let options = ParsingOptions {
        allow_dtd: false,
        nodes_limit: NODES_MAX,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options);
    let document = document.map_err(|error| {
        let line = error.pos().row;
        // Names with a prefix that is not declared stop the parser.
        let is_macro = text.contains("<xacro:");
        let hint = if is_macro { XACRO } else { "" };
        one(line, format!("this is no XML: {error}"), hint)
    })?;
    let mut reader = Reader {
        document: &document,
        errors: Vec::new(),
        warnings: Vec::new(),
    };
    let urdf = reader.robot(document.root_element());
    match urdf {
        Some(urdf) if reader.errors.is_empty() => Ok(Urdf {
            warnings: reader.warnings,
            ..urdf
        }),
        _ => Err(UrdfError {
            findings: reader.errors,
        }),
    }
}

fn children<'a>(node: Node<'a, 'a>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    node.children()
        .filter(move |child| child.has_tag_name(name))
}

impl<'a> Reader<'a> {
    fn line(&self, node: Node<'a, 'a>) -> u32 {
        self.document.text_pos_at(node.range().start).row
    }

    fn error(&mut self, node: Node<'a, 'a>, cause: impl Into<String>, hint: &str) {
        let line = self.line(node);
        self.errors.push(finding(line, cause, hint));
    }

    fn robot(&mut self, root: Node<'a, 'a>) -> Option<Urdf> {
        let is_macro = |node: &Node<'_, '_>| {
            let name = node.tag_name().namespace();
            name.is_some_and(|it| it.contains("xacro"))
                || node
                    .attributes()
                    .any(|it| it.value().contains("${") || it.value().contains("$("))
        };
        if let Some(node) = root.descendants().find(is_macro) {
            self.error(node, "this is a file of macros (xacro)", XACRO);
            return None;
        }
        if !root.has_tag_name("robot") {
            let cause = format!(
                "the file describes a `{}`, not a `robot`",
                root.tag_name().name()
            );
            let hint = "URDF is wanted; SDF and MJCF are other formats";
            self.error(root, cause, hint);
            return None;
        }
        let links: Vec<_> = children(root, "link")
            .filter_map(|node| self.link(node))
            .collect();
        let joints: Vec<_> = children(root, "joint")
            .filter_map(|node| self.joint(node))
            .collect();
        if links.is_empty() {
            self.error(root, "the robot has no links", "");
        }
        if links.len().max(joints.len()) > LINKS_MAX {
            let cause = format!(
                "the robot has {} links and {} joints",
                links.len(),
                joints.len()
            );
            self.error(
                root,
                cause,
                &format!("at most {LINKS_MAX} of each are read"),
            );
            return None;
        }
        let root_link = self.root(&links, &joints);
        Some(Urdf {
            name: root.attribute("name").unwrap_or_default().to_owned(),
            root: root_link?,
            links,
            joints,
            warnings: Vec::new(),
        })
    }

    fn name(&mut self, node: Node<'a, 'a>, what: &str) -> Option<String> {
        let name = node.attribute("name").filter(|name| !name.is_empty());
        if name.is_none() {
            self.error(node, format!("a {what} has no name"), "");
        }
        name.map(str::to_owned)
    }

    /// So many numbers of an attribute; `None` with an error if there are others, without one if it is not there.
    fn numbers<const N: usize>(&mut self, node: Node<'a, 'a>, name: &str) -> Option<[f64; N]> {
        let text = node.attribute(name)?;
        let numbers: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
        let numbers = numbers.ok().and_then(|it| <[f64; N]>::try_from(it).ok());
        let numbers = numbers.filter(|it| it.iter().all(|number| number.is_finite()));
        if numbers.is_none() {
            let wanted = if N == 1 {
                "a number".to_owned()
            } else {
                format!("{N} numbers")
            };
            let cause = format!(
                "`{name}` of `{}` is \"{text}\", not {wanted}",
                node.tag_name().name()
            );
            self.error(node, cause, "");
        }
        numbers
    }

    fn number(&mut self, node: Node<'a, 'a>, name: &str) -> Option<f64> {
        self.numbers::<1>(node, name).map(|[number]| number)
    }

    /// The `origin` of an element; the identity if it has none.
    fn origin(&mut self, node: Node<'a, 'a>) -> Frame {
        let Some(origin) = children(node, "origin").next() else {
            return Frame::identity();
        };
        let [x, y, z] = self.numbers(origin, "xyz").unwrap_or_default();
        let [roll, pitch, yaw] = self.numbers(origin, "rpy").unwrap_or_default();
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        Frame::from_parts(Vector3::new(x, y, z).into(), rotation)
    }

    fn link(&mut self, node: Node<'a, 'a>) -> Option<Link> {
        let name = self.name(node, "link")?;
        let inertial = children(node, "inertial").next();
        let body = inertial.and_then(|inertial| self.body(inertial, &name));
        let visuals = children(node, "visual").filter_map(|visual| {
            let geometry = children(visual, "geometry").next()?;
            Some((self.origin(visual), self.shape(geometry)?))
        });
        let visuals = visuals.collect();
        Some(Link {
            line: self.line(node),
            name,
            body,
            visuals,
        })
    }

    fn body(&mut self, inertial: Node<'a, 'a>, link: &str) -> Option<Body> {
        let mass = children(inertial, "mass").next();
        let mass = mass.and_then(|mass| self.number(mass, "value"))?;
        let mut inertia = Matrix3::zeros();
        if let Some(node) = children(inertial, "inertia").next() {
            let mut at = |name| self.number(node, name).unwrap_or(0.0);
            let [xx, xy, xz] = [at("ixx"), at("ixy"), at("ixz")];
            let [yy, yz, zz] = [at("iyy"), at("iyz"), at("izz")];
            inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        }
        let body = Body::new(mass, Vector3::zeros(), inertia);
        if mass != 0.0 && !body.is_possible() {
            let cause = format!("no body has the mass and inertia of link `{link}`");
            let hint = "principal moments are positive, and none exceeds the sum of the others; torques of this arm would be wrong";
            let line = self.line(inertial);
            self.warnings.push(finding(line, cause, hint));
        }
        Some(body.seen_from(&self.origin(inertial)))
    }

    fn shape(&mut self, geometry: Node<'a, 'a>) -> Option<Shape> {
        let node = geometry.children().find(Node::is_element)?;
        Some(match node.tag_name().name() {
            "box" => Shape::Box(self.numbers(node, "size")?.into()),
            "cylinder" => {
                Shape::Cylinder(self.number(node, "radius")?, self.number(node, "length")?)
            }
            "sphere" => Shape::Sphere(self.number(node, "radius")?),
            "mesh" => {
                let scale = self.numbers(node, "scale").unwrap_or([1.0; 3]);
                Shape::Mesh(node.attribute("filename")?.to_owned(), scale.into())
            }
            _ => return None,
        })
    }

    fn joint(&mut self, node: Node<'a, 'a>) -> Option<UrdfJoint> {
        let name = self.name(node, "joint")?;
        let kind = match node.attribute("type") {
            Some("revolute") => Kind::Revolute,
            Some("continuous") => Kind::Continuous,
            Some("prismatic") => Kind::Prismatic,
            Some("fixed") => Kind::Fixed,
            Some("floating") => Kind::Floating,
            Some("planar") => Kind::Planar,
            other => {
                let cause = format!(
                    "joint `{name}` has the type \"{}\"",
                    other.unwrap_or_default()
                );
                let hint =
                    "expected one of revolute, continuous, prismatic, fixed, floating, planar";
                self.error(node, cause, hint);
                return None;
            }
        };
        let link = |name: &'static str| {
            let of = children(node, name)
                .next()
                .and_then(|it| it.attribute("link"));
            of.unwrap_or_default().to_owned()
        };
        let (parent, child) = (link("parent"), link("child"));
        let origin = self.origin(node);
        let distance = origin.translation.vector.norm();
        if distance > LENGTH_MAX {
            let cause = format!("joint `{name}` is {distance:.0} m from the one before it");
            self.error(node, cause, METRES);
        }
        let axis = children(node, "axis").next();
        let axis = axis
            .and_then(|axis| self.numbers(axis, "xyz"))
            .unwrap_or([1.0, 0.0, 0.0]);
        let axis = Vector3::from(axis);
        let turns = matches!(kind, Kind::Revolute | Kind::Continuous | Kind::Prismatic);
        if turns && axis.norm() < 1e-9 {
            self.error(
                node,
                format!("the axis of joint `{name}` has no direction"),
                "",
            );
        }
        let limit = children(node, "limit").next();
        let limit = limit.map(|limit| self.limit(limit, &name, kind));
        let mimic = children(node, "mimic").next();
        Some(UrdfJoint {
            line: self.line(node),
            kind,
            parent,
            child,
            origin,
            axis,
            limit,
            mimic: mimic
                .and_then(|it| it.attribute("joint"))
                .map(str::to_owned),
            name,
        })
    }

    fn limit(&mut self, node: Node<'a, 'a>, joint: &str, kind: Kind) -> Limit {
        let lower = self.number(node, "lower").unwrap_or(0.0);
        let upper = self.number(node, "upper").unwrap_or(0.0);
        let largest = lower.abs().max(upper.abs());
        if kind == Kind::Revolute && largest > ANGLE_MAX {
            let cause = format!("joint `{joint}` may turn to {largest} rad");
            self.error(node, cause, METRES);
        }
        if lower > upper {
            let cause = format!("the range of joint `{joint}` is {lower} to {upper}");
            self.error(node, cause, "`lower` is the smaller one");
        }
        Limit {
            lower,
            upper,
            effort: self.number(node, "effort"),
            velocity: self.number(node, "velocity"),
        }
    }

    /// The one link that is behind no joint, if links and joints are a tree.
    fn root(&mut self, links: &[Link], joints: &[UrdfJoint]) -> Option<String> {
        let before = self.errors.len();
        let mut lines = BTreeMap::new();
        for link in links {
            if let Some(first) = lines.insert(&*link.name, link.line) {
                let cause = format!("link `{}` is there twice, first in line {first}", link.name);
                self.errors.push(finding(link.line, cause, ""));
            }
        }
        let mut names = BTreeSet::new();
        let mut parents: BTreeMap<&str, &UrdfJoint> = BTreeMap::new();
        for joint in joints {
            if !names.insert(&*joint.name) {
                let cause = format!("joint `{}` is there twice", joint.name);
                self.errors.push(finding(joint.line, cause, ""));
            }
            for end in [&joint.parent, &joint.child] {
                if !lines.contains_key(&**end) {
                    let cause = format!(
                        "joint `{}` names the link `{end}`, which is not there",
                        joint.name
                    );
                    self.errors.push(finding(joint.line, cause, ""));
                }
            }
            if let Some(first) = parents.insert(&joint.child, joint) {
                let cause = format!(
                    "link `{}` is behind joint `{}` and behind joint `{}` (line {}): a loop",
                    joint.child, joint.name, first.name, first.line
                );
                let hint = "a URDF is a tree: leave out the joint that closes the loop, if it is no joint of the arm";
                self.errors.push(finding(joint.line, cause, hint));
            }
        }
        let roots: Vec<_> = links
            .iter()
            .filter(|link| !parents.contains_key(&*link.name))
            .collect();
        match &roots[..] {
            [root] => {
                self.check_cycles(links, &parents);
                return (self.errors.len() == before).then(|| root.name.clone());
            }
            [] => {
                let line = joints.first().map_or(1, |joint| joint.line);
                let cause = "every link is behind a joint: a loop without a base";
                self.errors.push(finding(line, cause, ""));
            }
            [_, second, ..] => {
                let names: Vec<_> = roots
                    .iter()
                    .map(|link| format!("`{}`", link.name))
                    .collect();
                let cause = format!(
                    "{} links are behind no joint: {}",
                    roots.len(),
                    names.join(", ")
                );
                let hint = "connect them by fixed joints";
                self.errors.push(finding(second.line, cause, hint));
            }
        }
        None
    }

    /// Links that the root does not reach are in a loop of their own.
    fn check_cycles(&mut self, links: &[Link], parents: &BTreeMap<&str, &UrdfJoint>) {
        for link in links {
            let mut at = &*link.name;
            let mut steps = 0;
            while let Some(joint) = parents.get(at) {
                at = &joint.parent;
                steps += 1;
                if steps > parents.len() {
                    let cause = format!("link `{}` is behind itself: a loop", link.name);
                    self.errors.push(finding(link.line, cause, ""));
                    return;
                }
            }
        }
    }
}
