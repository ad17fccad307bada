//! `takt emulate iiwa`: a Sunrise cabinet with an LBR iiwa that sends FRI messages to a controller. The cabinet itself
//! is in `takt_fri::sunrise::emulator`.

use std::net::SocketAddr;
use std::time::Duration;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use takt_devices::fri::emulator::{Robot, holding_program, tolerant_timing};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, Control, Faults, Io, Limits, Overlay, Robot as Arm,
};
use takt_fri::sunrise::wire::{
    CommandMode, Dialect, IOS_MAX, IoDirection, Name, OperationMode, TRANSFORMATIONS_MAX,
};
use takt_fri::sunrise::{DEFAULT_PORT, IoLevel};

use super::knobs::Knobs;
use super::lwr::Strategy;
use super::robot::{connect, watch};
use crate::Verdict;
use crate::output::{say, span, span_of_ms};

/// A Sunrise cabinet with a KUKA LBR iiwa, speaking FRI 1.x, 2.x or 2.7 over UDP.
///
/// Its robot program holds the arm with an overlay, of joint positions by default, and starts again when that ends. It
/// tolerates up to 100 missing answers and calls quality good when half of them are in time, so that it works on hosts
/// that stall; `--strict` applies the limits assumed of a real cabinet.
#[derive(Debug, Args)]
pub(crate) struct Iiwa {
    /// Where the controller listens; datagrams are sent there.
    #[arg(long, alias = "target", value_name = "IP:PORT", default_value_t = SocketAddr::from(([127, 0, 0, 1], DEFAULT_PORT)))]
    connect: SocketAddr,
    /// Version of its FRI option.
    #[arg(long, value_enum, default_value = "v1")]
    dialect: Version,
    /// Which arm.
    #[arg(long, value_enum, default_value = "14")]
    model: Model,
    /// Time from one message to the next, 1ms to 100ms.
    #[arg(long, value_name = "TIME", default_value = "2ms", value_parser = span_of_ms(1..=100))]
    period: Duration,
    /// Messages per answer that the controller expects, 1 to 100.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    receive_multiplier: u32,
    /// Quantity that the client commands in the overlay of the robot program.
    #[arg(long, value_enum, default_value = "position")]
    overlay: What,
    /// Control mode of the motion below an overlay of positions or poses; torques need joint, wrenches cartesian.
    #[arg(long, value_enum)]
    control: Option<Strategy>,
    /// Operation mode at the smartPAD; in T1 the flange is limited to 250 mm/s.
    #[arg(long, value_enum, default_value = "aut")]
    mode: Mode,
    /// An input that the robot program shares, read by the client; up to 10 inputs and outputs. Its type is that of the
    /// value: `Media.Key=true` is boolean, `Media.Count=3` digital, `Media.Level=0.5` analogue.
    #[arg(long = "input", value_name = "GROUP.NAME=VALUE", value_parser = shared)]
    inputs: Vec<Shared>,
    /// An output that the client may write, with its value at the start, as for --input.
    #[arg(long = "output", value_name = "GROUP.NAME=VALUE", value_parser = shared)]
    outputs: Vec<Shared>,
    /// A frame that the robot program requests of the client; up to 5.
    #[arg(long = "frame", value_name = "NAME", value_parser = frame)]
    frames: Vec<String>,
    /// How long quality must be GOOD before the session leaves MONITORING_WAIT.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = span)]
    monitoring_wait: Duration,
    /// How long COMMANDING_WAIT lasts at least.
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
    commanding_wait: Duration,
    #[command(flatten)]
    knobs: Knobs,
}

/// Quantity that the client commands in an overlay, as an option value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum What {
    /// Joint positions.
    Position,
    /// Joint torques on top of springs at the joints.
    Torque,
    /// Forces on top of springs at the tool.
    Wrench,
    /// Poses of the tool; FRI 2 only.
    Pose,
}

/// An operation mode as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Mode {
    /// Manual, reduced speed.
    T1,
    /// Manual, high speed.
    T2,
    /// Automatic.
    Aut,
}

/// An input or output as an option value.
#[derive(Clone, Debug, PartialEq)]
struct Shared {
    name: String,
    level: IoLevel,
}

impl Shared {
    fn io(&self, direction: IoDirection) -> Io {
        Io {
            name: self.name.clone(),
            direction,
            level: self.level,
        }
    }
}

/// Reads an input or output with its value.
fn shared(text: &str) -> Result<Shared, String> {
    let example =
        "write a name and a value, such as Media.Lamp=false, Media.Count=3 or Media.Level=0.5";
    let (name, value) = text
        .split_once('=')
        .ok_or_else(|| format!("`{text}`: {example}"))?;
    let level = match value {
        "true" => Some(IoLevel::Boolean(true)),
        "false" => Some(IoLevel::Boolean(false)),
        number => {
            let digital = number.parse().map(IoLevel::Digital).ok();
            let analog = number.parse().ok().filter(|value: &f64| value.is_finite());
            digital.or_else(|| analog.map(IoLevel::Analog))
        }
    };
    let level = level.ok_or_else(|| format!("`{value}` is no value: {example}"))?;
    let name = frame(name)?;
    Ok(Shared { name, level })
}

