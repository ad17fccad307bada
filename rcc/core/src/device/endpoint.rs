//! A driver's side of a device: what nets command, whether that is fresh, and what is published. Every driver has one for
//! each of its devices; how set-points become motion is in `setpoint`, the wire is the driver's own.

use takt_net::JointState;
use takt_net::device::{Interfaces, JointError, Layout};
use takt_rt::Nanos;
use takt_rt::latest::{LatestReader, LatestWriter};

use super::continuity::Continuity;
use super::driver::DeviceEnd;
use super::setpoint::Joint;
use super::{DeviceCommand, DeviceState, DeviceStatus, Part, parts};

/// Set-points older than this many cycles of the driver, and one period of the net thread, are ignored.
pub const STALE_CYCLES: i64 = 10;

/// What a driver exchanges with nets for one device.
#[derive(Debug)]
pub struct Endpoint {
    /// The newest commands of nets.
    pub taken: DeviceCommand,
    /// The state that is published next.
    pub reported: DeviceState,
    /// Where its values are in the words of both.
    pub interfaces: Interfaces,
    net_period: Nanos,
    continuity: Continuity,
    state: LatestWriter<DeviceState>,
    command: LatestReader<DeviceCommand>,
}

impl Endpoint {
    /// The endpoint of a device with these parts and so many joints.
    #[must_use]
    pub fn new(end: DeviceEnd, parts: &[Part], joints: usize) -> Self {
        let mut layout = Layout::default();
        let interfaces = parts::lay(parts, joints, &mut layout);
        Self {
            taken: DeviceCommand::new(layout.commands),
            reported: DeviceState::new(layout.signals),
            interfaces,
            net_period: end.net_period.into(),
            continuity: Continuity::default(),
            state: end.state,
            command: end.command,
        }
    }

    /// Takes the newest commands.
    pub fn take(&mut self) {
        let taken = &mut self.taken;
        self.command.read_with(|command| taken.copy_from(command));
    }

    /// Period of the net thread that commands it.
    #[must_use]
    pub const fn net_period(&self) -> Nanos {
        self.net_period
    }

    /// Whether the net thread is alive at `now`, for a driver of that cycle time.
    #[must_use]
    pub fn is_fresh(&self, now: Nanos, cycle: Nanos) -> bool {
        now - self.taken.time <= Nanos(cycle.0 * STALE_CYCLES) + self.net_period
    }

    /// Whether a net commands a joint.
    #[must_use]
    pub fn is_commanded(&self) -> bool {
        self.taken.joints.iter().any(|joint| joint.active)
    }

    /// Reports its joints with their measured positions (rad), velocities and accelerations, and checks their positions for
    /// jumps. The status is entered before.
    pub fn report_joints<'a>(
        &mut self,
        joints: impl IntoIterator<Item = (&'a Joint, [Option<f64>; 3])>,
    ) {
        let mut limits = [None; super::ARM_JOINTS_MAX];
        let status = self.reported.status;
        let reported = &mut self.reported;
        let rejected = reported.rejected.iter_mut();
        let reports = reported.limited.iter_mut().zip(rejected);
        let places = reported.joints.iter_mut().zip(reports);
        for (((state, (limited, rejected)), limit), (joint, measured)) in
            places.zip(&mut limits).zip(joints)
        {
            let (position, velocity, acceleration) = joint.continued();
            *limit = Some(joint.limits().velocity_max);
            (*limited, *rejected) = (*joint.limited(), *joint.rejected());
            *state = JointState {
                commanded_position: Some(position),
                commanded_velocity: Some(velocity),
                commanded_acceleration: Some(acceleration),
                measured_position: measured[0],
                measured_velocity: measured[1],
                measured_acceleration: measured[2],
                error: joint_error(status, joint.error()) as i32,
            };
        }
        self.continuity
            .check(reported, |number| *limits.get(number)?);
    }

    /// Reports figures, those from number `first` on; `None` is not known.
    pub fn report_figures(&mut self, first: usize, values: impl IntoIterator<Item = Option<f64>>) {
        let places = self.interfaces.figures.iter().skip(first);
        for (figure, value) in places.zip(values) {
            figure.place.report(&mut self.reported.signals, value);
        }
    }

    /// Publishes the state.
    pub fn publish(&mut self) {
        let reported = &self.reported;
        self.state.write_with(|state| state.copy_from(reported));
    }
}

/// The error that nets see of a joint or base, whose own is `error` while it follows.
#[must_use]
pub const fn joint_error(status: DeviceStatus, error: JointError) -> JointError {
    match status {
        DeviceStatus::Offline => JointError::Offline,
        DeviceStatus::SafeOperational => JointError::NotEnabled,
        DeviceStatus::Operational => error,
    }
}
