//! `takt ecat youbot`: status and parameters of the drives of a KUKA youBot, homing of its joints. Their protocol is in
//! `takt_ethercat::youbot`; wheels are moved by nets only.

mod home;
#[cfg(test)]
mod tests;

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::{Args, Subcommand};
use takt_ethercat::AlState;
use takt_ethercat::master::{JobError, JobKind};
use takt_ethercat::youbot::parameters::{Access, Parameter, ParameterGroup};
use takt_ethercat::youbot::{Answer, CallError, Flags, Request, TRINAMIC, TmclError, parameters};

use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target};
use crate::output::{complain, say};
use crate::signal::Stop;
use crate::{Verdict, confirm};

/// Capacity for a mailbox of any length.
const MAILBOX_MAX: usize = 1486;
/// Attempts of a request.
const ATTEMPTS: usize = 3;
/// Time after which late answers have arrived.
const SETTLE: Duration = Duration::from_millis(100);
/// Parameters that move something when they are written.
const MOVING: [&str; 7] = [
    "target_position",
    "target_speed",
    "actual_position",
    "initialized",
    "reinitialize",
    "bar_target_position",
    "bar_target_speed",
];

/// Speeds that are commanded, and the parameter that limits each.
const SPEEDS: [(&str, &str); 2] = [
    ("target_speed", "max_positioning_speed"),
    ("bar_target_speed", "bar_max_speed"),
];
/// Targets, and the position that shows whether something moves.
const TARGETS: [(&str, &str); 4] = [
    ("target_position", "actual_position"),
    ("target_speed", "actual_position"),
    ("bar_target_position", "bar_actual_position"),
    ("bar_target_speed", "bar_actual_position"),
];
/// Time within which a motor has moved after it got a target.
const MOVES_WITHIN: Duration = Duration::from_secs(1);
/// A motor that moved less did not move, ticks or steps.
const MOVED_FROM: u32 = 10;

/// Show the drives of a KUKA youBot, read and write their parameters, home its joints.
///
/// A motor that gets a target and does not move is reported, and so is a joint that is homed where it stood; a target
/// speed above the limit of its drive is rejected, and a motor that runs away while it is homed loses its current.
/// Exit status: 0 good; 1 a drive has a fault, rejects a value, did not move or was not homed; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat youbot enp2s0 status
  takt ecat youbot enp2s0 get 6 max_current
  takt ecat youbot enp2s0 set 6 max_current 2000
  takt ecat youbot enp2s0 parameters
  takt ecat youbot enp2s0 home 6 7 8 9 10 --yes")]
pub(crate) struct YouBot {
    #[command(flatten)]
    target: Target,
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Firmware, flags, supply and counters of all drives.
    Status,
    /// List the parameters: number, unit, range, who may write them.
    Parameters,
    /// Read a parameter.
    Get {
        /// Position of the drive from 0, or its name if no other has it.
        slave: String,
        /// As `parameters` lists it.
        parameter: String,
        /// Which bar of the gripper, for those of the gripper.
        #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=1))]
        bar: u8,
    },
    /// Write a parameter; it lasts until power-off.
    Set {
        /// Position of the drive from 0, or its name if no other has it.
        slave: String,
        /// As `parameters` lists it.
        parameter: String,
        /// In the unit of the parameter.
        #[arg(allow_hyphen_values = true)]
        value: i32,
        /// Which bar of the gripper, for those of the gripper.
        #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=1))]
        bar: u8,
        /// Keep it beyond power-off, in the drive's EEPROM.
        #[arg(long)]
        store: bool,
        /// Do not ask whether what moves is safe, and whether the value may be kept.
        #[arg(long)]
        yes: bool,
    },
    /// Move joints to their stops and set their encoders to 0 there.
    Home {
        /// Positions of the drives from 0, from the arm's first joint on.
        #[arg(required = true, num_args = 1..=5)]
        slaves: Vec<usize>,
        /// It is safe that the machine moves; do not ask.
        #[arg(long = "yes", alias = "confirm-motion")]
        confirm_motion: bool,
    },
}

