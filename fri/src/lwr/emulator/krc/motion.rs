//! How the arm follows commands under each control strategy. Rules and timing are checked elsewhere.

use super::{Krc, Received};
use crate::emulator::{Law, Pose};
use crate::lwr::AXES;
use crate::lwr::emulator::{ExitReason, Stiffness};
use crate::lwr::wire::{Cmd, CmdFlags, Control};
use nalgebra::{Matrix3, Vector3};

impl Krc {
    pub(super) fn move_joints(&mut self) {
        let received = self.inbox.take();
        if self.follows() && !self.following {
            self.last = (self.grid.index().saturating_sub(1), self.arm.set_point);
        }
        if let Some(reason) = received
            .as_ref()
            .and_then(|received| self.check(received).err())
        {
            self.leave(reason);
        }
        let in_command = received
            .as_ref()
            .filter(|it| it.sent.is_some_and(|sent| sent.in_command));
        self.flags = self
            .flags
            .or_else(|| in_command.map(|received| received.cmd.flags));
        let followed = self.following;
        self.following = self.follows();
        if followed && !self.following {
            self.drop_additions();
        }
        match received {
            _ if !self.following => self.arm.brake(&self.brake_step),
            Some(received) => self.follow(&received),
            None => self.arm.extrapolate(&self.config.limits.position_rad),
        }
        self.settle();
    }

    fn settle(&mut self) {
        let span_s = self.grid.period().as_secs_f64();
        if self.has_power() || !self.arm.is_at_rest() {
            let law = self.law();
            self.arm.settle(&law, span_s);
        } else {
            // Brakes hold the joints; the set-point stays there for the return of power.
            self.arm.body.freeze();
            self.arm.sync_set_point();
        }
    }

    /// Drops the client's additions. A compliant arm stays where its contact has pushed it.
    pub(super) fn drop_additions(&mut self) {
        self.stiffness = self.config.stiffness;
        (self.added_torque, self.added_wrench) = ([0.0; AXES], [0.0; 6]);
        if self.control != Control::Position {
            self.arm.sync_set_point();
        }
    }

    /// Joint positions that a command requests; `None` if it has no position.
    pub(super) fn target(&self, cmd: &Cmd) -> Result<Option<[f64; AXES]>, ExitReason> {
        let flags = cmd.flags.intersection(CmdFlags::allowed(self.control));
        let joints = cmd.joints.map(f64::from);
        if flags.contains(CmdFlags::CARTPOS) {
            let frame = cmd.frame.map(f64::from);
            if let Some(joint) = frame.iter().position(|value| !value.is_finite()) {
                return Err(ExitReason::NotFinite {
                    joint: joint.min(AXES - 1),
                });
            }
            let near = if self.following {
                self.last.1
            } else {
                self.arm.set_point
            };
            let reached = self.arm.body.reach(&near, &pose(&frame));
            return reached.map(Some).ok_or(ExitReason::OutOfReach);
        }
        Ok(flags.contains(CmdFlags::JNTPOS).then_some(joints))
    }

    fn follow(&mut self, received: &Received) {
        let is_motion = received.sent.is_none_or(|sent| sent.following);
        let target = self.target(&received.cmd).ok().flatten();
        match target.filter(|_| is_motion) {
            Some(target) => {
                let cycles = self.cycles_since_last(received);
                self.arm.follow(&target, &self.last.1, cycles, 1);
                self.last = (self.cycle_of(received), target);
            }
            None => self.arm.hold(),
        }
        self.apply_parameters(&received.cmd);
    }

    /// Applies the fields that flags declare valid and the strategy allows; the others keep their `$STIFFNESS` value.
    fn apply_parameters(&mut self, cmd: &Cmd) {
        let flags = cmd.flags.intersection(CmdFlags::allowed(self.control));
        let has = |flag| flags.contains(flag);
        let Stiffness {
            joint_stiffness,
            joint_damping,
            cartesian_stiffness,
            cartesian_damping,
        } = &mut self.stiffness;
        if has(CmdFlags::JNTSTIFF) {
            *joint_stiffness = cmd.joint_stiffness.map(f64::from);
        }
        if has(CmdFlags::JNTDAMP) {
            *joint_damping = cmd.joint_damping.map(f64::from);
        }
        if has(CmdFlags::CARTSTIFF) {
            *cartesian_stiffness = cmd.cartesian_stiffness.map(f64::from);
        }
        if has(CmdFlags::CARTDAMP) {
            *cartesian_damping = cmd.cartesian_damping.map(f64::from);
        }
        if has(CmdFlags::JNTTRQ) {
            self.added_torque = cmd.joint_torque.map(f64::from);
        }
        if has(CmdFlags::TCPFT) {
            self.added_wrench = cmd.wrench.map(f64::from);
        }
    }

    fn law(&self) -> Law {
        let Stiffness {
            joint_stiffness,
            joint_damping,
            cartesian_stiffness,
            cartesian_damping,
        } = self.stiffness;
        match self.control {
            Control::JointImpedance => Law::Joint {
                stiffness: joint_stiffness,
                damping: joint_damping,
                overlay: self.added_torque,
            },
            Control::CartesianImpedance => Law::Cartesian {
                stiffness: turned(&cartesian_stiffness),
                damping: turned(&cartesian_damping),
                overlay: turned(&self.added_wrench),
            },
            Control::Position | Control::Unspecified | Control::Other(_) => Law::Position,
        }
    }

    /// The cycle whose measurement a command reflects; if unknown, the one after the last command.
    fn cycle_of(&self, received: &Received) -> u64 {
        let unknown = self.last.0 + 1;
        received
            .sent
            .map_or(unknown, |sent| sent.index)
            .max(self.last.0)
    }

    pub(super) fn cycles_since_last(&self, received: &Received) -> f64 {
        let cycles = self.cycle_of(received) - self.last.0;
        f64::from(u32::try_from(cycles).unwrap_or(u32::MAX)).max(1.0)
    }
}

/// Converts between the order X, Y, Z, Rz, Ry, Rx of the datagrams and X, Y, Z, Rx, Ry, Rz.
pub(super) fn turned(values: &[f64; 6]) -> [f64; 6] {
    let [x, y, z, c, b, a] = *values;
    [x, y, z, a, b, c]
}

/// Pose from a 3x4 row-major frame.
fn pose(frame: &[f64; 12]) -> Pose {
    let [a, b, c, x, d, e, f, y, g, h, i, z] = *frame;
    Pose {
        rotation: Matrix3::new(a, b, c, d, e, f, g, h, i),
        position: Vector3::new(x, y, z),
    }
}
