//! `takt ecat drive`: one axis of a CiA 402 drive, enabled state by state over process data, with the reason when it is
//! not enabled, and moved a little. Start-up, monitor and shutdown are those of the drivers; sequences of motions are for
//! nets.

mod setup;
#[cfg(test)]
mod tests;

use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use takt_cia402::dictionary::Address;
use takt_cia402::emulator::FaultCode;
use takt_cia402::proof::{Object, Objects};
use takt_cia402::{
    ControlWord, DriveFault, Goal, MasterOptions, Monitor, Power, Quirk, Runaway, Shutdown,
    Standstill, State, StatusWord, axis_goal,
};
use takt_core::device::driver::SHUTDOWN_MAX;
use takt_ethercat::AlState;
use takt_ethercat::axis::{Axis, AxisState, Target};

use super::Target as Segment;
use super::session::{Session, Wire};
use crate::jog::{Limits, Profile, Speed};
use crate::output::{positive_span, say, span};
use crate::signal::Stop;
use crate::{Verdict, confirm};

/// Enable an axis of a CiA 402 drive, show its words as named bits, report why it is not enabled, and jog it.
///
/// The segment is brought to OP, the axis to Operation enabled in cyclic synchronous position (CSP), held there or
/// moved, and switched off again as drivers do: at standstill, operation disabled before power is removed. Then all
/// slaves are left in INIT. Before the axis gets power, its PDOs are compared with SDO uploads in both directions; a
/// drive that does not use the mapping it acknowledged gets none. A jog faster than 607Fh or 6080h allows is rejected; a
/// motor that runs away from its set-points loses power at once. Ctrl-C brakes first. Exit status: 0 it was enabled and
/// did as requested; 1 it did not, with the reason; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat drive enp2s0 3
  takt ecat drive enp2s0 3 --axis 1 --sync0 --reset --hold 5s
  takt ecat drive enp2s0 3 --by 4096 --duration 2s --yes")]
pub(crate) struct Drive {
    #[command(flatten)]
    target: Segment,
    /// The slave: its position from 0, or its name or order code if no other has it.
    slave: String,
    /// The axis of a drive with several, from 0.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..8))]
    axis: u8,
    /// Period of the frames, and of SYNC0.
    #[arg(long, value_name = "TIME", default_value = "4ms", value_parser = positive_span)]
    cycle: Duration,
    /// Synchronize the drive to SYNC0.
    #[arg(long)]
    sync0: bool,
    /// Reset a fault, once.
    #[arg(long)]
    reset: bool,
    /// How long to hold it in Operation enabled.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = span)]
    hold: Duration,
    /// Move it by this many increments, smoothly, from its position.
    #[arg(long, value_name = "INCREMENTS", allow_hyphen_values = true)]
    by: Option<i32>,
    /// Duration of the motion, from rest to rest.
    #[arg(long, value_name = "TIME", default_value = "2s", value_parser = positive_span)]
    duration: Duration,
    /// A quirk of the drive: no_follow_bit, sod_as_0020 or mode_after_enable; may be repeated.
    #[arg(long = "quirk", value_name = "QUIRK")]
    quirks: Vec<Quirk>,
    /// Objects that SDO does not show as PDOs carry them, by the drive's manual, such as 607A,60FF: not compared.
    #[arg(long, value_name = "INDEX", value_delimiter = ',', value_parser = mirrored)]
    not_mirrored: Vec<Object>,
    /// It is safe that the machine moves; do not ask.
    #[arg(long = "yes", alias = "confirm-motion")]
    confirm_motion: bool,
}

/// An object that commands an axis, by its index on the first axis.
fn mirrored(text: &str) -> Result<Object, String> {
    let address = text.parse::<Address>().map_err(|error| error.to_string())?;
    Object::of(address.index)
        .ok_or_else(|| format!("{address} commands no axis; write 607A or another mapped object"))
}

