//! Faults of devices in the demo: it reports each with the stall that caused it, waits until the device follows
//! commands again, moves its arms back to their start, and requests the rest of the motion. Drivers recover the
//! devices; motion resumes only on the requests made here.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use takt_core::Controller;
use takt_core::device::DeviceStatus;

use super::cell::Arm;
use super::motion;
use crate::client::Client;
use crate::output::complain;

/// Shortest time for arms to return to their start.
pub(super) const RETURN: Duration = Duration::from_secs(3);
/// How fast a joint goes back on average, rad/s.
pub(super) const RETURN_SPEED: f64 = 0.3;
/// Distance below which joints have reached their start, rad.
pub(super) const HOME: f64 = 0.05;
/// A shorter rest of the motion is left out.
const REST_MIN: Duration = Duration::from_secs(1);
/// Between two attempts to start a net.
const AGAIN: Duration = Duration::from_millis(200);
/// Between two polls of all nets, in case the end of one was not pushed.
const POLL_EVERY: Duration = Duration::from_secs(1);
/// Failures that are kept for the report; of others only the number.
const FAILURES_MAX: usize = 16;

/// Result of the motion.
#[derive(Clone, Debug, Default)]
pub(super) struct Outcome {
    /// How often a net ended before its time.
    pub(super) interrupted: u64,
    /// After how many of these its devices moved again at the demo's request, or nothing was left to do.
    pub(super) requested_again: u64,
    /// Interruptions without a fault of a device or a stall of the host, and motion that was not requested again.
    pub(super) failures: Vec<String>,
    /// Failures beyond those.
    pub(super) more: u64,
}

impl Outcome {
    fn fail(&mut self, failure: String) {
        if self.failures.len() < FAILURES_MAX {
            self.failures.push(failure);
        } else {
            self.more += 1;
        }
    }
}

/// State of a part of the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Moving,
    /// Its arms go back to where they began.
    Returning,
    /// It waits for its devices; if it was interrupted in motion, it returns to its start first.
    Waiting {
        returns: bool,
    },
    Done,
}

/// A part of the cell that one net moves.
#[derive(Debug)]
struct Part {
    arms: &'static [Arm],
    /// By arm: where its joints began, rad.
    home: Vec<Vec<f64>>,
    net: String,
    state: State,
    /// Faults of its devices when its net was started.
    faults: u64,
    /// When and why it was interrupted, as long as its motion is not requested again.
    interrupted: Option<(Instant, String)>,
    /// No net is started before this time.
    not_before: Instant,
}

impl Part {
    fn names(&self) -> String {
        let names: Vec<_> = self.arms.iter().map(|arm| arm.name).collect();
        names.join(" and ")
    }
}

/// All parts and their results.
#[derive(Debug)]
pub(super) struct Parts<'c> {
    controller: &'c Controller,
    parts: Vec<Part>,
    outcome: Outcome,
    begin: Instant,
    duration: Duration,
    polled: Instant,
    /// The last fault reported, and faults that are not over.
    reported: u64,
    open: VecDeque<u64>,
}

