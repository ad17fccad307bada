//! Start procedure of one node (CiA 302-2): reset, boot-up, identity check, configuration, start.
//! It returns actions; the owner handles SDOs and frames.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address};

use super::NodeFault;
use super::plan::{Download, NodePlan};
use crate::canopen::{NmtCommand, NmtState};

/// Phase of the start procedure.
///
/// ```text
///       1 begin            2 boot-up           3 all equal              4 all written
/// Off ---------> Resetting ---------> Checking -----------> Configuring -------------> Starting
///                    ^                   ^        each write may be followed by its       |
///                    | 8 retry           |        reading back                            | 5 state
///                  Failed <--------------|------------------------------------------------|   reported
///                        6 any failure   +--- 7 boot-up in any state -------------------- Running
/// ```
///
/// 1 and 8 [`Startup::begin`], 2 and 7 `Startup::handle_boot_up`, 3 and 4 [`Startup::handle_answer`],
/// 5 [`Startup::handle_state`], 6 all of them and [`Startup::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Not requested to run.
    Off,
    /// Reset communication was sent.
    Resetting,
    /// Reading device type (0) and identity (1 to 4).
    Checking(u8),
    /// Writing or reading back a configuration value.
    Configuring {
        /// Index of the value.
        at: usize,
        /// Whether it is being read back.
        reading: bool,
    },
    /// Start was sent.
    Starting,
    /// Operational.
    Running,
    /// Failed; restarted after the retry delay.
    Failed,
}

/// Next action of the owner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing.
    None,
    /// Send that command to the node.
    Command(NmtCommand),
    /// Read this object by SDO.
    Read(Address),
    /// Write the download with that index by SDO.
    Write(usize),
}

/// Result of an SDO transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer<'a> {
    /// A value.
    Value(&'a [u8]),
    /// The value was written.
    Written,
    /// The node aborted the transfer.
    Refused(AbortCode),
    /// Timeout.
    Silent,
}

/// Start procedure of one node.
#[derive(Clone, Debug)]
pub struct Startup {
    expected: [Option<u32>; 5],
    downloads: Vec<Download>,
    /// Heartbeat or guarding will confirm the Operational state.
    watched: bool,
    phase: Phase,
    since: Duration,
    boot_up_max: Duration,
    retry: Duration,
    fault: Option<NodeFault>,
}

impl Startup {
    /// Start procedure of a node with this plan and these configuration values.
    pub fn new(plan: &NodePlan, downloads: Vec<Download>, timing: (Duration, Duration)) -> Self {
        let [a, b, c, d] = plan.identity;
        Self {
            expected: [plan.device_type, a, b, c, d],
            downloads,
            watched: plan.supervision != super::plan::Supervision::None,
            phase: Phase::Off,
            since: Duration::ZERO,
            boot_up_max: timing.0,
            retry: timing.1,
            fault: None,
        }
    }

    /// Its current phase.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// The fault that keeps it from running, or the last one.
    pub const fn fault(&self) -> Option<NodeFault> {
        self.fault
    }

    /// The configuration value with that index.
    pub fn download(&self, at: usize) -> Option<&Download> {
        self.downloads.get(at)
    }

    /// Starts with reset communication.
    pub const fn begin(&mut self, now: Duration) -> Action {
        (self.phase, self.since) = (Phase::Resetting, now);
        Action::Command(NmtCommand::ResetCommunication)
    }

    /// Stops the node: it returns to Pre-operational.
    pub const fn end(&mut self) -> Action {
        self.phase = Phase::Off;
        Action::Command(NmtCommand::EnterPreOperational)
    }

    /// Handles a fault. A started node gets NMT stop, because it may still receive frames although its own are lost.
    /// NMT stop, not enter pre-operational, triggers 6007h of drives and 6206h of outputs.
    pub const fn fail(&mut self, fault: NodeFault, now: Duration) -> Action {
        let started = matches!(self.phase, Phase::Starting | Phase::Running);
        self.fault = Some(fault);
        (self.phase, self.since) = (Phase::Failed, now);
        if started {
            Action::Command(NmtCommand::Stop)
        } else {
            Action::None
        }
    }

    /// Handles its boot-up message.
    pub(crate) fn handle_boot_up(&mut self, now: Duration) -> Action {
        match self.phase {
            Phase::Off => return Action::None,
            Phase::Running | Phase::Starting | Phase::Configuring { .. } => {
                self.fault = Some(NodeFault::Restarted);
            }
            // With two boot-up messages, one may be from before the reset.
            Phase::Resetting | Phase::Checking(_) | Phase::Failed => {}
        }
        self.since = now;
        self.check(0)
    }

    /// Reads the next value of the identity check, or continues with the configuration.
    fn check(&mut self, from: u8) -> Action {
        for at in from..5 {
            if self.expected[usize::from(at)].is_some() {
                self.phase = Phase::Checking(at);
                return Action::Read(Self::checked(at));
            }
        }
        self.write(0)
    }

    const fn checked(at: u8) -> Address {
        if at == 0 {
            Address::new(0x1000, 0)
        } else {
            Address::new(0x1018, at)
        }
    }

    fn write(&mut self, at: usize) -> Action {
        if at < self.downloads.len() {
            self.phase = Phase::Configuring { at, reading: false };
            return Action::Write(at);
        }
        self.phase = Phase::Starting;
        Action::Command(NmtCommand::Start)
    }

