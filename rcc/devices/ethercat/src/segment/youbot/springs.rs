//! Compliance of a youBot arm as nets order it: control strategy, joint impedance, and tool impedance. The control
//! law of a joint is `takt_ethercat::youbot::Impedance`, that of the tool [`Tool`].

use std::time::Duration;

use takt_ethercat::youbot::{ARM, Impedance, JointGeometry, holding};
use takt_motion::kinematics::YouBot;
use takt_net::device::{Answer, CartesianImpedance, Interfaces, JointImpedance};
use takt_net::value::Wrench;

use super::tool::{Motions, Tool, axes, stiffness_by_inertia};
use takt_core::device::DeviceCommand;

/// Largest stiffness, Nm/rad.
const STIFFNESS_MAX: f64 = 1000.0;

/// Largest stiffness of the tool, N/m and Nm/rad.
const TOOL_STIFFNESS_MAX: f64 = 10_000.0;
/// Natural frequency of a spring with the inertia of the motors that it moves, rad/s, times the cycle, s, at most: torques act two
/// cycles after the position that they answer, and a stiffer spring swings, against any damper.
const SWING_MAX: f64 = 0.2;
/// A joint nearer to the end of its range than this is not pushed towards it, rad: 5 degrees.
const END: f64 = 0.0873;

/// Control strategy, by the number that nets order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Strategy {
    /// Joint position control by the drives.
    #[default]
    Position = 0,
    /// Joint impedance.
    Joints = 1,
    /// Tool impedance.
    Tool = 2,
}

impl Strategy {
    const fn of(number: i32) -> Option<Self> {
        match number {
            0 => Some(Self::Position),
            1 => Some(Self::Joints),
            2 => Some(Self::Tool),
            _ => None,
        }
    }
}

/// Error values of answers.
mod error {
    /// Unknown strategy, or a parameter is out of range or not finite; a spring is stiffer than the cycle admits.
    pub(super) const RANGE: i32 = 1;
    /// The arm is not operational.
    pub(super) const NOT_ENABLED: i32 = 2;
    /// A joint moves, or is not at its commanded position.
    pub(super) const MOVES: i32 = 3;
}

/// The parameters in force.
#[derive(Debug, Default)]
pub(super) struct Springs {
    /// s.
    cycle: f64,
    pub(super) strategy: Strategy,
    laws: [Impedance; 5],
    tool: Tool,
    switched: Option<Answer>,
    answers: [Option<Answer>; 5],
    tool_answer: Option<Answer>,
}

impl Springs {
    /// Springs of an arm with that kinematics, whose torques are set each cycle.
    pub(super) fn of(arm: YouBot, cycle: Duration) -> Self {
        Self {
            cycle: cycle.as_secs_f64(),
            tool: Tool::of(arm),
            ..Self::default()
        }
    }

    /// Applies orders. `fresh` is whether the net thread that gave them is alive: added torques end with it. `rests`
    /// is whether the arm rests at its commanded position, `None` if it does not follow.
    pub(super) fn apply(
        &mut self,
        has: &Interfaces,
        given: &DeviceCommand,
        fresh: bool,
        rests: Option<bool>,
    ) {
        let DeviceCommand {
            words, cycle: now, ..
        } = given;
        if rests.is_none() {
            // An arm that recovers holds its position.
            self.strategy = Strategy::Position;
        }
        self.obey_strategy(has, words, rests);
        let orders = has.joint_impedance.iter().flat_map(|orders| orders.iter());
        let cycle = self.cycle;
        let laws = ARM.iter().zip(&mut self.laws);
        for ((order, (joint, law)), last) in orders.zip(laws).zip(&mut self.answers) {
            let Some(given) = order.command.read(words) else {
                continue;
            };
            law.added = 0.0;
            if fresh && given.is_in_force(*now) {
                law.added = addition(&given.value);
            }
            if !given.is_withdrawn() {
                answer(last, given.cycle, || take(law, joint, cycle, &given.value));
            }
        }
        let order = has.cartesian_impedance.as_ref();
        if let Some(given) = order.and_then(|order| order.command.read(words)) {
            self.tool.added = [0.0; 6];
            if fresh && given.is_in_force(*now) {
                self.tool.added = force(&given.value);
            }
            let tool = &mut self.tool;
            if !given.is_withdrawn() {
                answer(&mut self.tool_answer, given.cycle, || {
                    take_tool(tool, cycle, &given.value)
                });
            }
        }
    }

