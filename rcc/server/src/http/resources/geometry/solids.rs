//! Simple solids for the devices of a cell: what a viewer shows of an arm whose shape is not known, with the lengths of its
//! kinematics. They are no collision model.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use takt_core::cell::ObjectShape;
use takt_core::controller::{ArmModel, Axis, Chain, DeviceDetails, VisualShape};
use takt_core::net::Frame;

use super::meshes::{file_name, mesh_uri};

type Point = Vector3<f64>;

/// Shorter links are the joint alone, m.
const SHORT: f64 = 0.005;
/// Distance of the dials of an arm without kinematics, m.
const DIAL_DISTANCE: f64 = 0.3;
/// Largest opening that is shown of a gripper, m.
const OPENING_MAX: f64 = 0.2;

/// The solids of a device and what moves them.
#[derive(Debug)]
pub(super) struct Model {
    /// The rotation axes of its joints while all are at 0.
    pub(super) axes: Vec<Axis>,
    /// Whether each joint carries the next; joints of an arm without kinematics turn each for itself.
    pub(super) is_serial: bool,
    pub(super) solids: Vec<Solid>,
}

/// A solid, in the base of its device while all joints are at 0.
#[derive(Debug)]
pub(super) struct Solid {
    /// Number of the joint that moves it, from 1; 0 stays with the base.
    pub(super) link: usize,
    /// What it stands for.
    pub(super) role: &'static str,
    pub(super) shape: Shape,
    /// Its shift for each metre that a gripper is open.
    pub(super) slide: Option<Point>,
}

impl Solid {
    /// The solid of an object of the cell, about its middle.
    pub(super) fn of_object(shape: ObjectShape) -> Self {
        let shape = match shape {
            ObjectShape::Box(lengths) => Shape::Box {
                pose: Frame::identity(),
                size: lengths.into(),
            },
            ObjectShape::Cylinder { radius, length } => {
                let half = Point::z() * (0.5 * length);
                cylinder(-half, half, radius)
            }
            ObjectShape::Sphere(radius) => ball(Point::zeros(), radius),
        };
        Self {
            link: 0,
            role: "object",
            shape,
            slide: None,
        }
    }
}

/// A sphere: a capsule without length.
const fn ball(centre: Point, radius: f64) -> Shape {
    Shape::Capsule {
        from: centre,
        to: centre,
        radius,
    }
}

/// Dimensions in m.
#[derive(Debug)]
pub(super) enum Shape {
    Capsule {
        from: Point,
        to: Point,
        radius: f64,
    },
    Cylinder {
        from: Point,
        to: Point,
        radius: f64,
    },
    Box {
        pose: Frame,
        size: Point,
    },
    /// A file of the model, of which a client gets the bytes at `uri`.
    Mesh {
        pose: Frame,
        uri: String,
        file: String,
        scale: Point,
    },
}

impl Model {
    pub(super) fn of(device: &DeviceDetails) -> Self {
        let mut model = Self {
            axes: Vec::new(),
            is_serial: true,
            solids: Vec::new(),
        };
        match &device.chain {
            Some(chain) => model.arm(chain, device),
            None => model.dials(device.joints.len()),
        }
        if let Some(arm) = device.model.arm() {
            model.visuals(arm, &device.info.name);
        }
        if let Some(base) = device.abilities.get("robotbase") {
            let wheels = base.get("wheels").map_or("", String::as_str);
            let is_large = device.info.kind.contains("rmp");
            model.wheeled(wheels == "2", is_large);
        }
        if let Some(gripper) = device.abilities.get("gripper") {
            let width = gripper.get("width_max").and_then(|it| it.parse().ok());
            model.gripper(width.unwrap_or(0.1));
        } else if device.abilities.contains_key("servogripper") {
            model.gripper(0.11);
        }
        model
    }

    fn add(&mut self, link: usize, role: &'static str, shape: Shape) {
        self.solids.push(Solid {
            link,
            role,
            shape,
            slide: None,
        });
    }

    /// Capsules from joint to joint, a drum for each joint, the flange and the tools.
    fn arm(&mut self, chain: &Chain, device: &DeviceDetails) {
        self.axes.clone_from(&chain.axes);
        let centres = centres(chain);
        let length: f64 = centres.windows(2).map(distance).sum();
        let thick = (0.055 * length).clamp(0.015, 0.12);
        let count = chain.axes.len().max(1) as f64;
        let radius = |link: usize| thick * (1.0 - 0.45 * link as f64 / count);
        let foot = Point::z() * (0.3 * thick);
        self.add(0, "foot", cylinder(Point::zeros(), foot, 1.6 * thick));
        for (link, pair) in centres.windows(2).enumerate() {
            if let [from, to] = *pair
                && distance(pair) > SHORT
            {
                let radius = radius(link);
                self.add(link, "link", Shape::Capsule { from, to, radius });
            }
        }
        for (number, (axis, centre)) in chain.axes.iter().zip(centres.iter().skip(1)).enumerate() {
            let radius = radius(number);
            let half = axis.direction * (1.2 * radius);
            self.add(
                number,
                "joint",
                cylinder(centre - half, centre + half, 1.12 * radius),
            );
        }
        self.flange(chain, device, radius(chain.axes.len()));
    }

