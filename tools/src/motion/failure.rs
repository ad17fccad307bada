//! Errors of the Robotics API with what to do next, and whether the cell refused or the command was wrong.

use takt_api::Error;

/// The arm cannot follow, or the controller refused: nothing is wrong with the command line or the connection.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Refused(String);

/// An error with a remedy where there is one.
pub(super) fn hinted(error: Error) -> anyhow::Error {
    let text = error.to_string();
    let with = |hint: &str| {
        if hint.is_empty() || text.contains("\nhint: ") {
            text.clone()
        } else {
            format!("{text}\nhint: {hint}")
        }
    };
    let state =
        "the page of the controller and the log of `takt run` name the state of each device";
    let hint = match &error {
        Error::Limit { min, max, .. } => {
            let (min, max) = (min.to_degrees(), max.to_degrees());
            format!("its range is {min:.1}deg to {max:.1}deg")
        }
        Error::Unreachable { .. } => {
            "name a nearer pose, or begin in another configuration: `takt move ARM ptp`".to_owned()
        }
        Error::Conflict { .. } => {
            "`takt net list` shows the nets that run; cancel the one that commands the arm"
                .to_owned()
        }
        Error::Unplanned { .. } => "move its joints: `takt move ARM ptp`".to_owned(),
        Error::Rejected(_)
        | Error::Refused(_)
        | Error::DeviceFailed { .. }
        | Error::PredecessorFailed(_)
        | Error::Ended { .. } => state.to_owned(),
        Error::Invalid(_) => {
            return anyhow::anyhow!(with("`takt help move` lists all arguments"));
        }
        Error::Lost(_) => {
            return anyhow::anyhow!(with("the controller brakes what this command moved"));
        }
        Error::Connection(_) | Error::Version { .. } => return error.into(),
        Error::NoDevice { .. } | Error::TooFast { .. } | _ => String::new(),
    };
    Refused(with(&hint)).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_follow_the_cause_once() {
        let limit = hinted(Error::Limit {
            joint: "left joint 1".to_owned(),
            value: 3.0,
            min: -2.0,
            max: 2.0,
        });
        assert!(limit.is::<Refused>());
        let text = limit.to_string();
        assert!(
            text.ends_with("hint: its range is -114.6deg to 114.6deg"),
            "{text}"
        );
        let failed = Error::DeviceFailed {
            device: "left".to_owned(),
            cause: "offline\nhint: wait".to_owned(),
        };
        assert_eq!(hinted(failed).to_string(), "left: offline\nhint: wait");
        assert!(!hinted(Error::Invalid("no".to_owned())).is::<Refused>());
        assert!(!hinted(Error::Lost("gone".to_owned())).is::<Refused>());
    }
}
