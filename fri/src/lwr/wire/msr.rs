//! The measurement datagram, controller to PC. Successive measurements are related elsewhere.

use super::codec::{Reader, Writer};
use super::{Control, Header, Joints, Krl, Quality, State};
use crate::error::{DecodeError, EncodeError};
use crate::lwr::AXES;
use std::fmt;

/// A measurement (MSR), sent by the controller once per period.
///
/// Layout of FRI 1.0 as in the header that Stanford University publishes with its FRI library under Apache-2.0
/// (`FRICommunication.h`); meaning after Schreiber, Stemmer, Bischoff, "The Fast Research Interface for the KUKA
/// Lightweight Robot", ICRA 2010 workshop. Little endian, no padding, 916 bytes:
///
/// | offset | type | field | offset | type | field |
/// |--:|---|---|--:|---|---|
/// | 0 | u16\[4\] | [`Header`] | 292 | f32\[7\] | cmdJntPos |
/// | 8 | 132 bytes | [`Krl`] | 320 | f32\[7\] | cmdJntPosFriOffset |
/// | 140 | 20 bytes | [`Interface`] | 348 | f32\[12\] | cmdCartPos |
/// | 160 | 20 bytes | [`Statistics`] | 396 | f32\[12\] | cmdCartPosFriOffset |
/// | 180 | 36 bytes | [`Robot`] | 444 | f32\[7\] | msrJntTrq |
/// | 216 | f32\[7\] | msrJntPos | 472 | f32\[7\] | estExtJntTrq |
/// | 244 | f32\[12\] | msrCartPos | 500 | f32\[6\] | estExtTcpFT |
/// | 524 | f32\[42\] | jacobian | 692 | f32\[49\] | massMatrix |
/// | 888 | f32\[7\] | gravity | | | |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Msr {
    /// Sequence numbers.
    pub header: Header,
    /// User data written by the KRL program, `$FRI_TO_…`.
    pub krl: Krl,
    /// State and periods of the interface.
    pub interface: Interface,
    /// The controller's statistics of our answers.
    pub statistics: Statistics,
    /// Drives and control strategy.
    pub robot: Robot,
    /// Measured joint positions, rad.
    #[doc(alias = "msrJntPos")]
    pub measured_joints: [f32; AXES],
    /// Measured tool frame, 3x4 row-major, translation in m at indices 3, 7, 11.
    #[doc(alias = "msrCartPos")]
    pub measured_frame: [f32; 12],
    /// Joint positions commanded by the KRL interpolator, before FRI's offset, rad.
    #[doc(alias = "cmdJntPos")]
    pub commanded_joints: [f32; AXES],
    /// FRI's part of the joint set-point, rad.
    #[doc(alias = "cmdJntPosFriOffset")]
    pub joint_offset: [f32; AXES],
    /// Commanded tool frame before FRI's offset, 3x4 row-major, m.
    #[doc(alias = "cmdCartPos")]
    pub commanded_frame: [f32; 12],
    /// FRI's part of the commanded frame, 3x4 row-major, m.
    #[doc(alias = "cmdCartPosFriOffset")]
    pub frame_offset: [f32; 12],
    /// Measured joint torques, Nm.
    #[doc(alias = "msrJntTrq")]
    pub measured_torque: [f32; AXES],
    /// Estimated external joint torques, Nm.
    #[doc(alias = "estExtJntTrq")]
    pub external_torque: [f32; AXES],
    /// Estimated external force and torque at the tool: Fx, Fy, Fz in N, then Tz, Ty, Tx in Nm (sic).
    #[doc(alias = "estExtTcpFT")]
    pub external_wrench: [f32; 6],
    /// 6x7 row-major; rows X, Y, Z, RZ, RY, RX (sic), per rad.
    pub jacobian: [f32; 42],
    /// 7x7 row-major, kg m2.
    pub mass_matrix: [f32; 49],
    /// Gravity torques, Nm (the header's comment says m/s2; its users read seven torques).
    pub gravity: [f32; AXES],
}

/// State and periods, at offset 140 of [`Msr`]: f32 timestamp, u16 state, u16 quality, f32 desiredMsrSampleTime,
/// f32 desiredCmdSampleTime, f32 safetyLimits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interface {
    /// Time of the controller, s. An f32: after an hour its resolution is 0.2 ms.
    pub timestamp_s: f32,
    /// Monitor or command mode.
    pub state: State,
    /// The controller's rating of our timing.
    pub quality: Quality,
    /// Period of measurements, s, above 0.
    #[doc(alias = "desiredMsrSampleTime")]
    pub msr_period_s: f32,
    /// Period in which commands are expected, s, above 0.
    #[doc(alias = "desiredCmdSampleTime")]
    pub cmd_period_s: f32,
    /// Scale of the controller's limits given to friStart, 0..=1.
    #[doc(alias = "safetyLimits")]
    pub safety_scale: f32,
}

/// Averages over the last 100 datagrams, at offset 160 of [`Msr`]: f32 answerRate, f32 latency, f32 jitter,
/// f32 missRate, u32 missCounter.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Statistics {
    /// Share of measurements answered in time, 0..=1.
    pub answer_rate: f32,
    /// Time from measurement to answer as seen by the controller, s.
    pub latency_s: f32,
    /// Variation of that time, s.
    pub jitter_s: f32,
    /// Share of measurements not answered in time, 0..=1.
    pub miss_rate: f32,
    /// Number of missing answers since the interface was opened.
    pub miss_counter: u32,
}

