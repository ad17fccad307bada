//! Requests to the system and their outcomes, one line each: an ordinary user's run works and reports item
//! it lacks.
//!
//! It does not assess the host; the reader decides whether a refused request matters.

use std::fmt;

/// One request to the system and its outcome. Displays as one plain line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// Name of the request, as in `SCHED_FIFO priority`.
    pub item: &'static str,
    /// Value of the request, as in `80`; may be empty.
    pub detail: String,
    /// Outcome of the request.
    pub outcome: Outcome,
}

/// Outcome of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// In force.
    Granted,
    /// Not in force.
    Refused {
        /// The system's error text.
        why: String,
        /// How to fix it, and item the run continues without.
        remedy: String,
    },
    /// The configuration does not request it.
    NotRequested,
}

impl Grant {
    pub(crate) fn not_requested(item: &'static str) -> Self {
        Self {
            item,
            detail: String::new(),
            outcome: Outcome::NotRequested,
        }
    }

    /// The outcome of an attempt: `Ok`, or the reason and the remedy.
    pub(crate) fn from_attempt(
        item: &'static str,
        detail: impl Into<String>,
        attempt: Result<(), (String, String)>,
    ) -> Self {
        let outcome = match attempt {
            Ok(()) => Outcome::Granted,
            Err((why, remedy)) => Outcome::Refused { why, remedy },
        };
        Self {
            item,
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
        f.write_str(self.item)?;
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
