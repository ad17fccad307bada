//! A KUKA LBR iiwa on a Sunrise cabinet: what it is like, and its end of the connection as the driver of
//! FRI arms sees it. The driver is in `fri`, the protocol in `takt_fri::sunrise`. Control and command
//! mode are chosen by the robot program; nothing here can switch them.

use std::time::Duration;

use takt_fri::linux::UdpLink;
use takt_fri::sunrise::wire::{CommandMode, MonitorData, Quality};
use takt_fri::sunrise::{AXES, Demand, Phase, Session, SessionConfig};
use takt_net::JointLimits;
use takt_net::value::Wrench;

use crate::cell::{IiwaConfig, IiwaModel};
use crate::device::driver::DriverEnds;
use crate::device::fri::{self, FriArm, FriFigures, Heard, Joints, Protocol, Settings, Totals};
use crate::device::{ArmDescription, DeviceStatus, Part};
use crate::error::Error;

/// A running driver of an iiwa.
pub type Iiwa = FriArm<Session>;
/// Figures of a driver of an iiwa.
pub type IiwaFigures = FriFigures<Quality>;

/// Share of the data sheet's speeds that is used: the controller ends the overlay at the very limit,
/// and interpolation may exceed ours a little.
const SPEED_SHARE: f64 = 0.99;
/// No acceleration is published for commanded positions; this is what gentle drivers use, rad/s².
const ACCELERATION: f64 = 4.0;

/// What an iiwa tells beside its joints. Force at the tool is not among it: only FRI 2.7 tells it, and
/// the order of its torques has not been seen.
pub const PARTS: &[Part] = &[Part::Torques];

/// An iiwa by its data sheet: ranges and speeds of the axes.
#[must_use]
pub fn describe(name: &str, model: IiwaModel) -> ArmDescription {
    let ranges = [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0_f64];
    let (kinematics, speeds) = match model {
        IiwaModel::Iiwa7 => (
            "kuka_iiwa7",
            [98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0_f64],
        ),
        IiwaModel::Iiwa14 => (
            "kuka_iiwa14",
            [85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0_f64],
        ),
    };
    let limits = ranges.into_iter().zip(speeds);
    let limits = limits.map(|(range, speed)| JointLimits {
        position_min: -range.to_radians(),
        position_max: range.to_radians(),
        velocity_max: speed.to_radians() * SPEED_SHARE,
        acceleration_max: ACCELERATION,
    });
    ArmDescription {
        name: name.to_owned(),
        kind: "kuka_iiwa_fri",
        limits: limits.collect(),
        model: kinematics.into(),
    }
}

/// Opens the socket at which the cabinet's datagrams arrive.
///
/// # Errors
/// If the address cannot be listened at.
pub fn listen(config: &IiwaConfig) -> Result<UdpLink, Error> {
    fri::listen(&config.name, config.listen)
}

impl Iiwa {
    /// Starts the driver thread. On the clock that it tells, zero and every whole period is the instant of
    /// a measurement. The dialect is found out from the first datagrams.
    ///
    /// # Errors
    /// If the socket has no address or the system has no thread to give.
    pub fn start(config: &IiwaConfig, link: UdpLink, ends: DriverEnds) -> Result<Self, Error> {
        let session = Session::new(SessionConfig::default());
        let settings = Settings {
            listen: config.listen,
            priority: config.priority,
            cpus: config.cpus.clone(),
        };
        let description = describe(&config.name, config.model).with(PARTS);
        Self::launch(session, description, settings, link, ends)
    }
}

/// What brings the joints to these positions under an overlay of this kind: they are the centre of the
/// impedance where the overlay adds a wrench or torques. `None` where they cannot be commanded.
fn demand(mode: CommandMode, joints: &Joints) -> Option<Demand> {
    match mode {
        CommandMode::Position => Some(Demand::Position(*joints)),
        CommandMode::Wrench => Some(Demand::Wrench {
            wrench: [0.0; 6],
            joints: Some(*joints),
        }),
        CommandMode::Torque => Some(Demand::Torque {
            torque: [0.0; AXES],
            joints: Some(*joints),
        }),
        CommandMode::None | CommandMode::CartesianPose | CommandMode::Other(_) => None,
    }
}

fn told(session: &Session) -> Option<&MonitorData> {
    session.message()?.monitor.as_ref()
}

impl Protocol for Session {
    type Quality = Quality;

    /// Engages as soon as the overlay is active: set-points that are under way then are refused by the
    /// joints until they end, so nothing moves that was not asked for anew.
    fn hear(&mut self, datagram: &[u8], at: Duration) -> Option<Heard> {
        let reception = self.handle_datagram(datagram, at).ok()?;
        if self.phase() == Phase::CommandingActive && !self.is_engaged() {
            let _not_active = self.engage();
        }
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
        let demand = demand(self.command_mode(), joints).filter(|_| self.is_engaged());
        let answer = self.answer(&demand.unwrap_or(Demand::Hold), buffer);
        answer.ok().map(|answer| answer.len)
    }

    fn status(&self) -> DeviceStatus {
        match self.phase() {
            Phase::Offline => DeviceStatus::Offline,
            Phase::Idle
            | Phase::MonitoringWait
            | Phase::MonitoringReady
            | Phase::CommandingWait => DeviceStatus::SafeOperational,
            Phase::CommandingActive => {
                let follows = demand(self.command_mode(), &[0.0; AXES]).is_some();
                if follows && self.is_engaged() {
                    DeviceStatus::Operational
                } else {
                    DeviceStatus::SafeOperational
                }
            }
        }
    }

    fn rest(&self) -> Joints {
        self.mirror()
    }

    fn set_point(&self) -> Option<Joints> {
        self.message().map(|_| self.mirror())
    }

    fn measured(&self) -> Option<Joints> {
        told(self)?.measured
    }

    fn external_torques(&self) -> Option<Joints> {
        told(self)?.external_torque
    }

    fn measured_torques(&self) -> Option<Joints> {
        told(self)?.torque
    }

    fn wrench(&self) -> Option<Wrench> {
        None
    }

    fn cycle(&self) -> Option<Duration> {
        self.period()
    }

    fn quality_code(&self) -> i32 {
        self.message().map_or(0, |told| told.quality().code())
    }

    fn quality(code: i32) -> Quality {
        Quality::from(code)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_go_with_every_overlay_that_takes_them() {
        let joints = [0.1; AXES];
        for mode in [
            CommandMode::Position,
            CommandMode::Wrench,
            CommandMode::Torque,
        ] {
            assert_eq!(demand(mode, &joints).and_then(|d| d.mode()), Some(mode));
        }
        for mode in [CommandMode::None, CommandMode::CartesianPose] {
            assert_eq!(demand(mode, &joints), None);
        }
    }

    #[test]
    fn the_two_arms_differ_in_speed_and_kinematics() {
        let [light, heavy] = [IiwaModel::Iiwa7, IiwaModel::Iiwa14].map(|m| describe("a", m));
        assert!(light.limits[3].velocity_max > 1.5 * heavy.limits[3].velocity_max);
        for arm in [light, heavy] {
            assert!(takt_motion::kinematics::named(&arm.model).is_some());
        }
    }
}
