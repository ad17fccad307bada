//! `[fleet]`: the cell as a member of a fleet of controllers. It opens nothing.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use takt_core::Loopback;
use takt_core::cell::{ControllerConfig, located};
use takt_core::span;

use crate::keys::CellName;

/// Most bytes of the name of a cell.
pub const CELL_NAME_BYTES_MAX: usize = 64;
/// Maximum number of endpoints of each list.
const ENDPOINTS_MAX: usize = 16;
/// Maximum number of access rules, and of certificates of each.
const RULES_MAX: usize = 64;
/// Highest rate of joints, 1/s.
const JOINTS_HZ_MAX: u32 = 500;

/// Whether a text can be the name of a cell: one chunk of a key.
#[must_use]
pub fn is_cell_name(name: &str) -> bool {
    let is_usual = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    (1..=CELL_NAME_BYTES_MAX).contains(&name.len()) && name.chars().all(is_usual)
}

/// How a member reaches the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FleetMode {
    /// By links of its own.
    #[default]
    Peer,
    /// By one link to a router.
    Client,
    /// By links of its own, and it forwards what others send.
    Router,
}

impl FleetMode {
    /// Its name in configurations.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Peer => "peer",
            Self::Client => "client",
            Self::Router => "router",
        }
    }
}

/// What members of the fleet may do here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FleetRight {
    /// See telemetry and resources.
    Read,
    /// Open sessions and send commands.
    Command,
    /// Prepare and commit coordinated starts.
    Start,
}

/// An access rule.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetRule {
    /// Common names of the certificates that it is for; empty for links without TLS, which are on loopback.
    #[serde(default)]
    pub certificates: Vec<String>,
    /// What they may do.
    pub rights: Vec<FleetRight>,
}

/// A member of a fleet.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FleetSettings {
    /// The name of the cell, unique in the fleet; `None`: the cell is in no fleet.
    pub cell: Option<String>,
    /// How it reaches the others.
    pub mode: FleetMode,
    /// Endpoints at which it listens, such as `tls/192.0.2.1:7447`; `None` for `tcp/127.0.0.1:7447` if it connects to none.
    pub listen: Option<Vec<String>>,
    /// Endpoints to which it connects.
    pub connect: Vec<String>,
    /// Certificate of the authority that signs those of all members, PEM.
    pub ca: Option<PathBuf>,
    /// Certificate of this cell, PEM.
    pub certificate: Option<PathBuf>,
    /// Its private key, PEM.
    pub key: Option<PathBuf>,
    /// Time without a sign of life after which a link is lost, 200 ms to 60 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub lease: Duration,
    /// Maximum number of links, 1 to 1000.
    pub links: u16,
    /// Maximum size of a message, KiB, 16 to 16384.
    pub message_kib: u32,
    /// Highest rate at which joints are published, 1/s, 0 for never, to 500.
    pub joints_hz: u32,
    /// Who may do what; without a rule, all members may read.
    pub allow: Vec<FleetRule>,
}

impl Default for FleetSettings {
    fn default() -> Self {
        Self {
            cell: None,
            mode: FleetMode::default(),
            listen: None,
            connect: Vec::new(),
            ca: None,
            certificate: None,
            key: None,
            lease: Duration::from_secs(1),
            links: 128,
            message_kib: 1024,
            joints_hz: JOINTS_HZ_MAX,
            allow: Vec::new(),
        }
    }
}

/// Where a cell listens if nothing is configured.
pub const FLEET_ENDPOINT: &str = "tcp/127.0.0.1:7447";

const NO_CELL: &str = "[fleet] has no `cell`: the name of this cell in the fleet\nhint: set cell = \"weld3\" under [fleet]";

/// What of a cell file is read here.
#[derive(Deserialize)]
struct CellFile {
    fleet: Option<FleetSettings>,
}

impl FleetSettings {
    /// Reads and checks the table `[fleet]` of a cell file; without one, the cell is in no fleet. Files that it names are relative
    /// to `folder`, that of the cell file.
    ///
    /// # Errors
    /// The first fault, with its line and a hint.
    pub fn of_file(
        text: &str,
        folder: &Path,
        controller: &ControllerConfig,
    ) -> Result<Option<(CellName, Self)>, String> {
        let file: CellFile = toml::from_str(text).map_err(|error| error.to_string())?;
        let Some(mut fleet) = file.fleet else {
            return Ok(None);
        };
        fleet.check(controller).map_err(|why| located(text, why))?;
        let name = fleet.cell.as_deref().ok_or(NO_CELL)?;
        let name = CellName::new(name).map_err(|why| why.to_string())?;
        let files = [&mut fleet.ca, &mut fleet.certificate, &mut fleet.key];
        for file in files.into_iter().flatten() {
            *file = folder.join(&*file);
        }
        Ok(Some((name, fleet)))
    }

