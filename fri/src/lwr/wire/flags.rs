//! Which fields of a command datagram are valid. It does not know which of them a control strategy accepts.

use super::Control;
use std::fmt;
use std::ops::BitOr;

/// The `cmdFlags` bit field; unknown bits are kept.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct CmdFlags(u32);

/// Known bits with the names of the published header.
const NAMES: [(CmdFlags, &str); 10] = [
    (CmdFlags::JNTPOS, "JNTPOS"),
    (CmdFlags::JNTVEL, "JNTVEL"),
    (CmdFlags::JNTTRQ, "JNTTRQ"),
    (CmdFlags::JNTSTIFF, "JNTSTIFF"),
    (CmdFlags::JNTDAMP, "JNTDAMP"),
    (CmdFlags::CARTPOS, "CARTPOS"),
    (CmdFlags::CARTVEL, "CARTVEL"),
    (CmdFlags::TCPFT, "TCPFT"),
    (CmdFlags::CARTSTIFF, "CARTSTIFF"),
    (CmdFlags::CARTDAMP, "CARTDAMP"),
];

impl CmdFlags {
    /// No field is valid.
    pub const NONE: Self = Self(0);
    /// [`super::Cmd::joints`] is valid.
    pub const JNTPOS: Self = Self(0x0001);
    /// Reserved by the layout, supported by no known controller.
    pub(crate) const JNTVEL: Self = Self(0x0002);
    /// [`super::Cmd::joint_torque`] is valid.
    pub const JNTTRQ: Self = Self(0x0004);
    /// [`super::Cmd::joint_stiffness`] is valid.
    pub const JNTSTIFF: Self = Self(0x0010);
    /// [`super::Cmd::joint_damping`] is valid.
    pub const JNTDAMP: Self = Self(0x0020);
    /// [`super::Cmd::frame`] is valid.
    pub const CARTPOS: Self = Self(0x0100);
    /// Reserved by the layout, supported by no known controller.
    pub(crate) const CARTVEL: Self = Self(0x0200);
    /// [`super::Cmd::wrench`] is valid.
    pub const TCPFT: Self = Self(0x0400);
    /// [`super::Cmd::cartesian_stiffness`] is valid.
    pub const CARTSTIFF: Self = Self(0x1000);
    /// [`super::Cmd::cartesian_damping`] is valid.
    pub const CARTDAMP: Self = Self(0x2000);

    /// Flags from raw bits.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// Raw bits as on the wire.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// The fields that a controller accepts under a control strategy; joint positions only under an unknown one.
    pub fn allowed(control: Control) -> Self {
        match control {
            Control::JointImpedance => Self::JNTPOS | Self::JNTSTIFF | Self::JNTDAMP | Self::JNTTRQ,
            Control::CartesianImpedance => {
                Self::JNTPOS | Self::CARTPOS | Self::CARTSTIFF | Self::CARTDAMP | Self::TCPFT
            }
            Control::Position | Control::Unspecified | Control::Other(_) => Self::JNTPOS,
        }
    }

    /// The bits set in both.
    #[must_use]
    pub const fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Whether every bit of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl BitOr for CmdFlags {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl fmt::Display for CmdFlags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut unknown = self.0;
        let mut separator = "";
        for (flag, name) in NAMES.into_iter().filter(|(flag, _)| self.contains(*flag)) {
            write!(f, "{separator}{name}")?;
            separator = "|";
            unknown &= !flag.0;
        }
        match (self.0, unknown) {
            (0, _) => f.write_str("none"),
            (_, 0) => Ok(()),
            (_, unknown) => write!(f, "{separator}{unknown:#x}"),
        }
    }
}

impl fmt::Debug for CmdFlags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CmdFlags({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_display_named_and_unknown_bits() {
        assert_eq!(CmdFlags::NONE.to_string(), "none");
        assert_eq!(
            (CmdFlags::JNTPOS | CmdFlags::CARTDAMP).to_string(),
            "JNTPOS|CARTDAMP"
        );
        assert_eq!(CmdFlags::from_bits(0x8001).to_string(), "JNTPOS|0x8000");
        assert_eq!(CmdFlags::from_bits(0x8000).to_string(), "0x8000");
    }

    #[test]
    fn flags_contains_requires_every_bit() {
        let flags = CmdFlags::JNTPOS | CmdFlags::JNTSTIFF;
        assert!(flags.contains(CmdFlags::JNTPOS));
        assert!(!flags.contains(CmdFlags::JNTPOS | CmdFlags::JNTDAMP));
    }
}
