//! The rules a command must keep in command mode. Timing is judged elsewhere, once per cycle.

use super::{Krc, Received};
use crate::lwr::AXES;
use crate::lwr::emulator::{Leave, Parameter};
use crate::lwr::wire::{Cmd, CmdFlags, State};

/// Allowance on a speed for the single precision of positions: half a bit at pi over 1 ms is 1.2e-4 rad/s.
const SPEED_ROUNDING: f64 = 5e-4;
/// The same on a position, rad.
const POSITION_ROUNDING: f64 = 5e-7;

impl Krc {
    pub(super) fn judge(&self, received: &Received) -> Result<(), Leave> {
        let cmd = &received.cmd;
        if self.state != State::Cmd {
            return Ok(());
        }
        if received.sent.is_some_and(|sent| sent.in_command) {
            judge_flags(self.flags, cmd.flags)?;
        }
        self.judge_parameters(cmd)?;
        let Some(joints) = self.target(cmd)? else {
            return Ok(());
        };
        judge_finite(&joints)?;
        match received.sent.filter(|sent| !sent.following) {
            Some(sent) => judge_mirror(&joints, &sent.set_point, self.config.mirror_tolerance_rad),
            None if !self.follows() => Ok(()),
            None => {
                judge_position(&joints, &self.config.limits.position_rad)?;
                self.judge_speed(received, &joints)
            }
        }
    }

    /// The fields that flags declare valid and the strategy allows, one by one.
    fn judge_parameters(&self, cmd: &Cmd) -> Result<(), Leave> {
        let flags = cmd.flags.intersection(CmdFlags::allowed(self.control));
        let torque_max = &self.config.limits.torque_nm;
        for parameter in Parameter::ALL {
            if !flags.contains(parameter.flag()) {
                continue;
            }
            for (index, value) in parameter.values(cmd).iter().enumerate() {
                let value = f64::from(*value);
                let [low, high] = parameter.range(torque_max.get(index).copied());
                if !(low..=high).contains(&value) || value.is_infinite() {
                    return Err(Leave::Parameter {
                        parameter,
                        index,
                        value,
                    });
                }
            }
        }
        Ok(())
    }

    fn judge_speed(&self, received: &Received, joints: &[f64; AXES]) -> Result<(), Leave> {
        let span_s = self.cycles_since_last(received) * self.grid.period().as_secs_f64();
        for (joint, position) in joints.iter().enumerate() {
            let speed = (position - self.last.1[joint]) / span_s;
            let limit = self.config.limits.speed_rad_per_s[joint] * self.scale;
            if speed.abs() > limit + SPEED_ROUNDING {
                return Err(Leave::Speed {
                    joint,
                    speed,
                    limit,
                });
            }
        }
        Ok(())
    }
}

fn judge_flags(first: Option<CmdFlags>, now: CmdFlags) -> Result<(), Leave> {
    match first {
        Some(from) if from != now => Err(Leave::FlagsChanged { from, to: now }),
        Some(_) | None => Ok(()),
    }
}

fn judge_finite(joints: &[f64; AXES]) -> Result<(), Leave> {
    let bad = joints.iter().position(|position| !position.is_finite());
    bad.map_or(Ok(()), |joint| Err(Leave::NotFinite { joint }))
}

fn judge_mirror(
    joints: &[f64; AXES],
    set_point: &[f64; AXES],
    tolerance: f64,
) -> Result<(), Leave> {
    for (joint, (commanded, expected)) in joints.iter().zip(set_point).enumerate() {
        if (commanded - expected).abs() > tolerance {
            let (commanded, expected) = (*commanded, *expected);
            return Err(Leave::Interpolation {
                joint,
                commanded,
                expected,
            });
        }
    }
    Ok(())
}

fn judge_position(joints: &[f64; AXES], limits: &[f64; AXES]) -> Result<(), Leave> {
    for (joint, (position, limit)) in joints.iter().zip(limits).enumerate() {
        if position.abs() > *limit + POSITION_ROUNDING {
            return Err(Leave::Position {
                joint,
                position: *position,
                limit: *limit,
            });
        }
    }
    Ok(())
}
