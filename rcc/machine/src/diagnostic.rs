//! What a check of a file found: errors and warnings with their locations, and how they are printed. Errors of a
//! running machine are values of the run time, never these.

use std::fmt;
use std::ops::Range;

use takt_net::fault::excerpt;

/// Upper bound on the diagnostics of one file; beyond it the search ends.
pub const DIAGNOSTICS_MAX: usize = 100;

/// Whether a file can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// It cannot be used.
    Error,
    /// It can be used, but probably does not do what is meant.
    Warning,
}

impl Level {
    /// As it begins a message.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Error => "Error",
            Self::Warning => "Warning",
        }
    }
}

/// One error or warning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Whether the file can be used.
    pub level: Level,
    /// The bytes of the text that it refers to.
    pub at: Range<usize>,
    /// The cause.
    pub text: String,
    /// The remedy.
    pub hint: String,
}

impl Diagnostic {
    /// Line and column (both from 1, columns in characters) in `text`.
    #[must_use]
    pub fn location(&self, text: &str) -> (usize, usize) {
        excerpt::location(text, self.at.start)
    }

    /// The diagnostic with an excerpt of `text`, carets below and the hint, without colour.
    #[must_use]
    pub fn render(&self, file: &str, text: &str) -> String {
        let (line, column) = self.location(text);
        let level = self.level.text();
        let mut out = format!("{level}: {}\n  --> {file}:{line}:{column}\n", self.text);
        excerpt::append(text, &self.at, "", &mut out);
        out.push_str(&format!("hint: {}\n", self.hint));
        out
    }
}

/// All diagnostics of one file, in text order once [`Self::sort`] was called.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Diagnostics {
    found: Vec<Diagnostic>,
}

impl Diagnostics {
    /// Adds an error.
    pub fn error(&mut self, at: Range<usize>, text: impl Into<String>, hint: impl Into<String>) {
        self.add(Level::Error, at, text.into(), hint.into());
    }

    /// Adds a warning.
    pub fn warning(&mut self, at: Range<usize>, text: impl Into<String>, hint: impl Into<String>) {
        self.add(Level::Warning, at, text.into(), hint.into());
    }

    fn add(&mut self, level: Level, at: Range<usize>, text: String, hint: String) {
        let next = Diagnostic {
            level,
            at,
            text,
            hint,
        };
        if self.found.len() < DIAGNOSTICS_MAX && !self.found.contains(&next) {
            self.found.push(next);
        }
    }

    /// Whether no more are kept.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.found.len() >= DIAGNOSTICS_MAX
    }

    /// Whether one of them is an error.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        self.found.iter().any(|found| found.level == Level::Error)
    }

    /// All of them.
    #[must_use]
    pub fn all(&self) -> &[Diagnostic] {
        &self.found
    }

    /// Puts them into text order.
    pub fn sort(&mut self) {
        self.found
            .sort_by_key(|found| (found.at.start, found.at.end));
    }

    /// The value if there is no error; else these diagnostics, in text order.
    ///
    /// # Errors
    /// If one of them is an error.
    pub fn or<T>(mut self, value: Option<T>) -> Result<(T, Self), Self> {
        self.sort();
        match value {
            Some(value) if !self.has_errors() => Ok((value, self)),
            _ => Err(self),
        }
    }

    /// All diagnostics as text; see [`Diagnostic::render`].
    #[must_use]
    pub fn render(&self, file: &str, text: &str) -> String {
        self.found.iter().map(|d| d.render(file, text)).collect()
    }
}

/// The causes in one line.
impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, found) in self.found.iter().enumerate() {
            if i > 0 {
                f.write_str("; ")?;
            }
            f.write_str(&found.text)?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostics {}

/// The most similar of some names, as a hint; else the names themselves.
pub(crate) fn suggest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    const SHOWN: usize = 12;
    let known: Vec<&str> = known.into_iter().collect();
    if let Some(similar) = takt_net::fault::similar(name, known.iter().copied()) {
        return format!("did you mean `{similar}`?");
    }
    if known.is_empty() {
        return "there are none".to_owned();
    }
    let shown: Vec<String> = known.iter().take(SHOWN).map(|k| format!("`{k}`")).collect();
    let more = if known.len() > SHOWN { ", …" } else { "" };
    format!("there are {}{more}", shown.join(", "))
}
