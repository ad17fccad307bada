//! Proof of the process data: before an axis gets power, what its PDOs carry is compared with SDO uploads of the same
//! objects, in both directions. A drive may acknowledge a mapping and go on using another one; reading the mapping back
//! does not reveal this, and such a drive takes a byte of one object for that of another. This module knows no bus: its
//! owner makes the uploads and exchanges the PDOs.
//!
//! ```text
//!          1 power wanted        2 no power, by SDO         3 all equal           4 Ready to switch on, by PDO
//! Quiet ------------------> Resting ---------------> Pattern ------------> Release ------------------> Proven
//!   ^  zeros                  zeros       pattern      |        targets      |        and SDO, equal      |
//!   |                                                  +--> Refused <--------+ 5 differs, five times      |
//!   +------ 6 device was offline, from any state ----------------------------------------------------------+
//! ```
//!
//! 1 to 3 and 5: [`Proof::step`] and [`Proof::handle_upload`]; 4 in the latter; 6 [`Proof::restart`].
//!
//! Until the pattern goes out an unproven axis receives zeros: whatever byte its drive takes for 6040h, that is
//! *disable voltage*. `proof/pattern.rs` explains why the pattern cannot move anything. After the pattern the drive is
//! brought to Ready to switch on, without power: its statusword changes by PDO and by SDO alike, and targets replace
//! the pattern. This reveals process data that are frozen or late.
//!
//! What is received may change while it is read: 6064h of a shaft that is turned, bits of 6041h that toggle. The upload
//! must lie among the PDOs from before it to three after it, with a margin as wide as their own spread. Bits that
//! differ among these PDOs are not compared. A value is refused after five uploads that all differ, 10 ms apart: a
//! drive that delays its process data by less than that passes.

mod objects;
mod pattern;
#[cfg(test)]
mod tests;
mod window;

use std::fmt;
use std::time::Duration;

use crate::dictionary::{AbortCode, Address};
use crate::{DecodeError, Goal, State, StatusWord};

pub use objects::{Object, Objects, Values};
use pattern::pattern;
use window::Window;

/// Cycles with PDOs after which unchanged outputs count as received by the drive.
const SETTLE: u32 = 4;
/// Cycles with PDOs after an upload whose values the upload may already show.
const AFTER: u32 = 3;
/// Differing uploads after which the proof fails.
const ATTEMPTS: u32 = 5;
/// Time between two uploads of the same object.
const AGAIN: Duration = Duration::from_millis(10);
/// Unanswered uploads that make a fault, and the time after which the proof is then retried.
const SILENT: u32 = 3;
const RETRY: Duration = Duration::from_secs(5);

/// Why process data are not proven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProofFault {
    /// The PDO carries another value than the object has.
    Differs {
        /// The object.
        object: Object,
        /// Axis, 0 to 7.
        axis: u8,
        /// Value by PDO: as sent, or as last received.
        pdo: u32,
        /// Value by SDO.
        sdo: u32,
    },
    /// The drive does not let the object be read.
    Unreadable {
        /// The object.
        object: Object,
        /// Axis, 0 to 7.
        axis: u8,
        /// Abort code.
        code: AbortCode,
    },
    /// The drive does not answer an upload of the object.
    Silent {
        /// The object.
        object: Object,
        /// Axis, 0 to 7.
        axis: u8,
    },
    /// 6041h by SDO shows power although 6040h is disable voltage.
    Powered {
        /// Axis, 0 to 7.
        axis: u8,
        /// 6041h by SDO.
        status: u32,
    },
}

struct Shown(Object, u32);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.show(self.1, f)
    }
}

