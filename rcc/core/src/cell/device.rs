//! A device of a cell: the configuration of one kind of driver. Each kind is defined in its module of `device`.

use std::time::Duration;

use serde::Deserialize;

use crate::device::config::{IiwaConfig, LwrConfig, RmpConfig};
use crate::device::{DeviceDescription, iiwa, lwr, rmp};

/// A device.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", deny_unknown_fields)]
pub enum DeviceConfig {
    /// A KUKA LWR on a KRC2lr, over FRI 1.0.
    #[serde(rename = "kuka_lwr_fri")]
    Lwr(LwrConfig),
    /// A KUKA LBR iiwa on a Sunrise cabinet, over FRI 1.7 to 2.7.
    #[serde(rename = "kuka_iiwa_fri")]
    Iiwa(IiwaConfig),
    /// A mobile base of one Segway RMP, or of two RMP50 on mecanum wheels, over CAN or USB.
    #[serde(rename = "segway_rmp")]
    Rmp(RmpConfig),
}

impl DeviceConfig {
    /// Name by which nets find it.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Lwr(config) => &config.name,
            Self::Iiwa(config) => &config.name,
            Self::Rmp(config) => &config.name,
        }
    }

    /// `SCHED_FIFO` priority of its driver thread; `None` for an ordinary thread.
    #[must_use]
    pub const fn priority(&self) -> Option<u8> {
        match self {
            Self::Lwr(config) => config.priority,
            Self::Iiwa(config) => config.priority,
            Self::Rmp(config) => config.priority,
        }
    }

    /// What is known of it before it is in contact.
    #[must_use]
    pub fn describe(&self) -> DeviceDescription {
        match self {
            Self::Lwr(config) => lwr::describe(&config.name).with(lwr::PARTS),
            Self::Iiwa(config) => {
                iiwa::describe(&config.name, config.model).with(&iiwa::parts(&config.io))
            }
            Self::Rmp(config) => rmp::describe(config),
        }
    }

    /// Period of the net thread that commands it; `None` for the first.
    #[must_use]
    pub const fn thread(&self) -> Option<Duration> {
        match self {
            Self::Lwr(config) => config.thread,
            Self::Iiwa(config) => config.thread,
            Self::Rmp(config) => config.thread,
        }
    }
}

#[cfg(test)]
mod tests {
    use takt_fri::lwr::Protocol as Handshake;

    use super::*;

    #[test]
    fn a_handshake_is_known_by_its_name() {
        let parse = |handshake: &str| {
            let text = format!("type = \"kuka_lwr_fri\"\nname = \"a\"\n{handshake}");
            toml::from_str::<DeviceConfig>(&text).map_err(|error| error.to_string())
        };
        for known in Handshake::ALL {
            let DeviceConfig::Lwr(arm) = parse(&format!("handshake = \"{known}\"")).unwrap() else {
                panic!("{known}");
            };
            assert_eq!(arm.handshake, Some(known));
        }
        let DeviceConfig::Lwr(arm) = parse("").unwrap() else {
            panic!("no LWR");
        };
        assert_eq!(arm.handshake, None);
        let error = parse("handshake = \"RCC\"").unwrap_err();
        let all =
            "`RCC` is no handshake; known handshakes are rcc, stanford, kuka-lwr, tum, first-app";
        assert!(error.contains(all), "{error}");
    }

    #[test]
    fn inputs_and_outputs_of_an_iiwa_are_named() {
        let text = "type = \"kuka_iiwa_fri\"\nname = \"a\"\nio = { bool_out = [\"Media.Lamp\"] }";
        let DeviceConfig::Iiwa(arm) = toml::from_str(text).unwrap() else {
            panic!("no iiwa");
        };
        assert_eq!(arm.io.bool_out, ["Media.Lamp"]);
        let wrong = text.replace("bool_out", "bools");
        assert!(toml::from_str::<DeviceConfig>(&wrong).is_err());
    }
}
