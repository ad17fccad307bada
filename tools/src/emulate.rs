//! `takt emulate`: emulated robots and devices at a network or CAN interface, for labs and tests. Protocols and robots
//! are in the protocol crates.

#[cfg(feature = "can")]
mod canopen;
#[cfg(feature = "can")]
mod drive;
#[cfg(feature = "can")]
mod faults;
#[cfg(feature = "fri")]
mod iiwa;
#[cfg(feature = "fri")]
mod knobs;
#[cfg(feature = "fri")]
mod lwr;
#[cfg(feature = "can")]
mod node;
#[cfg(feature = "can")]
mod rmp;
#[cfg(feature = "fri")]
mod robot;
#[cfg(feature = "ethercat")]
pub(crate) mod segment;
mod service;
#[cfg(feature = "ethercat")]
mod station;
#[cfg(feature = "wsg")]
mod wsg;
#[cfg(feature = "ethercat")]
mod youbot;

use clap::Subcommand;

use crate::Verdict;

/// Emulated robots.
#[derive(Debug, Subcommand)]
pub(crate) enum Emulate {
    #[cfg(feature = "fri")]
    /// A KRC with a KUKA LWR, speaking FRI 1.0 over UDP.
    ///
    /// It tolerates up to 100 missing answers, and no quality ends its command mode, so that it works on hosts that
    /// stall; `--strict` applies the limits assumed of a real KRC.
    Lwr(lwr::Lwr),
    #[cfg(feature = "fri")]
    Iiwa(iiwa::Iiwa),
    #[cfg(feature = "can")]
    /// A Segway power base on CAN or on its USB port.
    Rmp(rmp::Rmp),
    #[cfg(feature = "can")]
    /// A CiA 402 drive as a CANopen node.
    Drive(drive::DriveArgs),
    #[cfg(feature = "can")]
    Node(node::NodeArgs),
    #[cfg(feature = "ethercat")]
    /// A Stäubli TX90 of six CiA 402 axes on an EtherCAT segment.
    Tx90(segment::Tx90),
    #[cfg(feature = "ethercat")]
    Youbot(youbot::YouBot),
    #[cfg(feature = "ethercat")]
    Station(station::StationArgs),
    #[cfg(feature = "wsg")]
    /// A Schunk WSG gripper, over TCP.
    Wsg(wsg::Wsg),
}

impl Emulate {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            #[cfg(feature = "fri")]
            Self::Lwr(lwr) => lwr.run(),
            #[cfg(feature = "fri")]
            Self::Iiwa(iiwa) => iiwa.run(),
            #[cfg(feature = "can")]
            Self::Rmp(rmp) => rmp.run(),
            #[cfg(feature = "can")]
            Self::Drive(drive) => drive.run(),
            #[cfg(feature = "can")]
            Self::Node(node) => node.run(),
            #[cfg(feature = "ethercat")]
            Self::Tx90(tx90) => tx90.run(),
            #[cfg(feature = "ethercat")]
            Self::Youbot(youbot) => youbot.run(),
            #[cfg(feature = "ethercat")]
            Self::Station(station) => station.run(),
            #[cfg(feature = "wsg")]
            Self::Wsg(wsg) => wsg.run(),
        }
    }
}