impl fmt::Display for ProofFault {
    /// The cause, and on a line of its own the hint.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let index = |object: Object, axis: u8| object.address(axis).index;
        match *self {
            Self::Differs {
                object,
                axis,
                pdo,
                sdo,
            } => write!(
                f,
                "{:04X}h by PDO {}, by SDO {}: the slave does not use the mapping it acknowledged\nhint: power-cycle \
                 it; name {object:?} in `not_mirrored` only if its manual says that SDO does not show process data",
                index(object, axis),
                Shown(object, pdo),
                Shown(object, sdo)
            ),
            Self::Unreadable { object, axis, code } => write!(
                f,
                "{:04X}h cannot be read by SDO ({code}): its process data are not proven\nhint: name {object:?} in \
                 `not_mirrored` if the drive's manual says so",
                index(object, axis)
            ),
            Self::Silent { object, axis } => write!(
                f,
                "{:04X}h by SDO: no answer; the process data are not proven\nhint: check whether another master or tool \
                 keeps its mailbox or SDO server busy",
                index(object, axis)
            ),
            Self::Powered { axis, status } => write!(
                f,
                "{:04X}h by SDO {}: it has power although 6040h by PDO is disable voltage\nhint: power-cycle it",
                index(Object::STATUS, axis),
                Shown(Object::STATUS, status)
            ),
        }
    }
}

/// Why an upload brought no value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denied {
    /// The drive refused.
    Abort(AbortCode),
    /// No answer was received.
    Silent,
    /// The request could not be queued: the queue is full.
    Busy,
}

/// What an axis and its master exchanged in a cycle.
#[derive(Clone, Copy, Debug)]
pub struct Exchanged {
    /// Received by PDO.
    pub received: Values,
    /// Last values sent by PDO.
    pub sent: Values,
    /// `received` is new since the last cycle.
    pub fresh: bool,
    /// State that 6041h shows by PDO.
    pub state: Option<State>,
    /// Power is wanted and the device can accept it: it is in OP or Operational.
    pub wanted: bool,
    /// 6060h that will be commanded.
    pub mode: i8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Quiet,
    Resting,
    Pattern,
    Release,
    Proven,
    Refused,
}

/// An upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Upload {
    /// None is due before then.
    Idle(Duration),
    /// To be requested.
    Due,
    /// Requested.
    Sent,
    /// The uploaded value, and how many fresh PDOs are still awaited.
    Received(u32, u32),
}

/// The proof of the process data of one axis.
#[derive(Clone, Debug)]
pub struct Proof {
    axis: u8,
    carried: Objects,
    not_mirrored: Objects,
    stage: Stage,
    /// Index of the current object in the order of the stage.
    at: usize,
    upload: Upload,
    /// Uploads of the current object that differed, and uploads without an answer.
    differed: u32,
    silent: u32,
    /// Fresh PDOs since the stage began.
    settled: u32,
    window: Window,
    pattern: Values,
    seed: u32,
    /// When the stage began.
    since: Duration,
    /// Time from the request for power to the end of the proof.
    began: Duration,
    took: Option<Duration>,
    fault: Option<ProofFault>,
}

/// Objects that are compared once targets have replaced the pattern.
const RELEASE: [Object; 2] = [Object::STATUS, Object::TARGET];

impl Proof {
    /// The proof for an axis (0 to 7) whose PDOs carry these objects. `not_mirrored` are those of which SDO does not
    /// show what PDOs carry: they are not compared, on the authority of the configuration.
    pub fn new(axis: u8, carried: Objects, not_mirrored: Objects) -> Self {
        Self {
            axis,
            carried,
            not_mirrored,
            stage: Stage::Quiet,
            at: 0,
            upload: Upload::Idle(Duration::ZERO),
            differed: 0,
            silent: 0,
            settled: 0,
            window: Window::default(),
            pattern: Values::default(),
            seed: 0x5DEE_CE66 ^ u32::from(axis) << 8,
            since: Duration::ZERO,
            began: Duration::ZERO,
            took: None,
            fault: None,
        }
    }

    /// The device was offline, or was exchanged: it is proven again before it gets power. A pending upload is dropped.
    pub fn restart(&mut self) {
        let fresh = Self::new(self.axis, self.carried, self.not_mirrored);
        // A pattern that differs from the last.
        let seed = self.seed.wrapping_mul(0x9E37_79B9).wrapping_add(1);
        *self = Self { seed, ..fresh };
    }

    /// Whether the axis may get power.
    pub const fn is_proven(&self) -> bool {
        matches!(self.stage, Stage::Proven)
    }

    /// Whether the proof is running.
    pub const fn is_running(&self) -> bool {
        matches!(self.stage, Stage::Resting | Stage::Pattern | Stage::Release)
    }

    /// Why the proof failed; `None` while it has not.
    pub const fn fault(&self) -> Option<ProofFault> {
        self.fault
    }

