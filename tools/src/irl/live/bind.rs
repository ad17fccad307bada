//! Which arms and inputs and outputs a program uses, from the options and from what the controller has.

use takt_api::{Cell, ErrorKind};
use takt_irl::net::{Binding, Channel};
use takt_irl::{Direction, Program, Signal, SignalKind};

use super::{Live, Options};
use crate::irl::values::{assignment, signal_of, value_of};
use crate::net::server::Server;

/// What a signal without a device is bound to.
const NO_DEVICE: &str = "none";
/// Most variables that are watched.
const WATCH_MAX: usize = 512;

/// The binding, and the types of its arms.
pub(super) fn binding(
    live: &Live,
    server: &Server,
    program: &Program,
    options: &Options<'_>,
) -> anyhow::Result<(Binding, Vec<String>)> {
    let arms = arms(live, program)?;
    let (channels, values) = signals(live, program, options.inputs)?;
    let mut kinds = Vec::new();
    if !arms.is_empty() || channels.iter().any(Option::is_some) {
        let cell = server.cell()?;
        for (robot, arm) in program.system.robots.iter().zip(&arms) {
            kinds.push(kind_of(&cell, &robot.name, arm)?);
        }
        for (signal, channel) in program.system.signals.iter().zip(&channels) {
            if let Some(channel) = channel {
                find(&cell, signal, channel)?;
            }
        }
        cell.close()?;
    }
    let variables = program.variables.iter().map(|variable| &variable.name);
    // The records of robots follow what the program declares.
    let is_own = |name: &&String| {
        let robots = &program.system.robots;
        robots
            .iter()
            .all(|robot| !name.starts_with(&format!("{}.", robot.name)))
    };
    let watch = variables.filter(is_own).take(WATCH_MAX).cloned().collect();
    let binding = Binding {
        arms,
        channels,
        values,
        watch,
        steps: options.steps,
        breakpoints: live.breakpoints.clone(),
        speed: live.speed,
        is_held: live.paused,
    };
    Ok((binding, kinds))
}

fn arms(live: &Live, program: &Program) -> anyhow::Result<Vec<String>> {
    let robots = &program.system.robots;
    let mut given: Vec<(String, String)> = Vec::new();
    for text in &live.robot {
        let (robot, arm) = assignment(text, "ROBOT=ARM")?;
        let is_known = robots.iter().any(|r| r.name.eq_ignore_ascii_case(robot));
        let known = || {
            robots
                .iter()
                .map(|r| r.name.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        };
        anyhow::ensure!(
            is_known,
            "the program has no robot `{robot}`\nhint: its robots are {}",
            known()
        );
        let is_twice = given
            .iter()
            .any(|(name, _)| robot.eq_ignore_ascii_case(name));
        anyhow::ensure!(!is_twice, "robot {robot} is bound twice");
        given.push((robot.to_ascii_lowercase(), arm.to_owned()));
    }
    let arms = robots.iter().map(|robot| {
        let arm = given.iter().find(|(name, _)| *name == robot.name);
        arm.map_or_else(|| robot.name.clone(), |(_, arm)| arm.clone())
    });
    Ok(arms.collect())
}

/// The type of an arm.
fn kind_of(cell: &Cell, robot: &str, arm: &str) -> anyhow::Result<String> {
    let found = cell.arm(arm).map_err(|error| {
        if let ErrorKind::NoDevice { known, .. } = &error.kind {
            return anyhow::anyhow!(
                "robot {robot} of the program has no arm `{arm}`\nhint: name one with --robot {robot}=ARM; the controller has {known}"
            );
        }
        anyhow::anyhow!(error.kind)
    })?;
    Ok(found.description().kind.clone())
}

/// Whether the device has the ports of a signal.
fn find(cell: &Cell, signal: &Signal, channel: &Channel) -> anyhow::Result<()> {
    let wrong = |error: takt_api::Error| anyhow::anyhow!("signal {}: {}", signal.name, error.kind);
    let io = cell.io(&channel.device).map_err(wrong)?;
    for bit in 0..signal.width() {
        let port = u32::from(channel.port) + u32::from(bit);
        match (signal.direction, signal.kind) {
            (Direction::In, SignalKind::Analog) => io.analogue_input(port).map(drop),
            (Direction::Out, SignalKind::Analog) => io.analogue_output(port).map(drop),
            (Direction::In, SignalKind::Digital | SignalKind::Binary) => io.input(port).map(drop),
            (Direction::Out, SignalKind::Digital | SignalKind::Binary) => io.output(port).map(drop),
        }
        .map_err(wrong)?;
    }
    Ok(())
}

/// Channels of the signals, and first values of those without one.
type Signals = (Vec<Option<Channel>>, Vec<Option<String>>);

fn signals(live: &Live, program: &Program, inputs: &[String]) -> anyhow::Result<Signals> {
    let signals = &program.system.signals;
    let find = |name: &str| signal_of(program, name);
    let mut channels = vec![None; signals.len()];
    let mut values = vec![None; signals.len()];
    for (signal, channel) in signals.iter().zip(&mut channels) {
        channel.clone_from(&signal.io);
    }
    let mut given = vec![false; signals.len()];
    for text in &live.signal {
        let (name, channel) = assignment(text, "SIGNAL=DEVICE:PORT")?;
        let number = find(name)?;
        anyhow::ensure!(!given[number], "signal `{name}` is bound twice");
        given[number] = true;
        channels[number] = match channel {
            NO_DEVICE => None,
            channel => Some(channel.parse().map_err(anyhow::Error::msg)?),
        };
    }
    for text in inputs {
        let (name, value) = assignment(text, "SIGNAL=VALUE")?;
        let number = find(name)?;
        let signal = &signals[number];
        anyhow::ensure!(
            signal.direction == Direction::In,
            "`{name}` is an output; only inputs take a value"
        );
        anyhow::ensure!(
            !given[number] || channels[number].is_none(),
            "input `{name}` has a device and a value\nhint: give --signal or --input"
        );
        values[number] = Some(value_of(signal, value)?);
        channels[number] = None;
    }
    let all = signals.iter().zip(channels.iter().zip(&values));
    let missing = all.filter(|(signal, (channel, value))| {
        signal.direction == Direction::In && channel.is_none() && value.is_none()
    });
    let missing: Vec<_> = missing.map(|(signal, _)| signal.name.as_str()).collect();
    anyhow::ensure!(
        missing.is_empty(),
        "inputs of the program have no device: {}\nhint: name it with --signal {}=DEVICE:PORT, or a value with --input",
        missing.join(", "),
        missing.first().unwrap_or(&"")
    );
    Ok((channels, values))
}
