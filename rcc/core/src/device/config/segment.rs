//! EtherCAT segments and CANopen networks of a cell and the devices on them, as its file tells them. How they are
//! led is in `device::ethercat` and `device::canopen`.

use std::time::Duration;

use serde::{Deserialize, Deserializer};
use takt_can::cia402::{Patience, Quirk, UnknownQuirk};

use super::{EthercatClocks, EthercatIo, EthercatSlave, YouBotArm, YouBotBase};
use crate::span;

/// A segment.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EthercatConfig {
    /// Its name.
    pub name: String,
    /// Network interface at its beginning.
    pub interface: String,
    /// Network interface at its other end, which makes it a ring: a cable may be cut, and all slaves are still
    /// reached. `None` for a line.
    #[serde(default)]
    pub second: Option<String>,
    /// Time from one frame to the next, 100 us to 100 ms.
    #[serde(
        default = "EthercatConfig::default_cycle",
        deserialize_with = "span::text::deserialize"
    )]
    pub cycle: Duration,
    /// How long after SYNC0 frames are sent; `None` for half a cycle.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub phase: Option<Duration>,
    /// How long the driver asks for a frame's answer again and again before it sleeps, at most half a cycle: takes the
    /// system's wake-up out of the round trip, and keeps a processor busy meanwhile. Zero sleeps at once.
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
    /// How its clocks are brought together.
    #[serde(default)]
    pub clocks: EthercatClocks,
    /// The slaves that are expected.
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
    /// A line of nothing at no interface.
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

    /// Its devices that are given no command after a fault until their driver starts again.
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
    /// The master's own node number, 1 to 127; no node may have it.
    #[serde(default = "CanopenConfig::default_master")]
    pub master: u8,
    /// Time from one heartbeat of the master to the next, two cycles to 20 s; nodes that hear none for two and a half
    /// times that take it for lost. `None` for five cycles, but not less than 20 ms; zero for no heartbeat.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub heartbeat: Option<Duration>,
    /// What drives do that have lost the master (6007h).
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

/// What a CANopen drive does when it has lost its master: abort connection option code, 6007h. Drives without that
/// object do what they always do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkLoss {
    /// It stops by its quick stop option code (605Ah).
    #[default]
    QuickStop,
    /// It takes the voltage from its motor, which coasts unless there is a brake.
    DisableVoltage,
    /// It goes into fault, by its fault reaction option code (605Eh).
    Fault,
    /// It goes on.
    Nothing,
    /// What is set in the drive, which is not touched.
    AsSet,
}

/// What becomes of a device after a fault, once its drives could follow commands again. Whatever is chosen, nothing moves
/// before a program requests it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Recovery {
    /// Its faults are reset, its drives are enabled, and it looks for its commutation and its stops as far as it may.
    #[default]
    Automatic,
    /// It brakes and is given no command until its driver starts again, with the controller.
    OnRestart,
}

/// A robot arm made of drives, which are named as their bus names them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveArm<D> {
    /// Name by which nets find it.
    pub name: String,
    /// Its kinematics, such as `staubli_tx90`; empty for none.
    #[serde(default)]
    pub model: String,
    /// What becomes of it after a fault.
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
    /// The drive: the name of the EtherCAT slave, or the number of the CANopen node.
    #[serde(alias = "slave", alias = "node")]
    pub drive: D,
    /// Which of its axes, from 0.
    #[serde(default)]
    pub axis: u8,
    /// Increments of the drive for a turn of the joint, gear included; negative if they count the other way.
    pub increments_per_turn: f64,
    /// Increments at which the joint is at zero.
    #[serde(default)]
    pub zero: f64,
    /// Range of the joint, degrees.
    pub range: [f64; 2],
    /// Largest speed, degrees per second.
    pub velocity_max: f64,
    /// Largest acceleration, degrees per second squared.
    pub acceleration_max: f64,
    /// Farthest that its motor may be from its target, degrees of the joint, before its power is taken, whatever the
    /// drive's own 6065h says; `None` for a tenth of a second at its largest speed, but not less than one degree.
    #[serde(default)]
    pub following_error_max: Option<f64>,
    /// Objects, by their index on the first axis, whose SDO upload does not show what PDOs carry, by the drive's manual.
    /// They are not compared before the drive gets power; without them every mapped object of the axis is.
    #[serde(default)]
    pub not_mirrored: Vec<u16>,
    /// What the drive does not do as CiA 402 wants it, by its manual or by what its faults name: `no_follow_bit`,
    /// `sod_as_0020`, `mode_after_enable`.
    #[serde(default, deserialize_with = "quirks")]
    pub quirks: Vec<Quirk>,
}

/// Quirks by their names.
fn quirks<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Quirk>, D::Error> {
    let names = Vec::<String>::deserialize(deserializer)?;
    let quirks = names.iter().map(|name| name.parse());
    quirks
        .collect::<Result<_, UnknownQuirk>>()
        .map_err(serde::de::Error::custom)
}

impl<D> DriveJoint<D> {
    /// Farthest that its motor may be from its target, degrees of the joint.
    #[must_use]
    pub fn following_error(&self) -> f64 {
        let usual = (self.velocity_max * FOLLOWING_TIME_S).max(FOLLOWING_MIN);
        self.following_error_max.unwrap_or(usual)
    }

    /// What its drive may do otherwise than others.
    #[must_use]
    pub(crate) fn patience(&self) -> Patience {
        Patience::default().with_quirks(&self.quirks)
    }
}

/// A motor may lag by what it goes in this time at its largest speed, s, but by a degree at least.
const FOLLOWING_TIME_S: f64 = 0.1;
const FOLLOWING_MIN: f64 = 1.0;
