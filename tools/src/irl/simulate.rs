//! `takt irl run`: a program in virtual time, with robots that follow exactly, unless a controller is named. No device is known
//! here.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use takt_irl::{Control, Direction, Machine, Phase, SignalKind};

use super::Source;
use super::live::{Live, Options};
use super::values::{assignment, signal_of, value_of};
use crate::Verdict;
use crate::output::{complain, positive_span, save, say};

/// Run a program: in virtual time with robots that follow exactly, or on the arms of a controller.
///
/// On a controller (`--connect`, `--emulated`), each line is printed when the program comes to it. Standard input takes `pause`,
/// `continue`, `step`, `break LINE`, `clear LINE`, `print [NAME]`, `override 0.5`, `set SIGNAL=VALUE` and `stop`. Ctrl-C stops on the path
/// and waits for rest; a second one ends at once, and the controller brakes.
///
/// Exit status: 0 the program ended by itself; 1 it failed or has errors; 2 it could not be tried.
#[derive(Debug, Args)]
pub(crate) struct Simulate {
    #[command(flatten)]
    source: Source,
    /// Time from one cycle to the next.
    #[arg(long, value_name = "TIME", default_value = "1ms", value_parser = positive_span, conflicts_with_all = LIVE)]
    period: Duration,
    /// Longest time that the program may take in virtual time.
    #[arg(long, value_name = "TIME", default_value = "600s", value_parser = positive_span, conflicts_with_all = LIVE)]
    duration: Duration,
    /// Most steps of the program in a cycle.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(16..=100_000))]
    steps: u32,
    /// Value of an input, such as part_present=1. May be given several times. Without one, an input has no value in virtual
    /// time, and needs a --signal on a controller.
    #[arg(long, value_name = "SIGNAL=VALUE")]
    input: Vec<String>,
    /// Write time (s) and joint positions (deg) of each cycle to this file.
    #[arg(long, value_name = "FILE", conflicts_with_all = LIVE)]
    csv: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long, conflicts_with_all = LIVE)]
    json: bool,
    #[command(flatten)]
    live: Live,
}

/// Options that name a controller.
const LIVE: [&str; 2] = ["connect", "emulated"];

impl Simulate {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let Some(program) = self.source.program()? else {
            return Ok(Verdict::Failed);
        };
        if self.live.is_requested() {
            let options = Options {
                name: self.source.name(),
                steps: self.steps,
                inputs: &self.input,
                text: self.source.text(),
            };
            return self.live.run(&program, &options);
        }
        let mut machine = Machine::new(Arc::new(program), &[], self.period, self.steps)?;
        let homes: Vec<Vec<f64>> = machine.program().system.robots.iter().map(home).collect();
        for (robot, home) in homes.iter().enumerate() {
            machine.place(robot, home);
        }
        for input in &self.input {
            set(&mut machine, input)?;
        }
        let mut csv = head(&machine);
        let cycles = self.duration.as_nanos() / self.period.as_nanos().max(1);
        let mut cycle = 0_u128;
        loop {
            let phase = machine.cycle(Control {
                resume: true,
                ..Control::default()
            });
            cycle += 1;
            if self.csv.is_some() {
                row(&mut csv, cycle as f64 * self.period.as_secs_f64(), &machine);
            }
            let has_ended = matches!(phase, Phase::Ended | Phase::Failed);
            if (has_ended && machine.is_at_rest()) || cycle >= cycles {
                break;
            }
        }
        if let Some(path) = &self.csv {
            save(path, &csv)?;
        }
        self.report(&machine, cycle as f64 * self.period.as_secs_f64())
    }

    fn report(&self, machine: &Machine, time_s: f64) -> anyhow::Result<Verdict> {
        let name = self.source.name();
        let phase = machine.phase();
        let program = machine.program();
        let ends: Vec<(String, Vec<f64>)> = program
            .system
            .robots
            .iter()
            .enumerate()
            .map(|(i, robot)| {
                (
                    robot.name.clone(),
                    machine.positions(i).iter().map(|q| rounded(*q)).collect(),
                )
            })
            .collect();
        if self.json {
            let robots: serde_json::Map<_, _> =
                ends.into_iter().map(|(name, q)| (name, q.into())).collect();
            let fault = machine.fault().map(|f| {
                serde_json::json!({"code": f.kind as i32, "line": f.at.line, "column": f.at.column, "text": f.kind.to_string()})
            });
            let json = serde_json::json!({
                "ok": phase == Phase::Ended, "file": name, "time_s": time_s, "fault": fault, "robots_deg": robots,
            });
            say(&json.to_string())?;
        } else {
            for (robot, positions) in &ends {
                let positions: Vec<String> = positions.iter().map(|q| format!("{q:.3}")).collect();
                say(&format!("{robot}: at {} deg", positions.join(" ")))?;
            }
            match (phase, machine.fault()) {
                (Phase::Ended, _) => say(&format!("{name}: ended after {time_s:.3} s"))?,
                (_, Some(fault)) => complain(&format!("{name}:{fault}")),
                _ => complain(&format!(
                    "{name}:{}: did not end within {time_s:.3} s\nhint: a longer --duration, or an --input that it waits for",
                    machine.location().line
                )),
            }
        }
        Ok(if phase == Phase::Ended {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// Millionths of a degree, without a negative zero.
fn rounded(radians: f64) -> f64 {
    (radians.to_degrees() * 1e6).round() / 1e6 + 0.0
}

fn home(robot: &takt_irl::Robot) -> Vec<f64> {
    robot.home.iter().map(|q| q.to_radians()).collect()
}

fn set(machine: &mut Machine, input: &str) -> anyhow::Result<()> {
    let (name, value) = assignment(input, "SIGNAL=VALUE")?;
    let number = signal_of(machine.program(), name)?;
    let signal = &machine.program().system.signals[number];
    anyhow::ensure!(
        signal.direction == Direction::In,
        "`{name}` is an output; only inputs take a value"
    );
    let value = value_of(signal, value)?;
    let word = match signal.kind {
        SignalKind::Digital => u64::from(value == "true"),
        SignalKind::Analog => value.parse::<f64>()?.to_bits(),
        SignalKind::Binary => value.parse::<i64>()?.cast_unsigned(),
    };
    machine.set_input(number, Some(word));
    Ok(())
}

fn head(machine: &Machine) -> String {
    let mut head = "time_s".to_owned();
    for robot in &machine.program().system.robots {
        for joint in 1..=robot.joints.len() {
            let _ = write!(head, ",{}.{joint}_deg", robot.name);
        }
    }
    head.push('\n');
    head
}

fn row(out: &mut String, time_s: f64, machine: &Machine) {
    let _ = write!(out, "{time_s:.6}");
    for robot in 0..machine.program().system.robots.len() {
        for q in machine.positions(robot) {
            let _ = write!(out, ",{:.6}", rounded(*q));
        }
    }
    out.push('\n');
}
