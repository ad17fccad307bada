//! What a program holds of an activity that was begun: its outcome, by waiting or by `await` on any executor, and its
//! cancellation.

use std::future::{Future, IntoFuture};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use crate::activity::Activity;
use crate::engine::{ActivityId, State, When};
use crate::error::Error;
use crate::outcome::Outcome;
use crate::session::Session;

/// An activity that was begun, or several that began together. Dropping the handle does not end them.
#[derive(Debug)]
#[must_use = "the outcome of an activity is in its handle"]
pub struct Handle {
    session: Arc<Session>,
    ids: Vec<ActivityId>,
}

impl Handle {
    pub(crate) const fn new(session: Arc<Session>, ids: Vec<ActivityId>) -> Self {
        Self { session, ids }
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
    pub fn wait_for(&self, timeout: Duration) -> Option<Result<Outcome, Error>> {
        let until = Instant::now() + timeout;
        self.session.wait_until(until, |_| self.outcome())
    }

    /// Requests that it end: it brakes on its path. One that has not begun does not begin, nor do those that wait for it.
    pub fn cancel(&self) {
        self.session.cancel(&self.ids);
    }

    /// Part of the path that it has completed, 0 to 1; of several activities the smallest.
    pub fn progress(&self) -> f64 {
        let session = &self.session;
        self.ids
            .iter()
            .map(|id| session.engine().progress(*id))
            .fold(1.0, f64::min)
    }

    /// The outcome, if it has ended.
    pub fn outcome(&self) -> Option<Result<Outcome, Error>> {
        let engine = self.session.engine();
        let of = |id: &ActivityId| match engine.state(*id) {
            Some(State::Ended(outcome)) => Some(outcome.clone()),
            Some(_) => None,
            None => Some(Ok(Outcome::Cancelled)),
        };
        let outcomes: Option<Vec<_>> = self.ids.iter().map(of).collect();
        outcomes.map(joint)
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.session.release(&self.ids);
    }
}

/// The outcome of several activities: the first error, else the outcome that is furthest from completion.
fn joint(outcomes: Vec<Result<Outcome, Error>>) -> Result<Outcome, Error> {
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>, _>>()?;
    let rank = |outcome: &Outcome| match outcome {
        Outcome::Cancelled => 0,
        Outcome::Stopped(_) => 1,
        Outcome::TakenOver => 2,
        Outcome::Completed => 3,
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
        // The waker is known before the state is read, so that no change is missed.
        self.0.session.wake_on_change(context.waker());
        self.0.outcome().map_or(Poll::Pending, Poll::Ready)
    }
}

impl IntoFuture for Handle {
    type Output = Result<Outcome, Error>;
    type IntoFuture = Ending;

    fn into_future(self) -> Ending {
        Ending(self)
    }
}

/// Activities of different devices that begin in the same cycle.
#[derive(Debug)]
#[must_use = "nothing moves before it is begun"]
pub struct Together(Vec<Activity>);

/// Combines activities of different devices to one that begins when all of the devices are ready, in the same cycle.
pub fn together(activities: impl IntoIterator<Item = Activity>) -> Together {
    Together(activities.into_iter().collect())
}

impl Together {
    /// Begins them, and returns when they run.
    ///
    /// # Errors
    /// If one of them is invalid or rejected, two have the same device, or they belong to different cells.
    pub fn begin(self) -> Result<Handle, Error> {
        let handle = self.queue()?;
        handle.session.wait_for_begin(&handle.ids)?;
        Ok(handle)
    }

    /// The same, but does not wait until they run.
    ///
    /// # Errors
    /// As [`Self::begin`].
    pub fn queue(self) -> Result<Handle, Error> {
        let first = self.0.first();
        let session = first.map(|first| Arc::clone(&first.session));
        let Some(session) = session else {
            return Err(Error::Invalid("there is no activity to begin".to_owned()));
        };
        if self
            .0
            .iter()
            .any(|other| !Arc::ptr_eq(&other.session, &session))
        {
            let text = "activities of different cells cannot begin together";
            return Err(Error::Invalid(text.to_owned()));
        }
        let is_now = self.0.iter().any(|activity| activity.when == When::Now);
        let when = if is_now { When::Now } else { When::Follow };
        let orders: Vec<_> = self.0.into_iter().map(|activity| activity.order).collect();
        let ids = session.begin(&orders, when)?;
        Ok(Handle::new(session, ids))
    }

    /// Begins them and waits until all have ended.
    ///
    /// # Errors
    /// As [`Self::begin`] and [`Handle::wait`].
    pub fn run(self) -> Result<Outcome, Error> {
        self.begin()?.wait()
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
        let error = Error::Lost("closed".to_owned());
        assert_eq!(joint(vec![Ok(Cancelled), Err(error.clone())]), Err(error));
    }
}
