//! Outputs of a master: events, emergencies, replies to jobs. All queues are bounded; dropped entries are counted.
//! Texts are formatted by the reader, never here.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use super::job::Reply;
use crate::eoe::EoeResult;
use crate::foe::FoeError;
use crate::{AlState, AlStatus, AlStatusCode, Emergency, MailboxError};
use takt_cia402::dictionary::{AbortCode, Address, Mapped};

/// Why a slave has not reached its goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// It does not answer.
    Silent {
        /// The register.
        register: u16,
    },
    /// It is lost: it does not answer at all.
    Lost,
    /// It refused a state or left one.
    State {
        /// The requested state.
        wanted: AlState,
        /// The AL status.
        status: AlStatus,
        /// Its cause.
        code: AlStatusCode,
    },
    /// It neither reached a state nor reported an error.
    Slow {
        /// The requested state.
        wanted: AlState,
        /// The AL status.
        status: AlStatus,
        /// Time since the request.
        waited: Duration,
    },
    /// Its AL control accepts no request, as its firmware has not read the previous one.
    Unread {
        /// The requested state.
        wanted: AlState,
        /// The AL status.
        status: AlStatus,
        /// Time since the request.
        waited: Duration,
    },
    /// Its SII does not answer, or reports that there is none.
    Sii {
        /// Word address.
        word: u16,
        /// Register 0502h.
        status: u16,
    },
    /// An object was refused.
    Abort {
        /// The object.
        address: Address,
        /// Its cause.
        code: AbortCode,
    },
    /// An object was refused as an entry of a PDO.
    Entry {
        /// The entry: 1600h or 1A00h and following, with its number.
        address: Address,
        /// The object to map.
        entry: Mapped,
        /// Its cause.
        code: AbortCode,
    },
    /// A PDO does not carry the object that was mapped.
    Mapped {
        /// The entry: 1600h or 1A00h and following, with its number.
        address: Address,
        /// The mapped object; `None` if none was.
        wanted: Option<Mapped>,
        /// The actual object; `None` if there is none.
        found: Option<Mapped>,
    },
    /// Its mailbox did not answer.
    Mailbox {
        /// The object.
        address: Address,
        /// Its cause.
        error: JobError,
    },
    /// Its PDOs do not fit its SyncManager.
    Mapping {
        /// The SyncManager.
        sync_manager: u8,
        /// Length of its PDOs, bytes.
        bytes: usize,
        /// Capacity, bytes.
        capacity: usize,
    },
    /// It does not keep the PDOs that were assigned.
    Assignment {
        /// The SyncManager.
        sync_manager: u8,
        /// Length of the wanted PDOs, bits.
        wanted: usize,
        /// Length of its actual PDOs, bits.
        found: usize,
    },
    /// Its SII has no SyncManager for the configured process data.
    NoChannel {
        /// Outputs rather than inputs.
        outputs: bool,
    },
    /// It is not the slave that was there before.
    Identity {
        /// Vendor and product that were expected.
        expected: (u32, u32),
        /// Vendor and product that were found.
        found: (u32, u32),
    },
    /// Its clock does not lock to the reference clock.
    Clock {
        /// Difference, ns.
        difference_ns: i32,
        /// Largest allowed, ns.
        window_ns: u32,
    },
    /// SYNC signals are configured, but it has no suitable clock.
    NoClock,
    /// The reference clock does not show its time.
    NoReference {
        /// The slave of the reference clock.
        slave: usize,
    },
    /// It appeared after the process image was laid out, and its process data was not known then.
    NotInImage,
}

impl fmt::Display for Fault {
    #[expect(clippy::too_many_lines, reason = "a text for each fault")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent { register } => write!(
                f,
                "no answer from register {register:04X}h; check its supply and the cable before it"
            ),
            Self::Lost => f.write_str("lost from the segment; check its supply and the cable before it"),
            Self::State { wanted, status, code } => write!(f, "{wanted} wanted, {status} shown: {code}"),
            Self::Slow { wanted, status, waited } => write!(
                f,
                "{wanted} wanted, {status} shown for {waited:?} without a code; is its firmware running?"
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
            Self::Mapping { sync_manager, bytes, capacity } => write!(
                f,
                "its PDOs have {bytes} bytes, SyncManager {sync_manager} has a capacity of {capacity}; assign fewer"
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
            Self::NotInImage => f.write_str(
                "it has no region in the process image; give its outputs and inputs in the configuration",
            ),
        }
    }
}

/// An entry of a PDO, for error texts.
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
    /// The slave could not process the message.
    #[error("{0}")]
    Mailbox(MailboxError),
    /// The slave refused a file.
    #[error("the slave refuses the file: {0}")]
    File(FoeError),
    /// The slave refused a request to its Ethernet port.
    #[error("the slave refuses: {0}")]
    Ethernet(EoeResult),
    /// The data is no Ethernet frame.
    #[error("an Ethernet frame of {0} bytes; frames have 14 to 1518, without checksum")]
    FrameLength(usize),
    /// The answer timed out.
    #[error("no answer within {0:?}; is the slave in PRE-OP or higher, and its firmware running?")]
    Timeout(Duration),
    /// The slave has no mailbox, or no CoE.
    #[error("the slave has no {0}")]
    Unsupported(&'static str),
    /// The answer is longer than the buffer.
    #[error("the answer has {size} bytes, the buffer holds {capacity}")]
    TooLong {
        /// Length of the answer, bytes.
        size: usize,
        /// Capacity, bytes.
        capacity: usize,
    },
    /// A datagram as long as its mailbox does not fit into a frame beside the process image.
    #[error(
        "its mailbox of {size} bytes does not fit into a frame beside the process image, which leaves {capacity}; map \
         fewer or smaller PDOs, or split the segment"
    )]
    MailboxTooLong {
        /// Length of the longer of its two areas, bytes.
        size: usize,
        /// Remaining capacity for one datagram, bytes.
        capacity: usize,
    },
    /// The answer violates the protocol.
    #[error("the answer is no valid {0}; a fault of the slave's firmware")]
    Protocol(&'static str),
    /// The register did not answer.
    #[error("the register did not answer (working counter 0)")]
    NoAnswer,
    /// The EEPROM acknowledged no command in the whole time (0502h bit 13).
    #[error(
        "its EEPROM acknowledges no command (0502h bit 13): firmware holds it, or it is write-protected or broken"
    )]
    NoAcknowledge,
    /// The slave was lost, or fell to INIT.
    #[error("the slave is offline")]
    Absent,
    /// Too many jobs are queued for this slave.
    #[error("{0} jobs are queued for this slave; wait for replies first")]
    Busy(usize),
    /// There is no such slave.
    #[error("there is no slave {0}")]
    NoSlave(usize),
}

