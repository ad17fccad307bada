//! What every subcommand returns; only `main` makes an exit status of it.

/// Result of a subcommand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// All is as it should be: exit status 0.
    Good,
    /// The check failed, or the request was not completed: exit status 1.
    Failed,
}
