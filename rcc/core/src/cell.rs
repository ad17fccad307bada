//! `cell.toml`: what a controller is made of. It is read once at the start.
//!
//! ```toml
//! [controller]
//! period = "1ms"           # time from one cycle of nets to the next
//! priority = 80            # SCHED_FIFO, 1 to 98; leave out for an ordinary thread
//! cpus = [1]               # processors of the net thread; leave out for any
//! websocket = "127.0.0.1:8080"
//! tcp = "127.0.0.1:8081"
//!
//! [[device]]
//! name = "left"
//! type = "kuka_lwr_fri"
//! listen = "0.0.0.0:49938" # where the KRC sends its datagrams
//! priority = 85
//! ```

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use serde::Deserialize;

use crate::error::Error;
use crate::span;

/// A controller and its devices.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellConfig {
    /// The controller itself.
    #[serde(default)]
    pub controller: ControllerConfig,
    /// Its devices.
    #[serde(default, rename = "device")]
    pub devices: Vec<DeviceConfig>,
}

/// Settings of the controller itself.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// Time from one cycle to the next, 100 us to 100 ms.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub period: Duration,
    /// `SCHED_FIFO` priority of the net thread, 1 to 98; `None` for an ordinary thread.
    pub priority: Option<u8>,
    /// Processors of the net thread; empty for any.
    pub cpus: Vec<usize>,
    /// Where DirectIO over WebSocket listens.
    pub websocket: Option<SocketAddr>,
    /// Where DirectIO over plain TCP listens.
    pub tcp: Option<SocketAddr>,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            period: Duration::from_millis(1),
            priority: Some(80),
            cpus: Vec::new(),
            websocket: Some(SocketAddr::from(([127, 0, 0, 1], 8080))),
            tcp: Some(SocketAddr::from(([127, 0, 0, 1], 8081))),
        }
    }
}

/// A device.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "type", deny_unknown_fields)]
pub enum DeviceConfig {
    /// A KUKA LWR on a KRC2lr, over FRI 1.0.
    #[serde(rename = "kuka_lwr_fri")]
    Lwr(LwrConfig),
}

/// A KUKA LWR.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LwrConfig {
    /// Name by which nets find it.
    pub name: String,
    /// Address and port at which the KRC's datagrams arrive.
    #[serde(default = "LwrConfig::default_listen")]
    pub listen: SocketAddr,
    /// `SCHED_FIFO` priority of its driver thread, 1 to 98; `None` for an ordinary thread.
    #[serde(default = "LwrConfig::default_priority")]
    pub priority: Option<u8>,
    /// Processors of its driver thread; empty for any.
    #[serde(default)]
    pub cpus: Vec<usize>,
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

impl CellConfig {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, is no TOML, names what does not exist, or a value is out of range.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(&text).map_err(|what| Error::Config {
            path: path.to_owned(),
            what,
        })
    }

    fn parse(text: &str) -> Result<Self, String> {
        let config: Self = toml::from_str(text).map_err(|e| e.to_string())?;
        config.check()?;
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        let period = self.controller.period;
        if !(Duration::from_micros(100)..=Duration::from_millis(100)).contains(&period) {
            return Err(format!(
                "controller.period is {period:?}; it must be 100us to 100ms"
            ));
        }
        let priorities = self
            .devices
            .iter()
            .map(|DeviceConfig::Lwr(d)| (&*d.name, d.priority));
        for (name, priority) in priorities.chain([("controller", self.controller.priority)]) {
            if priority.is_some_and(|p| !(1..=98).contains(&p)) {
                return Err(format!("{name}: priority must be 1 to 98, or be left out"));
            }
        }
        let mut names: Vec<_> = self
            .devices
            .iter()
            .map(|DeviceConfig::Lwr(d)| &d.name)
            .collect();
        names.sort();
        match names.windows(2).find(|w| w[0] == w[1]) {
            Some(twice) => Err(format!("device name `{}` is given twice", twice[0])),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whole_cell() {
        let text = r#"
            [controller]
            period = "500us"
            cpus = [1]
            [[device]]
            name = "left"
            type = "kuka_lwr_fri"
            listen = "127.0.0.1:49938"
        "#;
        let config = CellConfig::parse(text).unwrap();
        assert_eq!(config.controller.period, Duration::from_micros(500));
        let DeviceConfig::Lwr(lwr) = &config.devices[0];
        assert_eq!((lwr.name.as_str(), lwr.priority), ("left", Some(85)));
    }

    #[test]
    fn faults_name_the_line_or_the_field() {
        for (text, said) in [
            ("[controller]\nperiod = 1", "invalid type"),
            ("[controller]\nperiod = \"1\"", "is no duration"),
            ("[controller]\nperiod = \"1s\"", "must be 100us to 100ms"),
            ("[controller]\npriority = 99", "priority must be 1 to 98"),
            ("[controller]\nperoid = \"1ms\"", "unknown field `peroid`"),
            (
                "[[device]]\nname = \"a\"\ntype = \"kuka\"",
                "unknown variant `kuka`",
            ),
            (
                "[[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"\nport = 1",
                "unknown field `port`",
            ),
        ] {
            let error = CellConfig::parse(text).unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
        let twice = "[[device]]\nname = \"a\"\ntype = \"kuka_lwr_fri\"\n".repeat(2);
        assert!(
            CellConfig::parse(&twice)
                .unwrap_err()
                .contains("given twice")
        );
    }
}
