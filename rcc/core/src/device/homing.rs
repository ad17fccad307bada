//! The inputs and outputs of an axis beside its homing ([`super::Part::Homing`]), in one order for all drivers, and why homing fails.

/// Digital inputs: [`READY`], [`PROXIMITY`], [`POWERED`].
pub const BOOL_IN: usize = 3;
/// Digital outputs: [`POWER`].
pub const BOOL_OUT: usize = 1;
/// Analogue inputs: [`OFFSET`].
pub const REAL_IN: usize = 1;

/// Digital input: its amplifier is ready.
pub const READY: usize = 0;
/// Digital input: its proximity switch is on.
pub const PROXIMITY: usize = 1;
/// Digital input: it has power, and its brake is released.
pub const POWERED: usize = 2;
/// Digital output: power while it is set, for an axis that has power on request only; taken back, the axis brakes, and then its
/// brake closes.
pub const POWER: usize = 0;
/// Analogue input: voltage that compensates the offset of its amplifier, V.
pub const OFFSET: usize = 0;

/// What the numbers of a failure of homing mean, from 1.
pub const FAILURES: [&str; 7] = [
    "sensor not found",
    "switch stuck",
    "index not found",
    "wrong direction",
    "not moving",
    "time-out",
    "power lost",
];

/// What the numbers of the steps of homing mean, from 0.
pub const STEPS: [&str; 9] = [
    "not begun",
    "off the switch on which it began",
    "to the switch",
    "on the switch until it may leave",
    "off the switch",
    "to the index pulse",
    "to its start",
    "done",
    "failed or cancelled",
];
/// The step in which it is on the switch until it may leave.
pub const TOUCHED: i32 = 3;
