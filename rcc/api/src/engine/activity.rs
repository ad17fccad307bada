//! Activities and groups: what a program begins, what each of them does, and how it ended.

use std::collections::BTreeSet;

use crate::error::ErrorKind;
use crate::outcome::Outcome;

/// Number of an activity, unique for its engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ActivityId(pub(super) u64);

/// Number of a group of activities that begin together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct GroupId(pub(super) u64);

/// Key of the result of a net that fits where its arms are when it begins.
pub const FITS: &str = "fits";

/// An activity to be begun.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The devices that it commands, with one net: coupled arms have several.
    pub devices: Vec<String>,
    /// Text of its net.
    pub net: String,
    /// Name of its net, if that was loaded beforehand: it is ready to be scheduled.
    pub loaded: Option<String>,
    /// Whether its net decides in its first cycle whether it begins: by the result [`FITS`], or a failure.
    pub is_guarded: bool,
    /// Keys of the results after which a successor may begin.
    pub results: Vec<String>,
    /// Results after which it has failed, the first in order before the others.
    pub failures: Vec<Failure>,
}

/// A result of a net that stands for an error.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// Key of the result.
    pub key: String,
    /// The error; progress and the controller's reason are added to it.
    pub error: ErrorKind,
}

impl Failure {
    /// The device fails for a cause.
    pub fn of(key: &str, device: &str, cause: &str) -> Self {
        let error = ErrorKind::DeviceFailed {
            device: device.to_owned(),
            cause: cause.to_owned(),
        };
        Self::with(key, device, error)
    }

    /// One key for each device, so that a net may command several.
    pub fn with(key: &str, device: &str, error: ErrorKind) -> Self {
        let key = format!("{key}_{device}");
        Self { key, error }
    }

    /// A joint of an arm does not follow its commands.
    pub fn joints_failed(device: &str) -> Self {
        Self::of("failed", device, "a joint does not follow its commands")
    }

    /// A device of coupled arms, of which this one is the first, does not follow its commands; it is not known which.
    pub fn device_lost(device: &str) -> Self {
        let cause = "it or an arm that is coupled with it has failed";
        Self::of("lost", device, cause)
    }

    /// A joint of an arm would leave its range.
    pub fn out_of_range(device: &str) -> Self {
        Self::of("illegal", device, "a joint would leave its range")
    }

    /// Another net commands the device.
    pub fn conflict(device: &str) -> Self {
        let error = ErrorKind::Conflict {
            device: device.to_owned(),
            joint: None,
            holder: None,
        };
        Self::with("concurrent", device, error)
    }

    /// An arm is not where the activity was prepared for.
    pub fn moved(device: &str) -> Self {
        let cause = "the arm is not where it was to begin";
        Self::with("moved", device, ErrorKind::stale(device, cause))
    }

    /// Whether it is that another net commands the device.
    pub(super) const fn is_conflict(&self) -> bool {
        matches!(self.error, ErrorKind::Conflict { .. })
    }

    /// The path of an arm leaves its reach.
    pub fn unreachable(device: &str) -> Self {
        Self::off_path("unreachable", device, "the frame is out of reach")
    }

    /// A joint of an arm becomes too fast on its path.
    pub fn too_fast(device: &str) -> Self {
        let cause = "a joint becomes too fast: the path leads near a singularity";
        Self::off_path("fast", device, cause)
    }

    /// The measured position of a joint is further from a trajectory than it may be; `place` is `path` or `goal`.
    pub fn deviated(place: &'static str, device: &str) -> Self {
        let error = ErrorKind::Deviation {
            device: device.to_owned(),
            place,
            joint: 0,
            deviation: 0.0,
        };
        Self::with(&format!("{place}_tolerance"), device, error)
    }

    fn off_path(key: &str, device: &str, cause: &str) -> Self {
        let error = ErrorKind::Unreachable {
            device: device.to_owned(),
            progress: 0.0,
            cause: cause.to_owned(),
        };
        Self::with(key, device, error)
    }

