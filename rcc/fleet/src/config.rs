//! From the table `[fleet]` of a cell file to the configuration of a zenoh session. It opens nothing.
//!
//! zenoh's own defaults suit a desktop network: multicast scouting, all interfaces, no access control, messages of 1 GiB. Each is
//! set here, and a test reads each back from zenoh.

mod access;
mod settings;

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};
pub use settings::{
    CELL_NAME_BYTES_MAX, Endpoint, FLEET_ENDPOINT, FleetMode, FleetRight, FleetRule, FleetSettings,
    is_cell_name,
};

use crate::keys::{CellName, CellNameError};

/// Time that a tool waits for a link.
pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

/// Values of a zenoh configuration, by their paths.
pub type Entries = Vec<(&'static str, Value)>;

/// The files of mutual TLS, PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// Certificate of the authority.
    pub ca: PathBuf,
    /// Own certificate.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

/// A program that is no cell: a tool, an observer, a client of the Robotics API.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Observer {
    /// Endpoints to which it connects.
    pub connect: Vec<String>,
    /// Its files for `tls/…`.
    pub tls: Option<TlsFiles>,
}

/// Why an observer's endpoint is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum ObserverError {
    #[error(
        "`{0}` is no endpoint\nhint: write tcp/127.0.0.1:7447, or tls/HOST:7447 with certificates"
    )]
    Endpoint(String),
    #[error("`{0}` needs certificates\nhint: give --ca, --certificate and --key")]
    NoCertificates(String),
    #[error("`{0}` is beyond loopback and not protected\nhint: write tls/… and give certificates")]
    NotProtected(String),
    #[error("no endpoint is given\nhint: --connect tcp/127.0.0.1:7447")]
    None,
}

/// The name of the cell, if it is in a fleet.
///
/// # Errors
/// If the name is none; settings of a cell file are checked before.
pub fn cell_name(settings: &FleetSettings) -> Result<Option<CellName>, CellNameError> {
    settings.cell.as_deref().map(CellName::new).transpose()
}

/// The files of mutual TLS of a cell, if it has them.
#[must_use]
pub fn tls_files(settings: &FleetSettings) -> Option<TlsFiles> {
    Some(TlsFiles {
        ca: settings.ca.clone()?,
        certificate: settings.certificate.clone()?,
        key: settings.key.clone()?,
    })
}

/// The zenoh configuration of a cell.
#[must_use]
pub fn of_cell(cell: &CellName, settings: &FleetSettings) -> Entries {
    let limits = Limits {
        lease: settings.lease,
        links: settings.links,
        message_bytes: u64::from(settings.message_kib) << 10,
    };
    let mut entries = common(
        settings.mode,
        &settings.listens(),
        &settings.connect,
        &limits,
    );
    // A cell runs on without a peer, and zenoh tries again for ever, but for a client that has never been connected: opening its session
    // would wait as long.
    let timeout_ms = if settings.mode == FleetMode::Client {
        0
    } else {
        -1
    };
    entries.push(("connect/exit_on_failure", json!(false)));
    entries.push(("connect/timeout_ms", json!(timeout_ms)));
    entries.extend(tls(tls_files(settings).as_ref()));
    entries.push(("access_control", access::rules(cell, settings)));
    entries
}

/// The zenoh configuration of a program that is no cell. It listens nowhere, and fails if no peer answers.
///
/// # Errors
/// If an endpoint is not one, or is beyond loopback without certificates.
pub fn of_observer(observer: &Observer) -> Result<Entries, ObserverError> {
    use ObserverError as E;
    if observer.connect.is_empty() {
        return Err(E::None);
    }
    for text in &observer.connect {
        let endpoint = Endpoint::parse(text).ok_or_else(|| E::Endpoint(text.clone()))?;
        if endpoint.tls && observer.tls.is_none() {
            return Err(E::NoCertificates(text.clone()));
        }
        if !endpoint.tls && !endpoint.is_loopback() {
            return Err(E::NotProtected(text.clone()));
        }
    }
    let limits = Limits {
        lease: Duration::from_secs(1),
        links: 16,
        message_bytes: 16 << 20,
    };
    // One link: a client; several: a peer with a link to each.
    let mode = if observer.connect.len() == 1 {
        FleetMode::Client
    } else {
        FleetMode::Peer
    };
    let mut entries = common(mode, &[], &observer.connect, &limits);
    entries.push(("connect/exit_on_failure", json!(true)));
    let timeout = u64::try_from(CONNECT_TIMEOUT.as_millis()).unwrap_or(u64::MAX);
    entries.push(("connect/timeout_ms", json!(timeout)));
    entries.extend(tls(observer.tls.as_ref()));
    Ok(entries)
}

struct Limits {
    lease: Duration,
    links: u16,
    message_bytes: u64,
}

fn common(mode: FleetMode, listen: &[String], connect: &[String], limits: &Limits) -> Entries {
    let lease = u64::try_from(limits.lease.as_millis()).unwrap_or(u64::MAX);
    vec![
        ("mode", json!(mode.word())),
        ("listen/endpoints", json!(listen)),
        ("listen/exit_on_failure", json!(true)),
        ("connect/endpoints", json!(connect)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/unicast/max_sessions", json!(limits.links)),
        ("transport/unicast/accept_pending", json!(16)),
        ("transport/unicast/accept_timeout", json!(3000)),
        ("transport/unicast/open_timeout", json!(3000)),
        ("transport/link/tx/lease", json!(lease)),
        (
            "transport/link/rx/max_message_size",
            json!(limits.message_bytes),
        ),
        ("queries_default_timeout", json!(3000)),
        ("adminspace/enabled", json!(false)),
    ]
}

fn tls(files: Option<&TlsFiles>) -> Entries {
    let Some(files) = files else {
        return Vec::new();
    };
    let text = |path: &Path| json!(path.display().to_string());
    let (certificate, key) = (text(&files.certificate), text(&files.key));
    vec![
        ("transport/link/tls/root_ca_certificate", text(&files.ca)),
        ("transport/link/tls/listen_certificate", certificate.clone()),
        ("transport/link/tls/listen_private_key", key.clone()),
        ("transport/link/tls/connect_certificate", certificate),
        ("transport/link/tls/connect_private_key", key),
        ("transport/link/tls/enable_mtls", json!(true)),
        ("transport/link/tls/verify_name_on_connect", json!(true)),
        ("transport/link/tls/close_link_on_expiration", json!(true)),
    ]
}

#[cfg(test)]
mod tests;
