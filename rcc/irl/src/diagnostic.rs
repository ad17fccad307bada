//! Errors and warnings of a source text, with stable codes, locations and hints, and how they are rendered. Errors of a
//! running program are in `machine`.

use std::ops::Range;

use takt_net::fault::excerpt;

/// Upper bound on the errors that one run reports.
pub(crate) const ERRORS_MAX: usize = 100;

/// What kind of error it is; its number never changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Code {
    /// A character that begins no word of the language, or a text that does not end.
    Lexical = 101,
    /// The text does not follow the grammar.
    Syntax = 102,
    /// The text or its nesting exceeds a bound.
    Bound = 103,
    /// A name that is not declared.
    UnknownName = 201,
    /// A name that is declared twice.
    Twice = 202,
    /// A name that is something else than is required here.
    WrongKind = 203,
    /// Types that do not fit.
    Type = 301,
    /// A wrong number of arguments, components or indices.
    Count = 302,
    /// A value that must be known when the program is compiled, and is not.
    NotConstant = 303,
    /// A constant beyond its range.
    Range = 304,
    /// An assignment to something that cannot be assigned.
    ReadOnly = 305,
    /// A routine that calls itself.
    Recursion = 306,
    /// A statement in a place where it has no meaning.
    Misplaced = 307,
    /// An attribute that the motion does not have, or that is given twice.
    Attribute = 401,
    /// A robot that the system specification does not have.
    Robot = 402,
    /// A target that the robot cannot take.
    Target = 403,
    /// Two branches that move the same robot.
    SharedRobot = 404,
    /// The system specification is missing or invalid.
    Specification = 501,
    /// Warning: status and turns of a target are not used.
    StatusUnused = 901,
}

impl Code {
    /// All of them, by number.
    pub const ALL: [Self; 19] = [
        Self::Lexical,
        Self::Syntax,
        Self::Bound,
        Self::UnknownName,
        Self::Twice,
        Self::WrongKind,
        Self::Type,
        Self::Count,
        Self::NotConstant,
        Self::Range,
        Self::ReadOnly,
        Self::Recursion,
        Self::Misplaced,
        Self::Attribute,
        Self::Robot,
        Self::Target,
        Self::SharedRobot,
        Self::Specification,
        Self::StatusUnused,
    ];

    /// As it is printed: `E0102`, or `W0901` for a warning.
    #[must_use]
    pub fn text(self) -> String {
        let letter = if self.is_warning() { 'W' } else { 'E' };
        format!("{letter}{:04}", self as u32)
    }

    /// Whether a program with it can be compiled nevertheless.
    #[must_use]
    pub const fn is_warning(self) -> bool {
        self as u32 >= 900
    }
}

/// One error or warning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Its kind.
    pub code: Code,
    /// The bytes of the text that it refers to.
    pub at: Range<usize>,
    /// The cause.
    pub text: String,
    /// What to do about it; empty if the cause says so.
    pub hint: String,
}

impl Diagnostic {
    pub(crate) fn new(code: Code, at: Range<usize>, text: impl Into<String>) -> Self {
        Self {
            code,
            at,
            text: text.into(),
            hint: String::new(),
        }
    }

    /// The system specification that a text names at these bytes cannot be used.
    #[must_use]
    pub fn specification(at: Range<usize>, cause: impl Into<String>) -> Self {
        let hint = "the file is searched beside the program; `--spc FILE` names another one";
        Self::new(Code::Specification, at, cause).hint(hint)
    }

    pub(crate) fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = hint.into();
        self
    }

    /// Line and column in `text`, both from 1.
    #[must_use]
    pub fn location(&self, text: &str) -> (usize, usize) {
        excerpt::location(text, self.at.start)
    }

    /// The diagnostic with an excerpt of `text` and carets below, without colour.
    #[must_use]
    pub fn render(&self, file: &str, text: &str) -> String {
        let (line, column) = self.location(text);
        let severity = if self.code.is_warning() {
            "Warning"
        } else {
            "Error"
        };
        let code = self.code.text();
        let mut out = format!(
            "{severity}[{code}]: {}\n  --> {file}:{line}:{column}\n",
            self.text
        );
        excerpt::append(text, &self.at, "", &mut out);
        if !self.hint.is_empty() {
            out.push_str(&format!("hint: {}\n", self.hint));
        }
        out
    }
}

/// All diagnostics of a text that cannot be compiled, in text order: at least one error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejection {
    /// The errors and warnings.
    pub diagnostics: Vec<Diagnostic>,
}

impl Rejection {
    /// All of them, rendered.
    #[must_use]
    pub fn render(&self, file: &str, text: &str) -> String {
        let rendered = self.diagnostics.iter().map(|d| d.render(file, text));
        rendered.collect()
    }
}

impl std::fmt::Display for Rejection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (i, diagnostic) in self.diagnostics.iter().enumerate() {
            let separator = if i > 0 { "; " } else { "" };
            write!(
                f,
                "{separator}{}: {}",
                diagnostic.code.text(),
                diagnostic.text
            )?;
        }
        Ok(())
    }
}

impl std::error::Error for Rejection {}

/// "; did you mean `x`?", if a known name is similar.
pub(crate) fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    takt_net::fault::similar(name, known)
        .map_or_else(String::new, |similar| format!("did you mean `{similar}`?"))
}