    /// The endpoints at which it listens.
    #[must_use]
    pub fn listens(&self) -> Vec<String> {
        match &self.listen {
            Some(listen) => listen.clone(),
            None if self.connect.is_empty() => vec![FLEET_ENDPOINT.to_owned()],
            None => Vec::new(),
        }
    }

    /// Whether it has all files of mutual TLS.
    #[must_use]
    pub const fn has_tls(&self) -> bool {
        self.ca.is_some() && self.certificate.is_some() && self.key.is_some()
    }

    /// Checks what belongs together.
    ///
    /// # Errors
    /// The first fault, with a hint.
    pub fn check(&self, controller: &ControllerConfig) -> Result<(), String> {
        let Some(cell) = &self.cell else {
            return if *self == Self::default() {
                Ok(())
            } else {
                Err(NO_CELL.to_owned())
            };
        };
        if !is_cell_name(cell) {
            return Err(format!(
                "fleet.cell is `{cell}`, which is no name of a cell\nhint: 1 to {CELL_NAME_BYTES_MAX} ASCII letters, digits, \
                 `-`, `_` and `.`"
            ));
        }
        self.check_ranges()?;
        self.check_files()?;
        self.check_endpoints()?;
        self.check_rules()?;
        self.check_token(controller)
    }

    fn check_ranges(&self) -> Result<(), String> {
        let lease = self.lease;
        if !(Duration::from_millis(200)..=Duration::from_secs(60)).contains(&lease) {
            return Err(format!("fleet.lease is {lease:?}; it must be 200ms to 60s"));
        }
        let ranges = [
            ("links", u32::from(self.links), 1, 1000),
            ("message_kib", self.message_kib, 16, 16384),
            ("joints_hz", self.joints_hz, 0, JOINTS_HZ_MAX),
        ];
        for (key, value, from, to) in ranges {
            if !(from..=to).contains(&value) {
                return Err(format!("fleet.{key} is {value}; it must be {from} to {to}"));
            }
        }
        Ok(())
    }

    fn check_files(&self) -> Result<(), String> {
        let files = [&self.ca, &self.certificate, &self.key];
        let given = files.iter().filter(|file| file.is_some()).count();
        if given == 0 || given == files.len() {
            return Ok(());
        }
        Err(
            "fleet.ca, fleet.certificate and fleet.key belong together: all members show certificates to each other\nhint: \
             docs/fleet.md shows how to make them"
                .to_owned(),
        )
    }

    fn check_endpoints(&self) -> Result<(), String> {
        let listens = self.listens();
        for (key, endpoints) in [("listen", &listens), ("connect", &self.connect)] {
            if endpoints.len() > ENDPOINTS_MAX {
                let count = endpoints.len();
                return Err(format!(
                    "fleet.{key} has {count} endpoints; at most {ENDPOINTS_MAX} are possible"
                ));
            }
            for text in endpoints {
                let endpoint = Endpoint::parse(text).ok_or_else(|| no_endpoint(key, text))?;
                self.check_endpoint(key, text, &endpoint)?;
            }
        }
        if self.mode == FleetMode::Client && self.connect.is_empty() {
            return Err(
                "fleet.mode is `client`, but fleet.connect names no router\nhint: set connect = [\"tls/router:7447\"]"
                    .to_owned(),
            );
        }
        if self.mode == FleetMode::Client && !listens.is_empty() {
            return Err(
                "fleet.mode is `client`, which does not listen\nhint: leave out listen, or set mode = \"peer\"".to_owned(),
            );
        }
        Ok(())
    }

    fn check_endpoint(&self, key: &str, text: &str, endpoint: &Endpoint) -> Result<(), String> {
        if endpoint.tls && !self.has_tls() {
            return Err(format!(
                "fleet.{key}: `{text}` needs certificates\nhint: set ca, certificate and key under [fleet]; docs/fleet.md shows \
                 how to make them"
            ));
        }
        if !endpoint.tls && !endpoint.is_loopback() {
            return Err(format!(
                "fleet.{key}: `{text}` is beyond loopback and not protected: anybody on that network could command robots\nhint: \
                 write `tls/…` and set ca, certificate and key under [fleet]"
            ));
        }
        Ok(())
    }

