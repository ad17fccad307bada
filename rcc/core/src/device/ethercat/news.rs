//! What the driver of a segment reports: values out of the real-time thread, of which texts are made by who takes them. It
//! does not decide when.

use std::fmt;

use takt_ethercat::config::IMAGE_MAX;
use takt_ethercat::master::{Difference, EmergencyReport, Event};

use super::arm::AxisNews;
use super::io::Lack;
use crate::device::driver::{Notice, Severity};
use crate::device::drives::{self, JointNews};

/// What is told of a segment.
#[derive(Debug)]
pub(super) enum News {
    Event(Event),
    Emergency(EmergencyReport),
    Difference(Difference),
    /// It is as expected again, or for the first time after it was not.
    AsExpected,
    /// Bytes of a process image that fits no frame.
    TooLarge(usize),
    Lack(Lack),
    /// Of an axis of a slave.
    Axis(usize, u8, AxisNews),
    /// Of a joint of an arm, in their order.
    Joint(usize, usize, JointNews),
}

impl News {
    /// In words, and how much it matters.
    pub(super) fn notice(&self) -> Notice {
        Notice {
            severity: self.severity(),
            text: self.to_string(),
        }
    }

    const fn severity(&self) -> Severity {
        match self {
            Self::Event(event) => match event {
                Event::Reached { .. }
                | Event::Returned { .. }
                | Event::RingClosed
                | Event::ClockBack { .. }
                | Event::Reference { .. } => Severity::Info,
                Event::RingOpen { .. }
                | Event::UnexpectedSlave { .. }
                | Event::ClockLost { .. }
                | Event::MailboxTooLong { .. } => Severity::Warning,
                Event::Fault { .. }
                | Event::CableCut { .. }
                | Event::StartSplit { .. }
                | Event::Unplaced { .. } => Severity::Error,
                // Those that are not known here.
                _ => Severity::Warning,
            },
            // Error code 0000h takes an emergency back.
            Self::Emergency(report) if report.emergency.code == 0 => Severity::Info,
            Self::AsExpected | Self::Axis(_, _, AxisNews::Proven(..)) => Severity::Info,
            Self::Joint(_, _, JointNews::OutOfRange { .. }) => Severity::Warning,
            Self::Emergency(_)
            | Self::Difference(_)
            | Self::TooLarge(_)
            | Self::Lack(_)
            | Self::Axis(_, _, AxisNews::Lack(_) | AxisNews::DriveFault(_))
            | Self::Joint(_, _, JointNews::Runaway(_)) => Severity::Error,
        }
    }
}

impl fmt::Display for News {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Event(event) => event.fmt(f),
            Self::Emergency(report) => {
                let (slave, said) = (report.slave, &report.emergency);
                let [code, register] = [said.code, u16::from(said.register)];
                write!(
                    f,
                    "slave {slave}: emergency, error code {code:04X}h, register {register:02X}h"
                )
            }
            Self::Difference(difference) => difference.fmt(f),
            Self::AsExpected => f.write_str("all slaves are there as the cell expects them"),
            Self::TooLarge(bytes) => write!(
                f,
                "the process image has {bytes} bytes, {IMAGE_MAX} fit one frame; map fewer or smaller PDOs, or make \
                 two segments of it"
            ),
            Self::Lack(lack) => lack.fmt(f),
            Self::Axis(slave, axis, AxisNews::Lack(lack)) => {
                write!(f, "slave {slave}: axis {axis} cannot be led: {lack}")
            }
            Self::Axis(slave, axis, AxisNews::DriveFault(drive_fault)) => {
                write!(f, "slave {slave}, axis {axis}: {drive_fault}")
            }
            Self::Axis(slave, axis, AxisNews::Proven(took, trusted)) => {
                write!(
                    f,
                    "slave {slave}, axis {axis}: {}",
                    drives::proven(*took, *trusted)
                )
            }
            Self::Joint(arm, joint, news) => write!(f, "arm {arm}, joint {joint}: {news}"),
        }
    }
}
