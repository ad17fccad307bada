//! What the driver of a network reports: values out of the real-time thread; the supervisor converts them to text.

use std::fmt;
use std::time::Duration;

use takt_can::canopen::network::{AxisFault, NodeFault};
use takt_can::canopen::{Emergency, NodeId};
use takt_can::cia402::proof::Objects;

use takt_core::device::driver::Severity;
use takt_device_drives::{self as drives, JointEvent};

/// An event of the network.
#[derive(Debug)]
pub(super) enum NetworkEvent {
    Runs(NodeId),
    Fault(NodeId, NodeFault),
    Emergency(NodeId, Emergency, u32),
    /// Of the axis with that number in its drive.
    Axis(NodeId, u8, AxisFault),
    /// The process data of an axis are proven, except these objects.
    Proven(NodeId, u8, Duration, Objects),
    /// Of a joint of an arm: arm, joint, event.
    Joint(usize, usize, JointEvent),
}

impl NetworkEvent {
    /// Severity.
    pub(super) const fn severity(&self) -> Severity {
        match self {
            Self::Runs(_) | Self::Proven(..) => Severity::Info,
            // Error code 0000h clears an emergency.
            Self::Emergency(_, emergency, _) if emergency.code == 0 => Severity::Info,
            Self::Joint(_, _, event) if event.is_warning() => Severity::Warning,
            Self::Fault(_, NodeFault::Garbled { .. } | NodeFault::PdoShort { .. }) => {
                Severity::Warning
            }
            Self::Fault(..) | Self::Emergency(..) | Self::Axis(..) | Self::Joint(..) => {
                Severity::Error
            }
        }
    }
}

impl fmt::Display for NetworkEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Runs(node) => write!(f, "node {node}: running"),
            Self::Fault(node, fault) => write!(f, "node {node}: {fault}"),
            Self::Emergency(node, emergency, 1) => {
                write!(f, "node {node}: {}", NodeFault::Emergency(*emergency))
            }
            Self::Emergency(node, emergency, count) => write!(
                f,
                "node {node}: {count} emergencies, last: {}",
                NodeFault::Emergency(*emergency)
            ),
            Self::Axis(node, axis, fault) => write!(f, "node {node}, axis {axis}: {fault}"),
            Self::Proven(node, axis, took, trusted) => {
                let proven = drives::proven(*took, *trusted);
                write!(f, "node {node}, axis {axis}: {proven}")
            }
            Self::Joint(arm, joint, event) => write!(f, "arm {arm}, joint {joint}: {event}"),
        }
    }
}
