//! What the driver of FRI arms needs of a session, whichever generation it speaks. It moves no bytes.

use std::fmt;
use std::time::Duration;

use takt_fri::diagnosis::{Measurement, Observer};
use takt_fri::error::DecodeError;
use takt_fri::guard::Violation;
use takt_fri::lwr::Order;
use takt_net::device::Interfaces;
use takt_net::value::Wrench;

use super::orders::Orders;
use crate::device::DeviceStatus;

/// Joints of every arm that speaks FRI.
pub const AXES: usize = 7;

/// A datagram that was heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heard {
    /// Whether it is newer than those before it; else it means nothing.
    pub is_new: bool,
    /// Measurements lost since the one before.
    pub lost: u16,
    /// Whether it is the first, the first after silence, or of a controller that began anew: nothing that was commanded
    /// before means anything to it.
    pub is_first: bool,
}

impl Heard {
    /// By its place in the controller's sequence.
    pub(in crate::device) fn of(order: Order, lost: u16) -> Self {
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
    /// Measurements that never came.
    pub lost: u64,
    /// Datagrams that were none.
    pub malformed: u64,
}

/// A value of each joint.
pub type Joints = [f64; AXES];

/// One end of a connection, as a driver sees it: a session of either generation.
pub trait Protocol: fmt::Debug + Send + 'static {
    /// How the controller judges the connection.
    type Quality: Copy + fmt::Debug + PartialEq;

    /// Takes a datagram that arrived `at`.
    ///
    /// # Errors
    /// If it is none of this protocol, with the reason.
    fn hear(&mut self, datagram: &[u8], at: Duration) -> Result<Heard, DecodeError>;

    /// An observer of this protocol that has seen nothing yet.
    fn observer(&self) -> Observer;

    /// The newest measurement, which arrived `at`, for an observer; `None` before the first.
    fn measurement(&self, at: Duration) -> Option<Measurement>;

    /// The counter of the answer written last.
    fn sent_sequence(&self) -> u32;

    /// Whether these positions may be in the next answer, rad.
    ///
    /// # Errors
    /// With the joint and the limit that they are beyond; an answer would hold the robot at once.
    fn check(&self, joints: &Joints) -> Result<(), Violation>;

    /// Why the last answer held the robot, or added nothing; `None` if it said what was asked for.
    fn violation(&self) -> Option<Violation>;

    /// It is `now`, and nothing came; whether the controller counts as gone since just now.
    fn hear_nothing(&mut self, now: Duration) -> bool;

    /// Whether the controller waits for an answer.
    fn is_due(&self) -> bool;

    /// Takes what nets order beside positions; it goes out with the next answers as far as the robot takes it
    /// now.
    fn obey(&mut self, has: &Interfaces, orders: &Orders<'_>);

    /// Tells what became of orders, and the robot's inputs and outputs.
    fn report(&self, has: &Interfaces, signals: &mut [u64]);

    /// Writes the answer with these positions, rad, and tells its length; nothing if none is due.
    fn reply(&mut self, joints: &Joints, buffer: &mut [u8]) -> Option<usize>;

    /// Whether the robot is there and follows.
    fn status(&self) -> DeviceStatus;

    /// Positions that the next answer may carry without a jump, rad.
    fn rest(&self) -> Joints;

    /// Where the robot is to be by its own account, rad; `None` before the first measurement.
    fn set_point(&self) -> Option<Joints>;

    /// Where it is, rad; `None` before the first measurement.
    fn measured(&self) -> Option<Joints>;

    /// Torques that act on the joints from outside, as the controller estimates them, Nm.
    fn external_torques(&self) -> Option<Joints>;

    /// Torques measured at the joints, Nm.
    fn measured_torques(&self) -> Option<Joints>;

    /// Force and torque at the tool, if the controller tells; else the driver finds them by the external torques.
    fn wrench(&self) -> Option<Wrench>;

    /// Time between measurements; `None` before the first.
    fn cycle(&self) -> Option<Duration>;

    /// The code of the quality last told.
    fn quality_code(&self) -> i32;

    /// What a code of quality means.
    fn quality(code: i32) -> Self::Quality;

    /// Totals so far.
    fn totals(&self) -> Totals;
}
