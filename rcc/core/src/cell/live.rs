//! `[live]`: data for other tools while the controller runs. The server sends it.

use std::net::SocketAddr;

use serde::Deserialize;

use super::access::check_origins;
use crate::probe::PROBES_MAX;

/// Largest divisor of cycles.
const EVERY_MAX: u64 = 1000;

/// What is sent to other tools.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LiveSettings {
    /// Where the Foxglove WebSocket listens; `None` for none.
    pub foxglove: Option<SocketAddr>,
    /// Whether its clients may start, cancel and abort nets and stop the controller.
    pub services: bool,
    /// Origins of web pages that may connect to it, such as `https://app.foxglove.dev`; `file://` for desktop programs.
    pub origins: Vec<String>,
    /// Where samples of `probes` are sent as JSON in UDP datagrams, one for each cycle; `None` for none.
    pub udp: Option<SocketAddr>,
    /// The probes whose samples are sent there, 1 to 64.
    pub probes: Vec<String>,
    /// Only each n-th cycle is sent, 1 to 1000.
    pub every: u64,
}

impl Default for LiveSettings {
    fn default() -> Self {
        Self {
            foxglove: None,
            services: false,
            origins: Vec::new(),
            udp: None,
            probes: Vec::new(),
            every: 1,
        }
    }
}

impl LiveSettings {
    /// Checks what belongs together.
    pub(super) fn check(&self) -> Result<(), String> {
        check_origins("live.origins", &self.origins, &["file://"])?;
        if !(1..=EVERY_MAX).contains(&self.every) {
            let every = self.every;
            return Err(format!(
                "live.every is {every}; it must be 1 to {EVERY_MAX}"
            ));
        }
        if self.foxglove.is_none() && (self.services || !self.origins.is_empty()) {
            return Err(
                "live.services and live.origins are for the Foxglove WebSocket, which is off\nhint: set \
                 foxglove = \"127.0.0.1:8765\" under [live]"
                    .to_owned(),
            );
        }
        if self.udp.is_some() == self.probes.is_empty() {
            return Err(
                "live.udp and live.probes belong together\nhint: set udp = \"127.0.0.1:9870\" and \
                 probes = [\"left.joint.0.measured\"] under [live]; `takt scope --list` prints the names"
                    .to_owned(),
            );
        }
        if self.probes.len() > PROBES_MAX {
            let count = self.probes.len();
            return Err(format!(
                "live.probes has {count} names; at most {PROBES_MAX} are sent"
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::cell::CellConfig;

    #[test]
    fn live_section_wrong_is_rejected() {
        let parse = |lines: &str| CellConfig::parse(&format!("[live]\n{lines}"), &[]);
        let good = "foxglove = \"127.0.0.1:8765\"\nservices = true\nevery = 5\n\
            origins = [\"https://app.foxglove.dev\", \"file://\"]";
        assert!(parse(good).is_ok(), "{:?}", parse(good));
        let none = CellConfig::parse("", &[]).unwrap();
        assert_eq!(none.live.foxglove, None, "off");
        for (lines, said) in [
            ("services = true", "is off"),
            ("every = 0", "live.every is 0; it must be 1 to 1000"),
            (
                "foxglove = \"127.0.0.1:8765\"\norigins = [\"foxglove\"]",
                "`foxglove` is no origin",
            ),
            ("udp = \"127.0.0.1:9870\"", "belong together"),
            ("probes = [\"a\"]", "belong together"),
            ("foxglove = \"here\"", "invalid socket address"),
            ("foxgloves = true", "unknown field `foxgloves`"),
        ] {
            let error = parse(lines).unwrap_err().to_string();
            assert!(error.contains(said), "{lines}: {error}");
        }
    }
}
