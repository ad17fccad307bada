//! `takt emulate lwr`: a KRC with a KUKA LWR that sends FRI datagrams to a controller. The KRC itself is in
//! `takt_fri::lwr::emulator`.

use std::net::SocketAddr;
use std::time::Duration;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use takt_devices::fri::emulator::{Robot, resting};
use takt_fri::lwr::emulator::{self, Krc, KrcConfig, Script};
use takt_fri::lwr::wire::Control;
use takt_fri::lwr::{DEFAULT_PORT, Protocol};

use super::knobs::Knobs;
use super::robot::{connect, watch};
use crate::Verdict;
use crate::output::{say, span_of_ms};

/// A KRC with an LWR.
#[derive(Debug, Args)]
pub(crate) struct Lwr {
    /// Where the controller listens; datagrams are sent there.
    #[arg(long, alias = "target", value_name = "IP:PORT", default_value_t = SocketAddr::from(([127, 0, 0, 1], DEFAULT_PORT)))]
    connect: SocketAddr,
    /// Time from one measurement to the next, 1ms to 100ms.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = span_of_ms(1..=100))]
    period: Duration,
    /// The KRL program takes requests over user data, by this convention; without it, it starts FRI when quality is
    /// PERFECT.
    #[arg(long, value_enum, value_name = "NAME")]
    handshake: Option<Handshake>,
    /// Control strategy at the start.
    #[arg(long, value_enum, default_value = "position")]
    strategy: Strategy,
    /// Digital output of the controller, 0 to 15, that takes the obstacle of --contact away while it is true.
    #[arg(long, value_name = "PORT", requires = "contact", value_parser = clap::value_parser!(u32).range(0..=15))]
    contact_off: Option<u32>,
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
        let link = connect(self.knobs.bind, self.connect, 0)?;
        let local = link.local_addr()?;
        let config = self.config();
        let load = self.knobs.carried();
        let robot = Robot::launch("krc", link, move |start| {
            let mut krc = Krc::new(config, start);
            if let Some(load) = load {
                krc.set_surroundings(load);
            }
            krc
        })?;
        say(&format!(
            "LWR sends measurements to {} every {:?}, from {local}",
            self.connect, self.period
        ))?;
        watch(robot, self.knobs.duration)
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
        let patient = KrcConfig {
            tool_m: self.knobs.tool_m(),
            ..patient
        };
        let tip = Krc::new(patient.clone(), Duration::ZERO).tip();
        KrcConfig {
            faults,
            seed: self.knobs.seed,
            timing: self.knobs.timing(patient.timing),
            contact: self.knobs.contact(tip),
            contact_off: self.contact_off,
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

#[cfg(test)]
mod tests {
    use clap::Parser;
    use takt_devices::fri::emulator::MISSES_MAX;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        lwr: Lwr,
    }

    fn config(words: &str) -> KrcConfig {
        let line = Line::try_parse_from(std::iter::once("lwr").chain(words.split_whitespace()));
        line.unwrap().lwr.config()
    }

    #[test]
    fn knobs_reach_the_krc() {
        let words = "--strategy joint --handshake tum --period 2ms --reorder 0.1 --drift 20 --contact spring:0.02";
        let krc = config(words);
        assert_eq!(
            (krc.control, krc.period),
            (Control::JointImpedance, Duration::from_millis(2))
        );
        assert!(matches!(krc.script, Script::Handshake(Protocol::Tum)));
        assert!((krc.faults.to_krc.reorder - 0.1).abs() < 1e-12);
        assert!((krc.faults.drift_ppm - 20.0).abs() < 1e-12);
        let contact = krc.contact.unwrap();
        let flange = Krc::new(resting(krc.period), Duration::ZERO).flange();
        assert!((flange[2] - contact.point[2] - 0.02).abs() < 1e-9);
        assert_eq!(krc.timing.misses_max, MISSES_MAX);
        assert_eq!(config("--strict").timing, emulator::Timing::default());
    }
}