/// Drives and strategy, at offset 180 of [`Msr`]: u16 power, u16 control, u16 error, u16 warning, f32\[7\] temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Robot {
    /// One bit per drive with power; 0x7f is all seven.
    pub power: u16,
    /// Control strategy in force.
    pub control: Control,
    /// Drive errors, one bit each; they switch the power off.
    pub error: u16,
    /// Drive warnings, one bit each.
    pub warning: u16,
    /// Drive temperatures, unit not published.
    pub temperature: [f32; AXES],
}

impl Msr {
    /// Length of the datagram, bytes.
    pub const LEN: usize = 916;
    /// Its datagramId, which is also the version of its layout.
    pub const ID: u16 = 0x2006;
    const PACKET_SIZE: u16 = 916;

    /// The joint set-point: KRL's command plus FRI's offset, rad. Clients mirror it.
    pub fn set_point(&self) -> [f64; AXES] {
        let mut sum = self.commanded_joints.map(f64::from);
        for (sum, offset) in sum.iter_mut().zip(self.joint_offset) {
            *sum += f64::from(offset);
        }
        sum
    }

    /// Whether the robot follows commands: command mode and at least one drive with power.
    pub fn is_commanding(&self) -> bool {
        self.interface.state == State::Cmd && self.robot.power != 0
    }

    /// Reads a datagram; every value of every field is accepted, only length, packetSize and id are checked.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let mut from = Reader::new(bytes, Self::LEN)?;
        let from = &mut from;
        Ok(Self {
            header: Header::read(from, Self::PACKET_SIZE, Self::ID)?,
            krl: Krl::read(from)?,
            interface: Interface::read(from)?,
            statistics: Statistics::read(from)?,
            robot: Robot::read(from)?,
            measured_joints: from.f32s()?,
            measured_frame: from.f32s()?,
            commanded_joints: from.f32s()?,
            joint_offset: from.f32s()?,
            commanded_frame: from.f32s()?,
            frame_offset: from.f32s()?,
            measured_torque: from.f32s()?,
            external_torque: from.f32s()?,
            external_wrench: from.f32s()?,
            jacobian: from.f32s()?,
            mass_matrix: from.f32s()?,
            gravity: from.f32s()?,
        })
    }

    /// Writes the datagram to the front of `buf` and returns its length.
    pub fn encode(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        let mut to = Writer::new(buf, Self::LEN)?;
        self.header.write(&mut to, Self::PACKET_SIZE, Self::ID)?;
        self.krl.write(&mut to)?;
        self.interface.write(&mut to)?;
        self.statistics.write(&mut to)?;
        self.robot.write(&mut to)?;
        to.f32s(&self.measured_joints)?;
        to.f32s(&self.measured_frame)?;
        to.f32s(&self.commanded_joints)?;
        to.f32s(&self.joint_offset)?;
        to.f32s(&self.commanded_frame)?;
        to.f32s(&self.frame_offset)?;
        to.f32s(&self.measured_torque)?;
        to.f32s(&self.external_torque)?;
        to.f32s(&self.external_wrench)?;
        to.f32s(&self.jacobian)?;
        to.f32s(&self.mass_matrix)?;
        to.f32s(&self.gravity)?;
        Ok(Self::LEN)
    }
}

impl Interface {
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            timestamp_s: from.f32()?,
            state: from.u16()?.into(),
            quality: from.u16()?.into(),
            msr_period_s: from.f32()?,
            cmd_period_s: from.f32()?,
            safety_scale: from.f32()?,
        })
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        to.f32(self.timestamp_s)?;
        to.u16(self.state.code())?;
        to.u16(self.quality.code())?;
        to.f32s(&[self.msr_period_s, self.cmd_period_s, self.safety_scale])
    }
}

impl Statistics {
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            answer_rate: from.f32()?,
            latency_s: from.f32()?,
            jitter_s: from.f32()?,
            miss_rate: from.f32()?,
            miss_counter: from.u32()?,
        })
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        to.f32s(&[
            self.answer_rate,
            self.latency_s,
            self.jitter_s,
            self.miss_rate,
        ])?;
        to.u32(self.miss_counter)
    }
}

impl Robot {
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            power: from.u16()?,
            control: from.u16()?.into(),
            error: from.u16()?,
            warning: from.u16()?,
            temperature: from.f32s()?,
        })
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        to.u16(self.power)?;
        to.u16(self.control.code())?;
        to.u16(self.error)?;
        to.u16(self.warning)?;
        to.f32s(&self.temperature)
    }
}

impl fmt::Display for Msr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            header,
            interface,
            statistics,
            robot,
            ..
        } = self;
        write!(f, "MSR seq {} refl {}", header.sequence, header.reflected)?;
        write!(
            f,
            " t {:.3} s {} {}",
            interface.timestamp_s, interface.state, interface.quality
        )?;
        write!(f, " T {} ms", interface.msr_period_s * 1e3)?;
        write!(f, " power {:#04x} {}", robot.power, robot.control)?;
        if (robot.error, robot.warning) != (0, 0) {
            write!(
                f,
                " error {:#06x} warning {:#06x}",
                robot.error, robot.warning
            )?;
        }
        write!(
            f,
            " answered {:.2} latency {:.3} ms jitter {:.3} ms missed {}",
            statistics.answer_rate,
            statistics.latency_s * 1e3,
            statistics.jitter_s * 1e3,
            statistics.miss_counter
        )?;
        write!(f, " q {} rad", Joints(&self.measured_joints))
    }
}
