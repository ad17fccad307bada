//! The session with a KRC as the FRI driver uses it, with the orders of nets besides positions. It creates no thread
//! and opens no socket.

use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer};
use takt_fri::error::DecodeError;
use takt_fri::guard::{Guard, Guarded, Violation};
use takt_fri::lwr::wire::{CmdFlags, Control, Krl, Msr, Quality};
use takt_fri::lwr::{JOINT_NAMES, Phase, Session, SessionConfig};
use takt_net::JointLimits;
use takt_net::device::{Interfaces, Io};
use takt_net::value::Wrench;

use super::impedance::{Impedance, OrderContext};
use super::program::Program;
use super::{TORQUE_MAX, WRENCH_MAX};
use crate::fri::orders::from_wire;
use crate::fri::{AXES, Joints, Orders, Protocol, Reception, Totals, guard};
use crate::payload::Weight;
use takt_core::device::DeviceStatus;
use takt_core::device::on_end::OutputsOnEnd;

/// The session with a KRC and its orders.
#[derive(Debug)]
pub struct End {
    session: Session,
    program: Program,
    impedance: Impedance,
    guard: Guard,
    /// User data to send.
    krl: Krl,
    on_end: OutputsOnEnd,
    /// Of a payload that the KRC does not know of.
    weight: Option<Weight>,
    /// The torques that nets add, Nm.
    added: Joints,
}

impl End {
    /// A session without data. `handshake` is that of the KRL program for orders, if it has one.
    #[must_use]
    pub fn new(handshake: Option<takt_fri::lwr::Protocol>) -> Self {
        let limits = super::describe("").limits;
        let guard = guard(JOINT_NAMES, &limits, TORQUE_MAX, WRENCH_MAX);
        Self {
            session: session(guard),
            program: Program::new(handshake),
            impedance: Impedance::default(),
            guard,
            krl: Krl::default(),
            on_end: OutputsOnEnd::default(),
            weight: None,
            added: [0.0; AXES],
        }
    }

    /// Narrows the guard to these limits of the joints.
    pub(super) fn within(mut self, limits: &[JointLimits]) -> Self {
        self.guard = guard(JOINT_NAMES, limits, TORQUE_MAX, WRENCH_MAX);
        self.session = session(self.guard);
        self
    }

    /// Holds the weight of a payload in joint impedance.
    pub(super) fn carrying(mut self, weight: Option<Weight>) -> Self {
        self.weight = weight;
        self
    }

    /// Adds the weight of the payload to the torques that nets add; the guard's limit holds for both together.
    fn add_weight(&mut self, now: Duration) -> CmdFlags {
        let context = self.context();
        let measured = self.measured();
        let Some(weight) = &mut self.weight else {
            return CmdFlags::NONE;
        };
        let follows = context.phase == Phase::Command
            && context.control == Control::JointImpedance
            && context.flags.contains(CmdFlags::JNTTRQ);
        let most = &self.guard.torque_nm;
        let torques = weight.torques(measured, follows, now, most);
        let fields = self.session.fields_mut();
        let both = self.added.iter().zip(torques).zip(most);
        for (field, ((added, torque), most)) in fields.joint_torque.iter_mut().zip(both) {
            *field = (added + torque).max(-most).min(*most);
        }
        CmdFlags::JNTTRQ
    }

    /// Sets the output policies at the end of a net.
    #[must_use]
    pub fn on_end(mut self, on_end: OutputsOnEnd) -> Self {
        self.on_end = on_end;
        self
    }

    fn context(&self) -> OrderContext {
        let control = self.session.measurement().map(|msr| msr.robot.control);
        OrderContext {
            phase: self.session.phase(),
            control: control.unwrap_or(Control::Unspecified),
            flags: self.session.flags(),
        }
    }

    /// Sets the user data that nets command, except those of the handshake.
    fn write(&mut self, io: &Io, orders: &Orders<'_>) {
        for ((at, index), output) in (0_usize..).zip(0_u32..).zip(io.bool_out.iter()) {
            let wanted = self.on_end.truth(at, output.command.read(orders.words));
            if let Some(value) = wanted.filter(|_| !self.program.owns_bool(at)) {
                self.krl.set_bool(index, value);
            }
        }
        for (at, (real, output)) in self.krl.real.iter_mut().zip(io.real_out.iter()).enumerate() {
            let wanted = self.on_end.number(at, output.command.read(orders.words));
            if let Some(value) = wanted.filter(|_| !self.program.owns_real(at)) {
                *real = super::to_f32(value);
            }
        }
    }

