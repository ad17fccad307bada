//! How far the start-up of a slave is, and what it has read and learnt. The steps themselves are in [`super::steps`].

use super::super::event::Fault;
use super::super::process::Assignment;
use super::learn::Learn;

/// The step up to which a slave may proceed by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::master) enum Gate {
    /// Until it is identified.
    #[default]
    Identity,
    /// Until its process data is known.
    Process,
    /// Up to its goal.
    Goal,
}

/// A step of the start. [`Unit::prepare`] defines its operation, [`Unit::advance`] handles its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::master) enum Step {
    Absent,
    Init,
    Information,
    Configuration,
    Links,
    ClockUnit,
    SiiForce,
    SiiTake,
    SiiRead,
    Identified,
    ReceiveTimes,
    ClearFmmus,
    ClearSyncManagers,
    ClearSync,
    Mailboxes,
    PreOp,
    Startup(u16),
    Assign(u16),
    Learn(u8),
    Configured,
    Watchdog,
    Channel(u8),
    Map(u8),
    ClockWait,
    ClockReset,
    ClockRead,
    ClockOffset,
    ClockGain,
    ClockFilter,
    ClockLock,
    SyncStart,
    SyncCycle,
    SyncOn,
    SafeOp,
    Open(u8),
    Op,
    Run,
    Failed,
    Check,
    Fallback,
}

/// The start-up of a slave.
#[derive(Debug)]
pub(super) struct Start {
    pub(super) step: Step,
    /// SII as read.
    pub(super) sii: Vec<u8>,
    /// Its SII was read.
    pub(super) known: bool,
    pub(super) assignments: Vec<Assignment>,
    /// The first assignment that was refused; whether it matters shows when the PDOs are read back.
    pub(super) refused: Option<Fault>,
    pub(super) learn: Learn,
    /// It has reached its goal and holds its set-up.
    pub(super) set_up: bool,
}

impl Default for Start {
    fn default() -> Self {
        Self {
            step: Step::Absent,
            sii: Vec::new(),
            known: false,
            assignments: Vec::new(),
            refused: None,
            learn: Learn::default(),
            set_up: false,
        }
    }
}
