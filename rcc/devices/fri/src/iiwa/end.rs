//! The session with a Sunrise cabinet as the FRI driver uses it, with the orders of nets besides positions. Orders
//! that the overlay of the robot program does not support are refused, not emulated.

use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer};
use takt_fri::error::DecodeError;
use takt_fri::guard::{Guard, Guarded, Violation};
use takt_fri::sunrise::wire::{CommandMode, ControlMode, MonitorData, Quality};
use takt_fri::sunrise::{
    AXES, Demand, IoLevel, JOINT_NAMES, Phase, Session, SessionConfig, Withheld,
};
use takt_net::JointLimits;
use takt_net::device::{Answer, CartesianImpedance, Interfaces, Io, JointImpedance};
use takt_net::value::Wrench;

use crate::config::{IiwaIo, IiwaModel};
use crate::fri::orders::{Gate, answer, error, first, from_wire, to_wire};
use crate::fri::{Joints, Orders, Protocol, Reception, RefusedOutput, Totals, guard};
use crate::payload::Weight;

use super::refusals::Refusals;
use takt_core::device::DeviceStatus;
use takt_core::device::on_end::OutputsOnEnd;

/// The session with a cabinet and its orders.
#[derive(Debug)]
pub struct End {
    session: Session,
    guard: Guard,
    /// Why the last answer held the robot.
    violation: Option<Violation>,
    /// The guard violation of added torques or wrenches.
    beyond: Option<Violation>,
    /// Added joint torques, Nm.
    torque: Joints,
    torque_gates: [Gate; AXES],
    /// Added wrench at the tool, in wire order, N and Nm.
    wrench: [f64; 6],
    wrench_gate: Gate,
    answers: Answers,
    io: IiwaIo,
    outputs: Refusals,
    on_end: OutputsOnEnd,
    /// Of a payload that the cabinet does not know of, and its torques now, Nm.
    weight: Option<Weight>,
    held: Joints,
}

/// Answers to the last orders.
#[derive(Debug, Default)]
struct Answers {
    strategy: Option<Answer>,
    joints: [Option<Answer>; AXES],
    cartesian: Option<Answer>,
}

impl End {
    /// A session without data.
    #[must_use]
    pub fn new(model: IiwaModel, io: IiwaIo) -> Self {
        let (torque_max, wrench_max) = (super::torque_max(model), super::wrench_max(model));
        let limits = super::describe("", model).limits;
        let guard = guard(JOINT_NAMES, &limits, torque_max, wrench_max);
        let config = SessionConfig {
            guard,
            ..SessionConfig::default()
        };
        Self {
            session: Session::new(config),
            guard,
            violation: None,
            beyond: None,
            torque: [0.0; AXES],
            torque_gates: [Gate::default(); AXES],
            wrench: [0.0; 6],
            wrench_gate: Gate::default(),
            answers: Answers::default(),
            outputs: Refusals::new(&io),
            io,
            on_end: OutputsOnEnd::default(),
            weight: None,
            held: [0.0; AXES],
        }
    }

    /// Narrows the guard to these limits of the joints.
    pub(super) fn within(mut self, limits: &[JointLimits]) -> Self {
        let Guard {
            torque_nm, wrench, ..
        } = self.guard;
        self.guard = guard(JOINT_NAMES, limits, torque_nm, wrench);
        self.session = Session::new(SessionConfig {
            guard: self.guard,
            ..SessionConfig::default()
        });
        self
    }

    /// Holds the weight of a payload by an overlay of torques.
    pub(super) fn carrying(mut self, weight: Option<Weight>) -> Self {
        self.weight = weight;
        self
    }

    /// The torques that hold the payload now.
    fn hold_weight(&mut self, now: Duration) {
        let follows = self.session.phase() == Phase::CommandingActive
            && self.session.command_mode() == CommandMode::Torque
            && self.session.is_engaged();
        let measured = self.measured();
        if let Some(weight) = &mut self.weight {
            self.held = weight.torques(measured, follows, now, &self.guard.torque_nm);
        }
    }

    /// The torques that nets add and those that hold the payload; the guard's limit holds for both together.
    fn added(&self) -> Joints {
        std::array::from_fn(|axis| {
            let most = self.guard.torque_nm[axis];
            (self.torque[axis] + self.held[axis]).max(-most).min(most)
        })
    }

    /// Sets the output policies at the end of a net.
    #[must_use]
    pub fn on_end(mut self, on_end: OutputsOnEnd) -> Self {
        self.on_end = on_end;
        self
    }

    fn monitor(&self) -> Option<&MonitorData> {
        self.session.message()?.monitor.as_ref()
    }

