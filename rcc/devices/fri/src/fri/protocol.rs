//! Interface between the FRI driver and a session of either generation. It moves no bytes.

use std::fmt;
use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer};
use takt_fri::error::DecodeError;
use takt_fri::guard::{Guarded, Violation};
use takt_fri::lwr::Order;
use takt_fri::sunrise::IoError;
use takt_fri::sunrise::wire::Name;
use takt_net::device::Interfaces;
use takt_net::value::Wrench;

use super::orders::Orders;
use takt_core::device::DeviceStatus;

/// Joints of every arm that speaks FRI.
pub const AXES: usize = 7;

/// A received datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reception {
    /// Whether it is newer than those before it; otherwise it is ignored.
    pub is_new: bool,
    /// Number of measurements lost before it.
    pub lost: u16,
    /// Whether it is the first, the first after silence, or the first of a restarted controller: earlier commands
    /// mean nothing to it.
    pub is_first: bool,
}

impl Reception {
    /// From its order in the controller's sequence.
    pub(crate) fn of(order: Order, lost: u16) -> Self {
        let is_first = match order {
            Order::First | Order::Restart => true,
            Order::Next { .. } | Order::Duplicate | Order::Old => false,
        };
        Self {
            is_new: order.is_new(),
            lost,
            is_first,
        }
    }
}

/// Totals of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Measurements received.
    pub received: u64,
    /// Measurements lost.
    pub lost: u64,
    /// Malformed datagrams.
    pub malformed: u64,
}

/// An output of the controller that cannot be written as nets command it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefusedOutput {
    /// Its name.
    pub name: Name,
    /// Why it is not written.
    pub error: IoError,
}

impl fmt::Display for RefusedOutput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "output `{}` is not written: {}", self.name, self.error)
    }
}

/// A value of each joint.
pub type Joints = [f64; AXES];

/// A session of either generation, as the driver sees it.
pub trait Protocol: fmt::Debug + Send + 'static {
    /// The controller's rating of the connection.
    type Quality: Copy + fmt::Debug + PartialEq;

    /// Names of the qualities, by code.
    const QUALITIES: &'static [&'static str];

    /// Names of the session states, by code.
    const STATES: &'static [&'static str];

    /// Handles a datagram that arrived `at`.
    ///
    /// # Errors
    /// If it is malformed.
    fn receive(&mut self, datagram: &[u8], at: Duration) -> Result<Reception, DecodeError>;

    /// A new observer of this protocol.
    fn observer(&self) -> Observer;

    /// The newest measurement, which arrived `at`, for observers; `None` before the first.
    fn measurement(&self, at: Duration) -> Option<Measurement>;

    /// Sequence number of the last answer.
    fn sent_sequence(&self) -> u32;

    /// Why the last answer held the robot or added nothing; `None` if it carried what was commanded.
    fn violation(&self) -> Option<Violation>;

    /// An output whose commands are refused since it was last asked for; `None` if there is none. It stays until
    /// [`confirm_refused_output`](Self::confirm_refused_output).
    fn refused_output(&self) -> Option<RefusedOutput> {
        None
    }

    /// The output that [`refused_output`](Self::refused_output) returned was reported.
    fn confirm_refused_output(&mut self) {}

    /// Handles the time `now` without a datagram; returns whether the controller was lost just now.
    fn handle_silence(&mut self, now: Duration) -> bool;

    /// Whether the controller waits for an answer.
    fn is_due(&self) -> bool;

    /// Applies orders of nets besides positions; they are sent with the next answers as far as the robot accepts them
    /// now.
    fn apply(&mut self, has: &Interfaces, orders: &Orders<'_>);

    /// Reports the answers to orders, and the robot's inputs and outputs.
    fn report(&self, has: &Interfaces, signals: &mut [u64]);

    /// Writes the answer with these positions, rad; `None` if none is due. If the guard rejects them, it carries those of
    /// `brake`, or holds the robot.
    fn reply(
        &mut self,
        joints: &Joints,
        brake: &mut dyn FnMut() -> Joints,
        buffer: &mut [u8],
    ) -> Option<Guarded>;

    /// Status of the robot.
    fn status(&self) -> DeviceStatus;

    /// Positions that the next answer may carry without a jump, rad.
    fn rest(&self) -> Joints;

    /// The robot's own set-point, rad; `None` before the first measurement.
    fn set_point(&self) -> Option<Joints>;

    /// Measured positions, rad; `None` before the first measurement.
    fn measured(&self) -> Option<Joints>;

    /// External joint torques, estimated by the controller, Nm.
    fn external_torques(&self) -> Option<Joints>;

    /// Torques measured at the joints, Nm.
    fn measured_torques(&self) -> Option<Joints>;

    /// Force and torque at the tool, if the controller reports them; otherwise the driver estimates them from
    /// external torques.
    fn wrench(&self) -> Option<Wrench>;

    /// Time between measurements; `None` before the first.
    fn cycle(&self) -> Option<Duration>;

    /// Code of the last reported quality.
    fn quality_code(&self) -> i32;

    /// Code of the last reported session state.
    fn state_code(&self) -> i32;

    /// The quality of a code.
    fn quality(code: i32) -> Self::Quality;

    /// Totals so far.
    fn totals(&self) -> Totals;
}
