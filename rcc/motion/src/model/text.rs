//! The text of a chain: records of words between spaces, with `;` between them. Names have `%XX` for what separates.
//!
//! ```text
//! serial 1 NAME FILE BASE TIP
//! R|P NAME LINE min max velocity|- effort|- FRAME axis(3) mass moment(3) inertia(9)
//! F FRAME                                     the flange in the last joint
//! V JOINT FRAME box|cylinder|sphere|mesh ...  a solid
//! ```
//! A frame is x y z (m) and the quaternion x y z w.

use std::fmt::{Display, Write as _};
use std::str::{FromStr, SplitAsciiWhitespace};

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use takt_net::Frame;

use crate::dynamics::Body;
use crate::kinematics::{JOINTS_MAX, JointKind, Range};
use crate::urdf::{ArmJoint, ArmModel, Shape, Visual};

/// What begins a chain of any version.
const BEGIN: &str = "serial ";
/// The version of the text.
const VERSION: &str = "1";
/// Longest text, bytes.
const BYTES_MAX: usize = 1 << 18;
/// Most solids of an arm.
const SOLIDS_MAX: usize = 512;
/// How far a quaternion may be from length 1.
const NEARLY_UNIT: f64 = 1e-6;

/// Why a text is no chain.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TextError {
    /// Written by another version.
    #[error(
        "the chain of joints is of version {0}\nhint: use the version of Takt that wrote it; this one reads version {VERSION}"
    )]
    Version(String),
    /// Too long.
    #[error("the chain of joints has more than {BYTES_MAX} bytes")]
    Long,
    /// A record that cannot be read, from 0.
    #[error("record {0} of the chain of joints cannot be read")]
    Record(usize),
    /// Joints that make no arm.
    #[error("the chain of joints is no arm: {0}")]
    Arm(String),
}

pub(super) fn is_chain(text: &str) -> bool {
    text.starts_with(BEGIN)
}

pub(super) fn write(arm: &ArmModel, has_solids: bool) -> String {
    let mut out = Writer(format!("{BEGIN}{VERSION}"));
    for name in [&arm.name, &arm.file, &arm.base, &arm.tip] {
        out.name(name);
    }
    for joint in &arm.joints {
        let most = |most: Option<f64>| most.map_or_else(|| "-".to_owned(), |it| it.to_string());
        out.record(match joint.kind {
            JointKind::Revolute => "R",
            JointKind::Prismatic => "P",
        });
        out.name(&joint.name);
        out.word(joint.line);
        out.numbers(&[joint.range.min, joint.range.max]);
        out.word(most(joint.velocity_max));
        out.word(most(joint.effort_max));
        out.frame(&joint.origin);
        out.numbers(joint.axis.as_slice());
        out.numbers(&[joint.body.mass]);
        out.numbers(joint.body.moment.as_slice());
        out.numbers(joint.body.inertia.as_slice());
    }
    out.record("F");
    out.frame(&arm.flange);
    for visual in arm.visuals.iter().filter(|_| has_solids) {
        out.record("V");
        out.word(visual.joint);
        out.frame(&visual.origin);
        out.shape(&visual.shape);
    }
    out.0
}

struct Writer(String);

impl Writer {
    fn record(&mut self, kind: &str) {
        self.0.push(';');
        self.0.push_str(kind);
    }

    fn word(&mut self, word: impl Display) {
        // A string takes all that is written.
        let _ = write!(self.0, " {word}");
    }

    fn name(&mut self, name: &str) {
        self.0.push(' ');
        for byte in name.bytes() {
            match byte {
                b'!'..=b'~' if byte != b'%' && byte != b';' => self.0.push(char::from(byte)),
                _ => {
                    let _ = write!(self.0, "%{byte:02X}");
                }
            }
        }
        if name.is_empty() {
            self.0.push('%');
        }
    }

    fn numbers(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.word(number);
        }
    }

    fn frame(&mut self, frame: &Frame) {
        self.numbers(frame.translation.vector.as_slice());
        self.numbers(frame.rotation.coords.as_slice());
    }

    fn shape(&mut self, shape: &Shape) {
        match shape {
            Shape::Box(size) => {
                self.word("box");
                self.numbers(size.as_slice());
            }
            Shape::Cylinder(radius, length) => {
                self.word("cylinder");
                self.numbers(&[*radius, *length]);
            }
            Shape::Sphere(radius) => {
                self.word("sphere");
                self.numbers(&[*radius]);
            }
            Shape::Mesh(file, scale) => {
                self.word("mesh");
                self.name(file);
                self.numbers(scale.as_slice());
            }
        }
    }
}

