//! What filters and limits need of a value: sums, lengths, and the point on the way to another value. What
//! they do over time is theirs.

use crate::value::text::TextValue;
use crate::value::{Frame, Rotation, Twist, Vector, Wrench};

/// A value of numbers that are added and scaled one by one.
pub(super) trait Linear: TextValue {
    /// `self` times `a` plus `other` times `b`.
    fn combine(self, a: f64, other: Self, b: f64) -> Self;
}

/// A value with a length: its magnitude without its direction.
pub(super) trait Length: Linear {
    /// The length, in the unit of the value.
    fn length(self) -> f64;

    /// The value at most `most` long, in its direction.
    fn shortened(self, most: f64) -> Self {
        let length = self.length();
        if length > most {
            self.combine(most / length, Self::default(), 0.0)
        } else {
            self
        }
    }
}

impl Linear for f64 {
    fn combine(self, a: f64, other: Self, b: f64) -> Self {
        self * a + other * b
    }
}

impl Length for f64 {
    fn length(self) -> f64 {
        self.abs()
    }

    fn shortened(self, most: f64) -> Self {
        // Unlike a division, exact.
        if self.abs() > most {
            most.copysign(self)
        } else {
            self
        }
    }
}

impl Linear for Vector {
    fn combine(self, a: f64, other: Self, b: f64) -> Self {
        self * a + other * b
    }
}

impl Length for Vector {
    fn length(self) -> f64 {
        self.norm()
    }
}

impl Linear for Twist {
    fn combine(self, a: f64, other: Self, b: f64) -> Self {
        Self {
            vel: self.vel.combine(a, other.vel, b),
            rot: self.rot.combine(a, other.rot, b),
        }
    }
}

impl Linear for Wrench {
    fn combine(self, a: f64, other: Self, b: f64) -> Self {
        Self {
            force: self.force.combine(a, other.force, b),
            torque: self.torque.combine(a, other.torque, b),
        }
    }
}

/// A value from which another can be approached.
pub(super) trait Approach: TextValue {
    /// The value a part (0 to 1) of the way to `goal`.
    fn towards(self, goal: Self, part: f64) -> Self;
}

impl<T: Linear> Approach for T {
    fn towards(self, goal: Self, part: f64) -> Self {
        self.combine(1.0, goal.combine(1.0, self, -1.0), part)
    }
}

/// By the shorter turn about one axis.
impl Approach for Rotation {
    fn towards(self, goal: Self, part: f64) -> Self {
        let turn = self.inverse() * goal;
        let next = self * Self::from_scaled_axis(shorter(turn) * part);
        // Rounding errors of many steps must not add up.
        Self::new_normalize(next.into_inner())
    }
}

/// The axis of a rotation times its angle, which is at most half a turn.
pub(super) fn shorter(turn: Rotation) -> Vector {
    let positive = if turn.w < 0.0 {
        Rotation::new_unchecked(-turn.into_inner())
    } else {
        turn
    };
    positive.scaled_axis()
}

/// The position along a straight line, the orientation as a rotation.
impl Approach for Frame {
    fn towards(self, goal: Self, part: f64) -> Self {
        let position = self.translation.vector;
        let position = position.towards(goal.translation.vector, part);
        let rotation = self.rotation.towards(goal.rotation, part);
        Self::from_parts(position.into(), rotation)
    }
}

/// The value, unless a number of it is not finite.
pub(super) fn finite<T: TextValue>(value: T) -> Option<T> {
    let mut is_finite = true;
    value.put(|_, word| is_finite &= f64::from_bits(word).is_finite());
    is_finite.then_some(value)
}
