//! What can go wrong with an activity, as values that a program can match. Texts give the cause first, with the
//! line of the program, then a hint.

use std::fmt;
use std::panic::Location;

/// An error, with the line of the program that it concerns: that of the call, and for an activity that runs that of its
/// `begin`, `queue` or `run`. Programs match [`Self::kind`].
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::error_impl_error, reason = "the one error type of the crate")]
pub struct Error {
    /// What is wrong.
    pub kind: ErrorKind,
    /// The line of the program.
    pub place: &'static Location<'static>,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (text, place) = (self.kind.to_string(), self.place);
        let (cause, hint) = text.split_once('\n').unwrap_or((&text, ""));
        write!(f, "{cause} (at {}:{})", place.file(), place.line())?;
        if hint.is_empty() {
            return Ok(());
        }
        write!(f, "\n{hint}")
    }
}

impl std::error::Error for Error {}

// `?` and `into` pass the caller on, so that the place is that of the program in each function with `#[track_caller]`.
impl From<ErrorKind> for Error {
    #[track_caller]
    fn from(kind: ErrorKind) -> Self {
        let place = Location::caller();
        Self { kind, place }
    }
}

impl From<takt_client::Error> for Error {
    #[track_caller]
    fn from(error: takt_client::Error) -> Self {
        ErrorKind::from(error).into()
    }
}