    /// Checks added values by a guard and notes a violation.
    fn admits(&mut self, verdict: Result<(), Violation>) -> bool {
        self.beyond = self.beyond.or_else(|| verdict.err());
        verdict.is_ok()
    }

    /// Whether the overlay supports what only one command mode carries.
    fn verdict(&self, needed: CommandMode) -> i32 {
        match self.session.phase() {
            Phase::Offline | Phase::Idle => error::NOT_THERE,
            Phase::MonitoringWait | Phase::MonitoringReady | Phase::CommandingWait => {
                error::NOT_NOW
            }
            Phase::CommandingActive if self.session.command_mode() == needed => error::NONE,
            Phase::CommandingActive => error::IMPOSSIBLE,
        }
    }

    /// The robot program determines the strategy: an order for the current one succeeds, others are impossible.
    fn take_strategy(&self, wanted: i32) -> i32 {
        let message = self.session.message();
        let in_force = message
            .and_then(|message| message.robot)
            .and_then(|robot| robot.control_mode)
            .and_then(number);
        match self.session.phase() {
            _ if !(1..=3).contains(&wanted) => error::RANGE,
            Phase::Offline | Phase::Idle => error::NOT_THERE,
            Phase::MonitoringWait
            | Phase::MonitoringReady
            | Phase::CommandingWait
            | Phase::CommandingActive => {
                if in_force == Some(wanted) {
                    error::NONE
                } else {
                    error::IMPOSSIBLE
                }
            }
        }
    }

    fn take_joint(
        &mut self,
        axis: usize,
        wanted: &JointImpedance,
        (in_force, follows): (bool, bool),
    ) -> i32 {
        let torque = wanted.torque.filter(|_| in_force).unwrap_or(0.0);
        let fits = self.admits(self.guard.check_torque_of(axis, torque));
        let ([torque], refused) = self.torque_gates[axis].pass([torque], fits, follows);
        self.torque[axis] = torque;
        let is_fixed = wanted.stiffness.is_some()
            || wanted.damping.is_some()
            || wanted.torque_max.is_some_and(|torque| torque > 0.0);
        let needed = match wanted.torque {
            Some(_) => self.verdict(CommandMode::Torque),
            None => error::NONE,
        };
        verdict(refused, is_fixed, needed)
    }

    fn take_cartesian(
        &mut self,
        wanted: &CartesianImpedance,
        (in_force, follows): (bool, bool),
    ) -> i32 {
        let wrench = to_wire(&wanted.wrench.filter(|_| in_force).unwrap_or_default());
        let fits = self.admits(self.guard.check_wrench(&wrench));
        let (added, refused) = self.wrench_gate.pass(wrench, fits, follows);
        self.wrench = added;
        let is_fixed = wanted.stiffness.is_some() || wanted.damping.is_some();
        let needed = match wanted.wrench {
            Some(_) => self.verdict(CommandMode::Wrench),
            None => error::NONE,
        };
        verdict(refused, is_fixed, needed)
    }

    /// Writes the outputs that nets command. One that the robot program does not share, or shares with another type, is
    /// reported; its state stays null.
    fn write(&mut self, io: &Io, orders: &Orders<'_>) {
        if self.session.phase() == Phase::Offline {
            return;
        }
        let outputs = self.io.bool_out.iter().zip(io.bool_out.iter());
        for (port, (name, output)) in outputs.enumerate() {
            let given = output.command.read(orders.words);
            if let Some(value) = self.on_end.truth(port, given) {
                let written = self.session.write(name, IoLevel::Boolean(value));
                self.outputs.note(port, written);
            }
        }
        let outputs = self.io.real_out.iter().zip(io.real_out.iter());
        for (port, (name, output)) in outputs.enumerate() {
            let given = output.command.read(orders.words);
            if let Some(value) = self.on_end.number(port, given) {
                let written = self.session.write_number(name, value);
                self.outputs.note(self.io.bool_out.len() + port, written);
            }
        }
    }

    fn read(&self, io: &Io, signals: &mut [u64]) {
        let is_silent = self.session.phase() == Phase::Offline;
        let level = |name: &String| self.session.read(name).filter(|_| !is_silent);
        let truth = |name| level(name).and_then(truth);
        let real = |name| level(name).and_then(real);
        for (name, input) in self.io.bool_in.iter().zip(io.bool_in.iter()) {
            input.report(signals, truth(name));
        }
        for (name, input) in self.io.real_in.iter().zip(io.real_in.iter()) {
            input.report(signals, real(name));
        }
        for (name, output) in self.io.bool_out.iter().zip(io.bool_out.iter()) {
            output.state.report(signals, truth(name));
        }
        for (name, output) in self.io.real_out.iter().zip(io.real_out.iter()) {
            output.state.report(signals, real(name));
        }
    }
}