/// Reads a name of an input, output or frame.
fn frame(name: &str) -> Result<String, String> {
    if name.is_empty() || Name::new(name).is_none() {
        let most = Name::LEN_MAX;
        return Err(format!("`{name}` is no name: it has 1 to {most} bytes"));
    }
    Ok(name.to_owned())
}

/// Stiffness of springs at the joints, Nm/rad, and their damping.
const JOINT_SPRINGS: ([f64; 7], [f64; 7]) = ([1000.0; 7], [0.7; 7]);
/// The same at the tool, N/m and Nm/rad.
const TOOL_SPRINGS: ([f64; 6], [f64; 6]) =
    ([2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0], [0.7; 6]);

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
        let config = self.config()?;
        let link = connect(self.knobs.bind, self.connect, DEFAULT_PORT)?;
        let local = link.local_addr()?;
        let load = self.knobs.carried();
        let robot = Robot::launch("cabinet", link, move |start| {
            let mut cabinet = Cabinet::new(config, start);
            if let Some(load) = load {
                cabinet.set_surroundings(load);
            }
            cabinet
        })?;
        say(&format!(
            "iiwa sends messages to {} every {:?}, from {local}",
            self.connect, self.period
        ))?;
        watch(robot, self.knobs.duration)
    }

    fn config(&self) -> anyhow::Result<CabinetConfig> {
        let Model(robot) = self.model;
        let Version(dialect) = self.dialect;
        let line = self.knobs.line();
        let config = CabinetConfig {
            robot,
            limits: Limits::of(robot),
            dialect,
            send_period: self.period,
            receive_multiplier: self.receive_multiplier,
            timing: self.knobs.timing(tolerant_timing()),
            operation_mode: match self.mode {
                Mode::T1 => OperationMode::T1,
                Mode::T2 => OperationMode::T2,
                Mode::Aut => OperationMode::Aut,
            },
            program: holding_program(self.overlay()?),
            faults: Faults {
                to_client: line,
                to_cabinet: line,
                power_off: self.knobs.power_off(),
                drift_ppm: self.knobs.drift_ppm(),
                ..Faults::default()
            },
            seed: self.knobs.seed,
            ios: self.ios()?,
            requested_frames: self.frames()?,
            monitoring_wait: self.monitoring_wait,
            commanding_wait: self.commanding_wait,
            tool_m: self.knobs.tool_m(),
            ..CabinetConfig::default()
        };
        let tip = Cabinet::new(config.clone(), Duration::ZERO).tip();
        Ok(CabinetConfig {
            contact: self.knobs.contact(tip),
            ..config
        })
    }

    /// Inputs and outputs that the robot program shares.
    fn ios(&self) -> anyhow::Result<Vec<Io>> {
        let inputs = self.inputs.iter().map(|it| it.io(IoDirection::Input));
        let outputs = self.outputs.iter().map(|it| it.io(IoDirection::Output));
        let ios: Vec<_> = inputs.chain(outputs).collect();
        let found = ios.len();
        anyhow::ensure!(
            found <= IOS_MAX,
            "{found} inputs and outputs; FRI carries {IOS_MAX} at most"
        );
        for (number, io) in ios.iter().enumerate() {
            let is_twice = ios.iter().take(number).any(|it| it.name == io.name);
            anyhow::ensure!(!is_twice, "`{}` is given twice", io.name);
        }
        Ok(ios)
    }

    /// Frames that the robot program requests.
    fn frames(&self) -> anyhow::Result<Vec<String>> {
        let found = self.frames.len();
        anyhow::ensure!(
            found <= TRANSFORMATIONS_MAX,
            "{found} frames; FRI carries {TRANSFORMATIONS_MAX} at most"
        );
        Ok(self.frames.clone())
    }

    /// The motion of the robot program, if a cabinet supports it.
    fn overlay(&self) -> anyhow::Result<Overlay> {
        let Version(dialect) = self.dialect;
        let (command, fitting) = match self.overlay {
            What::Position => (CommandMode::Position, None),
            What::Torque => (CommandMode::Torque, Some(Strategy::Joint)),
            What::Wrench => (CommandMode::Wrench, Some(Strategy::Cartesian)),
            What::Pose => (CommandMode::CartesianPose, None),
        };
        anyhow::ensure!(
            self.overlay != What::Pose || dialect != Dialect::V1,
            "an overlay of poses needs FRI 2\nhint: give --dialect v2 or v3"
        );
        let wanted = self.control.or(fitting).unwrap_or(Strategy::Position);
        anyhow::ensure!(
            fitting.is_none_or(|fitting| fitting == wanted),
            "the control mode does not fit the overlay\nhint: leave --control out; torques go with joint, wrenches with cartesian"
        );
        let control = match wanted {
            Strategy::Position => Control::Position,
            Strategy::Joint => Control::JointImpedance {
                stiffness: JOINT_SPRINGS.0,
                damping: JOINT_SPRINGS.1,
            },
            Strategy::Cartesian => Control::CartesianImpedance {
                stiffness: TOOL_SPRINGS.0,
                damping: TOOL_SPRINGS.1,
            },
        };
        Ok(Overlay { control, command })
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use takt_devices::fri::emulator::MISSES_MAX;
    use takt_fri::sunrise::emulator::{Program, Timing};

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        iiwa: Iiwa,
    }

    fn config(words: &str) -> Result<CabinetConfig, String> {
        let line = Line::try_parse_from(std::iter::once("iiwa").chain(words.split_whitespace()));
        let line = line.map_err(|e| e.to_string())?;
        line.iiwa.config().map_err(|e| e.to_string())
    }

    #[test]
    fn iiwa_overlay_sets_its_control_mode() {
        let overlay = |words| match config(words).unwrap().program {
            Program::Auto { overlay, .. } => (overlay.command, overlay.control.mode()),
            Program::Manual => panic!("no program"),
        };
        use takt_fri::sunrise::wire::ControlMode as Mode;
        for (words, command, control) in [
            ("", CommandMode::Position, Mode::Position),
            (
                "--control joint",
                CommandMode::Position,
                Mode::JointImpedance,
            ),
            (
                "--overlay torque",
                CommandMode::Torque,
                Mode::JointImpedance,
            ),
            (
                "--overlay wrench",
                CommandMode::Wrench,
                Mode::CartesianImpedance,
            ),
            (
                "--overlay pose --dialect v2",
                CommandMode::CartesianPose,
                Mode::Position,
            ),
        ] {
            assert_eq!(overlay(words), (command, control), "{words}");
        }
        let error = config("--overlay wrench --control joint").unwrap_err();
        assert!(error.contains("wrenches with cartesian"), "{error}");
        let error = config("--overlay pose").unwrap_err();
        assert!(error.contains("--dialect v2"), "{error}");
    }

    #[test]
    fn iiwa_inputs_outputs_and_frames_reach_the_cabinet() {
        let words = "--input Media.Key=true --input Media.Count=3 --output Media.Level=0.5 --frame Tool --frame Part";
        let cabinet = Cabinet::new(config(words).unwrap(), Duration::ZERO);
        assert_eq!(cabinet.io("Media.Key"), Some(IoLevel::Boolean(true)));
        assert_eq!(cabinet.io("Media.Count"), Some(IoLevel::Digital(3)));
        assert_eq!(cabinet.io("Media.Level"), Some(IoLevel::Analog(0.5)));
        assert_eq!(config(words).unwrap().requested_frames, ["Tool", "Part"]);
        let many: String = (0..11).map(|i| format!("--output A.B{i}=1 ")).collect();
        for (wrong, cause) in [
            ("--input Media.Key", "such as Media.Lamp=false"),
            ("--input =true", "is no name"),
            ("--output A.B=NaN", "is no value"),
            ("--output A.B=-1 --input A.B=2", "`A.B` is given twice"),
            (many.as_str(), "FRI carries 10 at most"),
            (
                "--frame a --frame b --frame c --frame d --frame e --frame f",
                "carries 5 at most",
            ),
        ] {
            let error = config(wrong).unwrap_err();
            assert!(error.contains(cause), "{wrong}: {error}");
        }
    }

    #[test]
    fn knobs_reach_the_cabinet() {
        let words =
            "--receive-multiplier 3 --mode t1 --duplicate 0.1 --drift -20 --contact wall:0.02:5000";
        let cabinet = config(words).unwrap();
        assert_eq!(
            (cabinet.receive_multiplier, cabinet.operation_mode),
            (3, OperationMode::T1)
        );
        assert!((cabinet.faults.to_cabinet.duplicate - 0.1).abs() < 1e-12);
        assert!((cabinet.faults.drift_ppm + 20.0).abs() < 1e-12);
        let contact = cabinet.contact.unwrap();
        let flange = Cabinet::new(CabinetConfig::default(), Duration::ZERO).tip();
        assert!((flange[2] - contact.point[2] - 0.02).abs() < 1e-9);
        assert_eq!(cabinet.timing.misses_max, MISSES_MAX);
        assert_eq!(config("--strict").unwrap().timing, Timing::default());
    }
}