    fn obey_strategy(&mut self, has: &Interfaces, words: &[u64], rests: Option<bool>) {
        let order = has.strategy.as_ref();
        let given = order.and_then(|order| order.command.read(words));
        if let Some(given) = given.filter(|given| !given.is_withdrawn())
            && self.switched.is_none_or(|last| last.order != given.cycle)
        {
            let order = given.cycle;
            let error = self.switch(given.value, rests);
            self.switched = Some(Answer { order, error });
        }
    }

    fn switch(&mut self, wanted: i32, rests: Option<bool>) -> i32 {
        let Some(wanted) = Strategy::of(wanted) else {
            return error::RANGE;
        };
        match rests {
            _ if wanted == self.strategy => 0,
            None => error::NOT_ENABLED,
            Some(false) => error::MOVES,
            Some(true) if !self.admits(wanted) => error::RANGE,
            Some(true) => {
                self.strategy = wanted;
                0
            }
        }
    }

    /// Whether the present springs come to rest at the cycle.
    fn admits(&self, strategy: Strategy) -> bool {
        let stiffness_by_inertia = match strategy {
            Strategy::Position => 0.0,
            Strategy::Joints => {
                let laws = self.laws.iter().zip(&ARM);
                laws.map(|(law, joint)| law.stiffness / joint.inertia())
                    .fold(0.0, f64::max)
            }
            Strategy::Tool => stiffness_by_inertia(&self.tool.stiffness),
        };
        is_steady(stiffness_by_inertia, self.cycle)
    }

    /// Joint torques, Nm, from commanded and measured positions; `ends` are the smallest and largest position of each
    /// joint, rad. `None` in position control.
    pub(super) fn torques(
        &self,
        commanded: &Motions,
        measured: &Motions,
        ends: &[(f64, f64); 5],
    ) -> Option<[f64; 5]> {
        let mut torques = match self.strategy {
            Strategy::Position => return None,
            Strategy::Joints => std::array::from_fn(|n| {
                let ([to, wanted], [at, speed]) = (commanded[n], measured[n]);
                self.laws[n].torque(&ARM[n], to - at, wanted - speed)
            }),
            Strategy::Tool => self.tool.torques(commanded, measured),
        };
        let joints = measured.map(|[at, _]| at);
        for (n, weight) in holding(&joints).into_iter().enumerate() {
            // Only the push of a spring is limited near the end of the range. Gravity compensation stays on.
            torques[n] = before_end(torques[n], joints[n], ends[n]) + weight;
        }
        Some(torques)
    }

    pub(super) fn report(&self, has: &Interfaces, signals: &mut [u64]) {
        if let Some(order) = &has.strategy {
            order.answer.report(signals, self.switched);
        }
        let orders = has.joint_impedance.iter().flat_map(|orders| orders.iter());
        for (order, answer) in orders.zip(self.answers) {
            order.answer.report(signals, answer);
        }
        if let Some(order) = &has.cartesian_impedance {
            order.answer.report(signals, self.tool_answer);
        }
    }
}

/// Handles an order that was not answered yet.
fn answer(last: &mut Option<Answer>, order: u64, take: impl FnOnce() -> bool) {
    if last.is_none_or(|last| last.order != order) {
        let error = if take() { 0 } else { error::RANGE };
        *last = Some(Answer { order, error });
    }
}

/// A torque without the part that would push a joint into the end of its range.
fn before_end(torque: f64, at: f64, (low, high): (f64, f64)) -> f64 {
    if (at < low + END && torque < 0.0) || (at > high - END && torque > 0.0) {
        0.0
    } else {
        torque
    }
}

/// The value to add, if finite.
fn addition(wanted: &JointImpedance) -> f64 {
    let torque = wanted.torque.filter(|torque| torque.is_finite());
    torque.unwrap_or(0.0)
}

