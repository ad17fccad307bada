//! `takt can rmp`: a Segway power base, on CAN or at its USB port: its state, its scales, and a jog. Start-up, ramps and
//! odometry are those of the driver. It commands one power base; the platform of two is a device of the controller.

mod port;
mod session;
#[cfg(test)]
mod tests;
mod text;

use std::io::Write as _;
use std::time::Duration;

use clap::Args;
use takt_can::rmp::{Config, Gain, Model, YawSign};

use super::confirm;
use super::wire::Live;
use crate::Verdict;
use crate::output::{complain, is_terminal, positive_span, say};
use port::SerialPort;
use session::{Jog, Plan, Session, View};

/// Show a Segway power base, set its scales, jog it.
///
/// Without --set and --jog it only receives. Exit status: 0 it sends, and did what was requested; 1 not, with the
/// reason; 2 it could not be tried. Ctrl-C brakes.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can rmp can0
  takt can rmp --serial /dev/ttyUSB0 --model rmp50 --duration 5s --json
  takt can rmp can0 --set velocity=16,turn=16
  takt can rmp can0 --jog 0.2,0 --duration 2s --yes
  takt can rmp can0 --jog 0,0.5 --duration 4s --yes        checks the sign of its yaw")]
pub(crate) struct Rmp {
    /// The CAN interface.
    #[arg(required_unless_present = "serial", conflicts_with = "serial")]
    interface: Option<String>,
    /// The serial port of its USB chip, such as /dev/ttyUSB0.
    #[arg(long, value_name = "DEV")]
    serial: Option<String>,
    /// `rmp50`, `rmp100`, `rmp200` or `rmp400`: the scales of its counts.
    #[arg(long, default_value = "rmp200", value_parser = model)]
    model: Model,
    /// How long to observe it, by default until Ctrl-C on a terminal and 2s elsewhere; with --jog, how long to drive it,
    /// by default 1s.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    /// Set stored values: velocity, acceleration, turn (sixteenths, 0 to 16), current (0 to 256), gain (0 to 2),
    /// as in velocity=16,turn=16.
    #[arg(long, value_name = "NAME=VALUE,..", value_parser = configs)]
    set: Option<Configs>,
    /// Drive it: metres per second forward and radians per second counter-clockwise.
    #[arg(long, value_name = "M/S,RAD/S", value_parser = velocity, allow_hyphen_values = true)]
    jog: Option<Velocity>,
    /// Which way its integrated yaw (404h) counts: clockwise, or counter_clockwise. A jog that turns it by a sixth of a
    /// revolution or more says whether that is right.
    #[arg(long, value_name = "SIGN", default_value = "clockwise", value_parser = yaw_sign)]
    yaw_integral: YawSign,
    /// Print one JSON object at the end instead.
    #[arg(long)]
    json: bool,
    /// It is safe that the machine moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
}

/// Settings of the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Configs(Vec<Config>);

/// A velocity of the command line: forward, m/s, and rotation, rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Velocity([f64; 2]);

/// Largest speed of a jog, m/s and rad/s: a walk.
const SPEED_MAX: f64 = 1.5;
const ROTATION_MAX: f64 = 1.5;
/// How long to receive without a terminal.
const DURATION: Duration = Duration::from_secs(2);
/// How long to drive it unless the command line gives a duration.
const JOG: Duration = Duration::from_secs(1);

fn model(text: &str) -> Result<Model, String> {
    Model::named(text).ok_or_else(|| {
        let known = Model::ALL.map(Model::name).join(", ");
        format!("there is no such model\nhint: write one of {known}")
    })
}

fn yaw_sign(text: &str) -> Result<YawSign, String> {
    YawSign::named(text).ok_or_else(|| {
        let known = YawSign::ALL.map(YawSign::name).join(" or ");
        format!("`{text}` is no sign: write {known}")
    })
}

fn configs(text: &str) -> Result<Configs, String> {
    text.split(',')
        .map(config)
        .collect::<Result<_, _>>()
        .map(Configs)
}

fn config(text: &str) -> Result<Config, String> {
    let wrong = || {
        format!(
            "`{text}` is no setting: write velocity=, acceleration= or turn= (0 to 16), current= (0 to 256), \
             gain= (0 to 2)"
        )
    };
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    let value: u16 = value.trim().parse().map_err(|_| wrong())?;
    let sixteenths = u8::try_from(value).ok().filter(|scale| *scale <= 16);
    match (name.trim(), sixteenths) {
        ("velocity", Some(scale)) => Ok(Config::MaxVelocity(scale)),
        ("acceleration", Some(scale)) => Ok(Config::MaxAcceleration(scale)),
        ("turn", Some(scale)) => Ok(Config::MaxTurn(scale)),
        ("current", _) if value <= 256 => Ok(Config::CurrentLimit(value)),
        ("gain", _) if value <= 2 => Ok(Config::Gain(Gain::from_raw(value))),
        _ => Err(wrong()),
    }
}

fn velocity(text: &str) -> Result<Velocity, String> {
    let wrong =
        || format!("`{text}` is no velocity: write metres and radians per second, as in 0.2,-0.1");
    let (forward, rotation) = text.split_once(',').unwrap_or((text, "0"));
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wrong());
    let (forward, rotation) = (number(forward)?, number(rotation)?);
    if forward.abs() <= SPEED_MAX && rotation.abs() <= ROTATION_MAX {
        return Ok(Velocity([forward, rotation]));
    }
    Err(format!(
        "{text} is too fast to jog: at most {SPEED_MAX} m/s and {ROTATION_MAX} rad/s"
    ))
}

impl Rmp {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        match (&self.serial, &self.interface) {
            (Some(device), _) => {
                let mut port = SerialPort::open(device)?;
                self.session(&mut port, device)
            }
            (None, Some(interface)) => {
                let mut wire = Live::open_to_stop(interface)?;
                self.session(&mut wire, interface)
            }
            (None, None) => {
                anyhow::bail!("no interface is named\nhint: name one, or a serial port by --serial")
            }
        }
    }

    fn session<P: port::Port>(&self, port: &mut P, place: &str) -> anyhow::Result<Verdict> {
        if self.jog.is_some() {
            confirm::action(place, "driving the power base", self.confirm_motion)?;
        }
        let live = is_terminal() && !self.json;
        let plan = Plan {
            model: self.model,
            yaw_integral: self.yaw_integral,
            duration: self
                .duration
                .filter(|_| self.jog.is_none())
                .or_else(|| (!live).then_some(DURATION)),
            configs: self.set.clone().map_or_else(Vec::new, |configs| configs.0),
            jog: self.jog.map(|Velocity(velocity)| Jog {
                velocity,
                time: self.duration.unwrap_or(JOG),
            }),
        };
        let mut show = |view: &View| {
            if live {
                redraw(&text::view(view));
            }
        };
        let report = Session::new(port, plan).run(&mut show)?;
        if live {
            complain("");
        }
        let text = match self.json {
            true => text::json(&report).to_string(),
            false => text::report(place, &report),
        };
        say(text.trim_end())?;
        Ok(match report.is_good() {
            true => Verdict::Good,
            false => Verdict::Failed,
        })
    }
}

/// Overwrites the last view. Errors of the terminal are ignored.
fn redraw(text: &str) {
    let lines = text.lines().count();
    let mut out = std::io::stderr().lock();
    let _ = write!(out, "\x1b[J{text}\x1b[{lines}A\r");
    let _ = out.flush();
}