impl<'c> Parts<'c> {
    /// Those that these nets are about to move, for so long.
    pub(super) fn new(
        controller: &'c Controller,
        nets: impl IntoIterator<Item = (&'static [Arm], String)>,
        duration: Duration,
    ) -> Self {
        let now = Instant::now();
        let part = |(arms, net): (&'static [Arm], String)| Part {
            arms,
            home: arms.iter().map(|arm| commanded(controller, arm)).collect(),
            net,
            state: State::Moving,
            faults: faults_of(controller, arms),
            interrupted: None,
            not_before: now,
        };
        Self {
            controller,
            parts: nets.into_iter().map(part).collect(),
            outcome: Outcome::default(),
            begin: now,
            duration,
            polled: now,
            reported: controller.faults().last().map_or(0, |fault| fault.number),
            open: VecDeque::new(),
        }
    }

    /// Whether all parts have ended.
    pub(super) fn are_done(&self) -> bool {
        self.parts.iter().all(|part| part.state == State::Done)
    }

    /// The result. A part that is not done was not requested again, unless a signal stopped the demo.
    pub(super) fn finish(mut self, is_stopped: bool) -> Outcome {
        if is_stopped && !self.are_done() {
            let after_s = self.begin.elapsed().as_secs_f64();
            self.outcome
                .fail(format!("a signal stopped the motion after {after_s:.1} s"));
            return self.outcome;
        }
        for part in &mut self.parts {
            let names = part.names();
            match part.interrupted.take() {
                Some((at, why)) => {
                    let at_s = at.duration_since(self.begin).as_secs_f64();
                    self.outcome.fail(format!(
                        "the motion of {names}, interrupted at {at_s:.1} s ({why}), was not requested again"
                    ));
                }
                None if part.state != State::Done => {
                    self.outcome
                        .fail(format!("the motion of {names} did not come to its end"));
                }
                None => {}
            }
        }
        self.outcome
    }

    fn left(&self) -> Duration {
        self.duration.saturating_sub(self.begin.elapsed())
    }

    /// Reports faults that are new or over, handles nets that ended, and resumes those whose devices recovered.
    pub(super) fn poll(&mut self, client: &mut Client, ended: bool) -> anyhow::Result<()> {
        self.report_faults();
        if ended || self.polled.elapsed() >= POLL_EVERY {
            self.polled = Instant::now();
            for net in client.nets()? {
                let part = self.parts.iter().position(|part| part.net == net.id);
                if let Some(number) = part.filter(|_| net.state == "TERMINATED") {
                    self.net_ended(number, &net.end);
                    client.command("neun", &net.id)?;
                }
            }
        }
        for number in 0..self.parts.len() {
            self.resume(number, client)?;
        }
        Ok(())
    }

    fn report_faults(&mut self) {
        for fault in self.controller.faults() {
            if fault.number > self.reported {
                let ago = Duration::try_from(takt_rt::monotonic() - fault.at).unwrap_or_default();
                let at = self.begin.elapsed().saturating_sub(ago).as_secs_f64();
                complain(&format!("fault at {at:.1} s: {fault}"));
                self.reported = fault.number;
                self.open.push_back(fault.number);
            }
            let is_open = self.open.contains(&fault.number);
            if let (true, Some(after)) = (is_open, fault.recovered_after) {
                self.open.retain(|number| *number != fault.number);
                let (device, after_s) = (&fault.device, after.as_secs_f64());
                complain(&format!(
                    "{device} follows commands again after {after_s:.1} s"
                ));
            }
        }
    }

    fn net_ended(&mut self, number: usize, end: &str) {
        let left = self.left();
        let at_s = self.begin.elapsed().as_secs_f64();
        let Some(part) = self.parts.get_mut(number) else {
            return;
        };
        part.net.clear();
        let is_whole = end.is_empty() && (part.state == State::Returning || left.is_zero());
        if is_whole {
            // A part whose set-points were refused on its return has not arrived.
            let is_away = part.state == State::Returning && distance(self.controller, part) > HOME;
            part.state = State::Waiting { returns: is_away };
            return;
        }
        let had_fault = faults_of(self.controller, part.arms) > part.faults;
        let stall = self.controller.last_stall();
        let why = if end.is_empty() {
            "a set-point was refused"
        } else {
            end
        };
        if !had_fault {
            let names = part.names();
            match stall {
                Some(stall) => complain(&format!(
                    "{names} stopped at {at_s:.1} s: {why}; {stall}"
                )),
                None => self.outcome.fail(format!(
                    "{names} stopped at {at_s:.1} s: {why}, though no device had a fault and this host did not stall"
                )),
            }
        }
        self.outcome.interrupted += 1;
        part.interrupted = Some((Instant::now(), why.to_owned()));
        part.state = State::Waiting { returns: true };
    }

    /// Requests what is left of a part that waits, once all of its devices follow commands again.
    fn resume(&mut self, number: usize, client: &mut Client) -> anyhow::Result<()> {
        let left = self.left();
        let Some(part) = self.parts.get_mut(number) else {
            return Ok(());
        };
        let State::Waiting { returns } = part.state else {
            return Ok(());
        };
        let now = Instant::now();
        if now < part.not_before || !follow(self.controller, part.arms) {
            return Ok(());
        }
        part.not_before = now + AGAIN;
        let returns = returns && part.arms.iter().all(|arm| arm.wheel.is_none());
        let next = if left < REST_MIN {
            None
        } else if returns {
            let span = way_back(self.controller, part);
            let net = motion::back(part.arms, &part.home, span);
            Some((State::Returning, net))
        } else {
            Some((State::Moving, motion::of(part.arms, left)))
        };
        if let Some((state, net)) = next {
            part.faults = faults_of(self.controller, part.arms);
            let id = load(client, &net)?;
            if client.command("nest", &id).is_err() {
                // A device was lost again meanwhile.
                client.command("neun", &id)?;
                return Ok(());
            }
            (part.net, part.state) = (id, state);
        } else {
            part.state = State::Done;
        }
        if let Some((at, _)) = part.interrupted.take() {
            self.outcome.requested_again += 1;
            let after_s = at.elapsed().as_secs_f64();
            let event = match part.state {
                State::Done => "no motion is left for",
                State::Moving | State::Returning | State::Waiting { .. } => {
                    "motion is requested again for"
                }
            };
            complain(&format!("{event} {}, {after_s:.1} s after", part.names()));
        }
        Ok(())
    }
}

/// Loads a net of the motion; its identifier.
pub(super) fn load(client: &mut Client, net: &str) -> anyhow::Result<String> {
    let id = client.load(net, "demo motion")?;
    let faults = client.faults(&id)?;
    anyhow::ensure!(
        faults.is_empty(),
        "the net is rejected: {}",
        faults.join("; ")
    );
    client.subscribe(&id, Duration::from_millis(100))?;
    Ok(id)
}

/// Whether all of these follow commands.
pub(super) fn follow(controller: &Controller, arms: &[Arm]) -> bool {
    let devices = controller.devices();
    arms.iter().all(|arm| {
        let mut found = devices.iter().filter(|device| device.name == arm.name);
        found.all(|device| device.status == DeviceStatus::Operational)
    })
}

/// Faults of these devices so far.
pub(super) fn faults_of(controller: &Controller, arms: &[Arm]) -> u64 {
    let states = arms.iter().map(|arm| controller.arm_state(arm.name));
    states.flatten().map(|state| state.faults).sum()
}

/// Where the joints of an arm are commanded to be, rad.
pub(super) fn commanded(controller: &Controller, arm: &Arm) -> Vec<f64> {
    let state = controller.arm_state(arm.name).unwrap_or_default();
    let joints = state.joints.iter().take(arm.joints.len());
    joints
        .map(|joint| joint.commanded_position.unwrap_or(0.0))
        .collect()
}

/// Largest distance of a joint of a part from its start, rad.
fn distance(controller: &Controller, part: &Part) -> f64 {
    let arms = part.arms.iter().zip(&part.home);
    let distances = arms.flat_map(|(arm, home)| {
        let now = commanded(controller, arm);
        let distances = now.into_iter().zip(home.clone());
        distances.map(|(now, home)| (home - now).abs())
    });
    distances.fold(0.0, f64::max)
}

/// Time that a part takes to return to its start.
fn way_back(controller: &Controller, part: &Part) -> Duration {
    Duration::try_from_secs_f64(distance(controller, part) / RETURN_SPEED)
        .unwrap_or(RETURN)
        .max(RETURN)
}
