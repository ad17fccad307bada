//! What the system was asked for and what it gave, one line each, so that an ordinary user's run works
//! and still says what it lacks.
//!
//! It does not judge the host; a refusal is for the reader of the line to weigh.

use std::fmt;

/// One request to the system and its outcome. Displays as one plain line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// What was asked for, as in `SCHED_FIFO priority`.
    pub what: &'static str,
    /// Which or how much of it, as in `80`; may be empty.
    pub detail: String,
    /// What became of it.
    pub outcome: Outcome,
}

/// What became of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// In force.
    Granted,
    /// Not in force.
    Refused {
        /// The system's own words.
        why: String,
        /// What the reader can do, and what the run goes on without.
        remedy: String,
    },
    /// The configuration does not ask for it.
    NotRequested,
}

impl Grant {
    pub(crate) fn not_requested(what: &'static str) -> Self {
        Self {
            what,
            detail: String::new(),
            outcome: Outcome::NotRequested,
        }
    }

    /// The outcome of an attempt: `Ok`, or the reason and the remedy.
    pub(crate) fn from_attempt(
        what: &'static str,
        detail: impl Into<String>,
        attempt: Result<(), (String, String)>,
    ) -> Self {
        let outcome = match attempt {
            Ok(()) => Outcome::Granted,
            Err((why, remedy)) => Outcome::Refused { why, remedy },
        };
        Self {
            what,
            detail: detail.into(),
            outcome,
        }
    }

    /// Whether the request is in force.
    pub fn is_granted(&self) -> bool {
        self.outcome == Outcome::Granted
    }

    /// Whether the request was made and refused.
    pub fn is_refused(&self) -> bool {
        matches!(self.outcome, Outcome::Refused { .. })
    }
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.what)?;
        if !self.detail.is_empty() {
            write!(f, " {}", self.detail)?;
        }
        match &self.outcome {
            Outcome::Granted => f.write_str(": granted"),
            Outcome::Refused { why, remedy } => write!(f, ": refused ({why}); {remedy}"),
            Outcome::NotRequested => f.write_str(": not requested"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn displays_as_one_line() {
        let refusal = Err(("Operation not permitted".into(), "do this".into()));
        let grant = Grant::from_attempt("SCHED_FIFO priority", "80", refusal);
        assert_eq!(
            grant.to_string(),
            "SCHED_FIFO priority 80: refused (Operation not permitted); do this"
        );
        let grant = Grant::from_attempt("memory lock", "", Ok(()));
        assert_eq!(grant.to_string(), "memory lock: granted");
        assert_eq!(
            Grant::not_requested("affinity").to_string(),
            "affinity: not requested"
        );
    }
}
