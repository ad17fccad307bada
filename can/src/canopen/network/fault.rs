//! Faults of nodes and axes, with remedies in their text.

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address};
use takt_cia402::{DriveFault, HomingError, SetPointError};

use crate::canopen::{Emergency, NmtState};

/// Fault of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum NodeFault {
    /// No boot-up message after a reset.
    NoBootUp(Duration),
    /// The device differs from the plan.
    WrongDevice {
        /// 1000h or an entry of 1018h.
        address: Address,
        /// Planned value.
        expected: u32,
        /// Read value.
        found: u32,
    },
    /// It aborted a read or write of its configuration.
    Refused {
        /// The object.
        address: Address,
        /// Abort code.
        code: AbortCode,
    },
    /// No response to a read or write of its configuration.
    Silent(Address),
    /// It answered a read or write of its configuration with an unrelated response; the request is repeated.
    Garbled {
        /// The requested object.
        address: Address,
        /// Abort code for the response.
        code: AbortCode,
    },
    /// A written value reads back differently.
    NotTaken(Address),
    /// It reports another state after the start command.
    NotStarted(NmtState),
    /// It sends no heartbeat after the start command.
    NoHeartbeat(Duration),
    /// Its heartbeats stopped.
    HeartbeatLost(Duration),
    /// No response to node guarding.
    GuardingLost,
    /// It rebooted while running and lost its configuration.
    Restarted,
    /// It left Operational without a command.
    LeftOperational(NmtState),
    /// A synchronous TPDO was missing for this many cycles.
    PdoMissing {
        /// Number of the TPDO, from 0.
        number: u16,
        /// SYNCs without it.
        cycles: u32,
    },
    /// A TPDO was shorter than what was mapped.
    PdoShort {
        /// Number of the TPDO, from 0.
        number: u16,
        /// Received bytes.
        len: u8,
    },
    /// It reported an error by EMCY.
    Emergency(Emergency),
}

/// Consequence and remedy if a device lacks this object.
const fn lacks(address: Address) -> &'static str {
    match address.index {
        0x1016 => {
            ": it cannot monitor its master; let the master send no heartbeat, and note that the device goes on \
             when the master hangs"
        }
        _ => "",
    }
}

impl fmt::Display for NodeFault {
    #[expect(clippy::too_many_lines, reason = "a table of texts")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoBootUp(after) => write!(
                f,
                "no boot-up message {after:?} after reset communication: is it powered and wired, \
                 its bit rate and node number right, the bus terminated?"
            ),
            Self::WrongDevice {
                address,
                expected,
                found,
            } => write!(
                f,
                "{address} is {found:08X}h, {expected:08X}h was planned: a different device or \
                 firmware has this node number; correct the plan or the wiring"
            ),
            Self::Refused { address, code } => write!(f, "{address}: {code}{}", lacks(*address)),
            Self::Silent(address) => write!(
                f,
                "no SDO response for {address}: is the node stopped, or its SDO server busy with \
                 another master?"
            ),
            Self::Garbled { address, code } => write!(
                f,
                "unsolicited SDO response while {address} was requested ({code}): two nodes with the same \
                 number, another master, or a node that repeats its responses; the request is repeated when it is quiet"
            ),
            Self::NotTaken(address) => write!(
                f,
                "{address} reads back another value than written: the device limits it, or needs \
                 it stored (1010h) and a reset"
            ),
            Self::NotStarted(state) => write!(
                f,
                "state {state} after the start command: does its 1F80h or a local control forbid the start?"
            ),
            Self::NoHeartbeat(after) => write!(
                f,
                "no heartbeat {after:?} after start: does it support 1017h? Else plan node \
                 guarding"
            ),
            Self::HeartbeatLost(after) => write!(
                f,
                "no heartbeat for {after:?}: power, wiring, bus-off, or a firmware that hangs"
            ),
            Self::GuardingLost => f.write_str(
                "no response to node guarding: power, wiring, bus-off, or 100Ch and 100Dh",
            ),
            Self::Restarted => f.write_str(
                "it rebooted while running and lost its configuration: check its power supply; it is \
                 configured again and waits for its goal",
            ),
            Self::LeftOperational(state) => write!(
                f,
                "it went to {state} without a command: 1029h after an error, or another master"
            ),
            Self::PdoMissing { number, cycles } => write!(
                f,
                "TPDO {} missing for {cycles} SYNCs: bus load too high, SYNC not received \
                 (1005h), or its type ({:04X}h:02) changed",
                u32::from(*number) + 1,
                0x1800 + u32::from(*number)
            ),
            Self::PdoShort { number, len } => write!(
                f,
                "TPDO {} has {len} bytes, fewer than mapped: its mapping {:04X}h was \
                 changed, or another node has the same identifier",
                u32::from(*number) + 1,
                0x1A00 + u32::from(*number)
            ),
            Self::Emergency(emergency) => write!(
                f,
                "EMCY {:04X}h, error register {:02X}h",
                emergency.code, emergency.register
            ),
        }
    }
}

/// Why an axis does not follow its commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum AxisFault {
    /// Its node does not run.
    NodeDown,
    /// A fault at the level of the drive profile.
    Drive(DriveFault),
    /// The drive could follow, but its target is too far from its position: it would jump.
    NotAligned {
        /// 607Ah, user units.
        target: i32,
        /// 6064h, user units.
        actual: i32,
    },
    /// The last homing run failed.
    Homing(HomingError),
    /// A profile position set-point was not accepted.
    SetPoint(SetPointError),
    /// Another mode of operation, or homing, was requested of an axis whose plan has a constant one; the request was
    /// ignored.
    ConstantMode {
        /// 6060h of the plan.
        planned: i8,
        /// Requested 6060h.
        requested: i8,
    },
    /// It was lost while enabled; it is held back until its goal is set again.
    HeldBack,
}

impl fmt::Display for AxisFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NodeDown => f.write_str("its node does not run; see the node's fault"),
            Self::Drive(drive_fault) => drive_fault.fmt(f),
            Self::NotAligned { target, actual } => write!(
                f,
                "its target {target} is too far from its position {actual} and it would jump: start from \
                 6064h"
            ),
            Self::Homing(error) => error.fmt(f),
            Self::SetPoint(error) => error.fmt(f),
            Self::ConstantMode { planned, requested } => write!(
                f,
                "mode of operation {requested} was requested, but its plan has the constant mode {planned} and no 6060h in its \
                 process data: the request is ignored; plan it without `mode`"
            ),
            Self::HeldBack => f.write_str(
                "its node was lost while it was enabled: find the cause, then set its goal again",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_fault_names_objects_of_high_pdos() {
        let missing = |number| NodeFault::PdoMissing { number, cycles: 4 }.to_string();
        assert!(missing(0).contains("TPDO 1 missing") && missing(0).contains("(1800h:02)"));
        assert!(missing(64).contains("TPDO 65 missing") && missing(64).contains("(1840h:02)"));
        let short = |number| NodeFault::PdoShort { number, len: 2 }.to_string();
        assert!(short(0).contains("1A00h") && short(192).contains("1AC0h"));
    }

    #[test]
    fn node_fault_missing_heartbeat_consumer_has_remedy() {
        let refused = |index| {
            let (address, code) = (Address::new(index, 1), AbortCode::NoObject);
            NodeFault::Refused { address, code }.to_string()
        };
        assert!(refused(0x1016).contains("let the master send no heartbeat"));
        assert!(!refused(0x1017).contains("heartbeat"));
    }
}
