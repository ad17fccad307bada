//! Cell file configuration of robots with a driver of their own.

use std::net::SocketAddr;
use std::time::Duration;

use serde::{Deserialize, Deserializer};
use takt_fri::lwr::Protocol as Handshake;

use super::OutputsOnEnd;
use crate::span;

/// A KUKA LWR.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LwrConfig {
    /// Name by which nets find it.
    pub name: String,
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
    /// Analogue signals that nets write.
    pub real_out: Vec<String>,
}

impl IiwaConfig {
    /// An iiwa 14 with default settings.
    #[must_use]
    pub fn new(name: impl Into<String>, listen: SocketAddr) -> Self {
        Self {
            name: name.into(),
            model: IiwaModel::default(),
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
            period: Self::default_period(),
            priority: None,
            cpus: Vec::new(),
            thread: None,
        }
    }

    fn default_model() -> String {
        "rmp50".to_owned()
    }

    const fn default_period() -> Duration {
        Duration::from_millis(50)
    }
}
