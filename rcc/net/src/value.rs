//! The values that a port can carry: their types and their layouts in memory and in words. Their
//! text form is in [`text`]; null is not a value but the `None` of a slot.

pub mod text;
pub mod unit;

use std::fmt;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::slots::{Column, ColumnBuilder, Slots, SlotsBuilder};

/// `World::Vector`: three coordinates, metres unless a port declares another unit.
pub type Vector = Vector3<f64>;
/// `World::Rotation`: a rotation in space, held as a unit quaternion.
pub type Rotation = UnitQuaternion<f64>;
/// `World::Frame`: position (m) and orientation of one frame in another.
pub type Frame = Isometry3<f64>;

/// `Core::nsecs`: a point in time or a span, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Nanos(pub i64);

/// `World::Twist`: velocity of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Translational velocity, m/s.
    pub vel: Vector,
    /// Rotational velocity as axis times speed, rad/s.
    pub rot: Vector,
}

/// `World::Wrench`: force and torque at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force, N.
    pub force: Vector,
    /// Torque, Nm.
    pub torque: Vector,
}

/// The type of one element of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Element {
    /// `Core::bool`
    Bool,
    /// `Core::int`, 32 bit.
    Int,
    /// `Core::double`
    Double,
    /// `Core::nsecs`, 64 bit nanoseconds.
    Nanos,
    /// `World::Vector`
    Vector,
    /// `World::Rotation`
    Rotation,
    /// `World::Frame`
    Frame,
    /// `World::Twist`
    Twist,
    /// `World::Wrench`
    Wrench,
}

impl Element {
    /// Every element type, in a fixed order.
    pub const ALL: [Self; 9] = [
        Self::Bool,
        Self::Int,
        Self::Double,
        Self::Nanos,
        Self::Vector,
        Self::Rotation,
        Self::Frame,
        Self::Twist,
        Self::Wrench,
    ];

    /// The full name on the wire, such as `Core::double`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bool => "Core::bool",
            Self::Int => "Core::int",
            Self::Double => "Core::double",
            Self::Nanos => "Core::nsecs",
            Self::Vector => "World::Vector",
            Self::Rotation => "World::Rotation",
            Self::Frame => "World::Frame",
            Self::Twist => "World::Twist",
            Self::Wrench => "World::Wrench",
        }
    }
}

/// The type of a port: an element, or a fixed array of it. The size of an array is a property of
/// the source that fills it and is checked at load time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Type {
    /// The type of one element.
    pub element: Element,
    /// Whether the port carries a fixed array of elements.
    pub array: bool,
}

impl Type {
    /// The type of one element.
    pub const fn scalar(element: Element) -> Self {
        Self {
            element,
            array: false,
        }
    }

    /// The type of a fixed array.
    pub const fn array(element: Element) -> Self {
        Self {
            element,
            array: true,
        }
    }
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.element.name())?;
        if self.array {
            f.write_str("[]")
        } else {
            Ok(())
        }
    }
}

/// A Rust type that a port can carry.
///
/// The word form is the one layout in which values cross threads and enter recordings: a fixed
/// number of 64-bit words, exact for every value including the payload of a NaN.
pub trait Value: Copy + Default + PartialEq + fmt::Debug + Send + Sync + 'static {
    /// Which element type this is.
    const ELEMENT: Element;
    /// The prefix of generic families of this type, such as `Core::Double`.
    const PREFIX: &'static str;
    /// Number of words of one value.
    const WORDS: usize;

    /// The column of a plan for values of this type.
    #[doc(hidden)]
    fn column(slots: &Slots) -> &Column<Self>;

    /// The slots of this type while a plan is built.
    #[doc(hidden)]
    fn builder(slots: &mut SlotsBuilder) -> &mut ColumnBuilder<Self>;

    /// Writes the value as [`Self::WORDS`] words.
    fn put(self, word: impl FnMut(usize, u64));

    /// Reads a value back from its words.
    fn take(word: impl Fn(usize) -> u64) -> Self;
}

macro_rules! value {
    ($type:ty, $element:ident, $prefix:literal, $column:ident, $words:literal,
     $put:expr, $take:expr) => {
        impl Value for $type {
            const ELEMENT: Element = Element::$element;
            const PREFIX: &'static str = $prefix;
            const WORDS: usize = $words;

            fn column(slots: &Slots) -> &Column<Self> {
                &slots.$column
            }

            fn builder(slots: &mut SlotsBuilder) -> &mut ColumnBuilder<Self> {
                &mut slots.$column
            }

            fn put(self, mut word: impl FnMut(usize, u64)) {
                let words: [u64; $words] = $put(self);
                for (i, w) in words.into_iter().enumerate() {
                    word(i, w);
                }
            }

            fn take(word: impl Fn(usize) -> u64) -> Self {
                $take(std::array::from_fn::<u64, $words, _>(word))
            }
        }
    };
}

