//! What orders to FRI arms have in common, whichever generation: how they are answered, and that nothing is
//! added to a robot that came back before a net asks anew. It sends nothing.

use std::time::Duration;

use takt_net::device::{Answer, Given};
use takt_net::value::{Vector, Wrench};

/// Values of an answer's error.
pub(in crate::device) mod error {
    /// Carried out, or on its way with every answer.
    pub(in crate::device) const NONE: i32 = 0;
    /// Out of range or no number.
    pub(in crate::device) const RANGE: i32 = 1;
    /// No contact to the robot, or its drives have no power.
    pub(in crate::device) const NOT_THERE: i32 = 2;
    /// A joint moves, or is not where it is commanded.
    pub(in crate::device) const MOVES: i32 = 3;
    /// The strategy in force does not take it, or the robot's program has no way to do it.
    pub(in crate::device) const IMPOSSIBLE: i32 = 4;
    /// The robot's program did not do it.
    pub(in crate::device) const NO_REACTION: i32 = 5;
    /// Not before the robot enters command mode anew, or the addition is asked for anew.
    pub(in crate::device) const NOT_NOW: i32 = 6;
}

/// What nets order, as the driver sees it before an answer.
#[derive(Clone, Copy, Debug)]
pub struct Orders<'a> {
    /// All that nets command beside joint positions, in the places of the device's interfaces.
    pub words: &'a [u64],
    /// Number of the cycle in which these words were handed over.
    pub cycle: u64,
    /// Whether the net thread that hands them over is alive.
    pub is_fresh: bool,
    /// Whether the robot follows, and did so already at the last answer.
    pub follows: bool,
    /// Whether a joint is commanded to move now.
    pub moves: bool,
    /// Time since some instant, as the session counts it.
    pub now: Duration,
}

impl Orders<'_> {
    /// Whether the net that gave this still asks for it: for what ends with its net.
    pub(in crate::device) const fn stands<T>(&self, given: &Given<T>) -> bool {
        self.is_fresh && given.is_in_force(self.cycle)
    }
}

/// Lets what nets add through only if it was not asked for already when the robot entered command mode: whoever
/// was pushing before a fault does not go on by itself.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::device) struct Gate {
    is_shut: bool,
}

impl Gate {
    /// Whether what is wanted may be added now; `follows` is whether the robot follows.
    const fn admits(&mut self, is_wanted: bool, follows: bool) -> bool {
        self.is_shut = is_wanted && (self.is_shut || !follows);
        is_wanted && !self.is_shut
    }

    /// What of these values is added, and why not all: [`error::RANGE`] if one does not fit, by a guard,
    /// [`error::NOT_NOW`] if they are to be asked for anew; then nothing is added.
    pub(in crate::device) fn pass<const N: usize>(
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
pub(in crate::device) const fn answer(order: u64, error: i32) -> Option<Answer> {
    Some(Answer { order, error })
}

/// The first error of several; none if all are well.
pub(in crate::device) fn first(errors: impl IntoIterator<Item = i32>) -> i32 {
    let mut errors = errors.into_iter();
    errors.find(|e| *e != error::NONE).unwrap_or(error::NONE)
}

/// Force and torque from the order of both generations: along x, y, z, then about z, y, x.
pub(in crate::device) const fn from_wire(values: [f64; 6]) -> Wrench {
    let [x, y, z, about_z, about_y, about_x] = values;
    Wrench {
        force: Vector::new(x, y, z),
        torque: Vector::new(about_x, about_y, about_z),
    }
}

/// The same the other way round.
pub(in crate::device) fn to_wire(wrench: &Wrench) -> [f64; 6] {
    let ([x, y, z], [a, b, c]) = (wrench.force.into(), wrench.torque.into());
    [x, y, z, c, b, a]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torques_about_z_come_first_on_the_wire() {
        let wrench = from_wire([1.0, 2.0, 3.0, 6.0, 5.0, 4.0]);
        assert_eq!(wrench.force, Vector::new(1.0, 2.0, 3.0));
        assert_eq!(wrench.torque, Vector::new(4.0, 5.0, 6.0));
        assert_eq!(from_wire(to_wire(&wrench)), wrench);
    }

    #[test]
    fn what_was_asked_for_before_the_robot_followed_is_added_when_asked_anew() {
        let mut gate = Gate::default();
        assert!(gate.admits(true, true), "asked for while it follows");
        assert!(!gate.admits(true, false), "it fell out of command");
        assert!(!gate.admits(true, true), "and came back");
        assert!(!gate.admits(false, true));
        assert!(gate.admits(true, true), "asked anew");
    }

    #[test]
    fn what_ends_with_its_net_ends_with_the_net_thread_too() {
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
        assert!(orders.stands(&given(7)) && !orders.stands(&given(6)));
        let stale = Orders {
            is_fresh: false,
            ..orders
        };
        assert!(!stale.stands(&given(8)));
    }
}
