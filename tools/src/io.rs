//! `takt io`: inputs and outputs of devices, through the Robotics API. Ports are numbers from 0, as in nets.

use std::fmt;
use std::time::Duration;

use anyhow::ensure;
use clap::{Args, Subcommand};
use serde_json::json;
use takt_api::{IoState, Outcome};

use crate::Verdict;
use crate::motion::{confirm_device, hinted, perform_unplanned};
use crate::net::server::Server;
use crate::output::{positive_span, say};

/// What is done with inputs and outputs.
#[derive(Debug, Subcommand)]
pub(crate) enum Io {
    List(List),
    Get(Get),
    Set(Set),
}

/// List inputs and outputs: each device with its ports and their states.
///
/// Ports are in0 (digital input), out0 (digital output), ain0 (analogue input) and aout0 (analogue output), counted from 0.
/// `-` is a state that the device does not know, as while it is offline.
#[derive(Debug, Args)]
pub(crate) struct List {
    /// Only this device.
    device: Option<String>,
    /// Print one JSON object a device.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: Server,
}

/// Print the state of an input or output: true, false, or a number in the unit of the device.
///
/// Exit status: 0 it is known; 1 there is no such port, or the device does not know it.
#[derive(Debug, Args)]
pub(crate) struct Get {
    /// The device, as in cell.toml.
    device: String,
    /// in0, out0, ain0 or aout0, counted from 0.
    #[arg(value_parser = port)]
    port: Port,
    #[command(flatten)]
    server: Server,
}

/// Set an output. It keeps its state when the command has ended.
///
/// Outputs switch valves and drives: the command asks for confirmation, unless the controller simulates the device.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt io set plant out3 true
  takt io set plant out3 true --for 200ms
  takt io set plant aout0 -2.5 --yes")]
pub(crate) struct Set {
    /// The device, as in cell.toml.
    device: String,
    /// out0 or aout0, counted from 0.
    #[arg(value_parser = port)]
    port: Port,
    /// true or false; a number in the unit of the device for aout0.
    #[arg(allow_negative_numbers = true)]
    value: String,
    /// Set a digital output for this time only, up to 1h, and then to the contrary.
    #[arg(long = "for", value_name = "TIME", value_parser = positive_span)]
    time: Option<Duration>,
    /// It is safe to set the output; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    yes: bool,
    #[command(flatten)]
    server: Server,
}

/// Kind of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    DigitalInput,
    DigitalOutput,
    AnalogueInput,
    AnalogueOutput,
}

const KINDS: [(Kind, &str); 4] = [
    (Kind::DigitalInput, "in"),
    (Kind::DigitalOutput, "out"),
    (Kind::AnalogueInput, "ain"),
    (Kind::AnalogueOutput, "aout"),
];

impl Kind {
    /// States of all its ports as texts.
    fn states(self, state: &IoState) -> Vec<Option<String>> {
        fn texts<T: fmt::Display>(all: &[Option<T>]) -> Vec<Option<String>> {
            let text = |value: &Option<T>| value.as_ref().map(ToString::to_string);
            all.iter().map(text).collect()
        }
        match self {
            Self::DigitalInput => texts(&state.digital_inputs),
            Self::DigitalOutput => texts(&state.digital_outputs),
            Self::AnalogueInput => texts(&state.analogue_inputs),
            Self::AnalogueOutput => texts(&state.analogue_outputs),
        }
    }
}

/// A port of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Port {
    kind: Kind,
    number: u32,
}

/// Reads the name of a port.
fn port(text: &str) -> Result<Port, String> {
    let of = |(kind, name): &(Kind, &str)| {
        let number = text.strip_prefix(name)?;
        let is_number = number.bytes().all(|byte| byte.is_ascii_digit());
        let number = number.parse().ok().filter(|_| is_number)?;
        Some(Port {
            kind: *kind,
            number,
        })
    };
    let wrong = || {
        format!(
            "`{text}` is no port: write in0, out0, ain0 or aout0, counted from 0; `takt io list` shows them"
        )
    };
    KINDS.iter().find_map(of).ok_or_else(wrong)
}

impl Io {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        match self {
            Self::List(list) => list.run(),
            Self::Get(get) => get.run(),
            Self::Set(set) => set.run(),
        }
    }
}

impl List {
    fn run(&self) -> anyhow::Result<Verdict> {
        let cell = self.server.cell()?;
        let devices = match &self.device {
            Some(name) => vec![cell.io(name).map_err(hinted)?],
            None => cell.ios().map_err(hinted)?,
        };
        if devices.is_empty() && !self.json {
            say("no device of this controller has inputs or outputs")?;
        }
        for device in devices {
            let state = device.state().map_err(hinted)?;
            say(&if self.json {
                json!({
                    "device": device.name(), "type": device.kind(),
                    "in": state.digital_inputs, "out": state.digital_outputs,
                    "ain": state.analogue_inputs, "aout": state.analogue_outputs,
                })
                .to_string()
            } else {
                listed(device.name(), device.kind(), &state)
            })?;
        }
        Ok(Verdict::Good)
    }
}

