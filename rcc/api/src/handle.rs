//! What a program holds of an activity that was begun: its outcome, by waiting or by `await` on any executor, and its
//! cancellation.

use std::future::{Future, IntoFuture};
use std::panic::Location;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use crate::engine::{ActivityId, State};
use crate::error::{Error, ErrorKind};
use crate::outcome::Outcome;
use crate::session::Session;

/// An activity that was begun, or several that began together. Dropping the handle does not end them.
#[derive(Debug)]
#[must_use = "the outcome of an activity is in its handle"]
pub struct Handle {
    pub(crate) session: Arc<Session>,
    parts: Vec<Part>,
    /// Where the program began it.
    place: &'static Location<'static>,
}

/// Longer than any activity.
pub(crate) const FOR_EVER: Duration = Duration::from_secs(u32::MAX as u64);

/// Activities that begin together.
#[derive(Debug)]
pub(crate) struct Part {
    pub(crate) ids: Vec<ActivityId>,
    /// Whether it follows no other part.
    pub(crate) is_first: bool,
    /// Number of the part whose place it takes: that one's outcome does not count then.
    pub(crate) replaces: Vec<usize>,
}

impl Handle {
    #[track_caller]
    pub(crate) const fn new(session: Arc<Session>, parts: Vec<Part>) -> Self {
        let place = Location::caller();
        Self {
            session,
            parts,
            place,
        }
    }

    /// The line of the program that began it; its errors name it.
    pub const fn place(&self) -> &'static Location<'static> {
        self.place
    }

    pub(crate) fn ids(&self) -> Vec<ActivityId> {
        let ids = self.parts.iter().flat_map(|part| &part.ids);
        ids.copied().collect()
    }

    /// Waits until it has ended.
    ///
    /// # Errors
    /// The error with which it ended; of several activities the first.
    pub fn wait(&self) -> Result<Outcome, Error> {
        loop {
            if let Some(outcome) = self.wait_for(Duration::from_secs(3600)) {
                return outcome;
            }
        }
    }

    /// Waits until it has ended, at most for `timeout`; `None` if it goes on.
    ///
    /// # Errors
    /// As [`Self::wait`].
    pub fn wait_for(&self, timeout: Duration) -> Option<Result<Outcome, Error>> {
        let until = Instant::now() + timeout;
        self.session.wait_until(until, |_| self.outcome())
    }

    /// Waits until it has ended, also if it maintains its goal, at most for `timeout`; `None` if it goes on.
    ///
    /// # Errors
    /// As [`Self::wait`].
    pub fn wait_to_end_for(&self, timeout: Duration) -> Option<Result<Outcome, Error>> {
        let until = Instant::now() + timeout;
        let ended = |outcome: &Result<Outcome, Error>| !matches!(outcome, Ok(Outcome::Maintaining));
        self.session
            .wait_until(until, |_| self.outcome().filter(ended))
    }

    /// Waits until it has ended, also if it maintains its goal: until a condition stops it, another activity takes over, or it
    /// is cancelled or fails.
    ///
    /// # Errors
    /// As [`Self::wait`].
    pub fn wait_to_end(&self) -> Result<Outcome, Error> {
        loop {
            if let Some(outcome) = self.wait_to_end_for(Duration::from_secs(3600)) {
                return outcome;
            }
        }
    }

    /// Waits until its first activities run, at most for `timeout`; `None` if they still wait for what their devices do before.
    ///
    /// # Errors
    /// If it ended with an error before.
    pub fn wait_for_begin(&self, timeout: Duration) -> Option<Result<(), Error>> {
        let firsts = self.parts.iter().filter(|part| part.is_first);
        let firsts: Vec<_> = firsts.flat_map(|part| part.ids.clone()).collect();
        let until = Instant::now() + timeout;
        self.session.wait_until(until, |session| {
            let engine = session.engine();
            let begun = |id: &ActivityId| engine.has_begun(*id);
            let failed = |id: &ActivityId| matches!(engine.state(*id), Some(State::Ended(Err(_))));
            let all = firsts.iter().all(begun);
            let is_failed = firsts.iter().any(failed);
            drop(engine);
            match self.outcome() {
                Some(Err(error)) => Some(Err(error)),
                Some(Ok(_)) => Some(Ok(())),
                // An alternative of what failed may still begin.
                None => (all && !(is_failed && firsts.len() == 1)).then_some(Ok(())),
            }
        })
    }

    /// The outcome, if it has ended; else the task is woken at the next change. For executors that keep the handle.
    pub fn poll_outcome(&self, context: &Context<'_>) -> Poll<Result<Outcome, Error>> {
        // The waker is known before the state is read, so that no change is missed.
        self.session.wake_on_change(context.waker());
        self.outcome().map_or(Poll::Pending, Poll::Ready)
    }

