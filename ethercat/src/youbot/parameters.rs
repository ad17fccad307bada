//! Parameters of the drives and of the gripper by name, with unit, range and write access. Nothing is sent here:
//! [`Parameter::get`] and [`Parameter::set`] return the request.

use super::tmcl::Request;

/// Group of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterGroup {
    /// Axis parameter of a drive.
    Drive,
    /// Global parameter of a drive, in this bank.
    Bank(u8),
    /// Of a bar of the gripper.
    Bar,
}

/// Write access of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Always writable.
    Free,
    /// Writable after the drive was unlocked by `unlock`.
    Protected,
    /// Read only.
    ReadOnly,
}

use Access::{Free, Protected, ReadOnly};
use ParameterGroup::{Bank, Bar, Drive};

/// A parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Its name.
    pub name: &'static str,
    /// Its group.
    pub group: ParameterGroup,
    /// Its number in the group.
    pub number: u8,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// Smallest and largest value.
    pub range: (i32, i32),
    /// Its write access.
    pub access: Access,
}

/// A value that a parameter cannot have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RangeError {
    /// Beyond its range.
    #[error("{name} is {low} to {high} {unit}, not {value}")]
    Range {
        /// Its name.
        name: &'static str,
        /// Smallest.
        low: i32,
        /// Largest.
        high: i32,
        /// Unit.
        unit: &'static str,
        /// The given value.
        value: i32,
    },
    /// It shows a measurement.
    #[error("{0} can only be read")]
    ReadOnly(&'static str),
}

impl Parameter {
    /// The parameter with this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        ALL.iter().find(|parameter| parameter.name == name)
    }

    /// The request that reads it; `bar` matters to those of the gripper.
    pub const fn get(&self, bar: u8) -> Request {
        match self.group {
            Drive => Request::get(self.number),
            Bank(bank) => Request::get_global(bank, self.number),
            Bar => Request::get_bar(bar, self.number),
        }
    }

    /// The request that writes it; `bar` matters to those of the gripper.
    ///
    /// # Errors
    /// If the value is not allowed.
    pub fn set(&self, bar: u8, value: i32) -> Result<Request, RangeError> {
        let (low, high) = self.range;
        if self.access == ReadOnly {
            return Err(RangeError::ReadOnly(self.name));
        }
        if !(low..=high).contains(&value) {
            let (name, unit) = (self.name, self.unit);
            return Err(RangeError::Range {
                name,
                low,
                high,
                unit,
                value,
            });
        }
        Ok(match self.group {
            Drive => Request::set(self.number, value),
            Bank(bank) => Request::set_global(bank, self.number, value),
            Bar => Request::set_bar(bar, self.number, value),
        })
    }
}

const ANY: (i32, i32) = (i32::MIN, i32::MAX);
const POSITIVE: (i32, i32) = (0, i32::MAX);
const FLAG: (i32, i32) = (0, 1);
const GAIN: (i32, i32) = (0, 65_535);
/// Range of speeds and currents; larger values suggest a wrong unit.
const LARGE: (i32, i32) = (0, 100_000);
/// Range of ticks and times; likewise.
const HUGE: (i32, i32) = (0, 1_000_000);

const fn of(
    group: ParameterGroup,
    name: &'static str,
    number: u8,
    unit: &'static str,
    range: (i32, i32),
    access: Access,
) -> Parameter {
    Parameter {
        name,
        group,
        number,
        unit,
        range,
        access,
    }
}