    /// The error with what is known at the end of the net.
    fn at_end(&self, reason: &str, part: f64, deviated: (usize, f64)) -> ErrorKind {
        let mut error = self.error.clone();
        if let ErrorKind::Deviation {
            joint, deviation, ..
        } = &mut error
        {
            (*joint, *deviation) = deviated;
        }
        if let ErrorKind::Unreachable { progress, .. } = &mut error {
            *progress = part * 100.0;
        }
        if let ErrorKind::DeviceFailed { cause, .. } = &mut error
            && !reason.is_empty()
        {
            *cause = format!("{cause}: {reason}");
        }
        error
    }
}

/// Activities that begin together, as part of what a program begins in one call.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// The activities; their devices differ.
    pub starts: Vec<Start>,
    /// Whether it waits for what its devices do.
    pub when: When,
    /// Numbers of earlier parts of the call that it follows besides: of each slot the one that comes to run last.
    pub after: Vec<Vec<usize>>,
    /// What starts it besides; without it the part is skipped.
    pub trigger: Option<Trigger>,
    /// Whether it begins also if what it follows fails.
    pub after_failure: bool,
    /// Number of the part of the call that it stands in for: it begins only if that one cannot.
    pub instead_of: Option<usize>,
}

impl Part {
    /// Activities that begin together.
    pub const fn new(starts: Vec<Start>, when: When) -> Self {
        Self {
            starts,
            when,
            after: Vec::new(),
            trigger: None,
            after_failure: false,
            instead_of: None,
        }
    }
}

/// Results that start a part: one of the keys is true.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trigger {
    /// Number of an earlier part of the call; its first activity has the results.
    pub part: usize,
    /// Keys of results of its net.
    pub keys: Vec<String>,
}

/// When a group begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// After what its devices do, or where that permits blending.
    Follow,
    /// In the next cycle, in place of what its devices do.
    Now,
}

/// What is to be requested from the controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Load the net and subscribe to it; report by [`Engine::loaded`](super::Engine::loaded).
    Load {
        /// Its activity.
        activity: ActivityId,
        /// Text of the net.
        net: String,
    },
    /// Install a rule and subscribe to it; report by [`Engine::scheduled`](super::Engine::scheduled).
    Schedule {
        /// Its group.
        group: GroupId,
        /// When it fires.
        condition: String,
        /// Nets that it stops.
        stop: Vec<String>,
        /// Nets that it starts.
        start: Vec<String>,
    },
    /// Request that a net end.
    Cancel(String),
    /// Remove a net that does not run.
    Unload(String),
}

/// What an activity does.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// Its net is being loaded.
    Loading,
    /// Its net is loaded; predecessors or other activities of its group are not yet.
    Loaded,
    /// It waits for its predecessors.
    Waiting,
    /// Its net runs.
    Running,
    /// It has ended.
    Ended(Result<Outcome, ErrorKind>),
}

#[derive(Debug)]
pub(super) struct Activity {
    pub(super) devices: Vec<String>,
    pub(super) group: GroupId,
    pub(super) results: Vec<String>,
    pub(super) failures: Vec<Failure>,
    pub(super) net: Option<String>,
    pub(super) state: State,
    /// Keys of the results that are true.
    pub(super) values: BTreeSet<String>,
    /// Part of the path, 0 to 1.
    pub(super) progress: f64,
    /// The joint that deviates, and how far, rad.
    pub(super) deviated: (usize, f64),
    /// Whether a program still refers to it.
    pub(super) is_held: bool,
    /// How it ends if its net is unloaded before it runs: its end was requested after its rule.
    pub(super) pending: Option<Result<Outcome, ErrorKind>>,
    /// Whether the unloading of its net was requested.
    pub(super) is_unloading: bool,
    /// Whether it has reached its goal and kept it up.
    pub(super) has_maintained: bool,
    /// Whether its net still decides whether it begins.
    pub(super) is_undecided: bool,
}

