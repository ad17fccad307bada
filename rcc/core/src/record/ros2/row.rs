//! A row of a device's flight recorder, taken apart. Who wrote it is not known here.

use takt_net::{JointState, Nanos};

use crate::device::DeviceStatus;
use crate::executor::flight::{HEAD, JOINT_WORDS};
use crate::record::words::status_of;

/// What a device reported in a cycle, and what nets commanded to it.
#[derive(Clone, Copy, Debug)]
pub(in crate::record) struct FlightRow<'a> {
    pub(in crate::record) cycle: u64,
    /// When the thread woke for the cycle.
    pub(in crate::record) woken: Nanos,
    pub(in crate::record) status: DeviceStatus,
    /// Number of times that it stopped following commands.
    pub(in crate::record) faults: u64,
    joints: &'a [[u64; JOINT_WORDS]],
    /// Words of its interfaces.
    pub(in crate::record) signals: &'a [u64],
}

/// A joint in a row.
#[derive(Clone, Copy, Debug)]
pub(in crate::record) struct FlightJoint {
    /// Not a number if nets commanded nothing.
    pub(in crate::record) set_point: f64,
    pub(in crate::record) state: JointState,
}

impl<'a> FlightRow<'a> {
    /// The row of a device with so many joints; `None` if it is too short.
    pub(in crate::record) fn of(row: &'a [u64], joints: usize) -> Option<Self> {
        let (head, rest) = row.split_first_chunk::<HEAD>()?;
        let [cycle, _, status, faults, _, woken] = *head;
        let (of_joints, signals) = rest.split_at_checked(joints * JOINT_WORDS)?;
        Some(Self {
            cycle,
            woken: Nanos(woken.cast_signed()),
            status: status_of(status),
            faults,
            joints: of_joints.as_chunks().0,
            signals,
        })
    }

    /// Its joints in order.
    pub(in crate::record) fn joints(
        &self,
    ) -> impl ExactSizeIterator<Item = FlightJoint> + Clone + use<'a> {
        self.joints.iter().map(|words| {
            let [set_point, commanded, measured, velocity, error] = words.map(f64::from_bits);
            let known = |value: f64| (!value.is_nan()).then_some(value);
            #[expect(clippy::cast_possible_truncation, reason = "it was an i32")]
            let error = error as i32;
            FlightJoint {
                // Null has bits of its own in the ring; messages have one NaN.
                set_point: known(set_point).unwrap_or(f64::NAN),
                state: JointState {
                    error,
                    commanded_position: known(commanded),
                    measured_position: known(measured),
                    measured_velocity: known(velocity),
                    ..JointState::default()
                },
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_row_short_is_none() {
        let nan = f64::NAN.to_bits();
        let mut row = vec![
            7,
            5,
            2,
            3,
            4,
            6,
            1.5_f64.to_bits(),
            nan,
            0.5_f64.to_bits(),
            nan,
        ];
        row.extend([2.0_f64.to_bits(), 9]);
        let read = FlightRow::of(&row, 1).unwrap();
        assert_eq!((read.cycle, read.woken, read.faults), (7, Nanos(6), 3));
        let words = [9];
        assert_eq!(read.status, DeviceStatus::Operational);
        assert_eq!(read.signals, words);
        let joint = read.joints().next().unwrap();
        assert_eq!(joint.set_point.to_bits(), 1.5_f64.to_bits());
        assert_eq!(joint.state.error, 2);
        assert_eq!(joint.state.measured_position, Some(0.5));
        assert_eq!(joint.state.commanded_position, None);
        row[6] = takt_net::ports::NULL;
        let joint = FlightRow::of(&row, 1).unwrap().joints().next().unwrap();
        assert_eq!(joint.set_point.to_bits(), f64::NAN.to_bits());
        assert!(FlightRow::of(&row, 2).is_none());
        assert!(FlightRow::of(&row[..3], 0).is_none());
    }
}
