//! Simulated devices that programs create at run time. The net thread steps them, so they need no thread, no wire and
//! no clock. They simulate what nets see; physics only as each file documents.

mod arm;
mod base;
mod compliance;
mod config;
mod gripper;
mod io;
mod parameters;
mod servo_gripper;
mod sheet;
mod simulated;

use std::collections::BTreeMap;

use crate::error::Error;
pub use config::ArmSimConfig;
use parameters::Parameters;
use simulated::seconds;
pub use simulated::{Made, Simulated};

type Make = fn(&Parameters<'_>, &'static str) -> Result<Made, Error>;

/// Type of a simulated arm of any model.
pub const ARM: &str = "arm_sim";

/// Constructors by type.
const KINDS: [(&str, Make); 8] = [
    (ARM, arm::any),
    ("kuka_lwr_sim", arm::lwr),
    ("kuka_iiwa_sim", arm::iiwa),
    ("kuka_youbot_arm_sim", arm::youbot),
    ("kuka_youbot_base_sim", base::youbot),
    ("kuka_youbot_gripper_sim", gripper::youbot),
    ("schunk_wsg_sim", servo_gripper::wsg),
    ("io_sim", io::looped),
];

/// The device types that can be created at run time.
#[must_use]
pub fn kinds() -> Vec<&'static str> {
    KINDS.iter().map(|(kind, _)| *kind).collect()
}

/// Creates a simulated device of one of [`kinds`]. Unknown parameters are ignored: known clients send the same ones
/// to real devices.
///
/// # Errors
/// If there is no such type, or a parameter is missing, unreadable or out of range.
pub fn make(name: &str, kind: &str, parameters: &BTreeMap<String, String>) -> Result<Made, Error> {
    let parameters = Parameters {
        name,
        texts: parameters,
    };
    let Some((kind, make)) = KINDS.iter().find(|(known, _)| *known == kind) else {
        let known = kinds().join(", ");
        let what = format!("there is no type `{kind}`; there are {known}");
        return Err(parameters.wrong(what));
    };
    make(&parameters, kind)
}

#[cfg(test)]
mod limit_tests;

#[cfg(test)]
mod tests {
    use super::*;

    fn sound(kind: &str) -> BTreeMap<String, String> {
        let joints = if kind == "kuka_youbot_arm_sim" { 5 } else { 7 };
        let list = |value: f64| format!("{:?}", vec![value; joints]);
        let of_arm = [
            ("min_joint", -2.0),
            ("max_joint", 2.0),
            ("max_vel", 2.0),
            ("max_acc", 4.0),
            ("home_joint", 0.0),
            ("external_torque", 1.0),
        ];
        let of_base = ["max_vel", "max_rot_vel", "max_acc", "max_rot_acc"];
        let of_gripper = ["max_distance", "max_vel"];
        let scalar = |key: &&str| ((*key).to_owned(), "0.5".to_owned());
        match kind {
            "kuka_youbot_base_sim" => of_base.iter().map(scalar).collect(),
            "kuka_youbot_gripper_sim" => of_gripper.iter().map(scalar).collect(),
            "schunk_wsg_sim" => ["stroke", "part"].iter().map(scalar).collect(),
            "io_sim" => BTreeMap::new(),
            ARM => {
                let model = [("model".to_owned(), "kuka_iiwa7".to_owned())];
                let lists = of_arm.map(|(key, v)| (key.to_owned(), list(v)));
                lists.into_iter().chain(model).collect()
            }
            _ => of_arm.map(|(key, v)| (key.to_owned(), list(v))).into(),
        }
    }

    #[test]
    fn sim_parameters_not_finite_or_huge_are_rejected() {
        for kind in kinds() {
            let parameters = sound(kind);
            assert!(make("a", kind, &parameters).is_ok(), "{kind}");
            for (key, text) in &parameters {
                for value in ["inf", "-inf", "nan", "1e300", "-1e300"] {
                    let mut wrong = parameters.clone();
                    // All numbers of a list but the last are as they were.
                    let text = text.trim_end_matches(']').rsplit_once(", ");
                    let text = text
                        .map_or_else(|| value.to_owned(), |(head, _)| format!("{head}, {value}]"));
                    wrong.insert(key.clone(), text);
                    assert!(make("a", kind, &wrong).is_err(), "{kind}, {key}, {value}");
                }
            }
        }
    }

    #[test]
    fn sim_lightweight_arm_without_parameters_has_data_sheet() {
        for (kind, range, velocity) in [
            ("kuka_lwr_sim", 170.0_f64, 100.0_f64),
            ("kuka_iiwa_sim", 175.0, 98.0),
        ] {
            let (description, _) = make("a", kind, &BTreeMap::new()).unwrap();
            let (first, last) = (description.limits[0], description.limits[6]);
            for (found, degrees) in [
                (last.position_min, -range),
                (first.velocity_max, velocity),
                (first.acceleration_max, 4.0 * velocity),
            ] {
                assert!(
                    (found.to_degrees() - degrees).abs() < 1e-9,
                    "{kind}: {found}"
                );
            }
        }
        let error = make("a", "kuka_youbot_arm_sim", &BTreeMap::new());
        assert!(error.is_err_and(|error| error.to_string().contains("min_joint is missing")));
    }

    #[test]
    fn sim_limits_too_small_are_rejected() {
        for key in ["max_vel", "max_acc"] {
            for value in ["0", "1e-320", "-1"] {
                let mut wrong = sound("kuka_lwr_sim");
                wrong.insert(key.to_owned(), format!("[{}]", [value; 7].join(",")));
                let error = make("a", "kuka_lwr_sim", &wrong).unwrap_err().to_string();
                assert!(error.contains("leave it no motion"), "{error}");
            }
        }
    }
}
