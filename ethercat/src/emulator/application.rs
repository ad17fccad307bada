//! The firmware of a slave. The rules of the controller are not here.

use std::fmt;

use crate::{AlState, AlStatusCode};

/// Inputs of a firmware cycle: at SYNC0, or with each frame of outputs.
#[derive(Clone, Copy, Debug)]
pub struct Cycle<'a> {
    /// The newest outputs; `None` before the first, and outside of OP.
    pub outputs: Option<&'a [u8]>,
    /// The outputs are new since the last cycle.
    pub fresh: bool,
    /// Time since the last cycle, ns.
    pub dt: u64,
    /// The state of the slave.
    pub state: AlState,
    /// The cycle was triggered by SYNC0, rather than by outputs or time.
    pub synchronous: bool,
}

/// Set-up by the master at a state request.
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
    /// The code of the refusal.
    fn enter(&mut self, state: AlState, setup: &Setup) -> Result<(), AlStatusCode> {
        let _ = (state, setup);
        Ok(())
    }

    /// Called at a state change.
    fn leave(&mut self, from: AlState, to: AlState) {
        let _ = (from, to);
    }

    /// Number of consecutive SYNC0 without new outputs after which it leaves OP (10F1h:02), if configurable.
    fn sync_errors(&self) -> Option<u32> {
        None
    }

    /// Whether its mailbox carries no mailbox header: [`Self::mailbox`] then gets the complete content, and the answer
    /// is written unchanged.
    fn has_raw_mailbox(&self) -> bool {
        false
    }

    /// Handles the content of a CoE mailbox and writes the answer to `reply`; returns whether there is one.
    fn mailbox(&mut self, request: &[u8], reply: &mut Vec<u8>) -> bool {
        let _ = (request, reply);
        false
    }

    /// Writes an unsolicited message (an emergency, a fragment) to `message`; returns whether there is one.
    fn unasked(&mut self, message: &mut Vec<u8>) -> bool {
        let _ = message;
        false
    }

    /// One cycle: takes outputs, writes `inputs`, whose length is that of the process data.
    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]);

    /// Called at power-on or reset.
    fn reset(&mut self) {}
}

/// Firmware that has neither mailbox nor process data: a coupler's.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plain;

impl Application for Plain {
    fn cycle(&mut self, _: &Cycle<'_>, _: &mut [u8]) {}
}
