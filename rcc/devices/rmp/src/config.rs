//! Cell file configuration of Segway RMP bases.

use std::time::Duration;

use serde::Deserialize;
use takt_can::rmp::YawSign;
use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds};
use takt_core::span;

use crate::base::{self, Rmp};

/// A Segway RMP, or two of them under one platform.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RmpConfig {
    /// Name by which nets find it.
    pub name: String,
    /// Links of its power bases: `can0`, or `/dev/ttyUSB0` for the USB port. One for a base of two wheels; front and
    /// back for a platform of two RMP50.
    pub links: Vec<String>,
    /// `rmp50`, `rmp100`, `rmp200` or `rmp400`; a platform of two is of RMP50.
    #[serde(default = "RmpConfig::default_model")]
    pub model: String,
    /// Which way the integrated yaw (404h) of its power base counts: `clockwise`, as its yaw rate, or
    /// `counter_clockwise`. `takt can rmp --jog 0,0.5 --duration 4s` says which.
    #[serde(default = "RmpConfig::default_yaw_integral")]
    pub yaw_integral: String,
    /// Time between commands, 10 ms to 300 ms.
    #[serde(
        default = "RmpConfig::default_period",
        deserialize_with = "span::text::deserialize"
    )]
    pub period: Duration,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default)]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands it; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
}

impl RmpConfig {
    /// A base on these links with default settings.
    #[must_use]
    pub fn new(name: impl Into<String>, links: &[&str]) -> Self {
        Self {
            name: name.into(),
            links: links.iter().map(|link| (*link).to_owned()).collect(),
            model: Self::default_model(),
            yaw_integral: Self::default_yaw_integral(),
            period: Self::default_period(),
            priority: None,
            cpus: Vec::new(),
            thread: None,
        }
    }

    fn default_model() -> String {
        "rmp50".to_owned()
    }

    fn default_yaw_integral() -> String {
        YawSign::default().name().to_owned()
    }

    const fn default_period() -> Duration {
        Duration::from_millis(50)
    }
}

impl DriverConfig for RmpConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn thread(&self) -> Option<Duration> {
        self.thread
    }

    fn priority(&self) -> Option<u8> {
        self.priority
    }

    fn check(&self) -> Result<(), String> {
        base::check(self)
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        vec![base::describe(self)]
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        Ok(Box::new(Rmp::start(self, base::open(self)?, ends)?))
    }
}
