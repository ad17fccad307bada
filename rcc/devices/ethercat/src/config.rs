//! Cell file configuration of EtherCAT segments and their devices.

mod servo;
mod slave;
mod youbot;

use std::time::Duration;

use serde::Deserialize;

use takt_core::span;
use takt_device_drives::{DriveArm, Recovery};

pub use servo::{EthercatHoming, EthercatServo, ServoPower};
pub use slave::{
    AnalogueChannel, EthercatClocks, EthercatIo, EthercatSlave, LostPolicy, SlaveGoal, SlavePdo,
    SlaveTimeouts, StartupObject, StartupValue, UnlockedPolicy,
};
pub use youbot::{YouBotArm, YouBotBase, YouBotControl, YouBotZero};

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
    /// Consecutive lost frames after which all slaves count as absent, and their devices stop, 1 to 250; a device without
    /// inputs for one cycle more than that is offline. Slaves end operation by themselves after their process data
    /// watchdog, usually 100 ms.
    #[serde(default = "EthercatConfig::default_lost_frames")]
    pub lost_frames: u8,
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
    /// Servo axes of terminals.
    #[serde(default, rename = "servo")]
    pub servos: Vec<EthercatServo>,
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
            lost_frames: Self::default_lost_frames(),
            phase: None,
            spin: Duration::ZERO,
            priority: Self::default_priority(),
            cpus: Vec::new(),
            thread: None,
            clocks: EthercatClocks::default(),
            slaves: Vec::new(),
            arms: Vec::new(),
            ios: Vec::new(),
            servos: Vec::new(),
            youbot_bases: Vec::new(),
            youbot_arms: Vec::new(),
        }
    }
}

impl EthercatConfig {
    const fn default_cycle() -> Duration {
        Duration::from_millis(1)
    }

    const fn default_lost_frames() -> u8 {
        3
    }

    /// Arms with an axis that has power while a net requests it: they are not operational before.
    pub fn on_request(&self) -> impl Iterator<Item = &String> {
        let waits = |drive: &str| {
            let mut servos = self.servos.iter();
            servos.any(|it| it.name == drive && it.power == ServoPower::OnRequest)
        };
        let arms = self.arms.iter();
        let arms = arms.filter(move |arm| arm.joints.iter().any(|joint| waits(&joint.drive)));
        arms.map(|arm| &arm.name)
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
