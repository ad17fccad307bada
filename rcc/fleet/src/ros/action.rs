//! The goals of an action server: their states, who waits for their results, what a request to cancel means (`action_msgs`). What
//! a goal does is not known here, nor how answers get to clients.

use super::messages::{GOALS_MAX, GoalId, Nanos};

/// State of a goal, as numbered by `action_msgs/GoalStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalStatus {
    /// Taken, and waits to begin.
    Accepted = 1,
    /// Runs.
    Executing = 2,
    /// Is to end.
    Canceling = 3,
    /// At its goal.
    Succeeded = 4,
    /// Ended on request.
    Canceled = 5,
    /// Ended for another reason.
    Aborted = 6,
}

impl GoalStatus {
    /// Whether it stays as it is.
    #[must_use]
    pub const fn is_final(self) -> bool {
        matches!(self, Self::Succeeded | Self::Canceled | Self::Aborted)
    }
}

/// Status of a goal that is not known.
pub const UNKNOWN: u8 = 0;

/// Answers of a request to cancel.
pub mod cancel {
    /// Goals are being cancelled, those in the answer.
    pub const NONE: u8 = 0;
    /// There is no such goal.
    pub const UNKNOWN_GOAL: u8 = 2;
    /// The goal has ended.
    pub const GOAL_TERMINATED: u8 = 3;
}

/// Most clients that wait for a result.
const WAITERS_MAX: usize = 64;

#[derive(Debug)]
struct Goal<W> {
    id: GoalId,
    /// When it was accepted.
    stamp: Nanos,
    status: GoalStatus,
    /// The answer of `get_result`, once it has ended.
    result: Option<Vec<u8>>,
    waiters: Vec<W>,
}

/// What becomes of a request for a result.
#[derive(Debug, PartialEq, Eq)]
pub enum Requested<W> {
    /// The result is there.
    Now(W, Vec<u8>),
    /// It will be, and the client waits.
    Later,
    /// There is no such goal.
    Unknown(W),
    /// Too many clients wait.
    Full(W),
}

/// The goals of a server, the newest last. `W` is a client that waits.
#[derive(Debug)]
pub struct Goals<W> {
    goals: Vec<Goal<W>>,
}

impl<W> Default for Goals<W> {
    fn default() -> Self {
        Self { goals: Vec::new() }
    }
}

impl<W> Goals<W> {
    /// Takes a goal. Of ended goals the oldest is forgotten if there are too many; `false` if its identifier is known, or too many
    /// are still to end.
    pub fn accept(&mut self, id: GoalId, stamp: Nanos) -> bool {
        if self.find(id).is_some() {
            return false;
        }
        if self.goals.len() >= GOALS_MAX {
            let ended = self.goals.iter().position(|goal| goal.status.is_final());
            let Some(ended) = ended else {
                return false;
            };
            self.goals.remove(ended);
        }
        self.goals.push(Goal {
            id,
            stamp,
            status: GoalStatus::Accepted,
            result: None,
            waiters: Vec::new(),
        });
        true
    }

    /// Forgets a goal that could not begin: for its client it never was one.
    pub fn forget(&mut self, id: GoalId) {
        self.goals.retain(|goal| goal.id != id);
    }

    fn find(&mut self, id: GoalId) -> Option<&mut Goal<W>> {
        self.goals.iter_mut().find(|goal| goal.id == id)
    }

    /// The state of a goal.
    #[must_use]
    pub fn status(&self, id: GoalId) -> Option<GoalStatus> {
        let goal = self.goals.iter().find(|goal| goal.id == id);
        goal.map(|goal| goal.status)
    }

    /// Changes the state of a goal that has not ended.
    pub fn set(&mut self, id: GoalId, status: GoalStatus) {
        if let Some(goal) = self.find(id)
            && !goal.status.is_final()
        {
            goal.status = status;
        }
    }

    /// Ends a goal; returns the clients that wait for its result.
    pub fn end(&mut self, id: GoalId, status: GoalStatus, result: Vec<u8>) -> Vec<W> {
        match self.find(id) {
            Some(goal) if !goal.status.is_final() => {
                goal.status = status;
                goal.result = Some(result);
                std::mem::take(&mut goal.waiters)
            }
            _ => Vec::new(),
        }
    }

    /// A request for a result.
    pub fn request(&mut self, id: GoalId, waiter: W) -> Requested<W> {
        let Some(goal) = self.find(id) else {
            return Requested::Unknown(waiter);
        };
        match &goal.result {
            Some(result) => Requested::Now(waiter, result.clone()),
            None if goal.waiters.len() >= WAITERS_MAX => Requested::Full(waiter),
            None => {
                goal.waiters.push(waiter);
                Requested::Later
            }
        }
    }