    fn check_rules(&self) -> Result<(), String> {
        if self.allow.len() > RULES_MAX {
            let count = self.allow.len();
            return Err(format!(
                "fleet.allow has {count} rules; at most {RULES_MAX} are possible"
            ));
        }
        for (number, rule) in self.allow.iter().enumerate() {
            let wrong = |why: String| Err(format!("fleet.allow {number}: {why}"));
            if rule.rights.is_empty() {
                return wrong(
                    "`rights` is empty\nhint: `read`, `command` and `start` are possible"
                        .to_owned(),
                );
            }
            if rule.certificates.len() > RULES_MAX {
                return wrong(format!("`certificates` has more than {RULES_MAX} names"));
            }
            if rule.certificates.iter().any(|name| name.trim().is_empty()) {
                return wrong(
                    "`certificates` has an empty name\nhint: write the common name (CN) of a certificate".to_owned(),
                );
            }
            if !rule.certificates.is_empty() && !self.has_tls() {
                return wrong(
                    "`certificates` are for links with TLS, and there is none\nhint: set ca, certificate and key under [fleet]"
                        .to_owned(),
                );
            }
        }
        Ok(())
    }

    /// Links of loopback without certificates carry no token: they must not go around it.
    fn check_token(&self, controller: &ControllerConfig) -> Result<(), String> {
        let default = if controller.token_file.is_some() {
            Loopback::Token
        } else {
            Loopback::Open
        };
        let is_open = controller.loopback.unwrap_or(default) == Loopback::Open;
        let listens = self.listens();
        let plain = listens
            .iter()
            .find(|text| Endpoint::parse(text).is_some_and(|endpoint| !endpoint.tls));
        match plain {
            Some(text) if !is_open => Err(format!(
                "fleet.listen: `{text}` admits every account of this host, but controller.loopback requires the token\nhint: \
                 listen at `tls/…` with certificates, or set loopback = \"open\" under [controller]"
            )),
            Some(_) | None => Ok(()),
        }
    }
}

fn no_endpoint(key: &str, text: &str) -> String {
    format!(
        "fleet.{key}: `{text}` is no endpoint\nhint: write `tcp/127.0.0.1:7447`, or `tls/HOST:7447` with certificates"
    )
}

/// An endpoint: `tcp/HOST:PORT` or `tls/HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Whether the link is encrypted and both ends show certificates.
    pub tls: bool,
    /// Name or address.
    pub host: String,
    /// Port; 0 for any free one.
    pub port: u16,
}

