//! Why a drive did not do what it should: the cause, and the remedy. The session finds it.

use std::fmt;

use takt_can::canopen::{Message, NmtState, NodeId};
use takt_cia402::{ControlWord, DriveFault, Runaway, SetPointError, State};

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
    /// It rejects a write.
    Refused(SdoError),
    /// The state machine does not go where it should.
    Drive(DriveFault),
    /// 6040h does not hold what was written: another master writes it.
    Overwritten { wrote: u16, holds: u16 },
    /// It restarted.
    Rebooted,
    /// It left Operational.
    Left(NmtState),
    /// Enabled, commanded to turn, and at rest.
    DoesNotTurn { wanted: i32, shown: i32 },
    /// It left Operation enabled without a command.
    Dropped(State),
    /// It turned, was commanded to stop, and turns.
    DoesNotStop { shown: i32 },
    /// It ends with power.
    StaysPowered(State),
    /// It was commanded to a position and is at rest elsewhere.
    DoesNotArrive { target: i32, shown: i32 },
    /// It does not accept a set-point of profile position.
    SetPoint(SetPointError),
    /// Several devices have its number.
    Duplicate,
    /// 605Ah is 0: nothing would brake the jog in this mode.
    Coasts,
    /// The distance of a jog is not known.
    UnknownUnit,
    /// It cannot monitor the heartbeat of this program.
    Unguarded(SdoError),
    /// It would continue if the heartbeat ended: 6007h is 0.
    NoReaction,
    /// The jog is faster than 607Fh or 6080h allows.
    TooFast(TooFast),
    /// Its motor is not where its velocity can have moved it, or too fast.
    Runaway(Runaway),
}

/// A cause and its evidence.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Diagnosis {
    pub(super) node: NodeId,
    pub(super) cause: Cause,
    /// Objects of the drive that explain it, one line each.
    pub(super) facts: Vec<String>,
    /// Another master's message to the drive.
    pub(super) other_master: Option<Message>,
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
            Self::StaysPowered(_) => "stays-powered",
            Self::DoesNotArrive { .. } => "does-not-arrive",
            Self::SetPoint(_) => "set-point",
            Self::Duplicate => "duplicate",
            Self::Coasts => "coasts",
            Self::UnknownUnit => "unknown-unit",
            Self::Unguarded(_) => "unguarded",
            Self::NoReaction => "no-reaction",
            Self::TooFast(_) => "too-fast",
            Self::Runaway(_) => "runaway",
        }
    }
}

impl fmt::Display for Diagnosis {
    #[expect(clippy::too_many_lines, reason = "a table of texts")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let node = self.node;
        match self.cause {
            Cause::Silent(refusal) => refusal.fmt(f),
            Cause::NotADrive(kind) => write!(
                f,
                "1000h of node {node} is {kind:08X}h: it is no CiA 402 drive\nhint: `takt can scan` lists the nodes"
            ),
            Cause::NoAxis(axis, refusal) => write!(
                f,
                "node {node} has no axis {axis}: {refusal}\nhint: axes count from 0, 800h apart"
            ),
            Cause::Refused(refusal) => write!(
                f,
                "{refusal}\nhint: check whether a PDO of another master writes the object, and whether the drive has this mode"
            ),
            Cause::Drive(DriveFault::Stuck { state, sent, .. }) => write!(
                f,
                "{state} although 6040h is {sent}\nhint: check inputs, interlock and parameters of the drive"
            ),
            Cause::Drive(drive_fault) => drive_fault.fmt(f),
            Cause::Overwritten { wrote, holds } => {
                let (held, written) = (ControlWord::new(holds), ControlWord::new(wrote));
                write!(f, "6040h holds {held} although {written} was written: ")?;
                if held.halt() && !written.halt() {
                    f.write_str("its bit 8 (halt) holds the motor at rest; ")?;
                }
                write!(
                    f,
                    "another master writes it\n\
                     hint: find it by `takt can dump --filter node={node}` and stop it"
                )
            }
            Cause::Rebooted => write!(
                f,
                "node {node} restarted (boot-up)\nhint: check its supply, whether it was reset, and its firmware"
            ),
            Cause::Left(state) => write!(
                f,
                "node {node} went to {state}\nhint: check for another master, and the reaction to errors in 1029h"
            ),
            Cause::DoesNotTurn { wanted, shown } => write!(
                f,
                "did not move: enabled and commanded to turn with {wanted}, 606Ch shows {shown}\n\
                 hint: check motor, brake, limit switches, and the limits of torque and speed"
            ),
            Cause::Dropped(state) => write!(
                f,
                "it left Operation enabled for {state} without a command\n\
                 hint: check enabling inputs, safe torque off, and for another master"
            ),
            Cause::DoesNotStop { shown } => write!(
                f,
                "commanded to stop, 606Ch still shows {shown}: its load drives it\n\
                 hint: use the emergency stop, and check whether the brake holds"
            ),
            Cause::StaysPowered(state) => write!(
                f,
                "it does not switch off: still {state}\n\
                 hint: check for another master; use the emergency stop"
            ),
            Cause::DoesNotArrive { target, shown } => write!(
                f,
                "did not arrive: commanded to position {target}, 6064h shows {shown}\n\
                 hint: check motor, brake, limit switches, 607Dh, and the limits of torque and speed"
            ),
            Cause::SetPoint(error) => error.fmt(f),
            Cause::Duplicate => write!(
                f,
                "node {node} answers one SDO request more than once, or 1000h and not 1018h:04: several devices have its \
                 number, or its SDO server is faulty\nhint: unplug all but one of them and give it another number (takt can scan)"
            ),
            Cause::Coasts => f.write_str(
                "605Ah is 0: a quick stop lets the motor coast, so nothing would brake it if the jog were stopped\n\
                 hint: set it to 2, jog by --mode pv, or, with an operator at the emergency stop, use --unguarded",
            ),
            Cause::UnknownUnit => f.write_str(
                "the unit of velocity (60A9h, 6096h) is not known, so the distance of the jog is not\n\
                 hint: jog by --mode pv",
            ),
            Cause::Unguarded(refusal) => write!(
                f,
                "the drive cannot monitor the heartbeat of this program ({refusal}), so it would continue to turn without \
                 it\nhint: with an operator at the emergency stop, use --unguarded"
            ),
            Cause::TooFast(error) => write!(f, "{error}\nhint: --jog {:.0} at most", error.allowed.floor()),
            Cause::Runaway(runaway) => runaway.fmt(f),
            Cause::NoReaction => f.write_str(
                "6007h is 0: the drive would continue to turn if this program ended\n\
                 hint: set it to 1, 2 or 3, or, with an operator at the emergency stop, use --unguarded",
            ),
        }
    }
}
