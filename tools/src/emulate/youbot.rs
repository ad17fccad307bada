//! `takt emulate youbot`: the slaves of a KUKA youBot at a network interface, for Takt or any other master at the other
//! end of its cable. What they do is in `takt_ethercat::emulator`.

use std::time::Duration;

use clap::{Args, ValueEnum};
use takt_ethercat::emulator::{self, DriveHandle, SharedSegment, YouBot as Slaves, YouBotConfig};
use takt_ethercat::youbot::Flags;

use super::segment::{Ends, serve};
use crate::Verdict;
use crate::output::{positive_span, say};

/// Flags whose changes are printed.
const REPORTED: u32 = Flags::BLOCKING | Flags::INITIALIZED | Flags::TIMEOUT | Flags::I2T;

/// A KUKA youBot: power boards, four wheels, an arm of five joints with a gripper.
#[derive(Debug, Args)]
pub(crate) struct YouBot {
    /// Network interface; the master is at the other end of its cable (`ip link add near type veth peer name far`).
    #[arg(long, value_name = "IFACE")]
    interface: String,
    /// Firmware of the drives.
    #[arg(long, value_name = "VERSION", default_value = "2.00")]
    firmware: Firmware,
    /// Electronics: TMCM-174 and TMCM-KR-841, or TMCM-1632 and TMCM-1610.
    #[arg(long, value_name = "KIND", default_value = "new")]
    boards: Boards,
    /// How many arms, 0 to 2.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=2))]
    arms: u8,
    /// No base: the segment begins with the arm's power board.
    #[arg(long)]
    no_base: bool,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Firmware {
    #[value(name = "1.48")]
    V148,
    #[value(name = "2.00")]
    V200,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Boards {
    Old,
    New,
}

impl YouBot {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        anyhow::ensure!(
            self.arms > 0 || !self.no_base,
            "neither base nor arm\nhint: leave out --no-base, or give --arms 1"
        );
        let config = YouBotConfig {
            firmware: match self.firmware {
                Firmware::V148 => emulator::Firmware::V148,
                Firmware::V200 => emulator::Firmware::V200,
            },
            boards: match self.boards {
                Boards::Old => emulator::Boards::Old,
                Boards::New => emulator::Boards::New,
            },
            base: !self.no_base,
            arms: self.arms.into(),
            ..YouBotConfig::default()
        };
        let (segment, bot) = Slaves::segment(&config);
        let mut watched = watched(bot);
        let segment = SharedSegment::new(segment);
        let poll = || watched.iter_mut().try_for_each(Watched::poll);
        serve(
            &segment,
            Ends::line(&self.interface),
            self.duration,
            || {},
            poll,
        )
    }
}

/// A drive and the flags printed last.
struct Watched {
    name: String,
    drive: DriveHandle,
    flags: u32,
}

fn watched(bot: Slaves) -> Vec<Watched> {
    let watch = |(name, drive)| Watched {
        name,
        drive,
        flags: 0,
    };
    let wheels = bot.wheels.into_iter().enumerate();
    let wheels = wheels.map(|(n, drive)| (format!("wheel {n}"), drive));
    let arms = bot.arms.into_iter().enumerate();
    let joints = arms.flat_map(|(arm, joints)| {
        let joints = joints.into_iter().enumerate();
        joints.map(move |(n, drive)| (format!("arm {arm} joint {n}"), drive))
    });
    wheels.chain(joints).map(watch).collect()
}

impl Watched {
    /// Prints flags that changed.
    fn poll(&mut self) -> anyhow::Result<()> {
        let flags = self.drive.lock().flags() & REPORTED;
        if flags == self.flags {
            return Ok(());
        }
        self.flags = flags;
        say(&format!("{}: {}", self.name, Flags(flags)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn youbot_drives_are_named_by_position() {
        let config = YouBotConfig {
            arms: 2,
            ..YouBotConfig::default()
        };
        let (_, bot) = Slaves::segment(&config);
        let names: Vec<_> = watched(bot).into_iter().map(|one| one.name).collect();
        assert_eq!(names.len(), 14);
        assert_eq!(
            (names[0].as_str(), names[13].as_str()),
            ("wheel 0", "arm 1 joint 4")
        );
    }
}
