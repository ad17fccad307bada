//! What happened in the world, with times: onsets of contact, grasps, slips, drops, seats. Bounded.

use std::time::Duration;

/// Longest list of events; what does not fit is counted.
pub(crate) const EVENTS_MAX: usize = 10_000;

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    /// Time of the world's step.
    pub at: Duration,
    /// What.
    pub kind: EventKind,
}

/// Kind of an [`Event`]; names are those given to the builder.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum EventKind {
    /// The tip of a hand's tool touches a surface or a body.
    Touched {
        /// Hand.
        hand: String,
        /// Surface or body.
        on: String,
    },
    /// It no longer does.
    Left {
        /// Hand.
        hand: String,
    },
    /// Fingers hold a body.
    Grasped {
        /// Hand.
        hand: String,
        /// Body.
        body: String,
    },
    /// Fingers opened.
    Released {
        /// Hand.
        hand: String,
        /// Body.
        body: String,
    },
    /// A held body begins to slide between the fingers.
    Slipped {
        /// Hand.
        hand: String,
        /// Body.
        body: String,
    },
    /// A held body slid out of the fingers, or was wrenched out.
    Lost {
        /// Hand.
        hand: String,
        /// Body.
        body: String,
    },
    /// A body falls: it is faster than 0.3 m/s, and no hand holds it.
    Dropped {
        /// Body.
        body: String,
    },
    /// A body came to rest on a surface.
    Rested {
        /// Body.
        body: String,
    },
    /// A peg touches the face, the chamfer or the wall of a hole.
    PegTouched {
        /// Body of the peg.
        peg: String,
        /// Hole.
        hole: String,
    },
    /// A peg reached the bottom of its hole.
    Seated {
        /// Body of the peg.
        peg: String,
        /// Hole.
        hole: String,
    },
    /// The bit of a screwdriver took a screw.
    ScrewTaken {
        /// Hand.
        hand: String,
        /// Screw.
        screw: String,
    },
    /// The screw is in its thread.
    ScrewEngaged {
        /// Screw.
        screw: String,
        /// Thread.
        thread: String,
    },
    /// The screw is in its thread askew.
    CrossThreaded {
        /// Screw.
        screw: String,
        /// Thread.
        thread: String,
    },
    /// The head of the screw reached its seat.
    ScrewSeated {
        /// Screw.
        screw: String,
    },
    /// The bit turned without the screw for want of axial force.
    BitSlipped {
        /// Screw.
        screw: String,
    },
    /// The thread gave way.
    Stripped {
        /// Screw.
        screw: String,
    },
}

/// Events so far.
#[derive(Debug, Clone, Default)]
pub(crate) struct Log {
    pub(crate) events: Vec<Event>,
    pub(crate) lost: u64,
}

impl Log {
    pub(crate) fn push(&mut self, at: Duration, kind: EventKind) {
        if self.events.len() < EVENTS_MAX {
            self.events.push(Event { at, kind });
        } else {
            self.lost += 1;
        }
    }
}
