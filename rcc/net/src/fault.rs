//! Faults of a net text, with their locations, and how they are rendered. Faults of a running net
//! are values in its ports, never these.

pub mod excerpt;

use std::fmt;
use std::ops::Range;
use std::time::Duration;

use crate::cost::NetCost;
use crate::finding::{Finding, Severity};

/// Upper bound on the faults that one load reports. Beyond it the search ends, or else a text of
/// faults alone would take memory and time without bound.
pub(crate) const FAULTS_MAX: usize = 100;

/// One fault of a net.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The cause.
    pub kind: FaultKind,
    /// The bytes of the net text that it refers to.
    pub at: Range<usize>,
    /// Related locations, each with a note.
    pub also: Vec<(Range<usize>, String)>,
}

/// The kinds of faults.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum FaultKind {
    /// The text does not follow the grammar.
    #[error("{expected} is expected here, not {found}")]
    Syntax { expected: String, found: String },
    /// The net exceeds a bound of [`crate::Limits`].
    #[error("the net has {found} {item}; at most {bound} are allowed")]
    Bound {
        item: &'static str,
        found: usize,
        bound: usize,
    },
    /// The net cannot be evaluated within its period.
    #[error(
        "a cycle of the net costs up to {:?}; the limit is {budget:?} of its period of {period:?}; the \
         heaviest are {}; use fewer of these, give the net a longer period, or measure what \
         primitives cost on this host: `takt net calibrate`",
        .cost.total, .cost.heaviest(3)
    )]
    Cost {
        cost: NetCost,
        budget: Duration,
        period: Duration,
    },
    /// No primitive of that name exists.
    #[error("there is no primitive `{name}`{}", did_you_mean(.similar))]
    UnknownPrimitive {
        name: String,
        similar: Option<String>,
    },
    /// The primitive has no parameter of that name.
    #[error("`{primitive}` has no parameter `{name}`; it has {}", listed(.known))]
    UnknownParameter {
        primitive: String,
        name: String,
        known: Vec<String>,
    },
    /// The primitive or fragment has no in port of that name.
    #[error("{owner} has no in port `{name}`; it has {}", listed(.known))]
    UnknownInPort {
        owner: String,
        name: String,
        known: Vec<String>,
    },
    /// The primitive or fragment has no out port of that name.
    #[error("{owner} has no out port `{name}`; it has {}", listed(.known))]
    UnknownOutPort {
        owner: String,
        name: String,
        known: Vec<String>,
    },
    /// A link starts at a child that this fragment does not have.
    #[error("this fragment has no child `{name}`{}", similar_or_reach(.similar))]
    UnknownChild {
        name: String,
        similar: Option<String>,
    },
    /// `parent` was used in the root fragment.
    #[error(
        "the root fragment has no in ports, so `parent` refers to nothing; use a NetcommIn for \
         values from outside"
    )]
    NoParent,
    /// Two children, ports or parameters have the same name.
    #[error("`{name}` is given twice")]
    Twice { name: String },
    /// A parameter's text is not a value of its type, or not an allowed one.
    #[error("parameter `{parameter}`: {why}")]
    Parameter { parameter: String, why: String },
    /// An arm is not as the primitive needs it, such as one without known kinematics.
    #[error("parameter `{parameter}`: {why}")]
    Arm { parameter: String, why: String },
    /// A link joins ports of different types.
    #[error(
        "in port `{port}` takes {expected}, but this source gives {found}{}",
        conversion(.expected, .found)
    )]
    Type {
        port: String,
        expected: String,
        found: String,
    },
    /// Array sizes do not match.
    #[error("{0}")]
    ArraySize(String),
    /// A required in port has no source.
    #[error("in port `{port}` of `{primitive}` must be connected: `{port}=child.port`")]
    NotConnected { primitive: String, port: String },
    /// A text was given to an in port.
    #[error(
        "`{port}` is an in port and takes a link such as `child.port`, not a text{}",
        constant_hint(.parameter)
    )]
    TextForPort {
        port: String,
        parameter: Option<String>,
    },
    /// A link was given to a parameter.
    #[error("`{name}` is a parameter and takes a text such as '1', not a link")]
    LinkForParameter { name: String },
    /// Links form a cycle without a Pre.
    #[error(
        "links form a cycle: {path}; insert a Pre where the value of the previous cycle suffices"
    )]
    Cycle { path: String },
    /// Fragment ports are connected to each other, and no primitive feeds them.
    #[error(
        "`{name}` is fed by itself through fragment ports; one of them must come from a primitive"
    )]
    PortLoop { name: String },
    /// The root fragment has no termination signal.
    #[error(
        "the root fragment has no out port `outTerminate`; add one that becomes true when the net \
         shall end, such as `c=Cancel(),outTerminate=c.outCancel`"
    )]
    NoTerminate,
    /// There is no such device, or it is of another kind.
    #[error("there is no {kind} `{name}`; available are {}", listed(.known))]
    Device {
        kind: &'static str,
        name: String,
        /// Devices of that kind.
        known: Vec<String>,
    },
    /// Two netcomm primitives that cannot share one key.
    #[error("netcomm value `{key}`: {why}")]
    Netcomm { key: String, why: &'static str },
}

fn did_you_mean(similar: &Option<String>) -> String {
    similar
        .as_ref()
        .map_or_else(String::new, |s| format!("; did you mean `{s}`?"))
}

fn similar_or_reach(similar: &Option<String>) -> String {
    if similar.is_some() {
        return did_you_mean(similar);
    }
    "; one inside another fragment is reached by that fragment's out port, one outside by \
     `parent` and an in port"
        .to_owned()
}

