//! Values of `outError` that primitives set themselves; drivers have others.

/// Another primitive of the net commands the same in this cycle.
pub(super) const CONCURRENT: i32 = -1;
/// The value is out of range.
pub(super) const RANGE: i32 = 1;
/// The value is not a number.
pub(super) const INVALID: i32 = 2;

/// The first of these errors that is set: concurrent access, the device's own, the value's.
pub(super) const fn first_error(concurrent: bool, device: i32, value: i32) -> i32 {
    match (concurrent, device) {
        (true, _) => CONCURRENT,
        (false, 0) => value,
        (false, device) => device,
    }
}
