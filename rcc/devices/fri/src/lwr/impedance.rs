//! Stiffness, damping and added torques as nets order them for joints and for the tool. The KRL program selects the
//! strategy.

use takt_fri::guard::{Guard, Violation};
use takt_fri::lwr::wire::{CmdFlags, Control};
use takt_fri::lwr::{Fields, Phase};
use takt_net::device::{Answer, CartesianImpedance, Interfaces, JointImpedance};
use takt_net::value::Wrench;

use crate::fri::orders::{Gate, answer, error, first, to_wire};
use crate::fri::{AXES, Orders};

/// Largest plausible stiffness, Nm/rad: beyond is an error of a unit.
const JOINT_STIFFNESS_MAX: f64 = 5000.0;
/// Largest plausible stiffness, N/m and Nm/rad: beyond is an error of a unit.
const CARTESIAN_STIFFNESS_MAX: f64 = 10_000.0;

/// State of the session, from which orders are answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct OrderContext {
    pub(super) phase: Phase,
    pub(super) control: Control,
    /// Fields that go out with the next answer.
    pub(super) flags: CmdFlags,
}

impl OrderContext {
    /// Whether these fields reach the robot.
    fn verdict(&self, fields: CmdFlags) -> i32 {
        match self.phase {
            Phase::Offline => error::NOT_THERE,
            Phase::Monitor | Phase::Command
                if !CmdFlags::allowed(self.control).contains(fields) =>
            {
                error::IMPOSSIBLE
            }
            // They are selected now, and take effect with the next friStart.
            Phase::Monitor => error::NONE,
            Phase::Command if self.flags.contains(fields) => error::NONE,
            Phase::Command => error::NOT_NOW,
        }
    }
}

/// Answers to orders, and the fields that they need.
#[derive(Debug)]
pub(super) struct Impedance {
    /// Fields that were ever ordered: others stay as `$STIFFNESS` sets them.
    chosen: CmdFlags,
    joints: [Option<Answer>; AXES],
    joint_gates: [Gate; AXES],
    cartesian: Option<Answer>,
    cartesian_gate: Gate,
    /// Torques and wrenches that nets add, and the guard violation.
    violation: Option<Violation>,
}

impl Default for Impedance {
    fn default() -> Self {
        Self {
            chosen: CmdFlags::JNTPOS,
            joints: [None; AXES],
            joint_gates: [Gate::default(); AXES],
            cartesian: None,
            cartesian_gate: Gate::default(),
            violation: None,
        }
    }
}

impl Impedance {
    /// The fields to select when that is possible.
    pub(super) const fn chosen(&self) -> CmdFlags {
        self.chosen
    }

    /// The guard violation of the added values.
    pub(super) const fn violation(&self) -> Option<Violation> {
        self.violation
    }

    /// Writes orders of nets to the fields of the answers, as far as the guard permits.
    pub(super) fn apply(
        &mut self,
        has: &Interfaces,
        orders: &Orders<'_>,
        context: &OrderContext,
        (fields, guard): (&mut Fields, &Guard),
    ) {
        self.violation = None;
        let joints = has.joint_impedance.iter().flat_map(|joints| joints.iter());
        for (axis, order) in joints.take(AXES).enumerate() {
            if let Some(given) = order.command.read(orders.words) {
                let request = (orders.is_in_force(&given), orders.follows);
                // Orders of an ended net are ignored; parameters in force stay.
                let none = JointImpedance::default();
                let wanted = if given.is_withdrawn() {
                    &none
                } else {
                    &given.value
                };
                let error = self.take_joint(axis, wanted, request, context, (fields, guard));
                if !given.is_withdrawn() {
                    self.joints[axis] = answer(given.cycle, error);
                }
            }
        }
        if let Some(given) = has
            .cartesian_impedance
            .and_then(|order| order.command.read(orders.words))
        {
            let request = (orders.is_in_force(&given), orders.follows);
            let none = CartesianImpedance::default();
            let wanted = if given.is_withdrawn() {
                &none
            } else {
                &given.value
            };
            let error = self.take_cartesian(wanted, request, context, (fields, guard));
            if !given.is_withdrawn() {
                self.cartesian = answer(given.cycle, error);
            }
        }
    }

