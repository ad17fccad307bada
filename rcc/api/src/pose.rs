//! Places and angles as programs write them. Lengths are metres, angles radians.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// An angle in degrees as radians.
pub fn deg(angle: f64) -> f64 {
    angle.to_radians()
}

/// A position and an orientation in a reference frame, by default the base of the arm that moves there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose(Isometry3<f64>);

impl Pose {
    /// The pose of the reference frame itself.
    pub const IDENTITY: Self = Self(Isometry3 {
        rotation: UnitQuaternion::new_unchecked(Quaternion {
            coords: nalgebra::Vector4::new(0.0, 0.0, 0.0, 1.0),
        }),
        translation: Translation3 {
            vector: nalgebra::Vector3::new(0.0, 0.0, 0.0),
        },
    });

    /// The pose of the reference frame in this one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self(self.0.inverse())
    }

    /// A position, m, with the orientation of the reference frame.
    pub fn xyz(x: f64, y: f64, z: f64) -> Self {
        Self(Isometry3::translation(x, y, z))
    }

    /// The same position, turned by `a` about z, then by `b` about the new y, then by `c` about the new x, rad.
    #[must_use]
    pub fn abc(self, a: f64, b: f64, c: f64) -> Self {
        let rotation = UnitQuaternion::from_euler_angles(c, b, a);
        Self(Isometry3::from_parts(self.0.translation, rotation))
    }

    /// A position, m, and a quaternion with its scalar last, which is normalised.
    pub fn quaternion([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Self {
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        Self(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
    }

    /// Position in m.
    pub fn position(&self) -> [f64; 3] {
        self.0.translation.vector.into()
    }

    /// Orientation as a quaternion with its scalar last.
    pub fn orientation(&self) -> [f64; 4] {
        self.0.rotation.coords.into()
    }

    /// The pose as an isometry, m.
    pub const fn isometry(&self) -> &Isometry3<f64> {
        &self.0
    }

    /// A vector of this frame along the axes of the reference frame.
    pub(crate) fn turned(&self, vector: [f64; 3]) -> [f64; 3] {
        (self.0.rotation * nalgebra::Vector3::from(vector)).into()
    }

    /// Whether all its numbers are finite.
    pub(crate) fn is_finite(&self) -> bool {
        let numbers = self
            .0
            .translation
            .vector
            .iter()
            .chain(self.0.rotation.coords.iter());
        numbers.copied().all(f64::is_finite)
    }

    /// Its text in a net.
    pub(crate) fn text(&self) -> String {
        let [x, y, z] = self.position();
        let (c, b, a) = self.0.rotation.euler_angles();
        format!("{{pos:{{x:{x},y:{y},z:{z}}},rot:{{a:{a},b:{b},c:{c}}}}}")
    }

    /// Reads the text of a frame, as a controller prints it: `{pos:{x:…,y:…,z:…},rot:{a:…,b:…,c:…}}`. Members that are
    /// left out are 0.
    pub(crate) fn read(text: &str) -> Option<Self> {
        let member = |key: &str| -> Option<f64> {
            let Some(at) = text.find(&format!("{key}:")) else {
                return Some(0.0);
            };
            let rest = text.get(at + key.len() + 1..)?;
            let end = rest.find([',', '}']).unwrap_or(rest.len());
            rest.get(..end)?.trim().parse().ok()
        };
        let pose = Self::xyz(member("x")?, member("y")?, member("z")?);
        Some(pose.abc(member("a")?, member("b")?, member("c")?))
    }
}

impl From<Isometry3<f64>> for Pose {
    fn from(isometry: Isometry3<f64>) -> Self {
        Self(isometry)
    }
}

/// The pose `other` in the reference frame of `self`.
impl std::ops::Mul for Pose {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn text_of_a_pose_reads_back(
            position in prop::array::uniform3(-3.0..3.0_f64),
            (a, b, c) in (-3.1..3.1_f64, -1.5..1.5_f64, -3.1..3.1_f64),
        ) {
            let [x, y, z] = position;
            let pose = Pose::xyz(x, y, z).abc(a, b, c);
            let again = Pose::read(&pose.text()).unwrap();
            prop_assert_eq!(again.position().map(f64::to_bits), position.map(f64::to_bits));
            let angle = again.0.rotation.angle_to(&pose.0.rotation);
            prop_assert!(angle < 1e-9, "{} {}", pose.text(), angle);
        }
    }

    #[test]
    fn abc_turns_about_z_first() {
        let pose = Pose::xyz(0.0, 0.0, 0.0).abc(deg(90.0), 0.0, deg(90.0));
        let z = pose.0 * nalgebra::Point3::new(0.0, 0.0, 1.0);
        assert!(
            (z - nalgebra::Point3::new(1.0, 0.0, 0.0)).norm() < 1e-12,
            "{z}"
        );
    }

    #[test]
    fn quaternion_has_its_scalar_last() {
        let pose = Pose::quaternion([1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 2.0]);
        assert_eq!(pose, Pose::xyz(1.0, 2.0, 3.0));
    }
}