    /// The flange with a notch along its x axis, by which a viewer sees it turn.
    fn flange(&mut self, chain: &Chain, device: &DeviceDetails, radius: f64) {
        let last = chain.axes.len();
        let at = |x: f64, y: f64, z: f64| (chain.home * nalgebra::Point3::new(x, y, z)).coords;
        let disc = cylinder(at(0.0, 0.0, -0.3 * radius), at(0.0, 0.0, 0.0), 1.1 * radius);
        self.add(last, "flange", disc);
        let shift = Translation3::new(1.05 * radius, 0.0, -0.15 * radius);
        let notch = Shape::Box {
            pose: chain.home * shift,
            size: Point::new(0.5, 0.35, 0.35) * radius,
        };
        self.add(last, "notch", notch);
        for tool in &device.tools {
            let [x, y, z] = tool.position;
            let (from, to) = (at(0.0, 0.0, 0.0), at(x, y, z));
            if (to - from).norm() > SHORT {
                let radius = 0.35 * radius;
                self.add(last, "tool", Shape::Capsule { from, to, radius });
            }
        }
    }

    /// The shapes that a URDF gives to its links. The simple solids of a link stand for them where one cannot be drawn.
    fn visuals(&mut self, arm: &ArmModel, device: &str) {
        let joints = arm.joints.iter().scan(Frame::identity(), |at, joint| {
            *at *= joint.origin;
            Some(*at)
        });
        let at: Vec<_> = std::iter::once(Frame::identity()).chain(joints).collect();
        for (number, visual) in arm.visuals.iter().enumerate() {
            let Some(at) = at.get(visual.joint) else {
                continue;
            };
            let pose = at * visual.origin;
            let shape = match &visual.shape {
                VisualShape::Box(size) => Shape::Box { pose, size: *size },
                VisualShape::Cylinder(radius, length) => {
                    let end = |z: f64| (pose * nalgebra::Point3::new(0.0, 0.0, z)).coords;
                    cylinder(end(-0.5 * length), end(0.5 * length), *radius)
                }
                VisualShape::Sphere(radius) => ball(pose.translation.vector, *radius),
                VisualShape::Mesh(path, scale) => Shape::Mesh {
                    pose,
                    uri: mesh_uri(device, number),
                    file: file_name(path),
                    scale: *scale,
                },
            };
            self.add(visual.joint, "visual", shape);
        }
    }

    /// A dial with a pointer for each joint, side by side.
    fn dials(&mut self, joints: usize) {
        self.is_serial = joints == 0;
        for number in 0..joints {
            let point = Point::new(0.0, DIAL_DISTANCE * number as f64, 0.2);
            let direction = Vector3::x();
            self.axes.push(Axis { direction, point });
            let along = direction * 0.03;
            self.add(0, "foot", cylinder(point - along * 2.0, point - along, 0.1));
            self.add(
                number + 1,
                "link",
                cylinder(point - along, point + along, 0.11),
            );
            let pointer = Shape::Capsule {
                from: point + along,
                to: point + along + Vector3::z() * 0.1,
                radius: 0.012,
            };
            self.add(number + 1, "notch", pointer);
        }
    }

    /// A box on wheels: two beside each other, or four.
    fn wheeled(&mut self, has_two: bool, is_large: bool) {
        let (radius, track, wheelbase) = match (is_large, has_two) {
            (true, true) => (0.24, 0.55, 0.0),
            (true, false) => (0.24, 0.55, 0.65),
            (false, true) => (0.06, 0.3, 0.0),
            (false, false) => (0.0475, 0.3, 0.471),
        };
        let size = Point::new(
            wheelbase + 2.4 * radius,
            track - radius * 0.4,
            radius * 1.84,
        );
        let pose = lifted(1.85 * radius);
        self.add(0, "body", Shape::Box { pose, size });
        let nose = Shape::Box {
            pose: Translation3::new(0.5 * size.x, 0.0, 1.85 * radius) * Frame::identity(),
            size: Point::new(0.2 * radius, 0.5 * size.y, 0.4 * radius),
        };
        self.add(0, "notch", nose);
        let axles: &[f64] = if has_two { &[0.0] } else { &[-0.5, 0.5] };
        for (x, side) in axles.iter().flat_map(|x| [(x, -0.5), (x, 0.5)]) {
            let from = Point::new(x * wheelbase, side * track, radius);
            let to = from + Vector3::y() * (side * radius * 1.4);
            self.add(0, "wheel", cylinder(from, to, radius));
        }
    }