    fn take_joint(
        &mut self,
        axis: usize,
        wanted: &JointImpedance,
        (in_force, follows): (bool, bool),
        context: &OrderContext,
        (fields, guard): (&mut Fields, &Guard),
    ) -> i32 {
        let torque = wanted.torque.filter(|_| in_force).unwrap_or(0.0);
        let beyond = guard.check_torque_of(axis, torque).err();
        self.violation = self.violation.or(beyond);
        let gate = &mut self.joint_gates[axis];
        let ([torque], refused) = gate.pass([torque], beyond.is_none(), follows);
        fields.joint_torque[axis] = torque;
        let is_soft = in_range(wanted.stiffness, JOINT_STIFFNESS_MAX);
        let is_damped = in_range(wanted.damping, 1.0);
        if !(is_soft && is_damped) || refused == error::RANGE {
            return error::RANGE;
        }
        let Fields {
            joint_stiffness,
            joint_damping,
            ..
        } = fields;
        joint_stiffness[axis] = wanted.stiffness.unwrap_or(joint_stiffness[axis]);
        joint_damping[axis] = wanted.damping.unwrap_or(joint_damping[axis]);
        let needed = needed([
            (wanted.stiffness.is_some(), CmdFlags::JNTSTIFF),
            (wanted.damping.is_some(), CmdFlags::JNTDAMP),
            (wanted.torque.is_some(), CmdFlags::JNTTRQ),
        ]);
        self.chosen = self.chosen | needed;
        // The strategy's parameters limit torques on this arm.
        let is_capped = wanted.torque_max.is_some_and(|torque| torque > 0.0);
        first([
            if is_capped { error::IMPOSSIBLE } else { 0 },
            context.verdict(needed),
            refused,
        ])
    }

    fn take_cartesian(
        &mut self,
        wanted: &CartesianImpedance,
        (in_force, follows): (bool, bool),
        context: &OrderContext,
        (fields, guard): (&mut Fields, &Guard),
    ) -> i32 {
        let wrench = to_wire(&wanted.wrench.filter(|_| in_force).unwrap_or_default());
        let beyond = guard.check_wrench(&wrench).err();
        self.violation = self.violation.or(beyond);
        let gate = &mut self.cartesian_gate;
        let (added, refused) = gate.pass(wrench, beyond.is_none(), follows);
        fields.wrench = added;
        let values = |wrench: Wrench| to_wire(&wrench);
        let stiffness = wanted.stiffness.map(values);
        let damping = wanted.damping.map(values);
        let fit = |values: Option<[f64; 6]>, max| {
            let mut values = values.iter().flatten();
            values.all(|value| in_range(Some(*value), max))
        };
        if refused == error::RANGE || !fit(stiffness, CARTESIAN_STIFFNESS_MAX) || !fit(damping, 1.0)
        {
            return error::RANGE;
        }
        fields.cartesian_stiffness = stiffness.unwrap_or(fields.cartesian_stiffness);
        fields.cartesian_damping = damping.unwrap_or(fields.cartesian_damping);
        let needed = needed([
            (stiffness.is_some(), CmdFlags::CARTSTIFF),
            (damping.is_some(), CmdFlags::CARTDAMP),
            (wanted.wrench.is_some(), CmdFlags::TCPFT),
        ]);
        self.chosen = self.chosen | needed;
        first([context.verdict(needed), refused])
    }

    pub(super) fn report(&self, has: &Interfaces, signals: &mut [u64]) {
        let joints = has.joint_impedance.iter().flat_map(|joints| joints.iter());
        for (order, answer) in joints.zip(self.joints) {
            order.answer.report(signals, answer);
        }
        if let Some(order) = &has.cartesian_impedance {
            order.answer.report(signals, self.cartesian);
        }
    }
}

fn needed(parts: [(bool, CmdFlags); 3]) -> CmdFlags {
    let ordered = parts.into_iter().filter(|(is_ordered, _)| *is_ordered);
    ordered.fold(CmdFlags::NONE, |all, (_, flag)| all | flag)
}

fn in_range(value: Option<f64>, max: f64) -> bool {
    value.is_none_or(|value| (0.0..=max).contains(&value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fri::orders::from_wire;

    #[test]
    fn lwr_wrench_beyond_guard_is_rejected() {
        let context = OrderContext {
            phase: Phase::Command,
            control: Control::CartesianImpedance,
            flags: CmdFlags::JNTPOS | CmdFlags::TCPFT,
        };
        for (force, torque, is_refused) in [
            (-350.0, 100.0, false),
            (350.1, 0.0, true),
            (0.0, -100.1, true),
            (1e39, 0.0, true),
            (f64::NAN, 0.0, true),
        ] {
            let mut impedance = Impedance::default();
            let guard = Guard {
                wrench: super::super::WRENCH_MAX,
                ..Guard::open(takt_fri::lwr::JOINT_NAMES)
            };
            let mut fields = Fields::default();
            let wrench = [force, 0.0, 0.0, 0.0, torque, 0.0];
            let wanted = CartesianImpedance {
                wrench: Some(from_wire(wrench)),
                ..CartesianImpedance::default()
            };
            let code =
                impedance.take_cartesian(&wanted, (true, true), &context, (&mut fields, &guard));
            assert_eq!(impedance.violation().is_some(), is_refused);
            assert_eq!(code == error::RANGE, is_refused, "{force} N, {torque} Nm");
            let sent = if is_refused { [0.0; 6] } else { wrench };
            assert_eq!(fields.wrench.map(f64::to_bits), sent.map(f64::to_bits));
        }
    }
}