/// The same for the tool: all components or none.
fn force(wanted: &CartesianImpedance) -> [f64; 6] {
    let wrench = wanted.wrench.as_ref().map(axes);
    let wrench = wrench.filter(|wrench| wrench.iter().all(|value| value.is_finite()));
    wrench.unwrap_or_default()
}

/// Whether springs of so much stiffness for their inertia, 1/s², come to rest.
fn is_steady(stiffness_by_inertia: f64, cycle: f64) -> bool {
    stiffness_by_inertia.sqrt() * cycle <= SWING_MAX
}

fn take_tool(tool: &mut Tool, cycle: f64, wanted: &CartesianImpedance) -> bool {
    let or = |wanted: &Option<Wrench>, now| wanted.as_ref().map_or(now, axes);
    let stiffness = or(&wanted.stiffness, tool.stiffness);
    let damping = or(&wanted.damping, tool.damping);
    let within = |values: [f64; 6], most| values.iter().all(|value| (0.0..=most).contains(value));
    let possible = within(stiffness, TOOL_STIFFNESS_MAX)
        && within(damping, 1.0)
        && or(&wanted.wrench, [0.0; 6]).iter().all(|v| v.is_finite())
        && is_steady(stiffness_by_inertia(&stiffness), cycle);
    if possible {
        (tool.stiffness, tool.damping) = (stiffness, damping);
    }
    possible
}

