//! What a primitive can access in a cycle: slots, the image of the devices, times and requests. Plans make it; ports,
//! devices and primitives use it.

use crate::device::Image;
use crate::netcomm::Mailbox;
use crate::slots::Slots;
use crate::value::Nanos;

/// The inputs of a cycle from outside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Moment {
    /// Number of the cycle of the evaluating thread, from 1; skipped cycles count.
    pub cycle: u64,
    /// Logical time of the cycle: start of the thread plus whole periods, without jitter.
    pub time: Nanos,
    /// The clock reading at the start of this cycle: on the same time line, unless the thread keeps
    /// phase with a device's clock; the two then drift apart.
    pub wall: Nanos,
    /// Number of thread cycles in one net period; 0 counts as 1.
    pub every: u64,
    /// Whether the net was requested to cancel.
    pub cancel: bool,
    /// Whether a successor is scheduled.
    pub takeover: bool,
    /// Whether a device that the net commands has failed since the net started.
    pub device_failed: bool,
    /// The number of the evaluated net: it owns its commands, which end with it.
    pub net: u32,
}

/// The data that a primitive can access in a step.
#[derive(Debug)]
pub struct Cycle<'a> {
    pub(crate) slots: &'a Slots,
    /// Device states at the start of the cycle, and commands to the devices.
    pub image: &'a Image,
    /// Time and requests from outside.
    pub moment: Moment,
    /// Number of previous evaluations of the net; unlike `moment.cycle` without gaps.
    pub count: i64,
    pub(crate) inbox: &'a Mailbox,
    pub(crate) outbox: &'a Mailbox,
}