    /// How long the proof took, once it is complete.
    pub const fn took(&self) -> Option<Duration> {
        self.took
    }

    /// Carried objects that are not compared.
    pub const fn taken_on_trust(&self) -> Objects {
        self.carried.common(self.not_mirrored)
    }

    /// Highest state that the axis may reach.
    pub const fn ceiling(&self) -> Goal {
        match self.stage {
            Stage::Quiet | Stage::Resting | Stage::Pattern | Stage::Refused => {
                Goal::SwitchOnDisabled
            }
            Stage::Release => Goal::ReadyToSwitchOn,
            Stage::Proven => Goal::OperationEnabled,
        }
    }

    /// Values to send instead of controlword and targets; `None` to send those.
    pub const fn instead(&self) -> Option<&Values> {
        match self.stage {
            Stage::Quiet | Stage::Resting | Stage::Pattern | Stage::Refused => Some(&self.pattern),
            Stage::Release | Stage::Proven => None,
        }
    }

    fn enter(&mut self, stage: Stage, now: Duration) {
        self.stage = stage;
        (self.at, self.settled, self.since) = (0, 0, now);
        (self.differed, self.silent) = (0, 0);
        self.upload = Upload::Idle(now);
        self.window = Window::default();
    }

    fn refuse(&mut self, fault: ProofFault, now: Duration) {
        self.fault = Some(fault);
        self.pattern = Values::default();
        self.enter(Stage::Refused, now);
    }

    /// One cycle at time `now` of any clock that does not go back.
    pub fn step(&mut self, exchanged: &Exchanged, now: Duration) {
        if exchanged.fresh {
            self.settled = self.settled.saturating_add(1);
        }
        match self.stage {
            Stage::Quiet if exchanged.wanted => {
                self.began = now;
                self.enter(Stage::Resting, now);
            }
            Stage::Quiet | Stage::Proven => {}
            Stage::Refused => {
                let silent = matches!(self.fault, Some(ProofFault::Silent { .. }));
                if silent && exchanged.wanted && now.saturating_sub(self.since) >= RETRY {
                    self.enter(Stage::Resting, now);
                }
            }
            // A started proof continues: what it sends gives no power, and a few late frames prove nothing.
            Stage::Resting | Stage::Pattern | Stage::Release => self.compare(exchanged, now),
        }
    }

    /// The current object.
    fn object(&self) -> Option<Object> {
        let mirrored = |object: &Object| {
            self.carried.contains(*object) && !self.not_mirrored.contains(*object)
        };
        match self.stage {
            Stage::Resting => [Object::STATUS].into_iter().nth(self.at),
            Stage::Pattern => Object::all().filter(mirrored).nth(self.at),
            Stage::Release => RELEASE.into_iter().filter(mirrored).nth(self.at),
            Stage::Quiet | Stage::Proven | Stage::Refused => None,
        }
    }

    fn compare(&mut self, exchanged: &Exchanged, now: Duration) {
        let Some(object) = self.object() else {
            self.advance(exchanged.mode, now);
            return;
        };
        let pdo = if object.is_sent() {
            exchanged.sent.get(object)
        } else {
            exchanged.received.get(object)
        };
        let asking = !matches!(self.upload, Upload::Idle(_));
        // Any target sent since the pattern is accepted: which of them the drive currently holds is not known.
        if exchanged.fresh && (asking || object.is_sent()) {
            self.window.take(object, pdo);
        }
        match self.upload {
            Upload::Idle(at) if now >= at && self.settled >= SETTLE => {
                if !object.is_sent() {
                    self.window = Window::default();
                    self.window.take(object, pdo);
                }
                self.upload = Upload::Due;
            }
            Upload::Received(sdo, 0) => self.judge(object, sdo, exchanged, now),
            Upload::Received(sdo, left) if exchanged.fresh => {
                self.upload = Upload::Received(sdo, left - 1);
            }
            Upload::Idle(_) | Upload::Due | Upload::Sent | Upload::Received(..) => {}
        }
    }

