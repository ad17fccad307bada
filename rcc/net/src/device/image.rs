//! The image of all device interfaces that the nets of one thread read and write. Which device has which part of it is
//! defined elsewhere.

use std::cell::Cell;

use super::Trail;

/// Upper bound on the words that drivers report, beside joints.
pub const SIGNAL_WORDS_MAX: usize = 4096;

/// Upper bound on the words that nets command, beside joints.
pub const COMMAND_WORDS_MAX: usize = 4096;

/// Upper bound on the joints in the image: the sum over all robot arms.
pub const JOINTS_MAX: usize = 512;

/// The state that a robot-arm joint reports. `None` is "not known".
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointState {
    /// Last commanded position, rad.
    pub commanded_position: Option<f64>,
    /// Velocity of the commanded position, rad/s.
    pub commanded_velocity: Option<f64>,
    /// Acceleration of the commanded position, rad/s²; 0 while the driver brakes the joint or leads it to its set-points.
    pub commanded_acceleration: Option<f64>,
    /// Measured position, rad.
    pub measured_position: Option<f64>,
    /// Measured velocity, rad/s.
    pub measured_velocity: Option<f64>,
    /// Measured acceleration, rad/s².
    pub measured_acceleration: Option<f64>,
    /// 0 if the joint follows commands; see [`JointError`] for the other values.
    pub error: i32,
}

/// Values of [`JointState::error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum JointError {
    /// The joint follows commands.
    None = 0,
    /// The device is offline.
    Offline = 1,
    /// The device answers, but its drives are not enabled.
    NotEnabled = 2,
    /// The driver rejected the set-points and holds the joint: a step or speed beyond the limit.
    Refused = 3,
    /// Its drive stays without power: its process data by PDO differ from those by SDO.
    NotProven = 4,
    /// Its motor moved without a command to do so, and its power was switched off.
    Runaway = 5,
    /// It is out of its range: set-points that begin at its present position move it back, slowly.
    OutOfRange = 6,
}

/// A set-point for a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointCommand {
    /// The cycle in which it was given, as in `Moment::cycle`; 0 is "never".
    pub cycle: u64,
    /// Number of thread cycles until its net gives the next one: it is in force until then. 0 once
    /// it is withdrawn.
    pub every: u64,
    /// Position, rad.
    pub position: f64,
    /// The net that gave it; `None` if no running net did.
    pub net: Option<u32>,
}

impl JointCommand {
    /// Whether it is in force in this cycle: it was given in it, or the next one of its net is not
    /// due yet.
    pub const fn is_in_force(&self, cycle: u64) -> bool {
        cycle.saturating_sub(self.cycle) < self.every
    }
}

/// One joint in the image.
#[derive(Debug, Default)]
pub struct Joint {
    /// What the driver reports.
    pub state: Cell<JointState>,
    /// The command of a net.
    pub command: Cell<JointCommand>,
    /// The motion that nets command.
    pub trail: Cell<Trail>,
}

/// The emergency-stop votes of nets, cast by their `EStop` primitives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StopVote {
    /// The first cycle of the thread without a vote.
    pub voted_until: u64,
    /// The first cycle of the thread without a vote to stop.
    pub stop_until: u64,
}

impl StopVote {
    /// Adds a vote for all cycles before `until`. One vote to stop outweighs any number of others.
    #[must_use]
    pub fn with(self, until: u64, stop: bool) -> Self {
        Self {
            voted_until: self.voted_until.max(until),
            stop_until: if stop {
                self.stop_until.max(until)
            } else {
                self.stop_until
            },
        }
    }

    /// The vote for `cycle`: whether to stop; `None` without a vote.
    pub const fn at(self, cycle: u64) -> Option<bool> {
        if self.voted_until > cycle {
            Some(self.stop_until > cycle)
        } else {
            None
        }
    }
}

/// All device interfaces as the nets of one thread see them during one cycle.
#[derive(Debug)]
pub struct Image {
    /// Joints of all robot arms.
    pub joints: Box<[Joint]>,
    /// Other values that drivers report, addressed by [`Signal`](super::Signal)s.
    pub signals: Box<[Cell<u64>]>,
    /// Other commands of nets, addressed by [`Command`](super::Command)s.
    pub commands: Box<[Cell<u64>]>,
    /// The net that gave each command, by the command's first word.
    pub owners: Box<[Cell<Option<u32>>]>,
    /// Emergency-stop votes.
    pub stop: Cell<StopVote>,
    /// The last cycle in which nets were evaluated; 0 before the first.
    pub last_cycle: Cell<u64>,
}

/// Longest pause of a thread after which nets go on from what they commanded last, cycles: in longer ones, drivers brake.
const SKIPPED_MAX: u64 = 10;

impl Image {
    /// Cycles that the thread skipped between this one and the last that it evaluated; 0 also after a longer pause.
    pub fn skipped(&self, cycle: u64) -> u64 {
        let since = match self.last_cycle.get() {
            0 => 0,
            last => cycle.saturating_sub(last).saturating_sub(1),
        };
        if since <= SKIPPED_MAX { since } else { 0 }
    }
}

impl Default for Image {
    fn default() -> Self {
        Self {
            joints: (0..JOINTS_MAX).map(|_| Joint::default()).collect(),
            signals: (0..SIGNAL_WORDS_MAX).map(|_| Cell::new(0)).collect(),
            commands: (0..COMMAND_WORDS_MAX).map(|_| Cell::new(0)).collect(),
            owners: (0..COMMAND_WORDS_MAX).map(|_| Cell::new(None)).collect(),
            stop: Cell::default(),
            last_cycle: Cell::default(),
        }
    }
}
