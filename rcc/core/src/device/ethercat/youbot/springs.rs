//! What nets order of the compliance of a youBot arm: its control strategy and how each joint gives way. The law of
//! the spring is `takt_ethercat::youbot::Impedance`.

use takt_ethercat::youbot::Impedance;
use takt_net::device::{Answer, Interfaces, JointImpedance};

/// Largest stiffness, Nm/rad.
const STIFFNESS_MAX: f64 = 1000.0;

/// Numbers of the control strategies.
const POSITION: i32 = 0;
const JOINT_IMPEDANCE: i32 = 1;

/// Values of the answers' error.
mod error {
    /// There is no such strategy, or a parameter is out of range or no number.
    pub(super) const RANGE: i32 = 1;
    /// The arm is not operational.
    pub(super) const NOT_ENABLED: i32 = 2;
    /// A joint moves, or is not where it is commanded.
    pub(super) const MOVES: i32 = 3;
}

/// What is in force.
#[derive(Debug, Default)]
pub(super) struct Springs {
    /// Joints give way.
    pub(super) soft: bool,
    pub(super) laws: [Impedance; 5],
    strategy: Option<Answer>,
    answers: [Option<Answer>; 5],
}

impl Springs {
    /// Takes orders; `rests` is whether the arm is at rest where it is commanded, `None` if it does not follow.
    pub(super) fn obey(
        &mut self,
        has: &Interfaces,
        words: &[u64],
        cycle: u64,
        rests: Option<bool>,
    ) {
        if rests.is_none() {
            // What comes back holds its position.
            self.soft = false;
        }
        let given = has
            .strategy
            .as_ref()
            .and_then(|order| order.command.read(words));
        if let Some(given) = given
            && self.strategy.is_none_or(|last| last.order != given.cycle)
        {
            let order = given.cycle;
            let error = self.switch(given.value, rests);
            self.strategy = Some(Answer { order, error });
        }
        let orders = has.joint_impedance.iter().flat_map(|orders| orders.iter());
        for ((order, law), last) in orders.zip(&mut self.laws).zip(&mut self.answers) {
            let given = order.command.read(words);
            let standing = given.filter(|given| given.stands(cycle));
            let added = standing.and_then(|given| given.value.torque);
            law.added = added.filter(|torque| torque.is_finite()).unwrap_or(0.0);
            if let Some(given) = given
                && last.is_none_or(|last| last.order != given.cycle)
            {
                let possible = take(law, &given.value);
                let error = if possible { 0 } else { error::RANGE };
                let order = given.cycle;
                *last = Some(Answer { order, error });
            }
        }
    }

    fn switch(&mut self, wanted: i32, rests: Option<bool>) -> i32 {
        let soft = match wanted {
            POSITION => false,
            JOINT_IMPEDANCE => true,
            _ => return error::RANGE,
        };
        match rests {
            _ if soft == self.soft => 0,
            None => error::NOT_ENABLED,
            Some(false) => error::MOVES,
            Some(true) => {
                self.soft = soft;
                0
            }
        }
    }

    pub(super) fn tell(&self, has: &Interfaces, signals: &mut [u64]) {
        if let Some(order) = &has.strategy {
            order.answer.tell(signals, self.strategy);
        }
        let orders = has.joint_impedance.iter().flat_map(|orders| orders.iter());
        for (order, answer) in orders.zip(self.answers) {
            order.answer.tell(signals, answer);
        }
    }
}

fn take(law: &mut Impedance, wanted: &JointImpedance) -> bool {
    let stiffness = wanted.stiffness.unwrap_or(law.stiffness);
    let damping = wanted.damping.unwrap_or(law.damping);
    let torque_max = wanted.torque_max.unwrap_or(law.torque_max);
    let possible = (0.0..=STIFFNESS_MAX).contains(&stiffness)
        && (0.0..=1.0).contains(&damping)
        && torque_max.is_finite()
        && wanted.torque.is_none_or(f64::is_finite);
    if possible {
        (law.stiffness, law.damping, law.torque_max) = (stiffness, damping, torque_max);
    }
    possible
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::ethercat::youbot::describe::ARM_PARTS;
    use crate::device::parts;
    use takt_net::device::Layout;

    #[test]
    fn the_strategy_changes_only_at_rest() {
        for (soft, wanted, rests, error, after) in [
            (false, 1, Some(true), 0, true),
            (true, 0, Some(true), 0, false),
            (false, 1, Some(false), error::MOVES, false),
            (false, 1, None, error::NOT_ENABLED, false),
            (true, 1, Some(false), 0, true),
            (false, 2, Some(true), error::RANGE, false),
        ] {
            let mut springs = Springs {
                soft,
                ..Springs::default()
            };
            assert_eq!(springs.switch(wanted, rests), error, "{wanted} {rests:?}");
            assert_eq!(springs.soft, after);
        }
    }

    #[test]
    fn parameters_out_of_range_leave_what_is_in_force() {
        let mut law = Impedance::default();
        let before = law;
        for (stiffness, damping) in [(-1.0, 0.5), (1001.0, 0.5), (f64::NAN, 0.5), (1.0, 1.1)] {
            let wanted = JointImpedance {
                stiffness: Some(stiffness),
                damping: Some(damping),
                ..JointImpedance::default()
            };
            assert!(!take(&mut law, &wanted));
            assert_eq!(law, before);
        }
        let wanted = JointImpedance {
            stiffness: Some(12.0),
            ..JointImpedance::default()
        };
        assert!(take(&mut law, &wanted));
        assert!((law.stiffness - 12.0).abs() < 1e-9 && (law.damping - before.damping).abs() < 1e-9);
    }

    #[test]
    fn an_arm_that_does_not_follow_becomes_stiff() {
        let mut layout = Layout::default();
        let has = parts::lay(&ARM_PARTS, 5, &mut layout);
        let mut springs = Springs {
            soft: true,
            ..Springs::default()
        };
        springs.obey(&has, &vec![0; layout.commands], 1, Some(true));
        assert!(springs.soft);
        springs.obey(&has, &vec![0; layout.commands], 2, None);
        assert!(!springs.soft);
    }
}
