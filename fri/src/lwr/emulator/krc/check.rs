//! The rules for commands in command mode. Timing is checked once per cycle, elsewhere.

use super::{Krc, Received};
use crate::lwr::AXES;
use crate::lwr::emulator::{ExitReason, Parameter};
use crate::lwr::wire::{Cmd, CmdFlags, State};

/// Speed tolerance for the single precision of positions: half a bit at pi over 1 ms is 1.2e-4 rad/s.
const SPEED_ROUNDING: f64 = 5e-4;
/// Position tolerance for the same reason, rad.
const POSITION_ROUNDING: f64 = 5e-7;

impl Krc {
    pub(super) fn check(&self, received: &Received) -> Result<(), ExitReason> {
        let cmd = &received.cmd;
        if self.state != State::Cmd {
            return Ok(());
        }
        if received.sent.is_some_and(|sent| sent.in_command) {
            check_flags(self.flags, cmd.flags)?;
        }
        self.check_parameters(cmd)?;
        let Some(joints) = self.target(cmd)? else {
            return Ok(());
        };
        check_finite(&joints)?;
        match received.sent.filter(|sent| !sent.following) {
            Some(sent) => check_mirror(&joints, &sent.set_point, self.config.mirror_tolerance_rad),
            None if !self.follows() => Ok(()),
            None => {
                check_position(&joints, &self.config.limits.position_rad)?;
                self.check_speed(received, &joints)
            }
        }
    }

    /// Checks the fields that flags declare valid and the strategy allows.
    fn check_parameters(&self, cmd: &Cmd) -> Result<(), ExitReason> {
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
                    return Err(ExitReason::Parameter {
                        parameter,
                        index,
                        value,
                    });
                }
            }
        }
        Ok(())
    }

    fn check_speed(&self, received: &Received, joints: &[f64; AXES]) -> Result<(), ExitReason> {
        let span_s = self.cycles_since_last(received) * self.grid.period().as_secs_f64();
        for (joint, position) in joints.iter().enumerate() {
            let speed = (position - self.last.1[joint]) / span_s;
            let limit = self.config.limits.speed_rad_per_s[joint] * self.scale;
            if speed.abs() > limit + SPEED_ROUNDING {
                return Err(ExitReason::Speed {
                    joint,
                    speed,
                    limit,
                });
            }
        }
        Ok(())
    }
}

fn check_flags(first: Option<CmdFlags>, now: CmdFlags) -> Result<(), ExitReason> {
    match first {
        Some(from) if from != now => Err(ExitReason::FlagsChanged { from, to: now }),
        Some(_) | None => Ok(()),
    }
}

fn check_finite(joints: &[f64; AXES]) -> Result<(), ExitReason> {
    let bad = joints.iter().position(|position| !position.is_finite());
    bad.map_or(Ok(()), |joint| Err(ExitReason::NotFinite { joint }))
}

fn check_mirror(
    joints: &[f64; AXES],
    set_point: &[f64; AXES],
    tolerance: f64,
) -> Result<(), ExitReason> {
    for (joint, (commanded, expected)) in joints.iter().zip(set_point).enumerate() {
        if (commanded - expected).abs() > tolerance {
            let (commanded, expected) = (*commanded, *expected);
            return Err(ExitReason::Interpolation {
                joint,
                commanded,
                expected,
            });
        }
    }
    Ok(())
}

fn check_position(joints: &[f64; AXES], limits: &[f64; AXES]) -> Result<(), ExitReason> {
    for (joint, (position, limit)) in joints.iter().zip(limits).enumerate() {
        if position.abs() > *limit + POSITION_ROUNDING {
            return Err(ExitReason::Position {
                joint,
                position: *position,
                limit: *limit,
            });
        }
    }
    Ok(())
}