    /// A request to cancel: a goal, all goals accepted up to a time, both, or, without either, all goals. Returns the code of the
    /// answer, and the goals, which are being cancelled from now on.
    pub fn cancel(&mut self, id: GoalId, stamp: Nanos) -> (u8, Vec<(GoalId, Nanos)>) {
        let is_any = id == [0; 16];
        if !is_any && stamp == 0 {
            match self.status(id) {
                None => return (cancel::UNKNOWN_GOAL, Vec::new()),
                Some(status) if status.is_final() => {
                    return (cancel::GOAL_TERMINATED, Vec::new());
                }
                Some(_) => {}
            }
        }
        let mut cancelled = Vec::new();
        for goal in &mut self.goals {
            let by_time = if stamp == 0 {
                is_any
            } else {
                goal.stamp <= stamp
            };
            if (goal.id == id || by_time) && !goal.status.is_final() {
                goal.status = GoalStatus::Canceling;
                cancelled.push((goal.id, goal.stamp));
            }
        }
        (cancel::NONE, cancelled)
    }

    /// All goals with their states, as the status topic has them.
    #[must_use]
    pub fn statuses(&self) -> Vec<(GoalId, Nanos, u8)> {
        let goals = self.goals.iter();
        goals.map(|it| (it.id, it.stamp, it.status as u8)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(number: u8) -> GoalId {
        [number; 16]
    }

    #[test]
    fn goal_id_is_accepted_once() {
        let mut goals = Goals::<u8>::default();
        assert!(goals.accept(id(1), 10));
        assert!(!goals.accept(id(1), 11));
        assert_eq!(goals.statuses(), [(id(1), 10, 1)]);
    }

    #[test]
    fn forgotten_goal_may_come_again() {
        let mut goals = Goals::<u8>::default();
        assert!(goals.accept(id(1), 10));
        goals.forget(id(1));
        assert!(goals.statuses().is_empty());
        assert!(goals.accept(id(1), 11));
    }

    #[test]
    fn result_is_sent_to_all_that_wait_and_kept() {
        let mut goals = Goals::default();
        goals.accept(id(1), 1);
        assert_eq!(goals.request(id(1), "first"), Requested::Later);
        assert_eq!(goals.request(id(1), "second"), Requested::Later);
        let waiters = goals.end(id(1), GoalStatus::Succeeded, vec![7]);
        assert_eq!(waiters, ["first", "second"]);
        assert_eq!(
            goals.request(id(1), "later"),
            Requested::Now("later", vec![7])
        );
        assert_eq!(goals.request(id(2), "x"), Requested::Unknown("x"));
        assert!(goals.end(id(1), GoalStatus::Aborted, vec![]).is_empty());
        assert_eq!(goals.status(id(1)), Some(GoalStatus::Succeeded));
    }

    #[test]
    fn thousands_of_goals_are_bounded() {
        let mut goals = Goals::<u8>::default();
        for number in 0..5_000_u128 {
            let id = (number + 1).to_le_bytes();
            assert!(goals.accept(id, 0), "{number}");
            goals.end(id, GoalStatus::Aborted, vec![]);
        }
        assert_eq!(goals.statuses().len(), GOALS_MAX);
        let mut open = Goals::<u8>::default();
        let taken = (1..=200_u128).filter(|n| open.accept(n.to_le_bytes(), 0));
        assert_eq!(taken.count(), GOALS_MAX);
        let waiting =
            (0..200).filter(|_| open.request(1_u128.to_le_bytes(), 0) == Requested::Later);
        assert_eq!(waiting.count(), WAITERS_MAX);
    }

    #[test]
    fn cancel_takes_goal_time_both_or_all() {
        let goals = || {
            let mut goals = Goals::<u8>::default();
            for number in 1..=4 {
                goals.accept(id(number), i64::from(number) * 10);
            }
            goals.end(id(1), GoalStatus::Succeeded, vec![]);
            goals
        };
        let numbers = |(code, list): (u8, Vec<(GoalId, Nanos)>)| {
            (code, list.iter().map(|(id, _)| id[0]).collect::<Vec<_>>())
        };
        assert_eq!(numbers(goals().cancel(id(3), 0)), (cancel::NONE, vec![3]));
        assert_eq!(
            numbers(goals().cancel(id(0), 30)),
            (cancel::NONE, vec![2, 3])
        );
        assert_eq!(
            numbers(goals().cancel(id(4), 20)),
            (cancel::NONE, vec![2, 4])
        );
        assert_eq!(
            numbers(goals().cancel(id(0), 0)),
            (cancel::NONE, vec![2, 3, 4])
        );
        assert_eq!(goals().cancel(id(9), 0).0, cancel::UNKNOWN_GOAL);
        assert_eq!(goals().cancel(id(1), 0).0, cancel::GOAL_TERMINATED);
        let mut one = goals();
        one.cancel(id(2), 0);
        assert_eq!(one.status(id(2)), Some(GoalStatus::Canceling));
    }
}
