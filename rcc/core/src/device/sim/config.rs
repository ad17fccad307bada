//! Simulated arms of a cell file: `type = "arm_sim"`. They have no driver thread and no wire.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Deserialize;
use takt_motion::Model;

use super::{ARM, Made, make};
use crate::device::DeviceDescription;
use crate::device::driver::{DeviceDriver, DriverConfig, DriverEnds};
use crate::error::Error;
use crate::span;

/// A simulated arm of any model.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmSimConfig {
    /// Name by which nets find it.
    pub name: String,
    /// Model of its kinematics: a name, or `urdf:` with a file.
    pub model: Model,
    /// Period of the net thread that commands it; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
    /// Range of each joint, degrees; empty for that of the model.
    #[serde(default)]
    pub range: Vec<[f64; 2]>,
    /// Largest speed of each joint, degrees per second; empty for that of the model.
    #[serde(default)]
    pub velocity_max: Vec<f64>,
    /// Largest acceleration of each joint, degrees per second squared; empty for its speed within 0.25 s.
    #[serde(default)]
    pub acceleration_max: Vec<f64>,
    /// Where its joints begin, degrees; empty for 0, or the middle of a range without 0.
    #[serde(default)]
    pub start: Vec<f64>,
}

impl ArmSimConfig {
    fn made(&self) -> Result<Made, Error> {
        let lists = [
            ("min_joint", self.range.iter().map(|it| it[0]).collect()),
            ("max_joint", self.range.iter().map(|it| it[1]).collect()),
            ("max_vel", self.velocity_max.clone()),
            ("max_acc", self.acceleration_max.clone()),
            ("home_joint", self.start.clone()),
        ];
        let given = lists.into_iter().filter(|(_, list)| !list.is_empty());
        let radians = |list: Vec<f64>| list.into_iter().map(f64::to_radians).collect::<Vec<_>>();
        let texts = given.map(|(key, list)| (key.to_owned(), format!("{:?}", radians(list))));
        let mut texts: BTreeMap<_, _> = texts.collect();
        texts.insert("model".to_owned(), self.model.full_text().into_owned());
        make(&self.name, ARM, &texts)
    }
}

impl DriverConfig for ArmSimConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn thread(&self) -> Option<Duration> {
        self.thread
    }

    fn priority(&self) -> Option<u8> {
        None
    }

    fn check(&self) -> Result<(), String> {
        match self.made() {
            Ok(_) => Ok(()),
            Err(Error::DeviceParameter { name, what }) => Err(format!("{name}: {what}")),
            Err(error) => Err(error.to_string()),
        }
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        self.made().map(|(arm, _)| arm).into_iter().collect()
    }

    fn simulated(&self) -> Result<Option<Made>, Error> {
        self.made().map(Some)
    }

    fn start(&self, _: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Err(Error::DeviceParameter {
            name: self.name.clone(),
            what: "a simulated arm has no driver to start".to_owned(),
        })
    }
}
