//! What a master has to tell: events, emergencies, answers to jobs. All queues are bounded; what does not fit is
//! counted. Texts are made by who reads them, never here.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use super::job::Reply;
use crate::{AlState, AlStatus, AlStatusCode, Emergency, MailboxError};
use takt_cia402::dictionary::{AbortCode, Address, Mapped};

/// Why a slave is not where it is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// It does not answer.
    Silent {
        /// The register that was asked for.
        register: u16,
    },
    /// It is gone: nothing of it answers any more.
    Lost,
    /// It refused a state or fell out of one.
    State {
        /// What was asked for.
        wanted: AlState,
        /// What it shows.
        status: AlStatus,
        /// Why.
        code: AlStatusCode,
    },
    /// It neither came to a state nor said why.
    Slow {
        /// What was asked for.
        wanted: AlState,
        /// What it shows.
        status: AlStatus,
        /// For how long.
        waited: Duration,
    },
    /// Its AL control takes no request, as its firmware has not read the one before.
    Unread {
        /// What was to be asked for.
        wanted: AlState,
        /// What it shows.
        status: AlStatus,
        /// For how long.
        waited: Duration,
    },
    /// Its SII does not answer, or says that there is none.
    Sii {
        /// Word address.
        word: u16,
        /// Register 0502h.
        status: u16,
    },
    /// An object was refused.
    Abort {
        /// Which.
        address: Address,
        /// Why.
        code: AbortCode,
    },
    /// An object was refused as an entry of a PDO.
    Entry {
        /// The entry: 1600h or 1A00h and following, with its number.
        address: Address,
        /// What was to be mapped there.
        entry: Mapped,
        /// Why.
        code: AbortCode,
    },
    /// A PDO does not carry what was mapped into it.
    Mapped {
        /// The entry: 1600h or 1A00h and following, with its number.
        address: Address,
        /// What was mapped there; `None` if nothing was.
        wanted: Option<Mapped>,
        /// What is there; `None` if nothing is.
        found: Option<Mapped>,
    },
    /// Its mailbox did not answer.
    Mailbox {
        /// The object that was asked for.
        address: Address,
        /// Why.
        error: JobError,
    },
    /// What it carries does not fit its SyncManager.
    Mapping {
        /// The SyncManager.
        sync_manager: u8,
        /// Bytes of its PDOs.
        bytes: usize,
        /// Bytes of room.
        room: usize,
    },
    /// It does not keep the PDOs that were assigned.
    Assignment {
        /// The SyncManager.
        sync_manager: u8,
        /// Bits of the PDOs that are wanted.
        wanted: usize,
        /// Bits of those that it has.
        found: usize,
    },
    /// Its SII has no SyncManager for what is to be exchanged.
    NoChannel {
        /// Outputs, or else inputs.
        outputs: bool,
    },
    /// It is not the slave that was there before.
    Identity {
        /// Vendor and product that were expected.
        expected: (u32, u32),
        /// Vendor and product that were found.
        found: (u32, u32),
    },
    /// Its clock does not come close to the reference clock.
    Clock {
        /// Difference, ns.
        difference_ns: i32,
        /// Largest allowed, ns.
        window_ns: u32,
    },
    /// It is to give SYNC signals, and has no clock that can.
    NoClock,
    /// The reference clock does not show its time.
    NoReference {
        /// Whose clock that is.
        slave: usize,
    },
    /// It came when the process image was made already, and its process data was not known then.
    NoRoom,
}

