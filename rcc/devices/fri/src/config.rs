//! Cell file configuration of KUKA arms over FRI.

use std::net::SocketAddr;
use std::time::Duration;

use serde::{Deserialize, Deserializer};
use takt_fri::lwr::Protocol as Handshake;
use takt_motion::Model;
use takt_motion::dynamics::{Down, Payload};

use takt_core::device::on_end::OutputsOnEnd;
use takt_core::span;

/// A KUKA LWR.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LwrConfig {
    /// Name by which nets find it.
    pub name: String,
    /// Kinematics by a URDF, such as a calibrated one or one with a mounted tool; empty for that of the maker.
    #[serde(default)]
    pub kinematics: Model,
    /// What it carries beyond the load that its controller knows: in joint impedance with added torques its weight is held.
    #[serde(default)]
    pub payload: Payload,
    /// Direction of gravity in its base, for that.
    #[serde(default)]
    pub down: Down,
    /// Local address and port for the KRC's datagrams.
    #[serde(default = "LwrConfig::default_listen")]
    pub listen: SocketAddr,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "LwrConfig::default_priority")]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands it; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
    /// Handshake by which the KRL program accepts control strategy, tool and load over user data; `None` if it does
    /// not.
    #[serde(default, deserialize_with = "handshake")]
    pub handshake: Option<Handshake>,
    /// Policies of the user data when the net that wrote them ends.
    #[serde(default)]
    pub on_end: OutputsOnEnd,
}

fn handshake<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Handshake>, D::Error> {
    let name = String::deserialize(from)?;
    let known = Handshake::ALL.into_iter().find(|it| it.to_string() == name);
    known.map(Some).ok_or_else(|| {
        let all = Handshake::ALL.map(|it| it.to_string()).join(", ");
        serde::de::Error::custom(format!(
            "`{name}` is no handshake; known handshakes are {all}"
        ))
    })
}

impl LwrConfig {
    /// An arm with default settings.
    #[must_use]
    pub fn new(name: impl Into<String>, listen: SocketAddr) -> Self {
        let (name, priority) = (name.into(), Self::default_priority());
        Self {
            name,
            kinematics: Model::default(),
            payload: Payload::default(),
            down: Down::default(),
            listen,
            priority,
            cpus: Vec::new(),
            thread: None,
            handshake: None,
            on_end: OutputsOnEnd::default(),
        }
    }

    const fn default_listen() -> SocketAddr {
        SocketAddr::new(
            std::net::IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED),
            takt_fri::lwr::DEFAULT_PORT,
        )
    }

    #[expect(
        clippy::unnecessary_wraps,
        reason = "the type of the field it is the default of"
    )]
    const fn default_priority() -> Option<u8> {
        Some(85)
    }
}

/// LBR iiwa model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum IiwaModel {
    /// LBR iiwa 7 R800.
    #[serde(rename = "iiwa7")]
    Iiwa7,
    /// LBR iiwa 14 R820.
    #[default]
    #[serde(rename = "iiwa14")]
    Iiwa14,
}

/// A KUKA LBR iiwa.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IiwaConfig {
    /// Name by which nets find it.
    pub name: String,
    /// `iiwa7` or `iiwa14`.
    #[serde(default)]
    pub model: IiwaModel,
    /// Kinematics by a URDF, such as a calibrated one or one with a mounted tool; empty for that of the maker.
    #[serde(default)]
    pub kinematics: Model,
    /// What it carries beyond the load that its controller knows: in joint impedance with added torques its weight is held.
    #[serde(default)]
    pub payload: Payload,
    /// Direction of gravity in its base, for that.
    #[serde(default)]
    pub down: Down,
    /// Local address and port for the cabinet's datagrams.
    #[serde(default = "IiwaConfig::default_listen")]
    pub listen: SocketAddr,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "LwrConfig::default_priority")]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
    /// Period of the net thread that commands it; `None` for the first.
    #[serde(default, deserialize_with = "span::text::deserialize_some")]
    pub thread: Option<Duration>,
    /// Inputs and outputs that the robot program shares, at most 10.
    #[serde(default)]
    pub io: IiwaIo,
    /// Policies of the outputs when the net that wrote them ends.
    #[serde(default)]
    pub on_end: OutputsOnEnd,
}

/// Inputs and outputs of a Sunrise cabinet by their names, `Group.Name`; the first of each list is port 0.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IiwaIo {
    /// Digital signals from the cabinet.
    pub bool_in: Vec<String>,
    /// Digital signals that nets write.
    pub bool_out: Vec<String>,
    /// Numeric signals from the cabinet, analogue or digital.
    pub real_in: Vec<String>,
    /// Numeric signals that nets write: analogue ones, and digital ones as whole numbers from 0.
    pub real_out: Vec<String>,
}

impl IiwaConfig {
    /// An iiwa 14 with default settings.
    #[must_use]
    pub fn new(name: impl Into<String>, listen: SocketAddr) -> Self {
        Self {
            name: name.into(),
            model: IiwaModel::default(),
            kinematics: Model::default(),
            payload: Payload::default(),
            down: Down::default(),
            listen,
            priority: LwrConfig::default_priority(),
            cpus: Vec::new(),
            thread: None,
            io: IiwaIo::default(),
            on_end: OutputsOnEnd::default(),
        }
    }

    const fn default_listen() -> SocketAddr {
        SocketAddr::new(
            std::net::IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED),
            takt_fri::sunrise::DEFAULT_PORT,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lwr_handshake_is_found_by_name() {
        let parse = |handshake: &str| {
            let text = format!("name = \"a\"\n{handshake}");
            toml::from_str::<LwrConfig>(&text).map_err(|error| error.to_string())
        };
        for known in Handshake::ALL {
            let arm = parse(&format!("handshake = \"{known}\"")).unwrap();
            assert_eq!(arm.handshake, Some(known));
        }
        assert_eq!(parse("").unwrap().handshake, None);
        let error = parse("handshake = \"RCC\"").unwrap_err();
        let all =
            "`RCC` is no handshake; known handshakes are rcc, stanford, kuka-lwr, tum, first-app";
        assert!(error.contains(all), "{error}");
    }

    #[test]
    fn iiwa_inputs_and_outputs_are_named() {
        let text = "name = \"a\"\nio = { bool_out = [\"Media.Lamp\"] }";
        let arm = toml::from_str::<IiwaConfig>(text).unwrap();
        assert_eq!(arm.io.bool_out, ["Media.Lamp"]);
        let wrong = text.replace("bool_out", "bools");
        assert!(toml::from_str::<IiwaConfig>(&wrong).is_err());
    }
}
