//! The inputs and outputs by which nets home an axis, in one order for all drivers: the primitive `Homing::Axis` and the drivers
//! share it.

/// Digital inputs: [`HOMED`], [`HOMING`], amplifier ready, proximity switch.
pub const BOOL_IN: usize = 4;
/// Digital outputs: [`HOME`].
pub const BOOL_OUT: usize = 1;
/// Analogue inputs: [`FAILURE`], offset voltage in V.
pub const REAL_IN: usize = 2;

/// Digital input: the zero of the axis is known.
pub const HOMED: usize = 0;
/// Digital input: homing is under way.
pub const HOMING: usize = 1;
/// Digital output: home while it is set; taken back before the end, the axis brakes.
pub const HOME: usize = 0;
/// Analogue input: number of the last failure, 0 without one.
pub const FAILURE: usize = 0;
/// What the numbers from 1 mean.
pub const FAILURES: [&str; 7] = [
    "sensor not found",
    "switch stuck",
    "index not found",
    "wrong direction",
    "not moving",
    "time-out",
    "power lost",
];
