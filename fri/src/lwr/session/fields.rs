//! The fields of a command besides joint positions: frame, added torques, stiffness and damping.

use super::Session;
use crate::guard::Violation;
use crate::lwr::wire::{Cmd, CmdFlags, Msr};
use crate::lwr::{AXES, Phase};

/// Values of the fields that [`Session::choose`] selects; sent with every answer until changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fields {
    /// Tool frame, 3x4 row-major, translation in m at indices 3, 7, 11; `None` mirrors the controller's.
    pub frame: Option<[f64; 12]>,
    /// Added joint torques, Nm.
    pub joint_torque: [f64; AXES],
    /// Added force at the tool, N, then torque about z, y, x, Nm.
    pub wrench: [f64; 6],
    /// Nm/rad, from 0.
    pub joint_stiffness: [f64; AXES],
    /// 0..=1.
    pub joint_damping: [f64; AXES],
    /// X, Y, Z in N/m, then about z, y, x in Nm/rad, from 0.
    pub cartesian_stiffness: [f64; 6],
    /// In the same order, 0..=1.
    pub cartesian_damping: [f64; 6],
}

impl Default for Fields {
    /// Stiff and well damped, nothing added.
    fn default() -> Self {
        Self {
            frame: None,
            joint_torque: [0.0; AXES],
            wrench: [0.0; 6],
            joint_stiffness: [1000.0; AXES],
            joint_damping: [0.7; AXES],
            cartesian_stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
            cartesian_damping: [0.7; 6],
        }
    }
}

/// Fields may not be chosen in command mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("command flags may change in monitor mode only: let the KRL program call friStop first")]
pub struct ChooseError;

impl Session {
    /// Chooses the fields of the next answers. Fields that the active control strategy does not allow are omitted; if no
    /// position is left, joint positions are sent.
    pub fn choose(&mut self, flags: CmdFlags) -> Result<(), ChooseError> {
        if self.phase == Phase::Command {
            return Err(ChooseError);
        }
        self.chosen = flags;
        Ok(())
    }

    /// Values of the chosen fields.
    pub fn fields_mut(&mut self) -> &mut Fields {
        &mut self.fields
    }

    /// The flags of the next answer.
    pub fn flags(&self) -> CmdFlags {
        let control = self.msr.as_ref().map(|msr| msr.robot.control);
        let allowed = control.map_or(CmdFlags::JNTPOS, CmdFlags::allowed);
        let flags = self.chosen.intersection(allowed);
        let has_position = flags.contains(CmdFlags::JNTPOS) || flags.contains(CmdFlags::CARTPOS);
        if has_position {
            flags
        } else {
            flags | CmdFlags::JNTPOS
        }
    }

    /// Writes the chosen fields. Outside command mode frames mirror the controller's, and nothing is added.
    pub(super) fn fill(&self, cmd: &mut Cmd, msr: &Msr) -> Option<Violation> {
        cmd.flags = self.flags();
        let fields = &self.fields;
        let mirrored = mirrored_frame(msr);
        cmd.frame = mirrored;
        cmd.joint_stiffness = fields.joint_stiffness.map(super::to_f32);
        cmd.joint_damping = fields.joint_damping.map(super::to_f32);
        cmd.cartesian_stiffness = fields.cartesian_stiffness.map(super::to_f32);
        cmd.cartesian_damping = fields.cartesian_damping.map(super::to_f32);
        if self.phase != Phase::Command {
            return None;
        }
        let frame = fields
            .frame
            .filter(|it| it.iter().all(|value| value.is_finite()));
        cmd.frame = frame.map_or(mirrored, |frame| frame.map(super::to_f32));
        let guard = &self.config.guard;
        let torque = guard.check_torque(&fields.joint_torque);
        if torque.is_ok() {
            cmd.joint_torque = fields.joint_torque.map(super::to_f32);
        }
        let wrench = guard.check_wrench(&fields.wrench);
        if wrench.is_ok() {
            cmd.wrench = fields.wrench.map(super::to_f32);
        }
        torque.and(wrench).err()
    }
}

/// The active frame: KRL's command plus FRI's offset.
fn mirrored_frame(msr: &Msr) -> [f32; 12] {
    let at = |frame: &[f32; 12], row: usize, column: usize| match (row, column) {
        (3, 3) => 1.0,
        (3, _) => 0.0,
        _ => frame[row * 4 + column],
    };
    std::array::from_fn(|i| {
        let (row, column) = (i / 4, i % 4);
        (0..4)
            .map(|k| at(&msr.commanded_frame, row, k) * at(&msr.frame_offset, k, column))
            .sum()
    })
}
