//! What is so in the world, for tests and figures: no robot could measure it.

use crate::event::Event;
use crate::geometry::{Pose, Twist, Wrench};
use std::time::Duration;

/// The state of the world at one step.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Time of the step on the clock of the posts; `None` before the first post.
    pub at: Option<Duration>,
    /// Steps so far, of 0.25 ms.
    pub steps: u64,
    /// In the order of the builder.
    pub bodies: Vec<BodyTruth>,
    /// In the order of the builder.
    pub hands: Vec<HandTruth>,
    /// Of each peg and each hole.
    pub pegs: Vec<PegTruth>,
    /// In the order of the builder.
    pub screws: Vec<ScrewTruth>,
    /// Poses of the bases with their docking offset, by name.
    pub bases: Vec<(String, Pose)>,
    /// What happened, oldest first; at most 10,000.
    pub events: Vec<Event>,
    /// Events that did not fit.
    pub events_lost: u64,
    /// Kinetic energy of the bodies and potential energy of their weight, J.
    pub energy_j: f64,
}

/// A body.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyTruth {
    /// Its name.
    pub name: String,
    /// Of its centre of mass.
    pub pose: Pose,
    /// Of its centre of mass.
    pub twist: Twist,
    /// Hands that hold it.
    pub held_by: Vec<String>,
    /// Whether it lies on something and moves with it.
    pub is_resting: bool,
    /// Whether it was removed.
    pub is_missing: bool,
    /// Half of what two hands pull (positive) or push (negative) against each other along the line between them, N; 0
    /// unless two hold it.
    pub internal_force_n: f64,
    /// Largest absolute value so far.
    pub internal_force_max_n: f64,
    /// Least and greatest distance of the two tool centre points while they held it, m.
    pub grasp_distance_m: Option<[f64; 2]>,
}

/// A hand.
#[derive(Debug, Clone, PartialEq)]
pub struct HandTruth {
    /// Its name.
    pub name: String,
    /// Of the flange, interpolated; `None` before the first post.
    pub flange: Option<Pose>,
    /// On the flange, about its origin.
    pub wrench: Wrench,
    /// Largest force on the flange so far, N.
    pub force_max_n: f64,
    /// Body between its fingers.
    pub holds: Option<String>,
    /// How far bodies have slid between its fingers, m.
    pub slip_m: f64,
    /// Surface or body that its tip touches.
    pub touches: Option<String>,
    /// Posts that were refused: not finite, or older than the last.
    pub refused: u64,
}

/// A peg against a hole.
#[derive(Debug, Clone, PartialEq)]
pub struct PegTruth {
    /// Body of the peg.
    pub peg: String,
    /// Hole.
    pub hole: String,
    /// Of the tip below the mouth, m; negative above it or beside it.
    pub depth_m: f64,
    /// Of the tip from the axis of the hole, m.
    pub offset_m: f64,
    /// Force on the peg out of the hole, N.
    pub force_n: f64,
    /// Largest so far, N.
    pub force_max_n: f64,
    /// Whether it has reached the bottom.
    pub is_seated: bool,
}

/// A screw.
#[derive(Debug, Clone, PartialEq)]
pub struct ScrewTruth {
    /// Its name.
    pub name: String,
    /// Hand at whose bit it is.
    pub at_bit: Option<String>,
    /// Thread in which it is.
    pub thread: Option<String>,
    /// In the thread, m.
    pub depth_m: f64,
    /// Turned into the thread, rad.
    pub turned_rad: f64,
    /// Torque against its turn, Nm.
    pub torque_nm: f64,
    /// Largest so far, Nm.
    pub torque_max_nm: f64,
    /// Whether it is in its thread askew.
    pub is_cross_threaded: bool,
    /// Whether its head is seated.
    pub is_seated: bool,
    /// Whether it has ruined its thread.
    pub is_stripped: bool,
}

impl Truth {
    /// The body of that name.
    #[must_use]
    pub fn body(&self, name: &str) -> Option<&BodyTruth> {
        self.bodies.iter().find(|body| body.name == name)
    }

    /// The hand of that name.
    #[must_use]
    pub fn hand(&self, name: &str) -> Option<&HandTruth> {
        self.hands.iter().find(|hand| hand.name == name)
    }

    /// The peg of a body against a hole.
    #[must_use]
    pub fn peg(&self, peg: &str, hole: &str) -> Option<&PegTruth> {
        let mut pegs = self.pegs.iter();
        pegs.find(|it| it.peg == peg && it.hole == hole)
    }

    /// The screw of that name.
    #[must_use]
    pub fn screw(&self, name: &str) -> Option<&ScrewTruth> {
        self.screws.iter().find(|screw| screw.name == name)
    }

    /// The first event that `is` so.
    #[must_use]
    pub fn first(&self, is: impl Fn(&Event) -> bool) -> Option<&Event> {
        self.events.iter().find(|event| is(event))
    }
}
