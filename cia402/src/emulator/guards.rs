//! Fault detection of the drive: following error, temperature, voltage, loss of the master. How the drive stops is
//! decided elsewhere.

use std::fmt;

use crate::error_text;

/// An error code as object 603Fh and the emergency message carry it (CiA 402-1, IEC 61800-7-201).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[doc(alias = "603Fh")]
pub struct FaultCode(pub u16);

impl FaultCode {
    /// No error, or the error is reset.
    pub const NONE: Self = Self(0x0000);
    /// Short circuit at the output.
    pub const SHORT_CIRCUIT: Self = Self(0x2320);
    /// The DC link has too much voltage.
    pub const OVER_VOLTAGE: Self = Self(0x3210);
    /// The DC link has too little voltage.
    pub(crate) const UNDER_VOLTAGE: Self = Self(0x3220);
    /// The control of the power stage failed; drives with a weak supply show it while they are enabled.
    pub(crate) const POWER_STAGE: Self = Self(0x5201);
    /// Drive or motor is too hot.
    pub const TEMPERATURE: Self = Self(0x4310);
    /// The incremental encoder failed.
    pub const ENCODER: Self = Self(0x7305);
    /// Heartbeat or guarding of the master stopped.
    pub const HEARTBEAT: Self = Self(0x8130);
    /// A received PDO is too short.
    pub const PDO_LENGTH: Self = Self(0x8210);
    /// An expected PDO is missing.
    pub const PDO_TIMEOUT: Self = Self(0x8250);
    /// The position does not follow.
    pub(crate) const FOLLOWING_ERROR: Self = Self(0x8611);
    /// A cyclic set-point is missing.
    pub const SYNC: Self = Self(0x8700);

    /// The bits of the error register 1001h for this code.
    pub const fn register(self) -> u8 {
        match self.0 >> 8 {
            0x00 => 0,
            0x20..=0x2F => 0x03,
            0x30..=0x3F => 0x05,
            0x40..=0x4F => 0x09,
            0x81 | 0x82 => 0x11,
            0x83..=0x87 => 0x21,
            0xFF => 0x81,
            _ => 0x01,
        }
    }
}

impl fmt::Display for FaultCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:04X}h)", error_text(self.0), self.0)
    }
}

/// Values that the guards check in each step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Watched {
    /// Demand less actual position, user units; `None` where no position is followed.
    pub(super) following_error: Option<f64>,
    pub(super) window: u32,
    /// s
    pub(super) timeout: f64,
    /// 1 is the temperature limit.
    pub(super) heat: f64,
    /// V
    pub(super) dc_link: f64,
    /// The power stage is on.
    pub(super) powered: bool,
    /// s
    pub(super) dt: f64,
}

/// Allowed DC link voltages, V.
pub(super) const DC_LINK: (f64, f64) = (20.0, 60.0);
/// Fraction of the temperature limit above which the drive warns.
pub(super) const WARM: f64 = 0.8;

/// Timers of the guards.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Guards {
    /// How long the following error has been out of its window, s.
    outside: f64,
}

impl Guards {
    /// Whether the following error is out of its window, long enough or not.
    pub(super) fn is_outside(&self) -> bool {
        self.outside > 0.0
    }

    /// The present fault, if any.
    pub(super) fn step(&mut self, seen: &Watched) -> Option<FaultCode> {
        let off = seen.window == u32::MAX;
        let outside = |error: f64| !off && error.abs() > f64::from(seen.window);
        if seen.powered && seen.following_error.is_some_and(outside) {
            self.outside += seen.dt;
        } else {
            self.outside = 0.0;
        }
        let (low, high) = DC_LINK;
        if self.outside > seen.timeout {
            Some(FaultCode::FOLLOWING_ERROR)
        } else if seen.heat > 1.0 {
            Some(FaultCode::TEMPERATURE)
        } else if seen.dc_link > high {
            Some(FaultCode::OVER_VOLTAGE)
        } else if seen.dc_link < low && seen.powered {
            Some(FaultCode::UNDER_VOLTAGE)
        } else {
            None
        }
    }
}