    /// Handles the result of its SDO transfer.
    pub fn handle_answer(&mut self, answer: Answer<'_>, now: Duration) -> Action {
        match self.phase {
            Phase::Checking(at) => match self.identify(at, answer) {
                Ok(()) => self.check(at + 1),
                Err(fault) => self.fail(fault, now),
            },
            Phase::Configuring { at, reading } => match self.configured(at, reading, answer) {
                Ok(true) => {
                    self.phase = Phase::Configuring { at, reading: true };
                    self.downloads
                        .get(at)
                        .map_or(Action::None, |d| Action::Read(d.address))
                }
                Ok(false) => {
                    self.since = now;
                    self.write(at + 1)
                }
                Err(fault) => self.fail(fault, now),
            },
            Phase::Off | Phase::Resetting | Phase::Starting | Phase::Running | Phase::Failed => {
                Action::None
            }
        }
    }

    fn identify(&self, at: u8, answer: Answer<'_>) -> Result<(), NodeFault> {
        let address = Self::checked(at);
        let expected = self.expected[usize::from(at)].unwrap_or(0);
        let found = match answer {
            Answer::Value(bytes) => {
                let mut four = [0; 4];
                four.iter_mut()
                    .zip(bytes)
                    .for_each(|(to, from)| *to = *from);
                u32::from_le_bytes(four)
            }
            Answer::Refused(code) => return Err(NodeFault::Refused { address, code }),
            Answer::Silent | Answer::Written => return Err(NodeFault::Silent(address)),
        };
        if found == expected {
            Ok(())
        } else {
            Err(NodeFault::WrongDevice {
                address,
                expected,
                found,
            })
        }
    }

    /// The pending SDO request, for a repetition: all reads and writes of the procedure may be repeated.
    pub fn pending(&self) -> Action {
        match self.phase {
            Phase::Checking(at) => Action::Read(Self::checked(at)),
            Phase::Configuring { at, reading: false } => Action::Write(at),
            Phase::Configuring { at, reading: true } => {
                let download = self.downloads.get(at);
                download.map_or(Action::None, |d| Action::Read(d.address))
            }
            Phase::Off | Phase::Resetting | Phase::Starting | Phase::Running | Phase::Failed => {
                Action::None
            }
        }
    }

    /// Evaluates a write; returns whether to read the value back.
    fn configured(&self, at: usize, reading: bool, answer: Answer<'_>) -> Result<bool, NodeFault> {
        let Some(download) = self.downloads.get(at) else {
            return Ok(false);
        };
        let address = download.address;
        match answer {
            Answer::Refused(code) if download.may_lack && is_absent(code) => Ok(false),
            Answer::Refused(code) => Err(NodeFault::Refused { address, code }),
            Answer::Silent => Err(NodeFault::Silent(address)),
            Answer::Written => Ok(download.verify && !reading),
            Answer::Value(bytes) if download.is_taken(bytes) => Ok(false),
            Answer::Value(_) => Err(NodeFault::NotTaken(address)),
        }
    }

    /// Handles a state reported by heartbeat or guarding.
    pub fn handle_state(&mut self, state: NmtState, now: Duration) -> Action {
        match (self.phase, state) {
            (_, NmtState::BootUp) => self.handle_boot_up(now),
            (Phase::Starting, NmtState::Operational) => {
                self.phase = Phase::Running;
                Action::None
            }
            (Phase::Running, NmtState::Operational) => Action::None,
            (Phase::Running, state) => self.fail(NodeFault::LeftOperational(state), now),
            (Phase::Starting, state) if now.saturating_sub(self.since) >= self.boot_up_max => {
                self.fail(NodeFault::NotStarted(state), now)
            }
            // The node was running before the master: the reset is on its way.
            (
                Phase::Off
                | Phase::Resetting
                | Phase::Checking(_)
                | Phase::Configuring { .. }
                | Phase::Starting
                | Phase::Failed,
                _,
            ) => Action::None,
        }
    }

    /// Handles timeouts.
    pub fn poll(&mut self, now: Duration) -> Action {
        let waited = now.saturating_sub(self.since);
        match self.phase {
            Phase::Resetting if waited >= self.boot_up_max => {
                self.fail(NodeFault::NoBootUp(self.boot_up_max), now)
            }
            Phase::Starting if !self.watched => {
                self.phase = Phase::Running;
                Action::None
            }
            Phase::Starting if waited >= self.boot_up_max + self.boot_up_max => {
                self.fail(NodeFault::NoHeartbeat(self.boot_up_max * 2), now)
            }
            Phase::Failed if waited >= self.retry && !self.retry.is_zero() => self.begin(now),
            Phase::Off
            | Phase::Resetting
            | Phase::Checking(_)
            | Phase::Configuring { .. }
            | Phase::Starting
            | Phase::Running
            | Phase::Failed => Action::None,
        }
    }

    /// Time of the next poll.
    pub fn poll_timeout(&self) -> Option<Duration> {
        match self.phase {
            Phase::Resetting => Some(self.since + self.boot_up_max),
            Phase::Starting if !self.watched => Some(Duration::ZERO),
            Phase::Starting => Some(self.since + self.boot_up_max + self.boot_up_max),
            Phase::Failed if !self.retry.is_zero() => Some(self.since + self.retry),
            Phase::Off
            | Phase::Checking(_)
            | Phase::Configuring { .. }
            | Phase::Running
            | Phase::Failed => None,
        }
    }
}

/// Whether the abort code means that the object does not exist.
const fn is_absent(code: AbortCode) -> bool {
    matches!(code, AbortCode::NoObject | AbortCode::NoSubIndex)
}

#[cfg(test)]
mod tests;
