//! What the page shows and uses beyond the controller: the program that runs the server knows the host, and has the Robotics
//! API, on which this crate does not depend.

use std::fmt::Debug;

/// What of an arm a jog moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JogKind {
    /// Each joint, by velocities in rad/s: the in value `sent` is an array.
    Joints,
    /// The flange in the axes of the base, by velocities in m/s and rad/s: the in value `sent` is a twist.
    Flange,
}

/// The program that runs the server. Its calls may block; requests wait for them.
pub trait HostProgram: Debug + Send + Sync {
    /// The findings of the host check, one JSON object as of `takt doctor --json`.
    ///
    /// # Errors
    /// Why the host cannot be examined.
    fn findings(&self) -> Result<String, String>;

    /// The cells of its fleet, a JSON array as of `takt fleet list --json`, and the name of the own one: `{"own":"a","cells":[…]}`. `None`
    /// if the controller is in no fleet.
    ///
    /// # Errors
    /// Why they cannot be listed.
    fn cells(&self) -> Result<Option<String>, String>;

    /// The text of the net that jogs an arm: hold-to-run, so that the arm brakes when the last velocity is older than 0.1 s.
    /// `speed` is a part of the limits, above 0 to 1.
    ///
    /// # Errors
    /// Cause and hint.
    fn jog_net(&self, arm: &str, kind: JogKind, speed: f64) -> Result<String, String>;
}