impl YouBot {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        match &self.what {
            What::Parameters => {
                say(list().trim_end())?;
                Ok(Verdict::Good)
            }
            What::Status => {
                let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
                let (text, good) = status(&mut session)?;
                say(text.trim_end())?;
                Ok(verdict(good))
            }
            What::Get {
                slave,
                parameter,
                bar,
            } => {
                let parameter = named(parameter)?;
                let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
                let slave = session.find(slave)?;
                let answer = call(&mut session, slave, parameter.get(*bar))?;
                print(slave, parameter, answer)
            }
            What::Set {
                slave,
                parameter,
                value,
                bar,
                store,
                yes,
            } => {
                let parameter = named(parameter)?;
                let requests = writing(parameter, *bar, *value, *store)?;
                if MOVING.contains(&parameter.name) {
                    confirm::motion(&format!("writing {}", parameter.name), *yes)?;
                }
                if *store {
                    let what = format!("{} lasts beyond power-off", parameter.name);
                    confirm::change(&what, *yes)?;
                }
                let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
                let slave = session.find(slave)?;
                let motion = Motion::new(&mut session, slave, parameter, *bar, *value)?;
                let mut answer = Ok(Answer::Value(*value));
                for request in requests {
                    answer = answer.and(call(&mut session, slave, request)?);
                }
                let verdict = print(slave, parameter, answer.map(|_| Answer::Value(*value)))?;
                match motion {
                    Some(motion) if verdict == Verdict::Good => motion.check(&mut session),
                    Some(_) | None => Ok(verdict),
                }
            }
            What::Home {
                slaves,
                confirm_motion,
            } => {
                confirm::motion("homing", *confirm_motion)?;
                let mut session = self.target.bring_up(AlState::Op, home::CYCLE)?;
                home::check(&session, slaves)?;
                let stop = Stop::listen()?;
                let good = home::home(&mut session, slaves, &|| stop.is_requested(), say)?;
                Ok(verdict(good))
            }
        }
    }
}

const fn verdict(good: bool) -> Verdict {
    if good { Verdict::Good } else { Verdict::Failed }
}

fn named(name: &str) -> anyhow::Result<&'static Parameter> {
    Parameter::named(name)
        .with_context(|| format!("there is no parameter `{name}`\nhint: `parameters` lists them"))
}

/// The requests that write a parameter, and store it.
fn writing(
    parameter: &Parameter,
    bar: u8,
    value: i32,
    store: bool,
) -> anyhow::Result<Vec<Request>> {
    let mut requests = Vec::new();
    if parameter.access == Access::Protected {
        requests.push(Request::set(UNLOCK, 1));
    }
    requests.push(parameter.set(bar, value)?);
    if store {
        ensure!(
            parameter.group == ParameterGroup::Drive,
            "{} cannot be stored: only axis parameters of drives can",
            parameter.name
        );
        requests.push(Request::store(parameter.number));
    }
    Ok(requests)
}

/// Axis parameter by which protected ones are unlocked.
const UNLOCK: u8 = 248;

/// A motor that gets a target, and where it was before.
#[derive(Debug)]
struct Motion {
    slave: usize,
    position: &'static Parameter,
    bar: u8,
    start: i32,
}

