//! The measurement of an emulated KRC.

use super::motion::turned;
use super::{ALL_DRIVES, Krc};
use crate::emulator::{INERTIA, Pose, Sent, Window};
use crate::lwr::AXES;
use crate::lwr::wire::{Header, Interface, Msr, Robot, State, Statistics};
use std::time::Duration;

impl Krc {
    pub(super) fn measure(&mut self, now: Duration) {
        if self.state != State::Cmd {
            self.base = self.arm.set_point;
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.counters.sent += 1;
        self.history.push(Sent {
            sequence: self.sequence.into(),
            index: self.grid.index(),
            at: now,
            set_point: self.arm.set_point,
            in_command: self.state == State::Cmd,
            following: self.following,
        });
        let mut bytes = [0; Msr::LEN];
        if self.measurement().encode(&mut bytes).is_ok() {
            let (behind, faults) = (self.behind(), &mut self.config.faults.to_client);
            self.to_client
                .push(&bytes, now, behind, faults, &mut self.random);
        }
    }

    fn measurement(&self) -> Msr {
        let mut offset = self.arm.set_point;
        for (offset, base) in offset.iter_mut().zip(self.base) {
            *offset -= base;
        }
        let body = &self.arm.body;
        let commanded = body.pose_of(&self.base);
        let sensed = self.sensor.estimate();
        let [x, y, z] = sensed.force.map(to_f32);
        let [a, b, c] = sensed.moment.map(to_f32);
        Msr {
            header: Header {
                sequence: self.sequence,
                reflected: u16::try_from(self.tracker.newest()).unwrap_or(0),
            },
            krl: self.krl_out,
            interface: self.interface(),
            statistics: statistics(&self.window),
            robot: self.robot(),
            measured_joints: body.joints().map(to_f32),
            measured_frame: frame(&body.pose()),
            commanded_joints: self.base.map(to_f32),
            joint_offset: offset.map(to_f32),
            commanded_frame: frame(&commanded),
            frame_offset: frame(&commanded.to(&body.pose_of(&self.arm.set_point))),
            measured_torque: body.measured_torque().map(to_f32),
            external_torque: sensed.joints.map(to_f32),
            external_wrench: [x, y, z, c, b, a],
            jacobian: self.jacobian(),
            mass_matrix: mass_matrix(),
            gravity: body.gravity().map(to_f32),
        }
    }

    fn interface(&self) -> Interface {
        let period_s = self.grid.period().as_secs_f32();
        Interface {
            timestamp_s: self.grid.time().as_secs_f32(),
            state: self.state,
            quality: self.quality,
            msr_period_s: period_s,
            cmd_period_s: period_s,
            safety_scale: to_f32(self.scale),
        }
    }

    fn robot(&self) -> Robot {
        Robot {
            power: if self.has_power() { ALL_DRIVES } else { 0 },
            control: self.control,
            error: 0,
            warning: 0,
            temperature: [25.0; AXES],
        }
    }

    /// Rows X, Y, Z, RZ, RY, RX.
    fn jacobian(&self) -> [f32; 42] {
        let mut rows = [0.0; 42];
        for (axis, column) in self.arm.body.jacobian().0.iter().enumerate() {
            for (row, value) in turned(column).into_iter().enumerate() {
                rows[row * AXES + axis] = to_f32(value);
            }
        }
        rows
    }
}

fn mass_matrix() -> [f32; 49] {
    let mut matrix = [0.0; 49];
    for (joint, inertia) in INERTIA.into_iter().enumerate() {
        matrix[joint * (AXES + 1)] = to_f32(inertia);
    }
    matrix
}

/// As 3x4 row-major.
fn frame(pose: &Pose) -> [f32; 12] {
    let (r, p) = (&pose.rotation, &pose.position);
    std::array::from_fn(|i| {
        let (row, column) = (i / 4, i % 4);
        to_f32(if column == 3 {
            p[row]
        } else {
            r[(row, column)]
        })
    })
}

fn statistics(window: &Window) -> Statistics {
    let (latency_s, jitter_s) = window.latency_and_jitter();
    Statistics {
        answer_rate: to_f32(window.answer_rate()),
        latency_s: to_f32(latency_s),
        jitter_s: to_f32(jitter_s),
        miss_rate: to_f32(window.miss_rate()),
        miss_counter: window.missed(),
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the wire has single precision"
)]
pub(super) fn to_f32(value: f64) -> f32 {
    value as f32
}
