//! What a slave does beyond its controller: the firmware. The controller's own rules are not here.

use std::fmt;

use crate::{AlState, AlStatusCode};

/// What the firmware sees when its cycle comes: at SYNC0, or with each frame of outputs.
#[derive(Clone, Copy, Debug)]
pub struct Cycle<'a> {
    /// The newest outputs; `None` before the first, and outside of OP.
    pub outputs: Option<&'a [u8]>,
    /// They came since the last cycle.
    pub fresh: bool,
    /// Time since the last cycle, ns.
    pub dt: u64,
    /// The state of the slave.
    pub state: AlState,
    /// It is SYNC0 that made this cycle, rather than outputs or the passing of time.
    pub synchronous: bool,
}

/// What the master has set up when it asks for a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// Length of the outputs, bytes; 0 if their SyncManager is off.
    pub outputs: u16,
    /// Length of the inputs, bytes; 0 if their SyncManager is off.
    pub inputs: u16,
    /// SYNC0 is active, with this cycle, ns.
    pub sync0: Option<u32>,
    /// SYNC1 is active.
    pub sync1: bool,
}

/// The firmware of a slave.
pub trait Application: fmt::Debug + Send {
    /// Whether a step to a state is allowed, beyond what the controller itself checks.
    ///
    /// # Errors
    /// The code with which the slave refuses.
    fn enter(&mut self, state: AlState, setup: &Setup) -> Result<(), AlStatusCode> {
        let _ = (state, setup);
        Ok(())
    }

    /// The slave goes from a state to another.
    fn leave(&mut self, from: AlState, to: AlState) {
        let _ = (from, to);
    }

    /// After how many SYNC0 in a row without new outputs it leaves OP (10F1h:02), if that can be set.
    fn sync_errors(&self) -> Option<u32> {
        None
    }

    /// Whether its mailbox carries no mailbox header: [`Self::mailbox`] then gets the whole of it,
    /// and the answer is put there as it is.
    fn has_raw_mailbox(&self) -> bool {
        false
    }

    /// Answers what is inside a mailbox of the kind CoE, into `reply`; returns whether there is an
    /// answer.
    fn mailbox(&mut self, request: &[u8], reply: &mut Vec<u8>) -> bool {
        let _ = (request, reply);
        false
    }

    /// Something to say without being asked (an emergency, a fragment), into `message`; returns
    /// whether there is.
    fn unasked(&mut self, message: &mut Vec<u8>) -> bool {
        let _ = message;
        false
    }

    /// One cycle: takes outputs, writes `inputs`, whose length is that of the process data.
    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]);

    /// Power came on, or the slave was reset.
    fn reset(&mut self) {}
}

/// Firmware that has neither mailbox nor process data: a coupler's.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plain;

impl Application for Plain {
    fn cycle(&mut self, _: &Cycle<'_>, _: &mut [u8]) {}
}
