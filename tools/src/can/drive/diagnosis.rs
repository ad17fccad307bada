//! Why a drive did not do what it should: the cause, and what to do about it. How it is found out is the business
//! of the session.

use std::fmt;

use takt_can::canopen::{Message, NmtState, NodeId};
use takt_cia402::{DriveFault, Runaway, State};

use crate::can::sdo_client::SdoError;
use crate::jog::TooFast;

/// A cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Cause {
    /// It does not answer.
    Silent(SdoError),
    /// 1000h names another profile.
    NotADrive(u32),
    /// The objects of that axis are not there.
    NoAxis(u8, SdoError),
    /// It does not take a write.
    Refused(SdoError),
    /// The state machine does not go where it should.
    Drive(DriveFault),
    /// 6040h does not hold what was written: somebody else writes it.
    Overwritten { wrote: u16, holds: u16 },
    /// It began anew meanwhile.
    Rebooted,
    /// It left Operational.
    Left(NmtState),
    /// Enabled, told to turn, and at rest.
    DoesNotTurn { wanted: i32, shown: i32 },
    /// It left Operation enabled without being told to.
    Dropped(State),
    /// It turned, was told to stop, and turns.
    DoesNotStop { shown: i32 },
    /// It cannot watch the heartbeat of this program.
    Unguarded(SdoError),
    /// It would go on if the heartbeat ended: 6007h is 0.
    NoReaction,
    /// The jog is faster than 607Fh or 6080h allows.
    TooFast(TooFast),
    /// Its motor is not where its velocity can have brought it, or too fast.
    Runaway(Runaway),
}

/// A cause with what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Diagnosis {
    pub(super) node: NodeId,
    pub(super) cause: Cause,
    /// What the drive says about it, one line each.
    pub(super) facts: Vec<String>,
    /// Another master's frame to the drive.
    pub(super) stranger: Option<Message>,
}

impl Cause {
    /// For programs.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Silent(_) => "silent",
            Self::NotADrive(_) => "not-a-drive",
            Self::NoAxis(..) => "no-axis",
            Self::Refused(_) => "refused",
            Self::Drive(DriveFault::Undefined(_)) => "undefined-state",
            Self::Drive(DriveFault::Fault) => "fault",
            Self::Drive(DriveFault::ResetRefused(_)) => "reset-refused",
            Self::Drive(DriveFault::EnablingFails(_)) => "enabling-fails",
            Self::Drive(DriveFault::NotRemote) => "not-remote",
            Self::Drive(DriveFault::NoVoltage) => "no-voltage",
            Self::Drive(DriveFault::Mode { .. }) => "mode",
            Self::Drive(DriveFault::Stuck { .. }) => "stuck",
            Self::Drive(DriveFault::QuickStopHeld) => "quick-stop-held",
            Self::Drive(DriveFault::NotFollowing) => "not-following",
            Self::Drive(DriveFault::NotProven(_)) => "not-proven",
            Self::Overwritten { .. } => "overwritten",
            Self::Rebooted => "rebooted",
            Self::Left(_) => "left-operational",
            Self::DoesNotTurn { .. } => "does-not-turn",
            Self::Dropped(_) => "dropped",
            Self::DoesNotStop { .. } => "does-not-stop",
            Self::Unguarded(_) => "unguarded",
            Self::NoReaction => "no-reaction",
            Self::TooFast(_) => "too-fast",
            Self::Runaway(_) => "runaway",
        }
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let node = self.node;
        match self.cause {
            Cause::Silent(refusal) => refusal.fmt(f),
            Cause::NotADrive(kind) => write!(
                f,
                "1000h of node {node} is {kind:08X}h: that is no drive of CiA 402; see takt can scan"
            ),
            Cause::NoAxis(axis, refusal) => write!(
                f,
                "node {node} has no axis {axis}: {refusal}; axes count from 0, 800h apart"
            ),
            Cause::Refused(refusal) => write!(
                f,
                "{refusal}; is the object written by a PDO of another master, or has the drive not this mode?"
            ),
            Cause::Drive(DriveFault::Stuck { state, sent, .. }) => write!(
                f,
                "{state} although 6040h is {sent}: an input, the interlock or a parameter of the drive keeps it there"
            ),
            Cause::Drive(drive_fault) => drive_fault.fmt(f),
            Cause::Overwritten { wrote, holds } => write!(
                f,
                "6040h holds {holds:04X}h although {wrote:04X}h was written: another master writes it; stop that one \
                 (takt can dump --filter node={node})"
            ),
            Cause::Rebooted => write!(
                f,
                "node {node} began anew (boot-up): its supply broke down, it was reset, or its firmware failed"
            ),
            Cause::Left(state) => write!(
                f,
                "node {node} went to {state}: another master commanded it, or 1029h reacts to an error"
            ),
            Cause::DoesNotTurn { wanted, shown } => write!(
                f,
                "enabled and told to turn with {wanted}, 606Ch shows {shown}: is the motor blocked or its brake \
                 closed, a limit switch reached, torque or speed limited to 0?"
            ),
            Cause::Dropped(state) => write!(
                f,
                "it left Operation enabled for {state} by itself: an enabling input, safe torque off, or another master"
            ),
            Cause::DoesNotStop { shown } => write!(
                f,
                "told to stop, 606Ch still shows {shown}: its load drives it; use the emergency stop, and see whether \
                 the brake holds"
            ),
            Cause::Unguarded(refusal) => write!(
                f,
                "the drive cannot watch the heartbeat of this program ({refusal}), so it would go on turning without \
                 it; with somebody at the emergency stop, say --unguarded"
            ),
            Cause::TooFast(error) => write!(f, "{error}\nhint: --jog {:.0} at most", error.allowed.floor()),
            Cause::Runaway(runaway) => runaway.fmt(f),
            Cause::NoReaction => f.write_str(
                "6007h is 0: the drive would go on turning if this program ended; set it to 1, 2 or 3, or, with \
                 somebody at the emergency stop, say --unguarded",
            ),
        }
    }
}