/// All known parameters.
pub const ALL: &[Parameter] = &[
    of(Drive, "target_position", 0, "ticks", ANY, Free),
    of(Drive, "actual_position", 1, "ticks", ANY, Free),
    of(Drive, "target_speed", 2, "rpm", ANY, Free),
    of(Drive, "actual_speed", 3, "rpm", ANY, ReadOnly),
    of(Drive, "max_positioning_speed", 4, "rpm", LARGE, Free),
    of(Drive, "max_current", 6, "mA", LARGE, Free),
    of(Drive, "max_set_position_speed", 7, "rpm", LARGE, Free),
    of(Drive, "position_pid_threshold", 8, "rpm", LARGE, Free),
    of(Drive, "halted_speed", 9, "rpm", LARGE, Free),
    of(Drive, "target_reached_distance", 10, "ticks", HUGE, Free),
    of(Drive, "acceleration", 11, "rpm/s", (0, 10_000_000), Free),
    of(Drive, "velocity_pid_threshold", 12, "rpm", LARGE, Free),
    of(Drive, "ramp_speed", 13, "rpm", ANY, ReadOnly),
    of(Drive, "hall_fx_threshold", 14, "rpm", LARGE, Free),
    of(Drive, "initialized", 15, "", FLAG, Free),
    of(Drive, "i2t_time", 25, "ms", HUGE, Protected),
    of(Drive, "i2t_limit", 26, "", POSITIVE, Protected),
    of(Drive, "i2t_sum", 27, "", ANY, ReadOnly),
    of(Drive, "i2t_counter", 28, "", ANY, ReadOnly),
    of(Drive, "clear_i2t", 29, "", ANY, Free),
    of(Drive, "operating_hours", 30, "h", ANY, ReadOnly),
    of(Drive, "reinitialize", 31, "", FLAG, Free),
    of(Drive, "position_p1", 130, "", GAIN, Free),
    of(Drive, "position_i1", 131, "", GAIN, Free),
    of(Drive, "position_d1", 132, "", GAIN, Free),
    of(Drive, "position_clip1", 135, "", GAIN, Free),
    of(Drive, "velocity_p1", 140, "", GAIN, Free),
    of(Drive, "velocity_i1", 141, "", GAIN, Free),
    of(Drive, "velocity_d1", 142, "", GAIN, Free),
    of(Drive, "velocity_clip1", 143, "", GAIN, Free),
    of(Drive, "ramp", 146, "", FLAG, Free),
    of(Drive, "current", 150, "mA", ANY, ReadOnly),
    of(Drive, "supply", 151, "10 mV", ANY, ReadOnly),
    of(Drive, "temperature", 152, "ADC", ANY, ReadOnly),
    of(Drive, "target_current", 155, "mA", ANY, ReadOnly),
    of(Drive, "flags", 156, "", ANY, ReadOnly),
    of(Drive, "supply_current", 157, "mA", ANY, ReadOnly),
    of(Drive, "clear_timeout", 158, "", ANY, Free),
    of(Drive, "commutation_mode", 159, "", (0, 5), Protected),
    of(Drive, "commutation_offset", 165, "", ANY, Protected),
    of(Drive, "current_p", 172, "", GAIN, Free),
    of(Drive, "current_i", 173, "", GAIN, Free),
    of(Drive, "current_d", 174, "", GAIN, Free),
    of(Drive, "current_clip", 175, "", GAIN, Free),
    of(Drive, "commutation_current", 177, "mA", LARGE, Protected),
    of(Drive, "position_p2", 230, "", GAIN, Free),
    of(Drive, "position_i2", 231, "", GAIN, Free),
    of(Drive, "position_d2", 232, "", GAIN, Free),
    of(Drive, "position_clip2", 233, "", GAIN, Free),
    of(Drive, "velocity_p2", 234, "", GAIN, Free),
    of(Drive, "velocity_i2", 235, "", GAIN, Free),
    of(Drive, "velocity_d2", 236, "", GAIN, Free),
    of(Drive, "velocity_clip2", 237, "", GAIN, Free),
    of(Drive, "commutation_speed", 244, "rpm", LARGE, Protected),
    of(Drive, "commutation_direction", 245, "", FLAG, Protected),
    of(Drive, "unlock", 248, "", ANY, Free),
    of(Drive, "commutation_method", 249, "", (0, 2), Protected),
    of(Drive, "encoder_steps", 250, "ticks", HUGE, Protected),
    of(Drive, "encoder_direction", 251, "", FLAG, Protected),
    of(Drive, "poles", 253, "", (2, 254), Protected),
    of(Drive, "hall_invert", 254, "", FLAG, Protected),
    of(Bank(0), "timeout", 90, "ms", POSITIVE, Protected),
    of(Bank(2), "calibrated", 16, "", FLAG, Free),
    of(Bank(2), "gripper_calibrated", 17, "", FLAG, Free),
    of(Bar, "bar_target_position", 0, "steps", ANY, Free),
    of(Bar, "bar_actual_position", 1, "steps", ANY, Free),
    of(Bar, "bar_target_speed", 2, "", ANY, Free),
    of(Bar, "bar_actual_speed", 3, "", ANY, ReadOnly),
    of(Bar, "bar_max_speed", 4, "", (0, 2047), Free),
    of(Bar, "bar_acceleration", 5, "", (0, 2047), Free),
    of(Bar, "bar_max_current", 6, "", (0, 255), Free),
    of(Bar, "bar_standby_current", 7, "", (0, 255), Free),
    of(Bar, "bar_target_reached", 8, "", FLAG, ReadOnly),
    of(Bar, "bar_microsteps", 140, "", (0, 8), Free),
    of(Bar, "bar_stallguard_filter", 173, "", FLAG, Free),
    of(Bar, "bar_stallguard_threshold", 174, "", (-64, 63), Free),
    of(Bar, "bar_stop_on_stall", 181, "", (0, 2047), Free),
    of(Bar, "bar_freewheel", 204, "", GAIN, Free),
    of(Bar, "bar_load", 206, "", ANY, ReadOnly),
    of(Bar, "bar_errors", 208, "", ANY, ReadOnly),
];