/// A device with its ports: those of a kind in a line.
fn listed(name: &str, kind: &str, state: &IoState) -> String {
    let mut text = format!("{name} ({kind})");
    for (kind, prefix) in KINDS {
        let states = kind.states(state);
        let Some(last) = states.len().checked_sub(1) else {
            continue;
        };
        let range = match last {
            0 => format!("{prefix}0"),
            last => format!("{prefix}0 to {prefix}{last}"),
        };
        let states = states.into_iter();
        let states = states.map(|it| it.map_or_else(|| "-".to_owned(), |it| short(&it).to_owned()));
        let states: Vec<_> = states.collect();
        text = format!("{text}\n  {range:<15} {}", states.join(" "));
    }
    text
}

/// Digital states as digits, so that a row of them fits.
fn short(state: &str) -> &str {
    match state {
        "true" => "1",
        "false" => "0",
        number => number,
    }
}

impl Get {
    fn run(&self) -> anyhow::Result<Verdict> {
        let cell = self.server.cell()?;
        let io = cell.io(&self.device).map_err(hinted)?;
        let Port { kind, number } = self.port;
        // For its error, which lists what there is.
        match kind {
            Kind::DigitalInput => io.input(number).map(drop),
            Kind::DigitalOutput => io.output(number).map(drop),
            Kind::AnalogueInput => io.analogue_input(number).map(drop),
            Kind::AnalogueOutput => io.analogue_output(number).map(drop),
        }
        .map_err(hinted)?;
        let states = kind.states(&io.state().map_err(hinted)?);
        let state = usize::try_from(number).ok().and_then(|at| states.get(at));
        match state.cloned().flatten() {
            Some(state) => {
                say(&state)?;
                Ok(Verdict::Good)
            }
            None => {
                say("not known")?;
                crate::output::complain(
                    "hint: the page of the controller and the log of `takt run` say why the device is offline",
                );
                Ok(Verdict::Failed)
            }
        }
    }
}

impl Set {
    fn run(&self) -> anyhow::Result<Verdict> {
        let cell = self.server.cell()?;
        let io = cell.io(&self.device).map_err(hinted)?;
        let number = self.port.number;
        let activity = match self.port.kind {
            Kind::DigitalOutput => {
                let state = match self.value.as_str() {
                    "true" | "1" | "on" => true,
                    "false" | "0" | "off" => false,
                    other => anyhow::bail!(
                        "`{other}` is no state of a digital output: write true or false"
                    ),
                };
                match self.time {
                    Some(time) => io.pulse(number, state, time),
                    None => io.set(number, state),
                }
            }
            Kind::AnalogueOutput => {
                ensure!(self.time.is_none(), "--for is for digital outputs");
                let value = self.value.parse().ok().filter(|it: &f64| it.is_finite());
                let Some(value) = value else {
                    anyhow::bail!(
                        "`{}` is no value of an analogue output: write a number in the unit of the device, such as 2.5",
                        self.value
                    );
                };
                io.set_analogue(number, value)
            }
            Kind::DigitalInput | Kind::AnalogueInput => {
                anyhow::bail!("inputs cannot be set\nhint: outputs are out0 and aout0")
            }
        };
        activity.explain().map_err(hinted)?;
        confirm_device("setting an output of", &self.device, io.kind(), self.yes)?;
        let outcome = perform_unplanned(activity)?;
        drop(io);
        cell.close().map_err(hinted)?;
        Ok(if outcome == Outcome::Completed {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn port_names_have_kind_and_number() {
        let read = |text| port(text).map(|it| (it.kind, it.number));
        assert_eq!(read("in0"), Ok((Kind::DigitalInput, 0)));
        assert_eq!(read("out15"), Ok((Kind::DigitalOutput, 15)));
        assert_eq!(read("ain3"), Ok((Kind::AnalogueInput, 3)));
        assert_eq!(read("aout2"), Ok((Kind::AnalogueOutput, 2)));
        for wrong in [
            "",
            "in",
            "in-1",
            "in+1",
            "x0",
            "0",
            "in1.0",
            "out99999999999",
        ] {
            let error = read(wrong).unwrap_err();
            assert!(error.contains("write in0"), "{wrong}: {error}");
        }
    }

    #[test]
    fn list_shows_ranges_and_unknown_states() {
        let state = IoState {
            digital_inputs: vec![Some(true), Some(false), None],
            analogue_outputs: vec![Some(-2.5)],
            ..IoState::default()
        };
        assert_eq!(
            listed("plant", "io_sim", &state),
            "plant (io_sim)\n  in0 to in2      1 0 -\n  aout0           -2.5"
        );
    }
}
