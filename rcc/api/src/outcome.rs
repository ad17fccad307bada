//! How activities end. Errors are not outcomes.

/// How an activity ended. Errors are not outcomes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It reached its goal.
    Completed,
    /// It was cancelled and is at rest on its path, or was not begun.
    Cancelled,
    /// It reached its goal and keeps it up until another activity takes over, or it is finished or cancelled.
    Maintaining,
    /// It did not begin: the result that was to start it did not occur, or an alternative began instead.
    Skipped,
    /// Another activity took over while it moved.
    TakenOver,
    /// The condition of this name stopped it; it is at rest on its path.
    Stopped(String),
}

impl Outcome {
    /// Whether the condition of this name stopped the activity.
    pub fn is_stopped_by(&self, name: &str) -> bool {
        matches!(self, Self::Stopped(by) if by == name)
    }
}
