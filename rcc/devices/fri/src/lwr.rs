//! The KUKA LWR on a KRC2 lr: description and start of its driver. The driver is in `fri`, its session in `end`, the
//! protocol in `takt_fri::lwr`.

mod end;
mod impedance;
mod program;

use takt_fri::client::Version;
use takt_fri::linux::UdpLink;
use takt_fri::lwr::wire::Quality;
use takt_net::JointLimits;

use crate::config::LwrConfig;
use crate::fri::{self, AXES, FriArm, FriFigures, Settings};
use crate::kinematics;
use crate::payload::Weight;
use takt_core::Error;
use takt_core::device::driver::DriverEnds;
use takt_core::device::parts::with_figures;
use takt_core::device::{ArmDescription, Part};

pub use end::End;

/// A running driver of an LWR.
pub type Lwr = FriArm<End>;
/// Figures of a driver of an LWR.
pub type LwrFigures = FriFigures<Quality>;

/// Largest joint torques by the data sheet of the LWR 4+, Nm; more is not added.
const TORQUE_MAX: [f64; AXES] = [176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0];

/// Largest force and torque added at the tool, in wire order, N and Nm. Errors of a unit lie beyond: the main axes
/// hold 350 N at half a metre, the first wrist axis 100 Nm.
const WRENCH_MAX: [f64; 6] = [350.0, 350.0, 350.0, 100.0, 100.0, 100.0];

/// An LWR by its controller: axis ranges, and the speed and acceleration that existing drivers use for all axes.
#[must_use]
pub fn describe(name: &str) -> ArmDescription {
    let limits = Version::Lwr.position_max_rad().map(|range| JointLimits {
        position_min: -range,
        position_max: range,
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

/// An LWR as its configuration has it: with the kinematics and the narrower limits of its URDF, if there is one.
#[must_use]
pub fn describe_config(config: &LwrConfig) -> ArmDescription {
    kinematics::with_kinematics(describe(&config.name), &config.kinematics)
}

/// Parts of an LWR besides its joints. Its inputs and outputs are the FRI user data: port n is KRL index n + 1,
/// inputs are `$FRI_TO_BOOL` and `$FRI_TO_REA` as the program writes them, outputs are `$FRI_FRM_BOOL` and
/// `$FRI_FRM_REA` as it reads them.
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

/// These parts, and the figures of the connection.
#[must_use]
pub fn parts() -> Vec<Part> {
    with_figures(PARTS, fri::figures::<End>())
}

/// Checks a configuration.
///
/// # Errors
/// With a text that names what to change.
pub fn check(config: &LwrConfig) -> Result<(), String> {
    let checked = config.on_end.check(16, 16);
    let arm = describe(&config.name);
    let checked = checked.and_then(|()| kinematics::check(&arm, &config.kinematics));
    checked.map_err(|what| format!("{}: {what}", config.name))
}

/// Opens the socket for the KRC's datagrams.
///
/// # Errors
/// If the address cannot be bound.
pub fn listen(config: &LwrConfig) -> Result<UdpLink, Error> {
    fri::listen(&config.name, config.listen)
}

impl Lwr {
    /// Starts the driver thread. On the clock that it publishes, zero and every whole period is the instant of a
    /// measurement.
    ///
    /// # Errors
    /// If the socket has no address or the thread cannot be created.
    pub fn start(config: &LwrConfig, link: UdpLink, ends: DriverEnds) -> Result<Self, Error> {
        let settings = Settings {
            listen: config.listen,
            priority: config.priority,
            cpus: config.cpus.clone(),
        };
        let description = describe_config(config).with(&parts());
        let weight = Weight::new(&description.model, &config.payload, &config.down);
        let end = End::new(config.handshake)
            .on_end(config.on_end.clone())
            .within(&description.limits)
            .carrying(weight);
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