/// The first error of an order: its values, stiffness and damping (not carried by Sunrise FRI), what the overlay does
/// not support, and what must be requested again.
fn verdict(refused: i32, is_fixed: bool, needed: i32) -> i32 {
    let range = if refused == error::RANGE {
        refused
    } else {
        error::NONE
    };
    let fixed = if is_fixed {
        error::IMPOSSIBLE
    } else {
        error::NONE
    };
    first([range, fixed, needed, refused])
}

const fn truth(level: IoLevel) -> Option<bool> {
    match level {
        IoLevel::Boolean(value) => Some(value),
        IoLevel::Digital(_) | IoLevel::Analog(_) => None,
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "digital values are small counts"
)]
const fn real(level: IoLevel) -> Option<f64> {
    match level {
        IoLevel::Boolean(_) => None,
        IoLevel::Digital(value) => Some(value as f64),
        IoLevel::Analog(value) => Some(value),
    }
}

/// Number of a control mode for nets.
const fn number(mode: ControlMode) -> Option<i32> {
    match mode {
        ControlMode::Position => Some(1),
        ControlMode::CartesianImpedance => Some(2),
        ControlMode::JointImpedance => Some(3),
        ControlMode::None | ControlMode::Other(_) => None,
    }
}

/// The command for these positions in an overlay of this kind, with the added values: positions are the centre of the
/// impedance if the overlay adds a wrench or torques. `None` if positions cannot be commanded.
fn demand(mode: CommandMode, joints: &Joints, torque: Joints, wrench: [f64; 6]) -> Option<Demand> {
    let joints = Some(*joints);
    match mode {
        CommandMode::Position => joints.map(Demand::Position),
        CommandMode::Wrench => Some(Demand::Wrench { wrench, joints }),
        CommandMode::Torque => Some(Demand::Torque { torque, joints }),
        CommandMode::None | CommandMode::CartesianPose | CommandMode::Other(_) => None,
    }
}

impl Protocol for End {
    type Quality = Quality;

