//! The KUKA LBR iiwa on a Sunrise cabinet: description and start of its driver. The driver is in `fri`, its session
//! in `end`, the protocol in `takt_fri::sunrise`. The robot program selects control and command mode; this driver
//! cannot switch them.

mod end;
mod refusals;

use takt_fri::client::Version;
use takt_fri::linux::UdpLink;
use takt_fri::sunrise::wire::Quality;
use takt_net::JointLimits;

use crate::config::{IiwaConfig, IiwaIo, IiwaModel};
use crate::fri::{self, AXES, FriArm, FriFigures, Settings};
use crate::kinematics;
use crate::payload::Weight;
use takt_core::Error;
use takt_core::device::driver::DriverEnds;
use takt_core::device::parts::with_figures;
use takt_core::device::{ArmDescription, Part};

pub use end::End;

/// A running driver of an iiwa.
pub type Iiwa = FriArm<End>;
/// Figures of a driver of an iiwa.
pub type IiwaFigures = FriFigures<Quality>;

/// Share of the data sheet's speeds that is used: the controller ends the overlay at the exact limit, and
/// interpolation may exceed ours slightly.
const SPEED_SHARE: f64 = 0.99;
/// No acceleration limit is published for commanded positions; conservative drivers use this one, rad/s².
const ACCELERATION: f64 = 4.0;
/// Most inputs and outputs of one message.
const IOS_MAX: usize = takt_fri::sunrise::wire::IOS_MAX;
/// Longest name of an input or output, bytes.
const IO_NAME_MAX: usize = 63;

/// Parts of an iiwa besides its joints. FRI 2.7 reports the force at the tool; for older versions the driver
/// estimates it from external torques. Its figures are those of the connection.
#[must_use]
pub fn parts(io: &IiwaIo) -> Vec<Part> {
    let mut parts = vec![
        Part::Strategy,
        Part::JointImpedance,
        Part::CartesianImpedance,
        Part::Torques,
        Part::Wrench,
    ];
    if *io != IiwaIo::default() {
        parts.push(Part::Io {
            bool_in: io.bool_in.len(),
            bool_out: io.bool_out.len(),
            real_in: io.real_in.len(),
            real_out: io.real_out.len(),
        });
    }
    with_figures(&parts, fri::figures::<End>())
}

/// Checks a configuration.
///
/// # Errors
/// With a text that names what to change.
pub fn check(config: &IiwaConfig) -> Result<(), String> {
    let IiwaIo {
        bool_in,
        bool_out,
        real_in,
        real_out,
    } = &config.io;
    let names: Vec<_> = [bool_in, bool_out, real_in, real_out]
        .into_iter()
        .flatten()
        .collect();
    let name = &config.name;
    if names.len() > IOS_MAX {
        let found = names.len();
        return Err(format!(
            "{name}: io names {found} inputs and outputs; FRI carries {IOS_MAX} at most"
        ));
    }
    match names
        .iter()
        .find(|io| io.is_empty() || io.len() > IO_NAME_MAX)
    {
        Some(bad) => Err(format!(
            "{name}: io `{bad}` must be `Group.Name` of at most {IO_NAME_MAX} bytes"
        )),
        None => {
            let checked = config.on_end.check(bool_out.len(), real_out.len());
            let arm = describe(name, config.model);
            let checked = checked.and_then(|()| kinematics::check(&arm, &config.kinematics));
            checked.map_err(|what| format!("{name}: {what}"))
        }
    }
}

/// Largest joint torques by the data sheets, Nm; more is not added.
const fn torque_max(model: IiwaModel) -> [f64; AXES] {
    match model {
        IiwaModel::Iiwa7 => [176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0],
        IiwaModel::Iiwa14 => [320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0],
    }
}

/// Largest force and torque added at the tool, in wire order, N and Nm. Errors of a unit lie beyond: the main axes
/// hold that force at half a metre, the first wrist axis that torque.
const fn wrench_max(model: IiwaModel) -> [f64; 6] {
    let force = match model {
        IiwaModel::Iiwa7 => 350.0,
        IiwaModel::Iiwa14 => 640.0,
    };
    [force, force, force, 110.0, 110.0, 110.0]
}

/// An iiwa by its data sheet: axis ranges and speeds.
#[must_use]
pub fn describe(name: &str, model: IiwaModel) -> ArmDescription {
    let (kinematics, speeds) = match model {
        IiwaModel::Iiwa7 => (
            "kuka_iiwa7",
            [98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0_f64],
        ),
        IiwaModel::Iiwa14 => (
            "kuka_iiwa14",
            [85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0_f64],
        ),
    };
    let ranges = Version::Sunrise(None).position_max_rad();
    let limits = ranges.into_iter().zip(speeds);
    let limits = limits.map(|(range, speed)| JointLimits {
        position_min: -range,
        position_max: range,
        velocity_max: speed.to_radians() * SPEED_SHARE,
        acceleration_max: ACCELERATION,
    });
    ArmDescription {
        name: name.to_owned(),
        kind: "kuka_iiwa_fri",
        limits: limits.collect(),
        model: kinematics.into(),
    }
}

/// An iiwa as its configuration has it: with the kinematics and the narrower limits of its URDF, if there is one.
#[must_use]
pub fn describe_config(config: &IiwaConfig) -> ArmDescription {
    kinematics::with_kinematics(describe(&config.name, config.model), &config.kinematics)
}

/// Opens the socket for the cabinet's datagrams.
///
/// # Errors
/// If the address cannot be bound.
pub fn listen(config: &IiwaConfig) -> Result<UdpLink, Error> {
    fri::listen(&config.name, config.listen)
}

impl Iiwa {
    /// Starts the driver thread. On the clock that it publishes, zero and every whole period is the instant of a
    /// measurement. The dialect is detected from the first datagrams.
    ///
    /// # Errors
    /// If the socket has no address or the thread cannot be created.
    pub fn start(config: &IiwaConfig, link: UdpLink, ends: DriverEnds) -> Result<Self, Error> {
        let settings = Settings {
            listen: config.listen,
            priority: config.priority,
            cpus: config.cpus.clone(),
        };
        let description = describe_config(config).with(&parts(&config.io));
        let weight = Weight::new(&description.model, &config.payload, &config.down);
        let end = End::new(config.model, config.io.clone())
            .on_end(config.on_end.clone())
            .within(&description.limits)
            .carrying(weight);
        Self::launch(end, description, settings, link, ends)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iiwa_models_differ_in_speed_and_kinematics() {
        let [light, heavy] = [IiwaModel::Iiwa7, IiwaModel::Iiwa14].map(|m| describe("a", m));
        assert!(light.limits[3].velocity_max > 1.5 * heavy.limits[3].velocity_max);
        for arm in [light, heavy] {
            assert!(arm.model.unlimited().is_some());
        }
    }

    #[test]
    fn iiwa_too_many_signals_are_rejected_with_bound() {
        let anywhere = ([127, 0, 0, 1], 0).into();
        let with = |bool_in: Vec<String>| IiwaConfig {
            io: IiwaIo {
                bool_in,
                ..IiwaIo::default()
            },
            ..IiwaConfig::new("arm", anywhere)
        };
        let names = |count: usize| (0..count).map(|i| format!("Group.Lamp{i}")).collect();
        assert_eq!(check(&with(names(10))), Ok(()));
        let error = check(&with(names(11))).unwrap_err();
        assert!(
            error.contains("11 inputs and outputs; FRI carries 10"),
            "{error}"
        );
        let error = check(&with(vec!["x".repeat(64)])).unwrap_err();
        assert!(error.contains("at most 63 bytes"), "{error}");
    }
}
