//! Events of the driver of a segment: values from the real-time thread, formatted by their reader.

use std::fmt;

use takt_ethercat::config::IMAGE_MAX;
use takt_ethercat::master::{Difference, EmergencyReport, Event};

use super::arm::AxisEvent;
use super::io::Lack;
use super::servo::ServoEvent;
use takt_core::device::driver::{DriverEvent, Severity};
use takt_device_drives::{self as drives, JointEvent};

/// An event of the segment.
#[derive(Debug)]
pub(super) enum SegmentEvent {
    Event(Event),
    Emergency(EmergencyReport),
    Difference(Difference),
    /// The segment is as expected again.
    AsExpected,
    /// Size of a process image that does not fit one frame.
    TooLarge(usize),
    Lack(Lack),
    /// Of an axis of a slave.
    Axis(usize, u8, AxisEvent),
    /// Of a servo axis.
    Servo(usize, ServoEvent),
    /// Of a joint of an arm: arm, joint, event.
    Joint(usize, usize, JointEvent),
}

impl SegmentEvent {
    /// Severity and text.
    pub(super) fn event(&self) -> DriverEvent {
        DriverEvent::new(self.severity(), self.to_string())
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
                // Events unknown to this version.
                _ => Severity::Warning,
            },
            // Error code 0000h clears an emergency.
            Self::Emergency(report) if report.emergency.code == 0 => Severity::Info,
            Self::Servo(_, ServoEvent::Homed) => Severity::Info,
            Self::AsExpected | Self::Axis(_, _, AxisEvent::Proven(..)) => Severity::Info,
            Self::Joint(_, _, event) if event.is_warning() => Severity::Warning,
            Self::Emergency(_)
            | Self::Difference(_)
            | Self::TooLarge(_)
            | Self::Lack(_)
            | Self::Servo(..)
            | Self::Axis(_, _, AxisEvent::Lack(_) | AxisEvent::DriveFault(_))
            | Self::Joint(..) => Severity::Error,
        }
    }
}

impl fmt::Display for SegmentEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Event(event) => event.fmt(f),
            Self::Emergency(report) => {
                let (slave, emergency) = (report.slave, &report.emergency);
                let [code, register] = [emergency.code, u16::from(emergency.register)];
                write!(
                    f,
                    "slave {slave}: emergency, error code {code:04X}h, register {register:02X}h"
                )
            }
            Self::Difference(difference) => difference.fmt(f),
            Self::AsExpected => f.write_str("all slaves are as the cell expects them"),
            Self::TooLarge(bytes) => write!(
                f,
                "the process image has {bytes} bytes, but one frame holds {IMAGE_MAX}\nhint: map fewer or smaller PDOs, or \
                 split the segment"
            ),
            Self::Lack(lack) => lack.fmt(f),
            Self::Axis(slave, axis, AxisEvent::Lack(lack)) => {
                write!(f, "slave {slave}: axis {axis} cannot be controlled: {lack}")
            }
            Self::Axis(slave, axis, AxisEvent::DriveFault(drive_fault)) => {
                write!(f, "slave {slave}, axis {axis}: {drive_fault}")
            }
            Self::Axis(slave, axis, AxisEvent::Proven(took, trusted)) => {
                write!(
                    f,
                    "slave {slave}, axis {axis}: {}",
                    drives::proven(*took, *trusted)
                )
            }
            Self::Servo(servo, event) => write!(f, "servo axis {servo}: {event}"),
            Self::Joint(arm, joint, event) => write!(f, "arm {arm}, joint {joint}: {event}"),
        }
    }
}
