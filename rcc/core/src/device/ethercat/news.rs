//! What a segment's driver reports, on its way from the driver thread to the log: values there, text here.

use std::fmt;

use takt_ethercat::config::IMAGE_MAX;
use takt_ethercat::master::{Difference, EmergencyReport, Event};

use super::arm::AxisNews;
use super::io::Lack;
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
