//! The start of one node, after CiA 302-2: reset, boot-up, who are you, configuration, start. It
//! says what to do next; SDOs and frames are its owner's.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address};

use super::Trouble;
use super::plan::{Download, NodePlan};
use crate::canopen::{NmtCommand, NmtState};

/// Where the start of a node is.
///
/// ```text
///       1 begin            2 boot-up           3 all equal              4 all written
/// Off ---------> Resetting ---------> Checking -----------> Configuring -------------> Starting
///                    ^                   ^        each write may be followed by its       |
///                    | 8 retry           |        reading back                            | 5 says
///                  Failed <--------------|------------------------------------------------|   so
///                        6 any failure   +--- 7 boot-up in any state -------------------- Running
/// ```
///
/// 1 and 8 [`Startup::begin`], 2 and 7 [`Startup::booted`], 3 and 4 [`Startup::answered`],
/// 5 [`Startup::said`], 6 all of them and [`Startup::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nobody wants it to run.
    Off,
    /// Reset communication was sent.
    Resetting,
    /// Its device type (0) and its identity (1 to 4) are read.
    Checking(u8),
    /// That value of the configuration is written, or read back.
    Configuring {
        /// Which.
        at: usize,
        /// It is being read back.
        reading: bool,
    },
    /// Start was sent.
    Starting,
    /// It runs.
    Running,
    /// It does not; it is tried again after a while.
    Failed,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing.
    None,
    /// Send that command to the node.
    Command(NmtCommand),
    /// Read this by SDO.
    Read(Address),
    /// Write the download of that number by SDO.
    Write(usize),
}

/// What an SDO brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer<'a> {
    /// A value.
    Value(&'a [u8]),
    /// The value was written.
    Written,
    /// The node refused.
    Refused(AbortCode),
    /// The node did not answer.
    Silent,
}

/// The start of one node.
#[derive(Clone, Debug)]
pub struct Startup {
    expected: [Option<u32>; 5],
    downloads: Vec<Download>,
    /// A heartbeat or an answer to guarding will tell that it runs.
    watched: bool,
    phase: Phase,
    since: Duration,
    boot_up_max: Duration,
    retry: Duration,
    trouble: Option<Trouble>,
}

impl Startup {
    /// The start of a node that is to be as planned, with all these values.
    #[must_use]
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
            trouble: None,
        }
    }

    /// Where it is.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Why it does not run, or what it had last.
    #[must_use]
    pub const fn trouble(&self) -> Option<Trouble> {
        self.trouble
    }

    /// The value of a number.
    #[must_use]
    pub fn download(&self, at: usize) -> Option<&Download> {
        self.downloads.get(at)
    }

    /// Begins from reset communication.
    pub const fn begin(&mut self, now: Duration) -> Action {
        (self.phase, self.since) = (Phase::Resetting, now);
        Action::Command(NmtCommand::ResetCommunication)
    }

    /// Ends it: the node is sent back to Pre-operational.
    pub const fn end(&mut self) -> Action {
        self.phase = Phase::Off;
        Action::Command(NmtCommand::EnterPreOperational)
    }

    /// Something is wrong while it runs or starts. A node that was told to start is told to stop: it
    /// may hear without being heard, and nobody leads it any more. NMT stop it is, not enter
    /// pre-operational, as that is what 6007h of drives and 6206h of outputs react to.
    pub const fn fail(&mut self, trouble: Trouble, now: Duration) -> Action {
        let started = matches!(self.phase, Phase::Starting | Phase::Running);
        self.trouble = Some(trouble);
        (self.phase, self.since) = (Phase::Failed, now);
        if started {
            Action::Command(NmtCommand::Stop)
        } else {
            Action::None
        }
    }

    /// Its boot-up message came.
    pub fn booted(&mut self, now: Duration) -> Action {
        match self.phase {
            Phase::Off => return Action::None,
            Phase::Running | Phase::Starting | Phase::Configuring { .. } => {
                self.trouble = Some(Trouble::Restarted);
            }
            // Of two boot-up messages one may be from before the reset.
            Phase::Resetting | Phase::Checking(_) | Phase::Failed => {}
        }
        self.since = now;
        self.check(0)
    }

    /// The next number to be checked, from this one on; then the configuration.
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

    /// An SDO of its own came to its end.
    pub fn answered(&mut self, answer: Answer<'_>, now: Duration) -> Action {
        match self.phase {
            Phase::Checking(at) => match self.identify(at, answer) {
                Ok(()) => self.check(at + 1),
                Err(trouble) => self.fail(trouble, now),
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
                Err(trouble) => self.fail(trouble, now),
            },
            Phase::Off | Phase::Resetting | Phase::Starting | Phase::Running | Phase::Failed => {
                Action::None
            }
        }
    }

    fn identify(&self, at: u8, answer: Answer<'_>) -> Result<(), Trouble> {
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
            Answer::Refused(code) => return Err(Trouble::Refused { address, code }),
            Answer::Silent | Answer::Written => return Err(Trouble::Silent(address)),
        };
        if found == expected {
            Ok(())
        } else {
            Err(Trouble::WrongDevice {
                address,
                expected,
                found,
            })
        }
    }

    /// What it waits for by SDO, to be requested again: reads and writes of a start-up may be repeated.
    #[must_use]
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

    /// Whether what was written has to be read back.
    fn configured(&self, at: usize, reading: bool, answer: Answer<'_>) -> Result<bool, Trouble> {
        let Some(download) = self.downloads.get(at) else {
            return Ok(false);
        };
        let address = download.address;
        match answer {
            Answer::Refused(code) if download.may_lack && is_absent(code) => Ok(false),
            Answer::Refused(code) => Err(Trouble::Refused { address, code }),
            Answer::Silent => Err(Trouble::Silent(address)),
            Answer::Written => Ok(download.verify && !reading),
            Answer::Value(bytes) if download.is_taken(bytes) => Ok(false),
            Answer::Value(_) => Err(Trouble::NotTaken(address)),
        }
    }

    /// Its heartbeat, or its answer to guarding, says this state.
    pub fn said(&mut self, state: NmtState, now: Duration) -> Action {
        match (self.phase, state) {
            (_, NmtState::BootUp) => self.booted(now),
            (Phase::Starting, NmtState::Operational) => {
                self.phase = Phase::Running;
                Action::None
            }
            (Phase::Running, NmtState::Operational) => Action::None,
            (Phase::Running, state) => self.fail(Trouble::LeftOperational(state), now),
            (Phase::Starting, state) if now.saturating_sub(self.since) >= self.boot_up_max => {
                self.fail(Trouble::NotStarted(state), now)
            }
            // The node was there before the master: the reset is on its way.
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

    /// Time passed.
    pub fn poll(&mut self, now: Duration) -> Action {
        let waited = now.saturating_sub(self.since);
        match self.phase {
            Phase::Resetting if waited >= self.boot_up_max => {
                self.fail(Trouble::NoBootUp(self.boot_up_max), now)
            }
            Phase::Starting if !self.watched => {
                self.phase = Phase::Running;
                Action::None
            }
            Phase::Starting if waited >= self.boot_up_max + self.boot_up_max => {
                self.fail(Trouble::NoHeartbeat(self.boot_up_max * 2), now)
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

    /// When it has to be polled.
    #[must_use]
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

/// Whether a device says that it has no such object.
const fn is_absent(code: AbortCode) -> bool {
    matches!(code, AbortCode::NoObject | AbortCode::NoSubIndex)
}

#[cfg(test)]
mod tests;
