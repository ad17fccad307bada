//! What nets order of the compliance of a youBot arm: its control strategy and how each joint gives way. The law of
//! the spring is `takt_ethercat::youbot::Impedance`.

use takt_ethercat::youbot::Impedance;
use takt_net::device::{Answer, Interfaces, JointImpedance};

use crate::device::DeviceCommand;

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
    /// Takes orders. `fresh` is whether the net thread that gave them is alive: what it adds ends with it. `rests` is
    /// whether the arm is at rest where it is commanded, `None` if it does not follow.
    pub(super) fn obey(
        &mut self,
        has: &Interfaces,
        given: &DeviceCommand,
        fresh: bool,
        rests: Option<bool>,
    ) {
        let DeviceCommand { words, cycle, .. } = given;
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
            let standing = given.filter(|given| fresh && given.stands(*cycle));
            law.added = standing.map_or(0.0, |given| addition(&given.value));
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

/// What is to be added, if it is a number.
fn addition(wanted: &JointImpedance) -> f64 {
    let torque = wanted.torque.filter(|torque| torque.is_finite());
    torque.unwrap_or(0.0)
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
    use crate::device::{Part, parts};
    use takt_net::device::{Layout, Words};

    /// What a net's primitive leaves for the first joint in a cycle: two stamps before what it wants.
    fn given(layout: Layout, cycle: u64, wanted: JointImpedance) -> DeviceCommand {
        let mut given = DeviceCommand::new(layout.commands);
        given.cycle = cycle;
        (given.words[1], given.words[2]) = (cycle, 1);
        wanted.put_words(|i, word| given.words[3 + i] = word);
        given
    }

    #[test]
    fn what_a_net_adds_ends_with_the_net_and_with_its_thread() {
        let mut layout = Layout::default();
        let has = parts::lay(&[Part::JointImpedance], 5, &mut layout);
        let torque = |torque| JointImpedance {
            torque: Some(torque),
            ..JointImpedance::default()
        };
        let mut springs = Springs::default();
        let mut added = |given: &DeviceCommand, fresh| {
            springs.obey(&has, given, fresh, Some(true));
            springs.laws[0].added
        };
        let mut standing = given(layout, 5, torque(2.0));
        assert!((added(&standing, true) - 2.0).abs() < 1e-9);
        assert!(
            added(&standing, false).abs() < 1e-9,
            "its thread stands still"
        );
        standing.cycle = 6;
        assert!(added(&standing, true).abs() < 1e-9, "it ended");
        let no_number = given(layout, 7, torque(f64::NAN));
        assert!(added(&no_number, true).abs() < 1e-9);
    }

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
        let given = DeviceCommand::new(layout.commands);
        springs.obey(&has, &given, true, Some(true));
        assert!(springs.soft);
        springs.obey(&has, &given, true, None);
        assert!(!springs.soft);
    }
}
