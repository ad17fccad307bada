//! Findings of a check: what in an accepted net is probably not meant, such as a joint that is commanded
//! twice. Unlike faults they do not keep a net from running.

use std::ops::Range;

use crate::fault::excerpt;

/// Upper bound on the findings of one net.
pub(crate) const FINDINGS_MAX: usize = 100;

/// How grave a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// The check could not decide: more must be known.
    Note,
    /// The net probably does not do what is meant.
    Warning,
}

impl Severity {
    /// As it begins a message.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Note => "Note",
            Self::Warning => "Warning",
        }
    }
}

/// One finding in a net text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How grave it is.
    pub severity: Severity,
    /// The bytes of the net text that it refers to.
    pub at: Range<usize>,
    /// What is the case.
    pub text: String,
    /// What to do about it.
    pub hint: String,
}

impl Finding {
    /// Line and column (both from 1, columns in characters) of the finding in `text`.
    #[must_use]
    pub fn location(&self, text: &str) -> (usize, usize) {
        excerpt::location(text, self.at.start)
    }

    /// The finding with an excerpt of `text`, carets below and the hint, without colour.
    #[must_use]
    pub fn render(&self, file: &str, text: &str) -> String {
        let (line, column) = self.location(text);
        let mut out = format!(
            "{}: {}\n  --> {file}:{line}:{column}\n",
            self.severity.text(),
            self.text
        );
        excerpt::append(text, &self.at, "", &mut out);
        out.push_str(&format!("hint: {}\n", self.hint));
        out
    }
}
