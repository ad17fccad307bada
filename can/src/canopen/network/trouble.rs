//! Why a node or an axis is not where it is wanted, in words that say what to do.

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address};
use takt_cia402::{HomingError, Obstacle, SetPointError};

use crate::canopen::{Emergency, NmtState};

/// Why a node does not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Trouble {
    /// After a reset its boot-up message did not come.
    NoBootUp(Duration),
    /// It is another device than was planned.
    WrongDevice {
        /// 1000h or an entry of 1018h.
        address: Address,
        /// As planned.
        expected: u32,
        /// As read.
        found: u32,
    },
    /// It refused a read or a write of its configuration.
    Refused {
        /// Of what.
        address: Address,
        /// Why.
        code: AbortCode,
    },
    /// It did not answer a read or a write of its configuration.
    Silent(Address),
    /// It answered a read or a write of its configuration with what is no answer to it; it is asked again.
    Garbled {
        /// About what it was asked.
        address: Address,
        /// What was wrong with the answer.
        code: AbortCode,
    },
    /// It took a value and shows another.
    NotTaken(Address),
    /// It was started and says another state.
    NotStarted(NmtState),
    /// It was started and says nothing.
    NoHeartbeat(Duration),
    /// Its heartbeats stopped.
    HeartbeatLost(Duration),
    /// It does not answer node guarding.
    GuardingLost,
    /// It booted up while it ran: it has lost its configuration.
    Restarted,
    /// It left Operational without being told.
    LeftOperational(NmtState),
    /// A TPDO that comes with SYNC was missing for so many cycles.
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
        /// Bytes that came.
        len: u8,
    },
    /// It told an error by EMCY.
    Emergency(Emergency),
}

/// What a device lacks that has not this object, and what to do.
const fn lacks(address: Address) -> &'static str {
    match address.index {
        0x1016 => {
            ": it cannot watch its master; let the master send no heartbeat, and know that the device goes on \
             when the master hangs"
        }
        _ => "",
    }
}

impl fmt::Display for Trouble {
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
                "{address} is {found:08X}h, {expected:08X}h was planned: another device or \
                 firmware has this node number; correct the plan or the wiring"
            ),
            Self::Refused { address, code } => write!(f, "{address}: {code}{}", lacks(*address)),
            Self::Silent(address) => write!(
                f,
                "no SDO answer about {address}: is the node stopped, or its SDO server busy with \
                 another master?"
            ),
            Self::Garbled { address, code } => write!(
                f,
                "an SDO answer that belongs to no request, when {address} was asked ({code}): two nodes of one \
                 number, another master, or a node that repeats its answers; it is asked again when it is quiet"
            ),
            Self::NotTaken(address) => write!(
                f,
                "{address} was written and reads another value: the device limits it, or needs \
                 it stored (1010h) and a reset"
            ),
            Self::NotStarted(state) => write!(
                f,
                "told to start, it says {state}: does its 1F80h or a local control forbid it?"
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
                "no answer to node guarding: power, wiring, bus-off, or 100Ch and 100Dh",
            ),
            Self::Restarted => f.write_str(
                "it booted up while it ran and lost its configuration: check its supply; it is \
                 configured anew and waits for its goal",
            ),
            Self::LeftOperational(state) => write!(
                f,
                "it went to {state} without being told: 1029h after an error, or another master"
            ),
            Self::PdoMissing { number, cycles } => write!(
                f,
                "TPDO {} did not come for {cycles} SYNCs: bus load too high, SYNC not received \
                 (1005h), or its type ({:04X}h:02) changed",
                u32::from(*number) + 1,
                0x1800 + u32::from(*number)
            ),
            Self::PdoShort { number, len } => write!(
                f,
                "TPDO {} came with {len} bytes, more are mapped: its mapping {:04X}h was \
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

/// Why an axis does not do what it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum AxisTrouble {
    /// Its node does not run.
    NodeDown,
    /// What the drive profile knows.
    Drive(Obstacle),
    /// The drive would follow, but its target is too far from where it is: it would jump.
    NotAligned {
        /// 607Ah, user units.
        target: i32,
        /// 6064h, user units.
        actual: i32,
    },
    /// The last homing run failed.
    Homing(HomingError),
    /// A set-point of profile position was not taken.
    SetPoint(SetPointError),
    /// It was lost while enabled; it is held back until its goal is set anew.
    HeldBack,
}

impl fmt::Display for AxisTrouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NodeDown => f.write_str("its node does not run; see the node's trouble"),
            Self::Drive(obstacle) => obstacle.fmt(f),
            Self::NotAligned { target, actual } => write!(
                f,
                "its target {target} is too far from its position {actual}: begin from 6064h, or \
                 it would jump"
            ),
            Self::Homing(error) => error.fmt(f),
            Self::SetPoint(error) => error.fmt(f),
            Self::HeldBack => f.write_str(
                "its node was lost while it was enabled: find out why, then set its goal",
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_of_high_pdos_are_named() {
        let missing = |number| Trouble::PdoMissing { number, cycles: 4 }.to_string();
        assert!(missing(0).contains("TPDO 1 did") && missing(0).contains("(1800h:02)"));
        assert!(missing(64).contains("TPDO 65 did") && missing(64).contains("(1840h:02)"));
        let short = |number| Trouble::PdoShort { number, len: 2 }.to_string();
        assert!(short(0).contains("1A00h") && short(192).contains("1AC0h"));
    }

    #[test]
    fn a_device_that_cannot_watch_its_master_has_a_remedy() {
        let refused = |index| {
            let (address, code) = (Address::new(index, 1), AbortCode::NoObject);
            Trouble::Refused { address, code }.to_string()
        };
        assert!(refused(0x1016).contains("let the master send no heartbeat"));
        assert!(!refused(0x1017).contains("heartbeat"));
    }
}