impl fmt::Display for Fault {
    #[expect(clippy::too_many_lines, reason = "a text for each fault")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent { register } => write!(
                f,
                "no answer from register {register:04X}h; see its supply and the cable before it"
            ),
            Self::Lost => f.write_str("gone from the segment; see its supply and the cable before it"),
            Self::State { wanted, status, code } => write!(f, "{wanted} wanted, {status} shown: {code}"),
            Self::Slow { wanted, status, waited } => write!(
                f,
                "{wanted} wanted, {status} shown for {waited:?} without a code; is its controller running?"
            ),
            Self::Unread { wanted, status, waited } => write!(
                f,
                "{wanted} wanted, {status} shown, and its firmware has not read AL control for {waited:?}; it hangs or \
                 is missing: switch its power off and on"
            ),
            Self::Sii { word, status } => write!(
                f,
                "SII word {word:04X}h cannot be read (0502h is {status:04X}h); its EEPROM is empty, broken or held \
                 by the slave"
            ),
            Self::Abort { address, code } => {
                write!(f, "object {address} refused: {code}; compare the set-up with its manual")
            }
            Self::Entry { address, entry, code } => write!(
                f,
                "{} refused as entry {} of PDO {:04X}h: {code}; map an object that the drive's manual lists for it",
                MappedText(Some(*entry)),
                address.sub,
                address.index
            ),
            Self::Mapped { address, wanted, found } => write!(
                f,
                "entry {} of PDO {:04X}h is {}, {} was mapped; the PDO is fixed or the slave keeps another mapping",
                address.sub,
                address.index,
                MappedText(*found),
                MappedText(*wanted)
            ),
            Self::Mailbox { address, error } => write!(f, "object {address}: {error}"),
            Self::Mapping { sync_manager, bytes, room } => write!(
                f,
                "its PDOs have {bytes} bytes, SyncManager {sync_manager} has room for {room}; assign fewer"
            ),
            Self::Assignment { sync_manager, wanted, found } => write!(
                f,
                "SyncManager {sync_manager} has {found} bits assigned, {wanted} are wanted; its PDOs are fixed or it \
                 keeps others: read 1C1{sync_manager:X}h"
            ),
            Self::NoChannel { outputs } => write!(
                f,
                "its SII has no SyncManager for {}; take them out of the configuration",
                if *outputs { "outputs" } else { "inputs" }
            ),
            Self::Identity { expected, found } => write!(
                f,
                "vendor {:08X}h product {:08X}h found where vendor {:08X}h product {:08X}h was; exchanged?",
                found.0, found.1, expected.0, expected.1
            ),
            Self::Clock { difference_ns, window_ns } => write!(
                f,
                "its clock is {difference_ns} ns from the reference, {window_ns} ns are allowed; see 092Ch over \
                 time: a jitter points to the cycle, a drift to its loop settings"
            ),
            Self::NoClock => f.write_str(
                "SYNC0 is wanted, and the slave has no clock of 64 bits with SYNC unit; take `sync` out",
            ),
            Self::NoReference { slave } => write!(
                f,
                "its clock waits for the reference clock, which is not running; see why slave {slave} does not come up"
            ),
            Self::NoRoom => f.write_str(
                "it has no place in the process image; give its outputs and inputs in the configuration",
            ),
        }
    }
}

/// An entry of a PDO as texts name it.
struct MappedText(Option<Mapped>);

impl fmt::Display for MappedText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(Mapped { address, bits }) => write!(f, "{address} ({bits} bits)"),
            None => f.write_str("nothing"),
        }
    }
}

/// Why a job failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum JobError {
    /// The slave refused the object.
    #[error("the slave refuses: {0}")]
    Abort(AbortCode),
    /// The slave could not take the message.
    #[error("{0}")]
    Mailbox(MailboxError),
    /// Nothing came back in time.
    #[error("no answer within {0:?}; is the slave in PRE-OP or higher, and its firmware running?")]
    Timeout(Duration),
    /// The slave has no mailbox, or no CoE.
    #[error("the slave has no {0}")]
    Unsupported(&'static str),
    /// The answer is longer than what was given to hold it.
    #[error("the answer has {size} bytes, {room} were given for it")]
    TooLong {
        /// Bytes of the answer.
        size: usize,
        /// Bytes of room.
        room: usize,
    },
    /// A datagram as long as its mailbox has no room in a frame beside the process image.
    #[error(
        "its mailbox of {size} bytes does not fit into a frame beside the process image, which leaves {room}; map \
         fewer or smaller PDOs, or split the segment"
    )]
    NoRoom {
        /// Bytes of the longer of its two areas.
        size: usize,
        /// Bytes left for one datagram.
        room: usize,
    },
    /// The answer is not what the protocol says.
    #[error("the answer is no valid {0}; a fault of the slave's firmware")]
    Protocol(&'static str),
    /// The register did not answer.
    #[error("the register did not answer (working counter 0)")]
    NoAnswer,
    /// The slave went away, or back to INIT.
    #[error("the slave is not there")]
    Absent,
    /// Too many jobs wait for this slave.
    #[error("{0} jobs wait for this slave already; wait for answers first")]
    Busy(usize),
    /// There is no such slave.
    #[error("there is no slave {0}")]
    NoSlave(usize),
}

/// Something happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// A slave reached its goal.
    Reached {
        /// Which.
        slave: usize,
        /// The state.
        state: AlState,
    },
    /// A slave is not where it is wanted.
    Fault {
        /// Which.
        slave: usize,
        /// Why.
        fault: Fault,
    },
    /// A slave that was lost answers again, or an optional one came.
    Returned {
        /// Which.
        slave: usize,
    },
    /// Nothing comes through a cable any more.
    CableCut {
        /// The cable.
        cable: Cable,
    },
    /// A ring of two ports is open at a cable; all slaves are still reached.
    RingOpen {
        /// The cable.
        cable: Cable,
    },
    /// The ring is whole again.
    RingClosed,
    /// A slave is there that nobody expects.
    Stranger {
        /// Where in the ring, from 0.
        position: u16,
    },
    /// At start a ring is open before this position, so that slaves cannot be given addresses by their place; it is
    /// waited for.
    StartSplit {
        /// Where, from 0.
        position: u16,
    },
    /// A slave came back, and which one it is cannot be told: it is left alone. Told once until that changes.
    Unplaced {
        /// Because a ring is open between slaves; else because another one of its kind is missing too.
        ring: bool,
    },
    /// A clock that was locked does not follow the reference any more.
    ClockLost {
        /// Whose.
        slave: usize,
        /// Difference, ns; positive is ahead.
        difference_ns: i32,
    },
    /// A clock that was lost follows again.
    ClockBack {
        /// Whose.
        slave: usize,
    },
    /// While process data is exchanged, the mailbox of a slave cannot be used: it does not fit beside them. Jobs for it
    /// end with [`JobError::NoRoom`], and should it come back later, it cannot be set up by objects.
    MailboxTooLong {
        /// Whose.
        slave: usize,
        /// Bytes of the longer of its two areas.
        size: usize,
        /// Bytes left for one datagram.
        room: usize,
    },
    /// The reference clock changed.
    Reference {
        /// The slave whose clock it is now.
        slave: usize,
    },
}

