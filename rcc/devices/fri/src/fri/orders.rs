//! Common parts of orders to FRI arms of both generations: answers, and the gate that adds nothing to a robot that
//! recovered before a net requests it again. Nothing is sent here.

use std::time::Duration;

use takt_net::device::{Answer, Given};
use takt_net::value::{Vector, Wrench};

/// Error values of answers.
pub(crate) mod error {
    /// Executed, or sent with every answer.
    pub(crate) const NONE: i32 = 0;
    /// Out of range or not finite.
    pub(crate) const RANGE: i32 = 1;
    /// No contact to the robot, or its drives are off.
    pub(crate) const NOT_THERE: i32 = 2;
    /// A joint moves, or is not at its commanded position.
    pub(crate) const MOVES: i32 = 3;
    /// Not supported by the current strategy or by the robot's program.
    pub(crate) const IMPOSSIBLE: i32 = 4;
    /// The robot's program did not react.
    pub(crate) const NO_REACTION: i32 = 5;
    /// Only after the robot enters command mode again, or the addition is requested again.
    pub(crate) const NOT_NOW: i32 = 6;
}

/// Orders of nets, as the driver sees them before an answer.
#[derive(Clone, Copy, Debug)]
pub struct Orders<'a> {
    /// Command words besides joint positions.
    pub words: &'a [u64],
    /// Number of the cycle that published these words.
    pub cycle: u64,
    /// Whether the net thread that publishes them is alive.
    pub is_fresh: bool,
    /// Whether the robot follows, and did so already at the last answer.
    pub follows: bool,
    /// Whether a joint is commanded to move now.
    pub moves: bool,
    /// Session time.
    pub now: Duration,
}

impl Orders<'_> {
    /// Whether the net that gave this still requests it; for commands that end with their net.
    pub(crate) const fn is_in_force<T>(&self, given: &Given<T>) -> bool {
        self.is_fresh && given.is_in_force(self.cycle)
    }
}

/// Passes torques and wrenches that nets add only if they began after the robot entered command mode: a net that was
/// pushing before a fault does not continue by itself.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gate {
    is_shut: bool,
}

impl Gate {
    /// Whether the wanted values may be added now; `follows` is whether the robot follows.
    const fn admits(&mut self, is_wanted: bool, follows: bool) -> bool {
        self.is_shut = is_wanted && (self.is_shut || !follows);
        is_wanted && !self.is_shut
    }

    /// The values that are added, and the error: [`error::RANGE`] if a guard rejects one, [`error::NOT_NOW`] if they
    /// must be requested again; then nothing is added.
    pub(crate) fn pass<const N: usize>(
        &mut self,
        wanted: [f64; N],
        fits: bool,
        follows: bool,
    ) -> ([f64; N], i32) {
        let is_wanted = fits && wanted.iter().any(|value| value.abs() > 0.0);
        let passes = self.admits(is_wanted, follows);
        let added = if passes { wanted } else { [0.0; N] };
        let refused = match (fits, is_wanted && !passes) {
            (false, _) => error::RANGE,
            (true, true) => error::NOT_NOW,
            (true, false) => error::NONE,
        };
        (added, refused)
    }
}

/// The answer to an order.
pub(crate) const fn answer(order: u64, error: i32) -> Option<Answer> {
    Some(Answer { order, error })
}

/// The first error, or none.
pub(crate) fn first(errors: impl IntoIterator<Item = i32>) -> i32 {
    let mut errors = errors.into_iter();
    errors.find(|e| *e != error::NONE).unwrap_or(error::NONE)
}

/// Force and torque from the order of both generations: along x, y, z, then about z, y, x.
pub(crate) const fn from_wire(values: [f64; 6]) -> Wrench {
    let [x, y, z, about_z, about_y, about_x] = values;
    Wrench {
        force: Vector::new(x, y, z),
        torque: Vector::new(about_x, about_y, about_z),
    }
}

/// The inverse of [`from_wire`].
pub(crate) fn to_wire(wrench: &Wrench) -> [f64; 6] {
    let ([x, y, z], [a, b, c]) = (wrench.force.into(), wrench.torque.into());
    [x, y, z, c, b, a]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fri_wire_wrench_has_torque_z_first() {
        let wrench = from_wire([1.0, 2.0, 3.0, 6.0, 5.0, 4.0]);
        assert_eq!(wrench.force, Vector::new(1.0, 2.0, 3.0));
        assert_eq!(wrench.torque, Vector::new(4.0, 5.0, 6.0));
        assert_eq!(from_wire(to_wire(&wrench)), wrench);
    }

    #[test]
    fn fri_gate_adds_old_request_only_after_renewal() {
        let mut gate = Gate::default();
        assert!(gate.admits(true, true), "requested while it follows");
        assert!(!gate.admits(true, false), "it left command mode");
        assert!(!gate.admits(true, true), "and recovered");
        assert!(!gate.admits(false, true));
        assert!(gate.admits(true, true), "requested again");
    }

    #[test]
    fn fri_orders_end_with_net_and_net_thread() {
        let orders = Orders {
            words: &[],
            cycle: 8,
            is_fresh: true,
            follows: true,
            moves: false,
            now: Duration::ZERO,
        };
        let given = |cycle| Given {
            cycle,
            every: 2,
            value: (),
        };
        assert!(orders.is_in_force(&given(7)) && !orders.is_in_force(&given(6)));
        let stale = Orders {
            is_fresh: false,
            ..orders
        };
        assert!(!stale.is_in_force(&given(8)));
    }
}