impl Motion {
    /// Before a parameter is written; `None` if that gives no motor a target away from where it is.
    ///
    /// # Errors
    /// If it is a speed above the limit of its drive, or the drive does not answer.
    fn new<W: Wire>(
        session: &mut Session<W>,
        slave: usize,
        parameter: &Parameter,
        bar: u8,
        value: i32,
    ) -> anyhow::Result<Option<Self>> {
        let of = |pairs: &[(&str, &'static str)]| {
            let found = pairs.iter().find(|(name, _)| *name == parameter.name);
            found.and_then(|(_, other)| Parameter::named(other))
        };
        let limit = of(&SPEEDS);
        if let Some(limit) = limit {
            let most = read(session, slave, limit, bar)?;
            ensure!(
                value.unsigned_abs() <= most.unsigned_abs(),
                "{} {value} is too fast: {} of slave {slave} is {most} {}\nhint: write a lower speed",
                parameter.name,
                limit.name,
                limit.unit
            );
        }
        let Some(position) = of(&TARGETS) else {
            return Ok(None);
        };
        let start = read(session, slave, position, bar)?;
        let distance = if limit.is_some() {
            value.unsigned_abs().saturating_mul(MOVED_FROM)
        } else {
            value.abs_diff(start)
        };
        Ok((distance >= MOVED_FROM).then_some(Self {
            slave,
            position,
            bar,
            start,
        }))
    }

    /// Whether it moves now that its target is written.
    fn check<W: Wire>(self, session: &mut Session<W>) -> anyhow::Result<Verdict> {
        let Self {
            slave,
            position,
            bar,
            start,
        } = self;
        let end = session.now()? + MOVES_WITHIN;
        while session.now()? < end {
            if read(session, slave, position, bar)?.abs_diff(start) >= MOVED_FROM {
                return Ok(Verdict::Good);
            }
            session.run_for(SETTLE)?;
        }
        complain(&format!(
            "takt: slave {slave} did not move: {} is still {start} {}\n\
             hint: check its flags by `takt ecat youbot IFACE status` (not initialized, emergency stop, undervoltage), \
             its brake and its surroundings",
            position.name, position.unit
        ));
        Ok(Verdict::Failed)
    }
}

/// Reads a value.
fn read<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    parameter: &Parameter,
    bar: u8,
) -> anyhow::Result<i32> {
    let answer = call(session, slave, parameter.get(bar))?;
    let value = answer.with_context(|| format!("slave {slave}: cannot read {}", parameter.name))?;
    value
        .value()
        .context("the drive answered with its firmware")
}

/// Prints the value of a parameter, or why there is none.
fn print(
    slave: usize,
    parameter: &Parameter,
    answer: Result<Answer, CallError>,
) -> anyhow::Result<Verdict> {
    match answer {
        Ok(Answer::Value(value)) => {
            say(format!("{} {value} {}", parameter.name, parameter.unit).trim_end())?;
            Ok(Verdict::Good)
        }
        Ok(Answer::Version(_)) => bail!("slave {slave} answered with its firmware"),
        Err(error) => {
            complain(&format!("takt: slave {slave}: {}: {error}", parameter.name));
            Ok(Verdict::Failed)
        }
    }
}

fn list() -> String {
    let mut text = String::from("parameter                   number  where    unit    range\n");
    for parameter in parameters::ALL {
        let group = match parameter.group {
            ParameterGroup::Drive => "drive".to_owned(),
            ParameterGroup::Bank(bank) => format!("bank {bank}"),
            ParameterGroup::Bar => "gripper".to_owned(),
        };
        let range = match (parameter.access, parameter.range) {
            (Access::ReadOnly, _) => "read only".to_owned(),
            (_, (i32::MIN, i32::MAX)) => "any".to_owned(),
            (_, (low, i32::MAX)) => format!("from {low}"),
            (_, (low, high)) => format!("{low} to {high}"),
        };
        let lock = if parameter.access == Access::Protected {
            ", protected"
        } else {
            ""
        };
        let Parameter {
            name, number, unit, ..
        } = parameter;
        // Cannot fail.
        let _ = writeln!(
            text,
            "{name:<27} {number:>6}  {group:<8} {unit:<7} {range}{lock}"
        );
    }
    text
}