/// Why something was not begun, or did not end as requested. Positions are in rad.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The controller cannot be reached.
    #[error("{0}")]
    Connection(String),
    /// The controller does not speak this version of the line protocol.
    #[error(
        "the controller at {address} is of another version: {reason}\nhint: use a program and a controller of one version"
    )]
    Version {
        /// Where it is.
        address: String,
        /// Its reply.
        reason: String,
    },
    /// The connection ended; the controller cancels what this program began.
    #[error("the connection to the controller is lost: {0}")]
    Lost(String),
    /// An argument is out of its bounds; nothing was begun.
    #[error("{0}")]
    Invalid(String),
    /// A joint position is out of its range; nothing was begun.
    #[error(
        "{joint}: {value:.4} rad is out of its range, {min:.4} to {max:.4} rad\nhint: positions are in rad; `deg` converts \
         degrees"
    )]
    Limit {
        /// Arm and joint.
        joint: String,
        /// The position.
        value: f64,
        /// The range begins here.
        min: f64,
        /// The range ends here.
        max: f64,
    },
    /// The controller has no such device, or the device has no such interface.
    #[error("there is no {wanted} `{name}`\nhint: the controller has {known}")]
    NoDevice {
        /// Kind of device.
        wanted: &'static str,
        /// The name.
        name: String,
        /// Names of the devices of this kind.
        known: String,
    },
    /// The device has no such input or output; nothing was begun.
    #[error("{device}: there is no {wanted} {port}\nhint: ports count from 0; it has {known}")]
    NoPort {
        /// The device.
        device: String,
        /// Kind of port.
        wanted: &'static str,
        /// Its number.
        port: u32,
        /// How many ports of each kind the device has.
        known: String,
    },
    /// The pose of one frame in the other changes with motions, or is not known; nothing was begun.
    #[error(
        "the frames `{}` and `{}` are not connected: they are placed in `{}` and `{}`\nhint: `[[frame]]` and `[[base]]` of \
         the cell file place frames and devices in `world`", .frames[0].0, .frames[1].0, .frames[0].1, .frames[1].1
    )]
    NotConnected {
        /// Name of each frame, and of the frame in which it is placed in the end.
        frames: Box<[(String, String); 2]>,
    },
    /// The controller rejected the net of an activity.
    #[error("the controller rejected the net: {}", .0.join("; "))]
    Rejected(Vec<String>),
    /// The controller refused a command or a rule, with its reason.
    #[error("{0}")]
    Refused(String),
    /// A device is commanded by another program or net, which goes on.
    #[error(
        "{device}{}: {} commands it\nhint: `takt net list` shows the nets that run; end the one that commands the device, or \
         wait for its end",
        .joint.map_or_else(String::new, |joint| format!(" joint {joint}")),
        .holder.as_deref().unwrap_or("another net")
    )]
    Conflict {
        /// The device.
        device: String,
        /// The joint, where the device is an arm and the joint is known. Joints count from 0.
        joint: Option<usize>,
        /// The net that commands it, with its session and program, as far as known.
        holder: Option<String>,
    },
    /// The path leaves the reach of the arm, or the range of a joint.
    #[error(
        "{device}: the arm cannot follow the path at {progress:.0} % of the motion: {cause}\nhint: give a nearer pose, or begin \
         with other joint positions"
    )]
    Unreachable {
        /// The arm.
        device: String,
        /// Part of the path, in percent.
        progress: f64,
        /// What is wrong there.
        cause: String,
    },
    /// A joint would be too fast on the path; nothing was begun.
    #[error(
        "{device}: joint {joint} would move at {velocity:.3} rad/s at {progress:.0} % of the motion, its limit is \
         {limit:.3} rad/s\nhint: the path fits at the speed {speed:.3}"
    )]
    TooFast {
        /// The arm.
        device: String,
        /// Number of the joint, from 0.
        joint: usize,
        /// Part of the path, in percent.
        progress: f64,
        /// Its velocity there, rad/s.
        velocity: f64,
        /// Its limit, rad/s.
        limit: f64,
        /// Largest speed of the activity, as part of the limits, at which all joints keep their limits.
        speed: f64,
    },
    /// The device has no such ability; nothing was begun, or it refused.
    #[error("{device}: {wanted} is not supported: {cause}")]
    Unsupported {
        /// The device.
        device: String,
        /// The ability.
        wanted: &'static str,
        /// The cause.
        cause: String,
    },
    /// An arm under force has moved as far as it may: there was no contact, or what it touched gave way. It is at rest.
    #[error(
        "{device}: a force of {force} N is not reached within {travel} m\nhint: begin nearer to the object, or permit more \
         `travel`"
    )]
    ForceNotReached {
        /// The arm.
        device: String,
        /// The wanted force, N.
        force: f64,
        /// Longest way along its direction, m.
        travel: f64,
    },
    /// What an arm pressed against is there no more; the arm is at rest.
    #[error(
        "{device}: the contact is lost\nhint: a condition such as `force.under(2.0).after(force.over(10.0))` of `until` makes \
         that an outcome"
    )]
    ContactLost {
        /// The arm.
        device: String,
    },
    /// The force at the tool of an arm is larger than it may be; the arm is at rest.
    #[error(
        "{device}: the force at its tool exceeds {limit} N\nhint: approach more slowly, or permit more by `force_max`"
    )]
    ForceExceeded {
        /// The arm.
        device: String,
        /// The largest force, N.
        limit: f64,
    },
    /// A measured position is further from the trajectory, or from its goal, than the tolerance permits; the arm is at rest.
    #[error(
        "{device}: joint {joint} is {deviation:.4} rad from the {place}, more than its tolerance\nhint: see its following error in \
         `takt scope`; a slower trajectory, or another tolerance, may do"
    )]
    Deviation {
        /// The arm.
        device: String,
        /// `path`, or `goal` at the end.
        place: &'static str,
        /// Number of the joint, from 0.
        joint: usize,
        /// Its deviation, rad.
        deviation: f64,
    },
    /// A motion cannot be planned by the program.
    #[error("{device}: the motion cannot be planned: {cause}")]
    Unplanned {
        /// The device.
        device: String,
        /// The cause.
        cause: String,
    },
    /// The device does not follow its commands.
    #[error("{device}: {cause}")]
    DeviceFailed {
        /// The device.
        device: String,
        /// The cause.
        cause: String,
    },
    /// What was to run before ended with an error; nothing was begun.
    #[error("not begun, since the activity before it failed: {0}")]
    PredecessorFailed(Box<Self>),
    /// An activity that was prepared no longer fits: the arm is elsewhere, or its net was unloaded. Nothing was begun.
    #[error("{device}: the prepared activity no longer fits: {cause}\nhint: prepare it again")]
    Stale {
        /// The device.
        device: String,
        /// What has changed.
        cause: String,
    },
    /// A callback of the program failed; what it listened to has ended.
    #[error(
        "the callback failed: {0}\nhint: the controller goes on; listen again when the callback is repaired"
    )]
    Callback(String),
    /// The net ended without a result.
    #[error("{device}: the motion ended without a result: {reason}")]
    Ended {
        /// The device.
        device: String,
        /// The reason that the controller gives.
        reason: String,
    },
}

impl ErrorKind {
    /// A number of an argument is NaN or infinite.
    pub(crate) fn not_finite(device: &str, what: &str) -> Self {
        Self::Invalid(format!(
            "{device}: {what} is not finite\nhint: one of its numbers is NaN or infinite; check what it is calculated from"
        ))
    }

    /// Both are too fast: the speed fits both.
    pub(crate) const fn slow_down(&mut self, other: &Self) {
        if let (Self::TooFast { speed, .. }, Self::TooFast { speed: slower, .. }) = (self, other) {
            *speed = speed.min(*slower);
        }
    }

    /// A prepared activity no longer fits.
    pub(crate) fn stale(device: &str, cause: &str) -> Self {
        let [device, cause] = [device, cause].map(str::to_owned);
        Self::Stale { device, cause }
    }

    /// There is no such device; `known` are those of its kind.
    pub(crate) fn no_device(wanted: &'static str, name: &str, known: Vec<String>) -> Self {
        Self::NoDevice {
            wanted,
            name: name.to_owned(),
            known: if known.is_empty() {
                "none".to_owned()
            } else {
                known.join(", ")
            },
        }
    }
}