pub(super) fn read(text: &str) -> Result<ArmModel, TextError> {
    if text.len() > BYTES_MAX {
        return Err(TextError::Long);
    }
    let mut records = text.split(';').enumerate();
    let (_, head) = records.next().ok_or(TextError::Record(0))?;
    let mut head = Reader::new(head.strip_prefix(BEGIN).unwrap_or_default());
    let version = head.word().unwrap_or_default();
    if version != VERSION {
        return Err(TextError::Version(version.to_owned()));
    }
    let names = head.names();
    let [name, file, base, tip] = names.ok_or(TextError::Record(0))?;
    let (mut joints, mut flange, mut visuals) = (Vec::new(), None, Vec::new());
    for (number, record) in records {
        let mut record = Reader::new(record);
        let read = match record.word() {
            Some("R") => record.joint(JointKind::Revolute).map(|it| joints.push(it)),
            Some("P") => record.joint(JointKind::Prismatic).map(|it| joints.push(it)),
            Some("F") => record.frame().map(|it| flange = Some(it)),
            Some("V") => record.visual().map(|it| visuals.push(it)),
            _ => None,
        };
        let is_bounded = joints.len() <= JOINTS_MAX && visuals.len() <= SOLIDS_MAX;
        let is_good = read.is_some() && is_bounded && record.word().is_none();
        if !is_good {
            return Err(TextError::Record(number));
        }
    }
    let flange = flange.ok_or_else(|| TextError::Arm("it has no flange".to_owned()))?;
    let arm = ArmModel::new(name, joints, flange);
    let arm = arm.map_err(|error| TextError::Arm(error.to_string()))?;
    Ok(ArmModel {
        file,
        base,
        tip,
        visuals,
        ..arm
    })
}

struct Reader<'a>(SplitAsciiWhitespace<'a>);

impl<'a> Reader<'a> {
    fn new(record: &'a str) -> Self {
        Self(record.split_ascii_whitespace())
    }

    fn word(&mut self) -> Option<&'a str> {
        self.0.next()
    }

    fn value<T: FromStr>(&mut self) -> Option<T> {
        self.word()?.parse().ok()
    }

    fn name(&mut self) -> Option<String> {
        let word = self.word()?;
        if word == "%" {
            return Some(String::new());
        }
        let mut bytes = Vec::with_capacity(word.len());
        let mut rest = word.bytes();
        while let Some(byte) = rest.next() {
            if byte != b'%' {
                bytes.push(byte);
                continue;
            }
            let mut digit = || char::from(rest.next()?).to_digit(16);
            let [high, low] = [digit()?, digit()?];
            bytes.push(u8::try_from(high * 16 + low).ok()?);
        }
        String::from_utf8(bytes).ok()
    }

    fn names(&mut self) -> Option<[String; 4]> {
        Some([self.name()?, self.name()?, self.name()?, self.name()?])
    }

    fn finite(&mut self) -> Option<f64> {
        self.value().filter(|value: &f64| value.is_finite())
    }

    fn vector(&mut self) -> Option<Vector3<f64>> {
        Some(Vector3::new(self.finite()?, self.finite()?, self.finite()?))
    }

    fn frame(&mut self) -> Option<Frame> {
        let position = self.vector()?;
        let [x, y, z, w] = [
            self.finite()?,
            self.finite()?,
            self.finite()?,
            self.finite()?,
        ];
        let turn = Quaternion::new(w, x, y, z);
        let is_unit = (turn.norm() - 1.0).abs() < NEARLY_UNIT;
        // Not normalized: every bit is as it was written.
        let turn = is_unit.then(|| UnitQuaternion::new_unchecked(turn))?;
        Some(Frame::from_parts(position.into(), turn))
    }

    /// A number that is left out as `-`.
    fn most(&mut self) -> Option<Option<f64>> {
        let word = self.word()?;
        if word == "-" {
            return Some(None);
        }
        let value: f64 = word.parse().ok()?;
        (value > 0.0 && value.is_finite()).then_some(Some(value))
    }

    fn joint(&mut self, kind: JointKind) -> Option<ArmJoint> {
        Some(ArmJoint {
            name: self.name()?,
            line: self.value()?,
            kind,
            range: Range {
                min: self.value()?,
                max: self.value()?,
            },
            velocity_max: self.most()?,
            effort_max: self.most()?,
            origin: self.frame()?,
            axis: self.vector()?,
            body: Body {
                mass: self.finite()?,
                moment: self.vector()?,
                inertia: Matrix3::from_columns(&[self.vector()?, self.vector()?, self.vector()?]),
            },
        })
    }

    fn visual(&mut self) -> Option<Visual> {
        let joint = self.value()?;
        let origin = self.frame()?;
        let shape = match self.word()? {
            "box" => Shape::Box(self.vector()?),
            "cylinder" => Shape::Cylinder(self.finite()?, self.finite()?),
            "sphere" => Shape::Sphere(self.finite()?),
            "mesh" => Shape::Mesh(self.name()?, self.vector()?),
            _ => return None,
        };
        (joint <= JOINTS_MAX).then_some(Visual {
            joint,
            origin,
            shape,
        })
    }
}
