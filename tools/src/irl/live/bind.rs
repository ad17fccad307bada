//! Which arms and inputs and outputs a program uses, from the options and from what the controller has.

use anyhow::Context as _;
use takt_irl::net::{Binding, Channel};
use takt_irl::{Direction, Program, SignalKind};

use super::{Live, Options, assignment};
use crate::net::server::Server;

/// Most variables that are watched.
const WATCH_MAX: usize = 512;

/// The binding, and the types of its arms.
pub(super) fn binding(
    live: &Live,
    server: &Server,
    program: &Program,
    options: &Options<'_>,
) -> anyhow::Result<(Binding, Vec<String>)> {
    let (arms, kinds) = arms(live, server, program)?;
    let (channels, values) = signals(live, program, options.inputs)?;
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

fn arms(
    live: &Live,
    server: &Server,
    program: &Program,
) -> anyhow::Result<(Vec<String>, Vec<String>)> {
    let robots = &program.system.robots;
    let mut given = Vec::new();
    for text in &live.robot {
        let (robot, arm) = assignment(text, "ROBOT=ARM")?;
        let is_known = robots.iter().any(|r| r.name.eq_ignore_ascii_case(robot));
        anyhow::ensure!(is_known, "the program has no robot `{robot}`");
        given.push((robot.to_ascii_lowercase(), arm.to_owned()));
    }
    let arms = robots.iter().map(|robot| {
        let arm = given.iter().find(|(name, _)| *name == robot.name);
        arm.map_or_else(|| robot.name.clone(), |(_, arm)| arm.clone())
    });
    let arms: Vec<String> = arms.collect();
    if arms.is_empty() {
        return Ok((arms, Vec::new()));
    }
    let cell = server.cell()?;
    let mut kinds = Vec::new();
    for (robot, name) in robots.iter().zip(&arms) {
        let arm = cell.arm(name).with_context(|| {
            format!(
                "robot {0} of the program has no arm\nhint: name one with --robot {0}=ARM",
                robot.name
            )
        })?;
        kinds.push(arm.description().kind.clone());
    }
    cell.close()?;
    Ok((arms, kinds))
}

/// Channels of the signals, and first values of those without one.
type Signals = (Vec<Option<Channel>>, Vec<Option<String>>);

fn signals(live: &Live, program: &Program, inputs: &[String]) -> anyhow::Result<Signals> {
    let signals = &program.system.signals;
    let find = |name: &str| {
        let number = signals
            .iter()
            .position(|s| s.name.eq_ignore_ascii_case(name));
        number.with_context(|| format!("the program has no signal `{name}`"))
    };
    let mut channels = vec![None; signals.len()];
    let mut values = vec![None; signals.len()];
    for text in &live.signal {
        let (name, channel) = assignment(text, "SIGNAL=DEVICE:PORT")?;
        let parts = channel.rsplit_once(':');
        let parts = parts.and_then(|(device, port)| Some((device, port.parse().ok()?)));
        let (device, port) = parts.with_context(|| format!("`{channel}` is not DEVICE:PORT"))?;
        let device = device.to_owned();
        channels[find(name)?] = Some(Channel { device, port });
    }
    for text in inputs {
        let (name, value) = assignment(text, "SIGNAL=VALUE")?;
        let number = find(name)?;
        let value = value_of(value, signals[number].kind);
        values[number] = Some(value.with_context(|| format!("`{text}` is not a value of it"))?);
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

/// A value as texts of nets have it.
fn value_of(text: &str, kind: SignalKind) -> Option<String> {
    match (kind, text) {
        (SignalKind::Digital, "1" | "true") => Some("true".to_owned()),
        (SignalKind::Digital, "0" | "false") => Some("false".to_owned()),
        (SignalKind::Digital, _) => None,
        (SignalKind::Analog, _) => text.parse::<f64>().ok().map(|value| value.to_string()),
        (SignalKind::Binary, _) => text.parse::<i32>().ok().map(|value| value.to_string()),
    }
}