impl Drive {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let what = format!("enabling axis {} of slave {}", self.axis, self.slave);
        confirm::motion(&what, self.confirm_motion)?;
        let stop = Stop::listen()?;
        let mut session = self.target.bring_up(AlState::PreOp, super::REQUEST_CYCLE)?;
        let slave = session.find(&self.slave)?;
        let order = Order {
            slave,
            axis: self.axis,
            cycle: self.cycle,
            sync0: self.sync0,
            reset: self.reset,
            hold: self.hold,
            jog: self.by.map(|increments| (increments, self.duration)),
            timeout: self.target.timeout,
            profile: MasterOptions::default().with_quirks(&self.quirks),
            not_mirrored: {
                let mut all = Objects::default();
                self.not_mirrored
                    .iter()
                    .for_each(|object| all.insert(*object));
                all
            },
        };
        let done = perform(&mut session, &order, &|| stop.is_requested(), &mut |line| {
            say(line)
        });
        let left = session.leave();
        let outcome = done?;
        left?;
        say(&outcome.to_string())?;
        Ok(outcome.verdict())
    }
}

/// What to do with an axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order {
    slave: usize,
    axis: u8,
    cycle: Duration,
    sync0: bool,
    reset: bool,
    hold: Duration,
    /// Increments, and their duration.
    jog: Option<(i32, Duration)>,
    timeout: Duration,
    /// Tolerated deviations of the drive from its profile.
    profile: MasterOptions,
    /// Objects that are not compared before it gets power.
    not_mirrored: Objects,
}

impl Order {
    /// Largest speed of its jog, increments/s.
    fn speed(&self) -> f64 {
        self.jog.map_or(0.0, |(increments, time)| {
            Profile::new(increments, time).speed()
        })
    }
}

/// Why the jog is too fast for the drive, with the duration that is long enough.
fn too_fast(limits: &Limits, order: &Order) -> Option<String> {
    let (_, time) = order.jog?;
    let error = limits.check(Speed::Increments(order.speed())).err()?;
    let longer = time.as_secs_f64().max(0.01) * order.speed() / error.allowed;
    let seconds = (longer * 10.0).ceil() / 10.0;
    Some(format!(
        "axis {}: {error}\n      hint: give it more time (--duration {seconds:.1}s) or fewer increments",
        order.axis
    ))
}

/// The result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// All was done; increments moved, and the largest lag behind the set-points.
    Done(Option<(i32, i32)>),
    /// The slave did not get to OP.
    Slave(String),
    /// The axis was not enabled, did not stay so, or did not move.
    Axis(String),
    /// It was stopped on request and braked.
    Stopped,
}

impl Outcome {
    const fn is_failure(&self) -> bool {
        matches!(self, Self::Slave(_) | Self::Axis(_))
    }

    const fn verdict(&self) -> Verdict {
        match self {
            Self::Done(_) => Verdict::Good,
            Self::Slave(_) | Self::Axis(_) | Self::Stopped => Verdict::Failed,
        }
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Done(None) => f.write_str("good: it was enabled and switched off as requested"),
            Self::Done(Some((moved, lag))) => {
                write!(
                    f,
                    "good: moved by {moved} increments, up to {lag} behind its set-points"
                )
            }
            Self::Slave(why) | Self::Axis(why) => write!(f, "FAIL  {why}"),
            Self::Stopped => f.write_str("stopped: braked and switched off"),
        }
    }
}

/// Executes an order, printing each step.
pub(super) fn perform<W: Wire>(
    session: &mut Session<W>,
    order: &Order,
    is_stopped: &dyn Fn() -> bool,
    print: &mut dyn FnMut(&str) -> anyhow::Result<()>,
) -> anyhow::Result<Outcome> {
    let config = match setup::config(session, order)? {
        Ok(config) => config,
        Err(why) => return Ok(Outcome::Slave(why)),
    };
    let limits = setup::limits(session, order)?;
    if let Some(why) = too_fast(&limits, order) {
        return Ok(Outcome::Axis(why));
    }
    session.restart(config)?;
    if order.sync0 {
        session.follow_sync0();
    }
    session.bring_up(order.timeout)?;
    if let Some(why) = setup::missing(session, order) {
        return Ok(Outcome::Slave(why));
    }
    let process = session
        .master()
        .slave(order.slave)
        .map(|slave| slave.process());
    let process = process.context("the slave is offline")?;
    let axis = match Axis::new(order.slave, process, order.axis, order.profile) {
        Ok(axis) => axis.not_mirrored(order.not_mirrored),
        Err(missing) => return Ok(Outcome::Slave(missing.to_string())),
    };
    let bounds = limits.monitor(Speed::Increments(order.speed()), order.cycle);
    if order.jog.is_some() {
        for note in limits.notes() {
            print(&format!("            {note}"))?;
        }
    }
    let begin = session.now()?;
    let mut bench = Bench {
        session,
        axis,
        order,
        is_stopped,
        print,
        begin,
        printed: None,
        proven: None,
        monitor: Monitor::new(bounds),
        standstill: limits.standstill(),
        held: None,
        runaway: None,
    };
    let outcome = bench.run()?;
    let end = bench.switch_off()?;
    if outcome.is_failure() {
        return Ok(outcome);
    }
    Ok(bench.judge_end(&end)?.unwrap_or(outcome))
}