fn listed(known: &[String]) -> String {
    if known.is_empty() {
        return "none".to_owned();
    }
    let shown: Vec<String> = known.iter().take(12).map(|k| format!("`{k}`")).collect();
    let more = if known.len() > 12 { ", …" } else { "" };
    format!("{}{more}", shown.join(", "))
}

fn conversion(expected: &str, found: &str) -> &'static str {
    match (expected, found) {
        ("Core::double", "Core::int") => "; `Core::DoubleFromInt` converts",
        ("Core::int", "Core::double") => "; `Core::IntFromDouble` converts",
        _ => "",
    }
}

fn constant_hint(parameter: &Option<String>) -> String {
    parameter.as_ref().map_or_else(String::new, |p| {
        format!("; for a constant set parameter `{p}`")
    })
}

impl FaultKind {
    /// The minor number of `errorState` in the HTTP resource of a net, as existing clients know it.
    pub const fn minor(&self) -> u32 {
        match self {
            Self::UnknownPrimitive { .. } => 2,
            Self::Bound { .. } | Self::Cost { .. } => 3,
            Self::NoTerminate => 4,
            Self::UnknownParameter { .. } | Self::LinkForParameter { .. } => 5,
            Self::Parameter { .. }
            | Self::Arm { .. }
            | Self::NotConnected { .. }
            | Self::ArraySize(_)
            | Self::Netcomm { .. }
            | Self::Twice { .. } => 6,
            Self::Cycle { .. } | Self::PortLoop { .. } => 7,
            Self::UnknownInPort { .. } | Self::TextForPort { .. } => 8,
            Self::UnknownChild { .. } | Self::NoParent => 9,
            Self::UnknownOutPort { .. } => 10,
            Self::Type { .. } => 11,
            Self::Syntax { .. } => 12,
            Self::Device { .. } => 15,
        }
    }
}

impl Fault {
    /// A fault at one location.
    pub const fn new(kind: FaultKind, at: Range<usize>) -> Self {
        Self {
            kind,
            at,
            also: Vec::new(),
        }
    }

    /// Whether it is a syntax fault.
    pub(crate) const fn is_syntax(&self) -> bool {
        matches!(self.kind, FaultKind::Syntax { .. })
    }

    /// Line and column (both from 1, columns in characters) of the fault in `text`.
    pub fn location(&self, text: &str) -> (usize, usize) {
        excerpt::location(text, self.at.start)
    }
}

/// All faults of a rejected net.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejection {
    /// The faults in text order, at least one.
    pub faults: Vec<Fault>,
}

impl Rejection {
    /// The faults with an excerpt of `text` and carets below, without colour.
    pub fn render(&self, file: &str, text: &str) -> String {
        let mut out = String::new();
        for fault in &self.faults {
            let (line, column) = fault.location(text);
            let location = format!("{file}:{line}:{column}");
            out.push_str(&format!("Error: {}\n  --> {location}\n", fault.kind));
            excerpt::append(text, &fault.at, "", &mut out);
            for (at, note) in &fault.also {
                excerpt::append(text, at, note, &mut out);
            }
        }
        out
    }

    /// One line for each fault: `line:column: text`.
    pub fn lines(&self, text: &str) -> Vec<String> {
        let line = |fault: &Fault| {
            let (line, column) = fault.location(text);
            format!("{line}:{column}: {}", fault.kind)
        };
        self.faults.iter().map(line).collect()
    }
}

impl Rejection {
    /// What the cell has to decide, if only robot arms are not as the net needs them: then the faults may
    /// be those of arms that stand in for the ones of a cell.
    #[must_use]
    pub fn as_notes(&self) -> Option<Vec<Finding>> {
        let note = |fault: &Fault| {
            matches!(fault.kind, FaultKind::Arm { .. }).then(|| Finding {
                severity: Severity::Note,
                at: fault.at.clone(),
                text: "only its cell knows the joints, the limits and the geometry of this robot"
                    .to_owned(),
                hint: "check the net with the cell that has the robot: `--config cell.toml`"
                    .to_owned(),
            })
        };
        self.faults.iter().map(note).collect()
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, fault) in self.faults.iter().enumerate() {
            if i > 0 {
                f.write_str("; ")?;
            }
            write!(f, "{}", fault.kind)?;
        }
        Ok(())
    }
}

impl std::error::Error for Rejection {}

/// The name in `known` most similar to `name`, if any is similar enough.
pub fn similar<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Longer names and more candidates are no typing errors, and comparing them would take long.
    const LONGEST: usize = 100;
    const CANDIDATES: usize = 1000;
    if name.len() > LONGEST {
        return None;
    }
    let most = name.chars().count() / 3 + 1;
    known
        .into_iter()
        .take(CANDIDATES)
        .filter(|k| k.len().abs_diff(name.len()) <= 4 * most)
        .map(|k| (distance(name, k), k))
        .filter(|(d, _)| *d <= most)
        .min()
        .map(|(_, k)| k)
}

/// Levenshtein distance, ignoring case.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.to_lowercase().chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.to_lowercase().chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substitute = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substitute.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn location_counts_lines_and_characters() {
        let fault = Fault::new(FaultKind::NoParent, 6..8);
        assert_eq!(fault.location("abc\näöx"), (2, 2));
        assert_eq!(Fault::new(FaultKind::NoParent, 0..0).location(""), (1, 1));
    }

    #[test]
    fn similar_names_are_found() {
        let known = ["Core::DoubleAdd", "Core::IntAdd", "Core::Clock"];
        assert_eq!(similar("Core::DoubelAdd", known), Some("Core::DoubleAdd"));
        assert_eq!(similar("core::clock", known), Some("Core::Clock"));
        assert_eq!(similar("Elephant", known), None);
    }
}