    /// A palm along z and two fingers that open along y.
    fn gripper(&mut self, width_max: f64) {
        let width = width_max.clamp(0.01, OPENING_MAX);
        let (palm, finger) = (0.5 * width + 0.02, 0.5 * width + 0.03);
        let size = Point::new(0.05, width + 0.05, palm);
        let pose = lifted(0.5 * palm);
        self.add(0, "body", Shape::Box { pose, size });
        for side in [-1.0, 1.0] {
            let shift = Translation3::new(0.0, side * 0.007, palm + 0.5 * finger);
            let pose = shift * Frame::identity();
            let size = Point::new(0.02, 0.014, finger);
            self.solids.push(Solid {
                link: 0,
                role: "finger",
                shape: Shape::Box { pose, size },
                slide: Some(Vector3::y() * (0.5 * side)),
            });
        }
    }
}

const fn cylinder(from: Point, to: Point, radius: f64) -> Shape {
    Shape::Cylinder { from, to, radius }
}

fn lifted(height: f64) -> Frame {
    Frame::from_parts(
        Translation3::new(0.0, 0.0, height),
        UnitQuaternion::identity(),
    )
}

fn distance(pair: &[Point]) -> f64 {
    match pair {
        [from, to] => (to - from).norm(),
        _ => 0.0,
    }
}

/// The base, for each joint the point on its axis where the arm bends, and the flange.
fn centres(chain: &Chain) -> Vec<Point> {
    let flange = chain.home.translation.vector;
    let mut centres = vec![Point::zeros()];
    let mut last = Point::zeros();
    for (number, axis) in chain.axes.iter().enumerate() {
        last = match chain.axes.get(number + 1) {
            Some(next) => nearest(axis, next).unwrap_or_else(|| projected(axis, &last)),
            None => projected(axis, &flange),
        };
        centres.push(last);
    }
    centres.push(flange);
    centres
}

/// The point on an axis that is nearest to another axis; none if they are parallel.
fn nearest(axis: &Axis, other: &Axis) -> Option<Point> {
    let cosine = axis.direction.dot(&other.direction);
    let square = 1.0 - cosine * cosine;
    if square < 1e-9 {
        return None;
    }
    let between = other.point - axis.point;
    let along = axis.direction.dot(&between) - cosine * other.direction.dot(&between);
    Some(axis.point + axis.direction * (along / square))
}

/// The point on an axis that is nearest to a point.
fn projected(axis: &Axis, point: &Point) -> Point {
    axis.point + axis.direction * axis.direction.dot(&(point - axis.point))
}

#[cfg(test)]
mod tests {
    use takt_motion::kinematics::named;

    use super::*;

    #[track_caller]
    fn joined(model: &str, expected: &[[f64; 3]]) {
        let chain = Chain::of(&*named(model).unwrap());
        let found = centres(&chain);
        for (number, expected) in expected.iter().enumerate() {
            let off = (found[number] - Point::from(*expected)).norm();
            assert!(off < 1e-9, "{model}: {number}: {:?}", found[number]);
        }
        assert_eq!(found.len(), expected.len());
    }

    #[test]
    fn arm_bends_where_its_axes_meet() {
        let [shoulder, elbow] = [[0.0, 0.0, 0.3105], [0.0, 0.0, 0.7105]];
        let [wrist, flange] = [[0.0, 0.0, 1.1005], [0.0, 0.0, 1.1785]];
        joined(
            "kuka_lwr4",
            &[
                [0.0; 3], shoulder, shoulder, elbow, elbow, wrist, wrist, flange, flange,
            ],
        );
        let [elbow, wrist] = [[0.05, 0.05, 0.903], [0.05, 0.05, 1.328]];
        let [waist, shoulder, flange] =
            [[0.0, 0.0, 0.478], [0.05, 0.0, 0.478], [0.05, 0.05, 1.428]];
        joined(
            "staubli_tx90",
            &[
                [0.0; 3], waist, shoulder, elbow, wrist, wrist, flange, flange,
            ],
        );
    }

    #[test]
    fn links_reach_from_axis_to_axis() {
        for model in ["kuka_youbot", "kuka_iiwa14", "staubli_tx90"] {
            let chain = Chain::of(&*named(model).unwrap());
            for (axis, centre) in chain.axes.iter().zip(centres(&chain).iter().skip(1)) {
                let off = (centre - projected(axis, centre)).norm();
                assert!(off < 1e-9, "{model}: {off} m off its axis");
            }
        }
    }
}
