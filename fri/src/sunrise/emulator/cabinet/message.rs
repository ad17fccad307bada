//! The monitoring message of an emulated cabinet, in its dialect.

use super::Cabinet;
use crate::emulator::{Pose, Sent};
use crate::sunrise::emulator::Io;
use crate::sunrise::wire::{
    CommandMode, ConnectionInfo, ControlMode, Dialect, Header, IOS_MAX, IoValue, IpoData, List,
    MESSAGE_MAX, MonitorData, Monitoring, Name, Overlay, Placement, Redundancy, RedundancyStrategy,
    RobotInfo, SessionState, TRANSFORMATIONS_MAX, TimeStamp, Transformation,
};
use crate::sunrise::{AXES, IoLevel};
use nalgebra::{Rotation3, UnitQuaternion};
use std::time::Duration;

/// Unix time at the cabinet's start, s.
const EPOCH_S: u32 = 1_700_000_000;

impl Cabinet {
    pub(super) fn send(&mut self, now: Duration) {
        self.sensor.sense(&self.arm.body, self.grid.period());
        self.sequence = self.sequence.wrapping_add(1);
        self.counters.sent += 1;
        self.history.push(Sent {
            sequence: self.sequence,
            index: self.grid.index(),
            at: now,
            set_point: self.arm.set_point,
            in_command: self.is_commanding(),
            following: self.state == SessionState::CommandingActive,
        });
        let mut bytes = [0; MESSAGE_MAX];
        let message = self.message();
        let dialect = self.config.dialect;
        if let Ok(len) = dialect.frame(&mut bytes, |buf| message.encode(buf)) {
            let (behind, faults) = (self.behind(), &mut self.config.faults.to_client);
            self.to_client
                .push(&bytes[..len], now, behind, faults, &mut self.random);
        }
    }

    fn message(&self) -> Monitoring {
        Monitoring {
            header: Header {
                sequence: self.sequence,
                reflected: self.tracker.newest(),
            },
            robot: Some(self.robot()),
            monitor: Some(self.monitor()),
            connection: Some(ConnectionInfo {
                state: self.state,
                quality: self.quality,
                send_period_ms: u32::try_from(self.grid.period().as_millis()).ok(),
                receive_multiplier: Some(self.multiplier()),
            }),
            ipo: Some(self.ipo()),
            requested: self.requested(),
            end: None,
        }
    }

    fn requested(&self) -> List<Transformation, TRANSFORMATIONS_MAX> {
        let mut requested = List::new();
        for frame in self.frames.iter() {
            let _full = requested.push(Transformation {
                name: frame.name,
                ..Transformation::default()
            });
        }
        requested
    }

    fn robot(&self) -> RobotInfo {
        let control = self.control();
        RobotInfo {
            joints: i32::try_from(AXES).ok(),
            safety: Some(self.safety),
            drives: Some([self.drive(); AXES]),
            operation_mode: Some(self.config.operation_mode),
            control_mode: Some(control.map_or(ControlMode::None, |control| control.mode())),
        }
    }

    fn monitor(&self) -> MonitorData {
        let dialect = self.config.dialect;
        let body = &self.arm.body;
        let sensed = self.sensor.estimate();
        let ([x, y, z], [a, b, c]) = (sensed.force, sensed.moment);
        let torque = body.measured_torque();
        let time = self.grid.time();
        MonitorData {
            measured: Some(body.joints()),
            torque: Some(torque),
            commanded: (dialect == Dialect::V1).then_some(self.arm.set_point),
            commanded_torque: Some(torque),
            external_torque: Some(sensed.joints),
            external_force: (dialect == Dialect::V3).then_some([x, y, z, c, b, a]),
            ios: self.ios,
            pose: (dialect != Dialect::V1).then(|| pose(&body.pose())),
            redundancy: (dialect != Dialect::V1).then(|| elbow(body.joints()[2])),
            stamp: Some(TimeStamp {
                seconds: EPOCH_S.wrapping_add(u32::try_from(time.as_secs()).unwrap_or(0)),
                nanoseconds: time.subsec_nanos(),
            }),
        }
    }

    fn ipo(&self) -> IpoData {
        let is_active = self.state == SessionState::CommandingActive;
        if !self.is_commanding() {
            return IpoData {
                command_mode: Some(CommandMode::None),
                overlay: Some(Overlay::None),
                tracking: Some(0.0),
                ..IpoData::default()
            };
        }
        let has_pose = self.config.dialect != Dialect::V1;
        let is_cartesian = self.overlay.command == CommandMode::CartesianPose;
        IpoData {
            joints: Some(self.ipo),
            pose: has_pose.then(|| pose(&self.arm.body.pose_of(&self.ipo))),
            redundancy: has_pose.then(|| elbow(self.ipo[2])),
            command_mode: Some(self.overlay.command),
            overlay: Some(if is_cartesian {
                Overlay::Cartesian
            } else {
                Overlay::Joint
            }),
            tracking: Some(if is_active {
                self.window.answer_rate()
            } else {
                0.0
            }),
        }
    }
}

fn pose(flange: &Pose) -> Transformation {
    let rotation = Rotation3::from_matrix_unchecked(flange.rotation);
    let turn = UnitQuaternion::from_rotation_matrix(&rotation);
    let [x, y, z] = (flange.position * 1e3).into();
    Transformation {
        name: Name::new("flange").unwrap_or_default(),
        placement: Some(Placement::Quaternion([
            x, y, z, turn.w, turn.i, turn.j, turn.k,
        ])),
        stamp: None,
    }
}

/// The third axis stands in for the elbow angle, which the emulator does not compute.
fn elbow(value: f64) -> Redundancy {
    Redundancy {
        strategy: RedundancyStrategy::E1,
        value,
    }
}

/// The first ten whose names fit.
pub(super) fn ios(config: &[Io]) -> List<IoValue, IOS_MAX> {
    let mut ios = List::new();
    for io in config {
        let Some(name) = Name::new(&io.name) else {
            continue;
        };
        let (kind, digital, analog) = match io.level {
            IoLevel::Boolean(value) => (0.into(), Some(u64::from(value)), None),
            IoLevel::Digital(value) => (1.into(), Some(value), None),
            IoLevel::Analog(value) => (2.into(), None, Some(value)),
        };
        let _full = ios.push(IoValue {
            name,
            kind,
            direction: io.direction,
            digital,
            analog,
        });
    }
    ios
}

/// The first five whose names fit.
pub(super) fn frames(names: &[String]) -> List<Transformation, TRANSFORMATIONS_MAX> {
    let mut frames = List::new();
    for name in names.iter().filter_map(|name| Name::new(name)) {
        let _full = frames.push(Transformation {
            name,
            ..Transformation::default()
        });
    }
    frames
}
