//! Cell file configuration of EtherCAT segments and CANopen networks and their devices. The drivers are in
//! `device::ethercat` and `device::canopen`.

use std::time::Duration;

use serde::{Deserialize, Deserializer};
use takt_can::cia402::{MasterOptions, Quirk, UnknownQuirk};

use super::{EthercatClocks, EthercatIo, EthercatSlave, YouBotArm, YouBotBase};
use crate::span;

/// A segment.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EthercatConfig {
    /// Its name.
    pub name: String,
    /// Network interface at its start.
    pub interface: String,
    /// Network interface at its other end, for a ring: all slaves stay reachable when a cable is cut. `None` for a
    /// line.
    #[serde(default)]
    pub second: Option<String>,
    /// Time from one frame to the next, 100 us to 100 ms.
    #[serde(
        default = "EthercatConfig::default_cycle",
        deserialize_with = "span::text::deserialize"
    )]
    pub cycle: Duration,
    /// Time from SYNC0 to the frame; `None` for half a cycle.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub phase: Option<Duration>,
    /// How long the driver polls for a frame's answer before it sleeps, at most half a cycle: removes the wake-up
    /// latency from the round trip, but occupies a processor. Zero sleeps at once.
    #[serde(default, deserialize_with = "span::text::deserialize")]
    pub spin: Duration,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "EthercatConfig::default_priority")]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands its devices; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
    /// Synchronization of its clocks.
    #[serde(default)]
    pub clocks: EthercatClocks,
    /// Expected slaves.
    #[serde(default, rename = "slave")]
    pub slaves: Vec<EthercatSlave>,
    /// Robot arms made of drives.
    #[serde(default, rename = "arm")]
    pub arms: Vec<DriveArm<String>>,
    /// Inputs and outputs.
    #[serde(default, rename = "io")]
    pub ios: Vec<EthercatIo>,
    /// Bases of KUKA youBots.
    #[serde(default, rename = "youbot_base")]
    pub youbot_bases: Vec<YouBotBase>,
    /// Arms of KUKA youBots.
    #[serde(default, rename = "youbot_arm")]
    pub youbot_arms: Vec<YouBotArm>,
}

impl Default for EthercatConfig {
    /// An empty segment without interface.
    fn default() -> Self {
        Self {
            name: String::new(),
            interface: String::new(),
            second: None,
            cycle: Self::default_cycle(),
            phase: None,
            spin: Duration::ZERO,
            priority: Self::default_priority(),
            cpus: Vec::new(),
            thread: None,
            clocks: EthercatClocks::default(),
            slaves: Vec::new(),
            arms: Vec::new(),
            ios: Vec::new(),
            youbot_bases: Vec::new(),
            youbot_arms: Vec::new(),
        }
    }
}

impl EthercatConfig {
    const fn default_cycle() -> Duration {
        Duration::from_millis(1)
    }

    /// Devices that get no commands after a fault until their driver restarts.
    pub(crate) fn on_restart(&self) -> Vec<String> {
        let arms = self.arms.iter().map(|it| (it.recovery, &it.name));
        let bases = self.youbot_bases.iter().map(|it| (it.recovery, &it.name));
        let of_arm = |it: &YouBotArm| {
            let names = [Some(it.name.clone()), it.gripper.clone()];
            let is_held = it.recovery == Recovery::OnRestart;
            names.into_iter().flatten().filter(move |_| is_held)
        };
        let held = arms.chain(bases);
        let held = held.filter(|(recovery, _)| *recovery == Recovery::OnRestart);
        let held = held.map(|(_, name)| name.clone());
        held.chain(self.youbot_arms.iter().flat_map(of_arm))
            .collect()
    }

    #[expect(
        clippy::unnecessary_wraps,
        reason = "the type of the field it is the default of"
    )]
    const fn default_priority() -> Option<u8> {
        Some(85)
    }
}

/// A CANopen network.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CanopenConfig {
    /// Its name.
    pub name: String,
    /// CAN interface.
    pub interface: String,
    /// Time from one SYNC to the next, 1 ms to 100 ms.
    #[serde(
        default = "CanopenConfig::default_cycle",
        deserialize_with = "span::text::deserialize"
    )]
    pub cycle: Duration,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "EthercatConfig::default_priority")]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands its devices; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
    /// Node number of the master, 1 to 127; no node may have it.
    #[serde(default = "CanopenConfig::default_master")]
    pub master: u8,
    /// Heartbeat period of the master, two cycles to 20 s; nodes without a heartbeat for two and a half periods
    /// consider it lost. `None` for five cycles, but not less than 20 ms; zero for no heartbeat.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub heartbeat: Option<Duration>,
    /// Reaction of drives to the loss of the master (6007h).
    #[serde(default)]
    pub on_link_loss: LinkLoss,
    /// Robot arms made of drives.
    #[serde(default, rename = "arm")]
    pub arms: Vec<DriveArm<u8>>,
}

