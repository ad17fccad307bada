//! `takt emulate lwr`: a KRC with a KUKA LWR that sends FRI datagrams to a controller. The KRC itself is in
//! `takt_fri::lwr::emulator`.

use std::net::SocketAddr;
use std::time::Duration;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use takt_fri::lwr::emulator::{self, Krc, KrcConfig, KrcStatus, Script};
use takt_fri::lwr::wire::Control;
use takt_fri::lwr::{DEFAULT_PORT, Protocol};

use super::knobs::Knobs;
use super::{Robot, resting};
use crate::Verdict;
use crate::output::{say, span};
use crate::run::until_stopped;

/// A KRC with an LWR.
#[derive(Debug, Args)]
pub(crate) struct Lwr {
    /// Where the controller listens; datagrams are sent there.
    #[arg(long, value_name = "IP:PORT", default_value_t = SocketAddr::from(([127, 0, 0, 1], DEFAULT_PORT)))]
    target: SocketAddr,
    /// Time from one measurement to the next, 1ms to 100ms.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = span)]
    period: Duration,
    /// The KRL program takes orders over user data, by this convention; without it, it starts FRI when quality is PERFECT.
    #[arg(long, value_enum, value_name = "NAME")]
    handshake: Option<Handshake>,
    /// Control strategy at the start.
    #[arg(long, value_enum, default_value = "position")]
    strategy: Strategy,
    #[command(flatten)]
    knobs: Knobs,
}

/// A convention for user data as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Handshake(Protocol);

impl ValueEnum for Handshake {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [Handshake; 5] = [
            Handshake(Protocol::Rcc),
            Handshake(Protocol::Stanford),
            Handshake(Protocol::KukaLwr),
            Handshake(Protocol::Tum),
            Handshake(Protocol::FirstApp),
        ];
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self.0 {
            Protocol::Rcc => PossibleValue::new("rcc").help("Robot Control Core, fri2.src"),
            Protocol::Stanford => PossibleValue::new("stanford").help("Stanford and LIRMM"),
            Protocol::KukaLwr => PossibleValue::new("kuka-lwr").help("kuka-lwr of Pisa"),
            Protocol::Tum => PossibleValue::new("tum").help("TUM and RCPRG"),
            Protocol::FirstApp => PossibleValue::new("first-app").help("KUKA's demonstration"),
        })
    }
}

/// A control strategy as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Strategy {
    /// The robot follows positions, whatever pushes it.
    Position,
    /// Springs at the joints.
    Joint,
    /// Springs at the tool.
    Cartesian,
}

impl Lwr {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let robot = Robot::start("krc", self.target, self.config())?;
        say(&format!(
            "LWR sends measurements to {} every {:?}",
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
        super::farewell(
            status.sent(),
            status.answers(),
            status.missed(),
            status.stalls(),
        )
    }

    fn config(&self) -> KrcConfig {
        let patient = resting(self.period);
        let line = self.knobs.line();
        let faults = emulator::Faults {
            to_client: line,
            to_krc: line,
            power_off: self.knobs.power_off(),
            drift_ppm: self.knobs.drift_ppm(),
            ..emulator::Faults::default()
        };
        let flange = Krc::new(patient.clone(), Duration::ZERO).flange();
        KrcConfig {
            faults,
            seed: self.knobs.seed,
            timing: self.knobs.timing(patient.timing),
            contact: self.knobs.contact(flange),
            control: match self.strategy {
                Strategy::Position => Control::Position,
                Strategy::Joint => Control::JointImpedance,
                Strategy::Cartesian => Control::CartesianImpedance,
            },
            script: match self.handshake {
                Some(Handshake(protocol)) => Script::Handshake(protocol),
                None => patient.script,
            },
            ..patient
        }
    }
}

/// What is told whenever it changes.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Shown {
    state: u16,
    quality: u16,
    has_power: bool,
    falls: u64,
}

impl Shown {
    fn of(status: &KrcStatus) -> Self {
        Self {
            state: status.state().code(),
            quality: status.quality().code(),
            has_power: status.has_power(),
            falls: status.falls(),
        }
    }

    fn line(self, status: &KrcStatus) -> String {
        let power = if self.has_power { "on" } else { "off" };
        let fall = status.last_fall().filter(|_| self.falls > 0);
        let fall = fall.map_or_else(String::new, |why| format!("; left command mode: {why}"));
        let state = takt_fri::lwr::wire::State::from(self.state);
        let quality = takt_fri::lwr::wire::Quality::from(self.quality);
        format!("{state:?}, quality {quality:?}, drives {power}{fall}")
    }
}