#[derive(Debug)]
pub(super) struct Group {
    pub(super) members: Vec<ActivityId>,
    /// What it follows: of each slot one activity, whichever comes to run last.
    pub(super) slots: Vec<Vec<ActivityId>>,
    /// Activity and keys of its results that start it.
    pub(super) trigger: Option<(ActivityId, Vec<String>)>,
    /// Slots that the program named: if all of one are skipped, so is the group.
    pub(super) required: Vec<Vec<ActivityId>>,
    /// Results without which it does not begin: its own trigger, and those of what it follows by request.
    pub(super) branch: Vec<(ActivityId, Vec<String>)>,
    pub(super) after_failure: bool,
    /// The group that it stands in for.
    pub(super) instead_of: Option<GroupId>,
    /// Number of the call that began it; its groups are scheduled before the first of them begins.
    pub(super) call: u64,
    /// Nets of a group that stands in for another, until they are loaded.
    pub(super) reserve: Vec<String>,
    /// Activities of its devices whose end was requested and is not confirmed.
    pub(super) ending: Vec<ActivityId>,
    pub(super) when: When,
    pub(super) life: GroupLife,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GroupLife {
    /// It stands in for another one, and nothing is loaded.
    Reserve,
    /// Nets are being loaded.
    Loading,
    /// The rule is requested or installed.
    Scheduled,
    /// The rule fired.
    Fired,
    /// It will not begin any more.
    Dead,
}

impl Activity {
    /// Its devices, as texts name them.
    pub(super) fn name(&self) -> String {
        self.devices.join(", ")
    }

    /// Whether it commands one of these devices.
    pub(super) fn commands<'a>(&self, devices: impl IntoIterator<Item = &'a String>) -> bool {
        devices
            .into_iter()
            .any(|device| self.devices.contains(device))
    }

    /// How it ended, by the results of its net. `is_followed`: another activity takes its place.
    pub(super) fn outcome(&self, reason: &str, is_followed: bool) -> Result<Outcome, ErrorKind> {
        let device = || self.name();
        let is = |key: &str| self.values.contains(key);
        let mut failures = self.failures.iter();
        if let Some(failure) = failures.find(|failure| is(&failure.key)) {
            return Err(failure.at_end(reason, self.progress, self.deviated));
        }
        if let Some(name) = self
            .values
            .iter()
            .find_map(|key| key.strip_prefix("until_"))
        {
            return Ok(Outcome::Stopped(name.to_owned()));
        }
        if is("completed") {
            return Ok(Outcome::Completed);
        }
        if is("cancelled") {
            // It had reached its goal before.
            let has_ended = self.has_maintained;
            return Ok(if has_ended {
                Outcome::Completed
            } else {
                Outcome::Cancelled
            });
        }
        if is_followed {
            return Ok(Outcome::TakenOver);
        }
        let reason = if reason.is_empty() {
            "the controller gives none"
        } else {
            reason
        };
        Err(ErrorKind::Ended {
            device: device(),
            reason: reason.to_owned(),
        })
    }
}

impl Group {
    /// Whether its rule has neither fired nor died.
    pub(super) fn may_begin(&self) -> bool {
        use GroupLife::{Loading, Reserve, Scheduled};
        matches!(self.life, Loading | Scheduled | Reserve)
    }

    /// All activities that it may follow.
    pub(super) fn predecessors(&self) -> impl Iterator<Item = ActivityId> {
        self.slots.iter().flatten().copied()
    }

    /// Whether it follows an activity or is started by it.
    pub(super) fn concerns(&self, id: ActivityId) -> bool {
        self.predecessors().any(|other| other == id) || self.is_started_by(id)
    }

    /// Whether it begins in any case.
    pub(super) fn is_sure(&self) -> bool {
        self.life == GroupLife::Fired || (self.branch.is_empty() && self.instead_of.is_none())
    }

    /// Whether at most one of both begins: they start by different ends of one activity.
    pub(super) fn excludes(&self, other: &[(ActivityId, Vec<String>)]) -> bool {
        let mut mine = self.branch.iter();
        mine.any(|(id, keys)| {
            let mut others = other.iter();
            others.any(|(of, theirs)| {
                of == id && keys != theirs && are_ends(keys) && are_ends(theirs)
            })
        })
    }

    pub(super) fn is_started_by(&self, id: ActivityId) -> bool {
        self.trigger
            .as_ref()
            .is_some_and(|(trigger, _)| *trigger == id)
    }
}

/// Whether results are ends of an activity, of which only one occurs.
fn are_ends(keys: &[String]) -> bool {
    let is_end = |key: &String| !key.starts_with("mark_") && key != "blend" && key != "maintaining";
    keys.iter().all(is_end)
}
