//! A KUKA LWR on a KRC2 lr: what it is like, and how its driver is started. The driver is in `fri`, its end of the
//! connection in `end`, the protocol in `takt_fri::lwr`.

mod end;
mod impedance;
mod program;

use takt_fri::linux::UdpLink;
use takt_fri::lwr::wire::Quality;
use takt_net::JointLimits;

use crate::device::config::LwrConfig;
use crate::device::driver::DriverEnds;
use crate::device::fri::{self, AXES, FriArm, FriFigures, Settings};
use crate::device::{ArmDescription, Part};
use crate::error::Error;

pub use end::End;

/// A running driver of an LWR.
pub type Lwr = FriArm<End>;
/// Figures of a driver of an LWR.
pub type LwrFigures = FriFigures<Quality>;

/// Largest torque of each joint by the data sheet of the LWR 4+, Nm; more is not added.
const TORQUE_MAX: [f64; AXES] = [176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0];

/// Largest force and torque added at the tool, in the wire's order, N and Nm. A slip of a unit is beyond: the main axes
/// hold 350 N half a metre out, the first axis of the wrist 100 Nm.
const WRENCH_MAX: [f64; 6] = [350.0, 350.0, 350.0, 100.0, 100.0, 100.0];

/// An LWR as its controller describes it: ranges of the axes, and the speed and acceleration that
/// existing drivers use for all of them.
#[must_use]
pub fn describe(name: &str) -> ArmDescription {
    let ranges = [170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 170.0_f64];
    let limits = ranges.map(|range| JointLimits {
        position_min: -range.to_radians(),
        position_max: range.to_radians(),
        velocity_max: 112.5_f64.to_radians(),
        acceleration_max: 4.0,
    });
    ArmDescription {
        name: name.to_owned(),
        kind: "kuka_lwr_fri",
        limits: limits.to_vec(),
        model: "kuka_lwr4".into(),
    }
}

/// What an LWR offers beside its joints. Its inputs and outputs are the user data of FRI: port n is KRL's index
/// n + 1, an input what the program writes to `$FRI_TO_BOOL` or `$FRI_TO_REA`, an output what it finds in
/// `$FRI_FRM_BOOL` or `$FRI_FRM_REA`.
pub const PARTS: &[Part] = &[
    Part::Tool,
    Part::Strategy,
    Part::JointImpedance,
    Part::CartesianImpedance,
    Part::Torques,
    Part::Wrench,
    Part::Io {
        bool_in: 16,
        bool_out: 16,
        real_in: 16,
        real_out: 16,
    },
];

/// Whether its settings make sense; the first thing that does not.
///
/// # Errors
/// Says what to change.
pub fn check(config: &LwrConfig) -> Result<(), String> {
    let checked = config.on_end.check(16, 16);
    checked.map_err(|what| format!("{}: {what}", config.name))
}

/// Opens the socket at which the KRC's datagrams arrive.
///
/// # Errors
/// If the address cannot be listened at.
pub fn listen(config: &LwrConfig) -> Result<UdpLink, Error> {
    fri::listen(&config.name, config.listen)
}

impl Lwr {
    /// Starts the driver thread. On the clock that it tells, zero and every whole period is the instant of
    /// a measurement.
    ///
    /// # Errors
    /// If the socket has no address or the system has no thread to give.
    pub fn start(config: &LwrConfig, link: UdpLink, ends: DriverEnds) -> Result<Self, Error> {
        let settings = Settings {
            listen: config.listen,
            priority: config.priority,
            cpus: config.cpus.clone(),
        };
        let description = describe(&config.name).with(PARTS);
        let end = End::new(config.handshake).on_end(config.on_end.clone());
        Self::launch(end, description, settings, link, ends)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the wire has single precision"
)]
const fn to_f32(value: f64) -> f32 {
    value as f32
}
