//! Errors of the Robotics API with what to do next, and whether the cell refused or the command was wrong.

use takt_api::{Error, ErrorKind};

/// The arm cannot follow, or the controller refused: nothing is wrong with the command line or the connection.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Refused(String);

impl Refused {
    /// With this text.
    pub(crate) fn new(text: &str) -> Self {
        Self(text.to_owned())
    }
}

/// An error with a remedy where there is one.
pub(crate) fn hinted(error: Error) -> anyhow::Error {
    // The line of the program is one of this tool, and says nothing to its user.
    let text = error.kind.to_string();
    let cause = text.split("\nhint: ").next().unwrap_or_default();
    // What the Robotics API advises is for programs.
    let is_own = matches!(
        error.kind,
        ErrorKind::Limit { .. } | ErrorKind::Unreachable { .. } | ErrorKind::Conflict { .. }
    );
    let with = |hint: &str| {
        if is_own {
            format!("{cause}\nhint: {hint}")
        } else if hint.is_empty() || text.contains("\nhint: ") {
            text.clone()
        } else {
            format!("{text}\nhint: {hint}")
        }
    };
    let state =
        "the page of the controller and the log of `takt run` name the state of each device";
    let hint = match &error.kind {
        ErrorKind::Limit { min, max, .. } => {
            let (min, max) = (min.to_degrees(), max.to_degrees());
            format!("its range is {min:.1}deg to {max:.1}deg")
        }
        ErrorKind::Unreachable { .. } => {
            "name a nearer pose, or begin in another configuration: `takt move ARM ptp`".to_owned()
        }
        ErrorKind::Unplanned { .. } => "move its joints: `takt move ARM ptp`".to_owned(),
        ErrorKind::Rejected(_)
        | ErrorKind::Refused(_)
        | ErrorKind::DeviceFailed { .. }
        | ErrorKind::PredecessorFailed(_)
        | ErrorKind::Ended { .. } => state.to_owned(),
        ErrorKind::Invalid(_) => {
            return anyhow::anyhow!(with("`--help` lists all arguments"));
        }
        ErrorKind::Lost(_) => {
            return anyhow::anyhow!(with("the controller brakes what this command moved"));
        }
        ErrorKind::Connection(_) | ErrorKind::Version { .. } => return anyhow::anyhow!(text),
        ErrorKind::NoDevice { .. } | ErrorKind::TooFast { .. } | _ => String::new(),
    };
    Refused(with(&hint)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_follow_the_cause_once() {
        let limit = hinted(
            ErrorKind::Limit {
                joint: "left joint 1".to_owned(),
                value: 3.0,
                min: -2.0,
                max: 2.0,
            }
            .into(),
        );
        assert!(limit.is::<Refused>());
        let text = limit.to_string();
        assert!(
            text.ends_with("hint: its range is -114.6deg to 114.6deg"),
            "{text}"
        );
        let failed = ErrorKind::DeviceFailed {
            device: "left".to_owned(),
            cause: "offline\nhint: wait".to_owned(),
        };
        assert_eq!(
            hinted(failed.into()).to_string(),
            "left: offline\nhint: wait"
        );
        assert!(!hinted(ErrorKind::Invalid("no".to_owned()).into()).is::<Refused>());
        assert!(!hinted(ErrorKind::Lost("gone".to_owned()).into()).is::<Refused>());
    }
}