/// A cable between two ports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cable {
    /// The slave nearer to the master and its port; `None` is the master.
    pub from: Option<(usize, u8)>,
    /// The slave farther from the master, by its port 0; `None` is the master's second port.
    pub to: Option<usize>,
}

impl fmt::Display for Cable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.from {
            Some((slave, port)) => write!(f, "the cable from slave {slave} port {port} to ")?,
            None => f.write_str("the cable from the master to ")?,
        }
        match self.to {
            Some(slave) => write!(f, "slave {slave} port 0"),
            None => f.write_str("the master's second port"),
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reached { slave, state } => write!(f, "slave {slave}: {state}"),
            Self::Fault { slave, fault } => write!(f, "slave {slave}: {fault}"),
            Self::Returned { slave } => write!(f, "slave {slave}: there again"),
            Self::CableCut { cable } => write!(
                f,
                "{cable}: nothing comes through; see plugs, cable and supply there"
            ),
            Self::RingOpen { cable } => write!(
                f,
                "{cable}: the ring is open there; all slaves are reached still"
            ),
            Self::RingClosed => f.write_str("the ring is whole again"),
            Self::Stranger { position } => write!(
                f,
                "position {position}: a slave that the configuration does not know; it stays in INIT"
            ),
            Self::StartSplit { position } => write!(
                f,
                "the ring is open before position {position}: slaves get their addresses by their place, which two \
                 ends at once do not show; see plugs, cable and supply there, or start without the second port"
            ),
            Self::Unplaced { ring: true } => f.write_str(
                "a slave came back while the ring is open between others, so that its place cannot be told; it stays \
                 in INIT until the ring is whole",
            ),
            Self::Unplaced { ring: false } => f.write_str(
                "a slave came back while another one of its kind is missing, so that its place cannot be told; it \
                 stays in INIT until all are back: an alias for each (SII word 4), by which they are expected, tells \
                 them apart",
            ),
            Self::ClockLost {
                slave,
                difference_ns,
            } => write!(
                f,
                "slave {slave}: its clock is {difference_ns} ns from the reference; a jump points to the slave, a \
                 drift to frames that do not pass it"
            ),
            Self::ClockBack { slave } => {
                write!(f, "slave {slave}: its clock follows the reference again")
            }
            Self::MailboxTooLong { slave, size, room } => {
                write!(
                    f,
                    "slave {slave}: {}",
                    JobError::NoRoom {
                        size: *size,
                        room: *room
                    }
                )
            }
            Self::Reference { slave } => write!(f, "slave {slave}: its clock is the reference now"),
        }
    }
}

/// An emergency that a slave sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmergencyReport {
    /// Which slave.
    pub slave: usize,
    /// What it said.
    pub emergency: Emergency,
    /// When it was fetched.
    pub at: Duration,
}

/// Most of each kind that wait to be fetched.
pub(super) const QUEUE_MAX: usize = 128;

/// What waits to be fetched.
#[derive(Debug)]
pub(super) struct Outbox {
    pub(super) events: VecDeque<Event>,
    pub(super) emergencies: VecDeque<EmergencyReport>,
    pub(super) replies: VecDeque<Reply>,
    /// Events and emergencies that did not fit.
    pub(super) dropped: u64,
}

impl Outbox {
    pub(super) fn new() -> Self {
        Self {
            events: VecDeque::with_capacity(QUEUE_MAX),
            emergencies: VecDeque::with_capacity(QUEUE_MAX),
            replies: VecDeque::with_capacity(QUEUE_MAX),
            dropped: 0,
        }
    }

    pub(super) fn event(&mut self, event: Event) {
        if self.events.len() < QUEUE_MAX {
            self.events.push_back(event);
        } else {
            self.dropped += 1;
        }
    }

    /// The oldest goes when there are too many: the newest tells what is wrong now.
    pub(super) fn emergency(&mut self, report: EmergencyReport) {
        if self.emergencies.len() == QUEUE_MAX {
            self.emergencies.pop_front();
            self.dropped += 1;
        }
        self.emergencies.push_back(report);
    }

    pub(super) fn reply(&mut self, reply: Reply) {
        // As many can be under way as fit; see `Master::submit`.
        if self.replies.len() < QUEUE_MAX {
            self.replies.push_back(reply);
        } else {
            self.dropped += 1;
        }
    }
}