impl Endpoint {
    /// Parses an endpoint; `None` if it is of another kind, or has options.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (protocol, address) = text.split_once('/')?;
        let tls = match protocol {
            "tcp" => false,
            "tls" => true,
            _ => return None,
        };
        let (host, port) = address.rsplit_once(':')?;
        let is_name = |c: char| c.is_ascii_alphanumeric() || "-_.:[]".contains(c);
        if host.is_empty() || host.len() > 255 || !host.chars().all(is_name) {
            return None;
        }
        if host.contains(':') && address.parse::<SocketAddr>().is_err() {
            return None;
        }
        Some(Self {
            tls,
            host: host.trim_matches(['[', ']']).to_owned(),
            port: port.parse().ok()?,
        })
    }

    /// Whether it is reachable from this host only. Names other than `localhost` may be anything.
    #[must_use]
    pub fn is_loopback(&self) -> bool {
        let address = self.host.parse::<IpAddr>();
        self.host == "localhost"
            || address.is_ok_and(|address| address.to_canonical().is_loopback())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TLS: &str = "ca = \"ca.pem\"\ncertificate = \"c.pem\"\nkey = \"k.pem\"\n";

    fn parse(lines: &str) -> Result<FleetSettings, String> {
        let fleet: FleetSettings = toml::from_str(lines).map_err(|error| error.to_string())?;
        fleet.check(&ControllerConfig::default()).map(|()| fleet)
    }

    #[test]
    fn fleet_absent_is_off() {
        assert_eq!(parse("").unwrap().cell, None);
    }

    #[test]
    fn fleet_defaults_are_loopback_and_reading() {
        let fleet = parse("cell = \"weld3\"").unwrap();
        assert_eq!(fleet.listens(), ["tcp/127.0.0.1:7447"]);
        assert!(fleet.allow.is_empty() && fleet.lease == Duration::from_secs(1));
        let fleet = parse("cell = \"weld3\"\nconnect = [\"tcp/127.0.0.1:7448\"]").unwrap();
        assert!(fleet.listens().is_empty());
    }

    #[test]
    fn fleet_section_wrong_is_rejected() {
        for (lines, said) in [
            ("links = 3", "has no `cell`"),
            ("cell = \"a/b\"", "fleet.cell is `a/b`"),
            ("cell = \"a\"\nlease = \"1ms\"", "fleet.lease is 1ms"),
            (
                "cell = \"a\"\nlinks = 0",
                "fleet.links is 0; it must be 1 to 1000",
            ),
            ("cell = \"a\"\njoints_hz = 501", "must be 0 to 500"),
            ("cell = \"a\"\nmessage_kib = 1", "must be 16 to 16384"),
            (
                "cell = \"a\"\nlisten = [\"udp/127.0.0.1:1\"]",
                "is no endpoint",
            ),
            (
                "cell = \"a\"\nlisten = [\"tcp/127.0.0.1:1#iface=lo\"]",
                "is no endpoint",
            ),
            (
                "cell = \"a\"\nlisten = [\"tcp/0.0.0.0:7447\"]",
                "beyond loopback and not protected",
            ),
            (
                "cell = \"a\"\nconnect = [\"tcp/robot:7447\"]",
                "beyond loopback and not protected",
            ),
            (
                "cell = \"a\"\nlisten = [\"tls/0.0.0.0:7447\"]",
                "needs certificates",
            ),
            ("cell = \"a\"\nca = \"ca.pem\"", "belong together"),
            ("cell = \"a\"\nmode = \"client\"", "names no router"),
            (
                "cell = \"a\"\nallow = [{ rights = [] }]",
                "`rights` is empty",
            ),
            (
                "cell = \"a\"\nallow = [{ certificates = [\"x\"], rights = [\"read\"] }]",
                "are for links with TLS",
            ),
        ] {
            let error = parse(lines).unwrap_err();
            assert!(error.contains(said), "{lines}: {error}");
        }
        assert!(
            parse("cells = \"a\"")
                .unwrap_err()
                .contains("unknown field `cells`")
        );
    }

    #[test]
    fn fleet_of_cell_file_is_read_with_lines_and_folder() {
        let of = |text: &str| {
            let controller = ControllerConfig::default();
            FleetSettings::of_file(text, Path::new("/etc/takt"), &controller)
        };
        let text = format!("[[device]]\nname = \"a\"\n[fleet]\ncell = \"a\"\n{TLS}");
        let (name, fleet) = of(&text).unwrap().unwrap();
        assert_eq!(name.as_str(), "a");
        assert_eq!(fleet.ca, Some(PathBuf::from("/etc/takt/ca.pem")));
        assert_eq!(of("[controller]").unwrap(), None);
        assert!(of("[fleet]").unwrap_err().contains("has no `cell`"));
        let error = of("[controller]\n[fleet]\ncell = \"a\"\nlinks = 0").unwrap_err();
        assert!(
            error.contains("line 4") && error.contains("fleet.links is 0"),
            "{error}"
        );
        let error = of("[fleet]\ncells = \"a\"").unwrap_err();
        assert!(
            error.contains("line 2") && error.contains("unknown field `cells`"),
            "{error}"
        );
    }

    #[test]
    fn fleet_beyond_loopback_needs_certificates() {
        let lines = format!("cell = \"a\"\nlisten = [\"tls/0.0.0.0:7447\"]\n{TLS}");
        let rule = "allow = [{ certificates = [\"panel\"], rights = [\"read\", \"command\"] }]";
        let fleet = parse(&format!("{lines}{rule}")).unwrap();
        assert!(fleet.has_tls());
        assert_eq!(
            fleet.allow[0].rights,
            [FleetRight::Read, FleetRight::Command]
        );
    }

    #[test]
    fn fleet_plain_loopback_does_not_bypass_token() {
        let fleet = parse("cell = \"a\"").unwrap();
        let guarded = |loopback| ControllerConfig {
            token_file: Some("token".into()),
            loopback,
            ..ControllerConfig::default()
        };
        let error = fleet.check(&guarded(None)).unwrap_err();
        assert!(error.contains("requires the token"), "{error}");
        assert_eq!(fleet.check(&guarded(Some(Loopback::Open))), Ok(()));
    }

    #[test]
    fn endpoint_forms() {
        let of = |text| Endpoint::parse(text);
        assert!(of("tcp/[::1]:7447").unwrap().is_loopback());
        assert!(of("tcp/localhost:0").unwrap().is_loopback());
        assert!(!of("tls/weld3.local:7447").unwrap().is_loopback());
        assert!(!of("tcp/[::]:7447").unwrap().is_loopback());
        for text in [
            "tcp/127.0.0.1",
            "127.0.0.1:1",
            "tcp/:1",
            "tcp/a:b:1",
            "tcp/a:70000",
            "tcp/a?x:1",
        ] {
            assert_eq!(of(text), None, "{text}");
        }
    }
}