fn vector([x, y, z]: [u64; 3]) -> Vector {
    Vector::new(f64::from_bits(x), f64::from_bits(y), f64::from_bits(z))
}

fn vector_words(v: Vector) -> [u64; 3] {
    [v.x.to_bits(), v.y.to_bits(), v.z.to_bits()]
}

fn rotation([w, i, j, k]: [u64; 4]) -> Rotation {
    // The words were written from a unit quaternion; normalising again would change bits.
    Rotation::new_unchecked(Quaternion::new(
        f64::from_bits(w),
        f64::from_bits(i),
        f64::from_bits(j),
        f64::from_bits(k),
    ))
}

fn rotation_words(r: Rotation) -> [u64; 4] {
    [r.w.to_bits(), r.i.to_bits(), r.j.to_bits(), r.k.to_bits()]
}

value!(
    bool,
    Bool,
    "Core::Boolean",
    bool,
    1,
    |v| [u64::from(v)],
    |[w]: [u64; 1]| w != 0
);
value!(
    i32,
    Int,
    "Core::Int",
    int,
    1,
    |v: i32| [u64::from(v.cast_unsigned())],
    |[w]: [u64; 1]| {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "put wrote a zero-extended i32"
        )]
        (w as u32).cast_signed()
    }
);
value!(
    f64,
    Double,
    "Core::Double",
    double,
    1,
    |v: f64| [v.to_bits()],
    |[w]: [u64; 1]| { f64::from_bits(w) }
);
value!(
    Nanos,
    Nanos,
    "Core::Time",
    nanos,
    1,
    |v: Nanos| [v.0.cast_unsigned()],
    |[w]: [u64; 1]| { Nanos(w.cast_signed()) }
);
value!(
    Vector,
    Vector,
    "World::Vector",
    vector,
    3,
    vector_words,
    vector
);
value!(
    Rotation,
    Rotation,
    "World::Rotation",
    rotation,
    4,
    rotation_words,
    rotation
);
value!(
    Frame,
    Frame,
    "World::Frame",
    frame,
    7,
    |v: Frame| {
        let [x, y, z] = vector_words(v.translation.vector);
        let [w, i, j, k] = rotation_words(v.rotation);
        [x, y, z, w, i, j, k]
    },
    |[x, y, z, w, i, j, k]: [u64; 7]| {
        Frame::from_parts(
            Translation3::from(vector([x, y, z])),
            rotation([w, i, j, k]),
        )
    }
);
value!(
    Twist,
    Twist,
    "World::Twist",
    twist,
    6,
    |v: Twist| {
        let ([a, b, c], [d, e, f]) = (vector_words(v.vel), vector_words(v.rot));
        [a, b, c, d, e, f]
    },
    |[a, b, c, d, e, f]: [u64; 6]| Twist {
        vel: vector([a, b, c]),
        rot: vector([d, e, f])
    }
);
value!(
    Wrench,
    Wrench,
    "World::Wrench",
    wrench,
    6,
    |v: Wrench| {
        let ([a, b, c], [d, e, f]) = (vector_words(v.force), vector_words(v.torque));
        [a, b, c, d, e, f]
    },
    |[a, b, c, d, e, f]: [u64; 6]| Wrench {
        force: vector([a, b, c]),
        torque: vector([d, e, f])
    }
);

#[cfg(test)]
mod tests {
    use super::*;

    fn through_words<T: Value>(value: T) -> T {
        let mut words = vec![0; T::WORDS];
        value.put(|i, w| words[i] = w);
        T::take(|i| words[i])
    }

    #[test]
    fn words_are_exact() {
        assert!(through_words(true));
        assert_eq!(through_words(-7_i32), -7);
        assert_eq!(through_words(Nanos(i64::MIN)), Nanos(i64::MIN));
        let frame = Frame::from_parts(
            Translation3::new(1.0, -2.0, 3.5),
            Rotation::from_euler_angles(0.1, -0.7, 2.9),
        );
        assert_eq!(through_words(frame), frame);
        let twist = Twist {
            vel: Vector::new(1.0, 2.0, 3.0),
            rot: Vector::new(4.0, 5.0, 6.0),
        };
        assert_eq!(through_words(twist), twist);
        let wrench = Wrench {
            force: Vector::new(1.0, 2.0, 3.0),
            torque: Vector::new(4.0, 5.0, 6.0),
        };
        assert_eq!(through_words(wrench), wrench);
    }

    #[test]
    fn nan_keeps_its_payload() {
        let nan = f64::from_bits(0x7ff8_0000_dead_beef);
        assert_eq!(through_words(nan).to_bits(), nan.to_bits());
    }
}
