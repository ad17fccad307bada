//! The command datagram, PC to controller. It does not check that flags fit a control strategy.

use super::codec::{Reader, Writer};
use super::{CmdFlags, Header, Joints, Krl};
use crate::error::{DecodeError, EncodeError};
use crate::lwr::AXES;
use std::fmt;

/// A command (CMD), sent by the PC once per measurement.
///
/// Source of the layout as for [`super::Msr`]. Little endian, no padding, 376 bytes:
///
/// | offset | type | field | flag |
/// |--:|---|---|---|
/// | 0 | u16\[4\] | [`Header`] | |
/// | 8 | 132 bytes | [`Krl`] | |
/// | 140 | u32 | cmdFlags | |
/// | 144 | f32\[7\] | jntPos | `JNTPOS` |
/// | 172 | f32\[12\] | cartPos | `CARTPOS` |
/// | 220 | f32\[7\] | addJntTrq | `JNTTRQ` |
/// | 248 | f32\[6\] | addTcpFT | `TCPFT` |
/// | 272 | f32\[7\] | jntStiffness | `JNTSTIFF` |
/// | 300 | f32\[7\] | jntDamping | `JNTDAMP` |
/// | 328 | f32\[6\] | cartStiffness | `CARTSTIFF` |
/// | 352 | f32\[6\] | cartDamping | `CARTDAMP` |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cmd {
    /// Sequence numbers.
    pub header: Header,
    /// User data for the KRL program, `$FRI_FRM_…`.
    pub krl: Krl,
    /// Which of the fields below are valid; may change in monitor mode only.
    #[doc(alias = "cmdFlags")]
    pub flags: CmdFlags,
    /// Joint positions, rad.
    #[doc(alias = "jntPos")]
    pub joints: [f32; AXES],
    /// Tool frame, 3x4 row-major, translation in m at indices 3, 7, 11.
    #[doc(alias = "cartPos")]
    pub frame: [f32; 12],
    /// Added joint torques, Nm.
    #[doc(alias = "addJntTrq")]
    pub joint_torque: [f32; AXES],
    /// Added force and torque at the tool: Fx, Fy, Fz in N, then Tz, Ty, Tx in Nm (sic).
    #[doc(alias = "addTcpFT")]
    pub wrench: [f32; 6],
    /// Joint stiffness, Nm/rad, from 0.
    #[doc(alias = "jntStiffness")]
    pub joint_stiffness: [f32; AXES],
    /// Joint damping, normalised, 0..=1.
    #[doc(alias = "jntDamping")]
    pub joint_damping: [f32; AXES],
    /// Cartesian stiffness: X, Y, Z in N/m, then A, B, C (about z, y, x) in Nm/rad, from 0.
    #[doc(alias = "cartStiffness")]
    pub cartesian_stiffness: [f32; 6],
    /// Cartesian damping in the same order, normalised, 0..=1.
    #[doc(alias = "cartDamping")]
    pub cartesian_damping: [f32; 6],
}

impl Cmd {
    /// Length of the datagram, bytes.
    pub const LEN: usize = 376;
    /// Its datagramId, which is also the version of its layout.
    pub const ID: u16 = 0x1005;
    const PACKET_SIZE: u16 = 376;

    /// Reads a datagram; every value of every field is accepted, only length, packetSize and id are checked.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut from = Reader::new(bytes, Self::LEN)?;
        let from = &mut from;
        Ok(Self {
            header: Header::read(from, Self::PACKET_SIZE, Self::ID)?,
            krl: Krl::read(from)?,
            flags: CmdFlags::from_bits(from.u32()?),
            joints: from.f32s()?,
            frame: from.f32s()?,
            joint_torque: from.f32s()?,
            wrench: from.f32s()?,
            joint_stiffness: from.f32s()?,
            joint_damping: from.f32s()?,
            cartesian_stiffness: from.f32s()?,
            cartesian_damping: from.f32s()?,
        })
    }

    /// Writes the datagram to the front of `buf` and returns its length.
    pub fn encode(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        let mut to = Writer::new(buf, Self::LEN)?;
        self.header.write(&mut to, Self::PACKET_SIZE, Self::ID)?;
        self.krl.write(&mut to)?;
        to.u32(self.flags.bits())?;
        to.f32s(&self.joints)?;
        to.f32s(&self.frame)?;
        to.f32s(&self.joint_torque)?;
        to.f32s(&self.wrench)?;
        to.f32s(&self.joint_stiffness)?;
        to.f32s(&self.joint_damping)?;
        to.f32s(&self.cartesian_stiffness)?;
        to.f32s(&self.cartesian_damping)?;
        Ok(Self::LEN)
    }
}

impl fmt::Display for Cmd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { header, flags, .. } = self;
        write!(
            f,
            "CMD seq {} refl {} {flags}",
            header.sequence, header.reflected
        )?;
        if flags.contains(CmdFlags::JNTPOS) {
            write!(f, " q {} rad", Joints(&self.joints))?;
        }
        Ok(())
    }
}