/// Axis parameter "clear the I2t flag".
pub(crate) const CLEAR_I2T: u8 = 29;
/// Axis parameter "clear the EtherCAT time-out".
pub(crate) const CLEAR_TIMEOUT: u8 = 158;
/// Axis parameter "largest current", mA.
pub(crate) const MAX_CURRENT: u8 = 6;
/// Axis parameter "actual position"; written, it presets it.
pub(crate) const ACTUAL_POSITION: u8 = 1;
/// Bank and number of the global parameter "the joint was homed since power came on".
pub const CALIBRATED: (u8, u8) = (2, 16);
/// The same for the gripper. The vendor's driver uses that of the joint for both, which hides one from the other.
pub(crate) const GRIPPER_CALIBRATED: (u8, u8) = (2, 17);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_numbers_are_unique() {
        for (n, one) in ALL.iter().enumerate() {
            for other in &ALL[..n] {
                assert_ne!(one.name, other.name);
                assert_ne!((one.group, one.number), (other.group, other.number));
            }
            assert!(one.range.0 < one.range.1, "{}", one.name);
            assert_eq!(Parameter::named(one.name), Some(one));
        }
        assert_eq!(Parameter::named("no such"), None);
    }

    #[test]
    fn parameter_requests_address_their_group() {
        let request = |name: &str, value| Parameter::named(name).unwrap().set(1, value);
        assert_eq!(request("max_current", 500), Ok(Request::set(6, 500)));
        assert_eq!(request("timeout", 90), Ok(Request::set_global(0, 90, 90)));
        assert_eq!(request("bar_max_speed", 9), Ok(Request::set_bar(1, 4, 9)));
        let read = |name: &str| Parameter::named(name).unwrap().get(1);
        assert_eq!(read("flags"), Request::get(156));
        assert_eq!(read("calibrated"), Request::get_global(2, 16));
        assert_eq!(read("bar_load"), Request::get_bar(1, 206));
        let error = request("max_current", -1).unwrap_err().to_string();
        assert_eq!(error, "max_current is 0 to 100000 mA, not -1");
        let error = request("current", 1).unwrap_err().to_string();
        assert_eq!(error, "current can only be read");
    }
}