/// An axis while it is commanded.
struct Bench<'a, W: Wire> {
    session: &'a mut Session<W>,
    axis: Axis,
    order: &'a Order,
    is_stopped: &'a dyn Fn() -> bool,
    print: &'a mut dyn FnMut(&str) -> anyhow::Result<()>,
    begin: Duration,
    /// Words that were printed last.
    printed: Option<(ControlWord, StatusWord)>,
    /// Duration of the proof of its process data.
    proven: Option<Duration>,
    /// Whether its motor follows its target.
    monitor: Monitor,
    standstill: Standstill,
    /// Position that it holds, increments.
    held: Option<i32>,
    /// Its runaway; its power is removed.
    runaway: Option<Runaway>,
}

impl<W: Wire> Bench<'_, W> {
    /// One cycle; words that changed are printed.
    fn cycle(&mut self, target: Target) -> anyhow::Result<AxisState> {
        self.session.cycle()?;
        let now = self.session.now()?;
        while let Some(reply) = self.session.master_mut().poll_reply() {
            // There are no other jobs while the axis is commanded.
            let _ = self.axis.handle_reply(reply, now);
        }
        let state = self.axis.cycle(self.session.master_mut(), target, now);
        self.supervise(&state, target, now);
        self.standstill.note(state.position, now);
        self.print_proof()?;
        let words = (state.control, state.status);
        if self.printed != Some(words) {
            self.printed = Some(words);
            let time = now.saturating_sub(self.begin).as_secs_f64();
            let name = state
                .state
                .map_or_else(|| "no state".to_owned(), |s| s.to_string());
            (self.print)(&format!("{time:>8.3} s  {name}"))?;
            (self.print)(&format!("            6041h {}", state.status))?;
            (self.print)(&format!("            6040h {}", state.control))?;
        }
        Ok(state)
    }

    /// Checks that its motor follows its target; removes its power if not.
    fn supervise(&mut self, state: &AxisState, target: Target, now: Duration) {
        let wanted = match target {
            Target::Position(position) => Some(position),
            Target::Hold | Target::Velocity(_) | Target::Torque(_) | Target::Home => {
                self.held.or(Some(state.position))
            }
        };
        let is_commanded = state.online && state.follows && self.runaway.is_none();
        let wanted = wanted.filter(|_| is_commanded);
        self.held = wanted;
        if let Some(runaway) = self.monitor.step(wanted, state.position, now) {
            self.runaway = Some(runaway);
            self.axis.set_goal(Goal::SwitchOnDisabled);
        }
    }

    /// The outcome of a runaway.
    fn ran_away(&self) -> Option<Outcome> {
        let runaway = self.runaway?;
        let why = runaway.to_string().replace("\nhint", "\n      hint");
        Some(Outcome::Axis(format!("axis {}: {why}", self.order.axis)))
    }

    /// Prints once that its process data are proven.
    fn print_proof(&mut self) -> anyhow::Result<()> {
        let took = self.axis.proof().took();
        if took == std::mem::replace(&mut self.proven, took) {
            return Ok(());
        }
        let Some(took) = took else {
            return Ok(());
        };
        let trusted = self.axis.proof().taken_on_trust();
        let exception = if trusted.is_empty() {
            String::new()
        } else {
            format!(", but for {trusted}, taken on trust")
        };
        let ms = took.as_millis();
        (self.print)(&format!(
            "            process data proven in {ms} ms{exception}"
        ))
    }

    fn run(&mut self) -> anyhow::Result<Outcome> {
        if let Err(outcome) = self.enable()? {
            return Ok(outcome);
        }
        let Some((increments, time)) = self.order.jog else {
            return self.hold();
        };
        self.jog(increments, time)
    }

    /// To Operation enabled, until it follows.
    fn enable(&mut self) -> anyhow::Result<Result<(), Outcome>> {
        // Its state before it is commanded.
        for _ in 0..3 {
            self.cycle(Target::Hold)?;
        }
        self.axis.set_goal(Goal::OperationEnabled);
        let mut reset = self.order.reset;
        let begin = self.session.now()?;
        loop {
            let state = self.cycle(Target::Hold)?;
            if (self.is_stopped)() {
                return Ok(Err(Outcome::Stopped));
            }
            if state.follows {
                return Ok(Ok(()));
            }
            if reset && state.state == Some(State::Fault) {
                (self.print)("            its fault is reset")?;
                self.axis.reset_fault();
                reset = false;
                continue;
            }
            let resetting = self.order.reset && state.drive_fault == Some(DriveFault::Fault);
            let offline = !state.online && self.session.now()?.saturating_sub(begin) > ONLINE;
            if offline || (state.drive_fault.is_some() && !resetting) {
                return Ok(Err(self.failure(&state)?));
            }
        }
    }

    fn hold(&mut self) -> anyhow::Result<Outcome> {
        let end = self.session.now()? + self.order.hold;
        while self.session.now()? < end {
            let state = self.cycle(Target::Hold)?;
            if let Some(outcome) = self.ran_away() {
                return Ok(outcome);
            }
            if (self.is_stopped)() {
                return Ok(Outcome::Stopped);
            }
            if !state.follows {
                return self.failure(&state);
            }
        }
        Ok(Outcome::Done(None))
    }

    /// From rest to rest; braked on request.
    fn jog(&mut self, increments: i32, time: Duration) -> anyhow::Result<Outcome> {
        let start = self.cycle(Target::Hold)?.position;
        let begin = self.session.now()?;
        let mut profile = Profile::new(increments, time);
        let (mut lag, mut stopped, mut next_print) = (0, false, PROGRESS);
        loop {
            let now = self.session.now()?.saturating_sub(begin);
            if (self.is_stopped)() && !stopped {
                stopped = true;
                (self.print)("            braking")?;
                profile.brake(now);
            }
            let target = start.wrapping_add(profile.at(now));
            let state = self.cycle(Target::Position(target))?;
            if let Some(outcome) = self.ran_away() {
                return Ok(outcome);
            }
            if !state.follows {
                return self.failure(&state);
            }
            let behind = target.wrapping_sub(state.position).saturating_abs();
            lag = lag.max(behind);
            if now >= next_print {
                next_print += PROGRESS;
                let time = self.session.now()?.saturating_sub(self.begin).as_secs_f64();
                let position = state.position;
                (self.print)(&format!(
                    "{time:>8.3} s  position {position}, {behind} behind"
                ))?;
            }
            // At the end it has time to arrive.
            if now > profile.end() + SETTLE {
                let moved = state.position.wrapping_sub(start);
                return Ok(if stopped {
                    Outcome::Stopped
                } else if has_moved(moved, increments) {
                    Outcome::Done(Some((moved, lag)))
                } else {
                    let number = self.order.axis;
                    Outcome::Axis(format!(
                        "axis {number}: 6064h moved by {moved} increments of {increments}: its motor does not turn as \
                         607Ah commands\n{NOT_MOVED}"
                    ))
                });
            }
        }
    }

    /// Why the axis is not in the state that is wanted.
    fn failure(&mut self, state: &AxisState) -> anyhow::Result<Outcome> {
        let number = self.order.axis;
        let mut why = match (state.online, state.drive_fault, state.state) {
            (false, ..) => match self.session.master().slave(self.order.slave) {
                Some(slave) => slave.fault().map_or_else(
                    || "its process data stopped arriving".to_owned(),
                    |fault| fault.to_string(),
                ),
                None => "its slave is offline".to_owned(),
            },
            (true, Some(drive_fault), _) => drive_fault.to_string(),
            (true, None, Some(State::OperationEnabled)) => format!(
                "it is enabled and no longer follows its set-points: 6041h {}, 6061h is not 8, or bit 12 is 0\n{NOT_FOLLOWED}",
                state.status
            ),
            (true, None, Some(shown)) => format!("it left Operation enabled: {shown}"),
            (true, None, None) => format!("its statusword {} shows no state", state.status),
        };
        for line in setup::reasons(self.session, self.order, state)? {
            why = format!("{why}\n      {line}");
        }
        Ok(Outcome::Axis(format!("axis {number}: {why}")))
    }

    /// Why a drive that did as requested did not end as it should: without power and without a fault.
    fn judge_end(&mut self, end: &AxisState) -> anyhow::Result<Option<Outcome>> {
        let shown = match end.state {
            Some(State::Fault | State::FaultReactionActive) => {
                let faulted = AxisState {
                    drive_fault: end.drive_fault.or(Some(DriveFault::Fault)),
                    ..*end
                };
                return self.failure(&faulted).map(Some);
            }
            Some(State::SwitchedOn | State::OperationEnabled | State::QuickStopActive)
                if end.online =>
            {
                end.status
            }
            Some(_) | None => return Ok(None),
        };
        let number = self.order.axis;
        Ok(Some(Outcome::Axis(format!(
            "axis {number}: it does not switch off: 6041h is still {shown}\n{NOT_OFF}"
        ))))
    }

    /// Removes power as the drivers do: from a motor that moves only if nothing brakes it. Returns its state at the end.
    fn switch_off(&mut self) -> anyhow::Result<AxisState> {
        let begin = self.session.now()?;
        let mut shutdown = Shutdown::new(begin);
        loop {
            let state = self.cycle(Target::Hold)?;
            let now = self.session.now()?;
            let power = state.state.filter(|_| state.online);
            let power = power.map_or(Power::Off, Power::from);
            let has_torque = power == Power::Drives;
            let is_at_rest = !has_torque || self.standstill.is_reached(now);
            let goal = shutdown.step(is_at_rest, has_torque, now);
            let goal = axis_goal(goal, power, self.runaway.is_some());
            if let Some(goal) = goal {
                self.axis.set_goal(goal);
            }
            let off = matches!(
                state.state,
                Some(State::SwitchOnDisabled | State::NotReadyToSwitchOn | State::Fault)
            );
            if goal == Some(Goal::SwitchOnDisabled) && (off || !state.online) {
                return Ok(state);
            }
            if now > begin + SHUTDOWN_MAX {
                (self.print)("            it does not switch off; the watchdog of its slave will")?;
                return Ok(state);
            }
        }
    }
}

/// Timeout of the first process data.
const ONLINE: Duration = Duration::from_secs(1);
/// Time between two prints of a position.
const PROGRESS: Duration = Duration::from_millis(500);
/// Time for an axis to arrive.
const SETTLE: Duration = Duration::from_millis(200);

/// What keeps the motor of an enabled drive from turning.
const NOT_MOVED: &str = "      hint: check its brake and load, 6072h and 6080h (torque and speed that it may use), and the gear \
    and encoder factors (608Fh, 6091h)";

/// What keeps a drive from switching off.
const NOT_OFF: &str =
    "      hint: check for a service tool or another master at the drive, and its emergency stop";

/// What makes an enabled drive leave its mode.
const NOT_FOLLOWED: &str = "      hint: check for another master or a service tool at the drive; without one, it may use another \
    mapping than it acknowledged: power-cycle it";

/// Whether an axis moved at least half of its motion, in that direction.
fn has_moved(moved: i32, wanted: i32) -> bool {
    let along = i64::from(moved) * i64::from(wanted.signum());
    along * 2 >= i64::from(wanted).abs()
}

/// An error code of 603Fh as text.
fn error_text(code: u16) -> String {
    format!("603Fh is {code:04X}h: {}", FaultCode(code))
}