    /// Requests that it end: it brakes on its path. One that has not begun does not begin, nor do those that wait for it.
    pub fn cancel(&self) {
        self.session.cancel(&self.ids());
    }

    /// Writes a value into its nets.
    pub(crate) fn write(&self, key: &str, text: &str) -> Result<(), ErrorKind> {
        self.session.write(&self.ids(), key, text)
    }

    /// Part of the path that it has completed, 0 to 1; of several activities the smallest.
    pub fn progress(&self) -> f64 {
        let session = &self.session;
        self.ids()
            .iter()
            .map(|id| session.engine().progress(*id))
            .fold(1.0, f64::min)
    }

    /// The outcome, if it has ended.
    ///
    /// # Errors
    /// The error with which it ended.
    pub fn outcome(&self) -> Option<Result<Outcome, Error>> {
        let engine = self.session.engine();
        let of = |id: &ActivityId| match engine.state(*id) {
            Some(State::Ended(outcome)) => Some(outcome.clone()),
            Some(_) if engine.is_maintaining(*id) => Some(Ok(Outcome::Maintaining)),
            Some(_) => None,
            None => Some(Ok(Outcome::Cancelled)),
        };
        let part = |part: &Part| {
            let outcomes: Option<Vec<_>> = part.ids.iter().map(of).collect();
            outcomes.map(joint)
        };
        let outcomes: Option<Vec<_>> = self.parts.iter().map(part).collect();
        let total = outcomes.map(|outcomes| self.total(outcomes))?;
        let place = self.place;
        Some(total.map_err(|kind| Error { kind, place }))
    }

    /// The outcome of those parts whose place no other part took.
    fn total(&self, outcomes: Vec<Result<Outcome, ErrorKind>>) -> Result<Outcome, ErrorKind> {
        let mut is_replaced = vec![false; outcomes.len()];
        let pairs = self.parts.iter().zip(&outcomes);
        for (part, _) in pairs.filter(|(_, outcome)| **outcome != Ok(Outcome::Skipped)) {
            for number in &part.replaces {
                is_replaced
                    .get_mut(*number)
                    .into_iter()
                    .for_each(|is| *is = true);
            }
        }
        let is_cause = |outcome: &&Result<Outcome, ErrorKind>| matches!(outcome, Err(error) if !matches!(error, ErrorKind::PredecessorFailed(_)));
        let counted = outcomes.iter().zip(is_replaced);
        let counted: Vec<_> = counted
            .filter(|(_, is_replaced)| !is_replaced)
            .map(|(outcome, _)| outcome.clone())
            .collect();
        match joint(counted) {
            // The cause, not its consequence.
            Err(error @ ErrorKind::PredecessorFailed(_)) => outcomes
                .into_iter()
                .find(|outcome| is_cause(&outcome))
                .unwrap_or(Err(error)),
            total => total,
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.session.release(&self.ids());
    }
}

/// The outcome of several activities: the first error, else the outcome that is furthest from completion.
fn joint(outcomes: Vec<Result<Outcome, ErrorKind>>) -> Result<Outcome, ErrorKind> {
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>, _>>()?;
    let rank = |outcome: &Outcome| match outcome {
        Outcome::Cancelled => 0,
        Outcome::Stopped(_) => 1,
        Outcome::TakenOver => 2,
        Outcome::Maintaining => 3,
        Outcome::Completed => 4,
        Outcome::Skipped => 5,
    };
    Ok(outcomes
        .into_iter()
        .min_by_key(rank)
        .unwrap_or(Outcome::Completed))
}

/// Waits without blocking; any executor can poll it.
#[derive(Debug)]
pub struct Ending(Handle);

impl Future for Ending {
    type Output = Result<Outcome, Error>;

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        self.0.poll_outcome(context)
    }
}

impl IntoFuture for Handle {
    type Output = Result<Outcome, Error>;
    type IntoFuture = Ending;

    fn into_future(self) -> Ending {
        Ending(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joint_outcome_is_the_worst() {
        use Outcome::{Cancelled, Completed, Stopped, TakenOver};
        assert_eq!(joint(vec![Ok(Completed), Ok(Completed)]), Ok(Completed));
        assert_eq!(joint(vec![Ok(Completed), Ok(TakenOver)]), Ok(TakenOver));
        let stopped = Stopped("touch".to_owned());
        assert_eq!(
            joint(vec![Ok(TakenOver), Ok(stopped.clone())]),
            Ok(stopped.clone())
        );
        assert_eq!(joint(vec![Ok(stopped), Ok(Cancelled)]), Ok(Cancelled));
        let error = ErrorKind::Lost("closed".to_owned());
        assert_eq!(joint(vec![Ok(Cancelled), Err(error.clone())]), Err(error));
    }
}