/// Sends a request to a drive, again if no answer arrives.
fn call<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    request: Request,
) -> anyhow::Result<Result<Answer, CallError>> {
    let mut last = Err(CallError::Refused(TmclError::Foreign));
    for _ in 0..ATTEMPTS {
        let mut data = Vec::with_capacity(MAILBOX_MAX);
        data.extend_from_slice(&request.encode());
        last = match session.request(slave, JobKind::RawMailbox, data)? {
            Ok(bytes) => request.answer(&bytes).map_err(CallError::Refused),
            Err(error) => Err(CallError::Lost(error)),
        };
        match last {
            Err(CallError::Lost(JobError::Timeout(_)) | CallError::Refused(TmclError::Foreign)) => {
                session.run_for(SETTLE)?;
            }
            Ok(_) | Err(_) => break,
        }
    }
    Ok(last)
}

/// The slaves that are drives of a youBot.
fn drives<W: Wire>(session: &Session<W>) -> Vec<usize> {
    let master = session.master();
    let is_drive = |number: &usize| {
        master.slave(*number).is_some_and(|slave| {
            let info = slave.info();
            info.identity.vendor == TRINAMIC && info.mailbox.receive_len > 0
        })
    };
    (0..master.len()).filter(is_drive).collect()
}

/// Status of all drives as text, and whether all are good.
fn status<W: Wire>(session: &mut Session<W>) -> anyhow::Result<(String, bool)> {
    let drives = drives(session);
    ensure!(
        !drives.is_empty(),
        "{}: no drive of a youBot among {} slaves (vendor {TRINAMIC:04X}h with a mailbox)",
        session.interface(),
        session.master().len()
    );
    let mut text = String::from("slave name       firmware   supply  hours   I2t  homed  flags\n");
    let mut good = true;
    for slave in drives {
        let name = session
            .master()
            .slave(slave)
            .map(|slave| slave.info().name.clone())
            .unwrap_or_default();
        match row(session, slave)? {
            Ok((line, is_good)) => {
                good &= is_good;
                let _ = writeln!(text, "{slave:>5} {name:<10} {line}");
            }
            Err(error) => {
                good = false;
                let _ = writeln!(text, "{slave:>5} {name:<10} {error}");
            }
        }
    }
    Ok((text, good))
}

/// Status of a drive as a line, and whether it is good.
fn row<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
) -> anyhow::Result<Result<(String, bool), CallError>> {
    let version = match call(session, slave, Request::firmware())? {
        Ok(Answer::Version(version)) => version,
        Ok(Answer::Value(_)) => return Ok(Err(CallError::Refused(TmclError::Foreign))),
        Err(error) => return Ok(Err(error)),
    };
    let mut values = [0; 5];
    let (bank, number) = parameters::CALIBRATED;
    let requests = [
        Request::get(151),
        Request::get(30),
        Request::get(28),
        Request::get_global(bank, number),
        Request::get(156),
    ];
    for (value, request) in values.iter_mut().zip(requests) {
        match call(session, slave, request)? {
            Ok(answer) => *value = answer.value().unwrap_or_default(),
            Err(error) => return Ok(Err(error)),
        }
    }
    let [supply, hours, i2t, homed, flags] = values;
    let flags = Flags(flags.cast_unsigned());
    let known = version.firmware().is_some();
    let note = if known { "" } else { "; firmware unknown" };
    let homed = match (version.board, homed) {
        // Wheels have no stop.
        (1632 | 174, _) => "-",
        (_, 1) => "yes",
        _ => "no",
    };
    let volts = f64::from(supply) / 100.0;
    let (board, major, minor) = (version.board, version.number / 100, version.number % 100);
    let line = format!(
        "{board:04} {major}.{minor:02} {volts:>6.1} V {hours:>6} {i2t:>5}  {homed:<5}  {flags}{note}"
    );
    let is_good = known && !flags.any(Flags::BLOCKING | Flags::I2T);
    Ok(Ok((line, is_good)))
}
