//! A KUKA LWR on a KRC2 lr: what it is like, and its end of the connection as the driver of FRI arms
//! sees it. The driver is in `fri`, the protocol in `takt_fri::lwr`.

use std::time::Duration;

use takt_fri::linux::UdpLink;
use takt_fri::lwr::wire::{Msr, Quality};
use takt_fri::lwr::{Phase, Session, SessionConfig};
use takt_net::JointLimits;
use takt_net::value::{Vector, Wrench};

use crate::cell::LwrConfig;
use crate::device::driver::DriverEnds;
use crate::device::fri::{self, FriArm, FriFigures, Heard, Joints, Protocol, Settings, Totals};
use crate::device::{ArmDescription, DeviceStatus, Part};
use crate::error::Error;

/// A running driver of an LWR.
pub type Lwr = FriArm<Session>;
/// Figures of a driver of an LWR.
pub type LwrFigures = FriFigures<Quality>;

/// An LWR as its controller describes it: ranges of the axes, and the speed and acceleration that
/// existing drivers use for all of them.
#[must_use]
pub fn describe(name: &str) -> ArmDescription {
    let ranges = [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 170.0_f64];
    let limits = ranges.map(|range| JointLimits {
        position_min: -range.to_radians(),
        position_max: range.to_radians(),
        velocity_max: 112.5_f64.to_radians(),
        acceleration_max: 4.0,
    });
    ArmDescription {
        name: name.to_owned(),
        kind: "kuka_lwr_fri",
        limits: limits.to_vec(),
        model: "kuka_lwr4".into(),
    }
}

/// What an LWR tells beside its joints.
pub const PARTS: &[Part] = &[Part::Torques, Part::Wrench];

/// Opens the socket at which the KRC's datagrams arrive.
///
/// # Errors
/// If the address cannot be listened at.
pub fn listen(config: &LwrConfig) -> Result<UdpLink, Error> {
    fri::listen(&config.name, config.listen)
}

impl Lwr {
    /// Starts the driver thread. On the clock that it tells, zero and every whole period is the instant of
    /// a measurement.
    ///
    /// # Errors
    /// If the socket has no address or the system has no thread to give.
    pub fn start(config: &LwrConfig, link: UdpLink, ends: DriverEnds) -> Result<Self, Error> {
        let session = Session::new(SessionConfig::default());
        let settings = Settings {
            listen: config.listen,
            priority: config.priority,
            cpus: config.cpus.clone(),
        };
        let description = describe(&config.name).with(PARTS);
        Self::launch(session, description, settings, link, ends)
    }
}

impl Protocol for Session {
    type Quality = Quality;

    fn hear(&mut self, datagram: &[u8], at: Duration) -> Option<Heard> {
        let reception = self.handle_datagram(datagram, at).ok()?;
        Some(Heard {
            is_new: reception.order.is_new(),
            lost: reception.lost,
        })
    }

    fn hear_nothing(&mut self, now: Duration) -> bool {
        self.handle_timeout(now)
    }

    fn is_due(&self) -> bool {
        self.is_pending()
    }

    fn reply(&mut self, joints: &Joints, buffer: &mut [u8]) -> Option<usize> {
        self.answer(Some(joints), buffer).ok()
    }

    fn status(&self) -> DeviceStatus {
        match self.phase() {
            Phase::Offline => DeviceStatus::Offline,
            Phase::Monitor => DeviceStatus::SafeOperational,
            Phase::Command => DeviceStatus::Operational,
        }
    }

    fn rest(&self) -> Joints {
        self.mirror()
    }

    fn set_point(&self) -> Option<Joints> {
        self.measurement().map(Msr::set_point)
    }

    fn measured(&self) -> Option<Joints> {
        self.measurement()
            .map(|msr| msr.measured_joints.map(f64::from))
    }

    fn external_torques(&self) -> Option<Joints> {
        self.measurement()
            .map(|msr| msr.external_torque.map(f64::from))
    }

    fn measured_torques(&self) -> Option<Joints> {
        self.measurement()
            .map(|msr| msr.measured_torque.map(f64::from))
    }

    fn wrench(&self) -> Option<Wrench> {
        self.measurement().map(|msr| wrench(&msr.external_wrench))
    }

    fn cycle(&self) -> Option<Duration> {
        self.period()
    }

    fn quality_code(&self) -> i32 {
        let quality = self.measurement().map(|msr| msr.interface.quality.code());
        quality.unwrap_or_default().into()
    }

    fn quality(code: i32) -> Quality {
        Quality::from(u16::try_from(code).unwrap_or_default())
    }

    fn totals(&self) -> Totals {
        let counters = self.counters();
        Totals {
            received: counters.received,
            lost: counters.lost,
            malformed: counters.malformed,
        }
    }
}

/// Force and torque in the wire's order, in which torques are about z, y, x.
fn wrench(values: &[f32; 6]) -> Wrench {
    let [x, y, z, about_z, about_y, about_x] = values.map(f64::from);
    Wrench {
        force: Vector::new(x, y, z),
        torque: Vector::new(about_x, about_y, about_z),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torques_about_z_come_first_on_the_wire() {
        let wrench = wrench(&[1.0, 2.0, 3.0, 6.0, 5.0, 4.0]);
        assert_eq!(wrench.force, Vector::new(1.0, 2.0, 3.0));
        assert_eq!(wrench.torque, Vector::new(4.0, 5.0, 6.0));
    }
}