    const QUALITIES: &'static [&'static str] = &["poor", "fair", "good", "excellent"];
    const STATES: &'static [&'static str] = &[
        "idle",
        "monitoring wait",
        "monitoring ready",
        "commanding wait",
        "commanding active",
    ];

    /// Engages as soon as the overlay is active: the joints refuse set-points of an earlier run until they end, so
    /// only motion that is requested again starts.
    fn receive(&mut self, datagram: &[u8], at: Duration) -> Result<Reception, DecodeError> {
        let reception = self.session.handle_datagram(datagram, at)?;
        if self.session.phase() == Phase::CommandingActive && !self.session.is_engaged() {
            let _not_active = self.session.engage();
        }
        Ok(Reception::of(reception.order, reception.lost))
    }

    fn observer(&self) -> Observer {
        Observer::sunrise()
    }

    fn measurement(&self, at: Duration) -> Option<Measurement> {
        let received = self.session.message();
        received.map(|message| Measurement::sunrise(at, message))
    }

    fn sent_sequence(&self) -> u32 {
        self.session.sent_sequence()
    }

    fn violation(&self) -> Option<Violation> {
        self.violation.or(self.beyond)
    }

    fn refused_output(&self) -> Option<RefusedOutput> {
        self.outputs.next()
    }

    fn confirm_refused_output(&mut self) {
        self.outputs.confirm();
    }

    fn handle_silence(&mut self, now: Duration) -> bool {
        self.session.handle_timeout(now)
    }

    fn is_due(&self) -> bool {
        self.session.is_pending()
    }

    fn apply(&mut self, has: &Interfaces, orders: &Orders<'_>) {
        self.beyond = None;
        self.hold_weight(orders.now);
        // Answered again in each cycle, because the robot program does the switching.
        if let Some(given) = has.strategy.and_then(|it| it.command.read(orders.words)) {
            self.answers.strategy = answer(given.cycle, self.take_strategy(given.value));
        }
        let joints = has.joint_impedance.iter().flat_map(|joints| joints.iter());
        for (axis, order) in joints.take(AXES).enumerate() {
            if let Some(given) = order.command.read(orders.words) {
                let error = self.take_joint(
                    axis,
                    &given.value,
                    (orders.is_in_force(&given), orders.follows),
                );
                self.answers.joints[axis] = answer(given.cycle, error);
            }
        }
        if let Some(given) = has
            .cartesian_impedance
            .and_then(|it| it.command.read(orders.words))
        {
            let error =
                self.take_cartesian(&given.value, (orders.is_in_force(&given), orders.follows));
            self.answers.cartesian = answer(given.cycle, error);
        }
        if let Some(io) = &has.io {
            self.write(io, orders);
        }
    }

    fn report(&self, has: &Interfaces, signals: &mut [u64]) {
        if let Some(order) = &has.strategy {
            order.answer.report(signals, self.answers.strategy);
        }
        let joints = has.joint_impedance.iter().flat_map(|joints| joints.iter());
        for (order, answer) in joints.zip(self.answers.joints) {
            order.answer.report(signals, answer);
        }
        if let Some(order) = &has.cartesian_impedance {
            order.answer.report(signals, self.answers.cartesian);
        }
        if let Some(io) = &has.io {
            self.read(io, signals);
        }
    }

    fn reply(
        &mut self,
        joints: &Joints,
        brake: &mut dyn FnMut() -> Joints,
        buffer: &mut [u8],
    ) -> Option<Guarded> {
        let mode = self.session.command_mode();
        let demand = demand(mode, joints, self.added(), self.wrench);
        let demand = demand.filter(|_| self.session.is_engaged());
        let wanted = demand.unwrap_or(Demand::Hold);
        let brake = |_| Some(brake());
        let answer = self.session.answer_or_brake(&wanted, brake, buffer).ok()?;
        self.violation = match answer.withheld {
            Some(Withheld::Guard(violation)) => Some(violation),
            Some(_) | None => None,
        };
        Some(Guarded {
            len: answer.len,
            refused: answer.refused,
            is_held: demand.is_none() || answer.withheld.is_some(),
        })
    }

    fn status(&self) -> DeviceStatus {
        match self.session.phase() {
            Phase::Offline => DeviceStatus::Offline,
            Phase::Idle
            | Phase::MonitoringWait
            | Phase::MonitoringReady
            | Phase::CommandingWait => DeviceStatus::SafeOperational,
            Phase::CommandingActive => {
                let mode = self.session.command_mode();
                let follows = demand(mode, &[0.0; AXES], [0.0; AXES], [0.0; 6]).is_some();
                if follows && self.session.is_engaged() {
                    DeviceStatus::Operational
                } else {
                    DeviceStatus::SafeOperational
                }
            }
        }
    }

    fn rest(&self) -> Joints {
        self.session.mirror()
    }

    fn set_point(&self) -> Option<Joints> {
        self.session.message().map(|_| self.session.mirror())
    }

    fn measured(&self) -> Option<Joints> {
        self.monitor()?.measured
    }

    fn external_torques(&self) -> Option<Joints> {
        self.monitor()?.external_torque
    }

    fn measured_torques(&self) -> Option<Joints> {
        self.monitor()?.torque
    }

    fn wrench(&self) -> Option<Wrench> {
        self.monitor()?.external_force.map(from_wire)
    }

    fn cycle(&self) -> Option<Duration> {
        self.session.period()
    }

    fn quality_code(&self) -> i32 {
        let message = self.session.message();
        message.map_or(0, |message| message.quality().code())
    }

    fn state_code(&self) -> i32 {
        let message = self.session.message();
        message.map_or(0, |message| message.state().code())
    }

    fn quality(code: i32) -> Quality {
        Quality::from(code)
    }

    fn totals(&self) -> Totals {
        let counters = self.session.counters();
        Totals {
            received: counters.received,
            lost: counters.lost,
            malformed: counters.refused,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iiwa_wrench_beyond_guard_is_rejected() {
        let mut end = End::new(IiwaModel::Iiwa7, IiwaIo::default());
        for (force, torque, is_refused) in [
            (350.0, -110.0, false),
            (350.1, 0.0, true),
            (0.0, 110.1, true),
            (1e39, 0.0, true),
            (f64::NAN, 0.0, true),
        ] {
            let wrench = from_wire([force, 0.0, 0.0, 0.0, torque, 0.0]);
            let wanted = CartesianImpedance {
                wrench: Some(wrench),
                ..CartesianImpedance::default()
            };
            let code = end.take_cartesian(&wanted, (true, true));
            assert_eq!(code == error::RANGE, is_refused, "{force} N, {torque} Nm");
        }
    }

    #[test]
    fn iiwa_overlays_carry_joints_and_added_values() {
        let (joints, torque, wrench) = ([0.1; AXES], [1.0; AXES], [2.0; 6]);
        let with = |mode| demand(mode, &joints, torque, wrench);
        let joints = Some(joints);
        let pushed = Demand::Wrench { wrench, joints };
        let turned = Demand::Torque { torque, joints };
        assert_eq!(with(CommandMode::Wrench), Some(pushed));
        assert_eq!(with(CommandMode::Torque), Some(turned));
        let positions = joints.map(Demand::Position);
        assert_eq!(with(CommandMode::Position), positions);
        for mode in [CommandMode::None, CommandMode::CartesianPose] {
            assert_eq!(with(mode), None);
        }
    }
}
