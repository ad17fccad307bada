//! What a program has described and not begun: an activity of a device, of any kind.

use std::sync::Arc;

use crate::compose::{Composite, Event};
use crate::engine::When;
use crate::error::Error;
use crate::explain::Explanation;
use crate::handle::Handle;
use crate::order::{Operation, Order, Speed};
use crate::outcome::Outcome;
use crate::plan::Plan;
use crate::preparation::Before;
use crate::prepared::Prepared;
use crate::session::Session;

/// An activity that was described and not begun.
#[derive(Clone, Debug)]
#[must_use = "nothing moves before it is begun"]
pub struct Activity {
    pub(crate) session: Arc<Session>,
    pub(crate) when: When,
    pub(crate) order: Order,
}

impl Activity {
    /// The activity that executes an operation.
    pub(crate) fn new(
        session: &Arc<Session>,
        operation: impl Operation + 'static,
        speed: Speed,
    ) -> Self {
        Self {
            session: Arc::clone(session),
            when: When::Follow,
            order: Order {
                operation: Arc::new(operation),
                speed,
                blend: None,
                until: Vec::new(),
                marks: Vec::new(),
                is_checked: true,
            },
        }
    }

    /// Multiplies its speed by `factor`, above 0 to 1.
    pub fn speed(mut self, factor: f64) -> Self {
        self.order.speed = self.order.speed.times(factor);
        self
    }

    /// Lets a successor take over from this part of the path on, 0 to below 1.
    pub const fn blend(mut self, progress: f64) -> Self {
        self.order.blend = Some(progress);
        self
    }

    /// Stops the motion on its path when the condition holds; the outcome names it.
    pub fn until(mut self, name: &str, condition: crate::Condition) -> Self {
        self.order.until.push((name.to_owned(), condition));
        self
    }

    /// Lets it begin in the next cycle, in place of what its device does, at rest or in motion.
    pub const fn now(mut self) -> Self {
        self.when = When::Now;
        self
    }

    /// Lets `next` follow: both are loaded and scheduled before the first one begins.
    pub fn then(self, next: impl Into<Composite>) -> Composite {
        Composite::from(self).then(next)
    }

    /// Lets `next` begin at an event of this activity, decided by the controller. What is not begun is skipped.
    pub fn on(self, event: Event, next: impl Into<Composite>) -> Composite {
        Composite::from(self).on(event, next)
    }

    /// Lets it begin also if what it follows fails or is cancelled.
    pub fn after_failure(self) -> Composite {
        Composite::from(self).after_failure()
    }

    /// Plans, writes and loads it, so that [`Prepared::begin`] later is one request; nothing moves.
    ///
    /// # Errors
    /// As [`Composite::prepare`].
    #[track_caller]
    pub fn prepare(self) -> Result<Prepared, Error> {
        Composite::from(self).prepare()
    }

    /// Begins it, and returns when it runs: a program is at most one activity ahead.
    ///
    /// # Errors
    /// If it is invalid, rejected, or what its device does before fails.
    #[track_caller]
    pub fn begin(self) -> Result<Handle, Error> {
        Composite::from(self).begin()
    }

    /// Lets it begin after what its device does, and returns at once.
    ///
    /// # Errors
    /// If it is invalid or rejected.
    #[track_caller]
    pub fn queue(self) -> Result<Handle, Error> {
        Composite::from(self).queue()
    }

    /// Begins it and waits until it has ended.
    ///
    /// # Errors
    /// As [`Self::begin`] and [`Handle::wait`].
    #[track_caller]
    pub fn run(self) -> Result<Outcome, Error> {
        self.begin()?.wait()
    }

    /// Begins it without a check of its path beforehand: where the arm cannot follow, the motion fails on its way.
    pub const fn unchecked(mut self) -> Self {
        self.order.is_checked = false;
        self
    }

    /// Plans it from where what its device does now ends, or from where the device is: nothing is loaded, nothing moves.
    ///
    /// # Errors
    /// If it is invalid, the arm cannot follow, or its path is not known before it runs.
    #[track_caller]
    pub fn plan(&self) -> Result<Plan, Error> {
        self.order.check()?;
        let begins = self
            .session
            .begins(&self.order, self.when, &Before::new())?;
        let speed = self.order.speed.factor();
        self.order.operation.follow(&begins, speed)?;
        Ok(self.order.operation.plan(&begins, speed)?)
    }

    /// What it becomes if it is begun now: its net, what it follows and what ends it, its worst-case cost, and its plan. The
    /// controller checks the net; nothing moves.
    ///
    /// # Errors
    /// If it is invalid, or the controller rejects the net.
    #[track_caller]
    pub fn explain(&self) -> Result<Explanation, Error> {
        Ok(self.session.explain(&self.order, self.when)?)
    }
}