    /// Reports the user data of both directions; null while the robot is silent.
    fn read(&self, io: &Io, signals: &mut [u64]) {
        let is_silent = self.session.phase() == Phase::Offline;
        let received = self.session.measurement().filter(|_| !is_silent);
        for (index, input) in (0..).zip(io.bool_in.iter()) {
            input.report(signals, received.map(|msr| msr.krl.bool(index)));
        }
        for (at, input) in io.real_in.iter().enumerate() {
            let value = received.and_then(|msr| msr.krl.real.get(at));
            input.report(signals, value.map(|value| f64::from(*value)));
        }
        for (index, output) in (0..).zip(io.bool_out.iter()) {
            let sent = received.map(|_| self.krl.bool(index));
            output.state.report(signals, sent);
        }
        for (output, sent) in io.real_out.iter().zip(self.krl.real) {
            let sent = received.map(|_| f64::from(sent));
            output.state.report(signals, sent);
        }
    }
}

fn session(guard: Guard) -> Session {
    Session::new(SessionConfig {
        guard,
        ..SessionConfig::default()
    })
}

impl Protocol for End {
    type Quality = Quality;

    const QUALITIES: &'static [&'static str] = &["unacceptable", "bad", "ok", "perfect"];
    const STATES: &'static [&'static str] = &["off", "monitor", "command"];

    fn receive(&mut self, datagram: &[u8], at: Duration) -> Result<Reception, DecodeError> {
        let reception = self.session.handle_datagram(datagram, at)?;
        let received = Reception::of(reception.order, reception.lost);
        if received.is_first {
            self.program.handle_silence(&mut self.krl);
        }
        Ok(received)
    }

    fn observer(&self) -> Observer {
        Observer::lwr()
    }

    fn measurement(&self, at: Duration) -> Option<Measurement> {
        let received = self.session.measurement();
        received.map(|msr| Measurement::lwr(at, msr))
    }

    fn sent_sequence(&self) -> u32 {
        self.session.sent_sequence().into()
    }

    fn violation(&self) -> Option<Violation> {
        self.session
            .violation()
            .or_else(|| self.impedance.violation())
    }

    fn handle_silence(&mut self, now: Duration) -> bool {
        let is_lost = self.session.handle_timeout(now);
        if is_lost {
            self.program.handle_silence(&mut self.krl);
        }
        is_lost
    }

    fn is_due(&self) -> bool {
        self.session.is_pending()
    }

    fn apply(&mut self, has: &Interfaces, orders: &Orders<'_>) {
        if let Some(io) = &has.io {
            self.write(io, orders);
        }
        let received = (self.session.phase(), self.session.measurement());
        self.program.turn(has, orders, received, &mut self.krl);
        *self.session.krl_mut() = self.krl;
        let context = self.context();
        let fields = self.session.fields_mut();
        fields.joint_torque = self.added;
        self.impedance
            .apply(has, orders, &context, (&mut *fields, &self.guard));
        self.added = fields.joint_torque;
        // Refused in command mode: then answers keep the fields with which it was entered.
        let chosen = self.impedance.chosen() | self.add_weight(orders.now);
        let _in_command = self.session.choose(chosen);
    }

    fn report(&self, has: &Interfaces, signals: &mut [u64]) {
        self.program.report(has, signals);
        self.impedance.report(has, signals);
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
        let brake = |_| Some(brake());
        self.session
            .answer_or_brake(Some(joints), brake, buffer)
            .ok()
    }

    fn status(&self) -> DeviceStatus {
        match self.session.phase() {
            Phase::Offline => DeviceStatus::Offline,
            Phase::Monitor => DeviceStatus::SafeOperational,
            Phase::Command => DeviceStatus::Operational,
        }
    }

    fn rest(&self) -> Joints {
        self.session.mirror()
    }

    fn set_point(&self) -> Option<Joints> {
        self.session.measurement().map(Msr::set_point)
    }

    fn measured(&self) -> Option<Joints> {
        let received = self.session.measurement();
        received.map(|msr| msr.measured_joints.map(f64::from))
    }

    fn external_torques(&self) -> Option<Joints> {
        let received = self.session.measurement();
        received.map(|msr| msr.external_torque.map(f64::from))
    }

    fn measured_torques(&self) -> Option<Joints> {
        let received = self.session.measurement();
        received.map(|msr| msr.measured_torque.map(f64::from))
    }

    fn wrench(&self) -> Option<Wrench> {
        let received = self.session.measurement();
        received.map(|msr| from_wire(msr.external_wrench.map(f64::from)))
    }

    fn cycle(&self) -> Option<Duration> {
        self.session.period()
    }

    fn quality_code(&self) -> i32 {
        let received = self.session.measurement();
        let quality = received.map(|msr| msr.interface.quality.code());
        quality.unwrap_or_default().into()
    }

    fn state_code(&self) -> i32 {
        let received = self.session.measurement();
        let state = received.map(|msr| msr.interface.state.code());
        state.unwrap_or_default().into()
    }

    fn quality(code: i32) -> Quality {
        Quality::from(u16::try_from(code).unwrap_or_default())
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