impl CanopenConfig {
    const fn default_cycle() -> Duration {
        Duration::from_millis(2)
    }

    const fn default_master() -> u8 {
        127
    }
}

/// Reaction of a CANopen drive to the loss of its master: abort connection option code, 6007h. Drives without that
/// object keep their own reaction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkLoss {
    /// Stop by the quick stop option code (605Ah).
    #[default]
    QuickStop,
    /// Disable voltage: the motor coasts unless there is a brake.
    DisableVoltage,
    /// Fault, by the fault reaction option code (605Eh).
    Fault,
    /// No reaction.
    Nothing,
    /// The setting stored in the drive is not changed.
    AsSet,
}

/// Recovery of a device after a fault, once its drives can follow commands again. In each case, nothing moves before
/// a program requests it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Recovery {
    /// Faults are reset, drives are enabled, and commutation and stops are searched as far as allowed.
    #[default]
    Automatic,
    /// It brakes and gets no commands until its driver restarts with the controller.
    OnRestart,
}

/// A robot arm made of drives, named as on their bus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveArm<D> {
    /// Name by which nets find it.
    pub name: String,
    /// Kinematics model, such as `staubli_tx90`; empty for none.
    #[serde(default)]
    pub model: String,
    /// Recovery after a fault.
    #[serde(default)]
    pub recovery: Recovery,
    /// Its joints, from the base.
    #[serde(rename = "joint")]
    pub joints: Vec<DriveJoint<D>>,
}

/// A joint moved by an axis of a drive.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveJoint<D> {
    /// The drive: name of the EtherCAT slave, or number of the CANopen node.
    #[serde(alias = "slave", alias = "node")]
    pub drive: D,
    /// Axis of the drive, from 0.
    #[serde(default)]
    pub axis: u8,
    /// Increments of the drive per turn of the joint, including gear; negative for the opposite direction.
    pub increments_per_turn: f64,
    /// Increments at joint zero.
    #[serde(default)]
    pub zero: f64,
    /// Range of the joint, degrees.
    pub range: [f64; 2],
    /// Largest speed, degrees per second.
    pub velocity_max: f64,
    /// Largest acceleration, degrees per second squared.
    pub acceleration_max: f64,
    /// Largest following error, degrees of the joint, before power is removed, independent of 6065h; `None` for the
    /// motion in a tenth of a second at its largest speed, but not less than one degree.
    #[serde(default)]
    pub following_error_max: Option<f64>,
    /// Objects, by their index on the first axis, whose SDO upload does not mirror the PDO values, according to the
    /// drive's manual. They are excluded from the comparison before power-on; every other mapped object of the axis
    /// is compared.
    #[serde(default)]
    pub not_mirrored: Vec<u16>,
    /// Deviations of the drive from CiA 402, by its manual or by the text of its faults: `no_follow_bit`,
    /// `sod_as_0020`, `mode_after_enable`.
    #[serde(default, deserialize_with = "quirks")]
    pub quirks: Vec<Quirk>,
}

/// Deserializes quirks by name.
fn quirks<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Quirk>, D::Error> {
    let names = Vec::<String>::deserialize(deserializer)?;
    let quirks = names.iter().map(|name| name.parse());
    quirks
        .collect::<Result<_, UnknownQuirk>>()
        .map_err(serde::de::Error::custom)
}

impl<D> DriveJoint<D> {
    /// Largest following error, degrees of the joint.
    #[must_use]
    pub fn following_error(&self) -> f64 {
        let usual = (self.velocity_max * FOLLOWING_TIME_S).max(FOLLOWING_MIN);
        self.following_error_max.unwrap_or(usual)
    }

    /// Timeouts of its drive, adapted to its quirks.
    #[must_use]
    pub(crate) fn master_options(&self) -> MasterOptions {
        MasterOptions::default().with_quirks(&self.quirks)
    }
}

/// Default following error: motion in this time at the largest speed, s, but at least one degree.
const FOLLOWING_TIME_S: f64 = 0.1;
const FOLLOWING_MIN: f64 = 1.0;