/// An event of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// A slave reached its goal.
    Reached {
        /// The slave.
        slave: usize,
        /// The state.
        state: AlState,
    },
    /// A slave failed to reach or left its goal.
    Fault {
        /// The slave.
        slave: usize,
        /// Its cause.
        fault: Fault,
    },
    /// A slave that was lost answers again, or an optional one appeared.
    Returned {
        /// The slave.
        slave: usize,
    },
    /// A cable is interrupted.
    CableCut {
        /// The cable.
        cable: Cable,
    },
    /// A ring of two ports is open at a cable; all slaves are still reached.
    RingOpen {
        /// The cable.
        cable: Cable,
    },
    /// The ring is closed again.
    RingClosed,
    /// A slave that is not configured.
    UnexpectedSlave {
        /// Position in the ring, from 0.
        position: u16,
    },
    /// At start the ring is open before this position, so that slaves cannot be addressed by position; the master waits
    /// for it to close.
    StartSplit {
        /// Position, from 0.
        position: u16,
    },
    /// A slave returned that cannot be identified: it stays in INIT. Reported once until that changes.
    Unplaced {
        /// True if a ring is open between slaves; false if another slave of its kind is missing too.
        ring: bool,
    },
    /// A locked clock lost the reference.
    ClockLost {
        /// The slave.
        slave: usize,
        /// Difference, ns; positive is ahead.
        difference_ns: i32,
    },
    /// A lost clock is locked again.
    ClockBack {
        /// The slave.
        slave: usize,
    },
    /// The mailbox of a slave does not fit beside the process data and cannot be used while they are exchanged. Jobs
    /// for it end with [`JobError::MailboxTooLong`], and if it returns later, it cannot be configured by objects.
    MailboxTooLong {
        /// The slave.
        slave: usize,
        /// Length of the longer of its two areas, bytes.
        size: usize,
        /// Remaining capacity for one datagram, bytes.
        capacity: usize,
    },
    /// The reference clock changed.
    Reference {
        /// The slave of the new reference clock.
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
            Self::Returned { slave } => write!(f, "slave {slave}: online again"),
            Self::CableCut { cable } => write!(
                f,
                "{cable}: no frames pass; check connectors, cable and supply there"
            ),
            Self::RingOpen { cable } => write!(
                f,
                "{cable}: the ring is open there; all slaves are reached still"
            ),
            Self::RingClosed => f.write_str("the ring is closed again"),
            Self::UnexpectedSlave { position } => write!(
                f,
                "position {position}: a slave that the configuration does not know; it stays in INIT"
            ),
            Self::StartSplit { position } => write!(
                f,
                "the ring is open before position {position}: slaves are addressed by position, which is ambiguous from \
                 both ends; check connectors, cable and supply there, or start without the second port"
            ),
            Self::Unplaced { ring: true } => f.write_str(
                "a slave returned while the ring is open between others, so that its position is ambiguous; it stays \
                 in INIT until the ring is closed",
            ),
            Self::Unplaced { ring: false } => f.write_str(
                "a slave returned while another one of its kind is missing, so that its position is ambiguous; it \
                 stays in INIT until all are back: give each an alias (SII word 4) and configure it to distinguish \
                 them",
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
            Self::MailboxTooLong { slave, size, capacity } => {
                write!(
                    f,
                    "slave {slave}: {}",
                    JobError::MailboxTooLong {
                        size: *size,
                        capacity: *capacity
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
    /// Its content.
    pub emergency: Emergency,
    /// Time at which it was fetched.
    pub at: Duration,
}

/// Maximum number of queued entries of each kind.
pub(super) const QUEUE_MAX: usize = 128;

/// Queued outputs.
#[derive(Debug)]
pub(super) struct Outbox {
    pub(super) events: VecDeque<Event>,
    pub(super) emergencies: VecDeque<EmergencyReport>,
    pub(super) replies: VecDeque<Reply>,
    /// Dropped events and emergencies.
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

    /// The oldest is dropped when the queue is full: the newest shows the present fault.
    pub(super) fn emergency(&mut self, report: EmergencyReport) {
        if self.emergencies.len() == QUEUE_MAX {
            self.emergencies.pop_front();
            self.dropped += 1;
        }
        self.emergencies.push_back(report);
    }

    pub(super) fn reply(&mut self, reply: Reply) {
        // `Master::submit` limits pending jobs to the capacity.
        if self.replies.len() < QUEUE_MAX {
            self.replies.push_back(reply);
        } else {
            self.dropped += 1;
        }
    }
}
