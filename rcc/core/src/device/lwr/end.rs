//! Our end of the connection to a KRC, as the driver of FRI arms sees it: the session, and what nets ordered
//! beside positions. It makes no thread and opens no socket.

use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer};
use takt_fri::error::DecodeError;
use takt_fri::guard::{Guard, Violation};
use takt_fri::lwr::wire::{Control, Krl, Msr, Quality};
use takt_fri::lwr::{JOINT_NAMES, Phase, Session, SessionConfig};
use takt_net::device::{Interfaces, Io};
use takt_net::value::Wrench;

use super::impedance::{Impedance, Standing};
use super::program::Program;
use super::{TORQUE_MAX, WRENCH_MAX};
use crate::device::DeviceStatus;
use crate::device::config::OutputsOnEnd;
use crate::device::fri::orders::from_wire;
use crate::device::fri::{Heard, Joints, Orders, Protocol, Totals, guard};

/// The session with a KRC, and orders to it.
#[derive(Debug)]
pub struct End {
    session: Session,
    program: Program,
    impedance: Impedance,
    guard: Guard,
    /// User data as it goes out.
    krl: Krl,
    on_end: OutputsOnEnd,
}

impl End {
    /// Nothing heard yet. `handshake` is the convention by which the KRL program takes orders, if it does.
    #[must_use]
    pub fn new(handshake: Option<takt_fri::lwr::Protocol>) -> Self {
        let limits = super::describe("").limits;
        let guard = guard(JOINT_NAMES, &limits, TORQUE_MAX, WRENCH_MAX);
        let config = SessionConfig {
            guard,
            ..SessionConfig::default()
        };
        Self {
            session: Session::new(config),
            program: Program::new(handshake),
            impedance: Impedance::default(),
            guard,
            krl: Krl::default(),
            on_end: OutputsOnEnd::default(),
        }
    }

    /// The same with what becomes of outputs when the net that wrote them ends.
    #[must_use]
    pub fn on_end(mut self, on_end: OutputsOnEnd) -> Self {
        self.on_end = on_end;
        self
    }

    fn standing(&self) -> Standing {
        let control = self.session.measurement().map(|msr| msr.robot.control);
        Standing {
            phase: self.session.phase(),
            control: control.unwrap_or(Control::Unspecified),
            flags: self.session.flags(),
        }
    }

    /// Sets the user data that nets command, but for what the handshake uses.
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

    /// Tells the user data of both directions; nothing while the robot is silent.
    fn read(&self, io: &Io, signals: &mut [u64]) {
        let is_silent = self.session.phase() == Phase::Offline;
        let heard = self.session.measurement().filter(|_| !is_silent);
        for (index, input) in (0..).zip(io.bool_in.iter()) {
            input.report(signals, heard.map(|msr| msr.krl.bool(index)));
        }
        for (at, input) in io.real_in.iter().enumerate() {
            let value = heard.and_then(|msr| msr.krl.real.get(at));
            input.report(signals, value.map(|value| f64::from(*value)));
        }
        for (index, output) in (0..).zip(io.bool_out.iter()) {
            let sent = heard.map(|_| self.krl.bool(index));
            output.state.report(signals, sent);
        }
        for (output, sent) in io.real_out.iter().zip(self.krl.real) {
            let sent = heard.map(|_| f64::from(sent));
            output.state.report(signals, sent);
        }
    }
}

impl Protocol for End {
    type Quality = Quality;

    fn hear(&mut self, datagram: &[u8], at: Duration) -> Result<Heard, DecodeError> {
        let reception = self.session.handle_datagram(datagram, at)?;
        let heard = Heard::of(reception.order, reception.lost);
        if heard.is_first {
            self.program.handle_silence(&mut self.krl);
        }
        Ok(heard)
    }

    fn observer(&self) -> Observer {
        Observer::lwr()
    }

    fn measurement(&self, at: Duration) -> Option<Measurement> {
        let heard = self.session.measurement();
        heard.map(|msr| Measurement::lwr(at, msr))
    }

    fn sent_sequence(&self) -> u32 {
        self.session.sent_sequence().into()
    }

    fn check(&self, joints: &Joints) -> Result<(), Violation> {
        self.session.check_joints(joints)
    }

    fn violation(&self) -> Option<Violation> {
        self.session
            .violation()
            .or_else(|| self.impedance.violation())
    }

    fn hear_nothing(&mut self, now: Duration) -> bool {
        let is_gone = self.session.handle_timeout(now);
        if is_gone {
            self.program.handle_silence(&mut self.krl);
        }
        is_gone
    }

    fn is_due(&self) -> bool {
        self.session.is_pending()
    }

    fn obey(&mut self, has: &Interfaces, orders: &Orders<'_>) {
        if let Some(io) = &has.io {
            self.write(io, orders);
        }
        let heard = (self.session.phase(), self.session.measurement());
        self.program.turn(has, orders, heard, &mut self.krl);
        *self.session.krl_mut() = self.krl;
        let standing = self.standing();
        let taken = (self.session.fields_mut(), &self.guard);
        self.impedance.obey(has, orders, &standing, taken);
        // Refused in command mode: then the answers keep the fields with which it was entered.
        let _in_command = self.session.choose(self.impedance.chosen());
    }

    fn report(&self, has: &Interfaces, signals: &mut [u64]) {
        self.program.report(has, signals);
        self.impedance.report(has, signals);
        if let Some(io) = &has.io {
            self.read(io, signals);
        }
    }

    fn reply(&mut self, joints: &Joints, buffer: &mut [u8]) -> Option<usize> {
        self.session.answer(Some(joints), buffer).ok()
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
        let heard = self.session.measurement();
        heard.map(|msr| msr.measured_joints.map(f64::from))
    }

    fn external_torques(&self) -> Option<Joints> {
        let heard = self.session.measurement();
        heard.map(|msr| msr.external_torque.map(f64::from))
    }

    fn measured_torques(&self) -> Option<Joints> {
        let heard = self.session.measurement();
        heard.map(|msr| msr.measured_torque.map(f64::from))
    }

    fn wrench(&self) -> Option<Wrench> {
        let heard = self.session.measurement();
        heard.map(|msr| from_wire(msr.external_wrench.map(f64::from)))
    }

    fn cycle(&self) -> Option<Duration> {
        self.session.period()
    }

    fn quality_code(&self) -> i32 {
        let heard = self.session.measurement();
        let quality = heard.map(|msr| msr.interface.quality.code());
        quality.unwrap_or_default().into()
    }

    fn quality(code: i32) -> Quality {
        Quality::from(u16::try_from(code).unwrap_or_default())
    }

    fn totals(&self) -> Totals {
        let counters = self.session.counters();
        Totals {
            received: counters.received,
            lost: counters.lost,
            malformed: counters.malformed,
        }
    }
}