    fn judge(&mut self, object: Object, sdo: u32, exchanged: &Exchanged, now: Duration) {
        let resting = self.stage == Stage::Resting;
        let state = StatusWord::new(u16::try_from(sdo).unwrap_or(0)).state();
        let good = if resting {
            is_unpowered(state)
        } else {
            self.window.holds(object, sdo)
        };
        if resting && !good && state.ok() == exchanged.state {
            // The drive is still stopping, and reports that by PDO and by SDO.
            self.upload = Upload::Idle(now + AGAIN);
            return;
        }
        if good {
            let status = self.stage == Stage::Release && object == Object::STATUS;
            if status && exchanged.state != Some(State::ReadyToSwitchOn) {
                // The drive is not there yet, and reports that by PDO and by SDO. Its master reports why.
                self.upload = Upload::Idle(now + AGAIN);
                (self.differed, self.silent) = (0, 0);
                return;
            }
            self.at += 1;
            self.window = Window::default();
            if self.stage == Stage::Release {
                self.settled = 0;
            }
            (self.differed, self.silent) = (0, 0);
            self.upload = Upload::Idle(now);
            return;
        }
        self.differed += 1;
        self.upload = Upload::Idle(now + AGAIN);
        if self.differed < ATTEMPTS {
            return;
        }
        let axis = self.axis;
        let fault = if resting {
            ProofFault::Powered { axis, status: sdo }
        } else {
            let pdo = self.window.last();
            ProofFault::Differs {
                object,
                axis,
                pdo,
                sdo,
            }
        };
        self.refuse(fault, now);
    }

    /// All objects of a stage are equal.
    fn advance(&mut self, mode: i8, now: Duration) {
        match self.stage {
            Stage::Resting => {
                let ns = u32::try_from(now.as_nanos() & u128::from(u32::MAX)).unwrap_or(0);
                self.seed ^= ns;
                self.pattern = pattern(self.carried, mode, self.seed);
                self.enter(Stage::Pattern, now);
            }
            Stage::Pattern => {
                self.pattern = Values::default();
                self.enter(Stage::Release, now);
            }
            Stage::Release => {
                self.fault = None;
                self.took = Some(now.saturating_sub(self.began));
                self.enter(Stage::Proven, now);
            }
            Stage::Quiet | Stage::Proven | Stage::Refused => {}
        }
    }

    /// The next object to upload, once; its answer goes to [`Self::handle_upload`].
    pub fn poll_upload(&mut self) -> Option<Address> {
        if self.upload != Upload::Due {
            return None;
        }
        let object = self.object()?;
        self.upload = Upload::Sent;
        Some(object.address(self.axis))
    }

    /// Whether an upload is due.
    pub fn has_upload(&self) -> bool {
        self.upload == Upload::Due
    }

    /// Handles the result of an upload.
    pub fn handle_upload(&mut self, answer: Result<&[u8], Denied>, now: Duration) {
        let Some(object) = self.object().filter(|_| self.upload == Upload::Sent) else {
            return;
        };
        let axis = self.axis;
        match answer {
            Ok(bytes) if !bytes.is_empty() => {
                let mut raw = [0; 4];
                raw.iter_mut()
                    .zip(bytes)
                    .take(object.bytes())
                    .for_each(|(to, from)| *to = *from);
                let after = if object.is_sent() { 0 } else { AFTER };
                self.upload = Upload::Received(u32::from_le_bytes(raw), after);
            }
            Err(Denied::Abort(code)) => {
                self.refuse(ProofFault::Unreadable { object, axis, code }, now);
            }
            Err(Denied::Busy) => self.upload = Upload::Idle(now + AGAIN),
            Ok(_) | Err(Denied::Silent) => {
                self.silent += 1;
                self.upload = Upload::Idle(now + AGAIN);
                if self.silent >= SILENT {
                    self.refuse(ProofFault::Silent { object, axis }, now);
                }
            }
        }
    }
}

/// Whether a drive has no power and is not about to get it. A statusword without a state, as old stacks show it, counts
/// as no power.
const fn is_unpowered(state: Result<State, DecodeError>) -> bool {
    match state {
        Ok(State::NotReadyToSwitchOn | State::SwitchOnDisabled | State::Fault) | Err(_) => true,
        Ok(
            State::ReadyToSwitchOn
            | State::SwitchedOn
            | State::OperationEnabled
            | State::QuickStopActive
            | State::FaultReactionActive,
        ) => false,
    }
}
