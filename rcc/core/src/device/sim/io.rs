//! Simulated inputs and outputs: each input has the value that the output with its number had in the previous cycle.
//!
//! Parameters: `bools` and `reals`, number of each (8 and 2); `on_end_bool` and `on_end_real`, output policies at the
//! end of a net.

use takt_net::device::{Given, Interfaces, Io, Layout, Output, Signal, Words};
use takt_rt::Nanos;

use super::{Made, Parameters, Simulated};
use crate::device::on_end::OutputsOnEnd;
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, Part, parts};
use crate::error::Error;

const MOST: usize = 64;

pub(super) fn looped(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let bools = parameters.count("bools", 8, 0..=MOST)?;
    let reals = parameters.count("reals", 2, 0..=MOST)?;
    let part = Part::Io {
        bool_in: bools,
        bool_out: bools,
        real_in: reals,
        real_out: reals,
    };
    let description = DeviceDescription {
        name: parameters.name.to_owned(),
        kind,
        limits: Vec::new(),
        model: "".into(),
        parts: vec![part],
    };
    let mut layout = Layout::default();
    let interfaces = parts::lay(&description.parts, 0, &mut layout);
    let mut state = DeviceState::new(layout.signals);
    state.status = DeviceStatus::Operational;
    let on_end = parameters.on_end(bools, reals)?;
    let mut looped = Looped {
        interfaces,
        state,
        on_end,
    };
    looped.step(&DeviceCommand::new(layout.commands), Nanos::ZERO);
    Ok((description, Box::new(looped)))
}

#[derive(Debug)]
struct Looped {
    interfaces: Interfaces,
    state: DeviceState,
    on_end: OutputsOnEnd,
}

impl Simulated for Looped {
    fn step(&mut self, command: &DeviceCommand, _dt: Nanos) {
        self.state.stamp = command.time;
        self.retract(command);
    }

    fn retract(&mut self, command: &DeviceCommand) {
        if let Some(io) = &self.interfaces.io {
            loop_back(io, &self.on_end, command, &mut self.state);
        }
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}

/// Sets outputs as commanded, and each input to the output with its number, if there is one.
pub(super) fn loop_back(
    io: &Io,
    on_end: &OutputsOnEnd,
    command: &DeviceCommand,
    state: &mut DeviceState,
) {
    let truth = |port, given| on_end.truth(port, given);
    connect(&io.bool_in, &io.bool_out, truth, command, state);
    let number = |port, given| on_end.number(port, given);
    connect(&io.real_in, &io.real_out, number, command, state);
}

fn connect<T: Words + Default>(
    inputs: &[Signal<T>],
    outputs: &[Output<T>],
    wanted: impl Fn(usize, Option<Given<T>>) -> Option<T>,
    command: &DeviceCommand,
    state: &mut DeviceState,
) {
    for (number, output) in outputs.iter().enumerate() {
        let value = output.command.read(&command.words);
        let value = wanted(number, value).unwrap_or_default();
        output.state.report(&mut state.signals, Some(value));
        if let Some(input) = inputs.get(number) {
            input.report(&mut state.signals, Some(value));
        }
    }
}