fn take(law: &mut Impedance, joint: &JointGeometry, cycle: f64, wanted: &JointImpedance) -> bool {
    let stiffness = wanted.stiffness.unwrap_or(law.stiffness);
    let damping = wanted.damping.unwrap_or(law.damping);
    let torque_max = wanted.torque_max.unwrap_or(law.torque_max);
    let possible = (0.0..=STIFFNESS_MAX).contains(&stiffness)
        && (0.0..=1.0).contains(&damping)
        && torque_max.is_finite()
        && wanted.torque.is_none_or(f64::is_finite)
        && is_steady(stiffness / joint.inertia(), cycle);
    if possible {
        (law.stiffness, law.damping, law.torque_max) = (stiffness, damping, torque_max);
    }
    possible
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::youbot::describe::ARM_PARTS;
    use takt_core::device::{Part, parts};
    use takt_net::device::{Layout, Words};

    /// s.
    const MS: f64 = 1e-3;

    fn limits() -> [(f64, f64); 5] {
        [(0.0, 5.9), (0.0, 2.7), (-5.2, 0.0), (0.0, 3.6), (0.0, 5.8)]
    }

    /// What a net's primitive leaves for the first joint in a cycle: two stamps before what it wants.
    fn given(layout: Layout, cycle: u64, wanted: JointImpedance) -> DeviceCommand {
        let mut given = DeviceCommand::new(layout.commands);
        given.cycle = cycle;
        (given.words[1], given.words[2]) = (cycle, 1);
        wanted.put_words(|i, word| given.words[3 + i] = word);
        given
    }

    #[test]
    fn youbot_added_torque_ends_with_net_and_thread() {
        let mut layout = Layout::default();
        let has = parts::lay(&[Part::JointImpedance], 5, &mut layout);
        let torque = |torque| JointImpedance {
            torque: Some(torque),
            ..JointImpedance::default()
        };
        let mut springs = Springs::default();
        let mut added = |given: &DeviceCommand, fresh| {
            springs.apply(&has, given, fresh, Some(true));
            springs.laws[0].added
        };
        let mut held = given(layout, 5, torque(2.0));
        assert!((added(&held, true) - 2.0).abs() < 1e-9);
        assert!(added(&held, false).abs() < 1e-9, "its thread is stalled");
        held.cycle = 6;
        assert!(added(&held, true).abs() < 1e-9, "it ended");
        let no_number = given(layout, 7, torque(f64::NAN));
        assert!(added(&no_number, true).abs() < 1e-9);
    }

    #[test]
    fn youbot_strategy_changes_only_at_rest() {
        use Strategy::{Joints, Position, Tool};
        for (before, wanted, rests, error, after) in [
            (Position, 1, Some(true), 0, Joints),
            (Position, 2, Some(true), 0, Tool),
            (Tool, 1, Some(true), 0, Joints),
            (Joints, 0, Some(true), 0, Position),
            (Position, 1, Some(false), error::MOVES, Position),
            (Joints, 2, Some(false), error::MOVES, Joints),
            (Position, 2, None, error::NOT_ENABLED, Position),
            (Joints, 1, Some(false), 0, Joints),
            (Position, 3, Some(true), error::RANGE, Position),
            (Position, -1, Some(true), error::RANGE, Position),
        ] {
            let mut springs = Springs {
                strategy: before,
                ..Springs::default()
            };
            assert_eq!(springs.switch(wanted, rests), error, "{wanted} {rests:?}");
            assert_eq!(springs.strategy, after);
            assert_eq!(Strategy::of(after as i32), Some(after));
        }
    }

    #[test]
    fn youbot_tool_parameters_out_of_range_are_ignored() {
        let wrench = |force: f64, torque: f64| Wrench {
            force: [force; 3].into(),
            torque: [torque; 3].into(),
        };
        let mut tool = Tool::default();
        let before = tool.clone();
        for (stiffness, damping) in [
            (wrench(-1.0, 5.0), wrench(0.5, 0.5)),
            (wrench(50.0, 10_001.0), wrench(0.5, 0.5)),
            (wrench(f64::NAN, 5.0), wrench(0.5, 0.5)),
            (wrench(50.0, 5.0), wrench(0.5, 1.1)),
        ] {
            let wanted = CartesianImpedance {
                stiffness: Some(stiffness),
                damping: Some(damping),
                wrench: None,
            };
            assert!(!take_tool(&mut tool, MS, &wanted));
            assert_eq!(tool, before);
        }
        let wanted = CartesianImpedance {
            stiffness: Some(wrench(80.0, 8.0)),
            ..CartesianImpedance::default()
        };
        assert!(take_tool(&mut tool, MS, &wanted));
        assert_eq!(
            tool.damping.map(f64::to_bits),
            before.damping.map(f64::to_bits)
        );
        assert!((tool.stiffness[0] - 80.0).abs() < 1e-9);
    }

    #[test]
    fn youbot_soft_joints_carry_arm_avoid_range_ends() {
        let springs = Springs {
            strategy: Strategy::Joints,
            ..Springs::default()
        };
        let ends = limits();
        let flat = [1.0, 2.5, -2.5, 1.8, 1.0].map(|at| [at, 0.0]);
        let torques = springs.torques(&flat, &flat, &ends).unwrap();
        let weight = holding(&flat.map(|[at, _]| at));
        for (torque, weight) in torques.iter().zip(weight) {
            assert!((torque - weight).abs() < 1e-9, "{torque} {weight}");
        }
        assert!(torques[1] < -5.0, "{torques:?}");
        for (at, pushed) in [(0.05, false), (0.2, true)] {
            let (mut commanded, mut measured) = (flat, flat);
            (commanded[0][0], measured[0][0]) = (0.0, at);
            let torques = springs.torques(&commanded, &measured, &ends).unwrap();
            assert_eq!(torques[0] < 0.0, pushed, "at {at} rad");
            // Off the end it always is.
            (commanded[0][0], measured[0][0]) = (1.0, at);
            let torques = springs.torques(&commanded, &measured, &ends).unwrap();
            assert!(torques[0] > 0.0);
        }
        assert!(Springs::default().torques(&flat, &flat, &ends).is_none());
        // At the upper end of the elbow, and its weight pulls down.
        let folded = [1.0, 2.5, -0.05, 1.79, 1.0].map(|at| [at, 0.0]);
        let torques = springs.torques(&folded, &folded, &ends).unwrap();
        let weight = holding(&folded.map(|[at, _]| at));
        assert!(weight[2] > 1.0, "{weight:?}");
        assert!((torques[2] - weight[2]).abs() < 1e-9, "{torques:?}");
    }

    #[test]
    fn youbot_joint_parameters_out_of_range_are_ignored() {
        let mut law = Impedance::default();
        let before = law;
        for (stiffness, damping) in [(-1.0, 0.5), (1001.0, 0.5), (f64::NAN, 0.5), (1.0, 1.1)] {
            let wanted = JointImpedance {
                stiffness: Some(stiffness),
                damping: Some(damping),
                ..JointImpedance::default()
            };
            assert!(!take(&mut law, &ARM[0], MS, &wanted));
            assert_eq!(law, before);
        }
        let wanted = JointImpedance {
            stiffness: Some(12.0),
            ..JointImpedance::default()
        };
        assert!(take(&mut law, &ARM[0], MS, &wanted));
        assert!((law.stiffness - 12.0).abs() < 1e-9 && (law.damping - before.damping).abs() < 1e-9);
    }

    /// A joint with its spring, whose torque acts two cycles after the position that it answers: how far it swings from the fourth to
    /// the fifth second after it was 0.1 rad away, rad.
    fn swing(law: &Impedance, joint: &JointGeometry, cycle: f64) -> f64 {
        let (mut at, mut speed, mut late) = (0.1_f64, 0.0_f64, [0.0; 2]);
        let (mut now, mut most) = (0.0, 0.0_f64);
        while now < 5.0 {
            let torque = law.torque(joint, -at, -speed);
            let [acting, next] = late;
            late = [next, torque];
            // Held for the cycle.
            let acceleration = acting / joint.inertia();
            at = (at + speed * cycle + acceleration * cycle * cycle / 2.0).clamp(-9.0, 9.0);
            speed += acceleration * cycle;
            now += cycle;
            if now > 4.0 {
                most = most.max(at.abs());
            }
        }
        most
    }

    #[test]
    fn youbot_springs_that_cycle_cannot_calm_are_refused() {
        for joint in &ARM {
            for cycle in [1e-3, 2e-3, 4e-3, 10e-3] {
                let most = (SWING_MAX / cycle).powi(2) * joint.inertia();
                let order = |stiffness: f64| JointImpedance {
                    stiffness: Some(stiffness),
                    damping: Some(0.7),
                    ..JointImpedance::default()
                };
                let mut law = Impedance::default();
                if most < STIFFNESS_MAX {
                    assert!(take(&mut law, joint, cycle, &order(most * 0.999)), "{most}");
                    assert!(
                        !take(&mut law, joint, cycle, &order(most * 1.001)),
                        "{most}"
                    );
                }
                let of = |stiffness| Impedance { stiffness, ..law };
                assert!(
                    swing(&of(most), joint, cycle) < 1e-3,
                    "{most} Nm/rad, {cycle} s"
                );
                assert!(
                    swing(&of(most * 6.0), joint, cycle) > 0.1,
                    "{most} Nm/rad, {cycle} s"
                );
            }
        }
        let stiff = |force: f64| CartesianImpedance {
            stiffness: Some(Wrench {
                force: [force; 3].into(),
                torque: [force / 10.0; 3].into(),
            }),
            ..CartesianImpedance::default()
        };
        for (force, cycle, is_taken) in [
            (1000.0, 1e-3, true),
            (1000.0, 4e-3, false),
            (200.0, 4e-3, true),
            (10_000.0, 1e-3, false),
        ] {
            let taken = take_tool(&mut Tool::default(), cycle, &stiff(force));
            assert_eq!(taken, is_taken, "{force} N/m, {cycle} s");
        }
        // Those that no net has ordered are refused with their strategy.
        for (cycle, error) in [(4, 0), (20, error::RANGE)] {
            for strategy in [Strategy::Joints, Strategy::Tool] {
                let cycle = Duration::from_millis(cycle);
                let mut springs = Springs::of(YouBot::default(), cycle);
                let said = springs.switch(strategy as i32, Some(true));
                assert_eq!(said, error, "{strategy:?} {cycle:?}");
            }
        }
    }

    #[test]
    fn youbot_arm_not_following_becomes_stiff() {
        let mut layout = Layout::default();
        let has = parts::lay(&ARM_PARTS, 5, &mut layout);
        let mut springs = Springs {
            strategy: Strategy::Tool,
            ..Springs::default()
        };
        let given = DeviceCommand::new(layout.commands);
        springs.apply(&has, &given, true, Some(true));
        assert_eq!(springs.strategy, Strategy::Tool);
        springs.apply(&has, &given, true, None);
        assert_eq!(springs.strategy, Strategy::Position);
    }
}
