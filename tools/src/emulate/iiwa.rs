//! `takt emulate iiwa`: a Sunrise cabinet with an LBR iiwa that sends FRI messages to a controller. The cabinet itself
//! is in `takt_fri::sunrise::emulator`.

use std::net::SocketAddr;
use std::time::Duration;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, CabinetStatus, Faults, Limits, Robot as Arm, Timing, serve,
};
use takt_fri::sunrise::{DEFAULT_PORT, wire::Dialect};

use super::{Knobs, MISSES_MAX, Robot};
use crate::Verdict;
use crate::output::{say, span};
use crate::run::until_stopped;

/// A Sunrise cabinet with a KUKA LBR iiwa, speaking FRI 1.x, 2.x or 2.7 over UDP.
///
/// Its robot program holds the arm with an overlay of joint positions and starts again when that ends. It bridges up
/// to 100 missing answers and calls quality good when half of them are in time: more patience than a real cabinet
/// has, for hosts that stall.
#[derive(Debug, Args)]
pub(crate) struct Iiwa {
    /// Where the controller listens; datagrams are sent there.
    #[arg(long, value_name = "IP:PORT", default_value_t = SocketAddr::from(([127, 0, 0, 1], DEFAULT_PORT)))]
    target: SocketAddr,
    /// What its FRI option speaks.
    #[arg(long, value_enum, default_value = "v1")]
    dialect: Version,
    /// Which arm.
    #[arg(long, value_enum, default_value = "14")]
    model: Model,
    /// Time from one message to the next, 1ms to 100ms.
    #[arg(long, value_name = "TIME", default_value = "2ms", value_parser = span)]
    period: Duration,
    #[command(flatten)]
    knobs: Knobs,
}

/// A version of FRI as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Version(Dialect);

impl ValueEnum for Version {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(Dialect::V1), Self(Dialect::V2), Self(Dialect::V3)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self.0 {
            Dialect::V1 => PossibleValue::new("v1").help("1.7 to 1.17"),
            Dialect::V2 => PossibleValue::new("v2").help("2.0 to 2.5"),
            Dialect::V3 => PossibleValue::new("v3").help("2.7, with length and checksum"),
        })
    }
}

/// An arm as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Model(Arm);

impl ValueEnum for Model {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(Arm::Iiwa7), Self(Arm::Iiwa14)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self.0 {
            Arm::Iiwa7 => PossibleValue::new("7").help("LBR iiwa 7 R800"),
            Arm::Iiwa14 => PossibleValue::new("14").help("LBR iiwa 14 R820"),
        })
    }
}

impl Iiwa {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let config = self.config();
        let robot = Robot::launch(
            "cabinet",
            self.target,
            CabinetStatus::new(),
            move |link, status, stop| {
                let mut cabinet = Cabinet::new(config, takt_fri::linux::monotonic()?);
                serve(&mut cabinet, link, status, stop)
            },
        )?;
        say(&format!(
            "iiwa sends messages to {} every {:?}",
            self.target, self.period
        ))?;
        let mut told = None;
        until_stopped(self.knobs.duration, || {
            let now = Shown::of(&robot.status);
            if told == Some(now) {
                return Ok(());
            }
            told = Some(now);
            say(&now.line(&robot.status))
        })?;
        let status = robot.stop()?;
        say(&format!(
            "sent {}, answers {}, missed {}, own stalls {}",
            status.sent(),
            status.answers(),
            status.missed(),
            status.stalls()
        ))?;
        Ok(Verdict::Good)
    }

    fn config(&self) -> CabinetConfig {
        let Model(robot) = self.model;
        let Version(dialect) = self.dialect;
        let line = self.knobs.line();
        CabinetConfig {
            robot,
            limits: Limits::of(robot),
            dialect,
            send_period: self.period,
            timing: Timing {
                misses_max: MISSES_MAX,
                bad_from: 0.0,
                ok_from: 0.5,
                ..Timing::default()
            },
            faults: Faults {
                to_client: line,
                to_cabinet: line,
                power_off: self.knobs.power_off(),
                ..Faults::default()
            },
            seed: self.knobs.seed,
            ..CabinetConfig::default()
        }
    }
}

/// What is told whenever it changes.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Shown {
    state: i32,
    quality: i32,
    has_power: bool,
    falls: u64,
}

impl Shown {
    fn of(status: &CabinetStatus) -> Self {
        Self {
            state: status.state().code(),
            quality: status.quality().code(),
            has_power: status.has_power(),
            falls: status.falls(),
        }
    }

    fn line(self, status: &CabinetStatus) -> String {
        let power = if self.has_power { "on" } else { "off" };
        let fall = status.last_fall().filter(|_| self.falls > 0);
        let fall = fall.map_or_else(String::new, |why| format!("; overlay ended: {why}"));
        format!(
            "{}, quality {}, drives {power}{fall}",
            takt_fri::sunrise::wire::SessionState::from(self.state),
            takt_fri::sunrise::wire::Quality::from(self.quality)
        )
    }
}