impl ErrorKind {
    /// What the controller refused: a conflict if it names what holds a resource.
    pub(crate) fn refused(text: &str) -> Self {
        let of_rule = || {
            let (before, after) =
                text.split_once(" cannot be reserved for the nets to be started: ")?;
            let (holder, _) = after.split_once(" holds it or waits for it")?;
            Some((before, holder))
        };
        let of_firing = || {
            let (holder, resource) = text.rsplit_once(" holds ")?;
            (holder.starts_with("net ") || holder == "another net").then_some((resource, holder))
        };
        let Some((resource, holder)) = of_rule().or_else(of_firing) else {
            return Self::Refused(text.to_owned());
        };
        // The kind of the refusal precedes its reason.
        let resource = resource.rsplit(": ").next().unwrap_or(resource);
        let is_known = holder != "another net";
        Self::conflict(resource, is_known.then(|| holder.to_owned()))
    }

    /// Another net holds a resource, such as `left_Joint_3` or `platform_Base`.
    pub(crate) fn conflict(resource: &str, holder: Option<String>) -> Self {
        let (device, part) = resource.split_once("_Joint_").map_or_else(
            || {
                (
                    resource
                        .rsplit_once('_')
                        .map_or(resource, |(device, _)| device),
                    None,
                )
            },
            |(device, joint)| (device, joint.parse().ok()),
        );
        Self::Conflict {
            device: device.to_owned(),
            joint: part,
            holder: holder.map(|holder| holder.replace('`', "")),
        }
    }
}

impl From<takt_client::Error> for ErrorKind {
    fn from(error: takt_client::Error) -> Self {
        use takt_client::Error as Client;
        let text = error.to_string();
        if let Client::Refused { text, conflict, .. } = error {
            let of = |it: takt_client::Conflict| Self::conflict(&it.resource, it.holder);
            // Controllers of older versions have it in the text only.
            return conflict.map_or_else(|| Self::refused(&text), of);
        }
        let is_lost = matches!(
            error,
            Client::Closed { .. } | Client::Connection { .. } | Client::Unread { .. }
        );
        if is_lost && text.contains("\nhint: ") {
            Self::Lost(text)
        } else if is_lost {
            Self::Lost(format!(
                "{text}\nhint: the controller brakes what this program moved; connect again"
            ))
        } else {
            Self::Connection(text)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conflict_names_device_joint_and_holder() {
        let text = |resource, holder: Option<&str>| {
            let text = ErrorKind::conflict(resource, holder.map(str::to_owned)).to_string();
            text.lines().next().unwrap_or_default().to_owned()
        };
        let holder = Some("net rpinet3 of session s2 (`paint.py, process 7`)");
        assert_eq!(
            text("left_arm_Joint_3", holder),
            "left_arm joint 3: net rpinet3 of session s2 (paint.py, process 7) commands it"
        );
        assert_eq!(
            text("platform_Base", None),
            "platform: another net commands it"
        );
    }

    /// The wording of the controller: `Error::NotSchedulable`, and why a rule could not start its nets.
    #[test]
    fn refusal_that_names_a_holder_is_a_conflict() {
        let held = "scheduling not possible: left_Joint_2 cannot be reserved for the nets to be started: net rpinet3 of \
                    session s1 (`jog.py, process 7`) holds it or waits for it, and the rule does not follow that net";
        let fired = "net rpinet3 of session s1 (`jog.py, process 7`) holds left_Joint_2";
        for text in [held, fired] {
            let expected = ErrorKind::Conflict {
                device: "left".to_owned(),
                joint: Some(2),
                holder: Some("net rpinet3 of session s1 (jog.py, process 7)".to_owned()),
            };
            assert_eq!(ErrorKind::refused(text), expected);
        }
        let other = "device `left` does not follow commands";
        assert_eq!(
            ErrorKind::refused(other),
            ErrorKind::Refused(other.to_owned())
        );
        // The fields of the controller are preferred to its text.
        for (resource, text) in [
            ("left_Joint_2", held),
            ("left_Joint_2", "what a later version says"),
        ] {
            let refused = takt_client::Error::Refused {
                command: "nesc".to_owned(),
                text: text.to_owned(),
                conflict: Some(takt_client::Conflict {
                    resource: resource.to_owned(),
                    holder: Some("net rpinet3 of session s1 (`jog.py, process 7`)".to_owned()),
                }),
            };
            assert_eq!(
                ErrorKind::from(refused),
                ErrorKind::refused(fired),
                "{text}"
            );
        }
        let without = takt_client::Error::Refused {
            command: "nesc".to_owned(),
            text: held.to_owned(),
            conflict: None,
        };
        assert_eq!(ErrorKind::from(without), ErrorKind::refused(fired));
        let unknown = ErrorKind::refused("another net holds platform_Base");
        assert!(
            matches!(&unknown, ErrorKind::Conflict { holder: None, device, .. } if device == "platform"),
            "{unknown}"
        );
    }
}
